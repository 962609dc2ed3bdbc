"""The phantom limb as the patient feels it, often shorter than the intact limb or telescoped."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manip3d.errors import InputError
from manip3d.phantom._state import joints
from manip3d.rgbd import Skeleton

LIMITS = {"length": (20, 150), "telescoping": (0, 100), "raised": (-30, 180), "bent": (0, 150)}
"""Smallest and largest value of each field of `FeltLimb`."""

_ARM, _LEG = ("Shoulder", "Elbow", "Wrist"), ("Hip", "Knee", "Ankle")


@dataclass(frozen=True)
class FeltLimb:
    """Description of the limb that the patient feels.

    Attributes
    ----------
    length : int, per cent
        Felt length in per cent of the intact limb's.
    telescoping : int, per cent
        Share by which the hand or foot is felt to have moved towards the body: 0 at the end of the
        felt length, 100 in the shoulder or hip.
    raised : int, degrees
        Angle by which the whole limb is raised sideways from hanging down.
    bent : int, degrees
        Angle of elbow or knee; 0: straight.

    Raises
    ------
    InputError
        A number is out of `LIMITS`.
    """

    length: int = 100
    telescoping: int = 0
    raised: int = 0
    bent: int = 0

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"{name}: expected {low} to {high}, got {value}")


def felt_places(felt: FeltLimb, skeleton: Skeleton, affected: str) -> NDArray[np.float64] | None:
    """Return the felt limb's shoulder, elbow and hand, or hip, knee and foot; (3, 3), metres.

    Arms bend forwards, legs backwards. None: the trunk or the intact limb is not tracked.
    """
    side, _, limb = affected.partition("_")
    other = "Right" if side == "left" else "Left"
    names = _ARM if limb == "arm" else _LEG
    chain = joints(skeleton, *(f"{name}{other}" for name in names))
    trunk = joints(skeleton, "ShoulderLeft", "ShoulderRight", "SpineBase", "SpineShoulder")
    root = joints(skeleton, f"{names[0]}{side.title()}")
    if chain is None or trunk is None or root is None:
        return None
    left, right, base, top = trunk
    down = _unit(base - top)
    across = right - left
    across = _unit(across - down * float(across @ down))  # to the person's right
    # Ahead: down x across in a frame of x right, y down, z ahead gives the person's front.
    ahead = np.cross(across, down)
    out = across if side == "right" else -across
    angle, bend = math.radians(felt.raised), math.radians(felt.bent)
    upper = math.cos(angle) * down + math.sin(angle) * out
    fold = ahead if limb == "arm" else -ahead
    lower = math.cos(bend) * upper + math.sin(bend) * fold
    scale = felt.length / 100 * (1 - felt.telescoping / 100)
    lengths = [float(np.linalg.norm(b - a)) * scale for a, b in itertools.pairwise(chain)]
    elbow = root[0] + lengths[0] * upper
    return np.stack([root[0], elbow, elbow + lengths[1] * lower])


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
