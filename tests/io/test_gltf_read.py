"""Reading glTF and GLB: every rule of the format on the smallest file that shows it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manip3d
from gltf_files import (
    FACES,
    PNG,
    SQUARE,
    SQUARE_BUFFER,
    Scene,
    data_uri,
    document,
    glb,
    json_of,
    square,
)
from manip3d import InputError, Material, Texture, io
from manip3d.io import read_mesh_bytes, read_report, read_scene


def read(content: bytes) -> manip3d.Mesh:
    return read_mesh_bytes(content)


def report(tmp_path: Path, content: bytes) -> Any:
    path = tmp_path / "scene.glb"
    path.write_bytes(content)
    return read_report(path)


def test_a_square_comes_as_it_is() -> None:
    mesh = read(square())
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    np.testing.assert_array_equal(mesh.faces, FACES)
    assert mesh.texcoords is mesh.normals is mesh.colors is mesh.face_material is None


def test_json_with_a_data_uri(tmp_path: Path) -> None:
    path = tmp_path / "square.gltf"
    path.write_text(
        json.dumps(document(buffers=[{"byteLength": 60, "uri": data_uri(SQUARE_BUFFER)}]))
    )
    mesh = manip3d.read_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    assert mesh.source == str(path)


# --- Nodes ------------------------------------------------------------------------------------

HALF_TURN_Z = [0, 0, 1, 0]
MATRIX_MOVE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]


@pytest.mark.parametrize(
    ("nodes", "corner"),
    [
        ([{"mesh": 0}], [1, 0, 0]),
        ([{"mesh": 0, "translation": [5, 6, 7]}], [6, 6, 7]),
        ([{"mesh": 0, "matrix": MATRIX_MOVE}], [6, 6, 7]),
        ([{"mesh": 0, "scale": [2, 3, 4]}], [2, 0, 0]),
        ([{"mesh": 0, "rotation": HALF_TURN_Z}], [-1, 0, 0]),
        ([{"mesh": 0, "rotation": [0, 0, 5, 0]}], [-1, 0, 0]),  # normalised
        # translation * rotation * scale: scaled first, moved last
        (
            [{"mesh": 0, "translation": [5, 0, 0], "rotation": HALF_TURN_Z, "scale": [2, 1, 1]}],
            [3, 0, 0],
        ),
        ([{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "translation": [1, 0, 0]}], [4, 0, 0]),
        (
            [
                {"children": [1], "translation": [0, 0, 1]},
                {"children": [2], "rotation": HALF_TURN_Z},
                {"mesh": 0, "matrix": MATRIX_MOVE},
            ],
            [-6, -6, 8],
        ),
    ],
)
def test_node_transforms(nodes: list[dict[str, Any]], corner: list[float]) -> None:
    mesh = read(square(nodes=nodes))
    np.testing.assert_allclose(mesh.vertices[1], corner, atol=1e-15)
    np.testing.assert_array_equal(mesh.faces, FACES)


def test_what_exporters_write_beside_the_standard() -> None:
    """Bytes behind the asset, rounded matrices, normalized floats, and null for nothing."""
    plain = read(square())
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0.9999999]
    content = document(nodes=[{"mesh": 0, "matrix": matrix, "name": None}])
    content["accessors"][0]["normalized"] = True
    for file in (
        square() + b"\0\0\0\0",
        square(nodes=[{"mesh": 0, "matrix": matrix, "name": None, "camera": None}]),
        square(accessors=content["accessors"]),
    ):
        mesh = read(file)
        np.testing.assert_array_equal(mesh.vertices, plain.vertices)
        np.testing.assert_array_equal(mesh.faces, plain.faces)


@pytest.mark.parametrize("mirrored", [[-1, 1, 1], [1, 1, -1], [-1, -1, -1]])
def test_a_mirror_turns_the_faces_around(mirrored: list[int]) -> None:
    mesh = read(square(nodes=[{"mesh": 0, "scale": mirrored}]))
    np.testing.assert_array_equal(mesh.faces, FACES[:, [0, 2, 1]])


def test_two_mirrors_do_not() -> None:
    nodes = [{"children": [1], "scale": [-1, 1, 1]}, {"mesh": 0, "scale": [1, -1, 1]}]
    np.testing.assert_array_equal(read(square(nodes=nodes)).faces, FACES)


def test_instances_follow_in_depth_first_order() -> None:
    def node(x: float, *children: int) -> dict[str, Any]:
        extra = {"children": list(children)} if children else {}
        return {"mesh": 0, "translation": [x, 0, 0], **extra}

    nodes = [node(100), node(10, 2, 3), node(1), node(2)]
    mesh = read(square(nodes=nodes, scenes=[{"nodes": [1, 0]}]))
    assert mesh.num_faces == 8
    np.testing.assert_array_equal(mesh.vertices[::4, 0], [10, 11, 12, 100])


@pytest.mark.parametrize("scenes", [[], [{}], [{"nodes": []}, {}]])
def test_without_nodes_all_meshes_are_read_where_they_are(
    scenes: list[dict[str, Any]], tmp_path: Path
) -> None:
    """trimesh reads such files the same way."""
    primitives = [{"attributes": {"POSITION": 0}, "indices": 1}]
    content = document(meshes=[{"primitives": primitives}] * 2, nodes=[], scenes=scenes)
    for empty in [key for key in ("nodes", "scenes") if not content[key]] + ["scene"]:
        del content[empty]
    seen = report(tmp_path, glb(content, SQUARE_BUFFER))
    np.testing.assert_array_equal(seen.mesh.vertices, np.vstack([SQUARE, SQUARE]))
    np.testing.assert_array_equal(seen.mesh.faces, np.vstack([FACES, FACES + 4]))
    warning = "the file has no nodes: all its meshes are read, where their vertices are"
    assert seen.warnings == (warning,)
    scene = read_scene(tmp_path / "scene.glb")
    assert scene.num_faces == 4
    assert scene.fixed == ("", "")
    assert scene.warnings == (warning,)
    scene.write(tmp_path / "again.glb")
    assert report(tmp_path, (tmp_path / "again.glb").read_bytes()).warnings == ()
    assert manip3d.read_mesh(tmp_path / "again.glb").num_faces == 4


def test_the_default_scene_is_read_alone() -> None:
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [9, 0, 0]}]
    scenes = [{"nodes": [0]}, {"nodes": [1]}, {}]
    for scene, start in ((0, [0.0]), (1, [9.0]), (2, [])):
        mesh = read(square(nodes=nodes, scenes=scenes, scene=scene))
        np.testing.assert_array_equal(mesh.vertices[::4, 0], start)
    first = document(nodes=nodes, scenes=scenes)
    del first["scene"]
    assert read(glb(first, SQUARE_BUFFER)).vertices[0, 0] == 0
    del first["scenes"]
    assert read(glb(first, SQUARE_BUFFER)).num_faces == 4


# --- Primitives -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "corners", "faces"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3, 0], [[0, 1, 2], [1, 3, 2], [2, 3, 0]]),  # section 3.7.2.1
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
        (5, [0, 1], np.empty((0, 3))),
    ],
)
@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_modes_and_index_types(mode: int, corners: list[int], faces: Any, dtype: str) -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    scene.primitive({"POSITION": position}, mode=mode, indices=scene.accessor(corners, dtype))
    np.testing.assert_array_equal(read(scene.glb()).faces, faces)


def test_without_indices_the_vertices_are_the_corners() -> None:
    scene = Scene()
    scene.primitive({"POSITION": scene.accessor(SQUARE)}, mode=5)
    np.testing.assert_array_equal(read(scene.glb()).faces, [[0, 1, 2], [1, 3, 2]])


def test_primitives_with_one_position_accessor_share_their_vertices() -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    for face in FACES:
        scene.primitive({"POSITION": position}, indices=scene.accessor(face, "u2"))
    mesh = read(scene.glb())
    assert mesh.num_vertices == 4
    np.testing.assert_array_equal(mesh.faces, FACES)


def test_a_strided_view_with_offsets() -> None:
    rows = np.zeros((4, 5), dtype="<f4")
    rows[:, 1:4] = SQUARE
    scene = Scene()
    scene.json["accessors"].append(
        {
            "bufferView": scene.view(rows.tobytes(), byteStride=20),
            "byteOffset": 4,
            "componentType": 5126,
            "count": 4,
            "type": "VEC3",
        }
    )
    scene.primitive({"POSITION": 0}, indices=scene.accessor(FACES.reshape(-1), "u2"))
    np.testing.assert_array_equal(read(scene.glb()).vertices, SQUARE)


@pytest.mark.parametrize("dense", [False, True])
def test_sparse_accessors(dense: bool) -> None:
    scene = Scene()
    sparse = {
        "count": 2,
        "indices": {"bufferView": scene.view(bytes([1, 3])), "componentType": 5121},
        "values": {"bufferView": scene.view(np.array([[9, 8, 7], [6, 5, 4]], "<f4").tobytes())},
    }
    accessor = {"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse}
    if dense:
        accessor["bufferView"] = scene.view(SQUARE.tobytes())
    scene.json["accessors"].append(accessor)
    scene.primitive({"POSITION": 0}, mode=5)
    expected = SQUARE.copy() if dense else np.zeros((4, 3))
    expected[1], expected[3] = [9, 8, 7], [6, 5, 4]
    np.testing.assert_array_equal(read(scene.glb()).vertices, expected)


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2"])
@pytest.mark.parametrize("normalized", [False, True])
def test_quantized_attributes(dtype: str, normalized: bool) -> None:
    limits = np.iinfo(np.dtype(dtype))
    values = np.array([[0, 0, 0], [limits.max, 0, 1], [limits.min, 5, 0], [1, 2, 3]])
    scene = Scene()
    scene.json["extensionsRequired"] = scene.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    attributes = {
        "POSITION": scene.accessor(values, dtype, normalized=normalized),
        "TEXCOORD_0": scene.accessor(values[:, :2], dtype, normalized=normalized),
    }
    scene.primitive(attributes, mode=5)
    mesh = read(scene.glb())
    expected = np.maximum(values / limits.max, -1) if normalized else values.astype(float)
    np.testing.assert_array_equal(mesh.vertices, expected)
    np.testing.assert_array_equal(mesh.texcoords, [[u, 1 - v] for u, v in expected[:, :2]])


def test_sparse_indices() -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    sparse = {
        "count": 1,
        "indices": {"bufferView": scene.view(bytes([5])), "componentType": 5121},
        "values": {"bufferView": scene.view(bytes([3]))},
    }
    corners = scene.accessor([0, 1, 2, 2, 1, 0], "u1", sparse=sparse)
    scene.primitive({"POSITION": position}, indices=corners)
    np.testing.assert_array_equal(read(scene.glb()).faces, FACES)


def test_v_is_flipped_and_primitives_without_uv_say_so() -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    uv = scene.accessor([[0, 0], [1, 0.25], [0, 0.5], [1, 1]])
    scene.primitive(
        {"POSITION": position, "TEXCOORD_0": uv}, indices=scene.accessor(FACES[0], "u2")
    )
    scene.primitive({"POSITION": position}, indices=scene.accessor(FACES[1], "u2"))
    mesh = read(scene.glb())
    np.testing.assert_array_equal(mesh.texcoords, [[0, 1], [1, 0.75], [0, 0.5], [1, 0]])
    np.testing.assert_array_equal(mesh.face_texcoords, [[0, 1, 2], [-1, -1, -1]])


def test_normals_follow_the_inverse_transpose() -> None:
    scene = Scene()
    normal = scene.accessor([[0, 1, 0], [0.6, 0.8, 0], [0, 0, 1], [0, 0, -1]])
    scene.primitive({"POSITION": scene.accessor(SQUARE), "NORMAL": normal}, mode=5)
    scene.json["nodes"] = [{"mesh": 0, "scale": [2, 1, -1]}]
    mesh = read(scene.glb())
    slanted = np.array([0.3, 0.8, 0]) / np.hypot(0.3, 0.8)
    np.testing.assert_allclose(mesh.normals, [[0, 1, 0], slanted, [0, 0, -1], [0, 0, 1]], atol=1e-7)
    np.testing.assert_array_equal(mesh.face_normals, mesh.faces)


def test_colors_are_srgb_and_white_where_a_primitive_has_none(tmp_path: Path) -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    linear = np.array([[0, 0, 0], [1, 1, 1], [0.5, 0.2158605, 0.001], [2, -1, 0.0031308]])
    color = scene.accessor(linear)
    scene.primitive({"POSITION": position, "COLOR_0": color}, mode=5)
    mesh = read(scene.glb())
    np.testing.assert_array_equal(
        mesh.colors, [[0, 0, 0], [255, 255, 255], [188, 128, 3], [255, 0, 10]]
    )
    scene.primitive({"POSITION": position}, mode=5)
    seen = report(tmp_path, scene.glb())
    assert seen.mesh.colors is not None
    np.testing.assert_array_equal(seen.mesh.colors[:4], mesh.colors)
    np.testing.assert_array_equal(seen.mesh.colors[4:], np.full((4, 3), 255))
    assert seen.warnings == ()


@pytest.mark.parametrize("node", [{}, {"rotation": [0, 0, 1, 0]}])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_normals_and_texture_coordinates_that_are_not_finite_are_left_out(
    node: dict[str, Any], bad: float, tmp_path: Path
) -> None:
    """The whole file was refused. The surface does not depend on them."""
    scene = Scene()
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    normals[3, 1] = bad
    texcoords = np.array([[0, 0], [1, 0], [0, 1], [bad, 1]])
    attributes = {"POSITION": SQUARE, "NORMAL": normals, "TEXCOORD_0": texcoords}
    views = {name: scene.accessor(values) for name, values in attributes.items()}
    scene.primitive(views, mode=5)
    scene.json["nodes"] = [{"mesh": 0, **node}]
    seen = report(tmp_path, scene.glb())
    (tmp_path / "scene.glb").write_bytes(scene.glb())
    scene_read = read_scene(tmp_path / "scene.glb")
    (of_scene,) = scene_read.meshes
    for mesh in (seen.mesh, of_scene):
        for table, faces in (
            (mesh.normals, mesh.face_normals),
            (mesh.texcoords, mesh.face_texcoords),
        ):
            assert table is not None
            assert faces is not None
            assert np.isfinite(table).all()
            assert (faces >= 0).all(axis=1).tolist() == [True, False]
    for warnings in (seen.warnings, scene_read.warnings):
        for what in ("normals", "texture coordinates"):
            assert f"{what} that are no finite numbers are left out (faces: 1)" in warnings


def placed_square(*transforms: dict[str, Any]) -> bytes:
    """One square for each transform, all on the same coordinates: (0, 0) to (1, 1)."""
    scene = Scene()
    position, texcoord = scene.accessor(SQUARE), scene.accessor([[0, 0], [1, 0], [0, 1], [1, 1]])
    image = "data:image/png;base64,aGFsbG8="
    scene.json["images"], scene.json["textures"] = [{"uri": image}], [{"source": 0}]
    scene.json["materials"] = [
        {
            "pbrMetallicRoughness": {
                "baseColorTexture": {
                    "index": 0,
                    "extensions": {"KHR_texture_transform": transform},
                }
            }
        }
        for transform in transforms
    ]
    scene.json["extensionsRequired"] = scene.json["extensionsUsed"] = ["KHR_texture_transform"]
    for material in range(len(transforms)):
        scene.primitive({"POSITION": position, "TEXCOORD_0": texcoord}, mode=5, material=material)
    return scene.glb()


def test_texture_transforms_are_in_the_texture_coordinates(tmp_path: Path) -> None:
    """KHR_texture_transform: scale, then counter-clockwise rotation, then offset; v points down."""
    seen = report(
        tmp_path,
        placed_square(
            {"offset": [0.5, 0.25], "scale": [2, 3]},
            {"rotation": np.pi / 2, "scale": [2, 3], "offset": [0, 1]},
            {},
        ),
    )
    assert seen.warnings == ()
    texcoords = seen.mesh.texcoords
    assert texcoords is not None
    down = np.column_stack([texcoords[:, 0], 1 - texcoords[:, 1]])
    np.testing.assert_allclose(down[:4], [[0.5, 0.25], [2.5, 0.25], [0.5, 3.25], [2.5, 3.25]])
    # (1, 0) of the image turns up, to smaller v; (0, 1) to the right.
    np.testing.assert_allclose(down[4:8], [[0, 1], [0, -1], [3, 1], [3, -1]], atol=1e-12)
    np.testing.assert_allclose(down[8:], [[0, 0], [1, 0], [0, 1], [1, 1]])


@pytest.mark.parametrize(
    ("sampler", "wrap", "smooth"),
    [
        ({}, ("repeat", "repeat"), True),
        (
            {"wrapS": 10497, "wrapT": 10497, "magFilter": 9729, "minFilter": 9984},
            ("repeat", "repeat"),
            True,
        ),
        ({"wrapS": 33071}, ("clamp", "repeat"), True),
        ({"wrapT": 33648}, ("repeat", "mirror"), True),
        ({"magFilter": 9728, "wrapS": 33648, "wrapT": 33071}, ("mirror", "clamp"), False),
    ],
)
def test_samplers_of_textures_survive(
    tmp_path: Path, sampler: dict[str, int], wrap: tuple[str, str], smooth: bool
) -> None:
    scene = Scene()
    position, texcoord = scene.accessor(SQUARE), scene.accessor([[0, 0], [1, 0], [0, 1], [1, 1]])
    scene.json["images"] = [{"uri": data_uri(PNG, "image/png")}]
    scene.json["samplers"] = [sampler]
    scene.json["textures"] = [{"source": 0, "sampler": 0}]
    scene.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    scene.primitive({"POSITION": position, "TEXCOORD_0": texcoord}, mode=5, material=0)
    seen = report(tmp_path, scene.glb())
    assert list(seen.mesh.materials[0].textures) == ["base_color"]
    assert seen.warnings == ()
    seen.mesh.write(tmp_path / "again.glb")
    again = manip3d.read_mesh(tmp_path / "again.glb")
    for mesh in (seen.mesh, again):
        texture = mesh.materials[0].textures["base_color"]
        assert (texture.wrap, texture.smooth) == (wrap, smooth)


def test_one_image_with_two_samplers_is_stored_once(tmp_path: Path) -> None:
    vertices, faces = SQUARE, FACES
    textures = [Texture(data=PNG), Texture(data=PNG, wrap=("clamp", "clamp")), Texture(data=PNG)]
    materials = [Material(str(i), textures={"base_color": own}) for i, own in enumerate(textures)]
    mesh = manip3d.Mesh(
        vertices,
        [faces[0], faces[1], faces[0]],
        texcoords=vertices[:, :2],
        face_texcoords=[faces[0], faces[1], faces[0]],
        face_material=[0, 1, 2],
        materials=materials,
    )
    mesh.write(tmp_path / "a.glb")
    found = json_of(tmp_path / "a.glb")
    assert len(found["images"]) == 1
    assert found["samplers"] == [{"wrapS": 33071, "wrapT": 33071}]
    assert found["textures"] == [{"source": 0}, {"source": 0, "sampler": 0}]
    named = [m["pbrMetallicRoughness"]["baseColorTexture"]["index"] for m in found["materials"]]
    assert named == [0, 1, 0]


@pytest.mark.parametrize(
    "wrap", ["clamp", ("clamp",), ("clamp", "clamp", "clamp"), ("clamp", "border"), None]
)
def test_a_wrong_wrap_of_a_texture_is_refused(wrap: Any) -> None:
    with pytest.raises(InputError, match="wrap: expected two of repeat, mirror, clamp, got"):
        Texture("a.png", wrap=wrap)


@pytest.mark.parametrize("is_required", [False, True])
def test_the_centre_of_a_tile_is_not_lost_silently(tmp_path: Path, is_required: bool) -> None:
    """A tile stood at the centre of the earth, and one that requires the extension was refused."""
    center = [4156000.5, 671000.25, 4774000.125]
    tile = document(extensionsUsed=["CESIUM_RTC"], extensions={"CESIUM_RTC": {"center": center}})
    if is_required:
        tile["extensionsRequired"] = ["CESIUM_RTC"]
    (tmp_path / "tile.glb").write_bytes(glb(tile, SQUARE_BUFFER))
    seen = io.read_report(tmp_path / "tile.glb")
    (warning,) = seen.warnings
    assert "CESIUM_RTC: coordinates are relative to the point (4156000.5" in warning
    np.testing.assert_array_equal(seen.mesh.vertices, SQUARE)
    scene = io.read_scene(tmp_path / "tile.glb")
    assert scene.warnings == ()
    scene.write(tmp_path / "again.glb")
    again = json_of(tmp_path / "again.glb")
    for key in ("extensions", "extensionsUsed", "extensionsRequired"):
        assert again.get(key) == tile.get(key)


def test_a_texture_placed_otherwise_than_the_base_colour_is_left_out(tmp_path: Path) -> None:
    """A mesh has one place for texture coordinates: the base colour's."""
    scene = Scene()
    position, texcoord = scene.accessor(SQUARE), scene.accessor([[0, 0], [1, 0], [0, 1], [1, 1]])
    image = "data:image/png;base64,aGFsbG8="
    scene.json["images"], scene.json["textures"] = [{"uri": image}], [{"source": 0}]
    doubled, tripled = (
        {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [times, times]}}}
        for times in (2, 3)
    )
    scene.json["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorTexture": doubled},
            "normalTexture": tripled,
            "occlusionTexture": doubled,
        }
    ]
    scene.json["extensionsUsed"] = ["KHR_texture_transform"]
    scene.primitive({"POSITION": position, "TEXCOORD_0": texcoord}, mode=5, material=0)
    seen = report(tmp_path, scene.glb())
    assert sorted(seen.mesh.materials[0].textures) == ["base_color", "occlusion"]
    assert seen.mesh.texcoords is not None
    assert seen.mesh.texcoords[:, 0].max() == 2.0
    (warning,) = seen.warnings
    assert "placed otherwise than the first of their material are left out" in warning


