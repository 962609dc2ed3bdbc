"""Estimate the lattice from exact clouds: with the unrounded coordinates of the scanner's
driver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import line_fit, product
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._lattice_steps import (
    LATERALS,
    MAX_SEARCHED,
    MIN_SPREAD,
    RANGE_STEPS,
    best_encoder,
    find_range_step,
    first_encoders,
    off_step,
    off_the_steps,
    parallax,
)
from manip3d.authenticate._rings import MIN_EXACT, MIN_LABELLED, MIN_POINTS, NEAREST
from manip3d.authenticate._slipped_columns import APART, Placed, steps_of_slips

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    from manip3d.authenticate._lattice import LatticeReading

    Floats: TypeAlias = NDArray[np.float64]

EXACT_TOLERANCE = 1e-4
"""Metres: largest distance of points of an exact cloud from their line or step. Single precision
leaves an error of 3e-5 m at 100 m."""

EXACT_STEPS = (512, 1024, 1800, 2048, 3600, 4096, 9000, 18_000, 36_000)
"""Numbers of encoder counts per turn that are tried for exact clouds, the coarsest first: Ouster's
columns per turn, and multiples of 0.01 degrees, in which Hesai's packets state azimuths."""

MAX_STEPS_BESIDE = 4096
"""Up to this number of counts, beams may pass beside the axis. The lateral distances that are tried
(`LATERALS`) are too coarse for finer encoders, whose scanners have beams through the axis."""

EXACT_RANGE_STEPS = (*RANGE_STEPS, 1e-3)
"""Range steps, metres, that are tried for exact clouds; Ouster measures whole millimetres."""

MAX_FITS = 40
"""Largest number of line fits, each to the points near the previous line. Most converge after five;
eight were too few for a laser of an OS1-128, and left its points 0.1 mm off its steps."""

TRIED_AGAIN = 16
"""Number of starting points, from `LATERALS`, for the fit of a laser if the likeliest one fails."""

MIN_SEEN, MIN_SEEN_BETWEEN = 1.0 / 20.0, 1.0 / 10.0
"""Least number of whole degrees of azimuth with points on a line of a laser, as a share of that of
the line with most: MIN_SEEN of the highest and lowest lines, and MIN_SEEN_BETWEEN of those
between two lines that reach this share. An object of another scanner's cloud brings lines of its
own, which are as wide as the object. In eight clean clouds of eight scanners the share is above a
seventh between such lines, and below MIN_SEEN for the outermost line of two scanners."""

MIN_ON_STEPS = 0.5
"""Least share of a laser's points that are on its steps, in each scan of its lattice: an edit moves
fewer points of a laser. It was not chosen on data. In simulated clouds of three scanners, one of
them with four sequences of start angles, the share is at least 0.82 for the true step, and 0 in the
scans that a step twice or ten times the true one does not fit."""


def exact_lattice(
    rho: Floats,
    z: Floats,
    angle: Floats,
    frame: NDArray[np.intp],
    members: Sequence[NDArray[np.intp]],
    slope: Floats,
    offset: Floats,
) -> SensorLattice | None:
    """The lattice of exact clouds; None if their coordinates are rounded.

    ``frame`` is the number of the scan of each point.
    """
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
    # A line without any point within EXACT_TOLERANCE is not the line of a laser.
    kept = [k for k in _one_below_the_other(slope, on) if len(on[k])]
    slope, offset, on = slope[kept], offset[kept], [on[k] for k in kept]
    seen = _seen_widely([angle[rows] for rows in on])
    slope, offset, on = slope[seen], offset[seen], [on[k] for k in seen]
    if sum(map(len, on)) < MIN_EXACT * len(rho):
        return None
    steps, lateral, azimuth = _exact_steps(rho, angle, frame, on)
    if steps:
        placed = _placed(rho, angle, frame, on, lateral, azimuth, steps)
        steps = steps_of_slips(placed, steps, EXACT_STEPS, EXACT_TOLERANCE)
    range_step, phase, incoherence = find_range_step(rho, z, on, slope, lateral, EXACT_RANGE_STEPS)
    center, slope_error = slope_trust(rho, z, on, slope, offset)
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
    """Indices of lines with strictly descending slopes.

    Of two lines out of order, the one with more points is kept, because the other one was found on
    moved points, between two lasers.
    """
    kept: list[int] = []
    for k in range(len(slope)):
        while kept and not slope[k] < slope[kept[-1]] and len(on[k]) > len(on[kept[-1]]):
            kept.pop()
        if not kept or slope[k] < slope[kept[-1]]:
            kept.append(k)
    return kept


