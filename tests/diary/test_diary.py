"""The diary's file returns what was written, and keeps nothing of deleted participants."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import date, datetime, timedelta, timezone
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError, InputError

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")

import sqlalchemy as sql

from manip3d.diary import (
    OWNERSHIP,
    Diary,
    DiaryGame,
    DiarySession,
    Protocol,
    adherence,
    export_clips,
    export_csv,
    export_fhir,
    make_key,
    write_overview,
    write_page,
)
from manip3d.diary import _schema as schema
from manip3d.diary._file import DiaryFile, is_filled

ZONE = timezone(timedelta(hours=-6))
START = datetime(2026, 3, 2, 9, 0, tzinfo=ZONE)


def game(minutes: float = 5, name: str = "piano", **changes: Any) -> DiaryGame:
    fields: dict[str, Any] = {
        "game": name, "difficulty": 2, "seed": 11, "ending": "time", "seconds": 60.0,
        "paused_s": 2.5, "score": 17, "misses": 3, "by_phantom": 8,
        "anomalies": ((4.0, 16.5), (30.0, 44.0)), "limb": "left_leg", "source": "openni2:",
        "version": "0.1", "latency_ms": 31.5, "tracked": 0.96,
    }  # fmt: skip
    return DiaryGame(**({"at": START + timedelta(minutes=minutes)} | fields | changes))


def jpeg(text: str, size: int = 400) -> bytes:
    """Return bytes that the diary stores as an image."""
    return b"\xff\xd8" + (f"picture of {text} " * size)[:size].encode()


def fill(diary: Diary, name: str = "P01") -> int:
    """Enrol a participant with one record of each kind."""
    diary.enrol(name, limb="left_leg", clips=True, at=START)
    session = diary.start_session(name, at=START)
    diary.add_rating(name, 4, session=session, at=START)
    films = [[(0.0, jpeg(name)), (0.1, jpeg(name))], [(25.0, jpeg(name, 90_000))]]
    diary.add_game(session, game(), films)
    diary.add_rating(name, 3, session=session, at=START + timedelta(minutes=6))
    diary.add_event(name, "other", f"stump of {name} was sore", session=session, at=START)
    diary.add_mcgill(name, [1] * 20, 2, occasion="baseline", at=START)
    diary.end_session(session, at=START + timedelta(minutes=9))
    return session


@pytest.fixture
def diary(tmp_path: Path, key: Path | None) -> Iterator[Diary]:
    with Diary(tmp_path / "study.diary", key=key, create=True) as found:
        yield found


def test_what_is_written_is_read_again_by_another_program(diary: Diary, key: Path | None) -> None:
    number = fill(diary)
    diary.close()
    with Diary(diary.path, key=key) as again:
        (session,) = again.sessions("P01")
        assert session.number == number
        assert session.games == (game(),)
        assert (session.started, session.ended) == (START, START + timedelta(minutes=9))
        assert (session.pain_before, session.pain_after) == (4, 3)
        assert [rating.pain for rating in again.ratings("P01")] == [4, 3]
        first, second = again.clips("P01")
        assert (first.game, first.start, first.end) == ("piano", 4.0, 16.5)
        assert first.pictures == ((0.0, jpeg("P01")), (0.1, jpeg("P01")))
        assert second.pictures == ((25.0, jpeg("P01", 90_000)),)
        assert jpeg("P01") not in repr(first).encode()
        (filled,) = again.mcgill("P01")
        assert (filled.occasion, filled.score.pri, filled.ranks) == ("baseline", 20, (1,) * 20)
        (event,) = again.events("P01")
        assert (event.kind, event.text) == ("other", "stump of P01 was sore")
        (person,) = again.participants()
        assert (person.identifier, person.limb, person.enrolled) == ("P01", "left_leg", START)
        actions = [action for _, action, whose in again.audit() if whose == "P01"]
        assert actions == ["enrol", "session", "rating", "game", "rating", "event", "questionnaire"]
        again.check()


def test_pain_that_rises_by_two_stops_and_is_an_adverse_event(diary: Diary) -> None:
    diary.enrol("P01")
    session = diary.start_session("P01")
    assert diary.add_rating("P01", 3, session=session) == ""
    assert diary.add_rating("P01", 6, session=session) == ""  # said better, before any game
    diary.add_game(session, game())
    assert diary.add_rating("P01", 7, session=session) == ""
    assert "rose from 6 to 8" in diary.add_rating("P01", 8, session=session)
    assert [event.kind for event in diary.events("P01")] == ["pain"]
    assert diary.sessions("P01")[0].pain_before == 6
    other = diary.start_session("P01")
    diary.add_game(other, game())
    assert diary.add_rating("P01", 10, session=other) == ""  # nobody knows what was before
    late = diary.start_session("P01")
    diary.add_game(late, game())
    assert diary.add_rating("P01", 4, session=late) == ""
    assert "rose from 4 to 6" in diary.add_rating("P01", 6, session=late)


def test_a_rating_during_the_first_game_is_not_the_one_before_it(diary: Diary) -> None:
    """A rating after the start of play, also of a touch cue, does not count as pain before play."""
    diary.enrol("P01")
    session = diary.start_session("P01", at=START)
    diary.add_rating("P01", 3, session=session, at=START)
    diary.begin_play(session, at=START + timedelta(seconds=5))
    diary.begin_play(session, at=START + timedelta(seconds=90))
    told = diary.add_rating("P01", 9, session=session, at=START + timedelta(seconds=10))
    assert "rose from 3 to 9" in told
    assert [event.kind for event in diary.events("P01")] == ["pain"]
    (found,) = diary.sessions("P01")
    assert (found.pain_before, found.pain_after) == (3, 9)
    assert found.begun == START + timedelta(seconds=5)


@pytest.mark.usefixtures("local_zone")
def test_a_stop_holds_for_its_day(diary: Diary) -> None:
    diary.enrol("P01")
    diary.add_event("P01", "other", "a chair fell over", at=START)
    assert diary.halt_reason("P01", today=START.date()) == ""
    session = diary.start_session("P01", at=START)
    diary.add_rating("P01", 1, session=session, at=START)
    diary.begin_play(session, at=START)
    diary.add_rating("P01", 4, session=session, at=START + timedelta(minutes=1))
    assert diary.halt_reason("P01", today=START.date()).startswith("The pain rose from 1 to 4.")
    assert diary.halt_reason("P01", today=START.date() + timedelta(days=1)) == ""
    assert diary.halt_reason("P01") == ""
    diary.add_event("P01", "sickness")
    assert diary.halt_reason("P01").startswith("You feel sick.")
    diary.enrol("P02")
    assert diary.halt_reason("P02", today=START.date()) == ""


def test_pain_that_rises_before_any_play_stops_too(diary: Diary) -> None:
    """A rating within half a minute of the first one corrects it; a later one is a rise of pain."""
    diary.enrol("P01")
    for seconds, told in ((29, ""), (31, "The pain rose from 3 to 6.")):
        session = diary.start_session("P01", at=START)
        diary.add_rating("P01", 3, session=session, at=START)
        again = diary.add_rating("P01", 6, session=session, at=START + timedelta(seconds=seconds))
        assert again.startswith(told)
        assert bool(again) == bool(told)
    first, second = diary.sessions("P01")
    assert {first.pain_before, second.pain_before} == {6, 3}


def test_a_game_that_goes_on_is_replaced_by_what_became_of_it(diary: Diary) -> None:
    diary.enrol("P01", clips=True)
    session, other = diary.start_session("P01"), diary.start_session("P01")
    row = diary.add_game(session, game(0, ending="interrupted", score=0, anomalies=()))
    going = game(1, ending="interrupted", score=4)
    assert diary.add_game(session, going, replaces=row) == row
    kept = {one.number: one.games for one in diary.sessions("P01")}
    assert (kept[session], kept[other]) == ((going,), ())
    films = [[(0.0, jpeg("x"))], []]
    diary.add_game(session, game(), films, replaces=row)
    diary.add_game(session, game(9))
    kept = {one.number: one.games for one in diary.sessions("P01")}
    assert kept[session] == (game(), game(9))
    assert len(diary.clips("P01")) == 1
    assert [action for _, action, _ in diary.audit()].count("game") == 2
    with pytest.raises(InputError, match=r"replaces: session .* has no game number"):
        diary.add_game(other, game(), replaces=row)
    with pytest.raises(InputError, match="replaces: "):
        diary.add_game(session, game(), replaces=1)
    diary.check()


def test_refusals(diary: Diary) -> None:
    diary.enrol("P01")
    diary.enrol("P02")
    session = diary.start_session("P01")
    for call, message in (
        (lambda: diary.enrol("P01"), "P01 is enrolled already"),
        (lambda: diary.enrol("../P"), "participant: expected up to 64 letters"),
        (lambda: diary.enrol("Straße"), r"64 letters \(A to Z and a to z\), digits, .*'Straße'"),
        (lambda: diary.enrol(""), "participant: expected up to 64"),
        (lambda: diary.enrol("=1+1"), "participant: expected up to 64"),
        (
            lambda: diary.enrol("P03", at=datetime(2026, 1, 1)),
            "at: expected a time with its",
        ),
        (lambda: diary.start_session("P9"), "participant: 'P9' is not enrolled"),
        (lambda: diary.add_game(1, game()), "session: there is no session"),
        (lambda: diary.add_rating("P01", 11), "pain: expected 0 to 10, got 11"),
        (lambda: diary.add_rating("P02", 1, session=session), "is another participant's"),
        (lambda: diary.add_rating("P01", 1, when="soon"), "when: expected"),
        (lambda: diary.add_event("P01", "joy"), "kind: expected"),
        (lambda: diary.add_event("P01", "other", "x" * 2001), "text: expected at most 2000"),
        (lambda: diary.add_event("P01", "other", "caf\udce9"), "text: expected a text without con"),
        (lambda: diary.add_event("P01", "other", "\x1b[31mred"), r"without .* got '\\x1b\[31mred'"),
        (lambda: diary.enrol("P03", limb="tail"), r"limb: expected left_arm, .*, got .tail."),
        (lambda: diary.add_game(session, game(name="pi\x00ano")), "game: expected a text without"),
        (lambda: diary.add_game(session, game(name="no/game")), "game: expected 1 to 64 .*'no/ga"),
        (lambda: diary.add_game(session, game(name="")), "game: expected 1 to 64 characters"),
        (lambda: diary.add_game(session, game(seconds=nan)), "seconds: expected a finite number"),
        (lambda: diary.add_game(session, game(seconds=10**400)), "seconds: expected a finite numb"),
        (lambda: diary.add_game(session, game(seconds=True)), "seconds: expected a finite number"),
        (lambda: diary.add_game(session, game(anomalies=[(1, 2, 3)])), "anomalies: expected pairs"),
        (lambda: diary.add_game(session, game(anomalies=[4.0])), "anomalies: expected pairs of"),
        (lambda: diary.add_game(session, game(tracked=inf)), "tracked: expected a finite number"),
        (lambda: diary.add_game(session, game(tracked=1.5)), "tracked: expected a share of 0 to 1"),
        (
            lambda: diary.add_game(session, game(seconds=-1.0)),
            "seconds: expected 0 or more, got -1",
        ),
        (lambda: diary.add_game(session, game(misses=-1)), "misses: expected 0 or more, got -1"),
        (lambda: diary.add_game(session, game(gain=0.0)), "gain: expected a number > 0, got 0"),
        (
            lambda: diary.add_game(session, game(anomalies=[(9, 3)])),
            "anomalies: expected 0 <= start",
        ),
        (lambda: diary.add_game(session, game(score=3.5)), "score: expected a whole number"),
        (
            lambda: diary.add_game(session, game(anomalies=((4.0, nan),))),
            "anomalies: expected a finite number, got nan",
        ),
        (lambda: diary.add_game(session, game(limb="tail")), "limb: expected left_arm"),
        (lambda: diary.add_game(session, game(ending="bored")), "ending: expected time, misses"),
        (
            lambda: diary.add_felt("P01", length=60, telescoping=0, raised=0, bent=0, limb="tail"),
            "limb: expected left_arm",
        ),
        (lambda: diary.add_mcgill("P01", [1] * 20, 1, occasion="noon"), "occasion: expected"),
        (lambda: diary.delete("P9"), "'P9' is not enrolled"),
    ):
        with pytest.raises(InputError, match=message):
            call()
    diary.add_mcgill("P01", [1] * 20, 1, occasion="week-1")
    with pytest.raises(InputError, match="P01 has a questionnaire of week-1"):
        diary.add_mcgill("P01", [1] * 20, 1, occasion="week-1")
    assert len(diary.mcgill("P01")) == 1
    assert diary.sessions("P01")[0].ratings == ()
    diary.check()


def test_numbers_of_numpy_are_stored_as_those_of_python(diary: Diary) -> None:
    diary.enrol("P01")
    session = diary.start_session("P01")
    changes = {"seconds": np.float32(60), "latency_ms": np.float64(31.5), "seed": np.uint8(11)}
    changes |= {"score": np.int64(17), "anomalies": np.array([[4.0, 16.5], [30.0, 44.0]])}
    diary.add_game(session, game(**changes))
    assert diary.sessions("P01")[0].games == (game(),)
    filled = diary.add_mcgill("P01", np.ones(20, np.int64), np.int64(2), occasion="baseline")
    assert diary.mcgill("P01")[0].ranks == filled.ranks == (1,) * 20
    given = diary.add_answers("P01", OWNERSHIP, np.arange(-3, 3))
    assert diary.answers("P01")[-1].answers == given.answers == (-3, -2, -1, 0, 1, 2)
    assert given.scores == OWNERSHIP.score(np.arange(-3, 3)) == {"ownership": -2, "control": 1}


def test_a_diary_that_was_closed_refuses(tmp_path: Path) -> None:
    """A closed diary raises an error; it does not open its file again silently."""
    with Diary(tmp_path / "closed.diary", create=True) as diary:
        diary.enrol("P01", clips=True)
    diary.close()
    for call in (
        lambda: diary.enrol("P02"),
        lambda: diary.sessions("P01"),
        lambda: diary.set_consent("P01", clips=False),
        lambda: diary.delete("P01"),
        lambda: diary.check(),
    ):
        with pytest.raises(InputError, match=r"diary: .*closed\.diary was closed"):
            call()


def test_a_text_may_have_lines_and_any_script(diary: Diary) -> None:
    diary.enrol("P01")
    diary.add_event("P01", "other", "first line\nsecond: Knöchel, 足首")
    assert diary.events("P01")[0].text == "first line\nsecond: Knöchel, 足首"


@pytest.mark.parametrize("name", [":memory:", "file:z.diary", "file:z.diary?mode=memory"])
def test_a_name_is_always_one_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with Diary(name, create=True) as diary:
        diary.enrol("P01")
    assert (tmp_path / name).stat().st_size > 0
    with Diary(name) as again:
        assert [one.identifier for one in again.participants()] == ["P01"]


@pytest.fixture
def local_zone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Put this machine into a time zone six hours behind UTC."""
    monkeypatch.setenv("TZ", "XST6")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def test_patients_are_not_shown_what_a_therapist_wrote(diary: Diary) -> None:
    diary.enrol("P01")
    diary.add_event("P01", "pain", "P01 exaggerates, as always")
    assert diary.halt_reason("P01").startswith("The pain rose. Please stop")


