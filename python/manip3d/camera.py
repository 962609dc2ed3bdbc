"""Cameras: intrinsics, registration of a colour to a depth camera, and readers of calibrations."""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from manip3d import _core
from manip3d._util.arrays import CONVERSION_ERRORS, as_array, one_line, rows, vector
from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.regular_files import open_regular
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A pinhole camera that looks along +z, x to the right and y down; pixel centres are integers.

    Attributes
    ----------
    width, height : int, pixels
        Size of the image, 1 to 16384.
    fx, fy : float, pixels
        Focal lengths. ``fy`` is negative if the image's y axis points up.
    cx, cy : float, pixels
        Principal point.
    distortion : five floats
        Coefficients of Brown's model: k1, k2, p1, p2, k3 (OpenCV's order).
    rays : (height, width, 2) float32, optional
        Ray table: x/z and y/z of each pixel, as in calibrations of the Kinect V2; NaN = a pixel
        without a line of sight. It replaces the model above when a depth image is lifted to points.
    mirrored : bool
        Whether the image is flipped left to right. Points are those of the camera before the flip.

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
            if not -(2**31) <= value < 2**31:  # _core takes int32 and checks the exact range
                raise InputError(f"intrinsics.{name}: expected 1 to 16384, got {value}")
            object.__setattr__(self, name, int(value))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, _number(getattr(self, name), f"intrinsics.{name}"))
        if isinstance(self.distortion, str) or not isinstance(self.distortion, Iterable):
            raise InputError(
                f"intrinsics.distortion: expected five numbers, got {self.distortion!r}"
            )
        coefficients = tuple(_number(k, "intrinsics.distortion") for k in self.distortion)
        if len(coefficients) != 5:
            raise InputError(
                "intrinsics.distortion: expected five numbers (k1, k2, p1, p2, k3), "
                f"got {len(coefficients)}"
            )
        object.__setattr__(self, "distortion", coefficients)
        if not isinstance(self.mirrored, bool | np.bool_):
            raise InputError(f"intrinsics.mirrored: expected True or False, got {self.mirrored!r}")
        object.__setattr__(self, "mirrored", bool(self.mirrored))
        if self.rays is not None:
            rays = as_array(self.rays, "intrinsics.rays")
            if rays.dtype.kind not in "iuf":
                raise InputError(f"intrinsics.rays: expected numbers, got dtype {rays.dtype}")
            if rays.shape != (self.height, self.width, 2):
                raise InputError(
                    f"intrinsics.rays: expected shape ({self.height}, {self.width}, 2), "
                    f"got {rays.shape}"
                )
            object.__setattr__(self, "rays", np.ascontiguousarray(rays, np.float32))
        _core.check_intrinsics(self)

    def __eq__(self, other: object) -> bool:
        """Return whether all values, including the ray tables, are equal."""
        return same_camera(self, other) if isinstance(other, Intrinsics) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.distortion))

    @overload
    def unproject(
        self, depth: ArrayLike, pixels: None = None, *, threads: int = 0
    ) -> NDArray[np.float32]: ...
    @overload
    def unproject(
        self, depth: ArrayLike, pixels: ArrayLike, *, threads: int = 0
    ) -> NDArray[np.float64]: ...
    def unproject(
        self, depth: ArrayLike, pixels: ArrayLike | None = None, *, threads: int = 0
    ) -> NDArray[np.float32] | NDArray[np.float64]:
        """Lift a depth image, or single pixels, to points of the camera frame in metres.

        Parameters
        ----------
        depth : (H, W) uint16 in millimetres or float32 in metres
            Distance along the optical axis. 0 and NaN mean no measurement. With ``pixels``: (...)
            uint16 in millimetres or float in metres; one number per pixel, or one for all.
        pixels : (..., 2) float, optional
            Columns and rows ``(u, v)``, which may be fractions. They may lie outside the image,
            unless the camera has a ray table. A depth of 1 gives the lines of sight.
        threads : int
            Number of threads for an image; 0: all cores. The result does not depend on it.

        Returns
        -------
        (H, W, 3) float32, or (..., 3) float64 with ``pixels``
            Points; NaN without a measurement or a line of sight.

        Raises
        ------
        InputError
            ``depth`` or ``pixels`` has another shape or dtype; a depth is negative or infinite.

        Examples
        --------
        >>> import numpy as np
        >>> import manip3d
        >>> camera = manip3d.Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5)
        >>> camera.unproject(np.full((48, 64), 2.0, np.float32)).shape
        (48, 64, 3)
        >>> camera.unproject(2.0, pixels=(61.5, 23.5))
        array([1., 0., 2.])
        """
        if pixels is None:
            image = checked_depth(depth, self)
            points, _, _ = _core.unproject(image, self, threads_of(threads))
            return np.asarray(points, np.float32).reshape(*image.shape, 3)
        at = _last_axis(pixels, 2, "pixels")
        given = as_array(depth, "depth")
        if given.dtype.kind not in "iuf":
            raise InputError(f"depth: expected numbers, got dtype {given.dtype}")
        z = np.asarray(given, np.float64)
        if given.dtype == np.uint16:
            z = z / 1000.0
        if z.ndim and z.shape != at.shape[:-1]:
            raise InputError(f"depth: expected one number or shape {at.shape[:-1]}, got {z.shape}")
        if (z < 0).any() or np.isinf(z).any():
            raise InputError("depth: expected finite numbers >= 0")
        z = np.where(z > 0, z, np.nan)
        flat = np.ascontiguousarray(np.broadcast_to(z, at.shape[:-1])).reshape(-1)
        points = np.asarray(_core.unproject_pixels(at.reshape(-1, 2), flat, self), np.float64)
        points[np.isnan(points[:, 0])] = np.nan  # without a line of sight, z is NaN, too
        return points.reshape(*at.shape[:-1], 3)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the pixels to which points of the camera frame are projected.

        Parameters
        ----------
        points : (..., 3) float, metres
            Points in the camera frame.

        Returns
        -------
        (..., 2) float64
            Columns and rows ``(u, v)``; pixel centres are integers. They may lie outside the image.
            NaN for points that are not in front of the camera, and for points that no pixel of a
            ray table sees.

        Raises
        ------
        InputError
            ``points`` has another shape or dtype.

        Examples
        --------
        >>> import manip3d
        >>> camera = manip3d.Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5)
        >>> camera.project([1.0, 0.0, 2.0])
        array([61.5, 23.5])
        """
        xyz = _last_axis(points, 3, "points")
        pixels = _core.project(xyz.reshape(-1, 3), self)
        return np.asarray(pixels, np.float64).reshape(*xyz.shape[:-1], 2)

    def resized(self, width: int, height: int) -> Intrinsics:
        """Return the camera of the image resized to ``width`` x ``height`` pixels.

        The image's corner is at (-0.5, -0.5), because pixel centres are integers:
        cx' = (cx + 0.5) width' / width - 0.5.

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


