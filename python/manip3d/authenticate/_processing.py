"""Changes of a scan as a whole: shuffled, rounded, cropped, turned, deskewed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d import _core
from manip3d.authenticate._firings import (
    OFF_LATTICE,
    SIDES,
    beside_silence,
    ends_in_silence,
    firings_of,
    is_cut_above,
    is_cut_below,
)
from manip3d.authenticate._generic import MISSING, generic_consistency
from manip3d.authenticate._lattice import FIVE_DIGITS_TO, has_whole_millimetres
from manip3d.authenticate._reflectance import (
    is_in_hundredths,
    why_of_no_scene,
    why_of_other_points,
    why_rewritten,
)
from manip3d.authenticate._sensors import HDL64E, is_hdl64e, is_in_metres, kitti_lattice
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from manip3d.authenticate._firings import Firings
    from manip3d.authenticate._generic import GenericResult
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.authenticate._sensors import Sensor
    from manip3d.lidar import LidarFrame

ROUNDINGS = (0.1, 0.05, 0.02, 0.01, 0.005)
"""Metres that files are rounded to, the coarsest first; scanners write 2 mm and less."""

FINE_ROUNDINGS = (0.002, 0.001)
"""Metres: the same of files of an HDL-64E, whose own ranges are steps of 2 mm and whose coordinates
are whole millimetres, where the scan contradicts both."""

OF_ROUNDING = 0.5
"""Share of the step of a rounding that points may be off the lines for it, in the median."""

OWN_ROUNDING = 0.0005
"""Metres: the median distance of a scan's points from the scanner's lines, at most, which the
roundings of its own files leave (0.25 mm in KITTI)."""

OF_FLOAT16 = 0.01
"""Metres: the median distance from the lines, at most, that numbers of 16 bits leave, whose steps
are 4 to 31 mm from 4 to 64 m on."""

NEAR_STEPS, LEAST_STEP, MOST_STEP, FEWEST_STEPS, MOST_STEPS_APART = 32.0, 2e-5, 0.1, 50, 32
"""Metres up to which single precision leaves coordinates apart that are a step apart; the smallest
and the largest step that is looked for, metres; different coordinates, at least; and steps between
two that are next to each other, at most: whole millimetres leave most of finer steps out."""

SAME_STEP = 1e-5
"""Share of a step by which steps of two axes that are the same may differ."""

SINGLE = 2.0**-23
"""Share of a coordinate that single precision may add to the difference of two."""

OF_PLACES = {"grid", "step", "range"}
"""Kinds of evidence that a change of all coordinates by a millimetre contradicts."""

CUT_OFF = (
    "coordinates are whole millimetres and the scanner's ranges are not: they were cut off, "
    "rounded twice, or all ranges were changed"
)

NEAR_SCALED, FEWEST_SCALED, LEAST_SCALED, OFF_SCALED = (8.0, 25.0), 1000, 0.002, 0.001
"""Metres; points; a difference from 1; metres. Points that were scaled stand so near to lines of
the scanner whose offsets were scaled as well, where lines are apart by more."""

MOST_OF_TURN = 150_000
"""Points of one turn of an HDL-64E: 64 lasers fire 2083 times, and up to a tenth more often."""

FAR_DIGITS, FEWEST_FAR_DIGITS = 10.0, 1000
"""Metres from which on coordinates of so many significant digits are whole numbers of a tenth, a
hundredth or a thousandth, and nearer ones are not; and coordinates that tell."""

SAMPLE, FEW = 5000, 20
"""Points that are looked at before all are, and one of how many of them before that."""

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

FIRST_AZIMUTH = 1.0
"""Degrees from straight ahead at which rings of whole frames begin at most."""

LEAST_FILL = 0.6
"""Share of the firings of the lower half of the lasers that return. Whole frames of KITTI have 0.77
to 0.95, every second point of one 0.48."""

FEW_RETURNS = "fewer returns from the ground than a whole frame has"

DARK, MOST_DARK = 0.05, 0.002
"""Reflectance, share: where so many are nearly 0, some are 0. KITTI's whole frames have 0.09 of 0,
and 0.01 to 0.03 between it and this."""

BRIGHT, LAST_REFLECTANCES, FEWEST_NEAR_END = 0.975, 0.1, 60
"""Reflectances, points: scans of KITTI's scanner go on to 0.99, where it saturates; 22 points and
more do in each of 53 whole frames. In a scene without anything so bright few points would come near
the brightest: above 0.9, below 0.99 there are 17 of a frame and more, from 0.8 to 0.9 21 to 336."""

MOST_SINGLE_HOLES, SAME_RANGE, NEAR_HOLES = 0.0034, 0.005, 15.0
"""Share of the firings of the lower half of the lasers without a return, of those whose neighbours
along the ring both have one, nearer than so many metres, at ranges that differ by less than that
share: on a smooth road, which always answers. It is that of the half of the sectors that lacks
least: dark cars lose returns in some sectors, what is left out at random is missing in all. Whole
frames of KITTI have 0.0002 at most, and 0.0036 at least without one point of 200 (24 frames of nine
drives, all of which were looked at, twice each), frames of 8 simulated streets 0.0004 at most. The
limit is near the thinned ones: a road that is wet or worn may lose more than those of nine
drives."""

HOLE_SECTORS, FEWEST_ON_ROAD = 16, 4000
"""Sectors of the firings: what is missing everywhere is missing in half of them; and firings that
could be missed there, at least, so that a few lost ones say nothing."""

FAR_HOLES, MOST_FAR_HOLES, FEWEST_FAR = (25.0, 60.0), 0.05, 400
"""Metres; the same share of all lasers between these ranges; and firings that could be missed. Of
47 frames of KITTI, all of which were looked at, it is 0.007 at most, of ten simulated streets
0.019; where the more returns were left out the farther they are, from 20 m to all at 100 m, 0.1 and
more in the 36 with enough of them. Far roads that are wet lose returns one by one, too."""

WIDEST_HOLE = 8
"""Firings from a return to the next on the same surface: far longer than holes are if every second
one is missing at random (1 of 256), and shorter than what a dark thing leaves."""

MOST_SILENT_ALONE = 190
"""Firings in a row in which one laser has no return and both beside it have one. There are 119 at
most in 47 whole frames of KITTI and 69 in 12 of four simulated streets; a page of a file that was
lost, or was filled with zeros, leaves 256 rows of a laser out."""

MOST_OFF_FIRINGS = 0.1
"""Share of such points in a turn whose extent is reported; KITTI's have none, rounded ones most."""

