"""Detector IV: what the turns before and after saw, and a frame does not show."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lattice_scans as scans
import turn_scans
from manip3d import InputError, LidarFrame, _core, authenticate, forge, simulate
from manip3d.authenticate import TurnResult, _drives, turn_consistency
from manip3d.authenticate._extent import Lacking, left_out_of_turn
from manip3d.authenticate._inspect import inspect_beside
from manip3d.authenticate._movers import passes_by
from manip3d.io import read_scan
from manip3d.lidar import map_shift
from manip3d.report import write_evidence
from manip3d.report._evidence import _drawn_regions

LATTICE = turn_scans.LATTICE
STEP = 0.9


@pytest.fixture(scope="module")
def turns() -> list[np.ndarray]:
    """Three turns, 0.9 m apart."""
    return [turn_scans.turn(STEP * k, 10 + k) for k in (-1, 0, 1)]


def judged(turns: list[np.ndarray], frame: np.ndarray, threads: int = 1) -> TurnResult:
    return turn_consistency(frame, turns[0], turns[2], lattice=LATTICE, threads=threads)


def test_turns_are_aligned_and_a_clean_frame_is_not_accused(turns: list[np.ndarray]) -> None:
    found = judged(turns, turns[1])
    assert found.verdict == "no_trace"
    assert found.p_value > 0.01
    for motion, way in ((found.previous, -STEP), (found.following, STEP)):
        np.testing.assert_allclose(motion[:3, 3], (way, 0.0, 0.0), atol=0.02)
        np.testing.assert_allclose(motion[:3, :3], np.eye(3), atol=2e-3)


def test_a_place_on_a_map_is_the_same_in_turns_that_are_shifted_by_other_amounts(
    tmp_path: Path,
) -> None:
    """A scanner that stays; the turn before it was moved near 0 by 3 m less."""
    place = np.array([458_000.0, 5_429_000.0, 112.0])
    frames = []
    for number in range(3):
        np.save(tmp_path / "map.npy", turn_scans.turn(0.0, 10 + number) + place)
        frames.append(read_scan(tmp_path / "map.npy"))
    before, now, after = frames
    assert before.format is not None
    to_file = before.format.to_file.copy()
    to_file[0, 3] -= 3.0
    shifted = replace(before.format, to_file=to_file)
    before = before.replace(points=before.points + np.float32([3, 0, 0]), format=shifted)
    origin = place - map_shift(now)
    found = authenticate.inspect(
        now, previous=before, following=after, lattice=LATTICE, origin=origin
    )
    assert found.turns is not None
    for motion in (found.turns.previous, found.turns.following):
        np.testing.assert_allclose(motion[:3, 3], 0.0, atol=0.02)


def test_the_motion_of_a_scanner_that_turns_is_not_its_inverse(turns: list[np.ndarray]) -> None:
    angle = np.radians(2.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0],
                     [0.0, 0.0, 1.0]])  # fmt: skip
    beside = [np.float32(turns[0] @ turn.T), np.float32(turns[2] @ turn)]
    found = turn_consistency(turns[1], *beside, lattice=LATTICE)
    assert found.verdict == "no_trace"
    for motion, way, back in ((found.previous, -STEP, turn.T), (found.following, STEP, turn)):
        np.testing.assert_allclose(motion[:3, :3], back, atol=2e-3)
        np.testing.assert_allclose(motion[:3, 3], (way, 0.0, 0.0), atol=0.03)


@pytest.mark.parametrize(
    ("rate", "verdict"), [(20, "no_trace"), (10, "no_trace"), (5, "undecidable")]
)
def test_a_scanner_that_turns_slowly_is_not_judged_by_limits_of_fast_ones(
    rate: int, verdict: str
) -> None:
    """A car passes at 25 m/s: at 5 turns a second by more than its length from turn to turn."""
    frames = []
    for k in (-1, 0, 1):
        y = 25.0 * k / rate - 2.0
        car = ((9.1, y - 2.2, -1.73), (10.9, y + 2.2, -0.2))
        points = turn_scans.turn(0.0, 10 + k, (*turn_scans.BOXES, car))
        frames.append(LidarFrame(points, time_ns=1_000_000_000 * k // rate))
    found = turn_consistency(frames[1], frames[0], frames[2], lattice=LATTICE)
    assert found.verdict == verdict
    assert found.regions == ()
    if verdict == "undecidable":
        assert found.reason == "the turn before was taken 0.20 s apart, which is no turn"
        assert not found.aligned


def test_a_reading_that_is_given_changes_nothing(turns: list[np.ndarray]) -> None:
    """The turns are read in the frame's coordinates."""
    table = LATTICE.table
    told = [
        _core.compare_turns(turns[1], turns[0], turns[2], table, True, 1, reading)
        for reading in (None, LATTICE.read(turns[1]).columns)
    ]
    for found in told:
        rotation, shift = found["previous"]["rotation"], found["previous"]["translation"]
        moved = turns[0] @ rotation.T.astype(np.float32) + np.float32(shift.ravel())
        seen = LATTICE.read(np.ascontiguousarray(moved))
        assert np.mean(seen.ring == found["seen"][0][0]) > 0.999
        apart = np.abs(seen.azimuth - found["seen"][0][2])
        assert np.mean(np.minimum(apart, 2.0 * np.pi - apart) < 1e-4) > 0.999
    assert repr(told[0]["regions"]) == repr(told[1]["regions"])
    with pytest.raises(InputError, match="reading: expected that of"):
        _core.compare_turns(
            turns[1], turns[0], turns[2], table, True, 1, LATTICE.read(turns[0]).columns
        )


