"""Measure the share of edits of each class that detectors find, by planting them in clean scans."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import generator_of, reporting, shares, sharing
from manip3d._util.paths import path_of
from manip3d._util.shares import binomial_tail
from manip3d.authenticate._carriers import ALLOWED, without_bits
from manip3d.authenticate._generic import consistency_allowing, generic_consistency
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._lattice_estimate import estimate_lattice
from manip3d.authenticate._reflectance import reflectance_consistency, why_not_judged
from manip3d.authenticate._sensors import HDL64E, is_hdl64e, why_off_lattice
from manip3d.authenticate._turns import turn_consistency
from manip3d.authenticate._verdict import NO_POWER, Power, rate_of
from manip3d.errors import InputError
from manip3d.io import read_scan
from manip3d.io._scan_files import scan_paths
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.authenticate._sensors import Sensor
    from manip3d.forge import Forgery

    Points = NDArray[np.float32]
    Cloud = NDArray[np.float32]  # x, y, z and, if it was measured, reflectance
    Rows = NDArray[np.int64]
    Edit = Callable[[Cloud, Rows, SensorLattice, np.random.Generator], Cloud]

BLIND = (
    "reflectance rewritten within the noise, or with that of other firings of the same lasers",
    "points left out one by one: fewer than one of 200 of the scan, or up to 4 of 5 of an object's",
    "points left out that stand alone, where they are too few to be told as a filter of outliers",
)
"""Classes of edits that no detector here finds."""

BLIND_WITHOUT_TURNS = (
    "ranges of existing firings rewritten on the lattice, with reflectances that fit (white-box)"
)
"""A further blind class if detector IV did not compare the scan with its neighbouring turns."""

BLIND_WITHOUT_REFLECTANCES = "reflectance rewritten: the scan has none that can be judged"
"""A further blind class if detector V cannot judge the scan."""

UNMEASURED_REFLECTANCES = (
    "Detector V judged the reflectances; what share of rewritten reflectances it finds was not "
    "measured in scans with a watermark, nor in those of other units than KITTI's."
)
"""Note on the power if detector V judged the scan without known power."""

BLIND_WITHOUT_STEPS = "points turned about the scanner: its azimuths have no steps"
"""A further blind class if the lattice has lines and ranges only, as that of a Velodyne."""

BLIND_TURNED = (
    "objects turned about the scanner by whole steps of azimuth, or mirrored, whose own place is "
    "empty; copies that overlap the original or are less than 5 degrees away; copies in clouds "
    "with little noise or two returns a firing"
)
"""A further blind class in exact clouds whose azimuths have steps: detector III finds other turned
copies, since they have the ranges of the original."""

BLIND_TURNED_ANYHOW = (
    "objects turned about the scanner, or mirrored, whose own place is empty; copies that overlap "
    "the original or are less than 5 degrees away, and copies in clouds with little noise or two "
    "returns a firing: the scanner's azimuths have no steps"
)
"""A further blind class in exact clouds whose azimuths have no steps, but whose ranges have."""

BLIND_COPIED = (
    "objects turned about the scanner by whole steps of azimuth, mirrored, or copied in this way: "
    "the scanner's ranges have no steps by which copies are recognised"
)
"""A further blind class in exact clouds whose ranges have no steps, but whose azimuths have."""

BLIND_ALONG_RAYS = "points moved along their rays: the scanner's ranges have no steps"
"""A further blind class in exact clouds whose ranges have no steps."""

BLIND_WHOLE_STEPS = "points moved along their rays by whole range steps"
"""A further blind class in exact clouds whose ranges have steps: coordinates are not rounded a
second time, so that moved points stand on the range steps, too."""

BLIND_CUT = (
    "fewer than 24 of the highest or of the lowest lasers silenced in a sector wider than 43 "
    "degrees; points cut out by their height above the scanner"
)
"""A further blind class in scans of an HDL-64E: beside the sky and beside the blind spot under the
scanner, no neighbouring lasers should answer."""

BLIND_CUT_ELSEWHERE = (
    "some lasers silenced in a sector; points cut out by their range, height or elevation: both "
    "are looked for in scans of an HDL-64E only"
)
"""A further blind class in scans of other scanners whose lattice is known."""

BLIND_TERRESTRIAL = "points removed, cropped or moved together: only what was added is looked for"
"""A further blind class in scans that detectors I and II judge."""

BLIND_SPARSE = "objects added with a spacing coarser than the scan's: few points hide nothing"
"""A further blind class in scans that detectors I and II judge: a gap must span a region of
neighbouring directions."""

NOT_FOUND = "not found; a watermark shows it"
"""Text of reports on a blind class, beside a share of 0 %."""

NEAREST, FARTHEST = 5.0, 25.0
"""Metres: range of distances at which edits are planted."""

MIN_POINTS = 100
"""Fewest returns of an object that is edited."""

DRAWS = 10
"""Largest number of places at which an edit is tried until it changes enough points."""


def _rounded(points: NDArray[np.float64], lattice: SensorLattice) -> Points:
    """Round to the steps of the coordinates in the scanner's files, if these have any."""
    if lattice.coordinate_step:  # else rounding would give the edit away
        a_metre = 1.0 / lattice.coordinate_step
        points = np.round(points * a_metre) / a_metre
    return np.ascontiguousarray(points, np.float32)


