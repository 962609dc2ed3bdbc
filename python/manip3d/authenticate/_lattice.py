"""The lattice on which a spinning scanner measures, estimated from its own clean scans."""

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
from manip3d.authenticate._rings import Cloud
from manip3d.authenticate._verdict import NO_POWER, Power
from manip3d.errors import FormatError
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

_MOST_BYTES = 1 << 20  # a file of 128 lasers takes 20000

LINE_TOLERANCE = 2e-3
"""Metres from a line: coordinates of whole millimetres leave 0.8 mm."""

EXACT_REACH = 100.0
"""Metres within which single precision leaves less than that tolerance. Drivers compute directions
to 6e-7 radians, so that returns from 160 m on, and most of a clean cloud in centimetres, are off
their own lattice."""

FIVE_DIGITS_TO = 10.0
"""Metres within which texts of five significant digits (MATLAB's ``dlmwrite``) leave that tolerance
too; farther coordinates are whole millimetres there, which no driver computes."""

FEWEST_WHOLE = 5
"""Coordinates, at least, that tell this: one of 50 is a whole millimetre by chance."""

WIDE_GAP = 1.4
"""Times the narrower of the gaps beside it: a wider one between lines may hold a laser that
answered too little for a line."""

LINES_APART = 1.5
"""Metres from the axis: there the lines of KITTI's HDL-64E are 7 to 20 mm apart. Nearer to a
scanner, chance puts many points within `LINE_TOLERANCE` of a line."""

FEWEST_TOLD = 30
"""Fewest points of a laser at similar distances that tell whether its line and steps hold there.
Chosen, with that distance and the share of a half, on crops of one frame of an OS-0-128 and one of
an OS-1-128. Of 34 crops of the same two that chose nothing and tell a lattice, none is accused."""

COLUMNS = ("slope", "offset", "lateral", "azimuth", "range_phase", "center", "slope_error")
"""Columns of the table of lasers."""


