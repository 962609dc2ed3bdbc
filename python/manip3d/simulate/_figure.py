"""The skeleton of a simulated person: bone lengths, frames that rotate at the joints, poses.

The person's own frame has x to the person's left, y up and z ahead, metres, and its origin at the
base of the spine. Posed bones are in the frame of the camera: x right, y down, z ahead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d._util.linear import product, quaternions
from manip3d.errors import InputError
from manip3d.rgbd import MIRRORED_JOINTS, PARENTS

Array = NDArray[np.float64]

MIRROR = np.diag([-1.0, 1.0, 1.0])
"""Reflection that exchanges left and right, in the person's own frame."""

PERSON_TO_CAMERA = np.diag([1.0, -1.0, -1.0])
"""Rotation from the frame of a person who looks straight at the camera to the camera's."""

SOLE = 0.075
"""Height of the ankle above the floor, metres."""

SITTING_HEIGHT = 0.54
"""Height of the base of the spine above the floor while sitting on a chair, metres."""

_MIDDLE_AND_LEFT = {
    0: (0.0, 0.0, 0.0),
    1: (0.0, 0.31, 0.0),
    20: (0.0, 0.535, 0.0),
    2: (0.0, 0.61, 0.0),
    3: (0.0, 0.745, 0.005),
    4: (0.175, 0.495, 0.0),
    5: (0.175, 0.23, 0.0),
    6: (0.175, -0.015, 0.0),
    7: (0.175, -0.09, 0.0),
    21: (0.175, -0.165, 0.0),
    22: (0.175, -0.085, 0.05),
    12: (0.087, -0.005, 0.0),
    13: (0.087, -0.405, 0.0),
    14: (0.087, -0.80, 0.0),
    15: (0.087, -0.855, 0.125),
}
"""Joints of a standing person of 1.75 m, with the proportions of the public recordings."""


def _rest_joints() -> Array:
    joints = np.zeros((25, 3))
    for joint, position in _MIDDLE_AND_LEFT.items():
        joints[joint] = position
        joints[MIRRORED_JOINTS[joint]] = product(MIRROR, position)
    return joints


REST_JOINTS: Array = _rest_joints()

# A frame rotates the parts beyond one joint. Frames of the left side precede those of the right.
FRAMES = (
    "pelvis", "chest", "girdle", "head",
    "left-upper-arm", "left-forearm", "left-hand", "left-thigh", "left-shin", "left-foot",
    "right-upper-arm", "right-forearm", "right-hand", "right-thigh", "right-shin", "right-foot",
)  # fmt: skip
_FRAME_PARENT = (0, 0, 1, 1, 2, 4, 5, 0, 7, 8, 2, 10, 11, 0, 13, 14)
_FRAME_JOINT = (0, 1, 20, 2, 4, 5, 6, 12, 13, 14, 8, 9, 10, 16, 17, 18)
FRAME_ORIGIN: Array = REST_JOINTS[list(_FRAME_JOINT)]

_FRAME_OF_LEFT = {0: 0, 1: 0, 20: 1, 2: 1, 3: 3, 4: 2, 5: 4, 6: 5, 7: 6, 21: 6, 22: 6} | {
    12: 0, 13: 7, 14: 8, 15: 9
}  # fmt: skip


def mirrored_frame(frame: int) -> int:
    """The corresponding frame on the other side of the body."""
    if frame < 4:
        return frame
    return frame + 6 if frame < 10 else frame - 6


BONE_FRAME: NDArray[np.intp] = np.array(
    [
        _FRAME_OF_LEFT[joint]
        if joint in _FRAME_OF_LEFT
        else mirrored_frame(_FRAME_OF_LEFT[MIRRORED_JOINTS[joint]])
        for joint in range(25)
    ],
    np.intp,
)
"""The frame that moves each joint: that of the bone that ends there."""

_WITHOUT_ORIENTATION = [3, 15, 19, 21, 22, 23, 24]
"""Joints at the ends of the skeleton, for which a Kinect gives no orientation."""


