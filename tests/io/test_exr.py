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
        {"a.Depth.Z": DEPTH, "a.Mist.Z": 0 * DEPTH},
        {"a.Depth.Z": DEPTH} | {f"a.Normal.{axis}": 0 * DEPTH for axis in "XYZ"},
        {"depth": DEPTH} | {name: 0 * DEPTH for name in ("R", "G", "B", "N.X", "N.Y", "N.Z")},
        {"Z": DEPTH} | {name: 0 * DEPTH for name in ("R", "G", "B", "N.X", "N.Y", "N.Z", "a.Z")},
        {"a.Z": DEPTH} | {name: 0 * DEPTH for name in ("N.X", "N.Y", "N.Z", "UV.U", "UV.V")},
        {f"a.DEPTH.{name}": DEPTH for name in "RGBA"} | {"R": 0 * DEPTH},
        {"Z": DEPTH, "depth.A": 0 * DEPTH},
    ],
)
def test_the_channel_of_depth_is_found(channels: dict[str, Any], tmp_path: Path) -> None:
    found = io.read_depth(write(tmp_path / "a.exr", channels))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, DEPTH)


def write_parts(path: Path, parts: dict[str, dict[str, Any]], **headers: Any) -> Path:
    """Write one part for each name; ``headers`` has the header's additions of parts by name."""
    written = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage} | headers.get(name, {}), channels, name)
        for name, channels in parts.items()
    ]
    with OpenEXR.File(written) as file:
        file.write(str(path))
    return path


GREY, ONES = {name: DEPTH / 10 for name in "RGB"}, np.ones_like(DEPTH)


@pytest.mark.parametrize(
    "parts",
    [
        {"beauty": GREY, "depth": {"Z": DEPTH}},
        {"depth": {"Z": DEPTH}, "beauty": GREY},
        {"mask": {"A": ONES}, "a.Depth": {"a.Depth.Z": DEPTH}},
        {"rgba": {"R": DEPTH, "G": 2 * DEPTH, "B": DEPTH, "Z": DEPTH}, "mask": {"A": ONES}}
        | {"mist": {"Z": ONES}},
        {"a.Combined": {"R": ONES, "G": DEPTH, "B": DEPTH}, "Depth": dict.fromkeys("RGB", DEPTH)},
        {"normal": dict.fromkeys("XYZ", ONES), "a.Depth": {"V": DEPTH}},
    ],
)
def test_the_depth_may_be_in_any_part(parts: dict[str, Any], tmp_path: Path) -> None:
    found = io.read_depth(write_parts(tmp_path / "a.exr", parts))
    np.testing.assert_array_equal(found, DEPTH)


@pytest.mark.parametrize(
    "parts",
    [
        {"one": {"Z": DEPTH}, "two": {"Z": ONES}},
        {"one": {"A": ONES}, "two": {"A": ONES}},
        {"one": GREY, "two": {"A": ONES}},
    ],
)
def test_an_error_names_the_parts(parts: dict[str, Any], tmp_path: Path) -> None:
    path = write_parts(tmp_path / "a.exr", parts)
    with pytest.raises(FormatError, match=r"one named Z or Depth, got 'one\.\w'.*'two\.\w'$"):
        io.read_depth(path)


def test_the_windows_are_those_of_the_part(tmp_path: Path) -> None:
    stored = {"dataWindow": window(6, 4, 19, 8), "displayWindow": window(0, 0, 29, 19)}
    parts = {"rgb": {"R": DEPTH}, "depth": {"Z": np.ascontiguousarray(DEPTH[4:9, 6:20])}}
    path = write_parts(tmp_path / "a.exr", parts, depth=stored)
    expected = np.zeros_like(DEPTH)
    expected[4:9, 6:20] = DEPTH[4:9, 6:20]
    np.testing.assert_array_equal(io.read_depth(path), expected)


