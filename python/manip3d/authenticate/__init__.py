"""Has this scan been edited? Detectors that look at one scan and say what they found."""

from __future__ import annotations

from manip3d.authenticate._generic import (
    EvidenceReport,
    GenericResult,
    SuspectRegion,
    generic_consistency,
)
from manip3d.authenticate._lattice import LatticeReading, SensorLattice, estimate_lattice
from manip3d.authenticate._verdict import Calibration, Verdict

__all__ = [
    "Calibration",
    "EvidenceReport",
    "GenericResult",
    "LatticeReading",
    "SensorLattice",
    "SuspectRegion",
    "Verdict",
    "estimate_lattice",
    "generic_consistency",
]
