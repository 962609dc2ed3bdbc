"""Colours of faces in STL, OFF and PLY become materials, and colours of materials are written."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import Mesh, io
from manip3d.io._face_colors import with_corner_colors

RED, BLUE = (255, 0, 0), (0, 0, 255)
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
TWO = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def srgb_of_faces(mesh: Mesh) -> list[tuple[int, ...] | None]:
    assert mesh.face_material is not None
    linear = np.array([m.base_color[:3] for m in mesh.materials])
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    colors = np.rint(255 * srgb).astype(int)
    return [None if i < 0 else tuple(colors[i].tolist()) for i in mesh.face_material]


def colored_stl(attributes: list[int], header: bytes = b"") -> bytes:
    rows = [
        np.concatenate([[0, 0, 1], SQUARE[face].reshape(-1)]).astype("<f4").tobytes()
        + struct.pack("<H", attribute)
        for face, attribute in zip(TWO, attributes, strict=True)
    ]
    return header.ljust(80, b" ") + struct.pack("<I", len(rows)) + b"".join(rows)


ORANGE_PART = b"COLOR=\xff\x80\x00\xff,MATERIAL=0000"
ORANGE = (255, 128, 0)
# MeshLab's header, and MeshLab's attributes of red and blue.
GREY_PART = b"COLOR=\x7f\x7f\x7f\xff MATERIAL=\x7f\x7f\x7f\xff"
MARKED_RED, MARKED_BLUE = 0x801F, 0xFC00
GREY, BLACK, WHITE = (127, 127, 127), (0, 0, 0), (255, 255, 255)


@pytest.mark.parametrize(
    ("attributes", "header", "expected"),
    [
        ([0x8000 | 31 << 10, 0x8000 | 31], b"", [RED, BLUE]),
        ([0x8000 | 31 << 10, 31], b"", [RED, None]),  # VisCAM: not marked, no colour
        ([31, 31 << 10], ORANGE_PART, [RED, BLUE]),
        ([31, 0x8000], ORANGE_PART, [RED, ORANGE]),  # Magics: marked, the colour of the part
        ([0, 0], b"made by me " + ORANGE_PART, [ORANGE, ORANGE]),
        ([MARKED_RED, MARKED_BLUE], GREY_PART, [RED, BLUE]),
        ([MARKED_RED, MARKED_RED], GREY_PART, [RED, RED]),
        ([0x8000, 0xFFFF], GREY_PART, [BLACK, WHITE]),
        ([0, 0], GREY_PART, [GREY, GREY]),
        ([MARKED_RED, MARKED_BLUE], ORANGE_PART, [RED, BLUE]),  # they differ: no mark of Magics
        ([MARKED_RED, MARKED_RED], ORANGE_PART, [ORANGE, ORANGE]),
        ([0x8000, 0xFFFF], ORANGE_PART, [ORANGE, ORANGE]),
    ],
)
def test_colors_of_binary_stl(
    attributes: list[int], header: bytes, expected: list[tuple[int, ...] | None]
) -> None:
    assert srgb_of_faces(io.read_mesh_bytes(colored_stl(attributes, header), "stl")) == expected


@pytest.mark.parametrize(
    ("attributes", "header"), [([0, 0], b""), ([31, 5], b"x" * 74 + b"COLOR=")]
)
def test_an_stl_without_colors_has_no_materials(attributes: list[int], header: bytes) -> None:
    mesh = io.read_mesh_bytes(colored_stl(attributes, header), "stl")
    assert mesh.materials == ()
    assert mesh.face_material is None


def off(first: str, second: str, keyword: str = "OFF") -> str:
    return f"{keyword}\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 {first}\n3 0 2 3 {second}\n"


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("255 0 0", "0 0 255", [RED, BLUE]),
        ("255 0 0 255", "0.0 0 1.0 .5", [RED, BLUE]),
        ("", "0.0 0 1.0", [None, BLUE]),
        ("1 0 0", "0.0 0 1.0", [RED, BLUE]),
        ("1 0 0 1.0", "0 0 1 0.5", [RED, BLUE]),
    ],
)
def test_colors_of_off_faces(
    first: str, second: str, expected: list[tuple[int, ...] | None]
) -> None:
    assert srgb_of_faces(io.read_mesh_bytes(off(first, second).encode(), "off")) == expected


def test_off_faces_that_name_a_place_in_a_table_of_colors_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.off").write_text(off("7", "8"))
    report = io.read_report(tmp_path / "a.off")
    assert report.warnings == ("colors of faces that are no 3 or 4 numbers are left out",)
    assert report.num_skipped == 2


@pytest.mark.parametrize("keyword", ["nOFF\n3", "nOFF 3"])
def test_an_off_that_says_three_dimensions_is_read(keyword: str) -> None:
    assert io.read_mesh_bytes(off("", "", keyword).encode()).num_faces == 2


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
{vertex}element face 2
property list uchar int vertex_indices
property uchar red
property uchar green
property uchar blue
property uchar alpha
{face}end_header
"""


