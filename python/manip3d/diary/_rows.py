"""Access to the rows of a diary within one transaction.

Payloads are encrypted with the participant's key when they are written and decrypted when they are
read. Each payload is bound to its row, so that two payloads cannot be swapped unnoticed.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sql

from manip3d._util.texts import has_control_characters
from manip3d.diary import _schema as schema
from manip3d.diary._audit import append_row, erase_rows, verify
from manip3d.diary._clips import Pictures, seal_pictures, unseal_pictures
from manip3d.diary._sealing import new_key, seal, seal_fields, unseal, unseal_fields
from manip3d.errors import FormatError, InputError

_PARTICIPANT_TABLES = (
    schema.SESSIONS,
    schema.GAMES,
    schema.ANOMALIES,
    schema.RATINGS,
    schema.QUESTIONNAIRES,
    schema.EVENTS,
)  # clips are treated separately, because their payloads are pictures


@dataclass(frozen=True)
class Enrolled:
    """A participant: number of the row, key, and fields."""

    number: int
    key: bytes | None
    fields: Mapping[str, Any]


class DiaryTransaction:
    """Reads and writes rows through the connection of one transaction.

    ``key`` is the diary's key, which encrypts the participants' keys; ``chain_key`` is the key of
    the audit.
    """

    def __init__(
        self, connection: sql.Connection, path: Path, key: bytes | None, chain_key: bytes
    ) -> None:
        self.connection = connection
        self._path = path
        self._key = key
        self._chain_key = chain_key

    # --- participants ----------------------------------------------------------------------------

    def everybody(self) -> list[Enrolled]:
        """Return all participants."""
        found = []
        for row in self.connection.execute(sql.select(schema.PARTICIPANTS)):
            key = None
            if self._key is not None:
                key = unseal(self._key, row.key, _key_of(row.id))
            found.append(Enrolled(row.id, key, unseal_fields(key, row.payload, _about(row.id))))
        return found

    def find(self, identifier: str) -> Enrolled:
        """Return the participant with a pseudonym; raise InputError if there is none."""
        for participant in self.everybody():
            if participant.fields["identifier"] == identifier:
                return participant
        raise InputError(f"participant: {identifier!r} is not enrolled in {self._path}")

    def find_by_session(self, session: int) -> Enrolled:
        """Return the participant of a session; raise InputError if there is no such session."""
        table = schema.SESSIONS
        number = self.connection.execute(
            sql.select(table.c.participant).where(table.c.id == session)
        ).scalar_one_or_none()
        if number is None:
            raise InputError(f"session: there is no session number {session}")
        for participant in self.everybody():
            if participant.number == number:
                return participant
        raise FormatError("the diary has rows without a participant", file=str(self._path))

    def check_owner(self, session: int, participant: Enrolled) -> None:
        """Raise InputError if a session is not this participant's."""
        if self.find_by_session(session).number != participant.number:
            raise InputError(f"session: {session} is another participant's")

    def enrol(self, fields: Mapping[str, Any]) -> int:
        """Add a participant, with a key of their own if the diary is encrypted."""
        check_texts(fields)
        number, key = _new_number(), new_key() if self._key else None
        wrapped = seal(self._key, key, _key_of(number)) if key else b""
        self.connection.execute(
            sql.insert(schema.PARTICIPANTS).values(
                id=number, key=wrapped, payload=seal_fields(key, fields, _about(number))
            )
        )
        return number

    def change(self, participant: Enrolled, fields: Mapping[str, Any]) -> None:
        """Set some of the fields of a participant."""
        check_texts(fields)
        payload = seal_fields(
            participant.key, {**participant.fields, **fields}, _about(participant.number)
        )
        table = schema.PARTICIPANTS
        done = self.connection.execute(
            sql.update(table).where(table.c.id == participant.number).values(payload=payload)
        )
        if done.rowcount != 1:
            name = participant.fields["identifier"]
            raise InputError(f"participant: {name!r} is no longer enrolled in {self._path}")

    def delete(self, participant: Enrolled) -> None:
        """Delete a participant with all their rows; only the digests of their audit rows remain."""
        erased = erase_rows(self.connection, participant.number)
        table = schema.PARTICIPANTS
        self.connection.execute(sql.delete(table).where(table.c.id == participant.number))
        self.note("delete", None, erased)

    # --- what they said and did ------------------------------------------------------------------

    def add(
        self,
        table: sql.Table,
        participant: Enrolled,
        fields: Mapping[str, Any],
        **parents: int | None,
    ) -> int:
        """Add a row and return its number; ``parents``: numbers of the rows that it belongs to."""
        check_texts(fields)
        row = _new_number()
        payload = seal_fields(participant.key, fields, _about(participant.number, table, row))
        self._insert(table, row, participant, payload, parents)
        return row

    def replace(
        self,
        table: sql.Table,
        row: int,
        participant: Enrolled,
        fields: Mapping[str, Any],
        **parents: int,
    ) -> bool:
        """Replace the fields of a row; return False if its parents have no such row."""
        check_texts(fields)
        payload = seal_fields(participant.key, fields, _about(participant.number, table, row))
        is_row = [
            table.c.id == row,
            *(table.c[name] == row_number for name, row_number in parents.items()),
        ]
        done = self.connection.execute(sql.update(table).where(*is_row).values(payload=payload))
        return bool(done.rowcount == 1)

    def read(
        self, table: sql.Table, participant: Enrolled
    ) -> list[tuple[Mapping[str, Any], dict[str, Any]]]:
        """Return columns and fields of each row of a participant."""
        rows = self.connection.execute(
            sql.select(table).where(table.c.participant == participant.number)
        )
        return [(row._asdict(), self._fields(table, row, participant)) for row in rows]

    def read_one(self, table: sql.Table, row: int, participant: Enrolled) -> dict[str, Any]:
        """Return the fields of an existing row."""
        found = self.connection.execute(sql.select(table).where(table.c.id == row)).one()
        return self._fields(table, found, participant)

    def delete_anomalies(self, game: int) -> None:
        """Delete the anomalies of a game."""
        table = schema.ANOMALIES
        self.connection.execute(sql.delete(table).where(table.c.game == game))

    def has_clips(self, participant: Enrolled) -> bool:
        """Return whether a participant has any clip."""
        table = schema.CLIPS
        one = sql.select(table.c.id).where(table.c.participant == participant.number).limit(1)
        return self.connection.execute(one).first() is not None

    def add_clip(self, participant: Enrolled, anomaly: int, pictures: Pictures) -> None:
        """Add the pictures of an anomaly, encrypted like all other payloads."""
        clip = _new_number()
        about = _about(participant.number, schema.CLIPS, clip)
        payload = seal_pictures(participant.key, pictures, about)
        self._insert(schema.CLIPS, clip, participant, payload, {"anomaly": anomaly})

    def read_clips(
        self, participant: Enrolled
    ) -> Iterator[tuple[int, tuple[tuple[float, bytes], ...]]]:
        """Yield the anomaly and the pictures of each clip, one at a time because they are large."""
        table = schema.CLIPS
        ids = self.connection.execute(
            sql.select(table.c.id).where(table.c.participant == participant.number)
        )
        for one in ids.scalars().all():
            row = self.connection.execute(sql.select(table).where(table.c.id == one)).one()
            about = _about(participant.number, table, one)
            yield row.anomaly, unseal_pictures(participant.key, row.payload, about)

    def delete_clips(self, participant: Enrolled) -> None:
        """Delete the clips of a participant."""
        table = schema.CLIPS
        self.connection.execute(sql.delete(table).where(table.c.participant == participant.number))

    # --- the audit, and all of it ----------------------------------------------------------------

    def note(self, action: str, number: int | None, erased: Sequence[int] = ()) -> None:
        """Add a row to the audit; ``erased``: numbers of the rows that a deletion erased."""
        at = datetime.now().astimezone().isoformat()
        append_row(self.connection, self._chain_key, action, number, at=at, erased=erased)

    def read_audit(self) -> Sequence[sql.Row[Any]]:
        """Return the rows of the audit without erased ones."""
        table = schema.AUDIT
        return self.connection.execute(
            sql.select(table).where(table.c.salt != "").order_by(table.c.number)
        ).all()

    def verify_audit(self) -> None:
        """Raise FormatError if a row of the audit was changed or is missing."""
        verify(self.connection, self._chain_key, str(self._path))

    def verify(self) -> None:
        """Raise FormatError if any page, row, payload or hash was changed."""
        told = self.connection.exec_driver_sql("PRAGMA integrity_check").scalars().all()
        if told != ["ok"]:
            raise FormatError(f"the diary is damaged: {told[0]}", file=str(self._path))
        if self.connection.exec_driver_sql("PRAGMA foreign_key_check").first() is not None:
            raise FormatError("the diary has rows without a participant", file=str(self._path))
        for participant in self.everybody():
            for table in _PARTICIPANT_TABLES:
                self.read(table, participant)
            for _ in self.read_clips(participant):
                pass
        self.verify_audit()

    def _insert(
        self,
        table: sql.Table,
        row: int,
        participant: Enrolled,
        payload: bytes,
        parents: Mapping[str, int | None],
    ) -> None:
        self.connection.execute(
            sql.insert(table).values(
                id=row, participant=participant.number, payload=payload, **parents
            )
        )

    def _fields(self, table: sql.Table, row: sql.Row[Any], participant: Enrolled) -> dict[str, Any]:
        about = _about(participant.number, table, row.id)
        return unseal_fields(participant.key, row.payload, about)


