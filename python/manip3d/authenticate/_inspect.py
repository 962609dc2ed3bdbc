"""All detectors together: what one scan gives each of them to say, and the verdict that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d._util.showing import Showable
from manip3d.authenticate._density import PAPER_DENSITY, DensityResult, density_consistency
from manip3d.authenticate._generic import GenericResult, generic_consistency
from manip3d.authenticate._occlusion import (
    PAPER_OCCLUSION,
    OcclusionResult,
    estimate_grid,
    occlusion_consistency,
)
from manip3d.authenticate._origin import estimate_origin
from manip3d.authenticate._verdict import Calibration, Verdict
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, ScanLike, to_scan
from manip3d.lidar import place as place_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress

    Place = tuple[float, float, float]

TITLES = {
    "density": "I: spacing follows range",
    "occlusion": "II: nothing behind anything",
    "generic": "III: the sensor's lattice",
}
"""What each detector tests, by its name."""

_GENERIC_REASONS = {
    "authentic": "points lie where the sensor can measure",
    "tampered": "points lie where the sensor cannot measure",
    "undecidable": "no lattice of a spinning scanner in this scan",
}


@dataclass(frozen=True, eq=False)
class DetectorReport:
    """What one detector says of a scan, in the words that all of them share.

    Attributes
    ----------
    name : 'density', 'occlusion' or 'generic'
    verdict : 'authentic', 'tampered' or 'undecidable'
    reason : str
        The verdict's reason in words.
    score : float or None
        The detector's own measure, larger is more suspicious; None: it could not judge.
    p_value : float or None
        Probability, at most, that a clean scan shows as much; None: the detector states none.
    suspected : (K,) int64
        Rows of the suspected points.
    boxes : tuple of Box
        Boxes around the suspected points, metres.
    calibration : Calibration or None
        Where the thresholds come from; None: a publication, a user, or the detector needs none.
    """

    name: str
    verdict: Verdict
    reason: str
    score: float | None = None
    p_value: float | None = None
    suspected: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64), repr=False)
    boxes: tuple[Box, ...] = ()
    calibration: Calibration | None = None

    @property
    def title(self) -> str:
        """The test that the detector makes."""
        return TITLES[self.name]


@dataclass(frozen=True, eq=False)
class Inspection(Showable):
    """What `inspect` found.

    Attributes
    ----------
    verdict : 'authentic', 'tampered' or 'undecidable'
        The verdict of all detectors together, see `combined_verdict`.
    num_points : int
        Points of the scan.
    origin : (float, float, float) or None
        Position of the scanner, metres; None: it is not known, and nothing can be judged.
    origin_from : str
        ``argument``, ``file``, the words of `estimate_origin`, or why the position is not known.
    detectors : tuple of DetectorReport
        One report each of detectors I, II and III.
    density, occlusion, generic
        The detectors' own results with their maps; None where a detector did not run.
    scan : LidarFrame or None
        What was judged, so that the result can be shown.
    """

    verdict: Verdict
    num_points: int
    origin: Place | None
    origin_from: str
    detectors: tuple[DetectorReport, ...]
    density: DensityResult | None = field(default=None, repr=False)
    occlusion: OcclusionResult | None = field(default=None, repr=False)
    generic: GenericResult | None = field(default=None, repr=False)
    scan: LidarFrame | None = field(default=None, repr=False)

    def record(self) -> dict[str, Any]:
        """Return the result as JSON values, without the maps."""
        return {
            "verdict": self.verdict,
            "points": self.num_points,
            "origin": None if self.origin is None else list(self.origin),
            "origin_from": self.origin_from,
            "detectors": {report.name: self._detector(report) for report in self.detectors},
        }

    def _detector(self, report: DetectorReport) -> dict[str, Any]:
        values: dict[str, Any] = {
            "verdict": report.verdict,
            "reason": report.reason,
            "score": report.score,
            "p_value": report.p_value,
            "suspected_points": len(report.suspected),
            "boxes": [
                {"center": list(box.center), "size": list(box.size), "yaw": box.yaw}
                for box in report.boxes
            ],
            "calibration": None if report.calibration is None else vars(report.calibration),
        }
        if report.name == "density" and self.density is not None:
            values["offending_ranges"] = self.density.offending.tolist()
        if report.name == "occlusion" and self.occlusion is not None:
            grid = self.occlusion.grid
            values["cell_degrees"] = [grid.azimuth_deg, grid.elevation_deg]
        if report.name == "generic" and self.generic is not None:
            values["false_alarm_rate"] = self.generic.false_alarm_rate
        return values


@checked
def inspect(
    scan: ScanLike,
    *,
    origin: ArrayLike | None = None,
    printed: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> Inspection:
    """Judge whether a LiDAR scan was edited, by all detectors that can judge it.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        One scan of one scanner, metres.
    origin : (3,), optional
        Position of the scanner, metres; by default that of the frame, else what
        `estimate_origin` finds.
    printed : bool
        Use the thresholds printed in the dissertation instead of the calibrated ones.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        A shape is wrong, or a coordinate is not finite.

    Notes
    -----
    Detector III runs where the scan has no regular elevation grid: only spinning scanners have the
    lattice that it tests.

    Examples
    --------
    >>> import numpy as np
    >>> import manip3d
    >>> manip3d.authenticate.inspect(np.zeros((0, 3), np.float32)).verdict
    'undecidable'
    """
    frame = _as_frame(scan)
    with reporting(progress, "inspect") as report:
        told = report or (lambda _: None)
        place, source = _scanner(frame, origin, threads)
        told(0.1)
        if place is None:
            return _without_place(frame, source)
        return _judged(frame, place, source, printed, threads, told)


def _judged(
    frame: LidarFrame,
    place: Place,
    source: str,
    printed: bool,
    threads: int,
    told: Callable[[float], object],
) -> Inspection:
    density = density_consistency(
        frame, parameters=PAPER_DENSITY if printed else None, origin=place, threads=threads
    )
    told(0.5)
    occlusion = occlusion_consistency(
        frame, parameters=PAPER_OCCLUSION if printed else None, origin=place, threads=threads
    )
    told(0.7)
    generic = None
    if occlusion.grid.elevation_strength == 0.0:
        generic = generic_consistency(_at_origin(frame, place), threads=threads)
    told(1.0)
    reports = (_of_density(density), _of_occlusion(occlusion), _of_generic(generic, place))
    return Inspection(
        combined_verdict(reports), frame.num_points, place, source, reports, density, occlusion,
        generic, frame.replace(origin=place),
    )  # fmt: skip


@checked
def combined_verdict(reports: Sequence[DetectorReport]) -> Verdict:
    """Combine the verdicts of detectors I, II and III.

    Parameters
    ----------
    reports : sequence of DetectorReport

    Returns
    -------
    'authentic', 'tampered' or 'undecidable'
        ``tampered`` if a detector says so. ``undecidable`` where detector II cannot judge, because
        no single position explains the scan; then only detector III can say ``tampered``.
    """
    verdicts = {report.name: report.verdict for report in reports}
    if "occlusion" not in verdicts:
        raise InputError(f"reports: expected that of occlusion among them, got {list(verdicts)}")
    if verdicts["occlusion"] == "undecidable":
        return "tampered" if verdicts["generic"] == "tampered" else "undecidable"
    return "tampered" if "tampered" in verdicts.values() else "authentic"


def _as_frame(scan: ScanLike) -> LidarFrame:
    if isinstance(scan, LidarFrame):
        return scan
    points, intensity, _ = to_scan(scan)
    return LidarFrame(points, intensity if len(intensity) else None)


def _scanner(frame: LidarFrame, origin: ArrayLike | None, threads: int) -> tuple[Place | None, str]:
    """The scanner's position and who states it; or None and why the scan cannot be judged."""
    stated = origin if origin is not None else frame.origin
    if stated is None:
        found = estimate_origin(frame, threads=threads)
        return found.position, found.reason
    grid = estimate_grid(frame, origin=stated, threads=threads)
    if grid.elevation_strength > 0.0:  # there is a grid: does it hold for the whole scan?
        known = estimate_origin(frame, known=stated, threads=threads)
        if known.position is None:
            return None, "several positions fused, or the scanner stood elsewhere"
    x, y, z = (float(value) for value in place_of(stated, "origin"))
    return (x, y, z), "argument" if origin is not None else "file"


