"""Scans in archives of NumPy arrays, one array per quantity, such as Open3D's point clouds."""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import os
import warnings
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.errors import Error, FormatError
from manip3d.io import _scan_npy
from manip3d.io._files import atomic_path, bytes_below, open_regular
from manip3d.io._limits import check_points
from manip3d.io._npy_headers import MAX_HEADER, read_npy_header
from manip3d.io._scan_tables import (
    Table,
    frame_of_table,
    general_fields,
    refuse_expansion,
    stored_coordinates,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from manip3d.lidar import LidarFrame

_POINTS = ("positions", "points", "xyz", "pcloud_points")
"""Names of the coordinates: of Open3D's tensor and legacy point clouds, of converters for ROS, of
the data set A2D2."""
_MAX_SIDE = 8
"""Largest number of rows or of columns of an array that is no image, such as a pose."""
_PREFIX = "pcloud_attr."  # before the names of A2D2's other arrays
_TRIPLES = {"colors": ("red", "green", "blue"), "normals": ("nx", "ny", "nz")}
"""Names of the three columns of Open3D's arrays ``colors`` and ``normals``."""


def is_npz_scan(path: str | os.PathLike[str]) -> bool:
    """Return whether an archive is a scan and no depth image.

    It is a scan if an array has one of the names of coordinates, or, beside no image, if three
    arrays of one length are x, y and z, or if a single array, of whatever name, holds points.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            arrays = _arrays(archive)
            if any(name in arrays for name in _POINTS):
                return True
            if len(arrays) == 1:
                return _scan_npy.is_scan(_head(archive, *arrays.values()))
            heads = {name: _head(archive, entry) for name, entry in arrays.items()}
            return _has_columns(heads) or _only_points(heads) is not None
    except OSError:
        raise
    except Exception:  # zipfile and zlib raise various types for damaged files
        return False


def read(path: Path, limit: int) -> LidarFrame:
    """Read a scan, see `manip3d.io.read_scan`."""
    return frame_of_table(read_table(path, limit), origin=None)


def read_table(path: Path, limit: int) -> Table:
    """Read all points of an archive, including those that were not measured.

    Raises
    ------
    FormatError
        The archive is damaged, or holds no scan.
    """
    name = str(path)
    try:
        data = bytes_below(path, limit)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            arrays = _arrays(archive)
            claimed = sum(entry.file_size for entry in arrays.values())
            refuse_expansion(claimed, len(data), limit, "")
            members = {key: archive.read(entry) for key, entry in arrays.items()}
        key = next((key for key in _POINTS if key in members), None)
        if key is None and len(members) == 1:
            return _scan_npy.table_of(next(iter(members.values())), name)
        if key is None and _has_columns(members):
            return _table_of_columns(members, name)
        if key is None:
            key = _only_points(members)
        if key is None:
            others = ", ".join(sorted(members)[:20]) or "none"
            raise FormatError(
                f"expected an array named {' or '.join(_POINTS)}, or arrays x, y and z of one "
                f"length, or a single one of points, beside no image, got {others}"
            )
        if _scan_npy.has_names(members[key]):  # pyntcloud writes all columns in one array
            return _scan_npy.table_of(members[key], name)
        points = _array(members[key])
        names = _scan_npy.column_names(points.shape, points.dtype)
        if not names:
            raise FormatError(
                f"{key}: expected (N, 3) or (H, W, 3) numbers, or more columns, got "
                f"{points.dtype} {points.shape}"
            )
        if len(members) == 1 and len(names) > len("xyz"):
            return _scan_npy.table_of(members[key], name)
        del members[key]
        sides = points.shape[:-1]
        points = points.reshape(-1, len(names))
        check_points(len(points), "")
    except FormatError as error:
        raise FormatError(error.reason, file=name, byte_offset=error.byte_offset) from error
    except (OSError, Error):
        raise
    except Exception as error:  # zipfile and zlib raise various types for damaged files
        reason = f"damaged .npz: {str(error) or type(error).__name__}"
        raise FormatError(reason, file=name) from error
    columns: dict[str, NDArray[Any]] = dict(zip(names, points.T, strict=True))
    found = _other_columns(members, sides, name)
    # An array of its own tells more than a column behind the coordinates.
    unnamed = set(names[3:]) - found.keys()
    columns |= {each: v for each, v in found.items() if each not in names[:3]}
    rest = [each for each in names if each in unnamed]
    header = {"pairs": _scan_npy.pairs_of(sides), "unnamed": rest}
    return Table("npz", columns, name, header=header)


def _head(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    with archive.open(entry) as member:
        return member.read(MAX_HEADER)


def _has_columns(members: Mapping[str, bytes]) -> bool:
    """Return whether x, y and z are arrays of one number for each point, beside no image.

    Axes of an image or of a volume have these names, too.
    """
    if not set("xyz") <= members.keys():
        return False
    axes = [read_npy_header(members[axis][:MAX_HEADER])[0] for axis in "xyz"]
    if any(len(shape) != 1 and shape[1:] != (1,) for shape in axes):
        return False
    points = axes[0][0]
    if any(shape[0] != points for shape in axes):
        return False
    shapes = _shapes(members)
    # An array of as many rows has several numbers for each point.
    has_image = any(_is_image(shape) and shape[:-1] != (points,) for shape in shapes.values())
    return not has_image and not _has_depths(shapes, points)


def _only_points(members: Mapping[str, bytes]) -> str | None:
    """Return the name of the array of points among arrays that are no images.

    It is None if there is none, or if it is ambiguous: the range images of two returns, for
    example, are two such arrays, and the points beside a depth image may be its calibration.
    """
    shapes = _shapes(members)
    found = [
        name
        for name in shapes
        if not _scan_npy.has_names(members[name]) and _scan_npy.is_scan(members[name])
    ]
    if len(found) != 1:
        return None
    points = shapes.pop(found[0])[0]
    if found == ["depth"] or _has_depths(shapes, points) or any(map(_is_image, shapes.values())):
        return None
    return found[0]


def _shapes(members: Mapping[str, bytes]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays of numbers; those of Python objects are left out."""
    shapes = {}
    for name, data in members.items():
        with contextlib.suppress(FormatError):
            shapes[name] = read_npy_header(data)[0]
    return shapes


def _is_image(shape: tuple[int, ...]) -> bool:
    """Return whether two sides of an array are those of an image, wherever its channels are."""
    return len(shape) >= 2 and sorted(shape)[-2] > _MAX_SIDE


def _has_depths(shapes: Mapping[str, tuple[int, ...]], points: int) -> bool:
    """Return whether there is an array named depth that has not one number for each point."""
    return shapes.get("depth", (points,)) not in ((points,), (points, 1))


def _table_of_columns(members: Mapping[str, bytes], name: str) -> Table:
    """Return the table of an archive with one array for each column, among them x, y and z.

    Raises
    ------
    FormatError
        The coordinates are no numbers.
    """
    axes = {axis: _array(members[axis]) for axis in "xyz"}
    points = len(axes["x"])
    columns: dict[str, NDArray[Any]] = {}
    for axis, values in axes.items():
        columns |= _columns_of(axis, values, points)
    if columns.keys() != axes.keys():
        shapes = ", ".join(f"{each.dtype} {each.shape}" for each in axes.values())
        raise FormatError(f"x, y, z: expected as many numbers of each, got {shapes}")
    check_points(points, "")
    others = {key: data for key, data in members.items() if key not in axes}
    columns |= _other_columns(others, (points,), name)
    return Table("npz", columns, name, header={"pairs": (), "unnamed": []})


def _other_columns(
    members: Mapping[str, bytes], sides: tuple[int, ...], name: str
) -> dict[str, NDArray[Any]]:
    """Return the columns in the arrays beside the coordinates; warn of arrays that hold none."""
    points = math.prod(sides)
    columns: dict[str, NDArray[Any]] = {}
    gone = []
    for other, member in members.items():
        try:
            values = _by_points(_array(member), sides)
            found = _columns_of(other.removeprefix(_PREFIX), values, points)
        except FormatError:  # the array holds Python objects, or is damaged
            found = {}
        gone += [] if found else [other]
        columns |= {each: v for each, v in found.items() if each not in columns}
    if gone:
        warnings.warn(
            f"{name}: arrays without numbers for each of {points} points are left out: "
            f"{', '.join(sorted(gone))}",
            stacklevel=caller_level(),
        )
    return columns


def _by_points(values: NDArray[Any], sides: tuple[int, ...]) -> NDArray[Any]:
    """Return the values of an organised cloud's points row by row; other arrays unchanged."""
    if len(sides) == 2 and values.shape[:2] == sides:
        return values.reshape(math.prod(sides), *values.shape[2:])
    return values


def write(frame: LidarFrame, path: Path) -> None:
    """Write a scan as a tensor point cloud of Open3D, with an array (N, k) for each quantity."""
    arrays: dict[str, NDArray[Any]] = {"positions": stored_coordinates(frame, "npz")}
    if frame.intensity is not None:
        arrays["intensity"] = frame.intensity[:, None]
    columns = general_fields(frame)
    for name, triple in _TRIPLES.items():
        if all(each in columns for each in triple):
            arrays[name] = np.column_stack([columns.pop(each) for each in triple])
    names = _free_names(columns, arrays.keys(), path)
    arrays |= {names[name]: values[:, None] for name, values in columns.items()}
    with atomic_path(path) as local, local.open("wb") as file:
        # Written to memory first, because the error for a full disk would not name the cause.
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w") as archive:  # np.savez refuses an array named "file"
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.ascontiguousarray(array))
        file.write(content.getbuffer())


