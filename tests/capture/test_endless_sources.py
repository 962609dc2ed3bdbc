"""Sources that may never end, and frames that come only once."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import capsule_body
import rgbd_frames
from manip3d import InputError, LidarFrame, RgbdFrame, authenticate, capture, forge, io

PEOPLE = [replace(capsule_body.painted(n), number=n) for n in range(4)]


def endless() -> Iterator[RgbdFrame]:
    """The frames of a camera that somebody drives by themselves."""
    return (replace(PEOPLE[0], number=n, time_ns=n * 33_000_000) for n in itertools.count())


class Camera:
    """A camera that begins whenever it is asked to."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        return endless()


def recording(folder: Path) -> capture.RgbdSource:
    capture.record(rgbd_frames.frames(9), folder / "walk")
    return capture.open_rgbd(f"folder:{folder / 'walk'}")


def drive(folder: Path) -> capture.LidarSource:
    (folder / "velodyne").mkdir()
    for number in range(9):
        io.write_scan(LidarFrame(np.ones((5, 3))), folder / "velodyne" / f"{number:06}.bin")
    return capture.open_lidar(f"kitti:{folder}")


SOURCES: dict[str, Callable[[Path], Any]] = {
    "generator": lambda _: capture.from_frames(endless()),
    "list": lambda _: capture.from_frames(list(rgbd_frames.frames(9))),
    "folder": recording,
    "drive": drive,
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_loop_ends_when_the_source_is_stopped(name: str, tmp_path: Path) -> None:
    """The loop may run in one thread while another one stops the source."""
    source = SOURCES[name](tmp_path)
    given = 0
    for _ in source:
        given += 1
        if given == 3:
            source.stop()
        assert given < 6
    assert given == 3
    assert source.read() is None
    assert list(source) == []
    if name in ("list", "folder"):
        source.start()
        assert len(list(source)) == 9


@pytest.mark.parametrize("name", SOURCES)
def test_a_closed_source_is_not_an_empty_one(name: str, tmp_path: Path) -> None:
    """A loop after the with statement found no frames, as if the recording had none."""
    with SOURCES[name](tmp_path) as source:
        for _ in source:
            break
    assert source.read() is None
    advice = "open it again" + (
        ", or call start()" if isinstance(source, capture.RgbdSource) else ""
    )
    told = re.escape(f"source: {source.uri} is closed; {advice}") + "$"
    for read in (source.__iter__, source.past_errors):
        with pytest.raises(InputError, match=told):
            next(read())
    with source, pytest.raises(InputError, match=told):  # a second statement opens nothing
        next(iter(source))
    if name in ("list", "folder"):
        source.start()
        assert len(list(source)) == 9


def test_a_source_says_whether_it_ends_and_whether_it_begins_anew(tmp_path: Path) -> None:
    def said(frames: Any) -> tuple[bool, bool]:
        source = capture.from_frames(frames)
        return source.has_known_end, source.begins_anew

    assert said(PEOPLE) == (True, True)
    assert said(Camera()) == (False, True)
    assert said(endless()) == (False, False)
    with recording(tmp_path) as source:
        assert (source.has_known_end, source.begins_anew) == (True, True)


@pytest.mark.parametrize("make", [endless, Camera])
def test_the_first_frames_of_what_never_ends_are_judged(make: Callable[[], Any]) -> None:
    """The whole was counted first, which never came to an end."""
    found = authenticate.inspect_stream(capture.from_frames(make()))
    assert len(found.numbers) == 60
    assert found.reason.endswith("of the first 60 frames, not the rest")


def test_a_camera_of_a_user_may_have_methods_of_any_name() -> None:
    """The mirroring of a joined recording was asked of any iterable, by this name."""

    class Converting(Camera):
        def conversions(self) -> int:
            return 2

    source = capture.from_frames(Converting())
    assert (source.flipped, source.assumed_rate) == ((), None)


def test_what_never_ends_is_summarized_as_a_camera_is() -> None:
    found = capture.summarize(capture.from_frames(endless()), seconds=0.05)
    assert found.num_frames > 1


def test_frames_that_come_once_are_judged_and_forged() -> None:
    """They were gone through to count them, and no frame was left."""
    numbers = [frame.number for frame in PEOPLE]
    for make in (lambda: iter(PEOPLE), lambda: capture.from_frames(iter(PEOPLE))):
        assert authenticate.inspect_stream(make()).numbers.tolist() == numbers
        for with_plate in (False, True):
            found = forge.recorded_people(make(), with_plate=with_plate)
            for _ in range(2):
                assert [frame.number for frame in found.frames] == numbers
