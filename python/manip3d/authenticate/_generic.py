"""Detector III: has a LiDAR scan been edited, told from the scan alone?"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.showing import Showable
from manip3d.authenticate._lattice import SensorLattice, estimate_lattice
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Verdict = Literal["authentic", "tampered", "undecidable"]

EVIDENCE = ("grid", "line", "step", "firing", "duplicate", "order", "range", "void", "time")
"""Kinds of evidence, in the order of the bits of ``flags``."""

STRAY_RATE = 1e-5
"""Points of a clean frame, at most, that contradict the lattice for no reason: none of the 2.5
million of KITTI's drive 0002 and two other drives does, so it is below 1.2e-6 (95 %)."""

NEIGHBOURS = 100
"""Points among which a second stray point would be taken for a neighbour of a first."""

WINDOWS = 1_000_000
"""Windows of ranges that might be tested in a frame of 64 lasers: three around each voxel."""

VOID_FEWEST, VOID_SCALE = 8.0, 55.0
"""The largest voids of a clean frame reach ``s`` firings with probability exp((8 - s) / 55) at
most. That is what simulated streets show, whose dark cars return nothing at all: of 40 frames the
median is 40, a tenth is above 140, the largest has 245. Of 21 real frames of three drives 20 have
none and one has 12; cars that swallow all light are rare there, but they are not forgeries."""

TIME_FEWEST, TIME_SCALE = 8.0, 25.0
"""The same where a previous frame was answered: of 36 simulated pairs the median is 12, the largest
has 80; of 21 real pairs 20 have none and one has 13."""

REASONS = {
    "unknown": "the lattice does not know it",
    "contradicted": "the whole frame contradicts it: processed, or another scanner",
    "depends": "it stands on evidence that was dropped",
    "no ground": "no ground plane was found",
    "no previous": "no earlier frame on the same lattice was given",
    "no lattice": "no lattice of a spinning scanner was found",
}


@dataclass(frozen=True)
class EvidenceReport:
    """What one kind of evidence says of a frame.

    Attributes
    ----------
    used : bool
    reason : str
        Why not; empty where it was used.
    share : float
        Of the frame's points that contradict it, whether it was used or not.
    strength : float
        Of the strongest region: points, firings (``void``) or an exponent (``range``).
    p_value : float
        Probability, at most, that a clean frame shows as much; 1 where it was not used.
    """

    used: bool
    reason: str
    share: float
    strength: float
    p_value: float


@dataclass(frozen=True)
class SuspectRegion:
    """A connected part of the view with evidence of an edit.

    Attributes
    ----------
    p_value : float
        Probability, at most, that a clean frame has a region with as much.
    strength : mapping of str to float
        By kind of evidence; those that say nothing are left out.
    lower, upper : (float, float, float)
        Metres: axis-parallel box of the suspected points, or of where removed ones stood.
    """

    p_value: float
    strength: Mapping[str, float]
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class GenericResult(Showable):
    """What detector III says of a frame; see :func:`generic_consistency`.

    Attributes
    ----------
    verdict : 'authentic', 'tampered' or 'undecidable'
    p_value : float
        Probability, at most, that a clean frame shows evidence as strong; the verdict is
        ``tampered`` where it does not exceed ``false_alarm_rate``.
    score : float
        For ranking: ``-log10`` of the smallest p-value of a region and a kind of evidence, before
        their number is allowed for, and without the limits of floating point.
    false_alarm_rate : float
        As asked for.
    evidence : mapping of str to EvidenceReport
        Each kind, used or not.
    regions : tuple of SuspectRegion
        Those whose own ``p_value`` does not exceed ``false_alarm_rate``, the most significant
        first.
    suspected : (K,) int64
        Rows of the points with evidence in those regions.
    evidence_map : (R, C) uint16
        Items of evidence by direction: two lasers a row, the highest first; columns
        counter-clockwise from straight ahead.
    lattice : SensorLattice or None
        That the frame was judged by.
    scan : LidarFrame or None
        What was judged, so that the result can be shown.
    """

    verdict: Verdict
    p_value: float
    score: float
    false_alarm_rate: float
    evidence: Mapping[str, EvidenceReport]
    regions: tuple[SuspectRegion, ...]
    suspected: NDArray[np.int64]
    evidence_map: NDArray[np.uint16]
    lattice: SensorLattice | None
    scan: LidarFrame | None = field(default=None, repr=False)


