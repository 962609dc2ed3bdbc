"""All detectors together: `inspect` runs each that can judge a scan."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import reporting, sharing
from manip3d.authenticate._carriers import (
    ALLOWED,
    MILLIMETRES,
    find_carrier,
    rounding_of,
    trace_of,
    without_bits,
)
from manip3d.authenticate._copies import are_fired_twice, copies_of_earlier, one_of_each
from manip3d.authenticate._density import PAPER_DENSITY, DensityResult, density_consistency
from manip3d.authenticate._extent import Lacking, left_out_of_turn
from manip3d.authenticate._generic import (
    EVIDENCE,
    IN_WORDS,
    MISSING,
    GenericResult,
    consistency_allowing,
)
from manip3d.authenticate._inspection import DetectorReport, Inspection, combined_verdict
from manip3d.authenticate._keys import KeyFile, KeyRing
from manip3d.authenticate._lattice import LatticeReading, SensorLattice
from manip3d.authenticate._no_returns import returns_of
from manip3d.authenticate._occlusion import (
    PAPER_OCCLUSION,
    OcclusionResult,
    estimate_grid,
    occlusion_consistency,
)
from manip3d.authenticate._origin import (
    LEAST_EXPLAINED,
    estimate_origin,
    is_on_map,
    several_sources,
)
from manip3d.authenticate._power import (
    BLIND,
    BLIND_TERRESTRIAL,
    BLIND_WITHOUT_REFLECTANCES,
    EDITS,
    known_power,
    measure_power,
)
from manip3d.authenticate._processing import (
    COORDINATES_KEPT,
    STILL_COMPARED,
    find_processing,
    padding,
)
from manip3d.authenticate._reflectance import ReflectanceResult, reflectances_read
from manip3d.authenticate._repeats import in_common, sketch_of
from manip3d.authenticate._sensors import (
    HDL64E,
    NOT_IN_METRES,
    Sensor,
    height_above_origin,
    identify_and_read,
    is_in_metres,
    nothing_to_tell,
)
from manip3d.authenticate._silences import silent_lasers
from manip3d.authenticate._turns import (
    FARTHEST,
    FARTHEST_MOTION,
    FOREIGN,
    MOST_APART_NS,
    TurnResult,
    turns_read,
)
from manip3d.authenticate._verdict import (
    NO_POWER,
    Calibration,
    Power,
    Processing,
    Region,
    Verdict,
    rate_of,
)
from manip3d.authenticate._watermark import Policy, Watermarker, WatermarkResult
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, ScanLike, as_frame
from manip3d.lidar import place as position_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress

    Position = tuple[float, float, float]

FORENSIC = ("density", "occlusion", "generic")
"""Detectors I, II and III, which look at the scan alone."""

LATTICE_CALIBRATION = Calibration(
    "simulated streets 80000 to 80050, ten frames each, which fixed no threshold: those stand on "
    "how KITTI's scanner measures",
    510,
    0,
    "Below a p-value of 1 / 511 the rate of false alarms was not measured; it is what points that "
    "strayed alone would have.",
)
"""The clean frames that detector III was asked about: its p-values below 1 / 511 are a model's, and
`inspect` states none that is smaller."""

EXACT_CALIBRATION = Calibration(
    "simulated streets 90000 to 91019, one turn each of a Hesai Pandar40P, a PandarXT-32 or an "
    "Ouster OS1-32, which fixed no threshold: single precision does",
    1020,
    0,
    "Of five real clouds of five such scanners no point is off its own lattice.",
)
"""The clean frames that detector III was asked about whose lattices are exact."""

SENSORS = ("auto", "lattice", "terrestrial", "other")
"""Kinds of scanner that a caller can name; ``auto``: `identify_sensor` finds out."""


@checked
def inspect(
    frame: ScanLike,
    *,
    previous: ScanLike | None = None,
    following: ScanLike | None = None,
    lattice: SensorLattice | None = None,
    sensor: str = "auto",
    origin: ArrayLike | None = None,
    watermark: bytes | WatermarkResult | None = None,
    key: KeyFile | KeyRing | None = None,
    power: bool = True,
    plant: int = 0,
    printed: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> Inspection:
    """Judge whether a LiDAR scan was edited, by the detectors that can judge its scanner.

    Parameters
    ----------
    frame : LidarFrame, (N, 3) or (N, 4) float32
        One scan of one scanner, metres.
    previous, following : the same, optional
        The frames a turn earlier and later: what was answered then is missed now. One of them is
        a further witness of detector III; with both, detector IV compares what the turns saw, and
        detector III looks at the frame alone. Frames whose ``time_ns`` are more than 0.15 s apart
        are no neighbours. A frame between two of which one was cut, thinned or moved off its
        firings is ``processed`` (neighbours) unless what they still show accuses it, and one whose
        neighbour has nine tenths of its points, in any order, is ``processed`` (repeated). One that
        shows another place than both, which show the same, is ``processed`` (foreign).
    lattice : SensorLattice, optional
        Lattice of the scanner, from `estimate_lattice` on clean scans. Without it that of KITTI's
        scanner is tried, then one estimated from the frame.
    sensor : 'auto', 'lattice', 'terrestrial' or 'other'
        The scanner: recognised from the scan; one on a lattice (HDL-64E); a terrestrial one;
        another, which no detector is calibrated for. A scan that does not stand on the lattice, or
        on a grid of azimuth and elevation, is undecidable whatever is stated.
    origin : (3,), optional
        Position of the scanner, metres; by default that of the frame, else what
        `estimate_origin` finds. Where none is given and KITTI's scanner stands above or
        below that, as in clouds with the ground at a height of 0, it is judged from there.
    watermark : bytes or WatermarkResult, optional
        The scan's record, which ``key`` verifies, or what `Watermarker.verify` said of this scan.
        What the embedding moved is allowed for then, and nothing more. Without it a scan whose
        points carry a watermark's bits is ``processed``, and so is one whose record does not hold.
    key : KeyFile or KeyRing, optional
        Verifies a record; without it, a record says nothing.
    power : bool
        State the share of edits of each class that are found in scans of this scanner.
    plant : int
        Edits of each class that are planted in copies of this very scan, with its neighbours if
        both were given: ``power`` says in ``here_found`` how many are found. Only a scan that is
        ``no_trace``, of a spinning scanner and without a watermark, is planted in. Each edit takes
        as long as an inspection. A scan on an exact lattice whose power is not known becomes
        ``no_trace`` by them, if half of the edits of some class are found.
    printed : bool
        Ask detectors I and II with the thresholds printed in the dissertation. They were printed
        for terrestrial scanners: scans of all others are undecidable then.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        A shape is wrong, a coordinate is not finite, an unknown word for ``sensor``; a result of
        another scan's watermark, a key without a record; ``plant`` is negative, or not 0 without
        ``power``.

    Notes
    -----
    Detector III judges scanners whose lattice is known, detectors IV and V beside it, detectors I
    and II the terrestrial scanners that they are calibrated for; scans of other scanners are
    ``undecidable``. Clouds that nobody has rounded since the driver of a Hesai, an Ouster or a
    Velodyne computed them are exact, and tell their lattice themselves: detector III judges them,
    too, but what share of edits it finds is not known unless edits are planted in them (``plant``)
    or `calibrate_lattice` has measured it. Of the clean scans of a spinning scanner 1 % at most may
    be called tampered, whichever detector does it: III may use up 0.1 % of them, IV 0.7 %, V 0.2 %.
    No verdict says that a scan is authentic: an attacker who rewrites ranges of existing firings
    leaves no trace in it. Only a keyed watermark proves that nothing was changed.

    A watermark that holds proves nothing of what came before it: the detectors look at the scan as
    it was signed. The lowest bits (`lbm`) take the steps of the scanner's ranges with them, so that
    fewer edits that were made before embedding are found; ``power`` says how many.

    Rows that are no returns (markers farther away than the scanner measures, one range for all
    firings without a return), and further copies of a point, are named and set apart, and the
    others are judged. Points that stand elsewhere in the file than the scanner writes them are
    named, too; that alone accuses nobody.

    Where a scan was processed as a whole, detector III does not judge what is missing, and IV and
    V do not run: it is ``processed``, whether or not something was removed from it as well. Only
    where whole lasers were left out, IV and V judge what the others saw.

    Examples
    --------
    >>> import numpy as np
    >>> import manip3d
    >>> manip3d.authenticate.inspect(np.zeros((0, 3), np.float32)).verdict
    'undecidable'
    """
    return inspect_beside(
        frame, left_out_of_turn, previous=previous, following=following, lattice=lattice,
        sensor=sensor, origin=origin, watermark=watermark, key=key, power=power, plant=plant,
        printed=printed, threads=threads, progress=progress,
    )  # fmt: skip


def inspect_beside(
    frame: ScanLike,
    left_out: LeftOut,
    *,
    previous: ScanLike | None,
    following: ScanLike | None,
    lattice: SensorLattice | None,
    sensor: str,
    origin: ArrayLike | None,
    watermark: bytes | WatermarkResult | None,
    key: KeyFile | KeyRing | None,
    power: bool,
    printed: bool,
    threads: int,
    plant: int = 0,
    progress: Progress = None,
) -> Inspection:
    """Judge as `inspect` does, and ask ``left_out`` whether the turns beside the frame are whole.

    The scans of a drive ask twice for each turn, which needs one look only.
    """
    if sensor not in SENSORS:
        raise InputError(f"sensor: expected one of {', '.join(SENSORS)}, got {sensor!r}")
    if plant < 0:
        raise InputError(f"plant: expected at least 0, got {plant}")
    if plant and not power:
        raise InputError(f"plant: can only be given with power, got {plant} without it")
    scan = as_frame(frame)
    signed = _verified(scan, watermark, key)
    is_planting = bool(plant) and signed is None
    own = 1.0 / (1 + plant * len(EDITS)) if is_planting else 1.0
    with sharing(progress, "inspect") as part:
        with reporting(part(0.0, own), "inspect") as report:
            result = _inspected(
                scan,
                signed,
                _Asked(previous, following, lattice, sensor, origin, printed, threads, left_out),
                report or (lambda _: None),
            )
        result = replace(_with_watermark(result, signed), scan=scan.replace(origin=result.origin))
        if is_planting:
            rest = part(own, 1.0)
            return _planted(result, previous, following, plant, threads, rest)
    if power:
        return result
    bare = tuple(replace(report, power=NO_POWER) for report in result.detectors)
    return replace(result, detectors=bare)


def _planted(
    result: Inspection,
    previous: ScanLike | None,
    following: ScanLike | None,
    plant: int,
    threads: int,
    progress: Progress,
) -> Inspection:
    """The result with what is found of edits in copies of the scan, where nothing was found yet."""
    scan, sensor, position = result.scan, result.sensor, result.origin
    is_unmeasured = _is_unmeasured(result)
    if not is_unmeasured and result.verdict != "no_trace":
        return result
    if scan is None or position is None or sensor is None or sensor.lattice is None:
        return result
    frames = [_at_origin(scan, position)]
    if previous is not None and following is not None and not is_unmeasured:
        before, after = (_at_origin(as_frame(other), position) for other in (previous, following))
        frames = [before, *frames, after]
    here = measure_power(
        frames, sensor.lattice, planted=plant, neighbours=len(frames) > 1, threads=threads,
        progress=progress,
    )  # fmt: skip
    if is_unmeasured:
        return _measured_here(result, here)
    return replace(result, planted_here=ReadOnlyMapping(here))


def _is_unmeasured(result: Inspection) -> bool:
    """Whether detector III found nothing by an exact lattice, and its power is not known."""
    sensor, generic = result.sensor, result.generic
    if result.verdict != "undecidable" or result.processing or generic is None or sensor is None:
        return False
    is_exact = sensor.lattice is not None and sensor.lattice.is_exact
    return is_exact and generic.verdict == "no_trace"


def _measured_here(result: Inspection, here: Mapping[str, Power]) -> Inspection:
    """The result of a scan whose own planted edits are all that is known of the power."""
    power = ReadOnlyMapping(
        {name: replace(each, source="edits planted in this scan") for name, each in here.items()}
    )
    reports = tuple(
        replace(report, verdict="no_trace", reason=IN_WORDS["no_trace"], power=power)
        if report.name == "generic"
        else report
        for report in result.detectors
    )
    verdict = combined_verdict(reports)
    return replace(result, verdict=verdict, reason=_reason(verdict, reports, ()), detectors=reports)


class _Asked(NamedTuple):
    """Arguments of `inspect` beside the scan."""

    previous: ScanLike | None
    following: ScanLike | None
    lattice: SensorLattice | None
    sensor: str
    origin: ArrayLike | None
    printed: bool
    threads: int
    left_out: LeftOut


_Identified = tuple[Sensor, "LatticeReading | None"]
"""The scanner, and the scan as its lattice reads it, if that was tried."""

_Beside = tuple["LidarFrame | None", "LidarFrame | None"]
"""The frames one revolution before and after."""

LeftOut: TypeAlias = "Callable[[LidarFrame, SensorLattice], Lacking | None]"
"""How to tell what a turn lacks, as `left_out_of_turn` does."""


def _inspected(
    scan: LidarFrame,
    signed: WatermarkResult | None,
    asked: _Asked,
    told: Callable[[float], object],
) -> Inspection:
    """Judge a scan by the detectors that apply to its scanner.

    The bits of a watermark whose record was verified are removed first.
    """
    embedding = "" if signed is None else signed.embedding
    if embedding not in ALLOWED:
        if trace := trace_of(scan.points):
            return _carrying(scan, trace)
        embedding = ""
    units = MILLIMETRES if signed is None or not embedding else signed.units_per_m
    if embedding:
        points = without_bits(scan.points, embedding, units)
        scan = scan.replace(points=points, exact=None, format=None)
    position, source, known = _scanner(scan, asked.origin, asked.lattice, asked.threads)
    told(0.1)
    if position is None:
        return _without_position(scan, source)
    found, reading = _identified(
        _at_origin(scan, position), asked.sensor, asked.lattice, asked.threads, known
    )
    if source != "argument" and (height := height_above_origin(found, scan.points)):
        raised = (position[0], position[1], position[2] + height)
        other = identify_and_read(_at_origin(scan, raised), threads=asked.threads)
        if other[0].kind == "lattice" and not other[0].is_own and other[0].off_lattice == 0.0:
            position, source = raised, "the lattice of a spinning scanner"
            found, reading = other
    told(0.3)
    if found.kind == "lattice" and not asked.printed:
        beside = (asked.previous, asked.following)
        before, after = (_neighbour(other, position, embedding, units) for other in beside)
        case = _Case(
            scan, position, source, (found, reading), embedding, units, asked.left_out,
            asked.threads,
        )  # fmt: skip
        result = _by_lattice(case, (before, after))
    elif found.kind == "terrestrial":
        result = _by_angles(scan, position, source, found, asked.printed, asked.threads, told)
    else:
        result = _not_judged(scan, position, source, found, asked.printed)
    told(1.0)
    return result


def _verified(
    scan: LidarFrame, watermark: bytes | WatermarkResult | None, key: KeyFile | KeyRing | None
) -> WatermarkResult | None:
    """Result of the verifier for the record; None where there is no record or no key."""
    if isinstance(watermark, WatermarkResult):
        if watermark.scan is None or not np.array_equal(watermark.scan.points, scan.points):
            raise InputError("watermark: expected the result of this scan, got another scan's")
        return watermark
    if key is None:
        return None
    if watermark is None:
        raise InputError("key: can only be given with a watermark's record, got none")
    with Watermarker(key) as verifier:
        return verifier.verify(scan, watermark, policy=Policy(order="any"))


def _with_watermark(result: Inspection, signed: WatermarkResult | None) -> Inspection:
    """The result with the report of the watermark.

    The suspected rows are not copied: they are in ``Inspection.watermark``.
    """
    if signed is None:
        return result
    verdict: Verdict = "no_trace"
    if "tampered" in (signed.verdict, signed.content):  # or a replay of what was signed
        verdict = "tampered"
    elif signed.content != "intact":
        verdict = "undecidable"
    regions = tuple(Region(region.box) for region in signed.regions)
    report = DetectorReport("watermark", verdict, signed.reason, signed.score, regions=regions)
    reports = (*result.detectors, report)
    if verdict != "tampered" or result.verdict == "tampered":
        return replace(result, detectors=reports, watermark=signed)
    reason = f"watermark: {signed.reason}"
    return replace(result, verdict="tampered", reason=reason, detectors=reports, watermark=signed)


def _carrying(scan: LidarFrame, trace: tuple[Processing, ...]) -> Inspection:
    """A scan with the bits of a watermark that nobody verified: points lie where it put them."""
    reports = tuple(DetectorReport(name, "undecidable", trace[0].detail) for name in FORENSIC)
    known = None
    if scan.origin is not None:
        x, y, z = (float(value) for value in position_of(scan.origin, "origin"))
        known = (x, y, z)
    return Inspection(
        "processed", _reason("processed", reports, trace), scan.num_points, None, trace, known,
        "file" if known is not None else "not looked for in a scan with a watermark", reports,
        scan=scan,
    )  # fmt: skip


def _identified(
    scan: LidarFrame,
    sensor: str,
    lattice: SensorLattice | None,
    threads: int,
    known: _Identified | None,
) -> _Identified:
    """The scanner; what a caller states of it is believed where the scan can be one of it.

    Beside it where the points lie on its lattice, if that was read; ``known``: it was found before.
    """
    if sensor in ("auto", "lattice"):
        found = known or identify_and_read(scan, lattice=lattice, threads=threads)
        if sensor == "auto" or _tells_position(found[0]):
            return found
    return _stated(scan, sensor, threads), None


def _stated(scan: LidarFrame, sensor: str, threads: int) -> Sensor:
    """The scanner that a caller stated, and that was not told from the scan."""
    if (why := nothing_to_tell(scan.points)) is not None:
        return Sensor("unknown", "unknown", why)
    if sensor == "terrestrial" and not is_in_metres(scan.points):
        return Sensor("unknown", "unknown", NOT_IN_METRES)
    if sensor == "terrestrial":
        found = estimate_origin(scan, known=(0.0, 0.0, 0.0), threads=threads)
        if found.position is not None and found.explained >= LEAST_EXPLAINED:
            return Sensor("terrestrial scanner", "terrestrial", "stated by the caller")
        return Sensor(
            "unknown", "unknown", "the scan does not stand on the grid of a terrestrial scanner"
        )
    if sensor == "other":
        return Sensor("another scanner", "unknown", "stated by the caller")
    return Sensor("unknown", "unknown", "the scan does not stand on the lattice that was stated")


def _neighbour(
    scan: ScanLike | None, position: Position, embedding: str, units_per_m: int
) -> LidarFrame | None:
    if scan is None:
        return None
    frame = as_frame(scan)
    if embedding and find_carrier(frame.points, units_per_m) == embedding:
        points = without_bits(frame.points, embedding, units_per_m)
        frame = frame.replace(points=points, exact=None, format=None)
    return _at_origin(frame, position)


def _is_part_of_turn(scan: LidarFrame) -> bool:
    """Whether the packets say so, as where a recording begins and ends: nobody cropped it."""
    return scan.format is not None and scan.format.header.get("is_complete") is False


class _Case(NamedTuple):
    """A scan on the lattice of its scanner, with what each stage of its judging must know of it."""

    scan: LidarFrame
    position: Position
    source: str  # who states the position
    identified: _Identified
    embedding: str  # of a verified watermark; empty: there is none
    units_per_m: int
    left_out: LeftOut
    threads: int

    @property
    def sensor(self) -> Sensor:
        return self.identified[0]

    @property
    def centred(self) -> LidarFrame:
        """The scan with the scanner in (0, 0, 0)."""
        return _at_origin(self.scan, self.position)


def _by_lattice(case: _Case, beside: _Beside) -> Inspection:
    """Judge the returns of a scan, and of the turns beside it; name its rows that are none."""
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
    """The turn without the rows that are no returns of the scanner."""
    if turn is None:
        return None
    rows, _ = _returns_of(turn, sensor, None)
    return turn if rows is None else turn.select(rows)


def _with_rows(found: Inspection, rows: NDArray[np.int64], scan: LidarFrame) -> Inspection:
    """The result of some rows of a scan as one of the whole scan."""
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


def _returns_by_lattice(case: _Case, beside: _Beside, padded: tuple[Processing, ...]) -> Inspection:
    """Judge by detectors III, IV and V, allowing for what a verified embedding moved."""
    sensor, position, embedding = case.sensor, case.position, case.embedding
    centred = case.centred
    neighbours, why_not, repeats = _usable(centred, beside)
    generic, of_rows, once = _judged_by_lattice(case, centred, neighbours)
    repeated_turns = tuple(Processing("repeated", detail) for detail in repeats)
    processing = of_rows + padded + padding(case.scan, sensor) + repeated_turns
    processing += _processing_of_points(case, centred, generic, once)
    if generic is not None and _changed(processing):
        generic = generic.without(_spoiled(generic, processing))
    compared = _Compared(None, None, (), why_not)
    is_repeated = any(step.kind == "repeated" for step in of_rows)
    if generic is not None and not is_repeated and _are_comparable(sensor, processing):
        compared = _compared(case, centred, neighbours, why_not, processing)
        processing += compared.processing
    reports = (
        *_not_applicable(sensor, embedding),
        _generic_report(generic, position, sensor, embedding),
        *_turns_report(compared.turns, beside, compared.why_not, position, sensor, embedding),
        *_reflectance_report(compared.reflectance, position, sensor, embedding),
    )
    if _is_part_of_turn(case.scan) and {step.kind for step in processing} == {"cropped"}:
        processing, reports = (), _reports_of_part(reports)
    return _combined(
        case.scan, position, case.source, sensor, reports, processing, generic=generic,
        turns=compared.turns, reflectance=compared.reflectance,
        blind=BLIND if reports[-1].name == "reflectance" and reports[-1].power
        else (*BLIND, BLIND_WITHOUT_REFLECTANCES),
    )  # fmt: skip


def _processing_of_points(
    case: _Case,
    centred: LidarFrame,
    generic: GenericResult | None,
    once: NDArray[np.int64] | None,
) -> tuple[Processing, ...]:
    """Find what was done to all points; roundings of an embedding are named as the embedding's."""
    sensor, reading = case.identified
    coarse = rounding_of(case.embedding, case.units_per_m)
    seen, reading = (centred, reading) if once is None else (centred.select(once), None)
    found = find_processing(seen.points, sensor, generic, seen.intensity, reading)
    return coarse + tuple(step for step in found if not (coarse and step.kind == "rounded"))


