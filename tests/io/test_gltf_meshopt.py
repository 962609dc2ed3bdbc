"""glTF with compressed bufferViews: streams that meshoptimizer 1.1 wrote, and damaged ones."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d
from gltf_files import FACES, SQUARE, Scene, glb, glb_parts
from manip3d.io import read_mesh_bytes, read_report, read_scene

KHR, EXT = "KHR_meshopt_compression", "EXT_meshopt_compression"

# --- What was encoded: a sheet of 9 x 6 vertices ------------------------------------------------

NUMBER = np.arange(54)
COLUMN, ROW = NUMBER % 9, NUMBER // 9
POSITIONS = np.stack([COLUMN * 0.25, ROW * 0.5, 7 * NUMBER % 13 * 0.125], axis=1).astype("<f4")
TEXCOORDS = np.stack([COLUMN * 8191, ROW * 13107], axis=1).astype("<u2")
SLOPES = np.stack([COLUMN - 4, ROW - 2.5, 5 * NUMBER % 7 - 2.5], axis=1)
TURNS = np.column_stack([SLOPES, 3 * NUMBER % 5 - 2])
COLORS = np.stack([COLUMN / 8, ROW / 5, 5 * NUMBER % 7 / 6, 3 * NUMBER % 5 / 4], axis=1)
CORNER = (np.arange(5)[:, None] * 9 + np.arange(8)).reshape(-1, 1)
TRIANGLES = (CORNER + np.array([0, 1, 9, 9, 1, 10])).reshape(-1, 3)
SCATTERED = (np.arange(240) ** 2 * 7919 % 54).reshape(-1, 3)
MANY = np.stack([np.arange(300), 300 - np.arange(300)], axis=1).astype("<u2")


def noise() -> NDArray[np.uint8]:
    """Bytes of a linear congruential generator, which do not compress."""
    state, found = 1, []
    for _ in range(160):
        state = state * 16807 % (2**31 - 1)
        found.append(state >> 16 & 255)
    return np.uint8(found).reshape(40, 4)


STREAMS = {
    "positions_0": (
        "oAAAfwD//4CAQEBAQAD//4CAQEBAQAD//4CAQEBAQAD//4CAQEBAQAD//4CAQEBAQAD////wAACAgEBAQEBVOAC+AHx/"
        "fC+AC+B/fH98AvgAvn98f3wAIAAAAAAUDAADAP+AAMAAMIBAEQAAMAB+AIAAAAAAfwDAv/8AIGA/wJ/gv/9/wL//ACBg"
        "P8Cf4L//f8C//wAgYD/An+C//3/Av/8AIGA/wP/wAACf4L//f8BVNmYAPX59fpmAD2Z9fmAD2Zh9fgDwAAB9fgAAAAAA"
        "AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
    ),
    "positions_1": (
        "oWkK6RUQAOQAAzkADkADAwOQAOQDAyAAA2oPwmEx8PwmE/T/9B8PwmEx8Pwm//T/9BMfD8JhMfD8//T/9LdwAAAGA/8U"
        "AAiAECCAQAUAAn4EAAEAAmADAwMADAMDgAEDAzAAAwMA9hYYEBEVFgoLCQ4I9PYWGBARFRYKCwkOCPT2FhgQERUWCgsJ"
        "Dgj09hYYEBEVFgoLCQ4I9PYAAAAAAAAAAAAAAAAAAAAAAAAAAAAyAUI="
    ),
    "texcoords": (
        "oQ1VFVV1VRBdVVdVEBBV1VV1EBBVUAAAAD5AQEBAQEBAAj5AQEBAQEBAAj5AQEBAQEBAAj5AQEBAQEBAAj5AQEBAQEBA"
        "Aj5AQEBAQEBAFQACZgQIZmYQIGZmFQACZgQIZmYQIGZmAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
    ),
    "many": (
        "oZlVVVVVKqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqq"
        "qlVVVVUVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVV"
        "mRWqqqqqqqqqqqqqqgAVVVVVVVVVVVVVVVUAAAAAAAAAAAAAAAAAAAAAAAAAAAAALAEB"
    ),
    "many_0": (
        "oFVVVVUqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqq"
        "AAAAAFVVVVUVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVVV"
        "VVVVEAAAAAAAABAVqqqqqqqqqqqqqqoAAYAAAAAVVVVVVVVVVVVVVVUAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
        "AAAAACwB"
    ),
    "noise": (
        "of8AYnvU6e9BH7LEt3P38VH1/gxOCflaZwBdDjGJ1+5kaZEujd2o0kcuAGDDb98n65ymgRvt4aiTo7Ns8eS77VATCFyO"
        "uWpwK5Nr3afQEGoUaQCcIn14oMR/m7mzsoY/yJUHDJGp42rFX2GWG9eb/zGp9ktzDg988JcAYNGifevJR+h/q10vVOAs"
        "ceOOSO2Jtig7r9DlASuso31UyYmwkfOAAAAAAAAAAAAAAAAAAAAAAAAAAADWt7UA"
    ),
    "noise_0": (
        "oB8AYnvU6e9BH7LEt3P38VH1/gxOCflaZwBdDjGJ1+5kaf//AACRLo3dqNJHLh8AYMNv3yfrnKaBG+3hqJOjs2zx5Lvt"
        "UBMIXI65anArk///AABr3afQEGoUaR8AnCJ9eKDEf5u5s7KGP8iVBwyRqeNqxV9hlhvXm/8xqf//AAD2S3MOD3zwlx8A"
        "YNGifevJR+h/q10vVOAsceOOSO2Jtig7r9DlASuso///AAB9VMmJsJHzgAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
        "AAAA1re1"
    ),
    "triangles": (
        "4f4eEA4QDhAOEA4QDhAOEA7+HhAOEA4QDhAOEA4QDhAO/h4QDhAOEA4QDhAOEA4QDv4eEA4QDhAOEA4QDhAOEA7+HhAO"
        "EA4QDhAOEA4QDhAODxIPAg8CDwIPAgB2h1ZneKmGZYlomAFpAAA="
    ),
    "triangles_4": (
        "4f4eEA4QDhAOEA4QDhAOEA7+HhAOEA4QDhAOEA4QDhAO/h4QDhAOEA4QDhAOEA4QDv4eEA4QDhAOEA4QDhAOEA7+HhAO"
        "EA4QDhAOEA4QDhAODxIPAg8CDwIPAgB2h1ZneKmGZYlomAFpAAA="
    ),
    "scattered": (
        "4f7//////////x9jtv///////x9jtv///////x9jtv///////x9jtv///////x9jtv///////x9jtv///////x9jtv//"
        "/////x9jtv///////0YF/xoxEf8OLh3/AiIp/wkWNf9WCkH/IWpN/z4NEv85GQYmvDX/WlU2/xUKKv8hAR7/LQ0S/zIZ"
        "BkW8Nv8RFjX/VgpB/yFqTf8+DRL/ORkGJrw1/1pVNv8VCir/IQEe/y0NEv8yGQZFvDb/ERY1/1YKQf8hak3/Pg0S/zkZ"
        "Bia8Nf9aVTb/FQoq/yEBHv8tDRL/MhkGRbw2/xEWNf9WCkH/IWpN/z4NEv85GQYmvDX/WlU2/xUKKv8hAR7/LQ0S/zIZ"
        "BkW8Nv8RFjX/VgpB/yFqTf8+DRIAdodWZ3iphmWJaJgBaQAA"
    ),
    "indices": (
        "0QAEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJB4EIAAeJCIEIAAeJCIEIAAeJCIE"
        "IAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJB4EIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAe"
        "JCIEIAAeJB4EIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJB4EIAAeJCIEIAAeJCIE"
        "IAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJCIEIAAeJAAAAAA="
    ),
    "octahedral_8": (
        "oW8AWAUZgDJOLj3mE3YIgHJdRDC4FzsJ3oBecT5yA4IZwYtOXg6UFxmIKoA+UT6oWgAL4FU8Pj0APi9LYhUXBVgGP0op"
        "nTKMCx9cCTlplBU/bgNITmUmvuMGICw7HExXPiwAcwpAOSRUQJMWElGqA0NDQ0NDQ0NDQ0NDQ0NDQ0NDQ0NDQ0NDQ0ND"
        "AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAApLl/gQA="
    ),
    "octahedral_16": (
        "oXeaAHNlZgDNzv4eOqyTkgDNIkT4j2hEqQEAAdwv8kNCZgHLzgHc2WhmiKoAAdwvWFUAqwCqQx0eKgYQgmI/BihlEUTx"
        "MOhFTwgPExkSdkLxGEgjT2AVFT4ADgUEBAMAHf/LIqpoZXNyAJKRAs3Myw0lmUapq6oA3DGIzmVmAWNmANomM8xoAawA"
        "xJIAcjirAKyp29wqBBVgEEI0GSoRYDWANgRnStIiMkMkByQyLwAEBAcCA6oDQ0NDQ0NDQ0NDQ0NDQ0NDQ0NDQ0NDQ0ND"
        "Q0MAAAAAAAAAAAAAAAAAAAAAAAAAOvqP+/8HAYAAAQ=="
    ),
    "quaternion": (
        "oXeXAAK+ksTEkr4CMTj7bbEA3nVIs6WKXn8ZE4VmIySQW0YmkS6G6d8AZwCsg9eUe9T/kad9LS8JKgLcec0vI/4LEBEi"
        "ggkf02AEjxIViACRCgXAD/QRED8ACwscCQoDACqY+1BQ+8Api75Z4ysHeBCBkR0fHT7Re74++RrD29IPiCOwNQDKqhxM"
        "+YJwR/COgarPg4+mKwATEhMODBMDFAsMExQVBhJ5VMRVf1OvhhoZRtcIzV//lPYWFxoTPwAUCwsSDRQAsxrSsv7SkrQQ"
        "0H2Mso2kwLrwD3tcAfTRPaFIWkNPxvv+CslQ4M6VP0wa/j56HudbrJcRl4wqC/X2WMWv/f8SExEQEBP7GOt6M4D+cRAP"
        "qrlM////eC8TFhMWExIXPwAGCAQIEQwpCJEDdAQEMAAEAlQwBCEDAAAEIyMAQRAAAQAAAAAAAAAAAAAAAAAA9QT1BPgD"
        "/AcAAA=="
    ),
    "exponential": (
        "oS4iLgAgIA8QEBAQLz8gAEAfEBAQLz8QEBAQEBAQLz8QEBAQEBAQLz8ICAgICAgICD8ICAgICAgICBoyAJZgyCQACQAI"
        "AAIVAD4gIB8gHwYMDzAfQBggLxAQGjIAlmDIJAAJAAgAAgBwXzAvOC84P0gHEABfOC84N0AvOC84LzgvLzgvOC84Lzgv"
        "DBccFxccFxwXHBccFxwXHBcXHBoyAJZgyCQACQAIAAIAAAAAAAAAAAAAAACOAAAAjgAAAI4AAAA="
    ),
    "color_8": (
        "of8AfBsZehkbGXp1G3wbGRt8GxkeGxkZfBsZeht1G3wbGXoZGRseGRt8GxkbfBt1ehkbGXoZGXoAs3R0sXR0dLOpdrN0"
        "dHSzdHYudHZ0s3J2s3SndLN0dLN0dnQudHSxdHR0s3Sns3R0drV0drMAeRocexwaHHveGHcaHBp5GhpIGhoceRwaeRrc"
        "GnkaHHkcGhpGHBp5GhwaeRrceRwaGnkcGnkAvn2+fX++fb59f759vn1/vn2+fX++fb59f759vn1/vn2+fX++fb59f759"
        "vn1/vn2+fX++fb4AAAAAAAAAAAAAAAAAAAAAAAAAAAAAgAA="
    ),
    "color_16": (
        "oXdXAFNUVlVWVFZVilRTVFZUU1RWIVRWVlNUVlVUilRTVFZVVlZUIVZUU1RWVFNUilVWVFZVVlZVagYBgRGHGBEGASER"
        "gRgVGBGBESEGARgXgV0wAAAIBgCsq6uuq6urrKmprKurq6yrqa6rqausramsq6errKurrKupq66rq66rq6usq6esq6up"
        "qquprKoLhpaGmWloaWj2iLaJaYuGG5aG+GloaWmWG4i2iQAAAAAAAFZVU1RTVVNUIVdYVVNVVlVViFVVU1ZTVVZVI1VW"
        "VVNWU1VVhlNVVlVTVVZVI1ZTVVVWU1VWKgcgUCJ+JyInIGICcicuJyJyAmAnIicuci0AAgUCBVUZhmGYZhmGYZhmGYZh"
        "kAAAqgpaV6WlelpXpaV6WlelpXpaV6WlelpXpaV6WgAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAACAAA"
    ),
}
"""Names that end in 0 are version 0 of attributes, those of EXT_meshopt_compression."""


def stream(name: str) -> bytes:
    return base64.b64decode(STREAMS[name])


class Packed(Scene):
    def packed(self, content: bytes, count: int, stride: int, mode: str, **more: Any) -> int:
        """Add a bufferView whose bytes are in a stream only; ``name`` is the extension's."""
        name = more.pop("name", KHR)
        self.json["extensionsUsed"] = self.json["extensionsRequired"] = [name]
        view = dict(self.json["bufferViews"][self.view(content)])
        extension = {**view, "byteStride": stride, "count": count, "mode": mode, **more}
        self.json["bufferViews"].append(
            {"buffer": 1, "byteLength": count * stride, "extensions": {name: extension}}
        )
        return len(self.json["bufferViews"]) - 1

    def hollow(self, view: int, count: int, kind: str, component: int, **more: Any) -> int:
        """Add an accessor to a bufferView."""
        accessor = {"bufferView": view, "componentType": component, "count": count, "type": kind}
        self.json["accessors"].append({**accessor, **more})
        return len(self.json["accessors"]) - 1

    def glb(self) -> bytes:
        fallback = {"byteLength": 1 << 20, "extensions": {KHR: {"fallback": True}}}
        buffers = [{"byteLength": len(self.buffer)}, fallback]
        return glb({**self.json, "buffers": buffers}, self.buffer)


