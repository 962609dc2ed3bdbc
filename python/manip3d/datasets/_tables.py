"""Reader of this package's CSV files, which list data files, their checksums and addresses."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from importlib.resources import files

from manip3d.datasets._registry import DataFile


def table(name: str) -> Iterator[dict[str, str]]:
    """Yield the rows of a CSV file of this package."""
    text = files("manip3d.datasets").joinpath(name).read_text(encoding="utf-8")
    yield from csv.DictReader(text.splitlines())


def data_file(folder: str, row: Mapping[str, str], text: str = "") -> DataFile:
    """Return the file of a row; its path is relative to ``folder`` in the data root."""
    return DataFile(
        path=f"{folder}/{row['path']}",
        size=int(row["size"]),
        sha256=row["sha256"],
        content_sha256=row.get("content_sha256") or row["sha256"],
        url=row["url"],
        text=text,
    )
