"""Read and clear watermark records in the lowest bits of pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def checked_picture(picture: ArrayLike) -> NDArray[np.uint8]:
    """Return a picture as a uint8 array, grey or RGB."""
    pixels = np.asarray(picture)
    if pixels.dtype != np.uint8 or not (
        pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)
    ):
        raise InputError(
            f"picture: expected uint8 (H, W) or (H, W, 3), got {pixels.dtype} {pixels.shape}"
        )
    return np.ascontiguousarray(pixels)


@checked
def record_of_picture(picture: ArrayLike) -> bytes:
    """Return the watermark record that a picture carries in its pixels, without verifying it.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) uint8
        Picture that carries a record.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        ``picture`` has another shape or dtype, or fewer than 16384 samples.
    FormatError
        The picture carries no record.

    Examples
    --------
    >>> import tempfile, numpy as np, manip3d
    >>> from manip3d.authenticate import KeyFile, Watermarker, record_of_picture
    >>> scan = manip3d.LidarFrame(np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8)
    >>> grey = np.full((375, 1242), 128, np.uint8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     marker = Watermarker(KeyFile.create(folder + "/sensor.key"))
    ...     sent = marker.embed(scan, picture=grey)
    ...     print(marker.verify(sent.frame, None, picture=sent.picture).verdict)
    authentic
    >>> record_of_picture(sent.picture) == sent.record
    True
    """
    return _core.watermark_in_picture(checked_picture(picture))


@checked
def without_record(picture: ArrayLike) -> NDArray[np.uint8]:
    """Return a copy of a picture in which the bits that can carry a record are 0.

    Results that sender and receiver both compute from it, such as the stereo depth of the printed
    watermark, are the same before and after embedding.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) uint8
        Picture with or without a record.

    Returns
    -------
    (H, W) or (H, W, 3) uint8
        The copy.

    Raises
    ------
    InputError
        ``picture`` has another shape or dtype, or fewer than 16384 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import without_record
    >>> int(without_record(np.full((128, 128), 255, np.uint8)).max())
    254
    """
    pixels = checked_picture(picture)
    return _core.without_watermark_record(pixels).reshape(pixels.shape)
