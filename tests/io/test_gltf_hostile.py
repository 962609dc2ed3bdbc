"""glTF that lies: always a FormatError that says where, soon, without allocating the lie."""

from __future__ import annotations

import gzip
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manip3d
from cost_of_reading import cost_of_reading
from gltf_files import PNG, SQUARE, Scene, data_uri, document, glb, square
from manip3d.io import read_mesh_bytes

Changes = dict[str, Any]

# A fifth of a second on an idle machine. What grows with the square of the file's size takes
# minutes, so that a busy machine may take its time.
MAX_SECONDS = 5.0


def accessors(**changes: Any) -> Changes:
    """Change the accessor of the positions."""
    first, second = document()["accessors"]
    return {"accessors": [{**first, **changes}, second]}


def indices(values: list[int], **changes: Any) -> bytes:
    scene = Scene()
    position = scene.accessor(SQUARE)
    scene.primitive({"POSITION": position}, indices=scene.accessor(values, "u4", **changes))
    return scene.glb()


def sparse(rows: list[int]) -> bytes:
    scene = Scene()
    values = np.zeros((len(rows), 3), dtype="<f4").tobytes()
    scene.json["accessors"].append(
        {
            "componentType": 5126,
            "count": 3,
            "type": "VEC3",
            "sparse": {
                "count": len(rows),
                "indices": {"bufferView": scene.view(bytes(rows)), "componentType": 5121},
                "values": {"bufferView": scene.view(values)},
            },
        }
    )
    scene.primitive({"POSITION": 0})
    return scene.glb()


def positions(values: Any) -> bytes:
    scene = Scene()
    scene.primitive({"POSITION": scene.accessor(values)})
    return scene.glb()


def nodes(*content: Changes, **more: Any) -> bytes:
    return square(nodes=list(content), **more)


def primitive(**changes: Any) -> bytes:
    return square(
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **changes}]}]
    )


VIEWS = document()["bufferViews"]
NAN_TRIANGLE = [[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]]

