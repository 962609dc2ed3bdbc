"""The SQLite file of a diary: open, check, migrate to the current version, lock and close."""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import uuid
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sql

from manip3d._util.durable import folder_beside, sync_folder
from manip3d.diary import _schema as schema
from manip3d.diary._audit import append_row, begin_chain, time_in
from manip3d.diary._rows import DiaryTransaction
from manip3d.diary._sealing import CHECK, check_key, new_key, seal, unseal
from manip3d.errors import FormatError, InputError

_STUDY = "meta study"  # purpose to which the encryption of the study's identifier is bound
_CHAIN = "meta audit key"
_WITHOUT_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS)
"""Errors of a file system without hard links, on which a diary is made directly in its place."""
_MIN_BYTES = 1 << 16  # size of two pages of the write-ahead log's index, bytes
_FIXED = "ro&immutable=1"
"""Mode in which SQLite reads a file as if nothing could change it."""
BESIDE = ("-wal", "-shm", "-journal")
"""Endings of the files that SQLite keeps beside a diary."""
_BUSY_S = 5.0  # longest wait for another program that writes, seconds


class DiaryFile:
    """An open diary file, which is locked only during transactions.

    A file that cannot be written, or whose folder cannot, is opened to be read only.

    Raises InputError, FormatError and OSError as `Diary` does.
    """

    def __init__(
        self, path: Path, key: bytes | None, *, create: bool, told_as: Path | None = None
    ) -> None:
        self.path = path
        self.key = key
        self._is_closed = False
        self.place = Path(os.path.abspath(path))  # holds after a change of the working directory
        self._told_as = self.place if told_as is None else told_as
        if create and told_as is None and not os.path.lexists(path):
            _make(path, key)
        with self._unchanged():
            self._open(create)

    def _open(self, create: bool) -> None:
        """Check the file, migrate it to the current version and read what each access needs."""
        self._check_file(create)
        self.engine = sql.create_engine(
            "sqlite://",
            creator=self._connect,
            poolclass=sql.pool.NullPool,
        )
        sql.event.listen(self.engine, "connect", self._on_connect)
        sql.event.listen(self.engine, "begin", _on_begin)
        sql.event.listen(self.engine, "handle_error", self._on_error)
        with self.engine.begin() as connection:
            # Another program may have made or changed the file in the meantime.
            now = int(connection.exec_driver_sql("PRAGMA user_version").scalar_one())
            if now > 0:
                self._check_key(connection)  # the key is checked before anything is written with it
            if now < schema.VERSION:
                self._refuse_to_migrate_what_is_read_only()
                self._migrate(connection, now)
            self.study = self._read_study(connection)
            self.chain_key = unseal(self.key, self._meta(connection, "audit key"), _CHAIN)

    def close(self) -> None:
        self._is_closed = True
        self.engine.dispose()

    def _refuse_if_closed(self) -> None:
        if self._is_closed:
            raise InputError(f"diary: {self.path} was closed")

    @contextlib.contextmanager
    def begin(self) -> Iterator[DiaryTransaction]:
        """Run a transaction: all of it is written at its end, or nothing if it raises."""
        self._refuse_if_closed()
        with self._unchanged(), self.engine.begin() as connection:
            yield self._rows(connection)

    @contextlib.contextmanager
    def begin_without_remains(self) -> Iterator[DiaryTransaction]:
        """Run a transaction after which deleted content is neither in the file nor beside it."""
        self._refuse_if_closed()
        self.refuse_if_read_only()
        with self.engine.connect() as connection:
            raw = connection.connection.dbapi_connection
            assert isinstance(raw, sqlite3.Connection)
            # Empties the write-ahead log; fails while another program has the file open.
            try:
                mode = raw.execute("PRAGMA journal_mode = DELETE").fetchone()[0]
            except sqlite3.OperationalError:
                mode = "wal"
            except sqlite3.DatabaseError as error:
                raise self._told(error) from error
            if mode != "delete":
                raise OSError(
                    f"{self._told_as}: another program has the diary open; nothing deleted"
                )
            with connection.begin():
                yield self._rows(connection)
            try:
                raw.execute("VACUUM")
                raw.execute("PRAGMA journal_mode = WAL")
            except sqlite3.DatabaseError as error:
                raise OSError(
                    f"{self._told_as}: deleted, but the file could not be written anew: {error}"
                ) from error

    def _unchanged(self) -> contextlib.AbstractContextManager[None]:
        """Return a context that raises OSError if a file changes that is read without a lock."""
        if _is_read_only(self.place):
            return unchanged(self.place, self._told_as)
        return contextlib.nullcontext()

    def _connect(self) -> sqlite3.Connection:
        return connect(self.place, _mode_of(self.place), timeout=_BUSY_S)

    def _cannot_be_written(self) -> OSError:
        return OSError(
            f"{self._told_as}: the diary can only be read, because it or its folder cannot be "
            "written: copy it into a folder that can be written"
        )

    def refuse_if_read_only(self) -> None:
        """Raise OSError if the file or its folder cannot be written."""
        if _is_read_only(self.place):
            raise self._cannot_be_written()

    def _refuse_to_migrate_what_is_read_only(self) -> None:
        if _is_read_only(self.place):
            raise OSError(
                f"{self._told_as}: an earlier manip3d wrote the diary, which must be changed to be "
                "read, and it or its folder cannot be written: copy it into a folder that can be "
                "written"
            )

    def _rows(self, connection: sql.Connection) -> DiaryTransaction:
        return DiaryTransaction(connection, self.path, self.key, self.chain_key)

    def _check_file(self, create: bool) -> None:
        """Refuse files that are no diary or of a later version; make a new file if allowed."""
        is_new = create and _make_empty(self.path)
        expect_regular_file(self.path)
        try:
            with contextlib.closing(self._connect()) as plain:
                mark, version = (
                    int(plain.execute(f"PRAGMA {name}").fetchone()[0])
                    for name in ("application_id", "user_version")
                )
                holds = int(plain.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])
                if mark == schema.APPLICATION:
                    self._check_pages(plain)
        except sqlite3.DatabaseError as error:
            raise _told(error, self.path) from error
        except UnicodeDecodeError as error:  # SQLite's message has a name that is not UTF-8
            raise FormatError(
                f"the diary is damaged: {error}; 'manip3d diary rescue' copies what can be read",
                file=str(self.path),
            ) from error
        if holds == 0 and mark == 0:
            if is_new:
                return
            # It may stand in the place of a diary that was moved, so that no new one is made here.
            raise empty_file_error(self.path)
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
        """Migrate the file from a version to the current one; 0: it is new."""
        audit = self._old_audit(connection) if 0 < version < schema.WITH_CHAIN else []
        schema.migrate(connection, version)
        marks = {}
        if version == 0:  # encrypted, so that a key can be checked when the diary is opened
            marks["check"] = seal(self.key, CHECK, "meta")
        if version < schema.WITH_STUDY:
            marks["study"] = seal(self.key, str(uuid.uuid4()).encode(), _STUDY)
        if version < schema.WITH_CHAIN:
            chain_key = new_key()
            marks["audit key"] = seal(self.key, chain_key, _CHAIN)
        for name, value in marks.items():
            connection.execute(sql.insert(schema.META).values(name=name, value=value))
        if version < schema.WITH_CHAIN:
            begin_chain(connection, chain_key)
            for at, action, number in audit:
                append_row(connection, chain_key, action, number, at=at)

    def _old_audit(self, connection: sql.Connection) -> list[tuple[str, str, int | None]]:
        """Time, action and participant of each row of an audit without hashes, by time.

        Rows with an invalid time come first and are kept unchanged, so that the diary can be opened
        and `audit` reports them.
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
        name = unseal(self.key, self._meta(connection, "study"), _STUDY)
        try:
            return str(uuid.UUID(name.decode("ascii")))
        except ValueError:
            raise FormatError("expected a UUID of the study; the diary is damaged",
                              file=str(self.path)) from None  # fmt: skip

    def _check_key(self, connection: sql.Connection) -> None:
        value = self._meta(connection, "check")
        if not check_key(value, self.key, self.path):
            raise InputError(f"key: {self.path} is encrypted; its key file is needed")

    def _on_connect(
        self, connection: sqlite3.Connection, record: sql.pool.ConnectionPoolEntry
    ) -> None:
        # SQLAlchemy begins transactions explicitly, because sqlite3 begins none for changes of
        # tables.
        connection.isolation_level = None
        is_read_only = _is_read_only(self.place)
        record.info["begin"] = "BEGIN" if is_read_only else "BEGIN IMMEDIATE"
        if is_read_only:
            return
        try:
            for pragma in (
                "journal_mode = WAL",
                "synchronous = FULL",  # acknowledged data are on the disk
                "foreign_keys = ON",
                "secure_delete = ON",  # deleted or moved data are overwritten with zeros
                "temp_store = MEMORY",
            ):
                connection.execute(f"PRAGMA {pragma}")
        except sqlite3.DatabaseError as error:
            raise self._told(error) from error

    def _on_error(self, context: sql.ExceptionContext) -> None:
        if isinstance(context.original_exception, sqlite3.DatabaseError):
            raise self._told(context.original_exception) from context.original_exception

    def _told(self, error: sqlite3.DatabaseError) -> Exception:
        """Return an OSError for a full disk, a lock or a missing file, or else a FormatError."""
        if not self.place.exists():
            return OSError(f"the diary is no longer at {self._told_as}; put it back")
        # Python's own error about text that is not UTF-8 has no code of SQLite: it is damage.
        is_of_sqlite = hasattr(error, "sqlite_errorcode")
        if is_of_sqlite and error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_READONLY:
            return self._cannot_be_written()
        if is_of_sqlite and isinstance(error, sqlite3.OperationalError):
            return OSError(f"{self._told_as}: {_advised(error, self.place)}")
        return FormatError(f"the diary is damaged: {error}", file=str(self._told_as))


def expect_regular_file(path: Path) -> None:
    """Raise FormatError if there is no file but a folder or device, or FileNotFoundError."""
    if path.is_file():
        return
    if path.exists():
        raise FormatError("expected a regular file", file=str(path))
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))


def empty_file_error(path: Path) -> FormatError:
    """Return the error about an empty file in the place of a diary."""
    return FormatError(
        "expected a diary, got an empty file: put the diary back in its place, or delete the file "
        "to begin a new diary",
        file=str(path),
    )


def connect(path: Path, mode: str = "rw", **options: Any) -> sqlite3.Connection:
    """Connect to an existing file; by default SQLite would make an empty one if it is missing.

    The address is that of an absolute path, because `:memory:` is an in-memory database.
    """
    address = f"file:{quote(os.fsencode(os.path.abspath(path)))}?mode={mode}"
    connection: sqlite3.Connection = sqlite3.connect(address, uri=True, **options)
    return connection


def _is_read_only(path: Path) -> bool:
    """Whether SQLite cannot write an existing file, for which it makes others beside it."""
    return os.path.exists(path) and not (os.access(path, os.W_OK) and _has_writable_folder(path))


def _has_writable_folder(path: Path) -> bool:
    return os.access(os.path.dirname(os.path.realpath(path)), os.W_OK)


def _logs(path: Path) -> list[str]:
    """Names of the files with the last entries of a diary that is open or was not closed."""
    beside = (f"{os.path.realpath(path)}{ending}" for ending in ("-wal", "-journal"))
    return [os.path.basename(log) for log in beside if is_filled(log)]


def is_filled(path: str | Path) -> bool:
    """Whether a file exists and is not empty, as a log is after a full disk had no room for it."""
    try:
        return os.path.getsize(path) > 0
    except FileNotFoundError:  # a program that closes the diary removes its log
        return False


def _mode_of(path: Path) -> str:
    """Return the mode in which SQLite can open a file.

    To read a file with a write-ahead log, SQLite makes files beside it. A file that cannot be
    written it reads as if nothing could change it, which is only right without a log. The files
    would have the mode of the diary, and be left behind where the folder can be written, so that
    the diary could not be written either once it may be.
    """
    if not _is_read_only(path):
        return "rw"
    return "ro" if _logs(path) else _FIXED


@contextlib.contextmanager
def unchanged(path: Path, told_as: Path) -> Iterator[None]:
    """Raise OSError if another program changes a file that is read without a lock.

    Pages from before and after a change do not fit together, and make a healthy diary look damaged:
    the error is raised instead of any other.
    """
    before = _stamp(path)
    try:
        yield
    except Exception as error:
        if path.exists() and _stamp(path) != before:
            raise _written_meanwhile(told_as) from error
        raise
    if _stamp(path) != before:
        raise _written_meanwhile(told_as)


def _stamp(path: Path) -> tuple[int, int, int]:
    """Return what changes when a file is replaced or written."""
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns


def _written_meanwhile(path: Path) -> OSError:
    return OSError(errno.EBUSY, "another program wrote to the diary meanwhile", str(path))


def _make_empty(path: Path) -> bool:
    """Make an empty file; return False if there is a file already."""
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    except FileExistsError:
        return False
    return True


def _make(path: Path, key: bytes | None) -> None:
    """Make a diary completely or not at all; do nothing if another program made it first."""
    with folder_beside(path, path) as folder:
        made = folder / path.name
        DiaryFile(made, key, create=True, told_as=path).close()
        try:
            with contextlib.closing(sqlite3.connect(made)) as plain:
                # close() does not report a full disk; the content is then in the write-ahead log.
                plain.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        except sqlite3.DatabaseError as error:
            raise OSError(f"{path}: {error}") from error
        try:
            os.link(made, path)
            sync_folder(path.parent)
        except OSError as error:
            if error.errno not in (errno.EEXIST, *_WITHOUT_LINKS):
                raise


def _on_begin(connection: sql.Connection) -> None:
    connection.exec_driver_sql(connection.info["begin"])


def words_of(error: sqlite3.DatabaseError, path: Path) -> str:
    """Return SQLite's message, and why even reading is impossible, if that is known."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    is_refused = code in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY)
    if is_refused and (logs := _logs(path)) and not _has_writable_folder(path):
        return (
            f"{error}: {logs[0]} holds the last entries, and the folder cannot be written: copy "
            "both files into a folder that can be written"
        )
    if code == sqlite3.SQLITE_IOERR:
        with contextlib.suppress(OSError):
            disk = os.statvfs(path.parent)
            if disk.f_bavail * disk.f_frsize < _MIN_BYTES:
                return f"{error}: the disk is full, and a diary needs some room even to be read"
    return str(error)


def _advised(error: sqlite3.DatabaseError, path: Path) -> str:
    """Return `words_of`, and a way out if there is no room even to read."""
    words, code = words_of(error, path), getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code == sqlite3.SQLITE_IOERR and words != str(error):
        return f"{words}; 'manip3d diary rescue' copies it to another disk"
    return words


def _told(error: sqlite3.DatabaseError, path: Path) -> Exception:
    """Turn errors of SQLite while a file is opened into errors about the file or the disk."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code == sqlite3.SQLITE_NOTADB:
        return FormatError(f"expected a diary: {error}", file=str(path))
    if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_ERROR):
        return FormatError(
            f"the diary is damaged: {error}; 'manip3d diary rescue' copies what can be read",
            file=str(path),
        )
    return OSError(
        errno.EIO, _advised(error, path), str(path)
    )  # a full disk, a lock, a folder to read only
