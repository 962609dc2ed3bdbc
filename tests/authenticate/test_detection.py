"""Every detector answers in the same words: verdict, reason, score, p-value, regions, power."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest
import test_cross_modal as scenes

import lattice_scans as scans
from cave_scans import AHEAD, ball
from manip3d import LidarFrame, authenticate, forge
from manip3d.authenticate import (
    Calibration,
    DensityParameters,
    Detection,
    Disparity,
    Power,
    RegionLike,
)
from manip3d.authenticate import _reflectance as reflectance
from manip3d.authenticate import _turns as turns
from manip3d.authenticate._verdict import tail_p_value
from manip3d.lidar import Box

LATTICE = scans.lattice()
FORGED = np.concatenate([AHEAD, ball(0.6, 20_000) + np.float32([3, 1, 0])])
STREET = scans.scan(np.random.default_rng(5))
FORGED_STREET = np.concatenate([STREET, ball(0.5, 3_000) + np.float32([6, 2, 0])])
FRAME = LidarFrame(STREET, np.full(len(STREET), 0.25, np.float32))
NOTHING = np.empty((0, 3), np.float32)

DETECTIONS: dict[str, Callable[[], Detection]] = {
    "density": lambda: authenticate.density_consistency(
        forge.ctp(AHEAD, ball(0.35, 8000), position=(3.5, 1, 0)).points,
        parameters=DensityParameters(sector=10, level_width=0.1, fall=0.6),
    ),
    "density of nothing": lambda: authenticate.density_consistency(NOTHING),
    "occlusion": lambda: authenticate.occlusion_consistency(FORGED),
    "occlusion of nothing": lambda: authenticate.occlusion_consistency(NOTHING),
    "generic": lambda: authenticate.generic_consistency(FORGED_STREET, lattice=LATTICE),
    "generic of nothing": lambda: authenticate.generic_consistency(NOTHING, lattice=LATTICE),
    "turns": lambda: authenticate.turn_consistency(FRAME, FRAME, FRAME, lattice=LATTICE),
    "reflectance": lambda: authenticate.reflectance_consistency(FRAME, lattice=LATTICE),
    "cross-modal": lambda: authenticate.cross_modal_consistency(
        scenes.lidar(scenes.CAR), scenes.cameras(), scenes.RIG
    ),
    "cross-modal in the dark": lambda: authenticate.cross_modal_consistency(
        scenes.lidar(scenes.CAR), Disparity(np.zeros((72, 96), np.float32)), scenes.RIG
    ),
    "surround": lambda: authenticate.surround_consistency(
        scenes.lidar(scenes.CAR), {"front": scenes.cameras()}, {"front": scenes.RIG}
    ),
    "inspect": lambda: authenticate.inspect(FORGED, origin=(0, 0, 0)),
}


@pytest.mark.parametrize("name", DETECTIONS)
def test_the_words_are_those_of_the_protocol(name: str) -> None:
    found = DETECTIONS[name]()
    assert isinstance(found, Detection)
    assert found.verdict in ("no_trace", "tampered", "processed", "undecidable")
    assert found.reason
    assert found.score is None or found.score >= 0.0
    assert found.p_value is None or 0.0 <= found.p_value <= 1.0
    assert found.calibration is None or isinstance(found.calibration, Calibration)
    assert all(isinstance(power, Power) for power in found.power.values())
    assert found.suspected.dtype.kind == "i"
    assert (np.diff(found.suspected) > 0).all()
    assert (found.verdict == "tampered") >= bool(len(found.suspected))
    for region in found.regions:
        assert isinstance(region, RegionLike)
        assert isinstance(region.box, Box)
        assert region.rows.dtype == np.int64
        assert np.isin(region.rows, found.suspected).all()
        assert region.p_value is None or 0.0 <= region.p_value <= 1.0


@pytest.mark.parametrize(
    "name", ["density", "occlusion", "generic", "inspect", "cross-modal", "surround"]
)
def test_an_accusation_has_regions_and_their_points(name: str) -> None:
    found = DETECTIONS[name]()
    assert found.verdict == "tampered"
    rows = np.unique(np.concatenate([region.rows for region in found.regions]))
    np.testing.assert_array_equal(rows, found.suspected)


def test_each_occlusion_region_has_the_points_of_its_own_place() -> None:
    """Two balls in front of the wall, and no point of one in the region of the other."""
    first, second = (ball(0.6, 20_000) + np.float32(at) for at in ([3, 1, 0], [-3, 1, 0]))
    found = authenticate.occlusion_consistency(np.concatenate([AHEAD, first, second]))
    one, other = sorted(found.regions, key=lambda region: -region.box.center[0])[:2]
    assert ((one.rows >= len(AHEAD)) & (one.rows < len(AHEAD) + len(first))).mean() > 0.95
    assert (other.rows >= len(AHEAD) + len(first)).mean() > 0.95


def test_a_p_value_counts_the_clean_frames_with_as_much_evidence() -> None:
    tail = (3.0, 2.0, 2.0, 1.0)
    found = [tail_p_value(strength, tail, 9) for strength in (4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5)]
    assert found == [0.1, 0.2, 0.2, 0.4, 0.4, 1.0, 1.0]


@pytest.mark.parametrize("detector", [turns, reflectance], ids=["turns", "reflectance"])
def test_strengths_of_clean_frames_descend(detector: ModuleType) -> None:
    assert list(detector.TAIL) == sorted(detector.TAIL, reverse=True)