ZOO: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "byte 0"),
    "header only": (b"glTF", "byte 4: GLB: the header is cut off"),
    "version 1": (b"glTF\1\0\0\0" + square()[8:], "byte 4: GLB: expected version 2, got 1"),
    "shorter than it says": (square()[:-4], "byte 8: GLB: the header says"),
    "no room for its header": (
        square()[:8] + b"\x04\0\0\0" + square()[12:],
        "byte 8: GLB: the header says 4 bytes",
    ),
    "no json": (glb(b"")[:12] + b"\0\0\0\0BIN\0", "expected a JSON chunk first"),
    "chunk beyond the end": (
        square()[:12] + b"\xff\xff\xff\xff" + square()[16:],
        "byte 12: GLB: the chunk says 4294967295 bytes",
    ),
    "broken json": (glb(b'{"asset": {]'), "byte 31: not JSON"),
    "not utf-8": (glb(b'{"asset": "\xff"}'), "not JSON"),
    "a number beyond double": (glb(b'{"asset": 1e999}'), "out of range"),
    "an array": (glb(b"[]"), "expected an object"),
    "deep": (b"[" * 500_000, "byte 64: JSON: nested deeper than 64"),
    "deep extras": (
        b'{"asset":{"version":"2.0"},"extras":' + b"[" * 60_000 + b"]" * 60_000 + b"}",
        "nested deeper than 64",
    ),
    "no asset": (glb({}), 'expected a member "asset"'),
    "glTF 1": (square(asset={"version": "1.0"}), "/asset/version"),
    "buffer longer than its bytes": (
        square(buffers=[{"byteLength": 64}]),
        "/buffers/0/byteLength: says 64 bytes, the buffer has 60",
    ),
    "huge buffer": (square(buffers=[{"byteLength": 2**62}]), "/buffers/0/byteLength"),
    "negative buffer": (square(buffers=[{"byteLength": -1}]), "/buffers/0/byteLength"),
    "fractional buffer": (square(buffers=[{"byteLength": 59.5}]), "/buffers/0/byteLength"),
    "buffer without bytes": (glb(document()), "/buffers/0: the buffer has no data"),
    "data URI without comma": (
        square(buffers=[{"byteLength": 1, "uri": "data:;base64"}]),
        "/buffers/0/uri: expected data:",
    ),
    "data URI not base64": (
        square(buffers=[{"byteLength": 1, "uri": "data:;base64,!!!!"}]),
        "/buffers/0/uri: expected base64",
    ),
    "zero byte in a name": (
        square(buffers=[{"byteLength": 1, "uri": "a%00.bin"}]),
        "/buffers/0/uri: a URI holds a zero byte",
    ),
    "view beyond its buffer": (
        square(bufferViews=[{"buffer": 0, "byteOffset": 13, "byteLength": 48}, VIEWS[1]]),
        "/bufferViews/0: bytes 13 to 61 of a buffer of 60",
    ),
    "view that overflows": (
        square(bufferViews=[{"buffer": 0, "byteOffset": 2**53, "byteLength": 2**53}, VIEWS[1]]),
        "/bufferViews/0: bytes",
    ),
    "stride below the element": (
        square(bufferViews=[{**VIEWS[0], "byteStride": 8}, VIEWS[1]]),
        "/bufferViews/0/byteStride",
    ),
    "no such view": (square(**accessors(bufferView=7)), "/accessors/0/bufferView"),
    "accessor beyond its view": (square(**accessors(count=5)), "/accessors/0: 5 elements"),
    "accessor offset": (square(**accessors(byteOffset=4)), "/accessors/0: 4 elements"),
    "billions": (square(**accessors(count=2**31 - 1)), "/accessors/0: 2147483647 elements"),
    "more than billions": (square(**accessors(count=2**31)), "/accessors/0/count"),
    "component type": (square(**accessors(componentType=5124)), "/accessors/0/componentType"),
    "type": (square(**accessors(type="VEC9")), "/accessors/0/type"),
    "positions in the plane": (square(**accessors(type="VEC2")), "does not suit POSITION"),
    "index out of range": (indices([0, 1, 4]), "/accessors/1: element 2 is 4"),
    "index of four billions": (indices([0, 1, 2**32 - 1]), "is 4294967295"),
    "two corners": (indices([0, 1]), "2 corners do not make whole triangles"),
    "float indices": (primitive(indices=0), "as indices, got component type 5126"),
    "sparse out of range": (sparse([0, 3]), "got 3 after 0"),
    "sparse unsorted": (sparse([1, 1]), "got 1 after 1"),
    "more sparse than dense": (sparse([0, 1, 2, 2]), "/accessors/0/sparse/count"),
    "NaN": (
        positions(NAN_TRIANGLE),
        "/accessors/0: expected finite numbers, got .*nan in element 1",
    ),
    "infinite": (positions(np.full((3, 3), np.inf)), "/accessors/0: expected finite numbers"),
    "infinite after the transform": (
        nodes({"children": [1], "scale": [1e200, 1, 1]}, {"mesh": 0, "scale": [1e200, 1, 1]}),
        "not finite after the transform",
    ),
    "attributes of different length": (
        square(
            meshes=[{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 2}}]}],
            accessors=[
                *document()["accessors"],
                {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            ],
        ),
        "/accessors/2: has 3 elements, POSITION of /meshes/0/primitives/0 4",
    ),
    "cycle": (
        nodes({"mesh": 0, "children": [1]}, {"children": [0]}),
        "/nodes/0: the nodes form a cycle",
    ),
    "own child": (nodes({"mesh": 0, "children": [0]}), "/nodes/0: the nodes form a cycle"),
    "cycle aside": (
        nodes({"mesh": 0}, {"children": [2]}, {"children": [1]}),
        "/nodes/1: the nodes form a cycle",
    ),
    "two parents": (
        nodes({"children": [2]}, {"children": [2]}, {"mesh": 0}),
        "/nodes/1/children/0: node 2 has two parents",
    ),
    "twice the same child": (nodes({"children": [1, 1]}, {"mesh": 0}), "node 1 has two parents"),
    "a root with a parent": (
        nodes({"mesh": 0}, {"children": [0]}),
        "/scenes/0/nodes/0: the root of a scene has a parent",
    ),
    "a root listed twice": (square(scenes=[{"nodes": [0, 0]}]), "node 0 is listed twice"),
    "no such node": (square(scenes=[{"nodes": [1]}]), "/scenes/0/nodes/0"),
    "no such scene": (square(scene=1), "/scene: expected"),
    "no such mesh": (nodes({"mesh": 1}), "/nodes/0/mesh"),
    "no such accessor": (primitive(indices=9), "/meshes/0/primitives/0/indices"),
    "no such material": (primitive(material=0), "the file has no materials"),
    "no such mode": (primitive(mode=7), "/meshes/0/primitives/0/mode"),
    "short matrix": (nodes({"mesh": 0, "matrix": [1, 0]}), "/nodes/0/matrix: expected 16 numbers"),
    "projective matrix": (
        nodes({"mesh": 0, "matrix": [1] * 16}),
        "/nodes/0/matrix: expected 0 0 0 1",
    ),
    "no rotation": (nodes({"mesh": 0, "rotation": [0, 0, 0, 0]}), "/nodes/0/rotation"),
    "endless rotation": (
        nodes({"mesh": 0, "rotation": [1e200, 0, 0, 0]}),
        "/nodes/0/rotation: expected a unit quaternion, got one without a finite length",
    ),
    "words for numbers": (nodes({"mesh": 0, "scale": ["a", 1, 1]}), "/nodes/0/scale/0"),
    "a buffer for what is compressed": (
        square(
            buffers=[
                {"byteLength": 60},
                {"byteLength": 60, "extensions": {"EXT_meshopt_compression": {"fallback": True}}},
            ],
            bufferViews=[{"buffer": 1, "byteLength": 48}, VIEWS[1]],
        ),
        "/buffers/1: the buffer has no data",
    ),
    "no such image": (
        square(
            materials=[{"normalTexture": {"index": 0}}],
            textures=[{"source": 1}],
            images=[{"uri": data_uri(PNG)}],
        ),
        "/textures/0/source",
    ),
    "alpha mode": (square(materials=[{"alphaMode": "MAYBE"}]), "/materials/0/alphaMode"),
}


