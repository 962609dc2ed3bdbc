"""Results of an inspection: the reports of all detectors, and the combined verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.authenticate._density import DensityResult
from manip3d.authenticate._generic import GenericResult
from manip3d.authenticate._known_power import known_power
from manip3d.authenticate._occlusion import OcclusionResult
from manip3d.authenticate._power import (
    BLIND,
    BLIND_WITHOUT_TURNS,
    FARTHEST,
    MIN_POINTS,
    NEAREST,
    OBJECT_RADIUS,
    UNMEASURED_REFLECTANCES,
)
from manip3d.authenticate._reflectance import ReflectanceResult
from manip3d.authenticate._repeats import points_id
from manip3d.authenticate._sensors import Sensor
from manip3d.authenticate._turns import TurnResult
from manip3d.authenticate._verdict import (
    NO_POWER,
    RATE_SHARES,
    Calibration,
    Power,
    Processing,
    Region,
    Verdict,
    likelihood_ratio,
)
from manip3d.authenticate._watermark import WatermarkResult
from manip3d.lidar import Box, LidarFrame, map_shift, shifted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Position = tuple[float, float, float]

TITLES = {
    "density": "I: spacing follows range",
    "occlusion": "II: nothing behind anything",
    "generic": "III: the sensor's lattice",
    "turns": "IV: the turns before and after",
    "reflectance": "V: the reflectances",
    "watermark": "Keyed watermark",
}
"""The property that each detector tests, by its name."""


@dataclass(frozen=True, eq=False)
class DetectorReport:
    """Verdict of one detector on a scan; all detectors share its attributes (`Detection`).

    Attributes
    ----------
    name : 'density', 'occlusion', 'generic', 'turns', 'reflectance' or 'watermark'
        Name of the detector; `title` describes its test.
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
        Verdict of this detector.
    reason : str
        Reason of the verdict in words.
    score : float or None
        The detector's own measure of suspicion, larger is more suspicious; None: it could not
        judge.
    p_value : float or None
        Upper bound of the probability that a clean scan shows as much evidence; None: the detector
        states none. If it was calibrated on ``n`` clean scans, it is never below 1 / (n + 1),
        because ``n`` scans do not support a smaller value.
    regions : tuple of Region
        Places with evidence, the most significant first.
    suspected : (K,) int64
        Rows of the suspected points.
    power : mapping of str to Power
        Share of the edits of each class that the detector finds in clean scans of this scanner;
        empty: not measured for this scanner.
    calibration : Calibration or None
        Scans on which the thresholds were chosen; None: the thresholds come from a publication or a
        user, or the detector needs none.
    model_p_value : float or None
        Detector III: the p-value that its model of clean scans states, also below 1 / (n + 1). The
        verdict follows from it. 0: below the range of double precision. None: as ``p_value``.
    """

    name: str
    verdict: Verdict
    reason: str
    score: float | None = None
    p_value: float | None = None
    regions: tuple[Region, ...] = ()
    suspected: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64), repr=False)
    power: Mapping[str, Power] = field(default_factory=lambda: NO_POWER, repr=False)
    calibration: Calibration | None = None
    model_p_value: float | None = None

    __repr__ = short_repr

    @property
    def least_p_value(self) -> float | None:
        """The p-value of which the verdict is made: ``model_p_value``, else ``p_value``."""
        return self.p_value if self.model_p_value is None else self.model_p_value

    @property
    def title(self) -> str:
        """Test that the detector makes."""
        return TITLES[self.name]

    @property
    def number(self) -> str:
        """Number of the detector, such as III; for a watermark its title."""
        return self.title.partition(":")[0]

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Boxes around the suspected points, metres."""
        return tuple(region.box for region in self.regions)

    @property
    def could_object(self) -> bool:
        """Whether the detector finds at least half of the edits of some class, as measured."""
        return any(power.share >= 0.5 for power in self.power.values())


