"""Every syntax rule of OBJ, MTL, PLY, OFF and STL, with its exact result."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manip3d
from gltf_files import PNG
from manip3d import FormatError, Material, Mesh, Texture, io, read_mesh, simplify
from manip3d.io import read_mesh_bytes

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
VT = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def obj(text: str) -> manip3d.Mesh:
    return read_mesh_bytes(text.encode(), "obj")


def error(text: str | bytes, kind: str) -> manip3d.FormatError:
    data = text.encode() if isinstance(text, str) else text
    with pytest.raises(manip3d.FormatError) as caught:
        read_mesh_bytes(data, kind)
    return caught.value


# --- OBJ ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("face", "texcoords", "normals"),
    [
        ("f 1 2 3", None, None),
        ("f 1/1 2/2 3/3", [0, 1, 2], None),
        ("f 1//1 2//1 3//1", None, [0, 0, 0]),
        ("f 1/3/1 2/2/1 3/1/1", [2, 1, 0], [0, 0, 0]),
        ("f 1/1/ 2/2/ 3/3/", [0, 1, 2], None),
        ("f 1/1 2 3//1", [0, -1, -1], [-1, -1, 0]),
        ("f -4/-4/-1 -3/-3/-1 -2/-2/-1", [0, 1, 2], [0, 0, 0]),
        ("f\t1 2  3 # comment", None, None),
        ("f 1 \\\n 2 \\\n 3", None, None),
        ("fo 1 2 3", None, None),
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_obj_corners(
    face: str, texcoords: list[int] | None, normals: list[int] | None, newline: str
) -> None:
    mesh = obj((SQUARE + VT + "vn 0 0 1\n" + face).replace("\n", newline))
    assert mesh.faces.tolist() == [[0, 1, 2]]
    expected = None if texcoords is None else [texcoords]
    assert (None if mesh.face_texcoords is None else mesh.face_texcoords.tolist()) == expected
    expected = None if normals is None else [normals]
    assert (None if mesh.face_normals is None else mesh.face_normals.tolist()) == expected


def test_obj_negative_index_counts_from_the_last_row_so_far() -> None:
    mesh = obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nf -1 -2 -3\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 2, 1]]


def test_obj_positive_index_may_point_ahead() -> None:
    assert obj("f 1 2 3 4\n" + SQUARE).faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_obj_attributes_may_begin_and_end_at_any_face() -> None:
    mesh = obj(SQUARE + VT + "f 1 2 3\nf 1/1 2/2 3/3 4/4\nf 1 3 4\n")
    assert mesh.face_texcoords is not None
    assert mesh.face_texcoords.tolist() == [[-1] * 3, [0, 1, 2], [0, 2, 3], [-1] * 3]


def test_obj_vertex_colors() -> None:
    mesh = obj("v 0 0 0 1 0.5 0\nv 1 0 0\nv 0 1 0 0 0 1 1\nf 1 2 3")
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[255, 128, 0], [255, 255, 255], [0, 0, 255]]
    mesh = obj("v 0 0 0 255 127 0\nv 1 0 0 1 0 0\nv 0 1 0 0 0 1\nf 1 2 3")
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[255, 127, 0], [1, 0, 0], [0, 0, 1]]
    # overexposed or rounded: the others keep their meaning
    mesh = obj("v 0 0 0 1.0001 0.5 0\nv 1 0 0 1.9 0 0\nv 0 1 0 0 0 1\nf 1 2 3")
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[255, 128, 0], [255, 0, 0], [0, 0, 255]]
    # bytes that were averaged, and bytes of a dark mesh
    mesh = obj("v 0 0 0 199.5 0.5 0\nv 1 0 0 1 0 0\nv 0 1 0 0 0 1\nf 1 2 3")
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[200, 1, 0], [1, 0, 0], [0, 0, 1]]
    mesh = obj("v 0 0 0 2 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3")
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[2, 1, 0], [255, 255, 255], [255, 255, 255]]
    assert obj("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 0.5\nf 1 2 3").colors is None  # w of curves


def test_obj_numbers_are_exact() -> None:
    texts = ["+1.5", "1e-3", "-.25", "5.", "0.1", "1e-400", "-1e-5000", "-0"]
    texts += ["123456789.123456789"]
    texts += ["2.2250738585072011e-308", "179769313486231570000e288", "1E5", "9007199254740993"]
    mesh = obj("".join(f"v {t} 0 0\n" for t in texts) + "f 1 2 3")
    assert mesh.vertices[:, 0].tolist() == [float(t) for t in texts]


def test_obj_materials_in_order_of_use() -> None:
    text = SQUARE + "f 1 2 3\nusemtl red paint\nf 1 3 4\nusemtl b\nf 1 2 4\nusemtl red paint\n"
    mesh = obj(text + "f 2 3 4\nusemtl\nf 1 2 3")
    assert [m.name for m in mesh.materials] == ["red paint", "b"]
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [-1, 0, 1, 0, -1]


def test_obj_skips_and_counts_what_it_does_not_know(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("# c\n\no a\ng b\ns off\nl 1 2\nfoo bar\n" + SQUARE + "f 1 2 3")
    assert io.read_report(tmp_path / "m.obj").num_skipped == 5


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("v 0 0", "v: expected a finite number, got the end of the line"),
        ("v 0 0 x1", "v: expected a finite number, got 'x1'"),
        ("v 0 0 nan", "v: expected a finite number, got 'nan'"),
        ("v 0 inf 0", "v: expected a finite number, got 'inf'"),
        ("v 0 0 1e999", "v: expected a number that fits a double, got '1e999'"),
        ("v 0 0 1e5000", "v: expected a number that fits a double, got '1e5000'"),
        ("v 0 0 +-5", "v: expected a finite number, got '+-5'"),
        ("v 0 0 0x1", "v: expected a finite number, got '0x1'"),
        ("v 0 0 0 1 2", "v: expected 3, 4, 6 or 7 numbers, got the end of the line"),
        ("v 0 0 0 1 2 3 4 5", "v: expected 3, 4, 6 or 7 numbers, got '5'"),
        ("vn 0 0", "vn: expected a finite number, got the end of the line"),
        ("vt", "vt: expected a finite number, got the end of the line"),
        ("f 1 2 0", "face: expected v, v/vt, v//vn or v/vt/vn with indices that exist, got '0'"),
        ("f 1 2 -5", "face: expected v, v/vt, v//vn or v/vt/vn with indices that exist, got '-5'"),
        ("f 1 2 3x", "face: expected v, v/vt, v//vn or v/vt/vn with indices that exist, got '3x'"),
        (
            "f 1 2 99999999999999999999",
            "face: expected v, v/vt, v//vn or v/vt/vn with indices that exist, "
            "got '99999999999999999999'",
        ),
        ("f 1 2 5", "vertex index: expected 1 to 4, got 5"),
        ("f 1 2 3 4 9", "vertex index: expected 1 to 4, got 9"),
    ],
)
def test_obj_errors_name_the_line(line: str, message: str) -> None:
    caught = error(SQUARE + line + "\nf 1 2 3\n", "obj")
    assert (caught.line, caught.reason, caught.byte_offset) == (5, message, None)


@pytest.mark.parametrize(
    ("lines", "warnings"),
    [
        ("l 1 2\nl 2 3 4\np 1\n", ("points and lines are left out",)),
        ("p 1 2\n", ("points and lines are left out",)),
        ("cstype bezier\nsurf 0 1 0 1 1 2 3 4\n", ("free-form curves and surfaces are left out",)),
        ("o a\ng b\ns off\n", ()),
    ],
)
def test_obj_shapes_that_are_no_faces_are_left_out_with_a_warning(
    tmp_path: Path, lines: str, warnings: tuple[str, ...]
) -> None:
    (tmp_path / "m.obj").write_text(SQUARE + lines + "f 1 2 3\n")
    seen = io.read_report(tmp_path / "m.obj")
    assert (seen.mesh.num_faces, seen.warnings) == (1, warnings)


# --- MTL ------------------------------------------------------------------------------------


def with_mtl(folder: Path, mtl: str, **options: bool) -> io.ReadReport:
    (folder / "m.mtl").write_text(mtl)
    (folder / "m.obj").write_text("mtllib m.mtl\n" + SQUARE + "usemtl a\nf 1 2 3\n")
    return io.read_report(folder / "m.obj", **options)


def test_mtl_factors(tmp_path: Path) -> None:
    text = "newmtl other\nKd 0 0 0\nnewmtl a\nKd 0.25 0.5 0.75\nd 0.5\nPr 0.3\nPm 0.7\nNs 10\n"
    (material,) = with_mtl(tmp_path, text).mesh.materials
    assert material.base_color == (0.25, 0.5, 0.75, 0.5)
    assert (material.metallic, material.roughness, material.alpha_mode) == (0.7, 0.3, "blend")
    (material,) = with_mtl(tmp_path, "newmtl a\nTr 0.25\nKd 0.5\n").mesh.materials
    assert material.base_color == (0.5, 0.5, 0.5, 0.75)
    (material,) = with_mtl(tmp_path, "newmtl a\nd -halo 1\nKd spectral f.rfl\n").mesh.materials
    assert (material.base_color, material.alpha_mode) == ((1, 1, 1, 1), "opaque")
    for option in ("-halo", "-HALO"):
        (material,) = with_mtl(tmp_path, f"newmtl a\nd {option} 0.5\n").mesh.materials
        assert (material.base_color[3], material.alpha_mode) == (0.5, "blend")
    seen = with_mtl(tmp_path, "newmtl a\nd -0.0\n")
    assert seen.warnings == ("m.mtl: materials of opacity 0 (d 0, Tr 1) are read as opaque",)


def test_mtl_opacity_of_0_does_not_make_parts_invisible(tmp_path: Path) -> None:
    """Old exporters write the opacity as Tr; others forget what d means."""
    text = "newmtl a\nd 1\nTr 1\nnewmtl b\nd 0\nnewmtl c\nTr 0.999\n"
    (tmp_path / "m.mtl").write_text(text)
    uses = "".join(f"usemtl {name}\nf 1 2 3\n" for name in "abc")
    (tmp_path / "m.obj").write_text("mtllib m.mtl\n" + SQUARE + uses)
    report = io.read_report(tmp_path / "m.obj")
    looks = [(m.base_color[3], m.alpha_mode) for m in report.mesh.materials]
    assert looks == [(1, "opaque"), (1, "opaque"), (pytest.approx(0.001), "blend")]
    assert report.warnings == ("m.mtl: materials of opacity 0 (d 0, Tr 1) are read as opaque",)


@pytest.mark.parametrize(
    ("line", "role", "path"),
    [
        ("map_Kd a.png", "base_color", "a.png"),
        ("map_Kd my picture.png", "base_color", "my picture.png"),
        ("map_Kd sub\\a.png", "base_color", "sub/a.png"),
        ("map_Kd -s 2 2 2 -o 0.5 -mm 0 1 -blendu on a b.png", "base_color", "a b.png"),
        ("map_Kd -clamp on -bm 1 a.png", "base_color", "a.png"),
        ("map_Ke e.png", "emissive", "e.png"),
        ("norm n.png", "normal", "n.png"),
        ("map_Pr r.png\nmap_Pm r.png", "metallic_roughness", "r.png"),
    ],
)
def test_mtl_textures(tmp_path: Path, line: str, role: str, path: str) -> None:
    (material,) = with_mtl(tmp_path, f"newmtl a\n{line}\n").mesh.materials
    assert {r: t.path for r, t in material.textures.items()} == {role: path}


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("Kd 1 x 1", "Kd: expected a finite number, got 'x'"),
        ("Kd", "Kd: expected three numbers, got the end of the line"),
        ("Kd nan 0 0", "Kd: expected a finite number, got 'nan'"),
        ("map_Kd", "map_Kd: expected a file name, got the end of the line"),
        ("map_Kd -bm 1", "map_Kd: expected a file name, got the end of the line"),
        ("d", "d: expected a number, got the end of the line"),
        ("Pr rough", "Pr: expected a finite number, got 'rough'"),
    ],
)
def test_mtl_line_with_a_fault_costs_what_it_says(
    tmp_path: Path, line: str, complaint: str
) -> None:
    seen = with_mtl(tmp_path, f"newmtl a\n{line}\nPm 0.5\n")
    (material,) = seen.mesh.materials
    assert material == manip3d.Material("a", metallic=0.5)
    assert seen.warnings == (f"m.mtl: line 2: {complaint}; the line is left out",)


@pytest.mark.parametrize(
    "path", ["C:\\Users\\Jo Doe\\maps\\a.png", "/elsewhere/maps/a.png", "\\\\server\\maps\\a.png"]
)
def test_mtl_textures_of_another_machine_are_found_beside(tmp_path: Path, path: str) -> None:
    (tmp_path / "a.png").touch()
    seen = with_mtl(tmp_path, f"newmtl a\nmap_Kd {path}\n")
    assert seen.mesh.materials[0].textures["base_color"].path == "a.png"
    assert seen.warnings == ()


@pytest.mark.parametrize("path", ["maps/a.png", "maps\\a.png", "../maps/a.png"])
def test_mtl_textures_of_a_missing_folder_are_found_beside(tmp_path: Path, path: str) -> None:
    (tmp_path / "a.png").touch()
    seen = with_mtl(tmp_path, f"newmtl a\nmap_Kd {path}\n")
    assert seen.mesh.materials[0].textures["base_color"].path == "a.png"
    written = path.replace("\\", "/")
    assert seen.warnings == (f"texture '{written}' not found, 'a.png' is used",)


@pytest.mark.parametrize("path", ["maps/a.png", "maps/b.png"])
def test_mtl_textures_stay_where_they_are_or_nowhere(tmp_path: Path, path: str) -> None:
    (tmp_path / "a.png").touch()
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "a.png").touch()
    seen = with_mtl(tmp_path, f"newmtl a\nmap_Kd {path}\n")
    assert seen.mesh.materials[0].textures["base_color"].path == path
    assert seen.warnings == ()


def test_a_texture_beside_may_not_be_a_link_to_elsewhere(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.png").touch()
    (inner / "a.png").symlink_to("../secret.png")
    seen = with_mtl(inner, "newmtl a\nmap_Kd maps/a.png\n")
    assert seen.mesh.materials[0].textures["base_color"].path == "maps/a.png"


def test_mtl_faults_of_one_keyword_are_counted(tmp_path: Path) -> None:
    seen = with_mtl(tmp_path, "newmtl b\nmap_Kd\nnewmtl a\nKd 0.5\nmap_Kd\nmap_Kd\nKd\n")
    assert seen.mesh.materials[0].base_color == (0.5, 0.5, 0.5, 1)
    assert seen.warnings == (
        "m.mtl: line 7: Kd: expected three numbers, got the end of the line; the line is left out",
        "m.mtl: line 2: map_Kd: expected a file name, got the end of the line; the line is left "
        "out, and 2 more of its kind",
    )


def test_mtl_of_faults_alone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(manip3d.FormatError, match="Kd: expected three numbers") as caught:
        with_mtl(tmp_path, "newmtl a\n" + 100_001 * "Kd\n")
    assert (caught.value.file, caught.value.line) == (str(tmp_path / "m.mtl"), 100_002)


def test_mtl_options_of_textures_name_file_and_line(tmp_path: Path) -> None:
    seen = with_mtl(tmp_path, "newmtl a\nmap_Kd -mm 0.5 1 a.png\n")
    (warning,) = seen.warnings
    assert warning == "m.mtl: line 2: texture option -mm is not supported and was left out"


def test_textures_of_mtl_that_clamp_survive(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(PNG)
    maps = "".join(f"{key} -clamp on a.png\n" for key in ("map_Kd", "map_Pr", "map_Pm", "norm"))
    seen = with_mtl(tmp_path, f"newmtl a\n{maps}map_Ke a.png\n")
    assert seen.warnings == ()
    wraps = {role: own.wrap for role, own in seen.mesh.materials[0].textures.items()}
    roles = ("base_color", "metallic_roughness", "normal")
    assert wraps == dict.fromkeys(roles, ("clamp", "clamp")) | {"emissive": ("repeat", "repeat")}
    seen.mesh.write(tmp_path / "again.obj")
    assert read_mesh(tmp_path / "again.obj").materials == seen.mesh.materials


@pytest.mark.parametrize(
    "given", [{"wrap": ("mirror", "mirror")}, {"wrap": ("clamp", "repeat")}, {"smooth": False}]
)
@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_samplers_that_a_format_cannot_hold_are_named(
    tmp_path: Path, given: dict[str, Any], suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    material = Material("m", textures={"base_color": Texture(path="a.png", data=PNG, **given)})
    mesh = Mesh(
        np.eye(3),
        [[0, 1, 2]],
        texcoords=np.eye(3)[:, :2],
        face_texcoords=[[0, 1, 2]],
        face_material=[0],
        materials=[material],
    )
    mesh.write(tmp_path / f"a{suffix}")
    lost = {".obj": "OBJ holds no textures that mirror", ".ply": "PLY: samplers of textures left"}
    assert lost[suffix] in caplog.text
    texture = read_mesh(tmp_path / f"a{suffix}").materials[0].textures["base_color"]
    assert (texture.wrap, texture.smooth) == (("repeat", "repeat"), True)


@pytest.mark.parametrize(
    ("line", "path", "option"),
    [
        ('map_Kd "a b.png"', "a b.png", None),
        ("map_Kd -s 1 1.0 1.000 -o 0 0 0 -t 0 -mm 0 1 -clamp off a.png", "a.png", None),
        ("map_Kd -s 1 1 1 -o 0.5 0 0 a.png", "a.png", "-o"),
        ("map_Kd -s 1 2 a.png", "a.png", "-s"),
        ("map_Kd -o 0 0e+00 0E0 wood.png", "wood.png", None),
        ("map_Kd -s +1 1e+00 1.e0 wood.png", "wood.png", None),
        ("map_Kd -o 0 1e+00 0 wood.png", "wood.png", "-o"),
        ("map_Kd -o 0 e wood.png", "e wood.png", None),
        ("map_Kd -o 0 +-1 . wood.png", "+-1 . wood.png", None),
        ("map_Kd -o 0 inf wood.png", "inf wood.png", None),
        ("map_Kd -bm 0.3 a.png", "a.png", None),
    ],
)
def test_mtl_options_that_change_nothing_are_no_loss(
    tmp_path: Path, line: str, path: str, option: str | None
) -> None:
    (tmp_path / path).write_bytes(b"")
    seen = with_mtl(tmp_path, f"newmtl a\n{line}\n")
    assert seen.mesh.materials[0].textures["base_color"].path == path
    assert [f"texture option {option} " in each for each in seen.warnings] == [True] * bool(option)


def test_missing_library_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("mtllib none.mtl\nusemtl a\n" + SQUARE + "f 1 2 3")
    report = io.read_report(tmp_path / "m.obj")
    assert report.warnings == ("material library 'none.mtl' not found",)
    assert report.mesh.materials == (manip3d.Material("a"),)


def test_a_missing_library_with_blanks_in_its_name_is_named_once(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("mtllib ALX02 Base Link.mtl\n" + SQUARE + "f 1 2 3")
    seen = io.read_report(tmp_path / "m.obj")
    assert seen.warnings == ("material library 'ALX02 Base Link.mtl' not found",)


def test_of_several_libraries_the_missing_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "m.obj").write_text("mtllib a.mtl b.mtl\nusemtl a\n" + SQUARE + "f 1 2 3")
    seen = io.read_report(tmp_path / "m.obj")
    assert seen.warnings == ("material library 'b.mtl' not found",)
    assert seen.mesh.materials[0].base_color == (1, 0, 0, 1)


@pytest.mark.parametrize("how", ["parent", "absolute", "link"])
def test_reading_never_leaves_the_folder(tmp_path: Path, how: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "out.mtl").write_text("newmtl a\nPr 0.5\n")
    (tmp_path / "out.png").write_bytes(b"png")
    (inner / "link.mtl").symlink_to("../out.mtl")
    (inner / "link.png").symlink_to("../out.png")
    prefix = {"parent": "../out", "absolute": f"{tmp_path}/out", "link": "link"}[how]
    (inner / "m.obj").write_text(f"mtllib {prefix}.mtl\nusemtl a\n" + SQUARE + "f 1 2 3")
    report = io.read_report(inner / "m.obj")
    assert "outside" in report.warnings[0]
    assert report.mesh.materials[0].roughness == 1.0
    allowed = manip3d.read_mesh(inner / "m.obj", allow_outside=True)
    assert allowed.materials[0].roughness == 0.5

    report = with_mtl(inner, f"newmtl a\nmap_Kd {prefix}.png\n")
    assert report.mesh.materials[0].textures == {}
    assert "outside" in report.warnings[0]
    mesh = with_mtl(inner, f"newmtl a\nmap_Kd {prefix}.png\n", allow_outside=True).mesh
    texture = mesh.materials[0].textures["base_color"]
    found = io.texture_path(mesh, texture)
    assert found is not None
    assert found.read_bytes() == b"png"


def test_texture_path(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"png")
    mesh = with_mtl(tmp_path, "newmtl a\nmap_Kd a.png\n").mesh
    assert io.texture_path(mesh, mesh.materials[0].textures["base_color"]) == tmp_path / "a.png"
    assert io.texture_path(mesh, manip3d.Texture("none.png")) is None
    assert io.texture_path(mesh, manip3d.Texture(None, b"x")) is None
    with pytest.raises(manip3d.InputError, match="outside"):
        io.texture_path(mesh, manip3d.Texture("../a.png"))


@pytest.mark.parametrize(
    ("line", "light"),
    [
        ("Ke 1 0.5 0", (1, 0.5, 0)),
        ("ke 0.5", (0.5, 0.5, 0.5)),
        ("Ke 5 2 -1", (5, 2, 0)),
        ("Ke spectral f.rfl", (0, 0, 0)),
        ("Kd 1 0 0", (0, 0, 0)),
    ],
)
def test_mtl_light(tmp_path: Path, line: str, light: tuple[float, ...]) -> None:
    (material,) = with_mtl(tmp_path, f"newmtl a\n{line}\n").mesh.materials
    assert material.emissive == light


def test_mtl_keywords_may_be_written_in_any_case(tmp_path: Path) -> None:
    text = "NEWMTL a\nkd 0.25 0.5 0.75\nPM 0.5\nmap_kd a.png\nMAP_KE e.png\nNorm n.png\n"
    (material,) = with_mtl(tmp_path, text).mesh.materials
    assert (material.base_color, material.metallic) == ((0.25, 0.5, 0.75, 1.0), 0.5)
    assert {role: t.path for role, t in material.textures.items()} == {
        "base_color": "a.png",
        "emissive": "e.png",
        "normal": "n.png",
    }


def test_mtl_textures_that_are_left_out_are_named_once(tmp_path: Path) -> None:
    lines = "map_Ks s.png\nmap_Bump b.png\nbump b.png\nmap_Pr r.png\nmap_Pm m.png\nmap_d d.png\n"
    report = with_mtl(tmp_path, f"newmtl b\n{lines}newmtl a\nmap_Kd a.png\nNs 10\n{lines}")
    assert report.warnings == (
        "textures of map_Ks are left out: a material has no place for it",
        "textures of map_Bump are left out: a material has no place for it",
        "textures of bump are left out: a material has no place for it",
        "textures of map_Pr and map_Pm are left out: expected the same image for both",
        "textures of map_d are left out: expected the image of map_Kd",
    )
    assert set(report.mesh.materials[0].textures) == {"base_color"}
    assert report.mesh.materials[0].alpha_mode == "opaque"


@pytest.mark.parametrize(
    ("lines", "mode"),
    [
        ("map_Kd leaf.png\nmap_d leaf.png", "mask"),
        ("map_d leaf.png\nmap_Kd leaf.png\nd 1", "mask"),
        ("map_Kd leaf.png\nmap_d leaf.png\nd 0.5", "blend"),
        ("map_Kd leaf.png", "opaque"),
    ],
)
def test_mtl_opacity_in_the_image_of_the_colour_cuts_out(
    tmp_path: Path, lines: str, mode: str
) -> None:
    report = with_mtl(tmp_path, f"newmtl a\n{lines}\n")
    assert (report.mesh.materials[0].alpha_mode, report.warnings) == (mode, ())
    report.mesh.write(tmp_path / "again.obj")
    assert manip3d.read_mesh(tmp_path / "again.obj").materials[0].alpha_mode == mode


def written_look(path: Path, **look: Any) -> Material:
    """The material as read back from a file with it, whose image is made up."""
    look = {"textures": {"base_color": Texture("leaf.png", PNG)}} | look
    square = Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 1, 2]],
        texcoords=[[0, 0], [1, 0], [0, 1]],
        face_texcoords=[[0, 1, 2]],
        face_material=[0],
        materials=[Material("leaf", **look)],
    )
    square.write(path)
    (material,) = manip3d.read_mesh(path).materials
    return material


def test_obj_opacity_of_an_image_comes_back(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """MTL has no word for the way of blending; what is cut out stays so."""
    path = tmp_path / "a.obj"
    assert written_look(path, alpha_mode="blend").alpha_mode == "mask"
    blend = written_look(path, alpha_mode="blend", base_color=(1, 1, 1, 0.5))
    assert (blend.alpha_mode, blend.base_color[3]) == ("blend", 0.5)
    opaque = written_look(path, base_color=(1, 1, 1, 0.5))  # glTF ignores this alpha
    assert (opaque.alpha_mode, opaque.base_color[3]) == ("opaque", 1.0)
    assert written_look(path, alpha_mode="mask").alpha_mode == "mask"
    assert not caplog.text
    written_look(path, alpha_mode="mask", alpha_cutoff=0.3)
    assert "material leaf: OBJ holds no alpha cutoff" in caplog.text


@pytest.mark.parametrize(
    ("what", "look"),
    [
        ("opacity", {"alpha_mode": "blend"}),
        ("metallic", {"metallic": 0.5}),
        ("roughness", {"roughness": 0.5}),
        ("emissive", {"emissive": (0.0, 0.0, 2.0)}),
    ],
)
def test_ply_names_what_it_leaves_out_of_materials(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, what: str, look: dict[str, Any]
) -> None:
    written_look(tmp_path / "a.ply")
    assert not caplog.text
    written_look(tmp_path / "a.ply", **look)
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / 'a.ply'}: PLY: {what} left out"
    ]


# --- Line ends ------------------------------------------------------------------------------

ASCII_TRIANGLES = {
    "obj": "# made by hand\n" + SQUARE + "f 1 2 3\n",
    "off": "OFF\n# made by hand\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n",
    "ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n",
    "stl": "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\n"
    "endloop\nendfacet\nendsolid a\n",
}


@pytest.mark.parametrize("kind", ASCII_TRIANGLES)
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [True, False])
def test_any_line_ends(kind: str, newline: str, last: bool) -> None:
    text = ASCII_TRIANGLES[kind] if last else ASCII_TRIANGLES[kind].rstrip("\n")
    data = text.replace("\n", newline).encode()
    for given in (kind, None):  # None: known by its content
        mesh = read_mesh_bytes(data, given)
        corners = mesh.vertices[mesh.faces]
        assert corners.tolist() == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]


def test_lines_that_end_in_cr_are_counted() -> None:
    assert error("# made by hand\rv 0 0 0\rv 1 x 0\r", "obj").line == 3


def test_cr_ends_lines_however_long_the_first_one_is() -> None:
    """Longer than what is looked at to tell formats apart, and than a block of the reader."""
    for length in (300, 300_000):
        text = "#" + length * "x" + "\r" + SQUARE.replace("\n", "\r") + "f 1 2 3\r"
        assert read_mesh_bytes(text.encode(), "obj").num_faces == 1


def test_a_block_may_end_between_cr_and_lf() -> None:
    """A CR at the end of a block is half of CRLF if the next block begins with LF."""
    for length in range((1 << 18) - 4, (1 << 18) + 1):
        text = "#" + length * "x" + "\r\n" + SQUARE.replace("\n", "\r\n") + "f 1 2 3\r\n"
        assert read_mesh_bytes(text.encode(), "obj").num_faces == 1
        assert error(text + "v 0 x 0\r\n", "obj").line == 7


def test_a_stray_cr_ends_no_line_where_lf_does() -> None:
    mesh = obj("# first\rv 9 9 9\n" + SQUARE + "f 1\r2 3\n")
    assert (mesh.num_vertices, mesh.faces.tolist()) == (4, [[0, 1, 2]])


def test_mtl_lines_may_end_in_cr(tmp_path: Path) -> None:
    (material,) = with_mtl(tmp_path, "# made by hand\rnewmtl a\rPr 0.5\r").mesh.materials
    assert material.roughness == 0.5


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_binary_ply_whose_data_hold_lf(newline: str) -> None:
    header = f"element vertex 4\n{XYZ.replace('float', 'uchar')}"
    header += "element face 1\nproperty list uchar uchar vertex_index\n"
    points = [(10, 13, 10), (13, 0, 0), (0, 1, 0), (0, 0, 1)]
    rows: list[list[tuple[str, float | list[float]]]] = [[("uchar", c) for c in p] for p in points]
    data = ply("binary_little_endian", header, [*rows, [("uchar uchar", [0, 1, 2])]])
    end = data.index(b"end_header\n") + len(b"end_header\n")
    data = data[:end].replace(b"\n", newline.encode()) + data[end:]
    mesh = read_mesh_bytes(data, "ply")
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in points]
    assert mesh.faces.tolist() == [[0, 1, 2]]


# --- PLY ------------------------------------------------------------------------------------

PLY_TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I",
    "float": "f", "double": "d", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip
PLY_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def ply(encoding: str, header: str, elements: list[list[tuple[str, float | list[float]]]]) -> bytes:
    """Bytes of a PLY file; a value is (type, number) or ("count type", numbers)."""
    body = b""
    order = PLY_FORMATS[encoding]
    for element in elements:
        words = []
        for types, value in element:
            values = value if isinstance(value, list) else [value]
            if isinstance(value, list):
                values = [len(value), *value]
            names = types.split()
            codes = [names[0], *[names[-1]] * (len(values) - 1)]
            words += [repr(v) for v in values]
            if order:
                for name, v in zip(codes, values, strict=True):
                    body += struct.pack(order + PLY_TYPES[name], v)
        if not order:
            body += " ".join(words).encode() + b"\n"
    return f"ply\nformat {encoding} 1.0\n{header}end_header\n".encode() + body


XYZ = "property float x\nproperty float y\nproperty float z\n"
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def vertex_elements(kind: str = "float") -> list[list[tuple[str, float | list[float]]]]:
    return [[(kind, c) for c in p] for p in POINTS]


@pytest.mark.parametrize("encoding", PLY_FORMATS)
@pytest.mark.parametrize("kind", PLY_TYPES)
def test_ply_any_property_type(encoding: str, kind: str) -> None:
    header = f"element vertex 4\n{XYZ.replace('float', kind)}"
    header += f"element face 1\nproperty list {'uchar' if 'f' in kind or 'd' in kind else kind} "
    header += f"{kind} vertex_index\n"
    count = "uchar" if "f" in kind or "d" in kind else kind
    face: list[tuple[str, float | list[float]]] = [(f"{count} {kind}", [0, 1, 2, 3])]
    mesh = read_mesh_bytes(ply(encoding, header, [*vertex_elements(kind), face]), "ply")
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in POINTS]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_ply_skips_what_it_does_not_know_exactly(encoding: str) -> None:
    header = (
        "comment c\nobj_info num_cols 3\nbye\nbye\nelement junk 2\nproperty list int double a\n"
        "property short b\nelement vertex 4\nproperty uchar flag\nproperty list uchar short l\n"
        + XYZ
        + "property double quality\nelement empty 7\nelement face 1\nproperty int n\n"
        "property list uchar uint vertex_indices\nproperty list ushort char tail\n"
        "element after 1\nproperty char c\n"
    )
    vertices: list[list[tuple[str, float | list[float]]]] = [
        [("uchar", 7), ("uchar short", [1] * i), *v, ("double", 0.5)]
        for i, v in enumerate(vertex_elements())
    ]
    junk: list[list[tuple[str, float | list[float]]]] = [
        [("int double", [1.5, 2.5]), ("short", 1)],
        [("int double", []), ("short", 1)],
    ]
    face: list[tuple[str, float | list[float]]]
    face = [("int", -9), ("uchar uint", [0, 1, 2]), ("ushort char", [1, 2, 3])]
    data = ply(encoding, header, [*junk, *vertices, face, [("char", 1)]])
    mesh = read_mesh_bytes(data, "ply")
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in POINTS]
    assert mesh.faces.tolist() == [[0, 1, 2]]


def test_ply_skipped_values_may_be_nan() -> None:
    data = ply("ascii", "element vertex 1\n" + XYZ + "property float quality\n", [])
    assert read_mesh_bytes(data + b"0 0 0 nan\n", "ply").num_vertices == 1


@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_ply_normals_colors_and_vertex_texcoords(encoding: str) -> None:
    header = (
        "element vertex 4\n" + XYZ + "property float nx\nproperty float ny\nproperty float nz\n"
    )
    header += (
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n"
    )
    header += "property float {}\nproperty float {}\nelement face 1\n"
    header += "property list uchar int vertex_indices\n"
    rows: list[list[tuple[str, float | list[float]]]] = [
        [
            *v,
            *(("float", n) for n in (0.0, 0.0, 1.0)),
            *(("uchar", c) for c in (10 * i, 2, 255, 9)),
            *(("float", t) for t in (0.5, 0.25 * i)),
        ]
        for i, v in enumerate(vertex_elements())
    ]
    rows.append([("uchar int", [3, 2, 1])])
    for names in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
        mesh = read_mesh_bytes(ply(encoding, header.format(*names), rows), "ply")
        assert mesh.colors is not None
        assert mesh.colors.tolist() == [[10 * i, 2, 255] for i in range(4)]
        assert mesh.normals is not None
        assert mesh.normals.tolist() == [[0.0, 0.0, 1.0]] * 4
        assert mesh.face_normals is not None
        assert mesh.face_texcoords is not None
        assert mesh.face_normals.tolist() == mesh.face_texcoords.tolist() == [[3, 2, 1]]
        assert mesh.texcoords is not None
        assert mesh.texcoords.tolist() == [[0.5, 0.25 * i] for i in range(4)]


@pytest.mark.parametrize("encoding", PLY_FORMATS)
@pytest.mark.parametrize(("largest", "alpha"), [(255, 255), (255, 128), (65535, 65535), (256, 255)])
def test_ply_colors_of_16_bits(encoding: str, largest: int, alpha: int, tmp_path: Path) -> None:
    """Values of 8 bits that are stored as numbers of 16 bits became black."""
    names = ("red", "green", "blue", "alpha")
    header = "element vertex 4\n" + XYZ + "".join(f"property ushort {name}\n" for name in names)
    header += "element face 1\nproperty list uchar int vertex_indices\n"
    rows: list[list[tuple[str, float | list[float]]]] = [
        [*v, *(("ushort", c) for c in (i * largest // 3, 0, largest, alpha))]
        for i, v in enumerate(vertex_elements())
    ]
    path = tmp_path / "a.ply"
    path.write_bytes(ply(encoding, header, [*rows, [("uchar int", [0, 1, 2])]]))
    report = io.read_report(path)
    assert report.mesh.colors is not None
    full = 255 if largest <= 255 else 65535
    expected = [
        [round(255 * (i * largest // 3) / full), 0, round(255 * largest / full)] for i in range(4)
    ]
    assert report.mesh.colors.tolist() == expected
    assert any("8-bit colors" in text for text in report.warnings) == (largest <= 255)
    assert any("alpha" in text for text in report.warnings) == (alpha < full)


@pytest.mark.parametrize("has_index", [False, True])
@pytest.mark.parametrize(("largest", "alpha"), [(255, 255), (255, 128), (65535, 65535), (256, 255)])
def test_ply_colors_of_faces_of_16_bits(
    has_index: bool, largest: int, alpha: int, tmp_path: Path
) -> None:
    names = ("red", "green", "blue", "alpha")
    header = f"element vertex 4\n{XYZ}element face 2\nproperty list uchar int vertex_indices\n"
    header += "".join(f"property ushort {name}\n" for name in names)
    header += "property int material_index\n" if has_index else ""
    faces: list[list[tuple[str, float | list[float]]]] = []
    for face, color in ([0, 1, 2], [largest, 0, 0]), ([0, 2, 3, 1], [0, largest, largest // 5]):
        values: list[tuple[str, float | list[float]]] = [("ushort", c) for c in [*color, alpha]]
        faces.append([("uchar int", face), *values, *([("int", len(faces))] if has_index else [])])
    path = tmp_path / "a.ply"
    path.write_bytes(ply("binary_little_endian", header, [*vertex_elements(), *faces]))
    report = io.read_report(path)
    assert report.mesh.face_material is not None
    assert report.mesh.face_material.tolist() == [0, 1, 1]
    full = 255 if largest <= 255 else 65535
    shown = [round(255 * c / full) for c in (largest, largest // 5)]
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.divide(shown, 255)
    ]
    expected = [(linear[0], 0, 0), (0, linear[0], linear[1])]
    for material, color in zip(report.mesh.materials, expected, strict=True):
        np.testing.assert_allclose(material.base_color[:3], color, atol=1 / 65535)
    assert any("8-bit colors" in text for text in report.warnings) == (largest <= 255)
    assert any("alpha" in text for text in report.warnings) == (alpha < full)


@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_ply_corner_texcoords_and_textures_as_meshlab_writes_them(encoding: str) -> None:
    header = "comment TextureFile a.png\ncomment TextureFile b c.png\nelement vertex 4\n" + XYZ
    header += "element face 3\nproperty list uchar int vertex_indices\n"
    header += "property list uchar float texcoord\nproperty int texnumber\n"
    faces: list[list[tuple[str, float | list[float]]]] = [
        [("uchar int", [0, 1, 2]), ("uchar float", [0.0, 0.0, 1.0, 0.0, 1.0, 1.0]), ("int", 1)],
        [("uchar int", [0, 2, 3]), ("uchar float", [0.0, 0.0, 1.0, 1.0, 0.0, 1.0]), ("int", 0)],
        [("uchar int", [0, 1, 3]), ("uchar float", []), ("int", -1)],
    ]
    mesh = read_mesh_bytes(ply(encoding, header, [*vertex_elements(), *faces]), "ply")
    assert mesh.texcoords is not None
    assert mesh.texcoords.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert mesh.face_texcoords is not None
    assert mesh.face_texcoords.tolist() == [[0, 1, 2], [0, 2, 3], [-1, -1, -1]]
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [1, 0, -1]
    paths = [m.textures["base_color"].path for m in mesh.materials]
    assert paths == ["a.png", "b c.png"]


ARTEC = (
    "element face 2\nproperty list uchar int vertex_indices\n"
    "element multi_texture_vertex 6\nproperty uchar tx\nproperty float u\nproperty float v\n"
    "element multi_texture_face 2\nproperty uchar tx\nproperty uint tn\n"
    "property list uchar int texture_vertex_indices\nend_header\n"
)
ARTEC_FACES = "3 0 1 2\n3 0 2 3\n"
ARTEC_TEXCOORDS = "0 0 0\n0 1 0\n0 1 1\n1 0 0\n1 1 1\n1 0 0.5\n"
ARTEC_TEXTURES = "0 0 3 0 1 2\n1 0 3 3 4 5\n"
ARTEC_VERTICES = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def artec(
    tmp_path: Path, header: str, body: str, comments: str = "comment TextureFile a.png\n"
) -> io.ReadReport:
    text = "ply\nformat ascii 1.0\n" + comments + "element vertex 4\n" + XYZ + header + body
    (tmp_path / "artec.ply").write_text(text)
    return io.read_report(tmp_path / "artec.ply")


def test_ply_textures_of_faces_in_elements_of_their_own(tmp_path: Path) -> None:
    """Artec's files: the faces of multi_texture_face are those of the element face."""
    body = ARTEC_VERTICES + ARTEC_FACES + ARTEC_TEXCOORDS + ARTEC_TEXTURES
    two = "comment TextureFile a.png\ncomment TextureFile b.png\n"
    seen = artec(tmp_path, ARTEC, body, two)
    mesh = seen.mesh
    assert mesh.texcoords is not None
    assert mesh.texcoords.tolist() == [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 0.5]]
    assert mesh.face_texcoords is not None
    assert mesh.face_texcoords.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [0, 1]
    assert [m.textures["base_color"].path for m in mesh.materials] == ["a.png", "b.png"]
    assert seen.warnings == ("properties of element multi_texture_face are left out: tn",)
    one = artec(tmp_path, ARTEC, body.replace("\n1 0 3", "\n0 0 3"), "").mesh
    assert one.face_texcoords is not None
    assert (one.face_texcoords.tolist(), one.materials) == ([[0, 1, 2], [3, 4, 5]], ())
    for none in ("1 0 3 -1 -1 -1\n", "300000 0 3 3 4 5\n"):  # no corners; no such texture
        header = ARTEC.replace("face 2\nproperty uchar tx", "face 2\nproperty int tx")
        part = artec(tmp_path, header, body[: body.rindex("1 0 3 3 4 5")] + none, two).mesh
        assert part.face_texcoords is not None
        expected = [-1, -1, -1] if "-1" in none else [3, 4, 5]
        assert part.face_texcoords.tolist() == [[0, 1, 2], expected]
        assert part.face_material is not None
        assert part.face_material.tolist() == [0, -1]


