"""Detector III: points of a scan that contradict the lattice of a spinning scanner.

The lattice is the set of places where the scanner can measure: directions of the lasers at each
step of the encoder, and, where known, whole range steps. A *ring* is a laser, a *firing* one shot
of it, a *stray* point a point off the lattice in a clean frame.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d.authenticate._carriers import ALLOWED, MILLIMETRES, allowance, allowing
from manip3d.authenticate._lattice import LINE_TOLERANCE, SensorLattice
from manip3d.authenticate._lattice_estimate import estimate_lattice, without_roundings
from manip3d.authenticate._turned_copies import TURNS, turned_copy
from manip3d.authenticate._verdict import (
    NO_POWER,
    Calibration,
    Power,
    Verdict,
    is_alarm,
    verdict_repr,
)
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.authenticate._lattice import LatticeReading

EVIDENCE = (
    "grid", "line", "step", "firing", "duplicate", "order", "place", "range", "drift", "void",
    "time",
)  # fmt: skip
"""Kinds of evidence, in the order of the bits of ``flags``."""

MISSING = ("void", "time", "firing")
"""Kinds of evidence based on missing returns, or on the number of returns of a firing."""

STRAY_RATE = 1e-5
"""Upper bound of the share of stray points in a clean frame. None of the 2.5 million points of
KITTI's drive 0002 and two other drives is stray, so that the share is below 1.2e-6 (95 %)."""

EXACT_STRAY_RATE = 1e-4
"""The same for the points that an exact lattice can judge. None of the 279,681 such points of nine
clouds of eight scanners of Hesai, Ouster and Velodyne is stray, so that the share is below 1.1e-5
(95 %). Nine times as much is used, since a single cause could produce several such points."""

NEIGHBOURS = 100
"""Number of points near a stray point among which a second one would join its region."""

SCATTER = 1.5
"""Metres: stray points within this distance of one of them form a group, though they do not touch
as points of a region do."""

ALONE = 0.1
"""Metres: points off an exact lattice that are nearer than this to another point do not accuse a
scan by their number. Filters that average the points of a voxel leave such points where the scan is
dense."""

MAX_SCATTERED = 1000
"""Stray points outside of regions are tested only up to this number, since each is compared with
all others. It is a fiftieth of the number at which they would form regions."""

FAR_OFF = 2.5
"""A point is far off if it is more than this many tolerances from its line or step. None of the 5.3
million points of 43 frames of nine KITTI drives is, so that the share is below 5.7e-7 (95 %).
`STRAY_RATE` is used for these points as well, 17 times as much, because a single cause that these
43 frames did not show could produce several such points in one frame."""

WINDOWS = 1_000_000
"""Upper bound of the number of range windows tested in a frame of 64 lasers: three around each
voxel. The p-value of a window is multiplied by it (Bonferroni)."""

DRIFT_MIN, DRIFT_SCALE = 5.0, 0.84
"""The largest drift of a window in a clean frame exceeds ``s`` standard deviations with a
probability of at most exp((5 - s) / 0.84). With seven kinds of evidence, 10.5 deviations are needed
to accuse at 1 %. The tail is longer than that of the normal law, because rounding to whole
millimetres is correlated along a ring on level ground. The scale was chosen on 41 frames of four
KITTI drives: the largest drift is 8.3, and one more is above 8."""

VOID_MIN, VOID_SCALE = 8.0, 55.0
"""The largest void of a clean frame has ``s`` firings or more with a probability of at most
exp((8 - s) / 55). The scale was chosen on 40 simulated streets, whose dark cars return nothing at
all: the median is 40, a tenth is above 140, the largest is 245. Of 21 real frames of three drives
20 have no void, and one has 12: cars that absorb all light are rare there, but no forgeries."""

TIME_MIN, TIME_SCALE = 8.0, 25.0
"""The same for voids that the previous frame answered. Of 36 simulated pairs of frames the median
is 12 and the largest 80; of 21 real pairs 20 have none and one has 13."""

BETWEEN_MIN, BETWEEN_SCALE = 10.0, 150.0
"""The same for voids that both the previous and the following frame answered, without holes that
moved. The scale was chosen on 17 simulated frames with cars that return nothing at all, whose
largest holes have 982, 338 and 109 firings. None of 44 other simulated frames (streets 1000 to 1021
and 2000 to 2021) is accused; their largest holes have 561, 297 and 199. Of 33 real frames 32 have
none and one has 10. The long tail costs power: of 18 objects removed in drive 0005, 2 are found."""

EXPONENTIAL_TAILS = {
    "drift": (DRIFT_MIN, DRIFT_SCALE),
    "void": (VOID_MIN, VOID_SCALE),
    "time": (TIME_MIN, TIME_SCALE),
    "between": (BETWEEN_MIN, BETWEEN_SCALE),
}
"""Kinds whose strength reaches ``s`` in a clean frame with a probability of at most
exp((fewest - s) / scale), as (fewest, scale). ``between`` is the rule of `GenericResult.rules`."""

REASONS = {
    "unknown": "the lattice does not know it",
    "contradicted": "the whole frame contradicts it: processed, or another scanner",
    "depends": "it stands on evidence that was dropped",
    "no ground": "no ground plane was found",
    "processed": "the frame was cropped, thinned or processed otherwise",
    "no previous": "no frame before or after on the same lattice was given",
    "no lattice": "no lattice of a spinning scanner was found",
}


