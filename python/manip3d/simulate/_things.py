"""Procedural objects of streets and rooms; x forward, y left, z up, standing on z = 0, metres.

Texture coordinates are metres along the surface, so that one texture fits objects of any size.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.linear import product
from manip3d.simulate import _surfaces
from manip3d.simulate import _textures as textures
from manip3d.simulate._surfaces import Patch, Points, revolved, sheet, waves
from manip3d.simulate._world import Parts, Surface, placed, turned

Random = np.random.Generator

CONCRETE = Surface((0.55, 0.54, 0.52), 0.35)
PLASTER = Surface((0.85, 0.83, 0.78), 0.6)
WOOD = Surface((0.50, 0.33, 0.18), 0.45)
METAL = Surface((0.45, 0.46, 0.48), 0.3)
DARK = Surface((0.06, 0.06, 0.07), 0.06)
CLOTH = Surface((0.30, 0.33, 0.45), 0.4)
GLASS = Surface((0.25, 0.32, 0.38), 0.05, transmission=0.93)
CAR_GLASS = Surface((0.12, 0.15, 0.18), 0.06, transmission=0.45)
LEAF = Surface((0.22, 0.36, 0.12), 0.5)
BARK = Surface((0.30, 0.23, 0.16), 0.3)
SKIN = Surface((0.75, 0.57, 0.45), 0.5)
RUBBER = Surface((0.05, 0.05, 0.05), 0.05)
LAMP = Surface((0.9, 0.88, 0.8), 0.6)
TAIL_LAMP = Surface((0.55, 0.03, 0.03), 0.7)


# --- Solids -------------------------------------------------------------------------------------
def quad(corners: ArrayLike) -> Patch:
    """A flat quad; corners counter-clockwise seen from the front; UV in metres along its sides."""
    points = np.asarray(corners, float)
    width = float(np.linalg.norm(points[1] - points[0], axis=-1))
    height = float(np.linalg.norm(points[3] - points[0], axis=-1))
    grid = points[[0, 1, 3, 2]].reshape(2, 2, 3)
    return sheet(grid, uv_box=(0.0, 0.0, width, height))


# Corners of the six sides, counter-clockwise seen from outside; 0: low end of an axis, 1: high.
_SIDES = np.array(
    [
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)],
        [(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)],
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
        [(0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0)],
    ]
)


def block(low: ArrayLike, high: ArrayLike, surface: Surface) -> Parts:
    """A box between two corners."""
    corners = np.where(_SIDES, np.asarray(high, float), np.asarray(low, float))
    width = abs(corners[:, 1] - corners[:, 0]).sum(axis=1)
    height = abs(corners[:, 3] - corners[:, 0]).sum(axis=1)
    texcoords = _rectangles(width, height)
    return [(Patch(corners.reshape(-1, 3), _two_faces_each(6), texcoords), surface)]


def standing(heights: ArrayLike, radii: ArrayLike, sectors: int) -> Patch:
    """A profile rotated about z; UV in metres around and up."""
    z, r = np.asarray(heights, float), np.asarray(radii, float)
    around = 2.0 * np.pi * float(r.max())
    patch = revolved(z, r, sectors, uv_box=(0.0, float(z[0]), around, float(z[-1])))
    return patch.moved(axes=(1, 2, 0))


def cylinder(radius: float, height: float, surface: Surface, *, sectors: int = 16) -> Parts:
    """A closed upright cylinder."""
    return [(standing([0, 0, height, height], [0, radius, radius, 0], sectors), surface)]


def ball(center: ArrayLike, radii: ArrayLike, surface: Surface, *, sectors: int = 14) -> Parts:
    """An ellipsoid."""
    angle = np.linspace(0.0, np.pi, sectors // 2 + 1)
    patch = standing(-np.cos(angle), np.sin(angle), sectors)
    return [(patch.moved(center, scale=radii), surface)]


def rod(start: ArrayLike, end: ArrayLike, radius: float, surface: Surface) -> Parts:
    """A round bar between two points."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = (b - a) / np.linalg.norm(b - a, axis=-1)
    side = np.cross(along, (1.0, 0.0, 0.0) if abs(along[0]) < 0.9 else (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side, axis=-1)
    frame = np.stack([along, side, np.cross(along, side)])
    length = float(np.linalg.norm(b - a, axis=-1))
    tube = revolved([0, 0, length, length], [0, radius, radius, 0], 10, uv_box=(0, 0, 1, length))
    return [(Patch(product(tube.vertices, frame) + a, tube.faces, tube.texcoords), surface)]


def pierced(
    width: float, height: float, holes: ArrayLike, *, depth: float
) -> tuple[Patch, Patch, Patch]:
    """An upright wall in the plane y = 0, facing -y, with rectangular holes.

    Parameters
    ----------
    width, height : float, metres
    holes : (N, 4)
        x0, z0, x1, z1 of each hole; holes must not overlap.
    depth : float, metres
        Depth of the recess behind the wall.

    Returns
    -------
    The wall, the panes at the back of the holes, and the reveals between them.
    """
    hole = np.asarray(holes, float).reshape(-1, 4)
    x = np.unique(np.concatenate([[0.0, width], hole[:, 0], hole[:, 2]]))
    z = np.unique(np.concatenate([[0.0, height], hole[:, 1], hole[:, 3]]))
    gx, gz = np.meshgrid(x, z)
    grid = np.stack([gx, np.zeros_like(gx), gz], axis=-1)
    texcoords = np.stack([gx.ravel(), gz.ravel()], axis=-1)
    front = Patch(grid.reshape(-1, 3), _surfaces.grid_faces(len(z), len(x)), texcoords)
    center = front.centers[:, None, [0, 2]]
    in_hole: NDArray[np.bool_] = np.any(
        ((center > hole[:, :2]) & (center < hole[:, 2:])).all(axis=2), axis=1
    )
    panes = front.where(in_hole) if in_hole.any() else _nothing()
    return front.where(~in_hole), panes.moved((0.0, depth, 0.0)), _reveals(hole, depth)


def _nothing() -> Patch:
    return Patch(np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty((0, 2)))


def _reveals(hole: Points, depth: float) -> Patch:
    """The four sides of each hole, seen from inside it."""
    if len(hole) == 0:
        return _nothing()
    x0, z0, x1, z1 = hole.T
    corners = np.stack(
        [np.stack([x, 0 * x, z], axis=-1) for x, z in ((x0, z0), (x1, z0), (x1, z1), (x0, z1))], 1
    )
    front, back = corners, corners + np.array([0.0, depth, 0.0])
    following = [1, 2, 3, 0]
    quads = np.stack([front, back, back[:, following], front[:, following]], axis=2)
    vertices = quads.reshape(-1, 3)
    faces = _two_faces_each(len(vertices) // 4)[:, ::-1]
    length = np.linalg.norm(quads[:, :, 3] - quads[:, :, 0], axis=-1).ravel()
    return Patch(vertices, faces, _rectangles(np.full_like(length, depth), length))


def _rectangles(width: Points, height: Points) -> Points:
    """(4 N, 2) texture coordinates of the corners of N rectangles of the given sizes."""
    zero = np.zeros_like(width)
    u, v = np.stack([zero, width, width, zero], 1), np.stack([zero, zero, height, height], 1)
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def _two_faces_each(quads: int) -> NDArray[np.int64]:
    """Two faces for each of ``quads`` quads with successive corners."""
    corners = np.arange(4 * quads).reshape(-1, 4)
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


# --- Outdoors -----------------------------------------------------------------------------------
class Relief:
    """Gently rolling ground: the height as a function of the position."""

    def __init__(self, random: Random, amplitude: float, wavelength: float = 40.0) -> None:
        self._amplitude, self._wavelength = amplitude, wavelength
        self._seed = int(random.integers(1 << 30))

    def __call__(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Height at (x, y), metres."""
        places = np.stack(np.broadcast_arrays(x, y, 0.0), axis=-1).astype(float)
        noise = waves(places, 12, self._wavelength, np.random.default_rng(self._seed))
        return self._amplitude * noise

    def ground(self, half: float, cell: float, surface: Surface) -> Parts:
        """A square of ground of ``2 half`` metres."""
        s = np.arange(-half, half + cell, cell)
        x, y = np.meshgrid(s, s)
        grid = np.stack([x, y, self(x, y)], axis=-1)
        size = float(s[-1] - s[0])
        return [(sheet(grid, uv_box=(0.0, 0.0, size, size)), surface)]


def building(
    random: Random,
    length: float,
    depth: float,
    floors: int,
    *,
    wall: Surface = PLASTER,
    roof: Surface = CONCRETE,
    window: Surface = GLASS,
    frame: Surface = CONCRETE,
    gable: bool = False,
) -> Parts:
    """A house whose four sides have windows set back into the wall; its front faces -y."""
    storey = float(random.uniform(2.8, 3.4))
    height = floors * storey + 0.6
    parts: Parts = []
    bay = float(random.uniform(2.4, 3.6))
    recess = float(random.uniform(0.12, 0.3))
    for yaw, across, offset in (
        (0.0, length, (0.0, 0.0, 0.0)),
        (np.pi / 2, depth, (length, 0.0, 0.0)),
        (np.pi, length, (length, depth, 0.0)),
        (-np.pi / 2, depth, (0.0, depth, 0.0)),
    ):
        holes = _windows(random, across, floors, storey, bay)
        front, panes, reveals = pierced(across, height, holes, depth=recess)
        side = [(front, wall), (panes, window), (reveals, frame)]
        parts += placed(side, at=offset, yaw=yaw)
    return parts + _roof(length, depth, height, roof, wall, gable=gable)


def _windows(random: Random, across: float, floors: int, storey: float, bay: float) -> Points:
    """x0, z0, x1, z1 of the windows and the doors of one side."""
    count = max(1, int(across // bay))
    width, tall = random.uniform(0.9, 0.6 * bay), random.uniform(1.2, 1.7)
    middle = (np.arange(count) + 0.5) * across / count
    floor = np.arange(floors)[:, None] * storey
    x, sill = np.broadcast_arrays(middle, floor + 0.9)
    holes = np.stack([x - width / 2, sill, x + width / 2, sill + tall], axis=-1)
    holes[0, random.integers(count), [1, 3]] = 0.05, 2.2  # a door
    return np.asarray(holes.reshape(-1, 4))


def _roof(
    length: float, depth: float, height: float, roof: Surface, wall: Surface, *, gable: bool
) -> Parts:
    if not gable:
        return block((-0.2, -0.2, height), (length + 0.2, depth + 0.2, height + 0.3), roof)
    ridge = height + 0.35 * depth
    out, low = 0.4, height - 0.4 * 0.7
    slopes = [
        [(0, -out, low), (length, -out, low), (length, depth / 2, ridge), (0, depth / 2, ridge)],
        [
            (length, depth + out, low),
            (0, depth + out, low),
            (0, depth / 2, ridge),
            (length, depth / 2, ridge),
        ],
    ]
    corners = np.array([(x, y, height) for x in (0.0, length) for y in (0.0, depth)])
    tops = np.array([(0.0, depth / 2, ridge), (length, depth / 2, ridge)])
    ends = Patch(
        np.concatenate([corners, tops]),
        np.array([[0, 4, 1], [2, 3, 5]]),
        np.concatenate([corners, tops])[:, 1:],
    )
    return [*((quad(slope), roof) for slope in slopes), (ends, wall)]


def tree(random: Random, height: float, *, leaf: Surface = LEAF, leaves: int = 1200) -> Parts:
    """A tree; the last part is the leaves, the parts before it are wood."""
    trunk = 0.4 * height
    radius = 0.018 * height + 0.05
    z = np.linspace(0.0, 0.85 * height, 9)
    parts: Parts = [(standing(z, np.linspace(1.0, 0.15, 9) * radius, 12), BARK)]
    for angle in random.uniform(0.0, 2.0 * np.pi, 6):
        start = np.array([0.0, 0.0, random.uniform(0.8 * trunk, 0.7 * height)])
        reach = 0.22 * height * np.array([np.cos(angle), np.sin(angle), random.uniform(0.4, 1.0)])
        parts += rod(start, start + reach, 0.3 * radius, BARK)
    crown = np.array([0.24, 0.24, 0.33]) * height
    spot = random.normal(size=(leaves, 3))
    spot *= random.uniform(0.6, 1.0, (leaves, 1)) / np.linalg.norm(spot, axis=1)[:, None]
    lumps = 1.0 + 0.25 * waves(spot, 8, 1.2, random)[:, None]
    center = spot * crown * lumps + (0.0, 0.0, trunk + 0.8 * crown[2])
    return [*parts, (_leaf_quads(center, 0.045 * height, random), leaf)]


def hedge(random: Random, length: float, width: float, height: float) -> Parts:
    """A clipped hedge, a solid core covered with leaves, with its middle at the origin."""
    half = np.array([length, width, height]) / 2.0
    core = block(-0.85 * half + (0, 0, half[2]), 0.85 * half + (0, 0, half[2]), LEAF)
    count = int(60 * (length * height + length * width))
    spot = random.uniform(-1.0, 1.0, (count, 3))
    axis = random.choice(3, count, p=half / half.sum())
    spot[np.arange(count), axis] = np.copysign(1.0, spot[np.arange(count), axis])
    return [*core, (_leaf_quads(spot * half + (0, 0, half[2]), 0.12, random), LEAF)]


def _leaf_quads(center: Points, size: float, random: Random) -> Patch:
    """Small randomly rotated squares, one at each place."""
    count = len(center)
    a = random.normal(size=(count, 3))
    a /= np.linalg.norm(a, axis=1)[:, None]
    b = np.cross(a, random.normal(size=(count, 3)))
    b /= np.linalg.norm(b, axis=1)[:, None]
    half = 0.5 * size * random.uniform(0.6, 1.4, (count, 1))
    a, b = a * half, b * half
    vertices = np.stack([center - a - b, center + a - b, center + a + b, center - a + b], axis=1)
    texcoords = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (count, 1)) * size
    return Patch(vertices.reshape(-1, 3), _two_faces_each(count), texcoords)


@functools.cache
def _car_panels() -> tuple[Patch, ...]:
    """The panels of the procedural car of `models`, one for each material."""
    from manip3d.simulate import models

    mesh = models.car(5_000)
    half = np.sort(mesh.vertices[mesh.faces].sum(axis=1), axis=1)
    # the model stores each face twice, front and back
    _, first = np.unique(np.round(half, 9), axis=0, return_index=True)
    faces, material = mesh.faces[np.sort(first)], mesh.face_material
    assert material is not None
    # The front of the model looks to -x, y is up.
    vertices = mesh.vertices[:, [0, 2, 1]] * (-1.0, 1.0, 1.0)
    # projected along a direction that no face of a car has
    texcoords = vertices[:, [0, 2]] + 0.7 * vertices[:, 1:2]
    whole = Patch(vertices, faces.astype(np.int64), texcoords)
    kinds = material[np.sort(first)]
    return tuple(whole.where(kinds == k) for k in range(8))


def car(random: Random, *, paint: Surface | None = None) -> Parts:
    """A car of about 4.4 x 1.8 x 1.4 m that faces +x, of random size and, by default, colour."""
    if paint is None:
        paint = textures.paint(CAR_COLORS[random.integers(len(CAR_COLORS))])
    scale = random.uniform((0.86, 0.95, 0.97), (1.08, 1.05, 1.25))
    surfaces = (paint, CAR_GLASS, RUBBER, METAL, LAMP, TAIL_LAMP, DARK, CLOTH)
    return [
        (Patch(p.vertices * scale, p.faces, p.texcoords), s)
        for p, s in zip(_car_panels(), surfaces, strict=True)
    ]


CAR_COLORS = (
    (0.75, 0.76, 0.78),
    (0.05, 0.05, 0.06),
    (0.30, 0.31, 0.33),
    (0.86, 0.86, 0.84),
    (0.10, 0.16, 0.36),
    (0.50, 0.06, 0.06),
    (0.14, 0.26, 0.18),
    (0.52, 0.47, 0.38),
)


def person(random: Random) -> Parts:
    """A standing or walking person who faces +x."""
    tall = float(random.uniform(1.55, 1.92))
    coat, legs = textures.cloth(random, 0.8), textures.cloth(random, 0.4)
    stride = float(random.uniform(0.0, 0.28))
    parts: Parts = []
    for side, step in ((0.1, stride), (-0.1, -stride)):
        parts += rod((0, side, 0.5 * tall), (step, side, 0.04), 0.075, legs)
        parts += rod(
            (0, 2.1 * side, 0.8 * tall), (-0.8 * step, 2.4 * side, 0.46 * tall), 0.05, coat
        )
    body = standing(
        np.array([0.47, 0.5, 0.6, 0.72, 0.81, 0.85, 0.87]) * tall,
        [0.02, 0.15, 0.14, 0.17, 0.15, 0.08, 0.06],
        14,
    )
    parts.append((body.moved(scale=(0.75, 1.15, 1.0)), coat))
    return parts + ball((0, 0, 0.93 * tall), (0.10, 0.08, 0.12), SKIN)


def cyclist(random: Random) -> Parts:
    """A cyclist who rides towards +x."""
    parts: Parts = []
    for x in (-0.52, 0.52):
        wheel = revolved([-0.02, 0.02], [0.34, 0.34], 24).moved((x, 0, 0.34), axes=(1, 0, 2))
        rim = revolved([-0.02, 0.02], [0.30, 0.30], 24).moved((x, 0, 0.34), axes=(1, 0, 2))
        parts += [(wheel, RUBBER), (rim, METAL)]
    paint = Surface(tuple(random.uniform(0.1, 0.8, 3).tolist()), 0.4)
    corners = [
        ((-0.52, 0.34), (-0.1, 0.85)),
        ((-0.1, 0.85), (0.42, 0.9)),
        ((0.42, 0.9), (0.52, 0.34)),
    ]
    corners += [((0.0, 0.3), (-0.1, 0.85)), ((0.0, 0.3), (0.42, 0.85)), ((0.0, 0.3), (-0.52, 0.34))]
    for (x0, z0), (x1, z1) in corners:
        parts += rod((x0, 0, z0), (x1, 0, z1), 0.02, paint)
    rider = [(p.moved((0, 0, 0.35), scale=(1, 1, 0.82)), s) for p, s in person(random)]
    return parts + rider


def lamp_post(random: Random) -> Parts:
    """A street lamp whose arm reaches to +x."""
    height = float(random.uniform(5.0, 9.0))
    post = standing([0, 0, 1.0, height, height], [0, 0.11, 0.08, 0.05, 0], 12)
    arm = rod((0, 0, height - 0.1), (1.4, 0, height + 0.2), 0.04, METAL)
    return [
        (post, METAL),
        *arm,
        *block((1.2, -0.12, height + 0.1), (1.9, 0.12, height + 0.2), LAMP),
    ]


def sign(random: Random) -> Parts:
    """A traffic sign that faces -x."""
    height = float(random.uniform(2.2, 2.8))
    color = ((0.75, 0.1, 0.1), (0.1, 0.2, 0.6), (0.85, 0.75, 0.1))[random.integers(3)]
    disc = revolved([0, 0, 0.02, 0.02], [0, 0.32, 0.32, 0], 20).moved((-0.06, 0, height - 0.2))
    return [*cylinder(0.035, height, METAL, sectors=10), (disc, Surface(color, 0.95))]


def bench() -> Parts:
    """A park bench whose front faces -y."""
    parts = block((-0.8, -0.25, 0.40), (0.8, 0.25, 0.45), WOOD)
    parts += block((-0.8, 0.21, 0.55), (0.8, 0.25, 0.85), WOOD)
    for x in (-0.65, 0.6):
        parts += block((x, -0.22, 0), (x + 0.05, 0.25, 0.40), METAL)
        parts += block((x, 0.22, 0.4), (x + 0.05, 0.25, 0.85), METAL)
    return parts


def bin_(random: Random) -> Parts:
    """A litter bin."""
    return cylinder(float(random.uniform(0.2, 0.35)), float(random.uniform(0.8, 1.1)), METAL)


# --- Indoors ------------------------------------------------------------------------------------
def table(length: float, width: float, *, surface: Surface = WOOD) -> Parts:
    """A table with its middle at the origin."""
    x, y = length / 2, width / 2
    parts = block((-x, -y, 0.70), (x, y, 0.74), surface)
    for sx in (-1, 1):
        for sy in (-1, 1):
            corner = np.array([sx * (x - 0.06), sy * (y - 0.06)])
            parts += block((*(corner - 0.025), 0.0), (*(corner + 0.025), 0.70), METAL)
    return parts


def chair(*, surface: Surface = CLOTH) -> Parts:
    """A chair that faces +x."""
    parts = block((-0.22, -0.22, 0.42), (0.22, 0.22, 0.47), surface)
    parts += block((-0.25, -0.21, 0.55), (-0.21, 0.21, 0.95), surface)
    for x in (-0.2, 0.2):
        for y in (-0.2, 0.2):
            top = 0.95 if x < 0 else 0.42
            parts += block((x - 0.015, y - 0.015, 0.0), (x + 0.015, y + 0.015, top), METAL)
    return parts


def shelf(random: Random, length: float, height: float) -> Parts:
    """A shelf full of books and boxes; its back faces +y, and it is open to -y."""
    depth = 0.35
    parts = block((0, depth - 0.02, 0), (length, depth, height), WOOD)
    for x in (0.0, length - 0.03):
        parts += block((x, 0, 0), (x + 0.03, depth, height), WOOD)
    for level in np.arange(0.05, height, 0.38):
        parts += block((0, 0, level), (length, depth, level + 0.025), WOOD)
        x = 0.05
        while x < length - 0.15 and level + 0.35 < height:
            wide = float(random.uniform(0.02, 0.12))
            tall, deep = float(random.uniform(0.15, 0.32)), float(random.uniform(0.02, 0.15))
            if random.random() < 0.8:
                color = tuple(random.uniform(0.1, 0.8, 3).tolist())
                book = Surface(color, float(np.mean(color)))
                low = (x, deep, level + 0.025)
                parts += block(low, (x + wide, depth - 0.03, level + tall), book)
            x += wide + 0.003
    return parts


def cabinet(length: float, depth: float, height: float, surface: Surface = METAL) -> Parts:
    """A closed cabinet with a recessed base; its back faces +y."""
    parts = block((0, 0.04, 0), (length, depth, 0.08), DARK)
    parts += block((0, 0, 0.08), (length, depth, height), surface)
    for x in np.arange(0.45, length, 0.5):
        parts += rod((x, -0.03, 0.45 * height), (x, -0.03, 0.55 * height), 0.012, METAL)
    return parts


def sofa(length: float) -> Parts:
    """A sofa that faces -y."""
    parts = block((0, 0, 0.08), (length, 0.85, 0.42), CLOTH)
    parts += block((0, 0.62, 0.42), (length, 0.85, 0.85), CLOTH)
    for x in (0.0, length - 0.18):
        parts += block((x, 0, 0.42), (x + 0.18, 0.85, 0.62), CLOTH)
    return parts


def crates(random: Random, count: int) -> Parts:
    """A stack of boxes, each slightly rotated."""
    parts: Parts = []
    z = 0.0
    for _ in range(count):
        size = random.uniform((0.4, 0.4, 0.3), (0.8, 0.7, 0.6))
        color = (0.62, 0.48, 0.32) if random.random() < 0.7 else (0.3, 0.4, 0.55)
        crate = block(
            (-size[0] / 2, -size[1] / 2, z),
            (size[0] / 2, size[1] / 2, z + size[2]),
            Surface(color, 0.5),
        )
        yaw = float(random.normal(0.0, 0.12))
        parts += [(Patch(turned(p.vertices, yaw), p.faces, p.texcoords), s) for p, s in crate]
        z += float(size[2])
    return parts


def plant(random: Random) -> Parts:
    """A pot plant."""
    pot = cylinder(0.18, 0.35, Surface((0.55, 0.28, 0.18), 0.5))
    spot = random.normal(size=(160, 3)) * (0.22, 0.22, 0.28) + (0, 0, 0.85)
    stem = rod((0, 0, 0.3), (0, 0, 0.9), 0.015, BARK)
    return [*pot, *stem, (_leaf_quads(spot, 0.14, random), LEAF)]
