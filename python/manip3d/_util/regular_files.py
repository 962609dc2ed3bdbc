"""Reading of regular files only; pipes, sockets and devices, which may not end, are refused."""

from __future__ import annotations

import os
import stat
from io import BufferedReader

from manip3d.errors import FormatError


def open_regular(path: str | os.PathLike[str]) -> BufferedReader:
    """Open a regular file for reading bytes; refuse pipes and devices, which may be endless.

    Raises
    ------
    FormatError
        The file is a pipe, a socket or a device.
    OSError
        The file cannot be opened (`FileNotFoundError`, `IsADirectoryError`, ...).
    """
    # Without O_NONBLOCK, opening a pipe would wait for its writer.
    file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise FormatError("expected a regular file, got a pipe, socket or device", file=str(path))


def limited_bytes(path: str | os.PathLike[str], most: int) -> bytes:
    """Return the content of a regular file of at most ``most`` bytes.

    Raises
    ------
    FormatError
        The file has more bytes, or is no regular file.
    OSError
        See `open_regular`.
    """
    return _bytes_of(path, most, f"expected at most {most} bytes, got more", most)


def bytes_below(path: str | os.PathLike[str], limit: int) -> bytes:
    """Return the content of a regular file of at most ``limit`` bytes, a user's ``max_bytes``.

    Parameters
    ----------
    path : path-like
    limit : int
        Largest number of bytes; 0: no limit.

    Raises
    ------
    FormatError
        The file has more bytes, or is no regular file.
    OSError
        See `open_regular`.
    """
    return _bytes_of(path, limit or None, over_max_bytes(limit))


def _bytes_of(
    path: str | os.PathLike[str], most: int | None, reason: str, at: int | None = None
) -> bytes:
    """Return a file's content; longer than ``most`` bytes, it is refused with ``reason``."""
    with open_regular(path) as file:
        content = file.read() if most is None else file.read(most + 1)
    if most is not None and len(content) > most:
        raise FormatError(reason, file=str(path), byte_offset=at)
    return content


def over_max_bytes(limit: int) -> str:
    """Return the reason for refusing a file of more than ``max_bytes``, in the core's words."""
    return f"expected at most max_bytes = {limit} bytes, got more"
