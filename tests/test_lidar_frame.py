"""`LidarFrame`: what it refuses, what travels with points."""

from __future__ import annotations

import json
import re
import tracemalloc
from typing import Any

import numpy as np
import pytest

import manip3d
from manip3d import Box, InputError, LidarFrame
from manip3d.lidar import ScanFormat, box_corners, box_outline


def frame(**changes: Any) -> LidarFrame:
    values: dict[str, Any] = {
        "points": np.arange(12, dtype=np.float32).reshape(4, 3),
        "intensity": np.array([0.1, 0.2, 0.3, 0.4], np.float32),
        "ring": np.array([3, 2, 1, 0], np.uint8),
        "fields": {"echo": np.array([1, 2, 1, 2], np.uint8), "rgb": np.eye(4, 3)},
    }
    return LidarFrame(**(values | changes))


def test_arrays_of_the_right_kind_are_not_copied() -> None:
    points = np.zeros((5, 3), np.float32)
    intensity = np.zeros(5, np.float32)
    made = LidarFrame(points, intensity)
    assert np.shares_memory(made.points, points)
    assert np.shares_memory(made.intensity, intensity)
    assert LidarFrame([[1, 2, 3]]).points.dtype == np.float32


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points": np.zeros((4, 2))}, "points: expected shape (N, 3), got (4, 2)"),
        ({"points": [[0, 0, np.nan]] * 4}, "points: expected finite numbers, got nan in row 0"),
        ({"points": [[0, 0, 0]] * 3 + [[0, np.inf, 0]]}, "got inf in row 3"),
        ({"intensity": [0.0] * 3}, "intensity: expected 4 values, got 3"),
        ({"intensity": [0.0, 0.0, np.nan, 0.0]}, "intensity: expected finite numbers"),
        ({"intensity": np.zeros((4, 1))}, "intensity: expected shape (N,), got (4, 1)"),
        ({"ring": np.zeros(4)}, "ring: expected integers, got dtype float64"),
        ({"ring": [1, 2]}, "ring: expected 4 rows"),
        ({"ring": np.zeros((4, 1), np.uint8)}, "ring: expected shape (N,), got (4, 1)"),
        ({"ring": np.zeros((4, 2), np.int64)}, "ring: expected shape (N,), got (4, 2)"),
        ({"file_rows": np.zeros((4, 1), np.int64)}, "file_rows: expected shape (N,), got (4, 1)"),
        ({"fields": {"a": np.zeros(3)}}, "a: expected 4 rows, as many as points"),
        (
            {"ring": np.zeros(3, np.uint8), "fields": {"ring": np.zeros(4)}},
            "ring: expected 4 rows, as many as points",
        ),
        ({"exact": np.zeros((3, 3))}, "exact: expected 4 rows"),
        ({"origin": (0.0, 0.0)}, "origin: expected three finite numbers"),
        ({"origin": (0.0, 0.0, np.nan)}, "origin: expected three finite numbers"),
    ],
)
def test_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        frame(**changes)


def test_selection_takes_every_column() -> None:
    kept = frame().select(np.array([False, True, False, True]))
    assert kept.points.tolist() == [[3, 4, 5], [9, 10, 11]]
    assert kept.ring is not None
    assert kept.ring.tolist() == [2, 0]
    assert kept.fields["echo"].tolist() == [2, 2]
    assert kept.fields["rgb"].shape == (2, 3)
    assert frame().select([2, 0]).points[:, 0].tolist() == [6, 0]
    with pytest.raises(InputError, match=r"mask of shape \(4,\), got \(3,\)"):
        frame().select(np.array([True, False, True]))


@pytest.mark.parametrize("dtype", [np.uint8, np.int8])
def test_a_mask_of_bytes_is_no_list_of_rows(dtype: type[np.generic]) -> None:
    """The frame had copies of its first two points: as many points as before, all of them wrong."""
    mask = np.array([0, 1, 0, 1], dtype)
    with pytest.raises(InputError, match=r"rows: expected a mask of dtype bool, got u?int8 0 or 1"):
        frame().select(mask)
    for rows in (mask.astype(np.int64), mask[:3], np.array([0, 1, 2, 1], dtype)):
        np.testing.assert_array_equal(frame().select(rows).points, frame().points[rows])
    two = LidarFrame(np.eye(3)[:2])
    np.testing.assert_array_equal(two.select(mask[:2]).points, two.points)


