"""The nearest-point search, against all pairs in NumPy and against Open3D."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

import manip3d
from manip3d.metrics import closest_points
from metrics_oracles import face_distances, sphere

# Coordinates on a small grid give every kind of degenerate face, ties and touching faces.
GRID = st.integers(-3, 3).map(float)
ANY = st.floats(-3, 3, width=32)


@settings(max_examples=200)
@given(data=st.data(), scale=st.sampled_from([1.0, 1e9, 1e-9]), far=st.booleans())
def test_equals_all_pairs(data: st.DataObject, scale: float, far: bool) -> None:
    values = data.draw(st.sampled_from([GRID, ANY]))
    num_vertices = data.draw(st.integers(1, 12))
    vertices = scale * data.draw(hnp.arrays(np.float64, (num_vertices, 3), elements=values))
    corner = st.integers(0, num_vertices - 1)
    faces = data.draw(hnp.arrays(np.int32, (data.draw(st.integers(1, 20)), 3), elements=corner))
    points = scale * 2 * data.draw(hnp.arrays(np.float64, (8, 3), elements=values))
    offset = scale * 2.0**20 * np.ones(3) if far else np.zeros(3)
    result = closest_points(manip3d.Mesh(vertices + offset, faces), points + offset)
    # what the far coordinates say after they were rounded
    vertices, points = (vertices + offset) - offset, (points + offset) - offset
    distances = face_distances(vertices, faces, points)
    tolerance = 1e-13 * scale
    np.testing.assert_allclose(result.distance, distances.min(axis=1), rtol=1e-12, atol=tolerance)
    own = distances[np.arange(len(points)), result.face]
    np.testing.assert_allclose(own, result.distance, rtol=1e-12, atol=tolerance)
    to_point = np.linalg.norm(points - (result.point - offset), axis=1)
    np.testing.assert_allclose(to_point, result.distance, rtol=1e-9, atol=1e-9 * scale)


def test_needles_and_caps_keep_full_precision() -> None:
    rng = np.random.default_rng(1)
    for height in 10.0 ** -np.arange(1, 16):
        for foot in (0.0, 1e-9, 0.3, 0.5, 1.0):
            corners = np.array([[0, 0, 0], [1, 0, 0], [foot, height, 0]], float)
            rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            weights = rng.dirichlet(np.ones(3), size=20)
            above = 0.25 * rotation[:, 2]
            points = weights @ (corners @ rotation.T) + above
            result = closest_points(manip3d.Mesh(corners @ rotation.T, [[0, 1, 2]]), points)
            np.testing.assert_allclose(result.distance, 0.25, rtol=1e-14)


def test_equally_near_faces_give_the_lowest_index() -> None:
    cube = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T.astype(float)
    triangle = [[0, 1, 2]]
    mesh = manip3d.Mesh(cube, triangle * 9)
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert (closest_points(mesh, points).face == 0).all()


def test_a_corner_is_at_distance_zero_exactly() -> None:
    mesh = sphere()
    far = mesh.replace(vertices=mesh.vertices + np.array([1e6, -5e5, 3.0]))
    result = closest_points(far, far.vertices)
    assert (result.distance == 0).all()
    assert (result.point == far.vertices).all()
    corners = far.vertices[far.faces[result.face]]
    assert (corners == far.vertices[:, None]).all(axis=2).any(axis=1).all()


def test_order_of_points_and_threads_change_nothing() -> None:
    mesh = sphere()
    rng = np.random.default_rng(0)
    points = np.vstack([rng.normal(size=(3000, 3)), np.zeros((10, 3)), mesh.vertices])
    expected = closest_points(mesh, points, threads=1)
    order = rng.permutation(len(points))
    for threads in (1, 2, 4):
        shuffled = closest_points(mesh, points[order], threads=threads)
        for name in ("distance", "face", "point"):
            assert (getattr(shuffled, name) == getattr(expected, name)[order]).all()


def test_equals_open3d() -> None:
    o3d = pytest.importorskip("open3d")
    mesh = sphere(60)
    rng = np.random.default_rng(0)
    points: NDArray[np.float32] = rng.normal(size=(5000, 3)).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    theirs = scene.compute_distance(o3d.core.Tensor(points)).numpy()
    np.testing.assert_allclose(closest_points(mesh, points).distance, theirs, atol=2e-6)


# With few points only the faces that may be near are looked at.
@pytest.mark.parametrize("num_points", [3, 40, 5000])
@pytest.mark.parametrize("offset", [0.0, 2.0**30])
def test_a_limit_leaves_out_what_is_farther_and_nothing_else(
    num_points: int, offset: float
) -> None:
    ball = sphere()
    mesh = manip3d.Mesh(ball.vertices + offset, ball.faces)
    assert mesh.num_faces > 8 * 40
    points = offset + np.random.default_rng(1).uniform(-1.5, 1.5, (num_points, 3))
    every = closest_points(mesh, points)
    for limit in (0.0, 1e-9, 0.05, float(every.distance[1]), 0.4, 10.0, np.inf):
        result = closest_points(mesh, points, max_distance=limit)
        near = result.face >= 0
        clearly = np.abs(every.distance - limit) > 1e-9
        np.testing.assert_array_equal(near[clearly], (every.distance <= limit)[clearly])
        for found, expected in (
            (result.face, every.face),
            (result.distance, every.distance),
            (result.point, every.point),
        ):
            np.testing.assert_array_equal(found[near], expected[near])
        assert (result.face[~near] == -1).all()
        assert np.isinf(result.distance[~near]).all()
        assert np.isnan(result.point[~near]).all()


def test_progress_ends_at_one_where_no_face_is_within_the_limit() -> None:
    corners = np.random.default_rng(2).uniform(0, 1, (12, 3, 3))
    mesh = manip3d.Mesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    for away in range(10, 20):  # in some of these cases no face is even looked at
        told: list[float] = []
        found = closest_points(
            mesh,
            [[away, 0, 0]],
            max_distance=1.0,
            progress=lambda part, _, to=told: to.append(part),
        )
        assert found.face.tolist() == [-1]
        assert told[-1:] == [1.0]


def test_large_faces_are_near_all_they_span() -> None:
    places = np.random.default_rng(2).uniform(90, 100, (300, 1, 3))
    specks = places + np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    wide = np.array([[[-50.0, -50, 0], [50, -50, 0], [0, 50, 0]]])
    corners = np.concatenate([specks, wide])
    mesh = manip3d.Mesh(corners.reshape(-1, 3), np.arange(903).reshape(-1, 3))
    result = closest_points(mesh, [[1.0, 2.0, 0.01], [1.0, 2.0, 0.2]], max_distance=0.1)
    assert result.face.tolist() == [300, -1]


def test_refuses_bad_input() -> None:
    mesh = sphere(4)
    with pytest.raises(manip3d.InputError, match=r"points: expected shape \(N, 3\)"):
        closest_points(mesh, [[0.0, 0.0]])
    for bad in (np.nan, np.inf, 1e300):
        with pytest.raises(manip3d.InputError, match="points"):
            closest_points(mesh, [[bad, 0.0, 0.0]])
    with pytest.raises(manip3d.InputError, match="at least one face"):
        closest_points(manip3d.Mesh([[0, 0, 0]], []), [[0.0, 0.0, 0.0]])
    for limit in (-1.0, np.nan):
        with pytest.raises(manip3d.InputError, match="max_distance: expected"):
            closest_points(mesh, [[0.0, 0.0, 0.0]], max_distance=limit)
    for bad in (np.nan, np.inf):
        with pytest.raises(manip3d.InputError, match="points"):
            closest_points(sphere(), [[bad, 0.0, 0.0]], max_distance=0.1)
    assert closest_points(mesh, np.empty((0, 3))).distance.shape == (0,)


def test_progress_may_cancel() -> None:
    seen: list[float] = []
    points = np.random.default_rng(0).normal(size=(200_000, 3))
    closest_points(sphere(), points, progress=lambda fraction, _: seen.append(fraction))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0

    def cancel(fraction: float, message: str) -> None:
        raise RuntimeError(message)

    with pytest.raises(RuntimeError, match="closest points"):
        closest_points(sphere(), points, progress=cancel)
