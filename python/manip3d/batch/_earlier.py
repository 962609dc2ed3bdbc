"""Files that earlier runs of a batch wrote."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from manip3d._util.json import sealed, unsealed
from manip3d.batch._places import Place
from manip3d.batch._run import bytes_of, rows_folder, table_of
from manip3d.io._remote import is_url

_LIST = "earlier.json"  # beside the rows of a table


def earlier_outputs(output: str, table: str) -> list[Path]:
    """Return the files that earlier runs wrote into a folder.

    Parameters
    ----------
    output : str
        Folder of the outputs. A URL has no files here.
    table : str
        Table of the run; empty: the default one.

    Returns
    -------
    list of Path
        Absolute paths of the files that the stored rows of the last run list, or the list of
        `store_outputs`, and that still have the size that is stated there.
    """
    rows = _rows(output, table)
    if is_url(output) or is_url(rows):
        return []
    folder = Path(output).resolve()
    found = set()
    for name, size in _stored(Path(rows)):
        path = Path(name)
        # A relative path may be one from another working directory; an absolute one into another
        # folder is a file of that folder, even if this one is a copy of it.
        if not path.is_absolute() and not path.resolve().is_relative_to(folder):
            path = folder / path.name
        path = path.resolve()
        if path.is_relative_to(folder) and path.is_file() and bytes_of(path) == size:
            found.add(path)
    return sorted(found)


def store_outputs(outputs: Sequence[Path], output: str, table: str) -> None:
    """Store a list of `earlier_outputs` for later runs, since the next run replaces the rows."""
    listed = [[str(path), bytes_of(path)] for path in outputs]
    Place(_rows(output, table)).write(_LIST, json.dumps(sealed({"outputs": listed})))


def _rows(output: str, table: str) -> str:
    place = table_of(table or None, Place(output))
    assert place is not None
    return rows_folder(place)


def _stored(rows: Path) -> Iterator[tuple[str, int]]:
    """Yield path and size of each output; rows are also there after an interrupted run."""
    for part in sorted(rows.glob("*.jsonl")):
        for line in part.read_bytes().splitlines():
            row = (unsealed(line) or {}).get("row", {})
            if row.get("output") and row.get("output_bytes") is not None:
                yield row["output"], row["output_bytes"]
    if (rows / _LIST).is_file():
        record = unsealed((rows / _LIST).read_bytes()) or {}
        yield from ((name, size) for name, size in record.get("outputs", []))
