"""Mesh.summary(): small meshes by hand, random soups against a dictionary, real files."""

from __future__ import annotations

import itertools
import json
import lzma
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from manip3d import Material, Mesh, read_mesh
from manip3d.io import READABLE
from manip3d.mesh import MeshSummary
from real_data import RealData
from soups import soups

TETRAHEDRON = Mesh(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
)


def test_tetrahedron_is_closed() -> None:
    summary = TETRAHEDRON.summary()
    assert (summary.vertices, summary.faces, summary.edges) == (4, 4, 6)
    assert summary.boundary_edges == summary.non_manifold_edges == summary.complex_vertices == 0
    assert summary.components == 1
    assert summary.closed
    assert summary.bounds == ((0, 0, 0), (1, 1, 1))


def test_bounds_are_those_of_the_faces_and_zero_without_any() -> None:
    corners = np.array([[5.0, 6, 7], [6, 6, 7], [5, 8, 7], [9, 9, 9]])
    face = np.array([[0, 1, 2]], np.int32)
    assert Mesh(corners, face).bounds.tolist() == [[5, 6, 7], [6, 8, 7]]  # without the last vertex
    empty = Mesh(corners, face[:0])
    assert empty.bounds.tolist() == [[0, 0, 0], [0, 0, 0]]
    assert empty.diagonal == 0


def test_unwelded_square_has_a_cut_that_welding_closes() -> None:
    #  4---3
    #  | / |   two triangles, each with its own corners
    #  0---1
    square = Mesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-0.0, 0, 0], [1, 1, 0], [0, 1, 0], [9, 9, 9]],
        [[0, 1, 2], [3, 4, 5]],
    )
    summary = square.summary()
    assert (summary.vertices, summary.vertices_welded) == (7, 4)
    assert (summary.edges, summary.edges_welded) == (6, 5)
    assert (summary.boundary_edges, summary.boundary_edges_welded) == (6, 4)
    assert (summary.components, summary.components_welded) == (2, 1)
    assert summary.unreferenced_vertices == 1
    assert not summary.closed


def test_bow_tie_has_one_complex_vertex() -> None:
    #  0   3
    #  |\ /|
    #  | 2 |   four boundary edges meet in 2
    #  |/ \|
    #  1   4
    summary = Mesh(
        [[0, 1, 0], [0, 0, 0], [1, 0.5, 0], [2, 1, 0], [2, 0, 0]], [[0, 1, 2], [2, 4, 3]]
    ).summary()
    assert summary.complex_vertices == 1
    assert summary.components == 1


def test_degenerate_and_zero_area_faces_are_counted_apart() -> None:
    vertices = np.array([[0, 0, 0], [1, 1, 1], [3, 3, 3], [0, 1, 0], [0, 0, 0]])
    faces = [[0, 1, 1], [0, 1, 2], [0, 4, 3], [0, 1, 3]]
    for scale in (1e-200, 1e-9, 1.0, 1e9, 1e150):
        summary = Mesh(vertices * scale, faces).summary()
        assert (summary.degenerate_faces, summary.degenerate_faces_welded) == (1, 2)
        assert summary.zero_area_faces == 2


def test_materials_and_texture_coordinates() -> None:
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0]]
    summary = Mesh(
        vertices,
        [[0, 1, 2], [1, 3, 2], [1, 4, 3]],
        texcoords=[[0, 0], [1, 0], [0, 1], [1, 0], [0.5, 0.5]],
        face_texcoords=[[0, 1, 2], [3, 4, 2], [1, -1, 4]],
        face_material=[7, -1, 7],
        materials=[Material()] * 8,
    ).summary()
    assert summary.materials_used == 1
    assert summary.texcoords == 5
    assert summary.faces_without_uv == 1
    assert summary.multi_uv_vertices == 0  # rows 1 and 3 hold the same value


