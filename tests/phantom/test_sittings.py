"""Sittings: their end, the record that is kept, and the rules on the next day."""

from __future__ import annotations

import errno
import functools
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

import capsule_body
from frame_reader import read_frame
from manip3d.errors import InputError
from manip3d.phantom import LiveSession, _sitting
from manip3d.phantom import _diary as _recorder
from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._touch import SECONDS
from manip3d.rgbd import RgbdFrame
from waiting import wait_for

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")

from manip3d.diary import Diary
from manip3d.diary._rows import DiaryTransaction
from manip3d.phantom._diary import RATE_FIRST, DiaryRecorder

FELT = {"length": 60, "telescoping": 10, "raised": 0, "bent": 20}
ANSWERS = {f"q{number}": 1 for number in range(1, 7)}


@functools.cache
def painted(number: int) -> RgbdFrame:
    return capsule_body.painted(number)


class Sitting:
    """A session of P01 that runs frame by frame with a clock of its own."""

    def __init__(self, path: Path, patch: pytest.MonkeyPatch) -> None:
        self.path = path
        self.now = datetime(2026, 3, 2, 9, 0).astimezone()
        for module in (_sitting, _recorder):
            patch.setattr(module, "local_now", lambda: self.now)
        self.number = 0
        if not path.exists():
            with Diary(path, create=True) as diary:
                diary.enrol("P01", limb="right_arm")
        self.open()

    def open(self) -> None:
        self.recorder = DiaryRecorder(self.path, "P01", None)
        self.session = LiveSession("right_arm", recorder=self.recorder)
        self.recorder.start()

    def say(self, name: str, **fields: Any) -> dict[str, Any]:
        """Send a command; return the status that the page shows afterwards."""
        self.session.command(name, fields)
        return self.show(2)

    def show(self, count: int = 1) -> dict[str, Any]:
        status: dict[str, Any] = {}
        for _ in range(count):
            self.number += 1
            frame = painted(self.number % 40)
            frame = replace(frame, time_ns=self.number * 33_333_333, number=self.number)
            message = self.session.process(frame, captured_ns=1)
            assert message is not None
            status = read_frame(message).status
        return status

    def end(self) -> Diary:
        self.session.end()
        assert self.recorder.end() == []
        return Diary(self.path)


@pytest.fixture
def sitting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Sitting]:
    found = Sitting(tmp_path / "study.diary", monkeypatch)
    yield found
    found.recorder.end()


def test_what_was_said_after_the_last_frame_is_kept(sitting: Sitting) -> None:
    sitting.say("pain", value=2)
    sitting.now += timedelta(minutes=1)
    done: list[str] = []
    for name, fields in (
        ("event", {"text": "a chair fell over"}), ("ready", {}), ("touch", {"mode": "synchronous"}),
        ("felt", FELT), ("ownership", {"mode": "synchronous", **ANSWERS}), ("pain", {"value": 3}),
    ):  # fmt: skip
        sitting.session.command(name, fields, done=lambda name=name: done.append(name))  # type: ignore[misc]
    sitting.session.end()
    sitting.session.command("event", {"text": "too late"}, done=lambda: done.append("late"))
    with sitting.end() as diary:
        assert [(e.kind, e.text) for e in diary.events("P01")] == [("other", "a chair fell over")]
        assert [rating.pain for rating in diary.ratings("P01")] == [2, 3]
        assert {rating.when for rating in diary.ratings("P01")} == {"before"}  # nothing began
        assert [felt.length for felt in diary.felt("P01")] == [60]
        assert len(diary.ownership("P01")) == 1
        (session,) = diary.sessions("P01")
        assert not session.games
    assert done == ["event", "felt", "ownership", "pain"]


