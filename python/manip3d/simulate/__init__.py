"""Data made on the spot, seeded: what runs where no data set is."""

from manip3d.simulate import models, scenes
from manip3d.simulate.terrestrial import TerrestrialScan, terrestrial_scan

__all__ = ["TerrestrialScan", "models", "scenes", "terrestrial_scan"]
