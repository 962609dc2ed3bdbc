"""Parts of a turn that were cut off: gaps, ends at one distance or height, a silent own car."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._firings import (
    OFF_LATTICE,
    SIDES,
    beside_silence,
    ends_in_silence,
    firings_of,
    is_cut_above,
    is_cut_below,
)
from manip3d.authenticate._roundings import SAMPLE, processing_of_coordinates, share_rounded
from manip3d.authenticate._sensors import is_unit_of_kitti
from manip3d.authenticate._silences import (
    FEW_RETURNS,
    highest_are_silent,
    silent_at_the_ends,
    thinned_out,
)
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._firings import Firings
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.lidar import LidarFrame

CHANCE_GAP = 10.0
"""Degrees without any point that may be left by chance where few of the points are kept."""

WIDEST_GAP = 0.5
"""Degrees of azimuth without any point. Whole frames of an HDL-64E have 0.15 at most (47 of nine
drives), all but one 0.07: its lower lasers always meet the road, or its own car."""

NARROW_GAP, FEWEST_GAPS, AZIMUTH_CELL = 0.2, 3, 0.025
"""Degrees, sectors, degrees of the cells in which they are counted: gaps that are no whole
`WIDEST_GAP`. Of 53 whole frames one has gaps of 0.1 to 0.15 degrees, in 16 places; all others have
none of 0.08."""

LEAST_RANGE = 78.5
"""Metres: whole frames of KITTI (47 of nine drives were looked at) reach to 79.8 m and farther."""

LAST_METRES, MOST_RANGE, FEWEST_CUT_OFF = 10.0, 80.0, 65
"""Metres; metres beyond which KITTI keeps no point; points: so many, at the density of the last
metres, would lie between the farthest point and that range. Where it is fewer, the farthest point
says little: 52 at most in 12 simulated streets that end between 77.4 and 78.5 m. Of frames of
KITTI cut at 76 m or nearer it is 72 and more, of those cut at 77 m 43 and more (13 frames)."""

LAST_SHARE, FEWEST_AT_END = 0.98, 40
"""Share of the largest range, points: frames that were cut at 20 to 55 m have 49 and more beyond it
(24 of KITTI and of simulated streets), those of which a filter of outliers left nothing beyond 60 m
24 at most (14)."""

SAME_END, WIDEST_STRIP, STRIP_EDGE, POINTS_AT_ENDS, LEAST_SILENT_AT_ENDS = 0.03, 70.0, 0.5, 9, 0.3
"""Metres, metres, metres, points, share: where a strip was cut out, x or y ends at the same
distance on both sides, nearer than this, in several points, some of which have a neighbour along
the ring that was cut off. In 227 whole frames (47 of KITTI) no two sides end within 0.1 m of the
same, nearer than 70 m."""

NEAREST_RANGE, LEAST_OF_LOWEST = 2.5, 0.25
"""Metres; share of the firings in which one of the lowest eighth of the lasers must have a return.
Where a scanner's own car does not answer (1.5 m in KITTI), the road does, which the lowest lasers
meet 4 m away; where nothing answers them, what is near was cut off."""

OWN_CAR, OF_OWN_CAR, FEWEST_OF_OWN_CAR = 2.0, (120.0, 140.0), 5
"""Metres, degrees of azimuth to the left and to the right, points: the rack of KITTI's own car
answers the lowest eighth of the lasers nearer than this, by 28 points and more in each of the whole
frames. Fewer are left of it where what is near was cut off, in whatever shape. Elsewhere walls and
other cars answer them, too."""

NEAREST_OF_OWN_CAR = 1.59
"""Metres: the rack begins nearer than this, at 1.48 m at most in the 30 frames of drives 0002 and
0005 and at 1.58 m in 24 simulated ones, which chose the limit. In 17 others of KITTI it begins at
1.49 m at most. A sphere of 1.6 m that is cut out takes no more than a third of the rack."""

FIRST_AZIMUTH = 1.0
"""Degrees from straight ahead at which rings of whole frames begin at most."""

MOST_OFF_FIRINGS = 0.1
"""Share of such points in a turn whose extent is reported; KITTI's have none, rounded ones most."""

