"""Sources that a with statement has closed: they keep their counts, and nothing open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rgbd_frames
import velodyne_packets
from manip3d import capture
from open_files import descriptors


def pcap(folder: Path) -> str:
    packets = velodyne_packets.seen_turns(0, 360)
    frames = (velodyne_packets.ethernet(velodyne_packets.udp_frame(each)) for each in packets)
    (folder / "drive.pcap").write_bytes(velodyne_packets.pcap(frames))
    return f"pcap:{folder / 'drive.pcap'}"


def bag(folder: Path) -> str:
    pytest.importorskip("rosbags", reason="the extra 'bags' is not installed")
    from ros_bags import TYPES, message, points_of, write_bag

    clouds = [message(TYPES, points_of(number), stamp=5.25 + number) for number in range(3)]
    return f"bag:{write_bag(folder / 'bag', {'/points': clouds}, 'mcap', 'NONE')}"


def images_of_a_bag(folder: Path) -> str:
    pytest.importorskip("rosbags", reason="the extra 'bags' is not installed")
    from ros_bags import INFO, PROJECTION, camera_info, image, millimetres, write_mixed_bag

    camera = replace(camera_info(PROJECTION), width=64, height=48)
    messages: list[tuple[float, str, str, Any]] = [(0.0, "/depth/camera_info", INFO, camera)]
    for number in range(9):
        rows = millimetres(number).view(np.uint8).reshape(48, 64, 2)
        depth = replace(image(rows, "16UC1", 1.0 + number), width=64)
        messages.append((1.0 + number, "/depth/image_raw", "sensor_msgs/msg/Image", depth))
    return f"rgbd-bag:{write_mixed_bag(folder / 'camera', messages)}"


def folder_of_images(folder: Path) -> str:
    capture.record(rgbd_frames.frames(9), folder / "walk")
    return f"folder:{folder / 'walk'}"


def matroska(folder: Path) -> str:
    capture.record(rgbd_frames.frames(9), folder / "walk.mkv")
    return f"mkv:{folder / 'walk.mkv'}"


def forged(folder: Path) -> str:
    return f"forged:{folder_of_images(folder)}#type=1"


RECORDINGS: dict[str, Callable[[Path], str]] = {
    "pcap": pcap,
    "bag": bag,
    "rgbd-bag": images_of_a_bag,
    "folder": folder_of_images,
    "mkv": matroska,
    "forged": forged,
    "velodyne": lambda _: "velodyne:0",
}
LIVE = ("velodyne",)


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_closed_source_keeps_nothing_open(name: str, tmp_path: Path) -> None:
    """A program that keeps its sources, to ask for their counts, opened two files with each."""
    uri = RECORDINGS[name](tmp_path)
    kept: list[Any] = []
    before = descriptors()
    for _ in range(3):
        with capture.open(uri) as source:
            found = source.read(timeout=0.0 if name in LIVE else None)
            counters = source.counters
            assert descriptors() > before
        assert (found is None) == (name in LIVE)
        assert source.counters == counters
        assert source.read() is None
        kept.append(source)
        assert descriptors() == before


@pytest.mark.parametrize("speed", [0.0, 1000.0])
@pytest.mark.parametrize("name", ["folder", "mkv", "rgbd-bag"])
def test_a_closed_recording_can_be_opened_again(name: str, speed: float, tmp_path: Path) -> None:
    uri = RECORDINGS[name](tmp_path)
    before = descriptors()
    with capture.open_rgbd(uri, speed=speed) as source:
        length, flipped = source.num_frames, source.flipped
        numbers = [frame.number for frame in source]
    assert (source.num_frames, source.flipped) == (length, flipped)
    source.start()
    with source:
        # In real time a slow reader may miss frames, but not the last one.
        assert [frame.number for frame in source][-1] == numbers[-1]
    assert descriptors() == before
    source.seek(0)
    with source:
        assert source.read() is not None
    assert descriptors() == before
