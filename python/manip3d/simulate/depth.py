"""Simulated depth images of a person and a room, from a sensor with known faults.

Surfaces of a scene are given by closed formulas, so that its depth is exact. `DepthScene.capture`
simulates a structured-light sensor: noise that grows with the square of the depth, flying pixels
between two surfaces at edges, and missing pixels. It also returns which pixels have these faults.
Lengths are in metres, in the frame of the camera: x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from manip3d import Intrinsics
from manip3d._util.linear import product
from manip3d._util.options import seed_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d._util.options import Rng

__all__ = ["DepthCapture", "DepthScene", "person", "room"]

Array = NDArray[np.float64]

NOISE_AT_ONE_METRE = 1.425e-3
"""Standard deviation of a Kinect's depth at 1 m, in metres; it grows with the square of the depth
[Khoshelham & Elberink, Accuracy and resolution of Kinect depth data, Sensors 2012]."""


@dataclass(frozen=True)
class DepthCapture:
    """Image of the simulated sensor, with its faults.

    Attributes
    ----------
    depth : (H, W) uint16, millimetres
        Measured depth; 0: no measurement.
    flying : (H, W) bool
        Pixels that were measured between two surfaces.
    dropped : (H, W) bool
        Pixels with a surface but without a measurement.
    """

    depth: NDArray[np.uint16]
    flying: NDArray[np.bool_]
    dropped: NDArray[np.bool_]

    __repr__ = short_repr


@dataclass(frozen=True)
class DepthScene:
    """Exact images of a scene, as of an ideal camera.

    Attributes
    ----------
    depth : (H, W) float64
        Exact depth along the optical axis, metres; NaN: no surface of the scene.
    behind : (H, W) float64
        Depth of surroundings that are not part of the scene (a wall that was cut away), metres. At
        the scene's edge, flying pixels lie in front of them. NaN: none.
    color : (H, W, 3) uint8
        Colours.
    slant : (H, W) float64
        Cosine of the angle between the line of sight and the surface's normal.
    intrinsics : Intrinsics
        The camera.
    """

    depth: Array
    behind: Array
    color: NDArray[np.uint8]
    slant: Array
    intrinsics: Intrinsics

    __repr__ = short_repr

    def capture(
        self,
        *,
        noise: float = NOISE_AT_ONE_METRE,
        flying: float = 0.5,
        dropouts: float = 0.002,
        rng: Rng = 0,
    ) -> DepthCapture:
        """Simulate one image of the sensor.

        Parameters
        ----------
        noise : float, metres
            Standard deviation of the depth at 1 m.
        flying : float
            Probability that a pixel at a depth edge lies between the two surfaces.
        dropouts : float
            Probability that a pixel has no measurement; surfaces at grazing angles never have one.
        rng : int, numpy.random.Generator or None
            Seed or generator; None: a different result each time.

        Raises
        ------
        InputError
            ``noise`` is negative, or a probability is outside of [0, 1].
        """
        if not noise >= 0:
            raise InputError(f"noise: expected >= 0, got {noise}")
        for name, value in (("flying", flying), ("dropouts", dropouts)):
            if not 0 <= value <= 1:
                raise InputError(f"{name}: expected a probability, got {value}")
        random = np.random.default_rng(seed_of(rng))
        everything = np.where(np.isfinite(self.depth), self.depth, self.behind)
        near, far = _extreme(self.depth, np.fmin), _extreme(everything, np.fmax)
        is_edge = (far - near > _EDGE * near) & (_bend(everything) * near > _EDGE)
        way = random.uniform(0.15, 0.85, is_edge.shape)
        between = near + way * (far - near)
        floats = is_edge & (random.random(is_edge.shape) < flying)
        floats &= np.isfinite(self.depth) | (between < near + _SEGMENTED)
        measured = np.where(floats, between, self.depth)
        measured = measured + noise * measured**2 * random.standard_normal(measured.shape)
        lost = random.random(measured.shape) < dropouts
        lost |= self.slant < _GRAZING
        seen = np.isfinite(measured) & ~lost
        millimetres = np.rint(np.where(seen, measured, 0.0) * 1000.0).clip(0, 65_535)
        return DepthCapture(
            millimetres.astype(np.uint16), floats & seen, np.isfinite(self.depth) & lost
        )

    def frames(
        self,
        count: int,
        *,
        noise: float = NOISE_AT_ONE_METRE,
        flying: float = 0.5,
        dropouts: float = 0.002,
        rng: Rng = 0,
    ) -> Iterator[DepthCapture]:
        """Yield images of the static scene with different faults; options as for `capture`."""
        random = np.random.default_rng(seed_of(rng))
        for _ in range(count):
            yield self.capture(noise=noise, flying=flying, dropouts=dropouts, rng=random)


_GRAZING = 0.12  # cosine below which the sensor's pattern is not recognised
_EDGE = 0.05  # least step at an edge, as a share of the depth
_SEGMENTED = 0.35  # metres: flying pixels nearer behind the scene count as part of it


def _extreme(depth: Array, choose: Callable[[Array, Array], Array]) -> Array:
    """Largest or smallest depth of the 3x3 pixels around each pixel, ignoring NaN."""
    rows, columns = depth.shape
    padded = np.pad(depth, 1, mode="edge")
    result = depth
    for row in range(3):
        for column in range(3):
            result = choose(result, padded[row : row + rows, column : column + columns])
    return result


def _bend(depth: Array) -> Array:
    """Largest second difference of the inverse depth along rows and columns; it is 0 on a plane."""
    inverse = np.pad(1.0 / depth, 1, mode="edge")
    middle = 2.0 * inverse[1:-1, 1:-1]
    along_rows = np.abs(inverse[1:-1, :-2] + inverse[1:-1, 2:] - middle)
    along_columns = np.abs(inverse[:-2, 1:-1] + inverse[2:, 1:-1] - middle)
    bend: Array = np.fmax(along_rows, along_columns)
    return bend


# --- Ray casting ------------------------------------------------------------------------------
# `cast` of a surface returns, for rays from the origin, the depth of the first hit (inf: none) and
# the normal there. All rays have z = 1, so that the depth is the ray's parameter.


@dataclass(frozen=True)
class _Ellipsoid:
    center: tuple[float, float, float]
    radii: tuple[float, float, float]
    color: tuple[int, int, int]

    def cast(self, rays: Array) -> tuple[Array, Array]:
        scaled = rays / self.radii
        center = np.array(self.center) / self.radii
        depth = _first_root(
            (scaled**2).sum(-1),
            -2.0 * product(scaled, center),
            float(product(center, center)) - 1.0,
        )
        normal = (_at(rays, depth) - self.center) / np.square(self.radii)
        return depth, normal


@dataclass(frozen=True)
class _Capsule:
    """A cylinder from ``start`` to ``end`` with round ends."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float
    color: tuple[int, int, int]

    def cast(self, rays: Array) -> tuple[Array, Array]:
        start, axis = np.array(self.start), np.subtract(self.end, self.start)
        length2 = float(product(axis, axis))
        along = product(rays, axis)
        offset = float(product(start, axis))
        depth = _first_root(
            (rays**2).sum(-1) - along**2 / length2,
            -2.0 * (product(rays, start) - along * offset / length2),
            float(product(start, start)) - offset**2 / length2 - self.radius**2,
        )
        where = (depth * along - offset) / length2
        depth = np.where((where >= 0.0) & (where <= 1.0), depth, np.inf)
        for end in (self.start, self.end):
            depth = np.minimum(depth, _sphere(rays, np.array(end), self.radius))
        point = _at(rays, depth)
        where = np.clip(product(point - start, axis) / length2, 0.0, 1.0)
        return depth, point - (start + where[..., None] * axis)


