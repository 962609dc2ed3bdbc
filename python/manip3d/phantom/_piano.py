"""Piano: keys pop up on the floor, one at a time, and are hit by stomping."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from manip3d.phantom._state import (
    SIDES,
    Event,
    Foot,
    Game,
    GameState,
    PianoField,
    Point,
    Target,
    Touch,
    is_new,
    joints,
    level,
    norm,
    point,
    seen_joints,
)
from manip3d.rgbd import JOINTS, Skeleton

_KEY = 0.28  # radius of a key as a share of the shank; keys are 0.4 apart
_DOWN_M = 0.04  # metres above the floor up to which a foot counts as down
_LEVEL_M = 0.01  # metres; keys do not follow smaller changes of the floor
_REST_S = 0.6  # seconds between one key and the next


def piano_field(
    skeleton: Skeleton, game: Game, difficulty: int, floor: float | None
) -> PianoField | None:
    """Lay out the keys from each foot outwards, at multiples of the shank's length."""
    feet = joints(skeleton, "FootLeft", "FootRight")
    hips = joints(skeleton, "HipLeft", "HipRight")
    knees = joints(skeleton, "KneeLeft", "KneeRight")
    ankles = joints(skeleton, "AnkleLeft", "AnkleRight")
    if feet is None or hips is None or knees is None or ankles is None:
        return None
    lateral = level(hips[0] - hips[1])
    if lateral is None:
        return None
    shank = max(norm(ankle - knee) for ankle, knee in zip(ankles, knees, strict=True))
    ground = max(float(foot[1]) for foot in feet) if floor is None else float(floor)
    sides = []
    for foot, sign in zip(feet, (1.0, -1.0), strict=True):
        keys = [foot + sign * share * shank * lateral for share in game.reaches[difficulty - 1]]
        sides.append(tuple((float(key[0]), ground, float(key[2])) for key in keys))
    return PianoField(sides[0], sides[1], ground, min(game.radius, _KEY * shank))


def on_floor(state: GameState, floor: float | None) -> GameState:
    """Return the game with its keys on the floor, which may have been unknown when it began."""
    field = state.field
    assert isinstance(field, PianoField)
    if floor is None or abs(floor - field.floor) < _LEVEL_M:
        return state

    def moved(place: Point) -> Point:
        return place[0], floor, place[2]

    lefts, rights = (tuple(map(moved, places)) for places in (field.lefts, field.rights))
    targets = tuple(replace(target, place=moved(target.place)) for target in state.targets)
    return replace(
        state, field=replace(field, lefts=lefts, rights=rights, floor=floor), targets=targets
    )


def play_piano(
    state: GameState, seconds: float, touch: Touch, skeleton: Skeleton | None
) -> GameState:
    """Play the active key if a foot that was lifted comes down on it."""
    state = _popped(state, seconds)
    feet, stomps = _stepped(state, skeleton)
    events, by_bone, targets = list[Event](), dict(state.by_bone), list(state.targets)
    for side, place in stomps:
        for target in targets:
            off = math.hypot(place[0] - target.place[0], place[2] - target.place[2])
            if off > state.radius:
                continue
            bone = JOINTS.index(f"Foot{side.title()}")
            by_bone[bone] = by_bone.get(bone, 0) + 1
            events.append(Event("note", target.number, target.side, target.place, bone, target.key))
        targets = [t for t in targets if all(t.number != event.number for event in events)]
    notes = len(events)
    kept = [target for target in targets if target.age < _life(state)]
    for target in targets:
        if target not in kept:
            events.append(Event("missed", target.number, target.side, target.place, key=target.key))
    return replace(
        state,
        feet=feet,
        targets=tuple(kept),
        wait=_REST_S if events else state.wait,
        events=tuple(events),
        by_bone=by_bone,
        score=state.score + notes,
        misses=state.misses + len(events) - notes,
    )


def keys_of(field: PianoField) -> list[tuple[str, Point]]:
    """Return the keys with their sides, from the player's left to their right."""
    lefts = [("left", place) for place in reversed(field.lefts)]
    return lefts + [("right", place) for place in field.rights]


def _life(state: GameState) -> float:
    return state.game.intervals[state.difficulty - 1]


def _popped(state: GameState, seconds: float) -> GameState:
    """Age the active key; if there is none and the pause is over, draw the next one by the seed."""
    assert isinstance(state.field, PianoField)
    if state.targets:
        older = tuple(replace(target, age=target.age + seconds) for target in state.targets)
        return replace(state, targets=older)
    wait = state.wait - seconds
    if wait > 0.0:
        return replace(state, wait=wait)
    keys = keys_of(state.field)
    number = int(np.random.default_rng([state.seed, state.spawned]).integers(len(keys)))
    side, place = keys[number]
    key = Target(state.spawned, side, place, key=number)
    return replace(state, targets=(key,), spawned=state.spawned + 1, wait=0.0)


def _stepped(
    state: GameState, skeleton: Skeleton | None
) -> tuple[tuple[Foot, Foot], list[tuple[str, Point]]]:
    """Return the new state of the feet, and the place where one came down, if any.

    A foot that is only inferred does not move, because trackers guess its place. One that was not
    seen for a while is up or down as it is now: it may have come down anywhere.
    """
    assert isinstance(state.field, PianoField)
    feet, stomps = [], list[tuple[str, Point]]()
    for side, foot in zip(SIDES, state.feet, strict=True):
        found = None if skeleton is None else seen_joints(skeleton, f"Foot{side.title()}")
        if found is None:
            feet.append(foot)
            continue
        height = state.field.floor - float(found[0][1])
        is_lifted = height >= state.game.swings[state.difficulty - 1]
        if is_new(foot, state.clock):
            foot = replace(foot, is_up=is_lifted)
        elif not foot.is_up and is_lifted:
            foot = replace(foot, is_up=True, moves=foot.moves + 1)
        elif foot.is_up and height <= _DOWN_M:
            foot = replace(foot, is_up=False, moves=foot.moves + 1)
            stomps.append((side, point(found[0])))
        feet.append(replace(foot, seen=state.clock))
    return (feet[0], feet[1]), stomps