@pytest.mark.parametrize("number", [0, 1, 2])
def test_deleted_box_is_found_where_it_stood(turns: list[np.ndarray], number: int) -> None:
    box = turn_scans.box_at(number, 0.0)
    inside = box.contains(turns[1])
    assert inside.sum() > 300
    found = judged(turns, turns[1][~inside])
    assert (found.verdict, found.regions[0].kind) == ("tampered", "lost")
    assert found.p_value <= 0.01
    assert np.abs(np.subtract(found.regions[0].box.center[:2], box.center[:2])).max() < 1.5
    assert box.contains(found.regions[0].stood).mean() > 0.9
    assert len(found.suspected) == 0


def test_box_that_is_overwritten_by_its_background_is_looked_through(
    turns: list[np.ndarray],
) -> None:
    forged = forge.lattice_remove(turns[1], turn_scans.box_at(0, 0.0), lattice=LATTICE)
    found = judged(turns, forged.points)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "through")
    assert np.isin(found.suspected, forged.moved).mean() > 0.9
    assert authenticate.generic_consistency(forged.points, lattice=LATTICE).verdict == ("no_trace")


def test_box_that_was_put_before_the_wall_was_not_there(turns: list[np.ndarray]) -> None:
    hoax = turns[1][turn_scans.box_at(0, 0.0).contains(turns[1])]
    forged = forge.lattice_insert(turns[1], hoax, lattice=LATTICE, turn=-1.2)
    found = judged(turns, forged.points)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "before")
    assert np.isin(found.suspected, forged.moved).mean() > 0.9


def test_what_stands_beside_the_road_alone_tells_the_motion() -> None:
    """Motion that is found from a first guess only: two metres from turn to turn, no wall ahead."""

    def beside(points: np.ndarray) -> np.ndarray:
        stands = points[:, 2] > -1.3
        return points[~stands | (np.abs(points[:, 1]) > np.abs(points[:, 0]))]

    before, now, after = (beside(turn_scans.turn(2.0 * k, 10 + k)) for k in (-1, 0, 1))
    found = turn_consistency(now, before, after, lattice=LATTICE)
    np.testing.assert_allclose(found.previous[:3, 3], (-2.0, 0.0, 0.0), atol=0.02)
    np.testing.assert_allclose(found.following[:3, 3], (2.0, 0.0, 0.0), atol=0.02)


def test_box_that_drives_by_is_no_edit() -> None:
    def at(x: float) -> tuple[tuple[tuple[float, ...], ...], ...]:
        return (*turn_scans.BOXES[1:], ((x, 4.0, -1.73), (x + 3.0, 6.0, 0.2)))

    moving = [
        turn_scans.turn(STEP * k, 20 + k, at(9.0 - 1.2 * k)) for k in (-1, 0, 1)
    ]  # fmt: skip
    assert judged(moving, moving[1]).verdict == "no_trace"