MOST_TWICE = 0.3
"""Share of a laser's points in a sector that share a firing with another one, in one turn."""

SECTORS, LEAST_SEEN_TWICE, FEWEST_SEEN_TWICE = 72, 30.0, 500
"""Sectors of the horizon; degrees in which most lasers answered twice where a scan holds more than
a turn; points, at least. What is pasted stands in the way of a few lasers, or is narrower."""

LEAST_ANSWERED, ANSWERED_BESIDE = 0.02, 0.3
"""Share of the firings with a return of a laser that was left out, and of the lasers above and
below. The lasers of KITTI's whole frames have 0.4 and more."""

LEAST_OF_HIGHEST = 0.01
"""Share of the firings of the highest eighth of the lasers, which look to the horizon and above:
where all that stands was taken away nothing answers them. KITTI's whole frames have 0.8."""


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

OWN_CAR_SILENT = "the scanner's own car does not answer"

VOXELS, FEWEST_SHARED, TIMES_SHIFTED = (0.008, 0.01, 0.012, 0.015, 0.02), 40, 4
"""Metres, points, a multiple: edges of voxels whose few means stand near the scanner, as an edit
does. Coarser ones leave means all around, finer ones none. Where a filter left one point a voxel,
hardly two share one of its cells, and many share one of a grid that is shifted by half a cell."""

MOST_FIRED_TWICE = 0.02
"""Share of points that repeat the one of the firing before. A VLP-16 close to its surroundings has
0.008, a VLP-32C 0.0006."""

COORDINATES_KEPT = ("repeated", "reflectances", "padded", "regrouped")
"""Kinds of processing that leave every return where it was measured."""

STILL_COMPARED = (*COORDINATES_KEPT, "lasers", "outliers")
"""Kinds after which the turns before and after still tell what is missing: in the lasers that the
file has. In 17 frames of KITTI without the lowest 1, 3, 8 or 16 lasers, one in the middle or every
fourth, detectors III to V accused none, and found as many removed objects as in whole ones. Of 60
frames after filters of outliers, beside turns with and without, they accused none either."""


def find_processing(
    points: NDArray[np.float32],
    sensor: Sensor,
    generic: GenericResult | None,
    reflectance: NDArray[np.float32] | None = None,
    reading: LatticeReading | None = None,
) -> tuple[Processing, ...]:
    """Say what was done to the scan as a whole; nothing where nothing is known.

    Parameters
    ----------
    points : (N, 3) float32
    sensor : Sensor
    generic : GenericResult or None
        What detector III says by the sensor's lattice.
    reflectance : (N,) float32 or None
        Reflectance of each point, looked at only for an HDL-64E on its lattice.
    reading : LatticeReading or None
        Where the points lie on the sensor's lattice; None: it is read here.
    """
    if sensor.unit:  # steps of a rounding are those of metres
        return (Processing("scaled", f"coordinates are in {sensor.unit}"),)
    found = list(_processing_of_coordinates(points))
    is_float16 = any(step.kind == "float16" for step in found)
    if sensor.turned:
        found.append(Processing("turned", sensor.turned))
    is_edited = generic is not None and generic.verdict == "tampered"
    if sensor.name == HDL64E and len(points) > MOST_OF_TURN and not is_edited:
        found.append(Processing("fused", f"{len(points)} points are more than a turn has"))
    if sensor.off_lattice > 0.0:
        if not (is_float16 and sensor.off_lattice <= OF_FLOAT16):
            found += _processing_off_lattice(points, sensor, reading)
    elif generic is not None and generic.lattice is not None:
        of_lattice = _processing_of_lattice(points, sensor, generic, reading)
        if sensor.name == HDL64E and not found and generic.contradicted & OF_PLACES:
            found += _finely_rounded(points, sensor.lattice, reading)
        is_explained = any(step.kind in ("rounded", "float16", "scaled") for step in found)
        found += [step for step in of_lattice if not (is_explained and step.kind == "moved")]
        if sensor.name != HDL64E or not generic.evidence["order"].used:
            reflectance = None  # another scanner's unit, or neighbours that were sorted apart
        if reflectance is not None:
            found += _processing_of_reflectance(reflectance, points, generic.lattice, reading)
        if sensor.name == HDL64E and _holds_no_pasted_points(generic):
            found = _with_outliers(points, found)
    return tuple(found)


