"""Steps of a study: the screens that a participant sees, with texts, stimuli and questions."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError
from manip3d.serve import Kind

FieldType = Literal["choice", "scale", "number", "text", "card"]
"""Type of a question. ``choice``: one of several values; ``scale``: a whole number between two
ends; ``number``: any number between two ends; ``text``: free text; ``card``: the width in pixels of
a bank card that the participant holds to the screen."""

Value: TypeAlias = "int | float | str | None"

NAME = re.compile(r"[a-z][a-z0-9_]{0,25}")
"""Names of fields and questions: REDCap's rule for variables, and its recommended length."""

CARD_MM = 85.60
"""Width of a bank card, millimetres [ISO/IEC 7810, ID-1]."""

CONSENT, ABOUT = "consent", "about"
"""Ids of the steps that ask for the consent and for the participant's group and person."""

MAX_TEXT = 2000
"""Largest number of characters of a free text."""


@dataclass(frozen=True)
class Field:
    """One question of a step.

    Attributes
    ----------
    name : str
        Name, unique in its step, which matches `NAME`.
    label : str
        The question.
    type : FieldType
    choices : sequence of (str, str)
        Values and labels of a choice.
    low, high : float
        Smallest and largest value of a scale, a number or a card.
    ends : (str, str)
        Meanings of the ends of a scale.
    optional : bool
        Whether the answer may be left empty.
    is_side : bool
        Whether it is a choice between the stimuli, whose buttons are shown below them.
    """

    name: str
    label: str
    type: FieldType
    choices: Sequence[tuple[str, str]] = ()
    low: float = 0.0
    high: float = 0.0
    ends: tuple[str, str] = ("", "")
    optional: bool = False
    is_side: bool = False

    @property
    def kind(self) -> Kind:
        """Accepted values of an answer in a message."""
        if self.type == "text":
            return Kind(str, length=MAX_TEXT)
        if self.type == "choice":
            values = [value for value, _ in self.choices]
            return Kind(str, choices=[*values, ""] if self.optional else values)
        if self.optional:
            return Kind(str, length=24)  # the number as text, or an empty text
        return Kind(int if self.type == "scale" else float, self.low, self.high)

    def read(self, value: int | float | str) -> Value:
        """Return the answer in a message; None: it was left empty.

        Parameters
        ----------
        value : int, float or str
            Value of the message, as accepted by `kind`.

        Raises
        ------
        FormatError
            The value is not an answer to this question.
        """
        if self.optional and value == "":
            return None
        if self.type == "text":
            text = str(value).strip()
            if not text and not self.optional:
                raise FormatError(f"{self.name}: expected a text")
            return text
        if self.type == "choice" or not isinstance(value, str):
            return value
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not self.low <= number <= self.high:
            raise FormatError(f"{self.name}: expected {self.low:g} to {self.high:g}")
        if self.type != "scale":
            return number
        if not number.is_integer():
            raise FormatError(f"{self.name}: expected a whole number")
        return int(number)

    def message(self) -> dict[str, Any]:
        """Description of the field for the page."""
        return {
            "name": self.name,
            "label": self.label,
            "type": self.type,
            "choices": [list(choice) for choice in self.choices],
            "low": self.low,
            "high": self.high,
            "ends": list(self.ends),
            "optional": self.optional,
            "is_side": self.is_side,
        }


@dataclass(frozen=True)
class Stimulus:
    """A picture, clip or mesh that is shown.

    Attributes
    ----------
    address : str
        Path at which the page fetches it, which does not reveal its content.
    type : {"image", "video", "mesh"}
        Type; animated pictures are images, and meshes are GLB files that make one revolution.
    """

    address: str
    type: Literal["image", "video", "mesh"]


@dataclass(frozen=True)
class Step:
    """One screen of a study.

    Attributes
    ----------
    id : str
        Unique in the session.
    title : str
    text : sequence of str
        Paragraphs.
    fields : sequence of Field
    stimuli : sequence of Stimulus
    size_deg : float
        Width of a stimulus in visual degrees; 0: as large as the window allows.
    turn_s : float
        Time of one revolution of a mesh, seconds.
    minimum_s : float
        Smallest time for which the step is shown, seconds.
    button : str
        Label of the button that ends the step.
    condition : mapping
        Truth about the stimuli, which is stored with the answer but never sent to the page.
    """

    id: str
    title: str
    text: Sequence[str] = ()
    fields: Sequence[Field] = ()
    stimuli: Sequence[Stimulus] = ()
    size_deg: float = 0.0
    turn_s: float = 0.0
    minimum_s: float = 0.0
    button: str = "Continue"
    condition: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr

    def message(self, *, px_per_degree: float | None) -> dict[str, Any]:
        """Return the description of the step for the page, without the truth.

        Parameters
        ----------
        px_per_degree : float or None
            CSS pixels per visual degree of the participant's screen, by which stimuli are sized;
            None: not measured.
        """
        width = 0.0 if px_per_degree is None else self.size_deg * px_per_degree
        return {
            "type": "step",
            "id": self.id,
            "title": self.title,
            "text": list(self.text),
            "fields": [each.message() for each in self.fields],
            "stimuli": [{"address": s.address, "type": s.type} for s in self.stimuli],
            "width_px": round(width, 2),
            "turn_s": self.turn_s,
            "minimum_s": self.minimum_s,
            "button": self.button,
        }


@checked
def px_per_degree(card_px: float, distance_cm: float) -> float:
    """Return the number of CSS pixels per visual degree in the middle of a screen.

    Parameters
    ----------
    card_px : float
        Width of a bank card on the screen, in CSS pixels.
    distance_cm : float
        Distance from the eyes to the screen, centimetres.

    Returns
    -------
    float

    Examples
    --------
    >>> from manip3d.study import px_per_degree
    >>> round(px_per_degree(323.5, 60.0), 1)  # a screen of 96 dots per inch
    39.6
    """
    return 2.0 * 10.0 * distance_cm * math.tan(math.radians(0.5)) * card_px / CARD_MM
