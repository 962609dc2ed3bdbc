"""`authenticate.inspect`: one result of all detectors, and how their verdicts combine."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import lattice_scans as scans
from cave_scans import AHEAD, CAVE, ball
from landmarks import assert_accessible
from lattice_scans import reflectances
from manip3d import FormatError, InputError, LidarFrame, authenticate, io, report, simulate
from manip3d.authenticate import (
    DetectorReport,
    Inspection,
    Power,
    Processing,
    SensorLattice,
    _inspect,
    _sensors,
    _standpoint,
    combined_verdict,
    kitti_lattice,
)
from manip3d.authenticate._extent import _is_cut_on_both_sides, _least_of_rings, first_azimuth
from manip3d.authenticate._firings import (
    FARTHEST_POINTS,
    Firings,
    ends_in_silence,
    firings_of,
    is_cut_below,
)
from manip3d.authenticate._known_power import MEASURED
from manip3d.authenticate._lattice import COLUMNS
from manip3d.authenticate._processing import edge_of_voxels, find_processing
from manip3d.authenticate._reflectance import why_rewritten
from manip3d.authenticate._roundings import _step_of
from manip3d.authenticate._sensors import identify_and_read, is_hdl64e
from manip3d.authenticate._verdict import (
    FALSE_ALARM_RATE,
    OF_OCCLUSION,
    RATE_SHARES,
    Region,
    rate_of,
)
from manip3d.cli.inspect import show
from manip3d.lidar import Box, ScanFormat
from manip3d.report._evidence import _drawn_regions, _how_many, _region_figure
from real_data import RealData

LATTICE = scans.lattice()
DIRECTIONS = np.random.default_rng(1).normal(size=(50_000, 3))
SPHERE = 5.0 * DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
FORGED = np.concatenate([CAVE, ball(0.6, 20_000) + np.float32([3, 1, 0])])


def test_every_combination_of_verdicts() -> None:
    words = ("no_trace", "tampered", "processed", "undecidable")
    shuffled = Processing("shuffled", "")
    for verdicts in product(words, repeat=3):
        for found, done in product((0, 9, 10), ((), (shuffled,))):
            reports = [
                DetectorReport(name, verdict, "", power={"moved": Power(found, 20)})
                for name, verdict in zip(("density", "occlusion", "generic"), verdicts, strict=True)
            ]
            expected = "undecidable"
            if "no_trace" in verdicts and found == 10:  # a detector that finds half of them
                expected = "no_trace"
            if "processed" in verdicts or done:
                expected = "processed"
            if "tampered" in verdicts:
                expected = "tampered"
            assert combined_verdict(reports, done) == expected


def test_a_clean_and_a_forged_scan() -> None:
    told: list[float] = []
    clean = authenticate.inspect(
        LidarFrame(CAVE), origin=(0, 0, 0), progress=lambda fraction, message: told.append(fraction)
    )
    assert clean.verdict == "no_trace"
    assert clean.origin == (0.0, 0.0, 0.0)
    assert clean.origin_from == "argument"
    assert "removed" not in clean.power  # detectors I and II look for what was added, and say so
    assert any("removed" in name for name in clean.blind)
    assert told == sorted(told)
    assert told[-1] == 1.0
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    assert found.verdict == "tampered"
    assert found.num_points == len(FORGED)
    assert [report.name for report in found.detectors] == ["density", "occlusion", "generic"]
    occlusion = found.detectors[1]
    assert found.occlusion is not None
    assert occlusion.verdict == found.occlusion.verdict == "tampered"
    np.testing.assert_allclose(occlusion.boxes[0].center, (3, 1, 0), atol=0.1)
    assert (occlusion.suspected >= len(CAVE)).mean() > 0.95
    assert json.loads(json.dumps(found.record()))["detectors"]["occlusion"]["verdict"] == "tampered"


@pytest.mark.parametrize(
    "is_kept",
    [
        np.random.default_rng(3).random(len(FORGED)) < 0.5,
        np.random.default_rng(4).random(len(FORGED)) < 0.8,
        np.isin(
            np.arange(len(FORGED)),
            np.unique(np.floor(FORGED / 0.06).astype(int), axis=0, return_index=True)[1],
        ),
    ],
    ids=["half", "four of five", "voxels"],
)
def test_a_thinned_terrestrial_scan_is_processed_and_states_no_power(is_kept: np.ndarray) -> None:
    """Half of a forged scan lost its gaps, was `no_trace` and stated the power of whole scans."""
    is_own = np.arange(len(FORGED)) < len(CAVE)
    clean = authenticate.inspect(LidarFrame(FORGED[is_kept & is_own]))
    assert clean.verdict == "processed"
    assert [step.kind for step in clean.processing] == ["thinned"]
    assert not clean.power
    forged = authenticate.inspect(LidarFrame(FORGED[is_kept]))
    assert forged.verdict in ("processed", "tampered")
    assert "thinned" in [step.kind for step in forged.processing]


def test_an_object_sparser_than_the_scan_is_said_to_be_unseen() -> None:
    sparse = np.concatenate([CAVE, ball(0.4, 100) + np.float32([3, 1, 0])])
    found = authenticate.inspect(LidarFrame(sparse))
    assert found.verdict == "no_trace"
    assert any("coarser than the scan's" in name for name in found.blind)


def test_most_of_an_object_left_out_is_said_to_be_unseen(realdata: RealData) -> None:
    """The class of edits that nothing finds had ended at half of an object's points."""
    folder = "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0005_sync/velodyne_points/data"
    before, frame, after = (
        io.read_scan(realdata(f"{folder}/{number:010}.bin.xz")) for number in (3, 4, 5)
    )
    beside = np.hypot(frame.points[:, 0] - 6.7, frame.points[:, 1] - 10.0) < 1.2
    rows = np.flatnonzero(beside & (np.abs(frame.points[:, 2]) < 1.5))
    order = np.random.default_rng(4).permutation(rows)
    for share, verdict in ((0.6, "no_trace"), (0.8, "no_trace"), (1.0, "tampered")):
        left = np.delete(np.arange(frame.num_points), order[: int(share * len(rows))])
        found = authenticate.inspect(frame.select(left), previous=before, following=after)
        assert found.verdict == verdict
        assert any("up to 4 of 5 of an object's" in name for name in found.blind)


def test_far_returns_that_a_terrestrial_scanner_loses_are_no_thinning() -> None:
    distance = np.linalg.norm(CAVE, axis=1)
    lost = np.random.default_rng(2).random(len(CAVE)) < np.where(distance > 8.5, 0.3, 0.01)
    found = authenticate.inspect(LidarFrame(CAVE[~lost]))
    assert (found.verdict, found.processing) == ("no_trace", ())
    assert found.power["added"].share == 1.0


def street() -> np.ndarray:
    """A street as a scanner on a lattice sees it, without the scanner's own car."""
    points = scans.scan(np.random.default_rng(5))
    reading = LATTICE.read(points)
    row = np.flatnonzero(reading.ring == 0)[100:101]  # something far
    beam = scans.beam_points(LATTICE, reading.ring[row], reading.count[row], np.full(1, 79.0))
    points[row] = scans.rounded(beam)
    return points


@functools.cache
def simulated_street() -> np.ndarray:
    """A street as KITTI's scanner sees it, with the scanner's own car."""
    pytest.importorskip("open3d")
    made = simulate.hdl64e(simulate.street(rng=88_500), 3.0, rng=88_500)
    points: np.ndarray = made.frame.points
    return points


def street_with(edit: Callable[[np.ndarray], np.ndarray] | None = None) -> Inspection:
    """Inspect a street of a scanner on a lattice, after an optional edit by an attacker."""
    points = street()
    return authenticate.inspect(
        points if edit is None else edit(points), origin=(0, 0, 0), lattice=LATTICE
    )


def test_no_trace_states_the_power_and_what_it_is_blind_to() -> None:
    found = street_with()
    assert (found.verdict, found.processing) == ("no_trace", ())
    assert found.power["moved"].share == 1.0
    assert found.power["removed"].share < 0.5
    assert any("white-box" in name for name in found.blind)
    assert any("one by one" in name for name in found.blind)
    assert not any("removed" in name for name in found.blind)  # its power is measured
    assert found.p_value == 1.0
    assert "authentic" not in json.dumps(found.record())


