"""Copies of objects that were turned about a scanner, or mirrored, in exact clouds.

A turn about the scanner's axis by whole steps of azimuth leaves each point on the lattice. In a
copy all ranges of a laser are those of the original, one firing after another. Noise makes such
runs rare in clean clouds, even in front of a symmetrical wall. Clouds with little noise are not
judged: symmetrical places, and a tilted plane on both sides of its slope, have equal ranges there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

RUN = 5
"""Fewest successive returns of a laser with the same ranges elsewhere that are counted; they count
once for each RUN returns."""

MIN_APART = math.radians(5.0)
"""Nearer directions are not compared: a surface has similar ranges there."""

MAX_ALIKE, MAX_PAIRS = (64, 16, 4), 10_000_000
"""Ranges that a laser measured more often tell nothing, as those of a flat floor. Of the numbers,
the first is used with which there are at most MAX_PAIRS pairs of equal ranges."""

MAX_SHARE = 0.25
"""Largest number of pairs of equal ranges at one turn, as a share of the points. If there are more,
two turns were fused or the place is symmetrical, which is no edit of an object."""

MAX_MISSED, SHORT_GAP = 0.2, 3
"""Largest share of missed returns of a stretch, in which at most SHORT_GAP returns lie between
returns with equal ranges. In a copy they are few. In a perfectly symmetrical yard, noise of a third
of a range step leaves 0.25."""

MIN_DENSE = 0.7
"""Least share of the returns in runs that are in stretches without many missed ones. It is 0.98 and
more in copies. In symmetrical rooms, where noise of a third of a range step or more leaves runs by
chance, it is 0.46 at most."""

MAX_SMOOTH = 0.4
"""Largest share of returns whose range differs by at most half a step from the mean of the returns
before and after it. The share is 0.42 and more in the clouds without noise that were accused, and
0.35 at most in real ones (a PandarXT-32's)."""

SAME_FIRING, MAX_DOUBLED = 1e-4, 0.2
"""Radians between returns of one firing, and the largest share of returns that follow another one
of the same firing. In scans of both returns, or that store each point twice, fewer firings than
`RUN` would make a run."""

SAME_TURN = 2e-5
"""Radians: width of a bin of turns. Azimuths in single precision are exact to 5e-7."""

RANK = 20
"""The RANK-th largest number of runs is what a clean cloud has: several copies have several turns
with many runs."""

TURNS = 1_000_000
"""Upper bound of the number of turns and mirror images that are tested: half a turn and a whole one
in bins of `SAME_TURN`, twice each."""


class TurnedCopy(NamedTuple):
    """The turn or mirror image by which most runs of ranges agree.

    Attributes
    ----------
    runs : int
        Number of sets of `RUN` successive returns that agree.
    elsewhere : int
        The `RANK`-th largest such number of any turn or mirror image.
    places : tuple of two (K,) arrays of int
        Rows of the points at the two places; which of them is the copy is not known.
    """

    runs: int
    elsewhere: int
    places: tuple[Rows, Rows]


class _Pairs(NamedTuple):
    """Pairs of returns of a laser with the same range, at different azimuths."""

    first: Rows  # places in the order of lasers and azimuths
    second: Rows
    turn: Floats  # from the first azimuth to the second, or their sum, radians


def turned_copy(
    points: NDArray[np.float32], reading: LatticeReading, lattice: SensorLattice
) -> TurnedCopy | None:
    """Return the turn that most ranges agree with; None if there are none to compare.

    Parameters
    ----------
    points : (N, 3) float32, metres
        Points of an exact cloud.
    reading : LatticeReading
        Their places on the lattice.
    lattice : SensorLattice
    """
    x, y, z = points.astype(np.float64).T
    on = (reading.ring >= 0) & (np.abs(reading.line_error) <= lattice.tolerance)
    rows = np.flatnonzero(on & (np.abs(reading.range_error) <= lattice.tolerance))
    if not len(rows) or not lattice.range_step:
        return None
    ring = reading.ring[rows].astype(np.int64)
    azimuth = reading.azimuth[rows].astype(np.float64)
    order = np.lexsort((azimuth, ring))
    rows, ring, azimuth = rows[order], ring[order], azimuth[order]
    cosine = 1.0 / np.sqrt(1.0 + lattice.slope[ring] ** 2)
    along = np.sqrt(np.maximum(x[rows] ** 2 + y[rows] ** 2 - lattice.lateral[ring] ** 2, 0.0))
    ranges = (along + z[rows] * lattice.slope[ring]) * cosine
    steps = np.rint((ranges - lattice.range_phase[ring]) / lattice.range_step).astype(np.int64)
    if not _is_noisy(ring, azimuth, steps):
        return None
    first, second = _equal(ring, steps)
    apart = azimuth[second] - azimuth[first]  # in [0, 2 pi), as azimuths ascend within a laser
    far = np.minimum(apart, 2.0 * math.pi - apart) >= MIN_APART
    first, second, apart = first[far], second[far], apart[far]
    forward = apart <= math.pi + SAME_TURN  # half a turn is the same for all pairs
    pairs = (
        _Pairs(
            np.where(forward, first, second),
            np.where(forward, second, first),
            np.where(forward, apart, 2.0 * math.pi - apart),
        ),
        _Pairs(first, second, np.mod(azimuth[first] + azimuth[second], 2.0 * math.pi)),
    )
    # Other points may lie between those of a copy, but those of the original are successive.
    either = [*pairs, *(_Pairs(second, first, turn) for first, second, turn in pairs)]
    counted = (_runs(each, shift) for each in either for shift in (0.0, 0.5))
    found = max(counted, key=lambda runs: int(runs.number.max()))
    return _copy_of(found, rows)


def _is_noisy(ring: NDArray[np.int64], azimuth: Floats, steps: NDArray[np.int64]) -> bool:
    """Whether equal ranges tell a copy: neighbours differ by noise, and most firings have one
    return."""
    is_new = np.r_[True, (np.diff(ring) != 0) | (np.diff(azimuth) > SAME_FIRING)]
    if np.mean(~is_new) > MAX_DOUBLED:
        return False
    ring, steps = ring[is_new], steps[is_new]
    bend = np.abs(np.diff(steps, 2))[ring[2:] == ring[:-2]]  # twice the distance from the mean
    return len(bend) > 0 and bool(np.mean(bend <= 1) <= MAX_SMOOTH)


def _equal(ring: NDArray[np.int64], steps: NDArray[np.int64]) -> tuple[Rows, Rows]:
    """Pairs of returns of one laser with equal ranges; the first index is the smaller one."""
    order = np.lexsort((steps, ring))  # stable: indices ascend among equal ranges
    new = np.r_[True, (np.diff(ring[order]) != 0) | (np.diff(steps[order]) != 0)]
    group = np.cumsum(new) - 1
    size = np.bincount(group)
    number = [int((some * (some - 1) // 2).sum()) for some in (size[size <= m] for m in MAX_ALIKE)]
    most = next((m for m, n in zip(MAX_ALIKE, number, strict=True) if n <= MAX_PAIRS), 1)
    order = order[size[group] <= most]
    pairs = [(order[:0], order[:0])]
    for lag in range(1, most):
        near, far = order[:-lag], order[lag:]
        same = (ring[near] == ring[far]) & (steps[near] == steps[far])
        if not same.any():
            break
        pairs.append((near[same], far[same]))
    first, second = zip(*pairs, strict=True)
    return np.concatenate(first), np.concatenate(second)


class _Runs(NamedTuple):
    """Runs of successive returns with equal ranges, by bin of the turn."""

    first: Rows  # of all pairs
    second: Rows
    bins: NDArray[np.int64]
    is_long: NDArray[np.bool_]  # whether the run of the pair has at least `RUN` returns
    number: NDArray[np.int64]  # of sets of `RUN` returns in each bin


def _runs(pairs: _Pairs, shift: float) -> _Runs:
    """Runs in bins of turns that begin at ``shift`` of a bin, so that none is always at an edge."""
    number = round(2.0 * math.pi / SAME_TURN)
    bins = np.floor(pairs.turn * (number / (2.0 * math.pi)) + shift).astype(np.int64) % number
    order = np.lexsort((pairs.first, bins))
    first, second, bins = pairs.first[order], pairs.second[order], bins[order]
    new = np.r_[True, (np.diff(bins) != 0) | (np.diff(first) > 1)][: len(bins)]
    run = np.cumsum(new) - 1
    length = np.bincount(run)
    is_long = length[run] >= RUN if len(run) else new
    number_of = np.bincount(bins[new], length // RUN, number).astype(np.int64)
    return _Runs(first, second, bins, is_long, number_of)


def _is_dense(places: Rows) -> NDArray[np.bool_]:
    """Whether most returns around each of these ascending places have equal ranges, too."""
    gap = np.diff(places) - 1
    stretch = np.r_[0, np.cumsum(gap > SHORT_GAP)]
    missed = np.bincount(stretch[1:], np.where(gap > SHORT_GAP, 0, np.maximum(gap, 0)))
    share = missed / (missed + np.bincount(stretch))
    dense: NDArray[np.bool_] = share[stretch] <= MAX_MISSED
    return dense


def _copy_of(found: _Runs, rows: Rows) -> TurnedCopy | None:
    """The two places of the bin with most runs; None if they are no copy of an object."""
    best = int(found.number.argmax())
    same = found.bins == best
    if np.count_nonzero(same) > MAX_SHARE * len(rows):
        return None
    if not same.any():
        return None
    is_long = found.is_long[same]
    dense = is_long & _is_dense(found.first[same])
    if np.count_nonzero(dense) < MIN_DENSE * np.count_nonzero(is_long):
        return None
    first, second = found.first[same][dense], found.second[same][dense]
    if not len(first):
        return None
    length = np.bincount(np.cumsum(np.r_[0, np.diff(first) > 1]))
    elsewhere = int(np.partition(found.number, -RANK)[-RANK])
    places = np.unique(rows[first]), np.unique(rows[second])
    return TurnedCopy(int((length // RUN).sum()), elsewhere, places)