def _seen_widely(angles: Sequence[Floats]) -> list[int]:
    """Indices of the lines that see enough of the turn for a laser; given in descending order."""
    degrees = [len(np.unique(np.degrees(each).astype(np.intp))) for each in angles]
    most = max(degrees, default=0)
    wide = [k for k, seen in enumerate(degrees) if seen >= MIN_SEEN_BETWEEN * most]
    return [
        k
        for k, seen in enumerate(degrees)
        if k in wide or (seen >= MIN_SEEN * most and not wide[0] < k < wide[-1])
    ]


def _fit_exactly(x: Floats, y: Floats, slope: float, offset: float) -> tuple[float, float]:
    """The line near a given one on which most points lie to single precision.

    If there are too few such points, the given line is returned.
    """
    found = slope, offset
    before: NDArray[np.bool_] | None = None
    for _ in range(MAX_FITS):
        error = np.abs(y - found[0] * x - found[1])
        inside = error <= max(3.0 * _median(error), 1e-6)
        if np.count_nonzero(inside) < MIN_LABELLED or np.ptp(x[inside]) <= MIN_SPREAD:
            break
        if before is not None and np.array_equal(inside, before):
            break
        found, before = line_fit(x[inside], y[inside]), inside
    return found


def _median(values: Floats) -> float:
    """Return `numpy.median` in a quarter of its time for the few points of a ring; 0 if empty."""
    half = len(values) // 2
    if len(values) == 0 or np.isnan(values.max()):
        return 0.0 if len(values) == 0 else math.nan
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    below, above = np.partition(values, (half - 1, half))[half - 1 : half + 1].tolist()
    return float((below + above) / 2.0)


def _exact_steps(
    rho: Floats, angle: Floats, frame: NDArray[np.intp], members: Sequence[NDArray[np.intp]]
) -> tuple[int, Floats, Floats]:
    """Number of encoder counts, and each laser's lateral distance (m) and angle at count 0 (rad).

    The number of counts is 0 if the points stand on the steps of none of `EXACT_STEPS`.
    """
    zero = np.zeros(len(members))
    for steps in EXACT_STEPS:  # beams through the axis
        azimuth = np.array([_first_azimuth(rho[rows], angle[rows], steps) for rows in members])
        if _stand_on_steps(rho, angle, frame, members, zero, azimuth, steps):
            return steps, *_fit_all_beside(rho, angle, members, zero, azimuth, steps)
    for steps in (n for n in EXACT_STEPS if n <= MAX_STEPS_BESIDE):
        first = np.array(first_encoders(rho, angle, members, steps)).reshape(-1, 2)
        lateral, azimuth = _fit_all_beside(rho, angle, members, first[:, 0], first[:, 1], steps)
        if _stand_on_steps(rho, angle, frame, members, lateral, azimuth, steps):
            for k, rows in enumerate(members):
                start = float(lateral[k]), float(azimuth[k])
                lateral[k], azimuth[k] = _fit_again(rho[rows], angle[rows], steps, *start)
            return steps, lateral, azimuth
    return 0, zero, zero


def _first_azimuth(rho: Floats, angle: Floats, steps: int) -> float:
    """Angle at count 0 (rad) of a laser through the axis.

    Points beside the steps, on one side of them, move the most coherent angle. They do not move the
    median if they are the minority.
    """
    azimuth = best_encoder(rho, angle, np.zeros(1), steps)[1]
    return azimuth + _median(off_step(angle - azimuth, steps))


