"""Simplify the depth images of several calibrated cameras to one mesh, overlaps only once."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from manip3d import _core
from manip3d._util.arrays import checked_grid, rows
from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.options import threads_of
from manip3d._util.showing import Showable
from manip3d.camera import Intrinsics, Registration, checked_depth
from manip3d.errors import InputError
from manip3d.io._images import png_bytes
from manip3d.mesh import Material, Mesh, Texture
from manip3d.simplify._arguments import checked_color, count_of, limit_of
from manip3d.simplify._bandwidth import MIN_POINTS
from manip3d.simplify._depth import (
    Cs3Result,
    DenseGrid,
    DepthSimplification,
    Variant,
    cs3_grid,
    with_materials,
)
from manip3d.simplify._depth_steps import StepRule, across_gaps, across_steps
from manip3d.simplify._pixel_maps import confidence_image, mask_image, masked_depth
from manip3d.simplify._relief import Effort, Relief, relief_options, run_relief

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_PLACES = 20_000  # sampled points of `bridges`: a standard error of at most 0.004
_MAX_COMPARED = 20_000  # pixels of a view; a share of 1 % is known to within 0.1 %

__all__ = ["CameraView", "JointSimplification", "cs3_cameras", "relief_cameras"]

Report = Callable[[float], object]
"""Takes the share of the work that is done."""


def silent(fraction: float) -> None:
    """Report nothing."""


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
        Confidence of each pixel, as for `relief`; only `relief_cameras` uses it.
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


@dataclass(frozen=True, eq=False)
class JointSimplification(Showable):
    """One mesh of several views.

    Attributes
    ----------
    vertices : (n, 3) float64
        Measured points in the shared frame; they differ from the input only by their view's pose.
    faces : (m, 3) int32
        Vertices of each triangle.
    vertex_view : (n,) int32
        The view that measured each vertex.
    pixels : (n, 2) int32
        Column and row of each vertex in that view.
    face_view : (m,) int32
        The view in which each triangle was made, and whose colour image is its texture.
    corner_texcoords : (m, 3, 2) float32
        Texture coordinates of each triangle's corners in that image, v up; NaN: outside of it.
    covered : tuple of (H, W) bool
        For each view, True at valid pixels whose surface earlier views had already sampled.
    views : tuple of DepthSimplification
        The simplification of each view, before the views were joined.
    colors : tuple of ((H', W', 3) uint8 or None)
        Colour image of each view, if it has one.
    """

    vertices: NDArray[np.float64] = field(repr=False)
    faces: NDArray[np.int32] = field(repr=False)
    vertex_view: NDArray[np.int32] = field(repr=False)
    pixels: NDArray[np.int32] = field(repr=False)
    face_view: NDArray[np.int32] = field(repr=False)
    corner_texcoords: NDArray[np.float32] = field(repr=False)
    covered: tuple[NDArray[np.bool_], ...] = field(repr=False)
    views: tuple[DepthSimplification, ...] = field(repr=False)
    colors: tuple[NDArray[np.uint8] | None, ...] = field(repr=False)
    _measured: tuple[tuple[_View, float], ...] = field(repr=False)
    _threads: int = field(repr=False)
    _steps: _GapRules = field(repr=False)

    @property
    def num_vertices(self) -> int:
        """Number of vertices."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    @property
    def num_measured(self) -> int:
        """Number of measured pixels of all views."""
        return sum(int(view.valid.sum()) for view, _ in self._measured)

    @cached_property
    def bridges(self) -> float:
        """Share of the area that is farther than the ``tolerance`` from each view's dense mesh.

        Estimated at 20 000 points spread evenly over the area, on the first access. The dense
        meshes lack the triangles that ``max_edge`` and ``depth_step`` leave out.
        """
        if not self.num_faces:
            return 0.0
        places = _spread(self.vertices, self.faces)
        for view, tolerance in self._measured:
            max_edge = self._steps.max_edge
            dense = _core.grid_mesh(
                view.points, view.valid, view.rows_up, max_edge, None, self._threads
            )
            faces = self._steps.surface(view, dense["faces"])
            if len(faces) and len(places):
                mesh = Mesh(view.world, faces)
                _, face, _ = _core.closest_points(mesh, places, tolerance, self._threads, None)
                places = np.ascontiguousarray(places[face < 0])
        return len(places) / _PLACES

    @cached_property
    def coverage(self) -> float:
        """Share of the measured pixels of all views that lie within the ``tolerance`` of the mesh.

        Computed on the first access.
        """
        total = self.num_measured
        if total == 0 or not self.num_faces:
            return 0.0
        mesh = Mesh(self.vertices, self.faces)
        covered = 0
        for view, tolerance in self._measured:
            if view.valid.any():
                _, face, _ = _core.closest_points(mesh, view.world, tolerance, self._threads, None)
                covered += int(np.count_nonzero(face >= 0))
        return covered / total

    @cached_property
    def mesh(self) -> Mesh:
        """The result as a `Mesh`; views with colour are materials with textures (PNG).

        Faces with a corner that the view's colour camera cannot see have no texture.
        """
        textured: NDArray[np.bool_] = np.asarray(
            np.isfinite(self.corner_texcoords[..., 0]).all(axis=1)
        )
        # Equal texture coordinates at a vertex are stored once: formats that store a vertex for
        # each pair (such as glTF) would be several times as large otherwise.
        wedges = np.column_stack(
            [self.faces[textured].reshape(-1), self.corner_texcoords[textured].reshape(-1, 2)]
        )
        wedges, corners = np.unique(wedges, axis=0, return_inverse=True)
        face_texcoords = np.full((self.num_faces, 3), -1, np.int32)
        face_texcoords[textured] = corners.reshape(-1, 3)
        mesh = Mesh(
            self.vertices,
            self.faces,
            texcoords=wedges[:, 1:].astype(np.float32),
            face_texcoords=face_texcoords,
        )
        if all(color is None for color in self.colors):
            return mesh
        materials = tuple(
            Material(
                f"view {i}",
                textures={} if c is None else {"base_color": Texture(data=png_bytes(c))},
            )
            for i, c in enumerate(self.colors)
        )
        return with_materials(mesh, self.face_view, materials, textured)


