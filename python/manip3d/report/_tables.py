"""An experiment's rows as the tables of a report, whatever the report is written in."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Cell:
    """One value, and how it is meant.

    Attributes
    ----------
    text : str
    kind : str
        ``value``, ``best`` (lowest of its model among those that reached the target),
        ``published`` (of the same file), ``beside`` (published, of another mesh), ``ratio``,
        ``word`` or ``none``.
    hint : str
        Said when a reader points at it.
    """

    text: str
    kind: str = "value"
    hint: str = ""


@dataclass(frozen=True)
class Group:
    """The rows of one model under its heading.

    Attributes
    ----------
    title : str
    about : tuple of str
        What it is, its cleaning, its faces.
    rows : list of list of Cell
        One cell per heading of the table.
    """

    title: str
    about: tuple[str, ...]
    rows: list[list[Cell]] = field(default_factory=list)


@dataclass(frozen=True)
class Table:
    """Headings, and groups of rows."""

    headings: list[str]
    groups: list[Group]

    @property
    def flat(self) -> bool:
        """Whether each model has one row, which then needs no heading of its own."""
        return all(len(group.rows) == 1 for group in self.groups)


def table(record: Mapping[str, Any]) -> Table:
    """The table of one experiment of ``results.json``."""
    columns = record["columns"]
    headings = [heading for column in columns for heading in _headings(column)]
    by_model: dict[str, list[Row]] = {}
    for row in record["rows"]:
        by_model.setdefault(row["model"], []).append(row)
    groups = []
    for model, rows in by_model.items():
        best = {c["name"]: _lowest(rows, c["name"]) for c in columns if c["lower_is_better"]}
        cells = [[c for column in columns for c in _cells(row, column, best)] for row in rows]
        groups.append(Group(model, _about(rows[0]), cells))
    return Table(headings, groups)


def number(value: float, column: Mapping[str, Any]) -> str:
    """A number as its column shows it, whole ones in groups of three."""
    if not math.isfinite(value):
        return "not a number"
    scaled = value * column["scale"]
    if column["digits"] is not None:
        return f"{scaled:.{column['digits']}f}"
    return f"{scaled:,.0f}".replace(",", "\u202f") if scaled == int(scaled) else f"{scaled:g}"


def _headings(column: Mapping[str, Any]) -> list[str]:
    if not column["published"]:
        return [column["title"]]
    return [column["title"], "published", *(["ratio"] if column["ratio"] else [])]


def _lowest(rows: Sequence[Row], name: str) -> float | None:
    values = [row[name] for row in rows if _is_number(row.get(name)) and row.get("reached", True)]
    return min(values) if len(values) > 1 else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _about(row: Row) -> tuple[str, ...]:
    cleaning = row.get("cleaning_does", "")
    said = [row.get("role", ""), "" if cleaning and cleaning in row["model"] else cleaning]
    if row.get("faces_target"):
        faces = number(row["faces_original"], _WHOLE)
        target = "" if row.get("level") else f", target {number(row['faces_target'], _WHOLE)}"
        said.append(f"{faces} faces{target}")
    return tuple(text for text in said if text)


_WHOLE = {"scale": 1.0, "digits": None}


def _cells(row: Row, column: Mapping[str, Any], best: Mapping[str, float | None]) -> list[Cell]:
    name = column["name"]
    if row.get("error"):
        said = _word(row, column) if name in row else "failed"
        return [Cell(said, "word"), *[Cell("", "none")] * (len(_headings(column)) - 1)]
    value: Any = row.get(name)
    if _is_number(value):
        is_best = best.get(name) is not None and value == best[name]
        cells = [Cell(number(value, column), "best" if is_best else "value")]
    else:
        cells = [Cell(_word(row, column), "word" if value else "none")]
    return (cells + _published(row, column))[: len(_headings(column))]


def _word(row: Row, column: Mapping[str, Any]) -> str:
    value = row.get(column["name"])
    return "–" if value is None else column["words"].get(str(value), str(value))


def _published(row: Row, column: Mapping[str, Any]) -> list[Cell]:
    """The published value, and the ratio to it where it is of the same file."""
    printed, measured = row.get(column["published"]), row.get(column["name"])
    if printed is None:
        return [Cell("–", "none"), Cell("", "none")]
    text = "FAIL" if printed == "fail" else number(printed, column)
    if not row["same_file"]:
        hint = f"of the published {row['stands_in_for']}, another mesh"
        return [Cell(text, "beside", hint), Cell("", "none")]
    if not _is_number(measured) or not _is_number(printed) or printed == 0:
        return [Cell(text, "published"), Cell("", "none")]
    return [Cell(text, "published"), Cell(f"× {measured / printed:.2f}", "ratio")]
