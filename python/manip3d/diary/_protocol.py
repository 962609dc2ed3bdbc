"""Protocol of the study: sessions and games due, adherence, and the rule for stopping."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime

from manip3d._util.checked import checked
from manip3d.diary._records import DiarySession, Moment, Rating, day_of, first_pain, local_day
from manip3d.errors import InputError

STOP_RISE = 2
"""Rise of the pain above the first rating of a session, in points, at which the session stops."""

_STOP_REASON = re.compile(r"The pain rose from \d+ to \d+\. ")
"""Beginning of the sentences of `stop_reason`."""


@checked
@dataclass(frozen=True)
class Protocol:
    """Protocol of section 4.8.3: 4 weeks with two sessions a day and three games per session.

    Attributes
    ----------
    weeks, sessions_a_day, games_a_session : int
        Duration in weeks, sessions per day, and games per session; each at least 1.

    Raises
    ------
    InputError
        A number is less than 1.
    """

    weeks: int = 4
    sessions_a_day: int = 2
    games_a_session: int = 3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 1:
                raise InputError(f"{name}: expected >= 1, got {value}")


@dataclass(frozen=True)
class Adherence:
    """Share of the protocol that has been done so far.

    Attributes
    ----------
    days : int
        Number of days of the protocol so far, including the first one.
    expected, complete, partial : int
        Numbers of sessions: due on these days; done with all games; done with fewer games. Sessions
        in excess of a day's number do not count.
    days_played : int
        Number of days with at least one game.
    share : float
        Ratio of complete to expected sessions.
    simulated : int
        Number of games of a simulated person, which do not count.
    """

    days: int
    expected: int
    complete: int
    partial: int
    days_played: int
    share: float
    simulated: int = 0


@checked
def adherence(
    sessions: Sequence[DiarySession],
    start: datetime,
    today: date,
    *,
    protocol: Protocol | None = None,
) -> Adherence:
    """Compare sessions with a protocol.

    Games that were stopped or interrupted, and games of a simulated person, do not count. The day
    of a session is that of its first game that counts. Days are those of this machine's time zone,
    to which times with another offset from UTC are converted.

    Parameters
    ----------
    sessions : sequence of DiarySession
    start : datetime
        Time on the first day of the protocol.
    today : date
        Last day to count, in this machine's time zone; days after the end of the protocol do not
        count.
    protocol : Protocol, optional
        Protocol of the study.

    Returns
    -------
    Adherence

    Raises
    ------
    InputError
        ``today`` is before the start, or has a time.

    Examples
    --------
    >>> from datetime import UTC, date, datetime
    >>> from manip3d.diary import adherence
    >>> start = datetime(2026, 1, 1, 12, tzinfo=UTC)
    >>> adherence([], start, date(2026, 1, 7)).expected
    14
    """
    plan = protocol or Protocol()
    first = local_day(start)
    if day_of(today) < first:
        raise InputError(f"today: expected {first} or later, got {today}")
    days = min((today - first).days + 1, 7 * plan.weeks)
    complete, partial, played = Counter[int](), Counter[int](), set[int]()
    for session in sessions:
        times = [game.at for game in session.games if game.counts]
        if not times:
            continue
        day = (local_day(min(times)) - first).days
        if not 0 <= day < days:
            continue
        played.add(day)
        (complete if len(times) >= plan.games_a_session else partial)[day] += 1
    num_complete = sum(min(number, plan.sessions_a_day) for number in complete.values())
    num_partial = sum(
        min(number, plan.sessions_a_day - min(complete[day], plan.sessions_a_day))
        for day, number in partial.items()
    )
    expected = days * plan.sessions_a_day
    return Adherence(
        days=days,
        expected=expected,
        complete=num_complete,
        partial=num_partial,
        days_played=len(played),
        share=num_complete / expected,
        simulated=sum(game.is_simulated for session in sessions for game in session.games),
    )


@checked
def stop_reason(before: int | None, now: int) -> str:
    """Return the reason why a session must stop, which is pain 2 or more above the first rating.

    Parameters
    ----------
    before : int or None
        Rating before the session, 0 to 10; None: there is none.
    now : int
        Current rating, 0 to 10.

    Returns
    -------
    str
        Sentence for the patient; empty: the session may continue.

    Raises
    ------
    InputError
        A rating is out of range.

    Examples
    --------
    >>> from manip3d.diary import stop_reason
    >>> stop_reason(3, 5)
    'The pain rose from 3 to 5. Please stop for today and tell your therapist.'
    >>> stop_reason(3, 4)
    ''
    """
    for name, rating in (("before", before), ("now", now)):
        if rating is not None and not 0 <= rating <= 10:
            raise InputError(f"{name}: expected 0 to 10, got {rating}")
    if before is None or now - before < STOP_RISE:
        return ""
    return f"The pain rose from {before} to {now}. Please stop for today and tell your therapist."


def is_stop_reason(text: str) -> bool:
    """Return whether a text is a sentence of `stop_reason`."""
    return bool(_STOP_REASON.match(text))


def judge_rating(ratings: Sequence[Rating], pain: int, at: datetime, *, when: Moment) -> str:
    """Return why a session must stop after another rating, compared with the first; or ''."""
    return stop_reason(first_pain([*ratings, Rating(at, pain, when)]), pain)


PAIN = "The pain rose. Please stop for today and tell your therapist."
"""Reason shown for an adverse event of pain whose two ratings are unknown."""

SICKNESS = "You feel sick. Please stop for today and tell your therapist."
"""Sentence shown after the patient reported feeling sick."""
