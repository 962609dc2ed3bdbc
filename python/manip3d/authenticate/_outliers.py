"""Filters of outliers: how the distances of lone points from their neighbours end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core

if TYPE_CHECKING:
    from numpy.typing import NDArray


SPARSE = (4, 0.24, 0.012, 2.0, 2)
"""Number of the last neighbour; metres, and the share of the range, from which distances count: it
is twice as far as the firings of one laser lead, so that only points that stand alone count, not
the far end of a wall; metres up to which it is looked for; one point in so many is."""

_FAR = 1000.0
"""Metres: stray coordinates farther away are not returns."""

CUT_BELOW, CUT_ABOVE, LEAST_ABOVE, MOST_CUT = 0.8, 1.25, 40, (8.0, 7.0, 7.0, 5.5)
"""Shares of a distance, points, ratios of the first to the fourth neighbour. Filters of outliers
leave out points whose neighbours are farther than some distance, so that hardly any is left beyond
it. Points that stand alone with the fourth neighbour farther than 0.8 of a distance are at most 3.7
times as many as those with it farther than 1.25 of it in 53 clean frames of KITTI, whatever the
distance is, and 6 times and more after most filters. With the first to the third neighbour they are
at most 4.6, 3.6 and 3.9 times as many; filters that ask for one or two neighbours show there. It
holds for whole frames of an HDL-64E only: it is 10 in the clean court of a Hesai QT64, up to 7.8 in
frames that were cropped at 40 m and 6.2 in three quarters of a turn."""

SOFT_CUT, MOST_SOFT = (0.26, 0.5), 3.5
"""Metres, a ratio. Filters that set the distances against their mean, or count neighbours, leave
some points that stand alone, but fewer the farther they are from their neighbours. Points farther
from the first to the fourth neighbour than the first distance are at most 2.7 times as many as
those farther than the second one in 8 clean frames of KITTI and in 38 of simulated streets, which
chose the limit, and 4 times and more after most filters."""

FAR_CUT, MOST_SOFT_FAR, MOST_CUT_FAR = 60.0, 5.0, 2.0
"""Metres, the same ratio, and a multiple of `MOST_CUT`, where nothing lies beyond 60 m or more, as
a filter may leave a scan, too. The eight frames cut at 60 m reach 2.9 and 1, and cut to a box of
51 m to each side 3.8."""


def why_filtered(points: NDArray[np.float32], *, is_short: bool) -> str | None:
    """Say how the distances between points end if they end as a filter of outliers leaves them.

    Parameters
    ----------
    points : (N, 3) float32
        In the order of the scanner, which makes it quick.
    is_short : bool
        Nothing lies as far as the scanner measures, as other cuts leave a scan, too.

    Returns
    -------
    str or None
        None: lone points are as far from their neighbours as they are in clean scans.
    """
    if is_short and np.linalg.norm(points.astype(np.float64), axis=1).max() < FAR_CUT:
        return None
    distances = lone_distances(points)
    soft = max(_softness(each) for each in distances)
    cuts = zip(map(sharpest_end, distances), MOST_CUT, strict=True)
    excess, beyond = max((ratio / most, beyond) for (ratio, beyond), most in cuts)
    if excess > (MOST_CUT_FAR if is_short else 1.0):
        return f"hardly any point is farther than {beyond:.1f} m from its neighbours"
    if soft > (MOST_SOFT_FAR if is_short else MOST_SOFT):
        return f"few points are farther than {SOFT_CUT[1]:g} m from their neighbours"
    return None


def lone_distances(points: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return the distances of lone points from their first to their last neighbour of `SPARSE`.

    Parameters
    ----------
    points : (N, 3) float32
        In the order of the scanner, which makes it quick.

    Returns
    -------
    list of (M,) float32
        Metres, ascending.
    """
    if len(points) and max(points.max(), -points.min()) >= _FAR:
        points = points[np.abs(points).max(axis=1) < _FAR]
    return [np.sort(each) for each in _core.sparse_distances(np.ascontiguousarray(points), *SPARSE)]


def sharpest_end(distances: NDArray[np.float32]) -> tuple[float, float]:
    """Return how sharply distances of lone points from a neighbour end, and where.

    Parameters
    ----------
    distances : (M,) float32
        Metres, ascending.

    Returns
    -------
    ratio, distance : float
        Points farther from the neighbour than 0.8 of the distance (metres), to those farther than
        1.25 of it, where this is largest. 0 where there are too few of them.
    """
    at = np.geomspace(SPARSE[1] / CUT_BELOW, SPARSE[3] / CUT_ABOVE, 60)
    above = len(distances) - np.searchsorted(distances, CUT_BELOW * at)
    beyond = len(distances) - np.searchsorted(distances, CUT_ABOVE * at)
    ratio = np.where(above >= LEAST_ABOVE, above / (beyond + 2.0), 0.0)
    sharpest = int(ratio.argmax())
    return float(ratio[sharpest]), float(at[sharpest])


def _softness(distances: NDArray[np.float32]) -> float:
    """How many times as many distances exceed the first of `SOFT_CUT` as the second one."""
    first, second = (len(distances) - np.searchsorted(distances, end) for end in SOFT_CUT)
    return float(first / (second + 5.0)) if first >= LEAST_ABOVE else 0.0
