"""The phantom limb, frame by frame, on a person of capsules whose surface is known exactly."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from capsule_body import KINECT, frame, pose, render, surface_distance
from manip3d.modify import Limb, PhantomFrame, PhantomPipeline, PhantomState, PixelKind
from manip3d.rgbd import MIRRORED_JOINTS, PARENTS

LIMBS: tuple[Limb, ...] = get_args(Limb)
ROOTS = {"left_arm": 4, "right_arm": 8, "left_leg": 12, "right_leg": 16}


def limb_bones(limb: str) -> set[int]:
    """Bones beyond the root of a limb."""
    beyond = {ROOTS[limb]}
    for _ in range(25):
        beyond |= {bone for bone in range(1, 25) if PARENTS[bone] in beyond}
    return beyond - {ROOTS[limb]}


def phantom_points(result: PhantomFrame) -> np.ndarray:
    """Points that were mirrored, not filled."""
    u, v = result.pixels[: result.num_points].T
    kinds = result.kinds[v, u]
    chosen = (kinds == PixelKind.PHANTOM) | (kinds == PixelKind.AWAY)
    return result.vertices[: result.num_points][chosen].astype(float)


@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize("turn", [0.0, 8.0])
def test_phantom_lies_on_the_limb_that_is_not_there(limb: Limb, turn: float) -> None:
    whole = pose(turn_deg=turn)
    amputee = frame(whole, KINECT, without=tuple(limb_bones(limb)))
    result = PhantomPipeline(limb, smoothing=None).process(amputee)
    assert result.state is PhantomState.TRACKING
    assert result.opacity == 1
    points = phantom_points(result)
    assert len(points) > 1000
    assert np.median(surface_distance(points, whole)) < 0.001
    mirrored = result.phantom & (result.kinds != PixelKind.ROOT_FILLED)
    assert set(np.unique(result.labels[mirrored])) <= limb_bones(limb)


@pytest.mark.parametrize("limb", LIMBS)
def test_no_pixel_of_the_affected_limb_is_left(limb: Limb) -> None:
    whole = pose()
    before = frame(whole, KINECT)
    result = PhantomPipeline(limb, smoothing=None).process(before)
    _, bones = render(whole, KINECT)
    affected = np.isin(bones, list(limb_bones(limb)))
    assert result.num_removed >= affected.sum() > 1000
    assert not (affected & (result.kinds == PixelKind.BODY)).any()


def test_phantom_joints_are_mirrored() -> None:
    result = PhantomPipeline("left_leg", smoothing=None).process(frame(pose(turn_deg=20)))
    expected = pose(turn_deg=20).positions  # the capsule person is symmetric
    np.testing.assert_allclose(result.skeleton.positions, expected, atol=1e-5)
    assert MIRRORED_JOINTS[12] == 16
