"""Warnings about folders of images: pictures that are left out, and units that are assumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from manip3d._util.paths import is_hidden, visible
from manip3d._util.regular_files import open_regular
from manip3d.errors import Error

SET_UNIT = (
    "'manip3d capture record --units-per-metre' (units_per_metre= in Python) sets another unit"
)
"""Cure of a unit that was assumed wrongly."""
_COLOR_FOLDERS = "color, colour, rgb, image or images"
_PICTURES = (".jpg", ".jpeg", ".png")
_PNG_COLOR_TYPE = 25
"""Byte of a PNG that holds its colour type (RFC 2083)."""
_PNG_COLORS = (2, 6)  # pictures with a palette are mostly masks
_NEAREST_M, _FARTHEST_M = 0.2, 12.0
"""Limits of the median of a depth image, metres, that cameras of rooms and people measure."""


def pictures_left_out(folder: Path) -> str:
    """Return a warning about pictures beside ``depth/`` that are not read; empty if there are none.

    It is for folders of images of which no colour image was found.
    """
    others = sorted(
        each.name
        for each in folder.iterdir()
        if each.is_dir() and each.name != "depth" and not is_hidden(each.name) and _has_colors(each)
    )
    if not others:
        return ""
    return (
        f"{folder}: frames have no colour: pictures in {', '.join(others)} are left out, since "
        f"colour images are expected in {_COLOR_FOLDERS}, with the times or numbers of depth images"
    )


def _has_colors(folder: Path) -> bool:
    """Whether the first picture of a folder has colours; what cannot be read has none."""
    try:
        pictures = (each for each in folder.iterdir() if each.suffix.lower() in _PICTURES)
        first = next(visible(pictures), None)
        if first is None or first.suffix.lower() != ".png":
            return first is not None
        with open_regular(first) as file:
            start = file.read(_PNG_COLOR_TYPE + 1)
    except (OSError, Error):
        return False
    return len(start) > _PNG_COLOR_TYPE and start[_PNG_COLOR_TYPE] in _PNG_COLORS


def unit_in_doubt(
    depth: NDArray[np.uint16], units_per_metre: float, *, has_8_bits: bool = False
) -> str:
    """Return a warning if depth in millimetres speaks against the unit that was assumed, or empty.

    Parameters
    ----------
    depth : (H, W) uint16, millimetres
        A frame's depth; 0 is not measured.
    units_per_metre : float
        The stored units per metre that were assumed.
    has_8_bits : bool
        Whether the image was stored in 8 bits, in which a room in millimetres does not fit.
    """
    assumed = f"the {units_per_metre:g} units per metre that are assumed"
    if has_8_bits:
        farthest = 255.0 / units_per_metre
        return f"depth images of 8 bits reach {farthest:.3g} m with {assumed}; {SET_UNIT}"
    measured = depth[depth > 0]
    if not measured.size:
        return ""
    median = float(np.median(measured)) / 1000.0
    if _NEAREST_M <= median <= _FARTHEST_M:
        return ""
    return f"the median of the depth is {median:.3g} m with {assumed}; {SET_UNIT}"