def _placed(
    rho: Floats,
    angle: Floats,
    frame: NDArray[np.intp],
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> Placed:
    """The points of all lasers on the steps of azimuth."""
    rows = np.concatenate(members)
    laser = np.repeat(np.arange(len(members)), [len(each) for each in members])
    beam = angle[rows] - parallax(lateral[laser], rho[rows]) - azimuth[laser]
    count = np.mod(np.round(beam * (steps / (2.0 * math.pi))).astype(np.intp), steps)
    return Placed(rho[rows], laser, count, off_step(beam, steps) * rho[rows], frame[rows])


def with_slips(
    lattice: SensorLattice, points: NDArray[np.float32], reading: LatticeReading
) -> SensorLattice:
    """Return an exact lattice with the finer steps on which slipped columns of a scan stand, too.

    Parameters
    ----------
    lattice : SensorLattice
        Exact lattice that was estimated from other scans.
    points : (N, 3) float32, metres
        Points of the scan, with the scanner at the origin.
    reading : LatticeReading
        Their places on the lattice.

    Returns
    -------
    SensorLattice
        ``lattice`` itself if no columns slipped.
    """
    if not lattice.steps:
        return lattice
    rho = np.hypot(*points[:, :2].astype(np.float64).T)
    on = (reading.ring >= 0) & (reading.count >= 0) & (rho > NEAREST)
    rows = np.flatnonzero(on & (np.abs(reading.line_error) <= lattice.tolerance))
    placed = Placed(
        rho[rows],
        reading.ring[rows].astype(np.intp),
        reading.count[rows].astype(np.intp),
        reading.step_error[rows].astype(np.float64),
        np.zeros(len(rows), np.intp),
    )
    steps = steps_of_slips(placed, lattice.steps, EXACT_STEPS, lattice.tolerance)
    return lattice if steps == lattice.steps else replace(lattice, steps=steps)


def _fit_again(
    rho: Floats, angle: Floats, steps: int, lateral: float, azimuth: float
) -> tuple[float, float]:
    """Repeat the fit from other starting points, if too few points are on the given steps.

    If the points of a laser lie at two distances only, as over roofs, several lateral distances are
    almost equally likely; the right one has the most points on its steps.
    """

    def share_on_steps(fit: tuple[float, float]) -> float:
        off = off_the_steps(rho, angle, *fit, steps)
        return float(np.mean(np.abs(off) < EXACT_TOLERANCE))

    best = lateral, azimuth
    if len(rho) < MIN_LABELLED or share_on_steps(best) >= MIN_EXACT:
        return best
    some = slice(None, None, max(1, len(rho) // MAX_SEARCHED))
    waves = np.exp(1j * steps * (angle[some] - LATERALS[:, None] / rho[some])).mean(axis=1)
    for place in np.argsort(-np.abs(waves), kind="stable")[:TRIED_AGAIN]:
        start = float(LATERALS[place]), float(np.angle(waves[place])) / steps
        fit = _fit_beside(rho, angle, steps, *start)
        best = max(best, fit, key=share_on_steps)
        if share_on_steps(best) >= MIN_EXACT:
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
    """Lateral distance (m) and angle at count 0 (rad) of each laser, near the given ones."""
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
    for _ in range(MAX_FITS):
        error = off_the_steps(rho, angle, lateral, azimuth, steps)
        off = np.abs(error)
        inside = off <= max(3.0 * _median(off), 1e-6)
        if np.count_nonzero(inside) < MIN_LABELLED or np.ptp(rho[inside]) <= MIN_SPREAD:
            break
        turn, shift = line_fit(rho[inside], error[inside])
        lateral, azimuth = lateral + shift, azimuth + turn
        if abs(turn) < 1e-12 and abs(shift) < 1e-9:
            break
    return lateral, azimuth


def _stand_on_steps(
    rho: Floats,
    angle: Floats,
    frame: NDArray[np.intp],
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> bool:
    """Whether most points are on a step, of those at which neighbouring steps are far enough apart.

    Twice the true step also fits a laser, but only in the scans that share the parity of its
    counts. A laser that is on the steps in one scan must therefore be on them in all scans.
    """
    scans = int(frame.max(initial=0)) + 1
    on, apart = np.zeros((2, scans, len(members)))
    for k, rows in enumerate(members):
        far = rows[rho[rows] * (2.0 * math.pi / steps) > APART * EXACT_TOLERANCE]
        off = off_the_steps(rho[far], angle[far], lateral[k], azimuth[k], steps)
        on[:, k] = np.bincount(frame[far], np.abs(off) < EXACT_TOLERANCE, scans)
        apart[:, k] = np.bincount(frame[far], minlength=scans)
    if apart.sum() < MIN_POINTS or on.sum() < MIN_EXACT * apart.sum():
        return False
    share = on / np.maximum(apart, 1.0)
    enough = apart >= MIN_POINTS
    is_on = (enough & (share >= MIN_EXACT)).any(axis=0)
    is_off = (enough & (share < MIN_ON_STEPS)).any(axis=0)
    return not (is_on & is_off).any()


def _step_trust(
    rho: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> Floats:
    """Standard error of each laser's azimuth, from the points on its steps; 1 without any."""
    found = np.ones(len(members))
    for k, rows in enumerate(members):
        off = off_the_steps(rho[rows], angle[rows], lateral[k], azimuth[k], steps)
        on = np.abs(off) < EXACT_TOLERANCE
        if on.any():
            spread = rho[rows][on] - rho[rows][on].mean()
            found[k] = math.sqrt(off[on].var() / max(float(product(spread, spread)), 1e-12))
    return found


def slope_trust(
    rho: Floats, z: Floats, members: Sequence[NDArray[np.intp]], slope: Floats, offset: Floats
) -> tuple[Floats, Floats]:
    """Mean distance of each line's points from the axis, and the standard error of its slope.

    The error is 1 if all points of a line are at the same distance, as its slope is unknown then.
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
