"""Procedural streets with traffic, for sensors on a moving car; x along the street, z up,
metres."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.checked import checked
from manip3d._util.options import generator_of
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.lidar import Box
from manip3d.simulate import _textures as textures
from manip3d.simulate import _things as things
from manip3d.simulate._stage import Mover, Stage
from manip3d.simulate._surfaces import Patch, sheet
from manip3d.simulate._things import Random, Relief
from manip3d.simulate._world import Label, Parts, Surface, World, WorldBuilder, placed

if TYPE_CHECKING:
    from manip3d._util.options import Rng

__all__ = ["SENSOR_HEIGHT", "Mover", "Street", "street"]

SENSOR_HEIGHT = 1.73
"""Height of the LiDAR above the road, metres: KITTI's car (Geiger et al., IJRR 2013, figure 3)."""

LENGTH = 420.0
"""Length of a street, metres; the car drives from 60 to at most 360."""
BORDER = 95.0
"""Extent of the ground to both sides, metres: beyond the reach of the laser."""

ROAD_USERS = frozenset(label.title for label in (Label.CAR, Label.PERSON, Label.CYCLIST))
"""Labels of the boxes that a street returns."""

MARKING = Surface((0.9, 0.9, 0.88), 0.8)
CURB = Surface((0.6, 0.59, 0.57), 0.4)


