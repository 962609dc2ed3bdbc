"""Scans are written to files and read back; damaged files are errors that name the damage."""

from __future__ import annotations

import gzip
import itertools
import lzma
import os
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, InputError, LidarFrame, MissingExtraError, capture
from manip3d.cli.kinds import OtherKindError, expect_kind
from manip3d.io import read_mesh, read_scan, write_scan
from manip3d.io._scan_tables import grid_of
from manip3d.lidar import ScanFormat


def scan(num_points: int = 100) -> LidarFrame:
    rng = np.random.default_rng(0)
    return LidarFrame(
        rng.normal(size=(num_points, 3)) * 10, rng.random(num_points).astype(np.float32)
    )


@pytest.mark.parametrize("suffix", ["bin", "bin.xz", "bin.gz"])
@pytest.mark.parametrize("num_points", [0, 1, 100, 40_000])
def test_kitti_round_trip(tmp_path: Path, suffix: str, num_points: int) -> None:
    path = tmp_path / f"scan.{suffix}"
    frame = scan(num_points)
    frame.write(path)
    again = read_scan(path)
    assert np.array_equal(again.points, frame.points)
    assert again.intensity is not None
    assert np.array_equal(again.intensity, frame.intensity)
    assert again.origin == (0.0, 0.0, 0.0)
    assert again.source == str(path)
    assert again.format is not None
    assert again.format.name == "kitti"


