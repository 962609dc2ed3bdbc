"""Depth images and range scans to sparse textured meshes."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._arrays import index_rows
from manip3d._options import threads_of
from manip3d.camera import Intrinsics, Registration
from manip3d.errors import InputError, MissingExtraError
from manip3d.mesh import Material, Mesh, Texture

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["DepthMesh", "dense_mesh", "dense_mesh_grid", "grid_delaunay"]


@dataclass(frozen=True, eq=False)
class DepthMesh:
    """A mesh whose vertices are pixels, in the 32-bit buffers that a GPU takes.

    Attributes
    ----------
    vertices : (n, 3) float32
        Points of the input, unchanged; metres for depth images, else the input's unit.
    triangles : (m, 3) int32
        Front faces look at the sensor.
    pixels : (n, 2) int32
        Column u and row v of each vertex.
    uvs : (n, 2) float32
        Texture coordinates, v up; NaN where the colour camera cannot see the point.
    colour : (H', W', 3 or 4) uint8, optional
        The image that ``uvs`` refer to.
    """

    vertices: NDArray[np.float32] = field(repr=False)
    triangles: NDArray[np.int32] = field(repr=False)
    pixels: NDArray[np.int32] = field(repr=False)
    uvs: NDArray[np.float32] = field(repr=False)
    colour: NDArray[np.uint8] | None = field(repr=False)

    @property
    def num_vertices(self) -> int:
        """Number of vertices."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """Number of triangles."""
        return len(self.triangles)

    @cached_property
    def mesh(self) -> Mesh:
        """The same as a `Mesh` with UVs; with colour, also with a texture (PNG).

        Raises
        ------
        MissingExtraError
            There is a colour image and Pillow is not installed.
        """
        seen = np.isfinite(self.uvs[:, 0])
        corners = np.where(seen[self.triangles], self.triangles, np.int32(-1))
        mesh = Mesh(
            self.vertices,
            self.triangles,
            texcoords=np.where(seen[:, None], self.uvs, np.float32(0)),
            face_texcoords=corners,
        )
        if self.colour is None:
            return mesh
        texture = Texture(data=_png(self.colour))
        return mesh.replace(
            face_material=np.zeros(self.num_faces, np.int32),
            materials=(Material("colour", textures={"base_color": texture}),),
        )


def _png(colour: NDArray[np.uint8]) -> bytes:
    try:
        from PIL import Image
    except ImportError as error:
        raise MissingExtraError("Pillow", "io") from error
    buffer = io.BytesIO()
    Image.fromarray(colour).save(buffer, "PNG")
    return buffer.getvalue()


def _depth_image(depth: ArrayLike, intrinsics: Intrinsics) -> NDArray[np.uint16 | np.float32]:
    """The image in one of the two dtypes of the core; the same object if it is in one."""
    if not isinstance(intrinsics, Intrinsics):
        raise InputError(f"intrinsics: expected Intrinsics, got {intrinsics!r}")
    image = np.asarray(depth)
    if image.dtype not in (np.uint16, np.float32):
        raise InputError(
            f"depth: expected dtype uint16 (millimetres) or float32 (metres), got {image.dtype}"
        )
    if image.shape != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth: expected shape ({intrinsics.height}, {intrinsics.width}) as the intrinsics "
            f"say, got {image.shape}"
        )
    return np.ascontiguousarray(image)


def _point_grid(
    points: ArrayLike, valid: ArrayLike | None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    grid = np.asarray(points)
    if grid.ndim != 3 or grid.shape[2] != 3 or grid.dtype.kind != "f":
        raise InputError(
            f"points: expected (H, W, 3) floats, got shape {grid.shape}, dtype {grid.dtype}"
        )
    grid = np.ascontiguousarray(grid, dtype=np.float32)
    if valid is None:
        return grid, np.isfinite(grid).all(axis=2)
    mask = np.asarray(valid)
    if mask.shape != grid.shape[:2] or mask.dtype != np.bool_:
        raise InputError(
            f"valid: expected bool of shape {grid.shape[:2]}, got {mask.dtype} of {mask.shape}"
        )
    return grid, np.ascontiguousarray(mask)


def _colour_image(
    colour: ArrayLike | None, shape: tuple[int, ...], registration: Registration | None = None
) -> NDArray[np.uint8] | None:
    if registration is not None:
        if not isinstance(registration, Registration):
            raise InputError(f"registration: expected Registration, got {registration!r}")
        shape = (registration.colour.height, registration.colour.width)
    if colour is None:
        return None
    image = np.asarray(colour)
    if image.dtype != np.uint8 or image.shape not in ((*shape, 3), (*shape, 4)):
        raise InputError(
            f"colour: expected uint8 of shape ({shape[0]}, {shape[1]}, 3 or 4), "
            f"got {image.dtype} of {image.shape}"
        )
    return image


def _max_edge(max_edge: float | None) -> float:
    return math.inf if max_edge is None else float(max_edge)


def dense_mesh(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    *,
    colour: ArrayLike | None = None,
    registration: Registration | None = None,
    max_edge: float | None = None,
    threads: int = 1,
) -> DepthMesh:
    """The full mesh of a depth image: what simplification is compared with.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        0 and NaN mean no measurement.
    intrinsics : Intrinsics
    colour : (H', W', 3 or 4) uint8, optional
        Of the depth image's size, or that of ``registration.colour``.
    registration : Registration, optional
        Where the colour camera stands; without it both images share their pixels.
    max_edge : float, metres, optional
        Triangles with a longer edge are left out.
    threads : int
        0: all cores. The result is the same for any number.

    Returns
    -------
    DepthMesh
        All valid pixels in row-major order; two triangles for each 2x2 cell of four of them, cut
        along the shorter diagonal, and one where three are valid.

    Raises
    ------
    InputError
        Another shape or dtype, a negative or infinite depth, or an option out of range.
    """
    image = _depth_image(depth, intrinsics)
    picture = _colour_image(colour, image.shape, registration)
    threads = threads_of(threads)
    points, valid, rows_up = _core.unproject(image, intrinsics, threads)
    fields = _core.grid_mesh(
        points.reshape(*image.shape, 3),
        valid.reshape(image.shape).view(np.bool_),
        rows_up,
        _max_edge(max_edge),
        threads,
    )
    if registration is not None:
        fields["uvs"] = _core.registered_uvs(fields["vertices"], registration)
    return DepthMesh(**fields, colour=picture)


def dense_mesh_grid(
    points: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    colour: ArrayLike | None = None,
    rows_up: bool = True,
    max_edge: float | None = None,
    threads: int = 1,
) -> DepthMesh:
    """The full mesh of a range scan; see `dense_mesh`.

    Parameters
    ----------
    points : (H, W, 3) float
        As of `manip3d.io.read_range_grid`. Rounded to float32.
    valid : (H, W) bool, optional
        Default: where all three coordinates are finite.
    colour : (H, W, 3 or 4) uint8, optional
    rows_up : bool
        Seen from the sensor, do rows go upward (Stanford's scans) or downward (images)? It decides
        which side of the surface is the front.
    max_edge : float, optional
        In the unit of the points.
    threads : int

    Raises
    ------
    InputError
        As `dense_mesh`; a valid point is not finite.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> v, u = np.mgrid[0.0:3, 0:4]
    >>> scan = np.stack([u, v, 0 * u], axis=-1)
    >>> manip3d.simplify.dense_mesh_grid(scan).num_faces
    12
    """
    grid, mask = _point_grid(points, valid)
    picture = _colour_image(colour, mask.shape)
    fields = _core.grid_mesh(grid, mask, bool(rows_up), _max_edge(max_edge), threads_of(threads))
    return DepthMesh(**fields, colour=picture)


def grid_delaunay(pixels: ArrayLike) -> NDArray[np.int32]:
    """Delaunay triangulation of distinct pixels: exact, and unique although many are cocircular.

    Parameters
    ----------
    pixels : (N, 2) int
        Column u and row v, 0 to 16383, in any order.

    Returns
    -------
    (T, 3) int32
        Counter-clockwise for u to the right and v up. Empty for fewer than three pixels and for
        pixels on a line. Of four pixels on an otherwise empty circle the last in row-major order
        is cut off: the diagonal runs between the other two neighbours (symbolic perturbation).

    Raises
    ------
    InputError
        A pixel is repeated or out of range.

    Examples
    --------
    >>> import manip3d
    >>> manip3d.simplify.grid_delaunay([[0, 0], [1, 0], [0, 1], [1, 1]]).tolist()
    [[0, 1, 2], [2, 1, 3]]
    """
    triangles: NDArray[np.int32] = _core.grid_delaunay(index_rows(pixels, 2, "pixels"))
    return triangles
