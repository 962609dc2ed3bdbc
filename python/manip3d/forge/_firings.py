"""White-box attacks that rewrite ranges of existing firings, on the lattice of the scanner."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import generator_of
from manip3d._util.robust import NORMAL_MAD
from manip3d.errors import InputError
from manip3d.forge._attacks import box_around
from manip3d.forge._truth import Forgery
from manip3d.lidar import Box, LidarFrame, Scan, ScanLike, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Rng

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

MAX_SPOOFED = 200
"""Largest number of returns that an attacker with one laser beside the road can inject into a turn
(Sun et al., USENIX Security 2020)."""

ROUNDING = 1e-3
"""Radians: largest change of azimuth by rounding to whole millimetres, for near points."""

MIN_LASERS = 8
"""Fewest lasers with a return at an encoder count at which the scanner fired."""


class Readings(Protocol):
    """Laser and encoder count of points (-1: none), and azimuth in [0, 2 pi)."""

    @property
    def ring(self) -> NDArray[np.int32]: ...
    @property
    def count(self) -> NDArray[np.int32]: ...
    @property
    def azimuth(self) -> NDArray[np.float32]: ...


@runtime_checkable
class FiringLattice(Protocol):
    """An attacker's knowledge of the scanner, such as a `SensorLattice`."""

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
    """Insert an object by rewriting the ranges of existing returns: the white-box attack.

    The attacker knows the scanner's lattice: the directions in which its lasers fire. The inserted
    object (the hoax) was measured by the same scanner; it is rotated about the scanner's axis by
    whole steps of the encoder, so that each of its points keeps its laser, range, noise and
    intensity. A return of the scan is replaced by the hoax's point in the same direction if that
    point is nearer to the scanner. Returns in front of the hoax stay, and directions without a
    return stay without one.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres, z up, the scanner at the origin.
    hoax : LidarFrame, (K, 3) or (K, 4) float32
        Points of the inserted object in the frame of the scanner that measured them: from this
        scan (a duplicate) or from another scan of the same scanner.
    lattice : authenticate.SensorLattice
        Lattice of the scanner, with its encoder.
    turn : float, radians
        Angle by which the hoax is rotated, counter-clockwise seen from above, at most one turn
        either way; it is rounded to whole steps of the encoder.
    most : int, optional
        Largest number of returns that are rewritten, chosen at random; None: all. A real attacker
        with one laser reaches 200 (`spoof`).
    rng : int, numpy.random.Generator or None
        Seed or generator for that choice; None: a different result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery
        The rewritten points are in ``moved``. They are sorted to where the scanner would have
        written them in its file.

    Raises
    ------
    InputError
        A shape is wrong, the lattice has no encoder, ``most`` is not positive, ``turn`` is more
        than one turn, or no point would change: no point of the hoax is nearer than what the scan
        sees in its direction.

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
    scene_reading = lattice.read(scene.points, threads=threads)
    steps = round(turn * lattice.steps / (2.0 * math.pi))
    hoax_rows, firings = _turned_firings(thing, steps, scene_reading, lattice, threads)
    rows, seen = _hidden_rows(scene, scene_reading, firings, lattice)
    if most is not None and len(rows) > most:
        chosen = np.sort(random.choice(len(rows), most, replace=False))
        rows, seen = rows[chosen], seen[chosen]
    forged = _rewritten(
        "lattice insert" if most is None else "spoof",
        scene,
        lattice,
        rows,
        firings.select(seen),
        thing.intensity[hoax_rows[seen]] if len(thing.intensity) else None,
        {"turn": steps * 2.0 * math.pi / lattice.steps, "most": most},
    )
    if not forged.num_touched:
        raise InputError("hoax: expected points in front of the scan's, but no point would change")
    return forged


@checked
def spoof(
    scan: ScanLike,
    hoax: LidarFrame | ArrayLike,
    *,
    lattice: FiringLattice,
    turn: float = 0.0,
    most: int = MAX_SPOOFED,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Insert at most 200 points of an object, as an attacker with one laser at the roadside can.

    The attacker's laser pulses reach the scanner as if they were its own returns, so that the
    injected points have directions of the scanner.

    Parameters
    ----------
    scan, hoax, lattice, turn, rng, threads
        Same as for `lattice_insert`.
    most : int
        Largest number of injected points (Sun et al., USENIX Security 2020, reach 200).

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
    """Delete an object by rewriting the ranges of its returns: the white-box deletion.

    For each laser, the ranges of the object's returns are interpolated between the returns at both
    sides of the object, with the noise of the ranges there. The intensity is that of one of the two
    sides, chosen at random.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres, z up, the scanner at the origin.
    box : Box
        Box around the object, without the ground below it.
    lattice : authenticate.SensorLattice
        Lattice of the scanner, with its encoder.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery
        The rewritten points are in ``moved``, sorted to where the scanner would have written them.
        Returns of lasers without a return on both sides of the object remain unchanged.

    Raises
    ------
    InputError
        A shape is wrong, the lattice has no encoder, no point of the scan on the lattice is in the
        box, or no point would change: no laser has a return on both sides of the object.

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
    is_read = reading.count >= 0
    inside = box.contains(scene.points) & is_read
    rows, beside = np.flatnonzero(inside), np.flatnonzero(is_read & ~inside)
    if not len(rows):
        raise InputError("box: expected scene points on the lattice in it, got none")
    if not len(beside):
        raise InputError(_NOTHING_BESIDE)
    # Counts begin opposite to the object, so that they do not wrap around beside it.
    start = int(reading.count[rows[len(rows) // 2]]) + lattice.steps // 2
    place = reading.ring.astype(np.int64) * lattice.steps
    place += np.mod(reading.count - start, lattice.steps)
    beside = beside[np.argsort(place[beside], kind="stable")]
    rows, left, right = _neighbours_on_ring(rows, beside, place, reading.ring)

    distance = lattice.distance(scene.points, reading.ring)
    weight = (place[rows] - place[left]) / np.maximum(place[right] - place[left], 1)
    noise = _noise_of(distance[beside], place[beside])
    filled = distance[left] * (1.0 - weight) + distance[right] * weight
    filled += noise * random.standard_normal(len(rows))
    copied = np.where(random.random(len(rows)) < weight, right, left)
    forged = _rewritten(
        "lattice remove",
        scene,
        lattice,
        rows,
        Firings(reading.ring[rows], reading.count[rows], filled),
        scene.intensity[copied] if len(scene.intensity) else None,
        {},
    )
    if not forged.num_touched:
        raise InputError(_NOTHING_BESIDE)
    return forged


@dataclass(frozen=True, eq=False)
class Firings:
    """Firings of lasers and their ranges.

    Attributes
    ----------
    ring : (N,) integers
        Index of the laser.
    count : (N,) integers
        Encoder count.
    distance : (N,) float, metres
        Distance along the beam, as for `FiringLattice.points_at`.
    """

    ring: NDArray[Any]
    count: NDArray[Any]
    distance: Floats

    def keys(self, steps: int) -> NDArray[np.int64]:
        """Return a unique number for each pair of laser and count."""
        return np.asarray(self.ring.astype(np.int64) * steps + self.count, np.int64)

    def select(self, rows: Rows) -> Firings:
        return Firings(self.ring[rows], self.count[rows], self.distance[rows])


_NOTHING_BESIDE = (
    "box: expected a laser with returns on both sides of it, but no point would change"
)


def _check_encoder(lattice: FiringLattice) -> None:
    if not lattice.steps:
        raise InputError("lattice: expected one with an encoder, got one without steps")


def _turned_firings(
    hoax: Scan, steps: int, here: Readings, lattice: FiringLattice, threads: int
) -> tuple[Rows, Firings]:
    """Rows of a hoax that lie on the lattice, and their firings after a turn by ``steps``.

    Counts at which the scanner did not fire in the scan (``here``) are replaced by the nearest ones
    at which it did.
    """
    reading = lattice.read(hoax.points, threads=threads)
    rows = np.flatnonzero(reading.count >= 0)
    turned = np.mod(reading.count[rows] + steps, lattice.steps)
    return rows, Firings(
        reading.ring[rows],
        _nearest_fired(turned, here, lattice.steps),
        lattice.distance(hoax.points, reading.ring)[rows],
    )


def _hidden_rows(
    scene: Scan, here: Readings, hoax: Firings, lattice: FiringLattice
) -> tuple[Rows, Rows]:
    """Rows of a scan that a hoax hides, and the firing of the hoax in front of each."""
    keys = hoax.keys(lattice.steps)
    order = np.lexsort((hoax.distance, keys))
    if len(order):  # of points that share a firing, the nearest is seen
        order = order[np.r_[True, np.diff(keys[order]) > 0]]
    rows, found = _rows_of(keys[order], here, lattice.steps)
    seen = order[found]
    is_hidden = hoax.distance[seen] < lattice.distance(scene.points[rows], here.ring[rows])
    return rows[is_hidden], seen[is_hidden]


def _neighbours_on_ring(
    rows: Rows, beside: Rows, place: NDArray[np.int64], ring: NDArray[np.int32]
) -> tuple[Rows, Rows, Rows]:
    """Rows with a neighbour of the same laser at both sides, and these neighbours.

    ``beside`` are the rows that may be neighbours, in the order of ``place``.
    """
    at = np.searchsorted(place[beside], place[rows])
    left, right = beside[(at - 1).clip(min=0)], beside[at.clip(max=len(beside) - 1)]
    same = (at > 0) & (at < len(beside))  # the first and the last laser may lack a side
    same &= (ring[left] == ring[rows]) & (ring[right] == ring[rows])
    return rows[same], left[same], right[same]


def _nearest_fired(count: NDArray[Any], here: Readings, steps: int) -> NDArray[np.int64]:
    """Return for each count the nearest one at which the scanner fired."""
    votes = np.bincount(here.count[here.count >= 0], minlength=steps)
    fired = np.flatnonzero(votes >= MIN_LASERS)
    if not len(fired):
        return np.asarray(count, np.int64)
    around = np.concatenate([fired[-1:] - steps, fired, fired[:1] + steps])
    at = np.searchsorted(around, count).clip(1, len(around) - 1)
    nearest = np.where(count - around[at - 1] <= around[at] - count, around[at - 1], around[at])
    return np.asarray(np.mod(nearest, steps), np.int64)


def _rows_of(keys: NDArray[np.int64], here: Readings, steps: int) -> tuple[Rows, NDArray[np.bool_]]:
    """Rows of the scan's returns at firings, and a mask of the firings that have a return."""
    read = np.flatnonzero(here.count >= 0)
    own = here.ring[read].astype(np.int64) * steps + here.count[read]
    order = np.argsort(own, kind="stable")
    at = np.searchsorted(own[order], keys).clip(max=max(len(own) - 1, 0))
    found = own[order][at] == keys if len(own) else np.zeros(len(keys), np.bool_)
    return read[order[at[found]]] if len(own) else np.empty(0, np.intp), found


def _noise_of(seen: Floats, place: NDArray[np.int64]) -> float:
    """Standard deviation of ranges between shots, metres, from second differences."""
    near = (np.diff(place)[1:] <= 4) & (np.diff(place)[:-1] <= 4)
    bend = np.abs(np.diff(seen, 2))[near]
    return float(NORMAL_MAD * np.median(bend) / math.sqrt(6.0)) if len(bend) else 0.0


def _rewritten(
    attack: str,
    scene: Scan,
    lattice: FiringLattice,
    rows: Rows,
    firings: Firings,
    intensity: NDArray[np.float32] | None,
    parameters: Mapping[str, Any],
) -> Forgery:
    """Replace rows of a scan by the points of firings, rounded as the scanner rounds."""
    ring, count, distance = firings.ring, firings.count, firings.distance
    if lattice.range_step:
        phase = lattice.range_phase[ring]
        distance = phase + np.round((distance - phase) / lattice.range_step) * lattice.range_step
    values = lattice.points_at(ring, count, distance)
    if lattice.coordinate_step:
        # Division by a whole number gives the same floats as in the scanner's files.
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
    """Return all rows in the order of the scanner's file: ring after ring, each by azimuth.

    A rewritten range changes the azimuth a little, because beams pass beside the axis. Points that
    were not rewritten keep their order. If these are not in the scanner's order, nothing is sorted.
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
