"""Find bands of range, height or elevation that were cut out of a turn all around the scanner."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._firings import ALL_SIDES, SIDES, beside_silence
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._firings import Firings, Neighbours


class _Axis(NamedTuple):
    """A coordinate along which bands may have been cut out."""

    words: str  # description of a band, with the places of both of its ends
    cell: float  # width of the cells in which points are counted
    narrowest: int  # least number of empty cells
    beside: Neighbours  # neighbours of the points at an end that a cut silences
    min_silent: float  # least share of the points at either end with a silent neighbour
    lasers: int  # least number of lasers that have these points
    sectors: int  # least number of the `SECTORS` sectors of the turn that have these points
    max_ragged: float = 1.0  # largest share of these points beside a silent firing


RANGES = _Axis("no points from {:.1f} to {:.1f} m", 0.1, 2, SIDES, 0.2, 3, 6)
HEIGHTS = _Axis("no points at heights from {:.2f} to {:.2f} m", 0.02, 2, SIDES, 0.2, 3, 6)
"""Ranges and heights. A band that was cut out silences firings beside those that met both of its
ends, while a gap between the rings on a level road does not. In 22 whole frames (KITTI's drives
0002 and a, six simulated streets), which chose the limits, two gaps have MIN_BESIDE points on
either side, and of at most 3 % of the points at their ends a neighbouring firing is silent. In 37
other frames (31 of KITTI) no gap has as many points beside it. Of gaps with fewer points the share
is at most 25 %. Where bands of ranges of 0.5 to 2 m and heights of 0.1 to 0.5 m were cut out of
frames of both, it is 23 % to 95 % in nearly all. Points at an end are of three lasers at least,
because a ring alone on open ground may lose returns anywhere. They lie in six sectors at
least: in 9 to 26 where bands were cut out of three frames of KITTI, but in 4 where dark ground ends
and a tree stands beyond. In ten frames that did not choose the limits, all of 40 bands of ranges of
6 to 31 m and 28 of 30 of heights are found; heights above the scanner, hardly any."""

ELEVATIONS = _Axis(
    "no points at elevations from {:.1f} to {:.1f} degrees", 0.1, 8, ALL_SIDES, 0.6, 1, 1, 0.75
)
"""Elevations. Neighbouring lasers of an HDL-64E are at most 0.6 degrees apart. Gaps of 0.8 degrees
and more with MIN_BESIDE points on either side are in none of these frames; where bands of 1 and 2
degrees were cut out, at least 70 % of the points at their ends are beside silence. Such a cut
follows the lasers, so that a firing beside them is silent at no more than 57 % of the points. Where
dark or wet ground ends far away, and trees or houses stand beyond, it is at 93 % at least, because
each laser loses single returns there."""

FARTHEST = 50.0
"""Metres: filters of outliers leave gaps beyond, which are not judged."""

MIN_BESIDE, AT_END = 100, 40
"""MIN_BESIDE: least number of points in bands of the same width on either side of an empty band.
AT_END: number of points at either end that are tested for silence."""

SECTORS = 72
"""Number of sectors of a turn, of 5 degrees."""


def empty_bands(
    points: NDArray[np.float64],
    distance: NDArray[np.float64],
    firings: Firings,
    *,
    elevations: bool = True,
) -> list[Processing]:
    """Find bands without points between bands of the same width that have many.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Points with the scanner at (0, 0, 0).
    distance : (N,) float64, metres
        Distance of each point from the scanner.
    firings : Firings
        Firings of the turn.
    elevations : bool
        Whether to look for bands of elevation; missing lasers leave such bands, too.
    """
    fired = np.flatnonzero((firings.firing >= 0) & (distance < FARTHEST))
    height, reach = points[fired, 2], distance[fired]
    along = [(RANGES, reach), (HEIGHTS, height)]
    if elevations:
        along.append((ELEVATIONS, np.degrees(np.arcsin(height / reach))))
    return [
        Processing("cropped", axis.words.format(*band))
        for axis, values in along
        for band in _bands_along(values, axis, fired, firings)
    ]


def _bands_along(
    values: NDArray[np.float64], axis: _Axis, rows: NDArray[np.intp], firings: Firings
) -> list[tuple[float, float]]:
    """Both ends of each band that was cut out."""
    if not len(values):
        return []
    least = float(values.min())
    cell = ((values - least) * (1.0 / axis.cell)).astype(np.intp)
    below = np.r_[0, np.cumsum(np.bincount(cell))]
    filled = np.flatnonzero(np.diff(below))
    found = []
    for k in np.flatnonzero(np.diff(filled) > axis.narrowest):
        first, last = int(filled[k]) + 1, int(filled[k + 1])  # empty cells: first to last - 1
        width = last - first
        count_below = below[first] - below[max(0, first - width)]
        count_above = below[min(last + width, len(below) - 1)] - below[last]
        if min(count_below, count_above) < MIN_BESIDE:
            continue
        near = np.flatnonzero((cell >= first - width) & (cell < last + width))
        near = near[np.argsort(values[near], kind="stable")]
        upper = int(np.searchsorted(cell[near], first))
        ends = near[max(0, upper - AT_END) : upper], near[upper : upper + AT_END]
        if all(_is_cut(rows[end], axis, firings) for end in ends):
            found.append((float(values[near[upper - 1]]), float(values[near[upper]])))
    return found


def _is_cut(end: NDArray[np.intp], axis: _Axis, firings: Firings) -> bool:
    """Whether silence beside the points at one end of a band shows that it was cut out."""
    count = firings.answered.shape[1]
    if len(np.unique(firings.ring[end])) < axis.lasers:
        return False
    if len(np.unique(firings.firing[end] * SECTORS // count)) < axis.sectors:
        return False
    if np.mean(beside_silence(end, firings, SIDES)) > axis.max_ragged:
        return False
    return float(np.mean(beside_silence(end, firings, axis.beside))) >= axis.min_silent
