"""Coordinates that were rounded, scaled or moved as a whole: what their digits and lines say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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
"""Metres that files are rounded to, the coarsest first; scanners write 2 mm and less."""

FINE_ROUNDINGS = (0.002, 0.001)
"""Metres: the same of files of an HDL-64E, whose own ranges are steps of 2 mm and whose coordinates
are whole millimetres, where the scan contradicts both."""

OF_ROUNDING = 0.5
"""Share of the step of a rounding that points may be off the lines for it, in the median."""

OWN_ROUNDING = 0.0005
"""Metres: the median distance of a scan's points from the scanner's lines, at most, which the
roundings of its own files leave (0.25 mm in KITTI)."""

NEAR_STEPS, LEAST_STEP, MOST_STEP, FEWEST_STEPS, MOST_STEPS_APART = 32.0, 2e-5, 0.1, 50, 32
"""Metres up to which single precision leaves coordinates apart that are a step apart; the smallest
and the largest step that is looked for, metres; different coordinates, at least; and steps between
two that are next to each other, at most: whole millimetres leave most of finer steps out."""

SAME_STEP = 1e-5
"""Share of a step by which steps of two axes that are the same may differ."""

SINGLE = 2.0**-23
"""Share of a coordinate that single precision may add to the difference of two."""

NEAR_SCALED, FEWEST_SCALED, LEAST_SCALED, OFF_SCALED = (8.0, 25.0), 1000, 0.002, 0.001
"""Metres; points; a difference from 1; metres. Points that were scaled stand so near to lines of
the scanner whose offsets were scaled as well, where lines are apart by more."""

FAR_DIGITS, FEWEST_FAR_DIGITS = 10.0, 1000
"""Metres from which on coordinates of so many significant digits are whole numbers of a tenth, a
hundredth or a thousandth, and nearer ones are not; and coordinates that tell."""

SAMPLE, FEW = 5000, 20
"""Points that are looked at before all are, and one of how many of them before that."""


def processing_off_lattice(
    points: NDArray[np.float32],
    sensor: Sensor,
    reading: LatticeReading | None,
) -> list[Processing]:
    """Say why points lie beside the lines of the scanner, unless a rounding explains it.

    Parameters
    ----------
    points : (N, 3) float32
    sensor : Sensor
    reading : LatticeReading or None
        Where the points lie on the sensor's lattice; None: it is read here.
    """
    rounding = _rounding(points, sample_of(points), ROUNDINGS)
    if rounding is not None and sensor.off_lattice <= OF_ROUNDING * rounding[0]:
        return []
    if (factor := _factor_of(points, sensor, reading)) is not None:
        return [Processing("scaled", f"coordinates are metres times {factor:.4g}")]
    steps = _steps_of_axes(points)
    if steps and sensor.off_lattice <= OF_ROUNDING * max(steps):
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
    """The factor by which all coordinates were multiplied; None: that leaves them off the lines.

    It changes the offset of each line and no slope.
    """
    lattice = sensor.lattice
    if lattice is None:
        return None
    reading = lattice.read(points) if reading is None else reading
    away = np.hypot(points[:, 0], points[:, 1])
    some = (reading.ring >= 0) & (away > NEAR_SCALED[0]) & (away < NEAR_SCALED[1])
    if np.count_nonzero(some) < FEWEST_SCALED:
        return None
    offset = lattice.offset[reading.ring[some]]
    error = reading.line_error[some].astype(np.float64)
    change = float(np.median(error / offset))
    if abs(change) < LEAST_SCALED or np.median(np.abs(error - change * offset)) > OFF_SCALED:
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
    """Find a rounding to steps, as other scanners write or to any, that explains where points lie.

    That to the scanner's own steps, counted from 0, tells nothing.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice or None
        Lattice of the scanner.
    reading : LatticeReading or None
        Where the points lie on it; None: it is read here.
    """
    rounding = _rounding(points, sample_of(points), FINE_ROUNDINGS)
    if rounding == (FINE_ROUNDINGS[-1], _in_words(FINE_ROUNDINGS[-1])) or lattice is None:
        return []
    steps = _steps_of_axes(points) if rounding is None else [rounding[0]]
    off = np.abs((lattice.read(points) if reading is None else reading).line_error)
    if not steps or np.median(off) > OF_ROUNDING * max(steps) + OWN_ROUNDING:
        return []
    if rounding is not None:
        return [Processing("rounded", rounding[1])]
    return [_scaled_to_step(points, steps, lattice) or _rounded_to_steps(steps)]


def _scaled_to_step(
    points: NDArray[np.float32], steps: Sequence[float], lattice: SensorLattice
) -> Processing | None:
    """The factor that made the scanner's own step the step of all axes; None: that was not it."""
    if not lattice.coordinate_step or np.ptp(steps) > SAME_STEP * min(steps):
        return None
    factor = steps[0] / lattice.coordinate_step
    undone = (points / factor).astype(np.float32)
    if generic_consistency(undone, lattice=lattice).contradicted:
        return None
    return Processing("scaled", f"coordinates are metres times {factor:.4g}")


