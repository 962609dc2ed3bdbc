"""Hands and feet, which burst bubbles: where they are, and where they rest."""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from manip3d.phantom._setup import STILL_M
from manip3d.phantom._state import SIDES, bones_of
from manip3d.rgbd import JOINTS, NOT_TRACKED, PARENTS, Skeleton

_REST_S = 1.0  # seconds whose median is the position of rest
_PARTS = 3  # parts of this second whose medians are compared
# Largest movement between them as a multiple of that between two frames. In 99 of 100 seconds,
# white noise stays below 1 and the slower noise of a Kinect V2 below 2.4. Steady motion at 30 Hz
# reaches 20.
_NOISES = 3.0
_SAMPLES = 5  # points of a bone, which are up to 4 cm apart

_CHAINS = {
    limbs: tuple(tuple(JOINTS.index(f"{part}{side.title()}") for part in parts) for side in SIDES)
    for limbs, parts in (
        ("arms", ("Elbow", "Wrist", "Hand")),
        ("legs", ("Knee", "Ankle", "Foot")),
    )
}


def ends_of(skeleton: Skeleton, limbs: Literal["arms", "legs"]) -> Skeleton:
    """Return the skeleton with the joints of hands or feet only.

    Trackers with the joints of COCO see neither hands nor feet: the third of the forearm or shank
    next to the wrist or ankle touches in their place.
    """
    kept = [*bones_of(limbs, "left"), *bones_of(limbs, "right")]
    states = np.full(25, NOT_TRACKED, np.uint8)
    states[kept] = skeleton.states[kept]
    positions = skeleton.positions.copy()
    for inner, last, end in _CHAINS[limbs]:
        if states[last] != NOT_TRACKED and skeleton.states[end] == NOT_TRACKED:
            states[inner] = skeleton.states[inner]
            positions[inner] = (positions[inner] + 2.0 * positions[last]) / 3.0
    return Skeleton(positions, skeleton.orientations, states, skeleton.id, skeleton.body)


def points_of_ends(skeleton: Skeleton, limbs: Literal["arms", "legs"]) -> NDArray[np.float64]:
    """Return points, (N, 3), along the bones of hands or feet; metres."""
    ends = ends_of(skeleton, limbs)
    is_seen = ends.states != NOT_TRACKED
    bones = [bone for bone in range(25) if is_seen[bone] and is_seen[PARENTS[bone]]]
    last = ends.positions[bones].astype(np.float64)
    first = ends.positions[[PARENTS[bone] for bone in bones]].astype(np.float64)
    shares = np.linspace(0.0, 1.0, _SAMPLES)[:, None, None]
    return (first + shares * (last - first)).reshape(-1, 3)


def _is_moving(places: NDArray[np.float32]) -> bool:
    """Return whether a joint moved in the frames of a second, (N, 3), beyond a tracker's noise.

    Noise changes the places from frame to frame, movements those of longer times. A swing that
    turns in the middle of the second has two equal halves; thirds differ.
    """
    if len(places) < _PARTS:
        return False
    parts = np.array([np.median(part, axis=0) for part in np.array_split(places, _PARTS)])
    moved = np.linalg.norm(parts - np.roll(parts, 1, axis=0), axis=1).max()
    noise = np.median(np.linalg.norm(np.diff(places, axis=0), axis=1))
    return bool(moved > max(STILL_M, _NOISES * noise))


class Rest:
    """The player in the last second, whose median a tracker's noise does not move."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, Skeleton]] = deque()  # time, nanoseconds, and skeleton

    def add(self, skeleton: Skeleton, now: int) -> None:
        """Add a frame; ``now``: its time, nanoseconds."""
        self._seen.append((now, skeleton))
        while now - self._seen[0][0] > _REST_S * 1e9:
            self._seen.popleft()

    def forget(self) -> None:
        """Forget all frames, because their places or times are not those of the next one."""
        self._seen.clear()

    def skeleton(self, limbs: Literal["arms", "legs"]) -> Skeleton | None:
        """Return the player with each joint at its median; None: hands or feet were moving."""
        last = self._seen[-1][1]
        positions, states = last.positions.copy(), last.states.copy()
        ends = [*bones_of(limbs, "left"), *bones_of(limbs, "right")]
        for joint in range(25):
            tracked = [one for _, one in self._seen if one.states[joint] != NOT_TRACKED]
            if not tracked:
                continue
            places = np.array([one.positions[joint] for one in tracked])
            positions[joint] = np.median(places, axis=0)
            states[joint] = max(one.states[joint] for one in tracked)
            if joint in ends and _is_moving(places):
                return None
        return Skeleton(positions, last.orientations, states, last.id, last.body)
