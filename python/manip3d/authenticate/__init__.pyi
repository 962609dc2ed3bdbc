from __future__ import annotations

from manip3d.authenticate._alert import AlertMonitor
from manip3d.authenticate._alert_tally import AlertTally, verdict_of_alerts
from manip3d.authenticate._alert_verdict import WITNESSES, Alert, AlertCounts, WitnessReport
from manip3d.authenticate._cross_modal import (
    CrossModalParameters,
    CrossModalRegion,
    CrossModalResult,
    attack_type,
    cross_modal_consistency,
)
from manip3d.authenticate._density import (
    CALIBRATED_DENSITY,
    PAPER_DENSITY,
    SPARSE_DENSITY,
    DensityParameters,
    DensityResult,
    density_consistency,
)
from manip3d.authenticate._drives import (
    DriveInspection,
    inspect_drive,
    judge_drive,
    verdict_of_drive,
)
from manip3d.authenticate._edits import EDITS
from manip3d.authenticate._generic import (
    EvidenceReport,
    GenericResult,
    SuspectRegion,
    generic_consistency,
)
from manip3d.authenticate._inspect import inspect
from manip3d.authenticate._inspection import DetectorReport, Inspection, combined_verdict
from manip3d.authenticate._keys import KeyFile, KeyRing
from manip3d.authenticate._lattice import LatticeReading, SensorLattice
from manip3d.authenticate._lattice_calibration import calibrate_lattice
from manip3d.authenticate._lattice_estimate import estimate_lattice
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
from manip3d.authenticate._picture_files import read_carrier, write_carrier
from manip3d.authenticate._picture_records import record_of_picture, without_record
from manip3d.authenticate._power import measure_power
from manip3d.authenticate._reflectance import (
    ReflectanceRegion,
    ReflectanceResult,
    reflectance_consistency,
)
from manip3d.authenticate._repeats import are_same_points, points_id
from manip3d.authenticate._rig_files import RIGS_FILE, CameraPair, read_rigs, write_rigs
from manip3d.authenticate._risk import (
    ACTIONS,
    ATTACK_TYPES,
    AttackObservation,
    Risk,
    RiskParameters,
    RiskTracker,
    temporal_factor,
)
from manip3d.authenticate._sensors import Sensor, identify_sensor, kitti_lattice
from manip3d.authenticate._sequence import DriveEvidence, drive_evidence
from manip3d.authenticate._stereo import Disparity, StereoRig, stereo_disparity
from manip3d.authenticate._stream_frames import judged_frames
from manip3d.authenticate._stream_verdict import StreamInspection, StreamRegion, StreamReport
from manip3d.authenticate._streams import depth_noise, inspect_stream, inter_frame_noise
from manip3d.authenticate._surround import SurroundResult, surround_consistency
from manip3d.authenticate._turns import TurnRegion, TurnResult, turn_consistency
from manip3d.authenticate._verdict import (
    Calibration,
    Detection,
    Power,
    Processing,
    Region,
    RegionLike,
    Verdict,
    likelihood_ratio,
)
from manip3d.authenticate._watch import TURN_S, DriveMoment, DriveWatch, WatchedDrive, watch_drive
from manip3d.authenticate._watermark import (
    CARRIERS,
    EMBEDDINGS,
    MAX_MOVE_M,
    Policy,
    Tile,
    Watermarked,
    Watermarker,
    WatermarkResult,
)
from manip3d.authenticate._watermark_drives import (
    EmbeddedScan,
    VerifiedFiles,
    drive_pictures,
    embed_files,
    verify_files,
)
from manip3d.authenticate._watermark_files import (
    RECORD_SUFFIX,
    as_stored,
    drive_numbers,
    drive_scans,
    find_record,
    read_record,
    record_path,
    scan_of_record,
    verdict_of_stream,
    write_watermarked,
)

__all__ = [
    "ACTIONS",
    "ATTACK_TYPES",
    "CALIBRATED_DENSITY",
    "CALIBRATED_OCCLUSION",
    "CARRIERS",
    "EDITS",
    "EMBEDDINGS",
    "MAX_MOVE_M",
    "PAPER_DENSITY",
    "PAPER_EMBEDDINGS",
    "PAPER_OCCLUSION",
    "RECORD_SUFFIX",
    "RIGS_FILE",
    "RINGS_OCCLUSION",
    "SPARSE_DENSITY",
    "TURN_S",
    "WITNESSES",
    "Alert",
    "AlertCounts",
    "AlertMonitor",
    "AlertTally",
    "AngularGrid",
    "AttackObservation",
    "Calibration",
    "CameraPair",
    "CrossModalParameters",
    "CrossModalRegion",
    "CrossModalResult",
    "DensityParameters",
    "DensityResult",
    "Detection",
    "DetectorReport",
    "Disparity",
    "DriveEvidence",
    "DriveInspection",
    "DriveMoment",
    "DriveWatch",
    "EmbeddedScan",
    "EvidenceReport",
    "GenericResult",
    "Inspection",
    "KeyFile",
    "KeyRing",
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
    "ReflectanceRegion",
    "ReflectanceResult",
    "Region",
    "RegionLike",
    "Risk",
    "RiskParameters",
    "RiskTracker",
    "Sensor",
    "SensorLattice",
    "StereoRig",
    "StreamInspection",
    "StreamRegion",
    "StreamReport",
    "SurroundResult",
    "SuspectRegion",
    "Tile",
    "TurnRegion",
    "TurnResult",
    "Verdict",
    "VerifiedFiles",
    "WatchedDrive",
    "WatermarkResult",
    "Watermarked",
    "Watermarker",
    "WitnessReport",
    "are_same_points",
    "as_stored",
    "attack_type",
    "calibrate_lattice",
    "combined_verdict",
    "compare_paper",
    "cross_modal_consistency",
    "density_consistency",
    "depth_noise",
    "drive_evidence",
    "drive_numbers",
    "drive_pictures",
    "drive_scans",
    "embed_files",
    "embed_paper",
    "estimate_grid",
    "estimate_lattice",
    "estimate_origin",
    "find_record",
    "generic_consistency",
    "identify_sensor",
    "inspect",
    "inspect_drive",
    "inspect_stream",
    "inter_frame_noise",
    "judge_drive",
    "judged_frames",
    "kitti_lattice",
    "likelihood_ratio",
    "measure_power",
    "noise_blocks",
    "occlusion_consistency",
    "points_id",
    "read_carrier",
    "read_record",
    "read_rigs",
    "record_of_picture",
    "record_path",
    "reflectance_consistency",
    "scan_of_record",
    "stereo_disparity",
    "surround_consistency",
    "temporal_factor",
    "turn_consistency",
    "verdict_of_alerts",
    "verdict_of_drive",
    "verdict_of_stream",
    "verify_files",
    "watch_drive",
    "without_record",
    "write_carrier",
    "write_rigs",
    "write_watermarked",
]
