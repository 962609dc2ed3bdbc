"""The published tables, as CSV files of this package."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d.errors import InputError
from manip3d.experiments._model import Finding, Row

METHOD_NAMES = {
    "qem-orig": "QEM_ORIG",
    "qem-bp": "QEM_BP",
    "qem-tp": "QEM_TP",
    "qem-btp": "QEM_BTP",
    "qem4vr": "QEM_4VR",
}
"""Name of each method in the tables, by this package's name."""


@checked
@cache
def published_rows(name: str) -> tuple[Mapping[str, str], ...]:
    """Return the rows of a published table, with the text of each cell by its column.

    Parameters
    ----------
    name : str
        Name of the table, as in `Experiment.published`, such as ``table_6_1_lidar_forensics``.

    Returns
    -------
    tuple of mapping
        One read-only mapping for each row, in the table's order.

    Raises
    ------
    InputError
        There is no such table.

    Examples
    --------
    >>> from manip3d.experiments import published_rows
    >>> published_rows("table_6_1_lidar_forensics")[2]["II_forged"]
    '13'
    """
    path = files("manip3d.experiments").joinpath("published", f"{name}.csv")
    if not path.is_file():
        raise InputError(f"name: expected a published table, got {name!r}")
    rows = csv.DictReader(path.read_text(encoding="utf-8").splitlines())
    return tuple(ReadOnlyMapping(row) for row in rows)


def value(table: str, model: str, method: str, column: str) -> float | str | None:
    """Return a cell: a number, ``"fail"`` if the method failed, or None if nothing is printed."""
    for row in published_rows(table):
        if row["model"] == model and row["method"] == METHOD_NAMES.get(method, method):
            text = row[column]
            if text == "fail":
                return "fail"
            return None if text in ("", "unknown") else float(text)
    return None


def with_counts(row: Row, table: str, counts: Sequence[str]) -> Row:
    """Return the row with the published counts of the model that it stands in for, if any."""
    named = (r for r in published_rows(table) if r["model"] == row["stands_in_for"])
    printed = next(named, None)
    return row | {f"published_{name}": int(printed[name]) if printed else None for name in counts}


def finding_of_share(name: str, holds: bool, numbers: str, errors: float) -> Finding:
    """Return a finding about a share; too few frames can refute it, but not confirm it.

    Where the claimed share allows less than one error, even a much larger share may leave none.
    """
    if errors < 1.0 and holds:
        return Finding(name, None, numbers, unjudged="too few frames to judge so small a share")
    return Finding(name, holds, numbers)


def same_counts(
    rows: Sequence[Row], models: Sequence[str], counts: Sequence[str]
) -> Iterator[Finding]:
    """Yield whether the counts of the published files of these models are the printed ones.

    A model whose published file is not among the rows has a finding that is not judged, so that the
    claim about all of them does not hold because of the others.

    Parameters
    ----------
    rows : sequence of dict
        Rows of all kinds of data (`Claim.together`).
    models : sequence of str
        Names of the published models.
    counts : sequence of str
        Keys of the counts; the printed ones have the prefix ``published_``.
    """
    present = {row["stands_in_for"]: row for row in rows if row["data"] == "published"}
    for model in models:
        row = present.get(model)
        if row is None:
            why = "the published file is not in this run"
            yield Finding(model, None, "", "published", unjudged=why)
            continue
        got = [row[name] for name in counts]
        printed = [row[f"published_{name}"] for name in counts]
        yield Finding(row["model"], got == printed, f"{got}, published {printed}", "published")
