"""Scans in tables of points (KITTI, PCD, PLY, 3DTK, text), and functions shared by all formats."""

from __future__ import annotations

import logging
import math
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.callers import caller_level
from manip3d._util.linear import inverse, moved, product
from manip3d._util.regular_files import over_max_bytes
from manip3d._util.text_files import text_of
from manip3d.errors import FormatError
from manip3d.io._limits import check_points
from manip3d.io._scan_colors import NORMALS, color_names, plain_name
from manip3d.lidar import LidarFrame, ScanFormat, map_shift

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_logger = logging.getLogger("manip3d")

Column = tuple[str, str, int]
"""Name, NumPy type, values per point."""

TABLE_SUFFIXES: tuple[str, ...] = tuple(_core.point_suffixes())
_COMPRESSED = (".gz", ".xz")
_TEXT = ("xyz", "xyzi", "xyzn", "xyzrgb", "asc", "pts", "txt", "csv")
_NAMED_BY_SUFFIX = {"xyzn": ("nx", "ny", "nz"), "xyzrgb": ("red", "green", "blue")}
"""Columns after x, y and z in a text file without column names, as Open3D writes them."""
_WITH_FOURTH = (4, 7)
"""Numbers of columns of a ``.3d`` file whose fourth is the intensity: 3DTK's uosr and uos_rrgb."""
_UNSTATED = (*_TEXT, "npy", "npz")
"""Formats that state neither the scanner's position nor which columns are integers."""
_WITH_DOUBLES = (*_UNSTATED, "ply", "pcd", "las", "ptx", "ros")
"""Formats that can hold map coordinates to the millimetre."""
_POSED = ("e57", "ptx")
"""Formats that hold the pose of the scanner."""
_BARE = ("kitti", "nuscenes")
_WITH_GRID = (".pcd", ".npy")
"""Suffixes of the formats that hold the grid of an organised cloud."""
_AT_SCANNER = (*_BARE, "3dtk")
"""Formats whose points are relative to the scanner, without a place for its position."""
_LARGEST = 1e9
"""Largest number in a scan, metres or otherwise. If 64-bit numbers are read as 32-bit ones, some
are larger."""
_MOST_LARGE = 0.01  # share of such numbers in a scan with damaged points
_ROW_SIZES = range(3, 9)  # numbers of a point
_BLOCKS, _BLOCK = 24, 840  # compared numbers; whole rows of each of these sizes
_MIN_NUMBERS, _LEVELS = 400, 8
_TOLD = 0.07
"""Mean square contingency (0: independent). Places within rows tell 0.15 or more, and parts of a
file of rows may tell 1; in planes, places tell 0.04 or less, and parts 0.14 or more. One scan of an
HDL-32E with a fifth plane tells 0.09 by its places, and is taken for rows."""
_AXIS_UNIT = re.compile(r"(?i)(?<![a-z_])[xyz]1? ?[(\[]([^)\]]*)[)\]]")
_LENGTHS = {"mm": 1e-3, "millimeters": 1e-3, "cm": 1e-2, "centimeters": 1e-2}  # metres
_FEET = ("ft", "feet", "foot", "us-ft", "ftus")
_FAR = 8192.0
"""Metres; beyond this distance from 0, the spacing of float32 is about 1 mm (2**-10 m) or more."""
_MAX_OF = (0.1, 0.5, 0.9)
"""Quantiles of coordinates: the range of 80 % of the points, and its middle."""
_INTENSITY = ("intensity", "reflectance", "reflectivity", "remission", "i")
_RING = ("ring", "channel", "laser_id")
_SAME = 1e-6
"""Absolute (metres) and relative tolerance between a coordinate in 32 and in 64 bits."""

# From metres with x forward, y left, z up to 3DTK's centimetres with x right, y up, z forward
# (left-handed).
_THREE_DTK = 100.0 * np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


def scan_suffix(path: str | os.PathLike[str]) -> str:
    """Return the suffix that determines the format, in lower case, ignoring ``.gz`` and ``.xz``."""
    name = PurePath(os.fspath(path))
    plain = PurePath(name.stem if name.suffix in _COMPRESSED else name.name)
    last_two = "".join(plain.suffixes[-2:]).lower()
    return last_two if last_two in TABLE_SUFFIXES else plain.suffix.lower()


def scan_stem(path: str | os.PathLike[str]) -> str:
    """Return the file name without `scan_suffix`, ``.gz`` and ``.xz``."""
    name = PurePath(os.fspath(path))
    plain = name.stem if name.suffix in _COMPRESSED else name.name
    return plain[: len(plain) - len(scan_suffix(name))]


def refuse_expansion(claimed: int, stored: int, limit: int, file: str) -> None:
    """Refuse a compressed file that claims to hold too many bytes; see `read_scan`.

    Raises
    ------
    FormatError
        ``claimed`` is more than ``limit``; or, if that is 0, more than 64 MiB and more than 200
        times ``stored``.
    """
    if limit and claimed > limit:
        raise FormatError(over_max_bytes(limit), file=file)
    if not limit and claimed > 64 << 20 and claimed > 200 * stored:
        raise FormatError(
            f"{stored} bytes claim to hold {claimed}; set max_bytes to read them", file=file
        )


