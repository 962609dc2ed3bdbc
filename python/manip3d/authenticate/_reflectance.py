"""Detector V: reflectances that the scanner cannot have measured, or that the turns beside do not
have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import threads_of
from manip3d.authenticate._generic import largest_group, tight_box
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._turns import TurnResult, turn_consistency
from manip3d.authenticate._verdict import BesideTurns, Calibration, Verdict
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading
    from manip3d.authenticate._turns import Seen

REFLECTANCE_EVIDENCE = ("grid", "even", "changed")
"""Kinds of evidence. ``grid``: values that are not the hundredths that the rest of the frame has;
``even``: neighbours along a ring have the same value, without the scanner's shot noise;
``changed``: the turns before and after agree on a value that the frame does not have."""

STEP = 0.01
"""Reflectances of KITTI's scanner are whole numbers of this."""

MOST_OFF_STEP = 0.2
"""Share of values off the hundredths above which the scanner does not write hundredths."""

FEWEST_VALUES = 16
"""Different reflectances of a frame, at least: fewer hold no noise to judge by."""

OTHER_STEPS = (1.0, 1.0 / 255.0)
"""Steps of other files of the scanner: its own unit of 0 to 255, and that divided by 255."""

FULL_OF_16_BITS = 65535.0
"""A reflectance of 1 in files of whole numbers of 16 bits, such as LAS."""

UNITS_OF_ONE, LEAST_OF_ONE, MOST_FOREIGN = (100.0, 255.0, FULL_OF_16_BITS), 0.9, 0.01
"""Numbers that stand for a reflectance of 1 in files of whole numbers; share of one that the
brightest point has at least; share of values that are no hundredths, at most. A file in the
scanner's own unit of 0 to 255 has 0.6 of them."""

SAMPLE = 7
"""One pair of rows in so many is looked at to tell rewritten reflectances: a prime, since files may
have values that repeat in powers of two (in one of KITTI every eighth row has none)."""

MOST_UNUSED = 0.15
"""Share of the hundredths between the 5th and the 95th percentile that no point has. All occur in
47 whole frames of KITTI; of reflectances whose root was rounded a third is missing."""

MOST_ALIKE = 0.2
"""Share of points with the reflectance of the next one in the file. Whole frames of KITTI have 0.08
to 0.14, their mean over five points 0.3, their median over five 0.5, 20 levels 0.35."""

SATURATED, FEWEST_CLIPPED, TIMES_BEFORE = 0.985, 20, 2
"""Reflectance, points, a multiple: KITTI's scanner saturates at 0.99, which each of 53 whole frames
has. So many points have the largest value where others were clipped to it, and more than have the
hundredth below it: of values that nobody clipped, the larger ones are rarer."""

MOST_AT_LARGEST = 0.025
"""Share of the points with the largest reflectance, where it is also more than have the smallest.
Dark things answer with 0: 0.12 to 0.17 of the points in 17 frames of KITTI, 0.05 to 0.09 in 16 of
simulated streets, of which 0.004 at most have the largest. In inverted ones it is the reverse."""

MOST_UNLIKE, FEWEST_PAIRS = 0.9, 1000
"""Half the mean squared difference of every other row of the file, in variances of all of them, of
reflectances that are neither the smallest nor the largest; pairs of such rows, at least. It is 1
where reflectances stand at points that they do not belong to. Rows next to each other differ more:
odd and even firings of KITTI's scanner do, by 0.85 in a clean crop that has 0.63 here."""

FEWEST_EDGES, FEWEST_ON_SURFACE = 1000, 10_000
"""Pairs of rows over an edge and on a surface, at least, that tell the contrast of reflectances."""

LEAST_CONTRAST = 2.6
"""How many times as large the mean squared difference of reflectances is over edges as on surfaces.
It is 4.0 and more in 26 frames of KITTI's drives 0005 and a, and at most 1.8 with reflectances of
other points: those that stand 200 rows and more away, or were permuted within each laser."""

