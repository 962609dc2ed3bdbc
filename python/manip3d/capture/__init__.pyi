from __future__ import annotations

from manip3d.capture._addresses import rgbd_address, scan_address
from manip3d.capture._bag import holds_clouds
from manip3d.capture._bag_stereo import watched_recording
from manip3d.capture._drive import LidarDrive, open_drive
from manip3d.capture._folder_depth import FolderDepth, folder_depth
from manip3d.capture._joints import ExportedJoints, export_joints
from manip3d.capture._lidar import DEFAULT_PORT, RETURN_TYPES, LidarSource, open_lidar
from manip3d.capture._rgbd import Scheme, open_rgbd
from manip3d.capture._rgbd_record import Recording, record
from manip3d.capture._rgbd_source import ForgedSource, RgbdSource, from_frames
from manip3d.capture._sources import open, sources
from manip3d.capture._summary import SourceSummary, summarize
from manip3d.capture._velodyne_calibration import VelodyneCalibration, read_velodyne_calibration

__all__ = [
    "DEFAULT_PORT",
    "RETURN_TYPES",
    "ExportedJoints",
    "FolderDepth",
    "ForgedSource",
    "LidarDrive",
    "LidarSource",
    "Recording",
    "RgbdSource",
    "Scheme",
    "SourceSummary",
    "VelodyneCalibration",
    "export_joints",
    "folder_depth",
    "from_frames",
    "holds_clouds",
    "open",
    "open_drive",
    "open_lidar",
    "open_rgbd",
    "read_velodyne_calibration",
    "record",
    "rgbd_address",
    "scan_address",
    "sources",
    "summarize",
    "watched_recording",
]
