"""Recordings in Matroska: killed recorders, and what other programs find in the files."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import capture
from manip3d.camera import Intrinsics, Registration

DATA = os.environ.get("MANIP3D_DATA", "")
CAMERA = Intrinsics(96, 72, 80.0, 80.0, 47.5, 35.5)
COLOR = Registration(Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5), np.eye(3), np.zeros(3))
CALIBRATION = manip3d.RgbdCalibration(CAMERA, COLOR)

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
    color = np.zeros((48, 64, 3), np.uint8)
    color[..., 0] = np.arange(64) * 3
    color[..., 1] = number % 200
    joints = random.normal(size=(25, 3)).astype(np.float32)
    return manip3d.RgbdFrame(
        depth=depth,
        calibration=CALIBRATION,
        color=color,
        body_index=body,
        skeletons=(manip3d.Skeleton(positions=joints, id=7, body=0),),
        time_ns=1_700_000_000_000_000_001 + number * 33_333_333,
        number=number,
    )


def assert_same(frame: manip3d.RgbdFrame, expected: manip3d.RgbdFrame) -> None:
    assert (frame.number, frame.time_ns) == (expected.number, expected.time_ns)
    np.testing.assert_array_equal(frame.depth, expected.depth)
    np.testing.assert_array_equal(frame.body_index, expected.body_index)
    for skeleton, other in zip(frame.skeletons, expected.skeletons, strict=True):
        np.testing.assert_array_equal(skeleton.positions, other.positions)
        np.testing.assert_array_equal(skeleton.orientations, other.orientations)
        assert (skeleton.id, skeleton.body) == (other.id, other.body)


def test_three_hundred_frames_replay_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "walk.mkv"
    capture.record((frame_of(n) for n in range(300)), path, lossless_color=True)
    source = capture.open(f"mkv:{path}")
    frames = list(source)
    assert len(frames) == 300
    for frame in frames:
        expected = frame_of(frame.number)
        assert_same(frame, expected)
        np.testing.assert_array_equal(frame.color, expected.color)
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


def test_a_recording_without_frames_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "empty.mkv"
    capture.record((frame_of(n) for n in range(3)), path, trigger=lambda _: False)
    with capture.open_rgbd(f"mkv:{path}") as source:
        assert source.num_frames == len(source) == 0
        assert list(source) == []
        assert set(source.counters.values()) == {0}
        with pytest.raises(IndexError, match="frame 0 of 0"):
            source[0]
    whole = path.read_bytes()
    path.write_bytes(whole.replace(hashlib.sha256().hexdigest().encode(), b"0" * 64))
    with capture.open_rgbd(f"mkv:{path}") as source:
        assert source.num_frames is None
        assert list(source) == []
        assert source.counters["cut_short"] == 1


def test_nothing_is_printed_about_a_file_that_is_cut(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """FFmpeg prints a line if it knows the size of a file that ends within an element."""
    path = tmp_path / "walk.mkv"
    capture.record([frame_of(n) for n in range(4)], path)
    whole = path.read_bytes()
    for size in (*range(500, 2000, 100), *range(len(whole) - 500, len(whole), 50)):
        path.write_bytes(whole[:size])
        with (
            contextlib.suppress(manip3d.FormatError),
            capture.open_rgbd(f"mkv:{path}") as source,
        ):
            list(source)
    assert capfd.readouterr() == ("", "")


def test_an_existing_recording_names_what_replaces_it(tmp_path: Path) -> None:
    path = tmp_path / "walk.mkv"
    capture.record([frame_of(0)], path)
    expected = r"path: .*walk\.mkv exists already; --force \(overwrite=True\) replaces it"
    with pytest.raises(manip3d.InputError, match=expected):
        capture.record([frame_of(1)], path)


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
        assert record["time"] == frame_of(number).time_ns
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


def run(code: str, *arguments: object) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


ABSENCE = """
import importlib.abc, sys
import numpy as np
from manip3d import DeviceError, Intrinsics, RgbdCalibration, RgbdFrame, capture

class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "manip3d._mkv":
            raise eval(sys.argv[1])

camera = RgbdCalibration(Intrinsics(8, 8, 9.0, 9.0, 3.5, 3.5))
frame = RgbdFrame(np.zeros((8, 8), np.uint16), camera)
sys.meta_path.insert(0, Absent())
mkv = next(scheme for scheme in capture.sources() if scheme.name == "mkv")
print(mkv.reason)
print(mkv.cure)
path = sys.argv[2]
record = lambda: capture.record([frame], path, overwrite=True)
for use in (lambda: capture.open("mkv:" + path), record):
    try:
        use()
    except DeviceError as error:
        print(error)
