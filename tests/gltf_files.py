"""Small glTF files, made by hand: what a test changes is all that it says."""

from __future__ import annotations

import base64
import copy
import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from manip3d import Mesh, io

# 2---3
# | \ |   the unit square: corners 0 1 2 and 2 1 3
# 0---1
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype="<f4")
FACES = np.array([[0, 1, 2], [2, 1, 3]], dtype="<u2")
PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de"
    "0000000c49444154789c63f8cfc000000301010018dd8db00000000049454e44ae426082"
)


def glb(document: dict[str, Any] | bytes, binary: bytes | None = None) -> bytes:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text
    if binary is not None:
        binary += b"\0" * (-len(binary) % 4)
        chunks += struct.pack("<I", len(binary)) + b"BIN\0" + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def glb_parts(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the document and the buffer of a GLB file."""
    size = struct.unpack_from("<I", content, 12)[0]
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def json_of(path: Path) -> dict[str, Any]:
    """Return the document of a glTF file, also of a binary one."""
    content = path.read_bytes()
    is_binary = content.startswith(b"glTF")
    document: dict[str, Any] = glb_parts(content)[0] if is_binary else json.loads(content)
    return document


def data_uri(content: bytes, mime: str = "application/octet-stream") -> str:
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"


def document(**changes: Any) -> dict[str, Any]:
    """One node, one mesh, one triangle strip's worth of vertices, no indices; then the changes."""
    base: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 60}],
    }
    return {**copy.deepcopy(base), **changes}


SQUARE_BUFFER = SQUARE.tobytes() + FACES.tobytes()


def square(**changes: Any) -> bytes:
    """The unit square as GLB."""
    return glb(document(**changes), SQUARE_BUFFER)


COMPONENT_TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Scene:
    """Collects accessors, then gives a GLB with one primitive per call of `primitive`."""

    def __init__(self) -> None:
        self.buffer = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}],
            "accessors": [],
            "bufferViews": [],
        }

    def view(self, content: bytes, **more: Any) -> int:
        self.buffer += b"\0" * (-len(self.buffer) % 4)
        self.json["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": len(content), **more}
        )
        self.buffer += content
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str = "f4", **more: Any) -> int:
        array = np.asarray(values, dtype="<" + dtype)
        columns = 1 if array.ndim == 1 else array.shape[1]
        self.json["accessors"].append(
            {
                "bufferView": self.view(array.tobytes()),
                "componentType": COMPONENT_TYPES[dtype],
                "count": len(array),
                "type": SHAPES[columns],
                **more,
            }
        )
        return len(self.json["accessors"]) - 1

    def primitive(self, attributes: dict[str, int], **more: Any) -> None:
        self.json["meshes"][0]["primitives"].append({"attributes": attributes, **more})

    def glb(self) -> bytes:
        return glb({**self.json, "buffers": [{"byteLength": len(self.buffer)}]}, self.buffer)


def scene_of(mesh: Mesh) -> io.Scene:
    """A mesh as a scene of one node."""
    with tempfile.TemporaryDirectory() as folder:
        mesh.write(Path(folder, "mesh.glb"))
        return io.read_scene(Path(folder, "mesh.glb"))
