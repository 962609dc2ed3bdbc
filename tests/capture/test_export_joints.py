"""Joints as tables and motions that other programs read."""

from __future__ import annotations

import csv
import json
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import capsule_body
from bvh_motions import read_bvh, waving
from capsule_body import pose
from command_line import manip3d
from manip3d import InputError, Skeleton, capture
from manip3d.capture._joints import _Vertical
from manip3d.io._joint_files import read_joint_file
from manip3d.modify import DownSource
from manip3d.rgbd import JOINTS, NOT_TRACKED, PARENTS, RgbdFrame


def test_a_motion_puts_joints_where_they_were(tmp_path: Path) -> None:
    frames = waving()
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    assert (done.frames, done.people) == (12, 1)
    names, places, step = read_bvh(done.path)
    assert step == pytest.approx(1 / 30, abs=1e-6)
    for joint, name in enumerate(JOINTS):
        mine = places[:, names.index(name)] / (100, -100, -100)
        true = np.array([f.skeletons[0].positions[joint] for f in frames])
        np.testing.assert_allclose(mine, true, atol=2e-4, err_msg=name)


@pytest.mark.parametrize(("tilt", "roll"), [(20.0, 0.0), (0.0, -15.0)])
def test_up_is_away_from_the_floor_of_a_tilted_camera(
    tmp_path: Path, tilt: float, roll: float
) -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator

    def poses(name: str, **options: float) -> NDArray[np.float64]:
        """Joints from the root of the first frame."""
        people = BodySimulator(motion="stepping", color="none", frames=4, threads=1, **options)  # type: ignore[arg-type]
        _, places, _ = read_bvh(capture.export_joints(people, tmp_path / name).path)
        return np.asarray(places - places[:1, :1])

    level = poses("level.bvh")
    # Centimetres, a metre from the root; the columns of the image are off by 25 cm or more.
    np.testing.assert_allclose(poses("tilted.bvh", tilt=tilt, roll=roll), level, atol=0.5)


@pytest.mark.parametrize(("last", "told"), [(0.5, 0.0), (2.0, 2.0)])
def test_the_last_floor_tells_the_vertical(last: float, told: float) -> None:
    """The first estimate is wrong: a table top, or a floor of which little is seen."""
    tilts = iter((5.0, last))

    def process(frame: RgbdFrame) -> SimpleNamespace:
        tilt = np.radians(next(tilts))
        down = np.array([0.0, np.cos(tilt), np.sin(tilt)])
        return SimpleNamespace(down=down, down_source=DownSource.FLOOR)

    vertical = _Vertical()
    vertical._pipeline = SimpleNamespace(process=process)  # type: ignore[assignment]
    assert len(list(vertical.watching(waving()[:2]))) == 2
    tilt = np.radians(told)
    np.testing.assert_allclose(vertical.down, (0.0, np.cos(tilt), np.sin(tilt)), atol=1e-12)


def test_a_table_has_all_that_was_seen(tmp_path: Path) -> None:
    frames = waving()[:2]
    visitor = replace(pose(at=(0.5, 0, 3)), id=7)
    frames[1] = replace(frames[1], skeletons=(*frames[1].skeletons, visitor))
    done = capture.export_joints(frames, tmp_path / "wave.csv")
    assert (done.frames, done.people) == (3, 2)
    with done.path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 25
    last = rows[-1]
    assert (last["id"], last["name"], last["state"]) == ("7", JOINTS[24], "2")
    np.testing.assert_allclose([float(last[c]) for c in "xyz"], visitor.positions[24], atol=1e-6)
    assert last["time_ns"] == str(frames[1].time_ns)


