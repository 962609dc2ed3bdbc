"""Faults during recording and replay, through `capture.open` and `capture.record`."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rgbd_frames
from manip3d import (
    DeviceError,
    FormatError,
    InputError,
    Intrinsics,
    RgbdCalibration,
    RgbdFrame,
    capture,
)
from rgbd_frames import COLS, ROWS, assert_same

HAS_MKV = next(scheme for scheme in capture.sources() if scheme.name == "mkv").is_available
KINDS = [
    "folder",
    pytest.param("mkv", marks=pytest.mark.skipif(not HAS_MKV, reason="there is no FFmpeg")),
]
each_kind = pytest.mark.parametrize("kind", KINDS)


def path_of(kind: str, folder: Path, name: str = "walk") -> Path:
    return folder / (name + ("" if kind == "folder" else f".{kind}"))


def opened(kind: str, path: Path, **options: Any) -> capture.RgbdSource:
    return capture.open_rgbd(f"{kind}:{path}", **options)


def run(command: list[str]) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, capture_output=True, text=True, env=environment)


KILLED = textwrap.dedent(
    """
    import os, random, signal, sys, time
    import rgbd_frames
    from manip3d import Error, capture
    kind, folder, kills = sys.argv[1], sys.argv[2], int(sys.argv[3])
    rng, expected = random.Random(1), list(rgbd_frames.frames(2000))
    acknowledged = in_the_middle = 0
    for trial in range(kills):
        path = os.path.join(folder, str(trial) + ("" if kind == "folder" else "." + kind))
        told, tell = os.pipe()
        child = os.fork()
        if child == 0:
            def frames():
                for frame in expected:
                    yield frame
                    os.write(tell, b".")  # asked for the next one, so this one is written
                signal.pause()
            capture.record(frames(), path, lossless_color=True)
        os.close(tell)
        written, enough = 0, rng.randrange(40)
        while written < enough:  # frames, not seconds: machines differ, and what else they do
            written += len(os.read(told, 1))
        time.sleep(rng.uniform(0.0, 0.002))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while got := os.read(told, 4096):
            written += len(got)
        os.close(told)
        if written == 0:
            continue  # killed before or in its first frame
        found = list(source := capture.open_rgbd(kind + ":" + path))
        assert written <= len(found) <= written + 1, (written, len(found))
        assert source.counters["damaged"] == 0, source.counters
        for frame, other in zip(expected, found):
            rgbd_frames.assert_same(frame, other)
        acknowledged += written
        in_the_middle += written < len(expected)
    print(acknowledged, in_the_middle)
    """
)


@pytest.mark.parametrize("kills", [10, pytest.param(100, marks=pytest.mark.slow)])
@each_kind
def test_kills_lose_no_frame_that_was_acknowledged(kind: str, kills: int, tmp_path: Path) -> None:
    done = run([sys.executable, "-c", KILLED, kind, str(tmp_path), str(kills)])
    assert done.returncode == 0, done.stderr
    acknowledged, in_the_middle = map(int, done.stdout.split())
    assert in_the_middle >= 0.8 * kills
    assert acknowledged >= 10 * kills


FULL_DISK = textwrap.dedent(
    """
    import errno, os, sys
    import rgbd_frames
    from manip3d import capture
    kind, path = sys.argv[1:]
    try:
        capture.record(rgbd_frames.frames(10_000), path, lossless_color=True)
    except OSError as error:
        assert error.errno == errno.ENOSPC and error.filename.startswith(path), error
        (note,) = error.__notes__
    else:
        raise AssertionError("the disk should be full")
    source = capture.open_rgbd(kind + ":" + path)
    frames = list(source)
    assert len(frames) > 3 and source.counters["damaged"] == 0, source.counters
    assert note == f"{path} has {len(frames)} frames, which are whole", note
    if kind == "folder":
        assert source.counters["incomplete"] == 0
        for name in ("depth", "body_index", "colour"):
            assert len(os.listdir(os.path.join(path, name))) == len(frames)  # no litter
    for frame, other in zip(rgbd_frames.frames(len(frames)), frames):
        rgbd_frames.assert_same(frame, other)
    print("done")
    """
)


@pytest.mark.parametrize("size", ["96k", "100k", "104k", "140k"])
@each_kind
def test_a_full_disk_leaves_the_frames_before(kind: str, tmp_path: Path, size: str) -> None:
    mount = f"mount -t tmpfs -o size={size} none {tmp_path} && exec "
    namespace = ["unshare", "-rm", "sh", "-c"]
    if run([*namespace, mount + "true"]).returncode:
        pytest.skip("no mount namespaces here")
    script = mount + f'{sys.executable} -c "$0" {kind} {path_of(kind, tmp_path)}'
    done = run([*namespace, script, FULL_DISK])
    assert (done.stdout, done.returncode) == ("done\n", 0), done.stderr


@each_kind
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_new_recording_that_gets_no_frame_is_removed(
    kind: str, tmp_path: Path, error: BaseException
) -> None:
    def broken() -> Iterator[Any]:
        yield from rgbd_frames.frames(1)
        raise AssertionError("the first frame cannot be written")

    def fail(frame: RgbdFrame) -> bool:
        raise error

    with pytest.raises(type(error)):
        capture.record(broken(), path_of(kind, tmp_path), trigger=fail)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_that_was_there_stays(tmp_path: Path) -> None:
    def fail(frame: RgbdFrame) -> bool:
        raise OSError(28, "No space left on device")

    (tmp_path / "walk").mkdir()
    with pytest.raises(OSError, match="No space"):
        capture.record(rgbd_frames.frames(1), tmp_path / "walk", trigger=fail)
    assert (tmp_path / "walk").is_dir()


def test_a_disk_too_small_for_the_calibration_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        (tmp_path / "walk").mkdir()  # as the recorder, which then cannot write into it
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("manip3d._core.open_recorder", refuse)
    with pytest.raises(OSError, match="No space"):
        capture.record(rgbd_frames.frames(1), tmp_path / "walk")
    assert list(tmp_path.iterdir()) == []


@each_kind
def test_an_unplugged_source_leaves_the_frames_before(kind: str, tmp_path: Path) -> None:
    frames = list(rgbd_frames.frames(5))

    def unplugged() -> Iterator[Any]:
        yield from frames
        raise DeviceError("camera: unplugged")

    with pytest.raises(DeviceError, match="camera: unplugged"):
        capture.record(unplugged(), path_of(kind, tmp_path), lossless_color=True)
    source = opened(kind, path_of(kind, tmp_path))
    assert source.num_frames == 5  # it was finished
    for frame, other in zip(frames, source, strict=True):
        assert_same(frame, other)


@each_kind
def test_frames_out_of_order_are_refused(kind: str, tmp_path: Path) -> None:
    first, second = rgbd_frames.frames(2)
    for name, wrong in (
        ("number", replace(second, number=first.number)),
        ("time_ns", replace(second, time_ns=first.time_ns)),
    ):
        path = path_of(kind, tmp_path, name)
        with pytest.raises(InputError, match=rf"frame\.{name}: expected more than the frame bef"):
            capture.record([first, wrong], path, lossless_color=True)
        (found,) = opened(kind, path)
        assert_same(first, found)


@each_kind
def test_images_of_size_zero_are_refused(kind: str, tmp_path: Path) -> None:
    (frame,) = rgbd_frames.frames(1)
    for empty in (np.zeros((0, 0), np.uint16), np.zeros((0, COLS), np.uint16)):
        with pytest.raises(InputError, match="depth: expected"):
            replace(frame, depth=empty)
    with pytest.raises(InputError, match="width"):
        Intrinsics(0, ROWS, 15.0, 15.5, 7.25, 6.5)
    tiny = RgbdCalibration(Intrinsics(1, 1, 15.0, 15.5, 0.0, 0.0))
    pixel = list(rgbd_frames.frames(1, tiny))
    path = path_of(kind, tmp_path)
    if kind == "mkv":
        with pytest.raises(InputError, match="expected at least 4 x 4 pixels for FFV1, got 1 x 1"):
            capture.record(pixel, path, lossless_color=True)
    else:
        capture.record(pixel, path, lossless_color=True)
        (found,) = opened(kind, path)
        assert_same(pixel[0], found)


@each_kind
def test_a_wrong_calibration_is_refused(kind: str, tmp_path: Path) -> None:
    frames = list(rgbd_frames.frames(2))
    path = path_of(kind, tmp_path)
    capture.record(frames, path, lossless_color=True)
    wrong = Intrinsics(COLS, ROWS - 1, 15.0, 15.0, 7.0, 6.0)
    with pytest.raises(FormatError, match=r"expected 16 x 11 pixels.* calibration") as error:
        opened(kind, path, camera=wrong).read()
    assert str(error.value.file).startswith(str(path))
    other = RgbdCalibration(Intrinsics(COLS + 1, ROWS, 15.0, 15.5, 7.25, 6.5))
    (alien,) = rgbd_frames.frames(1, other)
    later = replace(alien, time_ns=frames[0].time_ns + 1, number=frames[0].number + 1)
    path = path_of(kind, tmp_path, "changed")
    with pytest.raises(InputError, match=r"frame\.depth: expected 16 x 12 pixels, got 17 x 12"):
        capture.record([frames[0], later], path, lossless_color=True)
    (found,) = opened(kind, path)
    assert_same(frames[0], found)


# --- recordings that are in use -------------------------------------------------------------------


@pytest.mark.parametrize("given", ["address", "source", "generator"])
@each_kind
def test_a_recording_onto_itself_is_refused_before_it_is_touched(
    kind: str, given: str, tmp_path: Path
) -> None:
    path = path_of(kind, tmp_path)
    frames = list(rgbd_frames.frames(3))
    capture.record(frames, path, lossless_color=True)
    source: Any = f"{kind}:{path}" if given == "address" else opened(kind, path)
    if given == "generator":
        source = (replace(frame, skeletons=()) for frame in source)
    with pytest.raises(InputError, match=r"nobody has open, got .*walk.*, which is being read"):
        capture.record(source, path, overwrite=True)
    for frame, other in zip(frames, opened(kind, path), strict=True):
        assert_same(frame, other)


@each_kind
def test_a_source_that_ended_or_was_stopped_lets_others_record(kind: str, tmp_path: Path) -> None:
    path = path_of(kind, tmp_path)
    capture.record(rgbd_frames.frames(3), path)
    ended = opened(kind, path)
    assert len(list(ended)) == 3
    with opened(kind, path) as stopped:
        stopped.read()
    capture.record(rgbd_frames.frames(2), path, overwrite=True)
    assert opened(kind, path).num_frames == 2
    del ended, stopped


@pytest.mark.parametrize("kind", ["folder", "mkv", "tum"])
def test_an_earlier_recording_stays_until_a_frame_replaces_it(kind: str, tmp_path: Path) -> None:
    """A recording that ends before its first frame leaves the earlier recording in place."""
    place = f"{kind}:{tmp_path / ('walk.mkv' if kind == 'mkv' else 'walk')}"

    def stopped(frame: object) -> bool:
        raise KeyboardInterrupt

    def recorded(count: int, **options: Any) -> int:
        frames = rgbd_frames.frames(count, color=kind != "tum")
        return capture.record(frames, place, overwrite=True, **options).frames

    assert recorded(3) == 3
    assert recorded(2, trigger=lambda _: False) == 0
    with pytest.raises(KeyboardInterrupt):
        recorded(2, trigger=stopped)
    with capture.open(place) as source:
        assert len(list(source)) == 3  # type: ignore[arg-type]
    assert recorded(2) == 2
    with capture.open(place) as source:
        assert len(list(source)) == 2  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["folder", "mkv", "tum"])
@pytest.mark.parametrize("is_new", [False, True])
def test_a_source_without_frames_replaces_no_recording(
    kind: str, is_new: bool, tmp_path: Path
) -> None:
    """A closed source is an error; an iterator that has ended gives an empty recording."""
    frames = list(rgbd_frames.frames(3, color=kind != "tum"))
    name = "walk.mkv" if kind == "mkv" else "walk"
    place = f"{kind}:{tmp_path / name}"
    if not is_new:
        capture.record(frames, place)
    with capture.from_frames(frames) as closed:
        pass
    with pytest.raises(InputError, match="source: frames is closed"):
        capture.record(closed, place, overwrite=True)
    assert (tmp_path / name).exists() != is_new
    ended = capture.from_frames(iter(frames))
    assert len(list(ended)) == 3
    assert capture.record(ended, place, overwrite=True).frames == 0
    assert len(list(capture.open_rgbd(place))) == (0 if is_new else 3)


ENDLESS = """
import sys
import rgbd_frames
from manip3d import capture
def endless():
    for frame in rgbd_frames.frames(100_000):
        yield frame
        print("written", flush=True)
