"""Units of the stored numbers of depth images, given by name or guessed."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.io._depth_files import MAX_PIXELS, MILLIMETRES, read_stored_depth
from manip3d.rgbd import NO_MEASUREMENT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Depth = NDArray[np.uint16] | NDArray[np.float32]

_NO_DISPARITY = 2047
"""The Kinect V1 stores this value for "no measurement"."""

_NEAREST_DISPARITY, _FARTHEST_DISPARITY = 300.0, 1091.0
"""Disparities at 0.44 m and at 234 m; raw images of the Kinect V1 have none outside this range."""

_FARTHEST_MILLIMETRES = 20_000.0
"""Largest plausible depth in millimetres; depth cameras that store millimetres reach 10 m or
less."""

_NEAREST_MILLIMETRES = 4_000.0
"""If the 5th percentile, read as millimetres, is above 4 m, then 1/5000 m (0.8 m) is the more
likely unit of a depth camera."""

_MOST_ROTATED = 0.9
"""SUN RGB-D stores multiples of 8; filtered images of it have a few other numbers. Also the largest
share of multiples of 16 among them."""

_MIN_ROTATED = 50
"""Smallest number of different multiples of 8: all numbers of an image of a few flat surfaces may
be multiples of 8 by chance."""

_NEAREST_ROTATED = 300.0
"""Millimetres: depth cameras measure little that is nearer. An image in steps of 8 mm, read as SUN
RGB-D's, would be 8 times too near."""

_NOTHING_THERE = 65_504.0
"""Metres: the largest finite half-precision number. Renderers store it, or 1e10, where a ray hits
nothing; no camera measures that far."""

_NEAREST_MEDIAN, _FARTHEST_MEDIAN = 0.05, 200.0
"""Metres: a median depth outside of these limits makes a given unit doubtful, because few cameras
look at anything nearer and few lasers measure farther."""

_USUAL_MEDIAN = 300.0
"""Millimetres: most depth cameras measure nothing nearer, but those of endoscopes and small parts
do, so that centimetres are only mentioned."""


@dataclass(frozen=True, eq=False)
class DepthReading:
    """A depth image, and the unit by which its stored numbers were converted.

    Attributes
    ----------
    depth : (H, W) uint16 in millimetres, or float32 in metres
        0 = no measurement.
    unit : str
        Name of the unit, valid as an argument of `read_depth_guessing`.
    guessed : bool
        Whether the unit was guessed from the numbers.
    reason : str
        Why this unit was guessed; empty if it was given.
    doubt : str
        Reason to doubt a unit that was given; empty if there is none.
    num_marked : int
        Number of pixels that stored 65535, the largest 16-bit number; they are 0 in ``depth``. Many
        cameras store it for "no measurement", or for any depth beyond their range. Floats of
        exactly this number are treated alike, unless the unit is the metre.
    """

    depth: NDArray[np.uint16] | NDArray[np.float32] = field(repr=False)
    unit: str
    guessed: bool
    reason: str
    doubt: str = ""
    num_marked: int = 0

    @property
    def num_measured(self) -> int:
        """Number of pixels with a measurement."""
        return int(np.count_nonzero(self.depth > 0))

    @property
    def range_m(self) -> tuple[float, float] | None:
        """Smallest and largest measurement in metres; None without a measurement."""
        measured = self.depth[self.depth > 0]
        if not len(measured):
            return None
        scale = 1e-3 if self.depth.dtype == np.uint16 else 1.0
        return float(measured.min()) * scale, float(measured.max()) * scale

    @property
    def sentence(self) -> str:
        """Summary in one sentence: range, unit, and why the unit was guessed or is doubtful."""
        if self.range_m is None:
            return "no measured pixel"
        near, far = self.range_m
        what = f"depth {near:.2f} to {far:.2f} m, unit {self.unit} ({describe_unit(self.unit)})"
        if self.guessed:
            what += f", guessed: {self.reason}"
        if self.doubt:
            what += f"; warning: {self.doubt}"
        if self.num_marked:
            what += f"; {self.num_marked} pixels of {NO_MEASUREMENT} taken as not measured"
        return what


def _per_metre(units: float) -> Callable[[NDArray[Any]], Depth]:
    def metres(stored: NDArray[Any]) -> Depth:
        if stored.dtype == np.uint16 and units == MILLIMETRES:
            return np.array(stored, order="C")
        with np.errstate(invalid="ignore"):  # signalling NaN
            return _positive(stored / units)

    return metres


def _positive(depth: NDArray[Any]) -> Depth:
    """Return depth in metres as float32; values <= 0 or beyond `_NOTHING_THERE` become 0."""
    with np.errstate(invalid="ignore"):
        there = (depth > 0) & (depth < _NOTHING_THERE)
    return np.where(there, depth, 0).astype(np.float32)


