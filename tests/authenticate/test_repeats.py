"""Scans of a drive that repeat earlier ones, are missing, or stand in another order."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manip3d import InputError, LidarFrame, authenticate, report
from manip3d.authenticate import TurnResult
from manip3d.authenticate._inspect import repeating
from manip3d.authenticate._repeats import (
    EarlierScans,
    first_copies,
    in_common,
    share_in_common,
    sketch_of,
)
from manip3d.authenticate._turns import CALIBRATION
from manip3d.cli import app

NOTHING = authenticate.inspect(LidarFrame(np.zeros((0, 3), np.float32)))
TURN_NS = 100_000_000


def cloud(seed: int, num_points: int = 3000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.round(rng.normal(0.0, 20.0, (num_points, 3)), 3).astype(np.float32)


def with_one_byte_changed(points: np.ndarray) -> np.ndarray:
    changed = points.copy()
    changed.view(np.uint8)[17, 1] ^= 1
    return changed


COPIES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "as it is": (lambda p: p.copy(), "the same points"),
    "shuffled": (lambda p: np.random.default_rng(1).permutation(p), "the same points in another"),
    "one byte": (with_one_byte_changed, "about 99.9% of the points"),
    "an object moved": (
        lambda p: np.concatenate([p[:100] + np.float32(1), p[100:]]), "% of the points"),
    "a half": (lambda p: p[:1500], "about 99.9% of the points of the smaller of the two"),
    "with empty rows": (lambda p: np.insert(p, [3, 3, 900], 0, axis=0), "the same points"),
    "negative zeros": (lambda p: np.where(p == 0, np.float32(-0.0), p), "the same points"),
}  # fmt: skip


@pytest.mark.parametrize("name", COPIES)
def test_copies_of_an_earlier_scan_are_known(name: str) -> None:
    change, words = COPIES[name]
    original = cloud(0)
    original[7] = 0.0, 1.0, -2.0
    scans = [cloud(5), original, cloud(6), change(original), cloud(7)]
    frames = [LidarFrame(points, origin=(0, 0, 0)) for points in scans]  # else it is searched for
    found = list(authenticate.inspect_drive(frames))
    assert [each.repeats for each in found if each] == [None, None, None, 1, None]
    copy = found[3]
    assert copy is not None
    assert copy.verdict == "processed"
    assert copy.reason.startswith("repeated: number 1 of the drive has")
    assert words in copy.reason
    assert copy.record()["repeats"] == 1
    told = authenticate.judge_drive(found)
    assert told.verdict == "processed"
    assert told.reason.endswith("repeated: number 3 has the points of an earlier one")


def test_scans_that_share_what_chance_or_emptiness_shares_are_no_copies() -> None:
    one, other = cloud(0), cloud(1)
    other[:1500] = one[:1500]  # half of the points
    assert share_in_common(sketch_of(one), sketch_of(other)) == pytest.approx(0.5, abs=0.12)
    assert in_common(sketch_of(one), sketch_of(other)) == ""
    nothing = np.zeros((2000, 3), np.float32)
    for points in (nothing, nothing[:0], one[:10]):
        assert in_common(sketch_of(points), sketch_of(points.copy() + 0)) in ("", "the same points")
    earlier = EarlierScans()
    assert [earlier.repeated(nothing, k) for k in range(3)] == [None] * 3
    repeated = np.repeat(one[:300], 10, axis=0)  # few distinct points
    assert in_common(sketch_of(repeated), sketch_of(repeated[::-1])).endswith("in another order")


def test_an_accused_copy_stays_accused() -> None:
    report_ = authenticate.DetectorReport("generic", "tampered", "off the lattice", 9.0, 0.002)
    accused = replace(NOTHING, verdict="tampered", reason="off", detectors=(report_,))
    found = repeating(accused, (4, "the same points"))
    assert (found.verdict, found.reason, found.repeats) == ("tampered", "off", 4)
    assert [step.kind for step in found.processing] == ["repeated"]


def test_ids_are_those_of_the_points_in_any_order() -> None:
    points = cloud(0)
    own = authenticate.points_id(points)
    assert len(own) == 32
    assert authenticate.points_id(points[::-1]) == own
    assert authenticate.are_same_points(own, authenticate.points_id(with_one_byte_changed(points)))
    assert not authenticate.are_same_points(own, authenticate.points_id(points[:-200]))
    assert authenticate.points_id(points * 0) == ""
    assert not authenticate.are_same_points("", "")
    with pytest.raises(InputError, match="other: expected an id of 32 digits, got 'ab'"):
        authenticate.are_same_points(own, "ab")


def test_files_of_a_folder_with_the_same_points_are_named(tmp_path: Path) -> None:
    for name, points in (
        ("a.bin", cloud(0)),
        ("b.bin", cloud(1)),
        ("c.bin", with_one_byte_changed(cloud(0))),
    ):
        LidarFrame(points, np.zeros(len(points), np.float32)).write(tmp_path / name)
    arguments = ["inspect", str(tmp_path), "--jobs", "1"]
    rows = json.loads(CliRunner().invoke(app, [*arguments, "--json", "-q"]).stdout)
    same = [row["same_points_as"] for row in rows]
    assert same[:2] == [None, None]
    assert same[2] == rows[0]["source"]
    assert "same_points_as" in CliRunner().invoke(app, arguments).stdout


def test_what_the_times_tell() -> None:
    scans = [NOTHING] * 6

    def remarks(*turns: float | None) -> list[tuple[str, str]]:
        times = [None if turn is None else round(turn * TURN_NS) for turn in turns]
        told = authenticate.judge_drive(scans[: len(times)], times_ns=times)
        assert all(f"{each.kind}: {each.detail}" in told.reason for each in told.remarks)
        return [(each.kind, each.detail) for each in told.remarks]

    assert remarks(0, 1, 2.03, 2.98, 4, 5) == []
    assert remarks(0, 1, 2, 6, 7, 8) == [
        ("missing", "3 scans are missing after number 2 (scans are 0.10 s apart)")
    ]
    assert remarks(0, None, 2, 3, 5, 6) == [
        ("missing", "1 scan is missing after number 3 (scans are 0.10 s apart)")
    ]
    assert remarks(5, 4, 3) == [("unordered", "times go back at numbers 1, 2")]
    assert remarks(None, None) == []
    assert remarks(0, 0, 0) == []
    turns = np.array([5, 4, 3]) * TURN_NS
    assert [r.kind for r in authenticate.judge_drive(scans[:3], times_ns=turns).remarks] == [
        "unordered"
    ]
    with pytest.raises(InputError, match="times_ns: expected 6, one for each scan, got 1"):
        authenticate.judge_drive(scans, times_ns=[0])


def test_what_the_numbers_tell_where_there_are_no_times() -> None:
    def kinds(*numbers: int) -> list[str]:
        told = authenticate.judge_drive([NOTHING] * len(numbers), numbers)
        return [f"{each.kind}: {each.detail}" for each in told.remarks]

    assert kinds(3, 4, 5) == []
    assert kinds(0, 2, 4) == []  # no sequence
    assert kinds(3, 4, 8, 9, 11) == [
        "missing: 4 scans are missing after numbers 1, 3 (by the numbers in the names of their "
        "files)"
    ]


def moving(steps: Sequence[float]) -> list[authenticate.Inspection | None]:
    """Inspections of a scanner that moves so many metres ahead between its turns."""

    def ahead(metres: float) -> np.ndarray:
        matrix = np.eye(4)
        matrix[0, 3] = metres
        return matrix

    nothing = np.empty(0, np.int64)
    results = [
        TurnResult("no_trace", "", 1.0, 0.0, 0.01, (), nothing, ahead(-before), ahead(after),
                   CALIBRATION)
        for before, after in itertools.pairwise(steps)
    ]  # fmt: skip
    return [NOTHING, *(replace(NOTHING, turns=turns) for turns in results), NOTHING]


def test_what_the_way_of_the_scanner_tells() -> None:
    def kinds(*steps: float) -> list[str]:
        return [each.kind for each in authenticate.judge_drive(moving(steps)).remarks]

    assert kinds(0.9, 0.9, 1.0, 1.1, 1.2) == []
    assert kinds(0.9, 0.9, 0.9, 3.6, 0.9, 0.9, 0.9) == ["jumps"]
    assert kinds(0.9, 0.9, 1.8, 0.9, 0.9) == ["jumps"]
    assert kinds(*[-0.9] * 6) == ["backwards"]
    assert kinds(*[-0.3] * 6) == []  # a car that reverses
    assert kinds(*[-0.3] * 100) == ["backwards"]  # farther than cars reverse
    assert kinds(*[-0.3] * 50, *[0.3] * 10, *[-0.3] * 50) == []
    assert kinds(-0.9, -0.9, 0.9, 0.9, 0.9, 0.9) == ["jumps"]
    found = moving([0.9] * 3 + [3.6] + [0.9] * 3)
    told = authenticate.judge_drive(found)
    assert "moves by up to 3.6 m in a turn (after number 3)" in told.reason
    assert told.verdict == "undecidable"  # a remark is no verdict
    turns = found[3].turns  # type: ignore[union-attr]
    assert turns is not None
    found[3] = replace(NOTHING, turns=replace(turns, following=np.eye(4)))
    assert authenticate.judge_drive(found).remarks == ()  # the two scans disagree
    found = moving([0.9] * 5)
    for k in (1, 3):
        found[k] = replace(NOTHING, turns=replace(turns, aligned=False))
    assert [(each.kind, each.detail.split(":")[0]) for each in
            authenticate.judge_drive(found).remarks] == [
        ("unaligned", "numbers 1, 3 cannot be aligned with the scans before and after")
    ]  # fmt: skip


def test_the_page_and_the_record_say_it(tmp_path: Path) -> None:
    found = list(authenticate.inspect_drive([LidarFrame(cloud(k % 2)) for k in range(3)]))
    page = tmp_path / "drive.html"
    times = [0, TURN_NS, 5 * TURN_NS]
    report.write_drive_evidence(found, page, names=list("abc"), times_ns=times)
    text = page.read_text()
    assert "repeated: number 2 has the points of an earlier one" in text
    assert "repeated: number 0 of the drive has the same points" in text
    told = authenticate.judge_drive(found, times_ns=times).record()
    assert [each["kind"] for each in told["remarks"]] == ["repeated"]


@pytest.mark.parametrize("times", [True, False])
def test_a_drive_with_a_gap_and_a_copy(times: bool, tmp_path: Path) -> None:
    scans = tmp_path / "drive" / "velodyne_points" / "data"
    scans.mkdir(parents=True)
    kept = [0, 1, 2, 6, 7]
    for number in kept:
        points = cloud(1 if number == 7 else number)
        LidarFrame(points, np.zeros(len(points), np.float32)).write(scans / f"{number:010d}.bin")
    if times:
        lines = [f"2011-09-26 13:02:{25 + k / 10:012.9f}" for k in range(9)]
        (scans.parent / "timestamps.txt").write_text("\n".join(lines) + "\n")
    arguments = ["inspect", str(tmp_path / "drive"), "--json", "-q"]
    told = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert [each["kind"] for each in told["remarks"]] == ["repeated", "missing"]
    assert "3 scans are missing after number 2" in told["reason"]
    assert [each["repeats"] for each in told["frames"]] == [None, None, None, None, 1]


def test_first_copies_are_those_of_all_pairs() -> None:
    """Groups of two values, so that ids are often the same but for a few groups."""
    rng = np.random.default_rng(5)
    ids = ["".join(rng.choice(["0a0a", "1b1b"], 8)) for _ in range(200)]
    ids[7] = ids[90] = ""
    expected = [
        next((j for j in range(i) if authenticate.are_same_points(ids[j], ids[i])), None)
        for i in range(len(ids))
    ]
    assert first_copies(ids) == expected
    assert None in expected
    assert any(j is not None and ids[i] != ids[j] for i, j in enumerate(expected))