@pytest.mark.parametrize(
    ("header", "body", "reason"),
    [
        (
            ARTEC,
            ARTEC_VERTICES + ARTEC_FACES + ARTEC_TEXCOORDS + ARTEC_TEXTURES.replace("3 0 1 2", "0"),
            "expected a triangle for each face, and only triangles",
        ),
        (
            ARTEC.replace("face 2", "face 1", 1),
            ARTEC_VERTICES + "4 0 1 2 3\n" + ARTEC_TEXCOORDS + ARTEC_TEXTURES,
            "expected a triangle for each face, and only triangles",
        ),
        (
            ARTEC,
            ARTEC_VERTICES + ARTEC_FACES + ARTEC_TEXCOORDS + ARTEC_TEXTURES.replace("5", "6"),
            "it refers to texture coordinates that are not there",
        ),
        (
            "property float s\nproperty float t\n" + ARTEC,
            ARTEC_VERTICES.replace("0\n", "0 0 0\n")
            + ARTEC_FACES
            + ARTEC_TEXCOORDS
            + ARTEC_TEXTURES,
            "there are other texture coordinates",
        ),
    ],
)
def test_ply_textures_of_faces_that_do_not_fit_are_named(
    tmp_path: Path, header: str, body: str, reason: str
) -> None:
    seen = artec(tmp_path, header, body)
    assert f"multi_texture_face is left out: {reason}" in seen.warnings
    assert seen.mesh.num_faces == 2
    has_own = header.startswith("property float s")
    assert (seen.mesh.texcoords is not None) == has_own


