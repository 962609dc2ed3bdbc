"""A damaged diary is copied into a new file, as far as it can be read."""

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
from urllib.parse import quote

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.diary import _schema as schema
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_path, open_regular

_FIRST, _LAST = -(2**63), 2**63 - 1  # before and behind the numbers of rows in SQLite
_HEAD_BYTES = 100  # of a file of SQLite
_MOST_MISSING = 1 << 36  # bytes that are missing at a file's end; a damaged head says anything
_HALVINGS = 12  # of the numbers between two damaged pages, which are random or consecutive


@dataclass(frozen=True)
class DiaryRescue:
    """Result of `rescue_diary`.

    Attributes
    ----------
    output : Path
    num_rows : int
        Rows of all tables that were copied.
    missing : tuple of str
        What could not be copied, in words; empty where nothing is missing.
    """

    output: Path
    num_rows: int
    missing: tuple[str, ...]


@checked
def rescue_diary(
    path: str | os.PathLike[str], output: str | os.PathLike[str], *, overwrite: bool = False
) -> DiaryRescue:
    """Copy what can be read of a damaged diary into a new one, which opens with the same key.

    Parameters
    ----------
    path : path
        The damaged diary. It is not written to.
    output : path
        The new diary.
    overwrite : bool
        Replace a file that is there.

    Returns
    -------
    DiaryRescue

    Raises
    ------
    InputError
        ``output`` exists, or is the diary itself, or has a journal of SQLite beside it.
    FormatError
        The file is not a diary, or is damaged where it says what its tables are or by which key it
        is read.
    OSError
        A file cannot be read or written; another program writes to the diary.

    Notes
    -----
    Rows are read by their numbers, without any index: from both ends of each table up to a page
    that cannot be read, then what lies between two such pages. An index is made anew, so that
    nothing is missing where only that was damaged. Rows that another page has replaced leave no
    trace and are not named. Rows of a participant or of a session that is missing go with it, as
    when that is deleted. Payloads are copied as they are: `Diary.check` says whether they were
    changed. Where entries of the audit or the participants they name are missing, it calls the
    audit damaged; the damaged file stays the evidence.

    Examples
    --------
    >>> from manip3d.diary import Diary, rescue_diary
    >>> with Diary("damaged.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    >>> rescue_diary("damaged.diary", "rescued.diary").missing
    ()
    """
    source, target = path_of(path, "path"), path_of(output, "output")
    if target.exists() and not overwrite:
        raise InputError(f"output: {target} exists")
    if target.exists() and source.exists() and target.samefile(source):
        raise InputError(f"output: expected another file than the diary, got {target}")
    if not source.is_file():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(source))
    for beside in (Path(f"{target}{ending}") for ending in ("-wal", "-shm", "-journal")):
        if beside.exists():  # SQLite would play it back into the new diary
            raise InputError(f"output: {beside} belongs to a diary that was not closed")
    missing: list[str] = []
    with atomic_path(target) as made:
        made.chmod(0o600)
        with (
            _whole(source, made) as whole,
            _connected(whole, "ro") as old,
            _connected(made, "rw") as new,
        ):
            try:
                old.execute("BEGIN")  # what is written meanwhile is not seen
                version = _version(old, source)
            except sqlite3.DatabaseError as error:
                _raise_if_busy(error, source)
                raise FormatError(f"cannot be rescued: {error}", file=str(source)) from error
            try:
                new.execute("BEGIN")
                _make_tables(new, version)
                for table in _tables(new):
                    missing += _copy(old, new, table, source)
                _check_marks(new, source)
                missing += _remove_orphans(new)
                num_rows = sum(
                    int(new.execute(f"SELECT count(*) FROM {table}").fetchone()[0])
                    for table in _tables(new)
                )
                new.execute("COMMIT")
            except sqlite3.Error as error:
                raise OSError(errno.EIO, f"cannot be written: {error}", str(target)) from error
    return DiaryRescue(target, num_rows, tuple(missing))


