"""Baselines of CS3: what each choice of pixels promises, against brute force."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manip3d import InputError, Intrinsics, Registration, datasets
from manip3d.simplify import dense_mesh_grid, sample_depth, sample_depth_grid
from manip3d.simulate import depth as simulated
from real_data import RealData

METHODS = ("uniform", "poisson", "ssa")


@pytest.fixture(scope="module")
def person() -> tuple[np.ndarray, Intrinsics]:
    scene = simulated.person(width=320, height=240)
    return scene.capture(rng=1).depth, scene.intrinsics


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("target", [50, 500, 1500])
def test_at_most_the_target_and_near_it(method: str, target: int, person: tuple) -> None:
    depth, camera = person
    mesh = sample_depth(depth, camera, target, method=method)
    assert mesh.num_vertices <= target
    assert mesh.num_vertices >= 0.97 * target
    u, v = mesh.pixels.T
    assert (depth[v, u] > 0).all()
    np.testing.assert_array_equal(np.lexsort((u, v)), np.arange(len(u)))
    assert len(np.unique(mesh.pixels, axis=0)) == len(u)


@pytest.mark.parametrize("method", METHODS)
def test_vertices_are_points_of_the_image_and_triangles_lie_over_it(
    method: str, person: tuple
) -> None:
    depth, camera = person
    mesh = sample_depth(depth, camera, 800, method=method)
    u, v = mesh.pixels.T
    z = depth[v, u] / 1000.0
    np.testing.assert_allclose(mesh.vertices[:, 2], z, rtol=1e-6)
    np.testing.assert_allclose(mesh.vertices[:, 0], (u - camera.cx) / camera.fx * z, rtol=1e-5)
    np.testing.assert_allclose(
        mesh.texcoords, np.c_[(u + 0.5) / 320, 1 - (v + 0.5) / 240], rtol=1e-6
    )
    center = np.rint(mesh.pixels[mesh.faces].mean(axis=1)).astype(int)
    assert (depth[center[:, 1], center[:, 0]] > 0).all()
    a, b, c = mesh.vertices[mesh.faces].astype(float).transpose(1, 0, 2)
    facing = (np.cross(b - a, c - a) * a).sum(axis=1)
    assert (facing < 0).mean() > 0.99  # front faces look at the sensor


def test_poisson_disks_are_apart_and_leave_no_room(person: tuple) -> None:
    depth, camera = person
    mesh = sample_depth(depth, camera, 400, method="poisson", rng=7)
    chosen = mesh.vertices.astype(float)
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=2)
    radius = between[~np.eye(len(chosen), dtype=bool)].min()
    everything = sample_depth(depth, camera, depth.size, method="poisson").vertices
    nearest = [
        np.linalg.norm(everything[i : i + 500, None] - chosen[None], axis=2).min(axis=1).max()
        for i in range(0, len(everything), 500)
    ]
    assert max(nearest) <= radius * 1.01  # dart throwing ends where every point is covered
    again = sample_depth(depth, camera, 400, method="poisson", rng=7)
    np.testing.assert_array_equal(again.pixels, mesh.pixels)
    other = sample_depth(depth, camera, 400, method="poisson", rng=8)
    assert not np.array_equal(other.pixels, mesh.pixels)


def test_the_lattice_is_a_lattice(person: tuple) -> None:
    depth, camera = person
    mesh = sample_depth(depth, camera, 600)
    columns, rows = np.unique(mesh.pixels[:, 0]), np.unique(mesh.pixels[:, 1])
    inside = depth[np.ix_(rows, columns)] > 0
    assert inside.sum() == mesh.num_vertices
    for lines in (columns, rows):
        assert np.diff(lines).max() - np.diff(lines).min() <= 1


def test_zero_crossings_are_where_the_curvature_along_rows_changes_sign() -> None:
    """A column with eight flutes, unrolled: its radius has an inflection every half flute."""
    v, u = np.mgrid[:40, :400].astype(float)
    period = 50.0
    angle = 2 * np.pi * u / 400
    radius = 1.0 + 0.05 * np.cos(2 * np.pi * u / period)
    points = np.stack([radius * np.sin(angle), 0.01 * v, radius * np.cos(angle)], axis=-1)
    mesh = sample_depth_grid(points, None, 40 * 20, method="ssa")
    inflections = np.arange(0.25 * period, 400, 0.5 * period)
    column = np.unique(mesh.pixels[:, 0])
    inner = column[(column > 60) & (column < 340)]
    apart = np.abs(inner[:, None] - inflections[None]).min(axis=1)
    assert apart.max() < 2.0
    assert len(inner) >= 10


@pytest.mark.parametrize("method", METHODS)
@given(
    rows=st.integers(0, 7),
    columns=st.integers(0, 7),
    target=st.integers(1, 30),
    seed=st.integers(0, 1000),
)
def test_small_and_empty_grids(
    method: str, rows: int, columns: int, target: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    points = random.integers(0, 4, (rows, columns, 3)).astype(np.float32)  # equal ones among them
    valid = random.random((rows, columns)) < 0.7
    mesh = sample_depth_grid(points, valid, target, method=method, rng=0)
    assert mesh.num_vertices <= min(target, valid.sum())
    if valid.sum() <= target and method != "ssa":
        assert mesh.num_vertices == valid.sum()


@pytest.mark.parametrize("method", METHODS)
def test_texture_coordinates_in_another_camera_are_those_of_the_dense_mesh(
    method: str, person: tuple
) -> None:
    depth, camera = person
    color = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)
    beside = Registration(color, translation=(0.05, 0.0, 0.0))
    mesh = sample_depth(depth, camera, 300, method=method, registration=beside)
    x, y, z = (mesh.vertices.astype(float) + np.array([0.05, 0.0, 0.0])).T
    expected = np.c_[(500 * x / z + 320.5) / 640, 1 - (500 * y / z + 240.5) / 480]
    np.testing.assert_allclose(mesh.texcoords, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("shape", "first_row", "target"),
    [
        ((64, 2048), 0, 8),
        ((64, 2048), 0, 20),
        ((1, 1000), 0, 10),
        ((1000, 1), 0, 10),
        ((64, 2048), 54, 20),
        ((480, 640), 479, 3),
        ((100, 100), 0, 1),
    ],
)
def test_a_narrow_scan_is_sampled(shape: tuple[int, int], first_row: int, target: int) -> None:
    v, u = np.mgrid[: shape[0], : shape[1]]
    points = np.stack([0.01 * u, -0.01 * v, np.ones(shape)], axis=-1)
    mesh = sample_depth_grid(points, v >= first_row, target)
    assert target / 2 < mesh.num_vertices <= target


def test_points_at_one_place_give_one_disk_and_no_crossing() -> None:
    points = np.broadcast_to([0.0, 0.0, 1.0], (20, 20, 3))
    assert sample_depth_grid(points, None, 50, method="poisson").num_vertices == 1
    assert sample_depth_grid(points, None, 50, method="ssa").num_vertices == 0


def test_long_edges_are_dropped(person: tuple) -> None:
    depth, camera = person
    mesh = sample_depth(depth, camera, 300, max_edge=0.08)
    sides = np.diff(mesh.vertices[mesh.faces[:, [0, 1, 2, 0]]], axis=1)
    assert np.linalg.norm(sides, axis=2).max() <= 0.08 * (1 + 1e-6)
    assert 0 < mesh.num_faces < sample_depth(depth, camera, 300).num_faces


def test_arguments_are_checked(person: tuple) -> None:
    depth, camera = person
    with pytest.raises(InputError, match="method: expected 'uniform', 'poisson' or 'ssa'"):
        sample_depth(depth, camera, 10, method="best")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="target_points: expected >= 1, got 0"):
        sample_depth(depth, camera, 0)
    for max_edge in (-1.0, 0.0, float("nan")):
        with pytest.raises(InputError, match="max_edge: expected > 0"):
            sample_depth(depth, camera, 10, max_edge=max_edge)


def test_a_result_says_whether_all_points_are_in_it() -> None:
    points = np.stack([*np.mgrid[:4, :5], np.ones((4, 5))], axis=-1)[..., [1, 0, 2]]
    assert sample_depth_grid(points, None, 20, method="poisson").stop == "all_points"
    assert sample_depth_grid(points, None, 19, method="poisson").stop == "target"


@pytest.mark.golden
@pytest.mark.parametrize("method", METHODS)
def test_golden(method: str, golden: Callable[..., None]) -> None:
    """The same choice on every machine: whole numbers in, no libm on the way."""
    random = np.random.default_rng(11)
    v, u = np.mgrid[:90, :120]
    relief = random.integers(0, 9, (90, 120)) + (u - 60) ** 2 // 40 + (v - 45) ** 2 // 30
    points = np.stack([4 * u, 4 * v, relief], axis=-1).astype(np.float32)
    valid = random.random((90, 120)) < 0.95
    mesh = sample_depth_grid(points, valid, 700, method=method, rng=3)
    bits = hashlib.sha256(mesh.pixels.tobytes() + mesh.faces.tobytes()).hexdigest()
    golden(f"sample_depth {method}", bits)


def test_the_published_order_of_the_baselines_on_bun000(realdata: RealData) -> None:
    """Table 3.4: scale space is by far the worst, Poisson disks are the best of the three."""
    from manip3d.metrics import metro

    realdata.needs("bun000")
    scan = datasets.load_scan("bun000")
    dense = dense_mesh_grid(scan.points, scan.valid).mesh
    error = {
        method: metro(
            dense,
            sample_depth_grid(scan.points, scan.valid, 2012, method=method).mesh,
            sampling="area",
            samples=100_000,
        ).mean
        for method in METHODS
    }
    assert error["poisson"] < error["uniform"] < 0.5 * error["ssa"]