IN_WORDS: dict[Verdict, str] = {
    "no_trace": "points lie where the sensor can measure",
    "processed": "the whole scan contradicts a part of the sensor's lattice",
    "undecidable": "the scan does not stand on the lattice of a spinning scanner",
}
"""Reason of each verdict in words; `_accusation` states that of ``tampered``."""

WRONG_PLACE = "points lie where the sensor cannot measure"
NO_RETURN = "returns are missing where a surface must have answered"
REPEATED = "two places have the same ranges, firing after firing: one of them is a turned copy"

UNJUDGED = "{} points are on no line, where a laser without a line may look: they cannot be judged"
"""Reason of an undecidable scan with `MIN_EXACT` or more such points. None of five clouds of
Hesai and Ouster scanners and of packets of three Velodyne scanners has a single one by a lattice
with all of its lasers."""

FEW_FAR_OFF = "{} points are off the lattice: too few to accuse, or those of a laser without a line"
"""Reason of an undecidable scan with fewer such points, and others between known lines."""


@dataclass(frozen=True)
class EvidenceReport:
    """Result of detector III for one kind of evidence, such as ``line`` or ``void``, on a frame.

    Attributes
    ----------
    used : bool
        Whether this kind counts for the verdict. A kind that does not apply to the frame, or that
        the whole frame contradicts, is left out.
    reason : str
        Reason why it was left out; empty if it was used.
    share : float
        Share of the frame's points with this evidence of an edit, whether it was used or not.
    strength : float
        Strength of the evidence in the strongest region. Its unit depends on the kind: firings
        without a return (``void``, ``time``), the natural logarithm of the improbability
        (``range``), standard deviations (``drift``), points (all others).
    p_value : float
        Upper bound of the probability that a clean frame has evidence as strong; 1 if it was not
        used.
    """

    used: bool
    reason: str
    share: float
    strength: float
    p_value: float