@dataclass(frozen=True, eq=False)
class Inspection(Showable):
    """Result of `inspect`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
        Combined verdict of all detectors, see `combined_verdict`.
    reason : str
        Reason of the verdict in words.
    num_points : int
        Number of points of the scan.
    sensor : Sensor or None
        Scanner of the scan; None: its position is unknown.
    processing : tuple of Processing
        Processing of the scan as a whole.
    origin : (float, float, float) or None
        Position of the scanner, metres; None: unknown, and nothing can be judged.
    origin_from : str
        Source of the position: ``argument``, ``file``, the words of `estimate_origin`, or the
        reason why it is unknown.
    detectors : tuple of DetectorReport
        Reports of detectors I, II and III; of detector IV if the previous and following frames were
        given; of detector V if a frame of a spinning scanner has reflectances; and of the watermark
        if a record and a key were given.
    blind : tuple of str
        Classes of edits that no detector finds in scans of this scanner.
    planted_here : mapping of str to Power
        By class of edit: how many of the edits that were planted in copies of this scan all
        detectors together find (also stated by ``power``); empty: none were planted.
    density, occlusion, generic, turns, reflectance
        Full results of the detectors with their maps; None: the detector did not run.
    scan : LidarFrame or None
        The scan that was judged; the viewer shows it.
    watermark : WatermarkResult or None
        Result of the watermark's verifier; None: no record or no key was given.
    repeats : int or None
        Place in the drive, from 0, of an earlier scan with the same points; None: there is none, or
        the scan was inspected alone.
    """

    verdict: Verdict
    reason: str
    num_points: int
    sensor: Sensor | None
    processing: tuple[Processing, ...]
    origin: Position | None
    origin_from: str
    detectors: tuple[DetectorReport, ...]
    blind: tuple[str, ...] = (*BLIND, BLIND_WITHOUT_TURNS)
    planted_here: Mapping[str, Power] = field(default_factory=lambda: NO_POWER, repr=False)
    density: DensityResult | None = field(default=None, repr=False)
    occlusion: OcclusionResult | None = field(default=None, repr=False)
    generic: GenericResult | None = field(default=None, repr=False)
    turns: TurnResult | None = field(default=None, repr=False)
    reflectance: ReflectanceResult | None = field(default=None, repr=False)
    scan: LidarFrame | None = field(default=None, repr=False)
    watermark: WatermarkResult | None = field(default=None, repr=False)
    repeats: int | None = None

    def __repr__(self) -> str:
        sensor = "unknown scanner" if self.sensor is None else self.sensor.name
        scan = f"{counted(self.num_points, 'point')}, {sensor}"
        return f"<manip3d.authenticate.Inspection: {self.verdict}; {self.reason}; {scan}>"

    @property
    def accusing(self) -> DetectorReport | None:
        """Report of the ``tampered`` detector with most evidence, else of a watermark, else None.

        See `all_accusing` for the order.
        """
        return next(iter(self.all_accusing), None)

    @property
    def all_accusing(self) -> tuple[DetectorReport, ...]:
        """Reports of all ``tampered`` detectors, in this order.

        Detectors that suspect points come first, and a watermark last, since its regions have no
        rows. Among others, the smallest p-value in proportion to the detector's limit comes first.
        """
        return accusing_of(self.detectors)

    @property
    def score(self) -> float | None:
        """Largest score of the detectors with the combined verdict."""
        return max((r.score for r in self._deciding() if r.score is not None), default=None)

    @property
    def p_value(self) -> float | None:
        """Smallest p-value of the detectors with the combined verdict.

        It is never below the bound that calibrations support, see `DetectorReport`, and may
        therefore exceed the limit below which a detector accuses.
        """
        return min((r.p_value for r in self._deciding() if r.p_value is not None), default=None)

    @property
    def model_p_value(self) -> float | None:
        """Smallest p-value of the detectors with the combined verdict, without that bound."""
        known = (r.least_p_value for r in self._deciding())
        return min((p_value for p_value in known if p_value is not None), default=None)

    @property
    def likelihood_ratio(self) -> float | None:
        """Lower bound of the likelihood ratio of the evidence: edited against clean.

        The bound is that of the smallest p-value of the detectors, times the number of detectors
        with a p-value; see `likelihood_ratio`. None: no detector states a p-value, or the scan was
        processed.
        """
        p_values = [r.p_value for r in self.detectors if r.p_value is not None]
        if not p_values or self.verdict == "processed":
            return None
        return likelihood_ratio(min(1.0, min(p_values) * len(p_values)))

    @property
    def regions(self) -> tuple[Region, ...]:
        """Places with evidence, from all detectors with the combined verdict."""
        return tuple(region for report in self._deciding() for region in report.regions)

    @property
    def suspected(self) -> NDArray[np.int64]:
        """Rows of the points that the detectors with the combined verdict suspect, ascending."""
        rows = [report.suspected for report in self._deciding()]
        return np.unique(np.concatenate(rows)) if rows else np.empty(0, np.int64)

    @property
    def power(self) -> Mapping[str, Power]:
        """Power by class of edit: that of the best detector, with the counts of `planted_here`."""
        best: dict[str, Power] = {}
        for report in self.detectors:
            for name, power in report.power.items():
                if name not in best or power.share > best[name].share:
                    best[name] = power
        for name, here in self.planted_here.items():
            if name in best:
                best[name] = replace(best[name], here_found=here.found, here_planted=here.planted)
        return ReadOnlyMapping(best)

    @property
    def power_notes(self) -> tuple[str, ...]:
        """Sentences that state for which edits ``power`` was measured, and what would raise it."""
        power = self.power
        if self.generic is None or self.sensor is None or not power:
            return ()
        notes = [
            f"Planted edits are of one object, or of its part within {OBJECT_RADIUS:g} m of a "
            f"point, with at least {MIN_POINTS} returns, {NEAREST:.0f} to {FARTHEST:.0f} m from "
            "the scanner; nothing was measured of smaller and farther objects."
        ]
        if any(
            r.name == "reflectance" and r.p_value is not None and not r.power
            for r in self.detectors
        ):
            notes.append(UNMEASURED_REFLECTANCES)
        alone = power.get("removed")
        beside = known_power("turns", self.sensor).get("removed")
        if alone is not None and beside is not None and alone.share < beside.share:
            notes.append(
                f"Of objects that were left out, {alone.share:.0%} are found in a scan alone, and "
                f"{beside.share:.0%} ({beside.found} of {beside.planted}) where the scans before "
                "and after are given, too."
            )
        return tuple(notes)

    @property
    def calibration(self) -> Calibration | None:
        """Calibration of the first detector with the combined verdict that has one, else None."""
        return next((r.calibration for r in self._deciding() if r.calibration is not None), None)

    def _deciding(self) -> tuple[DetectorReport, ...]:
        return tuple(report for report in self.detectors if report.verdict == self.verdict)

    def in_file(self, region: Region) -> Region:
        """Return a region with its box in the coordinates of the scan's file.

        They differ from those of ``scan`` if the file has coordinates of a map, which are shifted
        near 0 on reading.

        Parameters
        ----------
        region : Region
            One of the regions of ``detectors``.
        """
        return replace(region, box=shifted(region.box, map_shift(self.scan)))

    @property
    def origin_in_file(self) -> Position | None:
        """Position of the scanner in the coordinates of the scan's file, metres."""
        if self.origin is None:
            return None
        x, y, z = (np.asarray(self.origin) + map_shift(self.scan)).tolist()
        return (x, y, z)

    def record(self) -> dict[str, Any]:
        """Return the result as JSON values, without the maps; places are those of the file."""
        origin = self.origin_in_file
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "score": self.score,
            "p_value": self.p_value,
            "model_p_value": self.model_p_value,
            "likelihood_ratio": self.likelihood_ratio,
            "points": self.num_points,
            "points_id": None if self.scan is None else points_id(self.scan.points),
            "sensor": None if self.sensor is None else self.sensor.name,
            "sensor_reason": None if self.sensor is None else self.sensor.reason,
            "processing": [vars(step) for step in self.processing],
            "repeats": self.repeats,
            "regions": [self.in_file(region).record() for region in self.regions],
            "power": {name: power.record() for name, power in self.power.items()},
            "power_notes": list(self.power_notes),
            "blind": list(self.blind),
            "origin": None if origin is None else list(origin),
            "origin_from": self.origin_from,
            "watermark": None if self.watermark is None else self.watermark.record(),
            "detectors": {report.name: self._detector(report) for report in self.detectors},
        }

    def _detector(self, report: DetectorReport) -> dict[str, Any]:
        values: dict[str, Any] = {
            "verdict": report.verdict,
            "reason": report.reason,
            "score": report.score,
            "p_value": report.p_value,
            "model_p_value": report.least_p_value,
            "suspected_points": len(report.suspected),
            "boxes": [
                {"center": list(box.center), "size": list(box.size), "yaw": box.yaw}
                for box in (self.in_file(region).box for region in report.regions)
            ],
            "power": {name: power.record() for name, power in report.power.items()},
            "calibration": None if report.calibration is None else vars(report.calibration),
        }
        if report.name == "density" and self.density is not None:
            values["offending_ranges"] = self.density.offending.tolist()
        if report.name == "occlusion" and self.occlusion is not None:
            grid = self.occlusion.grid
            values["cell_degrees"] = [grid.azimuth_deg, grid.elevation_deg]
        if report.name == "generic" and self.generic is not None:
            values["false_alarm_rate"] = self.generic.false_alarm_rate
        if report.name == "turns" and self.turns is not None:
            values["false_alarm_rate"] = self.turns.false_alarm_rate
        if report.name == "reflectance" and self.reflectance is not None:
            values["false_alarm_rate"] = self.reflectance.false_alarm_rate
        return values


