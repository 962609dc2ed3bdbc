"""Forge LiDAR scans and RGB-D streams, with ground truth, to test `manip3d.authenticate`."""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_alert": (
            "ALERT_ATTACKS additive additive_subtractive replacement rotation subtractive "
            "translation"
        ),
        "_attacks": (
            "crtp ctp deform insert_occluding range_scale resample snap_to_lattice subtract"
        ),
        "_firings": "MAX_SPOOFED lattice_insert lattice_remove spoof",
        "_objects": "Segmentation nearest_object segment",
        "_plates": "background_plate without_people",
        "_recorded": "MAX_KEPT NUM_POSES RecordedPeople at_pace recorded_people recorded_poses",
        "_stream": "ForgedFrame ForgedStream StreamForger stream",
        "_stream_truth": "StreamTruth read_stream_truth",
        "_truth": "Forgery Lattice",
    },
)
