"""Detector III: has a LiDAR scan been edited, judged from the scan alone?"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.showing import Showable
from manip3d.authenticate._carriers import ALLOWED, MILLIMETRES, allowance, allowing
from manip3d.authenticate._lattice import LINE_TOLERANCE, SensorLattice
from manip3d.authenticate._lattice_estimate import estimate_lattice, without_roundings
from manip3d.authenticate._verdict import NO_POWER, Calibration, Power, Verdict
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

NUM_TESTS = len(EVIDENCE) + 1
"""Tests of a frame, at most: the kinds of evidence, and the points that are scattered."""

MISSING = ("void", "time", "firing")
"""Kinds of evidence that stand on returns that are not there, or on how many of a firing are."""

STRAY_RATE = 1e-5
"""Points of a clean frame, at most, that contradict the lattice for no reason: none of the 2.5
million of KITTI's drive 0002 and two other drives does, so it is below 1.2e-6 (95 %)."""

NEIGHBOURS = 100
"""Points among which a second stray point would be taken for a neighbour of a first."""

SCATTER, MOST_SCATTERED = 1.5, 1000
"""Metres around a point off its line or step in which others make a group, though they do not
touch; points that are compared with each other at most, a fiftieth of what makes a regular
region."""

FAR_OFF = 2.5
"""Times the tolerance. No point of 43 frames of nine drives of KITTI, 5.3 million, is so far
from its line or step. Strays of one frame may have one cause, which 43 frames cannot rule out: with
`STRAY_RATE`, 17 times what so many points allow (95 %), a frame may have several of them."""

WINDOWS = 1_000_000
"""Windows of ranges that might be tested in a frame of 64 lasers: three around each voxel."""

DRIFT_FEWEST, DRIFT_SCALE = 5.0, 0.84
"""The largest drift of a window in a clean frame exceeds ``s`` deviations with probability
exp((5 - s) / 0.84) at most: with seven kinds of evidence 10.5 deviations alarm at 1 %. Rounding to
whole millimetres is alike along a ring on level ground, so that windows stray farther than chance:
of 41 frames of four drives of KITTI that chose the scale the largest has 8.3, one more than 8."""

VOID_FEWEST, VOID_SCALE = 8.0, 55.0
"""The largest voids of a clean frame reach ``s`` firings with probability exp((8 - s) / 55) at
most. That is what simulated streets show, whose dark cars return nothing at all: of 40 frames the
median is 40, a tenth is above 140, the largest has 245. Of 21 real frames of three drives 20 have
none and one has 12; cars that swallow all light are rare there, but they are not forgeries."""

TIME_FEWEST, TIME_SCALE = 8.0, 25.0
"""Limits where a previous frame was answered: of 36 simulated pairs the median is 12, the largest
has 80; of 21 real pairs 20 have none and one has 13."""

BETWEEN_FEWEST, BETWEEN_SCALE = 10.0, 150.0
"""Limits between two frames that were both answered, after holes that moved are taken off. The
scale was chosen on 17 simulated frames, whose dark cars return nothing at all: the largest holes
have 982, 338 and 109. Of 44 other simulated frames (streets 1000 to 1021 and 2000 to 2021), which
chose nothing, none is accused; the largest holes have 561, 297 and 199. Of 33 real frames 32 have
none and one has 10. It costs power: of 18 objects removed in drive 0005 about 2 are found."""

EXPONENTIAL_TAILS = {
    "drift": (DRIFT_FEWEST, DRIFT_SCALE),
    "void": (VOID_FEWEST, VOID_SCALE),
    "time": (TIME_FEWEST, TIME_SCALE),
    "between": (BETWEEN_FEWEST, BETWEEN_SCALE),
}
"""Kinds whose strength ``s`` clean frames reach with probability exp((fewest - s) / scale)."""

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
    "tampered": "points lie where the sensor cannot measure",
    "processed": "the whole scan contradicts a part of the sensor's lattice",
    "undecidable": "the scan does not stand on the lattice of a spinning scanner",
}
"""Reasons of the verdicts."""