ELEMENTS = {2: ("SCALAR", 5123), 4: ("VEC4", 5120), 8: ("VEC4", 5122), 12: ("VEC3", 5126)}


def decoded(folder: Path, content: bytes, count: int, stride: int, mode: str, **more: Any) -> bytes:
    """The bytes of a stream, as an accessor of an animation that is kept as it was read."""
    scene = Packed()
    scene.primitive(
        {"POSITION": scene.accessor(SQUARE)}, indices=scene.accessor(FACES.ravel(), "u2")
    )
    kind, component = ("SCALAR", 5125) if mode != "ATTRIBUTES" and stride == 4 else ELEMENTS[stride]
    output = scene.hollow(
        scene.packed(content, count, stride, mode, **more), count, kind, component
    )
    scene.json["animations"] = [
        {
            "samplers": [{"input": 0, "output": output}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}],
        }
    ]
    (folder / "a.glb").write_bytes(scene.glb())
    read_scene(folder / "a.glb").write(folder / "b.glb")
    written = (folder / "b.glb").read_bytes()
    assert b"meshopt" not in written
    found, buffer = glb_parts(written)
    place = found["accessors"][found["animations"][0]["samplers"][0]["output"]]
    view = found["bufferViews"][place["bufferView"]]
    start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
    return buffer[start : start + count * stride]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("positions_0", POSITIONS),
        ("positions_1", POSITIONS),
        ("texcoords", TEXCOORDS),
        ("many_0", MANY),
        ("many", MANY),
        ("noise_0", noise()),
        ("noise", noise()),
    ],
)
def test_attributes_come_out_to_the_bit(name: str, expected: NDArray[Any], tmp_path: Path) -> None:
    stride = expected.itemsize * expected.shape[1]
    found = decoded(tmp_path, stream(name), len(expected), stride, "ATTRIBUTES")
    assert found == expected.tobytes()


