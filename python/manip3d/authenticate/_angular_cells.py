"""Cells of an angular grid in which points lie, seen from the scanner."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._occlusion import AngularGrid


class AngularCells(NamedTuple):
    """Cell and range of each point.

    Attributes
    ----------
    row, column : (N,) int64
        Row from the lowest occupied one on, and column from 0 to ``num_columns - 1``.
    distance : (N,) float64, metres
    num_columns : int
        Columns of a whole turn.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    distance: NDArray[np.float64]
    num_columns: int


def angular_cells(away: NDArray[np.float64], grid: AngularGrid) -> AngularCells:
    """Return the cells of points, (N, 3) float64 in metres from the scanner."""
    level = np.hypot(away[:, 0], away[:, 1])
    azimuth = np.degrees(np.arctan2(away[:, 1], away[:, 0])) - grid.azimuth_phase_deg
    elevation = np.degrees(np.arctan2(away[:, 2], level)) - grid.elevation_phase_deg
    num_columns = max(1, round(360.0 / grid.azimuth_deg))
    column = np.round(azimuth / grid.azimuth_deg).astype(np.int64) % num_columns
    row = np.round(elevation / grid.elevation_deg).astype(np.int64)
    row -= row.min() if len(row) > 0 else 0
    return AngularCells(row, column, np.hypot(level, away[:, 2]), num_columns)
