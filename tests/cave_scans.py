"""A small scan whose truth is known: a bumpy cave, and a ball to put into it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]
STEP = 0.3
"""Degrees."""


def cave(step: float = STEP, seed: int = 0, noise: float = 0.003) -> Points:
    """A terrestrial scan of a bumpy cave 5 to 11 m wide, on a regular grid."""
    random = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(-180 + step / 2, 180, step)),
        np.radians(np.arange(-40 + step / 2, 60, step)),
        indexing="ij",
    )
    r = 8 + 3 * np.sin(3 * azimuth) * np.cos(2 * elevation) + random.normal(0, noise, azimuth.shape)
    azimuth = azimuth + random.normal(0, 1e-5, azimuth.shape)
    level = np.cos(elevation)
    xyz = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    return (np.stack(xyz, axis=-1) * r[..., None]).reshape(-1, 3).astype(np.float32)


def ball(radius: float, count: int, seed: int = 0) -> Points:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return (radius * v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


CAVE = cave()
AHEAD = CAVE[len(CAVE) // 3 : 2 * len(CAVE) // 3]
"""A third of the turn, for tests that need a scan and no whole one."""