def test_the_streams_show_all_that_the_format_has() -> None:
    """Versions 0 and 1, and in the tails of version 1 differences of one, two and four bytes."""
    assert [stream(name)[0] for name in ("positions_0", "positions_1")] == [0xA0, 0xA1]
    channels = {name: list(stream(name)[-3:]) for name in ("positions_1", "octahedral_8")}
    assert channels["positions_1"] == [0x32, 1, 0x42]
    assert channels["octahedral_8"][-1] == 0


def turned(faces: NDArray[Any]) -> list[list[int]]:
    """Each triangle from its lowest corner on."""
    return [np.roll(face, -int(np.argmin(face))).tolist() for face in faces]


@pytest.mark.parametrize(
    ("name", "expected", "stride"),
    [("triangles", TRIANGLES, 2), ("triangles_4", TRIANGLES, 4), ("scattered", SCATTERED, 4)],
)
def test_triangles_come_out_in_their_order(
    name: str, expected: NDArray[Any], stride: int, tmp_path: Path
) -> None:
    found = decoded(tmp_path, stream(name), expected.size, stride, "TRIANGLES")
    assert turned(np.frombuffer(found, f"<u{stride}").reshape(-1, 3)) == turned(expected)


def test_indices_come_out_to_the_bit(tmp_path: Path) -> None:
    found = decoded(tmp_path, stream("indices"), 240, 4, "INDICES")
    np.testing.assert_array_equal(np.frombuffer(found, "<u4"), TRIANGLES.ravel())


