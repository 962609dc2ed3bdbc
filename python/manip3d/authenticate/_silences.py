"""Returns that are missing one by one, and lasers without any."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._firings import (
    firings_of,
)
from manip3d.authenticate._sensors import is_hdl64e, is_unit_of_kitti
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._firings import Firings
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice

LEAST_FILL = 0.6
"""Share of the firings of the lower half of the lasers that return. Whole frames of KITTI have 0.77
to 0.95, every second point of one 0.48."""

FEW_RETURNS = "fewer returns from the ground than a whole frame has"

MOST_SINGLE_HOLES, SAME_RANGE, NEAR_HOLES = 0.0034, 0.005, 15.0
"""Share of the firings of the lower half of the lasers without a return, of those whose neighbours
along the ring both have one, nearer than so many metres, at ranges that differ by less than that
share: on a smooth road, which always answers. It is that of the half of the sectors that lacks
least: dark cars lose returns in some sectors, what is left out at random is missing in all. Whole
frames of KITTI have 0.0002 at most, and 0.0036 at least without one point of 200 (24 frames of nine
drives, all of which were looked at, twice each), frames of 8 simulated streets 0.0004 at most. The
limit is near the thinned ones: a road that is wet or worn may lose more than those of nine
drives."""

HOLE_SECTORS, FEWEST_ON_ROAD = 16, 4000
"""Sectors of the firings: what is missing everywhere is missing in half of them; and firings that
could be missed there, at least, so that a few lost ones say nothing."""

FAR_HOLES, MOST_FAR_HOLES, FEWEST_FAR = (25.0, 60.0), 0.05, 400
"""Metres; the same share of all lasers between these ranges; and firings that could be missed. Of
47 frames of KITTI, all of which were looked at, it is 0.007 at most, of ten simulated streets
0.019; where the more returns were left out the farther they are, from 20 m to all at 100 m, 0.1 and
more in the 36 with enough of them. Far roads that are wet lose returns one by one, too."""

WIDEST_HOLE = 8
"""Firings from a return to the next on the same surface: far longer than holes are if every second
one is missing at random (1 of 256), and shorter than what a dark thing leaves."""

MOST_SILENT_ALONE = 190
"""Firings in a row in which one laser has no return and both beside it have one. There are 119 at
most in 47 whole frames of KITTI and 69 in 12 of four simulated streets; a page of a file that was
lost, or was filled with zeros, leaves 256 rows of a laser out."""

LEAST_ANSWERED, ANSWERED_BESIDE = 0.02, 0.3
"""Share of the firings with a return of a laser that was left out, and of the lasers above and
below. The lasers of KITTI's whole frames have 0.4 and more."""

LEAST_OF_HIGHEST = 0.01
"""Share of the firings of the highest eighth of the lasers, which look to the horizon and above:
where all that stands was taken away nothing answers them. KITTI's whole frames have 0.8."""


