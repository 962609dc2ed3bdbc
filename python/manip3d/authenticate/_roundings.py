"""Recognise coordinates that were rounded, scaled or moved as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import line_fit
from manip3d.authenticate._generic import generic_consistency
from manip3d.authenticate._lattice import FIVE_DIGITS_TO, has_whole_millimetres
from manip3d.authenticate._sensors import is_in_metres
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.authenticate._sensors import Sensor

ROUNDINGS = (0.1, 0.05, 0.02, 0.01, 0.005)
"""Steps of roundings, metres, the coarsest first; scanners write steps of 2 mm and less."""

FINE_ROUNDINGS = (0.002, 0.001)
"""Further steps, metres, for scans of an HDL-64E that contradict the scanner's own steps: its
ranges are multiples of 2 mm, and its coordinates whole millimetres."""

MAX_OFF_ROUNDING = 0.5
"""Largest median distance from the lines that a rounding explains, in its steps."""

OWN_ROUNDING = 0.0005
"""Metres: largest median distance from the lines that is due to the rounding of the scanner's own
files (0.25 mm in KITTI)."""

NEAR_STEPS, MIN_STEP, MAX_STEP, MIN_STEPS, MAX_STEPS_APART = 32.0, 2e-5, 0.1, 50, 32
"""Search for the step of coordinates. NEAR_STEPS, metres: only smaller coordinates are used, for
which single precision distinguishes steps. MIN_STEP and MAX_STEP, metres: limits of the step.
MIN_STEPS: fewest different coordinates. MAX_STEPS_APART: largest number of steps between
successive different coordinates; rounding to whole millimetres before leaves most of finer steps
unused."""

SAME_STEP = 1e-5
"""Largest relative difference of the steps of two axes that count as equal."""

SINGLE = 2.0**-23
"""Relative error of the difference of two coordinates in single precision."""

NEAR_SCALED, MIN_SCALED, MIN_SCALE_CHANGE, OFF_SCALED = (8.0, 25.0), 1000, 0.002, 0.001
"""Coordinates were scaled if the lines of the scanner fit after scaling their offsets, too: at
least MIN_SCALED points at distances within NEAR_SCALED (metres), where lines are far apart, have a
median error of at most OFF_SCALED metres. The factor differs from 1 by MIN_SCALE_CHANGE or more."""

FAR_DIGITS, MIN_FAR_DIGITS = 10.0, 1000
"""Coordinates with few significant digits are multiples of a tenth or a hundredth of a metre if
they are at least FAR_DIGITS metres, but smaller ones are not. At least MIN_FAR_DIGITS such
coordinates are needed."""

SAMPLE, FEW = 5000, 20
"""Tests are made on about SAMPLE points before all points; and before these, on one of FEW of
them."""


def processing_off_lattice(
    points: NDArray[np.float32],
    sensor: Sensor,
    reading: LatticeReading | None,
) -> list[Processing]:
    """Return the processing that moved points off the lines; empty if a known rounding explains it.

    Parameters
    ----------
    points : (N, 3) float32
    sensor : Sensor
    reading : LatticeReading or None
        Places of the points on the sensor's lattice; None: they are computed here.
    """
    rounding = _rounding(points, sample_of(points), ROUNDINGS)
    if rounding is not None and sensor.off_lattice <= MAX_OFF_ROUNDING * rounding[0]:
        return []
    if (factor := _factor_of(points, sensor, reading)) is not None:
        return [Processing("scaled", f"coordinates are metres times {factor:.4g}")]
    steps = _steps_of_axes(points)
    if steps and sensor.off_lattice <= MAX_OFF_ROUNDING * max(steps):
        return [_rounded_to_steps(steps)]
    return [
        Processing(
            "moved",
            f"points lie {1000 * sensor.off_lattice:.1f} mm beside the lines of the scanner in "
            "the median: deskewed, averaged, rounded, or noise was added",
        )
    ]


def _factor_of(
    points: NDArray[np.float32], sensor: Sensor, reading: LatticeReading | None
) -> float | None:
    """The factor by which all coordinates were multiplied; None if scaling does not fit.

    Scaling changes the offsets of the lines but not their slopes.
    """
    lattice = sensor.lattice
    if lattice is None:
        return None
    reading = lattice.read(points) if reading is None else reading
    away = np.hypot(points[:, 0], points[:, 1])
    near = (away > NEAR_SCALED[0]) & (away < NEAR_SCALED[1])
    some = np.flatnonzero((reading.ring >= 0) & near)
    some = some[lattice.offset[reading.ring[some]] != 0]  # scaling does not change an offset of 0
    if len(some) < MIN_SCALED:
        return None
    offset = lattice.offset[reading.ring[some]]
    error = reading.line_error[some].astype(np.float64)
    change = float(np.median(error / offset))
    left = np.median(np.abs(error - change * offset))
    if not (abs(change) >= MIN_SCALE_CHANGE and left <= OFF_SCALED):
        return None
    return 1.0 + change


def processing_of_coordinates(points: NDArray[np.float32]) -> list[Processing]:
    if len(points) == 0:
        return []
    some = sample_of(points)
    if _is_float16(some) and _is_float16(points):
        return [Processing("float16", "all coordinates are numbers of 16 bits")]
    if not is_in_metres(some):
        return []
    if (rounding := _rounding(points, some, ROUNDINGS)) is not None:
        return [Processing("rounded", rounding[1])]
    near = some[np.abs(some) < FIVE_DIGITS_TO]
    has_finer = len(near) > 0 and share_rounded(near, 1e-3) < 0.5
    if has_finer and has_whole_millimetres(points, FIVE_DIGITS_TO):
        return [Processing("rounded", "coordinates have five significant digits")]
    step = _rounded_to_digits(points, some)
    return [] if step is None else [step]


def sample_of(points: NDArray[np.float32]) -> NDArray[np.float32]:
    return points[:: max(1, len(points) // SAMPLE)]


def finely_rounded(
    points: NDArray[np.float32], lattice: SensorLattice | None, reading: LatticeReading | None
) -> list[Processing]:
    """Find a rounding to some step that explains the points' distances from the lines.

    Multiples of the scanner's own step of 1 mm are no processing.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice or None
        Lattice of the scanner.
    reading : LatticeReading or None
        Places of the points on the lattice; None: they are computed here.
    """
    rounding = _rounding(points, sample_of(points), FINE_ROUNDINGS)
    if rounding == (FINE_ROUNDINGS[-1], _in_words(FINE_ROUNDINGS[-1])) or lattice is None:
        return []
    steps = _steps_of_axes(points) if rounding is None else [rounding[0]]
    off = np.abs((lattice.read(points) if reading is None else reading).line_error)
    if not steps or np.median(off) > MAX_OFF_ROUNDING * max(steps) + OWN_ROUNDING:
        return []
    if rounding is not None:
        return [Processing("rounded", rounding[1])]
    return [_scaled_to_step(points, steps, lattice) or _rounded_to_steps(steps)]


def _scaled_to_step(
    points: NDArray[np.float32], steps: Sequence[float], lattice: SensorLattice
) -> Processing | None:
    """The scaling that makes the scanner's own step the step of all axes; None: none does."""
    if not lattice.coordinate_step or np.ptp(steps) > SAME_STEP * min(steps):
        return None
    factor = steps[0] / lattice.coordinate_step
    undone = (points / factor).astype(np.float32)
    if generic_consistency(undone, lattice=lattice).contradicted:
        return None
    return Processing("scaled", f"coordinates are metres times {factor:.4g}")


