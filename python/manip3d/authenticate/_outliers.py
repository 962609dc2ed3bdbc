"""Recognise filters of outliers by the distances of isolated points from their neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core

if TYPE_CHECKING:
    from numpy.typing import NDArray


SPARSE = (4, 0.24, 0.012, 2.0, 2)
"""Options of `_core.sparse_distances`: number of neighbours; least distance from a neighbour,
metres, and as a share of the range (twice the spacing of two firings of a laser, so that only
isolated points count, not the far end of a wall); largest distance of the search, metres; one in
this many points is searched for."""

_FAR = 1000.0
"""Metres: points with larger coordinates are no returns."""

CUT_BELOW, CUT_ABOVE, MIN_ABOVE, MAX_CUT = 0.8, 1.25, 40, (8.0, 7.0, 7.0, 5.5)
"""Filters of outliers remove points whose neighbours are farther than some distance d, so that
hardly any points remain beyond it. The test compares the number of isolated points whose neighbour
is farther than CUT_BELOW d (at least MIN_ABOVE points) with the number of those whose neighbour is
farther than CUT_ABOVE d plus `PRIOR_CUT`, for the first to the fourth neighbour; a ratio above
MAX_CUT shows a filter. For the fourth neighbour and any d, the ratio is at most 3.7 in 53 clean
frames of KITTI, and at least 6 after most filters. For the first to the third neighbour, which
reveal filters that require one or two neighbours, it is at most 4.6, 3.6 and 3.9. This holds for
whole frames of an HDL-64E only: the ratio is 10 in the clean court of a Hesai QT64, up to 7.8 in
frames cropped at 40 m, and 6.2 in three quarters of a turn."""

SOFT_CUT, MAX_SOFT = (0.26, 0.5), 3.5
"""Filters that compare distances with their mean, or count neighbours, leave some isolated points,
but fewer the more isolated they are. The test compares the number of points that are farther from
their first to fourth neighbour than SOFT_CUT[0] metres with that of points farther than SOFT_CUT[1]
plus `PRIOR_SOFT`; a ratio above MAX_SOFT shows a filter. The ratio is at most 2.7 in 8 clean frames
of KITTI and in 38 of simulated streets, which chose the limit, and at least 4 after most
filters."""

PRIOR_CUT, PRIOR_SOFT = 2.0, 5.0
"""Added to the second number of each test, so that a few points do not make a large ratio."""

FAR_CUT, MAX_SOFT_FAR, MAX_CUT_FAR = 60.0, 5.0, 2.0
"""If no points lie beyond FAR_CUT metres or a larger distance, the limits are MAX_SOFT_FAR and
MAX_CUT_FAR times `MAX_CUT`: a filter may be the reason, too. The eight frames, cut at 60 m, reach
a ratio of 2.9 and a multiple of 1; cut to a box of 51 m to each side, a ratio of 3.8."""

_ENDS = np.geomspace(SPARSE[1] / CUT_BELOW, SPARSE[3] / CUT_ABOVE, 60)
"""Metres: distances from a neighbour at which a filter may end the distances of a scan."""


def why_filtered(points: NDArray[np.float32], *, is_short: bool) -> str | None:
    """Return in words why the scan went through a filter of outliers; None if it did not.

    Parameters
    ----------
    points : (N, 3) float32
        Points, preferably in the order of the scanner, which is faster.
    is_short : bool
        Whether the farthest points are missing, which may also be due to a cut.

    Returns
    -------
    str or None
        None: the distances of isolated points from their neighbours are those of clean scans.
    """
    if is_short and np.linalg.norm(points.astype(np.float64), axis=1).max() < FAR_CUT:
        return None
    distances = lone_distances(points)
    soft = max(_softness(each) for each in distances)
    cuts = zip(map(sharpest_end, distances), MAX_CUT, strict=True)
    excess, beyond = max((ratio / most, beyond) for (ratio, beyond), most in cuts)
    if excess > (MAX_CUT_FAR if is_short else 1.0):
        return f"hardly any point is farther than {beyond:.1f} m from its neighbours"
    if soft > (MAX_SOFT_FAR if is_short else MAX_SOFT):
        return f"few points are farther than {SOFT_CUT[1]:g} m from their neighbours"
    return None


def lone_distances(points: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return the distances of isolated points from their nearest neighbours, see `SPARSE`.

    Parameters
    ----------
    points : (N, 3) float32
        Points, preferably in the order of the scanner, which is faster.

    Returns
    -------
    list of (M,) float32
        For the first to the last neighbour: distances in metres, ascending.
    """
    if len(points) and max(points.max(), -points.min()) >= _FAR:
        points = points[np.abs(points).max(axis=1) < _FAR]
    return [np.sort(each) for each in _core.sparse_distances(np.ascontiguousarray(points), *SPARSE)]


def sharpest_end(distances: NDArray[np.float32]) -> tuple[float, float]:
    """Return how sharply the distances of isolated points from a neighbour end, and where.

    Parameters
    ----------
    distances : (M,) float32
        Distances in metres, ascending.

    Returns
    -------
    ratio, distance : float
        The largest ratio, over all distances, of the number of points farther than 0.8 of the
        distance to the number farther than 1.25 of it plus `PRIOR_CUT` (0 if there are too few
        points), and that distance in metres.
    """
    above = len(distances) - np.searchsorted(distances, CUT_BELOW * _ENDS)
    beyond = len(distances) - np.searchsorted(distances, CUT_ABOVE * _ENDS)
    ratio = np.where(above >= MIN_ABOVE, above / (beyond + PRIOR_CUT), 0.0)
    sharpest = int(ratio.argmax())
    return float(ratio[sharpest]), float(_ENDS[sharpest])


def _softness(distances: NDArray[np.float32]) -> float:
    """Ratio of the number above SOFT_CUT[0] to that above SOFT_CUT[1] with `PRIOR_SOFT` added."""
    first, second = (len(distances) - np.searchsorted(distances, end) for end in SOFT_CUT)
    return float(first / (second + PRIOR_SOFT)) if first >= MIN_ABOVE else 0.0
