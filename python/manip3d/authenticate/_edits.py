"""Edits of objects in LiDAR scans that are planted to measure the power of the detectors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._lattice import SensorLattice
from manip3d.errors import InputError
from manip3d.lidar import Box

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.forge import Forgery

    Points = NDArray[np.float32]
    Cloud = NDArray[np.float32]  # x, y, z and, if it was measured, reflectance
    Rows = NDArray[np.int64]
    Edit = Callable[[Cloud, Rows, SensorLattice, np.random.Generator], Cloud]


def _rounded(points: NDArray[np.float64], lattice: SensorLattice) -> Points:
    """Round to the steps of the coordinates in the scanner's files, if these have any."""
    if lattice.coordinate_step:  # else rounding would give the edit away
        a_metre = 1.0 / lattice.coordinate_step
        points = np.round(points * a_metre) / a_metre
    return np.ascontiguousarray(points, np.float32)


def xyz(cloud: Cloud) -> Points:
    """Return the coordinates of the points."""
    return np.ascontiguousarray(cloud[:, :3])


def _written(cloud: Cloud, lattice: SensorLattice) -> Cloud:
    """Sort points ring by ring and by azimuth, as an attacker who knows the format does."""
    reading = lattice.read(xyz(cloud))
    return cloud[np.lexsort((reading.azimuth, reading.ring))]


