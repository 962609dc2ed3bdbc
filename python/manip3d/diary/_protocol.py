"""The study's protocol: how much is to be played, how much was, and when to stop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime

from manip3d._util.checked import checked
from manip3d.diary._records import DiarySession, Moment, Rating, first_pain
from manip3d.errors import InputError

STOP_RISE = 2
"""A session stops when the pain is so much above its first rating."""


@checked
@dataclass(frozen=True)
class Protocol:
    """Protocol of section 4.8.3: 4 weeks, two sessions every day, three games in each.

    Attributes
    ----------
    weeks, sessions_a_day, games_a_session : int
        At least 1.

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
    """Share of the protocol that was done so far.

    Attributes
    ----------
    days : int
        Days of the protocol so far, the first one included.
    expected, complete, partial : int
        Sessions to be done in them; done with all games; done with fewer. More sessions in a day
        than the protocol has count no further.
    days_played : int
        Days with at least one game.
    share : float
        Complete of expected ones.
    simulated : int
        Games of a simulated person, which are left out.
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

    A game that was stopped or interrupted, or of a simulated person, counts for nothing here; days
    are those of the clock where it was played.

    Parameters
    ----------
    sessions : sequence of DiarySession
    start : datetime
        First day of the protocol.
    today : date
        Last day that counts; days after the protocol's last one do not count either.
    protocol : Protocol, optional

    Returns
    -------
    Adherence

    Raises
    ------
    InputError
        ``today`` is before the start.

    Examples
    --------
    >>> from datetime import timezone
    >>> adherence([], datetime(2026, 1, 1, tzinfo=timezone.utc), date(2026, 1, 7)).expected
    14
    """
    plan = protocol or Protocol()
    if today < start.date():
        raise InputError(f"today: expected {start.date()} or later, got {today}")
    days = min((today - start.date()).days + 1, 7 * plan.weeks)
    complete, partial, played = Counter[int](), Counter[int](), set[int]()
    for session in sessions:
        day = (session.started.date() - start.date()).days
        games = sum(game.counts for game in session.games)
        if not 0 <= day < days or not games:
            continue
        played.add(day)
        (complete if games >= plan.games_a_session else partial)[day] += 1
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
    """Return why a session must stop: pain 2 points or more above the first rating; else empty.

    Parameters
    ----------
    before : int or None
        The rating before the session, 0 to 10; None: nobody asked.
    now : int
        0 to 10.

    Returns
    -------
    str
        In words for the patient; empty: it may go on.

    Raises
    ------
    InputError
        A rating is out of range.

    Examples
    --------
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


def judge_rating(ratings: Sequence[Rating], pain: int, at: datetime, *, when: Moment) -> str:
    """Why a session must stop with one more rating, compared with the first one; or nothing."""
    return stop_reason(first_pain([*ratings, Rating(at, pain, when)]), pain)


PAIN = "The pain rose. Please stop for today and tell your therapist."
"""Reason that is shown for an adverse event of pain without its two ratings."""

SICKNESS = "You feel sick. Please stop for today and tell your therapist."
"""Words of the page after the patient said that they feel sick."""
