"""3MF: archives of XML with build items, components, colours, textures; and hostile ones."""

from __future__ import annotations

import contextlib
import io as buffers
import zipfile
from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import FormatError, Mesh, io

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
MATERIAL = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
RELATIONS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/other.model" Id="rel0"
 Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"""
VERTICES = "".join(
    f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
)
CORNERS = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


def tetrahedron(number: int, about: str = "", faces: tuple[str, ...] = ("",) * 4) -> str:
    triangles = "".join(
        f'<triangle v1="{a}" v2="{b}" v3="{c}" {face}/>'
        for (a, b, c), face in zip(CORNERS, faces, strict=True)
    )
    return (
        f'<object id="{number}" {about}><mesh><vertices>{VERTICES}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )


def model(resources: str, items: str, before: str = "") -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{before}<model unit="millimeter" xmlns="{CORE}" '
        f'xmlns:m="{MATERIAL}" xmlns:p="{PRODUCTION}"><resources>{resources}</resources>'
        f"<build>{items}</build></model>"
    )


def archive(
    text: str, part: str = "3D/3dmodel.model", others: dict[str, bytes | str] | None = None
) -> bytes:
    content = buffers.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(part, text)
        for name, data in (others or {}).items():
            file.writestr(name, data)
    return content.getvalue()


def read(text: str, others: dict[str, bytes | str] | None = None) -> Mesh:
    return io.read_mesh_bytes(archive(text, others=others), "3mf")


def error(text: str) -> str:
    with pytest.raises(FormatError) as caught:
        read(text)
    return str(caught.value)


ITEM = '<item objectid="1"/>'


def test_a_part_is_read_also_by_its_content(tmp_path: Path) -> None:
    data = archive(model(tetrahedron(1), ITEM))
    (tmp_path / "a.3mf").write_bytes(data)
    report = io.read_report(tmp_path / "a.3mf")
    assert (report.format, report.num_polygons, report.warnings) == ("3mf", 4, ())
    assert report.mesh.faces.tolist() == [list(c) for c in CORNERS]
    assert report.mesh.vertices[3].tolist() == [0, 0, 1]
    assert io.read_mesh_bytes(data).num_faces == 4
    assert ".3mf" in io.READABLE


def test_the_relations_name_the_part() -> None:
    data = archive(model(tetrahedron(1), ITEM), "3D/other.model", {"_rels/.rels": RELATIONS})
    assert io.read_mesh_bytes(data, "3mf").num_faces == 4


def test_items_and_components_lie_at_their_places() -> None:
    pair = (
        '<object id="2"><components><component objectid="1"/>'
        '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 5 0 0"/></components></object>'
    )
    mesh = read(
        model(
            tetrahedron(1) + pair,
            '<item objectid="2"/><item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 10"/>',
        )
    )
    assert mesh.num_faces == 16
    # The mirrored one is at x from 5 to 4, and its faces look outwards.
    assert mesh.vertices[4:8].tolist() == [[5, 0, 0], [4, 0, 0], [5, 1, 0], [5, 0, 1]]
    assert mesh.vertices[12:16].tolist() == [[10, 0, 10], [8, 0, 10], [10, 2, 10], [10, 0, 12]]
    corners = mesh.vertices[mesh.faces]
    volumes = np.linalg.det(corners - np.array([0, 0, 0])).reshape(4, 4).sum(axis=1) / 6
    assert volumes == pytest.approx([1 / 6, 1 / 6, 8 / 6, 8 / 6])


def test_objects_of_other_parts() -> None:
    text = model(
        '<object id="9"><components><component p:path="/3D/Objects/a.model" objectid="1"/>'
        "</components></object>",
        '<item objectid="9" p:UUID="0"/>',
    )
    part = model(tetrahedron(1), '<item objectid="1"/>')  # whose build does not count
    assert read(text, {"3D/Objects/a.model": part}).num_faces == 4
    assert "expected the part 3D/Objects/a.model" in error(text)


BASES = (
    '<basematerials id="7"><base name="Größe" displaycolor="#FF0000"/>'
    '<base name="clear" displaycolor="#0000FF80"/></basematerials>'
)


def test_base_materials() -> None:
    faces = ("", 'pid="7" p1="1"', "", 'p1="1"')
    mesh = read(model(BASES + tetrahedron(1, 'pid="7" pindex="0"', faces), ITEM))
    assert [m.name for m in mesh.materials] == ["Größe", "clear"]
    assert mesh.materials[0].base_color == (1.0, 0.0, 0.0, 1.0)
    assert mesh.materials[1].base_color == (0.0, 0.0, 1.0, 128 / 255)
    assert mesh.materials[1].alpha_mode == "blend"
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [0, 1, 0, 1]


COLORS = (
    '<m:colorgroup id="3"><m:color color="#FF0000"/><m:color color="#00FF00"/>'
    '<m:color color="#0000FFFF"/></m:colorgroup>'
)


def test_colors_of_faces_become_materials() -> None:
    faces = ('pid="3" p1="0"', 'pid="3" p1="2"', "", 'pid="3" p1="2"')
    mesh = read(model(COLORS + tetrahedron(1, faces=faces), ITEM))
    assert [m.name for m in mesh.materials] == ["color_FF0000", "color_0000FF"]
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [0, 1, -1, 1]
    assert mesh.colors is None


def test_colors_of_corners_become_those_of_vertices() -> None:
    faces = ('pid="3" p1="0" p2="1" p3="2"', "", "", "")
    mesh = read(model(COLORS + tetrahedron(1, faces=faces), ITEM))
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[255, 0, 0], [0, 0, 255], [0, 255, 0], [255, 255, 255]]


def test_textures(tmp_path: Path) -> None:
    group = (
        '<m:texture2d id="5" path="/3D/Textures/Wood.png" contenttype="image/png"/>'
        '<m:texture2dgroup id="6" texid="5"><m:tex2coord u="0" v="0"/><m:tex2coord u="9" v="9"/>'
        '<m:tex2coord u="1" v="0"/><m:tex2coord u="0" v="1"/></m:texture2dgroup>'
    )
    faces = ('pid="6" p1="0" p2="2" p3="3"', "", "", "")
    text = model(group + tetrahedron(1, faces=faces), ITEM)
    mesh = read(text, {"3D/Textures/wood.png": b"\x89PNG"})
    assert mesh.texcoords is not None
    assert mesh.face_texcoords is not None
    assert mesh.texcoords.tolist() == [[0, 0], [1, 0], [0, 1]]
    assert mesh.face_texcoords.tolist() == [[0, 1, 2], *([[-1] * 3] * 3)]
    assert mesh.materials[0].textures["base_color"].data == b"\x89PNG"
    assert mesh.materials[0].textures["base_color"].path == "Wood.png"
    (tmp_path / "a.3mf").write_bytes(archive(text))
    assert io.read_report(tmp_path / "a.3mf").warnings == (
        "texture '3D/Textures/Wood.png' is not in the archive and is left out",
    )


@pytest.mark.parametrize(
    ("given", "wrap", "smooth"),
    [
        ("", ("repeat", "repeat"), True),
        ('tilestyleu="wrap" tilestylev="clamp" filter="auto"', ("repeat", "clamp"), True),
        ('tilestyleu="mirror" filter="nearest"', ("mirror", "repeat"), False),
    ],
)
def test_textures_keep_their_tiles_and_filter(
    given: str, wrap: tuple[str, str], smooth: bool
) -> None:
    group = (
        f'<m:texture2d id="5" path="/wood.png" contenttype="image/png" {given}/>'
        '<m:texture2dgroup id="6" texid="5"><m:tex2coord u="0" v="0"/></m:texture2dgroup>'
    )
    text = model(group + tetrahedron(1, faces=('pid="6" p1="0"', "", "", "")), ITEM)
    texture = read(text, {"wood.png": b"\x89PNG"}).materials[0].textures["base_color"]
    assert (texture.wrap, texture.smooth) == (wrap, smooth)


def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    faces = ('paint_color="8"', 'pid="4" p1="0"', "", "")
    text = model('<m:multiproperties id="4"/>' + tetrahedron(1, faces=faces), ITEM)
    (tmp_path / "a.3mf").write_bytes(archive(text))
    assert io.read_report(tmp_path / "a.3mf").warnings == (
        "multiproperties are left out",
        "what was painted in a slicer is left out",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (model(tetrahedron(1), ""), "expected an item to build"),
        (model(tetrahedron(1), '<item objectid="2"/>'), "expected an object with the id 2"),
        (model('<object id="1"/>', ITEM), "expected triangles"),
        (
            model(tetrahedron(1).replace('v1="0"', 'v1="4"'), ITEM),
            "vertex index: expected 0 to 3, got 4",
        ),
        (model(tetrahedron(1).replace('v1="0"', 'v1="-1"'), ITEM), "v1: expected a whole number"),
        (model(tetrahedron(1).replace('x="1"', 'x="nan"'), ITEM), "x: expected a finite number"),
        (model(tetrahedron(1).replace('x="1"', ""), ITEM), "x: expected a finite number"),
        (
            model(BASES + tetrahedron(1, 'pid="7" pindex="2"'), ITEM),
            "expected a place from 0 to 1, got 2",
        ),
        (
            model(tetrahedron(1), '<item objectid="1" transform="1 0"/>'),
            "transform: expected 12 finite numbers",
        ),
        (
            model('<m:colorgroup id="3"><m:color color="red"/></m:colorgroup>', ITEM),
            "color: expected #RRGGBB",
        ),
        (model(tetrahedron(1), ITEM)[:-9], "3D/3dmodel.model: unclosed token"),
        (
            model(tetrahedron(1), ITEM, '<!DOCTYPE model [<!ENTITY a "b">]>'),
            "expected XML without a document type",
        ),
        (
            model(
                '<object id="1"><components><component objectid="1"/></components></object>', ITEM
            ),
            "objects within objects",
        ),
        (
            model(
                tetrahedron(0)
                + "".join(
                    f'<object id="{i}"><components>'
                    + f'<component objectid="{i - 1}"/>' * 10
                    + "</components></object>"
                    for i in range(1, 20)
                ),
                '<item objectid="19"/>',
            ),
            "set max_bytes to read it",
        ),
        (
            model(tetrahedron(1), f'<item objectid="1" transform="{"1e308 " * 12}"/>'),
            "expected finite numbers after the transforms",
        ),
    ],
)
def test_damaged_and_hostile_models(text: str, message: str) -> None:
    assert message in error(text)


def test_damaged_and_hostile_archives(tmp_path: Path) -> None:
    data = archive(model(tetrahedron(1), ITEM))
    with pytest.raises(FormatError, match="damaged 3MF"):
        io.read_mesh_bytes(data[:100], "3mf")
    with pytest.raises(FormatError, match="expected the part"):
        io.read_mesh_bytes(archive("", "a.txt"), "3mf")
    bomb = archive(model(tetrahedron(1), ITEM), others={"zeros": bytes(65 << 20)})
    with pytest.raises(FormatError, match="set max_bytes"):
        io.read_mesh_bytes(bomb, "3mf")
    (tmp_path / "a.3mf").write_bytes(data)
    with pytest.raises(FormatError, match=r"a\.3mf: expected at most max_bytes = 100 bytes"):
        io.read_mesh(tmp_path / "a.3mf", max_bytes=100)
    with io.ReadLimits(max_points=3), pytest.raises(FormatError, match="max_points"):
        io.read_mesh(tmp_path / "a.3mf")


def test_every_damaged_byte_ends_in_a_mesh_or_a_format_error() -> None:
    data = archive(model(BASES + COLORS + tetrahedron(1, 'pid="7" pindex="0"'), ITEM))
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), 2):
            damaged[place] = rng.integers(256)
        with contextlib.suppress(FormatError):
            io.read_mesh_bytes(bytes(damaged), "3mf")


def test_a_3mf_is_simplified(tmp_path: Path) -> None:
    mesh = read(model(BASES + tetrahedron(1, 'pid="7" pindex="0"'), ITEM))
    light = manip3d.simplify.quality(mesh, target_faces=4).mesh
    light.write(tmp_path / "a.glb")
    assert io.read_mesh(tmp_path / "a.glb").materials[0].name == "Größe"


@pytest.mark.parametrize(
    ("name", "advice"),
    [("a.fbx", "Blender"), ("a.X3D", "Blender"), ("a.STEP", "a CAD program"), ("a.bin", "")],
)
def test_other_formats_are_refused_with_advice(name: str, advice: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"\x00something else")
    with pytest.raises(FormatError) as caught:
        io.read_mesh(tmp_path / name)
    assert "manip3d reads .obj .ply .off .stl .gltf .glb .3mf" in str(caught.value)
    assert (f"open it in {advice}" in str(caught.value)) == bool(advice)


@pytest.mark.parametrize("name", ["a.zip", "a.ZAE", "a.b.7z"])
def test_an_archive_is_to_be_unpacked(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04something else")
    with pytest.raises(FormatError, match="; unpack this archive first, and open the mesh in it"):
        io.read_mesh(tmp_path / name)
