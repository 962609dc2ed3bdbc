"""RGB-D frames: depth image, colour image and skeletons of a camera at one moment."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array, masked_elements, rows
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.camera import Intrinsics, Registration
from manip3d.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "INFERRED",
    "JOINTS",
    "MIRRORED_JOINTS",
    "NOT_TRACKED",
    "NO_BODY",
    "PARENTS",
    "TRACKED",
    "RgbdCalibration",
    "RgbdFrame",
    "Skeleton",
]

JOINTS: tuple[str, ...] = tuple(_core.joint_names())
"""Names of the Kinect V2's 25 joints by number; left and right are the person's own."""

PARENTS: tuple[int, ...] = tuple(_core.joint_parents())
"""Parent of each joint. Bone j runs from ``PARENTS[j]`` to j; there is no bone 0."""

MIRRORED_JOINTS: tuple[int, ...] = tuple(_core.mirrored_joints())
"""Joint on the other side of the body for each joint; a joint on the midline maps to itself."""

NOT_TRACKED, INFERRED, TRACKED = 0, 1, 2
"""Values of `Skeleton.states`."""

NO_BODY = 255
"""Value of `RgbdFrame.body_index` at pixels that show no person."""


NO_MEASUREMENT = 65535
"""Value of files of depth images at pixels without a measurement, beside 0: many cameras and data
sets store the largest number of 16 bits. Sources of such files set these pixels to 0."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """One person's pose: the Kinect V2's 25 joints in the frame of the camera that sees it.

    Attributes
    ----------
    positions : (25, 3) float32
        Positions in metres; x right, y down, z forward. Meaningless if the state is `NOT_TRACKED`.
    orientations : (25, 4) float32
        Unit quaternions w, x, y, z that rotate from the frame of the bone that ends at the joint to
        the camera frame; 0 if not known.
    states : (25,) uint8
        `NOT_TRACKED`, `INFERRED` or `TRACKED`.
    id : int
        Number of the person, constant while the sensor tracks the person without interruption.
    body : int
        Value of the person's pixels in `RgbdFrame.body_index`; `NO_BODY`: not known.

    Raises
    ------
    InputError
        An array has another shape, or a state or ``body`` is out of range.
    """

    positions: NDArray[np.float32]
    orientations: NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((25, 4), np.float32), repr=False
    )
    states: NDArray[np.uint8] = field(
        default_factory=lambda: np.full(25, TRACKED, np.uint8), repr=False
    )
    id: int = 0
    body: int = NO_BODY

    __repr__ = short_repr

    if TYPE_CHECKING:  # arrays of other dtypes and lists are converted

        def __init__(
            self,
            positions: ArrayLike,
            orientations: ArrayLike = ...,
            states: ArrayLike = ...,
            id: int = ...,
            body: int = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        columns = {"positions": 3, "orientations": 4, "states": None}
        for name, width in columns.items():
            array = rows(
                getattr(self, name),
                width,
                np.uint8 if width is None else np.float32,
                f"skeleton.{name}",
            )
            if len(array) != len(JOINTS):
                expected = (len(JOINTS),) if width is None else (len(JOINTS), width)
                raise InputError(f"skeleton.{name}: expected shape {expected}, got {array.shape}")
            object.__setattr__(self, name, array)
        if self.states.max() > TRACKED:
            raise InputError(f"skeleton.states: expected 0, 1 or 2, got {self.states.max()}")
        for name in ("id", "body"):
            object.__setattr__(self, name, _int64(f"skeleton.{name}", getattr(self, name)))
        if not 0 <= self.body <= NO_BODY:
            raise InputError(f"skeleton.body: expected 0 to 255, got {self.body}")


@dataclass(frozen=True)
class RgbdCalibration:
    """Calibration of a depth and a colour camera, shared by all frames; no camera is mirrored.

    Attributes
    ----------
    depth : Intrinsics
        Intrinsics of the depth camera.
    registration : Registration, optional
        Registration of the colour camera; default: the colour image has the depth image's pixels.

    Raises
    ------
    InputError
        ``depth`` or ``registration`` has another type, or a camera is mirrored.
    """

    depth: Intrinsics
    registration: Registration | None = None

    def __post_init__(self) -> None:
        for name, value, kind in (
            ("depth", self.depth, Intrinsics),
            ("registration", self.registration, Registration | None),
        ):
            if not isinstance(value, kind):
                raise InputError(
                    f"calibration.{name}: expected {getattr(kind, '__name__', kind)}, got {value!r}"
                )
        for name, camera in (
            ("depth", self.depth),
            ("registration.color", self.registration.color if self.registration else None),
        ):
            if camera is not None and camera.mirrored:
                raise InputError(f"calibration.{name}: expected a camera that is not mirrored")


@dataclass(frozen=True, eq=False, repr=False)
class RgbdFrame(Showable):
    """Images and skeletons of an RGB-D camera at one moment.

    Attributes
    ----------
    depth : (H, W) uint16
        Depth in millimetres along the optical axis; 0: no measurement. Either byte order is taken.
    calibration : RgbdCalibration
        Calibration of the cameras.
    color : (H', W', 3) uint8, optional
        Colour image: red, green, blue.
    body_index : (H, W) uint8, optional
        Number of the person at each pixel, or `NO_BODY`.
    skeletons : tuple of Skeleton
        Skeletons of the people that the sensor tracks.
    time_ns : int
        Time of the depth image, nanoseconds by the sensor's clock.
    number : int
        Number of the frame, counted by the sensor, so that gaps show lost frames.
    grabbed_ns : int
        Time at which this computer received the frame from a camera, or from a recording played in
        real time, nanoseconds since 1970 (`time.time_ns`); 0: not known. It is not recorded.

    Raises
    ------
    InputError
        Sizes of images do not agree with each other or with the calibration; a time or number is
        no 64-bit integer.
    """

    depth: NDArray[np.uint16]
    calibration: RgbdCalibration
    color: NDArray[np.uint8] | None = None
    body_index: NDArray[np.uint8] | None = None
    skeletons: tuple[Skeleton, ...] = ()
    time_ns: int = 0
    number: int = 0
    grabbed_ns: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.calibration, RgbdCalibration):
            made = isinstance(self.calibration, Intrinsics)
            raise InputError(
                f"frame.calibration: expected RgbdCalibration, got {self.calibration!r}"
                + ("; make one of it: RgbdCalibration(camera)" if made else "")
            )
        if isinstance(self.depth, np.ndarray) and not self.depth.dtype.isnative:
            object.__setattr__(self, "depth", as_array(self.depth, "frame.depth"))
        camera = self.calibration.depth
        _check_image("depth", self.depth, np.uint16, (camera.height, camera.width))
        if self.body_index is not None:
            _check_image("body_index", self.body_index, np.uint8, self.depth.shape)
        if self.color is not None:
            registration = self.calibration.registration
            color = registration.color if registration else camera
            _check_image("color", self.color, np.uint8, (color.height, color.width, 3))
        if not isinstance(self.skeletons, Iterable) or not all(
            isinstance(skeleton, Skeleton) for skeleton in self.skeletons
        ):
            raise InputError(f"frame.skeletons: expected a tuple of them, got {self.skeletons!r}")
        object.__setattr__(self, "skeletons", tuple(self.skeletons))
        for name in ("time_ns", "number", "grabbed_ns"):
            object.__setattr__(self, name, _int64(f"frame.{name}", getattr(self, name)))

    def __repr__(self) -> str:
        height, width = self.depth.shape
        parts = [f"{width} x {height} pixels of depth"]
        if self.color is not None:
            parts.append(f"{self.color.shape[1]} x {self.color.shape[0]} of colour")
        if self.body_index is not None:
            parts.append("people's pixels")
        if self.skeletons:
            parts.append(counted(len(self.skeletons), "skeleton"))
        parts.append(f"number {self.number}, t = {self.time_ns / 1e9:.3f} s")
        return f"<manip3d.RgbdFrame: {'; '.join(parts)}>"


def _int64(name: str, value: object) -> int:
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = 2**63
    if not -(2**63) <= number < 2**63:
        raise InputError(f"{name}: expected a whole number of 64 bits, got {value!r}")
    return number


def _check_image(name: str, image: object, dtype: type, shape: tuple[int, ...]) -> None:
    if masked := masked_elements(image):
        raise InputError(f"frame.{name}: expected an array without masked elements, got {masked}")
    if not isinstance(image, np.ndarray) or image.dtype != dtype or image.shape != shape:
        got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else repr(image)
        raise InputError(f"frame.{name}: expected {np.dtype(dtype)} {shape}, got {got}")


def check_frames(name: str, frames: object) -> None:
    """Refuse a container whose items are not all frames; iterators and sources are not checked."""
    if isinstance(frames, np.ndarray):
        raise InputError(f"{name}: expected RGB-D frames, got an array of shape {frames.shape}")
    if isinstance(frames, list | tuple | set | frozenset | dict):
        for frame in frames:
            if not isinstance(frame, RgbdFrame):
                raise InputError(f"{name}: expected RGB-D frames, got {type(frame).__name__}")


def numbered(frames: Sequence[RgbdFrame], places: Sequence[int]) -> list[RgbdFrame]:
    """Return the frames; if all have the same number, it is replaced by the frame's place."""
    if len(frames) < 2 or any(frame.number != frames[0].number for frame in frames):
        return list(frames)
    return [replace(frame, number=place) for frame, place in zip(frames, places, strict=False)]