OWN_CAR_SILENT = "the scanner's own car does not answer"
OWN_CAR_CUT = f"{OWN_CAR_SILENT} nearer than {NEAREST_OF_OWN_CAR:g} m"


class Lacking(NamedTuple):
    """Why a turn may lack points that the scanner measured.

    Attributes
    ----------
    reason : str
        What was done to the turn.
    is_in_place : bool
        Whether what is left lies where it was measured, to a few centimetres.
    whole_up_to_m : float
        Nothing is missing nearer than this, metres.
    """

    reason: str
    is_in_place: bool
    whole_up_to_m: float = 0.0


def left_out_of_turn(turn: LidarFrame, lattice: SensorLattice) -> Lacking | None:
    """Say why a turn beside a scan may lack points that it had; None: nothing tells that it does.

    Parts of it were cut off or thinned out; or its points were moved off their firings, so that
    nothing tells which answered. Whole lasers that are missing do not count: they are left out of
    the comparison.

    Parameters
    ----------
    turn : LidarFrame
        The scanner in (0, 0, 0).
    lattice : SensorLattice
        Lattice of the scan's scanner.
    """
    if turn.num_points == 0:
        return None
    reading = lattice.read(turn.points)
    is_off = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error)) > OFF_LATTICE
    some, step_m = turn.points[:: max(1, turn.num_points // SAMPLE)], lattice.coordinate_step
    is_scaled = step_m > 0.0 and share_rounded(some, step_m) < 1.0 - MOST_OFF_FIRINGS
    if np.mean(is_off) > MOST_OFF_FIRINGS or is_scaled:
        for step in processing_of_coordinates(turn.points):
            return Lacking(f"{step.kind}: {step.detail}", is_in_place=True)
        return Lacking("moved to where the scanner does not measure", is_in_place=False)
    steps = processing_of_extent(turn.points, lattice, reading, is_in_order=False)
    if not (steps := [step for step in steps if step.kind != "lasers"]):
        return None
    wide = turn.points.astype(np.float64)
    firings = firings_of(reading, len(lattice.slope))
    cuts = _cuts_far_away(wide, np.linalg.norm(wide, axis=1), firings)
    are_all = all(step.detail in [detail for _, detail in cuts] for step in steps)
    nearest = min((metres for metres, _ in cuts), default=0.0) if are_all else 0.0
    reason = f"{steps[0].kind}: {steps[0].detail}"
    return Lacking(reason, is_in_place=True, whole_up_to_m=nearest)


def _gaps(azimuth: NDArray[np.float32]) -> tuple[float, int]:
    """Degrees of the widest gap between azimuths, 0 where it is certainly below `WIDEST_GAP`, and
    how many are wider than `NARROW_GAP`."""
    cells = round(360.0 / AZIMUTH_CELL)
    cell = np.minimum((azimuth * (cells / (2.0 * math.pi))).astype(np.intp), cells - 1)
    filled = np.flatnonzero(np.bincount(cell, minlength=cells))
    if not len(filled):
        return 0.0, 0
    empty = np.diff(np.r_[filled, filled[0] + cells]) - 1
    narrow = int(np.count_nonzero(empty >= round(NARROW_GAP / AZIMUTH_CELL)))
    if (empty.max() + 2) * AZIMUTH_CELL <= WIDEST_GAP:
        return 0.0, narrow
    azimuth = np.sort(azimuth)
    gaps = np.diff(np.r_[azimuth, azimuth[:1] + 2.0 * math.pi])
    return math.degrees(float(gaps.max())), narrow


def processing_of_extent(
    points: NDArray[np.float32],
    lattice: SensorLattice | None,
    reading: LatticeReading | None,
    *,
    is_in_order: bool,
) -> list[Processing]:
    """Find what was cut off or thinned out, and whether the rings begin elsewhere than usual.

    Each kind of cut leaves silence: firings that have no return although those beside them do.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice or None
        Lattice of the scanner; None: nothing is found.
    reading : LatticeReading or None
        Where the points lie on it; None: it is read here.
    is_in_order : bool
        The points are in the order of the scanner.
    """
    if lattice is None or len(points) == 0:
        return []
    reading = lattice.read(points) if reading is None else reading
    firings = firings_of(reading, len(lattice.slope))
    gap, narrow_gaps = _gaps(reading.azimuth[reading.ring >= 0])
    is_whole_turn = gap <= WIDEST_GAP
    wide = points.astype(np.float64)
    x, y, z = wide.T
    distance = np.sqrt(x * x + y * y + z * z)

    found = []
    thinned = [] if firings is None else thinned_out(firings, distance, whole=gap <= CHANCE_GAP)
    is_thin = any(step.detail == FEW_RETURNS for step in thinned)
    if not is_whole_turn and not (is_thin and gap <= CHANCE_GAP):
        found.append(Processing("cropped", f"no points in {gap:.0f} degrees of azimuth"))
    found += [Processing("cropped", cut) for _, cut in _cuts_far_away(wide, distance, firings)]
    if distance.min() > NEAREST_RANGE and _lowest_are_silent(reading, lattice):
        found.append(Processing("cropped", f"no points nearer than {distance.min():.1f} m"))
    if is_whole_turn and not thinned and narrow_gaps >= FEWEST_GAPS and is_unit_of_kitti(lattice):
        detail = f"no points in {narrow_gaps} sectors of {NARROW_GAP:g} degrees of azimuth and more"
        found.append(Processing("cropped", detail))
    top, bottom = (0, 0) if firings is None else silent_at_the_ends(firings, lattice)
    for which, silent in (("highest", top), ("lowest", bottom)):
        if silent:
            lasers = "laser has" if silent == 1 else f"{silent} lasers have"
            found.append(Processing("lasers", f"the {which} {lasers} nearly no returns"))
    turned = _turned(reading) if is_whole_turn and is_in_order else []
    is_as_mounted = not (found or thinned or turned)  # else the own car may be cut off or elsewhere
    if is_as_mounted and (silence := _silence_of_own_car(reading, distance, lattice)):
        found.append(Processing("cropped", silence))
    return found + _cropped_in_height(wide, firings) + thinned + turned


def _cuts_far_away(
    points: NDArray[np.float64], distance: NDArray[np.float64], firings: Firings | None
) -> list[tuple[float, str]]:
    """Cuts at a distance from the scanner, or at the same x or y on both sides of it.

    Metres up to which nothing is missing, and the cut in words.
    """
    found = []
    x, y = points[:, 0], points[:, 1]
    is_short = distance.max() < LEAST_RANGE and _cut_off_beyond(distance) >= FEWEST_CUT_OFF
    if is_short and any(ends_in_silence(end, firings) for end in (distance, x, -x, y, -y)):
        ends = np.abs(points).max(axis=0)[:2].min()  # of a box or a strip, which ends nearer
        farthest = float(distance.max())
        detail = f"no points beyond {farthest:.1f} m"
        if np.count_nonzero(distance > LAST_SHARE * farthest) < FEWEST_AT_END:
            detail += ", and few near there: cut off, or left out by a filter of outliers"
        found.append((min(farthest, float(ends)), detail))
    for name, along in zip("xy", (x, y), strict=True):
        if _is_cut_on_both_sides(along, firings):
            end = float(along.max())
            found.append((end, f"{name} ends at {end:.1f} m on both sides"))
    return found


def _cropped_in_height(points: NDArray[np.float64], firings: Firings | None) -> list[Processing]:
    """The highest lasers without returns, and cuts at a height."""
    found = []
    z = points[:, 2]
    if firings is not None and highest_are_silent(firings):
        found.append(Processing("cropped", "the highest lasers have no returns"))
    if is_cut_above(z, firings):
        found.append(Processing("cropped", f"no points above a height of {z.max():.2f} m"))
    if is_cut_below(points, firings):
        found.append(Processing("cropped", f"no points below a height of {z.min():.2f} m"))
    return found


def _turned(reading: LatticeReading) -> list[Processing]:
    """Whether a whole turn in the scanner's order begins at another azimuth than the scanner."""
    first = first_azimuth(reading.ring, reading.azimuth)
    if abs(first) <= FIRST_AZIMUTH:
        return []
    return [Processing("turned", f"the rings begin at {first:.0f} degrees of azimuth")]


def _is_cut_on_both_sides(along: NDArray[np.float64], firings: Firings | None) -> bool:
    """Whether points end at the same distance on both sides because what lay beyond was cut off."""
    farthest, other = float(along.max()), -float(along.min())
    if firings is None or farthest > WIDEST_STRIP or abs(farthest - other) > SAME_END:
        return False
    fired = np.flatnonzero(firings.firing >= 0)
    if len(fired) < POINTS_AT_ENDS:
        return False
    order = fired[np.argsort(along[fired], kind="stable")]
    edges = (order[:POINTS_AT_ENDS], order[-POINTS_AT_ENDS:])
    return all(
        np.ptp(along[edge]) < STRIP_EDGE
        and np.mean(beside_silence(edge, firings, SIDES)) >= LEAST_SILENT_AT_ENDS
        for edge in edges
    )


def _cut_off_beyond(distance: NDArray[np.float64]) -> float:
    """Points that would lie beyond the farthest one if they went on as densely as before it."""
    farthest = float(distance.max())
    last = np.count_nonzero(distance > farthest - LAST_METRES)
    return last * (MOST_RANGE - farthest) / LAST_METRES


def _lowest_are_silent(reading: LatticeReading, lattice: SensorLattice) -> bool:
    """Whether a laser of the lowest eighth has returns in few of the firings."""
    rings = len(lattice.slope)
    known = (reading.ring >= 0) & (reading.count >= 0)
    fired = np.count_nonzero(np.bincount(reading.count[known]))
    returns = np.bincount(reading.ring[known], minlength=rings)[rings - rings // 8 :]
    return bool(returns.min(initial=fired) < LEAST_OF_LOWEST * fired)


def _silence_of_own_car(
    reading: LatticeReading, distance: NDArray[np.float64], lattice: SensorLattice
) -> str:
    """Say what KITTI's own car returns and is not there; other scanners stand on other cars."""
    if not is_unit_of_kitti(lattice):
        return ""
    lowest = reading.ring >= len(lattice.slope) - len(lattice.slope) // 8
    near = np.flatnonzero(lowest & (distance < OWN_CAR))
    to_a_side = 180.0 - np.abs(180.0 - np.degrees(reading.azimuth[near]))
    least, most = OF_OWN_CAR
    of_car = distance[near[(to_a_side > least) & (to_a_side < most)]]
    if len(of_car) < FEWEST_OF_OWN_CAR:
        return OWN_CAR_SILENT
    return OWN_CAR_CUT if of_car.min() > NEAREST_OF_OWN_CAR else ""


def first_azimuth(ring: NDArray[np.int32], azimuth: NDArray[np.float32]) -> float:
    """Degrees in (-180, 180] at which the rings of the file begin, in the median.

    A ring begins where the file first has it: points that were appended say nothing of it. Where
    nothing of the ring lies between straight ahead and its first point, it begins straight ahead:
    the laser had no return there, from a dark car for example.
    """
    rings = int(ring.max(initial=-1)) + 1
    first = np.full(rings + 1, -1)
    first[ring[::-1]] = np.arange(len(ring) - 1, -1, -1)  # the last to be written is the first row
    least = _least_of_rings(ring, azimuth, rings)
    numbers = 1 + np.flatnonzero(first[1:rings] >= 0)
    if len(numbers) < 8:
        return 0.0
    starts = azimuth[first[numbers]]
    begins = 180.0 - np.mod(180.0 - np.degrees(starts), 360.0)
    begins[starts <= least[numbers]] = 0.0
    return float(np.median(begins))


def _least_of_rings(
    ring: NDArray[np.int32], azimuth: NDArray[np.float32], rings: int
) -> NDArray[np.float64]:
    """The least azimuth of each ring; infinity where it has no point."""
    least = np.full(rings, np.inf)
    order = np.argsort(ring, kind="stable")
    starts = np.searchsorted(ring, np.arange(rings), sorter=order)
    some = np.flatnonzero(np.diff(np.r_[starts, len(ring)]))
    if len(some):
        least[some] = np.minimum.reduceat(azimuth[order], starts[some])
    return least
