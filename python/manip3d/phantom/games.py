"""Rules of the games: pure functions of the state, the elapsed time and the touched targets.

The functions do not draw, wait or read the clock: the same seed, times, touches and joints give the
same game. Positions are in level axes (x right, y down along the vertical, z ahead), metres: those
of a level camera or of `manip3d.modify.PhantomFrame.levelled`. Left and right are the player's own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.phantom._bubbles import bubble_field, can_reach_bubble, play_bubbles
from manip3d.phantom._pedal import ankle_angle, pedal_field, play_pedal
from manip3d.phantom._piano import keys_of, piano_field, play_piano
from manip3d.phantom._state import (
    ArmField,
    Event,
    Foot,
    FootSamples,
    Game,
    GameState,
    LegField,
    PedalField,
    PianoField,
    Target,
    Touch,
    bones_of,
)
from manip3d.rgbd import Skeleton

__all__ = [
    "GAMES",
    "ArmField",
    "Event",
    "Foot",
    "FootSamples",
    "Game",
    "GameState",
    "LegField",
    "PedalField",
    "PianoField",
    "Target",
    "Touch",
    "ankle_angle",
    "begin",
    "bones_of",
    "can_reach",
    "keys_of",
    "step",
]

GAMES: Mapping[str, Game] = {
    game.name: game
    for game in (
        Game(
            "bubbles",
            "Bubble Burst",
            "arms",
            "Burst the bubbles with both hands before they reach the ceiling.",
            joints=("Shoulder", "SpineBase"),
            speeds=(0.25, 0.4, 0.6),
            intervals=(2.5, 1.8, 1.2),
            reaches=((0.75,), (0.6, 0.9), (0.5, 0.75, 1.0)),
        ),
        Game(
            "bubbles-legs",
            "Bubble Burst for legs",
            "legs",
            "Burst the bubbles in front of you with both feet.",
            joints=("Hip", "Knee", "Ankle"),
            speeds=(0.15, 0.25, 0.35),
            intervals=(2.5, 1.8, 1.2),
            reaches=((0.75,), (0.75,), (0.75,)),
        ),
        Game(
            "pedal",
            "Pedal",
            "legs",
            "Draw your toes up and press them down, again and again, until both balls reach their "
            "disks.",
            rules="pedal",
            joints=("Knee", "Ankle", "Foot"),
            strokes=(8, 12, 16),
            swings=(12.0, 15.0, 18.0),
            radius=0.07,
            seconds=120.0,
            most_misses=0,
        ),
        Game(
            "piano",
            "Piano",
            "legs",
            "Lift a foot and stomp on the key that lights up.",
            rules="piano",
            joints=("Hip", "Knee", "Ankle", "Foot"),
            intervals=(6.0, 4.0, 2.5),
            reaches=((0.0, 0.4), (0.0, 0.4, 0.8), (0.0, 0.4, 0.8)),
            swings=(0.08, 0.1, 0.12),
            radius=0.11,
            most_misses=0,
        ),
    )
}
"""All games by name."""

_PLAY = {"bubbles": play_bubbles, "pedal": play_pedal, "piano": play_piano}


@checked
def begin(
    name: str,
    skeleton: Skeleton,
    *,
    difficulty: int = 1,
    seed: int = 0,
    floor: float | None = None,
    rest: Skeleton | None = None,
    at_any_rest: bool = False,
) -> GameState | None:
    """Lay out a game around a player who is ready.

    Parameters
    ----------
    name : str
        Key of `GAMES`.
    skeleton : Skeleton
        The player's skeleton in level axes, with all limbs that play.
    difficulty : int
        Difficulty, 1 to 3.
    seed : int
        Seed of the places of the targets; at least 0.
    floor : float, optional
        For the piano, the y coordinate of a foot that stands on the floor; default: that of the
        lower foot.
    rest : Skeleton, optional
        For bubbles, the player with hands or feet at rest, past which they rise without a touch;
        default: the player does not rest, and the bubbles are where the game has them.
    at_any_rest : bool
        Begin even if hands or feet rest so far from the body that bubbles beyond them are out of
        reach, as with a stiff knee: these bubbles rise as far away as the limb reaches, and begin
        above the resting hands or feet.

    Returns
    -------
    GameState or None
        None: a joint that the layout depends on is not tracked. Those of `Game.joints` are needed
        in any case; trackers with the joints of COCO have no feet, which pedals and piano need.
        Or hands or feet rest so far from the body that bubbles beyond them would be out of reach,
        and not ``at_any_rest``.

    Raises
    ------
    InputError
        No such game or difficulty, a negative seed, or a floor that is not a finite number.
    """
    if name not in GAMES:
        raise InputError(f"name: expected one of {', '.join(GAMES)}, got {name!r}")
    if not 1 <= difficulty <= 3:
        raise InputError(f"difficulty: expected 1 to 3, got {difficulty}")
    if seed < 0:
        raise InputError(f"seed: expected >= 0, got {seed}")
    if floor is not None and not math.isfinite(floor):
        raise InputError(f"floor: expected a finite number, got {floor}")
    game = GAMES[name]
    field: ArmField | PedalField | PianoField | None
    if game.rules == "pedal":
        field = pedal_field(skeleton, game, difficulty)
    elif game.rules == "piano":
        field = piano_field(skeleton, game, difficulty, floor)
    else:
        field = bubble_field(skeleton, game, difficulty, rest, at_any_rest=at_any_rest)
    return None if field is None else GameState(game, difficulty, seed, field)


def step(
    state: GameState, seconds: float, touch: Touch, skeleton: Skeleton | None = None
) -> GameState:
    """Return the state of a game after some more seconds of play.

    Bubbles rise, burst if they are touched, or stain the ceiling; new bubbles appear in pairs, left
    and right at the same time. Balls rise by strokes of the feet; keys pop up and are stomped on.
    Joints that are only inferred move no pedal and no key, and a foot that was not seen for 0.3 s
    is measured anew. Strokes must be slower than 300 degrees a second and larger than the noise of
    the tracker, which shows as changes of the foot's length.
    The game is over when the time is up, both balls have arrived or too many bubbles were missed;
    its state then stays the same.

    Parameters
    ----------
    state : GameState
    seconds : float
        Elapsed time, at least 0.
    touch : callable
        Function that finds touched targets, as `Touch`.
    skeleton : Skeleton, optional
        The player's skeleton in level axes, which pedals and piano need; without it no foot moves.

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
    played = replace(state, clock=clock)
    return _ended(_PLAY[state.game.rules](played, clock - state.clock, touch, skeleton))


def can_reach(state: GameState) -> bool:
    """Return whether a target is in reach.

    Examples
    --------
    >>> from manip3d.phantom.games import GAMES, GameState, PianoField, can_reach
    >>> field = PianoField(((0, 0, 2),), ((0.3, 0, 2),), floor=0.0, radius=0.11)
    >>> piano = GameState(GAMES["piano"], 1, 0, field)
    >>> can_reach(piano)  # no key is up
    False
    """
    if state.phase == "over":
        return False
    if state.game.rules == "bubbles":
        return can_reach_bubble(state)
    return bool(state.targets)


def _ended(state: GameState) -> GameState:
    if state.phase == "over":
        return state
    if state.game.most_misses and state.misses >= state.game.most_misses:
        return replace(state, phase="over", ending="misses", targets=())
    if state.clock >= state.game.seconds:
        return replace(state, phase="over", ending="time", targets=())
    return state