def _changed(processing: Sequence[Processing]) -> list[Processing]:
    """The steps after which points are missing or lie elsewhere."""
    return [step for step in processing if step.kind not in COORDINATES_KEPT]


def _are_comparable(sensor: Sensor, processing: Sequence[Processing]) -> bool:
    """Whether detectors IV and V know the scanner, and what was done leaves them something."""
    return sensor.name == HDL64E and all(step.kind in STILL_COMPARED for step in processing)


class _Compared(NamedTuple):
    """Results of the detectors that compare a scan with the turns beside it."""

    turns: TurnResult | None
    reflectance: ReflectanceResult | None
    processing: tuple[Processing, ...]
    why_not: list[str]  # reasons why the turns beside it were not used


def _compared(
    case: _Case,
    centred: LidarFrame,
    neighbours: _Beside,
    why_not: list[str],
    processing: Sequence[Processing],
) -> _Compared:
    """Judge by detectors IV and V, with what the turns beside the scan still have."""
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
    if turns is not None and turns.foreign:
        of_turns += (Processing("foreign", FOREIGN),)
    reflectance = _unless_foreign(reflectance, processing)
    if reflectance is not None and reflectance.rewritten:
        of_turns += (Processing("reflectances", reflectance.rewritten),)
    return _Compared(turns, reflectance, of_turns, why_not)