def test_the_coordinates_named_by_a_texture_transform_replace_the_textures_own(
    tmp_path: Path,
) -> None:
    """``texCoord`` stands in a texture and in its KHR_texture_transform, where it goes before."""
    scene = Scene()
    position, texcoord = scene.accessor(SQUARE), scene.accessor([[0, 0], [1, 0], [0, 1], [1, 1]])
    image = "data:image/png;base64,aGFsbG8="
    scene.json["images"], scene.json["textures"] = [{"uri": image}], [{"source": 0}]

    def on(own: int, placed: dict[str, Any]) -> dict[str, Any]:
        return {"index": 0, "texCoord": own, "extensions": {"KHR_texture_transform": placed}}

    scene.json["materials"] = [
        {
            "pbrMetallicRoughness": {
                "baseColorTexture": on(1, {"texCoord": 0, "scale": [2, 2]}),
                "metallicRoughnessTexture": on(0, {"scale": [2, 2]}),
            },
            "normalTexture": on(0, {"texCoord": 1, "scale": [2, 2]}),
            "occlusionTexture": on(1, {"scale": [2, 2]}),
        }
    ]
    scene.json["extensionsUsed"] = ["KHR_texture_transform"]
    attributes = {"POSITION": position, "TEXCOORD_0": texcoord, "TEXCOORD_1": texcoord}
    scene.primitive(attributes, mode=5, material=0)
    seen = report(tmp_path, scene.glb())
    assert sorted(seen.mesh.materials[0].textures) == ["base_color", "metallic_roughness"]
    assert seen.mesh.texcoords is not None
    assert seen.mesh.texcoords[:, 0].max() == 2.0
    others = "textures on other texture coordinates than the first of their material are left out"
    assert others in seen.warnings


