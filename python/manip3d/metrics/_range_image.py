"""Compare a mesh with the depth image it was made from, along the sensor's lines of sight."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import checked_grid
from manip3d._util.checked import checked
from manip3d._util.options import reporting, threads_of
from manip3d.camera import Intrinsics, checked_depth
from manip3d.errors import InputError
from manip3d.mesh import Mesh
from manip3d.simplify import DepthMesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress


@dataclass(frozen=True)
class RangeImageError:
    """Differences of depth between a range image and a mesh; see :func:`range_image_error`.

    Attributes
    ----------
    mean_square, mean_absolute, max : float
        Mean square, mean absolute and largest difference of depth, in (squared) units of the
        points: metres for depth images. NaN if no pixel was compared.
    diagonal : float
        Diagonal of the bounding box of the range image's points.
    compared : int
        Number of pixels that are valid in both.
    valid : int
        Number of valid pixels of the range image. Those without a line of sight, where the lens
        model cannot be inverted, count as well, although they cannot be compared.
    """

    mean_square: float
    mean_absolute: float
    max: float
    diagonal: float
    compared: int
    valid: int

    @property
    def mse(self) -> float:
        """``mean_square`` divided by the square of ``diagonal``."""
        return self.mean_square / self.diagonal**2

    @property
    def mean_square_mm2(self) -> float:
        """``mean_square`` in square millimetres, for points in metres."""
        return self.mean_square * 1e6

    @property
    def coverage(self) -> float:
        """Share of the range image's valid pixels that the mesh covers."""
        return self.compared / self.valid


@dataclass(frozen=True)
class Flicker:
    """Temporal noise of the meshes of a static scene; see :func:`flicker`.

    Attributes
    ----------
    mean_std_mm : float
        Mean, over the pixels that all frames cover, of the standard deviation of their depth.
    mean_step_mm : float
        The same between consecutive frames: the root of half the mean square of their differences
        (Allan's deviation). Equals `mean_std_mm` for white noise; insensitive to slow drift.
    unstable : float
        Share of the pixels of all frames together that some frame does not cover.
    changed : float or None
        Mean share of a frame's vertices that are no vertices of the previous frame. None if
        vertices are not pixels.
    frames : int
        Number of frames.
    """

    mean_std_mm: float
    mean_step_mm: float
    unstable: float
    changed: float | None
    frames: int


@dataclass(frozen=True)
class BoundaryNoise:
    """Flying pixels that remain in a mesh; see :func:`boundary_noise`.

    Attributes
    ----------
    survived : float
        Share of the flying pixels at which the mesh has a surface off all true surfaces.
    chosen : float or None
        Share of the flying pixels that are vertices. None if vertices are not pixels.
    density : float or None
        Vertices per measured pixel, the expected ``chosen`` for a random choice of vertices.
    flying : int
        Number of flying pixels.
    """

    survived: float
    chosen: float | None
    density: float | None
    flying: int


@checked
def render_depth(
    mesh: Mesh | DepthMesh, intrinsics: Intrinsics, *, threads: int = 0, progress: Progress = None
) -> NDArray[np.float64]:
    """Render the depth image of a mesh that a camera sees.

    Parameters
    ----------
    mesh : Mesh or DepthMesh
        Mesh in the frame of the camera, metres.
    intrinsics : Intrinsics
        The camera.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    (H, W) float64, metres
        Depth of the first surface on each pixel's line of sight; NaN if there is none.

    Raises
    ------
    InputError
        The mesh is not valid.

    Examples
    --------
    >>> from manip3d import Intrinsics, Mesh, metrics
    >>> camera = Intrinsics(3, 3, 1.0, 1.0, 1.0, 1.0)
    >>> wall = Mesh([[-9, -9, 2], [9, -9, 2], [0, 9, 2]], [[0, 2, 1]])
    >>> float(metrics.render_depth(wall, camera)[1, 1])
    2.0
    """
    shape = (intrinsics.height, intrinsics.width)
    points, valid, rows_up = _lifted(np.ones(shape, dtype=np.float32), intrinsics, threads)
    return _render(mesh, points, valid, rows_up, intrinsics, threads, progress)