@dataclass(frozen=True)
class Arm:
    """Angles of an arm, degrees; at 0 the arm hangs down with the thumb ahead.

    ``flexion`` raises the arm ahead, ``abduction`` sideways; ``twist`` rotates it inwards about its
    own axis.
    """

    flexion: float = 0.0
    abduction: float = 8.0
    twist: float = 0.0
    elbow: float = 8.0
    wrist: float = 0.0


@dataclass(frozen=True)
class Leg:
    """Angles of a leg, degrees; at 0 it is straight and vertical.

    ``turn`` rotates the leg outwards about the vertical, ``ankle`` raises the tip of the foot.
    """

    flexion: float = 0.0
    abduction: float = 2.0
    knee: float = 0.0
    ankle: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True)
class Pose:
    """Angles of a body, degrees.

    Attributes
    ----------
    turn : float
        Rotation of the whole body to the person's left; 0: towards the camera.
    lean : float
        Forward lean of the chest.
    twist : float
        Rotation of the chest relative to the pelvis, to the person's left.
    shoulder_tilt : float
        Tilt of the shoulders relative to the chest; positive: the person's left shoulder is higher.
    head_turn : float
        Rotation of the head to the person's left.
    left_arm, right_arm : Arm
        Angles of the arms.
    left_leg, right_leg : Leg
        Angles of the legs.
    sitting : bool
        Whether the base of the spine is at the height of a chair; otherwise the legs determine it.
    """

    turn: float = 0.0
    lean: float = 0.0
    twist: float = 0.0
    shoulder_tilt: float = 0.0
    head_turn: float = 0.0
    left_arm: Arm = field(default_factory=Arm)
    right_arm: Arm = field(default_factory=Arm)
    left_leg: Leg = field(default_factory=Leg)
    right_leg: Leg = field(default_factory=Leg)
    sitting: bool = False

    def mirrored(self) -> Pose:
        """The pose with left and right exchanged."""
        return replace(
            self,
            turn=-self.turn,
            twist=-self.twist,
            shoulder_tilt=-self.shoulder_tilt,
            head_turn=-self.head_turn,
            left_arm=self.right_arm,
            right_arm=self.left_arm,
            left_leg=self.right_leg,
            right_leg=self.left_leg,
        )


@dataclass(frozen=True, eq=False)
class PosedFigure:
    """Frames and joints of a pose, in the frame of the camera.

    Attributes
    ----------
    rotations : (16, 3, 3) float64
        Rotation of each frame of `FRAMES`, from rest to the camera's axes.
    origins : (16, 3) float64, metres
        Origin of each frame.
    joints : (25, 3) float64, metres
        Positions of the joints.
    orientations : (25, 4) float64
        Quaternions w, x, y, z of the bones that end at the joints, with y along the bone; 0: none.
    breath : float, metres
        Forward motion of the front of the chest by breathing.
    down : (x, y, z)
        Unit vector along the vertical.
    """

    rotations: Array
    origins: Array
    joints: Array
    orientations: Array
    breath: float = 0.0
    down: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def lateral(self) -> Array:
        """Unit vectors to the person's left, of pelvis and chest, (2, 3)."""
        return self.rotations[:2, :, 0].copy()


def pose_figure(pose: Pose, ground: tuple[float, float, float]) -> PosedFigure:
    """Compute the frames and joints of a pose.

    Parameters
    ----------
    pose : Pose
        Angles of the body.
    ground : (x, y, z), metres
        The point of the floor below the base of the spine, in the camera's frame.
    """
    local = _local_rotations(pose)
    rotations = np.empty((len(FRAMES), 3, 3))
    origins = np.empty((len(FRAMES), 3))
    rotations[0], origins[0] = product(PERSON_TO_CAMERA, local[0]), 0.0
    for frame in range(1, len(FRAMES)):
        parent = _FRAME_PARENT[frame]
        reach = FRAME_ORIGIN[frame] - FRAME_ORIGIN[parent]
        origins[frame] = origins[parent] + product(rotations[parent], reach)
        rotations[frame] = product(rotations[parent], local[frame])
    lowest = max(origins[9, 1], origins[15, 1])  # the lower ankle: y points down
    height = SITTING_HEIGHT if pose.sitting else lowest + SOLE
    origins += np.subtract(ground, (0.0, height, 0.0))
    return _figure_of(rotations, origins)


