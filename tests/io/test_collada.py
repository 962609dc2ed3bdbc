"""COLLADA: scenes of nodes, polygons of all kinds, materials with textures; and hostile ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import FormatError, Mesh, Texture, io
from zoo import volume

CUBE = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def text_of(values: object) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(values, dtype=float).ravel())


def source(name: str, rows: object, parameters: str = "X Y Z") -> str:
    table = np.asarray(rows, dtype=float)
    params = "".join(f'<param name="{each}" type="float"/>' for each in parameters.split())
    return (
        f'<source id="{name}"><float_array id="{name}-array" count="{table.size}">'
        f"{text_of(table)}</float_array><technique_common>"
        f'<accessor source="#{name}-array" count="{len(table)}" stride="{table.shape[1]}">'
        f"{params}</accessor></technique_common></source>"
    )


def geometry(
    faces: str, name: str = "cube", vertices: object = CUBE, sources: str = "", about: str = ""
) -> str:
    return (
        f'<geometry id="{name}"><mesh>{source(f"{name}-p", vertices)}{sources}'
        f'<vertices id="{name}-v"><input semantic="POSITION" source="#{name}-p"/>{about}'
        f"</vertices>{faces}</mesh></geometry>"
    )


def polylist(polygons: object, name: str = "cube", symbol: str = "") -> str:
    rows = [list(polygon) for polygon in polygons]  # type: ignore[attr-defined]
    return (
        f'<polylist material="{symbol}" count="{len(rows)}">'
        f'<input semantic="VERTEX" source="#{name}-v" offset="0"/>'
        f"<vcount>{' '.join(str(len(row)) for row in rows)}</vcount>"
        f"<p>{' '.join(str(v) for row in rows for v in row)}</p></polylist>"
    )


SHOWN = '<node><instance_geometry url="#cube"/></node>'


def document(geometries: str, nodes: str = SHOWN, libraries: str = "", before: str = "") -> bytes:
    scene = (
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
    )
    return (
        f'<?xml version="1.0" encoding="utf-8"?>{before}'
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        '<asset><unit meter="0.01" name="centimeter"/><up_axis>Z_UP</up_axis></asset>'
        f"{libraries}<library_geometries>{geometries}</library_geometries>{scene}</COLLADA>"
    ).encode()


def read(data: bytes) -> Mesh:
    return io.read_mesh_bytes(data, "dae")


def error(data: bytes) -> str:
    with pytest.raises(FormatError) as caught:
        read(data)
    return str(caught.value)


def test_a_file_is_read_also_by_its_content(tmp_path: Path) -> None:
    data = document(geometry(polylist(QUADS)))
    (tmp_path / "cube.DAE").write_bytes(data)
    report = io.read_report(tmp_path / "cube.DAE")
    assert (report.format, report.num_polygons, report.warnings) == ("dae", 6, ())
    assert report.mesh.num_faces == 12
    assert volume(report.mesh) == pytest.approx(1.0)
    assert io.read_mesh_bytes(data).num_faces == 12
    assert ".dae" in io.READABLE


def test_polygons_are_cut_as_in_all_formats() -> None:
    """
    A concave polygon, an arrow:
        1
       / \\
      / 3 \\
     / / \\ \\
    0       2
    """
    arrow = [(0, 0, 0), (2, 4, 0), (4, 0, 0), (2, 2, 0)]
    mesh = read(document(geometry(polylist([(0, 1, 2, 3)]), vertices=arrow)))
    obj = "".join(f"v {x} {y} {z}\n" for x, y, z in arrow) + "f 1 2 3 4\n"
    assert mesh.faces.tolist() == io.read_mesh_bytes(obj.encode(), "obj").faces.tolist()


@pytest.mark.parametrize(
    ("faces", "expected"),
    [
        ("<triangles count='2'>{}<p>0 1 2 2 1 3</p></triangles>", [[0, 1, 2], [2, 1, 3]]),
        ("<tristrips count='1'>{}<p>0 1 2 3</p></tristrips>", [[0, 1, 2], [1, 3, 2]]),
        ("<trifans count='1'>{}<p>0 1 3 2</p></trifans>", [[0, 1, 3], [0, 3, 2]]),
        ("<polygons count='2'>{}<p>0 1 2</p><p>2 1 3</p></polygons>", [[0, 1, 2], [2, 1, 3]]),
        ("<triangles count='1'>{}<p>0 1 2</p></triangles><lines count='1'/>", [[0, 1, 2]]),
    ],
)
def test_kinds_of_faces(faces: str, expected: list[list[int]]) -> None:
    given = '<input semantic="VERTEX" source="#cube-v" offset="0"/>'
    assert read(document(geometry(faces.format(given)))).faces.tolist() == expected


def test_ids_may_be_used_in_each_geometry_anew() -> None:
    """FreeCAD's writer numbers the sources of each of its parts from 0."""
    first = geometry(polylist(QUADS))
    second = first.replace('id="cube"', 'id="other"').replace("1 1 1</float", "3 3 3</float")
    nodes = SHOWN + SHOWN.replace("#cube", "#other")
    mesh = read(document(first + second, nodes))
    assert mesh.vertices[7].tolist() == [1, 1, 1]
    assert mesh.vertices[15].tolist() == [3, 3, 3]


