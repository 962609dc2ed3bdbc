"""Tell later echoes of pulses, which a file does not number, from points behind other points."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._angular_cells import angular_cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._occlusion import AngularGrid

BESIDE = 0.25
"""A range is that of a surface beside the cell if it differs by less than this share of the gap
between the cell's two points."""

AROUND = 2
"""Number of cells to each side in which these surfaces are looked for."""

MIN_ECHOES = 0.6
"""Least share of a region's points in front that look like first echoes. It is at least 0.82 in the
13 regions of two simulated scans with second echoes, and at most 0.35 in 17 regions of cars and
persons, as dense as the scan or sparser, and of points behind walls that were pasted into them."""

SECTORS, MIN_SECTORS = 72, 6
"""Echoes come from edges all around: they must be in at least MIN_SECTORS of SECTORS sectors of the
horizon. In the two scans they are in 11."""


class Cells(NamedTuple):
    """Cells of an angular grid with the ranges of their points.

    Attributes
    ----------
    of_point : (N,) int64
        Flat index of each point's cell.
    num_points : (H, W) int64
        Number of points of a cell.
    nearest, farthest : (H, W) float64, metres
        Least and largest range; infinity and 0 in empty cells.
    """

    of_point: NDArray[np.int64]
    num_points: NDArray[np.int64]
    nearest: NDArray[np.float64]
    farthest: NDArray[np.float64]


def are_echoes(
    points: NDArray[np.float32],
    place: NDArray[np.float64],
    grid: AngularGrid,
    regions: list[NDArray[np.int64]],
) -> list[bool]:
    """Return for each region of points in front whether a scanner of several echoes explains it.

    Where a beam meets the edge of a thing, the first echo lies on a surface that neighbouring beams
    meet alone, and so does the second one. A pasted object, or what was pasted behind a wall, is
    never met alone.

    Parameters
    ----------
    points : (N, 3) float32
    place : (3,) float64, metres
        Position of the scanner.
    grid : AngularGrid
    regions : list of (K,) int64
        Rows of the points in front, by region.
    """
    cells = _cells_of(points, place, grid)
    is_echo = _looks_like_two_echoes(cells)
    columns = cells.num_points.shape[1]
    found = np.unique((np.flatnonzero(is_echo) % columns) * SECTORS // columns)
    if len(found) < MIN_SECTORS:
        return [False] * len(regions)
    flat = is_echo.reshape(-1)
    return [bool(np.mean(flat[cells.of_point[rows]]) >= MIN_ECHOES) for rows in regions]


def _looks_like_two_echoes(cells: Cells) -> NDArray[np.bool_]:
    """Mask of cells that hold two points on surfaces that cells beside them hold alone."""
    height, width = cells.num_points.shape
    row, column = np.nonzero(cells.num_points == 2)
    near, far = cells.nearest[row, column], cells.farthest[row, column]
    apart = BESIDE * (far - near)
    front, rear = np.zeros(len(row), np.bool_), np.zeros(len(row), np.bool_)
    for up in range(-AROUND, AROUND + 1):
        for on in range(-AROUND, AROUND + 1):
            beside = (row + up).clip(0, height - 1), (column + on) % width
            alone = cells.num_points[beside] == 1
            reach = np.where(alone, cells.nearest[beside], np.nan)
            front |= np.abs(reach - near) < apart
            rear |= np.abs(reach - far) < apart
    found = np.zeros(cells.num_points.shape, np.bool_)
    found[row, column] = front & rear
    return found


def _cells_of(points: NDArray[np.float32], place: NDArray[np.float64], grid: AngularGrid) -> Cells:
    row, column, distance, columns = angular_cells(points.astype(np.float64) - place, grid)
    of_point = row * columns + column
    shape = (int(row.max()) + 1, columns)
    count = np.bincount(of_point, minlength=shape[0] * columns).reshape(shape)
    nearest, farthest = np.full(shape, np.inf), np.zeros(shape)
    np.minimum.at(nearest.reshape(-1), of_point, distance)
    np.maximum.at(farthest.reshape(-1), of_point, distance)
    return Cells(of_point, count, nearest, farthest)
