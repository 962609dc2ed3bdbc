"""Joints as tables and motions that other programs read."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bvh_motions import read_bvh, waving
from capsule_body import pose
from manip3d import InputError, Skeleton, capture
from manip3d.rgbd import JOINTS


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
