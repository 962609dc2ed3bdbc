"""The experiment on detector III: its measures, and attackers who know the lattice."""

from __future__ import annotations

import numpy as np
import pytest

import lattice_scans as scans
from manip3d._util.shares import upper_limit
from manip3d.authenticate import generic_consistency
from manip3d.experiments import _roc, detector_3
from manip3d.experiments._lidar_attacks import ADDING, OTHERS, Target, as_written
from manip3d.experiments._model import Plan
from manip3d.lidar import Box

LATTICE = scans.lattice()


@pytest.fixture(scope="module")
def target() -> Target:
    """A street, a pole of it to be touched, and a wall of 1.5 m by 1.2 m to be pasted."""
    random = np.random.default_rng(2)
    scan = scans.scan(random)
    hoax = random.uniform([7.0, -0.75, -1.6], [7.05, 0.75, -0.4], (1500, 3))
    rows = np.flatnonzero(
        (np.abs(np.arctan2(scan[:, 1], scan[:, 0]) - 1.0) < 0.06) & (scan[:, 2] > -1)
    )
    low, high = scan[rows].min(axis=0), scan[rows].max(axis=0)
    box = Box(tuple((0.5 * (low + high)).tolist()), tuple((high - low).tolist()))
    return Target(scan, box, hoax.astype(np.float32), 9.0, 2.0, LATTICE, 0)


@pytest.mark.parametrize("attack", ADDING)
def test_attacks_that_add_or_move_are_found(target: Target, attack: str) -> None:
    forged = as_written(ADDING[attack](target), LATTICE)
    assert generic_consistency(forged, lattice=LATTICE).p_value < 1e-9


def test_attacker_who_emulates_the_scanner_leaves_its_lattice_alone(target: Target) -> None:
    """He is not found, and the test says so: it also shows that he emulates it exactly."""
    ranges = as_written(OTHERS["occlusion on firings"](target), LATTICE)
    exact = as_written(OTHERS["occlusion on firings, ranges"](target), LATTICE)
    assert not np.array_equal(exact, target.scan)
    found = generic_consistency(ranges, lattice=LATTICE)
    told = [kind for kind, report in found.evidence.items() if report.strength > 0]
    assert told == ["place", "range"]
    assert found.verdict == "tampered"
    result = generic_consistency(exact, lattice=LATTICE)
    assert all(report.strength == 0.0 for report in result.evidence.values())
    assert result.verdict == "no_trace"


def test_points_lie_where_the_lattice_says() -> None:
    random = np.random.default_rng(0)
    ring = random.integers(0, 64, 5000)
    count = random.integers(0, LATTICE.steps, 5000)
    distance = random.uniform(2.0, 80.0, 5000)
    points = LATTICE.points_at(ring, count, distance)
    assert LATTICE.distance(points, ring) == pytest.approx(distance, abs=1e-9)
    reading = LATTICE.read(points.astype(np.float32))
    assert (reading.ring == ring).all()
    assert (reading.count == count).all()
    assert np.abs(reading.line_error).max() < 1e-5
    assert np.abs(reading.step_error).max() < 1e-5


def test_file_order_of_kitti(target: Target) -> None:
    shuffled = target.scan[np.random.default_rng(0).permutation(len(target.scan))]
    assert np.array_equal(as_written(shuffled, LATTICE), target.scan)


def test_area_under_the_curve_counts_pairs() -> None:
    random = np.random.default_rng(1)
    clean, forged = random.integers(0, 5, 30), random.integers(1, 7, 40)
    pairs = [(f > c) + 0.5 * (f == c) for c in clean for f in forged]
    assert _roc.auc(clean, forged) == pytest.approx(np.mean(pairs))
    false, found = _roc.curve(clean.tolist(), forged.tolist())
    steps = np.diff(false) * (np.asarray(found[1:]) + found[:-1])
    assert steps.sum() / 2 == pytest.approx(np.mean(pairs))


def test_interval_is_over_scenes() -> None:
    clean = {"a": [0.0] * 9, "b": [0.0]}
    assert _roc.auc_interval(clean, {"a": [1.0] * 9, "b": [1.0]}) == (1.0, 1.0)
    low, high = _roc.auc_interval(clean, {"a": [1.0] * 9, "b": [0.0]})
    assert (low, high) == (0.5, 1.0)


def test_bound_of_a_rate() -> None:
    assert upper_limit(0, 14) == pytest.approx(1.0 - 0.05 ** (1.0 / 14.0))
    assert upper_limit(3, 3) == 1.0


def test_tuning_drives_are_in_no_test() -> None:
    tested = {file for scene in (*detector_3.SCENES, detector_3.ODOMETRY) for file in scene.files}
    assert len(tested) == 14 + 1 + 6
    assert not any("drive_0002" in file or "unidentified" in file for file in tested)
    blocks = [case.options for case in detector_3.cases(Plan(data="simulated"))]
    streets = [s for b in blocks for s in range(b["first"], b["first"] + b["streets"])]
    assert len(set(streets)) * detector_3.FRAMES_PER_STREET >= 1000
    assert max(streets) < detector_3.TUNING_STREET


def test_claims_are_read_off_the_rows() -> None:
    def row(model: str, scene: str, scores: list[float]) -> dict[str, object]:
        return {
            "model": model,
            "attack": "" if "clean" in model else model,
            "scene": scene,
            "frames": len(scores),
            "scores": scores,
            "verdicts": ["tampered" if s >= 2.0 else "no_trace" for s in scores],
            "dropped": [],
            "data": "simulated" if "simulated" in model else "recorded",
            "found": float(np.mean([s >= 2.0 for s in scores])),
            "density_found": 0.0,
            "occlusion_found": 0.5,
        }

    rows = [
        row("clean, real", "a", [0.0, 0.1]),
        row("clean, real", "b", [0.0]),
        row("clean, simulated", "streets", [0.0] * 99 + [3.0]),
        row("CTP", "a", [5.0, 6.0]),
        row("CTP", "b", [7.0]),
        row("rotation", "a", [0.0, 6.0]),
    ]
    verdicts = [claim.verdict(rows) for claim in detector_3.EXPERIMENT.claims]
    assert {f.subject: f.holds for f in verdicts[0].findings} == {"CTP": True, "rotation": False}
    assert "AUC 1.000 [1.000, 1.000], 2 scenes, 3 forgeries" in verdicts[0].findings[0].numbers
    assert (
        "AUC against simulated clean frames 1.000; 100.0% found" in verdicts[0].findings[0].numbers
    )
    assert "100.0% at the stated 1 %; 0.0% by I; 50.0% by II" in verdicts[0].findings[0].numbers
    assert verdicts[2].holds is None  # no forgeries that the frame before could help with
    assert verdicts[3].holds is True
    assert verdicts[4].holds is True
    assert "1 of 100 frames" in verdicts[4].findings[0].numbers
    rows[2] = row("clean, simulated", "streets", [0.0] * 20)  # those of a quick run
    quick = detector_3.EXPERIMENT.claims[4].verdict(rows)
    assert (quick.word, quick.findings[0].unjudged[:14]) == ("undecided", "too few frames")
    rows[2] = row("clean, simulated", "streets", [0.0] * 19 + [3.0])
    assert detector_3.EXPERIMENT.claims[4].verdict(rows).word == "does not hold"
    (figure,) = detector_3.figures(rows).values()
    false_alarms = figure.axes[0].lines[0].get_xdata()
    assert sorted(set(false_alarms)) == pytest.approx([0.0, 1.0 / 3.0, 1.0])  # of real frames alone
