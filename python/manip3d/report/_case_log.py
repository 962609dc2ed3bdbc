"""Log of inspections with a hash chain, which reveals changed, removed and inserted lines."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import stat
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d import __version__
from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.durable import sync_folder
from manip3d._util.json import finite
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io._files import open_regular

if TYPE_CHECKING:
    from manip3d.authenticate import DriveInspection, Inspection, StreamInspection

LOG_SUFFIX = ".jsonl"

_FIRST = "0" * 64
"""Value of ``previous`` in the first line."""

_START = b'{"time": '
"""First bytes of every line."""


@dataclass(frozen=True)
class _End:
    """The last line of a log that this process has checked.

    Attributes
    ----------
    size : int
        Bytes up to the end of the line.
    lines : int
        Number of lines up to and including it.
    hash : str
        Hash of the line.
    last : bytes
        The line with its newline, by which a log that grew is distinguished from one that was
        changed.
    """

    size: int = 0
    lines: int = 0
    hash: str = _FIRST
    last: bytes = b""


_checked_logs: dict[tuple[int, int], _End] = {}
"""Checked ends of logs by (device, inode), so that repeated appends do not read the whole log."""


@checked
def append_log(
    path: str | os.PathLike[str],
    inspection: Inspection | StreamInspection | DriveInspection,
    *,
    source: str,
    source_sha256: str = "",
) -> str:
    """Append an inspection to a log in which each line holds the hash of the line before.

    Parameters
    ----------
    path : path
        A ``.jsonl`` file; it is created if it does not exist.
    inspection : Inspection, StreamInspection or DriveInspection
        The result of `manip3d.authenticate.inspect`, `inspect_stream` or `judge_drive`.
    source : str
        Name of the scan.
    source_sha256 : str
        Hexadecimal SHA-256 of its file; for a folder, `manip3d.datasets.folder_sha256`.

    Returns
    -------
    str
        Hash of the new line, 64 hexadecimal digits. Whoever keeps it in another place can prove
        later that the log up to this line is unchanged.

    Raises
    ------
    FormatError
        The log is damaged, or is not a regular file.
    OSError
        The file cannot be written; the log stays unchanged.

    Notes
    -----
    Several processes may append to one log: each locks the file (``flock``) while it reads the end
    and writes its line. A process checks the whole log before its first line, and later only lines
    that were appended in the meantime; `read_log` always checks the whole log.

    A writer that was killed can leave an incomplete line at the end. The next append moves its
    bytes to a file ``LOG.torn-1`` beside the log, records their hash in the new line, and warns.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, report
    >>> found = authenticate.inspect(np.zeros((0, 3), np.float32))
    >>> first = report.append_log("cases.jsonl", found, source="scan.bin")
    >>> second = report.append_log("cases.jsonl", found, source="other.bin")
    >>> first == second, report.read_log("cases.jsonl")[1]["previous"] == first
    (False, True)
    """
    return _append_entry(path, source, source_sha256, inspection.record())


def append_error(
    path: str | os.PathLike[str], error: str, *, source: str, source_sha256: str = ""
) -> str:
    """Append the error of a source that cannot be read, as `append_log` appends an inspection.

    Raises
    ------
    FormatError, OSError
        As `append_log`.
    """
    return _append_entry(path, source, source_sha256, {"error": error})


def _append_entry(
    path: str | os.PathLike[str], source: str, source_sha256: str, content: Mapping[str, Any]
) -> str:
    """Append an entry to a log and return its hash, which includes that of the entry before.

    An incomplete last line is kept in a file of its own; no other line is changed.
    """
    target = path_of(path)
    with _locked(target) as descriptor:
        end, torn = _checked_end(descriptor, path)
        aside = _keep_aside(target, torn) if torn else None
        mark = {} if aside is None else {"torn_line": _mark_of(torn, aside)}
        entry = {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "manip3d": __version__,
            "source": source,
            "source_sha256": source_sha256,
            **finite(content),
            **mark,
            "previous": end.hash,
        }
        entry["hash"] = _hash(entry)
        line = _line(entry)
        missing = b"" if end.last.endswith(b"\n") or not end.size else b"\n"
        try:
            _append(descriptor, missing + line, end.size, torn)
        except BaseException:
            is_as_it_was = os.fstat(descriptor).st_size == end.size + len(torn)
            if aside is not None and is_as_it_was:
                aside.unlink()
            raise
        size = end.size + len(missing) + len(line)
        _checked_logs[_identity(descriptor)] = _End(size, end.lines + 1, str(entry["hash"]), line)
    if aside is not None:
        warnings.warn(
            f"{target}: line {end.lines + 1} was not whole: its writer was interrupted after "
            f"{len(torn)} bytes, which are kept in {aside}. The entries before it hold, and the "
            "log is continued after them",
            stacklevel=caller_level(),
        )
    return str(entry["hash"])


def check_log(path: str | os.PathLike[str]) -> None:
    """Refuse a log to which `append_log` cannot append, before the inspection is done.

    Raises
    ------
    InputError
        The name does not end in ``.jsonl``, or its folder does not exist.
    FormatError
        The file is no log, or is damaged. An incomplete last line is no damage, see `append_log`.
    OSError
        The file cannot be read.
    """
    target = path_of(path)
    if target.suffix.lower() != LOG_SUFFIX:
        raise InputError(f"{target}: expected the name of a log that ends in {LOG_SUFFIX}")
    if not target.parent.is_dir():
        raise InputError(f"{target}: there is no folder {target.parent}")
    if target.exists():
        with open_regular(target) as file:
            fcntl.flock(file, fcntl.LOCK_SH)  # so that no line is incomplete while it is written
            _checked_end(file.fileno(), path)


@checked
def read_log(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Read a log of inspections and check its chain of hashes.

    Parameters
    ----------
    path : path
        A log that `append_log` has written.

    Returns
    -------
    list of dict
        One entry per inspection, the oldest first.

    Raises
    ------
    FormatError
        A line is no entry; a line was changed, removed or inserted; the last line is incomplete.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, report
    >>> found = authenticate.inspect(np.zeros((0, 3), np.float32))
    >>> _ = report.append_log("cases.jsonl", found, source="scan.bin")
    >>> [entry["source"] for entry in report.read_log("cases.jsonl")]
    ['scan.bin']
    """
    return [entry for entry, _ in _entries(_content(path), _End(), path)]


