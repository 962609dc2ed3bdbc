"""Has this scan been edited? Detectors that look at a scan, and watermarks that prove it."""

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
from manip3d.authenticate._paper_watermark import (
    PAPER_EMBEDDINGS,
    PaperComparison,
    PaperMarked,
    PaperMetadata,
    compare_paper,
    embed_paper,
    noise_blocks,
)
from manip3d.authenticate._power import EDITS, measure_power
from manip3d.authenticate._sensors import Sensor, identify_sensor, kitti_lattice
from manip3d.authenticate._verdict import Calibration, Power, Processing, Region, Verdict
from manip3d.authenticate._watermark import (
    EMBEDDINGS,
    MAX_MOVE_M,
    KeyFile,
    Policy,
    Tile,
    Watermarked,
    Watermarker,
    WatermarkResult,
)
from manip3d.authenticate._watermark_files import (
    drive_scans,
    drive_times,
    plain_name,
    read_record,
    record_path,
    refuse_existing_record,
    verdict_of_stream,
    write_watermarked,
)

__all__ = [
    "CALIBRATED_DENSITY",
    "CALIBRATED_OCCLUSION",
    "EDITS",
    "EMBEDDINGS",
    "MAX_MOVE_M",
    "PAPER_DENSITY",
    "PAPER_EMBEDDINGS",
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
    "KeyFile",
    "LatticeReading",
    "OcclusionParameters",
    "OcclusionRegion",
    "OcclusionResult",
    "OriginEstimate",
    "PaperComparison",
    "PaperMarked",
    "PaperMetadata",
    "Policy",
    "Power",
    "Processing",
    "Region",
    "Sensor",
    "SensorLattice",
    "SuspectRegion",
    "Tile",
    "Verdict",
    "WatermarkResult",
    "Watermarked",
    "Watermarker",
    "combined_verdict",
    "compare_paper",
    "density_consistency",
    "drive_scans",
    "drive_times",
    "embed_paper",
    "estimate_grid",
    "estimate_lattice",
    "estimate_origin",
    "generic_consistency",
    "identify_sensor",
    "inspect",
    "kitti_lattice",
    "measure_power",
    "noise_blocks",
    "occlusion_consistency",
    "plain_name",
    "read_record",
    "record_path",
    "refuse_existing_record",
    "verdict_of_stream",
    "write_watermarked",
]