def _unless_foreign(
    found: ReflectanceResult | None, processing: Sequence[Processing]
) -> ReflectanceResult | None:
    """The result of detector V; reflectances that are not those of the points say nothing, unless
    they accuse."""
    why = next((step.detail for step in processing if step.kind == "reflectances"), None)
    if found is None or why is None or found.verdict != "no_trace":
        return found
    return replace(found, verdict="undecidable", reason=why)


def _reports_of_part(reports: tuple[DetectorReport, ...]) -> tuple[DetectorReport, ...]:
    """The reports on a part of a turn, which only accuse: the rest of it was never recorded."""
    if any(each.verdict == "tampered" for each in reports):
        return reports
    why = "the recording holds a part of this turn only"
    return tuple(DetectorReport(each.name, "undecidable", why) for each in reports)


def _judged_by_lattice(
    case: _Case, centred: LidarFrame, beside: _Beside
) -> tuple[GenericResult | None, tuple[Processing, ...], NDArray[np.int64] | None]:
    """Detector III's result, and what was done to rows: which are repeated, or stand elsewhere.

    Then the rows that were judged, each point once; None: all.
    """
    sensor, reading = case.identified
    if sensor.off_lattice != 0.0 or sensor.lattice is None:
        return None, (), None
    before, after = beside
    both = before is not None and after is not None  # what is missing is detector IV's to find
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
        if not are_fired_twice(centred.points, copies, sensor.lattice):
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


