"""The truth of a forged scan, as values for the JSON file beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.linear import product
from manip3d.io._scan_tables import loses_map_coordinates, place_in_pose, scan_suffix
from manip3d.lidar import map_shift, shifted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.forge import Forgery


def truth_of(forged: Forgery, output: Path) -> dict[str, Any]:
    """Return the ground truth as values that can be written as JSON; lengths are in metres.

    The box is in the coordinates of the points in the file ``output``, which in E57 and PTX are
    relative to the scanner if its position is known. The transform is in those of the scan as it is
    read, which are less by ``shift`` if the file has coordinates of a map.
    """
    suffix = scan_suffix(output)
    scanner = place_in_pose(forged.frame, suffix)
    is_near_0 = scanner is not None or loses_map_coordinates(forged.frame, suffix)
    shift = np.zeros(3) if is_near_0 else map_shift(forged.frame)
    start = np.zeros(3) if scanner is None else scanner
    box = shifted(forged.box, shift - start)
    return {
        "attack": forged.attack,
        "points": len(forged.points),
        "added": forged.added.tolist(),
        "moved": forged.moved.tolist(),
        "moved_from": forged.moved_from.tolist(),
        "removed": forged.removed.tolist(),
        "box": {"center": list(box.center), "size": list(box.size), "yaw": box.yaw},
        "transform": _transform(forged, start).tolist(),
        "shift": shift.tolist(),
    }


def _transform(forged: Forgery, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the object's transform to a scan whose coordinates begin at ``start``.

    The frame of an added object is its own. An object of the scan that only moves has the scan's.
    """
    from_start = np.zeros(3) if len(forged.added) else start
    transform = forged.transform.copy()
    transform[:3, 3] += product(transform[:3, :3], from_start) - start
    return transform