def test_a_rating_that_is_said_to_be_before_play_is_compared_too(diary: Diary) -> None:
    diary.enrol("P01")
    session = diary.start_session("P01", at=START)
    diary.add_rating("P01", 2, session=session, when="before", at=START)
    later = START + timedelta(minutes=5)
    told = diary.add_rating("P01", 7, session=session, when="before", at=later)
    assert "rose from 2 to 7" in told
    assert diary.add_rating("P01", 9, session=session, when="other", at=later) == ""


def test_ratings_are_in_the_order_in_which_they_were_given(diary: Diary) -> None:
    """The clock is set back between them: the second is not the one that others rise from."""
    diary.enrol("P01")
    session = diary.start_session("P01", at=START)
    diary.add_rating("P01", 2, session=session, at=START)
    back = START - timedelta(minutes=30)
    assert "rose from 2 to 6" in diary.add_rating("P01", 6, session=session, at=back)
    assert "rose from 2 to 6" in diary.add_rating("P01", 6, session=session, at=back)
    (found,) = diary.sessions("P01")
    assert (found.pain_before, [one.pain for one in found.ratings]) == (2, [2, 6, 6])


@pytest.mark.parametrize("ending", ["", "-wal", "-shm"])
def test_no_export_replaces_the_diary(tmp_path: Path, ending: str) -> None:
    path = tmp_path / "study.diary"
    (tmp_path / "link").symlink_to(f"{path}{ending}")
    with Diary(path, create=True) as diary:
        diary.enrol("P01")
        for output in (f"{path}{ending}", tmp_path / "link"):
            for export in (write_page, export_fhir):
                with pytest.raises(
                    InputError, match="output: expected another file than the diary"
                ):
                    export(diary, output, "P01", overwrite=True)
        assert [one.identifier for one in diary.participants()] == ["P01"]


