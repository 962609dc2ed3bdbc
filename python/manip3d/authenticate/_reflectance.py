"""Detector V: reflectances that contradict the scanner's noise or the neighbouring turns."""

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
from manip3d._util.reprs import short_repr
from manip3d.authenticate._generic import largest_group, tight_box
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._turns import TurnResult, turn_consistency
from manip3d.authenticate._verdict import (
    BesideTurns,
    Calibration,
    Verdict,
    tail_p_value,
    verdict_repr,
)
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading
    from manip3d.authenticate._turns import Seen

REFLECTANCE_EVIDENCE = ("grid", "even", "changed")
"""Kinds of evidence. ``grid``: values are not hundredths like those of the rest of the frame.
``even``: neighbours along a ring have the same value, without the scanner's shot noise.
``changed``: the neighbouring turns agree on a value that the frame does not have."""

STEP = 0.01
"""Step of the reflectances of KITTI's scanner."""

MAX_OFF_STEP = 0.2
"""Largest share of values off the hundredths if the scanner writes hundredths."""

MIN_VALUES = 16
"""Fewest different reflectances of a frame; with fewer, no noise is visible."""

OTHER_STEPS = (1.0, 1.0 / 255.0)
"""Steps of reflectances in other files of the scanner: its own unit from 0 to 255, and this unit
divided by 255."""

FULL_OF_16_BITS = 65535.0
"""Value of a reflectance of 1 in files with 16-bit integers, such as LAS."""

UNITS_OF_ONE, MIN_OF_ONE, MAX_FOREIGN = (100.0, 255.0, FULL_OF_16_BITS), 0.9, 0.01
"""UNITS_OF_ONE: values of a reflectance of 1 in files with integers. MIN_OF_ONE: least value of
the brightest point, as a share of one of these. MAX_FOREIGN: largest share of values that are no
hundredths; in a file in the scanner's own unit of 0 to 255 it is 0.6."""

SAMPLE = 7
"""One pair of rows in this many is tested for rewritten reflectances. It is a prime, because values
in files may repeat with a power of two (in one file of KITTI every eighth row has none)."""

MAX_UNUSED = 0.15
"""Largest share of hundredths between the 5th and the 95th percentile that no point has. All of
them occur in 47 whole frames of KITTI; a third is missing if square roots of reflectances were
rounded."""

MAX_ALIKE = 0.2
"""Largest share of points with the same reflectance as the next point in the file. It is 0.08 to
0.14 in whole frames of KITTI, 0.3 after a mean over five points, 0.5 after a median over five
points, and 0.35 after rounding to 20 levels."""

SATURATED, MIN_CLIPPED, TIMES_BEFORE = 0.985, 20, 2
"""KITTI's scanner saturates at 0.99, which each of 53 whole frames reaches. Reflectances were
clipped if the largest is below SATURATED, if at least MIN_CLIPPED points have it, and if these
are more than TIMES_BEFORE times the points with the hundredth below it. Without clipping, larger
values are rarer."""

MAX_AT_LARGEST = 0.025
"""Reflectances were inverted if more than this share of the points has the largest value, and more
than have the smallest. Dark surfaces have 0: 0.12 to 0.17 of the points in 17 frames of KITTI, 0.05
to 0.09 in 16 frames of simulated streets, while at most 0.004 have the largest value."""

MAX_UNLIKE, MIN_PAIRS = 0.9, 1000
"""Reflectances were permuted if half the mean squared difference of rows two apart, divided by the
variance of all, exceeds MAX_UNLIKE; reflectances that are the smallest or the largest are
excluded, and MIN_PAIRS pairs are needed. The ratio is 1 for permuted reflectances. Adjacent rows
are not used, because odd and even firings of KITTI's scanner differ: their ratio is 0.85 in a clean
crop in which that of rows two apart is 0.63."""

MIN_EDGES, MIN_ON_SURFACE = 1000, 10_000
"""Fewest pairs of rows across an edge, and fewest on a surface, for the contrast of
reflectances."""

