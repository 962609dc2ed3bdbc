"""Re-posing through Python: identity, angles, real people; the kernel is tested in C++."""

from __future__ import annotations

import numpy as np
import pytest

import manip3d
from manip3d import datasets, modify, rgbd
from real_data import RealData

JOINT = {name: number for number, name in enumerate(rgbd.JOINTS)}


def bent(degrees: float) -> manip3d.Skeleton:
    """Standing, the left forearm bent towards the camera."""
    positions = np.zeros((25, 3))
    for name, x, y in (
        ("SpineBase", 0.0, 0.0),
        ("SpineMid", 0.0, -0.25),
        ("SpineShoulder", 0.0, -0.5),
        ("ShoulderLeft", 0.2, -0.5),
        ("ElbowLeft", 0.2, -0.2),
        ("ShoulderRight", -0.2, -0.5),
        ("ElbowRight", -0.2, -0.2),
    ):
        positions[JOINT[name]] = (x, y, 2.0)
    angle = np.deg2rad(degrees)
    forearm = 0.25 * np.array([0, np.cos(angle), -np.sin(angle)])
    positions[JOINT["WristLeft"]] = positions[JOINT["ElbowLeft"]] + forearm
    return manip3d.Skeleton(positions)


def elbow_angle(skeleton: manip3d.Skeleton, side: str = "Left") -> float:
    shoulder, elbow, wrist = (
        skeleton.positions[JOINT[part + side]].astype(np.float64)
        for part in ("Shoulder", "Elbow", "Wrist")
    )
    upper, lower = elbow - shoulder, wrist - elbow
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(upper, lower)), upper @ lower))


def test_gain_one_changes_no_bit() -> None:
    vertices = np.random.default_rng(5).normal(size=(1000, 3))
    for dtype in (np.float32, np.float64):
        given = vertices.astype(dtype)
        result = modify.repose(given, bent(40), gains={"ElbowLeft": 1.0})
        assert result is not None
        assert result.vertices.dtype == dtype
        np.testing.assert_array_equal(result.vertices, given)
        np.testing.assert_array_equal(result.skeleton.positions, bent(40).positions)


def test_gains_and_limits_are_by_name_and_in_degrees() -> None:
    for gains, limits, angle in (
        ({"ElbowLeft": 2.0}, None, 60),
        ({"ElbowLeft": 2.0}, {"ElbowLeft": 45}, 45),
        (None, {"ElbowLeft": 10}, 10),
        ({"ElbowRight": 3.0}, None, 30),
    ):
        result = modify.repose(np.zeros((0, 3)), bent(30), gains=gains, limits=limits)
        assert elbow_angle(result.skeleton) == pytest.approx(angle, abs=1e-3)
        assert result.vertices.shape == (0, 3)
    result = modify.repose([], bent(30), gains={"ElbowLeft": 2.0}, rest=bent(20))
    assert elbow_angle(result.skeleton) == pytest.approx(40, abs=1e-3)


def test_vertices_on_the_bones_go_where_the_bones_go() -> None:
    skeleton = bent(30)
    joints = [JOINT["ElbowLeft"], JOINT["WristLeft"], JOINT["ShoulderLeft"]]
    for blended in (True, False):
        result = modify.repose(
            skeleton.positions[joints], skeleton, gains={"ElbowLeft": 2.0}, blended=blended
        )
        np.testing.assert_allclose(result.vertices, result.skeleton.positions[joints], atol=1e-6)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(manip3d.InputError, match=r"gains: expected one of Neck.*got 'SpineMid'"):
        modify.repose([], bent(30), gains={"SpineMid": 2.0})
    with pytest.raises(manip3d.InputError, match=r"gain of ElbowLeft: expected 0 to 100, got -1"):
        modify.repose([], bent(30), gains={"ElbowLeft": -1})
    with pytest.raises(manip3d.InputError, match=r"limit of ElbowLeft: expected at least 0"):
        modify.repose([], bent(30), limits={"ElbowLeft": float("nan")})
    with pytest.raises(manip3d.InputError, match="band: expected above 0"):
        modify.repose([], bent(30), band=0.0)
    with pytest.raises(manip3d.InputError, match=r"vertices: expected shape \(N, 3\)"):
        modify.repose(np.zeros((4, 2)), bent(30))
    lost = manip3d.Skeleton(bent(30).positions, states=np.zeros(25))
    assert modify.repose([], lost) is None


def test_a_real_person_s_elbow_bends_by_30_degrees_more_without_tearing(realdata: RealData) -> None:
    """Up to a right angle; folded limbs are one surface where they touch, which must stretch."""
    realdata.needs("people_utd_mhad")
    arm = [JOINT[f"{part}Right"] for part in ("Elbow", "Wrist", "Hand")]
    for frame in datasets.open_people("utd-mhad:a3_s1")[::12]:
        shown = modify.PhantomPipeline("left_leg", keep_residual=True, smoothing=None).process(
            frame
        )
        skeleton, vertices = frame.skeletons[0], shown.vertices.astype(np.float64)
        column, row = shown.pixels.T
        labels = shown.labels[row, column]
        corners = shown.faces[np.isin(labels[shown.faces], arm).all(axis=1)]
        assert len(corners) > 500
        angle = elbow_angle(skeleton, "Right")
        before = sides(vertices, corners)
        stretch = {}
        for blended in (True, False):
            gains = {"ElbowRight": (angle + 30) / angle}
            result = modify.repose(vertices, skeleton, gains=gains, blended=blended)
            assert elbow_angle(result.skeleton, "Right") == pytest.approx(angle + 30, abs=0.01)
            stretch[blended] = np.max(sides(result.vertices, corners) / before)
        assert stretch[True] < 1.6
        assert stretch[False] > 2.0


def sides(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = points[faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