def test_ply_textures_that_no_face_names_are_named(tmp_path: Path) -> None:
    """All faces have the first of several textures, as in MeshLab."""
    header = (
        "element face 2\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\n{}end_header\n"
    )
    two = "comment TextureFile a.png\ncomment TextureFile b.png\n"
    body = ARTEC_VERTICES + "3 0 1 2 6 0 0 1 0 1 1{}\n3 0 2 3 6 0 0 1 1 0 1{}\n"
    seen = artec(tmp_path, header.format(""), body.format("", ""), two)
    assert seen.warnings == (
        "the file names 2 textures, but not those of its faces: all faces have the first",
    )
    assert seen.mesh.face_material is not None
    assert seen.mesh.face_material.tolist() == [0, 0]
    header = header.format("property int texnumber\n")
    seen = artec(tmp_path, header, body.format(" 0", " 2"), two)
    assert seen.warnings == (
        "faces refer to texture 2, the file names 2: faces of missing ones have none",
    )
    assert [bool(m.textures) for m in seen.mesh.materials] == [True, True, False]
    assert artec(tmp_path, header, body.format(" 0", " 1"), two).warnings == ()


def test_ply_material_index_and_names() -> None:
    header = "comment material 0 steel\ncomment material 2 glass pane\nelement vertex 4\n" + XYZ
    header += (
        "element face 2\nproperty list uchar int vertex_indices\nproperty int material_index\n"
    )
    data = ply("ascii", header, vertex_elements()) + b"3 0 1 2 2\n3 0 2 3 -1\n"
    mesh = read_mesh_bytes(data, "ply")
    assert [m.name for m in mesh.materials] == ["steel", "material_1", "glass pane"]
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [2, -1]