def sources_logged(path: str | os.PathLike[str]) -> set[str]:
    """Return the sources of a log's entries, without that of an incomplete last line.

    Raises
    ------
    FormatError, FileNotFoundError
        As `read_log`, except that an incomplete last line is ignored.
    """
    content = _content(path)
    whole = content[: len(content) - len(_torn_line(content))]
    return {str(entry["source"]) for entry, _ in _entries(whole, _End(), path)}


def _content(path: str | os.PathLike[str]) -> bytes:
    with open_regular(path_of(path)) as file:
        fcntl.flock(file, fcntl.LOCK_SH)  # so that no line is incomplete while it is written
        return file.read()


@contextmanager
def _locked(target: Path) -> Iterator[int]:
    """Open a log for appending, with an exclusive lock."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
    is_new = not target.exists()
    descriptor = os.open(target, flags, 0o666)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise FormatError(
                "expected a regular file, got a pipe, socket or device", file=str(target)
            )
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
        if is_new:
            sync_folder(target.parent)
    finally:
        os.close(descriptor)


def _identity(descriptor: int) -> tuple[int, int]:
    found = os.fstat(descriptor)
    return found.st_dev, found.st_ino


def _checked_end(descriptor: int, path: str | os.PathLike[str]) -> tuple[_End, bytes]:
    """Check a log, and return its end and the incomplete line after it (b"" if there is none).

    Only lines that this process has not checked before are read.
    """
    start = _checked_logs.get(_identity(descriptor), _End())
    length = len(start.last)
    if os.pread(descriptor, length, start.size - length) != start.last:
        start = _End()  # the log was cut or changed: check it from the beginning
    with os.fdopen(os.dup(descriptor), "rb") as file:
        file.seek(start.size)
        content = file.read()
    torn = _torn_line(content)
    content = content[: len(content) - len(torn)]
    end = start
    for entry, line in _entries(content, start, path):
        end = _End(end.size + len(line), end.lines + 1, str(entry["hash"]), line)
    if end.last.endswith(b"\n"):  # otherwise another writer may append the missing newline
        _checked_logs[_identity(descriptor)] = end
    return end, torn


def _torn_line(content: bytes) -> bytes:
    """Return the last line if it is the beginning of an entry; b"" if it is complete or no entry.

    It may end in zero bytes, which stand for blocks that were not written before a power cut.
    """
    line = content[max(content.rfind(b"\n"), content.rfind(b"\r")) + 1 :]
    written = line.rstrip(b"\0")
    if not written.startswith(_START[: len(written)]):
        return b""
    try:
        json.loads(line)
    except (ValueError, RecursionError):
        return line
    return b""  # the entry is complete; only its newline is missing


def _keep_aside(target: Path, torn: bytes) -> Path:
    """Write an incomplete line to a new file beside the log, and return the file's path."""
    for number in count(1):
        aside = target.with_name(f"{target.name}.torn-{number}")
        try:
            descriptor = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            continue
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(torn)
                file.flush()
                os.fsync(file.fileno())
        except BaseException:
            aside.unlink()
            raise
        sync_folder(target.parent)
        return aside
    raise AssertionError


