"""Random triangle soups with every kind of defect, for property tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from manip3d import Material, Mesh

# Few values, so that positions, colours and texture coordinates often coincide; two zeros.
_COORDINATE = st.sampled_from([0.0, -0.0, 1.0, 2.0])


def _table(draw: st.DrawFn, rows: int, columns: int, values: st.SearchStrategy[float]) -> list:
    row = st.lists(values, min_size=columns, max_size=columns)
    return draw(st.lists(row, min_size=rows, max_size=rows))


@st.composite
def soups(draw: st.DrawFn, max_vertices: int = 9, max_faces: int = 14) -> Mesh:
    """Meshes of a few faces on coinciding positions, with or without each kind of attribute."""
    num_vertices = draw(st.integers(0, max_vertices))
    num_faces = draw(st.integers(0, max_faces)) if num_vertices else 0

    def corner_table(rows: int) -> list:
        return _table(draw, num_faces, 3, st.integers(-1, rows - 1))

    arrays: dict[str, object] = {}
    if draw(st.booleans()):
        arrays["texcoords"] = _table(draw, 4, 2, _COORDINATE)
        arrays["face_texcoords"] = corner_table(4)
    if draw(st.booleans()):
        arrays["normals"] = _table(draw, 3, 3, _COORDINATE)
        arrays["face_normals"] = corner_table(3)
    if draw(st.booleans()):
        arrays["colors"] = _table(draw, num_vertices, 3, st.sampled_from([0, 255]))
    if draw(st.booleans()):
        material = st.lists(st.integers(-1, 2), min_size=num_faces, max_size=num_faces)
        arrays["face_material"] = np.array(draw(material), np.int32)
        arrays["materials"] = [Material(name) for name in "abc"]
    corners = st.integers(0, max(0, num_vertices - 1))
    return Mesh(
        np.reshape(_table(draw, num_vertices, 3, _COORDINATE), (-1, 3)),
        np.reshape(_table(draw, num_faces, 3, corners), (-1, 3)).astype(np.int32),
        **arrays,
    )
