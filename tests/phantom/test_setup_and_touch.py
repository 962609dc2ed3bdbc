"""Set-up and extras of a session: placement, measures, the touch cue and the felt limb."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import capsule_body
from manip3d import InputError
from manip3d.phantom import LiveSession
from manip3d.phantom._felt import FeltLimb, felt_places
from manip3d.phantom._live import _Show
from manip3d.phantom._setup import PlacementCalibration, moved_to, placement_checks
from manip3d.phantom._touch import SECONDS, TOUCH_S, TouchCue, touches
from manip3d.rgbd import JOINTS, NOT_TRACKED, Skeleton


@pytest.fixture
def body() -> Skeleton:
    (found,) = capsule_body.painted(0).skeletons
    return found


def moved(body: Skeleton, shift: tuple[float, float, float], turn: float = 0.0) -> Skeleton:
    """Return the person at another place, turned about the vertical by degrees."""
    middle = body.positions[0]
    angle = np.radians(turn)
    spin = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    places = (body.positions - middle) @ spin.T + middle + np.array(shift)
    return replace(body, positions=places.astype(np.float32))


def unmet(skeleton: Skeleton, **options: Any) -> dict[str, str]:
    frame = capsule_body.painted(0)
    shown = LiveSession("right_arm")._pipeline.process(frame)
    seen = replace(shown, skeleton=skeleton, visible=options.pop("visible", 1.0))
    about = {"people": 1, "is_chosen": False, "rate": 30.0} | options
    checks = placement_checks(seen, skeleton, frame.calibration.depth, **about)
    assert all(check.is_met == (check.advice == "") for check in checks)
    return {check.name: check.advice for check in checks if not check.is_met}


def test_a_good_place_needs_no_advice(body: Skeleton) -> None:
    assert unmet(body) == {}


@pytest.mark.parametrize(
    ("shift", "turn", "name", "advice"),
    [
        ((0, 0, -1.4), 0, "Distance", "Step back"),
        ((0, 0, 3.0), 0, "Distance", "Come nearer"),
        ((1.6, 0, 0), 0, "Whole body in the picture", "hands"),
        ((0, -1.2, 0), 0, "Whole body in the picture", "head"),
        ((0, 1.2, 0), 0, "Whole body in the picture", "feet"),
        ((0, 0, 0), 40, "Facing the camera", "39 degrees"),
        ((0, 0, 0), 180, "Facing the camera", "179 degrees"),
    ],
)
def test_what_is_wrong_is_said(
    body: Skeleton, shift: tuple[float, float, float], turn: float, name: str, advice: str
) -> None:
    assert advice in unmet(moved(body, shift, turn))[name]


def test_other_people_hidden_limbs_and_slow_pictures(body: Skeleton) -> None:
    assert set(unmet(body, people=2)) == {"One patient"}
    assert unmet(body, people=2, is_chosen=True) == {}
    assert set(unmet(body, visible=0.4)) == {"Intact limb seen"}
    assert "11 pictures" in unmet(body, rate=11.2)["Pictures in time"]
    nobody = replace(body, states=np.full(25, NOT_TRACKED, np.uint8))
    assert set(unmet(nobody)) == {"Somebody in view"}


@pytest.mark.parametrize("rate", [10, 30, 90])
def test_measures_are_medians_of_two_still_seconds(body: Skeleton, rate: int) -> None:
    chance = np.random.default_rng(5)
    calibration = PlacementCalibration()
    found = None
    for number in range(2 * rate + 1):
        assert found is None
        noise = chance.normal(0, 0.008, body.positions.shape)
        noisy = replace(body, positions=(body.positions + noise).astype(np.float32))
        found = calibration.add(noisy, 5_000_000_000 + number * 1_000_000_000 // rate)
    assert found is not None
    # The error of a median of noise of 8 mm, four times as large in the worst of 75 coordinates.
    assert np.abs(found.positions - body.positions).max() < 4 * 0.008 * 1.25 / np.sqrt(2 * rate)
    there = moved(body, (0.5, 0.0, 0.4))
    assert np.abs(moved_to(found, there).positions - there.positions).max() < 0.02


def test_who_moves_is_measured_anew(body: Skeleton) -> None:
    calibration = PlacementCalibration()
    step = 50_000_000
    for number in range(21):
        calibration.add(body, number * step)
    assert calibration.share == pytest.approx(0.5)
    there = moved(body, (0.2, 0, 0))
    calibration.add(there, 21 * step)
    assert calibration.share == 0.0
    calibration.add(there, 22 * step)
    assert calibration.share == pytest.approx(0.025)
    calibration.add(replace(body, states=np.full(25, NOT_TRACKED, np.uint8)), 23 * step)
    assert calibration.share == 0.0


@pytest.mark.parametrize("later_s", [-1.0, 2.5])
def test_a_clock_that_jumps_begins_the_two_seconds_anew(body: Skeleton, later_s: float) -> None:
    calibration = PlacementCalibration()
    for number in range(20):
        calibration.add(body, number * 50_000_000)
    again = int(1e9 + later_s * 1e9)
    assert calibration.add(body, again) is None
    assert calibration.share == 0.0
    assert calibration.add(body, again + 1_000_000_000) is None
    assert calibration.share == pytest.approx(0.5)


# --- touch ----------------------------------------------------------------------------------------


def test_touches_are_seen_and_felt_at_once_or_not() -> None:
    together, apart = touches("synchronous", 4), touches("asynchronous", 4)
    assert together == touches("synchronous", 4)
    assert together != touches("synchronous", 5)
    assert [t.seen for t in together] == [t.seen for t in apart]  # only the feeling differs
    assert [t.joint for t in together] == [t.joint for t in apart]
    assert len(together) > 25
    assert all(t.felt == t.seen for t in together)
    assert all(0.5 <= t.felt - t.seen <= 0.9 for t in apart)
    # A felt touch must never coincide with a seen one.
    for touch in apart:
        assert not any(other.seen <= touch.felt < other.seen + TOUCH_S for other in apart)
    assert {t.joint for t in together} == {0, 1, 2}
    assert together[-1].seen + TOUCH_S < SECONDS
    with pytest.raises(InputError, match="mode: expected one of"):
        touches("both", 1)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="seed: expected >= 0"):
        touches("synchronous", -1)


@pytest.mark.parametrize("mode", ["synchronous", "asynchronous"])
def test_a_cue_shows_each_touch_once(mode: Any) -> None:
    cue = TouchCue(mode, 4)
    seen, felt = [], 0
    while not cue.is_over:
        due = cue.due
        joint, is_felt = cue.pass_time(1 / 30)
        assert is_felt == (due is not None and due.felt <= cue.clock)  # told beforehand
        seen.append(joint)
        felt += is_felt
    expected = touches(mode, 4)
    begun = [b for a, b in zip([None, *seen], seen, strict=False) if a is None and b is not None]
    assert begun == [touch.joint for touch in expected]
    assert felt == len(expected)


def test_the_ball_touches_the_phantom_limb_of_the_page(body: Skeleton) -> None:
    from frame_reader import read_frame

    session = LiveSession("right_arm")
    frames = [capsule_body.painted(number) for number in range(60)]
    session.command("touch", {"mode": "synchronous"})
    session.command("felt", {"length": 50, "telescoping": 0, "raised": 90, "bent": 0})
    shown = [read_frame(m) for m in map(session.process, frames) if m is not None]
    touched = [frame.status for frame in shown if frame.status["touch"]["place"]]
    assert touched
    arm = [JOINTS.index(f"{name}Right") for name in ("Elbow", "Wrist", "Hand")]
    for status in touched:
        assert status["touch"]["place"] in [status["joints"][joint] for joint in arm]
    assert sum(frame.status["touch"]["felt"] for frame in shown) >= 1
    seconds, joint = shown[0].status["touch"]["due"]
    assert 0 < seconds < 3
    assert joint in ("elbow", "wrist", "hand")
    felt = np.array(shown[-1].status["felt"])
    assert felt.shape == (3, 3)
    session.command("touch", {"mode": "off"})
    (last,) = [read_frame(m) for m in [session.process(capsule_body.painted(61))] if m]
    assert last.status["touch"] is None


# --- the felt limb --------------------------------------------------------------------------------


def test_the_felt_limb_is_where_the_patient_says(body: Skeleton) -> None:
    def at(name: str) -> np.ndarray[Any, Any]:
        return body.positions[JOINTS.index(name)].astype(float)

    def length(places: Any) -> float:
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    left = np.array([at(f"{n}Left") for n in ("Shoulder", "Elbow", "Wrist")])
    hanging = felt_places(FeltLimb(), body, "right_arm")
    assert hanging is not None
    assert hanging[0] == pytest.approx(at("ShoulderRight"))
    assert length(hanging) == pytest.approx(length(left), rel=1e-6)
    assert hanging[2][1] > hanging[0][1] + 0.9 * length(left)  # y is down
    raised = felt_places(FeltLimb(raised=90), body, "right_arm")
    assert raised is not None
    assert raised[2][0] < raised[0][0] - 0.9 * length(left)  # the person faces the camera
    short = felt_places(FeltLimb(length=80, telescoping=50), body, "right_arm")
    assert length(short) == pytest.approx(0.4 * length(left), rel=1e-6)
    bent = felt_places(FeltLimb(bent=90), body, "right_arm")
    assert bent is not None
    assert bent[2][2] < bent[1][2] - 0.1  # forwards, towards the camera
    leg = felt_places(FeltLimb(bent=90), body, "left_leg")
    assert leg is not None
    assert leg[2][2] > leg[1][2] + 0.1  # a knee bends backwards
    assert felt_places(FeltLimb(telescoping=100), body, "left_arm") is not None
    gone = replace(body, states=np.full(25, NOT_TRACKED, np.uint8))
    assert felt_places(FeltLimb(), gone, "right_arm") is None
    with pytest.raises(InputError, match="bent: expected 0 to 150, got 151"):
        FeltLimb(bent=151)


# --- the session ----------------------------------------------------------------------------------


def test_another_limb_is_mirrored_and_its_game_offered() -> None:
    from frame_reader import read_frame

    session = LiveSession("right_arm")
    frames = [capsule_body.painted(number) for number in range(8)]
    session.command("ready")
    for frame in frames[:4]:
        session.process(frame)
    session.command("limb", {"limb": "left_leg"})
    shown = [read_frame(m) for m in map(session.process, frames[4:]) if m is not None]
    status = shown[-1].status
    assert status["affected"] == session.affected == "left_leg"
    assert (status["game"]["name"], status["game"]["phase"]) == ("bubbles-legs", "waiting")
    assert [summary.ending for summary in session.summaries] in ([], ["stopped"])
    idle: Any = SimpleNamespace(report=list, refused={}, lost_lines=0)
    assert _Show(session, idle, None, 0.0).report([], idle).affected == "left_leg"


def test_the_chosen_person_is_followed() -> None:
    from frame_reader import read_frame

    session = LiveSession("right_arm")
    frame = capsule_body.painted(0)
    (first,) = frame.skeletons
    other = replace(moved(first, (1.2, 0, 0)), id=first.id + 1)
    both = [replace(capsule_body.painted(n), skeletons=(first, other)) for n in range(4)]

    def last(frames: list[Any]) -> dict[str, Any]:
        return [read_frame(m).status for m in map(session.process, frames) if m][-1]

    before = last(both[:2])
    assert [is_patient for _, is_patient in before["people"]] == [True, False]
    assert any(name == "One patient" and not met for name, met, _ in before["checks"])
    crossed = replace(both[2], skeletons=(other, first))
    session.command("patient", {"which": before["people"][1][0]})
    after = last([crossed, both[3]])
    assert not any(name == "One patient" and not met for name, met, _ in after["checks"])
    assert [is_patient for _, is_patient in after["people"]] == [False, True]
    session.command("patient", {"which": 9})  # nobody
    last([replace(capsule_body.painted(5), skeletons=(first, other))])
    session.command("limb", {"limb": "left_arm"})
    again = last([replace(capsule_body.painted(n), skeletons=(first, other)) for n in (6, 7)])
    assert [is_patient for _, is_patient in again["people"]] == [False, True]
    session.restart()  # the recording is repeated
    repeated = last([replace(capsule_body.painted(n), skeletons=(first, other)) for n in range(4)])
    assert [is_patient for _, is_patient in repeated["people"]] == [False, True]
    assert not any(name == "One patient" and not met for name, met, _ in repeated["checks"])


def test_a_game_is_laid_out_for_the_measured_patient() -> None:
    from frame_reader import read_frame

    session = LiveSession("right_arm")
    session.command("calibrate")
    frames = [capsule_body.painted(0)] * 90
    frames = [
        replace(f, time_ns=f.time_ns + n * 33_333_333, number=n) for n, f in enumerate(frames)
    ]
    shown = [read_frame(m).status for m in map(session.process, frames) if m]
    shares = [status["calibrated"] for status in shown]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert session._measured is not None


def test_measures_of_one_patient_are_not_those_of_another() -> None:
    from frame_reader import read_frame

    session = LiveSession("right_arm")
    frame = capsule_body.painted(0)
    (first,) = frame.skeletons
    other = replace(moved(first, (1.2, 0, 0)), id=first.id + 1)
    number = 0

    def next_status() -> dict[str, Any]:
        nonlocal number
        number += 1
        both = replace(frame, time_ns=number * 33_333_333, number=number, skeletons=(first, other))
        message = session.process(both)
        assert message is not None
        return read_frame(message).status

    session.command("calibrate")
    while (status := next_status())["calibrated"] != 1.0:
        assert number < 90
    (own, is_patient), (others, _) = status["people"]
    assert is_patient
    session.command("patient", {"which": own})
    assert next_status()["calibrated"] == 1.0
    session.command("patient", {"which": others})
    assert next_status()["calibrated"] is None
