"""RGB-D sources: recordings as folders, folders of images, TUM sequences, replay, no copies."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
import warnings
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

import rgbd_frames
from manip3d import DeviceError, FormatError, InputError, Intrinsics, RgbdFrame, capture, simplify
from manip3d._util.paths import by_number
from manip3d.capture import _frames_in_memory, _rgbd_source
from real_data import RealData
from rgbd_frames import CALIBRATION, CAMERA, COLS, ROWS, STEP, assert_same


def recorded(folder: Path, count: int = 5, **options: Any) -> list[RgbdFrame]:
    frames = list(rgbd_frames.frames(count))
    capture.record(frames, folder, **{"lossless_color": True, **options})
    return frames


def opened(folder: Path, **options: Any) -> capture.RgbdSource:
    return capture.open_rgbd(f"folder:{folder}", **options)


# --- recordings -----------------------------------------------------------------------------------


@pytest.mark.parametrize("calibration", [CALIBRATION, rgbd_frames.full_calibration()])
def test_a_folder_replays_bit_for_bit(tmp_path: Path, calibration: Any) -> None:
    frames = list(rgbd_frames.frames(5, calibration))
    done = capture.record(frames, tmp_path / "walk", lossless_color=True)
    assert (done.frames, done.stop, done.counters["frames"]) == (5, "end", 5)
    assert done.seconds == pytest.approx(4 * STEP / 1e9)
    with opened(tmp_path / "walk") as source:
        assert (source.num_frames, source.is_live) == (5, False)
        found = list(source)
        assert source.read() is None
        assert source.counters == {"frames": 5, "out_of_order": 0, "damaged": 0, "incomplete": 0}
    for frame, other in zip(frames, found, strict=True):
        assert_same(frame, other)
        assert other.calibration is source.calibration
    for name in ("fx", "fy", "cx", "cy", "distortion", "width", "height"):
        assert getattr(source.calibration.depth, name) == getattr(calibration.depth, name)
    if calibration.registration:
        registration = source.calibration.registration
        assert registration is not None
        assert registration.color.distortion == calibration.registration.color.distortion
        np.testing.assert_array_equal(registration.rotation, calibration.registration.rotation)
        np.testing.assert_array_equal(source.calibration.depth.rays, calibration.depth.rays)


def test_color_is_jpeg_by_default(tmp_path: Path) -> None:
    rows, cols = np.mgrid[:ROWS, :COLS]
    smooth = np.stack([10 * rows, 10 * cols, 0 * rows + 90], -1).astype(np.uint8)
    frame = RgbdFrame(np.ones((ROWS, COLS), np.uint16), CALIBRATION, color=smooth)
    capture.record([frame], tmp_path / "a")
    (path,) = (tmp_path / "a" / "colour").iterdir()
    assert path.suffix == ".jpg"
    (found,) = opened(tmp_path / "a")
    assert found.color is not None
    assert np.abs(found.color.astype(int) - smooth).max() < 25
    with Image.open(path) as image:
        assert np.abs(found.color.astype(int) - np.asarray(image)).max() <= 4  # other upsampling


def test_images_are_not_copied(tmp_path: Path) -> None:
    recorded(tmp_path / "walk", 2)
    source = opened(tmp_path / "walk")
    first, second = source.read(), source.read()
    assert first is not None
    assert second is not None
    kept = first.depth.copy()
    for name in ("depth", "body_index", "color"):
        image, other = getattr(first, name), getattr(second, name)
        owner = image
        while isinstance(owner, np.ndarray):
            owner = owner.base
        assert type(owner).__name__ == "PyCapsule"  # the core's own memory
        assert image.flags.c_contiguous
        assert image.flags.writeable
        assert not np.shares_memory(image, other)
    second.depth[:] = 0
    del source, second
    np.testing.assert_array_equal(first.depth, kept)


def test_a_frame_without_color_or_people(tmp_path: Path) -> None:
    depth = np.arange(ROWS * COLS, dtype=np.uint16).reshape(ROWS, COLS)
    capture.record([RgbdFrame(depth, CALIBRATION)], tmp_path / "a")
    (found,) = opened(tmp_path / "a")
    assert (found.color, found.body_index, found.skeletons) == (None, None, ())
    np.testing.assert_array_equal(found.depth, depth)


def test_record_takes_sources_generators_and_addresses(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "a", 6)
    assert capture.record(f"folder:{tmp_path / 'a'}", tmp_path / "b", frames=4).stop == "frames"
    with opened(tmp_path / "a") as source:
        done = capture.record(source, tmp_path / "c", seconds=2.5 * STEP / 1e9)
        assert (done.stop, done.frames, done.source_counters["frames"]) == ("seconds", 3, 4)
    said: list[float] = []
    done = capture.record(
        (frame for frame in frames), tmp_path / "d", progress=lambda part, _: said.append(part)
    )
    assert done.frames == len(said) == 6
    for name, count in (("b", 4), ("c", 3), ("d", 6)):
        for frame, other in zip(frames, opened(tmp_path / name), strict=False):
            assert_same(frame, other, color=False)
        assert opened(tmp_path / name).num_frames == count


def test_recorders_refuse_what_does_not_fit(tmp_path: Path) -> None:
    frames = list(rgbd_frames.frames(3))
    for order in ([1, 0], [1, 1]):
        with pytest.raises(InputError, match=r"frame\.number: expected more than the frame before"):
            capture.record([frames[i] for i in order], tmp_path / str(order))
        assert opened(tmp_path / str(order)).num_frames == 1  # what came before is good
    other = next(rgbd_frames.frames(1, rgbd_frames.full_calibration()))
    with pytest.raises(InputError, match=r"frame\.color: expected 16 x 12 pixels, got 20 x 10"):
        capture.record([frames[0], other], tmp_path / "size")
    far = [
        replace(frames[0], number=-(2**63), time_ns=-(2**63)),
        replace(frames[1], time_ns=2**63 - 1),
    ]
    capture.record(far, tmp_path / "far")
    assert [frame.time_ns for frame in opened(tmp_path / "far")] == [-(2**63), 2**63 - 1]
    crowd = replace(frames[0], skeletons=frames[0].skeletons * 65)
    with pytest.raises(InputError, match=r"frame\.skeletons: expected at most 64, got 65"):
        capture.record([crowd], tmp_path / "crowd")
    with pytest.raises(InputError, match="source: expected at least one frame, got none"):
        capture.record([], tmp_path / "none")
    with pytest.raises(InputError, match="jpeg_quality: expected 1 to 100, got 0"):
        capture.record(frames, tmp_path / "quality", jpeg_quality=0)
    with pytest.raises(InputError, match=r"path: expected a folder or a file that ends in .mkv"):
        capture.record(frames, tmp_path / "walk.avi")
    with pytest.raises(InputError, match="frames: expected > 0, got 0"):
        capture.record(frames, tmp_path / "zero", frames=0)
    with pytest.raises(FileNotFoundError):
        capture.record(frames, tmp_path / "no" / "such" / "folder")


@pytest.mark.parametrize("kind", ["folder", "mkv", "tum"])
@pytest.mark.parametrize("lossless", [False, True])
def test_colour_and_body_index_may_begin_after_the_first_frame(
    tmp_path: Path, kind: str, lossless: bool
) -> None:
    """Some cameras start with frames without colour; trackers find nobody at first."""
    frames = list(rgbd_frames.frames(6, rgbd_frames.full_calibration()))
    frames = [replace(frame, depth=frame.depth % 10_000) for frame in frames]  # TUM: up to 13 m
    for i, missing in enumerate([("color", "body_index"), ("body_index",), ("color",)]):
        frames[i] = replace(frames[i], **dict.fromkeys(missing))
    uri = f"{kind}:{tmp_path / 'late'}{'.mkv' if kind == 'mkv' else ''}"
    assert capture.record(frames, uri, lossless_color=lossless).frames == 6
    found = list(capture.open_rgbd(uri))
    assert [f.color is not None for f in found] == [False, True, False, True, True, True]
    for frame, expected in zip(found, frames, strict=True):
        assert np.array_equal(frame.depth, expected.depth)
        if kind != "tum":  # it has no body index, and colours at the pixels of depth
            assert_same(frame, expected, color=lossless)


def test_only_recordings_are_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "walk"
    recorded(folder, 5)
    with pytest.raises(InputError, match=r"got .*walk, which holds a recording"):
        recorded(folder)
    recorded(folder, 2, overwrite=True)
    assert opened(folder).num_frames == 2
    assert len(list((folder / "depth").iterdir())) == 2
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="which holds files"):
        recorded(other, overwrite=True)
    assert (other / "thesis.txt").read_text() == "mine"


WRITER = textwrap.dedent(
    """
    import itertools, sys
    import rgbd_frames
    from manip3d import capture
    def endless():
        for i, frame in enumerate(rgbd_frames.frames(10_000)):
            print(i, flush=True)  # frames before this one are written
            yield frame
    capture.record(endless(), sys.argv[1], lossless_color=True)
    """
)


def started(code: str, *arguments: object) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_what_a_killed_recorder_wrote_is_whole(tmp_path: Path) -> None:
    rng = random.Random(1)
    expected = list(rgbd_frames.frames(2000))
    for trial in range(5):
        folder = tmp_path / str(trial)
        with started(WRITER, folder) as process:
            assert process.stdout is not None
            for _ in range(2):  # the second line comes when the first frame is written
                process.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.1))
            process.send_signal(signal.SIGKILL)
            lines = process.stdout.read().split()
        written = int(lines[-1]) if lines else 0
        with opened(folder) as source:
            found = list(source)
            assert source.counters["damaged"] == 0
        assert len(found) >= written
        for frame, other in zip(expected, found, strict=False):
            assert_same(frame, other)


def test_ctrl_c_leaves_a_whole_recording(tmp_path: Path) -> None:
    with started(WRITER, tmp_path / "a") as process:
        assert process.stdout is not None
        for _ in range(20):
            process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert "KeyboardInterrupt" in process.communicate(timeout=20)[1]
    assert len(list(opened(tmp_path / "a"))) >= 19


def test_a_recorder_goes_on_when_there_is_room_again(tmp_path: Path) -> None:
    """A refused line is cut off, so that the next one starts where it did."""
    code = textwrap.dedent(
        """
        import os, resource, signal, sys
        import rgbd_frames
        from manip3d import _core
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        frames = list(rgbd_frames.frames(3, color=False))
        recorder = _core.open_recorder(
            os.fsencode(sys.argv[1]), frames[0].calibration, False, 90, False)
        recorder.write(frames[0])
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        size = os.path.getsize(os.path.join(sys.argv[1], "frames.jsonl"))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, limits[1]))
        try:
            recorder.write(frames[1])
        except OSError as error:
            print(error.errno)
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        recorder.write(frames[2])
        recorder.close()
        """
    )
    with started(code, tmp_path / "a") as process:
        out, errors = process.communicate(timeout=60)
    assert out == f"{errno.EFBIG}\n", errors
    frames = list(rgbd_frames.frames(3, color=False))
    first, last = opened(tmp_path / "a")
    assert_same(frames[0], first)
    assert_same(frames[2], last)


FAILING = textwrap.dedent(
    """
    import sys
    import rgbd_frames
    from manip3d import capture
    try:
        capture.record(rgbd_frames.frames(4), sys.argv[1], lossless_color=True)
    except OSError as error:
        sys.exit(error.errno)
    """
)


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.parametrize(
    ("call", "calls"),
    [
        ("write", 4),
        pytest.param("rename", 13, marks=pytest.mark.slow),
        ("fsync", 3),
    ],
)
def test_every_failing_system_call_leaves_the_frames_before(
    call: str, calls: int, tmp_path: Path
) -> None:
    probe = ["strace", "-f", "-qq", "-e", "trace=none", "true"]
    if subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("strace may not trace here")
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    expected = list(rgbd_frames.frames(4))
    for k in range(1, calls + 1):
        folder = tmp_path / f"{call}{k}"
        command = ["strace", "-f", "-qq", "-o", os.devnull, "-e", f"trace={call}"]
        command += ["-P", str(folder / "frames.jsonl")] if call == "write" else []
        command += ["-e", f"inject={call}:error=EIO:when={k}"]
        command += [sys.executable, "-c", FAILING, str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert done.returncode == errno.EIO, (call, k, done.stderr)
        if not (folder / "frames.jsonl").exists():
            continue  # it failed with the calibration, before any frame
        with opened(folder) as source:
            found = list(source)
            assert source.counters["damaged"] == source.counters["incomplete"] == 0
        images = [name for name in ("depth", "body_index", "colour") if (folder / name).exists()]
        assert all(len(os.listdir(folder / name)) == len(found) for name in images)
        for frame, other in zip(expected, found, strict=False):
            assert_same(frame, other)
        if call == "write":
            assert len(found) == k - 1


# --- damaged and hostile recordings ---------------------------------------------------------------


def test_a_line_without_its_end_is_not_there(tmp_path: Path) -> None:
    recorded(tmp_path / "a", 3)
    path = tmp_path / "a" / "frames.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    for cut in (1, 20, len(lines[2]) - 1):
        path.write_bytes(b"".join(lines[:2]) + lines[2][:cut])
        with opened(tmp_path / "a") as source:
            assert source.num_frames == len(list(source)) == 2
            assert source.counters["incomplete"] == 1


def test_damage_is_named_and_the_next_frame_comes(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "a", 6)
    folder = tmp_path / "a"
    data = bytearray((folder / "depth" / "000000.png").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "depth" / "000000.png").write_bytes(data)
    (folder / "depth" / "000001.png").write_bytes(b"")
    (folder / "colour" / "000002.png").write_bytes(b"no image")
    (folder / "body_index" / "000003.png").unlink()
    source = opened(folder)
    with pytest.raises(FormatError, match=r"depth/000000\.png: damaged: .* \(CRC-32\)"):
        source.read()
    with pytest.raises(FormatError, match=r"depth/000001\.png"):
        source.read()
    with pytest.raises(FormatError, match=r"colour/000002\.png"):
        source.read()
    with pytest.raises(FileNotFoundError):
        source.read()
    for frame, other in zip(frames[4:], source, strict=True):
        assert_same(frame, other)
    assert source.counters["damaged"] == 4
    assert source.counters["frames"] == 2


def test_frames_out_of_order_are_passed_over_and_counted(tmp_path: Path) -> None:
    recorded(tmp_path / "a", 5)
    path = tmp_path / "a" / "frames.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[i] for i in (0, 2, 1, 2, 4, 3)))
    source = opened(tmp_path / "a")
    assert [frame.time_ns for frame in source] == [10**15 + i * STEP for i in (0, 2, 4)]
    assert source.counters["out_of_order"] == 3


def test_a_wrong_calibration_is_named(tmp_path: Path) -> None:
    recorded(tmp_path / "a", 1)
    camera = Intrinsics(COLS, ROWS - 1, 15.0, 15.0, 7.0, 6.0)
    pixels = "expected 16 x 11 pixels as the calibration says, got 16 x 12"
    with pytest.raises(FormatError, match=rf"depth/000000\.png: {pixels}"):
        opened(tmp_path / "a", camera=camera).read()
    path = tmp_path / "a" / "calibration.json"
    told = json.loads(path.read_text())
    for change, message in (
        ({"width": 0}, r"/depth/width: expected a whole number in \[1, 16384\], got 0"),
        ({"fx": -1.0}, r"depth\.fx: expected a finite number > 0"),
        ({"fx": "x"}, "/depth/fx: expected a number"),
        ({"rays": "AAAA"}, "/depth/rays: expected two floats for each of 16 x 12 pixels"),
        ({"distortion": [0.0] * 4}, "/depth/distortion: expected 5 numbers"),
    ):
        depth = {**told["calibration"]["depth"], **change}
        changed = {**told["calibration"], "depth": depth}
        path.write_text(json.dumps({**told, "calibration": changed}))
        with pytest.raises(FormatError, match=message) as error:
            opened(tmp_path / "a")
        assert error.value.file == str(path)


def hostile(line: dict[str, Any], **changes: Any) -> str:
    return json.dumps({**line, **changes})


def test_hostile_lines_are_refused_with_their_number(tmp_path: Path) -> None:
    recorded(tmp_path / "a", 1)
    path = tmp_path / "a" / "frames.jsonl"
    line = json.loads(path.read_text())
    image = {"file": "../../secret.png", "crc32": 0}
    people = line["skeletons"]
    for text, message in (
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 100, "nested deeper than 64"),
        ("[" + "0," * 200_000 + "0]", "expected at most 100000 values"),
        ("null", "expected an object, got null"),
        ('{"number": 1e400}', "a number is out of range"),
        (hostile(line, number=2**63), "/number: expected a whole number"),
        (hostile(line, time_ns=0.5), "/time_ns: expected a whole number"),
        (hostile(line, depth=image), "/depth/file: expected the name of a file in this folder"),
        (hostile(line, depth={"file": "a.png"}), '/depth: expected a member "crc32"'),
        (hostile(line, skeletons=people * 65), "expected at most 64 skeletons"),
        (hostile(line, skeletons=[{**people[0], "states": [3] * 25}]), "/states/0: expected a"),
        (hostile(line, skeletons=[{**people[0], "positions": [0]}]), "expected 75 numbers"),
        (hostile(line, skeletons=[{**people[0], "body": 256}]), "/body: expected a whole number"),
    ):
        path.write_text(text + "\n")
        with pytest.raises(FormatError, match=message) as error:
            opened(tmp_path / "a").read()
        assert (error.value.file, error.value.line) == (str(path), 1)


def png_header(width: int, height: int, depth: int = 16) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4)

    fields = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([depth, 0, 0, 0, 0])
    pixels = zlib.compress(b"\0" * 100)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", fields) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("size", [(0, 12), (16, 0), (16384, 16384), (2**31 - 1, 12), (16, 12)])
def test_an_image_that_promises_too_much(tmp_path: Path, size: tuple[int, int]) -> None:
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "0.png").write_bytes(png_header(*size))
    with pytest.raises(FormatError, match=r"depth/0\.png"):
        opened(tmp_path, camera=CAMERA).read()


@given(data=st.data())
def test_damaged_images_are_errors_or_images(data: st.DataObject, tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.mktemp("a", numbered=True)
    (folder / "depth").mkdir()
    (folder / "rgb").mkdir()
    for name, image, kind in (
        ("depth/0.png", np.arange(ROWS * COLS, dtype=np.uint16).reshape(ROWS, COLS), "PNG"),
        ("rgb/0.jpg", np.full((ROWS, COLS, 3), 77, np.uint8), "JPEG"),
    ):
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, kind)
        content = bytearray(buffer.getvalue())
        position = data.draw(st.integers(0, len(content) - 1))
        content[position] = data.draw(st.integers(0, 255))
        (folder / name).write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with contextlib.suppress(FormatError):
        frame = opened(folder, camera=CAMERA).read()
        assert frame is not None
        assert frame.depth.shape == (ROWS, COLS)


# --- folders of images, TUM -----------------------------------------------------------------------


def images(folder: Path, name: str, count: int, image: NDArray[Any], suffix: str = "png") -> None:
    (folder / name).mkdir(parents=True, exist_ok=True)
    for i in range(count):
        Image.fromarray(image + image.dtype.type(i)).save(folder / name / f"{i:03}.{suffix}")


DEPTH = (1000 + np.arange(ROWS * COLS, dtype=np.uint16)).reshape(ROWS, COLS)
COLOR = np.arange(ROWS * COLS * 3, dtype=np.uint16).reshape(ROWS, COLS, 3).astype(np.uint8)


def test_colours_of_another_size_without_a_registration_are_left_out(tmp_path: Path) -> None:
    """Nobody knows which pixel of depth they belong to, whatever the sizes."""
    for name, shape in (("depth", (ROWS, COLS)), ("color", (2 * ROWS, 2 * COLS, 3))):
        (tmp_path / name).mkdir()
        for number in range(3):
            image = np.full(shape, 1000, np.uint16) if name == "depth" else np.ones(shape, np.uint8)
            Image.fromarray(image).save(tmp_path / name / f"{number}.png")
    camera = Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=COLS, height=ROWS)
    with capture.open_rgbd(f"folder:{tmp_path}", camera=camera) as source:
        with pytest.warns(UserWarning, match="of another size than the depth images") as warned:
            frames = list(source)
        assert len(warned) == 1
        assert [frame.color for frame in frames] == [None] * 3
        assert source.counters["unregistered_color"] == 3


@pytest.mark.parametrize(("name", "suffix"), [("color", "PNG"), ("colour", "png"), ("rgb", "png")])
def test_plain_folders_of_images(tmp_path: Path, name: str, suffix: str) -> None:
    images(tmp_path, "depth", 4, DEPTH)
    for file in (tmp_path / "depth").iterdir():
        file.rename(file.with_suffix(f".{suffix}"))
    images(tmp_path, name, 4, COLOR)
    with pytest.raises(InputError, match=r"has no calibration\.json"):
        opened(tmp_path)
    found = list(opened(tmp_path, camera=CAMERA))
    assert [frame.number for frame in found] == [0, 1, 2, 3]
    assert found[3].time_ns == 10**8  # 30 a second
    for i, frame in enumerate(found):
        np.testing.assert_array_equal(frame.depth, DEPTH + i)
        np.testing.assert_array_equal(frame.color, COLOR + np.uint8(i))
    (tmp_path / name / "003.png").unlink()
    with pytest.raises(FormatError, match="as many colour as depth images, got 3 and 4"):
        opened(tmp_path, camera=CAMERA)
    with pytest.raises(FormatError, match=r"expected frames\.jsonl, or PNG images in"):
        opened(tmp_path / name, camera=CAMERA)


def test_plain_folders_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Colours with leading zeros belong to depths without them."""
    camera = Intrinsics(16, 12, 15.0, 15.0, 7.5, 5.5)
    names = [*range(12), 10**30]
    for kind in ("depth", "color"):
        (tmp_path / kind).mkdir()
    for i, name in enumerate(names):
        depth = np.full((12, 16), 1000 + i, np.uint16)
        Image.fromarray(depth).save(tmp_path / "depth" / f"a{name}.png")
        color = np.full((12, 16, 3), i, np.uint8)
        Image.fromarray(color).save(tmp_path / "color" / f"a{name:02}.png")
    found = list(opened(tmp_path, camera=camera))
    assert [int(f.depth[0, 0]) - 1000 for f in found] == list(range(13))
    assert [int(f.color[0, 0, 0]) for f in found if f.color is not None] == list(range(13))