@pytest.mark.usefixtures("local_zone")
def test_days_with_a_time_are_refused(diary: Diary, tmp_path: Path) -> None:
    """They compare equal to no day: nobody would be stopped."""
    diary.enrol("P01", at=START)
    diary.add_event("P01", "sickness", at=START)
    for call in (
        lambda: diary.halt_reason("P01", today=START),
        lambda: write_page(diary, tmp_path / "page.html", "P01", today=START),
        lambda: write_overview(diary, tmp_path / "pages", today=START),
        lambda: adherence([], START, START),
    ):
        with pytest.raises(InputError, match="today: expected a date without a time"):
            call()


@pytest.mark.usefixtures("local_zone")
def test_a_stop_of_another_time_zone_holds_for_the_day_here(diary: Diary) -> None:
    """A time of the third of March in Tokyo is on the second here, and the stop holds that day."""
    diary.enrol("P01")
    tokyo = datetime(2026, 3, 3, 1, 0, tzinfo=timezone(timedelta(hours=9)))
    diary.add_event("P01", "sickness", at=tokyo)
    assert diary.halt_reason("P01", today=date(2026, 3, 2)).startswith("You feel sick.")
    assert diary.halt_reason("P01", today=date(2026, 3, 3)) == ""


def test_a_session_closed_without_a_rating_says_so(diary: Diary) -> None:
    diary.enrol("P01")
    first, second = (diary.start_session("P01", at=START) for _ in range(2))
    diary.end_session(first, at=START, answered=False)
    diary.end_session(second, at=START)
    found = {one.number: one.answered for one in diary.sessions("P01")}
    assert found == {first: False, second: True}


# --- the audit ------------------------------------------------------------------------------------


def test_the_audit_is_by_time_across_time_zones(
    diary: Diary, monkeypatch: pytest.MonkeyPatch
) -> None:
    for zone in ("XST6", "XST-9", "XST0"):
        monkeypatch.setenv("TZ", zone)
        time.tzset()
        diary.enrol(f"P{zone[3:]}")
    monkeypatch.undo()
    time.tzset()
    assert [whose for _, _, whose in diary.audit()] == ["P6", "P-9", "P0"]


