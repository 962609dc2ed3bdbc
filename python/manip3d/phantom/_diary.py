"""What a live session writes into a diary."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

from manip3d.errors import InputError
from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._session import GameSummary, Pictures
from manip3d.phantom._writer import OrderedWriter

if TYPE_CHECKING:
    from manip3d.diary import DiaryGame, Rating
    from manip3d.diary._records import Moment

RATE_FIRST = "Please say first how strong the pain is now; then the game can start."


_END_S = 15.0  # for so long the end of a session waits for the disk


class DiaryRecorder:
    """A session of a participant, written by a thread of its own, in order.

    What a locked file or a full disk keeps from being written is tried again until the session
    ends; `trouble` says so meanwhile. Only the constructor and `start` raise errors of the diary.

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
        try:
            person = self._diary.participant(participant)
        except BaseException:
            self._diary.close()
            raise
        self._participant, self._wants_clips = person.identifier, person.clips
        self.limb = person.limb
        self._source = source if source.startswith("sim:") else "".join(source.partition(":")[:2])
        self._latency: Callable[[], float | None] | None = None
        self._session = 0
        self._row: list[int] | None = None  # of the game that goes on, as soon as it is written
        self._withdrawals = 0  # of consent
        self._remaining_films = ""  # that were exported before consent was withdrawn
        self._ratings: list[Rating] = []
        self._has_begun = False
        self._writer: OrderedWriter | None = None

    def start(self, latency: Callable[[], float | None] | None = None) -> str:
        """The page is there; return why the patient must not play any more today, or nothing.

        ``latency``: gives milliseconds to the page, if they are known by now.
        """
        self._latency = latency
        self._session = self._diary.start_session(self._participant)
        self._writer = OrderedWriter()
        return self._diary.halt_reason(self._participant)

    def end(self) -> list[str]:
        """The page is gone; return what was not kept, in words."""
        unkept: list[str] = []
        if self._writer is not None:
            self._keep("", self._diary.end_session, self._session, at=_now())
            unkept = self._writer.close(_END_S)
        self._diary.close()
        return unkept

    @property
    def wants_clips(self) -> bool:
        """Whether the patient consented to short films of anomalies."""
        return self._wants_clips

    @property
    def trouble(self) -> str:
        """What is not kept yet, and why, and which films remain without consent; or nothing."""
        unkept = "" if self._writer is None else self._writer.trouble
        return " ".join(part for part in (unkept, self._remaining_films) if part)

    def game_goes_on(self, summary: GameSummary) -> None:
        """Keep how a game stands, in case the program is killed."""
        assert self._writer is not None
        # While the disk keeps one waiting, there is no need to write down every state.
        if self._row is None or self._writer.is_idle:
            self._keep_game("", summary)

    def game(self, summary: GameSummary, clips: Sequence[Pictures] = ()) -> None:
        """Keep a game that is over, and what was filmed of it."""
        what = f"game {summary.game}, {summary.score} points, {_now():%H:%M}"
        self._keep_game(what, summary, clips)
        self._row = None

    def _keep_game(self, what: str, summary: GameSummary, clips: Sequence[Pictures] = ()) -> None:
        row = self._row = [] if self._row is None else self._row
        game, withdrawals = self._game_of(summary), self._withdrawals

        def write() -> None:
            # Who has taken back their consent meanwhile is filmed no longer, and plays on.
            films = clips if self._wants_clips and withdrawals == self._withdrawals else ()
            replaces = row[0] if row else None
            try:
                row[:] = [self._diary.add_game(self._session, game, films, replaces=replaces)]
            except InputError:
                if not any(films):
                    raise
                self._wants_clips = self._diary.participant(self._participant).clips
                row[:] = [self._diary.add_game(self._session, game, replaces=replaces)]

        self._keep(what, write)

    def _game_of(self, summary: GameSummary) -> DiaryGame:
        from manip3d import __version__
        from manip3d.diary import DiaryGame

        fields = vars(summary) | {
            "anomalies": tuple((a.start, a.end) for a in summary.anomalies),
            "source": self._source,
            "version": __version__,
            "latency_ms": self._latency and self._latency(),
        }
        return DiaryGame(at=_now(), **fields)

    def may_play(self) -> str:
        """Why no game may start yet, or nothing: without a rating the stop rule would be off."""
        return "" if self._ratings else RATE_FIRST

    def play_begins(self) -> None:
        """A game or a touch cue begins; ratings are no longer those before the session."""
        if not self._has_begun:
            self._has_begun = True
            self._keep("", self._diary.begin_play, self._session, at=_now())

    def pain(self, value: int) -> str:
        """Keep a rating; return why the session must stop, or nothing."""
        from manip3d.diary import Rating
        from manip3d.diary._protocol import judge_rating

        at = _now()
        when: Moment = "after" if self._has_begun else "before"
        reason = judge_rating(self._ratings, value, at, when=when)
        self._ratings.append(Rating(at, value, when))
        self._keep(
            f"pain {value}, {at:%H:%M}",
            self._diary.add_rating, self._participant, value, session=self._session, at=at,
        )  # fmt: skip
        return reason

    def event(self, text: str) -> None:
        """Keep an adverse event in words."""
        if text.strip():
            self._keep_event("other", text.strip())

    def _keep_event(self, kind: Literal["sickness", "other"], text: str = "") -> None:
        self._keep(
            f"adverse event, {_now():%H:%M}: {text or kind}",
            self._diary.add_event,
            self._participant, kind, text, session=self._session, at=_now(),
        )  # fmt: skip

    def consent(self, clips: bool) -> None:
        """Keep whether the patient consents to films; without consent theirs are deleted."""
        if clips == self._wants_clips:
            return
        self._wants_clips = clips
        self._withdrawals += not clips
        assert self._writer is not None

        def write() -> None:
            self._diary.set_consent(self._participant, clips=clips)
            self._remaining_films = "" if clips else self._exported_films()

        # Clips are deleted only while no other program reads: nothing else waits for that.
        what = f"consent to films: {'yes' if clips else 'no, and the films to be deleted'}"
        self._writer.add(what, write, holds=False)

    def _exported_films(self) -> str:
        """Tell the therapist which exported files still show films."""
        files = [str(one.path) for one in self._diary.exports(self._participant) if one.has_films]
        return f"Exported before and to be deleted: {', '.join(files)}." if files else ""

    def ownership(self, mode: str, answers: Sequence[int]) -> None:
        """Keep the answers after a touch cue."""
        self._keep(
            f"answers after a touch cue ({mode}): {', '.join(map(str, answers))}",
            self._diary.add_ownership,
            self._participant, mode, answers, session=self._session, at=_now(),
        )  # fmt: skip

    def felt(self, felt: FeltLimb) -> None:
        """Keep how the patient feels the limb."""
        told = ", ".join(f"{name} {value}" for name, value in vars(felt).items())
        self._keep(
            f"limb as it is felt: {told}",
            self._diary.add_felt,
            self._participant, **vars(felt), session=self._session, at=_now(),
        )  # fmt: skip

    def unwell(self) -> str:
        """Keep that the patient feels sick; return that the session must stop."""
        from manip3d.diary import SICKNESS

        self._keep_event("sickness")
        return SICKNESS

    def _keep(self, what: str, write: Callable[..., object], *values: Any, **options: Any) -> None:
        assert self._writer is not None
        self._writer.add(what, functools.partial(write, *values, **options))


def _now() -> datetime:
    return datetime.now().astimezone()
