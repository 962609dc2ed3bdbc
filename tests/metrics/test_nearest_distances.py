"""Exact nearest neighbours of scans, whatever the points and the cells they are searched in."""

from __future__ import annotations

import lzma

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from manip3d import InputError
from manip3d.metrics import nearest_distances
from real_data import RealData

Points = NDArray[np.float32]


def oracle(points: Points) -> NDArray[np.float64]:
    cloud = points.astype(np.float64)
    distances: NDArray[np.float64] = cKDTree(cloud).query(cloud, k=2)[0][:, 1]
    return distances


def sphere(random: np.random.Generator, count: int) -> NDArray[np.float64]:
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def grid_scan(noise: float = 0.003, step: float = 0.6) -> Points:
    """A terrestrial scan of a bumpy cave, column by column."""
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(-180, 180, step)), np.radians(np.arange(-40, 60, step)), indexing="ij"
    )
    r = 5 + 3 * np.sin(3 * azimuth) * np.cos(2 * elevation)
    r += np.random.default_rng(0).normal(0, noise, r.shape)
    xyz = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    return (np.stack(xyz, axis=-1) * r[..., None]).reshape(-1, 3).astype(np.float32)


def clouds() -> dict[str, Points]:
    random = np.random.default_rng(0)
    scan = grid_scan()
    made = {
        "scan": scan,
        "shuffled": random.permutation(scan),
        "ball": random.normal(size=(20_000, 3)),
        "shells": sphere(random, 9000) * random.choice([1, 5, 5.001, 80], (9000, 1)),
        "no returns": np.concatenate([scan[:5000], np.zeros((2000, 3))]),
        "one in the origin": np.concatenate([scan[:5000], np.zeros((1, 3))]),
        "around the pole": np.concatenate(
            [random.normal(size=(2000, 3)) * [1e-3, 1e-3, 0] + [0, 0, 5], scan[:3000]]
        ),
        "lone at both poles": np.concatenate([[[0, 0, 7]], [[0, 0, -3]], scan[:3000]]),
        "one ray": np.outer(np.linspace(1, 100, 3000), [1, 2, 3]),
        "two heaps": np.concatenate(
            [sphere(random, 2000) * 0.01 + [s, 0, 0] for s in (-10, 10)] + [[[0, 50, 0]]]
        ),
        "heavy tails": random.standard_cauchy((8000, 3)),
        "far away": random.random((2000, 3)) * 100 + 1e9,
        "tiny": sphere(random, 2000) * 1e-20,
        "all the same": np.ones((2000, 3)),
        "duplicates": np.repeat(scan[:1000], 2, axis=0),
    }
    return {name: np.asarray(points, np.float32) for name, points in made.items()}


CLOUDS = clouds()


@pytest.mark.parametrize("name", CLOUDS)
def test_equal_to_a_tree_on_all_points(name: str) -> None:
    points = CLOUDS[name]
    found = nearest_distances(points)
    np.testing.assert_array_equal(found, nearest_distances(points, origin=None))
    np.testing.assert_array_equal(found, nearest_distances(points, threads=1))
    np.testing.assert_allclose(found, oracle(points), rtol=1e-15, atol=0)


@pytest.mark.parametrize("origin", [(0.5, 0.2, 1.0), (0, 0, 4), (1000, 0, 0)])
@pytest.mark.parametrize("name", ["scan", "ball", "shells"])
def test_a_wrong_origin_costs_time_only(name: str, origin: tuple[float, float, float]) -> None:
    points = CLOUDS[name][:8000]
    np.testing.assert_array_equal(nearest_distances(points, origin=origin), oracle(points))


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.01, 0.05, 0.2, 1.0, 3.0]),
    st.sampled_from([0.01, 0.2, 1.0]),
)
def test_random_scans(seed: int, resolution: float, flatness: float) -> None:
    random = np.random.default_rng(seed)
    points = sphere(random, 1200) * [1, 1, flatness]
    points *= random.choice([1.0, 1.0, 5.0, 5.01, 80.0], (1200, 1)) * (1 + 0.01 * random.random())
    cloud = points.astype(np.float32)
    np.testing.assert_array_equal(nearest_distances(cloud, resolution=resolution), oracle(cloud))


def test_few_points() -> None:
    assert nearest_distances(np.empty((0, 3), np.float32)).shape == (0,)
    assert nearest_distances([[1, 2, 3]]).tolist() == [np.inf]
    assert nearest_distances([[1, 2, 3], [1, 2, 5]]).tolist() == [2.0, 2.0]


def test_bad_arguments() -> None:
    with pytest.raises(InputError, match="row 1"):
        nearest_distances([[0, 0, 0], [np.nan, 0, 0]])
    with pytest.raises(InputError, match="origin"):
        nearest_distances([[0, 0, 0]], origin=(0, 0))
    with pytest.raises(InputError, match="origin: expected three finite"):
        nearest_distances([[0, 0, 0]], origin=(0, 0, np.inf))
    with pytest.raises(InputError, match="resolution"):
        nearest_distances([[0, 0, 0]], resolution=np.nan)
    with pytest.raises(InputError, match="threads: expected 0"):
        nearest_distances([[0, 0, 0]], threads=-2)


def test_kitti_frame(realdata: RealData) -> None:
    drive = "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"
    path = realdata(f"{drive}/velodyne_points/data/0000000000.bin.xz")
    frame = np.frombuffer(lzma.decompress(path.read_bytes()), np.float32).reshape(-1, 4)[:, :3]
    np.testing.assert_array_equal(nearest_distances(frame), oracle(np.asarray(frame)))


@pytest.mark.parametrize("origin", [None, (0.0, 0.0, 0.0), (450_000.0, 5_400_000.0, 302.0)])
def test_coordinates_of_a_map_have_the_distances_of_those_near_0(
    origin: tuple[float, float, float] | None,
) -> None:
    """Distances are exact at coordinates of a map, where float32 is off by up to 0.2 m."""
    cloud = np.random.default_rng(0).uniform(-20.0, 20.0, (3000, 3))
    far = cloud + np.array([450_000.0, 5_400_000.0, 300.0])
    expected = cKDTree(far).query(far, k=2)[0][:, 1]
    np.testing.assert_allclose(nearest_distances(far, origin=origin), expected, atol=1e-5)
    assert np.abs(nearest_distances(far.astype(np.float32)) - expected).max() > 0.1
