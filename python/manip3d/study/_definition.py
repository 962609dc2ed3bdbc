"""Definitions of studies: TOML or JSON files filled in by a researcher; unknown keys are errors."""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from manip3d._util.arrays import one_line
from manip3d._util.paths import path_of
from manip3d.errors import FormatError
from manip3d.io._files import limited_bytes
from manip3d.study._steps import NAME, Field

MAX_BYTES = 1 << 20
"""Largest size of a definition, bytes."""

ALL = "all"
"""Name of all groups together in results."""


class Section:
    """One table of a definition, read key by key; keys that were not read are errors.

    Parameters
    ----------
    table : mapping
        Keys and values.
    place : str
        Path of the table from the top of the file, for messages.
    file : str
        Name of the file, for messages.
    """

    def __init__(self, table: Mapping[str, Any], place: str = "", file: str = "") -> None:
        self._table, self._place, self._file = table, place, file
        self._left = set(table)

    def fail(self, key: str, expected: str) -> NoReturn:
        """Raise an error about a key.

        Raises
        ------
        FormatError
            Always; the message names the key and what was expected.
        """
        got = f", got {one_line(self._table[key], 60)}" if key in self._table else ""
        raise FormatError(f"{self._at(key)}: expected {expected}{got}", file=self._file)

    def has(self, key: str) -> bool:
        """Return whether the table has the key."""
        return key in self._table

    def text(self, key: str, default: str | None = None, *, most: int = 4000) -> str:
        """Read a text that is not empty."""
        value = self._take(key, default, "a text")
        if not isinstance(value, str) or not value.strip():
            self.fail(key, "a text that is not empty")
        if len(value) > most or any(ord(sign) < 32 and sign not in "\n\t" for sign in value):
            self.fail(key, f"at most {most} characters, none of them a control character")
        return value.strip()

    def name(self, key: str) -> str:
        """Read the name of a variable."""
        value = self.text(key)
        if not NAME.fullmatch(value):
            self.fail(key, "a small letter, then small letters, digits and _, at most 26 in all")
        return value

    def word(self, key: str, words: Sequence[str], default: str | None = None) -> str:
        """Read one of the given words."""
        value = self._take(key, default, f"one of {', '.join(words)}")
        if not isinstance(value, str) or value not in words:
            self.fail(key, f"one of {', '.join(words)}")
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Read a number from ``low`` to ``high``."""
        value = self._take(key, default, f"a number from {low:g} to {high:g}")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (is_number and low <= value <= high and math.isfinite(value)):
            self.fail(key, f"a number from {low:g} to {high:g}")
        return float(value)

    def whole(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Read a whole number from ``low`` to ``high``."""
        value = self._take(key, default, f"a whole number from {low} to {high}")
        if not (isinstance(value, int) and not isinstance(value, bool) and low <= value <= high):
            self.fail(key, f"a whole number from {low} to {high}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Read true or false."""
        value = self._take(key, default, "true or false")
        if not isinstance(value, bool):
            self.fail(key, "true or false")
        return value

    def texts(
        self, key: str, default: Sequence[str] | None = None, *, least: int = 1, most: int = 100
    ) -> tuple[str, ...]:
        """Read a list of different texts."""
        value = self._take(key, default, "a list of texts")
        are_texts = isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
        texts = tuple(each.strip() for each in value) if are_texts else ("",)
        if not all(texts) or not least <= len(texts) <= most or len(set(texts)) != len(texts):
            self.fail(key, f"a list of {least} to {most} different texts that are not empty")
        return texts

    def section(self, key: str) -> Section:
        """Read a table inside this one."""
        value = self._take(key, None, "a table")
        if not isinstance(value, dict):
            self.fail(key, "a table")
        return Section(value, self._at(key), self._file)

    def sections(self, key: str, *, least: int = 1, most: int = 1000) -> list[Section]:
        """Read a list of tables inside this one."""
        value = self._take(key, [] if least == 0 else None, "a list of tables")
        if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
            self.fail(key, "a list of tables")
        if not least <= len(value) <= most:
            raise FormatError(
                f"{self._at(key)}: expected {least} to {most} tables, got {len(value)}",
                file=self._file,
            )
        return [Section(v, f"{self._at(key)}[{n}]", self._file) for n, v in enumerate(value)]

    def finish(self) -> None:
        """Refuse keys that were not read.

        Raises
        ------
        FormatError
            The table has such a key.
        """
        if self._left:
            raise FormatError(f"{self._at(min(self._left))}: expected no such key", file=self._file)

    def _at(self, key: str) -> str:
        return f"{self._place}.{key}" if self._place else key

    def _take(self, key: str, default: Any, expected: str) -> Any:
        self._left.discard(key)
        if key in self._table:
            return self._table[key]
        if default is None:
            raise FormatError(f"{self._at(key)}: expected {expected}, found none", file=self._file)
        return default


@dataclass(frozen=True)
class Common:
    """Part of a definition that all studies have.

    Attributes
    ----------
    kind : {"rating", "jnd", "display"}
    title : str
    seed : int
        Seed of all random orders.
    consent : sequence of str
        Paragraphs that a participant agrees to.
    introduction : sequence of str
        Paragraphs before the first question.
    groups : sequence of str
        Groups, from which a participant chooses their own; may be empty.
    demographics : sequence of Field
        Questions about the participant.
    """

    kind: str
    title: str
    seed: int
    consent: tuple[str, ...]
    introduction: tuple[str, ...]
    groups: tuple[str, ...]
    demographics: tuple[Field, ...]

    @classmethod
    def read(cls, top: Section, kinds: Sequence[str]) -> Common:
        """Read these fields from the top of a definition."""
        return cls(
            kind=top.word("kind", kinds),
            title=top.text("title", most=200),
            seed=top.whole("seed", 0, 2**31 - 1, 0),
            consent=top.texts("consent"),
            introduction=top.texts("introduction", (), least=0),
            groups=top.texts("groups", (), least=0, most=20),
            demographics=_fields(top.sections("demographics", least=0, most=30)),
        )


def _fields(sections: Sequence[Section]) -> tuple[Field, ...]:
    found: list[Field] = []
    for section in sections:
        name = section.name("name")
        if name in {"group", *(each.name for each in found)}:
            section.fail("name", "a name that no other question has")
        kind = section.word("type", ("choice", "number", "text"))
        choices: tuple[tuple[str, str], ...] = ()
        low = high = 0.0
        if kind == "choice":
            choices = tuple((text, text) for text in section.texts("choices", least=2))
        elif kind == "number":
            low = section.number("low", -1e9, 1e9, 0.0)
            high = section.number("high", low, 1e9)
        found.append(
            Field(
                name,
                section.text("label", most=400),
                kind,  # type: ignore[arg-type]
                choices=choices,
                low=low,
                high=high,
                optional=section.flag("optional", True),
            )
        )
        section.finish()
    return tuple(found)


def read_table(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the content of a TOML file, or of a JSON file by its suffix.

    Raises
    ------
    FormatError
        The file is neither TOML nor JSON, or larger than `MAX_BYTES`.
    OSError
        The file cannot be read.
    """
    file = path_of(path)
    content = limited_bytes(file, MAX_BYTES)
    try:
        text = content.decode("utf-8-sig")  # some editors write a byte order mark
        found = json.loads(text) if file.suffix.lower() == ".json" else tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, JSONDecodeError, Unicode
        raise FormatError(f"expected TOML or JSON: {error}", file=str(file)) from None
    if not isinstance(found, dict):
        raise FormatError(f"expected a table, got {type(found).__name__}", file=str(file))
    return found
