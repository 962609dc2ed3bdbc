"""Bubble Burst: bubbles rise in pairs, left and right, and are burst by hands or feet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manip3d.phantom._state import (
    SIDES,
    ArmField,
    Event,
    GameState,
    LegField,
    Point,
    Target,
    Touch,
    joints,
    length,
    level,
    norm,
    point,
)
from manip3d.rgbd import Skeleton

_UP = np.array([0.0, -1.0, 0.0])
_WITH_END = 1.2  # metres from the wrist or ankle to the end of the hand or foot


def play_bubbles(
    state: GameState, seconds: float, touch: Touch, skeleton: Skeleton | None
) -> GameState:
    """Return the state after the bubbles moved for `seconds`, which the clock already includes."""
    return _spawned(_touched(state, seconds * state.speed, touch))


def can_reach_bubble(state: GameState) -> bool:
    """Return whether a bubble is within the limb's length of the shoulder or knee of its side."""
    field = state.field
    assert isinstance(field, ArmField)
    reach = field.reach + state.radius
    return any(
        norm(np.subtract(target.place, field.roots[SIDES.index(target.side)])) <= reach
        for target in state.targets
    )


def _touched(state: GameState, way: float, touch: Touch) -> GameState:
    """Move the targets, and remove those that were touched or have reached the ceiling."""
    targets = state.targets
    before = np.array([t.place for t in targets], np.float32).reshape(-1, 3)
    after = before + np.float32(way) * _UP.astype(np.float32)
    bones = touch(before, after, np.full(len(targets), state.radius, np.float32))
    assert isinstance(state.field, ArmField)
    ceiling = state.field.lefts[0][1] - state.field.rise
    left, events, by_bone = [], [], dict(state.by_bone)
    for target, place, bone in zip(targets, after.tolist(), bones.tolist(), strict=True):
        here: Point = (target.place[0], target.place[1] - way, target.place[2])
        if bone >= 0:
            events.append(Event("burst", target.number, target.side, here, bone))
            by_bone[bone] = by_bone.get(bone, 0) + 1
        elif place[1] <= ceiling:
            here = (here[0], ceiling, here[2])
            events.append(Event("missed", target.number, target.side, here))
        else:
            left.append(replace(target, place=here))
    missed = tuple(event.place for event in events if event.kind == "missed")
    return replace(
        state,
        targets=tuple(left),
        events=tuple(events),
        by_bone=by_bone,
        score=state.score + len(events) - len(missed),
        misses=state.misses + len(missed),
        stains=state.stains + missed,
    )


def _spawned(state: GameState) -> GameState:
    """Add the pairs that are due: the n-th after n intervals, at a place drawn by the seed."""
    interval = state.game.intervals[state.difficulty - 1]
    targets, spawned = list(state.targets), state.spawned
    while spawned * interval <= state.clock:
        pair = int(np.random.default_rng([state.seed, spawned]).integers(len(state.field.lefts)))
        for which, generators in enumerate((state.field.lefts, state.field.rights)):
            targets.append(Target(2 * spawned + which, SIDES[which], generators[pair]))
        spawned += 1
    return replace(state, targets=tuple(targets), spawned=spawned)


def arm_field(skeleton: Skeleton, reaches: tuple[float, ...]) -> ArmField | None:
    """Lay out the field for arms, to both sides of the shoulders, from the hips upwards."""
    shoulders = joints(skeleton, "ShoulderLeft", "ShoulderRight")
    base = joints(skeleton, "SpineBase")
    arms = [
        length(arm)
        for side in ("Left", "Right")
        if (arm := joints(skeleton, *(f"{part}{side}" for part in ("Shoulder", "Elbow", "Wrist"))))
    ]
    if shoulders is None or base is None or not arms:
        return None
    lateral = level(shoulders[0] - shoulders[1])
    if lateral is None:
        return None
    longest = max(arms)
    bottom = float(base[0][1])
    sides = []
    for shoulder, sign in zip(shoulders, (1.0, -1.0), strict=True):
        start = np.array([shoulder[0], bottom, shoulder[2]])
        sides.append(tuple(point(start + sign * r * longest * lateral) for r in reaches))
    top = min(float(s[1]) for s in shoulders) - 0.6 * longest
    roots = point(shoulders[0]), point(shoulders[1])
    return ArmField(sides[0], sides[1], max(bottom - top, 0.1), roots, _WITH_END * longest)


def leg_field(skeleton: Skeleton, reaches: tuple[float, ...]) -> ArmField | None:
    """Lay out the field for legs: before the knees, in the direction in which the hips face."""
    hips = joints(skeleton, "HipLeft", "HipRight")
    knees = joints(skeleton, "KneeLeft", "KneeRight")
    ankles = joints(skeleton, "AnkleLeft", "AnkleRight")
    if hips is None or knees is None or ankles is None:
        return None
    lateral = level(hips[0] - hips[1])
    if lateral is None:
        return None
    ahead = np.array([lateral[2], 0.0, -lateral[0]])  # -z for a person who faces the camera
    shank = max(norm(ankle - knee) for ankle, knee in zip(ankles, knees, strict=True))
    bottom = max(float(ankle[1]) for ankle in ankles)
    sides = []
    for knee in knees:
        start = np.array([knee[0], bottom, knee[2]])
        sides.append(tuple(point(start + r * shank * ahead) for r in reaches))
    top = min(float(knee[1]) for knee in knees)
    roots = point(knees[0]), point(knees[1])
    return LegField(sides[0], sides[1], max(bottom - top, 0.1), roots, _WITH_END * shank)
