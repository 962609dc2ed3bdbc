"""Verdict on an RGB-D stream, with its regions and the reports of its detectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.mappings import ReadOnlyMapping
from manip3d.authenticate._verdict import Calibration, Power, Processing, Verdict, verdict_repr

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]

CALIBRATION = Calibration(
    "the turning person, the red kitchen of 7-Scenes and simulated people before a Kinect V2",
    125,
    0,
    "cameras other than a few of structured light and time of flight, and compositors that draw "
    "softer silhouettes, are not covered",
)
"""Clean frames on which `SHARP` was chosen; they are not those of `POWER`."""

_SIMULATED = "8 simulated people of other seeds before a simulated Kinect V2"
_WALL = "8 people of UTD-MHAD before the turning person's wall"
_KITCHEN = "8 people of UTD-MHAD in the red kitchen of 7-Scenes"

POWER: Mapping[str, Power] = ReadOnlyMapping(
    {
        "still background, time of flight": Power(16, 16, source=_SIMULATED),
        "running background, time of flight": Power(16, 16, source=_SIMULATED),
        "still background with wide shadows": Power(14, 16, source=_WALL),
        "running background with wide shadows": Power(16, 16, source=_WALL),
        "still background with wide shadows, full of near things": Power(6, 16, source=_KITCHEN),
        "running background with wide shadows, moving camera": Power(10, 16, source=_KITCHEN),
    }
)
"""Share of forged streams of `manip3d.forge.stream`, of both types and with one inserted person,
that are found; from experiment ``figure-5.8``. The forgeries have sharp silhouettes; blended ones
are not found. The other streams before a still background are ``processed``. Before a background of
structured light or stereo without wide shadows, such as an empty room, streams are ``undecidable``,
and so are most with two inserted people before a bare wall that a camera of time of flight sees."""

NO_POWER_HERE = (
    "How many forged streams are found does not apply to this one: whether somebody was cut out of "
    "it cannot be told."
)


@dataclass(frozen=True)
class StreamRegion:
    """A place in the image with evidence of an edit.

    Attributes
    ----------
    frame : int
        Number of the frame.
    box : (int, int, int, int)
        First column, first row, width and height.
    share : float
        Share of sharp rows on the less sharp side of the silhouette; 1 before a frozen background.
    """

    frame: int
    box: tuple[int, int, int, int]
    share: float


@dataclass(frozen=True)
class StreamReport:
    """Report of one detector on a stream.

    Attributes
    ----------
    name : 'repetition', 'silhouettes' or 'noise'
        Name of the detector.
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
        Verdict of the detector.
    reason : str
        Reason of the verdict in words.
    score : float or None
        The detector's own measure, larger is more suspicious; for ``noise`` smaller.
    """

    name: str
    verdict: Verdict
    reason: str
    score: float | None = None


@dataclass(frozen=True, eq=False)
class StreamInspection:
    """Result of `inspect_stream`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
    reason : str
        Reason of the verdict in words.
    score : float or None
        Sharpness of silhouettes, larger is more suspicious; None: there is no silhouette to judge.
    p_value : None
        Always None: no probability is stated.
    regions : tuple of StreamRegion
        Places of inserted objects, frame by frame.
    masks : (T, H, W) bool
        Pixels of inserted objects in the frames of ``numbers``; empty without evidence.
    numbers : (T,) int64
        Numbers of the frames that were judged; their places in the stream if all numbers are equal.
    processing : tuple of Processing
        Processing of all images.
    detectors : tuple of StreamReport
        Reports of the detectors.
    noise : (N - 1,) float64
        Inter-frame noise of the judged pairs of frames, as published.
    power : mapping of str to Power
        Share of forged streams found, by kind, measured on streams that chose no threshold. Empty
        if the verdict is ``processed`` or ``undecidable``, because it does not apply then.
    calibration : Calibration
        Clean frames on which the thresholds were chosen.
    """

    verdict: Verdict
    reason: str
    score: float | None
    regions: tuple[StreamRegion, ...] = ()
    masks: Mask = field(default_factory=lambda: np.zeros((0, 0, 0), np.bool_), repr=False)
    numbers: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), repr=False)
    processing: tuple[Processing, ...] = ()
    detectors: tuple[StreamReport, ...] = ()
    noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), repr=False)
    power: Mapping[str, Power] = field(default_factory=lambda: POWER, repr=False)
    calibration: Calibration = CALIBRATION
    p_value: None = None

    __repr__ = verdict_repr

    def record(self) -> dict[str, Any]:
        """Return the result as JSON values, without the masks."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "score": self.score,
            "p_value": self.p_value,
            "frames": len(self.numbers),
            "median_inter_frame_noise": float(np.median(self.noise)) if len(self.noise) else None,
            "processing": [vars(step) for step in self.processing],
            "regions": [vars(region) for region in self.regions],
            "detectors": [vars(report) for report in self.detectors],
            "power": {k: {**vars(p), "share": p.share} for k, p in self.power.items()},
            "calibration": vars(self.calibration),
        }


def box_of(mask: Mask) -> tuple[int, int, int, int]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    u, v = int(columns[0]), int(rows[0])
    return u, v, int(columns[-1]) - u + 1, int(rows[-1]) - v + 1
