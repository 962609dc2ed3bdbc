"""Scans as archives of NumPy arrays, as Open3D writes and reads its point clouds."""

from __future__ import annotations

import contextlib
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import FormatError, LidarFrame, viewer
from manip3d.cli.kinds import kind_of
from manip3d.io import ReadLimits, read_scan, write_scan

POINTS = np.random.default_rng(4).normal(scale=9.0, size=(30, 3)).astype(np.float32)
SHARES = np.arange(90).reshape(30, 3) / 89.0
NORMALS = np.tile(np.float32([0, 0, 1]), (30, 1))


def saved(folder: Path, **arrays: NDArray[Any]) -> Path:
    np.savez(folder / "a.npz", **arrays)
    return folder / "a.npz"


@pytest.mark.parametrize("key", ["positions", "points"])
@pytest.mark.parametrize("colors", [SHARES, np.rint(SHARES * 255).astype(np.uint8)])
def test_clouds_of_open3d(key: str, colors: NDArray[Any], tmp_path: Path) -> None:
    path = saved(
        tmp_path, **{key: POINTS}, colors=colors, normals=NORMALS,
        intensity=SHARES[:, :1], label=np.arange(30),
    )  # fmt: skip
    assert kind_of(str(path)) == viewer.kind_of(path) == "scan"
    frame = read_scan(path)
    np.testing.assert_array_equal(frame.points, POINTS)
    assert frame.intensity is not None
    np.testing.assert_array_equal(frame.intensity, SHARES[:, 0].astype(np.float32))
    assert frame.origin is None
    assert {"red", "green", "blue", "nx", "ny", "nz", "label"} == set(frame.fields)
    assert frame.fields["green"].tolist() == np.rint(SHARES[:, 1] * 255).tolist()
    frame.write(tmp_path / "b.npz")
    with np.load(tmp_path / "b.npz") as again:
        assert set(again) == {"positions", "colors", "normals", "intensity", "label"}
        np.testing.assert_array_equal(again["positions"], POINTS)
        assert again["colors"].dtype == np.uint8
        assert again["colors"].shape == again["normals"].shape == (30, 3)
        assert again["intensity"].shape == again["label"].shape == (30, 1)
    frame.write(tmp_path / "c.ply")
    assert read_scan(tmp_path / "c.ply").fields["red"].dtype == np.uint8


def test_scans_of_a2d2(tmp_path: Path) -> None:
    """Its arrays have names with a prefix, and one states which points count."""
    valid = np.arange(30) % 3 > 0
    shine = np.arange(30, dtype=np.int64)
    attributes = {"reflectance": shine, "valid": valid, "timestamp": shine + 10**15}
    path = saved(
        tmp_path, pcloud_points=POINTS.astype(np.float64),
        **{f"pcloud_attr.{name}": values for name, values in attributes.items()},
    )  # fmt: skip
    assert kind_of(str(path)) == viewer.kind_of(path) == "scan"
    frame = read_scan(path)
    np.testing.assert_array_equal(frame.points, POINTS)
    assert frame.intensity is not None
    assert frame.intensity.tolist() == shine.tolist()
    assert frame.fields["valid"].tolist() == valid.tolist()
    assert frame.fields["timestamp"].tolist() == (shine + 10**15).tolist()


def test_coordinates_of_64_bits_and_of_maps_are_kept(tmp_path: Path) -> None:
    for offset in (0.0, 4e6):
        exact = POINTS.astype(np.float64) + 1e-9 + offset
        frame = read_scan(saved(tmp_path, positions=exact))
        frame.write(tmp_path / "b.npz")
        with np.load(tmp_path / "b.npz") as again:
            np.testing.assert_array_equal(again["positions"], exact)


def test_scans_of_other_formats_and_archives_of_one_array(tmp_path: Path) -> None:
    fields = {"file": np.arange(30, dtype=np.uint16), "red": np.full(30, 7, np.uint8),
              "green": np.full(30, 8, np.uint8), "blue": np.full(30, 9, np.uint8)}  # fmt: skip
    LidarFrame(POINTS, SHARES[:, 0].astype(np.float32), fields=fields).write(tmp_path / "b.npz")
    frame = read_scan(tmp_path / "b.npz")
    assert frame.fields["file"].tolist() == list(range(30))
    assert frame.fields["blue"].tolist() == [9] * 30
    np.savez(tmp_path / "rows.npz", np.column_stack([POINTS, NORMALS[:, 0]]))
    assert kind_of(str(tmp_path / "rows.npz")) == "scan"
    np.testing.assert_array_equal(read_scan(tmp_path / "rows.npz").points, POINTS)


@pytest.mark.parametrize("key", ["points", "positions", "any"])
def test_four_columns_are_points_with_intensity(key: str, tmp_path: Path) -> None:
    frame = read_scan(saved(tmp_path, **{key: np.column_stack([POINTS, SHARES[:, 0]])}))
    np.testing.assert_array_equal(frame.points, POINTS)
    np.testing.assert_array_equal(frame.intensity, SHARES[:, 0].astype(np.float32))


