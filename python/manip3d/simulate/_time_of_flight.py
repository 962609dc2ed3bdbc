"""Faults of a time-of-flight camera: noise, flying pixels, missing pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

SIGMA_AT_2_M = 1.5e-3
"""Standard deviation of the depth at 2 m, metres; it grows with the square of the depth."""

MAX_DEPTH = 8.0
"""Metres beyond which nothing is measured."""

FLYING = 0.5
"""Share of the pixels at an edge that mix the light of both surfaces."""

DROPPED = 0.001
"""Share of pixels without a measurement, at random."""

_EDGE = 0.05  # least step at an edge, as a share of the depth
_GRAZING = 0.10  # cosine below which too little light comes back


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured depth, metres (0: none), and a mask of pixels that lie between two surfaces."""

    depth: Floats
    flying: Mask


def measure(depth: Floats, slant: Floats, scale: float, random: np.random.Generator) -> Measured:
    """Simulate one image of the sensor.

    Parameters
    ----------
    depth : (H, W) float32, metres
        Exact depth; 0: no surface.
    slant : (H, W) float32
        Cosine of the angle between the line of sight and the surface's normal.
    scale : float
        Factor on all faults; 0: no faults.
    random : numpy.random.Generator
        Generator of the faults.
    """
    if scale == 0.0:
        seen = np.where(depth <= MAX_DEPTH, depth, np.float32(0.0))
        return Measured(seen, np.zeros(depth.shape, np.bool_))
    rows, columns, near, far = _edges(depth)
    picked = random.random(len(rows)) < min(1.0, FLYING * scale)
    rows, columns, near, far = rows[picked], columns[picked], near[picked], far[picked]
    measured = depth.copy()
    # The light of two surfaces adds up to a phase between theirs.
    measured[rows, columns] = near + random.uniform(0.1, 0.9, len(near)) * (far - near)
    flying = np.zeros(depth.shape, np.bool_)
    flying[rows, columns] = True
    sigma = np.float32(scale * SIGMA_AT_2_M / 4.0) * measured * measured
    noisy = measured + sigma * random.standard_normal(depth.shape, np.float32)
    lost = random.random(depth.shape, np.float32) < DROPPED * scale
    lost |= slant < _GRAZING
    noisy[lost | (measured == 0.0) | (measured > MAX_DEPTH)] = 0.0
    return Measured(noisy, flying & ~lost)


def _edges(depth: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats]:
    """Pixels at a step of the depth, and the nearer and the farther depth there."""
    beyond = np.where(depth > 0.0, depth, np.float32(MAX_DEPTH))
    near, far = _neighbours(beyond, np.minimum), _neighbours(beyond, np.maximum)
    rows, columns = np.nonzero(far - near > _EDGE * near)
    return rows, columns, near[rows, columns], far[rows, columns]


def _neighbours(depth: Floats, choose: np.ufunc) -> Floats:
    """Smallest or largest depth of each pixel and its four neighbours, as ``choose`` selects."""
    result = depth.copy()
    for axis in range(2):
        lower, upper = [slice(None)] * 2, [slice(None)] * 2
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        one, other = tuple(lower), tuple(upper)
        choose(result[one], depth[other], out=result[one])
        choose(result[other], depth[one], out=result[other])
    return result
