"""Records of a diary."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import date, datetime
from pathlib import Path
from typing import Literal

from manip3d._util.reprs import short_repr
from manip3d._util.times import local_now
from manip3d.diary._mcgill import McGillScore
from manip3d.diary._questionnaires import OWNERSHIP, Questionnaire
from manip3d.errors import FormatError, InputError
from manip3d.io._files import regular_bytes, sha256_of

Moment = Literal["before", "after", "other"]
Occasion = Literal["baseline", "week-1", "week-4", "other"]

CORRECTION_S = 30.0
"""Time in seconds within which a second rating, before any play, corrects the first one of a
session."""

_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def identifier_of(text: str) -> str:
    """Check a participant's pseudonym, which must be valid in file names and tables."""
    if not _IDENTIFIER.fullmatch(text):
        raise InputError(
            "participant: expected up to 64 letters (A to Z and a to z), digits, dots, hyphens and "
            f"underscores, beginning with a letter or digit, got {text!r}"
        )
    return text


def aware(moment: datetime | None) -> datetime:
    """Return the moment, or now if it is None; refuse a moment without offset from UTC."""
    if moment is None:
        return local_now()
    if moment.tzinfo is None:
        raise InputError(f"at: expected a time with its offset from UTC, got {moment}")
    return moment


def day_of(today: date | None) -> date:
    """Return the day, or today if it is None; refuse a time, which cannot be compared with days."""
    if isinstance(today, datetime):  # a subclass of date
        raise InputError(f"today: expected a date without a time (`.date()`), got {today!r}")
    return today or date.today()


def local_day(moment: datetime) -> date:
    """Return the day in this machine's time zone, which may differ from that of the record."""
    return moment.astimezone().date()


@dataclass(frozen=True)
class Participant:
    """A participant of the study, under a pseudonym.

    Attributes
    ----------
    identifier : str
        Pseudonym; the diary does not contain the person's name.
    limb : str
        The affected limb; empty: unknown.
    enrolled : datetime
        Time of the enrolment.
    clips : bool
        Whether the participant consented to clips of anomalies.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    identifier: str
    limb: str
    enrolled: datetime
    clips: bool = False
    number: int = field(default=0, compare=False)


@dataclass(frozen=True)
class DiaryGame:
    """A game of a session.

    Attributes
    ----------
    at : datetime
        Time of the game's end, or of the last record of a game that did not end.
    game : str
        Name of the game: 1 to 64 characters that file names may have, because films are named by
        it. Any game may be stored.
    difficulty, seed : int
        Options of the game.
    ending : str
        ``time``, ``misses``, ``done`` or ``stopped``; ``interrupted`` while the game is running, or
        if the program was killed.
    seconds, paused_s : float
        Time of play, and time of waiting for the phantom limb, seconds.
    score, misses, by_phantom : int
        Points, misses, and points made by the phantom limb.
    gain : float
        Gain of the virtual enhancement; 1: none.
    anomalies : tuple of (float, float)
        Start and end, in seconds of play, of times without a point despite a target in reach.
    limb : str
        The limb that was replaced.
    source : str
        Source of the frames: the whole address of a simulated person, but only the scheme of other
        sources, such as ``mkv:``, because file names may contain names of people. Empty: an older
        diary.
    version : str
        Version of this program.
    latency_ms : float or None
        95th percentile of the time from a frame's arrival to its decoding in the page that started
        the game; other screens do not count.
    tracked : float or None
        Share of the frames in which the phantom limb was tracked.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    game: str
    difficulty: int
    seed: int
    ending: str
    seconds: float
    paused_s: float
    score: int
    misses: int
    by_phantom: int
    anomalies: tuple[tuple[float, float], ...] = ()
    gain: float = 1.0
    limb: str = ""
    source: str = ""
    version: str = ""
    latency_ms: float | None = None
    tracked: float | None = None
    number: int = field(default=0, compare=False)

    @property
    def is_simulated(self) -> bool:
        """Whether the person in front of the camera was simulated."""
        return self.source.startswith("sim:")

    @property
    def counts(self) -> bool:
        """Whether the game counts for protocol and trends: a real person played it to its end."""
        return self.ending not in ("stopped", "interrupted") and not self.is_simulated


@dataclass(frozen=True)
class ExportedFile:
    """An exported copy of a part of the diary.

    Attributes
    ----------
    path : Path
    sha256 : str
        SHA-256 of its content when it was written.
    """

    path: Path
    sha256: str

    @property
    def state(self) -> Literal["unchanged", "changed", "gone"]:
        """State of the file: ``unchanged``, ``changed`` since the export, or ``gone``."""
        try:
            now = sha256_of(self.path)
        except FileNotFoundError:
            return "gone"
        except (OSError, FormatError):
            return "changed"
        return "unchanged" if now == self.sha256 else "changed"

    @property
    def has_films(self) -> bool:
        """Whether the file still exists and is a film or a page with films."""
        try:
            content = regular_bytes(self.path)
        except (OSError, FormatError):
            return False
        return content[8:12] == b"WEBP" or FILM_IN_PAGE in content


NOT_ANSWERED = "The rating of the pain at the end was not answered."
"""Text of exports for a session that ended without a last rating."""

CLOCK_WENT_BACK = "The clock was set back during the session: its duration is unknown."
"""Text of exports for a session whose end lay before its start by the computer's clock."""

FILM_IN_PAGE = b"data:image/webp;base64,"
"""First bytes of a film within a page."""


