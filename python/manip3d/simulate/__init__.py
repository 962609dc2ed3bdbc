"""Generate seeded test data: meshes, depth images, people, scans, streets and drives."""

from manip3d.simulate import depth, models, scenes, streets
from manip3d.simulate.cameras import StereoPair, stereo_pair
from manip3d.simulate.drives import DriveFrame, drive, write_drive
from manip3d.simulate.forged_people import ForgedPeople, write_forged_people
from manip3d.simulate.lidar import LidarScan, hdl64e
from manip3d.simulate.people import (
    LIMBS,
    BodyCapture,
    BodySimulator,
    BodyTruth,
    cast_mesh,
    opposite,
)
from manip3d.simulate.small_scans import cave, courtyard
from manip3d.simulate.sources import open_drive, open_source, watched_street
from manip3d.simulate.streets import Street, street
from manip3d.simulate.terrestrial import TerrestrialScan, terrestrial_scan

__all__ = [
    "LIMBS",
    "BodyCapture",
    "BodySimulator",
    "BodyTruth",
    "DriveFrame",
    "ForgedPeople",
    "LidarScan",
    "StereoPair",
    "Street",
    "TerrestrialScan",
    "cast_mesh",
    "cave",
    "courtyard",
    "depth",
    "drive",
    "hdl64e",
    "models",
    "open_drive",
    "open_source",
    "opposite",
    "scenes",
    "stereo_pair",
    "street",
    "streets",
    "terrestrial_scan",
    "watched_street",
    "write_drive",
    "write_forged_people",
]
