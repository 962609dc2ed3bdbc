"""White-box attacks: ranges of existing firings are rewritten, on the lattice of the scanner."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import generator_of
from manip3d.errors import InputError
from manip3d.forge._attacks import box_around
from manip3d.forge._truth import Forgery
from manip3d.lidar import Box, LidarFrame, Scan, ScanLike, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Rng

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

MOST_SPOOFED = 200
"""Returns that an attacker with one laser beside the road injects into a turn at most (Sun et al.,
USENIX Security 2020)."""

ROUNDING = 1e-3
"""Radians by which rounding to whole millimetres turns near points."""

FEWEST_LASERS = 8
"""Lasers that answer, at least, at a count of the encoder at which the head fired."""


class Readings(Protocol):
    """Laser and count of the encoder of points (-1: of none), and azimuth in [0, 2 pi)."""

    @property
    def ring(self) -> NDArray[np.int32]: ...
    @property
    def count(self) -> NDArray[np.int32]: ...
    @property
    def azimuth(self) -> NDArray[np.float32]: ...


@runtime_checkable
class FiringLattice(Protocol):
    """What an attacker knows of the scanner: `manip3d.authenticate.SensorLattice` is one."""

    @property
    def steps(self) -> int: ...
    @property
    def range_step(self) -> float: ...
    @property
    def range_phase(self) -> Floats: ...
    @property
    def coordinate_step(self) -> float: ...
    def read(self, points: ArrayLike, *, threads: int = 0) -> Readings: ...
    def points_at(self, ring: ArrayLike, count: ArrayLike, distance: ArrayLike) -> Floats: ...
    def distance(self, points: ArrayLike, ring: ArrayLike) -> Floats: ...


@checked
def lattice_insert(
    scan: ScanLike,
    hoax: LidarFrame | ArrayLike,
    *,
    lattice: FiringLattice,
    turn: float = 0.0,
    most: int | None = None,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Let firings see an object that the scanner measured elsewhere: the white-box attack.

    The object is rotated about the scanner's axis by whole steps of the encoder, so that its rings,
    ranges, noise and intensities stay what the scanner measured. Firings that saw something behind
    it see the object; those that saw something nearer, or nothing, stay as they are.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres, the scanner at the origin.
    hoax : LidarFrame, (K, 3) or (K, 4) float32
        The object as the same scanner saw it: points of this frame (a duplicate) or of another.
    lattice : authenticate.SensorLattice
        Lattice of the scanner, with its encoder.
    turn : float, radians
        Counter-clockwise; it is rounded to whole steps of the encoder.
    most : int, optional
        Returns that are rewritten at most, chosen by chance: 200 is what spoofing reaches that
        injects pulses with one laser (`spoof`).
    rng : int, numpy.random.Generator or None
        Seed, or generator; None: another result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery
        The rewritten points are ``moved``, at their places in the order of the file.

    Raises
    ------
    InputError
        A shape is wrong, the lattice has no encoder, ``most`` is not positive, ``turn`` is more
        than one turn.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, forge
    >>> lattice = authenticate.kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 1000), 1000)  # every fourth step of the encoder
    >>> is_car = (abs(count - 50) < 10) & (ring > 20) & (ring < 40)
    >>> distance = np.where(is_car, 10, 16) + lattice.range_phase[ring]  # before a round wall
    >>> scan = lattice.points_at(ring, 4 * count, distance).round(3).astype(np.float32)
    >>> forged = forge.lattice_insert(scan, scan[is_car], lattice=lattice, turn=1.0)
    >>> len(forged.moved), int(is_car.sum())
    (361, 361)
    """
    _check_encoder(lattice)
    if most is not None and most < 1:
        raise InputError(f"most: expected at least 1, got {most}")
    if not abs(turn) <= 2.0 * math.pi:
        raise InputError(f"turn: expected at most one turn of 2 pi radians, got {turn}")
    random = generator_of(rng)
    scene, thing = to_scan(scan), to_scan(hoax)
    here = lattice.read(scene.points, threads=threads)
    there = lattice.read(thing.points, threads=threads)
    known = np.flatnonzero(there.count >= 0)
    ring, range_ = there.ring[known], lattice.distance(thing.points, there.ring)[known]
    steps = round(turn * lattice.steps / (2.0 * math.pi))
    count = _nearest_fired(np.mod(there.count[known] + steps, lattice.steps), here, lattice.steps)

    # The nearest of the object's points that share a firing is seen.
    key = ring.astype(np.int64) * lattice.steps + count
    order = np.lexsort((range_, key))
    order = order[np.r_[True, np.diff(key[order]) > 0]] if len(order) else order
    rows, found = _rows_of(key[order], here, lattice.steps)
    order = order[found]
    behind = range_[order] < lattice.distance(scene.points[rows], here.ring[rows])
    rows, order = rows[behind], order[behind]
    if most is not None and len(rows) > most:
        chosen = np.sort(random.choice(len(rows), most, replace=False))
        rows, order = rows[chosen], order[chosen]
    intensity = thing.intensity[known[order]] if len(thing.intensity) else None
    return _rewritten(
        "lattice insert" if most is None else "spoof",
        scene,
        lattice,
        rows,
        (ring[order], count[order], range_[order]),
        intensity,
        {"turn": steps * 2.0 * math.pi / lattice.steps, "most": most},
    )