@checked
def generic_consistency(
    frame: LidarFrame | ArrayLike,
    *,
    calibration: SensorLattice | None = None,
    previous: LidarFrame | ArrayLike | None = None,
    false_alarm_rate: float = 0.01,
    tolerance: float = 0.002,
    threads: int = 0,
) -> GenericResult:
    """Look for edits of one scan of a spinning LiDAR: detector III.

    Parameters
    ----------
    frame : LidarFrame or (N, 3) points
        Metres, the scanner at the origin, the points in the order of its file.
    calibration : SensorLattice, optional
        Of the scanner, from :func:`estimate_lattice` on clean scans; else it is estimated from the
        frame itself, which takes some tenths of a second.
    previous : LidarFrame or (N, 3) points, optional
        The frame a turn earlier: what was answered then is missed now.
    false_alarm_rate : float
        Of clean frames that may be called tampered; in (0, 1).
    tolerance : float, metres
        How far from its line and step a point may be; coordinates of whole millimetres leave 0.8
        mm.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    GenericResult

    Raises
    ------
    InputError
        Points of another shape or not finite; an option out of range.

    Notes
    -----
    Every return of an HDL-64E lies on one of 64 lines, at a step of the encoder at which the whole
    head fired, at a range that is a whole number of 2 mm; each laser has at most one return per
    firing, and KITTI's files list them in a fixed order. What is pasted, moved, turned or dented
    breaks one or several of these; what is removed leaves firings into the ground without a return,
    above ground that answered, with answers to both sides.
    Evidence that the whole frame contradicts (a motion-compensated cloud is on no lattice) is
    dropped, with all that stands on it. A frame without alarm whose lines were dropped is
    undecidable.

    Single points that stray by chance are allowed for: of ``m`` neighbouring ones,
    ``N * STRAY_RATE * (NEIGHBOURS * STRAY_RATE)**(m - 1)`` are expected. Kinds of evidence are
    combined by their smallest p-value times their number (Bonferroni).
    """
    if not 0.0 < false_alarm_rate < 1.0:
        raise InputError(f"false_alarm_rate: expected a share in (0, 1), got {false_alarm_rate!r}")
    cloud = _points_of(frame, "points")
    lattice = calibration
    if lattice is None:
        try:
            lattice = estimate_lattice(frame)
        except InputError:
            _core.check_points(cloud, np.empty(0, np.float32))
            return _undecidable(false_alarm_rate)
    found = _core.generic_consistency(
        cloud,
        lattice.table,
        lattice.steps,
        lattice.range_step,
        lattice.coordinate_step,
        tolerance,
        _points_of(previous, "previous"),
        threads_of(threads),
    )
    scan = frame if isinstance(frame, LidarFrame) else LidarFrame(cloud, origin=(0.0, 0.0, 0.0))
    return _judged(found, scan, lattice, false_alarm_rate)


def _points_of(frame: LidarFrame | ArrayLike | None, name: str) -> NDArray[np.float32]:
    if frame is None:
        return np.empty((0, 3), np.float32)
    points = frame.points if isinstance(frame, LidarFrame) else frame
    return as_rows(points, 3, np.float32, name)


def _log10_p(kind: str, strength: float, points: int) -> float:
    """log10 of the probability, at most, that a clean frame has a region of such a strength."""
    if strength <= 0.0:
        return 0.0
    if kind == "range":
        log = math.log10(WINDOWS) - strength * math.log10(math.e)
    elif kind == "void":
        log = (VOID_FEWEST - strength) / VOID_SCALE * math.log10(math.e)
    elif kind == "time":
        log = (TIME_FEWEST - strength) / TIME_SCALE * math.log10(math.e)
    else:
        stray = max(points, 1) * STRAY_RATE
        log = math.log10(stray) + (strength - 1.0) * math.log10(NEIGHBOURS * STRAY_RATE)
    return min(0.0, log)


def _judged(
    found: Mapping[str, Any], scan: LidarFrame, lattice: SensorLattice, false_alarm_rate: float
) -> GenericResult:
    points = scan.num_points
    used = [
        kind
        for kind, (dropped, _, _) in zip(EVIDENCE, found["evidence"], strict=True)
        if not dropped
    ]
    tests = math.log10(max(1, len(used)))
    evidence = {}
    for kind, (dropped, share, strength) in zip(EVIDENCE, found["evidence"], strict=True):
        p_value = 10.0 ** _log10_p(kind, strength, points) if not dropped else 1.0
        evidence[kind] = EvidenceReport(
            not dropped, REASONS.get(dropped, ""), share, strength, p_value
        )
    best = [
        min(_log10_p(k, s, points) for k, s in zip(EVIDENCE, strengths, strict=True))
        for strengths, _, _ in found["regions"]
    ]
    logs = [min(0.0, tests + log) for log in best]
    alarming = [i for i, log in enumerate(logs) if 10.0**log <= false_alarm_rate]
    regions = tuple(
        _region(found["regions"][i], logs[i]) for i in sorted(alarming, key=lambda i: (logs[i], i))
    )
    suspected = np.flatnonzero(np.isin(found["region_of_point"], alarming))
    quiet: Verdict = "authentic" if evidence["line"].used else "undecidable"
    return GenericResult(
        "tampered" if alarming else quiet,
        10.0 ** min(logs, default=0.0),
        abs(min(best, default=0.0)),
        false_alarm_rate,
        evidence,
        regions,
        suspected,
        found["cells"].reshape(-1, _core.CELL_COLUMNS),
        lattice,
        scan,
    )


def _region(found: tuple[Any, Any, Any], log: float) -> SuspectRegion:
    strengths, lower, upper = found
    speaking = {k: s for k, s in zip(EVIDENCE, strengths, strict=True) if s > 0.0}
    return SuspectRegion(10.0**log, speaking, tuple(lower), tuple(upper))


def _undecidable(false_alarm_rate: float) -> GenericResult:
    nothing = EvidenceReport(False, REASONS["no lattice"], 0.0, 0.0, 1.0)
    return GenericResult(
        "undecidable",
        1.0,
        0.0,
        false_alarm_rate,
        dict.fromkeys(EVIDENCE, nothing),
        (),
        np.empty(0, np.int64),
        np.zeros((0, _core.CELL_COLUMNS), np.uint16),
        None,
    )