def colored_ply(vertex: str = "", face: str = "", tails: tuple[str, str, str] = ("",) * 3) -> str:
    at, first, second = tails
    rows = "".join(f"{x:g} {y:g} {z:g} {at}\n" for x, y, z in SQUARE)
    rows += f"3 0 1 2 255 0 0 255 {first}\n3 0 2 3 0 0 255 255 {second}\n"
    return PLY.format(vertex=vertex, face=face) + rows


def test_colors_of_ply_faces() -> None:
    assert srgb_of_faces(io.read_mesh_bytes(colored_ply().encode())) == [RED, BLUE]


def test_colors_of_ply_faces_are_those_of_their_materials() -> None:
    text = colored_ply(face="property int material_index\n", tails=("", "1", "0"))
    mesh = io.read_mesh_bytes(text.encode())
    assert [m.name for m in mesh.materials] == ["material_0", "material_1"]
    assert srgb_of_faces(mesh) == [RED, BLUE]


def test_ply_warns_of_what_a_mesh_has_no_place_for(tmp_path: Path) -> None:
    colors = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha"))
    text = colored_ply(
        colors + "property float quality\nproperty int label\n", tails=("1 2 3 100 .5 7", "", "")
    )
    (tmp_path / "a.ply").write_text(text)
    report = io.read_report(tmp_path / "a.ply")
    assert report.warnings == (
        "properties of element vertex are left out: quality, label",
        "alpha of colors is left out",
        "colors of faces are left out: there are those of vertices",
    )


def test_faces_of_very_many_colors_give_them_to_vertices(tmp_path: Path) -> None:
    # A strip of separate triangles, each of another colour; the last face has the first's corners.
    count = 300
    rows = "".join(f"{i} 0 0\n{i} 1 0\n{i} 0 1\n" for i in range(count))
    rows += "".join(
        f"3 {3 * i} {3 * i + 1} {3 * i + 2} {i % 256} {i // 256} 10\n" for i in range(count)
    )
    (tmp_path / "a.off").write_text(f"OFF\n{3 * count} {count + 1} 0\n{rows}3 0 2 1 4 100 10\n")
    report = io.read_report(tmp_path / "a.off")
    assert report.mesh.materials == ()
    assert report.mesh.colors is not None
    assert report.mesh.colors[[0, 3, 897]].tolist() == [[2, 50, 10], [1, 0, 10], [43, 1, 10]]
    assert report.warnings == (
        "faces have more than 256 colors: each vertex takes the mean of its faces",
    )


@pytest.mark.parametrize("suffix", [".ply", ".off", ".stl", ".obj", ".glb"])
def test_colors_of_faces_are_kept(suffix: str, tmp_path: Path) -> None:
    mesh = io.read_mesh_bytes(off("255 0 0", "0 0 255").encode(), "off")
    io.write_mesh(mesh, tmp_path / f"a{suffix}")
    back = io.read_mesh(tmp_path / f"a{suffix}")
    assert set(srgb_of_faces(back)) == {RED, BLUE}


