"""Study of displays: each participant uses several displays and rates each (section 4.5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from manip3d._util.reprs import short_repr
from manip3d.study._definition import ALL, Common, Section
from manip3d.study._engine import ListedStudy
from manip3d.study._steps import Field, Step, Value
from manip3d.study._store import Session

LIKERT = 7  # answers go from 1 to this
ENDS = ("strongly agree", "strongly disagree")
# Scores from 1 to 3 agree, 4 is neutral. The dissertation does not say which scores it counts.
_AGREE = 3


@dataclass(frozen=True)
class Part:
    """Questions under a common title.

    Attributes
    ----------
    title : str
    questions : sequence of (str, str, str)
        Name, wording, and topic of the published percentage; an empty topic: nothing published.
    """

    title: str
    questions: tuple[tuple[str, str, str], ...]


PUBLISHED_AGREE: Mapping[str, Mapping[str, float]] = {
    "finding": {"Oculus Rift": 100.0, "3D TV": 92.59},
    "realistic": {"3D TV": 100.0, "Oculus Rift": 100.0, "Gear VR": 92.6},
    "no_delay": {"3D TV": 88.89, "Oculus Rift": 92.59, "Gear VR": 74.07},
}
"""Percentage of the 27 participants who agreed, from section 4.5.1, by topic and display."""


@dataclass(frozen=True)
class DisplayStudy(ListedStudy):
    """The displays study.

    Attributes
    ----------
    common : Common
    displays : sequence of str
    counterbalanced : bool
        Whether the participants of each group get different orders in turn. If false, the order is
        that of ``displays``, as published. For up to three displays all orders are used; for more,
        the rows of a Williams square, in which each display follows each other one equally often.
    familiarisation_s : float
        Duration of familiarisation with each display, seconds.
    task : sequence of str
        Paragraphs shown after familiarisation.
    parts : sequence of Part
    """

    common: Common
    displays: tuple[str, ...]
    counterbalanced: bool
    familiarisation_s: float
    task: tuple[str, ...]
    parts: tuple[Part, ...]
    _orders: tuple[tuple[int, ...], ...] = field(init=False, repr=False, compare=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        count = len(self.displays)
        orders = _williams(count) if count > 3 else list(permutations(range(count)))
        # Shuffle the orders, so that the first participants do not all begin with one display.
        mixed = np.random.default_rng(self.common.seed).permutation(len(orders))
        object.__setattr__(self, "_orders", tuple(orders[int(n)] for n in mixed))

    @classmethod
    def read(cls, top: Section, base: Path | None) -> DisplayStudy:
        """Read the study from a definition.

        Parameters
        ----------
        top : Section
            The whole definition.
        base : Path or None
            Not used: the study has no files of its own.

        Raises
        ------
        FormatError
            A key is missing, unknown, or has a wrong value.
        """
        common = Common.read(top, ("display",))
        own = top.section("display")
        parts = tuple(_part(section) for section in own.sections("parts", most=20))
        names = [name for part in parts for name, _, _ in part.questions]
        for name in names:
            if names.count(name) > 1:
                own.fail("parts", f"each question's name once; {name} is there twice")
        found = cls(
            common=common,
            displays=own.texts("displays", least=1, most=6),
            counterbalanced=own.word("order", ("counterbalanced", "published")) != "published",
            familiarisation_s=own.number("familiarisation_s", 0, 3600, 180.0),
            task=own.texts("task"),
            parts=parts,
        )
        own.finish()
        top.finish()
        return found

    @property
    def num_orders(self) -> int:
        return len(self._orders) if self.counterbalanced else 1

    def order_of(self, session: Session) -> list[str]:
        """Return the displays in this participant's order.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        if not self.counterbalanced:
            return list(self.displays)
        order = self._orders[session.assigned % len(self._orders)]
        # Displays already seen keep their places, because an earlier version of this program may
        # have used other orders.
        seen = list(
            dict.fromkeys(
                str(answer.condition["display"])
                for answer in session.answers
                if answer.condition.get("display") in self.displays
            )
        )
        return seen + [self.displays[n] for n in order if self.displays[n] not in seen]

    def steps(self, session: Session) -> list[Step]:
        """Return all steps of the study's own.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        found = []
        for number, display in enumerate(self.order_of(session)):
            truth = {"display": display, "session": number + 1}
            key = f"d{number + 1}"
            of_all = f"Session {number + 1} of {len(self.displays)}: {display}"
            seconds = self.familiarisation_s
            amount, unit = (seconds / 60, "minute") if seconds >= 60 else (seconds, "second")
            long = f"{amount:g} {unit}" if amount == 1 else f"{amount:g} {unit}s"
            found.append(
                Step(
                    f"{key}_familiarisation",
                    of_all,
                    (f"Move about and explore the virtual game environment for {long}.",),
                    minimum_s=self.familiarisation_s,
                    condition=truth,
                )
            )
            found.append(
                Step(f"{key}_task", of_all, self.task, condition=truth, button="I have finished")
            )
            for place, part in enumerate(self.parts):
                fields = tuple(
                    Field(name, wording, "scale", low=1, high=LIKERT, ends=ENDS)
                    for name, wording, _ in part.questions
                )
                title = f"{display}: {part.title}"
                found.append(Step(f"{key}_part{place + 1}", title, (), fields, condition=truth))
        found.append(
            Step(
                "comments",
                "Your remarks",
                (),
                (
                    Field("positive", "What did you like?", "text", optional=True),
                    Field("negative", "What did you not like?", "text", optional=True),
                ),
            )
        )
        return found

    def progress(self, session: Session) -> float:
        steps = {step.id for step in self.steps(session)}
        return len(steps & {answer.step for answer in session.answers}) / len(steps)

    def files(self) -> Mapping[str, Path]:
        return {}

    def variables(self) -> Sequence[tuple[str, Field]]:
        """Return the session, the scores of all questions for each display, and the remarks."""
        found = []
        for number, display in enumerate(self.displays):
            found.append(
                (
                    display,
                    Field(
                        f"d{number + 1}_session",
                        f"{display}: session",
                        "number",
                        low=1,
                        high=len(self.displays),
                    ),
                )
            )
            for part in self.parts:
                found += [
                    (
                        f"{display}: {part.title}",
                        Field(
                            f"d{number + 1}_{name}", wording, "scale", low=1, high=LIKERT, ends=ENDS
                        ),
                    )
                    for name, wording, _ in part.questions
                ]
        found += [
            ("Remarks", Field(name, label, "text", optional=True))
            for name, label in (
                ("positive", "What did you like?"),
                ("negative", "What did you not like?"),
            )
        ]
        return found

    def wide(self, session: Session) -> dict[str, Value]:
        row: dict[str, Value] = {}
        for answer in session.answers:
            if "display" in answer.condition:
                key = f"d{self.displays.index(str(answer.condition['display'])) + 1}"
                row[f"{key}_session"] = int(answer.condition["session"])
                row |= {f"{key}_{name}": value for name, value in answer.values.items()}
            elif answer.step == "comments":
                row |= answer.values
        return row

    def simulate(self, session: Session, step: Step, rng: np.random.Generator) -> dict[str, Value]:
        return {
            each.name: "" if each.type == "text" else int(rng.binomial(LIKERT - 1, 0.2)) + 1
            for each in step.fields
        }

    def summary(self, sessions: Sequence[Session]) -> list[dict[str, Any]]:
        """Return histograms: one row for each group, display and question.

        Parameters
        ----------
        sessions : sequence of Session
            One per participant.

        Returns
        -------
        list of dict
            Group (empty: all), display, part, question, counts of the scores 1 to 7, percent who
            agreed (scores 1 to 3), and the published percentage or None.
        """
        rows = []
        for group in ("", *self.common.groups):
            chosen = [s for s in sessions if group in ("", s.group)]
            for number, display in enumerate(self.displays):
                for part in self.parts:
                    for name, wording, topic in part.questions:
                        key = f"d{number + 1}_{name}"
                        given = [self.wide(session).get(key) for session in chosen]
                        scores = np.array([g for g in given if g is not None], np.int64)
                        counts = np.bincount(scores, minlength=LIKERT + 1)[1:]
                        answered = int(counts.sum())
                        agree = float(100 * counts[:_AGREE].sum() / answered) if answered else None
                        published = None if group else PUBLISHED_AGREE.get(topic, {}).get(display)
                        rows.append(
                            {
                                "group": group or ALL,
                                "display": display,
                                "part": part.title,
                                "question": name,
                                "wording": wording,
                                **{f"score_{n + 1}": int(c) for n, c in enumerate(counts)},
                                "answers": answered,
                                "agree_percent": agree,
                                "published_percent": published,
                            }
                        )
        return rows


def _williams(count: int) -> list[tuple[int, ...]]:
    """Return the rows of a Williams square [Williams, Aust. J. Sci. Res. A 2, 1949].

    Each item occurs at each position, and directly after each other item, equally often: once for
    an even ``count``, twice for an odd one, for which the mirrored rows are added.
    """
    first = [
        (place + 1) // 2 if place % 2 else (count - place // 2) % count for place in range(count)
    ]
    rows = [tuple((thing + shift) % count for thing in first) for shift in range(count)]
    return rows if count % 2 == 0 else rows + [row[::-1] for row in rows]


def _part(section: Section) -> Part:
    title = section.text("title", most=200)
    questions = []
    for each in section.sections("questions", most=40):
        name = each.name("name")
        if len(name) > 20:
            each.fail("name", "at most 20 characters")
        topic = each.word("topic", tuple(PUBLISHED_AGREE)) if each.has("topic") else ""
        if each.has("about"):
            each.text("about")
        wording = each.text("text", most=400)
        questions.append((name, wording, topic))
        each.finish()
    section.finish()
    return Part(title, tuple(questions))
