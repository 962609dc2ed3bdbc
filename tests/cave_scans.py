"""A small scan whose truth is known: a bumpy cave, and a ball to put into it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from manip3d import simulate

Points = NDArray[np.float32]
STEP = 0.3
"""Degrees."""
WHOLE_TURN = (-180.0, 180.0), (-40.0, 60.0)


def cave(step: float = STEP, seed: int = 0, noise: float = 0.003) -> Points:
    """A whole turn of a terrestrial scanner in a cave 5 to 11 m wide."""
    frame = simulate.cave(step, field_of_view=WHOLE_TURN, range_noise=noise, rng=seed)
    return frame.points


def ball(radius: float, count: int, seed: int = 0) -> Points:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return (radius * v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


CAVE = cave()
AHEAD = CAVE[len(CAVE) // 3 : 2 * len(CAVE) // 3]
"""A third of the turn, for tests that need a scan and no whole one."""
