"""Detector I: points whose spacing does not follow from their distance (IsDensityConsistent)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting, threads_of
from manip3d._util.robust import NORMAL_MAD
from manip3d.authenticate._origin import NO_ORIGIN, scanner_position
from manip3d.authenticate._verdict import Calibration, Region, Verdict, WithoutRate, verdict_repr
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, ScanLike, placed, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress

    Floats = NDArray[np.float64]

MIN_POINTS = 1000
"""With fewer points, a scan has too few levels to compare."""

MIN_PEERS = 10
"""Fewest sectors with enough points at a level for its median spacing: more than one object
covers."""

USUAL = 0.05
"""If at least this share of all levels of all sectors is off, spacing does not follow from distance
in this scan, and nothing is judged."""


@checked
@dataclass(frozen=True)
class DensityParameters:
    """Parameters of `density_consistency`.

    Attributes
    ----------
    sector : int
        Size of a sector in azimuth and elevation, degrees; each sector has its own levels. 0: the
        whole scan is one sector.
    level_width, level_growth : float
        A level is an interval of range, ``max(level_width, level_growth * range)`` metres wide.
    window : int
        Number of levels of the moving average; odd.
    run : int
        Number of consecutive levels that must be off: "sudden and persistent".
    fall, rise : float
        A level is off if the ratio of measured to expected spacing is at most ``fall``, or at least
        ``rise``.
    deviation : float
        If above 0, it replaces ``fall`` and ``rise``: a level is off if it is this many robust
        standard deviations (from the median absolute deviation) from the fit.
    fewest : int
        Fewest points of a level that is judged.
    """

    sector: int = 3
    level_width: float = 0.05
    level_growth: float = 0.01
    window: int = 1
    run: int = 3
    fall: float = 0.75
    rise: float = 6.0
    deviation: float = 0.0
    fewest: int = 20

    def __post_init__(self) -> None:
        if self.window < 1 or self.window % 2 == 0:
            raise InputError(f"window: expected an odd number of levels, got {self.window}")
        if self.run < 1 or self.fewest < 1:
            raise InputError("run, fewest: expected at least 1")
        if not (0.0 < self.fall < 1.0 < self.rise):
            raise InputError("fall, rise: expected 0 < fall < 1 < rise")
        if not self.deviation >= 0.0:
            raise InputError(f"deviation: expected >= 0, got {self.deviation}")


PAPER_DENSITY = DensityParameters(
    sector=0, level_width=0.2, level_growth=0.0, window=7, deviation=3.5, fewest=10
)
"""Parameters of the dissertation: one signal over range, its moving average, and deviations that
are sudden and persistent."""

CALIBRATED_DENSITY = DensityParameters()
"""Parameters for terrestrial scans of millions of points."""

SPARSE_DENSITY = DensityParameters(
    sector=10, level_width=0.25, level_growth=0.02, fall=0.6, rise=5.0, fewest=30
)
"""Parameters for scans of fewer than `FEW_POINTS` points."""

FEW_POINTS = 500_000

_CALIBRATIONS = (
    (
        CALIBRATED_DENSITY,
        Calibration(
            scenes="calibration-indoor-00..11, -outdoor-00..11 of manip3d.simulate.scenes",
            num_scans=24,
            false_alarms=0,
            note="simulated terrestrial scans of 0.06 degrees; sector, fewest, fall and rise were "
            "chosen on these scans, clean and with two hoaxes each (CTP), half way between the "
            "clean scan and the forgery that come nearest to each other (1.286 and 1.391)",
        ),
    ),
    (
        SPARSE_DENSITY,
        Calibration(
            scenes="KITTI raw drive 2011_09_26_0002 (4 frames), two unidentified drives (5 frames)",
            num_scans=9,
            false_alarms=0,
            note="HDL-64E",
        ),
    ),
)


@dataclass(frozen=True, eq=False)
class DensityResult(WithoutRate):
    """Result of `density_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
    reason : str
        Reason of the verdict in words.
    ranges : (L,) float64, metres
        Middles of the levels.
    signal : (L,) float64, metres
        Mean nearest-neighbour distance of each level (median over the sectors), after the moving
        average; NaN at levels with too few points.
    fit : (L,) float64, metres
        Expected spacing at each level, fitted to the scan itself.
    ratio : (S, L) float64
        Spacing of each sector and level divided by the fit; NaN at levels with too few points.
    offending : (K, 2) float64, metres
        Begin and end of the ranges that are off.
    suspected : int32 array
        Rows of the points in levels that are off, ascending.
    regions : tuple of Region
        One region with all suspected points; empty if there are none.
    score : float
        The largest persistent deviation divided by its threshold; tampered if it is at least 1.
    parameters : DensityParameters
        Parameters of the detector.
    calibration : Calibration or None
        Clean scans on which the thresholds were chosen; None: they come from a publication or a
        user.
    scan : LidarFrame or None
        The scan that was judged; the viewer shows it.
    """

    verdict: Verdict
    reason: str
    ranges: Floats
    signal: Floats
    fit: Floats
    ratio: Floats
    offending: Floats
    suspected: NDArray[np.int32]
    regions: tuple[Region, ...]
    score: float
    parameters: DensityParameters
    calibration: Calibration | None
    scan: LidarFrame | None = field(default=None, repr=False)

    __repr__ = verdict_repr


@checked
def density_consistency(
    scan: ScanLike,
    *,
    parameters: DensityParameters | None = None,
    origin: ArrayLike | None = None,
    distances: ArrayLike | None = None,
    threads: int = 0,
    progress: Progress = None,
) -> DensityResult:
    """Find points whose density does not follow from their distance: detector I.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        A scan taken from one position.
    parameters : DensityParameters, optional
        Default: `CALIBRATED_DENSITY`, or `SPARSE_DENSITY` for fewer than half a million points.
        `PAPER_DENSITY` uses the dissertation's single signal.
    origin : (3,), optional
        Position of the scanner, metres; default: that of the frame, else the result of
        `estimate_origin`; (0, 0, 0) for an array.
    distances : (N,) float64, optional
        Distance of each point from its nearest neighbour, as `manip3d.metrics.nearest_distances`
        returns it; default: computed here.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    DensityResult

    Raises
    ------
    InputError
        A shape is wrong, a coordinate is not finite.

    Notes
    -----
    Dissertation, algorithm 1. The text quantises z "which represents the distance from the sensor";
    here that distance is the range r. For a single signal the expected spacing is a r, with a
    constant a. For sectors it is a monotone fit (pool adjacent violators) to the median over the
    sectors. Sectors are compared with each other at equal range, because an object of a few
    thousand points has no effect on the mean of a whole level.

    If sectors are compared, the scan itself shows whether spacing follows from range. If it does
    not in 5 % or more of all levels of all sectors, the reason is the scanner or the scenery, not
    an object, and nothing is judged. Examples are a tilting planar scanner, whose points crowd at
    two poles (3DTK: 5 % of the levels have less than half the usual spacing); leaves, in cells 13
    times as wide as high (the forest of a Riegl VZ-400i); and duplicated points, which have no
    spacing. On simulated terrestrial scans, clean or forged, 5 % of the levels have at most 0.87 of
    the usual spacing (0.75 is off); on frames of an HDL-64E, at most 0.74 to 0.87 (0.6 is off).

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import density_consistency
    >>> a, e = np.radians(np.mgrid[0:360:1, -40:60:1]).reshape(2, -1)
    >>> rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    >>> walls = (np.array([6, 4, 2]) / np.maximum(abs(rays), 1e-9)).min(axis=1, keepdims=True)
    >>> room = (rays * walls).astype(np.float32)
    >>> density_consistency(room).verdict
    'no_trace'
    """
    scene = to_scan(scan)
    if parameters is None:
        few = len(scene.points) < FEW_POINTS
        parameters = SPARSE_DENSITY if few else CALIBRATED_DENSITY
    if len(scene.points) < MIN_POINTS:
        return _undecidable(f"fewer than {MIN_POINTS} points", parameters)
    place = scanner_position(origin, scene, threads)
    if place is None:
        return _undecidable(NO_ORIGIN, parameters)
    if distances is None:
        with reporting(progress, "density") as report:
            spacing_of = _core.nearest_distances(
                scene.points, place, 0.0, threads_of(threads), report
            )
    else:
        spacing_of = np.ascontiguousarray(distances, np.float64)
    edges, spacing = _levels(scene.points, spacing_of, place, parameters, threads)
    signal = _typical(spacing)
    ranges = (edges[1:] + edges[:-1]) / 2
    fit = _proportional_fit(signal, ranges) if len(spacing) == 1 else _monotone_fit(signal, ranges)
    if not np.count_nonzero(np.isfinite(signal)) > parameters.run:
        return _undecidable("too few levels of range hold enough points", parameters)
    # if all points are duplicated, the fit is 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = spacing / fit
    if parameters.deviation == 0.0 and not (usual := _share_off(ratio, parameters)) < USUAL:
        return _undecidable(_no_law(usual), parameters)
    off, score = _off(ratio, parameters)
    suspected = _points_of(off, scene.points, place, parameters, threads)
    reason = f"spacing off its range's over at least {parameters.run} levels"
    return DensityResult(
        verdict="tampered" if off.any() else "no_trace",
        reason=reason if off.any() else "spacing follows range",
        ranges=ranges,
        signal=signal,
        fit=fit,
        ratio=ratio,
        offending=_ranges(np.asarray(off.any(axis=0)), edges),
        suspected=suspected,
        regions=_regions(scene.points, suspected),
        score=score,
        parameters=parameters,
        calibration=_calibration(parameters),
        scan=placed(scene, np.asarray(place, np.float64)),
    )


MAX_RANGE = 500.0  # metres; farther points are left out


def _levels(
    points: NDArray[np.float32],
    spacing_of: Floats,
    place: Floats,
    parameters: DensityParameters,
    threads: int,
) -> tuple[Floats, Floats]:
    """Borders of the levels of range, (L + 1,), and smoothed spacings, (sectors, L)."""
    sectors, edges, counts, means = _core.density_levels(
        points,
        spacing_of,
        place,
        parameters.sector,
        parameters.level_width,
        parameters.level_growth,
        MAX_RANGE,
        parameters.sector > 0,
        threads_of(threads),
    )
    spacing = np.where(counts >= parameters.fewest, means, np.nan).reshape(sectors, -1)
    return edges, _moving_average(spacing, parameters.window)


def _moving_average(values: Floats, window: int) -> Floats:
    """Mean of the finite values in the window of levels around each; NaN remains NaN."""
    if window == 1:
        return values
    known = np.isfinite(values)
    half = ((0, 0), (window // 2, window // 2))
    padded = np.pad(np.where(known, values, 0.0), half)
    number = np.pad(known.astype(np.int64), half)
    levels = values.shape[1]
    total, count = np.zeros(values.shape), np.zeros(values.shape, np.int64)
    for shift in range(window):  # a fixed order, so that sums do not depend on the CPU
        total = total + padded[:, shift : shift + levels]
        count = count + number[:, shift : shift + levels]
    return np.where(known, total / np.maximum(count, 1), np.nan)


def _typical(spacing: Floats) -> Floats:
    """Median over the sectors at each level; NaN if fewer than MIN_PEERS sectors are known."""
    if len(spacing) == 1:
        signal: Floats = spacing[0]
        return signal
    reached = np.isfinite(spacing)
    enough = np.count_nonzero(reached, axis=0) >= MIN_PEERS
    signal = np.full(spacing.shape[1], np.nan)
    if enough.any():
        some = reached.any(axis=1)
        signal[enough] = np.nanmedian(spacing[np.ix_(some, enough)], axis=0)
    return signal


def _proportional_fit(signal: Floats, ranges: Floats) -> Floats:
    """Expected spacing a r, where a is the median of signal / r; NaN where the signal is NaN."""
    known = np.isfinite(signal)
    if not known.any():
        return signal
    fit: Floats = np.where(known, float(np.median(signal[known] / ranges[known])) * ranges, np.nan)
    return fit


def _monotone_fit(signal: Floats, ranges: Floats) -> Floats:
    """Isotonic regression by pooling adjacent violators.

    Unknown levels are interpolated; before the first and after the last known level the fit is
    proportional to range.
    """
    levels = np.flatnonzero(np.isfinite(signal))
    if not len(levels):
        return signal
    pools: list[tuple[float, int]] = []  # each pool: mean, number of levels
    for value in signal[levels].tolist():
        pools.append((value, 1))
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (high, m), (low, n) = pools[-2:]
            pools[-2:] = [((high * m + low * n) / (m + n), m + n)]
    known = np.repeat([mean for mean, _ in pools], [size for _, size in pools])
    fit: Floats = np.interp(ranges, ranges[levels], known)
    first, last = levels[0], levels[-1]
    fit[:first] = known[0] * (ranges[:first] / ranges[first])
    fit[last + 1 :] = known[-1] * (ranges[last + 1 :] / ranges[last])
    return fit


def _off(ratio: Floats, parameters: DensityParameters) -> tuple[NDArray[np.bool_], float]:
    """Levels in runs of at least ``run`` levels that are off, and the score of the result."""
    if parameters.deviation > 0.0:
        residual = ratio - 1.0
        known = residual[np.isfinite(residual)]
        spread = NORMAL_MAD * float(np.median(np.abs(known - np.median(known))))
        size = residual / max(spread, 1e-9)
        low, high = -size, size
        limits = (parameters.deviation, parameters.deviation)
    else:
        with np.errstate(divide="ignore"):
            low, high = 1.0 / ratio, ratio
        limits = (1.0 / parameters.fall, parameters.rise)
    off = np.zeros(ratio.shape, np.bool_)
    score = 0.0
    for side, limit in zip((low, high), limits, strict=True):
        known = np.where(np.isfinite(side), side, -np.inf)
        lowest = known[:, : known.shape[1] - parameters.run + 1]
        for shift in range(1, parameters.run):
            lowest = np.minimum(lowest, known[:, shift : shift + lowest.shape[1]])
        starts = lowest >= limit
        for shift in range(parameters.run):
            off[:, shift : shift + starts.shape[1]] |= starts
        score = max(score, float(lowest.max(initial=0.0)) / limit)
    return off, score


def _share_off(ratio: Floats, parameters: DensityParameters) -> float:
    """Share of the known levels that are off; the larger one of too dense and too sparse."""
    known = ratio[np.isfinite(ratio)]
    if not len(known):
        return float("nan")
    sides = np.count_nonzero(known <= parameters.fall), np.count_nonzero(known >= parameters.rise)
    return max(sides) / len(known)


def _no_law(usual: float) -> str:
    """Reason of an undecidable result: too many levels are off, or no spacing is known."""
    if np.isnan(usual):
        return "no spacing is known: the points are there twice"
    return f"spacing off its range's in {usual:.0%} of the places: not a law of this scan"


def _points_of(
    off: NDArray[np.bool_],
    points: NDArray[np.float32],
    place: Floats,
    parameters: DensityParameters,
    threads: int,
) -> NDArray[np.int32]:
    """Rows of the points in levels that are off, ascending."""
    if not off.any():
        return np.empty(0, np.int32)
    return _core.points_of_levels(
        points,
        np.ascontiguousarray(off.ravel(), np.uint8),
        place,
        parameters.sector,
        parameters.level_width,
        parameters.level_growth,
        MAX_RANGE,
        threads_of(threads),
    )


def _ranges(off: NDArray[np.bool_], edges: Floats) -> Floats:
    """Begin and end, metres, of each run of levels that are off."""
    steps = np.diff(np.concatenate([[0], off.astype(np.int8), [0]]))
    return np.column_stack([edges[np.flatnonzero(steps == 1)], edges[np.flatnonzero(steps == -1)]])


def _regions(points: NDArray[np.float32], rows: NDArray[np.int32]) -> tuple[Region, ...]:
    """One region with all the points; empty if there are none."""
    if not len(rows):
        return ()
    low = points[rows].min(axis=0).astype(np.float64)
    high = points[rows].max(axis=0).astype(np.float64)
    box = Box(tuple(((low + high) / 2).tolist()), tuple((high - low).tolist()))
    return (Region(box, rows.astype(np.int64)),)


def _calibration(parameters: DensityParameters) -> Calibration | None:
    return next((known for key, known in _CALIBRATIONS if key == parameters), None)


def _undecidable(reason: str, parameters: DensityParameters) -> DensityResult:
    nothing = np.empty(0)
    return DensityResult(
        verdict="undecidable",
        reason=reason,
        ranges=nothing,
        signal=nothing,
        fit=nothing,
        ratio=np.empty((0, 0)),
        offending=np.empty((0, 2)),
        suspected=np.empty(0, np.int32),
        regions=(),
        score=0.0,
        parameters=parameters,
        calibration=_calibration(parameters),
    )