def test_columns_behind_points_beside_other_arrays(tmp_path: Path) -> None:
    """An array of its own goes before a column without a name."""
    wide = np.column_stack([POINTS, SHARES[:, 0], NORMALS[:, 0]])
    frame = read_scan(saved(tmp_path, points=wide, label=np.arange(30)))
    np.testing.assert_array_equal(frame.points, POINTS)
    np.testing.assert_array_equal(frame.intensity, SHARES[:, 0].astype(np.float32))
    assert frame.fields["label"].tolist() == list(range(30))
    np.testing.assert_array_equal(frame.fields["column_5"], NORMALS[:, 0])
    other = np.linspace(0, 1, 30, dtype=np.float32)
    frame = read_scan(saved(tmp_path, points=wide, intensity=other))
    np.testing.assert_array_equal(frame.intensity, other)


def test_an_array_for_each_column(tmp_path: Path) -> None:
    x, y, z = POINTS.T
    ring = np.arange(30, dtype=np.uint16) % 4
    path = saved(tmp_path, x=x, y=y, z=z[:, None], intensity=SHARES[:, 0], ring=ring, t=y * 2)
    assert kind_of(str(path)) == viewer.kind_of(path) == "scan"
    frame = read_scan(path)
    np.testing.assert_array_equal(frame.points, POINTS)
    np.testing.assert_array_equal(frame.intensity, SHARES[:, 0].astype(np.float32))
    np.testing.assert_array_equal(frame.ring, ring)
    np.testing.assert_array_equal(frame.fields["t"], y * 2)
    with pytest.warns(UserWarning, match="are left out: pose"):
        assert read_scan(saved(tmp_path, x=x, y=y, z=z, pose=np.eye(4))).num_points == 30


def test_an_array_of_objects_beside_points_is_left_out(tmp_path: Path) -> None:
    x, y, z = POINTS.T
    told = np.array([{"sensor": "front"}], dtype=object)
    for arrays in ({"x": x, "y": y, "z": z, "told": told}, {"lidar": POINTS, "told": told}):
        path = saved(tmp_path, **arrays)
        assert kind_of(str(path)) == "scan"
        with pytest.warns(UserWarning, match="are left out: told"):
            assert read_scan(path).num_points == 30


@pytest.mark.parametrize("key", ["pointcloud", "lidar"])
def test_the_only_array_of_points_has_any_name(key: str, tmp_path: Path) -> None:
    rows = np.column_stack([POINTS, SHARES[:, 0]])
    path = saved(tmp_path, **{key: rows, "pose": np.eye(4), "label": np.arange(30)})
    assert kind_of(str(path)) == viewer.kind_of(path) == "scan"
    with pytest.warns(UserWarning, match="are left out: pose"):
        frame = read_scan(path)
    np.testing.assert_array_equal(frame.points, POINTS)
    np.testing.assert_array_equal(frame.intensity, SHARES[:, 0].astype(np.float32))
    assert frame.fields["label"].tolist() == list(range(30))


def test_points_beside_an_image_are_not_chosen(tmp_path: Path) -> None:
    """They may be its calibration; x, y and z may be images or their axes, too."""
    image = np.ones((30, 40), np.float32)
    x, y, z = POINTS.T
    square = np.ones((30, 30), np.float32)
    for arrays in (
        {"depth": image, "corners": POINTS},
        {"depth": image[None], "corners": POINTS},
        {"depth": image.ravel(), "corners": POINTS},
        {"depth": np.ones((30, 4), np.float32), "pose": np.eye(4)},
        {"img": np.ones((3, 30, 40), np.float32), "tracks": np.ones((100, 5))},
        {"x": image, "y": image, "z": image},
        {"x": x, "y": y, "z": z, "depth": np.ones((48, 64), np.float32)},
        {"x": x, "y": y, "z": z, "depth": square},
        {"x": x, "y": y, "z": z, "volume": np.ones((30, 30, 30), np.float32)},
        {"x": x, "y": y, "z": z, "img": np.ones((3, 48, 64), np.uint8)},
        {"x": x, "y": y, "z": z[:3], "depth": square},
    ):
        path = saved(tmp_path, **arrays)
        assert kind_of(str(path)) == viewer.kind_of(path) == "depth"
        with pytest.raises(FormatError, match="expected an array named positions"):
            read_scan(path)


def test_a_depth_for_each_point_is_a_column(tmp_path: Path) -> None:
    x, y, z = POINTS.T
    depth, features = np.arange(30, dtype=np.float32), np.ones((30, 12), np.float32)
    for arrays in (
        {"x": x, "y": y, "z": z, "depth": depth, "features": features},
        {"lidar": POINTS, "depth": depth[:, None]},
    ):
        path = saved(tmp_path, **arrays)
        assert kind_of(str(path)) == viewer.kind_of(path) == "scan"
        frame = read_scan(path)
        np.testing.assert_array_equal(frame.points, POINTS)
        np.testing.assert_array_equal(frame.fields["depth"], depth)


