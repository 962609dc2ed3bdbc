"""Cameras: the intrinsics of a sensor, and how a depth and a colour camera stand to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A pinhole camera that looks along +z, x to the right and y down; pixel centres are integers.

    Attributes
    ----------
    width, height : int, pixels
        1 to 16384.
    fx, fy : float, pixels
        Focal lengths. ``fy`` is negative where the image's y axis points up.
    cx, cy : float, pixels
        Principal point.
    distortion : five floats
        Brown's model: k1, k2, p1, p2, k3 (OpenCV's order).
    rays : (height, width, 2) float32, optional
        x/z and y/z of each pixel, as calibrations of the Kinect V2 come; NaN = a pixel that sees
        nothing. It replaces the model above when a depth image is lifted to points.
    mirrored : bool
        The image is flipped left to right; points are those of the camera that is not.

    Raises
    ------
    InputError
        A number is out of range, or ``rays`` has another shape.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    rays: NDArray[np.float32] | None = field(default=None, repr=False)
    mirrored: bool = False

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer):
                raise InputError(f"intrinsics.{name}: expected a whole number, got {value!r}")
            object.__setattr__(self, name, int(value))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, _number(getattr(self, name), f"intrinsics.{name}"))
        coefficients = tuple(_number(k, "intrinsics.distortion") for k in self.distortion)
        if len(coefficients) != 5:
            raise InputError(
                "intrinsics.distortion: expected five numbers (k1, k2, p1, p2, k3), "
                f"got {len(coefficients)}"
            )
        object.__setattr__(self, "distortion", coefficients)
        object.__setattr__(self, "mirrored", bool(self.mirrored))
        if self.rays is not None:
            rays = np.ascontiguousarray(self.rays, dtype=np.float32)
            if rays.shape != (self.height, self.width, 2):
                raise InputError(
                    f"intrinsics.rays: expected shape ({self.height}, {self.width}, 2), "
                    f"got {rays.shape}"
                )
            object.__setattr__(self, "rays", rays)
        _core.check_intrinsics(self)

    def resized(self, width: int, height: int) -> Intrinsics:
        """The camera of the image resized to ``width`` x ``height`` pixels.

        Pixel centres are integers, so the principal point moves by half pixels.

        Raises
        ------
        InputError
            The camera has a ray table, or a size is not positive.
        """
        if self.rays is not None:
            raise InputError("resized: a ray table cannot be resized")
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the pixels of a depth camera lie in a colour image.

    Attributes
    ----------
    colour : Intrinsics
        Of the colour camera; without a ray table.
    rotation : (3, 3) float64
        Takes points of the depth camera to the colour camera.
    translation : (3,) float64, metres

    Raises
    ------
    InputError
        ``rotation`` is no rotation, or a number is not finite.
    """

    colour: Intrinsics
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    translation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        if not isinstance(self.colour, Intrinsics):
            raise InputError(f"registration.colour: expected Intrinsics, got {self.colour!r}")
        rotation = rows(self.rotation, 3, np.float64, "registration.rotation")
        translation = rows(
            np.asarray(self.translation)[None], 3, np.float64, "registration.translation"
        )[0]
        if rotation.shape != (3, 3):
            raise InputError(f"registration.rotation: expected shape (3, 3), got {rotation.shape}")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)
        _core.check_registration(self)


def _number(value: float, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected a number, got {value!r}") from error
