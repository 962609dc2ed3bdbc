"""`LiveSession`: from a camera's frames and a page's messages to what the page shows."""

from __future__ import annotations

import functools
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.modify import ColliderTracker, Limb, PhantomPipeline, PhantomState, repose
from manip3d.phantom._anomalies import Anomaly, AnomalyWatch
from manip3d.phantom._clips import ClipRing
from manip3d.phantom._felt import LIMITS, FeltLimb, felt_places
from manip3d.phantom._setup import PlacementCalibration, moved_to, placement_checks
from manip3d.phantom._touch import ARM, LEG, MODES, SECONDS, STATEMENTS, Mode, TouchCue
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
from manip3d.rgbd import JOINTS, NOT_TRACKED, RgbdFrame, Skeleton
from manip3d.serve import Kind, encode_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.modify import BodyColliders, PhantomFrame

MOST_GAIN = 2.0
"""Largest gain of virtual enhancement."""

_ENHANCED = {"arm": ("Shoulder", "Elbow"), "leg": ("Hip", "Knee", "Ankle")}

LIMBS: Sequence[Limb] = ("left_arm", "right_arm", "left_leg", "right_leg")

_KEPT: dict[str, Kind] = {
    "page": Kind(int, 0, 2**32 - 1, optional=True),
    "number": Kind(int, 1, 2**31, optional=True),
}
"""What a page adds to what must not be lost: it says so again until the answer ``heard`` comes, and
the session takes each number of a page once."""

MESSAGES: Mapping[str, Mapping[str, Kind]] = {
    "ack": {"sequence": Kind(int, 0, 2**32 - 1), "decoded_ms": Kind(float, 0, 1e15)},
    "bad": {},
    "clock": {"sent_ms": Kind(float, 0, 1e15)},
    "screen": {},
    "choose": {"game": Kind(str, choices=tuple(GAMES)), "difficulty": Kind(int, 1, 3)},
    "ready": {},
    "stop": {},
    "enough": _KEPT,
    "unanswered": _KEPT,
    "again": {},
    "pain": {"value": Kind(int, 0, 10), **_KEPT},
    "unwell": _KEPT,
    "event": {"text": Kind(str, length=500), **_KEPT},
    "consent": {"clips": Kind(int, 0, 1), **_KEPT},
    "limb": {"limb": Kind(str, choices=LIMBS)},
    "patient": {"which": Kind(int, 1, 2**31)},
    "calibrate": {},
    "gain": {"value": Kind(float, 1, MOST_GAIN)},
    "touch": {"mode": Kind(str, choices=(*MODES, "off"))},
    "ownership": {"mode": Kind(str, choices=MODES)}
    | {f"q{number}": Kind(int, -3, 3) for number in range(1, len(STATEMENTS) + 1)}
    | _KEPT,
    "felt": {name: Kind(int, low, high) for name, (low, high) in LIMITS.items()} | _KEPT,
}
"""What a page may say."""

_NOT_LOST = tuple(name for name, fields in MESSAGES.items() if "number" in fields)
"""Messages that are taken even when the session ends before the next frame."""

OF_THE_CONNECTION = ("ack", "bad", "clock", "screen")
"""Messages that `hear` takes itself; all others are the session's."""

Pictures = Sequence[tuple[float, bytes]]

_Command = tuple[str, dict[str, Any], Callable[[], object] | None]
"""Name, fields, and what is called when it is kept."""

_LONGEST_STEP_S = 0.25  # a longer gap between frames is none of the player's time
_PAGES = 64  # of which the last number is known
_EVENTS_NS = 1_000_000_000  # for so long an event is told: a slow page leaves frames out
_TELL_S = 10.0  # between what is kept of a game that goes on
_FRAMES = 90  # over which times of stages are averaged
_REST = timedelta(hours=1)  # without a word: who goes on at midnight is in the same sitting
_FLOOR_S = 4.0  # for so long the lowest place of a foot is the floor
_FEET = tuple(JOINTS.index(name) for name in ("FootLeft", "FootRight"))


