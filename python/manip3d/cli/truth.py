"""The truth of a forged scan, as values for the JSON file beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from manip3d.lidar import map_shift, shifted

if TYPE_CHECKING:
    from manip3d.forge import Forgery


def truth_of(forged: Forgery) -> dict[str, Any]:
    """Return the ground truth as values that can be written as JSON; lengths are in metres.

    The box is in the coordinates of the file. The transform is in those of the scan as it is read,
    which are shifted near 0 if the file has coordinates of a map.
    """
    box = shifted(forged.box, map_shift(forged.original))
    return {
        "attack": forged.attack,
        "points": len(forged.points),
        "added": forged.added.tolist(),
        "moved": forged.moved.tolist(),
        "moved_from": forged.moved_from.tolist(),
        "removed": forged.removed.tolist(),
        "box": {"center": list(box.center), "size": list(box.size), "yaw": box.yaw},
        "transform": forged.transform.tolist(),
    }
