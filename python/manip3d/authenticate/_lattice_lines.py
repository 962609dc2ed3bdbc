"""Find the lines on which the returns of a spinning scanner lie, one per laser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.linear import line_fit
from manip3d.authenticate._lattice import COLUMNS, LINE_TOLERANCE
from manip3d.authenticate._rings import MIN_LABELLED, MIN_POINTS, Cloud
from manip3d.errors import InputError

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

MIN_LINES, MAX_LINES = 4, 128
"""Smallest and largest number of lines of a scanner: no scanner has more lasers. Clouds with
rounded elevations lie on hundreds of lines; they are refused, because points between such lines are
no evidence."""

NARROW = 0.05
"""Metres: if the distances of most of a ring's points from the axis differ by less (the scanner's
own car, or a wall around it), they do not determine the slope of its line."""

MAX_OF_A_RING = (0.05, 0.95)
"""Quantiles of the distances; the few points beyond them may be forged."""

MAX_PAIRED = 250
"""Number of points of a ring (at most twice as many) from which lines are proposed, each through
one point of the nearer half and one of the farther half."""


def find_lines(clouds: Sequence[Cloud]) -> tuple[Floats, Floats]:
    """Slopes and offsets of the lines on which the rings of the clouds agree, the highest first."""
    rings = [(cloud, ring) for cloud in clouds for ring in cloud.rings]
    # A ring may be wide only because of forged points; its other points then decide.
    wide = [_fit_wide_ring(cloud, ring) for cloud, ring in rings]
    known = [line[1] for line in wide if line is not None]
    height = float(np.median(known)) if known else 0.0  # not 0 if the cloud was moved up or down
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
    ring = on_lines(rho, z, slope, offset)
    members = [np.flatnonzero(ring == k) for k in range(len(slope))]
    fits = [
        line_fit(rho[rows], z[rows])
        if len(rows) >= MIN_POINTS and _is_wide(rho[rows])
        else (slope[k], offset[k])
        for k, rows in enumerate(members)
        if len(rows) >= MIN_LABELLED
    ]
    _check_lines(len(fits))  # rounded or noisy rings may agree on lines with few points
    return np.array(fits)[:, 0], np.array(fits)[:, 1]


def _is_wide(rho: Floats) -> bool:
    low, high = np.quantile(rho, MAX_OF_A_RING)
    return bool(high - low > NARROW)


def _check_lines(found: int) -> None:
    if not MIN_LINES <= found <= MAX_LINES:
        raise InputError(
            f"frames: expected the rings of a spinning scanner ({MIN_LINES} to {MAX_LINES}), "
            f"ring after ring and each by azimuth, or `ring`; found {found} lines"
        )


def _fit_wide_ring(cloud: Cloud, ring: NDArray[np.intp]) -> tuple[float, float, int] | None:
    """Slope, offset and number of points of the best line through two points; None: none fits."""
    some = ring[:: max(1, len(ring) // MAX_PAIRED)]
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
    if not _is_wide(cloud.rho[inside]):
        return None
    return float(slope[best]), float(offset[best]), len(inside)


def _fit_narrow_ring(
    cloud: Cloud, ring: NDArray[np.intp], height: float
) -> tuple[float, float, int] | None:
    """The line through the scanner, if nearly all points of a ring lie on it; else None."""
    rho, rise = cloud.rho[ring], cloud.points[ring, 2] - height
    slope = float(np.median(rise / rho))
    inside = int(np.count_nonzero(np.abs(rise - slope * rho) < LINE_TOLERANCE))
    return (slope, height, inside) if inside >= 0.9 * len(ring) else None


def on_lines(rho: Floats, z: Floats, slope: Floats, offset: Floats) -> NDArray[np.int32]:
    """Index of the line on which each point lies; -1: on none."""
    table = np.zeros((len(slope), len(COLUMNS)))
    table[:, 0], table[:, 1] = slope, offset
    cloud = np.ascontiguousarray(np.column_stack([rho, np.zeros_like(rho), z]), np.float32)
    ring, _, _, error, _, _ = _core.read_lattice(cloud, table, 0, 0.0, 0.0, 1)
    found: NDArray[np.int32] = np.where(np.abs(error) < LINE_TOLERANCE, ring, np.int32(-1))
    return found
