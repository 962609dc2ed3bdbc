"""Data of the games: state, targets and fields; and helpers for positions of joints."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from manip3d._util.reprs import short_repr
from manip3d.rgbd import JOINTS, NOT_TRACKED, TRACKED, Skeleton

SIDES = ("left", "right")

Phase = Literal["playing", "over"]
Rules = Literal["bubbles", "pedal", "piano"]
Point = tuple[float, float, float]
"""Position in level axes, metres: x right, y down along the vertical, z forward."""

Touch = Callable[[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]], NDArray[np.int8]]
"""Function that returns the bone that touched each target, (N,), or -1. Its arguments are the
targets' centres in the previous and in the current frame, (N, 3), and radii, (N,); metres in level
axes."""

END_SHARE = 5 / 9
"""Radius of a hand or foot as a share of that of a bubble: 0.05 m for bubbles of 0.09 m."""

_LONGEST_GAP_S = 0.3  # seconds for which a foot may be unseen within a movement

_HANDS = ("Wrist", "Hand", "HandTip", "Thumb")
_FEET = ("Ankle", "Foot")
_IN_WORDS = {"SpineBase": "base of the spine"}


@dataclass(frozen=True)
class Game:
    """A game and its levels of difficulty, 1 to 3.

    Attributes
    ----------
    name, title, limbs : str
        Key, title, and the limbs whose hands or feet play: ``arms`` or ``legs``.
    how : str
        Instruction for the player, in a sentence.
    rules : str
        ``bubbles``, ``pedal`` or ``piano``.
    joints : tuple of str
        Joints without which the game cannot begin; of both sides if no side is named.
    speeds : tuple of float, metres per second
        Speeds of the bubbles, one for each difficulty.
    intervals : tuple of float, seconds
        Time between two pairs of bubbles, or time for which a key of the piano stays up; one for
        each difficulty.
    reaches : tuple of tuple of float
        Distances of the pairs of generators or keys, as shares of the limb's length.
    strokes : tuple of int
        Number of strokes of a pedal that lift its ball to the disk, one for each difficulty.
    swings : tuple of float
        Smallest movement of a foot that counts: degrees at the ankle for the pedals, more where the
        tracker is noisy; metres above the floor for the piano.
    radius : float, metres
        Largest radius of a target; those of a child are smaller (`ArmField.radius`,
        `PianoField.radius`).
    seconds : float
        Time limit.
    most_misses : int
        Number of misses that ends the game; 0: misses do not end it.
    """

    name: str
    title: str
    limbs: Literal["arms", "legs"]
    how: str
    rules: Rules = "bubbles"
    joints: tuple[str, ...] = ()
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
        Number of the target within the game.
    side : str
        ``left`` or ``right``.
    place : (float, float, float)
        Centre in level axes (x right, y down along the vertical, z forward), metres.
    key : int
        Key of the piano, counted from the player's left to their right.
    age : float, seconds
        Time for which a key has been up.
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
        ``burst`` (a bubble), ``stroke`` (of a pedal), ``arrived`` (a ball at its disk), ``note`` (a
        key), or ``missed``.
    number, side, place, key
        Values of the target.
    bone : int
        Bone that caused the event, numbered by its far joint; -1: none.
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
        Left and right generator of each pair, at hip height.
    rise : float, metres
        Height of the ceiling above the generators.
    roots : (point, point)
        The left and the right shoulder, or knee.
    reach : float, metres
        Largest distance from a root that its limb can touch.
    radius : float, metres
        Radius of a bubble: `Game.radius`, and less for an arm shorter than 0.5 m or a shank shorter
        than 0.39 m, because the lines are closer to the hands or feet at rest.
    """

    lefts: tuple[Point, ...]
    rights: tuple[Point, ...]
    rise: float
    roots: tuple[Point, Point]
    reach: float
    radius: float

    @property
    def end_radius(self) -> float:
        """Radius of the hands or feet that burst the bubbles, metres."""
        return END_SHARE * self.radius


@dataclass(frozen=True)
class LegField(ArmField):
    """Field for legs: two channels before the knees, from the floor to knee height."""


@dataclass(frozen=True)
class PedalField:
    """A pedal under each foot, and a ball that rises beside it.

    Attributes
    ----------
    lefts, rights : tuple of one point
        Start of the left and of the right ball.
    rise : float, metres
        Height of the disks above the starts.
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
        The y coordinate of the joint of a foot that stands on the floor, metres.
    radius : float, metres
        Distance from the centre of a key within which a foot plays it: `Game.radius`, and less for
        a shank shorter than 0.39 m, because the keys are closer together.
    """

    lefts: tuple[Point, ...]
    rights: tuple[Point, ...]
    floor: float
    radius: float


@dataclass(frozen=True)
class FootSamples:
    """Measurements of a foot and how steady they are.

    Attributes
    ----------
    recent : tuple of (float, float, float)
        Last measurements: time of play, seconds; angle at the ankle, degrees; distance from ankle
        to foot, metres.
    since : float, seconds
        Time of play since which the measurements have had neither gap nor jump.
    seconds : float
        Time over which `length` and `variance` are averages.
    length, variance : float, metres and square metres
        Mean and variance of the distance from ankle to foot.
    """

    recent: tuple[Point, ...] = ()
    since: float = 0.0
    seconds: float = 0.0
    length: float = 0.0
    variance: float = 0.0


