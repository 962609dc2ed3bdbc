"""Records of a diary."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import date, datetime
from pathlib import Path
from typing import Literal

from manip3d.diary._mcgill import McGillScore
from manip3d.diary._questionnaires import OWNERSHIP, Questionnaire
from manip3d.errors import FormatError, InputError
from manip3d.io._files import regular_bytes, sha256_of

Moment = Literal["before", "after", "other"]
Occasion = Literal["baseline", "week-1", "week-4", "other"]

CORRECTION_S = 30.0
"""Seconds in which a second rating, before any play, corrects the first one of a session."""

_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def identifier_of(text: str) -> str:
    """The pseudonym of a participant, which file names and tables can hold."""
    if not _IDENTIFIER.fullmatch(text):
        raise InputError(
            "participant: expected up to 64 letters, digits, dots, hyphens and underscores, "
            f"beginning with a letter or digit, got {text!r}"
        )
    return text


def aware(moment: datetime | None, name: str) -> datetime:
    """The moment, by default now; it must know its offset from UTC."""
    if moment is None:
        return datetime.now().astimezone()
    if moment.tzinfo is None:
        raise InputError(f"{name}: expected a time with its offset from UTC, got {moment}")
    return moment


@dataclass(frozen=True)
class Participant:
    """A participant of the study, under a pseudonym.

    Attributes
    ----------
    identifier : str
        A pseudonym; who it is stands elsewhere.
    limb : str
        The affected one, or empty.
    enrolled : datetime
    clips : bool
        Whether they consented to clips of anomalies.
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
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
        When it was over, or last heard of.
    game : str
    difficulty, seed : int
    ending : str
        ``time``, ``misses``, ``done`` or ``stopped``; ``interrupted`` while it goes on, or where
        the program was killed.
    seconds, paused_s : float
        Played, and waited for the phantom limb.
    score, misses, by_phantom : int
    gain : float
        Gain of the virtual enhancement; 1: none.
    anomalies : tuple of (float, float)
        From and to which second of play no point was made though a target was in reach.
    limb : str
        The limb that was replaced.
    source : str
        Where the frames came from: the whole address of a simulated person, else only its scheme,
        such as ``mkv:``, as names of files may be names of people. Empty: an older diary.
    version : str
        Version of this program.
    latency_ms : float or None
        From a frame's arrival to its being decoded in the page, 95th percentile.
    tracked : float or None
        Share of the frames in which the phantom limb was followed.
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
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
        """Whether the person before the camera was simulated."""
        return self.source.startswith("sim:")

    @property
    def counts(self) -> bool:
        """Whether the game counts for protocol and trends: a person played it to its end."""
        return self.ending not in ("stopped", "interrupted") and not self.is_simulated


@dataclass(frozen=True)
class ExportedFile:
    """An exported copy of a part of the diary.

    Attributes
    ----------
    path : Path
    sha256 : str
        SHA-256 of what it held.
    """

    path: Path
    sha256: str

    @property
    def state(self) -> Literal["unchanged", "changed", "gone"]:
        """Whether the file is there and holds what was written."""
        try:
            now = sha256_of(self.path)
        except FileNotFoundError:
            return "gone"
        except (OSError, FormatError):
            return "changed"
        return "unchanged" if now == self.sha256 else "changed"

    @property
    def has_films(self) -> bool:
        """Whether the file is there and is a film, or a page that shows films."""
        try:
            content = regular_bytes(self.path)
        except (OSError, FormatError):
            return False
        return content[8:12] == b"WEBP" or FILM_IN_PAGE in content


NOT_ANSWERED = "The rating of the pain at the end was not answered."
"""Words of copies for a session that was closed without a last rating."""

FILM_IN_PAGE = b"data:image/webp;base64,"
"""The bytes with which a film on a page begins."""


@dataclass(frozen=True)
class Rating:
    """Intensity of the pain, from 0 (none) to 10 (the worst).

    Attributes
    ----------
    at : datetime
    pain : int
    when : str
        ``before`` the first game or touch cue of a session began, ``after`` that, or ``other``.
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
    """

    at: datetime
    pain: int
    when: Moment
    number: int = field(default=0, compare=False)


def first_pain(ratings: Iterable[Rating]) -> int | None:
    """Return the rating with which later ones of a session are compared.

    That is the first one, or its correction (`CORRECTION_S`). ``ratings`` are sorted by time.
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
            and (rating.at - first.at).total_seconds() <= CORRECTION_S
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
        For `Diary.add_game` and the like.
    started : datetime
    ended : datetime or None
        None while it goes on, or where the program was killed.
    games : tuple of DiaryGame
    ratings : tuple of Rating
    begun : datetime or None
        When the first game or touch cue began.
    answered : bool
        False: the patient was asked for a last rating of the pain and gave none.
    """

    number: int
    started: datetime
    ended: datetime | None
    games: tuple[DiaryGame, ...]
    ratings: tuple[Rating, ...]
    begun: datetime | None = None
    answered: bool = True

    @property
    def pain_before(self) -> int | None:
        """The first rating, where it was given before the first game or touch cue.

        Another one within half a minute corrects it.
        """
        return first_pain(rating for rating in self.ratings if rating.when == "before")

    @property
    def pain_after(self) -> int | None:
        """The last rating since the first game or touch cue began."""
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
    score : McGillScore
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
    """

    at: datetime
    occasion: Occasion
    ranks: tuple[int, ...]
    score: McGillScore
    number: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Ownership:
    """Answers after a touch cue, each from -3 (not at all) to 3 (very much).

    Attributes
    ----------
    at : datetime
    mode : str
        ``synchronous`` or ``asynchronous``.
    answers : tuple of 6 int
        Three about ownership of the limb, then three controls.
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
    """

    at: datetime
    mode: Literal["synchronous", "asynchronous"]
    answers: tuple[int, ...]
    number: int = field(default=0, compare=False)

    @property
    def ownership(self) -> float:
        """Mean of the first three."""
        return OWNERSHIP.score(self.answers)["ownership"]

    @property
    def control(self) -> float:
        """Mean of the others."""
        return OWNERSHIP.score(self.answers)["control"]


@dataclass(frozen=True)
class Answers:
    """A filled-in questionnaire.

    Attributes
    ----------
    at : datetime
    questionnaire : Questionnaire
        As it was asked.
    answers : tuple of int
        One of each question.
    occasion : str
        ``baseline``, ``week-1``, ``week-4`` or ``other``.
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
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
        Felt length in per cent of the intact limb's; how far the hand or foot has moved up into the
        stump.
    raised, bent : int, degrees
        The limb sideways from hanging down; elbow or knee.
    limb : str
        Which one, as ``left_arm``; empty: the one of the enrolment.
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
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
    """An adverse event, as somebody reported it.

    Attributes
    ----------
    at : datetime
    kind : str
        ``pain`` (2 or more above the rating before the session), ``sickness`` or ``other``.
    text : str
    number : int
        Number of its row, by which copies name it; 0: it was not read from a diary.
    """

    at: datetime
    kind: Literal["pain", "sickness", "other"]
    text: str
    number: int = field(default=0, compare=False)

    @property
    def local_date(self) -> date:
        """The day in the time zone of this machine, which may not be where it was written down."""
        return self.at.astimezone().date()
