"""The interface between a session and its diary."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

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
        """Keep a game that is over; for each anomaly its pictures (seconds of play, JPEG), or
        none."""

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
        """Store the patient's description of a limb as it is felt."""

    def last_felt(self, limb: str) -> FeltLimb | None:
        """Return the patient's last description of a limb as it is felt."""

    def close_session(self, *, answered: bool = True) -> None:
        """The patient has had enough: the sitting is over; a second call changes nothing.

        ``answered``: whether the patient gave the rating that was asked for at the end."""

    def open_session(self) -> None:
        """Begin another sitting, with a first rating of its own; an open one is closed."""

    def begin_message(self) -> None:
        """Begin a group of entries, for which `when_kept` waits."""

    def when_kept(self, done: Callable[[], object]) -> None:
        """Call something as soon as all that was told since `begin_message` is on the disk; from
        any thread. It is not called where any of that cannot be kept."""


@dataclass(frozen=True)
class GameSummary:
    """Result of a game that is over, or the state of the current one.

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