def test_rows_without_a_return_do_not_move_with_the_turns(turns: list[np.ndarray]) -> None:
    """Organised clouds have rows at (0, 0, 0), which are no points near the scanner."""
    silent = np.zeros((50, 3), np.float32)
    before, after = (np.vstack([points, silent]) for points in (turns[0], turns[2]))
    found = _core.compare_turns(turns[1], before, after, LATTICE.table, True, 1, None)
    for seen in found["seen"]:
        assert np.all(seen[0][-len(silent) :] == -1)
    plain = _core.compare_turns(turns[1], turns[0], turns[2], LATTICE.table, True, 1, None)
    assert repr(found["regions"]) == repr(plain["regions"])


def test_turns_that_tell_no_motion_are_not_moved(turns: list[np.ndarray]) -> None:
    found = turn_consistency(turns[1], np.empty((0, 3)), turns[1][:50], lattice=LATTICE)
    np.testing.assert_array_equal(found.previous, np.eye(4))
    np.testing.assert_array_equal(found.following, np.eye(4))


def test_threads_change_nothing(turns: list[np.ndarray]) -> None:
    frame = turns[1][~turn_scans.box_at(0, 0.0).contains(turns[1])]
    one, four = judged(turns, frame), judged(turns, frame, threads=4)
    assert one.score == four.score
    assert np.array_equal(one.previous, four.previous)
    assert np.array_equal(one.regions[0].stood, four.regions[0].stood)


@pytest.mark.parametrize("n", [0, 1, 500])
def test_turns_that_say_nothing_are_undecidable(turns: list[np.ndarray], n: int) -> None:
    random = np.random.default_rng(n).normal(size=(n, 3)).astype(np.float32)
    for triple in ((random, turns[1], turns[2]), (turns[0], random, turns[2])):
        found = turn_consistency(triple[1], triple[0], triple[2], lattice=LATTICE)
        assert (found.verdict, found.regions, found.p_value) == ("undecidable", (), 1.0)


def test_turns_of_another_place_are_undecidable(turns: list[np.ndarray]) -> None:
    elsewhere = turn_scans.turn(12.0, 5)
    found = turn_consistency(turns[1], turns[0], elsewhere, lattice=LATTICE)
    assert found.verdict == "undecidable"
    assert not found.foreign


def test_a_frame_of_another_place_is_foreign(turns: list[np.ndarray]) -> None:
    elsewhere = turn_scans.turn(12.0, 5)
    told = turn_consistency(elsewhere, turns[0], turns[2], lattice=LATTICE)
    assert (told.verdict, told.foreign, told.aligned) == ("undecidable", True, False)
    far = [with_far_point(points) for points in (turns[0], elsewhere, turns[2])]
    before, put_in, after = (LidarFrame(points, origin=(0, 0, 0)) for points in far)
    found = authenticate.inspect(put_in, previous=before, following=after, lattice=LATTICE)
    assert (found.verdict, found.processing[-1].kind) == ("processed", "foreign")
    assert judged(turns, turns[1]).foreign is False
    drive = authenticate.judge_drive([found])
    assert drive.verdict == "processed"
    assert "foreign: number 0 shows another place than the scans before and after" in drive.reason
    assert [remark.kind for remark in drive.remarks] == ["foreign"]


def test_what_is_wrong_is_named(turns: list[np.ndarray]) -> None:
    bad = turns[0].copy()
    bad[7, 1] = np.nan
    with pytest.raises(InputError, match="row 7"):
        turn_consistency(turns[1], bad, turns[2], lattice=LATTICE)
    with pytest.raises(InputError, match="following"):
        turn_consistency(turns[1], turns[0], turns[2][:, :2], lattice=LATTICE)
    with pytest.raises(InputError, match="false_alarm_rate"):
        turn_consistency(turns[1], turns[0], turns[2], lattice=LATTICE, false_alarm_rate=1.0)


