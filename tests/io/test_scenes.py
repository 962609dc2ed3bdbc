"""Scenes: what is read of a glTF file's nodes, and what is written again."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gltf_files import PNG, SQUARE_BUFFER, data_uri, document, glb, json_of
from manip3d import FormatError, InputError, Mesh, io, read_mesh

# root (moved up)      the square is shown by `left`, `right` (half as large) and `mirrored`
#   left  right  mirrored        `camera` shows nothing
NODES: list[dict[str, Any]] = [
    {"name": "root", "translation": [0, 0, 5], "children": [1, 2, 3, 4], "extras": {"id": 7}},
    {"name": "left", "mesh": 0, "translation": [-2, 0, 0]},
    {"name": "right", "mesh": 0, "translation": [2, 0, 0], "scale": [0.5, 0.5, 0.5]},
    {
        "name": "mirrored",
        "mesh": 0,
        "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 3, 0, 1],
    },
    {"name": "camera", "camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
]


def scene_document(**changes: Any) -> dict[str, Any]:
    """A hierarchy with three instances of the square, a camera, a light, a texture."""
    base = document(
        nodes=copy.deepcopy(NODES),
        cameras=[{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
        extensionsUsed=["KHR_lights_punctual", "KHR_texture_transform"],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "point", "name": "lamp"}]}},
        images=[{"uri": data_uri(PNG, "image/png"), "name": "skin"}],
        samplers=[{"wrapS": 33071}],
        textures=[{"source": 0, "sampler": 0}],
        materials=[
            {
                "name": "paint",
                "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]},
                "extras": {"keep": True},
            }
        ],
        asset={"version": "2.0", "copyright": "somebody"},
    )
    base["meshes"][0] |= {"name": "square", "extras": {"part": 3}}
    base["meshes"][0]["primitives"][0]["material"] = 0
    return {**base, **changes}


def written(path: Path, **changes: Any) -> Path:
    path.write_bytes(glb(scene_document(**changes), SQUARE_BUFFER))
    return path


def test_faces_below_hidden_nodes_are_counted(tmp_path: Path) -> None:
    def hidden(*indices: int, visible: object = False) -> int:
        nodes = scene_document()["nodes"]
        for i in indices:
            nodes[i]["extensions"] = {"KHR_node_visibility": {"visible": visible}}
        path = written(tmp_path / "a.glb", nodes=nodes, extensionsUsed=["KHR_node_visibility"])
        return io.read_scene(path).num_hidden_faces

    assert [hidden(), hidden(1), hidden(1, 2), hidden(4)] == [0, 2, 4, 0]
    assert hidden(0) == 6  # the root hides its children
    assert hidden(0, visible=True) == 0


def test_each_mesh_is_read_once_and_nodes_say_where_it_is(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "scene.glb"))
    assert [node.name for node in scene.nodes] == ["root", "left", "right", "mirrored", "camera"]
    assert [node.parent for node in scene.nodes] == [None, 0, 0, 0, 0]
    assert [node.mesh for node in scene.nodes] == [None, 0, 0, 0, None]
    assert len(scene.meshes) == 1
    assert scene.names == ("square",)
    assert scene.fixed == ("",)
    assert (scene.num_instances, scene.num_faces, scene.num_stored_faces) == (3, 6, 2)
    np.testing.assert_array_equal(scene.meshes[0].vertices[3], [1, 1, 0])
    world = scene.world_transforms()
    np.testing.assert_array_equal(world[2] @ [1, 1, 0, 1], [2.5, 0.5, 5, 1])
    np.testing.assert_array_equal(world[3] @ [1, 1, 0, 1], [-1, 4, 5, 1])
    assert scene.warnings == ()


def test_a_mesh_has_no_colours_of_the_mesh_before_it(tmp_path: Path) -> None:
    base = scene_document()
    (square,) = base["meshes"]
    colored = copy.deepcopy(square)
    colored["primitives"][0]["attributes"]["COLOR_0"] = 0  # any numbers will do
    nodes = [{"mesh": 0}, {"mesh": 1}, {"mesh": 0}]
    source = written(
        tmp_path / "scene.glb", meshes=[colored, square], nodes=nodes, scenes=[{"nodes": [0, 1, 2]}]
    )
    scene = io.read_scene(source)
    assert [mesh.colors is not None for mesh in scene.meshes] == [True, False]
    scene.write(tmp_path / "out.glb")
    found = [mesh["primitives"][0] for mesh in json_of(tmp_path / "out.glb")["meshes"]]
    assert ["COLOR_0" in primitive["attributes"] for primitive in found] == [True, False]


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_scene_is_written_as_it_was_read(suffix: str, tmp_path: Path) -> None:
    source = written(tmp_path / "scene.glb")
    copied = tmp_path / f"copy{suffix}"
    io.read_scene(source).write(copied)
    found = json_of(copied)
    for member in ("nodes", "scenes", "scene", "cameras", "extensions", "samplers", "textures"):
        assert found[member] == scene_document()[member], member
    assert found["materials"] == scene_document()["materials"]
    assert found["asset"]["copyright"] == "somebody"
    assert found["meshes"][0]["name"] == "square"
    assert found["meshes"][0]["extras"] == {"part": 3}
    assert found["images"][0]["name"] == "skin"
    before, after = read_mesh(source), read_mesh(copied)
    np.testing.assert_array_equal(after.vertices[after.faces], before.vertices[before.faces])
    if suffix == ".glb":  # what was read is written the same again
        io.read_scene(copied).write(tmp_path / "again.glb")
        assert json_of(tmp_path / "again.glb") == found


def test_other_triangles_take_the_place_of_a_mesh_in_all_its_nodes(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "scene.glb"))
    triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], face_material=[0])
    changed = scene.with_meshes({0: triangle})
    assert (changed.num_faces, changed.num_stored_faces) == (3, 1)
    assert scene.num_faces == 6
    changed.write(tmp_path / "out.glb")
    found = json_of(tmp_path / "out.glb")
    assert len(found["meshes"]) == 1
    assert found["meshes"][0]["primitives"][0]["material"] == 0
    assert len(found["accessors"]) == 2
    assert read_mesh(tmp_path / "out.glb").num_faces == 3


def test_a_mesh_of_which_nothing_is_left_leaves_its_nodes(tmp_path: Path) -> None:
    nodes = [*copy.deepcopy(NODES), {"name": "other", "mesh": 1}]
    meshes = scene_document()["meshes"] * 2
    source = written(tmp_path / "scene.glb", nodes=nodes, meshes=meshes, scenes=[{"nodes": [0, 5]}])
    scene = io.read_scene(source)
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    scene.with_meshes({0: nothing}).write(tmp_path / "out.glb")
    found = json_of(tmp_path / "out.glb")
    assert [node.get("mesh") for node in found["nodes"]] == [None] * 5 + [0]
    assert [node["name"] for node in found["nodes"]] == [node["name"] for node in nodes]
    assert read_mesh(tmp_path / "out.glb").num_faces == 2


def test_levels_of_detail_hang_on_nodes_that_are_nothing_but_a_mesh(tmp_path: Path) -> None:
    nodes = copy.deepcopy(NODES)
    nodes[1]["children"] = [5]
    nodes.append({"name": "under left"})
    scene = io.read_scene(written(tmp_path / "scene.glb", nodes=nodes))
    triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], face_material=[0])
    coarse = scene.with_meshes({0: triangle})
    io.write_lods([scene, coarse], tmp_path / "lods.glb")
    found = json_of(tmp_path / "lods.glb")
    assert found["extensionsUsed"][-1] == "MSFT_lod"
    right, left = found["nodes"][2], found["nodes"][1]
    (level,) = right["extensions"]["MSFT_lod"]["ids"]
    assert right["extras"]["MSFT_screencoverage"] == [0.5, 0.0]
    assert found["nodes"][level]["scale"] == right["scale"]
    assert found["nodes"][level]["mesh"] == 1
    # `left` has a child: a level in its place would take the child away
    assert "mesh" not in left
    assert "extensions" not in left
    shown = found["nodes"][left["children"][-1]]
    assert shown["mesh"] == 0
    assert "MSFT_lod" in shown["extensions"]
    assert read_mesh(tmp_path / "lods.glb").num_faces == 6
    # read again, the coarser levels belong to no scene
    again = io.read_scene(tmp_path / "lods.glb")
    assert again.num_faces == 6
    assert any("MSFT_lod" in text for text in again.warnings)


def test_a_folder_of_levels_counts_drawn_and_stored_faces(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "scene.glb"))
    io.write_lods([scene], tmp_path / "lods", errors=[0.0])
    (level,) = json.loads((tmp_path / "lods" / "lods.json").read_text())["levels"]
    assert (level["faces"], level["stored_faces"]) == (6, 2)
    assert len(json_of(tmp_path / "lods" / "level_0.glb")["nodes"]) == 5


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"targets": [{"POSITION": 0, "COLOR_0": 0}]}, "its morph targets change COLOR_0"),
        ({"mode": 1}, "it has no triangles"),
    ],
)
def test_why_a_mesh_is_fixed(change: dict[str, Any], reason: str, tmp_path: Path) -> None:
    meshes = scene_document()["meshes"]
    meshes[0]["primitives"][0] |= change
    source = written(tmp_path / "scene.glb", meshes=meshes)
    assert io.read_scene(source).fixed == (reason,)


def test_what_is_lost_is_named(tmp_path: Path) -> None:
    meshes = scene_document()["meshes"]
    meshes[0]["primitives"][0]["attributes"]["TANGENT"] = 0
    meshes[0]["primitives"][0]["extras"] = {"a": 1}
    used = ["KHR_lights_punctual", "EXT_strange"]
    source = written(tmp_path / "scene.glb", meshes=meshes, extensionsUsed=used)
    warnings = io.read_scene(source).warnings
    tangent = "TANGENT of meshes that are simplified is left out: viewers compute it from the "
    assert f"{tangent}texture coordinates" in warnings
    assert "extras of primitives that are simplified are left out" in warnings
    assert "extension EXT_strange is left out" in warnings
    io.read_scene(source).write(tmp_path / "out.glb")
    assert json_of(tmp_path / "out.glb")["extensionsUsed"] == ["KHR_lights_punctual"]


def test_images_beside_the_file_come_along(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "skin.png").write_bytes(PNG)
    images = [{"uri": "skin.png"}, {"uri": "missing.png"}, {"uri": "https://host/x.png"}]
    source = written(tmp_path / "a" / "scene.glb", images=images)
    scene = io.read_scene(source)
    assert any("missing.png" in text for text in scene.warnings)
    scene.write(tmp_path / "out.glb")
    first, second, third = json_of(tmp_path / "out.glb")["images"]
    assert first["mimeType"] == "image/png"
    assert (second, third) == ({"uri": "missing.png"}, {"uri": "https://host/x.png"})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"animations": [{"samplers": [{"input": 99, "output": 0}]}]}, "/animations/0"),
        ({"animations": [{"samplers": 3}]}, "array"),
        ({"skins": [{"inverseBindMatrices": 9}]}, "/skins/0/inverseBindMatrices"),
        ({"images": [{"bufferView": 8}]}, "/images/0/bufferView"),
        ({"images": [{}]}, '"uri"'),
        ({"extensionsRequired": ["EXT_strange"]}, "EXT_strange"),
        ({"nodes": [{"mesh": 4}]}, "/nodes/0/mesh"),
        ({"nodes": [{"children": [0]}]}, "cycle"),
        ({"scenes": [{"nodes": [0]}, {"nodes": [1]}]}, "has a parent"),
        ({"meshes": [3]}, "/meshes/0"),
    ],
)
def test_damaged_scenes_are_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=message):
        io.read_scene(written(tmp_path / "scene.glb", **changes))


def test_other_formats_and_documents_are_refused(tmp_path: Path) -> None:
    source = written(tmp_path / "scene.glb")
    scene = io.read_scene(source)
    with pytest.raises(InputError, match=r"path: expected \.glb or \.gltf"):
        scene.write(tmp_path / "out.obj")
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    with pytest.raises(FormatError, match="expected a scene"):
        io.read_scene(tmp_path / "a.obj")
    with pytest.raises(InputError, match="below 1"):
        scene.with_meshes({1: scene.meshes[0]})
    other = io.read_scene(written(tmp_path / "other.glb", meshes=scene_document()["meshes"] * 2))
    with pytest.raises(InputError, match="coarser"):
        io.write_scene(scene, tmp_path / "out.glb", coarser=[other])
    with pytest.raises(InputError, match="levels: expected a sequence"):
        io.write_lods([scene, scene.meshes[0]], tmp_path / "out.glb")  # type: ignore[list-item]
    assert not (tmp_path / "out.glb").exists()


def instanced(path: Path, **attributes: np.ndarray) -> Path:
    """The square, drawn by the node `left` wherever EXT_mesh_gpu_instancing puts it."""
    base, buffer = scene_document(), SQUARE_BUFFER
    accessors = {}
    for name, values in attributes.items():
        base["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(buffer), "byteLength": values.nbytes}
        )
        base["accessors"].append(
            {"bufferView": len(base["bufferViews"]) - 1, "count": len(values),
             "componentType": {"<f4": 5126, "i1": 5120}[values.dtype.str.replace("|", "")],
             "normalized": values.dtype.kind == "i", "type": f"VEC{values.shape[1]}"}
        )  # fmt: skip
        accessors[name] = len(base["accessors"]) - 1
        buffer += values.tobytes()
    base["buffers"] = [{"byteLength": len(buffer)}]
    base["nodes"][1]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": accessors}}
    base["nodes"] = base["nodes"][:2]
    base["nodes"][0]["children"] = [1]
    base |= {"extensionsUsed": ["EXT_mesh_gpu_instancing"]}
    base |= {"extensionsRequired": ["EXT_mesh_gpu_instancing"]}
    path.write_bytes(glb(base, buffer))
    return path


PLACES = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], "<f4")
QUARTER_TURN = np.array([[0, 0, 0, 127], [0, 0, 90, 90], [0, 0, 0, 127]], "i1")  # about z
SIZES = np.array([[1, 1, 1], [2, 2, 2], [1, 1, 3]], "<f4")


def test_instances_are_read_at_their_places(tmp_path: Path) -> None:
    source = instanced(tmp_path / "i.glb", TRANSLATION=PLACES, ROTATION=QUARTER_TURN, SCALE=SIZES)
    mesh = read_mesh(source)  # the far corner of each square, moved by `left` and `root`
    np.testing.assert_allclose(mesh.vertices[3::4], [[-1, 1, 5], [6, 2, 5], [-1, 11, 5]])
    scene = io.read_scene(source)
    assert (scene.num_instances, scene.num_faces, scene.num_stored_faces) == (3, 6, 2)
    assert scene.fixed == ("",)
    placed = scene.world_transforms()[1] @ scene.nodes[1].instances
    np.testing.assert_allclose((placed @ [1, 1, 0, 1])[:, :3], mesh.vertices[3::4])


def test_instances_stay_when_their_mesh_changes(tmp_path: Path) -> None:
    source = instanced(tmp_path / "i.glb", TRANSLATION=PLACES)
    scene = io.read_scene(source)
    one = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    light = scene.with_meshes({0: one})
    for quantize in (False, True):
        light.write(tmp_path / "light.glb", quantize=quantize)
        assert read_mesh(tmp_path / "light.glb").num_faces == 3
        np.testing.assert_allclose(
            np.ptp(read_mesh(tmp_path / "light.glb").vertices, axis=0), [11, 11, 0]
        )
    io.write_scene(scene, tmp_path / "lods.glb", coarser=[light], coverages=[0.5, 0.1])
    assert read_mesh(tmp_path / "lods.glb").num_faces == 6
    nodes = json_of(tmp_path / "lods.glb")["nodes"]
    shown = [node for node in nodes if "mesh" in node]
    assert len(shown) == 2
    assert all("EXT_mesh_gpu_instancing" in node["extensions"] for node in shown)
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    scene.with_meshes({0: empty}).write(tmp_path / "empty.glb")
    assert "extensions" not in json_of(tmp_path / "empty.glb")["nodes"][1]


def test_instances_of_other_numbers_are_refused(tmp_path: Path) -> None:
    source = instanced(tmp_path / "i.glb", TRANSLATION=PLACES, SCALE=SIZES[:2])
    for read in (read_mesh, io.read_scene):
        with pytest.raises(FormatError, match="has 2 elements, another of"):
            read(source)
    source = instanced(tmp_path / "i.glb", ROTATION=np.zeros((2, 4), "<f4"))
    with pytest.raises(FormatError, match="expected a unit quaternion, got zero"):
        read_mesh(source)


def test_more_instances_than_the_file_can_mean_are_refused_before_they_are_made(
    tmp_path: Path,
) -> None:
    """An accessor without a bufferView is zeros: a few bytes may ask for 2^31 instances."""
    source = instanced(tmp_path / "i.glb", TRANSLATION=PLACES)
    content = json_of(source)
    content["accessors"][2]["count"] = 2_000_000_000
    del content["accessors"][2]["bufferView"]
    source.write_bytes(glb(content, source.read_bytes()[-content["buffers"][0]["byteLength"] :]))
    for read in (read_mesh, io.read_scene):
        with pytest.raises(FormatError, match="max_bytes"):
            read(source)


def with_outline(**changes: Any) -> dict[str, Any]:
    """The square with its outline as lines of the same mesh."""
    meshes = scene_document()["meshes"]
    meshes[0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 2, "material": 0})
    return scene_document(meshes=meshes, **changes)


def test_lines_beside_triangles_of_a_mesh_stay_and_its_triangles_may_change(tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(glb(with_outline(), SQUARE_BUFFER))
    scene = io.read_scene(tmp_path / "scene.glb")
    assert (scene.fixed, scene.warnings) == (("",), ())
    half = scene.meshes[0].replace(faces=scene.meshes[0].faces[:1], face_material=None)
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    for mesh, modes in ((half, [4, 2]), (nothing, [2])):
        scene.with_meshes({0: mesh}).write(tmp_path / "out.glb")
        found = json_of(tmp_path / "out.glb")
        primitives = found["meshes"][0]["primitives"]
        assert [primitive.get("mode", 4) for primitive in primitives] == modes
        outline = found["accessors"][primitives[-1]["attributes"]["POSITION"]]
        assert outline["count"] == 4
        assert read_mesh(tmp_path / "out.glb").num_faces == 3 * mesh.num_faces


def test_lines_of_a_quantised_scene_keep_their_place(tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(glb(with_outline(), SQUARE_BUFFER))
    io.read_scene(tmp_path / "scene.glb").write(tmp_path / "out.glb", quantize=True)
    found = json_of(tmp_path / "out.glb")
    assert len(found["nodes"]) == len(NODES)  # no child that would scale the lines, too
    assert "extensionsRequired" not in found


VARIANTS = "KHR_materials_variants"


def variants_document(*mappings: list[dict[str, Any]] | None) -> dict[str, Any]:
    """The square once for each of the mappings, all with material 0."""
    meshes = scene_document()["meshes"]
    (primitive,) = meshes[0]["primitives"]
    meshes[0]["primitives"] = [
        primitive | ({} if own is None else {"extensions": {VARIANTS: {"mappings": own}}})
        for own in mappings
    ]
    paint = scene_document()["materials"]
    return scene_document(
        meshes=meshes,
        materials=[*paint, {"name": "other"}],
        extensions={VARIANTS: {"variants": [{"name": "red"}]}},
        extensionsUsed=[VARIANTS],
    )


def test_variants_of_materials_follow_other_triangles(tmp_path: Path) -> None:
    mappings = [{"material": 1, "variants": [0]}]
    made = variants_document(mappings, mappings)
    (tmp_path / "scene.glb").write_bytes(glb(made, SQUARE_BUFFER))
    scene = io.read_scene(tmp_path / "scene.glb")
    assert scene.warnings == ()
    io.write_scene(scene, tmp_path / "out.glb", coarser=[scene])
    found = json_of(tmp_path / "out.glb")
    assert found["extensions"] == made["extensions"]
    assert len(found["meshes"]) == 2
    for mesh in found["meshes"]:
        (primitive,) = mesh["primitives"]
        assert primitive["extensions"] == {VARIANTS: {"mappings": mappings}}
        assert sorted(mesh) == ["extras", "name", "primitives"]


def test_variants_that_one_material_has_in_two_ways_are_named(tmp_path: Path) -> None:
    made = variants_document([{"material": 1, "variants": [0]}], None)
    (tmp_path / "scene.glb").write_bytes(glb(made, SQUARE_BUFFER))
    scene = io.read_scene(tmp_path / "scene.glb")
    (warning,) = scene.warnings
    assert warning.startswith("KHR_materials_variants of primitives that share a material")
    scene.write(tmp_path / "out.glb")
    (primitive,) = json_of(tmp_path / "out.glb")["meshes"][0]["primitives"]
    assert "extensions" not in primitive


@pytest.mark.parametrize(
    ("name", "mime", "content"),
    [
        ("EXT_texture_avif", "image/avif", b"\0\0\0\x1cftypavif\0\0\0\0"),
        ("EXT_texture_webp", "image/webp", b"RIFF\x04\0\0\0WEBP"),
        ("KHR_texture_basisu", "image/ktx2", b"\xabKTX 20\xbb\r\n\x1a\n"),
        ("MSFT_texture_dds", "image/vnd-ms.dds", b"DDS \x7c\0\0\0"),
    ],
)
def test_pictures_of_other_formats_are_kept(
    name: str, mime: str, content: bytes, tmp_path: Path
) -> None:
    (tmp_path / "skin.picture").write_bytes(content)
    textures = [{"extensions": {name: {"source": 0}}}]
    images = [{"uri": "skin.picture", "mimeType": mime}]
    made = {"textures": textures, "images": images, "extensionsUsed": [name]}
    scene = io.read_scene(written(tmp_path / "scene.glb", **made))
    assert scene.warnings == ()
    scene.write(tmp_path / "out.glb")
    found = json_of(tmp_path / "out.glb")
    assert (found["textures"], found["extensionsUsed"]) == (textures, [name])
    assert found["images"][0]["mimeType"] == mime
    view = found["bufferViews"][found["images"][0]["bufferView"]]
    assert content in (tmp_path / "out.glb").read_bytes()
    assert view["byteLength"] == len(content)


def test_a_picture_that_ends_early_keeps_only_its_name(tmp_path: Path) -> None:
    (tmp_path / "skin.picture").write_bytes(b"RIFF\x04\0")
    images = [{"uri": "skin.picture", "mimeType": "image/webp"}]
    scene = io.read_scene(written(tmp_path / "scene.glb", images=images))
    (warning,) = scene.warnings
    assert warning.startswith("/images/0 is not a PNG or JPEG image")
    scene.write(tmp_path / "out.glb")
    assert json_of(tmp_path / "out.glb")["images"] == images


def test_pictures_are_found_behind_the_separators_of_windows(tmp_path: Path) -> None:
    (tmp_path / "in" / "textures").mkdir(parents=True)
    (tmp_path / "in" / "textures" / "skin.png").write_bytes(PNG)
    (tmp_path / "secret.png").write_bytes(PNG)
    images = [{"uri": "textures\\skin.png"}, {"uri": "..\\secret.png"}]
    scene = io.read_scene(written(tmp_path / "in" / "scene.glb", images=images))
    (warning,) = scene.warnings
    assert "secret.png" in warning
    scene.write(tmp_path / "out.glb")
    found, outside = json_of(tmp_path / "out.glb")["images"]
    assert found["mimeType"] == "image/png"
    assert outside == {"uri": "..\\secret.png"}


MOVED = np.array([[0, -1, 0, 5.0], [1, 0, 0, 0.25], [0, 0, 2, -3], [0, 0, 0, 1]])


def with_node(scene: io.Scene, index: int, **changes: Any) -> io.Scene:
    nodes = list(scene.nodes)
    nodes[index] = replace(nodes[index], **changes)
    return replace(scene, nodes=tuple(nodes))


@pytest.mark.parametrize("quantize", [False, True])
def test_transforms_of_nodes_are_written(quantize: bool, tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "scene.glb"))
    moved = with_node(scene, 1, transform=MOVED.tolist())
    moved.write(tmp_path / "out.glb", quantize=quantize)
    again = io.read_scene(tmp_path / "out.glb")
    np.testing.assert_array_equal(again.nodes[1].transform, MOVED)
    np.testing.assert_array_equal(again.world_transforms()[:5], moved.world_transforms())
    found, before = json_of(tmp_path / "out.glb"), scene_document()
    assert set(found["nodes"][1]).isdisjoint({"translation", "rotation", "scale"})
    for i in (0, 2, 3, 4):
        assert found["nodes"][i].get("name") == before["nodes"][i].get("name")
        assert found["nodes"][i].get("matrix") == before["nodes"][i].get("matrix")
    for member in ("cameras", "extensions", "samplers", "textures"):
        assert found[member] == before[member], member


def test_transforms_of_nodes_cannot_be_changed_in_place(tmp_path: Path) -> None:
    """A change of a shared array would not be noticed when the scene is written."""
    transform = np.eye(4)
    node = io.SceneNode("a", None, None, transform, drawn=True)
    transform[0, 3] = 5.0
    assert node.transform[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        node.transform[0, 3] = 5.0


def test_transforms_of_levels_are_those_of_the_finest(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "scene.glb"))
    moved = with_node(scene, 1, transform=MOVED)
    io.write_scene(moved, tmp_path / "out.glb", coarser=[moved])
    np.testing.assert_array_equal(
        io.read_scene(tmp_path / "out.glb").world_transforms()[1], moved.world_transforms()[1]
    )
    with pytest.raises(InputError, match="coarser: expected nodes with the transforms"):
        io.write_scene(moved, tmp_path / "out.glb", coarser=[scene])


@pytest.mark.parametrize(
    "changes", [{"name": "other"}, {"parent": None}, {"mesh": None}, {"drawn": False}]
)
def test_other_changes_of_nodes_are_refused(changes: dict[str, Any], tmp_path: Path) -> None:
    scene = with_node(io.read_scene(written(tmp_path / "scene.glb")), 1, **changes)
    with pytest.raises(InputError, match=rf"nodes\[1\]\.{next(iter(changes))}: only transforms"):
        scene.write(tmp_path / "out.glb")
    fewer = replace(scene, nodes=scene.nodes[:-1])
    with pytest.raises(InputError, match="nodes: expected the 5 nodes of the file, got 4"):
        fewer.write(tmp_path / "out.glb")


@pytest.mark.parametrize("pointer", [False, True])
def test_animated_nodes_keep_their_transforms(pointer: bool, tmp_path: Path) -> None:
    target: dict[str, Any] = {"node": 1, "path": "translation"}
    if pointer:
        named = {"KHR_animation_pointer": {"pointer": "/nodes/1/translation"}}
        target = {"path": "pointer", "extensions": named}
    channels = [{"sampler": 0, "target": target}]
    animation = {"channels": channels, "samplers": [{"input": 0, "output": 1}]}
    scene = io.read_scene(written(tmp_path / "scene.glb", animations=[animation]))
    with pytest.raises(InputError, match=r"nodes\[1\].transform: the node is animated"):
        with_node(scene, 1, transform=MOVED).write(tmp_path / "out.glb")
    with_node(scene, 2, transform=MOVED).write(tmp_path / "out.glb")


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (MOVED.T, "transform: expected 0 0 0 1 as the last row"),
        (MOVED[:3], r"transform: expected numbers of shape \(4, 4\)"),
        (np.full((4, 4), np.nan), "transform: expected finite numbers"),
        (np.eye(4).astype(str), "transform: expected numbers"),
    ],
)
def test_transforms_of_nodes_are_checked(transform: Any, message: str, tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "scene.glb"))
    with pytest.raises(InputError, match=message):
        with_node(scene, 0, transform=transform)
    with pytest.raises(InputError, match=r"instances: expected numbers of shape \(I, 4, 4\)"):
        with_node(scene, 1, instances=np.eye(4))


def test_a_transform_that_overflows_is_a_format_error(tmp_path: Path) -> None:
    turned = {"mesh": 0, "rotation": [0, 0, 3, 3], "scale": [float(np.finfo(float).max)] * 3}
    source = written(tmp_path / "scene.glb", nodes=[turned], scenes=[{"nodes": [0]}])
    with pytest.raises(FormatError, match="nodes: transform: expected finite numbers"):
        io.read_scene(source)
