"""The Hausdorff distance between two bounds, on shapes whose distance is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from manip3d import InputError, Mesh
from manip3d.metrics import closest_points, hausdorff_bound
from zoo import grid, sphere

TRIANGLE = Mesh([[0, 0, 0], [4, 0, 0], [0, 3, 0]], [[0, 1, 2]])


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
def test_a_corner_that_is_gone(tolerance: float) -> None:
    """(4, 0) is 2 away from (2, 0); the small triangle lies in the large one."""
    small = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    bound = hausdorff_bound(TRIANGLE, small, tolerance=tolerance)
    assert math.isclose(bound.forward[0], 2.0, rel_tol=1e-14)
    assert 2.0 <= bound.forward[1] <= 2.0 + tolerance * 5
    assert bound.backward[0] <= 1e-15
    assert bound.backward[1] <= tolerance * 5
    assert bound.diagonal == 5.0


def test_the_largest_distance_may_be_in_a_face() -> None:
    r"""A ridge between two rails: no vertex shows it.

    rails |  |     the plate's middle line is 1 away from both
    """
    plate = Mesh([[-1, 0, 0], [1, 0, 0], [1, 9, 0], [-1, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    rails = Mesh(
        [[-1, 0, 0], [-1, 9, 0], [-1, 9, 1], [1, 0, 0], [1, 9, 0], [1, 9, 1]],
        [[0, 1, 2], [3, 4, 5]],
    )
    bound = hausdorff_bound(plate, rails, tolerance=1e-4)
    assert bound.forward[0] <= 1.0 <= bound.forward[1]
    assert bound.forward[1] - bound.forward[0] <= 1e-4 * bound.diagonal * 1.001
    assert math.isclose(bound.backward[0], 1.0, rel_tol=1e-14)


def test_a_finer_triangulation_of_the_same_plate_is_at_no_distance() -> None:
    coarse, fine = Mesh(*grid(1, 1)), Mesh(*grid(40, 40))
    fine = fine.replace(vertices=fine.vertices / [40, 40, 1])
    bound = hausdorff_bound(coarse, fine, tolerance=1e-9)
    assert bound.upper <= 2e-9


def test_bounds_enclose_dense_samples_and_do_not_depend_on_threads() -> None:
    vertices, faces = sphere(40, 20)
    fine, coarse = Mesh(vertices, faces), Mesh(*sphere(12, 6))
    bound = hausdorff_bound(fine, coarse, tolerance=1e-3, threads=1)
    again = hausdorff_bound(fine, coarse, tolerance=1e-3, threads=4)
    assert bound == again
    rng = np.random.default_rng(0)
    corners = coarse.vertices[coarse.faces]
    points = np.einsum("fsk,fkd->fsd", rng.dirichlet([1, 1, 1], (len(corners), 500)), corners)
    sampled = closest_points(fine, points.reshape(-1, 3)).distance.max()
    assert sampled <= bound.backward[1]
    assert bound.backward[0] >= 0.97 * sampled
    # The flat faces of the coarse ball cut off less than its facets' sagitta.
    assert bound.upper < 1 - math.cos(math.pi / 6)


def test_the_order_of_units_and_places_does_not_matter() -> None:
    moved = TRIANGLE.replace(vertices=TRIANGLE.vertices * 1e-6 + 1e3)
    shifted = moved.replace(vertices=moved.vertices + np.array([0, 0, 1e-6]))
    bound = hausdorff_bound(moved, shifted, tolerance=1e-3)
    assert math.isclose(bound.upper, 1e-6, rel_tol=6e-3)


@pytest.mark.parametrize("size", [1e3, 1e5, 1e7])
def test_bounds_of_a_much_larger_mesh_are_in_order(size: float) -> None:
    vertices, faces = grid(11, 11)
    vertices = np.c_[vertices[:, :2], np.sin(0.7 * vertices[:, 0]) * np.cos(0.5 * vertices[:, 1])]
    larger = Mesh([*vertices, [size, 0, 0]], [*faces, [0, 1, len(vertices)]])
    bound = hausdorff_bound(Mesh(vertices, faces), larger)
    assert bound.forward[0] <= bound.forward[1]
    assert bound.backward[0] <= bound.backward[1]
    assert math.isclose(bound.backward[0], size, rel_tol=0.1)


@pytest.mark.parametrize("size", [1e9, 1e20, 1e200])
def test_a_tolerance_that_is_too_small_for_the_size_is_refused(size: float) -> None:
    larger = TRIANGLE.replace(vertices=TRIANGLE.vertices * size)
    with pytest.raises(InputError, match=r"tolerance: expected at least .* of these sizes"):
        hausdorff_bound(TRIANGLE, larger)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 9e-13, math.nan])
def test_a_tolerance_is_above_rounding(tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        hausdorff_bound(TRIANGLE, TRIANGLE, tolerance=tolerance)
