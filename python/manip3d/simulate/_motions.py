"""Exercises as functions of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from manip3d.simulate._figure import Arm, Leg, Pose

PERIOD = 4.0
"""Period of an exercise, seconds."""

_STANDING = Leg()
_SEATED = Leg(flexion=80.0, abduction=6.0, knee=80.0)
_SEATED_ARM = Arm(flexion=12.0, abduction=10.0, elbow=50.0, twist=20.0)


@dataclass(frozen=True)
class Exercise:
    """Motions of arms and legs; a limb without a motion rests.

    Attributes
    ----------
    arm : callable, optional
        Function of the time (seconds) and the arm at rest that returns the moved arm.
    leg : callable, optional
        Function of the time, the leg at rest and whether it is the left one that returns the moved
        leg.
    """

    arm: Callable[[float, Arm], Arm] | None = None
    leg: Callable[[float, Leg, bool], Leg] | None = None


def pose_at(
    exercise: str,
    time: float,
    *,
    moving: tuple[bool, bool] = (True, True),
    sitting: bool = False,
    turn: float = 0.0,
    twist: float = 0.0,
    shoulder_tilt: float = 0.0,
    thigh_turn: float = 0.0,
) -> Pose:
    """Return the pose of an exercise at a time.

    Parameters
    ----------
    exercise : str
        Name in `MOTIONS`.
    time : float, seconds
        Time since the start of the exercise.
    moving : (bool, bool)
        Whether the left and the right limbs move; others rest.
    sitting : bool
        Whether the person sits.
    turn, twist, shoulder_tilt : float, degrees
        Same as in `Pose`.
    thigh_turn : float, degrees
        Rotation of a sitting person's legs relative to the pelvis, to the person's left.
    """
    motion = MOTIONS[exercise]
    arm, leg = (_SEATED_ARM, _SEATED) if sitting else (Arm(), _STANDING)
    arms, legs = [arm, arm], [leg, leg]
    for side in range(2):
        if not moving[side]:
            continue
        if motion.arm is not None:
            arms[side] = motion.arm(time, arm)
        if motion.leg is not None:
            legs[side] = motion.leg(time, leg, side == 0)
    if sitting and thigh_turn:
        legs = [replace(legs[0], turn=thigh_turn), replace(legs[1], turn=-thigh_turn)]
    return Pose(
        turn=turn,
        twist=twist,
        shoulder_tilt=shoulder_tilt,
        left_arm=arms[0],
        right_arm=arms[1],
        left_leg=legs[0],
        right_leg=legs[1],
        sitting=sitting,
    )


def clear_of_trunk(pose: Pose, girth: float) -> Pose:
    """Return the pose with arms moved aside so that they clear a trunk of the given girth.

    Up to a girth of 1.2 nothing needs to change.
    """
    # metres: half width of the waist and length of an upper arm, at girth 1
    half, upper_arm = 0.23, 0.29
    wider = half * max(0.0, girth - 1.2)
    aside = float(np.degrees(np.arcsin(wider / upper_arm)))
    left, right = pose.left_arm, pose.right_arm
    return replace(
        pose,
        left_arm=replace(left, abduction=left.abduction + aside),
        right_arm=replace(right, abduction=right.abduction + aside),
    )


def _swell(time: float, period: float = PERIOD) -> float:
    """Smooth value from 0 to 1 and back within a period, with zero speed at both ends."""
    return float(0.5 - 0.5 * np.cos(2.0 * np.pi * time / period))


def _arm_raise(time: float, arm: Arm) -> Arm:
    return replace(arm, abduction=8.0 + 92.0 * _swell(time), elbow=8.0)


def _arm_curl(time: float, arm: Arm) -> Arm:
    return replace(arm, abduction=10.0, flexion=5.0, elbow=10.0 + 120.0 * _swell(time), twist=15.0)


def _reach(time: float, arm: Arm) -> Arm:
    way = _swell(time)
    return replace(arm, flexion=80.0 * way, abduction=10.0, elbow=40.0 * (1.0 - way) + 8.0)


def _wave(time: float, arm: Arm) -> Arm:
    up = min(1.0, max(0.0, time))
    swing = 25.0 * np.sin(2.0 * np.pi * time / 1.5) * up
    return Arm(
        abduction=8.0 + 72.0 * up, flexion=0.0, twist=-90.0 * up, elbow=8 + (72 + swing) * up
    )


def _elbow_bent(time: float, arm: Arm) -> Arm:
    return replace(arm, flexion=0.0, abduction=15.0, elbow=90.0, twist=0.0)


def _knee_extension(time: float, leg: Leg, left: bool) -> Leg:
    return replace(leg, knee=80.0 - 65.0 * _swell(time))


def _dorsiflexion(time: float, leg: Leg, left: bool) -> Leg:
    return replace(leg, ankle=-10.0 + 30.0 * _swell(time, PERIOD / 2.0))


def _stepping(time: float, leg: Leg, left: bool) -> Leg:
    lift = _swell(time if left else time + PERIOD / 4.0, PERIOD / 2.0)
    if leg.flexion > 45.0:
        return replace(leg, flexion=leg.flexion + 18.0 * lift)
    return replace(leg, flexion=45.0 * lift, knee=75.0 * lift, ankle=10.0 * lift)


MOTIONS: Mapping[str, Exercise] = {
    "still": Exercise(),
    "arm-raise": Exercise(arm=_arm_raise),
    "arm-curl": Exercise(arm=_arm_curl),
    "reach": Exercise(arm=_reach),
    "wave": Exercise(arm=_wave),
    "elbow-bent": Exercise(arm=_elbow_bent),
    "knee-extension": Exercise(leg=_knee_extension),
    "dorsiflexion": Exercise(leg=_dorsiflexion),
    "stepping": Exercise(leg=_stepping),
}
"""Exercises by name."""


def walk(time: float, *, turn: float) -> Pose:
    """Pose of a person who walks in the direction in which they look."""
    swing = 28.0 * float(np.sin(2.0 * np.pi * time / 1.1))
    return Pose(
        turn=turn,
        left_arm=Arm(flexion=-0.7 * swing, elbow=20.0),
        right_arm=Arm(flexion=0.7 * swing, elbow=20.0),
        left_leg=Leg(flexion=swing, knee=12.0 + max(0.0, -swing)),
        right_leg=Leg(flexion=-swing, knee=12.0 + max(0.0, swing)),
    )
