"""The vertical of a tilted camera, and results in level axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_unusual_people import Scene

import capsule_body
from manip3d import InputError, Skeleton
from manip3d._util.linear import rotations_of
from manip3d.modify import DownSource, Limb, PhantomFrame, PhantomPipeline
from manip3d.modify._level import level_rotation, turned_skeleton
from manip3d.simulate._figure import Pose, about

LEVEL = (0.0, 1.0, 0.0)


def degrees_off(result: PhantomFrame, down: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, float(result.down @ down)))))


@pytest.mark.parametrize("limb", ["left_leg", "right_leg", "left_arm", "right_arm"])
@pytest.mark.parametrize(
    ("tilt", "roll", "height"),
    [(0.0, 0.0, 0.95), (25.0, 0.0, 2.1), (-20.0, 0.0, 0.3), (0.0, 20.0, 0.95)],
)
def test_a_floor_tells_the_vertical(limb: Limb, tilt: float, roll: float, height: float) -> None:
    """The floor gives the vertical for arms and legs, also with a body index."""
    turned = about("z", roll) @ about("x", tilt)
    for result in Scene(Pose(turn=20.0), turned=turned, height=height).watched(limb, 3):
        assert result.down_source is DownSource.FLOOR
        assert degrees_off(result, turned[:, 1]) < 0.3


@pytest.mark.parametrize("limb", ["left_leg", "right_arm"])
@pytest.mark.parametrize(("tilt", "roll"), [(25.0, 0.0), (0.0, 20.0)])
def test_a_standing_person_tells_the_vertical_roughly(limb: Limb, tilt: float, roll: float) -> None:
    turned = about("z", roll) @ about("x", tilt)
    result = Scene(Pose(), turned=turned, height=2.1, has_floor=False).watched(limb, 10)[-1]
    assert result.down_source is DownSource.POSTURE
    assert degrees_off(result, turned[:, 1]) < 5.0


def test_a_level_camera_without_a_floor_stays_level() -> None:
    result = Scene(Pose(turn=20.0), has_floor=False).watched("right_arm", 10)[-1]
    assert result.down_source is DownSource.POSTURE
    assert result.down.tolist() == list(LEVEL)


def test_nobody_tells_no_vertical_and_the_last_one_is_kept() -> None:
    scene = Scene(Pose(), turned=about("x", 25.0), height=2.1)
    empty = replace(scene.frame, skeletons=())
    pipeline = PhantomPipeline("left_leg")
    result = pipeline.process(empty)
    assert (result.down_source, result.down.tolist()) == (DownSource.ASSUMED, list(LEVEL))
    known = pipeline.process(replace(scene.frame, time_ns=1, number=1))
    for number in range(2, 4):
        result = pipeline.process(replace(empty, time_ns=number, number=number))
        assert result.down_source is DownSource.FLOOR
        np.testing.assert_array_equal(result.down, known.down)
    assert pipeline.reset().process(empty).down_source is DownSource.ASSUMED


# --- level axes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("down", [(0, 2, 0), (0.3, 0.9, -0.2), (0, 1, 1), (1, 0, 0), (0.1, -9, 0)])
def test_level_axes_are_the_vertical_and_where_the_camera_looks(down: tuple[float, ...]) -> None:
    rotation = level_rotation(down)
    unit = np.array(down) / np.linalg.norm(down)
    np.testing.assert_allclose(rotation @ unit, LEVEL, atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    ahead = rotation @ (0, 0, 1)
    assert ahead[0] == pytest.approx(0.0)
    assert ahead[2] > 0


def test_a_level_vertical_rotates_nothing() -> None:
    np.testing.assert_array_equal(level_rotation(LEVEL), np.eye(3))


@pytest.mark.parametrize("down", [(0, 0, 0), (0, 1), (0, np.nan, 1), (0, np.inf, 1), (0, 0, 1)])
def test_what_is_no_vertical_is_refused(down: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="down: expected"):
        level_rotation(down)


def test_orientations_turn_with_the_bones() -> None:
    random = np.random.default_rng(3)
    told = random.standard_normal((25, 4))
    told /= np.linalg.norm(told, axis=1, keepdims=True)
    told[7] = 0.0  # not known
    skeleton = Skeleton(random.standard_normal((25, 3)), told.astype(np.float32), id=3, body=2)
    rotation = level_rotation((0.3, 0.9, -0.2))
    turned = turned_skeleton(skeleton, rotation)
    np.testing.assert_allclose(turned.positions, skeleton.positions @ rotation.T, atol=1e-6)
    known = np.arange(25) != 7
    found, before = (rotations_of(s.orientations[known].astype(float)) for s in (turned, skeleton))
    np.testing.assert_allclose(found, rotation @ before, atol=1e-6)
    assert not turned.orientations[7].any()
    assert (turned.id, turned.body) == (3, 2)


def test_a_result_in_level_axes() -> None:
    rotation = about("x", 25.0)
    scene = Scene(Pose(), turned=rotation, height=2.1)
    result = scene.watched("left_leg", 3)[-1]
    level = result.levelled()
    assert level.down == pytest.approx(LEVEL)
    back = np.linalg.inv(rotation)
    for found, before in (
        (level.vertices, result.vertices),
        (level.skeleton.positions, result.skeleton.positions),
    ):
        np.testing.assert_allclose(found, before @ back.T, atol=0.02)
        assert found.dtype == np.float32
    assert level.plane is not None
    assert result.plane is not None
    mirrored = level.plane(level.skeleton.positions.astype(float))
    turned = result.plane(result.skeleton.positions.astype(float)) @ level_rotation(result.down).T
    np.testing.assert_allclose(mirrored, turned, atol=1e-5)
    assert level.depth is result.depth
    other = result.levelled(down=LEVEL)
    np.testing.assert_array_equal(other.vertices, result.vertices)


def test_a_result_without_a_plane_is_levelled() -> None:
    frame = replace(capsule_body.painted(0), skeletons=())
    result = PhantomPipeline().process(frame)
    assert result.plane is None
    assert result.levelled((0.0, 1.0, 0.5)).plane is None
