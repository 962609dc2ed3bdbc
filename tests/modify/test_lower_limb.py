"""Shoe cover, placement and colliders on simulated and recorded people, whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import datasets, modify, rgbd
from real_data import RealData

JOINT = {name: number for number, name in enumerate(rgbd.JOINTS)}


def frames(count: int, **scene):
    """Frames of a seated person who lost the right leg, with their truth, ten a second."""
    pytest.importorskip("open3d")
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(motion="dorsiflexion", amputated="right_leg", **scene)
    return [simulator.capture(number / 10) for number in range(count)]


def test_the_shoe_cover_shows_how_the_foot_moves() -> None:
    """The shoe cover gives the foot's motion under noise, without joints beyond the ankle."""
    tracker = modify.ShoeCoverTracker()
    foot = JOINT["FootLeft"]
    found, truth = [], []
    for capture in frames(20, cover="both"):
        skeleton = tracker.update(capture.frame, capture.frame.skeletons[0], "left")
        assert skeleton is not None
        assert tracker.num_pixels > 100
        found.append(skeleton.positions[foot])
        truth.append(capture.truth.joints[foot])
    error = np.array(found) - np.array(truth)
    assert np.ptp(truth, axis=0)[1] > 0.05  # 5 cm up and down
    # The visible part of a shoe is not its joint; what matters is that the two move alike.
    assert np.linalg.norm(error, axis=1).max() < 0.05
    assert error.std(axis=0).max() < 0.01
    assert error.std(axis=0)[1] < 0.005
    for axis in range(3):
        assert np.corrcoef(np.array(found)[:, axis], np.array(truth)[:, axis])[0, 1] > 0.95


def test_without_a_cover_nothing_is_found() -> None:
    (capture,) = frames(1)
    tracker = modify.ShoeCoverTracker()
    assert tracker.update(capture.frame, capture.frame.skeletons[0], "left") is None


def test_reach_is_the_length_of_the_leg() -> None:
    estimator = modify.PlacementEstimator(stable_frames=5)
    for capture in frames(5):
        placement = estimator.update(capture.frame.skeletons[0], "left")
    assert placement is not None
    assert placement.frozen
    hip, knee, ankle = (
        capture.truth.joints[JOINT[f"{part}Left"]] for part in ("Hip", "Knee", "Ankle")
    )
    leg = np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee)
    assert placement.reach == pytest.approx(leg, rel=0.05)
    base = capture.truth.joints[JOINT["SpineBase"]]
    for target in (placement.left, placement.right):
        assert np.linalg.norm(target - base) == pytest.approx(0.9 * placement.reach, abs=0.01)


def test_colliders_of_a_recorded_person_cover_it(realdata: RealData) -> None:
    """Nine of ten points lie inside the solids that they made, which are no balloons."""
    realdata.needs("people_utd_mhad")
    tracker = modify.ColliderTracker()
    for frame in datasets.open_people("utd-mhad:a3_s1")[:30]:
        person, camera = frame.skeletons[0], frame.calibration.depth
        found = modify.segment_body(frame.depth, camera, person, body_index=frame.body_index)
        there = found.labels > 0
        body = tracker.update(person, found.labels[there], found.distances[there] ** 2)
    labels, distances = found.labels[there], found.distances[there]
    limbs = body.radius[labels] > 0
    inside = distances[limbs] <= body.radius[labels[limbs]]
    assert inside.mean() > 0.85
    radii = body.radius[body.radius > 0]
    assert radii.min() > 0.05
    assert radii.max() < 0.2
    assert (body.torso_half_size > 0.1).all()
