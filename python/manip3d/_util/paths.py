"""Checks of path arguments of public functions."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from manip3d.errors import InputError


def path_of(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return an argument as a Path; ``name`` is the argument's name in errors.

    Raises
    ------
    InputError
        The argument is no path, has characters that file names cannot have, or has a NUL character,
        at which the operating system would cut it off.
    """
    if not isinstance(path, str | os.PathLike) or not isinstance(os.fspath(path), str):
        raise InputError(f"{name}: expected a path, got {type(path).__name__}")
    if "\0" in os.fspath(path):
        raise InputError(f"{name}: expected a path without NUL characters, got {path!r}")
    try:
        os.fsencode(path)
    except UnicodeEncodeError as error:
        raise InputError(f"{name}: expected characters of file names, got {path!r}") from error
    return Path(path)


def is_hidden(name: str) -> bool:
    """Return whether a file or folder of this name is hidden, so that searches ignore it.

    Programs create such files beside others: macOS writes ``._scan.bin`` beside each ``scan.bin``
    on foreign file systems; editors and version control have theirs.
    """
    return name.startswith(".")


_DECIMAL = re.compile(r"(?:^|/)[0-9]+\.([0-9]+)\.[^./0-9][^/]*$")
"""A path whose last name is a decimal number with a suffix; the group is its fraction."""


def by_number(name: str) -> tuple[tuple[tuple[int, str, int], ...], str]:
    """Return a key that sorts names with numbers in them by value, so that 2 is before 10.

    A name that is a decimal number, apart from its suffix, is sorted by its value: 0.25.png is
    before 0.5.png. In other names (``scan1.25.png``) each run of digits is a whole number.
    """
    decimal = _DECIMAL.search(name)
    fraction = decimal.start(1) if decimal else -1
    key: list[tuple[int, str, int]] = []
    for part in re.finditer(r"[0-9]+|[^0-9]+", name):
        text = part.group()
        if part.start() == fraction:
            key.append((0, text, 0))
        elif text[0] in "0123456789":
            key.append((0, "", int(text)))
        else:
            key.append((1, text, 0))
    return tuple(key), name  # the name distinguishes 01 from 1


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Return paths sorted by their names, numbers in them by value."""
    return sorted(paths, key=lambda path: by_number(path.name))