CHANGES = {
    "when": ("UPDATE audit SET at = '2026-01-01T00:00:00+00:00' WHERE number = 3", 3),
    "what": ("UPDATE audit SET action = 'consent' WHERE number = 2", 2),
    "whose": ("UPDATE audit SET participant = NULL WHERE number = 4", 4),
    "a row less": ("DELETE FROM audit WHERE number = 5", 5),
    "the last row less": ("DELETE FROM audit WHERE number = (SELECT max(number) FROM audit)", None),
    "all gone": ("DELETE FROM audit", 1),
    "erased": (
        "UPDATE audit SET at = '', action = '', participant = NULL, salt = '' WHERE number = 2",
        2,
    ),
    "a hash": (
        "UPDATE audit SET digest = CASE substr(digest, 1, 1) WHEN 'a' THEN 'b' ELSE 'a' END "
        "|| substr(digest, 2) WHERE number = 6",
        6,
    ),
    "order": (
        "UPDATE audit SET number = CASE number WHEN 2 THEN -3 ELSE -2 END WHERE number IN (2, 3);"
        "UPDATE audit SET number = -number WHERE number < 0",
        2,
    ),
    "one more": (
        "INSERT INTO audit SELECT max(number) + 1, at, action, participant, erased, salt, digest, "
        "link FROM audit",
        None,
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_the_first_changed_row_of_the_audit_is_named(diary: Diary, change: str) -> None:
    fill(diary, "P01")
    fill(diary, "P02")
    diary.delete("P01")
    fill(diary, "P03")
    diary.delete("P03")
    last = 23
    diary.check_audit()
    statement, row = CHANGES[change]
    if change in ("when", "what", "whose", "erased"):  # rows 1 to 7 are of P01, and erased
        number = row or 0
        statement, row = (
            statement.replace(f"number = {number}", f"number = {number + 7}"),
            number + 7,
        )
    with contextlib.closing(sqlite3.connect(diary.path)) as raw:
        assert raw.execute("SELECT max(number) FROM audit").fetchone() == (last,)
        raw.executescript(statement)
        raw.commit()
    named = row or (last if "less" in change else last + 1)
    with pytest.raises(FormatError, match=rf"the audit is damaged: row {named} "):
        diary.check_audit()
    with pytest.raises(FormatError, match="the audit is damaged"):
        diary.check()


@pytest.mark.parametrize("value", ["'ü'", "x'ff00'", "7"])
@pytest.mark.parametrize("column", ["at", "action", "salt", "erased", "digest", "link"])
def test_whatever_stands_in_a_row_of_the_audit_is_named(
    diary: Diary, column: str, value: str
) -> None:
    diary.enrol("P01")
    diary.start_session("P01")
    with contextlib.closing(sqlite3.connect(diary.path)) as raw:
        raw.execute(f"UPDATE audit SET {column} = {value} WHERE number = 2")
        raw.commit()
    with pytest.raises(FormatError, match="the audit is damaged: row 2 is not what was written"):
        diary.check_audit()
    if column == "at":
        with pytest.raises(FormatError, match="expected a time with its offset"):
            diary.audit()


@pytest.mark.parametrize("value", ["ü", b"\xff", "2026-03-02T09:30:00"])
def test_an_older_diary_with_a_bad_time_still_opens(tmp_path: Path, value: str | bytes) -> None:
    with Diary(tmp_path / "old", create=True) as today:
        today.enrol("P01")
    with contextlib.closing(sqlite3.connect(tmp_path / "old")) as raw:
        put_back_old_audit(raw)
        raw.execute("UPDATE audit SET at = ? WHERE action = 'session'", (value,))
        raw.execute("PRAGMA user_version = 6")
        raw.commit()
    with Diary(tmp_path / "old") as diary:
        assert [one.identifier for one in diary.participants()] == ["P01"]
        diary.check()  # from now on it is what it was
        with pytest.raises(FormatError, match="the audit is damaged: expected a time"):
            diary.audit()
    with contextlib.closing(sqlite3.connect(tmp_path / "old")) as raw:
        rows = raw.execute("SELECT action, at FROM audit ORDER BY number").fetchall()
    assert rows == [("session", value), ("enrol", "2026-03-02T15:30:00+01:00")]


def test_an_audit_without_rows_is_no_lost_one(diary: Diary) -> None:
    diary.check()
    with contextlib.closing(sqlite3.connect(diary.path)) as raw:
        raw.execute("DELETE FROM meta WHERE name = 'audit head'")
        raw.commit()
    with pytest.raises(FormatError, match="the audit is damaged: row 1 "):
        diary.check()


def test_the_chain_of_an_encrypted_audit_cannot_be_made_anew(tmp_path: Path) -> None:
    """The key of the audit's chain is not stored in clear, and differs between two diaries."""
    make_key(tmp_path / "a.key")
    keys = set()
    for name in ("one", "two"):
        with Diary(tmp_path / name, key=tmp_path / "a.key", create=True) as diary:
            diary.enrol("P01")
            assert diary._file.chain_key not in files_beside(diary.path)
            keys.add(diary._file.chain_key)
    assert len(keys) == 2


def test_a_damaged_page_is_found_before_anything_is_written(tmp_path: Path) -> None:
    path = tmp_path / "d"
    with Diary(path, create=True) as diary:
        session = fill(diary)
        for number in range(200):
            diary.add_game(session, game(number))
    with contextlib.closing(sqlite3.connect(path)) as raw:
        raw.execute("PRAGMA journal_mode = DELETE")
        (page,) = raw.execute("SELECT rootpage FROM sqlite_master WHERE name = 'games'").fetchone()
    content = bytearray(path.read_bytes())
    content[4096 * (page - 1) + 8 : 4096 * (page - 1) + 40] = b"\xff" * 32
    path.write_bytes(content)
    with pytest.raises(FormatError, match="damaged"):
        Diary(path)
    assert path.read_bytes() == content


# --- keys -----------------------------------------------------------------------------------------


def test_an_encrypted_diary_says_nothing_without_its_key(tmp_path: Path) -> None:
    make_key(tmp_path / "a.key")
    make_key(tmp_path / "b.key")
    path = tmp_path / "study.diary"
    with Diary(path, key=tmp_path / "a.key", create=True) as diary:
        fill(diary, "patient-7")
    content = path.read_bytes()
    # Words of five bytes and more: three occur in what is encrypted by chance.
    for word in (b"patient-7", b"left_leg", b"piano", b"stump", b"baseline", b"2026-03-02"):
        assert word not in content
    with pytest.raises(InputError, match="is encrypted; its key file is needed"):
        Diary(path)
    with pytest.raises(FormatError, match="this key does not open it"):
        Diary(path, key=tmp_path / "b.key")
    with Diary(tmp_path / "plain", create=True):
        pass
    with pytest.raises(InputError, match="is not encrypted; open it without a key"):
        Diary(tmp_path / "plain", key=tmp_path / "a.key")
    assert (tmp_path / "a.key").stat().st_mode & 0o777 == 0o600
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(FileExistsError):
        make_key(tmp_path / "a.key")
    (tmp_path / "c.key").write_text("manip3d diary key 1 zz")
    with pytest.raises(FormatError, match="expected a key of a diary"):
        Diary(path, key=tmp_path / "c.key")


def test_a_payload_cannot_be_put_elsewhere(tmp_path: Path) -> None:
    """Without the key, nobody can move a game from one participant to another in the file."""
    make_key(tmp_path / "a.key")
    path = tmp_path / "study.diary"
    with Diary(path, key=tmp_path / "a.key", create=True) as diary:
        fill(diary, "P01")
        fill(diary, "P02")
        with contextlib.closing(sqlite3.connect(path)) as raw:
            rows = raw.execute("SELECT id, payload FROM games").fetchall()
            raw.execute("UPDATE games SET payload = ? WHERE id = ?", (rows[0][1], rows[1][0]))
            raw.commit()
        with pytest.raises(FormatError, match="this key does not open it, or it was changed"):
            diary.check()


# --- deleting -------------------------------------------------------------------------------------


def files_beside(path: Path) -> bytes:
    return b"".join(
        (path.parent / name).read_bytes()
        for name in os.listdir(path.parent)
        if name.startswith(path.name)
    )


def payloads(path: Path) -> list[bytes]:
    """Return all blobs of the file as stored, except the last hash of the audit."""
    found: list[bytes] = []
    with contextlib.closing(sqlite3.connect(path)) as raw:
        for (name,) in raw.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name != 'meta'"
        ).fetchall():
            for row in raw.execute(f"SELECT * FROM {name}").fetchall():
                found += [value for value in row if isinstance(value, bytes) and len(value) > 13]
    return found


def remains(blob: bytes, files: bytes) -> bool:
    """Whether any part of a blob remains in the files; SQLite stores large blobs in pieces."""
    pieces = [blob[at : at + 64] for at in range(0, len(blob) - 63, 64)] or [blob]
    return any(piece in files for piece in pieces)


def test_no_byte_of_a_deleted_participant_remains(diary: Diary, key: Path | None) -> None:
    for name in ("P01", "Zebra-77", "P03"):
        session = fill(diary, name)
        for number in range(40):
            diary.add_game(session, game(6 + number, seed=880_000 + number))
    kept = set(payloads(diary.path))
    with contextlib.closing(sqlite3.connect(diary.path)) as raw:
        number = diary.participant("Zebra-77").number
        theirs = []
        ids = [number]
        for table in (
            "sessions", "games", "anomalies", "clips", "ratings", "questionnaires", "events"
        ):  # fmt: skip
            for row in raw.execute(f"SELECT id, payload FROM {table} WHERE participant = {number}"):
                ids.append(row[0])
                theirs.append(row[1])
        theirs += raw.execute(f"SELECT key FROM participants WHERE id = {number}").fetchone()
        theirs += raw.execute(f"SELECT payload FROM participants WHERE id = {number}").fetchone()
    theirs = [blob for blob in theirs if blob]
    assert len(theirs) > 120
    before = files_beside(diary.path)
    assert all(remains(blob, before) for blob in theirs)
    diary.delete("Zebra-77")
    after = files_beside(diary.path)
    assert b"Zebra" not in after  # in pictures neither
    for blob in theirs:
        if blob not in set(payloads(diary.path)):  # in plain, others may have said the very same
            assert blob not in after
            assert len(blob) < 1000 or not remains(blob, after)
            assert blob[13:] not in after or key is None
    for one in ids:
        assert one.to_bytes(8, "big") not in after
    assert set(payloads(diary.path)) <= kept
    assert [person.identifier for person in diary.participants()] == ["P01", "P03"]
    assert len(diary.sessions("P03")[0].games) == 41
    assert diary.audit()[-1][1:] == ("delete", "")
    assert not [whose for _, _, whose in diary.audit() if whose == "Zebra-77"]
    diary.check()


def test_who_takes_back_consent_is_filmed_no_longer(diary: Diary, key: Path | None) -> None:
    session = fill(diary, "Zebra-77")
    fill(diary, "P02")
    with contextlib.closing(sqlite3.connect(diary.path)) as raw:
        stored = [row[0] for row in raw.execute("SELECT payload FROM clips")]
    assert len(stored) == 4
    before = files_beside(diary.path)
    assert all(remains(one, before) for one in stored)
    diary.set_consent("Zebra-77", clips=False)
    assert diary.participant("Zebra-77").clips is False
    assert diary.clips("Zebra-77") == []
    assert len(diary.clips("P02")) == 2
    after = files_beside(diary.path)
    assert sum(remains(one, after) for one in stored) == 2
    assert b"picture of Zebra" not in after
    assert diary.sessions("Zebra-77")[0].games[0].anomalies == ((4.0, 16.5), (30.0, 44.0))
    with pytest.raises(InputError, match="did not consent"):
        diary.add_game(session, game(9), [[(0.0, jpeg("x"))], []])
    diary.add_game(session, game(9), [[], []])
    diary.set_consent("Zebra-77", clips=True)
    diary.add_game(session, game(10), [[(0.0, jpeg("x"))], []])
    assert len(diary.clips("Zebra-77")) == 1
    assert [action for _, action, _ in diary.audit()].count("no consent") == 1
    diary.check()


def test_damaged_clips_are_said_to_be() -> None:
    from manip3d.diary._clips import pack, unpack

    chance = random.Random(2)
    whole = pack([(0.1 * number, jpeg("x", 50 + number)) for number in range(5)])
    assert len(unpack(whole, "clip")) == 5
    refused = 0
    for _ in range(5000):
        found = bytearray(whole[: chance.randrange(len(whole) + 1)])
        for _ in range(chance.randrange(4)):
            if found:
                found[chance.randrange(len(found))] = chance.randrange(256)
        try:
            pictures = unpack(bytes(found), "clip")
            assert sum(len(content) for _, content in pictures) < len(whole)
        except FormatError:
            refused += 1
    assert refused > 2500


def test_clips_that_are_none(diary: Diary) -> None:
    session = fill(diary)
    for clips, message in (
        ([[(0.0, jpeg("x"))]], "clips: expected 2, got 1"),
        ([[(0.0, b"GIF89a")], []], "expected JPEG"),
        ([[(2.0, jpeg("x")), (1.0, jpeg("x"))], []], "times that do not fall"),
        ([[(-1.0, jpeg("x"))], []], "times that do not fall"),
        ([[(float("nan"), jpeg("x"))], []], "times that do not fall"),
        ([[(0.0, jpeg("x", 65_000_000))], []], "at most 64000000 bytes"),
    ):
        with pytest.raises(InputError, match=message):
            diary.add_game(session, game(9), clips)
    assert len(diary.sessions("P01")[0].games) == 1


def test_nothing_is_deleted_while_another_program_reads(diary: Diary) -> None:
    fill(diary)
    with contextlib.closing(sqlite3.connect(diary.path)) as other:
        other.execute("BEGIN")
        other.execute("SELECT count(*) FROM games").fetchone()
        with pytest.raises(OSError, match="another program has the diary open; nothing deleted"):
            diary.delete("P01")
        other.rollback()
    assert len(diary.participants()) == 1
    diary.delete("P01")
    assert diary.participants() == []


def test_a_file_that_cannot_be_written_anew_is_an_error_of_ours(diary: Diary) -> None:
    fill(diary)
    fill(diary, "P02")

    def refuse_vacuum(raw: sqlite3.Connection, _: object) -> None:
        # VACUUM attaches the new file to the old one.
        raw.set_authorizer(
            lambda action, *_: (
                sqlite3.SQLITE_DENY if action == sqlite3.SQLITE_ATTACH else sqlite3.SQLITE_OK
            )
        )

    sql.event.listen(diary._file.engine, "connect", refuse_vacuum)
    with pytest.raises(OSError, match="deleted, but the file could not be written anew"):
        diary.delete("P02")
    with pytest.raises(OSError, match="deleted, but the file could not be written anew"):
        diary.set_consent("P01", clips=False)
    sql.event.remove(diary._file.engine, "connect", refuse_vacuum)
    assert [one.identifier for one in diary.participants()] == ["P01"]
    assert diary.clips("P01") == []
    assert b"picture of P02" not in files_beside(diary.path)
    diary.check()


# --- versions -------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", range(1, schema.VERSION))
def test_an_older_file_becomes_one_of_today(tmp_path: Path, key: Path | None, version: int) -> None:
    """A file with the tables of an older version is migrated to those of a new file."""
    path = tmp_path / "old.diary"
    with Diary(path, key=key, create=True) as today:
        today.enrol("P01", at=START)
        session = today.start_session("P01", at=START)
        today.add_game(session, game(anomalies=()))
    with contextlib.closing(sqlite3.connect(path)) as raw:  # back to what that version knew
        for name in ("anomalies", "ratings", "questionnaires", "events") if version < 2 else ():
            raw.execute(f"DROP TABLE {name}")
        put_back_old_audit(raw)
        for (name,) in raw.execute(
            "SELECT name FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL"
        ).fetchall():
            raw.execute(f"DROP INDEX {name}")
        raw.execute("DROP TABLE clips")
        for statements in schema.MIGRATIONS[2:version]:
            for statement in statements:
                raw.execute(statement)
        # Games said less then.
        payloads = raw.execute("SELECT id, payload FROM games").fetchall()
        for number, payload in payloads if key is None else ():
            fields = json.loads(payload)
            for name in ("limb", "source", "version", "latency_ms", "tracked"):
                del fields[name]
            text = json.dumps(fields).encode()
            raw.execute("UPDATE games SET payload = ? WHERE id = ?", (text, number))
        if version < schema.WITH_STUDY:
            raw.execute("DELETE FROM meta WHERE name = 'study'")
        raw.execute(f"PRAGMA user_version = {version}")
        raw.commit()
    assert shape(path) == shape_of_version(tmp_path / "made", version)
    with Diary(path, key=key) as again:
        told = {} if key else {"limb": "", "source": "", "version": "", "latency_ms": None,
                               "tracked": None}  # fmt: skip
        assert again.sessions("P01")[0].games == (game(anomalies=(), **told),)
        again.add_rating("P01", 5)
        again.check()
        assert [row[1:] for row in again.audit()] == [
            ("enrol", "P01"), ("session", "P01"), ("rating", "P01")
        ]  # fmt: skip
        study = again.study
    assert re.fullmatch("[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", study)
    with Diary(path, key=key) as once_more:
        assert once_more.study == study
    assert (study.encode() in path.read_bytes()) == (key is None)
    assert shape(path) == shape_of_version(tmp_path / "now", schema.VERSION)


def test_a_wrong_key_changes_nothing_in_an_older_file(tmp_path: Path) -> None:
    """A wrong key is refused before the migration, which would write the study's name with it."""
    make_key(tmp_path / "a.key")
    make_key(tmp_path / "b.key")
    path = tmp_path / "old.diary"
    with Diary(path, key=tmp_path / "a.key", create=True):
        pass
    with contextlib.closing(sqlite3.connect(path)) as raw:
        raw.execute("DELETE FROM meta WHERE name != 'check'")
        raw.execute("DROP TABLE audit")
        raw.execute(schema.MIGRATIONS[0][-1])
        raw.execute("PRAGMA user_version = 5")
        raw.commit()
    with pytest.raises(FormatError, match="this key does not open it"):
        Diary(path, key=tmp_path / "b.key")
    with pytest.raises(InputError, match="is encrypted"):
        Diary(path)
    with Diary(path, key=tmp_path / "a.key") as diary:
        assert len(diary.study) == 36


def test_a_study_without_its_name_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "d"
    for change, message in (
        ("UPDATE meta SET value = x'ff00' WHERE name = 'study'", "expected a UUID of the study"),
        ("DELETE FROM meta WHERE name = 'study'", "expected a diary"),
    ):
        with Diary(path, create=True):
            pass
        with contextlib.closing(sqlite3.connect(path)) as raw:
            raw.execute(change)
            raw.commit()
        with pytest.raises(FormatError, match=message):
            Diary(path)
        path.unlink()


def put_back_old_audit(raw: sqlite3.Connection) -> None:
    """Put back an audit as before version 7: without hashes, and with rows in any order."""
    (whose,) = raw.execute("SELECT id FROM participants").fetchone()
    raw.execute("DROP TABLE audit")
    raw.execute(schema.MIGRATIONS[0][-1])
    raw.executemany(
        "INSERT INTO audit VALUES (?, ?, ?, ?)",
        [
            (3, "2026-03-02T09:30:00-06:00", "session", whose),  # an hour later than ...
            (5, "2026-03-02T15:30:00+01:00", "enrol", whose),
        ],
    )
    raw.execute("DELETE FROM meta WHERE name LIKE 'audit%'")


def shape(path: Path) -> set[tuple[str, ...]]:
    with contextlib.closing(sqlite3.connect(path)) as raw:
        return set(raw.execute("SELECT type, name, sql FROM sqlite_master").fetchall())


def shape_of_version(path: Path, version: int) -> set[tuple[str, ...]]:
    engine = sql.create_engine(f"sqlite:///{path}", poolclass=sql.pool.NullPool)
    with engine.begin() as connection:
        schema.migrate(connection, 0, version)
    return shape(path)


def test_the_tables_of_the_code_are_those_of_the_file(tmp_path: Path) -> None:
    with Diary(tmp_path / "d", create=True):
        pass
    with contextlib.closing(sqlite3.connect(tmp_path / "d")) as raw:
        for name, table in schema._metadata.tables.items():
            columns = [row[1] for row in raw.execute(f"PRAGMA table_info({name})")]
            assert sorted(columns) == sorted(column.name for column in table.columns)


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("not a diary at all, but long enough to be read as one" * 9)
    with contextlib.closing(sqlite3.connect(tmp_path / "other")) as raw:
        raw.execute("CREATE TABLE things (a)")
        raw.commit()
    (tmp_path / "empty").write_bytes(b"")
    before = (tmp_path / "other").read_bytes()
    for name in ("text", "other", "empty"):
        with pytest.raises(FormatError, match="expected a diary"):
            Diary(tmp_path / name)
    for name in ("text", "other", "empty"):
        with pytest.raises(FormatError, match="expected a diary"):
            Diary(tmp_path / name, create=True)
    assert (tmp_path / "empty").stat().st_size == 0
    assert (tmp_path / "other").read_bytes() == before
    with pytest.raises(FileNotFoundError):
        Diary(tmp_path / "absent")
    assert not (tmp_path / "absent").exists()
    with pytest.raises(FormatError, match="expected a regular file"):
        Diary(tmp_path)
    with Diary(tmp_path / "later", create=True):
        pass
    with contextlib.closing(sqlite3.connect(tmp_path / "later")) as raw:
        raw.execute("PRAGMA user_version = 99")
    with pytest.raises(FormatError, match="of version 7 at most, got 99"):
        Diary(tmp_path / "later")


@pytest.mark.parametrize("has_links", [True, False])
def test_an_empty_file_is_not_taken_for_a_new_diary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool
) -> None:
    """An empty file is refused, because it may stand in the place of a diary that was moved."""

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "no hard links here")

    if not has_links:
        monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "study.diary"
    path.touch()
    for create in (False, True):
        with pytest.raises(FormatError, match="got an empty file: put the diary back in its place"):
            Diary(path, create=create)
    path.unlink()
    with Diary(path, create=True) as diary:
        diary.enrol("P01")


