"""Size of the first depth image of a folder; only the header of its file is read."""

from __future__ import annotations

import re
import struct
from pathlib import Path

from manip3d._util.paths import in_order, is_hidden
from manip3d._util.regular_files import open_regular
from manip3d.errors import FormatError

_HEADER = struct.Struct(">8s4x4sII")
"""Beginning of a PNG: its signature, the first chunk's length and name, width and height."""
_MAX_LINE = 1 << 16  # bytes; there may be no end of a line in a damaged list
_LISTED = re.compile(
    rb"[\s,]*(?![+-]?[0-9]+,[0-9]+\s*,)(?:(?:[+-]?[0-9]+,[0-9]+|[^\s,#]+)\s+(?P<after_blanks>[^\s,#]\S*)"
    rb"|[^\s,#]+\s*,[\s,]*(?P<after_comma>[^\s,#]+))"
)
"""A line with a time, which may have a decimal comma, and a file after blanks or a comma.

``1,05,a.png`` is none: the reader refuses it.
"""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def first_depth_size(folder: Path, *, is_tum: bool) -> tuple[int, int] | None:
    """Return width and height of the first depth image; None if the folder has none.

    Images of a TUM sequence are those that depth.txt lists, in whatever folder; otherwise those in
    ``depth/``.

    Raises
    ------
    FormatError
        The first image is no PNG.
    OSError
        It cannot be read.
    """
    image = _first_listed(folder) if is_tum else next(iter(depth_images_of(folder)), None)
    return None if image is None else _png_size(image)


def depth_images_of(folder: Path) -> list[Path]:
    """Return the PNGs in ``depth/``, in the order of their names."""
    return in_order(
        image
        for image in (folder / "depth").glob("*")
        if image.suffix.lower() == ".png" and not is_hidden(image.name)
    )


def _first_listed(folder: Path) -> Path | None:
    """Return the first image that depth.txt lists: the word after the time.

    As in ``without_commas`` of cpp/src/capture/folder_lists.cpp, commas separate words only if one
    follows the time.
    """
    with open_regular(folder / "depth.txt") as file:
        while line := file.readline(_MAX_LINE):
            if found := _LISTED.match(line):
                name = found["after_blanks"] or found["after_comma"]
                return folder / name.decode(errors="surrogateescape")
    return None


def _png_size(image: Path) -> tuple[int, int]:
    with open_regular(image) as file:
        header = file.read(_HEADER.size)
    if len(header) == _HEADER.size:
        signature, chunk, width, height = _HEADER.unpack(header)
        if (signature, chunk) == (_SIGNATURE, b"IHDR"):
            return width, height
    raise FormatError("expected a PNG", file=str(image), byte_offset=0)