def test_points_with_named_columns(tmp_path: Path) -> None:
    named = np.empty(30, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4")])
    named["x"], named["y"], named["z"] = POINTS.T
    named["intensity"] = SHARES[:, 0]
    np.savez(tmp_path / "named.npz", points=named)  # as pyntcloud writes a cloud
    assert kind_of(str(tmp_path / "named.npz")) == "scan"
    frame = read_scan(tmp_path / "named.npz")
    np.testing.assert_array_equal(frame.points, POINTS)
    np.testing.assert_array_equal(frame.intensity, SHARES[:, 0].astype(np.float32))


def test_depth_images_stay_depth_images(tmp_path: Path) -> None:
    for arrays in ({"depth": np.zeros((30, 40), np.float32)}, {"a": np.zeros((30, 40), np.uint16)}):
        path = saved(tmp_path, **arrays)
        assert kind_of(str(path)) == viewer.kind_of(path) == "depth"


def test_arrays_of_other_lengths_are_named(tmp_path: Path) -> None:
    path = saved(tmp_path, positions=POINTS, colors=SHARES[:9], pose=np.eye(4))
    with pytest.warns(UserWarning, match="are left out: colors, pose"):
        assert read_scan(path).num_points == 30


@pytest.mark.parametrize(
    ("arrays", "match"),
    [
        (
            {"a": POINTS, "b": POINTS},
            "array named positions or points or xyz or pcloud_points, or arrays x, y and z of one "
            "length, or a single one of points, beside no image, got a, b",
        ),
        (
            {"x": SHARES[:, 0], "y": SHARES[:, 0], "z": SHARES[:9, 0]},
            "arrays x, y and z of one length, .* got x, y, z",
        ),
        (
            {"x": SHARES[:, 0], "y": SHARES[:, 0], "z": np.full(30, "far")},
            r"x, y, z: expected as many numbers of each, got float64 \(30,\), .* <U3 \(30,\)",
        ),
        ({"positions": POINTS[:, :2]}, "expected \\(N, 3\\) or "),
        ({"positions": np.array([{}], dtype=object)}, "expected an array of numbers"),
        ({"positions": np.full((3, 3), [np.inf, 0.0, 1.0])}, "coordinates that fit a float"),
    ],
)
def test_archives_without_points(arrays: dict[str, Any], match: str, tmp_path: Path) -> None:
    path = saved(tmp_path, **arrays)
    with pytest.raises(FormatError, match=match) as caught:
        read_scan(path)
    assert caught.value.file == str(path)


def test_damaged_archives_are_format_errors(tmp_path: Path) -> None:
    whole = saved(tmp_path, positions=POINTS, colors=SHARES).read_bytes()
    path = tmp_path / "bad.npz"
    random = np.random.default_rng(1)
    for _ in range(200):
        data = bytearray(whole[: int(random.integers(1, len(whole) + 1))])
        for _ in range(int(random.integers(0, 4))):
            data[int(random.integers(len(data)))] = int(random.integers(256))
        path.write_bytes(data)
        assert kind_of(str(path)) in ("scan", "depth")
        with contextlib.suppress(FormatError, UserWarning):  # a warning: damaged colours
            read_scan(path)


def test_archives_that_expand_are_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (8 << 20, 3)}
    )
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("positions.npy", header.getvalue() + bytes(192 << 20))
    with pytest.raises(FormatError, match="set max_bytes"):
        read_scan(tmp_path / "bomb.npz")
    with ReadLimits(max_points=5), pytest.raises(FormatError, match="more than max_points"):
        read_scan(saved(tmp_path, positions=POINTS))


@pytest.mark.parametrize("rows", [[0, 0, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1, 0]])
@pytest.mark.parametrize("suffix", [".npy", ".pcd"])
def test_chosen_points_of_an_organised_cloud_are_written_as_they_were_chosen(
    rows: list[int], suffix: str, tmp_path: Path
) -> None:
    points = np.arange(24, dtype=np.float32).reshape(2, 4, 3) + 1
    points[1, 2] = np.nan
    np.save(tmp_path / "a.npy", points)
    chosen = read_scan(tmp_path / "a.npy").select(rows)
    write_scan(chosen, tmp_path / f"b{suffix}")
    found = read_scan(tmp_path / f"b{suffix}")
    assert np.array_equal(found.points, chosen.points)


def test_columns_named_as_the_arrays_of_open3d_are_kept(tmp_path: Path) -> None:
    colors = dict.fromkeys(("red", "green", "blue"), np.arange(30, dtype=np.uint8))
    fields = {"positions": np.arange(30.0), "positions_2": np.arange(30), **colors}
    frame = LidarFrame(POINTS, fields={**fields, "colors": np.arange(30) + 7})
    with pytest.warns(UserWarning, match="positions as positions_3, colors as colors_2"):
        frame.write(tmp_path / "a.npz")
    found = read_scan(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.fields["positions_3"].tolist() == list(range(30))
    assert found.fields["positions_2"].tolist() == list(range(30))
    assert found.fields["colors_2"].tolist() == list(range(7, 37))
    assert found.fields["green"].tolist() == list(range(30))
