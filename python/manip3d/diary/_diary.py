"""`Diary`: one SQLite file with all sessions of a study's participants."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import date, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, get_args

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.diary._clips import Clip, Pictures
from manip3d.diary._mcgill import score_mcgill
from manip3d.diary._protocol import PAIN, SICKNESS, judge_rating
from manip3d.diary._questionnaires import (
    MCGILL,
    OWNERSHIP,
    Questionnaire,
    definition_of,
    questionnaire_of,
)
from manip3d.diary._records import (
    AdverseEvent,
    Answers,
    DiaryGame,
    DiarySession,
    ExportedFile,
    FeltRecord,
    McGill,
    Moment,
    Occasion,
    Ownership,
    Participant,
    Rating,
    aware,
    identifier_of,
)
from manip3d.diary._sealing import require_key_material
from manip3d.errors import FormatError, InputError, MissingExtraError
from manip3d.io._files import sha256_of
from manip3d.modify import Limb

try:
    import sqlalchemy as sql
except ModuleNotFoundError as error:
    raise MissingExtraError("sqlalchemy", "diary") from error

from manip3d.diary import _schema as schema
from manip3d.diary._audit import moment_of
from manip3d.diary._file import DiaryFile
from manip3d.diary._rows import Enrolled, Rows, check_texts

_ENDINGS = ("time", "misses", "done", "stopped", "interrupted")
_OWNERSHIP, _FELT, _FORM = "ownership", "felt", "form"  # kinds of questionnaires


@checked
class Diary:
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

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        key: str | os.PathLike[str] | None = None,
        create: bool = False,
    ) -> None:
        self.path = path_of(path)
        self._file = DiaryFile(self.path, require_key_material(key), create=create)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let the file go; may be called twice, and nothing is lost without it.

        Other methods raise InputError from then on.
        """
        self._file.close()

    @property
    def is_encrypted(self) -> bool:
        """Whether a key is needed to read it."""
        return self._file.key is not None

    @property
    def study(self) -> str:
        """A random UUID, which tells participants of this diary from those of other ones."""
        return self._file.study

    # --- writing ---------------------------------------------------------------------------------

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
                    raise InputError(f"replaces: session {session} has no game of the number {row}")
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
                past = next(o for o in _sessions(rows, participant) if o.number == session)
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
            fields |= {"kind": _FORM, "form": form, "answers": given}
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
        if mode not in ("synchronous", "asynchronous"):
            raise InputError(f"mode: expected synchronous or asynchronous, got {mode!r}")
        given = tuple(int(one) for one in answers)
        if len(given) != 6 or not all(-3 <= one <= 3 for one in given):
            raise InputError(f"answers: expected 6 from -3 to 3, got {list(answers)}")
        moment = aware(at, "at")
        fields = {"at": moment.isoformat(), "kind": _OWNERSHIP, "mode": mode, "answers": given}
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
        fields = {"at": moment.isoformat(), "kind": _FELT, "limb": limb, **numbers}
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
        if kind not in ("pain", "sickness", "other"):
            raise InputError(f"kind: expected pain, sickness or other, got {kind!r}")
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

    def exports(self, identifier: str) -> list[ExportedFile]:
        """List the files with data of a participant that exports wrote.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.

        Returns
        -------
        list of ExportedFile
            By path; a table of several participants is among the files of each of them.

        Raises
        ------
        InputError
            No such participant.
        """
        with self._file.begin() as rows:
            kept = rows.find(identifier).fields.get("exports", {})
        return [ExportedFile(Path(path), kept[path]) for path in sorted(kept)]

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

    # --- reading ---------------------------------------------------------------------------------

    def participants(self) -> list[Participant]:
        """Everybody, by pseudonym."""
        with self._file.begin() as rows:
            found = [_participant(one) for one in rows.everybody()]
        return sorted(found, key=lambda one: one.identifier)

    def participant(self, identifier: str) -> Participant:
        """Return what is known of one participant.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        Participant

        Raises
        ------
        InputError
            No such participant.
        """
        with self._file.begin() as rows:
            return _participant(rows.find(identifier))

    def sessions(self, identifier: str) -> list[DiarySession]:
        """Return the sessions of a participant, by time, with games, anomalies and ratings.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of DiarySession

        Raises
        ------
        InputError
            No such participant.
        """
        with self._file.begin() as rows:
            found = _sessions(rows, rows.find(identifier))
        return sorted(found, key=lambda session: session.started)

    def clips(self, identifier: str) -> list[Clip]:
        """Return the clips of a participant's anomalies, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of Clip

        Raises
        ------
        InputError
            No such participant.
        """
        found = []
        with self._file.begin() as rows:
            participant = rows.find(identifier)
            games = {row["id"]: fields for row, fields in rows.read(schema.GAMES, participant)}
            anomalies = {
                row["id"]: (games[row["game"]], fields)
                for row, fields in rows.read(schema.ANOMALIES, participant)
            }
            for anomaly, pictures in rows.read_clips(participant):
                game, times = anomalies[anomaly]
                at = datetime.fromisoformat(game["at"])
                found.append(Clip(at, game["game"], times["start"], times["end"], pictures))
        return sorted(found, key=lambda clip: (clip.at, clip.start))

    def ratings(self, identifier: str) -> list[Rating]:
        """Return all ratings of a participant's pain, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of Rating

        Raises
        ------
        InputError
            No such participant.
        """
        return sorted(
            (_rating(*one) for one in self._fields(schema.RATINGS, identifier)),
            key=lambda rating: rating.at,
        )

    def mcgill(self, identifier: str) -> list[McGill]:
        """Return the McGill questionnaires of a participant, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of McGill

        Raises
        ------
        InputError
            No such participant.
        """
        found = [
            McGill(
                datetime.fromisoformat(fields["at"]),
                fields["occasion"],
                tuple(fields["ranks"]),
                score_mcgill(fields["ranks"], fields["ppi"]),
                row,
            )
            for fields, row in self._answers(identifier, "")
        ]
        return sorted(found, key=lambda one: one.at)

    def ownership(self, identifier: str) -> list[Ownership]:
        """Return the answers of a participant after touch cues, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of Ownership

        Raises
        ------
        InputError
            No such participant.
        """
        found = [
            Ownership(datetime.fromisoformat(f["at"]), f["mode"], tuple(f["answers"]), row)
            for f, row in self._answers(identifier, _OWNERSHIP)
        ]
        return sorted(found, key=lambda one: one.at)

    def felt(self, identifier: str) -> list[FeltRecord]:
        """Return how a participant felt the limb that is not there, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of FeltRecord

        Raises
        ------
        InputError
            No such participant.
        """
        names = ("length", "telescoping", "raised", "bent")
        found = [
            FeltRecord(
                datetime.fromisoformat(f["at"]),
                **{name: f[name] for name in names},
                limb=f.get("limb", ""),  # diaries of before did not tell it
                number=row,
            )
            for f, row in self._answers(identifier, _FELT)
        ]
        return sorted(found, key=lambda one: one.at)

    def answers(self, identifier: str) -> list[Answers]:
        """Return all filled-in questionnaires of a participant, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of Answers
            Those of `mcgill` and `ownership` too, as `MCGILL` and `OWNERSHIP`.

        Raises
        ------
        InputError
            No such participant.
        FormatError
            A questionnaire cannot be parsed: the diary is damaged.
        """
        found = [
            Answers(one.at, MCGILL, (*one.ranks, one.score.ppi), one.occasion, one.number)
            for one in self.mcgill(identifier)
        ]
        found += [
            Answers(one.at, OWNERSHIP, one.answers, "other", one.number)
            for one in self.ownership(identifier)
        ]
        found += [self._form(*one) for one in self._answers(identifier, _FORM)]
        return sorted(found, key=lambda one: one.at)

    def _form(self, fields: Mapping[str, Any], row: int) -> Answers:
        try:
            form, given = questionnaire_of(fields["form"]), tuple(fields["answers"])
            form.check_answers(given)
        except InputError as error:
            raise FormatError(f"the diary is damaged: {error}", file=str(self.path)) from None
        return Answers(datetime.fromisoformat(fields["at"]), form, given, fields["occasion"], row)

    def _answers(self, identifier: str, kind: str) -> list[tuple[dict[str, Any], int]]:
        """Filled-in questionnaires of a kind; "" is McGill's, whose fields name none."""
        rows = self._fields(schema.QUESTIONNAIRES, identifier)
        return [(fields, row) for fields, row in rows if fields.get("kind", "") == kind]

    def events(self, identifier: str) -> list[AdverseEvent]:
        """Return the adverse events of a participant, by time.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant, as enrolled.

        Returns
        -------
        list of AdverseEvent

        Raises
        ------
        InputError
            No such participant.
        """
        found = [
            AdverseEvent(datetime.fromisoformat(fields["at"]), fields["kind"], fields["text"], row)
            for fields, row in self._fields(schema.EVENTS, identifier)
        ]
        return sorted(found, key=lambda event: event.at)

    def halt_reason(self, identifier: str, *, today: date | None = None) -> str:
        """Say why a participant must not play any more today, also after a restart.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        today : date, optional
            A day of this machine's time zone, by default the present one. Events of that day count
            wherever they were written down: a diary may come from another time zone.

        Returns
        -------
        str
            In words for the patient: of the first adverse event of that day for which a session
            stops (pain or sickness); empty: they may play.

        Raises
        ------
        InputError
            No such participant.
        """
        day = today or date.today()
        for event in self.events(identifier):
            if event.local_date == day and event.kind != "other":
                return SICKNESS if event.kind == "sickness" else event.text or PAIN
        return ""

    def audit(self) -> list[tuple[datetime, str, str]]:
        """List what was done, by time, without what was done to participants who were deleted.

        Returns
        -------
        list of (datetime, str, str)
            When, what (``enrol``, ``game``, ``delete`` ...), and whose; the last one is empty for a
            deletion. See `check_audit` for whether it is what was written.

        Raises
        ------
        FormatError
            A time cannot be parsed: the diary is damaged.
        """
        with self._file.begin() as rows:
            names = {one.number: one.fields["identifier"] for one in rows.everybody()}
            noted = rows.read_audit()
        found = [
            (moment_of(row.at, str(self.path)), row.action, names.get(row.participant, ""))
            for row in noted
        ]
        return sorted(found, key=lambda one: one[0])

    def check_audit(self) -> None:
        """Compare each row of the audit with its hashes, which bind it to all rows before it.

        The hashes need a key, which an encrypted diary keeps encrypted: who has no key file can
        change no row unnoticed. In a plain diary that key stands in the file, so that damage and
        changes with other programs are found, but no forgery by who takes this key. A copy of the
        whole file of an earlier day is valid.

        Raises
        ------
        FormatError
            Names the first row that is not what was written, or is missing.
        """
        with self._file.begin() as rows:
            rows.verify_audit()

    def check(self) -> None:
        """Read the whole file, open every payload and compare the audit with its hashes.

        Raises
        ------
        FormatError
            The file is damaged, or a payload or a row of the audit was changed.
        """
        with self._file.begin() as rows:
            rows.verify()

    def _fields(self, table: sql.Table, identifier: str) -> list[tuple[dict[str, Any], int]]:
        """Fields and number of each row."""
        with self._file.begin() as rows:
            return [(f, row["id"]) for row, f in rows.read(table, rows.find(identifier))]


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