def _number_elsewhere(generic: GenericResult) -> int:
    """Number of points at places that only the order of the file speaks of.

    They stand where the scanner measures: whoever sorts a file by distance, height or class puts
    them elsewhere in it, and none of `EDITS` is found by that alone.
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
    """Judge the points that a lattice read off the scan tells of.

    One scan tells neither holes and firings, nor places to a fraction of a millimetre.
    """
    kept = np.flatnonzero(lattice.is_told_by_scan(scan.points, reading))
    judged = judge(scan.select(kept)).with_rows(kept, scan)
    return judged.without(("firing", "place", "void"), why="unknown", quiet="no_trace")


def _in_lasers_of(
    centred: LidarFrame, identified: _Identified, beside: _Beside, threads: int
) -> _Beside:
    """The turns before and after without the lasers that the frame lacks."""
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
    identified: _Identified,
    beside: _Beside,
    lacking: Sequence[str],
    threads: int,
) -> tuple[TurnResult | None, ReflectanceResult | None]:
    """Results of detectors IV and V, where there is what they need.

    Turns that are not whole accuse by what they saw, but that they saw no more says nothing.
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


def _not_applicable(sensor: Sensor, embedding: str) -> tuple[DetectorReport, ...]:
    """Reports of detectors I and II, which do not judge scans on a lattice."""
    why = f"detector III judges the {sensor.name}"
    if sensor.name != HDL64E and not known_power("generic", sensor, embedding):
        why += ", and what share of edits it finds was not measured for this scanner"
    return tuple(DetectorReport(name, "undecidable", why) for name in ("density", "occlusion"))


