"""Frames out of sensors and recordings: ``open("pcap:FILE")``, ``open("folder:walk")``, ...

A source is iterated; each item is a `manip3d.LidarFrame` or a `manip3d.RgbdFrame`. What was seen
and what was refused is in its ``counters``. `sources` lists what can be opened; `record` writes
recordings of RGB-D frames.

Drivers of RGB-D cameras, each where its library was at build time, and what it was tried with:

============== ============================ ==================================================
``openni2:``   OpenNI2 2.2                  its Dummy device; no camera
``freenect2:`` libfreenect2 0.2             the library without a camera
``realsense:`` librealsense2 2.53 or later  2.59: a D435's recording (``FILE.bag``); no camera
``orbbec:``    OrbbecSDK 2                  2.9: the library without a camera or a recording
============== ============================ ==================================================
"""

from __future__ import annotations

from manip3d.capture._bag import holds_clouds
from manip3d.capture._joints import ExportedJoints, export_joints
from manip3d.capture._lidar import DEFAULT_PORT, RETURN_TYPES, LidarSource, open_lidar
from manip3d.capture._rgbd import (
    ForgedSource,
    Recording,
    RgbdSource,
    Scheme,
    from_frames,
    open_rgbd,
    record,
)
from manip3d.capture._sources import open, sources
from manip3d.capture._velodyne_calibration import VelodyneCalibration, read_velodyne_calibration

__all__ = [
    "DEFAULT_PORT",
    "RETURN_TYPES",
    "ExportedJoints",
    "ForgedSource",
    "LidarSource",
    "Recording",
    "RgbdSource",
    "Scheme",
    "VelodyneCalibration",
    "export_joints",
    "from_frames",
    "holds_clouds",
    "open",
    "open_lidar",
    "open_rgbd",
    "read_velodyne_calibration",
    "record",
    "sources",
]
