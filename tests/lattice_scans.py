"""A spinning scanner on a flat street between walls, in NumPy: scans on an exact lattice."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from manip3d.authenticate import SensorLattice

STEPS = 4000
GROUND = -1.73


def lattice(rings: int = 64) -> SensorLattice:
    """HDL-64E's: two blocks of lasers 7 cm apart, left and right of the axis."""
    upper = rings // 2
    angles = np.radians(
        np.concatenate([np.linspace(2.0, -8.5, upper), np.linspace(-9.0, -24.5, rings - upper)])
    )
    k = np.arange(rings)
    return SensorLattice(
        slope=np.tan(angles),
        offset=np.where(k < upper, 0.205, 0.12),
        lateral=np.where(k % 2 == 0, -0.026, 0.026),
        azimuth=np.mod(np.radians(7.3 * np.sin(1.7 * k)), 2.0 * math.pi),
        range_phase=np.mod(0.00071 * k, 0.002),
        center=np.full(rings, 10.0),
        slope_error=np.zeros(rings),
        steps=STEPS,
        range_step=0.002,
        coordinate_step=0.001,
        incoherence=0.065,
    )


def beam_points(
    sensor: SensorLattice,
    ring: NDArray[np.int_],
    count: NDArray[np.int_],
    reach: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Points at horizontal distances along beams, ranges rounded to the range step."""
    slope, offset, lateral = sensor.slope[ring], sensor.offset[ring], sensor.lateral[ring]
    cosine = 1.0 / np.sqrt(1.0 + slope**2)
    rho = np.hypot(reach, lateral)
    if sensor.range_step:
        span = (reach + (slope * rho + offset) * slope) * cosine - sensor.range_phase[ring]
        whole = np.round(span / sensor.range_step) * sensor.range_step
        reach = reach + (whole - span) * cosine
        rho = np.hypot(reach, lateral)
    angle = sensor.azimuth[ring] + count * (2.0 * math.pi / sensor.steps)
    x = reach * np.cos(angle) - lateral * np.sin(angle)
    y = reach * np.sin(angle) + lateral * np.cos(angle)
    return np.column_stack([x, y, slope * rho + offset])


def in_file_order(sensor: SensorLattice, points: NDArray[np.float32]) -> NDArray[np.intp]:
    """Order of KITTI's files: ring after ring, azimuths ascending from 0."""
    reading = sensor.read(points)
    return np.lexsort((reading.azimuth, reading.ring))


def rounded(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Whole millimetres in float32."""
    return np.ascontiguousarray(np.round(points * 1000.0) / 1000.0, np.float32)


def firings(rng: np.random.Generator) -> NDArray[np.int_]:
    """Counts at which the head fires: every second, now and then the next one."""
    counts = np.cumsum(rng.choice([1, 2], p=[0.15, 0.85], size=STEPS)) - 1
    return counts[counts < STEPS]


def scan(
    rng: np.random.Generator, sensor: SensorLattice | None = None, *, lost: float = 0.003
) -> NDArray[np.float32]:
    """(N, 3): a clean scan in KITTI's order, whole millimetres; a share of returns is lost."""
    sensor = sensor or lattice()
    fired = firings(rng)
    ring, count = (
        a.ravel() for a in np.meshgrid(np.arange(len(sensor.slope)), fired, indexing="ij")
    )
    angle = sensor.azimuth[ring] + count * (2.0 * math.pi / STEPS)
    walls = 15.0 + 10.0 * np.sin(2.0 * angle + rng.uniform(0.0, 6.0)) ** 2
    climb = 0.03 * np.cos(angle) + 0.02 * np.sin(angle)  # a street that is not level
    fall = climb - sensor.slope[ring]
    height = sensor.offset[ring] - GROUND
    ground = np.where(fall > 0.01, height / np.where(fall > 0.01, fall, 1.0), np.inf)
    reach = np.minimum(walls, ground) + rng.normal(0.0, 0.01, len(ring))
    kept = rng.random(len(ring)) >= lost
    points = rounded(beam_points(sensor, ring[kept], count[kept], reach[kept]))
    return points[in_file_order(sensor, points)]


def reflectances(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Whole hundredths with the scanner's noise, some of them 0."""
    rng = np.random.default_rng(3)
    values = 0.3 + 0.25 * np.sin(points[:, 0]) + rng.normal(0.0, 0.03, len(points))
    values[rng.random(len(points)) < 0.03] = 0.0
    return np.round(np.clip(values, 0.0, 0.99), 2).astype(np.float32)
