"""People in RGB-D frames: skeletons, phantom limbs, animation, and colliders for games."""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_animation": "Animated AnimationMesh PoseScope Skinning animate animation_mesh",
        "_colliders": "TORSO BodyColliders ColliderTracker Hits",
        "_joints": "JointLayout joint_layouts skeleton_from",
        "_lower_limb": "Placement PlacementEstimator ShoeCoverTracker Side",
        "_motions": "skeletons_from_motion",
        "_phantom": (
            "BodyMirror BodyPlane BodySegmentation DownSource Limb MirrorMode PhantomFrame "
            "PhantomPipeline PhantomQuality PhantomReason PhantomState PixelKind PlaneRule "
            "Segmentation Texturing body_mirror segment_body"
        ),
        "_pose": "PoseTracker lift_landmarks",
        "_repose": "POSABLE_JOINTS Reposed repose",
        "_smoothing": "JointSmoother KeyPerson clothing_colors",
    },
)
