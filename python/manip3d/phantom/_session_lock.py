"""A lock against two live sessions of one participant at a time."""

from __future__ import annotations

import contextlib
import os
import weakref
from pathlib import Path

from manip3d._util.locks import locked_file
from manip3d.errors import InputError


class SessionLock:
    """A lock on a participant; the operating system frees it when the program is killed.

    Two sessions would compare the pain with ratings of their own only, and the stop rule would miss
    a rise from one to the other. Participants of one diary play beside each other.

    Raises
    ------
    InputError
        Another session of this participant is open.
    OSError
        The lock's file cannot be made.
    """

    def __init__(self, diary: Path, participant: str, number: int) -> None:
        real = Path(os.path.realpath(diary))
        # Not the pseudonym: it would remain when the participant is deleted.
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
