"""Identify the scanner that made a scan from the angles of its points."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from manip3d._util.arrays import read_only
from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.texts import counted
from manip3d.authenticate._exact_lattice import with_slips
from manip3d.authenticate._lattice import (
    COLUMNS,
    LINE_TOLERANCE,
    LINES_APART,
    LatticeReading,
    SensorLattice,
)
from manip3d.authenticate._lattice_estimate import estimate_lattice
from manip3d.authenticate._occlusion import estimate_grid
from manip3d.authenticate._origin import MIN_EXPLAINED, estimate_origin
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame, ScanLike, to_scan

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

SensorKind: TypeAlias = Literal["lattice", "spinning", "terrestrial", "non-repetitive", "unknown"]

HDL64E = "HDL-64E"

_VLP_32C = (
    *(-25.0, -15.639, -11.31, -8.843, -7.254, -6.148, -5.333, -4.667, -4.0),
    *(k / 3.0 for k in range(-11, 6)),
    *(7.0 / 3.0, 10.0 / 3.0, 14.0 / 3.0, 7.0, 10.333, 15.0),
)
_PANDAR_40P = (
    *(-25.0, -19.0, *range(-14, -6), *(k / 3.0 for k in range(-18, 7)), 3.0, 5.0, 8.0, 11.0, 15.0),
)
BEAMS: Mapping[str, Floats] = MappingProxyType(
    {
        "VLP-16": np.arange(-15.0, 15.1, 2.0),
        "HDL-32E": -30.667 + 4.0 / 3.0 * np.arange(32.0),
        "VLP-32C": np.array(_VLP_32C),
        "Hesai Pandar40P": np.array(_PANDAR_40P),
        "Hesai PandarXT-32": np.arange(-16.0, 15.1, 1.0),
    }
)
"""Elevations of the lasers, degrees, from the makers' manuals."""

BEAM_WIDTH = 0.12
"""Largest deviation from a nominal elevation, degrees: calibrations of single units differ by
less."""

MIN_POINTS, MIN_RINGS = 1000, 16
"""Fewest points and rings of a scan on a lattice."""

MIN_OF_FEW_RINGS = 0.8
"""A scan with fewer rings, as a part of a file, is recognised as one of an HDL-64E if more than
this share of its points lies on the lines and on the steps of azimuth. The share is 1.00 in 940
pieces of 1200 to 20 000 rows of KITTI's frames, and at most 0.28 in 916 such pieces of 19 clouds of
other scanners."""

MIN_ON_RING, MIN_ON_LINES = 20, 0.5
"""A scan lies on the lines of a lattice if at least `MIN_RINGS` rings have MIN_ON_RING points on
them, and the share MIN_ON_LINES of its points is on them, sector by sector. By the lattice of
KITTI's scanner the share is 1.00 in 36 of its frames, and at most 0.21 in 12 clouds of other
scanners."""

NEAR_SCANNER, MIN_NEAR_LINES, MIN_RINGS_NEAR, LEAST_OFF = (8.0, 25.0), 0.7, 32, 1e-4
"""A scan lies near the lines if the share MIN_NEAR_LINES of its points at distances within
NEAR_SCANNER metres, where lines are farther apart than moves of the points, is nearer to them than
`NEAR_LINES`, in at least MIN_RINGS_NEAR rings. The share is at least 0.75 in six frames of KITTI's
odometry, which were deskewed, and at most 0.42 in the nine of those clouds that have enough such
points. LEAST_OFF metres: least median distance that is stated, because 0 would mean that the scan
lies on the lines."""

MIN_OF_RING, MAX_OF_RINGS = 50, 0.8
"""MIN_OF_RING: fewest points of a ring for its median elevation. MAX_OF_RINGS: least share of
rings at the nominal elevations of a model; the motion of a car moves rings that mostly see one
direction."""

MIN_SEEN = 0.6
"""A model is recognised by the lines of an exact lattice if more than this share of its lasers is
among them."""

NEARLY_EQUAL = 0.05
"""Models whose shares of points at the elevations of lasers differ by less are alike: the one with
the fewest lasers is named. Edits of a VLP-16's cloud may stand at the other lasers of a
PandarXT-32."""

FAR = 2.0
"""Metres: nearer points are ignored, because offsets of the lasers blur their elevations."""

MIN_DISTINCT = 500
"""Fewest distinct points among 20 000; copies of fewer points are no scan."""

SECTORS, MIN_OF_SECTOR, MIN_SECTORS = 72, 100, 8
"""Number of sectors of the horizon, fewest points of a sector that counts, and fewest such
sectors."""

NEAR_LINES = 0.02
"""Metres: points of the scanner's clouds remain that near to its lines after small moves, rounding
or deskewing."""

TERRESTRIAL_ROWS, IN_ROWS = 160, 0.95
"""A scan is terrestrial only if at least TERRESTRIAL_ROWS rows of elevation are needed for the
share IN_ROWS of its points. A spinning scanner has at most 128 lasers, and a few stray points, as
of rain, in rows without a laser. Simulated terrestrial scans of 0.34 degrees need at least 190
rows."""