@dataclass(frozen=True)
class EvidenceReport:
    """Result of detector III for one kind of evidence, such as ``line`` or ``void``, on a frame.

    Attributes
    ----------
    used : bool
        Whether this kind counts for the verdict. A kind that does not apply to the frame, or that
        the whole frame contradicts, is left out.
    reason : str
        Why it was left out; empty if it was used.
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
        Probability, at most, that a clean frame has a region with as much.
    strength : mapping of str to float
        By kind of evidence; those that say nothing are left out. ``scattered``: -log10 of the
        probability that points off the lattice lie so near to each other, or that there are so
        many of them in all.
    lower, upper : (float, float, float)
        Metres: axis-parallel box of the suspected points, or of where removed ones stood.
    rows : (K,) int64
        Rows of the suspected points; none where points were removed.
    box : Box
        The tight box, rotated about the vertical, of what was edited: of its largest group of
        points that stand where the sensor cannot measure; else the box between the corners above.
    """

    p_value: float
    strength: Mapping[str, float]
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    rows: NDArray[np.int64]
    box: Box


@dataclass(frozen=True, eq=False)
class GenericResult(Showable):
    """Result of detector III for a frame; see :func:`generic_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
        ``processed``: the whole frame contradicts a kind of evidence that the lattice knows, so
        that an edit may have gone unseen.
    reason : str
        In words.
    p_value : float
        Probability, at most, that a clean frame shows evidence as strong; the verdict is
        ``tampered`` where it does not exceed ``false_alarm_rate``.
    score : float
        For ranking: ``-log10`` of the smallest p-value of a region and a kind of evidence, before
        their number is allowed for, and without the limits of floating point.
    false_alarm_rate : float
        As asked for.
    evidence : mapping of str to EvidenceReport
        Each kind, used or not.
    regions : tuple of SuspectRegion
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the most significant
        first.
    suspected : (K,) int64
        Rows of the points with evidence in those regions.
    evidence_map : (R, C) uint16
        Items of evidence by direction: two lasers a row, the highest first; columns
        counter-clockwise from straight ahead.
    lattice : SensorLattice or None
        Lattice by which the frame was judged.
    scan : LidarFrame or None
        What was judged, so that the result can be shown.
    rules : mapping of str to str
        Rule for the p-value of a kind of evidence, where it is not the kind's own: that of ``time``
        is ``between`` if the frames before and after were both given.
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

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty: it depends on the scanner, see `inspect`."""
        return NO_POWER

    @property
    def calibration(self) -> Calibration | None:
        """None: what is clean follows from the lattice, not from thresholds fixed on scans."""
        return None

    @property
    def contradicted(self) -> frozenset[str]:
        """Kinds of evidence that the whole frame contradicts: it was processed."""
        why = REASONS["contradicted"]
        return frozenset(kind for kind, said in self.evidence.items() if said.reason == why)

    @property
    def values_changed(self) -> bool:
        """Whether coordinates were changed everywhere: then no point tells of itself."""
        return bool(self.contradicted & {"grid", "line", "step", "place", "range"})

    def with_rows(self, rows: NDArray[np.int64], scan: LidarFrame) -> GenericResult:
        """Return the result for a scan of which only some points were judged.

        Parameters
        ----------
        rows : (N,) int64
            Row of ``scan`` of each point that was judged.
        scan : LidarFrame
        """
        regions = tuple(replace(region, rows=rows[region.rows]) for region in self.regions)
        return replace(self, regions=regions, suspected=np.sort(rows[self.suspected]), scan=scan)

    def without(
        self, kinds: Collection[str], *, why: str = "processed", quiet: Verdict = "processed"
    ) -> GenericResult:
        """Return the result as it is without some kinds of evidence.

        Parameters
        ----------
        kinds : collection of str
            Kinds of evidence that stand on what a frame as a whole no longer has.
        why : str
            Key of `REASONS`: why they are left out.
        quiet : Verdict
            Verdict of a frame that was judged and has no other evidence.
        """
        points = 0 if self.scan is None else self.scan.num_points
        tests = math.log10(1 + sum(said.used for said in self.evidence.values()))
        if not set(STRAYING).isdisjoint(kinds):
            kinds = (*kinds, "scattered")
        kept = []
        for region in self.regions:
            strength = {k: s for k, s in region.strength.items() if k not in kinds}
            logs = [_log10_p(self.rules.get(k, k), s, points) for k, s in strength.items()]
            best = min(logs, default=0.0)
            log = min(0.0, tests + best)
            if 10.0**log <= self.false_alarm_rate:
                kept.append(replace(region, p_value=10.0**log, strength=strength))
        evidence = {
            kind: replace(said, used=False, reason=REASONS[why])
            if kind in kinds and said.used
            else said
            for kind, said in self.evidence.items()
        }
        rows = [region.rows for region in kept]
        if self.verdict == "undecidable":
            quiet = "undecidable"
        return replace(
            self,
            verdict="tampered" if kept else quiet,
            reason=IN_WORDS["tampered" if kept else quiet],
            p_value=min((region.p_value for region in kept), default=1.0),
            score=self.score if kept else 0.0,
            evidence=evidence,
            regions=tuple(kept),
            suspected=np.unique(np.concatenate(rows)) if rows else np.empty(0, np.int64),
        )


