"""Bubble Burst: bubbles rise in pairs, left and right, and are burst by hands or feet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from manip3d._util.linear import product
from manip3d.phantom._ends import points_of_ends
from manip3d.phantom._state import (
    END_SHARE,
    SIDES,
    ArmField,
    Event,
    Game,
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
_WITH_END = 1.2  # length to the end of the hand or foot as a share of that to wrist or ankle
# Radius of a bubble as a share of arm or shank: arms from 0.5 m and shanks from 0.39 m on burst
# bubbles of the full size.
_RADII = {"arms": 0.18, "legs": 0.23}
# Metres between bubbles and hands or feet at rest: about seven standard deviations of the noise of
# a Kinect V2.
_MARGIN_M = 0.04


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


@dataclass(frozen=True)
class _Layout:
    """Body and directions of a field: the lines lie outwards of the shoulders, or before the knees.

    Attributes
    ----------
    roots : (2, 3)
        Left and right shoulder or knee.
    ways : (2, 3)
        Level unit vectors from the left and from the right root towards the lines.
    limb : float, metres
        Length of the longer arm or shank.
    bottom : float, metres
        The y coordinate of the generators.
    rise : float, metres
        Height of the ceiling above the generators.
    """

    roots: NDArray[np.float64]
    ways: NDArray[np.float64]
    limb: float
    bottom: float
    rise: float


def bubble_field(
    skeleton: Skeleton, game: Game, difficulty: int, rest: Skeleton | None, *, at_any_rest: bool
) -> ArmField | None:
    """Lay out the lines of the bubbles, out of the way of hands or feet that rest.

    If lines beyond the resting hands or feet are out of reach, they lie as far away as the limb
    reaches and begin above them if ``at_any_rest``. Otherwise there is no field (None), as if a
    joint is not tracked.
    """
    layout = (_arm_layout if game.limbs == "arms" else _leg_layout)(skeleton)
    if layout is None or not layout.limb > 1e-6:
        return None
    radius = min(game.radius, _RADII[game.limbs] * layout.limb)
    clearance = radius + END_SHARE * radius + _MARGIN_M
    at_rest = np.empty((0, 3)) if rest is None else points_of_ends(rest, game.limbs)
    taken = _taken(layout, at_rest, clearance)
    distances = [_free(share * layout.limb, taken) for share in game.reaches[difficulty - 1]]
    reach = _WITH_END * layout.limb
    if max(distances) > reach:
        if not at_any_rest:
            return None
        distances = [min(distance, reach) for distance in distances]
        layout = _raised(layout, distances, at_rest, clearance)
    starts = layout.roots.copy()
    starts[:, 1] = layout.bottom
    lefts, rights = (
        tuple(point(start + distance * way) for distance in distances)
        for start, way in zip(starts, layout.ways, strict=True)
    )
    roots = point(layout.roots[0]), point(layout.roots[1])
    kind = ArmField if game.limbs == "arms" else LegField
    return kind(lefts, rights, layout.rise, roots, reach, radius)


def _taken(
    layout: _Layout, at_rest: NDArray[np.float64], clearance: float
) -> list[tuple[float, float]]:
    """Return, in order, the intervals of distances from the roots at which lines would be touched.

    They are those of both sides, because the lines of a pair are equally far from their roots.
    """
    middle = layout.bottom - 0.5 * layout.rise
    beyond = np.maximum(abs(at_rest[:, 1] - middle) - 0.5 * layout.rise, 0.0)  # the line's ends
    found = list[tuple[float, float]]()
    for root, way in zip(layout.roots, layout.ways, strict=True):
        off = (at_rest - root) * (1.0, 0.0, 1.0)
        along = product(off, way)
        aside2 = (off * off).sum(axis=1) - along * along
        half2 = clearance * clearance - beyond * beyond - aside2
        touched = half2 > 0.0
        half = np.sqrt(half2[touched])
        lows, highs = along[touched] - half, along[touched] + half
        found += zip(lows.tolist(), highs.tolist(), strict=True)
    return sorted(found)


def _free(distance: float, taken: list[tuple[float, float]]) -> float:
    """Return the smallest distance from a given one on that lies in no interval."""
    for low, high in taken:
        if low < distance < high:
            distance = high
    return distance


def _raised(
    layout: _Layout, distances: list[float], at_rest: NDArray[np.float64], clearance: float
) -> _Layout:
    """Return the layout with lines that begin above the resting hands or feet.

    The ceiling stays, but the lines keep half of their height at least.
    """
    bottom = layout.bottom
    for root, way in zip(layout.roots, layout.ways, strict=True):
        for distance in distances:
            off = (at_rest - root - distance * way) * (1.0, 0.0, 1.0)
            half2 = clearance * clearance - (off * off).sum(axis=1)
            tops = at_rest[half2 > 0.0, 1] - np.sqrt(half2[half2 > 0.0])
            bottom = min([bottom, *tops.tolist()])
    rise = max(layout.rise - (layout.bottom - bottom), 0.5 * layout.rise)
    return replace(layout, bottom=bottom, rise=rise)


def _arm_layout(skeleton: Skeleton) -> _Layout | None:
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
    longest, bottom = max(arms), float(base[0][1])
    top = min(float(shoulder[1]) for shoulder in shoulders) - 0.6 * longest
    return _Layout(
        roots=np.stack(shoulders),
        ways=np.stack([lateral, -lateral]),
        limb=longest,
        bottom=bottom,
        rise=max(bottom - top, 0.1),
    )


def _leg_layout(skeleton: Skeleton) -> _Layout | None:
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
    bottom = max(float(ankle[1]) for ankle in ankles)
    top = min(float(knee[1]) for knee in knees)
    return _Layout(
        roots=np.stack(knees),
        ways=np.stack([ahead, ahead]),
        limb=max(norm(ankle - knee) for ankle, knee in zip(ankles, knees, strict=True)),
        bottom=bottom,
        rise=max(bottom - top, 0.1),
    )
