"""The truth of a forged scan, as values for the JSON file beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.io._scan_tables import loses_map_coordinates, scan_suffix
from manip3d.lidar import map_shift, shifted

if TYPE_CHECKING:
    from manip3d.forge import Forgery


def truth_of(forged: Forgery, output: Path) -> dict[str, Any]:
    """Return the ground truth as values that can be written as JSON; lengths are in metres.

    The box is in the coordinates of the file ``output``. The transform is in those of the scan as
    it is read, which are less by ``shift`` if the file has coordinates of a map.
    """
    is_near_0 = loses_map_coordinates(forged.frame, scan_suffix(output))
    shift = np.zeros(3) if is_near_0 else map_shift(forged.frame)
    box = shifted(forged.box, shift)
    return {
        "attack": forged.attack,
        "points": len(forged.points),
        "added": forged.added.tolist(),
        "moved": forged.moved.tolist(),
        "moved_from": forged.moved_from.tolist(),
        "removed": forged.removed.tolist(),
        "box": {"center": list(box.center), "size": list(box.size), "yaw": box.yaw},
        "transform": forged.transform.tolist(),
        "shift": shift.tolist(),
    }