@dataclass(frozen=True)
class _Box:
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    color: tuple[int, int, int]

    def cast(self, rays: Array) -> tuple[Array, Array]:
        with np.errstate(divide="ignore"):
            first, second = np.array(self.low) / rays, np.array(self.high) / rays
        enter, leave = np.minimum(first, second), np.maximum(first, second)
        depth, end = enter.max(-1), leave.min(-1)
        normal = np.eye(3)[enter.argmax(-1)] * -np.sign(rays)
        inside = depth <= 0.0  # the camera is inside the box: the walls of a room
        normal = np.where(inside[..., None], np.eye(3)[leave.argmin(-1)] * -np.sign(rays), normal)
        depth = np.where(inside, end, depth)
        return np.where((depth <= end) & (end > 0.0), depth, np.inf), normal


def _sphere(rays: Array, center: Array, radius: float) -> Array:
    return _first_root(
        (rays**2).sum(-1), -2.0 * product(rays, center), float(product(center, center)) - radius**2
    )


def _first_root(a: Array, b: Array, c: Array | float) -> Array:
    """The smaller root of a x^2 + b x + c if it is real and positive; else inf."""
    inside = b**2 - 4.0 * a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        root = (-b - np.sqrt(inside)) / (2.0 * a)
    return np.where((inside >= 0.0) & (root > 0.0), root, np.inf)