@pytest.mark.parametrize(("name", "dtype", "bits"), [("8", "i1", 8), ("16", "<i2", 12)])
def test_unit_vectors_are_unfolded(name: str, dtype: str, bits: int, tmp_path: Path) -> None:
    """K bits leave half a step of 2**(1 - K) in both coordinates, thrice that at the worst."""
    size = np.dtype(dtype).itemsize
    content = decoded(
        tmp_path, stream(f"octahedral_{name}"), 54, 4 * size, "ATTRIBUTES", filter="OCTAHEDRAL"
    )
    found = np.frombuffer(content, dtype).reshape(-1, 4)[:, :3] / np.iinfo(dtype).max
    expected = SLOPES / np.linalg.norm(SLOPES, axis=1, keepdims=True)
    assert np.abs(found - expected).max() <= 3 * 2.0**-bits + 1 / np.iinfo(dtype).max
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1.5 / np.iinfo(dtype).max)


def test_unit_quaternions_get_their_largest_component_back(tmp_path: Path) -> None:
    content = decoded(tmp_path, stream("quaternion"), 54, 8, "ATTRIBUTES", filter="QUATERNION")
    found = np.frombuffer(content, "<i2").reshape(-1, 4) / 32767
    expected = TURNS / np.linalg.norm(TURNS, axis=1, keepdims=True)
    largest = np.take_along_axis(found, np.abs(expected).argmax(axis=1)[:, None], axis=1)
    assert (largest > 0.4).all()  # of four of norm one; it is stored positive
    sign = np.sign((found * expected).sum(axis=1, keepdims=True))
    assert np.abs(found - sign * expected).max() <= 3 * 2.0**-12


