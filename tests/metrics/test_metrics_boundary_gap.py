"""Boundary curves: known distances, cracks, seams, meshes without a boundary."""

from __future__ import annotations

import math

import numpy as np
import pytest

import manip3d
from manip3d.metrics import boundary_gap
from metrics_oracles import plane, sphere


def moved(mesh: manip3d.Mesh, offset: list[float], scale: float = 1.0) -> manip3d.Mesh:
    return mesh.replace(vertices=mesh.vertices * scale + np.array(offset))


def exploded(mesh: manip3d.Mesh) -> manip3d.Mesh:
    """Every face with vertices of its own."""
    return manip3d.Mesh(
        mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * mesh.num_faces).reshape(-1, 3)
    )


def test_a_square_inside_a_square() -> None:
    outer, inner = plane(8), moved(plane(6), [1, 1, 0])
    gap = boundary_gap(outer, inner)
    assert gap.diagonal == pytest.approx(8 * math.sqrt(2))
    back = gap.backward
    assert (back.mean, back.rms, back.max) == pytest.approx((1, 1, 1), rel=1e-12)
    corner = (math.sqrt(2) + math.asinh(1)) / 2  # integral of sqrt(1 + t^2) over [0, 1]
    assert gap.forward.mean == pytest.approx((6 + 2 * corner) / 8, rel=1e-5)
    assert gap.forward.rms == pytest.approx(math.sqrt((6 + 2 * 4 / 3) / 8), rel=1e-5)
    assert gap.forward.max == pytest.approx(math.sqrt(2), rel=1e-12)  # at a vertex
    assert (gap.cracks, gap.crack_length) == (24, pytest.approx(24))


def test_coarser_boundary_on_the_same_curve() -> None:
    gap = boundary_gap(plane(8), moved(plane(1), [0, 0, 0], scale=8))
    assert gap.forward.max < 1e-15
    assert gap.backward.max < 1e-15
    assert (gap.cracks, gap.crack_length) == (0, 0)


def test_statistics_are_by_length() -> None:
    """A long edge near and a short edge far: each counts with its length, not once."""
    line = manip3d.Mesh([[0, 0, 0], [9, 0, 0], [4, -9, 0]], [[0, 1, 2]])
    thin = manip3d.Mesh([[0, 0, 0], [9, 0, 0], [9, 3, 0]], [[0, 1, 2]])
    diagonal_edge = math.hypot(9, 3)
    # along y = 0 no distance; up x = 9 from 0 to 3; along the third edge from 3 to 0
    expected = (3 * 1.5 + diagonal_edge * 1.5) / (9 + 3 + diagonal_edge)
    assert boundary_gap(line, thin).backward.mean == pytest.approx(expected, rel=1e-4)


def test_a_crack_inside_the_surface() -> None:
    mesh = plane(4)
    middle = 2 * 5 + 2
    torn = exploded(mesh)
    at_middle = np.flatnonzero((torn.vertices == mesh.vertices[middle]).all(axis=1))
    vertices = torn.vertices.copy()
    vertices[at_middle[0], 2] += 0.5
    torn = torn.replace(vertices=vertices)
    gap = boundary_gap(mesh, torn)
    # the lifted corner leaves its two edges, and the two that its neighbours leave alone
    assert gap.cracks == 4
    assert gap.crack_length > 4
    assert gap.forward.max < 1e-15
    assert gap.backward.max == pytest.approx(math.hypot(2, 0.5))
    assert boundary_gap(mesh, exploded(mesh)).cracks == 0


def test_a_cut_corner_is_a_crack_although_its_ends_are_on_the_boundary() -> None:
    mesh = plane(4)
    last = np.flatnonzero((mesh.faces == 24).any(axis=1))
    corner_cut = mesh.replace(faces=np.delete(mesh.faces, last, axis=0))
    cut = boundary_gap(mesh, corner_cut)
    # two inner edges of the removed square, each with one end on the boundary
    assert (cut.cracks, cut.crack_length) == (2, pytest.approx(2))
    straight = mesh.replace(faces=np.vstack([corner_cut.faces, [[18, 19, 23]]]))
    across = boundary_gap(mesh, straight)
    assert (across.cracks, across.crack_length) == (1, pytest.approx(math.sqrt(2)))
    assert across.backward.max == pytest.approx(0.5, rel=2e-2)