TERRESTRIAL_VIEW, HALF_TURN = 60, 180
"""Least extents, degrees, of elevations and of azimuths of a terrestrial scan, of which one is
enough. Data sheets of terrestrial scanners state 80 degrees of elevation or more (Riegl VZ-400i
100, Leica 270, Faro 300), over the whole turn; those of solid-state scanners with rows as fine
state at most 43 (AT128 25, M1 25, Falcon 25, Innoviz Two 43), over 120 degrees of azimuth. 60 lies
between them, below a real windowed scan of 72 degrees. The power of the detectors was not measured
on solid-state scanners."""

OUTERMOST = 0.005
"""Share of the points at each end of the elevations that does not count for their extent."""

MIN_FILLED, MAX_AGAIN = 0.3, 0.25
"""MIN_FILLED: least share of occupied cells of a terrestrial scanner's grid below another
occupied cell. MAX_AGAIN: largest mean number of further points per cell, divided by that share; it
exceeds 0.5 for random directions. The share is 0.99 in a pump room and 0.5 in a random half of it,
both almost without further points. With directions rounded to steps of 0.05 to 0.2 degrees it is at
most 0.11 for an Ouster, an HDL-32E and a Pandar64, and 0.33 for a Livox, as by chance."""

TERRESTRIAL_STEP = 0.35
"""Largest spacing of rows, degrees; detectors I and II are calibrated for finer grids."""

MAX_MEDIAN = 200.0
"""Largest median distance from the scanner of points in metres. In millimetres, points of a room
are farther away, and any two points would have a gap for detector II."""

MAX_LASERS = 128  # lasers of the largest spinning scanners

LARGEST_SLOPE_ERROR = 2e-4
"""Largest standard error of a line's slope in a lattice that is estimated from a single scan and
judges it. It is at most 9e-5 in whole frames of KITTI, and 2e-4 to 1e-3 in camera crops, whose
lattices accuse clean points."""

MIN_OTHER_SLOPE = 3.0 * LARGEST_SLOPE_ERROR
"""Least median difference of the slopes of two units of a model. Those of one unit differ by less
in a cloud that was moved up or down."""

MIN_LINES = 60
"""Fewest lines of an HDL-64E's 64 lasers; no other scanner's clouds that are not exact keep the
steps of the encoder."""

MIN_EXACT_RINGS, MAX_OFF_EXACT = 8, 0.001
"""MIN_EXACT_RINGS: number of lasers of the smallest scanners. MAX_OFF_EXACT: largest share of
points of a sector off an exact lattice, as a median over the sectors. No point is off in five
clouds of five scanners by Hesai and Ouster, or in Velodyne's packets of three scanners, whose
azimuths have no steps."""

OUSTER_COLUMNS = (512, 1024, 2048, 4096)
"""Numbers of columns per turn of Ouster's scanners."""

MAX_UNEVEN, SAME_DIRECTION = 0.01, 1e-5
"""MAX_UNEVEN: largest deviation of the distances of a raster's rows from whole steps, in steps; it
is below 0.004 in 50 crops of two scans of a room. SAME_DIRECTION: radians; returns of one pulse
differ by less in azimuth."""

NEAREST_COLUMNS, RASTER_ASPECT = 0.1, 0.75
"""A raster's columns are farther apart than RASTER_ASPECT of its rows. This holds for all but the
share NEAREST_COLUMNS of its points, since the columns of a spinning scanner are farther apart
where it was thinned. This distance is at least 0.85 rows in those crops. It is 0.05 to 0.18 in
clouds of four spinning scanners with equally spaced lasers, and 0.33 where a twentieth of the
points was kept of one of them."""

SURELY_EXACT, MAX_BETWEEN = 40.0, 0.5
"""SURELY_EXACT: coordinates below this, metres, have an error of less than a quarter of the
tolerance of an exact lattice in single precision. MAX_BETWEEN: largest ratio of the number of
points with errors between a quarter of the tolerance and the tolerance to the number of points
beyond it. Objects that were moved by centimetres leave 0.05, and up to 0.25 if steps are short. In
a cloud that was turned, deskewed or rounded by a little, the ratio exceeds 1."""

MAX_EDITED, MAX_EDITED_OF_SECTOR = 0.1, 0.01
"""MAX_EDITED: largest share of a scan's points off an exact lattice; with more, a scan of another
scanner was fused with it. A car 5 m from the tested scanners has 0.07. MAX_EDITED_OF_SECTOR:
largest median, over the sectors of the horizon, of that share in a scan that is not exact. However
many points were pasted into a few sectors, they are an edit there."""

UNIT_TOLERANCE = 0.75
"""Largest difference, degrees, of the elevations of corresponding lasers of an HDL-64E and of
KITTI's unit. The nominal angles of the manual differ by at most 0.51; those of scanners with 64
lasers by other makers by at least 7."""


