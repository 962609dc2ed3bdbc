"""Detector V: reflectances that were rewritten, found alone and beside the turns around them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lattice_scans as scans
import turn_scans
from manip3d import InputError, LidarFrame, _core, authenticate, forge
from manip3d.authenticate import ReflectanceResult, TurnResult, reflectance_consistency
from manip3d.authenticate._reflectance import (
    TAIL,
    TAIL_FRAMES,
    _between_steps,
    _is_off,
    _shifted_as_a_whole,
    is_in_hundredths,
    reflectance_p_value,
    why_not_judged,
    why_of_no_scene,
    why_of_other_points,
    why_rewritten,
)
from manip3d.report import write_evidence

LATTICE = turn_scans.LATTICE
STEP = 0.9
GAIN = np.random.default_rng(7).normal(0.0, 0.06, len(LATTICE.slope))
"""By how much lasers are brighter than one another."""
KERB = 40
"""A laser that looks at the ground near by."""


def shining(points: np.ndarray, position: float, seed: int) -> LidarFrame:
    """Points of a scanner at (position, 0) with reflectances in hundredths: of patches of the
    world, with shot noise and the gains of the lasers."""
    x, y = points[:, 0].astype(np.float64) + position, points[:, 1].astype(np.float64)
    number = np.floor((x + 1.4) / 4.0) + np.floor((y + 1.4) / 4.0)  # no edge lies on a face
    patch = 0.3 + 0.1 * np.mod(number, 3.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.04, len(points))
    value = patch + GAIN[LATTICE.read(points).ring] + noise
    hundredths = np.clip(np.round(value * 100.0), 0.0, 99.0)
    return LidarFrame(points, (hundredths / 100.0).astype(np.float32), origin=(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def turns() -> list[LidarFrame]:
    """Three turns, 0.9 m apart."""
    return [shining(turn_scans.turn(STEP * k, 10 + k), STEP * k, 20 + k) for k in (-1, 0, 1)]


@pytest.fixture(scope="module")
def aligned(turns: list[LidarFrame]) -> TurnResult:
    return authenticate.turn_consistency(turns[1], turns[0], turns[2], lattice=LATTICE)


def judged(
    turns: list[LidarFrame], aligned: TurnResult | None, values: np.ndarray, threads: int = 1
) -> ReflectanceResult:
    frame = turns[1].replace(intensity=values.astype(np.float32))
    if aligned is None:
        return reflectance_consistency(frame, lattice=LATTICE, threads=threads)
    return reflectance_consistency(
        frame, lattice=LATTICE, previous=turns[0], following=turns[2], turns=aligned,
        threads=threads,
    )  # fmt: skip


def of_box(turns: list[LidarFrame]) -> tuple[np.ndarray, np.ndarray]:
    """The frame's reflectances, and rows of the first box."""
    assert turns[1].intensity is not None
    return turns[1].intensity.copy(), turn_scans.box_at(0, 0.0).contains(turns[1].points)


def test_a_clean_frame_is_not_accused(turns: list[LidarFrame], aligned: TurnResult) -> None:
    values, _ = of_box(turns)
    for beside in (None, aligned):
        found = judged(turns, beside, values)
        assert (found.verdict, found.with_turns) == ("no_trace", beside is not None)
        assert found.p_value > 0.01
        assert len(found.suspected) == 0


@pytest.mark.parametrize("edit", ["darker", "brighter", "scaled"])
def test_changed_reflectances_are_found_beside_the_turns(
    turns: list[LidarFrame], aligned: TurnResult, edit: str
) -> None:
    values, box = of_box(turns)
    change = {"darker": lambda v: v - 0.2, "brighter": lambda v: v + 0.2, "scaled": lambda v: v * 2}
    values[box] = np.clip(np.round(change[edit](values[box]) * 100.0), 0.0, 99.0) / 100.0
    assert judged(turns, None, values).verdict == "no_trace"  # alone, it is a bright box
    found = judged(turns, aligned, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "changed")
    assert box[found.suspected].mean() > 0.7
    center = turn_scans.box_at(0, 0.0).center
    assert np.abs(np.subtract(found.regions[0].box.center, center)).max() < 1.5


