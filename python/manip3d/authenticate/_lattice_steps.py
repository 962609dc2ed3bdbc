"""Find the steps in which a spinning scanner measures: of encoder, ranges and coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import line_fit
from manip3d.authenticate._lattice import LINE_TOLERANCE
from manip3d.authenticate._rings import MIN_LABELLED, MIN_POINTS

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

COORDINATE_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 1e-4)

RANGE_STEPS = (1e-2, 5e-3, 4e-3, 2.5e-3, 2e-3)
"""Range steps that are tried, metres; the coarsest first, since finer steps fit coarse data,
too."""

MIN_SPREAD = 1e-3
"""Metres: least difference between the nearest and the farthest point of a line fit in an exact
cloud; ``slope_error`` states how accurate the line is."""

MIN_PAIRS = 30
"""Fewest pairs of points at a given number of firings apart for estimating the encoder's counts."""

MAX_SEARCHED = 300
"""Number of points of a ring for the search over the grid `LATERALS`; of longer rings a subset of
this many to twice as many is used."""

LIKELY = 4
"""Number of lateral distances that are kept after that search."""

MAX_POINTS = 1000
"""Number of points of a ring (at most twice as many) that choose the best of these. A ring that
mostly meets the road has almost a single distance, so that only few points distinguish them."""

MAX_COMBED = 16_000
"""Number (at most twice as many are used) of pairs of points per number of firings apart, and of
points, on which steps are tested. With this many, the best coherence of 36 000 numbers of counts is
at most 0.04 by chance, while 0.5 is required."""

SECTORS = 16
"""Number of sectors of a ring that are judged separately."""

LATERALS = np.arange(-0.08, 0.0801, 0.002)
"""Metres: lateral distances between beam and axis that are tried; a fit then refines them."""


def parallax(lateral: float | Floats, rho: Floats) -> Floats:
    """Angle, seen from the axis, between a laser's direction and its return; radians.

    The beam passes the axis at the distance ``lateral``, metres. Points nearer than that cannot be
    on it; they are treated as its nearest point.
    """
    angle: Floats = np.arcsin(np.clip(lateral / rho, -1.0, 1.0))
    return angle