def accusing_of(reports: Sequence[DetectorReport]) -> tuple[DetectorReport, ...]:
    """Return the tampered reports in the order of `Inspection.all_accusing`.

    Parameters
    ----------
    reports : sequence of DetectorReport
    """

    def weakness(report: DetectorReport) -> tuple[bool, bool, float]:
        p_value, limit = report.least_p_value, RATE_SHARES.get(report.name, 1.0)
        relative = 1.0 if p_value is None else p_value / limit
        return report.name == "watermark", not len(report.suspected), relative

    tampered = (report for report in reports if report.verdict == "tampered")
    return tuple(sorted(tampered, key=weakness))


@checked
def combined_verdict(
    reports: Sequence[DetectorReport], processing: Sequence[Processing] = ()
) -> Verdict:
    """Combine the verdicts of all detectors that were run.

    Parameters
    ----------
    reports : sequence of DetectorReport
        Reports of the detectors.
    processing : sequence of Processing
        Processing of the scan as a whole.

    Returns
    -------
    'no_trace', 'tampered', 'processed' or 'undecidable'
        ``tampered`` if a detector's verdict is. Else ``processed`` if the scan was processed as a
        whole, which can hide an edit. Else ``no_trace`` if that is the verdict of a detector that
        finds at least half of the edits of some class, as measured on clean scans of this scanner.
        Else ``undecidable``.

    Raises
    ------
    InputError
        ``reports`` or ``processing`` holds an item of another type.

    Examples
    --------
    >>> from manip3d.authenticate import DetectorReport, Processing, combined_verdict
    >>> found = DetectorReport("occlusion", "tampered", "points behind a wall")
    >>> rounded = Processing("rounded", "to 1 cm")
    >>> combined_verdict([found], [rounded]), combined_verdict([], [rounded]), combined_verdict([])
    ('tampered', 'processed', 'undecidable')
    """
    verdicts = {report.verdict for report in reports}
    if "tampered" in verdicts:
        return "tampered"
    if len(processing) or "processed" in verdicts:
        return "processed"
    if any(report.verdict == "no_trace" and report.could_object for report in reports):
        return "no_trace"
    return "undecidable"
