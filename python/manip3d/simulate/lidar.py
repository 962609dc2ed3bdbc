"""Simulate a Velodyne HDL-64E on a moving car, as in KITTI's raw frames.

Properties of the real frames (measured on KITTI drive 2011_09_26_0002; the same numbers hold in all
other available raw, object and stereo frames):

- a laser's point is ``d`` metres along a beam that starts off the axis: ``z = slope * rho +
  offset`` and ``azimuth = 0.09 k + azimuth_deg + asin(horizontal / rho)`` with whole ``k``, both
  exact except for the rounding to 1 mm; ``d`` is a multiple of 2 mm plus an offset of the laser;
- the head turns clockwise in 103.1 ms and fires every 48 us: 2148 or 2149 firings, whose encoder
  value ``k`` (the same for all lasers) falls by 2, and about every seventh time by 1;
- a sweep begins and ends at encoder 178.2 degrees, behind the car;
- the car's own roof hides the lowest beams ahead and behind; the posts of its rack return some.
"""

from __future__ import annotations

import functools
import importlib.resources
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from manip3d._util.arrays import read_only
from manip3d._util.checked import checked
from manip3d._util.options import generator_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame
from manip3d.simulate._glass import lost
from manip3d.simulate._world import Label
from manip3d.simulate.streets import Street

if TYPE_CHECKING:
    from manip3d._util.options import Rng

__all__ = ["FIRING_PERIOD", "LidarScan", "hdl64e"]

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

FIRING_PERIOD = 48e-6
"""Seconds between firings (20 833 per second, HDL-64E S2 manual)."""
ENCODER_STEPS = 4000
"""Steps of the encoder per turn."""
STEP_DEG = 360.0 / ENCODER_STEPS
"""Degrees of one step of the encoder: 0.09."""
SEAM = 1980
"""Encoder value at which a sweep begins: 178.2 degrees."""
TURN_PERIOD = 0.10313
"""Seconds of one turn."""
PERIOD_SPREAD = 3e-5
"""Seconds: standard deviation of `TURN_PERIOD` between sweeps. The source of this number and of
`WOBBLE` is not recorded."""
WOBBLE = 0.6, 0.15
"""Steps of the encoder: amplitudes of the deviation from a uniform turn that has one period in a
turn, and of the one that has two."""
SPARE_FIRINGS = 4
"""Firings beyond a whole turn that are simulated before the turn is cut out of them: the firings
begin up to one period early, and the wobble is less than a step."""
FULL_LOSS = 25.0
"""Metres: the share of lost pulses is constant beyond this range. On smooth bright surfaces KITTI's
frames lose 0.02 % of the pulses up to 8 m, 0.06 % at 10 m, 0.2 % at 17 m and 0.3 to 0.4 % beyond
this range (18 frames of eight drives)."""
WEAK_ECHO = 6.0
"""Echoes weaker than this many times the weakest detected echo have intensity 0, as in KITTI's
frames."""
DIVERGENCE = 2e-3
"""Radians: width of a beam divided by its distance (HDL-64E S2 data sheet)."""
SPECKLE = 0.35
"""Standard deviation, between surfaces, of the logarithm of the noise of reflectances. In windows
of 6 lasers and 4 degrees of three drives of KITTI, the noise of the noisiest tenth is 2.2 times
that of the least noisy tenth."""

# These errors belong to the sensor and do not depend on the seed. Gains differ as those of KITTI's
# lasers.
_LASER_ERROR = np.random.default_rng(64).standard_normal(64)
_LASER_GAIN = np.random.default_rng(65).normal(0.0, 0.04, 64)
# Standard deviation of reflectances between shots; the upper block, for long ranges, is noisier.
# Second differences along the rings of three drives of KITTI give means of 0.08 and 0.05, partly
# due to patterns of surfaces, and a kurtosis of 4 to 5.
_LASER_NOISE = np.repeat([0.06, 0.04], 32) * np.exp(np.random.default_rng(66).normal(0.0, 0.2, 64))
_HEAVY_TAIL = 0.05
"""Weight of the cube of a normal number in that noise: it raises the kurtosis from 3 to 4.5."""


