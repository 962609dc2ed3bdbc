"""Organised clouds of depth cameras: the camera is told by the points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d.camera import Intrinsics
from manip3d.io._scan_tables import scan_suffix

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from manip3d.io import RangeGrid

_MOST_PIXELS = 20_000
"""Pixels that the camera is fitted to: far more than its four numbers need."""

_MOST_OFF = 0.05
"""Share of the image's size by which a pixel may be off a pinhole's: lenses bend less."""


def is_cloud_file(path: Path) -> bool:
    """Whether a file may be an organised cloud, by its name."""
    return scan_suffix(path) == ".pcd"


def camera_of_cloud(grid: RangeGrid) -> Intrinsics | None:
    """Return the camera that an organised cloud is the depth image of.

    Its rays are those of the measured pixels, so that lenses need no model; those of the others,
    and the focal lengths, are those of the pinhole that fits best.

    Parameters
    ----------
    grid : RangeGrid

    Returns
    -------
    Intrinsics or None
        None: points lie beside or behind the camera, or columns and rows do not follow x / z and
        y / z, as in the clouds of turning LiDARs and in those that were turned to another frame.
    """
    points, valid = grid.points, grid.valid
    rows, cols = np.nonzero(valid)
    if len(rows) < 3 or not (points[..., 2][valid] > 0.0).all():
        return None
    some = slice(None, None, -(-len(rows) // _MOST_PIXELS))
    seen = points[rows[some], cols[some]]
    across = _line(seen[:, 0] / seen[:, 2], cols[some], valid.shape[1])
    down = _line(seen[:, 1] / seen[:, 2], rows[some], valid.shape[0])
    if across is None or down is None or across[0] < 0.0:
        return None
    height, width = valid.shape
    rays = np.empty((height, width, 2), np.float32)
    rays[..., 0] = (np.arange(width) - across[1]) / across[0]
    rays[..., 1] = ((np.arange(height) - down[1]) / down[0])[:, None]
    rays[valid] = points[valid][:, :2] / points[valid][:, 2:]
    return Intrinsics(width, height, across[0], down[0], across[1], down[1], rays=rays)


def _line(
    slopes: NDArray[np.float64], pixels: NDArray[np.int64], size: int
) -> tuple[float, float] | None:
    """Focal length and principal point along one axis; None: the pixels do not follow a line."""
    design = np.column_stack([slopes, np.ones(len(slopes))])
    (focal, centre), _, rank, _ = np.linalg.lstsq(design, pixels.astype(np.float64), rcond=None)
    off = np.abs(design @ (focal, centre) - pixels)
    if rank < 2 or focal == 0.0 or np.percentile(off, 99) > _MOST_OFF * size:
        return None
    return float(focal), float(centre)
