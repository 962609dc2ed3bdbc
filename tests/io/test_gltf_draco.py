"""glTF compressed with Draco: streams of DracoPy's encoder in accessors without bytes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manip3d
from gltf_files import COMPONENT_TYPES, FACES, SHAPES, SQUARE, Scene, document, glb
from manip3d.io import read_mesh_bytes, read_report, read_scene

DracoPy = pytest.importorskip("DracoPy")

NAME = "KHR_draco_mesh_compression"
TEXCOORDS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
NORMALS = np.tile([0.0, 0.0, 1.0], (4, 1))
RED = np.tile(np.uint8([255, 0, 0, 255]), (4, 1))


def stream(**more: Any) -> bytes:
    """The square; ``preserve_order`` keeps its vertices and faces as they are."""
    return bytes(
        DracoPy.encode(
            SQUARE.astype(np.float32), FACES.astype(np.uint32), preserve_order=True, **more
        )
    )


def ids_of(content: bytes) -> dict[int, int]:
    """Unique ids by Draco's types: 0 position, 1 normal, 2 colour, 3 texture coordinates."""
    attributes = DracoPy.decode(content).attributes
    return {found["attribute_type"]: found["unique_id"] for found in attributes}


class DracoScene(Scene):
    def hollow(self, count: int, columns: int, dtype: str, **more: Any) -> int:
        """Add an accessor without bytes."""
        accessor = {
            "componentType": COMPONENT_TYPES[dtype],
            "count": count,
            "type": SHAPES[columns],
            **more,
        }
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def draco(self, content: bytes, **more: Any) -> dict[str, Any]:
        """Add a primitive with all that the stream holds."""
        for listed in ("extensionsUsed", "extensionsRequired"):
            self.json[listed] = [NAME]
        kinds = {
            0: ("POSITION", 3, "f4"),
            1: ("NORMAL", 3, "f4"),
            2: ("COLOR_0", 4, "u1"),
            3: ("TEXCOORD_0", 2, "f4"),
        }
        attributes, ids = {}, {}
        for kind, unique_id in ids_of(content).items():
            name, columns, dtype = kinds[kind]
            flags = {"normalized": True} if dtype == "u1" else {}
            attributes[name] = self.hollow(4, columns, dtype, **flags)
            ids[name] = unique_id
        extension = {"bufferView": self.view(content), "attributes": ids}
        self.primitive(
            attributes,
            **{"indices": self.hollow(6, 1, "u2"), "extensions": {NAME: extension}, **more},
        )
        return extension


def square(**more: Any) -> DracoScene:
    scene = DracoScene()
    scene.draco(stream(**more))
    return scene


def test_all_attributes_come_out() -> None:
    mesh = read_mesh_bytes(square(tex_coord=TEXCOORDS, normals=NORMALS, colors=RED).glb())
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    np.testing.assert_array_equal(mesh.faces, FACES)
    assert mesh.texcoords is not None
    assert mesh.normals is not None
    assert mesh.colors is not None
    np.testing.assert_array_equal(mesh.texcoords, TEXCOORDS * [1, -1] + [0, 1])
    np.testing.assert_array_equal(mesh.normals, NORMALS)
    np.testing.assert_array_equal(mesh.colors, RED[:, :3])


def test_quantised_streams_are_as_exact_as_their_bits() -> None:
    """A sheet of 21 x 21 vertices 1 apart, in 14 bits: half a step is 20/2**15."""
    columns, rows = np.meshgrid(np.arange(21.0), np.arange(21.0))
    vertices = np.stack([columns, rows, 0 * rows], axis=-1).reshape(-1, 3)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).reshape(-1, 1)
    faces = np.vstack([np.add(corner, [0, 1, 22]), np.add(corner, [0, 22, 21])])
    content = DracoPy.encode(
        vertices.astype(np.float32), faces.astype(np.uint32), quantization_bits=14
    )
    scene = DracoScene()
    scene.draco(bytes(content))
    scene.json["accessors"][0]["count"] = len(vertices)
    scene.json["accessors"][1]["count"] = 3 * len(faces)
    mesh = read_mesh_bytes(scene.glb())
    assert 0 < np.abs(mesh.vertices - np.round(mesh.vertices)).max() <= 20 / 2**15

    def triangles(positions: Any, indices: Any) -> set[frozenset[tuple[float, ...]]]:
        return {frozenset(map(tuple, face)) for face in np.round(positions)[indices].tolist()}

    assert triangles(mesh.vertices, mesh.faces) == triangles(vertices, faces)
    assert mesh.num_faces == len(faces)


