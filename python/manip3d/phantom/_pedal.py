"""Pedal: drawing the toes up and pressing them down lifts a ball over each foot to its disk."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from manip3d.phantom._state import (
    SIDES,
    Event,
    Foot,
    FootSamples,
    Game,
    GameState,
    PedalField,
    Target,
    Touch,
    is_new,
    joints,
    norm,
    point,
    seen_joints,
)
from manip3d.rgbd import JOINTS, Skeleton

_MEDIAN_S = 0.3  # seconds whose median is the angle of a foot
# Degrees per second: no ankle turns faster without a load. Trackers that take the floor or a shadow
# for the foot turn it by tens of degrees within a frame. The speed is that over the time of a frame
# of a Kinect or more. Jumps are larger than 4.5 standard deviations of the medians' noise, about
# three of that of single frames.
_FASTEST, _SHORTEST_S, _NOISES_OF_JUMP = 300.0, 0.033, 4.5
_FIRST_S = 1.0  # seconds for which a foot is watched before its movements count
_MEMORY_S = 20.0  # seconds over which the noise of a foot is averaged
# Movements of noise by 6.5 standard deviations are rare: for the simulated Kinect V2, a stroke
# in several minutes. Until a foot was watched for long, its noise is taken between the measured one
# and that of this tracker, 3 degrees, which weighs as much as 2 s.
_NOISES, _USUAL_NOISE, _USUAL_S = 6.5, 3.0, 2.0
_LARGEST = 45.0  # degrees; hardly anybody could move a foot by more again and again
_TELL_S = 4.0  # seconds after which the measured noise outweighs the usual one

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

    The angle is that between shank and foot, so that moving the whole leg does not count. It is the
    median of the last 0.3 s, without frames in which a joint is only inferred. A move is measured
    from the last turning point of the foot: no rest position has to be known, and tremor by less
    than a move does not count. Turns that are faster than an ankle count nothing, and a foot that
    the tracker sees unsteadily needs larger moves.
    """
    needed = 2 * state.game.strokes[state.difficulty - 1]
    feet, events, by_bone = [], list[Event](), dict(state.by_bone)
    for side, foot in zip(SIDES, state.feet, strict=True):
        moved = foot
        if skeleton is not None and foot.moves < needed:
            moved = _moved(foot, state, skeleton, side)
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


def _needed(foot: Foot, state: GameState) -> float:
    """Return the degrees that a move of a foot must have: those of the game, or more than noise.

    The distance from ankle to foot is that of a bone, so that its changes are noise of the tracker,
    and noise is of the same size in all directions.
    """
    noise = state.gain * _noise(foot.samples)
    return max(state.game.swings[state.difficulty - 1], _NOISES * noise)


def _noise(samples: FootSamples) -> float:
    """Return the standard deviation of the noise of a foot's angle, degrees."""
    measured = 0.0
    if samples.length > 0.0:
        measured = math.degrees(math.sqrt(samples.variance) / samples.length)
    total = samples.seconds * measured**2 + _USUAL_S * _USUAL_NOISE**2
    return math.sqrt(total / (samples.seconds + _USUAL_S))


def advise_pedal(state: GameState) -> str:
    """Return a sentence if the feet are seen too unsteadily for the game's moves, or nothing."""
    swing = state.game.swings[state.difficulty - 1]
    moves = 2 * state.game.strokes[state.difficulty - 1]
    watched = [f for f in state.feet if f.samples.seconds >= _TELL_S and f.moves < moves]
    needed = max((_needed(foot, state) for foot in watched), default=swing)
    unsteady = "The camera sees your feet unsteadily, "
    if needed > _LARGEST:
        return f"{unsteady}so that their movements cannot be counted."
    if needed > swing:
        return f"{unsteady}so that only movements of {5 * math.ceil(needed / 5)} degrees count."
    return ""


def _moved(foot: Foot, state: GameState, skeleton: Skeleton, side: str) -> Foot:
    """Return the state of a foot after another frame."""
    found = seen_joints(skeleton, *(f"{part}{side.title()}" for part in ("Knee", "Ankle", "Foot")))
    angle = ankle_angle(skeleton, side)
    if found is None or angle is None:
        return foot
    foot, level = _sampled(foot, state, angle, norm(found[2] - found[1]))
    if state.clock - foot.samples.since < _MEDIAN_S:
        return foot
    if foot.turn is None:
        return replace(foot, turn=level)
    way = level - foot.turn if foot.is_up else foot.turn - level
    if way < 0.0:
        return replace(foot, turn=level)
    needed = _needed(foot, state)
    if foot.samples.seconds < _FIRST_S or needed > min(way, _LARGEST):
        return foot
    return replace(foot, is_up=not foot.is_up, turn=level, moves=foot.moves + 1)


def _is_jump(samples: FootSamples, state: GameState, angle: float) -> bool:
    """Return whether a foot has turned faster than an ankle since a frame before."""
    earlier = [old for old in samples.recent if state.clock - old[0] >= _SHORTEST_S]
    before, then, _ = (earlier or samples.recent)[-1]
    seconds = max(state.clock - before, _SHORTEST_S)
    limit = max(_FASTEST * seconds, _NOISES_OF_JUMP * _noise(samples))
    return abs(angle - then) > state.gain * limit


def _sampled(foot: Foot, state: GameState, angle: float, length: float) -> tuple[Foot, float]:
    """Add a measurement; return the foot and the median of its last angles.

    After a gap or a jump the foot is measured anew, and what lies before is no movement.
    """
    clock, samples = state.clock, foot.samples
    since, turn = samples.since, foot.turn
    seconds = 0.0 if foot.seen is None or is_new(foot, clock) else clock - foot.seen
    recent = [old for old in samples.recent if clock - old[0] < _MEDIAN_S]
    if is_new(foot, clock) or _is_jump(samples, state, angle):
        recent, since, turn = [], clock, None
    recent.append((clock, angle, length))
    _, level, bone = (statistics.median(values) for values in zip(*recent, strict=True))
    watched = min(samples.seconds + seconds, _MEMORY_S)
    share = 1.0 if samples.length == 0.0 else min(1.0, seconds / max(watched, 1e-9))
    change = bone - samples.length
    samples = FootSamples(
        recent=tuple(recent),
        since=since,
        seconds=watched,
        length=samples.length + share * change,
        variance=(1.0 - share) * (samples.variance + share * change * change),
    )
    return replace(foot, turn=turn, seen=clock, samples=samples), level


def _ball(state: GameState, side: str, foot: Foot) -> Target:
    which = SIDES.index(side)
    x, y, z = (state.field.lefts, state.field.rights)[which][0]
    assert isinstance(state.field, PedalField)
    share = foot.moves / (2 * state.game.strokes[state.difficulty - 1])
    return Target(which, side, (x, y - share * state.field.rise, z))