@dataclass(frozen=True, eq=False)
class LidarScan:
    """One sweep, each point in the sensor's frame at its firing, as in KITTI's raw frames.

    The motion of the car is not compensated. Points are in KITTI's order: rings from the top
    downwards, each counter-clockwise from straight ahead.

    Attributes
    ----------
    points : (N, 3) float32, metres
        Points on a grid of 1 mm; x forward, y left, z up.
    intensity : (N,) float32
        Reflectance, 0 to 0.99 in steps of 0.01.
    ring : (N,) uint8
        Laser; 0 is the highest.
    label : (N,) uint8
        Truth: kind of object (`manip3d.simulate.scenes.Label`).
    object : (N,) int32
        Truth: number of the object; -1: background, and the car that carries the sensor.
    firing : (N,) uint16
        Truth: number of the firing within the sweep.
    encoder : (F,) int16
        Truth: encoder value of each firing, in steps of 0.09 degrees.
    time : (F,) float64, seconds
        Time of each firing, on the street's clock; the sensor looks ahead at the frame's time.
    """

    points: Floats
    intensity: Floats
    ring: NDArray[np.uint8]
    label: NDArray[np.uint8]
    object: NDArray[np.int32]
    firing: NDArray[np.uint16]
    encoder: NDArray[np.int16]
    time: Doubles

    __repr__ = short_repr

    @property
    def frame(self) -> LidarFrame:
        """The sweep as a `LidarFrame` with the truth in its fields ``label`` and ``object``."""
        return LidarFrame(
            self.points,
            self.intensity,
            ring=self.ring,
            origin=(0.0, 0.0, 0.0),
            source="simulate.hdl64e",
            fields={"label": self.label, "object": self.object},
        )


@dataclass(frozen=True)
class Lasers:
    """The 64 lasers, from the highest to the lowest; each field (64,) float64.

    Attributes
    ----------
    slope, offset_m
        Points lie at ``z = slope * reach + offset_m``; ``reach``: see ``horizontal_m``.
    azimuth_deg
        Azimuth of the laser at encoder value 0.
    horizontal_m
        Distance at which the beam passes the axis: a point lies ``reach`` ahead along the laser's
        azimuth and ``horizontal_m`` to the left.
    range_offset_mm
        Ranges are multiples of 2 mm plus this.
    """

    slope: Doubles
    offset_m: Doubles
    azimuth_deg: Doubles
    horizontal_m: Doubles
    range_offset_mm: Doubles


@functools.cache
def lasers() -> Lasers:
    """Calibration of KITTI's HDL-64E, measured on its clouds; its arrays are read-only."""
    text = importlib.resources.files("manip3d.simulate").joinpath("hdl64e_lasers.csv").read_text()
    table = np.array([[float(cell) for cell in row.split(",")] for row in text.split()[1:]])
    return Lasers(*read_only(table).T[1:])


