"""Rows of a scan that are no returns of its scanner: markers, fill values, decoders' leftovers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.lidar import LidarFrame

LARGEST_COUNT, MOST_CORRECTED = 2**16 - 1, 2.0
"""The largest number that packets state a range by, which stands for no return: 131.07 m of an
HDL-64E, which is made for 120 m; metres by which the calibration of a laser moves a range at most
(an HDL-64E's 1.6)."""

HOUSING = 0.1
"""Metres from the scanner's origin: nearer there is the scanner itself."""

LAST_RANGES, FEWEST_FILLED = 4.0, 60
"""Metres before the farthest point, wider than calibrations of lasers differ; rows of one range for
each laser that make a fill value."""

SAME_RANGE, FEWEST_OF_LASER, FEWEST_LASERS = 0.003, 5, 4
"""Metres by which rounding to millimetres leaves one range of a laser; rows of a laser, lasers: so
many at once have their farthest points at one range where firings without a return were filled with
one."""

NOISE = 0.1
"""Metres over which a scanner's noise spreads the returns of a wall. Scanners that state ranges in
steps of 8 mm put many of them at the farthest step, but more at those before it; before a fill
value there is next to nothing."""


def farthest_range(lattice: SensorLattice) -> float:
    """Return how far away a return of a scanner can lie at most, metres; infinity: not known.

    Parameters
    ----------
    lattice : SensorLattice
        An HDL-64E states ranges in 16 bits of 2 mm. Exact clouds are of scanners with other
        packets, and may be in another unit.
    """
    if lattice.is_exact or not lattice.range_step:
        return math.inf
    return LARGEST_COUNT * lattice.range_step - MOST_CORRECTED


def returns_of(
    scan: LidarFrame, lattice: SensorLattice, reading: LatticeReading | None = None
) -> tuple[NDArray[np.int64] | None, tuple[Processing, ...]]:
    """Return the rows of a scan that may be returns, and what the others are.

    Rows at (0, 0, 0) stay: scanners write them themselves.

    Parameters
    ----------
    scan : LidarFrame
        The scanner in (0, 0, 0).
    lattice : SensorLattice
    reading : LatticeReading or None
        Where the points lie on the lattice; None: it is read here, if need be.

    Returns
    -------
    (rows, processing)
        Rows in ascending order; None: all of them.
    """
    with np.errstate(over="ignore"):  # an infinite distance is far
        squared = np.einsum("ij,ij->i", scan.points, scan.points)
    reach = farthest_range(lattice)
    too_far = squared > reach * reach
    too_near = (squared < HOUSING * HOUSING) & (squared > 0.0)
    if lattice.is_exact:
        too_near[:] = False  # in some files a firing without a return stands where its laser does
    squared[too_far] = 0.0
    filled = _filled(scan.points, squared, lattice, reading)
    found = (
        (too_far, f"farther than {reach:.0f} m, which the scanner cannot measure"),
        (too_near, f"nearer than {HOUSING:g} m, in the scanner itself"),
        (filled, "at the farthest range, the same to the millimetre, as firings without a return"),
    )
    processing = tuple(
        Processing("padded", f"{number} {'row lies' if number == 1 else 'rows lie'} {words}")
        for those, words in found
        if (number := int(np.count_nonzero(those)))
    )
    if not processing:
        return None, ()
    return np.flatnonzero(~(too_far | too_near | filled)), processing


def _filled(
    points: NDArray[np.float32],
    squared: NDArray[np.float32],
    lattice: SensorLattice,
    reading: LatticeReading | None,
) -> NDArray[np.bool_]:
    """Which rows were filled with the range that stands for no return: the farthest of each laser.

    Lasers whose calibrations differ have it at different distances.
    """
    filled = np.zeros(len(points), np.bool_)
    begin = max(0.0, math.sqrt(squared.max(initial=0.0)) - LAST_RANGES)
    last = np.flatnonzero(squared > begin * begin)
    if len(last) < FEWEST_FILLED:
        return filled
    ring = lattice.read(points[last]).ring if reading is None else reading.ring[last]
    laser = ring + 1  # 0: none
    distance = np.sqrt((points[last].astype(np.float64) ** 2).sum(axis=1))
    farthest = np.zeros(int(laser.max()) + 1)
    np.maximum.at(farthest, laser, distance)
    same = distance > farthest[laser] - SAME_RANGE
    before = ~same & (distance > farthest[laser] - NOISE)
    of_laser, of_wall = (
        np.bincount(laser[rows], minlength=len(farthest)) for rows in (same, before)
    )
    is_filled = (of_laser >= FEWEST_OF_LASER) & (of_laser > of_wall)
    is_filled[0] = False
    if np.count_nonzero(is_filled) >= FEWEST_LASERS and of_laser[is_filled].sum() >= FEWEST_FILLED:
        filled[last[same & (laser > 0)]] = True
    return filled
