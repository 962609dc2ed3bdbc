"""Public data sets: origin, licence and checksums of their files, and loaders.

Real data is searched under ``$MANIP3D_DATA``, then in the user's cache, to which `fetch` downloads
it from its official addresses. The checksum of a file is verified before the file is opened.
`STAND_INS` are simulated data (`manip3d.simulate`), which are always available.

Other packages add data sets through entry points of the group ``manip3d.datasets``.
"""

from __future__ import annotations

from manip3d.datasets._fetch import FetchError, fetch, is_fetchable, steps_by_hand
from manip3d.datasets._load import (
    CLEANINGS,
    Cleaning,
    apply_cleaning,
    load_mesh,
    provenance,
    source_of,
)
from manip3d.datasets._registry import (
    ENTRY_POINTS,
    ChecksumError,
    DataFile,
    DataMissingError,
    DataSet,
    cache_folder,
    data_folder_problem,
    data_root,
    file_sha256,
    folder_sha256,
    get,
    is_here,
    locate,
    registry,
    require,
)
from manip3d.datasets._watched import watched_kitti
from manip3d.datasets.kitti import KittiCalibration, KittiDrive, KittiFrame, open_kitti
from manip3d.datasets.people import RgbdSequence, open_people, people_uris
from manip3d.datasets.range_images import RangeImageFolder, open_range_images
from manip3d.datasets.rgbd import (
    DepthFrame,
    frame_names,
    load_frame,
    load_kinect2_intrinsics,
)
from manip3d.datasets.scans import (
    RangeScan,
    load_scan,
    read_poses,
    scan_is_here,
    scan_names,
    scan_path,
)
from manip3d.datasets.stand_ins import STAND_INS, StandIn

__all__ = [
    "CLEANINGS",
    "ENTRY_POINTS",
    "STAND_INS",
    "ChecksumError",
    "Cleaning",
    "DataFile",
    "DataMissingError",
    "DataSet",
    "DepthFrame",
    "FetchError",
    "KittiCalibration",
    "KittiDrive",
    "KittiFrame",
    "RangeImageFolder",
    "RangeScan",
    "RgbdSequence",
    "StandIn",
    "apply_cleaning",
    "cache_folder",
    "data_folder_problem",
    "data_root",
    "fetch",
    "file_sha256",
    "folder_sha256",
    "frame_names",
    "get",
    "is_fetchable",
    "is_here",
    "load_frame",
    "load_kinect2_intrinsics",
    "load_mesh",
    "load_scan",
    "locate",
    "open_kitti",
    "open_people",
    "open_range_images",
    "people_uris",
    "provenance",
    "read_poses",
    "registry",
    "require",
    "scan_is_here",
    "scan_names",
    "scan_path",
    "source_of",
    "steps_by_hand",
    "watched_kitti",
]
