"""World of the simulated sensors: triangles, each with a true label, an object and a surface."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.linear import product
from manip3d._util.texts import counted
from manip3d.lidar import Box
from manip3d.simulate._raycast import RayCaster
from manip3d.simulate._surfaces import Patch, Points


class Label(IntEnum):
    """Kinds of objects that points lie on."""

    GROUND = 0
    BUILDING = 1
    WALL = 2
    VEGETATION = 3
    TRUNK = 4
    CAR = 5
    PERSON = 6
    POLE = 7
    FURNITURE = 8
    CYCLIST = 9

    @property
    def title(self) -> str:
        """Name of the class in boxes: KITTI's name if there is one."""
        return "Pedestrian" if self is Label.PERSON else self.name.capitalize()


@dataclass(frozen=True, eq=False)
class Surface:
    """Optical properties of a surface.

    Attributes
    ----------
    color : (red, green, blue)
        Diffuse colour, 0 to 1.
    reflectance : float
        Reflectance at the laser's wavelength, 0 to 1.
    transmission : float
        Share of laser pulses without a return, because they pass (glass) or are mirrored away.
        Neighbouring pulses are lost together.
    texture : (256, 256) uint8, optional
        Brightness, which is repeated every ``texture_size`` metres; 128: unchanged ``color``.
    texture_size : float, metres
        Period of the texture.
    """

    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    reflectance: float = 0.4
    transmission: float = 0.0
    texture: NDArray[np.uint8] | None = None
    texture_size: float = 1.0


Parts = list[tuple[Patch, Surface]]
"""Patches of an object, each with its surface; x forward, y left, z up."""


@dataclass(frozen=True, eq=False)
class World:
    """A static scene.

    Attributes
    ----------
    vertices : (V, 3) float32, metres
        Vertices.
    faces : (F, 3) int32
        Indices of the vertices of each face.
    texcoords : (F, 3, 2) float32, metres
        Texture coordinates of the corners; divided by the surface's ``texture_size`` they count
        repetitions.
    face_label : (F,) uint8
        `Label` of each face.
    face_object : (F,) int32
        Number of the object; -1: background.
    face_surface : (F,) int32
        Index into ``surfaces``.
    surfaces : tuple of Surface
        All surfaces.
    boxes : tuple of Box
        Boxes of the objects, in the world's frame; ``track`` is the object's number.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    texcoords: NDArray[np.float32]
    face_label: NDArray[np.uint8]
    face_object: NDArray[np.int32]
    face_surface: NDArray[np.int32]
    surfaces: tuple[Surface, ...]
    boxes: tuple[Box, ...]

    def __repr__(self) -> str:
        vertices = counted(len(self.vertices), "vertex", "vertices")
        faces, objects = counted(len(self.faces), "face"), counted(len(self.boxes), "object")
        return f"<manip3d.simulate.scenes.World: {vertices}, {faces}, {objects}>"

    def caster(self) -> RayCaster:
        """Build the search structure for rays."""
        return RayCaster(self.vertices, self.faces)

    @property
    def reflectance(self) -> NDArray[np.float32]:
        """Reflectance of each surface, (S,)."""
        return np.array([s.reflectance for s in self.surfaces], np.float32)

    @property
    def transmission(self) -> NDArray[np.float32]:
        """Transmission of each surface, (S,)."""
        return np.array([s.transmission for s in self.surfaces], np.float32)


@dataclass
class WorldBuilder:
    """Collects parts of a world; `build` joins them."""

    _patches: list[Patch] = field(default_factory=list)
    _labels: list[int] = field(default_factory=list)
    _objects: list[int] = field(default_factory=list)
    _surfaces: dict[Surface, int] = field(default_factory=dict)
    _boxes: list[Box] = field(default_factory=list)
    _count: int = 0

    def add(
        self, parts: Iterable[tuple[Patch, Surface]], label: Label, *, object_id: int = -1
    ) -> None:
        """Add parts of the background, or of the object ``object_id``."""
        for patch, surface in parts:
            index = self._surfaces.setdefault(surface, len(self._surfaces))
            self._patches.append(replace(patch, material=index))
            self._labels.append(int(label))
            self._objects.append(object_id)

    def add_object(
        self,
        parts: Parts,
        label: Label,
        *,
        at: ArrayLike = (0, 0, 0),
        yaw: float = 0.0,
        more: Sequence[tuple[Parts, Label]] = (),
    ) -> int:
        """Add an object and return its number; ``more``: its parts with other labels."""
        number = self._count
        self._count += 1
        for some, their_label in ((parts, label), *more):
            self.add(placed(some, at=at, yaw=yaw), their_label, object_id=number)
        vertices = [p.vertices for some, _ in ((parts, label), *more) for p, _ in some]
        self._boxes.append(box_of(np.concatenate(vertices), label, number, at=at, yaw=yaw))
        return number

    def build(self) -> World:
        """Join everything that was added to one world."""
        patches = self._patches
        starts = np.cumsum([0] + [len(p.vertices) for p in patches])
        sizes = [len(p.faces) for p in patches]
        corners = [
            np.zeros((len(p.faces), 3, 2), np.float32)
            if p.texcoords is None
            else p.texcoords[p.faces]
            for p in patches
        ]
        return World(
            np.concatenate([p.vertices for p in patches]).astype(np.float32),
            np.concatenate(
                [p.faces + s for p, s in zip(patches, starts, strict=False)], dtype=np.int32
            ),
            np.concatenate(corners, dtype=np.float32),
            np.repeat(np.array(self._labels, np.uint8), sizes),
            np.repeat(np.array(self._objects, np.int32), sizes),
            np.repeat(np.array([p.material for p in patches], np.int32), sizes),
            tuple(self._surfaces),
            tuple(self._boxes),
        )


def about_z(yaw: float) -> NDArray[np.float64]:
    """The rotation about z, counter-clockwise, (3, 3)."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def turned(points: Points, yaw: float) -> Points:
    """Points rotated about z, counter-clockwise."""
    return product(points, about_z(-yaw))  # rows times the inverse


def placed(parts: Parts, *, at: ArrayLike = (0, 0, 0), yaw: float = 0.0) -> Parts:
    """Parts rotated about z, then shifted."""
    offset = np.asarray(at, float)
    return [
        (replace(patch, vertices=turned(patch.vertices, yaw) + offset), surface)
        for patch, surface in parts
    ]


def box_of(
    vertices: Points, label: Label, number: int, *, at: ArrayLike = (0, 0, 0), yaw: float = 0.0
) -> Box:
    """The box around vertices in their own axes, after placing them."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = turned((low + high)[None] / 2.0, yaw)[0] + np.asarray(at, float)
    x, y, z = middle.tolist()
    length, width, height = (high - low).tolist()
    return Box((x, y, z), (length, width, height), yaw, label.title, number)