def _xyz(cloud: Cloud) -> Points:
    return np.ascontiguousarray(cloud[:, :3])


def _written(cloud: Cloud, lattice: SensorLattice) -> Cloud:
    """Sort points ring by ring and by azimuth, as an attacker who knows the format does."""
    reading = lattice.read(_xyz(cloud))
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


@checked
def measure_power(
    frames: Iterable[LidarFrame],
    lattice: SensorLattice,
    *,
    planted: int = 20,
    classes: Sequence[str] | None = None,
    neighbours: bool = False,
    embedding: str = "",
    false_alarm_rate: float = 0.01,
    rng: int = 0,
    threads: int = 0,
    progress: Progress = None,
) -> dict[str, Power]:
    """Plant edits in clean frames of a scanner and count those that detectors III to V find.

    Detectors IV and V look at frames of an HDL-64E only, as in `inspect`.

    Parameters
    ----------
    frames : iterable of LidarFrame
        Clean frames with the scanner at the origin; they must be consecutive with ``neighbours``.
    lattice : SensorLattice
        Lattice of the scanner.
    planted : int
        Number of edits of each class in each frame; fewer if there is no object, or if no edit of
        it changes enough points.
    classes : sequence of str, optional
        Names of classes in `EDITS`; default: all.
    neighbours : bool
        Give the detectors the previous and the following frame, which are clean. Without them,
        detector IV cannot judge, and detector V judges the frame alone.
    embedding : str
        'lbm' or 'qim': edited frames get a watermark, which is verified before detection, so that
        detectors allow for it; empty: no watermark.
    false_alarm_rate : float
        Largest share of clean frames that all detectors together may call tampered; each has a part
        of it, as in `inspect`.
    rng : int
        Seed of the edits.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    dict of str to Power
        Power by class of edit. Classes that could not be planted are left out, such as those of
        reflectances in frames without reflectances or with a watermark.

    Raises
    ------
    InputError
        ``planted`` is not positive; an embedding or a class is unknown.

    Notes
    -----
    Edits are planted in an object: the points within 1.2 m of a random point that is 0.4 to 2.7 m
    above the ground and 5 to 25 m from the scanner. The ground is the median height of what
    `manip3d.forge.segment` calls ground at these distances. It is taken to be 1.7 m below the
    scanner if it is 1.4 to 2 m below it, or if fewer than 1000 points are ground.

    White-box edits are counted if they change at least 100 points, the fewest that an object has,
    and other edits if they change any. An edit that does not is drawn again, for example with
    another turn, up to ten times in all; after that it is not counted.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame
    >>> from manip3d.authenticate import kitti_lattice, measure_power
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 2000), 2000)  # every second step of the encoder
    >>> distance = 10 + lattice.range_phase[ring]  # a round wall
    >>> scan = lattice.points_at(ring, 2 * count, distance).round(3)
    >>> azimuth = np.arctan2(scan[:, 1], scan[:, 0]) % (2 * np.pi)
    >>> scan = scan[np.lexsort((azimuth, ring))].astype(np.float32)
    >>> power = measure_power([LidarFrame(scan)], lattice, planted=2, classes=["added"])
    >>> power["added"].found, power["added"].planted
    (2, 2)
    """
    if embedding and embedding not in ALLOWED:
        raise InputError(f"embedding: expected one of {', '.join(ALLOWED)}, got {embedding!r}")
    if planted < 1:
        raise InputError(f"planted: expected at least 1, got {planted}")
    wanted = tuple(EDITS) if classes is None else tuple(classes)
    if unknown := set(wanted) - set(EDITS):
        raise InputError(f"classes: expected some of {', '.join(EDITS)}, got {min(unknown)!r}")
    random = generator_of(rng)
    (again,) = random.spawn(1)  # its draws do not change which objects are edited
    found, tried = dict.fromkeys(wanted, 0), dict.fromkeys(wanted, 0)
    listed = list(frames)
    if not all(isinstance(frame, LidarFrame) for frame in listed):
        raise InputError("frames: expected LidarFrames")
    judge = _Judge(lattice, embedding, false_alarm_rate, threads)
    judged = range(1, len(listed) - 1) if neighbours else range(len(listed))
    with reporting(progress, "plant") as report:
        told = report or (lambda _: None)
        for place, i in enumerate(judged):
            before, after = (listed[i - 1], listed[i + 1]) if neighbours else (None, None)
            cloud = _with_reflectance(listed[i], embedding)
            possible = [name for name in wanted if _can_be_planted(name, cloud, lattice)]
            for trial in range(planted):
                rows = _some_object(_xyz(cloud), random)
                if rows is None:
                    break
                for number, name in enumerate(possible, 1):
                    forged = _edited(name, cloud, rows, lattice, random, again)
                    if forged is not None:
                        tried[name] += 1
                        found[name] += judge.finds(forged, before, after, random)
                    told((place + (trial + number / len(possible)) / planted) / len(judged))
        told(1.0)
    return {name: Power(found[name], tried[name]) for name in wanted if tried[name]}