def test_a_diary_that_is_moved_away_is_asked_for_and_not_replaced(tmp_path: Path) -> None:
    path, moved = tmp_path / "study.diary", tmp_path / "moved.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", clips=True)
        path.rename(moved)
        for write in (
            lambda: diary.start_session("P01"),
            lambda: diary.set_consent("P01", clips=False),
        ):
            with pytest.raises(OSError, match=f"the diary is no longer at {path}; put it back"):
                write()
        assert [each.name for each in tmp_path.iterdir()] == [moved.name]
        moved.rename(path)
        diary.start_session("P01")
    with Diary(path) as diary:
        assert len(diary.sessions("P01")) == 1


def test_the_place_of_a_diary_is_told_after_a_change_of_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a change of directory, the relative path of a diary still means its own file."""
    monkeypatch.chdir(tmp_path)
    with Diary("study.diary", create=True) as diary:
        diary.enrol("P01")
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir("elsewhere")
        path = tmp_path / "study.diary"
        with contextlib.closing(sqlite3.connect(path)) as other:
            other.execute("BEGIN")
            other.execute("SELECT count(*) FROM games").fetchone()
            with pytest.raises(OSError, match=f"^{path}: another program has the diary open"):
                diary.delete("P01")
        path.rename(tmp_path / "moved.diary")
        with pytest.raises(OSError, match=f"the diary is no longer at {path}; put it back"):
            diary.enrol("P02")


@pytest.mark.parametrize("part", ["tables", "page", "payload"])
def test_a_damaged_file_is_said_to_be(tmp_path: Path, part: str) -> None:
    path = tmp_path / "d"
    with Diary(path, create=True) as diary:
        session = fill(diary)
        for number in range(60):
            diary.add_game(session, game(number))
    content = bytearray(path.read_bytes())
    where = {"tables": 100, "page": 4096 * 2, "payload": content.index(b'"score":17')}[part]
    content[where : where + 9] = b"\xa5" * 9
    path.write_bytes(content)
    with pytest.raises(FormatError), Diary(path) as damaged:
        damaged.check()


# --- protocol -------------------------------------------------------------------------------------


def sitting(day: int, hour: int = 9, games: int = 3, **changes: Any) -> DiarySession:
    start = START.replace(hour=hour) + timedelta(days=day)
    return DiarySession(1, start, None, (game(**{"at": start, **changes}),) * games, ())


@pytest.mark.parametrize("name", ["weeks", "sessions_a_day", "games_a_session"])
def test_a_protocol_asks_for_something(name: str) -> None:
    for value in (0, -1):
        with pytest.raises(InputError, match=f"{name}: expected >= 1, got {value}"):
            Protocol(**{name: value})


@pytest.mark.usefixtures("local_zone")
def test_adherence_counts_whole_sessions_up_to_two_a_day() -> None:
    sessions = [sitting(0), sitting(0, 17), sitting(0, 20), sitting(1), sitting(1, 17, games=2),
                sitting(2, games=0), sitting(3, ending="stopped"), sitting(30),
                sitting(3, ending="interrupted")]  # fmt: skip
    found = adherence(sessions, START, date(2026, 3, 5))
    assert (found.days, found.expected) == (4, 8)
    assert (found.complete, found.partial, found.days_played) == (3, 1, 2)
    assert found.share == 3 / 8
    whole = adherence([sitting(d, h) for d in range(28) for h in (9, 18)], START, date(2027, 1, 1))
    assert (whole.days, whole.expected, whole.complete, whole.share) == (28, 56, 56, 1.0)
    short = adherence(sessions, START, date(2026, 3, 5), protocol=Protocol(1, 1, 2))
    assert (short.expected, short.complete) == (4, 2)
    played = [sitting(0, source="mkv:"), sitting(1), sitting(1, 17, source="sim:body?seed=1")]
    found = adherence(played, START, date(2026, 3, 5))
    assert (found.complete, found.partial, found.simulated) == (2, 0, 3)
    with pytest.raises(InputError, match="today: expected 2026-03-02 or later"):
        adherence([], START, date(2026, 3, 1))


@pytest.mark.usefixtures("local_zone")
def test_a_session_counts_on_the_day_on_which_its_games_were_played() -> None:
    """Games after midnight count on their own day, although the session began before."""
    evening, night = START.replace(hour=23, minute=50), START.replace(hour=0) + timedelta(days=1)
    stopped = game(at=evening, ending="stopped")
    session = DiarySession(1, evening, None, (stopped, *(game(at=night),) * 3), ())
    first = adherence([session], START, START.date())
    assert (first.complete, first.days_played) == (0, 0)
    second = adherence([session], START + timedelta(days=1), START.date() + timedelta(days=1))
    assert (second.complete, second.days_played) == (1, 1)


@pytest.fixture
def read_only(diary: Diary, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the path of a filled diary whose folder is said to be one that cannot be written."""
    fill(diary)
    diary.close()
    access = os.access
    monkeypatch.setattr(
        "manip3d.diary._file.os.access",
        lambda path, mode: mode != os.W_OK and access(path, mode),
    )
    return diary.path


