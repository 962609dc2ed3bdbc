"""Every kind of glTF file that is written, before the Khronos validator (npm gltf-validator)."""

from __future__ import annotations

import atexit
import functools
import json
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gltf_files import PNG
from manip3d import Material, Mesh, Texture, io, simplify
from manip3d.viewer.page import BUNDLE
from zoo import grid, sphere

VALIDATOR = BUNDLE.parents[1] / "node_modules" / "gltf-validator" / "index.js"
# Each line names files; what they name is read, so that buffers and images are looked at too.
SCRIPT = """
const fs = require('fs'), path = require('path'), validator = require(process.argv[1]);
const check = async file => {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
    uri: path.basename(file),
    externalResourceFunction: async uri =>
      new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))),
  });
  return report.issues;
};
require('readline').createInterface({input: process.stdin}).on('line', line =>
  Promise.all(JSON.parse(line).map(check)).then(all => console.log(JSON.stringify(all))));
"""

Writer = Callable[[Path], None]


def node() -> str | None:
    """Node.js: of the machine, or the one that `make setup` puts beside Python."""
    return shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))


@functools.cache
def validator() -> subprocess.Popen[str] | None:
    """A process that has loaded the validator, which takes longer than most files."""
    program = node()
    if program is None or not VALIDATOR.exists():
        return None
    command = [program, "-e", SCRIPT, str(VALIDATOR)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=0
    )
    atexit.register(process.communicate)
    return process


def issues(*paths: Path) -> list[dict[str, Any]]:
    """The validator's issues of each file."""
    process = validator()
    if process is None:
        pytest.skip("the Khronos validator is not installed: make setup")
    assert process.stdin is not None
    assert process.stdout is not None
    print(json.dumps(list(map(str, paths))), file=process.stdin, flush=True)
    found: list[dict[str, Any]] = json.loads(process.stdout.readline())
    return found


def tga() -> bytes:
    """An image that glTF does not take, of 3 x 2 pixels."""
    return struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 3, 2, 24, 0) + b"\x20\x40\x80" * 6


def bumpy(**changes: Any) -> Mesh:
    """A height field of 800 faces with texture coordinates, two materials and colours."""
    vertices, faces = grid(20, 20)
    vertices[:, 2] = np.sin(vertices[:, 0] * 0.6) + np.cos(vertices[:, 1] * 0.5)
    colors = np.arange(3 * len(vertices), dtype=np.uint8).reshape(-1, 3)
    png = {"base_color": Texture(data=PNG)}
    mesh = Mesh(
        vertices,
        faces,
        texcoords=vertices[:, :2] / 20,
        face_texcoords=faces,
        colors=colors,
        face_material=(np.arange(len(faces)) % 2).astype(np.int32),
        materials=[
            Material("grass", textures=png | {"normal": Texture(data=PNG)}),
            Material("glass", (1.0, 0.5, 0.25, 0.125), 0.25, 0.5, "mask", 0.75, double_sided=False),
        ],
    )
    return mesh.replace(**changes)


def partly_textured() -> Mesh:
    """Some faces have no texture coordinates, in either material."""
    rows = bumpy().face_texcoords
    assert rows is not None
    rows = rows.copy()
    rows[::5] = -1
    return bumpy(face_texcoords=rows)


def with_normals() -> Mesh:
    vertices, faces = sphere(24, 16)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return Mesh(vertices, faces, normals=normals, face_normals=faces)


def with_tga(path: Path) -> None:
    (path.parent / "grass.tga").write_bytes(tga())
    material = Material("grass", textures={"base_color": Texture("grass.tga")})
    source = str(path.parent / "grass.obj")
    bumpy(materials=[material, Material("glass")], source=source).write(path)


def scene(path: Path) -> io.Scene:
    """Nodes below each other that show two meshes, one of them twice."""
    source = path.parent / "source.gltf"
    bumpy().write(source)
    document = json.loads(source.read_text())
    document["nodes"] = [
        {"name": "both", "children": [1, 2]},
        {"mesh": 0, "translation": [0, 0, 1]},
        {"mesh": 0, "scale": [-1, 1, 1], "rotation": [0, 0, 0.6, 0.8]},
    ]
    document["scenes"] = [{"nodes": [0]}]
    source.write_text(json.dumps(document))
    return io.read_scene(source)


