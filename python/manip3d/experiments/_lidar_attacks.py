"""Attacks on frames of a spinning LiDAR whose results have the scanner's order and rounding."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from manip3d import forge
from manip3d.authenticate import SensorLattice
from manip3d.lidar import Box
from manip3d.simulate._world import about_z

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Points = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Target:
    """Input of the attacks on one frame.

    Attributes
    ----------
    scan : (N, 3) float32
        The clean frame.
    box : Box
        Box of the object that is removed, moved or deformed.
    hoax : (K, 3) float32
        Points of an object from another drive.
    distance, azimuth : float
        Wanted horizontal distance, metres, and azimuth, radians, of the hoax.
    lattice : SensorLattice
        Lattice of the scanner.
    seed : int
        Seed of random attacks.
    """

    scan: Points
    box: Box
    hoax: Points
    distance: float
    azimuth: float
    lattice: SensorLattice
    seed: int

    @property
    def at_distance(self) -> Points:
        """Return the hoax, turned about the scanner and moved radially to its wanted place.

        Its height is unchanged, and the same side faces the scanner.
        """
        center = self.hoax.mean(axis=0, dtype=np.float64)
        turn = self.azimuth - math.atan2(center[1], center[0])
        turned = self.hoax.astype(np.float64) @ about_z(-turn)  # rows times the inverse
        away = self.distance - math.hypot(center[0], center[1])
        turned += away * np.array([math.cos(self.azimuth), math.sin(self.azimuth), 0.0])
        return np.ascontiguousarray(turned, np.float32)

    @property
    def position(self) -> NDArray[np.float64]:
        """Wanted position of the hoax's centroid."""
        return np.asarray(self.at_distance.mean(axis=0, dtype=np.float64))


def as_written(points: Points, lattice: SensorLattice) -> Points:
    """Round to whole millimetres and sort by ring, then azimuth, as in KITTI's files."""
    step = 1.0 / lattice.coordinate_step if lattice.coordinate_step else 1e6
    rounded = np.ascontiguousarray(np.round(points.astype(np.float64) * step) / step, np.float32)
    reading = lattice.read(rounded)
    exact = np.mod(np.arctan2(rounded[:, 1], rounded[:, 0], dtype=np.float64), 2.0 * math.pi)
    return rounded[np.lexsort((exact, reading.ring))]


def _ring_lines(target: Target) -> forge.Lattice:
    lattice = target.lattice
    return forge.Lattice(
        np.column_stack([lattice.slope, lattice.offset]),
        2.0 * math.pi / lattice.steps,
        float(lattice.azimuth[0]),
    )


def _ctp(target: Target) -> forge.Forgery:
    return forge.ctp(target.scan, target.at_distance, position=target.position)


def _crtp(target: Target) -> forge.Forgery:
    return forge.crtp(
        target.scan,
        target.at_distance,
        position=target.position,
        spacing=_spacing_of_ground(target),
        rng=target.seed,
    )