@pytest.mark.parametrize("name", ZOO)
def test_the_zoo(name: str) -> None:
    content, message = ZOO[name]
    begin = time.process_time()
    with pytest.raises(manip3d.FormatError, match=message) as caught:
        read_mesh_bytes(content, "gltf")
    assert time.process_time() - begin < MAX_SECONDS
    assert caught.value.byte_offset is not None


def test_a_file_cut_anywhere_is_refused() -> None:
    content = square()
    for size in range(len(content)):
        with pytest.raises(manip3d.FormatError):
            read_mesh_bytes(content[:size], "glb")


def test_any_wrong_byte_is_refused_or_harmless() -> None:
    content = square(materials=[{"alphaMode": "BLEND"}])
    harmless = 0
    for at in range(len(content)):
        for wrong in (0x00, 0x2D, 0x39, 0x5B, 0xFF):
            damaged = content[:at] + bytes([wrong]) + content[at + 1 :]
            try:
                mesh = read_mesh_bytes(damaged, "glb")
            except manip3d.FormatError:
                continue
            mesh.validate()
            assert mesh.num_faces <= 2
            harmless += 1
    # Numbers, names of unknown members and letters of strings may be others.
    assert 0.1 < harmless / (5 * len(content)) < 0.25


# --- More than the bytes can mean -----------------------------------------------------------------


def crowd(num_nodes: int, num_primitives: int) -> bytes:
    return square(
        nodes=[{"mesh": 0}] * num_nodes,
        scenes=[{"nodes": list(range(num_nodes))}],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}] * num_primitives}],
    )


def zeros(count: int, ballast: bytes = b"") -> bytes:
    lie = document(
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
        accessors=[{"componentType": 5126, "count": count, "type": "VEC3"}],
    )
    return glb(lie, ballast)


def test_a_small_file_cannot_claim_unlimited_memory() -> None:
    assert read_mesh_bytes(crowd(100, 100), "glb").num_faces == 20_000
    for lie in (crowd(10_000, 10_000), zeros(999_999_999)):
        with pytest.raises(manip3d.FormatError, match="max_bytes allows it"):
            read_mesh_bytes(lie, "glb")
    much = zeros(3_000_000)
    with pytest.raises(manip3d.FormatError, match="more than 67108864 bytes"):
        read_mesh_bytes(much, "glb")
    assert read_mesh_bytes(much, "glb", max_bytes=10**9).num_faces == 1_000_000


