"""Inspect a scan by all detectors that can judge it (`inspect`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import reporting, sharing
from manip3d.authenticate._carriers import (
    ALLOWED,
    MILLIMETRES,
    find_carrier,
    trace_of,
    without_bits,
)
from manip3d.authenticate._density import PAPER_DENSITY, density_consistency
from manip3d.authenticate._edits import EDITS
from manip3d.authenticate._extent import left_out_of_turn
from manip3d.authenticate._inspection import DetectorReport, Inspection, combined_verdict
from manip3d.authenticate._keys import KeyFile, KeyRing
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._occlusion import (
    PAPER_OCCLUSION,
    UNNUMBERED,
    estimate_grid,
    occlusion_consistency,
)
from manip3d.authenticate._on_lattice import Case, LeftOut, by_lattice
from manip3d.authenticate._origin import estimate_origin
from manip3d.authenticate._power import (
    BLIND,
    BLIND_SPARSE,
    BLIND_TERRESTRIAL,
    BLIND_WITHOUT_TURNS,
    measure_power,
)
from manip3d.authenticate._processing import find_processing
from manip3d.authenticate._reports import (
    FORENSIC,
    angles_report,
    combined,
    not_applicable,
    reason_of,
    without_position,
)
from manip3d.authenticate._sensors import (
    MIN_POINTS,
    Sensor,
    why_off_lattice,
)
from manip3d.authenticate._standpoint import ON_LATTICE, at_origin, identify, lifted, scanner_of
from manip3d.authenticate._thinning import why_thinned
from manip3d.authenticate._verdict import NO_POWER, PLANTED_HERE, Power, Processing, Region, Verdict
from manip3d.authenticate._watermark import Policy, Watermarker, WatermarkResult
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame, ScanLike, as_frame, map_shift, position_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from manip3d._util.options import Progress

    Position = tuple[float, float, float]


SENSORS = ("auto", "lattice", "terrestrial", "other")
"""Kinds of scanner that a caller can state; ``auto``: `identify_sensor` recognises the scanner."""


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
        Frames one turn earlier and later, which show what is missing in this one. If only one is
        given, detector III uses it; if both are, detector IV compares the three turns, and detector
        III judges the frame alone. Frames whose ``time_ns`` differ by more than 0.15 s are no
        neighbours. The frame is ``processed`` (neighbours) if a neighbour was cut, thinned or moved
        off its firings, unless the remaining points accuse it; ``processed`` (repeated) if a
        neighbour has nine tenths of its points, in any order; and ``processed`` (foreign) if both
        neighbours show the same place and it shows another one.
    lattice : SensorLattice, optional
        Lattice of the scanner, from `estimate_lattice` on clean scans; default: the lattice of
        KITTI's scanner is tried, then one is estimated from the frame.
    sensor : 'auto', 'lattice', 'terrestrial' or 'other'
        Kind of scanner: recognised from the scan (``auto``), spinning on a known lattice
        (``lattice``, as HDL-64E), terrestrial, or one that no detector is calibrated for
        (``other``). Whatever is stated, a scan that does not lie on the lattice, or on a grid of
        azimuth and elevation, is undecidable.
    origin : (3,), optional
        Position of the scanner, metres; default: that of the frame, else the result of
        `estimate_origin`. If it is not given and a scan of KITTI's scanner was moved up or down, as
        in clouds with the ground at height 0, the scanner's height is found as well.
    watermark : bytes or WatermarkResult, optional
        The scan's record, which ``key`` verifies, or the result of `Watermarker.verify` for this
        scan. The detectors then allow for the displacement by the embedding. Without a usable
        record, a scan whose points carry the bits of a watermark is ``processed``.
    key : KeyFile or KeyRing, optional
        Key that verifies the record; without it a record is ignored.
    power : bool
        State the share of edits of each class that the detectors find in scans of this scanner.
    plant : int
        Number of edits of each class that are planted in copies of this scan, with its neighbours
        if both are given; ``here_found`` of ``power`` states how many of them are found. Each edit
        takes as long as an inspection. Edits are planted only in scans of a spinning scanner that
        are ``no_trace`` and have no watermark, and in scans on an exact lattice whose power is
        unknown: these become ``no_trace`` if half of the edits of some class are found.
    printed : bool
        Use detectors I and II with the thresholds printed in the dissertation. They hold for
        terrestrial scanners; scans of all others become undecidable.
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
        A shape is wrong, or a coordinate is not finite; ``sensor`` is unknown; ``watermark`` is the
        result for another scan, or a key is given without a record; ``plant`` is negative, or not 0
        without ``power``.

    Notes
    -----
    Detectors III, IV and V judge spinning scanners whose lattice is known, detectors I and II the
    terrestrial scanners that they are calibrated for; scans of other scanners are ``undecidable``.
    A cloud is exact if its coordinates are those that the driver of a Hesai, an Ouster or a
    Velodyne computed, without later rounding. The lattice of its scanner can be estimated from an
    exact cloud itself, so that detector III judges it, too; the share of edits that are found is
    then only known if edits are planted (``plant``) or if `calibrate_lattice` has measured it. All
    detectors together call at most 1 % of the clean scans of a spinning scanner tampered: III 0.1
    %, IV 0.7 %, V 0.2 %. No verdict says that a scan is authentic, because an attacker who rewrites
    ranges of existing firings leaves no trace in it. Only a keyed watermark proves that nothing was
    changed.

    An intact watermark does not exclude edits before embedding; the detectors look for these. The
    embedding `lbm` blurs the scanner's range steps, so that fewer of them are found; ``power``
    states how many.

    Rows that are no returns (markers beyond the range of the scanner, or one range for all firings
    without a return) and further copies of a point are reported as processing; only the other rows
    are judged. Points at another place in the file than the scanner writes them are reported, too,
    but are no evidence of an edit.

    If a scan was processed as a whole, detector III does not judge missing points, and detectors IV
    and V do not run: the scan is ``processed``, whether or not points were removed as well. There
    are exceptions: detectors IV and V judge scans of which only whole lasers are missing, and all
    three those in which some lasers have no returns in a sector. If several lasers in a row are
    missing, everywhere or in a sector, detector V is ``undecidable``.

    Examples
    --------
    >>> from manip3d import authenticate, forge, simulate
    >>> scan = simulate.courtyard()
    >>> authenticate.inspect(scan).verdict
    'no_trace'
    >>> head = simulate.models.head(2000)
    >>> forged = forge.ctp(scan, head, position=(5.0, 0.0, -1.0), scale=3.0)
    >>> found = authenticate.inspect(forged.frame)
    >>> found.verdict, found.reason
    ('tampered', 'detector III: points lie where the sensor cannot measure')
    >>> [round(metres) for metres in found.regions[0].box.center]
    [5, 0, -1]
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
    """Judge as `inspect` does, with ``left_out`` to tell whether the neighbouring turns are whole.

    `inspect_drive` passes a function of its own, so that each turn is examined once and not twice.
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
            places = (
                _place_of(other, scan, result.origin, origin) for other in (previous, following)
            )
            return _planted(result, (previous, following), tuple(places), plant, threads, rest)
    if power:
        return result
    bare = tuple(replace(report, power=NO_POWER) for report in result.detectors)
    return replace(result, detectors=bare)


