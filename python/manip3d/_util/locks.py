"""File locks, which the operating system releases if the process that holds them is killed."""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def locked_file(path: Path, *, needs_locks: bool = True) -> int | None:
    """Lock a file; a missing one is created, with access for its owner only.

    Parameters
    ----------
    path : Path
    needs_locks : bool
        Raise OSError on file systems without locks, such as some network file systems, and leave no
        file there. Otherwise the file is returned without a lock.

    Returns
    -------
    int or None
        Descriptor of the open file, which is locked until the descriptor is closed; None if another
        process, or another descriptor of this process, has locked the file.

    Raises
    ------
    OSError
        The file cannot be created or opened, or is a symbolic link.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW
    lock = os.open(path, flags, 0o600)
    try:
        if _is_free(lock):
            return lock
    except OSError as error:
        if not needs_locks:
            return lock
        os.close(lock)
        with suppress(OSError):
            path.unlink()
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
    os.close(lock)
    return None


@contextmanager
def new_folder_locked(path: Path) -> Iterator[bool]:
    """Create a folder if it does not exist, and lock it; at the end it is removed if it is empty.

    Yields
    ------
    bool
        False if another process, or another thread of this process, has locked the folder. True
        also on file systems without locks, such as some network file systems.

    Raises
    ------
    OSError
        The folder cannot be created or opened.
    """
    lock, is_ours = _new_folder(path)
    try:
        yield is_ours
    finally:
        if is_ours:
            with suppress(OSError):
                path.rmdir()  # fails if the folder is not empty
        os.close(lock)


def _new_folder(path: Path) -> tuple[int, bool]:
    """Return the descriptor of a folder, and whether it is locked by this call.

    Another holder of the lock may remove the folder between any two steps: the steps are repeated
    until the folder that is locked is the one at the path.
    """
    while True:
        with suppress(FileExistsError):
            path.mkdir()
        try:
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except FileNotFoundError:
            if path.is_symlink():  # it leads nowhere
                raise
            continue
        try:
            is_ours = _is_free(lock)
        except OSError:  # this file system has no locks
            return lock, True
        if not is_ours or _leads_to(path, lock):
            return lock, is_ours
        os.close(lock)


def _leads_to(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _is_free(descriptor: int) -> bool:
    """Lock an open file if nobody else has."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