def thinned_out(
    firings: Firings, distance: NDArray[np.float64], *, whole: bool
) -> list[Processing]:
    """Find points that were left out here and there, or laser by laser.

    Parameters
    ----------
    firings : Firings
    distance : (N,) float64, metres
        Distance of each point from the scanner.
    whole : bool
        The turn has no wide gap.
    """
    found: list[Processing] = []
    rings, reach = len(firings.answered), _reach(firings, distance)
    lower, lowest = (slice(first, (7 * rings) // 8) for first in ((3 * rings) // 8, rings // 2))
    below = firings.answered[lower]
    if whole and np.count_nonzero(below) < LEAST_FILL * below.size:
        found.append(Processing("thinned", FEW_RETURNS))
    elif _single_holes(firings, reach, lowest) > MOST_SINGLE_HOLES:
        lost = _share_left_out(reach[lowest])
        found.append(
            Processing("thinned", f"{lost:.1%} of the returns are missing one by one everywhere")
        )
    elif _single_holes(firings, reach, slice(None), FAR_HOLES, FEWEST_FAR) > MOST_FAR_HOLES:
        detail = f"returns farther than {FAR_HOLES[0]:g} m are missing one by one everywhere"
        found.append(Processing("thinned", detail))
    if silent := len(_silent_between(firings)):
        found.append(Processing("lasers", f"{silent} of the {rings} lasers have no returns"))
    elif not found and (lost := _longest_silence_alone(firings)) > MOST_SILENT_ALONE:
        detail = f"a laser between two that answer has no return in {lost} firings in a row"
        found.append(Processing("thinned", detail))
    return found


def _longest_silence_alone(firings: Firings) -> int:
    """Firings, most of any laser from one return to its next, in which both lasers beside answer.

    One laser meets what those above and below it meet, but for an edge that it runs along.
    """
    answered = firings.answered
    beside = np.cumsum(answered[:-2] & answered[2:], axis=1, dtype=np.int32)
    laser, firing = np.nonzero(answered[1:-1])
    passed = np.diff(beside[laser, firing])
    passed[np.diff(laser) != 0] = 0
    return max(0, int(passed.max(initial=0)) - 1)


def _silent_between(firings: Firings) -> NDArray[np.intp]:
    """Lasers without returns between two that have many."""
    answered = firings.answered.mean(axis=1)
    beside = np.minimum(answered[:-2], answered[2:])
    return 1 + np.flatnonzero((answered[1:-1] < LEAST_ANSWERED) & (beside > ANSWERED_BESIDE))


def silent_lasers(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading | None = None
) -> NDArray[np.intp]:
    """Return the lasers that a file lacks, as processing of the kind ``lasers`` counts them.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice
    reading : LatticeReading or None
        Where the points lie on the lattice; None: it is read here.
    """
    rings = len(lattice.slope)
    firings = firings_of(lattice.read(points) if reading is None else reading, rings)
    if firings is None:
        return np.empty(0, np.intp)
    top, bottom = silent_at_the_ends(firings, lattice)
    ends = np.r_[:top, rings - bottom : rings]
    return np.union1d(_silent_between(firings), ends)


def _single_holes(
    firings: Firings,
    reach: NDArray[np.float64],
    lasers: slice,
    metres: tuple[float, float] = (0.0, NEAR_HOLES),
    fewest: int = FEWEST_ON_ROAD,
) -> float:
    """Share of firings without a return among those between two with one on a smooth surface.

    That of the half of the sectors that lacks least. It is high for any loss that leaves a return
    on either side of each hole, as of every third point: `_share_left_out` says how many are lost.
    """
    before, behind = reach[lasers, :-2], reach[lasers, 2:]
    between = (before > metres[0]) & (behind > metres[0]) & (before < metres[1])
    between &= np.abs(before - behind) < SAME_RANGE * before
    if between.shape[1] < HOLE_SECTORS:
        return 0.0
    holes = between & ~firings.answered[lasers, 1:-1]
    starts = np.linspace(0, between.shape[1], HOLE_SECTORS, endpoint=False).astype(np.intp)
    possible = np.add.reduceat(between.sum(axis=0), starts)
    missing = np.add.reduceat(holes.sum(axis=0), starts)
    fullest = np.argsort(missing / np.maximum(possible, 1), kind="stable")[: HOLE_SECTORS // 2]
    among = int(possible[fullest].sum())
    return float(missing[fullest].sum()) / among if among >= fewest else 0.0


def _reach(firings: Firings, distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres that each laser measured at each firing; 0: no return."""
    reach = np.zeros(firings.answered.size)
    reach[firings.cells] = distance[firings.rows]
    return reach.reshape(firings.answered.shape)


def _share_left_out(reach: NDArray[np.float64]) -> float:
    """Share of the returns of a smooth near surface that are missing, in the median sector.

    A firing without a return counts if it lies between two of its laser, at most `WIDEST_HOLE`
    firings apart, that have one on the same surface.
    """
    laser, firing = np.nonzero((reach > 0.0) & (reach < NEAR_HOLES))
    here = reach[laser, firing]
    apart = np.diff(firing)
    steps = (np.diff(laser) == 0) & (apart <= WIDEST_HOLE)
    steps &= np.abs(np.diff(here)) < SAME_RANGE * here[:-1]
    sector = firing[:-1][steps] * HOLE_SECTORS // reach.shape[1]
    fired = np.bincount(sector, apart[steps], HOLE_SECTORS)
    missing = np.bincount(sector, apart[steps] - 1, HOLE_SECTORS)
    return float(np.median(missing[fired > 0] / fired[fired > 0])) if fired.any() else 0.0


def highest_are_silent(firings: Firings) -> bool:
    """Return whether nothing answers the highest eighth of the lasers.

    Parameters
    ----------
    firings : Firings
    """
    highest = firings.answered[: max(1, len(firings.answered) // 8)]
    return bool(np.count_nonzero(highest) < LEAST_OF_HIGHEST * highest.size)


def silent_at_the_ends(firings: Firings, lattice: SensorLattice) -> tuple[int, int]:
    """Count lasers without returns above and below one with many, as in a file that ends too early.

    How few returns are none was measured on the unit of KITTI. The lowest lasers of another
    HDL-64E may mostly meet its own carrier, and those of other scanners may always do. Where the
    highest eighth is silent, it is what stands that was taken away, not lasers.

    Parameters
    ----------
    firings : Firings
    lattice : SensorLattice

    Returns
    -------
    highest, lowest : int
    """
    if not is_hdl64e(lattice):
        return 0, 0
    answered = firings.answered.mean(axis=1)
    is_heard = answered >= LEAST_ANSWERED if is_unit_of_kitti(lattice) else answered > 0.0
    heard = np.flatnonzero(is_heard)
    if not len(heard):
        return 0, 0
    top, last = int(heard[0]), int(heard[-1])
    bottom = len(answered) - 1 - last
    is_top = answered[top] > ANSWERED_BESIDE and not highest_are_silent(firings)
    return top if is_top else 0, bottom if answered[last] > ANSWERED_BESIDE else 0