def test_a_shift_within_the_noise_is_found_by_its_mean(
    turns: list[LidarFrame], aligned: TurnResult
) -> None:
    """Noise of 0.04 hides a shift of 0.06 from the energies of single points."""
    values, box = of_box(turns)
    values[box] = np.round(np.clip(values[box] - 0.06, 0.0, 0.99), 2)
    found = judged(turns, aligned, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "changed")
    assert box[found.suspected].mean() > 0.9


def test_a_dark_thing_that_shines_is_found(turns: list[LidarFrame], aligned: TurnResult) -> None:
    """Its returns are 0 in both turns beside the frame; in all three they say nothing."""
    dark = [
        turn.replace(intensity=np.where(
            turn_scans.box_at(0, STEP * k).contains(turn.points), np.float32(0), turn.intensity
        ))
        for k, turn in zip((-1, 0, 1), turns, strict=True)
    ]  # fmt: skip
    values, box = of_box(dark)
    assert not values[box].any()
    assert judged(dark, aligned, values).verdict == "no_trace"
    shine = np.random.default_rng(3).normal(0.15, 0.04, int(box.sum()))
    values[box] = np.round(np.clip(shine, 0.0, 0.99), 2)
    found = judged(dark, aligned, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "changed")
    assert box[found.suspected].mean() > 0.9


def test_a_thing_that_goes_dark_is_found_by_its_dark_returns(
    turns: list[LidarFrame], aligned: TurnResult
) -> None:
    values, box = of_box(turns)
    values[box] = 0.0
    found = judged(turns, aligned, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "changed")
    assert np.isin(np.flatnonzero(box), found.suspected).mean() > 0.7


@pytest.mark.parametrize("change", [lambda v: v + 0.06, lambda v: v**0.8])
def test_a_frame_that_was_brightened_as_a_whole_is_processed(
    turns: list[LidarFrame], change: Callable[[np.ndarray], np.ndarray]
) -> None:
    """It differs from both turns everywhere, at no place in particular."""
    values, _ = of_box(turns)
    brighter = np.round(np.clip(change(values), 0.0, 0.99), 2).astype(np.float32)
    edited = turns[1].replace(intensity=brighter)
    beside = {"previous": turns[0], "following": turns[2]}
    found = reflectance_consistency(edited, lattice=LATTICE, **beside)
    assert (found.verdict, found.with_turns) == ("undecidable", False)
    assert found.rewritten.startswith("reflectances differ as a whole")
    assert found.reason == found.rewritten
    result = authenticate.inspect(edited, lattice=LATTICE, power=False, **beside)
    assert result.verdict == "processed"
    assert "reflectances" in [step.kind for step in result.processing]
    # One turn alone that was brightened says nothing of the frame.
    for before, after in ((edited, turns[2]), (turns[0], edited)):
        other = reflectance_consistency(turns[1], lattice=LATTICE, previous=before, following=after)
        assert (other.verdict, other.rewritten) == ("no_trace", "")


def test_a_shift_that_lifts_dark_returns_is_named(turns: list[LidarFrame]) -> None:
    """Two fifths of the returns are dark: above 0, they stood among the others' lowest levels."""
    dark = [np.arange(turn.num_points) % 5 < 2 for turn in turns]
    dimmed = [
        turn.replace(intensity=np.where(at, np.float32(0.0), turn.intensity))
        for turn, at in zip(turns, dark, strict=True)
    ]
    assert dimmed[1].intensity is not None
    lifted = np.clip(np.round(dimmed[1].intensity + 0.02, 2), 0.0, 0.99).astype(np.float32)
    beside = dimmed[0], dimmed[2]
    assert _shifted_as_a_whole(dimmed[1], *beside) == ""
    said = _shifted_as_a_whole(dimmed[1].replace(intensity=lifted), *beside)
    assert said.startswith("reflectances differ as a whole")


def test_rows_of_a_result_can_be_those_of_a_whole_scan(
    turns: list[LidarFrame], aligned: TurnResult
) -> None:
    values, box = of_box(turns)
    values[box] = np.clip(values[box] + 0.2, 0.0, 0.99)
    found = judged(turns, aligned, values)
    rows = np.arange(len(values)) + 1000
    moved = found.with_rows(rows)
    assert isinstance(moved, ReflectanceResult)
    assert np.array_equal(moved.suspected, found.suspected + 1000)
    assert np.array_equal(moved.regions[0].rows, found.regions[0].rows + 1000)
    assert (moved.verdict, moved.calibration) == (found.verdict, found.calibration)
    assert isinstance(aligned.with_rows(rows), TurnResult)


