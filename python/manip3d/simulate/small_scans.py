"""Simulate small LiDAR scans in closed form, with NumPy alone, for examples and first trials.

`terrestrial_scan` and `hdl64e` cast rays at whole scenes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d._util.options import generator_of
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame
from manip3d.simulate._world import Label
from manip3d.simulate.lidar import (
    WEAK_ECHO,
    beams,
    firings,
    free_beams,
    measured_points,
    reflectances,
    with_own_car,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from manip3d._util.options import Rng

__all__ = ["cave", "courtyard"]

Doubles = NDArray[np.float64]

ANGLE_NOISE = 1e-5
"""Radians: standard deviation of the azimuths of a terrestrial scanner."""

FINEST_DEG = 0.01
"""Degrees: least step of the grid of a cave, which then has 120 million points."""

YARD = (-26.0, -14.0, -1.73), (31.0, 11.0, 30.0)
"""Metres: lowest and highest corner of the courtyard with its ground and its walls."""
BOXES = (
    ((9.0, 4.0, -1.73), (12.0, 6.0, 0.2)),
    ((-12.0, -8.0, -1.73), (-8.0, -6.0, 0.0)),
    ((3.0, -9.0, -1.73), (4.0, -8.0, 1.5)),
    ((16.0, -6.0, -1.73), (16.5, -4.5, 0.5)),
    ((-16.0, 5.0, -1.73), (-13.0, 5.8, 0.4)),
)
"""Metres: lowest and highest corner of each box in the courtyard."""
RANGE_NOISE = 0.011
"""Metres: standard deviation of the ranges in the courtyard between shots, as in `hdl64e`."""
_LABELS = np.array([Label.WALL, Label.WALL, Label.GROUND])  # of the yard's sides, by their axes
LOST = 0.003
"""Share of the pulses in the courtyard without a return."""


@checked
def cave(
    resolution_deg: float = 0.3,
    *,
    field_of_view: tuple[tuple[float, float], tuple[float, float]] = (
        (-60.0, 60.0),
        (-40.0, 60.0),
    ),
    range_noise: float = 0.003,
    rng: Rng = 0,
) -> LidarFrame:
    """Scan a bumpy cave, 5 to 11 m wide, on the angular grid of a terrestrial scanner.

    Parameters
    ----------
    resolution_deg : float
        Step of the grid in azimuth and in elevation, degrees. The detectors recognise a terrestrial
        scanner by its fine grid: at coarser steps than the default their verdict is undecidable.
    field_of_view : ((azimuth, azimuth), (elevation, elevation)), degrees
        Begin and end of the grid.
    range_noise : float, metres
        Standard deviation of a range.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.

    Returns
    -------
    LidarFrame
        The scanner is at the origin; the points stand column by column, each column upwards.

    Raises
    ------
    InputError
        The step is below 0.01 degrees, the noise is negative, or the field of view is empty.

    Examples
    --------
    >>> from manip3d import simulate
    >>> simulate.cave().num_points
    133200
    """
    if not (FINEST_DEG <= resolution_deg < math.inf):
        raise InputError(
            f"resolution_deg: expected degrees from {FINEST_DEG} on, got {resolution_deg}"
        )
    if not (0.0 <= range_noise < math.inf):
        raise InputError(f"range_noise: expected a finite number >= 0, got {range_noise}")
    if not np.isfinite(field_of_view).all():
        raise InputError(f"field_of_view: expected finite degrees, got {field_of_view}")
    random = generator_of(rng)
    azimuth, elevation = np.meshgrid(
        *(_middles(first, last, resolution_deg) for first, last in field_of_view), indexing="ij"
    )
    if not azimuth.size:
        raise InputError(f"field_of_view: expected at least one step, got {field_of_view}")
    distance = 8.0 + 3.0 * np.sin(3.0 * azimuth) * np.cos(2.0 * elevation)
    distance += random.normal(0.0, range_noise, azimuth.shape)
    azimuth += random.normal(0.0, ANGLE_NOISE, azimuth.shape)
    level = np.cos(elevation)
    beam = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    points = (np.stack(beam, axis=-1) * distance[..., None]).reshape(-1, 3)
    return LidarFrame(points.astype(np.float32), origin=(0.0, 0.0, 0.0), source="simulate.cave")


def _middles(first: float, last: float, step: float) -> Doubles:
    """Return the middles of the steps of an interval in degrees, in radians."""
    middles: Doubles = np.radians(np.arange(first + step / 2.0, last, step))
    return middles


@checked
def courtyard(x: float = 0.0, *, rng: Rng = 0) -> LidarFrame:
    """Scan a courtyard with five boxes by one turn of KITTI's HDL-64E.

    Neighbouring turns are scans from positions some decimetres apart, with different seeds. The car
    that carries the scanner stands still during a turn.

    Parameters
    ----------
    x : float, metres
        Position of the scanner, which looks along the x axis; from -8 to 8.
    rng : int, numpy.random.Generator or None
        Seed or generator of the noise, the lost pulses and the motor's wobble; None: a different
        result each time.

    Returns
    -------
    LidarFrame
        Points with the scanner at the origin, in the order of KITTI's files. The field ``object``
        is the number of the box, from 0; -1: ground, walls and the car.

    Raises
    ------
    InputError
        ``x`` is out of range.

    Examples
    --------
    >>> from manip3d import simulate
    >>> scan = simulate.courtyard()
    >>> scan.num_points
    128198
    >>> sorted(set(scan.fields["object"].tolist()))
    [-1, 0, 1, 2, 3, 4]
    """
    if not -8.0 <= x <= 8.0:
        raise InputError(f"x: expected -8 <= metres <= 8, got {x}")
    random = generator_of(rng)
    encoder, moment = firings(0.0, random)
    firing, ring = free_beams(encoder)
    returned = random.random(len(ring)) >= LOST
    firing, ring = firing[returned], ring[returned]
    start, direction = beams(encoder[firing], ring)
    place = np.array([x, 0.0, 0.0])
    distance, axis, box = _hits(start + place, direction)
    cosine = abs(direction[np.arange(len(axis)), axis])
    noise = random.normal(0.0, RANGE_NOISE, len(ring))
    points = measured_points(start, direction, distance + noise, ring)
    columns = (
        points.astype(np.float32),
        _reflectances(points + place, cosine, ring, random),
        ring.astype(np.uint8),
        np.where(box < 0, _LABELS[axis], Label.FURNITURE).astype(np.uint8),
        box,
        firing.astype(np.uint16),
    )
    scan = with_own_car(columns, encoder, moment, laser_bias=0.0)
    return replace(scan.frame, source="simulate.courtyard")


def _hits(
    start: Doubles, direction: Doubles
) -> tuple[Doubles, NDArray[np.int64], NDArray[np.int32]]:
    """Return the distance to the first surface, the axis of its normal, and the number of the box.

    A beam meets a box where it has entered all three of its slabs [Kay and Kajiya, SIGGRAPH 1986],
    and the courtyard, in which it begins, where it leaves the first slab.
    """
    _, leave = _slabs(start, direction, *YARD)
    axis = leave.argmin(axis=1)
    distance = leave.min(axis=1)
    number = np.full(len(start), -1, np.int32)
    for k, (low, high) in enumerate(BOXES):
        enter, leave = _slabs(start, direction, low, high)
        first = enter.max(axis=1)
        hit = (first > 0.0) & (first < leave.min(axis=1)) & (first < distance)
        distance[hit], axis[hit], number[hit] = first[hit], enter[hit].argmax(axis=1), k
    return distance, axis, number


def _slabs(
    start: Doubles, direction: Doubles, low: ArrayLike, high: ArrayLike
) -> tuple[Doubles, Doubles]:
    """Return where each beam enters and leaves the slabs of a box along the three axes, (N, 3)."""
    with np.errstate(divide="ignore"):
        ends = (np.asarray(low) - start) / direction, (np.asarray(high) - start) / direction
    return np.minimum(*ends), np.maximum(*ends)


def _reflectances(
    places: Doubles, cosine: Doubles, ring: NDArray[np.int64], random: np.random.Generator
) -> NDArray[np.float32]:
    """Return the reflectances of places in the courtyard, as bright in all turns."""
    painted = 0.55 + 0.45 * np.sin(places[:, 0]) * np.cos(places[:, 1])
    ones = np.ones(len(ring), np.float32)  # strong echoes, and no surface noisier than another
    return reflectances(
        painted.astype(np.float32), cosine.astype(np.float32), WEAK_ECHO * ones, ring, ones, random
    )