def find_steps(rho: Floats, angle: Floats, members: Sequence[NDArray[np.intp]]) -> int:
    """Encoder counts per revolution, found from azimuth differences within rings; 0: none."""
    size, fewest, most = 1 << 18, 600, 36000  # bins of a revolution: seven per count
    turns = np.zeros(size)
    rows = np.concatenate([ring for ring in members if len(ring)])
    same_ring = np.concatenate([np.full(len(ring), k) for k, ring in enumerate(members)])
    for lag in (1, 7, 49, 343):
        first, second = rows[:-lag], rows[lag:]
        alike = (same_ring[:-lag] == same_ring[lag:]) & (rho[first] > 10.0)
        # Equal parallax: for a beam 0.1 m beside the axis it differs by less than 2e-5 radians.
        alike &= np.abs(1.0 / rho[first] - 1.0 / rho[second]) < 2e-4
        pairs = np.flatnonzero(alike)
        pairs = pairs[:: max(1, len(pairs) // MAX_COMBED)]
        if len(pairs) < MIN_PAIRS:
            return 0
        turn = np.mod(angle[second[pairs]] - angle[first[pairs]], 2.0 * math.pi)
        bins = np.minimum((turn * (size / (2.0 * math.pi))).astype(np.int64), size - 1)
        turns += np.bincount(bins, minlength=size) / (4.0 * len(turn))
    middle = np.exp(-1j * math.pi / size * np.arange(most))  # shifts to the bins' middles
    coherence = np.real(np.fft.rfft(turns)[:most] * middle)
    best = fewest + int(coherence[fewest:].argmax())
    return best if coherence[best] > 0.5 else 0


def first_encoders(
    rho: Floats, angle: Floats, members: Sequence[NDArray[np.intp]], steps: int
) -> list[tuple[float, float]]:
    """Lateral distance (m) and angle at count 0 (rad) of each laser, by search over `LATERALS`.

    They maximise the absolute mean of ``exp(i steps (angle - lateral / rho))`` over the laser's
    points. Since the grid is evenly spaced, one product per point leads to its next value.
    """
    some = [rows[:: max(1, len(rows) // MAX_SEARCHED)] for rows in members]
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
        best_encoder(rho[rows], angle[rows], LATERALS[np.sort(places)], steps)
        for rows, places in zip(members, likely.T, strict=True)
    ]


def best_encoder(rho: Floats, angle: Floats, laterals: Floats, steps: int) -> tuple[float, float]:
    """The most coherent lateral distance for a laser's points, and the angle at count 0."""
    if len(rho) == 0:
        return 0.0, 0.0
    some = slice(None, None, max(1, len(rho) // MAX_POINTS))
    turns = steps * (angle[some] - laterals[:, None] / rho[some])
    waves = np.exp(1j * turns).mean(axis=1)
    best = np.abs(waves).argmax()
    return float(laterals[best]), float(np.angle(waves[best])) / steps


def fit_encoder(
    rho: Floats, angle: Floats, steps: int, lateral: float, azimuth: float
) -> tuple[float, float]:
    """Lateral distance (m) and angle at count 0 (rad, within one step) of one laser."""
    if len(rho) < MIN_POINTS:
        return 0.0, 0.0
    for _ in range(5):
        error = off_the_steps(rho, angle, lateral, azimuth, steps)
        near = np.abs(error) < LINE_TOLERANCE
        if near.sum() < 2 or np.ptp(rho[near]) <= MIN_SPREAD:
            break
        turn, shift = line_fit(rho[near], error[near])
        lateral, azimuth = lateral + shift, azimuth + turn
    return lateral, azimuth


def stands_on_steps(
    rho: Floats,
    angle: Floats,
    members: Sequence[NDArray[np.intp]],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> bool:
    """Whether fewer than 1 % of the points are off the steps in 3 of 4 sectors of the rings.

    In scans of an HDL-64E that holds for all sectors, apart from a few with forgeries. If azimuths
    are interpolated between packets (HDL-32E, VLP), a period may be found, but it only holds for a
    part of the turn.
    """
    shares = []
    for k, rows in enumerate(members):
        error = off_the_steps(rho[rows], angle[rows], lateral[k], azimuth[k], steps)
        off = np.abs(error) > LINE_TOLERANCE
        sector = (angle[rows] * (SECTORS / (2.0 * math.pi))).astype(np.intp).clip(0, SECTORS - 1)
        points = np.bincount(sector, minlength=SECTORS)
        enough = points >= MIN_LABELLED
        shares.append(np.bincount(sector, off, SECTORS)[enough] / points[enough])
    return bool(np.quantile(np.concatenate(shares), 0.75) < 0.01)


def off_step(angle: Floats, steps: int) -> Floats:
    """Deviation of angles from the nearest of ``steps`` steps per revolution, radians."""
    step = 2.0 * math.pi / steps
    return angle - np.round(angle / step) * step


def off_the_steps(rho: Floats, angle: Floats, lateral: float, azimuth: float, steps: int) -> Floats:
    """Distance along the arc from the nearest encoder step, metres."""
    beam = angle - parallax(lateral, rho) - azimuth
    return off_step(beam, steps) * rho


def align_counts(
    rho: Floats,
    angle: Floats,
    frame: NDArray[np.intp],
    ring: NDArray[np.int32],
    lateral: Floats,
    azimuth: Floats,
    steps: int,
) -> Floats:
    """Number of counts by which each laser looks ahead of the one with the most returns.

    All lasers fire at the same encoder counts, which are unevenly spaced in a revolution, but look
    in different directions. The cross-correlation of two lasers' returns over counts therefore
    peaks at the difference of their directions.
    """
    known = ring >= 0
    beam = angle[known] - parallax(lateral[ring[known]], rho[known]) - azimuth[ring[known]]
    count = np.mod(np.round(beam * (steps / (2.0 * math.pi))), steps).astype(np.int64)
    shape = (int(frame.max()) + 1, len(lateral), steps)
    answered = np.zeros(shape)
    answered[frame[known], ring[known], count] = 1.0
    window = np.zeros(steps)
    window[np.arange(-10, 11)] = 1.0 / 21.0  # slow variations are due to the street, not to firings
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


def find_range_step(
    rho: Floats,
    z: Floats,
    members: Sequence[NDArray[np.intp]],
    slope: Floats,
    lateral: Floats,
    steps: Sequence[float] = RANGE_STEPS,
) -> tuple[float, Floats, float]:
    """Step of the ranges (m), phase of each laser (m), and share of ranges a quarter step off."""
    cosine = 1.0 / np.sqrt(1.0 + slope**2)
    ranges = [
        np.sqrt(np.maximum(rho[rows] ** 2 - lateral[k] ** 2, 0.0)) * cosine[k]
        + z[rows] * slope[k] * cosine[k]
        for k, rows in enumerate(members)
    ]
    thinned = max(1, sum(len(r) for r in ranges) // MAX_COMBED)
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
    """Mean of ``exp(2 pi i range / step)`` of each laser; 0 if it has no range."""
    turn = 2j * math.pi / step
    return np.array([np.exp(turn * r).mean() if len(r) else 0.0j for r in ranges])


def find_coordinate_step(points: Floats) -> float:
    """The coarsest step, metres, of which nearly all coordinates are whole multiples; 0: none."""
    some = points[:: max(1, len(points) // 20_000)]
    for step in COORDINATE_STEPS:
        off = np.abs(some - np.round(some / step) * step).max(axis=1)
        if np.mean(off < 1e-5) > 0.9:
            return step
    return 0.0