def same_camera(one: Intrinsics, other: Intrinsics) -> bool:
    """Return whether two cameras have equal intrinsics, distortion and ray table."""
    if one is other:
        return True
    names = ("width", "height", "fx", "fy", "cx", "cy", "distortion", "mirrored")
    if any(getattr(one, name) != getattr(other, name) for name in names):
        return False
    if one.rays is None or other.rays is None:
        return one.rays is other.rays
    if one.rays is other.rays:
        return True
    # Pixels without a ray are NaN, which does not equal itself; the same bits do.
    return np.array_equal(one.rays.view(np.uint32), other.rays.view(np.uint32))


@dataclass(frozen=True, eq=False)
class Registration:
    """Pose and intrinsics of a colour camera relative to a depth camera.

    Attributes
    ----------
    color : Intrinsics
        Intrinsics of the colour camera, without a ray table.
    rotation : (3, 3) float64
        Rotation R of the transform from the depth to the colour camera's frame, p' = R p + t.
    translation : (3,) float64, metres
        Translation t of that transform.

    Raises
    ------
    InputError
        ``rotation`` is not a rotation, or a number is not finite.
    """

    color: Intrinsics
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    translation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if not isinstance(self.color, Intrinsics):
            raise InputError(f"registration.color: expected Intrinsics, got {self.color!r}")
        rotation = rows(self.rotation, 3, np.float64, "registration.rotation")
        translation = vector(self.translation, 3, "registration.translation")
        if rotation.shape != (3, 3):
            raise InputError(f"registration.rotation: expected shape (3, 3), got {rotation.shape}")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)
        _core.check_registration(self)

    def __eq__(self, other: object) -> bool:
        """Return whether all values are equal."""
        if not isinstance(other, Registration):
            return NotImplemented
        return (
            self.color == other.color
            and np.array_equal(self.rotation, other.rotation)
            and np.array_equal(self.translation, other.translation)
        )

    def __hash__(self) -> int:
        return hash(self.color)


def checked_depth(depth: ArrayLike, intrinsics: Intrinsics) -> NDArray[np.uint16 | np.float32]:
    """Return a depth image as a C-contiguous array, without a copy if it is one; check its size."""
    if not isinstance(intrinsics, Intrinsics):
        raise InputError(f"intrinsics: expected Intrinsics, got {intrinsics!r}")
    image = as_array(depth, "depth")
    if image.dtype not in (np.uint16, np.float32):
        raise InputError(
            f"depth: expected dtype uint16 (millimetres) or float32 (metres), got {image.dtype}"
        )
    if image.shape != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth: expected shape ({intrinsics.height}, {intrinsics.width}) as the intrinsics "
            f"say, got {image.shape}"
        )
    return np.ascontiguousarray(image)


def _last_axis(values: ArrayLike, size: int, name: str) -> NDArray[np.float64]:
    """Return a C-contiguous float64 array (..., size)."""
    array = as_array(values, name)
    if array.dtype.kind not in "iuf" or array.ndim == 0 or array.shape[-1] != size:
        raise InputError(
            f"{name}: expected numbers of shape (..., {size}), got {array.dtype} of {array.shape}"
        )
    return np.ascontiguousarray(array, np.float64)


def _number(value: float, name: str) -> float:
    try:
        # NumPy's complex numbers would lose their imaginary part.
        if isinstance(value, np.ndarray | np.generic) and np.iscomplexobj(value):
            raise TypeError
        return float(value)
    except CONVERSION_ERRORS as error:
        raise InputError(f"{name}: expected a number, got {one_line(value)}") from error


