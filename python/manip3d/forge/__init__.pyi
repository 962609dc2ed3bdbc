from __future__ import annotations

from manip3d.forge._alert import (
    ALERT_ATTACKS,
    additive,
    additive_subtractive,
    replacement,
    rotation,
    subtractive,
    translation,
)
from manip3d.forge._attacks import (
    crtp,
    ctp,
    deform,
    insert_occluding,
    range_scale,
    resample,
    snap_to_lattice,
    subtract,
)
from manip3d.forge._firings import MAX_SPOOFED, lattice_insert, lattice_remove, spoof
from manip3d.forge._objects import Segmentation, nearest_object, segment
from manip3d.forge._plates import background_plate, without_people
from manip3d.forge._recorded import (
    MAX_KEPT,
    NUM_POSES,
    RecordedPeople,
    at_pace,
    recorded_people,
    recorded_poses,
)
from manip3d.forge._stream import ForgedFrame, ForgedStream, StreamForger, stream
from manip3d.forge._stream_truth import StreamTruth, read_stream_truth
from manip3d.forge._truth import Forgery, Lattice

__all__ = [
    "ALERT_ATTACKS",
    "MAX_KEPT",
    "MAX_SPOOFED",
    "NUM_POSES",
    "ForgedFrame",
    "ForgedStream",
    "Forgery",
    "Lattice",
    "RecordedPeople",
    "Segmentation",
    "StreamForger",
    "StreamTruth",
    "additive",
    "additive_subtractive",
    "at_pace",
    "background_plate",
    "crtp",
    "ctp",
    "deform",
    "insert_occluding",
    "lattice_insert",
    "lattice_remove",
    "nearest_object",
    "range_scale",
    "read_stream_truth",
    "recorded_people",
    "recorded_poses",
    "replacement",
    "resample",
    "rotation",
    "segment",
    "snap_to_lattice",
    "spoof",
    "stream",
    "subtract",
    "subtractive",
    "translation",
    "without_people",
]