def _turned(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    cos, sin = math.cos(angle), math.sin(angle)
    x = cos * points[:, 0] - sin * points[:, 1]
    y = sin * points[:, 0] + cos * points[:, 1]
    return np.column_stack([x, y, points[:, 2]])


def _with(cloud: Cloud, rows: Rows, places: NDArray[np.float64], lattice: SensorLattice) -> Cloud:
    edited = cloud.copy()
    edited[rows, :3] = _rounded(places, lattice)
    return edited


def _added(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Paste a copy of the object, turned about the scanner by 1 to 5 radians."""
    pasted = cloud[rows]
    turned = _turned(pasted[:, :3].astype(np.float64), rng.uniform(1.0, 5.0))
    pasted[:, :3] = _rounded(turned, lattice)
    return _written(np.concatenate([cloud, pasted]), lattice)


def _moved(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Move the object by 0.5 to 3 m along the ground."""
    angle, length = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.5, 3.0)
    shift = length * np.array([math.cos(angle), math.sin(angle), 0.0])
    return _written(_with(cloud, rows, cloud[rows, :3] + shift, lattice), lattice)


def _rotated(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Rotate the object about its own centre by 5 to 30 degrees."""
    center = cloud[rows, :3].mean(axis=0, dtype=np.float64)
    angle = math.radians(rng.uniform(5.0, 30.0)) * rng.choice([-1.0, 1.0])
    turned = _turned(cloud[rows, :3] - center, angle) + center
    return _written(_with(cloud, rows, turned, lattice), lattice)


def _resampled(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Replace the object's points by points between pairs of them."""
    first, second = cloud[rows, :3], cloud[rng.permutation(rows), :3]
    weight = rng.uniform(0.2, 0.8, (len(rows), 1))
    return _written(_with(cloud, rows, first * weight + second * (1.0 - weight), lattice), lattice)


def _copied(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Paste a copy of the object, turned about the scanner by 1 to 5 radians in whole steps."""
    pasted = cloud[rows]
    pasted[:, :3] = _turned_by_steps(pasted, lattice, rng)
    return _written(np.concatenate([cloud, pasted]), lattice)


def _swung(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Turn the object itself about the scanner by 1 to 5 radians in whole steps."""
    turned = _turned_by_steps(cloud[rows], lattice, rng).astype(np.float64)
    return _written(_with(cloud, rows, turned, lattice), lattice)


def _turned_by_steps(object_: Cloud, lattice: SensorLattice, rng: np.random.Generator) -> Points:
    """Points of the object, turned about the scanner by whole steps, or degrees without steps."""
    steps = lattice.steps or 360
    angle = round(rng.uniform(1.0, 5.0) * steps / (2.0 * math.pi)) * 2.0 * math.pi / steps
    return _rounded(_turned(object_[:, :3].astype(np.float64), angle), lattice)


def _removed(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    return np.delete(cloud, rows, axis=0)


def _along_rays(
    cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator
) -> Cloud:
    """Move the object by 10 cm along the rays, nearer to the scanner or farther from it."""
    far = cloud[rows, :3].astype(np.float64)
    distance = np.sqrt((far * far).sum(axis=1, keepdims=True))
    shift = 0.1 * rng.choice([-1.0, 1.0])
    return _with(cloud, rows, far * (1.0 + shift / distance), lattice)


def _bump(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Add a smooth bump to the object, 5 cm towards the scanner and half a metre wide."""
    far = cloud[rows, :3].astype(np.float64)
    distance = np.sqrt((far * far).sum(axis=1, keepdims=True))
    apart = far - far[rng.integers(len(far))]
    height = 0.05 * np.exp(-(apart * apart).sum(axis=1, keepdims=True) / (2.0 * 0.25**2))
    return _with(cloud, rows, far * (1.0 - height / distance), lattice)


def _few_points(
    cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator
) -> Cloud:
    """Move five points of the object by up to 0.5 m along each axis."""
    some = np.sort(rng.choice(rows, 5, replace=False))
    places = cloud[some, :3] + rng.uniform(-0.5, 0.5, (5, 3))
    return _written(_with(cloud, some, places, lattice), lattice)


def _box_of(points: Points, rows: Rows) -> Box:
    low, high = points[rows].min(axis=0), points[rows].max(axis=0)
    center, size = (low + high) / 2.0, high - low + 0.04
    x, y, z = (float(value) for value in center)
    length, width, height = (float(value) for value in size)
    return Box((x, y, z), (length, width, height))


def _cloud_of(forgery: Forgery) -> Cloud:
    if forgery.intensity is None:
        return forgery.points
    return np.column_stack([forgery.points, forgery.intensity])


def _overwritten(
    cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator
) -> Cloud:
    """Rewrite the object's firings to ranges of its surroundings (white-box)."""
    from manip3d import forge

    box = _box_of(cloud[:, :3], rows)
    try:
        forged = forge.lattice_remove(cloud, box, lattice=lattice, rng=rng)
    except InputError:
        return cloud  # no laser sees both sides of the object
    return _cloud_of(forged)


def _duplicated(
    cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator
) -> Cloud:
    """Rewrite firings elsewhere to ranges of the object, on the lattice (white-box)."""
    from manip3d import forge

    turn = float(rng.uniform(0.5, 5.5))
    try:
        forged = forge.lattice_insert(cloud, cloud[rows], lattice=lattice, turn=turn, rng=rng)
    except InputError:
        return cloud  # all of the object would be hidden there
    return _cloud_of(forged)


def _spoofed(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Insert at most 200 returns of the object elsewhere, on the lattice."""
    from manip3d import forge

    turn = float(rng.uniform(0.5, 5.5))
    try:
        forged = forge.spoof(cloud, cloud[rows], lattice=lattice, turn=turn, rng=rng)
    except InputError:
        return cloud  # all of the object would be hidden there
    return _cloud_of(forged)


def _shining(cloud: Cloud, rows: Rows, values: NDArray[np.float64]) -> Cloud:
    """Give the object other reflectances, in the scanner's hundredths."""
    edited = cloud.copy()
    edited[rows, 3] = np.round(np.clip(values, 0.0, 0.99), 2)
    return edited


def _painted(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Give the whole object one reflectance."""
    return _shining(cloud, rows, np.full(len(rows), rng.uniform(0.1, 0.9)))


def _scaled(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Multiply the object's reflectances by 0.5 or 1.5."""
    return _shining(cloud, rows, cloud[rows, 3] * rng.choice([0.5, 1.5]))


def _shifted(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Add 0.2 to the object's reflectances, or subtract it."""
    return _shining(cloud, rows, cloud[rows, 3] + rng.choice([-0.2, 0.2]))


def _exchanged(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Permute the reflectances of the object."""
    return _shining(cloud, rows, cloud[rng.permutation(rows), 3].astype(np.float64))


def _borrowed(cloud: Cloud, rows: Rows, lattice: SensorLattice, rng: np.random.Generator) -> Cloud:
    """Give the object the reflectances of other rows of the file."""
    shift = int(rng.integers(len(cloud) // 4, 3 * len(cloud) // 4))
    return _shining(cloud, rows, cloud[(rows + shift) % len(cloud), 3].astype(np.float64))


WHITE_BOX: Mapping[str, Edit] = MappingProxyType(
    {
        "white-box removed": _overwritten,
        "white-box added": _duplicated,
        "spoofed": _spoofed,
    }
)
"""Edits by an attacker who rewrites ranges of existing firings; the lattice needs an encoder."""

REFLECTANCE_EDITS: Mapping[str, Edit] = MappingProxyType(
    {
        "reflectance: one value": _painted,
        "reflectance: scaled": _scaled,
        "reflectance: shifted": _shifted,
        "reflectance: exchanged": _exchanged,
        "reflectance: from elsewhere": _borrowed,
    }
)
"""Edits of the reflectances alone; frames need reflectances that detector V can judge."""

TURNS_BY_STEPS: Mapping[str, Edit] = MappingProxyType(
    {
        "copied on steps": _copied,
        "turned on steps": _swung,
    }
)
"""Edits that leave points on an exact lattice; they are planted in exact clouds only."""

EDITS: Mapping[str, Edit] = MappingProxyType(
    {
        "added": _added,
        "moved": _moved,
        "rotated": _rotated,
        "resampled": _resampled,
        "removed": _removed,
        "along rays": _along_rays,
        "bump": _bump,
        "five points": _few_points,
        **WHITE_BOX,
        **REFLECTANCE_EDITS,
        **TURNS_BY_STEPS,
    }
)
"""Classes of edits that can be planted. Edited points are in the scanner's order, and in the steps
of its coordinates if these have any: an edit that is rounded among exact points is no test."""

EDIT_MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "added": "a copy of an object, turned about the scanner",
        "moved": "an object shifted by 0.5 to 3 m on the ground",
        "rotated": "an object turned about its own centre by 5 to 30 degrees",
        "resampled": "an object's points replaced by others between them",
        "removed": "an object's points left out",
        "along rays": "an object 10 cm nearer to the scanner or farther from it",
        "bump": "a bump of 5 cm on an object, half a metre wide",
        "five points": "five points of an object moved by up to 0.5 m along each axis",
        "white-box removed": "an object's firings rewritten to see what stands beside it",
        "white-box added": "firings rewritten on the scanner's lattice to see an object",
        "spoofed": "at most 200 firings rewritten on the lattice to see an object",
        "reflectance: one value": "an object in one reflectance",
        "reflectance: scaled": "an object's reflectances times 0.5 or 1.5",
        "reflectance: shifted": "an object's reflectances plus or minus 0.2",
        "reflectance: exchanged": "an object's reflectances in another order",
        "reflectance: from elsewhere": "an object with the reflectances of another place",
        "copied on steps": "a copy of an object, turned about the scanner by whole steps",
        "turned on steps": "an object turned about the scanner by whole steps of azimuth",
    }
)
"""Description of each class of edits, for reports."""