def test_exponents_and_mantissas_become_floats(tmp_path: Path) -> None:
    """With 15 bits and one exponent for each vertex these positions are exact."""
    content = decoded(tmp_path, stream("exponential"), 54, 12, "ATTRIBUTES", filter="EXPONENTIAL")
    np.testing.assert_array_equal(np.frombuffer(content, "<f4").reshape(-1, 3), POSITIONS)


@pytest.mark.parametrize(("name", "dtype", "bits"), [("8", "u1", 8), ("16", "<u2", 12)])
def test_colours_come_back(name: str, dtype: str, bits: int, tmp_path: Path) -> None:
    size = np.dtype(dtype).itemsize
    content = decoded(tmp_path, stream(f"color_{name}"), 54, 4 * size, "ATTRIBUTES", filter="COLOR")
    found = np.frombuffer(content, dtype).reshape(-1, 4) / np.iinfo(dtype).max
    assert np.abs(found - COLORS).max() <= 3 * 2.0**-bits


# --- Whole files --------------------------------------------------------------------------------


def sheet(name: str = KHR) -> Packed:
    """Positions, normals, texture coordinates and triangles, all of them in streams only."""
    scene = Packed()

    def add(
        key: str, count: int, stride: int, mode: str, kind: str, component: int, **more: Any
    ) -> int:
        flags = {"filter": more.pop("filter")} if "filter" in more else {}
        view = scene.packed(stream(key), count, stride, mode, name=name, **flags)
        return scene.hollow(view, count, kind, component, **more)

    oct8 = {"filter": "OCTAHEDRAL", "normalized": True}
    attributes = {
        "POSITION": add("positions_0", 54, 12, "ATTRIBUTES", "VEC3", 5126),
        "TEXCOORD_0": add("texcoords", 54, 4, "ATTRIBUTES", "VEC2", 5123, normalized=True),
        "NORMAL": add("octahedral_8", 54, 4, "ATTRIBUTES", "VEC3", 5120, **oct8),
    }
    for accessor in (1, 2):
        scene.json["bufferViews"][scene.json["accessors"][accessor]["bufferView"]]["byteStride"] = 4
    scene.primitive(attributes, indices=add("triangles", 240, 2, "TRIANGLES", "SCALAR", 5123))
    return scene


