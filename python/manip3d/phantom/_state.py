"""Data of the games: state, targets and fields, and the places of joints."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from manip3d.rgbd import JOINTS, NOT_TRACKED, Skeleton

SIDES = ("left", "right")

Phase = Literal["playing", "over"]
Rules = Literal["bubbles", "pedal", "piano"]
Point = tuple[float, float, float]
Touch = Callable[[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]], NDArray[np.int8]]
"""From the targets' centres before and now, (N, 3), and radii, (N,), to the bone that touched each
one, (N,); -1: none."""

_HANDS = ("Wrist", "Hand", "HandTip", "Thumb")
_FEET = ("Ankle", "Foot")


@dataclass(frozen=True)
class Game:
    """A game and its levels of difficulty, 1 to 3.

    Attributes
    ----------
    name, title, limbs : str
        ``limbs`` is ``arms`` or ``legs``: whose ends play.
    how : str
        What the player does, in a sentence.
    rules : str
        ``bubbles``, ``pedal`` or ``piano``.
    speeds : tuple of float, metres per second
        Speeds of the bubbles, one for each difficulty.
    intervals : tuple of float, seconds
        Between one pair of bubbles and the next; how long a key of the piano stays up.
    reaches : tuple of tuple of float
        Places of the pairs of generators or keys, as shares of the limb's length.
    strokes : tuple of int
        Strokes of a pedal that lift its ball to the disk, one number for each difficulty.
    swings : tuple of float
        How far the foot must move to count: degrees at the ankle for the pedals, metres above the
        floor for the piano.
    radius : float, metres
        Radius of a target.
    seconds : float
        Time limit.
    most_misses : int
        Ends the game; 0: nothing is lost by a miss.
    """

    name: str
    title: str
    limbs: Literal["arms", "legs"]
    how: str
    rules: Rules = "bubbles"
    speeds: tuple[float, float, float] = (0.0, 0.0, 0.0)
    intervals: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reaches: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] = ((0.0,),) * 3
    strokes: tuple[int, int, int] = (0, 0, 0)
    swings: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.09
    seconds: float = 60.0
    most_misses: int = 20


@dataclass(frozen=True)
class Target:
    """A bubble, a ball over a pedal, or a key of the piano that is up.

    Attributes
    ----------
    number : int
        Counts the targets of a game.
    side : str
        ``left`` or ``right``.
    place : (float, float, float)
        Centre.
    key : int
        Key of the piano, counted from the player's left to their right.
    age : float, seconds
        How long a key has been up.
    """

    number: int
    side: str
    place: Point
    key: int = 0
    age: float = 0.0


@dataclass(frozen=True)
class Event:
    """Event of a target in this step.

    Attributes
    ----------
    kind : str
        ``burst`` of a bubble, ``stroke`` of a pedal, ``arrived`` at the disk, ``note`` of a key;
        ``missed``.
    number, side, place, key
        The target's.
    bone : int
        Bone that did it, by its far joint; -1: none.
    """

    kind: Literal["burst", "stroke", "arrived", "note", "missed"]
    number: int
    side: str
    place: Point
    bone: int = -1
    key: int = 0


@dataclass(frozen=True)
class ArmField:
    """Field in which bubbles rise for arms: lines to both sides of the shoulders.

    Attributes
    ----------
    lefts, rights : tuple of points
        One generator of each pair, at hip height.
    rise : float, metres
        From there to the ceiling.
    roots : (point, point)
        The left and the right shoulder, or knee.
    reach : float, metres
        From a root to what its limb can touch.
    """

    lefts: tuple[Point, ...]
    rights: tuple[Point, ...]
    rise: float
    roots: tuple[Point, Point]
    reach: float


@dataclass(frozen=True)
class LegField(ArmField):
    """Field for legs: two channels before the knees, from the floor to knee height."""


@dataclass(frozen=True)
class PedalField:
    """A pedal under each foot, and over it the way of a ball.

    Attributes
    ----------
    lefts, rights : tuple of one point
        Where the balls begin.
    rise : float, metres
        From there to the disks.
    """

    lefts: tuple[Point, ...]
    rights: tuple[Point, ...]
    rise: float


@dataclass(frozen=True)
class PianoField:
    """A row of keys on the floor.

    Attributes
    ----------
    lefts, rights : tuple of points
        Keys that the left and the right foot reach, from the middle outwards.
    floor : float
        Where a foot stands, the y of its joint.
    """

    lefts: tuple[Point, ...]
    rights: tuple[Point, ...]
    floor: float


@dataclass(frozen=True)
class Foot:
    """Moves of a foot so far.

    Attributes
    ----------
    is_up : bool
        The toes are drawn up, or the foot was lifted off the floor.
    turn : float or None
        The value (an angle, degrees) at which it last turned round; None before the first one.
    moves : int
        Up or down, so far.
    """

    is_up: bool = False
    turn: float | None = None
    moves: int = 0


@dataclass(frozen=True)
class GameState:
    """All there is to know about a game; `begin` makes the first one and `step` the next.

    Attributes
    ----------
    game : Game
    difficulty, seed : int
    field : ArmField, LegField, PedalField or PianoField
    phase : str
        ``playing`` or ``over``.
    ending : str
        Why it is over: ``time``, ``misses`` or ``done``; empty before.
    clock : float, seconds
        Time that was played; it stands still while nobody calls `step`.
    score, misses : int
    by_bone : mapping of int to int
        Points by the bone that made them.
    spawned : int
        Pairs of bubbles, or keys, so far.
    wait : float, seconds
        Until the next key pops up.
    feet : (Foot, Foot)
        The left and the right one.
    targets : tuple of Target
    stains : tuple of points
        Where missed targets reached the ceiling.
    events : tuple of Event
        Events of the last step.
    """

    game: Game
    difficulty: int
    seed: int
    field: ArmField | PedalField | PianoField
    phase: Phase = "playing"
    ending: Literal["", "time", "misses", "done"] = ""
    clock: float = 0.0
    score: int = 0
    misses: int = 0
    by_bone: Mapping[int, int] = None  # type: ignore[assignment]
    spawned: int = 0
    wait: float = 0.0
    feet: tuple[Foot, Foot] = (Foot(), Foot())
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


# --- where joints are -----------------------------------------------------------------------------


def joints(skeleton: Skeleton, *names: str) -> list[NDArray[np.float64]] | None:
    numbers = [JOINTS.index(name) for name in names]
    if any(skeleton.states[number] == NOT_TRACKED for number in numbers):
        return None
    return [skeleton.positions[number].astype(np.float64) for number in numbers]


def length(chain: list[NDArray[np.float64]]) -> float:
    return sum(norm(b - a) for a, b in itertools.pairwise(chain))


def norm(vector: NDArray[np.float64]) -> float:
    return math.sqrt(sum(float(x) * float(x) for x in vector))


def level(vector: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The horizontal part, of length 1."""
    flat = np.array([vector[0], 0.0, vector[2]])
    length = norm(flat)
    return flat / length if length > 1e-6 else None


def point(place: NDArray[np.float64]) -> Point:
    return float(place[0]), float(place[1]), float(place[2])
