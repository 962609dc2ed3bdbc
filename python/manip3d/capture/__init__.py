"""Frames of sensors and recordings: ``open("pcap:FILE")``, ``open("folder:walk")``, ...

Iterating over a source yields a `manip3d.LidarFrame` or a `manip3d.RgbdFrame` for each frame. Its
``counters`` count the frames, points and packets that were read and those that were refused.
`sources` lists what can be opened; `record` writes recordings of RGB-D frames.

Drivers of RGB-D cameras, each available if its library was present at build time, with the library
version, and the device or recording it was tried with:

============== ============================ ==================================================
``openni2:``   OpenNI2 2.2                  its Dummy device; no camera
``freenect2:`` libfreenect2 0.2             the library without a camera
``realsense:`` librealsense2 2.53 or later  2.59: a D435's recording (``FILE.bag``); no camera
``orbbec:``    OrbbecSDK 2                  2.9: the library without a camera or a recording
============== ============================ ==================================================
"""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_addresses": "rgbd_address scan_address",
        "_bag": "holds_clouds",
        "_bag_stereo": "watched_recording",
        "_drive": "LidarDrive open_drive",
        "_folder_depth": "FolderDepth folder_depth",
        "_joints": "ExportedJoints export_joints",
        "_lidar": "DEFAULT_PORT RETURN_TYPES LidarSource open_lidar",
        "_rgbd": "Scheme open_rgbd",
        "_rgbd_record": "Recording record",
        "_rgbd_source": "ForgedSource RgbdSource from_frames",
        "_sources": "open sources",
        "_summary": "SourceSummary summarize",
        "_velodyne_calibration": "VelodyneCalibration read_velodyne_calibration",
    },
)
