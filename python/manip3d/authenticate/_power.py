"""Measure the share of edits of each class that detectors find, by planting them in clean scans."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.options import generator_of, reporting
from manip3d.authenticate._carriers import ALLOWED, without_bits
from manip3d.authenticate._edits import EDITS, REFLECTANCE_EDITS, TURNS_BY_STEPS, WHITE_BOX, xyz
from manip3d.authenticate._generic import consistency_allowing
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._reflectance import reflectance_consistency, why_not_judged
from manip3d.authenticate._sensors import is_hdl64e
from manip3d.authenticate._turns import turn_consistency
from manip3d.authenticate._verdict import Power, rate_of
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.authenticate._edits import Cloud, Points, Rows

BLIND_REFLECTANCES = (
    "reflectance rewritten within the noise, or with that of other firings of the same lasers"
)
"""A class of edits that no detector here finds in any scan."""

BLIND = (
    BLIND_REFLECTANCES,
    "points left out one by one: fewer than one of 200 of the scan, or up to 4 of 5 of an object's",
    "points left out that stand alone, where they are too few to be told as a filter of outliers",
)
"""Classes of edits that no detector here finds."""

BLIND_EXACT = (
    BLIND_REFLECTANCES,
    "points left out: fewer than one of seven of the scan, those of objects, whole columns, all "
    "but every third or fourth point of each ring, or sectors of the turn (a scanner may be set to "
    "a part of it)",
)
"""The same for exact clouds whose azimuths have steps."""

BLIND_EXACT_WITHOUT_STEPS = (
    BLIND_REFLECTANCES,
    "points left out, however many: the scanner's azimuths have no steps that tell gaps",
)
"""The same for exact clouds whose azimuths have none."""

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

BLIND_OTHER_SCAN = (
    "objects taken from another scan of this scanner, in the directions in which it saw them "
    "there: they stand on the same lattice"
)
"""A further blind class in exact clouds. Objects of the class "added" are turned by no whole number
of steps."""

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
                rows = _some_object(xyz(cloud), random)
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
        points = _marked(xyz(cloud), self.embedding, random)
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
