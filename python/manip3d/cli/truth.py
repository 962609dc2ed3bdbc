"""The truth of a forged scan, as values for the JSON file beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from manip3d.forge import Forgery


def truth_of(forged: Forgery) -> dict[str, Any]:
    """Return the ground truth as values that can be written as JSON; lengths are in metres."""
    box = forged.box
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
