"""The six attacks of ALERT on objects that both LiDAR and cameras see."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from manip3d import forge
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

ATTACKS = ("additive", "subtractive", "additive_subtractive", "replacement", "translation",
           "rotation", "rotation_2m")  # fmt: skip
"""Attacks 1 to 6, and attack 6 with the sideways shift of 2 m that the authors' own tool makes."""

HALF_VIEW = math.radians(33.0)
"""Largest azimuth of an object's centre, radians. KITTI's cameras see 40 degrees to each side, but
the left edge of the left image has no match in the right image."""
NEAREST, FARTHEST = 6.0, 30.0
MIN_POINTS = 50
_PEDESTAL = 0.15  # metres above the ground; lower points do not belong to the object


def targets(frame: LidarFrame, boxes: Sequence[Box]) -> list[Box]:
    """Return boxes of the labelled objects in view, nearest first, without the ground below."""
    found = []
    for box in boxes:
        x, y, z = box.center
        distance = math.hypot(x, y)
        if not (NEAREST <= distance <= FARTHEST and abs(math.atan2(y, x)) <= HALF_VIEW):
            continue
        length, width, height = box.size
        raised = Box((x, y, z + _PEDESTAL / 2), (length, width, height - _PEDESTAL), box.yaw)
        if height > _PEDESTAL and np.count_nonzero(raised.contains(frame.points)) >= MIN_POINTS:
            found.append(raised)
    return sorted(found, key=lambda box: math.hypot(*box.center[:2]))


def segmented(frame: LidarFrame) -> list[Box]:
    """Find objects of the size of road users in an unlabelled scan, by clustering above ground."""
    found = []
    for box in forge.segment(frame).boxes:
        length, width = sorted(box.size[:2], reverse=True)
        if 0.3 <= width <= 3.0 and length <= 6.0 and 0.8 <= box.size[2] <= 3.0:
            found.append(box)
    return found


def attacked(
    frame: LidarFrame, box: Box, attack: str, rng: np.random.Generator
) -> tuple[LidarFrame, list[Box]] | None:
    """Return a frame after an attack on an object, and the changed boxes; None: no free place."""
    if attack == "subtractive":
        return forge.subtractive(frame, box, threads=1).frame, [box]
    inside = frame.select(box.contains(frame.points))
    if attack in ("replacement", "translation", "rotation", "rotation_2m"):
        try:
            return _in_its_place(frame, inside, box, attack)
        except InputError:  # the object would intersect another one
            return None
    for _ in range(200):
        turn = float(rng.uniform(-HALF_VIEW, HALF_VIEW)) - math.atan2(*box.center[1::-1])
        away = float(rng.uniform(0.6, 1.4))
        copy, place = _copied(inside, box, turn, away)
        if not NEAREST <= math.hypot(*place.center[:2]) <= FARTHEST:
            continue
        # The collision test of additive_subtractive() ignores the object, because it is removed.
        if box.contains(copy.points).any():
            continue
        try:
            if attack == "additive":
                return forge.additive(frame, copy, threads=1).frame, [place]
            made = forge.additive_subtractive(frame, copy, box, threads=1)
        except InputError:  # the copy would intersect another object
            continue
        return made.frame, [place, box]
    return None


def _in_its_place(
    frame: LidarFrame, inside: LidarFrame, box: Box, attack: str
) -> tuple[LidarFrame, list[Box]]:
    """Move or turn the object, or replace it by a copy of itself turned by half a turn."""
    if attack == "replacement":
        turned = inside.points * np.array([-1, -1, 1], np.float32)
        made = forge.replacement(frame, inside.replace(points=turned), box, threads=1)
        return made.frame, [box]
    if attack == "translation":
        made = forge.translation(frame, box, threads=1)
    else:
        sideways = 2.0 if attack == "rotation_2m" else 0.0
        made = forge.rotation(frame, box, sideways=sideways, threads=1)
    return made.frame, [box, made.box]


def _copied(inside: LidarFrame, box: Box, turn: float, away: float) -> tuple[LidarFrame, Box]:
    """Copy an object to another azimuth and distance; the same side faces the scanner."""
    cosine, sine = math.cos(turn), math.sin(turn)
    x, y, z = box.center
    at = np.array([cosine * x - sine * y, sine * x + cosine * y]) * away
    shift = inside.points[:, :2] - np.array([x, y], np.float32)
    points = inside.points.copy()
    points[:, 0] = at[0] + cosine * shift[:, 0] - sine * shift[:, 1]
    points[:, 1] = at[1] + sine * shift[:, 0] + cosine * shift[:, 1]
    return (
        inside.replace(points=points),
        Box((float(at[0]), float(at[1]), z), box.size, box.yaw + turn),
    )
