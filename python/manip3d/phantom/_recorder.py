"""The interface between a session and its diary."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from manip3d._util.reprs import short_repr
from manip3d.phantom._anomalies import Anomaly
from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._touch import Mode

Pictures = Sequence[tuple[float, bytes]]


@runtime_checkable
class Recorder(Protocol):
    """Stores the entries of a session; `DiaryRecorder` is the implementation."""

    @property
    def wants_clips(self) -> bool:
        """Whether the patient consented to short films of anomalies."""

    @property
    def trouble(self) -> str:
        """Sentence on entries that are not stored yet, and why; empty if there are none."""

    def game_goes_on(self, summary: GameSummary) -> None:
        """Store the state of the current game in case the program is killed; `game` replaces it."""

    def game(self, summary: GameSummary, clips: Sequence[Pictures]) -> None:
        """Store a game that is over.

        ``clips``: pictures of each anomaly (time of play in seconds, JPEG image), which may be
        empty.
        """

    def may_play(self) -> str:
        """Return why no game may start yet, for the patient; empty: games may."""

    def play_begins(self) -> None:
        """Note that a game or touch cue begins: later ratings of the pain are "after"."""

    def pain(self, value: int) -> str:
        """Store a rating from 0 to 10; return why the session must stop, or an empty text."""

    def unwell(self) -> str:
        """Store that the patient feels sick; return why the session must stop."""

    def event(self, text: str) -> None:
        """Store an adverse event."""

    def consent(self, clips: bool) -> None:
        """Store whether the patient consents to films; without consent all films are deleted."""

    def ownership(self, mode: Mode, answers: Sequence[int]) -> None:
        """Store the answers after a touch cue."""

    def felt(self, felt: FeltLimb, limb: str) -> None:
        """Store the patient's description of the felt phantom limb."""

    def last_felt(self, limb: str) -> FeltLimb | None:
        """Return the patient's last description of the felt phantom limb."""

    def close_session(self, *, answered: bool = True) -> None:
        """End the sitting; a second call changes nothing.

        ``answered``: whether the patient gave the rating that was asked for at the end.
        """

    def open_session(self) -> None:
        """Begin another sitting, with a first rating of its own; an open one is closed."""

    def begin_message(self) -> None:
        """Begin a group of entries, for which `when_kept` waits."""

    def when_kept(self, done: Callable[[], object]) -> None:
        """Call ``done`` when all entries since `begin_message` are on the disk, from any thread.

        It is not called if one of these entries is lost.
        """


@dataclass(frozen=True)
class GameSummary:
    """Result of a game that is over, or the state of the current one.

    Attributes
    ----------
    game : str
        Key of `manip3d.phantom.games.GAMES`.
    difficulty, seed : int
        Options of the game.
    ending : str
        ``time``, ``misses``, ``done`` or ``stopped``; ``interrupted``: the game is running.
    seconds, paused_s : float
        Time of play, and time of waiting for the phantom limb, seconds.
    score, misses : int
        Numbers of points and of misses.
    by_phantom : int
        Points made by the phantom limb; the intact limb made the others.
    gain : float
        Factor of joint angles (virtual enhancement) at the end; 1 in a game for other limbs than
        the replaced one.
    anomalies : tuple of Anomaly
        Times without a point despite a target in reach.
    limb : str
        The limb that was replaced.
    tracked : float or None
        Share of the frames in which the phantom limb was tracked; None: there were no frames.
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

    __repr__ = short_repr
