"""Make the reports of the detectors on a scan, and combine them to an inspection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.authenticate._density import DensityResult
from manip3d.authenticate._generic import GenericResult
from manip3d.authenticate._inspection import (
    DetectorReport,
    Inspection,
    accusing_of,
    combined_verdict,
)
from manip3d.authenticate._known_power import known_power
from manip3d.authenticate._occlusion import OcclusionRegion, OcclusionResult
from manip3d.authenticate._reflectance import ReflectanceResult
from manip3d.authenticate._sensors import HDL64E, Sensor
from manip3d.authenticate._turns import TurnResult
from manip3d.authenticate._verdict import NO_POWER, Calibration, Power, Processing, Region, Verdict
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    Position = tuple[float, float, float]


FORENSIC = ("density", "occlusion", "generic")
"""Detectors I, II and III, which judge the scan alone."""

LATTICE_CALIBRATION = Calibration(
    "simulated streets 80000 to 80050, ten frames each",
    510,
    0,
    "Below a p-value of 1 / 511 the rate of false alarms was not measured; there the p-value "
    "assumes that clean scans have no outliers except independent stray points.",
    chose=False,
)
"""Clean frames on which detector III was tested. Smaller p-values than 1 / 511 rest on a model
alone; `inspect` states them as ``model_p_value`` only."""

EXACT_CALIBRATION = Calibration(
    "simulated streets 90000 to 91019, one turn each of a Hesai Pandar40P, a PandarXT-32 or an "
    "Ouster OS1-32",
    1020,
    0,
    "Of five real clouds of five such scanners no point is off its own lattice.",
    chose=False,
)
"""Clean frames with exact lattices on which detector III was tested."""


def combined(
    scan: LidarFrame,
    position: Position,
    source: str,
    sensor: Sensor,
    reports: tuple[DetectorReport, ...],
    processing: tuple[Processing, ...],
    **results: Any,
) -> Inspection:
    """The inspection of a scan with the combined verdict of reports and processing."""
    verdict = combined_verdict(reports, processing)
    return Inspection(
        verdict, reason_of(verdict, reports, processing), scan.num_points, sensor, processing,
        position, source, reports, scan=scan.replace(origin=position), **results,
    )  # fmt: skip


def reason_of(
    verdict: Verdict, reports: Sequence[DetectorReport], processing: Sequence[Processing]
) -> str:
    """The reason of a verdict: the processing, or the reasons of the deciding detectors."""
    if verdict == "processed" and processing:
        return "; ".join(f"{step.kind}: {step.detail}" for step in processing)
    if verdict == "undecidable":
        last = reports[-1]  # a score: it judged the scan, without known power
        has_said = last.score is not None and last.verdict == "undecidable"
        return last.reason if has_said else reports[0].reason
    accusing = accusing_of(reports) if verdict == "tampered" else ()
    deciding = accusing or [next(r for r in reports if r.verdict == verdict)]
    return "; ".join(f"{_named(report)}: {report.reason}" for report in deciding)


def _named(report: DetectorReport) -> str:
    return report.name if report.name == "watermark" else f"detector {report.number}"


def without_position(frame: LidarFrame, why: str) -> Inspection:
    """The inspection of a scan that cannot be judged because its scanner's position is unknown."""
    reports = tuple(DetectorReport(name, "undecidable", why) for name in FORENSIC)
    return Inspection(
        "undecidable", why, frame.num_points, None, (), None, why, reports, scan=frame
    )


def not_applicable(sensor: Sensor, power: Mapping[str, Power]) -> tuple[DetectorReport, ...]:
    """Reports of detectors I and II, which do not judge scans on a lattice.

    Parameters
    ----------
    sensor : Sensor
    power : mapping of str to Power
        Power of detector III on scans of this scanner; empty: not measured.
    """
    why = f"detector III judges the {sensor.name}"
    if not power:
        why += ", and what share of edits it finds was not measured for this scanner"
        if sensor.name == HDL64E:
            why += ": calibrate_lattice (manip3d lattice) measures it in clean scans"
    return tuple(DetectorReport(name, "undecidable", why) for name in ("density", "occlusion"))


def angles_report(
    name: str, found: DensityResult | OcclusionResult, sensor: Sensor, *, is_thinned: bool
) -> DetectorReport:
    """Report of detector I or II; the power was measured on scans that fill their grid.

    A filter of voxels changes the spacing that detector I expects at each range.
    """
    if is_thinned and name == "density":
        return DetectorReport(name, "undecidable", "points were left out, which changes spacings")
    power = NO_POWER if is_thinned else known_power(name, sensor)
    regions = tuple(
        Region(region.box, region.rows, evidence=_evidence_of(region)) for region in found.regions
    )
    return DetectorReport(
        name, found.verdict, found.reason, found.score, None, regions,
        found.suspected.astype(np.int64), power, found.calibration,
    )  # fmt: skip


def _evidence_of(region: Region | OcclusionRegion) -> Mapping[str, float]:
    """Kinds of evidence of a region of detector I, which has none, or II."""
    return {"occluding": region.area} if isinstance(region, OcclusionRegion) else {}


def generic_report(
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
        found.p_value if judged else None,
    )  # fmt: skip


def turns_report(
    turns: TurnResult | None,
    beside: Sequence[LidarFrame | None],
    why_not: Sequence[str],
    position: Position,
    sensor: Sensor,
    embedding: str,
) -> tuple[DetectorReport, ...]:
    """Report of detector IV, or why it could not judge the given frames; empty: none were given."""
    if turns is not None:
        return (report_of("turns", turns, position, known_power("turns", sensor, embedding)),)
    if any(other is None for other in beside) or (not why_not and sensor.name == HDL64E):
        return ()
    reasons = why_not or [f"there are no thresholds for a {sensor.name}"]
    return (DetectorReport("turns", "undecidable", "; ".join(reasons)),)


def reflectance_report(
    found: ReflectanceResult | None, position: Position, sensor: Sensor, embedding: str
) -> tuple[DetectorReport, ...]:
    """Report of detector V; empty if it did not run."""
    if found is None:
        return ()
    setting = "reflectance" if found.with_turns else "reflectance alone"
    power = known_power(setting, sensor, embedding)
    return (report_of("reflectance", found, position, power),)


def report_of(
    name: str, found: TurnResult | ReflectanceResult, position: Position, power: Mapping[str, Power]
) -> DetectorReport:
    """Report of detector IV or V; boxes are moved from the scanner's frame to the scan's."""
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
    """The box in the frame of the scan, from one in the frame of the scanner."""
    x, y, z = box.center
    return replace(box, center=(x + position[0], y + position[1], z + position[2]))
