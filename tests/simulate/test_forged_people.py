"""The set of forged people: what is written, its truth, and what happens when it is stopped."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import InputError, capture, forge
from manip3d._util.remaining import RemainingTime
from manip3d.rgbd import NO_BODY
from manip3d.simulate import BodySimulator, ForgedPeople, write_forged_people

pytest.importorskip("open3d")

FEW: dict[str, Any] = {"people": 1, "actions": 2, "scenes": 1, "frames": 2, "jobs": 1}


@dataclass(frozen=True)
class Made:
    """A set that nothing stopped, and what its progress said."""

    folder: Path
    set: ForgedPeople
    told: list[tuple[float, str]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("people") / "set"
    told: list[tuple[float, str]] = []
    made = write_forged_people(folder, **FEW, progress=lambda *now: told.append(now))
    return Made(folder, made, told)


def test_every_stream_has_a_recording_and_every_forged_one_its_truth(whole: Made) -> None:
    made, folder = whole.set, whole.folder
    assert (len(made.rows), made.resumed, made.failed) == (6, 0, 0)
    with (folder / "streams.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["kind"] for row in rows[:3]] == ["real", "type1", "type2"]
    assert {row["action"] for row in rows} == {"wave", "raise-left"}
    for row in rows:
        frames = list(capture.open_rgbd(f"folder:{folder / row['recording']}"))
        assert len(frames) == int(row["frames"]) == 2
        assert all(frame.skeletons and frame.color is not None for frame in frames)
        if row["kind"] == "real":
            assert row["truth"] == ""
            continue
        truth = forge.read_stream_truth(folder / row["truth"])
        assert truth.kind == int(row["kind"][-1])
        for frame, mask in zip(frames, truth.masks, strict=True):
            np.testing.assert_array_equal(np.asarray(frame.body_index != NO_BODY), mask)
            assert 0.02 < mask.mean() < 0.2
    told = json.loads((folder / "provenance.json").read_text())
    assert told["frames"] == 2
    assert len({each["seed"] for each in told["streams"]}) == 6


def test_a_stopped_run_goes_on_and_gives_the_same(whole: Made, tmp_path: Path) -> None:
    few = FEW | {"actions": 1}

    def stop(fraction: float, message: str) -> None:
        if fraction > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_forged_people(tmp_path / "set", **few, progress=stop)
    shutil.rmtree(tmp_path / "set" / "p1-wave-room-type1")  # one that was lost is made again
    again = write_forged_people(tmp_path / "set", **few)
    assert again.resumed == 1
    assert again.rows == whole.set.rows[:3]
    for row in again.rows:
        one, other = (
            [frame.depth for frame in capture.open_rgbd(f"folder:{folder / row['recording']}")]
            for folder in (tmp_path / "set", whole.folder)
        )
        np.testing.assert_array_equal(one, other)


def test_a_recording_that_fails_does_not_end_the_run(tmp_path: Path) -> None:
    (tmp_path / "set" / "streams.csv.rows").mkdir(parents=True)
    blocked = tmp_path / "set" / "p1-wave-room-type1"
    blocked.mkdir()
    (blocked / "mine.txt").write_text("no recording")
    failures: list[str] = []
    few = FEW | {"actions": 1}
    made = write_forged_people(
        tmp_path / "set", **few, on_error=lambda name, error: failures.append(name)
    )
    assert failures == ["p1-wave-room-type1"]
    assert (len(made.rows), made.failed) == (3, 1)
    assert [row["stream"] for row in made.rows if row["error"]] == failures
    (blocked / "mine.txt").unlink()
    blocked.rmdir()
    again = write_forged_people(tmp_path / "set", **few)
    assert (again.resumed, again.failed) == (2, 0)


def test_a_full_disk_is_said_before_the_run_and_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1_000_000))
        with pytest.raises(OSError, match=r"expected \d+ MB free for 6 recordings, got 1 MB"):
            write_forged_people(tmp_path / "set", **FEW)
    assert not list((tmp_path / "set").glob("p1-*"))

    def fill(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    tried: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr(capture, "record", fill)
        with pytest.raises(OSError, match="No space left"):
            write_forged_people(
                tmp_path / "set", **FEW, on_error=lambda name, error: tried.append(name)
            )
    assert tried == ["p1-wave-room-real"]


def test_progress_says_what_is_done_and_how_long_the_rest_takes(whole: Made) -> None:
    told = whole.told
    assert [fraction for fraction, _ in told] == pytest.approx([n / 6 for n in range(1, 7)])
    assert told[0][1].startswith("p1-wave-room-real, ")
    assert told[0][1].endswith(" left")
    assert told[-1][1] == "p1-raise-left-room-type2"


def test_remaining_time_is_judged_by_this_run_alone() -> None:
    now = [100.0]
    remaining = RemainingTime(0.5, clock=lambda: now[0])  # half was there already
    assert remaining(0.5) == ""
    now[0] += 600.0
    assert remaining(0.6) == "about 40 minutes left"
    assert remaining(0.53) == "about 3 hours left"
    assert remaining(0.9) == "about 2 minutes left"
    assert remaining(0.95) == "about a minute left"
    assert remaining(0.99) == "less than a minute left"
    assert remaining(1.0) == ""


def test_wrong_options_are_named(tmp_path: Path) -> None:
    for options, message in (
        ({"people": 7}, "people: expected 1 to 6, got 7"),
        ({"actions": 0}, "actions: expected 1 to 4"),
        ({"scenes": 4}, "scenes: expected 1 to 3"),
        ({"frames": 0}, "frames: expected"),
        ({"kinds": ("type3",)}, "kinds: expected some of real, type1, type2, got type3"),
        ({"kinds": ()}, "kinds: expected some"),
        ({"seed": -1}, "jobs, seed"),
    ):
        with pytest.raises(InputError, match=message):
            write_forged_people(tmp_path / "set", **options)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("x")
    with pytest.raises(InputError, match="holds something else"):
        write_forged_people(tmp_path / "mine", **FEW)
    assert not (tmp_path / "set").exists()


def test_scenes_differ_and_the_person_does_not() -> None:
    frames = {
        s: BodySimulator(scene=s, motion="still").frame(0.0) for s in ("room", "office", "hall")
    }
    first = frames["room"]
    for name in ("office", "hall"):
        frame = frames[name]
        person = np.asarray(frame.body_index == 0) & np.asarray(first.body_index == 0)
        assert person.mean() > 0.04
        behind = ~np.asarray(frame.body_index == 0) & (frame.depth > 0) & (first.depth > 0)
        steps = np.abs(frame.depth.astype(int) - first.depth)
        assert (steps[behind] > 200).mean() > 0.05
        assert np.median(steps[person]) < 20
    with pytest.raises(InputError, match="scene: expected one of room, office, hall, got 'beach'"):
        BodySimulator(scene="beach")