@checked
def range_image_error(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    mesh: Mesh | DepthMesh,
    *,
    threads: int = 0,
    progress: Progress = None,
) -> RangeImageError:
    """Measure how far a mesh is from a depth image along the pixels' lines of sight.

    The mesh is rendered for the camera of the image, and depths are compared at the image's own
    points, at the pixels that both have. A mesh with holes has fewer compared pixels: read
    ``coverage`` together with ``mse``.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        0 and NaN mean no measurement.
    intrinsics : Intrinsics
        The camera.
    mesh : Mesh or DepthMesh
        Mesh in the frame of the camera, metres.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    RangeImageError

    Raises
    ------
    InputError
        The image has another shape or dtype, or no measurement; the mesh is not valid.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> camera = manip3d.Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> mesh = manip3d.simplify.dense_mesh(depth, camera)
    >>> manip3d.metrics.range_image_error(depth, camera, mesh).coverage
    1.0
    """
    image = checked_depth(depth, intrinsics)
    points, valid, rows_up = _lifted(image, intrinsics, threads)
    error = _error(mesh, points, valid, rows_up, intrinsics, threads, progress)
    return replace(error, valid=int(np.count_nonzero(image > 0)))


@checked
def range_image_error_grid(
    points: ArrayLike,
    valid: ArrayLike | None,
    mesh: Mesh | DepthMesh,
    *,
    rows_up: bool = True,
    threads: int = 0,
    progress: Progress = None,
) -> RangeImageError:
    """Measure how far a mesh is from a range scan; see `range_image_error`.

    The scan's lines of sight are fitted to its points: each coordinate of a pixel is a ratio of two
    affine functions of the point, which holds for cameras and for laser stripe scanners on a linear
    stage. Depth is measured along the mean direction of these lines.

    Parameters
    ----------
    points : (H, W, 3) float
        Points of the scan.
    valid : (H, W) bool, optional
        Valid points; default: those with three finite coordinates.
    mesh : Mesh or DepthMesh
        Mesh in the frame and unit of the points.
    rows_up : bool
        Same as for `manip3d.simplify.dense_mesh_grid`; only used if the lines of sight are
        parallel.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    RangeImageError

    Raises
    ------
    InputError
        As `range_image_error`; all points lie in a plane, or they fit no such sensor.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import metrics, simplify
    >>> y, x = np.mgrid[0:40, 0:40] * 0.01
    >>> points = np.stack([x, -y, 1 + 0.1 * np.sin(6 * x)], axis=2)
    >>> dense = simplify.dense_mesh_grid(points)
    >>> metrics.range_image_error_grid(points, None, dense).max
    0.0
    """
    grid, mask = checked_grid(points, valid)
    return _error(mesh, grid, mask, rows_up, None, threads, progress)


