"""Hostile files: each ends in a FormatError, soon, and without allocating what it claims."""

from __future__ import annotations

import gzip
import lzma
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import manip3d
from cost_of_reading import cost_of_reading
from manip3d import io

MIB = 1 << 20
XYZ = "property float x\nproperty float y\nproperty float z\n"
BINARY = "ply\nformat binary_little_endian 1.0\n"
FACE = "property list uint int vertex_indices\n"


def long_polygon(shape: str, corners: int) -> bytes:
    """Return an OBJ with one polygon that is hard to triangulate, as few corners are convex."""
    t = np.arange(corners)
    if shape == "comb":
        points = np.column_stack([t, 1000.0 * (t % 2), 0 * t])
    elif shape == "line":
        points = np.column_stack([t, 0 * t, 0 * t])
    elif shape == "point":
        points = np.zeros((corners, 3))
    else:
        points = np.random.default_rng(0).random((corners, 3))
    rows = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in points.tolist())
    return (rows + "f " + " ".join(map(str, range(1, corners + 1))) + "\n").encode()


Content = bytes | Callable[[], bytes]
"""Bytes of a file, or a function that makes them if this takes long, as workers import this."""


def laid_out(example: tuple[str, Content], folder: Path) -> Path:
    """Write a file and return its path."""
    suffix, content = example
    path = folder / f"m.{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content())
    return path


HOSTILE: dict[str, tuple[str, Content]] = {
    "ply, 2e9 vertices": ("ply", f"{BINARY}element vertex 2000000000\n{XYZ}end_header\n".encode()),
    "ply, 2e9 faces": ("ply", f"{BINARY}element face 2000000000\n{FACE}end_header\n".encode()),
    "ply, 2^63 vertices": (
        "ply",
        f"{BINARY}element vertex {2**63 - 1}\n{XYZ}end_header\n".encode(),
    ),
    "ply, 2^64 vertices": ("ply", f"{BINARY}element vertex {2**64}\n{XYZ}end_header\n".encode()),
    "ply, list of 2^32": (
        "ply",
        f"{BINARY}element face 1\n{FACE}end_header\n".encode() + b"\xff" * MIB,
    ),
    "ply, skipped list of 2^32": (
        "ply",
        f"{BINARY}element a 1\nproperty list uint double b\nend_header\n".encode() + b"\xff" * MIB,
    ),
    "ply, grid of 2^32 x 2^32": (
        "ply",
        f"ply\nformat ascii 1.0\nobj_info num_cols {2**32}\nobj_info num_rows {2**32}\n"
        f"element range_grid 0\n{FACE}end_header\n".encode(),
    ),
    "ply, a million header lines": ("ply", b"ply\nformat ascii 1.0\n" + b"element a 1\n" * 90000),
    "off, 2e9 vertices": ("off", b"OFF\n2000000000 1 0\n0 0 0\n"),
    "off, 2e9 faces": ("off", b"OFF\n1 2000000000 0\n0 0 0\n"),
    "off, 2e9 corners": ("off", b"OFF\n1 1 0\n0 0 0\n2000000000 0 0 0\n"),
    "stl, 4e9 triangles": ("stl", b"x" * 80 + b"\xff" * 4 + b"\0" * 500),
    "stl, NaN": ("stl", b"x" * 80 + struct.pack("<I12fH", 1, *[float("nan")] * 12, 0)),
    "obj, index 2^31": ("obj", b"v 0 0 0\n" * 3 + b"f 1 2 2147483648\n"),
    "obj, index -2^63": ("obj", b"v 0 0 0\n" * 3 + b"f 1 2 -9223372036854775808\n"),
    "obj, no such vertex": ("obj", b"f 1 2 3\n" * 100000),
    "obj, one long word": ("obj", b"v " + b"1" * MIB),
    "obj, zeros": ("obj", b"v 1 2 3\n\0\0\0\nf 1 1" + b"\0" * MIB),
    "obj, xz that ends early": ("obj.xz", lzma.compress(b"v 0 0 0\n" * 1000)[:-20]),
    "obj, xz with a wrong byte": (
        "obj.xz",
        (lambda d: d[:60] + bytes([d[60] ^ 1]) + d[61:])(
            lzma.compress(np.random.default_rng(0).bytes(1000))
        ),
    ),
    "obj, gz that ends early": ("obj.gz", gzip.compress(b"v 0 0 0\n" * 1000)[:-9]),
    "obj, gz that is none": ("obj.gz", b"v 0 0 0\n"),
    "obj, xz that is none": ("obj.xz", b"v 0 0 0\n"),
    "obj, xz bomb of a line": ("obj.xz", lambda: lzma.compress(b"v" * (80 * MIB), preset=0)),
    "ply, xz bomb of vertices": (
        "ply.xz",
        lambda: lzma.compress(
            f"{BINARY}element vertex 30000000\n{XYZ.replace('float', 'char')}end_header\n".encode()
            + bytes(90 * MIB),
            preset=0,
        ),
    ),
    "obj, xz bomb of faces": (
        "obj.xz",
        lambda: lzma.compress(b"v 1 0 0\n" + b"f 1 1 1\n" * (10 * MIB), preset=0),
    ),
}

