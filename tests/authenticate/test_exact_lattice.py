"""Lattices of clouds that nobody rounded: every point of a clean one is on them, edits are not."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

import exact_scans
from exact_scans import Unit, exact_scan, hesai, in_polar_steps, ouster, velodyne
from manip3d import FormatError, InputError, LidarFrame, capture, io
from manip3d.authenticate import (
    Inspection,
    Power,
    SensorLattice,
    calibrate_lattice,
    estimate_lattice,
    generic_consistency,
    identify_sensor,
    inspect,
    kitti_lattice,
    measure_power,
)
from manip3d.authenticate._exact_lattice import (
    _exact_steps,
    _fit_beside,
    _one_below_the_other,
)
from manip3d.authenticate._lattice_steps import first_encoders, off_the_steps
from manip3d.authenticate._power import (
    BLIND_ALONG_RAYS,
    BLIND_COPIED,
    BLIND_CUT_ELSEWHERE,
    BLIND_EXACT,
    BLIND_EXACT_WITHOUT_STEPS,
    BLIND_OTHER_SCAN,
    BLIND_TURNED,
    BLIND_TURNED_ANYHOW,
    BLIND_WHOLE_STEPS,
)
from manip3d.authenticate._processing import edge_of_voxels
from manip3d.authenticate._sensors import BEAMS
from manip3d.cli.inspect import show
from manip3d.report import write_evidence
from real_data import RealData

UNITS = {"hesai": hesai(), "ouster": ouster()}
Points = NDArray[np.float32]


@pytest.fixture(params=UNITS)
def unit(request: pytest.FixtureRequest) -> Unit:
    return UNITS[request.param]


def without_labels(points: Points) -> LidarFrame:
    return LidarFrame(np.ascontiguousarray(points, np.float32), origin=(0.0, 0.0, 0.0))


def said(frame: LidarFrame, **more: int) -> Inspection:
    return inspect(frame, power=bool(more), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("points", [8, 9, 20])
def test_a_line_that_no_point_is_exactly_on_is_none_of_a_laser(points: int) -> None:
    scan = exact_scan(ouster(), labelled=True)  # an Ouster whose lowest laser sees its own case
    assert scan.ring is not None
    lowest = np.flatnonzero(scan.ring == scan.ring.max())
    there = np.ones(scan.num_points, bool)
    there[lowest[points:]] = False
    moved = scan.points.copy()
    moved[lowest[:points], 2] += np.resize([-6e-4, 6e-4], points)
    lattice = estimate_lattice(
        LidarFrame(moved[there], ring=scan.ring[there], origin=(0.0, 0.0, 0.0))
    )
    assert lattice.is_exact
    assert np.isfinite([lattice.slope_error, lattice.center]).all()
    slope = np.tan(np.radians(ouster().elevation))
    np.testing.assert_allclose(lattice.slope[:31], slope[:31], atol=2e-6)
    assert (lattice.slope_error[31:] > 1e-4).all()  # one point tells no slope


@pytest.mark.parametrize("seed", [1, 2, 4, 6])
def test_a_laser_that_meets_two_walls_only_has_its_own_lateral_distance(seed: int) -> None:
    """58 points at 4.4 and 9.1 m, as an OS0-8's highest laser had: two distances explain them."""
    random = np.random.default_rng(seed)
    steps = 2048
    rho = [random.uniform(2.0, 40.0, 400) for _ in range(7)]
    walls = random.normal(4.42, 0.045, 12), random.normal(9.11, 0.11, 44)
    rho.append(np.concatenate([[0.75], *walls, [10.73]]))
    lateral, azimuth = random.uniform(0.004, 0.006, 8), random.uniform(0.0, 2e-3, 8)
    ring = np.repeat(np.arange(8), [len(each) for each in rho])
    far = np.concatenate(rho)
    count = random.integers(0, steps, len(far))
    angle = azimuth[ring] + 2.0 * np.pi / steps * count + np.arcsin(lateral[ring] / far)
    angle = np.mod(angle + random.normal(0.0, 2e-7, len(far)), 2.0 * np.pi)
    members = [np.flatnonzero(ring == k) for k in range(8)]
    found = _exact_steps(far, angle, np.zeros(len(far), np.intp), members)
    assert found[0] == steps
    np.testing.assert_allclose(found[1], lateral, atol=1e-5)


@pytest.mark.parametrize("seed", [317, 323, 330, 334])
def test_the_fit_of_a_laser_goes_on_until_it_stands(seed: int) -> None:
    """Points mostly near, as half of those of an OS1-128's laser were."""
    random = np.random.default_rng(seed)
    steps = 2048
    far = random.normal(18.0, 3.0, 120).clip(5.0), random.normal(40.0, 4.0, 130).clip(20.0)
    rho = np.concatenate([random.uniform(0.55, 0.9, 80), random.normal(10.0, 1.2, 400),
                          random.normal(12.5, 1.0, 300), *far])  # fmt: skip
    lateral, azimuth = random.uniform(-0.006, 0.006), random.uniform(0.0, 2.0 * np.pi / steps)
    angle = azimuth + 2.0 * np.pi / steps * random.integers(0, steps, len(rho))
    angle = np.mod(angle + np.arcsin(lateral / rho), 2.0 * np.pi)
    (start,) = first_encoders(rho, angle, [np.arange(len(rho))], steps)
    found = _fit_beside(rho, angle, steps, *start)
    assert np.abs(off_the_steps(rho, angle, *found, steps)).max() < 1e-5


@pytest.mark.parametrize("labelled", [False, True])
def test_the_lattice_of_an_exact_scan(unit: Unit, labelled: bool) -> None:
    scan = exact_scan(unit, labelled=labelled)
    lattice = estimate_lattice(scan)
    assert lattice.is_exact
    assert lattice.tolerance == 1e-4
    np.testing.assert_allclose(lattice.slope, np.tan(np.radians(unit.elevation)), atol=2e-6)
    assert lattice.steps == unit.columns if unit.is_by_ring else 3600  # 0.1 degrees hold all
    assert lattice.range_step == unit.step
    off, up = unit.start
    beside = off * np.sin(np.radians(unit.beside))
    np.testing.assert_allclose(lattice.lateral, -beside, atol=5e-5)
    along = off * np.cos(np.radians(unit.beside))
    np.testing.assert_allclose(lattice.offset, up - lattice.slope * along, atol=3e-5)
    reading = lattice.read(scan.points)
    assert np.abs(reading.line_error).max() < 1e-5
    assert np.abs(reading.step_error).max() < 2e-5
    assert np.abs(reading.range_error).max() < 2e-5


@pytest.mark.parametrize("millimetres", [10.0, 5.0, 4.0, 2.5, 2.0, 1.0])
def test_the_range_step_is_found(millimetres: float) -> None:
    scan = exact_scan(replace(hesai(), step=millimetres / 1000.0))
    assert estimate_lattice(scan).range_step == millimetres / 1000.0


def test_a_step_fits_the_scans_of_all_start_angles() -> None:
    """Steps of 0.02 degrees fit five of the scans, and no point of the sixth."""
    unit = replace(velodyne(), is_stepped=True, beside=np.full(16, 0.1))
    starts = [0, 2, 4, 6, 8, 5]  # counts of 0.01 degrees
    clean = [exact_scan(unit, seed, labelled=True) for seed in range(len(starts))]
    scans = [
        scan.replace(points=turned(scan.points, 0.01 * start))
        for scan, start in zip(clean, starts, strict=True)
    ]
    lattice = estimate_lattice(scans)
    assert lattice.steps == 36_000
    assert all(identify_sensor(scan, lattice=lattice).lattice is lattice for scan in scans)


