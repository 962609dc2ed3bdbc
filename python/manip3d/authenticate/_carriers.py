"""Traces of a watermark in a scan, and how far its embedding moved the points."""

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
    """Which points carry a bit, and the bits."""

FEWEST_CARRIERS = 1000
"""Points from which an embedding is recognised."""

LEAST_CARRYING = 0.9
"""Share of the points that must carry a bit. Chance makes the lowest bits of x, y and z equal for a
quarter of the points, and puts a thousandth of the heights in whole millimetres at a quarter of a
QIM cell."""

BALANCE = (0.25, 0.75)
"""Share of ones among the bits. Clouds in whole centimetres have equal lowest bits, too: zeros."""

OF_CELL = 1600.0
"""Quarters of a QIM cell of 2.5 mm in a metre."""


@dataclass(frozen=True)
class Allowance:
    """How far the points of a watermarked scan may be from where the scanner measured them.

    The carriers are put in the middle of what they may have been, which takes the bits off again.

    Attributes
    ----------
    tolerance : float
        Metres by which that middle may be wrong.
    azimuth_error : float
        Metres of that along the arc.
    range_incoherence : float or None
        Share of clean ranges, at most, that are a quarter of a step of 2 mm off then; None: ranges
        tell nothing any more. Whole millimetres alone leave 0.12 in `generic_consistency`.
    """

    tolerance: float
    azimuth_error: float
    range_incoherence: float | None


ALLOWED: Mapping[str, Allowance] = ReadOnlyMapping(
    {
        # Half a millimetre along each axis. Cells of 2 mm hide steps of 2 mm: along an axis every
        # second range is a quarter of a step off.
        "lbm": Allowance(math.sqrt(3.0) / 2000.0, math.sqrt(2.0) / 2000.0, None),
        # Half of a cell in height, of which a beam 25 degrees below the horizon, the lowest of an
        # HDL-64E, has 0.53 mm. With the rounding of three coordinates that is a normal distribution
        # of 0.42 mm, of which 0.23 are beyond half a millimetre.
        "qim": Allowance(0.00125, 0.0, 0.30),
    }
)
"""By embedding, on the grid of 1 mm (`allowance`); a detached watermark moves nothing."""

MILLIMETRES = 1000
"""Steps a metre of the grid that scans of an HDL-64E have, and of QIM's."""


def allowance(embedding: str, units_per_m: int = MILLIMETRES) -> Allowance:
    """The displacement that an embedding of `ALLOWED` causes on a grid of so many steps a metre."""
    found, scale = ALLOWED[embedding], MILLIMETRES / units_per_m
    return replace(
        found, tolerance=found.tolerance * scale, azimuth_error=found.azimuth_error * scale
    )


def find_carrier(points: Points, units_per_m: int = MILLIMETRES) -> str | None:
    """Name the watermark whose traces a scan has: lbm, qim or qim-printed; None: none of them.

    LBM writes one bit into the lowest bits of x, y and z in steps of its grid; QIM puts z at a
    quarter or three quarters of a cell of 2.5 mm, as printed at a whole or half one.
    """
    some = points[:: max(1, len(points) // 5000)]
    tests: Mapping[str, _Test] = _OF_CELLS | {"lbm": functools.partial(_carries_lbm, units_per_m)}
    for name, carries in tests.items():
        if _holds(some, carries) and _holds(points, carries):
            return name
    return None


def _holds(points: Points, carries: _Test) -> bool:
    """Whether nearly all points carry a bit, and the bits are of both kinds."""
    scaled = points[np.any(points != 0.0, axis=1)].astype(np.float64)
    if len(scaled) < FEWEST_CARRIERS:
        return False
    does, bits = carries(scaled)
    if np.mean(does) < LEAST_CARRYING:
        return False
    return bool(BALANCE[0] < np.mean(bits[does]) < BALANCE[1])


def _whole(
    values: NDArray[np.float64], units: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The nearest whole numbers of units per metre, and which values are such, as float32 can."""
    scaled = values * units
    nearest = np.round(scaled)
    wide: NDArray[np.bool_] = np.abs(scaled - nearest) < 0.01 + 1e-7 * np.abs(scaled)
    wide &= np.abs(nearest) < 2.0**53
    return np.where(wide, nearest, 0.0).astype(np.int64), wide


def _carries_lbm(
    units_per_m: int, points: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    units, whole = _whole(points, float(units_per_m))
    lowest = (units & 1).astype(np.bool_)
    equal = (lowest[:, 0] == lowest[:, 1]) & (lowest[:, 0] == lowest[:, 2])
    return equal & whole.all(axis=1), lowest[:, 0]


def _carries_qim(points: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    quarters, whole = _whole(points[:, 2], OF_CELL)
    return whole & (quarters % 2 == 1), quarters % 4 == 3


def _carries_printed(points: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    quarters, whole = _whole(points[:, 2], OF_CELL)
    return whole & (quarters % 2 == 0), quarters % 4 == 0


_OF_CELLS: dict[str, _Test] = {
    "qim": _carries_qim,
    "qim-printed": _carries_printed,
}


def trace_of(points: Points) -> tuple[Processing, ...]:
    """The traces of a watermark that is not verified, as processing; empty: there is none."""
    from manip3d.authenticate._verdict import Processing

    name = find_carrier(points)
    if name is None:
        return ()
    detail = (
        f"its points carry bits as the embedding {name!r} writes them, and no key verifies them"
    )
    return (Processing("watermarked", detail),)


def rounding_of(embedding: str, units_per_m: int) -> tuple[Processing, ...]:
    """The grid as processing if it is coarser than whole millimetres; else empty."""
    from manip3d.authenticate._verdict import Processing

    if embedding != "lbm" or units_per_m >= MILLIMETRES:
        return ()
    step = 1000.0 / units_per_m
    return (Processing("rounded", f"the watermark's grid has steps of {step:g} mm"),)


def without_bits(points: Points, embedding: str, units_per_m: int = MILLIMETRES) -> Points:
    """Put each carrier in the middle of what it may have been before a bit was written into it."""
    if embedding == "lbm":
        units = np.round(points.astype(np.float64) * units_per_m)
        middle = (2.0 * np.floor(units / 2.0) + 0.5) / units_per_m
        return np.ascontiguousarray(middle, np.float32)
    if embedding == "qim":
        cells = np.floor(np.round(points[:, 2].astype(np.float64) * OF_CELL) / 4.0)
        restored = points.copy()
        restored[:, 2] = (cells + 0.5) * 0.0025
        return restored
    return points


def allowing(lattice: SensorLattice, embedding: str) -> SensorLattice:
    """The lattice without the steps that an embedding blurs."""
    blurred = ALLOWED[embedding].range_incoherence is None
    return replace(lattice, coordinate_step=0.0, range_step=0.0 if blurred else lattice.range_step)