@dataclass(frozen=True, eq=False)
class SuspectRegion:
    """A connected part of the view with evidence of an edit.

    Attributes
    ----------
    p_value : float
        Upper bound of the probability that a clean frame has a region with as much evidence.
    strength : mapping of str to float
        Strength of each kind of evidence, see `EvidenceReport`; kinds without evidence are left
        out. ``scattered``: -log10 of the probability that points off the lattice lie so near to
        each other, or that the frame has so many of them. ``copied``: the same of the probability
        that so many successive ranges equal those of another region; which of the two is the copy
        is not known.
    lower, upper : (float, float, float), metres
        Corners of the axis-parallel box around the suspected points, or around the former places of
        removed points.
    rows : (K,) int64
        Rows of the suspected points; empty if points were removed.
    box : Box
        The box of the edited object: the smallest box, rotated about the vertical, around the
        largest group of points that lie where the sensor cannot measure. Without such points, the
        box from ``lower`` to ``upper``.
    """

    p_value: float
    strength: Mapping[str, float]
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    rows: NDArray[np.int64]
    box: Box

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class GenericResult(Showable):
    """Result of detector III for a frame; see :func:`generic_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
        ``processed``: the whole frame contradicts a kind of evidence that the lattice knows, so
        that an edit may have gone unseen.
    reason : str
        Reason of the verdict in words.
    p_value : float
        Upper bound of the probability that a clean frame shows evidence as strong; the verdict is
        ``tampered`` if it does not exceed ``false_alarm_rate``.
    score : float
        For ranking: ``-log10`` of the smallest p-value of any region and kind of evidence, without
        the correction for their number. It stays exact where the p-value underflows to 0.
    false_alarm_rate : float
        The argument of this name.
    evidence : mapping of str to EvidenceReport
        Report on each kind of evidence, used or not.
    regions : tuple of SuspectRegion
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the most significant
        first.
    suspected : (K,) int64
        Rows of the points with evidence in those regions.
    evidence_map : (R, C) uint16
        Number of items of evidence in each direction. A row is two lasers, the highest first;
        columns go counter-clockwise from straight ahead.
    lattice : SensorLattice or None
        Lattice by which the frame was judged.
    scan : LidarFrame or None
        The frame that was judged; the viewer shows it.
    rules : mapping of str to str
        Kinds of evidence whose p-value follows the rule of another name: ``time`` follows
        ``between`` if both the previous and the following frame were given.
    """

    verdict: Verdict
    reason: str
    p_value: float
    score: float
    false_alarm_rate: float
    evidence: Mapping[str, EvidenceReport]
    regions: tuple[SuspectRegion, ...]
    suspected: NDArray[np.int64]
    evidence_map: NDArray[np.uint16]
    lattice: SensorLattice | None
    scan: LidarFrame | None = field(default=None, repr=False)
    rules: Mapping[str, str] = field(default_factory=dict, repr=False)

    __repr__ = verdict_repr

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty, because the power depends on the scanner; `inspect` measures it."""
        return NO_POWER

    @property
    def calibration(self) -> Calibration | None:
        """None, because limits follow from the lattice and not from a set of clean scans."""
        return None

    @property
    def contradicted(self) -> frozenset[str]:
        """Kinds of evidence that the frame as a whole contradicts, which shows processing."""
        why = REASONS["contradicted"]
        return frozenset(kind for kind, said in self.evidence.items() if said.reason == why)

    @property
    def values_changed(self) -> bool:
        """Whether coordinates were changed in the whole frame: single points prove nothing then."""
        return bool(self.contradicted & {"grid", "line", "step", "place", "range"})

    def with_rows(self, rows: NDArray[np.int64], scan: LidarFrame) -> GenericResult:
        """Return the result for a scan of which only some points were judged.

        Parameters
        ----------
        rows : (N,) int64
            Row of ``scan`` of each point that was judged.
        scan : LidarFrame
            The whole scan.
        """
        regions = tuple(replace(region, rows=rows[region.rows]) for region in self.regions)
        return replace(self, regions=regions, suspected=np.sort(rows[self.suspected]), scan=scan)

    def without(
        self, kinds: Collection[str], *, why: str = "processed", quiet: Verdict = "processed"
    ) -> GenericResult:
        """Return the result without some kinds of evidence.

        Parameters
        ----------
        kinds : collection of str
            Kinds of evidence to leave out, because the frame as a whole lacks what they rely on.
        why : str
            Key of `REASONS` that states why they are left out.
        quiet : Verdict
            Verdict of a frame that could be judged and has no other evidence.
        """
        points = 0 if self.scan is None else self.scan.num_points
        tests = math.log10(1 + sum(said.used for said in self.evidence.values()))
        if not set(STRAYING).isdisjoint(kinds):
            kinds = (*kinds, "scattered", "copied")
        kept, score = [], 0.0
        for region in self.regions:
            strength = {k: s for k, s in region.strength.items() if k not in kinds}
            logs = [_log10_p(self.rules.get(k, k), s, points) for k, s in strength.items()]
            best = min(logs, default=0.0)
            log = min(0.0, tests + best)
            if is_alarm(log, self.false_alarm_rate):
                kept.append(replace(region, p_value=10.0**log, strength=strength))
                score = max(score, abs(best))
        evidence = {
            kind: replace(said, used=False, reason=REASONS[why])
            if kind in kinds and said.used
            else said
            for kind, said in self.evidence.items()
        }
        rows = [region.rows for region in kept]
        reason = _accusation(kept) if kept else IN_WORDS[quiet]
        if self.verdict == "undecidable" and not kept:
            quiet, reason = self.verdict, self.reason
        return replace(
            self,
            verdict="tampered" if kept else quiet,
            reason=reason,
            p_value=min((region.p_value for region in kept), default=1.0),
            score=score,
            evidence=evidence,
            regions=tuple(kept),
            suspected=np.unique(np.concatenate(rows)) if rows else np.empty(0, np.int64),
        )


RANGE_INCOHERENCE, EXACT_INCOHERENCE = 0.12, 0.02
"""Share of clean points, at most, whose range is more than a quarter step off: whole millimetres
leave 0.06 to 0.09 in KITTI, single precision leaves none."""

MIN_DIRECTIONS = 1000
"""A frame is judged only if at least this many pairs of laser and encoder step have a return."""


MIN_INCOHERENT = 6
"""Fewest incoherent ranges of a window that is evidence, as in the core."""


@checked
def generic_consistency(
    frame: LidarFrame | ArrayLike,
    *,
    lattice: SensorLattice | None = None,
    previous: LidarFrame | ArrayLike | None = None,
    following: LidarFrame | ArrayLike | None = None,
    false_alarm_rate: float = 0.01,
    tolerance: float | None = None,
    range_incoherence: float | None = None,
    azimuth_error: float = 0.0,
    threads: int = 0,
) -> GenericResult:
    """Detect edits in one scan of a spinning LiDAR (detector III).

    Parameters
    ----------
    frame : LidarFrame or (N, 3) points, metres
        The scan, with the scanner at the origin and the points in the order of its file.
    lattice : SensorLattice, optional
        Lattice of the scanner, from :func:`estimate_lattice` on clean scans. Default: estimated
        from the frame itself, which takes some tenths of a second.
    previous : LidarFrame or (N, 3) points, optional
        The frame one turn earlier. Directions that had a return then and have none now are
        evidence that points were removed.
    following : LidarFrame or (N, 3) points, optional
        The frame one turn later. If both are given, both must have a return in these directions.
    false_alarm_rate : float
        Largest share of clean frames that is called tampered; in (0, 1).
    tolerance : float, metres, optional
        Largest distance of a clean point from its line and its step; default: that of the lattice.
        For KITTI it is 2 mm, of which rounding to whole millimetres uses 0.8 mm.
    range_incoherence : float, optional
        Largest share of clean points whose range is more than a quarter of the scanner's range step
        off a whole number of steps; in (0, 0.5). Default: 0.12, for an exact lattice 0.02. Rounding
        to whole millimetres produces 0.06 to 0.09 in KITTI.
    azimuth_error : float, metres
        Largest move of points along the arc, besides rounding to whole millimetres. If it exceeds
        half a step of the encoder, the firing of a point is unknown.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    GenericResult

    Raises
    ------
    InputError
        Points of another shape or not finite; an option out of range.

    Notes
    -----
    Each return of an HDL-64E lies on the line (cone) of one of 64 lasers, at an encoder step at
    which the whole head fired, and at a range that is a whole multiple of 2 mm. Each laser has at
    most one return per firing, and KITTI's files list the returns in a fixed order. Edits break
    these rules:

    - Pasted, moved, turned and dented points are off their lines, steps or ranges, repeat a firing,
      or are out of order.
    - Points that were moved by centimetres along rays from the scanner's centre are off their lines
      by less than the rounding, but all in the same direction (``drift``). Their coordinates were
      rounded twice, or their ranges are between the steps: some of them are not the rounding of any
      point that their laser can measure (``place``).
    - Copies of an object that were turned about the scanner, or mirrored, may stand on the lattice
      of an exact cloud, but they have its ranges, firing after firing (``copied``). Clouds with
      little noise, where symmetrical places have equal ranges, and of both returns are not judged.
    - Removed points leave firings into the ground without a return (``void``), above ground with
      returns and with returns on both sides.

    A kind of evidence that the frame as a whole contradicts is left out, with the kinds that depend
    on it: a motion-compensated cloud, for example, is on no lattice. A frame without an alarm whose
    lines were left out is undecidable, and so is an exact one with five or more points off the
    lattice that are too few to accuse it, or that may be those of lasers without a line.

    Clean frames may have stray points. ``N * STRAY_RATE * (NEIGHBOURS * STRAY_RATE)**(m - 1)``
    bounds the expected number of regions of ``m`` stray points in a frame of ``N`` points, and
    serves as the p-value. Two tests concern points off their lines or steps that do not touch
    (``scattered``): the same bound for those within 1.5 m, and the Poisson law for the number of
    points that are off by more than 2.5 times the tolerance (of an exact cloud, only between lines
    that leave no room for a further laser). The p-value of a frame is the smallest
    one times the number of tests (Bonferroni).

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import generic_consistency, kitti_lattice
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 2000), 2000)  # every second step of the encoder
    >>> distance = 8 + 0.002 * count + lattice.range_phase[ring]  # a wall around the scanner
    >>> scan = lattice.points_at(ring, 2 * count, distance).round(3)
    >>> azimuth = np.arctan2(scan[:, 1], scan[:, 0]) % (2 * np.pi)
    >>> scan = scan[np.lexsort((azimuth, ring))].astype(np.float32)
    >>> generic_consistency(scan, lattice=lattice).verdict
    'no_trace'
    >>> scan[20000:20300, 2] += 0.01  # 300 points, lifted by a centimetre
    >>> generic_consistency(scan, lattice=lattice).verdict
    'tampered'
    """
    if not 0.0 < false_alarm_rate < 1.0:
        raise InputError(f"false_alarm_rate: expected a share in (0, 1), got {false_alarm_rate!r}")
    cloud = _points_of(frame, "points")
    is_stated = lattice is not None
    if lattice is None:
        try:
            lattice = estimate_lattice(frame)
        except InputError:
            _core.check_points(cloud, np.empty(0, np.float32))
            return _undecidable(false_alarm_rate)
    own = _Limits.of(lattice)
    limits = _Limits(
        own.tolerance if tolerance is None else tolerance,
        own.range_incoherence if range_incoherence is None else range_incoherence,
        azimuth_error,
    )
    return _consistency(
        frame, lattice, previous, following, limits, None, false_alarm_rate,
        is_stated=is_stated, threads=threads,
    )  # fmt: skip


def _consistency(
    frame: LidarFrame | ArrayLike,
    lattice: SensorLattice,
    previous: LidarFrame | ArrayLike | None,
    following: LidarFrame | ArrayLike | None,
    limits: _Limits,
    reading: LatticeReading | None,
    false_alarm_rate: float,
    *,
    is_stated: bool,
    threads: int,
) -> GenericResult:
    """Judge a frame; with an exact lattice, only the points whose lattice place is certain."""
    cloud = _points_of(frame, "points")
    scan = (
        frame if isinstance(frame, LidarFrame) else LidarFrame(cloud.copy(), origin=(0.0, 0.0, 0.0))
    )
    if not lattice.is_exact:
        found = _examined(cloud, lattice, previous, following, limits, reading, threads)
        return _judged(
            found, scan, lattice, limits.tolerance, false_alarm_rate, is_stated=is_stated,
            threads=threads,
        )  # fmt: skip
    reading = lattice.read(scan.points, threads=threads) if reading is None else reading
    is_told = lattice.is_told_exactly(scan, reading)
    num_unjudged = int(np.count_nonzero(~is_told & lattice.is_of_no_line(scan.points, reading)))
    kept = np.flatnonzero(is_told)
    told = scan.select(kept)
    reading = lattice.read(told.points, threads=threads)
    reading = without_roundings(reading, told.points, limits.tolerance)
    as_lines = _ranges_as_lines(reading, limits.tolerance)
    found = _examined(told.points, lattice, None, None, limits, as_lines, threads)
    judged = _judged(
        found, told, lattice, limits.tolerance, false_alarm_rate, is_stated=is_stated,
        reading=reading, num_unjudged=num_unjudged, threads=threads,
    )  # fmt: skip
    return judged.with_rows(kept, scan)


class _Limits(NamedTuple):
    """Largest deviations of clean points from the lattice; see `generic_consistency`."""

    tolerance: float = LINE_TOLERANCE
    range_incoherence: float = RANGE_INCOHERENCE
    azimuth_error: float = 0.0

    @classmethod
    def of(cls, lattice: SensorLattice) -> Self:
        """Return the limits for clean scans of a scanner."""
        share = EXACT_INCOHERENCE if lattice.is_exact else RANGE_INCOHERENCE
        return cls(lattice.tolerance, share)


def _examined(
    cloud: NDArray[np.float32],
    lattice: SensorLattice,
    previous: LidarFrame | ArrayLike | None,
    following: LidarFrame | ArrayLike | None,
    limits: _Limits,
    reading: LatticeReading | None,
    threads: int,
) -> Mapping[str, Any]:
    """Run the kernel. It looks up the points on the lattice if ``reading`` is None."""
    found: Mapping[str, Any] = _core.generic_consistency(
        cloud,
        lattice.table,
        lattice.steps,
        lattice.range_step,
        lattice.coordinate_step,
        *limits,
        _points_of(previous, "previous"),
        _points_of(following, "following"),
        threads_of(threads),
        None if reading is None else reading.columns,
    )
    return found


def _ranges_as_lines(reading: LatticeReading, tolerance: float) -> LatticeReading:
    """Return the reading with points off the range steps marked as off their lines.

    For an exact cloud, a range between the steps is evidence about a single point, like a distance
    from the line. The kernel judges ranges by windows of many points only, as rounded clouds need.
    """
    off = np.abs(reading.range_error) > tolerance
    return replace(reading, line_error=np.where(off, reading.range_error, reading.line_error))


def consistency_allowing(
    embedding: str,
    frame: LidarFrame | ArrayLike,
    lattice: SensorLattice,
    *,
    previous: LidarFrame | ArrayLike | None = None,
    following: LidarFrame | ArrayLike | None = None,
    reading: LatticeReading | None = None,
    units_per_m: int = MILLIMETRES,
    false_alarm_rate: float = 0.01,
    is_stated: bool = True,
    threads: int = 0,
) -> GenericResult:
    """Judge a frame by detector III, with limits that allow for the moves of a watermark.

    Parameters
    ----------
    embedding : str
        Embedding of the watermark, 'lbm' or 'qim', whose bits were removed (`without_bits`); empty:
        no watermark.
    reading : LatticeReading or None
        Places of the frame's points on the lattice; None: they are looked up. With an embedding
        they are looked up in any case, since its lattice has fewer steps.
    units_per_m : int
        Grid steps per metre of the embedding.
    is_stated : bool
        False: the lattice was estimated from the frame itself, so that contradictions are no sign
        of processing.
    """
    limits = _Limits.of(lattice)
    if embedding in ALLOWED:
        allowed = allowance(embedding, units_per_m)
        limits = _Limits(
            limits.tolerance + allowed.tolerance,
            allowed.range_incoherence or limits.range_incoherence,
            allowed.azimuth_error,
        )
        lattice, reading = allowing(lattice, embedding), None
    return _consistency(
        frame, lattice, previous, following, limits, reading, false_alarm_rate,
        is_stated=is_stated, threads=threads,
    )  # fmt: skip


def _points_of(frame: LidarFrame | ArrayLike | None, name: str) -> NDArray[np.float32]:
    if frame is None:
        return np.empty((0, 3), np.float32)
    points = frame.points if isinstance(frame, LidarFrame) else frame
    return as_rows(points, 3, np.float32, name)


def _log10_p(kind: str, strength: float, points: int) -> float:
    """Return log10 of an upper bound of the p-value: that a clean frame has such a region."""
    if strength <= 0.0:
        return 0.0
    if kind in EXPONENTIAL_TAILS:
        fewest, scale = EXPONENTIAL_TAILS[kind]
        log = (fewest - strength) / scale * math.log10(math.e)
    elif kind == "range":
        log = math.log10(WINDOWS) - strength * math.log10(math.e)
    elif kind in ("scattered", "copied"):
        log = -strength
    else:  # a region of `strength` stray points, see `generic_consistency`
        stray = max(points, 1) * STRAY_RATE
        log = math.log10(stray) + (strength - 1.0) * math.log10(NEIGHBOURS * STRAY_RATE)
    return min(0.0, log)


class _Suspects:
    """Places of a frame that were tested for an edit, and those that are too improbable.

    Parameters
    ----------
    points : (N, 3) float32
        Points of the frame.
    num_tests : int
        Number of tests of a place, for which its p-value is corrected.
    false_alarm_rate : float
        Places whose corrected p-value is at most this are accused.

    Attributes
    ----------
    log10_p, log10_p_corrected : list of float
        log10 p-values of all tested places, alone and corrected.
    regions : tuple of SuspectRegion
        Accused places.
    rows : (M,) int64
        Rows of their points.
    """

    def __init__(
        self, points: NDArray[np.float32], num_tests: int, false_alarm_rate: float
    ) -> None:
        self._points, self._false_alarm_rate = points, false_alarm_rate
        self._log10_tests = math.log10(num_tests)
        self.log10_p: list[float] = []
        self.log10_p_corrected: list[float] = []
        self.regions: tuple[SuspectRegion, ...] = ()
        self.rows: NDArray[np.int64] = np.empty(0, np.int64)

    def _corrected(self, log10_p: float) -> float:
        """Record the p-value of a place, and return it corrected."""
        corrected = min(0.0, self._log10_tests + log10_p)
        self.log10_p.append(log10_p)
        self.log10_p_corrected.append(corrected)
        return corrected

    def test_regions(self, found: Mapping[str, Any], rules: Mapping[str, str]) -> None:
        """Test each region of the kernel's answer by its strongest kind of evidence."""
        logs = [
            self._corrected(
                min(
                    _log10_p(rules.get(kind, kind), strength, len(self._points))
                    for kind, strength in zip(EVIDENCE, strengths, strict=True)
                )
            )
            for strengths, _, _ in found["regions"]
        ]
        accused = [i for i, log in enumerate(logs) if is_alarm(log, self._false_alarm_rate)]
        accused = _without_rests(found, accused)
        self.regions = tuple(
            _region(found["regions"][i], logs[i], _rows_of(found, i), found["flags"], self._points)
            for i in sorted(accused, key=lambda i: (logs[i], i))
        )
        self.rows = np.flatnonzero(np.isin(found["region_of_point"], accused))

    def test_together(self, kind: str, log10_p: float, places: Sequence[NDArray[np.int64]]) -> None:
        """Test places by one p-value; if they are too improbable, each becomes a region."""
        log = self._corrected(log10_p)
        if is_alarm(log, self._false_alarm_rate):
            new = (_region_of(rows, kind, log, log10_p, self._points) for rows in places)
            self.regions = (*self.regions, *new)
            self.rows = np.union1d(self.rows, np.concatenate(places))