def _planted(
    result: Inspection,
    beside: tuple[ScanLike | None, ...],
    places: tuple[Position | None, ...],
    plant: int,
    threads: int,
    progress: Progress,
) -> Inspection:
    """Add to a result how many edits are found that are planted in copies of the scan.

    The result stays as it is if the scan itself has a trace.
    """
    scan, sensor, position = result.scan, result.sensor, result.origin
    is_unmeasured = _is_unmeasured(result)
    if not is_unmeasured and result.verdict != "no_trace":
        return result
    if scan is None or position is None or sensor is None or sensor.lattice is None:
        return result
    frames = [at_origin(scan, position)]
    turns = [
        at_origin(as_frame(turn), place)
        for turn, place in zip(beside, places, strict=True)
        if turn is not None and place is not None
    ]
    if len(turns) == len(beside) and not is_unmeasured:
        frames = [turns[0], *frames, turns[1]]
    here = measure_power(
        frames, sensor.lattice, planted=plant, neighbours=len(frames) > 1, threads=threads,
        progress=progress,
    )  # fmt: skip
    if is_unmeasured:
        return _measured_here(result, here)
    return replace(result, planted_here=ReadOnlyMapping(here))


def _is_unmeasured(result: Inspection) -> bool:
    """Whether detector III found no trace on an exact lattice, and its power is unknown."""
    sensor = result.sensor
    if result.verdict != "undecidable" or result.processing or sensor is None:
        return False
    is_exact = sensor.lattice is not None and sensor.lattice.is_exact
    judged = (r for r in result.detectors if r.name == "generic" and r.verdict == "no_trace")
    return is_exact and any(judged)