@checked
def flicker(
    frames: Iterable[Mesh | DepthMesh],
    intrinsics: Intrinsics,
    *,
    within: NDArray[np.bool_] | None = None,
    threads: int = 0,
) -> Flicker:
    """Measure how much the meshes of a static scene change from frame to frame.

    Parameters
    ----------
    frames : iterable of Mesh or DepthMesh
        At least two meshes of a static scene from a static camera, metres.
    intrinsics : Intrinsics
        The camera.
    within : (H, W) bool, optional
        Pixels to measure, which should be static. Only vertices at these pixels count in
        ``changed``.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Flicker

    Raises
    ------
    InputError
        There are fewer than two frames; frames have no pixel in common; a `DepthMesh` is of another
        camera; ``within`` has another shape.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, metrics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> still = simplify.dense_mesh(np.full((48, 64), 2000, np.uint16), camera)
    >>> metrics.flicker([still, still, still], camera).mean_std_mm
    0.0
    """
    shape = (intrinsics.height, intrinsics.width)
    if within is not None and (within.shape != shape or within.dtype != np.bool_):
        raise InputError(f"within: expected bool {shape}, got {within.dtype} {within.shape}")
    mean, squares, steps = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    last = np.zeros(shape)
    covered = np.zeros(shape, dtype=np.int64)
    changed: list[float] = []
    before: NDArray[np.bool_] | None = None
    count = 0
    for count, frame in enumerate(frames, start=1):
        if not isinstance(frame, Mesh | DepthMesh):
            raise InputError(f"frames: expected meshes, got {frame!r}")
        depth = render_depth(frame, intrinsics, threads=threads)
        step = depth - mean  # Welford's method avoids differences of large sums
        covered += np.isfinite(depth)
        mean = mean + step / count
        squares = squares + step * (depth - mean)
        if count > 1:
            steps += (depth - last) ** 2
        last = depth
        if isinstance(frame, DepthMesh):
            chosen = _chosen(frame, intrinsics, f"frames[{count - 1}]")
            if within is not None:
                chosen &= within
            if before is not None and chosen.any():
                changed.append(float((chosen & ~before).sum() / chosen.sum()))
            before = chosen
    always, ever = covered == count, covered > 0
    if within is not None:
        always &= within
        ever &= within
    if count < 2 or not always.any():
        raise InputError(f"frames: expected at least two with a common pixel, got {count}")
    std = np.sqrt(squares[always] / count)
    complete = len(changed) == count - 1
    return Flicker(
        mean_std_mm=1000.0 * float(std.mean()),
        mean_step_mm=1000.0 * float(np.sqrt(steps[always] / (2 * (count - 1))).mean()),
        unstable=float((ever & ~always).sum() / ever.sum()),
        changed=float(np.mean(changed)) if complete else None,
        frames=count,
    )


@checked
def boundary_noise(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    mesh: Mesh | DepthMesh,
    *,
    flying: NDArray[np.bool_],
    truth: NDArray[np.float64],
    tolerance: float = 0.03,
    threads: int = 0,
) -> BoundaryNoise:
    """Measure the share of flying pixels of a depth image that survive in a mesh made from it.

    A flying pixel survives if the mesh has a surface there that is farther than ``tolerance`` from
    all true surfaces at the pixel and its eight neighbours.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        The image from which the mesh was made.
    intrinsics : Intrinsics
        The camera.
    mesh : Mesh or DepthMesh
        Mesh in the frame of the camera, metres.
    flying : (H, W) bool
        Pixels that were measured between two surfaces, as in `manip3d.simulate.depth.DepthCapture`.
    truth : (H, W) float64, metres
        Exact depth; NaN if there is no surface.
    tolerance : float, metres
        Largest distance from a true surface; choose it above the noise of the sensor.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    BoundaryNoise

    Raises
    ------
    InputError
        There is no flying or no measured pixel; an array has another shape; ``flying`` is no bool;
        ``tolerance`` is negative; ``mesh`` is a `DepthMesh` of another camera.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, metrics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> depth[:, 32:] = 1000
    >>> depth[:, 31] = 1500  # a mixture of the two surfaces
    >>> truth = np.where(np.arange(64) < 32, 2.0, 1.0) * np.ones((48, 1))
    >>> flying = np.zeros((48, 64), bool)
    >>> flying[:, 31] = True
    >>> dense = simplify.dense_mesh(depth, camera)
    >>> metrics.boundary_noise(depth, camera, dense, flying=flying, truth=truth).survived
    1.0
    """
    image = checked_depth(depth, intrinsics)
    for name, array in (("flying", flying), ("truth", truth)):
        if np.shape(array) != image.shape:
            raise InputError(f"{name}: expected shape {image.shape}, got {np.shape(array)}")
    if flying.dtype != np.bool_:  # integers would be used as row numbers
        raise InputError(f"flying: expected bool, got {flying.dtype}")
    if not np.any(flying):
        raise InputError("flying: expected at least one flying pixel, got none")
    if not tolerance >= 0:
        raise InputError(f"tolerance: expected >= 0, got {tolerance}")
    if not (image > 0).any():
        raise InputError("depth: expected at least one measured pixel, got none")
    shown = render_depth(mesh, intrinsics, threads=threads)
    survived = np.isfinite(shown) & ~(_distance_to_surfaces(shown, truth) <= tolerance)
    chosen = density = None
    if isinstance(mesh, DepthMesh):
        chosen = float(_chosen(mesh, intrinsics, "mesh")[flying].mean())
        density = mesh.num_vertices / int((image > 0).sum())
    return BoundaryNoise(float(survived[flying].mean()), chosen, density, int(flying.sum()))


