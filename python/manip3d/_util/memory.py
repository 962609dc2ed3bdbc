"""Resident memory of this process; parsing and formatting of sizes such as ``2GiB``."""

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
    """Return the resident memory of this process in bytes; None if it is not known."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def available_bytes() -> int | None:
    """Return the memory that programs can still use without swapping; None if it is not known."""
    try:
        text = Path("/proc/meminfo").read_text(encoding="ascii")
    except (OSError, ValueError):
        return None
    match = re.search(r"^MemAvailable:\s*(\d+) kB$", text, re.MULTILINE)
    return None if match is None else 1024 * int(match[1])


def most_resident_bytes() -> int | None:
    """Return the peak resident memory of this process in bytes; None if it is not known.

    ``getrusage`` is not used because its peak includes the parent's memory at the fork.
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except (OSError, ValueError):
        return None
    match = re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)
    return None if match is None else 1024 * int(match[1])


def release_unused() -> None:
    """Return freed memory to the operating system, if the C library can."""
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):
        return
    trim(0)


def bytes_of(text: str) -> int:
    """Return the number of bytes of ``"2GiB"``, ``"500 MB"`` or ``"100000"``.

    Raises
    ------
    InputError
        The text is not a positive number with one of the units.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([a-z]*)\s*", text.lower())
    size = 0
    if match is not None and match[2] in _UNITS:
        size = int(float(match[1]) * _UNITS[match[2]])
    if size <= 0:
        raise InputError(f"expected a size such as 2GiB, 500MB or 100000, got {text!r}")
    return size


def written_size(size: int) -> str:
    """Return a number of bytes as a readable text: ``1.50 GiB``."""
    for unit, power in (("GiB", 3), ("MiB", 2)):
        if size >= 1024**power:
            return f"{size / 1024**power:.2f} {unit}"
    return f"{size} bytes"