def test_a_material_whose_textures_lie_on_another_set_takes_its_coordinates(tmp_path: Path) -> None:
    scene = Scene()
    position, first = scene.accessor(SQUARE), scene.accessor([[0, 0]] * 4)
    second = scene.accessor([[0, 0], [1, 0], [0, 1], [1, 1]])
    image = "data:image/png;base64,aGFsbG8="
    scene.json["images"], scene.json["textures"] = [{"uri": image}], [{"source": 0}]
    scene.json["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}},
            "normalTexture": {"index": 0},
        }
    ]
    attributes = {"POSITION": position, "TEXCOORD_0": first, "TEXCOORD_1": second}
    scene.primitive(attributes, mode=5, material=0)
    seen = report(tmp_path, scene.glb())
    assert sorted(seen.mesh.materials[0].textures) == ["base_color"]  # the others lie elsewhere
    assert seen.mesh.texcoords is not None
    assert np.ptp(seen.mesh.texcoords, axis=0).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    "name",
    [
        "KHR_lights_punctual",
        "KHR_texture_basisu",
        "KHR_techniques_webgl",
        "EXT_texture_webp",
        "KHR_materials_ior",
    ],
)
def test_a_required_extension_of_looks_costs_a_warning(tmp_path: Path, name: str) -> None:
    seen = report(tmp_path, square(extensionsRequired=[name], extensionsUsed=[name]))
    assert seen.mesh.num_faces == 2
    assert seen.warnings == (f"extension {name} is left out",)