def test_heard_is_answered_when_it_is_on_the_disk(
    sitting: Sitting, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[int] = []
    failures = [OSError("disk full")]
    add = sitting.recorder._diary.add_event

    def fails_once(*values: Any, **options: Any) -> None:
        if failures:
            raise failures.pop()
        assert done == []
        add(*values, **options)

    monkeypatch.setattr(sitting.recorder._diary, "add_event", fails_once)
    monkeypatch.setattr("manip3d.phantom._writer._AGAIN_S", 3.0)
    fields = {"text": "dizzy", "page": 1, "number": 1}
    sitting.session.command("event", fields, done=lambda: done.append(1))
    sitting.show()
    sitting.session.command("event", fields, done=lambda: done.append(2))  # the page says it again
    sitting.show()
    assert done == []
    end = time.monotonic() + 30.0  # until the thread that writes had its turn
    while "Not kept in the diary yet: 1 entry" not in sitting.show()["message"]:
        assert time.monotonic() < end
    with sitting.end() as diary:
        assert len(diary.events("P01")) == 1
    assert done == [1, 2]


def lose(path: Path) -> None:
    """Delete the participant without the lock of the session, so that its entries are refused."""
    with Diary(path) as other, other._file.begin() as rows:
        rows.delete(rows.find("P01"))


def test_what_is_lost_is_never_said_to_be_kept(sitting: Sitting) -> None:
    done: list[int] = []
    lose(sitting.path)
    sitting.session.command("event", {"text": "dizzy"}, done=lambda: done.append(1))
    sitting.show()
    sitting.session.end()
    assert any("dizzy" in one for one in sitting.recorder.end())
    assert done == []


def test_what_is_lost_is_not_kept_when_it_is_said_again(sitting: Sitting) -> None:
    done: list[str] = []

    def said(name: str, number: int, **fields: Any) -> None:
        """Send a command twice, as if the first connection was lost."""
        for _ in range(2):
            fields |= {"page": 1, "number": number}
            sitting.session.command(name, fields, done=lambda: done.append(f"{name} {number}"))
            sitting.show()

    def is_written() -> bool:
        assert sitting.recorder._writer is not None
        return sitting.recorder._writer.is_idle

    said("event", 1, text="dizzy")
    wait_for(is_written)
    said("event", 1, text="dizzy")  # kept long ago
    assert done == ["event 1"] * 4
    lose(sitting.path)
    said("event", 2, text="a fall")
    wait_for(is_written)
    said("event", 2, text="a fall")
    said("enough", 3)  # of which nothing is to be written
    assert done[4:] == ["enough 3"] * 2
    assert any("a fall" in one for one in sitting.recorder.end())
    assert done[6:] == []


def test_no_touch_cue_before_a_rating(sitting: Sitting) -> None:
    """A touch cue waits for a rating, so that the rating after it can be compared."""
    status = sitting.say("touch", mode="synchronous")
    assert (status["touch"], status["game"]["ask"]) == (None, RATE_FIRST)
    sitting.say("pain", value=3)
    assert sitting.say("touch", mode="synchronous")["touch"] is not None
    sitting.now += timedelta(minutes=1)
    sitting.say("pain", value=4)
    with sitting.end() as diary:
        assert [rating.when for rating in diary.ratings("P01")] == ["before", "after"]


def test_stop_ends_a_touch_cue_but_not_its_questions(sitting: Sitting) -> None:
    sitting.say("pain", value=3)
    assert sitting.say("touch", mode="synchronous")["touch"]["left_s"] > 50
    assert sitting.say("stop")["touch"] is None
    sitting.say("touch", mode="asynchronous")
    assert sitting.session._cue is not None
    sitting.session._cue.clock = SECONDS
    assert sitting.say("stop")["touch"]["left_s"] == 0
    assert sitting.say("ownership", mode="asynchronous", **ANSWERS)["touch"] is None


def test_two_sittings_of_a_day_are_two_sessions(sitting: Sitting) -> None:
    for pain in (3, 5):  # the second sitting is compared with its own first rating
        sitting.say("pain", value=pain)
        assert sitting.say("ready")["game"]["phase"] == "playing"
        status = sitting.say("enough")["game"]
        assert (status["phase"], status["sitting"]) == ("over", "ending")
        sitting.now += timedelta(minutes=1)
        status = sitting.say("pain", value=pain - 1)["game"]
        assert (status["sitting"], status["halt"]) == ("over", "")
        ended = sitting.now
        sitting.now += timedelta(hours=5)
        assert sitting.say("ready")["game"]["phase"] == "over"
        assert sitting.say("touch", mode="synchronous")["touch"] is None
        assert sitting.say("again")["game"]["sitting"] == "open"
        status = sitting.say("ready")["game"]
        assert (status["phase"], status["ask"]) == ("waiting", RATE_FIRST)
    with sitting.end() as diary:
        first, second, empty = diary.sessions("P01")
        assert [len(one.games) for one in (first, second, empty)] == [1, 1, 0]
        assert [(one.pain_before, one.pain_after) for one in (first, second)] == [(3, 2), (5, 4)]
        assert second.ended == ended
        assert first.ended == second.started - timedelta(hours=5)


def test_the_closing_rating_cannot_be_left_out(sitting: Sitting) -> None:
    """Pain that rose during play is rated in its own session, and stops the next one."""
    sitting.say("pain", value=3)
    sitting.say("ready")
    assert sitting.say("enough")["game"]["sitting"] == "ending"
    assert sitting.say("again")["game"]["sitting"] == "ending"
    status = sitting.say("pain", value=6)["game"]
    assert status["sitting"] == "over"
    assert "rose from 3 to 6" in status["halt"]
    sitting.now += timedelta(minutes=1)
    sitting.say("again")
    sitting.say("pain", value=6)
    status = sitting.say("ready")["game"]
    assert (status["phase"], "rose from 3" in status["halt"]) == ("waiting", True)
    with sitting.end() as diary:
        first, second = diary.sessions("P01")
        assert (first.pain_before, first.pain_after, second.games) == (3, 6, ())


def test_a_therapist_closes_a_session_without_a_rating(sitting: Sitting) -> None:
    """After that, the stop rule still compares with the first rating of the closed sitting."""
    assert sitting.say("unanswered")["game"]["sitting"] == "open"  # nothing was asked yet
    sitting.say("pain", value=3)
    sitting.say("ready")
    sitting.say("enough")
    assert sitting.say("unanswered")["game"]["sitting"] == "over"
    sitting.now += timedelta(minutes=5)
    assert sitting.say("again")["game"]["sitting"] == "open"
    status = sitting.say("ready")["game"]
    assert (status["phase"], status["ask"]) == ("waiting", RATE_FIRST)
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]
    with sitting.end() as diary:
        first, second = diary.sessions("P01")
        assert (first.answered, first.pain_after, second.answered) == (False, None, True)
        assert first.ended == second.started - timedelta(minutes=5)
        assert [event.kind for event in diary.events("P01")] == ["pain"]


