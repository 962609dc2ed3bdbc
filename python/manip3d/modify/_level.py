"""Rotation from the axes of a tilted camera to level ones, whose y axis is the vertical."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import product, quaternions
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.rgbd import Skeleton

    Floats = NDArray[np.float64]

_SHORTEST = 1e-6  # of a vertical, and of the horizontal part of the optical axis

LEAST_DEG = 1.0
"""Degrees by which a measured vertical must differ from the one in use to replace it. A smaller
difference moves a key half a metre from a foot by less than a centimetre. The vertical of a
simulated floor is measured to 0.1 degrees, so that nothing is rotated for a level camera."""
_LEAST_CHORD = 2.0 * math.sin(math.radians(LEAST_DEG) / 2.0)  # distance of two such unit vectors


def differ(one: Floats, other: Floats) -> bool:
    """Return whether two verticals, as unit vectors, differ by `LEAST_DEG` or more."""
    return math.dist(one, other) >= _LEAST_CHORD


def level_rotation(down: ArrayLike) -> Floats:
    """Return the rotation from the camera's axes to level ones, (3, 3).

    Its rows are the level axes: x horizontal, to the right; y the vertical; z the horizontal part
    of the optical axis.

    Raises
    ------
    InputError
        ``down`` is not three finite numbers, is 0, or is parallel to the optical axis.
    """
    way = np.asarray(down, np.float64)
    length = float(np.sqrt((way * way).sum())) if way.shape == (3,) else 0.0
    if not _SHORTEST < length < np.inf:
        raise InputError(f"down: expected three finite numbers that are not all 0, got {down!r}")
    x, y, z = way / length
    level = float(np.sqrt(x * x + y * y))  # length of the horizontal part of the optical axis
    if not level > _SHORTEST:
        raise InputError(f"down: expected another direction than the optical axis, got {down!r}")
    return np.array(
        [[y / level, -x / level, 0.0], [x, y, z], [-x * z / level, -y * z / level, level]]
    )


def turned_skeleton(skeleton: Skeleton, rotation: Floats) -> Skeleton:
    """Return a skeleton in axes that a rotation leads to; unknown orientations stay 0."""
    w, x, y, z = quaternions(rotation[None])[0]
    times = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return replace(
        skeleton,
        positions=product(skeleton.positions, rotation.T).astype(np.float32),
        orientations=product(skeleton.orientations, times.T).astype(np.float32),
    )