def _at(rays: Array, depth: Array) -> Array:
    return rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]


_Surface = _Ellipsoid | _Capsule | _Box


def _cast(
    surfaces: Sequence[_Surface], camera: Intrinsics, relief: Callable[[Array], Array] | None
) -> tuple[Array, NDArray[np.uint8], Array]:
    """Depth, colour and slant of the nearest surface of each pixel.

    ``relief`` of the hit points, such as folds of cloth of a few millimetres, is added to the
    depth.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = camera.unproject(1.0, pixels=np.stack([u, v], 2))
    depth = np.full(u.shape, np.inf)
    color = np.zeros((*u.shape, 3))
    slant = np.ones(u.shape)
    for surface in surfaces:
        hit, normal = surface.cast(rays)
        nearer = hit < depth
        depth = np.where(nearer, hit, depth)
        norms = np.linalg.norm(normal, axis=-1) * np.linalg.norm(rays, axis=-1)
        cosine = np.abs((normal * rays).sum(-1)) / np.where(norms > 0.0, norms, 1.0)
        slant = np.where(nearer, cosine, slant)
        color[nearer] = surface.color
    point = _at(rays, depth)
    if relief is not None:
        depth = depth + np.where(np.isfinite(depth), relief(point), 0.0)
    shade = _pattern(point) * (0.35 + 0.65 * slant)
    painted = np.where(np.isfinite(depth)[..., None], color * shade[..., None], 0.0)
    return np.where(np.isfinite(depth), depth, np.nan), painted.astype(np.uint8), slant


def _pattern(point: Array) -> Array:
    """Stripes and checks with values from 0.6 to 1, which make a displaced texture visible."""
    checks = np.sin(40.0 * point[..., 0]) * np.sin(40.0 * point[..., 1])
    shade: Array = np.where(checks > 0.0, 1.0, 0.75) - 0.15 * (np.sin(9.0 * point[..., 1]) > 0.0)
    return shade


def _folds(point: Array) -> Array:
    """Displacement by folds of cloth, up to 6 mm, or by the texture of skin, a tenth of that."""
    x, y = point[..., 0], point[..., 1]
    cloth = 0.004 * np.sin(35.0 * x + 6.0 * np.sin(9.0 * y)) + 0.002 * np.sin(70.0 * y + 20.0 * x)
    return np.where(y > -0.52, cloth, 0.1 * cloth)


def _camera(width: int, height: int) -> Intrinsics:
    """The nominal depth camera of a Kinect, scaled to the image."""
    if not (width >= 16 and height >= 16):
        raise InputError(f"width, height: expected at least 16, got {width}, {height}")
    focal = 525.0 * width / 640.0
    return Intrinsics(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)


_SKIN, _SHIRT, _TROUSERS, _HAIR = (224, 172, 138), (70, 110, 170), (60, 60, 72), (70, 48, 36)


def person(*, width: int = 640, height: int = 480, wall: bool = False) -> DepthScene:
    """Make a scene of a person who stands 2.1 m before the camera with the arms slightly apart.

    Parameters
    ----------
    width, height : int
        Size of the image in pixels; the field of view is that of a Kinect.
    wall : bool
        Include the wall and the floor behind the person.

    Returns
    -------
    DepthScene

    Raises
    ------
    InputError
        The image has fewer than 16 x 16 pixels.
    """
    camera = _camera(width, height)
    body: list[_Surface] = [
        _Ellipsoid((0.0, -0.66, 2.1), (0.085, 0.115, 0.10), _SKIN),
        _Ellipsoid((0.0, -0.71, 2.125), (0.093, 0.09, 0.10), _HAIR),
        _Ellipsoid((0.0, -0.645, 2.0), (0.014, 0.025, 0.022), _SKIN),  # nose
        _Ellipsoid((0.0, -0.60, 2.012), (0.03, 0.008, 0.012), (190, 110, 100)),  # mouth
        _Capsule((0.0, -0.56, 2.12), (0.0, -0.48, 2.12), 0.05, _SKIN),
        _Ellipsoid((0.0, -0.25, 2.1), (0.20, 0.27, 0.13), _SHIRT),
        _Capsule((-0.16, -0.43, 2.11), (0.16, -0.43, 2.11), 0.065, _SHIRT),
        _Ellipsoid((0.0, 0.0, 2.1), (0.17, 0.16, 0.13), _TROUSERS),
    ]
    for side in (-1.0, 1.0):
        body += [
            _Capsule((side * 0.21, -0.43, 2.11), (side * 0.31, -0.16, 2.08), 0.052, _SHIRT),
            _Capsule((side * 0.31, -0.16, 2.08), (side * 0.38, 0.08, 1.98), 0.042, _SKIN),
            _Ellipsoid((side * 0.395, 0.15, 1.95), (0.035, 0.065, 0.025), _SKIN),
            _Capsule((side * 0.09, 0.06, 2.1), (side * 0.12, 0.45, 2.09), 0.085, _TROUSERS),
            _Capsule((side * 0.12, 0.45, 2.09), (side * 0.13, 0.84, 2.13), 0.062, _TROUSERS),
            _Ellipsoid((side * 0.135, 0.9, 2.07), (0.05, 0.04, 0.13), _HAIR),
        ]
    surroundings: list[_Surface] = [_Box((-3.0, -2.0, -1.0), (3.0, 0.95, 3.3), (200, 196, 186))]
    if wall:
        depth, color, slant = _cast([*body, *surroundings], camera, _folds_of_person)
        return DepthScene(depth, np.full(depth.shape, np.nan), color, slant, camera)
    depth, color, slant = _cast(body, camera, _folds)
    behind = _cast(surroundings, camera, None)[0]
    return DepthScene(depth, behind, color, slant, camera)


def _folds_of_person(point: Array) -> Array:
    is_body = (point[..., 2] < 2.6) & (point[..., 1] < 0.9)
    return np.where(is_body, _folds(point), 0.0)


def room(*, width: int = 640, height: int = 480) -> DepthScene:
    """Make a scene of a desk in a room, seen from 1.3 m: flat, round and thin surfaces.

    Parameters
    ----------
    width, height : int
        Size of the image in pixels; the field of view is that of a Kinect.

    Raises
    ------
    InputError
        The image has fewer than 16 x 16 pixels.
    """
    wood, paper, metal = (150, 105, 66), (228, 224, 210), (96, 104, 112)
    things: list[_Surface] = [
        _Box((-2.0, -1.3, -1.0), (2.1, 1.2, 3.4), (196, 190, 178)),
        _Box((-0.9, 0.45, 1.3), (0.8, 0.5, 2.3), wood),
        _Box((-0.86, 0.5, 1.34), (-0.8, 1.2, 1.4), wood),
        _Box((0.7, 0.5, 1.34), (0.76, 1.2, 1.4), wood),
        _Box((-0.45, -0.05, 2.0), (0.15, 0.36, 2.05), metal),  # screen
        _Box((-0.18, 0.3, 2.0), (-0.12, 0.45, 2.05), metal),
        _Box((0.25, 0.38, 1.5), (0.5, 0.45, 1.7), paper),  # books
        _Box((0.28, 0.33, 1.55), (0.48, 0.38, 1.72), (160, 70, 60)),
        _Ellipsoid((-0.6, 0.33, 1.7), (0.12, 0.12, 0.12), (190, 150, 40)),
        _Capsule((0.62, 0.45, 1.8), (0.62, 0.1, 1.9), 0.012, metal),  # lamp
        _Capsule((0.62, 0.1, 1.9), (0.45, -0.05, 1.7), 0.012, metal),
        _Ellipsoid((0.43, -0.03, 1.68), (0.08, 0.05, 0.08), (210, 60, 50)),
        _Box((-1.9, 0.1, 2.9), (-1.2, 1.2, 3.39), wood),  # cabinet
        _Ellipsoid((1.3, 0.7, 2.5), (0.4, 0.3, 0.4), (90, 130, 90)),
    ]
    camera = _camera(width, height)
    depth, color, slant = _cast(things, camera, None)
    return DepthScene(depth, np.full(depth.shape, np.nan), color, slant, camera)