def test_glTF_1_is_named(tmp_path: Path) -> None:
    with pytest.raises(manip3d.FormatError, match=r"expected glTF 2\.x, got version 1\.0"):
        read(square(asset={"version": "1.0"}))


# --- Materials --------------------------------------------------------------------------------


def test_materials() -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    scene.json["materials"] = [
        {},
        {
            "name": "glass",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.25, 0.5, 0.75, 0.125],
                "metallicFactor": 0.5,
                "roughnessFactor": 0.25,
                "baseColorTexture": {"index": 0},
                "metallicRoughnessTexture": {"index": 1},
            },
            "normalTexture": {"index": 2},
            "occlusionTexture": {"index": 2},
            "emissiveTexture": {"index": 2},
            "emissiveFactor": [1, 1, 1],
            "alphaMode": "MASK",
            "alphaCutoff": 0.75,
            "doubleSided": True,
        },
    ]
    scene.json["textures"] = [{"source": i} for i in range(3)]
    scene.json["images"] = [
        {"uri": data_uri(PNG, "image/png")},
        {"bufferView": scene.view(PNG), "mimeType": "image/png"},
        {"uri": "skins/bark%20%C3%A9.jpg"},
    ]
    scene.primitive({"POSITION": position}, mode=5, material=1)
    scene.primitive({"POSITION": position}, mode=5)
    mesh = read(scene.glb())
    np.testing.assert_array_equal(mesh.face_material, [1, 1, -1, -1])
    plain, glass = mesh.materials
    assert plain == manip3d.Material(metallic=1.0, double_sided=False)  # glTF's defaults
    external = manip3d.Texture(path="skins/bark é.jpg")
    assert glass == manip3d.Material(
        name="glass",
        base_color=(0.25, 0.5, 0.75, 0.125),
        metallic=0.5,
        roughness=0.25,
        alpha_mode="mask",
        alpha_cutoff=0.75,
        double_sided=True,
        textures={
            "base_color": manip3d.Texture(data=PNG),
            "metallic_roughness": manip3d.Texture(data=PNG),
            "normal": external,
            "occlusion": external,
            "emissive": external,
        },
        emissive=(1.0, 1.0, 1.0),
    )


