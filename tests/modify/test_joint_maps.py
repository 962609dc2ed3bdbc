"""Skeletons of other trackers become the Kinect V2's 25 joints."""

from __future__ import annotations

import numpy as np
import pytest

import manip3d
from manip3d import modify, rgbd

SIZES = {"kinect-v2": 25, "kinect-v1": 20, "azure-kinect": 32, "mediapipe": 33, "coco": 17,
         "openpose": 25, "coco-wholebody": 133}  # fmt: skip
LAYOUTS = sorted(SIZES)


def standing(layout: str) -> np.ndarray:
    """A symmetric person: each joint at a place that its name alone decides."""
    heights = {
        "Foot": 0.9, "Heel": 0.9, "Ankle": 0.85, "Knee": 0.45, "Hip": 0.0, "Pelvis": 0.0,
        "SpineBase": 0.0, "Spine": -0.2, "SpineNavel": -0.2, "SpineMid": -0.25, "Hand": 0.0,
        "Wrist": -0.05, "Elbow": -0.3, "Shoulder": -0.5, "Clavicle": -0.5, "SpineChest": -0.4,
    }  # fmt: skip
    rows = []
    for name in modify.joint_layouts()[layout]:
        part = name.removesuffix("Left").removesuffix("Right")
        side = 0.2 * (name.endswith("Left") - name.endswith("Right"))
        rows.append((side, heights.get(part, -0.7), 2.0))
    return np.array(rows)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_has_its_number_of_joints(layout: str) -> None:
    assert set(modify.joint_layouts()) == set(SIZES)
    names = modify.joint_layouts()[layout]
    assert len(names) == len(set(names)) == SIZES[layout]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_maps_move_with_the_body_and_keep_its_sides(layout: str) -> None:
    """Weights that do not sum to one, or a left joint made from a right one, show here."""
    joints = standing(layout)
    skeleton = modify.skeleton_from(joints, layout=layout)
    moved = modify.skeleton_from(joints + np.array([1.0, 2.0, 3.0]), layout=layout)
    there = skeleton.states != rgbd.NOT_TRACKED
    np.testing.assert_allclose(
        moved.positions[there], skeleton.positions[there] + np.array([1, 2, 3]), atol=1e-6
    )
    for joint, name in enumerate(rgbd.JOINTS):
        if there[joint]:
            side = name.endswith("Left") - name.endswith("Right")
            assert np.sign(skeleton.positions[joint, 0]) == side, name
    mirrored = list(rgbd.MIRRORED_JOINTS)
    assert (skeleton.states == skeleton.states[mirrored]).all()
    np.testing.assert_allclose(
        skeleton.positions[mirrored], skeleton.positions * [-1, 1, 1], atol=1e-6
    )


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_middle_of_a_symmetric_body_is_exactly_in_the_middle(layout: str) -> None:
    """Middle joints have x = 0 on every processor; fused multiply-add would leave a remainder."""
    middle = [j for j, name in enumerate(rgbd.JOINTS) if not name.endswith(("Left", "Right"))]
    for width in np.random.default_rng(5).uniform(0.1, 3.0, 200):
        joints = standing(layout) * [width, 1.0, 1.0]
        skeleton = modify.skeleton_from(joints, layout=layout)
        assert (skeleton.positions[middle, 0] == 0.0).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_names_that_both_know_are_the_same_joint(layout: str) -> None:
    joints = np.random.default_rng(3).normal(size=(SIZES[layout], 3))
    skeleton = modify.skeleton_from(joints, layout=layout)
    names = modify.joint_layouts()[layout]
    assert len(set(names) & set(rgbd.JOINTS)) >= 10
    for row, name in enumerate(names):
        # A hand of MediaPipe's is none of its landmarks, the thumb is.
        if name in rgbd.JOINTS:
            np.testing.assert_array_equal(
                skeleton.positions[rgbd.JOINTS.index(name)], joints[row].astype(np.float32)
            )


def test_what_a_tracker_lacks() -> None:
    def names(layout: str, state: int) -> set[str]:
        states = modify.skeleton_from(standing(layout), layout=layout).states
        return {rgbd.JOINTS[j] for j in np.flatnonzero(states == state)}

    ends = {f"{part}{side}" for part in ("HandTip", "Thumb") for side in ("Left", "Right")}
    hands_feet = {f"{part}{side}" for part in ("Hand", "Foot") for side in ("Left", "Right")}
    assert names("kinect-v1", rgbd.NOT_TRACKED) == ends
    assert names("kinect-v1", rgbd.INFERRED) == {"Neck"}
    assert names("azure-kinect", rgbd.TRACKED) == set(rgbd.JOINTS)
    assert names("coco", rgbd.NOT_TRACKED) == ends | hands_feet
    hands = {f"Hand{side}" for side in ("Left", "Right")}
    assert names("openpose", rgbd.NOT_TRACKED) == ends | hands
    assert names("coco-wholebody", rgbd.NOT_TRACKED) == set()
    assert names("coco-wholebody", rgbd.INFERRED) == {"Neck", "SpineMid"}
    assert names("mediapipe", rgbd.NOT_TRACKED) == set()
    assert names("mediapipe", rgbd.INFERRED) == {"Neck", "SpineMid", "HandTipLeft", "HandTipRight"}


def test_a_made_joint_is_as_good_as_its_worst_source() -> None:
    joints = standing("coco")
    names = modify.joint_layouts()["coco"]
    states = np.full(17, rgbd.TRACKED)
    states[names.index("HipLeft")] = rgbd.INFERRED
    states[names.index("ShoulderRight")] = rgbd.NOT_TRACKED
    found = modify.skeleton_from(joints, states, layout="coco").states
    assert found[rgbd.JOINTS.index("SpineBase")] == rgbd.INFERRED
    assert found[rgbd.JOINTS.index("SpineShoulder")] == rgbd.NOT_TRACKED
    assert found[rgbd.JOINTS.index("ShoulderLeft")] == rgbd.TRACKED


def test_the_nose_stands_in_for_a_hidden_ear() -> None:
    joints = standing("mediapipe")
    names = modify.joint_layouts()["mediapipe"]
    joints[names.index("EarLeft")] = np.nan
    skeleton = modify.skeleton_from(joints, layout="mediapipe")
    head = rgbd.JOINTS.index("Head")
    assert skeleton.states[head] == rgbd.INFERRED
    np.testing.assert_allclose(skeleton.positions[head], joints[names.index("Nose")], atol=1e-6)
    assert np.isfinite(skeleton.positions).all()


def test_the_kinect_s_axes_are_turned() -> None:
    joints = standing("kinect-v2")
    skeleton = modify.skeleton_from(joints, layout="kinect-v2", axes="kinect", id=7, body=2)
    np.testing.assert_array_equal(skeleton.positions, (joints * [-1, -1, 1]).astype(np.float32))
    assert (skeleton.id, skeleton.body) == (7, 2)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"layout": "halpe"}, "layout: expected 'kinect-v2', .*got 'halpe'"),
        ({"layout": "coco"}, "joints: expected 17 rows for coco, got 20"),
        ({"layout": "kinect-v1", "states": np.ones(3)}, r"states: expected shape \(20,\)"),
        ({"layout": "kinect-v1", "states": np.full(20, 3)}, "states: expected 0, 1 or 2"),
        ({"layout": "kinect-v1", "axes": "opengl"}, "axes: expected 'camera' or 'kinect'"),
    ],
)
def test_wrong_arguments_are_named(options: dict, match: str) -> None:
    with pytest.raises(manip3d.InputError, match=match):
        modify.skeleton_from(np.zeros((20, 3)), **options)