def _turns_report(
    turns: TurnResult | None,
    beside: _Beside,
    why_not: Sequence[str],
    position: Position,
    sensor: Sensor,
    embedding: str,
) -> tuple[DetectorReport, ...]:
    """Report of detector IV, or why it could not judge frames that were given; else none."""
    if turns is not None:
        return (_report_of("turns", turns, position, known_power("turns", sensor, embedding)),)
    if any(other is None for other in beside) or (not why_not and sensor.name == HDL64E):
        return ()
    reasons = why_not or [f"there are no thresholds for a {sensor.name}"]
    return (DetectorReport("turns", "undecidable", "; ".join(reasons)),)


def _reflectance_report(
    found: ReflectanceResult | None, position: Position, sensor: Sensor, embedding: str
) -> tuple[DetectorReport, ...]:
    """Report of detector V if it was run."""
    if found is None:
        return ()
    setting = "reflectance" if found.with_turns else "reflectance alone"
    power = known_power(setting, sensor, embedding)
    return (_report_of("reflectance", found, position, power),)


_NO_SKETCH = sketch_of(np.empty((0, 3), np.float32))


def _usable(scan: LidarFrame, beside: _Beside) -> tuple[_Beside, list[str], list[str]]:
    """The neighbours that are a turn apart; why others are not; which of them repeat a turn.

    No two turns of a scanner have the same points: a recorder that stalled, or somebody who put a
    turn in twice, writes them, and nothing is missing then or new.
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
        apart = 0 if None in (scan.time_ns, other.time_ns) else _apart_ns(scan, other)
        if same := in_common(own, sketch):
            repeats.append(f"the turn {name} has {same}")
        elif apart > MOST_APART_NS:
            why.append(f"the turn {name} was taken {apart * 1e-9:.2f} s apart, which is no turn")
        else:
            kept[-1] = other
    before, after = kept
    if before is not None and after is not None and (same := in_common(*others)):
        before = after = None
        repeats.append(f"the turns before and after have {same}")
    return (before, after), repeats + why, repeats


def _lacking(
    beside: _Beside, lattice: SensorLattice, left_out: LeftOut
) -> tuple[list[str], bool, tuple[Processing, ...]]:
    """Why turns may lack points that they had; whether what is left lies where it was measured.

    Then what somebody did to them, which can hide edits of the frame: nobody cropped the parts of
    turns with which a recording of packets begins and ends, and what is cut off farther away than
    detector IV looks hides nothing from it.
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


