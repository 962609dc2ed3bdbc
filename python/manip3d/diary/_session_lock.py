"""A lock against two live sessions of one participant, and against deletion during a session."""

from __future__ import annotations

import contextlib
import os
import weakref
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.locks import locked_file
from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d.diary._diary import Diary


class SessionLock:
    """A lock on a participant; the operating system frees it if the program is killed.

    Each session compares the pain only with its own ratings, so that with two sessions the stop
    rule would miss a rise from one to the other. Different participants of a diary can have
    sessions at the same time. A session keeps the diary open only while it writes, so that only
    this lock shows that one is going on.

    On a file system without locks no session can begin, so that a deletion needs no lock there.

    Raises
    ------
    InputError
        Another session of this participant is open, or they are being deleted.
    OSError
        The diary cannot be written, or the lock's file cannot be created or opened.
    """

    def __init__(
        self, diary: Diary, participant: str, number: int, *, for_deletion: bool = False
    ) -> None:
        file = diary._file
        file.refuse_if_read_only()
        real = Path(os.path.realpath(file.place))
        # The name contains no pseudonym, which would remain after the participant is deleted.
        self._path = real.with_name(f".{real.name}.{number}.lock")
        while True:
            lock = self._locked(needs_locks=not for_deletion)
            if lock is None:
                raise InputError(
                    f"participant: {participant} has a session open in another program, or is "
                    "being deleted there; end that first"
                )
            if self._is_ours(lock):
                break
            os.close(lock)  # the session that held the lock has removed the file in the meantime
        self._close = weakref.finalize(self, os.close, lock)
        # Whoever can write the diary can lock it, also if this program is killed.
        with contextlib.suppress(PermissionError):  # the file is another user's
            os.fchmod(lock, real.stat().st_mode & 0o666)

    def _locked(self, *, needs_locks: bool) -> int | None:
        try:
            return locked_file(self._path, needs_locks=needs_locks)
        except PermissionError as error:
            raise PermissionError(
                error.errno,
                "a session of another user left this file, which you may not open: delete it if "
                "that session is over",
                str(self._path),
            ) from error

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