def test_power_says_what_it_was_measured_of_and_what_the_turns_beside_would_add(
    tmp_path: Path,
) -> None:
    found = street_with()
    sizes, removed = found.power_notes
    assert "at least 100 returns, 5 to 25 m" in sizes
    assert found.power["removed"].share < 0.5
    share = f"{found.power['removed'].share:.0%} are found in a scan alone"
    assert share in removed
    assert "86% (31 of 36) where the scans before and after" in removed
    assert found.record()["power_notes"] == [sizes, removed]
    report.write_evidence(found, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert sizes in page
    assert removed in page
    turns = DetectorReport("turns", "no_trace", "seen", power=MEASURED["turns"])
    assert replace(found, detectors=(*found.detectors, turns)).power_notes == (sizes,)
    assert replace(found, detectors=()).power_notes == ()


def another_turn(width: float) -> np.ndarray:
    """Return the first radians of another turn, which saw the street anew."""
    points = scans.scan(np.random.default_rng(6))
    return points[np.mod(np.arctan2(points[:, 1], points[:, 0]), 2.0 * np.pi) < width]


TURNED: dict[str, tuple[tuple[int, int], ...]] = {  # column and sign of each of their axes
    "camera axes (x right, y down, z forward)": ((1, -1), (2, -1), (0, 1)),
    "axes with y up": ((1, 1), (2, 1), (0, 1)),
    "axes with z down": ((0, 1), (1, -1), (2, -1)),
    "axes with x up": ((2, 1), (0, 1), (1, 1)),
    "axes with x down": ((2, -1), (0, 1), (1, -1)),
}


@pytest.mark.parametrize("name", TURNED)
def test_scans_in_other_axes_are_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The axes are found without the slow search for the scanner's place."""
    points = scans.scan(np.random.default_rng(5), authenticate.kitti_lattice())
    turned = np.column_stack([sign * points[:, column] for column, sign in TURNED[name]])
    monkeypatch.setattr("manip3d.authenticate._standpoint.estimate_origin", None)
    for origin, sensor in ((None, "auto"), ((0.0, 0.0, 0.0), "lattice")):
        found = authenticate.inspect(turned.astype(np.float32), origin=origin, sensor=sensor)
        assert found.verdict == "processed"
        assert [(step.kind, step.detail) for step in found.processing] == [("turned", name)]
        assert found.sensor is not None
        assert found.sensor.name == "HDL-64E"
        assert found.origin == (0.0, 0.0, 0.0)
        assert dict(found.power) == {}


@pytest.mark.parametrize(
    ("unit", "a_metre"),
    [("millimetres", 1000.0), ("centimetres", 100.0), ("inches", 39.3701), ("feet", 3.28084)],
)
def test_scans_in_other_units_are_named(
    unit: str, a_metre: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scaled coordinates are not reported as rounded, although they are whole numbers of steps."""
    points = scans.scan(np.random.default_rng(5), authenticate.kitti_lattice())
    monkeypatch.setattr("manip3d.authenticate._standpoint.estimate_origin", None)
    found = authenticate.inspect((points * a_metre).astype(np.float32))
    assert found.verdict == "processed"
    assert found.processing == (Processing("scaled", f"coordinates are in {unit}"),)
    assert found.sensor is not None
    assert (found.sensor.name, found.sensor.unit) == ("HDL-64E", unit)
    assert {unit in detector.reason for detector in found.detectors} == {True}
    assert dict(found.power) == {}


def test_points_that_are_on_any_line_tell_no_unit_and_no_axes() -> None:
    """Metres taken for millimetres lie near the scanner, where any point is on some line."""
    random = np.random.default_rng(2)
    angle, rise = random.uniform(0.0, 2.0 * np.pi, 20_000), random.uniform(-0.4, 0.05, 20_000)
    rays = np.column_stack([np.cos(angle), np.sin(angle), np.tan(rise)])
    for distance in (0.3, 1.0, 15.0, 50.0):
        near = (distance * rays).astype(np.float32)
        for points in (near, np.ascontiguousarray(near[:, [0, 2, 1]])):
            found = authenticate.identify_sensor(points)
            assert (found.unit, found.turned) == ("", "")


def test_another_scale_is_no_unit() -> None:
    points = scans.scan(np.random.default_rng(5), authenticate.kitti_lattice())
    for scale in (1.0, 90.0, 1100.0):
        assert authenticate.identify_sensor((points * scale).astype(np.float32)).unit == ""


def test_every_region_of_the_accusing_detector_is_drawn(tmp_path: Path) -> None:
    """Regions are drawn up to a bound, the most significant first; the rest is counted."""
    points = street()
    rng = np.random.default_rng(0)
    places = [(10.0 * np.cos(a), 10.0 * np.sin(a), -0.5) for a in np.linspace(0.0, 6.0, 9)]
    pasted = [np.float32(place) + rng.uniform(0, 0.5, (60, 3)) for place in places]
    found = authenticate.inspect(
        np.concatenate([points, *pasted]).astype(np.float32), origin=(0, 0, 0), lattice=LATTICE
    )
    report_of = found.accusing
    assert report_of is not None
    assert len(report_of.regions) > 6
    assert _how_many(found) == ""
    assert len(_drawn_regions(found)) == len(report_of.regions)
    page = tmp_path / "page.html"
    report.write_evidence(found, page)
    assert f"<td>{len(report_of.regions)}</td>" in page.read_text()
    many = [
        replace(report_of.regions[0], p_value=p, evidence={"points": 1.0})
        for p in np.linspace(0.9, 0.1, 40)
    ]
    crowded = replace(
        found,
        detectors=(*found.detectors[:2], replace(report_of, regions=tuple(many))),
    )
    assert _drawn_regions(crowded)[0].place == 39
    assert _how_many(crowded) == "; the 24 most significant of 40, the table has all"
    tiny = (replace(report_of.regions[0], p_value=0.0),)
    certain = replace(found, detectors=(*found.detectors[:2], replace(report_of, regions=tiny)))
    figure = _region_figure(pytest.importorskip("matplotlib.figure").Figure, certain)
    assert figure is not None
    assert figure.axes[0].get_title().endswith(", p-value below 1e-300")


def test_edits_are_planted_in_the_scan_itself() -> None:
    points = street()
    told: list[float] = []
    found = authenticate.inspect(
        points, origin=(0, 0, 0), lattice=LATTICE, plant=1, progress=lambda f, _: told.append(f)
    )
    assert found.verdict == "no_trace"
    assert len(told) > 5
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)
    assert found.planted_here["added"].found == 1
    for report_of in found.detectors:  # what they find together is the word of none of them
        assert all(power.here_planted == 0 for power in report_of.power.values())
    added = found.power["added"]
    assert (added.here_found, added.here_planted) == (1, 1)
    assert found.power["removed"].here_planted == 1
    record = found.record()["power"]
    assert record["added"]["here_planted"] == 1
    assert "here_planted" not in street_with().record()["power"]["added"]
    forged = np.concatenate(
        [
            points,
            np.float32([[9.0, 3.0, -1.0]])
            + np.random.default_rng(0).uniform(0, 1, (500, 3)).astype(np.float32),
        ]
    )
    accused = authenticate.inspect(forged, origin=(0, 0, 0), lattice=LATTICE, plant=1)
    assert accused.verdict == "tampered"
    assert all(power.here_planted == 0 for power in accused.power.values())
    with pytest.raises(InputError, match="plant: expected at least 0, got -1"):
        authenticate.inspect(points, plant=-1)
    with pytest.raises(InputError, match="plant: can only be given with power"):
        authenticate.inspect(points, plant=1, power=False)


SIXTEEN = np.arange(0, 64, 4)


def of_sixteen(sensor: SensorLattice) -> SensorLattice:
    """Return a lattice with every fourth laser of another one."""
    columns = {name: getattr(sensor, name)[SIXTEEN] for name in COLUMNS}
    return replace(sensor, **columns)


def sixteen_street(seed: int = 5) -> LidarFrame:
    """A street that a scanner of 16 lasers sees, with reflectances."""
    points = scans.scan(np.random.default_rng(seed), of_sixteen(LATTICE))
    return LidarFrame(points, reflectances(points), origin=(0.0, 0.0, 0.0))


def test_an_hdl64e_is_told_by_its_lasers_and_its_encoder() -> None:
    known = authenticate.kitti_lattice()
    some = {name: np.delete(getattr(known, name), (3, 40, 41)) for name in COLUMNS}
    tilted = np.tan(np.arctan(known.slope) + np.radians(7.0))
    twice = {name: np.repeat(getattr(known, name)[:32], 2) for name in COLUMNS}
    for sensor, expected in (
        (known, True),
        (LATTICE, True),  # the nominal angles
        (replace(known, **some), True),
        (replace(known, slope=tilted), False),
        (replace(known, **twice), False),
        (replace(known, steps=2000), False),
        (replace(known, range_step=0.0), False),
        (of_sixteen(known), False),
        (replace(known, slope=np.full(64, np.nan)), False),
    ):
        assert is_hdl64e(sensor) is expected


def test_the_power_of_one_scanner_is_not_that_of_another() -> None:
    """III finds what was pasted in, but says no_trace only where its power was measured."""
    lattice = of_sixteen(LATTICE)
    clean = sixteen_street()
    found = authenticate.inspect(clean, lattice=lattice)
    assert found.sensor is not None
    assert found.sensor.name == "scanner of at least 16 lasers"
    assert (found.verdict, dict(found.power)) == ("undecidable", {})
    assert "was not measured for this scanner" in found.reason
    assert [each.name for each in found.detectors][3:] == []
    beside = authenticate.inspect(
        clean, previous=sixteen_street(6), following=sixteen_street(7), lattice=lattice
    )
    assert beside.verdict == "undecidable"
    assert "no thresholds for a scanner of at least 16 lasers" in beside.detectors[3].reason
    assert beside.detectors[3].p_value is None
    car = np.array([12.0, -4.0, -1.0]) + np.random.default_rng(0).uniform(-1, 1, (500, 3))
    forged = np.concatenate([clean.points, car.astype(np.float32)])
    assert authenticate.inspect(forged, origin=(0, 0, 0), lattice=lattice).verdict == "tampered"


def of_unknown_scanner(seed: int = 11) -> LidarFrame:
    """A street seen by 64 lasers that look lower than an HDL-64E's, with the laser of each point.

    One more, the lowest, sees nothing but the scanner's own case, less than half a metre away.
    """
    sensor = replace(LATTICE, slope=np.tan(np.arctan(LATTICE.slope) * 1.6))
    points = scans.scan(np.random.default_rng(seed), sensor)
    angle = np.random.default_rng(12).uniform(0.0, 2.0 * np.pi, 400)
    rho = 0.33 + 0.15 * np.sin(3.0 * angle) ** 2
    below = sensor.slope[-1] - 1.5 * (sensor.slope[-2] - sensor.slope[-1])
    case = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), below * rho + 0.12])
    ring = np.concatenate([sensor.read(points).ring, np.full(400, 64)])
    whole = np.concatenate([points, scans.rounded(case)])
    return LidarFrame(whole, ring=ring.astype(np.uint16), origin=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("kept", "is_own"),
    [
        (lambda xyz: np.ones(len(xyz), bool), True),
        (lambda xyz: np.random.default_rng(0).random(len(xyz)) < 0.9, True),
        (lambda xyz: xyz[:, 2] > -1.2, False),  # too little for a lattice
        (lambda xyz: np.hypot(xyz[:, 0], xyz[:, 1]) > 4.0, False),
        (lambda xyz: xyz[:, 0] > 0.0, False),
    ],
)
def test_what_a_scan_does_not_tell_of_its_scanner_accuses_nobody(
    kept: Callable[[np.ndarray], np.ndarray], is_own: bool
) -> None:
    """Neither a laser without a line nor one that saw little, nor the order of its points."""
    frame = of_unknown_scanner()
    found = authenticate.inspect(frame.select(np.flatnonzero(kept(frame.points))))
    assert found.sensor is not None
    assert found.sensor.is_own is is_own
    assert (found.verdict, found.processing) == ("undecidable", ())
    assert ("was not measured for this scanner" in found.reason) is is_own


def of_another_unit() -> np.ndarray:
    """A scan of an HDL-64E whose lasers look a little elsewhere than those of KITTI's."""
    known, random = kitti_lattice(), np.random.default_rng(1)
    turn = np.sort(random.normal(0.0, 2.5e-3, 64))[::-1] + random.normal(0.0, 6e-4, 64)
    return scans.scan(np.random.default_rng(5), replace(known, slope=known.slope + turn))


def test_another_unit_of_a_model_has_no_power_that_was_measured_on_kittis() -> None:
    """The power of KITTI's unit, whose lattice is known, is not stated for another unit."""
    found = authenticate.inspect(LidarFrame(of_another_unit()))
    assert found.sensor is not None
    assert (found.sensor.name, found.sensor.is_own) == ("HDL-64E", True)
    assert (found.verdict, found.processing) == ("undecidable", ())
    assert not found.power
    assert "was not measured for this scanner: calibrate_lattice" in found.reason


@pytest.mark.parametrize(
    ("kind", "kept"),
    [
        ("thinned", lambda xyz: np.random.default_rng(0).random(len(xyz)) < 0.5),
        ("thinned", lambda xyz: np.random.default_rng(0).random(len(xyz)) < 0.9),
        ("cropped", lambda xyz: np.abs(np.arctan2(xyz[:, 1], xyz[:, 0])) > 0.1),
    ],
)
def test_what_was_left_out_of_a_scan_of_another_unit_is_named(
    kind: str, kept: Callable[[np.ndarray], np.ndarray]
) -> None:
    points = of_another_unit()
    found = authenticate.inspect(LidarFrame(points[kept(points)]))
    assert found.sensor is not None
    assert found.sensor.is_own
    assert (found.verdict, [step.kind for step in found.processing]) == ("processed", [kind])


def test_a_lattice_that_one_scan_tells_accuses_no_other_of_its_drive() -> None:
    """The last scan of a recording is a part of a turn."""
    whole, other = of_unknown_scanner(), of_unknown_scanner(13)
    part = other.select(np.flatnonzero(other.points[:, 0] > np.abs(other.points[:, 1])))
    first, last = authenticate.inspect_drive([whole, part])
    assert first is not None
    assert last is not None
    assert first.sensor is not None
    assert first.sensor.is_own
    assert (first.verdict, first.processing) == ("undecidable", ())
    assert (last.verdict, last.processing) == ("undecidable", ())


@functools.cache
def on_a_street(seed: int) -> LidarFrame:
    """Return a simulated turn of an HDL-64E; it is cached because simulation is slow."""
    return simulate.hdl64e(simulate.street(rng=seed), 1.0, rng=0).frame


def test_a_thinned_scan_is_not_said_to_lack_the_scanners_own_car() -> None:
    scan = on_a_street(3)
    some = np.random.default_rng(7).random(scan.num_points) < 0.1
    found = authenticate.inspect(scan.select(np.flatnonzero(some)))
    assert "thinned" in {step.kind for step in found.processing}
    assert "own car" not in found.reason
    beyond = np.linalg.norm(scan.points, axis=1) > 2.0
    found = authenticate.inspect(scan.select(np.flatnonzero(beyond)))
    assert found.reason == "cropped: the scanner's own car does not answer"
    beyond = np.linalg.norm(scan.points, axis=1) > 1.6  # where the rack begins
    found = authenticate.inspect(scan.select(np.flatnonzero(beyond)))
    assert found.reason == "cropped: the scanner's own car does not answer nearer than 1.59 m"


@pytest.mark.parametrize("height", [0.5, 0.95, 1.05, 1.15, 1.25])
def test_a_cut_at_any_height_below_the_highest_laser_is_found(height: float) -> None:
    scan = on_a_street(3)
    below = scan.select(np.flatnonzero(scan.points[:, 2] < np.float32(height)))
    found = authenticate.inspect(below, power=False)
    assert found.verdict == "processed"
    assert f"no points above a height of {height:.2f} m" in found.reason


@pytest.mark.parametrize("rows", [1200, 5000, 20_000])
def test_rows_cut_out_of_a_file_are_a_part_of_the_scan(rows: int) -> None:
    whole = on_a_street(3)
    for first in (0, 30_000, whole.num_points - rows):
        part = np.arange(first, first + rows)
        piece = whole.points[part]  # without a file that says where the scanner stands
        found = authenticate.inspect(piece)
        assert found.sensor is not None
        assert found.sensor.name == "HDL-64E"
        assert (found.verdict, found.origin) == ("processed", (0.0, 0.0, 0.0))
        assert {step.kind for step in found.processing} <= {"cropped", "lasers", "thinned"}
        around = np.linalg.norm(piece - piece[rows // 2], axis=1) < 1.0
        moved = np.where(around[:, None], piece + np.float32([0.4, 0.3, 0.0]), piece)
        found = authenticate.inspect(np.round(moved, 3).astype(np.float32))
        assert found.verdict == "tampered"
        assert np.isin(np.flatnonzero(around), found.suspected).mean() > 0.8


def test_the_parts_of_turns_at_the_ends_of_a_recording_were_not_cropped() -> None:
    """Packets tell which turns are whole; a file that lacks the same points was cropped."""
    street = simulate.street(rng=3)
    turns = [simulate.hdl64e(street, 1.0 + 0.1 * i, rng=i).frame for i in range(3)]
    azimuth = np.arctan2(turns[2].points[:, 1], turns[2].points[:, 0])
    cropped = turns[2].select(np.flatnonzero(azimuth > 0.5))
    packets = ScanFormat("velodyne", header={"is_complete": False})
    part = cropped.replace(format=packets)
    *_, of_file = authenticate.inspect_drive([*turns[:2], cropped])
    *_, of_packets = authenticate.inspect_drive([*turns[:2], part])
    assert of_file is not None
    assert of_packets is not None
    assert {step.kind for step in of_file.processing} == {"cropped"}
    assert (of_file.verdict, of_packets.verdict) == ("processed", "undecidable")
    assert of_packets.processing == ()
    assert "a part of this turn only" in of_packets.reason


def test_a_lattice_that_the_scan_tells_still_accuses_what_was_pasted() -> None:
    frame = of_unknown_scanner()
    car = np.array([9.0, -4.0, -1.0]) + np.random.default_rng(0).uniform(-0.8, 0.8, (600, 3))
    ring = np.random.default_rng(1).integers(16, 48, 600)
    forged = LidarFrame(
        np.concatenate([frame.points, car.astype(np.float32)]),
        ring=np.concatenate([frame.ring, ring]).astype(np.uint16),
        origin=(0.0, 0.0, 0.0),
    )
    found = authenticate.inspect(forged)
    assert found.sensor is not None
    assert found.sensor.is_own
    assert found.verdict == "tampered"
    assert found.detectors[2].regions
    rows = np.concatenate([region.rows for region in found.detectors[2].regions])
    assert (rows >= frame.num_points).mean() > 0.95


def test_a_scan_of_what_is_near_is_on_no_lattice() -> None:
    """Half a metre away the lines of an HDL-64E are 4 mm apart: any point lies on one."""
    rng = np.random.default_rng(3)
    angle, height = rng.uniform(0.0, 2.0 * np.pi, 20_000), rng.uniform(-0.5, 0.3, 20_000)
    rho = rng.uniform(0.4, 0.6, 20_000)
    near = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), height])
    found = authenticate.inspect(near.astype(np.float32), origin=(0, 0, 0))
    assert found.sensor is not None
    assert (found.verdict, found.sensor.lattice) == ("undecidable", None)


def test_a_lattice_with_measured_power_earns_no_trace(tmp_path: Path) -> None:
    frames = [sixteen_street(seed) for seed in range(10, 14)]
    told: list[float] = []
    lattice = authenticate.calibrate_lattice(
        frames, planted=2, source="four streets", progress=lambda f, _: told.append(f)
    )
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)
    assert len(told) > 10
    assert len(lattice.slope) == 16
    assert lattice.power["added"].planted == 4
    assert lattice.power["added"].share == 1.0
    lattice.save(tmp_path / "sixteen.json")
    loaded = authenticate.SensorLattice.load(tmp_path / "sixteen.json")
    assert dict(loaded.power) == dict(lattice.power)
    found = authenticate.inspect(sixteen_street(), lattice=loaded)
    assert found.verdict == "no_trace"
    assert found.power["added"] == lattice.power["added"]
    assert found.power["added"].source == "four streets"
    with pytest.raises(InputError, match="at least 4 scans, got 1"):
        authenticate.calibrate_lattice(frames[:1])
    car = np.array([12.0, -4.0, -1.0]) + np.random.default_rng(0).uniform(-1, 1, (500, 3))
    for k in (1, 3):
        frames[k] = LidarFrame(np.concatenate([frames[k].points, car.astype(np.float32)]))
    with pytest.raises(InputError, match="detector III accuses 2 of 2 as they are"):
        authenticate.calibrate_lattice(frames, planted=1)


