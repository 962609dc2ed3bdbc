"""Masks and confidences of the pixels of a depth image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["confidence_of_levels"]


@checked
def confidence_of_levels(levels: ArrayLike, highest: int) -> NDArray[np.float32]:
    """Return the confidence of each pixel from the confidence levels of a camera.

    Parameters
    ----------
    levels : (H, W) whole numbers of at least 0, of any type
        Confidence levels; 0: the pixel is not used.
    highest : int
        Level of full confidence: 2 for ARKit, 15 for a RealSense L515, 255 for a grey image.

    Returns
    -------
    (H, W) float32
        Confidence ``levels / highest``, for `relief`.

    Raises
    ------
    InputError
        A wrong shape, ``highest`` below 1, or a level that is not whole, below 0 or above
        ``highest``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> simplify.confidence_of_levels(np.array([[0, 1, 2]], np.uint8), 2).tolist()
    [[0.0, 0.5, 1.0]]
    """
    found = as_array(levels, "levels")
    if found.ndim != 2:
        raise InputError(f"levels: expected shape (H, W), got {found.shape}")
    if isinstance(highest, bool) or not isinstance(highest, int | np.integer) or highest < 1:
        raise InputError(f"highest: expected a whole number of at least 1, got {highest!r}")
    return shares_of_levels(found, highest, "levels")


def shares_of_levels(levels: NDArray[Any], highest: int, name: str) -> NDArray[np.float32]:
    """Return levels, which have to be whole numbers from 0 to the highest, as shares of it."""
    is_level = (levels >= 0) & (levels <= highest)
    if levels.dtype.kind == "f":
        is_level &= levels == np.floor(levels)
    if not is_level.all():
        raise InputError(
            f"{name}: expected whole numbers from 0 to {highest}, got {levels[~is_level][0]}"
        )
    return (levels / np.float64(highest)).astype(np.float32)


def mask_image(
    mask: ArrayLike | None, shape: tuple[int, ...], name: str = "mask"
) -> NDArray[np.bool_] | None:
    """Check a mask of the given shape; True: the pixel is used."""
    if mask is None:
        return None
    found = as_array(mask, name)
    _expect_shape(found, shape, name)
    if found.dtype != np.bool_:
        raise InputError(f"{name}: expected bool, got {found.dtype}; `mask != 0` is one")
    return found


def confidence_image(
    confidence: ArrayLike | None, shape: tuple[int, ...], name: str = "confidence"
) -> NDArray[np.float32] | None:
    """Check confidences of the given shape, 0 to 1."""
    if confidence is None:
        return None
    found = as_array(confidence, name)
    _expect_shape(found, shape, name)
    if found.dtype.kind != "f":
        raise InputError(
            f"{name}: expected floats, got {found.dtype}; confidence_of_levels makes them from a "
            "camera's levels"
        )
    if np.isnan(found).any():
        raise InputError(f"{name}: expected 0 to 1, got {np.isnan(found).sum()} NaN")
    if not ((found >= 0) & (found <= 1)).all():
        raise InputError(
            f"{name}: expected 0 to 1, got {float(found.min())!r} to {float(found.max())!r}"
        )
    return np.ascontiguousarray(found, dtype=np.float32)


def _expect_shape(found: NDArray[Any], shape: tuple[int, ...], name: str) -> None:
    if found.shape != shape:
        raise InputError(f"{name}: expected shape {shape}, got {found.shape} (rows, columns)")


def masked_depth(
    depth: NDArray[np.uint16 | np.float32], mask: NDArray[np.bool_] | None
) -> NDArray[np.uint16 | np.float32]:
    """Return a copy of a depth image in which pixels outside the mask have no measurement."""
    return depth if mask is None else np.where(mask, depth, depth.dtype.type(0))
