"""A calibrated colour stereo pair on the car, with the geometry of KITTI's cameras 2 and 3."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import generator_of
from manip3d._util.reprs import short_repr
from manip3d.authenticate import StereoRig
from manip3d.errors import InputError
from manip3d.simulate._stage import Mover, Stage
from manip3d.simulate._world import about_z
from manip3d.simulate.streets import Street

if TYPE_CHECKING:
    from manip3d._util.options import Rng

__all__ = [
    "BASELINE",
    "FOCAL",
    "HEIGHT",
    "SURROUND",
    "WIDTH",
    "StereoPair",
    "projections",
    "stereo_pair",
    "surround_rigs",
]

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

WIDTH, HEIGHT = 1242, 375
FOCAL = 721.5377
"""Pixels (KITTI, 2011_09_26)."""
CENTER = (609.5593, 172.854)
"""Principal point: column, row."""
BASELINE = 0.5327
"""Metres between cameras 2 and 3."""
LEFT_OFFSET = 0.0622
"""Distance of camera 2 to the left of camera 0, metres."""
CAMERA_0 = (0.27, 0.0, -0.08)
"""Position of camera 0 in the LiDAR's frame, metres; all cameras look along the frame's x."""

SURROUND: Mapping[str, float] = ReadOnlyMapping(
    {"front": 0.0, "left": 72.0, "rear-left": 144.0, "rear-right": -144.0, "right": -72.0}
)
"""Headings of five pairs that together cover the full turn, degrees counter-clockwise from ahead.