@pytest.mark.parametrize(
    ("core", "old", "expected"),
    [
        (None, {"diffuseFactor": [0.25, 0.5, 0.75, 1]}, ((0.25, 0.5, 0.75, 1.0), None)),
        ({}, {"diffuseFactor": [0.25, 0.5, 0.75, 1]}, ((0.25, 0.5, 0.75, 1.0), None)),
        ({"baseColorFactor": [1, 0, 0, 1]}, {"diffuseFactor": [0, 1, 0, 1]}, ((1, 0, 0, 1), None)),
        ({"baseColorFactor": [1, 0, 0, 1]}, {"diffuseTexture": {"index": 1}}, ((1, 1, 1, 1), 1)),
        ({"baseColorTexture": {"index": 0}}, {"diffuseTexture": {"index": 1}}, ((1, 1, 1, 1), 0)),
        ({"baseColorTexture": {"index": 0}}, {"diffuseFactor": [0, 1, 0, 1]}, ((1, 1, 1, 1), 0)),
    ],
)
def test_diffuse_colours_stand_for_base_colours_that_the_core_lacks(
    tmp_path: Path, core: dict[str, Any] | None, old: dict[str, Any], expected: Any
) -> None:
    scene = Scene()
    name = "KHR_materials_pbrSpecularGlossiness"
    material: dict[str, Any] = {"extensions": {name: old | {"glossinessFactor": 0.75}}}
    if core is not None:
        material["pbrMetallicRoughness"] = core
    scene.json |= {
        "materials": [material],
        "textures": [{"source": i} for i in range(2)],
        "images": [{"uri": f"{i}.png"} for i in range(2)],
        "extensionsUsed": [name],
    }
    scene.primitive({"POSITION": scene.accessor(SQUARE)}, mode=5, material=0)
    seen = report(tmp_path, scene.glb())
    (read_material,) = seen.mesh.materials
    color, image = expected
    assert read_material.base_color == color
    named = None if image is None else manip3d.Texture(path=f"{image}.png")
    assert read_material.textures.get("base_color") == named
    from_core = core is not None and material["pbrMetallicRoughness"] != {} and image != 1
    assert (read_material.metallic, read_material.roughness) == ((1, 1) if from_core else (0, 0.25))
    assert f"of extension {name} only diffuse colors and glossiness are read" in seen.warnings


