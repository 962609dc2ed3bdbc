"""Writing glTF and GLB: read back by our own reader, by trimesh and by Open3D."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d
from gltf_files import PNG, json_of
from manip3d import Material, Mesh, Texture
from real_data import RealData

JPEG = b"\xff\xd8\xff\xe0 not looked at any further"


def corners(mesh: Mesh) -> NDArray[np.float64]:
    """(F, 3, 3) positions of the corners: the same for any order of the vertices."""
    return mesh.vertices[mesh.faces]


def corner_texcoords(mesh: Mesh) -> NDArray[np.float64]:
    """(F, 3, 2), NaN where there are none."""
    if mesh.texcoords is None or mesh.face_texcoords is None:
        return np.full((mesh.num_faces, 3, 2), np.nan)
    with_none: NDArray[np.float64] = np.vstack([mesh.texcoords, [[np.nan, np.nan]]])
    return with_none[mesh.face_texcoords]


def in_groups(mesh: Mesh) -> Mesh:
    """The faces in the order of a glTF file: by material and having UVs, as they first appear."""
    assert mesh.face_material is not None
    assert mesh.face_texcoords is not None
    keys = mesh.face_material * 2 + (mesh.face_texcoords >= 0).all(axis=1)
    _, first, group = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first[group], kind="stable")
    return mesh.replace(
        faces=mesh.faces[order],
        face_texcoords=mesh.face_texcoords[order],
        face_material=mesh.face_material[order],
        face_normals=None if mesh.face_normals is None else mesh.face_normals[order],
    )


@pytest.fixture
def mesh() -> Mesh:
    """3---2   faces 0 and 1 meet at a seam in UV space, face 2 has no UVs; vertex 4 is loose.
    | / |
    0---1
    """
    return Mesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5], [9, 9, 9]],
        [[0, 1, 2], [0, 2, 3], [0, 3, 1]],
        texcoords=[[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.25]],
        face_texcoords=[[0, 1, 2], [4, 2, 3], [-1, -1, -1]],
        colors=[[0, 0, 0], [255, 255, 255], [1, 2, 3], [128, 129, 130], [9, 9, 9]],
        face_material=[0, 0, 0],
        materials=[
            Material("skin", textures={"base_color": Texture(data=PNG)}),
            Material("glass", (1.0, 0.5, 0.25, 0.125), 0.25, 0.5, "mask", 0.75, double_sided=False),
        ],
    )


@pytest.mark.parametrize("name", ["m.glb", "m.gltf", "m.glb.xz", "m.gltf.gz"])
def test_round_trip(mesh: Mesh, tmp_path: Path, name: str) -> None:
    mesh.write(tmp_path / name)
    again = manip3d.read_mesh(tmp_path / name)
    np.testing.assert_array_equal(corners(again), corners(mesh))
    np.testing.assert_array_equal(corner_texcoords(again), corner_texcoords(mesh))
    assert again.colors is not None
    assert mesh.colors is not None
    np.testing.assert_array_equal(again.colors[again.faces], mesh.colors[mesh.faces])
    np.testing.assert_array_equal(again.face_material, [0, 0, 0])
    assert again.num_vertices == 5 + 3  # vertex 0 twice on the seam; the part without UVs apart
    if "glb" in name:
        assert again.materials == mesh.materials
    else:
        assert again.materials[0].textures == {"base_color": Texture(path="m_0.png")}
        assert (tmp_path / "m_0.png").read_bytes() == PNG


def test_the_same_mesh_gives_the_same_bytes(mesh: Mesh, tmp_path: Path) -> None:
    contents = []
    for name in ("a.glb", "b.glb"):
        mesh.write(tmp_path / name)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]
    assert json_of(tmp_path / "a.glb")["asset"] == {
        "version": "2.0",
        "generator": f"manip3d {manip3d.__version__}",
    }


def test_what_the_specification_asks_of_the_json(mesh: Mesh, tmp_path: Path) -> None:
    mesh.write(tmp_path / "m.glb")
    document = json_of(tmp_path / "m.glb")
    textured, plain = document["meshes"][0]["primitives"]
    position = document["accessors"][textured["attributes"]["POSITION"]]
    assert position["min"] == [0, 0, 0]
    assert position["max"] == [1, 1, 0.5]
    assert document["accessors"][textured["indices"]]["componentType"] == 5123
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
    # A material with textures must not meet a primitive without TEXCOORD_0.
    assert "TEXCOORD_0" not in plain["attributes"]
    assert (
        "baseColorTexture" not in document["materials"][plain["material"]]["pbrMetallicRoughness"]
    )
    assert document["materials"][plain["material"]]["name"] == "skin"


def test_every_srgb_value_comes_back(tmp_path: Path) -> None:
    grey = np.arange(256).repeat(3).reshape(-1, 3)
    vertices = np.column_stack([np.arange(256), np.arange(256) % 2, np.zeros(256)])
    faces = np.column_stack([np.arange(254), np.arange(1, 255), np.arange(2, 256)])
    Mesh(vertices, faces, colors=grey).write(tmp_path / "m.glb")
    again = manip3d.read_mesh(tmp_path / "m.glb")
    assert again.colors is not None
    np.testing.assert_array_equal(again.colors[again.faces], grey[faces])


def test_normals_split_and_zero_normals_are_none(tmp_path: Path) -> None:
    mesh = Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
        [[0, 1, 2], [2, 1, 3]],
        normals=[[0, 0, 2], [0, 3, 0], [0, 0, 0]],
        face_normals=[[0, 0, 0], [1, 1, 0]],
    )
    mesh.write(tmp_path / "m.glb")
    again = manip3d.read_mesh(tmp_path / "m.glb")
    assert again.normals is not None
    expected = [[[0, 0, 1]] * 3, [[0, 1, 0], [0, 1, 0], [0, 0, 1]]]
    np.testing.assert_array_equal(again.normals[again.face_normals], expected)
    mesh.replace(face_normals=[[0, 0, 0], [1, 1, 2]]).write(tmp_path / "m.glb")
    again = manip3d.read_mesh(tmp_path / "m.glb")
    np.testing.assert_array_equal(again.face_normals, [[0, 1, 2], [-1, -1, -1]])


@pytest.mark.parametrize(("num_vertices", "index_type"), [(65535, 5123), (65536, 5125)])
def test_indices_are_as_narrow_as_they_may(
    tmp_path: Path, num_vertices: int, index_type: int
) -> None:
    vertices = np.column_stack([np.arange(num_vertices)] * 3) % [257, 263, 269]
    faces = np.arange(num_vertices - num_vertices % 3).reshape(-1, 3)
    faces = np.vstack([faces, [[0, 1, num_vertices - 1]]])
    Mesh(vertices, faces).write(tmp_path / "m.glb")
    assert json_of(tmp_path / "m.glb")["accessors"][1]["componentType"] == index_type
    again = manip3d.read_mesh(tmp_path / "m.glb")
    np.testing.assert_array_equal(corners(again), vertices[faces])


def test_far_from_the_origin_the_node_moves_the_mesh(mesh: Mesh, tmp_path: Path) -> None:
    far = mesh.replace(vertices=mesh.vertices * 0.1 + [500_000.1, -3e6, 0])
    far.write(tmp_path / "m.glb")
    assert len(json_of(tmp_path / "m.glb")["nodes"][0]["translation"]) == 3
    again = manip3d.read_mesh(tmp_path / "m.glb")
    assert np.abs(corners(again) - corners(far)).max() < 1e-6 * far.diagonal
    mesh.write(tmp_path / "m.glb")
    assert "translation" not in json_of(tmp_path / "m.glb")["nodes"][0]


@pytest.mark.parametrize("scale", [1e9, 1e-9, 1e37, 1e-37])
def test_any_scale(mesh: Mesh, tmp_path: Path, scale: float) -> None:
    scaled = mesh.replace(vertices=mesh.vertices * scale)
    scaled.write(tmp_path / "m.glb")
    error = corners(manip3d.read_mesh(tmp_path / "m.glb")) - corners(scaled)
    assert np.abs(error).max() < 1e-6 * scaled.diagonal


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.eye(5, 3) * 1e39}, "vertices: glTF holds float32"),
        ({"vertices": np.eye(5, 3) * 1e-40}, "vertices: glTF holds float32, too coarse"),
        ({"texcoords": np.full((5, 2), 1e39)}, "texcoords: glTF holds float32"),
        ({"face_material": [0, 2, 0]}, "face_material: expected indices below 2"),
        (
            {"faces": [], "face_texcoords": None, "face_material": None},
            "a mesh without faces",
        ),
    ],
)
def test_what_cannot_be_written(
    mesh: Mesh, tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = tmp_path / "m.glb"
    path.write_text("the old file")
    with pytest.raises(manip3d.InputError, match=message):
        mesh.replace(**change).write(path)
    assert path.read_text() == "the old file"
    assert list(tmp_path.iterdir()) == [path]


# --- Textures and other files -------------------------------------------------------------------


def test_textures_are_found_beside_the_source_and_embedded_once(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "skin.jpg").write_bytes(JPEG)
    (tmp_path / "in" / "map.tga").write_bytes(b"no png")
    skin = Texture("skin.jpg")
    textured = Mesh(
        np.eye(3),
        [[0, 1, 2]],
        texcoords=np.eye(3, 2),
        face_texcoords=[[0, 1, 2]],
        face_material=[0],
        materials=[
            Material("a", textures={"base_color": skin, "emissive": Texture(data=JPEG)}),
            Material("b", textures={"base_color": skin, "normal": Texture("map.tga")}),
        ],
        source=str(tmp_path / "in" / "mesh.obj"),
    )
    textured.write(tmp_path / "m.glb")
    document = json_of(tmp_path / "m.glb")
    assert document["images"] == [{"bufferView": 3, "mimeType": "image/jpeg"}]
    embedded = Texture(data=JPEG)
    first, second = manip3d.read_mesh(tmp_path / "m.glb").materials
    assert first.textures == {"base_color": embedded, "emissive": embedded}
    assert second.textures == {"base_color": embedded}


def test_a_surface_does_not_glow_for_an_emissive_texture_that_is_missing(
    mesh: Mesh, tmp_path: Path
) -> None:
    there, missing = {"emissive": Texture(data=PNG)}, {"emissive": Texture("missing.png")}
    materials = [Material("a", textures=there), Material("b", textures=missing)]
    mesh.replace(materials=materials, source=str(tmp_path / "mesh.obj")).write(tmp_path / "m.glb")
    first, second, *_ = json_of(tmp_path / "m.glb")["materials"]
    assert (first["emissiveFactor"], first["emissiveTexture"]) == ([1, 1, 1], {"index": 0})
    assert "emissiveFactor" not in second
    assert "emissiveTexture" not in second


def test_light_that_a_surface_sends_out_comes_back(mesh: Mesh, tmp_path: Path) -> None:
    image = {"emissive": Texture(data=PNG)}
    materials = [
        Material("no image", emissive=(1.0, 0.5, 0.0)),
        Material("image", textures=image, emissive=(0.25, 0.5, 0.75)),
        Material("bright", emissive=(4.0, 2.0, 0.0)),
        Material("colour", textures={"base_color": Texture(data=PNG)}, emissive=(0.5, 0.5, 0.5)),
        Material("plain"),
    ]
    given = mesh.replace(materials=materials, face_material=[0, 3, 3])
    given.write(tmp_path / "m.glb")
    assert manip3d.read_mesh(tmp_path / "m.glb").materials == tuple(materials)
    found = json_of(tmp_path / "m.glb")
    assert found["extensionsUsed"] == ["KHR_materials_emissive_strength"]
    factors = [material.get("emissiveFactor") for material in found["materials"]]
    half = [0.5, 0.5, 0.5]  # the last one is "colour" for the face without UVs
    assert factors == [[1, 0.5, 0], [0.25, 0.5, 0.75], [1, 0.5, 0], half, None, half]
    given.write(tmp_path / "m.obj")
    again = manip3d.read_mesh(tmp_path / "m.obj").materials
    assert [m.emissive for m in again] == [materials[0].emissive, materials[3].emissive]


def test_what_is_left_out_is_told(
    mesh: Mesh, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "bad.png").write_bytes(b"no picture")
    textures = {"base_color": Texture("missing.png"), "normal": Texture("bad.png")}
    changed = mesh.replace(
        materials=[Material("a", textures=textures)], source=str(tmp_path / "mesh.obj")
    )
    with caplog.at_level(logging.WARNING, "manip3d"):
        changed.write(tmp_path / "m.glb")
    assert "texture 'missing.png' not found and left out" in caplog.text
    assert "texture 'bad.png' is not a PNG or JPEG image and was left out" in caplog.text
    assert "images" not in json_of(tmp_path / "m.glb")


def test_a_missing_texture_of_many_materials_is_told_once(
    mesh: Mesh, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "bad.png").write_bytes(b"no picture")
    missing, bad = Texture("missing.png"), Texture("bad.png")
    materials = [Material(name, textures={"base_color": missing, "normal": bad}) for name in "abc"]
    mesh = mesh.replace(materials=materials, source=str(tmp_path / "mesh.obj"))
    for name in ("m.glb", "m.gltf", "m.obj"):
        caplog.clear()
        with caplog.at_level(logging.WARNING, "manip3d"):
            mesh.write(tmp_path / name)
        told = [record.getMessage() for record in caplog.records]
        assert sum("missing.png" in text for text in told) == 1
        assert len(told) == len(set(told))
        assert not any("object at" in text for text in told)


def test_gltf_puts_its_files_beside_it_and_keeps_older_ones(mesh: Mesh, tmp_path: Path) -> None:
    path = tmp_path / "ä b.gltf"
    mesh.write(path)
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {"ä b.gltf", "ä b.bin", "ä b_0.png"}
    assert json_of(path)["buffers"][0]["uri"] == "%C3%A4%20b.bin"
    old = {p: p.read_bytes() for p in tmp_path.iterdir() if p != path}
    moved = mesh.replace(vertices=mesh.vertices + 1)
    moved.write(path)
    for file, content in old.items():
        assert file.read_bytes() == content  # whoever still holds the old .gltf
    assert len(list(tmp_path.iterdir())) == 4
    np.testing.assert_array_equal(corners(manip3d.read_mesh(path)), corners(moved))


# --- Others read it the same ----------------------------------------------------------------------


def test_trimesh_reads_the_same(mesh: Mesh, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    textured = mesh.replace(face_material=[0, 1, 0], vertices=mesh.vertices + np.array([1e6, 0, 0]))
    textured.write(tmp_path / "m.glb")
    scene = trimesh.load_scene(tmp_path / "m.glb", process=False)
    read = Mesh.from_trimesh(scene)
    ours = manip3d.read_mesh(tmp_path / "m.glb")
    np.testing.assert_array_equal(corners(read), corners(ours))
    np.testing.assert_allclose(corner_texcoords(read), corner_texcoords(ours), atol=1e-7)
    assert [m.name for m in read.materials] == ["skin", "glass", "skin"]


def test_open3d_reads_the_same(mesh: Mesh, tmp_path: Path) -> None:
    o3d = pytest.importorskip("open3d")
    mesh.write(tmp_path / "m.glb")
    read = o3d.io.read_triangle_mesh(str(tmp_path / "m.glb"))
    positions = np.asarray(read.vertices)[np.asarray(read.triangles)]
    np.testing.assert_allclose(positions, corners(mesh), atol=1e-7)


# --- Real models ----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("offset", [0.0, 5e5, 5e7])  # float32 has steps of 4 there
def test_quantised_values_are_near(offset: float, suffix: str, tmp_path: Path) -> None:
    """Errors are at most half a step: a power of two in space, 1/65535 in UV, 1/127 in normals."""
    rng = np.random.default_rng(7)
    vertices, normals = rng.random((60, 3)) * [40.0, 7.0, 0.5] + offset, rng.normal(size=(60, 3))
    faces = rng.permutation(60).reshape(20, 3)
    mesh = Mesh(
        vertices, faces, normals=normals, face_normals=faces,
        texcoords=rng.random((60, 2)), face_texcoords=faces, face_material=np.zeros(20, np.int32),
        materials=[Material("wood", textures={"base_color": Texture(data=PNG)})],
    )  # fmt: skip
    path = tmp_path / f"a{suffix}"
    manip3d.io.write_mesh(mesh, path, quantize=True)
    read = manip3d.read_mesh(path)
    step = 2.0**-10  # the smallest of which 65534 are 40
    off = np.abs(corners(read) - corners(mesh)).max()
    assert 0.3 * step < off < 0.51 * step
    off = np.abs(corner_texcoords(read) - corner_texcoords(mesh)).max()
    assert 0.3 / 65535 < off < 0.51 / 65535
    assert read.normals is not None
    assert read.face_normals is not None
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    cosines = (read.normals[read.face_normals] * unit[faces]).sum(axis=2)
    assert cosines.min() > np.cos(np.sqrt(3) * 0.51 / 127)
    document = json_of(path)
    assert document["extensionsRequired"] == ["KHR_mesh_quantization"]


def test_quantised_files_are_small_and_repeated_textures_stay_exact(tmp_path: Path) -> None:
    columns = 60
    tiles = manip3d.simulate.models.floor(columns=columns, rows=columns)
    assert tiles.texcoords is not None
    manip3d.io.write_mesh(tiles, tmp_path / "plain.glb")
    manip3d.io.write_mesh(tiles, tmp_path / "small.glb", quantize=True)
    sizes = [(tmp_path / name).stat().st_size for name in ("plain.glb", "small.glb")]
    assert sizes[1] < 0.8 * sizes[0]
    repeated = tiles.replace(texcoords=3.0 * tiles.texcoords)
    manip3d.io.write_mesh(repeated, tmp_path / "repeated.glb", quantize=True)
    off = corner_texcoords(manip3d.read_mesh(tmp_path / "repeated.glb"))
    np.testing.assert_allclose(off, corner_texcoords(in_groups(repeated)), atol=1e-5)


def test_quantised_tiles_still_meet(tmp_path: Path) -> None:
    """Each tile had a grid of its own: gaps of half a step along the border."""
    y = np.random.default_rng(3).random(50) * 30.0
    border = np.stack([np.full(50, 12.3), np.sort(y), np.sin(y)], axis=1)
    rows = []
    for side, name in ((-17.0, "left"), (18.5, "right")):
        vertices = np.concatenate([border, border + np.array([side, 0.1, 0.2])])
        i = np.arange(49)
        faces = np.concatenate(
            [np.stack([i, i + 1, i + 50], 1), np.stack([i + 1, i + 51, i + 50], 1)]
        )
        manip3d.io.write_mesh(Mesh(vertices, faces), tmp_path / f"{name}.glb", quantize=True)
        read = manip3d.read_mesh(tmp_path / f"{name}.glb").vertices
        at_border = np.unique(read[np.abs(read[:, 0] - 12.3) < 1e-3], axis=0)
        rows.append(at_border[np.argsort(at_border[:, 1])])
    assert len(rows[0]) == 50
    np.testing.assert_array_equal(rows[0], rows[1])


def test_trimesh_reads_quantised_files(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    head = manip3d.simulate.models.head(faces=2000)
    manip3d.io.write_mesh(head, tmp_path / "head.glb", quantize=True)
    (loaded,) = trimesh.load(tmp_path / "head.glb", process=False).dump()
    assert len(loaded.faces) == head.num_faces
    np.testing.assert_allclose(loaded.bounds, head.bounds, atol=2e-5 * head.diagonal)


def test_quantised_values_need_gltf(mesh: Mesh, tmp_path: Path) -> None:
    with pytest.raises(manip3d.InputError, match="quantised values need"):
        manip3d.io.write_mesh(mesh, tmp_path / "a.ply", quantize=True)


@pytest.mark.parametrize(
    "name",
    [
        "face_multitexture/face.obj",
        "flightgear/BAe-125/BAe-125.obj.xz",
        "littlest_tokyo/LittlestTokyo.obj.xz",
    ],
)
def test_real_models_come_back(realdata: RealData, tmp_path: Path, name: str) -> None:
    original = manip3d.read_mesh(realdata(f"meshes/{name}"))
    original.write(tmp_path / "m.glb")
    again = manip3d.read_mesh(tmp_path / "m.glb")
    expected = in_groups(original)
    np.testing.assert_array_equal(again.face_material, expected.face_material)
    tolerance = 1e-6 * original.diagonal
    np.testing.assert_allclose(corners(again), corners(expected), atol=tolerance, rtol=0)
    np.testing.assert_allclose(
        corner_texcoords(again), corner_texcoords(expected), rtol=1e-6, atol=1e-6
    )
    assert again.num_faces == original.num_faces
    assert [m.name for m in again.materials] == [m.name for m in original.materials]
    for ours, theirs in zip(again.materials, original.materials, strict=True):
        assert ours.base_color == pytest.approx(theirs.base_color)
        assert set(ours.textures) == set(theirs.textures)
    again.write(tmp_path / "again.glb")
    digest = [
        hashlib.sha256((tmp_path / n).read_bytes()).hexdigest() for n in ("m.glb", "again.glb")
    ]
    assert digest[0] == digest[1]
