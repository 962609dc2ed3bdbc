"""Reading and writing of LAS and LAZ through laspy and lazrs, with all dimensions, losslessly."""

from __future__ import annotations

import copy
import io
import itertools
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.extras import imported
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_path
from manip3d.io._las_checks import check_las, correct_wave_packets
from manip3d.io._las_units import stated_unit
from manip3d.io._scan_tables import (
    exact_coordinates,
    general_fields,
    map_coordinates,
    measured_points,
    near_zero,
    ring_name,
)
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


_RAW = ("X", "Y", "Z")  # whole numbers from which a reader computes x, y, z
_LONGEST_NAME = 32  # bytes of the name of an extra dimension
_STEP_M = 1e-4  # of the coordinates in new files
_MAX_DEGREES = 180
"""Largest scan angle in degrees; larger whole numbers are counts of 0.006 degrees (LAS 1.4)."""
_WEEK_S, _LAST_GPS_S = 7 * 86400, 1e9
"""Seconds of a GPS week, and of 2043 in adjusted standard GPS time, whose 0 is in 2011. Larger
numbers, such as times since 1970, are neither."""


def read(path: Path, limit: int) -> LidarFrame:
    """Read a scan, see `manip3d.io.read_scan`; points far from 0 are shifted near 0."""
    laspy = imported("laspy", "las")
    num_chunks = check_las(path, limit)
    # The parallel decoder allocates a whole chunk of the size that the file claims. A single chunk
    # may claim any size, and decoding it in parallel would be no faster.
    parallel, serial = laspy.LazBackend.LazrsParallel, laspy.LazBackend.Lazrs
    try:
        las = laspy.read(path, laz_backend=(parallel, serial) if num_chunks > 1 else serial)
        exact = np.column_stack([np.asarray(las[axis], np.float64) for axis in "xyz"])
        columns = {
            name: np.array(las[name])
            for name in las.point_format.dimension_names
            if name not in _RAW
        }
    except (MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # various types for damaged files, including panics of Rust
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise FormatError(f"damaged LAS: {str(error)[:200]}", file=str(path)) from error
    told: dict[str, Any] = {"las": las.header}
    if unit := stated_unit(las.header):
        told["unit"] = unit
        warnings.warn(
            f"{path}: its coordinate system is in {unit}; coordinates are not converted, so that "
            f"results which are said to be in metres are in {unit}",
            stacklevel=caller_level(),
        )
    layout = ScanFormat("las", header=told, to_file=near_zero(exact))
    points = measured_points(exact, layout, str(path))
    name = "reflectance" if "reflectance" in columns else "intensity"
    ring = ring_name([n for n, values in columns.items() if _may_be_lasers(values)])
    return LidarFrame(
        points=points,
        intensity=columns.pop(name).astype(np.float32),
        ring=None if ring is None else columns.pop(ring),
        source=str(path),
        fields=columns,
        exact=exact_coordinates(exact, points),
        format=layout,
    )


def _may_be_lasers(values: NDArray[Any]) -> bool:
    """Return whether a column can hold the numbers of the lasers, which are never negative."""
    return values.ndim == 1 and values.dtype.kind in "iu" and bool((values >= 0).all())


def write(frame: LidarFrame, path: Path) -> None:
    """Write a scan, see `manip3d.io.write_scan`."""
    laspy = imported("laspy", "las")
    own = frame.format is not None and frame.format.name == "las"
    if own and frame.format is not None:
        header = _without_octree(copy.deepcopy(frame.format.header["las"]))
        exact = frame.exact
        if exact is None:
            exact = frame.format.file_coordinates(frame.points)
        columns = list(frame.fields.items())
        if frame.ring is not None:
            others = [n for n in header.point_format.dimension_names if n not in frame.fields]
            columns.append((ring_name(others) or "ring", frame.ring))
    else:
        exact = _new_coordinates(frame)
        general = general_fields(frame)
        columns = list(general.items())
        header = _new_header(laspy, exact, general)
    if frame.intensity is not None:
        own_name = "reflectance" if "reflectance" in _names(header) else "intensity"
        fits = _holds(header, own_name, frame.intensity)
        # It comes first, because a field of the same name gets another one.
        columns.insert(0, ("reflectance" if not fits else own_name, frame.intensity))
    placed = _placed(laspy, header, columns, path)
    try:
        las = laspy.LasData(header)
        las.points = laspy.ScaleAwarePointRecord.zeros(len(exact), header=header)
        las.x, las.y, las.z = exact.T
        for name, values in placed.items():
            las[name] = values.astype(las[name].dtype)
    except OverflowError as error:
        raise InputError(f"points: LAS cannot hold them: {error}") from error
    compressed = path.suffix.lower() == ".laz"
    with atomic_path(path) as temporary, temporary.open("wb") as disk:
        # Written to memory first, because lazrs does not name the cause if the disk is full.
        memory = io.BytesIO()
        las.write(memory if compressed else disk, do_compress=compressed)
        if compressed:
            correct_wave_packets(memory)
        disk.write(memory.getbuffer())


def is_rounded(frame: LidarFrame) -> bool:
    """Return whether a file in another format than that of the scan rounds its coordinates."""
    if frame.format is not None and frame.format.name == "las":
        return False
    exact = _new_coordinates(frame)
    off = np.abs(exact - _STEP_M * np.rint(exact / _STEP_M))
    near = 0.5 * np.spacing(np.abs(frame.points)) + 1e-3 * _STEP_M
    return bool((off > near).any())


def _new_coordinates(frame: LidarFrame) -> NDArray[np.float64]:
    of_map = map_coordinates(frame, "las")
    return frame.points.astype(np.float64) if of_map is None else of_map


def _without_octree(header: Any) -> Any:
    """Remove the octree records of a COPC file, which do not fit rows that laspy writes anew."""
    for records in (header.vlrs, header.evlrs):
        if records is not None:
            records[:] = [record for record in records if record.user_id.strip("\0 ") != "copc"]
    return header


def _names(header: Any) -> set[str]:
    return set(header.point_format.dimension_names)


def _holds(header: Any, name: str, values: NDArray[Any]) -> bool:
    """Return whether a dimension holds all values of a column unchanged."""
    dimension = header.point_format.dimension_by_name(name)
    if dimension.scales is not None or dimension.num_elements > 1:
        return True  # of the scan's own file; laspy converts to counts of the scale
    dtype = dimension.dtype or np.dtype(np.uint8)  # of bit fields, which share a byte
    if name == "scan_angle" and values.dtype.kind == "f" and not _are_counts(values):
        return False
    if dtype.kind in "iu" and len(values):
        low, high = values.min(), values.max()
        if not (dimension.min <= low and high <= dimension.max):
            return False
    with np.errstate(invalid="ignore"):
        return np.array_equal(
            values.astype(dtype).astype(values.dtype), values, equal_nan=values.dtype.kind == "f"
        )


def _are_counts(angles: NDArray[Any]) -> bool:
    """Return whether the numbers of a column can only be counts of 0.006 degrees, as in LAS 1.4.

    Text states no types: all numbers are whole, and some are too large for degrees or all are 0.
    """
    is_wide = not angles.any() or np.abs(angles).max() > _MAX_DEGREES
    return bool(is_wide and (angles == np.rint(angles)).all())


def _placed(
    laspy: Any, header: Any, columns: Sequence[tuple[str, NDArray[Any]]], path: Path
) -> dict[str, NDArray[Any]]:
    """Return the columns by their names in the file; those that no dimension holds get a new one.

    A name in LAS has at most 32 bytes. Of columns of one name the first keeps it.
    """
    placed: dict[str, NDArray[Any]] = {}
    renamed = []
    for name, given in columns:
        values = given if given.dtype.kind != "f" else _of_las(given)
        used = _names(header)
        is_free = name in used and name not in _RAW and name not in placed
        if is_free and _holds(header, name, values):
            placed[name] = values
            continue
        free = _free_name(name, used)
        header.add_extra_dims([laspy.ExtraBytesParams(name=free, type=values.dtype)])
        placed[free] = values
        if free != name:
            renamed.append(f"{name} as {free}")
    if renamed:
        warnings.warn(
            f"{path}: LAS cannot hold columns under their names; written as extra dimensions: "
            + ", ".join(renamed),
            stacklevel=caller_level(),
        )
    return placed


def _of_las(values: NDArray[Any]) -> NDArray[Any]:
    """Return decimal numbers in one of the types that LAS has: 32 or 64 bits."""
    return values.astype(np.float32 if values.dtype.itemsize <= 4 else np.float64, copy=False)


def _free_name(name: str, used: set[str]) -> str:
    for number in itertools.count(1):
        ending = "" if number == 1 else f"_{number}"
        room = _LONGEST_NAME - len(ending)
        free = name.encode()[:room].decode(errors="ignore") + ending
        if free not in used:
            return free
    raise AssertionError  # the count has no end


def _new_header(laspy: Any, exact: NDArray[np.float64], columns: dict[str, NDArray[Any]]) -> Any:
    """Return a header with steps of 0.1 mm, and the kind of GPS time that the values tell."""
    is_colored = all(name in columns for name in ("red", "green", "blue"))
    header = laspy.LasHeader(point_format=7 if is_colored else 6, version="1.4")
    header.scales = np.full(3, _STEP_M)
    header.offsets = np.floor(exact.min(axis=0)) if len(exact) else np.zeros(3)
    if _is_standard_time(columns.get("gps_time", np.empty(0))):
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    return header


def _is_standard_time(times: NDArray[Any]) -> bool:
    """Return whether GPS times are adjusted standard ones, which are no seconds of a week."""
    if not len(times) or not bool((np.abs(times) <= _LAST_GPS_S).all()):
        return False
    return bool(times.min() < 0 or times.max() > _WEEK_S)