def test_new_points_have_zeros_beside_them() -> None:
    new = np.array([[3, 4, 5], [100, 100, 100], [0, 1, 2.5]], np.float32)
    made = frame().with_points(new, source_index=[1, -1, 0])
    assert made.points.tolist() == new.tolist()
    assert made.intensity is not None
    assert made.intensity.tolist() == np.array([0.2, 0.0, 0.1], np.float32).tolist()
    assert made.fields["echo"].tolist() == [2, 0, 1]
    given = frame().with_points(new, source_index=[1, -1, 0], intensity=[0.5, 0.5, 0.5])
    assert given.intensity is not None
    assert given.intensity.tolist() == [0.5, 0.5, 0.5]
    empty = LidarFrame(np.empty((0, 3))).with_points([[1, 2, 3]], source_index=[-1])
    assert empty.num_points == 1


def test_exact_coordinates_stay_where_points_stayed() -> None:
    exact = np.array([[5e5 + 0.1, 5e6 + 0.2, 100.3], [5e5 + 1.1, 5e6 + 1.2, 101.3]])
    offset = np.array([5e5, 5e6, 100.0])
    to_file = np.eye(4)
    to_file[:3, 3] = offset
    scan = LidarFrame(
        (exact - offset).astype(np.float32), exact=exact, format=ScanFormat("las", to_file=to_file)
    )
    moved = scan.points.copy()
    moved[1, 2] += 1.0
    made = scan.with_points(moved, source_index=[0, 1])
    assert made.exact is not None
    assert made.exact[0].tolist() == exact[0].tolist()
    np.testing.assert_allclose(made.exact[1], exact[1] + [0, 0, 1], atol=1e-6)


def test_a_summary_has_counts_and_extents_in_the_coordinates_of_a_map() -> None:
    to_file = np.eye(4)
    to_file[:3, 3] = (5e5, 5e6, 100.0)
    scan = LidarFrame(
        [[3, 4, 0], [0, 0, 0], [-6, 8, 1]],
        intensity=[0.25, 0.0, 0.5],
        ring=[7, 0, 7],
        origin=(0, 0, 1),
        fields={"echo": np.array([1, 1, 2], np.uint8)},
        format=ScanFormat("las", header={"unit": "m", "scale": 0.01}, to_file=to_file),
        num_dropped=2,
    )
    found = scan.summary()
    assert (found.num_points, found.num_empty, found.num_dropped) == (3, 1, 2)
    assert found.bounds == ((499994.0, 5000004.0, 100.0), (500003.0, 5000008.0, 101.0))
    assert found.origin == (500000.0, 5000000.0, 101.0)
    assert found.distances == (26**0.5, 10.0)
    assert (found.intensity, found.ring, found.num_rings) == ((0.0, 0.5), (0, 7), 2)
    record = found.record()
    assert json.loads(json.dumps(record)) == record
    assert (record["unit"], record["fields"]) == ("m", {"echo": "uint8"})
    assert "scale" not in record


def test_a_summary_of_no_points_has_no_extents() -> None:
    found = LidarFrame(np.empty((0, 3))).summary()
    assert found.num_points == 0
    assert (found.bounds, found.distances, found.intensity, found.num_rings) == (None,) * 4


