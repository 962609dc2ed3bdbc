"""simplify.clean: each rule on the smallest mesh, then properties over random soups."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manip3d import InputError, Material, Mesh
from manip3d.simplify import clean
from soups import soups

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])

options = st.fixed_dictionaries(
    {"weld": st.booleans(), "duplicates": st.sampled_from(["same", "any", "keep"])}
)


def test_welding_keeps_the_texture_coordinates_of_the_corners() -> None:
    #  2---3     two triangles with their own corners: a seam along 1-2
    #  | \ |
    #  0---1
    result = clean(
        Mesh(
            CORNERS[[0, 1, 2, 1, 3, 2]],
            [[0, 1, 2], [3, 4, 5]],
            texcoords=[[0, 0], [0.5, 0], [0, 1], [0.6, 0], [1, 1], [0.1, 1], [9, 9]],
            face_texcoords=[[0, 1, 2], [3, 4, 5]],
            normals=[[0, 0, 1], [0, 1, 0]],
            face_normals=[[0, 0, 0], [1, 1, 1]],
        )
    )
    assert result.mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert result.vertex_map.tolist() == [0, 1, 2, 1, 3, 2]
    assert result.mesh.texcoords[result.mesh.face_texcoords[1]].tolist() == [
        [0.6, 0],
        [1, 1],
        [0.1, 1],
    ]
    assert len(result.mesh.texcoords) == 6  # the unused row is gone
    assert result.mesh.face_normals.tolist() == [[0, 0, 0], [1, 1, 1]]
    assert (result.merged_vertices, result.unreferenced_vertices) == (2, 0)


def test_what_welding_makes_degenerate_goes() -> None:
    sliver = Mesh(CORNERS[[0, 1, 2, 1]], [[0, 1, 2], [0, 1, 3]])
    assert clean(sliver).mesh.faces.tolist() == [[0, 1, 2]]
    assert clean(sliver).degenerate_faces == 1
    assert clean(sliver, weld=False).mesh.faces.tolist() == [[0, 1, 2], [0, 1, 3]]


def test_the_lowest_vertex_in_use_gives_its_color() -> None:
    result = clean(
        Mesh(
            CORNERS[[1, 0, 1, 2, 1]],
            [[1, 2, 3], [1, 4, 3]],
            colors=[[9, 9, 9], [0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]],
        ),
        duplicates="keep",
    )
    assert result.mesh.colors.tolist() == [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    assert result.vertex_map.tolist() == [-1, 0, 1, 2, 1]
    assert result.changed_vertices == 1


def test_faces_that_welding_makes_equal_are_copies() -> None:
    mesh = Mesh(
        CORNERS[[0, 1, 2, 0, 1, 2]],
        [[0, 1, 2], [3, 4, 5]],
        colors=[[0, 0, 0]] * 3 + [[1, 1, 1]] * 3,
    )
    assert clean(mesh).duplicate_faces == 1
    assert clean(mesh).changed_vertices == 3
    assert clean(mesh, weld=False).duplicate_faces == 0


def two_faces(second: list[int], **arrays: object) -> Mesh:
    return Mesh(CORNERS, [[0, 1, 2], second], **arrays)


@pytest.mark.parametrize(
    ("second", "duplicates", "kept"),
    [
        ([0, 1, 2], "same", 1),
        ([1, 2, 0], "same", 1),
        ([2, 1, 0], "same", 2),
        ([2, 1, 0], "any", 1),
        ([1, 2, 0], "any", 1),
        ([1, 2, 0], "keep", 2),
        ([1, 2, 3], "any", 2),
    ],
)
def test_orientation_of_duplicates(second: list[int], duplicates: str, kept: int) -> None:
    result = clean(two_faces(second), duplicates=duplicates)
    assert result.mesh.num_faces == kept
    assert result.duplicate_faces == 2 - kept
    assert result.face_map.tolist() == [0, kept - 1 if kept == 2 else -1]


@pytest.mark.parametrize(
    "arrays",
    [
        {"face_material": [0, 1], "materials": [Material("a"), Material("b")]},
        {"texcoords": [[0, 0], [1, 0], [0, 1], [1, 1]], "face_texcoords": [[0, 1, 2], [0, 1, 3]]},
        {"texcoords": [[0, 0], [1, 0], [0, 1]], "face_texcoords": [[0, 1, 2], [-1, -1, -1]]},
    ],
)
def test_faces_that_look_different_are_no_exact_copies(arrays: dict[str, object]) -> None:
    mesh = two_faces([0, 1, 2], **arrays)
    assert clean(mesh).duplicate_faces == 0
    assert clean(mesh, duplicates="any").changed_faces == 1


def test_equal_values_in_other_rows_are_exact_copies() -> None:
    mesh = two_faces(
        [1, 2, 0],
        texcoords=[[0, 0], [1, 0], [0, 1], [1, 0], [0, 1], [-0.0, 0]],
        face_texcoords=[[0, 1, 2], [3, 4, 5]],
    )
    result = clean(mesh)
    assert result.duplicate_faces == 1
    assert len(result.mesh.texcoords) == 3


def test_names_of_materials_and_file_stay() -> None:
    mesh = two_faces([1, 3, 2], face_material=[0, 0], materials=[Material("a")], source="x.obj")
    assert clean(mesh).mesh.materials == mesh.materials
    assert clean(mesh).mesh.source == "x.obj"


def test_unknown_kind_of_duplicates_is_refused() -> None:
    with pytest.raises(InputError, match="duplicates: expected 'same', 'any' or 'keep', got 'all'"):
        clean(two_faces([0, 1, 2]), duplicates="all")


def corner_values(mesh: Mesh, face: int) -> list[tuple]:
    """Return position, texture coordinate and normal of each corner of a face."""
    rows = [mesh.vertices[mesh.faces[face]] + 0.0]
    for table, indices in (
        (mesh.texcoords, mesh.face_texcoords),
        (mesh.normals, mesh.face_normals),
    ):
        if indices is not None:
            values = np.full((3, 3), np.nan)
            for corner, row in enumerate(indices[face]):
                if row >= 0:
                    values[corner, : table.shape[1]] = table[row] + 0.0
            rows.append(values)
    return np.nan_to_num(np.hstack(rows), nan=-99.0).tolist()


def kinds_of_duplicates(mesh: Mesh, duplicates: str) -> set:
    """Return the distinct faces of a mesh, with the equality of 'same' or of 'any'."""
    kinds = set()
    for f in range(mesh.num_faces):
        corners = [tuple(corner) for corner in corner_values(mesh, f)]
        if mesh.colors is not None:
            corners = [
                (*corner, *mesh.colors[v]) for corner, v in zip(corners, mesh.faces[f], strict=True)
            ]
        material = -1 if mesh.face_material is None else mesh.face_material[f]
        if duplicates == "any":
            kinds.add(tuple(sorted(corner[:3] for corner in corners)))
        else:
            kinds.add((material, *min(corners[i:] + corners[:i] for i in range(3))))
    return kinds


@given(soups(), options)
def test_maps_and_counts_agree(mesh: Mesh, kwargs: dict) -> None:
    result = clean(mesh, **kwargs)
    out = result.mesh
    kept = np.flatnonzero(result.face_map >= 0)
    assert result.face_map[kept].tolist() == list(range(out.num_faces))
    for new, old in enumerate(kept):
        assert corner_values(out, new) == corner_values(mesh, old)
        assert out.faces[new].tolist() == result.vertex_map[mesh.faces[old]].tolist()
        if mesh.face_material is not None:
            assert out.face_material[new] == mesh.face_material[old]
    used = result.vertex_map >= 0
    assert set(result.vertex_map[used].tolist()) == set(range(out.num_vertices))
    assert (out.vertices[result.vertex_map[used]] == mesh.vertices[used]).all()
    assert mesh.num_faces == out.num_faces + result.degenerate_faces + result.duplicate_faces
    assert (
        mesh.num_vertices
        == out.num_vertices + result.merged_vertices + result.unreferenced_vertices
    )


@given(soups(), options)
def test_nothing_unclean_remains(mesh: Mesh, kwargs: dict) -> None:
    out = clean(mesh, **kwargs).mesh
    summary = out.summary()
    assert summary.unreferenced_vertices == 0
    assert summary.degenerate_faces == 0
    if kwargs["weld"]:
        assert summary.vertices == summary.vertices_welded
        assert summary.degenerate_faces_welded == 0
    for table, indices in ((out.texcoords, out.face_texcoords), (out.normals, out.face_normals)):
        if table is not None:
            assert set(range(len(table))) <= set(indices.ravel().tolist())
    if kwargs["duplicates"] != "keep":
        assert len(kinds_of_duplicates(out, kwargs["duplicates"])) == out.num_faces
    if kwargs["duplicates"] == "same":
        before = clean(mesh, weld=kwargs["weld"], duplicates="keep").mesh
        assert kinds_of_duplicates(out, "same") == kinds_of_duplicates(before, "same")


@given(soups(), options)
def test_cleaning_twice_changes_nothing(mesh: Mesh, kwargs: dict) -> None:
    once = clean(mesh, **kwargs).mesh
    again = clean(once, **kwargs)
    assert again.vertex_map.tolist() == list(range(once.num_vertices))
    assert again.face_map.tolist() == list(range(once.num_faces))
    for name in ("vertices", "faces", "texcoords", "face_texcoords", "normals", "colors"):
        np.testing.assert_array_equal(getattr(again.mesh, name), getattr(once, name))