def test_summary_prints_and_dumps() -> None:
    summary = TETRAHEDRON.summary()
    assert json.loads(json.dumps(summary.as_dict()))["boundary_edges_welded"] == 0
    rows = str(summary).splitlines()
    assert rows[0].split() == ["stored", "welded"]
    assert any(row.split() == ["edges", "6", "6"] for row in rows)
    assert len({len(row) for row in rows[1:] if row.startswith("boundary")}) == 1


def welded_numbers(rows: np.ndarray) -> list[int]:
    """Number the rows, with equal numbers for equal rows; -0.0 equals 0.0 as a key of a dict."""
    numbers: dict[tuple[float, ...], int] = {}
    return [numbers.setdefault(tuple(row), len(numbers)) for row in rows.tolist()]


def component_count(faces: list[list[int]]) -> int:
    groups: list[set[int]] = []
    for face in faces:
        touching = [group for group in groups if group & set(face)]
        groups = [group for group in groups if not group & set(face)]
        groups.append(set(face).union(*touching))
    return len(groups)


def count_by_dictionary(all_faces: list[list[int]], suffix: str) -> dict[str, int]:
    """Return the counts of one numbering of the vertices, straight from their definitions."""
    faces = [face for face in all_faces if len(set(face)) == 3]
    edges = Counter(frozenset(pair) for a, b, c in faces for pair in ((a, b), (b, c), (c, a)))
    boundary = defaultdict(set)
    for edge, uses in edges.items():
        if uses == 1:
            for vertex in edge:
                boundary[vertex] |= edge - {vertex}
    counts = {
        "edges": len(edges),
        "boundary_edges": sum(uses == 1 for uses in edges.values()),
        "non_manifold_edges": sum(uses > 2 for uses in edges.values()),
        "complex_vertices": sum(len(neighbors) != 2 for neighbors in boundary.values()),
        "degenerate_faces": len(all_faces) - len(faces),
        "duplicate_faces": len(faces) - len({frozenset(face) for face in faces}),
        "components": component_count(faces),
    }
    return {name + suffix: count for name, count in counts.items()}


@given(soups())
def test_counts_equal_a_dictionary(mesh: Mesh) -> None:
    summary = mesh.summary().as_dict()
    numbers = welded_numbers(mesh.vertices)
    faces = mesh.faces.tolist()
    welded = [[numbers[v] for v in face] for face in faces]
    used = {v for face in faces for v in face}
    expected = count_by_dictionary(faces, "") | count_by_dictionary(welded, "_welded")
    expected["vertices_welded"] = len({v for face in welded for v in face})
    expected["unreferenced_vertices"] = mesh.num_vertices - len(used)
    expected["zero_area_faces"] = sum(
        len(set(face)) == 3
        and not np.cross(*(mesh.vertices[face[1:]] - mesh.vertices[face[0]])).any()
        for face in faces
    )
    materials = [] if mesh.face_material is None else mesh.face_material.tolist()
    expected["materials_used"] = len({m for m in materials if m >= 0})
    expected["faces_without_uv"] = len(faces)
    expected["multi_uv_vertices"] = 0
    if mesh.texcoords is not None and mesh.face_texcoords is not None:
        uv_numbers = welded_numbers(mesh.texcoords)
        uvs = defaultdict(set)
        for face, corners in zip(welded, mesh.face_texcoords.tolist(), strict=True):
            for vertex, uv in zip(face, corners, strict=True):
                if uv >= 0:
                    uvs[vertex].add(uv_numbers[uv])
        expected["multi_uv_vertices"] = sum(len(values) > 1 for values in uvs.values())
        expected["faces_without_uv"] = sum(min(uv) < 0 for uv in mesh.face_texcoords.tolist())
    assert {name: summary[name] for name in expected} == expected
    assert summary["closed"] == (
        summary["edges_welded"] > 0 and summary["boundary_edges_welded"] == 0
    )