def with_far_point(points: np.ndarray) -> np.ndarray:
    """The frame with a return from afar, as whole frames have: else it would count as cropped."""
    reading = LATTICE.read(points)
    row = np.flatnonzero(reading.ring == 0)[100:101]
    points[row] = scans.rounded(
        scans.beam_points(LATTICE, reading.ring[row], reading.count[row], np.full(1, 79.0))
    )
    return points


def on_its_car(points: np.ndarray) -> np.ndarray:
    """A whole frame, with returns from afar and from the car that carries the scanner."""
    whole = with_far_point(points.copy())
    reading = LATTICE.read(whole)
    row = np.flatnonzero(reading.ring == 60)[:1]
    near = scans.beam_points(LATTICE, reading.ring[row], reading.count[row], np.full(1, 1.8))
    whole[row] = scans.rounded(near)
    return whole[scans.in_file_order(LATTICE, whole)]


def report_page(found: authenticate.Inspection, folder: Path) -> str:
    pytest.importorskip("matplotlib")
    write_evidence(found, folder / "evidence.html")
    return (folder / "evidence.html").read_text()


def test_all_accusing_detectors_are_named_and_drawn(
    turns: list[np.ndarray], tmp_path: Path
) -> None:
    """An object that was moved is off the lattice, and is missing where the turns saw it."""
    frame = with_far_point(turns[1].copy())
    moved = turn_scans.box_at(0, 0.0).contains(frame)
    frame[moved] = scans.rounded(frame[moved] + np.float64([0.0, 1.7, 0.0]))
    found = authenticate.inspect(frame, previous=turns[0], following=turns[2], lattice=LATTICE)
    assert [report.name for report in found.all_accusing] == ["generic", "turns"]
    assert found.accusing is found.all_accusing[0]
    assert found.reason.startswith("detector III: points lie where the sensor cannot measure")
    assert "; detector IV: points lie behind a thing that the turns" in found.reason
    drawn = {each.report.name for each in _drawn_regions(found)}
    assert drawn == {"generic", "turns"}
    page = report_page(found, tmp_path)
    assert "Regions of the accusing detectors: suspected points in orange, what" in page
    assert "0.002 stands for all smaller ones" in page
    assert found.model_p_value is not None
    assert found.model_p_value < 1e-6 < found.detectors[2].p_value


@pytest.mark.parametrize("lacking", [[63], [61, 62, 63], [20], [0, 1]])
@pytest.mark.parametrize("is_whole_drive", [True, False])
def test_what_was_removed_is_missed_in_the_lasers_that_a_file_has(
    turns: list[np.ndarray], lacking: list[int], is_whole_drive: bool
) -> None:
    def less(points: np.ndarray) -> np.ndarray:
        return points[~np.isin(LATTICE.read(points).ring, lacking)]

    before, now, after = map(on_its_car, turns)
    if is_whole_drive:
        before, after = less(before), less(after)
    judge = functools.partial(
        authenticate.inspect, previous=before, following=after, lattice=LATTICE
    )
    clean = judge(less(now))
    assert [step.kind for step in clean.processing] == ["lasers"]
    assert clean.verdict == "processed"
    assert clean.turns is not None
    assert clean.turns.verdict == "no_trace"
    found = judge(less(now[~turn_scans.box_at(0, 0.0).contains(now)]))
    assert found.verdict == "tampered"
    assert found.accusing is not None
    assert found.accusing.name == "turns"
    box = turn_scans.box_at(0, 0.0)
    assert np.abs(np.subtract(found.regions[0].box.center[:2], box.center[:2])).max() < 1.5


@pytest.mark.parametrize("lacking", [[30, 31], [30, 31, 32]])
def test_lasers_that_a_frame_lacks_are_no_holes_in_it(
    turns: list[np.ndarray], lacking: list[int]
) -> None:
    """Lasers beside each other would miss all that the turns saw, from wall to wall."""
    ring = LATTICE.read(turns[1]).ring
    found = judged(turns, turns[1][~np.isin(ring, lacking)])
    assert (found.verdict, found.regions) == ("no_trace", ())
    assert found.score < 0.5
    removed = ~np.isin(ring, lacking) & ~turn_scans.box_at(0, 0.0).contains(turns[1])
    assert judged(turns, turns[1][removed]).verdict == "tampered"


