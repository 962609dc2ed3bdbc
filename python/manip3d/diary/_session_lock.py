"""A lock against two live sessions of one participant, and against deletion during a session."""

from __future__ import annotations

import contextlib
import os
import weakref
from pathlib import Path

from manip3d._util.locks import locked_file
from manip3d.errors import InputError


class SessionLock:
    """A lock on a participant; the operating system frees it if the program is killed.

    Each session compares the pain only with its own ratings, so that with two sessions the stop
    rule would miss a rise from one to the other. Different participants of a diary can have
    sessions at the same time. A session keeps the diary open only while it writes, so that only
    this lock shows that one is going on.

    Raises
    ------
    InputError
        Another session of this participant is open.
    OSError
        The lock's file cannot be created.
    """

    def __init__(self, diary: Path, participant: str, number: int) -> None:
        real = Path(os.path.realpath(diary))
        # The name contains no pseudonym, which would remain after the participant is deleted.
        self._path = real.with_name(f".{real.name}.{number}.lock")
        while True:
            lock = locked_file(self._path)
            if lock is None:
                raise InputError(
                    f"participant: {participant} has a session open in another program; end that "
                    "one first"
                )
            if self._is_ours(lock):
                break
            os.close(lock)  # the session that held the lock has removed the file in the meantime
        self._close = weakref.finalize(self, os.close, lock)

    def _is_ours(self, lock: int) -> bool:
        with contextlib.suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(lock), self._path.stat())
        return False

    def release(self) -> None:
        """Let another session begin; may be called twice."""
        if self._close.alive:
            with contextlib.suppress(OSError):  # a file that remains locks nothing
                self._path.unlink()
            self._close()
