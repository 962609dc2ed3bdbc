"""Firings of a scanner: which lasers had returns, and cuts found by the silence beside them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading

OFF_LATTICE = 0.002
"""Metres: a point farther than this from its line or step belongs to no firing."""

FARTHEST_POINTS, MIN_SILENT_FAR = 500, 0.25
"""A frame was cut at a distance if, of its FARTHEST_POINTS farthest points, at least the share
MIN_SILENT_FAR has a neighbouring laser or firing without a return. In frames of KITTI that were
cut at 12 to 78 m the share is at least 0.43, because their neighbours' returns were cut off. In
frames of halls, garages and narrow courts it is at most 0.03, and in tunnels 0.12, because walls
surround the farthest points."""

FACE, MAX_ON_FACE = 0.05, 50
"""A frame that was cut at a height has more than MAX_ON_FACE points within FACE metres of the cut;
the lowest and the highest 5 cm of KITTI's whole frames hold at most 42. A flat street has many
points there as well, and one in 25 ends at a round height by chance."""

ROUND_HEIGHT, OFF_ROUND = 0.1, 0.002
"""Metres: people cut at multiples of ROUND_HEIGHT, and the point nearest to the cut is less than
OFF_ROUND from it."""

MAX_ANYWHERE = 200
"""Largest number of points on a face at a height that is not round, without a cut. Such a face
counts only if firings are known."""

CUT_EDGES, MIN_AT_EDGE, MIN_SILENT = (0.005, 0.01, 0.02, FACE), 20, 0.4
"""The edge of a cut is the narrowest of the bands CUT_EDGES, metres, with at least MIN_AT_EDGE
points. At a cut at the top at least the share MIN_SILENT of these points has a neighbouring laser
or firing without a return, since it was cut off."""

MIN_PLACES_BELOW_SILENCE = 6
"""A frame of KITTI was also cut at the top if more than MAX_ON_FACE points are on the face, and if
those below a laser without a return lie in at least this many sectors of DEGREES degrees of
azimuth. In whole frames there is none (21 frames of six drives, and 40 simulated streets), because
the highest laser has the highest returns. The number was chosen on eight frames of drives 0005 and
a, and two others: with it, 110 of 110 cuts at 0 to 0.6 m and 100 of 100 at 0.6 to 1.2 m are found,
and 107 and 83 without it. In eight frames of drives 0002 and b, and three others, 120 of 121 and
107 of 110 are found, and 120 and 77 without it."""

STEEP, BEYOND_OWN_CAR, MIN_SILENT_BESIDE = 5.0, 8.0, 0.12
"""A cut through the ground is searched for among points more than STEEP degrees below the horizon
and more than BEYOND_OWN_CAR metres away, beyond the scanner's own car: a road returns nearly every
pulse there. The ground was cut if at least the share MIN_SILENT_BESIDE of the lowest of these
points has a neighbouring firing without a return. At flatter angles a hollow of the road returns
nothing, and neighbouring lasers are not used because dark cars on the road silence them. The share
is at most 0.05 in 50 frames of five flat simulated streets, and at least 0.21 in KITTI's frames cut
1 to 1.9 m below the scanner; it can be smaller if a cut removes only a few hollows."""

MIN_SILENT_LOWER, DEGREES, MIN_PLACES = 0.6, 5.0, 4
"""A cut above the ground silences the lasers below the lowest points, at any distance: it is found
if at least the share MIN_SILENT_LOWER of these points has no return in the laser below, in at
least MIN_PLACES sectors of DEGREES degrees of azimuth. In KITTI's frames cut 1.3 m below the
scanner to 0.3 m above it the share is 0.64 to 1, in at least five sectors. In flat simulated
streets it is at most 0.43, except at the end of a road 35 m away, which spans two sectors."""

MORE_LOST_BESIDE = 3.0
"""Rain, snow, fog and wet roads silence single firings, too, and more of them the farther away the
road is: on average 7 m where single missing returns are counted, and 8 to 20 m where cuts are
searched for on level ground. Their share, times MORE_LOST_BESIDE, is therefore allowed for in
MIN_SILENT_BESIDE and MIN_SILENT_LOWER."""

Neighbours: TypeAlias = tuple[tuple[int, int], ...]

LOWER: Neighbours = ((1, 0),)
UPPER: Neighbours = ((-1, 0),)
SIDES: Neighbours = ((0, -1), (0, 1))
ALL_SIDES: Neighbours = (*SIDES, *LOWER, *UPPER)
"""Neighbours of a point as offsets: number of lasers downwards, number of firings onwards."""


class Firings(NamedTuple):
    """Firings of a turn, and the lasers that had returns at each.

    Attributes
    ----------
    answered : (rings, F) bool
        Whether the laser has a return at the firing.
    firing : (N,) int64
        Firing that each point belongs to; -1: none.
    ring : (N,) int32
        Laser of each point.
    cells, rows : (M,) int64
        Flat indices into ``answered`` of the points that belong to a firing, and their rows.
    """

    answered: NDArray[np.bool_]
    firing: NDArray[np.int64]
    ring: NDArray[np.int32]
    cells: NDArray[np.int64]
    rows: NDArray[np.intp]


def firings_of(reading: LatticeReading, rings: int) -> Firings | None:
    """Return the firings of a turn; None if the lattice has no encoder, or no point is on it."""
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
    if (of_row < 0).any():
        rows, of_row = rows[of_row >= 0], of_row[of_row >= 0]
    answered = np.zeros((rings, int(np.count_nonzero(fired))), np.bool_)
    cells = reading.ring[rows] * np.int64(answered.shape[1]) + of_row
    answered.reshape(-1)[cells] = True
    return Firings(answered, firing, reading.ring, cells, rows)


def is_cut_above(
    points: NDArray[np.float64], firings: Firings | None, *, sees_horizon: bool = False
) -> bool:
    """Return whether points above a height were cut off.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Points with the scanner at (0, 0, 0).
    firings : Firings or None
        None: firings are unknown; only the number of points at the edge decides.
    sees_horizon : bool
        Whether the highest laser is near the horizon, as that of KITTI's scanner: few scenes then
        end below it.
    """
    height = points[:, 2]
    if sees_horizon and firings is not None:
        face = np.flatnonzero((firings.firing >= 0) & (height > height.max() - FACE))
        silent = face[beside_silence(face, firings, UPPER)]
        if len(face) > MAX_ON_FACE and _places(points[silent]) >= MIN_PLACES_BELOW_SILENCE:
            return True
    if not _ends_in_a_face(height, firings):
        return False
    if firings is None:
        return True
    edge = _edge(height, firings.firing >= 0)
    return len(edge) >= MIN_AT_EDGE and _share_beside_silence(edge, firings) >= MIN_SILENT


def is_cut_below(
    points: NDArray[np.float64], firings: Firings | None, *, lost: float = 0.0
) -> bool:
    """Return whether points below a height were cut off.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Points with the scanner at (0, 0, 0).
    firings : Firings or None
        None: firings are unknown; only the number of points at the edge decides.
    lost : float
        Share of returns near the scanner that are missing one by one everywhere.
    """
    heard = max(0.0, 1.0 - MORE_LOST_BESIDE * lost)  # share of firings that single losses leave
    x, y, z = points.T
    if not _ends_in_a_face(-z, firings):
        return False
    if firings is None:
        return True
    away = np.sqrt(x * x + y * y)
    fired = firings.firing >= 0
    steep = fired & (-z > math.tan(math.radians(STEEP)) * away) & (away > BEYOND_OWN_CAR)
    edge = _edge(-z, steep)
    if len(edge) >= MIN_AT_EDGE:
        share = float(np.mean(beside_silence(edge, firings, SIDES)))
        if share >= 1.0 - (1.0 - MIN_SILENT_BESIDE) * heard * heard:
            return True
    edge = _edge(-z, fired)
    silent = edge[beside_silence(edge, firings, LOWER)]
    least = 1.0 - (1.0 - MIN_SILENT_LOWER) * heard
    if len(edge) < MIN_AT_EDGE or len(silent) < least * len(edge):
        return False
    return _places(points[silent]) >= MIN_PLACES


def _places(points: NDArray[np.float64]) -> int:
    """Number of sectors of DEGREES degrees of azimuth with points."""
    angles = np.arctan2(points[:, 1], points[:, 0])
    return len(np.unique(np.floor(angles * (180.0 / (math.pi * DEGREES)))))


def _ends_in_a_face(height: NDArray[np.float64], firings: Firings | None) -> bool:
    """Whether more points lie next to the highest one than in a whole frame."""
    top = float(height.max())
    count = int(np.count_nonzero(height > top - FACE))
    if abs(top - ROUND_HEIGHT * round(top / ROUND_HEIGHT)) < OFF_ROUND:
        return count > MAX_ON_FACE
    return firings is not None and count > MAX_ANYWHERE


def _edge(height: NDArray[np.float64], among: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Rows of the highest points ``among`` all: the narrowest band with enough, else the widest."""
    top = float(height.max())
    bands = (np.flatnonzero(among & (height > top - band)) for band in CUT_EDGES)
    rows = np.empty(0, np.intp)
    for rows in bands:
        if len(rows) >= MIN_AT_EDGE:
            break
    return rows