def test_power_in_a_file_must_be_possible(tmp_path: Path) -> None:
    path = tmp_path / "lattice.json"
    LATTICE.save(path)
    values = json.loads(path.read_text())
    for power in (
        {"added": {"found": 3, "planted": 2}},
        {"added": {"found": 1}},
        {"added": 1},
        [1],
    ):
        values["sensor_lattice"]["power"] = power
        path.write_text(json.dumps(values))
        with pytest.raises(FormatError, match="not a sensor lattice"):
            authenticate.SensorLattice.load(path)
    del values["sensor_lattice"]["power"]  # as older versions wrote it
    path.write_text(json.dumps(values))
    assert dict(authenticate.SensorLattice.load(path).power) == {}


ROTATION = np.array([[0.9, 0.19**0.5, 0.0], [-(0.19**0.5), 0.9, 0.0], [0.0, 0.0, 1.0]])
COS, SIN = np.cos(0.3), np.sin(0.3)
FLAT_TURN = np.array([[COS, -SIN, 0.0], [SIN, COS, 0.0], [0.0, 0.0, 1.0]])
LAUNDERING: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "shuffled": lambda p: p[np.random.default_rng(0).permutation(len(p))],
    "reversed": lambda p: p[::-1].copy(),
    "centimetres": lambda p: np.float32(np.round(p.astype(float) * 100) / 100),
    "float16": lambda p: p.astype(np.float16).astype(np.float32),
    "noise": lambda p: p + np.random.default_rng(0).normal(0, 0.005, p.shape).astype(np.float32),
    "deskewed": lambda p: p + np.outer(np.arctan2(p[:, 1], p[:, 0]), [0.1, 0, 0]).astype("f4"),
    "turned": lambda p: np.float32(p @ ROTATION),
    "halved": lambda p: p[np.random.default_rng(0).random(len(p)) < 0.5],
    "camera view": lambda p: p[np.abs(np.arctan2(p[:, 1], p[:, 0])) < 0.7],
    "near": lambda p: p[np.hypot(p[:, 0], p[:, 1]) < 20.0],
    "low": lambda p: p[p[:, 2] < 0.0],
    "voxels": lambda p: p[np.unique(np.floor(p / 0.1), axis=0, return_index=True)[1]],
    "twice": lambda p: np.concatenate([p, p]),
    "three of a hundred lost": lambda p: p[np.random.default_rng(0).random(len(p)) < 0.97],
    "one of a hundred lost": lambda p: p[np.random.default_rng(0).random(len(p)) < 0.99],
    "one of two hundred lost": lambda p: p[np.random.default_rng(0).random(len(p)) < 0.995],
    "noise below a millimetre": lambda p: scans.rounded(
        p + np.random.default_rng(0).normal(0, 0.0003, p.shape)
    ),
    "rounded twice": lambda p: scans.rounded(
        scans.rounded(p @ FLAT_TURN).astype(np.float64) @ FLAT_TURN.T
    ),
    "cut to millimetres in single precision": lambda p: np.float32(np.trunc(p * 1000) / 1000),
    "a laser left out": lambda p: p[LATTICE.read(p).ring != 20],
    "fine voxels in file order": lambda p: p[
        np.sort(np.unique(np.floor(p / 0.05), axis=0, return_index=True)[1])
    ],
    "the ground alone": lambda p: p[p[:, 2] < -0.9],
    "cut at no round height": lambda p: p[p[:, 2] < 0.437],
    "padded with its last point": lambda p: np.concatenate([p, np.repeat(p[-1:], 2000, axis=0)]),
    "a turn and a quarter": lambda p: np.concatenate([p, another_turn(1.5)]),
    "a sector left out": lambda p: p[np.abs(np.arctan2(p[:, 1], p[:, 0]) - 1.0) > 0.03],
}


@pytest.mark.parametrize("name", LAUNDERING)
def test_processed_scans_are_neither_accused_nor_cleared(name: str) -> None:
    found = street_with(LAUNDERING[name])
    assert found.verdict == "processed", found.record()
    assert found.processing
    if name in ("centimetres", "float16", "noise"):
        assert found.detectors[2].p_value is None  # detector III has nothing to accuse it by
    assert found.reason == "; ".join(f"{s.kind}: {s.detail}" for s in found.processing)