def _spacing_of_ground(target: Target) -> float:
    """Return the mean nearest-neighbour distance of points within 1 m of the foot of the hoax."""
    foot = target.position
    foot[2] = float(target.at_distance[:, 2].min())
    near = target.scan[np.linalg.norm(target.scan - foot, axis=1) < 1.0].astype(np.float64)
    if len(near) < 2:  # in a gap of the scan, use the scanner's angular step of 0.2 degrees
        return target.distance * math.radians(0.2)
    apart = np.linalg.norm(near[:, None] - near[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min(axis=1).mean())


def _occluding(target: Target) -> forge.Forgery:
    return forge.insert_occluding(
        target.scan, target.at_distance, position=target.position, range_noise=0.01, rng=target.seed
    )


def _occluding_on_rings(target: Target) -> forge.Forgery:
    return forge.insert_occluding(
        target.scan,
        target.at_distance,
        position=target.position,
        range_noise=0.01,
        lattice=_ring_lines(target),
        rng=target.seed,
    )


def _additive(target: Target) -> forge.Forgery:
    return forge.additive(target.scan, target.at_distance, allow_collision=True)


def _both(target: Target) -> forge.Forgery:
    return forge.additive_subtractive(
        target.scan, target.at_distance, target.box, allow_collision=True
    )


def _replacement(target: Target) -> forge.Forgery:
    return forge.replacement(target.scan, target.hoax, target.box, allow_collision=True)


def _translation(target: Target) -> forge.Forgery:
    return forge.translation(target.scan, target.box, allow_collision=True)


def _rotation(target: Target) -> forge.Forgery:
    return forge.rotation(target.scan, target.box, allow_collision=True)


def _subtractive(target: Target) -> forge.Forgery:
    return forge.subtractive(target.scan, target.box)


def _random(target: Target) -> forge.Forgery:
    return forge.deform(target.scan, target.box, amplitude=0.1, rng=target.seed)


def _dent(target: Target) -> forge.Forgery:
    return forge.deform(target.scan, target.box, amplitude=0.2, direction="normal")


def _snapped(attack: Callable[[Target], forge.Forgery], along: str) -> Callable[[Target], Points]:
    def run(target: Target) -> Points:
        forgery = attack(target)
        if along == "ray":
            return forge.snap_to_lattice(forgery, _ring_lines(target), along="ray").points
        return forge.snap_to_lattice(forgery, _ring_lines(target)).points

    return run


def _on_firings(
    attack: Callable[[Target], forge.Forgery], *, whole_ranges: bool
) -> Callable[[Target], Points]:
    """Return an attack whose changed points lie where a scanner with this lattice could see them.

    Each firing keeps its nearest changed point and hides the points behind.
    """

    def run(target: Target) -> Points:
        forgery, lattice = attack(target), target.lattice
        touched = forgery.label > 0
        pasted, rest = forgery.points[touched], forgery.points[~touched]
        reading, others = lattice.read(pasted), lattice.read(rest)
        fired = np.unique(others.count[others.count >= 0])
        seen = reading.ring >= 0
        ring = reading.ring[seen]
        count = fired[np.searchsorted(fired, reading.count[seen]).clip(0, len(fired) - 1)]
        distance = lattice.distance(pasted[seen], ring)
        if whole_ranges:
            phase = lattice.range_phase[ring]
            distance = phase + lattice.range_step * np.round(
                (distance - phase) / lattice.range_step
            )
        beam = ring.astype(np.int64) * lattice.steps + count
        order = np.lexsort((distance, beam))
        first = order[np.r_[True, np.diff(beam[order]) != 0][: len(order)]]
        hidden = np.isin(others.ring.astype(np.int64) * lattice.steps + others.count, beam)
        answers = lattice.points_at(ring[first], count[first], distance[first])
        return np.vstack([rest[~hidden], answers.astype(np.float32)])

    return run


def _points(attack: Callable[[Target], forge.Forgery]) -> Callable[[Target], Points]:
    return lambda target: attack(target).points


ADDING: Mapping[str, Callable[[Target], Points]] = MappingProxyType(
    {
        "CTP": _points(_ctp),
        "CRTP": _points(_crtp),
        "occlusion-aware": _points(_occluding),
        "occlusion-aware, rings": _points(_occluding_on_rings),
        "additive": _points(_additive),
        "both": _points(_both),
        "replacement": _points(_replacement),
        "translation": _points(_translation),
        "rotation": _points(_rotation),
    }
)
"""Attacks that add or move points."""

OTHERS: Mapping[str, Callable[[Target], Points]] = MappingProxyType(
    {
        "subtractive": _points(_subtractive),
        "deforming, random": _points(_random),
        "deforming, dent": _points(_dent),
        "CTP snapped in height": _snapped(_ctp, "height"),
        "CTP snapped on the ray": _snapped(_ctp, "ray"),
        "translation snapped": _snapped(_translation, "ray"),
        "occlusion on firings": _on_firings(_ctp, whole_ranges=False),
        "translation on firings": _on_firings(_translation, whole_ranges=False),
        "occlusion on firings, ranges": _on_firings(_ctp, whole_ranges=True),
        "translation on firings, ranges": _on_firings(_translation, whole_ranges=True),
    }
)
"""Attacks that remove or deform, then attacks that fit the scanner's lattice more and more
closely: heights or rays of rings, firings, and firings with whole range steps."""

appended = ADDING["CTP"]
"""Attack that appends the points of the hoax, at its wanted place, to the scan."""

on_firings = OTHERS["occlusion on firings, ranges"]
"""Attack that inserts the hoax as the scanner's firings would see it, with whole range steps."""
