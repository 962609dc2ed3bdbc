"""The measure `doubled` of ``benchmarks/bench_people.py`` against the truth of the simulator."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import RgbdFrame
from manip3d.modify import Limb, PhantomFrame, PhantomPipeline, PixelKind
from manip3d.simulate import BodySimulator
from manip3d.simulate.people import LIMBS

CASES: list[tuple[Limb, dict[str, Any]]] = [
    ("left_arm", {"motion": "arm-raise"}),
    ("right_arm", {"motion": "reach"}),
    ("right_arm", {"motion": "reach", "sitting": True}),
    ("left_arm", {"motion": "still", "sitting": True, "tracker": "kinect-v1"}),
    ("left_leg", {"motion": "stepping"}),
    ("right_leg", {"motion": "knee-extension", "sitting": True}),
]


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    """The benchmark as a module."""
    folder = str(Path(__file__).parents[2] / "benchmarks")
    sys.path.insert(0, folder)
    try:
        import bench_people
    finally:
        sys.path.remove(folder)
    return bench_people


@dataclass(frozen=True, eq=False)
class Seen:
    """A person with all limbs, nothing taken out, and the bone of each pixel as it is."""

    frame: RgbdFrame
    result: PhantomFrame
    bones: NDArray[np.uint8]
    limb: Limb


def whole_person(limb: Limb, body: dict[str, Any]) -> Seen:
    simulator = BodySimulator(color="none", room=False, seed=4, **body)
    pipeline = PhantomPipeline(limb, keep_residual=True)
    for number in range(12):
        capture = simulator.capture(number / 10.0)
        result = pipeline.process(capture.frame)
    return Seen(capture.frame, result, capture.truth.bones, limb)


@pytest.fixture(scope="module", params=CASES, ids=str)
def seen(request: pytest.FixtureRequest) -> Seen:
    """Each case once for all tests."""
    return whole_person(*request.param)


def doubled(bench: ModuleType, seen: Seen, shown: NDArray[np.bool_]) -> float:
    """The measure over its limit if the picture shows these pixels of the body."""
    kinds = np.where(shown, PixelKind.BODY, PixelKind.NONE).astype(seen.result.kinds.dtype)
    person = seen.frame.skeletons[0]
    bones = bench.segmented(seen.frame, person)
    rest = bench.segmented(seen.frame, bench.without(person, seen.limb))
    result = replace(seen.result, kinds=kinds)
    return float(bench.shares(seen.frame, result, seen.limb, bones, rest)["doubled"])


def end_of(seen: Seen) -> NDArray[np.bool_]:
    """Pixels of forearm and hand, or of shin and foot."""
    return (seen.frame.body_index == 0) & np.isin(seen.bones, LIMBS[seen.limb][2:])


def test_a_limb_that_is_left_is_doubled(bench: ModuleType, seen: Seen) -> None:
    assert end_of(seen).sum() > 100
    assert doubled(bench, seen, end_of(seen)) > 3.0


def test_other_limbs_and_the_trunk_are_not_doubled(bench: ModuleType, seen: Seen) -> None:
    others = (seen.frame.body_index == 0) & ~np.isin(seen.bones, LIMBS[seen.limb][1:])
    assert others.sum() > 1000
    assert doubled(bench, seen, others) < 1.0


def test_half_of_what_is_left_is_doubled_half_as_much(bench: ModuleType, seen: Seen) -> None:
    end = end_of(seen)
    every_other = np.indices(end.shape).sum(axis=0) % 2 == 0
    all_of_it, half = (doubled(bench, seen, end & part) for part in (True, every_other))
    assert half == pytest.approx(0.5 * all_of_it, rel=0.1)


@pytest.mark.parametrize("sitting", [False, True])
def test_the_flank_of_a_stout_trunk_is_no_arm(bench: ModuleType, sitting: bool) -> None:
    """A flank is no arm, unlike by distances from the spine alone or from the arm's line alone."""
    seen = whole_person("left_arm", {"motion": "still", "girth": 1.5, "sitting": sitting})
    others = (seen.frame.body_index == 0) & ~np.isin(seen.bones, LIMBS["left_arm"][1:])
    assert doubled(bench, seen, others) < 0.1


def test_a_knee_beside_a_hand_is_no_arm(bench: ModuleType) -> None:
    """Trackers put the joints of seated thighs too deep, so that knees are far from all of them."""
    seen = whole_person("left_arm", {"motion": "arm-curl", "sitting": True})
    person = seen.frame.skeletons[0]
    positions = person.positions.copy()
    positions[[12, 13, 16, 17]] += np.array([0.0, 0.0, 0.16], np.float32)  # hips and knees
    told = replace(
        seen, frame=replace(seen.frame, skeletons=(replace(person, positions=positions),))
    )
    legs = np.isin(seen.bones, [*LIMBS["left_leg"], *LIMBS["right_leg"]])
    assert doubled(bench, told, legs & (seen.frame.body_index == 0)) < 0.2
