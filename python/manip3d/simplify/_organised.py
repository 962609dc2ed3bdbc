"""Estimation of the camera of an organised cloud from its points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import determinant, eigen, inverse, line_fit, product
from manip3d.camera import Intrinsics
from manip3d.io._scan_files import holds_points
from manip3d.io._scan_tables import scan_suffix

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from manip3d.io import RangeGrid

_MAX_PIXELS = 20_000
"""Largest number of pixels that the camera is fitted to; far more than its parameters need."""

_MAX_OFF = 0.05
"""Largest deviation of a pixel from a pinhole camera, as a share of the image's size; lens
distortion is smaller."""


_MAX_SKEW = 0.02
"""Largest skew as a share of the focal length; the pixel axes of a camera are perpendicular."""


_MAX_ASIDE = 10.0
"""Largest distance of the principal point from the image's centre, in sizes of the image. A plane
in coordinates of a map seems to be seen from their origin, far aside; rays in 32 bits, with which
cropped images are no problem, would then shift points by decimetres."""


def is_cloud_file(path: Path) -> bool:
    """Return whether a file may be an organised cloud: a .pcd or an array that holds points."""
    suffix = scan_suffix(path)
    return suffix == ".pcd" or (suffix in (".npy", ".npz") and holds_points(path))


@dataclass(frozen=True, eq=False)
class CloudCamera:
    """Camera of a cloud whose points may be in another coordinate frame, such as a robot's.

    Attributes
    ----------
    intrinsics : Intrinsics
    depth : (H, W) float64
        z in the camera's frame, in the file's unit; NaN: no measurement.
    rotation : (3, 3) float64 or None
        Rotation from the file's axes to the camera's axes; None: they are the same.
    centre : (3,) float64
        Position of the camera in the file's coordinates.
    """

    intrinsics: Intrinsics
    depth: NDArray[np.float64]
    rotation: NDArray[np.float64] | None
    centre: NDArray[np.float64]

    def to_file(self, points: NDArray[np.float64], unit: float) -> NDArray[np.float64]:
        """Transform points from the camera's frame to the file's.

        ``points`` and the result are in a unit that is ``unit`` times the file's.
        """
        if self.rotation is None:
            return points
        return np.asarray(product(points, self.rotation) + self.centre / unit)


def find_camera(grid: RangeGrid) -> CloudCamera | None:
    """Return the camera of an organised cloud in any frame; None: no camera fits its points."""
    found = camera_of_cloud(grid.points, grid.valid)
    if found is not None:
        return CloudCamera(found, grid.points[..., 2], None, np.zeros(3))
    pose = _pose(grid.points, grid.valid)
    if pose is None:
        return None
    rotation, centre = pose
    points = product(grid.points - centre, rotation.T)
    found = camera_of_cloud(points, grid.valid)
    return None if found is None else CloudCamera(found, points[..., 2], rotation, centre)


_FAR = 16.0
"""Distance of a cloud from the origin, in diagonals of its box. Beyond it, as in coordinates of a
national grid, 32-bit points would be coarse, and the sensor is not at the origin."""


def far_origin(grid: RangeGrid) -> NDArray[np.float64]:
    """Return the centre of a cloud that lies far from the origin, else zeros.

    Relative to it, 32-bit coordinates are precise enough. It is also the best guess of where a
    sensor stood of which nothing else is known, because scanners look around.
    """
    points = grid.points[grid.valid]
    if not len(points):
        return np.zeros(3)
    low, high = points.min(axis=0), points.max(axis=0)
    centre: NDArray[np.float64] = (low + high) / 2
    is_far = np.linalg.norm(centre, axis=-1) > _FAR * np.linalg.norm(high - low, axis=-1)
    return centre if is_far else np.zeros(3)


def rows_go_up(grid: RangeGrid, place: ArrayLike = (0.0, 0.0, 0.0)) -> bool:
    """Return whether triangles of a range image face the sensor if rows are counted upwards.

    Parameters
    ----------
    grid : RangeGrid
    place : (3,)
        Position of the sensor.
    """
    corner, right, below = grid.points[:-1, :-1], grid.points[:-1, 1:], grid.points[1:, :-1]
    upwards = np.cross(right - corner, below - corner)
    towards = (upwards * (np.asarray(place) - corner)).sum(axis=2)
    return bool(np.count_nonzero(towards > 0) >= np.count_nonzero(towards < 0))


_MIN_PERSPECTIVE = 0.5
"""Pixels: a parallel projection that is nearer to the pixels may be the true one."""


def scan_rows_go_up(grid: RangeGrid) -> bool:
    """Return whether the rows of a range scan, whose sensor's position is not stored, go up.

    Those of Stanford's scans do, and their origin is not the sensor. Only if the scan has a camera,
    its side of the surface is known.
    """
    camera = camera_of_scan(grid)
    return True if camera is None else rows_go_up(grid, camera.centre)


def camera_of_scan(grid: RangeGrid) -> CloudCamera | None:
    """Return the camera of a range scan, as one of a converted depth image has it; else None.

    A camera must fit the points much better than a parallel projection.
    """
    camera = find_camera(grid)
    if camera is None:
        return None
    rows, cols = np.nonzero(grid.valid)
    some = slice(None, None, -(-len(rows) // _MAX_PIXELS))
    pixels = np.column_stack([cols[some], rows[some]]).astype(np.float64)
    seen = grid.points[rows[some], cols[some]]
    placed = seen - camera.centre
    if camera.rotation is not None:
        placed = product(placed, camera.rotation.T)
    lens = camera.intrinsics
    by_camera = placed[:, :2] / placed[:, 2:] * (lens.fx, lens.fy) + (lens.cx, lens.cy) - pixels
    parallel = _off_linear(seen, pixels)
    off, off_parallel = (float(np.sqrt((each**2).mean())) for each in (by_camera, parallel))
    is_camera = off_parallel > max(_MIN_PERSPECTIVE, 2 * off)
    return camera if is_camera else None


def _off_linear(points: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pixels' residuals, (N, 2), to their least-squares fit by a parallel projection."""
    away, seen = points - points.mean(axis=0), pixels - pixels.mean(axis=0)
    spread, axes = eigen(product(away.T, away))
    along = product(away, axes[:, spread > _FLAT * spread.max()])
    slopes = product(along.T, seen) / (along * along).sum(axis=0)[:, None]
    return np.asarray(product(along, slopes) - seen)