# In the order of `by_number`: digits go first, then the other characters, and equal values by text.
NAMES = ["01.png", "1.png", "1-2.png", "1-10.png", "1a.png", "2.png", "A.png", "a.png", "a00.png"]
NAMES += ["a0.png", "a1b2.png", "a1b10.png", "a2.png", "a-1.png", "aa.png"]
# Decimal numbers, whose digits after the point are a fraction, and names that are none.
DECIMALS = ["0.5.png", "0.25.png", "00.125.png", "1.25.png", "1.31a.png", "1.4a.png"]
DECIMALS += ["1.2.31.png", "1.2.4.png", "a0.5.png", "a0.25.png"]
TAKES = [f"1.{i}.png" for i in range(1, 13)]


@pytest.mark.parametrize("more", [DECIMALS, TAKES, [*DECIMALS, *TAKES]])
def test_plain_folders_are_sorted_as_in_python(more: list[str], tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    names = [*NAMES, *more]
    for i, name in enumerate(names):
        depth = np.full((12, 16), 1000 + i, np.uint16)
        Image.fromarray(depth).save(tmp_path / "depth" / name)
    found = opened(tmp_path, camera=Intrinsics(16, 12, 15.0, 15.0, 7.5, 5.5))
    order = [names[int(f.depth[0, 0]) - 1000] for f in found]
    assert order == sorted(names, key=by_number(names))
    if more is DECIMALS:
        assert order.index("0.25.png") < order.index("0.5.png")
    else:
        assert [name for name in order if name in TAKES] == TAKES


SMALL = Intrinsics(16, 12, 15.0, 15.0, 7.5, 5.5)


def named_images(folder: Path, depth: list[str], color: list[str]) -> list[str]:
    """Write images that hold their place in these lists, and return the paths of depth images."""
    for kind, names in (("depth", depth), ("color", color)):
        (folder / kind).mkdir(parents=True)
        for i, name in enumerate(names):
            depth_image = np.full((12, 16), 1000 + i, np.uint16)
            image = depth_image if kind == "depth" else np.full((12, 16, 3), i, np.uint8)
            Image.fromarray(image).save(folder / kind / f"{name}.png")
    return [str(folder / "depth" / f"{name}.png") for name in depth]


def partners(source: capture.RgbdSource) -> list[tuple[int, int | None]]:
    """Return the places of the depth and the colour image of each frame."""
    return [
        (int(f.depth[0, 0]) - 1000, None if f.color is None else int(f.color[0, 0, 0]))
        for f in source
    ]


def test_images_of_lost_frames_leave_gaps(tmp_path: Path) -> None:
    """Equally many depth and colour images, of different frames: an order is shifted."""
    depth = [f"{i:06}" for i in range(12) if i != 3]
    color = [f"{i:06}" for i in range(12) if i != 7]
    named_images(tmp_path, depth, color)
    source = opened(tmp_path, camera=SMALL, rate=10.0)
    frames = list(source)
    assert [frame.number for frame in frames] == [i for i in range(12) if i != 3]
    assert [frame.time_ns for frame in frames] == [i * 10**8 for i in range(12) if i != 3]
    assert partners(opened(tmp_path, camera=SMALL)) == [
        (i, color.index(name) if name in color else None) for i, name in enumerate(depth)
    ]
    assert source.counters["without_color"] == 1
    assert source[3].number == 4  # an index counts images
    with pytest.raises(InputError, match=r"found 10 of 11, none for 000007\.png$"):
        simplify.colors_of_frames(sorted((tmp_path / "depth").iterdir()), tmp_path / "color")


def test_names_that_are_times_give_the_times(tmp_path: Path) -> None:
    """Names of Python's floats, which lack trailing zeros."""
    at = 1_700_000_000
    depth = [f"{at}.0", f"{at}.03333", f"{at}.1", f"{at}.13333", f"{at}.2", f"{at}.23333"]
    color = [f"{at}.035", f"{at}.11", f"{at}.13", f"{at}.195", f"{at}.3"]
    frames = named_images(tmp_path, depth, color)
    source = opened(tmp_path, camera=SMALL)
    found = list(source)
    seconds = [0, 33_330_000, 100_000_000, 133_330_000, 200_000_000, 233_330_000]
    assert [frame.time_ns - at * 10**9 for frame in found] == seconds
    assert [frame.number for frame in found] == list(range(6))
    expected = [(0, None), (1, 0), (2, 1), (3, 2), (4, 3), (5, None)]
    assert partners(opened(tmp_path, camera=SMALL)) == expected
    assert source.counters["without_color"] == 2
    assert source.assumed_rate is None
    with pytest.raises(InputError, match=r"rate: expected none, since the frames of .* have"):
        opened(tmp_path, camera=SMALL, rate=30.0)
    pairs = simplify.colors_of_frames(frames[1:5], tmp_path / "color")
    assert [Path(pairs[frame]).stem for frame in frames[1:5]] == color[:4]
    for i in range(4):
        (tmp_path / "color" / f"{at + 1 + i}.5.png").write_bytes(b"of no frame")
    (tmp_path / "color" / "preview.png").write_bytes(b"of no time")
    assert partners(opened(tmp_path, camera=SMALL)) == expected
    (tmp_path / "depth" / "preview.png").write_bytes(b"of no time")
    for i in range(4):
        (tmp_path / "depth" / f"{at + 1 + i}.5.png").write_bytes(b"")
    with pytest.raises(FormatError, match=r"preview\.png: expected a time as its name"):
        opened(tmp_path, camera=SMALL)


@pytest.mark.parametrize("last", [9, 12, 120])
def test_numbers_of_takes_and_frames_are_no_times(last: int, tmp_path: Path) -> None:
    names = [f"1.{i}" for i in range(1, last + 1)]
    files = named_images(tmp_path, names, names)
    frames = list(opened(tmp_path, camera=SMALL, rate=10.0))
    assert [frame.time_ns for frame in frames] == [i * 10**8 for i in range(last)]
    assert partners(opened(tmp_path, camera=SMALL)) == [(i, i) for i in range(last)]
    pairs = simplify.colors_of_frames(files, tmp_path / "color")
    assert [Path(pairs[file]).stem for file in files] == names
    assert sorted(reversed(files), key=by_number(files)) == files


def test_times_of_two_clocks_are_refused(tmp_path: Path) -> None:
    named_images(tmp_path, ["10.000", "10.100"], ["10.025", "10.130"])
    with pytest.raises(FormatError, match=r"within 0\.02 s of depth images, got 0\.025000 s as"):
        opened(tmp_path, camera=SMALL)


@pytest.mark.parametrize(
    ("depth", "color"),
    [
        ([f"{i}_640x480" for i in range(6)], [f"{i}_640x480" for i in range(1, 7)]),
        ([f"depth_{i}_cam0" for i in range(6)], [f"rgb_{i}_cam0" for i in range(1, 7)]),
        (["1-000", "2-033", "3-067", "4-101"], ["1-000", "2-034", "3-069", "4-100"]),
        ([*map(str, range(0, 363, 33)), "370"], [*map(str, range(0, 396, 36)), "400"]),
        (["-1", "0", "1"], ["-1", "0", "1"]),
        (["1", "01", "2"], ["1", "01", "2"]),
    ],
)
def test_names_are_paired_in_order_where_few_agree(
    depth: list[str], color: list[str], tmp_path: Path
) -> None:
    files = named_images(tmp_path, depth, color)
    found = partners(opened(tmp_path, camera=SMALL))
    assert all(partner == i for i, partner in found)
    assert len(found) == len(depth)
    pairs = simplify.colors_of_frames(files, tmp_path / "color")
    assert [Path(pairs[file]).stem for file in files] == color


def random_names(rng: np.random.Generator, kind: int) -> tuple[list[str], list[str]]:
    """Return names of depth and colour images of which some are lost."""
    kept = [np.flatnonzero(rng.random(16) > rng.choice([0.0, 0.1, 0.3])) for _ in range(2)]
    first = int(rng.choice([0, 1, 5]))
    lists: list[list[str]] = []
    for shows, own in zip(("depth", "rgb"), kept, strict=True):
        number = own + first * (shows == "rgb") * int(rng.integers(0, 2))
        if kind == 0:
            names = [f"{n:04}" if shows == "rgb" else str(n) for n in number]
        elif kind == 1:
            names = [f"{shows}_{n}" for n in number]
        elif kind == 2:
            names = [f"{'img' if shows == 'rgb' else 'scan'}{n}" for n in number]
        else:
            names = [f"{7.0 + n / 30 + 0.004 * rng.random():.5f}".rstrip("0") for n in number]
        lists.append(names)
    return lists[0], lists[1]


@pytest.mark.parametrize("kind", range(4))
@pytest.mark.parametrize("seed", range(8))
def test_meshes_have_the_colours_of_the_frames(kind: int, seed: int, tmp_path: Path) -> None:
    """Both agree if both pair all depth images, and frames without a colour are an error."""
    depth, color = random_names(np.random.default_rng([seed, kind]), kind)
    files = named_images(tmp_path, depth, color)
    try:
        seen = partners(opened(tmp_path, camera=SMALL))
    except FormatError:
        with pytest.raises(InputError):
            simplify.colors_of_frames(files, tmp_path / "color")
        return
    colored = [files[i] for i, partner in seen if partner is not None]
    if len(colored) < len(files):
        with pytest.raises(InputError):
            simplify.colors_of_frames(files, tmp_path / "color")
    pairs = simplify.colors_of_frames(colored, tmp_path / "color")
    chosen = [color.index(Path(pairs[file]).stem) for file in colored]
    assert chosen == [partner for _, partner in seen if partner is not None]


@pytest.mark.parametrize("units", [1000.0, 5000.0, 100.0])
def test_the_largest_number_is_no_measurement(tmp_path: Path, units: float) -> None:
    """7-Scenes and many cameras store it; in 100 units per metre it would be refused."""
    depth = np.full_like(DEPTH, 500)
    depth[0, :3] = 65_535, 65_534 if units > 100.0 else 500, 0
    images(tmp_path, "depth", 1, depth)
    (frame,) = opened(tmp_path, camera=CAMERA, units_per_metre=units)
    expected = np.floor(depth * (1000.0 / units) + 0.5)
    expected[0, 0] = 0
    np.testing.assert_array_equal(frame.depth, expected)


def test_units_of_plain_folders(tmp_path: Path) -> None:
    images(tmp_path, "depth", 1, DEPTH)
    (frame,) = opened(tmp_path, camera=CAMERA, units_per_metre=5000.0)
    np.testing.assert_array_equal(frame.depth, np.floor(DEPTH / 5 + 0.5))
    with pytest.raises(FormatError, match=r"expected depths up to 65\.535 m"):
        opened(tmp_path, camera=CAMERA, units_per_metre=10.0).read()
    for units in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="units_per_metre: expected > 0"):
            opened(tmp_path, camera=CAMERA, units_per_metre=units)


