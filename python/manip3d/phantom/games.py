"""Rules of the games: pure functions of the state, the time that passed and what was touched.

Nothing here draws, waits or asks the clock: the same seed, times and touches give the same game.
Places are in the camera's frame (x right, y down, z ahead), metres; left and right are the
player's own.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.rgbd import JOINTS, NOT_TRACKED, Skeleton

__all__ = [
    "GAMES",
    "ArmField",
    "Event",
    "Game",
    "GameState",
    "LegField",
    "Target",
    "Touch",
    "begin",
    "bones_of",
    "step",
]

Phase = Literal["playing", "over"]
Point = tuple[float, float, float]
Touch = Callable[[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]], NDArray[np.int8]]
"""From the targets' centres before and now, (N, 3), and radii, (N,), to the bone that touched each
one, (N,); -1: none."""

_SIDES = ("left", "right")
_UP = np.array([0.0, -1.0, 0.0])
_HANDS = ("Wrist", "Hand", "HandTip", "Thumb")
_FEET = ("Ankle", "Foot")


@dataclass(frozen=True)
class Game:
    """A game and its levels of difficulty, 1 to 3.

    Attributes
    ----------
    name, title, limbs : str
        ``limbs`` is ``arms`` or ``legs``: whose ends touch.
    how : str
        What the player does, in a sentence.
    speeds : tuple of float, metres per second
    intervals : tuple of float, seconds
        Between one pair of targets and the next.
    reaches : tuple of tuple of float
        Places of the pairs of generators, as shares of the limb's length.
    radius : float, metres
        Of a target.
    seconds : float
        Time limit.
    most_misses : int
        Ends the game.
    """

    name: str
    title: str
    limbs: Literal["arms", "legs"]
    how: str
    speeds: tuple[float, float, float]
    intervals: tuple[float, float, float]
    reaches: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    radius: float = 0.09
    seconds: float = 60.0
    most_misses: int = 20


GAMES: Mapping[str, Game] = {
    game.name: game
    for game in (
        Game(
            "bubbles",
            "Bubble Burst",
            "arms",
            "Burst the bubbles with both hands before they reach the ceiling.",
            speeds=(0.25, 0.4, 0.6),
            intervals=(2.5, 1.8, 1.2),
            reaches=((0.75,), (0.6, 0.9), (0.5, 0.75, 1.0)),
        ),
        Game(
            "bubbles-legs",
            "Bubble Burst for legs",
            "legs",
            "Burst the bubbles in front of you with both feet.",
            speeds=(0.15, 0.25, 0.35),
            intervals=(2.5, 1.8, 1.2),
            reaches=((0.75,), (0.75,), (0.75,)),
        ),
    )
}
"""By name."""


@dataclass(frozen=True)
class Target:
    """A bubble.

    Attributes
    ----------
    number : int
        Counts the targets of a game.
    side : str
        ``left`` or ``right``.
    place : (float, float, float)
        Centre.
    """

    number: int
    side: str
    place: Point


@dataclass(frozen=True)
class Event:
    """What happened to a target in this step.

    Attributes
    ----------
    kind : str
        ``burst`` or ``missed``.
    number, side, place
        The target's.
    bone : int
        That burst it, by its far joint; -1.
    """

    kind: Literal["burst", "missed"]
    number: int
    side: str
    place: Point
    bone: int = -1


@dataclass(frozen=True)
class ArmField:
    """Where bubbles rise for arms: lines to both sides of the shoulders.

    Attributes
    ----------
    lefts, rights : tuple of points
        One generator of each pair, at hip height.
    rise : float, metres
        From there to the ceiling.
    """

    lefts: tuple[Point, ...]
    rights: tuple[Point, ...]
    rise: float


@dataclass(frozen=True)
class LegField(ArmField):
    """Where bubbles rise for legs: two channels before the knees, from the floor to knee height."""


@dataclass(frozen=True)
class GameState:
    """All there is to know about a game; `begin` makes the first one and `step` the next.

    Attributes
    ----------
    game : Game
    difficulty, seed : int
    field : ArmField
    phase : str
        ``playing`` or ``over``.
    ending : str
        Why it is over: ``time`` or ``misses``; empty before.
    clock : float, seconds
        That were played; it stands still while nobody calls `step`.
    score, misses : int
    by_bone : mapping of int to int
        Bursts by the bone that touched.
    spawned : int
        Pairs of targets so far.
    targets : tuple of Target
    stains : tuple of points
        Where missed targets reached the ceiling.
    events : tuple of Event
        Of the last step.
    """

    game: Game
    difficulty: int
    seed: int
    field: ArmField
    phase: Phase = "playing"
    ending: Literal["", "time", "misses"] = ""
    clock: float = 0.0
    score: int = 0
    misses: int = 0
    by_bone: Mapping[int, int] = None  # type: ignore[assignment]
    spawned: int = 0
    targets: tuple[Target, ...] = ()
    stains: tuple[Point, ...] = ()
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        if self.by_bone is None:
            object.__setattr__(self, "by_bone", {})

    @property
    def speed(self) -> float:
        """Metres per second of a target."""
        return self.game.speeds[self.difficulty - 1]


def bones_of(limbs: Literal["arms", "legs"], side: str) -> tuple[int, ...]:
    """Return the joints of the end that touches: a hand's or a foot's.

    Colliders of these joints alone are the bones from wrist to finger tips, or from ankle to toes.

    Examples
    --------
    >>> bones_of("arms", "right")
    (10, 11, 23, 24)
    """
    parts = _HANDS if limbs == "arms" else _FEET
    return tuple(sorted(JOINTS.index(f"{part}{side.title()}") for part in parts))


@checked
def begin(name: str, skeleton: Skeleton, *, difficulty: int = 1, seed: int = 0) -> GameState | None:
    """Lay out a game around a player who is ready.

    Parameters
    ----------
    name : str
        Of `GAMES`.
    skeleton : Skeleton
        The player's, with all limbs that play.
    difficulty : int
        1 to 3.
    seed : int
        Of the places; at least 0.

    Returns
    -------
    GameState or None
        None where a joint that the places depend on is not tracked.

    Raises
    ------
    InputError
        No such game or difficulty, or a negative seed.
    """
    if name not in GAMES:
        raise InputError(f"name: expected one of {', '.join(GAMES)}, got {name!r}")
    if not 1 <= difficulty <= 3:
        raise InputError(f"difficulty: expected 1 to 3, got {difficulty}")
    if seed < 0:
        raise InputError(f"seed: expected >= 0, got {seed}")
    game = GAMES[name]
    lay_out = _arm_field if game.limbs == "arms" else _leg_field
    field = lay_out(skeleton, game.reaches[difficulty - 1])
    return None if field is None else GameState(game, difficulty, seed, field)


def step(state: GameState, seconds: float, touch: Touch) -> GameState:
    """The game after some more seconds of play.

    Targets rise, are burst by what touches them on the way, or stain the ceiling; new ones appear
    in pairs, left and right at the same time. When the time is over or too many were missed, the
    game is over and nothing changes any more.

    Parameters
    ----------
    state : GameState
    seconds : float
        At least 0.
    touch : callable
        `Touch`.

    Raises
    ------
    InputError
        Negative or infinite seconds.
    """
    if not 0.0 <= seconds < math.inf:
        raise InputError(f"seconds: expected >= 0, got {seconds}")
    if state.phase == "over":
        return replace(state, events=())
    clock = min(state.clock + seconds, state.game.seconds)
    risen = _touched(state, (clock - state.clock) * state.speed, touch)
    return _ended(_spawned(replace(risen, clock=clock)))


def _touched(state: GameState, way: float, touch: Touch) -> GameState:
    """Moves the targets; those that were touched or have arrived are gone."""
    targets = state.targets
    before = np.array([t.place for t in targets], np.float32).reshape(-1, 3)
    after = before + np.float32(way) * _UP.astype(np.float32)
    bones = touch(before, after, np.full(len(targets), state.game.radius, np.float32))
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
    """Pairs whose time has come; the n-th appears at n intervals, at a place that the seed says."""
    interval = state.game.intervals[state.difficulty - 1]
    targets, spawned = list(state.targets), state.spawned
    while spawned * interval <= state.clock:
        pair = int(np.random.default_rng([state.seed, spawned]).integers(len(state.field.lefts)))
        for which, generators in enumerate((state.field.lefts, state.field.rights)):
            targets.append(Target(2 * spawned + which, _SIDES[which], generators[pair]))
        spawned += 1
    return replace(state, targets=tuple(targets), spawned=spawned)


def _ended(state: GameState) -> GameState:
    if state.misses >= state.game.most_misses:
        return replace(state, phase="over", ending="misses", targets=())
    if state.clock >= state.game.seconds:
        return replace(state, phase="over", ending="time", targets=())
    return state


# --- where targets appear -------------------------------------------------------------------------


def _joints(skeleton: Skeleton, *names: str) -> list[NDArray[np.float64]] | None:
    numbers = [JOINTS.index(name) for name in names]
    if any(skeleton.states[number] == NOT_TRACKED for number in numbers):
        return None
    return [skeleton.positions[number].astype(np.float64) for number in numbers]


def _length(chain: list[NDArray[np.float64]]) -> float:
    return sum(_norm(b - a) for a, b in itertools.pairwise(chain))


def _norm(vector: NDArray[np.float64]) -> float:
    return math.sqrt(sum(float(x) * float(x) for x in vector))


def _level(vector: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The horizontal part, of length 1."""
    flat = np.array([vector[0], 0.0, vector[2]])
    length = _norm(flat)
    return flat / length if length > 1e-6 else None