HOSTILE["obj, 90 000 libraries"] = ("obj", b"".join(b"mtllib %d\n" % i for i in range(90000)))
HOSTILE["obj, 90 000 libraries in a line"] = ("obj", b"mtllib" + b" a" * 90000)

SURVIVED: dict[str, tuple[str, Content]] = {
    "a comb of 30 000 teeth": ("obj", lambda: long_polygon("comb", 60000)),
    "a line of 60 000 corners": ("obj", lambda: long_polygon("line", 60000)),
    "60 000 corners at one place": ("obj", lambda: long_polygon("point", 60000)),
    "a polygon of 30 000 random corners": ("obj", lambda: long_polygon("random", 30000)),
    "a polygon of 500 000 equal corners": ("obj", b"v 1 2 3\nf" + b" 1" * 500000 + b"\n"),
    "250 polygons of 2 000 corners": (
        "obj",
        b"".join(b"v %d %d 0\n" % (i * 7919 % 101, i * 104729 % 103) for i in range(9))
        + (b"f" + b" 1 3 5 7 9 2 4 6 8" * 222 + b"\n") * 260,
    ),
    "90 000 materials": ("obj", b"".join(b"usemtl %d\n" % i for i in range(90000))),
    "continued lines": ("obj", b"v 0 0 0\nf" + b" \\\n1" * 250000 + b"\n"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_file_is_a_format_error(tmp_path: Path, name: str) -> None:
    path = laid_out(HOSTILE[name], tmp_path)
    with pytest.raises(manip3d.FormatError) as caught:
        manip3d.read_mesh(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize("name", [*HOSTILE, *SURVIVED])
def test_hostile_mebibyte_stays_small_and_quick(tmp_path: Path, name: str) -> None:
    path = laid_out({**HOSTILE, **SURVIVED}[name], tmp_path)
    assert path.stat().st_size < 1.2 * MIB
    peak, seconds = cost_of_reading("mesh", path)
    assert peak <= 256 * MIB
    assert seconds <= 5.0  # a second on an idle machine; this one may be busy


def test_max_bytes_lifts_the_limit_and_is_one(tmp_path: Path) -> None:
    path = tmp_path / "m.obj.xz"
    data = b"v 1 0 0\n" + b"# 01234567890123456789012345678901234567890123456789\n" * 1500000
    path.write_bytes(lzma.compress(data + b"f 1 1 1\n", preset=0))
    with pytest.raises(manip3d.FormatError, match="expand more than 200 times") as caught:
        manip3d.read_mesh(path)
    assert caught.value.byte_offset is not None
    assert caught.value.byte_offset >= 64 * MIB
    assert manip3d.read_mesh(path, max_bytes=100 * MIB).num_faces == 1
    with pytest.raises(manip3d.FormatError, match="at most max_bytes = 1000 bytes, got more"):
        manip3d.read_mesh(path, max_bytes=1000)
    plain = tmp_path / "m.obj"
    plain.write_bytes(b"v 0 0 0\n" * 200)
    with pytest.raises(manip3d.FormatError, match="at most max_bytes = 1000 bytes, got more"):
        manip3d.read_mesh(plain, max_bytes=1000)
    with pytest.raises(manip3d.InputError, match="max_bytes: expected > 0"):
        manip3d.read_mesh(plain, max_bytes=0)


@pytest.mark.parametrize("suffix", ["obj", "ply", "off", "stl"])
def test_every_truncation_is_an_error_or_a_valid_mesh(tmp_path: Path, suffix: str) -> None:
    """OBJ has no counts: a prefix is a mesh. An OFF file may lack its last line's end."""
    mesh = manip3d.Mesh(
        np.random.default_rng(0).random((6, 3)), [[0, 1, 2], [3, 4, 5]], face_material=[0, 0],
        materials=[manip3d.Material("m")],
    )  # fmt: skip
    mesh.write(tmp_path / f"m.{suffix}")
    data = (tmp_path / f"m.{suffix}").read_bytes()
    read: list[int] = []
    for size in range(len(data)):
        try:
            part = io.read_mesh_bytes(data[:size], suffix)
        except manip3d.FormatError:
            continue
        part.validate()
        np.testing.assert_array_equal(part.faces, mesh.faces[: part.num_faces])
        read.append(size)
    if suffix == "obj":
        assert 0.2 < len(read) / len(data) < 0.6
    else:
        assert read == ([len(data) - 1] if suffix == "off" else [])
