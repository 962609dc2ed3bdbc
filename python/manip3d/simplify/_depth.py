"""Sparse textured meshes of depth images and range scans: result types, CS3, Delaunay."""

from __future__ import annotations

import enum
import math
import threading
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from manip3d import _core
from manip3d._util.arrays import checked_grid, index_rows
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.camera import Intrinsics, Registration, checked_depth
from manip3d.errors import InputError
from manip3d.io._images import encoded_picture
from manip3d.mesh import Material, Mesh, Texture
from manip3d.simplify._arguments import checked_color, count_of, limit_of
from manip3d.simplify._pixel_maps import mask_image, masked_depth

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Cs3Result",
    "Cs3Stream",
    "DenseGrid",
    "DenseImage",
    "DepthMesh",
    "DepthSimplification",
    "Reached",
    "Variant",
    "cs3",
    "cs3_grid",
    "dense_mesh",
    "dense_mesh_grid",
    "grid_delaunay",
]

Variant = Literal["lnms", "lios", "cnms", "cios"]
_VARIANTS = {
    "lnms": (_core.Cs3Importance.LAPLACIAN, _core.Cs3Sampling.NON_MAXIMUM),
    "lios": (_core.Cs3Importance.LAPLACIAN, _core.Cs3Sampling.IMPORTANCE_ORDER),
    "cnms": (_core.Cs3Importance.MIN_CURVATURE, _core.Cs3Sampling.NON_MAXIMUM),
    "cios": (_core.Cs3Importance.MIN_CURVATURE, _core.Cs3Sampling.IMPORTANCE_ORDER),
}


