"""Files that end: no pipes, sockets and devices."""

from __future__ import annotations

import os
import stat
from io import BufferedReader

from manip3d.errors import FormatError


def open_regular(path: str | os.PathLike[str]) -> BufferedReader:
    """Open a regular file for reading bytes; a pipe or a device could go on for ever.

    Raises
    ------
    FormatError
        It is a pipe, a socket or a device.
    OSError
        `FileNotFoundError`, `IsADirectoryError` and the like.
    """
    # Without O_NONBLOCK, opening a pipe waits for its writer.
    file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise FormatError("expected a regular file, got a pipe, socket or device", file=str(path))


def limited_bytes(path: str | os.PathLike[str], most: int) -> bytes:
    """Return the content of what `open_regular` opens, of at most so many bytes.

    Raises
    ------
    FormatError
        It is longer, or no regular file.
    OSError
        As `open_regular`.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise FormatError(
            f"expected at most {most} bytes, got more", file=str(path), byte_offset=most
        )
    return content