def test_nodes_for_meshes_without_them_are_in_the_budget() -> None:
    content = document(meshes=[{"primitives": []}] * 200_000, nodes=[], scenes=[])
    with pytest.raises(manip3d.FormatError, match="/meshes: the mesh takes more than"):
        read_mesh_bytes(glb(content, b""), "glb", max_bytes=60_000_000)


def test_images_count_as_often_as_they_are_named() -> None:
    image = PNG + b"\0" * 100_000
    content = square(
        images=[{"uri": data_uri(image)}],
        textures=[{"source": 0}],
        materials=[{"normalTexture": {"index": 0}}] * 1000,
    )
    with pytest.raises(manip3d.FormatError, match="/images/0: the mesh takes more than"):
        read_mesh_bytes(content, "glb")


MEBIBYTE = 1 << 20


@pytest.mark.parametrize("kind", ["empty objects", "spaces", "zeros"])
def test_what_a_compressed_mebibyte_may_become_is_bounded(kind: str) -> None:
    if kind == "empty objects":
        nodes = b",".join([b"{}"] * 20_000_000)
        content = b'{"asset":{"version":"2.0"},"nodes":[' + nodes + b"]}"
    elif kind == "spaces":
        content = b" " * 60_000_000
    else:
        content = zeros(10_000_000, b"\0" * 50_000_000)
    small = gzip.compress(content, 1)
    assert len(small) < MEBIBYTE
    begin = time.process_time()
    with pytest.raises(manip3d.FormatError):
        read_mesh_bytes(small, "glb")
    assert time.process_time() - begin < MAX_SECONDS


HOSTILE: dict[str, bytes] = {
    "crowd": crowd(27_000, 10_000),
    "empty nodes": b'{"asset":{"version":"2.0"},"nodes":[' + b",".join([b"{}"] * 340_000) + b"]}",
    "empty arrays": b'{"asset":{"version":"2.0"},"nodes":[' + b",".join([b"[]"] * 340_000) + b"]}",
    "numbers": b'{"asset":{"version":"2.0"},"x":[' + b",".join([b"0"] * 510_000) + b"]}",
    "most zeros": zeros(2_550_000, b"\0" * (MEBIBYTE - 1000)),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_mebibyte_takes_little_memory_and_time(tmp_path: Path, name: str) -> None:
    content = HOSTILE[name]
    assert 0.8 * MEBIBYTE < len(content) <= MEBIBYTE
    path = tmp_path / "hostile.gltf"
    path.write_bytes(content)
    peak, seconds = cost_of_reading("mesh", path)
    assert seconds < MAX_SECONDS
    assert peak < 192 * MEBIBYTE  # beside some 60 of Python and the package


def one_tree_in_many_scenes(count: int) -> bytes:
    tree = [{"children": list(range(1, count))}, {"mesh": 0}, *[{}] * (count - 2)]
    return square(nodes=tree, scenes=[{"nodes": [0]}] * count)


def many_meshes(count: int) -> bytes:
    return square(
        nodes=[{"mesh": m} for m in range(count)],
        scenes=[{"nodes": list(range(count))}],
        meshes=document()["meshes"] * count,
    )


@pytest.mark.parametrize("make", [one_tree_in_many_scenes, many_meshes])
def test_scenes_take_no_quadratic_time(tmp_path: Path, make: Callable[[int], bytes]) -> None:
    """Four times the scenes, or meshes, take four times as long; it was sixteen times."""

    def seconds(count: int) -> float:
        path = tmp_path / "many.glb"
        path.write_bytes(make(count))
        begin = time.process_time()
        assert len(manip3d.io.read_scene(path).nodes) == count
        return time.process_time() - begin

    few = seconds(10_000)
    assert any(seconds(40_000) < 8.0 * few for _ in range(2))  # other processes may disturb one


def test_the_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "lie.gltf"
    path.write_text(json.dumps(document()))
    with pytest.raises(manip3d.FormatError, match="the buffer has no data") as caught:
        manip3d.read_mesh(path)
    assert caught.value.file == str(path)