@dataclass(frozen=True)
class _Table:
    """Name of a table format, and the function that returns the layout of a new file."""

    name: str
    layout: Callable[[LidarFrame], ScanFormat]


def _dtype(columns: Sequence[Column]) -> np.dtype[Any]:
    # A file may repeat column names, which NumPy refuses; the index makes them unique.
    return np.dtype(
        [
            (f"{i} {name}", kind, (count,)) if count != 1 else (f"{i} {name}", kind)
            for i, (name, kind, count) in enumerate(columns)
        ]
    )


@dataclass
class Table:
    """Columns by name, with one value or one row of values per point, and their source."""

    kind: str
    columns: dict[str, NDArray[Any]]
    source: str
    layout: tuple[Column, ...] = ()
    header: dict[str, Any] = field(default_factory=dict)


def read_columns(
    path: str | os.PathLike[str], limit: int, look: Callable[[float], None] | None = None
) -> Table:
    """Read all rows of a file, including points that were not measured."""
    name = os.fspath(path)
    kind, fields, pairs, num_points, raw = _core.read_points(os.fsencode(name), limit, look)
    check_points(num_points, name)
    columns = tuple((str(a), str(b), int(c)) for a, b, c in fields)
    if (told := _NAMED_BY_SUFFIX.get(kind)) and [c[0] for c in columns[3:]] == ["c3", "c4", "c5"]:
        columns = (*columns[:3], *((name, "<f8", 1) for name in told))
    if kind == "3dtk" and len(columns) in _WITH_FOURTH:
        columns = (*columns[:3], ("intensity", "<f8", 1), *columns[4:])
    dtype = _dtype(columns)
    values = raw.view(dtype) if raw.size else np.empty(num_points, dtype)
    if kind in _BARE:
        _refuse_other_records(raw, name)
    header: dict[str, Any] = {"pairs": _without_unused_names(pairs, columns, name)}
    layout = _with_short_intensity(columns) if kind in _TEXT else columns
    return Table(kind, _columns(values, columns, name), name, layout, header)


def _without_unused_names(
    pairs: Sequence[tuple[Any, Any]], columns: Sequence[Column], file: str
) -> tuple[tuple[str, str], ...]:
    """Return a header's pairs; warn if a comment of a text file names columns without x, y, z."""
    found = tuple((str(a), str(b)) for a, b in pairs)
    if unused := dict(found).get("unused_names"):
        warnings.warn(
            f"{file}: its columns are read as {', '.join(column[0] for column in columns)}; the "
            f"comment before the points names others: {unused[:200]}",
            stacklevel=caller_level(),
        )
    return tuple(pair for pair in found if pair[0] != "unused_names")


def _refuse_other_records(raw: NDArray[np.uint8], file: str) -> None:
    """Refuse a file without a header that does not hold 32-bit numbers, point by point.

    Raises
    ------
    FormatError
        Read as 32-bit numbers, some are too large for a scan, and read as 64-bit numbers, none is;
        a hundredth of the 32-bit numbers are too large; or all x come first, then all y.
    """
    single = raw.reshape(-1).view(np.float32)
    size = np.abs(single)
    if float(size.max(initial=0.0)) > _LARGEST:
        if raw.nbytes % np.dtype(np.float64).itemsize == 0:
            double = np.abs(raw.reshape(-1).view(np.float64))
            with np.errstate(invalid="ignore"):
                fits = (double == 0.0) | ((double > 1.0 / _LARGEST) & (double < _LARGEST))
            if fits.all():
                raise FormatError(
                    "numbers of 64 bits, expected 32: write it as float32, or as a .npy file",
                    file=file,
                )
        if np.count_nonzero(size > _LARGEST) > _MOST_LARGE * size.size:
            raise FormatError(
                f"expected x, y, z, ... as float32, got numbers above {_LARGEST:.0e}: not this "
                "layout (NCLT, for example, has 16-bit integers); write it as a .npy file",
                file=file,
            )
    if _are_planes(single):
        raise FormatError(
            "expected the points one after another, got all x first, then all y (rows of numbers, "
            "as in the Oxford RobotCar data): write it transposed",
            file=file,
        )


