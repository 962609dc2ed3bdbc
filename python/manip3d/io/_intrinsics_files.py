"""Calibration files of cameras, as OpenCV, ROS, Open3D, COLMAP and other programs write them."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.regular_files import open_regular
from manip3d.camera import Intrinsics
from manip3d.errors import FormatError, InputError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

_MAX_CAMERA_BYTES = 1 << 20  # largest size of a calibration file; real ones have a few kB


def unit_of_file(path: Path) -> str:
    """Return the unit of depth images that a camera's file states, or ``guess``."""
    name = path.name.lower()
    if name.endswith(".json"):
        return _unit_of_json(_text_of_camera(path))
    if not name.endswith(".txt"):
        return "guess"
    stereo = _stereo_calibration(_text_of_camera(path), path)
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


def camera_of_file(path: Path, width: int, height: int) -> Intrinsics:
    """Read the camera of an image of this size, as `manip3d.camera.read_intrinsics` does."""
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
    plain = _plain_fields(fields)
    _refuse_wide_lenses(plain)
    camera = _camera_of_mapping(fields, plain, path)
    if any(camera.get("distortion", ())):
        _expect_brown(plain)
    return camera


def _plain_name(name: object) -> str:
    return str(name).lower().replace("_", "")


def _plain_fields(fields: Mapping[Any, Any]) -> dict[str, Any]:
    """Return fields under their names in lower case without underscores."""
    return {_plain_name(name): value for name, value in fields.items()}


def _camera_of_mapping(
    fields: Mapping[Any, Any], plain: Mapping[str, Any], path: Path
) -> dict[str, Any]:
    """Return a camera from its fields; ``plain`` has them in lower case without underscores."""
    matrix = fields.get("intrinsic_matrix")
    if matrix is not None:
        size = {n: _whole(fields[n]) for n in ("width", "height") if n in fields}
        square = _square_of(_numbers_of(matrix), "an intrinsic_matrix")
        return size | _pinhole_of_matrix(square) | {"distortion": _lens_of(plain)}
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
    camera["distortion"] = _lens_of(fields)
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


_LENSES = (
    "distortioncoefficients", "distortioncoeffs", "distortion", "distcoeffs", "distcoefs", "dist",
    "d",
)  # fmt: skip
"""Names of the list of a lens's coefficients, as `_plain_fields` spells them."""

_COEFFICIENTS = (*_BROWN_NAMES, "k4", "k5", "k6")


def _is_of_lens(name: str, value: Any) -> bool:
    """Return whether a field has a lens; a number under the name of a list is something else."""
    if name in _LENSES:
        return not isinstance(value, int | float)
    return name in _COEFFICIENTS or name == "coeffs"


def _lens_of(fields: Mapping[str, Any]) -> tuple[float, ...]:
    """Return Brown's coefficients among the fields of a camera, which `_plain_fields` spells."""
    for name in _LENSES:
        value = fields.get(name)
        if not _is_of_lens(name, value):
            continue
        if isinstance(value, Mapping) and "data" not in value:
            return _lens_of(_plain_fields(value))
        if value is not None and not (isinstance(value, str) and is_brown(value)):
            return _brown_of(_numbers_of(value))
    if "coeffs" in fields:
        return _lens_of_realsense(fields["coeffs"], fields.get("model"))
    numbers = [_numbers_of(fields.get(name, 0.0)) for name in _COEFFICIENTS]
    # Matrices of a stereo pair have names such as K1 and P1.
    return _brown_of(np.array([each[0] if each.size == 1 else 0.0 for each in numbers]))


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
    plain = _plain_fields(fields)
    lenses = {name for name, value in fields.items() if _is_of_lens(_plain_name(name), value)}
    ours = {_OTHER_NAMES.get(n, n): value for n, value in fields.items() if n not in lenses}
    if lenses:
        ours["distortion"] = _lens_of(plain)
    if "fl_x" in fields or "fl_y" in fields:  # integers are the corners of pixels, as in COLMAP
        ours |= {name: ours[name] - 0.5 for name in ("cx", "cy") if name in ours}
    if absent := [name for name in ("fx", "fy", "cx", "cy") if name not in ours]:
        raise ValueError(f"no {' and no '.join(absent)}")
    ours |= {name: _whole(ours[name]) for name in ("width", "height") if name in ours}
    known = {name for name in Intrinsics.__dataclass_fields__ if name != "rays"}
    if others := [name for name in ours if name not in known | _LENS_FIELDS]:
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