def _measured_here(result: Inspection, here: Mapping[str, Power]) -> Inspection:
    """The result of a scan whose power is only known from the edits that were planted in it."""
    if not here or result.sensor is None:
        return result
    power = ReadOnlyMapping(
        {name: replace(each, source=PLANTED_HERE) for name, each in here.items()}
    )
    anew = {report.name: report for report in not_applicable(result.sensor, power)}
    reports = tuple(
        replace(report, power=power) if report.name == "generic" else anew.get(report.name, report)
        for report in result.detectors
    )
    verdict = combined_verdict(reports)
    if verdict == "undecidable":
        reason = (
            "detector III finds fewer than half of the edits of each class that were planted in "
            "this scan"
        )
    else:
        reason = reason_of(verdict, reports, ())
    return replace(result, verdict=verdict, reason=reason, detectors=reports, planted_here=power)


class _Asked(NamedTuple):
    """Arguments of `inspect` except for the scan, the watermark and options of the power."""

    previous: ScanLike | None
    following: ScanLike | None
    lattice: SensorLattice | None
    sensor: str
    origin: ArrayLike | None
    printed: bool
    threads: int
    left_out: LeftOut


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
    if unit := _stated_unit(scan):
        return without_position(scan, f"coordinates in {unit}, as the file says, not in metres")
    units = MILLIMETRES if signed is None or not embedding else signed.units_per_m
    if embedding:
        points = without_bits(scan.points, embedding, units)
        scan = scan.replace(points=points, exact=None, format=None)
    position, source, known = scanner_of(scan, asked.origin, asked.lattice, asked.threads)
    told(0.1)
    if position is None:
        return without_position(scan, source)
    found, reading = identify(
        at_origin(scan, position), asked.sensor, asked.lattice, asked.threads, known
    )
    if source != "argument" and (other := lifted(scan, position, found, asked.threads)):
        position, (found, reading) = other
        source = ON_LATTICE
    told(0.3)
    if found.kind == "lattice" and not asked.printed:
        beside = (asked.previous, asked.following)
        before, after = (
            _neighbour(other, _place_of(other, scan, position, asked.origin), embedding, units)
            for other in beside
        )
        case = Case(
            scan, position, source, (found, reading), embedding, units, asked.left_out,
            asked.threads,
        )  # fmt: skip
        result = by_lattice(case, (before, after))
    elif found.kind == "terrestrial":
        result = _by_angles(scan, position, source, found, asked.printed, asked.threads, told)
    else:
        result = _not_judged(scan, position, source, found, asked.printed)
    if asked.lattice is not None and found.lattice is not asked.lattice and scan.num_points:
        reason = _why_not_given(at_origin(scan, position), asked.lattice, asked.threads)
        result = replace(result, reason=f"{result.reason}; {reason}")
    told(1.0)
    return result


def _why_not_given(scan: LidarFrame, lattice: SensorLattice, threads: int) -> str:
    """Reason why a scan was not judged by the lattice that was given."""
    if (why := why_off_lattice(scan, lattice, threads=threads)) is not None:
        return f"not judged by the given lattice: {why}"
    if not (lattice.range_step or lattice.power):
        return "the given lattice has no range steps, and its power was not measured"
    return "another scanner was stated or recognised than that of the given lattice"


def _stated_unit(scan: LidarFrame) -> str:
    """Unit of length that the scan's file states, if it is not the metre; else ''."""
    return "" if scan.format is None else str(scan.format.header.get("unit", ""))


def _verified(
    scan: LidarFrame, watermark: bytes | WatermarkResult | None, key: KeyFile | KeyRing | None
) -> WatermarkResult | None:
    """Result of the verifier for the record; None if there is no key."""
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
    if "tampered" in (signed.verdict, signed.content):  # ``verdict`` is also tampered for a replay
        verdict = "tampered"
    elif signed.content != "intact":
        verdict = "undecidable"
    regions = tuple(Region(region.box) for region in signed.regions)
    report = DetectorReport("watermark", verdict, signed.reason, signed.score, regions=regions)
    reports = (*result.detectors, report)
    if verdict != "tampered":
        return replace(result, detectors=reports, watermark=signed)
    reason = reason_of(verdict, reports, ())
    return replace(result, verdict="tampered", reason=reason, detectors=reports, watermark=signed)


