"""Folders of LiDAR range images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError
from manip3d.datasets import open_range_images
from real_data import RealData

Image = pytest.importorskip("PIL.Image")


def folder(path: Path, config: str, ranges: np.ndarray) -> Path:
    (path / "data").mkdir(parents=True)
    (path / "velodyne_config.txt").write_text(config)
    Image.fromarray(ranges.astype(np.uint16)).save(path / "data" / "0000000000.png")
    (path / "timestamps.txt").write_text("2011-07-14 13:52:31.5\n")
    return path


def test_angles_and_ranges(tmp_path: Path) -> None:
    # Four columns of 90 degrees from +180 (behind, left border) to -180; two rows.
    ranges = np.array([[1000, 0, 500, 0], [0, 2000, 0, 0]])
    (frame,) = open_range_images(folder(tmp_path / "a", "# x\n500 4 2 180 -180 0 30", ranges))
    half = np.sqrt(0.5)
    down = np.array([np.cos(np.pi / 6) * half, np.cos(np.pi / 6) * half, -0.5])
    expected = [[-2 * half, 2 * half, 0], [half, -half, 0], 4 * down]
    np.testing.assert_allclose(frame.points, expected, atol=1e-6)
    assert frame.ring is not None
    assert frame.ring.tolist() == [0, 0, 1]
    assert frame.fields["column"].tolist() == [0, 2, 1]
    assert frame.fields["range"].tolist() == [2.0, 1.0, 4.0]
    assert frame.time_ns == 1_310_651_551_500_000_000
    assert frame.origin == (0.0, 0.0, 0.0)


def test_angles_of_the_borders(tmp_path: Path) -> None:
    ranges = np.full((4, 2), 3)
    (frame,) = open_range_images(folder(tmp_path / "a", "2 4 90 -90 -20 20", ranges))
    elevation = np.degrees(np.arcsin(frame.points[::2, 2] / 3.0))
    np.testing.assert_allclose(elevation, [15, 5, -5, -15], atol=1e-4)


def test_borders_of_a_scanner_upside_down(tmp_path: Path) -> None:
    """The upper border is 20 degrees below the horizon, the lower one 20 above it."""
    ranges = np.full((4, 2), 3)
    (frame,) = open_range_images(folder(tmp_path / "a", "2 4 90 -90 20 -20", ranges))
    elevation = np.degrees(np.arcsin(frame.points[::2, 2] / 3.0))
    np.testing.assert_allclose(elevation, [-15, -5, 5, 15], atol=1e-4)


def add_images(path: Path, names: list[str]) -> None:
    for name in names:
        Image.fromarray(np.ones((2, 4), np.uint16)).save(path / "data" / name)


def test_images_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    path = folder(tmp_path / "a", "500 4 2 180 -180 0 1", np.ones((2, 4)))
    add_images(path, ["10.png", "2.png"])
    (path / "data" / "._2.png").write_bytes(b"\0\5\x16\7")  # macOS writes it
    images = open_range_images(path).images
    assert [image.name for image in images] == ["0000000000.png", "2.png", "10.png"]


def test_a_time_belongs_to_the_number_of_an_image(tmp_path: Path) -> None:
    """Image 1 is missing, the time of image 3 is unknown, and that of image 4 is damaged."""
    path = folder(tmp_path / "a", "500 4 2 180 -180 0 1", np.ones((2, 4)))
    add_images(path, ["0000000002.png", "0000000003.png", "0000000004.png"])
    lines = [f"2011-07-14 13:52:3{second}" for second in range(3)]
    (path / "timestamps.txt").write_text("\n".join([*lines, "", "now"]))
    turns = open_range_images(path)
    begin = turns[0].time_ns
    assert begin is not None
    assert turns[1].time_ns == begin + 2_000_000_000
    assert turns[2].time_ns is None
    with pytest.raises(FormatError, match="line 5: expected a time, got 'now'"):
        turns[3]
    (path / "timestamps.txt").unlink()
    assert {turn.time_ns for turn in open_range_images(path)} == {None}


@pytest.mark.parametrize("names", [["1", "2"], ["scan_0", "scan_1"], ["1310651551", "1310651552"]])
def test_times_are_in_the_order_of_as_many_images(tmp_path: Path, names: list[str]) -> None:
    path = folder(tmp_path / "a", "500 4 2 180 -180 0 1", np.ones((2, 4)))
    (path / "data" / "0000000000.png").unlink()
    add_images(path, [f"{name}.png" for name in names])
    lines = [f"2011-07-14 13:52:3{second}" for second in range(2)]
    (path / "timestamps.txt").write_text("\n".join(lines))
    first, second = (turn.time_ns for turn in open_range_images(path))
    assert first is not None
    assert second == first + 1_000_000_000
    (path / "timestamps.txt").write_text("\n".join([*lines, "", " "]))  # blank lines at the end
    assert [turn.time_ns for turn in open_range_images(path)] == [first, second]
    (path / "timestamps.txt").write_text(lines[0])
    turns = open_range_images(path)
    assert turns[0].time_ns == first
    with pytest.warns(UserWarning, match=rf"that of {names[1]}.png, got 1 line"):
        assert turns[1].time_ns is None


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ("", "expected a line with sizes and angles"),
        ("500 4 2 180 -180 x 1", "line 1: expected sizes and angles"),
        ("500 4 2 180 -180 nan 1", "expected sizes and angles"),
        ("500 4 3 180 -180 1 2 3 4", "expected sizes and angles"),
        ("0 4 2 180 -180 0 1", "expected sizes and angles"),
        ("500 1e9 2 180 -180 0 1", "expected sizes and angles"),
        ("500 5 2 180 -180 0 1", r"expected \(2, 5\) pixels, got \(2, 4\)"),
    ],
)
def test_damage(tmp_path: Path, config: str, reason: str) -> None:
    path = folder(tmp_path / "a", config, np.ones((2, 4)))
    with pytest.raises(FormatError, match=reason):
        list(open_range_images(path))
    (path / "velodyne_config.txt").write_text("500 4 2 180 -180 0 1")
    (path / "timestamps.txt").write_text("now")
    with pytest.raises(FormatError, match="line 1: expected a time, got 'now'"):
        list(open_range_images(path))
    with pytest.raises(FileNotFoundError):
        open_range_images(tmp_path / "none")


def test_real_turns(realdata: RealData) -> None:
    turns = open_range_images(realdata("lidar/hdl64_range_images/muehlburger_tor"))
    assert len(turns) == 40
    counts = [turn.num_points for turn in turns]
    assert (min(counts), max(counts)) == (40497, 43219)  # the manifest's
    first, last = turns[0], turns[-1]
    assert first.ring is not None
    assert first.ring.max() == 63
    steps = first.fields["range"].astype(np.float64) * 500
    assert np.abs(steps - np.round(steps)).max() < 1e-2
    assert last.time_ns is not None
    assert first.time_ns is not None
    assert (last.time_ns - first.time_ns) / 1e9 == pytest.approx(3.9, abs=0.3)
    # The road is below the sensor, ahead and behind.
    assert -2.5 < np.percentile(first.points[:, 2], 5) < -1.5
