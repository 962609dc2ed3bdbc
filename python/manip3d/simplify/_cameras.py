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
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.io._images import encoded_picture
from manip3d.mesh import Material, Mesh, Texture
from manip3d.simplify._arguments import count_of, limit_of
from manip3d.simplify._bandwidth import MIN_POINTS
from manip3d.simplify._camera_views import (
    CameraView,
    View,
    checked_view,
    from_world,
    pixel_normals,
    spacing,
)
from manip3d.simplify._depth import (
    Cs3Result,
    DenseGrid,
    DepthSimplification,
    Variant,
    cs3_grid,
    with_materials,
)
from manip3d.simplify._depth_steps import DEPTH_STEP
from manip3d.simplify._joined_mesh import GapRules, JoinedMesh, Surface, normals_of
from manip3d.simplify._relief import Effort, Relief, relief_options, run_relief

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics

_PLACES = 20_000  # sampled points of `bridges`: a standard error of at most 0.004
_MAX_COMPARED = 20_000  # pixels of a view; a share of 1 % is known to within 0.1 %

__all__ = ["CameraView", "JointSimplification", "cs3_cameras", "relief_cameras"]

Report = Callable[[float], object]
"""Takes the share of the work that is done."""


def silent(fraction: float) -> None:
    """Report nothing."""


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
    _measured: tuple[tuple[View, float], ...] = field(repr=False)
    _threads: int = field(repr=False)
    _steps: GapRules = field(repr=False)

    def __repr__(self) -> str:
        vertices = counted(self.num_vertices, "vertex", "vertices")
        faces, views = counted(self.num_faces, "face"), counted(len(self.views), "view")
        return f"<manip3d.simplify.JointSimplification: {vertices}, {faces}, {views}>"

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
        valid = sum(int(view.valid.sum()) for view, _ in self._measured)
        return valid + self.without_ray

    @property
    def without_ray(self) -> int:
        """Number of these without a line of sight: the lens model cannot be inverted there."""
        return sum(view.without_ray for view, _ in self._measured)

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
        """Share of the measured pixels of all views that the mesh covers.

        A pixel of a depth image is covered if the mesh is the first surface on its line of sight
        up to ``depth_step`` (default 0.05) of its depth. If another surface is in front, and for
        views given as points, it is covered if it is as near to the mesh as to its neighbours
        (median distance), or within the ``tolerance`` of a place that is not on the border of the
        mesh. Pixels without a line of sight (``without_ray``) are not covered. Computed on the
        first access.
        """
        total = self.num_measured
        if total == 0 or not self.num_faces:
            return 0.0
        surface = Surface(self.vertices, self.faces)
        covered = 0
        for view, tolerance in self._measured:
            if not view.valid.any():
                continue
            judged = view.world
            if view.camera is not None:
                in_sight, hidden = self._seen(view, view.camera)
                covered += int(np.count_nonzero(in_sight))
                judged = judged[hidden]
            distance, on_border = surface.distance(judged, tolerance, self._threads)
            limit = np.where(on_border, spacing(view), tolerance)
            covered += int(np.count_nonzero(distance <= limit))
        return covered / total

    def _seen(self, view: View, camera: Intrinsics) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which valid pixels see the mesh at their own depth, and which in front of it."""
        mesh = Mesh(from_world(view, self.vertices), self.faces)
        found = _core.render_depth(
            mesh, view.points, view.valid, view.rows_up, camera, self._threads, None
        ).reshape(view.valid.shape)[view.valid]
        depth = view.points[view.valid][:, 2].astype(np.float64)
        limit = (self._steps.step or DEPTH_STEP) * depth
        return np.abs(found - depth) <= limit, found < depth - limit

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
                textures={} if c is None else {"base_color": Texture(data=encoded_picture(c))},
            )
            for i, c in enumerate(self.colors)
        )
        return with_materials(mesh, self.face_view, materials, textured)


def _spread(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return `_PLACES` points, spread evenly over the area of the faces.

    Faces are chosen at equal steps of the accumulated area, and the place within a face by the R2
    low-discrepancy sequence [Roberts, "The unreasonable effectiveness of quasirandom sequences",
    2018], whose steps are powers of 1/g, g the real root of g^3 = g + 1.
    """
    areas = np.linalg.norm(normals_of(vertices, faces), axis=1)
    step = (np.arange(_PLACES) + 0.5) / _PLACES * areas.sum()
    face = np.minimum(np.searchsorted(np.cumsum(areas), step), len(faces) - 1)
    number = np.arange(1, _PLACES + 1)[:, None]
    share = np.mod(number * np.array([0.7548776662466927, 0.5698402909980532]), 1.0)  # 1/g, 1/g^2
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    p, q, r = (vertices[faces[face, i]] for i in range(3))
    places: NDArray[np.float64] = p + share[:, :1] * (q - p) + share[:, 1:] * (r - p)
    return places


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
        Same as for `cs3`.
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

    def choose(view: View, open_pixels: NDArray[np.bool_], share: int) -> Cs3Result:
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
        Same as for `relief`.
    depth_step : float, optional
        Same as for `cs3_cameras`; steps are boundaries from the start, as in `relief`.
    tolerance : float, optional
        Same as for `cs3_cameras`.

    Returns
    -------
    JointSimplification

    Raises
    ------
    InputError
        No view, or one of them is not as `CameraView` says.

    Notes
    -----
    Views are joined as in `cs3_cameras`. A view keeps the triangles of its relief, except where the
    border of the mesh crosses them. Between them and the border, the triangulation has the edges of
    both (constrained Delaunay). A triangle of the seam is left out if it spans a step, or if it
    spans a gap by the following rule: along one of its edges, successive measured points are
    farther apart than ``max_edge`` times their distance in pixels, and these excesses add up to
    more than one ``max_edge``.

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

    def choose(view: View, open_pixels: NDArray[np.bool_], share: int) -> Relief:
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
    view: View,
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
        surface,
        confidence=view.confidence,
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """The surface that a view shows: the dense mesh of its pixels, with normals."""

    view: View
    dense_pixels: NDArray[np.int32]
    surface: Surface
    normals: NDArray[np.float64]  # (H, W, 3)
    tolerance: float

    @classmethod
    def of(cls, view: View, tolerance: float | None, steps: GapRules, threads: int) -> _Seen:
        dense = _core.grid_mesh(view.points, view.valid, view.rows_up, math.inf, None, threads)
        surface = Surface(view.world, steps.surface(view, dense["faces"]))
        near = tolerance or 5.0 * spacing(view)
        return cls(view, dense["pixels"], surface, pixel_normals(view), near)

    def covered_by(self, surface: Surface, threads: int) -> NDArray[np.bool_]:
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
    steps: GapRules
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
        steps = GapRules(depth_step, limit_of(max_edge))
        seen = []
        for index, view in enumerate(views):
            seen.append(_Seen.of(checked_view(view, index, threads), tolerance, steps, threads))
            report(0.5 * (index + 1) / len(views))
        owned = _num_owned(seen, threads, lambda fraction: report(0.5 + 0.5 * fraction))
        return cls(seen, owned, steps, threads)


def _check_lengths(**lengths: float | None) -> None:
    for name, value in lengths.items():
        if value is not None and not value > 0:
            raise InputError(f"{name}: expected > 0, got {value}")


def _join(
    views: _Views,
    choose: Callable[[View, NDArray[np.bool_], int], DepthSimplification],
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
    joint = JoinedMesh()
    all_covered, chosen_views = [], []
    for i, each in enumerate(seen):
        view = each.view
        covered = np.zeros(view.valid.shape, bool)
        if i > 0:
            so_far = Surface(joint.vertices, joint.faces)
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
