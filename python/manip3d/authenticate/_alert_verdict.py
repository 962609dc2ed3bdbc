"""Verdict on a frame of a drive (alert): the reports of its witnesses and their combination."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from manip3d.authenticate._cross_modal import CrossModalResult
from manip3d.authenticate._inspection import Inspection
from manip3d.authenticate._risk import Risk
from manip3d.authenticate._surround import SurroundResult
from manip3d.authenticate._watermark import WatermarkResult
from manip3d.lidar import Box

NO_PAIR = "no stereo pair"
"""Reason of absent cameras where a frame has no pictures."""

WITNESSES = ("watermark", "cross-modal", "forensics")


@dataclass(frozen=True)
class WitnessReport:
    """Verdict of one witness (watermark, cameras or forensics) on one frame.

    Attributes
    ----------
    verdict : str
        ``authentic`` (the watermark alone), ``no_trace``, ``tampered``, ``processed``,
        ``undecidable``, ``skipped`` (no time in this frame) or ``absent`` (there is no key, or
        there are no pictures).
    reason : str
        Reason of the verdict in words.
    seconds : float
        Time that the witness took.
    """

    verdict: str
    reason: str
    seconds: float = 0.0

    def record(self) -> dict[str, object]:
        """Return the fields, ready for JSON."""
        return {"verdict": self.verdict, "reason": self.reason, "seconds": self.seconds}


@dataclass(frozen=True, eq=False)
class Alert:
    """The verdict on one frame.

    Attributes
    ----------
    number : int
        Index of the frame in the monitor's stream, from 0; skipped frames count.
    verdict : 'authentic', 'no_trace', 'tampered', 'undecidable' or 'skipped'
        ``tampered`` if watermark or forensics accuse; ``undecidable`` if the cameras alone accuse,
        because they accuse too many clean frames to decide. ``authentic`` rests on the watermark
        alone: a frame without one is at best ``no_trace``.
    reason : str
        Reason of the verdict in words.
    witnesses : mapping of str to WitnessReport
        Reports of ``watermark``, ``cross-modal`` (cameras) and ``forensics``.
    attack : str
        Type of the attack, one of `ATTACK_TYPES`, from the most specific accusing witness: cameras,
        then forensics, then the watermark; empty if no attack was located.
    boxes : tuple of Box
        Boxes around the attacks in the LiDAR's frame, from all accusing witnesses. Boxes of the
        watermark are whole sectors.
    risk : Risk
        Risk of the gravest observation of these witnesses.
    seconds : float
        Time from receiving the frame to this verdict.
    is_late : bool
        Whether that time exceeds the budget.
    cross_modal : CrossModalResult, SurroundResult or None
        Result of the cameras; a `SurroundResult` if the monitor has several stereo pairs. None:
        they did not judge the frame.
    watermark : WatermarkResult or None
        Result of the watermark; None: it was not verified.
    forensics : Inspection or None
        Result of the detectors; None: they did not judge the frame.
    scan : str
        Name of the frame's scan, or its time in seconds; empty: unknown. Unlike ``number``, it is
        the same after earlier scans were lost. `watch_drive` sets it.
    """

    number: int
    verdict: str
    reason: str
    witnesses: Mapping[str, WitnessReport]
    attack: str
    boxes: tuple[Box, ...]
    risk: Risk
    seconds: float
    is_late: bool
    cross_modal: CrossModalResult | SurroundResult | None = field(default=None, repr=False)
    watermark: WatermarkResult | None = field(default=None, repr=False)
    forensics: Inspection | None = field(default=None, repr=False)
    scan: str = ""

    def __repr__(self) -> str:
        told = f"frame {self.number}, risk {self.risk.level}"
        return f"<manip3d.authenticate.Alert: {self.verdict}; {self.reason}; {told}>"

    def brief(self) -> Alert:
        """Return the alert without scans, maps and points, so that a whole drive fits in memory.

        The tiles of an authentic watermark are left out, too.

        Examples
        --------
        >>> from manip3d.authenticate import AlertMonitor
        >>> AlertMonitor().skip("too late").brief().verdict
        'skipped'
        """
        kept = self.watermark
        if kept is not None:
            tiles = () if kept.verdict == "authentic" else kept.tiles
            kept = replace(
                kept, scan=None, tiles=tiles, regions=(), suspected=np.empty(0, np.int64)
            )
        return replace(self, cross_modal=None, watermark=kept, forensics=None)

    def record(self) -> dict[str, Any]:
        """Return the alert without maps, ready for JSON; tiles of the watermark are included."""
        return {
            "frame": self.number,
            "scan": self.scan,
            "verdict": self.verdict,
            "reason": self.reason,
            "attack": self.attack,
            "witnesses": {name: each.record() for name, each in self.witnesses.items()},
            "boxes": [
                {"label": b.label, "center": list(b.center), "size": list(b.size), "yaw": b.yaw}
                for b in self.boxes
            ],
            "risk": self.risk.record(),
            "seconds": self.seconds,
            "is_late": self.is_late,
            "cross_modal": None if self.cross_modal is None else self.cross_modal.record(),
            "watermark": None if self.watermark is None else self.watermark.record(),
        }


@dataclass(frozen=True)
class AlertCounts:
    """Counts and times of a monitor so far.

    Attributes
    ----------
    frames : int
        Frames that arrived.
    verdicts : mapping of str to int
        Number of frames by verdict; ``skipped`` counts frames that no witness judged.
    skipped : mapping of str to int
        By witness: number of frames in which it had no time, or was not due. Several stereo pairs
        are also counted separately, as ``cross-modal NAME``.
    late : int
        Frames whose verdict took longer than the budget.
    slowest_s, mean_s : float
        Longest and mean time for a verdict, over the frames that were judged.
    """

    frames: int
    verdicts: Mapping[str, int]
    skipped: Mapping[str, int]
    late: int
    slowest_s: float
    mean_s: float

    def record(self) -> dict[str, Any]:
        """Return the fields, ready for JSON."""
        return {
            "frames": self.frames,
            "verdicts": dict(self.verdicts),
            "skipped": dict(self.skipped),
            "late": self.late,
            "slowest_s": self.slowest_s,
            "mean_s": self.mean_s,
        }


def joined(told: Mapping[str, WitnessReport], *, has_key: bool) -> tuple[str, str]:
    """Combine the reports into a verdict and its reason.

    An accusation by watermark or forensics makes the frame ``tampered``, one by the cameras alone
    ``undecidable``. Only the watermark can make it ``authentic``.
    """
    for name in ("watermark", "forensics"):
        if told[name].verdict == "tampered":
            return "tampered", f"{name}: {told[name].reason}"
    if told["cross-modal"].verdict == "tampered":
        reason = f"cross-modal: {told['cross-modal'].reason}; cameras accuse clean frames too"
        return "undecidable", f"{reason}, so another witness has to agree"
    sworn = told["watermark"]
    if has_key:
        return sworn.verdict, f"watermark: {sworn.reason}"
    for name in ("cross-modal", "forensics"):
        if told[name].verdict == "no_trace":
            return "no_trace", f"{name}: {told[name].reason}"
    for name in ("cross-modal", "forensics"):
        if told[name].verdict in ("undecidable", "processed"):
            return "undecidable", f"{name}: {told[name].reason}"
    return "undecidable", "no witness has seen this frame"