def test_a_diffuse_texture_is_placed_as_a_base_colour_is(tmp_path: Path) -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    old = {"diffuseTexture": {"index": 0, "texCoord": 1}}
    scene.json |= {
        "materials": [{"extensions": {"KHR_materials_pbrSpecularGlossiness": old}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "0.png"}],
    }
    second = scene.accessor(np.full((4, 2), 0.25, np.float32))
    attributes = {"POSITION": position, "TEXCOORD_1": second}
    scene.primitive(attributes, mode=5, material=0)
    mesh = read(scene.glb())
    assert mesh.materials[0].textures == {"base_color": manip3d.Texture(path="0.png")}
    assert mesh.texcoords is not None
    np.testing.assert_array_equal(mesh.texcoords, [[0.25, 0.75]] * 4)


# --- Files beside it --------------------------------------------------------------------------


def external(tmp_path: Path, uri: str) -> Path:
    folder = tmp_path / "folder"
    folder.mkdir(exist_ok=True)
    path = folder / "square.gltf"
    path.write_text(json.dumps(document(buffers=[{"byteLength": 60, "uri": uri}])))
    return path


def test_an_external_buffer(tmp_path: Path) -> None:
    path = external(tmp_path, "a%20b.bin")
    (path.parent / "a b.bin").write_bytes(SQUARE_BUFFER + b"more than byteLength")
    np.testing.assert_array_equal(manip3d.read_mesh(path).vertices, SQUARE)
    (path.parent / "a b.bin").write_bytes(SQUARE_BUFFER[:-1])
    with pytest.raises(manip3d.FormatError, match="says 60 bytes, the buffer has 59"):
        manip3d.read_mesh(path)
    (path.parent / "a b.bin").unlink()
    with pytest.raises(FileNotFoundError):
        manip3d.read_mesh(path)


@pytest.mark.parametrize("way", ["../secret.bin", "absolute", "link.bin", "%2e%2e/secret.bin"])
def test_buffers_outside_of_the_folder_are_refused(tmp_path: Path, way: str) -> None:
    secret = tmp_path / "secret.bin"
    secret.write_bytes(SQUARE_BUFFER)
    path = external(tmp_path, str(secret) if way == "absolute" else way)
    (path.parent / "link.bin").symlink_to(secret)
    with pytest.raises(manip3d.FormatError, match="outside"):
        manip3d.read_mesh(path)
    assert manip3d.read_mesh(path, allow_outside=True).num_faces == 2


def test_no_file_no_folder() -> None:
    with pytest.raises(manip3d.FormatError, match="no folder"):
        read(json.dumps(document(buffers=[{"byteLength": 60, "uri": "a.bin"}])).encode())


def test_remote_files_are_not_fetched(tmp_path: Path) -> None:
    with pytest.raises(manip3d.FormatError, match='"https:"'):
        manip3d.read_mesh(external(tmp_path, "https://example.org/a.bin"))


@pytest.mark.parametrize("suffix", [".xz", ".gz"])
def test_compressed(tmp_path: Path, suffix: str) -> None:
    import gzip
    import lzma

    path = tmp_path / f"square.glb{suffix}"
    path.write_bytes({".xz": lzma.compress, ".gz": gzip.compress}[suffix](square()))
    np.testing.assert_array_equal(manip3d.read_mesh(path).vertices, SQUARE)