def _judged(
    answer: Mapping[str, Any],
    scan: LidarFrame,
    lattice: SensorLattice,
    tolerance: float,
    false_alarm_rate: float,
    *,
    is_stated: bool,
    reading: LatticeReading | None = None,
    num_unjudged: int = 0,
    threads: int,
) -> GenericResult:
    """Return the verdict on a frame from the kernel's answer.

    ``reading``: places of the points on an exact lattice. ``num_unjudged``: number of points off
    all lines of an exact lattice that were not judged.
    """
    found = _known_exactly(answer) if lattice.is_exact else answer
    fewest = MIN_EXACT if lattice.is_exact else 2
    rules = {"time": "between"} if found["turns"] > 1 else {}
    evidence = _evidence_reports(found, rules, scan.num_points)
    num_tests = 1 + sum(report.used for report in evidence.values())
    suspects = _Suspects(scan.points, num_tests, false_alarm_rate)
    suspects.test_regions(found, rules)
    group = _scattered_group(found["flags"], scan.points, suspects.rows, fewest)
    limit, far_off = FAR_OFF * tolerance, (0.0, group[1][:0])
    if lattice.is_exact:
        far_off = _count_far_off_exactly(
            found["flags"], scan, suspects.rows, lattice, limit, threads
        )
    elif is_stated:
        far_off = _count_far_off(found["flags"], scan.points, suspects.rows, lattice, limit)
    log, rows = min(group, far_off, key=lambda log_and_rows: log_and_rows[0])
    suspects.test_together("scattered", log, (rows,))
    if reading is not None:
        suspects.test_together("copied", *_copied(scan.points, reading, lattice, suspects.rows))
    verdict = _quiet_verdict(evidence, found["directions"], is_stated)
    reason = IN_WORDS[verdict]
    if suspects.regions:
        verdict, reason = "tampered", _accusation(suspects.regions)
    elif lattice.is_exact and num_unjudged + len(far_off[1]) >= MIN_EXACT:
        verdict = "undecidable"
        few = FEW_FAR_OFF.format(num_unjudged + len(far_off[1]))
        reason = UNJUDGED.format(num_unjudged) if num_unjudged >= MIN_EXACT else few
    return GenericResult(
        verdict=verdict,
        reason=reason,
        p_value=10.0 ** min(suspects.log10_p_corrected, default=0.0),
        score=abs(min(suspects.log10_p, default=0.0)),
        false_alarm_rate=false_alarm_rate,
        evidence=evidence,
        regions=suspects.regions,
        suspected=suspects.rows,
        evidence_map=found["cells"].reshape(-1, _core.CELL_COLUMNS),
        lattice=lattice,
        scan=scan,
        rules=rules,
    )