@given(soups(), st.randoms(use_true_random=False))
def test_counts_do_not_depend_on_any_order(mesh: Mesh, random) -> None:
    vertex_order = random.sample(range(mesh.num_vertices), mesh.num_vertices)
    face_order = random.sample(range(mesh.num_faces), mesh.num_faces)
    new_number = np.empty(mesh.num_vertices, np.int32)
    new_number[vertex_order] = np.arange(mesh.num_vertices)
    per_face = {
        name: getattr(mesh, name)[face_order]
        for name in ("face_texcoords", "face_normals", "face_material")
        if getattr(mesh, name) is not None
    }
    if mesh.colors is not None:
        per_face["colors"] = mesh.colors[vertex_order]
    shuffled = mesh.replace(
        vertices=mesh.vertices[vertex_order],
        faces=np.roll(new_number[mesh.faces[face_order]], 1, axis=1),
        **{
            name: np.roll(table, 1, axis=1)
            if table.shape[1:] == (3,) and name != "colors"
            else table
            for name, table in per_face.items()
        },
    )
    assert shuffled.summary() == mesh.summary()


def manifest_rows(text: str, title: str) -> dict[str, dict[str, str]]:
    """Return a table of the data folder's MANIFEST.md: file -> column -> cell."""
    lines = text.split(f"## {title}\n")[1].split("\n## ")[0].splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if "|" in line]
    header, rows = cells[0][1:], cells[2:]
    return {row[0]: dict(zip(header, row[1:], strict=True)) for row in rows}


def manifest_cells(summary: MeshSummary, polygons: str) -> dict[str, str]:
    """Return the cells of the tables 'Geometry' and 'Attributes' from a summary."""

    def pair(name: str) -> str:
        counts = summary.as_dict()
        return f"{counts[name]} / {counts[f'{name}_welded']}"

    no_uv = "all" if summary.faces_without_uv == summary.faces else str(summary.faces_without_uv)
    return {
        "vertices": str(summary.vertices),
        "triangles": str(summary.faces),
        "polygons": polygons,  # not known once they are triangles
        "boundary (stored / welded)": pair("boundary_edges"),
        "non-manifold (stored / welded)": pair("non_manifold_edges"),
        "welded vertices": str(summary.vertices_welded),
        "closed after welding": "yes" if summary.closed else "no",
        "materials used": str(summary.materials_used),
        "texture coordinates": str(summary.texcoords),
        "triangles with no UV": no_uv,
        "multi-UV vertices": str(summary.multi_uv_vertices),
        "degenerate faces": str(summary.degenerate_faces),
        "duplicate faces (stored / welded)": pair("duplicate_faces"),
        "components (welded)": str(summary.components_welded),
    }


# Cells that depend on the cut of polygons: the manifest cuts fans, which turns some inside out.
CUT_DEPENDENT = (
    "boundary (stored / welded)",
    "non-manifold (stored / welded)",
    "duplicate faces (stored / welded)",
)


def obj_with_fans(path: Path) -> Mesh:
    """Read positions and faces of an OBJ file, with polygons cut from their first corners."""
    vertices, faces = [], []
    with lzma.open(path, "rt", encoding="latin-1") as lines:
        for key, *words in filter(None, map(str.split, lines)):
            if key == "v":
                vertices.append([float(word) for word in words[:3]])
            elif key == "f":
                first, *rest = (int(word.partition("/")[0]) - 1 for word in words)
                faces += [[first, a, b] for a, b in itertools.pairwise(rest)]
    return Mesh(vertices, faces)


def test_counts_equal_the_manifest_of_the_data_folder(realdata: RealData) -> None:
    text = realdata("meshes/MANIFEST.md").read_text()
    folder = realdata("meshes")
    geometry, attributes = manifest_rows(text, "Geometry"), manifest_rows(text, "Attributes")
    assert len(geometry) == len(attributes) == 24
    for name, row in geometry.items():
        if Path(name.removesuffix(".xz")).suffix not in READABLE:
            continue
        expected = row | attributes[name]
        got = manifest_cells(read_mesh(folder / name).summary(), row["polygons"])
        if row["polygons"] != row["triangles"] and name.endswith(".obj.xz"):
            fans = manifest_cells(obj_with_fans(folder / name).summary(), row["polygons"])
            got |= {column: fans[column] for column in CUT_DEPENDENT}
        assert got == expected, name
