"""Sessions without a browser: equal frames, commands and seeds give equal games."""

from __future__ import annotations

import functools
import io
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import capsule_body
from frame_reader import ReadFrame, read_frame
from manip3d import InputError, __version__
from manip3d.modify import PhantomState
from manip3d.phantom import GameSummary, LiveSession, simulated_patient
from manip3d.phantom._anomalies import Anomaly
from manip3d.phantom._diary import DiaryRecorder
from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._live import hear
from manip3d.phantom._messages import Inbox
from manip3d.phantom._recorder import Pictures, Recorder
from manip3d.phantom.games import begin
from manip3d.rgbd import JOINTS, NOT_TRACKED, RgbdFrame


@functools.cache
def patient(count: int = 75) -> list[RgbdFrame]:
    """Return frames of the simulated amputee, with the noise of a tracker."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator
    from manip3d.simulate.sources import open_source

    simulator = open_source(simulated_patient("right_arm"), threads=1)
    assert isinstance(simulator, BodySimulator)
    return [simulator.frame(number / 30) for number in range(count)]


def play(session: LiveSession, frames: list[RgbdFrame]) -> list[ReadFrame]:
    messages = [session.process(frame, captured_ns=1) for frame in frames]
    return [read_frame(message) for message in messages if message is not None]


def drop_times(status: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in status.items() if name != "stage_ms"}


def test_the_phantom_hand_bursts_a_bubble() -> None:
    session = LiveSession("right_arm")
    session.command("ready")
    shown = play(session, patient())
    bursts = list(
        {e[7]: e for frame in shown for e in frame.status["game"].get("events", ())}.values()
    )  # each is told for a second
    phantom_hand = {10, 11, 23, 24}
    by_phantom = [event for event in bursts if event[0] == "burst" and event[2] in phantom_hand]
    assert by_phantom
    last = shown[-1].status["game"]
    assert last["by_phantom"] == len(by_phantom)
    assert last["score"] == sum(event[0] == "burst" for event in bursts) > len(by_phantom)


def test_the_same_seed_is_the_same_session() -> None:
    def statuses(seed: int) -> list[dict[str, Any]]:
        session = LiveSession("right_arm", difficulty=3, seed=seed)
        session.command("ready")
        return [drop_times(frame.status) for frame in play(session, patient())]

    assert statuses(1) == statuses(1)
    assert statuses(1) != statuses(2)


def test_sequence_numbers_and_times_are_those_of_the_frames() -> None:
    frames = [capsule_body.painted(number) for number in range(4)]
    shown = play(LiveSession(), frames)
    assert [frame.sequence for frame in shown] == [0, 1, 2, 3]
    assert [frame.time_ns for frame in shown] == [frame.time_ns for frame in frames]
    assert [frame.captured_ns for frame in shown] == [1] * 4


def test_a_frame_that_is_not_newer_is_not_shown() -> None:
    session = LiveSession()
    frame = capsule_body.painted(1)
    assert session.process(frame) is not None
    assert session.process(frame) is None


def test_a_source_without_a_clock_is_played_at_30_frames_a_second() -> None:
    session = LiveSession("right_arm")
    session.command("ready")
    session.command("calibrate")
    shown = play(session, [replace(frame, time_ns=0) for frame in patient()])
    began = next(i for i, frame in enumerate(shown) if frame.status["game"]["phase"] == "playing")
    left = [frame.status["game"]["left_s"] for frame in shown[began:]]
    assert left[0] - left[-1] == pytest.approx((len(left) - 1) / 30, abs=0.02)
    assert max(frame.status["calibrated"] or 0.0 for frame in shown) > 0.0


def test_a_recording_may_begin_again() -> None:
    session = LiveSession()
    frame = capsule_body.painted(1)
    assert session.process(frame) is not None
    session.restart()
    assert session.process(frame) is not None


def test_a_lost_limb_pauses_the_game_and_punishes_nobody() -> None:
    """Nothing in the game changes while the patient is not seen for two seconds."""
    session = LiveSession("right_arm")
    session.command("ready")
    frames = patient()
    before = play(session, frames[:40])[-1].status
    assert before["game"]["phase"] == "playing"
    gone = [
        replace(
            frames[40], skeletons=(), time_ns=frames[39].time_ns + number * 33_333_333, number=1000
        )
        for number in range(1, 61)
    ]
    during = [frame.status for frame in play(session, gone)]
    assert during[-1]["state"] == "lost"
    for status in during:
        assert status["state"] != "tracking"
        assert status["game"]["phase"] == "paused"
        for name in ("left_s", "score", "misses", "targets", "stains"):
            assert status["game"][name] == before["game"][name]
        told = {event[7] for event in status["game"]["events"]}
        assert told <= {event[7] for event in before["game"]["events"]}  # no new ones
    session.command("stop")
    play(session, [replace(gone[-1], time_ns=gone[-1].time_ns + 33_333_333)])
    summary = session.summaries[-1]
    assert isinstance(summary, GameSummary)
    assert (summary.ending, summary.misses) == ("stopped", 0)
    assert summary.paused_s >= 60 * 0.0333
    assert summary.seconds == pytest.approx(60.0 - before["game"]["left_s"], abs=0.02)


def test_too_few_pictures_a_second_pause_the_game() -> None:
    """The game is paused at 3 pictures per second, since motion between them is unknown."""
    session = LiveSession("right_arm")
    session.command("ready")
    slow = [
        replace(frame, time_ns=number * 333_333_333) for number, frame in enumerate(patient()[:60])
    ]
    shown = [frame.status for frame in play(session, slow)]
    begun = next(i for i, status in enumerate(shown) if status["game"]["phase"] == "playing")
    for status in shown[begun + 1 :]:
        assert status["game"]["phase"] == "paused"
        if status["state"] == "tracking":
            assert "pictures come too slowly" in status["message"]
        assert (status["game"]["score"], status["game"]["left_s"]) == (0, 60.0)
    session.end()
    (summary,) = session.summaries
    assert (summary.ending, summary.seconds, summary.score) == ("stopped", 0.0, 0)
    assert summary.paused_s == pytest.approx((len(slow) - 1 - begun) / 3, abs=0.01)


@pytest.mark.parametrize("begins_again", [False, True])
def test_an_outage_of_the_camera_is_a_pause(begins_again: bool) -> None:
    session = LiveSession("right_arm")
    session.command("ready")
    frames = patient()[:60]
    start = 0 if begins_again else frames[39].time_ns + 30_000_000_000
    later = [
        replace(frame, time_ns=start + number * 33_333_333)
        for number, frame in enumerate(frames[40:])
    ]
    before = play(session, frames[:40])[-1].status["game"]
    session.notice("The camera is gone: check its cable.")
    messages = [session.process(frame, captured_ns=30_000_000_001) for frame in later]
    shown = [read_frame(message).status for message in messages if message is not None]
    assert shown[0]["game"]["phase"] == "paused"
    assert "were missing" in shown[0]["message"]
    for name in ("left_s", "score", "misses", "targets"):
        assert shown[0]["game"][name] == before[name]
    assert shown[-1]["game"]["phase"] == "playing"
    assert "were missing" not in shown[-1]["message"]
    session.end()
    assert session.summaries[0].paused_s >= 30.0
    assert session.summaries[0].seconds < 2.0


def test_feet_that_are_seen_unsteadily_are_told_on_the_page() -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(
        amputated="left_leg", motion="still", sitting=True, tracker="kinect-v1", seed=6, rate=10,
        color="none", room=False, frames=60, threads=1,
    )  # fmt: skip
    session = LiveSession("left_leg", game="pedal")
    session.command("ready")
    last = play(session, list(simulator))[-1].status
    assert last["game"]["phase"] == "playing"
    assert "The camera sees your feet unsteadily, so that only movements of" in last["message"]


WITHOUT_ENDS = [
    JOINTS.index(f"{name}{side}")
    for name in ("Hand", "HandTip", "Thumb", "Foot")
    for side in ("Left", "Right")
]
"""Joints that trackers with those of COCO do not have."""


def like_coco(frame: RgbdFrame) -> RgbdFrame:
    (body,) = frame.skeletons
    states = body.states.copy()
    states[WITHOUT_ENDS] = NOT_TRACKED
    positions = body.positions.copy()
    positions[WITHOUT_ENDS] = 0.0
    return replace(frame, skeletons=(replace(body, positions=positions, states=states),))


@pytest.mark.parametrize("game", ["pedal", "piano"])
def test_a_game_whose_joints_the_tracker_does_not_have_is_refused_with_those_that_can_be_played(
    game: str,
) -> None:
    frames = [capsule_body.painted(number) for number in range(40)]
    session = LiveSession("left_leg", game=game)
    session.command("ready")
    shown = [frame.status for frame in play(session, [like_coco(frame) for frame in frames])]
    waiting = [status for status in shown if status["state"] == "tracking"]
    assert len(waiting) > 10
    assert {status["game"]["phase"] for status in waiting} == {"starting"}
    (message,) = {status["message"] for status in waiting}
    assert message.endswith(
        f"{game.title()} needs joints that the tracker does not see: left foot, right foot. What "
        "can be played: Bubble Burst for legs."
    )
    session.command("choose", {"game": "bubbles-legs", "difficulty": 1})
    session.command("ready")
    later = [replace(frame, time_ns=frame.time_ns + 2_000_000_000) for frame in frames]
    after = play(session, [like_coco(frame) for frame in later])[-1].status
    assert after["game"]["phase"] == "playing"
    assert "needs joints" not in after["message"]


@pytest.mark.parametrize(("limb", "end"), [("right_arm", "Wrist"), ("left_leg", "Ankle")])
def test_touches_of_a_limb_without_its_end_are_on_joints_that_are_seen(limb: str, end: str) -> None:
    session = LiveSession(limb)
    session.command("touch", {"mode": "synchronous"})
    frames = [
        replace(like_coco(capsule_body.painted(number % 60)), time_ns=number * 33_333_333)
        for number in range(600)
    ]
    shown = [frame.status for frame in play(session, frames)]
    touched = [status for status in shown if status["touch"]["place"]]
    assert touched
    side = limb.partition("_")[0].title()
    inner = {"Wrist": "Elbow", "Ankle": "Knee"}[end]
    places = {name: JOINTS.index(name + side) for name in (inner, end)}
    for status in touched:
        assert status["touch"]["place"] in [status["joints"][joint] for joint in places.values()]
    assert {status["touch"]["due"][1] for status in shown} == {inner.lower(), end.lower()}


def test_enlarged_arms_ask_for_no_larger_movements_of_the_feet() -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(
        amputated="right_arm", motion="still", sitting=True, tracker="kinect-v2", seed=6, rate=10,
        color="none", room=False, frames=70, threads=1,
    )  # fmt: skip
    frames, messages = list(simulator), []
    for gain in (1.0, 2.0):
        session = LiveSession("right_arm", game="pedal", gain=gain)
        session.command("ready")
        messages.append([shown.status["message"] for shown in play(session, frames)])
    assert messages[0] == messages[1]


def test_the_frame_in_which_a_game_begins_counts_as_tracked() -> None:
    session = LiveSession("right_arm")
    frames = patient()
    play(session, frames[:30])
    session.command("ready")
    shown = play(session, frames[30:31])
    assert shown[-1].status["game"]["phase"] == "playing"
    session.end()
    assert session.summaries[0].tracked == 1.0


def test_starting_waits_for_a_phantom_limb() -> None:
    session = LiveSession("right_arm")
    session.command("ready")
    frames = patient()
    nobody = [replace(frame, skeletons=()) for frame in frames[:10]]
    assert {frame.status["game"]["phase"] for frame in play(session, nobody)} == {"starting"}
    shown = play(session, frames[10:])
    states = [frame.status["state"] for frame in shown]
    phases = [frame.status["game"]["phase"] for frame in shown]
    first = states.index(PhantomState.TRACKING)
    assert phases[:first] == ["starting"] * first
    assert phases[first] == "playing"


@pytest.mark.parametrize(
    ("has_color", "reason", "message"),
    [
        (True, "no_joints",
         "The tracker has no joints in this picture: the patient is out of view, or was not "
         "recognised."),
        (False, "no_skeleton",
         "The source has no colour images, in which --pose would find the joints."),
    ],
)  # fmt: skip
def test_nobody_in_view_is_no_reason_to_advise_what_is_in_use(
    has_color: bool, reason: str, message: str
) -> None:
    nobody = [replace(capsule_body.painted(n), skeletons=()) for n in range(40)]
    colors = [np.zeros((*frame.depth.shape, 3), np.uint8) for frame in nobody]
    colors[-1] = None  # one picture without colour says nothing about the source
    if not has_color:
        colors = [None] * len(nobody)
    frames = [replace(f, color=color) for f, color in zip(nobody, colors, strict=True)]
    last = play(LiveSession(pose=True), frames)[-1].status
    assert (last["reason"], last["message"]) == (reason, message)
    without = play(LiveSession(), frames)[-1].status["message"]
    assert without == "There is no skeleton in this source: use --pose."


def test_a_choice_holds_for_the_next_game() -> None:
    session = LiveSession("right_arm")
    session.command("choose", {"game": "bubbles-legs", "difficulty": 3})
    session.command("ready")
    shown = play(session, patient()[:40])
    game = shown[-1].status["game"]
    assert (game["name"], game["difficulty"]) == ("bubbles-legs", 3)
    session.command("stop")
    over = play(session, patient()[40:42])[-1].status["game"]
    assert (over["phase"], over["ending"]) == ("over", "stopped")
    assert session.summaries[-1].by_phantom == 0  # an arm plays no part in a game for legs


def test_a_notice_is_a_frame_with_words() -> None:
    found = read_frame(LiveSession().notice("The camera is gone."))
    assert found.status["message"] == "The camera is gone."
    assert found.status["state"] == "lost"
    assert len(found.vertices) == 0


class FakeRecorder:
    """A recorder without a diary: games are in lists, all other entries in ``told`` in order.

    It permits every game, and only the message that the patient feels sick stops the session.
    """

    def __init__(self) -> None:
        self.games: list[GameSummary] = []
        self.going: list[GameSummary] = []
        self.told: list[object] = []
        self.clips: list[Pictures] = []
        self.wants_clips = False
        self.trouble = ""

    def game(self, summary: GameSummary, clips: Sequence[Pictures]) -> None:
        self.games.append(summary)
        self.clips = list(clips)

    def game_goes_on(self, summary: GameSummary) -> None:
        self.going.append(summary)

    def pain(self, value: int) -> str:
        self.told.append(value)
        return ""

    def may_play(self) -> str:
        return ""

    def play_begins(self) -> None:
        self.told.append("begins")

    def event(self, text: str) -> None:
        self.told.append(text)

    def consent(self, clips: bool) -> None:
        self.wants_clips = clips

    def ownership(self, mode: str, answers: Sequence[int]) -> None:
        self.told.append((mode, *answers))

    def felt(self, felt: FeltLimb, limb: str) -> None:
        self.told.append(felt)

    def last_felt(self, limb: str) -> FeltLimb | None:
        return None

    def close_session(self, *, answered: bool = True) -> None:
        self.told.append("closed")

    def open_session(self) -> None:
        self.told.append("opened")

    def begin_message(self) -> None:
        pass

    def when_kept(self, done: Callable[[], object]) -> None:
        done()

    def unwell(self) -> str:
        self.told.append("unwell")
        return "You feel sick."


def test_the_fake_recorder_is_a_recorder() -> None:
    assert isinstance(FakeRecorder(), Recorder)


def recorded(path: Path, **options: Any) -> DiaryRecorder:
    """Return a recorder for P01, with a new diary if there is none."""
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary

    with Diary(path, create=True) as diary:
        if not diary.participants():
            diary.enrol("P01", limb="right_arm", clips=True)
    return DiaryRecorder(path, "P01", None, **options)


def test_pain_that_rises_during_the_first_game_ends_the_play(tmp_path: Path) -> None:
    recorder = recorded(tmp_path / "study.diary")
    recorder.start()
    session = LiveSession("right_arm", recorder=recorder)
    frames = patient()
    session.command("pain", {"value": 3})
    session.command("ready")
    shown = play(session, frames[:40])[-1].status["game"]
    assert (shown["phase"], shown["pain"], shown["halt"]) == ("playing", 3, "")
    session.command("pain", {"value": 9})
    shown = play(session, frames[40:42])[-1].status["game"]
    assert (shown["phase"], shown["pain"]) == ("over", 9)
    assert shown["halt"].startswith("The pain rose from 3 to 9.")
    session.command("ready")
    assert play(session, frames[42:50])[-1].status["game"]["phase"] == "over"
    session.end()
    recorder.end()
    from manip3d.diary import Diary

    with Diary(tmp_path / "study.diary") as diary:
        (sitting,) = diary.sessions("P01")
        assert (sitting.pain_before, sitting.pain_after) == (3, 9)
        assert [game.ending for game in sitting.games] == ["stopped"]
        assert [event.kind for event in diary.events("P01")] == ["pain"]


def test_no_game_starts_before_a_rating_nor_after_a_stop_of_the_same_day(tmp_path: Path) -> None:
    """A rating is needed for later comparisons; a stop also holds in a program started again."""
    path = tmp_path / "study.diary"
    recorder = recorded(path)
    session = LiveSession("right_arm", recorder=recorder)
    session.halt(recorder.start())
    frames = patient()
    session.command("ready")
    shown = play(session, frames[:40])[-1].status
    assert (shown["game"]["phase"], shown["game"]["halt"]) == ("waiting", "")
    assert shown["game"]["ask"].startswith("Please say first how strong the pain is now")
    assert shown["message"].startswith(shown["game"]["ask"])
    session.command("pain", {"value": 2})
    shown = play(session, frames[40:41])[-1].status
    assert (shown["game"]["phase"], shown["game"]["ask"]) == ("waiting", "")
    assert "Please say" not in shown["message"]
    session.command("ready")
    assert play(session, frames[41:44])[-1].status["game"]["phase"] == "playing"
    session.command("unwell")
    assert play(session, frames[44:45])[-1].status["game"]["phase"] == "over"
    recorder.end()

    recorder = recorded(path)
    session = LiveSession("right_arm", recorder=recorder)
    session.halt(recorder.start())
    session.command("pain", {"value": 2})
    session.command("ready")
    shown = play(session, frames[:40])[-1].status["game"]
    assert (shown["phase"], shown["halt"][:13]) == ("waiting", "You feel sick")
    recorder.end()


def test_pain_that_rises_after_a_touch_cue_ends_the_play(tmp_path: Path) -> None:
    recorder = recorded(tmp_path / "study.diary")
    recorder.start()
    session = LiveSession("right_arm", recorder=recorder)
    for name, fields in (
        ("pain", {"value": 3}), ("touch", {"mode": "synchronous"}), ("pain", {"value": 5})
    ):  # fmt: skip
        session.command(name, fields)
    assert "rose from 3 to 5" in play(session, patient()[:1])[-1].status["game"]["halt"]
    recorder.end()


def test_what_is_said_again_after_a_lost_answer_is_taken_once() -> None:
    recorder = FakeRecorder()
    session = LiveSession("right_arm", recorder=recorder)
    first = {"text": "dizzy", "page": 7, "number": 1}
    for fields in (
        first,
        first,
        {"text": "dizzy", "page": 7, "number": 2},
        {"text": "dizzy", "page": 8, "number": 1},  # another screen
        {"text": "dizzy"},
    ):
        session.command("event", fields)
    play(session, patient()[:1])
    assert recorder.told == ["dizzy"] * 4


def test_the_page_that_was_silent_longest_is_forgotten_first() -> None:
    """The numbers of 64 pages are remembered: the first page spoke again, the second did not."""
    inbox = Inbox()
    heard = [(page, 1) for page in range(1, 65)] + [(1, 2), (65, 1), (1, 2), (2, 1)]
    for page, number in heard:
        inbox.put("unwell", {"page": page, "number": number}, None)
    # The second page is forgotten, and what it says again is taken for new.
    assert sum(1 for _ in inbox.taken()) == 64 + 2 + 1


def test_a_page_is_answered_at_once_and_again_when_it_is_kept() -> None:
    """The page learns at once that a message was taken, and later that it is on disk."""
    said: list[dict[str, int]] = []
    client: Any = SimpleNamespace(say=lambda text: said.append(json.loads(text)))
    session = LiveSession("right_arm", recorder=FakeRecorder())
    text = json.dumps({"type": "pain", "value": 3, "page": 7, "number": 4})
    for _ in range(2):
        hear(session, client, text, lambda: "")
    assert said == [{"taken": 4}] * 2
    play(session, patient()[:1])
    assert said[2:] == [{"heard": 4}] * 2
    hear(session, client, json.dumps({"type": "ready"}), lambda: "")
    assert len(said) == 4


def test_who_feels_sick_is_not_touched_any_more() -> None:
    session = LiveSession("right_arm", recorder=FakeRecorder())
    frames = patient()
    session.command("touch", {"mode": "synchronous"})
    assert play(session, frames[:2])[-1].status["touch"] is not None
    session.command("unwell")
    assert play(session, frames[2:4])[-1].status["touch"] is None
    session.command("touch", {"mode": "synchronous"})
    assert play(session, frames[4:6])[-1].status["touch"] is None


def test_events_are_told_for_a_second_and_counted() -> None:
    """A page that leaves frames out misses no event and plays none twice."""
    session = LiveSession("right_arm")
    session.command("ready")
    shown = play(session, patient())
    first: dict[int, int] = {}
    last: dict[int, int] = {}
    for frame in shown:
        numbers = [event[7] for event in frame.status["game"].get("events", [])]
        assert numbers == sorted(numbers)
        for number in numbers:
            first.setdefault(number, frame.time_ns)
            last[number] = frame.time_ns
    assert list(first) == list(range(1, len(first) + 1))
    assert len(first) >= 2
    spans = [last[number] - first[number] for number in first if last[number] < shown[-1].time_ns]
    assert all(0.9e9 < span <= 1.0e9 for span in spans)


@pytest.mark.parametrize("consents", [True, False])
def test_an_anomaly_is_filmed_from_five_seconds_before_it(consents: bool) -> None:
    """The film of an anomaly begins five seconds before it, if the patient consents."""
    from PIL import Image

    recorder = FakeRecorder()
    recorder.wants_clips = consents
    session = LiveSession("right_arm", game="bubbles-legs", recorder=recorder)
    session.command("ready")
    frames = patient()
    there_and_back = [*frames[30:], *frames[-2:30:-1]]  # without a jump
    for number in range(20 * (22 if consents else 14)):
        frame = there_and_back[number % len(there_and_back)]
        time = frames[0].time_ns + number * 50_000_000
        session.process(replace(frame, time_ns=time, number=number), captured_ns=1)
    session.end()
    (game,) = recorder.games
    going = recorder.going
    assert {one.ending for one in going} == {"interrupted"}
    times = [one.seconds + one.paused_s for one in going]
    assert times == pytest.approx([0.0, 10.0, 20.0][: len(times)], abs=0.1)
    assert len(times) >= 2
    assert game.anomalies
    anomaly = game.anomalies[0]
    assert anomaly.end - anomaly.start >= 10.0
    assert len(recorder.clips) == len(game.anomalies)
    if not consents:
        assert not any(recorder.clips)
        return
    pictures = recorder.clips[0]
    times = [seconds for seconds, _ in pictures]
    first = max(0.0, anomaly.start - 5.0)
    assert first - 1e-6 <= times[0] <= first + 0.2
    assert times[-1] == pytest.approx(min(anomaly.end, anomaly.start + 25.0), abs=0.2)
    assert len(times) == pytest.approx(10 * (times[-1] - times[0]), rel=0.3)
    assert sum(len(content) for _, content in pictures) < 20_000 * len(pictures)
    with Image.open(io.BytesIO(pictures[-1][1])) as image:
        assert image.size == (320, 265)
        pixels = np.asarray(image).astype(int)
    assert (np.abs(pixels - 32).max(axis=-1) < 12).mean() > 0.5  # nothing of the room
    assert (np.abs(pixels - 32).max(axis=-1) > 60).sum() > 2000  # the person


def test_consent_that_is_taken_back_for_a_moment_takes_earlier_films_with_it() -> None:
    recorder = FakeRecorder()
    recorder.wants_clips = True
    session = LiveSession("right_arm", recorder=recorder)
    session.command("ready")
    frames = patient()
    play(session, frames[:45])
    session._play._watch.found.append(Anomaly(0.1, 0.5))  # a difficulty that is over
    play(session, frames[45:46])
    assert session._play._clips[0]
    session.command("consent", {"clips": 0})
    session.command("consent", {"clips": 1})
    play(session, frames[46:50])
    session.end()
    assert recorder.wants_clips
    assert len(recorder.games[0].anomalies) == len(recorder.clips) == 1
    assert not any(recorder.clips)


def test_from_the_camera_to_film_diary_and_fhir(tmp_path: Path) -> None:
    """The diary and its FHIR export keep a game with points and one without."""
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from PIL import Image

    from manip3d.diary import Diary, export_clips, fhir_bundle, write_page

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm", clips=True)
    recorder = DiaryRecorder(path, "P01", None, "mkv:/films/of Jane Doe.mkv")
    session = LiveSession("right_arm", recorder=recorder)
    recorder.start(lambda: 25.0)
    frames = patient()
    there_and_back = [*frames[30:], *frames[-2:30:-1]]
    seen = Counter[tuple[int, str]]()
    for number in range(30 * 22):
        if number == 0:
            session.command("pain", {"value": 3})
        if number in (0, 200):
            session.command("choose", {"game": "bubbles-legs" if number else "bubbles",
                                       "difficulty": 1})  # fmt: skip
            session.command("stop")
            session.command("ready")
        frame = there_and_back[number % len(there_and_back)]
        time = frames[0].time_ns + number * 33_333_333
        session.process(replace(frame, time_ns=time, number=number), captured_ns=1)
        if session._play.is_playing:
            seen[len(session.summaries), session.state] += 1
    session.end()
    recorder.end()
    with Diary(path) as diary:
        (sitting,) = diary.sessions("P01")
        assert [game.game for game in sitting.games] == ["bubbles", "bubbles-legs"]
        assert sitting.games[0].by_phantom >= 1
        assert sitting.games[0].score == session.summaries[0].score
        assert {game.limb for game in sitting.games} == {"right_arm"}
        assert {game.source for game in sitting.games} == {"mkv:"}
        assert {game.version for game in sitting.games} == {__version__}
        for number, game in enumerate(sitting.games):
            share = seen[number, "tracking"] / sum(n for (g, _), n in seen.items() if g == number)
            assert game.tracked == pytest.approx(share, abs=0.02)
        assert sitting.games[0].latency_ms == 25.0
        assert len(sitting.games[1].anomalies) == 1
        (clip,) = diary.clips("P01")
        assert (clip.start, clip.end) == sitting.games[1].anomalies[0]
        assert len(clip.pictures) > 80
        (film,) = export_clips(diary, tmp_path / "films", "P01")
        with Image.open(film) as moving:
            assert moving.n_frames > 80  # type: ignore[attr-defined]
        observations = [e["resource"] for e in fhir_bundle(diary, "P01")["entry"]]
        games = [o for o in observations if "Exercise game" in o.get("code", {}).get("text", "")]
        ranges = [p for p in games[1]["component"] if "valueRange" in p]
        assert ranges[0]["valueRange"]["low"]["value"] == clip.start
        write_page(diary, tmp_path / "P01.html", "P01", clips=True)
    keep = os.environ.get("MANIP3D_PICTURES")
    if keep:
        shutil.copy(tmp_path / "P01.html", keep)


def test_pictures_older_than_five_seconds_are_let_go() -> None:
    from manip3d.phantom._clips import ClipRing
    from manip3d.phantom._level import Level

    session = LiveSession("right_arm")
    frames = patient()
    shown = [session._pipeline.process(frame) for frame in frames[:40]][-1]
    game = begin("bubbles", shown.skeleton)
    assert game is not None
    ring = ClipRing()
    camera = frames[0].calibration.depth

    def pass_to(seconds: float, since: float | None = None) -> None:
        while clock[0] < seconds:
            clock[0] += 1 / 30
            ring.add(shown, replace(game, clock=clock[0]), camera, since, Level())

    clock = [0.0]
    pass_to(12.0)
    assert [ring._pictures[0][0]] == pytest.approx([7.0], abs=0.11)
    pass_to(30.0, since=12.0)  # it goes on
    found = ring.take(12.0, 30.0)
    assert (found[0][0], found[-1][0]) == (pytest.approx(7.0, abs=0.11), pytest.approx(30, abs=0.1))
    pass_to(60.0, since=12.0)
    assert ring.take(12.0, 60.0)[-1][0] == pytest.approx(12.0 + 25.0, abs=0.11)
    pass_to(61.0)
    assert ring._pictures[0][0] >= 56.0 - 0.11
    ring.clear()
    assert ring.take(0.0, 99.0) == ()


def test_enhanced_joints_turn_further_and_the_summary_says_so() -> None:
    def hand(session: LiveSession) -> float:
        """Return the height of the phantom hand above its shoulder."""
        joints = play(session, patient()[:60])[-1].status["joints"]
        return float(joints[8][1] - joints[11][1])

    plain, enhanced = LiveSession("right_arm"), LiveSession("right_arm")
    enhanced.command("gain", {"value": 1.5})
    enhanced.command("ready")
    before, after = hand(plain), hand(enhanced)
    assert after > before + 0.1
    session = LiveSession("right_arm", gain=1.5)
    session.command("ready")
    assert hand(session) == pytest.approx(after, abs=0.02)
    session.end()
    assert session.summaries[0].gain == 1.5


def test_a_game_for_other_limbs_is_played_without_the_gain() -> None:
    session = LiveSession("right_arm", game="pedal", gain=2.0)
    session.command("ready")
    play(session, patient()[:40])
    session.end()
    assert session.summaries[0].gain == 1.0


def test_without_a_diary_ratings_are_not_kept() -> None:
    session = LiveSession("right_arm")
    session.command("pain", {"value": 9})
    session.command("unwell")
    game = play(session, patient()[:2])[-1].status["game"]
    assert (game["pain"], game["halt"]) == (None, "")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"affected": "tail"}, "affected: expected 'left_arm'"),
        ({"game": "chess"}, "game: expected one of bubbles"),
        ({"difficulty": 4}, "difficulty: expected 1 to 3, got 4"),
        ({"seed": -1}, f"seed: expected 0 to {2**62}, got -1"),
        ({"jpeg_quality": 0}, "jpeg_quality: expected 1 to 100"),
        ({"gain": 2.5}, r"gain: expected 1 to 2, got 2\.5"),
        ({"gain": float("nan")}, "gain: expected 1 to 2, got nan"),
    ],
)
def test_bad_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LiveSession(**options)


def test_other_commands_are_refused() -> None:
    for name in ("ack", "quit", ""):
        with pytest.raises(InputError, match="name: expected one of choose, ready, stop"):
            LiveSession().command(name)


def test_there_is_no_simulated_patient_without_a_tail() -> None:
    for limb, game, message in (
        ("tail", None, "limb: expected one of left_arm, .*, got .tail."),
        ("left_leg", "chess", "game: expected one of .*, got .chess."),
    ):
        with pytest.raises(InputError, match=message):
            simulated_patient(limb, game)