def _are_planes(numbers: NDArray[np.float32]) -> bool:
    """Return whether a file holds all x first, then all y, and so on.

    In rows of points, the place of a number within its row tells much about it: x, y, z and
    intensity differ. In planes it tells nothing, but the part of the file does. Zeros, such as
    those of points without a return, tell nothing in both.
    """
    size = numbers.size
    index = np.arange(size)
    if size > _BLOCKS * _BLOCK:
        start = np.linspace(0, size - _BLOCK, _BLOCKS).astype(np.int64) // _BLOCK * _BLOCK
        index = (start[:, None] + np.arange(_BLOCK)).reshape(-1)
    index = index[np.isfinite(numbers[index]) & (numbers[index] != 0.0)]
    if len(index) < _MIN_NUMBERS:
        return False
    values = numbers[index]
    if (np.diff(values) >= 0.0).all():  # a line of points, or planes of it
        return False
    level = np.searchsorted(np.quantile(values, np.arange(1, _LEVELS) / _LEVELS), values, "right")
    quarter = index * 4 // size
    by_place = max(_told(quarter * n + index % n, level, 4 * n, groups=4) for n in _ROW_SIZES)
    by_part = max(_told(index * n // size, level, n) for n in _ROW_SIZES)
    return by_place < _TOLD < by_part


def _told(
    place: NDArray[np.int64], level: NDArray[np.int64], num_places: int, *, groups: int = 1
) -> float:
    """Return how much places tell about levels: the mean square contingency, less its expectation.

    Consecutive places form ``groups`` of equal size; they are compared within their group.
    """
    counts = np.bincount(place * _LEVELS + level, minlength=num_places * _LEVELS)
    table = counts.reshape(groups, num_places // groups, _LEVELS).astype(np.float64)
    of_place, of_level = table.sum(axis=2, keepdims=True), table.sum(axis=1, keepdims=True)
    total = table.sum(axis=(1, 2), keepdims=True)
    expected = of_place * of_level / np.maximum(total, 1.0)
    apart = (table - expected) ** 2 / np.where(expected > 0.0, expected, 1.0)
    degrees = ((of_place > 0.0).sum(axis=1) - 1).clip(0) * ((of_level > 0.0).sum(axis=2) - 1).clip(
        0
    )
    return float(apart.sum() - degrees.sum()) / len(level)


def _length_of(header: dict[str, Any], file: str) -> float:
    """Return the metres of a text file's unit of length, from its names of x, y and z.

    Feet are not converted, because there are two: the unit is stated in the header, with a warning.
    """
    names = dict(header.get("pairs", ())).get("names", "")
    units = {unit.strip().lower() for unit in _AXIS_UNIT.findall(names)}
    unit = units.pop() if len(units) == 1 else ""
    if unit in _FEET:
        header["unit"] = "feet"
        warnings.warn(
            f"{file}: its coordinates are in feet; they are not converted, so that results which "
            "are said to be in metres are in feet",
            stacklevel=caller_level(),
        )
    return _LENGTHS.get(unit, 1.0)


def read_table(
    path: str | os.PathLike[str], limit: int, look: Callable[[float], None] | None = None
) -> LidarFrame:
    table = read_columns(path, limit, look)
    frame = frame_of_table(table, origin=_origin(table.kind, dict(table.header["pairs"])))
    if table.kind == "3dtk":
        table.header["pose"] = read_pose(Path(table.source))
    return frame


def _with_short_intensity(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return the columns of a text file with the intensity as float32, so that 0.1 stays 0.1."""
    own = [column[0] for column in columns]
    names = {**{plain_name(name): name for name in own}, **dict(zip(own, own, strict=True))}
    taken = next((names[name] for name in _INTENSITY if name in names), None)
    return tuple((name, "<f4" if name == taken else kind, n) for name, kind, n in columns)


def frame_of_table(
    table: Table,
    *,
    origin: tuple[float, float, float] | None,
    time_ns: int | None = None,
    to_file: NDArray[np.float64] | None = None,
) -> LidarFrame:
    """Return a table of points as a scan; points without coordinates are left out.

    They are NaN, or all three are infinite in a PCD, a PointCloud2 or an array. ``to_file`` is the
    transform to the file's coordinates; default: the one that suits these points.

    Raises
    ------
    FormatError
        x, y or z is missing, or a coordinate or intensity is not finite.
    """
    name, by_name = table.source, _by_plain_names(table.columns)
    missing = [axis for axis in "xyz" if axis not in by_name or by_name[axis].ndim != 1]
    if missing:
        raise FormatError(f"a scan has x, y and z; {', '.join(missing)} not found", file=name)
    measured = ~np.any([np.isnan(by_name[axis]) for axis in "xyz"], axis=0)
    if table.kind in ("pcd", "ros", "npy", "npz"):
        measured &= ~np.all([np.isinf(by_name[axis]) for axis in "xyz"], axis=0)
    num_dropped = int(measured.size - np.count_nonzero(measured))
    if num_dropped:
        by_name = {key: values[measured] for key, values in by_name.items()}
    stored = np.column_stack([by_name.pop(axis) for axis in "xyz"])
    if to_file is None:
        to_file = _stored_to_file(table.kind, stored)
        to_file[:3, :3] /= _length_of(table.header, name)
    layout = ScanFormat(table.kind, table.layout, table.header, to_file)
    points = measured_points(stored, layout, name)
    # Each call removes its column from `by_name`; the remaining columns become fields.
    intensity = _intensity(by_name, name)
    ring = _ring(by_name, table.kind, name)
    return LidarFrame(
        points=points,
        intensity=intensity,
        ring=ring,
        origin=_shifted_origin(origin, to_file),
        time_ns=time_ns,
        source=name,
        fields={key: np.ascontiguousarray(values) for key, values in by_name.items()},
        exact=exact_coordinates(stored, points),
        format=layout,
        num_dropped=num_dropped,
        file_rows=np.flatnonzero(measured) if num_dropped else None,
    )


def _stored_to_file(kind: str, stored: NDArray[Any]) -> NDArray[np.float64]:
    """Return the (4, 4) transform from the frame of the points to the file's coordinates.

    64-bit coordinates, such as those of a national grid, are shifted near zero, so that float32
    can hold them. 32-bit coordinates need no shift.
    """
    is_wide = kind in _UNSTATED or (kind in _WITH_DOUBLES and stored.dtype != np.float32)
    return near_zero(stored) if is_wide else _to_file(kind)


def _shifted_origin(
    origin: tuple[float, float, float] | None, to_file: NDArray[np.float64]
) -> tuple[float, float, float] | None:
    """Return the scanner's position in the frame of the points; None if it is not known.

    If the points were shifted, a position of (0, 0, 0) is unknown: PCD files with map coordinates
    have it as their viewpoint if the viewpoint is not known.
    """
    shift = to_file[:3, 3]
    if origin is None or not shift.any():
        return origin
    return tuple((np.array(origin) - shift).tolist()) if any(origin) else None


def _ring(by_name: dict[str, NDArray[Any]], kind: str, name: str) -> NDArray[Any] | None:
    """Remove and return the column with the numbers of the lasers; None without one.

    It is, in this order: a column of integers, except in text, which states no types; a column that
    must hold integers from 0 to 65535, because the format says so or states no types (others raise
    `FormatError`); a float column that holds integers.
    """
    ring = None if kind in _TEXT else _take(by_name, _RING, "iu")
    if ring is None and kind == "nuscenes":
        # Zeros fill the column, which the format has, of a scan whose lasers are not known.
        told = _whole(by_name, "ring", name)
        ring = told if told.any() else None
    if ring is None and kind in _UNSTATED:
        ring = next((_whole(by_name, key, name) for key in _RING if key in by_name), None)
    if ring is None:
        ring = next((_whole(by_name, k, name) for k in _RING if _is_whole(by_name.get(k))), None)
    return ring


def ring_name(names: Sequence[str]) -> str | None:
    """Return the name of the column with the lasers' numbers; None without one.

    Of several variants of a name the plain one counts, or else the first.
    """
    by_plain = {plain_name(name): name for name in reversed(names)} | {name: name for name in names}
    return next((by_plain[name] for name in _RING if name in by_plain), None)


def _columns(table: NDArray[Any], columns: Sequence[Column], file: str) -> dict[str, NDArray[Any]]:
    """Return the columns by name, without padding (PCD's ``_``); of equal names the first counts.

    Raises
    ------
    FormatError
        Two columns of one coordinate have different values, so that the right one is not known.
    """
    for axis in "xyz":
        named = [i for i, (name, _, count) in enumerate(columns) if name == axis and count > 0]
        for again in named[1:]:
            if not _are_same(table[f"{named[0]} {axis}"], table[f"{again} {axis}"]):
                raise FormatError(f"field {axis} is named twice", file=file)
    found: dict[str, NDArray[Any]] = {}
    for i, (column, _, count) in enumerate(columns):
        if column != "_" and count > 0:
            found.setdefault(column, table[f"{i} {column}"])
    return found


def _are_same(first: NDArray[Any], again: NDArray[Any]) -> bool:
    """Return whether two columns hold one coordinate in 32 and 64 bits, as VeloView writes it."""
    return first.shape == again.shape and np.allclose(first, again, _SAME, _SAME, equal_nan=True)


def _by_plain_names(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the columns; variants of known names (``Intensity``, ``x [m]``) get the plain name.

    Integer columns X, Y and Z are not renamed, because they are steps of an unknown size, as in
    LAS.
    """
    known = {*"xyz", *_INTENSITY, *_RING} - columns.keys()
    found: dict[str, NDArray[Any]] = {}
    for name, values in columns.items():
        plain = plain_name(name)
        is_known = plain in known - found.keys() and (
            plain not in "xyz" or values.dtype.kind == "f"
        )
        found[plain if is_known else name] = values
    return found


def _take(
    by_name: dict[str, NDArray[Any]], names: Sequence[str], kinds: str
) -> NDArray[Any] | None:
    for name in names:
        values = by_name.get(name)
        if values is not None and values.ndim == 1 and values.dtype.kind in kinds:
            return np.ascontiguousarray(by_name.pop(name))
    return None


def _whole(by_name: dict[str, NDArray[Any]], column: str, file: str) -> NDArray[np.uint16]:
    """Remove a column from ``by_name``, and return it as laser numbers (uint16).

    Raises
    ------
    FormatError
        A value is no integer from 0 to 65535.
    """
    values = by_name.pop(column)
    bad = np.flatnonzero((values != np.rint(values)) | (values < 0) | (values > 65535))
    if bad.size:
        raise FormatError(
            f"{column} of point {bad[0]}: expected a whole number from 0 to 65535, "
            f"got {values[bad[0]]}",
            file=file,
        )
    return values.astype(np.uint16)


def _is_whole(values: NDArray[Any] | None) -> bool:
    """Return whether a float column holds only integers from 0 to 65535."""
    if values is None or values.ndim != 1 or values.dtype.kind != "f" or not len(values):
        return False
    return bool(((values == np.rint(values)) & (values >= 0) & (values <= 65535)).all())


def _intensity(by_name: dict[str, NDArray[Any]], file: str) -> NDArray[np.float32] | None:
    """Remove and return the column of intensities; if some are NaN, it stays a field."""
    before = dict(by_name)
    column = _take(by_name, _INTENSITY, "fiu")
    if column is None:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        values = column.astype(np.float32)
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return values
    num_nan = np.count_nonzero(np.isnan(values))
    if num_nan == bad.size:
        by_name |= {key: before[key] for key in before.keys() - by_name.keys()}
        _logger.warning(
            "%s: %d of %d intensities are NaN: the scan has none, their column stays a field",
            file, num_nan, len(values),
        )  # fmt: skip
        return None
    raise FormatError(
        f"intensity of point {bad[0]}: expected a finite number, got {column[bad[0]]}; "
        f"{bad.size} of {len(values)} points have such a number",
        file=file,
    )


def _to_file(kind: str) -> NDArray[np.float64]:
    matrix = np.eye(4)
    if kind == "3dtk":
        matrix[:3, :3] = _THREE_DTK
    return matrix


def near_zero(stored: NDArray[Any]) -> NDArray[np.float64]:
    """Return a (4, 4) translation from points near 0 to coordinates far from 0, as in maps.

    It is the identity unless most points are far from 0 compared with the size of the scan. A scan
    in millimetres has large coordinates, too, but they are no larger than the scan is wide.
    """
    matrix = np.eye(4)
    if not len(stored):
        return matrix
    # The median ignores a few far outliers. Points too large for float32 are not shifted, so that
    # measured_points() refuses them with the coordinates of the file.
    farthest = np.abs(stored).max(axis=1)
    if np.median(farthest) > _FAR and farthest.max() <= np.finfo(np.float32).max:
        wide = stored.astype(np.float64, copy=False)
        low, middle, high = np.quantile(wide, _MAX_OF, axis=0, method="nearest")
        if np.abs(middle).max() > (high - low).max():
            matrix[:3, 3] = np.round(middle)
    return matrix


def map_coordinates(frame: LidarFrame, name: str) -> NDArray[np.float64] | None:
    """Return the map coordinates of a scan, for a file of another format.

    None if the scan was not read from map coordinates, or if the format cannot hold them.
    """
    if frame.format is None or name not in _WITH_DOUBLES:
        return None
    to_file = frame.format.to_file
    if not np.array_equal(to_file[:3, :3], np.eye(3)):
        return None
    if frame.exact is None:
        return frame.format.file_coordinates(frame.points) if to_file[:3, 3].any() else None
    is_far = to_file[:3, 3].any() or near_zero(frame.exact)[:3, 3].any()
    return frame.exact if is_far else None


def stored_coordinates(frame: LidarFrame, name: str) -> NDArray[Any]:
    """Return the coordinates for a file of a format: map coordinates if it can hold them."""
    if frame.format is not None and frame.format.name == name:
        if frame.exact is None and not frame.format.to_file[:3, 3].any():
            return frame.points
        own = frame.format.file_coordinates(frame.points)
        return own if frame.exact is None else frame.exact
    of_map = map_coordinates(frame, name)
    return frame.points if of_map is None else _as_decimals(of_map, frame)


def keeps_float32_only(frame: LidarFrame, suffix: str) -> bool:
    """Return whether a binary file of this suffix gets the points in single precision.

    That is the case if they were read from a file of another format and are near its origin, or if
    the format holds no doubles.
    """
    name = format_name(suffix)
    if name not in (*_BARE, "pcd", "ply"):
        return False
    is_own = frame.format is not None and frame.format.name == name
    return not is_own and map_coordinates(frame, name) is None


def loses_map_coordinates(frame: LidarFrame, suffix: str) -> bool:
    """Return whether map coordinates are lost in a file of this suffix, which gets shifted ones."""
    name = format_name(suffix)
    if frame.format is None or frame.format.name == name or name in (*_WITH_DOUBLES, "e57"):
        return False
    return bool(frame.format.to_file[:3, 3].any())


def lost_pose(frame: LidarFrame, suffix: str) -> NDArray[np.float64] | None:
    """Return the scanner's pose (4, 4) if its file states it and this suffix cannot.

    None if the scan has no pose, or the identity.
    """
    if frame.format is None or suffix.lstrip(".") in _POSED:
        return None
    pose = frame.format.header.get("pose")  # of E57, PTX and .3d
    return None if pose is None or np.array_equal(pose, np.eye(4)) else np.asarray(pose)


def states_wrong_origin(frame: LidarFrame, suffix: str) -> bool:
    """Return whether a file of this suffix says that the scanner, whose position is not known,
    stood at the origin.

    PCD says so, too, but not of map coordinates, see `_shifted_origin`.
    """
    if frame.origin is not None:
        return False
    if suffix == ".pcd":
        return map_coordinates(frame, "pcd") is None
    return suffix == ".ptx" or format_name(suffix) in _AT_SCANNER


def seen_from(coordinates: NDArray[Any], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return coordinates relative to a place, such as that of the scanner.

    Points at exactly (0, 0, 0) stay there, because they were not measured.
    """
    return np.where(coordinates.any(axis=1, keepdims=True), coordinates - place, 0.0)


def place_in_pose(frame: LidarFrame, suffix: str) -> NDArray[np.float64] | None:
    """Return the scanner's position in a frame if files of this suffix hold it in their pose.

    Their points are relative to it. None if the position is not known, or for other suffixes.
    """
    is_relative = suffix.lstrip(".") in _POSED and frame.origin is not None
    return np.array(frame.origin) if is_relative else None


def lost_origin(frame: LidarFrame, suffix: str) -> NDArray[np.float64] | None:
    """Return the scanner's position in the coordinates of a file of this suffix, if it is lost.

    None if the file states it, if it is not known, or if it is the origin.
    """
    name = format_name(suffix)
    if frame.origin is None or name in (*_POSED, "pcd"):
        return None
    shift = np.zeros(3) if loses_map_coordinates(frame, suffix) else map_shift(frame)
    place = np.array(frame.origin) + shift
    return place if place.any() else None


def measured_points(stored: NDArray[Any], layout: ScanFormat, file: str) -> NDArray[np.float32]:
    """Convert file coordinates to points of a frame: metres, manip3d's axes, near 0."""
    back = inverse(layout.to_file)
    same = np.array_equal(back, np.eye(4))
    metres = stored if same else moved(stored.astype(np.float64), back)
    with np.errstate(over="ignore"):
        points: NDArray[np.float32] = np.ascontiguousarray(metres, np.float32)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise FormatError(
            f"point {bad[0]}: expected coordinates that fit a float, got {stored[bad[0]].tolist()}",
            file=file,
        )
    return points


def exact_coordinates(
    stored: NDArray[Any], points: NDArray[np.float32]
) -> NDArray[np.float64] | None:
    """Return the file's coordinates as float64 if float32 points do not equal them, else None."""
    if stored.dtype == np.float32 or np.array_equal(stored, points):
        return None
    return np.ascontiguousarray(stored, np.float64)


def _origin(kind: str, header: Mapping[str, str]) -> tuple[float, float, float] | None:
    if kind == "ply" or kind in _TEXT:
        return None
    if kind == "pcd":
        x, y, z = map(float, header["viewpoint"].split()[:3])
        return x, y, z
    return 0.0, 0.0, 0.0


def _decimals(steps: Sequence[float], offsets: Sequence[float]) -> int | None:
    """Return the number of decimals that write all ``offset + n * step`` exactly; None: above 9."""
    numbers = np.array([*steps, *offsets], np.float64)
    for decimals in range(10):
        scaled = numbers * 10.0**decimals
        if (np.abs(scaled - np.rint(scaled)) <= 1e-6 * np.minimum(1.0, np.abs(scaled))).all():
            return decimals
    return None


def _as_decimals(coordinates: NDArray[np.float64], frame: LidarFrame) -> NDArray[np.float64]:
    """Round LAS coordinates, which are steps times a scale, to the decimal numbers they stand for.

    In 64 bits 111954 * 0.001 is 111.95400000000001. Points between two steps are not rounded.
    """
    if frame.format is None or frame.format.name != "las":
        return coordinates
    header = frame.format.header["las"]
    decimals = _decimals(header.scales, header.offsets)
    if decimals is None:
        return coordinates
    rounded = np.round(coordinates, decimals)
    is_step = np.abs(rounded - coordinates) <= 4.0 * np.spacing(np.abs(coordinates))
    return np.where(is_step, rounded, coordinates)


def packed_rows(frame: LidarFrame, layout: ScanFormat) -> NDArray[Any]:
    """Return the rows of a file with this layout, as a structured array."""
    table = np.zeros(frame.num_points, _dtype(layout.columns))
    own = frame.format is not None and frame.format.name == layout.name
    if own and frame.exact is not None:
        coordinates = frame.exact
    elif not own and (of_map := map_coordinates(frame, layout.name)) is not None:
        coordinates = _as_decimals(of_map, frame) if layout.name in _TEXT else of_map
    else:
        coordinates = layout.file_coordinates(frame.points)
    values: dict[str, NDArray[Any]] = dict(zip("xyz", coordinates.T, strict=True))
    values |= dict(frame.fields)
    intensity: NDArray[np.floating[Any]] | None = frame.intensity
    if frame.intensity is not None and layout.name == "3dtk":
        intensity = _short(frame.intensity)
    for names, column in ((_INTENSITY, intensity), (_RING, frame.ring)):
        if column is not None:
            values |= {key: column for key in names if key not in values}
    for i, (name, kind, count) in enumerate(layout.columns):
        found = values.get(name, values.get(plain_name(name)))
        # A field with several values per point does not fit a column with one.
        if found is not None and count > 0 and found.size == count * len(found):
            table[f"{i} {name}"] = _cast(found, np.dtype(kind))
    return table


def _short(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return float32 numbers of at most six decimals as the float64 that is written as short."""
    wide = values.astype(np.float64)
    rounded = np.round(wide, 6)
    return np.where(rounded.astype(np.float32) == values, rounded, wide)


def _cast(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind in "iu" and values.dtype.kind == "f":
        limits = np.iinfo(dtype)
        values = np.clip(np.rint(values), limits.min, limits.max)
    cast: NDArray[Any] = values.astype(dtype, copy=False)
    return cast


def _header(layout: ScanFormat, frame: LidarFrame) -> list[list[str]]:
    """Return the header entries, with width and height if the points still are those of a grid."""
    pairs = [[k, v] for k, v in layout.header.get("pairs", ()) if k not in ("width", "height")]
    if layout.name != "pcd":
        return pairs
    if frame.format is layout:
        pairs = [[k, _own_viewpoint(frame, layout, v) if k == "viewpoint" else v] for k, v in pairs]
    if (sides := kept_grid(frame, layout)) is not None:
        pairs += [["width", str(sides[1])], ["height", str(sides[0])]]
    return pairs


def grid_of(frame: LidarFrame) -> tuple[int, int] | None:
    """Return height and width of the organised cloud that a scan was read from; None: no grid.

    The scan must still hold each point that was measured, in the file's order.
    """
    pairs = () if frame.format is None else frame.format.header.get("pairs", ())
    sizes = {key: int(value) for key, value in pairs if key in ("width", "height")}
    height, width = sizes.get("height", 1), sizes.get("width", 0)
    is_whole = height * width == frame.num_points + frame.num_dropped
    rows = frame.file_rows
    in_order = frame.num_dropped == 0 if rows is None else _ascend_from_0(rows)
    return (height, width) if min(height, width) > 1 and is_whole and in_order else None


def _ascend_from_0(rows: NDArray[np.int64]) -> bool:
    """Return whether rows of a file are in its order; a new point has -1."""
    return bool((np.diff(rows, prepend=-1) > 0).all())


def kept_grid(frame: LidarFrame, layout: ScanFormat) -> tuple[int, int] | None:
    """Return height and width of the grid of a scan that a layout can hold; None: no grid.

    Pixels without a return need coordinates that can be NaN.
    """
    kinds = {np.dtype(kind).kind for name, kind, _ in layout.columns if plain_name(name) in "xyz"}
    return grid_of(frame) if kinds == {"f"} or frame.num_dropped == 0 else None


def lost_grid(frame: LidarFrame, suffix: str) -> tuple[int, int] | None:
    """Return height and width of a scan's grid if a file of this suffix does not hold it."""
    layout = frame.format
    if layout is None:
        return None
    # New files have coordinates that can be NaN.
    is_new = layout.name != format_name(suffix)
    is_kept = suffix in _WITH_GRID and (is_new or kept_grid(frame, layout) is not None)
    return None if is_kept else grid_of(frame)


def grid_rows(frame: LidarFrame, layout: ScanFormat) -> NDArray[Any]:
    """Return `packed_rows`; pixels of a `kept_grid` without a return have rows of NaN and zeros."""
    rows = packed_rows(frame, layout)
    sides = kept_grid(frame, layout)
    if sides is None or frame.file_rows is None:
        return rows
    grid = np.zeros(math.prod(sides), rows.dtype)
    for i, (name, _, _) in enumerate(layout.columns):
        if plain_name(name) in "xyz":
            grid[f"{i} {name}"] = np.nan
    grid[frame.file_rows] = rows
    return grid


def _kitti_layout(frame: LidarFrame) -> ScanFormat:
    return ScanFormat("kitti", tuple((name, "<f4", 1) for name in ("x", "y", "z", "intensity")))


def _nuscenes_layout(frame: LidarFrame) -> ScanFormat:
    names = ("x", "y", "z", "intensity", "ring")
    return ScanFormat("nuscenes", tuple((name, "<f4", 1) for name in names))


def kind_of_coordinates(frame: LidarFrame, name: str) -> str:
    """Return NumPy's type name of the coordinates in a new file of a format."""
    return "<f4" if map_coordinates(frame, name) is None else "<f8"


def _general_columns(frame: LidarFrame, name: str) -> tuple[Column, ...]:
    kind = kind_of_coordinates(frame, name)
    columns: list[Column] = [(axis, kind, 1) for axis in "xyz"]
    if frame.intensity is not None:
        columns.append(("intensity", "<f4", 1))
    if frame.ring is not None:
        columns.append(("ring", _kind(frame.ring), 1))
    for field_name, values in frame.fields.items():
        if values.ndim <= 2 and values.dtype.kind in "iuf" and values.dtype.itemsize <= 8:
            columns.append((field_name, _kind(values), values.shape[1] if values.ndim == 2 else 1))
    return tuple(columns)


def general_fields(frame: LidarFrame) -> dict[str, NDArray[Any]]:
    """Return the columns of a frame that any format may hold: one number per point."""
    columns = {} if frame.ring is None else {"ring": frame.ring}
    columns |= {
        name: v for name, v in frame.fields.items() if v.ndim == 1 and v.dtype.kind in "iuf"
    }
    return columns


def _kind(values: NDArray[Any]) -> str:
    dtype = np.dtype(np.float32) if values.dtype == np.float16 else values.dtype
    return f"<{dtype.kind}{dtype.itemsize}"


def _pcd_layout(frame: LidarFrame) -> ScanFormat:
    is_of_map = map_coordinates(frame, "pcd") is not None
    place = _place_text(frame, map_shift(frame) if is_of_map else np.zeros(3))
    header = {"pairs": (("viewpoint", f"{place} 1 0 0 0"), ("data", "binary"))}
    return ScanFormat("pcd", _general_columns(frame, "pcd"), header)


def _place_text(frame: LidarFrame, shift: NDArray[np.float64]) -> str:
    """Return the position in a PCD viewpoint; (0, 0, 0) if it is not known."""
    origin = np.zeros(3) if frame.origin is None else np.array(frame.origin) + shift
    return " ".join(repr(value) for value in origin.tolist())


def _own_viewpoint(frame: LidarFrame, layout: ScanFormat, told: str) -> str:
    """Return the viewpoint of a scan that was read from PCD, as told unless the scanner moved."""
    stated = _origin("pcd", {"viewpoint": told})
    if frame.origin == _shifted_origin(stated, layout.to_file):
        return told
    turn = told.split()[3:]
    return " ".join([_place_text(frame, layout.to_file[:3, 3]), *turn])


def _ply_layout(frame: LidarFrame) -> ScanFormat:
    columns = [
        c for c in _general_columns(frame, "ply") if c[2] == 1 and c[1] not in ("<i8", "<u8")
    ]
    return ScanFormat("ply", tuple(columns))


def _three_dtk_layout(frame: LidarFrame) -> ScanFormat:
    columns: list[Column] = [(axis, "<f8", 1) for axis in "xyz"]
    if frame.intensity is not None:
        columns.append(("intensity", "<f8", 1))
    return ScanFormat("3dtk", tuple(columns), to_file=_to_file("3dtk"))


def _text_layout(name: str) -> Callable[[LidarFrame], ScanFormat]:
    def layout(frame: LidarFrame) -> ScanFormat:
        columns = [column for column in _general_columns(frame, name) if column[2] == 1]
        if name == "csv":
            names = [re.sub(r"[\s,;\"#]", "_", column[0]) for column in columns]
            pairs = [("names", ",".join(names)), ("separator", ",")]
        else:  # without column names, the meaning of other columns would be lost
            last = color_names(frame, name) or NORMALS.get(name, ())
            others = [column for column in columns if column[0] in last]
            has_fourth = frame.intensity is not None and name not in _NAMED_BY_SUFFIX
            columns = columns[: 3 + has_fourth] + others
            pairs = [("count", "")] if name == "pts" else []
        return ScanFormat(name, tuple(columns), {"pairs": tuple(pairs)})

    return layout


def read_pose(path: Path) -> NDArray[np.float64] | None:
    """Return the pose of a ``.3d`` file, (4, 4) in metres and manip3d's axes; None without one.

    Its ``.pose`` file holds the position in centimetres, then angles in degrees for R = Rx Ry Rz
    (3DTK's convention).
    """
    name = path.name[: -len(path.suffix)] if path.suffix in _COMPRESSED else path.name
    pose = path.with_name(name).with_suffix(".pose")
    if not pose.is_file():
        return None
    try:
        numbers = np.array(text_of(pose).split(), np.float64)
    except ValueError:
        numbers = np.empty(0)
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise FormatError("expected six finite numbers", file=str(pose))
    matrix = np.eye(4)
    matrix[:3, :3] = _euler(np.radians(numbers[3:]))
    matrix[:3, 3] = numbers[:3]
    axes = _to_file("3dtk")
    return product(product(inverse(axes), matrix), axes)


def _euler(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return product(product(rx, ry), rz)


_TABLES = {
    ".bin": _Table("kitti", _kitti_layout),
    ".pcd.bin": _Table("nuscenes", _nuscenes_layout),
    ".pcd": _Table("pcd", _pcd_layout),
    ".ply": _Table("ply", _ply_layout),
    ".3d": _Table("3dtk", _three_dtk_layout),
    **{f".{name}": _Table(name, _text_layout(name)) for name in _TEXT},
}


def format_name(suffix: str) -> str:
    """Return the name in `ScanFormat` of the format of a suffix of scans."""
    table = _TABLES.get(suffix)
    return suffix.lstrip(".").replace("laz", "las") if table is None else table.name


def column_names(frame: LidarFrame, suffix: str) -> set[str]:
    """Return the column names of a new file of one of `TABLE_SUFFIXES`."""
    return {name for name, _, _ in _TABLES[suffix].layout(frame).columns}


def write_table(frame: LidarFrame, name: str) -> None:
    """Write a scan in the table format of the suffix of ``name``; see `manip3d.io.write_scan`."""
    table = _TABLES.get(scan_suffix(name))
    if table is None:
        # Raises InputError, which lists the known suffixes.
        _core.write_points(os.fsencode(name), [], [], 0, np.empty(0, np.int8))
        return
    own = frame.format is not None and frame.format.name == table.name
    layout = frame.format if own and frame.format is not None else table.layout(frame)
    rows = grid_rows(frame, layout) if table.name == "pcd" else packed_rows(frame, layout)
    header = [(key, value) for key, value in _header(layout, frame)]
    data = rows.view(np.int8)
    _core.write_points(os.fsencode(name), list(layout.columns), header, len(rows), data)
    return