def _kinect_metres(stored: NDArray[Any]) -> Depth:
    """Convert Kinect V1 disparities d to metres: 351.3 / (1092.5 - d) (NYU Depth V2 toolbox)."""
    disparity = stored.astype(np.float64)
    there = (disparity >= 1) & (disparity <= _FARTHEST_DISPARITY)
    return _positive(np.where(there, 351.3 / np.where(there, 1092.5 - disparity, 1.0), 0.0))


def _nyu_metres(stored: NDArray[Any]) -> Depth:
    return _kinect_metres(stored.byteswap())


def _sun_millimetres(stored: NDArray[Any]) -> Depth:
    whole = np.asarray(stored, np.uint16)
    return np.asarray((whole >> 3) | (whole << 13), np.uint16)


_UNITS: Mapping[str, tuple[str, Callable[[NDArray[Any]], Depth]]] = {
    "mm": ("1/1000 m: Kinect V2, Azure Kinect, RealSense and most others", _per_metre(1000.0)),
    "tum": ("1/5000 m: TUM RGB-D, ICL-NUIM", _per_metre(5000.0)),
    "m": ("metres", _per_metre(1.0)),
    "kinect-raw": ("disparity of 11 bits of a Kinect V1", _kinect_metres),
    "nyu": ("disparity of a Kinect V1 with its bytes swapped: NYU Depth V2, raw", _nyu_metres),
    "sun": ("1/1000 m with the bits rotated by three: SUN RGB-D", _sun_millimetres),
}
DEPTH_UNITS = tuple(_UNITS)
"""Names of the units that `read_depth_guessing` knows."""

_UNIT_OF_NUMBER = {1.0: "m", 1000.0: "mm", 5000.0: "tum"}
"""Names of units by their number in a metre."""

_WHOLE_ONLY = ("kinect-raw", "nyu", "sun")

_DISPARITY = "disparity:"
"""Prefix of a unit of disparities; the two numbers of `_disparity_metres` follow it."""


def _disparity_metres(focal_baseline: float, offset: float) -> Callable[[NDArray[Any]], Depth]:
    """Return the conversion of disparities d of a rectified stereo pair to metres: f b / (d + o).

    ``focal_baseline`` is f b: the focal length in the unit of d times the baseline in metres;
    ``offset`` is o, the difference of the two principal points in the unit of d.
    """

    def metres(stored: NDArray[Any]) -> Depth:
        disparity = stored.astype(np.float64)
        with np.errstate(invalid="ignore"):
            there = (disparity > 0) & (disparity + offset > 0)
        return _positive(focal_baseline / np.where(there, disparity + offset, np.inf))

    return metres


@checked
def describe_unit(unit: str) -> str:
    """Describe a unit in words: ``1/5000 m: TUM RGB-D, ICL-NUIM``.

    Parameters
    ----------
    unit : str
        A unit of `read_depth_guessing`.

    Returns
    -------
    str
        The unit, with the cameras or data sets that use it.

    Raises
    ------
    InputError
        ``unit`` is not a unit.

    Examples
    --------
    >>> from manip3d import io
    >>> io.describe_unit("tum")
    '1/5000 m: TUM RGB-D, ICL-NUIM'
    """
    unit = _checked_unit(unit)
    if unit == "guess":
        return "guessed from the stored numbers"
    if unit.startswith(_DISPARITY):
        focal_baseline, offset = _disparity_numbers(unit)
        return f"depth is {focal_baseline:g} m / (d + {offset:g}), of a stereo pair"
    return _UNITS[unit][0] if unit in _UNITS else f"1/{unit} m"


@checked
def read_depth_guessing(
    path: str | os.PathLike[str], *, unit: str | float = "guess", max_pixels: int = MAX_PIXELS
) -> DepthReading:
    """Read a depth image whose unit is not known for certain.

    Parameters
    ----------
    path : path-like
        Depth image in any format of `read_depth`, recognised by its content.
    unit : str or float
        ``guess``, one of `DEPTH_UNITS`, the number of units per metre, or ``disparity:FB`` for the
        disparities d of a stereo pair. Their depth is FB / d, where FB is the focal length in the
        unit of d (pixels or a fraction of them) times the baseline in metres. With
        ``disparity:FB,DOFFS`` it is FB / (d + DOFFS). Disparities of 0 or less mean no measurement.
        Images of 8 bits are read only as disparities (Middlebury's older pairs), or with fewer than
        1000 units per metre.
    max_pixels : int
        Larger images are refused before any memory is allocated for them.

    Returns
    -------
    DepthReading
        The depth in millimetres or metres, with its unit and the reason for a guess.

    Raises
    ------
    InputError
        ``unit`` is not a unit, or is one of 16-bit integers while the image has other numbers.
    FormatError, OSError, MissingExtraError
        See `read_depth`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> np.save("depth.npy", np.full((48, 64), 2000, np.uint16))
    >>> io.read_depth_guessing("depth.npy").unit
    'mm'
    """
    stored = read_stored_depth(path, max_pixels=max_pixels, may_be_narrow=fits_8_bits(unit))
    return depth_reading(stored, unit, os.fspath(path))


