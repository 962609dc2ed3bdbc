"""``simplify`` and ``lod`` of glTF files with a single node: what a mesh has no place for stays."""

from __future__ import annotations

import csv
import gzip
import json
import lzma
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import manip3d
from gltf_files import PNG, data_uri, glb, glb_parts, json_of
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


def flatten(path: Path) -> None:
    """Give the only mesh of a file morph targets that keep it from being simplified as a scene."""
    document = json.loads(path.read_text())
    primitive = document["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"TEXCOORD_0": primitive["attributes"]["TEXCOORD_0"]}]
    path.write_text(json.dumps(document))


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
    flatten(chair)
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


@pytest.mark.parametrize("more", [("--jobs", "1"), ("--jobs", "2"), ("--dask", "local")])
def test_warnings_on_files_of_a_folder(chair: Path, tmp_path: Path, more: tuple[str, ...]) -> None:
    if "--dask" in more:
        pytest.importorskip("distributed")
    flatten(chair)
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a", "b"):
        document = json.loads(chair.read_text())
        document["buffers"][0]["uri"] = data_uri(chair.with_suffix(".bin").read_bytes())
        (folder / f"{name}.gltf").write_text(json.dumps(document))
    Mesh(*grid(12, 12)).write(folder / "c.ply")
    order = ("simplify", folder, "-o", tmp_path / "out", "--to", ".glb", "--ratio", "0.5", *more)
    reason = "its morph targets change TEXCOORD_0"
    warning = f"nodes are not kept, all becomes one mesh: {reason}"
    told = f"{folder / 'a.gltf'} and 1 more file: warning: {warning}\n"
    run = manip3d(*order)
    assert run.returncode == 0, run.stderr
    assert run.stderr.count(told) == run.stderr.count(warning) == 1
    with (tmp_path / "out" / "results.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["warnings.0"] for row in rows] == [warning, warning, ""]
    again = manip3d(*order, "--json")
    assert "3 from an earlier run" in again.stderr
    assert told in again.stderr
    records = json.loads(again.stdout)
    assert [record.get("warnings") for record in records] == [[warning], [warning], None]
    assert [record["nodes_lost"] for record in records] == [reason, reason, ""]
    assert manip3d(*order, "--quiet").stderr == ""


def test_warnings_on_one_file_are_in_its_record(chair: Path, tmp_path: Path) -> None:
    flatten(chair)
    order = ("simplify", chair, "-o", tmp_path / "out.glb", "--ratio", "0.5", "--force", "--json")
    run, quiet = manip3d(*order), manip3d(*order, "--quiet")
    (warning,) = json.loads(run.stdout)["warnings"]
    assert f"warning: {warning}\n" in run.stderr
    assert quiet.stderr == ""
    assert json.loads(quiet.stdout)["warnings"] == [warning]


def test_levels_of_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        Mesh(*grid(2, 2)).write(tmp_path / name)
    run = manip3d("lod", tmp_path, "-o", tmp_path / "out", "--levels", "9", "--jobs", "1", "--json")
    (first, second) = json.loads(run.stdout)
    warning = f"no more than {len(first['levels'])} levels could be made"
    assert f"{tmp_path / 'a.ply'} and 1 more file: warning: {warning}\n" in run.stderr
    assert first["warnings"] == second["warnings"] == [warning]


def two_sheets(path: Path, **second: Any) -> Path:
    """Write a scene with a large and a small sheet; ``second`` changes the small one's node."""
    Mesh(*grid(12, 12)).write(path)
    document, buffer = glb_parts(path.read_bytes())
    mesh = document["meshes"][0]
    small = json.loads(json.dumps(mesh)) | {"name": "small"}
    indices = document["accessors"][mesh["primitives"][0]["indices"]]
    document["accessors"].append(indices | {"count": 3})
    small["primitives"][0]["indices"] = len(document["accessors"]) - 1
    document["meshes"].append(small)
    document["nodes"] = [{"mesh": 0}, {"mesh": 1} | second]
    document["scenes"] = [{"nodes": [0, 1]}]
    document["extensionsUsed"] = ["KHR_node_visibility"]
    path.write_bytes(glb(document, buffer))
    return path


def test_meshes_that_are_gone_are_named(tmp_path: Path) -> None:
    path = two_sheets(tmp_path / "in.glb", scale=[0.01, 0.01, 0.01])
    order = ("simplify", "-o", tmp_path / "out", "--faces", "2", "--json")
    warning = "nothing is left of 1 mesh (small); nodes stay"
    run = manip3d(*order, path, "--to", ".glb")
    (record,) = json.loads(run.stdout)
    assert f"{path}: warning: {warning}\n" in run.stderr
    assert (record["gone_meshes"], record["warnings"]) == (["small"], [warning])


def test_faces_of_hidden_nodes_are_told(tmp_path: Path) -> None:
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    path = two_sheets(tmp_path / "in.glb", **hidden)
    run = manip3d("simplify", path, "-o", tmp_path / "out.glb", "--ratio", "0.5")
    faces = io.read_scene(path).num_faces
    assert f"KHR_node_visibility) count, too, with 1 of the {faces} faces drawn\n" in run.stderr
    two_sheets(path)
    run = manip3d("simplify", path, "-o", tmp_path / "out.glb", "--ratio", "0.5", "--force")
    assert "KHR_node_visibility" not in run.stderr


def test_meshes_that_stay_for_one_reason_are_told_together(chair: Path, tmp_path: Path) -> None:
    document = json.loads(chair.read_text())
    (mesh,) = document["meshes"]
    for name in ("x", "y"):
        fixed = json.loads(json.dumps(mesh)) | {"name": name}
        fixed["primitives"][0]["mode"] = 0
        document["meshes"].append(fixed)
        document["nodes"].append({"mesh": len(document["meshes"]) - 1})
        document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    chair.write_text(json.dumps(document))
    run = manip3d("simplify", chair, "-o", tmp_path / "out.glb", "--ratio", "0.5")
    assert "warning: 2 meshes (x, y) stay as they are: " in run.stderr