def _rounded_to_steps(steps: Sequence[float]) -> Processing:
    """Rounding to one step, or to a step for each axis."""
    several = [f"{1000.0 * step:.3g}" for step in steps]
    words = " and ".join(
        (", ".join(several[:-1]), several[-1]) if len(set(several)) > 1 else several[:1]
    )
    return Processing("rounded", f"coordinates are whole steps of {words} mm from an offset")


def _steps_of_axes(points: NDArray[np.float32]) -> list[float]:
    """Steps of x, y and z, metres, from any offset; empty if one of them has no step."""
    steps = [_step_of(coordinates) for coordinates in points.T]
    return [] if None in steps else [step for step in steps if step is not None]


def _step_of(coordinates: NDArray[np.float32]) -> float | None:
    """Step of coordinates from any offset, metres; None if there is none.

    The smallest difference of two coordinates is a few steps. Counting steps from each coordinate
    to the next, and fitting a line, gives the exact step.
    """
    values = np.unique(coordinates[np.abs(coordinates) < NEAR_STEPS]).astype(np.float64)
    if len(values) < MIN_STEPS:
        return None
    apart = np.diff(values)
    smallest = float(np.percentile(apart, 0.1))
    smallest = float(np.median(apart[apart < 1.01 * smallest + SINGLE * NEAR_STEPS]))
    for number in range(1, MAX_STEPS_APART + 1):
        if not MIN_STEP <= smallest / number <= MAX_STEP:
            continue
        count = np.cumsum(np.round(np.diff(values, prepend=values[0]) * (number / smallest)))
        step, start = line_fit(count, values)
        off = np.abs(values - (start + step * count))
        if np.mean(off < SINGLE * NEAR_STEPS) > 0.999:
            return step
    return None