def turned_figure(
    figure: PosedFigure, rotation: Array, pivot: tuple[float, float, float]
) -> PosedFigure:
    """Rotate a figure, and its vertical, about a point."""
    origins = product(figure.origins - pivot, rotation.T) + pivot
    turned = _figure_of(product(rotation, figure.rotations), origins)
    x, y, z = product(rotation, figure.down).tolist()
    return replace(turned, breath=figure.breath, down=(x, y, z))


def _figure_of(rotations: Array, origins: Array) -> PosedFigure:
    """Compute the joints of a figure from its frames."""
    from_frame = REST_JOINTS - FRAME_ORIGIN[BONE_FRAME]
    joints = origins[BONE_FRAME] + np.einsum("jab,jb->ja", rotations[BONE_FRAME], from_frame)
    joints[0] = origins[0]
    orientations = quaternions(product(rotations[BONE_FRAME], _BONE_AXES))
    orientations[_WITHOUT_ORIENTATION] = 0.0
    return PosedFigure(rotations, origins, joints, orientations)


def _local_rotations(pose: Pose) -> Array:
    """Return the rotation of each frame relative to its parent, (16, 3, 3)."""
    left = _arm(pose.left_arm) + _leg(pose.left_leg)
    right = [
        product(product(MIRROR, r), MIRROR) for r in _arm(pose.right_arm) + _leg(pose.right_leg)
    ]
    middle = [
        about("y", pose.turn),
        product(about("y", pose.twist), about("x", pose.lean)),
        about("z", pose.shoulder_tilt),
        about("y", pose.head_turn),
    ]
    return np.array(middle + left + right)


def _arm(arm: Arm) -> list[Array]:
    shoulder = product(
        product(about("z", arm.abduction), about("x", -arm.flexion)), about("y", -arm.twist)
    )
    return [shoulder, about("x", -arm.elbow), about("x", -arm.wrist)]


def _leg(leg: Leg) -> list[Array]:
    hip = product(about("z", leg.abduction), about("x", -leg.flexion))
    if leg.turn:
        hip = product(about("y", leg.turn), hip)
    return [hip, about("x", leg.knee), about("x", -leg.ankle)]


def about(axis: str, degrees: float) -> Array:
    """Right-handed rotation about a coordinate axis."""
    angle = np.deg2rad(degrees)
    c, s = np.cos(angle), np.sin(angle)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    rotation = np.eye(3)
    rotation[j, j] = rotation[k, k] = c
    rotation[k, j], rotation[j, k] = s, -s
    return rotation


def _bone_axes() -> Array:
    """Axes of the bones at rest, (25, 3, 3): y along the bone, z as far ahead as possible."""
    along = REST_JOINTS - REST_JOINTS[list(PARENTS)]
    along[0] = (0.0, 1.0, 0.0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.cross(along, (0.0, 0.0, 1.0))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    return np.stack([aside, along, np.cross(aside, along)], axis=2)


_BONE_AXES: Array = _bone_axes()

LIMBS: Mapping[str, tuple[int, ...]] = {
    "left_arm": (4, 5, 6, 7, 21, 22),
    "right_arm": (8, 9, 10, 11, 23, 24),
    "left_leg": (12, 13, 14, 15),
    "right_leg": (16, 17, 18, 19),
}
"""Joints of each limb, the root first; the limb's bones end at the other joints."""


@checked
def opposite(limb: str) -> str:
    """Return the limb on the other side.

    Parameters
    ----------
    limb : str
        One of `LIMBS`.

    Returns
    -------
    str

    Raises
    ------
    InputError
        The name is unknown.

    Examples
    --------
    >>> from manip3d import simulate
    >>> simulate.opposite("left_arm")
    'right_arm'
    """
    if limb not in LIMBS:
        raise InputError(f"limb: expected one of {', '.join(LIMBS)}, got {limb!r}")
    side, _, kind = limb.partition("_")
    return f"{'right' if side == 'left' else 'left'}_{kind}"
