"""The part of a live session that writes into a diary."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Literal

from manip3d.errors import InputError
from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._recorder import GameSummary, Pictures
from manip3d.phantom._session_lock import SessionLock
from manip3d.phantom._sitting import goes_on
from manip3d.phantom._touch import Mode
from manip3d.phantom._writer import OrderedWriter

if TYPE_CHECKING:
    from manip3d.diary import DiaryGame, Rating
    from manip3d.diary._records import Moment

RATE_FIRST = "Please say first how strong the pain is now; then a game or a touch can begin."


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
        No such participant, or they have a live session open in another program.
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
            felt = self._diary.felt(participant)
            self._lock = SessionLock(self._diary.path, person.identifier, person.number)
        except BaseException:
            self._diary.close()
            raise
        self._participant, self._wants_clips = person.identifier, person.clips
        self.limb = person.limb
        names = FeltLimb.__dataclass_fields__
        # The last one of each limb; records of before told none: they are of the enrolled one.
        self._felt = {
            one.limb or self.limb: FeltLimb(**{n: getattr(one, n) for n in names}) for one in felt
        }
        self._source = source if source.startswith("sim:") else "".join(source.partition(":")[:2])
        self._latency: Callable[[], float | None] | None = None
        self._session: list[int] = []  # its row, as soon as it is written
        self._is_open = False
        self._latest = _now()  # when something was told last
        self._over = self._latest  # the sitting before
        self._row: list[int] | None = None  # of the game that goes on, as soon as it is written
        self._withdrawals = 0  # of consent
        self._remaining_films = ""  # that were exported before consent was withdrawn
        self._ratings: list[Rating] = []
        self._unanswered: list[Rating] = []  # of sittings that were closed without a last rating
        self._has_begun = False
        self._writer: OrderedWriter | None = None

    def start(self, latency: Callable[[], float | None] | None = None) -> str:
        """The page is there; return why the patient must not play any more today, or nothing.

        ``latency``: gives milliseconds to the page, if they are known by now.
        """
        self._latency = latency
        self._unanswered = self._unanswered_so_far()
        self._session, self._is_open = (
            [self._diary.start_session(self._participant, at=_now())],
            True,
        )
        self._latest = _now()
        self._writer = OrderedWriter()
        return self._diary.halt_reason(self._participant)

    def _unanswered_so_far(self) -> list[Rating]:
        """Ratings of sittings that go on (`goes_on`) and were closed without a last one; a sitting
        with ratings that was closed otherwise ends the comparison, as in `close_session`.

        A program that was stopped or killed after a game had begun could not ask for the last one.
        """
        found: list[Rating] = []
        for sitting in self._diary.sessions(self._participant):
            last_said = [sitting.started, *(rating.at for rating in sitting.ratings)]
            if not goes_on(sitting.ended or max(last_said), _now()):
                continue
            if not sitting.answered or (sitting.begun is not None and sitting.pain_after is None):
                found += sitting.ratings
            elif sitting.ended is not None and sitting.ratings:
                found = []
        return found

    def end(self, is_hurried: Callable[[], bool] | None = None) -> list[str]:
        """The page is gone; return what was not kept, in words.

        ``is_hurried``: wait for the disk no longer as soon as it returns True.
        """
        unkept: list[str] = []
        if self._writer is not None:
            self.close_session()
            unkept = self._writer.close(_END_S, is_hurried)
        self._diary.close()
        self._lock.release()
        return unkept

    def close_session(self, *, answered: bool = True) -> None:
        """The sitting is over; a second call changes nothing.

        ``answered``: whether the patient gave the last rating, where it was asked for. Without it
        nobody knows whether the pain rose: ratings of another sitting are compared with the first
        one of this sitting, or a new one would switch the stop rule off.
        """
        if not self._is_open:
            return
        self._is_open = False
        if answered and self._ratings:
            self._unanswered = []
        else:
            self._unanswered = [*self._unanswered, *self._ratings]
        # A program that ran on over night was not a sitting of a night.
        at = _now() if _now().date() == self._latest.date() else self._latest
        self._over = at
        self._keep_of_session(
            "" if answered else f"no rating at the end of the session, {at:%H:%M}",
            lambda row: self._diary.end_session(row, at=at, answered=answered),
        )

    def open_session(self) -> None:
        """Another sitting begins, with a first rating of its own; one that is open is closed."""
        self.close_session()
        row: list[int] = []
        at = _now()
        self._session, self._is_open, self._latest = row, True, at
        self._ratings, self._has_begun, self._row = [], False, None
        if not goes_on(self._over, at):
            self._unanswered = []

        def write() -> None:
            row[:] = [self._diary.start_session(self._participant, at=at)]

        self._keep("", write)

    def begin_message(self) -> None:
        """Begin a group: `when_kept` waits for all that is told from now on."""
        assert self._writer is not None
        self._writer.begin()

    def when_kept(self, done: Callable[[], object]) -> None:
        """Call something as soon as what was told since `begin_message` is written; never where
        any of it is lost."""
        assert self._writer is not None
        self._writer.when_written(done)

    def last_felt(self, limb: str) -> FeltLimb | None:
        """How the patient felt that limb when they last said so."""
        return self._felt.get(limb)

    @property
    def wants_clips(self) -> bool:
        """Whether the patient consented to short films of anomalies."""
        return self._wants_clips

    @property
    def trouble(self) -> str:
        """Return what is not kept yet and why, and which films remain without consent."""
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

        def write(session: int) -> None:
            # Who has taken back their consent meanwhile is filmed no longer, and plays on.
            films = clips if self._wants_clips and withdrawals == self._withdrawals else ()
            replaces = row[0] if row else None
            try:
                row[:] = [self._diary.add_game(session, game, films, replaces=replaces)]
            except InputError:
                if not any(films):
                    raise
                self._wants_clips = self._diary.participant(self._participant).clips
                row[:] = [self._diary.add_game(session, game, replaces=replaces)]

        self._keep_of_session(what, write)

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
            at = _now()
            self._keep_of_session("", lambda row: self._diary.begin_play(row, at=at))

    def pain(self, value: int) -> str:
        """Keep a rating; return why the session must stop, or nothing."""
        from manip3d.diary import Rating
        from manip3d.diary._protocol import judge_rating

        at = _now()
        when: Moment = "after" if self._has_begun else "before"
        reason = judge_rating([*self._unanswered, *self._ratings], value, at, when=when)
        self._ratings.append(Rating(at, value, when))

        self._keep_of_session(
            f"pain {value}, {at:%H:%M}",
            # The diary compares ratings of one sitting only. One transaction: what is tried again
            # is written once, and no rating is kept without the reason to stop.
            lambda row: self._diary.add_rating(
                self._participant, value, session=row, at=at, reason=reason
            ),
        )
        return reason

    def event(self, text: str) -> None:
        """Keep an adverse event in words."""
        if text.strip():
            self._keep_event("other", text.strip())

    def _keep_event(self, kind: Literal["sickness", "other"], text: str = "") -> None:
        at = _now()
        self._keep_of_session(
            f"adverse event, {at:%H:%M}: {text or kind}",
            lambda row: self._diary.add_event(self._participant, kind, text, session=row, at=at),
        )

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
        number = sum(one.has_films for one in self._diary.exports(self._participant))
        if not number:
            return ""
        # The patient reads it too: no names of files here.
        files = (
            "1 exported file still shows" if number == 1 else f"{number} exported files still show"
        )
        return f"{files} films; see `manip3d diary consent`."

    def ownership(self, mode: Mode, answers: Sequence[int]) -> None:
        """Keep the answers after a touch cue."""
        at = _now()
        self._keep_of_session(
            f"answers after a touch cue ({mode}): {', '.join(map(str, answers))}",
            lambda row: self._diary.add_ownership(
                self._participant, mode, answers, session=row, at=at
            ),
        )

    def felt(self, felt: FeltLimb, limb: str) -> None:
        """Keep how the patient feels a limb."""
        self._felt[limb] = felt
        told = ", ".join(f"{name} {value}" for name, value in vars(felt).items())
        at = _now()
        self._keep_of_session(
            f"limb as it is felt: {told}",
            lambda row: self._diary.add_felt(
                self._participant, **vars(felt), limb=limb, session=row, at=at
            ),
        )

    def unwell(self) -> str:
        """Keep that the patient feels sick; return that the session must stop."""
        from manip3d.diary import SICKNESS

        self._keep_event("sickness")
        return SICKNESS

    def _keep_of_session(self, what: str, write: Callable[[int], object]) -> None:
        """Have something written that belongs to the sitting of now; ``write`` gets its row."""
        session, self._latest = self._session, _now()

        def write_to_row() -> None:
            if not session:
                raise InputError("the session could not be begun in the diary")
            write(session[0])

        self._keep(what, write_to_row)

    def _keep(self, what: str, write: Callable[[], object]) -> None:
        assert self._writer is not None
        self._writer.add(what, write)


def _now() -> datetime:
    return datetime.now().astimezone()
