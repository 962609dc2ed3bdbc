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


def noisy_disc(seed: int) -> NDArray[np.uint16]:
    """Noise makes steps on the surfaces too, and some faces join what they keep apart."""
    rng = np.random.default_rng(seed)
    depth = disc_before_slope() * rng.normal(1.0, 0.03, (48, 64))
    depth[rng.random(depth.shape) < 0.05] = 0
    return depth.astype(np.uint16)


def test_a_relief_knows_its_faces_across_steps() -> None:
    """With other triangles it knows none: they are looked for in the image then."""
    num_cut = 0
    for seed in range(6):
        depth = noisy_disc(seed)
        metres = np.where(depth > 0, depth / np.float32(1000), np.float32(np.nan))
        for image in (depth, metres):
            for points in (300, 100, 20):
                found = simplify.relief(image, CAMERA, points, depth_step=0.05)
                cut = simplify.cut_depth_steps(found, image)
                looked_for = simplify.cut_depth_steps(found.with_faces(found.faces), image)
                assert np.array_equal(cut.faces, looked_for.faces)
                assert cut.coverage == looked_for.coverage
                assert cut.bridges == looked_for.bridges
                assert cut.outside == looked_for.outside
                num_cut += found.num_faces - cut.num_faces
    assert num_cut > 20


def test_faces_across_steps_of_another_image_or_rule_are_looked_for() -> None:
    depth = noisy_disc(0)
    found = simplify.relief(depth, CAMERA, 300, depth_step=0.05)
    assert simplify.cut_depth_steps(found, depth).num_faces < found.num_faces
    wall = np.full((48, 64), 3000, np.uint16)
    assert simplify.cut_depth_steps(found, wall).num_faces == found.num_faces
    assert simplify.cut_depth_steps(found, depth, step=10.0).num_faces == found.num_faces
    # Taken for metres, the depths are so large that noise explains each step.
    far = simplify.cut_depth_steps(found, depth.astype(np.float32))
    assert far.num_faces == found.num_faces
    wide = Intrinsics(64, 48, 6.0, 6.0, 31.5, 23.5)
    assert simplify.cut_depth_steps(found, depth, intrinsics=wide).num_faces == found.num_faces
