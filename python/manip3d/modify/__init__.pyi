from __future__ import annotations

from manip3d.modify._animation import (
    Animated,
    AnimationMesh,
    PoseScope,
    Skinning,
    animate,
    animation_mesh,
)
from manip3d.modify._colliders import TORSO, BodyColliders, ColliderTracker, Hits
from manip3d.modify._joints import JointLayout, joint_layouts, skeleton_from
from manip3d.modify._lower_limb import Placement, PlacementEstimator, ShoeCoverTracker, Side
from manip3d.modify._motions import skeletons_from_motion
from manip3d.modify._phantom import (
    BodyMirror,
    BodyPlane,
    BodySegmentation,
    DownSource,
    Limb,
    MirrorMode,
    PhantomFrame,
    PhantomPipeline,
    PhantomQuality,
    PhantomReason,
    PhantomState,
    PixelKind,
    PlaneRule,
    Segmentation,
    Texturing,
    body_mirror,
    segment_body,
)
from manip3d.modify._pose import PoseTracker, lift_landmarks
from manip3d.modify._repose import POSABLE_JOINTS, Reposed, repose
from manip3d.modify._smoothing import JointSmoother, KeyPerson, clothing_colors

__all__ = [
    "POSABLE_JOINTS",
    "TORSO",
    "Animated",
    "AnimationMesh",
    "BodyColliders",
    "BodyMirror",
    "BodyPlane",
    "BodySegmentation",
    "ColliderTracker",
    "DownSource",
    "Hits",
    "JointLayout",
    "JointSmoother",
    "KeyPerson",
    "Limb",
    "MirrorMode",
    "PhantomFrame",
    "PhantomPipeline",
    "PhantomQuality",
    "PhantomReason",
    "PhantomState",
    "PixelKind",
    "Placement",
    "PlacementEstimator",
    "PlaneRule",
    "PoseScope",
    "PoseTracker",
    "Reposed",
    "Segmentation",
    "ShoeCoverTracker",
    "Side",
    "Skinning",
    "Texturing",
    "animate",
    "animation_mesh",
    "body_mirror",
    "clothing_colors",
    "joint_layouts",
    "lift_landmarks",
    "repose",
    "segment_body",
    "skeleton_from",
    "skeletons_from_motion",
]
