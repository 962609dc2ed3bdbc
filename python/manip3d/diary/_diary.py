"""`Diary`: one SQLite file with all sessions of a study's participants; what is written to it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any, Literal, get_args

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.diary import _schema as schema
from manip3d.diary._clips import Pictures
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
from manip3d.diary._rows import Enrolled, Rows, check_texts
from manip3d.errors import InputError
from manip3d.io._files import sha256_of
from manip3d.modify import Limb

_ENDINGS = ("time", "misses", "done", "stopped", "interrupted")


@checked
class Diary(DiaryReading):
    """A diary file. What a method has written when it returns survives the end of the program.

    One file holds all participants of a study, each under a pseudonym. With a key what they said
    and did is encrypted, each participant's with a key of their own; without one it is plain JSON
    in SQLite. Research software, no medical device.

    Parameters
    ----------
    path : path
        Path of the file.
    key : path, optional
        Key file of `make_key`; without it the diary is not encrypted.
    create : bool
        Make a new diary where there is no file.

    Raises
    ------
    InputError
        The diary is encrypted and no key is given, or the other way round.
    FormatError
        The file is not a diary, one of a later version, or of another key.
    OSError
        There is no such file, or it cannot be opened.

    Examples
    --------
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
            A pseudonym: letters, digits, dots, hyphens and underscores.
        limb : {"left_arm", "right_arm", "left_leg", "right_leg"}, optional
            The affected one; empty: it is not known.
        clips : bool
            Whether they consented to clips of anomalies; `set_consent` changes it.
        at : datetime, optional
            By default now; the protocol's days are counted from this one.

        Returns
        -------
        Participant

        Raises
        ------
        InputError
            The pseudonym is taken, in capital or small letters, or no pseudonym, there is no such
            limb, or the time has no offset from UTC.
        """
        name = identifier_of(identifier)
        _check_limb(limb)
        moment = aware(at, "at")
        fields = {"identifier": name, "limb": limb, "enrolled": moment.isoformat(), "clips": clips}
        with self._file.begin() as rows:
            for participant in rows.everybody():
                taken = participant.fields["identifier"]
                # Files that are named after people would be the same on many a disk.
                if taken.casefold() == name.casefold():
                    raise InputError(f"participant: {taken} is enrolled already")
            number = rows.enrol(fields)
            rows.note("enrol", number)
        return Participant(name, limb, moment, clips, number)

    def set_consent(self, identifier: str, *, clips: bool) -> None:
        """Say whether a participant consents to clips; without consent theirs are deleted.

        Films that were exported before are not reached: see `exports` and `ExportedFile.has_films`.

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
            There are clips to delete and another program has the diary open; nothing was changed.
            Or the file could not be written anew: the clips are deleted, their rows are zeros.
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
            When it happened; by default now.

        Returns
        -------
        int
            Its number, for `add_game` and the like.

        Raises
        ------
        InputError
            No such participant.
        """
        fields = {"started": aware(at, "at").isoformat(), "ended": None}
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            session = rows.add(schema.SESSIONS, participant, fields)
            rows.note("session", participant.number)
        return session

    def begin_play(self, session: int, *, at: datetime | None = None) -> None:
        """Record the start of the first game or touch cue of a session; later calls change nothing.

        Ratings of pain from now on are ``after``.

        Parameters
        ----------
        session : int
            As `start_session` returned it.
        at : datetime, optional
            When it happened; by default now.

        Raises
        ------
        InputError
            No such session.
        """
        self._set_time(session, "begun", aware(at, "at"), keep=True)

    def end_session(
        self, session: int, *, at: datetime | None = None, answered: bool = True
    ) -> None:
        """Record the end of a session.

        Parameters
        ----------
        session : int
            As `start_session` returned it.
        at : datetime, optional
            When it happened; by default now.
        answered : bool
            False: the patient was asked for a last rating of the pain and gave none.

        Raises
        ------
        InputError
            No such session.
        """
        self._set_time(session, "ended", aware(at, "at"), about={"answered": answered})

    def _set_time(
        self,
        session: int,
        name: str,
        at: datetime,
        *,
        keep: bool = False,
        about: Mapping[str, bool] | None = None,
    ) -> None:
        """Set a time of a session and what else is known of it; ``keep``: unless it is set."""
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
        """Keep a game, with its anomalies: spans without a point although a target was in reach.

        One that goes on is kept as ``interrupted``, so that it leaves a trace if the program is
        killed, and later replaced.

        Parameters
        ----------
        session : int
            As `start_session` returned it.
        game : DiaryGame
        clips : sequence of sequences of (float, bytes)
            For each anomaly the seconds of play and the JPEG of each picture, or no pictures; by
            default there are no clips.
        replaces : int, optional
            Number of the same game as it was kept before.

        Returns
        -------
        int
            A number, for ``replaces``.

        Raises
        ------
        InputError
            No such session, game, limb or ending, clips of somebody who did not consent, or more or
            fewer than anomalies.
        """
        if clips and len(clips) != len(game.anomalies):
            raise InputError(f"clips: expected {len(game.anomalies)}, got {len(clips)}")
        _check_limb(game.limb)
        if game.ending not in _ENDINGS:
            raise InputError(f"ending: expected {', '.join(_ENDINGS)}, got {game.ending!r}")
        fields: dict[str, Any] = asdict(game) | {"at": aware(game.at, "at").isoformat()}
        del fields["anomalies"], fields["number"]
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
            for which, (start, end) in enumerate(game.anomalies):
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
        """Keep how strong the pain is.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        pain : int
            0 (none) to 10 (the worst).
        session : int, optional
            As `start_session` returned it; by default it belongs to no session.
        when : {"before", "after", "other"}, optional
            By default ``before`` until the first game or touch cue of the session begins (see
            `begin_play`), then ``after``; ``other`` without a session.
        at : datetime, optional
            When it happened; by default now.
        reason : str
            Why the session must stop, as the caller found by ratings of other sessions, in at most
            2000 characters. It is kept and returned where the ratings of this one give no reason.

        Returns
        -------
        str
            Why the session must stop, where the pain is 2 or more above its first rating (which
            another one may correct within half a minute, before any play); it is kept as an
            adverse event too, in the same transaction as the rating. Else ``reason``.

        Raises
        ------
        InputError
            No such participant or session, no such rating, or a reason that is too long or has
            control characters.
        """
        if len(reason) > 2000:
            raise InputError(f"reason: expected at most 2000 characters, got {len(reason)}")
        check_texts({"reason": reason})
        if not 0 <= pain <= 10:
            raise InputError(f"pain: expected 0 to 10, got {pain}")
        if when is not None and when not in get_args(Moment):
            raise InputError(f"when: expected {', '.join(get_args(Moment))}, got {when!r}")
        moment = aware(at, "at")
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            if session is not None:
                rows.check_owner(session, participant)
                past = next(o for o in sessions_of(rows, participant) if o.number == session)
                if when is None or when == "after":
                    when = when or ("after" if past.begun or past.games else "before")
                    reason = judge_rating(past.ratings, pain, moment, when=when) or reason
            fields = {"at": moment.isoformat(), "pain": pain, "when": when or "other"}
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
        """Keep a filled-in McGill Pain Questionnaire.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        ranks, ppi
            As for `score_mcgill`.
        occasion : {"baseline", "week-1", "week-4", "other"}
        at : datetime, optional
            When it happened; by default now.

        Returns
        -------
        McGill

        Raises
        ------
        InputError
            No such participant or occasion; invalid answers; the occasion has one already.
        """
        score = score_mcgill(ranks, ppi)
        moment = aware(at, "at")
        fields = {"at": moment.isoformat(), "occasion": occasion, "ranks": list(ranks), "ppi": ppi}
        self._add_filled(identifier, fields)
        return McGill(moment, occasion, tuple(ranks), score)

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
        """Keep a filled-in questionnaire, with its questions.

        One that scores like `MCGILL`, whatever its words are, is kept as `add_mcgill` keeps it,
        without the words, so that `analyse` counts it.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        questionnaire : Questionnaire
        answers : sequence of int
            One of each question.
        occasion : {"baseline", "week-1", "week-4", "other"}
            At most one questionnaire of a name for each of the first three.
        session : int, optional
            As `start_session` returned it; by default it belongs to no session.
        at : datetime, optional
            When it happened; by default now.

        Returns
        -------
        Answers

        Raises
        ------
        InputError
            No such participant, session or occasion; invalid answers; the occasion has a
            questionnaire of this name already.
        """
        questionnaire.check_answers(answers)
        moment, given = aware(at, "at"), tuple(int(one) for one in answers)
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
        """Keep what was filled in, once for an occasion."""
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
        """Keep the answers after a touch cue.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        mode : {"synchronous", "asynchronous"}
        answers : sequence of 6 int
            From -3 (not at all) to 3 (very much); the first three are about ownership.
        session : int, optional
            As `start_session` returned it; by default it belongs to no session.
        at : datetime, optional
            When it happened; by default now.

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
        moment = aware(at, "at")
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
        """Keep how a participant feels the limb that is not there.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        length, telescoping : int, per cent
            20 to 150 of the intact limb's length; 0 to 100, how far the end has moved up.
        raised, bent : int, degrees
            -30 to 180 sideways from hanging down; 0 to 150 at elbow or knee.
        limb : {"left_arm", "right_arm", "left_leg", "right_leg"}, optional
            Which one; empty: the one of the enrolment.
        session : int, optional
            As `start_session` returned it; by default it belongs to no session.
        at : datetime, optional
            When it happened; by default now.

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
        moment = aware(at, "at")
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
        """Keep an adverse event.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        kind : {"pain", "sickness", "other"}
        text : str
            In the therapist's words, at most 2000 characters.
        session : int, optional
            As `start_session` returned it; by default it belongs to no session.
        at : datetime, optional
            When it happened; by default now.

        Raises
        ------
        InputError
            No such participant, session or kind, or a text that is too long or has control
            characters other than line feeds.
        """
        if len(text) > 2000:
            raise InputError(f"text: expected at most 2000 characters, got {len(text)}")
        fields = {"at": aware(at, "at").isoformat(), "kind": kind, "text": text}
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            if session is not None:
                rows.check_owner(session, participant)
            rows.add(schema.EVENTS, participant, fields, session=session)
            rows.note("event", participant.number)

    def note_export(self, identifier: str) -> None:
        """Write into the audit that somebody took a copy.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.

        Raises
        ------
        InputError
            No such participant.
        """
        with self._file.begin() as rows:
            rows.note("export", rows.find(identifier).number)

    def note_files(self, identifier: str, files: Sequence[str | os.PathLike[str]]) -> None:
        """Keep which files an export wrote, so that they can be found when a participant withdraws.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        files : sequence of path

        Raises
        ------
        InputError
            No such participant.
        OSError
            A file cannot be read.
        """
        found = {}
        for file in files:
            path = path_of(file, "files").absolute()
            found[str(path)] = sha256_of(path)
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            kept = participant.fields.get("exports", {})
            rows.change(participant, {"exports": {**kept, **found}})

    def delete(self, identifier: str) -> None:
        """Delete a participant: no byte of what they said and did remains in the file or beside it.

        The audit still tells how many of its rows were theirs, and between which others.
        The rows are overwritten with zeros, the file is written anew without them, and its
        write-ahead log is removed. Copies, exports (see `exports`) and what the disk itself keeps
        of overwritten files are not reached: encrypt the disk too.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.

        Raises
        ------
        InputError
            No such participant.
        OSError
            Another program has the diary open; nothing was deleted. Or the file could not be
            written anew: the participant is deleted, their rows are zeros.
        """
        with self._file.begin() as rows:
            participant = rows.find(identifier)
        with self._file.begin_without_remains() as rows:
            rows.delete(participant)


def _check_limb(limb: str) -> None:
    if limb and limb not in get_args(Limb):
        raise InputError(f"limb: expected {', '.join(get_args(Limb))}, got {limb!r}")


def _write_consent(rows: Rows, participant: Enrolled, clips: bool) -> None:
    rows.change(participant, {"clips": clips})
    rows.note("consent" if clips else "no consent", participant.number)


def _keep_answers(
    rows: Rows, participant: Enrolled, fields: Mapping[str, Any], session: int | None
) -> None:
    if session is not None:
        rows.check_owner(session, participant)
        fields = {**fields, "session": session}
    rows.add(schema.QUESTIONNAIRES, participant, fields)
    rows.note("questionnaire", participant.number)
