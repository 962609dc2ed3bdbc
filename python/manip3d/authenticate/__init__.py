"""Detect edited LiDAR scans and RGB-D streams, and prove by watermarks that scans are unchanged.

Begin with `inspect` (a LiDAR scan), `inspect_drive` or `inspect_stream` (an RGB-D recording), or
with `Watermarker` if a key can be kept. The names by purpose:

Verdict of all detectors
    `inspect`, `inspect_drive`, `combined_verdict`, `judge_drive`, `verdict_of_drive`,
    `drive_evidence`, `likelihood_ratio`; results `Inspection`, `DetectorReport`, `DriveInspection`.
One detector alone, I to V
    `density_consistency`, `occlusion_consistency`, `generic_consistency`, `turn_consistency`,
    `reflectance_consistency`.
The scanner
    `identify_sensor`, `estimate_lattice`, `kitti_lattice`, `estimate_origin`, `estimate_grid`.
Rates of detection and of false alarms
    `measure_power`, `calibrate_lattice`, and the classes of edits, `EDITS`.
Copies
    `are_same_points`, `points_id`.
RGB-D streams
    `inspect_stream`, `judged_frames`, `depth_noise`, `inter_frame_noise`.
Keyed watermark
    `KeyFile`, `KeyRing`, `Watermarker`, `Policy`; for files `embed_files`, `verify_files`,
    `verdict_of_stream`.
Records beside scans, and in pictures
    `find_record`, `read_record`, `record_path`, `scan_of_record`, `write_watermarked`, `as_stored`,
    `drive_scans`, `drive_numbers`, `drive_pictures`, `read_carrier`, `write_carrier`,
    `record_of_picture`, `without_record`.
Watermark as printed in the dissertation (section 7.3.1), for comparison
    `embed_paper`, `compare_paper`, `noise_blocks`.
Cameras beside the LiDAR
    `cross_modal_consistency`, `surround_consistency`, `stereo_disparity`, `attack_type`,
    `read_rigs`, `write_rigs`.
Alerts while driving
    `AlertMonitor`, `watch_drive`, `verdict_of_alerts`, `RiskTracker`, `temporal_factor`.
"""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_alert": "AlertMonitor",
        "_alert_tally": "AlertTally verdict_of_alerts",
        "_alert_verdict": "WITNESSES Alert AlertCounts WitnessReport",
        "_cross_modal": (
            "CrossModalParameters CrossModalRegion CrossModalResult attack_type "
            "cross_modal_consistency"
        ),
        "_density": (
            "CALIBRATED_DENSITY PAPER_DENSITY SPARSE_DENSITY DensityParameters DensityResult "
            "density_consistency"
        ),
        "_drives": "DriveInspection inspect_drive judge_drive verdict_of_drive",
        "_edits": "EDITS",
        "_generic": "EvidenceReport GenericResult SuspectRegion generic_consistency",
        "_inspect": "inspect",
        "_inspection": "DetectorReport Inspection combined_verdict",
        "_keys": "KeyFile KeyRing",
        "_lattice": "LatticeReading SensorLattice",
        "_lattice_calibration": "calibrate_lattice",
        "_lattice_estimate": "estimate_lattice",
        "_occlusion": (
            "CALIBRATED_OCCLUSION PAPER_OCCLUSION RINGS_OCCLUSION AngularGrid "
            "OcclusionParameters OcclusionRegion OcclusionResult estimate_grid "
            "occlusion_consistency"
        ),
        "_origin": "OriginEstimate estimate_origin",
        "_paper_watermark": (
            "PAPER_EMBEDDINGS PaperComparison PaperMarked PaperMetadata compare_paper "
            "embed_paper noise_blocks"
        ),
        "_picture_files": "read_carrier write_carrier",
        "_picture_records": "record_of_picture without_record",
        "_power": "measure_power",
        "_reflectance": "ReflectanceRegion ReflectanceResult reflectance_consistency",
        "_repeats": "are_same_points points_id",
        "_rig_files": "RIGS_FILE CameraPair read_rigs write_rigs",
        "_risk": (
            "ACTIONS ATTACK_TYPES AttackObservation Risk RiskParameters RiskTracker temporal_factor"
        ),
        "_sensors": "Sensor identify_sensor kitti_lattice",
        "_sequence": "DriveEvidence drive_evidence",
        "_stereo": "Disparity StereoRig stereo_disparity",
        "_stream_frames": "judged_frames",
        "_stream_verdict": "StreamInspection StreamRegion StreamReport",
        "_streams": "depth_noise inspect_stream inter_frame_noise",
        "_surround": "SurroundResult surround_consistency",
        "_turns": "TurnRegion TurnResult turn_consistency",
        "_verdict": (
            "Calibration Detection Power Processing Region RegionLike Verdict likelihood_ratio"
        ),
        "_watch": "TURN_S DriveMoment DriveWatch WatchedDrive watch_drive",
        "_watermark": (
            "CARRIERS EMBEDDINGS MAX_MOVE_M Policy Tile Watermarked Watermarker WatermarkResult"
        ),
        "_watermark_drives": "EmbeddedScan VerifiedFiles drive_pictures embed_files verify_files",
        "_watermark_files": (
            "RECORD_SUFFIX as_stored drive_numbers drive_scans find_record read_record record_path "
            "scan_of_record verdict_of_stream write_watermarked"
        ),
    },
)