def test_a_program_that_ends_while_it_asks_got_no_answer(sitting: Sitting) -> None:
    """After restarts, pain is compared with the first rating of the unanswered session."""
    sitting.say("pain", value=3)
    sitting.say("ready")
    sitting.say("enough")  # and Ctrl-C
    for _ in range(2):
        sitting.end().close()
        sitting.now += timedelta(minutes=5)
        sitting.open()
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]
    with sitting.end() as diary:
        assert [session.answered for session in diary.sessions("P01")] == [False, True, True]
        assert [event.kind for event in diary.events("P01")] == ["pain"]


def test_who_did_not_answer_has_not_answered_on_the_next_day(sitting: Sitting) -> None:
    sitting.say("pain", value=3)
    sitting.say("enough")
    sitting.now += timedelta(days=1)
    assert sitting.say("pain", value=6)["game"]["halt"] == ""
    with sitting.end() as diary:
        assert [session.answered for session in diary.sessions("P01")] == [False, True]


def test_a_restart_compares_with_what_was_not_answered_today_only(sitting: Sitting) -> None:
    sitting.say("pain", value=3)
    sitting.say("enough")
    sitting.end().close()
    sitting.now += timedelta(days=1)
    sitting.open()
    assert sitting.say("pain", value=6)["game"]["halt"] == ""
    sitting.say("enough")
    sitting.say("pain", value=6)  # answered: the next sitting begins with a rating of its own
    sitting.end().close()
    sitting.open()
    assert sitting.say("pain", value=8)["game"]["halt"] == ""


