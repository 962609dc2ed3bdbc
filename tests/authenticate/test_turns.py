"""Detector IV: what the turns before and after saw, and a frame does not show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lattice_scans as scans
import turn_scans
from manip3d import InputError, LidarFrame, authenticate, forge
from manip3d.authenticate import TurnResult, turn_consistency
from manip3d.report import write_evidence

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
    assert authenticate.generic_consistency(forged.points, calibration=LATTICE).verdict == (
        "no_trace"
    )


def test_box_that_was_put_before_the_wall_was_not_there(turns: list[np.ndarray]) -> None:
    hoax = turns[1][turn_scans.box_at(0, 0.0).contains(turns[1])]
    forged = forge.lattice_insert(turns[1], hoax, lattice=LATTICE, turn=-1.2)
    found = judged(turns, forged.points)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "before")
    assert np.isin(found.suspected, forged.moved).mean() > 0.9


def test_box_that_drives_by_is_no_edit() -> None:
    def at(x: float) -> tuple[tuple[tuple[float, ...], ...], ...]:
        return (*turn_scans.BOXES[1:], ((x, 4.0, -1.73), (x + 3.0, 6.0, 0.2)))

    moving = [
        turn_scans.turn(STEP * k, 20 + k, at(9.0 - 1.2 * k)) for k in (-1, 0, 1)
    ]  # fmt: skip
    assert judged(moving, moving[1]).verdict == "no_trace"


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


def report_page(found: authenticate.Inspection, folder: Path) -> str:
    pytest.importorskip("matplotlib")
    write_evidence(found, folder / "evidence.html")
    return (folder / "evidence.html").read_text()


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
    alone = authenticate.inspect(now, lattice=LATTICE)
    assert alone.turns is None
    cropped = now.replace(points=frame[np.abs(frame[:, 1]) < 5.0], exact=None, format=None)
    half = authenticate.inspect(cropped, previous=before, following=after, lattice=LATTICE)
    assert (half.verdict, half.turns) == ("processed", None)


def test_power_says_what_neighbours_add_for_white_box_edits(turns: list[np.ndarray]) -> None:
    frames = [LidarFrame(points, origin=(0, 0, 0)) for points in turns]
    alone = authenticate.measure_power(frames[1:2], LATTICE, planted=3, rng=1)
    assert set(alone) == {name for name in authenticate.EDITS if "reflectance" not in name}
    for name in ("white-box removed", "white-box added", "spoofed"):
        assert (alone[name].found, alone[name].planted) == (0, 3)
    beside = authenticate.measure_power(frames, LATTICE, planted=6, neighbours=True, rng=2)
    assert {power.planted for power in beside.values()} == {6}
    assert beside["removed"].found == 6
    assert beside["white-box removed"].found > 0
    assert beside["white-box added"].found > 0


def test_power_without_an_encoder_leaves_white_box_edits_out(turns: list[np.ndarray]) -> None:
    blind = authenticate.SensorLattice(**{**vars(LATTICE), "steps": 0})
    power = authenticate.measure_power([LidarFrame(turns[1])], blind, planted=1)
    assert "moved" in power
    assert "spoofed" not in power