def _apart_ns(scan: LidarFrame, other: LidarFrame) -> int:
    return abs((scan.time_ns or 0) - (other.time_ns or 0))


def _spoiled(generic: GenericResult, processing: Sequence[Processing]) -> Sequence[str]:
    """Kinds of evidence that say nothing of a scan that was processed as a whole."""
    if generic.values_changed or any(step.kind == "averaged" for step in processing):
        return EVIDENCE
    is_fused = any(step.kind == "fused" for step in processing)
    return (*MISSING, "duplicate", "order") if is_fused else MISSING


def _by_angles(
    scan: LidarFrame,
    position: Position,
    source: str,
    sensor: Sensor,
    printed: bool,
    threads: int,
    told: Callable[[float], object],
) -> Inspection:
    """Judge by detectors I and II."""
    # At the origin this was looked at: `_by_grid` names a terrestrial scanner where its grid holds.
    is_stated = source in ("argument", "file") and any(position)
    if is_stated and _fused(scan, position, threads):
        return _without_position(scan, "several positions fused, or the scanner stood elsewhere")
    density = density_consistency(
        scan, parameters=PAPER_DENSITY if printed else None, origin=position, threads=threads
    )
    told(0.6)
    occlusion = occlusion_consistency(
        scan, parameters=PAPER_OCCLUSION if printed else None, origin=position, threads=threads
    )
    told(0.9)
    reports = (
        _angles_report("density", density, sensor),
        _angles_report("occlusion", occlusion, sensor),
        DetectorReport("generic", "undecidable", "no scan of a spinning scanner"),
    )
    processing = find_processing(_at_origin(scan, position).points, sensor, None)
    return _combined(
        scan, position, source, sensor, reports, processing, density=density, occlusion=occlusion,
        blind=(*BLIND, BLIND_TERRESTRIAL),
    )  # fmt: skip


