"""Frames by their index, and sequences in the TUM layout for other programs."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import rgbd_frames
from command_line import manip3d
from manip3d import (
    FormatError,
    InputError,
    Intrinsics,
    Registration,
    RgbdCalibration,
    RgbdFrame,
    _core,
    capture,
    simplify,
)
from manip3d.capture._first_image import first_depth_size
from manip3d.cli.terminal import left_out
from manip3d.simplify._time_stamps import associate
from rgbd_frames import CALIBRATION, CAMERA, STEP, assert_same


def recorded(path: Path | str, count: int = 12) -> list[RgbdFrame]:
    frames = list(rgbd_frames.frames(count))
    capture.record(frames, path, lossless_color=True)
    return frames


def address(path: Path) -> str:
    return f"{'mkv' if path.suffix else 'folder'}:{path}"


# --- index ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["walk", "walk.mkv"])
def test_frames_by_their_index(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    frames = recorded(path)
    with capture.open_rgbd(address(path)) as source:
        assert len(source) == 12
        first = source.read()
        assert first is not None
        for index in (7, 3, 4, 11, 0, -1, -12):
            assert_same(source[index], frames[index])
        for found, expected in zip(source[2:9:3], frames[2:9:3], strict=True):
            assert_same(found, expected)
        second = source.read()  # an index does not move what is read next
        assert second is not None
        assert_same(second, frames[1])
        for index in (12, -13):
            with pytest.raises(IndexError, match=f"frame {index} of 12"):
                source[index]
        assert source.counters["frames"] == 2
    capture.record(frames[:2], path, overwrite=True)  # an index keeps no recording open


@pytest.mark.parametrize("name", ["walk", "walk.mkv"])
@pytest.mark.parametrize("speed", [0.0, 50.0])
def test_seek_is_where_reading_goes_on(tmp_path: Path, name: str, speed: float) -> None:
    path = tmp_path / name
    numbers = [frame.number for frame in recorded(path)]
    with capture.open_rgbd(address(path), speed=speed) as source:
        for index in (9, 2, 11, 12, -3):
            source.seek(index)
            at = index % 12 if index != 12 else 12
            found = [frame.number for frame in source]
            if speed:  # a slow reader may miss some, never the last one
                assert set(found) <= set(numbers[at:])
                assert found[-1:] == numbers[at:][-1:]
            else:
                assert found == numbers[at:]
                assert source.counters["frames"] == len(found)
                assert source.counters.get("lost", 0) == source.counters.get("cut_short", 0) == 0
        source.stop()
        source.seek(11)
        assert [frame.number for frame in source] == numbers[11:]
        for index in (13, -13):
            with pytest.raises(InputError, match="index: expected -12 to 12"):
                source.seek(index)
    with capture.open_rgbd(address(path), start=10) as source:
        for _ in range(2):  # begins there again
            assert [frame.number for frame in source] == numbers[10:]
        assert source[0].number == numbers[0]
    with pytest.raises(InputError, match="start: expected less than the 12 frames"):
        capture.open_rgbd(address(path), start=12)
    with pytest.raises(InputError, match="start: expected >= 0"):
        capture.open_rgbd(address(path), start=-1)


@pytest.mark.parametrize("name", ["walk", "walk.mkv"])
def test_a_recording_in_real_time_begins_anew(tmp_path: Path, name: str) -> None:
    numbers = [frame.number for frame in recorded(tmp_path / name, 3)]
    with capture.open_rgbd(address(tmp_path / name), speed=20.0) as source:
        for _ in range(2):
            assert [frame.number for frame in source][-1] == numbers[-1]


def test_an_unfinished_file_has_no_length_but_frames(tmp_path: Path) -> None:
    """The file of a killed recorder has no index of packets, but its frames are found by index."""
    path = tmp_path / "cut.mkv"
    frames = recorded(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    with capture.open_rgbd(f"mkv:{path}") as source:
        if source.num_frames is None:
            with pytest.raises(TypeError, match="number of frames is unknown"):
                len(source)
            with pytest.raises(InputError, match="index: expected >= 0"):
                source.seek(-1)
        assert source
        for index in (5, 2, 3, 0):
            assert_same(source[index], frames[index])
        with pytest.raises(IndexError):
            source[11]
        source.seek(4)
        found = source.read()
        assert found is not None
        assert_same(found, frames[4])


def test_a_damaged_frame_is_named_by_its_index(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    image = tmp_path / "walk" / "depth" / "000004.png"
    image.write_bytes(image.read_bytes()[:-20])
    source = capture.open_rgbd(f"folder:{tmp_path / 'walk'}")
    with pytest.raises(FormatError, match="000004"):
        source[4]
    assert_same(source[5], frames[5])
    recorded(tmp_path / "walk.mkv")
    whole = bytearray((tmp_path / "walk.mkv").read_bytes())
    middle = whole.index(b'"index":4,')  # its record, whose hash is then another
    whole[middle + 8 : middle + 9] = b"7"
    (tmp_path / "walk.mkv").write_bytes(whole)
    source = capture.open_rgbd(f"mkv:{tmp_path / 'walk.mkv'}")
    with pytest.raises(FormatError, match="frame 4 is damaged or lost"):
        source[4]
    core = _core.open_rgbd(f"mkv:{tmp_path / 'walk.mkv'}".encode(), 0.0, 0.0, 0.0, None)
    with pytest.raises(FormatError, match="frame 4 is damaged or lost"):
        core.read_at(4)
    assert core.read(0)["number"] == frames[5].number
    for index in (5, 3):
        assert_same(source[index], frames[index])
    source.seek(4)
    found = source.read()
    assert found is not None
    assert_same(found, frames[5])


def test_a_list_of_frames_that_is_gone_for_a_while_is_an_error_each_time(tmp_path: Path) -> None:
    numbers = [frame.number for frame in recorded(tmp_path / "walk")]
    with capture.open_rgbd(address(tmp_path / "walk")) as source:
        assert source[5].number == numbers[5]
        lines = (tmp_path / "walk" / "frames.jsonl").rename(tmp_path / "elsewhere")
        for index in (1, 5, 0):  # the first one crashed the second
            with pytest.raises(FileNotFoundError):
                source[index]
        lines.rename(tmp_path / "walk" / "frames.jsonl")
        assert source[1].number == numbers[1]


def test_an_index_while_another_thread_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = [frame.number for frame in recorded(tmp_path / "walk", 3)]
    source = capture.open_rgbd(address(tmp_path / "walk"))
    open_indexed = source._open_indexed
    assert open_indexed is not None

    class Stopped:
        """A source that is stopped, as if by another thread, while a frame is read."""

        def __init__(self) -> None:
            self.inner = open_indexed()

        def read_at(self, index: int) -> Any:
            source.stop()
            return self.inner.read_at(index)

        def stop(self) -> None:
            self.inner.stop()

    monkeypatch.setattr(source, "_open_indexed", Stopped)
    assert source[1].number == numbers[1]


def test_sequences_have_an_index_and_iterators_have_none() -> None:
    frames = list(rgbd_frames.frames(5))
    source = capture.from_frames(frames)
    assert (len(source), source[3].number, source[-1].number) == (5, 4, 6)
    source.seek(3)
    assert [frame.number for frame in source] == [4, 6]

    class Made:
        """An iterable that can be iterated again, but has neither length nor index."""

        def __iter__(self) -> Any:
            return iter(frames)

    made = capture.from_frames(Made())
    made.seek(4)
    assert [frame.number for frame in made] == [6]
    assert made[2].number == frames[2].number
    with pytest.raises(IndexError, match="the recording ends before it"):
        made[5]
    once = capture.from_frames(iter(frames))
    with pytest.raises(InputError, match="source: expected a recording, whose frames"):
        once.seek(1)
    with pytest.raises(InputError, match="source: expected a recording, whose frames"):
        once[1]


def test_a_simulated_person_by_index() -> None:
    uri = "sim:body?frames=6&motion=wave&color=none"
    with capture.open_rgbd(uri, start=4) as source:
        there = list(capture.open_rgbd(uri))
        assert [frame.number for frame in source] == [4, 5]
        np.testing.assert_array_equal(source[2].depth, there[2].depth)


# --- TUM ------------------------------------------------------------------------------------------


def test_a_tum_sequence_is_what_was_recorded(tmp_path: Path) -> None:
    limit = 13106
    frames = [
        replace(f, depth=np.minimum(f.depth, limit), time_ns=1305031102_160407123 + n * STEP)
        for n, f in enumerate(rgbd_frames.frames(4))
    ]
    done = capture.record(frames, f"tum:{tmp_path / 'walk'}")
    assert (done.path, done.frames, done.counters["too_far"]) == (tmp_path / "walk", 4, 0)
    with capture.open_rgbd(f"tum:{tmp_path / 'walk'}") as source, warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(source.calibration.depth, name) == getattr(CAMERA, name)
        for number, (found, frame) in enumerate(zip(source, frames, strict=True)):
            plain = replace(frame, body_index=None, skeletons=(), number=number)
            assert_same(found, plain)
        assert source.counters["without_color"] == 0
        assert source[2].time_ns == frames[2].time_ns


def test_other_programs_read_a_tum_sequence(tmp_path: Path) -> None:
    """A reader written by the benchmark's rules, without this library, gets the recorded frames."""
    frames = list(rgbd_frames.frames(3))
    done = capture.record(frames, f"tum:{tmp_path / 'walk'}")
    root = tmp_path / "walk"
    pairs = [line.split() for line in (root / "associations.txt").read_text().splitlines()]
    depths = [
        line.split()
        for line in (root / "depth.txt").read_text().splitlines()
        if not line.startswith("#")
    ]
    assert [pair[2:] for pair in pairs] == depths
    too_far = 0
    for frame, (color_time, color_file, depth_time, depth_file) in zip(frames, pairs, strict=True):
        assert (
            float(color_time) == float(depth_time) == pytest.approx(frame.time_ns / 1e9, abs=1e-9)
        )
        image = cv2.imread(str(root / depth_file), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert image.dtype == np.uint16
        reaches = frame.depth <= 13106
        np.testing.assert_array_equal(image / 5000.0, np.where(reaches, frame.depth, 0) / 1000.0)
        too_far += int((~reaches).sum())
        color = cv2.imread(str(root / color_file), cv2.IMREAD_COLOR)
        assert color is not None
        np.testing.assert_array_equal(color[..., ::-1], frame.color)
    assert done.counters["too_far"] == too_far > 0


def test_a_tum_sequence_without_colour_and_a_second_one_in_its_place(tmp_path: Path) -> None:
    place = f"tum:{tmp_path / 'walk'}"
    capture.record(rgbd_frames.frames(3, color=False), place)
    with pytest.raises(InputError, match="which holds a recording"):
        capture.record(rgbd_frames.frames(1), place)
    capture.record(rgbd_frames.frames(2, color=False), place, overwrite=True)
    with capture.open_rgbd(place) as source:
        assert [frame.color for frame in source] == [None, None]
    (tmp_path / "walk" / "groundtruth.txt").touch()  # somebody's own
    with pytest.raises(InputError, match="more than a recording"):
        capture.record(rgbd_frames.frames(1), place, overwrite=True)
    with pytest.raises(InputError, match="path: expected a place after tum:"):
        capture.record(rgbd_frames.frames(1), "tum:")
    early = replace(next(rgbd_frames.frames(1)), time_ns=-1_500_000_000)
    capture.record([early], f"tum:{tmp_path / 'early'}")
    assert next(iter(capture.open_rgbd(f"tum:{tmp_path / 'early'}"))).time_ns == -1_500_000_000


def test_a_tum_sequence_that_is_torn_has_its_whole_frames(tmp_path: Path) -> None:
    """A part of a line, left by a killed writer or an interrupted copy, is ignored."""
    folder = tmp_path / "walk"
    frames = [replace(f, depth=np.minimum(f.depth, 13106)) for f in rgbd_frames.frames(3)]
    capture.record(frames, f"tum:{folder}")
    whole = {name: (folder / name).read_bytes() for name in ("depth.txt", "rgb.txt")}
    for name, text in whole.items():
        last = text.splitlines()[-1]
        in_folder = len(last.partition(b"/")[2]) + 2  # what is left names the folder
        for size in (2, 12, in_folder, len(last)):  # of the last line with its line break
            (folder / name).write_bytes(text[: len(text) - size])
            with capture.open_rgbd(f"tum:{folder}") as source:
                found = list(source)
                counters = source.counters
            assert counters["incomplete"] == 1
            assert counters["without_color"] == (name == "rgb.txt")
            assert len(found) == (3 if name == "rgb.txt" else 2)
            assert_same(found[1], replace(frames[1], body_index=None, skeletons=(), number=1))
        (folder / name).write_bytes(text.rstrip())  # as an editor may write it
        with capture.open_rgbd(f"tum:{folder}") as source:
            assert len(list(source)) == 3
            assert source.counters["incomplete"] == 0
        (folder / name).write_bytes(text)
    command = ("capture", "record", f"tum:{folder}", "--force", "-o", tmp_path / "copy")
    assert "its end is missing" not in manip3d(*command).stderr
    (folder / "depth.txt").write_bytes(whole["depth.txt"][:-12])
    assert "its end is missing" in manip3d(*command).stderr
    (folder / "depth.txt").write_bytes(whole["depth.txt"][:-12] + b"\n")
    with capture.open_rgbd(f"tum:{folder}") as source, pytest.raises(FileNotFoundError):
        list(source)


def test_a_colour_image_belongs_to_one_depth_image(tmp_path: Path) -> None:
    """With depth at 60 Hz and colour at 30 Hz, every second depth image has no colour."""
    folder = tmp_path / "walk"
    step = 1_000_000_000 // 60
    frames = [
        replace(
            frame,
            depth=np.minimum(frame.depth, 13106),
            time_ns=n * step + 7,
            color=frame.color if n % 2 == 0 else None,
        )
        for n, frame in enumerate(rgbd_frames.frames(6))
    ]
    capture.record(frames, f"tum:{folder}")
    with capture.open_rgbd(f"tum:{folder}") as source:
        for n, found in enumerate(source):
            expected = replace(frames[n], body_index=None, skeletons=(), number=n)
            assert_same(found, expected)
        assert source.counters["without_color"] == 3


def renamed_images(folder: Path, kind: str, times_us: list[int]) -> list[str]:
    """Give the images of a TUM sequence other times, and return their paths."""
    files = sorted((folder / kind).iterdir())
    names = [f"{kind}/{time // 1_000_000}.{time % 1_000_000:06}.png" for time in times_us]
    for file, name in zip(files, names, strict=True):
        file.rename(folder / name)
    lines = [f"{Path(name).stem} {name}\n" for name in names]
    (folder / f"{kind}.txt").write_text("".join(lines))
    return [str(folder / name) for name in names]


@pytest.mark.parametrize("unit", [1, 1000, 5000])  # of the times; coarse ones have equal costs
@pytest.mark.parametrize("seed", range(4))
def test_meshes_have_the_colours_of_the_frames(unit: int, seed: int, tmp_path: Path) -> None:
    """Meshes and frames pair the images of a TUM sequence by the same rule."""
    rng, folder = np.random.default_rng(seed), tmp_path / "walk"
    recorded(f"tum:{folder}")
    steps = rng.integers(5_000 // unit, 35_000 // unit, (2, 12)) * unit
    depth_us, color_us = (1_305_031_102_160_407 + np.cumsum(steps, axis=1)).tolist()
    files = renamed_images(folder, "depth", depth_us)
    colors = renamed_images(folder, "rgb", color_us)
    with capture.open_rgbd(f"tum:{folder}") as source:
        seen = {file: frame.color for file, frame in zip(files, source, strict=True)}
    colored = [file for file in files if seen[file] is not None]
    assert len(colored) > 5
    pairs = simplify.colors_of_frames(colored, folder / "rgb")
    for file in colored:
        np.testing.assert_array_equal(cv2.imread(pairs[file])[..., ::-1], seen[file])
    alone = associate([time / 1e6 for time in depth_us], [time / 1e6 for time in color_us])
    assert [None if k is None else colors[k] for k in alone] == [pairs.get(f) for f in files]


@pytest.mark.parametrize("separator", [",", ", ", "\t"])
def test_lists_of_a_tum_sequence_with_commas_and_a_byte_order_mark(
    separator: str, tmp_path: Path
) -> None:
    """The benchmark's associate.py reads commas and tabs as blanks; Windows adds the mark."""
    folder = tmp_path / "walk"
    expected = recorded(f"tum:{folder}", 3)
    for name in ("depth.txt", "rgb.txt"):
        text = (folder / name).read_text().replace(" depth/", f"{separator}depth/")
        text = text.replace(" rgb/", f"{separator}rgb/")
        (folder / name).write_text("\ufeff" + text, encoding="utf-8")
    with capture.open_rgbd(f"tum:{folder}") as source:
        found = list(source)
        assert source.counters["without_color"] == 0
    assert [frame.time_ns for frame in found] == [frame.time_ns for frame in expected]


def test_a_tum_sequence_without_a_list_of_colours_has_none(tmp_path: Path) -> None:
    folder = tmp_path / "walk"
    recorded(f"tum:{folder}", 3)
    (folder / "rgb.txt").unlink()
    with capture.open_rgbd(f"tum:{folder}") as source:
        assert [frame.color for frame in source] == [None] * 3
        assert source.counters["without_color"] == 3
    (folder / "depth.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"depth\.txt"):
        capture.open_rgbd(f"tum:{folder}")


def test_a_tum_sequence_onto_itself_is_refused_before_it_is_touched(tmp_path: Path) -> None:
    place = f"tum:{tmp_path / 'walk'}"
    capture.record(rgbd_frames.frames(3), place)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=r"nobody has open, got .*walk, which is being read"):
        capture.record(place, place, overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    with capture.open_rgbd(place) as source:
        assert len(list(source)) == 3
    capture.record(rgbd_frames.frames(2), place, overwrite=True)  # nobody reads it any more


def test_colour_of_another_camera_is_looked_up(tmp_path: Path) -> None:
    """A wall at 2 m, a pole before it, and a colour camera 0.1 m to the right::

    depth pixel u sees x = (u - 31.5) 2 / 60, and the colour camera the column
    60 (x - 0.1) / 2 + 31.5 = u - 3 of the wall, u - 6 of the pole at 1 m.
    """
    camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    to_the_right = Registration(camera, translation=np.array([-0.1, 0.0, 0.0]))
    depth = np.full((48, 64), 2000, np.uint16)
    depth[:, 30:34] = 1000
    depth[0] = 0
    color = np.zeros((48, 64, 3), np.uint8)
    color[..., 0] = np.arange(64)
    frame = RgbdFrame(depth, RgbdCalibration(camera, to_the_right), color=color)
    capture.record([frame], f"tum:{tmp_path / 'a'}")
    with capture.open_rgbd(f"tum:{tmp_path / 'a'}") as source:
        found = source[0]
        assert source.calibration.registration is None
    assert found.color is not None
    expected = np.arange(64) - 3
    expected[30:34] = np.arange(30, 34) - 6
    expected[:3] = 0  # left of its picture
    expected[27:30] = 0  # behind the pole, as the colour camera sees it: columns 24 to 27
    assert not found.color[0].any()
    shown = found.color[1, :, 0].astype(int)
    hidden = (shown == 0) & (expected != 0)
    np.testing.assert_array_equal(shown[~hidden], expected[~hidden])
    assert hidden.sum() <= 4  # cells of the nearest depth are two pixels wide


# --- warnings -------------------------------------------------------------------------------------


@pytest.mark.parametrize("opening", [capture.open, capture.open_rgbd])
def test_a_warning_names_the_line_that_opened(tmp_path: Path, opening: Any) -> None:
    capture.record(list(rgbd_frames.frames(1, CALIBRATION)), f"tum:{tmp_path / 'a'}")
    (tmp_path / "a" / "calibration.json").unlink()
    with pytest.warns(UserWarning, match="camera: expected a calibration") as warned:
        opening(f"tum:{tmp_path / 'a'}")
    assert warned[0].filename == __file__


@pytest.mark.parametrize(
    ("line", "listed"),
    [
        ("12.25 depth/a.png", "depth/a.png"),
        ("12,25 depth/a.png", "depth/a.png"),
        ("-1,5 depth/a,1.png", "depth/a,1.png"),
        ("1.0 depth/a,1.png", "depth/a,1.png"),
        ("12.25, depth/a.png", "depth/a.png"),
        ("12.25\t,depth/a.png,more", "depth/a.png"),
        ("12,depth/a.png", "depth/a.png"),
        (",12.25 depth/a.png # of the first frame", "depth/a.png"),
    ],
)
def test_the_first_image_is_that_of_the_list(line: str, listed: str, tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / listed), np.full((12, 16), 5000, np.uint16))
    (tmp_path / "depth.txt").write_text(f"# time, file\n\n{line}\n")
    assert first_depth_size(tmp_path, is_tum=True) == (16, 12)
    camera = Intrinsics(16, 12, 15.0, 15.0, 8.0, 6.0)
    (frame,) = capture.open_rgbd(f"tum:{tmp_path}", camera=camera, units_per_metre=5000)
    assert frame.depth.shape == (12, 16)


def test_an_ambiguous_comma_is_refused(tmp_path: Path) -> None:
    (tmp_path / "depth.txt").write_text("1.0 a.png\n1,05,a.png\n")
    with pytest.raises(FormatError, match=r"line 2: time: expected a decimal point"):
        capture.open_rgbd(f"tum:{tmp_path}")
    (tmp_path / "depth.txt").write_text("1,05,a.png\n")
    assert first_depth_size(tmp_path, is_tum=True) is None


def test_frames_without_a_colour_image_are_told_of() -> None:
    assert left_out({"frames": 5, "without_color": 2}) == ["2 frames without a colour image"]
    assert left_out({"frames": 5, "without_color": 5}) == []  # a recording without colour
    assert left_out({"frames": 5, "without_color": 0}) == []
