"""Keys of the watermark: key files, and the ring of all keys that a sensor has had."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.closing import Closing
from manip3d._util.paths import path_of, visible
from manip3d.errors import InputError


@checked
class KeyFile(Closing):
    """The key of a sensor, read from its file; Python never holds its bytes.

    Parameters
    ----------
    path : path
        A file of `KeyFile.create`.

    Attributes
    ----------
    key_id : str
        Hexadecimal identifier of the key; it is not a secret.
    created_ns, expires_ns : int
        Times of creation and of expiry, nanoseconds since 1970; an ``expires_ns`` of 0 means never.

    Raises
    ------
    InputError
        Users other than the owner can read the file.
    FormatError
        The file is not a key file, or is damaged.
    OSError
        The file cannot be read.

    Notes
    -----
    To replace a key, create a new file under a new name; a verifier of old records also needs the
    old file, see `KeyRing`. The key is symmetric: whoever can verify can also embed. It is held in
    memory that is excluded from swap and core dumps, and `close` wipes it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._key = _core.WatermarkKey(os.fsencode(path_of(path)))

    @classmethod
    def create(cls, path: str | os.PathLike[str], *, expires_ns: int = 0) -> KeyFile:
        """Create a random key, write it to a file that only its owner can read, and open that file.

        Parameters
        ----------
        path : path
            Path of the new file.
        expires_ns : int
            Time at which the key expires, nanoseconds since 1970; 0: never.

        Returns
        -------
        KeyFile

        Raises
        ------
        OSError
            The file exists already (it is never replaced), or cannot be written.
        InputError
            ``expires_ns`` is in the past.
        """
        name = os.fsencode(path_of(path))
        _core.WatermarkKey.create(name, time.time_ns(), expires_ns)
        return cls(path)

    @property
    def key_id(self) -> str:
        """Hexadecimal identifier of the key."""
        return self._key.id.hex()

    @property
    def created_ns(self) -> int:
        """Time at which the key was created, nanoseconds since 1970."""
        return self._key.created_ns

    @property
    def expires_ns(self) -> int:
        """Time from which the key must not embed, nanoseconds since 1970; 0: it does not expire."""
        return self._key.expires_ns

    def close(self) -> None:
        """Wipe the key; may be called twice."""
        self._key.close()

    def __repr__(self) -> str:
        state = "" if self._key.is_open else ", closed"
        return f"<manip3d.authenticate.KeyFile: {self.key_id[:8]}{state}>"


@checked
class KeyRing(Closing):
    """All keys that a sensor has had, one after the other, for a verifier of its records.

    A record does not name its key: the key that verifies its tag made it. The newest key embeds. An
    older key only verifies records that state a time before the next key was created, and no key
    verifies records that state a time at which it had expired. Once a stream has frames of a newer
    key (the verifier's state file remembers that), frames of an older key are replays.

    Parameters
    ----------
    keys : sequence of KeyFile
        In any order; `KeyFile.created_ns` tells which is the newest.

    Raises
    ------
    InputError
        There are no keys, or a key is given twice.

    Notes
    -----
    Create the new key only when the sensor begins to use it, because records that the old key signs
    from then on are refused. The embedder states the time of a record. If a scan has a time, that
    is stated: a drive of 2011 that is signed today with the old key verifies. Whoever has stolen an
    old key can sign with an earlier time, and only a verifier that has seen a newer key in the
    stream notices it. Leave a stolen key out of the ring: its records then are unverifiable. A
    state file whose last frame was signed by a key outside the ring is refused.

    Examples
    --------
    >>> import tempfile, numpy as np
    >>> from manip3d.authenticate import KeyFile, KeyRing, Watermarker
    >>> scan = np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     old = KeyFile.create(folder + "/2025.key")
    ...     sent = Watermarker(old).embed(scan)
    ...     new = KeyFile.create(folder + "/2026.key")
    ...     late = Watermarker(old).embed(scan)
    ...     marker = Watermarker(KeyRing([old, new]))
    ...     print(marker.verify(sent.frame, sent.record).verdict)
    ...     print(marker.verify(late.frame, late.record).reason)
    authentic
    the record states a time after its key had expired or had been replaced
    """

    def __init__(self, keys: Sequence[KeyFile]) -> None:
        newest_first = sorted(keys, key=lambda key: (key.created_ns, key.key_id), reverse=True)
        if not newest_first:
            raise InputError("keys: expected at least one, got none")
        for one, other in pairwise(newest_first):
            if one.key_id == other.key_id:
                raise InputError(f"keys: expected each key once, got {one.key_id[:8]} twice")
        self.keys = tuple(newest_first)

    @classmethod
    def open(cls, paths: Sequence[str | os.PathLike[str]]) -> KeyRing:
        """Open key files, and the key files of folders. Copies of a key count once.

        Parameters
        ----------
        paths : sequence of path
            Key files, and folders, of which all files that end in ``.key`` are opened.

        Returns
        -------
        KeyRing

        Raises
        ------
        InputError
            A folder has no key files; or as `KeyFile` and `KeyRing`.
        FormatError, OSError
            As `KeyFile`.
        """
        files = [file for path in paths for file in _key_files(path_of(path))]
        opened: list[KeyFile] = []
        try:
            opened += (KeyFile(file) for file in files)
            return cls(_without_copies(opened))
        except BaseException:
            for key in opened:
                key.close()
            raise

    @property
    def newest(self) -> KeyFile:
        """The key that embeds."""
        return self.keys[0]

    def close(self) -> None:
        """Wipe all keys; may be called twice."""
        for key in self.keys:
            key.close()

    def __repr__(self) -> str:
        names = ", ".join(key.key_id[:8] for key in self.keys)
        return f"<manip3d.authenticate.KeyRing: {names}>"


def _without_copies(keys: Sequence[KeyFile]) -> list[KeyFile]:
    """Return each key once, and close its copies.

    Files with the same identifier but different times stay, which `KeyRing` refuses.
    """
    first: dict[tuple[str, int, int], KeyFile] = {}
    for key in keys:
        same = first.setdefault((key.key_id, key.created_ns, key.expires_ns), key)
        if same is not key:
            key.close()
    return list(first.values())


def _key_files(path: Path) -> list[Path]:
    """The given key file, or the key files of the given folder."""
    if not path.is_dir():
        return [path]
    found = sorted(visible(path.glob("*.key")))
    if not found:
        raise InputError(f"{path}: expected a folder with files that end in .key, found none")
    return found