def _rounding(
    points: NDArray[np.float32], some: NDArray[np.float32], steps: Sequence[float]
) -> tuple[float, str] | None:
    """The coarsest of some steps of which all coordinates are multiples, and a description.

    Multiples may be counted from 0, or from an offset, as in LAS files.
    """
    few, place = some[::FEW], some[0].astype(np.float64)
    for step in steps:
        if _are_rounded((few, some, points), step):
            return step, _in_words(step)
        if _are_rounded((few, some, points), step, place):
            return step, f"coordinates are whole steps of {1000 * step:g} mm from an offset"
    return None


def _in_words(step: float) -> str:
    return f"coordinates are whole numbers of {1000 * step:g} mm"


def _rounded_to_digits(points: NDArray[np.float32], some: NDArray[np.float32]) -> Processing | None:
    """Rounding to three or four significant digits; None if there is none."""
    few = some[::FEW]
    for step, words in ((0.1, "three"), (0.01, "four")):
        if not _are_rounded((_far_of(few), _far_of(some)), step):
            continue
        far, near = _far_of(points), some[np.abs(some) < FAR_DIGITS]
        if len(far) < MIN_FAR_DIGITS or not len(near) or share_rounded(near, step) > 0.5:
            continue
        if _are_rounded((far,), step):
            return Processing("rounded", f"coordinates have {words} significant digits")
    return None


def _far_of(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coordinates with two digits before the decimal point."""
    lengths = np.abs(points)
    return points[(lengths >= FAR_DIGITS) & (lengths < 10.0 * FAR_DIGITS)]


def _are_rounded(
    samples: Sequence[NDArray[np.float32]], step: float, start: NDArray[np.float64] | float = 0.0
) -> bool:
    """Whether coordinates are whole multiples of a step; small samples are tested first."""
    *tried, points = samples
    return all(
        len(each) > 0 and share_rounded(each, step, start) > least
        for each, least in (*((each, 0.99) for each in tried), (points, 0.999))
    )


def _is_float16(points: NDArray[np.float32]) -> bool:
    with np.errstate(over="ignore"):
        return np.array_equal(points.astype(np.float16).astype(np.float32), points)


def share_rounded(
    points: NDArray[np.float32], step: float, start: NDArray[np.float64] | float = 0.0
) -> float:
    """Return the share of coordinates that are whole multiples of a step from an offset.

    Parameters
    ----------
    points : (..., 3) or (N,) float32
    step : float, metres
    start : (3,) float64 or float, metres
    """
    wide = points.astype(np.float64)
    steps = (wide - start) / step
    off = np.abs(steps - np.round(steps)) * step
    return float(np.mean(off < 1e-5 + 1e-6 * np.abs(wide)))
