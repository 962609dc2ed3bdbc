"""Read and write picture files that carry watermark records of scans."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.paths import path_of
from manip3d.authenticate._picture_records import checked_picture
from manip3d.errors import FormatError
from manip3d.io._files import atomic_write, regular_bytes

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB = 0, 2
_MAX_PIXELS = 1 << 26  # a small file can state more; these are 200 MB of RGB
_REFUSED = {
    b"tRNS": "transparency",
    b"acTL": "an animation",
    b"fcTL": "an animation",
    b"fdAT": "an animation",
}


@checked
def picture_path(scan: str | os.PathLike[str]) -> Path:
    """Return the path of the picture beside a scan: ``scan.bin.png`` for ``scan.bin``.

    Parameters
    ----------
    scan : path
        Path of the scan.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        ``scan`` is not a path.

    Examples
    --------
    >>> from manip3d.authenticate._picture_files import picture_path
    >>> picture_path("drive/scan.bin").as_posix()
    'drive/scan.bin.png'
    """
    path = path_of(scan)
    return path.with_name(path.name + ".png")


@checked
def read_carrier(path: str | os.PathLike[str]) -> NDArray[np.uint8]:
    """Read a picture that may carry a record: PNG, 8 bits, grey or RGB.

    Parameters
    ----------
    path : path
        Path of the PNG file.

    Returns
    -------
    (H, W) or (H, W, 3) uint8

    Raises
    ------
    FormatError
        The file is no such picture: it is damaged, interlaced, transparent or animated, or has a
        palette or bytes behind its end. Viewers could show such files differently from the pixels
        that were signed.
    OSError
        The file cannot be read.
    MissingExtraError
        Pillow is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import read_carrier, write_carrier
    >>> write_carrier(np.full((128, 160), 77, np.uint8), "grey.png")
    >>> picture = read_carrier("grey.png")
    >>> picture.shape, int(picture.max())
    ((128, 160), 77)
    """
    file = path_of(path)
    data = regular_bytes(file)
    try:
        _check_chunks(data)
    except FormatError as error:
        raise FormatError(error.reason, file=str(file)) from None
    image_module = imported("PIL.Image", "alert")
    try:
        with image_module.open(io.BytesIO(data), formats=("PNG",)) as image:
            pixels: NDArray[np.uint8] = np.array(image)
    except (OSError, ValueError, SyntaxError, zlib.error) as error:
        raise FormatError(f"unreadable picture: {error}", file=str(file)) from error
    return checked_picture(pixels)


@checked
def write_carrier(picture: ArrayLike, path: str | os.PathLike[str]) -> None:
    """Write a picture without loss, as `read_carrier` reads it.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) uint8
        Pixels, grey or RGB.
    path : path
        Path of the PNG file; an existing file is replaced atomically.

    Raises
    ------
    InputError
        ``picture`` has another shape or dtype.
    OSError
        The file cannot be written.
    MissingExtraError
        Pillow is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import read_carrier, write_carrier
    >>> color = np.random.default_rng(0).integers(0, 255, (128, 128, 3), np.uint8)
    >>> write_carrier(color, "color.png")
    >>> bool((read_carrier("color.png") == color).all())
    True
    """
    atomic_write(path_of(path), carrier_bytes(picture))


def carrier_bytes(picture: ArrayLike) -> bytes:
    """Return the content of `write_carrier`'s file."""
    pixels = checked_picture(picture)
    image_module = imported("PIL.Image", "alert")
    stream = io.BytesIO()
    image_module.fromarray(pixels).save(stream, format="PNG", compress_level=1)
    return stream.getvalue()


def _check_chunks(data: bytes) -> None:
    """Check the chunks of a PNG file strictly, so that all decoders show the same pixels."""
    if not data.startswith(_SIGNATURE):
        raise FormatError("expected a PNG file")
    names: list[bytes] = []
    for name, body in _chunks(data):
        if name in _REFUSED:
            raise FormatError(f"expected a picture without {_REFUSED[name]}")
        is_critical = name[:1].isupper()
        if is_critical and name not in (b"IHDR", b"IDAT", b"IEND"):
            raise FormatError(f"expected a picture of grey or RGB, got a part {name!r}")
        if (name == b"IHDR") != (not names):
            raise FormatError("expected one header, at the beginning")
        if name == b"IHDR":
            _check_header(body)
        names.append(name)
    if names[-1:] != [b"IEND"]:
        raise FormatError("the picture ends too early")


def _check_header(body: bytes) -> None:
    if len(body) != 13:
        raise FormatError("expected a header of 13 bytes")
    width, height, bits, color, compression, filters, interlace = struct.unpack(">IIBBBBB", body)
    if bits != 8 or color not in (_GREY, _RGB):
        raise FormatError(f"expected 8 bits of grey or RGB, got {bits} bits of colour type {color}")
    if compression or filters or interlace:
        raise FormatError("expected a picture without interlace")
    if not 0 < width * height <= _MAX_PIXELS:
        raise FormatError(f"expected 1 to {_MAX_PIXELS} pixels, got {width} x {height}")


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Name and content of each chunk; raises FormatError on a wrong checksum or trailing bytes."""
    at = len(_SIGNATURE)
    while at < len(data):
        if len(data) - at < 12:
            raise FormatError("the picture ends too early")
        (size,) = struct.unpack_from(">I", data, at)
        name, end = data[at + 4 : at + 8], at + 12 + size
        if end > len(data):
            raise FormatError("the picture ends too early")
        if struct.unpack_from(">I", data, end - 4)[0] != zlib.crc32(data[at + 4 : end - 4]):
            raise FormatError(f"the checksum of a chunk {name!r} is wrong")
        yield name, data[at + 8 : end - 4]
        if name == b"IEND" and end != len(data):
            raise FormatError("bytes behind the end of the picture")
        at = end
