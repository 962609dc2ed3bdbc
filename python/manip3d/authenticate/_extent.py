"""Find parts that were cut off a turn: gaps, ends at one distance or height, a missing own car."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._empty_bands import empty_bands
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
    single_holes_near,
    thinned_out,
)
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._firings import Firings
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.lidar import LidarFrame

CHANCE_GAP = 10.0
"""Degrees: widest gap in azimuth that chance may leave where few points are kept at random."""

WIDEST_GAP = 0.5
"""Degrees: widest gap in azimuth of a whole turn. The widest gap of 47 whole frames of an HDL-64E
(nine drives) is 0.15, and at most 0.07 in all but one of them, because the lower lasers always meet
the road or the scanner's own car."""

NARROW_GAP, MIN_GAPS, AZIMUTH_CELL = 0.2, 3, 0.025
"""Sectors were cut out if at least MIN_GAPS gaps in azimuth are NARROW_GAP degrees or wider,
even if none reaches `WIDEST_GAP`. Gaps are counted in cells of AZIMUTH_CELL degrees. Of 53 whole
frames one has gaps of 0.1 to 0.15 degrees, in 16 places; all others have none of 0.08."""

MIN_RANGE = 78.5
"""Metres: a turn that ends nearer may have been cut. 47 whole frames of nine drives of KITTI reach
to 79.8 m or farther."""

LAST_METRES, MAX_RANGE, MIN_CUT_OFF = 10.0, 80.0, 65
"""A turn is cut at a distance only if at least MIN_CUT_OFF points would lie between the farthest
point and MAX_RANGE metres, beyond which KITTI keeps no point, at the density of the last
LAST_METRES metres. With fewer, the farthest point says little: the number is at most 52 in 12
simulated streets that end between 77.4 and 78.5 m. In 13 frames of KITTI it is at least 72 if they
are cut at 76 m or nearer, and at least 43 if they are cut at 77 m."""

LAST_SHARE, MIN_AT_END = 0.98, 40
"""A filter of outliers may be the reason of the cut if fewer than MIN_AT_END points lie beyond
the share LAST_SHARE of the largest range. Frames that were cut at 20 to 55 m have at least 49 such
points (24 frames of KITTI and of simulated streets); frames of which a filter of outliers left
nothing beyond 60 m have at most 24 (14 frames)."""

SAME_END, WIDEST_STRIP, STRIP_EDGE, POINTS_AT_ENDS, MIN_SILENT_AT_ENDS = 0.03, 70.0, 0.5, 9, 0.3
"""A strip was cut out if x or y ends on both sides at the same distance (to SAME_END metres),
nearer than WIDEST_STRIP metres; if the POINTS_AT_ENDS outermost points of either side lie within
STRIP_EDGE metres; and if at least the share MIN_SILENT_AT_ENDS of them have a neighbour along the
ring without a return, since it was cut off. In 227 whole frames (47 of KITTI) no two opposite sides
end within 0.1 m of the same distance, nearer than 70 m."""

NEAREST_RANGE, MIN_OF_LOWEST = 2.5, 0.25
"""The surroundings were cut off if no point is nearer than NEAREST_RANGE metres, and one of the
lowest eighth of the lasers has returns in less than the share MIN_OF_LOWEST of the firings. Whole
turns have returns from the scanner's own car (1.5 m in KITTI), or else from the road, which the
lowest lasers meet 4 m away."""

OWN_CAR, OWN_CAR_AZIMUTHS, MIN_OF_OWN_CAR = 2.0, (120.0, 140.0), 5
"""The rack of KITTI's own car returns points of the lowest eighth of the lasers nearer than OWN_CAR
metres, at azimuths of OWN_CAR_AZIMUTHS degrees to the left and to the right. Each whole frame has
at least 28 of them; fewer than MIN_OF_OWN_CAR mean that the surroundings of the scanner were cut
off, in whatever shape. At other azimuths walls and other cars return points, too."""

NEAREST_OF_OWN_CAR = 1.59
"""Metres: the nearest point of the rack is nearer than this. It is at most 1.48 m away in the 30
frames of drives 0002 and 0005, and 1.58 m in 24 simulated frames; these chose the limit. In 17
other frames of KITTI it is at most 1.49 m away. A sphere of 1.6 m that is cut out removes at most a
third of the rack."""