COLUMNS = np.arange(1200)
SLIPS = {
    "one column": 0.01 * (COLUMNS == 400),
    "three columns": -0.01 * np.isin(COLUMNS, (400, 401, 950)),
    "a twentieth": 0.01 * (np.random.default_rng(1).random(1200) < 0.05),
    "an arc": 0.02 * ((COLUMNS > 500) & (COLUMNS < 530)),
}


@pytest.mark.parametrize("slips", SLIPS.values(), ids=SLIPS)
def test_columns_that_slipped_by_a_count_accuse_nobody(slips: NDArray[np.float64]) -> None:
    """Drivers state the azimuths of some columns 0.01 degrees beside their steps of 0.1."""
    scan = exact_scan(replace(hesai(), beside=hesai().beside + 0.005), slips_deg=slips)
    found = said(scan)
    assert (found.verdict, found.processing) == ("undecidable", ())
    assert found.sensor is not None
    assert found.sensor.lattice is not None
    assert found.sensor.lattice.steps == (18_000 if slips.max() > 0.01 else 36_000)


def test_slipped_columns_do_not_contradict_a_lattice_of_other_scans() -> None:
    clean, scan = (exact_scan(hesai(), seed, slips_deg=seed * SLIPS["an arc"]) for seed in (0, 1))
    lattice = estimate_lattice(clean)
    assert lattice.steps == 3600
    sensor = identify_sensor(scan, lattice=lattice)
    assert sensor.lattice is not None
    assert sensor.lattice.steps == 18_000
    assert np.array_equal(sensor.lattice.slope, lattice.slope)


def test_edits_beside_slipped_columns_are_found() -> None:
    points = exact_scan(hesai(), slips_deg=SLIPS["a twentieth"]).points.copy()
    rows = np.flatnonzero(on_post(points))
    points[rows] += np.float32([0.5, 0.3, 0.0])
    found = said(without_labels(points))
    assert found.verdict == "tampered"
    assert len(found.suspected) > 0.85 * len(rows)


@pytest.mark.parametrize("degrees", [0.03, 33.37])
def test_an_object_turned_by_finer_steps_is_no_slip_of_columns(degrees: float) -> None:
    """Other lasers of its columns stand where they should."""
    points = exact_scan(hesai()).points.copy()
    rows = np.flatnonzero(on_post(points))
    points[rows] = turned(points[rows], degrees)
    found = said(without_labels(points))
    assert found.verdict == "tampered"
    assert set(found.suspected.tolist()) <= set(rows.tolist())


def test_an_object_on_open_land_is_no_slip_of_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """All lasers that return anything meet it, and nothing around contradicts it but its edges."""
    unit = replace(hesai(), elevation=np.linspace(3.0, -16.3, 32))
    monkeypatch.setattr("exact_scans.WALLS", (300.0, 300.0))
    donor = exact_scan(unit, 2).points
    thing = turned(donor[on_post(donor) & (donor[:, 2] < 0.2)], 30.05)
    monkeypatch.setattr("exact_scans.POST", (200.0, 200.0, 0.1))
    land = exact_scan(unit, 1).points
    land = land[np.linalg.norm(land, axis=1) < 60.0]
    azimuth, taken = (np.degrees(np.arctan2(p[:, 1], p[:, 0])) for p in (land, thing))
    free = (azimuth < taken.min() - 1.0) | (azimuth > taken.max() + 1.0)
    found = said(without_labels(np.concatenate([land[free], thing])))
    assert found.verdict == "tampered"
    assert len(found.suspected) > 0.85 * len(thing)
    assert found.suspected.min() >= np.count_nonzero(free)


def test_a_wall_at_coarse_ranges_is_no_fill_value() -> None:
    """A round wall whose farthest step of 8 mm holds several returns of each laser."""
    scan = exact_scan(hesai(64))
    towards = scan.points / np.linalg.norm(scan.points, axis=1, keepdims=True)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (scan.num_points, 1)).clip(-0.02, 0.02)
    reach = (np.rint((8.0 + noise) / 0.008) * 0.008).astype(np.float32)
    wall = (towards * reach).astype(np.float32)
    found = said(without_labels(wall))
    assert "64 lasers" in found.sensor.name, found.record()
    assert found.processing == ()
    filled = wall.copy()
    filled[::9] = towards[::9] * np.float32(50.0)
    assert [step.kind for step in said(without_labels(filled)).processing] == ["padded"]


def test_lines_between_lasers_are_left_out() -> None:
    """Moved points may lie on a line of their own, steeper or flatter than those around it."""
    slope = np.array([0.02, 0.01, -0.011, -0.001, -0.012, -0.012, -0.02])
    on = [np.arange(number) for number in (900, 800, 30, 900, 700, 20, 900)]
    assert _one_below_the_other(slope, on) == [0, 1, 3, 4, 6]
    assert _one_below_the_other(slope[::-1], on[::-1]) == [0]
    assert _one_below_the_other(slope[:0], []) == []


@pytest.mark.parametrize("rows_later", [1, 20, None])
def test_firings_that_a_scanner_tells_twice_are_no_repetition(rows_later: int | None) -> None:
    """Two firings of a laser may have one azimuth and one range; copies elsewhere were put in."""
    scan = exact_scan(hesai(), labelled=True)
    rows = np.arange(1000, 3000, 100)
    order = np.arange(scan.num_points)
    places = len(order) if rows_later is None else rows + rows_later
    found = said(scan.select(np.insert(order, places, rows)))
    kinds = [step.kind for step in found.processing]
    assert kinds == (["repeated"] if rows_later is None else [])
    many = said(scan.select(np.insert(order, [1001] * 5, 1000)))
    assert [step.kind for step in many.processing] == ["repeated"]


@pytest.mark.parametrize("second_returns", [0.0, 0.1])
def test_both_returns_of_each_firing_are_no_repetition(second_returns: float) -> None:
    """Some drivers write the only return of a firing twice, in two rows beside each other."""
    first = exact_scan(hesai(), labelled=True)
    rows = np.repeat(np.arange(first.num_points), 2)
    points = first.points[rows]
    is_second = np.arange(len(rows)) % 2 == 1
    others = is_second & (np.random.default_rng(0).random(len(rows)) < 2.0 * second_returns)
    away = points / np.linalg.norm(points, axis=1, keepdims=True)
    points[others] += np.float32(1.0) * away[others]
    found = said(first.select(rows).replace(points=points))
    assert (found.verdict, found.processing) == ("undecidable", ())
    assert found.sensor is not None
    assert found.sensor.reason.endswith("equal rows were judged as one return")
    moved = points.copy()
    moved[on_post(moved)] += np.float32([0.5, 0.3, 0.0])
    assert said(without_labels(moved)).verdict == "tampered"
    apart = np.r_[rows[::2], rows[::2]]  # all points again behind the last one
    elsewhere = said(first.select(apart))
    assert [step.kind for step in elsewhere.processing] == ["repeated"]


def test_no_scanner_has_hundreds_of_lasers() -> None:
    """Elevations that were rounded to a step; a few points between two of them are no edit."""
    random = np.random.default_rng(0)
    number, turn = 140, 360
    slope = np.repeat(np.tan(1e-3 * np.arange(70, 70 - number, -1)), turn)
    azimuth = np.tile(np.radians(np.arange(turn)), number)
    rho = random.uniform(3.0, 60.0, number * turn)
    points = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), rho * slope], axis=1)
    ring = np.repeat(np.arange(number), turn)
    scan = LidarFrame(points.astype(np.float32), ring=ring, origin=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"spinning scanner \(4 to 128\).*found 140 lines"):
        estimate_lattice(scan)
    whole = scan.select(np.flatnonzero(ring < 128))
    assert len(estimate_lattice(whole).slope) == 128


