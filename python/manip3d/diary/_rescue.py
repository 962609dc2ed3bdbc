"""Rescue of a damaged diary: all rows that can be read are copied to a new file."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.paths import path_of, refuse_existing
from manip3d._util.reprs import short_repr
from manip3d.diary import _schema as schema
from manip3d.diary._file import (
    BESIDE,
    connect,
    empty_file_error,
    expect_regular_file,
    is_filled,
    unchanged,
    words_of,
)
from manip3d.diary._rows import check_payload, read_participant
from manip3d.diary._sealing import check_key, require_key_material
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_path, open_regular

_FIRST, _LAST = -(2**63), 2**63 - 1  # bounds of row numbers in SQLite
_HEAD_BYTES = 100  # size of the header of an SQLite file
_MAX_MISSING = 1 << 36  # largest number of missing bytes; more means that the header is damaged
_OF_WRITING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_HALVINGS = 12  # of the range of row numbers between two damaged pages; numbers may be random


@dataclass(frozen=True)
class DiaryRescue:
    """Result of `rescue_diary`.

    Attributes
    ----------
    output : Path
    num_rows : int
        Number of rows that were copied, of all tables.
    missing : tuple of str
        Descriptions of the rows that could not be copied; empty: nothing is missing.
    """

    output: Path
    num_rows: int
    missing: tuple[str, ...]

    __repr__ = short_repr


@checked
def rescue_diary(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    key: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> DiaryRescue:
    """Copy all readable rows of a damaged diary to a new one, which opens with the same key.

    Parameters
    ----------
    path : path
        The damaged diary, which is not changed.
    output : path
        The new diary.
    key : path, optional
        Key file of an encrypted diary. Without it, encrypted payloads are copied without checks.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    DiaryRescue

    Raises
    ------
    InputError
        ``output`` exists, is no regular file, is the diary itself, or has an SQLite journal next to
        it; or a key is given for a diary that is not encrypted.
    FormatError
        The file is not a diary, its list of tables or the check of its key is damaged, or ``key``
        does not open it.
    OSError
        A file cannot be read or written, or another program is writing to the diary.

    Notes
    -----
    Rows are read by their numbers, without any index: from both ends of each table up to a page
    that cannot be read, then between two such pages. Indices are rebuilt, so that a damaged index
    loses no row. Rows of a page that was overwritten by another page leave no trace and are not
    listed. If a participant or session is missing, its rows are also left out, as in a deletion.
    A row whose payload cannot be decrypted or is not JSON would make the new diary unusable, and
    is left out; the values in a payload are not checked. `Diary.check` reports the audit as damaged
    if audit rows, or participants named in them, are missing. Keep the damaged file as evidence.

    Examples
    --------
    >>> from manip3d.diary import Diary, rescue_diary
    >>> with Diary("damaged.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    >>> rescue_diary("damaged.diary", "rescued.diary").missing
    ()
    """
    source, target = path_of(path, "path"), path_of(output, "output")
    opener = require_key_material(key)
    if target.exists() and not target.is_file():  # a device, which a file would replace
        raise InputError(f"output: expected the name of a regular file, got {target}")
    refuse_existing(target, overwrite=overwrite, name="output")
    if target.exists() and source.exists() and target.samefile(source):
        raise InputError(f"output: expected another file than the diary, got {target}")
    expect_regular_file(source)
    for beside in (Path(f"{target}{ending}") for ending in BESIDE):
        if beside.exists():  # SQLite would apply it to the new diary
            raise InputError(f"output: {beside} belongs to a diary that was not closed")
    missing: list[str] = []
    with atomic_path(target) as made:
        made.chmod(0o600)
        with (
            _whole(source, made, target) as whole,
            _to_read(whole) as old,
            _connected(made, "rw") as new,
        ):
            try:
                old.execute("BEGIN")  # later writes of other programs are not seen
                version = _version(old, source)
            except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
                _raise_if_busy(error, source)
                _raise_if_full(error, source)
                raise FormatError(f"cannot be rescued: {error}", file=str(source)) from error
            try:
                new.execute("BEGIN")
                _make_tables(new, version)
                for table in _tables(new):
                    missing += _copy(old, new, table, source)
                _check_marks(new, source)
                missing += _remove_damaged(new, opener, source)
                missing += _remove_orphans(new)
                num_rows = sum(
                    int(new.execute(f"SELECT count(*) FROM {table}").fetchone()[0])
                    for table in _tables(new)
                )
                new.execute("COMMIT")
            except sqlite3.Error as error:
                is_full = getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_FULL
                code = errno.ENOSPC if is_full else errno.EIO
                raise OSError(code, f"cannot be written: {error}", str(target)) from error
    return DiaryRescue(target, num_rows, tuple(missing))


@contextlib.contextmanager
def _whole(source: Path, made: Path, target: Path) -> Iterator[Path]:
    """Yield the file; if its end is missing, yield a copy with blank pages at the end.

    The end is missing after an interrupted copy. SQLite refuses a file with fewer pages than its
    header says.
    """
    with open_regular(source) as file:
        head = file.read(_HEAD_BYTES)
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    size, there = page * int.from_bytes(head[28:32], "big"), source.stat().st_size
    if not head.startswith(b"SQLite format 3\0") or not there < size <= there + _MAX_MISSING:
        yield source
        return
    with tempfile.TemporaryDirectory(dir=made.parent, prefix=f".{made.name}.") as folder:
        copy = Path(folder) / source.name
        log = Path(f"{source}-wal")
        try:
            shutil.copyfile(source, copy)
            copy.chmod(0o600)
            if log.is_file():
                shutil.copyfile(log, f"{copy}-wal")
        except OSError as error:  # whose file name is the source's, whichever of the two failed
            if error.errno in _OF_WRITING:
                raise OSError(error.errno, error.strerror, str(target)) from error
            raise
        os.truncate(copy, there // page * page)  # of an incomplete page, rows would read as zeros
        os.truncate(copy, size)
        yield copy


@contextlib.contextmanager
def _to_read(path: Path) -> Iterator[sqlite3.Connection]:
    """Connect to a diary without changing it, and without leaving files beside it.

    SQLite makes a log beside a file that has been written with one, for which a full disk has no
    room. Where no other program has left or opened the log, the file is therefore read as if
    nothing could change it; a change is noticed at the end.

    Raises
    ------
    OSError
        Another program changed the file meanwhile.
    """
    with open_regular(path) as file:
        is_logged = file.read(_HEAD_BYTES)[18:19] == b"\x02"
    has_log = is_filled(f"{path}-wal")
    is_closed = is_logged and not has_log
    mode = "ro&immutable=1" if is_closed else "ro" if has_log else "rw"
    is_fixed = unchanged(path, path) if is_closed else contextlib.nullcontext()
    with is_fixed, _connected(path, mode) as connection:
        connection.execute("PRAGMA query_only = 1")
        yield connection


def _connected(path: Path, mode: str) -> contextlib.closing[sqlite3.Connection]:
    return contextlib.closing(connect(path, mode, isolation_level=None))


def _raise_if_busy(error: Exception, source: Path) -> None:
    """Raise OSError if another program has locked the diary, because this is no damage."""
    # Python's own errors, as about text that is not UTF-8, have no code of SQLite.
    if getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        raise OSError(errno.EBUSY, str(error), str(source)) from error


def _raise_if_full(error: Exception, source: Path) -> None:
    """Raise OSError if the disk is full or cannot be written, because this is no damage."""
    if isinstance(error, sqlite3.DatabaseError) and (words := words_of(error, source)) != str(
        error
    ):
        is_full = error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_IOERR
        raise OSError(errno.ENOSPC if is_full else errno.EROFS, words, str(source)) from error


def _version(old: sqlite3.Connection, source: Path) -> int:
    mark, version = (
        int(old.execute(f"PRAGMA {name}").fetchone()[0])
        for name in ("application_id", "user_version")
    )
    if mark == 0 and not _tables(old):
        raise empty_file_error(source)
    if mark != schema.APPLICATION or not 0 < version <= schema.VERSION:
        raise FormatError("expected a diary, got another file or version", file=str(source))
    return version


def _make_tables(new: sqlite3.Connection, version: int) -> None:
    """Create the empty tables of the old file's version."""
    for statements in schema.MIGRATIONS[:version]:
        for statement in statements:
            new.execute(statement)
    new.execute(f"PRAGMA application_id = {schema.APPLICATION}")
    new.execute(f"PRAGMA user_version = {version}")


def _tables(connection: sqlite3.Connection) -> list[str]:
    found = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    return [name for (name,) in found.fetchall()]


def _copy(old: sqlite3.Connection, new: sqlite3.Connection, table: str, source: Path) -> list[str]:
    """Copy the readable rows of a table; return descriptions of the others."""
    columns = [name for _, name, *_ in new.execute(f"PRAGMA table_info({table})")]
    names, places = ", ".join(columns), ", ".join("?" for _ in columns)
    reader = _Reader(old, source)
    unread: list[str] = []
    lost: list[list[int]] = []
    for number in _numbers(reader, table, (_FIRST, _LAST), lost, _HALVINGS):
        row = reader.one(f"SELECT {names} FROM {table} NOT INDEXED WHERE rowid = ?", number)
        try:
            if row:
                new.execute(
                    f"INSERT INTO {table} (rowid, {names}) VALUES (?, {places})", (number, *row)
                )
        except (sqlite3.IntegrityError, sqlite3.DataError):  # a damaged row that can still be read
            row = None
        if not row:
            unread.append(f"{table}: row {number} cannot be read")
    return unread + [_in_words(table, *between) for between in lost]


class _Reader:
    """Reads single rows of a file that is damaged somewhere."""

    def __init__(self, old: sqlite3.Connection, source: Path) -> None:
        self._old, self._source = old, source

    def one(self, query: str, *values: int) -> tuple[Any, ...] | None:
        """Return the first row of a query; (): there is none; None: it cannot be read."""
        try:
            return tuple(self._old.execute(query, values).fetchone() or ())
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # a name may not be UTF-8
            _raise_if_busy(error, self._source)
            return None


def _numbers(
    reader: _Reader, table: str, between: tuple[int, int], lost: list[list[int]], halvings: int
) -> Iterator[int]:
    """Yield the numbers of readable rows between two numbers, from both ends to a damaged page.

    The range between two damaged pages is halved, and each half is read in the same way. The bounds
    of ranges that cannot be read are appended to ``lost``.
    """
    first, last = between
    query = f"SELECT rowid FROM {table} NOT INDEXED WHERE rowid > ? AND rowid < ? ORDER BY rowid "
    # A page that was overwritten by a copy of another page leads back to rows already read.
    while (found := reader.one(query + "LIMIT 1", first, last)) and first < found[0] < last:
        (first,) = found
        yield first
    if found == ():
        return
    while (found := reader.one(query + "DESC LIMIT 1", first, last)) and first < found[0] < last:
        (last,) = found
        yield last
    if found == ():
        return
    middle = (first + last) // 2
    if halvings and first + 1 < middle:
        yield from _numbers(reader, table, (first, middle + 1), lost, halvings - 1)
        yield from _numbers(reader, table, (middle, last), lost, halvings - 1)
    elif lost and first < lost[-1][1]:  # the second half of a range: extend the first half's entry
        lost[-1][1] = last
    else:
        lost.append([first, last])


def _in_words(table: str, first: int, last: int) -> str:
    begin = f"after {first}" if first != _FIRST else "from the first"
    end = f"before {last}" if last != _LAST else "to the last"
    return f"{table}: rows {begin} {end} cannot be read"


def _check_marks(new: sqlite3.Connection, source: Path) -> None:
    """Refuse a copy without the entries that are needed to open it: key check and study."""
    version = int(new.execute("PRAGMA user_version").fetchone()[0])
    wanted = {"check"}
    wanted |= {"study"} if version >= schema.WITH_STUDY else set()
    wanted |= {"audit key"} if version >= schema.WITH_CHAIN else set()
    found = {name for (name,) in new.execute("SELECT name FROM meta")}
    if lost := sorted(wanted - found):
        raise FormatError(f"cannot be rescued: {', '.join(lost)} cannot be read", file=str(source))


def _remove_damaged(new: sqlite3.Connection, key: bytes | None, source: Path) -> list[str]:
    """Delete rows whose payload cannot be opened; return which, as texts."""
    ((value,),) = new.execute("SELECT value FROM meta WHERE name = 'check'")
    if not check_key(value, key, source):
        return []  # an encrypted diary without its key
    told = []
    keys: dict[int, bytes | None] = {}  # of the participants that can be read
    tables = [name for name in _tables(new) if name not in ("meta", "audit", "participants")]
    for table in ["participants", *tables]:
        for (number,) in new.execute(f"SELECT id FROM {table}").fetchall():
            query = f"SELECT * FROM {table} WHERE id = ?"
            found = new.execute(query, (number,))
            row = dict(zip((name for name, *_ in found.description), found.fetchone(), strict=True))
            try:
                if table == "participants":
                    keys[number] = read_participant(key, number, row["key"], row["payload"])
                elif row["participant"] in keys:  # other rows are orphans
                    whose = row["participant"]
                    check_payload(table, number, whose, keys[whose], row["payload"])
            except (FormatError, TypeError):  # a damaged type gives a number for a payload
                new.execute(f"DELETE FROM {table} WHERE id = ?", (number,))
                told.append(f"{table}: the content of row {number} cannot be read")
    return told


def _remove_orphans(new: sqlite3.Connection) -> list[str]:
    """Delete rows whose participant, session or game is missing; return how many, as texts."""
    told = []
    while orphans := new.execute("PRAGMA foreign_key_check").fetchall():
        for table, parent in sorted({(table, parent) for table, _, parent, _ in orphans}):
            numbers = {(row,) for name, row, of, _ in orphans if (name, of) == (table, parent)}
            if table == "audit":
                change = "UPDATE audit SET participant = NULL WHERE rowid = ?"
                told.append(
                    f"audit: of whom {len(numbers)} entries are; a check calls them damaged"
                )
            else:
                change = f"DELETE FROM {table} WHERE rowid = ?"
                told.append(f"{table}: {len(numbers)} of {parent} that cannot be read")
            new.executemany(change, sorted(numbers))
    return told