@dataclass(frozen=True)
class Rating:
    """Intensity of the pain, from 0 (none) to 10 (the worst).

    Attributes
    ----------
    at : datetime
    pain : int
    when : str
        ``before`` the first game or touch cue of a session, ``after`` its start, or ``other``.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    pain: int
    when: Moment
    number: int = field(default=0, compare=False)


def first_pain(ratings: Iterable[Rating]) -> int | None:
    """Return the rating with which later ratings of a session are compared.

    It is the first rating, or a second one that corrects it (`CORRECTION_S`). ``ratings`` are
    in the order in which they were given; their times go back if the clock was set back.
    """
    first: Rating | None = None
    pain = None
    for rating in ratings:
        if rating.when == "other":
            continue
        if first is None:
            first = rating
        elif not (
            first.when == rating.when == "before"
            and abs((rating.at - first.at).total_seconds()) <= CORRECTION_S
        ):
            break
        pain = rating.pain
    return pain


@dataclass(frozen=True)
class DiarySession:
    """One session of a participant.

    Attributes
    ----------
    number : int
        Number of the session, for `Diary.add_game` and other methods.
    started : datetime
        Time of the start.
    ended : datetime or None
        Time of the end, not before the start; None: the session is running, or the program was
        killed.
    games : tuple of DiaryGame
    ratings : tuple of Rating
    begun : datetime or None
        Start of the first game or touch cue; None: none has started.
    answered : bool
        False: the patient was asked for a last rating of the pain and gave none.
    clock_went_back : bool
        Whether the end lay before the start, because the computer's clock was set back: `ended` is
        then the time of the start, and the duration is unknown.
    clock_at_end : datetime or None
        Time of the end as the clock stated it, which lies before the start if the clock was set
        back; None: not ended, or not read from a diary.
    """

    number: int
    started: datetime
    ended: datetime | None
    games: tuple[DiaryGame, ...]
    ratings: tuple[Rating, ...]
    begun: datetime | None = None
    answered: bool = True
    clock_went_back: bool = False
    clock_at_end: datetime | None = None

    __repr__ = short_repr

    @property
    def pain_before(self) -> int | None:
        """First rating if it was given before the first game or touch cue.

        A second rating within 30 seconds corrects it.
        """
        return first_pain(rating for rating in self.ratings if rating.when == "before")

    @property
    def pain_after(self) -> int | None:
        """Last rating after the start of the first game or touch cue."""
        return next((r.pain for r in reversed(self.ratings) if r.when == "after"), None)


@dataclass(frozen=True)
class McGill:
    """A filled-in McGill Pain Questionnaire.

    Attributes
    ----------
    at : datetime
    occasion : str
        ``baseline``, ``week-1``, ``week-4`` or ``other``.
    ranks : tuple of 20 int
        Ranks of the chosen words, as for `score_mcgill`.
    score : McGillScore
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    occasion: Occasion
    ranks: tuple[int, ...]
    score: McGillScore
    number: int = field(default=0, compare=False)

    __repr__ = short_repr


@dataclass(frozen=True)
class Ownership:
    """Answers after a touch cue, each from -3 (not at all) to 3 (very much).

    Attributes
    ----------
    at : datetime
    mode : str
        ``synchronous`` or ``asynchronous``.
    answers : tuple of 6 int
        Three answers about ownership of the limb, then three controls.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    mode: Literal["synchronous", "asynchronous"]
    answers: tuple[int, ...]
    number: int = field(default=0, compare=False)

    @property
    def ownership(self) -> float:
        """Mean of the three answers about ownership."""
        return OWNERSHIP.score(self.answers)["ownership"]

    @property
    def control(self) -> float:
        """Mean of the three controls."""
        return OWNERSHIP.score(self.answers)["control"]


@dataclass(frozen=True)
class Answers:
    """A filled-in questionnaire.

    Attributes
    ----------
    at : datetime
    questionnaire : Questionnaire
        The questionnaire with the wording that was used.
    answers : tuple of int
        Answer to each question.
    occasion : str
        ``baseline``, ``week-1``, ``week-4`` or ``other``.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    questionnaire: Questionnaire
    answers: tuple[int, ...]
    occasion: Occasion = "other"
    number: int = field(default=0, compare=False)

    @property
    def scores(self) -> dict[str, float]:
        """Scores by the names of the scales."""
        return self.questionnaire.score(self.answers)


@dataclass(frozen=True)
class FeltRecord:
    """The phantom limb as the patient feels it.

    Attributes
    ----------
    at : datetime
    length, telescoping : int, per cent
        Felt length in per cent of the intact limb's; and share by which the hand or foot is felt to
        have moved towards the stump.
    raised, bent : int, degrees
        Sideways elevation of the limb from hanging down; and angle of elbow or knee.
    limb : str
        The phantom limb, such as ``left_arm``; empty: the limb of the enrolment.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    length: int
    telescoping: int
    raised: int
    bent: int
    limb: str = ""
    number: int = field(default=0, compare=False)


@dataclass(frozen=True)
class AdverseEvent:
    """An adverse event that was reported.

    Attributes
    ----------
    at : datetime
    kind : str
        ``pain`` (reported by the therapist, or by the stop rule when a rating rose by 2 or more),
        ``sickness`` or ``other``.
    text : str
        Description.
    number : int
        Number of the row, by which exports name it; 0: not read from a diary.
    """

    at: datetime
    kind: Literal["pain", "sickness", "other"]
    text: str
    number: int = field(default=0, compare=False)

    @property
    def local_date(self) -> date:
        """The day in this machine's time zone, which may differ from that of the record."""
        return local_day(self.at)