@checked
def hdl64e(
    street: Street,
    time: float = 0.0,
    *,
    range_noise: float = 0.011,
    laser_bias: float = 0.017,
    drop_out: float = 0.003,
    max_range: float = 80.0,
    rng: Rng = 0,
    threads: int = 0,
) -> LidarScan:
    """Simulate one sweep of an HDL-64E on the car that drives along a street.

    Parameters
    ----------
    street : Street
        Street with the car.
    time : float, seconds
        Time at which the sensor looks straight ahead; the sweep begins half a turn earlier.
    range_noise : float, metres
        Standard deviation of ranges between shots: 9 to 13 mm on smooth parts of KITTI's rings.
    laser_bias : float, metres
        Standard deviation of the lasers' constant range errors; together with ``range_noise`` 2 cm.
    drop_out : float
        Share of lost pulses on good surfaces 25 m away or farther; nearer it falls with the square
        of the range. Glass, dark and grazing surfaces lose more.
    max_range : float, metres
        KITTI keeps no point beyond 80 m.
    rng : int, numpy.random.Generator or None
        Seed or generator of noise, lost pulses and the motor's wobble. The lasers' errors belong to
        the sensor and are the same for all seeds.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    LidarScan

    Raises
    ------
    InputError
        An option is out of range, or the car has left the street.
    MissingExtraError
        Open3D is not installed.

    Examples
    --------
    >>> from manip3d import simulate
    >>> scan = simulate.hdl64e(simulate.street(1))
    >>> len(scan.frame.points) > 50_000
    True
    """
    for name, value in (("range_noise", range_noise), ("laser_bias", laser_bias)):
        if not (0.0 <= value < 1.0):
            raise InputError(f"{name}: expected 0 <= metres < 1, got {value}")
    if not (0.0 <= drop_out < 1.0):
        raise InputError(f"drop_out: expected 0 <= share < 1, got {drop_out}")
    if not (2.0 < max_range <= 120.0):
        raise InputError(f"max_range: expected 2 < metres <= 120, got {max_range}")
    random = generator_of(rng)
    encoder, moment = firings(time, random)
    firing, ring = free_beams(encoder)
    start, direction = beams(encoder[firing], ring)

    origin, aim = _in_world(street, moment, firing, start, direction)
    stage = street.stage
    hits = stage.cast(origin, aim, moment[firing].astype(np.float32), threads=threads)
    surface = stage.face_surface[hits.face]
    cosine = abs(np.einsum("ij,ij->i", aim, hits.normal))
    echo = _echo(hits.distance, stage.reflectance[surface], cosine, random)
    returned = np.isfinite(hits.distance) & (echo >= 1.0)
    loss = drop_out * np.minimum(1.0, (hits.distance / FULL_LOSS) ** 2)
    returned &= random.random(len(ring), np.float32) >= loss
    glassy = np.flatnonzero(returned & (stage.transmission[surface] > 0))
    at = origin[glassy] + aim[glassy] * hits.distance[glassy, None]
    returned[glassy] = ~lost(at, stage.transmission[surface[glassy]], random)

    k = np.flatnonzero(returned)
    noise = _LASER_ERROR[ring[k]] * laser_bias + range_noise * random.standard_normal(len(k))
    points = measured_points(start[k], direction[k], hits.distance[k] + noise, ring[k])
    near = np.linalg.norm(points, axis=1) <= max_range
    points, k = points[near].astype(np.float32), k[near]
    order = kitti_order(points, ring[k])
    points, k = points[order], k[order]
    spot = np.float32(DIVERGENCE) * hits.distance[k]
    pattern = stage.shader.brightness(hits.face[k], hits.uv[k], spot)
    reflectance = stage.reflectance[surface[k]] * pattern
    speckle = _speckle(len(stage.surfaces))[surface[k]]
    columns = (
        points,
        reflectances(reflectance, cosine[k], echo[k] * pattern, ring[k], speckle, random),
        ring[k].astype(np.uint8),
        stage.face_label[hits.face[k]],
        hits.object[k],
        firing[k].astype(np.uint16),
    )
    return with_own_car(columns, encoder, moment, laser_bias)


def _in_world(
    street: Street,
    moment: Doubles,
    firing: NDArray[np.int64],
    start: Doubles,
    direction: Doubles,
) -> tuple[Floats, Floats]:
    """Origins and directions of beams in the world's frame; the car moves between firings."""
    position, yaw = street.pose(moment)
    to_world = _turns(yaw)[firing]
    origin = np.einsum("nij,nj->ni", to_world, start.astype(np.float32))
    origin += position[firing].astype(np.float32)
    return origin, np.einsum("nij,nj->ni", to_world, direction.astype(np.float32))