def test_ply_material_names_of_older_files_and_escapes_that_are_none() -> None:
    header = "comment material 0 Stra\u00dfe 50%\ncomment material_utf8 1 50%2 %zz %C3%9F%\n"
    header += "comment material_utf8 x y\nelement vertex 4\n" + XYZ
    header += (
        "element face 2\nproperty list uchar int vertex_indices\nproperty int material_index\n"
    )
    data = ply("ascii", header, vertex_elements()) + b"3 0 1 2 0\n3 0 2 3 1\n"
    mesh = read_mesh_bytes(data, "ply")
    assert [m.name for m in mesh.materials] == ["Stra\u00dfe 50%", "50%2 %zz \u00df%"]


def test_ply_triangle_strips() -> None:
    header = "element vertex 4\n" + XYZ + "element tristrips 1\n"
    header += "property list int int vertex_indices\n"
    data = ply("ascii", header, vertex_elements()) + b"8 0 1 3 2 -1 1 2 3\n"
    assert read_mesh_bytes(data, "ply").faces.tolist() == [[0, 1, 3], [3, 1, 2], [1, 2, 3]]


GRID = """ply
format ascii 1.0
obj_info num_cols 3
obj_info num_rows 2
bye
element vertex 5
property float x
property float y
property float z
element range_grid 6
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
2 0 0
0 1 0
1 1 0
1 0
1 1
1 2
1 3
1 4
0
"""


