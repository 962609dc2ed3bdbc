"""``simplify`` and ``lod`` of glTF files with a single node: what a mesh has no place for stays."""

from __future__ import annotations

import gzip
import json
import lzma
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import manip3d
from gltf_files import PNG, data_uri, json_of
from manip3d import Material, Mesh, Texture, io, read_mesh
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


@pytest.mark.parametrize("command", ["simplify", "lod"])
@pytest.mark.parametrize("compress", [bytes, gzip.compress, lzma.compress])
def test_a_scene_from_stdin_is_that_of_the_file(
    chair: Path, tmp_path: Path, command: str, compress: Callable[[bytes], bytes]
) -> None:
    """Nodes, skins, animations and further looks of materials were lost."""
    more = ("--ratio", "0.5") if command == "simplify" else ("--levels", "2")
    whole = tmp_path / "whole.glb"
    io.read_scene(chair).write(whole)
    assert manip3d(command, whole, "-o", tmp_path / "file.glb", *more).returncode == 0
    content = compress(whole.read_bytes())
    run = manip3d(command, "-", "-o", tmp_path / "stdin.glb", *more, stdin=content)
    assert run.returncode == 0, run.stderr
    assert "read - (stdin): 1 node, 1 mesh shown 1 time," in run.stderr
    assert (tmp_path / "stdin.glb").read_bytes() == (tmp_path / "file.glb").read_bytes()


def test_what_is_left_out_of_stdin_is_told_of_standard_input(chair: Path, tmp_path: Path) -> None:
    """It was told of "bytes"; a .gltf whose picture is missing is read without it."""
    document = json.loads(chair.read_text())
    document["images"][0]["uri"] = "missing.png"
    document["buffers"][0]["uri"] = data_uri(chair.with_suffix(".bin").read_bytes(), "x/y")
    content = json.dumps(document).encode()
    for output in ("scene.glb", "mesh.ply"):
        run = manip3d("simplify", "-", "-o", tmp_path / output, "--ratio", "0.5", stdin=content)
        assert run.returncode == 0, run.stderr
        assert "standard input: " in run.stderr
        assert "missing.png" in run.stderr


def test_a_mesh_from_stdin_that_is_no_scene(tmp_path: Path) -> None:
    vertices, faces = grid(12, 12)
    Mesh(vertices, faces).write(tmp_path / "sheet.ply")
    content = (tmp_path / "sheet.ply").read_bytes()
    run = manip3d("simplify", "-", "-o", tmp_path / "a.glb", "--faces", "9", stdin=content)
    assert run.returncode == 0, run.stderr
    assert read_mesh(tmp_path / "a.glb").num_faces <= 9
    assert manip3d("lod", "-", "-o", tmp_path / "b.glb", stdin=b"glTF").returncode == 1


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_materials_of_which_nothing_is_left_are_named(tmp_path: Path, suffix: str) -> None:
    vertices, faces = grid(12, 12)
    material = np.zeros(len(faces), np.int32)
    material[0] = 1
    materials = [Material("wood"), Material("pin", (1.0, 0.0, 0.0, 1.0))]
    path = tmp_path / f"in{suffix}"
    Mesh(vertices, faces, face_material=material, materials=materials).write(path)
    order = ("simplify", path, "-o", tmp_path / f"out{suffix}", "--json")
    run = manip3d(*order, "--faces", "1")
    assert "warning: nothing is left of 1 material (pin)" in run.stderr
    assert json.loads(run.stdout)["gone_materials"] == ["pin"]
    run = manip3d(*order, "--ratio", "0.9", "--force")
    assert "nothing is left" not in run.stderr
    assert json.loads(run.stdout)["gone_materials"] == []


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


@pytest.mark.parametrize("command", ["simplify", "lod"])
def test_the_vertices_that_locks_hold_in_a_scene_are_counted(tmp_path: Path, command: str) -> None:
    """Two sheets of 12 x 12 squares that meet: their common side is no boundary."""
    Mesh(*grid(12, 12)).write(tmp_path / "sheets.gltf")
    document = json.loads((tmp_path / "sheets.gltf").read_text())
    document["meshes"] *= 2
    document["nodes"] = [{"mesh": 0}, {"mesh": 1, "translation": [12, 0, 0]}]
    document["scenes"] = [{"nodes": [0, 1]}]
    (tmp_path / "sheets.gltf").write_text(json.dumps(document))
    more = ("--ratio", "0.5") if command == "simplify" else ("--levels", "2")
    box = ("--lock-box", "0", "0", "0", "1", "1", "1")
    order = (command, tmp_path / "sheets.gltf", "-o", tmp_path / "out.glb", *more)
    run = manip3d(*order, "--lock-boundary", *box)
    assert run.returncode == 0, run.stderr
    assert "--lock-box holds 4 vertices\n" in run.stderr
    assert "--lock-boundary holds 72 vertices\n" in run.stderr