def test_a_table_of_frames_without_numbers_and_of_joints_without_places_is_read_back(
    tmp_path: Path,
) -> None:
    frames = [replace(frame, number=0) for frame in with_joint(waving()[:3], 7, np.nan, 2)]
    done = capture.export_joints(frames, tmp_path / "wave.csv")
    found = read_joint_file(done.path)
    assert sorted(found.frames) == [0, 1, 2]
    assert [people[0].trust[7] for people in found.frames.values()] == [NOT_TRACKED] * 3
    assert found.times_ns == {place: frame.time_ns for place, frame in enumerate(frames)}


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    frames = waving()[:1]
    with pytest.raises(InputError, match=r"\.csv or \.bvh"):
        capture.export_joints(frames, tmp_path / "wave.txt")
    with pytest.raises(InputError, match="id 9"):
        capture.export_joints(frames, tmp_path / "wave.csv", person=9)
    capture.export_joints(frames, tmp_path / "wave.csv")
    with pytest.raises(InputError, match=r"exists already; overwrite=True"):
        capture.export_joints(frames, tmp_path / "wave.csv")
    nobody = [replace(frames[0], skeletons=())]
    with pytest.raises(InputError, match="a skeleton in some frame"):
        capture.export_joints(nobody, tmp_path / "nobody.bvh")


def test_joints_that_are_missing_stay_where_they_were(tmp_path: Path) -> None:
    frames = waving()
    hidden = frames[5].skeletons[0]
    states = hidden.states.copy()
    states[7] = 0
    gone = Skeleton(np.where(states[:, None] > 0, hidden.positions, 0.0), states=states, id=1)
    frames[5] = replace(frames[5], skeletons=(gone,))
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    names, places, _ = read_bvh(done.path)
    hand = places[:, names.index("HandLeft")]
    assert np.linalg.norm(np.diff(hand, axis=0), axis=1).max() < 30.0  # centimetres


def tilted(frames: list[RgbdFrame], name: str, by_m: float, which: slice) -> list[RgbdFrame]:
    """A joint and all joints beyond it are shifted sideways in some of the frames."""
    joint = JOINTS.index(name)
    moved: list[int] = []
    for other in range(len(JOINTS)):
        above = other
        while above not in (0, joint):
            above = PARENTS[above]
        if above == joint:
            moved.append(other)
    result = list(frames)
    for number in range(*which.indices(len(frames))):
        positions = frames[number].skeletons[0].positions.copy()
        positions[moved, 0] += by_m
        result[number] = replace(frames[number], skeletons=(Skeleton(positions, id=1),))
    return result


