"""A source whose person is forged on demand: what each consumer of sources sees of it."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capsule_body import SMALL, frame, pose
from manip3d import InputError, RgbdCalibration, RgbdFrame, capture
from manip3d.capture._forged import read_plan
from manip3d.rgbd import NO_BODY

STEP = 33_333_333


def person(number: int) -> RgbdFrame:
    """Return a frame of a person who walks past, 4 m before a wall."""
    places = pose(turn_deg=2.0 * number)
    seen = frame(places, SMALL, number=number)
    wall = np.full(seen.depth.shape, 4000, np.uint16) + np.uint16(number % 3)
    color = np.full((*wall.shape, 3), (200, 40, 40), np.uint8)
    depth = np.where(seen.depth > 0, seen.depth, wall)
    return replace(seen, depth=depth, color=color, time_ns=number * STEP)


def scene(number: int, color: bool = True) -> RgbdFrame:
    shape = (SMALL.height, SMALL.width)
    return RgbdFrame(
        np.full(shape, 3500, np.uint16),
        RgbdCalibration(SMALL),
        np.full((*shape, 3), (30, 160, 60), np.uint8) if color else None,
        np.full(shape, NO_BODY, np.uint8),
        number=number,
        time_ns=number * STEP,
    )


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("places")
    capture.record([person(n) for n in range(12)], folder / "person", lossless_color=True)
    capture.record([scene(n) for n in range(4)], folder / "scene", lossless_color=True)
    capture.record([scene(n, color=False) for n in range(4)], folder / "grey")
    return {name: f"folder:{folder / name}" for name in ("person", "scene", "grey")}


def seen(uri: str) -> tuple[list[RgbdFrame], dict[str, int]]:
    with capture.open_rgbd(uri) as source:
        return list(source), source.counters


def is_forged(given: RgbdFrame) -> bool:
    """Whether a frame shows the other background."""
    return bool((given.depth == 3500).mean() > 0.3)


def test_frames_are_forged_or_passed_on_as_they_are(places: dict[str, str]) -> None:
    uri = f"forged:{places['person']}#background={places['scene']}"
    frames, counters = seen(uri)
    assert (counters["forged"], counters["real"]) == (12, 0)
    for number, given in enumerate(frames):
        original = person(number)
        assert is_forged(given)
        assert (given.time_ns, given.number) == (original.time_ns, number)
        own = np.asarray(given.body_index == 0)
        np.testing.assert_array_equal(given.depth[own], original.depth[own])
        assert given.skeletons
    real, counters = seen(uri + "&show=real")
    assert (counters["forged"], counters["real"]) == (0, 12)
    for number, given in enumerate(real):
        np.testing.assert_array_equal(given.depth, person(number).depth)
        np.testing.assert_array_equal(given.color, person(number).color)  # type: ignore[arg-type]


def test_it_is_switched_while_it_runs(places: dict[str, str], tmp_path: Path) -> None:
    uri = f"forged:{places['person']}#background={places['scene']}&show=real"
    with capture.open_rgbd(uri) as source:
        assert isinstance(source, capture.ForgedSource)
        given = []
        for number in range(12):
            source.forged = number % 3 == 0
            assert source.forged == (number % 3 == 0)
            found = source.read()
            assert found is not None
            given.append(is_forged(found))
        assert given == [number % 3 == 0 for number in range(12)]
        with pytest.raises(InputError, match="forged: expected True or False"):
            source.forged = 1  # type: ignore[assignment]
    switch = tmp_path / "switch"
    with capture.open_rgbd(f"{uri}&switch={switch}") as source:
        words = ["", "forged", "", "real\n", "nonsense", "forged\n"]
        wanted = [False, True, True, False, False, True]
        for word, expected in zip(words, wanted, strict=True):
            if word:
                switch.write_text(word)
            found = source.read()
            assert found is not None
            assert is_forged(found) == expected


def test_real_and_forged_alternate_by_the_time_of_the_frames(places: dict[str, str]) -> None:
    period = 3 * STEP * 1e-9 - 1e-9
    frames, _ = seen(f"forged:{places['person']}#background={places['scene']}&show={period:.9f}")
    assert [is_forged(given) for given in frames] == [False, False, False, True, True, True] * 2


def test_the_scene_is_learnt_where_none_is_given() -> None:
    simulated = pytest.importorskip("open3d") and "forged:sim:body?motion=wave&frames=33"
    frames, counters = seen(simulated)
    assert (counters["real"], counters["forged"]) == (30, 3)
    assert all(given.color is not None for given in frames)
    last = frames[-1]
    assert 0.03 < np.mean(np.asarray(last.body_index != NO_BODY)) < 0.2


def test_colour_is_left_out_of_all_frames_where_the_background_has_none(
    places: dict[str, str], tmp_path: Path
) -> None:
    uri = f"forged:{places['person']}#background={places['grey']}&show=0.1"
    frames, _ = seen(uri)
    assert {given.color is None for given in frames} == {True}
    done = capture.record(uri, tmp_path / "both")
    assert (done.frames, done.source_counters["forged"] > 0) == (12, True)


@pytest.mark.parametrize("options", ["show=forged", "show=0.1"])
def test_a_forged_recording_begins_anew(places: dict[str, str], options: str) -> None:
    uri = f"forged:{places['person']}#background={places['scene']}&{options}"
    with capture.open_rgbd(uri) as source:
        once, counters = list(source), source.counters
        for _ in range(2):
            again = list(source)
            assert source.counters == counters
            for one, other in zip(once, again, strict=True):
                assert (one.number, one.time_ns) == (other.number, other.time_ns)
                np.testing.assert_array_equal(one.depth, other.depth)
                np.testing.assert_array_equal(one.color, other.color)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is closed"):
        list(source)


def test_a_learnt_scene_is_learnt_anew(tmp_path: Path) -> None:
    capture.record([person(n) for n in range(32)], tmp_path / "long", lossless_color=True)
    with capture.open_rgbd(f"forged:folder:{tmp_path / 'long'}") as source:
        for _ in range(2):
            assert len(list(source)) == 32
            assert (source.counters["real"], source.counters["forged"]) == (30, 2)


def test_poses_come_from_a_source_or_a_motion_file(places: dict[str, str], tmp_path: Path) -> None:
    file = tmp_path / "motion.bvh"
    capture.export_joints(places["person"], file)
    for motion in (places["person"], str(file)):
        uri = f"forged:{places['person']}#type=2&pose={motion}&background={places['scene']}"
        frames, counters = seen(uri)
        assert (len(frames), counters["forged"]) == (12, 12)


def test_frames_of_what_does_not_wait_are_given_at_their_times() -> None:
    pytest.importorskip("open3d")
    with capture.open_rgbd("forged:sim:body?frames=5&room=no&rate=5", speed=1.0) as source:
        begun = time.monotonic()
        assert len(list(source)) == 5
        assert time.monotonic() - begun > 0.75


def test_it_may_be_switched_and_stopped_from_other_threads(places: dict[str, str]) -> None:
    with capture.open_rgbd(f"forged:{places['person']}#background={places['scene']}") as source:
        assert isinstance(source, capture.ForgedSource)
        found: list[RgbdFrame] = []
        readers = [threading.Thread(target=lambda: found.extend(source)) for _ in range(3)]
        for reader in readers:
            reader.start()
        for number in range(200):
            source.forged = number % 2 == 0
        for reader in readers:
            reader.join(30)
        source.stop()
    assert sorted(given.number for given in found) == list(range(12))


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("forged:", "uri: expected forged:SOURCE"),
        ("forged:#type=1", "uri: expected forged:SOURCE"),
        ("forged:forged:x", "not forged itself"),
        ("forged:PERSON#kind=1", "kind: expected one of type, pose"),
        ("forged:PERSON#type=3", "type: expected 1 or 2, got '3'"),
        ("forged:PERSON#type=2", "pose: expected a motion for type=2"),
        ("forged:PERSON#pose=PERSON", "pose: expected a motion for type=2"),
        ("forged:PERSON#still=maybe", "still: expected yes or no"),
        ("forged:PERSON#move=1,2", "move: expected X,Y,Z"),
        ("forged:PERSON#move=1,2,nan", "move: expected X,Y,Z"),
        ("forged:PERSON#blend=65", "blend: expected 0 to 64"),
        ("forged:PERSON#blend=2.7", "blend: expected 0 to 64"),
        ("forged:PERSON#show=0", "show: expected real, forged, or seconds"),
        ("forged:PERSON#show=nan", "show: expected real, forged, or seconds"),
        ("forged:PERSON#background=OTHER", "frames of the source's camera"),
    ],
)
def test_wrong_addresses_are_named(
    uri: str, message: str, places: dict[str, str], tmp_path: Path
) -> None:
    camera = replace(SMALL, fx=SMALL.fx + 1.0)
    other = [replace(scene(n), calibration=RgbdCalibration(camera)) for n in range(2)]
    capture.record(other, tmp_path / "other")
    filled = uri.replace("PERSON", places["person"])
    with pytest.raises(InputError) as caught:
        capture.open_rgbd(filled.replace("OTHER", f"folder:{tmp_path / 'other'}"))
    assert message in str(caught.value)


def test_values_of_options_are_written_as_in_addresses() -> None:
    plan = read_plan("forged:sim:body#type=2&pose=a+b.bvh&switch=50%25 %26 more=less&background=")
    assert (plan.kind, plan.pose, plan.switch, plan.background) == (
        2, "a+b.bvh", "50% & more=less", "",
    )  # fmt: skip


@pytest.mark.parametrize("options", ["", "#show=real", "#background=mkv:w.mkv"])
def test_the_address_of_a_forged_recording_is_an_address(options: str) -> None:
    assert capture.rgbd_address(f"forged:mkv:w.mkv{options}") == f"forged:mkv:w.mkv{options}"


def test_options_of_other_sources_are_refused(places: dict[str, str]) -> None:
    options: Any
    for options in ({"camera": SMALL}, {"units_per_metre": 1000.0}, {"speed": -1.0}):
        with pytest.raises(InputError, match=next(iter(options))):
            capture.open_rgbd(f"forged:{places['person']}", **options)