MIN_CONTRAST = 2.6
"""Least contrast: mean squared difference of reflectances across edges, divided by that on
surfaces. It is at least 4.0 in 26 frames of KITTI's drives 0005 and a, and at most 1.8 with
reflectances of other points: of points at least 200 rows away, or permuted within each laser."""

SLIPS: Mapping[int, float] = MappingProxyType(
    {-16: 1.05, -4: 1.05, -2: 1.05, -1: 1.15, 1: 0.93, 2: 1.05, 4: 1.05, 16: 1.05}
)
"""Limits for detecting reflectances that were shifted by a number of rows of the file. Without a
shift, the contrast of points with the reflectances of rows that far away is at most this multiple
of the contrast with their own reflectances. In clean frames the multiple is at most 0.8 two or more
rows away. One row away (next row, previous row) it is at most 1.01 and 0.83 in drives 0002 and
0005, and 1.06 and 0.88 in their half turns; if reflectances were shifted by one row it is at least
1.20 and 0.99. The limits lie between. In 16 frames of other drives it is at most 1.06 and 0.83, and
at least 1.20 and 0.94."""

MIN_EDGES_OF_ROW = 1500
"""Fewest pairs across an edge for detecting a shift by one row: the multiple reaches 1.01 in camera
crops with fewer."""

LEVELS, MAX_SHIFTED = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9), 0.0125
"""LEVELS: quantiles of the reflectances, of all points and of those above 0. MAX_SHIFTED: largest
difference of a frame's quantiles from those of a neighbouring turn, as a median over the quantiles;
if it is larger for both neighbours, all reflectances were changed. None of 157 clean frames, and
none of 375 frames with one edited object, differs from the more similar neighbour by more than
0.01."""

