"""The game of a session: choice, course, films of anomalies, and storage by the recorder."""

from __future__ import annotations

import functools
import math
from collections import Counter, deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.modify import ColliderTracker, PhantomState
from manip3d.phantom._anomalies import AnomalyWatch
from manip3d.phantom._clips import ClipRing
from manip3d.phantom._ends import Rest, ends_of
from manip3d.phantom._pedal import advise_pedal
from manip3d.phantom._piano import on_floor
from manip3d.phantom._recorder import GameSummary, Pictures, Recorder
from manip3d.phantom._setup import moved_to
from manip3d.phantom._state import forget_feet, missing_joints
from manip3d.phantom.games import (
    GAMES,
    ArmField,
    GameState,
    PedalField,
    PianoField,
    begin,
    bones_of,
    keys_of,
    step,
)
from manip3d.rgbd import JOINTS, TRACKED, Skeleton

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics
    from manip3d.modify import PhantomFrame
    from manip3d.phantom._level import Level

_EVENTS_NS = (
    1_000_000_000  # seconds for which frames repeat an event, because slow pages skip frames
)
_TELL_S = 10.0  # seconds between stored states of the current game
_FLOOR_S = 10.0  # seconds of feet's heights that tell the floor
_FLOOR_SHARE = 0.9  # share of them above it: feet that stomp are in the air for most of the time
LONGEST_STEP_S = 0.25
"""Seconds; a longer gap between two frames is a pause: how the player moved in it is unknown."""
_FEET = tuple(JOINTS.index(name) for name in ("FootLeft", "FootRight"))

_TOO_SLOW = (
    "The pictures come too slowly or were missing, so the game waits: close other programs and "
    "check the camera."
)

_PATIENCE_S = 15.0  # seconds after which a game begins although hands or feet are in the way

_REST = {
    "arms": "Let your arms hang close to the body, so that the bubbles can rise beside them.",
    "legs": "Put your feet under your knees, so that the bubbles can rise before them.",
}


