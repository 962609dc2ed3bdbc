"""Find single missing returns everywhere in a scan, and lasers without returns."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._firings import firings_of
from manip3d.authenticate._sensors import is_hdl64e, is_unit_of_kitti
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from manip3d.authenticate._firings import Firings
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice

MIN_FILL = 0.6
"""Least share of firings with a return, in the lasers from three to seven eighths of the way down.
It is 0.77 to 0.95 in whole frames of KITTI, and 0.48 in every second point of a frame."""

FEW_RETURNS = "fewer returns from the ground than a whole frame has"

WHY_MISSING = "left out of the file, or lost by rain, snow, fog or a wet road"
"""Reasons for single missing returns; the scan does not show which of them it is."""

WHY_SILENT = "cut out, or water or a dark surface there"
"""Reasons for lasers without returns in a sector."""

MAX_SINGLE_HOLES, SAME_RANGE, NEAR_HOLES = 0.0034, 0.005, 15.0
"""Points were left out at random if more than the share MAX_SINGLE_HOLES of the firings of the
lower half of the lasers, without the lowest eighth, has no return, of those whose two neighbours
along the ring have returns nearer than NEAR_HOLES metres at ranges that differ by less than the
share SAME_RANGE: on a smooth road, which always returns the pulse. Only the half of the sectors
with the fewest missing returns counts, because dark cars lose returns in some sectors, while points
left out at random are missing in all. The share is at most 0.0002 in whole frames of KITTI, at
least 0.0036 without one point of 200 (24 frames of nine drives, each thinned twice), and at most
0.0004 in frames of 8 simulated streets. The limit is close to the thinned frames, because a wet or
worn road may lose more returns than those of nine drives. Simulated rain, snow, fog and wet roads
exceed it: one scan does not tell returns that the scanner lost from points that were left out."""

HOLE_SECTORS, MIN_ON_ROAD = 16, 4000
"""HOLE_SECTORS: number of sectors of the firings, of which the half with the fewest missing returns
counts. MIN_ON_ROAD: fewest firings between two returns of a smooth surface in that half."""

FAR_HOLES, MAX_FAR_HOLES, MIN_FAR = (25.0, 60.0), 0.05, 400
"""The same for all lasers and ranges within FAR_HOLES metres: MAX_FAR_HOLES is the largest share,
MIN_FAR the fewest firings. The share is at most 0.007 in 47 frames of KITTI, and 0.019 in ten
simulated streets. If returns are left out with a probability that rises from 20 m to 1 at 100 m, it
is at least 0.1 in the 36 frames with enough firings. Distant wet roads also lose single returns."""

WIDEST_HOLE = 8
"""Largest number of firings from a return to the next one on the same surface. Only 1 of 256 holes
is longer if every second return is missing at random; dark objects leave longer holes."""

MAX_SILENT = 190
"""Largest number of successive azimuths in which neighbouring lasers have no return while the
lasers above and below both have one. In 22 whole frames (KITTI's drives 0002 and a, six simulated
streets), which chose the limit, the number is at most 93, and in 37 other frames (31 of KITTI) at
most 80. A page of a file that was lost, or filled with zeros, removes 256 rows of a laser."""

MANY_LASERS = 24
"""Least number of silent lasers from the highest one downwards, or from the lowest one upwards,
that may be a crop: only the laser on one side of them can show it. In the same frames as many
neighbouring lasers are silent in at most 16 (22 frames) and 81 (37) successive azimuths."""

BESIDE, STRAIGHT = 20, 0.5
"""Such lasers were cut out only if at least the share STRAIGHT of them has a return within BESIDE
azimuths of each end of their silence: a cut ends at one azimuth, the shore of a lake or the side of
a dark vehicle does not. The share is at least 0.95 in frames of KITTI out of which sectors were
cut, and at most 0.06 beside water along a quay, in nine simulated scenes. There the laser beside
the silent ones answers in at most 0.2 of their azimuths, and in 0.68 to 1 of those of the cuts."""

ALONE = 8
"""A return without another one of its laser within ALONE azimuths does not interrupt a silence."""

MIN_ANSWERED, ANSWERED_BESIDE = 0.02, 0.3
"""Lasers were left out if their share of firings with a return is below MIN_ANSWERED, and that of
the lasers above and below them exceeds ANSWERED_BESIDE. Lasers of KITTI's whole frames have at
least 0.4."""

MIN_OF_HIGHEST = 0.01
"""Least share of firings with a return in the highest eighth of the lasers, which look at the
horizon and above; with less, all upright objects were removed. In KITTI's whole frames it is
0.8."""


def thinned_out(
    firings: Firings, lattice: SensorLattice, distance: NDArray[np.float64], *, whole: bool
) -> list[Processing]:
    """Find single points left out everywhere, and lasers left out everywhere or in a sector.

    Parameters
    ----------
    firings : Firings
        Firings of the turn.
    lattice : SensorLattice
        Lattice of the scanner.
    distance : (N,) float64, metres
        Distance of each point from the scanner.
    whole : bool
        Whether the turn has no wide gap in azimuth.
    """
    found: list[Processing] = []
    rings, reach = len(firings.answered), _reach(firings, distance)
    lower = _lower_half(rings)
    below = firings.answered[(3 * rings) // 8 : lower.stop]
    if whole and np.count_nonzero(below) < MIN_FILL * below.size:
        found.append(Processing("thinned", FEW_RETURNS))
    elif _single_holes(firings, reach, lower) > MAX_SINGLE_HOLES:
        lost = _share_left_out(reach[lower])
        detail = f"{lost:.1%} of the returns are missing one by one everywhere ({WHY_MISSING})"
        found.append(Processing("thinned", detail))
    elif _single_holes(firings, reach, slice(None), FAR_HOLES, MIN_FAR) > MAX_FAR_HOLES:
        far = f"returns farther than {FAR_HOLES[0]:g} m are missing one by one everywhere"
        found.append(Processing("thinned", f"{far} ({WHY_MISSING})"))
    if silent := len(_silent_between(firings)):
        have = "has" if silent == 1 else "have"
        found.append(Processing("lasers", f"{silent} of the {rings} lasers {have} no returns"))
    is_thin = any(step.kind == "thinned" for step in found)
    if whole and not is_thin and (silence := _longest_silence(firings, lattice)) is not None:
        found.append(silence.processing())
    return found


def single_holes_near(firings: Firings, distance: NDArray[np.float64]) -> float:
    """Return the share of single missing returns of the road nearby; 0: too few returns.

    Parameters
    ----------
    firings : Firings
        Firings of the turn.
    distance : (N,) float64, metres
        Distance of each point from the scanner.
    """
    return _single_holes(firings, _reach(firings, distance), _lower_half(len(firings.answered)))


def _lower_half(rings: int) -> slice:
    """The lower half of the lasers, without the lowest eighth."""
    return slice(rings // 2, (7 * rings) // 8)


class _Silence(NamedTuple):
    """Successive azimuths in which neighbouring lasers have no return."""

    first: int  # the highest laser
    last: int  # the lowest laser
    start: int  # azimuth at which the silence begins
    azimuths: int
    turn: int  # number of azimuths of the whole turn

    @property
    def firings(self) -> int:
        return (self.last - self.first + 1) * self.azimuths

    def processing(self) -> Processing:
        if self.first == self.last:
            lost = self.azimuths
            detail = f"a laser between two that answer has no return in {lost} firings in a row"
            return Processing("thinned", detail)
        ends = (360.0 * each / self.turn for each in (self.start, self.start + self.azimuths))
        begin, end = (round(each) % 360 for each in ends)
        where = f"from {begin} to {end} degrees of azimuth (counter-clockwise from x)"
        lasers = f"lasers {self.first} to {self.last} (0: the highest) have no returns"
        return Processing("sector", f"{where}, {lasers} ({WHY_SILENT})")


def _longest_silence(firings: Firings, lattice: SensorLattice) -> _Silence | None:
    """The silence with most firings of those that no whole frame has.

    A laser meets the same surfaces as the lasers above and below it, except along edges.
    """
    heard = np.flatnonzero(firings.answered.mean(axis=1) >= MIN_ANSWERED)
    if not len(heard):
        return None
    answered = _by_azimuth(firings.answered[heard], lattice.azimuth[heard])
    are_silent = [*_have_long_silences(answered), False]
    longest: _Silence | None = None
    for first in np.flatnonzero(are_silent).tolist():
        end = are_silent.index(False, first)
        lasers = int(heard[end - 1] - heard[first]) + 1
        silent = np.ones(answered.shape[1], np.bool_)
        for last in range(first, end):
            silent &= ~answered[last]
            runs = _long_runs(silent)
            # Firings of this silence if all the lasers below were silent in it, too
            most = lasers * max(map(len, runs), default=0)
            if most <= (longest.firings if longest else 0):
                break
            run = max(_unexplained(answered, (first, last), runs), key=len, default=None)
            if run is None:
                continue
            ends = int(heard[first]), int(heard[last])
            found = _Silence(*ends, int(run[0]), len(run), len(silent))
            if longest is None or found.firings > longest.firings:
                longest = found
    return longest


def _by_azimuth(answered: NDArray[np.bool_], azimuth: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The lasers' returns by azimuth instead of the time of firing, without single ones."""
    turn = answered.shape[1]
    steps = np.rint(azimuth * (turn / (2.0 * math.pi))).astype(np.intp)
    rolled = np.array([np.roll(row, step) for row, step in zip(answered, steps, strict=True)])
    around = np.pad(rolled, ((0, 0), (ALONE + 1, ALONE)), mode="wrap")
    until = np.cumsum(around, axis=1, dtype=np.int32)
    near = until[:, 2 * ALONE + 1 :] - until[:, : -2 * ALONE - 1]
    return rolled & (near > 1)