@pytest.mark.parametrize("units", [1000.0, 5000.0, 500.0])
def test_pixels_of_65535_are_not_measured_whatever_the_unit(tmp_path: Path, units: float) -> None:
    """Many cameras and data sets (7-Scenes) mark missing pixels by the largest number of 16 bits.

    In units of 2 mm it would be a depth that no frame can hold.
    """
    marked = DEPTH.copy()
    marked[2, 3:7] = 65535
    images(tmp_path / "marked", "depth", 1, marked)
    images(tmp_path / "zeros", "depth", 1, np.where(marked == 65535, 0, marked).astype(np.uint16))
    source = opened(tmp_path / "marked", camera=CAMERA, units_per_metre=units)
    (frame,) = source
    (expected,) = opened(tmp_path / "zeros", camera=CAMERA, units_per_metre=units)
    np.testing.assert_array_equal(frame.depth, expected.depth)
    assert frame.depth[2, 2:8].astype(bool).tolist() == [True, *[False] * 4, True]
    assert source.counters["pixels_of_65535"] == 4
    capture.record([frame], tmp_path / "again")


def test_mirrored_images_are_turned_round(tmp_path: Path) -> None:
    images(tmp_path, "depth", 1, DEPTH)
    images(tmp_path, "color", 1, COLOR)
    mirrored = Intrinsics(COLS, ROWS, 15.0, 15.5, 7.25, 6.5, mirrored=True)
    source = opened(tmp_path, camera=mirrored)
    (frame,) = source
    np.testing.assert_array_equal(frame.depth, DEPTH[:, ::-1])
    np.testing.assert_array_equal(frame.color, COLOR[:, ::-1])
    assert source.calibration.depth.cx == COLS - 1 - 7.25
    assert not source.calibration.depth.mirrored
    assert source.flipped == ("depth", "color")
    assert opened(tmp_path, camera=mirrored, speed=1.0).flipped == ("depth", "color")
    assert opened(tmp_path, camera=CAMERA).flipped == ()
    assert capture.from_frames([frame]).flipped == ()


