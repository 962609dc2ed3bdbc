"""Scans: the points of one turn or one position of a LiDAR, with their columns and metadata."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from dataclasses import replace as _replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array, vector, warn_of_rounding
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.linear import moved
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

ScanLike: TypeAlias = "LidarFrame | ArrayLike"

__all__ = ["Box", "LidarFrame", "ScanFormat", "ScanSummary"]

_Corner: TypeAlias = tuple[float, float, float]
_Extent: TypeAlias = tuple[float, float]

_TOLD = ("model", "sensor_time", "packets", "is_complete", "unit")
"""Names in `ScanFormat.header` of what describes a scan, in a summary's order."""


@dataclass(frozen=True, eq=False)
class ScanFormat:
    """Layout of the file that a scan was read from, so that it can be written in the same way.

    Attributes
    ----------
    name : str
        ``kitti``, ``pcd``, ``ply``, ...
    columns : tuple of (str, str, int)
        Name, NumPy type and number of values per point of each column of the file, in order.
    header : mapping
        Other metadata of the file, by the format's own names.
    to_file : (4, 4) float64
        Transform from the frame's points to the file's coordinates, which may have other axes,
        units or a distant origin.
    """

    name: str
    columns: tuple[tuple[str, str, int], ...] = ()
    header: Mapping[str, Any] = field(default_factory=dict)
    to_file: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))

    __repr__ = short_repr

    def file_coordinates(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points of the frame in the file's coordinates, (N, 3) float64."""
        matrix = self.to_file
        wide: NDArray[np.float64] = np.asarray(points, np.float64)
        if np.array_equal(matrix, np.eye(4)):  # exact, including the sign of zeros
            return wide
        return moved(wide, matrix)


@checked
@dataclass(frozen=True)
class Box:
    """A box around an object, upright and rotated about the vertical.

    Attributes
    ----------
    center : (float, float, float)
        Middle of the box, metres, in the frame of the scan it belongs to.
    size : (float, float, float)
        Length (along x before rotation), width, height, metres.
    yaw : float
        Rotation about z, radians, counter-clockwise seen from above.
    label : str
        ``Car``, ``Pedestrian``, ...
    track : int
        Number of the object, the same in all frames; -1: unknown.

    Raises
    ------
    InputError
        ``center`` or ``size`` are not three numbers; one of them or ``yaw`` is not finite; a size
        is below 0.
    """

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0
    label: str = ""
    track: int = -1

    def __post_init__(self) -> None:
        for name, values in (("center", self.center), ("size", self.size)):
            if not np.isfinite(values).all():
                raise InputError(f"{name}: expected finite numbers, got {values!r}")
        if not (np.asarray(self.size) >= 0).all():
            raise InputError(f"size: expected numbers >= 0, got {self.size!r}")
        if not math.isfinite(self.yaw):
            raise InputError(f"yaw: expected a finite number, got {self.yaw!r}")
        object.__setattr__(self, "center", _three(self.center))  # also converts arrays
        object.__setattr__(self, "size", _three(self.size))
        object.__setattr__(self, "yaw", float(self.yaw))

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return which of the (N, 3) points lie inside the box or on its faces."""
        rows = as_rows(points, 3, np.float64, "points")
        # Few points of a scan are near a box. The others are excluded by the cube around the box's
        # bounding sphere, which is slightly enlarged so that rounding excludes no point of the box.
        center, size = np.asarray(self.center, np.float64), np.asarray(self.size, np.float64)
        reach = 0.5 * np.linalg.norm(size) + 1e-6 * (1.0 + np.abs(center).max())
        near = np.flatnonzero(np.abs(rows[:, 0] - center[0]) <= reach)
        near = near[np.abs(rows[near, 1] - center[1]) <= reach]
        offset = rows[near] - center
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        along = cosine * offset[:, 0] + sine * offset[:, 1]
        across = cosine * offset[:, 1] - sine * offset[:, 0]
        half = np.abs(np.column_stack([along, across, offset[:, 2]])) * 2.0
        inside = np.zeros(len(rows), np.bool_)
        inside[near] = np.all(half <= size, axis=1)
        return inside


def box_corners(box: Box) -> NDArray[np.float64]:
    """Return the corners (8, 3) of a box in its scan's frame; the last axis changes fastest."""
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    along, across, up = (signs * np.asarray(box.size)).T
    cosine, sine = math.cos(box.yaw), math.sin(box.yaw)
    turned = [cosine * along - sine * across, sine * along + cosine * across, up]
    return np.asarray(np.column_stack(turned) + np.asarray(box.center))


def box_outline(box: Box, smallest: float) -> NDArray[np.float64]:
    """Return the corners (4, 3) of a box seen from above, at the height of its centre.

    They are in counter-clockwise order. Sides shorter than ``smallest`` are lengthened to it.
    """
    length, width, _ = box.size
    flat = _replace(box, size=(max(length, smallest), max(width, smallest), 0.0))
    return box_corners(flat)[[6, 2, 0, 4]]


@dataclass(frozen=True, eq=False, repr=False)
class LidarFrame(Showable):
    """One scan: points with, row by row, the columns of the sensor or the file.

    Attributes
    ----------
    points : (N, 3) float32
        Points in metres, right-handed; x forward, y left, z up (KITTI) if the format states its
        axes.
    intensity : (N,) float32 or None
        Intensity as stored (KITTI: reflectance in [0, 1]); None: there is none.
    time_ns : int or None
        Time of the scan, nanoseconds since 1970 (UTC); None: unknown.
    ring : (N,) integers or None
        Laser of each point; in decoded packets 0 is the highest beam (KITTI's order).
    origin : (float, float, float) or None
        Position of the scanner in the frame of ``points``; None: unknown.
    source : str
        File or address from which the scan was read.
    fields : mapping of str to (N,) or (N, k) array
        Other columns by name, in the file's own types.
    exact : (N, 3) float64 or None
        The file's own coordinates if float32 metres cannot represent them; unmoved points are
        written back with them. `ScanFormat.to_file` computes them for moved points.
    format : ScanFormat or None
        Format of the file that the scan came from.
    num_dropped : int
        Number of points of the file without coordinates (NaN), which are not in ``points``.
    file_rows : (N,) int64 or None
        Row of each point in the file, or in the frame that was made first; -1: a new point. None:
        the same row as here, because no point was dropped, left out or moved to another row.

    Raises
    ------
    InputError
        A shape or dtype is wrong, a coordinate or intensity is not finite.

    Notes
    -----
    C-contiguous arrays of the dtypes above are kept without a copy. Points that float32 rounds by
    more than a millimetre, such as those of a national grid, cause a warning.
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    time_ns: int | None = None
    ring: NDArray[Any] | None = None
    origin: tuple[float, float, float] | None = None
    source: str = ""
    fields: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    exact: NDArray[np.float64] | None = None
    format: ScanFormat | None = None
    num_dropped: int = 0
    file_rows: NDArray[np.int64] | None = None

    if TYPE_CHECKING:  # arrays of other dtypes and lists are converted

        def __init__(
            self,
            points: ArrayLike,
            intensity: ArrayLike | None = ...,
            time_ns: int | None = ...,
            ring: ArrayLike | None = ...,
            origin: ArrayLike | None = ...,
            source: str = ...,
            fields: Mapping[str, ArrayLike] = ...,
            exact: ArrayLike | None = ...,
            format: ScanFormat | None = ...,
            num_dropped: int = ...,
            file_rows: ArrayLike | None = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        for name, kind, words in (
            ("source", str, "a text"),
            ("format", ScanFormat | None, "a ScanFormat or None"),
            ("num_dropped", int | np.integer, "a whole number"),
        ):
            if not isinstance(value := getattr(self, name), kind):
                raise InputError(f"{name}: expected {words}, got {value!r}")
        convert = _near_points if self.exact is None else _points
        points = convert(self.points, "points")
        intensity = None if self.intensity is None else _column(self.intensity, "intensity")
        time_ns = _time(self.time_ns)
        _core.check_points(points, np.empty(0, np.float32) if intensity is None else intensity)
        exact = None if self.exact is None else as_rows(self.exact, 3, np.float64, "exact")
        ring = None if self.ring is None else _integers(as_array(self.ring, "ring"), "ring")
        fields = _fields(self.fields)
        rows = (
            None
            if self.file_rows is None
            else _integers(as_array(self.file_rows, "file_rows"), "file_rows")
        )
        columns = {"intensity": intensity, "exact": exact, "ring": ring, "file_rows": rows}
        for named in (columns, fields):  # a field may have the name of a column
            _check_lengths(named, len(points))
        origin = None if self.origin is None else _place(self.origin, "origin")
        checked: dict[str, Any] = {
            "points": points,
            "time_ns": time_ns,
            "origin": origin,
            **columns,
        }
        checked["fields"] = ReadOnlyMapping(fields)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def num_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def num_empty(self) -> int:
        """Number of points at exactly (0, 0, 0), by which some formats mark missing returns."""
        return int(np.count_nonzero(~self.points.any(axis=1)))

    def summary(self) -> ScanSummary:
        """Return counts and extents of the points and columns, and the format's metadata."""
        return _summarized(self)

    def replace(self, **changes: Any) -> LidarFrame:
        """Return the frame with some attributes changed; the other arrays are shared."""
        unknown = set(changes) - set(self.__dataclass_fields__)
        if unknown:
            raise InputError(f"replace: no such attribute: {', '.join(sorted(unknown))}")
        return _replace(self, **changes)

    def select(self, rows: ArrayLike) -> LidarFrame:
        """Return the frame with some of its points, whose `file_rows` are kept.

        Parameters
        ----------
        rows : (N,) bool or (M,) integers
            A mask, or row numbers in the order of the result; negative numbers count from the end.

        Raises
        ------
        InputError
            A mask has another length or is of 8-bit integers; row numbers are no integers or out
            of range.
        """
        index = as_array(rows, "rows")
        count = self.num_points
        if index.ndim == 1 and not index.size:  # an empty list becomes an array of floats
            index = index.astype(np.int64) if index.dtype != np.bool_ else index
        if index.dtype == np.bool_ and index.shape != (count,):
            raise InputError(f"rows: expected a mask of shape ({count},), got {index.shape}")
        if index.ndim != 1 or index.dtype.kind not in "biu":
            raise InputError(
                f"rows: expected a mask or integers of shape (N,), got {index.dtype} {index.shape}"
            )
        if _is_mask_of_bytes(index, count):
            raise InputError(
                f"rows: expected a mask of dtype bool, got {index.dtype} 0 or 1 for each of the "
                f"{count} points; give rows.astype(bool)"
            )
        if (
            index.dtype.kind in "iu"
            and index.size
            and not (index.min() >= -count and index.max() < count)
        ):
            raise InputError(
                f"rows: expected values in [{-count}, {count - 1}], "
                f"got {index.min()} to {index.max()}"
            )
        return self._taken(lambda values: values[index], self._file_rows_of(index))

    def _file_rows_of(self, index: NDArray[Any]) -> NDArray[np.int64] | None:
        """Return the rows of the file of a mask or row numbers; None if they change no row.

        A few rows of a large cloud do not need the numbers of all its rows.
        """
        if self.file_rows is not None:
            return np.asarray(self.file_rows[index], np.int64)
        if _is_identity(index, self.num_points):
            return None
        if index.dtype == np.bool_:
            return np.flatnonzero(index)
        rows = index.astype(np.int64)
        rows[rows < 0] += self.num_points
        return rows

    def with_points(
        self,
        points: ArrayLike,
        *,
        source_index: ArrayLike,
        intensity: ArrayLike | None = None,
    ) -> LidarFrame:
        """Return the frame with other points and the corresponding rows of its other columns.

        Parameters
        ----------
        points : (M, 3) float32
            The new points. A warning is raised if float32 rounds them by more than a millimetre.
        source_index : (M,) integers
            Row of each point in this frame; -1: a new point, whose other columns are 0, and whose
            ``file_rows`` is -1.
        intensity : (M,) float32, optional
            Intensity of each point; default: that of its source point.

        Raises
        ------
        InputError
            A row is out of range, or numbers of rows differ.
        """
        new = _near_points(points, "points")
        index = as_array(source_index, "source_index")
        if index.ndim == 1 and not index.size:  # an empty list becomes an array of floats
            index = index.astype(np.int64)
        if index.shape != (len(new),) or index.dtype.kind not in "iu":
            raise InputError(
                f"source_index: expected ({len(new)},) integers, got {index.dtype} {index.shape}"
            )
        if index.size and not (index.min() >= -1 and index.max() < self.num_points):
            raise InputError(
                f"source_index: expected values in [-1, {self.num_points - 1}], "
                f"got {index.min()} to {index.max()}"
            )
        added = index < 0
        safe = np.where(added, 0, index)

        def carried(values: NDArray[Any]) -> NDArray[Any]:
            if not self.num_points:
                return np.zeros((len(new), *values.shape[1:]), values.dtype)
            taken: NDArray[Any] = values[safe]
            taken[added] = 0
            return taken

        own = _own_rows(self, index)
        file_rows = None if own is None else np.where(added, -1, own[safe] if len(own) else -1)
        frame = self._taken(carried, file_rows)
        exact = None
        if frame.exact is not None:
            exact = frame.exact.copy()
            moved = added | np.any(frame.points != new, axis=1)
            exact[moved] = (self.format or ScanFormat("")).file_coordinates(new[moved])
        return frame.replace(
            points=new,
            exact=exact,
            intensity=frame.intensity if intensity is None else intensity,
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the scan to a file, atomically; see `manip3d.io.write_scan`."""
        from manip3d.io import write_scan

        write_scan(self, path)

    def _taken(self, take: Any, file_rows: NDArray[np.int64] | None) -> LidarFrame:
        """The frame with ``take`` applied to every array of rows but ``file_rows``."""
        named = {
            name: take(values)
            for name in ("points", "intensity", "ring", "exact")
            if (values := getattr(self, name)) is not None
        }
        fields = {name: take(values) for name, values in self.fields.items()}
        return self.replace(fields=fields, file_rows=file_rows, **named)

    def __repr__(self) -> str:
        parts = [counted(self.num_points, "point")]
        if self.ring is not None and self.num_points:
            parts.append(f"rings {self.ring.min()}-{self.ring.max()}")
        if self.time_ns is not None:
            parts.append(f"t = {self.time_ns / 1e9:.3f} s")
        if self.fields:
            parts.append(", ".join(self.fields))
        return f"<manip3d.LidarFrame: {'; '.join(parts)}>"


def _own_rows(frame: LidarFrame, index: NDArray[Any]) -> NDArray[np.int64] | None:
    """Return the rows of the file of all points of a frame; None if ``index`` changes no row."""
    if frame.file_rows is not None:
        return frame.file_rows.astype(np.int64, copy=False)
    return None if _is_identity(index, frame.num_points) else np.arange(frame.num_points)


def _is_identity(index: NDArray[Any], count: int) -> bool:
    """Return whether a mask or row numbers take all rows of a frame, in their order."""
    if index.dtype == np.bool_:
        return bool(index.all())
    return len(index) == count and bool((index == np.arange(count)).all())


def _is_mask_of_bytes(rows: NDArray[Any], count: int) -> bool:
    """Return whether integers are surely a mask: as row numbers, most would repeat the rows 0, 1.

    Other libraries write masks as 8-bit integers. Two numbers may be the rows of two points.
    """
    return (
        rows.dtype in (np.int8, np.uint8)
        and len(rows) == count > 2
        and set(np.unique(rows).tolist()) <= {0, 1}
    )


def _points(values: ArrayLike, name: str) -> NDArray[np.float32]:
    return as_rows(values, 3, np.float32, name)


def _near_points(values: ArrayLike, name: str) -> NDArray[np.float32]:
    """Convert to (N, 3) float32; warn if that rounds points by more than a millimetre."""
    points = _points(values, name)
    warn_of_rounding(values, points, name, "`LidarFrame.exact` keeps float64")
    return points


def _column(values: ArrayLike, name: str) -> NDArray[np.float32]:
    array = as_array(values, name)
    if array.ndim != 1:
        raise InputError(f"{name}: expected shape (N,), got {array.shape}")
    return as_rows(array[:, None], 1, np.float32, name)[:, 0]


def _time(time_ns: Any) -> int | None:
    if time_ns is None:
        return None
    if not isinstance(time_ns, int | np.integer) or not -(2**63) <= time_ns < 2**63:
        raise InputError(f"time_ns: expected whole nanoseconds of 64 bits, got {time_ns!r}")
    return int(time_ns)


def _integers(values: NDArray[Any], name: str) -> NDArray[Any]:
    if values.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integers, got dtype {values.dtype}")
    if values.ndim != 1:
        raise InputError(f"{name}: expected shape (N,), got {values.shape}")
    return values


def _fields(fields: Any) -> dict[str, NDArray[Any]]:
    if not isinstance(fields, Mapping):
        raise InputError(f"fields: expected a mapping of arrays, got {fields!r}")
    if others := [name for name in fields if not isinstance(name, str)]:
        raise InputError(f"fields: expected texts as names, got {others[0]!r}")
    return {name: as_array(values, name) for name, values in fields.items()}


def _check_lengths(columns: Mapping[str, NDArray[Any] | None], num_points: int) -> None:
    for name, values in columns.items():
        if values is not None and (values.ndim == 0 or len(values) != num_points):
            raise InputError(
                f"{name}: expected {num_points} rows, as many as points, got shape {values.shape}"
            )


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = np.asarray(values, np.float64).tolist()
    return x, y, z


def _place(values: Any, name: str) -> tuple[float, float, float]:
    x, y, z = vector(values, 3, name).tolist()
    return x, y, z


@dataclass(frozen=True)
class ScanSummary:
    """Counts and extents of a scan; see `LidarFrame.summary`.

    Attributes
    ----------
    format : str or None
        Name of the file's format.
    num_points, num_empty, num_dropped : int
        Same as for `LidarFrame`.
    bounds : ((x, y, z), (x, y, z)) float, or None
        Lowest and highest corner of the bounding box of all points but those at (0, 0, 0), in the
        coordinates of the file if it is a map; None: there are no such points.
    origin : (float, float, float) or None
        Position of the scanner, in the same coordinates.
    distances : (float, float) or None
        Smallest and largest distance of these points from the scanner; None: unknown.
    intensity, ring : (lowest, highest) or None
        Extents of these columns.
    num_rings : int or None
        Number of distinct rings.
    time_ns : int or None
        Same as for `LidarFrame`.
    fields : mapping of str to str
        Data type of each further column.
    header : mapping
        What the format states of sensor, time, packets and unit, under its own names.
    """

    format: str | None
    num_points: int
    num_empty: int
    num_dropped: int
    bounds: tuple[_Corner, _Corner] | None
    origin: _Corner | None
    distances: _Extent | None
    intensity: _Extent | None
    ring: _Extent | None
    num_rings: int | None
    time_ns: int | None
    fields: Mapping[str, str]
    header: Mapping[str, Any]

    __repr__ = short_repr

    def record(self) -> dict[str, Any]:
        """Return the summary as plain values that can be written as JSON.

        Returns
        -------
        dict
            The values that ``manip3d info`` prints of a scan with ``--json``.
        """
        return {
            "format": self.format,
            "points": self.num_points,
            "no_return": self.num_empty,
            "dropped": self.num_dropped,
            "bounds": None if self.bounds is None else [list(corner) for corner in self.bounds],
            "origin": None if self.origin is None else list(self.origin),
            "range": None if self.distances is None else list(self.distances),
            "intensity": None if self.intensity is None else list(self.intensity),
            "ring": None if self.ring is None else list(self.ring),
            "rings": self.num_rings,
            "time_ns": self.time_ns,
            "fields": dict(self.fields),
            **self.header,
        }


def _summarized(frame: LidarFrame) -> ScanSummary:
    shift = map_shift(frame)
    returned = frame.points[frame.points.any(axis=1)].astype(np.float64)
    seen = returned - (frame.origin or (0.0, 0.0, 0.0))
    reach = None if frame.origin is None else np.linalg.norm(seen, axis=1)
    header = {} if frame.format is None else frame.format.header
    return ScanSummary(
        format=None if frame.format is None else frame.format.name,
        num_points=frame.num_points,
        num_empty=frame.num_empty,
        num_dropped=frame.num_dropped,
        bounds=(_three(returned.min(0) + shift), _three(returned.max(0) + shift))
        if len(returned)
        else None,
        origin=None if frame.origin is None else _three(frame.origin + shift),
        distances=_extent(reach),
        intensity=_extent(frame.intensity),
        ring=_extent(frame.ring),
        num_rings=None if frame.ring is None else len(np.unique(frame.ring)),
        time_ns=frame.time_ns,
        fields=ReadOnlyMapping({n: str(values.dtype) for n, values in frame.fields.items()}),
        header=ReadOnlyMapping({name: header[name] for name in _TOLD if name in header}),
    )


def _extent(values: NDArray[Any] | None) -> _Extent | None:
    if values is None or not len(values):
        return None
    return values.min().item(), values.max().item()


class Scan(NamedTuple):
    """A scan as arguments of the core; ``intensity`` has no rows if the scan has none."""

    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    frame: LidarFrame | None


def to_scan(values: ScanLike) -> Scan:
    """A scan from a frame, (N, 3) points, or (N, 4) points with intensity."""
    none = np.empty(0, np.float32)
    if isinstance(values, LidarFrame):
        return Scan(values.points, none if values.intensity is None else values.intensity, values)
    array = as_array(values, "scan")
    if array.ndim == 2 and array.shape[1] == 4:
        return Scan(
            _near_points(array[:, :3], "scan"),
            np.ascontiguousarray(array[:, 3], np.float32),
            None,
        )
    return Scan(_near_points(array, "scan"), none, None)


def as_frame(scan: ScanLike) -> LidarFrame:
    """The scan as a frame that a result can keep; arrays of the caller are copied."""
    if isinstance(scan, LidarFrame):
        return scan
    points, intensity, _ = to_scan(scan)
    return LidarFrame(points.copy(), intensity.copy() if len(intensity) else None)


def placed(scan: Scan, origin: NDArray[np.float64]) -> LidarFrame:
    """The scan as a frame with the scanner at ``origin``."""
    frame = LidarFrame(scan.points.copy()) if scan.frame is None else scan.frame
    return frame.replace(origin=tuple(origin.tolist()))


def map_shift(frame: LidarFrame | None) -> NDArray[np.float64]:
    """Return the coordinates in its file of the origin of a frame that was read from a map.

    They are zeros for frames whose coordinates are those of the file, or have other axes or units.
    """
    if frame is None or frame.format is None:
        return np.zeros(3)
    to_file = frame.format.to_file
    is_shift = np.array_equal(to_file[:3, :3], np.eye(3))
    return to_file[:3, 3].copy() if is_shift else np.zeros(3)


def shifted(box: Box, shift: NDArray[np.float64]) -> Box:
    """Return a box with its center moved by three numbers."""
    x, y, z = (np.asarray(box.center) + shift).tolist()
    return _replace(box, center=(x, y, z))


def position_of(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Convert to three finite numbers; raise InputError for others."""
    return vector(values, 3, name)


def origin_of(origin: ArrayLike | None, scan: Scan) -> NDArray[np.float64]:
    """Return the position of the scanner: ``origin``, else that of the frame, else (0, 0, 0)."""
    if origin is None and scan.frame is not None and scan.frame.origin is not None:
        return position_of(scan.frame.origin, "origin")
    return np.zeros(3) if origin is None else position_of(origin, "origin")
