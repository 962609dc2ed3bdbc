"""The six attacks of ALERT on objects that LiDAR and cameras both see."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from manip3d import forge
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

ATTACKS = ("additive", "subtractive", "additive_subtractive", "replacement", "translation",
           "rotation", "rotation_2m")  # fmt: skip
"""Attacks 1 to 6, and 6 with the 2 m sideways that the authors' own tool has."""

HALF_VIEW = math.radians(33.0)
"""Largest direction of an object's middle: KITTI's cameras see 40 degrees to each side, of which
the left edge has no partner in the right image."""
NEAREST, FARTHEST = 6.0, 30.0
FEWEST_POINTS = 50
_PEDESTAL = 0.15  # metres above the ground at which the object is cut: the ground stays


def targets(frame: LidarFrame, boxes: Sequence[Box]) -> list[Box]:
    """Labelled objects in view, the nearest first, cut off above the ground."""
    found = []
    for box in boxes:
        x, y, z = box.center
        distance = math.hypot(x, y)
        if not (NEAREST <= distance <= FARTHEST and abs(math.atan2(y, x)) <= HALF_VIEW):
            continue
        length, width, height = box.size
        raised = Box((x, y, z + _PEDESTAL / 2), (length, width, height - _PEDESTAL), box.yaw)
        if height > _PEDESTAL and np.count_nonzero(raised.contains(frame.points)) >= FEWEST_POINTS:
            found.append(raised)
    return sorted(found, key=lambda box: math.hypot(*box.center[:2]))


def segmented(frame: LidarFrame) -> list[Box]:
    """Objects of the size of road users in an unlabelled scan, by clustering above the ground."""
    found = []
    for box in forge.segment(frame).boxes:
        length, width = sorted(box.size[:2], reverse=True)
        if 0.3 <= width <= 3.0 and length <= 6.0 and 0.8 <= box.size[2] <= 3.0:
            found.append(box)
    return found


def attacked(
    frame: LidarFrame, box: Box, attack: str, rng: np.random.Generator
) -> tuple[LidarFrame, list[Box]] | None:
    """The frame after an attack on an object, and where it was changed; None: no free place."""
    if attack == "subtractive":
        return forge.subtractive(frame, box, threads=1).frame, [box]
    inside = frame.select(box.contains(frame.points))
    if attack in ("replacement", "translation", "rotation", "rotation_2m"):
        try:
            return _in_its_place(frame, inside, box, attack)
        except InputError:  # it would stand in something
            return None
    for _ in range(200):
        turn = float(rng.uniform(-HALF_VIEW, HALF_VIEW)) - math.atan2(*box.center[1::-1])
        away = float(rng.uniform(0.6, 1.4))
        copy, place = _copied(inside, box, turn, away)
        if not NEAREST <= math.hypot(*place.center[:2]) <= FARTHEST:
            continue
        if box.contains(copy.points).any():  # the object itself counts as gone
            continue
        try:
            if attack == "additive":
                return forge.additive(frame, copy, threads=1).frame, [place]
            made = forge.additive_subtractive(frame, copy, box, threads=1)
        except InputError:  # it would stand in something
            continue
        return made.frame, [place, box]
    return None


def _in_its_place(
    frame: LidarFrame, inside: LidarFrame, box: Box, attack: str
) -> tuple[LidarFrame, list[Box]]:
    """The object moved or turned, or the same object seen from its other side, as another is."""
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
    """An object at another azimuth and distance, with the side towards the scanner that it had."""
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
