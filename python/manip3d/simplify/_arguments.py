"""Checks of arguments that the functions of depth images share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.arrays import as_array
from manip3d.camera import Registration
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def checked_color(
    color: ArrayLike | None, shape: tuple[int, ...], registration: Registration | None = None
) -> NDArray[np.uint8] | None:
    """Return a colour image of the depth image's ``shape`` or of the registered colour camera's.

    The image is copied, because results keep it while a camera overwrites its buffer.
    """
    if registration is not None:
        if not isinstance(registration, Registration):
            raise InputError(f"registration: expected Registration, got {registration!r}")
        shape = (registration.color.height, registration.color.width)
    if color is None:
        return None
    image = as_array(color, "color")
    if image.dtype != np.uint8 or image.shape not in ((*shape, 3), (*shape, 4)):
        raise InputError(
            f"color: expected uint8 of shape ({shape[0]}, {shape[1]}, 3 or 4), "
            f"got {image.dtype} of {image.shape}"
            + ("; images of another camera need its registration" * (registration is None))
        )
    return np.array(image)


def limit_of(value: float | None) -> float:
    """Return the limit, or infinity if it is None."""
    return math.inf if value is None else float(value)


def count_of(value: int, name: str) -> int:
    """Return a count as an int; refuse bool and fractions."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise InputError(f"{name}: expected a whole number >= 0, got {value!r}")
    return int(value)
