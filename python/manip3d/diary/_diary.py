"""`Diary`: one SQLite file with all sessions of a study's participants."""

from __future__ import annotations

import contextlib
import os
import secrets
import sqlite3
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, date, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, get_args

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.texts import has_control_characters
from manip3d.diary._clips import Clip, Pictures, seal_pictures, unseal_pictures
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
from manip3d.diary._sealing import (
    new_key,
    require_key_material,
    seal,
    seal_fields,
    unseal,
    unseal_fields,
)
from manip3d.errors import FormatError, InputError, MissingExtraError
from manip3d.io._files import sha256_of

try:
    import sqlalchemy as sql
except ModuleNotFoundError as error:
    raise MissingExtraError("sqlalchemy", "diary") from error

from manip3d.diary import _schema as schema
from manip3d.diary._audit import (
    append_row,
    begin_chain,
    erase_rows,
    moment_of,
    time_in,
    verify,
)

_CHECK = b"manip3d diary"
_STUDY = "meta study"  # what the study's identifier is encrypted for
_CHAIN = "meta audit key"
_OWNERSHIP, _FELT, _FORM = "ownership", "felt", "form"  # kinds of questionnaires
_BUSY_S = 5.0  # another program that writes is waited for


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
        The file is no diary, one of a later version, or of another key.
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
        self._key = require_key_material(key)
        self._check_file(create)
        self._engine = sql.create_engine(
            # SQLite takes `:memory:` for no file, and SQLAlchemy `file:` for an address.
            sql.URL.create("sqlite", database=os.path.abspath(self.path)),
            poolclass=sql.pool.NullPool,  # nobody holds the file between two calls
            connect_args={"timeout": _BUSY_S},
        )
        sql.event.listen(self._engine, "connect", self._on_connect)
        sql.event.listen(self._engine, "begin", _on_begin)
        sql.event.listen(self._engine, "handle_error", self._on_error)
        with self._engine.begin() as connection:
            # Another program may have made or changed it since.
            now = int(connection.exec_driver_sql("PRAGMA user_version").scalar_one())
            if now > 0:
                self._check_key(connection)  # before anything is written with it
            if now < schema.VERSION:
                self._migrate(connection, now)
            self._study = self._read_study(connection)
            self._chain_key = unseal(self._key, self._meta(connection, "audit key"), _CHAIN)

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
        """Let the file go; nothing is lost without this."""
        self._engine.dispose()

    @property
    def is_encrypted(self) -> bool:
        """Whether a key is needed to read it."""
        return self._key is not None

    @property
    def study(self) -> str:
        """A random UUID, which tells participants of this diary from those of other ones."""
        return self._study

    # --- writing ---------------------------------------------------------------------------------

    def enrol(
        self, identifier: str, *, limb: str = "", clips: bool = False, at: datetime | None = None
    ) -> Participant:
        """Add a participant.

        Parameters
        ----------
        identifier : str
            A pseudonym: letters, digits, dots, hyphens and underscores.
        limb : str
            The affected one.
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
            The pseudonym is taken, in capital or small letters, or no pseudonym, the limb has
            control characters, or the time has no offset from UTC.
        """
        name = identifier_of(identifier)
        _check_texts({"limb": limb})
        moment = aware(at, "at")
        with self._engine.begin() as connection:
            for _, _, found in self._all(connection):
                # Files that are named after people would be the same on many a disk.
                if found["identifier"].casefold() == name.casefold():
                    raise InputError(f"participant: {found['identifier']} is enrolled already")
            number, key = _new_number(), new_key() if self._key else None
            fields: dict[str, Any] = {
                "identifier": name, "limb": limb, "enrolled": moment.isoformat(), "clips": clips
            }  # fmt: skip
            wrapped = seal(self._key, key, f"participants {number} key") if key else b""
            connection.execute(
                sql.insert(schema.PARTICIPANTS).values(
                    id=number, key=wrapped, payload=seal_fields(key, fields, _about(number))
                )
            )
            self._note(connection, "enrol", number)
        return Participant(name, limb, moment, clips, number)

    def set_consent(self, identifier: str, *, clips: bool) -> None:
        """Say whether a participant consents to clips; without consent theirs are deleted.

        Films that were exported before are not reached: see `exports` and `ExportedFile.has_films`.

        Parameters
        ----------
        identifier : str
        clips : bool

        Raises
        ------
        InputError
            No such participant.
        OSError
            There are clips to delete and another program has the diary open; nothing was changed.
            Or the file could not be written anew: the clips are deleted, their rows are zeros.
        """
        with self._engine.begin() as connection:
            number, _ = self._find(connection, identifier)
            held = connection.execute(
                sql.select(schema.CLIPS.c.id).where(schema.CLIPS.c.participant == number)
            ).first()
        if clips or held is None:
            with self._engine.begin() as connection:
                self._write_consent(connection, identifier, clips)
            return
        with self._without_remains() as connection:
            self._write_consent(connection, identifier, clips)
            connection.execute(sql.delete(schema.CLIPS).where(schema.CLIPS.c.participant == number))

    def _write_consent(self, connection: sql.Connection, identifier: str, clips: bool) -> None:
        number = self._change_participant(connection, identifier, lambda _: {"clips": clips})
        self._note(connection, "consent" if clips else "no consent", number)

    def _change_participant(
        self,
        connection: sql.Connection,
        identifier: str,
        change: Callable[[Mapping[str, Any]], Mapping[str, Any]],
    ) -> int:
        """Set some of the fields of a participant, given all; return their number."""
        number, key = self._find(connection, identifier)
        table = schema.PARTICIPANTS
        payload = connection.execute(
            sql.select(table.c.payload).where(table.c.id == number)
        ).scalar_one()
        fields = unseal_fields(key, payload, _about(number))
        fields |= change(fields)
        connection.execute(
            sql.update(table)
            .where(table.c.id == number)
            .values(payload=seal_fields(key, fields, _about(number)))
        )
        return number

    def start_session(self, identifier: str, *, at: datetime | None = None) -> int:
        """Begin a sitting.

        Parameters
        ----------
        identifier : str
        at : datetime, optional

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
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            session = self._add(connection, schema.SESSIONS, number, key, fields)
            self._note(connection, "session", number)
        return session

    def begin_play(self, session: int, *, at: datetime | None = None) -> None:
        """Say that the first game or touch cue of a sitting begins; later calls change nothing.

        Ratings of pain from now on are ``after``.

        Parameters
        ----------
        session : int
        at : datetime, optional

        Raises
        ------
        InputError
            No such session.
        """
        self._set_time(session, "begun", aware(at, "at"), keep=True)

    def end_session(
        self, session: int, *, at: datetime | None = None, answered: bool = True
    ) -> None:
        """Say when a sitting ended.

        Parameters
        ----------
        session : int
        at : datetime, optional
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
        """Set a time of a sitting and what else is known of it; ``keep``: unless it is set."""
        with self._engine.begin() as connection:
            number, key = self._of_session(connection, session)
            table = schema.SESSIONS
            payload = connection.execute(
                sql.select(table.c.payload).where(table.c.id == session)
            ).scalar_one()
            place = _about(number, table, session)
            fields = unseal_fields(key, payload, place)
            if keep and fields.get(name):
                return
            fields |= {name: at.isoformat(), **(about or {})}
            connection.execute(
                sql.update(table)
                .where(table.c.id == session)
                .values(payload=seal_fields(key, fields, place))
            )

    def add_game(
        self,
        session: int,
        game: DiaryGame,
        clips: Sequence[Pictures] = (),
        *,
        replaces: int | None = None,
    ) -> int:
        """Keep a game, with its anomalies.

        One that goes on is kept as ``interrupted``, so that it leaves a trace if the program is
        killed, and later replaced.

        Parameters
        ----------
        session : int
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
            No such session or game, clips of somebody who did not consent, or more or fewer than
            anomalies.
        """
        if clips and len(clips) != len(game.anomalies):
            raise InputError(f"clips: expected {len(game.anomalies)}, got {len(clips)}")
        fields: dict[str, Any] = asdict(game) | {"at": aware(game.at, "at").isoformat()}
        del fields["anomalies"], fields["number"]
        with self._engine.begin() as connection:
            number, key = self._of_session(connection, session)
            if replaces is None:
                row = self._add(connection, schema.GAMES, number, key, fields, session=session)
                self._note(connection, "game", number)
            else:
                row = replaces
                self._replace_game(connection, session, row, number, key, fields)
            if any(clips) and not self._consents(connection, number):
                raise InputError("clips: expected none, as the participant did not consent")
            for which, (start, end) in enumerate(game.anomalies):
                part = {"start": start, "end": end}
                anomaly = self._add(connection, schema.ANOMALIES, number, key, part, game=row)
                if clips and clips[which]:
                    clip = _new_number()
                    about = _about(number, schema.CLIPS, clip)
                    connection.execute(
                        sql.insert(schema.CLIPS).values(
                            id=clip,
                            participant=number,
                            anomaly=anomaly,
                            payload=seal_pictures(key, clips[which], about),
                        )
                    )
        return row

    def _replace_game(
        self,
        connection: sql.Connection,
        session: int,
        row: int,
        number: int,
        key: bytes | None,
        fields: Mapping[str, Any],
    ) -> None:
        _check_texts(fields)
        table = schema.GAMES
        done = connection.execute(
            sql.update(table)
            .where(table.c.id == row, table.c.session == session)
            .values(payload=seal_fields(key, fields, _about(number, table, row)))
        )
        if done.rowcount != 1:
            raise InputError(f"replaces: session {session} has no game of the number {row}")
        connection.execute(sql.delete(schema.ANOMALIES).where(schema.ANOMALIES.c.game == row))

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
        pain : int
            0 (none) to 10 (the worst).
        session : int, optional
        when : {"before", "after", "other"}, optional
            By default ``before`` until the first game or touch cue of the session begins (see
            `begin_play`), then ``after``; ``other`` without a session.
        at : datetime, optional
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
        _check_texts({"reason": reason})
        if not 0 <= pain <= 10:
            raise InputError(f"pain: expected 0 to 10, got {pain}")
        if when is not None and when not in get_args(Moment):
            raise InputError(f"when: expected {', '.join(get_args(Moment))}, got {when!r}")
        moment = aware(at, "at")
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            if session is not None:
                self._check_owner(connection, session, number)
                past = self._session(connection, session, number, key)
                if when is None or when == "after":
                    when = when or ("after" if past.begun or past.games else "before")
                    reason = judge_rating(past.ratings, pain, moment, when=when) or reason
            fields = {"at": moment.isoformat(), "pain": pain, "when": when or "other"}
            self._add(connection, schema.RATINGS, number, key, fields, session=session)
            if reason:
                told = {"at": moment.isoformat(), "kind": "pain", "text": reason}
                self._add(connection, schema.EVENTS, number, key, told, session=session)
            self._note(connection, "rating", number)
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
        ranks, ppi
            As of `score_mcgill`.
        occasion : {"baseline", "week-1", "week-4", "other"}
        at : datetime, optional

        Returns
        -------
        McGill

        Raises
        ------
        InputError
            No such participant or occasion, or the answers are none; the occasion has one already.
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
        questionnaire : Questionnaire
        answers : sequence of int
            One of each question.
        occasion : {"baseline", "week-1", "week-4", "other"}
            At most one questionnaire of a name for each of the first three.
        session : int, optional
        at : datetime, optional

        Returns
        -------
        Answers

        Raises
        ------
        InputError
            No such participant, session or occasion, or the answers are none; the occasion has a
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

        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            known = self._rows(connection, schema.QUESTIONNAIRES, number, key)
            if occasion != "other" and any(name(f) == name(fields) for _, f in known):
                raise InputError(f"occasion: {identifier} has a questionnaire of {occasion}")
            self._keep_answers(connection, number, key, fields, session)

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
        mode : {"synchronous", "asynchronous"}
        answers : sequence of 6 int
            From -3 (not at all) to 3 (very much); the first three are about ownership.
        session : int, optional
        at : datetime, optional

        Returns
        -------
        Ownership

        Raises
        ------
        InputError
            No such participant, session or mode, or answers that are none.
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
        length, telescoping : int, per cent
            20 to 150 of the intact limb's length; 0 to 100, how far the end has moved up.
        raised, bent : int, degrees
            -30 to 180 sideways from hanging down; 0 to 150 at elbow or knee.
        limb : str
            Which one, as ``left_arm``; empty: the one of the enrolment.
        session : int, optional
        at : datetime, optional

        Returns
        -------
        FeltRecord

        Raises
        ------
        InputError
            No such participant or session, or a number out of range.
        """
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
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            self._keep_answers(connection, number, key, fields, session)

    def _keep_answers(
        self,
        connection: sql.Connection,
        number: int,
        key: bytes | None,
        fields: Mapping[str, Any],
        session: int | None,
    ) -> None:
        if session is not None:
            self._check_owner(connection, session, number)
        about = fields if session is None else {**fields, "session": session}
        self._add(connection, schema.QUESTIONNAIRES, number, key, about)
        self._note(connection, "questionnaire", number)

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
        kind : {"pain", "sickness", "other"}
        text : str
            In the therapist's words, at most 2000 characters.
        session : int, optional
        at : datetime, optional

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
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            if session is not None:
                self._check_owner(connection, session, number)
            self._add(connection, schema.EVENTS, number, key, fields, session=session)
            self._note(connection, "event", number)

    def note_export(self, identifier: str) -> None:
        """Write into the audit that somebody took a copy.

        Parameters
        ----------
        identifier : str

        Raises
        ------
        InputError
            No such participant.
        """
        with self._engine.begin() as connection:
            self._note(connection, "export", self._find(connection, identifier)[0])

    def note_files(self, identifier: str, files: Sequence[str | os.PathLike[str]]) -> None:
        """Keep which files an export wrote, so that they can be found when a participant withdraws.

        Parameters
        ----------
        identifier : str
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
        with self._engine.begin() as connection:
            self._change_participant(
                connection,
                identifier,
                lambda fields: {"exports": {**fields.get("exports", {}), **found}},
            )

    def exports(self, identifier: str) -> list[ExportedFile]:
        """List the files with data of a participant that exports wrote.

        Parameters
        ----------
        identifier : str

        Returns
        -------
        list of ExportedFile
            By path; a table of several participants is among the files of each of them.

        Raises
        ------
        InputError
            No such participant.
        """
        with self._engine.begin() as connection:
            number, _ = self._find(connection, identifier)
            fields = next(found for one, _, found in self._all(connection) if one == number)
        kept = fields.get("exports", {})
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

        Raises
        ------
        InputError
            No such participant.
        OSError
            Another program has the diary open; nothing was deleted. Or the file could not be
            written anew: the participant is deleted, their rows are zeros.
        """
        with self._engine.begin() as connection:
            number, _ = self._find(connection, identifier)
        with self._without_remains() as connection:
            erased = erase_rows(connection, number)
            connection.execute(
                sql.delete(schema.PARTICIPANTS).where(schema.PARTICIPANTS.c.id == number)
            )
            self._note(connection, "delete", None, erased)

    @contextlib.contextmanager
    def _without_remains(self) -> Iterator[sql.Connection]:
        """A transaction after which what it deleted is neither in the file nor beside it."""
        with self._engine.connect() as connection:
            raw = connection.connection.dbapi_connection
            assert isinstance(raw, sqlite3.Connection)
            # Out of the write-ahead log, which only works while nobody else has the file open.
            try:
                mode = raw.execute("PRAGMA journal_mode = DELETE").fetchone()[0]
            except sqlite3.OperationalError:
                mode = "wal"
            except sqlite3.DatabaseError as error:
                raise self._told(error) from error
            if mode != "delete":
                raise OSError(f"{self.path}: another program has the diary open; nothing deleted")
            with connection.begin():
                yield connection
            try:
                raw.execute("VACUUM")
                raw.execute("PRAGMA journal_mode = WAL")
            except sqlite3.DatabaseError as error:
                raise OSError(
                    f"{self.path}: deleted, but the file could not be written anew: {error}"
                ) from error

    # --- reading ---------------------------------------------------------------------------------

    def participants(self) -> list[Participant]:
        """Everybody, by pseudonym."""
        with self._engine.begin() as connection:
            found = [_participant(fields, number) for number, _, fields in self._all(connection)]
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
        with self._engine.begin() as connection:
            number, _ = self._find(connection, identifier)
            found = (fields for one, _, fields in self._all(connection) if one == number)
            return _participant(next(found), number)

    def sessions(self, identifier: str) -> list[DiarySession]:
        """Return the sittings of a participant, by time, with games, anomalies and ratings.

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
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            rows = self._rows(connection, schema.SESSIONS, number, key)
            found = [self._session(connection, row["id"], number, key) for row, _ in rows]
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
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            games = {row["id"]: f for row, f in self._rows(connection, schema.GAMES, number, key)}
            anomalies = {
                row["id"]: (games[row["game"]], f)
                for row, f in self._rows(connection, schema.ANOMALIES, number, key)
            }
            for row, pictures in self._pictures(connection, number, key):
                game, times = anomalies[row["anomaly"]]
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

    def questionnaires(self, identifier: str) -> list[McGill]:
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
            Those of `questionnaires` and `ownership` too, as `MCGILL` and `OWNERSHIP`.

        Raises
        ------
        InputError
            No such participant.
        FormatError
            A questionnaire is none: the diary is damaged.
        """
        found = [
            Answers(one.at, MCGILL, (*one.ranks, one.score.ppi), one.occasion, one.number)
            for one in self.questionnaires(identifier)
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
        """Filled-in questionnaires of a kind; those without one are McGill's."""
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
            A time is none: the diary is damaged.
        """
        table = schema.AUDIT
        with self._engine.begin() as connection:
            names = {number: fields["identifier"] for number, _, fields in self._all(connection)}
            rows = connection.execute(
                sql.select(table).where(table.c.salt != "").order_by(table.c.number)
            ).all()
        found = [
            (moment_of(row.at, str(self.path)), row.action, names.get(row.participant, ""))
            for row in rows
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
        with self._engine.begin() as connection:
            verify(connection, self._chain_key, str(self.path))

    def check(self) -> None:
        """Read the whole file, open every payload and compare the audit with its hashes.

        Raises
        ------
        FormatError
            The file is damaged, or a payload or a row of the audit was changed.
        """
        with self._engine.begin() as connection:
            told = connection.exec_driver_sql("PRAGMA integrity_check").scalars().all()
            if told != ["ok"]:
                raise FormatError(f"the diary is damaged: {told[0]}", file=str(self.path))
            if connection.exec_driver_sql("PRAGMA foreign_key_check").first() is not None:
                raise FormatError("the diary has rows of nobody", file=str(self.path))
            people = self._all(connection)
            for number, key, _ in people:
                for table in (schema.SESSIONS, schema.GAMES, schema.ANOMALIES, schema.RATINGS,
                              schema.QUESTIONNAIRES, schema.EVENTS):  # fmt: skip
                    self._rows(connection, table, number, key)
                for _ in self._pictures(connection, number, key):
                    pass
            verify(connection, self._chain_key, str(self.path))

    # --- the file --------------------------------------------------------------------------------

    def _check_file(self, create: bool) -> None:
        """Refuse what is no diary, or one of a later version; make a new file."""
        if create:
            with contextlib.suppress(FileExistsError):
                os.close(os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
        if not self.path.is_file():
            if self.path.exists():
                raise FormatError("expected a regular file", file=str(self.path))
            raise FileNotFoundError(2, "No such file or directory", str(self.path))
        try:
            # An absolute path: `:memory:` would be no file.
            with contextlib.closing(
                sqlite3.connect(os.path.abspath(self.path), timeout=_BUSY_S)
            ) as plain:
                mark, version = (
                    int(plain.execute(f"PRAGMA {name}").fetchone()[0])
                    for name in ("application_id", "user_version")
                )
                holds = int(plain.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])
                if mark == schema.APPLICATION:
                    self._check_pages(plain)
        except sqlite3.DatabaseError as error:
            raise FormatError(f"expected a diary: {error}", file=str(self.path)) from error
        # A file without tables: new, or its maker was killed before it was a diary.
        if create and holds == 0 and mark == 0:
            return
        if mark != schema.APPLICATION:
            raise FormatError("expected a diary, got another file", file=str(self.path))
        if version > schema.VERSION:
            raise FormatError(
                f"expected a diary of version {schema.VERSION} at most, got {version}: a later "
                "manip3d wrote it",
                file=str(self.path),
            )

    def _check_pages(self, plain: sqlite3.Connection) -> None:
        """Refuse a damaged file before anything is written into it."""
        # 1 ms for 300 games, 60 ms for 200 MB of films, as long as quick_check takes.
        (told,) = plain.execute("PRAGMA integrity_check(1)").fetchone()
        if told != "ok":
            raise FormatError(
                f"the diary is damaged: {told}; 'manip3d diary rescue' copies what can be read",
                file=str(self.path),
            )

    def _migrate(self, connection: sql.Connection, version: int) -> None:
        """Bring the file to the version of today; 0: it is new."""
        audit = self._old_audit(connection) if 0 < version < schema.WITH_CHAIN else []
        schema.migrate(connection, version)
        marks = {}
        if version == 0:  # what a key is checked by when the diary is opened
            marks["check"] = seal(self._key, _CHECK, "meta")
        if version < schema.WITH_STUDY:
            marks["study"] = seal(self._key, str(uuid.uuid4()).encode(), _STUDY)
        if version < schema.WITH_CHAIN:
            self._chain_key = new_key()
            marks["audit key"] = seal(self._key, self._chain_key, _CHAIN)
        for name, value in marks.items():
            connection.execute(sql.insert(schema.META).values(name=name, value=value))
        if version < schema.WITH_CHAIN:
            begin_chain(connection, self._chain_key)
        for at, action, number in audit:
            append_row(connection, self._chain_key, action, number, at=at)

    def _old_audit(self, connection: sql.Connection) -> list[tuple[str, str, int | None]]:
        """Time, action and participant of each row of an audit without hashes, by time.

        What is no time is taken over as it stands, first: `audit` names it, and the diary opens.
        """
        rows = connection.exec_driver_sql("SELECT at, action, participant FROM audit").all()
        first = datetime.min.replace(tzinfo=UTC)
        return sorted(((at, what, whose) for at, what, whose in rows),
                      key=lambda row: time_in(row[0]) or first)  # fmt: skip

    def _meta(self, connection: sql.Connection, name: str) -> bytes:
        table = schema.META
        value = connection.execute(
            sql.select(table.c.value).where(table.c.name == name)
        ).scalar_one_or_none()
        if value is None:
            raise FormatError("expected a diary, got another file", file=str(self.path))
        return bytes(value)

    def _read_study(self, connection: sql.Connection) -> str:
        name = unseal(self._key, self._meta(connection, "study"), _STUDY)
        try:
            return str(uuid.UUID(name.decode("ascii")))
        except ValueError:
            raise FormatError("expected a UUID of the study; the diary is damaged",
                              file=str(self.path)) from None  # fmt: skip

    def _check_key(self, connection: sql.Connection) -> None:
        value = self._meta(connection, "check")
        is_plain = value == _CHECK
        if is_plain and self._key is not None:
            raise InputError(f"key: {self.path} is not encrypted; open it without a key")
        if not is_plain and self._key is None:
            raise InputError(f"key: {self.path} is encrypted; its key file is needed")
        if not is_plain:
            try:
                unseal(self._key, value, "meta")
            except FormatError:
                raise FormatError("this key does not open it", file=str(self.path)) from None

    def _on_connect(self, connection: sqlite3.Connection, record: object) -> None:
        # SQLAlchemy says when a transaction begins; sqlite3 begins none for changes of tables.
        connection.isolation_level = None
        try:
            for pragma in (
                "journal_mode = WAL",
                "synchronous = FULL",  # what was acknowledged is on the disk
                "foreign_keys = ON",
                "secure_delete = ON",  # what is deleted or moved is overwritten with zeros
                "temp_store = MEMORY",
            ):
                connection.execute(f"PRAGMA {pragma}")
        except sqlite3.DatabaseError as error:
            raise self._told(error) from error

    def _on_error(self, context: sql.ExceptionContext) -> None:
        if isinstance(context.original_exception, sqlite3.DatabaseError):
            raise self._told(context.original_exception) from context.original_exception

    def _told(self, error: sqlite3.DatabaseError) -> Exception:
        """A full disk, a lock or a file that cannot be written; else the file is damaged."""
        if isinstance(error, sqlite3.OperationalError):
            return OSError(f"{self.path}: {error}")
        return FormatError(f"the diary is damaged: {error}", file=str(self.path))

    # --- rows ------------------------------------------------------------------------------------

    def _all(self, connection: sql.Connection) -> list[tuple[int, bytes | None, dict[str, Any]]]:
        """Number, key and fields of everybody."""
        found = []
        for row in connection.execute(sql.select(schema.PARTICIPANTS)):
            key = None
            if self._key is not None:
                key = unseal(self._key, row.key, f"participants {row.id} key")
            found.append((row.id, key, unseal_fields(key, row.payload, _about(row.id))))
        return found

    def _find(self, connection: sql.Connection, identifier: str) -> tuple[int, bytes | None]:
        for number, key, fields in self._all(connection):
            if fields["identifier"] == identifier:
                return number, key
        raise InputError(f"participant: {identifier!r} is not enrolled in {self.path}")

    def _of_session(self, connection: sql.Connection, session: int) -> tuple[int, bytes | None]:
        table = schema.SESSIONS
        number = connection.execute(
            sql.select(table.c.participant).where(table.c.id == session)
        ).scalar_one_or_none()
        if number is None:
            raise InputError(f"session: there is none of the number {session}")
        return next((n, key) for n, key, _ in self._all(connection) if n == number)

    def _check_owner(self, connection: sql.Connection, session: int, number: int) -> None:
        if self._of_session(connection, session)[0] != number:
            raise InputError(f"session: {session} is another participant's")

    def _add(
        self,
        connection: sql.Connection,
        table: sql.Table,
        number: int,
        key: bytes | None,
        fields: Mapping[str, Any],
        **parents: int | None,
    ) -> int:
        _check_texts(fields)
        row = _new_number()
        payload = seal_fields(key, fields, _about(number, table, row))
        connection.execute(
            sql.insert(table).values(id=row, participant=number, payload=payload, **parents)
        )
        return row

    def _rows(
        self, connection: sql.Connection, table: sql.Table, number: int, key: bytes | None
    ) -> list[tuple[Mapping[str, Any], dict[str, Any]]]:
        rows = connection.execute(sql.select(table).where(table.c.participant == number))
        return [
            (row._asdict(), unseal_fields(key, row.payload, _about(number, table, row.id)))
            for row in rows
        ]

    def _pictures(
        self, connection: sql.Connection, number: int, key: bytes | None
    ) -> Iterator[tuple[Mapping[str, Any], tuple[tuple[float, bytes], ...]]]:
        """Rows of clips, one after the other: they are large."""
        table = schema.CLIPS
        ids = connection.execute(sql.select(table.c.id).where(table.c.participant == number))
        for one in ids.scalars().all():
            row = connection.execute(sql.select(table).where(table.c.id == one)).one()
            yield row._asdict(), unseal_pictures(key, row.payload, _about(number, table, one))

    def _consents(self, connection: sql.Connection, number: int) -> bool:
        fields = next(f for n, _, f in self._all(connection) if n == number)
        return bool(fields.get("clips", False))

    def _fields(self, table: sql.Table, identifier: str) -> list[tuple[dict[str, Any], int]]:
        """Fields and number of each row."""
        with self._engine.begin() as connection:
            number, key = self._find(connection, identifier)
            rows = self._rows(connection, table, number, key)
            return [(fields, row["id"]) for row, fields in rows]

    def _session(
        self, connection: sql.Connection, session: int, number: int, key: bytes | None
    ) -> DiarySession:
        def of_session(table: sql.Table) -> list[tuple[Mapping[str, Any], dict[str, Any]]]:
            rows = self._rows(connection, table, number, key)
            return [(row, fields) for row, fields in rows if row["session"] == session]

        rows = self._rows(connection, schema.SESSIONS, number, key)
        about = next(fields for row, fields in rows if row["id"] == session)
        anomalies = self._rows(connection, schema.ANOMALIES, number, key)
        games = []
        for row, fields in of_session(schema.GAMES):
            times = [(f["start"], f["end"]) for a, f in anomalies if a["game"] == row["id"]]
            games.append(_game(fields, sorted(times), row["id"]))
        ratings = [_rating(fields, row["id"]) for row, fields in of_session(schema.RATINGS)]
        return DiarySession(
            session,
            datetime.fromisoformat(about["started"]),
            datetime.fromisoformat(about["ended"]) if about["ended"] else None,
            tuple(sorted(games, key=lambda game: game.at)),
            tuple(sorted(ratings, key=lambda rating: rating.at)),
            datetime.fromisoformat(about["begun"]) if about.get("begun") else None,
            bool(about.get("answered", True)),
        )

    def _note(
        self,
        connection: sql.Connection,
        action: str,
        number: int | None,
        erased: Sequence[int] = (),
    ) -> None:
        """One more line of the audit."""
        at = datetime.now().astimezone().isoformat()
        append_row(connection, self._chain_key, action, number, at=at, erased=erased)


def _on_begin(connection: sql.Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def _new_number() -> int:
    """Random, so that gaps between numbers do not tell of somebody who was deleted."""
    return secrets.randbelow(2**62 - 1) + 1


def _check_texts(fields: Mapping[str, Any]) -> None:
    """Refuse what no copy could hold and a terminal would obey."""
    for name, value in fields.items():
        if isinstance(value, str) and has_control_characters(value):
            raise InputError(
                f"{name}: expected a text without control characters, got {value[:60]!a}"
            )


def _about(number: int, table: sql.Table | None = None, row: int = 0) -> str:
    """What a payload belongs to: it is encrypted for this place only."""
    return f"participants {number}" if table is None else f"{table.name} {row} of {number}"


def _participant(fields: Mapping[str, Any], number: int) -> Participant:
    enrolled = datetime.fromisoformat(fields["enrolled"])
    clips = fields.get("clips", False)
    return Participant(fields["identifier"], fields["limb"], enrolled, clips, number)


def _rating(fields: Mapping[str, Any], row: int) -> Rating:
    return Rating(datetime.fromisoformat(fields["at"]), fields["pain"], fields["when"], row)


def _game(fields: dict[str, Any], anomalies: Sequence[tuple[float, float]], row: int) -> DiaryGame:
    at = datetime.fromisoformat(fields.pop("at"))
    return DiaryGame(at=at, **fields, anomalies=tuple(anomalies), number=row)
