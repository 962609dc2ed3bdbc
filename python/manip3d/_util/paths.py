"""Checks of paths at the API border."""

from __future__ import annotations

import os
import re
from pathlib import Path

from manip3d.errors import InputError


def path_of(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return the path that the argument ``name`` gives.

    Raises
    ------
    InputError
        It is not a path, or has a NUL character, where the operating system would cut it off.
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
    """Return whether a file or a folder of this name is left out where a folder is searched.

    Programs leave such files beside others: macOS ``._scan.bin`` beside each ``scan.bin`` on drives
    that are not its own, editors and version control theirs.
    """
    return name.startswith(".")


def by_number(name: str) -> tuple[tuple[tuple[int, str, int], ...], str]:
    """Key that sorts names as people do: numbers in them by their size, so that 2 is before 10."""
    parts = re.split(r"([0-9]+)", name)
    key = tuple((1, "", int(p)) if i % 2 else (0, p, 0) for i, p in enumerate(parts))
    return key, name  # 01 and 1 are two names
