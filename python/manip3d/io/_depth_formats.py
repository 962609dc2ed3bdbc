"""Decoding of depth images from their bytes: 16-bit PNG, PGM and TIFF, PFM, EXR, NumPy arrays."""

from __future__ import annotations

import contextlib
import io
import re
import sys
import warnings
import zipfile
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.extras import imported
from manip3d._util.regular_files import over_max_bytes
from manip3d.errors import Error, FormatError
from manip3d.io._limits import byte_limit, check_points
from manip3d.io._npy_headers import read_npy_header
from manip3d.io._orientations import orientation_of, upright
from manip3d.io._scan_tables import refuse_expansion

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray
    from PIL import Image

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_OR_TIFF = (_PNG, b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_JPEG = b"\xff\xd8\xff"
_BMP = b"BM"
_EXR = b"\x76\x2f\x31\x01"
_NPY = b"\x93NUMPY"
_ZIP = b"PK"
_DARKEST = 15  # a mask whose pixels are not brighter is black, with the noise of its compression
HEADER_BYTES = 1 << 20  # allowance for headers, colour profiles and text beside the pixels


def decode_depth(data: bytes, max_pixels: int, *, may_be_narrow: bool = False) -> NDArray[Any]:
    """Return the stored numbers (H, W) in the bytes of a depth image's file.

    A PNG, TIFF or PGM of 8 bits is read only if ``may_be_narrow`` is True, because it is more often
    a picture of a depth image than a depth image.

    Raises
    ------
    FormatError
        The file is damaged, no depth image, or has more than ``max_pixels`` pixels.
    MissingExtraError
        Pillow is not installed (PNG and TIFF).
    """
    if data.startswith(_NPY):
        return _depth_of_npy(data, max_pixels)
    if re.match(rb"P5[\s#]", data):
        return _read_pgm(data, max_pixels, may_be_narrow).astype(np.uint16)
    if data.startswith(_PNG_OR_TIFF):
        stored = _read_with_pillow(data, max_pixels, ("L",) if may_be_narrow else (), None)
        return _whole_depth(stored) if stored.dtype.kind in "iu" else stored
    if re.match(rb"P[fF]\s", data):
        return _read_pfm(data, max_pixels)
    if data.startswith(_ZIP):
        return _depth_of_npy(_array_of_npz(data, max_pixels, ("depth",)), max_pixels)
    if data.startswith(_EXR):
        return _read_exr(data, max_pixels, _depth_channel)
    kinds = "a 16-bit PNG, PGM or TIFF, or a .pfm, .exr, .npy or .npz file"
    raise FormatError(f"expected {kinds}, got bytes that begin with {data[:8]!r}", byte_offset=0)


def decode_mask(
    data: bytes, max_pixels: int, *, shape: tuple[int, ...] | None = None
) -> NDArray[np.bool_]:
    """Return a mask (H, W): True where a map of pixels is neither 0 nor NaN; see `decode_map`.

    A lossy compression (JPEG, WebP) leaves small numbers where 0 was, so that a pixel of one has to
    be at least half as bright as the brightest one, which is a grey in some masks. Dark pixels of a
    cut-out belong to it, so that there the transparency alone decides.
    """
    is_lossy = _is_lossy(data)
    grey_of = _cut_out if is_lossy else _brightest_channel
    values = np.nan_to_num(_levels(_map_of(data, max_pixels, shape, ("mask",), grey_of)))
    if not is_lossy:
        return np.asarray(values != 0)
    return np.asarray(values > max(_DARKEST, int(values.max()) // 2))


def decode_levels(
    data: bytes, max_pixels: int, *, shape: tuple[int, ...] | None = None
) -> tuple[NDArray[Any], int | None]:
    """Return the confidences (H, W) in a map's file, and the highest level that they can have.

    A PGM states it; else it is the largest number of 1, 8 or 16 bits. Wider integers and floats
    leave it open: None. For ``shape`` see `decode_map`.
    """
    names = ("confidence", "conf")
    levels = _levels(_map_of(data, max_pixels, shape, names, _brightest_channel))
    if header := _PGM_HEADER.match(data, 0, 8192):
        return levels, int(header[3])
    if levels.dtype == np.bool_:
        return levels, 1
    is_narrow = levels.dtype in (np.uint8, np.uint16)
    return levels, int(np.iinfo(levels.dtype).max) if is_narrow else None


def decode_map(
    data: bytes, max_pixels: int, *, shape: tuple[int, ...] | None = None
) -> NDArray[Any]:
    """Return the numbers (H, W) in the bytes of a map's file.

    A JPEG or WebP is turned upright by its EXIF data, unless only the stored image has the aspect
    ratio of ``shape`` (rows, columns), that of the depth image to which it belongs.
    """
    names = ("mask", "confidence", "conf")
    return _levels(_map_of(data, max_pixels, shape, names, _brightest_channel))


def _map_of(
    data: bytes,
    max_pixels: int,
    shape: tuple[int, ...] | None,
    names: tuple[str, ...],
    grey_of: Callable[[bytes, Image.Image], NDArray[Any]],
) -> NDArray[Any]:
    """Return the numbers of the array or channel with one of the names, or of the only one.

    ``grey_of`` reduces colours to one channel.
    """
    if data.startswith(_ZIP):
        data = _array_of_npz(data, max_pixels, names)
    if data.startswith(_NPY):
        return _with_single_floats(_read_npy(data, max_pixels, _MAP_DTYPES))
    if re.match(rb"P5[\s#]", data):
        return _read_pgm(data, max_pixels, may_be_narrow=True)
    if re.match(rb"P[fF]\s", data):
        return _read_pfm(data, max_pixels)
    if data.startswith(_EXR):
        return _read_exr(data, max_pixels, partial(_map_channel, names=names))
    if data.startswith((*_PNG_OR_TIFF, _JPEG, _BMP)) or _is_webp(data):
        levels = _read_with_pillow(data, max_pixels, ("1", "L"), grey_of)
        is_turned = data.startswith(_JPEG) or _is_webp(data)
        return upright(levels, _orientation(data), shape) if is_turned else levels
    raise FormatError(
        "expected a PNG, TIFF, JPEG, BMP, WebP, PGM, .pfm, .exr, .npy or .npz file, got bytes that "
        f"begin with {data[:8]!r}",
        byte_offset=0,
    )


def _levels(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return the numbers of a map, of which negative ones are refused: they have no meaning."""
    if (numbers < 0).any():
        raise FormatError(f"expected numbers of at least 0, got {np.nanmin(numbers)}")
    return numbers


def _is_webp(data: bytes) -> bool:
    return data[:4] == b"RIFF" and data[8:12] == b"WEBP"


def _is_lossy(data: bytes) -> bool:
    """Return whether the compression of an image changes its numbers: in JPEG and most WebP."""
    if not _is_webp(data):
        return data.startswith(_JPEG)
    start = 12
    while start + 8 <= len(data) and data[start : start + 4] != b"VP8 ":
        size = int.from_bytes(data[start + 4 : start + 8], "little")
        start += 8 + size + size % 2  # chunks have even sizes
    return start + 8 <= len(data)


def too_many_pixels(max_pixels: int, found: str) -> str:
    """Return the reason to refuse a larger image, and what can be done."""
    return (
        f"expected at most {max_pixels} pixels, got {found}; the limit bounds the memory: shrink "
        "the depth image, its intrinsics and maps alike, or read it with a larger max_pixels"
    )


def _checked_size(rows: int, columns: int, max_pixels: int) -> None:
    if not (rows > 0 and columns > 0):
        raise FormatError(f"expected at least one pixel, got {columns} x {rows}")
    if rows * columns > max_pixels:
        raise FormatError(too_many_pixels(max_pixels, f"{columns} x {rows}"))
    check_points(rows * columns, "")
    limit = byte_limit(None)
    if limit and rows * columns > limit:  # a pixel takes at least one byte
        raise FormatError(over_max_bytes(limit))


# --- PGM: read here, because Pillow rescales the numbers if the maximum is not 65535 ------------

_PGM_HEADER = re.compile(
    rb"P5" + 3 * rb"(?:\s|#[^\n\r]{0,1000}[\n\r]){1,100}(\d{1,9})" + rb"\s", re.DOTALL
)


def _read_pgm(data: bytes, max_pixels: int, may_be_narrow: bool) -> NDArray[np.uint8 | np.uint16]:
    header = _PGM_HEADER.match(data, 0, 8192)
    if header is None:
        raise FormatError("expected a PGM header 'P5 WIDTH HEIGHT MAXIMUM'", byte_offset=0)
    columns, rows, largest = (int(field) for field in header.groups())
    _checked_size(rows, columns, max_pixels)
    if not (0 if may_be_narrow else 255) < largest < 65536:
        raise FormatError(f"expected a PGM of 16 bits (maximum 256 to 65535), got {largest}")
    dtype = np.dtype(">u2" if largest > 255 else np.uint8)
    size = dtype.itemsize * rows * columns
    if len(data) - header.end() < size:
        raise FormatError(
            f"expected {size} bytes of pixels, got {len(data) - header.end()}",
            byte_offset=header.end(),
        )
    pixels = np.frombuffer(data, dtype, rows * columns, header.end()).reshape(rows, columns)
    if pixels.max() > largest:
        raise FormatError(f"expected values up to {largest}, got {pixels.max()}")
    return pixels.astype(dtype.newbyteorder("="))


# --- PFM: floats, the lowest row first -----------------------------------------------------------

_PFM_HEADER = re.compile(rb"P([fF])\s+(\d{1,9})\s+(\d{1,9})\s+([-+]?[0-9.eE+-]{1,32})(\r\n|\s)")


def _read_pfm(data: bytes, max_pixels: int) -> NDArray[np.float32]:
    header = _PFM_HEADER.match(data, 0, 8192)
    try:
        scale = float(header[4]) if header else 0.0
    except ValueError:
        scale = 0.0
    if header is None or not scale:
        raise FormatError("expected a PFM header 'Pf WIDTH HEIGHT SCALE'", byte_offset=0)
    if header[1] == b"F":
        raise FormatError("expected a PFM of one channel (Pf), got colours (PF)", byte_offset=0)
    columns, rows = int(header[2]), int(header[3])
    _checked_size(rows, columns, max_pixels)
    size, start = 4 * rows * columns, header.end()
    if header[5] == b"\r\n" and len(data) - start < size:
        start -= 1  # the header ends with \r alone, and the first byte of the pixels is a \n
    if len(data) - start < size:
        raise FormatError(
            f"expected {size} bytes of pixels, got {len(data) - start}", byte_offset=start
        )
    order = "<f4" if scale < 0 else ">f4"
    pixels = np.frombuffer(data, order, rows * columns, start).reshape(rows, columns)[::-1]
    # Middlebury and others store infinity for "no measurement".
    return np.where(np.isinf(pixels), np.float32(0.0), pixels).astype(np.float32)


# --- EXR ---------------------------------------------------------------------------------------

_NOTHING_HIT = 65504.0
"""Largest finite half-precision number. Blender writes it, or 1e10, where a ray hits nothing."""

_OF_DEPTH = ("z", "depth", "y", "v", "r", "g", "b")  # last parts of names of a pass with the depth
_DEPTH_CHANNELS = {"z": "xy", "y": "xz", "v": "u"}
"""Last parts of names such as "ViewLayer.Depth.Z", with the parts beside which they are vectors."""


def _read_exr(
    data: bytes, max_pixels: int, channel_of: Callable[[dict[str, NDArray[Any]]], str]
) -> NDArray[np.float32]:
    OpenEXR = imported("OpenEXR", "exr")

    def opened(*, header_only: bool) -> Any:
        stream = io.BytesIO(data)
        return OpenEXR.File(stream, separate_channels=True, header_only=header_only, num_threads=0)

    try:
        with contextlib.redirect_stdout(sys.stderr):  # OpenEXR prints its errors
            with opened(header_only=True) as file:
                headers = [dict(part.header) for part in file.parts]  # closing empties the headers
            windows = _checked_windows(headers, max_pixels)
            with opened(header_only=False) as file:
                if len(file.parts) < len(headers):  # OpenEXR leaves out what it cannot decode
                    raise FormatError("damaged .exr: a part cannot be decoded")
                found = _channels_of_parts(file)
        name = channel_of({name: pixels for name, (_, pixels) in found.items()})
        part, pixels = found[name]
        window, shown = windows[part]
        stored = np.asarray(pixels, np.float32)
        if stored.shape != window.size:
            rows, columns = window.size
            raise FormatError(f"expected {columns} x {rows} pixels, got shape {stored.shape}")
    except Error:
        raise
    except Exception as error:  # OpenEXR raises various types for damaged files
        raise FormatError(f"damaged .exr: {str(error) or type(error).__name__}") from error
    return _in_window(np.where(stored < _NOTHING_HIT, stored, np.float32(0.0)), window, shown)


def _channels_of_parts(file: Any) -> dict[str, tuple[int, NDArray[Any]]]:
    """Return the part's index and the pixels of each channel of an open EXR file.

    In a file of several parts, the part's name is the layer of its channels: channel "Z" of part
    "ViewLayer.Depth" becomes "ViewLayer.Depth.Z", unless it is stored under this name.
    """
    found = {}
    for index, part in enumerate(file.parts):
        layer = f"{part.name()}." if len(file.parts) > 1 else ""
        for name, channel in file.channels(index).items():
            found[layer + name.removeprefix(layer)] = index, channel.pixels
    return found


class _Window(NamedTuple):
    """A window of an EXR file; ``right`` and ``bottom`` lie just beyond its last pixel."""

    left: int
    top: int
    right: int
    bottom: int

    @staticmethod
    def of(stored: Any) -> _Window:
        (left, top), (right, bottom) = stored
        return _Window(int(left), int(top), int(right) + 1, int(bottom) + 1)

    @property
    def size(self) -> tuple[int, int]:
        """Number of rows and of columns."""
        return self.bottom - self.top, self.right - self.left


def _checked_windows(
    headers: Sequence[dict[str, Any]], max_pixels: int
) -> list[tuple[_Window, _Window]]:
    """Return the data and the display window of each part; all parts are read at once."""
    windows, numbers = [], 0
    for header in headers:
        window, shown = _Window.of(header["dataWindow"]), _Window.of(header["displayWindow"])
        if shown.size == (1, 1):  # programs that do not know it write 0
            shown = window
        _checked_size(*window.size, max_pixels)
        _checked_size(*shown.size, max_pixels)
        windows.append((window, shown))
        rows, columns = window.size
        numbers += rows * columns * len(header["channels"])
    if numbers > 2 * max_pixels:
        raise FormatError(f"more than {2 * max_pixels} numbers in all channels")
    return windows


def _in_window(stored: NDArray[np.float32], window: _Window, shown: _Window) -> NDArray[np.float32]:
    """Return the image of the display window, to which the camera belongs, from the stored pixels.

    Renderers store only a part where the rest is empty, or more than the image (overscan).
    """
    if window == shown:
        return stored
    left, top = max(window.left, shown.left), max(window.top, shown.top)
    right, bottom = min(window.right, shown.right), min(window.bottom, shown.bottom)
    if left >= right or top >= bottom:
        raise FormatError("expected pixels in the display window, got none")
    image = np.zeros(shown.size, np.float32)
    part = stored[top - window.top : bottom - window.top, left - window.left : right - window.left]
    image[top - shown.top : bottom - shown.top, left - shown.left : right - shown.left] = part
    return image


def _depth_channel(channels: dict[str, NDArray[Any]]) -> str:
    """Return the name of the only channel, or of depth, or of red if R, G and B are equal.

    A renderer's passes are layers: "ViewLayer.Depth.Z" is the depth, "ViewLayer.Normal.Z" and the
    fog "ViewLayer.Mist.Z" are not.
    """
    if len(channels) == 1:
        return next(iter(channels))
    passes = {name: name.lower().split(".") for name in channels}
    named = [n for n, parts in passes.items() if "depth" in parts and parts[-1] in _OF_DEPTH]
    single = [name for name, parts in passes.items() if _is_single(parts, [*passes.values()])]
    if len(named) > 1:
        named = [n for n in named if passes[n][-1] in ("z", "depth")] or _grey(named, channels)
    elif not named:
        named = [name for name in single if name == "Z"] or single
        if not named:
            named = _grey([name for name in channels if name in ("R", "G", "B")], channels)
    return _only(named, channels, "Z or Depth")


def _map_channel(channels: dict[str, NDArray[Any]], names: Sequence[str]) -> str:
    """Return the name of the only channel, or of one with a known name, or of the grey ones."""
    if len(channels) == 1:
        return next(iter(channels))
    named = [name for name in channels if not set(names).isdisjoint(name.lower().split("."))]
    found = named or [name for name in channels if name in ("Y", "R", "G", "B")]
    return _only(found if len(found) == 1 else _grey(found, channels), channels, " or ".join(names))


def _only(found: Sequence[str], channels: dict[str, NDArray[Any]], expected: str) -> str:
    if len(found) == 1:
        return found[0]
    names = ", ".join(repr(name[:40]) for name in sorted(channels)[:20]) or "none"
    raise FormatError(f"expected one channel, or one named {expected}, got {names}")


def _is_single(parts: Sequence[str], others: Sequence[Sequence[str]]) -> bool:
    """Return whether a channel is called like a depth, and is no part of a vector."""
    *layer, last = parts
    if last not in _DEPTH_CHANNELS or "mist" in layer:
        return False
    return all([*layer, beside] not in others for beside in _DEPTH_CHANNELS[last])


def _grey(names: Sequence[str], channels: dict[str, NDArray[Any]]) -> list[str]:
    """Return the name of red if just red, green and blue are among the names and equal."""
    color = [name for name in sorted(names) if name.rpartition(".")[2] in ("R", "G", "B")]
    values = [channels[name] for name in color]
    is_grey = all(np.array_equal(each, values[0], equal_nan=True) for each in values)
    return color[-1:] if len(color) == 3 and is_grey else []


# --- NumPy -------------------------------------------------------------------------------------


_DEPTH_DTYPES = (
    np.uint16, np.int16, np.uint32, np.int32, np.uint64, np.int64,
    np.float16, np.float32, np.float64,
)  # fmt: skip
_MAP_DTYPES = (np.bool_, np.uint8, np.int8, *_DEPTH_DTYPES)


def _array_of_npz(data: bytes, max_pixels: int, known: tuple[str, ...]) -> bytes:
    """Return the only array of an archive as a .npy file, or the first that has a known name."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            arrays = {
                entry.filename.removesuffix(".npy"): entry
                for entry in archive.infolist()
                if entry.filename.endswith(".npy")
            }
            found = [*arrays] if len(arrays) == 1 else [name for name in known if name in arrays]
            if not found:
                names = ", ".join(sorted(arrays)[:20]) or "none"
                expected = " or ".join(known)
                raise FormatError(f"expected one array, or one named {expected}, got {names}")
            entry = arrays[found[0]]
            refuse_expansion(entry.file_size, len(data), byte_limit(None), "")
            with archive.open(entry) as member:
                return member.read(8 * max_pixels + HEADER_BYTES)
    except Error:
        raise
    except Exception as error:  # zipfile and zlib raise various types for damaged files
        raise FormatError(f"damaged .npz: {str(error) or type(error).__name__}") from error


def _depth_of_npy(data: bytes, max_pixels: int) -> NDArray[Any]:
    """Return the depth image of a .npy file as uint16, float32 or float64."""
    stored = _with_single_floats(_read_npy(data, max_pixels, _DEPTH_DTYPES))
    if stored.dtype.kind == "f":
        return stored
    if stored.dtype == np.uint16:
        return stored.astype(np.uint16, copy=False)
    return _whole_depth(stored)


def _with_single_floats(stored: NDArray[Any]) -> NDArray[Any]:
    return stored.astype(np.float32) if stored.dtype == np.float16 else stored


def _whole_depth(stored: NDArray[Any]) -> NDArray[np.uint16]:
    """Return whole numbers, of which negative ones mean no measurement, as in images of floats."""
    if stored.max() > 65535:
        raise FormatError(f"expected whole numbers of at most 65535, got {stored.max()}")
    return np.asarray(np.maximum(stored, 0), np.uint16)


def _read_npy(data: bytes, max_pixels: int, dtypes: tuple[type[np.generic], ...]) -> NDArray[Any]:
    shape, fortran, dtype, start = read_npy_header(data)
    while len(shape) > 2 and shape[0] == 1:
        shape = shape[1:]
    while len(shape) > 2 and shape[-1] == 1:
        shape = shape[:-1]
    if len(shape) != 2 or dtype.newbyteorder("=") not in dtypes:
        *names, last = (np.dtype(known).name for known in dtypes)
        raise FormatError(
            f"expected a 2-D array of {', '.join(names)} or {last}, got {dtype} {shape}"
            f"{_advice_on_shape(shape)}"
        )
    _checked_size(*shape, max_pixels)
    size = shape[0] * shape[1] * dtype.itemsize
    if len(data) - start < size:
        raise FormatError(
            f"expected {size} bytes of pixels, got {len(data) - start}", byte_offset=start
        )
    pixels = np.frombuffer(data, dtype, shape[0] * shape[1], start)
    values: NDArray[Any] = pixels.reshape(shape, order="F" if fortran else "C")
    return values.astype(dtype.newbyteorder("="), copy=False)


_MAX_CHANNELS = 4
"""Largest number of channels of an image; no depth image is that narrow."""


def _advice_on_shape(shape: tuple[int, ...]) -> str:
    """Return how an array of another shape becomes a depth image, to be added to an error."""
    if len(shape) == 1:
        return "; array.reshape(height, width) has the rows of an image"
    if len(shape) != 3 or min(shape) == 0:
        return ""
    if shape[-1] <= _MAX_CHANNELS:
        return "; array[..., k] is channel k of an image"
    if shape[0] > _MAX_CHANNELS:
        return "; array[k] is image k of several"
    cloud = ", and np.moveaxis(array, 0, -1) an organised cloud of x, y, z" if shape[0] == 3 else ""
    return f"; the channels are first: array[k] is channel k{cloud}"


# --- Images that Pillow reads -------------------------------------------------------------------

_PICTURES = ("PNG", "TIFF", "JPEG", "BMP", "WEBP")
_COLOR_MODES = ("P", "LA", "RGB", "RGBA")  # of Pillow
_BITS_PER_SAMPLE = 258  # number of this tag in TIFF


def _read_with_pillow(
    data: bytes,
    max_pixels: int,
    narrow_modes: tuple[str, ...],
    grey_of: Callable[[bytes, Image.Image], NDArray[Any]] | None,
) -> NDArray[Any]:
    """Read an image with one channel of 16-bit integers or floats, or in a given mode.

    Images of Pillow's modes ``narrow_modes`` are returned unchanged. Colours of 8 bits are reduced
    to one channel by ``grey_of``, or refused if it is None.
    """
    pillow = imported("PIL.Image", "io")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # files about which Pillow warns are refused
            with pillow.open(io.BytesIO(data), formats=_PICTURES) as image:
                _checked_size(image.height, image.width, max_pixels)
                if image.mode in narrow_modes:
                    return np.array(image)
                if grey_of is not None and image.mode in _COLOR_MODES:
                    return grey_of(data, image)
                if not image.mode.startswith("I;16") and image.mode not in ("I", "F"):
                    bits = "8 or 16 bits" if narrow_modes else "16 bits"
                    kinds = f"{bits} of grey, or colours" if grey_of else f"{bits} of grey"
                    raise FormatError(f"expected {kinds}, got mode {image.mode}")
                _read_native_order(image)
                stored = np.array(image)
                has_more = _has_more(image)
    except Error:
        raise
    except pillow.UnidentifiedImageError as error:  # its message names neither file nor reason
        kinds = "whole numbers of 8, 16 or 32 bits or fractions of 32 bits"
        raise FormatError(f"expected an image of {kinds}, or the file is damaged") from error
    except Exception as error:  # Pillow's parsers raise various types for damaged files
        reason = str(error) or type(error).__name__
        raise FormatError(f"damaged image: {reason}") from error
    if has_more:
        warnings.warn(
            "a file of several images, of which the first is read", stacklevel=caller_level()
        )
    # Pillow reads a PNG of 16 bits as int32 in some versions.
    is_narrow = stored.dtype.kind == "u" or data.startswith(_PNG)
    return stored.astype(np.uint16) if is_narrow else stored


def _orientation(data: bytes) -> int:
    with imported("PIL.Image", "io").open(io.BytesIO(data), formats=_PICTURES) as image:
        return orientation_of(image)


def _read_native_order(image: Any) -> None:
    """Make Pillow read the numbers of a compressed TIFF in the byte order of this machine.

    Libtiff decodes to this order. Pillow knows that of uint16, and swaps the bytes of all other
    numbers of big-endian files once more.
    """
    if not image.tile or image.tile[0][0] != "libtiff":
        return
    tile = image.tile[0]
    rawmode, *rest = tile[3]
    args = (re.sub(r";(16|32)B", r";\1N", rawmode), *rest)
    # Before Pillow 11 it is a plain tuple.
    image.tile = [tile._replace(args=args) if hasattr(tile, "_replace") else (*tile[:3], args)]


def _cut_out(data: bytes, image: Image.Image) -> NDArray[Any]:
    """Return a cut-out as white before transparent black; see `_brightest_channel` for others."""
    if image.mode in ("RGBA", "LA"):
        is_shown = np.array(image.getchannel("A")) > 0
        if not is_shown.all():
            return np.where(is_shown, np.uint8(255), np.uint8(0))
    return _brightest_channel(data, image)


def _brightest_channel(data: bytes, image: Image.Image) -> NDArray[Any]:
    """Return the largest of red, green and blue, and 0 where an alpha channel is 0."""
    if (depth := _bits_of_channel(data, image)) > 8:  # Pillow would keep only the upper 8 bits
        raise FormatError(f"expected colours of 8 bits, got {depth}")
    channels = np.array(image.convert("RGBA"))
    brightest = np.asarray(channels[..., :3].max(axis=2))
    # The shape of a cut-out is its alpha channel: under it are the colours of the whole picture. A
    # label of a palette that is shown transparent is still a label.
    if image.mode in ("RGBA", "LA"):
        brightest[channels[..., 3] == 0] = 0
    return brightest


def _has_more(image: Image.Image) -> bool:
    """Return whether the file has a second image of the same size; a smaller one is an overview."""
    size = image.size
    try:
        image.seek(1)
    except Exception:  # there is no second image, or it is damaged, while the first can be read
        return False
    return image.size == size


def _bits_of_channel(data: bytes, image: Image.Image) -> int:
    """Return the number of bits per channel of a PNG or TIFF."""
    if data.startswith(_PNG):
        return data[24]
    bits: tuple[int, ...] = getattr(image, "tag_v2", {}).get(_BITS_PER_SAMPLE, (1,))
    return max(bits)