def _sessions(rows: Rows, participant: Enrolled) -> list[DiarySession]:
    """The sessions of a participant, each table read once."""
    times, games, ratings = defaultdict(list), defaultdict(list), defaultdict(list)
    for row, fields in rows.read(schema.ANOMALIES, participant):
        times[row["game"]].append((fields["start"], fields["end"]))
    for row, fields in rows.read(schema.GAMES, participant):
        games[row["session"]].append(_game(fields, sorted(times[row["id"]]), row["id"]))
    for row, fields in rows.read(schema.RATINGS, participant):
        ratings[row["session"]].append(_rating(fields, row["id"]))
    return [
        DiarySession(
            row["id"],
            datetime.fromisoformat(about["started"]),
            datetime.fromisoformat(about["ended"]) if about["ended"] else None,
            tuple(sorted(games[row["id"]], key=lambda game: game.at)),
            tuple(sorted(ratings[row["id"]], key=lambda rating: rating.at)),
            datetime.fromisoformat(about["begun"]) if about.get("begun") else None,
            bool(about.get("answered", True)),
        )
        for row, about in rows.read(schema.SESSIONS, participant)
    ]


def _participant(enrolled: Enrolled) -> Participant:
    fields = enrolled.fields
    at, clips = datetime.fromisoformat(fields["enrolled"]), fields.get("clips", False)
    return Participant(fields["identifier"], fields["limb"], at, clips, enrolled.number)


def _rating(fields: Mapping[str, Any], row: int) -> Rating:
    return Rating(datetime.fromisoformat(fields["at"]), fields["pain"], fields["when"], row)


def _game(fields: dict[str, Any], anomalies: Sequence[tuple[float, float]], row: int) -> DiaryGame:
    at = datetime.fromisoformat(fields.pop("at"))
    return DiaryGame(at=at, **fields, anomalies=tuple(anomalies), number=row)
