"""Depth images as OpenEXR."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError, MissingExtraError, io

OpenEXR = pytest.importorskip("OpenEXR", reason="the extra 'exr' is not installed")

DEPTH = np.linspace(0.5, 4.0, 20 * 30, dtype=np.float32).reshape(20, 30)


def write(path: Path, channels: dict[str, Any], **header: Any) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


@pytest.mark.parametrize(
    "channels",
    [
        {"Z": DEPTH},
        {"whatever": DEPTH},
        {"R": DEPTH, "G": DEPTH, "B": DEPTH},
        {"R": DEPTH, "G": 2 * DEPTH, "B": DEPTH, "A": DEPTH, "Z": DEPTH},
        {"View Layer.Depth.Z": DEPTH, "View Layer.Combined.R": 0 * DEPTH},
    ],
)
def test_the_channel_of_depth_is_found(channels: dict[str, Any], tmp_path: Path) -> None:
    found = io.read_depth(write(tmp_path / "a.exr", channels))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, DEPTH)


@pytest.mark.parametrize("kind", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
def test_compressions_and_halves(kind: str, tmp_path: Path) -> None:
    half = DEPTH.astype(np.float16)
    half[0, :3] = np.inf, np.nan, 65504.0  # nothing was hit
    path = write(
        tmp_path / "a.exr", {"Z": half}, compression=getattr(OpenEXR, f"{kind}_COMPRESSION")
    )
    expected = half.astype(np.float32)
    expected[0, :3] = 0.0
    np.testing.assert_array_equal(io.read_depth(path), expected)


def test_a_window_that_does_not_begin_at_zero(tmp_path: Path) -> None:
    window = (np.array([5, 7], np.int32), np.array([34, 26], np.int32))
    path = write(tmp_path / "a.exr", {"Z": DEPTH}, dataWindow=window)
    np.testing.assert_array_equal(io.read_depth(path), DEPTH)


def test_no_channel_of_depth(tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", {"R": DEPTH, "G": 2 * DEPTH, "B": DEPTH})
    with pytest.raises(FormatError, match="one named Z or Depth, got 'B', 'G', 'R'"):
        io.read_depth(path)


def test_too_large_and_damaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "a.exr", {"Z": DEPTH})
    with pytest.raises(FormatError, match="expected at most 599 pixels, got 30 x 20"):
        io.read_depth(path, max_pixels=599)
    several = write(tmp_path / "b.exr", {name: DEPTH for name in "ABC"})
    with pytest.raises(FormatError, match="more than 1200 numbers in all channels"):
        io.read_depth(several, max_pixels=600)
    data = bytearray(write(path, {"Z": np.ones_like(DEPTH)}).read_bytes())
    data[-20:] = b"\xff" * 20
    path.write_bytes(data)
    capsys.readouterr()
    with pytest.raises(FormatError, match=r"damaged \.exr"):
        io.read_depth(path)
    assert capsys.readouterr().out == ""
    path.write_bytes(data[:200])
    with pytest.raises(FormatError, match=r"damaged \.exr"):
        io.read_depth(path)


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", {"Z": DEPTH})
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match="exr"):
        io.read_depth(path)
