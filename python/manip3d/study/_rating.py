"""Rating of forgeries as real, manipulated or undecidable, with reasons (section 5.2.2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from manip3d._util.csv_tables import csv_rows
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.study._agreement import fleiss_kappa_interval, share_interval
from manip3d.study._definition import Common, Section
from manip3d.study._engine import SHOWABLE, ListedStudy
from manip3d.study._steps import Field, Step, Value
from manip3d.study._store import Session

VERDICTS = (("real", "Real"), ("manipulated", "Manipulated"), ("undecidable", "Undecidable"))

TRUTHS = ("real", "type1", "type2", "added", "deformed")
"""Truths: real; streams forged by type I and II; LiDAR scans with an object added or deformed."""

_TURN_S = 8.0  # seconds for one revolution of a mesh

MODALITIES = ("depth", "color", "rendered", "surface")
FORMS = ("image", "clip")
RESOLUTIONS = ("full", "low")

MANIFEST = "stimuli.csv"
"""File name of the table in a folder of stimuli, which lists truth and form of each file."""

COLUMNS = ("file", "truth", "modality", "form", "resolution", "background", "example")

PUBLISHED_COMPOSITION: Mapping[tuple[str, str, str], Mapping[str, int]] = {
    ("image", "depth", "full"): {"real": 10, "type1": 15, "type2": 15},
    ("image", "color", "full"): {"real": 10, "type1": 20, "type2": 10},
    ("image", "rendered", "full"): {"real": 10, "type2": 10},
    ("clip", "depth", "full"): {"real": 2, "type1": 2, "type2": 2},
    ("clip", "color", "full"): {"real": 2, "type1": 2, "type2": 2},
    ("clip", "rendered", "full"): {"real": 2, "type1": 2, "type2": 2},
    ("clip", "color", "low"): {"real": 2, "type1": 2, "type2": 2},
}
"""Number of stimuli by form, modality and resolution, then by truth (section 5.2.2). The section
says that some colour videos had low resolution, but not how many."""

PUBLISHED_UNABLE_PERCENT = 76.0
"""Published percentage for low-resolution colour videos: "unable to identify the difference 76% of
the time" (section 5.2.2)."""


@dataclass(frozen=True)
class Item:
    """One stimulus; attributes are the columns of `MANIFEST`.

    Attributes
    ----------
    file, truth, modality, form, resolution, background : str
    example : bool
        Whether it is shown before the questions as an example of the quality, without a question.
    """

    file: str
    truth: str
    modality: str
    form: str
    resolution: str
    background: str = ""
    example: bool = False

    @property
    def arm(self) -> tuple[str, str, str]:
        """Form, modality, resolution."""
        return self.form, self.modality, self.resolution