def fading_scene(path: Path) -> io.Scene:
    """A scene in which a material shows the alpha of vertices."""
    found = scene(path)
    mesh = found.meshes[0]
    source = path.parent / "source.gltf"
    document = json.loads(source.read_text())
    alphas = np.linspace(0.0, 1.0, mesh.num_vertices).astype(np.float32)
    binary = (path.parent / document["buffers"][0]["uri"]).read_bytes()
    for primitive in document["meshes"][0]["primitives"]:
        accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
        view = document["bufferViews"][accessor["bufferView"]]
        start = view["byteOffset"]
        rgb = np.frombuffer(binary[start : start + view["byteLength"]], "<f4").reshape(-1, 3)
        own = np.column_stack([rgb, alphas[: len(rgb)]]).astype("<f4").tobytes()
        binary += b"\0" * (-len(binary) % 4)
        accessor |= {"type": "VEC4", "bufferView": len(document["bufferViews"])}
        document["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(binary), "byteLength": len(own)}
        )
        binary += own
    for material in document["materials"]:
        material["alphaMode"] = "BLEND"
    document["buffers"] = [{"byteLength": len(binary), "uri": "fading.bin"}]
    (path.parent / "fading.bin").write_bytes(binary)
    source.write_text(json.dumps(document))
    return io.read_scene(source)


def simplified(mode: simplify.Mode) -> Writer:
    return lambda path: simplify.simplify(partly_textured(), mode, ratio=0.1).mesh.write(path)


WRITERS: dict[str, Writer] = {
    "plain": lambda path: Mesh(*sphere(24, 16)).write(path),
    "textured": lambda path: bumpy().write(path),
    "partly textured": lambda path: partly_textured().write(path),
    "normals": lambda path: with_normals().write(path),
    "samplers": lambda path: bumpy(
        materials=[
            Material("a", textures={"base_color": Texture(data=PNG, wrap=("clamp", "mirror"))}),
            Material("b", textures={"base_color": Texture(data=PNG, smooth=False)}),
        ]
    ).write(path),
    "tga": with_tga,
    "small primitives": lambda path: io.write_mesh(bumpy(), path, max_vertices=100),
    "emissive": lambda path: bumpy(
        materials=[Material("lamp", emissive=(4.0, 2.0, 0.5)), Material("glass")]
    ).write(path),
    "published": simplified("published"),
    "quality": simplified("quality"),
    "fast": simplified("fast"),
    "levels": lambda path: simplify.lod_chain(bumpy(), 4).write(path),
    "levels of small primitives": lambda path: simplify.lod_chain(
        partly_textured(), 3, method="fast"
    ).write(path, max_vertices=100),
    "quantised": lambda path: io.write_mesh(partly_textured(), path, quantize=True),
    "quantised normals": lambda path: io.write_mesh(with_normals(), path, quantize=True),
    "quantised levels": lambda path: simplify.lod_chain(bumpy(), 4).write(
        path, max_vertices=100, quantize=True
    ),
    "scene": lambda path: io.write_scene(scene(path), path),
    "simplified scene": lambda path: io.write_scene(
        simplify.simplify_scene(scene(path), ratio=0.2).scene, path
    ),
    "simplified scene with alpha": lambda path: io.write_scene(
        simplify.simplify_scene(fading_scene(path), ratio=0.2).scene, path
    ),
    "quantised scene": lambda path: io.write_scene(scene(path), path, quantize=True),
    "levels of a scene": lambda path: simplify.scene_lods(scene(path), 3).write(path),
    "quantised levels of a scene": lambda path: simplify.scene_lods(scene(path), 3).write(
        path, quantize=True
    ),
}


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("kind", WRITERS)
def test_the_validator_finds_no_error(kind: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"out{suffix}"
    WRITERS[kind](path)
    (found,) = issues(path)
    assert found["numErrors"] == 0, found["messages"]


def test_a_file_for_each_level(tmp_path: Path) -> None:
    simplify.lod_chain(bumpy(), 3).write(tmp_path / "levels")
    paths = sorted((tmp_path / "levels").glob("*.glb"))
    assert len(paths) == 3
    for path, found in zip(paths, issues(*paths), strict=True):
        assert found["numErrors"] == 0, (path.name, found["messages"])


def test_the_validator_finds_an_error_that_is_there(tmp_path: Path) -> None:
    path = tmp_path / "bad.gltf"
    bumpy().write(path)
    document = json.loads(path.read_text())
    document["accessors"][0]["count"] += 1_000_000
    path.write_text(json.dumps(document))
    (found,) = issues(path)
    assert found["numErrors"] > 0