def test_inspect_asks_the_turns(turns: list[np.ndarray], tmp_path: Path) -> None:
    frame = with_far_point(turns[1][~turn_scans.box_at(0, 0.0).contains(turns[1])])
    before, now, after = (LidarFrame(p, origin=(0, 0, 0)) for p in (turns[0], frame, turns[2]))
    found = authenticate.inspect(now, previous=before, following=after, lattice=LATTICE)
    assert [report.name for report in found.detectors][-1] == "turns"
    assert found.turns is not None
    report = found.detectors[-1]
    assert report.verdict == found.turns.verdict
    assert report.calibration is not None
    assert report.calibration.num_scans > 500
    assert report_page(found, tmp_path).count("what the turn before saw there in blue") >= 1
    assert found.power["white-box added"].share > 0.5
    assert not any("white-box" in name for name in found.blind)
    alone = authenticate.inspect(now, lattice=LATTICE)
    assert any("white-box" in name for name in alone.blind)
    assert alone.turns is None
    cropped = now.replace(points=frame[np.abs(frame[:, 1]) < 5.0], exact=None, format=None)
    half = authenticate.inspect(cropped, previous=before, following=after, lattice=LATTICE)
    assert (half.verdict, half.turns) == ("processed", None)


def cut_in_ways(turn: np.ndarray) -> Iterator[np.ndarray]:
    """A turn of which something was left out, as users and forgers do; box 0 is still seen.

    Ways that tell it whole or rounded alternate.
    """
    for kept in (
        np.abs(turn[:, 1]) < 6.5,
        turn[:, 0] > 0.0,
        np.arange(len(turn)) % 2 == 0,
        np.hypot(turn[:, 0], turn[:, 1]) < 25.0,
    ):
        yield turn[kept]
        yield np.float32(np.round(turn[kept].astype(np.float64), 2))
    yield np.float32(np.round(turn.astype(np.float64), 2))


def beside_cut_turns(
    frame: np.ndarray, turns: list[np.ndarray], cut: str
) -> Iterator[authenticate.Inspection]:
    """The frame inspected between turns of which one was cut, or both."""
    before, after = with_far_point(turns[0].copy()), with_far_point(turns[2].copy())
    ways = list(zip(cut_in_ways(before), cut_in_ways(after), strict=True))
    # All ways of both; of each alone every second one, which are others for one and the other.
    chosen = {"before": ways[::2], "after": ways[1::2], "both": ways}
    for lacking in chosen[cut]:
        yield authenticate.inspect(
            frame,
            previous=before if cut == "after" else lacking[0],
            following=after if cut == "before" else lacking[1],
            lattice=LATTICE,
        )


@pytest.mark.parametrize("cut", ["before", "after", "both"])
def test_a_turn_that_was_cut_accuses_nobody(turns: list[np.ndarray], cut: str) -> None:
    """Cut off there, a thing seems to have come anew, or to be looked through."""
    for found in beside_cut_turns(with_far_point(turns[1].copy()), turns, cut):
        assert found.verdict == "processed"
        steps = [step.detail for step in found.processing if step.kind == "neighbours"]
        names = ["before", "after"] if cut == "both" else [cut]
        assert [step.split(" was ")[0] for step in steps] == [f"the turn {name}" for name in names]
        report = next(report for report in found.detectors if report.name == "turns")
        assert (report.verdict, dict(report.power)) == ("undecidable", {})
        assert report.reason == "; ".join(steps)


def test_turns_whose_points_were_moved_accuse_nobody_and_clear_nobody(
    turns: list[np.ndarray],
) -> None:
    frame = turns[1][~turn_scans.box_at(0, 0.0).contains(turns[1])]
    for share in (1.0, 1.08):  # a scale shifts what stands far away by more than turns may differ
        found = authenticate.inspect(
            frame,
            previous=np.float32(turns[0] * share),
            following=np.float32(turns[2] * share),
            lattice=LATTICE,
        )
        report = next(report for report in found.detectors if report.name == "turns")
        assert report.verdict == ("tampered" if share == 1.0 else "undecidable")
    assert [step.kind for step in found.processing].count("neighbours") == 2
    assert report.reason == (
        "the turn before was moved to where the scanner does not measure; "
        "the turn after was moved to where the scanner does not measure"
    )


