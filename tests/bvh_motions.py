"""A person who waves, and a reader of BVH that shares nothing with manip3d's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capsule_body import frame, pose
from manip3d import RgbdFrame


def waving() -> list[RgbdFrame]:
    """An arm that turns at shoulder and elbow with bones that keep their lengths."""
    frames = []
    for number in range(12):
        angle, bend = np.deg2rad(9.0 * number), np.deg2rad(12.0 * number)
        shoulder = np.array([0.19, 0.46, 0.0])
        upper = 0.27 * np.array([np.sin(angle), -np.cos(angle), 0.0])
        fore = np.array([np.sin(angle + bend), -np.cos(angle + bend), 0.0])
        moved = {"ElbowLeft": shoulder + upper}
        for name, along in (("Wrist", 0.24), ("Hand", 0.31), ("HandTip", 0.39), ("Thumb", 0.30)):
            moved[name + "Left"] = shoulder + upper + along * fore
        moved["ThumbLeft"] = moved["ThumbLeft"] + (0.0, 0.0, -0.04)
        places = {name: tuple(place) for name, place in moved.items()}
        frames.append(frame(pose(places, turn_deg=3.0 * number), number=number))
    return frames


def read_bvh(path: Path) -> tuple[list[str], NDArray[np.float64], float]:
    """Names, (F, joints, 3) positions by the file's own words, and the time of a frame."""
    head, motion = path.read_text().split("MOTION\n")
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    stack: list[int] = []
    for line in head.splitlines()[1:]:
        words = line.split()
        if words[0] in ("ROOT", "JOINT", "End"):
            names.append(words[1] if words[0] != "End" else "")
            parents.append(stack[-1] if stack else -1)
        elif words[0] == "{":
            stack.append(len(names) - 1)
        elif words[0] == "}":
            stack.pop()
        elif words[0] == "OFFSET":
            offsets.append([float(word) for word in words[1:]])
    rows = motion.splitlines()
    found = []
    for row in rows[2:]:
        values = np.array(row.split(), float)
        places: list[NDArray[np.float64]] = []
        turned: list[NDArray[np.float64]] = []
        at = 3
        for joint, parent in enumerate(parents):
            before = turned[parent] if parent >= 0 else np.eye(3)
            start = places[parent] if parent >= 0 else values[:3] - offsets[0]
            places.append(start + before @ np.array(offsets[joint]))
            if not names[joint]:
                turned.append(before)
                continue
            z, x, y = np.deg2rad(values[at : at + 3])
            at += 3
            turned.append(before @ about(z, 2) @ about(x, 0) @ about(y, 1))
        found.append(places)
    return names, np.array(found), float(rows[1].split()[-1])


def about(angle: float, axis: int) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = -s, s
    return turn