class Play:
    """The current game of a session, if any, and those that are over.

    Attributes
    ----------
    choice : (str, int)
        Name and difficulty of the next game.
    game : GameState or None
        The current game.
    is_wanted : bool
        Whether a game begins with the next frame in which the limb is tracked.
    limb : str
        The limb that is replaced.
    gain : float
        Factor of joint angles (virtual enhancement).
    summaries : list of GameSummary
        Games that are over.
    advice : str
        Reason why the game, in the last frame, does not begin or does not count movements; empty
        if there is none.
    """

    def __init__(
        self, choice: tuple[str, int], seed: int, limb: str, gain: float, recorder: Recorder | None
    ) -> None:
        self.choice = choice
        self.game: GameState | None = None
        self.is_wanted = False
        self.limb = limb
        self.gain = gain
        self.summaries: list[GameSummary] = []
        self.advice = ""
        self._seed = seed
        self._recorder = recorder
        self._watch = AnomalyWatch()
        self._ring: ClipRing | None = None
        self._clips: list[Pictures] = []
        self._seen = Counter[
            bool
        ]()  # numbers of frames of the game in which the limb was and was not tracked
        self._paused_s = self._told_s = 0.0
        self._ends = ColliderTracker()  # colliders of hands or feet alone
        self._rest = Rest()
        self._refused_s = 0.0  # seconds for which hands or feet have been in the way
        self._heights: deque[tuple[int, float]] = deque()  # times and y of tracked feet
        self._events: deque[tuple[int, list[Any]]] = (
            deque()
        )  # time and content of each recent event
        self._num_events = 0

    @property
    def is_playing(self) -> bool:
        return self.game is not None and self.game.phase == "playing"

    @property
    def has_game(self) -> bool:
        """Return whether a game has begun and is not over."""
        return self.game is not None and self.game.phase != "over"

    def want(self) -> None:
        """Begin a game with the next frame in which the limb is tracked."""
        self.game, self.is_wanted, self._refused_s = None, True, 0.0

    def stop(self) -> None:
        """End the current game, or cancel one that was to begin."""
        self.is_wanted = False
        if self.game is not None and self.game.phase == "playing":
            self._finish("stopped")
            self.game = replace(self.game, phase="over", targets=(), events=())

    def forget_times(self) -> None:
        """Note that the camera's clock was reset."""
        self.forget_places()
        self._events.clear()

    def forget_places(self) -> None:
        """Note that places before the next frame are unknown, as are those in other axes."""
        self._interrupt()
        self._heights.clear()
        self._rest.forget()

    def drop_films(self) -> None:
        """Drop the buffered pictures, and take no more."""
        self._ring, self._clips = None, [() for _ in self._clips]

    def go_on(
        self, shown: PhantomFrame, seconds: float, now: int, measured: Skeleton | None
    ) -> bool:
        """Process the next frame; return whether the game continued in it.

        ``shown`` and ``measured``, the patient's body if it was measured, are in level axes;
        ``now``: the frame's time, nanoseconds.
        """
        self.advice = ""
        if shown.state != PhantomState.TRACKING:
            self._interrupt()
            if self.is_playing:
                self._seen[False] += 1
                self._paused_s += seconds
            return False
        self._note_feet(shown.skeleton, now)
        self._rest.add(shown.skeleton, now)
        begins = self.is_wanted
        if begins:
            self._begin(shown.skeleton, measured)
        if self.game is None and begins:
            self.advice = _cannot_begin(self.choice[0], shown.skeleton)
            if not missing_joints(GAMES[self.choice[0]], shown.skeleton):
                self._refused_s += min(seconds, LONGEST_STEP_S)
        if self.game is None or self.game.phase == "over":
            return False
        self._seen[True] += 1
        is_late = seconds > LONGEST_STEP_S and not begins
        if is_late:
            self._interrupt()
        self._ends.update(ends_of(shown.skeleton, self.game.game.limbs))
        if is_late:
            self._paused_s += seconds
            self.advice = _TOO_SLOW
            return False
        played = seconds if seconds <= LONGEST_STEP_S else 0.0
        if isinstance(self.game.field, PianoField):
            self.game = on_floor(self.game, self._floor())
        game = replace(self.game, gain=self._gain_in(self.game))
        self.game = step(game, played, self._touched, shown.skeleton)
        self._watch.update(self.game)
        self._keep_clips()
        if self.game.phase == "over":
            self._finish(self.game.ending)
        elif self.game.game.rules == "pedal":
            self.advice = advise_pedal(self.game)
        return True

    def tell(self) -> None:
        """Store the state of the game at its beginning and every ten seconds."""
        if self._recorder is None or self.game is None or self.game.phase != "playing":
            return
        if self.game.clock + self._paused_s >= self._told_s:
            self._told_s += _TELL_S
            self._recorder.game_goes_on(self._summary("interrupted"))

    def film(self, shown: PhantomFrame, camera: Intrinsics, level: Level) -> None:
        """Buffer the frame for a film of an anomaly, if the patient consented."""
        if self._ring is not None and self.game is not None:
            self._ring.add(shown, self.game, camera, self._watch.since, level)

    def shown(self, now: int, *, playing: bool) -> dict[str, Any]:
        """Return the state of the game for the page."""
        game, (chosen, difficulty) = self.game, self.choice
        if game is None:
            phase = "starting" if self.is_wanted else "waiting"
            return {"name": chosen, "difficulty": difficulty, "phase": phase}
        phase = game.phase if playing or game.phase == "over" else "paused"
        found: dict[str, Any] = {
            "name": game.game.name,
            "difficulty": game.difficulty,
            "phase": phase,
            "left_s": round(game.game.seconds - game.clock, 2),
            "score": game.score,
            "misses": game.misses,
            "by_phantom": self._by_phantom(game),
            "radius": game.radius,
            **_field_status(game),
            "targets": [[t.number, *rounded(t.place)] for t in game.targets],
            "stains": [rounded(place) for place in game.stains],
            "events": self._told_events(game if playing else None, now),
        }
        if game.phase == "over":
            found["ending"] = self.summaries[-1].ending
            found["paused_s"] = self.summaries[-1].paused_s
        return found

    def _begin(self, body: Skeleton, measured: Skeleton | None) -> None:
        """Begin a game once the person faces the camera."""
        name, difficulty = self.choice
        rest = self._rest.skeleton(GAMES[name].limbs)
        if measured is not None:
            body = moved_to(measured, body)
        seed = self._seed + len(self.summaries)
        floor = self._floor() if GAMES[name].rules == "piano" else None
        begin_at = functools.partial(
            begin, name, body, difficulty=difficulty, seed=seed, floor=floor
        )
        if rest is not None:
            self.game = begin_at(rest=rest, at_any_rest=self._refused_s >= _PATIENCE_S)
        else:
            # Hands or feet move. They rested when the body was measured, maybe in the way.
            self.game = begin_at(rest=None if measured is None else body) or begin_at()
        if self.game is None:
            return
        if isinstance(self.game.field, ArmField):
            self._ends = _colliders(self.game.field.end_radius)
        self.is_wanted, self._paused_s, self._told_s = False, 0.0, 0.0
        self._seen.clear()
        self._watch = AnomalyWatch()
        wanted = self._recorder is not None and self._recorder.wants_clips
        self._ring, self._clips = ClipRing() if wanted else None, []

    def _interrupt(self) -> None:
        """Note that movements before the next frame are unknown: they touch and count nothing."""
        self._ends.reset()
        if self.game is not None:
            self.game = forget_feet(self.game)

    def _finish(self, ending: str) -> None:
        self._watch.finish()
        self._keep_clips()
        summary = self._summary(ending)
        self.summaries.append(summary)
        if self._recorder is not None:
            self._recorder.game(summary, tuple(self._clips))
        self._ring, self._clips = None, []

    def _keep_clips(self) -> None:
        """Store the recorded frames of each anomaly that has ended."""
        for anomaly in self._watch.found[len(self._clips) :]:
            ring = self._ring
            self._clips.append(() if ring is None else ring.take(anomaly.start, anomaly.end))

    def _note_feet(self, skeleton: Skeleton, now: int) -> None:
        """Remember the heights (y) of the feet in the last seconds."""
        for joint in _FEET:
            height = float(skeleton.positions[joint][1])
            if skeleton.states[joint] == TRACKED and math.isfinite(height):
                self._heights.append((now, height))
        while self._heights and now - self._heights[0][0] > _FLOOR_S * 1e9:
            self._heights.popleft()

    def _floor(self) -> float | None:
        """Return the height (y) of the floor; None: no foot was seen in the last seconds."""
        if not self._heights:
            return None
        return float(np.quantile([y for _, y in self._heights], _FLOOR_SHARE))

    def _touched(
        self, start: NDArray[np.float32], end: NDArray[np.float32], radius: NDArray[np.float32]
    ) -> NDArray[np.int8]:
        return self._ends.hits(start, end, radius=radius).bone

    def _summary(self, ending: str) -> GameSummary:
        game, total = self.game, self._seen.total()
        assert game is not None
        return GameSummary(
            game=game.game.name,
            difficulty=game.difficulty,
            seed=game.seed,
            ending=ending,
            seconds=round(game.clock, 3),
            paused_s=round(self._paused_s, 3),
            score=game.score,
            misses=game.misses,
            by_phantom=self._by_phantom(game),
            gain=self._gain_in(game),
            anomalies=tuple(self._watch.found),
            limb=self.limb,
            tracked=round(self._seen[True] / total, 3) if total else None,
        )

    def _gain_in(self, game: GameState) -> float:
        """The gain, or 1 in a game for other limbs than those that it enlarges."""
        return self.gain if self.limb.endswith(game.game.limbs.removesuffix("s")) else 1.0

    def _by_phantom(self, game: GameState) -> int:
        own = bones_of(game.game.limbs, self.limb.partition("_")[0])
        if not self.limb.endswith(game.game.limbs[:-1]):  # the colliders are of the other limbs
            return 0
        return sum(number for bone, number in game.by_bone.items() if bone in own)

    def _told_events(self, game: GameState | None, now: int) -> list[list[Any]]:
        """Return the events of the last second with numbers.

        A page that skips frames misses none of them and plays none twice.
        """
        for event in () if game is None else game.events:
            self._num_events += 1
            told = [event.kind, event.number, event.bone, *rounded(event.place), event.key]
            self._events.append((now, [*told, self._num_events]))
        while self._events and now - self._events[0][0] > _EVENTS_NS:
            self._events.popleft()
        return [told for _, told in self._events]


