"""Colours of vertices that change abruptly: several vertices at one place with different colours.

Simplification welds vertices at one place, and a vertex has one colour. Therefore the faces between
abrupt changes (the charts of the colours) are given a material of their own while the mesh is
simplified, so that their borders are kept like those of materials. Then each chart gets its
own colours again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d.mesh import Material, Mesh
from manip3d.simplify._texcoords import charts, numbered, parted, texcoords_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.simplify._quality import QualityResult

# Levels by which colours at one place may differ and be one colour: hardly seen, and usual where
# each face of a scan was coloured by itself.
SAME_COLOR = 4

_HASH = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)


class ColorSeams:
    """A mesh whose colours change abruptly, as it is simplified and as it is returned.

    Attributes
    ----------
    mesh : Mesh
        The original with one material for each pair of material and chart.
    is_flat : bool
        Whether each chart has a single colour.
    """

    def __init__(self, original: Mesh, colors: NDArray[np.uint8]) -> None:
        self._original = original
        self._values = colors[:, None, :].astype(np.float32)
        self._charts = charts(original, self._values)
        materials = original.face_material
        pairs = np.column_stack(
            [np.full(original.num_faces, -1) if materials is None else materials, self._charts]
        )
        rows = numbered(pairs)
        self._pairs = np.empty((rows.max() + 1, 2), dtype=np.int64)
        self._pairs[rows] = pairs
        numbers = self._pairs[:, 0].tolist()  # one object for all charts of a material
        known = {number: _material(original, number) for number in set(numbers)}
        self.mesh = original.replace(
            face_material=rows.astype(np.int32), materials=[known[number] for number in numbers]
        )
        order = np.argsort(self._charts, kind="stable")
        corners = colors[original.faces][order]
        is_same_chart = self._charts[order[1:]] == self._charts[order[:-1]]
        changes = (corners[1:, 0] != corners[:-1, 0]).any(axis=1) & is_same_chart
        self.is_flat = bool((corners == corners[:, :1]).all() and not changes.any())

    def restored(self, result: QualityResult) -> QualityResult:
        """Return a result for `mesh` with the original's materials, and the colours of each chart.

        Vertices on borders between charts are duplicated, as they are in the original.
        """
        simplified = result.mesh
        rows_of_faces = simplified.face_material
        if rows_of_faces is None or simplified.num_faces == 0:
            return replace(result, mesh=simplified.replace(face_material=None, materials=()))
        material, chart = self._pairs[rows_of_faces].T
        rows, faces, values = texcoords_of(
            self._values, self._original, self._charts, simplified, chart
        )
        has_materials = self._original.face_material is not None
        mesh = parted(simplified, rows, faces).replace(
            colors=np.rint(values[:, 0]).astype(np.uint8),
            face_material=material.astype(np.int32) if has_materials else None,
            materials=self._original.materials,
        )
        return replace(result, mesh=mesh, vertex_map=self._vertex_map(result, chart, faces))

    def _vertex_map(
        self, result: QualityResult, chart: NDArray[np.int64], faces: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """Return for each input vertex the copy of its output vertex in its own chart."""
        count = result.mesh.num_vertices
        vertices = result.mesh.faces.reshape(-1).astype(np.int64)
        known, at = np.unique(np.repeat(chart, 3) * count + vertices, return_index=True)
        any_copy = np.zeros(count, dtype=np.int32)
        any_copy[vertices] = faces.reshape(-1)
        of_vertex = np.zeros(self._original.num_vertices, dtype=np.int64)
        of_vertex[self._original.faces.reshape(-1)] = np.repeat(self._charts, 3)
        into = result.vertex_map
        wanted = of_vertex * count + into
        place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
        copies = np.where(known[place] == wanted, faces.reshape(-1)[at[place]], any_copy[into])
        return np.where(into < 0, np.int32(-1), copies).astype(np.int32)


def _material(mesh: Mesh, index: int) -> Material:
    """Return a material, or for one of which only the index is known, a name for it."""
    if index < 0:
        return Material()
    return mesh.materials[index] if index < len(mesh.materials) else Material(str(index))


def color_seams(mesh: Mesh) -> ColorSeams | None:
    """Return the abrupt changes of a mesh's colours; None if no place has two colours."""
    colors, has_seams = _colors_at_places(mesh)
    return ColorSeams(mesh, colors) if colors is not None and has_seams else None


def has_color_seams(mesh: Mesh) -> bool:
    """Whether vertices at one place have different colours."""
    return _colors_at_places(mesh)[1]


def _colors_at_places(mesh: Mesh) -> tuple[NDArray[np.uint8] | None, bool]:
    """Return the colours, one where those at a place hardly differ, and whether others differ."""
    if mesh.colors is None or mesh.num_faces == 0:
        return None, False
    # Equal places have equal hashes (0.0 turns -0.0 into 0.0), and others hardly ever: without the
    # shift, the signs of two coordinates would cancel.
    bits = (mesh.vertices + 0.0).view(np.uint64)
    bits ^= bits >> np.uint64(32)
    places = bits @ _HASH
    order = np.argsort(places, kind="stable")
    colors, rest = mesh.colors[order].astype(np.int16), order
    place = np.cumsum(np.append(False, places[order[1:]] != places[order[:-1]]))
    result = mesh.colors.copy()
    num_rounds = 0
    while len(rest) > 0:  # in each round, one colour of each place that is left
        starts = np.flatnonzero(np.append(True, place[1:] != place[:-1]))
        first = np.repeat(colors[starts], np.diff(np.append(starts, len(rest))), axis=0)
        is_that = (np.abs(colors - first) <= SAME_COLOR).all(axis=1)
        result[rest[is_that]] = first[is_that]
        rest, colors, place = rest[~is_that], colors[~is_that], place[~is_that]
        num_rounds += 1
    return result, num_rounds > 1
