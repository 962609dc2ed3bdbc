"""Joints as tables and motions that other programs read."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from capsule_body import frame, pose
from manip3d import InputError, RgbdFrame, Skeleton, capture
from manip3d.rgbd import JOINTS


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


def test_a_motion_puts_joints_where_they_were(tmp_path: Path) -> None:
    frames = waving()
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    assert (done.frames, done.people) == (12, 1)
    names, places, step = read_bvh(done.path)
    assert step == pytest.approx(1 / 30, abs=1e-6)
    for joint, name in enumerate(JOINTS):
        mine = places[:, names.index(name)] / (100, -100, -100)
        true = np.array([f.skeletons[0].positions[joint] for f in frames])
        np.testing.assert_allclose(mine, true, atol=2e-4, err_msg=name)


def test_a_table_has_all_that_was_seen(tmp_path: Path) -> None:
    frames = waving()[:2]
    visitor = replace(pose(at=(0.5, 0, 3)), id=7)
    frames[1] = replace(frames[1], skeletons=(*frames[1].skeletons, visitor))
    done = capture.export_joints(frames, tmp_path / "wave.csv")
    assert (done.frames, done.people) == (3, 2)
    with done.path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 25
    last = rows[-1]
    assert (last["id"], last["name"], last["state"]) == ("7", JOINTS[24], "2")
    np.testing.assert_allclose([float(last[c]) for c in "xyz"], visitor.positions[24], atol=1e-6)
    assert last["time_ns"] == str(frames[1].time)


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    frames = waving()[:1]
    with pytest.raises(InputError, match=r"\.csv or \.bvh"):
        capture.export_joints(frames, tmp_path / "wave.txt")
    with pytest.raises(InputError, match="id 9"):
        capture.export_joints(frames, tmp_path / "wave.csv", person=9)
    capture.export_joints(frames, tmp_path / "wave.csv")
    with pytest.raises(InputError, match="exists already"):
        capture.export_joints(frames, tmp_path / "wave.csv")
    nobody = [replace(frames[0], skeletons=())]
    with pytest.raises(InputError, match="a skeleton in some frame"):
        capture.export_joints(nobody, tmp_path / "nobody.bvh")


def test_joints_that_are_missing_stay_where_they_were(tmp_path: Path) -> None:
    frames = waving()
    hidden = frames[5].skeletons[0]
    states = hidden.states.copy()
    states[7] = 0
    gone = Skeleton(np.where(states[:, None] > 0, hidden.positions, 0.0), states=states, id=1)
    frames[5] = replace(frames[5], skeletons=(gone,))
    done = capture.export_joints(frames, tmp_path / "wave.bvh")
    names, places, _ = read_bvh(done.path)
    hand = places[:, names.index("HandLeft")]
    assert np.linalg.norm(np.diff(hand, axis=0), axis=1).max() < 30.0  # centimetres
