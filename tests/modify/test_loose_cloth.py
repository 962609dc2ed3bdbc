"""Loose cloth of a missing limb is taken out; hands before the place of a leg stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import RgbdFrame, datasets, modify, rgbd
from real_data import RealData

JOINT = {name: number for number, name in enumerate(rgbd.JOINTS)}
INFERRED = 1


def made_up(frame: RgbdFrame, side: str) -> RgbdFrame:
    """Return the frame with a leg's joints inferred, as a tracker infers those of a missing leg."""
    person = frame.skeletons[0]
    states = person.states.copy()
    states[[JOINT[f"{part}{side}"] for part in ("Knee", "Ankle", "Foot")]] = INFERRED
    return replace(frame, skeletons=(replace(person, states=states),))


def near_hand(frame: RgbdFrame, side: str) -> NDArray[np.bool_]:
    """Return a mask of pixels within 10 cm of the hand or the wrist."""
    points = frame.calibration.depth.unproject(frame.depth)
    joints = frame.skeletons[0].positions
    distances = [
        np.linalg.norm(points - joints[JOINT[f"{part}{side}"]], axis=-1)
        for part in ("Hand", "Wrist")
    ]
    return np.asarray(np.minimum(*distances) < 0.1)


@pytest.mark.parametrize("action", ["a24", "a25"])
@pytest.mark.parametrize(("limb", "side"), [("left_leg", "Left"), ("right_leg", "Right")])
def test_hands_before_a_leg_are_no_cloth(
    action: str, limb: str, side: str, realdata: RealData
) -> None:
    """Hands of people who stand up and sit down are kept as well as with a tracked leg."""
    realdata.needs("people_utd_mhad")
    tracked, missing = modify.PhantomPipeline(limb), modify.PhantomPipeline(limb)
    lost = seen = 0
    for number, frame in enumerate(datasets.open_people(f"utd-mhad:{action}_s1")[:28:2]):
        kept = tracked.process(frame if number == 0 else made_up(frame, side)).kinds
        found = missing.process(made_up(frame, side)).kinds
        hand = near_hand(frame, side) & (kept == modify.PixelKind.BODY)
        if number > 0:
            seen += int(hand.sum())
            lost += int((hand & (found == modify.PixelKind.NONE)).sum())
    assert seen > 1000
    assert lost <= 0.035 * seen
