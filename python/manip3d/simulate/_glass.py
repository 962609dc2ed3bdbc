"""Lost laser pulses: they pass through windows, or windows and dark paint mirror them away."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from manip3d.simulate._textures import SIZE, noise

Floats = NDArray[np.float32]

TILE = 6.0
"""Period of the pattern of lost pulses, metres."""
SPECKLE = 0.15
"""Weight of the randomness of single pulses; the rest is common to neighbouring pulses."""


def lost(points: Floats, transmission: Floats, random: np.random.Generator) -> NDArray[np.bool_]:
    """Choose which of N pulses are lost.

    Neighbouring pulses are lost together, because KITTI's car windows and black cars are holes, not
    speckle.

    Parameters
    ----------
    points : (N, 3) float32, metres
        Points at which the pulses arrive, in the world's frame.
    transmission : (N,) float32
        Share of pulses that are lost at each point.
    random : numpy.random.Generator
        Generator of the randomness of single pulses.
    """
    row, column = _tile_place(points)
    fate = (1.0 - SPECKLE) * _fates()[row, column]
    fate += SPECKLE * random.random(len(points), np.float32)
    return np.asarray(fate < _quantile(transmission))


def _quantile(share: Floats) -> Floats:
    """Quantile of the sum of two uniform variables on [0, 1 - SPECKLE] and [0, SPECKLE]."""
    rest = 1.0 - SPECKLE
    end = np.sqrt(2.0 * rest * SPECKLE * np.minimum(share, 1.0 - share))
    middle = rest * share + 0.5 * SPECKLE
    at_end = np.minimum(share, 1.0 - share) < 0.5 * SPECKLE / rest
    return np.asarray(np.where(at_end, np.where(share < 0.5, end, 1.0 - end), middle))


def _tile_place(points: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of the pattern; no plane of a street or room maps to a line of it."""
    x, y, z = (points.astype(np.float64) * (SIZE / TILE)).T
    row = np.floor(z + 0.31 * x + 0.27 * y).astype(np.int64) % SIZE
    return row, np.floor(x + y * 1.13).astype(np.int64) % SIZE


@functools.cache
def _fates() -> Floats:
    """Smooth periodic noise with uniform distribution on (0, 1)."""
    field = noise(40, 1.4)
    rank = np.argsort(np.argsort(field.ravel()))
    return ((rank + 0.5) / rank.size).astype(np.float32).reshape(field.shape)
