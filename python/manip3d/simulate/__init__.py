"""Data made on the spot, seeded: what runs where no data set is."""

from manip3d.simulate import depth, models, scenes, streets
from manip3d.simulate.cameras import StereoPair, stereo_pair
from manip3d.simulate.drives import DriveFrame, drive, write_drive
from manip3d.simulate.lidar import LidarScan, hdl64e
from manip3d.simulate.people import BodyCapture, BodySimulator, BodyTruth
from manip3d.simulate.sources import open_source
from manip3d.simulate.streets import Street, street
from manip3d.simulate.terrestrial import TerrestrialScan, terrestrial_scan

__all__ = [
    "BodyCapture",
    "BodySimulator",
    "BodyTruth",
    "DriveFrame",
    "LidarScan",
    "StereoPair",
    "Street",
    "TerrestrialScan",
    "depth",
    "drive",
    "hdl64e",
    "models",
    "open_source",
    "scenes",
    "stereo_pair",
    "street",
    "streets",
    "terrestrial_scan",
    "write_drive",
]