capture.record(endless(), sys.argv[1])
"""


@each_kind
def test_of_two_recorders_the_second_is_refused(kind: str, tmp_path: Path) -> None:
    path = path_of(kind, tmp_path)
    search = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    with subprocess.Popen(
        [sys.executable, "-c", ENDLESS, path],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": search},
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "written\n"
        with pytest.raises(InputError, match="which is being read or recorded"):
            capture.record(rgbd_frames.frames(1), path, overwrite=True)
        first.kill()
    frames = list(opened(kind, path))  # as the first left it
    for frame, other in zip(rgbd_frames.frames(len(frames)), frames, strict=True):
        assert_same(frame, other, color=False)
    capture.record(rgbd_frames.frames(1), path, overwrite=True)
    assert opened(kind, path).num_frames == 1


@each_kind
def test_what_is_killed_before_its_first_frame_can_be_replaced(kind: str, tmp_path: Path) -> None:
    path = path_of(kind, tmp_path)
    code = (
        "import os, sys, rgbd_frames; from manip3d import _core\n"
        "recorder = _core.open_recorder("
        "os.fsencode(sys.argv[1]), rgbd_frames.CALIBRATION, False, 90, False)\n"
        "os.kill(os.getpid(), 9)"
    )
    assert run([sys.executable, "-c", code, str(path)]).returncode == -9
    assert path.exists()
    capture.record(rgbd_frames.frames(2), path, overwrite=True)
    assert opened(kind, path).num_frames == 2


def test_a_folder_of_a_killed_recorder_is_told_from_other_folders(tmp_path: Path) -> None:
    killed = tmp_path / "killed"
    killed.mkdir()
    (killed / "calibration.json").write_text("{}")
    (killed / ".manip3d-abc123").write_text("half")
    capture.record(rgbd_frames.frames(2), killed, overwrite=True)
    assert sorted(p.name for p in killed.iterdir()) == [
        "body_index",
        "calibration.json",
        "colour",
        "depth",
        "frames.jsonl",
    ]
    images = tmp_path / "images"  # somebody's own, with a camera
    (images / "depth").mkdir(parents=True)
    (images / "calibration.json").write_text("{}")
    with pytest.raises(InputError, match="which holds files"):
        capture.record(rgbd_frames.frames(2), images, overwrite=True)
    assert (images / "depth").exists()
    (killed / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="which holds more than a recording"):
        capture.record(rgbd_frames.frames(1), killed, overwrite=True)
    assert len(list(opened("folder", killed))) == 2


def test_ray_tables_that_no_reader_takes_are_refused(tmp_path: Path) -> None:
    side = 2600  # 52 MiB; the reader takes 64 MiB of text
    rays = np.zeros((side, side, 2), np.float32)
    camera = Intrinsics(side, side, 1000.0, 1000.0, 1300.0, 1300.0, rays=rays)
    frame = RgbdFrame(np.zeros((side, side), np.uint16), RgbdCalibration(camera))
    with pytest.raises(InputError, match=r"calibration\.depth\.ray_table: expected at most 48 MiB"):
        capture.record([frame], tmp_path / "walk")
    assert not (tmp_path / "walk").exists()


@pytest.mark.parametrize(
    ("uri", "options"),
    [
        ("kitti:nowhere", {"model": "hdl64e"}),
        ("kitti:nowhere", {"max_bytes": 10}),
        ("ouster:nowhere.pcap", {"cut_azimuth": 90.0}),
        ("pcap:nowhere.pcap", {"sender": "127.0.0.1"}),
        ("pcap:nowhere.pcap", {"metadata": "a.json"}),
        ("velodyne:0", {"port": 2368}),
        ("velodyne:0", {"max_bytes": 10}),
    ],
)
def test_options_that_a_scheme_does_not_use_are_refused(uri: str, options: dict[str, Any]) -> None:
    (name,) = options
    with pytest.raises(InputError, match=f"{name}: expected none for {uri.split(':')[0]}:"):
        capture.open_lidar(uri, **options)