def read_items(folder: Path) -> tuple[Item, ...]:
    """Return the stimuli of a folder, as its `MANIFEST` lists them.

    Raises
    ------
    InputError
        There is no such table.
    FormatError
        A line is wrong, or names a file that is not in the folder.
    OSError
        The table cannot be read.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError(
            f"{path}: expected a list of stimuli, found none; 'manip3d study stimuli' makes it"
        )
    rows = csv_rows(path)
    line, head = next(rows, (1, []))
    if tuple(head) != COLUMNS:
        raise FormatError(f"line {line}: expected {','.join(COLUMNS)}", file=str(path))
    found: list[Item] = []
    files: set[str] = set()
    for number, row in rows:
        item = _item(row, number, path)
        if item.file in files:
            raise FormatError(f"line {number}: {item.file} is there twice", file=str(path))
        if not (folder / item.file).is_file():
            raise FormatError(f"line {number}: there is no file {item.file}", file=str(path))
        files.add(item.file)
        found.append(item)
    return tuple(found)


_TEXTS = tuple(each.name for each in fields(Item) if each.name != "example")


def _item(row: Sequence[str], number: int, path: Path) -> Item:
    if len(row) != len(COLUMNS):
        raise FormatError(
            f"line {number}: expected {len(COLUMNS)} columns, got {len(row)}", file=str(path)
        )
    named = dict(zip(COLUMNS, row, strict=True))
    for column, words in (
        ("truth", TRUTHS),
        ("modality", MODALITIES),
        ("form", FORMS),
        ("resolution", RESOLUTIONS),
        ("example", ("", "0", "1")),
    ):
        if named[column] not in words:
            raise FormatError(
                f"line {number}: {column}: expected {', '.join(filter(None, words))}, "
                f"got {named[column]!r}",
                file=str(path),
            )
    name = named["file"]
    if Path(name).name != name or Path(name).suffix.lower() not in SHOWABLE or "\0" in name:
        raise FormatError(
            f"line {number}: file: expected a name that ends in {', '.join(SHOWABLE)}, "
            f"got {name!r}",
            file=str(path),
        )
    texts = {name: named[name] for name in _TEXTS}
    return Item(**texts, example=named["example"] == "1")


@dataclass(frozen=True)
class RatingStudy(ListedStudy):
    """A study in which people distinguish forged from real stimuli.

    Attributes
    ----------
    common : Common
    items : sequence of Item
        Stimuli; empty if the study is read for its answers only.
    reason : {"required", "optional", "none"}
        Whether a reason is asked for.
    stimuli : Path or None
        Folder of the stimuli.
    """

    common: Common
    items: tuple[Item, ...]
    reason: str
    stimuli: Path | None
    _keys: Mapping[Item, str] = field(init=False, repr=False, compare=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        keys = {item: f"i{place:03d}" for place, item in enumerate(self.items)}
        object.__setattr__(self, "_keys", keys)

    @classmethod
    def read(cls, top: Section, base: Path | None) -> RatingStudy:
        """Read the study from a definition, and the stimuli that it names.

        Parameters
        ----------
        top : Section
            The whole definition.
        base : Path or None
            Folder that relative paths start from; None: the definition contains the items.

        Raises
        ------
        FormatError
            A key is missing, unknown, or has a wrong value.
        """
        common = Common.read(top, ("rating",))
        own = top.section("rating")
        composition = own.word("composition", ("published", "any"), "published")
        reason = own.word("reason", ("required", "optional", "none"), "optional")
        folder = own.text("stimuli")
        stimuli = None if base is None else base / folder
        stored = [] if base is not None else own.sections("items", least=0, most=10_000)
        items = _stored_items(stored) if stimuli is None else read_items(stimuli)
        own.finish()
        top.finish()
        if composition == "published" and stimuli is not None:
            _check_composition(items, stimuli)
        if stimuli is not None and not any(not item.example for item in items):
            raise FormatError("expected stimuli, found none", file=str(stimuli / MANIFEST))
        return cls(common, items, reason, stimuli)

    def _asked(self) -> list[Item]:
        return [item for item in self.items if not item.example]

    def _key(self, item: Item) -> str:
        return self._keys[item]

    def steps(self, session: Session) -> list[Step]:
        """Return all steps of the study's own, in this participant's order.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        found = []
        examples = [item for item in self.items if item.example]
        for number, item in enumerate(examples):
            found.append(
                Step(
                    f"{self._key(item)}_example",
                    f"Example {number + 1} of {len(examples)}",
                    ("It shows the quality to expect. Nothing is asked about it.",),
                    stimuli=(self.stimulus(item.file),),
                    turn_s=_TURN_S,
                    condition={"example": item.file},
                )
            )
        asked = self._asked()
        questions = [
            Field("verdict", "What is this?", "choice", VERDICTS),
            Field("reason", "What tells you so?", "text", optional=self.reason == "optional"),
        ][: 1 if self.reason == "none" else 2]
        for number, place in enumerate(self.order(session, "items", len(asked))):
            item = asked[place]
            found.append(
                Step(
                    self._key(item),
                    f"{'Image' if item.form == 'image' else 'Video'} {number + 1} of {len(asked)}",
                    (),
                    tuple(questions),
                    (self.stimulus(item.file),),
                    turn_s=_TURN_S,
                    condition={name: getattr(item, name) for name in COLUMNS if name != "example"},
                )
            )
        return found

    def progress(self, session: Session) -> float:
        count = len(self.items)
        done = sum(
            answer.step.startswith("i") and answer.step != "introduction"
            for answer in session.answers
        )
        return done / count if count else 1.0

    def files(self) -> Mapping[str, Path]:
        if self.stimuli is None:
            return {}
        return {item.file: self.stimuli / item.file for item in self.items}

    def variables(self) -> Sequence[tuple[str, Field]]:
        found = []
        for item in self._asked():
            part = " ".join((item.modality, item.form, item.resolution))
            key = self._key(item)
            verdict = Field(f"{key}_verdict", f"{item.file}: verdict", "choice", VERDICTS)
            found.append((part, verdict))
            if self.reason != "none":
                why = Field(f"{key}_reason", f"{item.file}: reason", "text", optional=True)
                found.append((part, why))
        return found

    def wide(self, session: Session) -> dict[str, Value]:
        return {
            f"{answer.step}_{name}": value
            for answer in session.answers
            if "truth" in answer.condition
            for name, value in answer.values.items()
        }

    def _has_rated_all(self, session: Session) -> bool:
        rated = {a.condition["file"] for a in session.answers if "truth" in a.condition}
        return rated >= {item.file for item in self._asked()}

    def simulate(self, session: Session, step: Step, rng: np.random.Generator) -> dict[str, Value]:
        if not step.fields:
            return {}
        own = "real" if step.condition["truth"] == "real" else "manipulated"
        other = "manipulated" if own == "real" else "real"
        shares = [0.3, 0.2, 0.5] if step.condition["resolution"] == "low" else [0.55, 0.25, 0.2]
        values: dict[str, Value] = {
            "verdict": str(rng.choice([own, other, "undecidable"], p=shares))
        }
        if self.reason != "none":
            values["reason"] = "simulated"
        return values

    def summary(self, sessions: Sequence[Session]) -> list[dict[str, Any]]:
        """Return confusion and agreement: one row for each form, modality, resolution and truth.

        Parameters
        ----------
        sessions : sequence of Session
            One per participant.

        Returns
        -------
        list of dict
            Numbers of answers by verdict; percentages right, undecidable and not right with 95 %
            intervals (Wilson's, which assume independent answers, although answers of one person
            are correlated). Rows with truth ``all`` also have Fleiss' kappa with its numbers of
            raters and items, and the published percentage. Raters are the participants who rated
            every stimulus of the study.
        """
        answers = [
            answer
            for session in sessions
            for answer in session.answers
            if "truth" in answer.condition
        ]
        finished = [answer for s in sessions if self._has_rated_all(s) for answer in s.answers]
        arms = sorted({_arm(answer.condition) for answer in answers})
        rows = []
        for arm in arms:
            own = [answer for answer in answers if _arm(answer.condition) == arm]
            truths = [t for t in TRUTHS if any(a.condition["truth"] == t for a in own)]
            for truth in (*truths, "all"):
                chosen = [a for a in own if truth in ("all", a.condition["truth"])]
                row = dict(zip(("form", "modality", "resolution"), arm, strict=True))
                rows.append(row | {"truth": truth} | _counted(chosen))
            rows[-1] |= _agreement(
                [a for a in finished if "truth" in a.condition and _arm(a.condition) == arm]
            )
            is_published = arm == ("clip", "color", "low")
            rows[-1]["published_unable_percent"] = (
                PUBLISHED_UNABLE_PERCENT if is_published else None
            )
        return rows