def test_a_recording_in_matroska_tells_that_its_images_are_flipped(tmp_path: Path) -> None:
    recorded(tmp_path / "walk.mkv", 1)
    mirrored = replace(CAMERA, mirrored=True)
    with capture.open_rgbd(f"mkv:{tmp_path / 'walk.mkv'}", camera=mirrored) as source:
        assert source.flipped == ("depth", "color")
    with capture.open_rgbd(f"mkv:{tmp_path / 'walk.mkv'}") as source:
        assert source.flipped == ()


def test_images_without_times_come_at_a_rate(tmp_path: Path) -> None:
    images(tmp_path, "depth", 4, DEPTH)
    usual = opened(tmp_path, camera=CAMERA)
    assert [frame.time_ns for frame in usual] == [0, 33_333_333, 66_666_666, 100_000_000]
    assert usual.assumed_rate == 30.0
    given = opened(tmp_path, camera=CAMERA, rate=12.5)
    assert [frame.time_ns for frame in given] == [0, 80_000_000, 160_000_000, 240_000_000]
    assert given.assumed_rate == 12.5
    assert opened(tmp_path, camera=CAMERA, rate=12.5, speed=9.0).assumed_rate == 12.5
    summary = capture.summarize(opened(tmp_path, camera=CAMERA, rate=12.5))
    assert (summary.assumed_rate, summary.frames_per_second) == (12.5, pytest.approx(12.5))
    assert summary.record()["assumed_rate"] == 12.5


