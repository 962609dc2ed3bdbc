"""Cameras: intrinsics, registration of a colour to a depth camera, and nominal cameras."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from manip3d import _core
from manip3d._util.arrays import CONVERSION_ERRORS, as_array, one_line, rows, vector
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError

if TYPE_CHECKING:
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
            uint16 in millimetres or float in metres; one number per pixel, or one for all. Numbers
            of Python are in metres; other integers of NumPy are refused, also in lists.
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
        is_millimetres = given.dtype == np.uint16
        if not is_millimetres and (other := _integer_dtype(depth)) is not None:
            mixed = " beside other numbers" if other == np.uint16 else ""
            raise InputError(f"depth: expected dtype uint16 or float, got {other}{mixed}")
        z = np.asarray(given, np.float64)
        if is_millimetres:
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


def depth_array(depth: ArrayLike) -> NDArray[np.uint16 | np.float32]:
    """Return a depth image as an array, without a copy if it is one; check its type and axes."""
    image = as_array(depth, "depth")
    if image.dtype not in (np.uint16, np.float32):
        raise InputError(
            f"depth: expected dtype uint16 (millimetres) or float32 (metres), got {image.dtype}"
        )
    if image.ndim != 2:
        raise InputError(f"depth: expected shape (H, W), got {image.shape}")
    return image


def checked_depth(depth: ArrayLike, intrinsics: Intrinsics) -> NDArray[np.uint16 | np.float32]:
    """Return a depth image as a C-contiguous array, without a copy if it is one; check its size."""
    if not isinstance(intrinsics, Intrinsics):
        raise InputError(f"intrinsics: expected Intrinsics, got {intrinsics!r}")
    image = depth_array(depth)
    if image.shape != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth: expected shape ({intrinsics.height}, {intrinsics.width}) as the intrinsics "
            f"say, got {image.shape}"
        )
    return np.ascontiguousarray(image)


def _integer_dtype(value: Any) -> np.dtype[Any] | None:
    """Return the type of the first integers of NumPy in an array or in nested lists, or None."""
    if isinstance(value, list | tuple):
        return next((found for one in value if (found := _integer_dtype(one)) is not None), None)
    dtype = getattr(value, "dtype", None)
    return dtype if isinstance(dtype, np.dtype) and dtype.kind in "iu" else None


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
        from manip3d.io._intrinsics_files import camera_of_file

        return camera_of_file(Path(text), width, height)
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
    if not text.lower().endswith(CAMERA_SUFFIXES):
        return "guess"
    from manip3d.io._intrinsics_files import unit_of_file

    return unit_of_file(Path(text))