def _edited(
    name: str,
    cloud: Cloud,
    rows: Rows,
    lattice: SensorLattice,
    random: np.random.Generator,
    again: np.random.Generator,
) -> Cloud | None:
    """The scan with an edit of an object; None: no edit that was tried changes enough points."""
    for draw in range(DRAWS):
        forged = EDITS[name](cloud, rows, lattice, again if draw else random)
        if name in WHITE_BOX:
            is_enough = _num_moved(cloud, forged) >= MIN_POINTS
        else:
            is_enough = forged.shape != cloud.shape or not np.array_equal(forged, cloud)
        if is_enough:
            return forged
    return None


def _num_moved(cloud: Cloud, forged: Cloud) -> int:
    """Number of points of a forged scan that the scan lacks, in whatever order both are."""
    return int(np.count_nonzero(~np.isin(_keys_of(forged), _keys_of(cloud))))


def _keys_of(cloud: Cloud) -> NDArray[np.uint64]:
    """A number for the bits of each row; different rows have the same by a chance of 2**-64."""
    bits = np.ascontiguousarray(cloud, np.float32).view(np.uint32)
    keys = np.zeros(len(bits), np.uint64)
    for column in bits.T:
        keys = (keys ^ column) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(32)
    return keys


def _can_be_planted(name: str, cloud: Cloud, lattice: SensorLattice) -> bool:
    """Whether a class of edits can be planted in a scan, given its reflectances and lattice."""
    if name in REFLECTANCE_EDITS and cloud.shape[1] == 3:
        return False
    if name in TURNS_BY_STEPS:
        return lattice.is_exact
    return name not in WHITE_BOX or bool(lattice.steps)


