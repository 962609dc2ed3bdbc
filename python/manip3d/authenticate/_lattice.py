"""The lattice on which a spinning scanner measures, estimated from its own clean scans."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.linear import line_fit
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import threads_of
from manip3d._util.paths import path_of
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

_MOST_BYTES = 1 << 20  # a file of 128 lasers takes 20000

LINE_TOLERANCE = 2e-3
"""Metres from a line: coordinates of whole millimetres leave 0.8 mm."""

COORDINATE_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 1e-4)
RANGE_STEPS = (1e-2, 5e-3, 4e-3, 2e-3)
"""Metres that are looked for, the coarsest first: every finer one fits a coarser one's data."""

EXACT_TOLERANCE = 1e-4
"""Metres from a line or a step, in a cloud whose coordinates are those that the scanner's driver
computed, in single precision: they are within 3e-5 of them 100 m away."""

EXACT_REACH = 100.0
"""Metres within which single precision leaves less than that tolerance. Drivers compute directions
to 6e-7 radians, so that returns from 160 m on, and most of a clean cloud in centimetres, are off
their own lattice."""

FIVE_DIGITS_TO = 10.0
"""Metres within which texts of five significant digits (MATLAB's ``dlmwrite``) leave that tolerance
too; farther coordinates are whole millimetres there, which no driver computes."""

FEWEST_WHOLE = 5
"""Coordinates, at least, that tell this: one of 50 is a whole millimetre by chance."""

EXACT_STEPS = (512, 1024, 1800, 2048, 3600, 4096, 9000, 18_000, 36_000)
"""Counts of encoders that are looked for in exact clouds, the coarsest first: Ouster's columns of a
turn, and whole numbers of 0.01 degrees, in which Hesai's packets state azimuths."""

MOST_STEPS_BESIDE = 4096
"""Counts of encoders up to which beams may pass beside the axis: the places that are tried are too
far apart for finer ones, whose scanners have their beams pass through it."""

EXACT_RANGE_STEPS = (*RANGE_STEPS, 1e-3)
"""Range steps that are tried for exact clouds; Ouster measures whole millimetres."""

LEAST_EXACT = 0.8
"""Share of the points of an exact cloud that are on lines, steps and ranges: edits spoil a few."""

ANGLE_STEPS = (
    *(math.radians(degrees) for degrees in (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)),
    *(1e-3, 1e-4),
)
"""Radians to which angles are rounded where a cloud was written in polar coordinates, the coarsest
of each unit first."""

ON_ROUNDED, ROUNDED_APART = 0.05, 1.5
"""Share of a step of rounded coordinates that single precision leaves at most; and steps by which a
point may lie beside its line or count: where a laser looks half-way between two, rounding takes it
to either."""

WIDE_GAP = 1.4
"""Times the narrower of the gaps beside it: a wider one between lines may hold a laser that
answered too little for a line."""

LEAST_SPREAD = 1e-3
"""Metres from nearest to farthest that a line of an exact cloud needs; how far it can be trusted is
in ``slope_error``."""

SAME_ELEVATION = 4e-7
"""Radians between neighbours among the sorted elevations of a laser of an exact cloud, of which
single precision leaves 1e-7."""

FEWEST_ALIKE = 3
"""Fewest points at one elevation that make a laser: chance leaves two as near to each other."""

MOST_RINGS = 256
"""Lasers that a spinning scanner has at most."""

BEGIN_OF_TURN = math.radians(2.0)
"""Azimuth before that of the first point at which rings may begin, where azimuths descend."""

FEWEST_POINTS = 100
"""A ring with fewer points is not taken for one, unless the frame says which points are its own."""

FEWEST_LABELLED = 8
"""Fewest points of a ring that the frame names: enough to tell a line from an object."""

LEAST_LINES, MOST_LINES = 4, 128
"""Fewest and most lines that are the lasers of a scanner: none has more lasers. Clouds whose
elevations were rounded are on hundreds of lines, and few points between them are no edit."""

NARROW = 0.05
"""Metres: a ring of less extent from the axis (the scanner's own car, a wall around it) says where
its line passes there, not how it goes on."""

NEAREST = 0.5
"""Metres from the axis: nearer there is the scanner's own case, or no return at all."""

LINES_APART = 1.5
"""Metres from the axis: there the lines of KITTI's HDL-64E are 7 to 20 mm apart. Nearer to a
scanner, chance puts many points within `LINE_TOLERANCE` of a line."""

FEWEST_TOLD = 30
"""Fewest points of a laser at similar distances that tell whether its line and steps hold there.
Chosen, with that distance and the share of a half, on crops of one frame of an OS-0-128 and one of
an OS-1-128. Of 34 crops of the same two that chose nothing and tell a lattice, none is accused."""

FEWEST_PAIRS = 30
"""Fewest pairs of points a given number of firings apart, for the encoder's counts."""

MOST_SEARCHED = 300
"""Points of a ring for a search over a grid; of longer rings so many to twice as many are taken."""