@dataclass(frozen=True, eq=False)
class Sensor:
    """Result of `identify_sensor`.

    Attributes
    ----------
    name : str
        ``HDL-64E``, ``scanner of at least 16 lasers`` (or however many its lattice has; some may
        have had no returns), another model, ``spinning scanner`` (of no known model), ``terrestrial
        scanner``, ``raster scanner`` (of a small view), ``non-repetitive scanner``, ``another
        scanner`` (stated by the caller), or ``unknown``.
    kind : str
        ``lattice``: a spinning scanner whose lattice is known, which detector III judges;
        ``spinning``: another spinning scanner; ``terrestrial``: a grid of azimuth and elevation,
        for which detectors I and II are calibrated; ``non-repetitive``; ``unknown``.
    reason : str
        Description of the way in which the scanner was recognised, or reason why not.
    lattice : SensorLattice or None
        Lattice of the scanner; None: unknown.
    off_lattice : float
        Median distance, metres, of the points from the lines if they were moved off them; 0: they
        lie on the lines.
    turned : str
        Axes of the scan if they are not x forward, y left, z up; else empty.
    unit : str
        Unit of the scan's coordinates: ``millimetres``, ``centimetres``, ``inches`` or ``feet``;
        empty: metres, or unknown.
    is_own : bool
        Whether the lattice was estimated from the scan itself, or is exact. Such a lattice states
        where returns of its lasers lie, but not whether the scanner has further lasers above or
        below, in which order it writes its points, or its field of view.
    """

    name: str
    kind: SensorKind
    reason: str
    lattice: SensorLattice | None = field(default=None, repr=False)
    off_lattice: float = 0.0
    turned: str = ""
    unit: str = ""
    is_own: bool = False


SAME_HEIGHT, MIN_LIFTED, MIN_IN_STEP = 0.01, 0.8, 0.9
"""A cloud was moved up or down if at least the share MIN_LIFTED of the lasers has the same change
of offset, to SAME_HEIGHT metres, and if the heights of at least the share MIN_IN_STEP of the
points are whole millimetres plus the same part of one."""

FARTHEST_HEIGHT = 1e6
"""Metres: heights are clipped to this; larger ones are markers, not returns, and may overflow."""

PARTS_OF_STEP, WITHIN_STEP = 16, 8
"""A step is divided into PARTS_OF_STEP parts. Heights agree if they are within 1 / WITHIN_STEP of a
step of the middle of the part with the most heights."""

UNKNOWN = Sensor("unknown", "unknown", "the angles are those of no scanner that is known here")


@functools.cache
def kitti_lattice() -> SensorLattice:
    """Return the lattice of KITTI's HDL-64E, estimated from ten frames of drive 2011_09_26_0002.

    All calls return the same lattice, whose arrays are read-only.
    """
    lattice = SensorLattice.load(Path(__file__).with_name("kitti_hdl64e.json"))
    for name in COLUMNS:
        read_only(getattr(lattice, name))
    return lattice


def is_hdl64e(lattice: SensorLattice) -> bool:
    """Return whether a lattice is that of an HDL-64E with ten revolutions per second.

    Thresholds and power were measured for scanners with its lasers, encoder counts and range steps.

    Parameters
    ----------
    lattice : SensorLattice
        Lattice with lasers from the highest to the lowest; at least 60 of the 64 lasers are needed.
    """
    known = kitti_lattice()
    same_steps = lattice.steps == known.steps and math.isclose(
        lattice.range_step, known.range_step, rel_tol=1e-6
    )
    if not same_steps or not MIN_LINES <= len(lattice.slope) <= len(known.slope):
        return False
    expected = np.degrees(np.arctan(known.slope)).tolist()
    laser = 0
    for angle in np.degrees(np.arctan(lattice.slope)).tolist():
        while laser < len(expected) and not abs(expected[laser] - angle) <= UNIT_TOLERANCE:
            laser += 1
        laser += 1  # each laser makes one line
    return laser <= len(expected)


def is_unit_of_kitti(lattice: SensorLattice) -> bool:
    """Return whether a lattice is that of the unit with which KITTI was recorded.

    Parameters
    ----------
    lattice : SensorLattice
    """
    return np.array_equal(lattice.slope, kitti_lattice().slope)


def _name_of(lattice: SensorLattice) -> str:
    return HDL64E if is_hdl64e(lattice) else f"scanner of at least {len(lattice.slope)} lasers"


@checked
def identify_sensor(
    scan: ScanLike, *, lattice: SensorLattice | None = None, threads: int = 0
) -> Sensor:
    """Return the scanner that made a scan.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, with the scanner at the origin, in any order.
    lattice : SensorLattice, optional
        Lattice of the scanner, which is tried first; then that of KITTI's HDL-64E is tried, and one
        is estimated from the scan.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Sensor

    Raises
    ------
    InputError
        A shape is wrong, a coordinate is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import identify_sensor, kitti_lattice
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 2000), 2000)  # every second step of the encoder
    >>> distance = 10 + lattice.range_phase[ring]  # a round wall
    >>> scan = lattice.points_at(ring, 2 * count, distance).round(3)
    >>> azimuth = np.arctan2(scan[:, 1], scan[:, 0]) % (2 * np.pi)
    >>> scan = scan[np.lexsort((azimuth, ring))].astype(np.float32)
    >>> identify_sensor(scan, lattice=lattice).name
    'HDL-64E'
    """
    return identify_and_read(scan, lattice=lattice, threads=threads)[0]


