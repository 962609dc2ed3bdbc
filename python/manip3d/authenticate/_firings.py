"""Firings of a scanner: which lasers answered, and the silence beside a cut."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading

OFF_LATTICE = 0.002
"""Metres from a line or a step: what lies farther is of no firing."""

FARTHEST_POINTS, LEAST_SILENT_FAR = 500, 0.25
"""Points; share of them with a neighbour in the lasers or the firings that has no return. Of frames
of KITTI that were cut at 12 to 78 m 0.43 and more have one, because what they saw was cut off; of
frames in halls, garages and narrow courts 0.03 at most, and 0.12 in tunnels: walls answer around
their farthest points."""

FACE, MOST_ON_FACE = 0.05, 50
"""Metres, points: where a frame was cut at a height, many points lie next to the cut; the lowest
and highest 5 cm of KITTI's whole frames hold 42 at most. A flat street has many, too, and one in 25
ends at a round height by chance."""

ROUND_HEIGHT, OFF_ROUND = 0.1, 0.002
"""Metres: heights that people cut at, and how near to the cut the next point lies."""

MOST_ANYWHERE = 200
"""Points on a face at another height, which only tell of a cut where firings are known."""

CUT_EDGES, FEWEST_AT_EDGE, LEAST_SILENT = (0.005, 0.01, 0.02, FACE), 20, 0.4
"""Metres, points, share: of the points so near to a cut at the top (in the narrowest of the bands
with enough of them), many have a neighbour in the lasers or the firings that was cut off."""

STEEP, BEYOND_OWN_CAR, LEAST_SILENT_BESIDE = 5.0, 8.0, 0.12
"""Degrees below the horizon, metres, share: where lasers meet the ground so steeply, and beyond the
scanner's own car, a road answers nearly every pulse. Of the lowest points there, at a cut through
the ground, many have a neighbour to a side that was cut off. Farther away a hollow of the road is
met too flatly to answer; in the lasers above and below silence is that of a dark car on the road.
Of 50 frames of five flat simulated streets 0.05 at most have one, of KITTI's frames cut at 1 to
1.9 m below the scanner 0.21 and more; where a cut takes a few hollows only, it can stay below."""

LEAST_SILENT_LOWER, DEGREES, FEWEST_PLACES = 0.6, 5.0, 4
"""Share; degrees of azimuth, number: what is cut off above the ground leaves the lasers below the
lowest points silent, however far these are, in several sectors. It is 0.64 to 1, in at least five
of them, of KITTI's frames cut 1.3 m below the scanner to 0.3 m above it. In flat simulated streets
it is 0.43 at most, but for the end of a road 35 m away, in two sectors."""

Neighbours: TypeAlias = tuple[tuple[int, int], ...]

LOWER: Neighbours = ((1, 0),)
SIDES: Neighbours = ((0, -1), (0, 1))
ALL_SIDES: Neighbours = (*SIDES, *LOWER, (-1, 0))
"""Neighbours of a point: lasers downwards, firings onwards."""


class Firings(NamedTuple):
    """Which lasers answered at which firings.

    Attributes
    ----------
    answered : (rings, F) bool
    firing : (N,) int64
        Firing that each point belongs to; -1: none.
    ring : (N,) int32
        Laser of each point.
    cells, rows : (M,) int64
        Places in ``answered``, row after row, of the points on a firing, and their rows.
    """

    answered: NDArray[np.bool_]
    firing: NDArray[np.int64]
    ring: NDArray[np.int32]
    cells: NDArray[np.int64]
    rows: NDArray[np.intp]


def firings_of(reading: LatticeReading, rings: int) -> Firings | None:
    """Return the firings of the head; None: the lattice has no encoder, or no point is on it."""
    on = (reading.ring >= 0) & (reading.count >= 0)
    on &= (np.abs(reading.line_error) < OFF_LATTICE) & (np.abs(reading.step_error) < OFF_LATTICE)
    rows = np.flatnonzero(on)
    if not len(rows):
        return None
    count = reading.count[rows]
    votes = np.bincount(count)
    around = np.max([np.roll(votes, k) for k in range(-2, 3)], axis=0)
    fired = (votes > 0) & (votes >= 0.6 * around)
    of_row = np.where(fired, np.cumsum(fired) - 1, -1)[count]
    firing = np.full(len(reading.ring), -1)
    firing[rows] = of_row
    rows, of_row = rows[of_row >= 0], of_row[of_row >= 0]
    answered = np.zeros((rings, int(np.count_nonzero(fired))), np.bool_)
    cells = reading.ring[rows] * np.int64(answered.shape[1]) + of_row
    answered.reshape(-1)[cells] = True
    return Firings(answered, firing, reading.ring, cells, rows)


def is_cut_above(height: NDArray[np.float64], firings: Firings | None) -> bool:
    """Return whether points end at a height because what lay above it was cut off.

    Parameters
    ----------
    height : (N,) float64, metres
    firings : Firings or None
        None: firings are not known, and the points at the edge say it alone.
    """
    if not _ends_in_a_face(height, firings):
        return False
    if firings is None:
        return True
    edge = _edge(height, firings.firing >= 0)
    return len(edge) >= FEWEST_AT_EDGE and _share_beside_silence(edge, firings) >= LEAST_SILENT


def is_cut_below(points: NDArray[np.float64], firings: Firings | None) -> bool:
    """Return whether points end at a height because what lay below it was cut off.

    Parameters
    ----------
    points : (N, 3) float64, metres
        The scanner in (0, 0, 0).
    firings : Firings or None
        None: firings are not known, and the points at the edge say it alone.
    """
    x, y, z = points.T
    if not _ends_in_a_face(-z, firings):
        return False
    if firings is None:
        return True
    away = np.sqrt(x * x + y * y)
    fired = firings.firing >= 0
    steep = fired & (-z > math.tan(math.radians(STEEP)) * away) & (away > BEYOND_OWN_CAR)
    edge = _edge(-z, steep)
    if len(edge) >= FEWEST_AT_EDGE:
        share = float(np.mean(beside_silence(edge, firings, SIDES)))
        if share >= LEAST_SILENT_BESIDE:
            return True
    edge = _edge(-z, fired)
    silent = edge[beside_silence(edge, firings, LOWER)]
    if len(edge) < FEWEST_AT_EDGE or len(silent) < LEAST_SILENT_LOWER * len(edge):
        return False
    sectors = np.floor(np.arctan2(y[silent], x[silent]) * (180.0 / (math.pi * DEGREES)))
    return len(np.unique(sectors)) >= FEWEST_PLACES


def _ends_in_a_face(height: NDArray[np.float64], firings: Firings | None) -> bool:
    """Whether more points lie next to the highest one than a whole frame leaves there."""
    top = float(height.max())
    count = int(np.count_nonzero(height > top - FACE))
    if abs(top - ROUND_HEIGHT * round(top / ROUND_HEIGHT)) < OFF_ROUND:
        return count > MOST_ON_FACE
    return firings is not None and count > MOST_ANYWHERE


def _edge(height: NDArray[np.float64], among: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Rows of the highest points of some: of the narrowest band with enough, or of the widest."""
    top = float(height.max())
    bands = (np.flatnonzero(among & (height > top - band)) for band in CUT_EDGES)
    rows = np.empty(0, np.intp)
    for rows in bands:
        if len(rows) >= FEWEST_AT_EDGE:
            break
    return rows