def test_a_scene_in_xz_that_asks_for_much_memory_is_not_unpacked() -> None:
    import lzma
    import zlib

    from manip3d.io._scenes import scene_of_bytes

    def with_dictionary(code: int) -> bytes:
        packed = bytearray(lzma.compress(square(), check=lzma.CHECK_NONE))
        header = packed[12 : 12 + 4 * (packed[12] + 1)]  # of the first block
        header[header.index(b"\x21\x01") + 2] = code
        header[-4:] = zlib.crc32(header[:-4]).to_bytes(4, "little")
        packed[12 : 12 + len(header)] = header
        return bytes(packed)

    scene = scene_of_bytes(with_dictionary(22), "-")  # 8 MiB
    assert scene is not None
    assert scene.num_faces == 2
    assert scene_of_bytes(with_dictionary(30), "-") is None  # 128 MiB


# --- What is left out, what is refused ----------------------------------------------------------


EMISSIVE_STRENGTH = {"KHR_materials_emissive_strength": {"emissiveStrength": 4}}


@pytest.mark.parametrize(
    ("emissive", "light", "has_texture"),
    [
        ({"emissiveFactor": [1, 0, 0]}, (1, 0, 0), False),
        ({"emissiveFactor": [0, 0, 0], "emissiveTexture": {"index": 0}}, (0, 0, 0), False),
        ({"emissiveTexture": {"index": 0}}, (0, 0, 0), False),
        ({"emissiveFactor": [1, 0.5, 1], "emissiveTexture": {"index": 0}}, (1, 0.5, 1), True),
        # a texture that is left out: the factor is not that of the surface
        (
            {
                "normalTexture": {"index": 0},
                "emissiveFactor": [1, 1, 1],
                "emissiveTexture": {"index": 0, "texCoord": 1},
            },
            (0, 0, 0),
            False,
        ),
        ({"emissiveFactor": [1, 0.5, 0], "extensions": EMISSIVE_STRENGTH}, (4, 2, 0), False),
        # no light, and no texture, beside which 0 would count as 1
        (
            {
                "emissiveFactor": [1, 1, 1],
                "emissiveTexture": {"index": 0},
                "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 0}},
            },
            (0, 0, 0),
            False,
        ),
        ({"emissiveFactor": [-1, 0.5, -0.5]}, (0, 0.5, 0), False),
    ],
)
def test_light_that_a_surface_sends_out(
    tmp_path: Path, emissive: dict[str, Any], light: tuple[float, ...], has_texture: bool
) -> None:
    primitive = {**document()["meshes"][0]["primitives"][0], "material": 0}
    seen = report(
        tmp_path,
        square(
            meshes=[{"primitives": [primitive]}],
            materials=[emissive],
            textures=[{"source": 0}],
            images=[{"uri": data_uri(PNG, "image/png")}],
            extensionsUsed=list(emissive.get("extensions", {})),
        ),
    )
    (material,) = seen.mesh.materials
    assert material.emissive == light
    assert ("emissive" in material.textures) == has_texture
    assert not any("emissive" in text for text in seen.warnings)


@pytest.mark.parametrize(
    ("changes", "warning"),
    [
        ({"animations": [{}]}, "animations are left out"),
        ({"skins": [{}]}, "skins are left out: meshes have the pose of their joints"),
        ({"extensionsUsed": ["KHR_lights_punctual"]}, "extension KHR_lights_punctual is left out"),
        (
            {
                "extensionsUsed": ["KHR_materials_unlit"],
                "extensionsRequired": ["KHR_materials_unlit"],
            },
            "extension KHR_materials_unlit is left out",
        ),
    ],
)
def test_left_out_with_a_warning(tmp_path: Path, changes: dict[str, Any], warning: str) -> None:
    seen = report(tmp_path, square(**changes))
    assert seen.warnings == (warning,)
    assert seen.mesh.num_faces == 2


def test_tangents_are_left_out_with_a_warning(tmp_path: Path) -> None:
    scene = Scene()
    tangent = scene.accessor(np.tile(np.float32([1, 0, 0, 1]), (len(SQUARE), 1)))
    for _ in range(2):
        scene.primitive({"POSITION": scene.accessor(SQUARE), "TANGENT": tangent}, mode=5)
    seen = report(tmp_path, scene.glb())
    assert seen.mesh.num_faces == 4
    lost = "tangents are left out: viewers compute them from the texture coordinates"
    assert seen.warnings == (lost,)


def test_points_lines_and_morph_targets_are_left_out(tmp_path: Path) -> None:
    scene = Scene()
    position = scene.accessor(SQUARE)
    for mode in range(4):
        scene.primitive({"POSITION": position}, mode=mode)
    scene.primitive({"POSITION": position}, mode=5, targets=[{"POSITION": position}])
    seen = report(tmp_path, scene.glb())
    assert seen.mesh.num_faces == 2
    assert seen.warnings == ("points and lines are left out", "morph targets are left out")


UP = np.tile(np.float32([0, 0, 1]), (len(SQUARE), 1))


def morphed(
    mesh: dict[str, Any], node: dict[str, Any], target: dict[str, Any] | None = None
) -> bytes:
    """The square, with targets that move it by 1 along z and along x, and turn its normals to x."""
    scene = Scene()
    attributes = {"POSITION": scene.accessor(SQUARE), "NORMAL": scene.accessor(UP)}
    side = scene.accessor(np.roll(UP, 1, axis=1))
    targets = [
        {"POSITION": scene.accessor(UP), **(target or {})},
        {"POSITION": side, "NORMAL": scene.accessor(np.roll(UP, 1, axis=1) - UP)},
    ]
    scene.primitive(attributes, mode=5, targets=targets)
    scene.json["meshes"][0].update(mesh)
    scene.json["nodes"][0].update(node)
    return scene.glb()