def test_nodes_place_geometries_and_mirrors_keep_their_outside() -> None:
    nodes = (
        "<node><translate>10 0 0</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>"
        '<node><instance_geometry url="#cube"/></node></node>'
        '<node><matrix>-1 0 0 0  0 1 0 0  0 0 1 5  0 0 0 1</matrix><instance_node url="#more"/>'
        "</node>"
    )
    library = (
        '<library_nodes><node id="more"><instance_geometry url="#cube"/></node></library_nodes>'
    )
    mesh = read(document(geometry(polylist(QUADS)), nodes, library))
    first, second = mesh.vertices[:8], mesh.vertices[8:]
    assert first.min(axis=0) == pytest.approx([9, 0, 0], abs=1e-12)
    assert first.max(axis=0) == pytest.approx([10, 2, 1], abs=1e-12)
    assert second.min(axis=0).tolist() == [-1, 0, 5]
    assert volume(mesh) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("transform", "corner"),
    [
        # The node's -z axis points along x, its y axis up, so that its x axis points along -y.
        ("<lookat>5 6 7 9 6 7 0 0 1</lookat>", (2.0, 5.0, 10.0)),
        ("<lookat>5 6 7 5 6 7 0 0 1</lookat>", (6.0, 9.0, 10.0)),  # looks nowhere
        ("<lookat>5 6 7 5 6 1 0 0 1</lookat>", (6.0, 9.0, 10.0)),  # looks down, and up is up
        ("<skew>45 0 2 0 3 0 0</skew>", (4.0, 3.0, 3.0)),  # along x by y
        ("<skew>45 0 0 0 3 0 0</skew>", (1.0, 3.0, 3.0)),
    ],
)
def test_nodes_may_look_at_a_place_or_be_skewed(
    transform: str, corner: tuple[float, float, float]
) -> None:
    box = geometry(polylist(QUADS), vertices=np.array(CUBE) * (1, 3, 3))
    mesh = read(document(box, f'<node>{transform}<instance_geometry url="#cube"/></node>'))
    np.testing.assert_allclose(mesh.vertices[-1], corner, atol=1e-12)
    assert volume(mesh) == pytest.approx(9.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_normals_of_nodes_point_to_the_outside_of_their_faces(sign: int) -> None:
    """The node makes x three times as long, and mirrors it in the second case."""
    faces = (
        "<triangles count='1'><input semantic='VERTEX' source='#cube-v' offset='0'/>"
        "<input semantic='NORMAL' source='#n' offset='1'/><p>0 0 1 0 2 0</p></triangles>"
    )
    shape = geometry(faces, vertices=np.eye(3), sources=source("n", [(1, 1, 1)]))
    node = f'<node><scale>{3 * sign} 1 1</scale><instance_geometry url="#cube"/></node>'
    mesh = read(document(shape, node))
    a, b, c = mesh.vertices[mesh.faces[0]]
    outside = np.cross(b - a, c - a)
    assert outside @ (sign, 1, 1) > 0
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, [outside / np.linalg.norm(outside)], atol=1e-12)