UNITS: Mapping[str, float] = ReadOnlyMapping({"grid": 3.0, "even": 100.0, "changed": 3800.0})
"""Number of points (``grid``), log likelihood ratio (``even``) and weighted number of points
(``changed``) of a region whose strength is 1. They only relate the kinds to each other; `TAIL`
states how rare a strength is. Evenness reaches 9 in clean simulated frames, 9.7 in KITTI's drive
0002, and 38.9 in a clean frame of drive 0005, the largest of 53 clean frames of KITTI, most of them
of four drives; that frame raised its unit from 20 to 100. The unit of changes is 3800 instead of
3000 since means and dark returns are compared, so that the other kinds keep their thresholds."""

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
"""The largest strengths of clean simulated frames, in descending order, and the number of frames:
streets 70000 to 70059 of `manip3d.simulate.street`, and 72000 to 72044, where the car weaves and
turns by up to 0.9 degrees from one turn of the scanner to the next. Reported rates are measured on
other streets; `benchmarks/bench_alarms.py --calibrate` computes the strengths. A new clean frame is
as strong as the k-th of n with probability k / (n + 1). A frame that is stronger than all has p = 1
/ 1051, so that smaller false-alarm rates never accuse."""

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
        Upper bound of the probability that a clean frame has a region as strong.
    strength : float
        For ranking; a clean frame seldom reaches 1.
    box : Box
        The smallest box, rotated about the vertical, around the suspected points.
    rows : (K,) int64
        Rows of the suspected points.
    """

    kind: str
    p_value: float
    strength: float
    box: Box
    rows: NDArray[np.int64]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class ReflectanceResult(BesideTurns):
    """The result of detector V for a frame; see :func:`reflectance_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
        ``undecidable``: the frame has no reflectances, they have another unit, or all of them were
        changed.
    reason : str
        Reason of the verdict in words.
    p_value : float
        Upper bound of the probability that a clean frame shows as much evidence.
    score : float
        Largest strength of a region; larger is more suspicious.
    false_alarm_rate : float
        The argument of this name.
    regions : tuple of ReflectanceRegion
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the strongest first.
    suspected : (K,) int64
        Rows of the points in these regions.
    with_turns : bool
        Whether the neighbouring turns were compared as well.
    calibration : Calibration
        Clean frames on which the thresholds were chosen.
    rewritten : str
        Change of all reflectances relative to both neighbouring turns; empty: there is none, or
        there are no neighbouring turns.
    """

    regions: tuple[ReflectanceRegion, ...]
    with_turns: bool
    calibration: Calibration = field(repr=False)
    rewritten: str = ""

    __repr__ = verdict_repr


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
    """Find rewritten reflectances in one frame, alone and in comparison with neighbouring turns.

    Parameters
    ----------
    frame : LidarFrame
        Frame in metres, with the scanner at the origin and reflectances in [0, 1].
    lattice : SensorLattice
        Lattice of the scanner, from :func:`estimate_lattice`; only its lines are used.
    previous, following : LidarFrame, optional
        Frames of the same scanner one turn earlier and later, which must not be edited in the same
        way. Give both or neither.
    turns : TurnResult, optional
        Result of `turn_consistency` for the three frames, whose alignment is used; default: they
        are aligned here.
    false_alarm_rate : float
        Largest share of clean frames that may be called tampered; in (0, 1). Rates below 1 / 1051
        never accuse, because the threshold was chosen on 1050 frames.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    ReflectanceResult

    Raises
    ------
    InputError
        A value is not finite; only one neighbour is given; the rate is out of range.

    Notes
    -----
    The scanner's shot noise gives neighbouring firings different hundredths of reflectance: an area
    with one value, or filled with values of its surroundings, is too even. With both neighbours,
    the reflectance of a point, minus the bias of its laser, is compared with that of points within
    35 cm in the neighbouring turns. If one laser's values have the variance s^2, the difference of
    a point from the mean of the two turns has 1.5 s^2, and the difference between the turns 2 s^2.
    Patterns and moving objects raise both variances; an edit raises only the first, or the mean of
    the difference. This is tested over windows of 6 lasers and 4.3 degrees, and must also hold
    without any two of the lasers, because one laser may run along a kerb, on one side of it in this
    turn and on the other side in the neighbouring turns. Clipped returns, at 0 and at the largest
    value, are compared as well, unless they are clipped in all three turns. The test is made with
    and without them, and the stronger result counts.

    Small changes of values, and values copied from the firings of another turn, are not found, nor
    are about half of the exchanges within an object.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from manip3d import authenticate, forge, simulate
    >>> frame = simulate.courtyard()
    >>> lattice = authenticate.kitti_lattice()
    >>> authenticate.reflectance_consistency(frame, lattice=lattice).verdict
    'no_trace'
    >>> painted = frame.intensity.copy()
    >>> painted[forge.nearest_object(frame).contains(frame.points)] = 0.5
    >>> forged = replace(frame, intensity=painted)
    >>> found = authenticate.reflectance_consistency(forged, lattice=lattice)
    >>> found.verdict, found.regions[0].kind
    ('tampered', 'even')
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
    """Return the result of `reflectance_consistency`, given readings that were computed before.

    Parameters
    ----------
    reading : LatticeReading or None
        Places of the frame's points on the lattice; None: they are computed here.
    frame, lattice, previous, following, turns, false_alarm_rate, threads
        Same as in `reflectance_consistency`.
    seen : tuple of ReadingColumns or None
        Places of both neighbouring turns on the lattice, as `turns_read` returned them with
        ``turns``; None: they are computed here.
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
    traces = [_Trace(kind, value, rows) for kind, value, rows in found if value > 0.0]
    off = _between_steps(np.ascontiguousarray(frame.intensity, np.float32))
    if len(off):
        traces.append(_Trace("grid", float(len(off)), off))
    traces.sort(key=lambda trace: -trace.strength)
    alarming = tuple(_region(trace, frame) for trace in traces if trace.p_value <= false_alarm_rate)
    rows = [region.rows for region in alarming]
    verdict: Verdict = "tampered" if alarming else "undecidable" if rewritten else "no_trace"
    reason = rewritten or "reflectances are as noisy as the scanner's"
    return ReflectanceResult(
        verdict,
        _REASONS[alarming[0].kind] if alarming else reason,
        min((trace.p_value for trace in traces), default=1.0),
        max((trace.strength for trace in traces), default=0.0),
        false_alarm_rate,
        alarming,
        np.unique(np.concatenate(rows)) if rows else nothing,
        bool(motions),
        CALIBRATION,
        rewritten,
    )


def _in_hundredths(frame: LidarFrame) -> LidarFrame:
    """The frame with reflectances in hundredths, if it has them in another unit of integers.

    In each of `UNITS_OF_ONE`, rounded or truncated, different hundredths are different numbers, so
    that the conversion is exact.
    """
    values = frame.intensity
    if values is None or not len(values) or not np.isfinite(values).all() or values.max() <= 1.0:
        return frame
    largest = float(values.max())
    some = values[::SAMPLE].astype(np.float64)
    for one in UNITS_OF_ONE:
        if not MIN_OF_ONE * one <= largest <= one or _share_foreign(some, one) > MAX_FOREIGN:
            continue
        if _share_foreign(values.astype(np.float64), one) <= MAX_FOREIGN:
            hundredths = np.rint(values.astype(np.float64) * (100.0 / one)).astype(np.intp)
            whole = (np.arange(101) / 100.0).astype(np.float32)
            return frame.replace(intensity=whole[hundredths.clip(0, 100)], format=None)
    return frame


def _share_foreign(values: NDArray[np.float64], one: float) -> float:
    """Share of values that are no hundredths in a unit, rounded or truncated."""
    hundredths = np.arange(101) * (one / 100.0)
    near = np.add.outer((-1e-6, 1e-6), hundredths)  # errors of single precision
    return float(np.mean(~np.isin(values, np.floor([near, near + 0.5]))))


def reflectance_p_value(strength: float) -> float:
    """Return an upper bound of the probability that a clean frame has a region as strong."""
    return tail_p_value(strength, TAIL, TAIL_FRAMES)


def _shifted_as_a_whole(frame: LidarFrame, previous: LidarFrame, following: LidarFrame) -> str:
    """Return in words how all reflectances differ from both neighbours; empty: they do not."""
    own, before, after = (_levels(each) for each in (frame, previous, following))
    if min(_apart(own, before), _apart(own, after)) <= MAX_SHIFTED:
        return ""
    shifts = np.median(own - (before + after) / 2.0, axis=1)
    shift = float(shifts[np.argmax(np.abs(shifts))])
    return f"reflectances differ as a whole from both turns beside the scan, by {shift:+.2f}"


def _levels(frame: LidarFrame) -> NDArray[np.float64]:
    """Quantiles of the reflectances at `LEVELS`, of all points and of those above 0: (2, levels).

    Both are needed because a shift that lifts dark returns above 0 adds them to the second kind.
    """
    values = np.sort(_reflectance_of(frame))  # quantiles of sorted values take less time
    both = (values, values[np.searchsorted(values, 0.0, side="right") :])
    return np.stack([np.asarray(np.quantile(each, LEVELS), np.float64) for each in both])


def _apart(levels: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Median over the levels of the difference of two frames; the larger one of both rows."""
    return float(np.median(np.abs(levels - others), axis=1).max())


def why_rewritten(values: NDArray[np.float32]) -> str | None:
    """Return in words how all reflectances differ from the scanner's; None if they do not.

    Parameters
    ----------
    values : (N,) float32
        Reflectances in the order of the scanner's file.
    """
    in_hundredths = is_in_hundredths(values)
    if in_hundredths:
        values = np.clip(values, 0.0, 1.0)
    first, second = values[:-1:SAMPLE], values[1::SAMPLE]
    some = first.astype(np.float64)
    if len(some) < MIN_VALUES:
        return None
    noisy = (first > first.min()) & (first < first.max())
    if not noisy.any():
        return None  # no reflectances are present
    unit = 1.0
    if not in_hundredths:
        steps = [step for step in OTHER_STEPS if _share_off(some, step, most=255) < MAX_OFF_STEP]
        if are_hundredths_of_16_bits(some):
            unit = FULL_OF_16_BITS
        elif steps:
            unit = 255.0 * steps[0]
        else:
            return "reflectances are no whole hundredths"
    elif (why := _why_clipped(values)) is not None:
        return why
    unused = _share_unused(some / unit)
    if unused > MAX_UNUSED:
        return f"{unused:.0%} of the hundredths of reflectance do not occur"
    alike = float(np.mean(first[noisy] == second[noisy]))
    if alike > MAX_ALIKE:
        return f"{alike:.0%} of the points have the reflectance of the next one"
    return None


def why_of_no_scene(values: NDArray[np.float32]) -> str | None:
    """Return in words that reflectances are constant, inverted or permuted; None if they are not.

    Parameters
    ----------
    values : (N,) float32
        Reflectances in the order of the scanner's file, at least one.
    """
    smallest, largest = float(values.min()), float(values.max())
    if smallest == largest:
        return f"all reflectances are {largest:.3g}"
    at_end = float(np.mean(values == largest))
    if at_end > max(MAX_AT_LARGEST, float(np.mean(values == smallest))):
        return f"reflectances were inverted: {at_end:.0%} of the points have the largest"
    first, second = values[:-2:SAMPLE].astype(np.float64), values[2::SAMPLE].astype(np.float64)
    noisy = (np.minimum(first, second) > smallest) & (np.maximum(first, second) < largest)
    if np.count_nonzero(noisy) < MIN_PAIRS:
        return None
    first, second = first[noisy], second[noisy]
    variance = float(first.var() + second.var())
    if float(np.mean((first - second) ** 2)) <= MAX_UNLIKE * variance:
        return None
    return "reflectances of neighbouring points have nothing in common: they were permuted"


def why_of_other_points(
    values: NDArray[np.float32], points: NDArray[np.float32], reading: LatticeReading
) -> str | None:
    """Return in words that reflectances belong to other points; None if nothing shows it.

    Where a laser passes from one object to another one behind it, its reflectance changes more than
    on the objects themselves, unless the reflectances belong to other points.

    Parameters
    ----------
    values : (N,) float32
        Reflectances in the order of the scanner's file, at least one.
    points : (N, 3) float32
        Points in metres, with the scanner at the origin.
    reading : LatticeReading
        Places of the points on the scanner's lattice.
    """
    edges, surfaces, contrast = _core.reflectance_contrast(
        points, np.ascontiguousarray(values, np.float32), reading.ring, reading.azimuth, [0, *SLIPS]
    )
    if edges < MIN_EDGES or surfaces < MIN_ON_SURFACE:
        return None
    here = contrast[0]
    for (rows, times), beside in zip(SLIPS.items(), contrast[1:], strict=True):
        is_told = abs(rows) > 1 or edges >= MIN_EDGES_OF_ROW
        if is_told and beside > max(times * here, MIN_CONTRAST):
            return "reflectances stand some rows before or behind their points in the file"
    if here < MIN_CONTRAST:
        return "reflectances do not change where the distance does: they are those of other points"
    return None


def _why_clipped(values: NDArray[np.float32]) -> str | None:
    """Return in words that reflectances were clipped; None if they were not."""
    largest = float(values.max())
    at_end = int(np.count_nonzero(values == largest))
    before = int(np.count_nonzero(values > largest - 1.005 * STEP)) - at_end
    if largest < SATURATED and at_end >= MIN_CLIPPED and at_end > TIMES_BEFORE * before:
        return f"reflectances end at {largest:.3g}, which {at_end} points have: they were clipped"
    return None


def _share_unused(values: NDArray[np.float64]) -> float:
    """Share of the hundredths between the 5th and the 95th percentile that no value has.

    It is 0 for values in finer steps.
    """
    low, high = np.quantile(values, (0.05, 0.95))
    hundredths = round(float(high - low) / STEP) + 1
    occurring = np.unique(values)
    different = np.count_nonzero((occurring >= low) & (occurring <= high))
    return max(0.0, 1.0 - different / hundredths)


def is_in_hundredths(values: NDArray[np.float32]) -> bool:
    """Return whether reflectances are nearly all whole hundredths in [0, 1].

    Parameters
    ----------
    values : (N,) float32
        Reflectances.
    """
    some = values[::SAMPLE].astype(np.float64)
    return len(some) > 0 and _share_off(some, STEP, most=100) < MAX_OFF_STEP


def are_hundredths_of_16_bits(values: NDArray[np.float64]) -> bool:
    """Return whether reflectances are hundredths of 65535, rounded or truncated to integers.

    Parameters
    ----------
    values : (N,) float64
        Reflectances.
    """
    hundredth = STEP * FULL_OF_16_BITS
    hundredths = np.round(values / hundredth)
    is_off = np.abs(values - hundredths * hundredth) > 1.0
    is_off |= (values != np.round(values)) | (hundredths < 0.0) | (hundredths > 100.0)
    # In smaller units, such as 0 to 255, all values are near 0 or the first hundredth.
    return values.max(initial=0.0) > 255.0 and float(np.mean(is_off)) < MAX_OFF_STEP


def _share_off(values: NDArray[np.float64], step: float, most: int) -> float:
    """Share of values that are not whole multiples of a step, from 0 to ``most`` steps."""
    return float(np.mean(_is_off(values / step, most)))


def _is_off(steps: NDArray[np.float64], most: int) -> NDArray[np.bool_]:
    """Mask of numbers of steps that are not whole, are negative, or exceed ``most``."""
    return (np.abs(steps - np.round(steps)) > 1e-3) | (steps < -0.5) | (steps > most + 0.5)


def why_not_judged(frame: LidarFrame) -> str | None:
    """The reason why a frame's reflectances cannot be judged; None: they can."""
    values = frame.intensity
    if values is None or len(values) == 0:
        return "the frame has no reflectances"
    if not np.isfinite(values).all():
        raise InputError("frame: expected finite reflectances")
    if np.mean((values < 0.0) | (values > 1.0)) > MAX_OFF_STEP:
        return "reflectances are not in [0, 1]"
    some = values[::SAMPLE]
    if len(np.unique(some)) < MIN_VALUES and len(np.unique(values)) < MIN_VALUES:
        return f"reflectances have fewer than {MIN_VALUES} different values"
    return why_rewritten(values)


def _points_of(frame: LidarFrame) -> NDArray[np.float32]:
    return as_rows(frame.points, 3, np.float32, "frame")


def _reflectance_of(frame: LidarFrame) -> NDArray[np.float32]:
    """Reflectances, clipped to [0, 1]; `_between_steps` reports the few that are outside."""
    return np.clip(np.ascontiguousarray(frame.intensity, np.float32), 0.0, 1.0)


def _between_steps(reflectance: NDArray[np.float32]) -> NDArray[np.int64]:
    """Rows whose values are no hundredths, if the scanner writes hundredths.

    KITTI's files have the single-precision number nearest to each hundredth. A number slightly
    beside it was computed from another value. It only counts if most points of that hundredth are
    exact, because a program that computes hundredths differently changes all points with one.
    """
    steps = reflectance.astype(np.float64) / STEP
    nearest = np.round(steps)
    are_exact = reflectance == (nearest / 100.0).astype(np.float32)
    if are_exact.all() and nearest.min(initial=0.0) >= 0.0 and nearest.max(initial=0.0) <= 100.0:
        return np.empty(0, np.int64)
    between = _is_off(steps, most=100)
    if np.mean(between) > MAX_OFF_STEP:
        return np.empty(0, np.int64)
    hundredth = np.where(between, 0.0, nearest).astype(np.int64)
    inexact = ~are_exact & ~between
    exact_points = np.bincount(hundredth[~between & ~inexact], minlength=101)
    inexact_points = np.bincount(hundredth[inexact], minlength=101)
    beside = inexact & (exact_points > inexact_points)[hundredth]
    return np.flatnonzero(between | beside)


class _Trace:
    """Evidence of one kind in a set of points, whether or not it is strong enough for an alarm."""

    def __init__(
        self, kind: str, value: float, rows: NDArray[np.int32] | NDArray[np.int64]
    ) -> None:
        self.kind = kind
        self.strength = value / UNITS[kind]
        self.p_value = reflectance_p_value(self.strength)
        self.rows = rows


def _region(trace: _Trace, frame: LidarFrame) -> ReflectanceRegion:
    there = frame.points[trace.rows]
    box = tight_box(largest_group(there)) if len(there) else Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return ReflectanceRegion(
        trace.kind, trace.p_value, trace.strength, box, trace.rows.astype(np.int64)
    )