def test_a_diary_that_cannot_be_written_is_read(read_only: Path, key: Path | None) -> None:
    before = read_only.read_bytes()
    with Diary(read_only, key=key) as diary:
        assert [one.identifier for one in diary.participants()] == ["P01"]
        assert diary.sessions("P01")
        diary.check()
        for write in (
            lambda: diary.add_rating("P01", 3),
            lambda: diary.enrol("P02"),
            lambda: diary.delete("P01"),
            lambda: diary.set_consent("P01", clips=False),
        ):
            with pytest.raises(OSError, match=r"the diary can only be read, .*: copy it into a"):
                write()
        with pytest.raises(OSError, match=r"can only be read, .*; nothing was exported, because"):
            diary.note_export("P01")
    assert read_only.read_bytes() == before
    assert list(read_only.parent.glob(f"*{read_only.name}?*")) == []


def test_a_diary_that_changes_while_it_can_only_be_read_is_told(
    read_only: Path, key: Path | None
) -> None:
    """Another computer may write into a folder that this one can only read."""
    diary = Diary(read_only, key=key)
    with (
        pytest.raises(OSError, match="another program wrote to the diary meanwhile"),
        diary._file.begin(),
    ):
        os.utime(read_only, ns=(0, 0))


def test_a_diary_that_changes_while_it_is_read_is_no_damage(
    read_only: Path, key: Path | None
) -> None:
    """Pages from before and after the change do not fit together."""
    diary, whole = Diary(read_only, key=key), read_only.read_bytes()

    def read_while_another_program_writes() -> None:
        with diary._file.begin() as rows:
            read_only.write_bytes(whole[:4096] + b"\xff" * (len(whole) - 4096))
            rows.find("P01")

    with pytest.raises(OSError, match="another program wrote to the diary meanwhile"):
        read_while_another_program_writes()
    with pytest.raises(FormatError, match="the diary is damaged"):  # nobody writes now
        diary.participants()


