"""Pulses that do not come back: they pass a window or are mirrored away by it or by dark paint."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from manip3d.simulate._textures import SIZE, noise

Floats = NDArray[np.float32]

TILE = 6.0
"""Metres after which the pattern repeats."""
SPECKLE = 0.15
"""Share of chance from pulse to pulse; the rest is the same for neighbours."""


def lost(points: Floats, transmission: Floats, random: np.random.Generator) -> NDArray[np.bool_]:
    """Which of N pulses do not come back.

    Neighbours share their fate: KITTI's car windows and black cars are holes, not speckle.

    Parameters
    ----------
    points : (N, 3) float32, metres
        Where the pulses arrive, in the world.
    transmission : (N,) float32
        Share that is lost.
    random : numpy.random.Generator
        Generator of the chance events from pulse to pulse.
    """
    row, column = _tile_place(points)
    fate = (1.0 - SPECKLE) * _fates()[row, column]
    fate += SPECKLE * random.random(len(points), np.float32)
    return np.asarray(fate < _quantile(transmission))


def _quantile(share: Floats) -> Floats:
    """Below it lies this share of sums of two even spreads of lengths 1 - SPECKLE and SPECKLE."""
    rest = 1.0 - SPECKLE
    end = np.sqrt(2.0 * rest * SPECKLE * np.minimum(share, 1.0 - share))
    middle = rest * share + 0.5 * SPECKLE
    at_end = np.minimum(share, 1.0 - share) < 0.5 * SPECKLE / rest
    return np.asarray(np.where(at_end, np.where(share < 0.5, end, 1.0 - end), middle))


def _tile_place(points: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of the pattern: no plane of a street or a room maps to a line of it."""
    x, y, z = (points.astype(np.float64) * (SIZE / TILE)).T
    row = np.floor(z + 0.31 * x + 0.27 * y).astype(np.int64) % SIZE
    return row, np.floor(x + y * 1.13).astype(np.int64) % SIZE


@functools.cache
def _fates() -> Floats:
    """Smooth periodic noise, spread evenly over 0 to 1."""
    field = noise(40, 1.4)
    rank = np.argsort(np.argsort(field.ravel()))
    return ((rank + 0.5) / rank.size).astype(np.float32).reshape(field.shape)
