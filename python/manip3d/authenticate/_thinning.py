"""Find points that were left out of a terrestrial scan, from the fill of its angular grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._angular_cells import angular_cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._occlusion import AngularGrid

SAME_SURFACE = 1.1
"""Four cells beside a cell see the same surface if the largest of their ranges is less than
SAME_SURFACE times the smallest."""

MAX_EMPTY = 0.1
"""Points were left out if more than this share of the cells is empty, of those whose four
neighbours see the same near surface. The share is at most 0.0002 in 15 simulated scans of five
scenes for calibration (steps of 0.12 to 0.3 degrees, angles with an error of up to a tenth of a
step), and at most 0.051 if these lose single returns with a probability that rises with the square
of the range to 0.8 at 13 m. The limit is twice that."""

MIN_AMID = 0.3
"""Points were left out, too, if less than this share of the near occupied cells has four neighbours
on the same surface. The share is at least 0.85 in the scans that chose MAX_EMPTY, and at most 0.13
in random halves of them and of others."""


def why_thinned(points: NDArray[np.float32], grid: AngularGrid) -> str | None:
    """Return in words why points seem to be left out of a terrestrial scan; None: they do not.

    Only the nearer half of the scan counts, because far and dark surfaces lose single returns.

    Parameters
    ----------
    points : (N, 3) float32
        Points with the scanner at the origin.
    grid : AngularGrid
        Angular grid of the scan.
    """
    nearest = _nearest_of_cells(points, grid)
    if nearest.size == 0:
        return None
    here = nearest[1:-1, 1:-1]
    beside = (nearest[2:, 1:-1], nearest[:-2, 1:-1], nearest[1:-1, 2:], nearest[1:-1, :-2])
    low = np.minimum(np.minimum(beside[0], beside[1]), np.minimum(beside[2], beside[3]))
    high = np.maximum(np.maximum(beside[0], beside[1]), np.maximum(beside[2], beside[3]))
    seen = np.isfinite(here)
    half = np.median(here[seen])
    amid = (high < SAME_SURFACE * low) & (low <= half)  # infinite: a neighbour is empty
    among = int(np.count_nonzero(amid))
    empty = int(np.count_nonzero(amid & ~seen))
    if empty > MAX_EMPTY * among:
        return f"{empty / among:.0%} of the directions amid near surfaces have no return"
    near = int(np.count_nonzero(seen & (here <= half)))
    if among - empty < MIN_AMID * near:
        share = (among - empty) / near
        return f"{share:.0%} of the near points have neighbours on all sides in the angular grid"
    return None


def _nearest_of_cells(points: NDArray[np.float32], grid: AngularGrid) -> NDArray[np.float32]:
    """Least range in each cell of the occupied rows, infinite in empty ones, with a border.

    Columns continue on the other side of the turn.
    """
    xyz = points.astype(np.float64)
    away = xyz[(xyz != 0.0).any(axis=1)]
    if len(away) == 0:
        return np.empty((0, 0), np.float32)
    row, column, distance, columns = angular_cells(away, grid)
    nearest = np.full((int(row.max()) + 3, columns + 2), np.inf, np.float32)
    np.minimum.at(nearest, (row + 1, column + 1), distance.astype(np.float32))
    nearest[:, 0], nearest[:, -1] = nearest[:, -2], nearest[:, 1]
    return nearest
