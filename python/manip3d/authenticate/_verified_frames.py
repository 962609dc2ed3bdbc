"""The file that keeps what a verifier has seen: a checkpoint, and a journal of the frames since."""

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
"""The journal is folded into a new checkpoint after so many frames, and at the end."""

_MAGIC = b"m3d-vj01"
_HEADER = struct.Struct("<8sI")  # the magic, and the checkpoint's length
_HEAD, _TAG = 66, 32  # bytes of a verifier's state before the past sessions, and after them
_ENTRY = _HEAD + _TAG
_MOST_SESSIONS = 4096  # that a verifier remembers
_MOST_BYTES = _HEADER.size + _ENTRY + 16 * _MOST_SESSIONS + CHECKPOINT_FRAMES * _ENTRY


class VerifiedFrames:
    """Keeps the state of a verifier in a file, for one verifier at a time.

    The file holds a checkpoint and, for each frame since, the session, the number and the tag of
    the chain, authenticated together with the sessions of the checkpoint. A killed process loses
    nothing; entries are not synced one by one, so that a loss of power may lose those since the
    last checkpoint. Who can write the file can put an older one in its place.

    Parameters
    ----------
    path : Path
    verifier : WatermarkVerifier
        It goes on where the file ends.

    Raises
    ------
    InputError
        Another verifier is using the file.
    FormatError
        It is damaged, or of another key.
    OSError
        It cannot be read, or the lock beside it cannot be made.
    """

    def __init__(self, path: Path, verifier: _core.WatermarkVerifier) -> None:
        self._path = Path(os.path.realpath(path))
        self._verifier = verifier
        self._owner = os.getpid()
        self._stored = b""  # the state that the file ends with
        self._num_entries = 0
        self._unsaved = False  # the last frame could not be written
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
        except FileNotFoundError as error:  # the folder: the lock's own name tells nobody anything
            raise FileNotFoundError(error.errno, error.strerror, os.fspath(path)) from None
        if lock is None:
            raise InputError(f"state: expected a file of one verifier at a time, {path} is in use")
        return lock

    def _restore(self, path: Path) -> None:
        with open_regular(self._path) as file:
            content = file.read(_MOST_BYTES + 1)
        try:
            self._verifier.restore(_last_state(content))
        except FormatError as error:
            raise FormatError(error.reason, file=str(path)) from error

    def add(self) -> None:
        """Write down the frame that was just verified, if the chain went on with it.

        Raises
        ------
        OSError
            It cannot be written; the next frame writes it, too.
        Error
            This is a child of the process that opened the file.
        """
        state = self._verifier.state()
        if state == self._stored:
            return
        self._unsaved = True
        if self._journal is None or state[_HEAD:-_TAG] != self._stored[_HEAD:-_TAG]:
            self.fold()  # a session has ended
            return
        self._check_owner()
        self._append(self._journal, state[:_HEAD] + state[-_TAG:])
        self._stored = state
        self._num_entries += 1
        self._unsaved = False
        if self._num_entries >= CHECKPOINT_FRAMES:
            self.fold()

    def _append(self, journal: int, entry: bytes) -> None:
        try:
            written = os.write(journal, entry)
        except OSError as error:
            self._drop_journal()
            raise OSError(error.errno, error.strerror, os.fspath(self._path)) from error
        if written != len(entry):  # the disk is full, and the file ends within an entry
            self.fold()

    def fold(self) -> None:
        """Replace the file by a checkpoint of now.

        Raises
        ------
        OSError
            It cannot be written; the file stays as it was.
        Error
            This is a child of the process that opened the file.
        """
        self._check_owner()
        self._drop_journal()
        state = self._verifier.state()
        atomic_write(self._path, _HEADER.pack(_MAGIC, len(state)) + state)
        journal = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
        self._journal = journal
        self._close_journal = weakref.finalize(self, os.close, journal)
        self._stored, self._num_entries, self._unsaved = state, 0, False

    def close(self) -> None:
        """Fold the journal, write what could not be, and let others use the file.

        May be called twice.

        Raises
        ------
        OSError, Error
            As `fold`; others may use the file all the same.
        """
        if not self._unlock.alive:
            return
        try:
            if self._num_entries or self._unsaved:
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
    """The state that a file ends with.

    The last entry may be torn: its frame was never answered. Files without a header are
    checkpoints of before there was a journal.
    """
    if len(content) > _MOST_BYTES:
        raise FormatError("the file is larger than the state of a verifier can be")
    if not content.startswith(_MAGIC) or len(content) < _HEADER.size:
        return content
    _, length = _HEADER.unpack_from(content)
    checkpoint = content[_HEADER.size : _HEADER.size + length]
    num_entries = (len(content) - _HEADER.size - length) // _ENTRY
    if length < _ENTRY or num_entries < 0:
        raise FormatError("the state of a verifier is damaged: it ends within its checkpoint")
    if num_entries == 0:
        return checkpoint
    begin = _HEADER.size + length + (num_entries - 1) * _ENTRY
    entry = content[begin : begin + _ENTRY]
    return entry[:_HEAD] + checkpoint[_HEAD:-_TAG] + entry[_HEAD:]
