"""Files that appear whole or not at all: temporary name, sync, rename, sync of the folder."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot sync a folder
            raise
    finally:
        os.close(descriptor)


def _mode(target: Path) -> int:
    """The mode of the file that is replaced, else what ``open`` would give a new one."""
    try:
        return stat.S_IMODE(target.stat().st_mode)
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary name beside ``path`` that becomes ``path`` when the block ends.

    The temporary name has the suffix of ``path``. When the block raises, it is removed and
    ``path`` stays as it was.

    Raises
    ------
    OSError
        The folder is missing, the disk is full, and the like; ``filename`` is ``path``.
    """
    target = Path(os.path.realpath(path))
    try:
        descriptor, name = tempfile.mkstemp(
            prefix=".manip3d-", suffix=target.suffix, dir=target.parent
        )
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
    os.close(descriptor)
    temporary = Path(name)
    try:
        yield temporary
        with contextlib.suppress(PermissionError):  # a file system without modes
            temporary.chmod(_mode(target))
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
        _sync_folder(target.parent)
    except OSError as error:
        if error.filename in (name, None) and error.errno is not None:
            raise OSError(error.errno, error.strerror, os.fspath(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def atomic_write(path: str | os.PathLike[str], data: bytes | str) -> None:
    """Write ``data`` (text as UTF-8) to ``path``, whole or not at all.

    A target that is no regular file (a pipe, ``/dev/stdout``) is written in place.

    Raises
    ------
    OSError
        As `atomic_path`.
    """
    content = data.encode() if isinstance(data, str) else data
    target = Path(path)
    if target.exists() and not target.is_file():
        target.write_bytes(content)
        return
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)
