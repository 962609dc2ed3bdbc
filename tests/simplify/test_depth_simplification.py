"""All methods for depth images take the same arguments and return the same type of result."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest

from manip3d import Intrinsics, _core, simplify

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
METHODS: dict[str, Callable[..., simplify.DepthSimplification]] = {
    "cs3": simplify.cs3,
    "relief": simplify.relief,
    "uniform": simplify.sample_depth,
}


def two_walls() -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    depth = np.full((48, 64), 1000, np.uint16)
    depth[:, 32:] = 2000
    return depth


@pytest.mark.parametrize("method", METHODS)
def test_common_arguments_and_result(method: str) -> None:
    found = METHODS[method](two_walls(), CAMERA, 200, color=None, registration=None, threads=1)
    assert isinstance(found, simplify.DepthSimplification)
    assert found.stop == "target"
    assert found.num_used <= found.num_vertices <= 200
    assert 0.8 < found.coverage <= 1.0  # a lattice stays half a cell inside
    assert found.bridges == pytest.approx(0.0, abs=0.02)
    assert METHODS[method](two_walls(), CAMERA, 10_000).stop == "all_points"


@pytest.mark.parametrize("method", METHODS)
def test_coverage_is_of_the_surface_without_long_edges(method: str) -> None:
    """Between the walls the dense surface has no triangle; what lies there bridges the gap."""
    whole = METHODS[method](two_walls(), CAMERA, 200)
    split = METHODS[method](two_walls(), CAMERA, 200, max_edge=0.5)
    assert whole.bridges < 0.02
    assert split.surface.max_edge == 0.5
    without = whole.with_faces(whole.faces[:0])
    assert without.coverage == 0.0
    assert type(without) is type(whole)


WIDE = Intrinsics(160, 120, 62.5, 62.5, 80.0, 60.0, distortion=(-0.31, 0.1, 0.0, 0.0, -0.012))
"""A wide lens whose model cannot be inverted towards the corners of the image."""


@pytest.mark.parametrize("method", METHODS)
def test_pixels_without_a_line_of_sight_lie_outside(method: str) -> None:
    depth = np.full((120, 160), 2.0, np.float32)
    depth[:10], depth[50, 80] = 0.0, np.nan
    seen = np.isfinite(WIDE.unproject(depth)).all(axis=2)
    lone = 1 - seen.sum() / np.count_nonzero(depth > 0)
    assert lone > 0.1
    found = METHODS[method](depth, WIDE, 200)
    assert found.outside == pytest.approx(lone)
    assert found.coverage > 0.8  # a lattice stays half a cell inside
    assert found.with_faces(found.faces[:1]).outside == pytest.approx(lone)


@pytest.mark.parametrize("join", [simplify.relief_cameras, simplify.cs3_cameras])
def test_pixels_without_a_line_of_sight_are_not_covered_by_joined_views(
    join: Callable[..., simplify.JointSimplification],
) -> None:
    depth = np.full((120, 160), 2.0, np.float32)
    seen = int(np.isfinite(WIDE.unproject(depth)).all(axis=2).sum())
    found = join([simplify.CameraView(depth, WIDE, pose=np.eye(4))], 300)
    assert found.num_measured == depth.size
    assert found.without_ray == depth.size - seen
    assert 0.9 * seen / depth.size < found.coverage <= seen / depth.size


def test_coverage_after_cutting_depth_steps_is_measured_anew() -> None:
    found = simplify.relief(two_walls(), CAMERA, 50)
    cut = simplify.cut_depth_steps(found, two_walls())
    assert cut.num_faces < found.num_faces
    u, v = found.pixels[cut.faces].mean(axis=1).T
    assert not np.any((u > 31) & (u < 32) & (v > 0))
    assert cut.coverage <= found.coverage


@pytest.mark.parametrize("method", METHODS)
def test_coverage_is_of_the_image_that_was_given(method: str) -> None:
    depth = two_walls()
    found = METHODS[method](depth, CAMERA, 200)
    expected = METHODS[method](two_walls(), CAMERA, 200).coverage
    depth[:] = 0  # a camera that reuses its buffer
    assert found.coverage == expected
    assert pickle.loads(pickle.dumps(found)).coverage == expected


@pytest.mark.parametrize("step", [None, 0.05])
def test_live_measures_coverage_when_it_is_asked_for(step: float | None) -> None:
    depth = two_walls()
    depth[10:20, 10:14] = 0
    found = simplify.relief(depth, CAMERA, 40, effort="live", depth_step=step)
    cut = simplify.cut_depth_steps(found, depth)
    assert found.cover is None
    assert cut.cover is None
    points, valid, rows_up = _core.unproject(depth, CAMERA, 1)
    options = _core.ReliefOptions()
    options.target_points = 40
    options.effort = _core.ReliefEffort.live
    options.from_origin = True
    options.max_step = np.inf if step is None else step
    options.focal = found.surface.focal
    measured = _core.ReliefSolver().run(
        points.reshape(*depth.shape, 3), valid.reshape(depth.shape).view(np.bool_), rows_up, options
    )
    names = "coverage", "bridges", "outside", "filled"
    shares = [getattr(found, name) for name in names]
    assert shares == pytest.approx(measured["cover"], abs=1e-12)
    if step is not None:
        left = [getattr(cut, name) for name in names]
        assert left == pytest.approx(measured["without_off"], abs=1e-12)


def test_coverage_agrees_with_what_relief_measures_itself() -> None:
    depth = two_walls()
    depth[10:20, 10:14] = 0
    found = simplify.relief(depth, CAMERA, 40, max_edge=0.5)
    assert found.cover is not None
    assert found.with_faces(found.faces).coverage == pytest.approx(found.cover[0], abs=1e-12)
    assert found.with_faces(found.faces).bridges == pytest.approx(found.cover[1], abs=1e-6)