APPLIED = "morph targets are left out; meshes have the shape of their default weights"


@pytest.mark.parametrize(
    ("mesh", "node", "move", "normal", "warnings"),
    [
        ({}, {}, [0, 0, 0], [0, 0, 1], ("morph targets are left out",)),
        ({"weights": [0, 0]}, {}, [0, 0, 0], [0, 0, 1], ("morph targets are left out",)),
        ({"weights": [2, 0]}, {}, [0, 0, 2], [0, 0, 1], (APPLIED,)),
        ({"weights": [1, 0.5]}, {}, [0.5, 0, 1], [0.5**0.5, 0, 0.5**0.5], (APPLIED,)),
        ({"weights": [5, 5]}, {"weights": [-1, 0]}, [0, 0, -1], [0, 0, 1], (APPLIED,)),
        # the weights move the mesh before its node does
        ({"weights": [0, 1]}, {"scale": [1, 1, 3]}, [1, 0, 0], [1, 0, 0], (APPLIED,)),
        (
            {"weights": [3]},
            {},
            [0, 0, 3],
            [0, 0, 1],
            (
                APPLIED,
                "/meshes/0/weights: expected 2 weights (the morph targets), got 1; those without "
                "a partner are left out",
            ),
        ),
    ],
)
def test_morph_targets_are_applied_with_their_default_weights(
    tmp_path: Path,
    mesh: dict[str, Any],
    node: dict[str, Any],
    move: list[float],
    normal: list[float],
    warnings: tuple[str, ...],
) -> None:
    seen = report(tmp_path, morphed(mesh, node))
    np.testing.assert_allclose(seen.mesh.vertices, SQUARE + np.float64(move), atol=1e-15)
    corners = seen.mesh.normals[seen.mesh.face_normals].reshape(-1, 3)
    np.testing.assert_allclose(corners, np.tile(normal, (6, 1)), atol=1e-15)
    assert seen.warnings == warnings


def test_primitives_that_share_vertices_may_be_morphed_apart(tmp_path: Path) -> None:
    scene = Scene()
    position, added = scene.accessor(SQUARE), scene.accessor(UP)
    for target in ({"POSITION": added}, {}, {"POSITION": added}):
        scene.primitive({"POSITION": position}, mode=5, targets=[target])
    scene.json["meshes"][0]["weights"] = [1]
    mesh = report(tmp_path, scene.glb()).mesh
    assert mesh.num_vertices == 8  # the first and the third have the same shape
    heights = mesh.vertices[mesh.faces][:, :, 2]
    np.testing.assert_array_equal(heights, np.repeat([[1], [1], [0], [0], [1], [1]], 3, axis=1))


def test_colours_of_morph_targets_in_use_are_left_out_with_a_warning(tmp_path: Path) -> None:
    seen = report(tmp_path, morphed({"weights": [1, 0]}, {}, {"COLOR_0": 0}))
    assert seen.warnings == (APPLIED, "COLOR_0 of morph targets is left out")


def test_a_morph_target_has_as_many_elements_as_its_primitive(tmp_path: Path) -> None:
    scene = Scene()
    target = {"POSITION": scene.accessor(SQUARE[:3])}
    scene.primitive({"POSITION": scene.accessor(SQUARE)}, mode=5, targets=[target])
    assert report(tmp_path, scene.glb()).mesh.num_faces == 2
    scene.json["meshes"][0]["weights"] = [1]
    with pytest.raises(manip3d.FormatError, match="has 3 elements, POSITION of /meshes/0/primi"):
        read(scene.glb())


def test_a_mesh_of_a_scene_keeps_its_morph_targets_apart_from_its_shape(tmp_path: Path) -> None:
    path = tmp_path / "scene.glb"
    path.write_bytes(morphed({"weights": [2, 0]}, {}))
    scene = read_scene(path)
    np.testing.assert_array_equal(scene.meshes[0].vertices[:, 2], [0, 0, 0, 0])
    scene.write(tmp_path / "again.glb")  # the weights are not applied twice
    again = report(tmp_path, (tmp_path / "again.glb").read_bytes()).mesh
    np.testing.assert_array_equal(again.vertices[:, 2], [2, 2, 2, 2])


def test_a_mesh_that_cannot_change_has_the_shape_of_its_default_weights(tmp_path: Path) -> None:
    path = tmp_path / "scene.glb"
    path.write_bytes(morphed({"weights": [2, 0]}, {}, {"TEXCOORD_0": 0}))
    scene = read_scene(path)
    assert scene.fixed == ("its morph targets change TEXCOORD_0",)
    assert scene.deformations == (None,)
    np.testing.assert_array_equal(scene.meshes[0].vertices[:, 2], [2, 2, 2, 2])
    scene.write(tmp_path / "again.glb")
    again = report(tmp_path, (tmp_path / "again.glb").read_bytes()).mesh
    np.testing.assert_array_equal(again.vertices[:, 2], [2, 2, 2, 2])


@pytest.mark.parametrize(
    "name",
    [
        "KHR_animation_of_nothing",
        "KHR_gaussian_splatting",
    ],
)
def test_a_required_extension_is_named(name: str) -> None:
    with pytest.raises(manip3d.FormatError, match=name):
        read(square(extensionsRequired=[name]))
