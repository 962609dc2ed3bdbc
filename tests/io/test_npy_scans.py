"""Scans as NumPy arrays: which arrays are scans, and what is written back."""

from __future__ import annotations

import errno
import io
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import FormatError, InputError, LidarFrame, viewer
from manip3d.cli.kinds import kind_of
from manip3d.io import read_depth, read_scan

ROWS = np.random.default_rng(3).normal(scale=30.0, size=(40, 8))


def saved(path: Path, array: NDArray[Any]) -> Path:
    np.save(path / "a.npy", array)
    return path / "a.npy"


@pytest.mark.parametrize("columns", range(3, 9))
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", "<f2"])
def test_rows_of_numbers(columns: int, dtype: str, tmp_path: Path) -> None:
    rows = ROWS[:, :columns].astype(dtype)
    for order in (rows, np.asfortranarray(rows)):
        path = saved(tmp_path, order)
        assert kind_of(str(path)) == viewer.kind_of(path) == "scan"
        frame = read_scan(path)
        np.testing.assert_array_equal(frame.points, rows[:, :3].astype(np.float32))
        assert (frame.intensity is not None) == (columns > 3)
        if frame.intensity is not None:
            np.testing.assert_array_equal(frame.intensity, rows[:, 3].astype(np.float32))
        assert list(frame.fields) == [f"column_{i}" for i in range(5, columns + 1)]
        assert frame.origin is None
        frame.write(tmp_path / "b.npy")
        again = np.load(tmp_path / "b.npy")
        assert again.dtype == np.dtype(dtype).newbyteorder("<")
        expected = rows.copy()
        expected[:, 3:4] = rows[:, 3:4].astype(np.float32)  # what a LidarFrame holds
        np.testing.assert_array_equal(again, expected)


