"""Orientation of pictures as their EXIF data state it."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from PIL import Image

_Pixel = TypeVar("_Pixel", bound=np.generic)

SAME_SHAPE = 0.005
"""Largest relative difference of the aspect ratios of two images of the same view: one row or
column of 200, as resizing rounds it."""

_ORIENTATION = 274  # number of this tag in EXIF
_TURNS: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    2: lambda stored: stored[:, ::-1],
    3: lambda stored: stored[::-1, ::-1],
    4: lambda stored: stored[::-1],
    5: lambda stored: stored.swapaxes(0, 1),
    6: lambda stored: stored.swapaxes(0, 1)[:, ::-1],
    7: lambda stored: stored.swapaxes(0, 1)[::-1, ::-1],
    8: lambda stored: stored.swapaxes(0, 1)[::-1],
}
"""The transform from the stored to the upright image for each orientation but 1, which is none."""


def orientation_of(image: Image.Image) -> int:
    """Return the orientation in an image's EXIF data; 1, which is none, if they state none.

    Pillow itself turns TIFFs upright.
    """
    if image.format == "TIFF":
        return 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged EXIF data do not matter for the pixels
            return int(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # Pillow's parsers raise various types for damaged data
        return 1


def upright(
    stored: NDArray[_Pixel], orientation: int, shape: tuple[int, ...] | None = None
) -> NDArray[_Pixel]:
    """Return an image (H, W) or (H, W, C) upright.

    If only the stored image has the aspect ratio of ``shape`` (rows, columns), that of the depth
    image to which it belongs, it is returned as it is: both images are those of the sensor.
    """
    turn = _TURNS.get(orientation)
    if turn is None:
        return stored
    turned = turn(stored)
    if shape is not None and _fits(stored, shape) and not _fits(turned, shape):
        return stored
    return np.ascontiguousarray(turned)


def _fits(image: NDArray[Any], shape: tuple[int, ...]) -> bool:
    rows, columns = (float(side) for side in image.shape[:2])
    return abs(columns / shape[1] * shape[0] / rows - 1.0) <= SAME_SHAPE
