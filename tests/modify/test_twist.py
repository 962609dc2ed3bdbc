"""A chest that twists does not take the plane of a leg along."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from manip3d.modify import Limb, PhantomPipeline, PhantomState
from manip3d.simulate import BodySimulator

pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")


def followed(limb: Limb, **body: Any) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the plane in degrees, and whether the state is `tracking`."""
    pipeline = PhantomPipeline(limb)
    people = BodySimulator(
        amputated=limb, motion="still", tracker="kinect-v2", color="none", room=False, **body
    )
    off, tracking = [], []
    for number in range(120):
        seen = people.capture(number / 30.0)
        result = pipeline.process(seen.frame)
        if number < 15:
            continue
        assert result.plane is not None
        _, normal = seen.truth.mirror_plane(limb)
        off.append(np.degrees(np.arccos(min(1.0, abs(float(result.plane.normal @ normal))))))
        tracking.append(result.state.value == "tracking")
    return np.array(off), np.array(tracking)


@pytest.mark.parametrize(
    ("limb", "sitting"),
    [
        ("left_leg", True),
        ("right_leg", False),
        pytest.param("left_leg", False, marks=pytest.mark.slow),
        pytest.param("right_leg", True, marks=pytest.mark.slow),
    ],
)
def test_the_plane_of_a_leg_stays_at_the_pelvis(limb: Limb, sitting: bool) -> None:
    """It was 15 to 18 degrees off (medians) and half of the frames were not `tracking`.

    Most cases are off by 1 to 4 degrees; the standing right leg by 9, as the turn is sure late.
    """
    off, tracking = followed(limb, twist=20.0, sitting=sitting, seed=2)
    assert np.median(off) < 11.0
    assert np.percentile(off, 95) < 18.0
    assert tracking.mean() > 0.75


@pytest.mark.parametrize("limb", ["left_leg", pytest.param("right_leg", marks=pytest.mark.slow)])
def test_a_chest_at_rest_is_not_twisted(limb: Limb) -> None:
    off, tracking = followed(limb, twist=0.0, seed=2)
    assert off.max() < 3.0
    assert tracking.mean() > 0.95


def test_a_body_that_turns_as_a_whole_is_not_followed_later() -> None:
    """The plane does not lag; with one estimate for trunk and pelvis it lagged by 67 to 400 ms."""
    off, _ = followed("left_leg", sway=20.0, seed=3)
    assert np.percentile(off, 95) < 5.0


def test_a_person_who_enters_the_picture_gets_no_lasting_turn_of_the_pelvis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """While half of the person was out of view, the pelvis got a turn of 30 degrees for good."""
    from manip3d.simulate import people

    aside = 0.0
    stand = people.pose_figure
    monkeypatch.setattr(
        people, "pose_figure", lambda pose, at: stand(pose, (at[0] + aside, at[1], at[2]))
    )
    body = BodySimulator(
        amputated="right_leg",
        motion="still",
        tracker="kinect-v2",
        color="none",
        room=False,
        seed=2,
        frames=50,
    )
    pipeline = PhantomPipeline("right_leg")
    off = []
    for number in range(45):
        aside = min(0.0, -1.7 + 0.08 * number)  # metres; 0.8 m/s at 10 frames a second
        seen = body.capture(number / 10.0)
        result = pipeline.process(seen.frame)
        if number < 31 or result.state != PhantomState.TRACKING:
            continue
        assert result.plane is not None
        _, normal = seen.truth.mirror_plane("right_leg")
        off.append(np.degrees(np.arccos(min(1.0, abs(float(result.plane.normal @ normal))))))
    assert len(off) > 10
    assert max(off) < 5.0