def test_range_grid(tmp_path: Path) -> None:
    #  3---4   .      one full cell: two triangles,
    #  0---1---2      one cell with three pixels: one
    path = tmp_path / "scan.ply"
    path.write_text(GRID)
    report = io.read_report(path)
    assert report.mesh.faces.tolist() == [[0, 1, 4], [0, 4, 3], [1, 2, 4]]
    assert report.num_polygons == 2
    grid = io.read_range_grid(path)
    assert grid.valid.tolist() == [[True] * 3, [True, True, False]]
    assert grid.points[1, :2].tolist() == [[0, 1, 0], [1, 1, 0]]
    assert np.isnan(grid.points[1, 2]).all()
    path.write_text(GRID.replace("1 4\n", "1 5\n"))
    with pytest.raises(manip3d.FormatError, match="pixel 4 is out of range"):
        io.read_range_grid(path)
    with pytest.raises(manip3d.FormatError, match="pixel 4 is out of range"):
        manip3d.read_mesh(path)
    path.write_text(GRID.replace("num_cols 3", "num_cols 4"))
    with pytest.raises(manip3d.FormatError, match="num_cols x num_rows"):
        manip3d.read_mesh(path)
    path.write_text(GRID.replace("range_grid 6", "pixels 6"))
    with pytest.raises(manip3d.FormatError, match="no range_grid"):
        io.read_range_grid(path)


PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex 3\n" + XYZ
PLY_FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
PLY_BODY = "0 0 0\n1 0 0\n0 1 0\n"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("plx\n", 1, "expected 'ply'"),
        ("ply\nformat ascii 2.0\n", 2, "format: expected version 1.0"),
        ("ply\nformat text 1.0\n", 2, "format: expected ascii, binary_little"),
        ("ply\nend_header\n", 2, "expected a format line"),
        ("ply\nformat ascii 1.0\nelement vertex 3\n", 3, "file ends within the header"),
        ("ply\nproperty float x\n", 2, "property before the first element"),
        ("ply\nelement vertex 3\nproperty quad x\n", 3, "property: unknown type 'quad'"),
        ("ply\nelement vertex -3\n", 2, "element: expected a count >= 0"),
        ("ply\nelement vertex 3x\n", 2, "element: expected an integer, got '3x'"),
        (PLY_HEAD + "end_header\n0 0 0\n1 0\n", 8, "3 vertex claimed"),
        (PLY_HEAD + PLY_FACE + PLY_BODY[:-6] + "0 1\n3 0 1 2\n", 12, "z: expected a finite number"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "3 0 1\n", 13, "vertex_indices: expected a finite"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "3 0 1 3\n", 13, "vertex index: expected 0 to 2, got 3"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "3 0 1 -1\n", 13, "vertex_indices: expected an index"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "3 0 1 1.5\n", 13, "vertex_indices: expected an index"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "-3 0 1\n", 13, "vertex_indices: expected a count >= 0"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "3 0 1 2 5\n", 13, "element face: more values"),
        (PLY_HEAD + PLY_FACE + PLY_BODY + "\n\n\n\n", 17, "file ends within element face"),
        (
            PLY_HEAD + PLY_FACE + "0 0 nan\n" + PLY_BODY[:12] + "3 0 1 2\n",
            10,
            "z: expected a finite number",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n",
            3,
            "element vertex: expected properties x, y and z",
        ),
        (
            "ply\nformat ascii 1.0\nelement face 1\nproperty int a\nend_header\n0\n",
            3,
            "element face: expected a list vertex_indices",
        ),
    ],
)
def test_ply_errors_name_the_line(text: str, line: int, message: str) -> None:
    caught = error(text, "ply")
    assert caught.reason.startswith(message)
    if "claimed" not in message:
        assert caught.line == line


def test_binary_ply_errors_name_the_byte() -> None:
    header = "element vertex 4\n" + XYZ + "element face 1\nproperty list uchar int vertex_indices\n"
    face: list[tuple[str, float | list[float]]] = [("uchar int", [0, 1, 4])]
    data = ply("binary_little_endian", header, [*vertex_elements(), face])
    body = data.index(b"end_header\n") + 11
    caught = error(data, "ply")
    assert (caught.byte_offset, caught.line) == (body + 48, None)
    assert caught.reason == "vertex index: expected 0 to 3, got 4"
    caught = error(data[:-2], "ply")
    assert (caught.byte_offset, caught.reason) == (len(data) - 2, "file ends within face")
    data = ply("binary_little_endian", header, [*vertex_elements(), [("uchar int", [0, 1, 3])]])
    caught = error(data[: body + 4] + struct.pack("<f", np.inf) + data[body + 8 :], "ply")
    assert (caught.byte_offset, caught.reason) == (body, "y: expected a finite number")
    square = ply(
        "binary_little_endian", header, [*vertex_elements(), [("uchar int", [0, 1, 2, 3])]]
    )
    caught = error(square[: body + 24] + struct.pack("<f", np.nan) + square[body + 28 :], "ply")
    assert (caught.byte_offset, caught.reason) == (body + 24, "x: expected a finite number")


@pytest.mark.parametrize("absent", [(np.nan, 0.0, np.nan), (np.inf, 0.0, -np.inf)])
@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_ply_vertices_that_no_face_uses_may_have_no_position(
    encoding: str, absent: tuple[float, float, float], tmp_path: Path
) -> None:
    """Programs that mesh a depth image write one vertex per pixel, measured or not."""
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    names += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    header = f"element vertex 7\n{names}element face 2\nproperty list uchar int vertex_indices\n"
    rows: list[list[tuple[str, float | list[float]]]] = []
    for i, point in enumerate([None, *POINTS[:2], None, *POINTS[2:], None]):
        values = [("float", v) for v in (point or absent)]
        rows.append([*values, *[("float", v) for v in (0, 0, i)], *[("uchar", i)] * 3])
    faces: list[list[tuple[str, float | list[float]]]] = [
        [("uchar int", [1, 2, 4, 5])], [("uchar int", [1, 2, 4])],
    ]  # fmt: skip
    (tmp_path / "m.ply").write_bytes(ply(encoding, header, [*rows, *faces]))
    report = io.read_report(tmp_path / "m.ply")
    assert report.warnings == (
        "3 vertices without a finite position, which no face uses, are left out",
    )
    mesh = report.mesh
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in POINTS]
    assert sorted(map(sorted, mesh.faces[:2].tolist())) in (
        [[0, 1, 2], [0, 2, 3]],
        [[0, 1, 3], [1, 2, 3]],
    )
    assert mesh.faces[2].tolist() == [0, 1, 2]
    assert mesh.colors is not None
    assert mesh.colors[:, 0].tolist() == [1, 2, 4, 5]
    assert mesh.normals is not None
    assert mesh.face_normals is not None
    assert mesh.normals[mesh.face_normals[2], 2].tolist() == [1.0, 2.0, 4.0]


@pytest.mark.parametrize("word", ["inf", "-inf", "+Inf", "INFINITY", "-Infinity", "-nan"])
def test_ascii_ply_names_values_that_are_not_finite_as_programs_do(word: str) -> None:
    four = PLY_HEAD.replace("vertex 3", "vertex 4")
    text = f"{four}{PLY_FACE}{PLY_BODY}0 {word} 0\n"
    assert read_mesh_bytes((text + "3 0 1 2\n").encode(), "ply").num_vertices == 3
    assert error(text + "3 0 1 3\n", "ply").reason == "y: expected a finite number"
    assert error(text.replace(word, word + "x") + "3 0 1 2\n", "ply").reason.startswith("y: ")