MIN_CALIBRATED = 4
"""Fewest scans for `calibrate_lattice`; the lattice is estimated from every second one."""

CHANCE = 0.01
"""Largest share of correct lattices that may be refused because detector III accuses too many clean
scans by chance."""


@checked
def calibrate_lattice(
    frames: Iterable[LidarFrame | str | os.PathLike[str]],
    *,
    most: int | None = None,
    planted: int = 10,
    source: str = "",
    rng: int = 0,
    threads: int = 0,
    progress: Progress = None,
) -> SensorLattice:
    """Estimate the lattice of a scanner and measure the power of detector III on its scans.

    The lattice is estimated from every second scan. The other scans are judged by it, first
    unedited, then with planted edits of each class. With this lattice, `inspect` can return
    ``no_trace`` for scans of this scanner if half of the edits of some class are found. Ranges of
    exact clouds need no steps then; without them edits along the rays and turned copies stay
    hidden, as the power of their classes shows.

    Parameters
    ----------
    frames : iterable of LidarFrame or path
        At least four clean scans as the scanner recorded them, with the scanner at the origin. A
        path of a folder stands for all scans in it, or for all scans of that drive (`drive_scans`).
    most : int, optional
        Largest number of scans to read, evenly spread over all; at least four. Default: all.
    planted : int
        Number of edits of each class in each scan that is judged.
    source : str
        Name of the scans, for ``SensorLattice.power``; default: their number, and their file's or
        folder's name.
    rng : int
        Seed of the edits.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    SensorLattice
        Lattice with ``power``, which is empty if no edits could be planted.

    Raises
    ------
    InputError
        There are fewer than four scans, or they have no rings that can be distinguished;
        ``planted`` is not positive or ``most`` is below 4; detector III accuses more of the clean
        scans than chance explains at its rate, so that it cannot judge this scanner; `inspect`
        would not judge one of them by the lattice, so that a measured power would not hold.
    FormatError, OSError
        A file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame
    >>> from manip3d.authenticate import calibrate_lattice, kitti_lattice
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 2000), 2000)  # every second step of the encoder
    >>> def spiral_wall(radius):
    ...     distance = radius + 0.004 * count + lattice.range_phase[ring]
    ...     scan = lattice.points_at(ring, 2 * count, distance).round(3)
    ...     azimuth = np.arctan2(scan[:, 1], scan[:, 0]) % (2 * np.pi)
    ...     return LidarFrame(scan[np.lexsort((azimuth, ring))].astype(np.float32))
    >>> walls = [spiral_wall(radius) for radius in (8, 10, 12, 14)]
    >>> calibrate_lattice(walls, planted=1).power["moved"].share
    1.0
    """
    if most is not None and most < MIN_CALIBRATED:
        raise InputError(f"most: expected at least {MIN_CALIBRATED}, got {most}")
    given = list(frames)
    chosen = _spread([scan for each in given for scan in _scans_of(each)], most)
    if len(chosen) < MIN_CALIBRATED:
        raise InputError(f"frames: expected at least {MIN_CALIBRATED} scans, got {len(chosen)}")
    listed = [scan if isinstance(scan, LidarFrame) else read_scan(scan) for scan in chosen]
    lattice = estimate_lattice(listed[::2])
    others = [frame.replace(intensity=None) for frame in listed[1::2]]
    rate = rate_of("generic")
    classes = [name for name in EDITS if name not in REFLECTANCE_EDITS]
    clean, forged = shares([1.0, planted * len(classes)])
    with sharing(progress, "calibrate") as part:
        accused = 0
        with reporting(part(*clean), "clean scans") as report:
            for number, frame in enumerate(others, 1):
                found = generic_consistency(
                    frame, lattice=lattice, false_alarm_rate=rate, threads=threads
                )
                accused += found.verdict == "tampered"
                if report is not None:
                    report(number / len(others))
        if accused and binomial_tail(accused, len(others), rate) <= CHANCE:
            raise InputError(
                f"frames: expected clean scans that stand on a lattice; detector III accuses "
                f"{accused} of {len(others)} as they are"
            )
        _refuse_off_lattice(others, lattice, threads)
        measured = measure_power(
            others, lattice, planted=planted, classes=classes, rng=rng, threads=threads,
            progress=part(*forged),
        )  # fmt: skip
    told = source or f"{len(others)} clean scans{_places_in_words(given)}"
    power = {name: replace(each, source=told) for name, each in measured.items()}
    return replace(lattice, power=ReadOnlyMapping(power))


