"""Frames and skeletons: the joints' tables hang together, wrong shapes are named."""

from __future__ import annotations

import numpy as np
import pytest

import manip3d
from manip3d import rgbd

CAMERA = manip3d.Intrinsics(6, 4, 5.0, 5.0, 2.5, 1.5)


def test_the_tables_of_joints_agree() -> None:
    assert len(rgbd.JOINTS) == len(rgbd.PARENTS) == len(rgbd.MIRRORED_JOINTS) == 25
    for joint, other in enumerate(rgbd.MIRRORED_JOINTS):
        assert rgbd.MIRRORED_JOINTS[other] == joint
        name = rgbd.JOINTS[joint]
        swapped = {"Left": "Right", "Right": "Left"}
        side = next((s for s in swapped if name.endswith(s)), None)
        expected = name if side is None else name.removesuffix(side) + swapped[side]
        assert rgbd.JOINTS[other] == expected
        assert rgbd.MIRRORED_JOINTS[rgbd.PARENTS[joint]] == rgbd.PARENTS[other]


def test_every_joint_hangs_from_the_root() -> None:
    for joint in range(25):
        seen = [joint]
        while seen[-1] != 0:
            seen.append(rgbd.PARENTS[seen[-1]])
            assert len(seen) < 10


def test_a_frame_of_wrong_images_is_refused() -> None:
    calibration = manip3d.RgbdCalibration(CAMERA)
    depth = np.zeros((4, 6), np.uint16)
    frame = manip3d.RgbdFrame(depth, calibration, color=np.zeros((4, 6, 3), np.uint8))
    assert frame.skeletons == ()
    with pytest.raises(manip3d.InputError, match=r"frame\.depth: expected uint16 \(4, 6\)"):
        manip3d.RgbdFrame(depth.T, calibration)
    with pytest.raises(manip3d.InputError, match=r"frame\.body_index"):
        manip3d.RgbdFrame(depth, calibration, body_index=depth)
    with pytest.raises(manip3d.InputError, match=r"frame\.color"):
        manip3d.RgbdFrame(depth, calibration, color=np.zeros((4, 5, 3), np.uint8))


def test_a_mirrored_camera_is_refused() -> None:
    mirrored = manip3d.Intrinsics(6, 4, 5.0, 5.0, 2.5, 1.5, mirrored=True)
    with pytest.raises(manip3d.InputError, match="not mirrored"):
        manip3d.RgbdCalibration(mirrored)


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"positions": np.zeros((20, 3))}, "positions"),
        ({"positions": np.zeros((25, 3)), "states": np.full(25, 3)}, "states"),
        ({"positions": np.zeros((25, 3)), "body": 256}, "body"),
    ],
)
def test_a_wrong_skeleton_is_refused(fields: dict, match: str) -> None:
    with pytest.raises(manip3d.InputError, match=match):
        manip3d.Skeleton(**fields)