@pytest.mark.parametrize("cut", ["before", "after", "both"])
def test_turns_that_were_cut_do_not_hide_what_was_deleted(
    turns: list[np.ndarray], cut: str
) -> None:
    box = turn_scans.box_at(0, 0.0)
    frame = with_far_point(turns[1][~box.contains(turns[1])])
    for found in beside_cut_turns(frame, turns, cut):
        assert "turns" in [report.name for report in found.all_accusing]
        assert np.abs(np.subtract(found.regions[0].box.center[:2], box.center[:2])).max() < 1.5


@functools.cache
def on_a_street() -> LidarFrame:
    return simulate.hdl64e(simulate.street(rng=0), 1.0, rng=0).frame


@pytest.mark.parametrize(("cut", "whole_up_to_m"), [
    (lambda points: np.linalg.norm(points, axis=1) < 30.0, 30.0),
    (lambda points: np.abs(points[:, :2]).max(axis=1) < 35.0, 35.0),
    (lambda points: points[:, 0] > 0.0, 0.0),
    (lambda points: (np.linalg.norm(points, axis=1) < 30.0) & (points[:, 0] > 0.0), 0.0),
])  # fmt: skip
def test_a_turn_tells_how_far_it_is_whole(
    cut: Callable[[np.ndarray], np.ndarray], whole_up_to_m: float
) -> None:
    turn = on_a_street()
    rows = np.flatnonzero(cut(turn.points))
    lacking = left_out_of_turn(turn.select(rows), authenticate.kitti_lattice())
    assert lacking is not None
    assert lacking.whole_up_to_m == pytest.approx(whole_up_to_m, abs=1.5)


@pytest.mark.parametrize(("whole_up_to_m", "kinds"), [(30.0, []), (20.0, ["neighbours"] * 2)])
def test_turns_that_were_cut_beyond_what_is_compared_do_not_mark_a_scan(
    turns: list[np.ndarray], whole_up_to_m: float, kinds: list[str]
) -> None:
    before, now, after = map(with_far_point, turns)
    found = inspect_beside(
        now, lambda turn, lattice: Lacking("cropped: far away", True, whole_up_to_m),
        previous=before, following=after, lattice=LATTICE, sensor="auto", origin=None,
        watermark=None, key=None, power=False, printed=False, threads=1,
    )  # fmt: skip
    assert [step.kind for step in found.processing if step.kind == "neighbours"] == kinds


