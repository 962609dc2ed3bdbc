"""Has this scan or stream been edited? Detectors that look at it, watermarks that prove it."""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_alert": (
            "WITNESSES Alert AlertCounts AlertMonitor AlertTally WitnessReport verdict_of_alerts"
        ),
        "_cross_modal": (
            "CrossModalParameters CrossModalRegion CrossModalResult attack_type "
            "cross_modal_consistency"
        ),
        "_density": (
            "CALIBRATED_DENSITY PAPER_DENSITY SPARSE_DENSITY DensityParameters DensityResult "
            "density_consistency"
        ),
        "_drives": "DriveInspection inspect_drive judge_drive verdict_of_drive",
        "_generic": "EvidenceReport GenericResult SuspectRegion generic_consistency",
        "_inspect": "inspect",
        "_inspection": "DetectorReport Inspection combined_verdict",
        "_keys": "KeyFile KeyRing",
        "_lattice": "LatticeReading SensorLattice estimate_lattice",
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
        "_picture_files": "picture_path read_carrier write_carrier",
        "_picture_records": "record_of_picture without_record",
        "_power": "EDITS calibrate_lattice measure_power",
        "_reflectance": "ReflectanceRegion ReflectanceResult reflectance_consistency",
        "_repeats": "are_same_points points_id",
        "_rig_files": "RIGS_FILE CameraPair read_rigs write_rigs",
        "_risk": (
            "ACTIONS ATTACK_TYPES AttackObservation Risk RiskParameters RiskTracker temporal_factor"
        ),
        "_sensors": "Sensor identify_sensor kitti_lattice",
        "_sequence": "DriveEvidence drive_evidence",
        "_stereo": "Disparity StereoRig stereo_disparity",
        "_streams": (
            "StreamInspection StreamRegion StreamReport depth_noise inspect_stream "
            "inter_frame_noise judged_frames"
        ),
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
            "RECORD_SUFFIX as_stored check_holds_float32 copy_rest_of_drive drive_numbers "
            "drive_records_alone drive_scans find_record plain_name read_record record_path "
            "refuse_existing_record scan_of_record verdict_of_stream write_watermarked"
        ),
    },
)