@pytest.mark.parametrize(
    ("index", "message"),
    [
        ([0, 1], "expected (1,) integers"),
        ([0.0], "expected (1,) integers, got float64"),
        ([4], "expected values in [-1, 3], got 4 to 4"),
        ([-2], "expected values in [-1, 3]"),
    ],
)
def test_source_index_is_checked(index: list[Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        frame().with_points([[0, 0, 0]], source_index=index)


def test_an_empty_list_is_an_index_of_no_points() -> None:
    made = frame().with_points([], source_index=[])
    assert (made.num_points, made.fields["rgb"].shape) == (0, (0, 3))


def test_frames_are_frozen_and_replaced() -> None:
    scan = frame()
    with pytest.raises(AttributeError):
        scan.points = scan.points  # type: ignore[misc]
    with pytest.raises(TypeError):
        scan.fields["new"] = scan.points  # type: ignore[index]
    later = scan.replace(time_ns=2_500_000_000)
    assert later.time_ns == 2_500_000_000
    assert later.points is scan.points
    with pytest.raises(InputError, match="no such attribute: time"):
        scan.replace(time=2.5)
    assert repr(later) == "<manip3d.LidarFrame: 4 points; rings 0-3; t = 2.500 s; echo, rgb>"


def test_empty_returns_are_counted() -> None:
    assert LidarFrame([[0, 0, 0], [1, 0, 0], [0, 0, 0]]).num_empty == 2


def test_corners_of_a_box() -> None:
    box = Box((10.0, 5.0, 0.5), (4.0, 0.1, 1.0), np.pi / 2)  # its length is along y
    corners = [[10 - y, 5 + x, z] for x in (-2, 2) for y in (-0.05, 0.05) for z in (0, 1)]
    np.testing.assert_allclose(box_corners(box), corners)
    seen_from_above = [[9.8, 7, 0.5], [9.8, 3, 0.5], [10.2, 3, 0.5], [10.2, 7, 0.5]]
    np.testing.assert_allclose(box_outline(box, 0.4), seen_from_above)


def test_box_contains_what_lies_inside() -> None:
    #   y
    #   |  a car of 4 x 2 x 1 m at (10, 5, 0.5), turned by 90 degrees: along y
    box = Box((10.0, 5.0, 0.5), (4.0, 2.0, 1.0), np.pi / 2, "Car")
    inside = [[10, 5, 0.5], [10, 6.9, 0.5], [10.9, 5, 0.5], [10, 5, 0.9]]
    outside = [[10, 7.1, 0.5], [11.1, 5, 0.5], [10, 5, 1.1], [-10, 5, 0.5]]
    assert box.contains(inside + outside).tolist() == [True] * 4 + [False] * 4


def test_box_contains_the_same_points_wherever_it_is() -> None:
    rng = np.random.default_rng(5)
    for scale in (1e-3, 1.0, 1e6):
        for yaw in (0.0, 0.7, 1e5):
            center, size = rng.normal(size=3) * scale * 100, rng.uniform(0, 4, 3) * scale
            box = Box(tuple(center), tuple(size), yaw)
            # In the box's own axes half of them lie around it, many of them on its faces.
            own = rng.uniform(-0.6, 0.6, (4000, 3)) * size
            own[::7, rng.integers(3)] = 0.5 * size[0]
            turn = np.array(
                [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
            )
            points = np.concatenate([own @ turn.T + center, np.full((3, 3), np.nan)])
            points[-1] = np.inf
            offset = points - center
            with np.errstate(invalid="ignore"):
                along = np.cos(yaw) * offset[:, 0] + np.sin(yaw) * offset[:, 1]
                across = np.cos(yaw) * offset[:, 1] - np.sin(yaw) * offset[:, 0]
            inside = np.abs(np.column_stack([along, across, offset[:, 2]])) * 2 <= size
            assert 500 < inside.all(axis=1).sum() < 3500
            np.testing.assert_array_equal(box.contains(points), inside.all(axis=1))


def test_top_level_names() -> None:
    assert manip3d.LidarFrame is LidarFrame
    assert "read_scan" not in manip3d.__all__


@pytest.mark.parametrize(
    ("center", "size", "yaw", "message"),
    [
        ((0, 0), (1, 1, 1), 0.0, "center: expected 3 values"),
        ((0, 0, 0), 1.0, 0.0, "size: expected 3 values"),
        (("a", "b", "c"), (1, 1, 1), 0.0, "center: expected 3 values"),
        ((0, np.nan, 0), (1, 1, 1), 0.0, "center: expected finite numbers"),
        ((0, 0, 0), (1, np.inf, 1), 0.0, "size: expected finite numbers"),
        ((0, 0, 0), (1, -1, 1), 0.0, "size: expected numbers >= 0"),
        ((0, 0, 0), (1, 1, 1), np.nan, "yaw: expected a finite number"),
    ],
)
def test_what_is_no_box_is_refused(center: Any, size: Any, yaw: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Box(center, size, yaw)


def test_a_few_rows_of_a_large_cloud_need_little_memory() -> None:
    frame = LidarFrame(np.zeros((1_000_000, 3), np.float32))
    tracemalloc.start()
    try:
        chosen = frame.select([5, -1])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert chosen.file_rows is not None
    assert chosen.file_rows.tolist() == [5, 999_999]
    assert peak < 1_000_000  # numbers of all rows would be 8 MB
