"""Safe reading of untrusted text, XML and YAML: regular files of bounded size, with any bytes.

XML may have no entities, an external DTD only if it is ``standalone="yes"``, and has a bounded
depth; YAML may have no aliases.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d._util.extras import imported
from manip3d._util.regular_files import limited_bytes
from manip3d.errors import FormatError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_BYTES = 16 << 20  # largest size of a text or XML file, bytes
# PyYAML takes about a second to parse a file of this size.
_MAX_YAML_BYTES = 128 << 10
_MAX_DEPTH = 64  # largest depth of nested XML elements
# Number of XML elements between two checks of the time, a few hundredths of a second.
_ELEMENTS_A_CHECK = 1 << 16


def parse_xml(path: Path) -> Element:
    """Return the root element of an XML file.

    Raises
    ------
    FormatError
        The file is not well-formed, is larger than 16 MiB, has more than 64 levels, declares
        entities, or has an external DTD without being ``standalone="yes"``.
    """
    return parse_xml_bytes(limited_bytes(path, MAX_BYTES), str(path))


def parse_xml_bytes(
    data: bytes,
    file: str,
    check_time: Callable[[float], None] | None = None,
    *,
    max_depth: int = _MAX_DEPTH,
) -> Element:
    """Return the root element of XML bytes, the size of which the caller must bound.

    Tags and attributes keep their namespace prefixes: ``<x:b/>`` has the tag ``x:b``.

    Parameters
    ----------
    data : bytes
        An XML document.
    file : str
        Name of the file in errors.
    check_time : callable, optional
        Called with 0.0 every 65,536 elements, as the number of all elements is not known. It may
        raise to end the reading.
    max_depth : int
        Largest depth of nested elements.

    Raises
    ------
    FormatError
        The document is not well-formed, is nested deeper than ``max_depth``, declares entities, or
        has an external DTD, which could define them, without being
        ``standalone="yes"``.
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
        if check_time is not None and num_elements % _ELEMENTS_A_CHECK == 0:
            check_time(0.0)
        if depth > max_depth:
            raise fail(f"elements nested deeper than {max_depth}")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: Any) -> int:
        raise fail("entities and external DTDs are refused")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = refuse
    # With an external DTD, expat would delete undefined entities from texts and attributes.
    parser.NotStandaloneHandler = refuse
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise FormatError(
            f"not well-formed XML: {expat.ErrorString(error.code)}", file=file, line=error.lineno
        ) from None
    except FormatError:
        raise
    except (LookupError, ValueError) as error:  # the file declares an unknown encoding
        raise fail(f"expected XML in UTF-8: {error}") from None
    return builder.close()


def parse_yaml(path: Path, *, extra: str) -> Any:
    """Return the first document of a YAML file, which OpenCV may have written.

    Parameters
    ----------
    path : Path
        The file.
    extra : str
        The extra that installs PyYAML, for the message of `MissingExtraError`.

    Raises
    ------
    FormatError
        The file is not YAML, is larger than 128 KiB, is nested too deep, or has aliases.
    MissingExtraError
        PyYAML is not installed.
    """
    yaml = imported("yaml", extra)
    safe_loader: Any = yaml.SafeLoader

    class Loader(safe_loader):  # type: ignore[misc]
        """Loader that refuses aliases, since nine nested ones can expand to a billion words."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are refused")
            return super().compose_node(parent, index)

    for name in ("matrix", "nd-matrix"):
        Loader.add_constructor(f"tag:yaml.org,2002:opencv-{name}", Loader.construct_yaml_map)
    data = limited_bytes(path, _MAX_YAML_BYTES)
    # "%YAML:1.0", the first line of many OpenCV files, is no valid YAML directive. It becomes an
    # empty line, so that errors name the right line number.
    data = re.sub(rb"\A(\xef\xbb\xbf)?%YAML[^\r\n]*", b"", data)
    try:
        return next(yaml.load_all(data, Loader), None)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise FormatError(f"not YAML: {error.problem}", file=str(path), line=line) from None
    except RecursionError:
        raise FormatError("not YAML: nested too deep", file=str(path)) from None
    except Exception as error:  # various types if a value does not fit its tag
        raise FormatError(f"not YAML: {error!s:.200}", file=str(path)) from None


def text_of(path: Path) -> str:
    """Return the text of a file of at most 16 MiB; bytes that are not UTF-8 stay as surrogates.

    A byte order mark at the beginning is no part of it.

    Raises
    ------
    FormatError
        The file is larger, or no regular file.
    """
    return limited_bytes(path, MAX_BYTES).decode("utf-8-sig", "surrogateescape")