@pytest.mark.parametrize("starts_again", [False, True])
def test_midnight_does_not_switch_the_stop_rule_off(sitting: Sitting, starts_again: bool) -> None:
    """Pain after midnight is compared with the first rating, if the closing one is missing."""
    sitting.now = sitting.now.replace(hour=22, minute=40)
    sitting.say("pain", value=3)
    sitting.now += timedelta(minutes=70)
    sitting.say("enough")
    sitting.now += timedelta(minutes=1)
    sitting.say("unanswered")
    sitting.now += timedelta(minutes=20)  # eleven past midnight
    if starts_again:
        sitting.end().close()
        sitting.open()
    else:
        sitting.say("again")
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]


AHEAD = timedelta(days=200)  # error of the computer's clock


def hold_with_a_clock_ahead(sitting: Sitting, *last: str) -> None:
    """A sitting with a first rating of 3, within which the clock is set right."""
    sitting.end().close()
    sitting.now += AHEAD
    sitting.open()
    sitting.say("pain", value=3)
    sitting.say("enough")
    sitting.now += timedelta(minutes=5) - AHEAD
    for name in last:
        sitting.say(name, value=3)
    sitting.end().close()


@pytest.mark.parametrize(
    ("later", "halt"), [(timedelta(minutes=5), "rose from 3 to 6"), (timedelta(days=4), "")]
)
def test_a_clock_that_was_ahead_neither_ends_nor_pins_the_stop_rule(
    sitting: Sitting, later: timedelta, halt: str
) -> None:
    hold_with_a_clock_ahead(sitting, "unanswered")
    sitting.now += later
    sitting.open()
    assert sitting.say("pain", value=6)["game"]["halt"][9:25] == halt
    with sitting.end() as diary:
        ahead = diary.sessions("P01")[-1]
        assert ahead.clock_went_back
        assert ahead.clock_at_end == sitting.now - later


def test_a_clock_that_was_ahead_ends_no_later_comparison(sitting: Sitting) -> None:
    """A sitting dated in the future was closed before today's, whose last rating is missing."""
    hold_with_a_clock_ahead(sitting, "pain")
    sitting.now += timedelta(minutes=5)
    sitting.open()
    sitting.say("pain", value=2)
    sitting.say("enough")
    sitting.end().close()
    sitting.now += timedelta(minutes=5)
    sitting.open()
    assert "rose from 2 to 6" in sitting.say("pain", value=6)["game"]["halt"]


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_program_that_stops_in_a_game_does_not_switch_the_stop_rule_off(
    sitting: Sitting, is_killed: bool
) -> None:
    """After an end in a game without a rating, the next start compares with the first rating."""
    sitting.say("pain", value=3)
    assert sitting.say("ready")["game"]["phase"] == "playing"
    wait_for(lambda: sitting.recorder._diary.sessions("P01")[0].begun is not None)
    if is_killed:
        sitting.recorder._is_open = False  # nothing more is written of the sitting
    sitting.end().close()
    sitting.now += timedelta(minutes=5)
    sitting.open()
    assert sitting.say("pain", value=4)["game"]["halt"] == ""
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]
    with sitting.end() as diary:
        assert [event.kind for event in diary.events("P01")] == ["pain"]


def test_a_program_that_stops_before_any_game_leaves_nothing_to_compare_with(
    sitting: Sitting,
) -> None:
    sitting.say("pain", value=3)
    sitting.end().close()
    sitting.open()
    assert sitting.say("pain", value=6)["game"]["halt"] == ""


