"""Find rows of a scan that are no returns: markers, fill values, leftovers of decoders."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.lidar import LidarFrame

LARGEST_COUNT, MAX_CORRECTED = 2**16 - 1, 2.0
"""LARGEST_COUNT: largest range in packets, in range steps, which stands for no return (131.07 m for
an HDL-64E, which is specified for 120 m). MAX_CORRECTED: largest correction of a range by the
calibration of a laser, metres (1.6 for an HDL-64E)."""

HOUSING = 0.1
"""Metres from the scanner's origin: nearer points lie inside the scanner itself."""

LAST_RANGES, MIN_FILLED = 4.0, 60
"""Fill values are searched for within LAST_RANGES metres of the farthest point, which is more than
calibrations of lasers differ by. At least MIN_FILLED rows must have one."""

SAME_RANGE, MIN_OF_LASER, MIN_LASERS = 0.003, 5, 4
"""Firings without a return were filled with one range if at least MIN_OF_LASER rows of a laser
are at the laser's farthest range (to SAME_RANGE metres, because of rounding to millimetres), and at
least MIN_LASERS lasers have such rows."""

NOISE = 0.1
"""Metres over which noise spreads the returns of a wall. Scanners with range steps of 8 mm measure
many of them at the farthest step, but more at the steps before it; just below a fill value there
are almost no points."""


def farthest_range(lattice: SensorLattice) -> float:
    """Return the largest distance of a return of a scanner, metres; infinity: unknown.

    Parameters
    ----------
    lattice : SensorLattice
        Lattice of the scanner. An HDL-64E states ranges in 16 bits, in steps of 2 mm. Exact clouds
        come from scanners with other packets, and may be in another unit.
    """
    if lattice.is_exact or not lattice.range_step:
        return math.inf
    return LARGEST_COUNT * lattice.range_step - MAX_CORRECTED


def returns_of(
    scan: LidarFrame, lattice: SensorLattice, reading: LatticeReading | None = None
) -> tuple[NDArray[np.int64] | None, tuple[Processing, ...]]:
    """Return the rows of a scan that may be returns, and descriptions of the other rows.

    Rows at (0, 0, 0) are kept, because scanners themselves write them.

    Parameters
    ----------
    scan : LidarFrame
        Scan with the scanner at (0, 0, 0).
    lattice : SensorLattice
        Lattice of the scanner.
    reading : LatticeReading or None
        Places of the points on the lattice; None: they are computed here if needed.

    Returns
    -------
    (rows, processing)
        Rows in ascending order (None: all rows), and what the others are.
    """
    with np.errstate(over="ignore"):  # a squared distance of infinity is too far, too
        squared = np.einsum("ij,ij->i", scan.points, scan.points)
    reach = farthest_range(lattice)
    too_far = squared > reach * reach
    too_near = (squared < HOUSING * HOUSING) & (squared > 0.0)
    if lattice.is_exact:
        too_near[:] = False  # some files put firings without a return at their laser
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
    """Mask of rows with the range that stands for no return: the farthest range of each laser.

    That range differs between lasers with different calibrations.
    """
    filled = np.zeros(len(points), np.bool_)
    begin = max(0.0, math.sqrt(squared.max(initial=0.0)) - LAST_RANGES)
    last = np.flatnonzero(squared > begin * begin)
    if len(last) < MIN_FILLED:
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
    is_filled = (of_laser >= MIN_OF_LASER) & (of_laser > of_wall)
    is_filled[0] = False
    if np.count_nonzero(is_filled) >= MIN_LASERS and of_laser[is_filled].sum() >= MIN_FILLED:
        filled[last[same & (laser > 0)]] = True
    return filled