def test_kitti_rows_are_four_little_endian_floats(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"
    path.write_bytes(struct.pack("<8f", 1, 2, 3, 0.5, -4, -5, -6, 1.0))
    frame = read_scan(path)
    assert frame.points.tolist() == [[1, 2, 3], [-4, -5, -6]]
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [0.5, 1.0]


def test_no_intensity_is_written_as_zero(tmp_path: Path) -> None:
    write_scan(LidarFrame([[1, 2, 3]]), tmp_path / "s.bin")
    assert (tmp_path / "s.bin").read_bytes() == struct.pack("<4f", 1, 2, 3, 0)


@pytest.mark.parametrize(
    ("data", "byte", "reason"),
    [
        (bytes(17), 17, "file ends within a point"),
        (bytes(15), 15, "file ends within a point"),
        (bytes(20) + struct.pack("<f", np.nan) + bytes(8), 20, "expected a finite number"),
        (bytes(16 * 20_000) + struct.pack("<f", np.inf) + bytes(12), 320_000, "finite number"),
    ],
)
@pytest.mark.parametrize("compress", [bytes, lzma.compress, gzip.compress])
def test_damaged_kitti(tmp_path: Path, data: bytes, byte: int, reason: str, compress) -> None:  # type: ignore[no-untyped-def]
    suffix = {bytes: "", lzma.compress: ".xz", gzip.compress: ".gz"}[compress]
    path = tmp_path / f"scan.bin{suffix}"
    path.write_bytes(compress(data))
    with pytest.raises(FormatError, match=reason) as caught:
        read_scan(path)
    assert caught.value.byte_offset == byte
    assert caught.value.file == str(path)


@pytest.mark.parametrize("share", [0.001, 0.4, 0.9])
@pytest.mark.parametrize(
    ("name", "columns"), [("scan.bin", 4), ("scan.bin", 3), ("scan.bin", 6), ("scan.pcd.bin", 5)]
)
def test_rows_without_a_return_are_counted(
    tmp_path: Path, name: str, columns: int, share: float
) -> None:
    random = np.random.default_rng(0)
    values = (random.normal(size=(20_000, columns)) + 20.0 * np.arange(columns)).astype(np.float32)
    values[:, -1] = 3.0  # such as a ring, which has a value without a return, too
    lacking = random.random(len(values)) < share
    values[lacking, :3] = np.nan
    (tmp_path / name).write_bytes(values.tobytes())
    found = read_scan(tmp_path / name)
    assert found.num_dropped == np.count_nonzero(lacking)
    np.testing.assert_array_equal(found.points, values[~lacking, :3])
    assert found.file_rows is not None
    np.testing.assert_array_equal(found.file_rows, np.flatnonzero(~lacking))


@pytest.mark.parametrize(("name", "columns"), [("scan.bin", 4), ("scan.pcd.bin", 5)])
def test_damage_is_counted_with_its_first_row(tmp_path: Path, name: str, columns: int) -> None:
    values = np.zeros((40_000, columns), np.float32)
    values[30_000, 2] = values[30_000, 3] = np.nan
    values[39_999, 0] = np.inf
    (tmp_path / name).write_bytes(values.tobytes())
    expected = "z of row 30000: expected a finite number, got nan; 2 of 40000 points have such a"
    with pytest.raises(FormatError, match=expected) as caught:
        read_scan(tmp_path / name)
    assert caught.value.byte_offset == 4 * (30_000 * columns + 2)
    assert "Write the file without them" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("a.lvx", "lvx_to_rosbag.launch"),
        ("a.LVX2", "Livox Viewer 2"),
        ("a.pnts", "the .las, .laz or .e57 file"),
        ("a.fls", "export it as .e57, .ptx or .las"),
        ("a.feather", "pandas.read_feather"),
        ("a.h5", "h5py reads it"),
        ("a.HDF5", "h5py reads it"),
        ("a.tsv", r"name it \.csv"),
        ("a.pkl", "unpickling can run any program"),
        ("a.tfrecord", "Waymo Open Dataset"),
    ],
)
def test_clouds_of_other_programs_are_refused_with_advice(
    name: str, cure: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(b"livox_tech")
    with pytest.raises(InputError, match=cure):
        read_scan(path)
    with pytest.raises(FormatError, match=cure):
        read_mesh(path)  # the commands look into files of unknown kinds by this
    with pytest.raises(OtherKindError, match=cure):
        expect_kind(str(path), "scan", "mesh", verb="view")


def test_names_that_are_no_scans(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a point file \(.*\.bin"):
        read_scan(tmp_path / "scan.asd")
    with pytest.raises(InputError, match="expected a point file"):
        scan().write(tmp_path / "scan.obj")
    with pytest.raises(FileNotFoundError):
        read_scan(tmp_path / "none.bin")
    with pytest.raises(InputError, match="max_bytes: expected > 0, got 0"):
        read_scan(tmp_path / "none.bin", max_bytes=0)


def test_a_compressed_scan_may_not_explode(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin.xz"
    path.write_bytes(lzma.compress(bytes(80 << 20), preset=0))
    with pytest.raises(FormatError, match="expand more than 200 times"):
        read_scan(path)
    with pytest.raises(FormatError, match="expected at most max_bytes = 1000 bytes, got more"):
        read_scan(path, max_bytes=1000)
    assert read_scan(path, max_bytes=100 << 20).num_points == 5 << 20


PCD = """\
# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z _ ring rgb normal
SIZE 4 8 4 1 2 4 4
TYPE F F F U U U F
COUNT 1 1 1 4 1 1 3
WIDTH 2
HEIGHT 2
VIEWPOINT 1 2 3 1 0 0 0
POINTS 4
DATA {data}
"""
PCD_ROWS = [
    [1.5, 2.1, 3, 0, 0, 0, 0, 7, 255, 0, 0, 1],
    [-4, 5, 6, 0, 0, 0, 0, 8, 1, 1, 0, 0],
    [np.nan, np.nan, np.nan, 0, 0, 0, 0, 9, 2, 0, 1, 0],
    [7, 8, 9, 1, 2, 3, 4, 10, 3, 0, 0, 0.5],
]
PCD_TYPES = "<fdf4BHI3f"


def lzf_literals(data: bytes) -> bytes:
    """LZF without a copy: runs of at most 32 bytes."""
    runs = (data[i : i + 32] for i in range(0, len(data), 32))
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def pcd_bytes(data: str) -> bytes:
    head = PCD.format(data=data).encode()
    if data == "ascii":
        return head + "".join(" ".join(map(str, row)) + "\n" for row in PCD_ROWS).encode()
    rows = [struct.pack(PCD_TYPES, *row) for row in PCD_ROWS]
    if data == "binary":
        return head + b"".join(rows)
    edges = [0, 4, 12, 16, 20, 22, 26, 38]
    columns = b"".join(row[a:b] for a, b in itertools.pairwise(edges) for row in rows)
    packed = lzf_literals(columns)
    return head + struct.pack("<II", len(packed), len(columns)) + packed


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path: Path, data: str) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_bytes(data))
    frame = read_scan(path)
    assert frame.num_dropped == 1
    np.testing.assert_allclose(frame.points, [[1.5, 2.1, 3], [-4, 5, 6], [7, 8, 9]], rtol=1e-7)
    assert frame.exact is not None
    assert frame.exact[0, 1] == 2.1
    assert frame.ring is not None
    assert frame.ring.tolist() == [7, 8, 10]
    assert sorted(frame.fields) == ["normal", "rgb"]
    assert frame.fields["normal"].tolist() == [[0, 0, 1], [1, 0, 0], [0, 0, 0.5]]
    assert frame.origin == (1.0, 2.0, 3.0)
    assert frame.intensity is None
    # Written back: same encoding, types and order, with the point that was not measured.
    frame.write(tmp_path / "b.pcd")
    again = read_scan(tmp_path / "b.pcd")
    assert f"DATA {data}\n".encode() in (tmp_path / "b.pcd").read_bytes()
    assert b"WIDTH 2\nHEIGHT 2\n" in (tmp_path / "b.pcd").read_bytes()
    assert again.num_dropped == 1
    assert again.exact is not None
    assert np.array_equal(again.exact, frame.exact)
    assert again.fields["rgb"].tolist() == [255, 1, 3]
    assert again.format is not None
    assert again.format.columns == frame.format.columns  # type: ignore[union-attr]


def test_compressed_pcd_is_small_and_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    rng = np.random.default_rng(0)
    for case in range(30):
        n = int(rng.integers(0, 400))
        points = np.round(rng.normal(size=(n, 3)), int(rng.integers(0, 3)))
        frame = LidarFrame(points, rng.integers(0, 3, n).astype(np.float32))
        frame.write(path)
        packed = read_scan(path)
        header = {"pairs": (("data", "binary_compressed"),)}
        packed = packed.replace(format=ScanFormat("pcd", packed.format.columns, header))  # type: ignore[union-attr]
        packed.write(path)
        again = read_scan(path)
        assert np.array_equal(again.points, frame.points), case
    zeros = packed.replace(
        points=np.zeros((1000, 3)), intensity=np.zeros(1000, np.float32), fields={}, exact=None
    )
    zeros.write(path)
    assert path.stat().st_size < 600
    assert np.array_equal(read_scan(path).points, zeros.points)


PLY = """\
ply
format {format} 1.0
comment scanned on Monday
element vertex 2
property double x
property float y
property float z
property uchar reflectance
property ushort echo
element camera 1
property float view
end_header
"""


@pytest.mark.parametrize(("form", "order"), [("ascii", ""), ("little", "<"), ("big", ">")])
def test_ply(tmp_path: Path, form: str, order: str) -> None:
    path = tmp_path / "a.ply"
    head = PLY.format(format="ascii" if form == "ascii" else f"binary_{form}_endian").encode()
    values = [(1.1, 2, 3, 200, 5), (4, 5, 6, 100, 6)]
    if order:
        body = b"".join(struct.pack(order + "dffBH", *row) for row in values) + bytes(4)
    else:
        body = "".join(" ".join(map(str, row)) + "\n" for row in values).encode() + b"0\n"
    path.write_bytes(head + body)
    frame = read_scan(path)
    np.testing.assert_allclose(frame.points, [[1.1, 2, 3], [4, 5, 6]], rtol=1e-7)
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [200, 100]
    assert frame.fields["echo"].tolist() == [5, 6]
    assert frame.origin is None
    assert read_scan(path, origin=(0, 0, 1)).origin == (0.0, 0.0, 1.0)
    changed = frame.with_points(
        [[1.1, 2, 3], [9, 9, 9]], source_index=[0, -1], intensity=[200.4, 300]
    )
    changed.write(tmp_path / "b.ply")
    again = read_scan(tmp_path / "b.ply")
    assert b"comment scanned on Monday\n" in (tmp_path / "b.ply").read_bytes()
    assert again.exact is not None
    assert again.exact[0, 0] == 1.1
    assert again.fields["echo"].tolist() == [5, 0]
    assert again.intensity is not None
    assert again.intensity.tolist() == [200, 255]
    assert again.format.columns == frame.format.columns  # type: ignore[union-attr]


def test_3dtk_is_left_handed_and_in_centimetres(tmp_path: Path) -> None:
    path = tmp_path / "scan000.3d"
    path.write_text("100 20 300 0.5\n-1.1 -2.2 -3.3 0.25\n\n# end\n")
    (tmp_path / "scan000.pose").write_text("0 0 500\n0 90 0\n")
    frame = read_scan(path)
    # x to the right, y up, z ahead.
    np.testing.assert_allclose(frame.points[0], [3.0, -1.0, 0.2], rtol=1e-6)
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [0.5, 0.25]
    assert frame.format is not None
    pose = frame.format.header["pose"]
    # 5 m ahead, turned by 90 degrees from ahead (z) to the right (x).
    np.testing.assert_allclose(pose[:3, 3], [5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3] @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    frame.write(tmp_path / "b.3d")
    assert (tmp_path / "b.3d").read_text() == "100 20 300 0.5\n-1.1 -2.2 -3.3 0.25\n"
    (tmp_path / "scan000.pose").write_text("0 0 x")
    with pytest.raises(FormatError, match="expected six finite numbers"):
        read_scan(path)


@pytest.mark.parametrize("source", ["bin", "pcd", "ply", "3d"])
@pytest.mark.parametrize("target", ["bin", "pcd", "ply", "3d"])
def test_any_format_from_any_other(tmp_path: Path, source: str, target: str) -> None:
    frame = scan(200)
    frame.write(tmp_path / f"a.{source}")
    read_scan(tmp_path / f"a.{source}").write(tmp_path / f"b.{target}")
    again = read_scan(tmp_path / f"b.{target}")
    assert np.array_equal(again.points, frame.points)
    assert again.intensity is not None
    assert np.array_equal(again.intensity, frame.intensity)


@pytest.mark.parametrize(
    ("line", "intensity", "fields"),
    [
        ("1 2 3", None, []),
        ("1 2 3 0.1", [0.1], []),
        ("1 2 3 255 0 7", None, ["c3", "c4", "c5"]),
        ("1 2 3 0.1 255 0 7", [0.1], ["c4", "c5", "c6"]),
    ],
)
def test_3dtk_fourth_column_is_the_intensity(
    tmp_path: Path, line: str, intensity: list[float] | None, fields: list[str]
) -> None:
    (tmp_path / "a.3d").write_text(f"{line}\n")
    frame = read_scan(tmp_path / "a.3d")
    told = None if frame.intensity is None else frame.intensity.tolist()
    assert told == (None if intensity is None else np.float32(intensity).tolist())
    assert list(frame.fields) == fields
    frame.write(tmp_path / "b.3d")
    assert (tmp_path / "b.3d").read_text() == f"{line}\n"


BAD_PCD = [
    ("FIELDS x y z _ ring rgb normal", "FIELDS x y z", "expected as many SIZE, TYPE and COUNT"),
    ("SIZE 4 8", "SIZE 3 8", "expected a TYPE of I, U or F"),
    ("COUNT 1 1 1 4", "COUNT 1 1 1 -1", "COUNT: expected 0 to 1048576"),
    ("COUNT 1 1 1 4", "COUNT 1 1 1 9999999", "COUNT: expected 0 to 1048576"),
    ("POINTS 4", "POINTS 5", r"POINTS: expected WIDTH x HEIGHT = 4, got 5"),
    ("WIDTH 2\nHEIGHT 2\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 4", "WIDTH -5\nHEIGHT 1\nPOINTS -5",
     "WIDTH: expected at least 0, got -5"),
    ("POINTS 4", "POINTS -4", "POINTS: expected at least 0, got -4"),
    ("HEIGHT 2", "HEIGHT -2", "HEIGHT: expected at least 0, got -2"),
    ("WIDTH 2", "WIDTH 2000000000", "more than 2147483647 points"),
    ("POINTS 4", "POINTS many", "POINTS: expected an integer"),
    ("VIEWPOINT 1 2 3", "VIEWPOINT 1 nan 3", "VIEWPOINT: expected a finite number"),
    ("VERSION 0.7", "VERSIONS 0.7", "unknown entry 'VERSIONS'"),
    ("WIDTH 2\nHEIGHT 2\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 4",
     "WIDTH 20000\nHEIGHT 20000\nPOINTS 400000000", "claimed|uncompressed"),
    ("FIELDS x y z", "FIELDS a y z", "a scan has x, y and z; x not found"),
]  # fmt: skip


@pytest.mark.parametrize("data", ["binary", "ascii", "binary_compressed"])
@pytest.mark.parametrize(("old", "new", "reason"), BAD_PCD)
def test_damaged_pcd(tmp_path: Path, data: str, old: str, new: str, reason: str) -> None:
    path = tmp_path / "a.pcd"
    content = pcd_bytes(data)
    assert old.encode() in content
    path.write_bytes(content.replace(old.encode(), new.encode(), 1))
    with pytest.raises(FormatError, match=reason) as caught:
        read_scan(path)
    assert caught.value.file == str(path)


def test_a_double_in_a_pcd_of_text_is_no_integer(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_bytes("ascii").replace(b"TYPE F F F", b"TYPE F I F", 1))
    with pytest.raises(FormatError, match="expected an integer of its type"):
        read_scan(path)


@pytest.mark.parametrize(
    ("packed", "size", "reason"),
    [
        (b"\x05abc", 6, "within a run"),
        (b"\x20", 3, "within a copy"),
        (b"\xe0\x01", 3, "within a copy"),
        (b"\x00a\x20\x05", 3, "from before the beginning"),
        (b"\x00a\x20\x00", 3, "more bytes than expected"),
        (b"\x03abcd", 3, "more bytes than expected"),
        (b"\x00a", 3, "expected 3 bytes, got 1"),
        (b"\x00a", 9999, "2 bytes of LZF cannot hold 9999"),
    ],
)
def test_damaged_lzf(tmp_path: Path, packed: bytes, size: int, reason: str) -> None:
    path = tmp_path / "a.pcd"
    head = f"FIELDS x y z\nSIZE 1 1 1\nTYPE U U U\nWIDTH {size // 3}\nHEIGHT 1\nDATA "
    path.write_bytes(
        head.encode() + b"binary_compressed\n" + struct.pack("<II", len(packed), size) + packed
    )
    with pytest.raises(FormatError, match=reason):
        read_scan(path)


@pytest.mark.parametrize(
    ("suffix", "data"),
    [("pcd", "ascii"), ("pcd", "binary"), ("pcd", "binary_compressed"),
     ("ply", ""), ("3d", ""), ("bin", "")],
)  # fmt: skip
def test_every_truncation_is_an_error_or_a_prefix(tmp_path: Path, suffix: str, data: str) -> None:
    path = tmp_path / f"a.{suffix}"
    frame = scan(6)
    if suffix == "pcd":
        frame = frame.replace(
            format=ScanFormat(
                "pcd",
                tuple((name, "<f4", 1) for name in ("x", "y", "z", "intensity")),
                {"pairs": (("data", data),)},
            )
        )
    frame.write(path)
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        try:
            part = read_scan(path)
        except FormatError:
            continue
        text = suffix == "3d" or (data == "ascii" and suffix == "pcd")
        assert suffix == "bin" or text
        assert np.array_equal(part.points[:-1], frame.points[: max(0, part.num_points - 1)])


PLY_TEXT = PLY.format(format="ascii")


@pytest.mark.parametrize(
    ("suffix", "text", "reason"),
    [
        ("ply", "ply\nformat ascii 1.0\nelement face 0\nend_header\n", "vertex that comes first"),
        ("ply", PLY_TEXT.replace("float z", "list uchar int z"), "no lists"),
        ("ply", PLY_TEXT + "1 2 3 4\n4 5 6 7 800000\n", "echo: expected an integer"),
        ("ply", PLY_TEXT + "1 2 3 4 5 6\n4 5 6 7 8\n", "more values on the line"),
        (
            "ply",
            PLY_TEXT + "1 2 3 256 5\n4 5 6 7 8\n",
            "reflectance: expected an integer",
        ),
        (
            "ply",
            PLY_TEXT + "1 2e99 3 4 5\n4 5 6 7 8\n",
            "a number that fits a float",
        ),
        (
            "ply",
            PLY_TEXT + "1e999 2 3 4 5\n4 5 6 7 8\n",
            "a number that fits a double",
        ),
        ("ply", PLY_TEXT + "1e99 2 3 4 5\n4 5 6 7 8\n", "that fit a float"),
        ("ply", PLY_TEXT.replace("vertex 2", "vertex 2000000000"), "claimed"),
        ("3d", "1 2\n", "expected 3 numbers, got 2"),
        ("3d", "1 2 3\n1 2 3 4\n", "line 2: expected 3 numbers, got 4"),
        ("3d", "1 nan 3\n", "a coordinate: expected a finite number"),
        ("3d", "1 " * 100 + "\n", "more than 64 numbers"),
        ("3d", "1e60 0 0\n", "coordinates that fit a float"),
    ],
)
def test_damaged_text(tmp_path: Path, suffix: str, text: str, reason: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text(text)
    with pytest.raises(FormatError, match=reason) as caught:
        read_scan(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("package", "name", "extra"),
    [("laspy", "a.las", "las"), ("laspy", "a.laz", "las"), ("pye57", "a.e57", "e57")],
)
def test_a_missing_package_names_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, name: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / name).write_bytes(b"ASTM-E57")
    with pytest.raises(MissingExtraError, match=rf"pip install 'manip3d\[{extra}\]'"):
        read_scan(tmp_path / name)
    with pytest.raises(MissingExtraError, match=package):
        scan(3).write(tmp_path / name)


def test_missing_packages_of_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "yaml", None)
    (tmp_path / "c.yaml").write_text("lasers: []")
    with pytest.raises(MissingExtraError, match=r"manip3d\[velodyne\]"):
        capture.read_velodyne_calibration(tmp_path / "c.yaml")
    monkeypatch.setitem(sys.modules, "ouster", None)
    monkeypatch.setitem(sys.modules, "ouster.sdk", None)  # which an earlier test may have imported
    with pytest.raises(MissingExtraError, match=r"manip3d\[ouster\]"):
        capture.open(f"ouster:{tmp_path / 'a.pcap'}")


def test_nuscenes_has_five_columns(tmp_path: Path) -> None:
    """Five columns are recognised; reading four would silently misplace every number."""
    rows = np.random.default_rng(0).normal(size=(40, 5)).astype(np.float32)
    rows[:, 4] = np.arange(40) % 32
    path = tmp_path / "LIDAR_TOP.pcd.bin"
    path.write_bytes(rows.tobytes())
    frame = read_scan(path)
    assert np.array_equal(frame.points, rows[:, :3])
    assert frame.intensity is not None
    assert np.array_equal(frame.intensity, rows[:, 3])
    assert frame.ring is not None
    assert frame.ring.tolist() == rows[:, 4].tolist()
    frame.write(tmp_path / "again.pcd.bin.xz")
    again = read_scan(tmp_path / "again.pcd.bin.xz")
    assert np.array_equal(again.points, frame.points)
    frame.write(tmp_path / "same.pcd.bin")
    assert (tmp_path / "same.pcd.bin").read_bytes() == path.read_bytes()
    path.write_bytes(rows.tobytes()[:-4])
    with pytest.raises(FormatError, match=r"byte 796: .*multiple of 20 bytes"):
        read_scan(path)
    rows[7, 4] = 0.5
    path.write_bytes(rows.tobytes())
    with pytest.raises(FormatError, match=r"ring of point 7: expected a whole number .* got 0\.5"):
        read_scan(path)


def test_a_scan_without_rings_has_none_after_nuscenes_format(tmp_path: Path) -> None:
    """Points of several lasers with one number make no lines, so that no scanner is recognised."""
    frame = scan(50).replace(ring=None)
    frame.write(tmp_path / "a.pcd.bin")
    again = read_scan(tmp_path / "a.pcd.bin")
    assert again.ring is None
    assert not again.fields
    again.write(tmp_path / "b.pcd.bin")
    assert (tmp_path / "b.pcd.bin").read_bytes() == (tmp_path / "a.pcd.bin").read_bytes()


COLUMNS = ("x", "y", "z", "intensity", "column_5", "column_6", "column_7")


def rows_of_a_turn(columns: int, num_points: int) -> np.ndarray:
    """Return rows of a scan by 32 lasers: x, y, z, intensity, ring, time, azimuth."""
    rng = np.random.default_rng(columns)
    firing, ring = np.divmod(np.arange(num_points), 32)
    azimuth = firing * (2.0 * np.pi * 32 / num_points)
    reach = 10.0 + 5.0 * np.sin(3.0 * azimuth) + rng.normal(0.0, 0.02, num_points)
    position = reach * np.stack([np.cos(azimuth), np.sin(azimuth), np.tan((ring - 24) / 50.0)])
    others = (rng.integers(0, 256, num_points), ring, firing * 5e-5, np.degrees(azimuth))
    return np.column_stack([*position, *others])[:, :columns].astype(np.float32)


@pytest.mark.parametrize("order", ["firings", "rings", "shuffled"])
@pytest.mark.parametrize("num_points", [20_000, 20_001])  # whole rows of four floats, or not
@pytest.mark.parametrize("columns", [4, 5, 6, 7])
def test_the_values_of_a_bin_tell_how_many_columns_it_has(
    tmp_path: Path, columns: int, num_points: int, order: str
) -> None:
    rows = rows_of_a_turn(columns, num_points)
    number = np.arange(num_points)
    if order == "rings":
        rows = rows[np.lexsort((number, number % 32))]
    elif order == "shuffled":
        rows = rows[np.random.default_rng(1).permutation(num_points)]
    path = tmp_path / "scan.bin"
    path.write_bytes(rows.tobytes())
    frame = read_scan(path)
    assert frame.format is not None
    assert [name for name, _, _ in frame.format.columns] == list(COLUMNS[:columns])
    assert np.array_equal(frame.points, rows[:, :3])
    assert frame.intensity is not None
    assert np.array_equal(frame.intensity, rows[:, 3])
    for number, name in enumerate(COLUMNS[4:columns], 4):
        assert np.array_equal(frame.fields[name], rows[:, number])
    frame.write(tmp_path / "again.bin")
    assert (tmp_path / "again.bin").read_bytes() == path.read_bytes()
    frame.write(tmp_path / "scan.ply")
    assert np.array_equal(read_scan(tmp_path / "scan.ply").points, frame.points)
    path.write_bytes(rows.tobytes()[:-4])
    with pytest.raises(FormatError, match=f"ends within a point: .* multiple of {4 * columns} b"):
        read_scan(path)


@pytest.mark.parametrize("columns", [3, 4, 7])
@pytest.mark.parametrize("num_points", [20_000, 20_001])
def test_shuffled_points_in_a_hall_tell_how_many_columns_they_have(
    tmp_path: Path, columns: int, num_points: int
) -> None:
    """Heights are alike, x and y are not: columns differ little less from each other than from the
    next ones. Columns beyond the fourth are normals."""
    rng = np.random.default_rng(3)
    angle, reach = rng.uniform(0.0, 2.0 * np.pi, num_points), rng.uniform(1.0, 6.0, num_points)
    position = np.column_stack(
        [reach * np.cos(angle), reach * np.sin(angle), rng.normal(size=num_points)]
    )
    rest = rng.normal(size=(num_points, 4)) / 2.0
    rows = np.column_stack([position, rest])[:, :columns].astype(np.float32)
    path = tmp_path / "scan.bin"
    path.write_bytes(rows.tobytes())
    frame = read_scan(path)
    assert frame.format is not None
    assert len(frame.format.columns) == columns
    assert np.array_equal(frame.points, rows[:, :3])


@pytest.mark.parametrize("seed", range(20))
def test_noise_tells_no_columns(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "scan.bin"
    rows = np.random.default_rng(seed).normal(size=(21_000, 4)).astype(np.float32)
    path.write_bytes(rows.tobytes())
    assert read_scan(path).num_points == len(rows)


def test_few_or_equal_values_tell_no_columns(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"
    for rows in (rows_of_a_turn(5, 800), np.zeros((20_000, 5), np.float32)):
        path.write_bytes(rows.tobytes())
        assert read_scan(path).num_points == rows.size // 4


def test_columns_that_a_reader_could_not_tell_are_not_written(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"
    path.write_bytes(rows_of_a_turn(5, 20_000).tobytes())
    few = read_scan(path).select(np.arange(800))
    with pytest.raises(InputError, match=r"do not tell a reader of \.bin that each point has 5"):
        few.write(tmp_path / "few.bin")
    assert not (tmp_path / "few.bin").exists()


def test_four_columns_that_resemble_those_of_the_next_row_are_four(tmp_path: Path) -> None:
    row = np.arange(28_800)
    radius = np.where(row % 2, 5, 60)
    azimuth = row // 2 * 1e-4
    rows = np.column_stack([
        radius * np.cos(azimuth),
        radius * np.sin(azimuth + 0.8),
        np.full(row.shape, -1 / 3),
        np.random.default_rng(1).uniform(size=row.shape),
    ]).astype(np.float32)  # fmt: skip
    path = tmp_path / "scan.bin"
    path.write_bytes(rows.tobytes())
    assert read_scan(path).num_points == len(rows)


@pytest.mark.parametrize("columns", [4, 6])
def test_a_pcd_bin_has_five_columns_or_is_refused(tmp_path: Path, columns: int) -> None:
    path = tmp_path / "scan.pcd.bin"
    path.write_bytes(rows_of_a_turn(columns, 20_000).tobytes())
    expected = f"rows look like {columns} floats each; a .pcd.bin has 5 .* rename the file"
    with pytest.raises(FormatError, match=expected):
        read_scan(path)


def test_messages_show_the_bytes_of_files_as_escapes(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"a\xff\x1b[31m.pcd")
    path.write_bytes(b"VERSION 0.7\nFIELDS x \xff\x1b[2J\nSIZE 4 4\nTYPE F Q\n")
    with pytest.raises(FormatError) as caught:
        read_scan(path)
    assert str(caught.value).isprintable()
    assert r"a\xff\x1b[31m.pcd" in str(caught.value)
    assert caught.value.file == str(path)
    with pytest.raises(FileNotFoundError) as missing:
        read_scan(tmp_path / os.fsdecode(b"b\xff.pcd"))
    assert missing.value.filename == str(tmp_path / os.fsdecode(b"b\xff.pcd"))


def test_rows_of_the_file_are_known_where_points_were_dropped(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_bytes("binary"))
    frame = read_scan(path)
    assert frame.file_rows is not None
    assert frame.file_rows.tolist() == [0, 1, 3]
    some = frame.select([2, 0])
    assert some.file_rows is not None
    assert some.file_rows.tolist() == [3, 0]
    added = frame.with_points(np.zeros((2, 3), np.float32), source_index=[-1, 2])
    assert added.file_rows is not None
    assert added.file_rows.tolist() == [-1, 3]
    with pytest.raises(InputError, match="file_rows: expected integers"):
        frame.replace(file_rows=np.zeros(3))
    with pytest.raises(InputError, match="file_rows: expected 3 rows"):
        frame.replace(file_rows=np.zeros(2, np.int64))
    np.zeros((3, 4), np.float32).tofile(tmp_path / "a.bin")
    assert read_scan(tmp_path / "a.bin").file_rows is None


def organised_pcd(path: Path, dropped: int | None = None) -> LidarFrame:
    """An organised cloud of 4 x 5 pixels, one of them perhaps without a return."""
    points = np.arange(60, dtype=np.float32).reshape(20, 3)
    if dropped is not None:
        points[dropped] = np.nan
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points.tolist())
    path.write_text(
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 4\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 20\nDATA ascii\n{rows}"
    )
    return read_scan(path)


@pytest.mark.parametrize("dropped", [None, 7])
def test_a_cloud_in_another_order_has_no_grid(tmp_path: Path, dropped: int | None) -> None:
    frame = organised_pcd(tmp_path / "organised.pcd", dropped)
    count = frame.num_points
    moved = frame.points + np.float32(0.5)
    in_order = np.arange(count)
    twice = np.maximum(in_order, 1)
    for rows in (in_order, in_order.astype(np.uint64), in_order - count, in_order >= 0):
        assert grid_of(frame.select(rows)) == (4, 5)
    assert grid_of(frame.with_points(moved, source_index=in_order)) == (4, 5)
    for rows in (in_order[::-1], twice, in_order[::-1] - count):
        assert grid_of(frame.select(rows)) is None
    for rows in (in_order[::-1], twice, in_order - 1):
        changed = frame.with_points(moved, source_index=rows)
        assert grid_of(changed) is None
        changed.write(tmp_path / "changed.pcd")
        assert b"HEIGHT 1\n" in (tmp_path / "changed.pcd").read_bytes()


def test_selected_points_keep_their_rows_of_the_file(tmp_path: Path) -> None:
    frame = organised_pcd(tmp_path / "organised.pcd")
    assert frame.select(np.ones(20, np.bool_)).file_rows is None
    last = frame.select(frame.points[:, 0] > 50)
    assert last.file_rows is not None
    assert last.file_rows.tolist() == [17, 18, 19]
    once_more = last.select(np.array([2, 0], np.uint8))
    assert once_more.file_rows is not None
    assert once_more.file_rows.tolist() == [19, 17]


def pcd_of(path: Path, names: str, rows: np.ndarray) -> Path:
    """Write a binary PCD of float32 columns."""
    count = len(names.split())
    header = (
        f"VERSION 0.7\nFIELDS {names}\nSIZE {'4 ' * count}\nTYPE {'F ' * count}\n"
        f"COUNT {'1 ' * count}\nWIDTH {len(rows)}\nHEIGHT 1\nPOINTS {len(rows)}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + rows.astype("<f4").tobytes())
    return path


def test_points_at_infinity_are_not_measured(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).uniform(1, 9, (50, 4))
    rows[::5, :3] = np.inf
    frame = read_scan(pcd_of(tmp_path / "a.pcd", "x y z intensity", rows))
    assert (frame.num_points, frame.num_dropped) == (40, 10)
    rows[0, 0] = 1.0
    with pytest.raises(FormatError, match="expected coordinates that fit a float"):
        read_scan(pcd_of(tmp_path / "b.pcd", "x y z intensity", rows))


@pytest.mark.parametrize("shine", [0.0, 0.5])
def test_points_without_a_return_are_no_other_layout(shine: float, tmp_path: Path) -> None:
    """Livox scanners write points without a return as zeros, up to more than half of a scan."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 40.0, (60_000, 4)).astype("<f4")
    gone = rng.random(60_000) < 0.6
    points[gone] = (0.0, 0.0, 0.0, shine)
    points[gone, 3] *= rng.random(gone.sum(), np.float32)
    points.tofile(tmp_path / "a.bin")
    np.testing.assert_array_equal(read_scan(tmp_path / "a.bin").points, points[:, :3])
    points[:, :3] = 0.0  # nothing at all was measured
    points.tofile(tmp_path / "b.bin")
    assert read_scan(tmp_path / "b.bin").num_points == 60_000


def test_bin_files_of_other_layouts_are_refused(tmp_path: Path) -> None:
    """Other layouts are refused, instead of read as x, y, z, intensity with absurd values."""
    rng = np.random.default_rng(0)
    azimuth = np.linspace(0, 6.28, 2000)
    distance = 20 + 5 * np.sin(3 * azimuth) + rng.normal(0, 0.02, 2000)
    points = np.stack(
        [distance * np.cos(azimuth), distance * np.sin(azimuth), -1.7 + 0 * azimuth,
         rng.integers(0, 256, 2000)], axis=1
    ).astype("<f4")  # fmt: skip
    points.tofile(tmp_path / "a.bin")
    np.testing.assert_array_equal(read_scan(tmp_path / "a.bin").points, points[:, :3])
    np.ascontiguousarray(points.T).tofile(tmp_path / "planar.bin")
    with pytest.raises(FormatError, match="got all x first, then all y"):
        read_scan(tmp_path / "planar.bin")
    with_zeros = np.concatenate([np.zeros((30_000, 4), "<f4"), points])
    np.ascontiguousarray(with_zeros.T).tofile(tmp_path / "planar_zeros.bin")
    with pytest.raises(FormatError, match="got all x first, then all y"):
        read_scan(tmp_path / "planar_zeros.bin")
    records = np.zeros(2000, [("xyz", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])
    records["xyz"] = np.rint((points[:, :3] + 100.0) / 0.005)
    records["intensity"], records["laser"] = points[:, 3], rng.integers(0, 32, 2000)
    records.tofile(tmp_path / "nclt.bin")
    with pytest.raises(FormatError, match=r"numbers above 1e\+09|expected a finite number"):
        read_scan(tmp_path / "nclt.bin")


@pytest.mark.parametrize(
    ("columns", "order"),
    [*((c, order) for c in (4, 5, 6) for order in ("firing", "laser")), (4, "shuffled")],
)
def test_planes_are_told_from_rows_by_where_their_numbers_differ(
    tmp_path: Path, columns: int, order: str
) -> None:
    """Neighbours are of other lasers, and a third of the firings have no return."""
    rng = np.random.default_rng(columns)
    column, laser = np.divmod(np.arange(64 * 300), 64)
    azimuth, slope = column * 2.0 * np.pi / 300.0, np.tan(np.radians(rng.permutation(64) / 2 - 25))
    reach = np.minimum(12.0 + 5.0 * np.sin(3.0 * azimuth), -1.8 / np.minimum(slope[laser], -0.05))
    points = np.stack(
        [reach * np.cos(azimuth), reach * np.sin(azimuth), reach * slope[laser],
         rng.integers(0, 256, len(column)), laser, column * 1e-4], axis=1
    )[:, :columns].astype("<f4")  # fmt: skip
    points[rng.random(len(points)) < 0.3] = 0.0
    if order != "firing":
        points = points[np.argsort(laser, kind="stable") if order == "laser" else
                        rng.permutation(len(points))]  # fmt: skip
    points.tofile(tmp_path / "rows.bin")
    np.testing.assert_array_equal(read_scan(tmp_path / "rows.bin").points, points[:, :3])
    np.ascontiguousarray(points.T).tofile(tmp_path / "planes.bin")
    with pytest.raises(FormatError, match="got all x first, then all y"):
        read_scan(tmp_path / "planes.bin")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rows_of_a_cube_in_the_order_of_an_axis_are_no_planes(tmp_path: Path, axis: int) -> None:
    """Sorted rows are read as rows, although the parts of the file differ as in planes."""
    for count in (120, 21_000):
        rows = np.random.default_rng(axis).uniform(-1.0, 1.0, (count, 4)).astype("<f4")
        rows = rows[np.argsort(rows[:, axis])]
        rows.tofile(tmp_path / "a.bin")
        np.testing.assert_array_equal(read_scan(tmp_path / "a.bin").points, rows[:, :3])


def test_intensities_that_are_all_nan_are_none(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Intensities that are all NaN, as some drivers write them, are read as none."""
    rows = np.random.default_rng(0).uniform(1, 9, (50, 4))
    rows[:, 3] = np.nan
    path = pcd_of(tmp_path / "a.pcd", "x y z intensity", rows)
    frame = read_scan(path)
    assert frame.intensity is None
    assert "a.pcd: 50 of 50 intensities are NaN: the scan has none" in caplog.text
    write_scan(frame, tmp_path / "b.pcd")
    again = read_scan(tmp_path / "b.pcd")
    np.testing.assert_array_equal(again.points, frame.points)
    rows[:30, 3] = 0.5  # a scan joined to one without intensities
    frame = read_scan(pcd_of(tmp_path / "c.pcd", "x y z intensity", rows))
    assert frame.intensity is None
    np.testing.assert_array_equal(frame.fields["intensity"], rows[:, 3].astype(np.float32))
    rows[40, 3] = np.inf
    with pytest.raises(FormatError, match=r"point 30: .* got nan; 20 of 50 points have such"):
        read_scan(pcd_of(tmp_path / "c.pcd", "x y z intensity", rows))


@pytest.mark.parametrize("is_whole", [True, False])
def test_rings_may_be_floats_where_they_are_whole(is_whole: bool, tmp_path: Path) -> None:
    rows = np.random.default_rng(0).uniform(1, 9, (50, 4))
    rows[:, 3] = np.arange(50) % 32
    rows[7, 3] += 0.0 if is_whole else 0.5
    frame = read_scan(pcd_of(tmp_path / "a.pcd", "x y z ring", rows))
    if is_whole:
        assert frame.ring is not None
        assert frame.ring.tolist() == rows[:, 3].tolist()
    else:
        assert frame.ring is None
        np.testing.assert_array_equal(frame.fields["ring"], rows[:, 3].astype(np.float32))
    write_scan(frame, tmp_path / "b.pcd")
    np.testing.assert_array_equal(
        np.frombuffer((tmp_path / "b.pcd").read_bytes()[-800:], "<f4").reshape(50, 4),
        rows.astype(np.float32),
    )


@pytest.mark.parametrize("suffix", [".bin", ".pcd.bin"])
@pytest.mark.parametrize("digits", [3, None])
def test_numbers_of_64_bits_are_refused(tmp_path: Path, suffix: str, digits: int | None) -> None:
    """Numbers of 64 bits would be read as twice as many points with wrong coordinates."""
    columns = 4 if suffix == ".bin" else 5
    numbers = np.random.default_rng(0).normal(0.0, 20.0, (3000, columns)).astype(np.float32)
    wide = numbers.astype(np.float64)
    if digits is not None:
        wide = wide.round(digits)
    wide.tofile(tmp_path / f"wide{suffix}")
    with pytest.raises(FormatError):
        read_scan(tmp_path / f"wide{suffix}")
    if suffix == ".bin":
        numbers[7] = 3e12  # a damaged value is no sign of other numbers
        numbers.tofile(tmp_path / "scan.bin")
        assert read_scan(tmp_path / "scan.bin").num_points == 3000


@pytest.mark.parametrize(
    "names",
    [("x", "y", "z", "scalar_Intensity", "scalar_ring"), ("X", "Y", "Z", "Reflectance", "RING")],
)
def test_names_of_columns_in_other_letters(names: tuple[str, ...], tmp_path: Path) -> None:
    """Names of columns by CloudCompare and others are recognised, and written back unchanged."""
    rows = np.float32([[1, 2, 3, 0.5, 7], [4, 5, 6, 0.25, 9]])
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    path = tmp_path / "a.ply"
    path.write_bytes(head.encode() + rows.tobytes())
    frame = read_scan(path)
    assert frame.points.tolist() == rows[:, :3].tolist()
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [0.5, 0.25]
    assert frame.ring is not None
    assert frame.ring.tolist() == [7, 9]
    assert not frame.fields
    frame.write(tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == path.read_bytes()
    both = np.zeros(2, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"),
                        ("Intensity", "f4")])  # fmt: skip
    both["Intensity"] = 3.0
    np.save(tmp_path / "c.npy", both)
    assert list(read_scan(tmp_path / "c.npy").fields) == ["Intensity"]


def test_whole_numbers_in_capital_columns_are_no_coordinates(tmp_path: Path) -> None:
    """Integers in X, Y and Z, as in laspy's records, are scaled steps and no coordinates."""
    np.save(tmp_path / "a.npy", np.zeros(9, [("X", "i4"), ("Y", "i4"), ("Z", "i4")]))
    with pytest.raises(FormatError, match="x, y, z not found"):
        read_scan(tmp_path / "a.npy")


@pytest.mark.parametrize("suffix", ["bin", "pcd.bin", "ply", "xyz", "pcd"])
def test_an_intensity_of_several_numbers_is_no_intensity(tmp_path: Path, suffix: str) -> None:
    header = "VERSION .7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 4\n"
    rows = "\n".join(f"{k} 2 3 5 5 5 5" for k in range(8))
    source = tmp_path / "a.pcd"
    source.write_text(f"{header}WIDTH 8\nHEIGHT 1\nPOINTS 8\nDATA ascii\n{rows}\n")
    frame = read_scan(source)
    assert frame.intensity is None
    write_scan(frame, tmp_path / f"b.{suffix}")
    back = read_scan(tmp_path / f"b.{suffix}")
    assert np.array_equal(back.points, frame.points)
    if suffix.endswith("bin"):
        assert back.intensity is not None
        assert not back.intensity.any()


@pytest.mark.parametrize("off", [0.0, 2e-7, 1e-3])
def test_the_points_of_veloview_stand_in_its_file_twice(tmp_path: Path, off: float) -> None:
    """VeloView writes coordinates in 32 and in 64 bits; they are refused if they differ."""
    path = tmp_path / "frame.csv"
    axes = '"Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2","X","Y","Z"'
    rows = (f"{k},2.5,{-k},{k + off:.9f},2.5,{-k},{10 * k},{k}" for k in range(5))
    path.write_text(f'{axes},"intensity","laser_id"\n' + "\n".join(rows))
    if off > 1e-6:
        with pytest.raises(FormatError, match="field x is named twice"):
            read_scan(path)
        return
    frame = read_scan(path)
    assert frame.points.tolist() == [[k, 2.5, -k] for k in range(5)]
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [0, 10, 20, 30, 40]
    frame.write(tmp_path / "again.csv")
    assert np.array_equal(read_scan(tmp_path / "again.csv").points, frame.points)


@pytest.mark.parametrize(("fields", "twice"), [
    ("x y z x", "x"), ("x y z z", "z"), ("x y z intensity intensity", ""), ("x y z _ _", ""),
])  # fmt: skip
def test_a_coordinate_that_a_pcd_names_twice_is_refused(
    tmp_path: Path, fields: str, twice: str
) -> None:
    """A coordinate that is named twice is refused; of other names the first column is read."""
    count = len(fields.split())
    rows = "\n".join(" ".join(str(10 * i + k) for k in range(count)) for i in range(3))
    path = tmp_path / "a.pcd"
    path.write_text(
        f"FIELDS {fields}\nSIZE{' 4' * count}\nTYPE{' F' * count}\nCOUNT{' 1' * count}\nWIDTH 3\n"
        f"HEIGHT 1\nPOINTS 3\nDATA ascii\n{rows}\n"
    )
    if twice:
        with pytest.raises(FormatError, match=f"field {twice} is named twice"):
            read_scan(path)
        return
    frame = read_scan(path)
    assert frame.points[:, 2].tolist() == [2, 12, 22]
    if "intensity" in fields:
        assert frame.intensity is not None
        assert frame.intensity.tolist() == [3, 13, 23]