@dataclass(frozen=True, eq=False)
class Street:
    """A street with traffic, and the trajectory of the car with the sensors.

    Attributes
    ----------
    world : World
        Static world.
    movers : tuple of Mover
        Moving cars, cyclists and people.
    relief : callable
        Height of the road at (x, y).
    start : (x, y), metres
        Position of the car at time 0.
    speed : float, metres per second
        Speed of the car.
    sway : float, metres
        Amplitude of the car's oscillation about the middle of its lane.
    """

    world: World
    movers: tuple[Mover, ...]
    relief: Relief
    start: tuple[float, float]
    speed: float
    sway: float

    def __repr__(self) -> str:
        faces = counted(len(self.world.faces), "face")
        car = f"car at {self.speed:.1f} m/s for {self.duration:.1f} s"
        return f"<manip3d.simulate.Street: {faces}, {counted(len(self.movers), 'mover')}; {car}>"

    @functools.cached_property
    def stage(self) -> Stage:
        """World and movers, ready for ray casting; built once."""
        return Stage(self.world, self.movers)

    def pose(self, times: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the pose of the LiDAR at given times.

        Parameters
        ----------
        times : (N,) float, seconds
            Times on the street's clock.

        Returns
        -------
        positions : (N, 3) float64, metres
            Positions of the LiDAR.
        yaws : (N,) float64, radians
            Directions of the car, counter-clockwise from x.

        Raises
        ------
        InputError
            The car is not on the street at one of the times.
        """
        t = np.asarray(times, float)
        x = self.start[0] + self.speed * t
        if x.size and not (x.min() > 10.0 and x.max() < LENGTH - 10.0):
            raise InputError(
                f"times: expected the car on the street (x from 10 to {LENGTH - 10:.0f} m), "
                f"got x from {x.min():.1f} to {x.max():.1f} m"
            )
        wave = 2.0 * math.pi / 60.0  # period of 60 m
        y = self.start[1] + self.sway * np.sin(wave * x)
        z = self.relief(x, y) + SENSOR_HEIGHT
        yaw = np.arctan(self.sway * wave * np.cos(wave * x))
        return np.stack([x, y, z], axis=-1), yaw

    @property
    def duration(self) -> float:
        """Seconds from time 0 until the car has 60 m of street before it."""
        return (LENGTH - 60.0 - self.start[0]) / self.speed if self.speed > 0 else math.inf

    def boxes(self, time: float, *, max_range: float = 80.0) -> tuple[Box, ...]:
        """Return the boxes of cars, people and cyclists within a range, in the LiDAR's frame.

        Parameters
        ----------
        time : float, seconds
            Time on the street's clock.
        max_range : float, metres
            Objects farther away are left out.

        Returns
        -------
        tuple of Box
        """
        position, yaw = self.pose([time])
        cosine, sine = math.cos(yaw[0]), math.sin(yaw[0])
        seen = []
        for box in self.stage.boxes(time):
            dx, dy, dz = (np.asarray(box.center) - position[0]).tolist()
            x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
            if box.label in ROAD_USERS and math.hypot(x, y) < max_range:
                turn = math.remainder(box.yaw - float(yaw[0]), 2.0 * math.pi)
                seen.append(replace(box, center=(x, y, dz), yaw=turn))
        return tuple(seen)


@checked
def street(rng: Rng = 0) -> Street:
    """Make a street of 420 m with houses, parked cars, trees, lamps, people and traffic.

    Parameters
    ----------
    rng : int, numpy.random.Generator or None
        Seed or generator of the street: width, houses, greenery, traffic, speed.

    Returns
    -------
    Street

    Examples
    --------
    >>> from manip3d import simulate
    >>> len(simulate.street(1).boxes(0.0)) > 0
    True
    """
    random = generator_of(rng)
    relief = Relief(random, float(random.uniform(0.01, 0.05)), 30.0)
    builder = WorldBuilder()
    half_road = float(random.uniform(5.2, 7.0))
    pavement = float(random.uniform(1.8, 3.5))
    _ground(builder, random, relief, half_road, pavement)
    garden = float(random.choice([0.0, 3.0, 6.0, 10.0]))
    for side in (1, -1):
        _side(builder, random, relief, side, half_road, pavement, garden)
    speed = float(random.uniform(3.0, 13.0))
    start = (60.0, -1.6)
    movers = _traffic(random, relief, half_road, pavement, start, speed)
    return Street(builder.build(), movers, relief, start, speed, float(random.uniform(0.02, 0.15)))


def _ground(
    builder: WorldBuilder, random: Random, relief: Relief, half_road: float, pavement: float
) -> None:
    """Add the road with markings, curbs, pavements, and the ground beyond."""
    asphalt, paving, grass = textures.asphalt(random), textures.paving(random), textures.grass()
    edge, back = half_road, half_road + pavement
    rise = 0.11
    strips = [(_strip(relief, -edge, edge, 0.0, 1.0), asphalt)]
    for side in (1, -1):
        bands = ((edge, back, paving, 1.0), (back, BORDER, grass, 4.0))
        for near, far, surface, cell in bands:
            low, high = sorted((side * near, side * far))
            strips.append((_strip(relief, low, high, rise, cell), surface))
        x = np.arange(0.0, LENGTH + 1.0, 2.0)
        z = relief(x, side * edge)
        kerb = np.stack([np.stack([x, 0 * x + side * edge, z + h], -1) for h in (0.0, rise)])
        strips.append((sheet(kerb if side < 0 else kerb[::-1], uv_box=(0, 0, LENGTH, rise)), CURB))
    builder.add(strips, Label.GROUND)
    dashes: Parts = []
    for dash in np.arange(0.0, LENGTH - 3.0, 9.0).tolist():
        dashes.append((_strip(relief, -0.06, 0.06, 0.006, 0.12, x=(dash, dash + 3.0)), MARKING))
    for y in (-half_road + 0.25, half_road - 0.37):
        dashes.append((_strip(relief, y, y + 0.12, 0.006, 0.12), MARKING))
    builder.add(dashes, Label.GROUND)


def _strip(
    relief: Relief,
    low: float,
    high: float,
    rise: float,
    cell: float,
    *,
    x: tuple[float, float] = (0.0, LENGTH),
) -> Patch:
    """Make a strip of ground along the street, ``rise`` above the relief."""
    along = np.linspace(*x, max(2, round((x[1] - x[0]) / 2.0) + 1))
    across = np.linspace(low, high, max(2, round((high - low) / cell) + 1))
    gx, gy = np.meshgrid(along, across)
    grid = np.stack([gx, gy, relief(gx, gy) + rise], axis=-1)
    return sheet(grid, uv_box=(x[0], low, x[1], high))


def _side(
    builder: WorldBuilder,
    random: Random,
    relief: Relief,
    side: int,
    half_road: float,
    pavement: float,
    garden: float,
) -> None:
    """Add all objects on one side; ``side``: +1 left, -1 right."""
    yaw = 0.0 if side > 0 else np.pi
    front = side * (half_road + pavement + garden)
    x = 0.0
    while x < LENGTH:
        size = (float(random.uniform(8, 22)), float(random.uniform(8, 14)))
        if random.random() < 0.8:
            _house(builder, random, relief, x, front, size, side)
        else:
            _gap(builder, random, relief, x, front, size, side)
        x += size[0] + (
            float(random.uniform(1.5, 7.0)) if garden and random.random() < 0.7 else 0.0
        )
    parked = float(random.uniform(0.2, 0.85))
    for x in np.arange(4.0, LENGTH, 6.0) + random.uniform(0.0, 2.0):
        if random.random() < parked:
            at = (float(x + random.normal(0, 0.3)), side * (half_road - 1.05))
            heading = (np.pi if side > 0 else 0.0) + float(random.normal(0, 0.02))
            _put(builder, relief, things.car(random), Label.CAR, at, heading, rise=0.0)
    for x in np.arange(8.0, LENGTH, float(random.uniform(18, 32))):
        post = things.lamp_post(random) if random.random() < 0.7 else things.sign(random)
        _put(
            builder, relief, post, Label.POLE, (float(x), side * (half_road + 0.4)), yaw - np.pi / 2
        )
    pitch = float(random.uniform(8.0, 30.0))
    for x in np.arange(12.0, LENGTH, pitch) + random.uniform(0.0, pitch):
        _tree(builder, random, relief, (float(x), side * (half_road + 0.9)))
    if garden:
        for x in np.arange(0.0, LENGTH, 7.0):
            if random.random() < 0.5:
                bush = things.hedge(
                    random, *random.uniform((3.5, 0.5, 0.7), (6.5, 0.9, 1.7)).tolist()
                )
                bush = [(p, textures.leaves(random)) for p, _ in bush]
                at = (float(x), side * (half_road + pavement + 0.6))
                _put(builder, relief, bush, Label.VEGETATION, at)
    for x in random.uniform(20.0, LENGTH - 20.0, 8):
        thing = things.bin_(random) if random.random() < 0.5 else things.bench()
        at = (float(x), side * (half_road + pavement - 0.4))
        _put(builder, relief, thing, Label.FURNITURE, at, yaw)


def _house(
    builder: WorldBuilder,
    random: Random,
    relief: Relief,
    x: float,
    front: float,
    size: tuple[float, float],
    side: int,
) -> None:
    parts = things.building(
        random,
        *size,
        int(random.integers(2, 6)),
        wall=textures.wall(random),
        roof=textures.roof(random),
        window=textures.pane(random),
        gable=bool(random.random() < 0.5),
    )
    z = float(relief(x + size[0] / 2, front)) - 0.15
    corner = (x, front, z) if side > 0 else (x + size[0], front, z)
    builder.add(placed(parts, at=corner, yaw=0.0 if side > 0 else np.pi), Label.BUILDING)


def _gap(
    builder: WorldBuilder,
    random: Random,
    relief: Relief,
    x: float,
    front: float,
    size: tuple[float, float],
    side: int,
) -> None:
    """Add a yard between houses, with trees and possibly a wall."""
    if random.random() < 0.5:
        low = (x, min(front, front + side * 0.25), -0.2)
        high = (x + size[0], max(front, front + side * 0.25), float(random.uniform(1.2, 2.4)))
        wall = things.block(low, high, textures.wall(random))
        builder.add(placed(wall, at=(0, 0, float(relief(x, front)))), Label.WALL)
    for _ in range(3):
        at = (
            x + float(random.uniform(0.2, 0.8)) * size[0],
            front + side * float(random.uniform(3, 15)),
        )
        _tree(builder, random, relief, at)


def _put(
    builder: WorldBuilder,
    relief: Relief,
    parts: Parts,
    label: Label,
    at: tuple[float, float],
    yaw: float = 0.0,
    *,
    rise: float = 0.11,
    more: tuple[tuple[Parts, Label], ...] = (),
) -> None:
    z = float(relief(*at)) + rise - 0.01
    builder.add_object(parts, label, at=(*at, z), yaw=yaw, more=more)


def _tree(builder: WorldBuilder, random: Random, relief: Relief, at: tuple[float, float]) -> None:
    parts = things.tree(random, float(random.uniform(5.0, 10.0)), leaves=700)
    wood = [(patch, textures.bark()) for patch, _ in parts[:-1]]
    crown = [(parts[-1][0], textures.leaves(random))]
    _put(builder, relief, wood, Label.TRUNK, at, more=((crown, Label.VEGETATION),))


# --- Traffic ------------------------------------------------------------------------------------
def _model(parts: Parts, label: Label) -> World:
    """Make a mover's own world with one object, number 0."""
    builder = WorldBuilder()
    builder.add(parts, label, object_id=0)
    return builder.build()


def _traffic(
    random: Random,
    relief: Relief,
    half_road: float,
    pavement: float,
    start: tuple[float, float],
    speed: float,
) -> tuple[Mover, ...]:
    """Make cars ahead, behind and oncoming, cyclists, and people on the pavements."""

    def mover(
        parts: Parts, label: Label, x: float, y: float, yaw: float, pace: float, rise: float = 0.0
    ) -> Mover:
        at = (x, y, float(relief(x, y)) + rise)
        return Mover(_model(parts, label), label, at, yaw, pace)

    movers = []
    ahead = start[0] + float(random.uniform(10.0, 35.0))
    if random.random() < 0.7:
        pace = speed + float(random.normal(0.0, 0.3))
        movers.append(mover(things.car(random), Label.CAR, ahead, start[1], 0.0, pace))
    if random.random() < 0.5:
        behind = start[0] - float(random.uniform(9.0, 25.0))
        movers.append(mover(things.car(random), Label.CAR, behind, start[1], 0.0, speed))
    for x in start[0] + np.cumsum(random.uniform(12.0, 60.0, 6)):
        pace = float(random.uniform(4.0, 13.0))
        movers.append(mover(things.car(random), Label.CAR, float(x), -start[1], np.pi, pace))
    for _ in range(int(random.integers(0, 3)) if half_road > 6.0 else 0):
        x, y = start[0] + float(random.uniform(8.0, 60.0)), -half_road + 2.6
        movers.append(mover(things.cyclist(random), Label.CYCLIST, x, y, 0.0, 4.5))
    for _ in range(int(random.integers(6, 16))):
        x = start[0] + float(random.uniform(-30.0, 200.0))
        side = 1.0 if random.random() < 0.5 else -1.0
        y = side * (half_road + float(random.uniform(1.3, pavement - 0.2)))
        yaw = 0.0 if random.random() < 0.5 else np.pi
        pace = float(random.uniform(0.6, 1.7))
        movers.append(mover(things.person(random), Label.PERSON, x, y, yaw, pace, 0.11))
    return tuple(movers)