def _not_judged(
    scan: LidarFrame, position: Position, source: str, sensor: Sensor, printed: bool
) -> Inspection:
    why = f"{sensor.name} ({sensor.reason}): no detector is calibrated for it"
    if sensor.turned:
        why = f"{sensor.name} in {sensor.turned}: detectors judge x forward, y left, z up"
    if sensor.unit:
        why = f"{sensor.name} in {sensor.unit}: detectors judge coordinates in metres"
    if printed:
        why = f"{sensor.name}: the printed thresholds are those of terrestrial scanners"
    reports = tuple(DetectorReport(name, "undecidable", why) for name in FORENSIC)
    points = _at_origin(scan, position).points
    processing = () if scan.num_points < 1000 else find_processing(points, sensor, None)
    if sensor.kind == "unknown":
        processing = ()
    return _combined(scan, position, source, sensor, reports, processing)


def _combined(
    scan: LidarFrame,
    position: Position,
    source: str,
    sensor: Sensor,
    reports: tuple[DetectorReport, ...],
    processing: tuple[Processing, ...],
    **results: Any,
) -> Inspection:
    verdict = combined_verdict(reports, processing)
    return Inspection(
        verdict, _reason(verdict, reports, processing), scan.num_points, sensor, processing,
        position, source, reports, scan=scan.replace(origin=position), **results,
    )  # fmt: skip


def repeating(found: Inspection, repeat: tuple[int, str] | None) -> Inspection:
    """Return the result of a scan that has the points of an earlier one of its drive, if it has.

    Parameters
    ----------
    found : Inspection
    repeat : (int, str) or None
        Place of the earlier scan, and what of its points this one has; None: there is none.
    """
    if repeat is None:
        return found
    index, what = repeat
    step = Processing("repeated", f"number {index} of the drive has {what}")
    processing = (*found.processing, step)
    verdict = combined_verdict(found.detectors, processing)
    reason = found.reason
    if verdict != "tampered":
        reason = _reason(verdict, found.detectors, processing)
    return replace(found, verdict=verdict, reason=reason, processing=processing, repeats=index)


def _reason(
    verdict: Verdict, reports: Sequence[DetectorReport], processing: Sequence[Processing]
) -> str:
    if verdict == "processed" and processing:
        return "; ".join(f"{step.kind}: {step.detail}" for step in processing)
    if verdict == "undecidable":
        last = reports[-1]  # has a score where it looked at the scan, but has no measured power
        has_said = last.score is not None and last.verdict == "undecidable"
        return last.reason if has_said else reports[0].reason
    deciding = next(r for r in reports if r.verdict == verdict)
    return f"detector {deciding.title.split(':')[0]}: {deciding.reason}"


