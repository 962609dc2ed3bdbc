"""Views of calibrated cameras: depth images or scans with the pose of the camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import checked_grid, rows
from manip3d._util.linear import determinant, moved, product
from manip3d._util.reprs import short_repr
from manip3d.camera import Intrinsics, Registration, checked_depth
from manip3d.errors import InputError
from manip3d.simplify._arguments import checked_color
from manip3d.simplify._pixel_maps import confidence_image, mask_image, masked_depth

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class CameraView:
    """Depth image or range scan of one camera, with the camera's pose.

    Attributes
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        Depth image; needs ``intrinsics``.
    intrinsics : Intrinsics
        Camera of ``depth``; only with it.
    points : (H, W, 3) float
        A grid of points, such as a range scan, in place of ``depth`` and ``intrinsics``.
    valid : (H, W) bool, optional
        Measured pixels of ``points``; default: those with finite coordinates. Only with ``points``.
    pose : (4, 4) float64
        Rigid transform from the view's frame to the frame that all views share.
    color : (H', W', 3 or 4) uint8, optional
        Colour image, used as the view's texture.
    registration : Registration, optional
        Position of the colour camera, as for `cs3`; only with ``depth``.
    rows_up : bool
        Whether rows of ``points`` go up, as for `dense_mesh_grid`; only with ``points``.
    mask : (H, W) bool, optional
        Pixels to use.
    confidence : (H, W) float, 0 to 1, optional
        Confidence of each pixel, as for `relief`; only `relief_cameras` uses it. Pieces of the
        surface without confidence are left out, and count as measured pixels that are not covered.
    """

    depth: ArrayLike | None = None
    intrinsics: Intrinsics | None = None
    points: ArrayLike | None = None
    valid: ArrayLike | None = None
    pose: ArrayLike = field(default_factory=lambda: np.eye(4))
    color: ArrayLike | None = None
    registration: Registration | None = None
    rows_up: bool = True
    mask: ArrayLike | None = None
    confidence: ArrayLike | None = None

    __repr__ = short_repr


@dataclass
class View:
    """A checked view as a grid of points, with its pose in the shared frame."""

    points: NDArray[np.float32]
    valid: NDArray[np.bool_]
    rows_up: bool
    pose: NDArray[np.float64]
    color: NDArray[np.uint8] | None
    registration: Registration | None
    confidence: NDArray[np.float32] | None
    focal: float = 0.0  # focal length, pixels; 0: the view was given as points
    without_ray: int = 0  # measured pixels at which the lens model cannot be inverted
    camera: Intrinsics | None = None  # None: the view was given as points

    @cached_property
    def world(self) -> NDArray[np.float64]:
        """(N, 3) points of the valid pixels, in row-major order."""
        return moved(self.points[self.valid].astype(np.float64), self.pose)


def checked_view(view: CameraView, index: int, threads: int) -> View:
    """Check a view, and unproject its depth image; ``index`` names it in errors."""
    name = f"views[{index}]"
    if not isinstance(view, CameraView):
        raise InputError(f"{name}: expected CameraView, got {view!r}")
    pose = rows(view.pose, 4, np.float64, f"{name}.pose").copy()
    rotation = pose[:3, :3]
    rigid = (
        pose.shape == (4, 4)
        and np.isfinite(pose).all()
        and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
        and determinant(rotation) > 0
        and (pose[3] == (0, 0, 0, 1)).all()
    )
    if not rigid:
        raise InputError(f"{name}.pose: expected a rigid (4, 4) transform")
    if (view.depth is None) == (view.points is None):
        raise InputError(f"{name}: expected either depth with intrinsics, or points")
    _expect_own_fields(view, name)
    if view.points is not None:
        points, valid = checked_grid(view.points, view.valid, kept=True)
        mask = mask_image(view.mask, valid.shape, f"{name}.mask")
        confidence = confidence_image(view.confidence, valid.shape, f"{name}.confidence")
        valid = valid if mask is None else valid & mask
        color = checked_color(view.color, valid.shape)
        return View(points, valid, bool(view.rows_up), pose, color, None, confidence)
    if view.intrinsics is None:
        raise InputError(f"{name}: expected intrinsics beside depth")
    assert view.depth is not None
    image = checked_depth(view.depth, view.intrinsics)
    image = masked_depth(image, mask_image(view.mask, image.shape, f"{name}.mask"))
    confidence = confidence_image(view.confidence, image.shape, f"{name}.confidence")
    color = checked_color(view.color, image.shape, view.registration)
    flat, flags, rows_up = _core.unproject(image, view.intrinsics, threads)
    points = flat.reshape(*image.shape, 3)
    valid = flags.reshape(image.shape).view(np.bool_)
    focal = min(view.intrinsics.fx, abs(view.intrinsics.fy))
    without_ray = int(np.count_nonzero(image > 0) - np.count_nonzero(valid))
    return View(
        points,
        valid,
        rows_up,
        pose,
        color,
        view.registration,
        confidence,
        focal,
        without_ray,
        view.intrinsics,
    )


def _expect_own_fields(view: CameraView, name: str) -> None:
    """Refuse fields of points in a view with a depth image, and the other way round."""
    of_depth = {
        "intrinsics": view.intrinsics is not None,
        "registration": view.registration is not None,
    }
    of_points = {"valid": view.valid is not None, "rows_up": not view.rows_up}
    for field_name, is_given in (of_points if view.points is None else of_depth).items():
        if is_given:
            own, other = ("points", "depth") if view.points is None else ("depth", "points")
            raise InputError(f"{name}.{field_name}: can only be given with {own}, got {other}")


def pixel_normals(view: View) -> NDArray[np.float64]:
    """Return (H, W, 3) normals of the pixels in the shared frame, to the camera; NaN: unknown."""
    grid = np.full((*view.valid.shape, 3), np.nan)
    grid[view.valid] = view.world
    padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)

    def tangent(after: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        difference: NDArray[np.float64] = np.where(np.isnan(after), grid, after) - np.where(
            np.isnan(before), grid, before
        )
        return difference

    along_u = tangent(padded[1:-1, 2:], padded[1:-1, :-2])
    along_v = tangent(padded[2:, 1:-1], padded[:-2, 1:-1])
    normals: NDArray[np.float64] = np.cross(along_u, along_v)
    return normals if view.rows_up else -normals


def spacing(view: View) -> float:
    """Return the median distance of valid pixels from the next valid pixel in their row."""
    both = view.valid[:, 1:] & view.valid[:, :-1]
    steps = (view.points[:, 1:] - view.points[:, :-1])[both]
    return float(np.median(np.linalg.norm(steps, axis=1))) if len(steps) else 0.0


def from_world(view: View, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform points of the shared frame to that of a view."""
    return product(points - view.pose[:3, 3], view.pose[:3, :3])


def in_world(view: View, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
    """Transform vertices of a view to the shared frame."""
    return moved(vertices.astype(np.float64), view.pose)


def uvs(view: View, world: NDArray[np.float64], pixels: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the texture coordinates of vertices in the view's colour image."""
    if view.registration is not None:
        local = from_world(view, world)
        texcoords: NDArray[np.float32] = _core.registered_texcoords(
            np.ascontiguousarray(local, dtype=np.float32), view.registration
        )
        return texcoords
    height, width = view.valid.shape
    u, v = pixels.T
    return np.column_stack([(u + 0.5) / width, 1 - (v + 0.5) / height]).astype(np.float32)