def firings(time: float, random: np.random.Generator) -> tuple[NDArray[np.int16], Doubles]:
    """Encoder values and times of the firings of one sweep.

    The head turns uniformly except for a wobble of about half an encoder step.
    """
    period = TURN_PERIOD + PERIOD_SPREAD * random.standard_normal()
    count = int(np.ceil(period / FIRING_PERIOD)) + SPARE_FIRINGS
    moment = (np.arange(count) - random.random()) * FIRING_PERIOD
    turn = moment / period
    phases = random.uniform(0.0, 2.0 * np.pi, 2)
    once_a_turn, twice_a_turn = WOBBLE
    wobble = once_a_turn * np.sin(2.0 * np.pi * turn + phases[0]) + twice_a_turn * np.sin(
        4.0 * np.pi * turn + phases[1]
    )
    angle = SEAM - ENCODER_STEPS * turn + wobble
    encoder = np.floor(angle).astype(np.int64)
    once = (encoder <= SEAM) & (encoder > SEAM - ENCODER_STEPS)
    return encoder[once].astype(np.int16), time + moment[once] - SEAM / ENCODER_STEPS * period


def beams(encoder: NDArray[np.int16], ring: NDArray[np.int64]) -> tuple[Doubles, Doubles]:
    """Origins and unit directions of the beams in the sensor's frame, at given encoder values."""
    table = lasers()
    azimuth = np.radians(STEP_DEG * encoder + table.azimuth_deg[ring])
    ahead = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    level = 1.0 / np.hypot(1.0, table.slope[ring])  # cosine of the elevation
    rise = table.slope[ring] * level
    # Ranges begin at the foot of the perpendicular from the sensor's origin to the beam.
    perpendicular = table.offset_m[ring] * level
    start = np.empty((len(ring), 3))
    start[:, :2] = -(perpendicular * rise)[:, None] * ahead
    start[:, :2] += table.horizontal_m[ring][:, None] * left
    start[:, 2] = perpendicular * level
    direction = np.column_stack([ahead * level[:, None], rise])
    return start, direction


def _turns(yaw: Doubles) -> Floats:
    """Rotations about z, (N, 3, 3)."""
    cosine, sine, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    rows = [[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, zero + 1.0]]
    return np.array(rows, np.float32).transpose(2, 0, 1)


# Beams that KITTI's own car hides, as found in its clouds: first and last azimuth (degrees,
# positive to the left), first and last ring.
_OWN_CAR = (
    (-13, 9, 57, 58),  # bonnet
    (-15, 17, 59, 60),
    (-17, 22, 61, 63),
    (28, 38, 61, 63),  # racks
    (-40, -28, 61, 63),
    (126, 134, 57, 63),
    (-131, -123, 57, 63),
    (-77, -61, 46, 49),  # a case on the right
    (-81, -58, 50, 57),
    (-77, -60, 58, 60),
    (-73, -63, 61, 62),
    (158, 166, 42, 51),  # roof behind
    (-167, -159, 42, 51),
    (158, 202, 52, 56),
    (154, 206, 57, 59),
    (150, 210, 60, 62),
    (146, 214, 63, 63),
)


# Posts of the rack on its roof, at 1.5 to 1.9 m in each examined frame of KITTI: the second lowest
# laser hits them, always with an intensity near 0. Azimuths of the beam, degrees, among those that
# the car hides, and the ranges there, metres.
_POST_LASER = 62
_POSTS = (
    ((129.0, 129.4, 129.95, 130.7), (1.60, 1.57, 1.80, 1.73)),
    ((-123.7, -123.3, -123.05), (1.87, 1.68, 1.56)),
)


@functools.cache
def _hidden() -> NDArray[np.bool_]:
    """Whether the own car hides each laser at each encoder value, (64, 4000)."""
    ring, encoder = np.mgrid[:64, :ENCODER_STEPS]
    azimuth = STEP_DEG * encoder + lasers().azimuth_deg[:, None]
    hidden = np.zeros(ring.shape, np.bool_)
    for right, left, first, last in _OWN_CAR:
        within = (azimuth - right) % 360.0 < left - right
        hidden |= within & (ring >= first) & (ring <= last)
    return hidden


