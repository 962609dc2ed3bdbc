"""Left and right of joints in pixels, whose names depend on the picture that a tracker saw."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.errors import FormatError, InputError
from manip3d.io._joint_files import JointFile
from manip3d.modify import joint_layouts
from manip3d.modify._joints import JointLayout

_OPTIONS = re.compile(r"\?((?:mirrored|sides)=[^?]*)$")
_WORDS = {
    "mirrored": {"yes": True, "no": False},
    "sides": {"exchanged": True, "named": False},
}
_SEEN = 0.5  # confidence of a joint that was surely found
_AGREEMENT = 0.5  # of +1 and -1: three quarters of the shoulders' widths lie the same way


@dataclass(frozen=True)
class PixelOptions:
    """Options of ``joints:SOURCE#FILE?OPTIONS``; None: the source and the joints decide.

    Attributes
    ----------
    mirrored : bool or None
        Whether the tracker saw mirrored images.
    exchanged : bool or None
        Whether the names of left and right are to be exchanged.
    """

    mirrored: bool | None = None
    exchanged: bool | None = None


def file_and_options(text: str) -> tuple[str, PixelOptions]:
    """Return the file and the options of ``FILE?mirrored=yes&sides=named``.

    Raises
    ------
    InputError
        An option is unknown, or has another value than the words for it.
    """
    found = _OPTIONS.search(text)
    if found is None:
        return text, PixelOptions()
    values: dict[str, bool] = {}
    for option in found[1].split("&"):
        name, _, word = option.partition("=")
        if word not in _WORDS.get(name, {}) or name in values:
            raise InputError(
                "uri: expected mirrored=yes or no and sides=exchanged or named after ?, got "
                f"{found[1]!r}"
            )
        values[name] = _WORDS[name][word]
    options = PixelOptions(values.get("mirrored"), values.get("sides"))
    return text[: found.start()], options


@cache
def other_sides(layout: str) -> tuple[int, ...]:
    """Return for each joint of a layout the index of the one on the other side, or its own."""
    names = joint_layouts()[cast("JointLayout", layout)]
    other = {"Left": "Right", "Right": "Left"}
    return tuple(
        names.index(re.sub("(Left|Right)$", lambda side: other[side[1]], name)) for name in names
    )


def exchanges_sides(file: JointFile, path: str, options: PixelOptions, is_mirrored: bool) -> bool:
    """Return whether the names of left and right must be exchanged.

    A tracker names the sides by the picture, in which a mirrored person who faces the camera has
    the left shoulder where other people have it, too. Exchanged names of images that are not
    mirrored are warned of.

    Raises
    ------
    InputError
        There are options, but the joints are in metres.
    FormatError
        The images are mirrored, and nobody who faces the camera tells the sides.
    """
    if file.axes != "pixels":
        if options != PixelOptions():
            raise InputError(f"uri: expected mirrored= and sides= only of joints in pixels: {path}")
        return False
    if options.exchanged is not None:
        return options.exchanged
    balance = _left_minus_right(file)
    if is_mirrored and abs(balance) < _AGREEMENT:
        raise FormatError(
            "expected people who face the camera, with nose and shoulders, because the images are "
            "mirrored and nothing else tells left from right; say it in the address: "
            "FILE?sides=exchanged if the tracker saw the mirrored images, FILE?sides=named if the "
            "left joints are those of the left limbs",
            file=path,
        )
    if not is_mirrored and balance <= -_AGREEMENT:
        warnings.warn(
            f"{path}: left and right seem to be exchanged, because people who face the camera have "
            "their left shoulder to the left: say FILE?mirrored=yes in the address if the images "
            "that the tracker saw were mirrored, FILE?sides=exchanged if only the names are wrong, "
            "or FILE?sides=named if they are right",
            stacklevel=caller_level(),
        )
    return is_mirrored and balance > 0.0


def _left_minus_right(file: JointFile) -> float:
    """Return +1 if the left shoulders of people who face the camera are to the right, -1 if not.

    Between the two, the frames disagree; 0 also if nobody surely faces the camera. Wide shoulders
    count more than those of a person who stands sideways.
    """
    widths = np.array(list(_widths_of_facing(file)))
    total = float(np.abs(widths).sum())
    return float(widths.sum()) / total if total > 0.0 else 0.0


def _widths_of_facing(file: JointFile) -> Iterator[float]:
    """Yield how far the left shoulder is to the right of the right one, where a nose is seen."""
    names = joint_layouts()[cast("JointLayout", file.layout)]
    nose, left, right = (names.index(n) for n in ("Nose", "ShoulderLeft", "ShoulderRight"))
    for people in file.frames.values():
        for one in people:
            if (one.trust[[nose, left, right]] >= _SEEN).all():
                yield float(one.joints[left, 0] - one.joints[right, 0])
