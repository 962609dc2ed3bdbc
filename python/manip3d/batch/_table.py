"""Rows as one table: CSV, or Parquet where pyarrow is installed."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.extras import imported, require
from manip3d.errors import InputError
from manip3d.io._files import atomic_write
from manip3d.io._remote import local_output

TABLE_SUFFIXES = (".csv", ".parquet")
_MAX_ITEMS = 16  # longer lists get no columns, which would be most of the table


@checked
def write_table(rows: Sequence[Mapping[str, Any]], path: str | os.PathLike[str]) -> None:
    r"""Write rows as one table, whole or not at all.

    Nested values become columns of their own, such as ``metro.vertex.mean`` and ``bounds.0``;
    lists of more than 16 items are left out. Lists of mappings, such as the frames of a drive, give
    their number. Bytes in names of files that are not UTF-8 are escaped: ``a\udcff.bin``.

    Parameters
    ----------
    rows : sequence of mappings
        A column that a row does not have is empty in it.
    path : path or URL
        ``.csv`` or ``.parquet``.

    Raises
    ------
    InputError
        Another suffix.
    MissingExtraError
        Parquet, and pyarrow is not installed.
    OSError
        The operating system refused; the old file is whole.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import batch
    >>> batch.write_table([{"name": "a", "size": {"x": 1}}, {"name": "b"}], "table.csv")
    >>> Path("table.csv").read_text().split()
    ['name,size.x', 'a,1', 'b,']
    """
    name = os.fspath(path)
    flat = [dict(_flat(row)) for row in rows]
    columns = list(dict.fromkeys(column for row in flat for column in row))
    kind = name.lower()
    if kind.endswith(".csv"):
        content = csv_text(flat, columns).encode()
    elif kind.endswith(".parquet"):
        content = _parquet(flat, columns)
    else:
        raise InputError(f"{name}: expected a name that ends in {' or '.join(TABLE_SUFFIXES)}")
    with local_output(path) as local:
        atomic_write(local, content)


def check_table(name: str) -> None:
    """Check the name of a table before any work is done for it.

    Raises
    ------
    InputError
        The suffix is none of `TABLE_SUFFIXES`.
    MissingExtraError
        The table is Parquet, and pyarrow is not installed.
    """
    if not name.lower().endswith(TABLE_SUFFIXES):
        raise InputError(f"table: expected a name that ends in {' or '.join(TABLE_SUFFIXES)}")
    if name.lower().endswith(".parquet"):
        require("parquet")


def table_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows as CSV."""
    flat = [dict(_flat(row)) for row in rows]
    return csv_text(flat, list(dict.fromkeys(column for row in flat for column in row)))


def csv_text(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Return one line a row, after a line with the names of the columns."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple):
        if any(isinstance(item, Mapping) for item in value):
            yield printable(name), len(value)
        elif len(value) <= _MAX_ITEMS:
            for number, item in enumerate(value):
                yield from _flat(item, f"{name}.{number}")
    else:
        yield printable(name), printable(value) if isinstance(value, str) else value


def printable(text: str) -> str:
    """Return the text, with what UTF-8 cannot say, as bytes in names of files, as escapes."""
    return text.encode("utf-8", "backslashreplace").decode()


def _parquet(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> bytes:
    arrow = imported("pyarrow", "parquet")
    parquet = imported("pyarrow.parquet", "parquet")
    arrays = {}
    for column in columns:
        values = [row.get(column) for row in rows]
        try:
            arrays[column] = arrow.array(values)
        # Numbers in one row and words in another, or numbers that do not fit 64 bits.
        except (arrow.ArrowInvalid, arrow.ArrowTypeError, OverflowError):
            arrays[column] = arrow.array([None if v is None else str(v) for v in values])
    stream = io.BytesIO()
    parquet.write_table(arrow.table(arrays), stream)
    return stream.getvalue()
