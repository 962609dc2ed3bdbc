"""A chest that twists takes the plane of a leg along: the gate says so."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d.modify import Limb, PhantomPipeline, PhantomReason
from manip3d.simulate import BodySimulator

pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")


def followed(limb: Limb, twist: float) -> tuple[np.ndarray, np.ndarray, set[PhantomReason]]:
    """Errors of the plane in degrees, whether the state is `tracking`, and the other reasons."""
    pipeline = PhantomPipeline(limb)
    people = BodySimulator(
        amputated=limb, motion="still", twist=twist, tracker="kinect-v2", color="none", room=False,
        seed=2,
    )  # fmt: skip
    off, tracking, reasons = [], [], set()
    for number in range(120):
        seen = people.capture(number / 30.0)
        result = pipeline.process(seen.frame)
        if number < 15:
            continue
        assert result.plane is not None
        _, normal = seen.truth.mirror_plane(limb)
        off.append(np.degrees(np.arccos(min(1.0, abs(float(result.plane.normal @ normal))))))
        tracking.append(result.state.value == "tracking")
        if not tracking[-1]:
            reasons.add(result.reason)
    return np.array(off), np.array(tracking), reasons


@pytest.mark.parametrize("limb", ["left_leg", "right_leg"])
def test_a_chest_that_twists_is_said(limb: Limb) -> None:
    """Nine of ten frames whose plane was far off were `tracking` once."""
    off, tracking, reasons = followed(limb, 25.0)
    far = off > 10.0
    assert far.mean() > 0.5
    assert tracking[far].mean() < 0.4
    assert PhantomReason.SHAKY in reasons


@pytest.mark.parametrize("limb", ["left_leg", "right_leg"])
def test_a_chest_at_rest_is_not(limb: Limb) -> None:
    off, tracking, _ = followed(limb, 0.0)
    assert off.max() < 3.0
    assert tracking.mean() > 0.95
