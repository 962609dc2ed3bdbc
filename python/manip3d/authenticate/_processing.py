"""Find processing of a whole scan from its coordinates, its lattice and its reflectances."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d.authenticate._exact_thinning import thinned_exactly
from manip3d.authenticate._extent import (
    OWN_CAR_SILENT,
    processing_of_extent,
    processing_of_own,
)
from manip3d.authenticate._generic import MISSING, generic_consistency
from manip3d.authenticate._outliers import why_filtered
from manip3d.authenticate._reflectance import (
    is_in_hundredths,
    why_of_no_scene,
    why_of_other_points,
    why_rewritten,
)
from manip3d.authenticate._roundings import (
    finely_rounded,
    processing_of_coordinates,
    processing_off_lattice,
)
from manip3d.authenticate._sensors import HDL64E, is_of_two_scanners, is_unit_of_kitti
from manip3d.authenticate._verdict import Processing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate._generic import GenericResult
    from manip3d.authenticate._lattice import LatticeReading, SensorLattice
    from manip3d.authenticate._sensors import Sensor
    from manip3d.lidar import LidarFrame

MAX_OFF_FLOAT16 = 0.01
"""Metres: largest median distance from the lines that is due to 16-bit floats. Their steps are 4 mm
from 4 to 8 m, and 31 mm from 32 to 64 m."""

PLACE_EVIDENCE = {"grid", "step", "range"}
"""Kinds of evidence that all points contradict if all coordinates change by a millimetre."""

OFF_FIRING = {"grid", "step"}
"""Kinds of evidence that all points contradict if no point is on its firing."""

CUT_OFF = (
    "coordinates are whole millimetres and the scanner's ranges are not: they were cut off, "
    "rounded twice, or all ranges were changed"
)

MAX_OF_TURN = 150_000
"""Largest number of points of one turn of an HDL-64E: 64 lasers fire 2083 times, or up to a tenth
more often."""

DARK, MAX_DARK = 0.05, 0.002
"""If more than the share MAX_DARK of the reflectances is below DARK, some must be 0. In KITTI's
whole frames the share of 0 is 0.09, and that of values between 0 and DARK is 0.01 to 0.03."""

BRIGHT, LAST_REFLECTANCES, MIN_NEAR_END = 0.975, 0.1, 60
"""Bright points were left out if the largest reflectance is below BRIGHT and at least
MIN_NEAR_END points are within LAST_REFLECTANCES of it. KITTI's scanner saturates at 0.99, which
at least 22 points of each of 53 whole frames reach. In a scene without bright surfaces few points
would be near the largest value: each frame has at least 17 points from 0.9 to 0.99, and 21 to 336
from 0.8 to 0.9."""

MAX_TWICE = 0.3
"""Largest share of a laser's points in a sector that share a firing with another point, if the scan
is one turn."""

SECTORS, MIN_DEGREES_SEEN_TWICE, MIN_POINTS_SEEN_TWICE = 72, 30.0, 500
"""SECTORS: number of sectors of the horizon. A scan holds more than one turn if most lasers have
two returns per firing in at least MIN_DEGREES_SEEN_TWICE degrees of azimuth, and if there are more
than MIN_POINTS_SEEN_TWICE such points. Pasted objects are met by few lasers, or are narrower."""

EDGES = np.arange(40, 501) * 1e-4
"""Edges of voxels that are tried, metres. Coarser voxels leave means all around, and finer ones
none."""

MAX_CLOSE, MAX_PAIRS = 5000, 2000
"""Numbers of points, those with the closest neighbours, and of their closest pairs, from which the
edge of voxels is found."""

MAX_SHARED, VOXEL_RATE = 0.25, 0.01
"""A filter left one point per voxel if at most MAX_SHARED times as many close pairs share a cell of
its grid as share one of a grid anywhere, and this has a probability of at most VOXEL_RATE, with all
grids that are tried. Coordinates that are rounded afterwards may leave their cell."""

FAR_FROM_MEANS, MEANS_PER_PAIR = 3.0, 2.0
"""Few means of voxels (of 2 to 15 points in clean clouds) do not show a filter surely. Points off
the lattice may be such means if they are nearer to other points than FAR_FROM_MEANS edges, and not
more than MEANS_PER_PAIR times the close pairs that share a voxel elsewhere. Clean clouds have up to
1.7 times as many."""

TWO_SCANNERS = (
    "points in most directions lie beside the lines of the scanner, as those of another one do"
)

COORDINATES_KEPT = ("repeated", "reflectances", "padded", "regrouped")
"""Kinds of processing that move and remove no return."""

STILL_COMPARED = (*COORDINATES_KEPT, "lasers", "outliers")
"""Kinds of processing after which detectors IV and V can still compare the scan with its
neighbours, in the lasers that it has. Without the lowest 1, 3, 8 or 16 lasers, one in the middle or
every fourth laser, none of 17 frames of KITTI was accused by detectors III to V, and as many
removed objects were found as in whole frames. None of 60 frames after filters of outliers was
accused either, with filtered and unfiltered neighbours."""


def find_processing(
    points: NDArray[np.float32],
    sensor: Sensor,
    generic: GenericResult | None,
    reflectance: NDArray[np.float32] | None = None,
    reading: LatticeReading | None = None,
) -> tuple[Processing, ...]:
    """Return the processing of the scan as a whole; empty if none is recognised.

    Parameters
    ----------
    points : (N, 3) float32
        Points with the scanner at the origin.
    sensor : Sensor
        The scanner.
    generic : GenericResult or None
        Result of detector III by the sensor's lattice.
    reflectance : (N,) float32 or None
        Reflectance of each point; only used for an HDL-64E on its lattice.
    reading : LatticeReading or None
        Places of the points on the sensor's lattice; None: they are computed here.
    """
    if sensor.unit:  # steps of roundings only apply to metres
        return (Processing("scaled", f"coordinates are in {sensor.unit}"),)
    found = list(processing_of_coordinates(points))
    is_float16 = any(step.kind == "float16" for step in found)
    if sensor.turned:
        found.append(Processing("turned", sensor.turned))
    is_edited = generic is not None and generic.verdict == "tampered"
    if sensor.name == HDL64E and len(points) > MAX_OF_TURN and not is_edited:
        found.append(Processing("fused", f"{len(points)} points are more than a turn has"))
    if sensor.off_lattice > 0.0:
        if not (is_float16 and sensor.off_lattice <= MAX_OFF_FLOAT16):
            found += processing_off_lattice(points, sensor, reading)
    elif generic is not None and generic.lattice is not None:
        of_lattice = _processing_of_lattice(points, sensor, generic, reading)
        if sensor.name == HDL64E and not found and generic.contradicted & PLACE_EVIDENCE:
            found += finely_rounded(points, sensor.lattice, reading)
        if _holds_two_scanners(points, sensor, generic, reading):
            found.append(Processing("fused", TWO_SCANNERS))
        is_explained = any(step.kind in ("rounded", "float16", "scaled") for step in found)
        found += [step for step in of_lattice if not (is_explained and step.kind == "moved")]
        if sensor.name != HDL64E or not generic.evidence["order"].used:
            reflectance = None  # the unit differs, or rows are no neighbours
        if reflectance is not None:
            found += _processing_of_reflectance(reflectance, points, generic.lattice, reading)
        if sensor.name == HDL64E and _holds_no_pasted_points(generic):
            found = _with_outliers(points, found)
    return tuple(found)


def _holds_two_scanners(
    points: NDArray[np.float32],
    sensor: Sensor,
    generic: GenericResult,
    reading: LatticeReading | None,
) -> bool:
    """Whether a scan of another scanner seems to be fused with that of a known one."""
    if sensor.is_own or sensor.lattice is None or generic.values_changed:
        return False
    return is_of_two_scanners(points, reading or sensor.lattice.read(points))


def _holds_no_pasted_points(generic: GenericResult) -> bool:
    """Whether at most missing returns accuse the scan; pasted points can look like outliers."""
    return generic.verdict != "tampered" or generic.without(MISSING).verdict != "tampered"


def _with_outliers(points: NDArray[np.float32], found: list[Processing]) -> list[Processing]:
    """Add a filter of outliers to the processing, if no other processing explains missing points.

    The filter replaces a crop of far points, or of the scanner's own car, which it can also
    cause.
    """
    others = [step for step in found if step.kind not in COORDINATES_KEPT]
    kept = [step for step in found if step.kind in COORDINATES_KEPT]
    if not all(step.detail.startswith((OWN_CAR_SILENT, "no points beyond")) for step in others):
        return found
    is_short = any(not step.detail.startswith(OWN_CAR_SILENT) for step in others)
    if (ends := why_filtered(points, is_short=is_short)) is None:
        return found
    return [*kept, Processing("outliers", f"{ends}, as a filter of outliers leaves a scan")]


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
    elif in_hundredths and values.min() > 0.0 and np.mean(values < DARK) > MAX_DARK:
        found.append(Processing("filtered", "no point has a reflectance of 0, as many have"))
    elif in_hundredths and is_unit_of_kitti(lattice) and (why := _why_none_is_bright(values)):
        found.append(Processing("filtered", why))
    return found


def _why_none_is_bright(values: NDArray[np.float32]) -> str | None:
    """Return in words why brighter points seem to be left out; None if they do not."""
    largest = float(values.max())
    near = int(np.count_nonzero(values > largest - LAST_REFLECTANCES))
    if largest >= BRIGHT or near < MIN_NEAR_END:
        return None
    return f"no point has a reflectance above {largest:.2f}, which {near} points come near"


def padding(scan: LidarFrame, sensor: Sensor) -> tuple[Processing, ...]:
    """Report rows without a return in a scan of an HDL-64E, whose files do not have them.

    Scanners that write a row for each firing have such rows in clean scans.

    Parameters
    ----------
    scan : LidarFrame
        Scan in the file's own coordinates.
    sensor : Sensor
        The scanner.
    """
    if sensor.name != HDL64E:
        return ()
    x, y, z = scan.points.T
    empty = int(np.count_nonzero((x == 0.0) & (y == 0.0) & (z == 0.0)))
    counts = ((empty, "x, y and z of 0"), (scan.num_dropped, "no coordinates (NaN)"))
    return tuple(
        Processing("padded", f"{number} {'row has' if number == 1 else 'rows have'} {words}")
        for number, words in counts
        if number
    )


def _processing_of_lattice(
    points: NDArray[np.float32],
    sensor: Sensor,
    generic: GenericResult,
    reading: LatticeReading | None,
) -> list[Processing]:
    """Return what was done to the whole cloud: the rules of its lattice that it breaks everywhere.

    A single place that breaks a rule was edited; all of them show processing.
    """
    found = []
    contradicted, lattice = generic.contradicted, sensor.lattice
    if sensor.is_own:  # such a lattice knows neither order nor what lies outside of its lines
        if "duplicate" in contradicted:
            return [Processing("fused", "most directions hold several returns")]
        if lattice is not None and lattice.is_exact:
            return _averaged(points, generic) or thinned_exactly(points, lattice, reading)
        if sensor.name != HDL64E or lattice is None or contradicted & OFF_FIRING:
            return []
        return processing_of_own(points, lattice, reading)
    if "line" in contradicted:
        return [Processing("moved", "points lie beside the lines of the scanner everywhere")]
    if "order" in contradicted:
        rearranged = _rearranged(points, generic)
        if rearranged is not None:
            return [rearranged]
        found.append(Processing("shuffled", "the points are not in the order of the scanner"))
        found += _averaged(points, generic)
    if contradicted & PLACE_EVIDENCE:
        names = ", ".join(sorted(contradicted & PLACE_EVIDENCE))
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
    elif (twice := _degrees_seen_twice(points, sensor, generic, reading)) >= MIN_DEGREES_SEEN_TWICE:
        found.append(Processing("fused", f"{twice:.0f} degrees of azimuth were seen twice"))
    if contradicted & OFF_FIRING:  # silence is unknown
        return found
    return found + processing_of_extent(
        points, lattice, reading, is_in_order=generic.evidence["order"].used
    )


def _averaged(points: NDArray[np.float32], generic: GenericResult) -> list[Processing]:
    """Whether a filter of voxels left means, which are off the lattice as edits are."""
    if generic.verdict != "tampered":
        return []
    if edge := edge_of_voxels(points):
        detail = f"points that shared a voxel of {1000.0 * edge:.4g} mm became their mean"
        return [Processing("averaged", detail)]
    if edge := edge_of_voxels(points, generic.suspected):
        detail = (
            f"{len(generic.suspected)} points are off the lattice, as the means are that a filter "
            f"of voxels of {1000.0 * edge:.4g} mm would leave"
        )
        return [Processing("averaged", detail)]
    return []


def edge_of_voxels(points: NDArray[np.float32], means: NDArray[np.int64] | None = None) -> float:
    """Return the edge, metres, of voxels in which a filter left one point each; 0: no filter.

    The faces of a filter's cells separate all pairs of close points, and those of another grid
    separate some. Cells begin at 0, or half an edge below the least coordinates, as in common
    filters.

    Parameters
    ----------
    points : (N, 3) float32
    means : (K,) int, optional
        Rows of points that may be the means. With them, an edge is returned if a filter would leave
        as many, and as close to other points; without them, if there was a filter surely.
    """
    away = _core.nearest_distances(points, None, 0.0, 1, None)
    first, second = _closest_pairs(points, away, float(EDGES[-1]))
    apart = np.abs(points[first].astype(np.float64) - points[second])
    farthest, best = apart.max(axis=1, initial=0.0), (0.0, 0.0)
    least = points.min(axis=0, initial=0.0).astype(np.float64)
    for edge in EDGES.tolist():
        close = farthest < edge
        # The probability that two points share a cell of a grid anywhere.
        expected = float(np.prod(1.0 - apart[close] / edge, axis=1).sum())
        for start in (np.zeros(3), least - 0.5 * edge):
            ours = _cells(points[first[close]], edge, start)
            shared = int((ours == _cells(points[second[close]], edge, start)).all(axis=1).sum())
            if shared > MAX_SHARED * expected:
                continue
            # Chernoff's bound of the Poisson law.
            few = shared * math.log(shared / expected) if shared else 0.0
            surely = expected - shared + few
            is_sure = surely > math.log(2 * len(EDGES) / VOXEL_RATE)
            if is_sure or (means is not None and _are_likely(away[means], expected, edge)):
                best = max(best, (surely, edge))
    return best[1]


def _are_likely(away: NDArray[np.float32], expected: float, edge: float) -> bool:
    """Whether points at distances ``away`` from others may be means of as many voxels.

    About as many pairs shared a voxel, and became means, as pairs that are left are ``expected`` to
    share one of a grid anywhere.
    """
    are_close = bool((away < FAR_FROM_MEANS * edge).all())
    return are_close and 0 < len(away) <= MEANS_PER_PAIR * expected


def _cells(points: NDArray[np.float32], edge: float, start: NDArray[np.float64]) -> NDArray[Any]:
    # Filters whose cells begin at 0 compute in single precision, which decides on points on a face.
    own = np.float32 if not start.any() else np.float64
    cells: NDArray[Any] = np.floor((points - start.astype(own)) * own(1.0 / edge))
    return cells


def _closest_pairs(
    points: NDArray[np.float32], away: NDArray[np.float32], reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the closest pairs of points whose coordinates differ by less than ``reach``.

    ``away`` is the distance of each point from its nearest neighbour.
    """
    rows = np.flatnonzero(away < math.sqrt(3.0) * reach)
    rows = rows[np.argsort(away[rows], kind="stable")[:MAX_CLOSE]]
    cells = np.floor(points[rows].astype(np.float64) / reach).astype(np.int64)
    cells -= cells.min(axis=0, initial=0) - 1
    sides = cells.max(axis=0, initial=0) + 2
    numbers = (cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2]
    order = np.argsort(numbers, kind="stable")
    rows, numbers = rows[order], numbers[order]
    found = [np.empty((0, 2), np.int64)]
    for x, y, z in itertools.product((-1, 0, 1), repeat=3):
        there = numbers + (x * sides[1] + y) * sides[2] + z
        begin = np.searchsorted(numbers, there, "left")
        begin = np.maximum(begin, np.arange(len(rows)) + 1)  # each pair once
        count = (np.searchsorted(numbers, there, "right") - begin).clip(0)
        one = np.repeat(np.arange(len(rows)), count)
        other = np.repeat(begin - np.cumsum(count) + count, count) + np.arange(len(one))
        found.append(np.stack([rows[one], rows[other]], axis=1))
    pairs = np.concatenate(found)
    apart = np.abs(points[pairs[:, 0]].astype(np.float64) - points[pairs[:, 1]]).max(axis=1)
    closest = np.argsort(apart, kind="stable")[:MAX_PAIRS]
    closest = closest[apart[closest] < reach]
    return pairs[closest, 0], pairs[closest, 1]


