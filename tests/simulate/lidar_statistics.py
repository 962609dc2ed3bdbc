"""The measures by which KITTI's clouds and simulated ones are compared."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from manip3d.simulate import lidar

BANDS = (-26.0, -16.0, -8.5, -4.0, -2.0, 0.0, 2.0, 90.0)
"""Bands of elevation, degrees: those of the data's description."""

Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class Statistics:
    """Statistics of one sweep; residuals as (median, 99 %, maximum) in millimetres."""

    points: int
    smallest_ring: int
    largest_ring: int
    farthest_m: float
    lowest_deg: float
    highest_deg: float
    median_slice: float
    bands_percent: tuple[float, ...]
    off_line_mm: tuple[float, ...]
    off_azimuth_mm: tuple[float, ...]
    off_range_mm: tuple[float, ...]
    shot_noise_mm: float
    missed_percent: float

    def row(self) -> str:
        """One line of a table."""
        return "  ".join(_short(value) for value in asdict(self).values())


def _short(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(f"{v:.2f}" if v < 2 else f"{v:.0f}" for v in value)
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def rings_in_file_order(points: Doubles) -> NDArray[np.int64]:
    """Ring of each point: a new one begins where the azimuth wraps from 360 to 0 degrees."""
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    return np.concatenate([[0], np.cumsum(np.diff(azimuth) < -180.0)])


def off_lattice(
    points: Doubles, ring: NDArray[np.int64]
) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """Distance from the laser's line, encoder step and range step, in mm; and the range in m."""
    table = lidar.lasers()
    x, y, z = points.T
    rho = np.hypot(x, y)
    slope, horizontal = table.slope[ring], table.horizontal_m[ring]
    reach = np.sqrt(rho**2 - horizontal**2)
    line = z - slope * reach - table.offset_m[ring]
    angle = np.degrees(np.arctan2(y, x) - np.arcsin(horizontal / rho)) - table.azimuth_deg[ring]
    turn = np.radians((angle + 0.045) % 0.09 - 0.045) * rho
    level = 1.0 / np.hypot(1.0, slope)
    distance = reach / level + table.offset_m[ring] * slope * level
    step = (1e3 * distance - table.range_offset_mm[ring] + 1.0) % 2.0 - 1.0
    return 1e3 * abs(line), 1e3 * abs(turn), abs(step), distance


def measure(points: NDArray[np.float32]) -> Statistics:
    """Statistics of a cloud in KITTI's order."""
    cloud = points.astype(float)
    ring = rings_in_file_order(cloud)
    assert ring.max() == 63
    size = np.bincount(ring, minlength=64)
    elevation = np.degrees(np.arctan2(cloud[:, 2], np.hypot(cloud[:, 0], cloud[:, 1])))
    azimuth = np.degrees(np.arctan2(cloud[:, 1], cloud[:, 0])) % 360.0
    line, turn, step, distance = off_lattice(cloud, ring)
    return Statistics(
        len(cloud),
        int(size.min()),
        int(size.max()),
        float(np.linalg.norm(cloud, axis=1).max()),
        float(np.percentile(elevation, 0.1)),
        float(elevation.max()),
        float(np.median(np.bincount((azimuth // 10).astype(int), minlength=36))),
        tuple((100.0 * np.histogram(elevation, BANDS)[0] / len(cloud)).tolist()),
        *(tuple(np.percentile(off, [50, 99, 100]).tolist()) for off in (line, turn, step)),
        _shot_noise(distance, ring),
        float(100.0 * (1.0 - np.median(size[26:40]) / 2148.5)),
    )


def _shot_noise(distance: Doubles, ring: NDArray[np.int64]) -> float:
    """Estimate the noise from second differences along rings, most of which are smooth ground."""
    second = [np.diff(distance[ring == k], 2) for k in range(24, 60, 4)]
    spread = [1.4826 * np.median(abs(s)) / np.sqrt(6.0) for s in second]
    return float(1e3 * np.median(spread))