def _processing_off_lattice(
    points: NDArray[np.float32],
    sensor: Sensor,
    reading: LatticeReading | None,
) -> list[Processing]:
    """Why points lie beside the lines of the scanner, unless a rounding explains it."""
    rounding = _rounding(points, _some(points), ROUNDINGS)
    if rounding is not None and sensor.off_lattice <= OF_ROUNDING * rounding[0]:
        return []
    if (factor := _factor_of(points, sensor, reading)) is not None:
        return [Processing("scaled", f"coordinates are metres times {factor:.4g}")]
    steps = _steps_of_axes(points)
    if steps and sensor.off_lattice <= OF_ROUNDING * max(steps):
        return [_rounded_to_steps(steps)]
    return [
        Processing(
            "moved",
            f"points lie {1000 * sensor.off_lattice:.1f} mm beside the lines of the scanner in "
            "the median: deskewed, averaged, rounded, or noise was added",
        )
    ]


def _factor_of(
    points: NDArray[np.float32], sensor: Sensor, reading: LatticeReading | None
) -> float | None:
    """The factor by which all coordinates were multiplied; None: that leaves them off the lines.

    It changes the offset of each line and no slope.
    """
    lattice = sensor.lattice
    if lattice is None:
        return None
    reading = lattice.read(points) if reading is None else reading
    away = np.hypot(points[:, 0], points[:, 1])
    some = (reading.ring >= 0) & (away > NEAR_SCALED[0]) & (away < NEAR_SCALED[1])
    if np.count_nonzero(some) < FEWEST_SCALED:
        return None
    offset = lattice.offset[reading.ring[some]]
    error = reading.line_error[some].astype(np.float64)
    change = float(np.median(error / offset))
    if abs(change) < LEAST_SCALED or np.median(np.abs(error - change * offset)) > OFF_SCALED:
        return None
    return 1.0 + change


def _holds_no_pasted_points(generic: GenericResult) -> bool:
    """Whether nothing but missing returns accuses: pasted points stand alone as outliers do."""
    return generic.verdict != "tampered" or generic.without(MISSING).verdict != "tampered"


def _with_outliers(points: NDArray[np.float32], found: list[Processing]) -> list[Processing]:
    """Add a filter of outliers to what was found, where nothing else leaves points alone or takes
    them. What such a filter takes far away, or off the scanner's own car, was not cropped."""
    others = [step for step in found if step.kind not in COORDINATES_KEPT]
    kept = [step for step in found if step.kind in COORDINATES_KEPT]
    if not all(step.detail.startswith((OWN_CAR_SILENT, "no points beyond")) for step in others):
        return found
    is_short = any(step.detail != OWN_CAR_SILENT for step in others)
    if is_short and np.linalg.norm(points.astype(np.float64), axis=1).max() < FAR_CUT:
        return found
    distances = lone_distances(points)
    soft = max(_softness(each) for each in distances)
    cuts = zip(map(_cut, distances), MOST_CUT, strict=True)
    excess, beyond = max((ratio / most, beyond) for (ratio, beyond), most in cuts)
    if excess > (MOST_CUT_FAR if is_short else 1.0):
        ends = f"hardly any point is farther than {beyond:.1f} m from its neighbours"
    elif soft > (MOST_SOFT_FAR if is_short else MOST_SOFT):
        ends = f"few points are farther than {SOFT_CUT[1]:g} m from their neighbours"
    else:
        return found
    return [*kept, Processing("outliers", f"{ends}, as a filter of outliers leaves a scan")]


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


def cuts_of_outliers(points: NDArray[np.float32]) -> list[tuple[float, float]]:
    """Return how sharply the distances of lone points from their neighbours end, and where.

    Parameters
    ----------
    points : (N, 3) float32
        In the order of the scanner, which makes it quick.

    Returns
    -------
    list of (ratio, distance)
        For the first to the last neighbour of `SPARSE`: points farther from it than 0.8 of the
        distance (metres), to those farther than 1.25 of it, where this is largest. 0 where there
        are too few of them.
    """
    return [_cut(each) for each in lone_distances(points)]


def _softness(distances: NDArray[np.float32]) -> float:
    """How many times as many distances exceed the first of `SOFT_CUT` as the second one."""
    first, second = (len(distances) - np.searchsorted(distances, end) for end in SOFT_CUT)
    return float(first / (second + 5.0)) if first >= LEAST_ABOVE else 0.0


def _cut(distances: NDArray[np.float32]) -> tuple[float, float]:
    """The sharpest end of ascending distances, and where it is."""
    at = np.geomspace(SPARSE[1] / CUT_BELOW, SPARSE[3] / CUT_ABOVE, 60)
    above = len(distances) - np.searchsorted(distances, CUT_BELOW * at)
    beyond = len(distances) - np.searchsorted(distances, CUT_ABOVE * at)
    ratio = np.where(above >= LEAST_ABOVE, above / (beyond + 2.0), 0.0)
    sharpest = int(ratio.argmax())
    return float(ratio[sharpest]), float(at[sharpest])


def _processing_of_reflectance(
    values: NDArray[np.float32],
    points: NDArray[np.float32],
    lattice: SensorLattice,
    reading: LatticeReading | None,
) -> list[Processing]:
    found = []
    in_hundredths = is_in_hundredths(values)
    why = why_rewritten(values) or why_of_no_scene(values)
    if why is None:
        why = why_of_other_points(values, points, reading or lattice.read(points))
    if why is not None:
        found.append(Processing("reflectances", why))
    elif in_hundredths and values.min() > 0.0 and np.mean(values < DARK) > MOST_DARK:
        found.append(Processing("filtered", "no point has a reflectance of 0, as many have"))
    elif in_hundredths and _is_unit_of_kitti(lattice) and (why := _why_none_is_bright(values)):
        found.append(Processing("filtered", why))
    return found


