"""`relief(depth_step=...)`: steps in depth are boundaries of the surface from the start."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import InputError, Intrinsics, simplify

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def disc_before_slope() -> NDArray[np.uint16]:
    v, u = np.mgrid[0:48, 0:64]
    slope = 3000 + 8 * u + 4 * v
    return np.where(np.hypot(u - 30, v - 24) < 14, 1500, slope).astype(np.uint16)


def allowed(depth: NDArray[np.uint16], step: float) -> NDArray[np.bool_]:
    """Pixels with a cell of four, or of three, whose depths differ by no more than the step."""
    z = depth.astype(float)
    used = np.zeros(depth.shape, bool)
    for v in range(depth.shape[0] - 1):
        for u in range(depth.shape[1] - 1):
            corners = [(v, u), (v, u + 1), (v + 1, u + 1), (v + 1, u)]
            for skipped in range(4):
                three = [c for i, c in enumerate(corners) if i != skipped]
                values = [z[c] for c in three]
                if max(values) - min(values) <= step * min(values):
                    for c in three:
                        used[c] = True
    return used


@pytest.mark.parametrize("points", [20, 60, 300])
def test_steps_are_boundaries_and_cost_less_than_cutting(points: int) -> None:
    depth = disc_before_slope()
    found = simplify.relief(depth, CAMERA, points, depth_step=0.05)
    z = depth[found.pixels[:, 1], found.pixels[:, 0]][found.faces].astype(float)
    crossing = z.max(axis=1) > 1.5 * z.min(axis=1)
    assert crossing.mean() < 0.02  # bays of the disc's edge that were filled
    assert found.stop == "target"
    assert found.coverage > (0.98 if points > 20 else 0.9)
    uncut = simplify.relief(depth, CAMERA, points)
    cut = simplify.cut_depth_steps(uncut, depth)
    assert simplify.cut_depth_steps(found, depth).coverage >= cut.coverage
    assert cut.surface.depth_step == found.surface.depth_step == 0.05


def test_coverage_counts_the_pixels_of_the_surface_without_steps() -> None:
    """Half of the pixels of the dense mesh of both walls are the near wall's."""
    depth = np.full((48, 64), 1000, np.uint16)
    depth[:, 32:] = 2000
    depth[:, 31] = 1400  # flying pixels: no triangle without a step holds them
    found = simplify.relief(depth, CAMERA, 8, depth_step=0.05)
    near = found.faces[
        depth[found.pixels[:, 1], found.pixels[:, 0]][found.faces].max(axis=1) == 1000
    ]
    assert found.coverage == 1.0
    used = allowed(depth, 0.05)
    assert not used[:, 31].any()
    assert found.with_faces(near).coverage == pytest.approx(31 / 63)


def test_whatever_is_no_step_is_refused() -> None:
    for step in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="depth_step: expected > 0"):
            simplify.relief(disc_before_slope(), CAMERA, 20, depth_step=step)


def test_an_infinite_step_changes_nothing() -> None:
    depth = disc_before_slope()
    plain = simplify.relief(depth, CAMERA, 60)
    endless = simplify.relief(depth, CAMERA, 60, depth_step=float("inf"))
    assert np.array_equal(plain.pixels, endless.pixels)
    assert np.array_equal(plain.faces, endless.faces)


def test_a_stream_leaves_the_same_steps_out() -> None:
    depth = disc_before_slope()
    alone = simplify.relief(depth, CAMERA, 60, depth_step=0.05)
    stream = simplify.ReliefStream(CAMERA, 60, depth_step=0.05, stability=1.0, newest_share=1.0)
    for _ in range(2):
        found = stream.simplify(depth)
        np.testing.assert_array_equal(found.faces, alone.faces)
        assert found.surface.depth_step == 0.05
        assert found.coverage == alone.coverage
    with pytest.raises(InputError, match="depth_step"):
        simplify.ReliefStream(CAMERA, 60, depth_step=-1.0).simplify(depth)