LIKELY = 4
"""Places of the grid that are kept of that search."""

MOST_FITS = 40
"""Fits of a line to the points near the one before, which mostly end after five. Eight were too few
for a laser of an OS1-128, whose points were off its steps by 0.1 mm."""

TRIED_AGAIN = 16
"""Places of the grid that a laser's fit begins at where it fails from the likeliest one."""

MOST_POINTS = 1000
"""Points of a ring (twice as many at most) by which the best of these places is chosen. A ring that
mostly meets the road has all but one distance, and few points tell the places apart."""

MOST_PAIRED = 250
"""Points of a ring (twice as many at most); pairs, one from either half, propose the line."""

MOST_COMBED = 16_000
"""Pairs of points for each number of firings apart, and points (twice as many at most), to which a
comb of steps is laid: 36 000 combs agree with so many by chance to 0.04 at most, where half is
asked for."""

SECTORS = 16
"""Sectors of a ring, judged one by one."""

COLUMNS = ("slope", "offset", "lateral", "azimuth", "range_phase", "center", "slope_error")
"""Columns of the table of lasers."""

LATERALS = np.arange(-0.08, 0.0801, 0.002)
"""Metres between beam and axis that are tried; the fit behind the search finds the rest."""


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
        cloud = _Cloud.of(frame)
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


@checked
def estimate_lattice(
    frames: LidarFrame | ArrayLike | Iterable[LidarFrame | ArrayLike],
) -> SensorLattice:
    """Estimate the lattice of a scanner from scans of it.

    A minority of forged points does no harm: every fit goes by the majority.

    Parameters
    ----------
    frames : LidarFrame or (N, 3) points, metres, or several of them
        Scans as the scanner gave them, the scanner at the origin. Without ``ring`` the points must
        be in KITTI's order, ring after ring, azimuths ascending or descending in each, or each
        laser's elevation must be the same to a millionth of a degree.

    Returns
    -------
    SensorLattice

    Raises
    ------
    InputError
        No rings can be distinguished: another order, or a cloud that was moved.

    Notes
    -----
    KITTI's HDL-64E: 64 lines to 0.3 mm (rounding to whole millimetres), an encoder of 4000 counts,
    lasers 26 mm left or right of the axis, ranges in steps of 2 mm. The lasers' order is their
    slope's. Velodyne, HDL-64E S2 manual, appendix: the calibration whose numbers these are.

    Clouds of other scanners, as their drivers compute them (Hesai, Ouster), are exact: their points
    are on the lines, on whole steps of azimuth and at whole ranges to what single precision leaves.
    The lattice then has a ``tolerance`` of 0.1 mm.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import estimate_lattice, kitti_lattice
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 1000), 1000)  # every fourth step of the encoder
    >>> distance = 8 + 0.004 * count + lattice.range_phase[ring]  # a wall around it
    >>> scan = lattice.points_at(ring, 4 * count, distance).round(3)
    >>> azimuth = np.arctan2(scan[:, 1], scan[:, 0]) % (2 * np.pi)
    >>> scan = scan[np.lexsort((azimuth, ring))].astype(np.float32)
    >>> found = estimate_lattice(scan)
    >>> len(found.slope), float(np.abs(found.slope - lattice.slope).max().round(5))
    (64, 2e-05)
    """
    clouds = [_Cloud.of(frame) for frame in _listed(frames)]
    if not clouds:
        raise InputError("frames: expected at least one scan, got none")
    slope, offset = _find_lines(clouds)
    rho = np.concatenate([cloud.rho for cloud in clouds])
    z = np.concatenate([cloud.points[:, 2] for cloud in clouds])
    angle = np.concatenate([cloud.azimuth for cloud in clouds])
    frame = np.repeat(np.arange(len(clouds)), [len(cloud.rho) for cloud in clouds])
    ring = _on_lines(rho, z, slope, offset)
    if 2 * np.count_nonzero(ring >= 0) < len(ring):
        raise InputError(
            f"frames: expected points on the lines of a scanner's lasers, found "
            f"{np.mean(ring >= 0):.0%} of them within {1000 * LINE_TOLERANCE:.0f} mm of one"
        )
    xyz = np.concatenate([cloud.points for cloud in clouds])
    members = [np.flatnonzero(ring == k) for k in range(len(slope))]
    exact = _exact_lattice(rho, z, angle, members, slope, offset)
    if exact is not None:
        return exact
    steps = _find_steps(rho, angle, members)
    lateral, azimuth = np.zeros((2, len(slope)))
    if steps:
        starts = _first_encoders(rho, angle, members, steps)
        fits = [
            _fit_encoder(rho[rows], angle[rows], steps, *start)
            for rows, start in zip(members, starts, strict=True)
        ]
        lateral, azimuth = np.array(fits).T
        if not _stands_on_steps(rho, angle, members, lateral, azimuth, steps):
            steps = 0
            lateral, azimuth = np.zeros((2, len(slope)))
    if steps:
        shifts = _align_counts(rho, angle, frame, ring, lateral, azimuth, steps)
        azimuth += 2.0 * math.pi / steps * shifts
    range_step, phase, incoherence = _find_range_step(rho, z, members, slope, lateral)
    return SensorLattice(
        slope,
        offset,
        lateral,
        np.mod(azimuth, 2.0 * math.pi),
        phase,
        *_trust(rho, z, members, slope, offset),
        steps,
        range_step,
        _find_coordinate_step(xyz),
        incoherence,
    )