def _why_none_is_bright(values: NDArray[np.float32]) -> str | None:
    """Say up to where reflectances go if many come near their end, as where brighter ones were left
    out; None: they go on to the scanner's largest, or end with few."""
    largest = float(values.max())
    near = int(np.count_nonzero(values > largest - LAST_REFLECTANCES))
    if largest >= BRIGHT or near < FEWEST_NEAR_END:
        return None
    return f"no point has a reflectance above {largest:.2f}, which {near} points come near"


def copies_of_earlier(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which points repeat an earlier one to the bit; points at the origin do not.

    Parameters
    ----------
    points : (N, 3) float32
    """
    order, same = _equal_rows(points)
    copies = np.zeros(len(points), np.bool_)
    copies[order[1:][same]] = True  # a stable sort leaves the first of equal rows in front
    return copies & points.any(axis=1)


def _equal_rows(points: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """An order in which equal rows follow each other, and which rows equal the one before."""
    words = np.ascontiguousarray(points).view(np.uint32).astype(np.uint64)
    order = np.lexsort((words[:, 2], words[:, 1], words[:, 0]))
    return order, (words[order[1:]] == words[order[:-1]]).all(axis=1)


def one_of_each(
    points: NDArray[np.float32], copies: NDArray[np.bool_], reading: LatticeReading
) -> NDArray[np.bool_]:
    """Return which rows are left if each point is kept once: where it stands in the file's order.

    That is the first of its places between rows, of points that are not repeated, before and behind
    which the scanner writes it; else the first of all its places.

    Parameters
    ----------
    points : (N, 3) float32
    copies : (N,) bool
        As for `copies_of_earlier`.
    reading : LatticeReading
        Where the points lie on the lattice.
    """
    order, same = _equal_rows(points)
    group = np.empty(len(points), np.int64)
    group[order] = np.cumsum(np.r_[False, ~same])
    is_single = ~np.isin(group, group[copies])
    place = reading.ring + reading.azimuth.astype(np.float64) / (2.0 * math.pi)
    rows = np.flatnonzero(~is_single & points.any(axis=1))
    single = np.flatnonzero(is_single & (reading.ring >= 0))
    behind = np.searchsorted(single, rows)
    around = np.r_[-math.inf, place[single], math.inf]
    in_order = (around[behind] <= place[rows]) & (place[rows] <= around[behind + 1])
    best = rows[np.lexsort((rows, ~in_order, group[rows]))]
    first = np.r_[True, np.diff(group[best]) != 0] if len(best) else np.empty(0, np.bool_)
    kept = np.ones(len(points), np.bool_)
    kept[rows] = False
    kept[best[first]] = True
    return kept


def are_fired_twice(
    points: NDArray[np.float32], copies: NDArray[np.bool_], lattice: SensorLattice
) -> bool:
    """Return whether all copies are of the same laser's firing before, with the azimuth it had.

    Scanners whose azimuths are interpolated between packets say the same one of two firings now and
    then, and a wall is at the same range in many.

    Parameters
    ----------
    points : (N, 3) float32
        In the order of the scanner.
    copies : (N,) bool
        As for `copies_of_earlier`.
    lattice : SensorLattice
    """
    rows = np.flatnonzero(copies)
    if not lattice.is_exact or len(rows) > MOST_FIRED_TWICE * len(points):
        return False
    again = points[rows]
    found = np.zeros(len(rows), np.bool_)
    for back in range(1, 2 * len(lattice.slope) + 1):  # rows without a return may be left out
        found |= (points[np.maximum(rows - back, 0)] == again).all(axis=1)
    return bool(found.all()) and len(np.unique(again, axis=0)) == len(again)


def padding(scan: LidarFrame, sensor: Sensor) -> tuple[Processing, ...]:
    """Say of a scan of an HDL-64E that it has rows without a return, which its files do not have.

    Scanners that write a row for each firing have such rows by themselves.

    Parameters
    ----------
    scan : LidarFrame
        In the file's own coordinates.
    sensor : Sensor
    """
    if sensor.name != HDL64E:
        return ()
    empty = scan.num_points - int(np.count_nonzero(scan.points.any(axis=1)))
    counts = ((empty, "x, y and z of 0"), (scan.num_dropped, "no coordinates (NaN)"))
    return tuple(
        Processing("padded", f"{number} {'row has' if number == 1 else 'rows have'} {words}")
        for number, words in counts
        if number
    )


def _processing_of_coordinates(points: NDArray[np.float32]) -> list[Processing]:
    if len(points) == 0:
        return []
    some = _some(points)
    if _is_float16(some) and _is_float16(points):
        return [Processing("float16", "all coordinates are numbers of 16 bits")]
    if not is_in_metres(some):
        return []
    if (rounding := _rounding(points, some, ROUNDINGS)) is not None:
        return [Processing("rounded", rounding[1])]
    near = some[np.abs(some) < FIVE_DIGITS_TO]
    has_finer = len(near) > 0 and _share_rounded(near, 1e-3) < 0.5
    if has_finer and has_whole_millimetres(points, FIVE_DIGITS_TO):
        return [Processing("rounded", "coordinates have five significant digits")]
    step = _rounded_to_digits(points, some)
    return [] if step is None else [step]


def _some(points: NDArray[np.float32]) -> NDArray[np.float32]:
    return points[:: max(1, len(points) // SAMPLE)]


def _finely_rounded(
    points: NDArray[np.float32], lattice: SensorLattice | None, reading: LatticeReading | None
) -> list[Processing]:
    """A rounding to steps that other scanners write, or to any, if it explains where points lie;
    that to the scanner's own steps, counted from 0, tells nothing."""
    rounding = _rounding(points, _some(points), FINE_ROUNDINGS)
    if rounding == (FINE_ROUNDINGS[-1], _in_words(FINE_ROUNDINGS[-1])) or lattice is None:
        return []
    steps = _steps_of_axes(points) if rounding is None else [rounding[0]]
    off = np.abs((lattice.read(points) if reading is None else reading).line_error)
    if not steps or np.median(off) > OF_ROUNDING * max(steps) + OWN_ROUNDING:
        return []
    if rounding is not None:
        return [Processing("rounded", rounding[1])]
    return [_scaled_to_step(points, steps, lattice) or _rounded_to_steps(steps)]


def _scaled_to_step(
    points: NDArray[np.float32], steps: Sequence[float], lattice: SensorLattice
) -> Processing | None:
    """The factor that made the scanner's own step the step of all axes; None: that was not it."""
    if not lattice.coordinate_step or np.ptp(steps) > SAME_STEP * min(steps):
        return None
    factor = steps[0] / lattice.coordinate_step
    undone = (points / factor).astype(np.float32)
    if generic_consistency(undone, lattice=lattice).contradicted:
        return None
    return Processing("scaled", f"coordinates are metres times {factor:.4g}")


def _rounded_to_steps(steps: Sequence[float]) -> Processing:
    """The rounding to one step, or to one of each axis."""
    several = [f"{1000.0 * step:.3g}" for step in steps]
    words = " and ".join(
        (", ".join(several[:-1]), several[-1]) if len(set(several)) > 1 else several[:1]
    )
    return Processing("rounded", f"coordinates are whole steps of {words} mm from an offset")


def _steps_of_axes(points: NDArray[np.float32]) -> list[float]:
    """Steps, in metres, of which x, y and z are whole numbers from a place; empty: one is not."""
    steps = [_step_of(coordinates) for coordinates in points.T]
    return [] if None in steps else [step for step in steps if step is not None]


def _step_of(coordinates: NDArray[np.float32]) -> float | None:
    """The step, in metres, of which coordinates are whole numbers from a place; None: of none.

    The smallest difference between two is a few steps, and counting them from one coordinate to the
    next tells the step exactly.
    """
    values = np.unique(coordinates[np.abs(coordinates) < NEAR_STEPS]).astype(np.float64)
    if len(values) < FEWEST_STEPS:
        return None
    apart = np.diff(values)
    smallest = float(np.percentile(apart, 0.1))
    smallest = float(np.median(apart[apart < 1.01 * smallest + SINGLE * NEAR_STEPS]))
    for number in range(1, MOST_STEPS_APART + 1):
        if not LEAST_STEP <= smallest / number <= MOST_STEP:
            continue
        count = np.cumsum(np.round(np.diff(values, prepend=values[0]) * (number / smallest)))
        step, start = np.polyfit(count, values, 1)
        off = np.abs(values - (start + step * count))
        if np.mean(off < SINGLE * NEAR_STEPS) > 0.999:
            return float(step)
    return None


def _rounding(
    points: NDArray[np.float32], some: NDArray[np.float32], steps: Sequence[float]
) -> tuple[float, str] | None:
    """The coarsest of some steps that all coordinates are whole numbers of, or are so from a place
    that the file states, as of LAS; in words, too."""
    few, place = some[::FEW], some[0].astype(np.float64)
    for step in steps:
        if _are_rounded((few, some, points), step):
            return step, _in_words(step)
        if _are_rounded((few, some, points), step, place):
            return step, f"coordinates are whole steps of {1000 * step:g} mm from an offset"
    return None


def _in_words(step: float) -> str:
    return f"coordinates are whole numbers of {1000 * step:g} mm"


def _rounded_to_digits(points: NDArray[np.float32], some: NDArray[np.float32]) -> Processing | None:
    """Coordinates of three or four digits: far ones are whole numbers, and near ones are not."""
    few = some[::FEW]
    for step, words in ((0.1, "three"), (0.01, "four")):
        if not _are_rounded((_far_of(few), _far_of(some)), step):
            continue
        far, near = _far_of(points), some[np.abs(some) < FAR_DIGITS]
        if len(far) < FEWEST_FAR_DIGITS or not len(near) or _share_rounded(near, step) > 0.5:
            continue
        if _are_rounded((far,), step):
            return Processing("rounded", f"coordinates have {words} significant digits")
    return None


def _far_of(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coordinates of two digits before the point."""
    lengths = np.abs(points)
    return points[(lengths >= FAR_DIGITS) & (lengths < 10.0 * FAR_DIGITS)]


def _are_rounded(
    samples: Sequence[NDArray[np.float32]], step: float, start: NDArray[np.float64] | float = 0.0
) -> bool:
    """Whether coordinates are whole numbers of a step: first of a few, which are quick to try."""
    *tried, points = samples
    return all(
        len(each) > 0 and _share_rounded(each, step, start) > least
        for each, least in (*((each, 0.99) for each in tried), (points, 0.999))
    )


def _is_float16(points: NDArray[np.float32]) -> bool:
    with np.errstate(over="ignore"):
        return np.array_equal(points.astype(np.float16).astype(np.float32), points)


def _share_rounded(
    points: NDArray[np.float32], step: float, start: NDArray[np.float64] | float = 0.0
) -> float:
    """Share of coordinates that are whole numbers of a step from a place."""
    wide = points.astype(np.float64)
    steps = (wide - start) / step
    off = np.abs(steps - np.round(steps)) * step
    return float(np.mean(off < 1e-5 + 1e-6 * np.abs(wide)))


def _processing_of_lattice(
    points: NDArray[np.float32],
    sensor: Sensor,
    generic: GenericResult,
    reading: LatticeReading | None,
) -> list[Processing]:
    found = []
    contradicted, lattice = generic.contradicted, sensor.lattice
    if sensor.is_own:  # such a lattice tells neither the order of the points nor what is missing
        fused = Processing("fused", "most directions hold several returns")
        return [fused] if "duplicate" in contradicted else []
    if "line" in contradicted:
        return [Processing("moved", "points lie beside the lines of the scanner everywhere")]
    if "order" in contradicted:
        rearranged = _rearranged(points, generic)
        if rearranged is not None:
            return [rearranged]
        found.append(Processing("shuffled", "the points are not in the order of the scanner"))
        if generic.verdict == "tampered" and (edge := edge_of_voxels(points)):
            detail = f"points that shared a voxel of {1000.0 * edge:g} mm became their mean"
            found.append(Processing("averaged", detail))
    if contradicted & OF_PLACES:
        names = ", ".join(sorted(contradicted & OF_PLACES))
        kind = "turned" if _is_turned_by_part_of_step(points, sensor, reading) else "moved"
        detail = f"coordinates were changed everywhere (contradicted: {names})"
        is_on_grid = lattice is not None and lattice.coordinate_step > 0.0
        if kind == "moved" and is_on_grid and not contradicted & {"grid", "step"}:
            kind, detail = "rounded", CUT_OFF
        found.append(Processing(kind, detail))
    elif "place" in contradicted:
        found.append(
            Processing(
                "rounded",
                "coordinates are not roundings of places where the scanner measures: they were "
                "rounded twice or cut off, or noise of less than a millimetre was added",
            )
        )
    if "duplicate" in contradicted:
        found.append(Processing("fused", "most directions hold several returns"))
    elif (twice := _degrees_seen_twice(points, sensor, generic, reading)) >= LEAST_SEEN_TWICE:
        found.append(Processing("fused", f"{twice:.0f} degrees of azimuth were seen twice"))
    if contradicted & {"grid", "step"}:  # no point is on its firing: nothing tells which answered
        return found
    return found + _processing_of_extent(
        points, lattice, reading, is_in_order=generic.evidence["order"].used
    )


def edge_of_voxels(points: NDArray[np.float32]) -> float:
    """Return the edge, in metres, of voxels in which a filter left one point each; 0: none did.

    Cells are counted from 0, or from half an edge below the least coordinates, as filters do.

    Parameters
    ----------
    points : (N, 3) float32
    """
    for edge in VOXELS:
        for start in (np.zeros(3), points.min(axis=0).astype(np.float64) - 0.5 * edge):
            shared = _number_sharing_cells(points, edge, start)
            shifted = _number_sharing_cells(points, edge, start + 0.5 * edge)
            if shifted >= FEWEST_SHARED and TIMES_SHIFTED * shared < shifted:
                return edge
    return 0.0


def _number_sharing_cells(
    points: NDArray[np.float32], edge: float, start: NDArray[np.float64]
) -> int:
    """Number of points beside the first of each cell of a grid."""
    # Filters whose cells begin at 0 compute in single precision: a point on a face is in one cell.
    own = np.float32 if not start.any() else np.float64
    cells = np.floor((points - start.astype(own)) * own(1.0 / edge)).astype(np.int64)
    cells -= cells.min(axis=0)
    sides = cells.max(axis=0) + 1
    numbers = (cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2]
    return len(points) - len(np.unique(numbers))


FAR_ENOUGH, LEAST_ALIKE, LEAST_TURN = 10.0, 0.5, 0.01
"""Metres; length of the mean direction; share of a step. Points so far away, whose azimuths do not
suffer from rounding, stand beside the scanner's steps by one part of a step where all were turned.
It is 0.001 at most where they were scaled, cut, made 16 bits or noisy by a millimetre."""


def _is_turned_by_part_of_step(
    points: NDArray[np.float32], sensor: Sensor, reading: LatticeReading | None
) -> bool:
    """Whether azimuths are steps of the scanner, all turned by a part of one about the vertical."""
    lattice = sensor.lattice
    if lattice is None or not lattice.steps:
        return False
    reading = lattice.read(points) if reading is None else reading
    away = np.hypot(points[:, 0], points[:, 1])
    far = (reading.ring >= 0) & (reading.count >= 0) & (away > FAR_ENOUGH)
    if not far.any():
        return False
    steps = reading.step_error[far] * (lattice.steps / (2.0 * math.pi)) / away[far]
    angles = 2.0 * math.pi * steps.astype(np.float64)
    cosine, sine = float(np.mean(np.cos(angles))), float(np.mean(np.sin(angles)))
    turn = abs(math.atan2(sine, cosine)) / (2.0 * math.pi)
    return math.hypot(cosine, sine) > LEAST_ALIKE and turn > LEAST_TURN


REARRANGED = (
    ("reversed", "the points are in the reverse order of the scanner", 1, -1),
    ("mirrored", "the scan is a mirror image, left and right exchanged or front and back", -1, 1),
    ("mirrored", "the scan is a mirror image in the reverse order of the scanner", -1, -1),
)
"""Ways to rearrange a scan: kind, words, sign of y, and the direction in which rows follow each
other. A mirror image in x is one in y that was turned."""


def _rearranged(points: NDArray[np.float32], generic: GenericResult) -> Processing | None:
    """The way a scan was rearranged, if undoing it leaves neither order nor steps contradicted."""
    for kind, words, sign, direction in REARRANGED:
        undone = points[::direction] * np.array([1, sign, 1], np.float32)
        told = generic_consistency(
            np.ascontiguousarray(undone, np.float32), lattice=generic.lattice
        )
        if not told.contradicted & {"order", "step"}:
            return Processing(kind, words)
    return None


def _degrees_seen_twice(
    points: NDArray[np.float32],
    sensor: Sensor,
    generic: GenericResult,
    reading: LatticeReading | None,
) -> float:
    """Degrees of azimuth in which most lasers have two returns a firing: more than one turn."""
    lattice = sensor.lattice
    if lattice is None or not lattice.steps:
        return 0.0
    if not generic.evidence["duplicate"].strength > FEWEST_SEEN_TWICE:
        return 0.0
    reading = lattice.read(points) if reading is None else reading
    known = (reading.ring >= 0) & (reading.count >= 0)
    firing = reading.ring[known].astype(np.int64) * lattice.steps + reading.count[known]
    returns = np.bincount(firing)[firing]
    sector = (reading.azimuth[known] * (SECTORS / (2.0 * math.pi))).astype(np.intp)
    place = sector.clip(0, SECTORS - 1) * len(lattice.slope) + reading.ring[known]
    size = SECTORS * len(lattice.slope)
    several = np.bincount(place[returns > 1], minlength=size)
    is_double = several > MOST_TWICE * np.bincount(place, minlength=size)
    lasers = is_double.reshape(SECTORS, -1).mean(axis=1)
    return float(np.count_nonzero(lasers > 0.5) * 360.0 / SECTORS)


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
    is_scaled = step_m > 0.0 and _share_rounded(some, step_m) < 1.0 - MOST_OFF_FIRINGS
    if np.mean(is_off) > MOST_OFF_FIRINGS or is_scaled:
        for step in _processing_of_coordinates(turn.points):
            return Lacking(f"{step.kind}: {step.detail}", is_in_place=True)
        return Lacking("moved to where the scanner does not measure", is_in_place=False)
    steps = _processing_of_extent(turn.points, lattice, reading, is_in_order=False)
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


def _processing_of_extent(
    points: NDArray[np.float32],
    lattice: SensorLattice | None,
    reading: LatticeReading | None,
    *,
    is_in_order: bool,
) -> list[Processing]:
    """Find what was cut off or thinned out, and whether the rings begin elsewhere than usual.

    Each kind of cut leaves silence: firings that have no return although those beside them do.
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
    thinned = [] if firings is None else _thinned(firings, distance, whole=gap <= CHANCE_GAP)
    is_thin = any(step.detail == FEW_RETURNS for step in thinned)
    if not is_whole_turn and not (is_thin and gap <= CHANCE_GAP):
        found.append(Processing("cropped", f"no points in {gap:.0f} degrees of azimuth"))
    found += [Processing("cropped", cut) for _, cut in _cuts_far_away(wide, distance, firings)]
    if distance.min() > NEAREST_RANGE and _lowest_are_silent(reading, lattice):
        found.append(Processing("cropped", f"no points nearer than {distance.min():.1f} m"))
    if is_whole_turn and not thinned and narrow_gaps >= FEWEST_GAPS and _is_unit_of_kitti(lattice):
        detail = f"no points in {narrow_gaps} sectors of {NARROW_GAP:g} degrees of azimuth and more"
        found.append(Processing("cropped", detail))
    top, bottom = (0, 0) if firings is None else _silent_at_the_ends(firings, lattice)
    for which, silent in (("highest", top), ("lowest", bottom)):
        if silent:
            lasers = "laser has" if silent == 1 else f"{silent} lasers have"
            found.append(Processing("lasers", f"the {which} {lasers} nearly no returns"))
    turned = _turned(reading) if is_whole_turn and is_in_order else []
    is_as_mounted = not (found or thinned or turned)  # else the own car may be cut off or elsewhere
    if is_as_mounted and _own_car_is_silent(reading, distance, lattice):
        found.append(Processing("cropped", OWN_CAR_SILENT))
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
    if firings is not None and _highest_are_silent(firings):
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


def _own_car_is_silent(
    reading: LatticeReading, distance: NDArray[np.float64], lattice: SensorLattice
) -> bool:
    """Whether what KITTI's own car returns is not there; other scanners stand on other cars."""
    lowest = reading.ring >= len(lattice.slope) - len(lattice.slope) // 8
    to_a_side = 180.0 - np.abs(180.0 - np.degrees(reading.azimuth[lowest & (distance < OWN_CAR)]))
    least, most = OF_OWN_CAR
    of_car = int(np.count_nonzero((to_a_side > least) & (to_a_side < most)))
    return _is_unit_of_kitti(lattice) and of_car < FEWEST_OF_OWN_CAR


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


def _thinned(firings: Firings, distance: NDArray[np.float64], *, whole: bool) -> list[Processing]:
    """Points that were left out here and there, or laser by laser."""
    found: list[Processing] = []
    rings, reach = len(firings.answered), _reach(firings, distance)
    lower, lowest = (slice(first, (7 * rings) // 8) for first in ((3 * rings) // 8, rings // 2))
    below = firings.answered[lower]
    if whole and np.count_nonzero(below) < LEAST_FILL * below.size:
        found.append(Processing("thinned", FEW_RETURNS))
    elif _single_holes(firings, reach, lowest) > MOST_SINGLE_HOLES:
        lost = _share_left_out(reach[lowest])
        found.append(
            Processing("thinned", f"{lost:.1%} of the returns are missing one by one everywhere")
        )
    elif _single_holes(firings, reach, slice(None), FAR_HOLES, FEWEST_FAR) > MOST_FAR_HOLES:
        detail = f"returns farther than {FAR_HOLES[0]:g} m are missing one by one everywhere"
        found.append(Processing("thinned", detail))
    if silent := len(_silent_between(firings)):
        found.append(Processing("lasers", f"{silent} of the {rings} lasers have no returns"))
    elif not found and (lost := _longest_silence_alone(firings)) > MOST_SILENT_ALONE:
        detail = f"a laser between two that answer has no return in {lost} firings in a row"
        found.append(Processing("thinned", detail))
    return found


def _longest_silence_alone(firings: Firings) -> int:
    """Firings, most of any laser from one return to its next, in which both lasers beside answer.

    One laser meets what those above and below it meet, but for an edge that it runs along.
    """
    answered = firings.answered
    beside = np.cumsum(answered[:-2] & answered[2:], axis=1, dtype=np.int32)
    laser, firing = np.nonzero(answered[1:-1])
    passed = np.diff(beside[laser, firing])
    passed[np.diff(laser) != 0] = 0
    return max(0, int(passed.max(initial=0)) - 1)


def _silent_between(firings: Firings) -> NDArray[np.intp]:
    """Lasers without returns between two that have many."""
    answered = firings.answered.mean(axis=1)
    beside = np.minimum(answered[:-2], answered[2:])
    return 1 + np.flatnonzero((answered[1:-1] < LEAST_ANSWERED) & (beside > ANSWERED_BESIDE))


def silent_lasers(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading | None = None
) -> NDArray[np.intp]:
    """Return the lasers that a file lacks, as processing of the kind ``lasers`` counts them.

    Parameters
    ----------
    points : (N, 3) float32
    lattice : SensorLattice
    reading : LatticeReading or None
        Where the points lie on the lattice; None: it is read here.
    """
    rings = len(lattice.slope)
    firings = firings_of(lattice.read(points) if reading is None else reading, rings)
    if firings is None:
        return np.empty(0, np.intp)
    top, bottom = _silent_at_the_ends(firings, lattice)
    ends = np.r_[:top, rings - bottom : rings]
    return np.union1d(_silent_between(firings), ends)


def _single_holes(
    firings: Firings,
    reach: NDArray[np.float64],
    lasers: slice,
    metres: tuple[float, float] = (0.0, NEAR_HOLES),
    fewest: int = FEWEST_ON_ROAD,
) -> float:
    """Share of firings without a return among those between two with one on a smooth surface.

    That of the half of the sectors that lacks least. It is high for any loss that leaves a return
    on either side of each hole, as of every third point: `_share_left_out` says how many are lost.
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
    """Metres that each laser measured at each firing; 0: no return."""
    reach = np.zeros(firings.answered.size)
    reach[firings.cells] = distance[firings.rows]
    return reach.reshape(firings.answered.shape)


def _share_left_out(reach: NDArray[np.float64]) -> float:
    """Share of the returns of a smooth near surface that are missing, in the median sector.

    A firing without a return counts if it lies between two of its laser, at most `WIDEST_HOLE`
    firings apart, that have one on the same surface.
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


def _highest_are_silent(firings: Firings) -> bool:
    """Whether nothing answers the highest eighth of the lasers."""
    highest = firings.answered[: max(1, len(firings.answered) // 8)]
    return bool(np.count_nonzero(highest) < LEAST_OF_HIGHEST * highest.size)


def _silent_at_the_ends(firings: Firings, lattice: SensorLattice) -> tuple[int, int]:
    """Lasers without returns above and below one with many, as in a file that ends too early.

    How few returns are none was measured on the unit of KITTI. The lowest lasers of another
    HDL-64E may mostly meet its own carrier, and those of other scanners may always do. Where the
    highest eighth is silent, it is what stands that was taken away, not lasers.
    """
    if not is_hdl64e(lattice):
        return 0, 0
    answered = firings.answered.mean(axis=1)
    is_heard = answered >= LEAST_ANSWERED if _is_unit_of_kitti(lattice) else answered > 0.0
    heard = np.flatnonzero(is_heard)
    if not len(heard):
        return 0, 0
    top, last = int(heard[0]), int(heard[-1])
    bottom = len(answered) - 1 - last
    is_top = answered[top] > ANSWERED_BESIDE and not _highest_are_silent(firings)
    return top if is_top else 0, bottom if answered[last] > ANSWERED_BESIDE else 0


def _is_unit_of_kitti(lattice: SensorLattice) -> bool:
    return np.array_equal(lattice.slope, kitti_lattice().slope)
