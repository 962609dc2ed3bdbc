"""LAS and LAZ through laspy (and lazrs): every dimension kept, coordinates to the last bit."""

from __future__ import annotations

import copy
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.errors import FormatError, InputError, MissingExtraError
from manip3d.io._files import atomic_path
from manip3d.io._scan_tables import (
    byte_limit,
    exact_coordinates,
    general_fields,
    measured_points,
    refuse_expansion,
)
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Farther from 0 than this, float32 has steps of more than a millimetre.
_FAR = 8192.0
_HEADER = 227  # bytes of the shortest header, LAS 1.0
_VLR, _EVLR = 54, 60  # bytes of the head of a variable length record


def _laspy() -> Any:
    try:
        import laspy
    except ImportError:
        raise MissingExtraError("laspy", "las") from None
    return laspy


def read(path: Path, max_bytes: int | None) -> LidarFrame:
    """As `manip3d.io.read_scan`; points are moved near 0 where they lie far from it."""
    laspy = _laspy()
    _check_header(path, byte_limit(max_bytes))
    try:
        las = laspy.read(path)
        exact = np.column_stack([np.asarray(las[axis], np.float64) for axis in "xyz"])
        columns = {
            name: np.array(las[name])
            for name in las.point_format.dimension_names
            if name not in ("X", "Y", "Z")
        }
    except (MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # whatever it makes of a damaged file, panics of Rust included
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise FormatError(f"damaged LAS: {str(error)[:200]}", file=str(path)) from error
    to_file = np.eye(4)
    if len(exact) and np.isfinite(exact).all() and np.abs(exact).max() > _FAR:
        to_file[:3, 3] = np.round(exact.mean(axis=0))
    layout = ScanFormat("las", header={"las": las.header}, to_file=to_file)
    points = measured_points(exact, layout, str(path))
    name = "reflectance" if "reflectance" in columns else "intensity"
    return LidarFrame(
        points=points,
        intensity=columns.pop(name).astype(np.float32),
        source=str(path),
        fields=columns,
        exact=exact_coordinates(exact, points),
        format=layout,
    )


def _check_header(path: Path, limit: int) -> None:
    """Refuse counts that the file's bytes cannot hold, before anything is allocated."""
    with path.open("rb") as stream:
        head = stream.read(375)
    size = path.stat().st_size

    def fail(byte: int, reason: str) -> None:
        raise FormatError(reason, file=str(path), byte_offset=byte)

    if head[:4] != b"LASF":
        fail(0, "expected a LAS file (LASF)")
    if len(head) < _HEADER:
        fail(len(head), "file ends within the header")
    header_size, start, num_vlrs, kind, row, count = struct.unpack_from("<HIIBHI", head, 94)
    if head[24] == 1 and head[25] >= 4 and len(head) >= 255:
        evlr_start, num_evlrs, count = struct.unpack_from("<QIQ", head, 235)
        if num_evlrs * _EVLR > max(0, size - evlr_start):
            fail(243, f"{num_evlrs} records claimed, but the file ends before them")
    if header_size < _HEADER or start < header_size or start > size:
        fail(96, f"expected points at bytes {header_size} to {size}, got {start}")
    if num_vlrs * _VLR > start - header_size:
        fail(100, f"{num_vlrs} records claimed, but there is room for {start - header_size} bytes")
    is_compressed = kind & 0xC0 != 0
    if not is_compressed and count * row > size - start:
        fail(107, f"{count} points claimed, but {size - start} bytes follow")
    if is_compressed:
        refuse_expansion(count * row, size, limit, str(path))


def write(frame: LidarFrame, path: Path) -> None:
    """As `manip3d.io.write_scan`."""
    laspy = _laspy()
    own = frame.format is not None and frame.format.name == "las"
    if own and frame.format is not None:
        header = copy.deepcopy(frame.format.header["las"])
        exact = frame.exact
        if exact is None:
            exact = frame.format.file_coordinates(frame.points)
        columns = dict(frame.fields)
    else:
        exact = frame.points.astype(np.float64)
        columns = general_fields(frame)
        header = _new_header(laspy, exact, columns, frame)
    if frame.intensity is not None:
        known = set(header.point_format.dimension_names)
        columns["reflectance" if "reflectance" in known else "intensity"] = frame.intensity
    try:
        las = laspy.LasData(header)
        las.points = laspy.ScaleAwarePointRecord.zeros(len(exact), header=header)
        las.x, las.y, las.z = exact.T
        for name, values in columns.items():
            las[name] = _fitting(values, las[name].dtype)
    except OverflowError as error:
        raise InputError(f"points: LAS cannot hold them: {error}") from error
    with atomic_path(path) as temporary:
        las.write(str(temporary), do_compress=path.suffix.lower() == ".laz")


def _fitting(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        values = np.clip(np.rint(values), limits.min, limits.max)
    return values.astype(dtype)


def _new_header(
    laspy: Any, exact: NDArray[np.float64], columns: dict[str, NDArray[Any]], frame: LidarFrame
) -> Any:
    """Steps of 0.1 mm; what is no standard dimension becomes an extra one."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 1e-4)
    header.offsets = np.floor(exact.min(axis=0)) if len(exact) else np.zeros(3)
    extra = dict(columns)
    if frame.intensity is not None and np.any(frame.intensity != np.rint(frame.intensity)):
        extra["reflectance"] = frame.intensity
    known = set(header.point_format.dimension_names)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name=name[:32], type=values.dtype)
            for name, values in extra.items()
            if name not in known
        ]
    )
    return header
