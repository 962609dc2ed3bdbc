"""`Diary`: an SQLite file with all sessions of a study's participants; this part writes it."""

from __future__ import annotations

import contextlib
import math
import os
import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from manip3d._util.arrays import one_line
from manip3d._util.checked import checked
from manip3d._util.paths import legible_path_of
from manip3d.diary import _schema as schema
from manip3d.diary._clips import Pictures
from manip3d.diary._file import BESIDE
from manip3d.diary._mcgill import score_mcgill
from manip3d.diary._protocol import judge_rating
from manip3d.diary._questionnaires import MCGILL, Questionnaire, definition_of
from manip3d.diary._reading import DiaryReading, sessions_of
from manip3d.diary._records import (
    Answers,
    DiaryGame,
    FeltRecord,
    McGill,
    Moment,
    Occasion,
    Ownership,
    Participant,
    aware,
    identifier_of,
)
from manip3d.diary._rows import DiaryTransaction, Enrolled, check_texts
from manip3d.diary._session_lock import SessionLock
from manip3d.errors import InputError
from manip3d.io._files import sha256_of
from manip3d.modify import Limb

_GAME = re.compile(r"[^/\\\n]{1,64}")
"""Names of games: one line that cannot be taken for a path."""
_ENDINGS = ("time", "misses", "done", "stopped", "interrupted")


