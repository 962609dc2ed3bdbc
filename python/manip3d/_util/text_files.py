"""Text files of others: regular files of bounded size, any bytes; XML and YAML without their traps.

XML has no entities and no external files here, and a bounded depth; YAML has no aliases.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d._util.regular_files import limited_bytes
from manip3d.errors import FormatError, MissingExtraError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MOST_BYTES = 16 << 20
# PyYAML takes about a second for this much.
_MOST_YAML_BYTES = 128 << 10
_MOST_DEPTH = 64


def parse_xml(path: Path) -> Element:
    """The root element of a file.

    Raises
    ------
    FormatError
        Not well-formed, larger than 16 MiB, nested deeper than 64, or it declares entities.
    """
    return parse_xml_bytes(limited_bytes(path, MOST_BYTES), str(path))


def parse_xml_bytes(
    data: bytes,
    file: str,
    look: Callable[[float], None] | None = None,
    *,
    most_depth: int = _MOST_DEPTH,
) -> Element:
    """The root element of the bytes of a file, which errors name; see `parse_xml`.

    Every 65,536 elements ``look`` is called, which may end the reading.
    """
    from xml.etree.ElementTree import TreeBuilder
    from xml.parsers import expat

    builder = TreeBuilder()
    parser = expat.ParserCreate()
    depth = num_elements = 0

    def fail(reason: str) -> FormatError:
        return FormatError(reason, file=file, line=parser.CurrentLineNumber)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, num_elements
        depth += 1
        num_elements += 1
        if look is not None and num_elements % 65536 == 0:
            look(0.0)
        if depth > most_depth:
            raise fail(f"elements nested deeper than {most_depth}")
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
    except FormatError:
        raise
    except (LookupError, ValueError) as error:  # the encoding that the file names
        raise fail(f"expected XML in UTF-8: {error}") from None
    return builder.close()


def parse_yaml(path: Path, *, extra: str) -> Any:
    """The first document of a file, also of one that OpenCV wrote.

    Parameters
    ----------
    path : Path
    extra : str
        The extra that PyYAML comes with, as `MissingExtraError` names it.

    Raises
    ------
    FormatError
        Not YAML, larger than 128 KiB, nested too deep, or it has aliases.
    MissingExtraError
        PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError:
        raise MissingExtraError("PyYAML", extra) from None

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """Without aliases: nine of them can stand for a billion words."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are refused")
            return super().compose_node(parent, index)

    for name in ("matrix", "nd-matrix"):
        Loader.add_constructor(f"tag:yaml.org,2002:opencv-{name}", Loader.construct_yaml_map)
    data = limited_bytes(path, _MOST_YAML_BYTES)
    # "%YAML:1.0", OpenCV's first line for years, is no directive of YAML. The line stays, empty, so
    # that errors name the right one.
    data = re.sub(rb"\A(\xef\xbb\xbf)?%YAML[^\r\n]*", b"", data)
    try:
        return next(yaml.load_all(data, Loader), None)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise FormatError(f"not YAML: {error.problem}", file=str(path), line=line) from None
    except RecursionError:
        raise FormatError("not YAML: nested too deep", file=str(path)) from None
    except Exception as error:  # values that are not of their tag's type fail in many ways
        raise FormatError(f"not YAML: {error!s:.200}", file=str(path)) from None


def text_of(path: Path) -> str:
    """Return the text of a file of at most 16 MiB; bytes that are not UTF-8 stay as surrogates.

    Raises
    ------
    FormatError
        As `limited_bytes`.
    """
    return limited_bytes(path, MOST_BYTES).decode("utf-8", "surrogateescape")
