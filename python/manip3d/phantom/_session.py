"""`LiveSession`: turns frames of a camera and messages of pages into messages for the page."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.times import NOMINAL_PERIOD_NS
from manip3d.errors import InputError
from manip3d.modify import (
    ColliderTracker,
    Limb,
    PhantomPipeline,
    PhantomReason,
    PhantomState,
    repose,
)
from manip3d.phantom._felt import LIMITS, FeltLimb, felt_places
from manip3d.phantom._level import Level
from manip3d.phantom._messages import MAX_GAIN, MESSAGES, NOT_LOST, Inbox
from manip3d.phantom._play import LONGEST_STEP_S, Play, rounded
from manip3d.phantom._recorder import GameSummary, Recorder
from manip3d.phantom._setup import PlacementCalibration, placement_checks
from manip3d.phantom._sitting import Sitting
from manip3d.phantom._touch import ARM, LEG, SECONDS, STATEMENTS, TouchCue
from manip3d.phantom.games import GAMES
from manip3d.rgbd import JOINTS, NOT_TRACKED, RgbdFrame, Skeleton
from manip3d.serve import encode_frame

if TYPE_CHECKING:
    from manip3d.modify import BodyColliders, PhantomFrame

_ENHANCED = {"arm": ("Shoulder", "Elbow"), "leg": ("Hip", "Knee", "Ankle")}
NO_SKELETON = "There is no skeleton in this source: use --pose."
NO_COLOR = "The source has no colour images, in which --pose would find the joints."
_PEOPLE = 64  # number of people whose numbers are remembered
_FRAMES = 90  # number of frames over which times of stages are averaged


@checked
class LiveSession:
    """Turns each frame into a message for the page; the game's time is that of the frames.

    The same frames, commands and seed give the same game. Where the frames' clock begins again, the
    time that passed is that of their arrivals (``captured_ns``). While the phantom limb is not
    ``tracking``, and in gaps of more than 0.25 s between frames, the game is paused: nothing can be
    hit and nothing is missed.

    Games and page use level axes: x right, y down along the vertical, z ahead, the camera at the
    origin (`manip3d.modify.PhantomFrame.levelled`). They are those of the camera unless it is
    tilted by a degree or more. While a game is on, the vertical stays the same.

    Parameters
    ----------
    affected : {"left_arm", "right_arm", "left_leg", "right_leg"}
        The limb to replace.
    game : str
        Key of `manip3d.phantom.games.GAMES`; default: a game for that limb.
    difficulty : int
        Difficulty of the game, 1 to 3.
    seed : int
        Seed of the first game; each further game has the next number.
    jpeg_quality : int
        JPEG quality of colour images, 1 to 100.
    gain : float
        Virtual enhancement, 1 to 2: factor by which the page and the games enlarge the angles from
        rest of the joints of both arms or both legs.
    recorder : Recorder, optional
        Receiver of games, ratings of pain and reports of sickness.
    pose : bool
        The joints of the frames are found in their colour images, as `PoseTracker` does. If there
        are none, the page then says that nobody is in view, or that there is no colour.

    Attributes
    ----------
    affected : str
        The limb that is replaced.
    state : str
        `manip3d.modify.PhantomState` of the last frame.

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
        pose: bool = False,
    ) -> None:
        game_key = game or _game_for(affected)
        if game_key not in GAMES:
            raise InputError(f"game: expected one of {', '.join(GAMES)}, got {game!r}")
        for name, value, low, high in (
            ("difficulty", difficulty, 1, 3),
            ("seed", seed, 0, 2**62),
            ("jpeg_quality", jpeg_quality, 1, 100),
            ("gain", gain, 1, MAX_GAIN),
        ):
            if not low <= value <= high:
                raise InputError(f"{name}: expected {low} to {high}, got {value}")
        self._pipeline = PhantomPipeline(affected)
        self.affected = str(affected)
        self.state = "lost"
        self._recorder = recorder
        self._finds_joints = pose
        self._has_color = False  # whether any frame so far had a colour image
        self._inbox = Inbox()
        self._sitting = Sitting(recorder)
        self._play = Play((game_key, int(difficulty)), seed, self.affected, float(gain), recorder)
        self._people: list[Skeleton] = []
        self._numbers: dict[int, int] = {}  # number of each person, by the tracker's id
        self._chosen: int | None = None  # the tracker's id of the person that a page chose
        self._calibration: PlacementCalibration | None = None
        self._measured: Skeleton | None = None  # the person as the calibration measured them
        self._level = Level()
        self._body = ColliderTracker()
        self._cue: TouchCue | None = None
        self._seed = seed  # of the first touch cue; each further one adds 1
        self._cues = 0  # touch cues that began
        self._ticks = 0  # touches that were due in them
        # The patient's last description of the felt phantom limb.
        self._felt = None if recorder is None else recorder.last_felt(self.affected)
        self._quality = jpeg_quality
        self._sequence = 0
        self._frame_time: int | None = None  # of the last frame, and as the session counts it
        self._last_time: int | None = None
        self._last_captured = 0  # arrival of the last frame
        self._times: deque[int] = deque(maxlen=_FRAMES)
        self._stages: dict[str, deque[float]] = {
            name: deque(maxlen=_FRAMES) for name in ("pipeline", "rules", "encode")
        }

    @property
    def summaries(self) -> list[GameSummary]:
        """Games that are over."""
        return self._play.summaries

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
        """Queue a message of a page for the next frame; may be called from any thread.

        Parameters
        ----------
        name : str
            Key of `MESSAGES`.
        fields : mapping, optional
            Fields of the message.
        done : callable, optional
            Called, from any thread, when the message was handled and, with a recorder, its entries
            are on the disk. Never called if an entry is lost, nor after `end`. A repeated message
            (with the same number) is not handled again, but ``done`` is called.

        Raises
        ------
        InputError
            No such message.
        """
        self._inbox.put(name, fields, done)

    def restart(self) -> None:
        """Discard data about the person, before another recording or a repetition.

        The therapist's choice of the patient stays.
        """
        self._pipeline.reset()
        if self._chosen is not None:  # the reset also drops the choice
            self._pipeline.select(self._chosen)
        self._body.reset()
        self._play.forget_times()
        self._times.clear()
        self._frame_time = self._last_time = None

    def halt(self, reason: str) -> None:
        """Prevent further games; the page shows the reason.

        Parameters
        ----------
        reason : str
            Sentence for the page; empty: nothing changes.
        """
        self._sitting.halt(reason)

    def end(self) -> None:
        """Handle the queued messages, stop the current game, and close the recorder's session.

        Further games do not begin, and further messages are refused.
        """
        self._inbox.close()
        self._obey(only=NOT_LOST)
        self._sitting.note_unanswered()
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
        """Process the next frame, and return a message for the page.

        Parameters
        ----------
        frame : RgbdFrame
        captured_ns : int, optional
            Time of the frame's arrival, as of `time.time_ns`; default: now. Cameras store it in
            `RgbdFrame.grabbed_ns`.

        Returns
        -------
        bytes or None
            None: the frame is not newer than the previous one.

        Raises
        ------
        InputError
            A calibration is out of range.
        """
        captured = time.time_ns() if captured_ns is None else int(captured_ns)
        began = time.perf_counter()
        shown = self._pipeline.process(frame)
        self._has_color = self._has_color or frame.color is not None
        if self._finds_joints and self._has_color:
            shown = _without_advice_to_find_joints(shown)
        seen = time.perf_counter()
        shown = self._enhanced(shown)
        if shown.state == PhantomState.LATE:
            return None
        self.state = shown.state.value
        self._obey()
        now = self._time_of(frame)
        seconds = self._seconds_since_last(now, captured)
        self._people = sorted(frame.skeletons, key=lambda one: float(one.positions[0][0]))
        self._times.append(now)
        if self._calibration is not None and shown.state == PhantomState.TRACKING:
            found = self._calibration.add(shown.skeleton, now)
            if found is not None:
                self._measured, self._calibration = found, None
        level = self._levelled(shown)
        colliders = self._body.update(level.skeleton)
        if self._play.is_wanted and shown.state == PhantomState.TRACKING:
            self._cue = None
        measured = self._measured and self._level.skeleton(self._measured)
        playing = self._play.go_on(level, seconds, now, measured)
        self._play.tell()
        if playing:
            self._play.film(shown, frame.calibration.depth, self._level)
        status = (
            self._frame_status(level, colliders)
            | self._setup_status(shown, level.skeleton, frame)
            | self._touch_status(level, seconds if seconds <= LONGEST_STEP_S else 0.0)
            | self._game_status(playing=playing)
        )
        ruled = time.perf_counter()
        message = self._encoded(level, status, frame.time_ns, captured)
        done = time.perf_counter()
        spent = (seen - began, ruled - seen, done - ruled)
        for times, value in zip(self._stages.values(), spent, strict=True):
            times.append(value)
        return message

    def _enhanced(self, shown: PhantomFrame) -> PhantomFrame:
        """Return the person with joint angles, relative to the rest pose, times the gain."""
        gain = self._play.gain
        if gain == 1.0 or len(shown.vertices) == 0:
            return shown
        names = _ENHANCED[self.affected.partition("_")[2]]
        gains = {f"{name}{side}": gain for name in names for side in ("Left", "Right")}
        found = repose(shown.vertices, shown.skeleton, gains=gains, rest=self._measured, threads=1)
        if found is None:
            return shown
        return replace(shown, vertices=found.vertices, skeleton=found.skeleton)

    def _levelled(self, shown: PhantomFrame) -> PhantomFrame:
        """Return the person in level axes, whose vertical does not change during a game."""
        if not self._play.has_game and self._level.follow(shown):
            self._body.reset()
            self._play.forget_places()
        return self._level.frame(shown)

    # --- messages of pages -----------------------------------------------------------------------

    def _time_of(self, frame: RgbdFrame) -> int:
        before, self._frame_time = self._frame_time, frame.time_ns
        if frame.time_ns == 0 == before:  # no clock: 30 frames a second, as for the pipeline
            return (self._last_time or 0) + NOMINAL_PERIOD_NS
        return frame.time_ns

    def _seconds_since_last(self, now: int, captured: int) -> float:
        """Return the time since the previous frame, with an outage of the camera between them."""
        (last, last_captured), self._last_time = (self._last_time, self._last_captured), now
        self._last_captured = captured
        if last is None:
            return 0.0
        if now < last:  # the camera's clock began again, and only the arrival tells the time
            self._times.clear()
            self._play.forget_times()
            return max(0.0, (captured - last_captured) / 1e9)
        return (now - last) / 1e9

    def _obey(self, only: Sequence[str] = tuple(MESSAGES)) -> None:
        """Handle the messages of pages since the last frame."""
        for name, fields, done in self._inbox.taken():
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
        if self._sitting.hear():
            self._begin_sitting()
        if name == "choose":
            self._play.choice = str(fields["game"]), int(fields["difficulty"])
        elif name == "ready":
            self._start_game()
        elif name == "stop":
            self._stop()
        elif name == "enough":
            self._end_sitting()
        elif name == "unanswered":
            self._sitting.note_unanswered()
        elif name == "again":
            if self._sitting.state == "over":  # "ending" waits for the last rating
                self._begin_sitting()
        elif name == "gain":
            self._play.gain = float(fields["value"])
        elif name in ("limb", "patient", "calibrate", "touch", "felt"):
            self._set_up(name, fields)
        elif self._recorder is not None:
            self._heed(name, fields)

    def _begin_sitting(self) -> None:
        self._sitting.note_unanswered()
        self._stop()
        self._play.game, self._cue = None, None
        self._sitting.begin()

    def _end_sitting(self) -> None:
        """End the sitting at the patient's wish."""
        if self._sitting.state != "open":
            return
        self._stop()
        self._cue = None
        self._sitting.end()

    def _start_game(self) -> None:
        """Begin a game with the next frame of a tracked limb, if it is allowed."""
        if not self._play.has_game and self._sitting.may_begin():
            self._play.want()
            self._sitting.note_play()

    def _stop(self) -> None:
        """End the current game or touch cue; questions about a cue that is over stay."""
        if self._cue is not None and not self._cue.is_over:
            self._cue = None
        self._play.stop()

    def _heed(self, name: str, fields: Mapping[str, Any]) -> None:
        """Handle a message about the patient; it may end play for today."""
        assert self._recorder is not None
        if name == "pain":
            halt = self._sitting.rate(int(fields["value"]))
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
            if not fields["clips"]:
                self._play.drop_films()
        else:
            answers = [int(fields[f"q{number}"]) for number in range(1, len(STATEMENTS) + 1)]
            self._recorder.ownership(fields["mode"], answers)
            if self._cue is not None and self._cue.is_over:
                self._cue = None  # the questions are not shown again

    def _set_up(self, name: str, fields: Mapping[str, Any]) -> None:
        """Handle the therapist's settings; another limb or patient stops the current game."""
        if name == "limb":
            self._change_limb(fields["limb"])
        elif name == "patient":
            # Choose by number and not by position, because people move while the therapist chooses.
            known = {number: person for person, number in self._numbers.items()}
            if fields["which"] in known:
                self._choose_patient(known[fields["which"]])
        elif name == "calibrate":
            self._calibration, self._measured = PlacementCalibration(), None
        elif name == "touch":
            self._begin_cue(str(fields["mode"]))
        else:
            self._felt = FeltLimb(**{key: int(fields[key]) for key in LIMITS})
            if self._recorder is not None:
                self._recorder.felt(self._felt, self.affected)

    def _choose_patient(self, person: int) -> None:
        self._stop()
        if self._measured is not None and self._measured.id != person:
            self._measured = None  # measures of another body do not fit
        self._chosen = person
        self._pipeline.select(person)

    def _begin_cue(self, mode: str) -> None:
        """End the current game or cue; begin a minute of touches unless the mode is ``off``."""
        if mode == "off":
            self._stop()
            self._cue = None
        elif self._sitting.may_begin():
            self._stop()
            self._cue = TouchCue(mode, self._seed + self._cues)  # type: ignore[arg-type]
            self._cues += 1
            self._sitting.note_play()

    def _change_limb(self, limb: Limb) -> None:
        if limb == self.affected:
            return
        self._stop()
        self._play.game, self._measured, self._cue = None, None, None
        self._pipeline, self.affected = PhantomPipeline(limb), str(limb)
        self._play.limb = self.affected
        self._felt = None if self._recorder is None else self._recorder.last_felt(self.affected)
        self.restart()
        name, difficulty = self._play.choice
        if not GAMES[name].limbs.startswith(limb.partition("_")[2]):
            self._play.choice = _game_for(limb), difficulty

    # --- the message for the page ----------------------------------------------------------------

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

    def _told(self, *messages: str) -> str:
        """Return the sentences of the page: next instruction, messages, trouble of the diary."""
        trouble = "" if self._recorder is None else self._recorder.trouble
        return " ".join(part for part in (self._sitting.ask, *messages, trouble) if part)

    def _frame_status(self, shown: PhantomFrame, colliders: BodyColliders) -> dict[str, Any]:
        skeleton = shown.skeleton
        capsules = np.concatenate(
            [colliders.start, colliders.end, colliders.radius[:, None]], axis=1, dtype=np.float64
        )
        torso = None
        if colliders.torso_half_size.max() > 0:
            torso = {
                "centre": rounded(colliders.torso_centre),
                "axes": rounded(colliders.torso_axes.T),
                "half": rounded(colliders.torso_half_size),
            }
        message = shown.message
        if shown.reason == PhantomReason.NO_SKELETON:
            message = NO_COLOR if self._finds_joints else NO_SKELETON
        return {
            "state": shown.state.value,
            "reason": shown.reason.value,
            "message": self._told(message, self._play.advice),
            "visible": round(shown.visible, 3),
            "score": round(min(shown.quality.score, 1e6), 3),
            "joints": rounded(skeleton.positions),
            "joint_states": skeleton.states.tolist(),
            "down": rounded(self._level.down),
            "colliders": rounded(capsules),
            "torso": torso,
            "stage_ms": {name: round(value, 2) for name, value in self.stage_ms.items()},
        }

    def _setup_status(
        self, shown: PhantomFrame, body: Skeleton, frame: RgbdFrame
    ) -> dict[str, Any]:
        people = self._people
        span = (self._times[-1] - self._times[0]) / 1e9 if len(self._times) > 30 else 0.0
        checks = placement_checks(
            shown,
            body,
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
            "gain": self._play.gain,
            "checks": [[check.name, check.is_met, check.advice] for check in checks],
            "people": [[self._number(one.id), one.id == shown.skeleton.id] for one in people],
            "calibrated": calibrated,
            "felt_as": None if self._felt is None else vars(self._felt),
            "clips": None if self._recorder is None else self._recorder.wants_clips,
        }

    def _number(self, person: int) -> int:
        """Return the number of a person in view, counted from 1; tracker ids may have 64 bits."""
        if person not in self._numbers:
            self._numbers[person] = max(self._numbers.values(), default=0) + 1
            while len(self._numbers) > _PEOPLE:
                del self._numbers[next(iter(self._numbers))]
        return self._numbers[person]

    def _touch_status(self, shown: PhantomFrame, seconds: float) -> dict[str, Any]:
        felt = None
        if self._felt is not None:
            places = felt_places(self._felt, shown.skeleton, self.affected)
            felt = None if places is None else rounded(places)
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
            name = _seen_joint(names[: joint + 1], side, shown.skeleton)
            place = rounded(shown.skeleton.positions[JOINTS.index(name + side.title())])
        due = cue.due
        touched = due and _seen_joint(names[: due.joint + 1], side, shown.skeleton)
        return {
            "touch": {
                "mode": cue.mode,
                "left_s": round(SECONDS - cue.clock, 2),
                "place": place,
                "felt": is_felt,
                "ticks": self._ticks,
                "due": due and touched and [round(due.felt - cue.clock, 3), touched.lower()],
            },
            "felt": felt,
        }

    def _game_status(self, *, playing: bool) -> dict[str, Any]:
        shown = self._play.shown(self._last_time or 0, playing=playing)
        return {"game": shown | self._sitting.shown()}


def _seen_joint(names: Sequence[str], side: str, skeleton: Skeleton) -> str:
    """Return the last of a limb's joints that is tracked; the first if none is.

    Trackers with the joints of COCO see neither hands nor feet.
    """
    seen = [n for n in names if skeleton.states[JOINTS.index(n + side.title())] != NOT_TRACKED]
    return seen[-1] if seen else names[0]


def _without_advice_to_find_joints(shown: PhantomFrame) -> PhantomFrame:
    """Return the frame of a source whose joints are looked for: none were found in this frame."""
    if shown.reason != PhantomReason.NO_SKELETON:
        return shown
    return replace(shown, reason=PhantomReason.NO_JOINTS)


def _game_for(limb: str) -> str:
    return "bubbles" if limb.endswith("arm") else "bubbles-legs"
