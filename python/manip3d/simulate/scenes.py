"""Procedural rooms and outdoor places for a terrestrial scanner; x east, y north, z up, metres.

`SCENES` has 17 indoor and 27 outdoor scenes, all different. Thresholds may be chosen on the scenes
of `CALIBRATION`, on which no results are reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import product
from manip3d._util.options import generator_of
from manip3d.errors import InputError
from manip3d.simulate import _things as things
from manip3d.simulate._surfaces import Patch, Points, sheet, waves
from manip3d.simulate._things import Random, Relief
from manip3d.simulate._world import Label, Parts, Surface, World, WorldBuilder, placed

if TYPE_CHECKING:
    from manip3d._util.options import Rng

__all__ = [
    "CALIBRATION",
    "INDOOR",
    "OUTDOOR",
    "SCENES",
    "Label",
    "Scene",
    "World",
    "indoor",
    "make",
    "outdoor",
]

GRASS = Surface((0.28, 0.38, 0.16), 0.5)
ASPHALT = Surface((0.25, 0.25, 0.26), 0.18)
PAVING = Surface((0.5, 0.47, 0.44), 0.35)
CARPET = Surface((0.35, 0.33, 0.36), 0.35)
PARQUET = Surface((0.52, 0.36, 0.2), 0.4)


@dataclass(frozen=True, eq=False)
class Scene:
    """A place with the position of a scanner.

    Attributes
    ----------
    name : str
        Name of the scene.
    indoor : bool
        Whether the scene is indoors.
    kind : str
        ``"office"``, ``"street"``, ...
    world : World
        The world, with a true label and an object number for each face.
    scanner : (x, y, z), metres
        Position of the scanner in the world's frame.
    """

    name: str
    indoor: bool
    kind: str
    world: World
    scanner: tuple[float, float, float]


def make(name: str) -> Scene:
    """Make a scene by its name in `SCENES` or `CALIBRATION`; it is always the same.

    Raises
    ------
    InputError
        There is no scene of this name.
    """
    recipe = {**SCENES, **CALIBRATION}.get(name)
    if recipe is None:
        raise InputError(f"name: expected a scene such as 'indoor-00', got {name!r}")
    kind, seed = recipe
    build = indoor if kind in _ROOMS else outdoor
    return build(kind, rng=seed, name=name)


def indoor(kind: str, *, rng: Rng = 0, name: str = "") -> Scene:
    """Make a furnished room with windows and a door to a corridor.

    Parameters
    ----------
    kind : str
        ``office``, ``living``, ``lecture``, ``storage``, ``hall`` or ``workshop``.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.
    name : str
        Name of the scene; its kind, if empty.

    Raises
    ------
    InputError
        The kind is unknown.
    """
    random = generator_of(rng)
    furnish = _known(kind, _ROOMS)
    builder = WorldBuilder()
    low, high = _ROOM_SIZES[kind]
    length, width, height = random.uniform(low, high)
    _shell(builder, random, length, width, height)
    plan = _Plan(random, (0.0, length), (0.0, width))
    x = float(random.uniform(0.35, 0.65) * length)
    y = float(random.uniform(0.35, 0.65) * width)
    plan.keep_free(x, y, 0.9)
    plan.keep_free(length / 2, 0.5, 0.7)  # the door
    furnish(builder, random, plan, length, width, height)
    scanner = (x, y, float(random.uniform(1.4, 1.8)))
    return Scene(name or kind, True, kind, builder.build(), scanner)


def outdoor(kind: str, *, rng: Rng = 0, name: str = "") -> Scene:
    """Make an outdoor place of about 240 m in town or in the country.

    Parameters
    ----------
    kind : str
        ``street``, ``square``, ``parking``, ``park``, ``courtyard`` or ``suburb``.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.
    name : str
        Name of the scene; its kind, if empty.

    Raises
    ------
    InputError
        The kind is unknown.
    """
    random = generator_of(rng)
    lay_out = _known(kind, _PLACES)
    builder = WorldBuilder()
    relief = Relief(random, _RELIEF[kind])
    builder.add(relief.ground(120.0, 2.0, _GROUND[kind]), Label.GROUND)
    plan = _Plan(random, (-100.0, 100.0), (-100.0, 100.0))
    plan.keep_free(0.0, 0.0, 3.0)
    lay_out(builder, random, plan, relief)
    z = float(relief(0.0, 0.0)) + float(random.uniform(1.5, 1.9))
    return Scene(name or kind, False, kind, builder.build(), (0.0, 0.0, z))


def _known(kind: str, table: dict[str, Callable[..., None]]) -> Callable[..., None]:
    if kind not in table:
        raise InputError(f"kind: expected one of {', '.join(table)}, got {kind!r}")
    return table[kind]


class _Plan:
    """Occupied places, as circles, so that objects do not intersect."""

    def __init__(
        self, random: Random, x_range: tuple[float, float], y_range: tuple[float, float]
    ) -> None:
        self._random = random
        self._low = np.array([x_range[0], y_range[0]])
        self._high = np.array([x_range[1], y_range[1]])
        self._taken = np.empty((0, 3))  # x, y, radius

    def keep_free(self, x: float, y: float, radius: float) -> None:
        """Reserve the circle of ``radius`` around (x, y)."""
        self._taken = np.vstack([self._taken, [x, y, radius]])

    def is_free(self, x: float, y: float, radius: float) -> bool:
        """Return whether an object of this radius fits at (x, y)."""
        at = np.array([x, y])
        apart = np.hypot(*(self._taken[:, :2] - at).T) >= self._taken[:, 2] + radius
        return bool(
            apart.all() and (at - radius >= self._low).all() and (at + radius <= self._high).all()
        )

    def spot(
        self, radius: float, *, within: float = np.inf, tries: int = 40
    ) -> tuple[float, float] | None:
        """Reserve and return a free place at most ``within`` from the middle; None: none."""
        low, high = np.maximum(self._low, -within), np.minimum(self._high, within)
        if np.isinf(within):
            low, high = self._low, self._high
        for x, y in self._random.uniform(low, high, (tries, 2)).tolist():
            if self.is_free(x, y, radius):
                self.keep_free(x, y, radius)
                return x, y
        return None


# --- Rooms --------------------------------------------------------------------------------------
def _shell(
    builder: WorldBuilder, random: Random, length: float, width: float, height: float
) -> None:
    """Add floor, ceiling, a wall with windows, three other walls, a door and a corridor."""
    floor = (PARQUET, CARPET, things.CONCRETE)[random.integers(3)]
    color = tuple(random.uniform(0.6, 0.9, 3).tolist())
    wall = Surface(color, float(random.uniform(0.5, 0.8)))
    bays = max(1, int(length // 2.2))
    middle = (np.arange(bays) + 0.5) * length / bays
    half, sill, top = random.uniform(0.5, 0.8), random.uniform(0.7, 1.0), 0.85 * height
    windows = np.stack([middle - half, 0 * middle + sill, middle + half, 0 * middle + top], 1)
    door = [[length / 2 - 0.45, 0.0, length / 2 + 0.45, 2.05]]
    front, panes, reveals = things.pierced(length, height, windows, depth=0.25)
    back, _, passage = things.pierced(length, height, door, depth=0.15)
    side = things.pierced(width, height, [], depth=0.1)[0]
    # Walls face -y in their own frame; they are rotated so that they face the room.
    builder.add(placed([(front, wall), (reveals, wall)], at=(0, width, 0)), Label.WALL)
    builder.add(placed([(panes, things.GLASS)], at=(0, width, 0)), Label.WALL)
    builder.add(placed([(back, wall), (passage, wall)], at=(length, 0, 0), yaw=np.pi), Label.WALL)
    builder.add(placed([(side, wall)], at=(0, 0, 0), yaw=np.pi / 2), Label.WALL)
    builder.add(placed([(side, wall)], at=(length, width, 0), yaw=-np.pi / 2), Label.WALL)
    builder.add([(_uneven(length, width, random), floor)], Label.GROUND)
    ceiling = things.quad(
        [(0, 0, height), (0, width, height), (length, width, height), (length, 0, height)]
    )
    builder.add([(ceiling, things.PLASTER)], Label.WALL)
    _corridor(builder, length, height, wall, floor)


def _corridor(
    builder: WorldBuilder, length: float, height: float, wall: Surface, floor: Surface
) -> None:
    """Add the corridor that is visible through the door in the wall y = 0."""
    x0, x1, y0, y1 = -3.0, length + 3.0, -2.15, -0.15
    far = things.quad([(x0, y0, 0), (x0, y0, height), (x1, y0, height), (x1, y0, 0)])
    ground = things.quad([(x0, y0, 0), (x1, y0, 0), (x1, 0, 0), (x0, 0, 0)])
    above = things.quad([(x0, y0, height), (x0, y1, height), (x1, y1, height), (x1, y0, height)])
    builder.add([(far, wall), (above, wall)], Label.WALL)
    builder.add([(ground.moved((0, 0, -0.002)), floor)], Label.GROUND)


def _uneven(length: float, width: float, random: Random) -> Patch:
    """Make a floor that is flat to a few millimetres."""
    x, y = np.meshgrid(np.linspace(0, length, 25), np.linspace(0, width, 25))
    grid = np.stack([x, y, 0 * x], axis=-1)
    grid[..., 2] = 0.0015 * waves(grid, 8, 2.5, random)
    return sheet(grid, uv_box=(0.0, 0.0, length, width))


def _against_walls(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    length: float,
    width: float,
    pieces: list[tuple[Parts, float, float]],
) -> None:
    """Add pieces along the walls; each is (parts with their back to +y, length, depth)."""
    for parts, long, deep in pieces:
        for _ in range(12):
            corner, yaw = _beside_a_wall(random, length, width, long, deep)
            along = np.array([np.cos(yaw), np.sin(yaw)])
            inward = np.array([-along[1], along[0]]) * deep / 2
            steps = np.linspace(deep / 2, long - deep / 2, max(1, round(long / deep)) + 1)
            circles = (corner + inward + steps[:, None] * along).tolist()
            if all(plan.is_free(x, y, deep / 2) for x, y in circles):
                for x, y in circles:
                    plan.keep_free(x, y, deep / 2 + 0.1)
                builder.add_object(parts, Label.FURNITURE, at=(*corner, 0.0), yaw=yaw)
                break


def _beside_a_wall(
    random: Random, length: float, width: float, long: float, deep: float
) -> tuple[Points, float]:
    """Front corner and direction of a piece whose back is 3 cm from the wall at +y, +x or -x."""
    x, y = random.uniform(0.3, (length - long - 0.3, width - long - 0.3))
    corner, yaw = (
        ((x, width - deep - 0.03), 0.0),
        ((length - deep - 0.03, y + long), -np.pi / 2),
        ((deep + 0.03, y), np.pi / 2),
    )[random.integers(3)]
    return np.array(corner), yaw


def _on_floor(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    parts: Parts,
    radius: float,
    label: Label = Label.FURNITURE,
) -> tuple[float, float, float] | None:
    """Add an object at a random free place and angle; return (x, y, yaw) or None."""
    spot = plan.spot(radius)
    if spot is None:
        return None
    yaw = float(random.uniform(-np.pi, np.pi))
    builder.add_object(parts, label, at=(*spot, 0.0), yaw=yaw)
    return (*spot, yaw)


def _desk(builder: WorldBuilder, random: Random, plan: _Plan) -> None:
    """Add a desk with a screen, and a chair before it."""
    long = float(random.uniform(1.2, 1.8))
    parts = things.table(long, 0.75)
    parts += things.block((-0.3, 0.2, 0.80), (0.3, 0.23, 1.15), things.DARK)
    parts += things.block((-0.05, 0.18, 0.74), (0.05, 0.25, 0.80), things.DARK)
    seat = placed(things.chair(), at=(random.uniform(-0.2, 0.2), -0.65, 0), yaw=np.pi / 2)
    _on_floor(builder, random, plan, parts + seat, 0.55 * long)


def _office(
    builder: WorldBuilder, random: Random, plan: _Plan, length: float, width: float, height: float
) -> None:
    shelves = [
        (things.shelf(random, long, 2.0), long, 0.35) for long in random.uniform(0.8, 1.6, 3)
    ]
    closets = [
        (things.cabinet(long, 0.45, 1.3), long, 0.45) for long in random.uniform(0.8, 1.4, 2)
    ]
    _against_walls(builder, random, plan, length, width, shelves + closets)
    for _ in range(int(random.integers(2, 5))):
        _desk(builder, random, plan)
    _on_floor(builder, random, plan, things.plant(random), 0.35, Label.VEGETATION)
    _on_floor(builder, random, plan, things.bin_(random), 0.35)


def _living(
    builder: WorldBuilder, random: Random, plan: _Plan, length: float, width: float, height: float
) -> None:
    seat = float(random.uniform(1.6, 2.4))
    pieces = [
        (things.sofa(seat), seat, 0.85),
        (things.cabinet(1.8, 0.45, 0.6, things.WOOD), 1.8, 0.45),
    ]
    pieces += [(things.shelf(random, 1.2, 1.9), 1.2, 0.35)]
    _against_walls(builder, random, plan, length, width, pieces)
    spot = _on_floor(builder, random, plan, things.table(1.5, 0.9), 0.9)
    if spot is not None:
        for angle in (0.0, np.pi / 2, np.pi, -np.pi / 2):
            x = spot[0] + (0.95 if angle in (0.0, np.pi) else 0.65) * np.cos(angle + spot[2])
            y = spot[1] + (0.95 if angle in (0.0, np.pi) else 0.65) * np.sin(angle + spot[2])
            builder.add_object(
                things.chair(surface=things.WOOD),
                Label.FURNITURE,
                at=(x, y, 0),
                yaw=angle + spot[2] + np.pi,
            )
    for _ in range(int(random.integers(1, 3))):
        _on_floor(builder, random, plan, things.plant(random), 0.35, Label.VEGETATION)


def _lecture(
    builder: WorldBuilder, random: Random, plan: _Plan, length: float, width: float, height: float
) -> None:
    for x in np.arange(2.5, length - 1.0, float(random.uniform(1.2, 1.5))):
        for y in np.arange(0.9, width - 0.9, 1.5):
            at = (float(x + random.normal(0, 0.03)), float(y + random.normal(0, 0.03)))
            if plan.is_free(*at, 0.6):
                desk = placed(things.table(1.3, 0.5), yaw=np.pi / 2)
                seats = [
                    p
                    for dy in (-0.32, 0.32)
                    for p in placed(
                        things.chair(), at=(0.5, dy, 0), yaw=np.pi + random.normal(0, 0.2)
                    )
                ]
                builder.add_object(desk + seats, Label.FURNITURE, at=(*at, 0.0))
    board = things.block((0.02, 0.25 * width, 0.9), (0.06, 0.75 * width, 2.1), things.DARK)
    builder.add_object(board, Label.FURNITURE)


def _storage(
    builder: WorldBuilder, random: Random, plan: _Plan, length: float, width: float, height: float
) -> None:
    racks = [(things.shelf(random, long, 2.3), long, 0.35) for long in random.uniform(1.2, 2.4, 5)]
    _against_walls(builder, random, plan, length, width, racks)
    for _ in range(int(random.integers(4, 9))):
        _on_floor(builder, random, plan, things.crates(random, int(random.integers(1, 4))), 0.6)


def _hall(
    builder: WorldBuilder, random: Random, plan: _Plan, length: float, width: float, height: float
) -> None:
    radius = float(random.uniform(0.2, 0.4))
    for x in np.arange(2.0, length - 1.5, float(random.uniform(3.0, 4.5))):
        for y in (0.25 * width, 0.75 * width):
            if plan.is_free(float(x), y, radius):
                plan.keep_free(float(x), y, radius)
                pillar = things.cylinder(radius, height, things.CONCRETE, sectors=28)
                builder.add_object(pillar, Label.WALL, at=(x, y, 0))
    for _ in range(int(random.integers(2, 6))):
        _on_floor(builder, random, plan, things.bench(), 0.9)
    for _ in range(int(random.integers(0, 3))):
        _on_floor(builder, random, plan, things.person(random), 0.4, Label.PERSON)


def _workshop(
    builder: WorldBuilder, random: Random, plan: _Plan, length: float, width: float, height: float
) -> None:
    benches = [(things.cabinet(long, 0.7, 0.9), long, 0.7) for long in random.uniform(1.2, 2.2, 3)]
    _against_walls(builder, random, plan, length, width, benches)
    for x in np.arange(0.8, length, float(random.uniform(1.5, 2.5))):
        pipe = things.rod(
            (x, 0.3, 0.9 * height), (x, width - 0.3, 0.9 * height), 0.05, things.METAL
        )
        builder.add_object(pipe, Label.FURNITURE)
    for _ in range(3):
        machine = things.block((-0.5, -0.4, 0), (0.5, 0.4, 0.9), things.METAL)
        machine += things.cylinder(0.2, 1.5, things.METAL, sectors=24)
        machine += things.ball((0.25, 0.1, 1.0), (0.2, 0.2, 0.25), things.METAL)
        _on_floor(builder, random, plan, machine, 0.75)
    _on_floor(builder, random, plan, things.crates(random, 3), 0.6)


# --- Places -------------------------------------------------------------------------------------
def _put(
    builder: WorldBuilder,
    relief: Relief,
    parts: Parts,
    label: Label,
    at: tuple[float, float],
    yaw: float = 0.0,
    more: tuple[tuple[Parts, Label], ...] = (),
) -> None:
    """Add an object on the ground, sunk by 3 cm."""
    z = float(relief(*at)) - 0.03
    builder.add_object(parts, label, at=(*at, z), yaw=yaw, more=more)


def _house(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    relief: Relief,
    corner: tuple[float, float],
    size: tuple[float, float],
    yaw: float,
    *,
    floors: tuple[int, int] = (2, 6),
    gable: bool = False,
) -> None:
    """Add a building with a given corner, size (length, depth) and direction of its front."""
    wall = Surface(tuple(random.uniform(0.4, 0.9, 3).tolist()), float(random.uniform(0.3, 0.7)))
    parts = things.building(random, *size, int(random.integers(*floors)), wall=wall, gable=gable)
    along = np.array([np.cos(yaw), np.sin(yaw)])
    inward = np.array([-along[1], along[0]])
    center = np.asarray(corner) + along * size[0] / 2 + inward * size[1] / 2
    for s in np.linspace(-0.5, 0.5, max(2, round(size[0] / size[1]) + 1)):
        x, y = (center + along * s * max(0.0, size[0] - size[1])).tolist()
        plan.keep_free(x, y, 0.6 * size[1])
    z = float(relief(*center)) - 0.4
    builder.add_object(parts, Label.BUILDING, at=(*corner, z), yaw=yaw)


def _row_of_houses(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    relief: Relief,
    start: tuple[float, float],
    yaw: float,
    length: float,
    *,
    gap: float = 0.0,
    gable: bool = False,
    floors: tuple[int, int] = (2, 6),
) -> None:
    """Add houses side by side, with fronts to the right of the direction ``yaw``."""
    along = np.array([np.cos(yaw), np.sin(yaw)])
    s = 0.0
    while s < length:
        size = (float(random.uniform(9, 20)), float(random.uniform(8, 14)))
        x, y = (np.asarray(start) + s * along).tolist()
        _house(builder, random, plan, relief, (x, y), size, yaw, floors=floors, gable=gable)
        s += size[0] + gap * float(random.uniform(0.6, 1.4))


def _trees(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    relief: Relief,
    count: int,
    *,
    within: float = 60.0,
) -> None:
    for _ in range(count):
        spot = plan.spot(1.5, within=within)
        if spot is not None:
            _one_tree(builder, random, relief, spot)


def _one_tree(
    builder: WorldBuilder, random: Random, relief: Relief, at: tuple[float, float]
) -> None:
    parts = things.tree(random, float(random.uniform(5.0, 12.0)))
    _put(builder, relief, parts[:-1], Label.TRUNK, at, more=((parts[-1:], Label.VEGETATION),))


def _people(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief, count: int) -> None:
    for _ in range(count):
        spot = plan.spot(0.5, within=35.0)
        if spot is not None:
            yaw = float(random.uniform(-np.pi, np.pi))
            _put(builder, relief, things.person(random), Label.PERSON, spot, yaw)


def _parked(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    relief: Relief,
    start: tuple[float, float],
    count: int,
    *,
    pitch: float,
    turn: float = 0.0,
    share: float = 0.7,
) -> None:
    """Add a row of parked cars along x, ``pitch`` apart, each rotated by ``turn``."""
    for slot in range(count):
        x, y = (np.add(start, (pitch * slot, 0.0)) + random.normal(0, 0.12, 2)).tolist()
        if random.random() < share and plan.is_free(x, y, 1.3):
            plan.keep_free(x, y, 2.2)
            heading = turn + float(random.normal(0, 0.03))
            _put(builder, relief, things.car(random), Label.CAR, (x, y), heading)


def _posts(
    builder: WorldBuilder,
    random: Random,
    plan: _Plan,
    relief: Relief,
    y: float,
    pitch: float,
    yaw: float,
) -> None:
    """Add street lamps and some signs along a line of constant y."""
    for x in np.arange(-80.0, 80.0, pitch) + random.uniform(0, pitch):
        make_post = things.lamp_post if random.random() < 0.7 else things.sign
        if plan.is_free(float(x), y, 0.3):
            plan.keep_free(float(x), y, 0.3)
            _put(builder, relief, make_post(random), Label.POLE, (float(x), y), yaw)


def _street(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief) -> None:
    near, far = float(random.uniform(8, 11)), float(random.uniform(9, 14))
    _row_of_houses(builder, random, plan, relief, (-90, near), 0.0, 180)
    _row_of_houses(builder, random, plan, relief, (90, -far), np.pi, 180)
    _parked(builder, random, plan, relief, (-60, near - 3.5), 22, pitch=5.6)
    _parked(builder, random, plan, relief, (-60, -far + 3.5), 22, pitch=5.6, turn=np.pi)
    _posts(builder, random, plan, relief, near - 1.5, float(random.uniform(18, 28)), -np.pi / 2)
    for x in np.arange(-55.0, 55.0, float(random.uniform(9, 15))):
        if random.random() < 0.6 and plan.is_free(float(x), -far + 1.6, 0.4):
            _one_tree(builder, random, relief, (float(x), -far + 1.6))
    _people(builder, random, plan, relief, 10)


def _square(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief) -> None:
    half = float(random.uniform(22, 38))
    for quarter in range(4):
        yaw = quarter * np.pi / 2
        corner = np.array([-half, half])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        x, y = product(turn, corner).tolist()
        _row_of_houses(builder, random, plan, relief, (x, y), yaw, 2 * half - 14, floors=(3, 7))
    base = things.block((-1, -1, 0), (1, 1, 1.2), things.CONCRETE)
    figure = placed(things.person(random), at=(0, 0, 1.2))
    spot = plan.spot(2.0, within=15.0)
    if spot is not None:
        _put(builder, relief, base + figure, Label.WALL, spot)
    for _ in range(8):
        at = plan.spot(1.0, within=25.0)
        if at is not None:
            yaw = float(random.uniform(-3, 3))
            _put(builder, relief, things.bench(), Label.FURNITURE, at, yaw)
    _trees(builder, random, plan, relief, 8, within=28.0)
    _people(builder, random, plan, relief, 20)


def _parking(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief) -> None:
    for row, y in enumerate((-17.0, -11.5, 5.5, 11.0, 22.0)):
        turn = np.pi / 2 if row % 2 else -np.pi / 2
        _parked(builder, random, plan, relief, (-36, y), 28, pitch=2.7, turn=turn, share=0.55)
    _row_of_houses(builder, random, plan, relief, (-60, 36), 0.0, 110, floors=(1, 4))
    _posts(builder, random, plan, relief, -4.0, 22.0, np.pi / 2)
    _trees(builder, random, plan, relief, 18, within=55.0)
    _people(builder, random, plan, relief, 6)


def _park(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief) -> None:
    _trees(builder, random, plan, relief, 45)
    for _ in range(7):
        spot = plan.spot(1.2, within=30.0)
        if spot is not None:
            _put(
                builder, relief, things.bench(), Label.FURNITURE, spot, float(random.uniform(-3, 3))
            )
    for _ in range(6):
        spot = plan.spot(2.0, within=40.0)
        if spot is not None:
            bush = things.hedge(random, *random.uniform((1.5, 0.8, 0.7), (4.0, 1.5, 1.6)).tolist())
            _put(builder, relief, bush, Label.VEGETATION, spot, float(random.uniform(-3, 3)))
    _row_of_houses(builder, random, plan, relief, (-80, 70), 0.0, 140, gap=8.0)
    _people(builder, random, plan, relief, 8)


def _courtyard(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief) -> None:
    half = random.uniform(10, 17, 2)
    for quarter, (x, y) in enumerate(((-1, 1), (-1, -1), (1, -1), (1, 1))):
        yaw = (0.0, np.pi / 2, np.pi, -np.pi / 2)[quarter]
        length = 2 * float(half[quarter % 2])
        size = (length - (0.0 if quarter else 4.5), 10.0)  # the first house leaves a gateway
        _house(builder, random, plan, relief, (x * half[0], y * half[1]), size, yaw, floors=(2, 5))
    for _ in range(5):
        spot = plan.spot(0.5, within=12.0)
        if spot is not None:
            _put(builder, relief, things.bin_(random), Label.FURNITURE, spot)
    _parked(builder, random, plan, relief, (-half[0] + 3, -half[1] + 3), 5, pitch=3.0, turn=1.57)
    _trees(builder, random, plan, relief, 3, within=float(half.min()))
    _people(builder, random, plan, relief, 4)


def _suburb(builder: WorldBuilder, random: Random, plan: _Plan, relief: Relief) -> None:
    near, far = float(random.uniform(14, 20)), float(random.uniform(14, 20))
    for start, yaw in (((-80.0, near), 0.0), ((80.0, -far), np.pi)):
        _row_of_houses(
            builder, random, plan, relief, start, yaw, 150, gap=9.0, gable=True, floors=(1, 4)
        )
    for y in (near - 8.0, -far + 8.0):
        for x in np.arange(-60.0, 60.0, 9.0) + random.uniform(0, 4):
            size = random.uniform((4.0, 0.6, 0.8), (7.5, 1.0, 1.8)).tolist()
            if random.random() < 0.7 and plan.is_free(float(x), y, 1.0):
                _put(builder, relief, things.hedge(random, *size), Label.VEGETATION, (float(x), y))
    _parked(builder, random, plan, relief, (-50, near - 10.5), 14, pitch=7.0, share=0.5)
    _posts(builder, random, plan, relief, -far + 10.0, 25.0, np.pi / 2)
    _trees(builder, random, plan, relief, 26)
    _people(builder, random, plan, relief, 4)


_ROOMS: dict[str, Callable[..., None]] = {
    "office": _office,
    "living": _living,
    "lecture": _lecture,
    "storage": _storage,
    "hall": _hall,
    "workshop": _workshop,
}
_ROOM_SIZES = {
    "office": ((5.0, 4.0, 2.5), (8.0, 6.0, 3.0)),
    "living": ((5.0, 4.5, 2.4), (8.0, 6.5, 2.9)),
    "lecture": ((9.0, 6.0, 2.9), (14.0, 9.0, 3.8)),
    "storage": ((7.0, 6.0, 3.0), (12.0, 9.0, 4.5)),
    "hall": ((14.0, 8.0, 3.5), (24.0, 14.0, 6.0)),
    "workshop": ((8.0, 6.0, 3.2), (14.0, 10.0, 5.0)),
}
_PLACES: dict[str, Callable[..., None]] = {
    "street": _street,
    "square": _square,
    "parking": _parking,
    "park": _park,
    "courtyard": _courtyard,
    "suburb": _suburb,
}
_RELIEF = {
    "street": 0.04,
    "square": 0.05,
    "parking": 0.05,
    "park": 0.6,
    "courtyard": 0.04,
    "suburb": 0.25,
}
_GROUND = {
    "street": ASPHALT,
    "square": PAVING,
    "parking": ASPHALT,
    "park": GRASS,
    "courtyard": PAVING,
    "suburb": GRASS,
}


def _named(prefix: str, kinds: list[str], count: int, seed: int) -> dict[str, tuple[str, int]]:
    """Names of scenes with their kind and seed; kinds alternate."""
    return {
        f"{prefix}-{number:02d}": (kinds[number % len(kinds)], seed + number)
        for number in range(count)
    }


INDOOR = _named("indoor", list(_ROOMS), 17, 1000)
"""Kind and seed of the indoor scenes."""
OUTDOOR = _named("outdoor", list(_PLACES), 27, 2000)
"""Kind and seed of the outdoor scenes."""
SCENES = {**INDOOR, **OUTDOOR}
"""The 44 scenes on which results are reported."""
CALIBRATION = {
    **_named("calibration-indoor", list(_ROOMS), 12, 5000),
    **_named("calibration-outdoor", list(_PLACES), 12, 6000),
}
"""Scenes on which thresholds may be chosen, and on which no results are reported."""
