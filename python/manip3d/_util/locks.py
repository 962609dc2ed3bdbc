"""Locks of files, which the operating system frees when the program that holds them is killed."""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def locked_file(path: Path) -> int | None:
    """Lock a file, which is made if it is absent and which only its owner may open.

    Returns
    -------
    int or None
        Descriptor of the open file, which is locked until it is closed; None where another program,
        or another descriptor of this one, has locked it.

    Raises
    ------
    OSError
        It cannot be made or opened, or is a symbolic link.
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
    """Make a folder if it is absent, and lock it; it is removed again if nothing was put into it.

    Yields
    ------
    bool
        False: another program, or another thread of this one, has locked it. True also on file
        systems without locks, such as those of networks.

    Raises
    ------
    OSError
        It cannot be made or opened.
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
                path.rmdir()  # if it is empty
        os.close(lock)