SLIPS: Mapping[int, float] = MappingProxyType(
    {-16: 1.05, -4: 1.05, -2: 1.05, -1: 1.15, 1: 0.93, 2: 1.05, 4: 1.05, 16: 1.05}
)
"""By rows of the file by which reflectances may have slipped, the contrast there as a multiple of
that where they stand, at most. In clean frames it is 0.8 at most two rows away and farther. One row
away it is 1.01 and 0.83 in drives 0002 and 0005 (the next point, the one before), 1.06 and 0.88 in
their half turns; where reflectances slipped by one row it is 1.20 and 0.99 at least. The limits lie
between. In 16 frames of other drives it is 1.06 and 0.83 at most, and 1.20 and 0.94 at least."""

FEWEST_EDGES_OF_ROW = 1500
"""Pairs over an edge, at least, that tell of one row: camera crops with fewer reach 1.01."""

LEVELS, MOST_SHIFTED = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9), 0.0125
"""Shares of the points, and by how much the reflectances that so many do not exceed differ from
those of a turn beside, in the median over the shares, of all points or of those above 0. Of 157
clean frames none differs from the nearer turn by more than 0.01, nor of 375 with one thing edited.
What differs by more from both was changed as a whole."""

UNITS: Mapping[str, float] = ReadOnlyMapping({"grid": 3.0, "even": 100.0, "changed": 3800.0})
"""Points (``grid``), log likelihood ratio (``even``) and weighted points (``changed``) of a region
whose strength is 1. They only say how the kinds compare; what is rare is told by `TAIL`. Evenness
of clean simulated frames reaches 9, of KITTI's drive 0002 9.7; its unit was raised from 20 to 100
after a clean frame of drive 0005 had 38.9, the largest of 53 clean frames of KITTI, most of them of
four drives. That of changes was raised from 3000 to 3800 when means and dark returns came in, so
that the other kinds alarm at what they did."""

# fmt: off
TAIL: tuple[float, ...] = (
    0.792, 0.747, 0.734, 0.726, 0.700, 0.676, 0.651, 0.633, 0.625, 0.604,
    0.596, 0.592, 0.590, 0.582, 0.581, 0.578, 0.577, 0.555, 0.551, 0.530,
    0.521, 0.509, 0.506, 0.488, 0.487, 0.481, 0.462, 0.451, 0.448, 0.446,
    0.437, 0.435, 0.422, 0.410, 0.405, 0.397, 0.394, 0.392, 0.386, 0.383,
    0.374, 0.362, 0.360, 0.357, 0.356, 0.356, 0.353, 0.342, 0.337, 0.309,
    0.307, 0.293, 0.292, 0.285, 0.284, 0.283, 0.279, 0.279, 0.278, 0.277,
    0.274, 0.274, 0.272, 0.268, 0.265, 0.261, 0.258, 0.258, 0.256, 0.256,
    0.254, 0.254, 0.246, 0.242, 0.235, 0.234, 0.232, 0.228, 0.226, 0.225,
)
# fmt: on
TAIL_FRAMES = 1050
"""The largest strengths of clean simulated frames, in descending order, and how many frames these
are: streets 70000 to 70059 of `manip3d.simulate.street`, and 72000 to 72044, where the car weaves
and turns by up to 0.9 degrees from one turn of the scanner to the next. They are in no report;
`benchmarks/bench_alarms.py --calibrate` judges them. A new clean frame is as strong as the k-th of
n with probability k / (n + 1), so that one that is stronger than all has p = 1 / 1051: rates below
that never alarm."""

CALIBRATION = Calibration(
    "105 simulated streets from 70000 to 72044, on 45 of which the car weaves; ten frames each, "
    "with their neighbours",
    TAIL_FRAMES,
    1,
    "Patterns and noise of simulated surfaces are like those of KITTI's along a laser, not from "
    "laser to laser. Of 53 clean real frames, 20 of which raised the unit of evenness, none "
    "reaches the threshold without neighbours, nor do 33 with them: they bound the rate by 9 %.",
)


