"""The lattice of a spinning scanner: the places where it can measure (`SensorLattice`)."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import threads_of
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.authenticate._rings import MIN_LABELLED, Cloud
from manip3d.authenticate._verdict import NO_POWER, Power
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_write, limited_bytes
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]
    ReadingColumns: TypeAlias = tuple[
        NDArray[np.int32],
        NDArray[np.int32],
        NDArray[np.float32],
        NDArray[np.float32],
        NDArray[np.float32],
        NDArray[np.float32],
    ]

_MAX_BYTES = 1 << 20  # a file with 128 lasers has 20000

LINE_TOLERANCE = 2e-3
"""Metres: largest distance of clean points from their line. Rounding to whole millimetres causes
0.8 mm."""

EXACT_REACH = 100.0
"""Coordinates below this, metres, are exact to the tolerance of exact clouds. Drivers compute
directions to 6e-7 radians, so that returns from 160 m on are off their own lattice; in a clean
cloud in centimetres most points are."""

FIVE_DIGITS_TO = 10.0
"""Coordinates below this, metres, are still exact to that tolerance in text files with five
significant digits (MATLAB's ``dlmwrite``). These files round farther coordinates to whole
millimetres, which no driver computes."""

MIN_WHOLE = 5
"""Fewest coordinates that show such rounding: one in 50 is a whole millimetre by chance."""

WIDE_GAP = 1.4
"""A gap between two lines that is wider than this many times the narrower of its neighbouring gaps
may contain a laser with too few returns for a line."""

LINES_APART = 1.5
"""Metres from the axis. The lines of KITTI's HDL-64E are 7 to 20 mm apart there; nearer to the
scanner, many points lie within `LINE_TOLERANCE` of a line by chance."""

MIN_TOLD = 30
"""Fewest points of a laser at similar distances that confirm its line and steps there. It was
chosen, with `LINES_APART` and the share of a half, on crops of one frame of an OS-0-128 and one of
an OS-1-128. None of 34 other crops of these frames that have a lattice is accused."""

MAX_STEPS = 10_000_000
"""Largest number of encoder counts of a lattice that is read from a file."""

COLUMNS = ("slope", "offset", "lateral", "azimuth", "range_phase", "center", "slope_error")
"""Columns of `SensorLattice.table`."""


@dataclass(frozen=True, eq=False)
class SensorLattice:
    """Lattice of the possible returns of one scanner; see :func:`estimate_lattice`.

    Attributes
    ----------
    slope, offset : (R,) float64
        Line ``z = slope * rho + offset`` of each laser, ``rho = hypot(x, y)`` in metres; from the
        highest laser to the lowest.
    lateral : (R,) float64
        Distance at which the laser's beam passes the axis, metres, positive to the left.
    azimuth : (R,) float64
        Horizontal angle of the beam at count 0 of the encoder, radians.
    range_phase : (R,) float64
        Ranges of the laser are this plus whole multiples of ``range_step``, metres.
    center, slope_error : (R,) float64
        Mean ``rho`` of the points to which the line was fitted, metres, and standard error of the
        slope. They determine the error of the line at other distances.
    steps : int
        Encoder counts per revolution; 0: unknown.
    range_step : float
        Step of the ranges, metres; 0: unknown.
    coordinate_step : float
        Coordinates are whole multiples of this, metres; 0: of no step.
    incoherence : float
        Share of clean ranges that are more than a quarter of ``range_step`` off the steps.
    power : mapping of str to Power
        Share of the edits of each class that detector III finds in clean scans of this scanner, as
        `calibrate_lattice` measures it; empty: not measured. Without it `inspect` never returns
        ``no_trace``, except for the HDL-64E.
    tolerance : float
        Largest distance of clean points from lines and steps, metres.

    Raises
    ------
    InputError
        The columns of the lasers are not numbers, or have different lengths.
    """

    slope: Floats
    offset: Floats
    lateral: Floats
    azimuth: Floats
    range_phase: Floats
    center: Floats
    slope_error: Floats
    steps: int
    range_step: float
    coordinate_step: float
    incoherence: float
    power: Mapping[str, Power] = field(default_factory=lambda: NO_POWER, repr=False)
    tolerance: float = LINE_TOLERANCE

    def __post_init__(self) -> None:
        for name in COLUMNS:
            column = as_rows(getattr(self, name), None, np.float64, name)
            if len(column) != len(self.slope):
                raise InputError(
                    f"{name}: expected {len(self.slope)} values, one for each laser, got "
                    f"{len(column)}"
                )
            object.__setattr__(self, name, column)

    def __repr__(self) -> str:
        lasers = counted(len(self.slope), "laser")
        steps = f"{self.steps or 'unknown'} counts per turn, ranges in {1e3 * self.range_step:g} mm"
        return f"<manip3d.authenticate.SensorLattice: {lasers}, {steps}>"

    @property
    def is_exact(self) -> bool:
        """Whether scans have the unrounded coordinates that the scanner's driver computed."""
        return self.tolerance < LINE_TOLERANCE

    @property
    def table(self) -> Floats:
        """The columns `COLUMNS`, (R, 7)."""
        columns = [getattr(self, name) for name in COLUMNS]
        return np.ascontiguousarray(np.column_stack(columns), np.float64)

    def read(self, points: ArrayLike, *, threads: int = 0) -> LatticeReading:
        """Return the places of points on the lattice, and their distances from it.

        Parameters
        ----------
        points : (N, 3) float32, metres
            A C-contiguous array is not copied.
        threads : int
            0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
        """
        cloud = as_rows(points, 3, np.float32, "points")
        return LatticeReading(
            *_core.read_lattice(
                cloud,
                self.table,
                self.steps,
                self.range_step,
                self.coordinate_step,
                threads_of(threads),
            )
        )

    def points_at(self, ring: ArrayLike, count: ArrayLike, distance: ArrayLike) -> Floats:
        """Return the points that lasers measure at encoder counts, at distances along their beams.

        Parameters
        ----------
        ring, count : (N,) integers
            Index of the laser, and encoder count.
        distance : (N,) float, metres
            Distance as the scanner measures it: from the point of the beam nearest to the axis.

        Returns
        -------
        (N, 3) float64, metres
        """
        rows = np.asarray(ring, np.intp)
        slope, offset, lateral = self.slope[rows], self.offset[rows], self.lateral[rows]
        cosine = 1.0 / np.sqrt(1.0 + slope**2)
        span = np.asarray(distance, np.float64)
        reach = span * cosine
        for _ in range(4):  # the height depends on rho, slightly longer than the reach
            # relative to a beam through the axis
            height = slope * (np.hypot(reach, lateral) - reach) + offset
            reach = (span - height * slope * cosine) * cosine
        turn = 2.0 * math.pi / self.steps if self.steps else 0.0
        angle = self.azimuth[rows] + np.asarray(count, np.float64) * turn
        cos, sin = np.cos(angle), np.sin(angle)
        height = slope * np.hypot(reach, lateral) + offset
        return np.column_stack([reach * cos - lateral * sin, reach * sin + lateral * cos, height])

    def distance(self, points: ArrayLike, ring: ArrayLike) -> Floats:
        """Return the distance of points along the beams of their lasers, as measured, metres.

        Parameters
        ----------
        points : (N, 3), metres
            Points in the scanner's frame.
        ring : (N,) int
            Index of each point's laser.
        """
        xyz = as_rows(points, 3, np.float64, "points")
        rows = np.asarray(ring, np.intp)
        cosine = 1.0 / np.sqrt(1.0 + self.slope[rows] ** 2)
        reach = np.sqrt(np.maximum(xyz[:, 0] ** 2 + xyz[:, 1] ** 2 - self.lateral[rows] ** 2, 0.0))
        along: Floats = (reach + xyz[:, 2] * self.slope[rows]) * cosine
        return along

    def is_told_by_scan(
        self, points: NDArray[np.float32], reading: LatticeReading | None = None
    ) -> NDArray[np.bool_]:
        """Return which points a lattice that was estimated from their own scan can judge.

        A laser with few returns, or with few returns except from the scanner's own case, has no
        line, or one that is wrong elsewhere. Far from the points of its fit, any line is a guess.

        Parameters
        ----------
        points : (N, 3) float32, metres
        reading : LatticeReading or None
            Places of the points on the lattice; None: they are computed here.

        Returns
        -------
        (N,) bool
            False for points nearer to the axis than `LINES_APART`; for points above or below all
            lines by more than half of the distance between the two outermost lines; and for points
            of a laser if, of its points in the same interval of distance (each interval ends at 4/3
            of its begin), fewer than `MIN_TOLD` or fewer than half are on the lattice.
        """
        reading = self.read(points) if reading is None else reading
        told = self._is_between_lines(points) & (reading.ring >= 0)
        rho = np.hypot(*points[:, :2].astype(np.float64).T)
        error = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error))
        on = error < self.tolerance
        place = np.log(np.maximum(rho, LINES_APART) / LINES_APART) / math.log(4.0 / 3.0)
        bins = int(place.max(initial=0.0)) + 1
        cell = reading.ring.clip(0) * bins + place.astype(np.intp)
        size = len(self.slope) * bins
        there = np.bincount(cell[told], minlength=size)
        good = np.bincount(cell[told & on], minlength=size)
        told &= ((good >= MIN_TOLD) & (2 * good >= there))[cell]
        return told

    def is_told_exactly(
        self, frame: LidarFrame, reading: LatticeReading | None = None
    ) -> NDArray[np.bool_]:
        """Return which points of a frame an exact lattice can judge.

        Parameters
        ----------
        frame : LidarFrame
            Frame of the scanner.
        reading : LatticeReading or None
            Places of its points on the lattice; None: they are computed here.

        Returns
        -------
        (N,) bool
            False for points nearer to the axis than `LINES_APART`; for points beyond the reach of
            exact coordinates (`EXACT_REACH`, or `FIVE_DIGITS_TO`); for points above or below all
            lines by more than half of the distance between the two outermost lines; and for points
            of lasers that may have no line. These are points in a gap between two lines that is
            wide enough for a further laser, or beyond the outermost line: if only the order of the
            file tells rings, all points off the lines; else the points of a ring of which fewer
            than half are on any line, at elevations as close together as those of one laser, and
            points without a ring in the gap of such a ring, or as close together themselves.
        """
        reading = self.read(frame.points) if reading is None else reading
        told = self._is_between_lines(frame.points) & (reading.ring >= 0)
        told &= self._is_within_reach(frame.points)
        cloud = Cloud.of(frame)
        known = cloud.labels >= 0
        label = np.unique(cloud.labels[known], return_inverse=True)[1]
        on = np.abs(reading.line_error[cloud.there]) < self.tolerance
        no_line = 2 * np.bincount(label, on[known]) < np.bincount(label)
        # Height above the scanner, which is not at the origin if the cloud was moved up or down.
        height = (cloud.points[:, 2] - np.median(self.offset)) / cloud.rho
        apart = float(np.median(np.abs(np.diff(self.slope))))
        rows = np.flatnonzero(cloud.there)
        may_be_laser = self._is_in_wide_gap(height)
        if cloud.is_by_order:
            told[rows[~on & may_be_laser]] = False
        # Beams that start off the axis have no constant elevation: not all points have a ring.
        loose = np.flatnonzero(~known & ~on & may_be_laser)
        gap = np.searchsorted(np.sort(self.slope), height)
        of_gaps = [loose[gap[loose] == one] for one in np.unique(gap[loose])]
        rings = [np.flatnonzero(known)[label == one] for one in np.flatnonzero(no_line)]
        rings += [its for its in of_gaps if len(its) >= MIN_LABELLED]
        with_laser = []
        for its in rings:
            middle = its[np.argsort(height[its])[len(its) // 2]]
            # Points of another scanner's laser have a ring of their own, too, in any gap.
            if may_be_laser[middle] and np.ptp(np.quantile(height[its], (0.1, 0.9))) < apart:
                told[rows[its]] = False
                with_laser.append(gap[middle])
        told[rows[loose[np.isin(gap[loose], with_laser)]]] = False
        return told

    def is_of_no_line(
        self, points: NDArray[np.float32], reading: LatticeReading
    ) -> NDArray[np.bool_]:
        """Return which points are certainly on no line of an exact lattice, at any elevation.

        Parameters
        ----------
        points : (N, 3) float32, metres
        reading : LatticeReading
            Places of the points on the lattice.

        Returns
        -------
        (N,) bool
            False for points on a line, nearer to the axis than `LINES_APART`, or beyond the reach
            of exact coordinates.
        """
        off = (reading.ring < 0) | (np.abs(reading.line_error) > self.tolerance)
        off &= np.hypot(*points[:, :2].astype(np.float64).T) > LINES_APART
        return off & self._is_within_reach(points)

    def is_line_known(
        self, points: NDArray[np.float32], reading: LatticeReading
    ) -> NDArray[np.bool_]:
        """Return which points lie where only lasers with a known line look.

        Parameters
        ----------
        points : (N, 3) float32, metres
        reading : LatticeReading
            Places of the points on the lattice.

        Returns
        -------
        (N,) bool
            True for points on a line, and for points between two lines that are too close together
            for a further laser between them.
        """
        x, y, z = points.astype(np.float64).T
        height = (z - np.median(self.offset)) / np.maximum(np.hypot(x, y), LINES_APART)
        on_line = (reading.ring >= 0) & (np.abs(reading.line_error) <= self.tolerance)
        return on_line | ~self._is_in_wide_gap(height)

    def single_points(self, frame: LidarFrame) -> tuple[NDArray[np.bool_] | None, int]:
        """Return which points are certainly not those of a laser without a line.

        Parameters
        ----------
        frame : LidarFrame
            Frame of an exact lattice.

        Returns
        -------
        is_single : (N,) bool or None
            True for points on a line, and for points at an elevation that at most one other point
            has. None: only the order of the file tells rings, so that it is not known.
        lasers : int
            Number of rings of which fewer than half of the points are on any line.
        """
        cloud = Cloud.of(frame.replace(ring=None))
        if cloud.is_by_order:
            return None, 0
        reading = self.read(frame.points)
        on_line = (reading.ring >= 0) & (np.abs(reading.line_error) <= self.tolerance)
        labels = np.full(frame.num_points, -1)
        labels[cloud.there] = cloud.labels
        known = labels >= 0
        size = np.bincount(labels[known])
        no_line = 2 * np.bincount(labels[known], on_line[known], len(size)) < size
        return on_line | ~known, int(np.count_nonzero(no_line & (size > 0)))

    @staticmethod
    def _is_within_reach(points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Mask of points with coordinates that are exact to the tolerance of exact clouds."""
        has_five_digits = has_whole_millimetres(points, FIVE_DIGITS_TO)
        reach = FIVE_DIGITS_TO if has_five_digits else EXACT_REACH
        within: NDArray[np.bool_] = np.abs(points).max(axis=1, initial=0.0) < reach
        return within

    def _is_in_wide_gap(self, height: Floats) -> NDArray[np.bool_]:
        """Mask of tangents of elevation at which a laser with few returns may be.

        These are wide gaps between two lines, and all elevations beyond the outermost lines.
        """
        lines = np.sort(self.slope)
        gaps = np.diff(lines)
        beside = np.minimum(np.r_[np.inf, gaps[:-1]], np.r_[gaps[1:], np.inf])
        gap = np.searchsorted(lines, height) - 1
        wide = np.r_[True, gaps > WIDE_GAP * beside, True]
        return np.asarray(wide[gap + 1])

    def _is_between_lines(self, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Mask of points that are far from the axis, and not far above or below all lines."""
        x, y, z = points.astype(np.float64).T
        rho = np.hypot(x, y)
        order = np.argsort(self.slope)
        (low, above), (below, high) = order[:2], order[-2:]
        lower = self.slope[low] - (self.slope[above] - self.slope[low]) / 2.0
        upper = self.slope[high] + (self.slope[high] - self.slope[below]) / 2.0
        inside: NDArray[np.bool_] = rho > LINES_APART
        inside &= (z >= lower * rho + self.offset[low]) & (z <= upper * rho + self.offset[high])
        return inside

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the lattice as JSON.

        Parameters
        ----------
        path : path
            File that `load` reads.

        Examples
        --------
        >>> import numpy as np
        >>> from manip3d.authenticate import SensorLattice, kitti_lattice
        >>> kitti_lattice().save("lattice.json")
        >>> len(SensorLattice.load("lattice.json").slope)
        64
        """
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        text = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
        text["power"] = {name: vars(power) for name, power in self.power.items()}
        atomic_write(path, json.dumps({"sensor_lattice": text}, indent=1).encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SensorLattice:
        """Read a file of :meth:`save`.

        Parameters
        ----------
        path : path
            File of a lattice.

        Returns
        -------
        SensorLattice

        Raises
        ------
        FormatError
            The file is not a lattice that `save` wrote, or is damaged.
        """
        data = limited_bytes(path_of(path), _MAX_BYTES)
        try:
            values = json.loads(data)["sensor_lattice"]
            column = _columns_of(values)
            return cls(
                slope=column["slope"],
                offset=column["offset"],
                lateral=column["lateral"],
                azimuth=column["azimuth"],
                range_phase=column["range_phase"],
                center=column["center"],
                slope_error=column["slope_error"],
                steps=int(_length_of(values, "steps")),
                range_step=_length_of(values, "range_step"),
                coordinate_step=_length_of(values, "coordinate_step"),
                incoherence=_length_of(values, "incoherence"),
                power=_power_of(values.get("power", {})),
                tolerance=_tolerance_of(values.get("tolerance", LINE_TOLERANCE)),
            )
        except (
            ValueError,
            TypeError,
            KeyError,
            AttributeError,
            OverflowError,
            RecursionError,
        ) as error:
            raise FormatError(f"not a sensor lattice: {error}", file=os.fspath(path)) from error


def _columns_of(values: Mapping[str, Any]) -> dict[str, Floats]:
    """Columns of a lattice from a file; raises ValueError if they make no table of lasers."""
    columns = {name: np.asarray(values[name], np.float64) for name in COLUMNS}
    lasers = columns["slope"].size
    for name, column in columns.items():
        if column.shape != (lasers,) or lasers == 0:
            raise ValueError(f"{name}: expected one number for each laser, got {column.shape}")
        if not np.isfinite(column).all():
            raise ValueError(f"{name}: expected finite numbers")
    return columns


def _length_of(values: Mapping[str, Any], name: str) -> float:
    value = float(values[name])
    if not 0.0 <= value <= MAX_STEPS:
        raise ValueError(f"{name}: expected a number in [0, {MAX_STEPS}], got {value}")
    return value


def _tolerance_of(value: Any) -> float:
    tolerance = float(value)
    if not 0.0 < tolerance <= LINE_TOLERANCE:
        raise ValueError(f"tolerance: expected metres in (0, {LINE_TOLERANCE}], got {tolerance}")
    return tolerance


def _power_of(values: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Power]:
    """Power of detector III from a file; raises ValueError if a count is impossible."""
    power = {}
    for name, said in values.items():
        found, planted = int(said["found"]), int(said["planted"])
        if not 0 <= found <= planted or planted == 0:
            raise ValueError(
                f"power of {name!r}: expected found <= planted, got {found}, {planted}"
            )
        power[name] = Power(found, planted, source=str(said.get("source", "")))
    return ReadOnlyMapping(power)


@dataclass(frozen=True, eq=False)
class LatticeReading:
    """Places of points on a lattice, one per point; see :meth:`SensorLattice.read`.

    Attributes
    ----------
    ring : (N,) int32
        Nearest laser, 0 the highest; -1: at the scanner itself.
    count : (N,) int32
        Encoder count in ``[0, steps)``; -1: no ring, or the encoder is unknown.
    azimuth : (N,) float32
        ``atan2(y, x)`` in [0, 2 pi), radians.
    line_error, step_error, range_error : (N,) float32
        Distance from the line, from the nearest encoder step and from the nearest range step,
        metres.
    """

    ring: NDArray[np.int32]
    count: NDArray[np.int32]
    azimuth: NDArray[np.float32]
    line_error: NDArray[np.float32]
    step_error: NDArray[np.float32]
    range_error: NDArray[np.float32]

    __repr__ = short_repr

    @property
    def columns(self) -> ReadingColumns:
        """The arrays above, in their order, as functions of the core take them."""
        return (
            self.ring, self.count, self.azimuth, self.line_error, self.step_error, self.range_error
        )  # fmt: skip


def has_whole_millimetres(points: NDArray[np.float32], beyond: float) -> bool:
    """Return whether nearly all coordinates of at least ``beyond`` metres are whole millimetres.

    Parameters
    ----------
    points : (N, 3) float32
    beyond : float
        Metres: smaller coordinates, and those of at least `EXACT_REACH`, are ignored.
    """
    lengths = np.abs(points)
    some = points[(lengths >= beyond) & (lengths < EXACT_REACH)].astype(np.float64)
    off = np.abs(1000.0 * some - np.round(1000.0 * some))
    return len(some) >= MIN_WHOLE and float(np.mean(off < 0.01)) > 0.9
