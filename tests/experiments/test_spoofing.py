"""Published defences against spoofed cars: their scores of boxes whose truth is plain."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d.authenticate import kitti_lattice
from manip3d.experiments import registry, spoofing_6
from manip3d.experiments._lidar_attacks import Target
from manip3d.experiments._model import Plan
from manip3d.lidar import Box

CAR = Box((10.0, 0.0, -1.0), (4.0, 2.0, 1.5))


def wall_of_returns(range_: float) -> np.ndarray:
    """Returns at one distance along x, in the directions that meet the near face of the car."""
    across, up = np.meshgrid(np.linspace(-0.79, 0.79, 80), np.linspace(-1.4, -0.3, 60))
    face = np.column_stack([np.full(across.size, 8.0), across.ravel(), up.ravel()])
    return (face * (range_ / 8.0)).astype(np.float32)


def test_a_car_that_stops_all_lasers_is_neither_penetrated_nor_free() -> None:
    seen = wall_of_returns(8.0)
    assert spoofing_6.penetration(seen, CAR) == 0.0
    assert spoofing_6.free_space(seen, CAR) == 0.0
    assert spoofing_6.shadow(seen, CAR) == 0.0


def test_lasers_that_go_on_behind_a_box_tell_that_nothing_stands_there() -> None:
    behind = wall_of_returns(20.0)
    both = np.concatenate([wall_of_returns(8.5), behind])
    assert spoofing_6.penetration(behind, CAR) == 1.0
    assert spoofing_6.penetration(both, CAR) == 0.5
    assert spoofing_6.free_space(behind, CAR) > 0.6  # what no direction here crosses stays unknown
    assert spoofing_6.shadow(behind, CAR) > 0.0


def test_a_return_in_a_shadow_weighs_most_at_its_start_and_its_middle() -> None:
    start = float(np.hypot(12.0, 1.0))
    end = start + start * (spoofing_6.SENSOR_HEIGHT / 0.25 - 1.0)

    def score(rho: float, azimuth: float) -> float:
        place = [rho * np.cos(azimuth), rho * np.sin(azimuth), -1.7]
        return spoofing_6.shadow(np.array([place], np.float32), CAR)

    assert score(start + 0.001, 0.0) == pytest.approx(1.0, abs=1e-3)
    last = min(end, start + spoofing_6.LONGEST_SHADOW) - 0.01
    assert score(last, 0.999 * np.arctan2(1.0, 8.0)) == pytest.approx(0.0, abs=2e-3)
    assert score(start - 0.1, 0.0) == 0.0


def test_a_replayed_car_stands_where_its_returns_are() -> None:
    returns = CAR.center + np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3)) * CAR.size
    target = Target(
        returns[:0].astype(np.float32),
        CAR,
        returns.astype(np.float32),
        6.0,
        1.0,
        kitti_lattice(),
        0,
    )
    box = spoofing_6._spoofed_box(CAR, target)
    assert box.contains(target.at_distance).all()
    assert np.hypot(*box.center[:2]) == pytest.approx(6.0, abs=0.5)


@pytest.mark.parametrize(
    ("name", "first"), [("spoofing-6", spoofing_6.FIRST_STREET), ("detector-3", 0)]
)
def test_each_seed_has_streets_of_its_own(name: str, first: int) -> None:
    """The results that are published are those of seed 0."""
    streets: list[set[int]] = []
    for seed in range(3):
        cases = registry()[name].cases(Plan(data="simulated", seed=seed))
        blocks = [(each.options["first"], each.options["streets"]) for each in cases]
        streets.append({k for start, count in blocks for k in range(start, start + count)})
    assert min(streets[0]) == first
    assert len(set.union(*streets)) == 3 * len(streets[0])