@dataclass(frozen=True, eq=False)
class ReflectanceRegion:
    """A connected set of directions with evidence of rewritten reflectances.

    Attributes
    ----------
    kind : 'grid', 'even' or 'changed'
        See `REFLECTANCE_EVIDENCE`.
    p_value : float
        Probability, at most, that a clean frame has a region as strong.
    strength : float
        For ranking; a clean frame seldom reaches 1.
    box : Box
        The tight box, turned about the vertical, around the suspected points.
    rows : (K,) int64
        Rows of the suspected points.
    """

    kind: str
    p_value: float
    strength: float
    box: Box
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ReflectanceResult(BesideTurns):
    """The result of detector V for a frame; see :func:`reflectance_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
        ``undecidable``: the frame has no reflectances, or of another unit, or all of them were
        changed.
    reason : str
        In words.
    p_value : float
        Probability, at most, that a clean frame shows as much.
    score : float
        The largest strength of a region; larger is more suspicious.
    false_alarm_rate : float
        As asked for.
    regions : tuple of ReflectanceRegion
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the strongest first.
    suspected : (K,) int64
        Rows of the points in them.
    with_turns : bool
        Whether the turns before and after were compared, too.
    calibration : Calibration
    rewritten : str
        How all reflectances differ from those of both turns; empty: they do not, or there are no
        turns beside the frame.
    """

    regions: tuple[ReflectanceRegion, ...]
    with_turns: bool
    calibration: Calibration = field(repr=False)
    rewritten: str = ""


_REASONS = {
    "grid": "reflectances are not the values that the scanner writes",
    "even": "reflectances of neighbouring firings lack the scanner's noise",
    "changed": "reflectances differ from those that the turns before and after saw there",
}


@checked
def reflectance_consistency(
    frame: LidarFrame,
    *,
    lattice: SensorLattice,
    previous: LidarFrame | None = None,
    following: LidarFrame | None = None,
    turns: TurnResult | None = None,
    false_alarm_rate: float = 0.01,
    threads: int = 0,
) -> ReflectanceResult:
    """Look for rewritten reflectances in one frame, alone and beside the turns around it.

    Parameters
    ----------
    frame : LidarFrame
        Metres, the scanner at the origin, with reflectances in [0, 1].
    lattice : SensorLattice
        Lattice of the scanner, from :func:`estimate_lattice`; only its lines are looked at.
    previous, following : LidarFrame, optional
        The frames a turn earlier and later, of the same scanner; not edited in the same way.
        Both, or neither.
    turns : TurnResult, optional
        What `turn_consistency` said of the three frames, which knows how they lie to each other;
        else they are aligned here.
    false_alarm_rate : float
        Share of clean frames that may be called tampered; in (0, 1). Rates below 1 / 1051 never
        alarm: the threshold stands on so many frames.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    ReflectanceResult

    Raises
    ------
    InputError
        A value is not finite; one neighbour without the other; a rate out of range.

    Notes
    -----
    The scanner's shot noise leaves neighbouring firings different hundredths of reflectance: what
    was painted with one value, or filled with values of its surroundings, is too even. With both
    neighbours, the reflectance of a point, less what its laser adds, is compared with what the
    turns before and after saw within 35 cm. The variance of its difference from their mean is half
    as large again as one laser's; the variance of the difference between the turns, twice.
    Patterns and moving things raise both, an edit raises only the first, or the mean of the
    difference (a test over windows of 6 lasers and 4.3 degrees, which must hold without any two of
    them as well: one laser may run along a kerb, on one side of it in this turn and on the other in
    the turns beside). Returns that are clipped, at 0 and at the largest value, are compared as
    well, unless they are in all three turns; the test is made with them and without, and the
    stronger result counts.

    Values that were changed by a little, or copied from another turn's firings, stay unseen, and
    about half of those that were exchanged within an object.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, authenticate
    >>> nothing = LidarFrame(np.zeros((0, 3), np.float32))
    >>> lattice = authenticate.kitti_lattice()
    >>> authenticate.reflectance_consistency(nothing, lattice=lattice).verdict
    'undecidable'
    """
    return reflectances_read(
        None, frame, lattice, previous=previous, following=following, turns=turns,
        false_alarm_rate=false_alarm_rate, threads=threads,
    )  # fmt: skip


