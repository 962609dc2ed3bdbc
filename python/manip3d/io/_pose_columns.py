"""Order of the numbers of a pose in the lines of a trajectory, from the names of its columns."""

from __future__ import annotations

import re
import string
from collections.abc import Sequence

POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""Parts of a pose in the order in which they are read where no line names the columns."""

_BETWEEN = re.compile(r"\s*,\s*|\s+")
_MARKS = "".join(set(string.punctuation + string.whitespace) - set("_,;|"))
_BETWEEN_NAMES = re.compile(r"[{0}]*[,;|][{0}]*|[{0}]+".format(re.escape(_MARKS)))
_INSIDE_NAME = re.compile(r"(?<=\w)(?:[.-](?=\w)|\[(?=[wxyz0-4]\]))")
"""Marks within a name, as in q.w, frame-id and q[w], at which a line is not split."""
_IN_BRACKETS = re.compile(r"\[([^][]*)\]|\(([^()]*)\)")
_ORDER = re.compile(r"(wxyz|xyzw)\b")
_TIME = re.compile(r"time\w*|\w*stamp\w*|t|ts|(n|nano)?sec(ond)?s?")
_FRAME = re.compile(r"frame(_?(id|index|number))?")
_TRANSLATION = re.compile(r"(t|p|pos|position|trans|translation)(_\w+)?_?(?P<axis>[xyz])")
_QUATERNION = re.compile(
    r"(q|quat|quaternion|o|ori|orientation|r|rot|rotation)(_\w+)?_?(?P<axis>[wxyz0-4])"
)
_HAMILTON = {"qr": "qw", "qs": "qw", "qi": "qx", "qj": "qy", "qk": "qz"}
"""Names of a quaternion's parts after its real or scalar part and the units i, j and k."""


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
    text = _INSIDE_NAME.sub("_", line.lower())
    text = _ORDER.sub(lambda word: f" {' '.join(word[0])}", text)
    text = _IN_BRACKETS.sub(_without_unit, text).strip(_MARKS)
    names = [_known(name) for name in _BETWEEN_NAMES.split(text)]
    # Letters alone are a quaternion if w is among them or the translation has its own names.
    letter = "q" if "w" in names or "tx" in names else "t"
    return [letter + name if name in ("w", "x", "y", "z") else name for name in names]


def _without_unit(brackets: re.Match[str]) -> str:
    """Return the names in brackets, as in ``quaternion (w x y z)``; '' for a unit or a remark."""
    inside = brackets[1] or brackets[2] or ""
    words = map(_known, _BETWEEN_NAMES.split(inside))
    parts = [word for word in words if word in (*POSE, "w", "x", "y", "z")]
    return f" {inside} " if len(parts) >= 3 else ""


def _known(name: str) -> str:
    if _TIME.fullmatch(name):
        return "time"
    if _FRAME.fullmatch(name):
        return "frame"
    if found := _TRANSLATION.fullmatch(name):
        return "t" + found["axis"]
    if found := _QUATERNION.fullmatch(name):
        return "q" + found["axis"]
    return _HAMILTON.get(name.replace("_", ""), name)


def columns_of(names: Sequence[str], fields: Sequence[str]) -> tuple[int, ...]:
    """Return the columns of time, if there is one, and pose among fields; empty if unknown.

    The number of a frame is its time. If neither has a known name, the first column is the time,
    unless it is a part of the pose. Words before the first and behind the last name that is known
    may belong to a sentence.
    """
    known = [at for at, name in enumerate(names) if name in (*POSE, "time", "frame")]
    if not known:
        return ()
    first, end = known[0], known[-1] + 1
    # A word between names in a sentence may have no column: "qx qy qz qw, translation tx ty tz".
    in_sentence = [names[first:], names[first:end]] if len(known) == end - first else []
    for part in (names, *in_sentence):
        if are_named(part, fields) and all(part.count(name) == 1 for name in POSE):
            pose = tuple(part.index(name) for name in POSE)
            time = next((name for name in ("frame", "time") if name in part), part[0])
            if time in POSE:
                return pose
            if part.count(time) == 1 or time not in ("frame", "time"):
                return (part.index(time), *pose)
    return ()


def names_another_order(names: Sequence[str]) -> bool:
    """Return whether four parts of a quaternion are named one by one, never in `POSE`'s order.

    Fewer of them may be other words of a sentence, such as the axes of a camera.
    """
    runs = [tuple(names[at : at + 4]) for at in range(len(names) - 3)]
    named = [run for run in runs if all(map(_QUATERNION.fullmatch, run))]
    return bool(named) and POSE[3:] not in named
