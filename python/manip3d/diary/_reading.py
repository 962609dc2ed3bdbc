"""`DiaryReading`: reads a diary file into the records of `_records.py`."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d._util.checked import checked
from manip3d._util.closing import Closing
from manip3d._util.paths import path_of
from manip3d.diary import _schema as schema
from manip3d.diary._audit import moment_of
from manip3d.diary._clips import Clip
from manip3d.diary._file import DiaryFile
from manip3d.diary._mcgill import score_mcgill
from manip3d.diary._protocol import PAIN, SICKNESS, is_stop_reason
from manip3d.diary._questionnaires import MCGILL, OWNERSHIP, questionnaire_of
from manip3d.diary._records import (
    AdverseEvent,
    Answers,
    DiaryGame,
    DiarySession,
    ExportedFile,
    FeltRecord,
    McGill,
    Ownership,
    Participant,
    Rating,
    day_of,
)
from manip3d.diary._rows import DiaryTransaction, Enrolled
from manip3d.diary._sealing import require_key_material
from manip3d.errors import FormatError, InputError

if TYPE_CHECKING:
    import sqlalchemy as sql


@checked
class DiaryReading(Closing):
    """The part of `Diary` that opens a file and reads it; parameters and errors are the same."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        key: str | os.PathLike[str] | None = None,
        create: bool = False,
    ) -> None:
        self.path = path_of(path)
        self._file = DiaryFile(self.path, require_key_material(key), create=create)

    def __repr__(self) -> str:
        return f"<manip3d.diary.Diary: {self.path}>"

    def close(self) -> None:
        """Close the file; may be called twice.

        No data are lost if it is not called. Other methods raise an InputError afterwards.
        """
        self._file.close()

    @property
    def study(self) -> str:
        """Random UUID of the study, which distinguishes its participants from those of others."""
        return self._file.study

    def participants(self) -> list[Participant]:
        """Return all participants, sorted by pseudonym."""
        with self._file.begin() as rows:
            found = [_participant(one) for one in rows.everybody()]
        return sorted(found, key=lambda one: one.identifier)

    def participant(self, identifier: str) -> Participant:
        """Return the record of one participant.

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
            found = sessions_of(rows, rows.find(identifier))
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
            for f, row in self._answers(identifier, schema.OWNERSHIP)
        ]
        return sorted(found, key=lambda one: one.at)

    def felt(self, identifier: str) -> list[FeltRecord]:
        """Return a participant's descriptions of the felt phantom limb, by time.

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
                limb=f.get("limb", ""),  # older diaries did not store it
                number=row,
            )
            for f, row in self._answers(identifier, schema.FELT)
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
            All questionnaires, including those of `mcgill` and `ownership` as `MCGILL` and
            `OWNERSHIP`.

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
        found += [self._form(*one) for one in self._answers(identifier, schema.FORM)]
        return sorted(found, key=lambda one: one.at)

    def _form(self, fields: Mapping[str, Any], row: int) -> Answers:
        try:
            form, given = questionnaire_of(fields["form"]), tuple(fields["answers"])
            form.check_answers(given)
        except InputError as error:
            raise FormatError(f"the diary is damaged: {error}", file=str(self.path)) from None
        return Answers(datetime.fromisoformat(fields["at"]), form, given, fields["occasion"], row)

    def _answers(self, identifier: str, kind: str) -> list[tuple[dict[str, Any], int]]:
        """Return filled-in questionnaires of a kind; "": McGill's, which are stored without one."""
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
        """Return why a participant must not play again today; also valid after a restart.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.
        today : date, optional
            Day in this machine's time zone; default: today. Times of events are converted to this
            time zone, because a diary may come from another one.

        Returns
        -------
        str
            Sentence for the patient about the first adverse event of that day that stops sessions
            (pain or sickness), without what a therapist wrote about it; empty: the participant may
            play.

        Raises
        ------
        InputError
            No such participant, or ``today`` has a time.
        """
        day = day_of(today)
        for event in self.events(identifier):
            if event.local_date == day and event.kind != "other":
                told = event.text if is_stop_reason(event.text) else PAIN
                return SICKNESS if event.kind == "sickness" else told
        return ""

    def audit(self) -> list[tuple[datetime, str, str]]:
        """Return the audit log, by time, without the rows of deleted participants.

        Returns
        -------
        list of (datetime, str, str)
            Time, action (``enrol``, ``game``, ``delete`` ...) and participant's pseudonym, which is
            empty for a deletion. `check_audit` verifies that the rows are unchanged.

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
        """Verify the hashes of the audit's rows, which bind each row to all earlier ones.

        The hashes depend on a key. An encrypted diary stores this key encrypted, so that nobody
        without the key file can change a row unnoticed. A plain diary contains the key itself, so
        that damage and changes by other programs are detected, but not a forgery by somebody who
        uses this key. An older copy of the whole file is not detected.

        Raises
        ------
        FormatError
            A row was changed or is missing; the message names the first one.
        """
        with self._file.begin() as rows:
            rows.verify_audit()

    def check(self) -> None:
        """Read the whole file, decrypt every payload and verify the hashes of the audit.

        Raises
        ------
        FormatError
            The file is damaged, or a payload or a row of the audit was changed.
        """
        with self._file.begin() as rows:
            rows.verify()

    def _fields(self, table: sql.Table, identifier: str) -> list[tuple[dict[str, Any], int]]:
        """Return the fields and the number of each row of a participant."""
        with self._file.begin() as rows:
            return [(f, row["id"]) for row, f in rows.read(table, rows.find(identifier))]

    def exports(self, identifier: str) -> list[ExportedFile]:
        """List the files with data of a participant that exports wrote.

        Parameters
        ----------
        identifier : str
            Pseudonym of the participant.

        Returns
        -------
        list of ExportedFile
            Files sorted by path; a table of several participants is listed for each of them.

        Raises
        ------
        InputError
            No such participant.
        """
        with self._file.begin() as rows:
            kept = rows.find(identifier).fields.get("exports", {})
        return [ExportedFile(Path(path), kept[path]) for path in sorted(kept)]


def sessions_of(rows: DiaryTransaction, participant: Enrolled) -> list[DiarySession]:
    """Return the sessions of a participant; each table is read once."""
    times, games, ratings = defaultdict(list), defaultdict(list), defaultdict(list)
    for row, fields in rows.read(schema.ANOMALIES, participant):
        times[row["game"]].append((fields["start"], fields["end"]))
    for row, fields in rows.read(schema.GAMES, participant):
        games[row["session"]].append(_game(fields, sorted(times[row["id"]]), row["id"]))
    for row, fields in rows.read(schema.RATINGS, participant):
        # Early diaries state no order; their ratings are in that of their times.
        ratings[row["session"]].append((fields.get("order", -1), _rating(fields, row["id"])))
    found = []
    for row, about in rows.read(schema.SESSIONS, participant):
        started = datetime.fromisoformat(about["started"])
        ended = datetime.fromisoformat(about["ended"]) if about["ended"] else None
        found.append(
            DiarySession(
                row["id"],
                started,
                None if ended is None else max(started, ended),
                tuple(sorted(games[row["id"]], key=lambda game: game.at)),
                _in_order(ratings[row["id"]]),
                datetime.fromisoformat(about["begun"]) if about.get("begun") else None,
                bool(about.get("answered", True)),
                clock_went_back=ended is not None and ended < started,
                clock_at_end=ended,
            )
        )
    return found


def _in_order(numbered: list[tuple[int, Rating]]) -> tuple[Rating, ...]:
    """Return ratings in their order; times go back where the clock was set back."""
    numbered = sorted(numbered, key=lambda one: (one[1].when == "after", one[0], one[1].at))
    return tuple(rating for _, rating in numbered)


def _participant(enrolled: Enrolled) -> Participant:
    fields = enrolled.fields
    at, clips = datetime.fromisoformat(fields["enrolled"]), fields.get("clips", False)
    return Participant(fields["identifier"], fields["limb"], at, clips, enrolled.number)


def _rating(fields: Mapping[str, Any], row: int) -> Rating:
    return Rating(datetime.fromisoformat(fields["at"]), fields["pain"], fields["when"], row)


def _game(fields: dict[str, Any], anomalies: Sequence[tuple[float, float]], row: int) -> DiaryGame:
    at = datetime.fromisoformat(fields.pop("at"))
    return DiaryGame(at=at, **fields, anomalies=tuple(anomalies), number=row)
