"""People in RGB-D frames: skeletons, their limbs, and what is made of them."""

from __future__ import annotations

from manip3d.modify._joints import JointLayout, joint_layouts, skeleton_from
from manip3d.modify._pose import PoseTracker, lift_landmarks

__all__ = [
    "JointLayout",
    "PoseTracker",
    "joint_layouts",
    "lift_landmarks",
    "skeleton_from",
]
