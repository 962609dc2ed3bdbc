"""Static scenery around a person: floor, walls, furniture; views of each camera are cached."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from manip3d._util.linear import product
from manip3d.camera import Intrinsics
from manip3d.simulate._figure import SITTING_HEIGHT, about
from manip3d.simulate._raycast import CHUNK, RayCaster

Floats = NDArray[np.float32]
Point = tuple[float, float, float]

_WOOD, _METAL = (150, 112, 74), (92, 96, 102)
_FLOOR_FACES = 12  # the first box of a room
_WALL, _FLOOR = (206, 202, 192), (152, 146, 138)


@dataclass(frozen=True)
class Box:
    """An upright box between two corners, and its colour."""

    low: Point
    high: Point
    color: tuple[int, int, int]


def box_mesh(box: Box) -> tuple[Floats, NDArray[np.int32]]:
    """Vertices (8, 3) and faces (12, 3)."""
    corner = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], bool)
    vertices = np.where(corner, box.high, box.low).astype(np.float32)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return vertices, np.array(faces, np.int32)


@dataclass(frozen=True)
class Wheel:
    """An upright wheel about an axle along x, and its colour."""

    centre: Point
    radius: float
    color: tuple[int, int, int]


def wheel_mesh(wheel: Wheel) -> tuple[Floats, NDArray[np.int32]]:
    """Vertices and faces of a rim with a cross section of 25 x 25 mm and of eight spokes."""
    segments, half = 48, 0.0125
    angle = np.arange(segments) * 2.0 * np.pi / segments
    circle = np.stack([np.zeros(segments), np.cos(angle), np.sin(angle)], axis=1)
    rings = [
        wheel.centre + radius * circle + (aside, 0.0, 0.0)
        for radius, aside in (
            (wheel.radius, -half),
            (wheel.radius, half),
            (wheel.radius - 2.0 * half, half),
            (wheel.radius - 2.0 * half, -half),
        )
    ]
    a = np.arange(segments)
    b = (a + 1) % segments
    vertices, faces = [np.concatenate(rings)], []
    for ring in range(4):
        here, there = segments * ring, segments * ((ring + 1) % 4)
        faces += [np.stack([here + a, here + b, there + b], 1)]
        faces += [np.stack([here + a, there + b, there + a], 1)]
    for spoke in range(8):
        way = circle[spoke * segments // 8]
        aside = 0.004 * np.cross(way, (1.0, 0.0, 0.0))
        first = sum(map(len, vertices))
        ends = [wheel.centre, wheel.centre + wheel.radius * way]
        vertices.append(np.array([end + sign * aside for end in ends for sign in (-1, 1)]))
        faces.append(first + np.array([[0, 1, 3], [0, 3, 2]]))
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32)


@dataclass(frozen=True, eq=False)
class Background:
    """Exact images of the scenery from a camera with (H, W) pixels.

    Attributes
    ----------
    depth : (H, W) float32, metres
        Depth; 0: no surface.
    slant : (H, W) float32
        Cosine of the angle between the line of sight and the normal.
    color : (H, W, 3) uint8
        Colours.
    rays : (H, W, 3) float32
        Rays of the pixels, scaled to a depth of 1 m.
    """

    depth: Floats
    slant: Floats
    color: NDArray[np.uint8]
    rays: Floats


@dataclass(frozen=True, eq=False)
class Scenery:
    """Static objects.

    Attributes
    ----------
    vertices : (V, 3) float32, metres
        Vertices in the frame of the depth camera.
    faces : (F, 3) int32
        Indices of the vertices of each face.
    face_color : (F, 3) float32
        Colour of each face.
    """

    vertices: Floats
    faces: NDArray[np.int32]
    face_color: Floats
    _views: dict[tuple[int, int, bytes], Background] = field(default_factory=dict, repr=False)

    def seen_by(self, camera: Intrinsics, eye: Floats) -> Background:
        """Return the view of a camera at ``eye`` that looks ahead."""
        key = (camera.width, camera.height, eye.tobytes())
        if key not in self._views:
            self._views[key] = self._look(camera, eye)
        return self._views[key]

    def _look(self, camera: Intrinsics, eye: Floats) -> Background:
        shape = camera.height, camera.width
        rays = camera.unproject(np.ones(shape, np.float32))
        depth, slant = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        color = np.zeros((*shape, 3), np.uint8)
        if not len(self.faces):
            return Background(depth, slant, color, rays)
        caster = RayCaster(self.vertices, self.faces)
        flat = rays.reshape(-1, 3)
        for start in range(0, len(flat), CHUNK):
            part = flat[start : start + CHUNK]
            hits = caster.cast(eye, part)
            hit = np.flatnonzero(np.isfinite(hits.distance))
            way = part[hit]
            cosine = np.abs((hits.normal[hit] * way).sum(1)) / np.linalg.norm(way, axis=1)
            points = eye + way * hits.distance[hit, None]
            is_floor = hits.face[hit] < _FLOOR_FACES
            shade = _pattern(points, is_floor) * (0.7 + 0.3 * cosine)
            to = start + hit
            depth.reshape(-1)[to], slant.reshape(-1)[to] = hits.distance[hit], cosine
            painted = self.face_color[hits.face[hit]] * shade[:, None]
            color.reshape(-1, 3)[to] = painted.astype(np.uint8)
        return Background(depth, slant, color, rays)


SCENES = ("room", "office", "hall")
"""Kinds of scenery around a person."""

_BEHIND = {"room": 1.4, "office": 1.4, "hall": 2.6}  # metres from the person to the wall
_WALLS = {"room": _WALL, "office": (176, 190, 196), "hall": (214, 198, 168)}
_FLOORS = {"room": _FLOOR, "office": (104, 112, 124), "hall": (168, 150, 122)}


CHAIRS = ("chair", "wheelchair")
"""Kinds of seats."""


def furnish(
    scene: str,
    seat: float | None,
    turn: float,
    distance: float,
    camera_height: float,
    chair: str = "chair",
) -> Scenery:
    """Make the scenery around a person, with a chair if the person sits.

    Parameters
    ----------
    scene : str
        Name in `SCENES`; empty: no scenery at all.
    seat : float, optional
        Distance of the chair from the camera, metres; None: no chair.
    turn : float, degrees
        Rotation of the chair.
    distance : float, metres
        Distance of the person from the camera; the wall is 1.4 m behind, in a hall 2.6 m.
    camera_height : float, metres
        Height of the camera above the floor.
    chair : str
        Name in `CHAIRS`.
    """
    vertices: list[Floats] = []
    faces: list[NDArray[np.int32]] = []
    colors: list[Floats] = []

    def add(thing: Box | Wheel, place: NDArray[np.float64] | None = None) -> None:
        corners, sides = wheel_mesh(thing) if isinstance(thing, Wheel) else box_mesh(thing)
        if place is not None:
            corners = (product(corners, about("y", -turn).T) + place).astype(np.float32)
        faces.append(sides + sum(map(len, vertices)))
        vertices.append(corners)
        colors.append(np.repeat(np.array([thing.color], np.float32), len(sides), axis=0))

    if not scene:
        nothing = np.zeros((0, 3), np.float32)
        return Scenery(nothing, nothing.astype(np.int32), nothing)
    floor, wall = camera_height, distance + _BEHIND[scene]
    add(Box((-2.6, floor, -1.0), (2.6, floor + 0.1, wall), _FLOORS[scene]))
    add(Box((-2.6, -1.7, wall), (2.6, floor, wall + 0.1), _WALLS[scene]))
    for x in (-2.7, 2.6):
        add(Box((x, -1.7, -1.0), (x + 0.1, floor, wall), (186, 184, 178)))
    for box in {"room": [], "office": _office(floor, wall), "hall": _hall(floor, wall)}[scene]:
        add(box)
    if seat is not None:
        for thing in _wheelchair() if chair == "wheelchair" else _chair():
            add(thing, np.array([0.0, floor, seat]))
    return Scenery(np.concatenate(vertices), np.concatenate(faces), np.concatenate(colors))


def _office(floor: float, wall: float) -> list[Box]:
    """A desk with a screen on the left of the picture, a cupboard on the right, and a board."""
    desk = floor - 0.74
    back = wall - 0.15
    legs = [
        Box((x, desk, z), (x + 0.05, floor, z + 0.05), _METAL)
        for x in (-2.2, -0.95)
        for z in (back - 0.65, back - 0.05)
    ]
    return [
        Box((-2.2, desk - 0.03, back - 0.65), (-0.9, desk, back), _WOOD),
        *legs,
        Box((-1.8, desk - 0.43, back - 0.3), (-1.25, desk - 0.08, back - 0.26), (40, 44, 52)),
        Box((-1.58, desk - 0.08, back - 0.3), (-1.47, desk - 0.03, back - 0.2), _METAL),
        Box((1.0, floor - 1.9, wall - 0.45), (1.9, floor, wall), (132, 98, 62)),
        Box((-0.7, -0.75, wall - 0.03), (0.75, 0.1, wall), (226, 228, 224)),
    ]


def _hall(floor: float, wall: float) -> list[Box]:
    """Two pillars, a bench and a door."""
    pillars = [
        Box((x, -1.7, wall - 1.5), (x + 0.35, floor, wall - 1.15), (196, 186, 170))
        for x in (-1.75, 1.4)
    ]
    return [
        *pillars,
        Box((-1.1, floor - 0.45, wall - 0.5), (-0.2, floor - 0.37, wall - 0.1), _WOOD),
        *(
            Box((x, floor - 0.37, wall - 0.45), (x + 0.06, floor, wall - 0.15), _METAL)
            for x in (-1.0, -0.36)
        ),
        Box((0.35, floor - 2.05, wall - 0.05), (1.25, floor, wall), (92, 66, 48)),
    ]


def _chair() -> list[Box]:
    """A chair in its own frame: origin on the floor, y down, the sitter looks along -z."""
    top = -(SITTING_HEIGHT - 0.11)
    legs = [
        Box((x, top, z), (x + 0.03, 0.0, z + 0.03), _METAL)
        for x in (-0.21, 0.18)
        for z in (-0.17, 0.17)
    ]
    seat = Box((-0.22, top, -0.18), (0.22, top + 0.035, 0.22), _WOOD)
    back = Box((-0.20, top - 0.42, 0.20), (0.20, top - 0.10, 0.23), _WOOD)
    return [*legs, seat, back]


def _wheelchair() -> list[Box | Wheel]:
    """A wheelchair in the frame of `_chair`: seat, back, armrests, footrests and four wheels."""
    top = -(SITTING_HEIGHT - 0.11)
    cloth, rubber = (44, 46, 58), (38, 38, 40)
    things: list[Box | Wheel] = [
        Box((-0.22, top, -0.18), (0.22, top + 0.03, 0.22), cloth),
        Box((-0.21, top - 0.45, 0.20), (0.21, top - 0.02, 0.22), cloth),
    ]
    for side in (-1.0, 1.0):
        inner, outer = sorted((side * 0.245, side * 0.275))
        things += [
            Box((inner, top - 0.22, -0.12), (outer, top - 0.19, 0.20), cloth),  # armrest
            Box((inner, top - 0.19, -0.12), (outer, top + 0.03, -0.10), _METAL),
            Box((inner, top - 0.50, 0.20), (outer, -0.20, 0.23), _METAL),  # frame of the back
            Box((inner, top - 0.50, 0.23), (outer, top - 0.47, 0.33), rubber),  # handle
            Box((inner, top, -0.22), (outer, top + 0.03, 0.23), _METAL),
            Box((inner, top + 0.03, -0.22), (outer, -0.19, -0.19), _METAL),
            Wheel((side * 0.315, -0.30, 0.12), 0.30, rubber),
            Wheel((side * 0.26, -0.095, -0.20), 0.095, rubber),
        ]
    for side in (-1.0, 1.0):
        inner, outer = sorted((side * 0.04, side * 0.20))
        things.append(Box((inner, -0.03, -0.56), (outer, -0.01, -0.38), _METAL))  # footrest
        tube = sorted((side * 0.205, side * 0.225))
        things.append(Box((tube[0], top + 0.03, -0.40), (tube[1], -0.01, -0.38), _METAL))
        things.append(Box((tube[0], top, -0.40), (tube[1], top + 0.03, -0.18), _METAL))
    return things


def _pattern(points: Floats, is_floor: NDArray[np.bool_]) -> Floats:
    """Brightness of floors with tiles, and of walls with faint bands."""
    tiles = (np.floor(points[:, 0] / 0.4) + np.floor(points[:, 2] / 0.4)) % 2.0
    bands = 0.97 + 0.03 * np.sin(6.0 * points[:, 0]) * np.sin(4.0 * points[:, 1])
    return np.asarray(np.where(is_floor, 0.88 + 0.12 * tiles, bands), np.float32)
