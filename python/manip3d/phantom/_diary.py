"""`DiaryRecorder`: writes what happens in a live session into a diary.

A *sitting* is a session in the diary: from a first rating of the pain to a last one. A live session
(one run of the program) can hold several sittings.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Literal

from manip3d._util.times import local_now
from manip3d.errors import InputError
from manip3d.phantom._felt import FeltLimb
from manip3d.phantom._recorder import GameSummary, Pictures
from manip3d.phantom._sitting import goes_on
from manip3d.phantom._touch import Mode
from manip3d.phantom._writer import OrderedWriter

if TYPE_CHECKING:
    from manip3d.diary import DiaryGame, DiarySession, Rating
    from manip3d.diary._records import Moment

RATE_FIRST = "Please say first how strong the pain is now; then a game or a touch can begin."


_END_S = 15.0  # seconds that the end of a live session waits for entries to be written


class DiaryRecorder:
    """Writes the live session of a participant into a diary, in order, by a thread of its own.

    Entries that cannot be written, because the file is locked or the disk is full, are tried again
    until the live session ends; `trouble` lists them meanwhile. Only the constructor and `start`
    raise errors of the diary.

    Attributes
    ----------
    limb : str
        The affected limb, as enrolled.

    Raises
    ------
    InputError
        No such participant, or they have a live session open in another program or are being
        deleted there.
    FormatError, OSError
        There is no such diary, it has another key or can only be read, or its file system has no
        locks.
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
        from manip3d.diary._session_lock import SessionLock

        self._diary = Diary(path, key=key)
        try:
            person = self._diary.participant(participant)
            felt = self._diary.felt(participant)
            self._lock = SessionLock(self._diary, person.identifier, person.number)
        except BaseException:
            self._diary.close()
            raise
        self._participant, self._wants_clips = person.identifier, person.clips
        self.limb = person.limb
        names = FeltLimb.__dataclass_fields__
        # The last record of each limb. Records of older versions state no limb, and are of the
        # enrolled one.
        self._felt = {
            one.limb or self.limb: FeltLimb(**{n: getattr(one, n) for n in names}) for one in felt
        }
        self._source = source if source.startswith("sim:") else "".join(source.partition(":")[:2])
        self._latency: Callable[[], float | None] | None = None
        self._session: list[int] = []  # number of the sitting in the diary, once it is written
        self._is_open = False  # whether a sitting has begun and is not over
        self._latest = local_now()  # time of the last entry
        self._over = self._latest  # end of the previous sitting
        self._row: list[int] | None = None  # number of the current game, once it is written
        self._withdrawals = 0  # number of times that consent to films was withdrawn
        self._remaining_films = ""  # a sentence on exported films that still exist
        self._ratings: list[Rating] = []  # ratings of the current sitting
        self._unanswered: list[Rating] = []  # see `_unanswered_so_far`
        self._has_begun = False
        self._writer: OrderedWriter | None = None

    def start(self, latency: Callable[[], float | None] | None = None) -> str:
        """Begin the first sitting; return why the patient must not play today, or an empty text.

        ``latency`` returns the latency to the page in milliseconds, or None if it is not known yet.
        """
        self._latency = latency
        self._unanswered = self._unanswered_so_far()
        self._session, self._is_open = (
            [self._diary.start_session(self._participant, at=local_now())],
            True,
        )
        self._latest = local_now()
        self._writer = OrderedWriter()
        return self._diary.halt_reason(self._participant)

    def _unanswered_so_far(self) -> list[Rating]:
        """Return the ratings of earlier sittings with which new ratings must be compared.

        These are sittings that ended without a last rating so recently that they count as going on
        (`goes_on`), for example because the program was killed after a game had begun. A sitting
        with ratings that was closed properly ends the comparison, as in `close_session`. If the
        clock was set during a sitting, its times that are not recent count nowhere.
        """
        found: list[Rating] = []
        sessions = self._diary.sessions(self._participant)
        recent = [(last, one) for one in sessions if (last := _last_recent(one, local_now()))]
        for _, sitting in sorted(recent, key=lambda known: known[0]):
            if not sitting.answered or (sitting.begun is not None and sitting.pain_after is None):
                found += sitting.ratings
            elif sitting.ended is not None and sitting.ratings:
                found = []
        return found

    def end(self, is_hurried: Callable[[], bool] | None = None) -> list[str]:
        """End the last sitting and close the diary; return descriptions of entries that were lost.

        Waits for the disk up to `_END_S`, but no longer once ``is_hurried`` returns True.
        """
        unkept: list[str] = []
        if self._writer is not None:
            self.close_session()
            unkept = self._writer.close(_END_S, is_hurried)
        self._diary.close()
        self._lock.release()
        return unkept

    def close_session(self, *, answered: bool = True) -> None:
        """End the sitting; a second call changes nothing.

        ``answered``: False if the patient was asked for the last rating and gave none. It is then
        unknown whether the pain rose, and ratings of the next sitting are also compared with the
        first one of this sitting. Otherwise a new sitting would switch the stop rule off. The same
        holds if the patient played and gave no rating afterwards, because nobody asked.
        """
        if not self._is_open:
            return
        self._is_open = False
        is_rated = bool(self._ratings) and (
            not self._has_begun or self._ratings[-1].when == "after"
        )
        if answered and is_rated:
            self._unanswered = []
        else:
            self._unanswered = [*self._unanswered, *self._ratings]
        # If the program ran past midnight, the sitting ended with its last entry; the time of that
        # entry lies ahead if the clock was set back since.
        now = local_now()
        at = now if now.date() == self._latest.date() else min(now, self._latest)
        self._over = at
        self._keep_of_session(
            "" if answered else f"no rating at the end of the session, {at:%H:%M}",
            lambda row: self._diary.end_session(row, at=at, answered=answered),
        )

    def open_session(self) -> None:
        """Begin another sitting, with a first rating of its own; an open one is closed."""
        self.close_session()
        row: list[int] = []
        at = local_now()
        self._session, self._is_open, self._latest = row, True, at
        self._ratings, self._has_begun, self._row = [], False, None
        if not goes_on(self._over, at):
            self._unanswered = []

        def write() -> None:
            row[:] = [self._diary.start_session(self._participant, at=at)]

        self._keep("", write)

    def begin_message(self) -> None:
        """Begin a group of entries, for which `when_kept` waits."""
        assert self._writer is not None
        self._writer.begin()

    def when_kept(self, done: Callable[[], object]) -> None:
        """Call ``done`` once all entries since `begin_message` are written; not if one is lost."""
        assert self._writer is not None
        self._writer.when_written(done)

    def last_felt(self, limb: str) -> FeltLimb | None:
        """Return the patient's last description of the felt phantom limb."""
        return self._felt.get(limb)

    @property
    def wants_clips(self) -> bool:
        """Whether the patient consented to short films of anomalies."""
        return self._wants_clips

    @property
    def trouble(self) -> str:
        """Sentences on entries not written yet, and on films that exist without consent."""
        unkept = "" if self._writer is None else self._writer.trouble
        return " ".join(part for part in (unkept, self._remaining_films) if part)

    def game_goes_on(self, summary: GameSummary) -> None:
        """Write the current state of a game, in case the program is killed."""
        assert self._writer is not None
        # If the disk is slow, some states are left out.
        if self._row is None or self._writer.is_idle:
            self._keep_game("", summary)

    def game(self, summary: GameSummary, clips: Sequence[Pictures] = ()) -> None:
        """Write a game that is over, with its films."""
        what = f"game {summary.game}, {summary.score} points, {local_now():%H:%M}"
        self._keep_game(what, summary, clips)
        self._row = None

    def _keep_game(self, what: str, summary: GameSummary, clips: Sequence[Pictures] = ()) -> None:
        row = self._row = [] if self._row is None else self._row
        game, withdrawals = self._game_of(summary), self._withdrawals

        def write(session: int) -> None:
            # If consent was withdrawn in the meantime, the game is written without films.
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
        return DiaryGame(at=local_now(), **fields)

    def may_play(self) -> str:
        """Return why no game may start yet: without a first rating there is no stop rule."""
        return "" if self._ratings else RATE_FIRST

    def play_begins(self) -> None:
        """Note that a game or touch cue begins: later ratings are "after", not "before"."""
        if not self._has_begun:
            self._has_begun = True
            at = local_now()
            self._keep_of_session("", lambda row: self._diary.begin_play(row, at=at))

    def pain(self, value: int) -> str:
        """Write a rating of the pain; return why the session must stop, or an empty text."""
        from manip3d.diary import Rating
        from manip3d.diary._protocol import judge_rating

        at = local_now()
        when: Moment = "after" if self._has_begun else "before"
        reason = judge_rating([*self._unanswered, *self._ratings], value, at, when=when)
        self._ratings.append(Rating(at, value, when))

        self._keep_of_session(
            f"pain {value}, {at:%H:%M}",
            # `reason` may come from ratings of earlier sittings, which the diary does not compare.
            # Rating and reason are written in one transaction.
            lambda row: self._diary.add_rating(
                self._participant, value, session=row, at=at, reason=reason
            ),
        )
        return reason

    def event(self, text: str) -> None:
        """Write an adverse event."""
        if text.strip():
            self._keep_event("other", text.strip())

    def _keep_event(self, kind: Literal["sickness", "other"], text: str = "") -> None:
        at = local_now()
        self._keep_of_session(
            f"adverse event, {at:%H:%M}: {text or kind}",
            lambda row: self._diary.add_event(self._participant, kind, text, session=row, at=at),
        )

    def consent(self, clips: bool) -> None:
        """Write whether the patient consents to films; without consent all films are deleted."""
        if clips == self._wants_clips:
            return
        self._wants_clips = clips
        self._withdrawals += not clips
        assert self._writer is not None

        def write() -> None:
            self._diary.set_consent(self._participant, clips=clips)
            self._remaining_films = "" if clips else self._exported_films()

        # Films can be deleted only while no other program reads the diary. Other entries do not
        # wait for that.
        what = f"consent to films: {'yes' if clips else 'no, and the films to be deleted'}"
        self._writer.add(what, write, holds=False)

    def _exported_films(self) -> str:
        """Return a sentence on the number of exported files that still show films."""
        number = sum(one.has_films for one in self._diary.exports(self._participant))
        if not number:
            return ""
        # The patient reads this too, so it names no files.
        files = (
            "1 exported file still shows" if number == 1 else f"{number} exported files still show"
        )
        return f"{files} films; see `manip3d diary consent`."

    def ownership(self, mode: Mode, answers: Sequence[int]) -> None:
        """Write the answers after a touch cue."""
        at = local_now()
        self._keep_of_session(
            f"answers after a touch cue ({mode}): {', '.join(map(str, answers))}",
            lambda row: self._diary.add_ownership(
                self._participant, mode, answers, session=row, at=at
            ),
        )

    def felt(self, felt: FeltLimb, limb: str) -> None:
        """Write the patient's description of the felt phantom limb."""
        self._felt[limb] = felt
        told = ", ".join(f"{name} {value}" for name, value in vars(felt).items())
        at = local_now()
        self._keep_of_session(
            f"limb as it is felt: {told}",
            lambda row: self._diary.add_felt(
                self._participant, **vars(felt), limb=limb, session=row, at=at
            ),
        )

    def unwell(self) -> str:
        """Write that the patient feels sick; return why the session must stop."""
        from manip3d.diary import SICKNESS

        self._keep_event("sickness")
        return SICKNESS

    def _keep_of_session(self, what: str, write: Callable[[int], object]) -> None:
        """Write an entry of the current sitting; ``write`` is called with the sitting's number.

        ``what`` describes the entry if it is lost; empty: it is not listed.
        """
        session, self._latest = self._session, local_now()

        def write_to_row() -> None:
            if not session:
                raise InputError("the session could not be begun in the diary")
            write(session[0])

        self._keep(what, write_to_row)

    def _keep(self, what: str, write: Callable[[], object]) -> None:
        assert self._writer is not None
        self._writer.add(what, write)


def _last_recent(sitting: DiarySession, now: datetime) -> datetime | None:
    """Return the last of a sitting's times that are recent; None: the sitting is over."""
    times = [sitting.started, sitting.clock_at_end, *(rating.at for rating in sitting.ratings)]
    return max((at for at in times if at is not None and goes_on(at, now)), default=None)
