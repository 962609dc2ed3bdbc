"""The recorder of a live session never waits for the disk, and loses nothing silently."""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
from typer.testing import CliRunner

import capsule_body
from manip3d import FormatError, InputError, capture, phantom
from manip3d.cli import app, signals
from manip3d.phantom import GameSummary, LiveReport, LiveSession
from manip3d.phantom._anomalies import Anomaly
from manip3d.phantom._interrupts import Interrupts
from manip3d.phantom._log import SessionLog
from manip3d.phantom._writer import OrderedWriter
from waiting import wait_for

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")

from manip3d.diary import Diary, _file
from manip3d.phantom import _diary as _recorder
from manip3d.phantom._diary import DiaryRecorder

PICTURES = ((0.5, b"\xff\xd8 a picture"),)


def summary(score: int = 7, ending: str = "time") -> GameSummary:
    return GameSummary(
        "bubbles", 1, 3, ending, 60.0, 1.5, score, 2, 3, anomalies=(Anomaly(1.0, 12.0),)
    )


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock the diary by another connection that writes and does not end."""
    with contextlib.closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield
        other.rollback()


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(_file, "_BUSY_S", 0.3)
    with Diary(tmp_path / "study.diary", create=True) as diary:
        diary.enrol("P01", limb="right_arm", clips=True)
    return tmp_path / "study.diary"


def test_nobody_waits_for_a_locked_diary_and_all_is_kept_afterwards(path: Path) -> None:
    recorder = DiaryRecorder(path, "P01", None)
    session = LiveSession("right_arm", recorder=recorder)
    session.halt(recorder.start())
    frames = iter([capsule_body.painted(number) for number in range(4)])
    told = []
    with locked(path):
        for name, fields in (
            ("pain", {"value": 3}),
            ("event", {"text": "a chair"}),
            ("felt", FELT),
        ):
            session.command(name, fields)
        began = time.perf_counter()
        session.process(next(frames))
        assert time.perf_counter() - began < 0.25  # the file is waited for longer
        recorder.game(summary(), [PICTURES])
        wait_for(lambda: recorder.trouble != "")
        told.append(recorder.trouble)
        assert b"Not kept in the diary yet: 4 entries" in (session.process(next(frames)) or b"")
        assert b"Not kept in the diary yet: " in session.notice("The camera is gone.")
    wait_for(lambda: recorder.trouble == "")
    assert b"Not kept" not in (session.process(next(frames)) or b"")
    assert recorder.end() == []
    assert "database is locked" in told[0]
    with Diary(path) as diary:
        (sitting,) = diary.sessions("P01")
        assert [rating.pain for rating in sitting.ratings] == [3]
        assert [(game.score, game.ending) for game in sitting.games] == [(7, "time")]
        assert sitting.ended is not None
        actions = [action for _, action, _ in diary.audit()]
        assert actions == ["enrol", "session", "rating", "event", "questionnaire", "game"]
        assert sitting.ratings[0].at < sitting.games[0].at  # when it was said, not written
        assert len(diary.clips("P01")) == 1


def test_what_is_said_while_the_diary_is_moved_away_is_kept_when_it_is_back(path: Path) -> None:
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    moved = path.with_name("moved.diary")
    path.rename(moved)
    recorder.pain(3)
    wait_for(lambda: recorder.trouble != "")
    assert f"1 entry (the diary is no longer at {path}; put it back)" in recorder.trouble
    moved.rename(path)
    assert recorder.end() == []
    with Diary(path) as diary:
        assert [rating.pain for rating in diary.ratings("P01")] == [3]


FELT = {"length": 60, "telescoping": 10, "raised": 0, "bent": 20}


def test_what_could_not_be_kept_is_told_at_the_end(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_recorder, "_END_S", 0.5)
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    with locked(path):
        recorder.pain(3)
        recorder.play_begins()
        recorder.game_goes_on(summary(ending="interrupted"))
        assert "rose from 3 to 6" in recorder.pain(6)  # the stop rule waits for no disk
        recorder.game(summary())
        began = time.monotonic()
        told = recorder.end()
        assert time.monotonic() - began < 5.0
    assert [one.split(",")[0] for one in told] == ["pain 3", "pain 6", "game bubbles"]
    assert "7 points" in told[2]
    assert all("database is locked" in one for one in told)


class Camera:
    """A camera that films a moving person without end."""

    number = 0

    num_frames = None  # nobody knows when a camera ends

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def start(self) -> None:
        pass

    def read(self, timeout: float) -> Any:
        time.sleep(0.02)
        self.number += 1
        frame = capsule_body.painted(self.number % 40)
        return replace(frame, time_ns=self.number * 33_333_333, number=self.number)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (signal.SIGINT, signal.SIGINT),
        (signal.SIGINT, signal.SIGTERM),
        (signal.SIGTERM, signal.SIGTERM),
    ],
)
def test_a_second_signal_at_the_end_cuts_the_waiting_and_not_the_report(
    path: Path, monkeypatch: pytest.MonkeyPatch, first: signal.Signals, second: signal.Signals
) -> None:
    """A second Ctrl-C while another program locks the diary ends the waiting only."""
    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: Camera())
    monkeypatch.setattr(_recorder, "_END_S", 60.0)
    holder = contextlib.ExitStack()

    def press() -> None:
        # Only what is told after the start waits for the disk.
        recorder = started[0]
        recorder.pain(4)
        recorder.event("a chair fell over")
        time.sleep(0.3)
        for number in (first, second, second):
            os.kill(os.getpid(), number)
            time.sleep(0.5)

    started: list[DiaryRecorder] = []
    start = DiaryRecorder.start

    def note_start(recorder: DiaryRecorder, latency: Any = None) -> str:
        told = start(recorder, latency)
        holder.enter_context(locked(path))
        started.append(recorder)
        return told

    def on_start(url: str, made: object) -> None:
        threading.Thread(target=press, daemon=True).start()

    hurried: list[bool] = []
    close = OrderedWriter.close

    def note_close(
        writer: OrderedWriter, seconds: float, is_hurried: Callable[[], bool] | None = None
    ) -> list[str]:
        left = close(writer, seconds, is_hurried)
        hurried.append(is_hurried is not None and is_hurried())
        return left

    monkeypatch.setattr(OrderedWriter, "close", note_close)
    monkeypatch.setattr(DiaryRecorder, "start", note_start)
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    with holder, signals.ended_like_ctrl_c():
        report = phantom.run_live(
            "openni2:", affected="right_arm", diary=path, participant="P01", on_start=on_start
        )
    assert hurried == [True]  # not at the end of the minute that it would wait
    assert [one.split(",")[0] for one in report.unkept] == ["pain 4", "adverse event"]
    assert "a chair fell over: " in report.unkept[1]
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_signal_that_interrupts_nothing_ends_nothing() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    try:
        with Interrupts() as interrupts:
            for _ in range(2):
                signal.raise_signal(signal.SIGINT)
            assert len(heard) == 2  # neither was the one that ends the session
            assert not interrupts.is_hurried()
            interrupts.note_end()
            signal.raise_signal(signal.SIGINT)
            assert len(heard) == 2
            assert interrupts.is_hurried()
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_hurry_loses_nothing_that_a_working_disk_takes() -> None:
    writer = OrderedWriter()
    done: list[int] = []
    for number in range(3):
        writer.add(f"entry {number}", lambda n=number: (time.sleep(0.05), done.append(n)))  # type: ignore[misc]
    assert writer.close(10.0, lambda: True) == []
    assert done == [0, 1, 2]


def test_films_are_dropped_where_consent_is_gone_but_never_the_game(path: Path) -> None:
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    recorder.game_goes_on(summary(0, "interrupted"))
    with Diary(path) as other:
        wait_for(lambda: len(other.sessions("P01")[0].games) == 1)
        other.set_consent("P01", clips=False)
    recorder.game(summary(), [PICTURES])
    wait_for(lambda: not recorder.wants_clips)
    recorder.consent(True)
    recorder.game(summary(8), [PICTURES])
    assert recorder.end() == []
    with Diary(path) as diary:
        assert [game.score for game in diary.sessions("P01")[0].games] == [7, 8]
        assert [clip.start for clip in diary.clips("P01")] == [1.0]


def test_films_of_before_a_withdrawal_are_not_written_after_it(path: Path) -> None:
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    with locked(path):
        recorder.game(summary(), [PICTURES])
        recorder.consent(False)
        recorder.consent(True)
    assert recorder.end() == []
    with Diary(path) as diary:
        assert len(diary.sessions("P01")[0].games) == 1
        assert diary.clips("P01") == []
        assert diary.participant("P01").clips


def test_what_is_said_is_kept_while_films_cannot_be_deleted(path: Path) -> None:
    """A rating is kept while a reader of the diary keeps films from being deleted for good."""
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    recorder.game(summary(), [PICTURES])
    with Diary(path) as diary, contextlib.closing(sqlite3.connect(path)) as reader:
        wait_for(lambda: len(diary.clips("P01")) == 1)
        reader.execute("BEGIN")
        reader.execute("SELECT count(*) FROM games").fetchone()
        recorder.consent(False)
        recorder.pain(4)
        wait_for(lambda: len(diary.ratings("P01")) == 1)
        wait_for(lambda: "nothing deleted" in recorder.trouble)
        reader.rollback()
    assert recorder.end() == []
    with Diary(path) as diary:
        assert diary.clips("P01") == []


def test_films_that_were_exported_are_named_when_consent_is_withdrawn(path: Path) -> None:
    film = path.parent / "P01.webp"
    film.write_bytes(b"RIFF\0\0\0\0WEBP")
    with Diary(path) as diary:
        diary.note_files("P01", [film])
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    recorder.consent(False)
    wait_for(lambda: recorder.trouble != "")
    assert recorder.trouble == "1 exported file still shows films; see `manip3d diary consent`."
    recorder.consent(True)
    wait_for(lambda: recorder.trouble == "")
    assert recorder.end() == []


def test_what_would_fail_again_is_told_and_holds_up_nothing() -> None:
    done: list[int] = []
    failures = [OSError("disk full"), OSError("disk full")]

    def write(number: int) -> None:
        if number == 1 and failures:
            raise failures.pop()
        if number == 2:
            raise InputError("no such session")
        done.append(number)

    writer = OrderedWriter()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("manip3d.phantom._writer._AGAIN_S", 0.05)
        for number in range(4):
            writer.add(f"entry {number}", lambda number=number: write(number))  # type: ignore[misc]
        wait_for(lambda: writer.is_idle)
    assert done == [0, 1, 3]
    assert writer.trouble == "Cannot be kept in the diary: entry 2: no such session."
    assert writer.close(1.0) == ["entry 2: no such session"]
    wait_for(lambda: not writer._thread.is_alive())


def test_a_live_session_that_lost_something_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    report = LiveReport(
        "right_arm", 1, 1.0, 0.1, {}, {}, (), {}, (), unkept=("pain 6, 10:31: disk full",)
    )
    monkeypatch.setattr(phantom, "run_live", lambda *_, **__: report)
    done = CliRunner().invoke(app, ["phantom", "live", "--no-open", "--quiet", "--json"])
    assert done.exit_code == 1
    assert "not kept in the diary: pain 6, 10:31: disk full" in done.stderr
    assert '"unkept"' in done.stdout


class Nothing:
    """A session and a server without anything to log."""

    stage_ms: ClassVar[dict[str, float]] = {}
    summaries = ()
    num_clients = 0
    refused: ClassVar[dict[str, int]] = {}

    def report(self) -> list[object]:
        return []


def test_a_full_disk_costs_lines_of_the_log_and_no_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that takes no byte (`/dev/full`) or a part of a line costs that line only."""
    path, nothing = tmp_path / "log.jsonl", Nothing()
    for file in (Path("/dev/full"), path):
        with SessionLog(file) as log:
            log._due = 0.0
            log.tell(nothing, nothing, 0, {})  # type: ignore[arg-type]
            assert log.lost_lines == (file != path)
    whole = path.read_bytes()
    with SessionLog(path) as log:
        stream = log._file
        assert stream is not None
        part = SimpleNamespace(
            write=lambda line: stream.write(line[:10]),
            truncate=stream.truncate, seek=stream.seek, close=stream.close,
        )  # fmt: skip
        monkeypatch.setattr(log, "_file", part)
        log._due = 0.0
        log.tell(nothing, nothing, 0, {})  # type: ignore[arg-type]
        assert log.lost_lines == 1
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    "content", [b"manip3d diary key 1 00ff", b"SQLite format 3\0", b'{"cells": []}']
)
def test_a_log_is_added_to_no_other_file(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "study.key"
    path.write_bytes(content)
    with pytest.raises(InputError, match="log: expected a new file or the log of a session"):
        phantom.run_live(log=path, seconds=1.0)
    assert path.read_bytes() == content


def test_a_key_without_a_diary_is_refused() -> None:
    with pytest.raises(InputError, match="diary_key: can only be given with diary"):
        phantom.run_live(diary_key="study.key", seconds=1.0)


@pytest.mark.parametrize(
    "wrong", [{"gain": float("nan")}, {"port": 70_000}, {"certificate": "no.pem"}]
)
def test_what_is_refused_leaves_nothing_open(
    wrong: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[str] = []

    class Recorder:
        limb = "left_arm"

        def __init__(self, *_: object) -> None:
            ended.append("opened")

        def end(self, is_hurried: Callable[[], bool]) -> list[str]:
            ended.append("ended")
            return []

    (tmp_path / "no.pem").write_text("none")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("manip3d.phantom._live.DiaryRecorder", Recorder)
    with pytest.raises((InputError, FormatError)):
        phantom.run_live(diary="a", participant="P01", **wrong)
    assert ended == ["opened", "ended"]
