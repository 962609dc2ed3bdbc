"""Ouster recordings: every return of every frame, and what damaged ones say."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from manip3d import Error, FormatError, InputError, capture
from real_data import RealData

pytest.importorskip("ouster.sdk", reason="the extra 'ouster' is not installed")


@pytest.mark.parametrize(
    ("name", "metadata", "frames", "rows", "returns"),
    [
        ("OS-1-128_v2.3.0_1024x10_lb_n3.pcap", "OS-1-128_v2.3.0_1024x10.json", 3, 128, 1),
        ("OS-0-32-U1_v2.2.0_1024x10.pcap", "OS-0-32-U1_v2.2.0_1024x10.json", 1, 32, 2),
    ],
)
def test_real_recordings(
    realdata: RealData, name: str, metadata: str, frames: int, rows: int, returns: int
) -> None:
    folder = realdata("lidar/packets/ouster")
    with capture.open(f"ouster:{folder / name}", metadata=folder / metadata) as source:
        found = list(source)
    assert len(found) == frames == source.counters["frames"]
    counted = source.counters["points"] + source.counters["no_return"]
    assert counted == frames * rows * 1024 * returns
    for frame in found:
        assert frame.ring is not None
        assert frame.ring.max() == rows - 1
        assert set(np.unique(frame.fields["return"])) == set(range(1, returns + 1))
        assert {"column", "range", "time", "near_ir"} <= set(frame.fields)
        # A beam starts a few centimetres from the middle.
        distance = np.linalg.norm(frame.points.astype(np.float64), axis=1)
        assert np.abs(distance - frame.fields["range"]).max() < 0.06
        assert 0.0 <= frame.fields["time"].min() < frame.fields["time"].max() < 0.2
        low, high = (np.median(frame.points[frame.ring == r, 2]) for r in (rows - 1, 0))
        assert high > low


def test_damaged_recordings(realdata: RealData, tmp_path: Path) -> None:
    folder = realdata("lidar/packets/ouster")
    name, metadata = "OS-0-32-U1_v2.2.0_1024x10.pcap", "OS-0-32-U1_v2.2.0_1024x10.json"
    path = tmp_path / "a.pcap"
    whole = (folder / name).read_bytes()
    with pytest.raises(FileNotFoundError):
        capture.open(f"ouster:{path}")
    path.write_bytes(whole)
    with pytest.raises(InputError, match="metadata: expected the sensor's JSON file"):
        capture.open(f"ouster:{path}")
    shutil.copy(folder / metadata, tmp_path / "a.json")
    assert len(list(capture.open(f"ouster:{path}"))) == 1
    path.write_bytes(b"")
    with pytest.raises(FormatError, match="the file is empty"):
        capture.open(f"ouster:{path}")
    for data in (b"abc", whole[:100], whole[: len(whole) // 2], bytes(5000)):
        path.write_bytes(data)
        try:
            frames = list(capture.open(f"ouster:{path}"))
        except Error:
            continue
        assert len(frames) <= 1
    path.write_bytes(whole)
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(Error):
        list(capture.open(f"ouster:{path}"))


@pytest.fixture
def osf(realdata: RealData, tmp_path: Path) -> Path:
    """An Ouster's own recording, made of packets by its own software."""
    sdk = pytest.importorskip("ouster.sdk.osf")
    folder = realdata("lidar/packets/ouster")
    name, metadata = "OS-0-32-U1_v2.2.0_1024x10.pcap", "OS-0-32-U1_v2.2.0_1024x10.json"
    from ouster.sdk import open_source

    packets = open_source(str(folder / name), meta=[str(folder / metadata)])
    path = tmp_path / "one.osf"
    with sdk.Writer(str(path), packets.sensor_info) as writer:
        for frames in packets:
            writer.save(0, frames[0])
    return path


def test_osf_files_are_read_as_their_packets(realdata: RealData, osf: Path) -> None:
    folder = realdata("lidar/packets/ouster")
    name, metadata = "OS-0-32-U1_v2.2.0_1024x10.pcap", "OS-0-32-U1_v2.2.0_1024x10.json"
    (expected,) = capture.open(f"ouster:{folder / name}", metadata=folder / metadata)
    assert capture.scan_address(str(osf)) == f"ouster:{osf}"
    (found,) = capture.open(f"ouster:{osf}")
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.intensity, expected.intensity)
    (first,) = capture.open(f"ouster:{osf}#0")
    assert first.num_points == found.num_points
    for sensor in ("#1", "#-1", "#x"):
        with pytest.raises(InputError, match="#0, one of the sensors of the recording"):
            capture.open(f"ouster:{osf}{sensor}")