@dataclass(frozen=True)
class CameraPreset:
    """The nominal depth camera of a sensor, for images without their own calibration.

    Attributes
    ----------
    title : str
        Name of the sensor.
    cameras : tuple of Intrinsics
        Nominal cameras, one for each image size.
    is_resizable : bool
        Whether the sensor delivers the same view at other sizes as well.
    depth_unit : str
        Unit of the sensor's depth images, one of `manip3d.io.DEPTH_UNITS`; ``guess`` if several are
        in use.
    """

    title: str
    cameras: tuple[Intrinsics, ...]
    is_resizable: bool
    depth_unit: str

    def fitting(self, width: int, height: int) -> Intrinsics | None:
        """Return the camera for an image of this size; None if the sensor has no such size."""
        for camera in self.cameras:
            if (camera.width, camera.height) == (width, height):
                return camera
        for camera in self.cameras if self.is_resizable else ():
            if width * camera.height == height * camera.width:
                return camera.resized(width, height)
        return None

    @property
    def sizes(self) -> str:
        """Sizes of the sensor's images in words: ``640 x 480``."""
        return " or ".join(f"{camera.width} x {camera.height}" for camera in self.cameras)


def _vga(fx: float, fy: float, cx: float = 319.5, cy: float = 239.5) -> tuple[Intrinsics, ...]:
    return (Intrinsics(640, 480, fx, fy, cx, cy),)


def _centred(*sizes: tuple[int, int, float]) -> tuple[Intrinsics, ...]:
    return tuple(Intrinsics(w, h, f, f, (w - 1) / 2, (h - 1) / 2) for w, h, f in sizes)


CAMERA_PRESETS: Mapping[str, CameraPreset] = {
    "tum": CameraPreset("TUM RGB-D, nominal", _vga(525.0, 525.0), True, "tum"),
    "tum-fr1": CameraPreset(
        "TUM RGB-D, freiburg1", _vga(517.3, 516.5, 318.6, 255.3), False, "tum"
    ),
    "tum-fr2": CameraPreset(
        "TUM RGB-D, freiburg2", _vga(520.9, 521.0, 325.1, 249.7), False, "tum"
    ),
    "tum-fr3": CameraPreset(
        "TUM RGB-D, freiburg3", _vga(535.4, 539.2, 320.1, 247.6), False, "tum"
    ),
    "kinect-v1": CameraPreset("Kinect V1, its infrared camera", _vga(585.0, 585.0), True, "guess"),
    "kinect-v2": CameraPreset("Kinect V2", _centred((512, 424, 365.0)), False, "mm"),
    "azure": CameraPreset(
        "Azure Kinect",
        _centred((640, 576, 504.0), (320, 288, 252.0), (1024, 1024, 504.0), (512, 512, 252.0)),
        False,
        "mm",
    ),
    "realsense": CameraPreset(
        "RealSense D435, depth",
        _centred(
            (640, 480, 386.0), (848, 480, 425.0), (1280, 720, 640.0), (640, 360, 320.0),
            (424, 240, 212.0),
        ),
        False,
        "mm",
    ),
    "primesense": CameraPreset("PrimeSense, Xtion", _vga(525.0, 525.0), True, "guess"),
}  # fmt: skip
"""Nominal depth cameras by name; cameras of the same type differ by a few pixels."""

_MAX_CAMERA_BYTES = 1 << 20  # largest size of a calibration file; real ones have a few kB
CAMERA_SUFFIXES = (".csv", ".json", ".txt", ".xml", ".yaml", ".yml")
"""Suffixes of the files that `read_intrinsics` reads."""


@checked
def read_intrinsics(camera: str | os.PathLike[str], *, width: int, height: int) -> Intrinsics:
    """Return a depth camera from numbers, a preset's name or a calibration file.

    Parameters
    ----------
    camera : str or path-like
        One of

        - ``fx,fy,cx,cy`` in pixels, or a name of `CAMERA_PRESETS`;
        - an ``.xml``, ``.yaml``, ``.yml`` or ``.json`` file: a calibration in OpenCV's FileStorage,
          a CameraInfo of ROS, a camera of Open3D, Record3D, or Replica and NICE-SLAM (``.json``),
          or an object with the fields of `Intrinsics` under the names of manip3d, nerfstudio or
          librealsense (other fields are ignored with a warning; ``coeffs`` other than 0 must be of
          the model ``brown_conrady``). If OpenCV's calibration is that of a stereo pair, the
          left camera is read (P1 of the rectified images, or else M1 and D1);
        - a ``.txt`` file: a matrix of 3 x 3, 3 x 4 or 4 x 4 numbers (7-Scenes, 3DMatch, ScanNet),
          the four numbers above, COLMAP's ``cameras.txt``, or the ``calib.txt`` of a stereo pair of
          Middlebury or ETH3D, of which the left camera is read;
        - a ``.csv`` file: a matrix, as Stray Scanner's ``camera_matrix.csv``. It is that of the
          colour images (1920 x 1440 pixels), and refused for smaller ones of the same view with
          what it is for these.
    width, height : int, pixels
        Size of the image.

    Returns
    -------
    Intrinsics
        Camera for an image of this size.

    Raises
    ------
    InputError
        ``camera`` is none of these, or is for another image size.
    FormatError, OSError
        The file cannot be read, or describes a lens that `Intrinsics` cannot, such as a fisheye.
    MissingExtraError
        The file is YAML, and PyYAML is not installed: ``pip install 'manip3d[io]'``.

    Warns
    -----
    UserWarning
        A CameraInfo has distortion, and another camera for rectified images; the image is treated
        as not rectified. Or the calibration is that of a stereo pair; the warning states which
        camera was read.

    Examples
    --------
    >>> from manip3d.camera import read_intrinsics
    >>> read_intrinsics("525,525,319.5,239.5", width=640, height=480).fx
    525.0
    >>> read_intrinsics("kinect-v2", width=512, height=424).fx
    365.0
    """
    text = os.fspath(camera)
    if text.lower().endswith(CAMERA_SUFFIXES):
        return _camera_of_file(Path(text), width, height)
    preset = CAMERA_PRESETS.get(text)
    if preset is not None:
        found = preset.fitting(width, height)
        if found is None:
            raise InputError(
                f"intrinsics: {text} is for {preset.sizes} pixels, the image has {width} x {height}"
            )
        return found
    try:
        fx, fy, cx, cy = (float(field) for field in text.split(","))
    except ValueError:
        raise InputError(
            f"intrinsics: expected fx,fy,cx,cy, a file ({', '.join(CAMERA_SUFFIXES)}) or one of "
            f"{', '.join(CAMERA_PRESETS)}, got {text!r}"
        ) from None
    return Intrinsics(width, height, fx, fy, cx, cy)


