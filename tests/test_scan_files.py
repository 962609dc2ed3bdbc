"""Scans to files and back; what damaged files say."""

from __future__ import annotations

import gzip
import lzma
import struct
from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, InputError, LidarFrame, read_scan
from manip3d.io import write_scan


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


def test_names_that_are_no_scans(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a point file \(.*\.bin"):
        read_scan(tmp_path / "scan.xyz")
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
    with pytest.raises(FormatError, match="more than max_bytes = 1000"):
        read_scan(path, max_bytes=1000)
    assert read_scan(path, max_bytes=100 << 20).num_points == 5 << 20