def test_texcoords_normals_and_colors_have_indices_of_their_own() -> None:
    sources = (
        source("t", [(0, 0), (1, 0), (0, 1)], "S T")
        + source("n", [(0, 0, 2)])
        + source("c", [(1, 0, 0, 1), (0, 0, 1, 1)], "R G B A")
    )
    faces = (
        "<triangles count='1'><input semantic='VERTEX' source='#cube-v' offset='0'/>"
        "<input semantic='TEXCOORD' source='#t' offset='1' set='0'/>"
        "<input semantic='NORMAL' source='#n' offset='2'/>"
        "<input semantic='COLOR' source='#c' offset='3'/><p>0 0 0 0 1 1 0 0 2 2 0 1</p></triangles>"
    )
    scaled = '<node><scale>1 1 4</scale><instance_geometry url="#cube"/></node>'
    mesh = read(document(geometry(faces, sources=sources), scaled))
    assert mesh.texcoords is not None
    assert mesh.face_texcoords is not None
    assert mesh.texcoords[mesh.face_texcoords[0]].tolist() == [[0, 0], [1, 0], [0, 1]]
    assert mesh.normals is not None
    assert mesh.normals.tolist() == [[0, 0, 1]]
    assert mesh.colors is not None
    assert mesh.colors[:3].tolist() == [[255, 0, 0], [255, 0, 0], [0, 0, 255]]


def effect(look: str, parameters: str = "") -> str:
    return (
        f'<library_effects><effect id="e"><profile_COMMON>{parameters}<technique sid="common">'
        f"<phong>{look}</phong></technique></profile_COMMON></effect></library_effects>"
        '<library_materials><material id="m" name="wood"><instance_effect url="#e"/></material>'
        "</library_materials>"
    )


BOUND = (
    '<node><instance_geometry url="#cube"><bind_material><technique_common>'
    '<instance_material symbol="sym" target="#m"/></technique_common></bind_material>'
    "</instance_geometry></node>"
)


def test_materials_are_those_that_the_scene_binds() -> None:
    look = (
        "<emission><color>0 .5 0 1</color></emission><diffuse><color>.2 .4 .6 1</color></diffuse>"
        "<transparent opaque='A_ONE'><color>1 1 1 1</color></transparent>"
        "<transparency><float>.25</float></transparency>"
    )
    faces = polylist(QUADS[:4], symbol="sym") + polylist(QUADS[4:], symbol="unknown")
    mesh = read(document(geometry(faces), BOUND, effect(look)))
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [0] * 8 + [-1] * 4
    (material,) = mesh.materials
    assert material.name == "wood"
    assert material.base_color == (0.2, 0.4, 0.6, 0.25)
    assert (material.alpha_mode, material.emissive) == ("blend", (0.0, 0.5, 0.0))


def painted(color: str, symbol: str) -> str:
    """Two triangles of the given material; the corners of each have a colour of their own."""
    colors = source("c", np.array([[int(d) for d in name] for name in color.split()]), "R G B")
    faces = (
        f"<triangles material='{symbol}' count='2'><input semantic='VERTEX' source='#cube-v' "
        "offset='0'/><input semantic='COLOR' source='#c' offset='1'/>"
        "<p>0 0 1 0 2 0 3 1 4 1 5 1</p></triangles>"
    )
    return geometry(faces, sources=colors)


def test_a_layer_of_white_colors_leaves_materials_as_they_are() -> None:
    """Blender writes such a layer by default."""
    library = effect("<diffuse><color>.2 .4 .6 1</color></diffuse>")
    mesh = read(document(painted("111 111", "sym"), BOUND, library))
    assert mesh.colors is None
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [0, 0]
    assert [m.name for m in mesh.materials] == ["wood"]


def test_colors_of_faces_with_a_material_are_those_of_vertices() -> None:
    library = effect("<diffuse><color>.2 .4 .6 1</color></diffuse>")
    mesh = read(document(painted("100 111", "sym"), BOUND, library))
    assert mesh.colors is not None
    assert mesh.colors[:6].tolist() == [[255, 0, 0]] * 3 + [[255, 255, 255]] * 3
    assert mesh.face_material is not None
    assert mesh.face_material.tolist() == [0, 0]
    assert [m.name for m in mesh.materials] == ["wood"]


def test_colors_of_faces_without_a_material_are_materials() -> None:
    mesh = read(document(painted("111 001", "unknown")))
    assert mesh.colors is None
    assert mesh.face_material is not None
    assert [mesh.materials[i].base_color[:3] for i in mesh.face_material] == [(1, 1, 1), (0, 0, 1)]


def test_colors_that_differ_around_a_vertex_with_a_material_are_told(tmp_path: Path) -> None:
    shape = painted("100 001", "sym").replace("3 1 4 1 5 1", "0 1 4 1 5 1")
    library = effect("<diffuse><color>.2 .4 .6 1</color></diffuse>")
    (tmp_path / "a.dae").write_bytes(document(shape, BOUND, library))
    report = io.read_report(tmp_path / "a.dae")
    assert report.mesh.colors is not None
    assert report.mesh.colors[0].tolist() == [128, 0, 128]
    assert report.warnings == (
        "faces with materials have colors, too: each vertex takes the mean of its faces",
    )