FAR_ENOUGH, MIN_ALIKE, MIN_TURN = 10.0, 0.5, 0.01
"""A scan was turned about the vertical if points farther than FAR_ENOUGH metres, whose azimuths
rounding does not affect, are all off the scanner's steps by the same part of a step: the mean of
the parts, as directions on a circle, has at least the length MIN_ALIKE and is more than
MIN_TURN of a step. That part is at most 0.001 if scans were scaled, cut, converted to 16 bits or
made noisy by a millimetre."""


def _is_turned_by_part_of_step(
    points: NDArray[np.float32], sensor: Sensor, reading: LatticeReading | None
) -> bool:
    """Whether azimuths are the scanner's steps, all turned by one part of a step."""
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
    return math.hypot(cosine, sine) > MIN_ALIKE and turn > MIN_TURN


REARRANGED = (
    ("reversed", "the points are in the reverse order of the scanner", 1, -1),
    ("mirrored", "the scan is a mirror image, left and right exchanged or front and back", -1, 1),
    ("mirrored", "the scan is a mirror image in the reverse order of the scanner", -1, -1),
)
"""Ways to rearrange a scan: kind, description, sign of y, and direction of the rows. A mirror image
in x equals one in y that is turned by 180 degrees."""


def _rearranged(points: NDArray[np.float32], generic: GenericResult) -> Processing | None:
    """Find the rearrangement without which order and steps of a scan match the lattice."""
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
    """Degrees of azimuth in which most lasers have two returns per firing."""
    lattice = sensor.lattice
    if lattice is None or not lattice.steps:
        return 0.0
    if not generic.evidence["duplicate"].strength > MIN_POINTS_SEEN_TWICE:
        return 0.0
    reading = lattice.read(points) if reading is None else reading
    known = (reading.ring >= 0) & (reading.count >= 0)
    firing = reading.ring[known].astype(np.int64) * lattice.steps + reading.count[known]
    returns = np.bincount(firing)[firing]
    sector = (reading.azimuth[known] * (SECTORS / (2.0 * math.pi))).astype(np.intp)
    place = sector.clip(0, SECTORS - 1) * len(lattice.slope) + reading.ring[known]
    size = SECTORS * len(lattice.slope)
    several = np.bincount(place[returns > 1], minlength=size)
    is_double = several > MAX_TWICE * np.bincount(place, minlength=size)
    lasers = is_double.reshape(SECTORS, -1).mean(axis=1)
    return float(np.count_nonzero(lasers > 0.5) * 360.0 / SECTORS)