FIRST_AZIMUTH = 1.0
"""Degrees: largest azimuth, to either side of straight ahead, at which rings of whole frames
begin."""

MAX_OFF_FIRINGS = 0.1
"""Largest share of points off lines, steps or the coordinate grid in a turn whose extent is judged.
KITTI's turns have no such points; in rounded turns most points are."""

OWN_CAR_SILENT = "the scanner's own car does not answer"
OWN_CAR_CUT = f"{OWN_CAR_SILENT} nearer than {NEAREST_OF_OWN_CAR:g} m"


class Lacking(NamedTuple):
    """Reason why a turn may lack points that the scanner measured.

    Attributes
    ----------
    reason : str
        Description of the processing of the turn.
    is_in_place : bool
        Whether the remaining points lie where they were measured, to a few centimetres.
    whole_up_to_m : float
        Distance, metres, up to which no points are missing.
    """

    reason: str
    is_in_place: bool
    whole_up_to_m: float = 0.0


def left_out_of_turn(turn: LidarFrame, lattice: SensorLattice) -> Lacking | None:
    """Return why a neighbouring turn may lack points; None if nothing shows that it does.

    Either parts of the turn were cut off or thinned out, or its points were moved off their
    firings, so that it is unknown which firings had returns. Missing whole lasers do not count,
    because they are left out of the comparison.

    Parameters
    ----------
    turn : LidarFrame
        Turn with the scanner at (0, 0, 0).
    lattice : SensorLattice
        Lattice of the scan's scanner.
    """
    if turn.num_points == 0:
        return None
    reading = lattice.read(turn.points)
    is_off = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error)) > OFF_LATTICE
    some, step_m = turn.points[:: max(1, turn.num_points // SAMPLE)], lattice.coordinate_step
    is_scaled = step_m > 0.0 and share_rounded(some, step_m) < 1.0 - MAX_OFF_FIRINGS
    if np.mean(is_off) > MAX_OFF_FIRINGS or is_scaled:
        if found := processing_of_coordinates(turn.points):
            return Lacking(f"{found[0].kind}: {found[0].detail}", is_in_place=True)
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
    """Width of the widest gap in azimuth, degrees (0 if it is certainly below `WIDEST_GAP`), and
    the number of gaps of at least `NARROW_GAP`."""
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
    """Find parts that were cut off or thinned out, and rings that begin at an unusual azimuth.

    A cut is recognised by silence beside it: firings without a return next to firings with one.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice or None
        Lattice of the scanner; None: nothing is found.
    reading : LatticeReading or None
        Places of the points on the lattice; None: they are computed here.
    is_in_order : bool
        Whether the points are in the order of the scanner.
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
    is_around = gap <= CHANCE_GAP
    thinned = [] if firings is None else thinned_out(firings, lattice, distance, whole=is_around)
    is_thin = any(step.detail == FEW_RETURNS for step in thinned)
    if not is_whole_turn and not (is_thin and is_around):
        found.append(Processing("cropped", f"no points in {gap:.0f} degrees of azimuth"))
    found += [Processing("cropped", cut) for _, cut in _cuts_far_away(wide, distance, firings)]
    if distance.min() > NEAREST_RANGE and _lowest_are_silent(reading, lattice):
        found.append(Processing("cropped", f"no points nearer than {distance.min():.1f} m"))
    if is_whole_turn and not thinned and narrow_gaps >= MIN_GAPS and is_unit_of_kitti(lattice):
        detail = f"no points in {narrow_gaps} sectors of {NARROW_GAP:g} degrees of azimuth and more"
        found.append(Processing("cropped", detail))
    top, bottom = (0, 0) if firings is None else silent_at_the_ends(firings, lattice)
    for which, silent in (("highest", top), ("lowest", bottom)):
        if silent:
            lasers = "laser has" if silent == 1 else f"{silent} lasers have"
            found.append(Processing("lasers", f"the {which} {lasers} nearly no returns"))
    turned = _turned(reading) if is_whole_turn and is_in_order else []
    is_as_mounted = not (found or thinned or turned)  # else parts of the own car may be cut off
    if is_as_mounted and (silence := _silence_of_own_car(reading, distance, lattice)):
        found.append(Processing("cropped", silence))
    in_height = _cropped_in_height(wide, distance, firings, sees_horizon=is_unit_of_kitti(lattice))
    return found + in_height + _with_bands(thinned, wide, distance, firings) + turned


def processing_of_own(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading | None
) -> list[Processing]:
    """Find gaps, empty bands and points left out one by one in a scan of another HDL-64E.

    A lattice that was estimated from the scan itself tells these, but neither where the scanner's
    view ends nor its own car.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice
        Lattice that was estimated from the points.
    reading : LatticeReading or None
        Places of the points on the lattice; None: they are computed here.
    """
    reading = lattice.read(points) if reading is None else reading
    firings = firings_of(reading, len(lattice.slope))
    gap = _gaps(reading.azimuth[reading.ring >= 0])[0]
    wide = points.astype(np.float64)
    distance = np.linalg.norm(wide, axis=1)
    found = []
    if firings is not None:
        found = thinned_out(firings, lattice, distance, whole=gap <= CHANCE_GAP)
        found = _with_bands(found, wide, distance, firings)
    is_thin = any(step.detail == FEW_RETURNS for step in found)
    if gap > (CHANCE_GAP if is_thin else WIDEST_GAP):
        found.insert(0, Processing("cropped", f"no points in {gap:.0f} degrees of azimuth"))
    return found


def _with_bands(
    thinned: list[Processing],
    points: NDArray[np.float64],
    distance: NDArray[np.float64],
    firings: Firings | None,
) -> list[Processing]:
    """Add empty bands, which also explain why some lasers are silent in a sector.

    Where points were left out one by one, silence beside the ends of a band shows no cut.
    """
    if firings is None or any(step.kind == "thinned" for step in thinned):
        return thinned
    are_lasers_missing = any(step.kind == "lasers" for step in thinned)
    bands = empty_bands(points, distance, firings, elevations=not are_lasers_missing)
    if not bands:
        return thinned
    return bands + [step for step in thinned if step.kind != "sector"]


def _cuts_far_away(
    points: NDArray[np.float64], distance: NDArray[np.float64], firings: Firings | None
) -> list[tuple[float, str]]:
    """Cuts at a distance from the scanner, or at the same distance in x or y on both sides of it.

    Each as the distance (metres) up to which no points are missing, and the cut in words.
    """
    found = []
    x, y = points[:, 0], points[:, 1]
    is_short = distance.max() < MIN_RANGE and _cut_off_beyond(distance) >= MIN_CUT_OFF
    if is_short and any(ends_in_silence(end, firings) for end in (distance, x, -x, y, -y)):
        ends = np.abs(points).max(axis=0)[:2].min()  # a box or a strip ends nearer
        farthest = float(distance.max())
        detail = f"no points beyond {farthest:.1f} m"
        if np.count_nonzero(distance > LAST_SHARE * farthest) < MIN_AT_END:
            detail += ", and few near there: cut off, or left out by a filter of outliers"
        found.append((min(farthest, float(ends)), detail))
    for name, along in zip("xy", (x, y), strict=True):
        if _is_cut_on_both_sides(along, firings):
            end = float(along.max())
            found.append((end, f"{name} ends at {end:.1f} m on both sides"))
    return found


def _cropped_in_height(
    points: NDArray[np.float64],
    distance: NDArray[np.float64],
    firings: Firings | None,
    *,
    sees_horizon: bool,
) -> list[Processing]:
    """Missing returns of the highest lasers, and cuts at a height."""
    found = []
    z = points[:, 2]
    if firings is not None and highest_are_silent(firings):
        found.append(Processing("cropped", "the highest lasers have no returns"))
    if is_cut_above(points, firings, sees_horizon=sees_horizon):
        found.append(Processing("cropped", f"no points above a height of {z.max():.2f} m"))
    if is_cut_below(points, firings) and (
        firings is None or is_cut_below(points, firings, lost=single_holes_near(firings, distance))
    ):
        found.append(Processing("cropped", f"no points below a height of {z.min():.2f} m"))
    return found


def _turned(reading: LatticeReading) -> list[Processing]:
    """Whether a whole turn in the scanner's order begins at another azimuth than straight ahead."""
    first = first_azimuth(reading.ring, reading.azimuth)
    if abs(first) <= FIRST_AZIMUTH:
        return []
    return [Processing("turned", f"the rings begin at {first:.0f} degrees of azimuth")]


def _is_cut_on_both_sides(along: NDArray[np.float64], firings: Firings | None) -> bool:
    """Whether points end at the same distance on both sides because the rest was cut off."""
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
        and np.mean(beside_silence(edge, firings, SIDES)) >= MIN_SILENT_AT_ENDS
        for edge in edges
    )


def _cut_off_beyond(distance: NDArray[np.float64]) -> float:
    """Number of points between the farthest one and MAX_RANGE if they went on equally densely."""
    farthest = float(distance.max())
    last = np.count_nonzero(distance > farthest - LAST_METRES)
    return last * (MAX_RANGE - farthest) / LAST_METRES


def _lowest_are_silent(reading: LatticeReading, lattice: SensorLattice) -> bool:
    """Whether a laser of the lowest eighth has returns in few of the firings."""
    rings = len(lattice.slope)
    known = (reading.ring >= 0) & (reading.count >= 0)
    fired = np.count_nonzero(np.bincount(reading.count[known]))
    returns = np.bincount(reading.ring[known], minlength=rings)[rings - rings // 8 :]
    return bool(returns.min(initial=fired) < MIN_OF_LOWEST * fired)


def _silence_of_own_car(
    reading: LatticeReading, distance: NDArray[np.float64], lattice: SensorLattice
) -> str:
    """Return how KITTI's own car is cut; '' if it is whole, or for other scanners."""
    if not is_unit_of_kitti(lattice):
        return ""
    lowest = reading.ring >= len(lattice.slope) - len(lattice.slope) // 8
    near = np.flatnonzero(lowest & (distance < OWN_CAR))
    to_a_side = 180.0 - np.abs(180.0 - np.degrees(reading.azimuth[near]))
    least, most = OWN_CAR_AZIMUTHS
    of_car = distance[near[(to_a_side > least) & (to_a_side < most)]]
    if len(of_car) < MIN_OF_OWN_CAR:
        return OWN_CAR_SILENT
    return OWN_CAR_CUT if of_car.min() > NEAREST_OF_OWN_CAR else ""


def first_azimuth(ring: NDArray[np.int32], azimuth: NDArray[np.float32]) -> float:
    """Median azimuth at which the rings of the file begin, degrees in (-180, 180].

    A ring begins at its first row in the file, so that appended points do not matter. If no point
    of the ring lies between straight ahead and that first point, the ring counts as beginning
    straight ahead: the laser had no return there, as from a dark car.
    """
    rings = int(ring.max(initial=-1)) + 1
    first = np.full(rings + 1, -1)  # the last item is that of ring -1: points of no laser
    first[ring[::-1]] = np.arange(len(ring) - 1, -1, -1)  # in reverse order: the first row remains
    least = _least_of_rings(ring, azimuth, rings)
    # Ring 0 is left out, because rows that are cut off the start of a file take its beginning.
    numbers = 1 + np.flatnonzero(first[1:rings] >= 0)
    if len(numbers) < 8:  # too few rings for a median
        return 0.0
    starts = azimuth[first[numbers]]
    begins = 180.0 - np.mod(180.0 - np.degrees(starts), 360.0)
    begins[starts <= least[numbers]] = 0.0
    return float(np.median(begins))


def _least_of_rings(
    ring: NDArray[np.int32], azimuth: NDArray[np.float32], rings: int
) -> NDArray[np.float64]:
    """Smallest azimuth of each ring, radians; infinity if the ring has no point."""
    least = np.full(rings, np.inf)
    order = np.argsort(ring, kind="stable")
    starts = np.searchsorted(ring, np.arange(rings), sorter=order)
    some = np.flatnonzero(np.diff(np.r_[starts, len(ring)]))
    if len(some):
        least[some] = np.minimum.reduceat(azimuth[order], starts[some])
    return least