def test_nobody_is_deleted_during_their_live_session(sitting: Sitting) -> None:
    """Between two entries the session does not have the file open."""
    sitting.say("pain", value=3)
    with Diary(sitting.path) as diary:
        diary.enrol("P02")
        with pytest.raises(InputError, match="participant: P01 has a session open in another"):
            diary.delete("P01")
        diary.delete("P02")
        assert [one.identifier for one in diary.participants()] == ["P01"]
        sitting.end().close()
        diary.delete("P01")
        assert diary.participants() == []
    assert list(sitting.path.parent.glob(".*.lock")) == []


def test_a_participant_has_one_live_session_at_a_time(sitting: Sitting) -> None:
    """A second session is refused, since it would not know the ratings of the first."""
    sitting.say("pain", value=3)
    with Diary(sitting.path) as diary:
        diary.enrol("P02")
    link = sitting.path.with_name("link.diary")
    link.symlink_to(sitting.path)
    for path in (sitting.path, link):
        with pytest.raises(InputError, match="participant: P01 has a session open in another"):
            DiaryRecorder(path, "P01", None)
    other = DiaryRecorder(sitting.path, "P02", None)  # in the next room
    other.start()
    assert other.end() == []
    sitting.end().close()
    assert other.end() == []
    sitting.open()  # the lock is free again
    assert [path.name for path in sitting.path.parent.iterdir() if "P01" in path.name] == []
    sitting.end().close()
    assert list(sitting.path.parent.glob(".*.lock")) == []


