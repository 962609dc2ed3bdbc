"""The alert monitor: the witnesses that it asks, the frames that it skips, and its verdicts."""

from __future__ import annotations

import gc
import inspect
import json
import math
import re
import threading
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import ANY

import numpy as np
import pytest

import lattice_scans
from manip3d import Box, LidarFrame
from manip3d.authenticate import (
    WITNESSES,
    Alert,
    AlertMonitor,
    AlertTally,
    AttackObservation,
    DriveMoment,
    KeyFile,
    RiskParameters,
    StereoRig,
    Watermarker,
    WitnessReport,
    _alert,
    _watch,
    verdict_of_alerts,
    verdict_of_stream,
    watch_drive,
)
from manip3d.authenticate._alert_observations import _to_ahead, attack_observations
from manip3d.authenticate._alert_verdict import joined
from manip3d.errors import InputError
from manip3d.report import AlertTimeline
from watermark_scans import grid_scan, key_file

FRAME = LidarFrame(np.zeros((0, 3), np.float32))
RIG = StereoRig(700.0, (600.0, 180.0), 0.5, np.eye(4))
PICTURE = np.zeros((20, 192), np.uint8)  # as small as a pair may be


class Clock:
    """A clock that advances only when a witness works."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Let cameras take 80 ms and forensics 200 ms on a clock of the test."""
    made = Clock()

    def compare(*_: Any, **__: Any) -> Any:
        made.now += 0.08
        return SimpleNamespace(
            verdict="no_trace", reason="alike", observation=lambda **_: None, boxes=(),
            record=dict,
        )  # fmt: skip

    def look(*_: Any, **__: Any) -> Any:
        made.now += 0.2
        return SimpleNamespace(verdict="no_trace", reason="as it was", regions=(), scan=None)

    monkeypatch.setattr(_alert, "stereo_disparity", lambda *_: None)
    monkeypatch.setattr(_alert, "cross_modal_consistency", compare)
    monkeypatch.setattr(_alert, "inspect", look)
    return made


def asked(monitor: AlertMonitor, frames: int) -> dict[str, list[int]]:
    """Return the numbers of the frames in which each witness spoke."""
    spoke: dict[str, list[int]] = {"cross-modal": [], "forensics": []}
    for number in range(frames):
        alert = monitor.judge(FRAME, left=PICTURE, right=PICTURE, speed_mps=10.0)
        for name, frames_of in spoke.items():
            if alert.witnesses[name].verdict == "no_trace":
                frames_of.append(number)
    return spoke


def test_cameras_speak_where_there_is_time_and_forensics_once_a_second(clock: Clock) -> None:
    monitor = AlertMonitor(rig=RIG, budget_s=0.1, every_s=1.0, clock=clock)
    spoke = asked(monitor, 25)
    assert spoke["cross-modal"] == list(range(25))
    assert spoke["forensics"] == [0, 10, 20]
    counts = monitor.counts
    assert counts.frames == 25
    assert counts.verdicts == {"no_trace": 25}
    assert counts.skipped == {"forensics": 22}
    assert counts.late == 3  # with forensics a verdict takes 280 ms
    assert counts.slowest_s == pytest.approx(0.28)
    assert counts.mean_s == pytest.approx((25 * 0.08 + 3 * 0.2) / 25)


def test_cameras_that_are_too_slow_speak_once_a_second_and_the_rest_is_counted(
    clock: Clock,
) -> None:
    monitor = AlertMonitor(rig=RIG, budget_s=0.05, every_s=1.0, clock=clock)
    spoke = asked(monitor, 41)  # 50 ms apart
    assert spoke["cross-modal"] == [0, 20, 40]
    assert monitor.counts.skipped == {"cross-modal": 38, "forensics": 38}
    never = AlertMonitor(rig=RIG, budget_s=0.05, every_s=math.inf, clock=clock)
    assert asked(never, 41)["forensics"] == []


def test_without_a_budget_forensics_judge_each_frame_that_nobody_else_judged(clock: Clock) -> None:
    monitor = AlertMonitor(rig=RIG, budget_s=math.inf, clock=clock)
    spoke = []
    for number in range(12):
        picture = PICTURE if number < 5 else None
        alert = monitor.judge(
            FRAME, left=picture, right=picture, speed_mps=0.0, time_s=100.0 + number / 10
        )
        spoke += [number] * (alert.witnesses["forensics"].verdict == "no_trace")
        assert alert.verdict == "no_trace"
    assert spoke == [0, 5, 6, 7, 8, 9, 10, 11]  # once a second, and where there is no picture
    never = AlertMonitor(budget_s=math.inf, every_s=math.inf, clock=clock)
    assert never.judge(FRAME, speed_mps=0.0).witnesses["forensics"].verdict == "skipped"


ACCUSED = range(3, 8)  # frames that cameras and forensics accuse