sys.meta_path.pop(0)
print(capture.open("mkv:" + sys.argv[2]).num_frames)
"""


@pytest.mark.parametrize(
    ("error", "reason", "cure"),
    [
        (
            "ModuleNotFoundError('manip3d._mkv')",
            "manip3d._mkv is not built: FFmpeg's development files were not found",
            "apt-get install libavformat-dev libavcodec-dev libavutil-dev, then build again",
        ),
        (
            "ImportError('libavformat.so.59: cannot open shared object file')",
            "manip3d._mkv: libavformat.so.59: cannot open shared object file",
            "install the libraries of FFmpeg that manip3d was built with",
        ),
    ],
)
def test_without_its_library_it_says_so(tmp_path: Path, error: str, reason: str, cure: str) -> None:
    path = tmp_path / "walk.mkv"
    capture.record([frame_of(0)], path)
    lines = run(ABSENCE, error, path)
    message = f"mkv: {reason} ({cure})"
    # The library may come while the process runs.
    assert lines == [reason, cure, message, message, "1"]
    assert capture.open(f"mkv:{path}").num_frames == 1  # untouched


FIRST_USE = """
import ctypes, sys
from manip3d import capture

def libraries():
    with open("/proc/self/maps") as maps:
        return {line.split()[-1] for line in maps if "libav" in line}

before = libraries()
source = capture.open("mkv:" + sys.argv[1])
capture.record(source, sys.argv[2])
(libavutil,) = {path for path in libraries() if "libavutil" in path}
print(len(before), ctypes.CDLL(libavutil).av_log_get_level())
"""


def test_ffmpeg_is_loaded_when_it_is_needed_and_its_log_level_left_alone(tmp_path: Path) -> None:
    capture.record([frame_of(0)], tmp_path / "a.mkv")
    av_log_info = 32
    assert run(FIRST_USE, tmp_path / "a.mkv", tmp_path / "b.mkv") == [f"0 {av_log_info}"]


@pytest.mark.realdata
@pytest.mark.skipif(not DATA, reason="MANIP3D_DATA is not set")
def test_the_color_lens_of_a_real_azure_kinect(capfd: pytest.CaptureFixture[str]) -> None:
    """Its MetricRadius is 0: the lens holds as far as Microsoft's reader takes it, 1.7."""
    path = Path(DATA) / "rgbd" / "recording_azure_kinect" / "pyk4a_recording.mkv"
    with capture.open(f"mkv:{path}") as source:
        assert len(list(source)) == 1
    assert capfd.readouterr() == ("", "")  # nothing about tracks that FFmpeg does not know
    color = source.calibration.registration.color
    content = path.read_bytes()
    start = content.rindex(b"{", 0, content.index(b"CalibrationInformation"))
    stored, _ = json.JSONDecoder().raw_decode(content[start:].decode("latin-1"))
    cameras = stored["CalibrationInformation"]["Cameras"]
    (lens,) = (c for c in cameras if c["Location"] == "CALIBRATION_CameraLocationPV0")
    assert lens["MetricRadius"] == 0
    k1, k2, k3, k4, k5, k6, _, _, p2, p1 = lens["Intrinsics"]["ModelParameters"][4:]

    half = np.array([color.width / color.fx, color.height / color.fy]) / 2
    x, y = np.meshgrid(*(np.linspace(-0.95 * h, 0.95 * h, 41) for h in half))
    r2 = x * x + y * y
    real = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    b1, b2, q1, q2, b3 = color.distortion
    brown = 1 + r2 * (b1 + r2 * (b2 + r2 * b3))
    off_u = x * (brown - real) + 2 * x * y * (q1 - p1) + (r2 + 2 * x * x) * (q2 - p2)
    off_v = y * (brown - real) + 2 * x * y * (q2 - p2) + (r2 + 2 * y * y) * (q1 - p1)
    off = np.hypot(off_u * color.fx, off_v * color.fy)
    assert off.max() < color.width / 1000  # without distortion it is thirty times as much


@pytest.mark.parametrize("lossless", [False, True])
def test_colours_of_another_size_without_a_registration_are_left_out(
    tmp_path: Path, lossless: bool
) -> None:
    """A camera of the depth images alone does not say where the colours belong."""
    path = tmp_path / "walk.mkv"
    capture.record([frame_of(i) for i in range(4)], path, lossless_color=lossless)
    with capture.open_rgbd(f"mkv:{path}", camera=CAMERA) as source:
        with pytest.warns(UserWarning, match="of another size than the depth images"):
            frames = list(source)
        assert [frame.number for frame in frames] == [0, 1, 2, 3]
        assert source.counters["unregistered_color"] == 4
        assert source.counters["damaged"] == 0
        for number, frame in enumerate(frames):
            assert frame.color is None
            assert_same(frame, frame_of(number))
        assert source[2].color is None
    with capture.open_rgbd(f"mkv:{path}", camera=CALIBRATION) as source:
        assert all(frame.color is not None for frame in source)
        assert "unregistered_color" not in source.counters


def test_a_size_beyond_all_memory_is_an_error_of_the_file(tmp_path: Path) -> None:
    found_by_fuzzing = Path(__file__).parents[2] / "cpp/fuzz/corpus/mkv/size_beyond_memory"
    path = tmp_path / "hostile.mkv"
    path.write_bytes(found_by_fuzzing.read_bytes())
    with pytest.raises(manip3d.FormatError, match="a size in it is beyond all memory"):
        capture.open_rgbd(f"mkv:{path}")
