"""Games that have begun, for tests of their rules."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import capsule_body
from manip3d.phantom.games import GameState, begin

PLAYER = capsule_body.painted(0).skeletons[0]


def no_touch(
    start: NDArray[np.float32], end: NDArray[np.float32], radius: NDArray[np.float32]
) -> NDArray[np.int8]:
    """Let no bone touch a ball."""
    return np.full(len(start), -1, np.int8)


def started(name: str = "bubbles", **options: int) -> GameState:
    """Return the first state of a game of `PLAYER`."""
    state = begin(name, PLAYER, **options)
    assert state is not None
    return state