@dataclass(frozen=True, eq=False)
class SensorLattice:
    """Lattice of possible returns of one scanner; see :func:`estimate_lattice`.

    Attributes
    ----------
    slope, offset : (R,) float64
        Laser's line ``z = slope * rho + offset``, ``rho = hypot(x, y)``, metres; from the highest
        laser to the lowest.
    lateral : (R,) float64
        Distance at which its beam passes the axis, metres, positive to the left.
    azimuth : (R,) float64
        Its horizontal angle at count 0 of the encoder, radians.
    range_phase : (R,) float64
        Its ranges are this and whole numbers of ``range_step``, metres.
    center, slope_error : (R,) float64
        Mean ``rho`` of the points that the line was fitted to, metres, and the slope's standard
        error: how far the line can be trusted elsewhere.
    steps : int
        Counts of the encoder per revolution; 0: none found.
    range_step : float
        Metres; 0: none found.
    coordinate_step : float
        Coordinates are whole numbers of it, metres; 0: none found.
    incoherence : float
        Share of clean ranges more than a quarter of ``range_step`` off.
    power : mapping of str to Power
        Share of the edits of each class that detector III finds in clean scans of this scanner, as
        `calibrate_lattice` measures it; empty: not measured. Without it `inspect` says
        ``no_trace`` of no scanner but the HDL-64E.
    tolerance : float
        How far from lines and steps clean points may be, metres.
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

    @property
    def is_exact(self) -> bool:
        """Whether its scans have the coordinates that the scanner's driver computed, unrounded."""
        return self.tolerance < LINE_TOLERANCE

    @property
    def table(self) -> Floats:
        """(R, 7): the columns above, in their order."""
        columns = [getattr(self, name) for name in COLUMNS]
        return np.ascontiguousarray(np.column_stack(columns), np.float64)

    def read(self, points: ArrayLike, *, threads: int = 0) -> LatticeReading:
        """Say where points lie on the lattice, and how far off it.

        Parameters
        ----------
        points : (N, 3) float32, metres
            A C-contiguous array is not copied.
        threads : int
            0: ``MANIP3D_THREADS``, else all cores. The answer does not depend on it.
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
        """Points that lasers see at counts of the encoder, at distances along their beams.

        Parameters
        ----------
        ring, count : (N,) integers
        distance : (N,) float, metres
            As the scanner measures it: from the foot of the perpendicular from the axis.

        Returns
        -------
        (N, 3) float64, metres
        """
        rows = np.asarray(ring, np.intp)
        slope, offset, lateral = self.slope[rows], self.offset[rows], self.lateral[rows]
        cosine = 1.0 / np.sqrt(1.0 + slope**2)
        span = np.asarray(distance, np.float64)
        reach = span * cosine
        for _ in range(4):  # the height goes by rho, which is a hair longer than the reach
            height = slope * (np.hypot(reach, lateral) - reach) + offset  # of a level beam
            reach = (span - height * slope * cosine) * cosine
        turn = 2.0 * math.pi / self.steps if self.steps else 0.0
        angle = self.azimuth[rows] + np.asarray(count, np.float64) * turn
        cos, sin = np.cos(angle), np.sin(angle)
        height = slope * np.hypot(reach, lateral) + offset
        return np.column_stack([reach * cos - lateral * sin, reach * sin + lateral * cos, height])

    def distance(self, points: ArrayLike, ring: ArrayLike) -> Floats:
        """Return the distance of points along the beams of their lasers, as it is measured, metres.

        Parameters
        ----------
        points : (N, 3), metres
            In the scanner's frame.
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
        """Return the points that the lattice can judge when it was estimated from their own scan.

        A laser that saw little, or little but the scanner's own case, has no line or one that holds
        nowhere else, and a line far from what it was fitted to is a guess.

        Parameters
        ----------
        points : (N, 3) float32, metres
        reading : LatticeReading or None
            Where they lie on the lattice; None: it is read here.

        Returns
        -------
        (N,) bool
            False nearer to the axis than `LINES_APART`; farther above or below all lines
            than half of the distance between the two outermost; and where of the points of the same
            laser, at distances that differ by less than a third, fewer than `FEWEST_TOLD` or
            fewer than half are on the lattice.
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
        told &= ((good >= FEWEST_TOLD) & (2 * good >= there))[cell]
        return told

    def is_told_exactly(
        self, frame: LidarFrame, reading: LatticeReading | None = None
    ) -> NDArray[np.bool_]:
        """Return the points of a frame that an exact lattice can judge.

        Parameters
        ----------
        frame : LidarFrame
        reading : LatticeReading or None
            Where its points lie on the lattice; None: it is read here.

        Returns
        -------
        (N,) bool
            False nearer to the axis than `LINES_APART`, farther than coordinates are exact
            (`EXACT_REACH`, or `FIVE_DIGITS_TO`), farther above or below all lines than half of the
            distance between the two outermost, and for points of lasers that may have no line:
            fewer than half of those of a ring are on any, and they look as high as one laser does;
            or nothing but the order of the file tells rings, and there is room for a laser, as
            there is beside all lines.
        """
        reading = self.read(frame.points) if reading is None else reading
        told = self._is_between_lines(frame.points) & (reading.ring >= 0)
        has_five_digits = has_whole_millimetres(frame.points, FIVE_DIGITS_TO)
        reach = FIVE_DIGITS_TO if has_five_digits else EXACT_REACH
        told &= np.abs(frame.points).max(axis=1, initial=0.0) < reach
        cloud = Cloud.of(frame)
        known = cloud.labels >= 0
        label = np.unique(cloud.labels[known], return_inverse=True)[1]
        on = np.abs(reading.line_error[cloud.there]) < self.tolerance
        no_line = 2 * np.bincount(label, on[known]) < np.bincount(label)
        # Above the scanner, which stands elsewhere than at the origin in a cloud that was lifted.
        height = (cloud.points[:, 2] - np.median(self.offset)) / cloud.rho
        apart = float(np.median(np.abs(np.diff(self.slope))))
        rows = np.flatnonzero(cloud.there)
        if cloud.is_by_order:
            told[rows[~on & self._is_in_wide_gap(height)]] = False
        for one in np.flatnonzero(no_line):
            its = np.flatnonzero(known)[label == one]
            if np.ptp(np.quantile(height[its], (0.1, 0.9))) < apart:
                told[rows[its]] = False
        return told

    def _is_in_wide_gap(self, height: Floats) -> NDArray[np.bool_]:
        """Whether heights over distances lie where a laser that answered little may look.

        Lines are farther apart there than their neighbours, or all lie on one side.
        """
        lines = np.sort(self.slope)
        gaps = np.diff(lines)
        beside = np.minimum(np.r_[np.inf, gaps[:-1]], np.r_[gaps[1:], np.inf])
        gap = np.searchsorted(lines, height) - 1
        wide = np.r_[True, gaps > WIDE_GAP * beside, True]
        return np.asarray(wide[gap + 1])

    def _is_between_lines(self, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return the points that are far from the axis, and not far above or below all lines."""
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
        """Write it as JSON.

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
        """Read what :meth:`save` wrote.

        Parameters
        ----------
        path : path

        Returns
        -------
        SensorLattice

        Raises
        ------
        FormatError
            The file is not a lattice that `save` wrote, or is damaged.
        """
        data = limited_bytes(path_of(path), _MOST_BYTES)
        try:
            values = json.loads(data)["sensor_lattice"]
            column = {name: np.asarray(values[name], np.float64) for name in COLUMNS}
            return cls(
                slope=column["slope"],
                offset=column["offset"],
                lateral=column["lateral"],
                azimuth=column["azimuth"],
                range_phase=column["range_phase"],
                center=column["center"],
                slope_error=column["slope_error"],
                steps=int(values["steps"]),
                range_step=float(values["range_step"]),
                coordinate_step=float(values["coordinate_step"]),
                incoherence=float(values["incoherence"]),
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


def _tolerance_of(value: Any) -> float:
    tolerance = float(value)
    if not 0.0 < tolerance <= LINE_TOLERANCE:
        raise ValueError(f"tolerance: expected metres in (0, {LINE_TOLERANCE}], got {tolerance}")
    return tolerance


def _power_of(values: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Power]:
    """Power of detector III from a file; ValueError where the counts are impossible."""
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
    """Positions of points on a lattice, one per point; see :meth:`SensorLattice.read`.

    Attributes
    ----------
    ring : (N,) int32
        Nearest laser, 0 the highest; -1: at the scanner itself.
    count : (N,) int32
        Count of the encoder, in ``[0, steps)``; -1: no ring, or no encoder known.
    azimuth : (N,) float32
        ``atan2(y, x)`` in [0, 2 pi).
    line_error, step_error, range_error : (N,) float32
        Metres from the line, from the middle of the step, from the nearest range.
    """

    ring: NDArray[np.int32]
    count: NDArray[np.int32]
    azimuth: NDArray[np.float32]
    line_error: NDArray[np.float32]
    step_error: NDArray[np.float32]
    range_error: NDArray[np.float32]

    @property
    def columns(self) -> ReadingColumns:
        """The arrays above, in their order: what detectors take that need not read again."""
        return (
            self.ring, self.count, self.azimuth, self.line_error, self.step_error, self.range_error
        )  # fmt: skip


def has_whole_millimetres(points: NDArray[np.float32], beyond: float) -> bool:
    """Return whether nearly all coordinates from a distance on are whole millimetres.

    Parameters
    ----------
    points : (N, 3) float32
    beyond : float
        Metres: shorter coordinates, and those of `EXACT_REACH` and more, are not looked at.
    """
    lengths = np.abs(points)
    some = points[(lengths >= beyond) & (lengths < EXACT_REACH)].astype(np.float64)
    off = np.abs(1000.0 * some - np.round(1000.0 * some))
    return len(some) >= FEWEST_WHOLE and float(np.mean(off < 0.01)) > 0.9
