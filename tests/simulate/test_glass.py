"""Glass and dark paint: the right share of pulses is lost, in patches."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d.simulate._glass import TILE, lost


def plane(normal: int) -> np.ndarray[tuple[int, int, int], np.dtype[np.float32]]:
    """(300, 300, 3) places 2 cm apart on a plane across one axis."""
    s = np.linspace(0.0, TILE, 300)
    u, v = np.meshgrid(s, s, indexing="ij")
    axes = [u, v]
    axes.insert(normal, np.full_like(u, 1.7))
    return np.stack(axes, axis=-1).astype(np.float32)


@pytest.mark.parametrize("normal", [0, 1, 2])
@pytest.mark.parametrize("share", [0.25, 0.6, 0.93])
def test_neighbours_share_their_fate(normal: int, share: float) -> None:
    places = plane(normal)
    random = np.random.default_rng(0)
    gone = lost(places.reshape(-1, 3), np.full(places[..., 0].size, share, np.float32), random)
    gone = gone.reshape(places.shape[:2])
    differ = 0.5 * (gone[1:] != gone[:-1]).mean() + 0.5 * (gone[:, 1:] != gone[:, :-1]).mean()
    by_chance = 2 * gone.mean() * (1 - gone.mean())
    assert differ < 0.8 * by_chance  # 1: each pulse for itself


@pytest.mark.parametrize("share", [0.03, 0.25, 0.6, 0.93, 0.98])
def test_share_over_a_wide_area(share: float) -> None:
    random = np.random.default_rng(1)
    places = random.uniform(-200.0, 200.0, (50_000, 3)).astype(np.float32)
    gone = lost(places, np.full(len(places), share, np.float32), random)
    assert gone.mean() == pytest.approx(share, abs=0.01)


def test_all_and_nothing() -> None:
    places, random = plane(0).reshape(-1, 3), np.random.default_rng(0)
    assert not lost(places, np.zeros(len(places), np.float32), random).any()
    assert lost(places, np.ones(len(places), np.float32), random).all()