def free_beams(encoder: NDArray[np.int16]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Firing and ring of all beams that the own car does not hide, firing by firing."""
    free = ~_hidden()[:, encoder.astype(np.int64) % ENCODER_STEPS].T
    firing, ring = np.nonzero(free)
    return firing, ring


def with_own_car(
    columns: tuple[NDArray[Any], ...],
    encoder: NDArray[np.int16],
    moment: Doubles,
    laser_bias: float,
) -> LidarScan:
    """The sweep of the columns (points to firing) with the returns of the own car's posts."""
    azimuth = STEP_DEG * encoder + lasers().azimuth_deg[_POST_LASER]
    azimuth = 180.0 - (180.0 - azimuth) % 360.0
    reach = np.nansum(
        [np.interp(azimuth, at, reach, left=np.nan, right=np.nan) for at, reach in _POSTS], axis=0
    )
    firing = np.flatnonzero(reach)
    ring = np.full(len(firing), _POST_LASER)
    start, direction = beams(encoder[firing], ring)
    distance = reach[firing] + laser_bias * _LASER_ERROR[_POST_LASER]
    posts = measured_points(start, direction, distance, ring)
    own = (posts, 0.0 * reach[firing], ring, np.full_like(ring, Label.CAR), np.full_like(ring, -1))
    with_own: list[NDArray[Any]] = [
        np.concatenate([column, more.astype(column.dtype)])
        for column, more in zip(columns, (*own, firing), strict=True)
    ]
    order = kitti_order(with_own[0], with_own[2])
    points, intensity, of_ring, label, of_object, fired = (column[order] for column in with_own)
    return LidarScan(points, intensity, of_ring, label, of_object, fired, encoder, moment)


def _echo(
    distance: Floats, reflectance: Floats, cosine: Floats, random: np.random.Generator
) -> Floats:
    """Power of echoes relative to the weakest that the sensor detects (1).

    The range equation for a surface wider than the beam is power ~ reflectance cos / r^2. Unity is
    a quarter of the power of 10 % reflectance at the data sheet's 50 m, so that roads are detected
    as far away as in KITTI.
    """
    with np.errstate(invalid="ignore"):
        power = reflectance * cosine / np.maximum(distance, 5.0) ** 2
    speckle = 0.5 + random.random(len(distance), np.float32)
    return np.asarray(power * speckle * np.float32(4.0 * 50.0**2 / 0.1))


@functools.cache
def _speckle(surfaces: int) -> Floats:
    """Factor on the noise of reflectances for each surface, (surfaces,)."""
    random = np.random.default_rng(67)
    return np.exp(random.normal(0.0, SPECKLE, surfaces)).astype(np.float32)


def measured_points(
    start: Doubles, direction: Doubles, distance: Doubles, ring: NDArray[np.int64]
) -> Doubles:
    """Points at distances along beams.

    Ranges are rounded to the sensor's steps of 2 mm from the laser's offset, coordinates to 1 mm.
    """
    offset = lasers().range_offset_mm[ring]
    measured = (2.0 * np.round((1000.0 * distance - offset) / 2.0) + offset) / 1000.0
    return np.round((start + direction * measured[:, None]) * 1000.0) / 1000.0


def reflectances(
    reflectance: Floats,
    cosine: Floats,
    echo: Floats,
    ring: NDArray[np.int64],
    speckle: Floats,
    random: np.random.Generator,
) -> Floats:
    """Reflectances as the sensor states them: in hundredths, 0 for weak echoes."""
    glow = reflectance * np.sqrt(np.sqrt(cosine)) + _LASER_GAIN[ring]
    shot = random.standard_normal(len(glow), np.float32)
    shot *= 1.0 + _HEAVY_TAIL * shot**2
    shot /= np.sqrt(1.0 + 6.0 * _HEAVY_TAIL + 15.0 * _HEAVY_TAIL**2)  # to variance 1
    glow += _LASER_NOISE[ring] * speckle * shot
    glow[echo < WEAK_ECHO] = 0.0
    return (np.clip(np.round(glow * 100.0), 0, 99) / 100.0).astype(np.float32)


def kitti_order(points: Floats, ring: NDArray[np.int64]) -> NDArray[np.int64]:
    """Order of points by ring from the top, and by azimuth in 0 to 360 degrees."""
    azimuth = np.arctan2(*points[:, 1::-1].T.astype(float)) % (2.0 * np.pi)
    return np.lexsort((azimuth, ring))
