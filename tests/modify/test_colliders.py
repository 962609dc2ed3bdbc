"""Colliders, the shoe cover and the placement through Python; their rules are tested in C++."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
import pytest

import manip3d
from manip3d import datasets, modify, rgbd
from real_data import RealData

CAMERA = manip3d.Intrinsics(80, 60, 70.0, 70.0, 39.5, 29.5)


def standing() -> manip3d.Skeleton:
    """Made from the 17 joints of a symmetric person."""
    joints = dict.fromkeys(modify.joint_layouts()["coco"], (0.0, -0.7))
    for side, sign in (("Left", 1), ("Right", -1)):
        joints[f"Shoulder{side}"] = (0.2 * sign, -0.5)
        joints[f"Elbow{side}"] = (0.25 * sign, -0.2)
        joints[f"Wrist{side}"] = (0.3 * sign, 0.05)
        joints[f"Hip{side}"] = (0.1 * sign, 0.0)
        joints[f"Knee{side}"] = (0.1 * sign, 0.45)
        joints[f"Ankle{side}"] = (0.1 * sign, 0.85)
    positions = np.array([(*place, 2.0) for place in joints.values()])
    return modify.skeleton_from(positions, layout="coco")


def test_colliders_stand_where_the_bones_are() -> None:
    tracker = modify.ColliderTracker()
    skeleton = standing()
    labels = np.full(50, 6, np.uint8)
    body = tracker.update(skeleton, labels, np.full(50, 0.0399**2, np.float32))
    np.testing.assert_allclose(body.radius[[6, 10]], 0.04, rtol=1e-6)
    np.testing.assert_array_equal(body.start[6], skeleton.positions[5])
    np.testing.assert_array_equal(body.end[6], skeleton.positions[6])
    assert body.radius[[0, 1, 4, 7, 15, 20]].tolist() == [0] * 6  # torso; no hands, no feet
    np.testing.assert_allclose(body.torso_axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-6)
    np.testing.assert_allclose(body.torso_half_size, [0.2, 0.25, 0.05], atol=1e-6)
    np.testing.assert_allclose(body.torso_centre, [0.0, -0.25, 2.0], atol=1e-6)


def test_targets_hit_what_is_in_their_way() -> None:
    tracker = modify.ColliderTracker()
    tracker.update(standing())
    tracker.update(standing())
    start = np.array([[-2, -0.2, 2], [0, -0.25, 0], [3, 3, 3], [0.1, 0.6, 0]])
    hits = tracker.hits(start, start + np.array([0, 0, 4.0]) * (start[:, 2:] == 0), radius=0.02)
    assert hits.bone.tolist() == [-1, modify.TORSO, -1, 14]
    assert np.isnan(hits.time[[0, 2]]).all()
    # To the torso's front, 0.05 m before its middle, and the sphere's own radius.
    assert hits.time[1] == pytest.approx((2 - 0.05 - 0.02) / 4, abs=1e-4)
    assert hits.point[1, 2] == pytest.approx(2 - 0.07, abs=2e-4)
    with pytest.raises(manip3d.InputError, match="expected as many ends and radii as starts"):
        tracker.hits(start, start[:2])
    tracker.reset()
    assert not tracker.colliders.radius.any()


def test_spheres_without_a_size_touch_nothing_and_negative_ones_are_refused() -> None:
    """A sphere smaller than a point would reach into the capsules before it touches them."""
    tracker = modify.ColliderTracker()
    start, end = np.array([[0, 0.6, 0], [0.1, 0.6, 0]]), np.array([[0, 0.6, 4], [0.1, 0.6, 4]])
    assert tracker.hits(start, end).bone.tolist() == [-1, -1]  # there is no person yet
    tracker.update(standing())
    assert tracker.hits(start, end).bone.tolist() == [-1, 14]  # the person stands still
    assert tracker.hits(start, end, radius=[0.1, np.nan]).bone[1] == -1
    for radius in (-0.01, [0.02, -0.01]):
        with pytest.raises(manip3d.InputError, match=r"radius: expected numbers >= 0, got -0\.01"):
            tracker.hits(start, end, radius=radius)


def test_labels_come_with_distances() -> None:
    with pytest.raises(manip3d.InputError, match="expected both or neither"):
        modify.ColliderTracker().update(standing(), np.zeros(3, np.uint8))
    with pytest.raises(manip3d.InputError, match=r"expected as many as distances \(2\), got 3"):
        modify.ColliderTracker().update(standing(), np.zeros(3, np.uint8), np.zeros(2))
    with pytest.raises(manip3d.InputError, match="percentile"):
        modify.ColliderTracker(percentile=float("nan"))


def picture(color: np.ndarray) -> manip3d.RgbdFrame:
    depth = np.full((60, 80), 2000, np.uint16)
    return manip3d.RgbdFrame(depth, manip3d.RgbdCalibration(CAMERA), color=color)


def test_the_foot_goes_where_the_shoe_cover_is() -> None:
    color = np.full((60, 80, 3), 128, np.uint8)
    color[30:37, 40:49] = (30, 60, 200)
    positions = np.zeros((25, 3), np.float32)
    positions[14] = (0, 0, 2)
    skeleton = manip3d.Skeleton(positions, id=5, body=0)
    tracker = modify.ShoeCoverTracker()
    found = tracker.update(picture(color), skeleton, "left")
    assert found is not None
    assert (found.id, found.body, tracker.num_pixels) == (5, 0, 63)
    np.testing.assert_allclose(
        found.positions[15], [(44 - 39.5) / 35, (33 - 29.5) / 35, 2], atol=1e-6
    )
    np.testing.assert_array_equal(found.positions[:15], positions[:15])
    green = modify.ShoeCoverTracker(hue=(50, 70))
    assert green.update(picture(color), skeleton, "left") is None
    with pytest.raises(manip3d.InputError, match="side: expected 'left' or 'right', got 'up'"):
        tracker.update(picture(color), skeleton, "up")
    with pytest.raises(manip3d.InputError, match=r"expected colour of shape \(60, 80, 3\)"):
        tracker.update(
            manip3d.RgbdFrame(picture(color).depth, manip3d.RgbdCalibration(CAMERA)),
            skeleton,
            "left",
        )


def test_a_placement_freezes() -> None:
    estimator = modify.PlacementEstimator(stable_frames=3)
    states = [estimator.update(standing(), "right") for _ in range(3)]
    assert [state.frozen for state in states] == [False, False, True]
    assert states[2].knee_height == pytest.approx(0.4)
    assert states[2].reach == pytest.approx(0.4 * 0.491 / 0.246)
    np.testing.assert_allclose(states[2].left * [-1, 1, 1], states[2].right, atol=1e-6)
    estimator.reset()
    lost = manip3d.Skeleton(np.zeros((25, 3)), states=np.zeros(25))
    assert estimator.update(lost, "right") is None


@pytest.mark.golden
def test_hits_are_the_same_bits_everywhere(golden: Callable[..., None]) -> None:
    rng = np.random.default_rng(4)
    tracker = modify.ColliderTracker()
    tracker.update(standing())
    moved = standing().positions + rng.uniform(-0.1, 0.1, (25, 3)).astype(np.float32)
    tracker.update(manip3d.Skeleton(moved, states=standing().states))
    start, end = rng.uniform([-1, -1, 1], [1, 1, 3], (2, 500, 3))
    hits = tracker.hits(start, end, radius=rng.uniform(0, 0.1, 500))
    assert 100 < (hits.bone >= 0).sum() < 400
    digest = hashlib.sha256(hits.time.tobytes() + hits.bone.tobytes() + hits.point.tobytes())
    golden("colliders: hits of 500 moving spheres", digest.hexdigest())


def test_a_waving_hand_pops_a_bubble_beside_the_head_once_it_gets_there(
    realdata: RealData,
) -> None:
    realdata.needs("people_utd_mhad")
    tracker = modify.ColliderTracker()
    frames = datasets.open_people("utd-mhad:a3_s1")
    hand = rgbd.JOINTS.index("HandRight")
    places = np.array([frame.skeletons[0].positions[hand] for frame in frames])
    bubble = places[places[:, 1].argmin()]  # the highest
    hits = []
    for frame in frames:
        tracker.update(frame.skeletons[0])
        hits.append(tracker.hits(bubble[None], bubble[None], radius=0.02).bone[0])
    first = next(i for i, bone in enumerate(hits) if bone >= 0)
    assert 3 < first <= places[:, 1].argmin()
    assert rgbd.JOINTS[hits[first]] in ("WristRight", "HandRight")
