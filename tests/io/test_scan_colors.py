"""Colours and normals of scans: each format gets them under its own names."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import LidarFrame, io
from manip3d.io import read_scan
from manip3d.io._scan_files import names_left_out
from manip3d.lidar import ScanFormat

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-5, 5, (200, 3)).astype(np.float32)
COLORS = RNG.integers(0, 256, (200, 3))
NORMALS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
SUFFIXES = ("ply", "pcd", "las", "e57")


def write(path: Path) -> None:
    """A coloured scan as other programs write it."""
    suffix = path.suffix[1:]
    if suffix in ("ply", "pcd"):
        o3d = pytest.importorskip("open3d")
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
        cloud.colors = o3d.utility.Vector3dVector(COLORS / 255)
        cloud.normals = o3d.utility.Vector3dVector(NORMALS)
        assert o3d.io.write_point_cloud(str(path), cloud)
    elif suffix == "las":
        laspy = pytest.importorskip("laspy")
        header = laspy.LasHeader(point_format=7, version="1.4")
        header.scales = [1e-4] * 3
        las = laspy.LasData(header)
        las.x, las.y, las.z = POINTS.T
        las.red, las.green, las.blue = COLORS.T * 256
        las.write(str(path))
    else:
        pye57 = pytest.importorskip("pye57")
        names = ("cartesianX", "cartesianY", "cartesianZ")
        data = dict(zip(names, POINTS.astype(np.float64).T, strict=True))
        names = ("colorRed", "colorGreen", "colorBlue")
        file = pye57.E57(str(path), mode="w")
        file.write_scan_raw(data | dict(zip(names, COLORS.astype(np.uint8).T, strict=True)))
        file.close()


def colors_seen(path: Path) -> Any:
    """The colours that another program reads, 0 to 255; None: none."""
    suffix = path.suffix[1:]
    if suffix in ("ply", "pcd", "pts"):
        o3d = pytest.importorskip("open3d")
        cloud = o3d.io.read_point_cloud(str(path))
        return np.rint(np.asarray(cloud.colors) * 255) if cloud.has_colors() else None
    if suffix == "las":
        las = pytest.importorskip("laspy").read(path)
        is_colored = "red" in las.point_format.standard_dimension_names
        stored = np.column_stack([las.red, las.green, las.blue]) if is_colored else None
        return None if stored is None else stored // 256
    data = pytest.importorskip("pye57").E57(str(path)).read_scan_raw(0)
    names = ("colorRed", "colorGreen", "colorBlue")
    return np.column_stack([data[n] for n in names]) if names[0] in data else None


@pytest.mark.parametrize(("first", "second"), [*itertools.permutations(SUFFIXES, 2)])
def test_colors_survive_another_format(tmp_path: Path, first: str, second: str) -> None:
    write(tmp_path / f"a.{first}")
    read_scan(tmp_path / f"a.{first}").write(tmp_path / f"b.{second}")
    assert np.array_equal(colors_seen(tmp_path / f"b.{second}"), COLORS)
    read_scan(tmp_path / f"b.{second}").write(tmp_path / f"c.{first}")
    assert np.array_equal(colors_seen(tmp_path / f"c.{first}"), COLORS)


@pytest.mark.parametrize(
    "suffix", ["ply", "pcd", "csv", "pts", "xyz", "bin", "3d", "npy", "las", "e57"]
)
def test_what_is_left_out_is_told(tmp_path: Path, suffix: str) -> None:
    columns = dict(zip(("red", "green", "blue"), COLORS.astype(np.uint8).T, strict=True))
    columns |= dict(zip(("nx", "ny", "nz"), NORMALS.T, strict=True))
    frame = LidarFrame(POINTS, RNG.random(200), fields=columns | {"empty": np.zeros(200)})
    for module in {"las": ["laspy"], "e57": ["pye57"]}.get(suffix, []):
        pytest.importorskip(module)
    written = tmp_path / f"a.{suffix}"
    frame.write(written)
    if suffix in ("ply", "csv"):
        assert set(columns) <= set(read_scan(written).fields)
    told = names_left_out(frame, f".{suffix}")
    assert "empty" not in told
    held = [
        suffix in ("ply", "pcd", "csv", "pts", "las", "e57"),
        suffix in ("ply", "pcd", "csv", "las"),
    ]
    assert told == [name for i, name in enumerate(columns) if not held[i // 3]]


@pytest.mark.parametrize("first", SUFFIXES)
def test_colors_in_texts(tmp_path: Path, first: str) -> None:
    write(tmp_path / f"a.{first}")
    frame = read_scan(tmp_path / f"a.{first}")
    frame.write(tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text().partition("\n")[0].endswith("red,green,blue")
    numbers = np.loadtxt(tmp_path / "b.csv", delimiter=",", skiprows=1)[:, -3:]
    assert np.array_equal(numbers, COLORS * 256 if first == "las" else COLORS)
    frame.write(tmp_path / "b.pts")
    for text in ("b.csv", "b.pts"):
        read_scan(tmp_path / text).write(tmp_path / "c.ply")
        assert np.array_equal(colors_seen(tmp_path / "c.ply"), COLORS)
    columns = (tmp_path / "b.pts").read_text().splitlines()[1].split()
    assert columns[-3:] == [str(value) for value in COLORS[0]]


@pytest.mark.parametrize(("first", "second"), [("ply", "pcd"), ("pcd", "ply")])
def test_normals_survive_another_format(tmp_path: Path, first: str, second: str) -> None:
    o3d = pytest.importorskip("open3d")
    write(tmp_path / f"a.{first}")
    read_scan(tmp_path / f"a.{first}").write(tmp_path / f"b.{second}")
    cloud = o3d.io.read_point_cloud(str(tmp_path / f"b.{second}"))
    np.testing.assert_allclose(np.asarray(cloud.normals), NORMALS, atol=1e-6)


@pytest.mark.parametrize("name", ["rgb", "color", "colors"])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_colors_in_an_array_beside_the_points(tmp_path: Path, name: str, kind: type) -> None:
    values = COLORS.astype(np.uint8) if kind is np.uint8 else (COLORS / 255).astype(np.float32)
    np.savez(tmp_path / "a.npz", **{"points": POINTS, name: values})
    read_scan(tmp_path / "a.npz").write(tmp_path / "b.ply")
    back = read_scan(tmp_path / "b.ply").fields
    assert [back[each].tolist() for each in ("red", "green", "blue")] == COLORS.T.tolist()


def test_colors_of_16_bits_that_hold_8(tmp_path: Path) -> None:
    fields = {n: COLORS[:, i].astype(np.uint16) for i, n in enumerate(("red", "green", "blue"))}
    frame = LidarFrame(POINTS, fields=fields, format=ScanFormat("las"))
    io.write_scan(frame, tmp_path / "a.ply")
    back = read_scan(tmp_path / "a.ply").fields
    assert [back[name].tolist() for name in fields] == COLORS.T.tolist()
    assert back["red"].dtype == np.uint8


def test_colors_of_16_bits_stay_where_the_format_has_them(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    wide = RNG.integers(0, 65536, (200, 3)).astype(np.uint16)
    fields = {n: wide[:, i] for i, n in enumerate(("red", "green", "blue"))}
    io.write_scan(LidarFrame(POINTS, fields=fields, format=ScanFormat("ply")), tmp_path / "a.csv")
    read_scan(tmp_path / "a.csv").write(tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    assert np.array_equal(np.column_stack([las.red, las.green, las.blue]), wide)
    read_scan(tmp_path / "a.csv").write(tmp_path / "a.pcd")
    assert np.array_equal(colors_seen(tmp_path / "a.pcd"), wide // 256)


@pytest.mark.parametrize(
    "fields",
    [
        {"r": [0.5] * 200, "g": [1.0] * 200, "b": [2.0] * 200},  # no whole numbers
        {"red": [70000] * 200, "green": [0] * 200, "blue": [0] * 200},  # no 16 bits
        {"red": [-1] * 200, "green": [0] * 200, "blue": [0] * 200},
        {"red": [1] * 200, "green": [0] * 200},
        {"c3": [1] * 200, "c4": [0] * 200, "c5": [9] * 200, "c6": [7] * 200, "c7": [3] * 200},
    ],
)
def test_numbers_that_are_no_colors_stay(tmp_path: Path, fields: dict[str, Any]) -> None:
    arrays = {name: np.asarray(values) for name, values in fields.items()}
    frame = LidarFrame(POINTS, fields=arrays)
    io.write_scan(frame, tmp_path / "a.csv")
    back = read_scan(tmp_path / "a.csv").fields
    assert {name: values.tolist() for name, values in back.items()} == fields


def test_a_scan_without_points_or_colors(tmp_path: Path) -> None:
    empty = np.empty(0, np.uint8)
    fields = {"red": empty, "green": empty, "blue": empty}
    io.write_scan(LidarFrame(np.empty((0, 3), np.float32), fields=fields), tmp_path / "a.pcd")
    assert list(read_scan(tmp_path / "a.pcd").fields) == ["rgb"]
    io.write_scan(LidarFrame(POINTS), tmp_path / "a.ply")
    assert not read_scan(tmp_path / "a.ply").fields
