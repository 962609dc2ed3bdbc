"""Sources without a body index: the floor and the room are not the person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_unusual_people import Scene

from manip3d import RgbdFrame
from manip3d.modify import (
    Limb,
    PhantomFrame,
    PhantomPipeline,
    PhantomReason,
    PhantomState,
    PixelKind,
)
from manip3d.rgbd import NO_BODY
from manip3d.simulate import BodySimulator
from manip3d.simulate._figure import Pose, about

LIMBS: tuple[Limb, ...] = ("left_arm", "right_arm", "left_leg", "right_leg")


def blind(frame: RgbdFrame) -> RgbdFrame:
    """The frame of a source that does not know which pixels are people."""
    people = tuple(replace(person, body=NO_BODY) for person in frame.skeletons)
    return replace(frame, body_index=None, skeletons=people)


def overlap(a: PhantomFrame, b: PhantomFrame) -> float:
    """Intersection over union of what two pictures show."""
    shown = [result.kinds != PixelKind.NONE for result in (a, b)]
    return float((shown[0] & shown[1]).sum() / (shown[0] | shown[1]).sum())


@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize(("sitting", "least"), [(False, 0.97), (True, 0.9)])
def test_a_room_is_not_the_person(limb: Limb, sitting: bool, least: float) -> None:
    """A leg used to be `doubled` in every frame by the floor, and arms showed half of the room."""
    motion = "reach" if limb.endswith("arm") else "knee-extension" if sitting else "stepping"
    known, unknown = PhantomPipeline(limb), PhantomPipeline(limb)
    people = BodySimulator(
        motion=motion,
        amputated=limb,
        sitting=sitting,
        tracker="kinect-v2",
        color="none",
        seed=11,
        frames=8,
        rate=15.0,
    )
    for number, frame in enumerate(people):
        wanted, found = known.process(frame), unknown.process(blind(frame))
        if number < 3:
            continue
        assert found.state is PhantomState.TRACKING, found.reason
        assert overlap(wanted, found) > least


@pytest.mark.parametrize("limb", ["left_arm", "right_leg"])
@pytest.mark.parametrize(
    ("down", "roll", "turn", "height"),
    [
        (25.0, 0.0, 30.0, 2.1),
        (-20.0, 0.0, 30.0, 0.3),
        (0.0, 10.0, 0.0, 0.95),
        (40.0, 0.0, 0.0, 2.6),
        (0.0, 42.0, 0.0, 0.95),
    ],
)
def test_the_floor_of_a_tilted_camera(
    limb: Limb, down: float, roll: float, turn: float, height: float
) -> None:
    scene = Scene(Pose(turn=turn), turned=about("z", roll) @ about("x", down), height=height)
    wanted = scene.watched(limb, 5)
    scene.frame = blind(scene.frame)
    for before, after in list(zip(wanted, scene.watched(limb, 5), strict=True))[2:]:
        assert after.state is PhantomState.TRACKING
        assert overlap(before, after) > 0.97


def test_joints_beside_everything_are_a_matter_of_the_calibration() -> None:
    scene = Scene(Pose())
    told = scene.frame.skeletons[0]
    aside = told.positions + np.float32([0.0, -1.8, 0.0])
    scene.frame = blind(replace(scene.frame, skeletons=(replace(told, positions=aside),)))
    result = scene.watched("left_leg", 5)[-1]
    assert result.state is PhantomState.LOST
    assert result.reason is PhantomReason.CALIBRATION


def test_a_table_is_no_floor() -> None:
    """Most of what is level is a table's; the floor is lower."""
    scene = Scene(Pose(), height=1.6)
    wanted = scene.watched("right_leg", 5)[-1]
    camera = scene.frame.calibration.depth
    rays = camera.unproject(np.ones(scene.frame.depth.shape, np.float32))
    depth = scene.frame.depth.copy()
    with np.errstate(divide="ignore"):
        table = np.where(rays[..., 1] > 0.05, 1000.0 * 1.1 / rays[..., 1], 0.0)
    aside = np.abs(rays[..., 0] * table) > 350.0
    on_table = aside & (table > 1500.0) & (table < 3200.0) & (scene.frame.body_index != 0)
    depth[on_table] = table[on_table].astype(np.uint16)
    assert on_table.sum() > 0.5 * (scene.frame.body_index == 0).sum()
    scene.frame = blind(replace(scene.frame, depth=depth))
    found = scene.watched("right_leg", 5)[-1]
    assert found.state is PhantomState.TRACKING
    assert overlap(wanted, found) > 0.95