def read_participant(
    key: bytes | None, number: int, wrapped: bytes, payload: bytes
) -> bytes | None:
    """Return a participant's own key; raise FormatError if the row cannot be opened.

    ``key`` is the diary's key, or None for a diary that is not encrypted.
    """
    own = None if key is None else unseal(key, wrapped, _key_of(number))
    if "identifier" not in unseal_fields(own, payload, _about(number)):
        raise FormatError(f"{_about(number)}: expected an identifier")
    return own


def check_payload(table: str, row: int, number: int, key: bytes | None, payload: bytes) -> None:
    """Raise FormatError if a payload cannot be opened with the key of participant ``number``."""
    about = _about(number, schema.TABLES[table], row)
    if table == schema.CLIPS.name:
        unseal_pictures(key, payload, about)
    else:
        unseal_fields(key, payload, about)


def check_texts(fields: Mapping[str, Any]) -> None:
    """Refuse control characters, which exports cannot contain and terminals would execute.

    Texts within lists and mappings, and the keys of mappings, are checked, too.
    """
    for name, value in fields.items():
        for text in _texts_in(value):
            if has_control_characters(text):
                raise InputError(
                    f"{name}: expected a text without control characters, got {text[:60]!a}"
                )


def _texts_in(value: object) -> Iterator[str]:
    """Yield the texts of a value that is a text, a list, a mapping, or holds some of these."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _texts_in(key)
            yield from _texts_in(each)
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _texts_in(each)


def _new_number() -> int:
    """Return a random row number, so that gaps do not reveal deleted participants."""
    return secrets.randbelow(2**62 - 1) + 1


def _about(number: int, table: sql.Table | None = None, row: int = 0) -> str:
    """Return the name of a payload's row, to which its encryption is bound."""
    return f"participants {number}" if table is None else f"{table.name} {row} of {number}"


def _key_of(number: int) -> str:
    """Return the name to which the encryption of a participant's key is bound."""
    return f"participants {number} key"