@pytest.mark.parametrize("rate", [0.0, -1.0, 0.001, 1001.0, float("nan"), float("inf")])
def test_a_rate_is_that_of_a_camera(tmp_path: Path, rate: float) -> None:
    images(tmp_path, "depth", 1, DEPTH)
    with pytest.raises(InputError, match="rate: expected"):
        opened(tmp_path, camera=CAMERA, rate=rate)


def test_frames_that_have_times_take_no_rate(tmp_path: Path) -> None:
    recorded(tmp_path / "walk", 1)
    assert opened(tmp_path / "walk").assumed_rate is None
    with pytest.raises(InputError, match=r"rate: expected none, since the frames of .*walk have"):
        opened(tmp_path / "walk", rate=15.0)
    recorded(tmp_path / "walk.mkv", 1)
    for uri in (f"mkv:{tmp_path / 'walk.mkv'}", f"tum:{tmp_path / 'walk'}"):
        with pytest.raises(InputError, match="rate: can only be given with a folder of images"):
            capture.open_rgbd(uri, rate=15.0)
    with pytest.raises(InputError, match="rate: expected none of them for sim:"):
        capture.open_rgbd("sim:body?frames=1", rate=15.0)


def test_8_bit_and_color_pngs_of_all_kinds(tmp_path: Path) -> None:
    grey = (DEPTH % 256).astype(np.uint8)
    images(tmp_path, "depth", 1, grey)
    (tmp_path / "rgb").mkdir()
    for kind in ("L", "P", "RGBA", "LA", "1"):
        Image.fromarray(COLOR).convert(kind).save(tmp_path / "rgb" / "0.png")
        with pytest.warns(UserWarning, match=r"depth images of 8 bits reach 0\.255 m"):
            (frame,) = opened(tmp_path, camera=CAMERA)
        np.testing.assert_array_equal(frame.depth, grey)
        expected = Image.open(tmp_path / "rgb" / "0.png").convert("RGB")
        np.testing.assert_array_equal(frame.color, np.asarray(expected))