def off_degrees(path: Path, frames: list[RgbdFrame], name: str) -> NDArray[np.float64]:
    """Angle in each frame between a bone of a motion and the measured one."""
    names, places, _ = read_bvh(path)
    joint = JOINTS.index(name)
    parent = PARENTS[joint]
    mine = places[:, names.index(name)] - places[:, names.index(JOINTS[parent])]
    seen = np.array([f.skeletons[0].positions for f in frames]) * (100, -100, -100)
    true = seen[:, joint] - seen[:, parent]
    cosine = (mine * true).sum(1) / np.linalg.norm(mine, axis=1) / np.linalg.norm(true, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def test_one_bad_frame_does_not_bend_the_rest_of_a_motion(tmp_path: Path) -> None:
    """The spine leans to the side of the hips in the first frame only."""
    frames = tilted(waving(), "SpineMid", 0.15, slice(0, 1))
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    for name in ("SpineMid", "HipLeft", "HipRight"):
        assert np.median(off_degrees(done.path, frames, name)) < 2.0, name


def test_short_bones_count_as_much_as_long_ones(tmp_path: Path) -> None:
    """The neck, which is shorter than the shoulders, tilts to and fro."""
    frames = tilted(waving(), "Neck", 0.02, slice(0, None, 2))
    frames = tilted(frames, "Neck", -0.02, slice(1, None, 2))
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    neck, shoulder = (off_degrees(done.path, frames, n) for n in ("Neck", "ShoulderLeft"))
    assert np.median(neck) < 2.5 * np.median(shoulder)


def with_joint(frames: list, joint: int, place: float, state: int) -> list:
    """The same joint of all skeletons elsewhere."""
    changed = []
    for frame in frames:
        positions, states = frame.skeletons[0].positions.copy(), frame.skeletons[0].states.copy()
        positions[joint], states[joint] = place, state
        changed.append(replace(frame, skeletons=(Skeleton(positions, states=states, id=1),)))
    return changed


def test_joints_that_are_no_numbers_were_not_seen(tmp_path: Path) -> None:
    frames = waving()
    frames[3:5] = with_joint(frames[3:5], 7, np.nan, 2)
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    assert "nan" not in done.path.read_text()
    names, places, _ = read_bvh(done.path)
    wrist = places[4, names.index("WristLeft")] / (100, -100, -100)
    np.testing.assert_allclose(wrist, frames[4].skeletons[0].positions[6], atol=0.01)
    hand = places[:, names.index("HandLeft")]
    assert np.linalg.norm(np.diff(hand, axis=0), axis=1).max() < 30.0  # centimetres
    unknown = Skeleton(np.full((25, 3), np.nan, np.float32), id=1)
    nowhere = [replace(frame, skeletons=(unknown,)) for frame in frames]
    with pytest.raises(InputError, match="joints of the person that were seen"):
        capture.export_joints(nowhere, tmp_path / "nan.bvh")


def test_a_root_that_was_never_seen_is_at_the_next_joint_of_the_spine(tmp_path: Path) -> None:
    frames = with_joint(waving(), 0, 0.0, 0)
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    names, places, _ = read_bvh(done.path)
    for number, frame in enumerate(frames):
        mid = frame.skeletons[0].positions[JOINTS.index("SpineMid")]
        root = places[number, names.index("SpineBase")] / (100, -100, -100)
        np.testing.assert_allclose(root, mid, atol=2e-4)


def test_frames_without_the_person_keep_the_time(tmp_path: Path) -> None:
    frames = waving()
    for number in (0, 4, 5, 11):
        frames[number] = replace(frames[number], skeletons=())
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    assert (done.frames, done.people, done.held) == (8, 1, 2)
    _, places, step = read_bvh(done.path)
    assert step == pytest.approx(1 / 30, abs=1e-6)
    assert len(places) == 10  # from the first to the last time it was seen
    np.testing.assert_array_equal(places[3], places[2])
    np.testing.assert_array_equal(places[4], places[2])


def standing(numbers: range, at: float, identity: int) -> dict[int, Skeleton]:
    """A person who stands still at this x in some of the frames."""
    return {n: pose(at=(at, 0.0, 2.4), identity=identity) for n in numbers}


def seen(*people: dict[int, Skeleton], count: int = 40) -> list[RgbdFrame]:
    frames = []
    for number in range(count):
        here = tuple(one[number] for one in people if number in one)
        frames.append(replace(capsule_body.frame(pose(), number=number), skeletons=here))
    return frames


def test_a_motion_goes_on_if_the_tracker_gives_a_new_id(tmp_path: Path) -> None:
    """The person is lost for five frames, and then alone in view under another id."""
    frames = seen(standing(range(15), 0.0, 2), standing(range(20, 40), 0.0, 9))
    done = capture.export_joints(frames, tmp_path / "a.bvh")
    assert (done.frames, done.held, done.people) == (35, 5, 1)
    assert (done.ids, done.others) == ((2, 9), {})
    capture.record(frames, tmp_path / "walk")
    told = manip3d("capture", "export", tmp_path / "walk", "-o", tmp_path / "c.bvh")
    assert "the person is followed under several ids (2, 9)" in told.stderr
    table = capture.export_joints(frames, tmp_path / "a.csv")
    assert (table.people, table.ids, table.others) == (2, (2, 9), {})


def test_skeletons_of_other_people_are_counted(tmp_path: Path) -> None:
    """The first one of three people leaves."""
    first, second = standing(range(10), 0.5, 2), standing(range(40), -0.5, 4)
    frames = seen(first, second, standing(range(5, 15), -1.2, 1))
    done = capture.export_joints(frames, tmp_path / "a.bvh")
    assert (done.frames, done.ids, done.others) == (10, (2,), {1: 10, 4: 40})
    wanted = capture.export_joints(frames, tmp_path / "b.bvh", person=4)
    assert (wanted.frames, wanted.ids, wanted.others) == (40, (4,), {1: 10, 2: 10})
    capture.record(frames, tmp_path / "walk")
    told = manip3d("capture", "export", tmp_path / "walk", "-o", tmp_path / "c.bvh")
    assert "left out 50 skeletons of other people (id 1: 10, id 4: 40); --person" in told.stderr
    chosen = ("-o", tmp_path / "d.bvh", "--person", "4", "--json")
    told = manip3d("capture", "export", tmp_path / "walk", *chosen)
    assert "of other people" not in told.stderr
    assert json.loads(told.stdout)["others"] == {"1": 10, "2": 10}


def test_a_person_without_a_spine_is_followed_by_the_id(tmp_path: Path) -> None:
    arms = {n: with_states(one, "Spine") for n, one in standing(range(20), 0.0, 2).items()}
    done = capture.export_joints(seen(arms, standing(range(40), 0.6, 5)), tmp_path / "a.bvh")
    assert (done.frames, done.ids, done.others) == (20, (2,), {5: 40})


def at_steps(frames: list[RgbdFrame], seconds: float) -> list[RgbdFrame]:
    return [replace(one, time_ns=round(n * seconds * 1e9)) for n, one in enumerate(frames)]


@pytest.mark.parametrize("last", [40, 30])
def test_a_hidden_spine_is_no_absence(tmp_path: Path, last: int) -> None:
    """A person whose spine is hidden for 12.5 seconds is followed, also until they leave."""
    first = standing(range(last), 0.6, 2)
    first |= {n: with_states(first[n], "Spine") for n in range(5, 30)}
    frames = at_steps(seen(first, standing(range(40), 0.0, 5)), 0.5)
    done = capture.export_joints(frames, tmp_path / "a.bvh")
    assert (done.frames, done.ids, done.others) == (last, (2,), {5: 40})


def test_nobody_takes_the_place_of_a_person_whose_spine_was_hidden(tmp_path: Path) -> None:
    """The first person goes aside meanwhile, and somebody else stands where they stood."""
    first = {n: with_states(one, "Spine") for n, one in standing(range(5, 9), 0.8, 2).items()}
    first |= standing(range(5), 0.0, 2) | standing(range(9, 40), 0.8, 2)
    done = capture.export_joints(seen(first, standing(range(9, 40), 0.0, 5)), tmp_path / "a.bvh")
    assert (done.frames, done.ids, done.others) == (40, (2,), {5: 31})


def test_a_pause_of_a_recording_is_no_absence(tmp_path: Path) -> None:
    frames = seen(standing(range(40), 0.6, 2), standing(range(40), 0.0, 5))
    frames[20:] = [replace(one, time_ns=one.time_ns + 11 * 10**9) for one in frames[20:]]
    done = capture.export_joints(frames, tmp_path / "a.bvh")
    assert (done.frames, done.ids, done.others) == (40, (2,), {5: 40})


def with_states(skeleton: Skeleton, part: str) -> Skeleton:
    """The skeleton without the joints of a part, of the neck and of the head."""
    states = skeleton.states.copy()
    states[[n for n, name in enumerate(JOINTS) if name.startswith((part, "Neck", "Head"))]] = 0
    return replace(skeleton, states=states)


def test_dropped_frames_keep_the_time(tmp_path: Path) -> None:
    """Half a second after the fourth frame, and two dropped frames later on."""
    times = np.array([0, 33, 66, 99, 599, 632, 665, 698, 797, 830, 863, 896]) * 1_000_000
    frames = [replace(f, time_ns=int(t)) for f, t in zip(waving(), times, strict=True)]
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    _, places, step = read_bvh(done.path)
    assert (done.frames, done.held) == (12, 14 + 2)
    assert len(places) == 28
    assert step * 27 == pytest.approx(0.896, abs=1e-5)
    for place in places[4:18]:
        np.testing.assert_array_equal(place, places[3])
    moved = np.abs(np.diff(places, axis=0)).max(axis=(1, 2)) > 0
    np.testing.assert_allclose(np.flatnonzero(moved)[3] + 1, 18)
    table = capture.export_joints(frames, tmp_path / "wave.csv")
    assert (table.frames, table.held) == (12, 0)


def walking(times: NDArray[np.float64]) -> list[RgbdFrame]:
    """Frames of somebody who goes aside by 0.01 m a second: the place tells the true time."""
    first = waving()[0]
    return [
        replace(
            first,
            time_ns=round(time * 1e9) + 1_700_000_000_000_000_000,
            number=number,
            skeletons=(pose(at=(0.01 * (time - times[0]), 0.0, 2.0)),),
        )
        for number, time in enumerate(times)
    ]


def in_turn(*rates: tuple[int, float]) -> NDArray[np.float64]:
    """Times of a number of frames at each rate, one after the other."""
    return np.concatenate([[0.0], *(np.full(count, 1 / rate) for count, rate in rates)]).cumsum()


RANDOM = np.random.default_rng(4)
TIMES = {
    "one rate": in_turn((100, 30.0)),
    "in whole milliseconds": np.rint(in_turn((100, 30.0)) * 1e3) / 1e3,
    "slower later": in_turn((60, 30.0), (50, 20.0)),
    "faster later": in_turn((60, 15.0), (40, 30.0)),
    "slower for a while": in_turn((40, 25.0), (40, 17.0), (40, 25.0)),
    "every fifth dropped": np.delete(np.arange(100), np.s_[4::5]) / 30,
    "many dropped at random": np.flatnonzero(RANDOM.random(120) < 0.6) / 30,
    "jitter": (np.arange(100) + RANDOM.normal(0.0, 0.15, 100)) / 25,
    "jitter and dropped ones": np.delete(
        (np.arange(120) + RANDOM.normal(0.0, 0.1, 120)) / 30, RANDOM.integers(1, 119, 16)
    ),
    "a burst": np.sort(np.concatenate([np.arange(80) / 30, 1.01 + np.arange(8) / 300])),
}


@pytest.mark.parametrize("name", TIMES)
def test_poses_of_a_motion_are_played_at_their_times(name: str, tmp_path: Path) -> None:
    times = TIMES[name]
    done = capture.export_joints(walking(times), tmp_path / "walk.bvh")
    names, places, step = read_bvh(done.path)
    assert len(places) == done.frames + done.held
    aside = places[:, names.index("SpineBase"), 0]
    true = (aside - aside[0]) / 0.01 / 100
    is_new = np.diff(true, prepend=-1.0) > 1e-3
    assert is_new.sum() == done.frames
    off = np.abs(np.arange(len(places)) * step - true)[is_new] / step  # frames
    assert off.max() < (0.76 if "jitter" in name or name == "a burst" else 0.51)
    assert done.frames >= len(times) - (8 if name == "a burst" else 1)


def test_a_recording_at_one_rate_repeats_nothing(tmp_path: Path) -> None:
    for number, name in enumerate(("one rate", "in whole milliseconds")):
        done = capture.export_joints(walking(TIMES[name]), tmp_path / f"{number}.bvh")
        assert (done.frames, done.held) == (101, 0), name


def test_a_clock_that_begins_again_goes_on(tmp_path: Path) -> None:
    frames = walking(in_turn((40, 30.0)))
    frames += [replace(frame, time_ns=frame.time_ns - 10**9) for frame in frames]
    done = capture.export_joints(frames, tmp_path / "walk.bvh")
    assert (done.frames, done.held) == (82, 0)
    assert read_bvh(done.path)[2] == pytest.approx(1 / 30, abs=1e-6)


def test_poses_that_a_motion_lacks_are_counted(tmp_path: Path) -> None:
    """Frames whose times jitter by a third of a frame; the person is not seen in every tenth."""
    frames = walking(np.sort(np.arange(200) / 30 + np.random.default_rng(8).normal(0, 0.01, 200)))
    for number in range(5, 200, 10):
        frames[number] = replace(frames[number], skeletons=())
    done = capture.export_joints(frames, tmp_path / "walk.bvh")
    assert done.left_out > 0
    assert done.frames + done.left_out == 180
    capture.record(frames, tmp_path / "walk")
    told = manip3d("capture", "export", tmp_path / "walk", "-o", tmp_path / "told.bvh").stderr
    reason = "because an earlier skeleton already fills the nearest frame"
    assert f"left out {done.left_out} skeletons, {reason}" in told
    assert capture.export_joints(frames, tmp_path / "walk.csv").left_out == 0
    even = capture.export_joints(walking(TIMES["one rate"]), tmp_path / "even.bvh")
    assert even.left_out == 0


@pytest.mark.parametrize("unit", [1e-3, 1e-6])
def test_times_in_another_unit_leave_out_nothing(tmp_path: Path, unit: float) -> None:
    """Microseconds or milliseconds that were taken for nanoseconds, with half a second's pause."""
    times = in_turn((50, 30.0), (1, 2.0), (50, 30.0))
    frames = [
        replace(frame, time_ns=round(1e9 * unit * time))
        for frame, time in zip(walking(times), times, strict=True)
    ]
    done = capture.export_joints(frames, tmp_path / "walk.bvh")
    assert (done.frames, done.held, done.left_out) == (102, 0, 0)
    step = read_bvh(done.path)[2]
    assert step == pytest.approx(max(unit * times[-1] / 101, 1e-7), abs=6e-8)
    assert step > 0


def test_a_motion_has_no_gap_of_hours(tmp_path: Path) -> None:
    frames = waving()
    frames[-1] = replace(frames[-1], time_ns=frames[-1].time_ns + 4000 * 10**9)
    with pytest.raises(InputError, match="at most 3600 s between two frames of a motion, got 4000"):
        capture.export_joints(frames, tmp_path / "wave.bvh")


@pytest.mark.parametrize("frames", ["3", 2.5, 0, True])
def test_a_number_of_frames_is_a_whole_one(tmp_path: Path, frames: object) -> None:
    with pytest.raises(InputError, match="frames: expected"):
        capture.export_joints(waving(), tmp_path / "wave.csv", frames=frames)  # type: ignore[arg-type]


def test_no_more_is_read_than_asked_for(tmp_path: Path) -> None:
    frames = iter(waving())
    assert capture.export_joints(frames, tmp_path / "wave.csv", frames=3).frames == 3
    assert len(list(frames)) == 9
    with pytest.raises(InputError, match="source: expected frames"):
        capture.export_joints(np.zeros(3), tmp_path / "no.csv")  # type: ignore[arg-type]


def test_a_source_opened_by_its_address_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped = []
    opened = capture.from_frames(waving())
    monkeypatch.setattr(opened, "stop", lambda: stopped.append(True))
    monkeypatch.setattr("manip3d.capture._joints.open_rgbd", lambda uri: opened)
    capture.export_joints("folder:wave", tmp_path / "wave.csv", frames=2)
    assert stopped == [True]


def test_joints_may_be_found_in_the_colour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Finder:
        def __enter__(self) -> Finder:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def annotate(self, frame: RgbdFrame) -> RgbdFrame:
            return replace(frame, skeletons=(pose(identity=9),))

    monkeypatch.setattr("manip3d.capture._joints.PoseTracker", Finder)
    frames = waving()[:3]
    black = np.zeros((*frames[0].depth.shape, 3), np.uint8)
    frames = [replace(f, skeletons=(), color=black if k else None) for k, f in enumerate(frames)]
    done = capture.export_joints(frames, tmp_path / "wave.csv", pose=True, person=9)
    assert done.frames == 2


@pytest.mark.parametrize("name", ["wave.csv", "wave.bvh"])
def test_images_are_not_kept(name: str, tmp_path: Path) -> None:
    images: list[weakref.ref[NDArray[np.uint16]]] = []
    most = 0

    def frames() -> Iterator[RgbdFrame]:
        nonlocal most
        for frame in waving():
            alone = replace(frame, depth=frame.depth.copy())
            images.append(weakref.ref(alone.depth))
            yield alone
            most = max(most, sum(image() is not None for image in images))

    assert capture.export_joints(frames(), tmp_path / name).frames == 12
    assert most <= 3
