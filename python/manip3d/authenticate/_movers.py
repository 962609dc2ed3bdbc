"""Distinguish objects that drive through a place between two turns from objects pasted there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Points = NDArray[np.floating]

FARTHEST_MOVE = 4.0
"""Metres: largest motion between two turns, 144 km/h in 0.1 s; also the limit of the alignment."""

NEAREST_MOVE = 0.5
"""Metres: an object that moved less still covers its place in the neighbouring turns."""

MIN_MET = 0.9
"""Least share of the points that must meet the moved object in both turns."""

_CELL = 0.25  # metres
_MAX_POINTS = 200  # points of an object that are looked up, evenly chosen: more take longer
_MARGIN = 2  # cells around the reachable volume


def passes_by(points: Points, previous: Points, following: Points) -> bool:
    """Return whether an object moved evenly through a place from the previous to the next turn.

    Parameters
    ----------
    points : (K, 3), metres
        Points of a frame at a place that was empty in the neighbouring turns.
    previous, following : (N, 3), metres
        Neighbouring turns in the frame's coordinates.

    Notes
    -----
    Surfaces that only one of the neighbouring turns shows have moved or come into view. If the
    points meet such surfaces in the previous turn when they are shifted back by some vector along
    the ground, and in the following turn when they are shifted forwards by the same vector, an
    object of their shape drove through the place at constant speed. An object that was pasted into
    a single frame has no such counterparts.
    """
    if not len(points):
        return False
    low = points.min(axis=0) - FARTHEST_MOVE - _MARGIN * _CELL
    high = points.max(axis=0) + FARTHEST_MOVE + _MARGIN * _CELL
    low[2], high[2] = points[:, 2].min() - _MARGIN * _CELL, points[:, 2].max() + _MARGIN * _CELL
    shape = tuple(int(n) for n in np.ceil((high - low) / _CELL).astype(int) + 1)
    cells = []
    for turn in (previous, following):
        near = turn[np.all((turn >= low) & (turn < high), axis=1)]
        cells.append(_cells(near, low))
    seen = [_spread(_occupied(each, shape)) for each in cells]
    moved = [
        _spread(_occupied(each[~other[tuple(each.T)]], shape))
        for each, other in zip(cells, seen[::-1], strict=True)
    ]
    some = _cells(points[:: -(-len(points) // _MAX_POINTS)], low)
    back = _met(moved[0], some, -1)
    on = _met(moved[1], some, 1)
    return bool(np.minimum(back, on).max() >= MIN_MET)


def _cells(points: Points, low: Points) -> NDArray[np.int64]:
    return np.floor((points - low) / _CELL).astype(np.int64)


def _occupied(cells: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    grid = np.zeros(shape, bool)
    grid[tuple(cells.T)] = True
    return grid


def _spread(grid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Dilate by one cell in each direction, because positions are known to about a cell."""
    for axis in range(3):
        first, last = [slice(None)] * 3, [slice(None)] * 3
        first[axis], last[axis] = slice(1, None), slice(None, -1)
        wide = grid.copy()
        wide[tuple(first)] |= grid[tuple(last)]
        wide[tuple(last)] |= grid[tuple(first)]
        grid = wide
    return grid


def _met(grid: NDArray[np.bool_], cells: NDArray[np.int64], way: int) -> NDArray[np.float64]:
    """Share of the cells that are occupied in ``grid`` after each shift along the ground."""
    most = int(FARTHEST_MOVE / _CELL)
    steps = np.arange(-most, most + 1)
    x, y = (each.ravel() for each in np.meshgrid(steps, steps, indexing="ij"))
    length = np.hypot(x, y) * _CELL
    kept = (length >= NEAREST_MOVE) & (length <= FARTHEST_MOVE)
    x, y = x[kept], y[kept]
    met = grid[cells[:, :1] + way * x, cells[:, 1:2] + way * y, cells[:, 2:]]
    shares: NDArray[np.float64] = met.mean(axis=0)
    return shares
