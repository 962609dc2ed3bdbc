"""Pictures of RGB-D frames as they were stored, and sheets of several pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.rgbd import NO_BODY, RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.viewer.scene import Image

_COLUMNS = 400  # about the width of a picture on a sheet, pixels


@checked
def rgbd_picture(frame: RgbdFrame) -> Image:
    """Return a picture of a frame: depth in grey (near is bright), and its colour image beside it.

    Pixels of people are tinted.

    Parameters
    ----------
    frame : RgbdFrame

    Returns
    -------
    (H, W, 3) uint8, sRGB
        H is the height of the depth image, to which the colour image is reduced.

    Raises
    ------
    InputError
        ``frame`` is not an RGB-D frame.

    Examples
    --------
    >>> from manip3d import capture, viewer
    >>> with capture.open_rgbd("sim:body?frames=2") as person:
    ...     pictures = [viewer.rgbd_picture(frame) for frame in person]
    >>> pictures[0].shape
    (424, 1024, 3)
    >>> viewer.sheet(pictures).shape
    (142, 684, 3)
    """
    depth = frame.depth.astype(np.float32)
    seen = depth > 0
    near, far = np.percentile(depth[seen], (1, 99)) if seen.any() else (0.0, 1.0)
    bright = np.clip((far - depth) / max(far - near, 1.0), 0.0, 1.0)
    grey = np.where(seen, 55 + 200 * bright, 0).astype(np.uint8)
    image = np.repeat(grey[..., None], 3, axis=2)
    if frame.body_index is not None:
        image[..., 2] = np.where(frame.body_index != NO_BODY, image[..., 2] // 3, image[..., 2])
    if frame.color is None:
        return image
    rows = np.arange(image.shape[0]) * frame.color.shape[0] // image.shape[0]
    width = frame.color.shape[1] * image.shape[0] // frame.color.shape[0]
    columns = np.arange(width) * frame.color.shape[1] // max(width, 1)
    return np.concatenate([image, frame.color[np.ix_(rows, columns)]], axis=1)


@checked
def sheet(images: Sequence[NDArray[Any]]) -> Image:
    """Return pictures as a grid, each reduced to about 400 columns.

    Parameters
    ----------
    images : sequence of (H, W, 3) uint8
        Pictures, row by row; they may differ in size.

    Returns
    -------
    (H, W, 3) uint8
        A grid with ceil(sqrt(n)) columns; what no picture covers is black.

    Raises
    ------
    InputError
        There is no picture, or one of another shape or type.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import viewer
    >>> viewer.sheet([np.full((60, 80, 3), 255, np.uint8)] * 3).shape
    (120, 160, 3)
    """
    tiles = [_checked(image) for image in images]
    if not tiles:
        raise InputError("images: expected at least one picture, got none")
    height, width = (max(tile.shape[axis] for tile in tiles) for axis in (0, 1))
    step = max(1, round(width / _COLUMNS))
    columns = int(np.ceil(np.sqrt(len(tiles))))
    rows = -(-len(tiles) // columns)
    height, width = -(-height // step), -(-width // step)
    grid = np.zeros((rows * height, columns * width, 3), np.uint8)
    for i, tile in enumerate(tiles):
        small = tile[::step, ::step]
        top, left = i // columns * height, i % columns * width
        grid[top : top + small.shape[0], left : left + small.shape[1]] = small
    return grid


def _checked(image: Any) -> Image:
    if not (
        isinstance(image, np.ndarray)
        and image.dtype == np.uint8
        and image.ndim == 3
        and image.shape[2] == 3
        and image.size
    ):
        raise InputError("images: expected pictures, (H, W, 3) uint8")
    return image