def reflectances_read(
    reading: LatticeReading | None,
    frame: LidarFrame,
    lattice: SensorLattice,
    *,
    previous: LidarFrame | None,
    following: LidarFrame | None,
    turns: TurnResult | None,
    false_alarm_rate: float,
    threads: int,
    seen: Seen | None = None,
) -> ReflectanceResult:
    """Return what `reflectance_consistency` does, of a frame whose lattice may have been read.

    Parameters
    ----------
    reading : LatticeReading or None
        Where the frame's points lie on the lattice; None: it is read here.
    frame, lattice, previous, following, turns, false_alarm_rate, threads
        As for `reflectance_consistency`.
    seen : tuple of ReadingColumns or None
        Where both turns lie on the lattice, as `turns_read` said with ``turns``; None: they are
        read here.
    """
    if not 0.0 < false_alarm_rate < 1.0:
        raise InputError(f"false_alarm_rate: expected a share in (0, 1), got {false_alarm_rate!r}")
    if (previous is None) != (following is None):
        raise InputError("previous, following: expected both frames or neither, got one")
    nothing = np.empty(0, np.int64)
    frame = _in_hundredths(frame)
    if previous is not None and following is not None:
        previous, following = _in_hundredths(previous), _in_hundredths(following)
    if (why := why_not_judged(frame)) is not None:
        return ReflectanceResult(
            "undecidable", why, 1.0, 0.0, false_alarm_rate, (), nothing, False, CALIBRATION
        )
    rewritten = ""
    beside: list[NDArray[np.float32]] = []
    motions: list[NDArray[np.float64]] = []
    if previous is not None and following is not None:
        if turns is None:
            seen = None
            turns = turn_consistency(frame, previous, following, lattice=lattice, threads=threads)
        usable = turns.verdict != "undecidable"
        if usable and why_not_judged(previous) is None and why_not_judged(following) is None:
            rewritten = _shifted_as_a_whole(frame, previous, following)
        else:
            usable = False
        if usable and not rewritten:
            for other, motion in ((previous, turns.previous), (following, turns.following)):
                beside += [_points_of(other), _reflectance_of(other)]
                motions.append(np.ascontiguousarray(motion))
    found = _core.compare_reflectance(
        _points_of(frame), _reflectance_of(frame), lattice.table, beside, motions,
        threads_of(threads), None if reading is None else reading.columns,
        seen if motions and seen is not None else (),
    )  # fmt: skip
    regions = [_region(kind, value, rows, frame) for kind, value, rows in found if value > 0.0]
    off = _between_steps(np.ascontiguousarray(frame.intensity, np.float32))
    if len(off):
        regions.append(_region("grid", float(len(off)), off, frame))
    regions.sort(key=lambda region: -region.strength)
    alarming = tuple(region for region in regions if region.p_value <= false_alarm_rate)
    rows = [region.rows for region in alarming]
    verdict: Verdict = "tampered" if alarming else "undecidable" if rewritten else "no_trace"
    reason = rewritten or "reflectances are as noisy as the scanner's"
    return ReflectanceResult(
        verdict,
        _REASONS[alarming[0].kind] if alarming else reason,
        min((region.p_value for region in regions), default=1.0),
        max((region.strength for region in regions), default=0.0),
        false_alarm_rate,
        alarming,
        np.unique(np.concatenate(rows)) if rows else nothing,
        bool(motions),
        CALIBRATION,
        rewritten,
    )