@checked
def camera_depth_unit(camera: str | os.PathLike[str]) -> str:
    """Return the unit of a camera's depth images.

    Parameters
    ----------
    camera : str or path-like
        A camera that `read_intrinsics` accepts.

    Returns
    -------
    str
        A unit of `manip3d.io.read_depth_guessing`: that of a preset; ``disparity:FB,DOFFS`` for the
        ``calib.txt`` of a stereo pair, whose images are disparities; by the ``depth_scale`` of a
        ``.json`` file, see Notes; ``guess`` if it is not known.

    Raises
    ------
    FormatError, OSError
        The file cannot be read.

    Notes
    -----
    Programs mean different things by ``depth_scale``, which their usual numbers tell apart: up to
    0.01 it is metres per unit (librealsense), from 0.02 to 10 millimetres per unit (BOP's
    ``camera.json``), and from 100 on units per metre (Open3D). Other numbers are not read. The
    ``scale`` in the ``cam_params.json`` of Replica and NICE-SLAM is read alike.

    Examples
    --------
    >>> from manip3d.camera import camera_depth_unit
    >>> camera_depth_unit("tum"), camera_depth_unit("525,525,319.5,239.5")
    ('tum', 'guess')
    """
    text = os.fspath(camera)
    preset = CAMERA_PRESETS.get(text)
    if preset is not None:
        return preset.depth_unit
    if text.lower().endswith(".json"):
        return _unit_of_json(_text_of_camera(Path(text)))
    if not text.lower().endswith(".txt"):
        return "guess"
    stereo = _stereo_calibration(_text_of_camera(Path(text)), Path(text))
    return "guess" if stereo is None else stereo.depth_unit


_DEPTH_SCALE = "depth_scale"


def _unit_of_json(text: str) -> str:
    """Return the unit of depth images that a camera's JSON file states, or ``guess``."""
    try:
        scale = float(_fields_of_json(text)[_DEPTH_SCALE])
    # read_intrinsics tells what is wrong
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError):
        return "guess"
    if 1e-6 <= scale <= 0.01:
        return f"{1.0 / scale:.9g}"
    if 0.02 <= scale <= 10.0:
        return f"{1000.0 / scale:.9g}"
    return f"{scale:.9g}" if 100.0 <= scale <= 1e6 else "guess"


def _fields_of_json(text: str) -> Any:
    """Return what a JSON file holds, or the camera in the ``cam_params.json`` of Replica."""
    fields = json.loads(text)
    inner = fields.get("camera") if isinstance(fields, dict) and "fx" not in fields else None
    if isinstance(inner, dict) and "fx" in inner:
        return {_DEPTH_SCALE if name == "scale" else name: inner[name] for name in inner}
    return fields


@dataclass(frozen=True)
class _StereoCalibration:
    """Calibration of a rectified stereo pair, in the format of Middlebury's pairs of 2014."""

    fields: dict[str, float]
    depth_unit: str


def _text_of_camera(path: Path) -> str:
    with open_regular(path) as file:
        data = file.read(_MAX_CAMERA_BYTES + 1)
    if len(data) > _MAX_CAMERA_BYTES:
        raise FormatError("expected a camera, got more than a mebibyte", file=str(path))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        reason = "expected a camera as text, got other bytes"
        raise FormatError(reason, file=str(path), byte_offset=error.start) from error


