"""Scans of a walled yard as the drivers of three kinds of scanners compute them, unrounded."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manip3d import LidarFrame

Doubles = NDArray[np.float64]

GROUND, TILT, WALLS, POST = -1.6, (0.02, -0.03), (17.3, 11.9), (6.0, 3.0, 0.8)
"""Height of the ground below the scanner and its slope along x and y; half of the yard's length and
width; x, y and radius of a round post."""


@dataclass(frozen=True)
class Unit:
    """One scanner: its lasers, and how its driver writes a turn."""

    elevation: Doubles  # degrees
    beside: Doubles  # degrees of azimuth beside the encoder
    columns: int
    step: float  # metres
    start: tuple[float, float]  # metres of the beams off the axis, and above the origin
    is_by_ring: bool
    is_stepped: bool = True  # else azimuths are interpolated between packets


def hesai(lasers: int = 32) -> Unit:
    """Beams through the axis, firing after firing, 4 mm."""
    k = np.arange(lasers)
    beside = np.round(2.0 * np.sin(1.3 * k), 2)
    return Unit(np.linspace(14.7, -16.3, lasers), beside, 1200, 0.004, (0.0, 0.0), False)


def ouster(lasers: int = 32) -> Unit:
    """Beams that start off the axis, ring after ring clockwise, 1 mm."""
    beside = np.resize([3.11, 1.02, -1.05, -3.14], lasers)
    return Unit(np.linspace(21.3, -22.1, lasers), beside, 1024, 0.001, (0.0158, 0.0362), True)


def velodyne(lasers: int = 16) -> Unit:
    """Beams at interpolated azimuths, firing after firing, 2 mm."""
    elevation = np.linspace(-15.0, 15.0, lasers)
    return Unit(elevation, np.zeros(lasers), 1800, 0.002, (0.0, 0.011), False, is_stepped=False)


def _walls_and_ground(start: Doubles, beam: Doubles) -> Doubles:
    """Distance to what a beam meets first."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = beam[:, 2] - beam[:, :2] @ TILT
        above = start[:, 2] - start[:, :2] @ TILT - GROUND
        ground = np.where(rise < 0, -above / rise, np.inf)
        sides = [
            (np.sign(beam[:, axis]) * half - start[:, axis]) / beam[:, axis]
            for axis, half in enumerate(WALLS)
        ]
        middle = start[:, :2] - POST[:2]
        a = (beam[:, :2] ** 2).sum(axis=1)
        b = (middle * beam[:, :2]).sum(axis=1)
        root = np.sqrt(b * b - a * ((middle**2).sum(axis=1) - POST[2] ** 2))
        post = (-b - root) / a
    post = np.where(post > 0, post, np.inf)
    return np.minimum.reduce([ground, *sides, post])


def exact_scan(
    unit: Unit,
    seed: int = 0,
    *,
    labelled: bool = False,
    second_returns: float = 0.0,
    noise_m: float = 0.01,
    slips_deg: Doubles | None = None,
) -> LidarFrame:
    """A turn: noisy ranges in whole steps, coordinates in single precision.

    ``second_returns``: share of the firings that state another return a metre farther.
    ``slips_deg``: angles by which the stated azimuths of the columns are beside their places.
    """
    random = np.random.default_rng(seed)
    lasers = len(unit.elevation)
    shape = (lasers, unit.columns)
    ring, column = np.indices(shape).reshape(2, -1)
    if not unit.is_by_ring:
        column, ring = np.indices(shape[::-1]).reshape(2, -1)
    turn = column if unit.is_stepped else column + random.random(len(column))
    encoder = math.pi - turn * (2.0 * math.pi / unit.columns)
    if slips_deg is not None:
        encoder += np.radians(slips_deg)[column]
    angle = encoder + np.radians(unit.beside)[ring]
    level, rise = np.cos(np.radians(unit.elevation)), np.sin(np.radians(unit.elevation))
    beam = np.column_stack([level[ring] * np.cos(angle), level[ring] * np.sin(angle), rise[ring]])
    off, up = unit.start
    start = np.column_stack([off * np.cos(encoder), off * np.sin(encoder), np.full(len(ring), up)])
    distance = _walls_and_ground(start, beam) + random.normal(0.0, noise_m, len(ring))
    rows = np.flatnonzero(random.random(len(ring)) < 0.95)
    whole = np.rint(distance[rows] / unit.step)
    if second_returns:
        again = random.random(len(rows)) < second_returns
        rows = np.r_[rows, rows[again]]
        whole = np.r_[whole, whole[again] + round(1.0 / unit.step)]
    single = start[rows].astype(np.float32)
    single += beam[rows].astype(np.float32) * (whole * unit.step).astype(np.float32)[:, None]
    labels = ring[rows].astype(np.uint16) if labelled else None
    return LidarFrame(single, ring=labels, origin=(0.0, 0.0, 0.0))


def in_polar_steps(
    points: NDArray[np.float32], metres: float, azimuth_deg: float, elevation_deg: float
) -> NDArray[np.float32]:
    """The points with rounded polar coordinates; a step of 0 rounds nothing."""

    def rounded(values: Doubles, step: float) -> Doubles:
        return np.round(values / step) * step if step else values

    x, y, z = points.astype(np.float64).T
    distance = rounded(np.linalg.norm(points.astype(np.float64), axis=1), metres)
    azimuth = np.radians(rounded(np.degrees(np.arctan2(y, x)), azimuth_deg))
    rise = np.radians(rounded(np.degrees(np.arctan2(z, np.hypot(x, y))), elevation_deg))
    level = distance * np.cos(rise)
    places = [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(rise)]
    return np.column_stack(places).astype(np.float32)