@checked
class Diary(DiaryReading):
    """A diary file. Each method returns after its data are on the disk.

    One file contains all participants of a study, each under a pseudonym. With a key, each
    participant's data are encrypted with a key of their own, which the diary's key encrypts;
    without a key they are plain JSON in SQLite. A file that cannot be written, or whose folder
    cannot, is opened to be read only: methods that write then raise an OSError. Research software,
    no medical device.

    Parameters
    ----------
    path : path
        Path of the file.
    key : path, optional
        Key file made by `make_key`; default: the diary is not encrypted.
    create : bool
        Create a new diary if the file does not exist.

    Raises
    ------
    InputError
        The diary is encrypted and no key is given, or a key is given for a plain diary.
    FormatError
        The file is not a diary, has a later version, or was encrypted with another key.
    OSError
        The file does not exist or cannot be opened.

    Examples
    --------
    >>> from manip3d.diary import Diary
    >>> with Diary("study.diary", create=True) as diary:
    ...     _ = diary.enrol("P01", limb="left_leg")
    ...     session = diary.start_session("P01")
    ...     diary.add_rating("P01", 4, session=session)
    ...     [found.pain_before for found in diary.sessions("P01")]
    ''
    [4]
    """

    def enrol(
        self, identifier: str, *, limb: str = "", clips: bool = False, at: datetime | None = None
    ) -> Participant:
        """Add a participant.

        Parameters
        ----------
        identifier : str
            Pseudonym: letters (A to Z and a to z), digits, dots, hyphens and underscores.
        limb : {"left_arm", "right_arm", "left_leg", "right_leg"}, optional
            The affected limb; empty: unknown.
        clips : bool
            Whether the participant consented to clips of anomalies; `set_consent` changes it.
        at : datetime, optional
            Time of the enrolment, from which the protocol's days are counted; default: now.

        Returns
        -------
        Participant

        Raises
        ------
        InputError
            The pseudonym is invalid or already used (ignoring case), the limb is unknown, or the
            time has no offset from UTC.
        """
        name = identifier_of(identifier)
        _check_limb(limb)
        moment = aware(at)
        fields = {"identifier": name, "limb": limb, "enrolled": moment.isoformat(), "clips": clips}
        with self._file.begin() as rows:
            for participant in rows.everybody():
                taken = participant.fields["identifier"]
                # Many file systems ignore case, so that files with these names would be the same.
                if taken.casefold() == name.casefold():
                    raise InputError(f"participant: {taken} is enrolled already")
            number = rows.enrol(fields)
            rows.note("enrol", number)
        return Participant(name, limb, moment, clips, number)

    def set_consent(self, identifier: str, *, clips: bool) -> None:
        """Set whether a participant consents to clips; without consent, their clips are deleted.

        Films that were exported before are not deleted: see `exports` and `ExportedFile.has_films`.
        Consent can also be withdrawn during a live session, which then keeps no films.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        clips : bool

        Raises
        ------
        InputError
            No such participant.
        OSError
            There are clips to delete while another program has the diary open: nothing was changed.
            Or the file could not be rewritten: the clips are deleted and overwritten with zeros.
        """
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            if clips or not rows.has_clips(participant):
                _write_consent(rows, participant, clips)
                return
        with self._file.begin_without_remains() as rows:
            participant = rows.find(identifier)
            _write_consent(rows, participant, clips)
            rows.delete_clips(participant)

    def start_session(self, identifier: str, *, at: datetime | None = None) -> int:
        """Begin a session.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        at : datetime, optional
            Time of the start; default: now.

        Returns
        -------
        int
            Number of the session, for `add_game` and other methods.

        Raises
        ------
        InputError
            No such participant.
        """
        fields = {"started": aware(at).isoformat(), "ended": None}
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            session = rows.add(schema.SESSIONS, participant, fields)
            rows.note("session", participant.number)
        return session

    def begin_play(self, session: int, *, at: datetime | None = None) -> None:
        """Record the start of the first game or touch cue of a session; later calls change nothing.

        Pain ratings after this call are recorded as ``after``.

        Parameters
        ----------
        session : int
            Number returned by `start_session`.
        at : datetime, optional
            Time of the start; default: now.

        Raises
        ------
        InputError
            No such session.
        """
        self._set_time(session, "begun", aware(at), keep=True)

    def end_session(
        self, session: int, *, at: datetime | None = None, answered: bool = True
    ) -> None:
        """Record the end of a session.

        Parameters
        ----------
        session : int
            Number returned by `start_session`.
        at : datetime, optional
            Time of the end; default: now. `DiarySession.clock_went_back` tells if it lies before
            the start.
        answered : bool
            False: the patient was asked for a last rating of the pain and gave none.

        Raises
        ------
        InputError
            No such session.
        """
        self._set_time(session, "ended", aware(at), about={"answered": answered})

    def _set_time(
        self,
        session: int,
        name: str,
        at: datetime,
        *,
        keep: bool = False,
        about: Mapping[str, bool] | None = None,
    ) -> None:
        """Set a time of a session and further fields; ``keep``: do not replace an existing time."""
        with self._file.begin() as rows:
            participant = rows.find_by_session(session)
            fields = rows.read_one(schema.SESSIONS, session, participant)
            if keep and fields.get(name):
                return
            fields |= {name: at.isoformat(), **(about or {})}
            rows.replace(schema.SESSIONS, session, participant, fields)

    def add_game(
        self,
        session: int,
        game: DiaryGame,
        clips: Sequence[Pictures] = (),
        *,
        replaces: int | None = None,
    ) -> int:
        """Store a game with its anomalies: times without a point despite a target in reach.

        A game in progress is stored as ``interrupted``, so that it is recorded even if the program
        is killed, and replaced later.

        Parameters
        ----------
        session : int
            Number returned by `start_session`.
        game : DiaryGame
        clips : sequence of sequences of (float, bytes)
            Pictures of each anomaly, which may be empty: time of play in seconds, and JPEG image.
            Default: no clips.
        replaces : int, optional
            Number of the earlier record of the same game.

        Returns
        -------
        int
            Number of the record, for ``replaces``.

        Raises
        ------
        InputError
            An unknown session, limb, ending or ``replaces``; a name of a game with a slash or a
            backslash; anomalies that are no pairs; a number that is not finite, not whole though it
            must be, or impossible, such as a negative duration; clips of a participant who did not
            consent; or numbers of clips and of anomalies differ.
        """
        if clips and len(clips) != len(game.anomalies):
            raise InputError(f"clips: expected {len(game.anomalies)}, got {len(clips)}")
        fields = _fields_of(game)
        anomalies = fields.pop("anomalies")
        with self._file.begin() as rows:
            participant = rows.find_by_session(session)
            if replaces is None:
                row = rows.add(schema.GAMES, participant, fields, session=session)
                rows.note("game", participant.number)
            else:
                row = replaces
                if not rows.replace(schema.GAMES, row, participant, fields, session=session):
                    raise InputError(f"replaces: session {session} has no game number {row}")
                rows.delete_anomalies(row)
            if any(clips) and not participant.fields.get("clips", False):
                raise InputError("clips: expected none, as the participant did not consent")
            for which, (start, end) in enumerate(anomalies):
                part = {"start": start, "end": end}
                anomaly = rows.add(schema.ANOMALIES, participant, part, game=row)
                if clips and clips[which]:
                    rows.add_clip(participant, anomaly, clips[which])
        return row

    def add_rating(
        self,
        identifier: str,
        pain: int,
        *,
        session: int | None = None,
        when: Moment | None = None,
        at: datetime | None = None,
        reason: str = "",
    ) -> str:
        """Store a rating of the pain.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        pain : int
            Intensity, 0 (no pain) to 10 (worst pain).
        session : int, optional
            Number returned by `start_session`; default: the rating belongs to no session.
        when : {"before", "after", "other"}, optional
            Time of the rating relative to play. Default: ``before`` until the first game or touch
            cue of the session begins (see `begin_play`), then ``after``; ``other`` without a
            session.
        at : datetime, optional
            Time of the rating; default: now.
        reason : str
            Reason why the session must stop that the caller found in ratings of other sessions, at
            most 2000 characters. It is stored and returned if the ratings of this session give no
            reason.

        Returns
        -------
        str
            Reason why the session must stop, if the pain is 2 or more above the first rating of the
            session (or above a second rating that corrects it within 30 seconds, before any play).
            Ratings of ``other`` times are not compared. The reason is also stored as an adverse
            event, in the same transaction as the rating. In all other cases ``reason``.

        Raises
        ------
        InputError
            An unknown participant or session, an invalid rating, or a reason that is too long or
            has control characters.
        """
        if len(reason) > 2000:
            raise InputError(f"reason: expected at most 2000 characters, got {len(reason)}")
        check_texts({"reason": reason})
        if not 0 <= pain <= 10:
            raise InputError(f"pain: expected 0 to 10, got {pain}")
        if when is not None and when not in get_args(Moment):
            raise InputError(f"when: expected {', '.join(get_args(Moment))}, got {when!r}")
        moment = aware(at)
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            fields: dict[str, Any] = {"at": moment.isoformat(), "pain": pain}
            if session is not None:
                rows.check_owner(session, participant)
                past = next(o for o in sessions_of(rows, participant) if o.number == session)
                when = when or ("after" if past.begun or past.games else "before")
                if when != "other":
                    reason = judge_rating(past.ratings, pain, moment, when=when) or reason
                fields["order"] = len(past.ratings)
            fields["when"] = when or "other"
            rows.add(schema.RATINGS, participant, fields, session=session)
            if reason:
                told = {"at": moment.isoformat(), "kind": "pain", "text": reason}
                rows.add(schema.EVENTS, participant, told, session=session)
            rows.note("rating", participant.number)
        return reason

    def add_mcgill(
        self,
        identifier: str,
        ranks: Sequence[int],
        ppi: int,
        *,
        occasion: Occasion,
        at: datetime | None = None,
    ) -> McGill:
        """Store a filled-in McGill Pain Questionnaire.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        ranks, ppi
            Answers, as for `score_mcgill`.
        occasion : {"baseline", "week-1", "week-4", "other"}
            Occasion of the study; at most one questionnaire for each of the first three.
        at : datetime, optional
            Time of the answers; default: now.

        Returns
        -------
        McGill

        Raises
        ------
        InputError
            An unknown participant or occasion, invalid answers, or an occasion that already has a
            questionnaire.
        """
        score = score_mcgill(ranks, ppi)
        given = tuple(int(rank) for rank in ranks)  # NumPy's integers become Python's
        moment = aware(at)
        fields = {"at": moment.isoformat(), "occasion": occasion, "ranks": given, "ppi": ppi}
        self._add_filled(identifier, fields)
        return McGill(moment, occasion, given, score)

    def add_answers(
        self,
        identifier: str,
        questionnaire: Questionnaire,
        answers: Sequence[int],
        *,
        occasion: Occasion = "other",
        session: int | None = None,
        at: datetime | None = None,
    ) -> Answers:
        """Store a filled-in questionnaire with its questions.

        A questionnaire with the same scores as `MCGILL` is stored as by `add_mcgill`, without its
        texts, so that `analyse` includes it.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        questionnaire : Questionnaire
        answers : sequence of int
            Answer to each question.
        occasion : {"baseline", "week-1", "week-4", "other"}
            Occasion of the study; for each of the first three at most one questionnaire of a name.
        session : int, optional
            Number returned by `start_session`; default: the answers belong to no session.
        at : datetime, optional
            Time of the answers; default: now.

        Returns
        -------
        Answers

        Raises
        ------
        InputError
            An unknown participant, session or occasion, invalid answers, or an occasion that
            already has a questionnaire of this name.
        """
        questionnaire.check_answers(answers)
        moment, given = aware(at), tuple(int(one) for one in answers)
        fields: dict[str, Any] = {"at": moment.isoformat(), "occasion": occasion}
        if questionnaire.scores_like(MCGILL):
            questionnaire = MCGILL
            fields |= {"ranks": given[:-1], "ppi": given[-1]}
        else:
            form = definition_of(questionnaire)
            fields |= {"kind": schema.FORM, "form": form, "answers": given}
        self._add_filled(identifier, fields, session)
        return Answers(moment, questionnaire, given, occasion)

    def _add_filled(
        self, identifier: str, fields: Mapping[str, Any], session: int | None = None
    ) -> None:
        """Store a filled-in questionnaire; refuse a second one of its name for an occasion."""
        occasion = fields["occasion"]
        if occasion not in get_args(Occasion):
            raise InputError(
                f"occasion: expected {', '.join(get_args(Occasion))}, got {occasion!r}"
            )

        def name(filled: Mapping[str, Any]) -> object:
            return filled.get("kind"), filled.get("form", {}).get("name"), filled.get("occasion")

        with self._file.begin() as rows:
            participant = rows.find(identifier)
            known = rows.read(schema.QUESTIONNAIRES, participant)
            if occasion != "other" and any(name(f) == name(fields) for _, f in known):
                raise InputError(f"occasion: {identifier} has a questionnaire of {occasion}")
            _keep_answers(rows, participant, fields, session)

    def add_ownership(
        self,
        identifier: str,
        mode: Literal["synchronous", "asynchronous"],
        answers: Sequence[int],
        *,
        session: int | None = None,
        at: datetime | None = None,
    ) -> Ownership:
        """Store the answers after a touch cue.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        mode : {"synchronous", "asynchronous"}
            Whether touch was seen and felt at the same time.
        answers : sequence of 6 int
            Answers from -3 (not at all) to 3 (very much); the first three are about ownership.
        session : int, optional
            Number returned by `start_session`; default: the answers belong to no session.
        at : datetime, optional
            Time of the answers; default: now.

        Returns
        -------
        Ownership

        Raises
        ------
        InputError
            No such participant, session or mode, or invalid answers.
        """
        given = tuple(int(one) for one in answers)
        if len(given) != 6 or not all(-3 <= one <= 3 for one in given):
            raise InputError(f"answers: expected 6 from -3 to 3, got {list(answers)}")
        moment = aware(at)
        fields = {
            "at": moment.isoformat(),
            "kind": schema.OWNERSHIP,
            "mode": mode,
            "answers": given,
        }
        self._add_answers(identifier, fields, session)
        return Ownership(moment, mode, given)

    def add_felt(
        self,
        identifier: str,
        *,
        length: int,
        telescoping: int,
        raised: int,
        bent: int,
        limb: str = "",
        session: int | None = None,
        at: datetime | None = None,
    ) -> FeltRecord:
        """Store a participant's description of the felt phantom limb.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        length, telescoping : int, per cent
            Felt length, 20 to 150 per cent of the intact limb's; and telescoping, 0 to 100, the
            share by which hand or foot is felt to have moved towards the stump.
        raised, bent : int, degrees
            Sideways elevation from hanging down, -30 to 180; and angle of elbow or knee, 0 to 150.
        limb : {"left_arm", "right_arm", "left_leg", "right_leg"}, optional
            The phantom limb; empty: the limb of the enrolment.
        session : int, optional
            Number returned by `start_session`; default: the record belongs to no session.
        at : datetime, optional
            Time of the description; default: now.

        Returns
        -------
        FeltRecord

        Raises
        ------
        InputError
            No such participant, session or limb, or a number out of range.
        """
        _check_limb(limb)
        numbers = {"length": length, "telescoping": telescoping, "raised": raised, "bent": bent}
        for name, low, high in (
            ("length", 20, 150), ("telescoping", 0, 100), ("raised", -30, 180), ("bent", 0, 150)
        ):  # fmt: skip
            if not low <= numbers[name] <= high:
                raise InputError(f"{name}: expected {low} to {high}, got {numbers[name]}")
        moment = aware(at)
        fields = {"at": moment.isoformat(), "kind": schema.FELT, "limb": limb, **numbers}
        self._add_answers(identifier, fields, session)
        return FeltRecord(moment, **numbers, limb=limb)

    def _add_answers(self, identifier: str, fields: Mapping[str, Any], session: int | None) -> None:
        with self._file.begin() as rows:
            _keep_answers(rows, rows.find(identifier), fields, session)

    def add_event(
        self,
        identifier: str,
        kind: Literal["pain", "sickness", "other"],
        text: str = "",
        *,
        session: int | None = None,
        at: datetime | None = None,
    ) -> None:
        """Store an adverse event.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        kind : {"pain", "sickness", "other"}
        text : str
            Description in the therapist's words, at most 2000 characters.
        session : int, optional
            Number returned by `start_session`; default: the event belongs to no session.
        at : datetime, optional
            Time of the event; default: now.

        Raises
        ------
        InputError
            No such participant, session or kind, or a text that is too long or has control
            characters other than line feeds.
        """
        check_event_text(text)
        fields = {"at": aware(at).isoformat(), "kind": kind, "text": text}
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            if session is not None:
                rows.check_owner(session, participant)
            rows.add(schema.EVENTS, participant, fields, session=session)
            rows.note("event", participant.number)

    def note_export(self, identifier: str) -> None:
        """Record in the audit that a participant's data were copied.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.

        Raises
        ------
        InputError
            No such participant.
        OSError
            The diary cannot be written. Then nothing may be exported, because the audit names each
            export.
        """
        told = (
            "nothing was exported, because the audit names each export; 'manip3d diary rescue' "
            "copies the diary to another place, from which it can be exported"
        )
        with _telling_of_no_room(told), self._file.begin() as rows:
            rows.note("export", rows.find(identifier).number)

    def expect_other_file(self, output: str | os.PathLike[str]) -> None:
        """Raise InputError if an output is the diary's file, or one that SQLite keeps beside it.

        Parameters
        ----------
        output : path
            File that is about to be written.

        Raises
        ------
        InputError
            The file belongs to the diary.
        """
        place = self._file.place
        for own in (place, *(Path(f"{place}{ending}") for ending in BESIDE)):
            if os.path.realpath(output) == os.path.realpath(own) or (
                os.path.exists(output) and own.exists() and os.path.samefile(output, own)
            ):
                raise InputError(f"output: expected another file than the diary, got {output}")

    def note_files(self, identifier: str, files: Sequence[str | os.PathLike[str]]) -> None:
        """Record the files that an export wrote, to find them if the participant withdraws.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        files : sequence of path

        Raises
        ------
        InputError
            No such participant, or a path has control characters or is not UTF-8.
        OSError
            A file cannot be read, or the diary cannot be written.
        """
        found = {}
        for file in files:
            path = legible_path_of(file, "files").absolute()
            found[str(path)] = sha256_of(path)
        told = "exported, but the diary does not list the files, which 'diary delete' will not name"
        with _telling_of_no_room(told), self._file.begin() as rows:
            participant = rows.find(identifier)
            kept = participant.fields.get("exports", {})
            rows.change(participant, {"exports": {**kept, **found}})

    def delete(self, identifier: str) -> None:
        """Delete a participant; no data of theirs remain in the file or its write-ahead log.

        The audit still shows the number and the positions of its erased rows.
        The rows are overwritten with zeros, the file is rewritten without them, and its write-ahead
        log is removed. Copies, exports (see `exports`) and remains of overwritten files on the disk
        are not deleted; therefore also encrypt the disk.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.

        Raises
        ------
        InputError
            No such participant, or they have a live session in progress: nothing was deleted.
        OSError
            Another program has the diary open: nothing was deleted. Or the file could not be
            rewritten: the participant is deleted and their rows are overwritten with zeros.
        """
        with self._file.begin() as rows:
            participant = rows.find(identifier)
        name = participant.fields["identifier"]
        lock = SessionLock(self, name, participant.number, for_deletion=True)
        try:
            with self._file.begin_without_remains() as rows:
                rows.delete(participant)
        finally:
            lock.release()


