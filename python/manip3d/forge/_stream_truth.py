"""Ground truth of forged RGB-D streams in files."""

from __future__ import annotations

import io
import math
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING
from zipfile import ZipFile

import numpy as np

from manip3d._util.archives import NPZ_ERRORS
from manip3d._util.arrays import rows
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_write, regular_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]

_MAX_BYTES = 160 << 20
_MAX_PIXELS_OF_A_BYTE = 2048  # 200 to 500 for masks with a person, 8000 for empty masks
_MAX_PIXELS = 2**38  # of all frames: eight hours of 640 x 480 pixels at 30 Hz


@dataclass(frozen=True, eq=False)
class StreamTruth:
    """Ground truth of a forged recording.

    Attributes
    ----------
    kind : int
        Type of the forgery. 1: the person as recorded; 2: the person in other poses.
    masks : (T, H, W) bool
        Forged pixels of each frame.
    numbers : (T,) int64
        `RgbdFrame.number` of each frame.

    Raises
    ------
    InputError
        ``kind`` is neither 1 nor 2, ``masks`` are no masks of frames with pixels, or ``numbers`` is
        no list of a whole number for each of them.
    """

    kind: int
    masks: Mask
    numbers: NDArray[np.int64]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.kind not in (1, 2):
            raise InputError(f"kind: expected 1 or 2, got {self.kind}")
        masks, numbers = np.asarray(self.masks), rows(self.numbers, None, np.int64, "numbers")
        if masks.ndim != 3 or masks.dtype != np.bool_ or (len(masks) and not masks.size):
            raise InputError(f"masks: expected bool (T, H, W), got {masks.dtype} {masks.shape}")
        if len(numbers) != len(masks):
            raise InputError(
                f"numbers: expected {len(masks)}, one for each mask, got {len(numbers)}"
            )
        object.__setattr__(self, "masks", masks)
        object.__setattr__(self, "numbers", numbers)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the ground truth as a NumPy archive (``.npz``), atomically.

        Parameters
        ----------
        path : path
            Path of the ``.npz`` file. `read_stream_truth` needs a larger ``max_bytes`` to read it
            if masks of more than 160 MiB have hardly any forged pixels.

        Raises
        ------
        InputError
            There are more pixels than `read_stream_truth` accepts.
        OSError
            The file cannot be written.
        """
        check_size(self.masks.size)
        shape = (self.masks.shape[0], self.masks.shape[1], self.masks.shape[2])
        write_truth(path, self.kind, shape, np.packbits(self.masks), self.numbers)


def check_size(pixels: int) -> None:
    if pixels > _MAX_PIXELS:
        raise InputError(f"masks: expected at most {_MAX_PIXELS} pixels in all, got {pixels}")


def write_truth(
    path: str | os.PathLike[str],
    kind: int,
    shape: tuple[int, int, int],
    bits: NDArray[np.uint8],
    numbers: NDArray[np.int64],
) -> None:
    """Write the masks of a stream, packed to one run of bits over all frames."""
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
    """Read a file of `StreamTruth.write`.

    Parameters
    ----------
    path : path-like
        An ``.npz`` archive.
    max_bytes : int, optional
        Largest size of the masks in memory, one byte per pixel. Default: the larger of 160 MiB (772
        frames of a Kinect V2) and 2048 bytes per byte of the file. Masks with a person compress
        less than that; empty ones compress so well that the size of the file does not bound theirs.

    Returns
    -------
    StreamTruth

    Raises
    ------
    FormatError
        The file is no such archive, or its masks take more than ``max_bytes``.
    OSError
        The file cannot be read.

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
        max_bytes = max(_MAX_BYTES, _MAX_PIXELS_OF_A_BYTE * len(content))
    try:
        claimed_numbers = _check_claims(content, max_bytes)
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            frames, height, width = (int(side) for side in archive["shape"])
            size = frames * height * width
            if size > min(_MAX_PIXELS, max_bytes):
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
    except NPZ_ERRORS as error:
        raise FormatError(
            f"expected the truth of a forged stream: {error}", file=str(path)
        ) from None
    return StreamTruth(kind, masks, numbers)


def _check_claims(content: bytes, max_bytes: int) -> tuple[int, ...]:
    """Refuse arrays whose headers claim more than the file holds, before memory is allocated.

    Returns the shape of ``numbers`` in its header, which must agree with the masks.
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
