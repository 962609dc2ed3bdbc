"""Scans in closed form: the detectors take them for clean ones, and their points are where said."""

from __future__ import annotations

import math

import numpy as np
import pytest

from manip3d import InputError, LidarFrame, simulate
from manip3d.authenticate import inspect, kitti_lattice
from manip3d.simulate._world import Label
from manip3d.simulate.small_scans import BOXES, YARD


def test_a_clean_cave_has_no_trace() -> None:
    found = inspect(simulate.cave())
    assert (found.verdict, found.sensor.kind) == ("no_trace", "terrestrial")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_clean_courtyard_has_no_trace(seed: int) -> None:
    turns = [simulate.courtyard(x, rng=10 * seed + k) for k, x in enumerate((2.0, 3.0, 4.0))]
    found = inspect(turns[1], previous=turns[0], following=turns[2])
    assert (found.verdict, found.sensor.name) == ("no_trace", "HDL-64E")


def test_the_same_seed_gives_the_same_scan() -> None:
    for scan in (simulate.cave, simulate.courtyard):
        first, second, other = scan(rng=4), scan(rng=4), scan(rng=5)
        assert np.array_equal(first.points, second.points)
        assert not np.array_equal(first.points, other.points)


def test_points_of_the_cave_stand_on_the_grid() -> None:
    view = (0.0, 3.0), (-1.0, 1.0)
    points = simulate.cave(1.0, field_of_view=view, range_noise=0.0).points.astype(np.float64)
    x, y, z = points.T
    azimuth = np.degrees(np.arctan2(y, x)).reshape(3, 2)
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y))).reshape(3, 2)
    assert np.allclose(azimuth, [[0.5, 0.5], [1.5, 1.5], [2.5, 2.5]], atol=0.01)
    assert np.allclose(elevation, [[-0.5, 0.5]] * 3, atol=1e-4)


def distance_outside(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distance to a box; negative inside: the depth under its surface."""
    beyond = np.maximum(low - points, points - high)
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return outside + np.minimum(beyond.max(axis=1), 0.0)


def test_points_of_the_courtyard_are_on_what_their_labels_say() -> None:
    x = -3.0
    scan = simulate.courtyard(x, rng=1)
    places = scan.points + np.array([x, 0.0, 0.0])
    number, label = scan.fields["object"], scan.fields["label"]
    for k, corners in enumerate(BOXES):
        assert np.all(label[number == k] == Label.FURNITURE)
        off = distance_outside(places[number == k], *map(np.array, corners))
        assert abs(off).max() < 0.06  # five standard deviations of the ranges
    inner = np.isin(label, (Label.GROUND, Label.WALL))
    assert abs(distance_outside(places[inner], *map(np.array, YARD))).max() < 0.06


def test_points_of_the_courtyard_stand_on_the_lattice_of_kitti() -> None:
    scan = simulate.courtyard()
    reading = kitti_lattice().read(scan.points)
    assert np.mean(reading.ring == scan.ring) > 0.99
    assert np.median(abs(reading.line_error)) < 0.001


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: simulate.cave(0.0), "resolution_deg: expected degrees from 0.01 on"),
        (lambda: simulate.cave(math.nan), "resolution_deg: "),
        (lambda: simulate.cave(math.inf), "resolution_deg: "),
        (
            lambda: simulate.cave(field_of_view=((math.nan, 1.0), (0.0, 1.0))),
            "field_of_view: expected finite degrees",
        ),
        (lambda: simulate.cave(range_noise=-1.0), "range_noise: expected a finite number >= 0"),
        (
            lambda: simulate.cave(field_of_view=((0.0, 0.0), (0.0, 1.0))),
            "field_of_view: expected at least one step",
        ),
        (lambda: simulate.courtyard(9.0), "x: expected -8 <= metres <= 8"),
        (lambda: simulate.courtyard(math.nan), "x: "),
    ],
)
def test_wrong_options_are_refused(call: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()  # type: ignore[operator]


def test_both_are_frames() -> None:
    frames = simulate.cave(1.0), simulate.courtyard()
    assert [type(frame) for frame in frames] == [LidarFrame, LidarFrame]
    assert [frame.source for frame in frames] == ["simulate.cave", "simulate.courtyard"]
