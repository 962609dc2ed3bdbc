"""Data made on the spot, seeded: what runs where no data set is."""

from manip3d.simulate import models

__all__ = ["models"]