No pair looks straight back, where a sweep of the LiDAR begins and ends: half of its view would be
scanned 0.1 s after the other half.
"""

_BAND = 24  # rows per block of shading, so that arrays fit the cache
_NOISE = 1.5  # standard deviation, grey levels


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Two rectified pictures with the ground truth of the left one.

    Attributes
    ----------
    left, right : (375, 1242, 3) uint8
        RGB pictures.
    depth : (375, 1242) float32, metres
        Depth along the left camera's axis; 0: sky.
    object : (375, 1242) int32
        Number of the object in the left picture; -1: background.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    depth: Floats
    object: NDArray[np.int32]

    __repr__ = short_repr

    @property
    def disparity(self) -> Floats:
        """True disparity, left column minus right column, (375, 1242), pixels; 0: sky."""
        with np.errstate(divide="ignore"):
            return np.where(self.depth > 0, np.float32(FOCAL * BASELINE) / self.depth, 0.0).astype(
                np.float32
            )


def projections() -> tuple[dict[int, Doubles], Doubles]:
    """Return (3, 4) projections of cameras 0 to 3, and the (4, 4) transform from LiDAR to camera 0.

    Cameras 0 and 1 (grey) are only included for complete calibration files; they have no pictures.
    """
    intrinsic = np.array([[FOCAL, 0.0, CENTER[0]], [0.0, FOCAL, CENTER[1]], [0.0, 0.0, 1.0]])
    to_camera = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    matrices = {}
    for camera, shift in enumerate((0.0, -BASELINE, LEFT_OFFSET, LEFT_OFFSET - BASELINE)):
        matrices[camera] = intrinsic @ np.column_stack([np.eye(3), [shift, 0.0, 0.0]])
    rigid = np.eye(4)
    rigid[:3, :3] = to_camera
    rigid[:3, 3] = -to_camera @ np.asarray(CAMERA_0)
    return matrices, rigid


def surround_rigs() -> dict[str, StereoRig]:
    """Return the rigs of `SURROUND`: the front pair, rotated about the LiDAR's vertical."""
    x, y, z = CAMERA_0
    ahead = np.array(
        [
            [0.0, 0.0, 1.0, x],
            [-1.0, 0.0, 0.0, y + LEFT_OFFSET],
            [0.0, -1.0, 0.0, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return {
        name: StereoRig(FOCAL, CENTER, BASELINE, product(_turn(math.radians(heading)), ahead))
        for name, heading in SURROUND.items()
    }


def _turn(angle: float) -> Doubles:
    """Rotation about the vertical by an angle in radians, (4, 4)."""
    turn = np.eye(4)
    turn[:3, :3] = about_z(angle)
    return turn


@checked
def stereo_pair(
    street: Street,
    time: float = 0.0,
    *,
    heading: float = 0.0,
    rng: Rng = 0,
    threads: int = 0,
) -> StereoPair:
    """Render the pictures of the car's cameras at a time, with one ray per pixel.

    Parameters
    ----------
    street : Street
        Street with the car.
    time : float, seconds
        Time at which the LiDAR looks in the direction of the pair.
    heading : float, degrees
        Rotation of the pair about the LiDAR's vertical, counter-clockwise from ahead.
    rng : int, numpy.random.Generator or None
        Seed or generator of the noise of the pictures.
    threads : int
        Threads of the ray casting; 0: ``MANIP3D_THREADS``, else all cores. The result does not
        depend on it.

    Returns
    -------
    StereoPair

    Raises
    ------
    InputError
        The car has left the street, or the heading is not finite.
    MissingExtraError
        Open3D is not installed.
    """
    random = generator_of(rng)
    position, yaw = street.pose([time])
    if not math.isfinite(heading):
        raise InputError(f"heading: expected a finite number, got {heading}")
    turn = about_z(yaw[0] + math.radians(heading))
    rays, _ = _rays()
    aim = product(rays, turn.T.astype(np.float32))
    noise = [random.integers(0, 128, 3) for _ in range(2)]
    stage = street.stage
    eyes = [
        position[0] + product(turn, np.add(CAMERA_0, (0.0, side, 0.0)))
        for side in (LEFT_OFFSET, LEFT_OFFSET - BASELINE)
    ]

    def draw(eye: int) -> tuple[NDArray[np.uint8], Floats, NDArray[np.int32]]:
        return _picture(stage, eyes[eye], turn, aim, float(time), noise[eye], threads)

    stage.shader  # noqa: B018  built before two threads use it
    with ThreadPoolExecutor(2) as pool:
        (left, depth, number), (right, _, _) = pool.map(draw, (0, 1))
    return StereoPair(left, right, depth, number)


@functools.cache
def _rays() -> tuple[Floats, Floats]:
    """Unit directions of the pixels, (N, 3), in the LiDAR's axes, and depth per metre of range."""
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    right, down = (column - CENTER[0]) / FOCAL, (row - CENTER[1]) / FOCAL
    direction = np.stack([np.ones_like(right), -right, -down], axis=-1).reshape(-1, 3)
    depth = 1.0 / np.linalg.norm(direction, axis=1)
    return (direction * depth[:, None]).astype(np.float32), depth.astype(np.float32)


def _picture(
    stage: Stage,
    eye: Doubles,
    turn: Doubles,
    aim: Floats,
    time: float,
    noise: NDArray[np.int64],
    threads: int,
) -> tuple[NDArray[np.uint8], Floats, NDArray[np.int32]]:
    """Picture, depth and object numbers of one camera."""
    subsets = [_pixels_of(mover, eye, turn, time) for mover in stage.movers]
    hits = stage.cast(eye.astype(np.float32), aim, time, subsets=subsets, threads=threads)
    picture = np.empty((HEIGHT * WIDTH, 3), np.uint8)
    _, per_metre = _rays()
    grain = _grain()
    for start in range(0, HEIGHT * WIDTH, _BAND * WIDTH):
        band = slice(start, min(start + _BAND * WIDTH, HEIGHT * WIDTH))
        color = _sky(aim[band, 2])
        seen = np.flatnonzero(np.isfinite(hits.distance[band]))
        rays, distance = aim[band][seen], hits.distance[band][seen]
        normal = hits.normal[band][seen]
        facing = np.einsum("ij,ij->i", rays, normal)
        light = _light(normal, facing)
        footprint = distance / np.float32(FOCAL) / np.sqrt(np.maximum(abs(facing), 0.02))
        color[seen] = stage.shader.colors(
            hits.face[band][seen], hits.uv[band][seen], footprint, light
        )
        rows = np.arange(start // WIDTH, band.stop // WIDTH) + noise[0]
        color += grain[rows[:, None] % 512, (np.arange(WIDTH) + noise[1]) % 2048].reshape(-1, 3)
        picture[band] = np.clip(color, 0.0, 255.0)
    depth = np.where(np.isfinite(hits.distance), hits.distance * per_metre, np.float32(0.0))
    return (
        picture.reshape(HEIGHT, WIDTH, 3),
        depth.reshape(HEIGHT, WIDTH),
        hits.object.reshape(HEIGHT, WIDTH),
    )


_SUN = np.array([0.35, -0.5, 0.79], np.float32)  # unit length


def _light(normal: Floats, facing: Floats) -> Floats:
    """Lambert's law with sun and sky; surfaces are lit on their visible side."""
    side = np.where(facing > 0, -1.0, 1.0).astype(np.float32)
    lit = np.maximum(product(normal, _SUN) * side, 0.0)
    up = normal[:, 2] * side
    return np.asarray(0.45 + 0.15 * up + 0.75 * lit)


def _sky(up: Floats) -> Floats:
    """Colours of the sky, (N, 3): pale at the horizon, blue above."""
    t = np.sqrt(np.clip(up * np.float32(3.0), 0.0, 1.0))[:, None]
    low, high = np.array([222, 226, 230], np.float32), np.array([128, 168, 222], np.float32)
    return np.asarray(low + t * (high - low))


@functools.cache
def _grain() -> Floats:
    """A tile of the sensor's noise; each picture uses another part of it."""
    random = np.random.default_rng(0)
    return np.float32(_NOISE) * random.standard_normal((512, 2048, 3), np.float32)


def _pixels_of(mover: Mover, eye: Doubles, turn: Doubles, time: float) -> NDArray[np.int64]:
    """Pixels of the rectangle around a mover's box; all pixels if it is beside the camera."""
    low, high = mover.model.vertices.min(axis=0), mover.model.vertices.max(axis=0)
    corner = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    at = product(corner, about_z(mover.yaw).T) + mover.start + mover.velocity * time
    ahead, left, up = product(at - eye, turn).T
    if ahead.max() < 0.2:
        return np.empty(0, np.int64)
    if ahead.min() < 0.2:
        return np.arange(HEIGHT * WIDTH)
    column, row = CENTER[0] - FOCAL * left / ahead, CENTER[1] - FOCAL * up / ahead
    c0, c1 = np.clip([np.floor(column.min()), np.ceil(column.max()) + 1], 0, WIDTH).astype(int)
    r0, r1 = np.clip([np.floor(row.min()), np.ceil(row.max()) + 1], 0, HEIGHT).astype(int)
    return (np.arange(r0, r1)[:, None] * WIDTH + np.arange(c0, c1)).ravel()
