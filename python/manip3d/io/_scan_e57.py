"""Reading and writing of E57 through pye57: all scan positions, poses, rows and columns."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.extras import imported
from manip3d._util.linear import product, quaternions
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_path, open_regular
from manip3d.io._limits import check_points
from manip3d.io._scan_tables import (
    exact_coordinates,
    measured_points,
    near_zero,
    refuse_expansion,
    seen_from,
)
from manip3d.lidar import LidarFrame, ScanFormat, map_shift

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_RIGID = 1e-5  # largest error of R R^T; poses in text have six digits or more
_BLOCK = 1 << 20  # bytes per write
_NO_TURN = (1.0, 0.0, 0.0, 0.0)  # quaternion w, x, y, z
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_STATES = ("cartesianInvalidState", "sphericalInvalidState")
ECHO = "returnIndex"
"""Column with the number of the echo of a pulse, from 0."""
_TIME = "timeStamp"
"""Column with the time of each point in seconds, after the scan's own start."""
_NO_INTENSITY = "isIntensityInvalid"
_EXTENSION, _EXTENSION_URI = "manip3d", "urn:manip3d:e57"
"""Prefix and URI of this library's elements in an E57 file, which other readers ignore."""
_UNPLACED = f"{_EXTENSION}:unknownScannerPosition"
"""Element of a scan whose pose only places its points, because nobody knows where the scanner
stood."""

COLORS = ("colorRed", "colorGreen", "colorBlue")
_MAX_COLOR, _MAX_WIDE_COLOR = 255.0, 65535.0
INTEGERS: dict[str, type[np.unsignedinteger[Any]]] = {
    "rowIndex": np.uint16, "columnIndex": np.uint16, **dict.fromkeys(COLORS, np.uint8)
}  # fmt: skip
"""Columns that are written in addition to coordinates and intensity, and their types."""


def read_all(path: Path, limit: int) -> list[LidarFrame]:
    """Read all scan positions, in the file's order; see `manip3d.io.read_scans`."""
    pye57 = imported("pye57", "e57")
    with open_regular(path) as stream:  # raises OSError before the parser runs
        if stream.read(8) != b"ASTM-E57":
            raise FormatError("expected an E57 file", file=str(path), byte_offset=0)
    try:
        file = pye57.E57(str(path))
        try:
            _check_claims(file, path, limit)
            return [_read_one(file, i, path) for i in range(file.scan_count)]
        finally:
            file.close()
    except (FormatError, OSError, MemoryError):
        raise
    except Exception as error:  # pye57 raises various types for damaged files
        # The lines after the first name functions of the library.
        reason = str(error).replace("\\n", "\n").strip().partition("\n")[0][:200]
        raise FormatError(f"damaged E57: {reason}", file=str(path)) from error


def _check_claims(file: Any, path: Path, limit: int) -> None:
    """Refuse a file whose scans claim more bytes than it can hold, or exceed a limit."""
    headers = [file.get_header(index) for index in range(file.scan_count)]
    claimed = sum(8 * each.point_count * max(1, len(each.point_fields)) for each in headers)
    refuse_expansion(claimed, path.stat().st_size, limit, str(path))
    check_points(sum(each.point_count for each in headers), str(path))


def _columns_of(file: Any, header: Any) -> dict[str, NDArray[Any]]:
    """Columns that pye57 knows; also echoes, times and invalid intensities, which it leaves out."""
    pye57 = imported("pye57", "e57")
    known = [name for name in header.point_fields if name in pye57.e57.SUPPORTED_POINT_FIELDS]
    data: dict[str, NDArray[Any]]
    data, buffers = file.make_buffers(
        [name for name in known if name not in INTEGERS], header.point_count
    )
    # pye57's own buffers hold 8 and 16 bits, and files hold larger and negative numbers.
    for name in (*(name for name in known if name in INTEGERS), ECHO, _TIME, _NO_INTENSITY):
        if name in header.point_fields:
            data[name] = np.empty(header.point_count, np.float64)
            buffers.append(
                pye57.libe57.SourceDestBuffer(
                    file.image_file, name, data[name], header.point_count, True, True
                )
            )
    header.points.reader(buffers).read()
    wide = max((data[name].max(initial=0.0) for name in COLORS if name in data), default=0.0)
    for name in COLORS:
        if name in data and wide > _MAX_COLOR:
            data[name] *= _MAX_COLOR / max(wide, _MAX_WIDE_COLOR)
    if _NO_INTENSITY in data:
        data[_NO_INTENSITY] = (data[_NO_INTENSITY] != 0.0).astype(np.uint8)
    return data | {name: _whole(data[name], name) for name in (*INTEGERS, ECHO) if name in data}


def _whole(values: NDArray[np.float64], name: str) -> NDArray[Any]:
    """Return whole numbers in the type that the column is written in, or in a wider one."""
    values = np.rint(values)
    for dtype in (INTEGERS.get(name, np.uint16), np.int64):
        limits = np.iinfo(dtype)
        if limits.min <= values.min(initial=0.0) and values.max(initial=0.0) <= limits.max:
            break
    return values.astype(dtype)