def ends_in_silence(distance: NDArray[np.float64], firings: Firings | None) -> bool:
    """Return whether nothing stands around the farthest points: what lay beyond was cut off.

    Parameters
    ----------
    distance : (N,) float64, metres
        From the scanner, or along an axis.
    firings : Firings or None
        None: firings are not known, and a whole frame is taken to have points far away.
    """
    if firings is None or len(distance) <= FARTHEST_POINTS:
        return True
    farthest = np.argpartition(distance, -FARTHEST_POINTS)[-FARTHEST_POINTS:]
    farthest = farthest[firings.firing[farthest] >= 0]
    if len(farthest) < FEWEST_AT_EDGE:
        return True
    return _share_beside_silence(farthest, firings) >= LEAST_SILENT_FAR


def _share_beside_silence(edge: NDArray[np.intp], firings: Firings) -> float:
    """Share of points with a neighbour, in lasers or firings, without a return."""
    return float(np.mean(beside_silence(edge, firings, ALL_SIDES)))


def beside_silence(
    edge: NDArray[np.intp], firings: Firings, beside: Neighbours
) -> NDArray[np.bool_]:
    """Return which points have a neighbour, in lasers and firings, without a return.

    Parameters
    ----------
    edge : (M,) int64
        Rows of points that belong to a firing.
    firings : Firings
    beside : tuple of (int, int)
        The neighbours that are looked at: lasers downwards, firings onwards.
    """
    ring, firing = firings.ring[edge], firings.firing[edge]
    rings, count = firings.answered.shape
    surrounded = np.ones(len(edge), np.bool_)
    for lower, on in beside:
        laser = np.clip(ring + lower, 0, rings - 1)
        surrounded &= firings.answered[laser, (firing + on) % count]
    return ~surrounded
