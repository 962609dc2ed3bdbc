"""File locks, which the operating system releases if the process that holds them is killed."""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def locked_file(path: Path) -> int | None:
    """Lock a file; a missing one is created, with access for its owner only.

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
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        return None
    except BaseException:
        os.close(lock)
        raise
    return lock


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
    path.mkdir(exist_ok=True)
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    is_ours = True
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            is_ours = False
        except OSError:  # this file system has no locks
            pass
        yield is_ours
    finally:
        if is_ours:
            with suppress(OSError):
                path.rmdir()  # fails if the folder is not empty
        os.close(lock)