RANGE_INCOHERENCE, EXACT_INCOHERENCE = 0.12, 0.02
"""Share of clean points, at most, whose range is more than a quarter step off: whole millimetres
leave 0.06 to 0.09 in KITTI, single precision leaves none."""

FEWEST_DIRECTIONS = 1000
"""Fewest pairs of laser and step that answered in a frame that can be judged; copies are one."""


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
    """Look for edits of one scan of a spinning LiDAR: detector III.

    Parameters
    ----------
    frame : LidarFrame or (N, 3) points
        Metres, the scanner at the origin, the points in the order of its file.
    lattice : SensorLattice, optional
        Lattice of the scanner, from :func:`estimate_lattice` on clean scans; else it is estimated
        from the frame itself, which takes some tenths of a second.
    previous : LidarFrame or (N, 3) points, optional
        The frame a turn earlier: what was answered then is missed now.
    following : LidarFrame or (N, 3) points, optional
        The frame a turn later, in the same sense; beside ``previous`` it must have answered, too.
    false_alarm_rate : float
        Share of clean frames that may be called tampered; in (0, 1).
    tolerance : float, metres, optional
        How far from its line and step a point may be; by default that of the lattice. Coordinates
        of whole millimetres leave 0.8 mm, of 2 that are allowed.
    range_incoherence : float, optional
        Share of clean points, at most, whose range is more than a quarter of the scanner's step off
        a whole number of steps; in (0, 0.5). By default 0.12, of an exact lattice 0.02: whole
        millimetres leave 0.06 to 0.09 in KITTI.
    azimuth_error : float, metres
        How far along the arc points may have been moved, besides rounding to whole millimetres;
        where half a step of the encoder is shorter, nothing is said of a point's firing.
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
    Every return of an HDL-64E lies on one of 64 lines, at a step of the encoder at which the whole
    head fired, at a range that is a whole number of 2 mm; each laser has at most one return per
    firing, and KITTI's files list them in a fixed order. What is pasted, moved, turned or dented
    breaks one or several of these; what is moved along rays from the scanner's centre by
    centimetres leaves the lines by less than they are rounded to, and all points the same way
    (``drift``). Its coordinates are rounded a second time, or its ranges lie between those that the
    laser prints, so that a share of the points are not roundings of any place where their laser can
    have measured (``place``); what is removed leaves firings into the ground without a return,
    above ground that answered, with answers to both sides.
    Evidence that the whole frame contradicts (a motion-compensated cloud is on no lattice) is
    dropped, with all that stands on it. A frame without alarm whose lines were dropped is
    undecidable.

    Single points that stray by chance are allowed for: of ``m`` neighbouring ones,
    ``N * STRAY_RATE * (NEIGHBOURS * STRAY_RATE)**(m - 1)`` are expected. Of points off their lines
    or steps that do not touch, the same is asked of those within 1.5 m (``scattered``), and how
    many there are in all that are farther off than 2.5 times the tolerance. Kinds of evidence are
    combined by their smallest p-value times their number (Bonferroni).

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import generic_consistency, kitti_lattice
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 2000), 2000)  # every second step of the encoder
    >>> distance = 8 + 0.002 * count + lattice.range_phase[ring]  # a wall around it
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
    """Judge a frame; of an exact lattice, the points that it tells of."""
    cloud = _points_of(frame, "points")
    scan = (
        frame if isinstance(frame, LidarFrame) else LidarFrame(cloud.copy(), origin=(0.0, 0.0, 0.0))
    )
    if not lattice.is_exact:
        found = _examined(cloud, lattice, previous, following, limits, reading, threads)
        return _judged(
            found, scan, lattice, limits.tolerance, false_alarm_rate, is_stated=is_stated
        )
    kept = np.flatnonzero(lattice.is_told_exactly(scan, reading))
    told = scan.select(kept)
    reading = lattice.read(told.points, threads=threads)
    reading = without_roundings(reading, told.points, limits.tolerance)
    reading = _ranges_as_lines(reading, limits.tolerance)
    found = _examined(told.points, lattice, None, None, limits, reading, threads)
    judged = _judged(found, told, lattice, limits.tolerance, false_alarm_rate, is_stated=is_stated)
    return judged.with_rows(kept, scan)


class _Limits(NamedTuple):
    """How far clean points may lie off the lattice; see `generic_consistency`."""

    tolerance: float = LINE_TOLERANCE
    range_incoherence: float = RANGE_INCOHERENCE
    azimuth_error: float = 0.0

    @classmethod
    def of(cls, lattice: SensorLattice) -> Self:
        """The limits for clean scans of a scanner."""
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
    """Run the kernel, which also reads the lattice where that was not done."""
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
    """The reading with what is off the ranges said to be off its line: it tells of a point alone.

    Rounding leaves windows of ranges for it to tell; an exact cloud has none.
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
    """Return what detector III says of a frame with what an embedding moved allowed for.

    Parameters
    ----------
    embedding : str
        'lbm' or 'qim', of points `without_bits`; empty: none.
    reading : LatticeReading or None
        Where the frame's points lie on the lattice; None: it is read here. With an embedding it is
        read anew: its lattice knows fewer steps.
    units_per_m : int
        Steps a metre of the embedding's grid.
    is_stated : bool
        False: the lattice was read off the frame itself, so that what contradicts it is not a sign
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
    """Return log10 of an upper bound of the probability that a clean frame has such a region."""
    if strength <= 0.0:
        return 0.0
    if kind in EXPONENTIAL_TAILS:
        fewest, scale = EXPONENTIAL_TAILS[kind]
        log = (fewest - strength) / scale * math.log10(math.e)
    elif kind == "range":
        log = math.log10(WINDOWS) - strength * math.log10(math.e)
    elif kind == "scattered":
        log = -strength
    else:  # stray points among their neighbours
        stray = max(points, 1) * STRAY_RATE
        log = math.log10(stray) + (strength - 1.0) * math.log10(NEIGHBOURS * STRAY_RATE)
    return min(0.0, log)


def _judged(
    found: Mapping[str, Any],
    scan: LidarFrame,
    lattice: SensorLattice,
    tolerance: float,
    false_alarm_rate: float,
    *,
    is_stated: bool,
) -> GenericResult:
    """Return the verdict on a frame from what the kernel found in it.

    ``best`` are log10 p-values of the regions alone; ``logs`` allow for the number of kinds.
    """
    points, fewest = scan.num_points, 2
    if lattice.is_exact:
        found, fewest = _known_exactly(found), FEWEST_EXACT
    rules = {"time": "between"} if found["turns"] > 1 else {}
    evidence = _evidence_reports(found, rules, points)
    tests = math.log10(1 + sum(report.used for report in evidence.values()))
    best = [
        min(_log10_p(rules.get(k, k), s, points) for k, s in zip(EVIDENCE, strengths, strict=True))
        for strengths, _, _ in found["regions"]
    ]
    logs = [min(0.0, tests + log) for log in best]
    alarming = [i for i, log in enumerate(logs) if 10.0**log <= false_alarm_rate]
    regions = tuple(
        _region(found["regions"][i], logs[i], _rows_of(found, i), found["flags"], scan.points)
        for i in sorted(alarming, key=lambda i: (logs[i], i))
    )
    suspected = np.flatnonzero(np.isin(found["region_of_point"], alarming))
    log, rows = _scattered(found["flags"], scan.points, suspected, fewest)
    if is_stated and not lattice.is_exact:
        strewn = _strewn(found["flags"], scan.points, suspected, lattice, FAR_OFF * tolerance)
        log, rows = min((log, rows), strewn, key=lambda of_rows: of_rows[0])
    best.append(log)
    logs.append(min(0.0, tests + log))
    if 10.0 ** logs[-1] <= false_alarm_rate:
        regions = (*regions, _scattered_region(logs[-1], log, rows, scan.points))
        suspected = np.union1d(suspected, rows)
    quiet = _quiet_verdict(evidence, found["directions"], is_stated)
    verdict: Verdict = "tampered" if regions else quiet
    return GenericResult(
        verdict,
        IN_WORDS[verdict],
        10.0 ** min(logs, default=0.0),
        abs(min(best, default=0.0)),
        false_alarm_rate,
        evidence,
        regions,
        suspected,
        found["cells"].reshape(-1, _core.CELL_COLUMNS),
        lattice,
        scan,
        rules,
    )


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
    """The kernel's answer, without the kinds of evidence that an exact lattice does not know.

    Some scanners state two returns of a firing, and each writes its points in another order. A
    laser that answered once or twice has no line, so that few points are not evidence.
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
        (np.where(known, strengths, 0.0) if many >= FEWEST_EXACT else np.zeros(len(known)), *place)
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
    """What a frame without evidence is: only kinds of evidence that were used could object.

    A lattice that was read off the frame itself does not know the order of the scanner's files, for
    one: what contradicts it is not a sign of processing.
    """
    if not evidence["line"].used or directions < FEWEST_DIRECTIONS:
        return "undecidable"
    contradicted = any(said.reason == REASONS["contradicted"] for said in evidence.values())
    return "processed" if contradicted and is_stated else "no_trace"


