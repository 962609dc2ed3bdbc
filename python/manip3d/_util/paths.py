"""Checks of path arguments of public functions."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path

from manip3d._util.texts import has_control_characters
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


def legible_path_of(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return `path_of` for a file whose absolute path will be stored and shown later.

    Raises
    ------
    InputError
        See `path_of`; or the absolute path has control characters, line feeds included, or is not
        UTF-8.
    """
    found = path_of(path, name)
    text = str(found.absolute())
    if has_control_characters(text) or "\n" in text:
        raise InputError(
            f"{name}: expected a path of UTF-8 without control characters, got {text!a}"
        )
    return found


def refuse_existing(
    path: Path, *, overwrite: bool, name: str = "", option: str = "overwrite"
) -> None:
    """Raise InputError if an output exists and may not be replaced.

    Parameters
    ----------
    path : Path
        A file or a folder.
    overwrite : bool
        Whether it may be replaced.
    name : str
        The argument that is the path, if the error is to begin with it.
    option : str
        The argument that permits to replace it. Commands show it as ``--force``.
    """
    if path.exists() and not overwrite:
        place = f"{name}: {path}" if name else f"{path}:"
        raise InputError(f"{place} exists already; {option}=True replaces it")


def is_hidden(name: str) -> bool:
    """Return whether a file or folder of this name is hidden, so that searches ignore it.

    Programs create such files beside others: macOS writes ``._scan.bin`` beside each ``scan.bin``
    on foreign file systems; editors and version control have theirs.
    """
    return name.startswith(".")


def visible(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the paths whose names are not hidden."""
    return (path for path in paths if not is_hidden(path.name))


_DECIMAL = re.compile(r"(?:^|/)[0-9]+\.([0-9]+)\.[^./0-9][^/]*$")
"""A path whose last name is a decimal number with a suffix; the group is its fraction."""
_WHOLE_DIGITS, _FRACTION_DIGITS = 5, 3  # of times; numbers of takes have fewer

_Key = tuple[tuple[tuple[int, str, int], ...], str]


def has_decimals(stems: Iterable[str]) -> bool:
    """Return whether numbers with a point, in the names of one list, are decimals, as times are.

    Otherwise the point is between two whole numbers: 1.9, 1.10, 1.11 are frames of a take. Decimals
    are as fine as times: one has five digits before its point or three after it. All have as many
    digits after the point, or none has a 0 at its end, as programs write 1.5 for 1.50. The rule is
    that of ``has_decimals`` in cpp/src/capture/image_names.cpp.
    """
    found = [number for stem in stems for number in re.findall(r"([0-9]+)\.([0-9]+)", stem)]
    is_fine = any(len(w) >= _WHOLE_DIGITS or len(f) >= _FRACTION_DIGITS for w, f in found)
    have_one_length = len({len(fraction) for _, fraction in found}) == 1
    end_in_0 = any(len(fraction) > 1 and fraction.endswith("0") for _, fraction in found)
    return is_fine and (have_one_length or not end_in_0)


def by_number(names: Collection[str]) -> Callable[[str], _Key]:
    """Return the key that sorts these names, numbers in them by value, so that 2 is before 10.

    If numbers with a point are decimals in them (`has_decimals`), names of only such a number and a
    suffix are sorted by its value: 0.25.png is before 0.5.png. In other names (``scan1.25.png``)
    each run of digits is a whole number.
    """
    stems = (name.rpartition("/")[2].rpartition(".")[0] for name in names)
    return _key_of_decimal if has_decimals(stems) else _key_of


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Return paths sorted by their names, numbers in them by value."""
    listed = list(paths)
    key = by_number([path.name for path in listed])
    return sorted(listed, key=lambda path: key(path.name))


def _key_of_decimal(name: str) -> _Key:
    decimal = _DECIMAL.search(name)
    return _key_of(name, decimal.start(1) if decimal else -1)


def _key_of(name: str, fraction: int = -1) -> _Key:
    """Return the key of a name; ``fraction`` is where its digits after the point begin."""
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