@dataclass
class _View:
    """A checked view as a grid of points, with its pose in the shared frame."""

    points: NDArray[np.float32]
    valid: NDArray[np.bool_]
    rows_up: bool
    pose: NDArray[np.float64]
    color: NDArray[np.uint8] | None
    registration: Registration | None
    confidence: NDArray[np.float32] | None
    focal: float = 0.0  # focal length, pixels; 0: the view was given as points

    @cached_property
    def world(self) -> NDArray[np.float64]:
        """(N, 3) points of the valid pixels, in row-major order."""
        local = self.points[self.valid].astype(np.float64)
        moved: NDArray[np.float64] = product(local, self.pose[:3, :3].T) + self.pose[:3, 3]
        return moved


def _checked_view(view: CameraView, index: int, threads: int) -> _View:
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
        and np.linalg.det(rotation) > 0
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
        return _View(points, valid, bool(view.rows_up), pose, color, None, confidence)
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
    return _View(points, valid, rows_up, pose, color, view.registration, confidence, focal)


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


def _spread(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return `_PLACES` points, spread evenly over the area of the faces.

    Faces are chosen at equal steps of the accumulated area, and the place within a face by the R2
    low-discrepancy sequence [Roberts, "The unreasonable effectiveness of quasirandom sequences",
    2018], whose steps are powers of 1/g, g the real root of g^3 = g + 1.
    """
    areas = np.linalg.norm(_normals(vertices, faces), axis=1)
    step = (np.arange(_PLACES) + 0.5) / _PLACES * areas.sum()
    face = np.minimum(np.searchsorted(np.cumsum(areas), step), len(faces) - 1)
    number = np.arange(1, _PLACES + 1)[:, None]
    share = np.mod(number * np.array([0.7548776662466927, 0.5698402909980532]), 1.0)  # 1/g, 1/g^2
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    p, q, r = (vertices[faces[face, i]] for i in range(3))
    places: NDArray[np.float64] = p + share[:, :1] * (q - p) + share[:, 1:] * (r - p)
    return places


def _normals(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the normals of faces, each as long as twice the area."""
    p, q, r = (points[faces[:, i]] for i in range(3))
    normals: NDArray[np.float64] = np.cross(q - p, r - p)
    return normals


def _num_inside(corners: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the number of pixels strictly inside each triangle, by Pick's theorem.

    ``corners``: (n, 3, 2) pixels.
    """
    sides = np.roll(corners, -1, axis=1).astype(np.int64) - corners
    doubled_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    on_sides = np.gcd(sides[..., 0], sides[..., 1]).sum(axis=1)
    inside: NDArray[np.int64] = (doubled_area - on_sides + 2) // 2
    return inside


@dataclass(frozen=True)
class _GapRules:
    """Rules by which triangles of a view span a step in depth, or a gap.

    ``step`` and ``max_edge`` are those of `cs3_cameras`; None and infinity: no limit.
    """

    step: float | None
    max_edge: float

    def apart(
        self, view: _View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return which triangles bridge a gap in the depth image larger than ``max_edge``."""
        if math.isinf(self.max_edge) or not len(corners):
            return np.zeros(len(corners), bool)
        return across_gaps(corners, pixels, view.points, view.valid, self.max_edge)

    def across(
        self, view: _View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return which triangles of the sparse mesh span a step."""
        if self.step is None or view.focal == 0 or not len(corners):
            return np.zeros(len(corners), bool)
        image = np.where(view.valid, view.points[..., 2], np.float32(0))
        surface = DenseGrid(view.points, view.valid, self.max_edge, self.step, view.focal)
        rule = StepRule.of(self.step, view.focal)
        return across_steps(np.ascontiguousarray(corners), pixels, image, rule, surface)

    def across_between(
        self, view: _View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return which triangles of a seam, made without regard to steps, span a step.

        Besides those of `across`, triangles that have a side across a step and no pixel inside:
        `across` cannot judge these, because all pixels that they cover may be on their other sides,
        which lie on the surface.
        """
        found = self.across(view, pixels, corners)
        if self.step is None or view.focal == 0 or not len(corners):
            return found
        image = np.where(view.valid, view.points[..., 2], np.float32(0))
        rule = StepRule.of(self.step, view.focal)
        crosses = across_steps(np.ascontiguousarray(corners), pixels, image, rule, None)
        return np.asarray(found | (crosses & (_num_inside(pixels[corners]) == 0)))

    def surface(self, view: _View, faces: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the triangles of the dense mesh that do not span a step."""
        if self.step is None or view.focal == 0:
            return faces
        z = view.points[view.valid][:, 2][faces]
        rule = StepRule.of(self.step, view.focal)
        return np.ascontiguousarray(faces[~rule.differ(z.min(axis=1), z.max(axis=1))])


class _Surface:
    """A mesh in the shared frame that points are compared with."""

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        self.mesh = Mesh(vertices, faces)
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        keys = edges[:, 0].astype(np.int64) * len(vertices) + edges[:, 1]
        _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        self.on_boundary = (counts[inverse] == 1).reshape(-1, 3)  # edge i: corners i, i + 1
        self.boundary = np.unique(edges[self.on_boundary.ravel()])

    def covers(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        tolerance: float | NDArray[np.float64],
        threads: int,
    ) -> NDArray[np.bool_]:
        """Return which points lie on the surface.

        Such a point is within the tolerance, its normal faces as the surface does, and its closest
        point is not on the border, beyond which the surface is unknown.
        """
        if not len(points) or not self.mesh.num_faces:
            return np.zeros(len(points), bool)
        distance, face, foot = _core.closest_points(
            self.mesh, points, float(np.max(tolerance)), threads, None
        )
        covered: NDArray[np.bool_] = distance <= tolerance
        near = np.flatnonzero(covered)
        face, foot = face[near], foot[near]
        of_faces = _normals(self.mesh.vertices, self.mesh.faces[face])
        same_side = np.einsum("ij,ij->i", of_faces, normals[near]) > 0
        covered[near] = same_side & ~self._on_border(face, foot, of_faces)
        return covered

    def _on_border(
        self, face: NDArray[np.int32], foot: NDArray[np.float64], normals: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return whether each closest point ``foot`` lies on an edge that has one face only.

        ``normals`` are those of ``face``, each as long as twice the area.
        """
        corners = self.mesh.vertices[self.mesh.faces[face]]
        double_area = np.linalg.norm(normals, axis=1)
        on_border = np.zeros(len(face), bool)
        for i in range(3):
            p, q = corners[:, i], corners[:, (i + 1) % 3]
            # On the edge this triangle has no area: its share is a barycentric coordinate.
            part = np.linalg.norm(np.cross(q - p, foot - p), axis=1)
            on_border |= self.on_boundary[face, i] & (part <= 1e-6 * double_area)
        return on_border


def _pixel_normals(view: _View) -> NDArray[np.float64]:
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


def _spacing(view: _View) -> float:
    """Return the median distance of valid pixels from the next valid pixel in their row."""
    both = view.valid[:, 1:] & view.valid[:, :-1]
    steps = (view.points[:, 1:] - view.points[:, :-1])[both]
    return float(np.median(np.linalg.norm(steps, axis=1))) if len(steps) else 0.0


def _own_vertices(
    chosen: DepthSimplification, border_pixels: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return which vertices of a view to add: one for each pixel without a border vertex."""
    _, first = np.unique(_pixel_keys(chosen.pixels), return_index=True)
    own = np.zeros(chosen.num_vertices, bool)
    own[first] = True  # a relief has two vertices where two fans of triangles meet
    own &= ~np.isin(_pixel_keys(chosen.pixels), _pixel_keys(border_pixels))
    return own


def _in_world(view: _View, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
    """Transform vertices of a view to the shared frame."""
    moved: NDArray[np.float64] = product(vertices.astype(np.float64), view.pose[:3, :3].T)
    return moved + view.pose[:3, 3]


def _centroids(pixels: NDArray[np.int32], corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the pixel at the centroid of each triangle, rounded."""
    centroids: NDArray[np.int32] = (2 * pixels[corners].sum(axis=1) + 3) // 6
    return centroids


def _triangles_between(
    view: _View, pixels: NDArray[np.int32], open_pixels: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Triangulate pixels (Delaunay), and keep triangles whose centroid is an open pixel.

    The triangles face the camera.
    """
    corners: NDArray[np.int32] = _core.grid_delaunay(np.ascontiguousarray(pixels))
    centroids = _centroids(pixels, corners)
    corners = corners[open_pixels[centroids[:, 1], centroids[:, 0]]]
    return corners if view.rows_up else corners[:, [0, 2, 1]]


def _is_turned_right(
    vertices: NDArray[np.float64],
    pixels: NDArray[np.int32],
    corners: NDArray[np.int32],
    num_border: int,
    normals: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return which triangles face as the surface at their centroid does.

    Only triangles of the seam, with one of the first ``num_border`` vertices, can face away: a
    border vertex is triangulated at the pixel nearest to it, not exactly where the view sees it, so
    that a sliver may turn over.
    """
    seam = (corners < num_border).any(axis=1)
    centroids = _centroids(pixels, corners)
    facing = _normals(vertices, corners) * normals[centroids[:, 1], centroids[:, 0]]
    is_right: NDArray[np.bool_] = ~seam | (facing.sum(axis=1) > 0)
    return is_right


class _JoinedMesh:
    """The mesh of the views that were joined so far; fields as in `JointSimplification`."""

    def __init__(self) -> None:
        self.vertices = np.empty((0, 3))
        self.faces = np.empty((0, 3), np.int32)
        self.vertex_view = np.empty(0, np.int32)
        self.pixels = np.empty((0, 2), np.int32)
        self.face_view = np.empty(0, np.int32)
        self.corner_texcoords = np.empty((0, 3, 2), np.float32)

    def border_in(
        self, dense: Mesh, pixel_of: NDArray[np.int32], tolerance: float, threads: int
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the border vertices within ``tolerance`` of a view's dense mesh, and their pixels.

        ``pixel_of`` gives the pixel of each vertex of ``dense``. Of border vertices at the same
        pixel the first one is returned.
        """
        if not len(self.faces) or not dense.num_faces:
            return np.empty(0, np.int32), np.empty((0, 2), np.int32)
        border = _Surface(self.vertices, self.faces).boundary.astype(np.int32)
        _, face, foot = _core.closest_points(
            dense, np.ascontiguousarray(self.vertices[border]), tolerance, threads, None
        )
        near = face >= 0
        border, corners, foot = border[near], dense.faces[face[near]], foot[near]
        gaps = np.linalg.norm(dense.vertices[corners] - foot[:, None], axis=2)
        pixels = pixel_of[corners[np.arange(len(corners)), gaps.argmin(axis=1)]]
        _, first = np.unique(_pixel_keys(pixels), return_index=True)
        return border[first], pixels[first]

    def add(
        self,
        index: int,
        view: _View,
        chosen: DepthSimplification,
        open_pixels: NDArray[np.bool_],
        border: tuple[NDArray[np.int32], NDArray[np.int32]],
        normals: NDArray[np.float64],
        steps: _GapRules,
    ) -> None:
        """Triangulate the chosen pixels of a view together with the border, and append them.

        ``border`` is the result of `border_in`. Without a border, a relief keeps its triangles.
        """
        if isinstance(chosen, Relief) and not len(border[0]):
            whole = ~steps.across(view, chosen.pixels, chosen.faces)
            self._append(index, view, chosen.with_faces(chosen.faces[whole]))
            return
        own = _own_vertices(chosen, border[1])
        pixels = np.concatenate([border[1], chosen.pixels[own]])
        new = np.arange(len(self.vertices), len(self.vertices) + own.sum(), dtype=np.int32)
        vertex = np.concatenate([border[0], new])
        world = _in_world(view, chosen.vertices[own])
        vertices = np.concatenate([self.vertices, world])
        corners = _triangles_between(view, pixels, open_pixels)
        keep = self._fits(vertex[corners])
        keep &= _is_turned_right(vertices[vertex], pixels, corners, len(border[0]), normals)
        if isinstance(chosen, Relief):
            # The limit holds for edges between neighbouring pixels, not for those of the relief.
            keep &= ~steps.apart(view, pixels, corners)
        elif steps.max_edge < math.inf:
            faces = vertex[corners]
            sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
            keep &= np.linalg.norm(sides, axis=2).max(axis=1) <= steps.max_edge
        across = steps.across_between if isinstance(chosen, Relief) else steps.across
        keep &= ~across(view, pixels, corners)
        corners = corners[keep]
        if isinstance(chosen, Relief):
            seam = (corners < len(border[0])).any(axis=1)
            corners[~seam] = self._flipped(view, pixels, corners[~seam])
            corners = corners[~(across(view, pixels, corners) | steps.apart(view, pixels, corners))]
        texcoords = _uvs(view, vertices[vertex], pixels)[corners]
        self._extend(index, world, vertex[corners], chosen.pixels[own], texcoords)

    def _append(self, index: int, view: _View, chosen: DepthSimplification) -> None:
        """Append a view with its own triangles; it shares no vertex with the mesh so far."""
        world = _in_world(view, chosen.vertices)
        texcoords = _uvs(view, world, chosen.pixels)[chosen.faces]
        faces = chosen.faces + np.int32(len(self.vertices))
        self._extend(index, world, faces, chosen.pixels, texcoords)

    def _extend(
        self,
        index: int,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        pixels: NDArray[np.int32],
        corner_texcoords: NDArray[np.float32],
    ) -> None:
        """Append the new vertices and faces of a view."""
        self.vertices = np.concatenate([self.vertices, vertices])
        self.faces = np.concatenate([self.faces, faces])
        self.vertex_view = np.concatenate(
            [self.vertex_view, np.full(len(vertices), index, np.int32)]
        )
        self.pixels = np.concatenate([self.pixels, pixels])
        self.face_view = np.concatenate([self.face_view, np.full(len(faces), index, np.int32)])
        self.corner_texcoords = np.concatenate([self.corner_texcoords, corner_texcoords])

    @staticmethod
    def _flipped(
        view: _View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """Flip edges between triangles of the view's own pixels, as a relief does."""
        return _core.relief_flip_edges(
            view.points, view.valid, view.rows_up, pixels, corners, view.confidence
        )

    def _fits(self, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which new faces to keep, so that no edge has more than two faces.

        Of too many, the first ones stay.
        """
        old, old_counts = np.unique(_edge_keys(self.faces), return_counts=True)
        new = _edge_keys(faces)
        order = np.argsort(new, kind="stable")
        ordered = new[order]
        place = np.searchsorted(old, ordered)
        place[place == len(old)] = 0
        before = np.zeros(len(new), np.int64)
        if len(old):
            before = np.where(old[place] == ordered, old_counts[place], 0)
        nth = np.arange(len(new)) - np.searchsorted(ordered, ordered)
        fits = np.empty(len(new), bool)
        fits[order] = before + nth < 2
        return fits[0::3] & fits[1::3] & fits[2::3]


def _pixel_keys(pixels: NDArray[np.int32]) -> NDArray[np.int64]:
    keys: NDArray[np.int64] = pixels[:, 1].astype(np.int64) << 32 | pixels[:, 0]
    return keys


def _edge_keys(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    keys: NDArray[np.int64] = edges[:, 0] << 32 | edges[:, 1]
    return keys


def _uvs(view: _View, world: NDArray[np.float64], pixels: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the texture coordinates of vertices in the view's colour image."""
    if view.registration is not None:
        local = product(world - view.pose[:3, 3], view.pose[:3, :3])
        texcoords: NDArray[np.float32] = _core.registered_texcoords(
            np.ascontiguousarray(local, dtype=np.float32), view.registration
        )
        return texcoords
    height, width = view.valid.shape
    u, v = pixels.T
    return np.column_stack([(u + 0.5) / width, 1 - (v + 0.5) / height]).astype(np.float32)


@checked
def cs3_cameras(
    views: Sequence[CameraView],
    target_points: int,
    *,
    variant: Variant = "cios",
    max_edge: float | None = None,
    depth_step: float | None = None,
    tolerance: float | None = None,
    threads: int = 0,
) -> JointSimplification:
    """Simplify the views of several calibrated cameras to one mesh, overlaps only once.

    Parameters
    ----------
    views : sequence of CameraView
        Where several views show the same surface, the earliest one is sampled.
    target_points : int
        Largest number of vertices of all views together. Each view gets a share in proportion to
        its pixels whose surface no earlier view shows.
    variant, max_edge, threads
        As for `cs3`.
    depth_step : float, optional
        Triangles across a larger step in the depth of a view are left out. The step is a share of
        the depth (`cut_depth_steps` states the rule). Views given as points have no steps.
    tolerance : float, optional, in the units of the points (metres for depth)
        Surfaces of two views that face the same way count as the same surface up to this distance.
        Default: five times the median distance of neighbouring pixels of the view.

    Returns
    -------
    JointSimplification

    Raises
    ------
    InputError
        No view, or one of them is not as `CameraView` says.

    Notes
    -----
    The views are added to the mesh one by one. Pixels of a view whose surface the mesh already
    covers are left out, and the others are simplified by `cs3`. They are triangulated together with
    the border vertices of the mesh that the view sees, at the pixels where it sees them: the seam
    is closed with shared vertices. A triangle is kept if the pixel at its centroid is not covered.
    Section 8.3 of the dissertation names this as future work.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> wall = np.full((48, 64), 2000, np.uint16)
    >>> beside = np.eye(4)
    >>> beside[0, 3] = 0.5  # half a metre to the right
    >>> views = [simplify.CameraView(wall, camera), simplify.CameraView(wall, camera, pose=beside)]
    >>> simplify.cs3_cameras(views, 200).mesh.num_vertices
    198
    """
    number = count_of(target_points, "target_points")
    return cs3_joiner(
        views,
        variant=variant,
        max_edge=max_edge,
        depth_step=depth_step,
        tolerance=tolerance,
        threads=threads,
    )(number)


class Join(Protocol):
    """Returns one mesh of prepared views, with at most the given number of points."""

    def __call__(self, target_points: int, *, report: Report = ...) -> JointSimplification: ...


def cs3_joiner(
    views: Sequence[CameraView],
    *,
    variant: Variant = "cios",
    max_edge: float | None = None,
    depth_step: float | None = None,
    tolerance: float | None = None,
    threads: int = 0,
    report: Report = silent,
) -> Join:
    """Prepare views for `cs3_cameras`, once for several numbers of points."""

    def choose(view: _View, open_pixels: NDArray[np.bool_], share: int) -> Cs3Result:
        chosen = cs3_grid(
            view.points,
            open_pixels if share > 0 else np.zeros_like(open_pixels),
            max(share, 1),
            rows_up=view.rows_up,
            variant=variant,
            threads=threads,
        )
        surface = DenseGrid(view.points, open_pixels, math.inf, focal=view.focal)
        return replace(chosen, surface=surface)

    taken = _Views.of(views, max_edge, depth_step, tolerance, threads, report)
    return functools.partial(_join, taken, choose)


@checked
def relief_cameras(
    views: Sequence[CameraView],
    target_points: int,
    *,
    effort: Effort = "balanced",
    max_edge: float | None = None,
    depth_step: float | None = None,
    tolerance: float | None = None,
    threads: int = 0,
) -> JointSimplification:
    """Simplify the views of several calibrated cameras to one mesh by `relief`.

    Parameters
    ----------
    views : sequence of CameraView
        Where several views show the same surface, the earliest one is sampled. Masks and
        confidences are used.
    target_points : int
        Largest number of vertices of all views together, at least 3. Each view gets a share in
        proportion to its pixels whose surface no earlier view shows.
    effort, max_edge, threads
        As for `relief`.
    depth_step : float, optional
        As for `cs3_cameras`; steps are boundaries from the start, as in `relief`.
    tolerance : float, optional
        As for `cs3_cameras`.

    Returns
    -------
    JointSimplification

    Raises
    ------
    InputError
        No view, or one of them is not as `CameraView` says.

    Notes
    -----
    Views are joined as in `cs3_cameras`. A view without a seam keeps the triangles of its relief.
    In a view with a seam, edges away from the seam are flipped while that lowers the sum of
    distances between the pixels and the planes of their triangles, as in `relief`. A triangle of
    such a view spans a gap, and is left out, by the following rule: along one of its edges,
    successive measured points are farther apart than ``max_edge`` times their distance in pixels,
    and these excesses add up to more than one ``max_edge``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> v, u = np.mgrid[0:48, 0:64]
    >>> hill = (2.0 - 0.2 * np.exp(-((u - 32) ** 2 + (v - 24) ** 2) / 200)).astype(np.float32)
    >>> view = simplify.CameraView(hill, camera)
    >>> joint = simplify.relief_cameras([view, view], 100)
    >>> 90 < joint.num_vertices <= 100
    True
    """
    if count_of(target_points, "target_points") < MIN_POINTS:
        raise InputError(f"target_points: expected at least 3, got {target_points}")
    return relief_joiner(
        views,
        effort=effort,
        max_edge=max_edge,
        depth_step=depth_step,
        tolerance=tolerance,
        threads=threads,
    )(target_points)


def relief_joiner(
    views: Sequence[CameraView],
    *,
    effort: Effort = "balanced",
    max_edge: float | None = None,
    depth_step: float | None = None,
    tolerance: float | None = None,
    threads: int = 0,
    report: Report = silent,
) -> Join:
    """Prepare views for `relief_cameras`, once for several numbers of points."""

    def choose(view: _View, open_pixels: NDArray[np.bool_], share: int) -> Relief:
        enough = share >= MIN_POINTS
        return _relief_of_view(
            view,
            open_pixels if enough else np.zeros_like(open_pixels),
            max(share, MIN_POINTS),
            effort,
            max_edge,
            depth_step,
            threads,
        )

    taken = _Views.of(views, max_edge, depth_step, tolerance, threads, report)
    return functools.partial(_join, taken, choose)


def _relief_of_view(
    view: _View,
    open_pixels: NDArray[np.bool_],
    points: int,
    effort: Effort,
    max_edge: float | None,
    depth_step: float | None,
    threads: int,
) -> Relief:
    options = relief_options(
        points,
        effort,
        move_points=False,
        max_edge=max_edge,
        threads=threads,
        from_origin=False,
        depth_step=depth_step if view.focal > 0 else None,
        focal=view.focal,
    )
    surface = DenseGrid(view.points, open_pixels, options.max_edge, options.max_step, options.focal)
    return run_relief(
        _core.ReliefSolver(),
        view.points,
        open_pixels,
        view.rows_up,
        options,
        None,
        None,
        surface,
        view.confidence,
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """The surface that a view shows: the dense mesh of its pixels, with normals."""

    view: _View
    dense_pixels: NDArray[np.int32]
    surface: _Surface
    normals: NDArray[np.float64]  # (H, W, 3)
    tolerance: float

    @classmethod
    def of(cls, view: _View, tolerance: float | None, steps: _GapRules, threads: int) -> _Seen:
        dense = _core.grid_mesh(view.points, view.valid, view.rows_up, math.inf, None, threads)
        surface = _Surface(view.world, steps.surface(view, dense["faces"]))
        near = tolerance or 5.0 * _spacing(view)
        return cls(view, dense["pixels"], surface, _pixel_normals(view), near)

    def covered_by(self, surface: _Surface, threads: int) -> NDArray[np.bool_]:
        """Return which valid pixels lie on another surface that faces the same way."""
        facing = self.normals[self.view.valid]
        return surface.covers(self.view.world, facing, self.tolerance, threads)


def _evenly(count: int, most: int) -> NDArray[np.int64]:
    """Return all indices below ``count``, or ``most`` of them at equal distances."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def _num_owned(seen: Sequence[_Seen], threads: int, report: Report) -> list[float]:
    """Estimate for each view how many of its pixels lie on the dense mesh of no earlier view.

    Each view is compared with at most `_MAX_COMPARED` pixels of each later view.
    """
    # These arrays hold the compared pixels that lie on no view before `each`.
    compared = [_evenly(len(each.view.world), _MAX_COMPARED) for each in seen]
    points = np.concatenate([e.view.world[s] for e, s in zip(seen, compared, strict=True)])
    facing = np.concatenate(
        [e.normals[e.view.valid][s] for e, s in zip(seen, compared, strict=True)]
    )
    view_of = np.repeat(np.arange(len(seen)), [len(some) for some in compared])
    tolerance = np.array([each.tolerance for each in seen])
    owned = []
    for i, each in enumerate(seen):
        later = view_of > i
        own = len(later) - int(np.count_nonzero(later))
        owned.append(own * len(each.view.world) / max(1, len(compared[i])))
        points, facing, view_of = points[later], facing[later], view_of[later]
        unseen = ~each.surface.covers(points, facing, tolerance[view_of], threads)
        points, facing, view_of = points[unseen], facing[unseen], view_of[unseen]
        report((i + 1) / len(seen))
    return owned


@dataclass(frozen=True, eq=False)
class _Views:
    """Prepared views: all that does not depend on the number of points."""

    seen: Sequence[_Seen]
    owned: Sequence[float]  # number of pixels that no earlier view shows, estimated
    steps: _GapRules
    threads: int

    @classmethod
    def of(
        cls,
        views: Sequence[CameraView],
        max_edge: float | None,
        depth_step: float | None,
        tolerance: float | None,
        threads: int,
        report: Report,
    ) -> _Views:
        if not len(views):
            raise InputError("views: expected at least one")
        _check_lengths(max_edge=max_edge, depth_step=depth_step, tolerance=tolerance)
        threads = threads_of(threads)
        steps = _GapRules(depth_step, limit_of(max_edge))
        seen = []
        for index, view in enumerate(views):
            seen.append(_Seen.of(_checked_view(view, index, threads), tolerance, steps, threads))
            report(0.5 * (index + 1) / len(views))
        owned = _num_owned(seen, threads, lambda fraction: report(0.5 + 0.5 * fraction))
        return cls(seen, owned, steps, threads)


def _check_lengths(**lengths: float | None) -> None:
    for name, value in lengths.items():
        if value is not None and not value > 0:
            raise InputError(f"{name}: expected > 0, got {value}")


def _join(
    views: _Views,
    choose: Callable[[_View, NDArray[np.bool_], int], DepthSimplification],
    target_points: int,
    *,
    report: Report = silent,
) -> JointSimplification:
    """Join the views to one mesh of at most ``target_points`` vertices.

    ``choose(view, open_pixels, share)`` simplifies the open pixels of a view to ``share`` points.
    """
    seen, steps, threads = views.seen, views.steps, views.threads
    remaining = target_points
    rate = target_points / max(1, sum(views.owned))
    largest = int(np.argmax(views.owned))
    joint = _JoinedMesh()
    all_covered, chosen_views = [], []
    for i, each in enumerate(seen):
        view = each.view
        covered = np.zeros(view.valid.shape, bool)
        if i > 0:
            so_far = _Surface(joint.vertices, joint.faces)
            covered[view.valid] = each.covered_by(so_far, threads)
        open_pixels = view.valid & ~covered
        share = math.floor(rate * int(open_pixels.sum()))
        # The view that shows most gets at least a triangle, for which the views before it leave
        # points.
        if i == largest:
            share = max(share, MIN_POINTS)
        share = max(0, min(share, remaining - (MIN_POINTS if i < largest else 0)))
        chosen = choose(view, open_pixels, share)
        border = joint.border_in(each.surface.mesh, each.dense_pixels, each.tolerance, threads)
        before = len(joint.vertices)
        joint.add(i, view, chosen, open_pixels, border, each.normals, steps)
        remaining -= len(joint.vertices) - before
        all_covered.append(covered)
        chosen_views.append(chosen)
        report((i + 1) / len(seen))
    return JointSimplification(
        joint.vertices,
        joint.faces,
        joint.vertex_view,
        joint.pixels,
        joint.face_view,
        joint.corner_texcoords,
        tuple(all_covered),
        tuple(chosen_views),
        tuple(each.view.color for each in seen),
        tuple((each.view, each.tolerance) for each in seen),
        threads,
        steps,
    )
