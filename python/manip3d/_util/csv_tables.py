"""Reader of CSV tables that people fill in and save with a spreadsheet."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path

from manip3d._util.regular_files import limited_bytes
from manip3d._util.text_files import MAX_BYTES
from manip3d.errors import FormatError

_SEPARATORS = ",;\t"
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?\s*")


def csv_rows(
    path: Path, *, most_bytes: int = MAX_BYTES, errors: str = "strict"
) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of the line at which a row ends, and its cells; empty rows are left out.

    Where the decimal sign is a comma, spreadsheets write semicolons or tabs between the columns.
    The separator is the one of the first line, and numbers with a decimal comma get a point.

    Parameters
    ----------
    path : Path
        The table, in UTF-8 with or without a byte order mark.
    most_bytes : int
        Largest size.
    errors : str
        Handling of bytes that are not UTF-8, as in `bytes.decode`.

    Raises
    ------
    FormatError
        The table is in another encoding, too large or no CSV.
    """
    text = _text_of(path, most_bytes, errors)
    head = text.partition("\n")[0]
    separator = next((sign for sign in _SEPARATORS if sign in head), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            yield reader.line_num, row if separator == "," else [*map(_with_decimal_point, row)]
    except csv.Error as error:
        line = max(1, reader.line_num)
        raise FormatError(f"expected CSV: {error}", file=str(path), line=line) from None


def csv_records(path: Path, *, errors: str = "strict") -> Iterator[dict[str, str]]:
    """Yield the rows after the first one by its names; cells beyond the shorter one are left out.

    Raises
    ------
    FormatError
        See `csv_rows`.
    """
    names: list[str] = []
    for _, row in csv_rows(path, errors=errors):
        if names:
            yield dict(zip(names, row, strict=False))
        names = names or row


def _text_of(path: Path, most_bytes: int, errors: str) -> str:
    data = limited_bytes(path, most_bytes)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise FormatError("expected UTF-8, got UTF-16: save it as CSV UTF-8", file=str(path))
    try:
        return data.decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise FormatError(f"expected CSV in UTF-8: {error}", file=str(path)) from None


def _with_decimal_point(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