def test_a_killed_session_lets_the_next_one_begin(tmp_path: Path) -> None:
    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01")
    code = (
        "import os, sys; from manip3d.phantom._diary import DiaryRecorder;"
        "kept = DiaryRecorder(sys.argv[1], 'P01', None); kept.start(); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert len(list(tmp_path.glob(".*.lock"))) == 1
    DiaryRecorder(path, "P01", None).end()
    assert list(tmp_path.glob(".*.lock")) == []


def test_a_session_is_noticed_after_a_change_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The diary was opened by a relative path."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    with Diary("study.diary", create=True) as diary:
        diary.enrol("P01")
        recorder = DiaryRecorder("study.diary", "P01", None)
        monkeypatch.chdir("elsewhere")
        with pytest.raises(InputError, match=r"session open in .*, or is being deleted there"):
            diary.delete("P01")
        recorder.end()
    assert list(tmp_path.rglob(".*.lock")) == []


def test_the_lock_of_a_killed_session_has_the_mode_of_the_diary(sitting: Sitting) -> None:
    """Another user who may write the diary then can begin a session."""
    sitting.end().close()
    sitting.path.chmod(0o660)
    umask = os.umask(0o077)
    try:
        sitting.open()
    finally:
        os.umask(umask)
    (lock,) = sitting.path.parent.glob(".*.lock")
    assert lock.stat().st_mode & 0o777 == 0o660


def test_a_lock_of_another_user_is_named_with_its_remedy(
    sitting: Sitting, monkeypatch: pytest.MonkeyPatch
) -> None:
    sitting.end().close()

    def refused(path: Path, **_: Any) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr("manip3d.diary._session_lock.locked_file", refused)
    with pytest.raises(PermissionError, match=r"delete it if that session is over: .*\.lock'"):
        DiaryRecorder(sitting.path, "P01", None)


def test_a_file_system_without_locks_has_no_sessions_but_deletions(
    sitting: Sitting, monkeypatch: pytest.MonkeyPatch
) -> None:
    sitting.end().close()

    def without_locks(*_: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("manip3d._util.locks.fcntl.flock", without_locks)
    with pytest.raises(OSError, match=r"No locks available: .*\.lock'"):
        DiaryRecorder(sitting.path, "P01", None)
    with Diary(sitting.path) as diary:
        diary.delete("P01")
        assert diary.participants() == []
    assert list(sitting.path.parent.glob(".*.lock")) == []


def test_a_session_with_a_diary_that_can_only_be_read_is_refused(
    sitting: Sitting, monkeypatch: pytest.MonkeyPatch
) -> None:
    sitting.end().close()
    access = os.access
    monkeypatch.setattr(
        "manip3d.diary._file.os.access",
        lambda path, mode: mode != os.W_OK and access(path, mode),
    )
    with pytest.raises(OSError, match="the diary can only be read, because"):
        DiaryRecorder(sitting.path, "P01", None)
    assert list(sitting.path.parent.glob(".*.lock")) == []


def test_a_rating_that_stops_is_kept_once_and_with_its_reason(
    sitting: Sitting, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk during the second row of a rating leaves both rows once in the diary."""
    sitting.say("pain", value=3)
    sitting.say("enough")
    sitting.say("unanswered")
    sitting.say("again")
    sitting.now += timedelta(minutes=1)  # later than a correction
    kept = sitting.recorder._diary
    wait_for(lambda: len(kept.sessions("P01")) == 2)
    add, failures = DiaryTransaction.add, [OSError("disk full")]

    def fails_once(self: DiaryTransaction, table: Any, *rest: Any, **parents: Any) -> int:
        if table.name == "events" and failures:
            raise failures.pop()
        return add(self, table, *rest, **parents)

    monkeypatch.setattr(DiaryTransaction, "add", fails_once)
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]
    with sitting.end() as diary:
        assert failures == []
        assert [rating.pain for rating in diary.ratings("P01")] == [3, 6]
        assert [(e.kind, "3 to 6" in e.text) for e in diary.events("P01")] == [("pain", True)]


def test_a_rating_that_was_not_given_matters_on_its_day_only(sitting: Sitting) -> None:
    sitting.say("pain", value=3)
    sitting.say("enough")
    sitting.say("unanswered")
    sitting.now += timedelta(days=1)
    assert sitting.say("pain", value=6)["game"]["halt"] == ""
    assert sitting.say("ready")["game"]["phase"] == "playing"


def test_midnight_within_a_sitting_ends_no_stop(sitting: Sitting) -> None:
    sitting.now = sitting.now.replace(hour=23, minute=50)
    sitting.say("pain", value=3)
    sitting.say("ready")
    sitting.now += timedelta(minutes=8)
    assert sitting.say("pain", value=6)["game"]["halt"] != ""
    sitting.now += timedelta(minutes=3)
    status = sitting.say("ready")["game"]
    assert (status["phase"], "rose from 3" in status["halt"]) == ("over", True)
    assert "rose from 3" in sitting.say("again")["game"]["halt"]
    sitting.now += timedelta(hours=9)
    assert sitting.show()["game"]["halt"] == ""
    assert sitting.say("ready")["game"]["halt"] == ""


@pytest.mark.parametrize("is_halted", [False, True])
def test_a_rest_after_midnight_ends_the_sitting_of_the_day_before(
    monkeypatch: pytest.MonkeyPatch, is_halted: bool
) -> None:
    night = datetime(2026, 5, 1, 23, 50).astimezone()
    now = night
    monkeypatch.setattr(_sitting, "local_now", lambda: now)
    patient = _sitting.Sitting(None)
    assert not patient.hear()
    if is_halted:
        patient.halt("pain rose")
    now = night + timedelta(minutes=30)
    assert not patient.hear()
    assert bool(patient.halted) == is_halted
    now = night + timedelta(hours=10)
    assert patient.hear()
    assert patient.halted == ""


def test_the_morning_after_asks_first_and_compares_with_the_night(sitting: Sitting) -> None:
    """A patient who played past midnight rated nothing since; the pain may have risen overnight."""
    sitting.now = sitting.now.replace(hour=23, minute=50)
    sitting.say("pain", value=3)
    sitting.say("ready")
    sitting.now += timedelta(minutes=30)
    sitting.say("stop")
    sitting.now += timedelta(hours=9)
    status = sitting.say("ready")["game"]
    assert (status["ask"], status["pain"]) == (RATE_FIRST, None)
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]


def test_a_sitting_that_is_over_stays_over() -> None:
    patient = _sitting.Sitting(None)
    patient.end()
    assert patient.state == "over"
    patient.end()
    assert patient.state == "over"
    with pytest.raises(InputError, match="pain: expected a session with a diary"):
        patient.rate(3)


def test_a_sitting_that_ended_asks_for_no_second_rating(sitting: Sitting) -> None:
    sitting.say("pain", value=3)
    sitting.say("enough")
    sitting.say("pain", value=3)
    patient = sitting.session._sitting
    assert patient.state == "over"
    patient.end()
    assert patient.state == "over"


def test_a_stop_and_a_baseline_hold_for_their_day(sitting: Sitting) -> None:
    """A stop and a first rating hold for one day, although the program runs over night."""
    sitting.now = sitting.now.replace(hour=23, minute=50)
    sitting.say("pain", value=3)
    sitting.say("ready")
    sitting.now += timedelta(minutes=9)
    last = sitting.now
    sitting.say("stop")
    sitting.now += timedelta(minutes=6)
    assert "rose from 3 to 6" in sitting.say("pain", value=6)["game"]["halt"]  # of one sitting
    sitting.now += timedelta(hours=8)
    status = sitting.say("ready")["game"]
    assert "rose from 3" in status["halt"]  # it is still the day on which it was said
    sitting.now += timedelta(days=1)
    status = sitting.say("ready")["game"]
    assert (status["halt"], status["ask"], status["pain"]) == ("", RATE_FIRST, None)
    assert sitting.say("pain", value=7)["game"]["halt"] == ""
    assert sitting.say("ready")["game"]["phase"] == "playing"
    with sitting.end() as diary:
        first, second = diary.sessions("P01")
        assert first.ended is not None
        assert last < first.ended < last + timedelta(minutes=10)  # no night in it
        assert (second.pain_before, len(second.games)) == (7, 1)


def test_without_a_diary_there_is_a_way_out() -> None:
    session = LiveSession("right_arm")
    session.command("enough")
    message = session.process(painted(0))
    assert message is not None
    assert read_frame(message).status["game"]["sitting"] == "over"
    session.command("again")
    message = session.process(painted(1))
    assert message is not None
    assert read_frame(message).status["game"]["sitting"] == "open"


def test_a_camera_whose_clock_begins_again_makes_nothing_grow() -> None:
    session = LiveSession("right_arm")
    session.command("ready")

    def run(start: int, count: int) -> None:
        for number in range(start, start + count):
            frame = painted(number % 40)
            session.process(replace(frame, time_ns=number * 33_333_333, number=number))

    run(100_000, 30)
    run(0, 300)  # ten seconds
    heights = session._play._heights
    assert heights
    assert heights[-1][0] - heights[0][0] <= 10e9
    assert len(heights) <= 2 * 301
    assert list(session._times) == sorted(session._times)
    assert all(0 <= session._last_time - time <= 1e9 for time, _ in session._play._events)  # type: ignore[operator]


def test_the_limb_as_it_was_felt_last_time_is_shown_again(sitting: Sitting) -> None:
    assert sitting.show()["felt_as"] is None
    sitting.say("felt", **FELT)
    sitting.end().close()
    sitting.open()
    assert sitting.show()["felt_as"] == FELT
    assert sitting.show()["felt"] is not None  # where it is, beside the limb
    assert sitting.recorder.last_felt("left_leg") is None
    assert sitting.recorder.last_felt("right_arm") == FeltLimb(**FELT)
    assert sitting.say("limb", limb="left_arm")["felt_as"] is None


def test_each_limb_is_felt_in_its_own_way(sitting: Sitting) -> None:
    other = FELT | {"length": 90}
    sitting.say("felt", **FELT)
    sitting.now += timedelta(minutes=1)
    sitting.say("limb", limb="left_arm")
    sitting.say("felt", **other)
    for _ in range(2):
        assert sitting.say("limb", limb="right_arm")["felt_as"] == FELT
        assert sitting.say("limb", limb="left_arm")["felt_as"] == other
        with sitting.end() as diary:
            told = [(one.limb, one.length) for one in diary.felt("P01")]
            assert told == [("right_arm", 60), ("left_arm", 90)]
        sitting.open()
