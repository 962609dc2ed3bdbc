"""Audit log of a diary: a chain of rows, each bound to all earlier rows by a keyed hash.

A row has two hashes (HMAC-SHA256): ``digest``, of its content and a random salt, and ``link``, of
the previous row's link and the digest. When a participant is deleted, content and salt of their
rows are erased. The digests remain, so that the links can still be verified, but without the salt
they reveal nothing about the content. The row of the deletion lists the numbers of erased rows.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import sqlalchemy as sql

from manip3d.diary import _schema as schema
from manip3d.errors import FormatError

_SALT = 16  # bytes: more than anybody can try
_HEAD = "audit head"  # entry of `meta`: number of rows, with a hash of the number and last link


def begin_chain(connection: sql.Connection, key: bytes) -> None:
    """Store that there are no rows, so that an empty audit differs from one with lost rows."""
    _write_head(connection, key, 0, "")


def append_row(
    connection: sql.Connection,
    key: bytes,
    action: str,
    participant: int | None,
    *,
    at: str,
    erased: Sequence[int] = (),
) -> None:
    """Add a row within the transaction of the connection.

    ``erased``: numbers of the rows of a deleted participant, as returned by `erase_rows`.
    """
    table = schema.AUDIT
    last = connection.execute(
        sql.select(table.c.number, table.c.link).order_by(table.c.number.desc()).limit(1)
    ).first()
    number, before = (1, "") if last is None else (last.number + 1, last.link)
    row = {
        "number": number,
        "at": at,
        "action": action,
        "participant": participant,
        "erased": json.dumps(list(erased)),
        "salt": secrets.token_hex(_SALT),
    }
    digest = _digest(key, row)
    link = _hash(key, "link", before, digest)
    connection.execute(sql.insert(table).values(**row, digest=digest, link=link))
    _write_head(connection, key, number, link)


def erase_rows(connection: sql.Connection, participant: int) -> list[int]:
    """Erase the content of a participant's rows; return the numbers of these rows."""
    table = schema.AUDIT
    theirs = table.c.participant == participant
    numbers = connection.execute(sql.select(table.c.number).where(theirs).order_by(table.c.number))
    found = [int(number) for number in numbers.scalars()]
    connection.execute(
        sql.update(table).where(theirs).values(at="", action="", participant=None, salt="")
    )
    return found


def verify(connection: sql.Connection, key: bytes, file: str) -> None:
    """Verify the hashes of all rows.

    Raises
    ------
    FormatError
        A row was changed or is missing; the message names the first one.
    """

    def broken(number: int, what: str) -> FormatError:
        return FormatError(f"the audit is damaged: row {number} {what}", file=file)

    before, count = "", 0
    empty, erased = set[int](), set[int]()
    table = schema.AUDIT
    for row in connection.execute(sql.select(table).order_by(table.c.number)).mappings():
        count += 1
        if row["number"] != count:
            raise broken(count, "is missing")
        if row["salt"] == "":
            empty.add(count)
            is_same = (row["at"], row["action"], row["participant"]) == ("", "", None)
        else:
            is_same = _is_equal(_digest(key, row), row["digest"])
            erased |= set(json.loads(row["erased"])) if is_same else set()
        before = _hash(key, "link", before, str(row["digest"]))
        if not (is_same and _is_equal(before, row["link"])):
            raise broken(count, "is not what was written")
    expected = _read_head(connection)
    if expected is None or not hmac.compare_digest(expected, _head(key, count, before)):
        kept = 0 if expected is None else int.from_bytes(expected[:8], "big")
        if kept > count:
            raise broken(count + 1, "is missing")
        raise broken(max(count, 1), "is not the last one that was written")
    if empty != erased:
        raise broken(min(empty ^ erased), "was erased or filled in, and not by a deletion")


def moment_of(text: object, file: str) -> datetime:
    """Return the time of a row."""
    found = time_in(text)
    if found is None:
        raise FormatError("the audit is damaged: expected a time with its offset", file=file)
    return found


def time_in(text: object) -> datetime | None:
    """Return the time in a row; None: the row is damaged and contains no time."""
    try:
        found = datetime.fromisoformat(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
    return None if found.tzinfo is None else found


def _is_equal(expected: str, found: object) -> bool:
    """Compare hashes in constant time; a damaged hash may contain characters outside ASCII."""
    return hmac.compare_digest(expected.encode(), str(found).encode(errors="replace"))


def _digest(key: bytes, row: Any) -> str:
    names = ("number", "at", "action", "participant", "erased")
    return _hash(key, "row", row["salt"], _json([row[name] for name in names]))


def _hash(key: bytes, *parts: str) -> str:
    """Return the hash of texts, encoded as JSON to distinguish ("a", "bc") from ("ab", "c")."""
    return hmac.new(key, _json(parts).encode(), hashlib.sha256).hexdigest()


def _json(values: Sequence[Any]) -> str:
    """Return the content of a row as JSON; bytes in a damaged row are converted to text."""
    return json.dumps(values, default=str)


def _head(key: bytes, count: int, link: str) -> bytes:
    return count.to_bytes(8, "big") + bytes.fromhex(_hash(key, "head", str(count), link))


def _write_head(connection: sql.Connection, key: bytes, count: int, link: str) -> None:
    table = schema.META
    connection.execute(sql.delete(table).where(table.c.name == _HEAD))
    connection.execute(sql.insert(table).values(name=_HEAD, value=_head(key, count, link)))


def _read_head(connection: sql.Connection) -> bytes | None:
    table = schema.META
    found = connection.execute(
        sql.select(table.c.value).where(table.c.name == _HEAD)
    ).scalar_one_or_none()
    return None if found is None else bytes(found)
