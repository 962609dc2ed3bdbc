"""Reading and writing of mesh files: round trips, names and errors common to all formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import io

QUAD_OBJ = b"""\
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1 2 3 4
"""


def test_missing_file_is_file_not_found(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        manip3d.read_mesh(tmp_path / "none.obj")
    assert caught.value.filename == str(tmp_path / "none.obj")


def test_format_error_names_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / "bad.obj"
    path.write_bytes(QUAD_OBJ + b"f 1 2 9\n")
    with pytest.raises(manip3d.FormatError) as caught:
        manip3d.read_mesh(path)
    assert (caught.value.file, caught.value.line) == (str(path), 6)
    assert str(caught.value) == f"{path}: line 6: vertex index: expected 1 to 4, got 9"


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".obj.gz", ".ply.xz"])
def test_round_trip_keeps_bits(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(1)
    mesh = manip3d.Mesh(
        rng.normal(size=(5, 3)) * 1e3,
        [[0, 1, 2], [2, 3, 4]],
        texcoords=rng.random((4, 2)).astype(np.float32),
        face_texcoords=[[0, 1, 2], [-1, -1, -1]],
        colors=rng.integers(0, 256, (5, 3), dtype=np.uint8),
        face_material=[1, -1],
        materials=[manip3d.Material("a b"), manip3d.Material("c")],
    )
    mesh.write(tmp_path / f"m{suffix}")
    back = manip3d.read_mesh(tmp_path / f"m{suffix}")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    assert back.texcoords is not None
    assert mesh.texcoords is not None
    assert back.face_texcoords is not None
    np.testing.assert_array_equal(back.texcoords[back.face_texcoords[0]], mesh.texcoords[:3])
    np.testing.assert_array_equal(back.face_texcoords[1], [-1, -1, -1])
    assert back.colors is not None
    np.testing.assert_array_equal(back.colors, mesh.colors)
    assert back.face_material is not None
    names = [back.materials[i].name if i >= 0 else None for i in back.face_material]
    assert names == ["c", None]


def test_bytes_and_unknown_suffix_are_told_by_content(tmp_path: Path) -> None:
    assert io.read_mesh_bytes(QUAD_OBJ, "obj").num_faces == 2
    (tmp_path / "m.dat").write_bytes(QUAD_OBJ)
    assert manip3d.read_mesh(tmp_path / "m.dat").num_faces == 2
    with pytest.raises(manip3d.InputError, match="format"):
        io.read_mesh_bytes(QUAD_OBJ, "doc")
    with pytest.raises(manip3d.InputError, match=r"path: expected one of"):
        io.read_mesh_bytes(QUAD_OBJ).write(tmp_path / "m.doc")
