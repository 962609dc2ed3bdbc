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
from manip3d.simplify._depth_steps import StepRule, across_gaps, across_steps, share_off
from manip3d.simplify._relief import Relief

if TYPE_CHECKING:
    from numpy.typing import NDArray


_NO_EDGES = np.empty((0, 2), np.int32)


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

        Besides those of `across`, triangles that have a side across a step and either cover a pixel
        off the surface or have no pixel inside. `across` tolerates some pixels off the surface, and
        if no pixel is inside, all that they cover may be on their other sides, which lie on it.
        """
        found = self.across(view, pixels, corners)
        if self.step is None or view.focal == 0 or not len(corners):
            return found
        image = np.where(view.valid, view.points[..., 2], np.float32(0))
        surface = DenseGrid(view.points, view.valid, self.max_edge, self.step, view.focal)
        rule = StepRule.of(self.step, view.focal)
        crosses = across_steps(np.ascontiguousarray(corners), pixels, image, rule, None)
        judged = np.ascontiguousarray(corners[crosses])
        off = share_off(judged, pixels, surface) != 0  # negative: unknown
        found[crosses] |= off | (_num_inside(pixels[judged]) == 0)
        return found

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
        distance, face, foot = self._closest(points, float(np.max(tolerance)), threads)
        covered: NDArray[np.bool_] = distance <= tolerance
        near = np.flatnonzero(covered)
        face, foot = face[near], foot[near]
        of_faces = normals_of(self.mesh.vertices, self.mesh.faces[face])
        same_side = np.einsum("ij,ij->i", of_faces, normals[near]) > 0
        covered[near] = same_side & ~self._on_border(face, foot, of_faces)
        return covered

    def distance(
        self, points: NDArray[np.float64], most: float, threads: int
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the distance of points up to ``most`` (else infinity), and if the border is next.

        The latter tells whether the closest point of the surface is on its border.
        """
        if not len(points):
            return np.empty(0), np.empty(0, bool)
        distance, face, foot = self._closest(points, most, threads)
        near = np.flatnonzero(face >= 0)
        on_border = np.zeros(len(points), bool)
        of_faces = normals_of(self.mesh.vertices, self.mesh.faces[face[near]])
        on_border[near] = self._on_border(face[near], foot[near], of_faces)
        return np.where(face >= 0, distance, np.inf), on_border

    def _closest(
        self, points: NDArray[np.float64], most: float, threads: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
        """Return the distance of each point from the surface up to ``most``, the face and place."""
        return _core.closest_points(self.mesh, points, most, threads, None)

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


def _at_pixels(chosen: DepthSimplification, pixels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the faces of a view with corners that are places in ``pixels``."""
    keys = _pixel_keys(pixels)
    order = np.argsort(keys)
    place = order[np.searchsorted(keys[order], _pixel_keys(chosen.pixels))].astype(np.int32)
    return np.ascontiguousarray(place[chosen.faces])


def _centroids(pixels: NDArray[np.int32], corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the pixel at the centroid of each triangle, rounded."""
    centroids: NDArray[np.int32] = (2 * pixels[corners].sum(axis=1) + 3) // 6
    return centroids


def _triangles_between(
    view: View,
    pixels: NDArray[np.int32],
    edges: NDArray[np.int32],
    whole: NDArray[np.int32],
    open_pixels: NDArray[np.bool_],
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Triangulate pixels (Delaunay) with the given edges, and keep triangles over open pixels.

    Kept are those whose centroid is an open pixel, and those that are one of the faces ``whole``.
    They face the camera. Also returned is which of them are one of ``whole``.
    """
    corners: NDArray[np.int32] = _core.grid_delaunay(
        np.ascontiguousarray(pixels), np.ascontiguousarray(edges)
    )
    centroids = _centroids(pixels, corners)
    is_whole = np.isin(_face_keys(corners), _face_keys(whole))
    keep = open_pixels[centroids[:, 1], centroids[:, 0]] | is_whole
    corners = corners if view.rows_up else corners[:, [0, 2, 1]]
    return np.ascontiguousarray(corners[keep]), is_whole[keep]


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
            in_one = ~steps.across(view, chosen.pixels, chosen.faces)
            self._append(index, view, chosen.with_faces(chosen.faces[in_one]))
            return
        own = _own_vertices(chosen, border[1])
        pixels = np.concatenate([border[1], chosen.pixels[own]])
        new = np.arange(len(self.vertices), len(self.vertices) + own.sum(), dtype=np.int32)
        vertex = np.concatenate([border[0], new])
        world = in_world(view, chosen.vertices[own])
        vertices = np.concatenate([self.vertices, world])
        edges, whole = _NO_EDGES, np.empty((0, 3), np.int32)
        if isinstance(chosen, Relief):
            whole = _at_pixels(chosen, pixels)
            whole = whole[~steps.across(view, pixels, whole)]
            # Delaunay edges may cross the border, and triangles across it would be left out whole.
            edges = np.concatenate([self._edges_between(border[0]), _edges_of(whole)])
        corners, is_whole = _triangles_between(view, pixels, edges, whole, open_pixels)
        keep = self._fits(vertex[corners])
        keep &= _is_turned_right(vertices[vertex], pixels, corners, len(border[0]), normals)
        if isinstance(chosen, Relief):
            # The limit holds for edges between neighbouring pixels, not for those of the relief.
            across = steps.apart(view, pixels, corners)
            keep &= is_whole | ~(across | steps.across_between(view, pixels, corners))
        else:
            if steps.max_edge < math.inf:
                faces = vertex[corners]
                sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
                keep &= np.linalg.norm(sides, axis=2).max(axis=1) <= steps.max_edge
            keep &= ~steps.across(view, pixels, corners)
        corners = corners[keep]
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

    def _edges_between(self, border: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the edges that have one face only and join two of the vertices ``border``.

        Their ends are places in ``border``.
        """
        keys, counts = np.unique(_edge_keys(self.faces), return_counts=True)
        place = np.full(len(self.vertices), -1, np.int32)
        place[border] = np.arange(len(border))
        edges = place[_ends_of(keys[counts == 1])]
        return np.ascontiguousarray(edges[(edges >= 0).all(axis=1)])

    def _fits(self, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which new faces to keep, so that no edge has more than two faces.

        If there are too many, the first ones stay.
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


def _ends_of(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the ends of edges, from their keys."""
    return np.column_stack([keys >> 32, keys & 0xFFFFFFFF]).astype(np.int32)


def _edges_of(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return each edge of faces once."""
    return _ends_of(np.unique(_edge_keys(faces)))


def _face_keys(faces: NDArray[np.int32]) -> NDArray[np.void]:
    """Return a key of the set of corners of each face."""
    ordered = np.ascontiguousarray(np.sort(faces, axis=1))
    return ordered.view(np.dtype((np.void, 12))).reshape(-1)