def test_changed_reflectances_are_found_by_a_scanner_that_turns(turns: list[LidarFrame]) -> None:
    """Two degrees are a third of a metre at 10 m: turns that are moved by the inverse show other
    surfaces, and a clean frame more than its noise."""
    angle = np.radians(2.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0],
                     [0.0, 0.0, 1.0]])  # fmt: skip
    before, after = (
        each.replace(points=np.ascontiguousarray(each.points @ way, np.float32))
        for each, way in ((turns[0], turn.T), (turns[2], turn))
    )
    values, box = of_box(turns)
    clean = reflectance_consistency(turns[1], lattice=LATTICE, previous=before, following=after)
    straight = reflectance_consistency(
        turns[1], lattice=LATTICE, previous=turns[0], following=turns[2]
    )
    assert clean.score < straight.score + 0.1
    values[box] = np.clip(np.round((values[box] - 0.2) * 100.0), 0.0, 99.0) / 100.0
    found = reflectance_consistency(
        turns[1].replace(intensity=values.astype(np.float32)), lattice=LATTICE, previous=before,
        following=after,
    )  # fmt: skip
    assert (found.verdict, found.regions[0].kind) == ("tampered", "changed")
    assert box[found.suspected].mean() > 0.7


def test_turns_that_were_read_are_not_read_again(
    turns: list[LidarFrame], aligned: TurnResult
) -> None:
    table = LATTICE.table
    seen = _core.compare_turns(
        turns[1].points, turns[0].points, turns[2].points, table, True, 1
    )["seen"]  # fmt: skip
    beside = [a for k in (0, 2) for a in (turns[k].points, turns[k].intensity)]
    motions = [aligned.previous, aligned.following]
    values, box = of_box(turns)
    values[box] *= 0.5
    given = (turns[1].points, values, table, beside, motions, 1, None)
    found, expected = _core.compare_reflectance(*given, seen), _core.compare_reflectance(*given)
    assert repr(found) == repr(expected)
    assert any(kind == "changed" for kind, _, _ in found)
    with pytest.raises(InputError, match="seen: expected the readings of two turns"):
        _core.compare_reflectance(*given, seen[:1])
    with pytest.raises(InputError, match="reading: expected that of"):
        _core.compare_reflectance(*given, seen[::-1])


def test_one_value_has_no_shot_noise(turns: list[LidarFrame]) -> None:
    values, box = of_box(turns)
    values[box] = 0.4
    found = judged(turns, None, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "even")
    assert box[found.suspected].mean() > 0.8


@pytest.mark.parametrize("one", [100.0, 255.0, 65535.0])
@pytest.mark.parametrize("write", [np.round, np.floor])
def test_hundredths_in_another_unit_are_judged(
    turns: list[LidarFrame], one: float, write: Callable[[np.ndarray], np.ndarray]
) -> None:
    values, inside = of_box(turns)
    values[inside] = np.float32(0.3)
    values[np.flatnonzero(~inside)[:3]] = np.float32(0.99)  # as bright as the scanner measures
    frame = turns[1].replace(intensity=values)
    written = write((values.astype(np.float64) * one).round(4)).astype(np.float32)
    found = reflectance_consistency(turns[1].replace(intensity=written), lattice=LATTICE)
    expected = reflectance_consistency(frame, lattice=LATTICE)
    assert found.verdict == expected.verdict == "tampered"
    assert np.array_equal(found.suspected, expected.suspected)


def test_numbers_that_are_no_hundredths_are_not_judged(turns: list[LidarFrame]) -> None:
    own = np.random.default_rng(0).integers(0, 256, turns[1].num_points).astype(np.float32)
    found = reflectance_consistency(turns[1].replace(intensity=own), lattice=LATTICE)
    assert (found.verdict, found.reason) == ("undecidable", "reflectances are not in [0, 1]")


def test_a_filled_hole_has_the_values_of_its_rim(turns: list[LidarFrame]) -> None:
    """The white-box deletion, which no other detector finds in one frame."""
    forged = forge.lattice_remove(turns[1], turn_scans.box_at(0, 0.0), lattice=LATTICE)
    assert forged.intensity is not None
    assert authenticate.generic_consistency(forged.points, lattice=LATTICE).verdict == ("no_trace")
    found = reflectance_consistency(LidarFrame(forged.points, forged.intensity), lattice=LATTICE)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "even")
    assert np.isin(found.suspected, forged.moved).mean() > 0.8