@pytest.fixture
def accusing(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Cameras accuse all pictures that are not black, forensics all scans that are not empty."""

    def compare(*_: Any, **__: Any) -> Any:
        clock.now += 0.08
        return SimpleNamespace(
            verdict="tampered", reason="a wall", observation=lambda **_: None, boxes=(), record=dict
        )

    def look(frame: LidarFrame, **_: Any) -> Any:
        clock.now += 0.2
        verdict = "tampered" if frame.num_points else "no_trace"
        return SimpleNamespace(verdict=verdict, reason="shadow", regions=(), scan=None)

    innocent = _alert.cross_modal_consistency
    monkeypatch.setattr(_alert, "stereo_disparity", lambda left, _: left.any())
    monkeypatch.setattr(
        _alert,
        "cross_modal_consistency",
        lambda frame, forged, *rest, **more: (compare if forged else innocent)(frame, **more),
    )
    monkeypatch.setattr(_alert, "inspect", look)
    return clock


def drive_with_a_wall(first_forged: int = 3) -> list[DriveMoment]:
    """Twelve frames; cameras accuse five, forensics those of them from ``first_forged`` on."""
    wall, bright = LidarFrame(np.ones((4, 3), np.float32)), PICTURE + np.uint8(9)
    return [
        DriveMoment(
            wall if number in ACCUSED and number >= first_forged else FRAME,
            (bright, bright) if number in ACCUSED else (PICTURE, PICTURE),
            time_s=number / 10,
        )
        for number in range(12)
    ]


def test_forensics_see_the_frames_that_only_the_cameras_accuse(accusing: Clock) -> None:
    """A forged drive with pictures is as easy to judge as one without them."""
    alerts: list[Alert] = []
    monitor = AlertMonitor(rig=RIG, budget_s=math.inf, clock=accusing)
    watched = watch_drive(monitor, drive_with_a_wall(), show=alerts.append)
    assert watched.verdict == "tampered"
    assert [a.number for a in alerts if a.verdict == "tampered"] == list(ACCUSED)
    heard = [a.number for a in alerts if a.witnesses["forensics"].verdict != "skipped"]
    assert heard == [0, *ACCUSED]
    never = AlertMonitor(rig=RIG, budget_s=math.inf, every_s=math.inf, clock=accusing)
    assert watch_drive(never, drive_with_a_wall()).verdict == "undecidable"
    assert never.counts.skipped == {"forensics": 12}


def test_the_verdict_of_a_drive_says_that_nobody_read_its_pictures() -> None:
    """It passed as a drive without pictures does."""
    unread = DriveMoment(FRAME, blind="needs the extra alert")
    told = "; the cameras judged no frame: needs the extra alert"
    assert watch_drive(AlertMonitor(), [DriveMoment(FRAME), unread]).reason.endswith(told)
    assert "cameras" not in watch_drive(AlertMonitor(), [DriveMoment(FRAME)]).reason


def test_one_judged_frame_is_not_no_frame(accusing: Clock) -> None:
    monitor = AlertMonitor(rig=RIG, budget_s=math.inf, clock=accusing)
    unread = DriveMoment(FRAME, blind="needs the extra alert")
    seen = DriveMoment(FRAME, (PICTURE, PICTURE))
    assert "judged no frame" not in watch_drive(monitor, [unread, seen]).reason


def test_cameras_alone_do_not_convict_a_drive_that_forensics_clear(accusing: Clock) -> None:
    monitor = AlertMonitor(rig=RIG, budget_s=math.inf, clock=accusing)
    watched = watch_drive(monitor, drive_with_a_wall(first_forged=99))
    assert watched.verdict == "undecidable"
    assert monitor.counts.verdicts == {"no_trace": 7, "undecidable": 5}


def test_with_a_budget_forensics_see_one_accused_frame_in_each_period(accusing: Clock) -> None:
    alerts: list[Alert] = []
    monitor = AlertMonitor(rig=RIG, budget_s=0.1, every_s=0.3, clock=accusing)
    watched = watch_drive(monitor, drive_with_a_wall(), show=alerts.append)
    heard = [a.number for a in alerts if a.witnesses["forensics"].verdict != "skipped"]
    assert heard == [0, 3, 6, 9]  # frames 3 and 6 are due in any case
    alerts = []
    monitor = AlertMonitor(rig=RIG, budget_s=0.1, every_s=1.0, clock=accusing)
    watched = watch_drive(monitor, drive_with_a_wall(), show=alerts.append)
    heard = [a.number for a in alerts if a.witnesses["forensics"].verdict != "skipped"]
    assert heard == [0, 3]  # not due before frame 13 after it
    assert watched.verdict == "tampered"


def test_a_frame_whose_watermark_is_broken_needs_no_forensics(
    accusing: Clock, tmp_path: Path
) -> None:
    with KeyFile(key_file(tmp_path / "key")) as key:
        sent = Watermarker(key).embed(grid_scan(2000))
        monitor = AlertMonitor(Watermarker(key), rig=RIG, budget_s=math.inf, clock=accusing)
        monitor.judge(FRAME, speed_mps=1.0)  # forensics are due once
        points = sent.points.copy()
        points[7] += np.float32([0.5, 0, 0])
        bright = PICTURE + np.uint8(9)
        alert = monitor.judge(
            LidarFrame(points, sent.frame.intensity), record=sent.record, left=bright,
            right=bright, speed_mps=1.0,
        )  # fmt: skip
    assert {name: told.verdict for name, told in alert.witnesses.items()} == {
        "watermark": "tampered", "cross-modal": "tampered", "forensics": "skipped"
    }  # fmt: skip


@pytest.mark.parametrize("first_forged", [3, 4, 99])
def test_an_accused_frame_waits_for_forensics_in_the_background(
    first_forged: int, accusing: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, seen = threading.Event(), []
    judged = _alert.inspect

    def look(frame: LidarFrame, **options: Any) -> Any:
        assert go_on.wait(30)
        seen.append(frame.num_points)
        return judged(frame, **options)

    monkeypatch.setattr(_alert, "inspect", look)
    monitor = AlertMonitor(rig=RIG, budget_s=math.inf, background=True, clock=accusing)
    moments = drive_with_a_wall(first_forged)

    def show(alert: Alert) -> None:
        assert alert.witnesses["forensics"].verdict == "skipped"  # frame 0 takes a long time
        if alert.number == len(moments) - 1:
            go_on.set()

    watched = watch_drive(monitor, moments, show=show)
    assert len(seen) == 2  # frames 0 and 3; frames 4 to 7 are too many
    assert watched.verdict == ("tampered" if first_forged == 3 else "undecidable")
    assert monitor.finish() is None


def test_an_accusation_is_not_replaced_by_the_last_word(
    accusing: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frame 0 is forged; frame 1 is clean, although cameras accuse it."""
    go_on = threading.Event()
    judged = _alert.inspect
    monkeypatch.setattr(
        _alert, "inspect", lambda *a, **b: judged(*a, **b) if go_on.wait(30) else None
    )
    monitor = AlertMonitor(rig=RIG, background=True, clock=accusing, budget_s=math.inf)
    monitor.judge(LidarFrame(np.ones((4, 3), np.float32)), speed_mps=1.0)
    bright = PICTURE + np.uint8(9)
    monitor.judge(FRAME, left=bright, right=bright, speed_mps=1.0)
    go_on.set()
    assert monitor.finish() == WitnessReport("tampered", "frame 0: shadow", ANY)
    assert monitor.finish() is None


def test_forensics_in_the_background_speak_of_the_frame_that_they_saw(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    go_on, seen = threading.Event(), []

    def look(frame: LidarFrame, **options: Any) -> Any:
        seen.append((frame.num_points, options["threads"]))
        assert go_on.wait(30)
        return SimpleNamespace(verdict="tampered", reason="a hole", regions=(), scan=None)

    monkeypatch.setattr(_alert, "inspect", look)
    monitor = AlertMonitor(background=True, every_s=1.0)
    scan = LidarFrame(np.zeros((7, 3), np.float32))

    def told(number: int, frame: LidarFrame = FRAME) -> tuple[str, str, str]:
        alert = monitor.judge(frame, speed_mps=1.0, time_s=number / 10)
        report = alert.witnesses["forensics"]
        assert alert.number == number
        return alert.verdict, report.verdict, report.reason

    assert told(0, scan) == ("undecidable", "skipped", "not due")  # they have only begun
    scan.points[:] = np.nan  # nobody else's
    for number in range(1, 15):  # due again, but still at work
        assert told(number) == ("undecidable", "skipped", "still at frame 0")
    go_on.set()
    assert monitor.finish() == WitnessReport("tampered", "frame 0: a hole", ANY)
    assert monitor.finish() is None
    assert told(15) == ("undecidable", "skipped", "not due")  # and asked again
    for _ in range(10_000):
        heard = monitor.judge(FRAME, speed_mps=1.0, time_s=1.6)
        if heard.witnesses["forensics"].verdict != "skipped":
            break
        time.sleep(0.001)
    assert heard.verdict == "tampered"
    assert heard.reason == "forensics: frame 15: a hole"
    assert heard.forensics is not None
    assert seen == [(7, 1), (0, 1)]
    assert monitor.counts.skipped["forensics"] == heard.number


def test_what_goes_wrong_in_the_background_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise InputError("points: row 3 is not finite")

    monkeypatch.setattr(_alert, "inspect", fail)
    monitor = AlertMonitor(background=True)
    monitor.judge(FRAME, speed_mps=1.0)
    last = monitor.finish()
    assert last == WitnessReport("undecidable", "frame 0: failed: points: row 3 is not finite", ANY)


WRONG: list[dict[str, Any]] = [
    {"speed_mps": -1.0},
    {"speed_mps": math.nan},
    {"motion": (0.0, math.inf, 0.0)},
    {"left": PICTURE[:10, :10], "right": PICTURE[:10, :10]},
    {"left": PICTURE, "right": PICTURE.astype(float)},
]


@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_a_frame_that_was_refused_is_authentic_when_it_is_judged_again(
    wrong: dict[str, Any], tmp_path: Path
) -> None:
    """The chain of the watermark has not moved, and the frame has not been counted."""
    with KeyFile(key_file(tmp_path / "key")) as key:
        monitor = AlertMonitor(Watermarker(key), rig=RIG)
        sent = Watermarker(key).embed(grid_scan(2000))
        with pytest.raises(InputError):
            monitor.judge(sent.frame, record=sent.record, **{"speed_mps": 1.0, **wrong})
        again = monitor.judge(sent.frame, record=sent.record, speed_mps=1.0)
    assert again.verdict == "authentic"
    assert again.number == 0


def test_a_frame_that_was_refused_leaves_no_time_behind(tmp_path: Path) -> None:
    with KeyFile(key_file(tmp_path / "key")) as key:
        monitor = AlertMonitor(Watermarker(key))
        assert monitor.judge(FRAME, speed_mps=1.0).witnesses["forensics"].reason != "not due"
        with pytest.raises(InputError, match="record: cannot be given with a picture"):
            monitor.judge(FRAME, record=b"", carrier=PICTURE, speed_mps=1.0, time_s=1e3)
        assert monitor.judge(FRAME, speed_mps=1.0).witnesses["forensics"].reason == "not due"


@pytest.mark.parametrize("several", [False, True])
def test_what_cameras_and_forensics_cannot_do_is_their_word_and_the_frame_counts(
    several: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise ValueError("no memory for the map")

    monkeypatch.setattr(_alert, "cross_modal_consistency", fail)
    monkeypatch.setattr(_alert, "inspect", fail)
    shown: dict[str, Any] = {"left": PICTURE, "right": PICTURE}
    if several:
        shown = {"pairs": {"front": (PICTURE, PICTURE)}}
    with KeyFile(key_file(tmp_path / "key")) as key:
        rig = {"front": RIG, "rear": RIG} if several else RIG
        monitor = AlertMonitor(Watermarker(key), rig=rig)
        sender = Watermarker(key)
        for number in range(2):
            sent = sender.embed(grid_scan(2000))
            alert = monitor.judge(
                sent.frame, record=sent.record, speed_mps=1.0, time_s=float(number), **shown
            )
            assert (alert.number, alert.verdict) == (number, "authentic")
            for name in ("cross-modal", "forensics"):
                assert alert.witnesses[name].verdict == "undecidable"
                assert alert.witnesses[name].reason.endswith("failed: no memory for the map")


def fail_at(monkeypatch: pytest.MonkeyPatch, calls: set[int]) -> None:
    """Let the comparisons of these numbers fail at once, and keep the others."""
    compare, numbers = _alert.cross_modal_consistency, iter(range(100))

    def fail_or_compare(*given: Any, **options: Any) -> Any:
        if next(numbers) in calls:
            raise ValueError("pictures are torn")
        return compare(*given, **options)

    monkeypatch.setattr(_alert, "cross_modal_consistency", fail_or_compare)


def test_a_quick_failure_does_not_tell_what_a_verdict_costs(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_at(monkeypatch, {1})
    monitor = AlertMonitor(rig=RIG, budget_s=0.1, every_s=math.inf, clock=clock)
    for waited, expected in (
        (0.0, "no_trace"),  # takes 80 ms
        (0.01, "undecidable"),  # takes no time
        (0.05, "skipped"),  # 80 ms would not be within 100 ms
        (0.01, "no_trace"),
    ):
        alert = monitor.judge(
            FRAME, left=PICTURE, right=PICTURE, speed_mps=1.0, waited_s=waited
        )  # fmt: skip
        assert alert.witnesses["cross-modal"].verdict == expected
    assert monitor.counts.late == 0


def test_a_comparison_that_fails_slowly_makes_one_verdict_late_in_a_period(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    compare, is_broken = _alert.cross_modal_consistency, True

    def fail_slowly(*given: Any, **options: Any) -> Any:
        if is_broken:
            clock.now += 0.3
            raise MemoryError("no memory for the map")
        return compare(*given, **options)

    monkeypatch.setattr(_alert, "cross_modal_consistency", fail_slowly)
    monitor = AlertMonitor(rig=RIG, budget_s=0.1, every_s=1.0, clock=clock)

    def verdict(time_s: float) -> str:
        shown: dict[str, Any] = {"left": PICTURE, "right": PICTURE}
        alert = monitor.judge(FRAME, speed_mps=1.0, time_s=time_s, **shown)
        return alert.witnesses["cross-modal"].verdict

    found = [verdict(0.1 * number) for number in range(20)]
    assert found == 2 * ["undecidable", *9 * ["skipped"]]
    assert monitor.counts.late == 2
    is_broken = False
    assert [verdict(2.0 + 0.1 * number) for number in range(3)] == 3 * ["no_trace"]


def test_one_quick_verdict_is_forgotten_after_ten_others(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    compare, seconds = _alert.cross_modal_consistency, iter([0.001])

    def quick_at_first(*given: Any, **options: Any) -> Any:
        before = clock.now
        found = compare(*given, **options)
        clock.now = before + next(seconds, 0.08)
        return found

    monkeypatch.setattr(_alert, "cross_modal_consistency", quick_at_first)
    monitor = AlertMonitor(rig=RIG, budget_s=0.1, every_s=math.inf, clock=clock)
    waiting = {"left": PICTURE, "right": PICTURE, "speed_mps": 1.0, "waited_s": 0.05}
    late = [monitor.judge(FRAME, **waiting).is_late for _ in range(13)]
    assert late == [False, *[True] * 10, False, False]  # at last the cameras are left out


def test_pairs_take_turns_in_the_order_in_which_they_were_asked(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_at(monkeypatch, {0})
    rigs = {"front": RIG, "left": RIG, "rear": RIG}
    monitor = AlertMonitor(rig=rigs, budget_s=0.1, every_s=math.inf, clock=clock)
    pairs = dict.fromkeys(rigs, (PICTURE, PICTURE))
    first = monitor.judge(
        FRAME, pairs=dict.fromkeys(["front", "left"], (PICTURE, PICTURE)), speed_mps=1.0
    )
    assert "front: failed: pictures are torn" in first.witnesses["cross-modal"].reason
    monitor.judge(FRAME, pairs={"rear": (PICTURE, PICTURE)}, speed_mps=1.0)
    # Only one pair fits into 100 ms, and the one that failed was asked longest ago.
    reason = monitor.judge(FRAME, pairs=pairs, speed_mps=1.0).witnesses["cross-modal"].reason
    assert "(not asked: left, rear)" in reason


@pytest.mark.parametrize("background", [False, True])
def test_the_log_states_where_a_witness_failed(
    background: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def mistaken(*_: Any, **__: Any) -> Any:
        raise AttributeError("a mistake in the program")

    monkeypatch.setattr(_alert, "inspect", mistaken)
    caplog.set_level("DEBUG", "manip3d")
    monitor = AlertMonitor(background=background)
    monitor.judge(FRAME, speed_mps=1.0)
    monitor.finish()
    assert "in mistaken" in caplog.text
    assert "AttributeError: a mistake in the program" in caplog.text


def test_a_monitor_that_is_behind_verifies_the_watermark_alone(
    clock: Clock, tmp_path: Path
) -> None:
    with (
        KeyFile(key_file(tmp_path / "key")) as key,
        Watermarker(key) as sender,
        Watermarker(key) as receiver,
    ):
        monitor = AlertMonitor(receiver, rig=RIG, budget_s=0.1, clock=clock)
        for number, waited in enumerate((0.0, 0.3, 0.03, 0.01)):
            sent = sender.embed(LidarFrame(grid_scan(2000)))
            alert = monitor.judge(
                sent.frame, record=sent.record, left=PICTURE, right=PICTURE, speed_mps=1.0,
                time_s=number / 10, waited_s=waited,
            )  # fmt: skip
            cameras = "no_trace" if waited <= 0.02 else "skipped"  # they take 80 ms
            assert alert.witnesses["watermark"].verdict == "authentic"
            assert alert.witnesses["cross-modal"].verdict == cameras
            assert alert.is_late == (number in (0, 1))  # forensics, waiting
            assert alert.seconds >= waited
    for wrong in (-0.1, math.nan, math.inf):
        with pytest.raises(InputError, match="waited_s"):
            monitor.judge(FRAME, speed_mps=1.0, waited_s=wrong)


def test_a_stream_that_begins_again_is_asked_again(clock: Clock) -> None:
    monitor = AlertMonitor(rig=RIG, clock=clock)
    for time_s in (100.0, 100.1, 5.0):
        alert = monitor.judge(FRAME, speed_mps=0.0, time_s=time_s)
        expected = "skipped" if time_s == 100.1 else "no_trace"
        assert alert.witnesses["forensics"].verdict == expected
        assert alert.witnesses["cross-modal"].verdict == "absent"


def test_a_frame_without_a_time_follows_the_one_before(clock: Clock) -> None:
    """The clock began again at 0, as if another stream had begun."""
    monitor = AlertMonitor(rig=RIG, clock=clock)
    heard = [
        monitor.judge(FRAME, speed_mps=0.0, time_s=time_s).witnesses["forensics"].verdict
        for time_s in (100.0, None, 100.2, None)
    ]
    assert heard == ["no_trace", "skipped", "skipped", "skipped"]


def test_a_frame_left_out_is_counted_and_undecided() -> None:
    monitor = AlertMonitor()
    alert = monitor.skip()
    assert alert.verdict == "skipped"
    assert {told.verdict for told in alert.witnesses.values()} == {"skipped"}
    assert monitor.counts.verdicts == {"skipped": 1}
    assert verdict_of_alerts([alert])[0] == "undecidable"


@pytest.mark.parametrize(
    ("watermark", "cameras", "forensics", "has_key", "expected"),
    [
        ("authentic", "no_trace", "absent", True, "authentic"),
        ("authentic", "absent", "skipped", True, "authentic"),
        ("authentic", "tampered", "absent", True, "undecidable"),  # they err too often alone
        ("absent", "tampered", "no_trace", False, "undecidable"),
        ("absent", "tampered", "tampered", False, "tampered"),
        ("tampered", "no_trace", "no_trace", True, "tampered"),
        ("undecidable", "no_trace", "no_trace", True, "undecidable"),
        ("undecidable", "absent", "tampered", True, "tampered"),
        ("absent", "no_trace", "skipped", False, "no_trace"),
        ("absent", "no_trace", "processed", False, "no_trace"),
        ("absent", "undecidable", "no_trace", False, "no_trace"),
        ("absent", "undecidable", "skipped", False, "undecidable"),
        ("absent", "absent", "tampered", False, "tampered"),
        ("absent", "absent", "processed", False, "undecidable"),
        ("absent", "absent", "skipped", False, "undecidable"),
    ],
)
def test_one_verdict_of_three_witnesses(
    watermark: str, cameras: str, forensics: str, has_key: bool, expected: str
) -> None:
    told = {
        name: WitnessReport(verdict, verdict)
        for name, verdict in zip(WITNESSES, (watermark, cameras, forensics), strict=True)
    }
    assert joined(told, has_key=has_key)[0] == expected


def test_the_watermark_alone_clears_and_accuses(tmp_path: Path) -> None:
    with KeyFile(key_file(tmp_path / "key")) as key:
        sender, receiver = Watermarker(key), Watermarker(key)
        monitor = AlertMonitor(receiver)
        sent = [sender.embed(grid_scan(4000, seed=seed)) for seed in range(3)]
        alert = monitor.judge(sent[0].frame, record=sent[0].record, speed_mps=15.0)
        assert alert.verdict == "authentic"
        assert alert.risk.level == "none"
        assert alert.witnesses["forensics"].verdict == "undecidable"  # random points, no scanner
        points = sent[1].points.copy()
        points[7] += np.float32([0.5, 0, 0])
        forged = LidarFrame(points, sent[1].frame.intensity)
        alert = monitor.judge(forged, record=sent[1].record, speed_mps=15.0)
        assert alert.verdict == "tampered"
        assert alert.risk.level == "low"  # the first frame; f_s has no pair
        assert alert.attack == "modification"
        assert alert.boxes
        assert monitor.judge(sent[2].frame, speed_mps=15.0).verdict == "undecidable"  # no record
        text = json.dumps(alert.record())
        assert "tampered" in text
        assert key.key_id not in repr(monitor)


def test_a_false_alarm_of_the_cameras_hides_no_sector_and_lowers_no_risk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cameras accuse a far place to the side, the watermark all around the car."""
    far = Box((2.0, 30.0, 0.0), (1.0, 1.0, 1.0))
    seen = AttackObservation("rotation", (2.0, 30.0), 1, 1000)

    def compare(*_: Any, **__: Any) -> Any:
        return SimpleNamespace(verdict="tampered", reason="apart", observation=lambda **_: seen,
                               boxes=(far,), record=dict)  # fmt: skip

    monkeypatch.setattr(_alert, "stereo_disparity", lambda *_: None)
    monkeypatch.setattr(_alert, "cross_modal_consistency", compare)
    alerts = {}
    for pictures in (None, PICTURE):
        with KeyFile(key_file(tmp_path / f"key{pictures is None}")) as key:
            sender, receiver = Watermarker(key), Watermarker(key)
            monitor = AlertMonitor(receiver, rig=RIG, every_s=math.inf)
            for number in range(3):
                sent = sender.embed(grid_scan(4000, seed=number))
                forged = sent.frame.select(np.arange(100, 4000))
                # Cameras err in the middle frame only: the place they name must not break the line.
                shown = pictures if number == 1 else None
                alert = monitor.judge(
                    forged, record=sent.record, left=shown, right=shown, speed_mps=10.0
                )
                alerts[pictures is None, number] = alert
    for number in range(3):
        assert alerts[False, number].risk == alerts[True, number].risk
    quiet, loud = alerts[True, 1], alerts[False, 1]
    assert quiet.risk.score > 0.0
    assert loud.boxes[0] == far
    assert len(loud.boxes) == 1 + len(quiet.boxes) > 1
    assert (quiet.attack, loud.attack) == ("modification", "rotation")


def alert_of(watermark: str, cameras: str, forensics: str = "skipped") -> Alert:
    told = {
        name: WitnessReport(verdict, f"{name} says {verdict}")
        for name, verdict in zip(WITNESSES, (watermark, cameras, forensics), strict=True)
    }
    verdict, reason = joined(told, has_key=watermark != "absent")
    return replace(AlertMonitor().skip(), verdict=verdict, reason=reason, witnesses=told)


@pytest.mark.parametrize(("frames", "chance", "doubted"), [(154, 4, 5), (1540, 22, 23), (10, 1, 2)])
def test_cameras_doubt_a_drive_where_they_accuse_more_frames_than_by_chance(
    frames: int, chance: int, doubted: int
) -> None:
    """For 154 clean frames at 1 of 120: five or more in 0.96 % of drives, one or more in 72 %."""

    def verdict_of(accused: int, watermark: str) -> tuple[str, str]:
        alerts = [alert_of(watermark, "tampered" if n < accused else "no_trace")
                  for n in range(frames)]  # fmt: skip
        assert sum(alert.verdict == "undecidable" for alert in alerts) == accused
        return verdict_of_alerts(alerts, whole=False)

    for watermark, calm in (("authentic", "authentic"), ("absent", "no_trace")):
        assert verdict_of(0, watermark)[0] == calm
        verdict, reason = verdict_of(chance, watermark)
        assert verdict == calm
        assert f"cameras accuse {chance} of {frames} frames, not more than by chance" in reason
        verdict, reason = verdict_of(doubted, watermark)
        assert verdict == "undecidable"
        assert "more than by chance" in reason
        assert "not more" not in reason


@pytest.mark.parametrize(("number", "told"), [(1, "(1 frame)"), (2, "(2 frames)")])
def test_a_quiet_drive_states_its_frames(number: int, told: str) -> None:
    assert verdict_of_alerts([alert_of("absent", "no_trace")] * number)[1].endswith(told)


def test_chance_excuses_the_cameras_only() -> None:
    calm = [alert_of("authentic", "no_trace")] * 200
    for other, verdict in (
        (alert_of("undecidable", "tampered"), "undecidable"),
        (alert_of("tampered", "tampered"), "tampered"),
        (alert_of("authentic", "tampered", "tampered"), "tampered"),
        (alert_of("authentic", "tampered"), "authentic"),
        (alert_of("authentic", "absent"), "authentic"),
    ):
        assert verdict_of_alerts([*calm, other], whole=False)[0] == verdict
    unheard = [alert_of("authentic", "absent")] * 1000  # frames that cameras did not judge
    some = [alert_of("authentic", "tampered")] * 3
    assert verdict_of_alerts([*unheard, *some], whole=False)[0] == "undecidable"


def test_a_drive_that_was_cut_is_not_authentic(tmp_path: Path) -> None:
    with KeyFile(key_file(tmp_path / "key")) as key:
        sender = Watermarker(key)
        sent = [sender.embed(grid_scan(2000, seed=n), is_end=n == 2) for n in range(3)]
        monitor = AlertMonitor(Watermarker(key))
        alerts = [
            monitor.judge(each.frame, record=each.record, speed_mps=1.0).brief() for each in sent
        ]
    assert all(alert.watermark is not None and alert.watermark.scan is None for alert in alerts)
    assert verdict_of_alerts(alerts)[0] == "authentic"
    verdict, reason = verdict_of_alerts(alerts[:2])
    assert verdict == "undecidable"
    assert "end are missing" in reason
    assert verdict_of_alerts(alerts[:2], whole=False)[0] == "authentic"


def test_every_verdict_on_a_drive_wants_a_whole_one_unless_told_otherwise() -> None:
    for judge in (verdict_of_stream, verdict_of_alerts, AlertTally.verdict, watch_drive):
        assert inspect.signature(judge).parameters["whole"].default is True


def test_an_error_of_the_caller_is_no_verdict_on_the_drive() -> None:
    def fails(alert: Alert) -> None:
        if alert.number == 1:
            raise OSError(28, "No space left on device")

    def interrupts(alert: Alert) -> None:
        if alert.number == 1:
            raise KeyboardInterrupt

    drive = [DriveMoment(FRAME)] * 3
    with pytest.raises(OSError, match="No space left"):
        watch_drive(AlertMonitor(), drive, show=fails)
    watched = watch_drive(AlertMonitor(), drive, show=interrupts)
    assert (watched.num_frames, watched.reason) == (2, "ended after 2 frames: it was interrupted")


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_forensics_in_the_background_have_their_say_when_the_view_fails(
    monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    go_on = threading.Event()

    def look(frame: LidarFrame, **_: Any) -> Any:
        assert go_on.wait(30)
        return SimpleNamespace(verdict="tampered", reason="a hole", regions=(), scan=None)

    def fails(alert: Alert) -> None:
        go_on.set()
        raise error

    monkeypatch.setattr(_alert, "inspect", look)
    monitor = AlertMonitor(background=True)
    if error is KeyboardInterrupt:
        watched = watch_drive(monitor, [DriveMoment(FRAME)], show=fails)
        assert watched.verdict == "tampered"
        assert watched.reason == (
            "forensics: frame 0: a hole; ended after 1 frame: it was interrupted"
        )
    else:
        with pytest.raises(error):
            watch_drive(monitor, [DriveMoment(FRAME)], show=fails)
    assert monitor.finish() is None


def test_an_interruption_while_forensics_end_hides_no_error_of_the_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(self: AlertMonitor) -> None:
        raise KeyboardInterrupt

    def fails(alert: Alert) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(AlertMonitor, "finish", interrupted)
    with pytest.raises(OSError, match="No space left"):
        watch_drive(AlertMonitor(), [DriveMoment(FRAME)], show=fails)
    watched = watch_drive(AlertMonitor(), [DriveMoment(FRAME)])
    assert isinstance(watched.stopped, KeyboardInterrupt)


def test_forensics_take_a_verified_watermark_for_no_edit(tmp_path: Path) -> None:
    """A scanner on a lattice, whose points the embedding moved off it."""
    points = lattice_scans.scan(np.random.default_rng(0)).astype(np.float64)
    scan = LidarFrame(np.float32(np.round(1000.0 * points) / 1000.0))
    with KeyFile(key_file(tmp_path / "key")) as key:
        sent = Watermarker(key).embed(scan)
        alert = AlertMonitor(Watermarker(key)).judge(sent.frame, record=sent.record, speed_mps=10.0)
        assert alert.verdict == "authentic"
        assert alert.witnesses["forensics"].verdict in ("no_trace", "undecidable", "processed")


def test_a_region_behind_hides_none_ahead_from_the_risk_of_forensics() -> None:
    ahead, behind = (Box((x, 0.0, 0.0), (2.0, 2.0, 1.0)) for x in (9.0, -6.0))
    scan = LidarFrame(np.array([[8.5, 0.0, 0.0], [-5.5, 0.0, 0.0], [9.0, 5.0, 0.0]], np.float32))
    places = []
    for boxes in ([ahead], [ahead, behind]):
        regions = [SimpleNamespace(box=box, rows=[row]) for row, box in enumerate(boxes)]
        found: Any = SimpleNamespace(verdict="tampered", regions=regions, scan=scan)
        (observed,) = attack_observations(None, None, found, 14.0, RiskParameters())
        assert (observed.changed, observed.cells) == (1, 2)
        places.append(observed.position)
    assert places == [(8.0, 0.0), (8.0, 0.0)]  # the nearest point of the box


def test_forensics_alone_accuse_no_clean_scan() -> None:
    """A clean scan on a known lattice is not accused; a scan with a pasted object is."""
    scan = lattice_scans.scan(np.random.default_rng(0))
    alert = AlertMonitor().judge(LidarFrame(scan), speed_mps=10.0)
    assert alert.verdict in ("no_trace", "undecidable")
    assert alert.forensics is not None
    box = np.random.default_rng(1).uniform((8.0, -1.0, -1.5), (10.0, 1.0, 0.0), (800, 3))
    pasted = np.concatenate([scan, box.astype(np.float32)])
    assert AlertMonitor().judge(LidarFrame(pasted), speed_mps=10.0).verdict == "tampered"


@pytest.mark.parametrize(
    ("begin", "end", "expected"),
    [(0, 10, 0.0), (350, 360, 0.0), (-10, 10, 0.0), (20, 30, 20.0), (330, 350, 10), (90, 180, 90)],
)  # fmt: skip
def test_how_far_a_sector_is_from_ahead(begin: float, end: float, expected: float) -> None:
    assert math.degrees(_to_ahead(begin, end)) == pytest.approx(expected, abs=1e-9)


def test_a_frame_that_was_left_out_moves_the_car_all_the_same(tmp_path: Path) -> None:
    """Places of attacks are compared across frames that were left out."""
    motions = ((1.0, 0.0, 0.4), (2.0, 0.5, 0.3))
    spaces = []
    for left_out in (None, "skip", "unread"):
        with KeyFile(key_file(tmp_path / f"key {left_out}")) as key:
            sender, monitor = Watermarker(key), AlertMonitor(Watermarker(key), every_s=math.inf)
            for number, motion in enumerate([(0.0, 0.0, 0.0), *motions]):
                sent = sender.embed(grid_scan(3000, seed=number))
                if number == 1 and left_out == "skip":
                    monitor.skip(motion=motion)
                elif number == 1 and left_out == "unread":
                    monitor.judge_unread("torn", record=sent.record, motion=motion)
                elif left_out is not None or number != 1:
                    moved = sent.frame.select(np.arange(50, 3000))
                    if left_out is None and number == 2:  # both steps by hand
                        (a, b, t), (c, d, u) = motions
                        motion = (a + c * math.cos(t) - d * math.sin(t),
                                  b + c * math.sin(t) + d * math.cos(t), t + u)  # fmt: skip
                    alert = monitor.judge(moved, record=sent.record, speed_mps=10.0, motion=motion)
            spaces.append(alert.risk.factors["space"])
            assert monitor._risk._pose == pytest.approx((2.647413, 1.239367, 0.7), abs=1e-6)
    assert spaces[0] == spaces[1] == spaces[2] < 1.0


def test_alerts_name_the_scan_or_its_time() -> None:
    named, timed, unread = DriveMoment(FRAME, name="0012"), DriveMoment(FRAME, time_s=0.25), "gone"
    moments = [named, timed, DriveMoment(FRAME), DriveMoment(unread, name="0015", time_s=1.0)]
    alerts: list[Alert] = []
    watch_drive(AlertMonitor(), moments, show=alerts.append)
    assert [alert.record()["scan"] for alert in alerts] == ["0012", "0.250 s", "", "0015"]
    assert alerts[0].brief().scan == "0012"


def test_a_velocity_that_is_no_number_is_an_unknown_motion() -> None:
    moments = [
        DriveMoment(FRAME, velocity=velocity, time_s=float(number))
        for number, velocity in enumerate([(1.0, 0.0, 0.0), (math.nan, 0.0, 0.0), (1.0, 0.0, 0.0)])
    ]
    monitor = AlertMonitor(every_s=math.inf)
    watched = watch_drive(monitor, moments)
    assert (watched.num_frames, watched.stopped) == (3, None)
    assert watched.reason.endswith(
        "; frame 1: its time or speed is wrong, the motion counts as unknown"
    )
    assert monitor._risk._pose == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "times",
    [
        (0.0, 0.1, None, 0.3, 0.4),
        (None, None, 7.0, 7.1, 7.2),
        (None,) * 5,
        (3.0, None, None, None, None),
        (0.0, 0.1, 50.0, 0.3, 0.4),
        (0.0, 0.1, -50.0, 0.3, 0.4),
        (0.0, 0.2, 0.1, 0.3, 0.4),
    ],
)
def test_the_motion_is_that_of_the_time_since_the_first_moment(
    times: tuple[float | None, ...],
) -> None:
    monitor = AlertMonitor(every_s=math.inf)
    moments = [DriveMoment(FRAME, velocity=(10.0, 0.0, 0.0), time_s=time_s) for time_s in times]
    watch_drive(monitor, moments)
    assert monitor._risk._pose == pytest.approx((4.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("times", "waits"),
    [
        ((1.3e9, 1.3e9 + 0.5), [0.5]),
        ((None, 1.3e9, 1.3e9 + 0.5), [0.1, 0.5]),
        ((0.0, 1e300, 0.2, 0.3), [10.0, 0.1]),
        ((1e300, 0.1, 0.2), [0.1]),
        ((0.0, 0.2, 0.1, 0.3), [0.2, 0.1]),
        ((0.0, -1.7e308, 1.7e308, 0.1), [10.0]),
    ],
)
def test_a_drive_that_is_played_waits_for_the_next_moment_only(
    monkeypatch: pytest.MonkeyPatch, times: tuple[float | None, ...], waits: list[float]
) -> None:
    """One wrong time made it wait for years, and left out all moments after it."""
    slept: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: sum(slept), sleep=slept.append)
    monkeypatch.setattr(_watch, "time", clock)
    alerts: list[Alert] = []
    moments = [DriveMoment(FRAME, time_s=time_s) for time_s in times]
    watch_drive(AlertMonitor(every_s=math.inf), moments, live=True, show=alerts.append)
    assert slept == pytest.approx(waits)
    assert "skipped" not in [alert.verdict for alert in alerts]


@pytest.mark.parametrize("live", [False, True])
def test_a_time_that_is_not_finite_ends_the_drive(*, live: bool) -> None:
    moments = [DriveMoment("torn", time_s=0.0), DriveMoment("torn", time_s=math.inf)]
    watched = watch_drive(AlertMonitor(every_s=math.inf), moments, live=live)
    assert (watched.verdict, watched.num_frames) == ("undecidable", 1)
    assert watched.reason.endswith("moments: expected finite times, got inf")
    with pytest.raises(InputError, match="moments: expected finite times"):
        watch_drive(AlertMonitor(every_s=math.inf), moments[1:], live=live)


def test_long_motions_over_frames_that_were_left_out_are_unknown_together(tmp_path: Path) -> None:
    """The next frame is judged, and is not refused after the watermark has seen it."""
    with KeyFile(key_file(tmp_path / "key")) as key:
        sent = Watermarker(key).embed(grid_scan(3000))
        monitor = AlertMonitor(Watermarker(key), every_s=math.inf)
        for _ in range(2):
            monitor.skip(motion=(9e5, 0.0, 0.0))
        alert = monitor.judge(sent.frame, record=sent.record, speed_mps=10.0)
    assert alert.verdict == "authentic"
    assert monitor._risk._pose == (0.0, 0.0, 0.0)


def test_the_page_shows_a_late_attack_and_lists_it_first(tmp_path: Path) -> None:
    """Many changes of verdict and 300 doubtful frames come before it."""
    seen = AlertMonitor().judge(LidarFrame(grid_scan(500)), speed_mps=1.0)
    with KeyFile(key_file(tmp_path / "key")) as key:
        sent = Watermarker(key).embed(grid_scan(2000))
        found = Watermarker(key).verify(sent.frame, sent.record)
    timeline = AlertTimeline("drive", risk=RiskParameters(low=0.25, high=0.55))
    for number in range(400):
        verdict = "undecidable" if number % 7 == 6 or 50 < number < 360 else "authentic"
        verdict = "tampered" if number in (390, 391) else verdict
        timeline.add(
            replace(seen, number=number, verdict=verdict, reason=f"why {number}", watermark=found)
        )
    page = tmp_path / "page.html"
    timeline.write(page, verdict="tampered", reason="r", counts=AlertMonitor().counts)
    text = page.read_text()
    shown = [int(n) for n in re.findall(r"<h3>Frame ([0-9]+):", text)]
    assert len(shown) == 12
    assert {390, 391} < set(shown)
    assert shown == sorted(shown)
    rows = [int(n) for n in re.findall(r"<tr><td>([0-9]+)</td>", text)]
    assert rows[:4] == [390, 391, 6, 13]
    first, count = timeline.gravest(3)
    assert [record["frame"] for record in first] == [390, 391, 6]
    assert f"and {count - 200} more" in text
    assert count == sum(record["verdict"] != "authentic" for record in timeline.records)
    assert "lines at 0.25 (medium) and 0.55 (high)" in text
    assert [record["frame"] for record in timeline.records] == list(range(400))


def test_the_page_of_a_drive_without_frames_says_so(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    counts = AlertMonitor().counts
    AlertTimeline("drive").write(page, verdict="undecidable", reason="r", counts=counts)
    assert "<span>no frames; lines at" in page.read_text()


def test_a_view_from_above_has_at_most_2500_points(tmp_path: Path) -> None:
    scan = LidarFrame(np.linspace((2, -4, 0), (9, 4, 1), 4999, dtype=np.float32))
    with KeyFile(key_file(tmp_path / "key")) as key:
        monitor = AlertMonitor(Watermarker(key), every_s=math.inf)
        timeline = AlertTimeline("drive")
        timeline.add(monitor.judge(scan, speed_mps=1.0))
    page = tmp_path / "page.html"
    timeline.write(page, verdict="undecidable", reason="r", counts=monitor.counts)
    assert page.read_text().count("h.01") == 2500


def test_a_long_drive_keeps_few_bytes_of_a_frame(tmp_path: Path) -> None:
    """Memory grows by less than 300 bytes per frame, since alerts and records go to files.

    Alerts in memory took 3.3 kB per frame, alerts and records 9 kB.
    """
    tally, timeline = AlertTally(), AlertTimeline("drive")
    kept = []
    with KeyFile(key_file(tmp_path / "key")) as key:
        monitor = AlertMonitor(Watermarker(key), every_s=math.inf)
        sender = Watermarker(key)
        scan = grid_scan(2000)
        for number in range(201):
            if number == 20:
                tracemalloc.start()
            sent = sender.embed(scan)
            alert = monitor.judge(sent.frame, record=sent.record, speed_mps=1.0)
            assert not alert.brief().watermark.tiles  # type: ignore[union-attr]
            timeline.add(alert)
            tally.add(alert)
            del alert
            if number in (100, 200):
                gc.collect()
                kept.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert tally.verdict(whole=False)[0] == "authentic"
    assert kept[1] - kept[0] < 100 * 300  # bytes; the risk looks back at most 720 frames


def test_the_page_of_a_long_quiet_drive_is_short(tmp_path: Path) -> None:
    timeline, monitor = AlertTimeline("drive"), AlertMonitor()
    sizes = []
    for count in (1, 2000):
        for _ in range(count):
            timeline.add(monitor.skip("too late"))
        page = tmp_path / "page.html"
        timeline.write(page, verdict="undecidable", reason="late", counts=monitor.counts)
        sizes.append(len(page.read_text().split("Frames to look at")[0]))
    assert sizes[1] < sizes[0] + 100
    assert "frame 0 to 2000" in page.read_text()


def test_a_tally_says_what_all_alerts_together_say(tmp_path: Path) -> None:
    with KeyFile(key_file(tmp_path / "key")) as key:
        sender, monitor = Watermarker(key), AlertMonitor(Watermarker(key), every_s=math.inf)
        sent = [sender.embed(grid_scan(2000, seed=n), is_end=n == 3) for n in range(4)]
        alerts = [monitor.judge(s.frame, record=s.record, speed_mps=1.0) for s in (*sent, sent[1])]
    expected = ["undecidable", "undecidable", "undecidable", "authentic", "tampered"]
    reasons = ["end are missing"] * 3 + ["(4 frames)", "seen before"]
    tally = AlertTally()
    with pytest.raises(InputError, match="at least one"):
        tally.verdict()
    for count, alert in enumerate(alerts, 1):
        tally.add(alert.brief())
        assert tally.verdict(whole=True) == verdict_of_alerts(alerts[:count], whole=True)
        assert tally.verdict(whole=True)[0] == expected[count - 1]
        assert reasons[count - 1] in tally.verdict(whole=True)[1]
    assert tally.num_frames == 5


def test_bad_input_is_named() -> None:
    for arguments, words in (
        ({"left": PICTURE}, "left, right: expected both"),
        ({"time_s": math.nan}, "time_s: expected a finite number"),
        ({"speed_mps": -1.0}, "speed_mps: expected a number >= 0"),
        ({"unread": {"watermark": "torn"}}, "unread: expected cross-modal, got 'watermark'"),
    ):
        with pytest.raises(InputError, match=words):
            AlertMonitor(rig=RIG).judge(FRAME, **{"speed_mps": 1.0, **arguments})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="budget_s: expected a number > 0"):
        AlertMonitor(budget_s=0.0)
    for leave_out in (AlertMonitor().skip, AlertMonitor().judge_unread):
        with pytest.raises(InputError, match="motion: expected finite numbers"):
            leave_out("torn", motion=(0.0, 0.0, math.nan))
    with pytest.raises(InputError, match="every_s: expected a number > 0"):
        AlertMonitor(every_s=math.nan)
    with pytest.raises(InputError, match="alerts: expected at least one"):
        verdict_of_alerts([])
