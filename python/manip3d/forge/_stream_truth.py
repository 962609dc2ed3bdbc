"""The truth about a forged RGB-D stream, in a file."""

from __future__ import annotations

import io
import math
import os
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING
from zipfile import BadZipFile, ZipFile

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_write, regular_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]

_MOST_BYTES = 160 << 20
_MOST_PIXELS_OF_A_BYTE = 2048  # masks with a person in them are 200 to 500, empty ones 8000
_MOST_PIXELS = 2**38  # in all frames: eight hours of a depth camera of 640x480 at 30 Hz


@dataclass(frozen=True, eq=False)
class StreamTruth:
    """Truth about a forged recording.

    Attributes
    ----------
    kind : int
        1: the person as recorded; 2: in another pose.
    masks : (T, H, W) bool
        Forged pixels of each frame.
    numbers : (T,) int64
        `RgbdFrame.number` of each frame.
    """

    kind: int
    masks: Mask
    numbers: NDArray[np.int64]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the truth as a NumPy archive (``.npz``), whole or not at all.

        Parameters
        ----------
        path : path
            An ``.npz`` file; `read_stream_truth` reads it, if it is told ``max_bytes`` where more
            than 160 MiB of pixels have nearly no forged one among them.

        Raises
        ------
        InputError
            There are more pixels than `read_stream_truth` takes.
        OSError
            The file cannot be written.
        """
        check_size(self.masks.size)
        shape = (self.masks.shape[0], self.masks.shape[1], self.masks.shape[2])
        write_truth(path, self.kind, shape, np.packbits(self.masks), self.numbers)


def check_size(pixels: int) -> None:
    if pixels > _MOST_PIXELS:
        raise InputError(f"masks: expected at most {_MOST_PIXELS} pixels in all, got {pixels}")


def write_truth(
    path: str | os.PathLike[str],
    kind: int,
    shape: tuple[int, int, int],
    bits: NDArray[np.uint8],
    numbers: NDArray[np.int64],
) -> None:
    """Write the masks of a stream, packed in one run over all frames."""
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        kind=np.int64(kind),
        shape=np.array(shape, np.int64),
        masks=bits,
        numbers=numbers,
    )
    atomic_write(path_of(path), stream.getvalue())


@checked
def read_stream_truth(path: str | os.PathLike[str], *, max_bytes: int | None = None) -> StreamTruth:
    """Read what `StreamTruth.write` has written.

    Parameters
    ----------
    path : path-like
        An ``.npz`` archive.
    max_bytes : int, optional
        Refuse masks of more pixels, each of which takes a byte. Default: 160 MiB, which are 772
        frames of a Kinect V2, or 2048 for each byte of the file if that is more: masks with a
        person in them compress less, empty ones so well that a file says little of their size.

    Returns
    -------
    StreamTruth

    Raises
    ------
    FormatError
        The file is no such archive, or its masks take more than ``max_bytes``.
    OSError
        It cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import forge
    >>> masks = np.zeros((2, 48, 64), bool)
    >>> masks[1, 10:20, 10:20] = True
    >>> forge.StreamTruth(1, masks, np.arange(2)).write("truth.npz")
    >>> forge.read_stream_truth("truth.npz").masks.sum(axis=(1, 2)).tolist()
    [0, 100]
    """
    content = regular_bytes(path_of(path))
    if max_bytes is None:
        max_bytes = max(_MOST_BYTES, _MOST_PIXELS_OF_A_BYTE * len(content))
    try:
        claimed_numbers = _check_claims(content, max_bytes)
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            frames, height, width = (int(side) for side in archive["shape"])
            size = frames * height * width
            if size > min(_MOST_PIXELS, max_bytes):
                raise ValueError(f"{size} pixels are more than max_bytes = {max_bytes}")
            if claimed_numbers != (frames,) or (frames and not size):
                raise ValueError("numbers do not agree with the masks")
            bits, numbers = archive["masks"], archive["numbers"]
            kind = int(archive["kind"])
        if min(frames, height, width) < 0 or (size + 7) // 8 != bits.size or kind not in (1, 2):
            raise ValueError("sizes do not agree")
        flat = np.unpackbits(bits.astype(np.uint8, casting="no", copy=False), count=size)
        masks = flat.view(np.bool_).reshape(frames, height, width)
        if numbers.dtype != np.int64:
            raise ValueError("numbers do not agree with the masks")
    except (
        ValueError,
        KeyError,
        EOFError,
        TypeError,
        OverflowError,
        MemoryError,
        OSError,  # of the archive: the file itself was read
        NotImplementedError,  # a version or a compression of zip
        RuntimeError,  # encrypted
        BadZipFile,
        zlib.error,
    ) as error:
        raise FormatError(
            f"expected the truth of a forged stream: {error}", file=str(path)
        ) from None
    return StreamTruth(kind, masks, numbers)


def _check_claims(content: bytes, max_bytes: int) -> tuple[int, ...]:
    """Refuse arrays that claim more than there is, before anything is allocated for them.

    Returns the shape that the numbers claim, which is to agree with that of the masks.
    """
    numbers: tuple[int, ...] = ()
    with ZipFile(io.BytesIO(content)) as archive:
        for member in archive.infolist():
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                if version != (1, 0):
                    raise ValueError(f"an array of version {version}")
                shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                if math.prod(shape) * dtype.itemsize > member.file_size:
                    raise ValueError(f"{member.filename} claims {shape} {dtype}, and has less")
                if member.filename == "numbers.npy":
                    numbers = shape
                    continue
                if math.prod(shape) * dtype.itemsize > max_bytes // 8 + 64:  # eight pixels a byte
                    raise ValueError(f"{member.filename} is for more than max_bytes = {max_bytes}")
    return numbers