@pytest.mark.parametrize(("bulge", "cracks"), [(0.99, 0), (1.01, 1)])
def test_tolerance_decides(bulge: float, cracks: int) -> None:
    size = bulge * 1e-3 * math.sqrt(2)  # of the diagonal, over the hypotenuse of the cut corner
    flat = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    rim = math.sqrt(2) * size
    cut = manip3d.Mesh(
        [[0, 0, 0], [1, 0, 0], [1, 1 - 2 * size, 0], [1 - 2 * size, 1, 0], [0, 1, 0]],
        [[0, 1, 2], [0, 2, 3], [0, 3, 4]],
    )
    gap = boundary_gap(flat, cut)
    assert gap.cracks == cracks
    assert gap.crack_length == pytest.approx(2 * rim * cracks)
    assert boundary_gap(flat, cut, tolerance=2e-3).cracks == 0
    assert boundary_gap(flat, cut, tolerance=1e-5).cracks == 1


def test_welding_closes_seams() -> None:
    whole, split = plane(4), exploded(plane(4))
    assert boundary_gap(whole, split) == boundary_gap(whole, whole)
    stored = boundary_gap(whole, split, weld=False)
    assert stored.backward.max == pytest.approx(2.0)
    assert stored.cracks > 0
    assert boundary_gap(split, split, weld=False).cracks == 0


def test_closed_surfaces() -> None:
    nothing = boundary_gap(sphere(6), sphere(5))
    assert nothing.forward is None
    assert nothing.backward is None
    assert (nothing.cracks, nothing.crack_length) == (0, 0)
    closed = boundary_gap(plane(2), sphere(5))  # the hole was filled
    assert closed.forward.mean == closed.forward.max == math.inf
    assert closed.backward is None
    assert closed.cracks == 0
    opened = boundary_gap(sphere(5), plane(2))
    assert opened.forward is None
    assert opened.backward.mean == math.inf
    assert (opened.cracks, opened.crack_length) == (8, pytest.approx(8))


def test_degenerate_faces_have_no_boundary() -> None:
    mesh = plane(3)
    extra = mesh.replace(faces=np.vstack([mesh.faces, [[0, 0, 9]]]))
    assert boundary_gap(extra, mesh) == boundary_gap(mesh, mesh)


def test_scale_place_and_threads_change_nothing() -> None:
    a, b = plane(8), moved(plane(6), [1, 1, 0.25])
    expected = boundary_gap(a, b, threads=1)
    assert {boundary_gap(a, b, threads=t) for t in (2, 4)} == {expected}
    far = [moved(m, [2.0**20] * 3) for m in (a, b)]
    assert boundary_gap(*far) == expected
    scale = 2.0**-400
    small = boundary_gap(*(moved(m, [0, 0, 0], scale) for m in (a, b)))
    assert small.forward.mean == expected.forward.mean * scale
    assert small.cracks == expected.cracks


def test_refuses_bad_input() -> None:
    mesh = plane(1)
    for tolerance in (0.0, -1.0, 1e-9, 2.0, math.nan):
        with pytest.raises(manip3d.InputError, match="tolerance"):
            boundary_gap(mesh, mesh, tolerance=tolerance)
    with pytest.raises(manip3d.InputError, match="original: expected at least one face"):
        boundary_gap(manip3d.Mesh(mesh.vertices, []), mesh)


def test_a_simplified_mesh_of_another_order_of_magnitude_is_measured_at_once() -> None:
    """Found by fuzzing: edges were cut into pieces of the original's size, 1e12 of them."""
    gap = boundary_gap(plane(1), moved(plane(1), [0, 0, 0], scale=1e9))
    assert gap.backward.samples < 10_000
    assert gap.backward.max == pytest.approx(1e9 * math.sqrt(2), rel=1e-6)
