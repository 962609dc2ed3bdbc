"""Clouds by the rings of a spinning scanner: which points are of one laser."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.arrays import rows as as_rows
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]

LEAST_EXACT = 0.8
"""Share of the points of an exact cloud that are on lines, steps and ranges: edits spoil a few."""

SAME_ELEVATION = 4e-7
"""Radians between neighbours among the sorted elevations of a laser of an exact cloud, of which
single precision leaves 1e-7."""

FEWEST_ALIKE = 3
"""Fewest points at one elevation that make a laser: chance leaves two as near to each other."""

MOST_RINGS = 256
"""Lasers that a spinning scanner has at most."""

BEGIN_OF_TURN = math.radians(2.0)
"""Azimuth before that of the first point at which rings may begin, where azimuths descend."""

FEWEST_POINTS = 100
"""A ring with fewer points is not taken for one, unless the frame says which points are its own."""

FEWEST_LABELLED = 8
"""Fewest points of a ring that the frame names: enough to tell a line from an object."""

NEAREST = 0.5
"""Metres from the axis: nearer there is the scanner's own case, or no return at all."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points that are not the scanner's own case, and the laser of each: -1 if none is known."""

    there: NDArray[np.bool_]
    points: Floats
    rho: Floats
    azimuth: Floats
    labels: NDArray[np.int64]
    is_by_order: bool

    @classmethod
    def of(cls, frame: LidarFrame | ArrayLike) -> Cloud:
        labels = frame.ring if isinstance(frame, LidarFrame) else None
        points = frame.points if isinstance(frame, LidarFrame) else frame
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
        fewest = FEWEST_POINTS if self.is_by_order else FEWEST_LABELLED
        return [r for r in rings if len(r) >= fewest and self.labels[r[0]] >= 0]


def _by_exact_elevation(rho: Floats, z: Floats) -> NDArray[np.int64] | None:
    """Ring of each point, -1 where it has none, if elevations are the same in each; else None."""
    elevation = np.arctan2(z, rho)
    order = np.argsort(elevation, kind="stable")
    run = np.cumsum(np.r_[False, np.diff(elevation[order]) > SAME_ELEVATION])
    size = np.bincount(run)
    is_ring = size >= FEWEST_ALIKE
    several = np.count_nonzero(size >= FEWEST_LABELLED)
    if size[is_ring].sum() < LEAST_EXACT * len(rho) or several > MOST_RINGS:
        return None
    labels = np.empty(len(rho), np.int64)
    labels[order] = np.where(is_ring, np.cumsum(is_ring), -1)[run]
    return labels


def _by_order(azimuth: Floats) -> NDArray[np.int64]:
    """Number of the ring of each point of a file that has ring after ring."""
    if len(azimuth) < 2:
        return np.zeros(len(azimuth), np.int64)
    step, back = np.diff(azimuth), -math.pi
    if np.median(step) < 0.0:  # clockwise, from wherever the first ring begins
        step = np.diff(np.mod(azimuth[0] + BEGIN_OF_TURN - azimuth, 2.0 * math.pi))
        back = -1.0
    return np.cumsum(np.r_[False, step < back])
