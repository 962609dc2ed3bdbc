"""The map of what is shown to the origin and to unit size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from manip3d.viewer.points import DrawnPoints
    from manip3d.viewer.scene import Points


@dataclass(frozen=True)
class Placement:
    """Map to the origin and to unit size, where float32 and depth buffers are exact."""

    center: Points
    scale: float

    @classmethod
    def of(cls, thing: Mesh | DrawnPoints) -> Placement:
        """Return the placement of ``thing``."""
        if not (thing.num_faces if isinstance(thing, Mesh) else thing.num_points):
            return cls(np.zeros(3), 1.0)
        low, high = thing.bounds
        diagonal = float(np.linalg.norm(high - low, axis=-1))
        return cls(0.5 * (low + high), 1.0 / (diagonal or 1.0))

    def __call__(self, points: Points) -> Points:
        return (points - self.center) * self.scale
