"""Has this scan been edited? Detectors that look at one scan and say what they found."""

from __future__ import annotations

from manip3d.authenticate._verdict import Calibration, Verdict

__all__ = ["Calibration", "Verdict"]