def _camera_of_file(path: Path, width: int, height: int) -> Intrinsics:
    try:
        fields = _fields_of_file(path, width, height)
        known = Intrinsics(**({"width": width, "height": height} | fields))
    except (ValueError, TypeError, RecursionError) as error:
        if isinstance(error, FormatError):
            raise
        expected = (
            "fx, fy, cx and cy, a matrix of 3 x 3, 3 x 4 or 4 x 4 numbers, the calib.txt of a "
            "stereo pair or COLMAP's cameras.txt"
            if path.suffix.lower() == ".txt"
            else "a matrix of 3 x 3, 3 x 4 or 4 x 4 numbers"
            if path.suffix.lower() == ".csv"
            else "an object with fx, fy, cx and cy, Open3D's intrinsic_matrix, OpenCV's or ROS's "
            "camera_matrix"
        )
        raise FormatError(f"expected {expected}: {error}", file=str(path)) from error
    if path.suffix.lower() == ".csv":
        _refuse_camera_of_colors(known, path)
    if (known.width, known.height) != (width, height):
        same_view = ""
        if known.rays is None and known.width * height == known.height * width:
            at = known.resized(width, height)
            numbers = ",".join(f"{value:g}" for value in (at.fx, at.fy, at.cx, at.cy))
            same_view = f"; if it shows the same view, its camera is {numbers}"
        raise InputError(
            f"intrinsics: {path} is for {known.width} x {known.height} pixels, "
            f"the image has {width} x {height}{same_view}"
        )
    return known


_STRAY_SCANNER = (1920, 1440)
"""Size of the colour images of Stray Scanner, which states it nowhere."""


def _refuse_camera_of_colors(camera: Intrinsics, path: Path) -> None:
    """Refuse a camera without a size that seems to be that of larger colour images.

    Its centre lies outside of the image, or, if the image may show the same view in fewer pixels,
    nearer to the middle of the colour images.
    """
    (width, height), own = _STRAY_SCANNER, (camera.width, camera.height)
    is_same_shape = camera.width * height == camera.height * width
    is_inside = camera.cx < camera.width and camera.cy < camera.height
    off, off_own = (_off_middle(camera, *size) for size in ((width, height), own))
    is_of_larger = is_same_shape and camera.width < width and off < off_own
    if is_inside and not is_of_larger:
        return
    same_view = ""
    if is_same_shape:
        at = replace(camera, width=width, height=height).resized(*own)
        numbers = ",".join(f"{value:g}" for value in (at.fx, at.fy, at.cx, at.cy))
        same_view = f"; if that has {width} x {height} of the same view, the camera is {numbers}"
    raise InputError(
        f"intrinsics: {path} is the camera of a larger image than {camera.width} x {camera.height} "
        f"pixels{same_view}"
    )


def _off_middle(camera: Intrinsics, width: int, height: int) -> float:
    """Return the distance of a camera's centre from the middle of an image."""
    return math.hypot(camera.cx - (width - 1) / 2, camera.cy - (height - 1) / 2)


def _fields_of_file(path: Path, width: int, height: int) -> dict[str, Any]:
    """Return the fields of `Intrinsics` in a file; if it has several cameras, for this size."""
    suffix = path.suffix.lower()
    if suffix == ".txt":
        text = _text_of_camera(path)
        if (cameras := _COLMAP_CAMERA.findall(text)) != []:
            return _fields_of_colmap(cameras, width, height)
        stereo = _stereo_calibration(text, path)
        return _fields_of_matrix(text) if stereo is None else stereo.fields
    if suffix == ".csv":
        return _fields_of_matrix(_text_of_camera(path))
    if suffix == ".json":
        text = _text_of_camera(path)
        fields = _fields_of_json(text)
        if isinstance(fields, dict) and _unit_of_json(text) != "guess":
            fields.pop(_DEPTH_SCALE)  # `camera_depth_unit` reads it
        return _fields_of_mapping(fields, path)
    from manip3d._util.text_files import parse_xml, parse_yaml

    if suffix == ".xml":
        return _fields_of_mapping(_values_of(parse_xml(path)), path)
    return _fields_of_mapping(parse_yaml(path, extra="io"), path)


def _values_of(element: Element) -> Any:
    """Return an element of OpenCV's XML as a mapping of its children, or as text if it has none."""
    if len(element) == 0:
        return (element.text or "").strip().strip('"')
    return {child.tag: _values_of(child) for child in element}


def _fields_of_mapping(fields: Any, path: Path) -> dict[str, Any]:
    if not isinstance(fields, Mapping):
        raise TypeError("no object")
    inner = fields.get("intrinsic")  # PinholeCameraParameters of Open3D, or a matrix of OpenCV
    if isinstance(inner, Mapping) and "data" not in inner:
        fields = inner
    plain = {str(name).lower().replace("_", ""): value for name, value in fields.items()}
    _refuse_wide_lenses(plain)
    camera = _camera_of_mapping(fields, plain, path)
    if any(camera.get("distortion", ())):
        _expect_brown(plain)
    return camera


def _camera_of_mapping(
    fields: Mapping[Any, Any], plain: Mapping[str, Any], path: Path
) -> dict[str, Any]:
    """Return a camera from its fields; ``plain`` has them in lower case without underscores."""
    matrix = fields.get("intrinsic_matrix")
    if matrix is not None:
        size = {n: _whole(fields[n]) for n in ("width", "height") if n in fields}
        return size | _pinhole_of_matrix(_square_of(_numbers_of(matrix), "an intrinsic_matrix"))
    if _matrix_of(plain) is not None:
        return _fields_of_calibration(plain, path)
    if (left := _left_of_pair(plain, path)) is not None:
        return _fields_of_calibration(left, path)
    return _renamed({str(name): value for name, value in fields.items()})