@np.errstate(over="ignore")  # distances that overflow float32 become infinite
def identify_and_read(
    scan: ScanLike, *, lattice: SensorLattice | None = None, threads: int = 0
) -> tuple[Sensor, LatticeReading | None]:
    """Return the scanner, and the places of the points on its lattice if they were computed."""
    scene = to_scan(scan)
    frame = scene.frame if scene.frame is not None else LidarFrame(scene.points)
    if (why := nothing_to_tell(frame.points)) is not None:
        return Sensor("unknown", "unknown", why), None
    given = [] if lattice is None else [lattice]
    for known in (*given, kitti_lattice()):
        reading = known.read(frame.points, threads=threads)
        if known.is_exact:
            known, reading = _with_slips(known, frame.points, reading, threads)
        found = _on_given_lattice(frame.points, known, reading, is_calibrated=bool(known.power))
        if found is not None and found.off_lattice > 0.0 and (own := _other_unit(frame, known)):
            return own, None
        if found is not None:
            return found, reading
    sensor = (
        _by_turned_axes(frame.points, threads)
        or _by_other_unit(frame.points, threads)
        or _by_own_lattice(frame)
    )
    if sensor is None or sensor.kind == "unknown":
        sensor = _by_grid(frame, threads) or sensor or _by_beams(frame.points)
    return (_by_rings(frame) or sensor) if sensor.kind == "unknown" else sensor, None


def why_off_lattice(frame: LidarFrame, lattice: SensorLattice, *, threads: int = 0) -> str | None:
    """Return why `manip3d.authenticate.inspect` does not judge a scan by a calibrated lattice.

    Parameters
    ----------
    frame : LidarFrame
        Scan with the scanner at the origin.
    lattice : SensorLattice
        Lattice that is given to `inspect`; it is treated as calibrated though it has no power yet.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores.

    Returns
    -------
    str or None
        None if the scan is judged by the lattice.
    """
    if (why := nothing_to_tell(frame.points)) is not None:
        return why
    reading = lattice.read(frame.points, threads=threads)
    found = _on_given_lattice(frame.points, lattice, reading, is_calibrated=True)
    if found is not None and found.off_lattice == 0.0:
        return None
    fewest = MIN_EXACT_RINGS if lattice.is_exact else MIN_RINGS
    if len(lattice.slope) < fewest:
        return f"it has {len(lattice.slope)} lines, and at least {fewest} are needed"
    if off := np.count_nonzero((reading.ring < 0) | _is_off(reading, lattice)):
        return f"{off} of {frame.num_points} points are not on it"
    return (
        "its points are too few, in too few directions or too inexact to tell that they are on it"
    )


def _is_off(reading: LatticeReading, lattice: SensorLattice) -> NDArray[np.bool_]:
    """Whether points are beside the lines and steps; of an exact lattice, also the range steps."""
    error = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error))
    off = ~(error <= lattice.tolerance)
    if lattice.is_exact and lattice.range_step:
        off |= ~(np.abs(reading.range_error) <= lattice.range_step / 4.0)
    return np.asarray(off)


def _with_slips(
    known: SensorLattice, points: NDArray[np.float32], reading: LatticeReading, threads: int
) -> tuple[SensorLattice, LatticeReading]:
    """The lattice with the steps of slipped columns of this scan, and the places of its points."""
    finer = with_slips(known, points, reading)
    return (known, reading) if finer is known else (finer, finer.read(points, threads=threads))


def _on_given_lattice(
    points: NDArray[np.float32],
    lattice: SensorLattice,
    reading: LatticeReading,
    *,
    is_calibrated: bool,
) -> Sensor | None:
    """The scanner of a lattice that was not estimated from the scan, or None."""
    if lattice.is_exact:
        return _on_exact_lattice(points, lattice, reading, is_calibrated=is_calibrated)
    return _on_lattice(points, lattice, reading)