@pytest.mark.parametrize(("metres", "verdict"), [(3e-5, "no_trace"), (2e-4, "tampered")])
def test_what_single_precision_adds_up_is_no_edit(metres: float, verdict: str) -> None:
    def shift(points: np.ndarray) -> np.ndarray:  # of a group, as far points of a street are
        shifted = points.astype(np.float64)
        shifted[30_000:30_030] += metres
        return shifted.astype(np.float32)

    assert street_with(shift).verdict == verdict


@pytest.mark.parametrize("name", ["from 0", "from the least coordinates"])
def test_means_of_fine_voxels_are_no_edit(name: str) -> None:
    points = simulated_street()
    edge = 0.01
    start = np.zeros(3) if name == "from 0" else points.min(axis=0).astype(float) - edge / 2
    found = authenticate.inspect(voxel_means(points, edge, start), origin=(0, 0, 0))
    assert found.verdict == "processed"
    assert [step.kind for step in found.processing[:2]] == ["shuffled", "averaged"]
    assert "10 mm" in found.reason


def voxel_means(points: np.ndarray, edge: float, start: np.ndarray) -> np.ndarray:
    own = np.float64 if start.any() else np.float32
    cells = np.floor((points - start.astype(own)) * own(1 / edge)).astype(int)
    _, cell, size = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(cell.ravel(), axis.astype(float)) for axis in points.T]
    return np.column_stack([(each / size).astype(np.float32) for each in sums])


def test_voxels_are_told_by_the_cells_that_no_two_points_share() -> None:
    points = np.random.default_rng(0).uniform(0, 0.5, (20_000, 3)).astype(np.float32)
    assert edge_of_voxels(points) == 0.0
    assert edge_of_voxels(voxel_means(points, 0.012, np.zeros(3))) == 0.012
    assert edge_of_voxels(points[:100]) == 0.0  # none is near another one
    assert edge_of_voxels(points[:100], np.empty(0, np.int64)) == 0.0  # no means, no filter


def test_a_hole_in_a_shuffled_scan_is_of_no_voxels() -> None:
    """0 points off the lattice were said to be the means of voxels."""
    pytest.importorskip("open3d")
    points = simulate.hdl64e(simulate.street(0)).points
    away, azimuth = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    rest = points[~((abs(azimuth) < 0.25) & (away > 8) & (away < 25))]
    assert authenticate.inspect(rest, origin=(0, 0, 0), power=False).verdict == "tampered"
    shuffled = np.random.default_rng(1).permutation(rest)
    found = authenticate.inspect(shuffled, origin=(0, 0, 0), power=False)
    assert [step.kind for step in found.processing] == ["shuffled"]


def test_a_quarter_turn_is_not_said_to_lack_the_scanners_own_car() -> None:
    points = simulated_street()
    turned = np.column_stack([-points[:, 1], points[:, 0], points[:, 2]])
    found = authenticate.inspect(turned, origin=(0, 0, 0))
    assert [step.kind for step in found.processing] == ["turned"]
    assert "begin at 90 degrees" in found.reason


@pytest.mark.parametrize("kind", ["reversed", "mirrored"])
@pytest.mark.parametrize("is_forged", [False, True])
def test_reversed_and_mirrored_scans_are_named(kind: str, is_forged: bool) -> None:
    def change(points: np.ndarray) -> np.ndarray:
        if is_forged:
            points = points.copy()
            points[20_000:20_300] += np.float32([0.3, 0.2, 0.0])
        return {
            "reversed": lambda: points[::-1].copy(),
            "mirrored": lambda: points * np.float32([1, -1, 1]),
        }[kind]()

    found = street_with(change)
    assert [step.kind for step in found.processing] == [kind]
    assert found.verdict in (("processed", "tampered") if is_forged else ("processed",))
    across = street_with(lambda points: points * np.float32([-1, 1, 1]))
    assert [step.kind for step in across.processing] == ["mirrored"]
    backwards = street_with(lambda points: points[::-1] * np.float32([1, -1, 1]))
    assert [step.detail for step in backwards.processing] == [
        "the scan is a mirror image in the reverse order of the scanner"
    ]


def test_an_edit_beside_repeated_points_is_found_with_its_rows() -> None:
    def paste(points: np.ndarray) -> np.ndarray:
        car = np.array([12.0, -4.0, -1.0]) + np.random.default_rng(0).uniform(-1, 1, (500, 3))
        return np.concatenate([points[:100], points, car.astype(np.float32)])

    found = street_with(paste)
    assert found.verdict == "tampered"
    assert [step.kind for step in found.processing] == ["repeated"]
    assert found.scan is not None
    assert (found.regions[0].rows >= found.num_points - 500).mean() > 0.9
    assert found.regions[0].rows.max() < found.num_points


@pytest.mark.parametrize("place", [0, 40_000, None])
def test_rows_without_a_return_are_named(place: int | None) -> None:
    def pad(points: np.ndarray, number: int) -> np.ndarray:
        at = len(points) if place is None else place
        return np.insert(points, [at] * number, 0.0, axis=0)

    found = street_with(lambda points: pad(points, 500))
    assert found.verdict == "processed"
    assert found.reason == "padded: 500 rows have x, y and z of 0"
    assert street_with(lambda points: pad(points, 1)).reason == "padded: 1 row has x, y and z of 0"

    def moved(points: np.ndarray) -> np.ndarray:
        points = points.copy()
        points[20_000:20_300] += np.float32([0.3, 0.2, 0.0])
        return pad(points, 500)

    forged = street_with(moved)
    assert (forged.verdict, [step.kind for step in forged.processing]) == ("tampered", ["padded"])


def test_rows_that_were_left_out_as_nan_are_named(tmp_path: Path) -> None:
    rows = np.insert(street(), [7, 90_000], np.nan, axis=0)
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nPOINTS {len(rows)}\nDATA binary\n"
    )
    path = tmp_path / "scan.pcd"
    path.write_bytes(head.encode() + rows.astype("<f4").tobytes())
    found = authenticate.inspect(io.read_scan(path), origin=(0, 0, 0), lattice=LATTICE)
    assert found.reason == "padded: 2 rows have no coordinates (NaN)"


def with_fill_value(points: np.ndarray, metres: float) -> np.ndarray:
    """Firings between those of the scan that had no return, filled with one range."""
    reading = LATTICE.read(points)
    some = np.random.default_rng(4).choice(len(points), 3000, replace=False)
    ring, count = reading.ring[some], (reading.count[some] + 1) % LATTICE.steps
    filled = scans.rounded(LATTICE.points_at(ring, count, np.full(len(some), metres)))
    both = np.concatenate([points, filled])
    return both[scans.in_file_order(LATTICE, both)]


@pytest.mark.parametrize("is_zeroed", [False, True])
def test_a_page_of_the_file_that_was_lost_is_named(is_zeroed: bool) -> None:
    page = np.arange(60_160, 60_416)

    def lose(points: np.ndarray) -> np.ndarray:
        if not is_zeroed:
            return np.delete(points, page, axis=0)
        points = points.copy()
        points[page] = 0.0
        return points

    found = street_with(lose)
    assert found.verdict == "processed", found.record()
    told = re.search(r"thinned: a laser .* has no return in (\d+) firings in a row", found.reason)
    assert told is not None
    assert 250 < int(told[1]) < 262


def lifted(points: np.ndarray) -> np.ndarray:
    """An edit of 300 points."""
    points = points.copy()
    points[20_000:20_300] += np.float32([0.3, 0.2, 0.0])
    return points


@pytest.mark.parametrize("height", [1.73, -0.5, 1.7327])
def test_a_cloud_above_the_ground_is_judged_from_where_the_scanner_stands(height: float) -> None:
    """Its own lattice tells neither what is missing nor the order: a thinned one was `no_trace`."""

    def said(points: np.ndarray) -> Inspection:
        raised = (points + np.array([0.0, 0.0, height])).astype(np.float32)
        return authenticate.inspect(LidarFrame(raised, origin=(0.0, 0.0, 0.0)), power=False)

    points = simulated_street()
    clean = said(points)
    assert (clean.verdict, clean.processing) == ("no_trace", ())
    assert clean.origin == pytest.approx((0.0, 0.0, height), abs=2e-6)
    assert clean.origin_from == "the lattice of a spinning scanner"
    thinned = said(points[np.random.default_rng(0).random(len(points)) < 0.9])
    assert "thinned" in {step.kind for step in thinned.processing}
    near = said(points[np.linalg.norm(points, axis=1) < 40.0])
    assert (near.verdict, near.processing[0].kind) == ("processed", "cropped")
    forged = said(lifted(points))
    assert forged.verdict == "tampered"
    assert np.isin(forged.suspected, np.arange(20_000, 20_300)).mean() > 0.9
    raised = (points + np.array([0.0, 0.0, height])).astype(np.float32)
    stated = authenticate.inspect(LidarFrame(raised), origin=(0.0, 0.0, 0.0))
    assert stated.origin == (0.0, 0.0, 0.0)  # the caller's word counts


NO_RETURNS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "three points at 10 km": lambda p: np.concatenate([p, np.float32([[1e4, 0, 0]] * 3)]),
    "16 bits of centimetres": lambda p: np.insert(p, [9, 900, 50_000], 655.35, axis=0),
    "many of 0x7FFF": lambda p: np.insert(p, np.arange(0, len(p), 9), 32767.0, axis=0),
    "16 bits of the scanner": lambda p: np.insert(p, [9, 10], [131.07, 0, 0], axis=0),
    "the largest floats": lambda p: np.insert(p, [7, 7, 70], 3.4e38, axis=0),
    "far points at random": lambda p: np.concatenate(
        [p, np.random.default_rng(0).uniform(150, 400, (40, 3)).astype(np.float32)]
    ),
    "a hair beside the scanner": lambda p: np.insert(p, [8, 80, 800], 0.001, axis=0),
    "firings filled with 120 m": lambda p: with_fill_value(p, 120.0),
    "firings filled with 90 m": lambda p: with_fill_value(p, 90.0),
}


@pytest.mark.parametrize("name", NO_RETURNS)
def test_rows_that_are_no_returns_are_set_apart(name: str) -> None:
    spoil = NO_RETURNS[name]
    found = street_with(spoil)
    assert found.verdict == "processed", found.record()
    assert [step.kind for step in found.processing] == ["padded"]
    changed = street()
    changed = lifted(changed)
    spoiled = spoil(changed)
    forged = street_with(lambda _: spoiled)
    assert (forged.verdict, [step.kind for step in forged.processing]) == ("tampered", ["padded"])
    assert forged.num_points == len(spoiled)
    edited = changed[20_000:20_300]
    suspected = spoiled[forged.suspected]
    assert (suspected[:, None] == edited).all(axis=2).any(axis=1).mean() > 0.9


def test_near_points_that_were_pasted_beside_a_marker_are_an_edit() -> None:
    pasted = np.float32([[12.0, 3.0, 0.5]] * 3)
    marker = np.float32([[1e4, 0.0, 0.0]] * 3)
    found = street_with(lambda points: np.concatenate([points, marker, pasted]))
    assert found.verdict == "tampered"
    assert found.suspected.min() >= found.num_points - 3


