"""A static world with moving objects; rays are cast at each moving object in its own frame."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manip3d._util.linear import product
from manip3d.lidar import Box
from manip3d.simulate._raycast import NO_FACE
from manip3d.simulate._shading import Shader
from manip3d.simulate._world import Label, Surface, World, about_z, box_of

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Mover:
    """An object that moves straight ahead at constant speed.

    Attributes
    ----------
    model : World
        The object in its own frame: origin at the middle of its bottom, x forward.
    label : Label
        Kind of the object.
    start : (x, y, z), metres
        Position at time 0.
    yaw : float, radians
        Direction of motion, counter-clockwise from the world's x axis.
    speed : float, metres per second
        Speed along its x axis.
    """

    model: World
    label: Label
    start: tuple[float, float, float]
    yaw: float
    speed: float

    def __repr__(self) -> str:
        return f"<manip3d.simulate.streets.Mover: {self.label.title}, {self.speed:.1f} m/s>"

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocity in the world's frame, (3,), metres per second."""
        return self.speed * np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])

    def box(self, number: int, time: float) -> Box:
        """Return the object's box at a time, with ``number`` as its track."""
        at = np.asarray(self.start) + self.velocity * time
        return box_of(self.model.vertices.astype(float), self.label, number, at=at, yaw=self.yaw)


@dataclass
class StageHits:
    """First points at which rays meet the stage.

    Attributes
    ----------
    distance : (N,) float32
        Distance along the ray, metres; infinite: no hit.
    face : (N,) int64
        Index into the stage's tables of faces; undefined without a hit.
    normal : (N, 3) float32
        Unit normal in the world's frame.
    uv : (N, 2) float32
        Barycentric weights of the second and the third corner.
    object : (N,) int32
        Number of the object; -1: background or no hit.
    """

    distance: Floats
    face: NDArray[np.int64]
    normal: Floats
    uv: Floats
    object: NDArray[np.int32]


class Stage:
    """A static world with moving objects, ready for ray casting.

    Parameters
    ----------
    world : World
        The static world.
    movers : sequence of Mover
        Moving objects; those with the same model share its search structure.
    """

    def __init__(self, world: World, movers: Sequence[Mover] = ()) -> None:
        self.world = world
        self.movers = tuple(movers)
        models = {id(mover.model): mover.model for mover in movers}
        worlds = [world, *models.values()]
        first = np.cumsum([0] + [len(w.faces) for w in worlds]).tolist()
        base = np.cumsum([0] + [len(w.surfaces) for w in worlds]).tolist()
        self._first_face = dict(zip(models, first[1:], strict=False))
        self._caster = world.caster()
        self._casters = {key: model.caster() for key, model in models.items()}
        self.surfaces: tuple[Surface, ...] = tuple(s for w in worlds for s in w.surfaces)
        self.reflectance = np.array([s.reflectance for s in self.surfaces], np.float32)
        self.transmission = np.array([s.transmission for s in self.surfaces], np.float32)
        self.face_label = np.concatenate([w.face_label for w in worlds])
        self.face_surface = np.concatenate(
            [w.face_surface + start for w, start in zip(worlds, base, strict=False)]
        )
        self.texcoords = np.concatenate([w.texcoords for w in worlds])
        self._face_object = np.concatenate([w.face_object for w in worlds])
        self._first_mover = int(world.face_object.max(initial=-1)) + 1

    @functools.cached_property
    def shader(self) -> Shader:
        """Shader for the colours of hits; it is built once."""
        return Shader(self.surfaces, self.face_surface, self.texcoords)

    def boxes(self, time: float) -> tuple[Box, ...]:
        """Return the boxes of all objects at a time, in the world's frame."""
        moving = [mover.box(self._first_mover + i, time) for i, mover in enumerate(self.movers)]
        return (*self.world.boxes, *moving)

    def cast(
        self,
        origins: Floats,
        directions: Floats,
        times: Floats | float,
        *,
        subsets: Sequence[NDArray[np.int64]] | None = None,
        threads: int = 0,
    ) -> StageHits:
        """Return the first hits of N rays, each at its own time.

        Parameters
        ----------
        origins : (N, 3) or (3,) float32
            Origins of the rays, metres.
        directions : (N, 3) float32
            Directions of unit length.
        times : (N,) float32 or float, seconds
            Time of each ray.
        subsets : sequence of (K,) int64, optional
            Indices of the rays that may meet each mover; default: found from bounding spheres.
        threads : int
            0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
        """
        static = self._caster.cast(origins, directions, threads=threads)
        face = static.face.astype(np.int64)
        missed = static.face == NO_FACE
        face[missed] = 0
        number = self._face_object[face]
        number[missed] = -1
        hits = StageHits(static.distance, face, static.normal, static.uv, number)
        for index, mover in enumerate(self.movers):
            rays = (
                self._rays_near(mover, origins, directions, times)
                if subsets is None
                else subsets[index]
            )
            if rays.size:
                self._merge(hits, index, rays, origins, directions, times, threads)
        return hits

    @staticmethod
    def _rays_near(
        mover: Mover, origins: Floats, directions: Floats, times: Floats | float
    ) -> NDArray[np.int64]:
        """Indices of the rays that meet the mover's bounding sphere."""
        low, high = mover.model.vertices.min(axis=0), mover.model.vertices.max(axis=0)
        radius = 0.5 * float(np.linalg.norm(high - low, axis=-1)) + 0.1
        center = np.array(mover.start) + np.array([0.0, 0.0, 0.5 * (low[2] + high[2])])
        off = center.astype(np.float32) + _moved(mover, times) - origins
        along = np.einsum("ij,ij->i", off, directions)
        aside = np.einsum("ij,ij->i", off, off) - along * along
        return np.flatnonzero((along > -radius) & (aside < radius * radius))

    def _merge(
        self,
        hits: StageHits,
        index: int,
        rays: NDArray[np.int64],
        origins: Floats,
        directions: Floats,
        times: Floats | float,
        threads: int,
    ) -> None:
        """Replace hits by those of one mover that are nearer."""
        mover = self.movers[index]
        to_mover = about_z(mover.yaw).astype(np.float32)  # rows times the inverse
        origin = origins if origins.ndim == 1 else origins[rays]
        moment = times[rays] if isinstance(times, np.ndarray) else times
        shift = np.array(mover.start, np.float32) + _moved(mover, moment)
        key = id(mover.model)
        found = self._casters[key].cast(
            product(origin - shift, to_mover),
            product(directions[rays], to_mover),
            threads=threads,
        )
        nearer = found.distance < hits.distance[rays]
        mine = rays[nearer]
        hits.distance[mine] = found.distance[nearer]
        hits.face[mine] = found.face[nearer].astype(np.int64) + self._first_face[key]
        hits.normal[mine] = product(found.normal[nearer], to_mover.T)
        hits.uv[mine] = found.uv[nearer]
        hits.object[mine] = self._first_mover + index


def _moved(mover: Mover, times: Floats | float) -> Floats:
    """Displacement of a mover since time 0, (N, 3) or (1, 3), metres."""
    return np.atleast_1d(np.asarray(times, np.float32))[:, None] * mover.velocity.astype(np.float32)