@dataclass(frozen=True, eq=False, repr=False)
class DepthMesh(Showable):
    """A mesh whose vertices are pixels of a depth image or range scan, in 32-bit arrays.

    Attributes
    ----------
    vertices : (n, 3) float32
        Points of the input, unchanged; metres for depth images, else the input's unit.
    faces : (m, 3) int32
        Front faces look at the sensor.
    pixels : (n, 2) int32
        Column u and row v of each vertex.
    texcoords : (n, 2) float32
        Texture coordinates, v up; NaN where the colour camera cannot see the point.
    color : (H', W', 3 or 4) uint8, optional
        The image that ``texcoords`` refer to.
    """

    vertices: NDArray[np.float32] = field(repr=False)
    faces: NDArray[np.int32] = field(repr=False)
    pixels: NDArray[np.int32] = field(repr=False)
    texcoords: NDArray[np.float32] = field(repr=False)
    color: NDArray[np.uint8] | None = field(repr=False)

    def __repr__(self) -> str:
        vertices = counted(self.num_vertices, "vertex", "vertices")
        faces = counted(self.num_faces, "face")
        return f"<manip3d.simplify.{type(self).__name__}: {vertices}, {faces}>"

    @property
    def num_vertices(self) -> int:
        """Number of vertices."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    def with_faces(self, faces: NDArray[np.int32]) -> Self:
        """Return the same points with other triangles.

        Parameters
        ----------
        faces : (m, 3) int32
            Indices of the points.
        """
        return replace(self, faces=faces)

    def gpu_buffers(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16] | NDArray[np.uint32]]:
        """Return positions, texture coordinates and indices for OpenGL, WebGL and glTF.

        Returns
        -------
        positions : (n, 3) float32
            ``vertices``, not copied.
        texcoords : (n, 2) float32
            v down, as images are stored; 0 where the colour camera cannot see the point. A face
            with such a corner has no texture.
        indices : (3 m,) uint16 or uint32
            ``faces``, one after the other; 16 bits if there are fewer than 65 536 vertices.
        """
        texcoords = self.texcoords.copy()
        texcoords[:, 1] = 1 - texcoords[:, 1]
        texcoords[np.isnan(texcoords)] = 0
        flat = self.faces.reshape(-1)
        small = self.num_vertices < 2**16  # 65 535, which restarts a primitive, is no index then
        return self.vertices, texcoords, flat.astype(np.uint16) if small else flat.view(np.uint32)

    def encode(self, *, sequence: int = 0, time_ns: int = 0, jpeg_quality: int = 80) -> bytes:
        """Return the mesh as one quantised binary message for the pages of `manip3d.serve`.

        Parameters
        ----------
        sequence : int
            Number of the frame, 0 to 2^32 - 1.
        time_ns : int, nanoseconds
            Time of the frame by the sensor's clock.
        jpeg_quality : int
            JPEG quality of ``color``, 1 to 100.

        Returns
        -------
        bytes
            In the layout of ``stream_frame.hpp``: positions in steps of 1/65535 of the extent along
            each axis, texture coordinates in 16 bits, faces, and the used part of the colour image
            as JPEG.

        Raises
        ------
        InputError
            A number out of range.
        """
        return _core.encode_stream_frame(
            self.vertices,
            self.texcoords,
            np.zeros(self.num_vertices, np.uint8),
            self.faces,
            None if self.color is None else np.ascontiguousarray(self.color[..., :3]),
            None,
            1.0,
            sequence,
            time_ns,
            0,
            "{}",
            jpeg_quality,
        )

    @cached_property
    def mesh(self) -> Mesh:
        """This mesh as a `Mesh` with texture coordinates and, with colour, a PNG texture.

        Faces with a corner that the colour camera cannot see have neither.

        Raises
        ------
        MissingExtraError
            There is a colour image and Pillow is not installed.
        """
        seen = np.isfinite(self.texcoords[:, 0])
        textured: NDArray[np.bool_] = np.asarray(seen[self.faces].all(axis=1))
        mesh = Mesh(
            self.vertices,
            self.faces,
            texcoords=np.where(seen[:, None], self.texcoords, np.float32(0)),
            face_texcoords=np.where(textured[:, None], self.faces, np.int32(-1)),
        )
        if self.color is None:
            return mesh
        texture = Texture(data=encoded_picture(self.color))
        picture = Material("colour", textures={"base_color": texture})
        return with_materials(mesh, np.zeros(self.num_faces, np.int32), (picture,), textured)


def with_materials(
    mesh: Mesh,
    face_material: NDArray[np.int32],
    materials: tuple[Material, ...],
    textured: NDArray[np.bool_],
) -> Mesh:
    """Return the mesh with a material for each face; faces that are not textured get a plain one.

    Without texture coordinates, a face of a material with a picture would show one of its pixels.
    """
    if not textured.all():
        face_material = np.where(textured, face_material, np.int32(len(materials)))
        materials = (*materials, Material("not seen"))
    return mesh.replace(face_material=face_material, materials=materials)


class Reached(enum.StrEnum):
    """Way in which `cs3` reached its number of points."""

    FACTOR = "factor"  #: a factor on the radii gives the target within 1 %
    CUT = "cut"  #: every factor gives more points; the order was cut off at the target
    CONTINUED = "continued"  #: no factor comes within 1 %; the most important other points follow
    ALL_PIXELS = "all_pixels"  #: there are no more valid pixels than the target


@dataclass(frozen=True, eq=False)
class DenseGrid:
    """The grid of points from which a sparse mesh was made.

    Attributes
    ----------
    points : (H, W, 3) float32
        The caller's array, not copied, if that was float32.
    valid : (H, W) bool
        Measured pixels.
    max_edge : float
        Dense triangles with a longer edge are left out; infinite: no limit.
    depth_step, focal : float
        Same as for `DenseImage`. By default depths are unknown, and no triangle counts as a step.
    """

    points: NDArray[np.float32]
    valid: NDArray[np.bool_]
    max_edge: float
    depth_step: float = math.inf
    focal: float = 0.0

    __repr__ = short_repr

    @property
    def grid(self) -> DenseGrid:
        """This grid."""
        return self

    @property
    def num_measured(self) -> int:
        """Number of measured pixels."""
        return int(np.count_nonzero(self.valid))

    @property
    def without_ray(self) -> int:
        """Number of measured pixels without a line of sight: none, as all have a point."""
        return 0


@dataclass(frozen=True, eq=False)
class DenseImage:
    """The depth image from which a sparse mesh was made.

    Attributes
    ----------
    depth : (H, W) uint16 or float32
        A copy, because cameras reuse their buffers.
    intrinsics : Intrinsics
        Camera of the depth image.
    max_edge : float
        Dense triangles with a longer edge are left out; infinite: no limit.
    depth_step : float
        Dense triangles across a step in depth are left out: the depths of their corners differ by
        more than this share of the smallest depth, and by more than on a surface that is inclined
        by 78 degrees; see `cut_depth_steps`.
    """

    depth: NDArray[np.uint16 | np.float32]
    intrinsics: Intrinsics
    max_edge: float
    depth_step: float = math.inf

    __repr__ = short_repr

    @property
    def focal(self) -> float:
        """The focal length along the axis with the coarser pixels."""
        return min(self.intrinsics.fx, abs(self.intrinsics.fy))

    @property
    def num_measured(self) -> int:
        """Number of measured pixels."""
        return int(np.count_nonzero(self.depth > 0))

    @cached_property
    def without_ray(self) -> int:
        """Number of measured pixels without a line of sight, as `num_without_ray` counts them."""
        return num_without_ray(self.depth, self.intrinsics)

    @property
    def grid(self) -> DenseGrid:
        """The points of the pixels."""
        points, valid, _ = _core.unproject(self.depth, self.intrinsics, 1)
        shape = self.depth.shape
        return DenseGrid(
            points.reshape(*shape, 3),
            valid.reshape(shape).view(np.bool_),
            self.max_edge,
            self.depth_step,
            self.focal,
        )


def num_without_ray(depth: NDArray[np.uint16 | np.float32], intrinsics: Intrinsics) -> int:
    """Return the number of measured pixels at which the lens model cannot be inverted.

    Such a pixel has no line of sight, and its depth is no point.
    """
    if intrinsics.rays is None and not any(intrinsics.distortion):
        return 0
    _, valid, _ = _core.unproject(depth, intrinsics, threads_of(0))
    return int(np.count_nonzero(depth > 0) - np.count_nonzero(valid))


Cover = tuple[float, float, float, float]
"""Shares that `DepthSimplification` calls ``coverage``, ``bridges``, ``outside``, ``filled``."""


@dataclass(frozen=True, eq=False, repr=False)
class DepthSimplification(DepthMesh):
    """A sparse mesh of a depth image or a range scan, by any method.

    Attributes
    ----------
    stop : str
        Reason why the method stopped. ``target``: at the requested number of points, or for `cs3`
        and `sample_depth` as near below as they come. ``all_points``: there are no more points.
        `Relief` lists the others.
    surface : DenseImage or DenseGrid
        The input.
    cover : (float, float, float, float) or None
        ``coverage``, ``bridges``, ``outside`` (of the pixels with a line of sight) and ``filled``,
        if the method has measured them.
    """

    stop: str
    surface: DenseImage | DenseGrid = field(repr=False)
    cover: Cover | None = field(repr=False)

    def _filled_pixels(self) -> NDArray[np.int32]:
        """Return the column and row of each pixel without measurement that the method filled."""
        return np.empty((0, 2), np.int32)

    @cached_property
    def _cover(self) -> Cover:
        if self.cover is not None:
            return self.cover
        dense = self.surface.grid
        return _core.depth_coverage(
            dense.points,
            dense.valid,
            self.pixels,
            self.faces,
            dense.max_edge,
            self.surface.depth_step,
            self.surface.focal,
            self._filled_pixels(),
        )

    @property
    def coverage(self) -> float:
        """Share of the dense surface's pixels that lie in or on a triangle of the mesh.

        The dense surface is that of `dense_mesh` with the same ``max_edge``. If faces across steps
        in depth were left out (`cut_depth_steps`), it lacks such triangles too, and a pixel that is
        a step before or behind a triangle is not covered by it. 0 without a dense surface. Computed
        on the first access, for the points before ``move_points``; until then, a grid of points
        that was given as float32 must not change.
        """
        return self._cover[0]

    @property
    def bridges(self) -> float:
        """Share of the mesh's area that lies where the dense surface has no triangle.

        Slivers between the contour's steps from pixel to pixel and the sides of triangles count;
        with few points they are most of it, a few per cent.
        """
        return self._cover[1]

    @property
    def outside(self) -> float:
        """Share of the measured pixels that no triangle of the dense surface uses.

        These are lone pixels, surfaces so steep that each of their pixels is a step, and pixels
        without a line of sight, where the lens model cannot be inverted.
        """
        without_ray = self.surface.without_ray
        if not without_ray:
            return self._cover[2]
        measured = self.surface.num_measured
        return (self._cover[2] * (measured - without_ray) + without_ray) / measured

    @property
    def filled(self) -> float:
        """Share of the mesh's area that closes pinholes on purpose, a part of ``bridges``.

        Only `relief` fills pinholes (``filled_pixels``); 0 for other methods.
        """
        return self._cover[3]

    @property
    def num_used(self) -> int:
        """Number of vertices that some triangle uses."""
        return len(np.unique(self.faces))

    def with_faces(self, faces: NDArray[np.int32]) -> Self:
        """Return the same points with other triangles; their coverage is computed when needed.

        Parameters
        ----------
        faces : (F, 3) int32
            Indices of the points.
        """
        return replace(self, faces=faces, cover=None)


@dataclass(frozen=True, eq=False, repr=False)
class Cs3Result(DepthSimplification):
    """Result of `cs3`: a sparse mesh, and how its number of points was reached.

    Attributes
    ----------
    reached : Reached
        Way in which the number of points was reached; it never exceeds the target.
    factor : float
        Factor on the radius Rd_max of eq. 3.8 (for non-maximum suppression, on the window s) that
        the search chose.
    literal_count : int or None
        Number of points by the formulas as printed, with factor 1. None if ``distance_dependent``,
        where counting them would take longer than the search for the factor.
    timings : dict of str to float, seconds
        Wall time of each stage.
    """

    reached: Reached
    factor: float
    literal_count: int | None
    timings: dict[str, float] = field(repr=False)


@checked
def dense_mesh(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    *,
    color: ArrayLike | None = None,
    registration: Registration | None = None,
    max_edge: float | None = None,
    threads: int = 0,
) -> DepthMesh:
    """Return the full mesh of a depth image, the reference for simplified meshes.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        Depth along the optical axis; 0 and NaN mean no measurement.
    intrinsics : Intrinsics
    color : (H', W', 3 or 4) uint8, optional
        Colour image of the depth image's size, or that of ``registration.color``.
    registration : Registration, optional
        Position of the colour camera; without it both images share their pixels.
    max_edge : float, metres, optional
        Triangles with a longer edge are left out.
    threads : int
        0: all cores. The result is the same for any number.

    Returns
    -------
    DepthMesh
        Its vertices are all valid pixels in row-major order. A 2x2 cell of four valid pixels has
        two triangles, cut along the shorter diagonal; a cell of three has one.

    Raises
    ------
    InputError
        Another shape or dtype, a negative or infinite depth, or an option out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> simplify.dense_mesh(np.full((48, 64), 2000, np.uint16), camera)
    <manip3d.simplify.DepthMesh: 3072 vertices, 5922 faces>
    """
    image = checked_depth(depth, intrinsics)
    picture = checked_color(color, image.shape, registration)
    threads = threads_of(threads)
    points, valid, rows_up = _core.unproject(image, intrinsics, threads)
    fields = _core.grid_mesh(
        points.reshape(*image.shape, 3),
        valid.reshape(image.shape).view(np.bool_),
        rows_up,
        limit_of(max_edge),
        registration,
        threads,
    )
    return DepthMesh(**fields, color=picture)


@checked
def dense_mesh_grid(
    points: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    color: ArrayLike | None = None,
    rows_up: bool = True,
    max_edge: float | None = None,
    threads: int = 0,
) -> DepthMesh:
    """Return the full mesh of a range scan; see `dense_mesh`.

    Parameters
    ----------
    points : (H, W, 3) float
        Same as for `manip3d.io.read_range_grid`. Rounded to float32.
    valid : (H, W) bool, optional
        Default: where all three coordinates are finite.
    color : (H, W, 3 or 4) uint8, optional
    rows_up : bool
        Whether rows go upward as seen from the sensor (Stanford's scans), not downward (images).
        This decides which side of the surface is the front.
    max_edge : float, optional
        In the unit of the points.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    DepthMesh

    Raises
    ------
    InputError
        Same as for `dense_mesh`; a valid point is not finite.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> v, u = np.mgrid[0.0:3, 0:4]
    >>> scan = np.stack([u, v, 0 * u], axis=-1)
    >>> manip3d.simplify.dense_mesh_grid(scan).num_faces
    12
    """
    grid, mask = checked_grid(points, valid)
    picture = checked_color(color, mask.shape)
    threads = threads_of(threads)
    fields = _core.grid_mesh(grid, mask, bool(rows_up), limit_of(max_edge), None, threads)
    return DepthMesh(**fields, color=picture)


@dataclass(frozen=True, eq=False)
class _Buffers:
    """Arrays for a mesh of up to ``len(vertices)`` vertices, into which the core writes."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    pixels: NDArray[np.int32]
    texcoords: NDArray[np.float32]

    @staticmethod
    def of_size(capacity: int) -> _Buffers:
        return _Buffers(
            np.empty((capacity, 3), np.float32),
            np.empty((2 * capacity, 3), np.int32),
            np.empty((capacity, 2), np.int32),
            np.empty((capacity, 2), np.float32),
        )


def _options(
    target_points: int,
    variant: Variant,
    max_edge: float | None,
    distance_dependent: bool,
    threads: int,
    reading: dict[str, str | float] | None,
) -> _core.Cs3Options:
    options = _core.Cs3Options()
    options.target_points = count_of(target_points, "target_points")
    if options.target_points < 1:
        raise InputError(f"target_points: expected >= 1, got {target_points}")
    options.importance, options.sampling = _VARIANTS[variant]
    expect_radii(variant, distance_dependent, "distance_dependent")
    options.max_edge = limit_of(max_edge)
    options.distance_dependent = bool(distance_dependent)
    options.num_threads = threads_of(threads)
    if reading:
        options.reading = _reading(reading)
    return options


def expect_radii(variant: Variant, by_distance: bool, name: str) -> None:
    """Refuse an option that scales the radii of sampling by order (eq. 3.9) with another sampling.

    ``name`` is the option's name in the error.
    """
    if by_distance and variant not in ("cios", "lios"):
        raise InputError(f"{name}, variant: expected the variant cios or lios, got {variant}")


_READINGS: dict[str, Any] = {
    "stencil": _core.Cs3Stencil,
    "beside_invalid": _core.Cs3BesideInvalid,
    "rounding": _core.Cs3Rounding,
}


def _reading(choices: dict[str, str | float]) -> _core.Cs3Reading:
    reading = _core.Cs3Reading()
    for name, value in choices.items():
        if name == "outliers":
            is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not is_number:
                raise InputError(f"reading: expected a number for outliers, got {value!r}")
            reading.outliers = float(value)
        elif name not in _READINGS:
            raise InputError(f"reading: expected {', '.join([*_READINGS, 'outliers'])}: {name!r}")
        else:
            members = _READINGS[name].__members__
            if str(value).upper() not in members:
                known = ", ".join(member.lower() for member in members)
                raise InputError(f"reading: expected one of {known} for {name}, got {value!r}")
            setattr(reading, name, members[str(value).upper()])
    return reading


def _result(
    report: dict[str, Any],
    buffers: _Buffers,
    color: NDArray[np.uint8] | None,
    surface: DenseImage | DenseGrid,
) -> Cs3Result:
    vertices, faces = report["num_vertices"], report["num_faces"]
    reached = Reached[report["reached"].name]
    return Cs3Result(
        vertices=buffers.vertices[:vertices],
        faces=buffers.faces[:faces],
        pixels=buffers.pixels[:vertices],
        texcoords=buffers.texcoords[:vertices],
        color=color,
        stop="all_points" if reached is Reached.ALL_PIXELS else "target",
        surface=surface,
        cover=None,
        reached=reached,
        factor=report["factor"],
        literal_count=report["literal_count"],
        timings=report["timings"],
    )


@checked
class Cs3Stream:
    """Apply `cs3` to the frames of a sequence, and reuse the memory of earlier frames.

    Parameters
    ----------
    target_points : int
        Largest number of vertices of each frame.
    variant, max_edge, distance_dependent, reading
        Same as for `cs3`.
    threads : int
        0: all cores. The result is the same for any number.
    frames : int, optional
        Reuse the arrays of this many results in turn: a result is then valid until as many more
        frames have been simplified, and with one thread the core allocates nothing. Default: new
        arrays for each frame.

    Notes
    -----
    The result of a frame depends on this frame alone, and has the same bytes as that of `cs3`.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> camera = manip3d.Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> stream = manip3d.simplify.Cs3Stream(100, frames=2)
    >>> [stream.simplify(np.full((48, 64), z, np.uint16), camera).num_vertices for z in (900, 950)]
    [100, 100]
    """

    def __init__(
        self,
        target_points: int,
        *,
        variant: Variant = "cios",
        max_edge: float | None = None,
        distance_dependent: bool = False,
        threads: int = 1,
        reading: dict[str, str | float] | None = None,
        frames: int | None = None,
    ) -> None:
        self._options = _options(
            target_points, variant, max_edge, distance_dependent, threads, reading
        )
        self._core = _core.Cs3Runner()
        self._pool: list[_Buffers | None] = [None] * (count_of(frames, "frames") if frames else 0)
        self._next = 0
        self._lock = threading.RLock()

    def __repr__(self) -> str:
        points = counted(self._options.target_points, "point")
        return f"<manip3d.simplify.Cs3Stream: {points} a frame>"

    def _buffers(self, shape: tuple[int, ...]) -> _Buffers:
        capacity = min(self._options.target_points, shape[0] * shape[1])
        if not self._pool:
            return _Buffers.of_size(capacity)
        buffers = self._pool[self._next]
        if buffers is None or len(buffers.vertices) < capacity:
            buffers = self._pool[self._next] = _Buffers.of_size(capacity)
        self._next = (self._next + 1) % len(self._pool)
        return buffers

    def simplify(
        self,
        depth: ArrayLike,
        intrinsics: Intrinsics,
        *,
        color: ArrayLike | None = None,
        registration: Registration | None = None,
    ) -> Cs3Result:
        """Simplify a depth image; see `cs3`.

        Parameters
        ----------
        depth, intrinsics, color, registration
            Same as for `cs3`.

        Returns
        -------
        Cs3Result
        """
        image = checked_depth(depth, intrinsics)
        picture = checked_color(color, image.shape, registration)
        surface = DenseImage(image.copy(), intrinsics, self._options.max_edge)
        with self._lock:
            buffers = self._buffers(image.shape)
            report = self._core.run_depth(image, intrinsics, self._options, registration, buffers)
            return _result(report, buffers, picture, surface)

    def simplify_grid(
        self,
        points: ArrayLike,
        valid: ArrayLike | None = None,
        *,
        color: ArrayLike | None = None,
        rows_up: bool = True,
    ) -> Cs3Result:
        """Simplify a grid of points; see `cs3_grid`.

        Parameters
        ----------
        points, valid, color, rows_up
            Same as for `cs3_grid`.

        Returns
        -------
        Cs3Result
        """
        grid, mask = checked_grid(points, valid, kept=True)
        picture = checked_color(color, mask.shape)
        surface = DenseGrid(grid, mask, self._options.max_edge)
        with self._lock:
            buffers = self._buffers(mask.shape)
            report = self._core.run_grid(grid, mask, bool(rows_up), self._options, buffers)
            return _result(report, buffers, picture, surface)


@checked
def cs3(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    target_points: int,
    *,
    color: ArrayLike | None = None,
    registration: Registration | None = None,
    mask: ArrayLike | None = None,
    variant: Variant = "cios",
    max_edge: float | None = None,
    depth_step: float | None = None,
    distance_dependent: bool = False,
    threads: int = 0,
    reading: dict[str, str | float] | None = None,
) -> Cs3Result:
    """Simplify a depth image by its curvature (CS3, dissertation chapter 3).

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        Depth along the optical axis; 0 and NaN mean no measurement.
    intrinsics : Intrinsics
    target_points : int
        Largest number of vertices. The result has at least 99 % of it if the image has as many
        measured pixels.
    color : (H', W', 3 or 4) uint8, optional
        Colour image of the depth image's size, or that of ``registration.color``.
    registration : Registration, optional
        Position of the colour camera; without it both images share their pixels.
    mask : (H, W) bool, optional
        Pixels to use; the others count as not measured.
    variant : 'cios', 'lios', 'cnms' or 'lnms'
        Importance by the smaller eigenvalue of the Hessian (C) or by the Laplacian (L); sampling
        by importance order (IOS) or by non-maximum suppression (NMS). CS3 is CIOS.
    max_edge : float, metres, optional
        Triangles with a longer edge are left out, which separates the objects of a scene.
    depth_step : float, optional
        Triangles across a larger step in depth, as a share of the depth, are left out by
        `cut_depth_steps`.
    distance_dependent : bool
        Put more points on nearer surfaces: radii are scaled by depth / largest depth (eq. 3.9).
        Only with ``'cios'`` and ``'lios'``, because non-maximum suppression has no radii.
    threads : int
        0: all cores. The result is the same for any number.
    reading : dict, optional
        Other interpretations of details that the dissertation leaves open, to measure their effect:
        ``stencil`` of the derivatives (``'gradient_of_gradient'``, ``'compact'``, ``'forward'``,
        ``'sobel'``), derivatives ``beside_invalid`` pixels (``'backward'``, ``'zero'``,
        ``'unknown'``), ``rounding`` of radii (``'down'``, ``'nearest'``, ``'up'``), and
        ``outliers`` (share of the pixels above the largest importance).

    Returns
    -------
    Cs3Result
        Vertices are points of the image, unmoved. Some may have no triangle, where all triangles
        around them were left out.

    Raises
    ------
    InputError
        Another shape or dtype, a negative or infinite depth, or an option out of range.

    Notes
    -----
    Points are chosen by decreasing importance (eq. 3.6). Each excludes other points from a square
    around it, whose radius is given by eq. 3.8. As printed, the equations give about half of the
    requested points (``literal_count``); therefore the method searches a ``factor`` on the radius
    that gives the target. The Delaunay triangulation of the pixels is exact and unique
    (`grid_delaunay`); triangles whose centroid is a pixel without depth are left out.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> camera = manip3d.Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> v, u = np.mgrid[0:48, 0:64]
    >>> depth = (1.0 + 0.2 * np.hypot((u - 32) / 32, (v - 24) / 24)).astype(np.float32)
    >>> result = manip3d.simplify.cs3(depth, camera, 200)
    >>> 198 <= result.num_vertices <= 200
    True
    """
    stream = Cs3Stream(
        target_points,
        variant=variant,
        max_edge=max_edge,
        distance_dependent=distance_dependent,
        threads=threads,
        reading=reading,
    )
    if depth_step is not None and not depth_step > 0:
        raise InputError(f"depth_step: expected > 0, got {depth_step}")
    image = checked_depth(depth, intrinsics)
    image = masked_depth(image, mask_image(mask, image.shape))
    found = stream.simplify(image, intrinsics, color=color, registration=registration)
    if depth_step is None or math.isinf(depth_step):
        return found
    from manip3d.simplify._depth_steps import cut_depth_steps  # imports this module

    return cut_depth_steps(found, image, step=depth_step)


@checked
def cs3_grid(
    points: ArrayLike,
    valid: ArrayLike | None,
    target_points: int,
    *,
    color: ArrayLike | None = None,
    rows_up: bool = True,
    variant: Variant = "cios",
    max_edge: float | None = None,
    threads: int = 0,
    reading: dict[str, str | float] | None = None,
) -> Cs3Result:
    """Simplify a grid of points that is not a pinhole image, such as a range scan; see `cs3`.

    Parameters
    ----------
    points : (H, W, 3) float
        Same as for `manip3d.io.read_range_grid`. Rounded to float32.
    valid : (H, W) bool, optional
        None: where all three coordinates are finite.
    target_points : int
        Largest number of vertices.
    color : (H, W, 3 or 4) uint8, optional
    rows_up : bool
        Same as for `dense_mesh_grid`.
    variant, max_edge, threads, reading
        Same as for `cs3`; ``max_edge`` in the unit of the points.

    Returns
    -------
    Cs3Result

    Raises
    ------
    InputError
        Same as for `cs3`; a valid point is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> y, x = np.mgrid[0:40, 0:40] * 0.01
    >>> points = np.stack([x, -y, 1 + 0.1 * np.sin(6 * x)], axis=2)
    >>> simplify.cs3_grid(points, None, 100).num_vertices
    100
    """
    stream = Cs3Stream(
        target_points, variant=variant, max_edge=max_edge, threads=threads, reading=reading
    )
    return stream.simplify_grid(points, valid, color=color, rows_up=rows_up)


@checked
def grid_delaunay(pixels: ArrayLike) -> NDArray[np.int32]:
    """Return the Delaunay triangulation of distinct pixels: exact, and unique if cocircular.

    Parameters
    ----------
    pixels : (N, 2) int
        Column u and row v, 0 to 16383, in any order.

    Returns
    -------
    (T, 3) int32
        Counter-clockwise for u to the right and v up. Empty for fewer than three pixels and for
        pixels on a line. If four pixels lie on an otherwise empty circle, the diagonal joins the
        two neighbours of the last one in row-major order (symbolic perturbation).

    Raises
    ------
    InputError
        A pixel is repeated or out of range.

    Examples
    --------
    >>> import manip3d
    >>> manip3d.simplify.grid_delaunay([[0, 0], [1, 0], [0, 1], [1, 1]]).tolist()
    [[0, 1, 2], [2, 1, 3]]

    It makes a mesh of all pixels of a sparse depth image, such as LiDAR points projected into a
    camera. The faces are reversed so that they face the camera:

    >>> import numpy as np
    >>> depth = np.zeros((48, 64), np.float32)
    >>> depth[::5, ::7] = 2.0
    >>> camera = manip3d.Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> v, u = np.nonzero(depth)
    >>> faces = manip3d.simplify.grid_delaunay(np.stack([u, v], axis=1))
    >>> mesh = manip3d.Mesh(camera.unproject(depth)[v, u], faces[:, ::-1])
    >>> mesh.num_vertices, mesh.num_faces
    (100, 162)
    """
    no_edges = np.empty((0, 2), np.int32)
    faces: NDArray[np.int32] = _core.grid_delaunay(index_rows(pixels, 2, "pixels"), no_edges)
    return faces