def test_neighbours_are_placed_where_they_say_their_scanner_stood() -> None:
    """In coordinates of a map each turn has a position of its own."""
    points = street()
    reading = LATTICE.read(points)
    away = np.linalg.norm(points.astype(np.float64), axis=1)
    turns = [
        scans.rounded(scans.beam_points(LATTICE, reading.ring, reading.count, away + more))
        for more in (0.1, 0.0, 0.2)
    ]
    places = [(10.0, 3.0, 1.0), (10.7, 3.0, 1.0), (11.4, 3.2, 1.1)]
    moved = [
        LidarFrame((turn + np.array(place)).astype(np.float32), origin=place)
        for turn, place in zip(turns, places, strict=True)
    ]
    found = authenticate.inspect(moved[1], previous=moved[0], following=moved[2], lattice=LATTICE)
    expected = authenticate.inspect(
        turns[1], previous=turns[0], following=turns[2], origin=(0, 0, 0), lattice=LATTICE
    )
    assert found.verdict == expected.verdict
    assert [each.reason for each in found.detectors] == [
        each.reason for each in expected.detectors
    ]  # fmt: skip
    given = authenticate.inspect(
        moved[1], previous=moved[0], following=moved[2], origin=places[1], lattice=LATTICE
    )  # the caller's word counts for all three
    assert given.processing != found.processing


@pytest.mark.parametrize("share", [0.015, 0.02])
def test_a_scan_of_another_scanner_around_this_one_is_no_edit(share: float) -> None:
    points = street()
    random = np.random.default_rng(4)
    number = round(share * len(points))
    angle, rho = random.uniform(0.0, 2.0 * np.pi, number), random.uniform(3.0, 25.0, number)
    other = np.column_stack(
        [rho * np.cos(angle), rho * np.sin(angle), random.uniform(-1.6, 0.5, number)]
    )
    found = street_with(lambda clean: np.concatenate([clean, scans.rounded(other)]))
    assert found.verdict == "processed"
    assert "fused" in {step.kind for step in found.processing}
    few = street_with(lambda clean: np.concatenate([clean, scans.rounded(other[angle < 0.6])]))
    assert few.verdict == "tampered"


def test_markers_in_the_turns_beside_a_frame_are_no_evidence() -> None:
    points = street()
    marked = np.concatenate([points, np.float32([[1e4, 0, 0]] * 3)])
    bare, spoiled = (
        authenticate.inspect(points, previous=p, following=p, origin=(0, 0, 0), lattice=LATTICE)
        for p in (scans.rounded(points @ FLAT_TURN), scans.rounded(marked @ FLAT_TURN))
    )
    assert bare.record() == spoiled.record()


@pytest.mark.parametrize("place", ["in front", "earlier", "later", "at the end"])
def test_points_that_are_repeated_elsewhere_in_the_file_are_no_edit(place: str) -> None:
    def again(points: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(2)
        rows = np.sort(rng.choice(len(points), 400, replace=False))
        at = {
            "in front": np.zeros(len(rows), int),
            "earlier": (rows * rng.random(len(rows))).astype(int),
            "later": rows + ((len(points) - rows) * rng.random(len(rows))).astype(int),
            "at the end": np.full(len(rows), len(points)),
        }[place]
        order = np.argsort(at, kind="stable")
        return np.insert(points, at[order], points[rows[order]], axis=0)

    found = street_with(again)
    assert found.reason == "repeated: 400 points repeat another one"
    forged = street_with(lambda points: again(lifted(points)))
    assert (forged.verdict, [s.kind for s in forged.processing]) == ("tampered", ["repeated"])


REGROUPED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "near before far": lambda p: np.hypot(p[:, 0], p[:, 1]) > 24.0,
    "the nearest first": lambda p: np.hypot(p[:, 0], p[:, 1]) > 4.2,
    "low before high": lambda p: p[:, 2] > 1.0,
    "one thing at the end": lambda p: np.hypot(p[:, 0] - 12.0, p[:, 1]) < 2.0,
}


@pytest.mark.parametrize("name", REGROUPED)
def test_files_that_were_sorted_by_group_are_no_edit(name: str) -> None:
    def sort(points: np.ndarray) -> np.ndarray:
        return points[np.argsort(REGROUPED[name](points), kind="stable")]

    found = street_with(sort)
    assert found.verdict == "processed", found.record()
    assert {step.kind for step in found.processing} <= {"regrouped", "shuffled"}
    forged = street_with(lambda points: sort(lifted(points)))
    assert forged.verdict == "tampered"
    edited = lifted(street())[20_000:20_300]
    suspected = sort(lifted(street()))[forged.suspected]
    assert (suspected[:, None] == edited).all(axis=2).any(axis=1).mean() > 0.9


REWRITINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "20 levels": lambda v: np.round(v * 20) / 20,
    "the root": lambda v: np.sqrt(v),
    "the root, rounded": lambda v: np.round(np.sqrt(v), 2),
    "the mean of five": lambda v: np.round(np.convolve(v, np.ones(5) / 5, "same"), 2),
    "another scale": lambda v: v * 255.0,
    "the number of the ring": lambda v: np.floor(np.arange(len(v)) * 64 / len(v)) / 63.0,
}


@pytest.mark.parametrize("name", REWRITINGS)
def test_reflectances_that_were_rewritten_everywhere_are_no_edit(name: str) -> None:
    points = street()
    values = REWRITINGS[name](reflectances(points)).astype(np.float32)
    found = authenticate.inspect(
        LidarFrame(points, values, origin=(0.0, 0.0, 0.0)), lattice=LATTICE
    )
    assert found.verdict == "processed"
    assert [step.kind for step in found.processing] == ["reflectances"]
    assert found.detectors[-1].verdict == "undecidable"


NO_SCENE: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "permuted": (np.random.default_rng(0).permutation, "nothing in common: they were permuted"),
    "inverted": (lambda v: 1.0 - v, "inverted"),
    "inverted, from the largest": (lambda v: v.max() - v, "inverted"),
    "inverted bytes": (lambda v: 255.0 - np.round(255.0 * v), "inverted"),
    "inverted in 16 bits": (lambda v: 65535.0 - np.round(65535.0 * v), "inverted"),
    "all 0": (np.zeros_like, "all reflectances are 0"),
    "all one value": (lambda v: np.full_like(v, 0.3), "all reflectances are 0.3"),
}


@pytest.mark.parametrize("name", NO_SCENE)
def test_reflectances_that_are_not_those_of_the_points_are_named(name: str) -> None:
    change, said = NO_SCENE[name]
    points = street()
    values = reflectances(points)
    values[np.linspace(0, len(values) - 1, 500).astype(int)] = 0.99  # as all frames of KITTI have
    found = authenticate.inspect(
        LidarFrame(points, change(values).astype(np.float32), origin=(0.0, 0.0, 0.0)),
        lattice=LATTICE,
    )
    assert found.verdict == "processed"
    assert [step.kind for step in found.processing] == ["reflectances"]
    assert said in found.reason


@pytest.mark.parametrize("end", [0.3, 0.4, 0.43, 0.517])
def test_clipped_reflectances_are_no_edit_and_a_painted_object_is(end: float) -> None:
    points = street()
    values = reflectances(points)
    values[np.linspace(0, len(values) - 1, 500).astype(int)] = 0.99  # as all frames of KITTI have

    def said(values: np.ndarray) -> Inspection:
        scan = LidarFrame(points, values.astype(np.float32), origin=(0.0, 0.0, 0.0))
        return authenticate.inspect(scan, lattice=LATTICE)

    assert said(values).verdict == "no_trace"
    found = said(np.minimum(values, np.float32(end)))
    assert found.verdict == "processed"
    assert found.reason.startswith("reflectances: reflectances ")
    painted = values.copy()
    painted[np.all(np.abs(points - [12.0, 3.0, -0.9]) < [3.0, 1.0, 0.6], axis=1)] = 0.6173
    assert said(painted).accusing is not None


def test_few_values_are_clipped_where_many_end_below() -> None:
    """Larger values get rarer slowly in a frame with many signs: 0.78, 0.79, and what is above."""
    usual = reflectances(street())
    usual = usual[usual <= 0.77]
    ends = np.repeat(np.float32([0.78, 0.79, 0.80, 0.99]), [90, 41, 40, 210])
    values = np.random.default_rng(0).permutation(np.concatenate([usual, ends]))
    assert why_rewritten(values) is None
    told = why_rewritten(np.minimum(values, np.float32(0.792)))
    assert told == "reflectances end at 0.792, which 250 points have: they were clipped"


def test_rewritten_values_are_told_where_every_eighth_row_has_none() -> None:
    values = reflectances(street())
    values[::8] = 0.0
    assert why_rewritten(values) is None
    assert why_rewritten(np.sqrt(values)) == "reflectances are no whole hundredths"


@functools.cache
def bright_street() -> LidarFrame:
    """A street in which many points are nearly as bright as KITTI's scanner tells."""
    pytest.importorskip("open3d")
    frame = simulate.hdl64e(simulate.street(rng=3), 4.0, rng=3).frame
    assert frame.intensity is not None
    values = frame.intensity.copy()
    values[np.linspace(0, len(values) - 1, 400).astype(int)] = np.repeat(
        np.arange(0.6, 1.0, 0.01).round(2), 10
    )
    return frame.replace(intensity=values.astype(np.float32))


@pytest.mark.parametrize(("most", "is_named"), [(1.0, False), (0.9, True), (0.7, True)])
def test_a_scan_without_its_bright_points_is_filtered(most: float, is_named: bool) -> None:
    frame = bright_street()
    assert frame.intensity is not None
    found = authenticate.inspect(frame.select(np.flatnonzero(frame.intensity < most)))
    assert found.verdict == ("processed" if is_named else "no_trace")
    details = [step.detail for step in found.processing]
    assert any("which" in each and "points come near" in each for each in details) is is_named


@pytest.mark.parametrize(("sectors", "is_named"), [(0, False), (2, False), (3, True), (12, True)])
def test_narrow_sectors_without_points_are_named(sectors: int, is_named: bool) -> None:
    frame = bright_street()
    azimuth = np.degrees(np.arctan2(*frame.points[:, 1::-1].T))
    away = np.abs(azimuth[:, None] - np.linspace(-150.0, 150.0, sectors)).min(axis=1, initial=9.0)
    found = authenticate.inspect(frame.select(np.flatnonzero(away > 0.2)))
    assert [step.detail for step in found.processing] == (
        [f"no points in {sectors} sectors of 0.2 degrees of azimuth and more"] if is_named else []
    )


