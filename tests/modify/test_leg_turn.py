"""Seated people who have both legs: the phantom lies where the affected leg was."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import datasets, modify
from manip3d.simulate import BodySimulator
from real_data import RealData


@pytest.mark.realdata
@pytest.mark.parametrize("limb", ["left_leg", "right_leg"])
def test_no_lap_is_cut_while_the_chest_turns_on_the_seat(
    limb: modify.Limb, realdata: RealData
) -> None:
    """A person whose legs are turned by 12 degrees against the chest, which turns when rising.

    By the plane of the trunk 17 to 29 % of what is below the hips was lost in the first 20 frames.
    """
    realdata.needs("people_utd_mhad")
    pipeline = modify.PhantomPipeline(limb)
    lost = []
    for frame in datasets.open_people("utd-mhad:a24_s6")[:36]:
        result = pipeline.process(frame)
        points = frame.calibration.depth.unproject(frame.depth)
        below = (frame.body_index == 0) & (points[..., 1] > frame.skeletons[0].positions[0, 1])
        lost.append(np.mean(result.kinds[below] == modify.PixelKind.NONE))
    assert np.median(lost) < 0.09
    assert np.percentile(lost, 95) < 0.15


@pytest.mark.parametrize("motion", ["still", "knee-extension", "dorsiflexion"])
def test_the_plane_turns_with_a_person_who_moves_the_intact_leg(motion: str) -> None:
    """Neither the exercise of one leg nor a sway of the whole body takes the plane along."""
    pipeline = modify.PhantomPipeline("left_leg")
    simulator = BodySimulator(
        motion=motion,
        side="right",
        sitting=True,
        sway=10.0,
        tracker="kinect-v1",
        color="none",
        room=False,
        seed=7,
    )
    off = []
    for number in range(60):
        seen = simulator.capture(number / 30.0)
        plane = pipeline.process(seen.frame).plane
        if plane is None or number < 5:
            continue
        hips = seen.truth.joints[12] - seen.truth.joints[16]
        cosine = abs(float(plane.normal @ hips)) / float(np.linalg.norm(hips))
        off.append(np.degrees(np.arccos(min(1.0, cosine))))
    assert len(off) > 50
    assert np.median(off) < 4.0
    assert np.percentile(off, 95) < 7.0