def nothing_to_tell(points: NDArray[np.float32]) -> str | None:
    """Return why points cannot identify a scanner: too few, or copies; None if they may."""
    if len(points) < MIN_POINTS:
        return f"fewer than {MIN_POINTS} points"
    some = points[:: max(1, len(points) // 20_000)]
    for tried in (some[: 2 * MIN_DISTINCT], some):  # a few points are enough for most scans
        if len(np.unique(product(tried, [1.0, math.sqrt(2.0), math.pi]))) >= MIN_DISTINCT:
            return None
    return "nearly all points are copies of a few"


def _on_lattice(
    points: NDArray[np.float32], lattice: SensorLattice, reading: LatticeReading
) -> Sensor | None:
    """The scanner of the lattice, if most points lie on its lines or near them; else None."""
    rho = np.hypot(points[:, 0], points[:, 1])
    apart = rho > LINES_APART
    if np.count_nonzero(apart) < MIN_POINTS:
        return None
    error = np.abs(reading.line_error)
    on = (reading.ring >= 0) & (error < LINE_TOLERANCE)
    rings = int(np.count_nonzero(np.bincount(reading.ring[on], minlength=1) >= MIN_ON_RING))
    name = _name_of(lattice)
    if rings >= MIN_RINGS:
        if _share_of_horizon(on[apart], reading.azimuth[apart]) > MIN_ON_LINES:
            return Sensor(name, "lattice", "its points lie on the lines of the lattice", lattice)
    elif rings and is_hdl64e(lattice):
        on_steps = on & (np.abs(reading.step_error) < LINE_TOLERANCE)
        if np.mean(on_steps[apart]) > MIN_OF_FEW_RINGS:
            lasers = counted(rings, "laser")
            reason = f"its points lie where {lasers} of the lattice measure"
            return Sensor(name, "lattice", reason, lattice)
    middle = (rho > NEAR_SCANNER[0]) & (rho < NEAR_SCANNER[1])
    if np.count_nonzero(middle) < MIN_POINTS:
        return None
    near = error[middle] < NEAR_LINES
    if _share_of_horizon(near, reading.azimuth[middle]) < MIN_NEAR_LINES:
        return None
    if np.unique(reading.ring[middle]).size < MIN_RINGS_NEAR:
        return None
    off = max(float(np.median(error[middle])), LEAST_OFF)
    return Sensor(name, "lattice", "its points lie near the lines of the lattice", lattice, off)


def is_of_two_scanners(points: NDArray[np.float32], reading: LatticeReading) -> bool:
    """Return whether points off the lines lie in too many directions for an edit.

    Parameters
    ----------
    points : (N, 3) float32, metres
        Points of a scan most of which lies on the lines of a lattice that is not exact.
    reading : LatticeReading
        Their places on it.
    """
    apart = np.hypot(points[:, 0], points[:, 1]) > LINES_APART
    off = (reading.ring < 0) | (np.abs(reading.line_error) > LINE_TOLERANCE)
    there, beside = _by_sector(off[apart], reading.azimuth[apart])
    some = there >= MIN_OF_SECTOR
    if np.count_nonzero(some) < MIN_SECTORS:
        return False
    return bool(np.median(beside[some] / there[some]) > MAX_EDITED_OF_SECTOR)


def _on_exact_lattice(
    points: NDArray[np.float32],
    lattice: SensorLattice,
    reading: LatticeReading,
    *,
    is_calibrated: bool = False,
) -> Sensor | None:
    """The scanner of an exact lattice, if nearly all points of most sectors lie on it.

    An edit moves points of some sectors off the lattice; a second scanner that was fused with this
    one adds points off the lattice to most sectors, or many to some. Without range steps, a lattice
    is used only if it is calibrated: clean scans of its scanner were judged by it.
    """
    if not (lattice.range_step or is_calibrated) or len(lattice.slope) < MIN_EXACT_RINGS:
        return None
    told = (np.hypot(points[:, 0], points[:, 1]) > LINES_APART) & (reading.ring >= 0)
    if np.count_nonzero(told) < MIN_POINTS:
        return None
    off = _is_off(reading, lattice)
    sector = (reading.azimuth[told] * (SECTORS / (2.0 * np.pi))).astype(np.intp)
    sector = sector.clip(0, SECTORS - 1)
    there = np.bincount(sector, minlength=SECTORS)
    share = np.bincount(sector, off[told], SECTORS) / np.maximum(there, 1)
    some = there >= MIN_OF_SECTOR
    if np.count_nonzero(some) < MIN_SECTORS or np.median(share[some]) > MAX_OFF_EXACT:
        return None
    if np.mean(off[told]) > MAX_EDITED or _errors_go_on(points, lattice, reading, told):
        return None
    steps = f", {lattice.steps} steps of azimuth" if lattice.steps else ""
    ranges = f"whole ranges of {1000.0 * lattice.range_step:g} mm"
    ranges = f" and {ranges}" if lattice.range_step else ", and ranges have no steps"
    reason = f"its points stand on {len(lattice.slope)} lines{steps}{ranges}"
    name = _model_of(lattice) or _name_of(lattice)
    return Sensor(name, "lattice", reason, lattice, is_own=True)


def _model_of(lattice: SensorLattice) -> str:
    """The model of whose lasers the largest share is among the lines of a lattice; empty: none.

    The odd degrees of a VLP-16 are lasers of a PandarXT-32, too. All lines must be those of lasers:
    a RoboSense RS-32 has 26 of the 32 elevations of a VLP-32C.
    """
    lines = np.degrees(np.arctan(lattice.slope))
    best, seen = "", MIN_SEEN
    for model, beams in BEAMS.items():
        near = np.abs(lines[:, None] - beams) < BEAM_WIDTH
        share = float(np.mean(near.any(axis=0)))
        if near.any(axis=1).all() and share > seen:
            best, seen = model, share
    return best


def _errors_go_on(
    points: NDArray[np.float32],
    lattice: SensorLattice,
    reading: LatticeReading,
    told: NDArray[np.bool_],
) -> bool:
    """Whether many errors are just below the tolerance, so that those above it are no edits.

    Unedited points of an exact cloud are on the lattice to a tenth of the tolerance.
    """
    errors = (reading.line_error, reading.step_error, reading.range_error)
    error = np.max(np.abs(errors), axis=0)[told]
    off = np.count_nonzero(error > lattice.tolerance)
    near = np.abs(points[told]).max(axis=1) < SURELY_EXACT
    between = (error > lattice.tolerance / 4.0) & (error <= lattice.tolerance) & near
    return bool(np.count_nonzero(between) > MAX_BETWEEN * off)


TURNED_AXES: Mapping[str, tuple[tuple[int, int], ...]] = MappingProxyType(
    {
        "camera axes (x right, y down, z forward)": ((2, 1), (0, -1), (1, -1)),
        "axes with y up": ((2, 1), (0, 1), (1, 1)),
        "axes with z down": ((0, 1), (1, -1), (2, -1)),
        "axes with x up": ((1, 1), (2, 1), (0, 1)),
        "axes with x down": ((1, 1), (2, -1), (0, -1)),
    }
)
"""Names of the axes for the five other directions of the vertical, with column and sign of the
scanner's x, y and z. A whole turn does not show which direction is forward, so that one of four
rotations about each vertical is enough."""

MAX_TURNED = 15_000
"""Number of points on which other axes and units are tested."""


MIN_MEDIAN = 4.0
"""Metres: least median distance of points for tests of other axes and units. Nearer to the scanner
its lines are so close to each other that any point lies on one."""


def _by_turned_axes(points: NDArray[np.float32], threads: int) -> Sensor | None:
    """KITTI's scanner in other axes, if points lie on its lines in the usual ones; else None."""
    some = points[:: -(-len(points) // MAX_TURNED)]
    for axes, columns in TURNED_AXES.items():
        upright = np.column_stack([sign * some[:, column] for column, sign in columns])
        if (found := _far_and_on_lattice(upright, threads)) is not None:
            reason = f"its points lie on the lines of the lattice in {axes}"
            return Sensor(found.name, "spinning", reason, turned=axes)
    return None


UNITS: Mapping[str, float] = MappingProxyType(
    {"millimetres": 1000.0, "centimetres": 100.0, "inches": 1.0 / 0.0254, "feet": 1.0 / 0.3048}
)
"""Units of exported clouds other than metres, with their number per metre."""


def _by_other_unit(points: NDArray[np.float32], threads: int) -> Sensor | None:
    """KITTI's scanner in another unit, if points lie on its lines after conversion; else None."""
    some = points[:: -(-len(points) // MAX_TURNED)]
    for unit, a_metre in UNITS.items():
        if (found := _far_and_on_lattice(some / np.float32(a_metre), threads)) is not None:
            reason = f"its points lie on the lines of the lattice if they are in {unit}"
            return Sensor(found.name, "spinning", reason, unit=unit)
    return None


def _far_and_on_lattice(points: NDArray[np.float32], threads: int) -> Sensor | None:
    """KITTI's scanner, if points lie on its lines and most are far enough away; else None."""
    if not np.median(np.hypot(points[:, 0], points[:, 1])) > MIN_MEDIAN:
        return None
    known = kitti_lattice()
    upright = np.ascontiguousarray(points, np.float32)
    found = _on_lattice(upright, known, known.read(upright, threads=threads))
    return found if found is not None and found.off_lattice == 0.0 else None


def _share_of_horizon(holds: NDArray[np.bool_], azimuth: NDArray[np.float32]) -> float:
    """Mean over the sectors of the horizon of the share of points for which ``holds`` is true.

    Every sector has the same weight, however many points were pasted into it.
    """
    points, holding = _by_sector(holds, azimuth)
    some = points >= MIN_OF_SECTOR
    if np.count_nonzero(some) < MIN_SECTORS:
        return float(np.mean(holds))
    return float(np.mean(holding[some] / points[some]))


def _by_sector(
    holds: NDArray[np.bool_], azimuth: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Number of points in each sector of the horizon, and of those for which ``holds`` is true."""
    sector = (azimuth * (SECTORS / (2.0 * np.pi))).astype(np.intp).clip(0, SECTORS - 1)
    counts = np.bincount(2 * sector + holds, minlength=2 * SECTORS).reshape(SECTORS, 2)
    return counts.sum(axis=1), counts[:, 1]


def _by_own_lattice(frame: LidarFrame) -> Sensor | None:
    """A scanner whose lattice can be estimated from the scan accurately enough; else None."""
    try:
        lattice = estimate_lattice(frame)
    except InputError:
        return None
    if lattice.is_exact:
        reading = lattice.read(frame.points)
        found = _on_exact_lattice(frame.points, lattice, reading)
        if found is None or not _is_raster(lattice, reading):
            return found
        rows = len(lattice.slope)
        return Sensor("unknown", "unknown", f"its points stand on {rows} rows of a raster")
    if len(lattice.slope) < MIN_LINES or not lattice.steps or not lattice.range_step:
        return None
    if lattice.slope_error.max() > LARGEST_SLOPE_ERROR:
        return None
    return Sensor(
        _name_of(lattice), "lattice", "its points tell the lattice themselves", lattice, is_own=True
    )


def _is_raster(lattice: SensorLattice, reading: LatticeReading) -> bool:
    """Whether the lines are rows of a raster, as of a terrestrial scanner, and not lasers.

    The rows of a raster are equally spaced, or some of them are missing, and its columns are about
    as far apart as its rows. So are those of Ouster's scanners with 128 lasers, which are
    recognised by their number of columns per turn.
    """
    if lattice.steps in OUSTER_COLUMNS or len(lattice.slope) < 2:
        return False
    apart = -np.diff(np.arctan(lattice.slope))
    step = np.median(apart)
    if (np.abs(apart / step - np.round(apart / step)) > MAX_UNEVEN).any():
        return False
    on = np.abs(reading.line_error) <= lattice.tolerance
    on &= reading.ring >= 0
    order = np.lexsort((reading.azimuth[on], reading.ring[on]))
    ring, azimuth = reading.ring[on][order], reading.azimuth[on][order].astype(np.float64)
    beside = np.diff(azimuth)[np.diff(ring) == 0]
    beside = beside[beside > SAME_DIRECTION]
    return bool(beside.size and np.quantile(beside, NEAREST_COLUMNS) > RASTER_ASPECT * step)


def _other_unit(frame: LidarFrame, known: SensorLattice) -> Sensor | None:
    """Another unit of a known model, whose lasers look elsewhere; None: a unit of the same slopes.

    Points of such a unit are near the lines of the known one, as if they had been moved.
    """
    own = _by_own_lattice(frame)
    if own is None or own.lattice is None:
        return None
    apart = np.abs(own.lattice.slope[:, None] - known.slope).min(axis=1)
    return own if np.median(apart) > MIN_OTHER_SLOPE else None


def height_above_origin(sensor: Sensor, points: NDArray[np.float32]) -> float:
    """Return the height of KITTI's scanner above the origin of a cloud, metres.

    Clouds with the ground at height 0 were moved up by it. The lattice that is estimated from such
    a cloud differs from the scanner's in its offsets, and knows neither missing points nor the
    order of points. The result is 0 if the height is unknown, or if heights are not those of the
    scanner's files plus a common constant.

    Parameters
    ----------
    sensor : Sensor
        Scanner that was identified from the cloud.
    points : (N, 3) float32
        Points of the cloud, metres.
    """
    own, known = sensor.lattice, kitti_lattice()
    if not sensor.is_own or own is None or own.is_exact or sensor.name != HDL64E:
        return 0.0
    laser = np.abs(own.slope[:, None] - known.slope).argmin(axis=1)
    lifted = own.offset - known.offset[laser]
    height = float(np.median(lifted))
    alike = float(np.mean(np.abs(lifted - height) < SAME_HEIGHT))
    beside, in_step = _common_part(points[:, 2], known.coordinate_step)
    if alike < MIN_LIFTED or in_step < MIN_IN_STEP:
        return 0.0
    step = known.coordinate_step
    return round(beside + step * round((height - beside) / step), 6)


def _common_part(heights: NDArray[np.float32], step: float) -> tuple[float, float]:
    """The common remainder, metres, of heights divided by a step, and the share of heights with it.

    Sums are over whole nanometres, so that they are the same on all machines.
    """
    whole = round(step * 1e9)
    metres = np.clip(heights.astype(np.float64), -FARTHEST_HEIGHT, FARTHEST_HEIGHT)
    beside = np.rint(metres * 1e9).astype(np.int64) % whole
    part = int(np.bincount(beside * PARTS_OF_STEP // whole, minlength=PARTS_OF_STEP).argmax())
    middle = (2 * part + 1) * whole // (2 * PARTS_OF_STEP)
    off = (beside - middle + whole // 2) % whole - whole // 2
    near = np.abs(off) * WITHIN_STEP <= whole
    mean = middle + int(off[near].sum()) / int(np.count_nonzero(near))
    return mean * 1e-9, float(np.mean(near))


def _by_grid(frame: LidarFrame, threads: int) -> Sensor | None:
    """A terrestrial scanner, if the scan has a regular grid with many rows; else None.

    A small view with many rows is that of a raster scanner, which no detector judges.
    """
    grid = estimate_grid(frame, origin=(0.0, 0.0, 0.0), threads=threads)
    if grid.elevation_strength < 0.5 or grid.elevation_deg > TERRESTRIAL_STEP:
        return None
    elevation = _elevations(frame.points)
    row = np.round((elevation - grid.elevation_phase_deg) / grid.elevation_deg)
    crowded = np.sort(np.unique(row, return_counts=True)[1])[::-1]
    if np.searchsorted(np.cumsum(crowded), IN_ROWS * row.size) + 1 < TERRESTRIAL_ROWS:
        return None
    column = np.round((_azimuths(frame.points) - grid.azimuth_phase_deg) / grid.azimuth_deg)
    if not _is_scanned(row, column):
        return None
    around = estimate_origin(frame, known=(0.0, 0.0, 0.0), threads=threads)
    if around.position is None or around.axis != "z" or around.explained < MIN_EXPLAINED:
        return None  # a tilted scanner, or rows that are due to rounding
    if not is_in_metres(frame.points):
        return Sensor("terrestrial scanner", "unknown", NOT_IN_METRES)
    rows = f"{crowded.size} rows of elevation, {grid.elevation_deg:.3f} degrees apart"
    up, around_it = _view(frame.points)
    if up < TERRESTRIAL_VIEW and around_it <= HALF_TURN:
        seen = f"over {up:.0f} degrees, and {around_it} degrees of azimuth"
        return Sensor("raster scanner", "unknown", f"{rows}, {seen}")
    return Sensor("terrestrial scanner", "terrestrial", rows)


def _view(points: NDArray[np.float32]) -> tuple[float, int]:
    """Extent of the points' elevations, and number of whole degrees of azimuth with points."""
    low, high = np.quantile(_elevations(points), (OUTERMOST, 1.0 - OUTERMOST))
    return float(high - low), len(np.unique(np.floor(_azimuths(points))))


def is_in_metres(points: NDArray[np.float32]) -> bool:
    """Return whether points are as near to the scanner as in a scan in metres.

    Parameters
    ----------
    points : (N, 3) float32
    """
    distance = np.linalg.norm(points.astype(np.float64), axis=1)
    return len(points) == 0 or bool(np.median(distance) <= MAX_MEDIAN)


NOT_IN_METRES = f"half of its points are farther than {MAX_MEDIAN:g}: they are not in metres"


def _is_scanned(row: Floats, column: Floats) -> bool:
    """Whether directions were measured on a grid, and not rounded to it afterwards.

    Returns of a scanner fill its grid cell by cell, each once or twice. Rounded directions of
    another scanner leave most cells empty, or fill many of them repeatedly.
    """
    up, along = (each - each.min() for each in (row, column))
    height = up.max() + 2.0  # one free row, so that columns are not adjacent
    cells = np.unique((along * height + up).astype(np.int64))
    beside = float(np.mean(np.diff(cells) == 1))  # the cell above is occupied, too
    again = len(row) / len(cells) - 1.0
    return beside >= MIN_FILLED and again < MAX_AGAIN * beside


def _by_beams(points: NDArray[np.float32]) -> Sensor:
    """A spinning scanner by the elevations of its lasers, or a scanner without rings."""
    elevation = _elevations(points)
    if elevation.size < MIN_POINTS:
        return UNKNOWN
    shares = {name: _share_on(elevation, beams) for name, beams in BEAMS.items()}
    alike = [name for name, each in shares.items() if each > max(shares.values()) - NEARLY_EQUAL]
    best = min(alike, key=lambda name: len(BEAMS[name]))
    share = shares[best]
    if share > 0.9:
        return Sensor(best, "spinning", f"{share:.0%} of the points at its lasers' elevations")
    peaks = _peaks(elevation)
    if len(peaks) and len(peaks) <= MAX_LASERS:
        where = "one elevation" if len(peaks) == 1 else f"{len(peaks)} elevations"
        return Sensor("spinning scanner", "spinning", f"the points stand on {where}")
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    if np.ptp(azimuth) < 150.0:
        return Sensor(
            "non-repetitive scanner", "non-repetitive", "a part of the turn, no rows of elevation"
        )
    return UNKNOWN


def _by_rings(frame: LidarFrame) -> Sensor | None:
    """A scanner by the median elevation of each labelled ring, which deskewing hardly changes."""
    if frame.ring is None:
        return None
    distance = np.linalg.norm(frame.points.astype(np.float64), axis=1)
    far = distance > FAR
    elevation = np.degrees(np.arcsin(frame.points[far, 2] / distance[far]))
    ring = np.asarray(frame.ring)[far]
    crowded = np.flatnonzero(np.bincount(ring, minlength=1) >= MIN_OF_RING)
    medians = np.sort([np.median(elevation[ring == each]) for each in crowded])
    if len(medians) < MIN_RINGS:
        return None
    for model, beams in BEAMS.items():
        order = np.sort(beams)
        nearest = np.abs(medians[:, None] - order).argmin(axis=1)
        off = np.abs(medians - order[nearest])
        if len(np.unique(nearest)) == len(medians) and (off < BEAM_WIDTH).mean() > MAX_OF_RINGS:
            return Sensor(
                model, "spinning", f"its {len(medians)} rings have the elevations of its lasers"
            )
    return None


def _elevations(points: NDArray[np.float32]) -> Floats:
    """Elevations, degrees, of the points farther than FAR."""
    xyz = points.astype(np.float64)
    distance = np.sqrt((xyz * xyz).sum(axis=1))
    far = distance > FAR
    elevation: Floats = np.degrees(np.arcsin(xyz[far, 2] / distance[far]))
    return elevation


def _azimuths(points: NDArray[np.float32]) -> Floats:
    """Azimuths, degrees, of the points farther than FAR."""
    xyz = points.astype(np.float64)
    far = np.sqrt((xyz * xyz).sum(axis=1)) > FAR
    azimuth: Floats = np.degrees(np.arctan2(xyz[far, 1], xyz[far, 0]))
    return azimuth


def _share_on(elevation: Floats, beams: Floats) -> float:
    """Share of points at the elevations of beams, corrected for chance; 0 if few beams are used."""
    order = np.sort(np.asarray(beams, np.float64))
    nearest = np.searchsorted((order[1:] + order[:-1]) / 2.0, elevation)
    on = np.abs(elevation - order[nearest]) < BEAM_WIDTH
    used = np.unique(nearest[on]).size
    if 2 * used < order.size or used < 8:
        return 0.0
    width = float(np.mean(np.minimum(np.diff(order), 4.0)))
    chance = min(0.9, 2.0 * BEAM_WIDTH / width)
    return float((np.mean(on) - chance) / (1.0 - chance))


def _peaks(elevation: Floats) -> Floats:
    """Elevations, degrees, that hold nine tenths of the points; empty if there are none."""
    count, edges = np.histogram(elevation, np.arange(-90.0, 90.01, 0.05))
    high = np.flatnonzero(count > 0.002 * elevation.size)
    if count[high].sum() < 0.9 * elevation.size:
        return np.empty(0)
    starts = high[np.r_[True, np.diff(high) > 1]]
    return edges[starts]