NAMES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "turned": (lambda p: np.float32(p @ FLAT_TURN), "turned"),
    "turned by a part of a step": (
        lambda p: np.float32(p @ np.array([[1, -4e-4, 0], [4e-4, 1, 0], [0, 0, 1.0]])), "turned"),
    "shrunk": (lambda p: np.float32(p * 0.999), "scaled"),
    "noise of a tenth of a millimetre": (
        lambda p: np.float32(p + np.random.default_rng(0).normal(0, 1e-4, p.shape)), "moved"),
    "16 bits": (lambda p: p.astype(np.float16).astype(np.float32), "float16"),
    "three digits": (lambda p: in_digits(p, 3), "rounded"),
    "four digits": (lambda p: in_digits(p, 4), "rounded"),
    "centimetres from an offset": (
        lambda p: np.float32(np.round((p.astype(float) - 0.1234) * 100) / 100 + 0.1234), "rounded"),
    "cut": (lambda p: np.float32(np.trunc(p.astype(float) * 1000) / 1000), "rounded"),
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_only_a_turn_is_called_one(name: str) -> None:
    change, kind = NAMES[name]
    assert {step.kind for step in street_with(change).processing} == {kind}


def test_lines_through_the_origin_tell_no_scale() -> None:
    """Division by their offsets of 0 would make any change fit."""
    lattice = replace(LATTICE, offset=np.zeros_like(LATTICE.offset))
    points = scans.scan(np.random.default_rng(5), lattice)
    noise = np.random.default_rng(0).normal(0.0, 0.006, points.shape)
    found = authenticate.inspect(np.float32(points + noise), origin=(0, 0, 0), lattice=lattice)
    assert [step.kind for step in found.processing] == ["moved"]


def in_digits(points: np.ndarray, digits: int) -> np.ndarray:
    return np.array([float(f"{value:.{digits}g}") for value in points.ravel()], "f4").reshape(-1, 3)


def in_steps(points: np.ndarray, steps: np.ndarray, start: np.ndarray) -> np.ndarray:
    return np.float32(start + np.round((points.astype(float) - start) / steps) * steps)


LAWS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "two millimetres": (
        lambda p: np.float32(np.round(p.astype(float) * 500) / 500),
        "rounded: coordinates are whole numbers of 2 mm"),
    "millimetres from an offset": (
        lambda p: np.float32(np.round(p.astype(float) - 1.2344, 3) + 1.2344),
        "rounded: coordinates are whole steps of 1 mm from an offset"),
    "16 bits of the extent": (
        lambda p: in_steps(p, np.ptp(p.astype(float), axis=0) / 65535.0, p.min(axis=0)),
        "rounded: coordinates are whole steps of "),
    "parts of a metre that are powers of two": (
        lambda p: in_steps(p, np.full(3, 2.0**-10), np.zeros(3)),
        "rounded: coordinates are whole steps of 0.977 mm from an offset"),
    "steps of 9.7 mm": (
        lambda p: in_steps(p, np.full(3, 0.0097), np.full(3, 0.1234)),
        "rounded: coordinates are whole steps of 9.7 mm from an offset"),
    "cut to millimetres": (
        lambda p: np.float32(np.trunc(p * np.float32(1000)) / np.float32(1000)),
        "rounded: coordinates are "),
    "yards": (
        lambda p: np.float32(p / 0.9144), "scaled: coordinates are metres times 1.09"),
    "two turns": (
        lambda p: np.concatenate([p, p + np.float32([0.37, 0.21, 0.003])]),
        "points are more than a turn has"),
    "one point of ten": (
        lambda p: p[np.random.default_rng(0).random(len(p)) < 0.1],
        "thinned: fewer returns from the ground than a whole frame has"),
}  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_what_was_done_to_a_frame_of_kittis_scanner_is_said(name: str) -> None:
    change, words = LAWS[name]
    found = authenticate.inspect(change(simulated_street()), origin=(0, 0, 0))
    assert found.verdict == "processed"
    assert words in found.reason
    assert "no points in" not in found.reason
    assert "moved" not in {step.kind for step in found.processing} or name == "two turns"


def test_fine_steps_do_not_explain_points_that_lie_centimetres_away() -> None:
    stretched = simulated_street().astype(float) * [1.01, 1.0, 1.0]
    points = in_steps(stretched, np.full(3, 0.00013), np.full(3, 0.1234))
    found = authenticate.inspect(points, origin=(0, 0, 0))
    assert "moved" in {step.kind for step in found.processing}


@pytest.mark.parametrize(("step", "start"), [(0.00244, 0.3), (0.00015, -1.0), (0.0097, 5.0)])
def test_steps_of_coordinates_are_told(step: float, start: float) -> None:
    values = np.random.default_rng(0).normal(0.0, 12.0, 40_000).round(3)
    rounded = (start + np.round((values - start) / step) * step).astype(np.float32)
    assert _step_of(rounded) == pytest.approx(step, rel=1e-4)
    assert _step_of(rounded + np.float32(1e-4) * np.sin(values).astype(np.float32)) is None
    assert _step_of(rounded[:20]) is None
    assert _step_of(np.zeros(500, np.float32)) is None


def test_whole_numbers_of_another_unit_are_no_rounding() -> None:
    metres = np.random.default_rng(0).uniform(-60.0, 60.0, (5000, 3)).round(1).astype(np.float32)
    other = replace(authenticate.identify_sensor(metres), kind="spinning", name="other")
    (step,) = find_processing(metres, other, None)
    assert step.detail == "coordinates are whole numbers of 100 mm"
    assert find_processing((metres * 1000.0).round(), other, None) == ()


@pytest.mark.parametrize("sensor", ["auto", "terrestrial"])
def test_a_room_in_millimetres_is_not_judged_as_one_in_metres(sensor: str) -> None:
    assert authenticate.inspect(CAVE, sensor=sensor).verdict == "no_trace"
    for points in (CAVE * np.float32(1000.0), np.round(CAVE * np.float32(1000.0))):
        found = authenticate.inspect(points, sensor=sensor)
        assert found.verdict == "undecidable"
        assert "not in metres" in found.reason


def test_reflectances_of_the_scanner_are_not_called_rewritten() -> None:
    points = street()
    clean = reflectances(points)
    of_16_bits = clean.astype(np.float64) * 65535  # LAS has whole numbers, rounded or cut
    for values in (
        clean,
        np.round(clean * 255),
        np.round(clean * 255) / 255,
        np.round(of_16_bits),
        np.floor(of_16_bits),
    ):
        frame = LidarFrame(points, values.astype(np.float32), origin=(0.0, 0.0, 0.0))
        found = authenticate.inspect(frame, lattice=LATTICE)
        assert (found.verdict, found.processing) == ("no_trace", ())
    dark = authenticate.inspect(
        LidarFrame(points[clean > 0], clean[clean > 0], origin=(0.0, 0.0, 0.0)), lattice=LATTICE
    )
    assert dark.verdict == "processed"
    assert "filtered" in {step.kind for step in dark.processing}