@runtime_checkable
class Recorder(Protocol):
    """What a session tells a diary."""

    @property
    def wants_clips(self) -> bool:
        """Whether the patient consented to short films of anomalies."""

    @property
    def trouble(self) -> str:
        """What is not kept yet, and why, in words; or nothing."""

    def game_goes_on(self, summary: GameSummary) -> None:
        """Keep how a game stands, in case the program is killed; `game` replaces it."""

    def game(self, summary: GameSummary, clips: Sequence[Pictures]) -> None:
        """Keep a game that is over; for each anomaly its pictures (seconds of play, JPEG), or
        none."""

    def may_play(self) -> str:
        """Why no game may start yet, in words for the patient, or nothing."""

    def play_begins(self) -> None:
        """A game or a touch cue begins; ratings of pain are no longer those before the session."""

    def pain(self, value: int) -> str:
        """Keep a rating from 0 to 10; return why the session must stop, or nothing."""

    def unwell(self) -> str:
        """Keep that the patient feels sick; return why the session must stop."""

    def event(self, text: str) -> None:
        """Keep an adverse event in words."""

    def consent(self, clips: bool) -> None:
        """Keep whether the patient consents to films; without consent theirs are deleted."""

    def ownership(self, mode: Mode, answers: Sequence[int]) -> None:
        """Keep the answers after a touch cue."""

    def felt(self, felt: FeltLimb, limb: str) -> None:
        """Keep how the patient feels a limb."""

    def last_felt(self, limb: str) -> FeltLimb | None:
        """How the patient felt that limb when they last said so."""

    def close_session(self, *, answered: bool = True) -> None:
        """The patient has had enough: the sitting is over; a second call changes nothing.

        ``answered``: whether the patient gave the rating that was asked for at the end."""

    def open_session(self) -> None:
        """Another sitting begins, with a first rating of its own; one that is open is closed."""

    def begin_message(self) -> None:
        """A page has said something: `when_kept` is about what is told from now on."""

    def when_kept(self, done: Callable[[], object]) -> None:
        """Call something as soon as all that was told since `begin_message` is on the disk; from
        any thread. It is not called where any of that cannot be kept."""


@dataclass(frozen=True)
class GameSummary:
    """A game that is over.

    Attributes
    ----------
    game : str
        Name out of `manip3d.phantom.games.GAMES`.
    difficulty, seed : int
    ending : str
        ``time``, ``misses``, ``done`` or ``stopped``; ``interrupted``: it goes on.
    seconds, paused_s : float
        Played, and waited for the phantom limb.
    score, misses : int
    by_phantom : int
        Points by the phantom limb; the others are the intact limb's.
    gain : float
        What joints' angles were multiplied by at the end.
    anomalies : tuple of Anomaly
        Times without a point though a target was in reach.
    limb : str
        The limb that was replaced.
    tracked : float or None
        Share of the frames in which the phantom limb was followed; None: there were none.
    """

    game: str
    difficulty: int
    seed: int
    ending: str
    seconds: float
    paused_s: float
    score: int
    misses: int
    by_phantom: int
    gain: float = 1.0
    anomalies: tuple[Anomaly, ...] = ()
    limb: str = ""
    tracked: float | None = None