def _accusation(regions: Sequence[SuspectRegion]) -> str:
    """The reason of ``tampered`` in words; a region without rows is one of missing returns."""
    copied = any("copied" in region.strength for region in regions)
    added = any(len(region.rows) and "copied" not in region.strength for region in regions)
    removed = any(not len(region.rows) for region in regions)
    return " and ".join([WRONG_PLACE] * added + [NO_RETURN] * removed + [REPEATED] * copied)


def _without_rests(found: Mapping[str, Any], alarming: list[int]) -> list[int]:
    """Leave out regions of a few points that windows of ranges around another region accuse.

    A window needs `MIN_INCOHERENT` incoherent ranges, so that a region with fewer has its strength
    from other points. All regions are kept if no other one is left.
    """
    size = np.bincount(found["region_of_point"] + 1, minlength=len(found["regions"]) + 1)[1:]
    others = np.array([kind != "range" for kind in EVIDENCE])
    kept = [
        i
        for i in alarming
        if size[i] >= MIN_INCOHERENT or np.asarray(found["regions"][i][0])[others].any()
    ]
    return kept or alarming


def _evidence_reports(
    found: Mapping[str, Any], rules: Mapping[str, str], points: int
) -> dict[str, EvidenceReport]:
    """Return the report of each kind of evidence, used or not."""
    reports = {}
    for kind, (dropped, share, strength) in zip(EVIDENCE, found["evidence"], strict=True):
        log = 0.0 if dropped else _log10_p(rules.get(kind, kind), strength, points)
        reports[kind] = EvidenceReport(
            not dropped, REASONS.get(dropped, ""), share, strength, 10.0**log
        )
    return reports