def test_values_between_hundredths_were_not_written_by_the_scanner(
    turns: list[LidarFrame],
) -> None:
    values, box = of_box(turns)
    values[box] *= 0.8123
    found = judged(turns, None, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "grid")
    assert set(found.suspected) <= set(np.flatnonzero(box))


@pytest.mark.parametrize("beyond", [-0.01, 1.01, 255.0, -1e30])
def test_a_few_values_that_no_scanner_writes_do_not_stop_the_search(
    turns: list[LidarFrame], aligned: TurnResult, beyond: float
) -> None:
    values, box = of_box(turns)
    values[box] = beyond
    for beside in (None, aligned):
        found = judged(turns, beside, values)
        assert (found.verdict, found.regions[0].kind) == ("tampered", "grid")
        assert np.array_equal(found.regions[0].rows, np.flatnonzero(box))
        assert found.score == found.regions[0].strength == box.sum() / 3.0


def test_a_rate_that_the_p_value_reaches_alarms(turns: list[LidarFrame]) -> None:
    values, box = of_box(turns)
    values[box] = 0.3333
    frame, least = turns[1].replace(intensity=values), 1.0 / (1 + TAIL_FRAMES)
    for rate, verdict in ((least, "tampered"), (0.99 * least, "no_trace")):
        found = reflectance_consistency(frame, lattice=LATTICE, false_alarm_rate=rate)
        assert (found.verdict, found.p_value) == (verdict, least)
        assert found.score == box.sum() / 3.0


def test_hundredths_that_were_computed_differ_in_the_last_bit(turns: list[LidarFrame]) -> None:
    values, box = of_box(turns)
    values[box] += np.float32(0.2)
    found = judged(turns, None, values)
    assert (found.verdict, found.regions[0].kind) == ("tampered", "grid")
    assert set(found.suspected) <= set(np.flatnonzero(box))


def test_another_way_to_compute_all_hundredths_is_no_edit(turns: list[LidarFrame]) -> None:
    assert turns[1].intensity is not None
    hundredths = np.round(turns[1].intensity * 100.0).astype(np.float32)
    values = hundredths * np.float32(0.01)
    assert 0.05 < np.mean(values != turns[1].intensity) < 0.95
    assert judged(turns, None, values).verdict == "no_trace"


def test_a_laser_is_compared_with_itself(turns: list[LidarFrame], aligned: TurnResult) -> None:
    """The gains of lasers are taken off: the kernel sees no edit where each has its own."""
    values, _ = of_box(turns)
    assert GAIN.std() > 0.04
    table = LATTICE.table
    beside = [a for k in (0, 2) for a in (turns[k].points, turns[k].intensity)]
    motions = [aligned.previous, aligned.following]
    found = _core.compare_reflectance(turns[1].points, values, table, beside, motions, 1)
    assert max((strength for kind, strength, _ in found if kind == "changed"), default=0.0) < 3000.0


@pytest.mark.parametrize(("lasers", "is_found"), [(1, False), (8, True)])
def test_one_laser_along_a_kerb_is_no_edit(
    turns: list[LidarFrame], aligned: TurnResult, lasers: int, is_found: bool
) -> None:
    """It lies on one side of the kerb in this turn, on the other in the turns before and after."""
    values, _ = of_box(turns)
    reading = LATTICE.read(turns[1].points)
    ahead = np.abs(np.remainder(reading.azimuth + np.pi, 2.0 * np.pi) - np.pi) < np.radians(60.0)
    there = ahead & (reading.ring >= KERB) & (reading.ring < KERB + lasers)
    values[there] = np.clip(values[there] + 0.3, 0.0, 0.99)
    beside = [a for k in (0, 2) for a in (turns[k].points, turns[k].intensity)]
    found = _core.compare_reflectance(
        turns[1].points, np.round(values, 2).astype(np.float32), LATTICE.table, beside,
        [aligned.previous, aligned.following], 1,
    )  # fmt: skip
    strength = max((each for kind, each, _ in found if kind == "changed"), default=0.0)
    assert (strength > 3000.0) == is_found


