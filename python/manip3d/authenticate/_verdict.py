"""What all detectors say in the same words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Verdict: TypeAlias = Literal["authentic", "tampered", "undecidable"]
"""``undecidable``: the scan gives the detector nothing to judge by (several positions fused, too
few points); never a guess."""


@dataclass(frozen=True)
class Calibration:
    """Where the thresholds of a detector come from.

    Attributes
    ----------
    scenes : str
        The clean scans on which they were fixed; never those of a report.
    num_scans : int
    false_alarms : int
        Of those scans, with the thresholds as they are.
    note : str
        What they do not cover.
    """

    scenes: str
    num_scans: int
    false_alarms: int
    note: str = ""