def test_structured_arrays_keep_their_fields(tmp_path: Path) -> None:
    fields = [("t", "<u8"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "u1", (3,)),
              ("reflectivity", "<u2"), ("ring", "u1"), ("name", "S4"), ("ok", "?")]  # fmt: skip
    array = np.zeros(5, fields)
    array["t"] = 1 << 60
    array["x"], array["ring"], array["reflectivity"] = np.arange(5), [3, 1, 2, 0, 4], 500
    array["rgb"] = np.arange(15).reshape(5, 3)
    array["ok"][2] = True
    with pytest.warns(UserWarning, match="hold no numbers are left out: name"):
        frame = read_scan(saved(tmp_path, array))
    assert frame.points[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [500.0] * 5
    assert frame.ring is not None
    assert frame.ring.tolist() == [3, 1, 2, 0, 4]
    assert frame.fields["t"].tolist() == [1 << 60] * 5
    frame.write(tmp_path / "b.npy")
    again = np.load(tmp_path / "b.npy")
    assert again.dtype.names == ("t", "x", "y", "z", "rgb", "reflectivity", "ring", "ok")
    for name in again.dtype.names:
        np.testing.assert_array_equal(again[name], array[name])
    organised = read_scan(saved(tmp_path, np.tile(array[["x", "y", "z"]], (4, 1))))
    assert organised.num_points == 20


def test_points_without_coordinates_are_dropped_and_coordinates_of_maps_moved(
    tmp_path: Path,
) -> None:
    rows = np.array([[450123.25, 5412345.5, 1.0], [np.nan, 1, 2], [450124.5, 5412346.5, 2.0]])
    frame = read_scan(saved(tmp_path, rows))
    assert (frame.num_points, frame.num_dropped) == (2, 1)
    assert np.abs(frame.points).max() < 10.0
    frame.write(tmp_path / "b.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "b.npy"), rows[[0, 2]])


def test_other_formats_become_arrays(tmp_path: Path) -> None:
    points = ROWS[:, :3].astype(np.float32)
    for intensity in (None, np.linspace(0, 1, 40, dtype=np.float32)):
        LidarFrame(points, intensity, ring=np.zeros(40, np.uint8)).write(tmp_path / "a.npy")
        array = np.load(tmp_path / "a.npy")
        assert (array.dtype, array.shape) == (np.float32, (40, 3 if intensity is None else 4))
        np.testing.assert_array_equal(array[:, :3], points)


@pytest.mark.parametrize("name", ["a.npy.gz", "a.las.xz", "a.e57.gz"])
def test_formats_that_are_not_written_compressed(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not written compressed"):
        LidarFrame(ROWS[:, :3].astype(np.float32)).write(tmp_path / name)
    assert not (tmp_path / name).exists()


def test_depth_images_are_no_scans(tmp_path: Path) -> None:
    for shape in ((48, 64), (48, 64, 1), (9, 9)):
        path = saved(tmp_path, np.ones(shape, np.float32))
        assert kind_of(str(path)) == viewer.kind_of(path) == "depth"
        assert read_depth(path).shape == shape[:2]
        with pytest.raises(FormatError, match=r"expected \(N, 3\) to \(N, 8\) numbers"):
            read_scan(path)


def header(text: str) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.zeros((2, 3), np.float32))
    whole = stream.getvalue()
    return whole[:10] + text.encode().ljust(117) + b"\n"


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "expected a header"),
        (b"\x93NUMPY\x09\x09junk", "expected a header"),
        (
            header("{'descr':'|O','fortran_order':False,'shape':(2,3)}"),
            r"expected an array of numbers, got object \(2, 3\)",
        ),
        (header("{'descr':'<f4','fortran_order':False,'shape':(2,9)}"), r"got float32 \(2, 9\)"),
        (
            header("{'descr':'<f4','fortran_order':False,'shape':(-2,3)}"),
            "expected a shape",
        ),
        (header("{'descr':'<f4','fortran_order':False,'shape':(2,3)}") + bytes(23), "got 23"),
        (header("{'descr':'<f4','fortran_order':False,'shape':(1<<60,3)}"), "expected a header"),
        (header("{'descr':'<f4','fortran_order':False,'shape':(1000000000000,3)}"), "point|bytes"),
        (header("{'descr':[('a','<f4')],'fortran_order':False,'shape':(1,)}") + bytes(4), "x, y"),
        (header("{'descr':[('x','|O')],'fortran_order':False,'shape':(1,)}") + bytes(8), "."),
    ],
)
def test_hostile_arrays_are_refused(data: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=reason) as caught:
        read_scan(path)
    assert caught.value.file == str(path)


def test_empty_arrays_are_written_and_impossible_shapes_refused(tmp_path: Path) -> None:
    read_scan(saved(tmp_path, ROWS[:0, :4])).write(tmp_path / "b.npy")
    assert np.load(tmp_path / "b.npy").shape == (0, 4)
    for shape in ("(4611686018427387904,4)", "(True,3)"):
        text = f"{{'descr':'<f4','fortran_order':False,'shape':{shape}}}"
        (tmp_path / "c.npy").write_bytes(header(text) + bytes(64))
        with pytest.raises(FormatError):
            read_scan(tmp_path / "c.npy")


def test_truth_values_are_written_back_as_such(tmp_path: Path) -> None:
    columns = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ok", "?"), ("both", "?", (2,))]
    rows = np.zeros(40, columns)
    rows["ok"][::3] = rows["both"][:, 1] = True
    np.save(tmp_path / "a.npy", rows)
    read_scan(tmp_path / "a.npy").write(tmp_path / "b.npy")
    again = np.load(tmp_path / "b.npy")
    assert again.dtype == rows.dtype
    assert np.array_equal(again, rows)


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    frame = LidarFrame(np.ones((100_000, 3), np.float32))
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, kept[1]))
    try:
        with pytest.raises(OSError, match=r"scan\.npy") as caught:
            frame.write(tmp_path / "scan.npy")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)
    assert caught.value.errno == errno.EFBIG
    assert not [*tmp_path.iterdir()]
