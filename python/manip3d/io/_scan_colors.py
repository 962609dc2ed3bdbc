"""Colours and normals of scans, under the names that each format has for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

_COLORS = (
    ("red", "green", "blue"),
    ("colorred", "colorgreen", "colorblue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
)
_PACKED = ("rgb", "rgba")
"""Red, green and blue in one number of 32 bits, as PCD has them, or in one row."""
_UNNAMED = (("c4", "c5", "c6"), ("c3", "c4", "c5"))
"""The last columns of a text without names: those of Leica's ``.pts``, and those of Open3D's."""
NORMALS = {
    "pcd": ("normal_x", "normal_y", "normal_z"),
    **dict.fromkeys(("ply", "npz", "xyzn"), ("nx", "ny", "nz")),
}
"""Names of normals by format."""
_NAMES = {
    "e57": ("colorRed", "colorGreen", "colorBlue"),
    **dict.fromkeys(("ply", "las", "csv", "pts", "ptx", "npz", "xyzrgb"), ("red", "green", "blue")),
}
_OF_CLOUDCOMPARE = "scalar_"
"""Prefix that CloudCompare puts before the names of columns."""
_WIDE = ("las", "csv")
"""Formats that hold colours of 16 bits."""
_LAS_STEP = 256
"""LAS stretches a colour of 8 bits to 16 by this factor."""


def plain_name(name: str) -> str:
    """The name of a column as others write it: ``intensity`` for ``scalar_Intensity``."""
    return name.lower().removeprefix(_OF_CLOUDCOMPARE)


def renamed(frame: LidarFrame, name: str) -> LidarFrame:
    """The frame with colours and normals as another format than its own names them.

    Colours have 8 bits in all formats but LAS and CSV. The fields stay as they are where there are
    none, or where the format has no names for them. LAS has whole intensities beside a reflectance,
    which is the frame's intensity: they get a name of their own, or go if they say nothing.
    """
    if frame.format is not None and frame.format.name == name:
        return frame
    fields = dict(frame.fields)
    if frame.intensity is not None and "intensity" in fields:
        second = fields.pop("intensity")
        if second.any():
            fields["las_intensity"] = second
    _rename_normals(fields, name)
    found = _find_colors(fields)
    if found is not None and (name == "pcd" or name in _NAMES):
        taken, colors = found
        kept = {key: values for key, values in fields.items() if key not in taken}
        fields = kept | _named_colors(colors, name)
    return frame.replace(fields=fields)


def color_names(frame: LidarFrame, name: str) -> tuple[str, ...]:
    """The fields of a renamed frame that hold its colours; empty: it has none."""
    names = _NAMES.get(name, ())
    return names if names and all(each in frame.fields for each in names) else ()


def _rename_normals(fields: dict[str, NDArray[Any]], name: str) -> None:
    wanted = NORMALS.get(name)
    for names in NORMALS.values():
        if wanted is not None and names != wanted and all(each in fields for each in names):
            # Open3D takes those of 64 bits in PCD for 0.
            taken = [fields.pop(each).astype(np.float32) for each in names]
            fields |= dict(zip(wanted, taken, strict=True))


def _find_colors(
    fields: Mapping[str, NDArray[Any]],
) -> tuple[Sequence[str], NDArray[Any]] | None:
    """The names of the fields that hold colours, and the colours, (N, 3), of 8 or 16 bits."""
    by_plain = {plain_name(name): name for name in fields}
    for names in (*_COLORS, *_UNNAMED):
        if not all(name in by_plain for name in names):
            continue
        taken = [by_plain[name] for name in names]
        if names in _UNNAMED and taken[-1] != list(fields)[-1]:
            continue
        most = 255 if len(names[0]) < 3 else 65535  # r, or a column without a name, may be anything
        colors = _as_colors([fields[name] for name in taken], most)
        if colors is not None:
            return taken, colors
    for name in _PACKED:
        values = fields.get(by_plain.get(name, name))
        if values is not None and (colors := _unpacked(values)) is not None:
            return [by_plain[name]], colors
    return None


def _as_colors(columns: Sequence[NDArray[Any]], most: int) -> NDArray[Any] | None:
    """Columns of whole numbers from 0 to ``most``; None: they are no colours.

    Numbers of 16 bits of which none is above 255 are those of 8 that were not stretched.
    """
    if any(values.ndim != 1 or values.dtype.kind not in "iuf" for values in columns):
        return None
    values = np.column_stack(columns)
    if most > 255 and _are_shares(values):  # Open3D's, and those of renderers
        return np.rint(values * 255.0).astype(np.uint8)
    if not bool((np.isfinite(values) & (values == np.rint(values)) & (values >= 0)).all()):
        return None
    largest = values.max(initial=0)
    if largest > most:
        return None
    return values.astype(np.uint8 if largest <= 255 else np.uint16)


def _are_shares(values: NDArray[Any]) -> bool:
    """Whether colours are numbers from 0 to 1, not all of them whole."""
    if values.dtype.kind != "f" or not bool(((values >= 0.0) & (values <= 1.0)).all()):
        return False
    return bool((values != np.rint(values)).any())


def _unpacked(values: NDArray[Any]) -> NDArray[np.uint8] | None:
    if values.ndim == 2 and values.shape[1] in (3, 4) and values.dtype == np.uint8:
        return np.ascontiguousarray(values[:, :3])
    if values.ndim != 1 or values.dtype.kind not in "iuf" or values.dtype.itemsize != 4:
        return None
    bits = np.ascontiguousarray(values).view(np.uint32)
    return np.column_stack([bits >> shift & 255 for shift in (16, 8, 0)]).astype(np.uint8)


def _named_colors(colors: NDArray[Any], name: str) -> dict[str, NDArray[Any]]:
    is_wide = colors.dtype == np.uint16
    if is_wide and name not in _WIDE:
        colors = (colors // _LAS_STEP).astype(np.uint8)
    if not is_wide and name == "las":
        colors = colors.astype(np.uint16) * _LAS_STEP
    if name == "xyzrgb":
        shares = colors / 255.0
        return {each: np.ascontiguousarray(shares[:, i]) for i, each in enumerate(_NAMES[name])}
    if name == "pcd":
        red, green, blue = colors.astype(np.uint32).T
        return {"rgb": (red << 16 | green << 8 | blue).view(np.float32)}
    return {each: np.ascontiguousarray(colors[:, i]) for i, each in enumerate(_NAMES[name])}
