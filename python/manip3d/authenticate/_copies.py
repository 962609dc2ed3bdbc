"""Points that a file has twice."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice

MOST_FIRED_TWICE = 0.02
"""Share of points that repeat the one of the firing before. A VLP-16 close to its surroundings has
0.008, a VLP-32C 0.0006."""


def copies_of_earlier(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which points repeat an earlier one to the bit; points at the origin do not.

    Parameters
    ----------
    points : (N, 3) float32
    """
    order, same = _equal_rows(points)
    copies = np.zeros(len(points), np.bool_)
    copies[order[1:][same]] = True  # a stable sort leaves the first of equal rows in front
    return copies & points.any(axis=1)


def _equal_rows(points: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """An order in which equal rows follow each other, and which rows equal the one before."""
    words = np.ascontiguousarray(points).view(np.uint32).astype(np.uint64)
    order = np.lexsort((words[:, 2], words[:, 1], words[:, 0]))
    return order, (words[order[1:]] == words[order[:-1]]).all(axis=1)


def one_of_each(
    points: NDArray[np.float32], copies: NDArray[np.bool_], reading: LatticeReading
) -> NDArray[np.bool_]:
    """Return which rows are left if each point is kept once: where it stands in the file's order.

    That is the first of its places between rows, of points that are not repeated, before and behind
    which the scanner writes it; else the first of all its places.

    Parameters
    ----------
    points : (N, 3) float32
    copies : (N,) bool
        As for `copies_of_earlier`.
    reading : LatticeReading
        Where the points lie on the lattice.
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
    """Return whether all copies are of the same laser's firing before, with the azimuth it had.

    Scanners whose azimuths are interpolated between packets say the same one of two firings now and
    then, and a wall is at the same range in many.

    Parameters
    ----------
    points : (N, 3) float32
        In the order of the scanner.
    copies : (N,) bool
        As for `copies_of_earlier`.
    lattice : SensorLattice
    """
    rows = np.flatnonzero(copies)
    if not lattice.is_exact or len(rows) > MOST_FIRED_TWICE * len(points):
        return False
    again = points[rows]
    found = np.zeros(len(rows), np.bool_)
    for back in range(1, 2 * len(lattice.slope) + 1):  # rows without a return may be left out
        found |= (points[np.maximum(rows - back, 0)] == again).all(axis=1)
    return bool(found.all()) and len(np.unique(again, axis=0)) == len(again)
