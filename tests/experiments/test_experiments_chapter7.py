"""Tables 7.1, 7.2 and `security`: their cases, their counts and what their claims make of them."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import manip3d
from manip3d.experiments import (
    Case,
    Plan,
    _alert_set,
    figure_7_7,
    figure_7_8,
    figure_7_10,
    figure_7_12,
    registry,
    security,
    select,
    table_7_1,
    table_7_2,
)
from manip3d.experiments._model import Row
from manip3d.simulate import streets
from watermark_scans import grid_scan, reflectances

QUICK = Plan("simulated", "quick")


def test_full_scale_has_the_published_frames() -> None:
    cases = table_7_2.EXPERIMENT.cases(Plan("simulated", "full"))
    assert registry()["table-7.2"] is table_7_2.EXPERIMENT
    assert sum(case.options["frames"]["original"] for case in cases) == 1765
    attacks = [sum(c.options["frames"].values()) - c.options["frames"]["original"] for c in cases]
    assert sum(attacks) == 8735
    pieces = [c.options for c in cases if c.options["model"] == "drive 2"]
    assert [piece["first"] for piece in pieces] == list(range(0, 395, 5))
    assert all(max(piece["frames"].values()) <= 5 for piece in pieces)


def piece(case: Case, detected: int, accused: int) -> Row:
    counts = {
        f"{attack} {kind}": accused if attack == "original" else detected
        for attack in table_7_2._ATTACKS
        for kind in table_7_2._KINDS
    }
    attacked = {f"{attack} attacked": 3 for attack in table_7_2._ATTACKS}
    return {**case.options, **counts, **attacked, "data": "simulated", "error": "", "key": "k"}


def rows(detected: int, accused: int) -> list[Row]:
    experiment = table_7_2.EXPERIMENT
    assert experiment.gather is not None
    made = [piece(case, detected, accused) for case in experiment.cases(QUICK)]
    return [experiment.complete(row) for row in experiment.gather(made)]


def test_figures_that_another_experiment_draws_are_run_by_their_own_numbers() -> None:
    ids = [each.id for each in select(["figure-7.11", "figure-7.9", "figure-7.10"])]
    assert sorted(ids) == ["figure-7.10", "figure-7.12"]
    with pytest.raises(manip3d.InputError, match=r"figure-7\.13"):
        select(["figure-7.13"])


def test_pieces_of_a_drive_are_added_up_and_a_failed_one_is_told() -> None:
    experiment = table_7_2.EXPERIMENT
    assert experiment.gather is not None
    case = experiment.cases(QUICK)[0]
    whole = piece(case, 2, 1)
    failed = {**case.options, "data": "simulated", "error": "OSError: no", "key": "l"}
    found = experiment.gather([whole, whole])
    assert [row["attack"] for row in found] == list(table_7_2._ATTACKS)
    assert [row["keyed lbm"] for row in found] == [2, 4, 4, 4, 4, 4, 4]
    assert {(row["attacked"], row["error"], row["model"]) for row in found} == {(6, "", "drive 1")}
    assert {row["error"] for row in experiment.gather([whole, failed])} == {
        "1 of 2 pieces failed: OSError: no"
    }


@pytest.mark.parametrize(
    ("detected", "accused", "holds"),
    [(3, 0, [True] * 4), (2, 0, [False, True] * 2), (3, 1, [True, False] * 2)],
)
def test_claims(detected: int, accused: int, holds: list[bool]) -> None:
    found = rows(detected, accused)
    assert found[0]["published frames"] == 800
    verdicts = [claim.verdict(found).holds for claim in table_7_2.EXPERIMENT.claims]
    assert verdicts == holds


def test_one_frame_of_each_attack() -> None:
    pytest.importorskip("open3d")
    case = table_7_2.EXPERIMENT.cases(QUICK)[1]
    frames = dict.fromkeys(table_7_2._ATTACKS, 1)
    row = table_7_2.detect(Case(case.run, {**case.options, "frames": frames}))
    for attack in table_7_2._ATTACKS:
        assert row[f"{attack} attacked"] == 1
        expected = 0 if attack == "original" else 1
        assert [row[f"{attack} {kind}"] for kind in table_7_2._KINDS] == [expected] * 5


def test_frames_of_a_piece_are_those_of_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("open3d")
    # Both readings pass the same two streets, each of which takes a second.
    monkeypatch.setattr(streets, "street", functools.cache(streets.street))
    late = list(_alert_set.frames(300, 99, 2))
    assert [number for number, _, _ in late] == [99, 100]  # the last of a street, the first of one
    again = next(_alert_set.frames(300, 100, 1))
    np.testing.assert_array_equal(late[1][1].points, again[1].points)


def test_an_attack_takes_the_nearest_object_that_has_a_free_place() -> None:
    """The nearer car stands before a wall, so that only the farther one can move on."""
    ground = np.mgrid[-30:30:0.5, -30:30:0.5, -1.5:-1:1].reshape(3, -1).T
    car = np.mgrid[-1:1:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    wall = np.mgrid[7.5:8:0.2, -3:3:0.2, -1.2:2:0.2].reshape(3, -1).T
    near, far = car + np.array([5.0, 0.0, 0.0]), car + np.array([0.0, 12.0, 0.0])
    frame = manip3d.LidarFrame(np.vstack([ground, near, far, wall]).astype(np.float32))
    size = (2.4, 2.4, 2.2)
    boxes = [manip3d.Box((5.0, 0.0, -0.3), size), manip3d.Box((0.0, 12.0, -0.3), size)]
    moved = _alert_set.attacked(frame, boxes, "translation")
    assert moved is not None
    assert moved.box.center[1] > 14.0
    assert _alert_set.attacked(frame, boxes[:1], "translation") is None
    removed = _alert_set.attacked(frame, boxes, "subtractive")
    assert removed is not None
    assert removed.frame.num_points == frame.num_points - len(car)
    # Behind the car stands the copy of the nearer one, and behind that nothing is.
    added = _alert_set.attacked(frame, boxes, "additive")
    assert added is not None
    np.testing.assert_allclose(added.box.center[:2], (-5.0, 0.0), atol=0.2)
    blocked = np.vstack([frame.points, near * np.array([-1, 1, 1])]).astype(np.float32)
    added = _alert_set.attacked(manip3d.LidarFrame(blocked), boxes, "additive")
    assert added is not None
    assert np.hypot(*added.box.center[:2]) == pytest.approx(5.0, abs=0.2)
    assert added.box.center[0] > -4.6


# --- Figures --------------------------------------------------------------------------------------


def test_the_safety_region_grows_with_the_speed() -> None:
    experiment = registry()["figure-7.7"]
    rows = [{**case.options, **figure_7_7.measure(case)} for case in experiment.cases(QUICK)]
    points = [row["points"] for row in rows]
    assert points == sorted(points)
    assert points[0] < points[-1]
    fifty = next(row for row in rows if row["speed_kmh"] == 50)
    # 1.5 s on the way at 13.9 m/s, then braking at 6 m/s^2.
    assert fifty["safe_m"] == pytest.approx(50 / 3.6 * 1.5 + (50 / 3.6) ** 2 / 12)
    seen, inside = np.asarray(fifty["seen"]), np.asarray(fifty["inside"])
    assert 0 < seen[inside, 0].min() <= seen[inside, 0].max() <= fifty["safe_m"] + 0.01
    assert abs(seen[inside, 1]).max() <= 10.01
    assert experiment.figures is not None
    assert len(experiment.figures(rows)) == 1


def test_late_patterns_weigh_more_and_a_wrong_weight_is_told() -> None:
    experiment = registry()["figure-7.8"]
    found = [{**case.options, **figure_7_8.weigh(case)} for case in experiment.cases(QUICK)]
    factors = {row["model"]: row["factor"] for row in found}
    # x_n / X_n times c_n / X_n, section 7.3.5.
    expected = {"11100": 0.36, "00111": 0.6, "11111": 1.0, "10000": 0.04, "00001": 0.2}
    assert {name: factors[name] for name in expected} == pytest.approx(expected)
    (claim,) = experiment.claims
    assert claim.verdict(found).holds is True
    found[0]["factor"] = 0.9  # 11100
    assert claim.verdict(found).holds is False
    assert experiment.figures is not None
    assert len(experiment.figures(found)) == 1


@pytest.mark.parametrize(
    "name", ["table-7.2-cross-modal", "table-7.2", "figure-7.12", "sequences-3"]
)
def test_no_seed_has_the_streets_or_frames_of_another(name: str) -> None:
    """Cases take consecutive seeds, from that in their options on."""
    (experiment,) = select([name])
    first, second = (
        [case.options["seed"] for case in experiment.cases(Plan(data="simulated", seed=seed))]
        for seed in (0, 1)
    )
    assert min(second) - max(first) > 500


def test_a_watermark_moves_points_by_what_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = manip3d.LidarFrame(grid_scan(40_000), reflectances(40_000))
    monkeypatch.setattr(_alert_set, "frames", lambda *_: iter([(0, frame, ()), (1, frame, ())]))
    experiment, found = registry()["figure-7.10"], []
    for case in experiment.cases(QUICK)[:5]:
        row = figure_7_10.embed(case)
        found.append(experiment.complete({**case.options, **row}))
        assert row["recovered"] == 1.0
    largest = {row["method"]: row["largest_mm"] for row in found}
    assert largest["keyed detached"] == 0.0
    assert largest["lbm"] == pytest.approx(3**0.5, abs=0.004)
    assert 1.0 < largest["qim-printed"] <= 1.254
    assert 1.254 < largest["keyed qim"] <= 1.879
    printed, moved, recovered = experiment.claims
    assert moved.verdict(found).holds is True
    assert recovered.verdict(found).holds is True
    assert {f.subject: f.holds for f in printed.verdict(found).findings}["drive 1, lbm"] is True
    found[0]["largest_mm"] = 1.8
    found[1]["recovered"] = 0.5
    assert moved.verdict(found).holds is False
    assert recovered.verdict(found).holds is False


def test_attacks_are_claimed_where_they_were_made() -> None:
    experiment = registry()["figure-7.12"]
    (claim,) = experiment.claims
    row: Row = {"model": "street 100", "attack": "original", "verdict": "no_trace", "type": ""}
    for change, holds in (
        ({}, True),
        ({"verdict": "tampered"}, False),
        ({"attack": "rotation", "verdict": "tampered", "placed": True}, True),
        ({"attack": "rotation", "verdict": "tampered", "placed": False}, False),
    ):
        assert claim.verdict([row | change]).holds is holds
    maps = {name: [[0.0, 5.0], [9.0, 0.0]] for name in ("lidar", "stereo", "mask")}
    assert experiment.figures is not None
    assert len(experiment.figures([row | maps])) == 1


def test_an_attack_is_seen_in_the_maps() -> None:
    pytest.importorskip("open3d")
    pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    cases = registry()["figure-7.12"].cases(QUICK)
    original, gone = (figure_7_12.locate(cases[place]) for place in (0, 2))
    assert cases[2].options["attack"] == "subtractive"
    assert original["verdict"] == "no_trace"
    assert gone["placed"]
    assert gone["type"] == "subtractive"
    assert original["stereo"] == gone["stereo"]
    assert original["lidar"] != gone["lidar"]


# --- Security -------------------------------------------------------------------------------------


def accepted(name: str, attempts: int = 4) -> Row:
    case = Case(security.attack, {"model": name, "attempts": attempts, "seed": 7})
    row = security.attack(case)
    assert row.keys() == {*security.DEFENCES, *(f"{name} tried" for name in security.DEFENCES)}
    return {**case.options, **row, "data": "simulated", "error": None}


@pytest.mark.parametrize("name", security.ATTACKS)
def test_the_keyed_watermark_accepts_no_forgery(name: str) -> None:
    row = accepted(name)
    for defence in ("keyed lbm", "keyed qim", "keyed detached"):
        assert row[f"{defence} tried"] > 0
        assert row[defence] == (row[f"{defence} tried"] if name == security.HARMLESS else 0)
    if name == security.REEMBEDDING:
        assert row["paper lbm"] == row["paper lbm tried"] == 4
    if name == "signed with another key":
        assert row["hmac tried"] == 4
        assert row["hmac"] == 0
        assert row["paper lbm"] is None  # it has no key
    if name in (security.HARMLESS, "one point moved"):
        assert row["hmac"] == 0
    if name in ("frame replayed", "frame dropped", "frames reordered"):
        assert row["hmac"] == row["hmac tried"]
    if name in ("record damaged", "record downgraded"):
        assert row["paper lbm"] is None
    claims = [claim.verdict([row]) for claim in security.EXPERIMENT.claims]
    assert all(finding.holds for claim in claims for finding in claim.findings)


def test_a_forgery_that_is_accepted_breaks_the_claim() -> None:
    row = accepted("one point moved", 2) | {"keyed qim": 1}
    (claim, *_) = security.EXPERIMENT.claims
    assert claim.verdict([row]).holds is False
    assert registry()["security"] is security.EXPERIMENT
    full = security.EXPERIMENT.cases(Plan("simulated", "full"))
    assert sum(case.options["attempts"] for case in full) * len(security.DEFENCES) >= 97_000


# --- Table 7.1 ------------------------------------------------------------------------------------


def test_steps_of_table_7_1_add_up_to_the_published_ones() -> None:
    cases = table_7_1.EXPERIMENT.cases(QUICK)
    assert registry()["table-7.1"] is table_7_1.EXPERIMENT
    assert len(cases) == 27
    rows = [
        table_7_1.EXPERIMENT.complete(
            {**case.options, "paper": 9.0, "keyed": 7.0, "data": "simulated", "error": None}
        )
        for case in cases
    ]
    published = {(row["model"], row["step"]): row["published"] for row in rows}
    assert published["drive 1", "ordering points"] == 61.8
    assert published["drive 2", "receive with QIM"] == 90.97
    assert published["drive 3", "LBM extraction and comparison"] == pytest.approx(47.25)
    faster, aim = (claim.verdict(rows) for claim in table_7_1.EXPERIMENT.claims)
    assert faster.holds is True
    assert aim.holds is False


@pytest.mark.parametrize("step", ["ordering points", "QIM embedding", "receive with LBM"])
def test_a_step_is_timed(step: str) -> None:
    frame = manip3d.LidarFrame(grid_scan(20_000), reflectances(20_000))
    row = table_7_1.time_frame(frame, step, 3)
    assert row["points"] == 20_000
    assert 0.0 < row["paper"] < 1000.0
    assert 0.0 < row["keyed"] < 1000.0