def _have_long_silences(answered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which lasers have no return in more than `MAX_SILENT` successive azimuths.

    The runs of `_long_runs` would tell it, too, but most scans are whole, and need no more than
    this answer for all lasers at once.
    """
    around = np.pad(answered, ((0, 0), (1, MAX_SILENT)), mode="wrap")
    until = np.cumsum(around, axis=1, dtype=np.int32)
    returns = until[:, MAX_SILENT + 1 :] - until[:, : -MAX_SILENT - 1]
    found: NDArray[np.bool_] = returns.min(axis=1) == 0
    return found


def _unexplained(
    answered: NDArray[np.bool_], lasers: tuple[int, int], runs: Sequence[NDArray[np.intp]]
) -> list[NDArray[np.intp]]:
    """The silences of lasers, among runs of azimuths, that no whole frame has."""
    first, last = lasers
    beside = [laser for laser in (first - 1, last + 1) if 0 <= laser < len(answered)]
    is_inside = len(beside) == 2
    if not is_inside and last - first + 1 < MANY_LASERS:
        return []
    answer = np.logical_and.reduce(answered[beside], axis=0)
    block = answered[first : last + 1]
    return [
        run
        for run in runs
        if np.count_nonzero(answer[run]) > MAX_SILENT
        and (is_inside or _has_straight_sides(block, run))
    ]


def _has_straight_sides(answered: NDArray[np.bool_], run: NDArray[np.intp]) -> bool:
    """Whether most lasers have a return soon before and soon after a run of azimuths."""
    turn, near = answered.shape[1], np.arange(1, BESIDE + 1)
    sides = (run[0] - near) % turn, (run[-1] + near) % turn
    return all(np.mean(answered[:, side].any(axis=1)) >= STRAIGHT for side in sides)


def _long_runs(mask: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Places of each run of more than `MAX_SILENT` true values on a circle."""
    if mask.all():
        return [np.arange(len(mask))] if len(mask) > MAX_SILENT else []
    start = int(np.argmin(mask))
    steps = np.diff(np.r_[False, np.roll(mask, -start), False].astype(np.int8))
    begin, end = start + np.flatnonzero(steps > 0), start + np.flatnonzero(steps < 0)
    long = np.flatnonzero(end - begin > MAX_SILENT)
    return [np.arange(begin[k], end[k]) % len(mask) for k in long]


def _silent_between(firings: Firings) -> NDArray[np.intp]:
    """Lasers with hardly any returns, one or several in a row, between two lasers with many."""
    answered = firings.answered.mean(axis=1)
    heard = np.flatnonzero(answered >= MIN_ANSWERED)
    between = [
        np.arange(above + 1, below)
        for above, below in itertools.pairwise(heard)
        if min(answered[above], answered[below]) > ANSWERED_BESIDE
    ]
    return np.concatenate([np.empty(0, np.intp), *between])


def silent_lasers(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading | None = None
) -> NDArray[np.intp]:
    """Return the lasers that are missing from a file, as counted by processing of kind ``lasers``.

    Parameters
    ----------
    points : (N, 3) float32
        Points with the scanner at the origin.
    lattice : SensorLattice
        Lattice of the scanner.
    reading : LatticeReading or None
        Places of the points on the lattice; None: they are computed here.
    """
    rings = len(lattice.slope)
    firings = firings_of(lattice.read(points) if reading is None else reading, rings)
    if firings is None:
        return np.empty(0, np.intp)
    top, bottom = silent_at_the_ends(firings, lattice)
    ends = np.r_[:top, rings - bottom : rings]
    return np.union1d(_silent_between(firings), ends)


def lacks_neighbouring_lasers(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading | None = None
) -> bool:
    """Return whether several lasers in a row are missing between two that have many returns.

    Parameters
    ----------
    points, lattice, reading
        As for `silent_lasers`.
    """
    firings = firings_of(lattice.read(points) if reading is None else reading, len(lattice.slope))
    return firings is not None and bool((np.diff(_silent_between(firings)) == 1).any())


def _single_holes(
    firings: Firings,
    reach: NDArray[np.float64],
    lasers: slice,
    metres: tuple[float, float] = (0.0, NEAR_HOLES),
    fewest: int = MIN_ON_ROAD,
) -> float:
    """Share of firings without a return, of those between two returns of a smooth surface.

    Only the half of the sectors with the smallest shares counts. The share is not that of all
    missing returns, because holes need a return on either side; see `_share_left_out`.
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
    """Range that each laser measured at each firing, metres; 0: no return."""
    reach = np.zeros(firings.answered.size)
    reach[firings.cells] = distance[firings.rows]
    return reach.reshape(firings.answered.shape)


def _share_left_out(reach: NDArray[np.float64]) -> float:
    """Share of missing returns of a smooth near surface; the median over the sectors.

    A firing without a return counts if it lies between two returns of its laser on the same
    surface, at most `WIDEST_HOLE` firings apart.
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
    """Return whether the highest eighth of the lasers has hardly any returns.

    Parameters
    ----------
    firings : Firings
    """
    highest = firings.answered[: max(1, len(firings.answered) // 8)]
    return bool(np.count_nonzero(highest) < MIN_OF_HIGHEST * highest.size)


def silent_at_the_ends(firings: Firings, lattice: SensorLattice) -> tuple[int, int]:
    """Count lasers without returns at the top and bottom, as in a file that ends too early.

    The next laser must have many returns. MIN_ANSWERED was chosen for KITTI's scanner; the lowest
    lasers of another HDL-64E may mostly meet its own carrier, so that only lasers without any
    return count there, and those of other scanners may always do, so that none are counted. If the
    highest eighth of the lasers is silent, upright objects were removed, not lasers.

    Parameters
    ----------
    firings : Firings
        Firings of the turn.
    lattice : SensorLattice
        Lattice of the scanner.

    Returns
    -------
    highest, lowest : int
    """
    if not is_hdl64e(lattice):
        return 0, 0
    answered = firings.answered.mean(axis=1)
    is_heard = answered >= MIN_ANSWERED if is_unit_of_kitti(lattice) else answered > 0.0
    heard = np.flatnonzero(is_heard)
    if not len(heard):
        return 0, 0
    top, last = int(heard[0]), int(heard[-1])
    bottom = len(answered) - 1 - last
    is_top = answered[top] > ANSWERED_BESIDE and not highest_are_silent(firings)
    return top if is_top else 0, bottom if answered[last] > ANSWERED_BESIDE else 0
