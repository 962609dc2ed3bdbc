"""Detector IV: objects that both neighbouring turns of a frame show, or neither of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.linear import moved
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d.authenticate._generic import largest_group, tight_box
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._movers import passes_by
from manip3d.authenticate._verdict import BesideTurns, Calibration, tail_p_value, verdict_repr
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.authenticate._lattice import LatticeReading, ReadingColumns

    Seen = tuple[ReadingColumns, ReadingColumns]

TURN_EVIDENCE = ("lost", "through", "before")
"""Kinds of evidence. ``lost``: no returns where both neighbouring turns saw the same object.
``through``: returns from behind a surface that both turns saw. ``before``: returns from a place
through which both turns saw."""

FARTHEST = 26.0
"""Metres: farther regions are not judged, because many single returns are lost there."""

FARTHEST_MOTION = 1.4
"""Metres: largest motion of the scanner between two turns. The cars of the streets in `TAIL` drive
3 to 13 m/s, up to 1.3 m per turn of 0.1 s; another 0.1 m allows for the alignment. At higher
speeds, or if turns are missing, clean frames have more evidence than `TAIL`."""

MAX_APART_NS = 150_000_000
"""Nanoseconds: largest time between neighbours, 1.5 turns of 0.1 s; thresholds were chosen for
turns of 0.1 s. In shorter turns, of scanners that turn 20 times a second, everything moves less."""

UNITS: Mapping[str, float] = ReadOnlyMapping({"lost": 400.0, "through": 60.0, "before": 110.0})
"""Number of directions times distance in metres of a region whose strength is 1, by kind. They only
relate the kinds to each other; `TAIL` states how rare a strength is."""

# fmt: off
TAIL: tuple[float, ...] = (
    9.402, 8.463, 5.276, 4.625, 4.355, 4.302, 3.901, 3.535, 3.423, 3.332,
    3.135, 3.113, 3.081, 2.828, 2.781, 2.751, 2.688, 2.606, 2.424, 2.423,
    2.198, 2.122, 1.979, 1.829, 1.805, 1.780, 1.742, 1.682, 1.681, 1.644,
    1.639, 1.634, 1.574, 1.549, 1.485, 1.461, 1.412, 1.301, 1.292, 1.289,
    1.257, 1.224, 1.204, 1.199, 1.176, 1.167, 1.153, 1.141, 1.130, 1.130,
    1.123, 1.121, 1.120, 1.113, 1.112, 1.109, 1.107, 1.105, 1.105, 1.102,
    1.096, 1.091, 1.091, 1.087, 1.072, 1.060, 1.059, 1.057, 1.054, 1.053,
    1.052, 1.051, 1.049, 1.037, 1.037, 1.033, 1.031, 1.031, 1.028, 1.025,
    1.022, 1.021, 1.019, 1.016, 1.015, 1.009, 1.002, 1.002, 1.001, 0.997,
    0.992, 0.990, 0.989, 0.985, 0.985, 0.981, 0.977, 0.975, 0.974, 0.974,
    0.974, 0.972, 0.970, 0.969, 0.968, 0.963, 0.962, 0.961, 0.957, 0.957,
    0.956, 0.951, 0.950, 0.944, 0.939, 0.937, 0.935, 0.934, 0.933, 0.932,
    0.932, 0.931, 0.930, 0.928, 0.927, 0.923, 0.922, 0.921, 0.921, 0.920,
    0.920, 0.917, 0.914, 0.912, 0.911, 0.909, 0.908, 0.907, 0.904, 0.903,
    0.898, 0.898, 0.896, 0.895, 0.895, 0.895, 0.895, 0.894, 0.893, 0.893,
    0.891, 0.886, 0.885, 0.885, 0.884, 0.883, 0.879, 0.879, 0.878, 0.878,
    0.877, 0.876, 0.875, 0.875, 0.875, 0.873, 0.871, 0.871, 0.871, 0.870,
    0.870, 0.869, 0.869, 0.868, 0.867, 0.867, 0.865, 0.865, 0.865, 0.863,
    0.863, 0.860, 0.860, 0.859, 0.859, 0.858, 0.858, 0.856, 0.856, 0.856,
    0.856, 0.855, 0.852, 0.851, 0.851, 0.851, 0.850, 0.848, 0.848, 0.848,
    0.847, 0.846, 0.846, 0.845, 0.842, 0.841, 0.841, 0.840, 0.840, 0.836,
    0.836, 0.835, 0.835, 0.835, 0.829, 0.829, 0.828, 0.826, 0.826, 0.825,
    0.824, 0.824, 0.823, 0.823, 0.822, 0.822, 0.822, 0.822, 0.820, 0.819,
    0.819, 0.817, 0.813, 0.812, 0.810, 0.809, 0.808, 0.808, 0.807, 0.807,
    0.807, 0.806, 0.806, 0.805, 0.804, 0.803, 0.802, 0.801, 0.798, 0.798,
    0.798, 0.797, 0.795, 0.795, 0.792, 0.790, 0.790, 0.790, 0.789, 0.789,
    0.788, 0.785, 0.784, 0.784, 0.784, 0.782, 0.781, 0.779, 0.779, 0.779,
    0.779, 0.778, 0.778, 0.776, 0.776, 0.776, 0.776, 0.773, 0.773, 0.772,
    0.772, 0.772,
)
# fmt: on
TAIL_FRAMES = 5634
"""The largest strengths of clean simulated frames, in descending order, and the number of frames:
streets 70000 to 70142, 71000 to 71142, 88000 to 88139 and 89000 to 89137 of
`manip3d.simulate.street`, partly those of detector V. Reported rates are measured on other streets;
`benchmarks/bench_alarms.py --calibrate` computes the strengths. A new clean frame is as strong as
the k-th of n with probability k / (n + 1), for any distribution (Vovk et al., Algorithmic Learning
in a Random World, 2005)."""


@dataclass(frozen=True, eq=False)
class TurnRegion:
    """A connected set of directions with evidence of an edit.

    Attributes
    ----------
    kind : 'lost', 'through' or 'before'
        See `TURN_EVIDENCE`.
    p_value : float
        Upper bound of the probability that a clean frame has a region as strong.
    strength : float
        For ranking; a clean frame seldom reaches 1.
    directions : int
        Number of directions in the region, each a third of a degree of one laser.
    distance : float, metres
        Median distance of the missing surface, or, for ``before``, of the added points.
    box : Box
        The smallest box, rotated about the vertical, around the missing surface, or around the
        added points.
    rows : (K,) int64
        Rows of the frame's points in these directions; empty for ``lost``.
    stood : (K, 3) float32, metres
        Points of the previous turn on the missing surface, in the frame's coordinates; empty for
        ``before``.
    """

    kind: str
    p_value: float
    strength: float
    directions: int
    distance: float
    box: Box
    rows: NDArray[np.int64]
    stood: NDArray[np.float32] = field(repr=False)

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class TurnResult(BesideTurns):
    """Result of detector IV for a frame; see :func:`turn_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
        ``undecidable``: the turns could not be aligned with the frame, the scanner moved farther
        between them than `FARTHEST_MOTION`, their times are farther apart than `MAX_APART_NS`, or
        no ground was found.
    reason : str
        Reason of the verdict in words.
    p_value : float
        Upper bound of the probability that a clean frame shows as much evidence.
    score : float
        Largest strength of a region; larger is more suspicious.
    false_alarm_rate : float
        The argument of this name.
    regions : tuple of TurnRegion
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the strongest first.
    suspected : (K,) int64
        Rows of the points in these regions.
    previous, following : (4, 4) float64
        Transforms of the previous and of the following turn into the frame's coordinates, metres.
    calibration : Calibration
        Clean frames on which the thresholds were chosen.
    aligned : bool
        Whether both turns could be aligned with the frame, so that the transforms are valid, even
        if the scanner moved too far for the thresholds.
    foreign : bool
        Whether both turns could be aligned with each other but not with the frame: they show one
        place, and the frame another one.
    """

    regions: tuple[TurnRegion, ...]
    previous: NDArray[np.float64] = field(repr=False)
    following: NDArray[np.float64] = field(repr=False)
    calibration: Calibration = field(repr=False)
    aligned: bool = True
    foreign: bool = False

    __repr__ = verdict_repr


CALIBRATION = Calibration(
    "564 simulated streets from 70000 to 89137, ten frames each, with their neighbours",
    TAIL_FRAMES,
    38,
    "In the simulated streets cars absorb pulses, but no plants move in the wind.",
)

FOREIGN = "the turns before and after show one place, and the frame another"

_REASONS = {
    "lost": "returns are missing from a thing that the turns before and after saw",
    "through": "points lie behind a thing that the turns before and after saw",
    "before": "points lie at a place that the turns before and after looked through",
}


@checked
def turn_consistency(
    frame: LidarFrame | ArrayLike,
    previous: LidarFrame | ArrayLike,
    following: LidarFrame | ArrayLike,
    *,
    lattice: SensorLattice,
    false_alarm_rate: float = 0.01,
    whole_turns: bool = True,
    threads: int = 0,
) -> TurnResult:
    """Find objects that were removed from a frame, or added, by comparing neighbouring turns.

    Parameters
    ----------
    frame : LidarFrame or (N, 3) points
        Frame in metres, with the scanner at the origin.
    previous, following : the same
        Frames of the same scanner one turn earlier and later, which must not be edited in the same
        way. Frames that state their times are compared if these are at most 0.15 s apart.
    lattice : SensorLattice
        Lattice of the scanner, from :func:`estimate_lattice`; only its lines are used.
    false_alarm_rate : float
        Largest share of clean frames that may be called tampered; in (0, 1). Rates below 1 / 5635
        never accuse, because the threshold was chosen on 5634 frames.
    whole_turns : bool
        Whether both turns have all of their points. If not (they were cropped or thinned), places
        where one of them has gaps are no evidence for ``before``, and less is found.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    TurnResult

    Raises
    ------
    InputError
        Points have another shape or are not finite; the rate is out of range.

    Notes
    -----
    Both turns are aligned with the frame by point-to-plane ICP. An object that both saw at one
    place stands still, and must be visible in the frame, or hidden by something nearer, because no
    object leaves a place and returns within two turns. Deleting its points leaves directions
    without a return; overwriting them with the background leaves returns from behind. Dark cars
    that absorb pulses leave holes as well, but these move: nearby directions that were silent in
    another turn and have a return now are subtracted. The evidence of a region is its number of
    directions times their distance in metres. An object that moves more than its own length per
    turn is seen at a place by one turn only; points with counterparts at equal distances behind in
    the previous turn and ahead in the following turn are therefore no evidence. If the scanner
    moved more than 1.4 m between two turns, nothing is judged.

    Both neighbours must show the place unedited: if two or more successive frames are edited there,
    this detector does not find it.

    Examples
    --------
    >>> from manip3d import authenticate, forge, simulate
    >>> before, frame, after = (simulate.courtyard(x, rng=k) for k, x in enumerate((-1, 0, 1)))
    >>> lattice = authenticate.kitti_lattice()
    >>> authenticate.turn_consistency(frame, before, after, lattice=lattice).verdict
    'no_trace'
    >>> forged = forge.subtract(frame, forge.nearest_object(frame)).frame
    >>> found = authenticate.turn_consistency(forged, before, after, lattice=lattice)
    >>> found.verdict, found.regions[0].kind
    ('tampered', 'lost')
    """
    for other, name in ((previous, "before"), (following, "after")):
        if (apart := apart_ns(frame, other)) > MAX_APART_NS:
            return _undecidable(no_turn(name, apart), false_alarm_rate)
    return turns_read(
        None, frame, previous, following, lattice, false_alarm_rate=false_alarm_rate,
        whole_turns=whole_turns, threads=threads,
    )[0]  # fmt: skip


def apart_ns(one: LidarFrame | ArrayLike, other: LidarFrame | ArrayLike) -> int:
    """Return the time between two scans, nanoseconds; 0 if one of them does not state its time."""
    times = [each.time_ns for each in (one, other) if isinstance(each, LidarFrame)]
    known = [time for time in times if time is not None]
    return abs(known[0] - known[1]) if len(known) == 2 else 0


def no_turn(name: str, apart: int) -> str:
    """Return why a scan that was taken so many nanoseconds before or after is not compared."""
    return f"the turn {name} was taken {apart * 1e-9:.2f} s apart, which is no turn"


def turns_read(
    reading: LatticeReading | None,
    frame: LidarFrame | ArrayLike,
    previous: LidarFrame | ArrayLike,
    following: LidarFrame | ArrayLike,
    lattice: SensorLattice,
    *,
    false_alarm_rate: float,
    whole_turns: bool,
    threads: int,
) -> tuple[TurnResult, Seen]:
    """Return the result of `turn_consistency`, and the places of both turns on the lattice.

    Parameters
    ----------
    reading : LatticeReading or None
        Places of the frame's points on the lattice; None: they are computed here.
    frame, previous, following, lattice, false_alarm_rate, whole_turns, threads
        Same as in `turn_consistency`.
    """
    if not 0.0 < false_alarm_rate < 1.0:
        raise InputError(f"false_alarm_rate: expected a share in (0, 1), got {false_alarm_rate!r}")
    cloud = _points_of(frame, "frame")
    before, after = _points_of(previous, "previous"), _points_of(following, "following")
    found = _core.compare_turns(
        cloud,
        before,
        after,
        lattice.table,
        whole_turns,
        threads_of(threads),
        None if reading is None else reading.columns,
    )
    seen: Seen = found["seen"]
    motions = _matrix(found["previous"]), _matrix(found["following"])
    if (why := _why_not_judged(found, motions)) is not None:
        is_foreign = _is_foreign(found, before, after, lattice, threads_of(threads))
        told = _undecidable(FOREIGN if is_foreign else why, false_alarm_rate, motions)
        return replace(told, aligned=bool(found["judged"]), foreign=is_foreign), seen
    traces = [_Trace(each) for each in found["regions"] if each["distance"] < FARTHEST]
    if any(trace.kind == "before" and trace.p_value < 1.0 for trace in traces):
        turns = [_in_frame(*each) for each in zip((before, after), motions, strict=True)]
        traces = [
            trace
            for trace in traces
            if trace.kind != "before" or trace.p_value == 1.0
            or not passes_by(cloud[trace.found["rows"]], *turns)
        ]  # fmt: skip
    traces.sort(key=lambda trace: -trace.strength)
    alarming = tuple(_region(trace, cloud) for trace in traces if trace.p_value <= false_alarm_rate)
    rows = [region.rows for region in alarming]
    return TurnResult(
        "tampered" if alarming else "no_trace",
        _REASONS[alarming[0].kind]
        if alarming
        else "the turns before and after saw what the frame shows",
        min((trace.p_value for trace in traces), default=1.0),
        max((trace.strength for trace in traces), default=0.0),
        false_alarm_rate,
        alarming,
        np.unique(np.concatenate(rows)) if rows else np.empty(0, np.int64),
        *motions,
        CALIBRATION,
    ), seen


def _undecidable(
    why: str, false_alarm_rate: float, motions: tuple[NDArray[np.float64], ...] = ()
) -> TurnResult:
    previous, following = motions or (np.eye(4), np.eye(4))
    return TurnResult(
        "undecidable", why, 1.0, 0.0, false_alarm_rate, (), np.empty(0, np.int64), previous,
        following, CALIBRATION, aligned=False,
    )  # fmt: skip


def turn_strength(region: Mapping[str, Any]) -> float:
    """Return the strength of a region: its directions times distance in metres, over `UNITS`.

    Parameters
    ----------
    region : mapping
        Region, as `_core.compare_turns` returns it.
    """
    kind = region["kind"]
    directions = region["agreed"] - (1.0 if kind == "before" else 0.5) * region["moved"]
    if kind == "lost":  # after a removal the ground is still seen, in a shadow it is not
        directions -= region["ground"]
    return max(0.0, float(directions * region["distance"] / UNITS[kind]))


def turn_p_value(strength: float) -> float:
    """Return an upper bound of the probability that a clean frame has a region as strong."""
    return tail_p_value(strength, TAIL, TAIL_FRAMES)


def _why_not_judged(
    found: Mapping[str, Any], motions: tuple[NDArray[np.float64], ...]
) -> str | None:
    """Reason why the turns cannot be compared with the frame; None: they can."""
    if not found["has_ground"]:
        return "no ground plane was found"
    if not found["judged"]:
        return "the turns before and after could not be aligned with the frame"
    farthest = max(float(np.linalg.norm(motion[:3, 3], axis=-1)) for motion in motions)
    if farthest > FARTHEST_MOTION:
        return (
            f"the scanner moved {farthest:.1f} m between two turns; the thresholds hold up to "
            f"{FARTHEST_MOTION} m. Turns may be missing"
        )
    return None


def _is_foreign(
    found: Mapping[str, Any],
    before: NDArray[np.float32],
    after: NDArray[np.float32],
    lattice: SensorLattice,
    threads: int,
) -> bool:
    """Whether the turns can be aligned with each other, but neither of them with the frame."""
    if not found["has_ground"] or any(found[name]["found"] for name in ("previous", "following")):
        return False
    skipping = _core.compare_turns(before, after, after, lattice.table, True, threads)
    return bool(skipping["previous"]["found"])


def _in_frame(points: NDArray[np.float32], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points in the coordinates of the frame; rows at (0, 0, 0) have no return."""
    return moved(points[points.any(axis=1)], motion)


def _points_of(frame: LidarFrame | ArrayLike, name: str) -> NDArray[np.float32]:
    points = frame.points if isinstance(frame, LidarFrame) else frame
    return as_rows(points, 3, np.float32, name)


def _matrix(motion: Mapping[str, Any]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = motion["rotation"], np.ravel(motion["translation"])
    return matrix


class _Trace:
    """A region that the kernel found, whether or not it is strong enough for an alarm."""

    def __init__(self, found: Mapping[str, Any]) -> None:
        self.found = found
        self.kind: str = found["kind"]
        self.strength = turn_strength(found)
        self.p_value = turn_p_value(self.strength)


def _region(trace: _Trace, points: NDArray[np.float32]) -> TurnRegion:
    found, rows = trace.found, trace.found["rows"].astype(np.int64)
    there = points[rows] if trace.kind == "before" else found["stood"]
    box = tight_box(largest_group(there)) if len(there) else Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return TurnRegion(
        trace.kind, trace.p_value, trace.strength, found["cells"], found["distance"], box,
        np.empty(0, np.int64) if trace.kind == "lost" else rows, found["stood"],
    )  # fmt: skip
