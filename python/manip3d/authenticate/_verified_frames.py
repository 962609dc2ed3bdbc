"""The state file of a verifier: a checkpoint, and a journal of the frames after it."""

from __future__ import annotations

import os
import struct
import weakref
from pathlib import Path

from manip3d import _core
from manip3d._util.locks import locked_file
from manip3d.errors import Error, FormatError, InputError
from manip3d.io._files import atomic_write, open_regular

CHECKPOINT_FRAMES = 600
"""Number of frames after which the journal is replaced by a new checkpoint, as also on close."""

_MAGIC = b"m3d-vj01"
_HEADER = struct.Struct("<8sI")  # magic number, length of the checkpoint
_HEAD, _TAG = 82, 32  # bytes of a state before and after its list of past sessions
_EARLY_HEAD = 66  # the same in the first two versions, whose states state no times
_EARLY = (b"m3d-vs01", b"m3d-vs02")
_ENTRY = _HEAD + _TAG
_MAX_SESSIONS = 4096  # largest number of sessions that a verifier remembers
_MAX_BYTES = _HEADER.size + _ENTRY + 24 * _MAX_SESSIONS + CHECKPOINT_FRAMES * _ENTRY


class VerifiedFrames:
    """Keeps the state of a verifier in a file, for one verifier at a time.

    The file has a checkpoint and, for each frame after it, the session, the number and the tag of
    the chain, authenticated together with the sessions of the checkpoint. A killed process loses no
    entries. A power failure may lose those after the last checkpoint, because entries are not
    synced individually. Anyone who can write the file can replace it by an older one.

    Parameters
    ----------
    path : Path
        Path of the file, which is created if needed.
    verifier : WatermarkVerifier
        Verifier whose state is restored from the file.

    Raises
    ------
    InputError
        Another verifier is using the file.
    FormatError
        The file is damaged, or belongs to another key.
    OSError
        The file cannot be read, or its lock file cannot be created.
    """

    def __init__(self, path: Path, verifier: _core.WatermarkVerifier) -> None:
        self._path = Path(os.path.realpath(path))
        self._verifier = verifier
        self._owner = os.getpid()
        self._stored = b""  # the state that the file ends with
        self._num_entries = 0
        self._journal: int | None = None
        self._close_journal: weakref.finalize[[int], VerifiedFrames] | None = None
        self._unlock = weakref.finalize(self, os.close, self._locked(path))
        try:
            if self._path.exists():
                self._restore(path)
        except BaseException:
            self._unlock()
            raise

    def _locked(self, path: Path) -> int:
        name = self._path.with_name(f".{self._path.name}.lock")
        try:
            lock = locked_file(name)
        except FileNotFoundError as error:  # of the folder; name the state file
            raise FileNotFoundError(error.errno, error.strerror, os.fspath(path)) from None
        if lock is None:
            raise InputError(f"state: expected a file of one verifier at a time, {path} is in use")
        return lock

    def _restore(self, path: Path) -> None:
        with open_regular(self._path) as file:
            content = file.read(_MAX_BYTES + 1)
        try:
            self._verifier.restore(_last_state(content))
        except FormatError as error:
            raise FormatError(error.reason, file=str(path)) from error

    def add(self, before: bytes) -> None:
        """Append the frame that was just verified, if it changed the state of the verifier.

        Parameters
        ----------
        before : bytes
            State of the verifier before that frame. The verifier returns to it if the entry cannot
            be written: nobody gets a verdict then, and a second attempt must be no replay.

        Raises
        ------
        OSError
            The entry cannot be written.
        Error
            The caller is a child of the process that opened the file.
        """
        try:
            self._append_state()
        except BaseException:
            self._verifier.restore(before)
            raise

    def _append_state(self) -> None:
        state = self._verifier.state()
        if state == self._stored:
            return
        if self._journal is None or state[_HEAD:-_TAG] != self._stored[_HEAD:-_TAG]:
            self.fold()  # a session has ended
            return
        self._check_owner()
        self._append(self._journal, state[:_HEAD] + state[-_TAG:])
        self._stored = state
        self._num_entries += 1
        if self._num_entries >= CHECKPOINT_FRAMES:
            self.fold()

    def _append(self, journal: int, entry: bytes) -> None:
        try:
            written = os.write(journal, entry)
        except OSError as error:
            self._drop_journal()
            raise OSError(error.errno, error.strerror, os.fspath(self._path)) from error
        if written != len(entry):  # the disk is full: the last entry is incomplete
            self.fold()

    def fold(self) -> None:
        """Replace the file by a checkpoint of the current state.

        Raises
        ------
        OSError
            The file cannot be written; it remains unchanged.
        Error
            The caller is a child of the process that opened the file.
        """
        self._check_owner()
        self._drop_journal()
        state = self._verifier.state()
        atomic_write(self._path, _HEADER.pack(_MAGIC, len(state)) + state)
        journal = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
        self._journal = journal
        self._close_journal = weakref.finalize(self, os.close, journal)
        self._stored, self._num_entries = state, 0

    def close(self) -> None:
        """Replace the journal by a checkpoint, and release the file.

        May be called twice.

        Raises
        ------
        OSError, Error
            As `fold`; the file is released nevertheless.
        """
        if not self._unlock.alive:
            return
        try:
            if self._num_entries:
                self.fold()
        finally:
            self._drop_journal()
            self._unlock()

    def _drop_journal(self) -> None:
        self._journal = None
        if self._close_journal is not None:
            self._close_journal()

    def _check_owner(self) -> None:
        if os.getpid() != self._owner:
            raise Error("the state file belongs to the process that opened it, not to its child")


def _last_state(content: bytes) -> bytes:
    """The last state in the content of a file.

    An incomplete last entry is ignored, because no verdict was returned for its frame. Files
    without a header are checkpoints without a journal, as early versions wrote them.
    """
    if len(content) > _MAX_BYTES:
        raise FormatError("the file is larger than the state of a verifier can be")
    if not content.startswith(_MAGIC) or len(content) < _HEADER.size:
        return content
    _, length = _HEADER.unpack_from(content)
    checkpoint = content[_HEADER.size : _HEADER.size + length]
    head = _EARLY_HEAD if checkpoint.startswith(_EARLY) else _HEAD
    size = head + _TAG
    num_entries = (len(content) - _HEADER.size - length) // size
    if length < size or num_entries < 0:
        raise FormatError("the state of a verifier is damaged: it ends within its checkpoint")
    if num_entries == 0:
        return checkpoint
    begin = _HEADER.size + length + (num_entries - 1) * size
    entry = content[begin : begin + size]
    return entry[:head] + checkpoint[head:-_TAG] + entry[head:]