@contextlib.contextmanager
def _telling_of_no_room(told: str) -> Iterator[None]:
    """Add what it means for an export that the diary's disk is full or can only be read."""
    try:
        yield
    except OSError as error:
        code = getattr(error.__cause__, "sqlite_errorcode", 0) & 0xFF
        if code not in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY):
            raise
        raise OSError(f"{error}; {told}") from error


def check_event_text(text: str) -> None:
    """Raise InputError for a text that `Diary.add_event` cannot store."""
    if len(text) > 2000:
        raise InputError(f"text: expected at most 2000 characters, got {len(text)}")
    check_texts({"text": text})


def _fields_of(game: DiaryGame) -> dict[str, Any]:
    """Return the fields of a game as values of JSON; refuse what a diary cannot store."""
    _check_limb(game.limb)
    if game.ending not in _ENDINGS:
        raise InputError(f"ending: expected {', '.join(_ENDINGS)}, got {game.ending!r}")
    if not _GAME.fullmatch(game.game):  # any game may be stored, also one of another program
        raise InputError(
            f"game: expected 1 to 64 characters without / and \\, got {one_line(game.game)}"
        )
    fields = asdict(game) | {"at": aware(game.at).isoformat()}
    del fields["number"]
    for name in ("difficulty", "seed", "score", "misses", "by_phantom"):
        fields[name] = _whole(fields[name], name)
    for name in ("seconds", "paused_s", "gain"):
        fields[name] = _finite(fields[name], name)
    for name in ("latency_ms", "tracked"):
        if fields[name] is not None:
            fields[name] = _finite(fields[name], name)
    for name in ("seconds", "paused_s", "misses", "by_phantom", "latency_ms", "tracked"):
        if fields[name] is not None and fields[name] < 0:
            raise InputError(f"{name}: expected 0 or more, got {fields[name]}")
    if fields["tracked"] is not None and fields["tracked"] > 1:
        raise InputError(f"tracked: expected a share of 0 to 1, got {fields['tracked']}")
    if not fields["gain"] > 0:
        raise InputError(f"gain: expected a number > 0, got {fields['gain']}")
    fields["anomalies"] = [_ends_of(anomaly) for anomaly in game.anomalies]
    return fields


