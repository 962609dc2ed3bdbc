"""Has this scan or stream been edited? Detectors that look at it and say what they found."""

from __future__ import annotations

from manip3d.authenticate._density import (
    CALIBRATED_DENSITY,
    PAPER_DENSITY,
    SPARSE_DENSITY,
    DensityParameters,
    DensityResult,
    density_consistency,
)
from manip3d.authenticate._generic import (
    EvidenceReport,
    GenericResult,
    SuspectRegion,
    generic_consistency,
)
from manip3d.authenticate._inspect import (
    DetectorReport,
    Inspection,
    combined_verdict,
    inspect,
)
from manip3d.authenticate._lattice import LatticeReading, SensorLattice, estimate_lattice
from manip3d.authenticate._occlusion import (
    CALIBRATED_OCCLUSION,
    PAPER_OCCLUSION,
    RINGS_OCCLUSION,
    AngularGrid,
    OcclusionParameters,
    OcclusionRegion,
    OcclusionResult,
    estimate_grid,
    occlusion_consistency,
)
from manip3d.authenticate._origin import OriginEstimate, estimate_origin
from manip3d.authenticate._power import EDITS, measure_power
from manip3d.authenticate._sensors import Sensor, identify_sensor, kitti_lattice
from manip3d.authenticate._streams import (
    StreamInspection,
    StreamRegion,
    StreamReport,
    depth_noise,
    inspect_stream,
    inter_frame_noise,
)
from manip3d.authenticate._verdict import Calibration, Power, Processing, Region, Verdict

__all__ = [
    "CALIBRATED_DENSITY",
    "CALIBRATED_OCCLUSION",
    "EDITS",
    "PAPER_DENSITY",
    "PAPER_OCCLUSION",
    "RINGS_OCCLUSION",
    "SPARSE_DENSITY",
    "AngularGrid",
    "Calibration",
    "DensityParameters",
    "DensityResult",
    "DetectorReport",
    "EvidenceReport",
    "GenericResult",
    "Inspection",
    "LatticeReading",
    "OcclusionParameters",
    "OcclusionRegion",
    "OcclusionResult",
    "OriginEstimate",
    "Power",
    "Processing",
    "Region",
    "Sensor",
    "SensorLattice",
    "StreamInspection",
    "StreamRegion",
    "StreamReport",
    "SuspectRegion",
    "Verdict",
    "combined_verdict",
    "density_consistency",
    "depth_noise",
    "estimate_grid",
    "estimate_lattice",
    "estimate_origin",
    "generic_consistency",
    "identify_sensor",
    "inspect",
    "inspect_stream",
    "inter_frame_noise",
    "kitti_lattice",
    "measure_power",
    "occlusion_consistency",
]
