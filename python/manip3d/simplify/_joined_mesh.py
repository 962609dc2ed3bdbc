"""The mesh to which views of several cameras are joined, one after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d.mesh import Mesh
from manip3d.simplify._camera_views import View, in_world, uvs
from manip3d.simplify._depth import DenseGrid, DepthSimplification
from manip3d.simplify._depth_steps import StepRule, across_gaps, across_steps
from manip3d.simplify._relief import Relief

if TYPE_CHECKING:
    from numpy.typing import NDArray


def normals_of(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
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
class GapRules:
    """Rules by which triangles of a view span a step in depth, or a gap.

    ``step`` and ``max_edge`` are those of `cs3_cameras`; None and infinity: no limit.
    """

    step: float | None
    max_edge: float

    def apart(
        self, view: View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return which triangles bridge a gap in the depth image larger than ``max_edge``."""
        if math.isinf(self.max_edge) or not len(corners):
            return np.zeros(len(corners), bool)
        return across_gaps(corners, pixels, view.points, view.valid, self.max_edge)

    def across(
        self, view: View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return which triangles of the sparse mesh span a step."""
        if self.step is None or view.focal == 0 or not len(corners):
            return np.zeros(len(corners), bool)
        image = np.where(view.valid, view.points[..., 2], np.float32(0))
        surface = DenseGrid(view.points, view.valid, self.max_edge, self.step, view.focal)
        rule = StepRule.of(self.step, view.focal)
        return across_steps(np.ascontiguousarray(corners), pixels, image, rule, surface)

    def across_between(
        self, view: View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
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

    def surface(self, view: View, faces: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the triangles of the dense mesh that do not span a step."""
        if self.step is None or view.focal == 0:
            return faces
        z = view.points[view.valid][:, 2][faces]
        rule = StepRule.of(self.step, view.focal)
        return np.ascontiguousarray(faces[~rule.differ(z.min(axis=1), z.max(axis=1))])


class Surface:
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
        of_faces = normals_of(self.mesh.vertices, self.mesh.faces[face])
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


def _own_vertices(
    chosen: DepthSimplification, border_pixels: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return which vertices of a view to add: one for each pixel without a border vertex."""
    _, first = np.unique(_pixel_keys(chosen.pixels), return_index=True)
    own = np.zeros(chosen.num_vertices, bool)
    own[first] = True  # a relief has two vertices where two fans of triangles meet
    own &= ~np.isin(_pixel_keys(chosen.pixels), _pixel_keys(border_pixels))
    return own


def _centroids(pixels: NDArray[np.int32], corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the pixel at the centroid of each triangle, rounded."""
    centroids: NDArray[np.int32] = (2 * pixels[corners].sum(axis=1) + 3) // 6
    return centroids


def _triangles_between(
    view: View, pixels: NDArray[np.int32], open_pixels: NDArray[np.bool_]
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
    facing = normals_of(vertices, corners) * normals[centroids[:, 1], centroids[:, 0]]
    is_right: NDArray[np.bool_] = ~seam | (facing.sum(axis=1) > 0)
    return is_right


class JoinedMesh:
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
        border = Surface(self.vertices, self.faces).boundary.astype(np.int32)
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
        view: View,
        chosen: DepthSimplification,
        open_pixels: NDArray[np.bool_],
        border: tuple[NDArray[np.int32], NDArray[np.int32]],
        normals: NDArray[np.float64],
        steps: GapRules,
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
        world = in_world(view, chosen.vertices[own])
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
        texcoords = uvs(view, vertices[vertex], pixels)[corners]
        self._extend(index, world, vertex[corners], chosen.pixels[own], texcoords)

    def _append(self, index: int, view: View, chosen: DepthSimplification) -> None:
        """Append a view with its own triangles; it shares no vertex with the mesh so far."""
        world = in_world(view, chosen.vertices)
        texcoords = uvs(view, world, chosen.pixels)[chosen.faces]
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
        view: View, pixels: NDArray[np.int32], corners: NDArray[np.int32]
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