def test_rounded_scans_are_not_exact(unit: Unit) -> None:
    scan = exact_scan(unit, labelled=True)
    for decimals in (3, 4):
        rounded = scan.replace(points=scan.points.round(decimals).astype(np.float32))
        assert estimate_lattice(rounded).is_exact is (decimals == 4)
    noisy = scan.points + np.random.default_rng(0).normal(0.0, 1e-3, scan.points.shape)
    assert not estimate_lattice(scan.replace(points=noisy.astype(np.float32))).is_exact
    assert not kitti_lattice().is_exact


def with_digits(scan: LidarFrame, digits: int) -> LidarFrame:
    """The scan as a text with so many significant digits holds it."""
    texts = np.char.mod(f"%.{digits}g", scan.points.astype(np.float64))
    return scan.replace(points=texts.astype(np.float64).astype(np.float32))


@pytest.mark.parametrize("digits", [4, 5, 6, 8])
def test_texts_of_few_digits_accuse_nobody(unit: Unit, digits: int) -> None:
    """Text with five digits, MATLAB's default, has whole millimetres from 10 m on: no edit."""
    for labelled in (False, True):
        scan = exact_scan(unit, labelled=labelled)
        assert np.abs(scan.points).max() > 10.0
        found = said(with_digits(scan, digits))
        assert found.verdict != "tampered"
        words = {4: ["four"], 5: ["five"]}.get(digits, [])
        named = [f"coordinates have {word} significant digits" for word in words]
        assert [step.detail for step in found.processing] == named


def test_five_digits_are_exact_within_ten_metres() -> None:
    whole = exact_scan(UNITS["ouster"], labelled=True)
    assert whole.ring is not None
    is_low = whole.ring >= 19  # lasers above see the post alone within ten metres
    within = is_low & (np.abs(whole.points).max(axis=1) < 10.3)
    scan = with_digits(whole.select(np.flatnonzero(within)), 5)
    lattice = estimate_lattice(scan)
    assert lattice.is_exact
    near = np.abs(scan.points).max(axis=1) < 10.0
    assert 0 < np.count_nonzero(~near) < 0.1 * scan.num_points
    assert lattice.is_told_exactly(scan).tolist() == near.tolist()
    found = said(scan)  # as long as all of them were judged, the few farther ones accused it
    assert (found.verdict, len(found.suspected)) == ("processed", 0)


def test_a_laser_half_way_between_rounded_azimuths_accuses_nobody() -> None:
    """Rounding takes its points to either side, as single precision has it."""
    beside = hesai().beside + np.where(np.arange(32) == 15, 0.005, 0.0)
    scan = exact_scan(replace(hesai(), beside=beside), labelled=True)
    x, y, _ = scan.points.T
    assert scan.ring is not None
    sees = (scan.ring != 15) | ((x > 0.0) & (np.abs(y - 2.0) < 0.5))  # little, as over a roof
    rounded = without_labels(in_polar_steps(scan.points[sees], 0.002, 0.01, 0.0))
    found = said(rounded)
    assert found.verdict == "undecidable"
    assert found.generic is not None  # it stands on a lattice, by which edits are still found
    moved = rounded.points.copy()
    moved[on_post(moved)] += np.float32([0.4, 0.3, 0.0])
    assert said(without_labels(moved)).verdict == "tampered"


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("hesai_qt64", (0.002, 0.01, math.degrees(1e-4))),
        ("hesai_xt32", (0.001, 0.005, 0.001)),
        ("ouster_os1_32", (0.005, 0.02, 0.0)),
    ],
)
@pytest.mark.realdata
def test_real_scans_in_polar_steps(
    name: str, steps: tuple[float, float, float], realdata: RealData
) -> None:
    """Lasers half-way between two elevations, too, and ranges seen from beside the beams' foot."""
    scan = io.read_scan(realdata("lidar/other_sensors") / f"{name}.pcd.xz")
    assert said(without_labels(in_polar_steps(scan.points, *steps))).verdict != "tampered"


def test_azimuths_between_packets_have_no_steps() -> None:
    """Lines and ranges tell edits alone; what names no rings is not judged."""
    scan = exact_scan(velodyne(), labelled=True)
    lattice = estimate_lattice(scan)
    assert (lattice.is_exact, lattice.steps, lattice.range_step) == (True, 0, 0.002)
    assert len(lattice.slope) == 16
    clean = said(scan)
    assert clean.verdict == "undecidable"
    assert clean.sensor is not None
    assert clean.sensor.reason == "its points stand on 16 lines and whole ranges of 2 mm"
    points = scan.points.copy()
    rows = np.flatnonzero(on_post(points))
    points[rows] += np.float32([0.5, 0.3, 0.0])
    found = said(scan.replace(points=points))
    assert found.verdict == "tampered"
    assert set(found.suspected.tolist()) <= set(rows.tolist())
    assert len(found.suspected) > 0.8 * len(rows)
    assert said(without_labels(points)).verdict == "undecidable"


def test_lines_that_a_model_lacks_are_of_another_one() -> None:
    """A VLP-32C of which five lasers look elsewhere, as those of a scanner of another maker."""
    lines = BEAMS["VLP-32C"].copy()
    unit = replace(hesai(), elevation=np.sort(lines)[::-1])
    clean = said(exact_scan(unit, labelled=True)).sensor
    assert clean is not None
    assert clean.name == "VLP-32C"
    lines[[1, 2, 3, 4, 5]] += 1.0
    other = replace(unit, elevation=np.sort(lines)[::-1])
    found = said(exact_scan(other, labelled=True)).sensor
    assert found is not None
    assert found.name == "scanner of at least 32 lasers"


@pytest.mark.parametrize(("lasers", "name"), [
    (16, "VLP-16"), (32, "scanner of at least 32 lasers"), (14, "scanner of at least 14 lasers"),
])  # fmt: skip
def test_the_lines_of_the_lattice_name_the_model(lasers: int, name: str) -> None:
    scan = exact_scan(velodyne(lasers), labelled=True)
    clean = said(scan).sensor
    assert clean is not None
    assert clean.name == name
    points = scan.points.copy()
    rows = np.flatnonzero(on_post(points))
    points[rows] += np.float32([0.5, 0.3, 0.0])
    edited = said(scan.replace(points=points)).sensor
    assert edited is not None
    assert edited.name == name


@pytest.mark.parametrize("second_returns", [0.0, 0.1])
def test_a_clean_scan_is_never_accused(unit: Unit, second_returns: float) -> None:
    for seed in range(4):
        scan = exact_scan(unit, seed, labelled=bool(seed % 2), second_returns=second_returns)
        found = said(scan)
        assert found.verdict == "undecidable"
        assert "was not measured for this scanner" in found.reason
        assert found.sensor is not None
        assert found.sensor.kind == "lattice"
        assert f"ranges of {1000 * unit.step:g} mm" in found.sensor.reason


def test_edits_planted_in_it_are_all_that_is_known_of_its_power(unit: Unit) -> None:
    found = said(exact_scan(unit), plant=2)
    assert found.verdict == "no_trace"
    assert found.power["moved"].found == found.power["moved"].planted == 2
    assert found.power["moved"].source == "edits planted in this scan"
    assert (found.power["moved"].here_found, found.power["moved"].here_planted) == (2, 2)
    console = Console(record=True, width=300)
    show(console, found)
    shown = console.export_text()
    assert "edits of this class" in shown
    assert "planted in this scan" in shown
    assert "planted in clean scans" not in shown
    assert "not found; a watermark shows it" in shown
    assert found.power["turned on steps"].found == 0
    elsewhere = exact_scan(unit).points + np.float32(0.5)
    assert said(without_labels(elsewhere), plant=2).verdict == "undecidable"


