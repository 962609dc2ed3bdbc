"""The published tables, as CSV files of this package."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

METHOD_NAMES = {
    "qem-orig": "QEM_ORIG",
    "qem-bp": "QEM_BP",
    "qem-tp": "QEM_TP",
    "qem-btp": "QEM_BTP",
    "qem4vr": "QEM_4VR",
}
"""This package's names of the methods, and the tables' names."""


@cache
def rows(name: str) -> tuple[dict[str, str], ...]:
    """The rows of a published table; ``name`` without ``.csv``."""
    path = files("manip3d.experiments").joinpath("published", f"{name}.csv")
    return tuple(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def value(table: str, model: str, method: str, column: str) -> float | str | None:
    """One cell: a number, ``"fail"`` where the method failed, None where nothing is printed."""
    for row in rows(table):
        if row["model"] == model and row["method"] == METHOD_NAMES.get(method, method):
            text = row[column]
            if text == "fail":
                return "fail"
            return None if text in ("", "unknown") else float(text)
    return None