def fits_8_bits(unit: str | float) -> bool:
    """Return whether an image of 8 bits may be in this unit; in millimetres it would be a mask."""
    name = _checked_unit(unit)
    if name == "guess" or name in _UNITS:
        return False
    return name.startswith(_DISPARITY) or float(name) < MILLIMETRES


def depth_reading(stored: NDArray[Any], unit: str | float, source: str) -> DepthReading:
    """Interpret stored depth numbers that are in memory; ``source`` names them in errors."""
    name = _checked_unit(unit)
    if name == "guess":
        name, reason = guess_depth_unit(stored)
        depth, num_marked = _converted(stored, name)
        return DepthReading(depth, name, True, reason, num_marked=num_marked)
    if name in _WHOLE_ONLY and stored.dtype != np.uint16:
        raise InputError(f"unit: {name} is of whole numbers, {source} has {stored.dtype}")
    depth, num_marked = _converted(stored, name)
    return DepthReading(depth, name, False, "", _doubt_of(depth, name, stored), num_marked)


def _converted(stored: NDArray[Any], unit: str) -> tuple[Depth, int]:
    """Return the depth, and the number of pixels that stored 65535, which are 0 in the depth."""
    depth = _conversion(unit)(stored)
    is_code = unit in _WHOLE_ONLY or unit.startswith(_DISPARITY)  # not a multiple of the depth
    numbers = depth if is_code else stored
    if numbers.dtype != np.uint16 and (is_code or unit == "m"):
        return depth, 0
    marked = numbers == NO_MEASUREMENT
    depth[marked] = 0  # safe, because a conversion always returns a new array
    return depth, int(np.count_nonzero(marked))


def _doubt_of(depth: Depth, unit: str, stored: NDArray[Any]) -> str:
    """Return a warning if the median depth is implausible for any camera, else an empty string."""
    measured = depth[depth > 0]
    if not len(measured):
        return ""
    median = float(np.median(measured)) * (1e-3 if depth.dtype == np.uint16 else 1.0)
    if _NEAREST_MEDIAN <= median <= _FARTHEST_MEDIAN:
        return ""
    looks = guess_depth_unit(stored)[0]
    far = median > _FARTHEST_MEDIAN
    where = f"beyond {median:.0f} m" if far else f"nearer than {1000 * median:.3g} mm"
    alike = f"; the numbers look like unit {looks}" if looks != unit else ""
    return f"half of the image is {where}{alike}"


def _conversion(unit: str) -> Callable[[NDArray[Any]], Depth]:
    if unit.startswith(_DISPARITY):
        return _disparity_metres(*_disparity_numbers(unit))
    return _UNITS[unit][1] if unit in _UNITS else _per_metre(float(unit))


def _checked_unit(unit: str | float) -> str:
    text = unit if isinstance(unit, str) else f"{unit:g}"
    if text == "guess" or text in _UNITS:
        return text
    if text.startswith(_DISPARITY):
        focal_baseline, offset = _disparity_numbers(text)
        return f"{_DISPARITY}{focal_baseline:.9g}" + (f",{offset:.9g}" if offset else "")
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < float("inf"):
        known = ", ".join(("guess", *_UNITS, "disparity:FB"))
        raise InputError(f"unit: expected {known} or a number of units per metre, got {text!r}")
    return _UNIT_OF_NUMBER.get(number, f"{number:g}")


def units_per_metre(unit: str) -> float | None:
    """Return how many of a unit, other than ``guess``, are a metre; None if no number is.

    Disparities and SUN RGB-D's rotated bits are no multiples of a depth.

    Raises
    ------
    InputError
        ``unit`` is not a unit of `read_depth_guessing`.
    """
    name = _checked_unit(unit)
    if name in _WHOLE_ONLY or name.startswith(_DISPARITY):
        return None
    numbers = {named: number for number, named in _UNIT_OF_NUMBER.items()}
    return numbers[name] if name in numbers else float(name)


def _disparity_numbers(unit: str) -> tuple[float, float]:
    """Return focal length times baseline, and the offset of the disparities, of such a unit."""
    focal_baseline, _, offset = unit.removeprefix(_DISPARITY).partition(",")
    try:
        numbers = float(focal_baseline), float(offset or 0.0)
    except ValueError:
        numbers = math.nan, 0.0
    if not (0.0 < numbers[0] < math.inf and math.isfinite(numbers[1])):
        expected = "disparity:FB or disparity:FB,DOFFS with a number FB > 0"
        raise InputError(f"unit: expected {expected}, got {unit!r}")
    return numbers