def test_a_material_that_nobody_would_see_is_opaque() -> None:
    look = (
        "<diffuse><color>1 1 1 1</color></diffuse><transparent><color>1 1 1 1</color>"
        "</transparent><transparency><float>0</float></transparency>"
    )
    mesh = read(document(geometry(polylist(QUADS, symbol="sym")), BOUND, effect(look)))
    assert mesh.materials[0].base_color == (1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("uri", "stored"),
    [
        ("wood.png", "wood.png"),
        ("my%20maps/wood.png", "my maps/wood.png"),
        ("file:///C:/pictures/wood.png", "wood.png"),
        ("C:\\textures\\wood.png", "wood.png"),
        ("./wood.png", "./wood.png"),
    ],
)
@pytest.mark.parametrize("through_sampler", [True, False])
def test_textures(tmp_path: Path, uri: str, stored: str, through_sampler: bool) -> None:
    parameters = (
        "<newparam sid='surface'><surface type='2D'><init_from>i</init_from></surface></newparam>"
        "<newparam sid='sampler'><sampler2D><source>surface</source></sampler2D></newparam>"
    )
    name = "sampler" if through_sampler else "i"
    look = f"<diffuse><texture texture='{name}' texcoord='UV'/></diffuse>"
    library = (
        f"<library_images><image id='i'><init_from>{uri}</init_from></image></library_images>"
        + effect(look, parameters if through_sampler else "")
    )
    path = tmp_path / "cube.dae"
    path.write_bytes(document(geometry(polylist(QUADS, symbol="sym")), BOUND, library))
    mesh = io.read_mesh(path)
    assert mesh.materials[0].textures["base_color"].path == stored


def test_textures_keep_wrap_modes_and_filter(tmp_path: Path) -> None:
    parameters = (
        "<newparam sid='surface'><surface type='2D'><init_from>i</init_from></surface></newparam>"
        "<newparam sid='sampler'><sampler2D><source>surface</source><wrap_s>CLAMP</wrap_s>"
        "<wrap_t>MIRROR</wrap_t><magfilter>NEAREST</magfilter></sampler2D></newparam>"
    )
    look = "<diffuse><texture texture='sampler' texcoord='UV'/></diffuse>"
    library = (
        "<library_images><image id='i'><init_from>wood.png</init_from></image></library_images>"
        + effect(look, parameters)
    )
    path = tmp_path / "cube.dae"
    path.write_bytes(document(geometry(polylist(QUADS, symbol="sym")), BOUND, library))
    texture = io.read_mesh(path).materials[0].textures["base_color"]
    assert texture == Texture("wood.png", wrap=("clamp", "mirror"), smooth=False)


@pytest.mark.parametrize("named", ["images/wood.png", "../pictures/wood.png"])
def test_a_picture_beside_the_file_is_used_if_its_folder_is_missing(
    tmp_path: Path, named: str
) -> None:
    look = "<diffuse><texture texture='i' texcoord='UV'/></diffuse>"
    library = (
        f"<library_images><image id='i'><init_from>{named}</init_from></image>"
        "</library_images>" + effect(look)
    )
    path = tmp_path / "here" / "cube.dae"
    path.parent.mkdir()
    path.write_bytes(document(geometry(polylist(QUADS, symbol="sym")), BOUND, library))
    (path.parent / "wood.png").touch()
    report = io.read_report(path)
    assert report.mesh.materials[0].textures["base_color"].path == "wood.png"
    assert report.warnings == (f"texture '{named}' not found, 'wood.png' is used",)
    outside = io.read_mesh(path, allow_outside=True).materials[0].textures["base_color"].path
    assert outside is not None
    assert outside.endswith(named)
    if named.startswith("images"):
        (path.parent / "images").mkdir()
        (path.parent / named).touch()
        report = io.read_report(path)
        assert report.mesh.materials[0].textures["base_color"].path == named
        assert report.warnings == ()