def test_a_diary_that_changes_while_it_is_opened_is_no_damage(
    read_only: Path, key: Path | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found_damaged(*_: Any) -> None:
        os.utime(read_only, ns=(0, 0))
        raise FormatError("the diary is damaged: row 3 missing from index", file=str(read_only))

    monkeypatch.setattr(DiaryFile, "_check_pages", found_damaged)
    with pytest.raises(OSError, match="another program wrote to the diary meanwhile"):
        Diary(read_only, key=key)


def test_a_change_is_noticed_although_the_log_was_there_at_the_beginning(
    read_only: Path, key: Path | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program closes the diary, and thereby removes the log, before the file is opened."""
    diary, log = Diary(read_only, key=key), Path(f"{read_only}-wal")
    log.write_bytes(bytes(32))
    begin = DiaryFile._connect

    def without_log(file: DiaryFile) -> sqlite3.Connection:
        log.unlink()
        return begin(file)

    monkeypatch.setattr(DiaryFile, "_connect", without_log)
    with (
        pytest.raises(OSError, match="another program wrote to the diary meanwhile"),
        diary._file.begin(),
    ):
        os.utime(read_only, ns=(0, 0))


def test_a_log_that_goes_away_is_not_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("manip3d.diary._file.os.path.exists", lambda _: True)
    assert not is_filled(tmp_path / "study.diary-wal")


def test_a_diary_can_be_written_again_after_it_was_read_only(
    diary: Diary, key: Path | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite gives the files that it makes beside a diary the mode of the diary."""
    fill(diary)
    diary.close()
    diary.path.chmod(0o444)
    access = os.access
    with monkeypatch.context() as patch:
        patch.setattr(
            "manip3d.diary._file.os.access",
            lambda path, mode: access(path, mode) and (mode != os.W_OK or Path(path).is_dir()),
        )
        with Diary(diary.path, key=key) as again:
            assert again.sessions("P01")
    assert list(diary.path.parent.glob(f"*{diary.path.name}?*")) == []


def test_an_older_diary_that_cannot_be_written_is_not_read(
    read_only: Path, key: Path | None
) -> None:
    with contextlib.closing(sqlite3.connect(read_only)) as plain:
        plain.execute(f"PRAGMA user_version = {schema.VERSION - 1}")
    with pytest.raises(OSError, match="an earlier manip3d wrote the diary, which must be changed"):
        Diary(read_only, key=key)


LEAVES_A_LOG = """
import os, sqlite3, sys
from manip3d.diary import Diary
diary = Diary(sys.argv[1])
other = sqlite3.connect(sys.argv[1])
other.execute("SELECT count(*) FROM meta").fetchone()
diary.add_rating("P01", 5)
os._exit(9)
"""
READS = """
import sys
from manip3d.diary import Diary
with Diary(sys.argv[1]) as diary:
    print([rating.pain for rating in diary.ratings("P01")])
"""


def test_a_log_in_a_folder_on_a_disk_that_cannot_be_written_is_not_passed_over(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    path = folder / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01")
        diary.add_rating("P01", 3)
    mount = f"mount --bind {folder} {folder} && mount -o remount,ro,bind {folder} && exec "
    namespace = ["unshare", "-rm", "sh", "-c"]
    if subprocess.run([*namespace, f"{mount} true"], check=False).returncode:
        pytest.skip("no mount namespaces here")

    def read() -> subprocess.CompletedProcess[str]:
        script = f'{mount} {sys.executable} -c "$0" {path}'
        return subprocess.run([*namespace, script, READS], capture_output=True, text=True,
                              check=False)  # fmt: skip

    assert read().stdout == "[3]\n"
    killed = subprocess.run([sys.executable, "-c", LEAVES_A_LOG, path], check=False)
    assert killed.returncode == 9
    assert read().stdout == "[3, 5]\n"
    path.with_name("study.diary-shm").unlink()  # without this index, a log cannot be read
    assert "study.diary-wal holds the last entries, and the folder cannot be" in read().stderr


def test_an_export_that_the_audit_cannot_name_is_not_made(diary: Diary, tmp_path: Path) -> None:
    """The disk of the diary is full; the export would have room."""
    fill(diary)
    with diary._file.begin() as rows:
        pages = rows.connection.exec_driver_sql("PRAGMA page_count").scalar_one()
    sql.event.listen(
        diary._file.engine,
        "connect",
        lambda raw, _: raw.execute(f"PRAGMA max_page_count = {pages}"),
    )
    told = r"disk is full; nothing was exported, .*'manip3d diary rescue' copies the diary"
    with contextlib.suppress(OSError):
        for _ in range(1000):  # until the last page is full
            diary.note_export("P01")
    number = len(diary.audit())
    with pytest.raises(OSError, match=told):
        export_csv(diary, tmp_path / "tables")
    assert not (tmp_path / "tables").exists()
    assert len(diary.audit()) == number
    note = tmp_path / "note.txt"
    note.write_text("a" * 100)
    with pytest.raises(OSError, match=r"disk is full; exported, but the diary does not list"):
        diary.note_files("P01", [_copied(note, number) for number in range(300)])


def _copied(file: Path, number: int) -> Path:
    return Path(shutil.copyfile(file, file.with_name(f"{number} {file.name}")))


def test_a_full_disk_leaves_no_part_of_a_new_diary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "study.diary"
    with monkeypatch.context() as patched:
        # Another failure of SQLite, told in the same way: no disk is full here.
        patched.setattr(schema, "migrate", lambda connection, _: connection.exec_driver_sql("no"))
        with pytest.raises(OSError, match=f"{path}: near "):
            Diary(path, create=True)
    assert list(tmp_path.iterdir()) == []
    with Diary(path, create=True) as diary:
        fill(diary)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    "value",
    [["\x1b[31m"], {"c": "\x00"}, {"\x07": 1}, {"deep": [{"er": ("calm", "\x1b[2J")}]}],
    ids=["list", "mapping", "key", "nested"],
)  # fmt: skip
def test_nested_texts_have_no_control_characters(tmp_path: Path, value: Any) -> None:
    with Diary(tmp_path / "a.diary", create=True) as diary:
        diary.enrol("P01")
        with diary._file.begin() as rows:
            participant = rows.find("P01")
            for write in (
                lambda: rows.change(participant, {"told": value}),
                lambda: rows.enrol({"identifier": "P02", "told": value}),
                lambda: rows.add(schema.EVENTS, participant, {"told": value}, session=None),
            ):
                with pytest.raises(InputError, match="told: expected a text without control"):
                    write()


@pytest.mark.parametrize("name", ["a\x1b[31m", "line\nfeed", "caf\udce9"])
def test_a_path_that_cannot_be_listed_is_refused_before_the_export(
    tmp_path: Path, name: str
) -> None:
    """A participant's files must be found and shown again when the participant withdraws."""
    with Diary(tmp_path / "a.diary", create=True) as diary:
        diary.enrol("P01")
        before = diary.audit()
        for export in (
            lambda path: export_csv(diary, path),
            lambda path: export_fhir(diary, path, "P01"),
            lambda path: export_clips(diary, path, "P01"),
            lambda path: write_page(diary, path, "P01"),
            lambda path: write_overview(diary, path),
        ):
            with pytest.raises(InputError, match="output: expected a path of UTF-8 without"):
                export(tmp_path / name)
        with pytest.raises(InputError, match="files: expected a path of UTF-8 without"):
            diary.note_files("P01", [tmp_path / name])
        assert diary.audit() == before
        assert not (tmp_path / name).exists()


def test_a_change_of_a_participant_who_is_gone_is_refused(tmp_path: Path) -> None:
    with Diary(tmp_path / "a.diary", create=True) as diary:
        diary.enrol("P01")
        with diary._file.begin() as rows:
            participant = rows.find("P01")
        diary.delete("P01")
        with (
            pytest.raises(InputError, match="'P01' is no longer enrolled"),
            diary._file.begin() as rows,
        ):
            rows.change(participant, {"clips": True})


def test_a_session_without_its_participant_is_a_damaged_diary(tmp_path: Path) -> None:
    with Diary(tmp_path / "a.diary", create=True) as diary:
        diary.enrol("P01")
        session = diary.start_session("P01")
        with diary._file.begin() as rows:
            rows.everybody = list  # type: ignore[method-assign]
            with pytest.raises(FormatError, match="rows without a participant"):
                rows.find_by_session(session)