@pytest.mark.parametrize(("place", "times"), [((0.0, 0.0, 0.0), 1), ((1.0, 2.0, 3.0), 2)])
def test_a_scan_around_the_origin_is_identified_once(
    place: tuple[float, float, float], times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scanner that was identified to find the position is not identified again."""
    asked: list[LidarFrame] = []

    def identify(scan: LidarFrame, **options: Any) -> Any:
        asked.append(scan)
        return identify_and_read(scan, **options)

    monkeypatch.setattr(_standpoint, "identify_and_read", identify)
    scan = LidarFrame(CAVE[: len(CAVE) // 6] + np.float32(place))
    found = authenticate.inspect(scan)
    assert found.verdict == "no_trace"
    assert found.origin == pytest.approx(place, abs=0.01)
    assert len(asked) == times
    stated = authenticate.inspect(scan, origin=place)
    assert found.sensor is not None
    assert stated.sensor is not None
    assert found.sensor.name == stated.sensor.name == "terrestrial scanner"
    assert [one.verdict for one in found.detectors] == [one.verdict for one in stated.detectors]


def test_a_grid_around_the_origin_is_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scan that has none there is no terrestrial scanner's; around another place it is looked
    for again."""
    asked: list[object] = []

    def ask(scan: LidarFrame, **options: Any) -> Any:
        asked.append(options["known"])
        return authenticate.estimate_origin(scan, **options)

    for module in (_inspect, _standpoint, _sensors):
        monkeypatch.setattr(module, "estimate_origin", ask)
    place, here = (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)
    two = np.concatenate([AHEAD, AHEAD + np.float32([2.0, 1.0, 0.3])])
    for points, stated, verdict, places in (
        (AHEAD, here, "no_trace", [here]),
        (AHEAD + np.float32(place), place, "no_trace", [here, place]),
        (two, here, "undecidable", []),  # they fill cells of the grid by chance
    ):
        asked.clear()
        assert authenticate.inspect(LidarFrame(points), origin=stated).verdict == verdict
        assert asked == places


def test_a_scan_on_its_side_is_not_taken_for_a_terrestrial_one() -> None:
    upright = authenticate.identify_sensor(CAVE)
    assert upright.kind == "terrestrial"
    on_its_side = authenticate.identify_sensor(np.ascontiguousarray(CAVE[:, [0, 2, 1]]))
    assert on_its_side.kind != "terrestrial"


def test_more_pasted_points_than_scanned_ones_do_not_hide_the_scanner() -> None:
    def paste(points: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(0)
        car = np.array([12.0, -4.0, -1.0]) + rng.uniform(-1, 1, (len(points) + 5000, 3))
        return np.concatenate([points, car.astype(np.float32)])

    found = street_with(paste)
    assert (found.verdict, found.processing) == ("tampered", ())
    np.testing.assert_allclose(found.regions[0].box.center, [12.0, -4.0, -1.0], atol=0.2)


@pytest.mark.parametrize("degrees", [2.0, 4.0])
def test_silence_straight_ahead_does_not_turn_a_frame(degrees: float) -> None:
    def drop(points: np.ndarray) -> np.ndarray:
        azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
        return points[(azimuth < 0.0) | (azimuth > degrees)]

    def turn(points: np.ndarray) -> np.ndarray:
        azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
        ring = LATTICE.read(points).ring
        return points[np.lexsort(((azimuth - degrees) % 360.0, ring))]

    def turned(points: np.ndarray) -> float:
        reading = LATTICE.read(points.astype(np.float32))
        return first_azimuth(reading.ring, reading.azimuth)

    assert abs(turned(street())) < 1.0
    assert turned(drop(street())) < 1.0
    assert turned(turn(street())) == pytest.approx(degrees, abs=0.3)


def test_the_least_azimuth_of_each_ring() -> None:
    random = np.random.default_rng(9)
    ring = random.integers(-1, 7, 500).astype(np.int32)
    ring[ring == 4] = 3  # a ring without points
    azimuth = random.uniform(0.0, 6.0, 500).astype(np.float32)
    expected = [min(azimuth[ring == k], default=np.inf) for k in range(8)]
    assert _least_of_rings(ring, azimuth, 8).tolist() == expected
    assert _least_of_rings(ring[:0], azimuth[:0], 2).tolist() == [np.inf, np.inf]


def street_above(cut: float) -> tuple[np.ndarray, Firings]:
    """Points of a street above a cut, and its firings."""
    points = street()
    points = points[points[:, 2] >= cut]
    firings = firings_of(LATTICE.read(points), len(LATTICE.slope))
    assert firings is not None
    return points.astype(np.float64), firings


def test_a_street_that_ends_at_a_round_height_is_not_cropped() -> None:
    points, firings = street_above(-9.0)
    lowest = np.sort(points[:, 2])[500]
    points[:, 2] = np.maximum(points[:, 2], lowest) - lowest - 1.8  # its lowest place is flat
    assert np.count_nonzero(points[:, 2] < -1.75) > 500
    assert is_cut_below(points, None)  # which firings answered is what tells
    assert not is_cut_below(points, firings)


@pytest.mark.parametrize("cut", [-1.7, -1.55, -1.0, 0.0, 0.53])
def test_a_crop_from_below_leaves_firings_silent(cut: float) -> None:
    points, firings = street_above(cut)
    assert np.count_nonzero(points[:, 2] < cut + 0.05) > 200
    assert is_cut_below(points, firings)


def flat_street() -> tuple[np.ndarray, Firings]:
    """A street whose lowest third is flat, 1.77 m below the scanner, at no round height."""
    points, firings = street_above(-9.0)
    flat = np.quantile(points[:, 2], 0.3)
    points[:, 2] = np.maximum(points[:, 2], flat) - flat - 1.77
    return points, firings


def lowest_of(points: np.ndarray) -> np.ndarray:
    """Return a mask of the points within 5 cm of the lowest one."""
    lowest: np.ndarray = points[:, 2] < points[:, 2].min() + 0.05
    return lowest


def silent_beside(firings: Firings, rows: np.ndarray, lower: int, on: int) -> Firings:
    """Return the firings with no return for the neighbours of some points."""
    answered = firings.answered.copy()
    rows = rows[firings.firing[rows] >= 0]
    columns = (firings.firing[rows] + on) % answered.shape[1]
    answered[np.clip(firings.ring[rows] + lower, 0, 63), columns] = False
    return firings._replace(answered=answered)


@pytest.mark.parametrize("where", ["far", "near"])
def test_silence_in_far_hollows_and_beside_the_own_car_is_no_crop(where: str) -> None:
    points, firings = flat_street()
    away = np.hypot(points[:, 0], points[:, 1])
    assert not is_cut_below(points, firings)
    there = away > 21.0 if where == "far" else away < 8.0
    rows = np.flatnonzero(lowest_of(points) & there)
    silent = silent_beside(silent_beside(firings, rows, 0, 1), rows, -1, 0)
    assert not is_cut_below(points, silent)
    rows = np.flatnonzero(lowest_of(points) & (away > 9.0) & (away < 19.0))
    assert is_cut_below(points, silent_beside(firings, rows, 0, 1))


def test_a_dark_car_above_the_lowest_points_is_no_crop() -> None:
    points, firings = flat_street()
    away = np.hypot(points[:, 0], points[:, 1])
    candidates = lowest_of(points) & (away > 9.0) & (away < 19.0)
    ring = np.bincount(firings.ring[candidates]).argmax()
    points[firings.ring != ring, 2] += 0.2
    rows = np.flatnonzero(candidates & (firings.ring == ring))
    assert len(rows) > 200
    assert not is_cut_below(points, silent_beside(firings, rows, -1, 0))
    assert is_cut_below(points, silent_beside(firings, rows, 1, 0))


@pytest.mark.parametrize("rings", [0, 1, 7, 40])
def test_a_file_that_ends_too_early_lacks_its_lowest_lasers(rings: int) -> None:
    points = closed_in()
    ring = LATTICE.read(points).ring
    found = authenticate.inspect(points[ring < 64 - rings], lattice=LATTICE)
    details = [step.detail for step in found.processing]
    said = "the lowest laser has" if rings == 1 else f"the lowest {rings} lasers have"
    assert (f"{said} nearly no returns" in details) == (rings > 0)
    assert found.verdict == ("processed" if rings else "no_trace")


@pytest.mark.parametrize("rings", [0, 1, 7, 8])
def test_a_file_that_begins_too_late_lacks_its_highest_lasers(rings: int) -> None:
    """Without the highest eighth it is cropped: what stands above the horizon was taken away."""
    points = closed_in()
    ring = LATTICE.read(points).ring
    found = authenticate.inspect(points[ring >= rings], lattice=LATTICE)
    said = "the highest laser has" if rings == 1 else f"the highest {rings} lasers have"
    details = [step.detail for step in found.processing]
    assert (f"{said} nearly no returns" in details) == (rings in (1, 7))
    assert ("the highest lasers have no returns" in details) == (rings == 8)
    assert found.verdict == ("processed" if rings else "no_trace")


def test_single_points_of_a_laser_hide_that_it_is_missing_only_of_an_unknown_unit() -> None:
    """The lowest laser of another unit than KITTI's may well meet its own carrier."""
    said = "the lowest 4 lasers have nearly no returns"
    for lattice, share in ((LATTICE, 0.0), (LATTICE, 0.01), (kitti_lattice(), 0.01)):
        points = scans.scan(np.random.default_rng(8), lattice)
        ring = lattice.read(points).ring
        kept = (ring < 60) | ((ring == 63) & (np.arange(len(ring)) % 100 < 100 * share))
        found = authenticate.inspect(points[kept], lattice=lattice)
        is_told = share == 0.0 or lattice is kitti_lattice()
        assert (said in [step.detail for step in found.processing]) == is_told


def closed_in() -> np.ndarray:
    """A frame between walls, 15 to 25 m away."""
    return scans.scan(np.random.default_rng(8))


def test_a_frame_between_walls_is_not_cropped() -> None:
    points = closed_in()
    assert np.linalg.norm(points, axis=1).max() < 30.0
    found = authenticate.inspect(points, lattice=LATTICE)
    assert (found.verdict, found.processing) == ("no_trace", ())


@pytest.mark.parametrize("cut", ["sphere", "box"])
def test_a_frame_that_was_cut_ends_in_silence(cut: str) -> None:
    points = closed_in()
    kept = np.linalg.norm(points, axis=1) < 14.0
    if cut == "box":  # its walls along x and behind stay as they are
        kept = points[:, 0] < 8.0
    found = authenticate.inspect(points[kept], lattice=LATTICE)
    assert found.verdict == "processed"
    assert "cropped: no points beyond" in found.reason


def reaching(far: np.ndarray) -> Inspection:
    """The inspection of a frame between walls, cut off at 14 m but for points at ranges `far`."""
    points = closed_in()
    reading = LATTICE.read(points)
    at = np.linalg.norm(points, axis=1)
    rows = np.flatnonzero((at > 14.0) & (reading.count >= 0))[::20][: len(far)]
    beams = scans.beam_points(LATTICE, reading.ring[rows], reading.count[rows], far)
    points[rows] = scans.rounded(beams)
    kept = (at < 14.0) | np.isin(np.arange(len(points)), rows)
    return authenticate.inspect(points[kept], lattice=LATTICE)


@pytest.mark.parametrize(("count", "is_cut"), [(150, False), (600, True)])
def test_a_frame_is_cut_at_a_range_where_points_thickly_lead_up_to_it(
    count: int, is_cut: bool
) -> None:
    found = reaching(np.random.default_rng(2).uniform(67.0, 77.0, count))
    details = [step.detail for step in found.processing]
    assert any("no points beyond" in detail for detail in details) == is_cut


@pytest.mark.parametrize("axis", [0, 1])
def test_a_strip_that_was_cut_out_is_named(axis: int) -> None:
    points = closed_in()
    row = np.argmax(points[:, 0])
    kept = np.abs(points[:, axis]) <= 8.0
    kept[row] = False
    details = [s.detail for s in authenticate.inspect(points[kept], lattice=LATTICE).processing]
    assert f"{'xy'[axis]} ends at 8.0 m on both sides" in details
    firings = firings_of(LATTICE.read(points), len(LATTICE.slope))
    assert not _is_cut_on_both_sides(points[:, axis].astype(np.float64), firings)


def test_lasers_silent_below_one_place_are_no_crop() -> None:
    """The end of a road leaves them silent in one direction, a crop in many."""
    points, firings = flat_street()
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    lowest = lowest_of(points) & (firings.firing >= 0)
    for width, is_cut in ((0.1, False), (2.0, True)):
        there = points.copy()
        there[~(np.abs(azimuth) < width), 2] += 0.2  # the lowest place lies ahead
        rows = np.flatnonzero(lowest & (np.abs(azimuth) < width))
        assert is_cut_below(there, silent_beside(firings, rows, 1, 0)) == is_cut


def test_what_cannot_be_told_of_an_end_counts_as_cut() -> None:
    points = closed_in()
    distance = np.linalg.norm(points.astype(np.float64), axis=1)
    firings = firings_of(LATTICE.read(points), len(LATTICE.slope))
    assert not ends_in_silence(distance, firings)
    assert ends_in_silence(distance, None)
    assert ends_in_silence(distance[:FARTHEST_POINTS], firings)


def test_the_detectors_of_a_frame_share_its_rate() -> None:
    assert sum(RATE_SHARES.values()) == pytest.approx(1.0)
    assert sum(map(rate_of, RATE_SHARES)) <= FALSE_ALARM_RATE * (1.0 + 1e-12)
    points = closed_in()
    values = np.random.default_rng(3).integers(0, 99, len(points)).astype(np.float32) / 100.0
    frame = LidarFrame(points, values)
    reading = LATTICE.read(points)
    away = np.linalg.norm(points.astype(np.float64), axis=1)
    before, after = (
        LidarFrame(
            scans.rounded(scans.beam_points(LATTICE, reading.ring, reading.count, away + more)),
            values,
        )
        for more in (0.1, 0.2)
    )
    found = authenticate.inspect(frame, previous=before, following=after, lattice=LATTICE)
    results = (found.generic, found.turns, found.reflectance)
    rates = [result.false_alarm_rate for result in results if result is not None]
    assert rates == pytest.approx([0.001, 0.007, 0.002])


def test_near_points_are_missed_where_the_lowest_lasers_are_silent() -> None:
    def cut(points: np.ndarray) -> np.ndarray:
        return points[np.hypot(points[:, 0], points[:, 1]) > 6.0]

    assert np.linalg.norm(street(), axis=1).min() > 2.5
    found = street_with(cut)
    assert found.verdict == "processed"
    assert "no points nearer than" in found.reason


def test_a_crop_takes_the_own_car_of_kitti_away() -> None:
    """Posts of its rack stand 1.5 to 1.9 m away in every frame; other scanners have another car.

    A wall that stands as near to the right stays where the rack is cut out.
    """
    known = kitti_lattice()
    whole = scans.scan(np.random.default_rng(8), known)
    reading = known.read(whole)
    post = np.flatnonzero((reading.ring == 62) & (abs(reading.count - 1380) < 10))
    reach = np.linspace(1.35, 1.6, len(post))
    whole[post] = scans.rounded(
        scans.beam_points(known, reading.ring[post], reading.count[post], reach)
    )
    wall = np.flatnonzero((reading.ring > 60) & (abs(np.degrees(reading.azimuth) - 270.0) < 3.0))
    assert len(wall) > 20
    whole[wall] = scans.rounded(
        scans.beam_points(known, reading.ring[wall], reading.count[wall], np.full(len(wall), 1.7))
    )
    whole = whole[scans.in_file_order(known, whole)]
    assert authenticate.inspect(whole).verdict == "no_trace"
    distance = np.linalg.norm(whole, axis=1)
    beside_rack = (np.abs(whole[:, :2]) > [2.5, 1.5]).any(axis=1)
    assert np.count_nonzero(distance[beside_rack] < 2.0) > 20
    for cut in (distance > 3.0, beside_rack):
        found = authenticate.inspect(whole[cut])
        assert found.verdict == "processed"
        assert found.reason == "cropped: the scanner's own car does not answer"
    other = authenticate.inspect(closed_in(), lattice=LATTICE)
    assert (other.verdict, other.processing) == ("no_trace", ())


def test_moved_object_is_found_with_a_tight_box() -> None:
    def move(points: np.ndarray) -> np.ndarray:
        rows = np.all(np.abs(points - [12.0, 3.0, -0.9]) < [3.0, 1.0, 0.6], axis=1)
        assert np.count_nonzero(rows) > 30
        moved.append(points[rows] + np.float32([1.3, 0.7, 0.0]))
        edited = points.copy()
        edited[rows] = np.round(moved[0] * 1000) / 1000
        return edited[scans.in_file_order(LATTICE, edited)]

    moved: list[np.ndarray] = []
    found = street_with(move)
    assert found.verdict == "tampered"
    assert found.p_value == 1.0 / 511.0  # so many clean frames support no less
    assert found.regions[0].p_value == 1.0 / 511.0
    assert found.likelihood_ratio == pytest.approx(0.5 * 511.0**0.5)
    assert found.score is not None
    assert found.score > 9.0
    box = found.regions[0].box
    low, high = moved[0].min(axis=0), moved[0].max(axis=0)
    assert np.prod(box.size[:2]) <= 1.2 * np.prod((high - low)[:2])
    assert box.contains(moved[0]).mean() > 0.8
    assert len(found.regions[0].rows)


@pytest.mark.parametrize("sensor", ["auto", "lattice", "terrestrial", "other"])
@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((5000, 3)),
        np.ones((5000, 3)),
        np.random.default_rng(0).normal(size=(3000, 3)),
        np.random.default_rng(2).uniform(-20, 20, (80_000, 3)),
        SPHERE,
        LATTICE.points_at(np.full(5000, 30), np.full(5000, 7), np.full(5000, 9.0)),
    ],
    ids=["empty", "zeros", "copies", "cloud", "room of dust", "sphere", "on the lattice"],
)
def test_degenerate_scans_are_undecidable(points: np.ndarray, sensor: str) -> None:
    scan = points.astype(np.float32)
    found = authenticate.inspect(scan, origin=(0, 0, 0), lattice=LATTICE, sensor=sensor)
    assert found.verdict == "undecidable"