@dataclass(frozen=True)
class Foot:
    """Movements of a foot so far.

    Attributes
    ----------
    is_up : bool
        Whether the toes are drawn up, or the foot is lifted off the floor.
    turn : float or None
        Angle, degrees, at which the movement last changed direction; None: not yet measured.
    moves : int
        Number of movements up or down.
    seen : float or None, seconds
        Time of play at which the foot was last seen; None: not since the beginning or a pause.
    samples : FootSamples
        Measurements of a foot on a pedal.
    """

    is_up: bool = False
    turn: float | None = None
    moves: int = 0
    seen: float | None = None
    samples: FootSamples = FootSamples()


@dataclass(frozen=True)
class GameState:
    """Complete state of a game; `begin` makes the first state and `step` each next one.

    Attributes
    ----------
    game : Game
    difficulty, seed : int
    field : ArmField, LegField, PedalField or PianoField
    phase : str
        ``playing`` or ``over``.
    ending : str
        Reason of the end: ``time``, ``misses`` or ``done``; empty while the game is running.
    clock : float, seconds
        Time of play; it passes only by calls of `step`.
    score, misses : int
        Numbers of points and of misses.
    by_bone : mapping of int to int
        Number of points made by each bone.
    spawned : int
        Number of pairs of bubbles, or of keys, so far.
    wait : float, seconds
        Time until the next key pops up.
    feet : (Foot, Foot)
        The left and the right foot.
    gain : float
        Factor by which the angles of the feet, and their noise, were enlarged.
    targets : tuple of Target
        Current targets.
    stains : tuple of points
        Places at which missed targets reached the ceiling.
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
    gain: float = 1.0
    targets: tuple[Target, ...] = ()
    stains: tuple[Point, ...] = ()
    events: tuple[Event, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.by_bone is None:
            object.__setattr__(self, "by_bone", {})

    @property
    def speed(self) -> float:
        """Speed of a target, metres per second."""
        return self.game.speeds[self.difficulty - 1]

    @property
    def radius(self) -> float:
        """Radius of a target, metres."""
        return self.game.radius if isinstance(self.field, PedalField) else self.field.radius


def forget_feet(state: GameState) -> GameState:
    """Return the state after a pause: the next frame sets the feet anew and counts nothing."""
    left, right = (replace(foot, seen=None) for foot in state.feet)
    return replace(state, feet=(left, right))


def is_new(foot: Foot, clock: float) -> bool:
    """Return whether a foot is seen for the first time, or again after a gap."""
    return foot.seen is None or clock - foot.seen > _LONGEST_GAP_S


def bones_of(limbs: Literal["arms", "legs"], side: str) -> tuple[int, ...]:
    """Return the joints of the end that touches: a hand's or a foot's.

    Colliders of these joints alone are the bones from wrist to finger tips, or from ankle to toes.

    Examples
    --------
    >>> from manip3d.phantom.games import bones_of
    >>> bones_of("arms", "right")
    (10, 11, 23, 24)
    """
    parts = _HANDS if limbs == "arms" else _FEET
    return tuple(sorted(JOINTS.index(f"{part}{side.title()}") for part in parts))


def missing_joints(game: Game, skeleton: Skeleton) -> list[str]:
    """Return the joints that are not tracked and without which a game cannot begin, in words."""
    missing = []
    for part in game.joints:
        sides = ("",) if part in JOINTS else tuple(side.title() for side in SIDES)
        for side in sides:
            if skeleton.states[JOINTS.index(part + side)] == NOT_TRACKED:
                missing.append(f"{side} {_IN_WORDS.get(part, part)}".strip().lower())
    return missing


# --- where joints are -----------------------------------------------------------------------------


def joints(skeleton: Skeleton, *names: str) -> list[NDArray[np.float64]] | None:
    numbers = [JOINTS.index(name) for name in names]
    if any(skeleton.states[number] == NOT_TRACKED for number in numbers):
        return None
    return [skeleton.positions[number].astype(np.float64) for number in numbers]


def seen_joints(skeleton: Skeleton, *names: str) -> list[NDArray[np.float64]] | None:
    """Return the joints, metres; None: one is not tracked or only inferred from the others."""
    if any(skeleton.states[JOINTS.index(name)] != TRACKED for name in names):
        return None
    return joints(skeleton, *names)


def length(chain: list[NDArray[np.float64]]) -> float:
    return sum(norm(b - a) for a, b in itertools.pairwise(chain))


def norm(vector: NDArray[np.float64]) -> float:
    return math.sqrt(sum(float(x) * float(x) for x in vector))


def level(vector: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the normalised horizontal part of a vector; None: it is too short."""
    flat = np.array([vector[0], 0.0, vector[2]])
    length = norm(flat)
    return flat / length if length > 1e-6 else None


def point(place: NDArray[np.float64]) -> Point:
    return float(place[0]), float(place[1]), float(place[2])