OFF_LATTICE = sum(1 << EVIDENCE.index(kind) for kind in ("grid", "line", "step", "firing", "place"))
"""Bits of the kinds that are said of a forged point itself: of two returns of one firing one is
clean, and windows of ranges reach beyond the object."""

KNOWN_EXACTLY, FEWEST_EXACT = ("line", "step", "range"), 5
"""Kinds of evidence that an exact lattice knows, and fewest points of a region off it."""

STRAYING = ("grid", "line", "step")
"""Kinds that are said of a point alone, wherever it is."""

GROUP = 0.5
"""Metres between suspected points of one object."""


def _scattered(
    flags: NDArray[np.uint16],
    points: NDArray[np.float32],
    known: NDArray[np.int64],
    fewest: int,
) -> tuple[float, NDArray[np.int64]]:
    """The group of points off the lattice, apart from each other, that chance explains least.

    Its log10 p-value: that one of all points strays, and so many of those around it. Rows of
    ``known`` are in no group, nor are fewer than ``fewest``.
    """
    bits = sum(1 << EVIDENCE.index(kind) for kind in STRAYING)
    rows = np.setdiff1d(np.flatnonzero(flags & bits), known)
    if not fewest <= len(rows) <= MOST_SCATTERED:
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


def _strewn(
    flags: NDArray[np.uint16],
    points: NDArray[np.float32],
    known: NDArray[np.int64],
    lattice: SensorLattice,
    far_off: float,
) -> tuple[float, NDArray[np.int64]]:
    """The points far off the lattice, wherever they are, and the log10 p-value of their number.

    That is the Poisson law's bound ``mean**n / n!``. Rows of ``known`` do not count.
    """
    bits = sum(1 << EVIDENCE.index(kind) for kind in STRAYING)
    rows = np.setdiff1d(np.flatnonzero(flags & bits), known)
    if not 0 < len(rows) <= MOST_SCATTERED:
        return 0.0, rows[:0]
    reading = lattice.read(np.ascontiguousarray(points[rows]))
    off = np.maximum(np.abs(reading.line_error), np.abs(reading.step_error))
    rows = rows[(off > far_off) | (reading.ring < 0)]
    mean = len(points) * STRAY_RATE
    log = len(rows) * math.log10(mean) - math.lgamma(len(rows) + 1.0) / math.log(10.0)
    return min(0.0, log), rows