def test_ply_may_be_named_in_capitals(tmp_path: Path) -> None:
    text = PLY_HEAD.replace("ply", "PLY") + PLY_FACE + PLY_BODY + "3 0 1 2\n"
    for name in ("m.ply", "m"):  # by its suffix, and by its content
        (tmp_path / name).write_text(text)
        assert io.read_mesh(tmp_path / name).num_faces == 1
    assert read_mesh_bytes(text.replace("\n", "\r").encode(), "ply").num_faces == 1


# --- OFF ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n4 1 0\n{}4 0 1 2 3\n",
        "OFF 4 1 0\n{}4 0 1 2 3\n",
        "4 1 0\n{}4 0 1 2 3",
        "OFF # c\n\n# c\n4 1\n{}\n4 0 1 2 3 0.1 0.2 0.3\n",
        "OFF\r\n4 1 0\r\n{}4 0 1 2 3 255 0 0 255\r\n",
    ],
)
def test_off_syntax(text: str) -> None:
    points = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS)
    mesh = read_mesh_bytes(text.format(points).encode(), "off")
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in POINTS]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("keyword", "tail"),
    [
        ("COFF", "255 0 10"),
        ("COFF", "255 0 10 128"),
        ("COFF", "1.0 0.0 0.0392 1.0"),
        ("OFF", "255 0 10"),
        ("NOFF", "0 0 1"),
        ("STOFF", "0.5 0.25"),
        ("CNOFF", "0 0 1 255 0 10 128"),
        ("STCNOFF", "0 0 1 255 0 10 128 0.5 0.25"),
        ("STCNOFF", "0 0 1 255 0 10 0.5 0.25"),
        ("NCOFF", "255 0 10 128 0 0 1"),  # MeshLab's order
        ("NCOFF", "255 0 10 0 0 1"),
        ("CSTOFF", "255 0 10 128 0.5 0.25"),
        ("NSTOFF", "0 0 1 0.5 0.25"),
        ("NCSTOFF", "255 0 10 128 0 0 1 0.5 0.25"),
        ("NCSTOFF", "255 0 10 0 0 1 0.5 0.25"),
    ],
)
def test_off_variants(keyword: str, tail: str) -> None:
    points = "".join(f"{x} {y} {z} {tail}\n" for x, y, z in POINTS[:3])
    mesh = read_mesh_bytes(f"{keyword}\n3 1 0\n{points}3 0 1 2\n".encode(), "off")
    if "C" in keyword or keyword == "OFF":
        assert mesh.colors is not None
        assert mesh.colors.tolist() == [[255, 0, 10]] * 3
    if "N" in keyword:
        assert mesh.normals is not None
        assert mesh.normals.tolist() == [[0, 0, 1]] * 3
    if "ST" in keyword:
        assert mesh.texcoords is not None
        assert mesh.texcoords.tolist() == [[0.5, 0.25]] * 3
        assert mesh.face_texcoords is not None
        assert mesh.face_texcoords.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        (["1 0 0 1", "0.5 0.2 0 1", "1 1 1 1"], [[255, 0, 0], [128, 51, 0], [255, 255, 255]]),
        (["1 0 0", "0 1 0", "0 0 1"], [[255, 0, 0], [0, 255, 0], [0, 0, 255]]),
        (["1 0 0 255", "0 0 0 255", "2 255 3 255"], [[1, 0, 0], [0, 0, 0], [2, 255, 3]]),
    ],
)
def test_off_decides_between_bytes_and_shares_for_all_vertices(
    written: list[str], expected: list[list[int]]
) -> None:
    points = "".join(f"{x} {y} {z} {c}\n" for (x, y, z), c in zip(POINTS[:3], written, strict=True))
    mesh = read_mesh_bytes(f"COFF\n3 1 0\n{points}3 0 1 2\n".encode(), "off")
    assert mesh.colors is not None
    assert mesh.colors.tolist() == expected


OFF_BODY = "0 0 0\n1 0 0\n0 1 0\n"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("FOO\n", 1, "expected OFF"),
        ("4OFF\n", 1, "expected [ST][C][N]OFF or"),
        ("CSTCOFF\n", 1, "expected [ST][C][N]OFF or [N][C]"),
        ("nOFF 4\n", 1, "dimension: expected 3"),
        ("nOFF\n2\n", 2, "dimension: expected 3"),
        ("OFF BINARY\n", 1, "binary OFF"),
        ("OFF\n", 2, "file ends within the header"),
        ("OFF\n3\n", 2, "number of faces: expected an integer"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1\n3 0 1 2\n", 5, "vertex: expected a finite number"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 inf 0\n3 0 1 2\n", 5, "vertex: expected a finite number"),
        ("OFF\n3 1 0\n" + OFF_BODY + "3 0 1 3\n", 6, "vertex index: expected 0 to 2, got 3"),
        ("OFF\n3 1 0\n" + OFF_BODY + "3 0 1 -1\n", 6, "vertex index: expected 0 to 2, got -1"),
        ("OFF\n3 1 0\n" + OFF_BODY + "-2 0 1\n", 6, "number of corners: expected at least 0"),
        ("OFF\n3 1 0\n" + OFF_BODY + "9 0 1 2\n", 6, "vertex index: expected an integer, got the"),
        ("OFF\n3 1 0\n" + OFF_BODY + "\n\n\n\n", 10, "file ends within the faces"),
    ],
)
def test_off_errors_name_the_line(text: str, line: int, message: str) -> None:
    caught = error(text, "off")
    assert caught.reason.startswith(message)
    assert caught.line == line


# --- STL ------------------------------------------------------------------------------------

FACET = "facet normal 0 0 1\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet\n"


def binary_stl(triangles: list[list[float]], header: bytes = b"binary") -> bytes:
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *t, 0) for t in triangles)
    return header.ljust(80, b"\0") + struct.pack("<I", len(triangles)) + body


TRIANGLES = [[0, 0, 0, 1, 0, 0, 1, 1, 0], [0, 0, 0, 1, 1, 0, -0.0, 1, 0]]


@pytest.mark.parametrize("header", [b"binary", b"solid cube"])
def test_binary_stl_is_told_by_its_size_and_welded(header: bytes) -> None:
    mesh = read_mesh_bytes(binary_stl([list(map(float, t)) for t in TRIANGLES], header), "stl")
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in POINTS]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_ascii_stl(newline: str) -> None:
    text = "solid a\n" + FACET.format("0 0 0", "1 0 0", "1 1 0")
    text += FACET.format("0 0 0", "1 1 0", "0 1e0 0") + "endsolid a\n"
    mesh = read_mesh_bytes(text.replace("\n", newline).encode(), "stl")
    assert mesh.vertices.tolist() == [list(map(float, p)) for p in POINTS]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_binary_stl_without_a_count_is_read_by_its_size(tmp_path: Path) -> None:
    data = binary_stl([list(map(float, t)) for t in TRIANGLES])
    open_ended = data[:80] + bytes(4) + data[84:]
    (tmp_path / "a.stl").write_bytes(open_ended)
    report = io.read_report(tmp_path / "a.stl")
    assert report.mesh.faces.tolist() == read_mesh_bytes(data, "stl").faces.tolist()
    assert report.warnings == ("0 triangles claimed, all that follow are read",)
    assert read_mesh_bytes(open_ended[:84], "stl").num_faces == 0
    assert read_mesh_bytes(open_ended + b"x", "stl").num_faces == 0


def test_ascii_stl_without_endloop_is_read() -> None:
    text = "solid a\n" + FACET.format("0 0 0", "1 0 0", "1 1 0").replace("endloop\n", "")
    mesh = read_mesh_bytes((text + "endsolid a\n").encode(), "stl")
    assert mesh.faces.tolist() == [[0, 1, 2]]
    caught = error(text.replace("vertex 1 1 0\n", "") + text + "endsolid a\n", "stl")
    assert (caught.line, caught.reason) == (6, "facet: expected 3 vertices, got 2")


def test_ascii_stl_with_a_byte_order_mark() -> None:
    text = "solid a\n" + FACET.format("0 0 0", "1 0 0", "1 1 0") + "endsolid a\n"
    mesh = read_mesh_bytes(b"\xef\xbb\xbf" + text.encode(), "stl")
    assert mesh.faces.tolist() == [[0, 1, 2]]


def test_text_that_is_no_stl_is_named() -> None:
    text = "; made by hand\nsolid a\n" + FACET.format("0 0 0", "1 0 0", "1 1 0") + "endsolid a\n"
    caught = error(text, "stl")
    assert (caught.line, caught.reason) == (
        1, "expected a text that begins with solid, or a binary STL file"
    )  # fmt: skip


