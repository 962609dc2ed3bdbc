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

_SEPARATORS = "\t;,"
_NAMED_SEPARATOR = re.compile(r"sep=([^\w\s\"]|\t) *(?:\r\n?|\n|\Z)", re.IGNORECASE)
"""First line of tables for Excel, which names their separator."""
_HEADING = re.compile(r'\s*((?:"[^"]*"|[^"\r\n]+)*)')
"""First row that is not blank; names between quotes may have line feeds."""
_QUOTED = re.compile(r'"[^"]*"')
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?\s*")


def csv_rows(
    path: Path, *, most_bytes: int = MAX_BYTES, errors: str = "strict"
) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of the line at which a row ends, and its cells; empty rows are left out.

    Where the decimal sign is a comma, spreadsheets write semicolons or tabs between the columns.
    The separator is the most frequent one of the heading, the first row that is not blank, outside
    quotes; or the one that a first line ``sep=;`` names. Numbers with a decimal comma get a point.
    They are refused between commas, because there ``"1,234"`` may also have groups of digits.

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
        The table is in another encoding, too large, no CSV, or has decimal commas between commas.
    """
    separator, text = _separated(_text_of(path, most_bytes, errors))
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if separator == ",":
                _refuse_decimal_commas(row, path, reader.line_num)
                yield reader.line_num, row
            else:
                yield reader.line_num, [*map(_with_decimal_point, row)]
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


def _separated(text: str) -> tuple[str, str]:
    """Return the separator of a table, and its text in which a line that names it is blank."""
    if named := _NAMED_SEPARATOR.match(text):
        return named[1], "\n" + text[named.end() :]
    heading = _HEADING.match(text)
    outside = _QUOTED.sub("", heading[1] if heading else "")
    # In a name, such as "remark, if any", a space follows the sign.
    found = max(_SEPARATORS, key=lambda sign: (outside.count(sign), -outside.count(f"{sign} ")))
    return found if found in outside else ",", text


def _refuse_decimal_commas(row: list[str], path: Path, line: int) -> None:
    for cell in row:
        if "," in cell and _DECIMAL_COMMA.fullmatch(cell):
            raise FormatError(
                f'expected a decimal point, got a decimal comma in "{cell}": save the table with '
                "semicolons between its columns",
                file=str(path),
                line=line,
            )


def _with_decimal_point(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
