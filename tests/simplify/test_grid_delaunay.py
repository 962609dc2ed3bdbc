"""Delaunay triangulation of pixels against brute force and scipy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from manip3d import InputError, simplify

Pixels = NDArray[np.int64]


def turn(a: Pixels, b: Pixels, c: Pixels) -> Pixels:
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )


def in_circle(a: Pixels, b: Pixels, c: Pixels, d: Pixels) -> Pixels:
    """Return a number > 0 if d is inside the circle through a, b, c (counter-clockwise)."""
    (au, av), (bu, bv), (cu, cv) = ((x - d).T for x in (a, b, c))
    return (
        (au * au + av * av) * (bu * cv - bv * cu)
        - (bu * bu + bv * bv) * (au * cv - av * cu)
        + (cu * cu + cv * cv) * (au * bv - av * bu)
    )


def hull_area(points: Pixels) -> tuple[float, int]:
    """Return area and number of border points of the convex hull [Andrew 1979]."""
    ordered = sorted(map(tuple, points.tolist()))

    def chain(sequence: list[tuple[int, int]]) -> list[tuple[int, int]]:
        kept: list[tuple[int, int]] = []
        for p in sequence:
            while len(kept) > 1 and turn(*map(np.array, (kept[-2], kept[-1], p))) <= 0:
                kept.pop()
            kept.append(p)
        return kept[:-1]

    hull = np.array(chain(ordered) + chain(ordered[::-1]))
    after = np.roll(hull, -1, axis=0)
    area = float(np.sum(hull[:, 0] * after[:, 1] - hull[:, 1] * after[:, 0])) / 2
    sides = turn(hull[:, None], after[:, None], points[None]) == 0
    return area, int(sides.any(axis=0).sum())


def on_a_line(points: Pixels) -> bool:
    return len(points) < 3 or not turn(points[0], points[1], points).any()


def check(points: Pixels) -> None:
    """Check all properties of the Delaunay triangulation with our rule for ties."""
    faces = simplify.grid_delaunay(points)
    if on_a_line(points):
        assert len(faces) == 0
        return
    a, b, c = (points[faces[:, i]] for i in range(3))
    areas = turn(a, b, c)
    assert (areas > 0).all()
    area, border = hull_area(points)
    assert areas.sum() == 2 * area  # with the next: planar, and covers the hull
    assert len(faces) == 2 * len(points) - 2 - border
    assert len(np.unique(faces)) == len(points)
    # A point that is on the circle counts as outside if it is later than all three corners:
    # then it is raised most. If a corner is the latest, the sign of what raising that corner does.
    rank = np.empty(len(points), int)
    rank[np.lexsort((points[:, 0], points[:, 1]))] = np.arange(len(points))
    for corners, p, q, r in zip(faces, a, b, c, strict=True):
        inside = in_circle(p, q, r, points)
        assert (inside <= 0).all()
        for d in np.flatnonzero(inside == 0):
            if d in corners:
                continue
            latest = int(np.argmax(rank[corners]))
            if rank[corners[latest]] > rank[d]:
                replaced = [points[v] for v in corners]
                replaced[latest] = points[d]
                assert turn(*replaced) < 0


def pixels_of(indices: list[int] | NDArray[np.int64], width: int) -> Pixels:
    flat = np.asarray(indices, dtype=np.int64)
    return np.column_stack([flat % width, flat // width])


@given(st.integers(1, 9), st.integers(1, 9), st.data())
def test_brute_force_on_small_grids(width: int, height: int, data: st.DataObject) -> None:
    chosen = data.draw(st.lists(st.integers(0, width * height - 1), min_size=1, unique=True))
    check(pixels_of(chosen, width))


@given(
    st.lists(
        st.tuples(st.integers(0, 16383), st.integers(0, 16383)),
        min_size=1,
        max_size=25,
        unique=True,
    )
)
def test_brute_force_at_full_range(chosen: list[tuple[int, int]]) -> None:
    """Circles are exact for differences up to 16 383, for which in_circle needs 60 bits."""
    points = np.array(chosen, dtype=np.int64)
    faces = simplify.grid_delaunay(points)
    if on_a_line(points):
        assert len(faces) == 0
        return
    assert turn(*(points[faces[:, i]] for i in range(3))).sum() == 2 * hull_area(points)[0]
    exact = points.astype(object)  # Python's integers cannot overflow
    for p, q, r in exact[faces]:
        assert all(in_circle(p, q, r, d) <= 0 for d in exact)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2), (3, 7), (12, 12)])
def test_full_lattices(shape: tuple[int, int]) -> None:
    check(pixels_of(np.arange(shape[0] * shape[1]), shape[1]))


def test_a_lattice_is_cut_one_way() -> None:
    """All squares are cut along the same diagonal."""
    faces = simplify.grid_delaunay(pixels_of(np.arange(20), 5))
    edges = {tuple(sorted(pair)) for t in faces.tolist() for pair in itertools.combinations(t, 2)}
    assert {b - a for a, b in edges} == {1, 5, 4}


HOSTILE = {
    "row then one": [(u, 0) for u in range(30)] + [(15, 9)],
    "one then row": [(15, 0)] + [(u, 9) for u in range(30)],
    "column then one": [(0, v) for v in range(30)] + [(9, 15)],
    "one beside a column": [(9, 15)] + [(20, v) for v in range(30)],
    "diagonal, one left": [(i, i) for i in range(20)] + [(2, 17)],
    "diagonal, one right": [(i, i) for i in range(20)] + [(17, 2)],
    "falling diagonal": [(20 - i, i) for i in range(20)] + [(0, 0)],
    "two rows": [(u, v) for v in (0, 7) for u in range(0, 40, 3)],
    "two columns": [(u, v) for v in range(40) for u in (0, 7)],
    "cross": [(20, v) for v in range(41)] + [(u, 20) for u in range(41) if u != 20],
    "comb": [(2 * i, 0) for i in range(20)] + [(2 * i + 1, 15) for i in range(20)],
    "V": [(i, 40 - i) for i in range(20)] + [(20 + i, 21 + i) for i in range(20)],
    "pyramid": [(40 - v, v) for v in range(40)] + [(40 + v, v) for v in range(1, 40)],
    "parabola": [(i, i * i) for i in range(60)],
    "parabola on its side": [(i * i, i) for i in range(60)],
    "both": [(i * i, i) for i in range(60)] + [(i, i * i) for i in range(2, 60)],
    "circle of radius 65": [
        (65 + x, 65 + y) for x in range(-65, 66) for y in range(-65, 66) if x * x + y * y == 4225
    ],
    "circle and centre": [(25, 25)]
    + [(25 + x, 25 + y) for x in range(-25, 26) for y in range(-25, 26) if x * x + y * y == 625],
    "corners": [(0, 0), (16383, 0), (0, 16383), (16383, 16383), (8191, 8192)],
    "far needle": [(0, 0), (16383, 1), (16382, 1), (16383, 2), (16383, 0)],
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("turned", [False, True], ids=["", "turned"])
def test_hostile(name: str, turned: bool) -> None:
    points = np.array(HOSTILE[name], dtype=np.int64)
    if turned:
        points = points.max(axis=0) - points
    check(points)


@pytest.mark.parametrize(("count", "width", "height"), [(900, 313, 214), (4000, 640, 480)])
def test_against_scipy(count: int, width: int, height: int) -> None:
    spatial = pytest.importorskip("scipy.spatial")
    rng = np.random.default_rng(count)
    points = pixels_of(rng.choice(width * height, count, replace=False), width)
    ours = simplify.grid_delaunay(points)
    theirs = spatial.Delaunay(points)
    areas = turn(*(points[ours[:, i]] for i in range(3)))
    assert areas.sum() == pytest.approx(2 * spatial.ConvexHull(points).volume)
    # The triangles are the same unless four points lie on a circle; ties are cut differently.
    shared = {tuple(sorted(t)) for t in ours.tolist()} & {
        tuple(sorted(t)) for t in theirs.simplices.tolist()
    }
    assert len(shared) > 0.9 * len(ours)


def test_clusters_and_holes() -> None:
    """The rules hold for points as CS3 chooses them, with clusters along curves and holes."""
    v, u = np.mgrid[0:48, 0:64]
    ring = np.abs(np.hypot(u - 32, v - 24) - 15) < 1.2
    sparse = ((u % 7 == 0) & (v % 5 == 0)) & (np.hypot(u - 32, v - 24) < 22)
    check(pixels_of(np.flatnonzero(ring | sparse), 64))


@given(st.permutations(range(25)))
def test_the_order_of_the_input_does_not_matter(order: list[int]) -> None:
    points = pixels_of(np.arange(25), 5)
    expected = {tuple(sorted(t)) for t in simplify.grid_delaunay(points).tolist()}
    shuffled = simplify.grid_delaunay(points[order])
    assert {tuple(sorted(order[i] for i in t)) for t in shuffled.tolist()} == expected


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        ([[0, 0], [1, 1], [0, 0]], "distinct pixels"),
        ([[0, 0], [16384, 0]], "from 0 to 16383"),
        ([[0, 0], [0, -1]], "from 0 to 16383"),
        ([[0.5, 1.0]], "expected integers"),
        ([[0, 1, 2]], r"pixels: expected shape \(N, 2\)"),
    ],
)
def test_refused(pixels: list[list[int]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simplify.grid_delaunay(pixels)


def test_too_few() -> None:
    for count in range(3):
        assert simplify.grid_delaunay(pixels_of(np.arange(count), 5)).shape == (0, 3)