def _in_hundredths(frame: LidarFrame) -> LidarFrame:
    """The frame with the hundredths of the scanner's files, where it holds them in another unit.

    Each hundredth is another number of `UNITS_OF_ONE`, rounded or cut, so that none is lost.
    """
    values = frame.intensity
    if values is None or not len(values) or not np.isfinite(values).all() or values.max() <= 1.0:
        return frame
    largest = float(values.max())
    some = values[::SAMPLE].astype(np.float64)
    for one in UNITS_OF_ONE:
        if not LEAST_OF_ONE * one <= largest <= one or _share_foreign(some, one) > MOST_FOREIGN:
            continue
        if _share_foreign(values.astype(np.float64), one) <= MOST_FOREIGN:
            hundredths = np.rint(values.astype(np.float64) * (100.0 / one)).astype(np.intp)
            whole = (np.arange(101) / 100.0).astype(np.float32)
            return frame.replace(intensity=whole[hundredths.clip(0, 100)], format=None)
    return frame


def _share_foreign(values: NDArray[np.float64], one: float) -> float:
    """Share of values that no hundredth is in a unit."""
    hundredths = np.arange(101) * (one / 100.0)
    near = np.add.outer((-1e-6, 1e-6), hundredths)  # single precision rounds to either side
    return float(np.mean(~np.isin(values, np.floor([near, near + 0.5]))))


def reflectance_p_value(strength: float) -> float:
    """Return the probability, at most, that a clean frame has a region as strong."""
    as_strong = sum(value >= strength for value in TAIL)
    return (1 + as_strong) / (1 + TAIL_FRAMES) if as_strong < len(TAIL) else 1.0


def _shifted_as_a_whole(frame: LidarFrame, previous: LidarFrame, following: LidarFrame) -> str:
    """Say how the reflectances of a frame differ as a whole from those of both turns beside it."""
    own, before, after = (_levels(each) for each in (frame, previous, following))
    if min(_apart(own, before), _apart(own, after)) <= MOST_SHIFTED:
        return ""
    shifts = np.median(own - (before + after) / 2.0, axis=1)
    shift = float(shifts[np.argmax(np.abs(shifts))])
    return f"reflectances differ as a whole from both turns beside the scan, by {shift:+.2f}"


def _levels(frame: LidarFrame) -> NDArray[np.float64]:
    """Reflectances at `LEVELS`, of all points and of those that are not dark: (2, levels).

    A shift that lifts dark returns above 0 changes the number of the others, too.
    """
    values = _reflectance_of(frame)
    both = (values, values[values > 0.0])
    return np.stack([np.asarray(np.quantile(each, LEVELS), np.float64) for each in both])