def test_primitives_share_a_stream() -> None:
    scene = square()
    primitives = scene.json["meshes"][0]["primitives"]
    primitives.append(primitives[0])
    mesh = read_mesh_bytes(scene.glb())
    assert (mesh.num_vertices, mesh.num_faces) == (4, 4)


def test_other_attributes_stay_plain() -> None:
    scene = square()
    texcoord = scene.accessor(TEXCOORDS)
    scene.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = texcoord
    mesh = read_mesh_bytes(scene.glb())
    assert mesh.texcoords is not None
    assert mesh.num_faces == 2


def test_plain_accessors_beside_the_stream_are_taken() -> None:
    scene = Scene()
    broken = {"bufferView": scene.view(b"no Draco"), "attributes": {"POSITION": 0}}
    scene.primitive(
        {"POSITION": scene.accessor(SQUARE)},
        indices=scene.accessor(FACES.ravel(), "u2"),
        extensions={NAME: broken},
    )
    scene.json["extensionsUsed"] = [NAME]
    np.testing.assert_array_equal(read_mesh_bytes(scene.glb()).vertices, SQUARE)


def test_a_damaged_stream_that_no_node_shows_does_no_harm() -> None:
    scene = square()
    broken = scene.draco(stream())
    broken["bufferView"] = scene.view(b"no Draco")
    primitives = scene.json["meshes"][0]["primitives"]
    scene.json["meshes"] = [{"primitives": [primitive]} for primitive in primitives]
    assert read_mesh_bytes(scene.glb()).num_faces == 2
    scene.json["nodes"].append({"mesh": 1})
    with pytest.raises(manip3d.FormatError, match="damaged Draco stream"):
        read_mesh_bytes(scene.glb())


def test_scenes_hold_the_mesh_and_are_written_plain(tmp_path: Path) -> None:
    """The second mesh has morph targets, which stay."""
    scene = square(tex_coord=TEXCOORDS)
    scene.draco(stream(), targets=[{"POSITION": scene.accessor(SQUARE)}])
    primitives = scene.json["meshes"][0]["primitives"]
    scene.json["meshes"] = [{"primitives": [primitive]} for primitive in primitives]
    scene.json["nodes"] = [{"mesh": 0}, {"mesh": 1, "translation": [2, 0, 0]}]
    (tmp_path / "a.glb").write_bytes(scene.glb())
    read = read_scene(tmp_path / "a.glb")
    assert [moves is None for moves in read.deformations] == [True, False]
    assert read.warnings == ()
    read.write(tmp_path / "b.glb")
    assert NAME.encode() not in (tmp_path / "b.glb").read_bytes()
    again = read_report(tmp_path / "b.glb")
    assert again.warnings == ("morph targets are left out",)
    np.testing.assert_array_equal(
        again.mesh.vertices, np.vstack([SQUARE, np.add(SQUARE, [2, 0, 0])])
    )


def test_without_dracopy_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    content = square().glb()
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(manip3d.errors.MissingExtraError, match=r"manip3d\[draco\]"):
        read_mesh_bytes(content)
    assert read_mesh_bytes(glb(document(), SQUARE.tobytes() + FACES.tobytes())).num_faces == 2


def changed(place: str, **changes: Any) -> bytes:
    """Change the first accessor ("a"), that of the indices ("i"), primitive or extension."""
    scene = square()
    primitive = scene.json["meshes"][0]["primitives"][0]
    {
        "a": scene.json["accessors"][0],
        "i": scene.json["accessors"][1],
        "p": primitive,
        "e": primitive["extensions"][NAME],
    }[place].update(changes)
    return scene.glb()


def with_stream(content: bytes) -> bytes:
    scene = square()
    scene.json["meshes"][0]["primitives"][0]["extensions"][NAME]["bufferView"] = scene.view(content)
    return scene.glb()


def two_sources() -> bytes:
    scene = square()
    scene.draco(stream())
    first, second = scene.json["meshes"][0]["primitives"]
    second["attributes"] = first["attributes"]
    return scene.glb()


def announcing(faces: bytes, points: bytes = b"\x04") -> bytes:
    """A sequential stream whose head has these counts, as numbers of seven bits a byte."""
    content = stream()
    assert content[11:13] == bytes([2, 4])
    return content[:11] + faces + points + content[13:]


def with_metadata(content: bytes) -> bytes:
    """A stream with metadata of an attribute, within another, and of the file."""

    def name(text: bytes) -> bytes:
        return bytes([len(text)]) + text

    entry = b"\x01" + name(b"attribute_name") + name(b"_FEATURE_ID_0")
    leaf, nested = entry + b"\x00", entry + b"\x02"
    element = nested + name(b"first") + leaf + name(b"second") + leaf
    return content[:10] + b"\x80" + b"\x01\x00" + element + b"\x00\x00" + content[11:]