def without_roundings(
    reading: LatticeReading, points: NDArray[np.float32], tolerance: float
) -> LatticeReading:
    """Return a reading without the errors that rounding of polar coordinates explains.

    Parameters
    ----------
    reading : LatticeReading
    points : (N, 3) float32, metres
        Seen from the scanner.
    tolerance : float
        Metres up to which errors are none in any case.

    Returns
    -------
    LatticeReading
        Where nearly all azimuths, elevations or distances from the origin are whole numbers of one
        step, points that are so too have no error that is hardly larger than that step.
    """
    errors = reading.line_error, reading.step_error, reading.range_error
    if not any((np.abs(error) > tolerance).any() for error in errors):
        return reading
    x, y, z = points.astype(np.float64).T
    rho = np.sqrt(x * x + y * y)
    distance = np.sqrt(rho * rho + z * z)
    line = _unless_rounded(reading.line_error, np.arctan2(z, rho), ANGLE_STEPS, distance, tolerance)
    step = _unless_rounded(reading.step_error, np.arctan2(y, x), ANGLE_STEPS, rho, tolerance)
    along = _unless_rounded(
        reading.range_error, distance, EXACT_RANGE_STEPS, np.ones_like(rho), tolerance
    )
    return replace(reading, line_error=line, step_error=step, range_error=along)


def _unless_rounded(
    error: NDArray[np.float32],
    value: Floats,
    steps: Sequence[float],
    arm: Floats,
    tolerance: float,
) -> NDArray[np.float32]:
    """Errors (m), 0 where a rounding of the coordinate to one of the steps explains them.

    A step of the coordinate is ``arm`` times as many metres.
    """
    off = np.abs(error) > tolerance
    for step in steps if off.any() else ():
        turns = value / step
        is_whole = np.abs(turns - np.round(turns)) < ON_ROUNDED
        if np.mean(is_whole) >= LEAST_EXACT:  # finer steps would only excuse more by chance
            explained = off & is_whole & (np.abs(error) <= ROUNDED_APART * step * arm)
            return np.where(explained, np.float32(0.0), error)
    return error


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


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points that are not the scanner's own case, and the laser of each: -1 if none is known."""

    there: NDArray[np.bool_]
    points: Floats
    rho: Floats
    azimuth: Floats
    labels: NDArray[np.int64]
    is_by_order: bool

    @classmethod
    def of(cls, frame: LidarFrame | ArrayLike) -> _Cloud:
        labels = frame.ring if isinstance(frame, LidarFrame) else None
        points = frame.points if isinstance(frame, LidarFrame) else frame
        xyz = as_rows(points, 3, np.float32, "frames").astype(np.float64)
        if not np.isfinite(xyz).all():
            raise InputError("frames: expected finite coordinates")
        rho = np.hypot(xyz[:, 0], xyz[:, 1])
        there = rho > NEAREST
        xyz, rho = xyz[there], rho[there]
        azimuth = np.mod(np.arctan2(xyz[:, 1], xyz[:, 0]), 2.0 * math.pi)
        if labels is None:
            kept = _by_exact_elevation(rho, xyz[:, 2])
        else:
            kept = labels[there].astype(np.int64)
        if kept is None:
            return cls(there, xyz, rho, azimuth, _by_order(azimuth), True)
        return cls(there, xyz, rho, azimuth, kept, False)

    @property
    def rings(self) -> list[NDArray[np.intp]]:
        """Rows of each laser that has enough points for a line, in the order of the labels."""
        order = np.argsort(self.labels, kind="stable")
        ends = np.flatnonzero(np.diff(self.labels[order])) + 1
        rings = np.split(order, ends)
        fewest = FEWEST_POINTS if self.is_by_order else FEWEST_LABELLED
        return [r for r in rings if len(r) >= fewest and self.labels[r[0]] >= 0]


def _by_exact_elevation(rho: Floats, z: Floats) -> NDArray[np.int64] | None:
    """Ring of each point, -1 where it has none, if elevations are the same in each; else None."""
    elevation = np.arctan2(z, rho)
    order = np.argsort(elevation, kind="stable")
    run = np.cumsum(np.r_[False, np.diff(elevation[order]) > SAME_ELEVATION])
    size = np.bincount(run)
    is_ring = size >= FEWEST_ALIKE
    several = np.count_nonzero(size >= FEWEST_LABELLED)
    if size[is_ring].sum() < LEAST_EXACT * len(rho) or several > MOST_RINGS:
        return None
    labels = np.empty(len(rho), np.int64)
    labels[order] = np.where(is_ring, np.cumsum(is_ring), -1)[run]
    return labels