def test_threads_do_not_matter(turns: list[LidarFrame], aligned: TurnResult) -> None:
    values, box = of_box(turns)
    values[box] = np.clip(values[box] + 0.2, 0.0, 0.99)
    one, two = (judged(turns, aligned, values, threads) for threads in (1, 2))
    assert one.score == two.score > 0.0
    np.testing.assert_array_equal(one.suspected, two.suspected)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (None, "no reflectances"),
        (lambda n: np.full(n, 0.5), "fewer than"),
        (lambda n: np.arange(n) % 200, "not in [0, 1]"),
    ],
)
def test_what_cannot_be_judged(
    turns: list[LidarFrame], values: Callable[[int], Any] | None, why: str
) -> None:
    points = turns[1].points
    given = None if values is None else values(len(points)).astype(np.float32)
    found = reflectance_consistency(LidarFrame(points, given), lattice=LATTICE)
    assert found.verdict == "undecidable"
    assert why in found.reason
    assert (found.p_value, found.score, found.with_turns) == (1.0, 0.0, False)
    assert found.regions == ()
    assert len(found.suspected) == 0


def test_turns_that_are_not_given_are_aligned_here(
    turns: list[LidarFrame], aligned: TurnResult
) -> None:
    values, box = of_box(turns)
    values[box] = np.round(np.clip(values[box] - 0.25, 0.0, 0.99), 2)
    frame = turns[1].replace(intensity=values)
    found = reflectance_consistency(
        frame, lattice=LATTICE, previous=turns[0], following=turns[2], threads=1
    )
    expected = judged(turns, aligned, values)
    assert (found.verdict, found.score, found.with_turns) == ("tampered", expected.score, True)
    np.testing.assert_array_equal(found.suspected, expected.suspected)


@pytest.mark.parametrize("rewritten", [0, 2])
def test_a_turn_with_other_reflectances_is_not_compared(
    turns: list[LidarFrame], aligned: TurnResult, rewritten: int
) -> None:
    beside = list(turns)
    beside[rewritten] = turns[rewritten].replace(intensity=None)
    values, box = of_box(turns)
    values[box] = np.round(np.clip(values[box] - 0.25, 0.0, 0.99), 2)
    found = judged(beside, aligned, values)
    assert not found.with_turns
    assert "changed" not in {region.kind for region in found.regions}


def test_bad_input_is_named(turns: list[LidarFrame]) -> None:
    with pytest.raises(InputError, match="previous, following"):
        reflectance_consistency(turns[1], lattice=LATTICE, previous=turns[0])
    with pytest.raises(InputError, match="false_alarm_rate"):
        reflectance_consistency(turns[1], lattice=LATTICE, false_alarm_rate=0.0)
    nothing = np.empty((0, 3), np.float32)
    with pytest.raises(InputError, match="reflectance"):
        _core.compare_reflectance(turns[1].points, nothing[:, 0].copy(), LATTICE.table, [], [], 1)
    with pytest.raises(InputError, match=r"\[0, 1\].*row 1"):
        _core.compare_reflectance(
            turns[1].points[:2].copy(), np.array([0, 2], "f4"), LATTICE.table, [], [], 1
        )


def far_seeing(frame: LidarFrame) -> LidarFrame:
    """The frame with a point at 79 m: the yard is smaller than what the scanner reaches."""
    points = frame.points.copy()
    row = np.flatnonzero(LATTICE.read(points).ring == 0)[100:101]
    reading = LATTICE.read(points[row])
    points[row] = scans.rounded(
        scans.beam_points(LATTICE, reading.ring, reading.count, np.full(1, 79.0))
    )
    return frame.replace(points=points)


PLANTED = [name for name in authenticate.EDITS if name.startswith("reflectance")]


def test_power_is_measured_for_rewritten_reflectances(turns: list[LidarFrame]) -> None:
    assert len(PLANTED) == 5
    alone = authenticate.measure_power(turns[1:2], LATTICE, planted=2, classes=PLANTED, rng=4)
    assert {power.planted for power in alone.values()} == {2}
    assert alone["reflectance: one value"].found > 0
    assert alone["reflectance: exchanged"].found == 0  # one frame says nothing of it
    beside = authenticate.measure_power(
        turns, LATTICE, planted=2, classes=["reflectance: shifted"], neighbours=True, rng=4
    )
    assert beside["reflectance: shifted"].found > 0
    constant = turns[1].replace(intensity=np.zeros(turns[1].num_points, np.float32))
    assert authenticate.measure_power([constant], LATTICE, planted=1, classes=PLANTED) == {}
    with pytest.raises(InputError, match="classes: expected some of added"):
        authenticate.measure_power(turns, LATTICE, classes=["painted"])


