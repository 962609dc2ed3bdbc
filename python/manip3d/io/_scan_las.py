"""Reading and writing of LAS and LAZ through laspy and lazrs, with all dimensions, losslessly."""

from __future__ import annotations

import copy
import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.errors import FormatError, InputError, MissingExtraError
from manip3d.io._files import atomic_path
from manip3d.io._las_checks import check_las
from manip3d.io._las_units import stated_unit
from manip3d.io._scan_tables import (
    exact_coordinates,
    general_fields,
    map_coordinates,
    measured_points,
    near_zero,
)
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from numpy.typing import NDArray


def _laspy() -> Any:
    try:
        import laspy
    except ImportError:
        raise MissingExtraError("laspy", "las") from None
    return laspy


def read(path: Path, limit: int) -> LidarFrame:
    """Read a scan, see `manip3d.io.read_scan`; points far from 0 are shifted near 0."""
    laspy = _laspy()
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
            if name not in ("X", "Y", "Z")
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
    return LidarFrame(
        points=points,
        intensity=columns.pop(name).astype(np.float32),
        source=str(path),
        fields=columns,
        exact=exact_coordinates(exact, points),
        format=layout,
    )


def write(frame: LidarFrame, path: Path) -> None:
    """Write a scan, see `manip3d.io.write_scan`."""
    laspy = _laspy()
    own = frame.format is not None and frame.format.name == "las"
    if own and frame.format is not None:
        header = _without_octree(copy.deepcopy(frame.format.header["las"]))
        exact = frame.exact
        if exact is None:
            exact = frame.format.file_coordinates(frame.points)
        columns = dict(frame.fields)
    else:
        of_map = map_coordinates(frame, "las")
        exact = frame.points.astype(np.float64) if of_map is None else of_map
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
    compressed = path.suffix.lower() == ".laz"
    with atomic_path(path) as temporary, temporary.open("wb") as disk:
        # Written to memory first, because lazrs does not name the cause if the disk is full.
        memory = io.BytesIO()
        las.write(memory if compressed else disk, do_compress=compressed)
        disk.write(memory.getbuffer())


def _without_octree(header: Any) -> Any:
    """Remove the octree records of a COPC file, which do not fit rows that laspy writes anew."""
    for records in (header.vlrs, header.evlrs):
        if records is not None:
            records[:] = [record for record in records if record.user_id.strip("\0 ") != "copc"]
    return header


def _fitting(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        values = np.clip(np.rint(values), limits.min, limits.max)
    return values.astype(dtype)


def _new_header(
    laspy: Any, exact: NDArray[np.float64], columns: dict[str, NDArray[Any]], frame: LidarFrame
) -> Any:
    """Return a header with steps of 0.1 mm; other columns become extra dimensions."""
    is_colored = all(name in columns for name in ("red", "green", "blue"))
    header = laspy.LasHeader(point_format=7 if is_colored else 6, version="1.4")
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