def _by_order(azimuth: Floats) -> NDArray[np.int64]:
    """Number of the ring of each point of a file that has ring after ring."""
    if len(azimuth) < 2:
        return np.zeros(len(azimuth), np.int64)
    step, back = np.diff(azimuth), -math.pi
    if np.median(step) < 0.0:  # clockwise, from wherever the first ring begins
        step = np.diff(np.mod(azimuth[0] + BEGIN_OF_TURN - azimuth, 2.0 * math.pi))
        back = -1.0
    return np.cumsum(np.r_[False, step < back])


def _listed(
    frames: LidarFrame | ArrayLike | Iterable[LidarFrame | ArrayLike],
) -> Sequence[LidarFrame | ArrayLike]:
    if isinstance(frames, LidarFrame) or (isinstance(frames, np.ndarray) and frames.ndim == 2):
        return [frames]
    if not isinstance(frames, Iterable):
        raise InputError(f"frames: expected scans, got {frames!r}")
    return list(frames)


def _find_lines(clouds: Sequence[_Cloud]) -> tuple[Floats, Floats]:
    """Lines that the rings of the clouds agree on, from the highest to the lowest."""
    rings = [(cloud, ring) for cloud in clouds for ring in cloud.rings]
    # A ring is wide where it was forged if nowhere else; then what is left of it decides.
    wide = [_fit_wide_ring(cloud, ring) for cloud, ring in rings]
    known = [line[1] for line in wide if line is not None]
    height = float(np.median(known)) if known else 0.0  # of the scanner in a cloud that was lifted
    found = [
        line or _fit_narrow_ring(cloud, ring, height)
        for line, (cloud, ring) in zip(wide, rings, strict=True)
    ]
    lines = np.array([line for line in found if line is not None]).reshape(-1, 3)
    lines = lines[np.argsort(-lines[:, 0], kind="stable")]
    # Slopes of one laser differ by 1e-5 between frames, of two lasers by 5e-3.
    groups = np.split(lines, np.flatnonzero(np.diff(-lines[:, 0]) > 1e-3) + 1)
    agreed = [group[group[:, 2].argmax()] for group in groups if 2 * len(group) >= len(clouds)]
    _check_lines(len(agreed))
    slope, offset = np.array(agreed)[:, 0], np.array(agreed)[:, 1]
    rho = np.concatenate([cloud.rho for cloud in clouds])
    z = np.concatenate([cloud.points[:, 2] for cloud in clouds])
    ring = _on_lines(rho, z, slope, offset)
    members = [np.flatnonzero(ring == k) for k in range(len(slope))]
    fits = [
        line_fit(rho[rows], z[rows])
        if len(rows) >= FEWEST_POINTS and np.ptp(rho[rows]) > NARROW
        else (slope[k], offset[k])
        for k, rows in enumerate(members)
        if len(rows) >= FEWEST_LABELLED
    ]
    _check_lines(len(fits))  # rounded or noisy rings agree on lines that few points are on
    return np.array(fits)[:, 0], np.array(fits)[:, 1]


def _check_lines(found: int) -> None:
    if not LEAST_LINES <= found <= MOST_LINES:
        raise InputError(
            f"frames: expected the rings of a spinning scanner ({LEAST_LINES} to {MOST_LINES}), "
            f"ring after ring and each by azimuth, or `ring`; found {found} lines"
        )


