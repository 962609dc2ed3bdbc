"""``simplify`` and ``lod`` of glTF files with a single node: what a mesh has no place for stays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import manip3d
from gltf_files import PNG, data_uri, json_of
from manip3d import Material, Mesh, Texture, read_mesh
from zoo import grid

LOOKS: dict[str, Any] = {
    "name": "wood",
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
    "normalTexture": {"index": 0, "scale": 0.25},
    "occlusionTexture": {"index": 0, "strength": 0.5},
    "extensions": {"KHR_materials_unlit": {}, "KHR_materials_clearcoat": {"clearcoatFactor": 1}},
    "extras": {"id": 7},
}
SAMPLER = {"wrapS": 33071, "magFilter": 9728}


@pytest.fixture
def chair(tmp_path: Path) -> Path:
    """A textured sheet, shown by a single node."""
    vertices, faces = grid(12, 12)
    mesh = Mesh(
        vertices,
        faces,
        texcoords=vertices[:, :2],
        face_texcoords=faces,
        face_material=np.zeros(len(faces), np.int32),
        materials=[Material("wood", textures={"base_color": Texture(data=PNG)})],
    )
    path = tmp_path / "chair.gltf"
    mesh.write(path)
    document = json.loads(path.read_text())
    document["nodes"][0] |= {"name": "Chair", "extras": {"id": 5}, "translation": [0, 0, 3]}
    document["meshes"][0]["name"] = "seat"
    document["materials"] = [LOOKS]
    document["images"] = [{"uri": data_uri(PNG, "image/png"), "name": "grain"}]
    document["samplers"] = [SAMPLER]
    document["textures"] = [{"source": 0, "sampler": 0}]
    document["extensionsUsed"] = ["KHR_materials_unlit", "KHR_materials_clearcoat"]
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("command", ["simplify", "lod"])
def test_a_file_of_one_node_keeps_its_looks_and_names(
    chair: Path, tmp_path: Path, command: str
) -> None:
    more = ("--ratio", "0.5") if command == "simplify" else ("--levels", "2")
    run = manip3d(command, chair, "-o", tmp_path / "out.glb", *more)
    assert run.returncode == 0
    assert "1 node, 1 mesh shown 1 time," in run.stderr
    assert "faces drawn:" not in run.stderr
    found = json_of(tmp_path / "out.glb")
    node = found["nodes"][0]
    assert (node["name"], node["translation"], node["extras"]["id"]) == ("Chair", [0, 0, 3], 5)
    assert found["meshes"][0]["name"] == "seat"
    assert found["materials"] == [LOOKS]
    assert found["samplers"] == [SAMPLER]
    assert found["textures"] == [{"source": 0, "sampler": 0}]
    assert found["images"][0]["name"] == "grain"
    assert set(found["extensionsUsed"]) >= {"KHR_materials_unlit", "KHR_materials_clearcoat"}
    before = read_mesh(chair)
    expected = before.num_faces // 2 if command == "simplify" else before.num_faces
    assert read_mesh(tmp_path / "out.glb").num_faces == expected


def test_the_record_of_a_file_of_one_node(chair: Path, tmp_path: Path) -> None:
    run = manip3d("simplify", chair, "-o", tmp_path / "out.glb", "--faces", "100", "--json")
    record = json.loads(run.stdout)
    assert (record["faces_before"], record["faces_after"]) == (read_mesh(chair).num_faces, 100)
    assert record["scene"]["nodes"] == record["scene"]["instances"] == 1


def test_a_file_of_one_node_whose_mesh_is_fixed_becomes_one_mesh(
    chair: Path, tmp_path: Path
) -> None:
    document = json.loads(chair.read_text())
    primitive = document["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"TEXCOORD_0": primitive["attributes"]["TEXCOORD_0"]}]
    chair.write_text(json.dumps(document))
    run = manip3d("simplify", chair, "-o", tmp_path / "out.glb", "--faces", "100")
    reason = "its morph targets change TEXCOORD_0"
    assert f"nodes are not kept, all becomes one mesh: {reason}" in run.stderr
    assert read_mesh(tmp_path / "out.glb").num_faces == 100


@pytest.mark.parametrize("verb", [("simplify", "--faces", "100"), ("lod",)])
def test_what_is_wrong_with_a_file_is_told_once(
    chair: Path, tmp_path: Path, verb: tuple[str, ...]
) -> None:
    document = json.loads(chair.read_text())
    document["asset"]["version"] = "1.0"
    chair.write_text(json.dumps(document))
    run = manip3d(*verb, chair, "-o", tmp_path / "out.glb")
    assert run.returncode == 1
    assert run.stderr.count("got version 1.0") == 1