@pytest.mark.parametrize("threads", [1, 2])
def test_a_drive_looks_closer_at_turns_beside_one_that_was_cut(
    turns: list[np.ndarray], monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """Turns beside one whose own inspection shows a cut are examined; whole drives cost nothing."""
    more = [turn_scans.turn(STEP * k, 10 + k) for k in (2, 3)]
    drive = [LidarFrame(on_its_car(turn), origin=(0, 0, 0)) for turn in (*turns, *more)]
    asked = []

    def left_out(turn: LidarFrame, lattice: authenticate.SensorLattice) -> Lacking | None:
        asked.append(turn)
        return left_out_of_turn(turn, lattice)

    def judged_drive() -> list[authenticate.Inspection]:
        found = list(authenticate.inspect_drive(drive, lattice=LATTICE, threads=threads))
        return [each for each in found if each is not None]

    monkeypatch.setattr(_drives, "left_out_of_turn", left_out)
    assert [each.verdict for each in judged_drive()] == ["no_trace"] * 5
    assert not asked
    box = turn_scans.box_at(0, 0.0)
    drive[1] = drive[1].select(np.flatnonzero(~box.contains(drive[1].points)))
    drive[2] = drive[2].select(np.flatnonzero(np.abs(drive[2].points[:, 1]) < 6.5))
    found = judged_drive()
    assert len(asked) == 4
    assert [each.verdict for each in found[1:4]] == ["tampered", "processed", "processed"]
    assert {step.kind for step in found[3].processing} == {"neighbours"}
    for k in (1, 3):
        alone = authenticate.inspect(
            drive[k], previous=drive[k - 1], following=drive[k + 1], lattice=LATTICE
        )
        assert alone.record() == found[k].record()


def test_power_says_what_neighbours_add_for_white_box_edits(turns: list[np.ndarray]) -> None:
    frames = [LidarFrame(points, origin=(0, 0, 0)) for points in turns]
    measured = authenticate.measure_power(frames[1:2], LATTICE, planted=1, rng=1)
    expected = {name for name in authenticate.EDITS if "reflectance" not in name}
    assert set(measured) == {name for name in expected if "on steps" not in name}  # exact clouds
    hidden = ("white-box removed", "white-box added", "spoofed")
    alone = authenticate.measure_power(frames[1:2], LATTICE, planted=3, classes=hidden, rng=1)
    assert set(alone) == set(hidden)
    for power in alone.values():
        assert (power.found, power.planted) == (0, 3)
    classes = ("removed", "white-box removed", "white-box added")
    beside = authenticate.measure_power(
        frames, LATTICE, planted=6, classes=classes, neighbours=True, rng=2
    )
    assert set(beside) == set(classes)
    assert {power.planted for power in beside.values()} == {6}
    assert beside["removed"].found == 6
    assert beside["white-box removed"].found > 0
    assert beside["white-box added"].found > 0


def among_walls(opening: float) -> LidarFrame:
    """A wall 4 m away, with a view of one 12 m away ahead, and of one 40 m away to the left.

    The view to the left is ``opening`` radians wide.
    """
    ring, count = np.divmod(np.arange(64 * 2000), 2000)
    azimuth = count * (2.0 * np.pi / 2000)  # every second step of the encoder
    ahead = np.minimum(azimuth, 2.0 * np.pi - azimuth) < 0.15
    left = np.abs(azimuth - np.pi / 2.0) < opening / 2.0
    distance = np.select([ahead, left], [12.0, 40.0], 4.0) + LATTICE.range_phase[ring]
    points = LATTICE.points_at(ring, 2 * count, distance).round(3)
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2.0 * np.pi)
    return LidarFrame(points[np.lexsort((azimuth, ring))].astype(np.float32), origin=(0, 0, 0))


@pytest.mark.parametrize("name", ["white-box added", "spoofed"])
def test_power_counts_only_edits_that_change_the_scan(name: str) -> None:
    """The object ahead is planted where it can be seen, and not counted where it never can."""
    views = {"wide": among_walls(2.0), "none": among_walls(0.0)}
    power = {
        view: authenticate.measure_power([scan], LATTICE, planted=2, classes=[name], rng=3)
        for view, scan in views.items()
    }
    assert power["wide"][name].planted == 2
    assert power["none"] == {}


def test_power_counts_only_white_box_edits_of_as_many_points_as_an_object_has() -> None:
    """Through a gap between walls only a part of the object would be seen."""
    classes = ["white-box added"]
    for opening, planted in ((0.03, 0), (1.0, 2)):
        power = authenticate.measure_power(
            [among_walls(opening)], LATTICE, planted=2, classes=classes, rng=1
        )
        assert sum(each.planted for each in power.values()) == planted


def test_power_counts_no_reflectances_that_stay_what_they_were(turns: list[np.ndarray]) -> None:
    black = np.zeros(len(turns[1]), np.float32)
    black[:40] = np.linspace(0.1, 0.9, 40)  # a frame of one reflectance is not judged
    frame = LidarFrame(turns[1], black, origin=(0, 0, 0))
    classes = ["reflectance: scaled", "reflectance: one value"]
    power = authenticate.measure_power([frame], LATTICE, planted=1, classes=classes, rng=1)
    assert set(power) == {"reflectance: one value"}


def test_power_without_an_encoder_leaves_white_box_edits_out(turns: list[np.ndarray]) -> None:
    blind = authenticate.SensorLattice(**{**vars(LATTICE), "steps": 0})
    power = authenticate.measure_power([LidarFrame(turns[1])], blind, planted=1)
    assert "moved" in power
    assert "spoofed" not in power