def _fields_of_calibration(fields: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return a camera from OpenCV's or ROS's fields, in lower case without underscores."""

    def first(*names: str) -> Any:
        return next((fields[name] for name in names if name in fields), None)

    square = _square_of(_numbers_of(_matrix_of(fields)), "a camera_matrix")
    camera: dict[str, Any] = _pinhole_of_matrix(square)
    lens = first("distortioncoefficients", "distcoeffs", "distcoefs", "dist", "d")
    camera["distortion"] = _brown_of(_numbers_of([] if lens is None else lens))
    rectified = first("projectionmatrix", "p")
    if rectified is not None and any(camera["distortion"]):
        _warn_of_rectified(camera, _numbers_of(rectified), path)
    size = first("imagesize")
    if size is not None:
        width, height = _numbers_of(size)
        camera |= {"width": _whole(width), "height": _whole(height)}
    for name in ("width", "height"):
        if (side := first(f"image{name}", name, name[0])) is not None:
            camera[name] = _whole(side)
    return camera


_MODELS = ("cameramodel", "distortionmodel", "model")
"""Fields with the name of a lens's model; the last may also have that of a product."""
_WIDE_FLAGS = ("isfisheye", "fisheye", "fisheyemodel")
_BROWN_MODELS = (
    "", "none", "null", "perspective", "pinhole", "simplepinhole", "plumbbob", "radtan",
    "radialtangential", "brown", "brownconrady", "opencv", "fullopencv", "simpleradial", "radial",
    "rationalpolynomial", "4",
)  # fmt: skip
"""Models of which Brown's is a part, as `_plain_model` spells them; 4 is librealsense's number."""
_OTHER_MODELS = re.compile(r"brownconrady|division|polynom|thinprism|^[12]$")
"""Models that are neither Brown's nor refused without coefficients; 1 and 2 are librealsense's."""
_FISHEYE = re.compile(
    r"fisheye|equidist|ftheta|kannala|omni(dir|$)|scaramuzza|doublesphere|"
    r"^(kb[0-9]?|fov|mei|ds|e?ucm|3|5)$"
)
_PANORAMA = re.compile(r"equirect|^spher(ic|e$)|panoram|cylind|orthophoto|orthographic|^vr180")
_REALSENSE_PREFIX = re.compile(r"^(rs2_distortion_|(rs2_)?distortion\.)", re.IGNORECASE)


def _plain_model(model: Any) -> str:
    """Return the name of a lens's model in lower case, without marks and librealsense's prefix."""
    return re.sub(r"[^a-z0-9]", "", _REALSENSE_PREFIX.sub("", str(model)).lower())


def is_brown(model: object) -> bool:
    """Return whether a lens's model of this name is Brown's, or has Brown's as a part.

    The coefficients of such a model after the fifth are those of its other part.
    """
    return _plain_model(model) in _BROWN_MODELS


def _refuse_wide_lenses(fields: Mapping[str, Any]) -> None:
    """Refuse lenses that are no pinhole camera even if all their coefficients are 0."""
    for name in _WIDE_FLAGS:
        if str(fields.get(name, 0)).strip().lower() not in ("", "0", "0.0", "false", "no", "none"):
            raise ValueError("a fisheye camera")
    for name in _MODELS:
        plain = _plain_model(fields.get(name, ""))
        if _FISHEYE.search(plain):
            raise ValueError(f"a fisheye camera ({str(fields[name])[:40]})")
        if _PANORAMA.search(plain):
            raise ValueError(f"no pinhole camera ({str(fields[name])[:40]})")


def _expect_brown(fields: Mapping[str, Any]) -> None:
    """Refuse the coefficients of a model that is not known, but not those of a product."""
    for name in _MODELS:
        model = fields.get(name, "")
        may_be_product = name == "model" and not _OTHER_MODELS.search(_plain_model(model))
        if not is_brown(model) and not may_be_product:
            raise ValueError(
                f"a distortion of the model {str(fields[name])[:40]!r}; those that can be read are "
                "plumb_bob, rational_polynomial, radtan, brown_conrady and those of COLMAP without "
                "fisheye"
            )


def _matrix_of(fields: Mapping[str, Any]) -> Any:
    """Return the field with a camera's matrix; None: there is none.

    Names that may mean something else count only with a matrix, and without fx beside them.
    """
    for name in ("cameramatrix", "k"):
        if name in fields:
            return fields[name]
    for name in ("intrinsic", "intrinsics", "intrinsicmatrix"):
        value = fields.get(name)
        if "fx" in fields or not isinstance(value, Mapping | list):
            continue
        with suppress(ValueError, TypeError):
            if _numbers_of(value).size in _SIZES_OF_MATRIX:
                return value
    return None


_SIZES_OF_MATRIX = (9, 12, 16)
_SIZES = ("imagesize", "imagewidth", "imageheight", "width", "height", "w", "h")
_LEFT = ("1", "l", "left")
"""Endings of the left camera's fields: M1, cameraMatrixL, camera_matrix_left."""


def _left_of_pair(fields: Mapping[str, Any], path: Path) -> Mapping[str, Any] | None:
    """Return the left camera of a stereo pair under the names of a single camera; None: no pair.

    OpenCV's sample program writes M1 and D1 to a file of intrinsics, and P1 to one of extrinsics;
    other programs write all to one file. P1 has precedence, because it is the camera of the
    rectified left image, to which a pair's depth belongs.
    """

    def left(size: int, *names: str) -> Any:
        """Return a field with ``size`` numbers (0: any), unlike the numbers k1 and p1 of a lens."""
        sided = (name + side for name in names for side in _LEFT)
        found = (fields[name] for name in sided if name in fields)
        return next((value for value in found if size in (0, _numbers_of(value).size)), None)

    matrix, projection = left(9, "m", "k", "cameramatrix"), left(12, "p", "projectionmatrix")
    if matrix is None and projection is None:
        return None
    size = {name: value for name, value in fields.items() if name in _SIZES}
    if projection is not None:
        pinhole = _numbers_of(projection).reshape(3, 4)[:, :3]
        words, camera = "of its rectified left image, P1", {"cameramatrix": pinhole}
    else:
        words = "of its left image with lens distortion, M1 and D1; that of rectified images is P1"
        lens = left(0, "d", "distcoeffs", "distortioncoefficients")
        camera = {"cameramatrix": matrix} | ({} if lens is None else {"d": lens})
    warnings.warn(f"{path}: a stereo pair; the camera is that {words}", stacklevel=caller_level())
    return size | camera


def _whole(value: Any) -> int:
    number = float(value)
    if not number.is_integer():
        raise ValueError(f"a size of {value} pixels")
    return int(number)


def _numbers_of(value: Any) -> NDArray[np.float64]:
    """Return the numbers of a list, of rows, of text, or of a mapping with the key ``data``."""
    if isinstance(value, Mapping):
        value = value.get("data", [])
    if isinstance(value, str):
        value = value.split()
    return np.asarray(value, dtype=np.float64).ravel()


def _brown_of(coefficients: NDArray[np.float64]) -> tuple[float, ...]:
    if np.any(coefficients[5:]):
        raise ValueError("a distortion of more than k1, k2, p1, p2 and k3")
    return tuple(np.pad(coefficients[:5], (0, max(0, 5 - coefficients.size))).tolist())


def _warn_of_rectified(
    camera: Mapping[str, float], projection: NDArray[np.float64], path: Path
) -> None:
    """Warn if the camera of rectified images is another one, and state it."""
    if projection.size != 12:
        return
    other = _pinhole_of_matrix(projection.reshape(3, 4)[:, :3])
    if other["fx"] > 0 and any(other[name] != camera[name] for name in other):
        numbers = ",".join(f"{value:g}" for value in other.values())
        warnings.warn(
            f"{path}: the image is taken as one with lens distortion; the camera of a rectified "
            f"one is {numbers}",
            stacklevel=caller_level(),
        )


_COLMAP_CAMERA = re.compile(
    r"^[ \t]*\d+[ \t]+([A-Z][A-Z_]+)[ \t]+(\d+)[ \t]+(\d+)((?:[ \t]+[^\s#]+)+)[ \t\r]*$",
    re.MULTILINE,
)
_COLMAP_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}


