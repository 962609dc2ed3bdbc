"""Order of the numbers of a pose in the lines of a trajectory, from the names of its columns."""

from __future__ import annotations

import re
from collections.abc import Sequence

POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""Parts of a pose in the order in which they are read where no line names the columns."""

_BETWEEN = re.compile(r"\s*,\s*|\s+")
_BETWEEN_NAMES = re.compile(r"\s*[,:]\s*|\s+")
_UNIT = re.compile(r"\[[^\]]*\]|\([^)]*\)")
_TIME = re.compile(r"time\w*|\w*stamp\w*|t|ts|(n|nano)?sec(ond)?s?")
_FRAME = re.compile(r"frame(_?(id|index|number))?")
_TRANSLATION = re.compile(r"(t|p|pos|position|trans|translation)(_\w+)?_?(?P<axis>[xyz])")
_QUATERNION = re.compile(
    r"(q|quat|quaternion|o|ori|orientation|r|rot|rotation)(_\w+)?_?(?P<axis>[wxyz0-4])"
)


def fields_of(line: str) -> list[str]:
    """Return the fields of a line, between which are spaces or commas; empty ones have commas."""
    return _BETWEEN.split(line.strip())


def are_named(names: Sequence[str], fields: Sequence[str]) -> bool:
    """Return whether there is a name for each field; the last fields may be empty or left out."""
    return len(filled(fields)) <= len(names) <= len(fields)


def filled(fields: Sequence[str]) -> Sequence[str]:
    """Return the fields up to the last one that is not empty."""
    return fields[: max((at for at, field in enumerate(fields, start=1) if field), default=0)]


def names_in(line: str) -> list[str]:
    """Return the names of columns in a line, those of a pose as in `POSE`.

    The names of a time and of a frame's number become ``time`` and ``frame``.
    """
    text = _UNIT.sub("", line.lower().replace('"', "")).strip("#% \t")
    names = [_known(name) for name in _BETWEEN_NAMES.split(text)]
    # Letters alone are a quaternion if w is among them or the translation has its own names.
    letter = "q" if "w" in names or "tx" in names else "t"
    return [letter + name if name in ("w", "x", "y", "z") else name for name in names]


def _known(name: str) -> str:
    if _TIME.fullmatch(name):
        return "time"
    if _FRAME.fullmatch(name):
        return "frame"
    if found := _TRANSLATION.fullmatch(name):
        return "t" + found["axis"]
    if found := _QUATERNION.fullmatch(name):
        return "q" + found["axis"]
    return name


def columns_of(names: Sequence[str], fields: Sequence[str]) -> tuple[int, ...]:
    """Return the columns of time, if there is one, and pose among fields; empty if unknown.

    The number of a frame is its time. Words before the first and behind the last name that is known
    may belong to a sentence.
    """
    known = [at for at, name in enumerate(names) if name in (*POSE, "time", "frame")]
    if not known:
        return ()
    for part in (names, names[known[0] :], names[known[0] : known[-1] + 1]):
        if are_named(part, fields) and all(part.count(name) == 1 for name in POSE):
            pose = tuple(part.index(name) for name in POSE)
            time = "frame" if "frame" in part else "time"
            if part.count(time) <= 1:
                return (part.index(time), *pose) if time in part else pose
    return ()


def names_another_order(names: Sequence[str]) -> bool:
    """Return whether a quaternion is named, and not in the order of `POSE`.

    One or two of its parts may be other words of a sentence.
    """
    last = {
        name: at for at, name in enumerate(names) if name in POSE or _QUATERNION.fullmatch(name)
    }
    if sum(name.startswith("q") for name in last) < 3:
        return False
    return sorted(last, key=last.__getitem__) != [name for name in POSE if name in last]