def test_few_found_edits_are_the_reason_of_an_undecidable_scan(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def few(*_: object, **__: object) -> dict[str, Power]:
        return {"added": Power(9, 20), "moved": Power(0, 20)}

    monkeypatch.setattr("manip3d.authenticate._inspect.measure_power", few)
    found = said(exact_scan(hesai()), plant=20)
    assert found.verdict == "undecidable"
    assert (found.power["added"].found, found.power["added"].here_found) == (9, 9)
    assert found.reason == (
        "detector III finds fewer than half of the edits of each class that were planted in this "
        "scan"
    )
    assert not any("was not measured" in each.reason for each in found.detectors)
    write_evidence(found, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "edits planted in this scan" in page
    assert "<td>9 of 20 in this scan</td>" in page
    assert "<td>9 of 20;" not in page


def test_thresholds_that_no_scan_chose_are_told_as_such(tmp_path: Path) -> None:
    found = said(exact_scan(hesai()))
    calibration = found.detectors[2].calibration
    assert calibration is not None
    assert not calibration.chose
    write_evidence(found, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert f"tested on {calibration.scenes}: 0 of 1020 clean scans alarm" in page
    assert "were chosen on these" not in page


def test_planted_edits_do_not_give_themselves_away_by_rounding() -> None:
    """A turn about the scanner keeps lines and ranges; azimuths have no steps in some packets."""
    classes = ["moved", "along rays", "turned on steps"]
    for unit, blind in ((velodyne(), BLIND_TURNED_ANYHOW), (hesai(), BLIND_TURNED)):
        clean = exact_scan(unit, labelled=True)
        lattice = estimate_lattice(clean)
        found = measure_power([clean], lattice, planted=2, classes=classes)
        assert {name: each.found for name, each in found.items()} == {
            "moved": 2, "along rays": 0,  # 10 cm are whole steps of range
            "turned on steps": 0,
        }  # fmt: skip
        assert {BLIND_TURNED, BLIND_TURNED_ANYHOW} & {*said(clean).blind} == {blind}
        assert BLIND_WHOLE_STEPS in said(clean).blind


@pytest.mark.parametrize("kind", ["hesai", "ouster", "velodyne"])
def test_copies_turned_by_whole_steps_have_the_ranges_of_the_original(kind: str) -> None:
    scan = exact_scan({**UNITS, "velodyne": velodyne()}[kind], labelled=True)
    found = measure_power([scan], estimate_lattice(scan), planted=2, classes=["copied on steps"])
    assert (found["copied on steps"].found, found["copied on steps"].planted) == (2, 2)
    post = np.flatnonzero(on_post(scan.points))
    beside = 2.8125 if kind == "ouster" else 3.0  # whole steps
    for degrees, verdict in ((180.0, "tampered"), (-45.0, "tampered"), (beside, "undecidable")):
        edited, copies = pasted(scan, turned(scan.points[post], degrees))
        judged = said(edited)
        assert judged.verdict == verdict
        if verdict == "tampered":
            assert "one of them is a turned copy" in judged.reason
            regions = judged.detectors[2].regions
            assert len(regions) == 2
            assert all("which of them is the copy is not known" in each.note for each in regions)
            shares = [
                [np.isin(each.rows, place).mean() for place in (post, copies)] for each in regions
            ]  # a few neighbours of the object have equal ranges by chance
            assert np.max(shares, axis=0).min() > 0.95
            assert np.max(shares, axis=1).min() > 0.95
            assert min(len(each.rows) for each in regions) > 0.5 * len(post)


def test_copies_that_are_mirrored_or_many_are_found_too() -> None:
    scan = exact_scan(velodyne(), labelled=True)
    post = scan.points[on_post(scan.points)]
    mirrored, _ = pasted(scan, post * np.float32([1, -1, 1]))
    assert said(mirrored).verdict == "tampered"
    many, _ = pasted(scan, np.concatenate([turned(post, 33.3 * k) for k in (1, 2, 3, 5)]))
    assert said(many).verdict == "tampered"


def test_an_object_of_another_scan_of_the_scanner_is_stated_as_not_found() -> None:
    """It stands on the lattice of both scans, with ranges of its own."""
    scan, other = (exact_scan(hesai(), seed) for seed in (1, 2))
    without = scan.points[~on_post(scan.points)]
    post = other.points[on_post(other.points)]
    lattice = estimate_lattice([scan, other])
    found = inspect(without_labels(np.concatenate([without, post])), lattice=lattice, power=False)
    assert found.verdict == "undecidable"
    assert BLIND_OTHER_SCAN in found.blind
    assert BLIND_OTHER_SCAN in said(exact_scan(velodyne(), labelled=True)).blind


@pytest.mark.parametrize("kind", ["ouster", "velodyne"])
def test_a_turn_that_was_fused_with_itself_has_no_copied_object(kind: str) -> None:
    scan = exact_scan({**UNITS, "velodyne": velodyne()}[kind], labelled=True)
    fused, _ = pasted(scan, turned(scan.points, 90.0))
    assert said(fused).verdict != "tampered"


@pytest.mark.parametrize("noise_m", [0.0, 0.0005, 0.001, 0.003])
def test_opposite_walls_at_one_distance_are_no_copies(unit: Unit, noise_m: float) -> None:
    scan = exact_scan(unit, labelled=True, noise_m=noise_m)
    assert said(scan).verdict != "tampered"


@pytest.mark.parametrize(("lasers", "noise"), [(32, 0.3), (32, 0.4), (64, 0.4), (64, 0.6)])
def test_a_symmetrical_room_at_coarse_ranges_has_no_copies(
    lasers: int, noise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise of a part of the range step of 8 mm leaves runs of equal ranges on opposite sides."""
    monkeypatch.setattr(exact_scans, "TILT", (0.0, 0.0))
    monkeypatch.setattr(exact_scans, "POST", (1e6, 1e6, 0.1))
    room = replace(hesai(lasers), step=0.008)
    scan = exact_scan(room, round(100 * noise), noise_m=noise * room.step)
    assert said(scan).verdict != "tampered"


@pytest.mark.parametrize("kind", ["hesai", "velodyne"])
def test_a_turned_copy_that_is_off_the_steps_has_one_region(kind: str) -> None:
    """The place that is off the lattice is the copy; the original is not suspected."""
    scan = exact_scan(UNITS.get(kind, velodyne()), labelled=True)
    post = scan.points[on_post(scan.points)]
    copy = turned(post, 90.003) + np.float32([0.0, 0.0, 0.001])
    edited, copies = pasted(scan, copy)
    judged = said(edited)
    assert judged.verdict == "tampered"
    assert set(judged.suspected.tolist()) <= set(copies.tolist())


def turned(points: Points, degrees: float) -> Points:
    angle = math.radians(degrees)
    turn = [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0]]
    there: Points = (points.astype(np.float64) @ np.array([*turn, [0, 0, 1]]).T).astype(np.float32)
    return there


def pasted(scan: LidarFrame, copy: Points) -> tuple[LidarFrame, NDArray[np.intp]]:
    """The scan with points at its end, in the lasers where they lie, and their rows."""
    lattice = estimate_lattice(scan)
    assert scan.ring is not None
    label = np.zeros(len(lattice.slope), np.uint16)
    label[lattice.read(scan.points).ring] = scan.ring
    ring = np.concatenate([scan.ring, label[lattice.read(copy).ring]])
    points = np.concatenate([scan.points, copy])
    rows = np.arange(scan.num_points, len(points))
    return scan.replace(points=points, ring=ring, intensity=None), rows


def on_post(points: Points) -> NDArray[np.bool_]:
    return (np.hypot(points[:, 0] - 6.0, points[:, 1] - 3.0) < 0.9) & (points[:, 2] > -1.4)


SIGHTS = {"gaps of one width": 1.0, "gaps that grow downwards": 1.6}


@pytest.mark.parametrize("power", SIGHTS.values(), ids=SIGHTS)
def test_an_object_of_another_scanner_is_no_laser_of_this_one(power: float) -> None:
    """Its points lie on the donor's elevations, each of which is a ring between two lines."""
    share = np.linspace(0.0, 1.0, 32) ** power
    host = replace(hesai(), elevation=14.7 - 31.0 * share)
    donor = replace(ouster(), elevation=np.linspace(20.9, -21.7, 64), beside=np.full(64, 0.013))
    clean, other = exact_scan(host, 1).points, exact_scan(donor, 2).points
    pasted = other[on_post(other)]
    assert len(pasted) > 100
    forged = without_labels(np.concatenate([clean, pasted]))
    stated = generic_consistency(forged, lattice=estimate_lattice(without_labels(clean)))
    own = said(forged)
    for found in (stated, own):
        assert found.verdict == "tampered"
        assert found.suspected.min() >= len(clean)
        assert len(found.suspected) > 0.6 * len(pasted)
    assert own.sensor is not None
    assert own.sensor.lattice is not None
    assert len(own.sensor.lattice.slope) == 32  # none of the donor's lines


def test_rings_of_a_pasted_box_are_no_lasers(unit: Unit) -> None:
    """Every 0.15 degrees of its height has a ring of its own."""
    clean = exact_scan(unit, labelled=True)
    assert clean.ring is not None
    box = np.random.default_rng(1).uniform([8.0, 2.2, -0.8], [8.3, 3.8, 0.7], (3000, 3))
    height = np.degrees(np.arctan2(box[:, 2], np.hypot(box[:, 0], box[:, 1])))
    ring = 200 + np.floor((height - height.min()) / 0.15).astype(np.uint16)
    points = np.concatenate([clean.points, box.astype(np.float32)])
    forged = LidarFrame(points, ring=np.r_[clean.ring, ring], origin=(0.0, 0.0, 0.0))
    found = generic_consistency(forged, lattice=estimate_lattice(clean))
    assert found.verdict == "tampered"
    assert found.suspected.min() >= clean.num_points


def test_points_above_all_lasers_are_not_passed_over(unit: Unit) -> None:
    """No line reaches them, so that nothing can be said about them; five are too many for noise."""
    clean = exact_scan(unit).points
    top = 10.0 * math.tan(math.radians(max(unit.elevation) + 3.0))
    box = np.random.default_rng(1).uniform([9.0, 3.1, top], [9.4, 4.9, top + 1.5], (800, 3))
    lattice = estimate_lattice(without_labels(clean))
    for number, verdict in ((4, "no_trace"), (5, "undecidable"), (800, "undecidable")):
        points = np.concatenate([clean, box[:number].astype(np.float32)])
        found = generic_consistency(without_labels(points), lattice=lattice)
        assert found.verdict == verdict
        assert found.reason.startswith(f"{number} points") is (verdict == "undecidable")
        without = found.without(("range",))  # as after processing of the whole scan
        assert (without.verdict == "undecidable") is (verdict == "undecidable")
    whole = said(without_labels(points), plant=1)
    assert whole.verdict == "undecidable"
    assert "800 points" in whole.reason
    moved = points.copy()
    moved[on_post(points)] += np.float32([0.5, 0.3, 0.0])
    assert said(without_labels(moved)).verdict == "tampered"


@pytest.mark.parametrize("height", [0.5, 1.7, 3.0])
def test_edits_are_planted_in_objects_however_high_the_scanner_stands(
    height: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edits are planted in objects, but not in the ground, at any height of the scanner."""
    monkeypatch.setattr(exact_scans, "GROUND", -height)
    monkeypatch.setattr(exact_scans, "WALLS", (60.0, 60.0))
    planted = []
    for post in ((6.0, 3.0, 0.8), (50.0, 50.0, 0.8)):  # the second one is too far away
        monkeypatch.setattr(exact_scans, "POST", post)
        clean = exact_scan(hesai(), labelled=True)
        lattice = estimate_lattice(clean)
        found = measure_power([clean], lattice, planted=3, classes=["moved"])
        planted.append([(each.found, each.planted) for each in found.values()])
    assert planted == [[(3, 3)], []]


@pytest.mark.parametrize("edit", ["moved", "turned", "along rays", "bump", "added"])
def test_edits_are_found_to_the_point(unit: Unit, edit: str) -> None:
    points = exact_scan(unit).points.copy()
    rows = np.flatnonzero(on_post(points))
    assert len(rows) > 100
    if edit == "moved":
        points[rows] += np.float32([0.5, 0.3, 0.0])
    elif edit == "turned":
        points[rows] = points[rows] @ np.float32([[0.99, 0.141, 0], [-0.141, 0.99, 0], [0, 0, 1]])
    elif edit == "along rays":
        points[rows] *= np.float32(1.0123)
    elif edit == "bump":
        away = points[rows] / np.linalg.norm(points[rows], axis=1)[:, None]
        points[rows] -= np.float32(0.0513) * away
    else:
        more = np.random.default_rng(2).normal([6, -3, -0.5], 0.4, (200, 3)).astype(np.float32)
        rows = np.arange(len(points), len(points) + 200)
        points = np.concatenate([points, more])
    found = said(without_labels(points))
    assert found.verdict == "tampered"
    assert set(found.suspected.tolist()) <= set(rows.tolist())
    assert len(found.suspected) >= (0.6 if edit == "added" else 0.85) * len(rows)
    assert found.p_value is not None
    assert found.p_value <= 0.002  # what so many clean scans support


def test_order_turns_and_crops_accuse_nobody(unit: Unit) -> None:
    scan = exact_scan(unit, labelled=True)
    random = np.random.default_rng(3)
    whole = np.arange(scan.num_points)
    for rows in (
        random.permutation(whole),
        whole[scan.points[:, 0] > 0],
        whole[np.abs(scan.points[:, 1]) < 5],
        whole[np.linalg.norm(scan.points, axis=1) < 8],
        whole[::3],
        np.sort(random.choice(whole, 3000, False)),
    ):
        for frame in (scan.select(rows), without_labels(scan.points[rows])):
            assert said(frame).verdict in ("undecidable", "processed")
    cos, sin = np.cos(0.3), np.sin(0.3)
    turned = scan.points.astype(float) @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
    assert said(without_labels(turned)).verdict in ("undecidable", "processed")


LEFT_OUT: dict[str, Callable[[Points], NDArray[np.bool_]]] = {
    "a fifth": lambda p: np.random.default_rng(5).random(len(p)) < 0.8,
    "half": lambda p: np.random.default_rng(5).random(len(p)) < 0.5,
    "seven tenths": lambda p: np.random.default_rng(5).random(len(p)) < 0.3,
    "all but one in each voxel": lambda p: np.isin(
        np.arange(len(p)), np.unique(np.floor(p / 0.1).astype(int), axis=0, return_index=True)[1]
    ),
}


@pytest.mark.parametrize("keeps", LEFT_OUT.values(), ids=LEFT_OUT)
def test_points_that_were_left_out_one_by_one_are_told(
    unit: Unit, keeps: Callable[[Points], NDArray[np.bool_]]
) -> None:
    clean = exact_scan(unit).points
    found = said(without_labels(clean[keeps(clean)]))
    assert found.verdict == "processed"
    assert [step.kind for step in found.processing] == ["thinned"]


def test_every_other_point_of_each_ring_is_told(unit: Unit) -> None:
    scan = exact_scan(unit, labelled=True)
    by_ring = scan.points[np.argsort(scan.ring, kind="stable")]
    found = said(without_labels(by_ring[::2]))
    assert [step.kind for step in found.processing] == ["thinned"]


def test_a_scan_of_a_sector_may_be_that_of_the_scanner(unit: Unit) -> None:
    """Scanners can be set to a part of the turn; it is stated that no cut of this kind is found."""
    points = exact_scan(unit).points
    front = np.abs(np.arctan2(points[:, 1], points[:, 0])) < math.radians(45.0)
    found = said(without_labels(points[front]))
    assert (found.verdict, found.processing) == ("undecidable", ())
    assert found.blind[:2] == BLIND_EXACT


@pytest.mark.parametrize("lasers", [16, 32])
def test_azimuths_without_steps_tell_no_gaps(lasers: int) -> None:
    scan = exact_scan(velodyne(lasers), labelled=True)
    half = np.flatnonzero(np.random.default_rng(5).random(scan.num_points) < 0.5)
    found = said(scan.select(half))
    assert found.processing == ()
    assert found.blind[:2] == BLIND_EXACT_WITHOUT_STEPS


@pytest.mark.realdata
@pytest.mark.parametrize(
    "name", ["hesai_pandar40p", "hesai_pandar64", "hesai_qt64", "hesai_xt32", "ouster_os1_32"]
)
def test_halves_of_real_scans_are_thinned(name: str, realdata: RealData) -> None:
    scan = io.read_scan(realdata("lidar/other_sensors") / f"{name}.pcd.xz")
    assert said(scan).processing == ()
    half = scan.points[LEFT_OUT["half"](scan.points)]
    assert [step.kind for step in said(without_labels(half)).processing] == ["thinned"]


def test_reflectances_of_sixteen_bits_are_those_of_the_scanner(unit: Unit) -> None:
    scan = exact_scan(unit)
    values = np.random.default_rng(0).integers(0, 65536, scan.num_points).astype(np.float32)
    assert said(scan.replace(intensity=values)).verdict == "undecidable"


@pytest.mark.parametrize("name", ["hesai", "ouster", "velodyne"])
def test_rounding_of_large_coordinates_accuses_nobody(name: str) -> None:
    """Single precision leaves 0.5 mm of what is 5 km away, and of 50 m in centimetres."""
    unit = {**UNITS, "velodyne": velodyne()}[name]
    scan = exact_scan(unit, labelled=True)
    for scale in (10.0, 50.0, 70.0, 100.0):
        larger = scan.replace(points=scan.points * np.float32(scale))
        found = said(larger)
        assert found.verdict == "undecidable", (scale, found.reason)
        assert len(found.suspected) == 0


def test_a_laser_that_saw_little_accuses_nobody(unit: Unit) -> None:
    """Its line is not known: of few points, or of points at one distance only."""
    scan = exact_scan(unit, labelled=True)
    assert scan.ring is not None

    def unlabelled(rows: NDArray[np.intp]) -> LidarFrame:
        return without_labels(scan.points[rows])

    for ring, keep in ((3, scan.select), (len(unit.elevation) - 4, unlabelled)):
        of_it = np.flatnonzero(scan.ring == ring)
        of_it = of_it[np.hypot(*scan.points[of_it, :2].T) > 2.0]
        for kept in (of_it[:1], of_it[:2], of_it[5:10], of_it[5:17], of_it[100:160]):
            rows = np.sort(np.r_[np.flatnonzero(scan.ring != ring), kept])
            assert said(keep(rows)).verdict == "undecidable", (ring, len(kept))


@pytest.mark.parametrize("kept", [slice(100, 160), slice(200), slice(None)])
def test_points_without_a_ring_may_be_those_of_a_laser_without_a_line(kept: slice) -> None:
    """Beams off the axis have no constant elevation: none or some of the points have a ring."""
    scan = exact_scan(hesai(64), labelled=True)
    beside = exact_scan(replace(hesai(64), start=(0.0158, 0.0)), labelled=True)
    others = scan.points[scan.ring != 3]
    lattice = estimate_lattice(without_labels(others))
    frame = without_labels(np.concatenate([others, beside.points[beside.ring == 3][kept]]))
    found = generic_consistency(frame, lattice=lattice)
    assert found.verdict == "undecidable"
    assert len(found.suspected) == 0


@pytest.mark.parametrize("is_reversed", [False, True])
def test_a_laser_beside_all_lines_accuses_nobody(is_reversed: bool) -> None:
    """Only the order of the file tells lasers, and that of few points is none of its rings."""
    scan = exact_scan(ouster(), labelled=True)
    assert scan.ring is not None
    ring = scan.ring.max() - scan.ring if is_reversed else scan.ring
    few = np.flatnonzero(ring == 30)[:48]
    rows = np.sort(np.r_[np.flatnonzero(~np.isin(ring, (27, 28, 30, 31))), few])
    assert said(without_labels(scan.points[rows])).verdict == "undecidable"


@pytest.mark.parametrize("seen", [5, 300])
@pytest.mark.parametrize("lifted", [0.0, 1.7])  # metres: the scanner's height on a car
def test_lasers_that_see_what_is_near_accuse_nobody(unit: Unit, lifted: float, seen: int) -> None:
    """Three lasers meet a thing 1.6 m away in some firings, and their own case in the others."""
    scan = exact_scan(unit, labelled=True)
    points = scan.points.copy()
    for laser in (3, 4, 5):
        rows = np.flatnonzero(scan.ring == laser)
        k = np.arange(len(rows))
        ranges = np.where(k < seen, 1.6 + 0.1 * np.sin(k / 7.0), 0.3)
        ranges = np.round(ranges / unit.step) * unit.step
        points[rows] *= (ranges / np.linalg.norm(points[rows], axis=1))[:, None].astype(np.float32)
    points[:, 2] += np.float32(lifted)
    frame = LidarFrame(points, ring=scan.ring, origin=(0.0, 0.0, 0.0))
    assert said(frame).verdict == "undecidable"


def test_few_stray_points_accuse_nobody(unit: Unit) -> None:
    points = exact_scan(unit).points.copy()
    rows = np.flatnonzero(on_post(points))[:4]
    points[rows] += np.float32(0.05)
    assert said(without_labels(points)).verdict == "undecidable"


def strewn_over(scan: LidarFrame, number: int) -> LidarFrame:
    """The scan with free points all around, no two of which are near each other, appended."""
    random = np.random.default_rng(number)
    azimuth = np.linspace(0.1, 2.0 * math.pi, number, endpoint=False)
    elevation = np.radians(random.uniform(-13.0, 12.0, number))
    level, distance = np.cos(elevation), random.uniform(3.0, 9.0, number)
    free = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    points = np.concatenate([scan.points, free * distance[:, None]]).astype(np.float32)
    return without_labels(points)


def test_points_strewn_over_a_scan_are_never_without_trace(unit: Unit) -> None:
    for number in (8, 24):
        frame = strewn_over(exact_scan(unit), number)
        assert said(frame, plant=1).verdict in ("undecidable", "tampered")
        assert generic_consistency(frame).verdict in ("undecidable", "tampered")


def test_many_strewn_points_are_found() -> None:
    whole = exact_scan(hesai())
    found = said(strewn_over(whole, 24))
    assert found.verdict == "tampered"
    assert found.suspected.tolist() == list(range(whole.num_points, whole.num_points + 24))


def test_a_lattice_that_does_not_fit_is_told() -> None:
    whole = exact_scan(hesai())
    lattice = estimate_lattice(whole)
    assert "given lattice" not in inspect(whole, lattice=lattice, power=False).reason
    many = strewn_over(whole, 700)
    found = inspect(many, lattice=lattice, power=False)
    assert found.verdict == "undecidable"
    told = re.search(r"; not judged by the given lattice: (\d+) of (\d+) points are not on it$",
                     found.reason)  # fmt: skip
    assert told is not None
    assert 650 <= int(told[1]) <= 700
    assert int(told[2]) == many.num_points
    none = inspect(whole.select(np.zeros(whole.num_points, bool)), lattice=lattice, power=False)
    assert "lattice" not in none.reason


def test_ranges_beside_the_steps_of_a_lattice_are_counted() -> None:
    """Scans of the same lasers that measure in other range steps are on its lines."""
    lattice = estimate_lattice(exact_scan(hesai()))
    for step in (3e-3, 5e-3):
        scan = exact_scan(replace(hesai(), step=step), 9)
        reason = inspect(scan, lattice=lattice, power=False).reason
        told = re.search(r"given lattice: (\d+) of \d+ points are not on it$", reason)
        assert told is not None
        # Half of the ranges differ by more than a quarter of a step.
        assert int(told[1]) == pytest.approx(scan.num_points / 2, rel=0.02)


def test_the_reason_why_a_given_lattice_is_not_used_is_true() -> None:
    whole = exact_scan(hesai())
    lattice = estimate_lattice(whole)
    few = estimate_lattice([exact_scan(hesai(6), seed) for seed in range(2)])
    ahead = np.abs(np.arctan2(whole.points[:, 1], whole.points[:, 0])) < 0.2
    for scan, given, sensor, why in (
        (
            exact_scan(hesai(6), 9),
            few,
            "auto",
            "lattice: it has 6 lines, and at least 8 are needed",
        ),
        (whole.select(ahead), lattice, "auto", "too inexact to tell that they are on it"),
        (whole, lattice, "other", "stated or recognised than that of the given lattice"),
    ):
        found = inspect(scan, lattice=given, sensor=sensor, power=False)
        assert found.verdict == "undecidable"
        assert found.reason.endswith(why)


def test_a_lattice_comes_from_rows_with_intensities() -> None:
    points = exact_scan(hesai()).points
    rows = np.column_stack([points, np.zeros(len(points), np.float32)])
    for frames in (rows, [rows]):
        found, known = estimate_lattice(frames), estimate_lattice(points)
        np.testing.assert_array_equal(found.table, known.table)


def test_a_second_scanner_accuses_nobody(unit: Unit) -> None:
    first, second = exact_scan(unit, 1).points, exact_scan(unit, 2).points[::4].astype(float)
    turned = second[:, [1, 0, 2]] * [1.0, -1.0, 1.0] + [0.4, 0.9, -0.3]
    found = said(without_labels(np.concatenate([first, turned.astype(np.float32)])))
    assert found.verdict in ("undecidable", "processed")
    # One that looks ahead only, beside a whole turn of the first.
    ahead = exact_scan(unit, 3).points + np.float32([0.4, 0.9, -0.3])
    ahead = ahead[np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) < 1.0]
    found = said(without_labels(np.concatenate([first, ahead])))
    assert found.verdict in ("undecidable", "processed")


def test_what_spoils_the_lattice_is_never_without_trace(unit: Unit) -> None:
    points = exact_scan(unit).points.astype(float)
    points[on_post(points.astype(np.float32))] += [0.5, 0.3, 0.0]
    random = np.random.default_rng(4)
    for changed in (
        points.round(3),
        points.round(2),
        points.astype(np.float16),
        points + random.normal(0.0, 0.005, points.shape),
        points @ [[1, 0, 0], [0, 0.995, 0.0998], [0, -0.0998, 0.995]],
        points * 1000,
    ):
        assert said(without_labels(changed), plant=1).verdict in ("undecidable", "processed")


def test_a_calibrated_lattice_knows_its_power(unit: Unit, tmp_path: Path) -> None:
    scans = [exact_scan(unit, seed) for seed in range(4)]
    lattice = calibrate_lattice(scans, planted=1)
    assert lattice.is_exact
    lattice.save(tmp_path / "lattice.json")
    loaded = SensorLattice.load(tmp_path / "lattice.json")
    assert (loaded.tolerance, loaded.steps) == (lattice.tolerance, lattice.steps)
    clean = exact_scan(unit, 9)
    assert inspect(clean, lattice=loaded).verdict == "no_trace"
    forged = clean.points.copy()
    forged[on_post(forged)] += np.float32([0.5, 0.3, 0.0])
    assert inspect(without_labels(forged), lattice=loaded).verdict == "tampered"
    assert generic_consistency(without_labels(forged), lattice=loaded).verdict == "tampered"


def test_a_calibrated_lattice_needs_no_range_steps() -> None:
    """It misses edits along the rays, and copies that only their ranges show."""
    unit = replace(hesai(), step=1e-7)
    *scans, another = [exact_scan(unit, seed) for seed in range(5)]
    lattice = calibrate_lattice(scans, planted=2)
    assert (lattice.is_exact, lattice.range_step) == (True, 0.0)
    assert lattice.power["moved"].share == lattice.power["resampled"].share == 1.0
    assert lattice.power["along rays"].found == lattice.power["copied on steps"].found == 0
    clean = inspect(another, lattice=lattice)
    assert (clean.verdict, clean.sensor.lattice) == ("no_trace", lattice)
    assert clean.sensor.reason == (
        "its points stand on 32 lines, 3600 steps of azimuth, and ranges have no steps"
    )
    assert {BLIND_ALONG_RAYS, BLIND_COPIED, BLIND_CUT_ELSEWHERE} < set(clean.blind)
    assert not {BLIND_TURNED, BLIND_WHOLE_STEPS} & set(clean.blind)
    post = np.flatnonzero(on_post(another.points))
    points = another.points.copy()
    points[post] += np.float32([0.3, -0.8, 0.0])
    edited = inspect(another.replace(points=points), lattice=lattice)
    assert edited.verdict == "tampered"
    assert np.isin(edited.detectors[0].suspected, post).all()


def test_without_range_steps_a_lattice_needs_a_measured_power() -> None:
    scans = [exact_scan(replace(hesai(), step=1e-7), seed) for seed in range(3)]
    lattice = estimate_lattice(scans[:2])
    found = inspect(scans[2], lattice=lattice)
    assert found.verdict == "undecidable"
    assert found.reason.endswith("has no range steps, and its power was not measured")
    shifted = scans[2].replace(points=scans[2].points + np.float32([0.0, 0.0, 0.5]))
    assert "points are not on it" in inspect(shifted, lattice=lattice).reason


def test_a_lattice_that_judges_no_scan_has_no_power() -> None:
    """The power of scans that `inspect` never judges by it would be of no use."""
    scans = [exact_scan(hesai(6), seed) for seed in range(4)]
    with pytest.raises(InputError, match=r"2 of 2 are not: it has 6 lines, and .* 8 are needed$"):
        calibrate_lattice(scans, planted=1)
    scans = [exact_scan(hesai(), seed) for seed in range(3)]
    two_scanners = np.concatenate([exact_scan(hesai(), 3).points, exact_scan(ouster(), 3).points])
    with pytest.raises(InputError, match=r"1 of 2 are not: .* points are not on it"):
        calibrate_lattice([*scans, without_labels(two_scanners)], planted=1)
    coarser = replace(hesai(), step=5e-3)
    mixed = [exact_scan(coarser if seed % 2 else hesai(), seed) for seed in range(4)]
    with pytest.raises(InputError, match=r"2 of 2 are not: [1-9]\d* of \d+ points are not on it$"):
        calibrate_lattice(mixed, planted=1)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 0.01, float("nan"), "wide", None])
def test_a_tolerance_that_is_none_is_refused(tolerance: object, tmp_path: Path) -> None:
    kitti_lattice().save(tmp_path / "a.json")
    values = json.loads((tmp_path / "a.json").read_text())
    assert values["sensor_lattice"]["tolerance"] == 0.002
    del values["sensor_lattice"]["tolerance"]
    (tmp_path / "b.json").write_text(json.dumps(values))
    assert SensorLattice.load(tmp_path / "b.json").tolerance == 0.002  # of an earlier version
    values["sensor_lattice"]["tolerance"] = tolerance
    (tmp_path / "c.json").write_text(json.dumps(values))
    with pytest.raises(FormatError, match="not a sensor lattice"):
        SensorLattice.load(tmp_path / "c.json")


REAL = {
    "hesai_pandar40p": (36, 36_000, 0.004),
    "hesai_pandar64": (63, 36_000, 0.004),
    "hesai_qt64": (51, 1800, 0.004),
    "hesai_xt32": (32, 18_000, 0.004),
    "ouster_os1_32": (32, 1024, 0.001),
}


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "lasers"), [("reference/vlp32", 32), ("sample_velodyne_hdl32", 31)]
)
def test_packets_of_real_scanners(name: str, lasers: int, realdata: RealData) -> None:
    with capture.open(f"pcap:{realdata('lidar/packets')}/{name}.pcap") as source:
        frames = [frame for _, frame in zip(range(3), source, strict=False)]
    for frame in frames[1:]:
        lattice = estimate_lattice(frame)
        assert (lattice.is_exact, len(lattice.slope), lattice.steps) == (True, lasers, 0)
        told = lattice.is_told_exactly(frame)
        reading = lattice.read(frame.points)
        assert told.sum() > 10_000
        assert np.abs(reading.line_error[told]).max() < 1e-5
        assert np.abs(reading.range_error[told]).max() < 1e-5
        assert said(frame).verdict == "undecidable"


@pytest.mark.realdata
@pytest.mark.parametrize("name", REAL)
def test_real_scanners(name: str, realdata: RealData) -> None:
    frame = io.read_scan(realdata("lidar/other_sensors") / f"{name}.pcd.xz")
    lattice = estimate_lattice(frame)
    assert (len(lattice.slope), lattice.steps, lattice.range_step) == REAL[name]
    told = lattice.is_told_exactly(frame)
    assert told.sum() > 10_000
    reading = lattice.read(frame.points)
    for error in (reading.line_error, reading.step_error, reading.range_error):
        assert np.abs(error[told]).max() < 1e-5
    assert said(frame).verdict == "undecidable"
    random = np.random.default_rng(7)
    rho = np.hypot(*frame.points[:, :2].T)
    for _ in range(5):
        center = frame.points[random.choice(np.flatnonzero((rho > 3.0) & (rho < 25.0)))]
        rows = np.flatnonzero(np.linalg.norm(frame.points - center, axis=1) < 0.7)
        for change in ("moved", "ray"):
            points = frame.points.copy()
            points[rows] += np.float32([0.5, 0.3, 0.0])
            if change == "ray":
                points = frame.points.copy()
                points[rows] *= np.float32(1.0 + 0.1 / np.linalg.norm(center))
            found = said(without_labels(points))
            assert found.verdict == "tampered"
            assert set(found.suspected.tolist()) <= set(rows.tolist())


def voxel_means(points: Points, edge: float, start: NDArray[np.float64]) -> Points:
    cells = np.floor((points - start) / edge).astype(np.int64)
    _, cell, size = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(cell.ravel(), axis.astype(float)) for axis in points.T]
    return np.column_stack([each / size for each in sums]).astype(np.float32)


@pytest.mark.parametrize(
    ("lasers", "millimetres", "is_at_least"),
    [(64, 24.6, True), (64, 23.8, False), (32, 28.0, False), (64, 31.3, True)],
)
def test_means_of_voxels_of_any_edge_are_no_edit(
    lasers: int, millimetres: float, is_at_least: bool
) -> None:
    """Cells of common filters begin at 0, or half an edge below the least coordinates."""
    edge = millimetres / 1000.0
    points = exact_scan(hesai(lasers), 3).points
    start = points.min(axis=0) - 0.5 * edge if is_at_least else np.zeros(3)
    means = voxel_means(points, edge, start)
    found = said(without_labels(means))
    assert found.verdict in ("processed", "undecidable")
    assert len(found.suspected) == 0
    if len(means) < len(points) - 30:
        assert edge_of_voxels(means) == pytest.approx(edge)
    assert edge_of_voxels(points) == 0.0


def test_few_points_beside_others_may_be_means_of_voxels() -> None:
    """Points elsewhere, or more of them, are not."""
    points = exact_scan(hesai(64), 3).points
    start = points.min(axis=0) - 0.5 * 0.0238
    means = voxel_means(points, 0.0238, start)
    assert edge_of_voxels(means) == 0.0
    is_mean = ~np.isin(means, points).all(axis=1)
    rows = np.flatnonzero(is_mean)
    assert 0 < len(rows) <= len(points) - len(means)
    assert edge_of_voxels(means, rows) > 0.0
    far = np.r_[rows, np.linalg.norm(means, axis=1).argmax()]
    assert edge_of_voxels(means, far) == 0.0
    assert edge_of_voxels(means, np.repeat(rows, 10)) == 0.0


@pytest.mark.realdata
def test_means_of_voxels_are_no_edit(realdata: RealData) -> None:
    scan = io.read_scan(realdata("lidar/other_sensors") / "hesai_qt64.pcd.xz")
    points = scan.points.astype(np.float64)
    cells = np.floor(points / 0.02).astype(np.int64)
    _, cell, size = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    means = np.zeros((len(size), 3))
    np.add.at(means, cell.ravel(), points)
    found = said(without_labels((means / size[:, None]).astype(np.float32)))
    assert found.verdict == "processed"
    assert [step.kind for step in found.processing] == ["averaged"]


def test_a_folder_of_scans_calibrates_a_lattice(tmp_path: Path) -> None:
    for seed in range(4):
        io.write_scan(exact_scan(hesai(), seed), tmp_path / f"{seed}.pcd")
    lattice = calibrate_lattice([tmp_path], planted=1)
    assert lattice.power["moved"].source == f"2 clean scans of {tmp_path.name}"
    with pytest.raises(InputError, match="expected a folder with velodyne_points/data"):
        calibrate_lattice([tmp_path.parent])


def _turned(points: Points, angle: float) -> Points:
    """Turn about an axis that lies, as a calibration of few digits does."""
    x, y, z = points.astype(float).T
    return np.column_stack([x + angle * z, y, z - angle * x]).astype(np.float32)


def _deskewed(points: Points, metres: float) -> Points:
    share = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi)
    return (points + np.outer(share, [0.8 * metres, 0.6 * metres, 0.1 * metres])).astype(np.float32)


def _from_map(points: Points, away: float) -> Points:
    """To coordinates of a map and back, both in single precision."""
    place = np.array([away, -0.7 * away, 0.02 * away])
    there = (points.astype(float) + place).astype(np.float32)
    return (there - place).astype(np.float32)


TINY: dict[str, Callable[[Points, float], Points]] = {
    "turned": lambda p, step: _turned(p, 1e-6 * step),
    "deskewed": lambda p, step: _deskewed(p, 3e-5 * step),
    "in a map": lambda p, step: _from_map(p, 400.0 * step),
    "scaled": lambda p, step: (p.astype(float) * (1.0 + 1e-6 * step)).astype(np.float32),
}


@pytest.mark.parametrize("change", TINY)
def test_what_moves_points_by_a_tenth_of_a_millimetre_accuses_nobody(
    unit: Unit, change: str
) -> None:
    """The errors of all points reach as far as those of the few beyond the tolerance."""
    for step in (1.0, 2.0, 3.0, 5.0, 10.0):
        for seed in range(2):
            scan = without_labels(TINY[change](exact_scan(unit, seed).points, step))
            assert said(scan).verdict in ("undecidable", "processed"), (step, seed)