def _fields_of_colmap(
    cameras: Sequence[tuple[str, str, str, str]], width: int, height: int
) -> dict[str, Any]:
    """Return the camera of COLMAP's ``cameras.txt`` with the image's size, or else the first."""
    fitting = {camera for camera in cameras if (int(camera[1]), int(camera[2])) == (width, height)}
    if len(fitting) > 1:
        raise ValueError(f"{len(fitting)} different cameras of {width} x {height} pixels")
    model, camera_width, camera_height, parameters = (fitting or set(cameras[:1])).pop()
    names = _COLMAP_MODELS.get(model)
    values = [float(word) for word in parameters.split()]
    if names is None or len(values) != len(names):
        known = ", ".join(_COLMAP_MODELS)
        raise ValueError(f"{model} with {len(values)} numbers; known models are {known}")
    given = dict(zip(names, values, strict=True))
    focal = given.get("f", 0.0)
    lens = np.array([given.get(name, 0.0) for name in (*_BROWN_NAMES, "k4", "k5", "k6")])
    return {
        "width": int(camera_width),
        "height": int(camera_height),
        "fx": given.get("fx", focal),
        "fy": given.get("fy", focal),
        # In COLMAP integers are the corners of pixels, in manip3d their centres.
        "cx": given["cx"] - 0.5,
        "cy": given["cy"] - 0.5,
        "distortion": _brown_of(lens),
    }


_OTHER_NAMES = {
    "fl_x": "fx", "fl_y": "fy", "ppx": "cx", "ppy": "cy", "w": "width", "h": "height",
}  # fmt: skip
"""Names of nerfstudio and librealsense, with the fields of `Intrinsics`."""

_BROWN_NAMES = ("k1", "k2", "p1", "p2", "k3")


_LENS_FIELDS = {"camera_model", "distortion_model", "model", "is_fisheye"}
"""Fields that `_fields_of_mapping` has checked."""


def _lens_of_realsense(coefficients: Any, model: Any) -> tuple[float, ...]:
    """Return the coefficients of librealsense's lens if its model is that of `Intrinsics`.

    Its modified and inverse models have the same coefficients, with another meaning.
    """
    if isinstance(coefficients, Mapping):
        raise ValueError("coeffs that are no list")
    numbers = _numbers_of([] if coefficients is None else coefficients)
    if numbers.any() and _plain_model(model) not in ("brownconrady", "4"):
        name = _REALSENSE_PREFIX.sub("", str(model))[:40]
        of_model = "without a model" if model is None else f"of the model {name!r}"
        raise ValueError(f"coeffs {of_model}; the one that can be read is brown_conrady")
    return _brown_of(numbers)