def ends_in_silence(distance: NDArray[np.float64], firings: Firings | None) -> bool:
    """Return whether silence beside the farthest points shows that points beyond were cut off.

    Parameters
    ----------
    distance : (N,) float64, metres
        Distance of each point from the scanner, or along an axis.
    firings : Firings or None
        None: firings are unknown, and the frame counts as cut, because whole frames reach farther.
    """
    if firings is None or len(distance) <= FARTHEST_POINTS:
        return True
    farthest = np.argpartition(distance, -FARTHEST_POINTS)[-FARTHEST_POINTS:]
    farthest = farthest[firings.firing[farthest] >= 0]
    if len(farthest) < MIN_AT_EDGE:
        return True
    return _share_beside_silence(farthest, firings) >= MIN_SILENT_FAR


def _share_beside_silence(edge: NDArray[np.intp], firings: Firings) -> float:
    """Share of points with a neighbouring laser or firing without a return."""
    return float(np.mean(beside_silence(edge, firings, ALL_SIDES)))


def beside_silence(
    edge: NDArray[np.intp], firings: Firings, beside: Neighbours
) -> NDArray[np.bool_]:
    """Return which points have a neighbouring laser or firing without a return.

    Parameters
    ----------
    edge : (M,) int64
        Rows of points that belong to a firing.
    firings : Firings
    beside : tuple of (int, int)
        Neighbours to test, as offsets: lasers downwards, firings onwards.
    """
    ring, firing = firings.ring[edge], firings.firing[edge]
    rings, count = firings.answered.shape
    surrounded = np.ones(len(edge), np.bool_)
    for lower, on in beside:
        laser = np.clip(ring + lower, 0, rings - 1)
        surrounded &= firings.answered[laser, (firing + on) % count]
    return ~surrounded