def _scanner(
    frame: LidarFrame, origin: ArrayLike | None, lattice: SensorLattice | None, threads: int
) -> tuple[Position | None, str, _Identified | None]:
    """The scanner's position and who states it; or None and why the scan cannot be judged.

    Then the scanner, where its lattice told the position or it stands at the coordinates' origin.
    """
    stated = origin if origin is not None else frame.origin
    if stated is None:
        if frame.num_points == 0:
            return None, "the scan has no points", None
        if (why := several_sources(frame)) is not None:
            return None, why, None
        if lattice is None and is_on_map(frame):  # a scanner's lattice stands around its own 0
            found = estimate_origin(frame, threads=threads)
            return found.position, found.reason, None
        identified = identify_and_read(frame, lattice=lattice, threads=threads)
        if frame.num_points and _tells_position(identified[0]):
            return (0.0, 0.0, 0.0), "the lattice of a spinning scanner", identified
        found = estimate_origin(frame, threads=threads)
        stands_there = found.position is not None and not any(found.position)
        return found.position, found.reason, identified if stands_there else None
    x, y, z = (float(value) for value in position_of(stated, "origin"))
    return (x, y, z), "argument" if origin is not None else "file", None


def _tells_position(sensor: Sensor) -> bool:
    """Whether a scanner was found whose lattice stands around the origin of the coordinates."""
    return sensor.kind == "lattice" or bool(sensor.turned or sensor.unit)


def _fused(scan: LidarFrame, position: Position, threads: int) -> bool:
    """Whether a scan with a grid has one that does not hold around the stated position."""
    grid = estimate_grid(scan, origin=position, threads=threads)
    return (
        grid.elevation_strength > 0.0
        and estimate_origin(scan, known=position, threads=threads).position is None
    )


def _without_position(frame: LidarFrame, why: str) -> Inspection:
    reports = tuple(DetectorReport(name, "undecidable", why) for name in FORENSIC)
    return Inspection(
        "undecidable", why, frame.num_points, None, (), None, why, reports, scan=frame
    )


def _at_origin(frame: LidarFrame, position: Position) -> LidarFrame:
    """The frame with the scanner in (0, 0, 0), as detector III takes it."""
    if not any(position):
        return frame
    moved = (frame.points - np.asarray(position)).astype(np.float32)
    return frame.replace(points=moved, exact=None, format=None, origin=(0.0, 0.0, 0.0))


def _angles_report(
    name: str, found: DensityResult | OcclusionResult, sensor: Sensor
) -> DetectorReport:
    regions = tuple(Region(region.box, region.rows) for region in found.regions)
    return DetectorReport(
        name, found.verdict, found.reason, found.score, None, regions,
        found.suspected.astype(np.int64), known_power(name, sensor), found.calibration,
    )  # fmt: skip


def _generic_report(
    found: GenericResult | None, position: Position, sensor: Sensor, embedding: str
) -> DetectorReport:
    if found is None:
        return DetectorReport(
            "generic", "processed", "the points were moved off the lattice of the scanner"
        )
    is_exact = sensor.lattice is not None and sensor.lattice.is_exact
    calibration = EXACT_CALIBRATION if is_exact else LATTICE_CALIBRATION
    least = 1.0 / (1 + calibration.num_scans)
    regions = tuple(
        Region(
            _moved(region.box, position), region.rows, max(least, region.p_value), region.strength
        )
        for region in found.regions
    )
    judged = found.verdict != "undecidable" and any(e.used for e in found.evidence.values())
    return DetectorReport(
        "generic", found.verdict, found.reason, found.score,
        max(least, found.p_value) if judged else None,
        regions, found.suspected, known_power("generic", sensor, embedding), calibration,
    )  # fmt: skip


def _report_of(
    name: str, found: TurnResult | ReflectanceResult, position: Position, power: Mapping[str, Power]
) -> DetectorReport:
    """The report of detector IV or V, whose boxes are seen from the scanner at ``position``."""
    regions = tuple(
        Region(
            _moved(region.box, position),
            region.rows,
            region.p_value,
            {region.kind: region.strength},
        )
        for region in found.regions
    )
    if found.verdict == "undecidable":
        score, p_value, power = None, None, NO_POWER
    else:
        score, p_value = found.score, found.p_value
    return DetectorReport(
        name, found.verdict, found.reason, score, p_value, regions, found.suspected, power,
        found.calibration,
    )  # fmt: skip


def _moved(box: Box, position: Position) -> Box:
    """The box in the scan's own frame, which is seen from the scanner."""
    x, y, z = box.center
    return replace(box, center=(x + position[0], y + position[1], z + position[2]))