def _renamed(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a camera under the names of `Intrinsics`; others cause a warning."""
    ours = {_OTHER_NAMES.get(name, name): value for name, value in fields.items()}
    if "fl_x" in fields or "fl_y" in fields:  # integers are the corners of pixels, as in COLMAP
        ours |= {name: ours[name] - 0.5 for name in ("cx", "cy") if name in ours}
    if "distortion" not in ours and any(name in ours for name in _BROWN_NAMES):
        ours["distortion"] = [ours.pop(name, 0.0) for name in _BROWN_NAMES]
    if "distortion" not in ours and "coeffs" in ours:
        ours["distortion"] = _lens_of_realsense(ours.pop("coeffs"), ours.pop("model", None))
    if absent := [name for name in ("fx", "fy", "cx", "cy") if name not in ours]:
        raise ValueError(f"no {' and no '.join(absent)}")
    ours |= {name: _whole(ours[name]) for name in ("width", "height") if name in ours}
    known = {name for name in Intrinsics.__dataclass_fields__ if name != "rays"}
    if others := [name for name in ours if name not in known | _LENS_FIELDS]:
        if any(np.any(ours[name]) for name in others if name in ("coeffs", "k4", "k5", "k6")):
            raise ValueError("a distortion of more than k1, k2, p1, p2 and k3")
        listed = ", ".join(repr(name[:40]) for name in others[:5]) + (
            ", ..." if len(others) > 5 else ""
        )
        warnings.warn(
            f"fields that are not a camera's are left out: {listed}", stacklevel=caller_level()
        )
    return {name: value for name, value in ours.items() if name in known}


def _fields_of_matrix(text: str) -> dict[str, float]:
    """Return a camera from a text of numbers, row by row, with comments after ``#``."""
    text = re.sub(r"#[^\n]*", "", text)
    words = re.split(r"[\s,;\[\]]+", text.strip(" \t\r\n[],;"), maxsplit=16)
    numbers = [float(word) for word in words]
    if len(numbers) == 4:
        return dict(zip(("fx", "fy", "cx", "cy"), numbers, strict=True))
    if len(numbers) not in (9, 12, 16):
        raise ValueError(f"{'more than 16' if len(numbers) > 16 else len(numbers)} numbers")
    rows = 4 if len(numbers) == 16 else 3
    return _pinhole_of_matrix(np.array(numbers).reshape(rows, -1))


def _square_of(numbers: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return nine numbers as a matrix, row by row; ``name`` names it in errors.

    Open3D's and Apple's matrices are stored column by column, which shows by cx and cy in the last
    row.
    """
    if numbers.size != 9:
        raise ValueError(f"{name} of {numbers.size} numbers")
    square = numbers.reshape(3, 3)
    by_column = np.any(square[2, :2]) and not np.any(square[:2, 2])
    return square.T if by_column else square


def _pinhole_of_matrix(matrix: NDArray[np.float64]) -> dict[str, float]:
    _expect_pinhole(matrix)
    return {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}


def _expect_pinhole(matrix: NDArray[np.float64]) -> None:
    """Refuse a matrix that is no camera, such as a pose; a skew of up to 1e-3 fx is rounding."""
    below = np.array([matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1.0])
    rest = np.concatenate([(matrix - np.eye(*matrix.shape))[:, 3:].ravel(), below])
    if matrix.shape[0] == 4:
        rest = np.concatenate([rest, matrix[3, :3]])
    if not np.allclose(rest, 0.0) or not abs(matrix[0, 1]) <= 1e-3 * abs(matrix[0, 0]):
        raise ValueError("a matrix that is not (fx, 0, cx; 0, fy, cy; 0, 0, 1)")


_STEREO_KEYS = ("cam0", "doffs", "baseline")


def _stereo_calibration(text: str, path: Path) -> _StereoCalibration | None:
    """Return the calibration in a ``calib.txt``; None if it is not that of a stereo pair.

    Depth is baseline x focal length / (disparity + doffs); the file has the baseline in
    millimetres, focal length and doffs in pixels.
    """
    values = dict(re.findall(r"^[ \t]*(\w+)[ \t]*=[ \t]*([^\r\n]*)", text, re.MULTILINE))
    if not any(key in values for key in _STEREO_KEYS):
        return None
    try:
        if absent := [key for key in _STEREO_KEYS if key not in values]:
            raise ValueError(f"no {' and no '.join(absent)}")
        fields = _fields_of_matrix(values["cam0"])
        fields |= {key: int(values[key]) for key in ("width", "height") if key in values}
        focal_metres = fields["fx"] * float(values["baseline"]) / 1000.0
        offset = float(values["doffs"])
        if not (0.0 < focal_metres < np.inf and np.isfinite(offset)):
            raise ValueError(f"baseline={values['baseline']}, doffs={values['doffs']}")
    except ValueError as error:
        reason = f"expected cam0=[fx 0 cx; 0 fy cy; 0 0 1], doffs and baseline: {error}"
        raise FormatError(reason, file=str(path)) from error
    return _StereoCalibration(fields, f"disparity:{focal_metres:.9g},{offset:.9g}")
