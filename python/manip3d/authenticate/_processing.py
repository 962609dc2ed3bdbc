"""What was done to a scan as a whole: shuffled, rounded, cropped, turned, deskewed?"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._generic import GenericResult
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.authenticate._sensors import Sensor

ROUNDINGS = (0.1, 0.05, 0.02, 0.01, 0.005)
"""Metres that files are rounded to, the coarsest first; scanners write 2 mm and less."""

SAMPLE = 5000
"""Points that are looked at before all are."""

WIDEST_GAP = 10.0
"""Degrees of azimuth without any point. Whole frames of an HDL-64E have 0.2 at most: its lower
lasers always meet the road, or its own car."""

LEAST_RANGE = 75.0
"""Metres: whole frames of KITTI (15 of six drives were looked at) reach to 79.9 m."""

NEAREST_RANGE, LEAST_OF_LOWEST = 2.5, 0.25
"""Metres; share of the firings in which one of the lowest eighth of the lasers must have a return.
Where a scanner's own car does not answer (1.5 m in KITTI), the road does, which the lowest lasers
meet 4 m away; where nothing answers them, what is near was cut off."""

FACE, MOST_ON_FACE = 0.05, 200
"""Metres, points: where a frame was cut at a height, many points lie next to the cut; the lowest
and highest 5 cm of KITTI's whole frames hold 42 at most. A flat street has many, too, and one in 25
ends at a round height by chance."""

ROUND_HEIGHT, OFF_ROUND = 0.1, 0.002
"""Metres: heights that people cut at, and how near to the cut the next point lies."""

CUT_EDGE, FEWEST_AT_EDGE, LEAST_SILENT = 0.005, 20, 0.4
"""Metres, points, share: of the points so near to a cut, many have a neighbour in the lasers or the
firings that was cut off. The lowest points of a street have neighbours that answered."""

FIRST_AZIMUTH = 1.0
"""Degrees from straight ahead at which rings of whole frames begin at most."""

LEAST_FILL = 0.6
"""Share of the firings of the lower half of the lasers that return. Whole frames of KITTI have 0.77
to 0.95, every second point of one 0.48."""


def find_processing(
    points: NDArray[np.float32], sensor: Sensor, generic: GenericResult | None
) -> tuple[Processing, ...]:
    """Say what was done to the scan as a whole; nothing where nothing can be told.

    Parameters
    ----------
    points : (N, 3) float32
    sensor : Sensor
    generic : GenericResult or None
        What detector III says by the sensor's lattice.
    """
    found = list(_of_coordinates(points))
    if sensor.off_lattice > 0.0:
        found.append(
            Processing(
                "moved",
                f"points lie {1000 * sensor.off_lattice:.1f} mm beside the lines of the scanner in "
                "the median: deskewed, averaged, rounded, or noise was added",
            )
        )
    elif generic is not None and generic.lattice is not None:
        found += _of_lattice(points, sensor, generic)
    return tuple(found)


def _of_coordinates(points: NDArray[np.float32]) -> list[Processing]:
    if len(points) == 0:
        return []
    some = points[:: max(1, len(points) // SAMPLE)]
    if _is_float16(some) and _is_float16(points):
        return [Processing("float16", "all coordinates are numbers of 16 bits")]
    for step in ROUNDINGS:
        if _share_rounded(some, step) > 0.99 and _share_rounded(points, step) > 0.999:
            return [Processing("rounded", f"coordinates are whole numbers of {1000 * step:g} mm")]
    return []


def _is_float16(points: NDArray[np.float32]) -> bool:
    with np.errstate(over="ignore"):
        return np.array_equal(points.astype(np.float16).astype(np.float32), points)


def _share_rounded(points: NDArray[np.float32], step: float) -> float:
    """Share of coordinates that are whole numbers of a step."""
    wide = points.astype(np.float64)
    off = np.abs(wide / step - np.round(wide / step)) * step
    return float(np.mean(off < 1e-5 + 1e-6 * np.abs(wide)))


def _of_lattice(
    points: NDArray[np.float32], sensor: Sensor, generic: GenericResult
) -> list[Processing]:
    found = []
    contradicted = generic.contradicted
    if "line" in contradicted:
        return [Processing("moved", "points lie beside the lines of the scanner everywhere")]
    if "order" in contradicted:
        found.append(Processing("shuffled", "the points are not in the order of the scanner"))
    if contradicted & {"grid", "step", "range"}:
        names = ", ".join(sorted(contradicted & {"grid", "step", "range"}))
        found.append(
            Processing("turned", f"coordinates were changed everywhere (contradicted: {names})")
        )
    if "duplicate" in contradicted:
        found.append(Processing("fused", "most directions hold several returns"))
    return found + _of_extent(points, sensor, generic)


def _of_extent(
    points: NDArray[np.float32], sensor: Sensor, generic: GenericResult
) -> list[Processing]:
    if sensor.lattice is None or len(points) == 0:
        return []
    found = []
    reading = sensor.lattice.read(points)
    azimuth = np.sort(reading.azimuth[reading.ring >= 0])
    gap = math.degrees(float(np.diff(np.r_[azimuth, azimuth[:1] + 2.0 * math.pi]).max(initial=0.0)))
    if gap > WIDEST_GAP:
        found.append(Processing("cropped", f"no points in {gap:.0f} degrees of azimuth"))
    wide = points.astype(np.float64)
    distance = np.sqrt((wide * wide).sum(axis=1))
    if distance.max() < LEAST_RANGE:
        found.append(Processing("cropped", f"no points beyond {distance.max():.1f} m"))
    if distance.min() > NEAREST_RANGE and _lowest_are_silent(reading, sensor.lattice):
        found.append(Processing("cropped", f"no points nearer than {distance.min():.1f} m"))
    firings = firings_of(reading, len(sensor.lattice.slope))
    for name, height in (("above", wide[:, 2]), ("below", -wide[:, 2])):
        if is_cut_at_height(height, firings):
            cut = float(height.max()) if name == "above" else -float(height.max())
            found.append(Processing("cropped", f"no points {name} a height of {cut:.2f} m"))
    if gap <= WIDEST_GAP and _is_thin(firings):
        found.append(Processing("thinned", "fewer returns from the ground than a whole frame has"))
    first = _first_azimuth(reading.ring, reading.azimuth)
    if gap <= WIDEST_GAP and abs(first) > FIRST_AZIMUTH and "order" not in generic.contradicted:
        found.append(Processing("turned", f"the rings begin at {first:.0f} degrees of azimuth"))
    return found


def _lowest_are_silent(reading: LatticeReading, lattice: SensorLattice) -> bool:
    """Whether a laser of the lowest eighth has returns in few of the firings."""
    rings = len(lattice.slope)
    known = (reading.ring >= 0) & (reading.count >= 0)
    fired = np.count_nonzero(np.bincount(reading.count[known]))
    returns = np.bincount(reading.ring[known], minlength=rings)[rings - rings // 8 :]
    return bool(returns.min(initial=fired) < LEAST_OF_LOWEST * fired)


def _first_azimuth(ring: NDArray[np.int32], azimuth: NDArray[np.float32]) -> float:
    """Degrees in (-180, 180] at which the rings of the file begin, in the median.

    A ring begins where the file first has it: points that were appended say nothing of it.
    """
    rings, starts = np.unique(ring, return_index=True)
    starts = starts[rings > 0]
    if len(starts) < 8:
        return 0.0
    return float(np.median(180.0 - np.mod(180.0 - np.degrees(azimuth[starts]), 360.0)))


def _is_thin(firings: Firings | None) -> bool:
    """Whether the firings of the lower half of the lasers have too few returns."""
    if firings is None:
        return False
    rings = len(firings.answered)
    below = firings.answered[(3 * rings) // 8 : (7 * rings) // 8]
    return bool(np.count_nonzero(below) < LEAST_FILL * below.size)


class Firings(NamedTuple):
    """Which lasers answered at which firings.

    Attributes
    ----------
    answered : (rings, F) bool
    firing : (N,) int64
        Of each point; -1: of none.
    ring : (N,) int32
        Laser of each point.
    """

    answered: NDArray[np.bool_]
    firing: NDArray[np.int64]
    ring: NDArray[np.int32]


def firings_of(reading: LatticeReading, rings: int) -> Firings | None:
    """Return the firings of the head; None: the lattice has no encoder, or no point is on it."""
    known = (reading.ring >= 0) & (reading.count >= 0)
    if not known.any():
        return None
    votes = np.bincount(reading.count[known])
    around = np.max([np.roll(votes, k) for k in range(-2, 3)], axis=0)
    fired = (votes > 0) & (votes >= 0.6 * around)
    number = np.where(fired, np.cumsum(fired) - 1, -1)
    firing = np.where(known, number[np.where(known, reading.count, 0)], -1)
    answered = np.zeros((rings, int(np.count_nonzero(fired))), np.bool_)
    on = firing >= 0
    answered[reading.ring[on], firing[on]] = True
    return Firings(answered, firing, reading.ring)


def is_cut_at_height(height: NDArray[np.float64], firings: Firings | None) -> bool:
    """Return whether points end at a round height because what lay beyond it was cut off.

    Parameters
    ----------
    height : (N,) float64, metres
        Upwards where the top may be cut, downwards where the bottom may be.
    firings : Firings or None
        None: firings are not known, and the points at the edge say it alone.
    """
    top = float(height.max())
    off = abs(top - ROUND_HEIGHT * round(top / ROUND_HEIGHT))
    if off >= OFF_ROUND or np.count_nonzero(height > top - FACE) <= MOST_ON_FACE:
        return False
    return firings is None or _is_silent_beyond(height > top - CUT_EDGE, firings)


def _is_silent_beyond(at_edge: NDArray[np.bool_], firings: Firings) -> bool:
    """Whether many of the points at an edge have a neighbour without a return."""
    edge = np.flatnonzero(at_edge & (firings.firing >= 0))
    if len(edge) < FEWEST_AT_EDGE:
        return False
    ring, firing = firings.ring[edge], firings.firing[edge]
    rings, count = firings.answered.shape
    surrounded = np.ones(len(edge), np.bool_)
    for up, on in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = np.clip(ring + up, 0, rings - 1)
        surrounded &= firings.answered[beside, (firing + on) % count]
    return bool(np.mean(~surrounded) >= LEAST_SILENT)
