"""Find points that were left out one by one of an exact cloud, from the gaps along its rings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._silences import WHY_MISSING
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading, SensorLattice

NEAR, SAME_SURFACE = 10.0, 0.02
"""Two successive points of a ring see the same surface if they are nearer than NEAR metres, at
distances that differ by less than the share SAME_SURFACE. Surfaces within NEAR rarely lose single
returns, and filters of voxels of 10 cm leave out most of their points."""

SECTORS, MIN_OF_SECTOR, MIN_SECTORS = 16, 50, 4
"""Number of sectors of the horizon, fewest pairs of successive points of a sector that counts, and
fewest such sectors. Points that are left out everywhere are missing in most sectors, and dark
surfaces lose returns in some."""

MAX_MISSING = 0.1
"""Points were left out if, in the median of the sectors, more than this share of the successive
points of a ring on one surface has one firing between them. The share is at most 0.031 in 21 clean
simulated clouds of seven scanners (streets, open land, halls) that lose 1 % of the returns, and at
least 0.15 in these without a fifth of their points, half or seven tenths of them, or with one point
in each voxel of 10 cm. In real clouds of five scanners by Hesai and Ouster it is at most 0.008, and
at least 0.15 after the same changes."""

MIN_BETWEEN = 0.02
"""Firings are closer than the most frequent gap if more than this share of the gaps shows it."""


def thinned_exactly(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading | None
) -> list[Processing]:
    """Return whether points of an exact cloud were left out one by one, everywhere.

    Parameters
    ----------
    points : (N, 3) float32
        Points with the scanner at the origin.
    lattice : SensorLattice
        Exact lattice of the scanner; without steps of azimuth nothing is found.
    reading : LatticeReading or None
        Places of the points on the lattice; None: they are computed here.
    """
    if not lattice.steps:
        return []
    share = _share_missing(points, lattice, lattice.read(points) if reading is None else reading)
    if share <= MAX_MISSING:
        return []
    detail = f"{share:.0%} of the returns of near surfaces are missing one by one ({WHY_MISSING})"
    return [Processing("thinned", detail)]


def _share_missing(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading
) -> float:
    """Share of pairs of successive points with one firing between them; 0: too few pairs."""
    error = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error))
    rows = np.flatnonzero((reading.ring >= 0) & (reading.count >= 0) & (error <= lattice.tolerance))
    rows = rows[np.lexsort((reading.count[rows], reading.ring[rows]))]
    apart = np.diff(reading.count[rows])
    pairs = np.flatnonzero((np.diff(reading.ring[rows]) == 0) & (apart > 0))
    if not len(pairs):
        return 0.0
    spacing = _spacing(apart[pairs])
    rho = np.hypot(*points[rows, :2].astype(np.float64).T)
    pairs = pairs[rho[pairs] < NEAR]
    pairs = pairs[np.abs(rho[pairs + 1] - rho[pairs]) < SAME_SURFACE * rho[pairs]]
    firings = np.rint(apart[pairs] / spacing)
    turns = reading.azimuth[rows[pairs]].astype(np.float64) / (2.0 * math.pi)
    sector = (turns * SECTORS).astype(np.intp).clip(0, SECTORS - 1)
    beside = np.bincount(sector[firings == 1.0], minlength=SECTORS)
    missing = np.bincount(sector[firings == 2.0], minlength=SECTORS)
    counts = beside + missing >= MIN_OF_SECTOR
    if np.count_nonzero(counts) < MIN_SECTORS:
        return 0.0
    return float(np.median(missing[counts] / (beside + missing)[counts]))


def _spacing(apart: NDArray[np.intp]) -> int:
    """Steps between neighbouring firings of a laser: the most frequent gap, or a part of it.

    Where every other point was left out the most frequent gap is two firings, of which the gaps at
    missing returns are no multiple.
    """
    spacing = int(np.bincount(apart).argmax())
    for parts in (4, 3, 2):
        finer = spacing // parts
        needs_it = (apart % spacing != 0) & (apart % max(finer, 1) == 0)
        if spacing % parts == 0 and needs_it.mean() > MIN_BETWEEN:
            return finer
    return spacing
