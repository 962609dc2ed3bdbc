"""Text files of others: regular files of bounded size, any bytes; XML without its traps.

XML has no entities and no external files here, and a bounded depth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from manip3d.errors import FormatError
from manip3d.io._files import open_regular

MOST_BYTES = 16 << 20
_MOST_DEPTH = 64


def parse_xml(path: Path) -> Element:
    """The root element of a file.

    Raises
    ------
    FormatError
        Not well-formed, larger than 16 MiB, nested deeper than 64, or it declares entities.
    """
    file = str(path)
    data = bounded_bytes(path, MOST_BYTES)
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    depth = 0

    def fail(reason: str) -> FormatError:
        return FormatError(reason, file=file, line=parser.CurrentLineNumber)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _MOST_DEPTH:
            raise fail(f"elements nested deeper than {_MOST_DEPTH}")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: Any) -> int:
        raise fail("entities are refused")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise FormatError(
            f"not well-formed XML: {expat.ErrorString(error.code)}", file=file, line=error.lineno
        ) from None
    except (LookupError, ValueError) as error:  # the encoding that the file names
        raise fail(f"expected XML in UTF-8: {error}") from None
    return builder.close()


def bounded_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file of at most so many.

    Raises
    ------
    FormatError
        There are more, or it is not a regular file (`open_regular`).
    """
    with open_regular(path) as stream:
        data = stream.read(most + 1)
    if len(data) > most:
        raise FormatError(
            f"expected at most {most} bytes, got more", file=str(path), byte_offset=most
        )
    return data


def text_of(path: Path) -> str:
    """Return the text of a file of at most 16 MiB; bytes that are not UTF-8 stay as surrogates.

    Raises
    ------
    FormatError
        As `bounded_bytes`.
    """
    return bounded_bytes(path).decode("utf-8", "surrogateescape")