def _colliders(radius: float) -> ColliderTracker:
    """Return colliders of a radius, metres, as long as no points are measured."""
    return ColliderTracker(min_radius=min(radius, 0.03), first_radius=radius)


def _cannot_begin(name: str, skeleton: Skeleton) -> str:
    """Return a sentence on the joints that a game lacks, and on games that can be played.

    If it lacks none, hands or feet are in the way of the bubbles.
    """
    missing = missing_joints(GAMES[name], skeleton)
    if not missing:
        return _REST[GAMES[name].limbs] if GAMES[name].rules == "bubbles" else ""
    told = f"{GAMES[name].title} needs joints that the tracker does not see: {', '.join(missing)}."
    others = [
        game.title
        for game in GAMES.values()
        if game.limbs == GAMES[name].limbs and not missing_joints(game, skeleton)
    ]
    return f"{told} What can be played: {', '.join(others)}." if others else told


def rounded(values: Any) -> Any:
    """Round nested lists of numbers to a tenth of a millimetre; JSON allows finite numbers only."""
    return (np.rint(np.nan_to_num(np.asarray(values, np.float64)) * 1e4) / 1e4).tolist()


def _field_status(game: GameState) -> dict[str, Any]:
    """Return the objects of the game for the page."""
    field = game.field
    if isinstance(field, PianoField):
        up = game.targets[0].key if game.targets else -1
        return {"keys": [rounded(place) for _, place in keys_of(field)], "up": up}
    if isinstance(field, PedalField):
        strokes = game.game.strokes[game.difficulty - 1]
        starts = (*field.lefts, *field.rights)
        disks = [rounded((x, y - field.rise, z)) for x, y, z in starts]
        return {"disks": disks, "starts": [rounded(place) for place in starts],
                "strokes": [foot.moves / 2 for foot in game.feet], "needed": strokes}  # fmt: skip
    assert isinstance(field, ArmField)
    return {"ceiling": field.lefts[0][1] - field.rise}
