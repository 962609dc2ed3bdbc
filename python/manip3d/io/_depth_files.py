"""Reading of depth images, and of masks and other maps of their pixels, from files."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io._depth_formats import (
    HEADER_BYTES,
    decode_depth,
    decode_levels,
    decode_map,
    decode_mask,
    too_many_pixels,
)
from manip3d.io._files import open_regular, over_max_bytes, refuse_pointer
from manip3d.io._limits import byte_limit, clock
from manip3d.io._remote import local_copy

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_Read = TypeVar("_Read")

DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".pfm", ".exr", ".npy", ".npz")
"""Suffixes of the formats that `read_depth` reads."""

MILLIMETRES = 1000.0  # units per metre
MAX_PIXELS = 1 << 26
"""Default of the largest image, 67 million pixels: cameras of 61 megapixels have fewer.

To simplify such an image takes 3.3 GB (50 bytes a pixel), to read it as 64-bit floats 2.1 GB.
"""


@checked
def read_depth(
    path: str | os.PathLike[str],
    *,
    units_per_metre: float = MILLIMETRES,
    max_pixels: int = MAX_PIXELS,
) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Read a depth image; 0 and NaN mean no measurement.

    Parameters
    ----------
    path : path-like or URL
        16-bit grey PNG, PGM or TIFF, ``.pfm``, ``.exr``, ``.npy`` or ``.npz``. The format is
        recognised by the content, not by the suffix. Arrays may have further axes of length 1:
        (H, W, 1), (1, H, W). Of an ``.npz`` the only array is read, or the one that is named
        ``depth``. Of an ``.exr`` the display window is read, whose pixels outside of the data
        window are not measured: the only channel, or the one with the part ``depth`` in its name
        (``ViewLayer.Depth.Z``), or ``Z``, or the only ``.Z``, ``.Y`` or ``.V`` that is no part of
        a vector; or red if red, green and blue are equal and no channel has such a name. If it has
        several parts, the name of each is one more layer of its channels (``depth.Z``).
    units_per_metre : float
        Stored units per metre of integer images: 1000 for Kinect and most others, 5000 for TUM and
        ICL-NUIM. Images of floating-point numbers (TIFF, ``.pfm``, ``.exr``, ``.npy``) are in
        metres.
    max_pixels : int
        Larger images are refused before any memory is allocated for them.

    Returns
    -------
    (H, W) uint16 in millimetres, or float32 in metres
        The stored integers unchanged if ``units_per_metre`` is 1000, else metres. Negative integers
        become 0.

    Raises
    ------
    FormatError
        The file is damaged, no depth image, or has more than ``max_pixels`` pixels.
    InputError
        ``units_per_metre`` or ``max_pixels`` is not positive.
    OSError
        The file cannot be read.
    MissingExtraError
        Pillow (PNG and TIFF) or OpenEXR is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> np.save("depth.npy", np.full((48, 64), 2000, np.uint16))
    >>> io.read_depth("depth.npy").shape
    (48, 64)
    """
    if not 0 < units_per_metre < float("inf"):
        raise InputError(f"units_per_metre: expected > 0, got {units_per_metre}")
    return _in_our_units(read_stored_depth(path, max_pixels=max_pixels), units_per_metre)


def read_stored_depth(
    path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS, may_be_narrow: bool = False
) -> NDArray[Any]:
    """Read the stored numbers of a depth image, without conversion of units; see `read_depth`.

    Images of 8 bits are refused unless ``may_be_narrow`` is True.
    """
    return _read(path, max_pixels, partial(decode_depth, may_be_narrow=may_be_narrow))


def _read(
    path: str | os.PathLike[str], max_pixels: int, decode: Callable[[bytes, int], _Read]
) -> _Read:
    if not max_pixels > 0:
        raise InputError(f"max_pixels: expected > 0, got {max_pixels}")
    name = os.fspath(path)
    limit, largest = byte_limit(None), 8 * max_pixels + HEADER_BYTES
    with clock(name):
        with local_copy(path, max_bytes=limit or None) as local, open_regular(local) as file:
            refuse_pointer(local)
            data = file.read(min(largest, limit or largest) + 1)
        try:
            if limit and len(data) > limit:
                raise FormatError(over_max_bytes(limit))
            if len(data) > largest:
                raise FormatError(too_many_pixels(max_pixels, "a larger file"))
            values = decode(data, max_pixels)
        except FormatError as error:
            offset = error.byte_offset
            raise FormatError(error.reason, file=name, byte_offset=offset) from error.__cause__
    return values


