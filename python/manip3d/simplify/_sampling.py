"""Sampling methods that CS3 is compared with: lattice, Poisson disks, scale-space analysis."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import checked_grid
from manip3d._util.checked import checked
from manip3d._util.options import seed_of, threads_of
from manip3d.camera import checked_depth
from manip3d.errors import InputError
from manip3d.simplify._arguments import checked_color, limit_of
from manip3d.simplify._depth import (
    DenseGrid,
    DenseImage,
    DepthSimplification,
    grid_delaunay,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Rng
    from manip3d.camera import Intrinsics, Registration

SamplingMethod = Literal["uniform", "poisson", "ssa"]


@checked
def sample_depth(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    target_points: int,
    *,
    method: SamplingMethod = "uniform",
    color: ArrayLike | None = None,
    registration: Registration | None = None,
    max_edge: float | None = None,
    rng: Rng = 0,
    threads: int = 0,
) -> DepthSimplification:
    """Reduce a depth image by a method that CS3 is compared with.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        0 and NaN mean no measurement.
    intrinsics : Intrinsics
    target_points : int
        Largest number of vertices; the result is within 1 % of it if the method allows.
    method : 'uniform', 'poisson' or 'ssa'
        'uniform': a square lattice; 'poisson': points in random order, none within a radius of
        another; 'ssa': zero crossings of the Laplacian of Gaussian along the rows (scale-space
        analysis), which is meant for a single object.
    color : (H', W', 3 or 4) uint8, optional
        Colour image of the depth image's size, or that of ``registration.color``.
    registration : Registration, optional
    max_edge : float, metres, optional
        Triangles with a longer edge are left out.
    rng : int, numpy.random.Generator or None
        Seed or generator for ``'poisson'``; None: another result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    DepthSimplification
        The chosen pixels in row-major order, triangulated as those of CS3: a Delaunay triangulation
        without the triangles whose centroid falls on a pixel without depth.

    Raises
    ------
    InputError
        A wrong shape or dtype, a negative or infinite depth, or an option out of range.

    Notes
    -----
    Poisson disks: R. L. Cook, ACM Transactions on Graphics 5(1), 1986. Scale-space analysis:
    I. Cheng, P. Boulanger, Proc. 3DPVT 2006. Section 3.6 of the dissertation compares both with
    CS3.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> wall = np.full((48, 64), 2000, np.uint16)
    >>> simplify.sample_depth(wall, camera, 300, method="uniform").num_vertices <= 300
    True
    """
    image = checked_depth(depth, intrinsics)
    picture = checked_color(color, image.shape, registration)
    points, valid, rows_up = _core.unproject(image, intrinsics, threads_of(threads))
    points, valid = points.reshape(*image.shape, 3), valid.reshape(image.shape).view(np.bool_)
    mesh = sample_depth_grid(
        points,
        valid,
        target_points,
        method=method,
        rows_up=rows_up,
        max_edge=max_edge,
        rng=rng,
    )
    texcoords = mesh.texcoords
    if registration is not None:
        texcoords = _core.registered_texcoords(mesh.vertices, registration)
    surface = DenseImage(image.copy(), intrinsics, limit_of(max_edge))
    return replace(mesh, texcoords=texcoords, color=picture, surface=surface)


@checked
def sample_depth_grid(
    points: ArrayLike,
    valid: ArrayLike | None,
    target_points: int,
    *,
    method: SamplingMethod = "uniform",
    color: ArrayLike | None = None,
    rows_up: bool = True,
    max_edge: float | None = None,
    rng: Rng = 0,
) -> DepthSimplification:
    """Reduce a range scan by a method that CS3 is compared with.

    Parameters
    ----------
    points : (H, W, 3) float
        Points as returned by `manip3d.io.read_range_grid`. They are rounded to float32.
    valid : (H, W) bool, optional
        Measured points. Default: points whose three coordinates are all finite.
    target_points : int
        Largest number of vertices; the result is within 1 % of it if the method allows.
    method : 'uniform', 'poisson' or 'ssa'
        'uniform': a square lattice; 'poisson': points in random order, none within a radius of
        another; 'ssa': zero crossings of the Laplacian of Gaussian along the rows (scale-space
        analysis), which is meant for a single object.
    color : (H, W, 3 or 4) uint8, optional
        Colour of each point, used as the mesh's texture.
    rows_up : bool
        Whether rows go upward as seen from the sensor (Stanford's scans), not downward (images).
        This decides which side of the surface is the front.
    max_edge : float, optional
        Triangles with a longer edge are left out; in the unit of the points.
    rng : int, numpy.random.Generator or None
        Seed or generator for ``'poisson'``; None: another result each time.

    Returns
    -------
    DepthSimplification
        The chosen points in row-major order, triangulated as those of CS3: a Delaunay triangulation
        without the triangles whose centroid falls on a point that is not valid.

    Raises
    ------
    InputError
        A wrong shape or dtype, a valid point that is not finite, or an option out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> y, x = np.mgrid[0:40, 0:40] * 0.01
    >>> points = np.stack([x, -y, 1 + 0.1 * np.sin(6 * x)], axis=2)
    >>> simplify.sample_depth_grid(points, None, 100).num_vertices <= 100
    True
    """
    grid, mask = checked_grid(points, valid, kept=True)
    picture = checked_color(color, mask.shape, None)
    seed = seed_of(rng)
    if method == "uniform":
        pixels = _core.sample_uniform(grid, mask, target_points)
    elif method == "poisson":
        pixels, _ = _core.sample_poisson_disk(grid, mask, target_points, seed)
    else:
        pixels, _ = _core.sample_scale_space(grid, mask, target_points)
    return _meshed(grid, mask, pixels, rows_up, limit_of(max_edge), picture)


def _meshed(
    points: NDArray[np.float32],
    valid: NDArray[np.bool_],
    pixels: NDArray[np.int32],
    rows_up: bool,
    max_edge: float,
    color: NDArray[np.uint8] | None,
) -> DepthSimplification:
    """Triangulate the chosen pixels by the modified Delaunay triangulation of section 3.4."""
    if not max_edge > 0:
        raise InputError(f"max_edge: expected > 0, got {max_edge}")
    height, width = valid.shape
    vertices = points[pixels[:, 1], pixels[:, 0]]
    faces = grid_delaunay(pixels)
    u, v = np.rint(pixels[faces].mean(axis=1)).astype(np.intp).T
    kept = valid[v, u]
    if max_edge < np.inf:
        corners = vertices[faces].astype(np.float64)
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        kept &= sides.max(axis=1, initial=0.0) <= max_edge
    faces = faces[kept]
    texcoords = np.stack(
        [(pixels[:, 0] + 0.5) / width, 1.0 - (pixels[:, 1] + 0.5) / height], axis=1
    ).astype(np.float32)
    return DepthSimplification(
        vertices,
        faces if rows_up else np.ascontiguousarray(faces[:, [0, 2, 1]]),
        pixels,
        texcoords,
        color,
        stop="all_points" if len(pixels) == int(valid.sum()) else "target",
        surface=DenseGrid(points, valid, max_edge),
        cover=None,
    )
