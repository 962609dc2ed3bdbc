"""Filters of outliers, which leave out points far from their neighbours, are named."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from manip3d import InputError, _core, authenticate, simulate
from manip3d.authenticate._outliers import MAX_CUT, lone_distances, sharpest_end
from manip3d.io import read_scan
from manip3d.lidar import LidarFrame
from real_data import RealData

scipy_spatial = pytest.importorskip("scipy.spatial")

FRAME = (
    "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0002_sync/velodyne_points/data/0000000007.bin.xz"
)


def neighbour_distances(points: np.ndarray, count: int) -> np.ndarray:
    """Distances of each point from its nearest others, ascending."""
    wide = points.astype(np.float64)
    near: np.ndarray = scipy_spatial.cKDTree(wide).query(wide, count + 1)[0]
    return near[:, 1:]


@pytest.mark.parametrize("neighbours", [1, 4, 8])
def test_distances_are_those_of_all_pairs(neighbours: int) -> None:
    rng = np.random.default_rng(neighbours)
    near = np.cumsum(rng.normal(0.0, 0.08, (3000, 3)), axis=0)  # rows beside each other are near
    points = np.concatenate([near, rng.uniform(-9, 9, (400, 3)), near[:50]]).astype(np.float32)
    for order in (np.arange(len(points)), rng.permutation(len(points))):
        cloud = np.ascontiguousarray(points[order])
        expected = neighbour_distances(cloud, neighbours).T
        found = _core.sparse_distances(cloud, neighbours, 0.24, 0.0, 2.0, 1)
        assert len(found) == neighbours
        for distances, each in zip(found, expected, strict=True):
            np.testing.assert_allclose(distances, np.minimum(each[each >= 0.24], 2.0), rtol=1e-6)
        some = _core.sparse_distances(cloud, neighbours, 0.24, 0.0, 2.0, 4)
        assert len(some[-1]) < len(found[-1]) / 3


def test_near_points_count_from_a_share_of_the_range() -> None:
    line = np.arange(10.0)[:, None] * np.array([0.0, 0.5, 0.0])
    cloud = np.add(line, [10.0, 0.0, 0.0]).astype(np.float32)
    assert len(_core.sparse_distances(cloud, 1, 0.24, 0.04, 2.0, 1)[0]) == 10
    assert len(_core.sparse_distances(cloud, 1, 0.24, 0.06, 2.0, 1)[0]) == 0
    first, second = _core.sparse_distances(cloud, 2, 0.24, 0.06, 2.0, 1)
    assert (len(first), len(second)) == (0, 2)  # the ends


def test_few_points_have_no_neighbours() -> None:
    def distances(*shape: int) -> list[list[float]]:
        cloud = np.ones(shape, np.float32)
        return [each.tolist() for each in _core.sparse_distances(cloud, 4, 0.24, 0.0, 2.0, 1)]

    assert distances(0, 3) == [[], [], [], []]
    assert distances(3, 3) == [[], [], [2, 2, 2], [2, 2, 2]]
    assert distances(9, 3) == [[], [], [], []]


def test_bad_options_are_named() -> None:
    for options, name in (
        ((0, 0.24, 0.0, 2.0, 1), "neighbours"),
        ((9, 0.24, 0.0, 2.0, 1), "neighbours"),
        ((4, 0.0, 0.0, 2.0, 1), "nearest"),
        ((4, float("nan"), 0.0, 2.0, 1), "nearest"),
        ((4, 3.0, 0.0, 2.0, 1), "nearest"),
        ((4, 0.24, 0.0, float("inf"), 1), "nearest"),
        ((4, 0.24, 0.0, 2.0, 0), "every"),
        ((4, 0.24, -0.1, 2.0, 1), "angle"),
    ):
        with pytest.raises(InputError, match=name):
            _core.sparse_distances(np.zeros((9, 3), np.float32), *options)


@cache
def street() -> LidarFrame:
    return simulate.hdl64e(simulate.street(rng=3), 1.0, rng=0).frame


def statistical(points: np.ndarray) -> np.ndarray:
    mean = neighbour_distances(points, 20).mean(axis=1)
    return mean < mean.mean() + 2.0 * mean.std()


def by_radius(points: np.ndarray) -> np.ndarray:
    return neighbour_distances(points, 5)[:, -1] < 1.0


def with_two_near(points: np.ndarray) -> np.ndarray:
    return neighbour_distances(points, 2)[:, -1] < 1.0


# Far points stand alone: a statistical filter takes all of them from a simulated street, a crop.
@pytest.mark.parametrize(
    ("keeps", "kind"),
    [
        (statistical, "cropped"),
        (by_radius, "outliers"),
        (with_two_near, "outliers"),
    ],
)
def test_filters_of_outliers_are_named(
    keeps: Callable[[np.ndarray], np.ndarray], kind: str
) -> None:
    pytest.importorskip("open3d")
    ends = map(sharpest_end, lone_distances(street().points))
    for (ratio, _), most in zip(ends, MAX_CUT, strict=True):
        assert ratio < most
    assert authenticate.inspect(street(), power=False).verdict != "processed"
    kept = street().select(np.flatnonzero(keeps(street().points)))
    found = authenticate.inspect(kept)
    assert found.verdict == "processed"
    (named,) = found.processing
    assert named.kind == kind
    if kind == "outliers":
        assert "from its neighbours, as a filter of outliers leaves a scan" in named.detail


# The first takes so much of a far road that a car seems to have been removed, the last the own car.
@pytest.mark.parametrize(("count", "metres"), [(16, 0.8), (10, 0.5), (0, 0.0)])
def test_filters_that_leave_some_lone_points_are_named(
    realdata: RealData, count: int, metres: float
) -> None:
    scan = read_scan(realdata(FRAME))
    if count:
        kept = neighbour_distances(scan.points, count)[:, -1] < metres
    else:
        mean = neighbour_distances(scan.points, 50).mean(axis=1)
        kept = mean < mean.mean() + mean.std()
    found = authenticate.inspect(scan.select(np.flatnonzero(kept)), power=False)
    assert found.verdict == "processed", found.reason
    assert [step.kind for step in found.processing] == ["outliers"]


@pytest.mark.parametrize("metres", [60.0, 72.0])
def test_a_crop_far_away_is_no_filter(realdata: RealData, metres: float) -> None:
    scan = read_scan(realdata(FRAME))
    kept = np.linalg.norm(scan.points, axis=1) < metres
    found = authenticate.inspect(scan.select(np.flatnonzero(kept)), power=False)
    assert [step.kind for step in found.processing] == ["cropped"]


def test_pasted_points_are_no_sign_of_a_filter(realdata: RealData) -> None:
    scan = read_scan(realdata(FRAME))
    kept = neighbour_distances(scan.points, 10)[:, -1] < 0.5
    filtered = scan.select(np.flatnonzero(kept))
    pasted = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 3)) + np.array([12, -4, -1])
    points = np.concatenate([filtered.points, pasted.round(3).astype(np.float32)])
    assert authenticate.inspect(points, origin=(0, 0, 0), power=False).verdict == "tampered"


def test_other_treatments_are_no_filter_of_outliers() -> None:
    pytest.importorskip("open3d")
    points = street().points
    away = np.linalg.norm(points, axis=1)
    random = np.random.default_rng(0).random(len(points))
    part = np.arctan2(points[:, 1], points[:, 0]) > 0.5  # ratio 6.2 in one street of 60
    for rows in (
        part,
        away < 40.0,
        points[:, 0] > 0.0,
        away > 3.0,
        random < 0.5,
        points[:, 2] < 0.5,
    ):
        found = authenticate.inspect(street().select(np.flatnonzero(rows)), power=False)
        assert found.verdict == "processed"
        assert "outliers" not in {step.kind for step in found.processing}
