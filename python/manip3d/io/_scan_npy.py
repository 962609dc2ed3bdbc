"""Scans in NumPy arrays: rows or pixels of x, y, z, intensity and more, or named columns."""

from __future__ import annotations

import io
import math
import os
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.errors import FormatError
from manip3d.io._files import atomic_path, bytes_below, open_regular
from manip3d.io._limits import check_points
from manip3d.io._npy_headers import MAX_HEADER, read_npy_header
from manip3d.io._scan_tables import (
    Column,
    Table,
    frame_of_table,
    grid_rows,
    kept_grid,
    kind_of_coordinates,
)
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_MIN, _MAX = 3, 8
"""Number of values per point; no depth image is that narrow."""
_MIN_SIDE = 2
"""Smallest number of rows and of columns of an organised cloud."""
_NAMES = ("x", "y", "z", "intensity")


def is_npy_scan(path: str | os.PathLike[str]) -> bool:
    """Return whether an array is a scan and no depth image, by its shape or column names.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    with open_regular(path) as file:
        return is_scan(file.read(MAX_HEADER))


def is_scan(head: bytes) -> bool:
    """Return whether an array file with these first bytes is a scan."""
    try:
        shape, _, dtype, _ = read_npy_header(head)
    except FormatError:
        return False
    is_list = len(shape) == 2 and shape[0] > _MAX
    is_image = len(shape) == 3 and min(shape[:2]) >= _MIN_SIDE
    is_narrow = (is_list or is_image) and _MIN <= shape[-1] <= _MAX
    # Whole numbers may be millimetres (Azure Kinect); those of one byte are colours.
    is_whole = is_image and dtype.kind in "iu" and dtype.itemsize > 1
    return dtype.names is not None or (is_narrow and (dtype.kind == "f" or is_whole))


def has_names(data: bytes) -> bool:
    """Return whether the array is a structured one, with named columns.

    Raises
    ------
    FormatError
        The bytes are no array file.
    """
    return read_npy_header(data)[2].names is not None


def read(path: Path, limit: int) -> LidarFrame:
    """Read a scan, see `manip3d.io.read_scan`."""
    return frame_of_table(read_table(path, limit), origin=None)


def read_table(path: Path, limit: int) -> Table:
    """Read all points of an array file, including those that were not measured.

    Raises
    ------
    FormatError
        The file is damaged, or holds no scan.
    """
    return table_of(bytes_below(path, limit), str(path))


def table_of(data: bytes, name: str) -> Table:
    """Return all points in the bytes of an array file, row by row; ``name`` is for errors.

    Raises
    ------
    FormatError
        The array is no scan.
    """
    try:
        shape, is_fortran, dtype, start = read_npy_header(data)
        if any(side < 0 for side in shape):
            raise FormatError(f"expected a shape, got {shape}", byte_offset=0)
        sides = shape if dtype.names is not None else shape[:-1]
        check_points(math.prod(sides), "")
        layout = _layout(shape, dtype)
        count = math.prod(shape)
        if len(data) - start < count * dtype.itemsize:
            raise FormatError(
                f"expected {count * dtype.itemsize} bytes of numbers, got {len(data) - start}",
                byte_offset=start,
            )
    except FormatError as error:
        raise FormatError(error.reason, file=name, byte_offset=error.byte_offset) from error
    values = np.frombuffer(data, dtype, count, start)
    values = values.reshape(shape, order="F" if is_fortran else "C")
    if dtype.names is None:
        by_point = values.reshape(-1, shape[-1])
        columns = {column[0]: by_point[:, i] for i, column in enumerate(layout)}
    else:
        flat = values.ravel()
        columns = {column[0]: flat[column[0]] for column in layout}
        if gone := [column for column in dtype.names if column not in columns]:
            warnings.warn(
                f"{name}: columns that hold no numbers are left out: {', '.join(gone)}",
                stacklevel=caller_level(),
            )
    native = {key: v.astype(v.dtype.newbyteorder("=")) for key, v in columns.items()}
    unnamed = list(columns)[3:] if dtype.names is None else []
    header = {"plain": dtype.names is None, "pairs": pairs_of(sides), "unnamed": unnamed}
    return Table("npy", native, name, layout, header)


def pairs_of(sides: tuple[int, ...]) -> tuple[tuple[str, str], ...]:
    """Return height and width of an organised cloud as entries of a PCD header; else empty."""
    if len(sides) != 2:
        return ()
    return ("height", str(sides[0])), ("width", str(sides[1]))


def write(frame: LidarFrame, path: Path) -> None:
    """Write a scan in its own layout if it was read from .npy, else rows of x, y, z, intensity.

    The points of an organised cloud are written as its pixels.
    """
    layout = frame.format
    if layout is None or layout.name != "npy":
        names = _NAMES if frame.intensity is not None else _NAMES[:3]
        kind = kind_of_coordinates(frame, "npy")
        layout = ScanFormat("npy", tuple((n, kind, 1) for n in names), {"plain": True})
    rows = grid_rows(frame, layout)
    sides = kept_grid(frame, layout) or (len(rows),)
    if layout.header["plain"]:
        array: NDArray[Any] = rows.view(layout.columns[0][1]).reshape(*sides, len(layout.columns))
    else:
        named = [(c[0], c[1]) if c[2] == 1 else (c[0], c[1], (c[2],)) for c in layout.columns]
        array = rows.view(np.dtype(named)).reshape(sides)
    with atomic_path(path) as local, local.open("wb") as file:
        # Written to memory first, because NumPy's error for a full disk does not name the cause.
        content = io.BytesIO()
        np.save(content, array, allow_pickle=False)
        file.write(content.getbuffer())


def _layout(shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[Column, ...]:
    """Return the columns of an array; those of a plain one begin with x, y and z."""
    if dtype.names is not None:
        assert dtype.fields is not None
        found = [(name, *_kind(dtype.fields[name][0])) for name in dtype.names]
        return tuple(column for column in found if column[2] > 0)
    names = column_names(shape, dtype)
    if not names:
        raise FormatError(
            f"expected (N, {_MIN}) to (N, {_MAX}) numbers, (H, W, {_MIN}) and more of the "
            f"pixels of an image, or a structured array, got {dtype} {shape}"
        )
    return tuple((name, _kind(dtype)[0], 1) for name in names)


def column_names(shape: tuple[int, ...], dtype: np.dtype[Any]) -> list[str]:
    """Return the names of the columns of an array without names; empty if it holds no points."""
    if len(shape) not in (2, 3) or not _MIN <= shape[-1] <= _MAX or dtype.kind not in "iuf":
        return []
    names = [*_NAMES, *(f"column_{i}" for i in range(5, _MAX + 1))]
    return names[: shape[-1]]


def _kind(dtype: np.dtype[Any]) -> tuple[str, int]:
    """Return the little-endian type name of a field, and its number of values; 0: not numeric."""
    base, shape = dtype.base, dtype.shape
    if base.kind not in "iufb" or len(shape) > 1:
        return "", 0
    if base.kind == "b":
        return "|b1", shape[0] if shape else 1
    return f"<{base.kind}{base.itemsize}", shape[0] if shape else 1
