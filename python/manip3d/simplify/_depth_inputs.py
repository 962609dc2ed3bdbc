"""Reading of a depth image, the images beside it, and its camera."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.paths import path_of
from manip3d.camera import (
    CAMERA_PRESETS,
    CAMERA_SUFFIXES,
    Registration,
    camera_depth_unit,
    read_intrinsics,
)
from manip3d.errors import InputError
from manip3d.io import DEPTH_UNITS, DepthReading, read_depth_guessing
from manip3d.io._depth_files import read_levels, read_mask
from manip3d.io._depth_units import fits_8_bits
from manip3d.io._images import read_color
from manip3d.io._orientations import SAME_SHAPE
from manip3d.simplify._depth_options import DepthOptions, check_confidence
from manip3d.simplify._depth_words import COMMON_GUESS
from manip3d.simplify._pixel_maps import shares_of_levels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics


@dataclass(frozen=True, eq=False)
class Maps:
    """Colours, mask and confidences that belong to a depth image."""

    color: NDArray[np.uint8] | None
    mask: NDArray[np.bool_] | None = None
    confidence: NDArray[Any] | None = None
    registration: Registration | None = None  # None: the colour image has the depth image's pixels


def registration_of(color: NDArray[np.uint8] | None, camera: Intrinsics) -> Registration | None:
    """Return the registration of a colour image that shows the depth image's view in other pixels.

    Phones store a view's depths in fewer pixels than its colours. None if the image has the depth
    image's size or another shape, or the camera has a ray table.
    """
    if color is None or camera.rays is not None:
        return None
    height, width = color.shape[:2]
    if (width, height) == (camera.width, camera.height):
        return None
    if abs(width / camera.width * camera.height / height - 1.0) > SAME_SHAPE:
        return None
    return Registration(camera.resized(width, height))


def same_view_words(registration: Registration) -> str:
    """Return words on a registration of `registration_of`, for people to check."""
    size = registration.color
    return f"colours of {size.width} x {size.height} pixels taken for those of the same view"


@dataclass(frozen=True)
class MapFiles:
    """Files with the colours, mask and confidences of a depth image."""

    color: Path | None
    mask: Path | None
    confidence: Path | None
    confidence_max: int | None

    @staticmethod
    def of(
        options: DepthOptions,
        color: str | os.PathLike[str] | None,
        mask: str | os.PathLike[str] | None,
        confidence: str | os.PathLike[str] | None,
        confidence_max: int | None,
    ) -> MapFiles:
        """Check which files are given for the options."""
        check_confidence(options, confidence is not None)
        if confidence_max is not None and confidence is None:
            raise InputError("confidence_max: can only be given with confidence")
        if confidence_max is not None and confidence_max < 1:
            raise InputError(f"confidence_max: expected at least 1, got {confidence_max}")
        return MapFiles(
            None if color is None else path_of(color, "color"),
            None if mask is None else path_of(mask, "mask"),
            None if confidence is None else path_of(confidence, "confidence"),
            confidence_max,
        )

    def read(self, shape: tuple[int, ...]) -> Maps:
        """Read the files; ``shape`` is that of the depth image."""
        highest = self.confidence_max
        return Maps(
            None if self.color is None else read_color(self.color, shape),
            None if self.mask is None else read_mask(self.mask, shape=shape),
            None if self.confidence is None else _confidence(self.confidence, shape, highest),
        )


def _confidence(path: Path, shape: tuple[int, ...], highest: int | None) -> NDArray[Any]:
    """Read confidences: floats from 0 to 1, or levels up to ``highest`` of any number type."""
    found, stated = read_levels(path, shape=shape)
    if highest is None and found.dtype.kind == "f" and not (found > 1).any():
        return found
    highest = stated if highest is None else highest
    if highest is None:
        raise InputError(
            f"confidence_max: expected the highest level, as the file has {found.dtype} up to "
            f"{np.nanmax(found):g}, got none"
        )
    return shares_of_levels(found, highest, "confidence")


_CAMERAS_BESIDE = (
    "calib.txt", "camera-intrinsics.txt", "intrinsic_depth.txt", "intrinsics.txt", "cameras.txt",
    "camera_matrix.csv", "camera.xml", "camera.yaml", "camera.yml", "camera_info.yaml",
    "camera.json", "intrinsics.json",
)  # fmt: skip


def expect_camera(intrinsics: str, image: Path) -> None:
    if intrinsics:
        return
    folders = (image.parent, image.absolute().parent.parent)
    near = (folder / name for folder in folders for name in _CAMERAS_BESIDE)
    beside = [str(path) for path in near if path.is_file()]
    raise InputError(
        f"intrinsics: expected the camera of the depth image: fx,fy,cx,cy, a file "
        f"({', '.join(CAMERA_SUFFIXES)}) or one of {', '.join(CAMERA_PRESETS)}, got none"
        + (f"; {beside[0]} may be it" if beside else "")
    )


def centre_doubt(camera: Intrinsics) -> str:
    """Return a reason to doubt that a camera is that of its image; empty if there is none.

    The principal point lies in the image, unless that was cropped. On its border it is that of an
    image of twice the size.
    """
    if camera.rays is not None:
        return ""
    inside = (-0.5 < camera.cx < camera.width - 0.5, -0.5 < camera.cy < camera.height - 0.5)
    if all(inside):
        return ""
    return (
        f"the camera's centre ({camera.cx:g}, {camera.cy:g}) lies outside of the image of "
        f"{camera.width} x {camera.height} pixels: it may be the camera of another image"
    )


def planar_depth(
    distances: NDArray[np.uint16 | np.float32], camera: Intrinsics
) -> NDArray[np.float32]:
    """Return depths along the optical axis, in metres, from distances along the lines of sight.

    A line of sight (x/z, y/z, 1) has the length of the distance at the depth 1. Where the camera
    has none, the distance stays, so that the pixel still counts as measured.
    """
    metres = distances / 1000.0 if distances.dtype == np.uint16 else distances.astype(np.float64)
    sight = camera.unproject(np.ones(distances.shape, np.float32)).astype(np.float64)
    lengths = np.sqrt(np.square(sight).sum(axis=2))
    return (metres / np.where(np.isfinite(lengths), lengths, 1.0)).astype(np.float32)


def read_frame(path: Path, options: DepthOptions) -> tuple[DepthReading, Intrinsics, str, str]:
    """Read a depth image and its camera, with words on the unit and a reason to doubt it, or none.

    The unit that the camera states, if any, overrides the guess.
    """
    reading = read_depth_guessing(path, unit=unit_to_read(options.unit, options.intrinsics))
    height, width = reading.depth.shape
    camera = read_intrinsics(options.intrinsics, width=width, height=height)
    reading, words, doubt = _in_unit_of_camera(reading, path, camera, options)
    if options.ray_depth:
        words += "; converted from distances along the lines of sight"
    return reading, camera, words, doubt


def _in_unit_of_camera(
    stored: DepthReading, path: Path, camera: Intrinsics, options: DepthOptions
) -> tuple[DepthReading, str, str]:
    reading = _planar(stored, camera, options)
    if options.unit.startswith(COMMON_GUESS):
        reading = replace(reading, guessed=True, reason="most of the images look like it")
        return reading, reading.sentence, reading.doubt
    unit = camera_depth_unit(options.intrinsics) if options.unit == "guess" else "guess"
    of_stereo = unit.startswith("disparity:")
    if unit == "guess" or (reading.unit == "m" and not of_stereo):
        return reading, reading.sentence, reading.doubt
    known = reading
    if not of_stereo:
        known = _planar(read_depth_guessing(path, unit=unit), camera, options)
    words = f"{known.sentence}, as intrinsics {options.intrinsics} has it"
    doubt = known.doubt
    # A guess never finds an unusual unit, so that it is no reason to doubt one.
    is_unusual = known.unit not in DEPTH_UNITS and reading.unit in ("mm", "tum")
    if known.unit != reading.unit and not of_stereo and not is_unusual:
        doubt = f"the numbers look like {reading.unit}: {reading.reason}"
        words += f"; but {doubt}"
    return known, words, doubt


def _planar(reading: DepthReading, camera: Intrinsics, options: DepthOptions) -> DepthReading:
    if not options.ray_depth:
        return reading
    return replace(reading, depth=planar_depth(reading.depth, camera))


def may_have_8_bits(unit: str, intrinsics: str) -> bool:
    """Return whether a depth image of 8 bits can be read with these options of `DepthOptions`."""
    return fits_8_bits(unit_to_read(unit, intrinsics))


def unit_to_read(unit: str, intrinsics: str) -> str:
    """Return the unit with which to read an image first: the camera's if that has disparities.

    They cannot be told from the numbers, and an image of 8 bits is read in no other unit.
    """
    if unit != "guess":
        return unit.removeprefix(COMMON_GUESS)
    of_camera = camera_depth_unit(intrinsics)
    return of_camera if of_camera.startswith("disparity:") else unit