def _stored_items(sections: Sequence[Section]) -> tuple[Item, ...]:
    """Read the stimuli from a definition that is stored with its answers."""
    found = []
    for each in sections:
        background = each.text("background") if each.has("background") else ""
        found.append(
            Item(
                each.text("file"),
                each.word("truth", TRUTHS),
                each.word("modality", MODALITIES),
                each.word("form", FORMS),
                each.word("resolution", RESOLUTIONS),
                background,
                each.flag("example", False),
            )
        )
        each.finish()
    return tuple(found)


def _arm(condition: Mapping[str, Any]) -> tuple[str, str, str]:
    return str(condition["form"]), str(condition["modality"]), str(condition["resolution"])


def _counted(answers: Sequence[Any]) -> dict[str, Any]:
    verdicts = Counter(str(answer.values["verdict"]) for answer in answers)
    right = sum(
        answer.values["verdict"]
        == ("real" if answer.condition["truth"] == "real" else "manipulated")
        for answer in answers
    )
    count = len(answers)
    row: dict[str, Any] = {name: verdicts[name] for name, _ in VERDICTS}
    for name, hits in (
        ("right", right),
        ("undecidable", verdicts["undecidable"]),
        ("unable", count - right),
    ):
        found = share_interval(hits, count)
        row[f"{name}_percent"] = 100 * found.value
        row[f"{name}_low"], row[f"{name}_high"] = 100 * found.low, 100 * found.high
    return row


def _agreement(answers: Sequence[Any]) -> dict[str, Any]:
    """Compute Fleiss' kappa of people who have all rated the same items."""
    names = [name for name, _ in VERDICTS]
    by_item: dict[str, Counter[str]] = {}
    for answer in answers:
        by_item.setdefault(str(answer.condition["file"]), Counter())[
            str(answer.values["verdict"])
        ] += 1
    raters = max((counts.total() for counts in by_item.values()), default=0)
    row: dict[str, Any] = {"raters": raters, "items": len(by_item)}
    if raters < 2:
        return row | {"kappa": None, "kappa_low": None, "kappa_high": None}
    found = fleiss_kappa_interval([[c[name] for name in names] for c in by_item.values()])
    return row | {"kappa": found.value, "kappa_low": found.low, "kappa_high": found.high}


def _check_composition(items: Sequence[Item], folder: Path) -> None:
    found: dict[tuple[str, str, str], Counter[str]] = {}
    for item in items:
        if not item.example and item.modality != "surface":
            found.setdefault(item.arm, Counter())[item.truth] += 1
    for arm in sorted({*found, *PUBLISHED_COMPOSITION}):
        wanted, got = dict(PUBLISHED_COMPOSITION.get(arm, {})), dict(found.get(arm, {}))
        if wanted != got:
            raise FormatError(
                f"{' '.join(arm)}: expected the published composition {wanted or 'without these'}, "
                f'got {got or "none"}; composition = "any" accepts others',
                file=str(folder / MANIFEST),
            )
