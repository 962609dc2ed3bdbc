"""Find traces of a watermark in a scan, and bound how far its embedding moved the points."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.mappings import ReadOnlyMapping

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import SensorLattice
    from manip3d.authenticate._verdict import Processing

    Points = NDArray[np.float32]
    _Test = Callable[[NDArray[np.float64]], tuple[NDArray[np.bool_], NDArray[np.bool_]]]
    """Maps points to two masks: which of them carry a bit, and their bits."""

MIN_CARRIERS = 1000
"""Fewest points in which an embedding is recognised."""

MIN_CARRYING = 0.9
"""Least share of points that carry a bit. Without a watermark the lowest bits of x, y and z are
equal for a quarter of the points, and a thousandth of the heights in whole millimetres lie at a
quarter of a QIM cell."""

BALANCE = (0.25, 0.75)
"""Limits of the share of ones among the bits. Clouds in whole centimetres also have equal lowest
bits, but all of them are zeros."""

QUARTERS_PER_M = 1600.0
"""Quarters of a QIM cell (2.5 mm) per metre."""


@dataclass(frozen=True)
class Allowance:
    """Largest error of watermarked points after `without_bits`.

    `without_bits` removes the bits: it sets each coordinate that carries one to the middle of the
    values that the coordinate may have had before.

    Attributes
    ----------
    tolerance : float
        Metres: largest distance between the restored and the measured point.
    azimuth_error : float
        Metres: largest part of that distance along the arc, which is horizontal.
    range_incoherence : float or None
        Largest share of clean ranges that are a quarter of a step of 2 mm or more off the range
        steps; None: range steps cannot be tested after this embedding. In `generic_consistency`
        rounding to whole millimetres alone has a share of 0.12.
    """

    tolerance: float
    azimuth_error: float
    range_incoherence: float | None


ALLOWED: Mapping[str, Allowance] = ReadOnlyMapping(
    {
        # The error is half a millimetre along each axis. Cells of 2 mm hide range steps of 2 mm:
        # along an axis every second range is a quarter of a step off.
        "lbm": Allowance(math.sqrt(3.0) / 2000.0, math.sqrt(2.0) / 2000.0, None),
        # The error is half a cell in height. Along the lowest beam of an HDL-64E, 25 degrees below
        # the horizon, it is at most 0.53 mm. With the rounding of three coordinates, the error of
        # ranges has a standard deviation of 0.42 mm, so that 0.23 of them are more than half a
        # millimetre off.
        "qim": Allowance(0.00125, 0.0, 0.30),
    }
)
"""Allowance of each embedding on a grid of 1 mm; `allowance` scales it to other grids. A detached
watermark moves no point and needs none."""

MILLIMETRES = 1000
"""Steps per metre of the grid of QIM and of KITTI's scans (HDL-64E)."""


def allowance(embedding: str, units_per_m: int = MILLIMETRES) -> Allowance:
    """The allowance of an embedding of `ALLOWED` on a grid of ``units_per_m`` steps per metre."""
    found, scale = ALLOWED[embedding], MILLIMETRES / units_per_m
    return replace(
        found, tolerance=found.tolerance * scale, azimuth_error=found.azimuth_error * scale
    )


def find_carrier(points: Points, units_per_m: int = MILLIMETRES) -> str | None:
    """Name the watermark whose traces a scan has: lbm, qim or qim-printed; None if it has no trace.

    LBM writes the same bit into the lowest bits of x, y and z, counted in steps of its grid. QIM
    sets z to one or three quarters of a cell of 2.5 mm; ``qim-printed``, QIM as the dissertation
    prints it, to a whole or half cell.
    """
    some = points[:: max(1, len(points) // 5000)]
    tests: Mapping[str, _Test] = _CELL_TESTS | {"lbm": functools.partial(_carries_lbm, units_per_m)}
    for name, carries in tests.items():
        if _holds(some, carries) and _holds(points, carries):
            return name
    return None


def _holds(points: Points, carries: _Test) -> bool:
    """Whether nearly all points carry a bit, and zeros and ones are both frequent."""
    x, y, z = points.T
    scaled = points[(x != 0.0) | (y != 0.0) | (z != 0.0)].astype(np.float64)
    if len(scaled) < MIN_CARRIERS:
        return False
    does, bits = carries(scaled)
    if np.mean(does) < MIN_CARRYING:
        return False
    return bool(BALANCE[0] < np.mean(bits[does]) < BALANCE[1])


def _whole(
    values: NDArray[np.float64], units: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Values rounded to whole units, and which of them are whole to the precision of float32."""
    scaled = values * units
    nearest = np.round(scaled)
    is_whole: NDArray[np.bool_] = np.abs(scaled - nearest) < 0.01 + 1e-7 * np.abs(scaled)
    is_whole &= np.abs(nearest) < 2.0**53
    return np.where(is_whole, nearest, 0.0).astype(np.int64), is_whole


def _carries_lbm(
    units_per_m: int, points: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    units, whole = _whole(points, float(units_per_m))
    lowest = (units & 1).astype(np.bool_)
    equal = (lowest[:, 0] == lowest[:, 1]) & (lowest[:, 0] == lowest[:, 2])
    return equal & whole.all(axis=1), lowest[:, 0]


def _carries_qim(points: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    quarters, whole = _whole(points[:, 2], QUARTERS_PER_M)
    return whole & (quarters % 2 == 1), quarters % 4 == 3


def _carries_printed(points: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    quarters, whole = _whole(points[:, 2], QUARTERS_PER_M)
    return whole & (quarters % 2 == 0), quarters % 4 == 0


_CELL_TESTS: dict[str, _Test] = {
    "qim": _carries_qim,
    "qim-printed": _carries_printed,
}


def trace_of(points: Points) -> tuple[Processing, ...]:
    """Traces of a watermark that no key verifies, as processing; empty if there are none."""
    from manip3d.authenticate._verdict import Processing

    name = find_carrier(points)
    if name is None:
        return ()
    detail = (
        f"its points carry bits as the embedding {name!r} writes them, and no key verifies them"
    )
    return (Processing("watermarked", detail),)


def rounding_of(embedding: str, units_per_m: int) -> tuple[Processing, ...]:
    """The watermark's rounding, as processing, if its grid is coarser than 1 mm; else empty."""
    from manip3d.authenticate._verdict import Processing

    if embedding != "lbm" or units_per_m >= MILLIMETRES:
        return ()
    step = 1000.0 / units_per_m
    return (Processing("rounded", f"the watermark's grid has steps of {step:g} mm"),)


def without_bits(points: Points, embedding: str, units_per_m: int = MILLIMETRES) -> Points:
    """Set each coordinate with a bit to the middle of its possible values before embedding."""
    if embedding == "lbm":
        units = np.round(points.astype(np.float64) * units_per_m)
        middle = (2.0 * np.floor(units / 2.0) + 0.5) / units_per_m
        return np.ascontiguousarray(middle, np.float32)
    if embedding == "qim":
        cells = np.floor(np.round(points[:, 2].astype(np.float64) * QUARTERS_PER_M) / 4.0)
        restored = points.copy()
        restored[:, 2] = (cells + 0.5) * 0.0025
        return restored
    return points


def allowing(lattice: SensorLattice, embedding: str) -> SensorLattice:
    """The lattice without the steps that an embedding makes untestable."""
    blurred = ALLOWED[embedding].range_incoherence is None
    return replace(lattice, coordinate_step=0.0, range_step=0.0 if blurred else lattice.range_step)
