"""Pedal: drawing the toes up and pressing them down lifts a ball over each foot to its disk."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from manip3d.phantom._state import (
    SIDES,
    Event,
    Foot,
    Game,
    GameState,
    PedalField,
    Target,
    Touch,
    joints,
    norm,
    point,
)
from manip3d.rgbd import JOINTS, Skeleton

_BESIDE_M = 0.22  # distance of a ball from its foot, outwards
_RISE_SHANKS = 1.6  # height that a ball rises


def pedal_field(skeleton: Skeleton, game: Game, difficulty: int) -> PedalField | None:
    """Lay out the balls beside the feet, with disks above the knees, where they can be seen."""
    feet = joints(skeleton, "FootLeft", "FootRight")
    knees = joints(skeleton, "KneeLeft", "KneeRight")
    ankles = joints(skeleton, "AnkleLeft", "AnkleRight")
    if feet is None or knees is None or ankles is None:
        return None
    across = feet[0] - feet[1]
    shank = max(norm(ankle - knee) for ankle, knee in zip(ankles, knees, strict=True))
    if norm(across) < 1e-6 or shank < 1e-6:
        return None
    out = _BESIDE_M * across / norm(across)
    left, right = point(feet[0] + out), point(feet[1] - out)
    return PedalField((left,), (right,), _RISE_SHANKS * shank)


def play_pedal(
    state: GameState, seconds: float, touch: Touch, skeleton: Skeleton | None
) -> GameState:
    """Lift a ball by half a stroke for each sufficiently large move of its foot.

    The angle is that between shank and foot, so that moving the whole leg does not count. A move
    is measured from the last turning point of the foot: no rest position has to be known, and
    tremor by less than a move does not count.
    """
    needed = 2 * state.game.strokes[state.difficulty - 1]
    feet, events, by_bone = [], list[Event](), dict(state.by_bone)
    for side, foot in zip(SIDES, state.feet, strict=True):
        angle = None if skeleton is None or foot.moves >= needed else ankle_angle(skeleton, side)
        moved = (
            foot if angle is None else _moved(foot, angle, state.game.swings[state.difficulty - 1])
        )
        feet.append(moved)
        if moved.moves == foot.moves or moved.moves % 2:
            continue
        bone = JOINTS.index(f"Foot{side.title()}")
        by_bone[bone] = by_bone.get(bone, 0) + 1
        ball = _ball(state, side, moved)
        events.append(Event("stroke", ball.number, side, ball.place, bone))
        if moved.moves == needed:
            events.append(Event("arrived", ball.number, side, ball.place, bone))
    after = replace(
        state,
        feet=(feet[0], feet[1]),
        targets=tuple(_ball(state, side, foot) for side, foot in zip(SIDES, feet, strict=True)),
        events=tuple(events),
        by_bone=by_bone,
        score=state.score + sum(event.kind == "stroke" for event in events),
    )
    if all(foot.moves >= needed for foot in feet):
        return replace(after, phase="over", ending="done")
    return after


def ankle_angle(skeleton: Skeleton, side: str) -> float | None:
    """Return the degrees between shank and foot, smaller with the toes up; None: not tracked."""
    found = joints(skeleton, *(f"{part}{side.title()}" for part in ("Knee", "Ankle", "Foot")))
    if found is None:
        return None
    knee, ankle, toes = found
    shank, foot = _unit(knee - ankle), _unit(toes - ankle)
    if shank is None or foot is None:
        return None
    return math.degrees(math.acos(max(-1.0, min(1.0, float(shank @ foot)))))


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64] | None:
    size = norm(vector)
    return vector / size if size > 1e-6 else None


def _moved(foot: Foot, angle: float, swing: float) -> Foot:
    """Return the state of a foot after its angle was measured."""
    if foot.turn is None:
        return replace(foot, turn=angle)
    way = angle - foot.turn if foot.is_up else foot.turn - angle
    if way >= swing:
        return Foot(not foot.is_up, angle, foot.moves + 1)
    return replace(foot, turn=angle) if way < 0.0 else foot


def _ball(state: GameState, side: str, foot: Foot) -> Target:
    which = SIDES.index(side)
    x, y, z = (state.field.lefts, state.field.rights)[which][0]
    assert isinstance(state.field, PedalField)
    share = foot.moves / (2 * state.game.strokes[state.difficulty - 1])
    return Target(which, side, (x, y - share * state.field.rise, z))