def test_colors_of_faces_stay_on_their_side_when_simplified() -> None:
    # Two halves of a grid of another colour each.
    size = 20
    at = [f"{x} {y} 0\n" for y in range(size + 1) for x in range(size + 1)]
    quads = [
        f"4 {i} {i + 1} {i + size + 2} {i + size + 1} {'255 0 0' if x < size // 2 else '0 0 255'}\n"
        for y in range(size)
        for x in range(size)
        for i in [y * (size + 1) + x]
    ]
    text = f"OFF\n{len(at)} {len(quads)} 0\n" + "".join(at + quads)
    mesh = io.read_mesh_bytes(text.encode(), "off")
    light = manip3d.simplify.quality(mesh, target_faces=8).mesh
    middles = light.vertices[light.faces].mean(axis=1)
    expected = [RED if x < size / 2 else BLUE for x in middles[:, 0]]
    assert srgb_of_faces(light) == expected


def test_ply_warns_of_textures_that_it_has_no_place_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = io.read_mesh_bytes(off("255 0 0", "0 0 255").encode(), "off")
    for material in mesh.materials:
        material.textures["normal"] = manip3d.mesh.Texture("n.png")
    io.write_mesh(mesh, tmp_path / "a.ply")
    assert "PLY: textures of normal left out" in caplog.text
    assert caplog.text.count("textures of normal") == 1


@pytest.mark.filterwarnings("ignore:source. faces have more than 256 colors")
@pytest.mark.parametrize("most", [3, 300])
def test_a_file_and_trimesh_give_the_same_colors(most: int) -> None:
    trimesh = pytest.importorskip("trimesh")
    count = 300
    vertices = [[i // 2, i % 2, 0] for i in range(count + 2)]
    faces = np.arange(count)[:, None] + np.arange(3)
    colors = np.array([[255 - i % most % 256, i % most // 256, 1] for i in range(count)])
    lines = [f"OFF\n{count + 2} {count} 0", *(f"{x} {y} {z}" for x, y, z in vertices)]
    for (a, b, c), (red, green, blue) in zip(faces, colors, strict=True):
        lines.append(f"3 {a} {b} {c} {red} {green} {blue}")
    read = io.read_mesh_bytes("\n".join(lines).encode(), "off")
    strip = trimesh.Trimesh(vertices, faces, face_colors=colors.astype(np.uint8), process=False)
    made = Mesh.from_trimesh(strip)
    assert [m.name for m in made.materials] == [m.name for m in read.materials]
    assert (made.colors is None) == (most == 3)
    for name in ("face_material", "colors"):
        np.testing.assert_array_equal(getattr(made, name), getattr(read, name))


def test_colors_beside_a_material_do_not_tint_the_materials_made_of_others() -> None:
    """glTF multiplies the colour of a material by those of its vertices."""
    material = manip3d.Material(name="paint")
    mesh = Mesh(SQUARE, TWO, face_material=np.array([0, -1], np.int32), materials=(material,))
    red, blue = 0xFF0000, 0x0000FF
    told: list[str] = []
    both = with_corner_colors(mesh, np.array([[red] * 3, [blue] * 3]), told.append)
    assert srgb_of_faces(both) == [WHITE, BLUE]
    assert both.colors is not None
    assert both.colors.tolist() == [[255, 128, 128], [255, 0, 0], [255, 128, 128], [255, 255, 255]]
    assert told == [
        "faces with materials have colors, too: each vertex takes the mean of its faces"
    ]


def test_a_material_with_the_name_of_none_is_kept_in_an_obj(tmp_path: Path) -> None:
    materials = (
        manip3d.Material(name="manip3d_no_material", base_color=(1.0, 0.0, 0.0, 1.0)),
        manip3d.Material(name="manip3d_no_material_"),
    )
    mesh = Mesh(SQUARE, TWO, face_material=np.array([0, -1], np.int32), materials=materials)
    mesh.write(tmp_path / "a.obj")
    again = manip3d.read_mesh(tmp_path / "a.obj")
    assert srgb_of_faces(again) == [RED, None]
    mesh.replace(face_material=None).write(tmp_path / "bare.obj")
    assert "usemtl" not in (tmp_path / "bare.obj").read_text()
    assert "no_material\n" not in (tmp_path / "bare.mtl").read_text()