def _without_place(frame: LidarFrame, why: str) -> Inspection:
    reports = tuple(DetectorReport(name, "undecidable", why) for name in TITLES)
    return Inspection("undecidable", frame.num_points, None, why, reports, scan=frame)


def _at_origin(frame: LidarFrame, place: Place) -> LidarFrame:
    """The frame with the scanner in (0, 0, 0), as detector III takes it."""
    if not any(place):
        return frame
    return LidarFrame((frame.points - np.asarray(place)).astype(np.float32), frame.intensity)


def _of_density(found: DensityResult) -> DetectorReport:
    return DetectorReport(
        "density", found.verdict, found.reason, found.score, None,
        found.suspected.astype(np.int64), found.boxes, found.calibration,
    )  # fmt: skip


def _of_occlusion(found: OcclusionResult) -> DetectorReport:
    return DetectorReport(
        "occlusion", found.verdict, found.reason, found.score, None,
        found.suspected.astype(np.int64), found.boxes, found.calibration,
    )  # fmt: skip


def _of_generic(found: GenericResult | None, place: Place) -> DetectorReport:
    if found is None:
        return DetectorReport("generic", "undecidable", "no scan of a spinning scanner")
    return DetectorReport(
        "generic", found.verdict, _GENERIC_REASONS[found.verdict], found.score, found.p_value,
        found.suspected, tuple(_box(region.lower, region.upper, place) for region in found.regions),
    )  # fmt: skip


def _box(lower: Sequence[float], upper: Sequence[float], place: Place) -> Box:
    """The box between two corners, which are seen from the scanner, in the scan's own frame."""
    (a, b, c), (d, e, f) = lower, upper
    x, y, z = place
    return Box((x + (a + d) / 2, y + (b + e) / 2, z + (c + f) / 2), (d - a, e - b, f - c))
