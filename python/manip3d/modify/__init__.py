"""People in RGB-D frames: skeletons, their limbs, and what is made of them."""

from __future__ import annotations

from manip3d.modify._joints import JointLayout, joint_layouts, skeleton_from

__all__ = [
    "JointLayout",
    "joint_layouts",
    "skeleton_from",
]
