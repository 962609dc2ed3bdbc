"""Points that a scan contains more than once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice

MAX_FIRED_TWICE = 0.02
"""Largest share of points that repeat the laser's previous firing in a clean scan. A VLP-16 close
to its surroundings has 0.008, a VLP-32C 0.0006."""

MIN_WRITTEN_TWICE, MIN_BESIDE = 0.25, 0.99
"""Least share of rows that are copies, and of copies that equal the row before, if a driver wrote
both returns of each firing. Half of the firings then had one return. In simulated clouds of twelve
scanners in streets, open land and halls the first share is 0.45 to 0.49, the second one 1."""


def copies_of_earlier(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which points equal an earlier point bit for bit; points at the origin do not count.

    Parameters
    ----------
    points : (N, 3) float32
    """
    order, same = _equal_rows(points)
    copies = np.zeros(len(points), np.bool_)
    copies[order[1:][same]] = True  # the sort is stable: the first of equal rows stays first
    return copies & points.any(axis=1)


def _equal_rows(points: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """An order in which equal rows are adjacent, and which rows of it equal the previous row."""
    words = np.ascontiguousarray(points).view(np.uint32).astype(np.uint64)
    order = np.lexsort((words[:, 2], words[:, 1], words[:, 0]))
    return order, (words[order[1:]] == words[order[:-1]]).all(axis=1)


def one_of_each(
    points: NDArray[np.float32], copies: NDArray[np.bool_], reading: LatticeReading
) -> NDArray[np.bool_]:
    """Return which rows remain if each point is kept once, at its place in the scanner's order.

    The scanner writes ring after ring, each by azimuth. Of several equal points, the first row is
    kept that lies, in this order, between the nearest unrepeated points before and after it in the
    file. If no row does, the first one is kept.

    Parameters
    ----------
    points : (N, 3) float32
    copies : (N,) bool
        Result of `copies_of_earlier`.
    reading : LatticeReading
        Places of the points on the lattice.
    """
    order, same = _equal_rows(points)
    group = np.empty(len(points), np.int64)
    group[order] = np.cumsum(np.r_[False, ~same])
    is_single = ~np.isin(group, group[copies])
    place = reading.ring + reading.azimuth.astype(np.float64) / (2.0 * math.pi)
    rows = np.flatnonzero(~is_single & points.any(axis=1))
    single = np.flatnonzero(is_single & (reading.ring >= 0))
    behind = np.searchsorted(single, rows)
    around = np.r_[-math.inf, place[single], math.inf]
    in_order = (around[behind] <= place[rows]) & (place[rows] <= around[behind + 1])
    best = rows[np.lexsort((rows, ~in_order, group[rows]))]
    first = np.r_[True, np.diff(group[best]) != 0] if len(best) else np.empty(0, np.bool_)
    kept = np.ones(len(points), np.bool_)
    kept[rows] = False
    kept[best[first]] = True
    return kept


def are_fired_twice(
    points: NDArray[np.float32], copies: NDArray[np.bool_], lattice: SensorLattice
) -> bool:
    """Return whether each copy repeats, with its azimuth, the previous firing of the same laser.

    Scanners that interpolate azimuths between packets occasionally give two firings the same
    azimuth. On a wall their ranges are often equal, too.

    Parameters
    ----------
    points : (N, 3) float32
        Points in the order of the scanner.
    copies : (N,) bool
        Result of `copies_of_earlier`.
    lattice : SensorLattice
    """
    rows = np.flatnonzero(copies)
    if not lattice.is_exact or len(rows) > MAX_FIRED_TWICE * len(points):
        return False
    again = points[rows]
    found = np.zeros(len(rows), np.bool_)
    for back in range(1, 2 * len(lattice.slope) + 1):  # firings without a return may be missing
        found |= (points[np.maximum(rows - back, 0)] == again).all(axis=1)
    return bool(found.all()) and len(np.unique(again, axis=0)) == len(again)


def are_both_returns(
    points: NDArray[np.float32], copies: NDArray[np.bool_], lattice: SensorLattice
) -> bool:
    """Return whether copies are second returns of firings that had one return only.

    Some drivers write two rows for each firing, the first return and directly after it the second.

    Parameters
    ----------
    points : (N, 3) float32
        Points in the order of the scanner.
    copies : (N,) bool
        Result of `copies_of_earlier`.
    lattice : SensorLattice
    """
    rows = np.flatnonzero(copies)
    if not lattice.is_exact or len(rows) < MIN_WRITTEN_TWICE * len(points):
        return False
    beside = (points[rows - 1] == points[rows]).all(axis=1)
    return float(np.mean(beside)) >= MIN_BESIDE
