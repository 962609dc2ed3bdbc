"""What can still be read of a damaged diary, in a new file."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.diary import _schema as schema
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_path

_FIRST, _LAST = -(2**63), 2**63 - 1  # of the numbers of rows in SQLite


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
        ``output`` exists, or is the diary itself.
    FormatError
        The file is no diary, or is damaged where it says what its tables are or by which key it
        is read.
    OSError
        A file cannot be read or written.

    Notes
    -----
    Rows are read by their numbers, without any index, from both ends of each table up to a page
    that cannot be read. An index is made anew, so that nothing is missing where only that was
    damaged. Rows of a participant or of a session that is missing go with it, as when that is
    deleted. Payloads are copied as they are: `Diary.check` says whether they were changed.

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
        raise FileNotFoundError(2, "No such file or directory", str(source))
    missing: list[str] = []
    with atomic_path(target) as made:
        made.chmod(0o600)
        with _connected(source, "ro") as old, _connected(made, "rw") as new:
            try:
                _make_tables(old, new, source)
                for table in _tables(new):
                    missing += _copy(old, new, table)
            except sqlite3.DatabaseError as error:
                raise FormatError(f"cannot be rescued: {error}", file=str(source)) from error
            _check_marks(new, source)
            missing += _remove_orphans(new)
            num_rows = sum(
                int(new.execute(f"SELECT count(*) FROM {table}").fetchone()[0])
                for table in _tables(new)
            )
            new.commit()
    return DiaryRescue(target, num_rows, tuple(missing))


def _connected(path: Path, mode: str) -> contextlib.closing[sqlite3.Connection]:
    where = f"file:{quote(os.path.abspath(path))}?mode={mode}"
    return contextlib.closing(sqlite3.connect(where, uri=True))


def _make_tables(old: sqlite3.Connection, new: sqlite3.Connection, source: Path) -> None:
    """Make the empty tables of the old file's version."""
    mark, version = (
        int(old.execute(f"PRAGMA {name}").fetchone()[0])
        for name in ("application_id", "user_version")
    )
    if mark != schema.APPLICATION or not 0 < version <= schema.VERSION:
        raise FormatError("expected a diary, got another file or version", file=str(source))
    for statements in schema.MIGRATIONS[:version]:
        for statement in statements:
            new.execute(statement)
    new.execute(f"PRAGMA application_id = {mark}")
    new.execute(f"PRAGMA user_version = {version}")


def _tables(connection: sqlite3.Connection) -> list[str]:
    found = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    return [name for (name,) in found.fetchall()]


def _copy(old: sqlite3.Connection, new: sqlite3.Connection, table: str) -> list[str]:
    """Copy the rows of a table that can be read; say which cannot."""
    columns = [name for _, name, *_ in new.execute(f"PRAGMA table_info({table})")]
    names, places = ", ".join(columns), ", ".join("?" for _ in columns)
    unread: list[str] = []
    for number in _numbers(old, table, unread):
        try:
            row = old.execute(
                f"SELECT {names} FROM {table} NOT INDEXED WHERE rowid = ?", (number,)
            ).fetchone()
            new.execute(
                f"INSERT INTO {table} (rowid, {names}) VALUES (?, {places})", (number, *row)
            )
        except sqlite3.DatabaseError:
            unread.append(f"{table}: row {number} cannot be read")
    return unread


def _numbers(old: sqlite3.Connection, table: str, unread: list[str]) -> Iterator[int]:
    """Numbers of the rows from both ends of a table, up to what cannot be read on either side."""
    query = f"SELECT rowid FROM {table} NOT INDEXED WHERE rowid > ? AND rowid < ? ORDER BY rowid "
    first, last = _FIRST, _LAST
    try:
        while found := old.execute(query + "LIMIT 1", (first, last)).fetchone():
            (first,) = found
            yield first
        return
    except sqlite3.DatabaseError:
        pass
    with contextlib.suppress(sqlite3.DatabaseError):
        while found := old.execute(query + "DESC LIMIT 1", (first, last)).fetchone():
            (last,) = found
            yield last
    begin = f"after {first}" if first != _FIRST else "from the first"
    end = f"before {last}" if last != _LAST else "to the last"
    unread.append(f"{table}: rows {begin} {end} cannot be read")


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
            if table == "audit":  # who did it is forgotten, as when a participant is deleted
                change = "UPDATE audit SET participant = NULL WHERE rowid = ?"
            else:
                change = f"DELETE FROM {table} WHERE rowid = ?"
                told.append(f"{table}: {len(numbers)} of {parent} that cannot be read")
            new.executemany(change, sorted(numbers))
    return told
