"""What a live session writes into a diary."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._session import GameSummary, Pictures

if TYPE_CHECKING:
    from manip3d.diary import DiaryGame

RATE_FIRST = "Please say first how strong the pain is now; then the game can start."


class DiaryRecorder:
    """A session of a participant; each game and rating is on the disk when its method returns.

    Attributes
    ----------
    limb : str
        The affected one, as enrolled.

    Raises
    ------
    InputError
        No such participant.
    FormatError, OSError
        No such diary, or one of another key.
    MissingExtraError
        SQLAlchemy is not installed.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        participant: str,
        key: str | os.PathLike[str] | None,
        source: str = "",
    ) -> None:
        from manip3d.diary import Diary

        self._diary = Diary(path, key=key)
        person = self._diary.participant(participant)
        self._participant, self._wants_clips = person.identifier, person.clips
        self.limb = person.limb
        self._source = source if source.startswith("sim:") else "".join(source.partition(":")[:2])
        self._latency: Callable[[], float | None] | None = None
        self._session: int | None = None
        self._row: int | None = None  # of the game that goes on
        self._has_begun = self._is_rated = False

    def start(self, latency: Callable[[], float | None] | None = None) -> str:
        """The page is there; return why the patient must not play any more today, or nothing.

        ``latency``: gives milliseconds to the page, if they are known by now.
        """
        self._latency = latency
        self._session = self._diary.start_session(self._participant)
        return self._diary.halt_reason(self._participant)

    def end(self) -> None:
        """The page is gone."""
        if self._session is not None:
            self._diary.end_session(self._session)
        self._diary.close()

    @property
    def wants_clips(self) -> bool:
        """Whether the patient consented to short films of anomalies."""
        return self._wants_clips

    def game_goes_on(self, summary: GameSummary) -> None:
        """Keep how a game stands, in case the program is killed."""
        assert self._session is not None
        game = self._game_of(summary)
        self._row = self._diary.add_game(self._session, game, replaces=self._row)

    def game(self, summary: GameSummary, clips: Sequence[Pictures] = ()) -> None:
        """Keep a game that is over, and what was filmed of it."""
        assert self._session is not None
        # Who has taken back their consent meanwhile is filmed no longer.
        films = clips if self.wants_clips else ()
        self._diary.add_game(self._session, self._game_of(summary), films, replaces=self._row)
        self._row = None

    def _game_of(self, summary: GameSummary) -> DiaryGame:
        from manip3d import __version__
        from manip3d.diary import DiaryGame

        fields = vars(summary) | {
            "anomalies": tuple((a.start, a.end) for a in summary.anomalies),
            "source": self._source,
            "version": __version__,
            "latency_ms": self._latency and self._latency(),
        }
        return DiaryGame(at=datetime.now().astimezone(), **fields)

    def may_play(self) -> str:
        """Why no game may start yet, or nothing: without a rating the stop rule would be off."""
        return "" if self._is_rated else RATE_FIRST

    def play_begins(self) -> None:
        """A game or a touch cue begins; ratings are no longer those before the session."""
        assert self._session is not None
        if not self._has_begun:
            self._diary.begin_play(self._session)
            self._has_begun = True

    def pain(self, value: int) -> str:
        """Keep a rating; return why the session must stop, or nothing."""
        self._is_rated = True
        return self._diary.add_rating(self._participant, value, session=self._session)

    def event(self, text: str) -> None:
        """Keep an adverse event in words."""
        if text.strip():
            self._diary.add_event(self._participant, "other", text.strip(), session=self._session)

    def consent(self, clips: bool) -> None:
        """Keep whether the patient consents to films; without consent theirs are deleted."""
        if clips != self._wants_clips:
            self._diary.set_consent(self._participant, clips=clips)
            self._wants_clips = clips

    def ownership(self, mode: str, answers: Sequence[int]) -> None:
        """Keep the answers after a touch cue."""
        self._diary.add_ownership(self._participant, mode, answers, session=self._session)  # type: ignore[arg-type]

    def felt(self, felt: FeltLimb) -> None:
        """Keep how the patient feels the limb."""
        self._diary.add_felt(self._participant, **vars(felt), session=self._session)

    def unwell(self) -> str:
        """Keep that the patient feels sick; return that the session must stop."""
        from manip3d.diary import SICKNESS

        self._diary.add_event(self._participant, "sickness", session=self._session)
        return SICKNESS
