"""The scans of a drive, past those that cannot be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manip3d import InputError, LidarFrame, authenticate, capture, datasets, io
from velodyne_packets import block, ethernet, packet, pcap, udp_frame
from watermark_scans import grid_scan, key_file


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "drive" / "velodyne"
    folder.mkdir(parents=True)
    for number in (3, 4, 6):
        np.full((number, 4), 1.0, np.float32).tofile(folder / f"{number:06d}.bin")
    (folder / "000004.bin").write_bytes(b"cut short")
    return tmp_path / "drive"


def test_a_scan_that_cannot_be_read_leaves_a_gap(drive: Path) -> None:
    opened = capture.open_drive(drive)
    for _ in range(2):  # again from the beginning
        scans = [None if scan is None else scan.num_points for scan in opened]
        assert scans == [3, None, 6]
        assert opened.names == ["000003.bin", "000004.bin", "000006.bin"]
        assert list(opened.errors) == [1]
        assert "000004.bin" in opened.errors[1]
    assert opened.numbers == authenticate.drive_numbers(drive)
    assert opened.paths[2] == drive / "velodyne" / "000006.bin"


def test_times_of_the_drive_are_those_of_scans_that_have_none(tmp_path: Path) -> None:
    folder = tmp_path / "velodyne_points" / "data"
    folder.mkdir(parents=True)
    for name in ("0000000001.bin", "of the morning.bin"):
        np.ones((5, 4), np.float32).tofile(folder / name)
    (tmp_path / "times.txt").write_text("0.0\n0.5\n")
    opened = capture.open_drive(tmp_path)
    assert len(list(opened)) == 2
    assert opened.times_ns == {0: 500_000_000}
    assert datasets.open_kitti(tmp_path)[0].time_ns == 500_000_000
    (tmp_path / "velodyne_points" / "timestamps.txt").write_text("2011-09-26 13:02:25.0\n" * 2)
    assert len(list(opened)) == 2
    assert opened.times_ns[0] > 10**18


@pytest.mark.parametrize("suffix", [".bin", ".csv"])
def test_names_without_leading_zeros_are_in_the_order_of_their_numbers(
    tmp_path: Path, suffix: str
) -> None:
    """CARLA and many recorders name scans 0, 1, ... 10, 11: as texts, 10 would be before 2."""
    folder = tmp_path / "velodyne_points" / "data"
    folder.mkdir(parents=True)
    for number in range(12):
        rows = np.full((number + 1, 4), 1.0 + number, np.float32)
        io.write_scan(LidarFrame(rows[:, :3], rows[:, 3]), folder / f"{number}{suffix}")
    opened = capture.open_drive(tmp_path)
    assert [scan.num_points for scan in opened if scan is not None] == list(range(1, 13))
    assert opened.names == [f"{number}{suffix}" for number in range(12)]
    assert opened.numbers == list(range(12))
    if suffix == ".bin":
        frames = datasets.open_kitti(tmp_path)
        assert [frame.name for frame in frames] == [str(number) for number in range(12)]


def test_a_signed_drive_of_names_without_leading_zeros_is_one_chain(tmp_path: Path) -> None:
    folder = tmp_path / "drive" / "velodyne"
    folder.mkdir(parents=True)
    for number in range(12):
        LidarFrame(grid_scan(300, number)).write(folder / f"{number}.bin")
    with authenticate.KeyFile(key_file(tmp_path / "sensor.key")) as key:
        marker = authenticate.Watermarker(key)
        authenticate.embed_files(marker, tmp_path / "drive", tmp_path / "signed")
        (tmp_path / "signed" / "velodyne" / "10.bin").unlink()
        found = authenticate.verify_files(authenticate.Watermarker(key), tmp_path / "signed")
    assert [Path(name).name for name, _ in found.frames] == [
        f"{number}.bin" for number in range(12)
    ]
    assert [result.number for _, result in found.frames] == list(range(12))


def test_records_go_along_with_the_scans(drive: Path) -> None:
    (drive / "velodyne" / "000006.bin.wm").write_bytes(b"of six")
    opened = capture.open_drive(drive)
    pairs = [record for _, record in zip(opened, opened.records(), strict=False)]
    assert pairs == [b"", b"", b"of six"]


def test_a_recording_of_packets_is_a_drive_without_numbers(tmp_path: Path) -> None:
    frames = []
    for start in range(0, 90000, 480):
        blocks = [block(start + 40 * b, [1000 + b] * 32) for b in range(12)]
        frames.append(ethernet(udp_frame(packet(blocks, product=0x22))))
    path = tmp_path / "turns.pcap"
    path.write_bytes(pcap(frames, step=0.001))
    opened = capture.open_drive(path)
    assert [scan is not None for scan in opened] == [True] * 3
    assert (opened.names, opened.numbers, opened.paths) == (
        ["frame 0", "frame 1", "frame 2"],
        None,
        {},
    )
    assert next(opened.records()) is None


def test_what_is_no_drive_is_refused(drive: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a file, a folder or one of pcap:PATH"):
        capture.open_drive(tmp_path / "nothing.obj")
    with pytest.raises(
        InputError, match="calibration: can only be given with a recording of packets"
    ):
        capture.open_drive(drive, calibration="db.xml")


@pytest.mark.parametrize("suffix", [".csv", ".npy", ".txt"])
def test_drives_of_exported_clouds_are_opened(suffix: str, tmp_path: Path) -> None:
    folder = tmp_path / "velodyne_points" / "data"
    folder.mkdir(parents=True)
    points = np.random.default_rng(0).normal(0.0, 9.0, (50, 3)).astype(np.float32)
    for number in (3, 4):
        LidarFrame(points + number, np.ones(50, np.float32)).write(folder / f"{number:010}{suffix}")
    drive = capture.open_drive(tmp_path)
    assert [frame is not None and frame.num_points for frame in drive] == [50, 50]
    assert (drive.names, drive.numbers) == ([f"{n:010}{suffix}" for n in (3, 4)], [3, 4])