def _ends_of(anomaly: object) -> tuple[float, float]:
    """Return the start and the end of an anomaly."""
    if not isinstance(anomaly, Sequence | np.ndarray) or np.shape(anomaly) != (2,):
        raise InputError(
            f"anomalies: expected pairs of a start and an end, got {one_line(anomaly)}"
        )
    start, end = _finite(anomaly[0], "anomalies"), _finite(anomaly[1], "anomalies")
    if not 0 <= start <= end:
        raise InputError(f"anomalies: expected 0 <= start <= end, got {start} and {end}")
    return start, end


def _whole(value: object, name: str) -> int:
    """Return a whole number, also one of NumPy, as Python's."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool):
        raise InputError(f"{name}: expected a whole number, got {value!r}")
    return int(value)


def _finite(value: object, name: str) -> float:
    """Return a finite number, also one of NumPy, as Python's."""
    is_number = isinstance(value, int | float | np.integer | np.floating)
    try:
        number = float(value) if is_number and not isinstance(value, bool) else math.nan  # type: ignore[arg-type]
    except OverflowError as error:
        raise InputError(f"{name}: expected a finite number, got a larger one") from error
    if not math.isfinite(number):
        raise InputError(f"{name}: expected a finite number, got {value!r}")
    return value if isinstance(value, int) else number


def _check_limb(limb: str) -> None:
    if limb and limb not in get_args(Limb):
        raise InputError(f"limb: expected {', '.join(get_args(Limb))}, got {limb!r}")


def _write_consent(rows: DiaryTransaction, participant: Enrolled, clips: bool) -> None:
    rows.change(participant, {"clips": clips})
    rows.note("consent" if clips else "no consent", participant.number)


def _keep_answers(
    rows: DiaryTransaction, participant: Enrolled, fields: Mapping[str, Any], session: int | None
) -> None:
    if session is not None:
        rows.check_owner(session, participant)
        fields = {**fields, "session": session}
    rows.add(schema.QUESTIONNAIRES, participant, fields)
    rows.note("questionnaire", participant.number)