def test_an_inspection_names_it(turns: list[LidarFrame], tmp_path: Path) -> None:
    values, box = of_box(turns)
    values[box] = 0.4
    found = authenticate.inspect(
        far_seeing(turns[1].replace(intensity=values)),
        previous=turns[0],
        following=turns[2],
        lattice=LATTICE,
    )
    assert (found.verdict, found.detectors[-1].name) == ("tampered", "reflectance")
    for name in PLANTED:
        assert found.power[name].planted >= 20
    assert found.power["reflectance: one value"].share > 0.9
    without = authenticate.inspect(far_seeing(turns[1]).replace(intensity=None), lattice=LATTICE)
    assert any("reflectance rewritten: the scan has none" in name for name in without.blind)
    assert not any(name in without.power for name in PLANTED)
    ratio = found.likelihood_ratio
    assert ratio is not None
    assert ratio > 1.0
    write_evidence(found, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Likelihood ratio of an edit over a clean scan" in page
    assert "V: the reflectances" in page


def written_reflectances(count: int = 40_000) -> np.ndarray:
    """Whole hundredths with the noise of each shot, as the scanner writes them."""
    random = np.random.default_rng(0)
    smooth = 0.35 + 0.2 * np.sin(np.arange(count) / 900.0)
    return np.round(np.clip(smooth + random.normal(0.0, 0.04, count), 0.0, 0.99), 2).astype("f4")


def test_what_rewrote_reflectances_is_named() -> None:
    values = written_reflectances()
    random = np.random.default_rng(1)
    assert why_rewritten(values) is None
    assert is_in_hundredths(values)
    noisy = (values + random.normal(0.0, 1e-3, len(values))).astype(np.float32)
    assert why_rewritten(noisy) == "reflectances are no whole hundredths"
    assert not is_in_hundredths(noisy)
    doubled = np.round(np.clip(2.0 * values, 0.0, 0.99), 2).astype(np.float32)
    assert str(why_rewritten(doubled)).endswith("% of the hundredths of reflectance do not occur")
    held = np.repeat(values[::8], 8)
    assert str(why_rewritten(held)).endswith("% of the points have the reflectance of the next one")


def test_other_scanners_steps_are_no_rewriting() -> None:
    """Bytes over 255 and whole bytes, as other makers write them."""
    bytes_ = np.round(255.0 * written_reflectances())
    for values in (bytes_ / 255.0, bytes_):
        assert why_rewritten(values.astype(np.float32)) is None
    assert not is_in_hundredths(bytes_.astype(np.float32))
    assert not is_in_hundredths(-written_reflectances())
    assert not is_in_hundredths(np.empty(0, np.float32))


@pytest.mark.parametrize("levels", [16, 52, 64])
@pytest.mark.parametrize("largest", [1.0, 255.0])
def test_few_levels_in_a_scanners_steps_are_named(levels: int, largest: float) -> None:
    """A quantiser's levels may be whole bytes: their evenness accused clean frames."""
    bits = np.round(255.0 * written_reflectances())
    values = np.floor(bits * levels / 256.0) * (255 // (levels - 1)) / 255.0 * largest
    assert not is_in_hundredths(values.astype(np.float32))
    named = str(why_rewritten(values.astype(np.float32)))
    assert named.endswith("% of the hundredths of reflectance do not occur")


def test_bytes_that_are_too_even_are_named() -> None:
    held = np.round(255.0 * np.repeat(written_reflectances()[::8], 8)).astype(np.float32)
    assert str(why_rewritten(held)).endswith("% of the points have the reflectance of the next one")


def test_reflectances_that_say_nothing_are_not_judged() -> None:
    for values in (np.zeros(5000), np.full(5000, 0.5), np.r_[np.zeros(4000), np.ones(1000)]):
        assert why_rewritten(values.astype(np.float32)) is None


def test_permuted_reflectances_are_told_from_noisy_ones() -> None:
    random = np.random.default_rng(2)
    values = written_reflectances()
    for noise in (0.0, 0.08):  # four times the variance of the shots, then
        noisy = np.round(np.clip(values + random.normal(0.0, noise, len(values)), 0.0, 0.99), 2)
        assert why_of_no_scene(noisy.astype(np.float32)) is None
    assert str(why_of_no_scene(random.permutation(values))).endswith("they were permuted")
    quarter = values.copy()
    quarter[::4] = random.permutation(quarter[::4])
    assert why_of_no_scene(quarter) is None
    assert why_of_no_scene(random.permutation(values)[:6000]) is None  # too few to tell
    alternating = values.copy()
    alternating[::2] = 0.9 - alternating[::2]  # odd and even firings differ, as in KITTI
    assert why_of_no_scene(alternating) is None


@pytest.mark.parametrize(("smallest", "largest", "is_named"), [
    (0, 240, False), (0, 260, True), (300, 260, False), (260, 300, True),
])  # fmt: skip
def test_many_have_the_largest_reflectance_where_it_was_the_smallest(
    smallest: int, largest: int, is_named: bool
) -> None:
    values = np.clip(written_reflectances(10_000), 0.01, 0.98)
    values[:smallest] = 0.0
    values[-largest:] = 0.99
    assert ("inverted" in str(why_of_no_scene(values))) is is_named


def test_a_strength_is_as_rare_as_clean_frames_show_it() -> None:
    assert reflectance_p_value(0.0) == 1.0
    assert reflectance_p_value(max(TAIL) + 1.0) == 1.0 / (1 + TAIL_FRAMES)
    assert reflectance_p_value(min(TAIL)) == 1.0  # how many more are as strong is not known
    for strength in sorted(TAIL, reverse=True)[: len(TAIL) // 2]:
        expected = (1 + sum(value >= strength for value in TAIL)) / (1 + TAIL_FRAMES)
        assert reflectance_p_value(strength) == expected


def test_which_steps_are_off() -> None:
    steps = np.array([-1.0, -0.0004, 0.0, 0.4, 1.0005, 1.002, 100.0, 100.0005, 101.0])
    off = [True, False, False, True, False, True, False, False, True]
    assert _is_off(steps, most=100).tolist() == off


@pytest.mark.parametrize("off", [1, 2])
def test_a_fifth_of_the_values_off_the_hundredths_is_too_many(off: int) -> None:
    values = np.full(70, 0.25, np.float32)  # ten of which are looked at
    values[: 7 * off : 7] = 0.2525
    assert is_in_hundredths(values) is (off < 2)


@pytest.mark.parametrize(("different", "is_judged"), [(15, False), (16, True)])
def test_sixteen_values_are_enough(different: int, is_judged: bool) -> None:
    """16 different values are enough, also if only values outside of the first sample differ."""
    random = np.random.default_rng(0)
    values = (0.3 + 0.01 * random.permutation(np.arange(7000) % different)).astype(np.float32)
    some = LidarFrame(np.ones((7000, 3), np.float32), values)
    assert (why_not_judged(some) is None) is is_judged
    values[::7] = np.resize(values[:7], 1000)
    few_there = LidarFrame(np.ones((7000, 3), np.float32), values)
    assert str(why_not_judged(few_there)).startswith("reflectances have fewer") is not is_judged


@pytest.mark.parametrize(("beyond", "is_judged"), [(1399, True), (1401, False)])
def test_a_fifth_of_the_values_may_be_beyond_the_scale(beyond: int, is_judged: bool) -> None:
    values = np.resize(written_reflectances(), 7000)
    values[-beyond:] = 2.0
    frame = LidarFrame(np.ones((7000, 3), np.float32), values)
    assert (why_not_judged(frame) != "reflectances are not in [0, 1]") is is_judged


def test_a_value_beside_a_hundredth_counts_where_most_are_exact() -> None:
    values = np.full(100, 0.25, np.float32)
    beside = np.nextafter(np.float32(0.25), np.float32(1.0))
    values[:49] = beside
    assert _between_steps(values).tolist() == list(range(49))
    values[49] = beside
    assert len(_between_steps(values)) == 0  # as many as are exact: another way to compute them
    values[:20] = 0.2525
    assert _between_steps(values).tolist() == [*range(20), *range(20, 50)]
    values[20] = 0.2525
    assert len(_between_steps(values)) == 0  # a file that has no hundredths


@pytest.mark.parametrize(("clipped", "before", "is_named"), [
    (20, 9, True), (19, 9, False), (20, 10, False), (21, 10, True),
])  # fmt: skip
def test_so_many_values_at_the_end_were_clipped(clipped: int, before: int, is_named: bool) -> None:
    values = 0.01 * (np.arange(7000) * 3 % 71)
    values = np.r_[values[values < 0.59], np.full(clipped, 0.61), np.full(before, 0.6)]
    found = why_rewritten(values.astype(np.float32))
    assert (found is not None and found.endswith("they were clipped")) is is_named


@pytest.mark.parametrize(("end", "is_named"), [(0.98, True), (0.99, False)])
def test_a_saturated_scanner_clipped_nothing(end: float, is_named: bool) -> None:
    values = 0.01 * (np.arange(7000) * 3 % 95)
    found = why_rewritten(np.r_[values, np.full(50, end)].astype(np.float32))
    assert (found is not None and found.endswith("they were clipped")) is is_named


def contrasted(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Any]:
    """A round wall with posts before it, which are brighter, and noise; in the scanner's order."""
    ring, count = np.divmod(np.arange(len(LATTICE.slope) * 1800), 1800)
    is_post = count % 60 < 12
    distance = np.where(is_post, 8.0, 14.0) + LATTICE.range_phase[ring]
    points = LATTICE.points_at(ring, 2 * count, distance).round(3).astype(np.float32)
    values = np.where(is_post, 0.6, 0.3) + rng.normal(0.0, 0.05, len(points))
    return points, np.round(values, 2).astype(np.float32), LATTICE.read(points)


def test_reflectances_of_other_points_are_told_by_edges_of_things() -> None:
    rng = np.random.default_rng(4)
    points, values, reading = contrasted(rng)
    edges, surfaces, contrast = _core.reflectance_contrast(
        points, values, reading.ring, reading.azimuth, [0, 2, -2]
    )
    # Two of 60 pairs a laser begin before an edge and end behind it, at both sides of a post.
    assert edges == pytest.approx(len(LATTICE.slope) * 30 * 4, rel=0.02)
    assert surfaces > 30_000
    # Noise of 0.05 twice, on the scale of the frame, beside a step of 0.3 that is clipped.
    scale = values.max() - values.min()
    step = min(0.3 / scale, 0.3)
    assert contrast[0] > (step - 0.1) ** 2 / (2.0 * (0.05 / scale) ** 2)
    assert max(contrast[1:]) < contrast[0]
    assert why_of_other_points(values, points, reading) is None
    assert why_of_other_points(255.0 * values, points, reading) is None
    shuffled = values.copy()
    for laser in range(len(LATTICE.slope)):
        rows = np.flatnonzero(reading.ring == laser)
        shuffled[rows] = values[rng.permutation(rows)]
    for other in (shuffled, np.roll(values, 30)):  # half a post's distance away
        assert "those of other points" in str(why_of_other_points(other, points, reading))
    for rows_away in (-5, -1, 1, 2, 5):
        slipped = np.roll(values, rows_away)
        assert "some rows before or behind" in str(why_of_other_points(slipped, points, reading))
    few = np.arange(3000)
    assert why_of_other_points(shuffled[few], points[few], LATTICE.read(points[few])) is None


def test_contrast_needs_pairs_and_differences() -> None:
    points, values, reading = contrasted(np.random.default_rng(4))
    one, two = reading.ring, reading.azimuth
    assert _core.reflectance_contrast(points[:0], values[:0], one[:0], two[:0], [0]) == (
        0,
        0,
        [0.0],
    )
    assert _core.reflectance_contrast(points, 0.0 * values, one, two, [0])[2] == [0.0]
    turned = np.roll(values, 7)
    of_slip = _core.reflectance_contrast(points, values, one, two, [-7, len(values) - 7])[2]
    assert of_slip == _core.reflectance_contrast(points, turned, one, two, [0, len(values)])[2]
    with pytest.raises(InputError, match="rings, azimuths: expected"):
        _core.reflectance_contrast(points, values, one[1:], two, [0])
    with pytest.raises(InputError, match="reflectance: expected"):
        _core.reflectance_contrast(points, values[:0], one, two, [0])