def _carrying(scan: LidarFrame, trace: tuple[Processing, ...]) -> Inspection:
    """Result for a scan that carries the bits of an unverified watermark: points are displaced."""
    reports = tuple(DetectorReport(name, "undecidable", trace[0].detail) for name in FORENSIC)
    known = None
    if scan.origin is not None:
        x, y, z = (float(value) for value in position_of(scan.origin, "origin"))
        known = (x, y, z)
    return Inspection(
        "processed", reason_of("processed", reports, trace), scan.num_points, None, trace, known,
        "file" if known is not None else "not looked for in a scan with a watermark", reports,
        scan=scan,
    )  # fmt: skip


def _place_of(
    turn: ScanLike | None, scan: LidarFrame, position: Position | None, given: ArrayLike | None
) -> Position | None:
    """The scanner's position in a neighbouring turn, which may state its own.

    ``position`` is that in the scan; it differs from the scan's own statement if the scanner was
    found above or below. A given position is one place of a map, from which each turn may have been
    shifted near 0 by another amount.
    """
    if position is None or not isinstance(turn, LidarFrame):
        return position
    if given is not None:
        x, y, z = (np.add(position, map_shift(scan)) - map_shift(turn)).tolist()
        return (x, y, z)
    if turn.origin is None:
        return position
    own = position_of(turn.origin, "origin")
    lift = np.subtract(position, scan.origin) if scan.origin is not None else np.zeros(3)
    x, y, z = (float(value) for value in own + lift)
    return (x, y, z)


def _neighbour(
    scan: ScanLike | None, position: Position | None, embedding: str, units_per_m: int
) -> LidarFrame | None:
    if scan is None or position is None:
        return None
    frame = as_frame(scan)
    if embedding and find_carrier(frame.points, units_per_m) == embedding:
        points = without_bits(frame.points, embedding, units_per_m)
        frame = frame.replace(points=points, exact=None, format=None)
    return at_origin(frame, position)


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
    # For a scanner at (0, 0, 0), `identify` has already tested the grid around it.
    is_stated = source in ("argument", "file") and any(position)
    if is_stated and _fused(scan, position, threads):
        return without_position(scan, "several positions fused, or the scanner stood elsewhere")
    density = density_consistency(
        scan, parameters=PAPER_DENSITY if printed else None, origin=position, threads=threads
    )
    told(0.6)
    occlusion = occlusion_consistency(
        scan, parameters=PAPER_OCCLUSION if printed else None, origin=position, threads=threads
    )
    told(0.9)
    points = at_origin(scan, position).points
    processing = find_processing(points, sensor, None)
    why = why_thinned(points, occlusion.grid) if occlusion.grid.azimuth_deg > 0.0 else None
    if why is not None:
        processing = (*processing, Processing("thinned", why))
    if occlusion.echoes:
        processing = (*processing, Processing("echoes", UNNUMBERED))
    reports = (
        angles_report("density", density, sensor, is_thinned=why is not None),
        angles_report("occlusion", occlusion, sensor, is_thinned=why is not None),
        DetectorReport("generic", "undecidable", "no scan of a spinning scanner"),
    )
    return combined(
        scan, position, source, sensor, reports, processing, density=density, occlusion=occlusion,
        blind=(*BLIND, BLIND_WITHOUT_TURNS, BLIND_TERRESTRIAL, BLIND_SPARSE),
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
    points = at_origin(scan, position).points
    processing = () if scan.num_points < MIN_POINTS else find_processing(points, sensor, None)
    if sensor.kind == "unknown":
        processing = ()
    return combined(scan, position, source, sensor, reports, processing)


def repeating(found: Inspection, repeat: tuple[int, str] | None) -> Inspection:
    """Return the result of a scan, marked as repeated if it has the points of an earlier scan.

    Parameters
    ----------
    found : Inspection
    repeat : (int, str) or None
        Place of the earlier scan in the drive, and in words what points are equal; None: no earlier
        scan has the points.
    """
    if repeat is None:
        return found
    index, what = repeat
    step = Processing("repeated", f"number {index} of the drive has {what}")
    processing = (*found.processing, step)
    verdict = combined_verdict(found.detectors, processing)
    reason = found.reason
    if verdict != "tampered":
        reason = reason_of(verdict, found.detectors, processing)
    return replace(found, verdict=verdict, reason=reason, processing=processing, repeats=index)


def _fused(scan: LidarFrame, position: Position, threads: int) -> bool:
    """Whether the scan has a grid of angles that does not hold around the stated position."""
    grid = estimate_grid(scan, origin=position, threads=threads)
    return (
        grid.elevation_strength > 0.0
        and estimate_origin(scan, known=position, threads=threads).position is None
    )
