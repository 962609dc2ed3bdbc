"""Simulated depth images: exact surfaces, and faults that are where the masks say."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import InputError
from manip3d.simulate import depth as simulated
from manip3d.simulate.depth import DepthScene

SCENES = {
    "person": lambda: simulated.person(width=160, height=120),
    "person, wall": lambda: simulated.person(width=160, height=120, wall=True),
    "room": lambda: simulated.room(width=160, height=120),
}


@pytest.fixture(scope="module", params=SCENES)
def scene(request: pytest.FixtureRequest) -> DepthScene:
    return SCENES[request.param]()


def test_without_faults_the_sensor_delivers_the_truth(scene: DepthScene) -> None:
    capture = scene.capture(noise=0.0, flying=0.0, dropouts=0.0)
    there = np.isfinite(scene.depth)
    assert not capture.flying.any()
    np.testing.assert_array_equal(capture.depth > 0, there & ~capture.dropped)
    seen = capture.depth > 0
    assert np.abs(capture.depth[seen] / 1000.0 - scene.depth[seen]).max() <= 0.5e-3 + 1e-12


def test_the_back_wall_and_the_floor_are_where_they_were_put() -> None:
    scene = simulated.person(width=160, height=120, wall=True)
    assert scene.depth[10, 5] == pytest.approx(3.3)
    v = 118
    slope = (v - scene.intrinsics.cy) / scene.intrinsics.fy
    assert scene.depth[v, 5] == pytest.approx(0.95 / slope)


def test_round_surfaces_have_their_closed_form() -> None:
    """The ball on the desk, against the quadratic formula written out for its middle."""
    scene = simulated.room()
    x, y, z, r = -0.6, 0.33, 1.7, 0.12
    k = scene.intrinsics
    u, v = round(k.fx * x / z + k.cx), round(k.fy * y / z + k.cy)
    d = np.array([(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0])
    c = np.array([x, y, z])
    expected = (d @ c - np.sqrt((d @ c) ** 2 - (d @ d) * (c @ c - r * r))) / (d @ d)
    assert scene.depth[v, u] == pytest.approx(expected)


def test_noise_grows_with_the_square_of_the_depth(scene: DepthScene) -> None:
    frames = [c.depth / 1000.0 for c in scene.frames(40, rng=1)]
    stack = np.array(frames)
    always = (stack > 0).all(axis=0)
    flat = always & ~np.any([c.flying for c in scene.frames(40, rng=1)], axis=0)
    ratio = stack.std(axis=0)[flat] / (simulated.NOISE_AT_ONE_METRE * scene.depth[flat] ** 2)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)


def test_flying_pixels_float_between_their_surfaces(scene: DepthScene) -> None:
    capture = scene.capture(noise=0.0, rng=2)
    assert capture.flying.sum() > 50
    depth = capture.depth[capture.flying] / 1000.0
    everything = np.where(np.isfinite(scene.depth), scene.depth, scene.behind)
    padded = np.pad(everything, 1, mode="edge")
    around = np.array(
        [padded[i : i + 120, j : j + 160][capture.flying] for i in range(3) for j in range(3)]
    )
    way = (depth - around.min(axis=0)) / (around.max(axis=0) - around.min(axis=0))
    assert way.min() > 0.14
    assert way.max() < 0.86
    measured = capture.depth > 0
    off = measured & ~(np.abs(capture.depth / 1000.0 - scene.depth) < 0.6e-3)
    assert not (off & ~capture.flying).any()
    assert off[capture.flying].mean() > 0.99


def test_dropouts_are_masked(scene: DepthScene) -> None:
    capture = scene.capture(dropouts=0.1, rng=2)
    assert not (capture.depth[capture.dropped] > 0).any()
    there = np.isfinite(scene.depth)
    assert capture.dropped[there].mean() == pytest.approx(0.1, abs=0.03)


def test_seeds_repeat_and_differ(scene: DepthScene) -> None:
    first, again, other = (scene.capture(rng=seed).depth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.01
    frames = [c.depth for c in scene.frames(2, rng=1)]
    assert (frames[0] != frames[1]).any()


def test_arguments_are_checked(scene: DepthScene) -> None:
    with pytest.raises(InputError, match="noise: expected >= 0, got nan"):
        scene.capture(noise=float("nan"))
    with pytest.raises(InputError, match="flying: expected a probability"):
        scene.capture(flying=1.5)
    with pytest.raises(InputError, match="at least 16"):
        simulated.room(width=8)
