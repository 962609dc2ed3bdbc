"""Estimate the lattice of a spinning scanner from its own clean scans."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d.authenticate._exact_lattice import EXACT_RANGE_STEPS, exact_lattice, slope_trust
from manip3d.authenticate._lattice import LINE_TOLERANCE, LatticeReading, SensorLattice
from manip3d.authenticate._lattice_lines import find_lines, on_lines
from manip3d.authenticate._lattice_steps import (
    align_counts,
    find_coordinate_step,
    find_range_step,
    find_steps,
    first_encoders,
    fit_encoder,
    stands_on_steps,
)
from manip3d.authenticate._rings import MIN_EXACT, Cloud
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]

ANGLE_STEPS = (
    *(math.radians(degrees) for degrees in (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)),
    *(1e-3, 1e-4),
)
"""Radians: steps to which angles are rounded in clouds that were written in polar coordinates, the
coarsest of each unit first."""

ON_ROUNDED, ROUNDED_APART = 0.05, 1.5
"""ON_ROUNDED: largest deviation of rounded coordinates from whole steps, in steps, that single
precision causes. ROUNDED_APART: largest error of a point, in steps, that the rounding explains; a
laser that looks half-way between two steps is rounded to either of them."""


@checked
def estimate_lattice(
    frames: LidarFrame | ArrayLike | Iterable[LidarFrame | ArrayLike],
) -> SensorLattice:
    """Estimate the lattice of a scanner from scans of it.

    A minority of forged points has no effect, because every fit follows the majority.

    Parameters
    ----------
    frames : LidarFrame, (N, 3) or (N, 4) points, metres, or several of them
        Scans as the scanner recorded them, with the scanner at the origin; the fourth column, with
        intensities, is not used. Without ``ring``, either the points must be in KITTI's order, ring
        after ring with ascending or descending azimuths, or the elevation of each laser must be
        constant to a millionth of a degree.

    Returns
    -------
    SensorLattice

    Raises
    ------
    InputError
        No rings can be distinguished, because the points are in another order or the cloud was
        moved.

    Notes
    -----
    KITTI's HDL-64E has 64 lines (accurate to 0.3 mm, because of rounding to whole millimetres), an
    encoder of 4000 counts, lasers 26 mm left or right of the axis, and ranges in steps of 2 mm.
    Lasers are ordered by slope. The appendix of Velodyne's HDL-64E S2 manual describes these
    numbers of a calibration.

    Clouds of other scanners (Hesai, Ouster), as their drivers compute them, are exact: to single
    precision, points lie on the lines, at whole steps of azimuth and at whole steps of range. The
    lattice then has a ``tolerance`` of 0.1 mm.

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
    clouds = [Cloud.of(frame) for frame in _listed(frames)]
    if not clouds:
        raise InputError("frames: expected at least one scan, got none")
    slope, offset = find_lines(clouds)
    rho = np.concatenate([cloud.rho for cloud in clouds])
    z = np.concatenate([cloud.points[:, 2] for cloud in clouds])
    angle = np.concatenate([cloud.azimuth for cloud in clouds])
    frame = np.repeat(np.arange(len(clouds)), [len(cloud.rho) for cloud in clouds])
    ring = on_lines(rho, z, slope, offset)
    if 2 * np.count_nonzero(ring >= 0) < len(ring):
        raise InputError(
            f"frames: expected points on the lines of a scanner's lasers, found "
            f"{np.mean(ring >= 0):.0%} of them within {1000 * LINE_TOLERANCE:.0f} mm of one"
        )
    xyz = np.concatenate([cloud.points for cloud in clouds])
    members = [np.flatnonzero(ring == k) for k in range(len(slope))]
    exact = exact_lattice(rho, z, angle, frame, members, slope, offset)
    if exact is not None:
        return exact
    steps = find_steps(rho, angle, members)
    lateral, azimuth = np.zeros((2, len(slope)))
    if steps:
        starts = first_encoders(rho, angle, members, steps)
        fits = [
            fit_encoder(rho[rows], angle[rows], steps, *start)
            for rows, start in zip(members, starts, strict=True)
        ]
        lateral, azimuth = np.array(fits).T
        if not stands_on_steps(rho, angle, members, lateral, azimuth, steps):
            steps = 0
            lateral, azimuth = np.zeros((2, len(slope)))
    if steps:
        shifts = align_counts(rho, angle, frame, ring, lateral, azimuth, steps)
        azimuth += 2.0 * math.pi / steps * shifts
    range_step, phase, incoherence = find_range_step(rho, z, members, slope, lateral)
    return SensorLattice(
        slope,
        offset,
        lateral,
        np.mod(azimuth, 2.0 * math.pi),
        phase,
        *slope_trust(rho, z, members, slope, offset),
        steps,
        range_step,
        find_coordinate_step(xyz),
        incoherence,
    )


def without_roundings(
    reading: LatticeReading, points: NDArray[np.float32], tolerance: float
) -> LatticeReading:
    """Return a reading without the errors that are due to rounding of polar coordinates.

    Parameters
    ----------
    reading : LatticeReading
        Reading of the points.
    points : (N, 3) float32, metres
        Points in the scanner's frame.
    tolerance : float
        Metres: smaller errors are kept.

    Returns
    -------
    LatticeReading
        If nearly all azimuths, elevations or distances from the origin are whole multiples of one
        step, errors of such points up to 1.5 steps become 0.
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
    """Errors (m), set to 0 if a rounding of the coordinate to one of the steps explains them.

    A step of the angle or range corresponds to ``arm`` times as many metres.
    """
    off = np.abs(error) > tolerance
    for step in steps if off.any() else ():
        turns = value / step
        is_whole = np.abs(turns - np.round(turns)) < ON_ROUNDED
        if np.mean(is_whole) >= MIN_EXACT:  # finer steps would excuse more errors by chance
            explained = off & is_whole & (np.abs(error) <= ROUNDED_APART * step * arm)
            return np.where(explained, np.float32(0.0), error)
    return error


def _listed(
    frames: LidarFrame | ArrayLike | Iterable[LidarFrame | ArrayLike],
) -> Sequence[LidarFrame | ArrayLike]:
    if isinstance(frames, LidarFrame) or (isinstance(frames, np.ndarray) and frames.ndim == 2):
        return [frames]
    if not isinstance(frames, Iterable):
        raise InputError(f"frames: expected scans, got {frames!r}")
    return list(frames)