def _point(place: NDArray[np.float64]) -> Point:
    return float(place[0]), float(place[1]), float(place[2])


def _arm_field(skeleton: Skeleton, reaches: tuple[float, ...]) -> ArmField | None:
    """Beside the shoulders, at shares of the longer arm's length; from the hips to above them."""
    shoulders = _joints(skeleton, "ShoulderLeft", "ShoulderRight")
    base = _joints(skeleton, "SpineBase")
    arms = [
        _length(arm)
        for side in ("Left", "Right")
        if (arm := _joints(skeleton, *(f"{part}{side}" for part in ("Shoulder", "Elbow", "Wrist"))))
    ]
    if shoulders is None or base is None or not arms:
        return None
    lateral = _level(shoulders[0] - shoulders[1])
    if lateral is None:
        return None
    length = max(arms)
    bottom = float(base[0][1])
    sides = []
    for shoulder, sign in zip(shoulders, (1.0, -1.0), strict=True):
        start = np.array([shoulder[0], bottom, shoulder[2]])
        sides.append(tuple(_point(start + sign * r * length * lateral) for r in reaches))
    top = min(float(s[1]) for s in shoulders) - 0.6 * length
    return ArmField(sides[0], sides[1], max(bottom - top, 0.1))


def _leg_field(skeleton: Skeleton, reaches: tuple[float, ...]) -> ArmField | None:
    """Before the knees, at a share of the shank's length towards where the hips face."""
    hips = _joints(skeleton, "HipLeft", "HipRight")
    knees = _joints(skeleton, "KneeLeft", "KneeRight")
    ankles = _joints(skeleton, "AnkleLeft", "AnkleRight")
    if hips is None or knees is None or ankles is None:
        return None
    lateral = _level(hips[0] - hips[1])
    if lateral is None:
        return None
    ahead = np.array([lateral[2], 0.0, -lateral[0]])  # a person who faces the camera: -z
    shank = max(_norm(ankle - knee) for ankle, knee in zip(ankles, knees, strict=True))
    bottom = max(float(ankle[1]) for ankle in ankles)
    sides = []
    for knee in knees:
        start = np.array([knee[0], bottom, knee[2]])
        sides.append(tuple(_point(start + r * shank * ahead) for r in reaches))
    top = min(float(knee[1]) for knee in knees)
    return LegField(sides[0], sides[1], max(bottom - top, 0.1))