@pytest.mark.parametrize("name", [KHR, EXT])
def test_a_mesh_in_streams_is_read_without_a_warning(name: str, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(sheet(name).glb())
    read = read_report(tmp_path / "a.glb")
    assert read.warnings == ()
    np.testing.assert_array_equal(read.mesh.vertices, POSITIONS)
    assert turned(read.mesh.faces) == turned(TRIANGLES)
    assert read.mesh.texcoords is not None
    assert read.mesh.normals is not None
    np.testing.assert_allclose(read.mesh.texcoords, TEXCOORDS / 65535 * [1, -1] + [0, 1])
    lengths = np.linalg.norm(SLOPES, axis=1, keepdims=True)
    np.testing.assert_allclose(read.mesh.normals, SLOPES / lengths, atol=0.02)


def test_a_stream_is_taken_before_its_fallback() -> None:
    scene = sheet()
    fallback = scene.view(bytes(54 * 12))
    view = scene.json["bufferViews"][scene.json["accessors"][0]["bufferView"]]
    view.update({key: scene.json["bufferViews"][fallback][key] for key in ("buffer", "byteOffset")})
    np.testing.assert_array_equal(read_mesh_bytes(scene.glb()).vertices, POSITIONS)


def test_what_no_node_shows_is_not_decoded() -> None:
    scene = sheet()
    scene.json["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}}]})
    hidden = scene.packed(b"no stream", 54, 12, "ATTRIBUTES")
    scene.hollow(hidden, 54, "VEC3", 5126)
    scene.json["meshes"][1]["primitives"][0]["attributes"]["POSITION"] = 4
    assert read_mesh_bytes(scene.glb()).num_faces == 80


# --- Damage -------------------------------------------------------------------------------------


def changed(**changes: Any) -> bytes:
    """Change what the extension says of the positions, or of the triangles (``of=3``)."""
    scene = sheet()
    accessor = scene.json["accessors"][changes.pop("of", 0)]
    view = scene.json["bufferViews"][accessor["bufferView"]]
    if "length" in changes:
        view["byteLength"] = changes.pop("length")
    view["extensions"][KHR].update(changes)
    return scene.glb()


def with_stream(content: bytes, of: int = 0) -> bytes:
    scene = sheet()
    place = dict(scene.json["bufferViews"][scene.view(content)])
    view = scene.json["bufferViews"][scene.json["accessors"][of]["bufferView"]]
    view["extensions"][KHR].update(place)
    return scene.glb()


def one_byte(name: str, at: int, value: int) -> bytes:
    content = bytearray(stream(name))
    content[at] = value
    return bytes(content)


ZOO = {
    "empty": (with_stream(b""), "shorter than its head and tail"),
    "only a head": (with_stream(b"\xa1"), "shorter than its head and tail"),
    "cut": (with_stream(stream("positions_0")[:-40]), "the stream ends within its data"),
    "too long": (
        with_stream(stream("positions_0")[:1] + b"\0" + stream("positions_0")[1:]),
        "left over before the tail|ends within",
    ),
    "another head": (with_stream(one_byte("positions_0", 0, 0xE1)), r"expected attributes .* 225"),
    "version 2": (with_stream(one_byte("positions_1", 0, 0xA2)), r"expected attributes .* 162"),
    "channel": (with_stream(one_byte("positions_1", -1, 3)), "unknown channel mode 3"),
    "turned bytes": (with_stream(one_byte("positions_1", -1, 0x10)), "unknown channel mode 16"),
    "triangles for attributes": (with_stream(stream("triangles")), "expected attributes"),
    "attributes for triangles": (with_stream(stream("many"), of=3), "expected triangles"),
    "an edge before the first": (
        with_stream(one_byte("triangles", 1, 0x00), of=3),
        "before the first",
    ),
    "table": (
        with_stream(b"\xe1\xf0" + stream("triangles")[2:-16] + b"\xff" * 16, of=3),
        "the table in the tail",
    ),
    "triangles are left over": (
        with_stream(stream("triangles")[:81] + b"\0" + stream("triangles")[81:], of=3),
        "2 bytes are left over",
    ),
    "a long number": (
        with_stream(b"\xe1" + b"\xff" * 80 + b"\xff" + b"\xff" * 6 + bytes(16), of=3),
        "a number of more than five bytes",
    ),
    "no stride": (changed(byteStride=6, count=108), "byteStride of 4 to 256"),
    "wide": (changed(byteStride=260), r"expected a whole number in \[2, 256\]"),
    "fewer": (changed(count=53), "/byteLength: expected 636 as the meshopt stream has, got 648"),
    "none": (changed(count=0, length=0), r"expected a whole number in \[1, "),
    "billions": (changed(count=2**31 - 1, length=12 * (2**31 - 1)), "the mesh takes more than"),
    "mode": (changed(mode="POINTS"), "expected one of ATTRIBUTES, TRIANGLES, INDICES"),
    "no mode": (changed(mode=1), "/mode: expected a string|expected text"),
    "filter": (changed(filter="BLUR"), "expected one of NONE, OCTAHEDRAL"),
    "filter of another width": (changed(filter="QUATERNION"), "not for elements of 12 bytes"),
    "filter of indices": (changed(of=3, filter="EXPONENTIAL"), "indices have no filter"),
    "no triangles": (changed(of=3, count=239, length=478), "a multiple of 3, got 239"),
    "wide triangles": (changed(of=3, byteStride=8, count=60), "a byteStride of 2 or 4"),
    "outside": (changed(byteOffset=10**6), "bytes 1000000 to"),
    "no buffer": (changed(buffer=1, byteOffset=0), "/buffers/1: the buffer has no data"),
    "no unit": (
        with_stream(stream("texcoords"), of=2),
        "element 0: its third component stands for no 1.0",
    ),
}


@pytest.mark.parametrize("name", ZOO)
def test_the_zoo(name: str) -> None:
    content, message = ZOO[name]
    with pytest.raises(manip3d.FormatError, match=message) as caught:
        read_mesh_bytes(content, "glb")
    assert caught.value.byte_offset is not None
    assert "/bufferViews/" in str(caught.value) or "/buffers/" in str(caught.value)


@pytest.mark.parametrize("name", ["positions_0", "positions_1", "triangles"])
def test_any_wrong_byte_is_refused_or_harmless(name: str) -> None:
    content = stream(name)
    refused = 0
    for at in range(len(content)):
        for wrong in (0x00, 0x01, 0x7F, 0xFF):
            damaged = content[:at] + bytes([wrong]) + content[at + 1 :]
            try:
                mesh = read_mesh_bytes(with_stream(damaged, of=3 if name == "triangles" else 0))
            except manip3d.FormatError:
                refused += 1
                continue
            mesh.validate()
            assert mesh.num_faces == 80
    assert refused > 0