def with_chunk(path: Path, kind: bytes, data: bytes) -> None:
    """Insert a chunk before the pixels of a PNG."""
    png = path.read_bytes()
    chunk = len(data).to_bytes(4, "big") + kind + data
    chunk += zlib.crc32(kind + data).to_bytes(4, "big")
    start = png.index(b"IDAT") - 4
    path.write_bytes(png[:start] + chunk + png[start:])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_transparent_value_of_depth_is_one_like_others(tmp_path: Path, dtype: Any) -> None:
    depth = np.full((ROWS, COLS), 200, dtype)
    depth[0] = 100
    images(tmp_path, "depth", 1, depth)
    (path,) = (tmp_path / "depth").iterdir()
    with_chunk(path, b"tRNS", (100).to_bytes(2, "big"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about 8 bits
        (frame,) = opened(tmp_path, camera=CAMERA)
    np.testing.assert_array_equal(frame.depth, depth)


def test_colours_of_a_cmyk_jpeg(tmp_path: Path) -> None:
    images(tmp_path, "depth", 1, DEPTH)
    (tmp_path / "rgb").mkdir()
    path = tmp_path / "rgb" / "0.jpg"
    Image.fromarray(COLOR).convert("CMYK").save(path, quality=95)
    (frame,) = opened(tmp_path, camera=CAMERA)
    assert frame.color is not None
    expected = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert np.abs(frame.color - expected).max() <= 2
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(FormatError, match="damaged JPEG image"):
        list(opened(tmp_path, camera=CAMERA))


def test_depth_images_are_pngs(tmp_path: Path) -> None:
    images(tmp_path, "depth", 2, DEPTH)
    Image.fromarray(COLOR).save(tmp_path / "depth" / "preview.jpg")
    assert [f.number for f in opened(tmp_path, camera=CAMERA)] == [0, 1]
    for path in (tmp_path / "depth").glob("*.png"):
        path.unlink()
    with pytest.raises(FormatError, match=r"or PNG images in"):
        opened(tmp_path, camera=CAMERA)


@pytest.mark.parametrize("name", ["image", "images"])
def test_other_names_of_folders_of_colours(name: str, tmp_path: Path) -> None:
    images(tmp_path, "depth", 2, DEPTH)
    images(tmp_path, name, 2, COLOR)
    for i, frame in enumerate(opened(tmp_path, camera=CAMERA)):
        np.testing.assert_array_equal(frame.color, COLOR + np.uint8(i))


@pytest.mark.parametrize("name", ["image", "images"])
@pytest.mark.parametrize("pictures", [["a.png"], ["broken.jpg"], [f"{i}.png" for i in range(5)]])
def test_pictures_of_a_general_name_need_not_be_colours(
    pictures: list[str], name: str, tmp_path: Path
) -> None:
    """Only folders that are named after colours hold nothing else."""
    images(tmp_path, "depth", 3, DEPTH)
    (tmp_path / name).mkdir()
    for each in pictures:
        Image.fromarray(COLOR).save(tmp_path / name / each)
    with pytest.warns(UserWarning, match=f"no colour: pictures in {name} are left out, since"):
        frames = list(opened(tmp_path, camera=CAMERA))
    assert [frame.color for frame in frames] == [None] * 3
    (tmp_path / name).rename(tmp_path / "color")
    with pytest.raises(FormatError, match=r"got (1|5) and 3"):
        opened(tmp_path, camera=CAMERA)


def test_pictures_beside_depth_that_are_left_out_are_told(tmp_path: Path) -> None:
    """Grey images may be masks or confidences, which nobody takes for colours."""
    images(tmp_path, "depth", 1, DEPTH)
    images(tmp_path, "confidence", 1, DEPTH)
    (tmp_path / "absent").mkdir()
    (tmp_path / "absent" / "0.png").symlink_to(tmp_path / "nowhere.png")
    (tmp_path / "absent" / "._0.jpg").write_bytes(b"\0\5\x16\7")  # macOS writes it
    assert opened(tmp_path, camera=CAMERA).read() is not None
    for name, suffix in (("left", "jpg"), ("frames", "png")):
        images(tmp_path, name, 1, COLOR, suffix)
    with pytest.warns(UserWarning, match="no colour: pictures in frames, left are left out, since"):
        opened(tmp_path, camera=CAMERA)
    images(tmp_path, "rgb", 1, COLOR)
    assert opened(tmp_path, camera=CAMERA)[0].color is not None


@pytest.mark.parametrize(("median", "is_told"), [(150, True), (1000, False), (16_000, True)])
def test_depth_that_speaks_against_the_assumed_unit_is_told(
    median: int, is_told: bool, tmp_path: Path
) -> None:
    empty = np.zeros((ROWS, COLS), np.uint16)
    images(tmp_path, "depth", 1, empty)
    for number in (1, 2):
        image = Image.fromarray(np.full((ROWS, COLS), median, np.uint16))
        image.save(tmp_path / "depth" / f"{number:03}.png")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        frames = list(opened(tmp_path, camera=CAMERA))
        assert [int(frame.depth.max()) for frame in frames] == [0, median, median]
    expected = f"the median of the depth is {median / 1000:.3g} m with the 1000 units per metre"
    assert [expected in str(each.message) for each in told] == ([True] if is_told else [])
    list(opened(tmp_path, camera=CAMERA, units_per_metre=1000))  # which is then no assumption


def test_lists_without_colours_state_the_unit_that_is_assumed(tmp_path: Path) -> None:
    """OpenLORIS has the lists of a TUM sequence, and millimetres."""
    tum(tmp_path / "freiburg1", ["1.0"], ["1.0"])
    folder = tmp_path / "freiburg1"
    (folder / "rgb.txt").rename(folder / "color.txt")
    with pytest.warns(UserWarning, match=r"no rgb\.txt .*; 5000 units per metre are assumed"):
        (frame,) = capture.open_rgbd(f"tum:{folder}", camera=CAMERA)
    assert frame.color is not None
    (frame,) = capture.open_rgbd(f"tum:{folder}", camera=CAMERA, units_per_metre=1000)
    np.testing.assert_array_equal(frame.depth, DEPTH)


def tum(folder: Path, depth_times: list[str], color_times: list[str], comment: str = "#") -> None:
    images(folder, "depth", len(depth_times), DEPTH)
    images(folder, "rgb", len(color_times), COLOR)
    for name, file, times in (("depth", "depth", depth_times), ("rgb", "rgb", color_times)):
        lines = [f"{time} {file}/{i:03}.png\n" for i, time in enumerate(times)]
        text = f"{comment} {name} maps\n# file: 'x.bag'\n# timestamp filename\n" + "".join(lines)
        (folder / f"{name}.txt").write_text(text)


def test_tum_sequences(tmp_path: Path) -> None:
    depth = ["1305031102.160407", "1305031102.194330", "1305031102.226738", "1305031102.300000"]
    tum(tmp_path, depth, ["1305031102.175304", "1305031102.211214", "1305031102.243211"])
    source = capture.open_rgbd(f"tum:{tmp_path}", camera=CAMERA)
    found = list(source)
    assert source.num_frames == len(found) == 4
    assert source.counters["without_color"] == 1
    for frame, text in zip(found, depth, strict=True):
        assert abs(frame.time_ns - int(text.replace(".", "")) * 1000) < 1000
    for i, frame in enumerate(found):
        np.testing.assert_array_equal(frame.depth, np.floor((DEPTH + i) / 5 + 0.5))
    chosen = [None if f.color is None else int(f.color[0, 0, 0]) for f in found]
    assert chosen == [0, 1, 2, None]  # 15, 17, 16 ms apart; the last one 57
    with pytest.raises(FormatError, match="expected 640 x 480 pixels as the calibration says"):
        capture.open_rgbd(f"tum:{renamed(tmp_path, 'rgbd_dataset_freiburg1_xyz')}").read()


def test_pixels_of_65535_of_a_tum_sequence_are_not_measured(tmp_path: Path) -> None:
    tum(tmp_path, ["1305031102.160407"], [])
    marked = DEPTH.copy()
    marked[0, :3] = 65535
    (file,) = (tmp_path / "depth").iterdir()
    Image.fromarray(marked).save(file)
    (frame,) = capture.open_rgbd(f"tum:{tmp_path}", camera=CAMERA)
    assert frame.depth[0, :4].tolist() == [0, 0, 0, (marked[0, 3] + 2) // 5]


def renamed(folder: Path, name: str) -> Path:
    """The same sequence under another name."""
    shutil.copytree(folder, folder / name, ignore=lambda _, names: {name} & set(names))
    return folder / name


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("rgbd_dataset_freiburg1_desk", (517.3, 516.5, 318.6, 255.3)),
        ("rgbd_dataset_freiburg2_pioneer_slam", (520.9, 521.0, 325.1, 249.7)),
        ("fr3_walking_xyz", (535.4, 539.2, 320.1, 247.6)),
    ],
)
def test_tum_cameras_go_by_the_sequence(
    tmp_path: Path, name: str, camera: tuple[float, ...]
) -> None:
    tum(tmp_path, ["1.0"], ["1.0"])
    depth = capture.open_rgbd(f"tum:{renamed(tmp_path, name)}/").calibration.depth
    assert (depth.fx, depth.fy, depth.cx, depth.cy) == camera


@pytest.mark.parametrize("name", ["desk", "fr4_desk", "afr1", "freiburg12", "fr"])
def test_a_tum_sequence_of_another_name_is_warned_about(tmp_path: Path, name: str) -> None:
    tum(tmp_path, ["1.0"], ["1.0"])
    folder = renamed(tmp_path, name)
    with pytest.warns(UserWarning, match=r"camera: .*freiburg1.*got") as warned:
        source = capture.open_rgbd(f"tum:{folder}")
    assert warned[0].filename == __file__
    assert source.calibration.depth.fx == 525.0
    assert source.counters["nominal_camera"] == 1
    assert "nominal_camera" not in capture.open_rgbd(f"tum:{folder}", camera=CAMERA).counters


def test_a_tum_sequence_may_have_a_calibration_of_its_own(tmp_path: Path) -> None:
    capture.record(rgbd_frames.frames(1), tmp_path / "recording")
    tum(tmp_path, ["1.0"], ["1.0"])
    folder = renamed(tmp_path, "freiburg1")
    shutil.copy(tmp_path / "recording" / "calibration.json", folder)
    stored = capture.open_rgbd(f"folder:{tmp_path / 'recording'}").calibration.depth
    mine = capture.open_rgbd(f"tum:{folder}").calibration.depth
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(mine, name) == getattr(stored, name)
    assert mine.fx != 517.3


def test_tum_lists_that_are_wrong(tmp_path: Path) -> None:
    tum(tmp_path, ["1.0"], ["1.0"])
    for line, message in (
        ("x depth/000.png", "time: expected a finite number, got 'x'"),
        ("1.0", "file: expected a name inside the sequence's folder"),
        ("1.0 /etc/passwd", "file: expected a name inside"),
        ("1.0 depth/../../secret.png", "file: expected a name inside"),
        ("1e300 depth/000.png", "time: expected seconds up to 9e9"),
    ):
        (tmp_path / "depth.txt").write_text(f"# a\n\n{line}\n")
        with pytest.raises(FormatError, match=message) as error:
            capture.open_rgbd(f"tum:{tmp_path}")
        assert (error.value.file, error.value.line) == (str(tmp_path / "depth.txt"), 3)
    with pytest.raises(FileNotFoundError):
        capture.open_rgbd(f"tum:{tmp_path / 'depth'}")


def test_real_folders(realdata: RealData) -> None:
    root = realdata("rgbd")
    camera = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    for name, units in (("scene_icl_nuim_livingroom", 5000.0), ("scene_redwood_synthetic", 1000.0)):
        found = list(opened(root / name, camera=camera, units_per_metre=units))
        assert len(found) == 5
        depths = sorted((root / name / "depth").iterdir())
        for path, frame in zip(depths, found, strict=True):
            with Image.open(path) as image:
                expected = np.asarray(image).astype(float) * 1000 / units
            assert np.abs(frame.depth - expected).max() <= 0.5
            assert frame.color is not None
            assert frame.color.std() > 10


# --- replay ---------------------------------------------------------------------------------------


def test_real_time_is_the_frames_times(tmp_path: Path) -> None:
    recorded(tmp_path / "a", 8)
    begin = time.monotonic_ns()
    with opened(tmp_path / "a", speed=1.0) as source:
        assert source.is_live
        for frame in source:
            assert time.monotonic_ns() - begin >= frame.time_ns - 10**15
    last = (10**15 + 7 * STEP, 7 + 3)
    assert (frame.time_ns, frame.number) == last  # the last one is never lost
    assert source.counters["dropped"] + source.counters["frames"] >= 8


def test_a_slow_reader_gets_the_latest(tmp_path: Path) -> None:
    recorded(tmp_path / "a", 12)
    with opened(tmp_path / "a", speed=1.0) as source:
        deadline = time.monotonic() + 30
        while source.counters["dropped"] < 11 and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(0.2)
        (frame,) = source
        assert frame.time_ns == 10**15 + 11 * STEP
        assert source.counters["dropped"] == 11
        assert 0.2e9 <= time.time_ns() - frame.grabbed_ns < 60e9  # it waited all the time
    with opened(tmp_path / "a") as source:
        assert {frame.grabbed_ns for frame in source} == {0}


def test_stop_wakes_a_reader(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "a", 1)
    later = RgbdFrame(frames[0].depth, CALIBRATION, number=9, time_ns=frames[0].time_ns + 10**13)
    capture.record([frames[0], later], tmp_path / "b")
    source = opened(tmp_path / "b", speed=1.0)
    assert source.read() is not None
    assert source.read(timeout=0.05) is None
    timer = threading.Timer(0.2, source.stop)
    timer.start()
    assert source.read() is None  # else it waits for hours
    timer.join()


def test_ctrl_c_ends_the_wait(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "a", 1)
    later = RgbdFrame(frames[0].depth, CALIBRATION, number=9, time_ns=frames[0].time_ns + 10**13)
    capture.record([frames[0], later], tmp_path / "b")
    code = textwrap.dedent(
        """
        import sys
        from manip3d import capture
        source = capture.open_rgbd("folder:" + sys.argv[1], speed=1.0)
        source.read()
        print("waiting", flush=True)
        source.read()
        """
    )
    with started(code, tmp_path / "b") as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert "KeyboardInterrupt" in process.communicate(timeout=20)[1]


def test_errors_of_the_thread_reach_the_reader(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "a", 3)
    (tmp_path / "a" / "depth" / "000001.png").write_bytes(b"")
    source = opened(tmp_path / "a", speed=100.0)
    assert source.read() is not None
    with pytest.raises(FormatError, match=r"000001\.png"):
        list(source)
    source.start()
    last = source.read()
    assert last is not None
    assert_same(frames[2], last)


# --- the list of schemes --------------------------------------------------------------------------


def test_sources_say_what_is_here() -> None:
    schemes = {scheme.name: scheme for scheme in capture.sources()}
    assert {"folder", "tum", "mkv", "openni2", "sim", "pcap", "velodyne"} <= set(schemes)
    assert schemes["folder"].is_available
    for scheme in schemes.values():
        assert scheme.is_available == (not scheme.reason) == (not scheme.cure)
        assert scheme.frames in ("rgbd", "lidar")
        assert "\n" not in scheme.description


def test_a_source_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected at least one frame, got none"):
        capture.record(iter([]), tmp_path / "empty")
    assert not (tmp_path / "empty").exists()


def test_numbers_that_decrease_are_not_missing_ones() -> None:
    frames = [
        replace(one, number=number)
        for one, number in zip(rgbd_frames.frames(4), (10, 0, 1, 4), strict=True)
    ]
    assert capture.summarize(capture.from_frames(frames)).num_missing == 2


def test_addresses_that_lead_nowhere(tmp_path: Path) -> None:
    for uri in ("nothing:here", "folder", "", ":"):
        with pytest.raises(InputError, match="uri: expected one of folder:"):
            capture.open(uri)
    with pytest.raises(InputError, match="speed: expected a finite number >= 0"):
        opened(tmp_path, speed=-1.0)
    with pytest.raises(InputError, match="expected none of them for sim:"):
        capture.open("sim:body", camera=CAMERA)
    with pytest.raises(InputError, match="speed: expected a finite number >= 0"):
        capture.open("sim:body", speed=-1.0)
    with pytest.raises((FileNotFoundError, FormatError)):
        capture.open(f"folder:{tmp_path / 'missing'}", camera=CAMERA)
    for scheme in capture.sources():
        if scheme.name in ("openni2", "freenect2", "realsense", "orbbec") and scheme.reason:
            with pytest.raises(DeviceError, match=f"{scheme.name}: "):
                capture.open(f"{scheme.name}:")


@pytest.mark.parametrize(
    ("before", "expected"), [(0.0, [6]), (0.1, [3, 4, 5, 6]), (60.0, range(7))]
)
def test_a_trigger_begins_a_recording_with_what_was_before(
    tmp_path: Path, before: float, expected: Iterable[int]
) -> None:
    """Frames are 1/30 s apart, so that 0.1 s are three of them; the trigger stays on."""
    there = list(rgbd_frames.frames(12))
    there = [replace(f, number=n, time_ns=n * 100_000_000 // 3) for n, f in enumerate(there)]
    asked: list[int] = []

    def trigger(frame: RgbdFrame) -> bool:
        asked.append(frame.number)
        return frame.number == 6

    done = capture.record(there, tmp_path / "a", trigger=trigger, before=before, frames=3)
    assert asked == list(range(7))
    numbers = [frame.number for frame in capture.open_rgbd(f"folder:{tmp_path / 'a'}")]
    assert numbers == [*expected, 7, 8]
    assert (done.frames, done.stop) == (len(numbers), "frames")
    assert done.seconds == pytest.approx((8 - numbers[0]) / 30)
    timed = capture.record(there, tmp_path / "b", trigger=trigger, before=before, seconds=0.05)
    assert (timed.frames, timed.stop) == (len(list(expected)) + 1, "seconds")


def test_what_was_before_a_clock_that_began_again_is_not_before_a_trigger(tmp_path: Path) -> None:
    there = [
        replace(frame, number=number, time_ns=time)
        for number, (frame, time) in enumerate(
            zip(rgbd_frames.frames(4), (10**12, 10**12 + 1, 0, 10), strict=True)
        )
    ]
    done = capture.record(there, tmp_path / "a", trigger=lambda f: f.number == 3, before=1.0)
    assert done.frames == 2


def test_a_trigger_that_never_comes_and_seconds_that_are_none(tmp_path: Path) -> None:
    there = list(rgbd_frames.frames(3))
    done = capture.record(there, tmp_path / "a", trigger=lambda _: False, before=1.0)
    assert (done.frames, done.seconds, done.stop) == (0, 0.0, "end")
    for before in (-1.0, 61.0, float("nan")):
        with pytest.raises(InputError, match="before: expected 0 to 60 seconds"):
            capture.record(there, tmp_path / "b", trigger=lambda _: True, before=before)
    with pytest.raises(InputError, match="before: can only be given with a trigger"):
        capture.record(there, tmp_path / "b", before=1.0)


class Made(Sequence[RgbdFrame]):
    """Frames of a simulator or a data set that take time to be made."""

    def __init__(self, clock: list[float], seconds: float, rate: float | None) -> None:
        self.clock, self.seconds, self.made = clock, seconds, list[int]()
        if rate is not None:
            self.rate = rate

    def __len__(self) -> int:
        return 30

    def __getitem__(self, index: Any) -> RgbdFrame:
        if not 0 <= index < 30:
            raise IndexError
        self.clock[0] += self.seconds
        self.made.append(index)
        image = next(iter(rgbd_frames.frames(1)))
        return replace(image, time_ns=index * 100_000_000, number=index)


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands unless somebody sleeps."""
    now = [100.0]
    monkeypatch.setattr(_frames_in_memory.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(
        _frames_in_memory.time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds)
    )
    return now


def played(
    frames: Made, reader_s: float, speed: float = 1.0
) -> tuple[list[int], capture.RgbdSource]:
    """Numbers of the frames that a reader gets who takes so long with each."""
    source = _rgbd_source.source_of(frames, "made", speed)
    numbers = []
    for frame in source:
        numbers.append(frame.number)
        frames.clock[0] += reader_s
    return numbers, source


def test_a_simulator_does_not_make_the_frames_that_its_reader_misses(wall: list[float]) -> None:
    """Frames of 0.1 s; making one takes 0.04 s, and the reader 0.26: every third one is seen."""
    frames = Made(wall, 0.04, rate=10.0)
    numbers, source = played(frames, 0.26)
    assert numbers == frames.made
    assert numbers == [0, *range(2, 29, 3), 29]
    assert source.counters == {"frames": len(numbers), "dropped": 30 - len(numbers)}
    assert wall[0] == pytest.approx(103.1, abs=0.3)  # in real time


def test_a_data_set_leaves_out_the_frames_that_its_reader_misses(wall: list[float]) -> None:
    numbers, source = played(Made(wall, 0.0, rate=None), 0.24)
    steps = np.diff(numbers)
    assert set(steps.tolist()) <= {1, 2, 3}
    assert steps.mean() == pytest.approx(2.4, abs=0.3)
    assert source.counters["dropped"] == 30 - len(numbers)


@pytest.mark.parametrize("rate", [10.0, None])
def test_a_quick_reader_gets_all_frames_at_their_times(
    wall: list[float], rate: float | None
) -> None:
    numbers, source = played(Made(wall, 0.03, rate=rate), 0.01, speed=2.0)
    assert numbers == list(range(30))
    assert source.counters["dropped"] == 0
    assert wall[0] == pytest.approx(100.0 + 2.9 / 2.0, abs=0.1)


def test_frames_that_are_made_more_slowly_than_they_are_played_are_not_caught_up_with(
    wall: list[float],
) -> None:
    """Were all late ones left out, none but the first and the last would be seen."""
    numbers, _ = played(Made(wall, 0.3, rate=None), 0.0)
    assert len(numbers) > 10


def test_a_reader_who_paused_does_not_wait_until_all_is_caught_up_with(wall: list[float]) -> None:
    """Frames of 0.1 s that take 0.096 s: a second is made good in 250 frames, not in one read."""
    source = _rgbd_source.source_of(Made(wall, 0.096, rate=None), "made", 1.0)
    source.read()
    wall[0] += 1.0
    before = wall[0]
    assert source.read() is not None
    assert wall[0] - before < 0.5


def test_speed_0_waits_for_its_reader(wall: list[float]) -> None:
    numbers, source = played(Made(wall, 0.3, rate=10.0), 5.0, speed=0.0)
    assert numbers == list(range(30))
    assert source.counters["dropped"] == 0


@pytest.mark.parametrize(("speed", "dropped"), [(1.0, 1), (20.0, 0)])
def test_how_late_a_frame_may_be_is_told_by_the_readers_clock(
    wall: list[float], speed: float, dropped: int
) -> None:
    """A reader 0.02 s late misses 0.4 s of a source at speed 20, which nobody sees."""
    source = _rgbd_source.source_of(Made(wall, 0.0, rate=None), "made", speed)
    source.read()
    wall[0] += 0.1 / speed + max(0.02, 0.06 / speed)
    source.read()
    assert source.counters["dropped"] == dropped


def test_simulated_people_are_given_at_their_times(wall: list[float]) -> None:
    pytest.importorskip("open3d")
    with capture.open_rgbd("sim:body?frames=4&room=no&rate=2", speed=50.0) as source:
        given = [(frame.time_ns, wall[0] - 100.0) for frame in source]
    times = [0, 500_000_000, 1_000_000_000, 1_500_000_000]
    assert [time for time, _ in given] == times
    assert [after for _, after in given] == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert source.counters == {"frames": 4, "dropped": 0}
    with capture.open_rgbd("sim:body?frames=4&room=no&rate=2", speed=0.5) as source:
        source.read()
        wall[0] += 2.5  # its reader misses the second one
        assert [frame.time_ns for frame in source] == times[2:]
        assert source.counters == {"frames": 3, "dropped": 1}


def test_a_stop_ends_the_wait_for_the_time_of_a_frame() -> None:
    pytest.importorskip("open3d")
    with capture.open_rgbd("sim:body?frames=3&room=no&rate=1", speed=0.001) as source:
        source.read()
        assert source.read(timeout=0.0) is None  # not yet
        threading.Timer(0.3, source.stop).start()
        assert source.read(timeout=60.0) is not None  # the frame that it had


def test_the_clock_of_frames_waits_for_their_times(wall: list[float]) -> None:
    """Twice as fast as they were."""
    clock = _frames_in_memory.FrameClock(2.0)
    assert clock.is_due(5_000_000_000, 1000)
    assert wall[0] == 100.0
    assert clock.is_due(5_500_000_000, 1000)
    assert wall[0] == pytest.approx(100.25)
    assert not clock.is_due(60_000_000_000, 100)
    assert wall[0] == pytest.approx(100.35)
    wall[0] = 200.0
    assert clock.late_s(6_000_000_000) == pytest.approx(199.0)
    assert clock.is_due(6_000_000_000, 1000)
    clock.restart(6_000_000_000)
    assert clock.is_due(7_000_000_000, 1000)
    assert wall[0] == pytest.approx(200.5)
    assert not clock.is_due(90_000_000_000, -1)
    assert wall[0] == pytest.approx(200.5)  # a negative timeout is none
    clock.stop()
    assert clock.late_s(0) == 0.0
    assert clock.is_due(90_000_000_000, 0)


def test_frames_in_memory_are_due_at_once_after_a_seek(wall: list[float]) -> None:
    source = _frames_in_memory.IteratedFrames(Made(wall, 0.0, rate=10.0), None, 1.0)
    assert source.read(0)
    wall[0] += 2.0
    source.seek(3)
    frame = source.read(0)
    assert isinstance(frame, RgbdFrame)
    assert frame.number == 3
    assert source.counters()["dropped"] == 0


def test_frames_in_memory_go_on_after_the_one_read_by_its_index(wall: list[float]) -> None:
    """A reader who is then 0.35 s late misses two frames of 0.1 s."""
    source = _frames_in_memory.IteratedFrames(Made(wall, 0.0, rate=10.0), None, 1.0)
    assert source.read(0)
    assert source.read_at(3).number == 3
    for number in (4, 5):
        frame = source.read(1000)
        assert isinstance(frame, RgbdFrame)
        assert frame.number == number
    wall[0] += 0.35
    frame = source.read(1000)
    assert isinstance(frame, RgbdFrame)
    assert frame.number == 8
    assert source.counters()["dropped"] == 2


def test_only_indices_of_frames_that_can_be_read_again_are_accepted(wall: list[float]) -> None:
    frames = Made(wall, 0.0, rate=None)
    source = _frames_in_memory.IteratedFrames(frames, None)
    for go in (source.seek, source.read_at):
        with pytest.raises(InputError, match="index: expected >= 0, got -1"):
            go(-1)
    with pytest.raises(InputError, match="index: expected that of a frame, got 30"):
        source.read_at(30)
    once = _frames_in_memory.IteratedFrames(iter(rgbd_frames.frames(2)), None)
    with pytest.raises(InputError, match="source: expected frames with an index, got an iterator"):
        once.seek(0)


def test_a_frame_is_read_by_its_index_while_others_wait(wall: list[float]) -> None:
    """Another thread that seeks between the search of a frame and its reading gets it otherwise."""
    is_free: list[bool] = []

    class Watched(Made):
        def __getitem__(self, index: Any) -> RgbdFrame:
            other = threading.Thread(
                target=lambda: is_free.append(source._lock.acquire(blocking=False))
            )
            other.start()
            other.join()
            return super().__getitem__(index)

    calibration = next(iter(rgbd_frames.frames(1))).calibration
    source = _frames_in_memory.IteratedFrames(Watched(wall, 0.0, rate=None), calibration)
    assert source.read_at(3).number == 3
    assert is_free == [False]


def test_people_of_the_data_sets_are_sources(realdata: RealData, tmp_path: Path) -> None:
    realdata.needs("people_utd_mhad")
    with capture.open("utd-mhad:a3_s1") as source:
        done = capture.record(source, tmp_path / "a", frames=5)
    assert done.frames == 5
    again = list(opened(tmp_path / "a"))
    for frame, other in zip(capture.open("utd-mhad:a3_s1"), again, strict=False):
        assert isinstance(frame, RgbdFrame)
        assert_same(frame, other)


@pytest.mark.parametrize("name", ["walk", "walk.mkv"])
def test_a_recording_that_has_ended_begins_anew(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    numbers = [frame.number for frame in recorded(path, 3)]
    with capture.open_rgbd(f"{'mkv' if path.suffix else 'folder'}:{path}") as source:
        assert [frame.number for frame in islice(source, 2)] == numbers[:2]
        assert [frame.number for frame in source] == numbers[2:]  # goes on where reading stopped
        assert source.read() is None
        for _ in range(2):
            assert [frame.number for frame in source] == numbers
            assert source.counters["frames"] == 3
        assert source.read() is None
        source.start()
        first = source.read()
        assert first is not None
        assert first.number == numbers[0]
        while source.read() is not None:
            pass
    for again in (iter(source), source.past_errors()):  # nobody would close it again
        with pytest.raises(InputError, match=r"source: .*walk.* is closed"):
            next(again)
    source.start()
    assert [frame.number for frame in source] == numbers
    source.stop()


@pytest.mark.parametrize("other", [None, 5, "a frame"])
@pytest.mark.parametrize("place", [0, 2])
def test_what_is_no_frame_is_told(other: object, place: int) -> None:
    there: list[Any] = [*rgbd_frames.frames(3)]
    there[place] = other
    with pytest.raises(InputError, match=f"expected frames of an RGB-D camera, got {other!r}"):
        list(capture.from_frames(there))


def test_frames_that_are_there_begin_anew() -> None:
    there = list(rgbd_frames.frames(3))
    numbers = [frame.number for frame in there]
    source = capture.from_frames(there)
    for _ in range(2):
        assert [frame.number for frame in source] == numbers
    once = capture.from_frames(iter(there))
    assert [frame.number for frame in once] == numbers
    assert list(once) == []