@checked
def read_pixel_map(
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, ...] | None = None,
    max_pixels: int = MAX_PIXELS,
) -> NDArray[np.bool_ | np.integer[Any] | np.floating[Any]]:
    """Read one number per pixel of a depth image, such as a mask or confidences.

    Parameters
    ----------
    path : path-like or URL
        PNG, TIFF, JPEG, BMP, WebP, PGM, ``.pfm``, ``.exr``, ``.npy`` or ``.npz``. The format is
        recognised by the content, not by the suffix. Arrays may be of bool, integers or floats. Of
        an ``.npz`` or ``.exr`` the only array or channel is read, or the one that is named
        ``mask``, ``confidence`` or ``conf``. The channels of an ``.exr`` may also be grey: ``Y``,
        or red, green and blue that are equal.
    shape : tuple of int, optional
        Rows and columns of the depth image. A JPEG or WebP is turned upright by its EXIF data,
        unless only the stored image has this aspect ratio.
    max_pixels : int
        Larger images are refused before any memory is allocated for them. The default is 2**26
        (67 million).

    Returns
    -------
    (H, W) bool, integers, float32 or float64, of at least 0
        The stored values, float16 as float32. Coloured and paletted images of 8 bits give the
        largest of red, green and blue, and 0 where an alpha channel is 0: only black pixels and
        those outside of a cut-out are 0. The transparency of a palette's colours is ignored. A JPEG
        has small numbers where 0 was before its compression, as most WebP have.

    Raises
    ------
    FormatError
        The file is damaged or not an image, has colours of 16 bits a channel, negative numbers or
        more than ``max_pixels`` pixels.
    InputError
        ``max_pixels`` is not positive.
    OSError
        The file cannot be read.
    MissingExtraError
        Pillow (PNG, TIFF, JPEG, BMP and WebP) or OpenEXR is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> np.save("mask.npy", np.eye(3, dtype=bool))
    >>> int(io.read_pixel_map("mask.npy").sum())
    3
    """
    return _read(path, max_pixels, partial(decode_map, shape=shape))


def read_mask(
    path: str | os.PathLike[str], *, shape: tuple[int, ...] | None = None
) -> NDArray[np.bool_]:
    """Read the mask of a depth image: pixels of a map that are not 0.

    In images with a lossy compression (JPEG, WebP) they are the bright ones, or those of a cut-out
    that are not transparent. For ``shape`` see `read_pixel_map`.
    """
    return _read(path, MAX_PIXELS, partial(decode_mask, shape=shape))


def read_levels(
    path: str | os.PathLike[str], *, shape: tuple[int, ...] | None = None
) -> tuple[NDArray[Any], int | None]:
    """Read the confidences of a depth image, and the highest level that they can have.

    It is None for integers of more than 16 bits and floats. For ``shape`` see `read_pixel_map`.
    """
    return _read(path, MAX_PIXELS, partial(decode_levels, shape=shape))


@checked
def is_color_png(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a PNG of at most 8 bits per channel, and so no depth image.

    Parameters
    ----------
    path : path-like
        The file; only its header is read.

    Returns
    -------
    bool
        True for pictures and masks, False for 16-bit PNG and all other files.

    Raises
    ------
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from PIL import Image
    >>> from manip3d import io
    >>> Image.fromarray(np.zeros((4, 4), np.uint8)).save("mask.png")
    >>> Image.fromarray(np.zeros((4, 4), np.uint16)).save("depth.png")
    >>> io.is_color_png("mask.png"), io.is_color_png("depth.png")
    (True, False)
    """
    header = _png_header(path)
    return len(header) == 26 and header[24] <= 8


def is_grey_png(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a PNG with one channel of grey; only its header is read."""
    header = _png_header(path)
    return len(header) == 26 and header[25] == 0


def _png_header(path: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a PNG up to bit depth and colour type; empty for other files."""
    with open_regular(path_of(path)) as file:
        header = file.read(26)
    return header if header.startswith(b"\x89PNG\r\n\x1a\n") else b""


def _in_our_units(
    stored: NDArray[Any], units_per_metre: float
) -> NDArray[np.uint16] | NDArray[np.float32]:
    with np.errstate(over="ignore"):  # too far is infinite, which is no measurement
        if stored.dtype.kind == "f":
            return np.array(stored, dtype=np.float32, order="C")
        if units_per_metre == MILLIMETRES:
            return np.array(stored, dtype=np.uint16, order="C")
        return (stored / units_per_metre).astype(np.float32)