_FLAT = 1e-12
"""Largest share of its square extent that the square thickness of a plane of points has."""


def _pose(
    points: NDArray[np.float64], valid: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return rotation and position of the camera by the direct linear transform."""
    rows, cols = np.nonzero(valid)
    if len(rows) < 6:
        return None
    some = slice(None, None, -(-len(rows) // _MAX_PIXELS))
    rows, cols = rows[some], cols[some]
    seen = points[rows, cols]
    middle = seen.mean(axis=0)
    scale = float((seen - middle).std()) or 1.0
    size = float(max(valid.shape))
    place = np.column_stack([(seen - middle) / scale, np.ones(len(seen))])
    none = np.zeros_like(place)
    u, v = cols[:, None] / size, rows[:, None] / size
    equations = np.vstack(
        [np.hstack([place, none, -u * place]), np.hstack([none, place, -v * place])]
    )
    squares, unknowns = eigen(product(equations.T, equations))
    camera = unknowns[:, np.argmin(squares)].reshape(3, 4)
    volume = determinant(camera[:, :3])
    if abs(volume) < 1e-12:
        return None
    camera *= np.sign(volume)
    lens, rotation = _lens_and_rotation(camera[:, :3])
    if not abs(lens[0, 1]) <= _MAX_SKEW * lens[0, 0]:
        return None
    centre = -product(inverse(camera[:, :3]), camera[:, 3])
    return rotation, middle + scale * centre


def _lens_and_rotation(
    camera: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the RQ decomposition of (3, 3), by Gram and Schmidt's method from the last row up."""
    lens, rotation = np.zeros((3, 3)), np.zeros((3, 3))
    for i in (2, 1, 0):
        rest = camera[i]
        for k in range(2, i, -1):
            lens[i, k] = product(rest, rotation[k])
            rest = rest - lens[i, k] * rotation[k]
        lens[i, i] = np.linalg.norm(rest, axis=-1)
        rotation[i] = rest / lens[i, i]
    return lens, rotation


def camera_of_cloud(points: NDArray[np.float64], valid: NDArray[np.bool_]) -> Intrinsics | None:
    """Return the camera of an organised cloud whose points are in the camera's axes.

    The ray of a measured pixel is the direction of its point, so that no lens model is needed. The
    other rays and the focal lengths are those of the best fitting pinhole camera.

    Parameters
    ----------
    points : (H, W, 3), NaN: no measurement
    valid : (H, W) bool

    Returns
    -------
    Intrinsics or None
        None: a point lies beside or behind the camera, or column and row are not linear in x / z
        and y / z, as in clouds of rotating LiDARs and in clouds rotated to another frame.
    """
    rows, cols = np.nonzero(valid)
    if len(rows) < 3 or not (points[..., 2][valid] > 0.0).all():
        return None
    some = slice(None, None, -(-len(rows) // _MAX_PIXELS))
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
    """Fit focal length and principal point along one axis; None: the fit is not linear."""
    if not np.ptp(slopes) > 1e-12 * np.abs(slopes).max():
        return None
    focal, centre = line_fit(slopes, pixels.astype(np.float64))
    off = np.abs(slopes * focal + centre - pixels)
    if focal == 0.0 or np.percentile(off, 99) > _MAX_OFF * size:
        return None
    if abs(centre - size / 2) > _MAX_ASIDE * size:
        return None
    return focal, centre