def test_turns_that_are_missing_are_told_by_the_way_between_them() -> None:
    for step, verdict in ((1.3, "no_trace"), (1.8, "undecidable")):
        apart = [turn_scans.turn(step * k, 30 + k) for k in (-1, 0, 1)]
        found = judged(apart, apart[1])
        assert found.verdict == verdict
    assert found.reason.startswith("the scanner moved 1.8 m between two turns")


def test_what_passes_by_faster_than_its_length_is_no_edit(monkeypatch: pytest.MonkeyPatch) -> None:
    def at(x: float) -> tuple[tuple[tuple[float, ...], ...], ...]:
        return (*turn_scans.BOXES[1:], ((x, 4.0, -1.73), (x + 1.5, 5.0, 0.3)))

    quick = [turn_scans.turn(0.3 * k, 20 + k, at(5.0 - 2.5 * k)) for k in (-1, 0, 1)]
    assert judged(quick, quick[1]).verdict == "no_trace"
    monkeypatch.setattr("manip3d.authenticate._turns.passes_by", lambda *_: False)
    assert judged(quick, quick[1]).regions[0].kind == "before"


def test_what_stands_as_far_behind_as_beyond_passes_by() -> None:
    def things(*places: tuple[float, float]) -> np.ndarray:
        thing = np.random.default_rng(0).uniform((0, 0, 0), (0.8, 0.4, 1.5), (300, 3))
        wall = np.random.default_rng(1).uniform((-9, 3, 0), (9, 3.1, 2), (3000, 3))
        return np.concatenate([wall, *(thing + np.array([*place, 0.0]) for place in places)])

    here = things((0.0, 0.0))[3000:]
    for before, after, passes in (
        (things((-1.5, 0.5)), things((1.5, -0.5)), True),
        (things((-1.5, 0.0)), things((1.75, 0.0)), True),  # it drives faster
        (things((-1.5, 0.0)), things((1.5, 1.5)), False),
        (things((-1.5, 0.0)), things((-3.0, 0.0)), False),
        (things((-1.5, 0.0)), things(), False),
        (things(), things(), False),
        (things((5.0, 0.0)), things((-5.0, 0.0)), False),  # 180 km/h
        (things((-1.5, 0.0), (1.5, 0.0)), things((-1.5, 0.0), (1.5, 0.0)), False),  # both stand
    ):
        assert passes_by(here, before, after) == passes
    assert not passes_by(here[:0], here, here)


def test_frames_that_are_no_turn_apart_are_no_neighbours(turns: list[np.ndarray]) -> None:
    forged = forge.lattice_remove(turns[1], turn_scans.box_at(0, 0.0), lattice=LATTICE).points
    before, frame, after = (
        LidarFrame(points, time_ns=10**8 * k)
        for k, points in enumerate((turns[0], forged, turns[2]))
    )
    judge = functools.partial(authenticate.inspect, lattice=LATTICE, threads=1)
    assert judge(frame, previous=before, following=after).accusing is not None
    late = after.replace(time_ns=4 * 10**8)
    found = judge(frame, previous=before, following=late)
    assert found.verdict == "no_trace"
    said = next(report for report in found.detectors if report.name == "turns")
    assert (said.verdict, said.score, dict(said.power)) == ("undecidable", None, {})
    assert said.reason == "the turn after was taken 0.30 s apart, which is no turn"


def test_a_turn_that_was_written_twice_is_repeated(turns: list[np.ndarray]) -> None:
    judge = functools.partial(authenticate.inspect, lattice=LATTICE, threads=1)
    before, frame, after = (LidarFrame(points) for points in turns)
    for beside, words in (
        ((frame, frame), "the turn before has the same points; repeated: the turn after has"),
        ((frame, after), "the turn before has the same points"),
        ((before, before), "the turns before and after have the same points"),
    ):
        found = judge(frame, previous=beside[0], following=beside[1])
        assert found.verdict == "processed"
        assert found.reason.startswith(f"repeated: {words}")
    assert judge(frame, previous=before, following=after).verdict == "no_trace"
