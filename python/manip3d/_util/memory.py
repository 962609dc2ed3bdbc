"""Resident memory of this process, and sizes as people write them."""

from __future__ import annotations

import ctypes
import os
import re
from pathlib import Path

from manip3d.errors import InputError

_UNITS = {"": 1, "b": 1} | {
    f"{letter}{middle}b": base**power
    for power, letter in enumerate("kmgt", start=1)
    for middle, base in (("", 1000), ("i", 1024))
}


def resident_bytes() -> int | None:
    """Resident memory of this process; ``None`` where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def most_resident_bytes() -> int | None:
    """The most that this process has held so far; ``None`` where the system does not say.

    (``getrusage`` would count what the parent held when it started this process.)
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except (OSError, ValueError):
        return None
    match = re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)
    return None if match is None else 1024 * int(match[1])


def release_unused() -> None:
    """Give freed memory back to the system, where the C library can."""
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):
        return
    trim(0)


def bytes_of(text: str) -> int:
    """The number of bytes of ``"2GiB"``, ``"500 MB"`` or ``"100000"``.

    Raises
    ------
    InputError
        It is not a positive number with one of the units.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([a-z]*)\s*", text.lower())
    size = 0
    if match is not None and match[2] in _UNITS:
        size = int(float(match[1]) * _UNITS[match[2]])
    if size <= 0:
        raise InputError(f"expected a size such as 2GiB, 500MB or 100000, got {text!r}")
    return size


def written_size(size: int) -> str:
    """Bytes as people read them: ``1.5 GiB``."""
    for unit, power in (("GiB", 3), ("MiB", 2)):
        if size >= 1024**power:
            return f"{size / 1024**power:.2f} {unit}"
    return f"{size} bytes"
