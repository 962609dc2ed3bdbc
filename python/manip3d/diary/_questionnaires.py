"""Questionnaires: questions with whole numbers as answers, and scales computed from the answers.

Two questionnaires are built in, without protected texts; others are read from files.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from manip3d._util.checked import checked
from manip3d._util.json import canonical_json, read_json
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.io._files import limited_bytes, write_new

Method = Literal["sum", "mean", "count"]

_MAX_BYTES = 1 << 20  # far more than any questionnaire has; so are the next limits
_MAX_ITEMS, _MAX_CHOICES, _MAX_NUMBER = 500, 101, 1000
_MAX_NAME, _MAX_TEXT = 200, 1000


@dataclass(frozen=True)
class QuestionnaireItem:
    """A question and the range of its answers.

    Attributes
    ----------
    text : str
        The question.
    low, high : int
        Smallest and largest answer, within -1000 to 1000.
    choices : tuple of str
        Meanings of the answers from ``low`` to ``high``, at most 101; may be empty.
    """

    text: str
    low: int
    high: int
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class QuestionnaireScale:
    """A score that is computed from the answers to some questions.

    Attributes
    ----------
    name : str
    items : tuple of int
        Numbers of the questions that it uses, from 1.
    reverse : tuple of int
        Numbers of the questions among them that are reverse-scored, as ``low + high - answer``.
    method : {"sum", "mean", "count"}
        Computation of the score; ``count``: number of answers above the smallest possible one.
    """

    name: str
    items: tuple[int, ...]
    reverse: tuple[int, ...] = ()
    method: Method = "sum"


@checked
@dataclass(frozen=True)
class Questionnaire:
    """A questionnaire: its questions, and the scales that are scored from the answers.

    Attributes
    ----------
    name : str
    items : tuple of QuestionnaireItem
        The questions, 1 to 500.
    scales : tuple of QuestionnaireScale
        The scales, at most 500.

    Raises
    ------
    InputError
        A text is empty, too long or has control characters; a range is empty; the number of choices
        differs from the number of answers; two scales have the same name; or a scale uses a
        question that does not exist.
    """

    name: str
    items: tuple[QuestionnaireItem, ...]
    scales: tuple[QuestionnaireScale, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _check_text(self.name, "name", _MAX_NAME)
        if not 1 <= len(self.items) <= _MAX_ITEMS or len(self.scales) > _MAX_ITEMS:
            raise InputError(
                f"items, scales: expected 1 to {_MAX_ITEMS} items and at most {_MAX_ITEMS} "
                f"scales, got {len(self.items)} and {len(self.scales)}"
            )
        for number, item in enumerate(self.items, 1):
            _check_item(item, f"items[{number}]")
        for number, scale in enumerate(self.scales, 1):
            _check_scale(scale, f"scales[{number}]", len(self.items))
        names = [scale.name for scale in self.scales]
        if len(set(names)) != len(names):
            raise InputError("scales: expected names that differ")

    @property
    def sha256(self) -> str:
        """SHA-256 of the definition, hexadecimal; it distinguishes wordings of a questionnaire."""
        return hashlib.sha256(canonical_json(definition_of(self))).hexdigest()

    @checked
    def scores_like(self, other: Questionnaire) -> bool:
        """Return whether equal answers have equal scores, whatever the texts are.

        Parameters
        ----------
        other : Questionnaire

        Returns
        -------
        bool
        """
        ranges, others = ([(i.low, i.high) for i in one.items] for one in (self, other))
        return ranges == others and self.scales == other.scales

    @checked
    def score(self, answers: Sequence[int]) -> dict[str, float]:
        """Score the answers.

        Parameters
        ----------
        answers : sequence of int
            Answer to each question.

        Returns
        -------
        dict of str to float
            Scores by the names of the scales; sums and counts are whole numbers.

        Raises
        ------
        InputError
            The number of answers is wrong, or an answer is out of range.
        """
        self.check_answers(answers)
        given = [int(answer) for answer in answers]  # NumPy's integers become Python's
        return {scale.name: self._score(scale, given) for scale in self.scales}

    @checked
    def check_answers(self, answers: Sequence[int]) -> None:
        """Refuse answers that the questionnaire does not allow.

        Parameters
        ----------
        answers : sequence of int
            Answer to each question.

        Raises
        ------
        InputError
            The number of answers is wrong, or an answer is out of range.
        """
        if len(answers) != len(self.items):
            raise InputError(f"answers: expected {len(self.items)}, got {len(answers)}")
        for number, (answer, item) in enumerate(zip(answers, self.items, strict=True), 1):
            if not item.low <= answer <= item.high:
                raise InputError(
                    f"answers: expected {item.low} to {item.high} for question {number}, "
                    f"got {answer!r}"
                )

    def _score(self, scale: QuestionnaireScale, answers: Sequence[int]) -> float:
        values = []
        for number in scale.items:
            item, answer = self.items[number - 1], answers[number - 1]
            value = item.low + item.high - answer if number in scale.reverse else answer
            values.append(int(value > item.low) if scale.method == "count" else value)
        return sum(values) / len(values) if scale.method == "mean" else sum(values)


def _check_text(text: object, name: str, most: int) -> None:
    if not isinstance(text, str) or not text.strip() or len(text) > most or not text.isprintable():
        raise InputError(
            f"{name}: expected a text of 1 to {most} characters without control characters, got "
            f"{_shown(text)}"
        )


def _shown(value: object) -> str:
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_item(item: QuestionnaireItem, name: str) -> None:
    _check_text(item.text, f"{name}.text", _MAX_TEXT)
    ends = (item.low, item.high)
    whole = all(_is_whole(end) and abs(end) <= _MAX_NUMBER for end in ends)
    if not whole or not item.low < item.high:
        raise InputError(
            f"{name}: expected whole numbers low < high within -{_MAX_NUMBER} to {_MAX_NUMBER}, "
            f"got {_shown(item.low)} and {_shown(item.high)}"
        )
    answers = item.high - item.low + 1
    if item.choices and (len(item.choices) != answers or answers > _MAX_CHOICES):
        raise InputError(
            f"{name}.choices: expected a text for each of the {answers} answers, at most "
            f"{_MAX_CHOICES}, got {len(item.choices)}"
        )
    for choice in item.choices:
        _check_text(choice, f"{name}.choices", _MAX_TEXT)


def _check_scale(scale: QuestionnaireScale, name: str, items: int) -> None:
    _check_text(scale.name, f"{name}.name", _MAX_NAME)
    for numbers, told in ((scale.items, "items"), (scale.reverse, "reverse")):
        good = all(_is_whole(one) and 1 <= one <= items for one in numbers)
        if not good or len(set(numbers)) != len(numbers):
            raise InputError(
                f"{name}.{told}: expected different numbers of questions, 1 to {items}, got "
                f"{_shown(list(numbers))}"
            )
    if not scale.items or not set(scale.reverse) <= set(scale.items):
        raise InputError(f"{name}: expected at least one question, and to reverse only its own")
    if scale.method not in get_args(Method):
        raise InputError(
            f"{name}.method: expected {', '.join(get_args(Method))}, got {_shown(scale.method)}"
        )


# --- files ----------------------------------------------------------------------------------------


@checked
def load_questionnaire(path: str | os.PathLike[str]) -> Questionnaire:
    """Read a questionnaire from a JSON file.

    The file contains an object with ``name``, ``items`` (objects with ``text``, ``low``, ``high``
    and optionally ``choices``) and ``scales`` (objects with ``name``, ``items`` and optionally
    ``reverse`` and ``method``); see `Questionnaire`. `write_questionnaire` writes such files.

    Parameters
    ----------
    path : path
        File to read, at most 1 MiB.

    Returns
    -------
    Questionnaire

    Raises
    ------
    FormatError
        The file is not such JSON: a key is unknown, repeated or missing, or `Questionnaire` does
        not accept a value.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.diary import load_questionnaire
    >>> _ = Path("mood.json").write_text('''{"name": "Mood", "items":
    ...   [{"text": "I feel well.", "low": 0, "high": 3},
    ...    {"text": "I am sad.", "low": 0, "high": 3}],
    ...   "scales": [{"name": "mood", "items": [1, 2], "reverse": [2]}]}''')
    >>> load_questionnaire("mood.json").score([3, 0])
    {'mood': 6}
    """
    file = path_of(path)
    content = limited_bytes(file, _MAX_BYTES)
    try:
        return questionnaire_of(read_json(content.decode("utf-8-sig")))
    except (InputError, FormatError) as error:
        raise FormatError(str(error), file=str(file)) from None
    except (ValueError, RecursionError) as error:
        raise FormatError(f"expected JSON: {error}", file=str(file)) from None


@checked
def write_questionnaire(questionnaire: Questionnaire, path: str | os.PathLike[str]) -> None:
    """Write a questionnaire as a JSON file that people can edit and `load_questionnaire` reads.

    For instance, the texts of `MCGILL` can be replaced by a licensed wording in this way.

    Parameters
    ----------
    questionnaire : Questionnaire
        Questionnaire whose names, texts and scales are written; default values are left out.
    path : path
        File to write. An existing file is never replaced, because it may contain edited texts.

    Raises
    ------
    OSError
        The file already exists (`FileExistsError`), or cannot be written.

    Examples
    --------
    >>> from manip3d.diary import MCGILL, load_questionnaire, write_questionnaire
    >>> write_questionnaire(MCGILL, "mcgill.json")
    >>> load_questionnaire("mcgill.json") == MCGILL
    True
    """
    text = json.dumps(definition_of(questionnaire), indent=1, ensure_ascii=False)
    write_new(path_of(path), f"{text}\n".encode())


def definition_of(questionnaire: Questionnaire) -> dict[str, Any]:
    """Return a questionnaire as a JSON object without its default values."""
    items = [
        {"text": item.text, "low": item.low, "high": item.high}
        | ({"choices": list(item.choices)} if item.choices else {})
        for item in questionnaire.items
    ]
    scales = [
        {"name": scale.name, "items": list(scale.items)}
        | ({"reverse": list(scale.reverse)} if scale.reverse else {})
        | ({"method": scale.method} if scale.method != "sum" else {})
        for scale in questionnaire.scales
    ]
    return {"name": questionnaire.name, "items": items, "scales": scales}


def questionnaire_of(found: object) -> Questionnaire:
    """Read a definition made by `definition_of` or by hand; raise InputError if it is invalid."""
    fields = _fields(found, "questionnaire", ("name", "items"), ("scales",))
    items = [
        _fields(one, f"items[{number}]", ("text", "low", "high"), ("choices",))
        for number, one in enumerate(_list(fields["items"], "items"), 1)
    ]
    scales = [
        _fields(one, f"scales[{number}]", ("name", "items"), ("reverse", "method"))
        for number, one in enumerate(_list(fields.get("scales", []), "scales"), 1)
    ]
    for parts, place in ((items, "items"), (scales, "scales")):
        for number, part in enumerate(parts, 1):
            for name in ("items", "reverse", "choices"):
                if name in part:
                    part[name] = tuple(_list(part[name], f"{place}[{number}].{name}"))
    return Questionnaire(
        fields["name"],
        tuple(QuestionnaireItem(**item) for item in items),
        tuple(QuestionnaireScale(**scale) for scale in scales),
    )


def _fields(
    found: object, name: str, needed: Sequence[str], others: Sequence[str]
) -> dict[str, Any]:
    if not isinstance(found, Mapping):
        raise InputError(f"{name}: expected an object, got {_shown(found)}")
    missing = sorted(set(needed) - set(found))
    if missing:
        raise InputError(f"{name}: expected {missing[0]}, found none")
    unknown = sorted(set(found) - {*needed, *others})
    if unknown:
        raise InputError(f"{name}: expected no key {_shown(unknown[0])}")
    return dict(found)


def _list(found: object, name: str) -> list[Any]:
    if not isinstance(found, list):
        raise InputError(f"{name}: expected a list, got {_shown(found)}")
    return found


# --- built in -------------------------------------------------------------------------------------

_GROUPS = (6, 3, 5, 3, 5, 3, 4, 4, 5, 4, 2, 2, 3, 5, 2, 5, 4, 5, 3, 5)

MCGILL = Questionnaire(
    "McGill Pain Questionnaire",
    (
        *(QuestionnaireItem(f"Group {n}", 0, most) for n, most in enumerate(_GROUPS, 1)),
        QuestionnaireItem("Present pain intensity", 0, 5),
    ),
    (
        QuestionnaireScale("sensory", tuple(range(1, 11))),
        QuestionnaireScale("affective", tuple(range(11, 16))),
        QuestionnaireScale("evaluative", (16,)),
        QuestionnaireScale("miscellaneous", tuple(range(17, 21))),
        QuestionnaireScale("pri", tuple(range(1, 21))),
        QuestionnaireScale("nwc", tuple(range(1, 21)), method="count"),
        QuestionnaireScale("ppi", (21,)),
    ),
)
"""The McGill Pain Questionnaire (Melzack, 1975) without its protected words. Answers are the ranks
of the words chosen in 20 groups (0: no word), and the present pain intensity."""

_TOUCH = (
    "It felt as if the limb that I saw were my own.",
    "It felt as if I was touched where I saw the ball touch the limb.",
    "It felt as if the ball that I saw caused the touch.",
    "It felt as if I had one limb more than I have.",
    "My own body felt as if it became stiff or unreal.",
    "The touch seemed to come from somewhere beside me.",
)

OWNERSHIP = Questionnaire(
    "Ownership of the limb after a touch cue",
    tuple(QuestionnaireItem(text, -3, 3) for text in _TOUCH),
    (
        QuestionnaireScale("ownership", (1, 2, 3), method="mean"),
        QuestionnaireScale("control", (4, 5, 6), method="mean"),
    ),
)
"""Questions after a touch cue, about ownership of the limb and controls; answers from -3 (not at
all) to 3 (very much)."""