def _known_exactly(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the kernel's answer without the kinds of evidence that exact lattices lack.

    Dual-return scanners have two returns per firing, and each model writes its points in an order
    of its own, so that `firing`, `duplicate` and `order` prove nothing. Regions of fewer than
    `MIN_EXACT` points are dropped as well: a laser with one or two returns has no line.
    """
    known = [kind in KNOWN_EXACTLY for kind in EVIDENCE]
    evidence = [
        (dropped if is_known else "unknown", share, strength)
        for is_known, (dropped, share, strength) in zip(known, found["evidence"], strict=True)
    ]
    flags = found["flags"] & sum(1 << EVIDENCE.index(kind) for kind in KNOWN_EXACTLY)
    of_point = np.where(flags != 0, found["region_of_point"], -1)
    size = np.bincount(of_point[of_point >= 0], minlength=len(found["regions"]))
    regions = [
        (np.where(known, strengths, 0.0) if many >= MIN_EXACT else np.zeros(len(known)), *place)
        for many, (strengths, *place) in zip(size, found["regions"], strict=True)
    ]
    return {
        **found,
        "evidence": evidence,
        "regions": regions,
        "flags": flags,
        "region_of_point": of_point,
    }


def _quiet_verdict(
    evidence: Mapping[str, EvidenceReport], directions: int, is_stated: bool
) -> Verdict:
    """Return the verdict on a frame without evidence of an edit.

    Contradictions show processing only if the lattice was stated. A lattice that was estimated from
    the frame itself may be wrong, for example about the order of points in the scanner's files.
    """
    if not evidence["line"].used or directions < MIN_DIRECTIONS:
        return "undecidable"
    contradicted = any(said.reason == REASONS["contradicted"] for said in evidence.values())
    return "processed" if contradicted and is_stated else "no_trace"


OFF_LATTICE = sum(1 << EVIDENCE.index(kind) for kind in ("grid", "line", "step", "firing", "place"))
"""Bits of the kinds of evidence by which a point itself is forged. With the other kinds, clean
points are suspected as well: one of two returns of a firing, or the rest of a range window."""

KNOWN_EXACTLY, MIN_EXACT = ("line", "step", "range"), 5
"""Kinds of evidence that an exact lattice supports; smallest number of points of its regions."""

STRAYING = ("grid", "line", "step")
"""Kinds of evidence that concern a single point, without regard to its neighbours."""

GROUP = 0.5
"""Metres: size of the ground cells that `largest_group` connects."""


def _scattered_group(
    flags: NDArray[np.uint16],
    points: NDArray[np.float32],
    known: NDArray[np.int64],
    fewest: int,
) -> tuple[float, NDArray[np.int64]]:
    """Return the log10 p-value and rows of the least probable group of scattered stray points.

    A group is the stray points within `SCATTER` of one of them; the one with the most points is
    tested. The p-value bounds the probability that any of the N points is stray, and that so many
    of those around it are. Rows in ``known`` are ignored, and so are groups of fewer than
    ``fewest`` points.
    """
    bits = sum(1 << EVIDENCE.index(kind) for kind in STRAYING)
    rows = np.setdiff1d(np.flatnonzero(flags & bits), known)
    if not fewest <= len(rows) <= MAX_SCATTERED:
        return 0.0, rows[:0]
    away = points[rows, None].astype(np.float64) - points[None, rows]
    near = (away * away).sum(axis=2) <= SCATTER**2
    center = int(near.sum(axis=1).argmax())
    around = points.astype(np.float64) - points[rows[center]]
    crowd = int(np.count_nonzero((around * around).sum(axis=1) <= SCATTER**2))
    group = rows[near[center]]
    if len(group) < fewest:
        return 0.0, rows[:0]
    log = math.log10(len(points) * STRAY_RATE)
    return min(0.0, log + (len(group) - 1) * math.log10(crowd * STRAY_RATE)), group


def _count_far_off(
    flags: NDArray[np.uint16],
    points: NDArray[np.float32],
    known: NDArray[np.int64],
    lattice: SensorLattice,
    far_off: float,
) -> tuple[float, NDArray[np.int64]]:
    """Return the log10 p-value of the number of points far off the lattice, and their rows.

    The p-value is the bound ``mean**n / n!`` of the Poisson law for n points. Rows in ``known`` are
    ignored.
    """
    bits = sum(1 << EVIDENCE.index(kind) for kind in STRAYING)
    rows = np.setdiff1d(np.flatnonzero(flags & bits), known)
    if not 0 < len(rows) <= MAX_SCATTERED:
        return 0.0, rows[:0]
    reading = lattice.read(np.ascontiguousarray(points[rows]))
    off = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error))
    rows = rows[(off > far_off) | (reading.ring < 0)]
    return _log_poisson(len(rows), len(points) * STRAY_RATE), rows


def _count_far_off_exactly(
    flags: NDArray[np.uint16],
    scan: LidarFrame,
    known: NDArray[np.int64],
    lattice: SensorLattice,
    far_off: float,
    threads: int,
) -> tuple[float, NDArray[np.int64]]:
    """Return the same for an exact lattice; without a p-value, the rows of all points far off.

    For the p-value, points count only where no laser without a line may look; those nearer than
    `ALONE` to another one do not, nor do those at the same elevation as two others, as they may be
    points of such a laser. The mean allows for lasers with one or two points. There is none if only
    the order of the file tells rings.
    """
    points = scan.points
    bits = sum(1 << EVIDENCE.index(kind) for kind in STRAYING)
    rows = np.setdiff1d(np.flatnonzero(flags & bits), known)
    if not MIN_EXACT <= len(rows) <= MAX_SCATTERED:
        return 0.0, rows[:0]
    reading = lattice.read(np.ascontiguousarray(points[rows]))
    off = np.max(
        [np.abs(e) for e in (reading.line_error, reading.step_error, reading.range_error)], 0
    )
    between = rows[(off > far_off) & lattice.is_line_known(points[rows], reading)]
    rows = rows[off > far_off]
    is_single, lasers = lattice.single_points(scan)
    if is_single is None or len(between) < MIN_EXACT:
        return 0.0, rows
    apart = _core.nearest_distances(points, None, 0.0, threads_of(threads), None)[between] > ALONE
    number = int(np.count_nonzero(is_single[between] & apart))
    if number < MIN_EXACT:
        return 0.0, rows
    return _log_poisson(number, len(points) * EXACT_STRAY_RATE + 2 * lasers), between


def _log_poisson(number: int, mean: float) -> float:
    """Return log10 of ``mean**n / n!``, a bound on the probability of n events; 0 at most."""
    return min(0.0, number * math.log10(mean) - math.lgamma(number + 1.0) / math.log(10.0))


def _copied(
    points: NDArray[np.float32],
    reading: LatticeReading,
    lattice: SensorLattice,
    known: NDArray[np.int64],
) -> tuple[float, tuple[NDArray[np.int64], ...]]:
    """Return the log10 p-value and rows of two places of which one is a copy of the other.

    The number of runs of equal ranges at one turn is compared, by the Poisson law, with that of
    other turns. There is no p-value if most rows of one of the places are in ``known``: then the
    copy was found already, and the other place is the original.
    """
    found = turned_copy(points, reading, lattice)
    if found is None or any(2 * np.isin(at, known).sum() > len(at) for at in found.places):
        return 0.0, ()
    log = math.log10(TURNS) + _log_poisson(found.runs, found.elsewhere + 1.0)
    return min(0.0, log), found.places


def _region_of(
    rows: NDArray[np.int64], kind: str, log: float, strength: float, points: NDArray[np.float32]
) -> SuspectRegion:
    """Return the region of evidence whose strength is the log10 of its probability."""
    there = points[rows].astype(np.float64)
    low, high = (tuple(each(axis=0).tolist()) for each in (there.min, there.max))
    return SuspectRegion(10.0**log, {kind: -strength}, low, high, rows, tight_box(there))


def _rows_of(found: Mapping[str, Any], region: int) -> NDArray[np.int64]:
    return np.flatnonzero(found["region_of_point"] == region)


def _region(
    found: tuple[Any, Any, Any],
    log: float,
    rows: NDArray[np.int64],
    flags: NDArray[np.uint16],
    points: NDArray[np.float32],
) -> SuspectRegion:
    strengths, lower, upper = found
    speaking = {k: s for k, s in zip(EVIDENCE, strengths, strict=True) if s > 0.0}
    low, high = np.asarray(lower), np.asarray(upper)
    box = Box(tuple(((low + high) / 2).tolist()), tuple((high - low).tolist()))
    telling = rows[(flags[rows] & OFF_LATTICE) != 0]
    telling = rows if len(telling) < 10 else telling
    if len(telling):
        box = tight_box(largest_group(points[telling]))
    return SuspectRegion(10.0**log, speaking, tuple(lower), tuple(upper), rows, box)


def largest_group(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the points of the largest set of touching ground cells of `GROUP` metres.

    Parameters
    ----------
    points : (N, 3) float32, metres
        At least one.
    """
    cells = np.floor(points[:, :2].astype(np.float64) / GROUP).astype(np.int64)
    cells -= cells.min(axis=0)
    width = int(cells[:, 1].max()) + 2  # one empty column, so that row ends are not neighbours
    keys, of_point = np.unique(cells[:, 0] * width + cells[:, 1], return_inverse=True)
    neighbours = [
        (first, at[first])
        for step in (1, width - 1, width, width + 1)
        for at in [np.searchsorted(keys, keys + step).clip(max=len(keys) - 1)]
        for first in [np.flatnonzero(keys[at] == keys + step)]
    ]
    pairs = np.concatenate([np.column_stack(pair) for pair in neighbours])
    label = np.arange(len(keys))
    while True:  # spread the lowest label; `joined[joined]` halves the length of chains each time
        joined = label.copy()
        np.minimum.at(joined, pairs[:, 0], label[pairs[:, 1]])
        np.minimum.at(joined, pairs[:, 1], label[pairs[:, 0]])
        joined = joined[joined]
        if np.array_equal(joined, label):
            break
        label = joined
    group = label[of_point]
    kept: NDArray[np.float64] = points[group == np.bincount(group).argmax()].astype(np.float64)
    return kept


def tight_box(points: NDArray[np.float64]) -> Box:
    """Return the box of least ground area around points, rotated about z by whole degrees.

    Parameters
    ----------
    points : (N, 3) float64, metres
        At least one.
    """
    turns = np.radians(np.arange(90.0))
    cos, sin = np.cos(turns), np.sin(turns)
    along = np.outer(points[:, 0], cos) + np.outer(points[:, 1], sin)
    across = np.outer(points[:, 1], cos) - np.outer(points[:, 0], sin)
    area = (np.ptp(along, axis=0) + 0.05) * (np.ptp(across, axis=0) + 0.05)
    best = int(area.argmin())
    a, b = along[:, best], across[:, best]
    u, v = (a.min() + a.max()) / 2.0, (b.min() + b.max()) / 2.0
    z = points[:, 2]
    return Box(
        (
            float(u * cos[best] - v * sin[best]),
            float(u * sin[best] + v * cos[best]),
            float((z.min() + z.max()) / 2.0),
        ),
        (float(np.ptp(a)), float(np.ptp(b)), float(np.ptp(z))),
        float(turns[best]),
    )


def _undecidable(false_alarm_rate: float) -> GenericResult:
    nothing = EvidenceReport(False, REASONS["no lattice"], 0.0, 0.0, 1.0)
    return GenericResult(
        "undecidable",
        IN_WORDS["undecidable"],
        1.0,
        0.0,
        false_alarm_rate,
        dict.fromkeys(EVIDENCE, nothing),
        (),
        np.empty(0, np.int64),
        np.zeros((0, _core.CELL_COLUMNS), np.uint16),
        None,
    )
