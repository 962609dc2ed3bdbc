"""What a mesh consists of: the counts of ``Mesh.summary()`` and ``manip3d info``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from manip3d import _core

if TYPE_CHECKING:
    from manip3d.mesh import Mesh

Corner = tuple[float, float, float]

# Rows of the printed table that have a count as stored and a count welded.
_PAIRED = {
    "vertices": "vertices",
    "edges": "edges",
    "boundary_edges": "boundary edges",
    "non_manifold_edges": "non-manifold edges",
    "complex_vertices": "complex vertices",
    "degenerate_faces": "degenerate faces",
    "duplicate_faces": "duplicate faces",
    "components": "components",
}
_SINGLE = {
    "zero_area_faces": "zero-area faces",
    "unreferenced_vertices": "unreferenced vertices",
    "materials_used": "materials used",
    "texcoords": "texture coordinates",
    "faces_without_uv": "faces without UV",
    "multi_uv_vertices": "multi-UV vertices",
}


@dataclass(frozen=True)
class MeshSummary:
    """Counts of a mesh, as stored and (``..._welded``) with equal positions taken as one vertex.

    Attributes
    ----------
    vertices, vertices_welded : int
        As stored, unreferenced ones included; distinct positions that some face uses.
    faces : int
    edges, edges_welded : int
    boundary_edges, boundary_edges_welded : int
        Edges of exactly one face.
    non_manifold_edges, non_manifold_edges_welded : int
        Edges of more than two faces.
    complex_vertices, complex_vertices_welded : int
        Vertices of a boundary edge whose number of boundary neighbours is not 2.
    degenerate_faces, degenerate_faces_welded : int
        Faces with a repeated vertex. All other counts but `faces` and `faces_without_uv` leave
        them out.
    duplicate_faces, duplicate_faces_welded : int
        Faces with the three vertices of an earlier face, in any orientation.
    components, components_welded : int
        Sets of faces that hang together through shared vertices.
    zero_area_faces : int
        Faces that are not degenerate as stored and have no area.
    unreferenced_vertices : int
        Vertices that no face uses.
    materials_used : int
        Distinct materials of the faces.
    texcoords : int
        Rows of the table of texture coordinates.
    faces_without_uv : int
        Faces with at least one corner that has no texture coordinate.
    multi_uv_vertices : int
        Welded vertices with more than one distinct texture coordinate.
    closed : bool
        There are faces and, when welded, no boundary edge.
    has_normals, has_colors : bool
    bounds : ((x, y, z), (x, y, z)) float
        Corners of the bounding box of the vertices that some face uses.
    """

    vertices: int
    vertices_welded: int
    faces: int
    edges: int
    edges_welded: int
    boundary_edges: int
    boundary_edges_welded: int
    non_manifold_edges: int
    non_manifold_edges_welded: int
    complex_vertices: int
    complex_vertices_welded: int
    degenerate_faces: int
    degenerate_faces_welded: int
    duplicate_faces: int
    duplicate_faces_welded: int
    components: int
    components_welded: int
    zero_area_faces: int
    unreferenced_vertices: int
    materials_used: int
    texcoords: int
    faces_without_uv: int
    multi_uv_vertices: int
    closed: bool
    has_normals: bool
    has_colors: bool
    bounds: tuple[Corner, Corner]

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, ready for JSON."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        """A table for a terminal: one row per count, as stored and welded."""
        lines = [f"{'':24}{'stored':>14}{'welded':>14}", f"{'faces':24}{self.faces:>14}"]
        for name, title in _PAIRED.items():
            stored, welded = getattr(self, name), getattr(self, f"{name}_welded")
            lines.append(f"{title:24}{stored:>14}{welded:>14}")
        for name, title in _SINGLE.items():
            lines.append(f"{title:24}{getattr(self, name):>14}")
        for name in ("closed", "has_normals", "has_colors"):
            answer = "yes" if getattr(self, name) else "no"
            lines.append(f"{name.removeprefix('has_'):24}{answer:>14}")
        for title, corner in zip(("lowest corner", "highest corner"), self.bounds, strict=True):
            lines.append(f"{title:24}" + "".join(f"{x:>14.6g}" for x in corner))
        return "\n".join(lines)


def summarize(mesh: Mesh) -> MeshSummary:
    """Count what ``mesh`` consists of; see :meth:`manip3d.Mesh.summary`."""
    fields = _core.summarize(mesh)
    low, high = fields.pop("bounds").tolist()
    return MeshSummary(**fields, bounds=(tuple(low), tuple(high)))