def test_stl_errors() -> None:
    data = binary_stl([list(map(float, t)) for t in TRIANGLES])
    caught = error(data[:-1], "stl")
    assert caught.byte_offset == 80
    assert caught.reason == "2 triangles claimed, but at most 1 fit into the rest of the file"
    caught = error(binary_stl([[0.0] * 9, [float("nan")] * 9]), "stl")
    assert (caught.byte_offset, caught.reason) == (134, "vertex: expected finite numbers")
    text = "solid\n" + FACET.format("0 0 0", "1 0 0", "1 1 0")
    assert error(text, "stl").reason == "file ends before endsolid"
    caught = error("solid\n" + FACET.format("0 0 0", "1 0 0", "1 1 x") + "endsolid", "stl")
    assert (caught.line, caught.reason) == (6, "vertex: expected a finite number, got 'x'")
    short = text.replace("vertex 1 1 0\n", "") + "endsolid"
    assert error(short, "stl").reason == "facet: expected 3 vertices, got 2"
    assert error(b"", "stl").reason == "file ends within the header"


def test_bytes_that_are_no_obj_are_an_error(tmp_path: Path) -> None:
    """They used to be a mesh without vertices and faces."""
    path = tmp_path / "noise.obj"
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(FormatError, match=r"line 1: expected OBJ statements .* found none"):
        io.read_mesh(path)
    path.write_text("# nothing but a name\no empty\n")
    assert io.read_mesh(path).num_faces == 0


@pytest.mark.parametrize("suffix", ["obj", "off"])
def test_byte_order_marks_are_left_out_or_named(suffix: str, tmp_path: Path) -> None:
    """The mark of UTF-8 used to cost the first vertex, that of UTF-16 was no statement."""
    text = OBJ_TRIANGLE if suffix == "obj" else "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    path = tmp_path / f"marked.{suffix}"
    path.write_bytes(text.encode("utf-8-sig"))
    mesh = io.read_mesh(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2]]
    for encoding in ("utf-16", "utf-16-be"):
        mark = "" if encoding == "utf-16" else "\ufeff"
        path.write_bytes((mark + text).encode(encoding))
        with pytest.raises(FormatError, match="line 1: expected ASCII or UTF-8, got the byte ord"):
            io.read_mesh(path)


OBJ_TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.obj", OBJ_TRIANGLE + "f 1 2\nf 1\n", 5),
        ("a.off", "OFF\n3 3 0\n" + OFF_BODY + "2 0 1\n3 0 1 2\n0\n", 6),
        (
            "a.ply",
            PLY_HEAD + PLY_FACE.replace("face 1", "face 3") + PLY_BODY + "1 0\n3 0 1 2\n2 0 1\n",
            13,
        ),
    ],
)
def test_faces_of_fewer_than_3_corners_are_left_out(
    tmp_path: Path, name: str, text: str, line: int
) -> None:
    """Real models hold some, between 300 000 good faces."""
    (tmp_path / name).write_text(text)
    seen = manip3d.io.read_report(tmp_path / name)
    assert seen.mesh.faces.tolist() == [[0, 1, 2]]
    assert seen.num_skipped == 2
    assert seen.warnings == (
        f"2 faces of fewer than 3 corners are left out, the first at line {line}",
    )


@pytest.mark.parametrize(
    ("face", "what"),
    [
        ("f 1//1 2//1 3//1", ["normals"]),
        ("f 1/1 2/1 3/1", ["texture coordinates"]),
        ("f 1/1/1 2/1/1 3/1/1", ["texture coordinates", "normals"]),
    ],
)
def test_attributes_that_are_not_there_cost_the_attributes(
    tmp_path: Path, face: str, what: list[str]
) -> None:
    """Some exporters name normals or texture coordinates and write none."""
    (tmp_path / "a.obj").write_text(OBJ_TRIANGLE.replace("f 1 2 3", f"{face}\nf 3 2 1"))
    seen = manip3d.io.read_report(tmp_path / "a.obj")
    assert seen.mesh.faces.tolist() == [[0, 1, 2], [2, 1, 0]]
    assert seen.mesh.normals is None
    assert seen.mesh.texcoords is None
    assert seen.warnings == tuple(
        f"{name} are left out: faces name some that the file does not hold" for name in what
    )


def test_stl_in_capitals_is_text(tmp_path: Path) -> None:
    text = (
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        "endloop\nendfacet\nendsolid a\n"
    )
    for written in (text, text.upper(), text.title()):
        (tmp_path / "a.stl").write_text(written)
        assert manip3d.read_mesh(tmp_path / "a.stl").num_faces == 1
        assert io.read_mesh_bytes(written.encode()).num_faces == 1


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("a.wrl", "#VRML V2.0 utf8\nShape {}\n"), ("a.vtk", "# vtk DataFile Version 3.0\nx\n"),
        ("a.usda", "#usda 1.0\n"), ("a.iv", "#Inventor V2.1 ascii\n"),
    ],
)  # fmt: skip
def test_a_format_that_is_not_read_is_not_taken_for_obj(
    tmp_path: Path, name: str, start: str
) -> None:
    (tmp_path / name).write_text(start)
    with pytest.raises(FormatError, match=r"unknown mesh format; manip3d reads \.obj \.ply"):
        manip3d.read_mesh(tmp_path / name)


COMMAS = {
    ".obj": "v -0,5 1,25e1 2\nv 1 0 ,0e-400\nv 0 1 ,5\nvt 0,25 1\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\n",
    ".off": "OFF\n3 1 0\n-0,5 1,25e1 2\n1 0 0\n0 1 ,5\n3 0 1 2\n",
    ".ply": (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "-0,5 1,25e1 2\n1 0 0\n0 1 ,5\n3 0 1 2\n"
    ),
    ".stl": (
        "solid a\nfacet normal 0,0 0,0 1,0\nouter loop\nvertex -0,5 1,25e1 2\nvertex 1 0 0\n"
        "vertex 0 1 ,5\nendloop\nendfacet\nendsolid a\n"
    ),
}


@pytest.mark.parametrize("extension", list(COMMAS))
def test_decimal_commas_are_read(extension: str) -> None:
    """Programs write them where the language of the system has them."""
    mesh = read_mesh_bytes(COMMAS[extension].encode(), extension)
    assert mesh.vertices.tolist() == [[-0.5, 12.5, 2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]
    if extension == ".obj":
        assert mesh.texcoords is not None
        assert mesh.texcoords.tolist() == [[0.25, 1.0]]


@pytest.mark.parametrize(
    ("numbers", "got"),
    [
        ("1, 2, 3", "1,"), ("1,2,3", "1,2,3"), ("1,000.5 0 0", "1,000.5"), ("1,2,3 0 0", "1,2,3"),
        ("1,5x 0 0", "1,5x"), (", 0 0", ","), ("1.5,2 0 0", "1.5,2"), ("1,1e999 0 0", "1,1e999"),
    ],
)  # fmt: skip
def test_other_commas_are_refused(numbers: str, got: str) -> None:
    text = f"v 0 0 0\nv {numbers}\nf 1 2 1\n"
    with pytest.raises(FormatError, match=f"line 2: v: expected a finite number, got '{got}'"):
        read_mesh_bytes(text.encode(), ".obj")


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "NaN"])
@pytest.mark.parametrize(
    ("normal", "texcoord", "warning"),
    [
        ("{}", "0.5", "normals"),
        ("0", "{}", "texture coordinates"),
    ],
)
def test_attributes_that_are_no_numbers_are_left_out_of_their_faces(
    word: str, normal: str, texcoord: str, warning: str, tmp_path: Path
) -> None:
    """Exporters write NaN where a face has no area, or a sensor no neighbours."""
    normal, texcoord = normal.format(word), texcoord.format(word)
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS)
    obj = f"{points}vn 0 0 1\nvn 0 0 {normal}\nvt 0 1\nvt 0 {texcoord}\n"
    rows = "".join(
        f"{x} {y} {z} 0 0 {normal if i == 3 else 1} 0 {texcoord if i == 3 else 1}\n"
        for i, (x, y, z) in enumerate(POINTS)
    )
    names = "".join(
        f"property float {name}\n" for name in ["x", "y", "z", "nx", "ny", "nz", "s", "t"]
    )
    ply = (
        f"ply\nformat ascii 1.0\nelement vertex 4\n{names}element face 2\n"
        f"property list uchar int vertex_indices\nend_header\n{rows}3 0 1 2\n3 0 2 3\n"
    )
    files = {"obj": obj + "f 1/1/1 2/1/1 3/1/1\nf 1/1/1 3/1/1 4/2/2\n", "ply": ply}
    for suffix, text in files.items():
        (tmp_path / f"m.{suffix}").write_text(text)
        report = io.read_report(tmp_path / f"m.{suffix}")
        assert report.warnings == (f"{warning} that are no finite numbers are left out (faces: 1)",)
        mesh = report.mesh
        assert mesh.num_faces == 2
        lost, kept = mesh.face_normals, mesh.face_texcoords
        if warning.startswith("texture"):
            lost, kept = kept, lost
        assert lost is not None
        assert kept is not None
        assert (lost[1] == -1).all()
        assert (lost[0] >= 0).all()
        assert (kept >= 0).all()
        simplify.clean(mesh)