def _refuse_off_lattice(scans: Sequence[LidarFrame], lattice: SensorLattice, threads: int) -> None:
    """Raise `InputError` if `inspect` would not judge some of the scans by the lattice."""
    reasons = [why_off_lattice(scan, lattice, threads=threads) for scan in scans]
    told = [why for why in reasons if why is not None]
    if told:
        raise InputError(
            f"frames: expected clean scans that are judged by a lattice of others; {len(told)} of "
            f"{len(scans)} are not: {told[0]}"
        )


def _scans_of(given: LidarFrame | str | os.PathLike[str]) -> list[LidarFrame | Path]:
    """The given scan, or the scans of a folder, which may be a drive."""
    if isinstance(given, LidarFrame):
        return [given]
    path = path_of(given, "frames")
    if not path.is_dir():
        return [path]
    from manip3d.authenticate._watermark_files import drive_scans

    return [*scan_paths(path)] or [*drive_scans(path)]


def _spread(scans: Sequence[LidarFrame | Path], most: int | None) -> list[LidarFrame | Path]:
    """At most ``most`` of the scans, evenly spread over all."""
    if most is None or len(scans) <= most:
        return list(scans)
    return [scans[k * len(scans) // most] for k in range(most)]


def _places_in_words(given: Sequence[LidarFrame | str | os.PathLike[str]]) -> str:
    """Name of the first file or folder, and the number of further ones, in words."""
    names = [Path(each).name for each in given if not isinstance(each, LidarFrame)]
    if not names:
        return ""
    return f" of {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def _with_reflectance(frame: LidarFrame, embedding: str) -> Cloud:
    """Points, with reflectances if detector V can judge them and no watermark is embedded."""
    usable = not embedding and why_not_judged(frame) is None
    if not usable or frame.intensity is None:
        return frame.points
    return np.column_stack([frame.points, frame.intensity])


class _Judge(NamedTuple):
    """The detectors of a spinning scanner."""

    lattice: SensorLattice
    embedding: str
    false_alarm_rate: float
    threads: int

    def finds(
        self,
        cloud: Cloud,
        before: LidarFrame | None,
        after: LidarFrame | None,
        random: np.random.Generator,
    ) -> bool:
        """Whether a detector accuses an edited frame."""
        points = _marked(_xyz(cloud), self.embedding, random)
        rate, threads = self.false_alarm_rate, self.threads
        result = consistency_allowing(
            self.embedding, points, self.lattice, false_alarm_rate=rate_of("generic", rate),
            threads=threads,
        )  # fmt: skip
        if result.verdict == "tampered":
            return True
        if not is_hdl64e(self.lattice):
            return False  # as in `inspect`: detectors IV and V only have thresholds for it
        turns = None
        if before is not None and after is not None:
            turns = turn_consistency(
                points, before, after, lattice=self.lattice,
                false_alarm_rate=rate_of("turns", rate), threads=threads,
            )  # fmt: skip
            if turns.verdict == "tampered":
                return True
        if cloud.shape[1] == 3:
            return False
        frame = LidarFrame(points, np.ascontiguousarray(cloud[:, 3]))
        beside = turns is not None and before is not None and before.intensity is not None
        return (
            reflectance_consistency(
                frame, lattice=self.lattice, previous=before if beside else None,
                following=after if beside else None, turns=turns,
                false_alarm_rate=rate_of("reflectance", rate), threads=threads,
            ).verdict
            == "tampered"
        )  # fmt: skip


def _marked(points: Points, embedding: str, random: np.random.Generator) -> Points:
    """The points after embedding and after removing the bits, as detectors judge them."""
    if not embedding:
        return points
    from manip3d.authenticate._paper_watermark import embed_paper, noise_blocks

    sent = embed_paper(points, noise_blocks(random), embedding=embedding).frame.points
    return without_bits(sent, embedding)


SEED_HEIGHTS, OBJECT_HEIGHTS = (0.4, 2.7), (0.2, 3.2)
"""Metres above the ground: heights of the point at which an object is looked for, and of the points
of the object."""

OBJECT_RADIUS, MAX_POINTS, TRIES = 1.2, 3000, 50
"""Metres on the ground around that point, most returns of an object, and number of points that are
tried in a scan."""

USUAL_GROUND, NEAR_USUAL, MIN_GROUND = -1.7, 0.3, 1000
"""Height of the ground below a scanner on the roof of a car, metres. It is used if the estimate
differs from it by less than NEAR_USUAL, so that slopes do not change which objects are edited, and
if fewer than MIN_GROUND points are ground, which is too few for an estimate."""


def _some_object(points: Points, random: np.random.Generator) -> Rows | None:
    """Rows of the points near a random point above the ground; None: no object."""
    ground = _ground_height(points)
    z, rho = points[:, 2], np.hypot(points[:, 0], points[:, 1])
    above = (z > ground + SEED_HEIGHTS[0]) & (z < ground + SEED_HEIGHTS[1])
    seeds = np.flatnonzero(above & (rho > NEAREST) & (rho < FARTHEST))
    for _ in range(TRIES):
        if not len(seeds):
            break
        seed = points[seeds[random.integers(len(seeds))]]
        near = np.hypot(points[:, 0] - seed[0], points[:, 1] - seed[1]) < OBJECT_RADIUS
        of_object = (z > ground + OBJECT_HEIGHTS[0]) & (z < ground + OBJECT_HEIGHTS[1])
        rows = np.flatnonzero(near & of_object)
        if MIN_POINTS <= len(rows) <= MAX_POINTS:
            return rows
    return None


def _ground_height(points: Points) -> float:
    """Height of the ground around the scanner, metres, relative to the scanner."""
    from manip3d import forge

    rho = np.hypot(points[:, 0], points[:, 1])
    around = (rho > NEAREST) & (rho < FARTHEST)
    is_ground = forge.segment(points).label == -1
    heights = points[around & is_ground, 2]
    if len(heights) < MIN_GROUND:
        return USUAL_GROUND
    found = float(np.median(heights))
    return USUAL_GROUND if abs(found - USUAL_GROUND) < NEAR_USUAL else found


def _measured(source: str, **found: tuple[int, int]) -> Mapping[str, Power]:
    return ReadOnlyMapping(
        {
            name.replace("__", ": ").replace("_", " ").replace("white box", "white-box"): Power(
                hits, planted, source=source
            )
            for name, (hits, planted) in found.items()
        }
    )


_REPORTED = (
    "8 clean frames of KITTI that chose no threshold: drives 0005 and 0079, stereo-2015 000083 and "
    "000131, object"
)
_SINGLE = (
    "7 clean frames of KITTI: 4 of drive 0005, of which one may have raised a threshold, "
    "stereo-2015 000083 and 000131, object; detectors III and V together"
)
_BESIDE = (
    "clean frames of KITTI's drive 0005, of which one may have raised a threshold, with the frames "
    "before and after; detectors III, IV and V together"
)
_SCENES = "simulated terrestrial scans of manip3d.simulate.scenes, 0.2 degrees"

MEASURED: Mapping[str, Mapping[str, Power]] = ReadOnlyMapping(
    {
        "generic": _measured(
            _REPORTED,
            added=(40, 40),
            moved=(40, 40),
            rotated=(40, 40),
            resampled=(40, 40),
            removed=(4, 40),
            along_rays=(40, 40),
            bump=(40, 40),
            five_points=(39, 40),
            white_box_removed=(0, 40),
            white_box_added=(0, 39),
            spoofed=(0, 39),
        ),
        "turns": _measured(
            "18 clean frames of KITTI's drive 0005 that chose no threshold, with the frames before "
            "and after; detectors III and IV together",
            added=(36, 36),
            moved=(36, 36),
            rotated=(36, 36),
            resampled=(36, 36),
            removed=(31, 36),
            along_rays=(36, 36),
            bump=(35, 36),
            five_points=(33, 36),
            white_box_removed=(12, 36),
            white_box_added=(22, 36),
            spoofed=(5, 36),
        ),
        "reflectance": _measured(
            _BESIDE,
            reflectance__one_value=(22, 22),
            reflectance__scaled=(18, 22),
            reflectance__shifted=(19, 22),
            reflectance__exchanged=(12, 22),
            reflectance__from_elsewhere=(17, 22),
            white_box_removed=(21, 22),
            white_box_added=(15, 22),
            spoofed=(4, 22),
        ),
        "reflectance alone": _measured(
            _SINGLE,
            reflectance__one_value=(42, 42),
            reflectance__scaled=(1, 42),
            reflectance__shifted=(5, 42),
            reflectance__exchanged=(0, 42),
            reflectance__from_elsewhere=(0, 42),
            white_box_removed=(38, 42),
            white_box_added=(0, 42),
            spoofed=(0, 42),
        ),
        "generic lbm": _measured(
            _REPORTED,
            added=(40, 40),
            moved=(40, 40),
            rotated=(40, 40),
            resampled=(40, 40),
            removed=(3, 40),
            along_rays=(21, 40),
            bump=(0, 40),
            five_points=(40, 40),
        ),
        "generic qim": _measured(
            _REPORTED,
            added=(40, 40),
            moved=(40, 40),
            rotated=(40, 40),
            resampled=(40, 40),
            removed=(3, 40),
            along_rays=(22, 40),
            bump=(9, 40),
            five_points=(40, 40),
        ),
        "density": _measured(_SCENES, added=(31, 32), resampled=(0, 32)),
        "occlusion": _measured(_SCENES, added=(32, 32), resampled=(32, 32)),
    }
)
"""Power at a false-alarm rate of 1 % for all detectors of a scan together, by detector and
embedding. `benchmarks/bench_power.py` measures it with `measure_power`, except for detectors I and
II."""


def known_power(detector: str, sensor: Sensor, embedding: str = "") -> Mapping[str, Power]:
    """Return the measured power of a detector on scans of a scanner; empty: not measured.

    For detector III, the power that the scanner's lattice states has priority, because it was
    measured on scans of this scanner.

    Parameters
    ----------
    detector : 'density', 'occlusion', 'generic', 'turns', 'reflectance' or 'reflectance alone'
        Detector; ``reflectance alone``: detector V without neighbouring frames.
    sensor : Sensor
        The scanner.
    embedding : str
        Embedding of the watermark whose bits the scan carries.
    """
    own = NO_POWER if sensor.lattice is None else sensor.lattice.power
    if detector == "generic" and own and not embedding:
        return own
    if detector in ("density", "occlusion"):
        is_of_this = sensor.kind == "terrestrial"
    else:
        # A lattice that the scan itself tells finds fewer edits, of another unit than KITTI's.
        is_of_this = sensor.kind == "lattice" and sensor.name == HDL64E and not sensor.is_own
    return MEASURED.get(f"{detector} {embedding}".strip(), NO_POWER) if is_of_this else NO_POWER
