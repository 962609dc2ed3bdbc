"""Reading and writing of scans; `manip3d.io` shows the functions."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from numpy.typing import NDArray

SCAN_SUFFIXES: tuple[str, ...] = tuple(_core.point_suffixes())
"""Suffixes that `read_scan` and `write_scan` know."""
_COMPRESSED = (".gz", ".xz")
_INTENSITY = ("intensity", "reflectance", "reflectivity", "remission", "i")
_RING = ("ring", "channel", "laser_id")


def scan_suffix(path: str | os.PathLike[str]) -> str:
    """The suffix that tells the format: lower case, without a compression's."""
    name = PurePath(os.fspath(path))
    return PurePath(name.stem if name.suffix in _COMPRESSED else name.name).suffix.lower()


def byte_limit(max_bytes: int | None) -> int:
    """``max_bytes`` as the core takes it: 0 means the limit of the ratio."""
    if max_bytes is None:
        return 0
    if not max_bytes > 0:
        raise InputError(f"max_bytes: expected > 0, got {max_bytes}")
    return int(max_bytes)


def read_scan(path: str | os.PathLike[str], *, max_bytes: int | None = None) -> LidarFrame:
    """Read a scan: one of `SCAN_SUFFIXES`, alone or followed by ``.gz`` or ``.xz``.

    Parameters
    ----------
    path : path-like
    max_bytes : int, optional
        The most uncompressed bytes to read. Without it compressed files are refused past 64 MiB
        where they expand more than 200 times.

    Returns
    -------
    LidarFrame
        KITTI's ``.bin``: metres, x forward, y left, z up, the scanner at the origin.

    Raises
    ------
    FormatError
        The file is damaged or hostile; names the file and the line or byte.
    InputError
        No format has that suffix.
    OSError
        `FileNotFoundError` and the like.
    """
    return _read_table(path, byte_limit(max_bytes))


def write_scan(frame: LidarFrame, path: str | os.PathLike[str]) -> None:
    """Write a scan in the format that the suffix says, then ``.gz`` or ``.xz`` if wanted.

    The file appears whole or not at all. A scan written to the format that it was read from keeps
    the file's columns, their types and their order; KITTI's ``.bin`` holds x, y, z and intensity
    (0 where the scan has none) and nothing else.

    Raises
    ------
    InputError
        Unknown suffix.
    OSError
        The operating system refused; the old file is whole.
    """
    name = os.fspath(path)
    columns = (("x", "<f4", 1), ("y", "<f4", 1), ("z", "<f4", 1), ("intensity", "<f4", 1))
    _core.write_points(
        os.fsencode(name),
        [list(column) for column in columns],
        frame.num_points,
        _packed(frame, columns).view(np.int8),
    )


def _dtype(columns: tuple[tuple[str, str, int], ...]) -> np.dtype[Any]:
    # Files repeat names; NumPy does not let them: the place keeps them apart.
    return np.dtype(
        [
            (f"{i} {name}", kind, (count,)) if count != 1 else (f"{i} {name}", kind)
            for i, (name, kind, count) in enumerate(columns)
        ]
    )


def _read_table(path: str | os.PathLike[str], limit: int) -> LidarFrame:
    name = os.fspath(path)
    kind, fields, num_points, raw = _core.read_points(os.fsencode(name), limit)
    columns = tuple((str(a), str(b), int(c)) for a, b, c in fields)
    dtype = _dtype(columns)
    table = raw.view(dtype) if dtype.itemsize else np.empty(num_points, dtype)
    by_name: dict[str, NDArray[Any]] = {}
    for i, (column, _, _) in enumerate(columns):
        by_name.setdefault(column, table[f"{i} {column}"])
    points = np.column_stack([by_name.pop(axis) for axis in "xyz"])
    intensity = next((by_name.pop(key) for key in _INTENSITY if key in by_name), None)
    return LidarFrame(
        points=points,
        intensity=None if intensity is None else np.ascontiguousarray(intensity, np.float32),
        origin=(0.0, 0.0, 0.0),
        source=name,
        fields={key: np.ascontiguousarray(values) for key, values in by_name.items()},
        format=ScanFormat(kind, columns),
    )


def _packed(frame: LidarFrame, columns: tuple[tuple[str, str, int], ...]) -> NDArray[Any]:
    table = np.zeros(frame.num_points, _dtype(columns))
    for i, (column, _, _) in enumerate(columns):
        target = table[f"{i} {column}"]
        if column in ("x", "y", "z"):
            target[:] = frame.points[:, "xyz".index(column)]
        elif column in _INTENSITY and frame.intensity is not None:
            target[:] = frame.intensity
    return table


def scan_paths(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """The scans of a folder, in the order of their names."""
    yield from sorted(p for p in Path(folder).iterdir() if scan_suffix(p) in SCAN_SUFFIXES)