def _rounded_to_steps(steps: Sequence[float]) -> Processing:
    """The rounding to one step, or to one of each axis."""
    several = [f"{1000.0 * step:.3g}" for step in steps]
    words = " and ".join(
        (", ".join(several[:-1]), several[-1]) if len(set(several)) > 1 else several[:1]
    )
    return Processing("rounded", f"coordinates are whole steps of {words} mm from an offset")


def _steps_of_axes(points: NDArray[np.float32]) -> list[float]:
    """Steps, in metres, of which x, y and z are whole numbers from a place; empty: one is not."""
    steps = [_step_of(coordinates) for coordinates in points.T]
    return [] if None in steps else [step for step in steps if step is not None]


def _step_of(coordinates: NDArray[np.float32]) -> float | None:
    """The step, in metres, of which coordinates are whole numbers from a place; None: of none.

    The smallest difference between two is a few steps, and counting them from one coordinate to the
    next tells the step exactly.
    """
    values = np.unique(coordinates[np.abs(coordinates) < NEAR_STEPS]).astype(np.float64)
    if len(values) < FEWEST_STEPS:
        return None
    apart = np.diff(values)
    smallest = float(np.percentile(apart, 0.1))
    smallest = float(np.median(apart[apart < 1.01 * smallest + SINGLE * NEAR_STEPS]))
    for number in range(1, MOST_STEPS_APART + 1):
        if not LEAST_STEP <= smallest / number <= MOST_STEP:
            continue
        count = np.cumsum(np.round(np.diff(values, prepend=values[0]) * (number / smallest)))
        step, start = np.polyfit(count, values, 1)
        off = np.abs(values - (start + step * count))
        if np.mean(off < SINGLE * NEAR_STEPS) > 0.999:
            return float(step)
    return None


def _rounding(
    points: NDArray[np.float32], some: NDArray[np.float32], steps: Sequence[float]
) -> tuple[float, str] | None:
    """The coarsest of some steps that all coordinates are whole numbers of, or are so from a place
    that the file states, as of LAS; in words, too."""
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
    """Coordinates of three or four digits: far ones are whole numbers, and near ones are not."""
    few = some[::FEW]
    for step, words in ((0.1, "three"), (0.01, "four")):
        if not _are_rounded((_far_of(few), _far_of(some)), step):
            continue
        far, near = _far_of(points), some[np.abs(some) < FAR_DIGITS]
        if len(far) < FEWEST_FAR_DIGITS or not len(near) or share_rounded(near, step) > 0.5:
            continue
        if _are_rounded((far,), step):
            return Processing("rounded", f"coordinates have {words} significant digits")
    return None


def _far_of(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coordinates of two digits before the point."""
    lengths = np.abs(points)
    return points[(lengths >= FAR_DIGITS) & (lengths < 10.0 * FAR_DIGITS)]


def _are_rounded(
    samples: Sequence[NDArray[np.float32]], step: float, start: NDArray[np.float64] | float = 0.0
) -> bool:
    """Whether coordinates are whole numbers of a step: first of a few, which are quick to try."""
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
    """Return the share of coordinates that are whole numbers of a step from a place.

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