@checked
def guess_depth_unit(stored: NDArray[Any]) -> tuple[str, str]:
    """Guess the unit of a depth image from its stored numbers.

    Parameters
    ----------
    stored : (H, W) whole numbers up to 65535, or float16, float32 or float64
        0, negative numbers and NaN = no measurement; the whole number 65535 is ignored.

    Returns
    -------
    unit : str
        One of `DEPTH_UNITS`.
    reason : str
        The reason in words.

    Raises
    ------
    InputError
        ``stored`` holds a whole number above 65535.

    Notes
    -----
    Millimetres and 1/5000 m are told apart only by the range of the numbers. The guess is wrong for
    a scene beyond 4 m stored in millimetres, and for a scene nearer than 0.8 m stored in 1/5000 m.
    Millimetres in steps of 8 mm beyond 2.4 m are taken for those of SUN RGB-D. Give the unit if it
    is known.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> io.guess_depth_unit(np.full((480, 640), 2.5, np.float32))[0]
    'm'
    """
    if stored.dtype.kind in "iu" and stored.dtype != np.uint16:
        if stored.size and stored.max() > NO_MEASUREMENT:
            raise InputError(
                f"stored: expected whole numbers of at most {NO_MEASUREMENT}, got {stored.max()}"
            )
        stored = np.maximum(stored, 0).astype(np.uint16)
    with np.errstate(invalid="ignore"):
        measured = stored[np.isfinite(stored) & (stored > 0)]
    if not len(measured):
        return ("mm" if stored.dtype == np.uint16 else "m"), "there is no measurement"
    if stored.dtype != np.uint16:
        return _guess_float(measured)
    measured = measured[measured < NO_MEASUREMENT]
    if not len(measured):
        return "mm", "there is no measurement"
    if _is_disparity(stored):
        return "kinect-raw", f"the values end at {_NO_DISPARITY}, which a Kinect V1 stores for none"
    if _is_disparity(stored.byteswap()):
        return "nyu", "with swapped bytes the values are disparities of a Kinect V1"
    if _is_rotated(measured):
        return "sun", "the values are multiples of 8, as of rotated millimetres"
    return _guess_whole(measured)


def _guess_float(measured: NDArray[Any]) -> tuple[str, str]:
    near = measured[measured < _NOTHING_THERE]
    median = float(np.median(near if len(near) else measured))
    if median > 100:
        reason = f"fractions, but half of the image would be beyond {median:.0f} m"
        if median < _USUAL_MEDIAN:
            reason += f"; in centimetres, unit 100, it would be beyond {median / 100:.1f} m"
        return "mm", reason
    return "m", "the image holds fractions, not whole numbers"


def _is_disparity(stored: NDArray[Any]) -> bool:
    """Return whether the values are raw disparities of a Kinect V1: 2047 means no measurement."""
    if stored.max() != _NO_DISPARITY:
        return False
    seen = stored[stored < _NO_DISPARITY]
    if not len(seen):
        return False
    inside = (seen >= _NEAREST_DISPARITY) & (seen <= _FARTHEST_DISPARITY)
    return bool(np.mean(inside) > 0.98)


def _is_rotated(measured: NDArray[Any]) -> bool:
    """Return whether the values are millimetres rotated left by three bits (SUN RGB-D).

    Nearly all are multiples of 8 then, and about half of them multiples of 16. If most were
    multiples of 16, they would be coarser numbers that were scaled up, such as those of 8 bits.
    """
    multiples = measured[measured % 8 == 0]
    return bool(
        len(multiples) > _MOST_ROTATED * len(measured)
        and np.mean(multiples % 16 == 0) < _MOST_ROTATED
        and len(np.unique(multiples)) >= _MIN_ROTATED
        and np.percentile(_sun_millimetres(measured), 5) > _NEAREST_ROTATED
        and np.percentile(_sun_millimetres(measured), 95) < _FARTHEST_MILLIMETRES
    )


def _guess_whole(measured: NDArray[Any]) -> tuple[str, str]:
    near, far = np.percentile(measured, (5, 99)) / 1000
    if 1000 * far > _FARTHEST_MILLIMETRES and 1000 * near > _NEAREST_MILLIMETRES / 2:
        return "tum", f"as millimetres the image would reach {far:.1f} m"
    if 1000 * near > _NEAREST_MILLIMETRES:
        return "tum", f"as millimetres nearly nothing would be nearer than {near:.1f} m"
    return "mm", f"whole numbers, and a usual range: mostly {near:.1f} to {far:.1f} m"
