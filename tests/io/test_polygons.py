"""Polygons to triangles: the same rule for all readers, shown through OBJ."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manip3d import InputError, _core
from manip3d.io import read_mesh_bytes


def triangles(points: np.ndarray) -> np.ndarray:
    """Corner numbers of the triangles that one polygon gives."""
    rows = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    face = "f " + " ".join(str(i + 1) for i in range(len(points)))
    return read_mesh_bytes((rows + face).encode(), "obj").faces


def flat(points: list[tuple[float, float]]) -> np.ndarray:
    return np.array([(x, y, 0.0) for x, y in points])


def areas(points: np.ndarray) -> np.ndarray:
    """Twice the signed area of each triangle along the polygon's Newell normal."""
    p = points[triangles(points)]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    normal /= np.linalg.norm(normal)
    return np.asarray(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) @ normal)


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        # 3---2   both diagonals fit and are equally long: from the first corner
        # 0---1
        ([(0, 0), (1, 0), (1, 1), (0, 1)], [[0, 1, 2], [0, 2, 3]]),
        # the shorter diagonal of a lozenge: 1-3, then 0-2
        ([(0, 0), (2, -1), (4, 0), (2, 1)], [[0, 1, 3], [1, 2, 3]]),
        ([(0, -1), (2, 0), (0, 1), (-2, 0)], [[0, 1, 2], [0, 2, 3]]),
        # an arrow head: only the diagonal through the notch flips nothing, though it is longer
        ([(0, 0), (4, -1), (1, 0), (4, 1)], [[0, 1, 2], [0, 2, 3]]),
        ([(4, 1), (0, 0), (4, -1), (1, 0)], [[0, 1, 3], [1, 2, 3]]),
        # corner 1 in line with 0 and 2: the diagonal 0-2 would leave an empty triangle
        ([(0, 0), (1, 0), (2, 0), (1, 0.1)], [[0, 1, 3], [1, 2, 3]]),
        # all in one place
        ([(0, 0), (0, 0), (0, 0), (0, 0)], [[0, 1, 2], [0, 2, 3]]),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 1e-300, 1e300])
def test_quads(points: list[tuple[float, float]], expected: list[list[int]], scale: float) -> None:
    assert triangles(flat(points) * scale).tolist() == expected


@given(seed=st.integers(0, 2**32), n=st.integers(4, 40), scale=st.sampled_from([1, 1e-9, 1e9]))
def test_star_shaped_polygons_are_covered_once(seed: int, n: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(0.1, 0.9, n)) / n
    radius = rng.uniform(0.1, 1.0, n)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle])
    frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = (points @ frame.T + rng.normal(size=3)) * scale
    area = areas(points)
    assert len(area) == n - 2
    assert (area > 0).all()
    polygon = np.linalg.norm(np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0))
    assert area.sum() == pytest.approx(polygon, rel=1e-9)


@pytest.mark.parametrize(
    "points",
    [
        # corners in the middle of edges
        [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)],
        # a comb
        [(0, 0), (7, 0), (7, 3), (6, 1), (5, 3), (4, 1), (3, 3), (2, 1), (1, 3), (0, 3)],
        # a spiral
        [(0, 0), (5, 0), (5, 5), (1, 5), (1, 2), (3, 2), (3, 3), (2, 3), (2, 4), (4, 4), (4, 1),
         (0, 1)],
        # a square with a square hole, joined by a bridge that is passed twice
        [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)],
    ],
)  # fmt: skip
def test_simple_polygons_are_covered_once_from_any_corner(
    points: list[tuple[float, float]],
) -> None:
    whole = flat(points)
    double = np.cross(whole, np.roll(whole, -1, axis=0)).sum(axis=0)[2]
    for first in range(len(points)):
        area = areas(np.roll(whole, first, axis=0))
        assert (area >= -1e-12).all()
        assert area.sum() == pytest.approx(double)


@given(st.lists(st.tuples(*[st.integers(0, 2)] * 3), min_size=3, max_size=30))
def test_any_polygon_gives_n_minus_2_triangles_of_its_corners(
    points: list[tuple[int, int, int]],
) -> None:
    result = triangles(np.array(points, dtype=float))
    assert len(result) == len(points) - 2
    assert set(result.ravel()) == set(range(len(points)))
    # Each edge of the polygon is an edge of one triangle, each cut of two: a disc.
    edges = {tuple(sorted(e)) for t in result.tolist() for e in zip(t, t[1:] + t[:1], strict=True)}
    assert len(edges) == 2 * len(points) - 3


def test_polygons_of_a_table_are_cut_alike() -> None:
    """Corner numbers count on from polygon to polygon; two corners make no face.

    3---2
    |   |
    0---1
    """
    square = flat([(0, 0), (1, 0), (1, 1), (0, 1)])
    corners = np.array([3, 0, 1, 0, 1, 0, 1, 2, 3], dtype=np.int32)
    counts = np.array([3, 2, 4], dtype=np.int32)
    cut = _core.triangulate_polygons(square, corners, counts)
    assert cut[0].tolist() == [0, 1, 2]
    assert (cut[1:] - 5).tolist() == triangles(square).tolist()


@pytest.mark.parametrize(
    ("corners", "counts", "text"),
    [
        ([0, 1, 4], [3], "corners: expected 0 to 3, got 4"),
        ([0, 1, -1], [3], "corners: expected 0 to 3, got -1"),
        ([0, 1, 2], [4], "counts: expected 3 corners, got 4"),
        ([0, 1, 2], [4, -1], "counts: expected numbers >= 0, got -1"),
    ],
)
def test_tables_that_do_not_fit_are_refused(
    corners: list[int], counts: list[int], text: str
) -> None:
    square = flat([(0, 0), (1, 0), (1, 1), (0, 1)])
    tables = (np.array(rows, dtype=np.int32) for rows in (corners, counts))
    with pytest.raises(InputError, match=text):
        _core.triangulate_polygons(square, *tables)