def test_a_texture_outside_of_the_folder_is_left_out(tmp_path: Path) -> None:
    look = "<diffuse><texture texture='i' texcoord='UV'/></diffuse>"
    library = (
        "<library_images><image id='i'><init_from>../secret.png</init_from></image>"
        "</library_images>" + effect(look)
    )
    path = tmp_path / "cube.dae"
    path.write_bytes(document(geometry(polylist(QUADS, symbol="sym")), BOUND, library))
    report = io.read_report(path)
    assert report.mesh.materials[0].textures == {}
    assert any("texture left out" in text for text in report.warnings)
    allowed = io.read_mesh(path, allow_outside=True).materials[0].textures["base_color"].path
    assert allowed is not None
    assert Path(allowed).resolve() == (tmp_path.parent / "secret.png").resolve()


def test_a_skin_stands_as_it_was_bound() -> None:
    library = (
        "<library_controllers><controller id='c'><skin source='#cube'><bind_shape_matrix>"
        "1 0 0 7  0 1 0 0  0 0 1 0  0 0 0 1</bind_shape_matrix></skin></controller>"
        "</library_controllers>"
    )
    nodes = (
        '<node><translate>100 0 0</translate><instance_controller url="#c"/></node>'
        "<node><instance_light url='#l'/></node>"
    )
    data = document(geometry(polylist(QUADS)), nodes, library)
    mesh = read(data)
    assert mesh.vertices.min(axis=0).tolist() == [7, 0, 0]


def test_long_chains_of_bones_are_read() -> None:
    """A file of 3ds Max has 66 bones, each a node within the one before it."""
    bones = "<node><translate>1 0 0</translate>" * 150 + SHOWN + "</node>" * 150
    mesh = read(document(geometry(polylist(QUADS)), bones))
    assert mesh.vertices.min(axis=0).tolist() == [150, 0, 0]


@pytest.mark.parametrize(
    ("transparent", "alpha_mode", "warnings"),
    [
        ("<transparent opaque='A_ONE'><texture texture='i'/></transparent>", "blend", ()),
        ("<transparent><texture texture='i'/></transparent>", "blend", ()),
        ("<transparent><texture texture='none'/></transparent>", "opaque", ()),
        (
            "<transparent><texture texture='j'/></transparent>",
            "opaque",
            ("the texture of the transparency of material 'wood' is left out",),
        ),
        (
            "<transparent opaque='RGB_ZERO'><texture texture='i'/></transparent>",
            "opaque",
            ("the texture of the transparency of material 'wood' is left out",),
        ),
    ],
)
def test_leaves_cut_out_by_the_alpha_of_their_texture(
    tmp_path: Path, transparent: str, alpha_mode: str, warnings: tuple[str, ...]
) -> None:
    look = f"<diffuse><texture texture='i' texcoord='UV'/></diffuse>{transparent}"
    images = "".join(
        f"<image id='{name}'><init_from>{name}.png</init_from></image>" for name in "ij"
    )
    library = f"<library_images>{images}</library_images>{effect(look)}"
    path = tmp_path / "leaf.dae"
    path.write_bytes(document(geometry(polylist(QUADS, symbol="sym")), BOUND, library))
    report = io.read_report(path)
    assert report.mesh.materials[0].alpha_mode == alpha_mode
    assert report.mesh.materials[0].base_color == (1.0, 1.0, 1.0, 1.0)
    assert report.warnings == warnings


def test_a_file_without_a_scene_gives_its_geometries() -> None:
    data = document(geometry(polylist(QUADS))).decode()
    start, end = data.index("<library_visual_scenes>"), data.index("</COLLADA>")
    assert read((data[:start] + data[end:]).encode()).num_faces == 12


@pytest.mark.parametrize(
    ("behind", "warnings"),
    [
        (bytes(300), ()),
        (b"\n" + bytes(20) + b"</mesh>", ("bytes behind the end of the document are left out",)),
    ],
)
def test_nuls_behind_the_end_are_left_out(
    tmp_path: Path, behind: bytes, warnings: tuple[str, ...]
) -> None:
    """A file that was written over a longer one."""
    (tmp_path / "a.dae").write_bytes(document(geometry(polylist(QUADS))) + behind)
    report = io.read_report(tmp_path / "a.dae")
    assert report.mesh.num_faces == 12
    assert report.warnings == warnings


def test_a_file_in_utf_16_is_read() -> None:
    text = document(geometry(polylist(QUADS))).decode().replace("utf-8", "utf-16")
    assert read(text.encode("utf-16")).num_faces == 12


