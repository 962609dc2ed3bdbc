"""A courtyard with boxes, seen by a spinning scanner that drives through it: turn after turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import lattice_scans as scans
from manip3d.lidar import Box

LATTICE = scans.lattice()
WALLS = (-26.0, 31.0, -14.0, 11.0)
"""Metres: x and y of the walls of the yard."""
BOXES = (
    ((9.0, 4.0, -1.73), (12.0, 6.0, 0.2)),
    ((-12.0, -8.0, -1.73), (-8.0, -6.0, 0.0)),
    ((3.0, -9.0, -1.73), (4.0, -8.0, 1.5)),
    ((16.0, -6.0, -1.73), (16.5, -4.5, 0.5)),
    ((-16.0, 5.0, -1.73), (-13.0, 5.8, 0.4)),
)
"""Metres: corners of the boxes that stand in it."""


def turn(
    position: float, seed: int, boxes: tuple[tuple[tuple[float, ...], ...], ...] = BOXES
) -> NDArray[np.float32]:
    """(N, 3): what the scanner sees at (position, 0), its own coordinates, whole millimetres."""
    rng = np.random.default_rng(seed)
    fired = scans.firings(rng)
    rings = np.arange(len(LATTICE.slope))
    ring, count = (a.ravel() for a in np.meshgrid(rings, fired, indexing="ij"))
    angle = LATTICE.azimuth[ring] + count * (2.0 * np.pi / scans.STEPS)
    slope, offset = LATTICE.slope[ring], LATTICE.offset[ring]
    cos, sin = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        down = np.where(slope < -1e-3, (scans.GROUND - offset) / slope, np.inf)
        ahead = np.where(cos > 0, WALLS[1] - position, WALLS[0] - position) / cos
        aside = np.abs(np.where(sin > 0, WALLS[3], WALLS[2]) / sin)
        reach = np.minimum(np.minimum(down, ahead), aside)
        for low, high in boxes:
            enter, leave = np.zeros_like(reach), np.full_like(reach, np.inf)
            for axis, (start, way) in enumerate(((position, cos), (0.0, sin), (offset, slope))):
                first, last = (low[axis] - start) / way, (high[axis] - start) / way
                enter = np.maximum(enter, np.minimum(first, last))
                leave = np.minimum(leave, np.maximum(first, last))
            reach = np.where((enter < leave) & (enter > 0.0) & (enter < reach), enter, reach)
    reach = reach + rng.normal(0.0, 0.008, len(reach))
    kept = (rng.random(len(reach)) >= 0.003) & (reach < 80.0)
    points = scans.rounded(scans.beam_points(LATTICE, ring[kept], count[kept], reach[kept]))
    return points[scans.in_file_order(LATTICE, points)]


def box_at(number: int, position: float) -> Box:
    """One of the boxes in the coordinates of a scanner at (position, 0), above the ground."""
    low, high = (np.array(corner) for corner in BOXES[number])
    low[2] += 0.25
    low, high = low - 0.05, high + 0.05
    center, size = (low + high) / 2.0 - [position, 0.0, 0.0], high - low
    return Box(tuple(center.tolist()), tuple(size.tolist()))