def test_metadata_of_a_stream_are_left_out() -> None:
    plain = read_mesh_bytes(with_stream(stream()))
    assert np.array_equal(DracoPy.decode(with_metadata(stream())).points, SQUARE)
    found = read_mesh_bytes(with_stream(with_metadata(stream())))
    assert np.array_equal(found.vertices, plain.vertices)
    assert np.array_equal(found.faces, plain.faces)


def hollow_indices() -> bytes:
    scene = DracoScene()
    scene.draco(stream())
    primitive = scene.json["meshes"][0]["primitives"][0]
    primitive["attributes"]["POSITION"] = scene.accessor(SQUARE)
    primitive["extensions"][NAME]["bufferView"] = scene.view(b"no Draco")
    return scene.glb()


ZOO = {
    "a billion points": (
        with_stream(announcing(b"\x02", b"\x80\x80\x80\x80\x04")),
        "the mesh takes more than",
    ),
    "a billion faces": (
        with_stream(announcing(b"\x80\x80\x80\x80\x04")),
        "the mesh takes more than",
    ),
    "metadata that are not there": (
        with_stream(stream()[:10] + b"\x80" + stream()[11:]),
        f"/{NAME}: damaged Draco stream",
    ),
    "metadata without an end": (
        with_stream(stream()[:10] + b"\x80" + b"\xff\xff\xff\xff\x7f" + stream()[11:]),
        f"/{NAME}: damaged Draco stream",
    ),
    "metadata before a billion points": (
        with_stream(with_metadata(announcing(b"\x02", b"\x80\x80\x80\x80\x04"))),
        "the mesh takes more than",
    ),
    "only the indices": (hollow_indices(), f"/{NAME}: damaged Draco stream"),
    "no stream": (with_stream(b"no Draco"), f"/{NAME}: damaged Draco stream"),
    "empty": (with_stream(b""), f"/{NAME}: damaged Draco stream"),
    "cut": (with_stream(stream()[:-20]), f"/{NAME}: damaged Draco stream"),
    "points": (with_stream(DracoPy.encode(SQUARE.astype("f4"))), "point cloud of a Draco stream"),
    "fewer": (changed("a", count=3), "/accessors/0: says 3 elements, the Draco stream has 4"),
    "more": (changed("a", count=10**9), "/accessors/0: says 1000000000 elements"),
    "corners": (changed("i", count=3), "/accessors/1: says 3 elements, the Draco stream has 6"),
    "type": (changed("a", type="VEC2"), "/accessors/0: the Draco stream has 3 components"),
    "integers": (changed("a", componentType=5125), "/accessors/0: the Draco stream holds floats"),
    "float indices": (changed("i", componentType=5126), "/accessors/1: .* holds integers"),
    "strip": (changed("p", mode=5), "/primitives/0/mode: expected triangles"),
    "no indices": (changed("p", indices=7), "/primitives/0/indices"),
    "no id": (changed("e", attributes={"POSITION": 9}), "/attributes/POSITION: .* no such"),
    "no position": (changed("e", attributes={}), 'expected a member "POSITION"'),
    "not of the primitive": (
        changed("e", attributes={"POSITION": 0, "NORMAL": 0}),
        'expected a member "NORMAL"',
    ),
    "no view": (changed("e", bufferView=9), f"/{NAME}/bufferView"),
    "no object": (changed("p", extensions={NAME: 1}), f"/{NAME}: expected an object"),
    "two sources": (two_sources(), "two Draco attributes give its elements"),
}


@pytest.mark.parametrize("name", ZOO)
def test_the_zoo(name: str) -> None:
    content, message = ZOO[name]
    with pytest.raises(manip3d.FormatError, match=message) as caught:
        read_mesh_bytes(content, "glb")
    assert caught.value.byte_offset is not None


def test_any_wrong_byte_is_refused_or_harmless() -> None:
    content = stream(tex_coord=TEXCOORDS)
    refused = 0
    for at in range(len(content)):
        for wrong in (0x00, 0x01, 0x7F, 0xFF):
            damaged = content[:at] + bytes([wrong]) + content[at + 1 :]
            try:
                mesh = read_mesh_bytes(with_stream(damaged), "glb")
            except manip3d.FormatError:
                refused += 1
                continue
            mesh.validate()
            assert mesh.num_faces == 2
    assert refused > len(content)
