"""Measured power of the detectors on the scanners that they are calibrated for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from manip3d._util.mappings import ReadOnlyMapping
from manip3d.authenticate._sensors import HDL64E
from manip3d.authenticate._verdict import NO_POWER, Power

if TYPE_CHECKING:
    from manip3d.authenticate._sensors import Sensor


def _measured(source: str, found: Mapping[str, tuple[int, int]]) -> Mapping[str, Power]:
    """Return the power by class of edits from the numbers of found and of planted ones."""
    return ReadOnlyMapping(
        {name: Power(hits, planted, source=source) for name, (hits, planted) in found.items()}
    )


_REPORTED = (
    "8 clean frames of KITTI that chose no threshold: drives 0005 and 0079, stereo-2015 000083 and "
    "000131, object"
)
_SINGLE = (
    "7 clean frames of KITTI: 4 of drive 0005, of which one may have raised a threshold, "
    "stereo-2015 000083 and 000131, object; detectors III and V together"
)
_BESIDE = (
    "clean frames of KITTI's drive 0005, of which one may have raised a threshold, with the frames "
    "before and after; detectors III, IV and V together"
)
_SCENES = "simulated terrestrial scans of manip3d.simulate.scenes, 0.2 degrees"

MEASURED: Mapping[str, Mapping[str, Power]] = ReadOnlyMapping(
    {
        "generic": _measured(
            _REPORTED,
            {
                "added": (40, 40),
                "moved": (40, 40),
                "rotated": (40, 40),
                "resampled": (40, 40),
                "removed": (4, 40),
                "along rays": (40, 40),
                "bump": (40, 40),
                "five points": (39, 40),
                "white-box removed": (0, 40),
                "white-box added": (0, 39),
                "spoofed": (0, 39),
            },
        ),
        "turns": _measured(
            "18 clean frames of KITTI's drive 0005 that chose no threshold, with the frames before "
            "and after; detectors III and IV together",
            {
                "added": (36, 36),
                "moved": (36, 36),
                "rotated": (36, 36),
                "resampled": (36, 36),
                "removed": (31, 36),
                "along rays": (36, 36),
                "bump": (35, 36),
                "five points": (33, 36),
                "white-box removed": (12, 36),
                "white-box added": (22, 36),
                "spoofed": (5, 36),
            },
        ),
        "reflectance": _measured(
            _BESIDE,
            {
                "reflectance: one value": (22, 22),
                "reflectance: scaled": (18, 22),
                "reflectance: shifted": (19, 22),
                "reflectance: exchanged": (12, 22),
                "reflectance: from elsewhere": (17, 22),
                "white-box removed": (21, 22),
                "white-box added": (15, 22),
                "spoofed": (4, 22),
            },
        ),
        "reflectance alone": _measured(
            _SINGLE,
            {
                "reflectance: one value": (42, 42),
                "reflectance: scaled": (1, 42),
                "reflectance: shifted": (5, 42),
                "reflectance: exchanged": (0, 42),
                "reflectance: from elsewhere": (0, 42),
                "white-box removed": (38, 42),
                "white-box added": (0, 42),
                "spoofed": (0, 42),
            },
        ),
        "generic lbm": _measured(
            _REPORTED,
            {
                "added": (40, 40),
                "moved": (40, 40),
                "rotated": (40, 40),
                "resampled": (40, 40),
                "removed": (3, 40),
                "along rays": (21, 40),
                "bump": (0, 40),
                "five points": (40, 40),
            },
        ),
        "generic qim": _measured(
            _REPORTED,
            {
                "added": (40, 40),
                "moved": (40, 40),
                "rotated": (40, 40),
                "resampled": (40, 40),
                "removed": (3, 40),
                "along rays": (22, 40),
                "bump": (9, 40),
                "five points": (40, 40),
            },
        ),
        "density": _measured(_SCENES, {"added": (31, 32), "resampled": (0, 32)}),
        "occlusion": _measured(_SCENES, {"added": (32, 32), "resampled": (32, 32)}),
    }
)
"""Power at a false-alarm rate of 1 % for all detectors of a scan together, by detector and
embedding. `benchmarks/bench_power.py` measures it with `measure_power`, except for detectors I and
II."""


def known_power(detector: str, sensor: Sensor, embedding: str = "") -> Mapping[str, Power]:
    """Return the measured power of a detector on scans of a scanner; empty: not measured.

    For detector III, the power that the scanner's lattice states has priority, because it was
    measured on scans of this scanner.

    Parameters
    ----------
    detector : 'density', 'occlusion', 'generic', 'turns', 'reflectance' or 'reflectance alone'
        Detector; ``reflectance alone``: detector V without neighbouring frames.
    sensor : Sensor
        The scanner.
    embedding : str
        Embedding of the watermark whose bits the scan carries.
    """
    own = NO_POWER if sensor.lattice is None else sensor.lattice.power
    if detector == "generic" and own and not embedding:
        return own
    if detector in ("density", "occlusion"):
        is_of_this = sensor.kind == "terrestrial"
    else:
        # A lattice that the scan itself tells finds fewer edits, of another unit than KITTI's.
        is_of_this = sensor.kind == "lattice" and sensor.name == HDL64E and not sensor.is_own
    return MEASURED.get(f"{detector} {embedding}".strip(), NO_POWER) if is_of_this else NO_POWER
