"""Assign the points of a cloud to the rings (lasers) of a spinning scanner."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.arrays import as_array
from manip3d._util.arrays import rows as as_rows
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]

MIN_EXACT = 0.8
"""Least share of the points of an exact cloud that are on lines, steps and ranges; a few may be
edited."""

SAME_ELEVATION = 4e-7
"""Radians: largest difference between successive sorted elevations of one laser in an exact cloud;
single precision causes 1e-7."""

MIN_ALIKE = 3
"""Fewest points at one elevation that make a laser: two may be that close by chance."""

MAX_RINGS = 256
"""Largest number of lasers of a spinning scanner."""

BEGIN_OF_TURN = math.radians(2.0)
"""Radians: if azimuths descend, rings may begin up to this before the azimuth of the first
point."""

MIN_POINTS = 100
"""Fewest points of a ring that is found from the order of points."""

MIN_LABELLED = 8
"""Fewest points of a ring that the frame itself labels: enough to distinguish a line from an
object."""

NEAREST = 0.5
"""Metres from the axis: nearer points are the scanner's own case, or no returns."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points outside of the scanner's own case, with the laser of each.

    ``there`` marks them among the frame's rows. ``labels`` are numbers of lasers, -1 if unknown;
    ``is_by_order``: they were found from the order of points.
    """

    there: NDArray[np.bool_]
    points: Floats
    rho: Floats
    azimuth: Floats
    labels: NDArray[np.int64]
    is_by_order: bool

    @classmethod
    def of(cls, frame: LidarFrame | ArrayLike) -> Cloud:
        labels = frame.ring if isinstance(frame, LidarFrame) else None
        points = frame.points if isinstance(frame, LidarFrame) else as_array(frame, "frames")
        if points.ndim == 2 and points.shape[1] == 4:  # the fourth column holds intensities
            points = points[:, :3]
        xyz = as_rows(points, 3, np.float32, "frames").astype(np.float64)
        if not np.isfinite(xyz).all():
            raise InputError("frames: expected finite coordinates")
        rho = np.hypot(xyz[:, 0], xyz[:, 1])
        there = rho > NEAREST
        xyz, rho = xyz[there], rho[there]
        azimuth = np.mod(np.arctan2(xyz[:, 1], xyz[:, 0]), 2.0 * math.pi)
        if labels is None:
            kept = _by_exact_elevation(rho, xyz[:, 2])
        else:
            kept = labels[there].astype(np.int64)
        if kept is None:
            return cls(there, xyz, rho, azimuth, _by_order(azimuth), True)
        return cls(there, xyz, rho, azimuth, kept, False)

    @property
    def rings(self) -> list[NDArray[np.intp]]:
        """Rows of each laser that has enough points for a line, in the order of the labels."""
        order = np.argsort(self.labels, kind="stable")
        ends = np.flatnonzero(np.diff(self.labels[order])) + 1
        rings = np.split(order, ends)
        fewest = MIN_POINTS if self.is_by_order else MIN_LABELLED
        return [r for r in rings if len(r) >= fewest and self.labels[r[0]] >= 0]


def _by_exact_elevation(rho: Floats, z: Floats) -> NDArray[np.int64] | None:
    """Ring of each point (-1: none) if each laser has one constant elevation; else None."""
    elevation = np.arctan2(z, rho)
    order = np.argsort(elevation, kind="stable")
    run = np.cumsum(np.r_[False, np.diff(elevation[order]) > SAME_ELEVATION])
    size = np.bincount(run)
    is_ring = size >= MIN_ALIKE
    several = np.count_nonzero(size >= MIN_LABELLED)
    if size[is_ring].sum() < MIN_EXACT * len(rho) or several > MAX_RINGS:
        return None
    labels = np.empty(len(rho), np.int64)
    labels[order] = np.where(is_ring, np.cumsum(is_ring), -1)[run]
    return labels


def _by_order(azimuth: Floats) -> NDArray[np.int64]:
    """Ring of each point of a file with ring after ring."""
    if len(azimuth) < 2:
        return np.zeros(len(azimuth), np.int64)
    step, back = np.diff(azimuth), -math.pi
    if np.median(step) < 0.0:  # clockwise, from the azimuth of the first point
        step = np.diff(np.mod(azimuth[0] + BEGIN_OF_TURN - azimuth, 2.0 * math.pi))
        back = -1.0
    return np.cumsum(np.r_[False, step < back])