def test_a_stated_scanner_is_believed_where_the_scan_can_be_one_of_it() -> None:
    for cloud, verdict in ((CAVE, "no_trace"), (FORGED, "tampered"), (street(), "undecidable")):
        found = authenticate.inspect(cloud, origin=(0, 0, 0), sensor="terrestrial")
        assert found.verdict == verdict


def test_unknown_scanner_is_refused() -> None:
    with pytest.raises(InputError, match="sensor: expected one of auto, lattice"):
        authenticate.inspect(CAVE, sensor="VLP-16")


def test_suspected_rows_are_a_table(tmp_path: Path) -> None:
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    report.write_suspected_rows(found, tmp_path / "rows.csv")
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert lines[0] == "row,x,y,z,detector,region,p_value,note"
    assert {int(line.split(",")[0]) for line in lines[1:]} == set(found.suspected.tolist())


def test_points_beside_a_seam_are_noted(tmp_path: Path) -> None:
    """Points of another turn of the same unit contradict firings on both sides of the seam."""
    rows = np.arange(3)
    box = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    seam, paste = (
        Region(box, rows, 0.01, evidence) for evidence in ({"firing": 3.0}, {"line": 3.0})
    )
    assert "which side" in seam.record()["note"]
    assert (paste.note, paste.record()["note"]) == ("", "")
    assert Region(box, rows, 0.01, {"firing": 3.0, "order": 3.0}).note == ""
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    report_of = replace(found.detectors[2], verdict="tampered", regions=(seam, paste))
    found = replace(found, detectors=(report_of,))
    report.write_suspected_rows(found, tmp_path / "rows.csv")
    notes = [line.split(",")[-1] for line in (tmp_path / "rows.csv").read_text().splitlines()]
    assert notes == ["note", *[seam.note] * 3, *[""] * 3]
    report.write_evidence(found, tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text().count(seam.note) == 1


def test_an_object_may_stand_before_the_inserted_one(tmp_path: Path) -> None:
    """Only the nearer points are suspected, although either of the two may have been inserted."""
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    occluding = found.detectors[1]
    assert occluding.verdict == "tampered"
    assert {region.note for region in occluding.regions} == {OF_OCCLUSION}
    assert all(region.evidence["occluding"] > 0.0 for region in occluding.regions)
    report.write_suspected_rows(found, tmp_path / "rows.csv")
    rows = (tmp_path / "rows.csv").read_text().splitlines()
    assert any(row.endswith(OF_OCCLUSION) for row in rows)
    console = Console(record=True, width=200)
    show(console, found)
    assert console.export_text().count(OF_OCCLUSION) == 1


def test_suspected_rows_are_those_of_the_file(tmp_path: Path) -> None:
    path, table = tmp_path / "scan.pcd", tmp_path / "rows.csv"
    stored = np.concatenate([np.full((1000, 3), np.nan, np.float32), FORGED])
    path.write_bytes(
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        b"WIDTH %d\nHEIGHT 1\nPOINTS %d\nDATA binary\n"
        % (len(stored), len(stored))
        + stored.tobytes()
    )
    found = authenticate.inspect(io.read_scan(path), origin=(0, 0, 0))
    assert found.verdict == "tampered"
    report.write_suspected_rows(found, table)
    for line in table.read_text().splitlines()[1:50]:
        row, *place = line.split(",")[:4]
        np.testing.assert_allclose(stored[int(row)], np.float32(place), atol=1e-4)


@pytest.mark.parametrize("has_new", [False, True])
def test_suspected_rows_of_a_scan_with_new_points_are_those_of_the_scan(
    tmp_path: Path, has_new: bool
) -> None:
    """A selected scan has the rows of its file; points of no file have rows in the scan only."""
    first = LidarFrame(np.concatenate([np.ones((1000, 3), np.float32), FORGED]))
    scan = first.select(np.arange(1000, first.num_points))
    if has_new:
        source_index = np.r_[np.arange(len(FORGED) - 1), -1]
        scan = scan.with_points(FORGED, source_index=source_index)
    found = authenticate.inspect(scan, origin=(0, 0, 0))
    report.write_suspected_rows(found, tmp_path / "rows.csv")
    lines = (tmp_path / "rows.csv").read_text().splitlines()[1:]
    rows = found.suspected if has_new else found.suspected + 1000
    assert {int(line.split(",")[0]) for line in lines} == set(rows.tolist())


def test_a_scan_without_a_position_is_undecidable() -> None:
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    assert found.verdict == "undecidable"
    assert found.origin is None
    assert found.density is None
    assert {report.verdict for report in found.detectors} == {"undecidable"}
    assert found.detectors[0].reason == found.origin_from == "the scan has no points"


def test_a_bad_position_is_named() -> None:
    with pytest.raises(InputError, match="origin: expected three finite numbers"):
        authenticate.inspect(CAVE, origin=(0, 0))


def test_the_evidence_is_one_page_or_json(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    page, numbers = tmp_path / "evidence.html", tmp_path / "evidence.json"
    report.write_evidence(found, page, source="<b>cave</b>")
    text = page.read_text()
    assert_accessible(text)
    assert text.count("data:image/png;base64,") == 3  # both detectors' maps, and the regions
    assert "manip3d " in text
    assert "&lt;b&gt;cave" in text
    assert "<b>cave" not in text
    loads = re.compile(r"""(src|href)\s*=\s*(["']|&quot;|&#x27;)?https?:""")
    assert not loads.search(text)  # it loads nothing
    report.write_evidence(found, numbers, source="cave")
    record = json.loads(numbers.read_text())
    assert record["source"] == "cave"
    assert record["verdict"] == "tampered"
    assert record["points_id"] == authenticate.points_id(FORGED)
    with pytest.raises(InputError, match="output: expected a name that ends in"):
        report.write_evidence(found, tmp_path / "evidence.pdf")


def test_printed_thresholds_accuse_terrestrial_scans_only() -> None:
    for frame, options, verdict in (
        (FORGED, {"origin": (0, 0, 0)}, "tampered"),
        (street(), {"lattice": LATTICE}, "undecidable"),
        (street(), {"origin": (0, 0, 0), "sensor": "other"}, "undecidable"),
    ):
        assert authenticate.inspect(frame, printed=True, **options).verdict == verdict
    found = authenticate.inspect(street(), lattice=LATTICE, printed=True)
    assert "the printed thresholds are those of terrestrial scanners" in found.reason


@pytest.mark.parametrize("left_out", ["a third", "at random"])
def test_a_thinned_scan_says_what_share_is_missing(left_out: str) -> None:
    scan = on_a_street(3)
    rows = np.arange(scan.num_points)
    at_random = np.random.default_rng(7).random(len(rows)) > 0.1
    kept = rows % 3 != 0 if left_out == "a third" else at_random
    steps = authenticate.inspect(scan.select(np.flatnonzero(kept))).processing
    (step,) = (each for each in steps if each.kind == "thinned")
    share = float(step.detail.partition("%")[0])
    assert share == pytest.approx(100.0 * (1.0 - kept.mean()), abs=1.5), step.detail
    assert "left out of the file, or lost by rain, snow, fog or a wet road" in step.detail


@pytest.mark.parametrize("per_metre", [0.01, 0.04])
def test_returns_lost_in_rain_are_no_cut_of_the_level_ground(per_metre: float) -> None:
    """The farther a return, the more often it is lost, as in rain or fog; a real cut is named."""
    scan = on_a_street(31)  # whose road is level
    distance = np.linalg.norm(scan.points, axis=1)
    kept = np.random.default_rng(7).random(len(distance)) < np.exp(-per_metre * distance)
    found = authenticate.inspect(scan.select(np.flatnonzero(kept)), power=False)
    assert [step.kind for step in found.processing] == ["thinned"]
    cut = scan.select(np.flatnonzero(kept & (scan.points[:, 2] > -1.6)))
    found = authenticate.inspect(cut, power=False)
    assert "no points below a height of -1.60 m" in {step.detail for step in found.processing}


def test_a_scan_that_lost_far_returns_by_chance_is_thinned() -> None:
    """The share that is lost grows from none at 20 m to all at 100 m, as in simulated fog."""
    scan = on_a_street(0)
    distance = np.linalg.norm(scan.points, axis=1)
    kept = np.random.default_rng(7).random(len(distance)) > (distance - 20.0) / 80.0
    assert "thinned" not in {step.kind for step in authenticate.inspect(scan).processing}
    found = authenticate.inspect(scan.select(np.flatnonzero(kept)))
    assert found.verdict == "processed"
    assert "farther than 25 m are missing one by one" in found.reason
