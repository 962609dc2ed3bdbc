"""The steps in which a spinning scanner measures: of its encoder, of ranges and of coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import line_fit
from manip3d.authenticate._lattice import LINE_TOLERANCE
from manip3d.authenticate._rings import FEWEST_LABELLED, FEWEST_POINTS

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

COORDINATE_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 1e-4)

RANGE_STEPS = (1e-2, 5e-3, 4e-3, 2e-3)
"""Metres that are looked for, the coarsest first: every finer one fits a coarser one's data."""

LEAST_SPREAD = 1e-3
"""Metres from nearest to farthest that a line of an exact cloud needs; how far it can be trusted is
in ``slope_error``."""

FEWEST_PAIRS = 30
"""Fewest pairs of points a given number of firings apart, for the encoder's counts."""

MOST_SEARCHED = 300
"""Points of a ring for a search over a grid; of longer rings so many to twice as many are taken."""

LIKELY = 4
"""Places of the grid that are kept of that search."""

MOST_POINTS = 1000
"""Points of a ring (twice as many at most) by which the best of these places is chosen. A ring that
mostly meets the road has all but one distance, and few points tell the places apart."""

MOST_COMBED = 16_000
"""Pairs of points for each number of firings apart, and points (twice as many at most), to which a
comb of steps is laid: 36 000 combs agree with so many by chance to 0.04 at most, where half is
asked for."""

SECTORS = 16
"""Sectors of a ring, judged one by one."""

LATERALS = np.arange(-0.08, 0.0801, 0.002)
"""Metres between beam and axis that are tried; the fit behind the search finds the rest."""


def parallax(lateral: float | Floats, rho: Floats) -> Floats:
    """Angle between a beam that passes the axis at a distance and what it meets, from the axis.

    Points nearer than that, which are on no such beam, are taken to lie where it is nearest.
    """
    angle: Floats = np.arcsin(np.clip(lateral / rho, -1.0, 1.0))
    return angle


def find_steps(rho: Floats, angle: Floats, members: Sequence[NDArray[np.intp]]) -> int:
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


def first_encoders(
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
        best_encoder(rho[rows], angle[rows], LATERALS[np.sort(places)], steps)
        for rows, places in zip(members, likely.T, strict=True)
    ]


def best_encoder(rho: Floats, angle: Floats, laterals: Floats, steps: int) -> tuple[float, float]:
    """The lateral distance, of some, that a laser's points agree on, and the angle they give."""
    if len(rho) == 0:
        return 0.0, 0.0
    some = slice(None, None, max(1, len(rho) // MOST_POINTS))
    turns = steps * (angle[some] - laterals[:, None] / rho[some])
    waves = np.exp(1j * turns).mean(axis=1)
    best = np.abs(waves).argmax()
    return float(laterals[best]), float(np.angle(waves[best])) / steps


def fit_encoder(
    rho: Floats, angle: Floats, steps: int, lateral: float, azimuth: float
) -> tuple[float, float]:
    """Lateral distance (m) and angle at count 0 (rad, within one step) of one laser."""
    if len(rho) < FEWEST_POINTS:
        return 0.0, 0.0
    for _ in range(5):
        error = off_the_steps(rho, angle, lateral, azimuth, steps)
        near = np.abs(error) < LINE_TOLERANCE
        if near.sum() < 2 or np.ptp(rho[near]) <= LEAST_SPREAD:
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
    """Whether three quarters of all places, a sector of a ring each, are as good as free of points
    off the steps: of an HDL-64E all are, forgeries spoil a few. Where azimuths are interpolated
    between packets (HDL-32E, VLP) there may be a period, but it holds for a part of the turn."""
    shares = []
    for k, rows in enumerate(members):
        error = off_the_steps(rho[rows], angle[rows], lateral[k], azimuth[k], steps)
        off = np.abs(error) > LINE_TOLERANCE
        sector = (angle[rows] * (SECTORS / (2.0 * math.pi))).astype(np.intp).clip(0, SECTORS - 1)
        points = np.bincount(sector, minlength=SECTORS)
        enough = points >= FEWEST_LABELLED
        shares.append(np.bincount(sector, off, SECTORS)[enough] / points[enough])
    return bool(np.quantile(np.concatenate(shares), 0.75) < 0.01)


def off_step(angle: Floats, steps: int) -> Floats:
    """Radians from the nearest of so many steps in a revolution."""
    step = 2.0 * math.pi / steps
    return angle - np.round(angle / step) * step


def off_the_steps(rho: Floats, angle: Floats, lateral: float, azimuth: float, steps: int) -> Floats:
    """Metres from the nearest step of the encoder."""
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
    """Counts by which each laser looks ahead of the first, from the pattern of the firings.

    All lasers fire at the same counts, which the revolution spaces unevenly, but look in different
    directions then: the correlation of who answered when peaks at the difference.
    """
    known = ring >= 0
    beam = angle[known] - parallax(lateral[ring[known]], rho[known]) - azimuth[ring[known]]
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


def find_range_step(
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


def find_coordinate_step(points: Floats) -> float:
    """The coarsest step, in metres, of which coordinates are whole numbers; 0: none is."""
    some = points[:: max(1, len(points) // 20_000)]
    for step in COORDINATE_STEPS:
        off = np.abs(some - np.round(some / step) * step).max(axis=1)
        if np.mean(off < 1e-5) > 0.9:
            return step
    return 0.0