@checked
def spoof(
    scan: ScanLike,
    hoax: LidarFrame | ArrayLike,
    *,
    lattice: FiringLattice,
    turn: float = 0.0,
    most: int = MOST_SPOOFED,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Inject at most 200 returns of an object, as a laser beside the road can.

    Parameters
    ----------
    scan, hoax, lattice, turn, most, rng, threads
        As in `lattice_insert`; the directions of injected returns are the scanner's own.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        As `lattice_insert`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, forge
    >>> lattice = authenticate.kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 1000), 1000)  # every fourth step of the encoder
    >>> is_car = (abs(count - 50) < 10) & (ring > 20) & (ring < 40)
    >>> distance = np.where(is_car, 10, 16) + lattice.range_phase[ring]  # before a round wall
    >>> scan = lattice.points_at(ring, 4 * count, distance).round(3).astype(np.float32)
    >>> forged = forge.spoof(scan, scan[is_car], lattice=lattice, turn=1.0)
    >>> len(forged.moved), int(is_car.sum())
    (200, 361)
    """
    return lattice_insert(
        scan, hoax, lattice=lattice, turn=turn, most=most, rng=rng, threads=threads
    )


@checked
def lattice_remove(
    scan: ScanLike,
    box: Box,
    *,
    lattice: FiringLattice,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Let the firings that saw an object see what stands beside it: the white-box deletion.

    Each laser's ranges are interpolated between both sides of the object, with the noise that the
    laser has there, and take the intensity of a neighbour.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres, the scanner at the origin.
    box : Box
        Around the object, without the ground below it.
    lattice : authenticate.SensorLattice
        Lattice of the scanner, with its encoder.
    rng : int, numpy.random.Generator or None
        Seed, or generator; None: another result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery
        The rewritten points are ``moved``, at their places in the order of the file. Those of
        lasers that see nothing beside the object stay as they are.

    Raises
    ------
    InputError
        A shape is wrong, the lattice has no encoder.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, authenticate, forge
    >>> lattice = authenticate.kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 1000), 1000)  # every fourth step of the encoder
    >>> is_car = (abs(count - 50) < 10) & (ring > 20) & (ring < 40)
    >>> distance = np.where(is_car, 10, 16) + lattice.range_phase[ring]  # before a round wall
    >>> scan = lattice.points_at(ring, 4 * count, distance).round(3).astype(np.float32)
    >>> low, high = scan[is_car].min(axis=0), scan[is_car].max(axis=0)
    >>> box = Box((low + high) / 2, high - low + 0.1)
    >>> forged = forge.lattice_remove(scan, box, lattice=lattice)
    >>> len(forged.moved), round(float(np.linalg.norm(forged.points[forged.moved], axis=1).mean()))
    (361, 16)
    """
    _check_encoder(lattice)
    scene = to_scan(scan)
    random = generator_of(rng)
    reading = lattice.read(scene.points, threads=threads)
    on = reading.count >= 0
    inside = box.contains(scene.points) & on
    rows = np.flatnonzero(inside)
    if not len(rows):
        return _rewritten("lattice remove", scene, lattice, rows, _NOTHING, None, {})
    # Counted from the side opposite to the object, so that its neighbours are next to it.
    start = int(reading.count[rows[len(rows) // 2]]) + lattice.steps // 2
    place = reading.ring.astype(np.int64) * lattice.steps
    place += np.mod(reading.count - start, lattice.steps)
    beside = np.flatnonzero(on & ~inside)
    if not len(beside):
        return _rewritten("lattice remove", scene, lattice, rows[:0], _NOTHING, None, {})
    beside = beside[np.argsort(place[beside], kind="stable")]
    at = np.searchsorted(place[beside], place[rows])
    left, right = beside[(at - 1).clip(min=0)], beside[at.clip(max=len(beside) - 1)]
    ring = reading.ring
    same = (ring[left] == ring[rows]) & (ring[right] == ring[rows])
    rows, left, right = rows[same], left[same], right[same]

    seen = lattice.distance(scene.points, ring)
    span = np.maximum(place[right] - place[left], 1)
    weight = (place[rows] - place[left]) / span
    noise = _noise_of(seen[beside], place[beside])
    range_ = seen[left] * (1.0 - weight) + seen[right] * weight
    range_ += noise * random.standard_normal(len(rows))
    nearer = np.where(random.random(len(rows)) < weight, right, left)
    intensity = scene.intensity[nearer] if len(scene.intensity) else None
    return _rewritten(
        "lattice remove",
        scene,
        lattice,
        rows,
        (ring[rows], reading.count[rows], range_),
        intensity,
        {},
    )


_NOTHING = (np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0))


def _check_encoder(lattice: FiringLattice) -> None:
    if not lattice.steps:
        raise InputError("lattice: expected one with an encoder, got one without steps")


def _nearest_fired(count: NDArray[np.int64], here: Readings, steps: int) -> NDArray[np.int64]:
    """The nearest counts at which the head fired in a scan."""
    votes = np.bincount(here.count[here.count >= 0], minlength=steps)
    fired = np.flatnonzero(votes >= FEWEST_LASERS)
    if not len(fired):
        return count
    around = np.concatenate([fired[-1:] - steps, fired, fired[:1] + steps])
    at = np.searchsorted(around, count).clip(1, len(around) - 1)
    nearest = np.where(count - around[at - 1] <= around[at] - count, around[at - 1], around[at])
    return np.asarray(np.mod(nearest, steps), np.int64)


def _rows_of(keys: NDArray[np.int64], here: Readings, steps: int) -> tuple[Rows, NDArray[np.bool_]]:
    """Rows of a scan that answered at firings, and which of the firings were answered."""
    read = np.flatnonzero(here.count >= 0)
    own = here.ring[read].astype(np.int64) * steps + here.count[read]
    order = np.argsort(own, kind="stable")
    at = np.searchsorted(own[order], keys).clip(max=max(len(own) - 1, 0))
    found = own[order][at] == keys if len(own) else np.zeros(len(keys), np.bool_)
    return read[order[at[found]]] if len(own) else np.empty(0, np.intp), found


def _noise_of(seen: Floats, place: NDArray[np.int64]) -> float:
    """Standard deviation of ranges from shot to shot, from differences of second order."""
    near = (np.diff(place)[1:] <= 4) & (np.diff(place)[:-1] <= 4)
    bend = np.abs(np.diff(seen, 2))[near]
    return float(1.4826 * np.median(bend) / math.sqrt(6.0)) if len(bend) else 0.0


def _rewritten(
    attack: str,
    scene: Scan,
    lattice: FiringLattice,
    rows: Rows,
    firings: tuple[NDArray[Any], NDArray[Any], Floats],
    intensity: NDArray[np.float32] | None,
    parameters: Mapping[str, Any],
) -> Forgery:
    """The scan whose rows are seen by firings (ring, count, range along the beam)."""
    ring, count, range_ = firings
    if lattice.range_step:
        phase = lattice.range_phase[ring]
        range_ = phase + np.round((range_ - phase) / lattice.range_step) * lattice.range_step
    values = lattice.points_at(ring, count, range_)
    if lattice.coordinate_step:
        # Divided by a whole number, the quotient is the float that the scanner's files have.
        per_metre = round(1.0 / lattice.coordinate_step)
        values = np.round(values * per_metre) / per_metre
    written = values.astype(np.float32)
    changed = (written != scene.points[rows]).any(axis=1)
    rows = rows[changed]
    points = scene.points.copy()
    points[rows] = written[changed]
    brightness = scene.intensity.copy() if len(scene.intensity) else None
    if brightness is not None and intensity is not None:
        brightness[rows] = intensity[changed]
    order = _in_file_order(points, rows, lattice)
    moved = np.flatnonzero(np.isin(order, rows)).astype(np.int32)
    none = np.empty(0, np.int32)
    return Forgery(
        points[order],
        None if brightness is None else brightness[order],
        none,
        moved,
        order[moved].astype(np.int32),
        none.copy(),
        box_around(points[rows]) if len(rows) else Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        np.eye(4),
        attack,
        ReadOnlyMapping(parameters),
        scene.frame,
    )


def _in_file_order(points: NDArray[np.float32], rows: Rows, lattice: FiringLattice) -> Rows:
    """Rows in the order in which the scanner's file has them: ring after ring, each by azimuth.

    Another range is another azimuth, because beams pass beside the axis. The other points keep
    their order; where they are in another one, so do all.
    """
    reading = lattice.read(points)
    place = reading.ring * 8.0 + reading.azimuth  # azimuths are below 8
    others = np.delete(np.arange(len(points)), rows)
    before = np.maximum.accumulate(place[others]) if len(others) else place[others]
    if np.count_nonzero(place[others] + ROUNDING < before) > 0.01 * len(others):
        return np.arange(len(points))
    edited = rows[np.argsort(place[rows], kind="stable")]
    at = np.searchsorted(before, place[edited], side="right")
    return np.insert(others, at, edited)