def _fit_wide_ring(cloud: _Cloud, ring: NDArray[np.intp]) -> tuple[float, float, int] | None:
    """Slope, offset and support of the line through pairs of points that most others lie on."""
    some = ring[:: max(1, len(ring) // MOST_PAIRED)]
    rho, z = cloud.rho[some], cloud.points[some, 2]
    order = np.argsort(rho, kind="stable")
    half = len(order) // 2
    near, far = order[:half], order[-half:]
    run = rho[far] - rho[near]
    wide = run > NARROW
    if not wide.any():
        return None
    slope = (z[far] - z[near])[wide] / run[wide]
    offset = z[near][wide] - slope * rho[near][wide]
    off = z - slope[:, None] * rho
    off -= offset[:, None]
    support = (np.abs(off, out=off) < LINE_TOLERANCE).sum(axis=1)
    best = support.argmax()
    for _ in range(3):
        line = slope[best], offset[best]
        error = cloud.points[ring, 2] - line[0] * cloud.rho[ring] - line[1]
        inside = ring[np.abs(error) < LINE_TOLERANCE]
        if 2 * len(inside) < len(ring):
            return None
        slope[best], offset[best] = line_fit(cloud.rho[inside], cloud.points[inside, 2])
    return float(slope[best]), float(offset[best]), len(inside)


def _fit_narrow_ring(
    cloud: _Cloud, ring: NDArray[np.intp], height: float
) -> tuple[float, float, int] | None:
    """The line through the scanner, where it holds for nearly all points of a ring."""
    rho, rise = cloud.rho[ring], cloud.points[ring, 2] - height
    slope = float(np.median(rise / rho))
    inside = int(np.count_nonzero(np.abs(rise - slope * rho) < LINE_TOLERANCE))
    return (slope, height, inside) if inside >= 0.9 * len(ring) else None


def _on_lines(rho: Floats, z: Floats, slope: Floats, offset: Floats) -> NDArray[np.int32]:
    """Line of each point; -1: off all of them."""
    table = np.zeros((len(slope), len(COLUMNS)))
    table[:, 0], table[:, 1] = slope, offset
    cloud = np.ascontiguousarray(np.column_stack([rho, np.zeros_like(rho), z]), np.float32)
    ring, _, _, error, _, _ = _core.read_lattice(cloud, table, 0, 0.0, 0.0, 1)
    found: NDArray[np.int32] = np.where(np.abs(error) < LINE_TOLERANCE, ring, np.int32(-1))
    return found


def _exact_lattice(
    rho: Floats,
    z: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    slope: Floats,
    offset: Floats,
) -> SensorLattice | None:
    """The lattice of clouds with unrounded coordinates; None if these are rounded."""
    errors = [np.abs(z[rows] - slope[k] * rho[rows] - offset[k]) for k, rows in enumerate(members)]
    if np.median(np.concatenate(errors)) > EXACT_TOLERANCE:
        return None
    lines = [
        _fit_exactly(rho[rows], z[rows], a, b)
        for rows, a, b in zip(members, slope, offset, strict=True)
    ]
    slope, offset = np.array(lines).reshape(-1, 2).T
    on = [
        rows[np.abs(z[rows] - slope[k] * rho[rows] - offset[k]) < EXACT_TOLERANCE]
        for k, rows in enumerate(members)
    ]
    # A line that no point is on to what single precision leaves is none of a laser.
    kept = [k for k in _one_below_the_other(slope, on) if len(on[k])]
    slope, offset, on = slope[kept], offset[kept], [on[k] for k in kept]
    if sum(map(len, on)) < LEAST_EXACT * len(rho):
        return None
    steps, lateral, azimuth = _exact_steps(rho, angle, on)
    range_step, phase, incoherence = _find_range_step(rho, z, on, slope, lateral, EXACT_RANGE_STEPS)
    center, slope_error = _trust(rho, z, on, slope, offset)
    if steps:
        slope_error = np.maximum(slope_error, _step_trust(rho, angle, on, lateral, azimuth, steps))
    return SensorLattice(
        slope,
        offset,
        lateral,
        np.mod(azimuth, 2.0 * math.pi),
        phase,
        center,
        slope_error,
        steps,
        range_step,
        0.0,
        incoherence,
        tolerance=EXACT_TOLERANCE,
    )


def _one_below_the_other(slope: Floats, on: Sequence[NDArray[np.int64]]) -> list[int]:
    """Lines whose slopes descend; of two that do not the one with more points, as a line that was
    found between the lasers of moved points is none of a laser."""
    kept: list[int] = []
    for k in range(len(slope)):
        while kept and not slope[k] < slope[kept[-1]] and len(on[k]) > len(on[kept[-1]]):
            kept.pop()
        if not kept or slope[k] < slope[kept[-1]]:
            kept.append(k)
    return kept


def _fit_exactly(x: Floats, y: Floats, slope: float, offset: float) -> tuple[float, float]:
    """The line that most points are on to what single precision leaves, near the one that is given.

    Without such points it is the given one.
    """
    found = slope, offset
    before: NDArray[np.bool_] | None = None
    for _ in range(MOST_FITS):
        error = np.abs(y - found[0] * x - found[1])
        inside = error <= max(3.0 * _median(error), 1e-6)
        if np.count_nonzero(inside) < FEWEST_LABELLED or np.ptp(x[inside]) <= LEAST_SPREAD:
            break
        if before is not None and np.array_equal(inside, before):
            break
        found, before = line_fit(x[inside], y[inside]), inside
    return found


def _median(values: Floats) -> float:
    """Return `numpy.median`, in a quarter of its time for the few points of a ring; 0 of none."""
    half = len(values) // 2
    if len(values) == 0 or np.isnan(values.max()):
        return 0.0 if len(values) == 0 else math.nan
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    below, above = np.partition(values, (half - 1, half))[half - 1 : half + 1].tolist()
    return float((below + above) / 2.0)


def _exact_steps(
    rho: Floats, angle: Floats, members: Sequence[NDArray[np.intp]]
) -> tuple[int, Floats, Floats]:
    """Counts of the encoder, and each laser's lateral distance and angle at count 0.

    0 counts where most points are on none of `EXACT_STEPS`.
    """
    zero = np.zeros(len(members))
    for steps in EXACT_STEPS:  # beams through the axis
        starts = [_best_encoder(rho[rows], angle[rows], zero[:1], steps)[1] for rows in members]
        azimuth = np.array(starts)
        if _share_on_steps(rho, angle, members, zero, azimuth, steps) >= LEAST_EXACT:
            return steps, *_fit_all_beside(rho, angle, members, zero, azimuth, steps)
    for steps in (n for n in EXACT_STEPS if n <= MOST_STEPS_BESIDE):
        first = np.array(_first_encoders(rho, angle, members, steps)).reshape(-1, 2)
        lateral, azimuth = _fit_all_beside(rho, angle, members, first[:, 0], first[:, 1], steps)
        if _share_on_steps(rho, angle, members, lateral, azimuth, steps) >= LEAST_EXACT:
            for k, rows in enumerate(members):
                start = float(lateral[k]), float(azimuth[k])
                lateral[k], azimuth[k] = _fit_again(rho[rows], angle[rows], steps, *start)
            return steps, lateral, azimuth
    return 0, zero, zero


def _fit_again(
    rho: Floats, angle: Floats, steps: int, lateral: float, azimuth: float
) -> tuple[float, float]:
    """The fit of `_fit_beside` from other places of the grid, if many points are off the given one.

    Points at two distances only, as of a laser that looks over the roofs, leave several lateral
    distances nearly as likely; the right one has the points on the steps.
    """

    def share_on_steps(fit: tuple[float, float]) -> float:
        off = _off_the_steps(rho, angle, *fit, steps)
        return float(np.mean(np.abs(off) < EXACT_TOLERANCE))

    best = lateral, azimuth
    if len(rho) < FEWEST_LABELLED or share_on_steps(best) >= LEAST_EXACT:
        return best
    some = slice(None, None, max(1, len(rho) // MOST_SEARCHED))
    waves = np.exp(1j * steps * (angle[some] - LATERALS[:, None] / rho[some])).mean(axis=1)
    for place in np.argsort(-np.abs(waves), kind="stable")[:TRIED_AGAIN]:
        start = float(LATERALS[place]), float(np.angle(waves[place])) / steps
        fit = _fit_beside(rho, angle, steps, *start)
        best = max(best, fit, key=share_on_steps)
        if share_on_steps(best) >= LEAST_EXACT:
            break
    return best


def _fit_all_beside(
    rho: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> tuple[Floats, Floats]:
    """Lateral distance and angle at count 0 of each laser, near those that are given."""
    fits = [
        _fit_beside(rho[rows], angle[rows], steps, beside, first)
        for rows, beside, first in zip(members, lateral, azimuth, strict=True)
    ]
    found = np.array(fits).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _fit_beside(
    rho: Floats, angle: Floats, steps: int, lateral: float, azimuth: float
) -> tuple[float, float]:
    """Lateral distance (m) and angle at count 0 (rad) that most points of a laser agree on."""
    for _ in range(MOST_FITS):
        error = _off_the_steps(rho, angle, lateral, azimuth, steps)
        off = np.abs(error)
        inside = off <= max(3.0 * _median(off), 1e-6)
        if np.count_nonzero(inside) < FEWEST_LABELLED or np.ptp(rho[inside]) <= LEAST_SPREAD:
            break
        turn, shift = line_fit(rho[inside], error[inside])
        lateral, azimuth = lateral + shift, azimuth + turn
        if abs(turn) < 1e-12 and abs(shift) < 1e-9:
            break
    return lateral, azimuth


def _share_on_steps(
    rho: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> float:
    """Share of the points that are on a step, of those where steps are far enough apart to tell."""
    on = apart = 0
    for k, rows in enumerate(members):
        far = rows[rho[rows] * (2.0 * math.pi / steps) > 8.0 * EXACT_TOLERANCE]
        off = _off_the_steps(rho[far], angle[far], lateral[k], azimuth[k], steps)
        on += int(np.count_nonzero(np.abs(off) < EXACT_TOLERANCE))
        apart += len(far)
    return on / apart if apart >= FEWEST_POINTS else 0.0


def _step_trust(
    rho: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> Floats:
    """Standard error of each laser's azimuth, as the points on its steps tell it."""
    found = np.ones(len(members))
    for k, rows in enumerate(members):
        off = _off_the_steps(rho[rows], angle[rows], lateral[k], azimuth[k], steps)
        on = np.abs(off) < EXACT_TOLERANCE
        if on.any():
            spread = rho[rows][on] - rho[rows][on].mean()
            found[k] = math.sqrt(off[on].var() / max(float(spread @ spread), 1e-12))
    return found


def _beside(lateral: float | Floats, rho: Floats) -> Floats:
    """Angle between a beam that passes the axis at a distance and what it meets, from the axis.

    Points nearer than that, which are on no such beam, are taken to lie where it is nearest.
    """
    angle: Floats = np.arcsin(np.clip(lateral / rho, -1.0, 1.0))
    return angle


def _off_the_steps(
    rho: Floats, angle: Floats, lateral: float, azimuth: float, steps: int
) -> Floats:
    """Metres from the nearest step of the encoder."""
    beam = angle - _beside(lateral, rho) - azimuth
    return _off_step(beam, steps) * rho


def _trust(
    rho: Floats, z: Floats, members: Sequence[NDArray[np.intp]], slope: Floats, offset: Floats
) -> tuple[Floats, Floats]:
    """Mean distance of each line's points, and the standard error of its slope.

    The error is 1 where all points of a line are equally far, which leaves its slope open.
    """
    center, error = np.zeros(len(slope)), np.ones(len(slope))
    for k, rows in enumerate(members):
        if not len(rows):
            continue
        center[k] = rho[rows].mean()
        if np.ptp(rho[rows]) == 0.0:
            continue
        spread = rho[rows] - rho[rows].mean()
        noise = z[rows] - slope[k] * rho[rows] - offset[k]
        error[k] = math.sqrt(noise.var() / (spread * spread).sum())
    return center, error


def _find_steps(rho: Floats, angle: Floats, members: Sequence[NDArray[np.intp]]) -> int:
    """Counts per revolution that make whole numbers of the differences within rings."""
    size, fewest, most = 1 << 18, 600, 36000  # bins: seven for each of the most counts
    turns = np.zeros(size)
    rows = np.concatenate([ring for ring in members if len(ring)])
    same_ring = np.concatenate([np.full(len(ring), k) for k, ring in enumerate(members)])
    for lag in (1, 7, 49, 343):
        first, second = rows[:-lag], rows[lag:]
        alike = (same_ring[:-lag] == same_ring[lag:]) & (rho[first] > 10.0)
        # Equal parallax: a beam 0.1 m beside the axis turns by less than 2e-5 more.
        alike &= np.abs(1.0 / rho[first] - 1.0 / rho[second]) < 2e-4
        pairs = np.flatnonzero(alike)
        pairs = pairs[:: max(1, len(pairs) // MOST_COMBED)]
        if len(pairs) < FEWEST_PAIRS:
            return 0
        turn = np.mod(angle[second[pairs]] - angle[first[pairs]], 2.0 * math.pi)
        bins = np.minimum((turn * (size / (2.0 * math.pi))).astype(np.int64), size - 1)
        turns += np.bincount(bins, minlength=size) / (4.0 * len(turn))
    middle = np.exp(-1j * math.pi / size * np.arange(most))  # of the bins
    coherence = np.real(np.fft.rfft(turns)[:most] * middle)
    best = fewest + int(coherence[fewest:].argmax())
    return best if coherence[best] > 0.5 else 0


def _first_encoders(
    rho: Floats, angle: Floats, members: Sequence[NDArray[np.intp]], steps: int
) -> list[tuple[float, float]]:
    """Lateral distance and angle at count 0 of each laser, as the grid of `LATERALS` tells them.

    They maximise the mean of ``exp(i steps (angle - lateral / rho))`` over its points. The grid is
    evenly spaced: a product for each point leads from one place to the next.
    """
    some = [rows[:: max(1, len(rows) // MOST_SEARCHED)] for rows in members]
    rows = np.concatenate(some)
    ends = np.cumsum([0, *map(len, some)])
    wave = np.exp(1j * steps * (angle[rows] - LATERALS[0] / rho[rows]))
    turn = np.exp(-1j * steps * (LATERALS[1] - LATERALS[0]) / rho[rows])
    size = np.empty((len(LATERALS), len(some)))
    for k in range(len(LATERALS)):
        size[k] = np.abs(np.diff(np.concatenate([[0.0], np.cumsum(wave)])[ends]))
        wave *= turn
    likely = np.argpartition(size, -LIKELY, axis=0)[-LIKELY:]
    return [
        _best_encoder(rho[rows], angle[rows], LATERALS[np.sort(places)], steps)
        for rows, places in zip(members, likely.T, strict=True)
    ]


def _best_encoder(rho: Floats, angle: Floats, laterals: Floats, steps: int) -> tuple[float, float]:
    """The lateral distance, of some, that a laser's points agree on, and the angle they give."""
    if len(rho) == 0:
        return 0.0, 0.0
    some = slice(None, None, max(1, len(rho) // MOST_POINTS))
    turns = steps * (angle[some] - laterals[:, None] / rho[some])
    waves = np.exp(1j * turns).mean(axis=1)
    best = np.abs(waves).argmax()
    return float(laterals[best]), float(np.angle(waves[best])) / steps


def _fit_encoder(
    rho: Floats, angle: Floats, steps: int, lateral: float, azimuth: float
) -> tuple[float, float]:
    """Lateral distance (m) and angle at count 0 (rad, within one step) of one laser."""
    if len(rho) < FEWEST_POINTS:
        return 0.0, 0.0
    for _ in range(5):
        error = _off_step(angle - _beside(lateral, rho) - azimuth, steps) * rho
        near = np.abs(error) < LINE_TOLERANCE
        if near.sum() < 2 or np.ptp(rho[near]) <= LEAST_SPREAD:
            break
        turn, shift = line_fit(rho[near], error[near])
        lateral, azimuth = lateral + shift, azimuth + turn
    return lateral, azimuth


def _stands_on_steps(
    rho: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> bool:
    """Whether three quarters of all places, a sector of a ring each, are as good as free of points
    off the steps: of an HDL-64E all are, forgeries spoil a few. Where azimuths are interpolated
    between packets (HDL-32E, VLP) there may be a period, but it holds for a part of the turn."""
    shares = []
    for k, rows in enumerate(members):
        beam = angle[rows] - _beside(lateral[k], rho[rows]) - azimuth[k]
        off = np.abs(_off_step(beam, steps) * rho[rows]) > LINE_TOLERANCE
        sector = (angle[rows] * (SECTORS / (2.0 * math.pi))).astype(np.intp).clip(0, SECTORS - 1)
        points = np.bincount(sector, minlength=SECTORS)
        enough = points >= FEWEST_LABELLED
        shares.append(np.bincount(sector, off, SECTORS)[enough] / points[enough])
    return bool(np.quantile(np.concatenate(shares), 0.75) < 0.01)


def _off_step(angle: Floats, steps: int) -> Floats:
    step = 2.0 * math.pi / steps
    return angle - np.round(angle / step) * step


def _align_counts(
    rho: Floats,
    angle: Floats,
    frame: NDArray[np.intp],
    ring: NDArray[np.int32],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> Floats:
    """Counts by which each laser looks ahead of the first, from the pattern of the firings.

    All lasers fire at the same counts, which the revolution spaces unevenly, but look in different
    directions then: the correlation of who answered when peaks at the difference.
    """
    known = ring >= 0
    beam = angle[known] - _beside(lateral[ring[known]], rho[known]) - azimuth[ring[known]]
    count = np.mod(np.round(beam * (steps / (2.0 * math.pi))), steps).astype(np.int64)
    shape = (int(frame.max()) + 1, len(lateral), steps)
    answered = np.zeros(shape)
    answered[frame[known], ring[known], count] = 1.0
    window = np.zeros(steps)
    window[np.arange(-10, 11)] = 1.0 / 21.0  # what varies slowly is the street, not the firings
    waves = np.fft.rfft(answered, axis=-1) * (1.0 - np.fft.rfft(window))
    total = answered.sum(axis=(0, 2))
    leader = int(total.argmax())
    shifts = np.zeros(len(lateral))
    common = waves[:, leader].copy()
    turns = np.arange(waves.shape[-1]) * (2j * math.pi / steps)
    for k in np.argsort(-total, kind="stable"):
        if k == leader:
            continue
        correlation = np.fft.irfft((waves[:, k] * np.conj(common)).sum(axis=0), n=steps)
        shifts[k] = correlation.argmax()
        common += waves[:, k] * np.exp(turns * shifts[k])
    return shifts


def _find_range_step(
    rho: Floats,
    z: Floats,
    members: Sequence[NDArray[np.intp]],
    slope: Floats,
    lateral: Floats,
    steps: Sequence[float] = RANGE_STEPS,
) -> tuple[float, Floats, float]:
    """Step of the ranges, each laser's phase (m), and the share of ranges a quarter step off."""
    cosine = 1.0 / np.sqrt(1.0 + slope**2)
    ranges = [
        np.sqrt(np.maximum(rho[rows] ** 2 - lateral[k] ** 2, 0.0)) * cosine[k]
        + z[rows] * slope[k] * cosine[k]
        for k, rows in enumerate(members)
    ]
    thinned = max(1, sum(len(r) for r in ranges) // MOST_COMBED)
    few = [r[::thinned] for r in ranges]
    for step in steps:
        if np.median(np.abs(_range_waves(few, step))) < 0.4:
            continue
        waves = _range_waves(ranges, step)
        phase = np.mod(np.angle(waves) * step / (2.0 * math.pi), step)
        off = np.concatenate([(r - p) / step for r, p in zip(ranges, phase, strict=True)])
        incoherence = float(np.mean(np.abs(off - np.round(off)) > 0.25))
        return step, phase, max(incoherence, 0.01)
    return 0.0, np.zeros(len(slope)), 0.25


def _range_waves(ranges: Sequence[Floats], step: float) -> NDArray[np.complex128]:
    """Mean of ``exp(2 pi i range / step)`` of each laser; 0 where it has no range."""
    turn = 2j * math.pi / step
    return np.array([np.exp(turn * r).mean() if len(r) else 0.0j for r in ranges])


def _find_coordinate_step(points: Floats) -> float:
    some = points[:: max(1, len(points) // 20_000)]
    for step in COORDINATE_STEPS:
        off = np.abs(some - np.round(some / step) * step).max(axis=1)
        if np.mean(off < 1e-5) > 0.9:
            return step
    return 0.0