@contextlib.contextmanager
def _whole(source: Path, made: Path) -> Iterator[Path]:
    """The file, or where its end is missing, as after a copy that stopped, one with blank pages.

    SQLite reads nothing of a file that has fewer pages than its head says.
    """
    with open_regular(source) as file:
        head = file.read(_HEAD_BYTES)
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    size, there = page * int.from_bytes(head[28:32], "big"), source.stat().st_size
    if not head.startswith(b"SQLite format 3\0") or not there < size <= there + _MOST_MISSING:
        yield source
        return
    with tempfile.TemporaryDirectory(dir=made.parent, prefix=f".{made.name}.") as folder:
        copy = Path(folder) / source.name
        shutil.copyfile(source, copy)
        copy.chmod(0o600)
        log = Path(f"{source}-wal")
        if log.is_file():
            shutil.copyfile(log, f"{copy}-wal")
        os.truncate(copy, there // page * page)  # of a part of a page rows would read as zeros
        os.truncate(copy, size)
        yield copy


def _connected(path: Path, mode: str) -> contextlib.closing[sqlite3.Connection]:
    where = f"file:{quote(os.path.abspath(path))}?mode={mode}"
    return contextlib.closing(sqlite3.connect(where, uri=True, isolation_level=None))


def _raise_if_busy(error: sqlite3.Error, source: Path) -> None:
    """Another program holds the diary: that says nothing about damage."""
    if error.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        raise OSError(errno.EBUSY, str(error), str(source)) from error


def _version(old: sqlite3.Connection, source: Path) -> int:
    mark, version = (
        int(old.execute(f"PRAGMA {name}").fetchone()[0])
        for name in ("application_id", "user_version")
    )
    if mark != schema.APPLICATION or not 0 < version <= schema.VERSION:
        raise FormatError("expected a diary, got another file or version", file=str(source))
    return version


def _make_tables(new: sqlite3.Connection, version: int) -> None:
    """Make the empty tables of the old file's version."""
    for statements in schema.MIGRATIONS[:version]:
        for statement in statements:
            new.execute(statement)
    new.execute(f"PRAGMA application_id = {schema.APPLICATION}")
    new.execute(f"PRAGMA user_version = {version}")


def _tables(connection: sqlite3.Connection) -> list[str]:
    found = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    return [name for (name,) in found.fetchall()]


def _copy(old: sqlite3.Connection, new: sqlite3.Connection, table: str, source: Path) -> list[str]:
    """Copy the rows of a table that can be read; say which cannot."""
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
        except (sqlite3.IntegrityError, sqlite3.DataError):  # damage that still reads as a row
            row = None
        if not row:
            unread.append(f"{table}: row {number} cannot be read")
    return unread + [_in_words(table, *between) for between in lost]


class _Reader:
    """Reads single rows of a file that is damaged somewhere."""

    def __init__(self, old: sqlite3.Connection, source: Path) -> None:
        self._old, self._source = old, source

    def one(self, query: str, *values: int) -> tuple[Any, ...] | None:
        """The first row that a query finds, () where there is none; None: it cannot be read."""
        try:
            return tuple(self._old.execute(query, values).fetchone() or ())
        except sqlite3.DatabaseError as error:
            _raise_if_busy(error, self._source)
            return None


def _numbers(
    reader: _Reader, table: str, between: tuple[int, int], lost: list[list[int]], halvings: int
) -> Iterator[int]:
    """Numbers of the rows between two numbers, from both ends up to what cannot be read.

    What is left between two damaged pages is halved, and each half read in the same way. What
    cannot be read is added to ``lost``: the numbers before and behind it.
    """
    first, last = between
    query = f"SELECT rowid FROM {table} NOT INDEXED WHERE rowid > ? AND rowid < ? ORDER BY rowid "
    # A page that is a copy of another one leads back, to rows that were read before.
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
    elif lost and first < lost[-1][1]:  # both halves of what was halved
        lost[-1][1] = last
    else:
        lost.append([first, last])


def _in_words(table: str, first: int, last: int) -> str:
    begin = f"after {first}" if first != _FIRST else "from the first"
    end = f"before {last}" if last != _LAST else "to the last"
    return f"{table}: rows {begin} {end} cannot be read"


def _check_marks(new: sqlite3.Connection, source: Path) -> None:
    """Refuse what would not open: by which key the diary is read, and its study."""
    version = int(new.execute("PRAGMA user_version").fetchone()[0])
    wanted = {"check"}
    wanted |= {"study"} if version >= schema.WITH_STUDY else set()
    wanted |= {"audit key"} if version >= schema.WITH_CHAIN else set()
    found = {name for (name,) in new.execute("SELECT name FROM meta")}
    if lost := sorted(wanted - found):
        raise FormatError(f"cannot be rescued: {', '.join(lost)} cannot be read", file=str(source))


def _remove_orphans(new: sqlite3.Connection) -> list[str]:
    """Delete rows of what is missing, as if that had been deleted; say how many."""
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