@checked
class LiveSession:
    """Frames in, messages for the page out; the game goes by the frames' own times.

    The same frames, commands and seed give the same game. While the phantom limb is not
    ``tracking`` the game stands still: nothing can be hit and nothing is missed.

    Parameters
    ----------
    affected : {"left_arm", "right_arm", "left_leg", "right_leg"}
        The limb to replace.
    game : str
        Name out of `manip3d.phantom.games.GAMES`; by default one for that limb.
    difficulty : int
        1 to 3.
    seed : int
        Seed of the first game; each further game has the next number.
    jpeg_quality : int
        1 to 100.
    gain : float
        Virtual enhancement, 1 to 2: by how much the joints of both arms, or both legs, turn
        further from rest on the page, and in the games, than the patient turns them.
    recorder : Recorder, optional
        Is told of games, ratings of pain and sickness.

    Attributes
    ----------
    affected : str
    state : str
        `manip3d.modify.PhantomState` of the last frame.
    summaries : list of GameSummary
        Games that are over.

    Raises
    ------
    InputError
        An option is unknown or out of range.
    """

    def __init__(
        self,
        affected: Limb = "right_arm",
        *,
        game: str | None = None,
        difficulty: int = 1,
        seed: int = 0,
        jpeg_quality: int = 80,
        gain: float = 1.0,
        recorder: Recorder | None = None,
    ) -> None:
        self._recorder = recorder
        self._ask = ""
        self._halt = "", _now().date()
        self._sitting: Literal["open", "ending", "over"] = "open"
        self._last_said = _now()
        self._pain: int | None = None
        self._lowest: deque[tuple[int, float]] = deque()
        self._watch = AnomalyWatch()
        self._ring: ClipRing | None = None
        self._clips: list[Pictures] = []
        self._pipeline = PhantomPipeline(affected)
        self.affected = str(affected)
        self._people: list[Skeleton] = []
        self._numbers: dict[int, int] = {}  # of people, by the tracker's id
        self._chosen: int | None = None
        self._heard: dict[int, int] = {}  # last number of each page
        # Callbacks by page and number of the message, until it is kept; those of lost ones stay.
        self._waiting: dict[tuple[int, int], list[Callable[[], object]]] = {}
        self._events: deque[tuple[int, list[Any]]] = deque()  # when, and what is told
        self._num_events = 0
        self._ticks = 0
        self._times: deque[int] = deque(maxlen=_FRAMES)
        self._calibration: PlacementCalibration | None = None
        self._measured: Skeleton | None = None
        self._cue: TouchCue | None = None
        self._cues = 0
        self._felt = None if recorder is None else recorder.last_felt(self.affected)
        chosen = game or ("bubbles" if self.affected.endswith("arm") else "bubbles-legs")
        if chosen not in GAMES:
            raise InputError(f"game: expected one of {', '.join(GAMES)}, got {game!r}")
        for name, value, low, high in (
            ("difficulty", difficulty, 1, 3),
            ("seed", seed, 0, 2**62),
            ("jpeg_quality", jpeg_quality, 1, 100),
            ("gain", gain, 1, MOST_GAIN),
        ):
            if not low <= value <= high:
                raise InputError(f"{name}: expected {low:g} to {high:g}, got {value}")
        self._gain = float(gain)
        self.summaries: list[GameSummary] = []
        self._choice = chosen, int(difficulty)
        self._seed = seed
        self._quality = jpeg_quality
        self._body = ColliderTracker()
        self._ends = ColliderTracker()  # of hands or feet alone
        self._commands: queue.SimpleQueue[_Command] = queue.SimpleQueue()
        self._entry = threading.Lock()
        self._is_over = False
        self._sequence = 0
        self._last_time: int | None = None
        self.state = "lost"
        self._wants_game = False
        self._game: GameState | None = None
        self._paused_s = self._told_s = 0.0
        self._seen = Counter[bool]()  # frames of the game, by whether the limb was followed
        self._stages: dict[str, deque[float]] = {
            name: deque(maxlen=_FRAMES) for name in ("pipeline", "rules", "encode")
        }

    @property
    def sequence(self) -> int:
        """Number of the next message."""
        return self._sequence

    @property
    def stage_ms(self) -> dict[str, float]:
        """Mean times of the last frames by stage, milliseconds."""
        return {n: float(np.mean(t)) * 1e3 if t else 0.0 for n, t in self._stages.items()}

    def command(
        self,
        name: str,
        fields: Mapping[str, Any] | None = None,
        *,
        done: Callable[[], object] | None = None,
    ) -> None:
        """Take a message of a page, of `MESSAGES`; from any thread. The next frame obeys it.

        Parameters
        ----------
        name : str
        fields : mapping, optional
        done : callable, optional
            Called, from any thread, when the message was obeyed and what it says is on the disk of
            the recorder, if there is one; never where it is lost, nor for what comes after `end`.
            What a page says again, by its number, is not obeyed again, but answered once it is
            kept.

        Raises
        ------
        InputError
            No such message.
        """
        if name not in MESSAGES or name in OF_THE_CONNECTION:
            expected = ", ".join(known for known in MESSAGES if known not in OF_THE_CONNECTION)
            raise InputError(f"name: expected one of {expected}, got {name!r}")
        found = dict(fields or {})
        page, number = found.pop("page", 0), found.pop("number", None)
        with self._entry:
            if self._is_over:
                return
            if number is None:
                self._commands.put((name, found, done))
                return
            is_new = number > self._heard.get(page, 0)
            if is_new:
                self._expect(page, number)
                kept = functools.partial(self._answer, page, number)
                self._commands.put((name, found, kept))
            waiting = self._waiting.get((page, number))
            if waiting is not None and done is not None:
                waiting.append(done)
        if waiting is None and done is not None:  # said again, as the answer was lost
            done()

    def _expect(self, page: int, number: int) -> None:
        """Note that a page has said something that is not kept yet."""
        self._heard[page] = number
        self._waiting[page, number] = []
        while len(self._heard) > _PAGES:
            gone = next(iter(self._heard))
            del self._heard[gone]
            self._waiting = {key: told for key, told in self._waiting.items() if key[0] != gone}

    def _answer(self, page: int, number: int) -> None:
        """Tell all who wait for it that something is kept."""
        with self._entry:
            waiting = self._waiting.pop((page, number), ())
        for done in waiting:
            done()

    def restart(self) -> None:
        """Forget the person: the next frame is of another recording, or the same one again."""
        self._pipeline.reset()
        self._body.reset()
        self._ends.reset()
        self._lowest.clear()
        self._times.clear()
        self._events.clear()
        self._last_time = None

    def halt(self, reason: str) -> None:
        """Let no further game start; the page says why.

        Parameters
        ----------
        reason : str
            Words for the page; empty: nothing changes.
        """
        if reason:
            self._halt = reason, _now().date()

    def end(self) -> None:
        """Keep what was said, stop a game that goes on, and tell the recorder.

        No game begins any more, and what pages say from now on is not taken.
        """
        with self._entry:
            self._is_over = True
        self._obey(only=_NOT_LOST)
        self._note_unanswered()
        self._stop()

    def notice(self, message: str) -> bytes:
        """Return a message for the page when there is no frame, such as that the camera is gone.

        Parameters
        ----------
        message : str
            Words for the page.

        Returns
        -------
        bytes
        """
        self._obey()
        self.state = "lost"
        status = {"state": "lost", "reason": "no_frame", "message": self._told(message)}
        return self._encoded(None, status | self._game_status(playing=False), 0, time.time_ns())

    def process(self, frame: RgbdFrame, *, captured_ns: int | None = None) -> bytes | None:
        """The next frame as a message for the page.

        Parameters
        ----------
        frame : RgbdFrame
        captured_ns : int, optional
            When it came in, by `time.time_ns`; by default now. Cameras note it in
            `RgbdFrame.grabbed_ns`.

        Returns
        -------
        bytes or None
            None for a frame that is not newer than the one before.

        Raises
        ------
        InputError
            A calibration is out of range.
        """
        captured = time.time_ns() if captured_ns is None else int(captured_ns)
        began = time.perf_counter()
        shown = self._pipeline.process(frame)
        seen = time.perf_counter()
        shown = self._enhanced(shown)
        if shown.state == PhantomState.LATE:
            return None
        self.state = shown.state.value
        self._obey()
        seconds = self._seconds_since_last(frame.time)
        self._people = sorted(frame.skeletons, key=lambda one: float(one.positions[0][0]))
        self._times.append(frame.time)
        if self._calibration is not None and shown.state == PhantomState.TRACKING:
            measured = self._calibration.add(shown.skeleton)
            if measured is not None:
                self._measured, self._calibration = measured, None
        colliders = self._body.update(shown.skeleton)
        playing = self._play(shown, seconds)
        self._tell_of_game()
        if playing and self._ring is not None and self._game is not None:
            self._ring.add(shown, self._game, frame.calibration.depth, self._watch.since)
        status = (
            self._frame_status(shown, colliders)
            | self._setup_status(shown, frame)
            | self._touch_status(shown, seconds)
            | self._game_status(playing=playing)
        )
        ruled = time.perf_counter()
        message = self._encoded(shown, status, frame.time, captured)
        done = time.perf_counter()
        spent = (seen - began, ruled - seen, done - ruled)
        for times, value in zip(self._stages.values(), spent, strict=True):
            times.append(value)
        return message

    def _enhanced(self, shown: PhantomFrame) -> PhantomFrame:
        """The same person with further turned joints; the measured body is what is at rest."""
        if self._gain == 1.0 or len(shown.vertices) == 0:
            return shown
        names = _ENHANCED[self.affected.partition("_")[2]]
        gains = {f"{name}{side}": self._gain for name in names for side in ("Left", "Right")}
        found = repose(shown.vertices, shown.skeleton, gains=gains, rest=self._measured, threads=1)
        if found is None:
            return shown
        return replace(shown, vertices=found.vertices, skeleton=found.skeleton)

    # --- the game --------------------------------------------------------------------------------

    def _seconds_since_last(self, now: int) -> float:
        last, self._last_time = self._last_time, now
        if last is not None and now < last:  # the camera's clock began again
            for times in (self._lowest, self._events, self._times):
                times.clear()
        gap = 0.0 if last is None else (now - last) / 1e9
        return gap if 0.0 <= gap <= _LONGEST_STEP_S else 0.0

    def _obey(self, only: Sequence[str] = tuple(MESSAGES)) -> None:
        """Do what pages have said since the last frame."""
        while not self._commands.empty():
            name, fields, done = self._commands.get()
            if name not in only:
                continue
            if self._recorder is not None:
                self._recorder.begin_message()
            self._take(name, fields)
            if done is not None and self._recorder is not None:
                self._recorder.when_kept(done)
            elif done is not None:
                done()

    def _take(self, name: str, fields: Mapping[str, Any]) -> None:
        self._note_day()
        if name == "choose":
            self._choice = str(fields["game"]), int(fields["difficulty"])
        elif name == "ready":
            self._start_game()
        elif name == "stop":
            self._stop()
        elif name == "enough":
            self._end_sitting()
        elif name == "unanswered":
            self._note_unanswered()
        elif name == "again":
            if self._sitting == "over":  # "ending" waits for the last rating
                self._begin_sitting()
        elif name == "gain":
            self._gain = float(fields["value"])
        elif name in ("limb", "patient", "calibrate", "touch", "felt"):
            self._set_up(name, fields)
        elif self._recorder is not None:
            self._heed(name, fields)

    def _note_day(self) -> None:
        """On another day, after a rest, what was said before holds no longer."""
        now, (halt, day) = _now(), self._halt
        is_another_day = now.date() != (day if halt else self._last_said.date())
        if is_another_day and now - self._last_said > _REST:
            self._begin_sitting()
            self._halt = "", now.date()
        self._last_said = now

    def _begin_sitting(self) -> None:
        self._note_unanswered()
        self._stop()
        self._game, self._cue = None, None
        self._sitting, self._pain, self._ask = "open", None, ""
        if self._recorder is not None:
            self._recorder.open_session()

    def _end_sitting(self) -> None:
        """The patient has had enough; a last rating of the pain is asked for, where it is kept."""
        if self._sitting != "open":
            return
        self._stop()
        self._cue, self._ask = None, ""
        self._sitting = "over" if self._recorder is None else "ending"

    def _close_sitting(self, *, answered: bool) -> None:
        """The last rating was given, or the therapist says that there is none."""
        assert self._recorder is not None
        self._sitting = "over"
        self._recorder.close_session(answered=answered)

    def _note_unanswered(self) -> None:
        """The rating that was asked for at the end of a sitting comes no more."""
        if self._sitting == "ending":
            self._close_sitting(answered=False)

    @property
    def _halted(self) -> str:
        """Why nothing more is played today, or nothing; no midnight within a sitting ends it."""
        reason, day = self._halt
        now = _now()
        return reason if day == now.date() or now - self._last_said <= _REST else ""

    def _may_begin(self) -> bool:
        """Whether a game or a touch cue may begin; the page says why not."""
        if self._halted or self._sitting != "open":
            return False
        self._ask = "" if self._recorder is None else self._recorder.may_play()
        return not self._ask

    def _start_game(self) -> None:
        """The next frame of a tracked limb begins one, if nothing speaks against it."""
        if self._game is not None and self._game.phase != "over":
            return
        if self._may_begin():
            self._game, self._wants_game = None, True
            self._note_play()

    def _note_play(self) -> None:
        if self._recorder is not None:
            self._recorder.play_begins()

    def _stop(self) -> None:
        """End the game or the touch cue that goes on; questions about a cue that is over stay."""
        self._wants_game = False
        if self._cue is not None and not self._cue.is_over:
            self._cue = None
        if self._game is not None and self._game.phase == "playing":
            self._finish("stopped")
            self._game = replace(self._game, phase="over", targets=(), events=())

    def _heed(self, name: str, fields: Mapping[str, Any]) -> None:
        """What the patient says of themselves; may end the play for today."""
        assert self._recorder is not None
        if name == "pain":
            self._pain, self._ask = int(fields["value"]), ""
            halt = self._recorder.pain(self._pain)
            if self._sitting == "ending":
                self._close_sitting(answered=True)
        elif name == "unwell":
            halt = self._recorder.unwell()
        else:
            halt = ""
            self._note(name, fields)
        if halt:
            self._stop()
            self.halt(halt)
            self._cue = None

    def _note(self, name: str, fields: Mapping[str, Any]) -> None:
        assert self._recorder is not None
        if name == "event":
            self._recorder.event(str(fields["text"]))
        elif name == "consent":
            self._recorder.consent(bool(fields["clips"]))
            if not fields["clips"]:  # neither what comes nor what was filmed before
                self._ring, self._clips = None, [() for _ in self._clips]
        else:
            answers = [int(fields[f"q{number}"]) for number in range(1, len(STATEMENTS) + 1)]
            self._recorder.ownership(fields["mode"], answers)
            if self._cue is not None and self._cue.is_over:
                self._cue = None  # no screen asks again

    def _set_up(self, name: str, fields: Mapping[str, Any]) -> None:
        """What the therapist says before a game; a game that goes on is stopped by another limb or
        patient."""
        if name == "limb":
            self._change_limb(fields["limb"])
        elif name == "patient":
            # By number, not by place: people cross while the therapist points at one.
            known = {number: person for person, number in self._numbers.items()}
            if fields["which"] in known:
                self._stop()
                self._chosen = known[fields["which"]]
                self._pipeline.select(self._chosen)
        elif name == "calibrate":
            self._calibration, self._measured = PlacementCalibration(), None
        elif name == "touch":
            self._begin_cue(str(fields["mode"]))
        else:
            self._felt = FeltLimb(**{key: int(fields[key]) for key in LIMITS})
            if self._recorder is not None:
                self._recorder.felt(self._felt, self.affected)

    def _begin_cue(self, mode: str) -> None:
        """Begin a minute of touches in place of what goes on, or none (``off``)."""
        if mode == "off":
            self._stop()
            self._cue = None
        elif self._may_begin():
            self._stop()
            self._cue = TouchCue(mode, self._seed + self._cues)  # type: ignore[arg-type]
            self._cues += 1
            self._note_play()

    def _change_limb(self, limb: Limb) -> None:
        if limb == self.affected:
            return
        self._stop()
        self._game, self._measured, self._cue = None, None, None
        self._pipeline, self.affected = PhantomPipeline(limb), str(limb)
        self._felt = None if self._recorder is None else self._recorder.last_felt(self.affected)
        self.restart()
        if self._chosen is not None:
            self._pipeline.select(self._chosen)
        if not GAMES[self._choice[0]].limbs.startswith(limb.partition("_")[2]):
            name = "bubbles" if limb.endswith("arm") else "bubbles-legs"
            self._choice = name, self._choice[1]

    def _play(self, shown: PhantomFrame, seconds: float) -> bool:
        """Whether the game went on in this frame."""
        if self._game is not None and self._game.phase == "playing":
            self._seen[shown.state == PhantomState.TRACKING] += 1
        if shown.state != PhantomState.TRACKING:
            self._ends.reset()  # what moves while nothing counts is swept over by nobody
            if self._game is not None and self._game.phase == "playing":
                self._paused_s += seconds
            return False
        floor = self._floor(shown)
        if self._wants_game:
            name, difficulty = self._choice
            seed = self._seed + len(self.summaries)
            body = shown.skeleton
            if self._measured is not None:
                body = moved_to(self._measured, body)
            self._cue = None
            self._game = begin(name, body, difficulty=difficulty, seed=seed, floor=floor)
            if self._game is None:  # somebody who faces the camera is asked for
                return False
            self._wants_game, self._paused_s, self._told_s = False, 0.0, 0.0
            self._seen.clear()
            self._watch = AnomalyWatch()
            wanted = self._recorder is not None and self._recorder.wants_clips
            self._ring, self._clips = ClipRing() if wanted else None, []
        if self._game is None or self._game.phase == "over":
            return False
        self._ends.update(_ends_of(shown.skeleton, self._game))
        self._game = step(self._game, seconds, self._touched, shown.skeleton)
        self._watch.update(self._game)
        self._keep_clips()
        if self._game.phase == "over":
            self._finish(self._game.ending)
        return True

    def _keep_clips(self) -> None:
        """Store the recorded frames of each anomaly that has ended."""
        for anomaly in self._watch.found[len(self._clips) :]:
            ring = self._ring
            self._clips.append(() if ring is None else ring.take(anomaly.start, anomaly.end))

    def _floor(self, shown: PhantomFrame) -> float | None:
        """The lowest place (the largest y) of a foot in the last seconds."""
        skeleton = shown.skeleton
        feet = [float(skeleton.positions[j][1]) for j in _FEET if skeleton.states[j] != NOT_TRACKED]
        now = self._last_time or 0
        if feet:
            self._lowest.append((now, max(feet)))
        while self._lowest and now - self._lowest[0][0] > _FLOOR_S * 1e9:
            self._lowest.popleft()
        return max((y for _, y in self._lowest), default=None)

    def _touched(
        self, start: NDArray[np.float32], end: NDArray[np.float32], radius: NDArray[np.float32]
    ) -> NDArray[np.int8]:
        return self._ends.hits(start, end, radius=radius).bone

    def _finish(self, ending: str) -> None:
        self._watch.finish()
        self._keep_clips()
        summary = self._summary(ending)
        self.summaries.append(summary)
        if self._recorder is not None:
            self._recorder.game(summary, tuple(self._clips))
        self._ring, self._clips = None, []

    def _tell_of_game(self) -> None:
        """A game that goes on is kept as it begins and every ten seconds."""
        if self._recorder is None or self._game is None or self._game.phase != "playing":
            return
        if self._game.clock + self._paused_s >= self._told_s:
            self._told_s += _TELL_S
            self._recorder.game_goes_on(self._summary("interrupted"))

    def _summary(self, ending: str) -> GameSummary:
        game, total = self._game, self._seen.total()
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
            gain=self._gain,
            anomalies=tuple(self._watch.found),
            limb=self.affected,
            tracked=round(self._seen[True] / total, 3) if total else None,
        )

    def _by_phantom(self, game: GameState) -> int:
        own = bones_of(game.game.limbs, self.affected.partition("_")[0])
        if not self.affected.endswith(game.game.limbs[:-1]):  # a game for the other limbs
            return 0
        return sum(number for bone, number in game.by_bone.items() if bone in own)

    # --- what the page shows ---------------------------------------------------------------------

    def _encoded(
        self, shown: PhantomFrame | None, status: Mapping[str, Any], frame_time: int, captured: int
    ) -> bytes:
        message = encode_frame(
            shown,
            status,
            sequence=self._sequence,
            time_ns=frame_time,
            captured_ns=captured,
            jpeg_quality=self._quality,
        )
        self._sequence = (self._sequence + 1) % 2**32
        return message

    def _told(self, message: str) -> str:
        """What the page says: what is to be done first, how the limb is followed, what is not kept
        in the diary."""
        trouble = "" if self._recorder is None else self._recorder.trouble
        return " ".join(part for part in (self._ask, message, trouble) if part)

    def _frame_status(self, shown: PhantomFrame, colliders: BodyColliders) -> dict[str, Any]:
        skeleton = shown.skeleton
        capsules = np.concatenate(
            [colliders.start, colliders.end, colliders.radius[:, None]], axis=1, dtype=np.float64
        )
        torso = None
        if colliders.torso_half_size.max() > 0:
            torso = {
                "centre": _rounded(colliders.torso_centre),
                "axes": _rounded(colliders.torso_axes.T),
                "half": _rounded(colliders.torso_half_size),
            }
        return {
            "state": shown.state.value,
            "reason": shown.reason.value,
            "message": self._told(shown.message),
            "visible": round(shown.visible, 3),
            "score": round(min(shown.quality.score, 1e6), 3),
            "joints": _rounded(skeleton.positions),
            "joint_states": skeleton.states.tolist(),
            "colliders": _rounded(capsules),
            "torso": torso,
            "stage_ms": {name: round(value, 2) for name, value in self.stage_ms.items()},
        }

    def _setup_status(self, shown: PhantomFrame, frame: RgbdFrame) -> dict[str, Any]:
        people = self._people
        span = (self._times[-1] - self._times[0]) / 1e9 if len(self._times) > 30 else 0.0
        checks = placement_checks(
            shown,
            frame.calibration.depth,
            people=len(people),
            is_chosen=self._chosen is not None,
            rate=(len(self._times) - 1) / span if span > 0 else 0.0,
        )
        calibrated = 1.0 if self._measured is not None else None
        if self._calibration is not None:
            calibrated = round(self._calibration.share, 2)
        return {
            "affected": self.affected,
            "gain": self._gain,
            "checks": [[check.name, check.is_met, check.advice] for check in checks],
            "people": [[self._number(one.id), one.id == shown.skeleton.id] for one in people],
            "calibrated": calibrated,
            "felt_as": None if self._felt is None else vars(self._felt),
            "clips": None if self._recorder is None else self._recorder.wants_clips,
        }

    def _number(self, person: int) -> int:
        """Small numbers for people in view, as they come; a tracker's ids may have 64 bits."""
        if person not in self._numbers:
            self._numbers[person] = max(self._numbers.values(), default=0) + 1
            while len(self._numbers) > _PAGES:
                del self._numbers[next(iter(self._numbers))]
        return self._numbers[person]

    def _touch_status(self, shown: PhantomFrame, seconds: float) -> dict[str, Any]:
        felt = None
        if self._felt is not None:
            places = felt_places(self._felt, shown.skeleton, self.affected)
            felt = None if places is None else _rounded(places)
        cue = self._cue
        if cue is None:
            return {"touch": None, "felt": felt}
        joint, is_felt, place = None, False, None
        side, _, limb = self.affected.partition("_")
        names = ARM if limb == "arm" else LEG
        if shown.state == PhantomState.TRACKING and not cue.is_over:
            joint, is_felt = cue.pass_time(seconds)
            self._ticks += is_felt
        if joint is not None:
            place = _rounded(shown.skeleton.positions[JOINTS.index(names[joint] + side.title())])
        due = cue.due
        return {
            "touch": {
                "mode": cue.mode,
                "left_s": round(SECONDS - cue.clock, 2),
                "place": place,
                "felt": is_felt,
                "ticks": self._ticks,
                "due": due and [round(due.felt - cue.clock, 3), names[due.joint].lower()],
            },
            "felt": felt,
        }

    def _game_status(self, *, playing: bool) -> dict[str, Any]:
        about = {
            "halt": self._halted,
            "ask": self._ask,
            "pain": self._pain,
            "sitting": self._sitting,
        }
        return {"game": self._shown_game(playing) | about}

    def _shown_game(self, playing: bool) -> dict[str, Any]:
        game, (chosen, difficulty) = self._game, self._choice
        if game is None:
            phase = "starting" if self._wants_game else "waiting"
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
            "radius": game.game.radius,
            **_field_status(game),
            "targets": [[t.number, *_rounded(t.place)] for t in game.targets],
            "stains": [_rounded(place) for place in game.stains],
            "events": self._told_events(game if playing else None),
        }
        if game.phase == "over":
            found["ending"] = self.summaries[-1].ending
            found["paused_s"] = self.summaries[-1].paused_s
        return found

    def _told_events(self, game: GameState | None) -> list[list[Any]]:
        """Events of the last second, each with a number, so that a page that leaves frames out
        misses none and plays none twice."""
        now = self._last_time or 0
        for event in () if game is None else game.events:
            self._num_events += 1
            told = [event.kind, event.number, event.bone, *_rounded(event.place), event.key]
            self._events.append((now, [*told, self._num_events]))
        while self._events and now - self._events[0][0] > _EVENTS_NS:
            self._events.popleft()
        return [told for _, told in self._events]