def _distance_to_surfaces(
    shown: NDArray[np.float64], truth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance in depth to the nearest true surface in the 3x3 pixels around; NaN if none."""
    rows, columns = truth.shape
    padded = np.pad(np.asarray(truth, dtype=np.float64), 1, mode="edge")
    distance = np.full(truth.shape, np.nan)
    for row in range(3):
        for column in range(3):
            beside = padded[row : row + rows, column : column + columns]
            distance = np.fmin(distance, np.abs(shown - beside))
    return distance


def _chosen(mesh: DepthMesh, intrinsics: Intrinsics, name: str) -> NDArray[np.bool_]:
    """Return the pixels that are vertices of a mesh, which must be of this camera."""
    chosen = np.zeros((intrinsics.height, intrinsics.width), dtype=np.bool_)
    if not mesh.num_vertices:
        return chosen
    columns, rows = mesh.pixels.T
    is_within = columns.max() < intrinsics.width and rows.max() < intrinsics.height
    # Vertices of a `Relief` may have been moved away from their pixels, but hardly most of them.
    off = np.abs(intrinsics.project(mesh.vertices) - mesh.pixels).max(axis=1)
    if not is_within or 2 * np.count_nonzero(off <= 1.0) < mesh.num_vertices:
        raise InputError(f"{name}: expected a mesh of this camera, got one of another")
    chosen[rows, columns] = True
    return chosen


def _lifted(
    image: NDArray[np.uint16 | np.float32], intrinsics: Intrinsics, threads: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_], bool]:
    points, valid, rows_up = _core.unproject(image, intrinsics, threads_of(threads))
    return points.reshape(*image.shape, 3), valid.reshape(image.shape).view(np.bool_), rows_up


def _plain(mesh: Mesh | DepthMesh) -> Mesh:
    """The mesh without texture, which is not needed here."""
    return Mesh(mesh.vertices, mesh.faces) if isinstance(mesh, DepthMesh) else mesh


def _render(
    mesh: Mesh | DepthMesh,
    points: NDArray[np.float32],
    valid: NDArray[np.bool_],
    rows_up: bool,
    intrinsics: Intrinsics | None,
    threads: int,
    progress: Progress,
) -> NDArray[np.float64]:
    with reporting(progress, "render depth") as report:
        depth: NDArray[np.float64] = _core.render_depth(
            _plain(mesh), points, valid, bool(rows_up), intrinsics, threads_of(threads), report
        )
    return depth.reshape(valid.shape)


def _error(
    mesh: Mesh | DepthMesh,
    points: NDArray[np.float32],
    valid: NDArray[np.bool_],
    rows_up: bool,
    intrinsics: Intrinsics | None,
    threads: int,
    progress: Progress,
) -> RangeImageError:
    with reporting(progress, "range image error") as report:
        return RangeImageError(
            *_core.range_image_error(
                _plain(mesh), points, valid, bool(rows_up), intrinsics, threads_of(threads), report
            )
        )
