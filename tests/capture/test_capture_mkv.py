"""Recordings in Matroska: killed recorders, and what other programs find in the files."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import capture
from manip3d.camera import Intrinsics, Registration

CAMERA = Intrinsics(96, 72, 80.0, 80.0, 47.5, 35.5)
COLOUR = Registration(Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5), np.eye(3), np.zeros(3))
CALIBRATION = manip3d.RgbdCalibration(CAMERA, COLOUR)

pytestmark = pytest.mark.skipif(
    not next(s for s in capture.sources() if s.name == "mkv").is_available,
    reason="built without FFmpeg",
)


def frame_of(number: int) -> manip3d.RgbdFrame:
    """A noisy wall, and a person who walks past it."""
    random = np.random.default_rng(number)
    depth = random.integers(2500, 2510, (72, 96)).astype(np.uint16)
    body = np.full((72, 96), manip3d.rgbd.NO_BODY, np.uint8)
    body[20:60, number % 80 : number % 80 + 16] = 0
    depth[body == 0] -= 1000
    colour = np.zeros((48, 64, 3), np.uint8)
    colour[..., 0] = np.arange(64) * 3
    colour[..., 1] = number % 200
    joints = random.normal(size=(25, 3)).astype(np.float32)
    return manip3d.RgbdFrame(
        depth=depth,
        calibration=CALIBRATION,
        colour=colour,
        body_index=body,
        skeletons=(manip3d.Skeleton(positions=joints, id=7, body=0),),
        time=1_700_000_000_000_000_001 + number * 33_333_333,
        number=number,
    )


def assert_same(frame: manip3d.RgbdFrame, expected: manip3d.RgbdFrame) -> None:
    assert (frame.number, frame.time) == (expected.number, expected.time)
    np.testing.assert_array_equal(frame.depth, expected.depth)
    np.testing.assert_array_equal(frame.body_index, expected.body_index)
    for skeleton, other in zip(frame.skeletons, expected.skeletons, strict=True):
        np.testing.assert_array_equal(skeleton.positions, other.positions)
        np.testing.assert_array_equal(skeleton.orientations, other.orientations)
        assert (skeleton.id, skeleton.body) == (other.id, other.body)


def test_three_hundred_frames_replay_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "walk.mkv"
    capture.record((frame_of(n) for n in range(300)), path, lossless_colour=True)
    source = capture.open(f"mkv:{path}")
    frames = list(source)
    assert len(frames) == 300
    for frame in frames:
        expected = frame_of(frame.number)
        assert_same(frame, expected)
        np.testing.assert_array_equal(frame.colour, expected.colour)
    assert source.counters == {
        "frames": 300,
        "damaged": 0,
        "lost": 0,
        "cut_short": 0,
        "unfinished": 0,
    }


@pytest.mark.parametrize("size", [100_000, 400_000])
def test_a_killed_recorder_leaves_its_frames(tmp_path: Path, size: int) -> None:
    path = tmp_path / "killed.mkv"
    program = (
        "import sys; sys.path.insert(0, sys.argv[2])\n"
        "import itertools, test_capture_mkv as t\n"
        "t.capture.record(map(t.frame_of, itertools.count()), sys.argv[1])\n"
    )
    recorder = subprocess.Popen([sys.executable, "-c", program, path, Path(__file__).parent])
    try:
        while not path.exists() or path.stat().st_size < size:
            assert recorder.poll() is None
            time.sleep(0.01)
    finally:
        recorder.send_signal(signal.SIGKILL)
        recorder.wait()
    source = capture.open(f"mkv:{path}")
    frames = list(source)
    assert [frame.number for frame in frames] == list(range(len(frames)))
    assert len(frames) > 5
    for frame in frames:
        assert_same(frame, frame_of(frame.number))
    assert source.counters["unfinished"] == 1
    assert source.counters["damaged"] == source.counters["lost"] == 0


def test_other_programs_read_it(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "walk.mkv"
    capture.record((frame_of(n) for n in range(5)), path)
    packets: dict[str, list[bytes]] = {}
    with av.open(str(path)) as file:
        titles = {stream.index: stream.metadata["title"] for stream in file.streams}
        for packet in file.demux():
            if packet.size:
                packets.setdefault(titles[packet.stream.index], []).append(bytes(packet))
    for number in range(5):
        sent, text = packets["frames"][number].decode().split("\n")
        assert sent == hashlib.sha256(text.encode()).hexdigest()
        record = json.loads(text)
        assert record["time"] == frame_of(number).time
        assert set(record["packets"]) == {"depth", "body index", "colour"}
        for name, digest in record["packets"].items():
            assert digest == hashlib.sha256(packets[name][number]).hexdigest()
        assert packets["colour"][number].startswith(b"\xff\xd8\xff")
    with av.open(str(path)) as file:
        stream = next(s for s in file.streams.video if s.metadata["title"] == "depth")
        for number, image in enumerate(file.decode(stream)):
            np.testing.assert_array_equal(
                image.to_ndarray(format="gray16le"), frame_of(number).depth
            )


def run_with_ffmpeg_of(folder: Path, code: str, *arguments: Path) -> str:
    environment = {**os.environ, "MANIP3D_FFMPEG": str(folder)}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


ABSENCE = """
import sys
from manip3d import DeviceError, capture
print(next(scheme.reason for scheme in capture.sources() if scheme.name == "mkv"))
try:
    capture.open("mkv:" + sys.argv[1])
except DeviceError as error:
    print(error)
"""


def test_without_ffmpeg_it_says_so(tmp_path: Path) -> None:
    path = tmp_path / "walk.mkv"
    capture.record([frame_of(0)], path)
    reason, error = run_with_ffmpeg_of(tmp_path, ABSENCE, path).splitlines()
    assert reason == (
        f"FFmpeg 5 to 8 (libavformat.so.59 to 62) cannot be loaded, not in {tmp_path}"
    )
    assert error == f"mkv: {reason} (apt-get install ffmpeg, or pip install 'manip3d[record]')"


COPY = """
import sys
from manip3d import capture
done = capture.record("mkv:" + sys.argv[1], sys.argv[2], lossless_colour=True)
print(done.frames, done.source_counters["damaged"])
"""


def test_pyav_brings_the_libraries(tmp_path: Path) -> None:
    """Read and recorded by PyAV's FFmpeg, read again by the one that this machine has."""
    spec = find_spec("av")
    if spec is None or spec.origin is None:
        pytest.skip("PyAV is not installed")
    libraries = Path(spec.origin).parents[1] / "av.libs"
    first, second = tmp_path / "first.mkv", tmp_path / "second.mkv"
    capture.record((frame_of(n) for n in range(20)), first, lossless_colour=True)
    if "cannot be loaded" in run_with_ffmpeg_of(libraries, ABSENCE, first):
        pytest.skip(f"no FFmpeg 5 to 8 that stands alone in {libraries}")
    assert run_with_ffmpeg_of(libraries, COPY, first, second) == "20 0\n"
    source = capture.open(f"mkv:{second}")
    assert source.num_frames == 20
    for number, frame in enumerate(source):
        assert_same(frame, frame_of(number))
        np.testing.assert_array_equal(frame.colour, frame_of(number).colour)
    assert source.counters["frames"] == 20