def _now() -> datetime:
    return datetime.now().astimezone()


def _field_status(game: GameState) -> dict[str, Any]:
    """What stands around the player."""
    field = game.field
    if isinstance(field, PianoField):
        up = game.targets[0].key if game.targets else -1
        return {"keys": [_rounded(place) for _, place in keys_of(field)], "up": up}
    if isinstance(field, PedalField):
        strokes = game.game.strokes[game.difficulty - 1]
        starts = (*field.lefts, *field.rights)
        disks = [_rounded((x, y - field.rise, z)) for x, y, z in starts]
        return {"disks": disks, "starts": [_rounded(place) for place in starts],
                "strokes": [foot.moves / 2 for foot in game.feet], "needed": strokes}  # fmt: skip
    assert isinstance(field, ArmField)
    return {"ceiling": field.lefts[0][1] - field.rise}


def _rounded(values: Any) -> Any:
    """Nested lists of numbers to a tenth of a millimetre; JSON has no others than finite ones."""
    return (np.rint(np.nan_to_num(np.asarray(values, np.float64)) * 1e4) / 1e4).tolist()


def _ends_of(skeleton: Skeleton, game: GameState) -> Skeleton:
    """The same person with hands or feet alone."""
    kept = [*bones_of(game.game.limbs, "left"), *bones_of(game.game.limbs, "right")]
    states = np.full(25, NOT_TRACKED, np.uint8)
    states[kept] = skeleton.states[kept]
    return Skeleton(skeleton.positions, skeleton.orientations, states, skeleton.id, skeleton.body)