def _scattered_region(
    log: float, strength: float, rows: NDArray[np.int64], points: NDArray[np.float32]
) -> SuspectRegion:
    there = points[rows].astype(np.float64)
    low, high = (tuple(each(axis=0).tolist()) for each in (there.min, there.max))
    return SuspectRegion(10.0**log, {"scattered": -strength}, low, high, rows, tight_box(there))


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
    """Return the points of the largest set that is connected over `GROUP` metres, seen from above.

    Parameters
    ----------
    points : (N, 3) float32, metres
        At least one.
    """
    cells = np.floor(points[:, :2].astype(np.float64) / GROUP).astype(np.int64)
    cells -= cells.min(axis=0)
    width = int(cells[:, 1].max()) + 2  # a column stays free: rows do not touch around their ends
    keys, of_point = np.unique(cells[:, 0] * width + cells[:, 1], return_inverse=True)
    neighbours = [
        (first, at[first])
        for step in (1, width - 1, width, width + 1)
        for at in [np.searchsorted(keys, keys + step).clip(max=len(keys) - 1)]
        for first in [np.flatnonzero(keys[at] == keys + step)]
    ]
    pairs = np.concatenate([np.column_stack(pair) for pair in neighbours])
    label = np.arange(len(keys))
    while True:  # the lowest label wins; a turn halves what is left of a chain
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