def _apart(levels: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """The median over the levels by which two frames differ; the larger of both rows."""
    return float(np.median(np.abs(levels - others), axis=1).max())


def why_rewritten(values: NDArray[np.float32]) -> str | None:
    """Say how reflectances differ everywhere from what the scanner writes; None: they do not.

    Parameters
    ----------
    values : (N,) float32
        In the order of the scanner's file.
    """
    in_hundredths = is_in_hundredths(values)
    if in_hundredths:
        values = np.clip(values, 0.0, 1.0)
    first, second = values[:-1:SAMPLE], values[1::SAMPLE]
    some = first.astype(np.float64)
    if len(some) < FEWEST_VALUES:
        return None
    noisy = (first > first.min()) & (first < first.max())
    if not noisy.any():
        return None  # none were measured, or none were kept
    unit = 1.0
    if not in_hundredths:
        steps = [step for step in OTHER_STEPS if _share_off(some, step, most=255) < MOST_OFF_STEP]
        if are_hundredths_of_16_bits(some):
            unit = FULL_OF_16_BITS
        elif steps:
            unit = 255.0 * steps[0]
        else:
            return "reflectances are no whole hundredths"
    elif (why := _why_clipped(values)) is not None:
        return why
    unused = _share_unused(some / unit)
    if unused > MOST_UNUSED:
        return f"{unused:.0%} of the hundredths of reflectance do not occur"
    alike = float(np.mean(first[noisy] == second[noisy]))
    if alike > MOST_ALIKE:
        return f"{alike:.0%} of the points have the reflectance of the next one"
    return None


def why_of_no_scene(values: NDArray[np.float32]) -> str | None:
    """Say why reflectances are not of what the points are of: constant, inverted or permuted.

    Parameters
    ----------
    values : (N,) float32
        In the order of the scanner's file, one at least.
    """
    smallest, largest = float(values.min()), float(values.max())
    if smallest == largest:
        return f"all reflectances are {largest:.3g}"
    at_end = float(np.mean(values == largest))
    if at_end > max(MOST_AT_LARGEST, float(np.mean(values == smallest))):
        return f"reflectances were inverted: {at_end:.0%} of the points have the largest"
    first, second = values[:-2:SAMPLE].astype(np.float64), values[2::SAMPLE].astype(np.float64)
    noisy = (np.minimum(first, second) > smallest) & (np.maximum(first, second) < largest)
    if np.count_nonzero(noisy) < FEWEST_PAIRS:
        return None
    first, second = first[noisy], second[noisy]
    variance = float(first.var() + second.var())
    if float(np.mean((first - second) ** 2)) <= MOST_UNLIKE * variance:
        return None
    return "reflectances of neighbouring points have nothing in common: they were permuted"


def why_of_other_points(
    values: NDArray[np.float32], points: NDArray[np.float32], reading: LatticeReading
) -> str | None:
    """Say whether reflectances are those of other points; None: nothing tells it.

    Where a laser passes from one thing to another behind it, its reflectance changes more than on
    the things themselves, unless the reflectances are not of these points.

    Parameters
    ----------
    values : (N,) float32
        In the order of the scanner's file, one at least.
    points : (N, 3) float32
        Metres, the scanner at the origin.
    reading : LatticeReading
        Where the points lie on the scanner's lattice.
    """
    edges, surfaces, contrast = _core.reflectance_contrast(
        points, np.ascontiguousarray(values, np.float32), reading.ring, reading.azimuth, [0, *SLIPS]
    )
    if edges < FEWEST_EDGES or surfaces < FEWEST_ON_SURFACE:
        return None
    here = contrast[0]
    for (rows, times), beside in zip(SLIPS.items(), contrast[1:], strict=True):
        is_told = abs(rows) > 1 or edges >= FEWEST_EDGES_OF_ROW
        if is_told and beside > max(times * here, LEAST_CONTRAST):
            return "reflectances stand some rows before or behind their points in the file"
    if here < LEAST_CONTRAST:
        return "reflectances do not change where the distance does: they are those of other points"
    return None


def _why_clipped(values: NDArray[np.float32]) -> str | None:
    """Say where hundredths end, if many points have the largest of them."""
    largest = float(values.max())
    at_end = int(np.count_nonzero(values == largest))
    before = int(np.count_nonzero(values > largest - 1.005 * STEP)) - at_end
    if largest < SATURATED and at_end >= FEWEST_CLIPPED and at_end > TIMES_BEFORE * before:
        return f"reflectances end at {largest:.3g}, which {at_end} points have: they were clipped"
    return None


def _share_unused(values: NDArray[np.float64]) -> float:
    """Share of the hundredths between the 5th and the 95th percentile that no value stands for.

    Values in finer steps than hundredths stand for all of them.
    """
    low, high = np.quantile(values, (0.05, 0.95))
    hundredths = round(float(high - low) / STEP) + 1
    different = len(np.unique(values[(values >= low) & (values <= high)]))
    return max(0.0, 1.0 - different / hundredths)


def is_in_hundredths(values: NDArray[np.float32]) -> bool:
    """Return whether reflectances are nearly all whole hundredths in [0, 1].

    Parameters
    ----------
    values : (N,) float32
    """
    some = values[::SAMPLE].astype(np.float64)
    return len(some) > 0 and _share_off(some, STEP, most=100) < MOST_OFF_STEP


def are_hundredths_of_16_bits(values: NDArray[np.float64]) -> bool:
    """Return whether reflectances are hundredths of 65535, rounded or cut to whole numbers.

    Parameters
    ----------
    values : (N,) float64
    """
    hundredth = STEP * FULL_OF_16_BITS
    hundredths = np.round(values / hundredth)
    is_off = np.abs(values - hundredths * hundredth) > 1.0
    is_off |= (values != np.round(values)) | (hundredths < 0.0) | (hundredths > 100.0)
    # Small values, such as those of 0 to 255, are all as near to 0 or to the first hundredth.
    return values.max(initial=0.0) > 255.0 and float(np.mean(is_off)) < MOST_OFF_STEP


def _share_off(values: NDArray[np.float64], step: float, most: int) -> float:
    """Share of values that are no whole numbers of a step, from 0 to the largest."""
    return float(np.mean(_is_off(values / step, most)))


def _is_off(steps: NDArray[np.float64], most: int) -> NDArray[np.bool_]:
    """Which numbers of steps are not whole, negative or above the largest."""
    return (np.abs(steps - np.round(steps)) > 1e-3) | (steps < -0.5) | (steps > most + 0.5)


def why_not_judged(frame: LidarFrame) -> str | None:
    """Why nothing can be told of a frame's reflectances; None: they can be judged."""
    values = frame.intensity
    if values is None or len(values) == 0:
        return "the frame has no reflectances"
    if not np.isfinite(values).all():
        raise InputError("frame: expected finite reflectances")
    if np.mean((values < 0.0) | (values > 1.0)) > MOST_OFF_STEP:
        return "reflectances are not in [0, 1]"
    some = values[::SAMPLE]
    if len(np.unique(some)) < FEWEST_VALUES and len(np.unique(values)) < FEWEST_VALUES:
        return f"reflectances have fewer than {FEWEST_VALUES} different values"
    return why_rewritten(values)


def _points_of(frame: LidarFrame) -> NDArray[np.float32]:
    return as_rows(frame.points, 3, np.float32, "frame")


def _reflectance_of(frame: LidarFrame) -> NDArray[np.float32]:
    """Reflectances in [0, 1]; the few that are beyond are evidence of `_between_steps`."""
    return np.clip(np.ascontiguousarray(frame.intensity, np.float32), 0.0, 1.0)


def _between_steps(reflectance: NDArray[np.float32]) -> NDArray[np.int64]:
    """Rows whose values are not the hundredths that the scanner writes, where it writes hundredths.

    KITTI's files hold the single-precision number next to each hundredth. One that is a little
    beside it was computed from another value. It only counts where most points of that hundredth
    are exact: a program that computes all hundredths in another way changes all points of one.
    """
    steps = reflectance.astype(np.float64) / STEP
    nearest = np.round(steps)
    between = _is_off(steps, most=100)
    if np.mean(between) > MOST_OFF_STEP:
        return np.empty(0, np.int64)
    hundredth = np.where(between, 0.0, nearest).astype(np.int64)
    inexact = (reflectance != (nearest / 100.0).astype(np.float32)) & ~between
    exact_points = np.bincount(hundredth[~between & ~inexact], minlength=101)
    inexact_points = np.bincount(hundredth[inexact], minlength=101)
    beside = inexact & (exact_points > inexact_points)[hundredth]
    return np.flatnonzero(between | beside)


def _region(
    kind: str, value: float, rows: NDArray[np.int32] | NDArray[np.int64], frame: LidarFrame
) -> ReflectanceRegion:
    strength = value / UNITS[kind]
    there = frame.points[rows]
    box = tight_box(largest_group(there)) if len(there) else Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return ReflectanceRegion(
        kind, reflectance_p_value(strength), strength, box, rows.astype(np.int64)
    )
