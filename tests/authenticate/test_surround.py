"""Several stereo pairs that look different ways: maps, boxes in the LiDAR's frame, who is asked."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import test_cross_modal as scenes
from numpy.typing import NDArray

from manip3d import Box, LidarFrame
from manip3d.authenticate import (
    AlertMonitor,
    CameraPair,
    CrossModalParameters,
    CrossModalRegion,
    RiskTracker,
    StereoRig,
    SurroundResult,
    _alert,
    attack_type,
    cross_modal_consistency,
    read_rigs,
    surround_consistency,
    write_rigs,
)
from manip3d.errors import FormatError, InputError


def turn(degrees: float) -> NDArray[np.float64]:
    matrix = np.eye(4)
    angle = math.radians(degrees)
    matrix[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    return matrix


def turned_rig(degrees: float) -> StereoRig:
    rig = scenes.RIG
    return StereoRig(rig.focal, rig.center, rig.baseline, turn(degrees) @ rig.T_lidar_camera)


def turned_scan(scan: LidarFrame, degrees: float) -> LidarFrame:
    points = scan.points.astype(np.float64) @ turn(degrees)[:3, :3].T
    return LidarFrame(points.astype(np.float32))


RIGS = {"front": turned_rig(0.0), "left": turned_rig(90.0), "rear": turned_rig(180.0)}


@pytest.mark.parametrize("heading", [0.0, 90.0, 143.0, 180.0, -72.0])
def test_a_turned_scene_is_judged_as_the_one_ahead(heading: float) -> None:
    clean, seen = scenes.lidar(), scenes.cameras()
    attacked = scenes.lidar(scenes.CAR)
    ahead = cross_modal_consistency(attacked, seen, scenes.RIG)
    found = cross_modal_consistency(turned_scan(attacked, heading), seen, turned_rig(heading))
    assert turned_rig(heading).heading_deg == pytest.approx(heading)
    assert found.heading == 5.0 * round(heading / 5.0)
    assert found.verdict == ahead.verdict == "tampered"
    (region,), (expected,) = found.regions, ahead.regions
    assert region.kind == "added"
    assert region.area == pytest.approx(expected.area, rel=0.05)
    x, y, z = turn(heading)[:3, :3] @ np.array(expected.box.center)
    assert region.box.center == pytest.approx((x, y, z), abs=0.1)
    assert region.box.yaw == pytest.approx(math.radians(found.heading))
    # The box holds the very points that were added, in the LiDAR's own axes.
    points = turned_scan(attacked, heading).points[found.suspected]
    grown = Box(region.box.center, tuple(s + 0.01 for s in region.box.size), region.box.yaw)  # type: ignore[arg-type]
    assert grown.contains(points).all()
    share = len(set(found.suspected) & set(ahead.suspected)) / len(ahead.suspected)
    assert share > 0.98
    left, right = found.judged_azimuth_deg
    assert right < heading < left
    begin, end = region.azimuth
    middle = math.atan2(y, x)
    assert begin < middle < end
    assert end - begin == pytest.approx(np.ptp(expected.azimuth), abs=0.02)
    calm = cross_modal_consistency(turned_scan(clean, heading), seen, turned_rig(heading))
    assert calm.verdict == "no_trace"


def test_maps_that_look_elsewhere_than_the_cameras_judge_nothing() -> None:
    away = CrossModalParameters(heading=180.0)
    found = cross_modal_consistency(scenes.lidar(), scenes.cameras(), scenes.RIG, parameters=away)
    assert (found.verdict, found.judged.any()) == ("undecidable", False)
    for wrong in (math.nan, 361.0):
        with pytest.raises(InputError, match="heading"):
            cross_modal_consistency(
                scenes.lidar(), scenes.cameras(), scenes.RIG,
                parameters=CrossModalParameters(heading=wrong),
            )  # fmt: skip


def all_around(**cars: Box) -> LidarFrame:
    """The street of `scenes` on three sides, each with the car that is named."""
    sides = []
    for name, heading in (("front", 0.0), ("left", 90.0), ("rear", 180.0)):
        scan = scenes.lidar(*([cars[name]] if name in cars else []))
        view = np.abs(np.arctan2(scan.points[:, 1], scan.points[:, 0])) < math.radians(45.0)
        sides.append(turned_scan(scan.select(view), heading).points)
    return LidarFrame(np.concatenate(sides))


def test_pairs_share_the_false_alarms_of_a_frame() -> None:
    """A single pair accuses at its least area; of several each needs more of it."""
    attacked, seen = scenes.lidar(scenes.CAR), scenes.cameras()
    alone = cross_modal_consistency(attacked, seen, scenes.RIG)
    (region,) = alone.regions
    just = CrossModalParameters(min_added_area=0.9 * region.evidence)
    one, three = ({name: RIGS[name] for name in names} for names in (["front"], list(RIGS)))
    assert surround_consistency(attacked, {"front": seen}, one, parameters=just).verdict == (
        "tampered"
    )
    assert surround_consistency(attacked, {"front": seen}, three, parameters=just).verdict == (
        "no_trace"
    )
    least = CrossModalParameters(min_added_area=0.9 * region.evidence / 3**0.65)
    assert surround_consistency(attacked, {"front": seen}, three, parameters=least).verdict == (
        "tampered"
    )
    assert just.shared(1) == just
    with pytest.raises(InputError, match="pairs"):
        just.shared(0)


def test_a_car_behind_is_found_behind() -> None:
    seen = dict.fromkeys(RIGS, scenes.cameras())
    assert surround_consistency(all_around(), seen, RIGS).verdict == "no_trace"
    found = surround_consistency(all_around(rear=scenes.CAR), seen, RIGS)
    assert (found.verdict, found.attack) == ("tampered", "additive")
    assert found.reason.startswith("rear: 1 region that the cameras do not see")
    (box,) = found.boxes
    assert box.center[:2] == pytest.approx((-12.0, -1.0), abs=2.0)
    assert box.center[0] < -9.0
    observed = found.observation(speed_mps=10.0)
    assert observed is not None
    assert observed.position[0] < -8.0
    rows = found.suspected
    assert len(rows) > 100
    assert (np.diff(rows) > 0).all()
    assert (all_around(rear=scenes.CAR).points[rows, 0] < -8.0).all()
    assert json.loads(json.dumps(found.record()))["pairs"]["front"]["verdict"] == "no_trace"


def test_a_nearer_attack_behind_hides_none_ahead() -> None:
    seen = dict.fromkeys(RIGS, scenes.cameras())
    nearer = Box((9.0, 1.0, -0.9), (4.0, 1.8, 1.6))
    scores, places = [], []
    for cars in ({"front": scenes.CAR}, {"front": scenes.CAR, "rear": nearer}):
        found = surround_consistency(all_around(**cars), seen, RIGS)
        assert len(found.boxes) == len(cars)
        observed = found.observation(speed_mps=15.0)
        assert observed is not None
        risk = RiskTracker().update(observed, speed_mps=15.0)
        places.append(observed.position)
        scores.append(risk.factors["distance"] * risk.factors["angle"])
    assert places[0] == places[1]
    assert scores[0] == scores[1] > 0.0


def test_a_car_moved_from_one_pair_s_view_into_another_s_is_one_modification() -> None:
    # Two places 3 m apart, one seen by the pair ahead, one by that to the left.
    def region(kind: str, x: float, y: float) -> CrossModalRegion:
        return CrossModalRegion(kind, 90, 0, 0.01, 1.0, 5.0, Box((x, y, 0), (1, 1, 1)), 2.0)

    near = (region("added", 8.0, 6.0), region("missing", 6.0, 8.0))
    assert attack_type(near) == "modification"
    assert attack_type((region("added", 20.0, 0.0), region("missing", -20.0, 0.0))) == "both"
    # The same direction, one side of straight behind each: far apart, but one object.
    behind = (region("added", -8.0, 0.2), region("missing", -20.0, -0.2))
    assert attack_type(behind) == "modification"


def test_a_pair_that_sees_nothing_leaves_its_side_undecided() -> None:
    dark = scenes.Disparity(np.zeros((scenes.HEIGHT, scenes.WIDTH), np.float32))
    seen = {"front": scenes.cameras(), "rear": dark}
    found = surround_consistency(all_around(), seen, RIGS)
    assert found.verdict == "undecidable"
    assert found.reason.startswith("rear: the cameras measured too little")
    accused = surround_consistency(all_around(front=scenes.CAR), seen, RIGS)
    assert accused.verdict == "tampered"


def test_what_does_not_fit_together_is_refused() -> None:
    scan, seen = scenes.lidar(), scenes.cameras()
    with pytest.raises(InputError, match="'top'"):
        surround_consistency(scan, {"top": seen}, RIGS)
    with pytest.raises(InputError, match="at least one"):
        surround_consistency(scan, {}, RIGS)
    with pytest.raises(InputError, match="no heading"):
        surround_consistency(
            scan, {"front": seen}, RIGS, parameters=CrossModalParameters(heading=5.0)
        )
    with pytest.raises(InputError, match="at least one stereo rig"):
        AlertMonitor(rig={})
    picture = np.zeros((20, 192), np.uint8)
    with pytest.raises(InputError, match="several rigs"):
        AlertMonitor(rig=RIGS).judge(scan, left=picture, right=picture, speed_mps=1.0)
    for monitor in (AlertMonitor(rig=RIGS), AlertMonitor(rig=scenes.RIG)):
        with pytest.raises(InputError, match="pairs: expected names of rigs"):
            monitor.judge(scan, pairs={"top": (picture, picture)}, speed_mps=1.0)


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> tuple[Clock, list[str]]:
    """Cameras take 40 ms a pair; who was asked."""
    clock, names = Clock(), []
    name_of = {id(rig): name for name, rig in RIGS.items()}

    def compare(frame: LidarFrame, _: Any, rig: StereoRig, **__: Any) -> Any:
        clock.now += 0.04
        names.append(name_of[id(rig)])
        return SimpleNamespace(
            verdict="no_trace", reason="alike", regions=(), boxes=(), score=0.0, scan=frame,
            record=dict,
        )  # fmt: skip

    monkeypatch.setattr(_alert, "stereo_disparity", lambda *_: None)
    monkeypatch.setattr(_alert, "cross_modal_consistency", compare)
    return clock, names


def pictures(*names: str) -> dict[str, Any]:
    picture = np.zeros((20, 192), np.uint8)
    return dict.fromkeys(names, (picture, picture))


def test_pairs_take_turns_where_there_is_no_time_for_all(asked: tuple[Clock, list[str]]) -> None:
    clock, names = asked
    monitor = AlertMonitor(rig=RIGS, budget_s=0.1, every_s=math.inf, clock=clock)
    frame = LidarFrame(np.zeros((0, 3), np.float32))
    # Two pairs fit into 100 ms; of the first frame the cost is not known before.
    for number in range(7):
        alert = monitor.judge(frame, pairs=pictures(*RIGS), speed_mps=1.0, time_s=number / 10.0)
        assert alert.witnesses["cross-modal"].verdict == "no_trace"
        assert isinstance(alert.cross_modal, SurroundResult)
    assert names[:3] == ["front", "left", "rear"]
    later = names[3:]
    assert len(later) == 12
    assert {name: later.count(name) for name in RIGS} == dict.fromkeys(RIGS, 4)
    assert "(not asked: " in alert.witnesses["cross-modal"].reason
    skipped = monitor.counts.skipped
    assert sum(skipped[f"cross-modal {name}"] for name in RIGS) == 6


def test_every_pair_is_heard_though_there_is_never_time(asked: tuple[Clock, list[str]]) -> None:
    clock, names = asked
    monitor = AlertMonitor(rig=RIGS, budget_s=0.01, every_s=1.0, clock=clock)
    frame = LidarFrame(np.zeros((0, 3), np.float32))
    heard: list[list[str]] = []
    for number in range(25):
        names.clear()
        monitor.judge(frame, pairs=pictures(*RIGS), speed_mps=1.0, time_s=number / 10.0)
        heard.append(names.copy())
    assert all(len(each) <= 1 for each in heard)
    assert [n for n, each in enumerate(heard) if each] == [0, 1, 2, 10, 11, 12, 20, 21, 22]
    assert [each[0] for each in heard if each] == ["front", "left", "rear"] * 3
    assert monitor.counts.skipped["cross-modal"] == 16


def test_a_frame_may_lack_the_pictures_of_a_pair(asked: tuple[Clock, list[str]]) -> None:
    clock, names = asked
    monitor = AlertMonitor(rig=RIGS, clock=clock)
    frame = LidarFrame(np.zeros((0, 3), np.float32))
    alert = monitor.judge(frame, pairs=pictures("rear"), speed_mps=1.0)
    assert names == ["rear"]
    assert alert.witnesses["cross-modal"].reason.endswith("(not asked: front, left)")
    assert monitor.judge(frame, speed_mps=1.0).witnesses["cross-modal"].verdict == "absent"


def test_rigs_come_back_from_their_file(tmp_path: Path) -> None:
    path = tmp_path / "rigs.json"
    pairs = {name: CameraPair(rig, 2 * n, 2 * n + 1) for n, (name, rig) in enumerate(RIGS.items())}
    write_rigs(pairs, path)
    read = read_rigs(path)
    assert list(read) == list(RIGS)
    for name, (rig, left, right) in read.items():
        assert (left, right) == pairs[name][1:]
        assert (rig.focal, rig.center, rig.baseline) == (360.0, (309.5, 86.0), 0.54)
        assert np.array_equal(rig.T_lidar_camera, RIGS[name].T_lidar_camera)
    whole = json.loads(path.read_text())
    for change in (
        {"format": "another"},
        {"pairs": {}},
        {"pairs": {"a": {}}},
        {"pairs": []},
        {"pairs": {"a": whole["pairs"]["front"] | {"left": "2"}}},
        {"pairs": {"a": whole["pairs"]["front"] | {"left": 1}}},
        {"pairs": {"a": whole["pairs"]["front"] | {"focal": -1.0}}},
        {"pairs": {"a": whole["pairs"]["front"] | {"focal": 10**400}}},
        {"pairs": {"a": whole["pairs"]["front"] | {"center": [1.0]}}},
        {"pairs": {"a": whole["pairs"]["front"] | {"T_lidar_camera": [[1.0]]}}},
    ):
        path.write_text(json.dumps(whole | change))
        with pytest.raises(FormatError, match="stereo rigs"):
            read_rigs(path)
    for text in ("", "[" * 100_000, "null", "\xff", '{"format": NaN}'):
        path.write_text(text)
        with pytest.raises(FormatError, match="stereo rigs"):
            read_rigs(path)
    path.write_text(" " * (1 << 20) + "{}")
    with pytest.raises(FormatError, match="at most"):
        read_rigs(path)
    with pytest.raises(InputError, match="two cameras"):
        write_rigs({"a": CameraPair(scenes.RIG, 3, 3)}, path)
    with pytest.raises(InputError, match="at least one"):
        write_rigs({}, path)