def test_a_damaged_part_is_not_left_out(tmp_path: Path) -> None:
    """The mask would be the only channel."""
    path = write_parts(tmp_path / "a.exr", {"mask": {"A": ONES}, "depth": {"Z": ONES}})
    data = bytearray(path.read_bytes())
    data[-20:] = b"\xff" * 20
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"damaged \.exr"):
        io.read_depth(path)


def test_the_numbers_of_all_parts_are_counted(tmp_path: Path) -> None:
    path = write_parts(tmp_path / "a.exr", {name: {"Z": DEPTH} for name in ("a", "b", "depth")})
    with pytest.raises(FormatError, match="more than 1200 numbers in all channels"):
        io.read_depth(path, max_pixels=600)
    np.testing.assert_array_equal(io.read_depth(path, max_pixels=900), DEPTH)


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


def window(left: int, top: int, right: int, bottom: int) -> tuple[Any, Any]:
    return np.array([left, top], np.int32), np.array([right, bottom], np.int32)


def test_pixels_lie_where_they_are_in_the_display_window(tmp_path: Path) -> None:
    """The data window is the part that a renderer has stored; a camera has the other one."""
    part = {"Z": np.ascontiguousarray(DEPTH[4:9, 6:20])}
    inside = window(6, 4, 19, 8)
    path = write(tmp_path / "a.exr", part, dataWindow=inside, displayWindow=window(0, 0, 29, 19))
    expected = np.zeros_like(DEPTH)
    expected[4:9, 6:20] = DEPTH[4:9, 6:20]
    np.testing.assert_array_equal(io.read_depth(path), expected)
    write(path, part, dataWindow=inside, displayWindow=window(5, 3, 24, 10))
    np.testing.assert_array_equal(io.read_depth(path), expected[3:11, 5:25])


def test_overscan_is_cut_off(tmp_path: Path) -> None:
    stored, shown = window(-3, -2, 26, 17), window(0, 0, 9, 40)
    path = write(tmp_path / "a.exr", {"Z": DEPTH}, dataWindow=stored, displayWindow=shown)
    expected = np.zeros((41, 10), np.float32)
    expected[:18] = DEPTH[2:, 3:13]
    np.testing.assert_array_equal(io.read_depth(path), expected)


def test_both_windows_may_begin_anywhere(tmp_path: Path) -> None:
    same = window(5, 7, 34, 26)
    for shown in (same, window(0, 0, 0, 0)):  # the second is that of programs that know none
        path = write(tmp_path / "a.exr", {"Z": DEPTH}, dataWindow=same, displayWindow=shown)
        np.testing.assert_array_equal(io.read_depth(path), DEPTH)


def test_display_windows_that_are_too_large_or_empty(tmp_path: Path) -> None:
    path, big = tmp_path / "a.exr", 2**20
    write(path, {"Z": DEPTH}, displayWindow=window(-big, -big, big - 1, big - 1))
    with pytest.raises(FormatError, match=f"expected at most .* pixels, got {2 * big} x {2 * big}"):
        io.read_depth(path)
    write(path, {"Z": DEPTH}, displayWindow=window(30, 0, 59, 19))
    with pytest.raises(FormatError, match="expected pixels in the display window, got none"):
        io.read_depth(path)


@pytest.mark.parametrize(
    "names",
    ["R G B N.X N.Y N.Z", "R G B X Y Z", "UV.U UV.V", "R G B a.Z b.Z", "a.Mist.Z R", "R G B",
     "R G B a.depth.Z b.depth.Z"],
)  # fmt: skip
def test_no_channel_of_depth(names: str, tmp_path: Path) -> None:
    different = {name: (1 + i) * DEPTH for i, name in enumerate(names.split())}
    path = write(tmp_path / "a.exr", different)
    with pytest.raises(FormatError, match="one named Z or Depth, got '"):
        io.read_depth(path)


def test_a_grey_picture_beside_several_depths(tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", {name: DEPTH for name in ("R", "G", "B", "a.Z", "b.Z")})
    with pytest.raises(FormatError, match="one named Z or Depth"):
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
