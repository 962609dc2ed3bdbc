"""Scans as arguments: what attacks and detectors share."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from manip3d._arrays import rows
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    ScanLike: TypeAlias = LidarFrame | ArrayLike


class Scan(NamedTuple):
    """A scan as the core takes it; ``intensity`` has no rows where there is none."""

    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    frame: LidarFrame | None


def to_scan(values: ScanLike) -> Scan:
    """A scan from a frame, (N, 3) points, or (N, 4) points with intensity."""
    none = np.empty(0, np.float32)
    if isinstance(values, LidarFrame):
        return Scan(values.points, none if values.intensity is None else values.intensity, values)
    array = np.asarray(values)
    if array.ndim == 2 and array.shape[1] == 4:
        return Scan(
            rows(array[:, :3], 3, np.float32, "scan"),
            np.ascontiguousarray(array[:, 3], np.float32),
            None,
        )
    return Scan(rows(array, 3, np.float32, "scan"), none, None)


def place(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Three finite numbers."""
    array = np.asarray(values, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name}: expected three finite numbers, got {values!r}")
    return array


def origin_of(origin: ArrayLike | None, scan: Scan) -> NDArray[np.float64]:
    """Where the scanner stood: as given, else as the frame says, else (0, 0, 0)."""
    if origin is None and scan.frame is not None and scan.frame.origin is not None:
        return place(scan.frame.origin, "origin")
    return np.zeros(3) if origin is None else place(origin, "origin")
