"""Detector IV: what the turns before and after a frame saw, and the frame does not show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import threads_of
from manip3d.authenticate._generic import largest_group, tight_box
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._movers import passes_by
from manip3d.authenticate._verdict import BesideTurns, Calibration
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.authenticate._lattice import LatticeReading, ReadingColumns

    Seen = tuple[ReadingColumns, ReadingColumns]

TURN_EVIDENCE = ("lost", "through", "before")
"""Kinds of evidence. ``lost``: no return where both turns saw the same thing; ``through``: returns
from behind a surface that both turns saw; ``before``: returns from a place that both looked
through."""

FARTHEST = 26.0
"""Metres: farther regions are not judged, because single returns get lost there in masses."""

FARTHEST_MOTION = 1.4
"""Metres that the scanner may move between two turns. The cars of the streets that fix the tail
drive 3 to 13 m/s, 1.3 m in a turn of a tenth of a second; a decimetre is for the alignment. Faster,
or with turns that were left out, clean frames show more than the tail holds."""

MOST_APART_NS = 150_000_000
"""Nanoseconds between neighbours: one and a half turns of a tenth of a second, as the thresholds
were fixed with."""

UNITS: Mapping[str, float] = ReadOnlyMapping({"lost": 400.0, "through": 60.0, "before": 110.0})
"""Directions times metres of a region whose strength is 1, by kind. They only say how the kinds
compare; what is rare is told by `TAIL`."""

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
"""The largest strengths of clean simulated frames, in descending order, and how many frames these
are: those of detector V, streets 70000 to 70142, 71000 to 71142, 88000 to 88139 and 89000 to 89137
of `manip3d.simulate.street`, which are in no report, as `benchmarks/bench_alarms.py --calibrate`
judges them. A new clean frame is as strong as the k-th of n with probability k / (n + 1), whatever
the distribution is (Vovk et al., Algorithmic Learning in a Random World, 2005)."""


@dataclass(frozen=True, eq=False)
class TurnRegion:
    """A connected set of directions with evidence of an edit.

    Attributes
    ----------
    kind : 'lost', 'through' or 'before'
        See `TURN_EVIDENCE`.
    p_value : float
        Probability, at most, that a clean frame has a region as strong.
    strength : float
        For ranking; a clean frame seldom reaches 1.
    directions : int
        Number of directions in the region, each a third of a degree of one laser.
    distance : float, metres
        Median of what the turns saw there, or of the points that nobody saw.
    box : Box
        The tight box, turned about the vertical, around what stood there, or around the points.
    rows : (K,) int64
        Points of the frame in those directions; none where the returns are gone.
    stood : (K, 3) float32, metres
        What the turn before saw there, in the frame's coordinates; none for ``before``.
    """

    kind: str
    p_value: float
    strength: float
    directions: int
    distance: float
    box: Box
    rows: NDArray[np.int64]
    stood: NDArray[np.float32] = field(repr=False)


@dataclass(frozen=True, eq=False)
class TurnResult(BesideTurns):
    """Result of detector IV for a frame; see :func:`turn_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
        ``undecidable``: the turns could not be aligned with the frame, the scanner moved farther
        between them than where the thresholds were fixed, or no ground was found.
    reason : str
        In words.
    p_value : float
        Probability, at most, that a clean frame shows as much.
    score : float
        The largest strength of a region; larger is more suspicious.
    false_alarm_rate : float
        As asked for.
    regions : tuple of TurnRegion
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the strongest first.
    suspected : (K,) int64
        Rows of the points in them.
    previous, following : (4, 4) float64
        The motion of the turn before and of the turn after into the frame's coordinates, metres.
    calibration : Calibration
    aligned : bool
        Whether both turns could be aligned with the frame, so that the motions hold, although the
        scanner moved too far for the thresholds.
    foreign : bool
        Whether neither turn could be aligned with the frame, and both with each other: they show
        one place, and the frame another.
    """

    regions: tuple[TurnRegion, ...]
    previous: NDArray[np.float64] = field(repr=False)
    following: NDArray[np.float64] = field(repr=False)
    calibration: Calibration = field(repr=False)
    aligned: bool = True
    foreign: bool = False


CALIBRATION = Calibration(
    "564 simulated streets from 70000 to 89137, ten frames each, with their neighbours",
    TAIL_FRAMES,
    38,
    "Simulated cars swallow pulses, but nothing in them grows or sways in the wind.",
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
    """Look for what was removed from a frame, or put into it, with the turns before and after.

    Parameters
    ----------
    frame : LidarFrame or (N, 3) points
        Metres, the scanner at the origin.
    previous, following : the same
        The frames a turn earlier and later, of the same scanner; not edited in the same way.
    lattice : SensorLattice
        Lattice of the scanner, from :func:`estimate_lattice`; only its lines are looked at.
    false_alarm_rate : float
        Share of clean frames that may be called tampered; in (0, 1). Rates below 1 / 5635 never
        alarm: the threshold stands on so many frames.
    whole_turns : bool
        Whether both turns have all of their points. If not (they were cropped or thinned), nothing
        is taken for new or looked through where one of them has gaps, and less is found.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    TurnResult

    Raises
    ------
    InputError
        Points of another shape or not finite; a rate out of range.

    Notes
    -----
    Both turns are aligned with the frame by point-to-plane ICP. What both saw at one place stands
    still, and must be seen in between, or hidden by something nearer: nothing leaves a place and is
    back within two turns. What was deleted leaves directions without a return, what was
    overwritten by its background leaves returns from behind. Dark cars that swallow pulses leave
    holes, too; these move, so that directions nearby that were silent in another turn and answer
    now are subtracted. A region weighs its directions times their distance in metres. What passes
    through a place faster than its own length a turn is seen there by one turn only: points with a
    counterpart as far behind in the turn before as beyond in the turn after are no evidence. Where
    the scanner moved more than 1.4 m between two turns, nothing is judged.

    Both neighbours must show the place unedited: where two or more frames in a row are edited
    there, this detector sees none of it.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate
    >>> nothing = np.zeros((0, 3), np.float32)
    >>> lattice = authenticate.kitti_lattice()
    >>> authenticate.turn_consistency(nothing, nothing, nothing, lattice=lattice).verdict
    'undecidable'
    """
    return turns_read(
        None, frame, previous, following, lattice, false_alarm_rate=false_alarm_rate,
        whole_turns=whole_turns, threads=threads,
    )[0]  # fmt: skip


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
    """Return what `turn_consistency` does, and where the moved turns lie on the lattice.

    Parameters
    ----------
    reading : LatticeReading or None
        Where the frame's points lie on the lattice; None: they are read here.
    frame, previous, following, lattice, false_alarm_rate, whole_turns, threads
        As for `turn_consistency`.
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
    nothing = np.empty(0, np.int64)
    if (why := _why_not_judged(found, motions)) is not None:
        is_foreign = _is_foreign(found, before, after, lattice, threads_of(threads))
        return TurnResult(
            "undecidable", FOREIGN if is_foreign else why, 1.0, 0.0, false_alarm_rate, (), nothing,
            *motions, CALIBRATION, aligned=bool(found["judged"]), foreign=is_foreign,
        ), seen  # fmt: skip
    regions = [_region(each, cloud) for each in found["regions"] if each["distance"] < FARTHEST]
    if any(region.kind == "before" and region.p_value < 1.0 for region in regions):
        turns = [_in_frame(*each) for each in zip((before, after), motions, strict=True)]
        regions = [
            region
            for region in regions
            if region.kind != "before" or region.p_value == 1.0
            or not passes_by(cloud[region.rows], *turns)
        ]  # fmt: skip
    regions.sort(key=lambda region: -region.strength)
    alarming = tuple(region for region in regions if region.p_value <= false_alarm_rate)
    rows = [region.rows for region in alarming]
    return TurnResult(
        "tampered" if alarming else "no_trace",
        _REASONS[alarming[0].kind]
        if alarming
        else "the turns before and after saw what the frame shows",
        min((region.p_value for region in regions), default=1.0),
        max((region.strength for region in regions), default=0.0),
        false_alarm_rate,
        alarming,
        np.unique(np.concatenate(rows)) if rows else nothing,
        *motions,
        CALIBRATION,
    ), seen


def turn_strength(region: Mapping[str, Any]) -> float:
    """Return how strong the evidence of a region is: directions times metres, in `UNITS`.

    Parameters
    ----------
    region : mapping
        As `_core.compare_turns` returns it.
    """
    kind = region["kind"]
    directions = region["agreed"] - (1.0 if kind == "before" else 0.5) * region["moved"]
    if kind == "lost":  # what was cut out above the ground leaves the ground; shadows do not
        directions -= region["ground"]
    return max(0.0, float(directions * region["distance"] / UNITS[kind]))


def turn_p_value(strength: float) -> float:
    """Return the probability, at most, that a clean frame has a region as strong."""
    as_strong = sum(value >= strength for value in TAIL)
    return (1 + as_strong) / (1 + TAIL_FRAMES) if as_strong < len(TAIL) else 1.0


def _why_not_judged(
    found: Mapping[str, Any], motions: tuple[NDArray[np.float64], ...]
) -> str | None:
    """Why the turns tell nothing of the frame; None: they can be compared."""
    if not found["has_ground"]:
        return "no ground plane was found"
    if not found["judged"]:
        return "the turns before and after could not be aligned with the frame"
    farthest = max(float(np.linalg.norm(motion[:3, 3])) for motion in motions)
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
    """Whether the turns lie to each other as two turns do, and neither to the frame."""
    if not found["has_ground"] or any(found[name]["found"] for name in ("previous", "following")):
        return False
    skipping = _core.compare_turns(before, after, after, lattice.table, True, threads)
    return bool(skipping["previous"]["found"])


def _in_frame(points: NDArray[np.float32], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    moved: NDArray[np.float64] = points @ motion[:3, :3].T + motion[:3, 3]
    return moved


def _points_of(frame: LidarFrame | ArrayLike, name: str) -> NDArray[np.float32]:
    points = frame.points if isinstance(frame, LidarFrame) else frame
    return as_rows(points, 3, np.float32, name)


def _matrix(motion: Mapping[str, Any]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = motion["rotation"], np.ravel(motion["translation"])
    return matrix


def _region(found: Mapping[str, Any], points: NDArray[np.float32]) -> TurnRegion:
    rows = found["rows"].astype(np.int64)
    there = points[rows] if found["kind"] == "before" else found["stood"]
    box = tight_box(largest_group(there)) if len(there) else Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    strength = turn_strength(found)
    return TurnRegion(
        found["kind"], turn_p_value(strength), strength, found["cells"], found["distance"], box,
        np.empty(0, np.int64) if found["kind"] == "lost" else rows, found["stood"],
    )  # fmt: skip
