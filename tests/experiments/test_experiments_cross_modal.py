"""Cameras against LiDAR: how its table counts."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import Box, LidarFrame
from manip3d._util.shares import wilson
from manip3d.experiments import Plan, _alert_attacks, cross_modal_7, registry
from manip3d.experiments._model import Row

CAR = Box((12.0, 2.0, -0.9), (4.0, 1.8, 1.5))


def scene() -> LidarFrame:
    """A car on flat ground."""
    random = np.random.default_rng(0)
    ground = random.uniform([2, -20, -1.71], [40, 20, -1.69], (20_000, 3))
    car = np.asarray(CAR.center) + random.uniform(-0.5, 0.5, (800, 3)) * CAR.size
    return LidarFrame(np.concatenate([ground, car]).astype(np.float32))


def test_it_is_registered_with_all_published_frames() -> None:
    experiment = registry()["table-7.2-cross-modal"]
    cases = experiment.cases(Plan("simulated", "full"))
    assert [case.options["frames"] for case in cases] == [800, 395, 570]
    assert not set(cross_modal_7.TUNED) & set(cross_modal_7.REPORTED)
    assert {*cross_modal_7.TUNED, *cross_modal_7.REPORTED} == set(cross_modal_7._REAL)


@pytest.mark.published("table 7.2")
def test_the_published_sums_are_those_of_the_table() -> None:
    rows = [cross_modal_7._complete({"model": f"drive {number}"}) for number in (1, 2, 3)]
    assert sum(row["published attacks"] for row in rows) == 8735
    assert [row["published clean"] for row in rows] == [28, 13, 6]


@pytest.mark.parametrize(
    ("found", "of", "low", "high"),
    [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (10, 10, 0.7225, 1.0), (0, 0, 0.0, 1.0)],
)
def test_intervals_are_wilson_s(found: int, of: int, low: float, high: float) -> None:
    assert wilson(found, of) == pytest.approx((low, high), abs=1e-4)


def test_claims_follow_the_counts() -> None:
    perfect: Row = {"model": "drive 1", "frames": 100, "clean": 0, "attacks": 600, "detected": 600}
    counts = ("", " of", " placed", " typed")
    perfect |= {f"{a}{count}": 100 for a in _alert_attacks.ATTACKS for count in counts}
    for change, accurate, calm in (
        ({}, True, True),
        ({"detected": 500}, False, True),
        ({"clean": 3}, True, False),
    ):
        row = perfect | change
        assert [f.holds for f in cross_modal_7._accuracy([row])] == [accurate]
        assert [f.holds for f in cross_modal_7._false_positives([row])] == [calm]
    assert all("100 of the right type" in f.numbers for f in cross_modal_7._by_attack([perfect]))
    tuned = perfect | {"model": cross_modal_7.TUNED[0]}
    assert list(cross_modal_7._accuracy([tuned])) == []  # never reported


def test_every_attack_changes_the_object_and_says_where() -> None:
    frame = scene()
    (target,) = _alert_attacks.targets(frame, [CAR, Box((-9.0, 0.0, 0.0), CAR.size)])
    before = np.count_nonzero(target.contains(frame.points))
    for attack in _alert_attacks.ATTACKS:
        made = _alert_attacks.attacked(frame, target, attack, np.random.default_rng(0))
        assert made is not None, attack
        forged, places = made
        assert places
        if attack == "additive":
            assert forged.num_points == frame.num_points + before
            continue
        assert not np.array_equal(forged.points, frame.points), attack
        if attack in ("subtractive", "additive_subtractive"):
            assert np.count_nonzero(target.contains(forged.points)) == 0, attack


def test_a_box_found_elsewhere_is_not_at_the_right_place() -> None:
    assert cross_modal_7._touch(Box((13.5, 2.5, 0.0), (1.0, 1.0, 1.0)), CAR)
    assert not cross_modal_7._touch(Box((25.0, 2.0, 0.0), (1.0, 1.0, 1.0)), CAR)


def test_a_single_frame_shows_no_share_of_a_few_percent() -> None:
    """None accused among one frame was called at most 2.66 %, with an interval up to 79 %."""
    row: Row = {"model": "drive 1", "frames": 1, "clean": 0, "attacks": 6, "detected": 6}
    for judge in (cross_modal_7._false_positives, cross_modal_7._accuracy):
        (finding,) = judge([row])
        assert finding.holds is None
        assert "too few" in finding.unjudged
    (enough,) = cross_modal_7._false_positives([row | {"frames": 38}])
    assert enough.holds is True


def test_many_errors_among_few_frames_refute_a_share() -> None:
    """26 of 36 right, against published 97.56 %, were called too few to judge."""
    row: Row = {"model": "kitti_object", "frames": 6, "clean": 3, "attacks": 30, "detected": 23}
    (accurate,) = cross_modal_7._accuracy([row])
    (calm,) = cross_modal_7._false_positives([row])
    assert (accurate.holds, accurate.unjudged) == (False, "")
    assert accurate.numbers == "26 of 36 right, 72.2% (56.0% to 84.2%)"
    assert (calm.holds, calm.unjudged) == (False, "")