def _free_names(columns: Iterable[str], taken: Iterable[str], path: Path) -> dict[str, str]:
    """Return the columns' names in the archive; those that other arrays have get a new one."""
    used = {*columns, *taken}
    names = {name: name for name in columns}
    for name in names.keys() & {*taken}:
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        names[name] = next(free for free in numbered if free not in used)
    if renamed := [f"{name} as {free}" for name, free in names.items() if free != name]:
        warnings.warn(
            f"{path}: .npz holds other arrays under the names of columns; written as: "
            + ", ".join(renamed),
            stacklevel=caller_level(),
        )
    return names


def _arrays(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    return {
        entry.filename.removesuffix(".npy"): entry
        for entry in archive.infolist()
        if entry.filename.endswith(".npy")
    }


def _array(data: bytes) -> NDArray[Any]:
    shape, is_fortran, dtype, start = read_npy_header(data)
    if any(side < 0 for side in shape):
        raise FormatError(f"expected a shape, got {shape}")
    count = 1
    for side in shape:  # in Python's integers, because NumPy's could overflow
        count *= side
    if len(data) - start < count * dtype.itemsize:
        raise FormatError(
            f"expected {count * dtype.itemsize} bytes of numbers, got {len(data) - start}"
        )
    values = np.frombuffer(data, dtype, count, start)
    values = values.reshape(shape, order="F" if is_fortran else "C")
    return values.astype(dtype.newbyteorder("="))


def _columns_of(name: str, values: NDArray[Any], num_points: int) -> dict[str, NDArray[Any]]:
    """Return the columns in an array (N,) or (N, k) of numbers or bools; empty for others."""
    if values.dtype.kind == "b":
        values = values.astype(np.uint8)
    if values.dtype.kind not in "iuf" or values.ndim not in (1, 2) or len(values) != num_points:
        return {}
    if values.shape[1:] == (0,):
        return {}
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    triple = _TRIPLES.get(name)
    if triple is None or values.shape != (num_points, 3):
        return {name: values}
    if name == "colors" and values.dtype.kind == "f" and values.max(initial=0.0) <= 1.0:
        values = np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
    return dict(zip(triple, values.T, strict=True))
