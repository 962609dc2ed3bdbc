"""Judge scans on the lattice of a spinning scanner by detectors III, IV and V."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from manip3d.authenticate._carriers import rounding_of
from manip3d.authenticate._copies import (
    are_both_returns,
    are_fired_twice,
    copies_of_earlier,
    one_of_each,
)
from manip3d.authenticate._extent import Lacking
from manip3d.authenticate._generic import EVIDENCE, MISSING, GenericResult, consistency_allowing
from manip3d.authenticate._inspection import DetectorReport, Inspection
from manip3d.authenticate._known_power import known_power
from manip3d.authenticate._lattice import LatticeReading, SensorLattice
from manip3d.authenticate._no_returns import returns_of
from manip3d.authenticate._power import (
    BLIND,
    BLIND_ALONG_RAYS,
    BLIND_COPIED,
    BLIND_CUT,
    BLIND_CUT_ELSEWHERE,
    BLIND_EXACT,
    BLIND_EXACT_WITHOUT_STEPS,
    BLIND_OTHER_SCAN,
    BLIND_TURNED,
    BLIND_TURNED_ANYHOW,
    BLIND_WHOLE_STEPS,
    BLIND_WITHOUT_REFLECTANCES,
    BLIND_WITHOUT_STEPS,
    BLIND_WITHOUT_TURNS,
)
from manip3d.authenticate._processing import (
    COORDINATES_KEPT,
    STILL_COMPARED,
    TWO_SCANNERS,
    find_processing,
    padding,
)
from manip3d.authenticate._reflectance import ReflectanceResult, reflectances_read
from manip3d.authenticate._repeats import in_common, sketch_of
from manip3d.authenticate._reports import (
    combined,
    generic_report,
    not_applicable,
    reflectance_report,
    turns_report,
)
from manip3d.authenticate._sensors import HDL64E, Sensor
from manip3d.authenticate._silences import lacks_neighbouring_lasers, silent_lasers
from manip3d.authenticate._standpoint import Identified, at_origin
from manip3d.authenticate._turns import (
    FARTHEST,
    FARTHEST_MOTION,
    FOREIGN,
    MAX_APART_NS,
    TurnResult,
    apart_ns,
    no_turn,
    turns_read,
)
from manip3d.authenticate._verdict import Processing, rate_of
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Position = tuple[float, float, float]


Beside = tuple["LidarFrame | None", "LidarFrame | None"]
"""The previous and the following frame, one revolution apart."""

LeftOut: TypeAlias = "Callable[[LidarFrame, SensorLattice], Lacking | None]"
"""Function that tells why a turn may lack points, as `left_out_of_turn` does."""


class Case(NamedTuple):
    """A scan on the lattice of its scanner, and the data that all stages of its inspection need."""

    scan: LidarFrame
    position: Position
    source: str  # source of the position
    identified: Identified
    embedding: str  # of the verified watermark; empty: none
    units_per_m: int
    left_out: LeftOut
    threads: int

    @property
    def sensor(self) -> Sensor:
        return self.identified[0]

    @property
    def centred(self) -> LidarFrame:
        """The scan with the scanner at (0, 0, 0)."""
        return at_origin(self.scan, self.position)


def by_lattice(case: Case, beside: Beside) -> Inspection:
    """Judge the returns of a scan beside its neighbours, and report rows that are no returns."""
    sensor, reading = case.identified
    rows, padded = _returns_of(case.centred, sensor, reading)
    before, after = (_returns(turn, sensor) for turn in beside)
    if rows is None:
        return _returns_by_lattice(case, (before, after), padded)
    returns = case._replace(scan=case.scan.select(rows), identified=(sensor, None))
    judged = _returns_by_lattice(returns, (before, after), padded)
    return _with_rows(judged, rows, case.scan.replace(origin=case.position))


def _returns_of(
    scan: LidarFrame, sensor: Sensor, reading: LatticeReading | None
) -> tuple[NDArray[np.int64] | None, tuple[Processing, ...]]:
    return (None, ()) if sensor.lattice is None else returns_of(scan, sensor.lattice, reading)


def _returns(turn: LidarFrame | None, sensor: Sensor) -> LidarFrame | None:
    """The turn without the rows that are no returns."""
    if turn is None:
        return None
    rows, _ = _returns_of(turn, sensor, None)
    return turn if rows is None else turn.select(rows)


def _with_rows(found: Inspection, rows: NDArray[np.int64], scan: LidarFrame) -> Inspection:
    """The result on some rows of a scan as a result on the whole scan."""
    reports = tuple(
        replace(
            report,
            regions=tuple(replace(each, rows=rows[each.rows]) for each in report.regions),
            suspected=rows[report.suspected],
        )
        for report in found.detectors
    )
    generic, turns, reflectance = found.generic, found.turns, found.reflectance
    return replace(
        found,
        num_points=scan.num_points,
        detectors=reports,
        generic=None if generic is None else generic.with_rows(rows, scan),
        turns=None if turns is None else turns.with_rows(rows),
        reflectance=None if reflectance is None else reflectance.with_rows(rows),
        scan=scan,
    )


def _returns_by_lattice(case: Case, beside: Beside, padded: tuple[Processing, ...]) -> Inspection:
    """Judge by detectors III, IV and V, allowing for displacements by a verified embedding."""
    sensor, position, embedding = case.sensor, case.position, case.embedding
    centred = case.centred
    neighbours, why_not, repeats = _usable(centred, beside)
    generic, of_rows, once = _judged_by_lattice(case, centred, neighbours)
    sensor = _told_of_returns(sensor, centred, once)
    repeated_turns = tuple(Processing("repeated", detail) for detail in repeats)
    processing = of_rows + padded + padding(case.scan, sensor) + repeated_turns
    of_points = _processing_of_points(case, centred, generic, once)
    if padded and sensor.lattice is not None and sensor.lattice.is_exact:
        # Firings that were filled lack their returns, which explains single missing ones.
        of_points = tuple(step for step in of_points if step.kind != "thinned")
    processing += of_points
    if generic is not None and _changed(processing):
        generic = generic.without(_spoiled(generic, processing))
    compared = _Compared(None, None, (), why_not)
    is_repeated = any(step.kind == "repeated" for step in of_rows)
    if generic is not None and not is_repeated and _are_comparable(sensor, processing):
        compared = _compared(case, centred, neighbours, why_not, processing)
        processing += compared.processing
    reports = (
        *not_applicable(sensor, known_power("generic", sensor, embedding)),
        generic_report(generic, position, sensor, embedding),
        *turns_report(compared.turns, beside, compared.why_not, position, sensor, embedding),
        *reflectance_report(compared.reflectance, position, sensor, embedding),
    )
    if _is_part_of_turn(case.scan) and {step.kind for step in processing} == {"cropped"}:
        processing, reports = (), _reports_of_part(reports)
    return combined(
        case.scan, position, case.source, sensor, reports, processing, generic=generic,
        turns=compared.turns, reflectance=compared.reflectance,
        blind=_blind(sensor, reports),
    )  # fmt: skip


def _told_of_returns(sensor: Sensor, scan: LidarFrame, once: NDArray[np.int64] | None) -> Sensor:
    """The scanner, with a remark in its reason if both returns of each firing are in the file."""
    if once is None or sensor.lattice is None:
        return sensor
    copies = np.ones(scan.num_points, np.bool_)
    copies[once] = False
    if not are_both_returns(scan.points, copies, sensor.lattice):
        return sensor
    return replace(sensor, reason=f"{sensor.reason}; {BOTH_WRITTEN}")


BOTH_WRITTEN = (
    "each firing has two rows, one for each return, and equal rows were judged as one return"
)
"""Remark on scans whose driver writes both returns of all firings."""


def _blind(sensor: Sensor, reports: Sequence[DetectorReport]) -> tuple[str, ...]:
    """Classes of edits that no detector finds in this scan of a scanner.

    Reflectances that were judged are none, even if the power was not measured; see
    `Inspection.power_notes`.
    """
    blind = [*_blind_anyhow(sensor.lattice)]
    if not any(report.name == "turns" and report.power for report in reports):
        blind.append(BLIND_WITHOUT_TURNS)
    if sensor.lattice is not None:
        blind += _blind_on(sensor.lattice)
        blind.append(BLIND_CUT if sensor.name == HDL64E else BLIND_CUT_ELSEWHERE)
    judged = ("no_trace", "tampered")
    if not any(report.name == "reflectance" and report.verdict in judged for report in reports):
        blind.append(BLIND_WITHOUT_REFLECTANCES)
    return tuple(blind)


def _blind_anyhow(lattice: SensorLattice | None) -> tuple[str, ...]:
    """Classes of edits that no detector finds in any scan with such a lattice."""
    if lattice is None or not lattice.is_exact:
        return BLIND
    return BLIND_EXACT if lattice.steps else BLIND_EXACT_WITHOUT_STEPS


def _blind_on(lattice: SensorLattice) -> list[str]:
    """Classes of edits that leave points on a lattice."""
    if not lattice.is_exact:
        return [] if lattice.steps else [BLIND_WITHOUT_STEPS]
    if not lattice.range_step:
        turned = BLIND_COPIED if lattice.steps else BLIND_WITHOUT_STEPS
        return [BLIND_OTHER_SCAN, turned, BLIND_ALONG_RAYS]
    turned = BLIND_TURNED if lattice.steps else BLIND_TURNED_ANYHOW
    return [BLIND_OTHER_SCAN, turned, BLIND_WHOLE_STEPS]


def _processing_of_points(
    case: Case,
    centred: LidarFrame,
    generic: GenericResult | None,
    once: NDArray[np.int64] | None,
) -> tuple[Processing, ...]:
    """Find processing of all points; rounding by an embedding is attributed to the embedding."""
    sensor, reading = case.identified
    coarse = rounding_of(case.embedding, case.units_per_m)
    seen, reading = (centred, reading) if once is None else (centred.select(once), None)
    found = find_processing(seen.points, sensor, generic, seen.intensity, reading)
    return coarse + tuple(step for step in found if not (coarse and step.kind == "rounded"))


def _changed(processing: Sequence[Processing]) -> list[Processing]:
    """Steps of processing that removed or moved points, except in a sector of some lasers."""
    return [step for step in processing if step.kind not in (*COORDINATES_KEPT, "sector")]


def _are_comparable(sensor: Sensor, processing: Sequence[Processing]) -> bool:
    """Whether detectors IV and V know the scanner, and can judge the scan after its processing."""
    return sensor.name == HDL64E and all(
        step.kind in (*STILL_COMPARED, "sector") for step in processing
    )


class _Compared(NamedTuple):
    """Results of the detectors that compare a scan with its neighbouring turns."""

    turns: TurnResult | None
    reflectance: ReflectanceResult | None
    processing: tuple[Processing, ...]
    why_not: list[str]  # reasons why neighbouring turns were not used


def _compared(
    case: Case,
    centred: LidarFrame,
    neighbours: Beside,
    why_not: list[str],
    processing: Sequence[Processing],
) -> _Compared:
    """Judge by detectors IV and V, with the points that neighbouring turns still have."""
    before, after = compared = neighbours
    lacking: list[str] = []
    of_turns: tuple[Processing, ...] = ()
    if any(step.kind == "lasers" for step in _changed(processing)):
        compared = _in_lasers_of(centred, case.identified, compared, case.threads)
    if before is not None and after is not None and case.sensor.lattice is not None:
        lacking, are_in_place, of_turns = _lacking(neighbours, case.sensor.lattice, case.left_out)
        if not are_in_place:
            compared, why_not = (None, None), [*why_not, *lacking]
    turns, reflectance = _beside_turns(centred, case.identified, compared, lacking, case.threads)
    is_whole = not any(step.kind == "sector" for step in processing)
    if turns is not None and turns.foreign and is_whole:
        of_turns += (Processing("foreign", FOREIGN),)
    reflectance = _unless_foreign(reflectance, processing)
    if reflectance is not None and _lacks_lasers(centred, case.identified, processing):
        reflectance = replace(
            reflectance, verdict="undecidable", reason=LASERS_MISSING, regions=(),
            suspected=np.empty(0, np.int64),
        )  # fmt: skip
    if reflectance is not None and reflectance.rewritten:
        of_turns += (Processing("reflectances", reflectance.rewritten),)
    return _Compared(turns, reflectance, of_turns, why_not)


LASERS_MISSING = (
    "several lasers in a row are missing, without which reflectances differ more from turn to turn"
)
"""Reason of detector V. In drive 0002 without lasers 30 to 33 it called one of ten frames tampered:
its thresholds hold for whole scans, and for those without single lasers or the lowest ones."""


def _lacks_lasers(
    centred: LidarFrame, identified: Identified, processing: Sequence[Processing]
) -> bool:
    """Whether several lasers in a row are missing between others, everywhere or in a sector."""
    if any(step.kind == "sector" for step in processing):
        return True
    sensor, reading = identified
    if sensor.lattice is None or not any(step.kind == "lasers" for step in processing):
        return False
    return lacks_neighbouring_lasers(centred.points, sensor.lattice, reading)


def _unless_foreign(
    found: ReflectanceResult | None, processing: Sequence[Processing]
) -> ReflectanceResult | None:
    """The result of detector V, without ``no_trace`` if reflectances were processed."""
    why = next((step.detail for step in processing if step.kind == "reflectances"), None)
    if found is None or why is None or found.verdict != "no_trace":
        return found
    return replace(found, verdict="undecidable", reason=why)


def _reports_of_part(reports: tuple[DetectorReport, ...]) -> tuple[DetectorReport, ...]:
    """The reports on a partly recorded turn: undecidable, unless a detector accuses it."""
    if any(each.verdict == "tampered" for each in reports):
        return reports
    why = "the recording holds a part of this turn only"
    return tuple(DetectorReport(each.name, "undecidable", why) for each in reports)


def _is_part_of_turn(scan: LidarFrame) -> bool:
    """Whether the packets state that the turn is incomplete, as at the ends of a recording."""
    return scan.format is not None and scan.format.header.get("is_complete") is False


def _judged_by_lattice(
    case: Case, centred: LidarFrame, beside: Beside
) -> tuple[GenericResult | None, tuple[Processing, ...], NDArray[np.int64] | None]:
    """Result of detector III, processing of rows (repeated, regrouped), and the judged rows.

    The judged rows have each point once; None: all rows.
    """
    sensor, reading = case.identified
    if sensor.off_lattice != 0.0 or sensor.lattice is None:
        return None, (), None
    before, after = beside
    both = before is not None and after is not None  # detector IV then judges missing points
    judge = functools.partial(
        consistency_allowing,
        case.embedding,
        lattice=sensor.lattice,
        previous=None if both else before,
        following=None if both else after,
        units_per_m=case.units_per_m,
        false_alarm_rate=rate_of("generic"),
        is_stated=not sensor.is_own,
        threads=case.threads,
    )
    if sensor.is_own and not sensor.lattice.is_exact:
        judge = functools.partial(_where_told, judge, sensor.lattice)
    generic = judge(centred, reading=reading)
    rows = np.arange(centred.num_points)
    of_rows: tuple[Processing, ...] = ()
    copies = np.zeros(centred.num_points, np.bool_)
    if generic.evidence["duplicate"].share > 0.0:
        copies = copies_of_earlier(centred.points)
    if copies.any():
        reading = reading or sensor.lattice.read(centred.points, threads=case.threads)
        rows = np.flatnonzero(one_of_each(centred.points, copies, reading))
        generic = judge(centred.select(rows)).with_rows(rows, centred)
        if not _are_of_the_scanner(centred.points, copies, sensor.lattice):
            detail = f"{np.count_nonzero(copies)} points repeat another one"
            of_rows = (Processing("repeated", detail),)
    if number := _number_elsewhere(generic):
        scan = centred.select(rows)
        found = sensor.lattice.read(scan.points, threads=case.threads)
        order = np.lexsort((found.azimuth, found.ring))
        judged = judge(scan.select(order)).with_rows(rows[order], centred)
        generic = judged.without(("order",), quiet=judged.verdict)
        detail = f"{number} points stand elsewhere in the file than where the scanner writes them"
        of_rows = (*of_rows, Processing("regrouped", detail))
    return generic, of_rows, rows if copies.any() else None


def _are_of_the_scanner(
    points: NDArray[np.float32], copies: NDArray[np.bool_], lattice: SensorLattice
) -> bool:
    """Whether the scanner or its driver wrote the copies of points."""
    return any(check(points, copies, lattice) for check in (are_fired_twice, are_both_returns))


def _number_elsewhere(generic: GenericResult) -> int:
    """Number of points in regions whose only evidence is the order of the file.

    These points lie where the scanner measures. Sorting a file by distance, height or class also
    moves points within the file, and none of `EDITS` is found by the order alone.
    """
    if not generic.evidence["order"].used or generic.values_changed:
        return 0
    kept = {id(region.rows) for region in generic.without(("order",)).regions}
    return sum(len(region.rows) for region in generic.regions if id(region.rows) not in kept)


def _where_told(
    judge: Callable[[LidarFrame], GenericResult],
    lattice: SensorLattice,
    scan: LidarFrame,
    *,
    reading: LatticeReading | None = None,
) -> GenericResult:
    """Judge the points for which a lattice that was estimated from the scan itself is reliable.

    A lattice from a single scan is too uncertain for the evidence of voids, firings and places.
    """
    kept = np.flatnonzero(lattice.is_told_by_scan(scan.points, reading))
    judged = judge(scan.select(kept)).with_rows(kept, scan)
    return judged.without(("firing", "place", "void"), why="unknown", quiet="no_trace")


def _in_lasers_of(
    centred: LidarFrame, identified: Identified, beside: Beside, threads: int
) -> Beside:
    """The neighbouring turns without the lasers that are missing from the frame."""
    (sensor, reading), (before, after) = identified, beside
    if sensor.lattice is None or before is None or after is None:
        return beside
    lattice, silent = sensor.lattice, silent_lasers(centred.points, sensor.lattice, reading)

    def reduced(turn: LidarFrame) -> LidarFrame:
        ring = lattice.read(turn.points, threads=threads).ring
        return turn.select(np.flatnonzero(~np.isin(ring, silent)))

    return reduced(before), reduced(after)


def _beside_turns(
    centred: LidarFrame,
    identified: Identified,
    beside: Beside,
    lacking: Sequence[str],
    threads: int,
) -> tuple[TurnResult | None, ReflectanceResult | None]:
    """Results of detectors IV and V, if the frame has the data that they need.

    Neighbouring turns that are not whole can show that points are missing from the frame, but
    points that are missing from them prove nothing.
    """
    (sensor, reading), (before, after) = identified, beside
    if sensor.lattice is None:
        return None, None
    turns, seen = None, None
    if before is not None and after is not None:
        turns, seen = turns_read(
            reading, centred, before, after, sensor.lattice,
            false_alarm_rate=rate_of("turns"), whole_turns=not lacking, threads=threads,
        )  # fmt: skip
        if lacking and turns.verdict == "no_trace":
            turns = replace(turns, verdict="undecidable", reason="; ".join(lacking))
    if centred.intensity is None:
        return turns, None
    is_alone = turns is None or bool(lacking)
    reflectance = reflectances_read(
        reading, centred, sensor.lattice, previous=None if is_alone else before,
        following=None if is_alone else after, turns=None if is_alone else turns,
        false_alarm_rate=rate_of("reflectance"), threads=threads, seen=seen,
    )  # fmt: skip
    return turns, reflectance


_NO_SKETCH = sketch_of(np.empty((0, 3), np.float32))


def _usable(scan: LidarFrame, beside: Beside) -> tuple[Beside, list[str], list[str]]:
    """The usable neighbours; why others are not usable; which of these have the points of a turn.

    No two turns of a scanner have the same points. A stalled recorder, or somebody who inserts a
    turn twice, writes such turns, and their comparison shows nothing.
    """
    kept: list[LidarFrame | None] = []
    why, repeats = [], []
    if all(other is None for other in beside):
        return beside, [], []
    own = sketch_of(scan.points)
    others = [_NO_SKETCH if each is None else sketch_of(each.points) for each in beside]
    for other, sketch, name in zip(beside, others, ("before", "after"), strict=True):
        kept.append(None)
        if other is None:
            continue
        apart = apart_ns(scan, other)
        if same := in_common(own, sketch):
            repeats.append(f"the turn {name} has {same}")
        elif apart > MAX_APART_NS:
            why.append(no_turn(name, apart))
        else:
            kept[-1] = other
    before, after = kept
    if before is not None and after is not None and (same := in_common(*others)):
        before = after = None
        repeats.append(f"the turns before and after have {same}")
    return (before, after), repeats + why, repeats


def _lacking(
    beside: Beside, lattice: SensorLattice, left_out: LeftOut
) -> tuple[list[str], bool, tuple[Processing, ...]]:
    """Reasons why neighbouring turns may lack points, whether the rest is in place, and processing.

    Processing of neighbours is reported because it can hide edits of the frame. It is not reported
    for the incomplete turns at the ends of a recording of packets, which nobody cropped, and for
    cuts beyond the reach of detector IV, which hide nothing from it.
    """
    why: list[str] = []
    processing: list[Processing] = []
    are_in_place = True
    for turn, name in zip(beside, ("before", "after"), strict=True):
        if turn is None or (lacking := left_out(turn, lattice)) is None:
            continue
        why.append(f"the turn {name} was {lacking.reason}")
        are_in_place &= lacking.is_in_place
        if not _is_part_of_turn(turn) and lacking.whole_up_to_m < FARTHEST + FARTHEST_MOTION:
            processing.append(Processing("neighbours", why[-1]))
    return why, are_in_place, tuple(processing)


def _spoiled(generic: GenericResult, processing: Sequence[Processing]) -> Sequence[str]:
    """Kinds of evidence that are invalid for a scan that was processed as a whole."""
    is_blurred = any(step.kind == "averaged" or step.detail == TWO_SCANNERS for step in processing)
    if generic.values_changed or is_blurred:
        return EVIDENCE
    is_fused = any(step.kind == "fused" for step in processing)
    return (*MISSING, "duplicate", "order") if is_fused else MISSING
