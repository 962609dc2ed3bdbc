"""Conversion of colours and normals of scans between the column names of different formats."""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

_COLORS = (
    ("red", "green", "blue"),
    ("colorred", "colorgreen", "colorblue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
)
_PACKED = ("rgb", "rgba")
"""Names of a column with red, green and blue packed in 32 bits (PCD)."""
_TABLES = (*_PACKED, "color", "colors", "colour", "colours")
"""Names of an array with red, green and blue, also with alpha, in each row."""
_UNNAMED = (("c4", "c5", "c6"), ("c3", "c4", "c5"))
"""Colours in the last columns of a text file without column names: Leica's ``.pts``, Open3D's."""
NORMALS = {
    "pcd": ("normal_x", "normal_y", "normal_z"),
    **dict.fromkeys(("ply", "npz", "xyzn"), ("nx", "ny", "nz")),
}
"""Column names of normals in each format."""
_NAMES = {
    "e57": ("colorRed", "colorGreen", "colorBlue"),
    **dict.fromkeys(("ply", "las", "csv", "pts", "ptx", "npz", "xyzrgb"), ("red", "green", "blue")),
}
_CLOUDCOMPARE_PREFIX = "scalar_"
"""Prefix of column names that CloudCompare writes."""
_UNIT = re.compile(r"(?<=\w) ?(\([^()]*\)|\[[^\[\]]*\])$")
"""Unit behind a column name, as in ``reflectivity (%)``."""
_WIDE = ("las", "csv")
"""Formats whose colours may have 16 bits."""
_LAS_STEP = 256
"""LAS scales 8-bit colours to 16 bits by this factor."""


def plain_name(name: str) -> str:
    """Return a column name in lower case without CloudCompare's prefix and without a unit."""
    return _UNIT.sub("", name.lower().removeprefix(_CLOUDCOMPARE_PREFIX))


def renamed(frame: LidarFrame, name: str) -> LidarFrame:
    """Return the frame with colours and normals under the names of the format ``name``.

    PLY and PCD hold no blanks in names: other columns get underscores instead.

    Colours have 8 bits in all formats except LAS and CSV. Fields stay unchanged if the frame has no
    colours, or if the format has no names for them, or if it is the frame's own format.

    A frame read from LAS may have integer intensities beside a reflectance, which is the frame's
    ``intensity``. The former become the field ``las_intensity``, or are dropped if all are 0. A
    field ``ring`` or ``Ring`` that is not the lasers' numbers becomes ``other_ring``, so that no
    reader takes it for these: the frame has a ``ring``, or the field has negative numbers. New
    names that other fields have already are numbered: ``other_ring_2``.
    """
    if frame.format is not None and frame.format.name == name:
        return frame
    fields = dict(frame.fields)
    if frame.intensity is not None and "intensity" in fields:
        second = fields.pop("intensity")
        if second.any():
            fields[_free_name("las_intensity", fields)] = second
    for key in [key for key in fields if key.lower() == "ring"]:
        if frame.ring is not None or (fields[key] < 0).any():
            fields[_free_name("other_ring", fields)] = fields.pop(key)
    _rename_normals(fields, name)
    found = find_colors(fields)
    if found is not None and (name == "pcd" or name in _NAMES):
        taken, colors = found
        kept = {key: values for key, values in fields.items() if key not in taken}
        fields = kept | _named_colors(colors, name)
    if name in ("ply", "pcd"):
        fields = _without_blanks(fields)
    return frame.replace(fields=fields)


def _without_blanks(fields: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the fields in their order, with underscores for blanks in their names."""
    found: dict[str, NDArray[Any]] = {}
    for key, values in fields.items():
        new = re.sub(r"\s+", "_", key)
        found[new if new == key else _free_name(new, fields.keys() | found.keys())] = values
    return found


def _free_name(name: str, used: Collection[str]) -> str:
    """Return the name, or the name with the first number from 2 with which no field has it."""
    numbered = (f"{name}_{number}" for number in itertools.count(2))
    return next(free for free in itertools.chain([name], numbered) if free not in used)


def color_names(frame: LidarFrame, name: str) -> tuple[str, ...]:
    """Return the names of the colour fields of a frame from `renamed`; empty without colours."""
    names = _NAMES.get(name, ())
    return names if names and all(each in frame.fields for each in names) else ()


def _rename_normals(fields: dict[str, NDArray[Any]], name: str) -> None:
    wanted = NORMALS.get(name)
    for names in NORMALS.values():
        if wanted is not None and names != wanted and all(each in fields for each in names):
            # float32, because Open3D reads 64-bit normals in PCD as 0.
            taken = [fields.pop(each).astype(np.float32) for each in names]
            fields |= dict(zip(wanted, taken, strict=True))


def find_colors(
    fields: Mapping[str, NDArray[Any]],
) -> tuple[Sequence[str], NDArray[Any]] | None:
    """Return the names of the fields with colours, and the colours (N, 3) of 8 or 16 bits."""
    by_plain = {plain_name(name): name for name in fields}
    for names in (*_COLORS, *_UNNAMED):
        if not all(name in by_plain for name in names):
            continue
        taken = [by_plain[name] for name in names]
        if names in _UNNAMED and taken[-1] != list(fields)[-1]:
            continue
        # Columns named r or c4 need not be colours, so that they must have 8 bits.
        most = 255 if len(names[0]) < 3 else 65535
        colors = _as_colors([fields[name] for name in taken], most)
        if colors is not None:
            return taken, colors
    for name in _TABLES:
        values = fields.get(by_plain.get(name, name))
        if values is None or (values.ndim == 1 and name not in _PACKED):
            continue
        if (colors := _unpacked(values)) is not None:
            return [by_plain[name]], colors
    return None


def is_packed(name: str, values: NDArray[Any]) -> bool:
    """Return whether a column holds the bits of packed colours, which may be NaN as floats."""
    return values.ndim == 1 and plain_name(name) in _PACKED


def with_8_bits(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours of 8 or 16 bits with 8."""
    wide = colors.dtype == np.uint16
    return (colors // _LAS_STEP if wide else colors).astype(np.uint8, copy=False)


def _as_colors(columns: Sequence[NDArray[Any]], most: int) -> NDArray[Any] | None:
    """Return the columns as colours, (N, 3); None if they are no integers from 0 to ``most``.

    If ``most`` is 65535, fractions from 0 to 1 are colours, too. If no number is above 255, the
    colours have 8 bits.
    """
    if any(values.ndim != 1 or values.dtype.kind not in "iuf" for values in columns):
        return None
    values = np.column_stack(columns)
    if most > 255 and _are_shares(values):  # Open3D and renderers write such colours
        return np.rint(values * 255.0).astype(np.uint8)
    if not bool((np.isfinite(values) & (values == np.rint(values)) & (values >= 0)).all()):
        return None
    largest = values.max(initial=0)
    if largest > most:
        return None
    return values.astype(np.uint8 if largest <= 255 else np.uint16)


def _are_shares(values: NDArray[Any]) -> bool:
    """Return whether colours are floats from 0 to 1, of which some are neither 0 nor 1."""
    if values.dtype.kind != "f" or not bool(((values >= 0.0) & (values <= 1.0)).all()):
        return False
    return bool((values != np.rint(values)).any())


def _unpacked(values: NDArray[Any]) -> NDArray[Any] | None:
    if values.ndim == 2 and values.shape[1] in (3, 4):
        return _as_colors([*values[:, :3].T], 65535)
    if values.ndim != 1 or values.dtype.kind not in "iuf" or values.dtype.itemsize != 4:
        return None
    bits = np.ascontiguousarray(values).view(np.uint32)
    return np.column_stack([bits >> shift & 255 for shift in (16, 8, 0)]).astype(np.uint8)


def _named_colors(colors: NDArray[Any], name: str) -> dict[str, NDArray[Any]]:
    is_wide = colors.dtype == np.uint16
    if is_wide and name not in _WIDE:
        colors = with_8_bits(colors)
    if not is_wide and name == "las":
        colors = colors.astype(np.uint16) * _LAS_STEP
    if name == "xyzrgb":
        shares = colors / 255.0
        return {each: np.ascontiguousarray(shares[:, i]) for i, each in enumerate(_NAMES[name])}
    if name == "pcd":
        red, green, blue = colors.astype(np.uint32).T
        return {"rgb": (red << 16 | green << 8 | blue).view(np.float32)}
    return {each: np.ascontiguousarray(colors[:, i]) for i, each in enumerate(_NAMES[name])}