def _mark_of(torn: bytes, aside: Path) -> dict[str, Any]:
    """Return the entry of a log about an incomplete line that was moved to another file."""
    return {"bytes": len(torn), "sha256": hashlib.sha256(torn).hexdigest(), "kept": aside.name}


def _entries(
    content: bytes, start: _End, path: str | os.PathLike[str]
) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Yield each entry with its line in the file, after checking both and the hash chain."""
    before = start.hash
    for number, line in enumerate(content.splitlines(keepends=True), start.lines + 1):
        try:
            entry = json.loads(line)
            kept = entry["hash"]
            # json.loads reads only one of two equal names, so that the bytes are compared as well.
            same = _line(entry).rstrip() == line.rstrip(b"\r\n")
            linked = same and entry["previous"] == before and _hash(entry) == kept
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise FormatError(
                _torn(number, len(line))
                if _torn_line(line)
                else f"line {number}: not an entry of a log: {error}",
                file=os.fspath(path),
            ) from error
        if not linked:
            raise FormatError(
                f"line {number}: the chain of hashes is broken: this line or the one before "
                "it was changed, removed or inserted",
                file=os.fspath(path),
            )
        yield entry, line
        before = str(kept)


def _torn(number: int, length: int) -> str:
    """Return the message about an incomplete line, and how to continue the log."""
    return (
        f"line {number}: the last line is not whole: its writer was interrupted after {length} "
        "bytes. The entries before it hold; the next inspection that is appended keeps these bytes "
        "in a file beside the log, and continues it"
    )


def _append(descriptor: int, content: bytes, size: int, torn: bytes) -> None:
    """Replace an incomplete line by the content and sync it, or leave the file unchanged."""
    try:
        if torn:
            os.ftruncate(descriptor, size)
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)
    except BaseException:
        os.ftruncate(descriptor, size)
        if torn:
            os.write(descriptor, torn)
        raise


def _line(entry: dict[str, Any]) -> bytes:
    return json.dumps(entry).encode() + b"\n"


def _hash(entry: dict[str, Any]) -> str:
    content = {name: value for name, value in entry.items() if name != "hash"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
