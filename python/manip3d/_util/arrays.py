"""Conversion of array arguments of public functions, the only place where they are copied."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_Scalar = TypeVar("_Scalar", bound=np.generic)


def masked_elements(values: object) -> str:
    """Return how many elements of a `numpy.ma` array are masked, and the cure; '' if none is.

    The data under a mask is arbitrary, so that without the mask it would count as measured.
    """
    # NumPy 2 imports numpy.ma on first use. Before its class exists, which another thread may be
    # about to define, there are no masked arrays.
    masked_array = getattr(sys.modules.get("numpy.ma"), "MaskedArray", None)
    if masked_array is None or not isinstance(values, masked_array):
        return ""
    from numpy import ma  # waits until another thread has finished the import

    if not ma.is_masked(values):
        return ""
    return (
        f"{np.count_nonzero(ma.getmaskarray(values))} masked elements of {values.size}; fill them "
        "first (0 in a depth image: `values.filled(0)`), or leave their rows out"
    )


CONVERSION_ERRORS = (TypeError, ValueError, OverflowError, RuntimeError)
"""Errors of ``numpy.asarray``: rows of different lengths, or a tensor that NumPy cannot read."""


def one_line(value: object, most: int = 80) -> str:
    """Return a value's ``repr`` in one line of at most ``most`` characters."""
    text = repr(value)
    if "\n" in text:  # arrays of other libraries
        text = " ".join(text.split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def unreadable_words(values: object, error: Exception) -> str:
    """Return words on a value of which NumPy makes no array, with the cure of its own error.

    Tensors of GPUs, and such that need their gradient, say in the error what to call first.
    """
    if not hasattr(values, "__array__"):
        return one_line(values)
    reason = " ".join(str(error).split())[:300]
    if "bfloat16" in reason.lower():  # this error names no cure
        reason += "; NumPy has no such numbers, convert them to float32 first"
    return f"an object of type {type(values).__name__}, which NumPy cannot read: {reason}"


def as_array(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return ``numpy.asarray(values)`` in this machine's byte order.

    Masked elements are refused, because ``asarray`` drops the mask.
    """
    if masked := masked_elements(values):
        raise InputError(f"{name}: expected an array without masked elements, got {masked}")
    try:
        array = np.asarray(values)
    except CONVERSION_ERRORS as error:
        found = unreadable_words(values, error)
        raise InputError(f"{name}: expected an array, got {found}") from error
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return the array, which nobody can write any more, because all callers share it."""
    array.flags.writeable = False
    return array


def _shaped(array: NDArray[Any], columns: int | None, name: str) -> NDArray[Any]:
    if array.size == 0:  # [] and np.empty((0, 3)) both mean no rows
        return array.reshape((0,) if columns is None else (0, columns))
    if array.ndim == (1 if columns is None else 2) and columns in (None, array.shape[-1]):
        return array
    expected = "(N,)" if columns is None else f"(N, {columns})"
    raise InputError(f"{name}: expected shape {expected}, got {array.shape}")


def _refuse_rounding(whole: NDArray[Any], converted: NDArray[Any], name: str) -> None:
    """Raise if float64 does not hold integers of 64 bits exactly."""
    if not whole.size or (whole.min() >= -(2**53) and whole.max() <= 2**53):
        return
    # Converting back would be undefined for 2**64. float64 holds both halves of 32 bits exactly.
    low = whole & 0xFFFFFFFF
    is_rounded = converted - (whole - low).astype(np.float64) != low
    if is_rounded.any():
        raise InputError(
            f"{name}: expected numbers that float64 holds exactly, got {whole[is_rounded][0]}"
        )


def rows(
    values: ArrayLike, columns: int | None, dtype: type[_Scalar], name: str
) -> NDArray[_Scalar]:
    """Return a C-contiguous array (N, columns), or (N,) if ``columns`` is None.

    An array that has this shape, dtype and order already is returned without a copy.
    """
    array = _shaped(as_array(values, name), columns, name)
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name}: expected numbers, got dtype {array.dtype}")
    if array.dtype != dtype and np.issubdtype(dtype, np.integer):
        limits = np.iinfo(np.dtype(dtype))
        fits = (
            np.isfinite(array)
            & (array >= limits.min)
            & (array <= limits.max)
            & (np.mod(array, 1) == 0)
        )
        if not fits.all():
            raise InputError(
                f"{name}: expected whole numbers in [{limits.min}, {limits.max}], "
                f"got {array[~fits][0]}"
            )
    with np.errstate(over="ignore"):  # overflow gives infinity, which callers refuse if they must
        converted = np.ascontiguousarray(array, dtype=dtype)
    if dtype is np.float64 and array.dtype in (np.int64, np.uint64):
        _refuse_rounding(array, converted, name)
    return converted


def vector(values: ArrayLike, size: int, name: str) -> NDArray[np.float64]:
    """Return a float64 array (size,) of finite numbers."""
    array = as_array(values, name)
    if array.shape != (size,) or array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        words = {2: "two", 3: "three"}.get(size, str(size))
        raise InputError(f"{name}: expected {words} finite numbers, got {one_line(values)}")
    return array.astype(np.float64)


_FAR_M = 8192.0  # beyond it, float32 rounds by a quarter of a millimetre or more
MAX_ROUNDED_M = 0.001  # about the noise of a terrestrial scanner; larger rounding is warned of


def rounded_by(values: ArrayLike, points: NDArray[np.float32]) -> float:
    """Return the largest distance along an axis by which float32 rounds coordinates in metres.

    0 if all are nearer than 8192 m, where it is below 0.5 mm. Points that are not finite, which
    mean no measurement in grids, are left out.
    """
    given = np.asarray(values)
    if given.dtype == np.float32 or not points.size:
        return 0.0
    if not np.abs(points).max() <= _FAR_M:  # also if a coordinate is NaN
        with np.errstate(invalid="ignore"):  # inf - inf
            off = np.abs(given - points.astype(np.float64))
        return float(off[np.isfinite(off)].max(initial=0.0))
    return 0.0


def warn_of_rounding(
    values: ArrayLike,
    points: NDArray[np.float32],
    name: str,
    cure: str = "",
    *,
    most: float = MAX_ROUNDED_M,
    unit: str = " m",
) -> None:
    """Warn if float32 rounds coordinates by more than ``most``, by default in metres."""
    rounded = rounded_by(values, points)
    if rounded > most:
        warnings.warn(
            f"{name}: float32 rounds these coordinates by up to {rounded:.2g}{unit}; subtract a "
            "place near them first, as readers of files do" + (f" ({cure})" if cure else ""),
            stacklevel=caller_level(),
        )


def index_rows(values: ArrayLike, columns: int | None, name: str) -> NDArray[np.int32]:
    """Return a C-contiguous int32 array (N, columns) or (N,); other integers are range-checked."""
    array = _shaped(as_array(values, name), columns, name)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integers, got dtype {array.dtype}")
    if array.dtype != np.int32 and array.size:
        limits = np.iinfo(np.int32)
        if array.min() < limits.min or array.max() > limits.max:
            raise InputError(
                f"{name}: expected values in [{limits.min}, {limits.max}], "
                f"got {array.min()} to {array.max()}"
            )
    return np.ascontiguousarray(array, dtype=np.int32)


_MAX_ROUNDED_SHARE = 1e-4  # of the extent of a grid, whose unit is not known


def _warn_of_rounded_grid(
    given: NDArray[Any], grid: NDArray[np.float32], valid: NDArray[np.bool_]
) -> None:
    if given.dtype == np.float32 or not valid.any():
        return
    points = grid[valid]
    extent = float(np.ptp(points.astype(np.float64), axis=0).max())
    most = _MAX_ROUNDED_SHARE * extent
    warn_of_rounding(given[valid], points, "points", most=most, unit="")


def checked_grid(
    points: ArrayLike, valid: ArrayLike | None, *, kept: bool = False
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return a grid of points as float32, and its mask of valid points (default: finite ones).

    With ``kept``, for results that keep the arrays, both are copies, so that the caller may reuse
    its own arrays.
    """
    grid = as_array(points, "points")
    if grid.ndim != 3 or grid.shape[2] != 3 or grid.dtype.kind != "f":
        is_first = grid.ndim == 3 and grid.shape[0] == 3
        advice = "; np.moveaxis(points, 0, -1) has the channels last" if is_first else ""
        raise InputError(
            f"points: expected (H, W, 3) floats, got shape {grid.shape}, dtype {grid.dtype}{advice}"
        )
    taken = np.array if kept else np.asarray  # np.asarray copies only if it must convert
    given = grid
    with np.errstate(over="ignore"):  # overflow gives infinity, which is no measurement
        grid = taken(given, np.float32, order="C")
    if valid is None:
        mask = np.isfinite(grid).all(axis=2)
        _warn_of_rounded_grid(given, grid, mask)
        return grid, mask
    mask = as_array(valid, "valid")
    if mask.shape != grid.shape[:2] or mask.dtype != np.bool_:
        raise InputError(
            f"valid: expected bool of shape {grid.shape[:2]}, got {mask.dtype} of {mask.shape}"
        )
    _warn_of_rounded_grid(given, grid, mask)
    return grid, taken(mask, order="C")
