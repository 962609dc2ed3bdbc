"""Tables of an experiment's rows, and what measured them, independent of the report's format."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from manip3d.experiments import counted

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Cell:
    """One value of a table, with the published value beside it.

    Attributes
    ----------
    text : str
        The value as text.
    kind : str
        ``value``, ``best`` (the lowest of its model among rows that reached the target and did not
        fail), ``word`` or ``none``.
    printed : str
        The published value; ``""`` if there is none.
    ratio : str
        Measured over published value, only for rows of the published file.
    hint : str
        Source of the published value if it belongs to another file; ``""`` for the same file.
    """

    text: str
    kind: str = "value"
    printed: str = ""
    ratio: str = ""
    hint: str = ""


@dataclass(frozen=True)
class Group:
    """The rows of one model under its heading.

    Attributes
    ----------
    title : str
        Name of the model.
    about : tuple of str
        Role, cleaning and number of faces of the model.
    rows : list of list of Cell
        One cell per heading of the table.
    """

    title: str
    about: tuple[str, ...]
    rows: list[list[Cell]] = field(default_factory=list)


@dataclass(frozen=True)
class Table:
    """A table: headings, and groups of rows.

    Attributes
    ----------
    title : str
        Value that all rows share, if an experiment has several tables; else ``""``.
    headings : list of str
        Titles of the columns.
    groups : list of Group
        Rows of each model.
    """

    title: str
    headings: list[str]
    groups: list[Group]

    @property
    def flat(self) -> bool:
        """Whether each model has one row, which then needs no heading of its own."""
        return all(len(group.rows) == 1 for group in self.groups)


def tables(record: Mapping[str, Any]) -> list[Table]:
    """Return the tables of one experiment of ``results.json``."""
    key = record.get("split", "")
    parts: dict[str, list[Row]] = {}
    for row in record["rows"]:
        parts.setdefault(str(row.get(key, "")) if key else "", []).append(row)
    return [_table(title, rows, record["columns"]) for title, rows in parts.items()]


def measured_by(results: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield each environment in which rows were measured, with the ids of their experiments.

    If all cases failed, it is the environment of the run.
    """
    records = results["experiments"]
    for name, environment in results["environments"].items():
        measured = [each for each, record in records.items() if name in record["environments"]]
        if measured:
            yield {**environment, "experiments": measured}
    if not any(record["environments"] for record in records.values()):
        yield {**results["environment"], "experiments": list(records)}


def _table(title: str, rows: Sequence[Row], columns: Sequence[Mapping[str, Any]]) -> Table:
    """Return one table; columns without any value are left out."""
    columns = [c for c in columns if any(row.get(c["name"]) is not None for row in rows)]
    by_model: dict[str, list[Row]] = {}
    for row in rows:
        by_model.setdefault(row["model"], []).append(row)
    groups = []
    for model, of_model in by_model.items():
        best = {c["name"]: _lowest(of_model, c["name"]) for c in columns if c["lower_is_better"]}
        cells = [[_cell(row, column, best) for column in columns] for row in of_model]
        groups.append(Group(readable(model), _about(of_model[0]), cells))
    return Table(readable(title), [column["title"] for column in columns], groups)


def readable(text: str) -> str:
    """Replace underscores within names by spaces: ``ferrari_458`` becomes ``ferrari 458``."""
    return re.sub(r"(?<=[^\W_])_(?=[^\W_])", " ", text)


def number(value: float, column: Mapping[str, Any]) -> str:
    """Format a number with its column's scale and digits; integers in groups of three digits."""
    if not math.isfinite(value):
        return "not a number"
    scaled = value * column["scale"]
    if column["digits"] is not None:
        return f"{scaled:.{column['digits']}f}"
    return f"{scaled:,.0f}".replace(",", "\u202f") if scaled == int(scaled) else f"{scaled:g}"


def _lowest(rows: Sequence[Row], name: str) -> float | None:
    values = [row[name] for row in rows if _is_number(row.get(name)) and _may_be_best(row)]
    return min(values) if len(values) > 1 else None


def _may_be_best(row: Row) -> bool:
    return not row.get("error") and bool(row.get("reached", True))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _about(row: Row) -> tuple[str, ...]:
    cleaning = row.get("cleaning_does", "")
    said = [row.get("role", ""), "" if cleaning and cleaning in row["model"] else cleaning]
    if row.get("faces_target") and row.get("faces_original"):
        faces = counted(row["faces_original"], "face")
        target = "" if row.get("level") else f", target {number(row['faces_target'], _WHOLE)}"
        said.append(f"{faces}{target}")
    return tuple(readable(text) for text in said if text)


_WHOLE = {"scale": 1.0, "digits": None}


def _cell(row: Row, column: Mapping[str, Any], best: Mapping[str, float | None]) -> Cell:
    name = column["name"]
    value: Any = row.get(name)
    if row.get("error"):
        return Cell(_word(row, column) if value is not None else "failed", "word")
    printed, ratio, hint = _published(row, column)
    if _is_number(value):
        is_best = best.get(name) is not None and value == best[name] and _may_be_best(row)
        return Cell(number(value, column), "best" if is_best else "value", printed, ratio, hint)
    kind = "word" if value not in (None, "") else "none"
    return Cell(_word(row, column), kind, printed, ratio, hint)


def _word(row: Row, column: Mapping[str, Any]) -> str:
    value = row.get(column["name"])
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "–" if value is None else readable(column["words"].get(str(value), str(value)))


def _published(row: Row, column: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return `Cell.printed`, `Cell.ratio` and `Cell.hint` of a value."""
    printed, measured = row.get(column["published"]), row.get(column["name"])
    if printed is None:
        return "", "", ""
    text = "FAIL" if printed == "fail" else number(printed, column)
    if row["data"] != "published":
        whose = row.get("stands_in_for")
        return text, "", f"of the published {whose}, another file" if whose else "of other data"
    if not column["ratio"] or not _is_number(measured) or not _is_number(printed) or printed == 0:
        return text, "", ""
    return text, f"× {measured / printed:.2f}", ""