def _read_one(file: Any, index: int, path: Path) -> LidarFrame:
    """Return a scan position without invalid points; coordinates of maps are moved near zero."""
    header = file.get_header(index)
    data = _columns_of(file, header)
    keep = np.ones(header.point_count, np.bool_)
    for state in _STATES:
        if state in data:
            keep &= data.pop(state) == 0
    if all(name in data for name in _CARTESIAN):
        exact = np.column_stack([data.pop(name) for name in _CARTESIAN])
    elif all(name in data for name in _SPHERICAL):
        distance, azimuth, elevation = (data.pop(name) for name in _SPHERICAL)
        flat = distance * np.cos(elevation)
        exact = np.column_stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)]
        )
    else:
        raise FormatError(f"scan {index}: expected x, y, z or range and angles", file=str(path))
    keep &= ~np.isnan(exact).any(axis=1)
    pose, rotation = np.eye(4), header.rotation
    pose[:3, :3] = header.rotation_matrix
    pose[:3, 3] = header.translation
    exact = np.ascontiguousarray(exact[keep])
    is_placed = not _is_unplaced(file, header)
    if not is_placed:
        exact = ScanFormat("e57", to_file=pose).file_coordinates(exact)
        pose, rotation = np.eye(4), np.array(_NO_TURN)
    about = {"pose": pose, "rotation": rotation, "index": index}
    layout = ScanFormat("e57", header=about, to_file=near_zero(exact))
    points = measured_points(exact, layout, str(path))
    fields = {name: values[keep] for name, values in data.items() if name != "intensity"}
    has_intensity = "intensity" in data and not fields.get(_NO_INTENSITY, np.zeros(1)).all()
    return LidarFrame(
        points=points,
        intensity=data["intensity"][keep] if has_intensity else None,
        origin=(0.0, 0.0, 0.0) if is_placed and not layout.to_file[:3, 3].any() else None,
        source=str(path),
        fields=fields,
        exact=exact_coordinates(exact, points),
        format=layout,
        num_dropped=int(np.count_nonzero(~keep)),
        file_rows=None if keep.all() else np.flatnonzero(keep),
    )


def _is_unplaced(file: Any, header: Any) -> bool:
    """Return whether a scan that this library wrote has no known scanner position."""
    # libE57 refuses names with a prefix that the file does not declare.
    image = file.image_file
    prefixes = [image.extensionsPrefix(i) for i in range(image.extensionsCount())]
    return _EXTENSION in prefixes and bool(header.node.isDefined(_UNPLACED))


def write_all(frames: Sequence[LidarFrame], path: Path) -> None:
    """Write all scan positions; pye57 writes coordinates as 32-bit floats.

    Points are relative to the scanner, whose position is written in the pose; those that were not
    measured stay at (0, 0, 0). Map coordinates are shifted near 0, and the shift is written in the
    pose, too. Scans whose scanner position is not known are marked by `_UNPLACED`.

    Raises
    ------
    InputError
        A frame has no points, which pye57 cannot write.
    """
    pye57 = imported("pye57", "e57")
    for frame in frames:
        if not frame.num_points:
            raise InputError("points: E57 needs at least one in each scan")
    # Written to memory first, because libE57 crashes if the disk is full or fails.
    with os.fdopen(os.memfd_create("manip3d"), "rb") as memory:
        file = pye57.E57(f"/proc/self/fd/{memory.fileno()}", mode="w")
        try:
            if any(frame.origin is None for frame in frames):
                file.image_file.extensionsAdd(_EXTENSION, _EXTENSION_URI)
            for frame in frames:
                _write_one(file, frame)
        finally:
            file.close()
        with atomic_path(path) as temporary, temporary.open("wb") as disk:
            shutil.copyfileobj(memory, disk, _BLOCK)


def integers_of(frame: LidarFrame) -> dict[str, str]:
    """Return the columns of `INTEGERS` that pye57 writes, and their names in the frame.

    They are those that fit, all three colours or rows and columns both. Names from text are in
    lower case.
    """
    by_lower = {name.lower(): name for name in frame.fields}
    by_lower |= {name.lower(): name for name in INTEGERS if name in frame.fields}
    fitting = {
        name: own
        for name, dtype in INTEGERS.items()
        if (own := by_lower.get(name.lower())) is not None and _fits(frame.fields[own], dtype)
    }
    groups = (COLORS, ("rowIndex", "columnIndex"))
    complete = [group for group in groups if fitting.keys() >= set(group)]
    return {name: fitting[name] for group in complete for name in group}


def _fits(values: NDArray[Any], dtype: type[np.unsignedinteger[Any]]) -> bool:
    with np.errstate(invalid="ignore"):
        return np.array_equal(values.astype(dtype), values)


def _write_one(file: Any, frame: LidarFrame) -> None:
    stands = np.zeros(3) if frame.origin is None else np.array(frame.origin)
    seen = seen_from(frame.points, stands)
    data: dict[str, NDArray[Any]] = {name: seen[:, i] for i, name in enumerate(_CARTESIAN)}
    if frame.intensity is not None:
        data["intensity"] = frame.intensity
    columns = integers_of(frame)
    data |= {name: frame.fields[own].astype(INTEGERS[name]) for name, own in columns.items()}
    header = {} if frame.format is None else frame.format.header
    given = header.get("pose")  # of E57 and PTX; None for a .3d file without its .pose file
    pose = np.eye(4) if given is None else np.asarray(given)
    rotation = header.get("rotation")
    if rotation is None:
        (rotation,) = quaternions(pose[None, :3, :3])
    if not np.allclose(product(pose[:3, :3], pose[:3, :3].T), np.eye(3), atol=_RIGID):
        raise InputError(
            "points: E57 holds poses that turn and move, got one that scales or skews; a format "
            "without poses holds the points"
        )
    translation = pose[:3, 3] + product(pose[:3, :3], map_shift(frame) + stands)
    file.write_scan_raw(data, rotation=rotation, translation=translation)
    if frame.origin is None:
        written = file.data3d[file.data3d.childCount() - 1]
        written.set(_UNPLACED, imported("pye57", "e57").libe57.IntegerNode(file.image_file, 1))
