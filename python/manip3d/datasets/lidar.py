"""Registry entries of the LiDAR scans and drives that experiments read.

``lidar.csv`` holds paths, sizes and checksums. KITTI serves its recordings as large archives after
a login, and the terrestrial scans are stored in other formats than at their sources, so that all
are obtained by hand. Paths are those of KITTI's own layouts below ``lidar/``.
"""

from __future__ import annotations

from dataclasses import dataclass

from manip3d.datasets._registry import DataFile, DataSet
from manip3d.datasets._tables import data_file, table

_KITTI_LICENCE = "CC BY-NC-SA 3.0 (KIT and TTIC)"
_RAW_PAGE = "https://www.cvlibs.net/datasets/kitti/raw_data.php"
_DAY = "kitti_raw/2011_09_26/"


@dataclass(frozen=True)
class _Recording:
    """A data set whose files are the rows of ``lidar.csv`` with the prefix ``below``."""

    name: str
    title: str
    below: str
    licence: str
    origin: str
    page: str


def _kitti(name: str, title: str, below: str, origin: str, page: str = _RAW_PAGE) -> _Recording:
    source = f"KITTI, Geiger et al., IJRR 2013; {origin}"
    return _Recording(name, title, below, _KITTI_LICENCE, source, page)


_RECORDINGS = (
    _kitti(
        "kitti_calibration_0926",
        "Calibration of KITTI's cameras and LiDAR, 26 September 2011",
        f"{_DAY}calib_",
        "archive 2011_09_26_calib.zip; ConnorMcShane/kitti-raw-pytorch-dataloader "
        "@0660acd83a94b9513f71f7b1ca8915f832c16e73 example_data/kitti_raw/2011_09_26",
    ),
    _kitti(
        "kitti_drive_0002",
        "KITTI drive 0002, city: frames 0 to 9, scans and colour pairs",
        f"{_DAY}2011_09_26_drive_0002_sync/",
        "archive 2011_09_26_drive_0002_sync.zip; ConnorMcShane/kitti-raw-pytorch-dataloader "
        "@0660acd83a94b9513f71f7b1ca8915f832c16e73 example_data/kitti_raw/2011_09_26",
    ),
    _kitti(
        "kitti_drive_0005",
        "KITTI drive 0005, city: scans of frames 0 to 19, colour pair of frame 0",
        f"{_DAY}2011_09_26_drive_0005_sync/",
        "archive 2011_09_26_drive_0005_sync.zip; scans converted from PCD: "
        "udacity/SFND_Lidar_Obstacle_Detection @ef15da2bc172359e7d6edfdd156a2a243d10977e "
        "src/sensors/data/pcd/data_2; pictures: fracgawd/kitti_motion_compensation "
        "@e804645d1f598c8d1835c6f26b0a6292fe09440e testing_assets/2011_09_26",
    ),
    _kitti(
        "kitti_drive_0079",
        "KITTI drive 0079, residential, as extracted: one scan",
        f"{_DAY}2011_09_26_drive_0079_extract/",
        "archive 2011_09_26_drive_0079_extract.zip; MRPT/mrpt "
        "@ed76ffc6019f74c191a74090156bf3f958a9747e modules/mrpt_data/tests",
    ),
    _kitti(
        "kitti_unidentified_a",
        "One scan of a KITTI drive that is not identified (a)",
        "kitti_raw/unidentified_drive_a/",
        "frame 0, converted from PCD: udacity/SFND_Lidar_Obstacle_Detection "
        "@ef15da2bc172359e7d6edfdd156a2a243d10977e src/sensors/data/pcd/data_1",
    ),
    _kitti(
        "kitti_unidentified_b",
        "One scan of a KITTI drive that is not identified (b), heavy traffic",
        f"{_DAY}unidentified_drive_b/",
        "frame 0: udacity/SFND_3D_Object_Tracking @3f2864369a4fc3afa88cbff39423566164a83d00 "
        "images/KITTI/2011_09_26",
    ),
    _kitti(
        "kitti_stereo2015",
        "KITTI stereo 2015: four scans with their colour pairs",
        "kitti_stereo2015/",
        "Menze & Geiger, CVPR 2015; ziliHarvey/LiDAR-Guided-Boundary-Bleeding-Refinement-for-"
        "Depth-Map @51a4885a7253d061840582e900e404e7b24ecae4 data",
        "https://www.cvlibs.net/datasets/kitti/eval_scene_flow.php?benchmark=stereo",
    ),
    _kitti(
        "kitti_object",
        "KITTI object detection: one scan with its colour pair",
        "kitti_object/",
        "HKUST-Aerial-Robotics/Stereo-RCNN @63c6ab98b7a5e36c7bcfdec4529804fc940ee900 demo",
        "https://www.cvlibs.net/datasets/kitti/eval_object.php?obj_benchmark=3d",
    ),
    _kitti(
        "kitti_odometry_00",
        "KITTI odometry, sequence 00: scans 0 to 5, grey pair of frame 0",
        "kitti_odometry/00/",
        "scans: url-kaist/patchwork-plusplus @b608129a4549523067eae461da656195026cd7ca data; "
        "pictures: gaoxiang12/slambook2 @e62d9cd1f95bab337fb4251608543b71d004c420 ch5/stereo; "
        "calibration: jerry73204/kitti-dataset-for-rust "
        "@4cd8355a1f6560e7b70e9cee11c7f12caef7401b kitti-dataset/tests/odometry_calib.txt",
        "https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
    ),
    _Recording(
        "tls_forest",
        "A forest from one position, Riegl VZ-400i",
        "tls/riegl_vz400i_forest",
        "GPL (>= 3)",
        "rTLS, converted from R data; cran/rTLS @d8d803d6d6e38a82d0bdef76445f8fe03f0327c8 "
        "data/TLS_scan.rda",
        "https://cran.r-project.org/package=rTLS",
    ),
    _Recording(
        "tls_pump_room",
        "Pumps in a room from one position, structured grid",
        "tls/pump_room_e57",
        "MIT (sample of the E57 project)",
        "libE57 sample pumpA, converted from E57; davidcaron/pye57 "
        "@b8d20999f3037c580bf1fe1dcb239c50a8f764ad tests/test_data",
        "https://github.com/davidcaron/pye57",
    ),
    _Recording(
        "tls_rooms",
        "One room from two positions, vertical-plane scanner",
        "tls/room_scan",
        "BSD-3-Clause",
        "PCL tutorials, converted from PCD; PointCloudLibrary/data "
        "@5c26bdd0591ba150b91858b5c9fe5e91cb39ae86 tutorials",
        "https://github.com/PointCloudLibrary/data",
    ),
    _Recording(
        "tls_3dtk",
        "Three positions of a robot with a tilting scanner; 3DTK",
        "tls/3dtk_dat/",
        "GPL-3.0 (repository)",
        "3DTK/3DTK @672da12f091aad3d865229bb8a3ba792a4c37c74 dat",
        "https://github.com/3DTK/3DTK",
    ),
)


def _data_sets() -> tuple[DataSet, ...]:
    rows = [row | {"url": ""} for row in table("lidar.csv")]

    def files_below(prefix: str) -> tuple[DataFile, ...]:
        return tuple(data_file("lidar", row) for row in rows if row["path"].startswith(prefix))

    return tuple(
        DataSet(
            name=recording.name,
            title=recording.title,
            kind="lidar",
            files=files_below(recording.below),
            licence=recording.licence,
            origin=recording.origin,
            page=recording.page,
        )
        for recording in _RECORDINGS
    )


DATA_SETS = _data_sets()
