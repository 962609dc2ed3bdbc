"""Checks before a session: the camera's view of the patient, and the patient's measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d.phantom._state import joints, level
from manip3d.rgbd import JOINTS, NOT_TRACKED, Skeleton

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics
    from manip3d.modify import PhantomFrame

NEAREST_M, FARTHEST_M = 1.4, 3.6
"""Distances of the patient from the camera along the floor, metres."""

MAX_TURN = 25.0
"""Largest turn of the shoulders away from the camera, degrees. Beyond it, too much of the mirrored
surface faces away from the camera."""
MIN_VISIBLE = 0.9
"""Least visible share of the intact limb, by length: what is hidden of it has no mirror image. The
pipeline mirrors a limb from half on."""

MIN_RATE = 20.0
"""Least number of frames per second: two thirds of a Kinect's 30."""

MARGIN = 0.01
"""Width of the image's border, as a share of its sides, in which joints count as outside."""

STILL_S = 2.0
"""Time for which the patient holds still for a calibration, seconds; the page says so, too. Frames
that lie farther apart begin it anew."""

STILL_M = 0.03
"""Largest median movement of joints that are held still, metres; above a tracker's noise."""

_STILL_LIMB_M = 3 * STILL_M
"""Largest ninth decile of these movements. An arm, six of 25 joints, hardly moves the median. The
ninth decile of noise alone is 1.6 times its median (Maxwell's distribution)."""

_PARTS = (
    ("head", ("Head",)),
    ("hands", ("HandLeft", "HandRight")),
    ("feet", ("AnkleLeft", "AnkleRight")),
)
_TRUNK = ("SpineBase", "SpineMid", "SpineShoulder", "ShoulderLeft", "ShoulderRight",
          "HipLeft", "HipRight")  # fmt: skip


@dataclass(frozen=True)
class Check:
    """A condition that must be met before a session.

    Attributes
    ----------
    name : str
        The condition in two or three words.
    is_met : bool
        Whether it is met.
    advice : str
        Instruction if it is not met; otherwise empty.
    """

    name: str
    is_met: bool
    advice: str = ""


def placement_checks(
    shown: PhantomFrame,
    body: Skeleton,
    camera: Intrinsics,
    *,
    people: int,
    is_chosen: bool,
    rate: float,
) -> list[Check]:
    """Check the camera's view of the patient.

    ``body``: the skeleton of ``shown`` in the level axes of the session (`Level`); ``people``:
    number of skeletons in view; ``is_chosen``: whether the therapist has chosen the patient among
    them; ``rate``: frames per second, or 0 if unknown.
    """
    found = joints(body, "SpineBase")
    if found is None:
        return [Check("Somebody in view", False, "Stand before the camera.")]
    distance = float(found[0][2])
    checks = [
        Check("Somebody in view", True),
        _distance(distance),
        _inside(shown.skeleton, camera),
        _facing(body),
        Check(
            "Intact limb seen",
            shown.visible >= MIN_VISIBLE,
            "" if shown.visible >= MIN_VISIBLE else "Nothing may be before the intact limb.",
        ),
    ]
    if people > 1:
        advice = "" if is_chosen else "Say below who the patient is, or ask the others to step out."
        checks.append(Check("One patient", is_chosen, advice))
    if rate > 0.0:
        is_met = rate >= MIN_RATE
        advice = "" if is_met else f"Only {rate:.0f} pictures a second: close other programs."
        checks.append(Check("Pictures in time", is_met, advice))
    return checks


def _distance(metres: float) -> Check:
    advice = ""
    if metres < NEAREST_M:
        advice = f"Step back: {metres:.1f} m now, {NEAREST_M} m at least."
    elif metres > FARTHEST_M:
        advice = f"Come nearer: {metres:.1f} m now, {FARTHEST_M} m at most."
    return Check("Distance", not advice, advice)


def _inside(skeleton: Skeleton, camera: Intrinsics) -> Check:
    outside = []
    for part, names in _PARTS:
        numbers = [JOINTS.index(name) for name in names]
        known = [n for n in numbers if skeleton.states[n] != NOT_TRACKED]
        pixels = camera.project(skeleton.positions[known].astype(np.float64))
        u, v = pixels.T if len(known) else (np.empty(0), np.empty(0))
        wide, high = MARGIN * camera.width, MARGIN * camera.height
        is_in = (u >= wide) & (u < camera.width - wide) & (v >= high) & (v < camera.height - high)
        if not is_in.all() or not known:
            outside.append(part)
    if not outside:
        return Check("Whole body in the picture", True)
    told = " and ".join(outside)
    return Check("Whole body in the picture", False, f"Not in the picture: {told}.")


def _facing(skeleton: Skeleton) -> Check:
    name = "Facing the camera"
    found = joints(skeleton, "ShoulderLeft", "ShoulderRight")
    across = None if found is None else level(found[1] - found[0])
    if across is None:
        return Check(name, False, "Turn both shoulders to the camera.")
    # The right shoulder of a person who faces the camera has a smaller x than the left one.
    turn = math.degrees(math.acos(min(1.0, max(-1.0, -float(across[0])))))
    if turn <= MAX_TURN:
        return Check(name, True)
    return Check(name, False, f"Turn to the camera: {turn:.0f} degrees away now.")


class PlacementCalibration:
    """Measures the patient's body while they stand or sit still for two seconds."""

    def __init__(self) -> None:
        self._frames: list[NDArray[np.float64]] = []
        self._states: list[NDArray[np.uint8]] = []
        self._first_ns = self._last_ns = 0

    @property
    def share(self) -> float:
        """Share of the two seconds that is over."""
        return min(1.0, (self._last_ns - self._first_ns) / (STILL_S * 1e9))

    def add(self, skeleton: Skeleton, time_ns: int) -> Skeleton | None:
        """Add a frame; return the measured body once the patient has held still for long enough.

        If the patient moves, is not seen for two seconds, or the camera's clock goes back, the
        measurement starts again.
        """
        if joints(skeleton, *_TRUNK) is None:
            self._forget(time_ns)
            return None
        now = skeleton.positions.astype(np.float64)
        known = skeleton.states != NOT_TRACKED
        if self._frames:
            both = known & (self._states[0] != NOT_TRACKED)
            moved = np.linalg.norm(now - np.median(self._frames, axis=0), axis=1)[both]
            has_moved = np.median(moved) > STILL_M or float(np.quantile(moved, 0.9)) > _STILL_LIMB_M
            if has_moved or not 0 <= time_ns - self._last_ns < STILL_S * 1e9:
                self._forget(time_ns)
        if not self._frames:
            self._first_ns = time_ns
        self._last_ns = time_ns
        self._frames.append(now)
        self._states.append(skeleton.states.copy())
        if self.share < 1.0:
            return None
        places = np.median(self._frames, axis=0).astype(np.float32)
        states = np.min(self._states, axis=0).astype(np.uint8)
        return Skeleton(places, skeleton.orientations, states, skeleton.id, skeleton.body)

    def _forget(self, time_ns: int) -> None:
        self._frames, self._states = [], []
        self._first_ns = self._last_ns = time_ns


def moved_to(body: Skeleton, skeleton: Skeleton) -> Skeleton:
    """Return the measured body, moved to the current position of the base of the spine."""
    here, there = joints(skeleton, "SpineBase"), joints(body, "SpineBase")
    if here is None or there is None:
        return body
    shift = (here[0] - there[0]).astype(np.float32)
    return Skeleton(
        body.positions + shift, body.orientations, body.states, skeleton.id, skeleton.body
    )