def test_what_is_damaged_is_named() -> None:
    assert "expected 0 to 7, got 8" in error(document(geometry(polylist([(0, 1, 8)]))))
    assert "expected 0 to 7, got 8" in error(document(geometry(polylist([(0, 1, 2, 8)]))))
    assert "invalid literal" in error(document(geometry(polylist([(0, 1, "x")]))))
    short = geometry(polylist(QUADS)).replace('count="8"', 'count="9"')
    assert "expected 27 numbers, got 24" in error(document(short))
    lost = document(geometry(polylist(QUADS)), '<node><instance_geometry url="#no"/></node>')
    assert "expected the id of a geometry or controller" in error(lost)
    assert "expected the element COLLADA" in error(b"<svg/>")
    assert "not well-formed" in error(document(geometry(polylist(QUADS)))[:-40])
    assert "got none" in error(document(geometry("")))
    nan = geometry(polylist(QUADS), vertices=[(np.nan, 0, 0), *CUBE[1:]])
    assert "expected finite numbers" in error(document(nan))
    far = "<node><scale>1e300 1 1</scale><node><scale>1e300 1 1</scale>{}</node></node>"
    assert "expected finite numbers" in error(
        document(geometry(polylist(QUADS)), far.format(SHOWN))
    )


def test_bombs_are_refused() -> None:
    entities = '<!DOCTYPE c [<!ENTITY a "aaaaaaaa">]>'
    assert "entities" in error(document(geometry(polylist(QUADS)), before=entities))
    levels = "".join(
        f'<node id="n{i}">' + f'<instance_node url="#n{i + 1}"/>' * 10 + "</node>"
        for i in range(12)
    )
    library = f"<library_nodes>{levels}<node id='n12'>{SHOWN}</node></library_nodes>"
    nodes = '<node><instance_node url="#n0"/></node>'
    assert "set max_bytes" in error(document(geometry(polylist(QUADS)), nodes, library))
    ring = "<library_nodes><node id='n0'><instance_node url='#n0'/></node></library_nodes>"
    assert "more than 192 deep" in error(document(geometry(polylist(QUADS)), nodes, ring))
    deep = error(document("<a>" * 300 + "</a>" * 300))
    assert deep == "line 1: elements nested deeper than 256"
    nothing = levels.replace("<node id='n12'>" + SHOWN + "</node>", "")
    library = f"<library_nodes>{nothing}<node id='n12'/></library_nodes>"
    assert "got none" in error(document(geometry(polylist(QUADS)), nodes, library))


def test_a_file_is_simplified_and_written(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), [0.0]), axis=-1).reshape(-1, 3)
    quads = [
        (20 * r + c, 20 * r + c + 1, 20 * r + c + 21, 20 * r + c + 20)
        for r in range(19)
        for c in range(19)
    ]
    path = tmp_path / "grid.dae"
    path.write_bytes(document(geometry(polylist(quads), vertices=grid)))
    result = manip3d.simplify.simplify(io.read_mesh(path), target_faces=2)
    result.mesh.write(tmp_path / "grid.glb")
    assert io.read_mesh(tmp_path / "grid.glb").num_faces == 2


def test_a_column_without_a_name_is_skipped() -> None:
    content = document(geometry(polylist(QUADS)))
    flat = content.replace(b'<param name="Z" type="float"/>', b'<param type="float"/>')
    assert flat != content
    mesh = io.read_mesh_bytes(flat, "dae")
    assert mesh.vertices[:, 2].tolist() == [0.0] * mesh.num_vertices
    assert len(np.unique(mesh.vertices[:, :2], axis=0)) == 4


def test_decimal_commas_are_read() -> None:
    """Autodesk's exporter of 2008 wrote them on machines whose language has them."""
    nodes = '<node><translate>0.5 0 -1e-3</translate><instance_geometry url="#cube"/></node>'
    polygons = polylist(QUADS)
    text = document(geometry(polygons, vertices=np.array(CUBE) * 1.25), nodes).decode()
    commas = text.replace("1.25", "1,25").replace("0.5", "0,5")
    assert commas.count(",") == 13
    expected, mesh = (io.read_mesh_bytes(each.encode()) for each in (text, commas))
    assert np.array_equal(mesh.vertices, expected.vertices)
    with pytest.raises(FormatError, match=r"translate: .*1\.2\.3"):
        io.read_mesh_bytes(text.replace("0.5 0", "1,2,3 0").encode())


def test_counts_that_overflow_their_sum_are_refused() -> None:
    huge = document(geometry(polylist(QUADS).replace("<vcount>4 4 ", f"<vcount>{2**62} {2**62} ")))
    with pytest.raises(FormatError, match="got 24 corners"):
        io.read_mesh_bytes(huge, "dae")
