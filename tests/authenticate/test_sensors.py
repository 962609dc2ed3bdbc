"""Identification of the scanner by the elevations of points, and scans built from directions."""

from __future__ import annotations

import re
from dataclasses import replace
from inspect import getsource

import numpy as np
import pytest
from numpy.typing import NDArray

import lattice_scans as scans
from exact_scans import exact_scan, hesai, in_polar_steps, ouster
from manip3d import LidarFrame, io
from manip3d.authenticate import (
    Sensor,
    SensorLattice,
    _sensors,
    _standpoint,
    identify_sensor,
    inspect,
    kitti_lattice,
)
from manip3d.authenticate._lattice import COLUMNS
from manip3d.authenticate._sensors import BEAM_WIDTH, BEAMS, _common_part, is_of_two_scanners
from real_data import RealData

COUNT = 8000


def scan_of(
    elevations: NDArray[np.float64], *, blur: float = 0.0, turn: float = 360.0, seed: int = 0
) -> NDArray[np.float32]:
    """Points at random azimuths and distances; ``blur``: degrees around the elevations."""
    random = np.random.default_rng(seed)
    elevation = np.radians(random.choice(elevations, COUNT) + random.normal(0.0, blur, COUNT))
    azimuth = np.radians(random.uniform(-turn / 2, turn / 2, COUNT))
    level = np.cos(elevation)
    beam = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    return (beam * random.uniform(4.0, 40.0, (COUNT, 1))).astype(np.float32)


def test_every_name_of_a_scanner_is_documented() -> None:
    code = "".join(getsource(module) for module in (_sensors, _standpoint))
    names = set(re.findall(r'Sensor\(\s*"([^"]+)"', code))
    assert {"spinning scanner", "raster scanner", "unknown"} <= names
    told = " ".join((Sensor.__doc__ or "").split())
    assert [name for name in names if f"``{name}``" not in told] == []


@pytest.mark.parametrize("model", BEAMS)
def test_lasers_at_a_makers_elevations_name_the_model(model: str) -> None:
    found = identify_sensor(scan_of(BEAMS[model], blur=0.03))
    assert (found.name, found.kind) == (model, "spinning")
    assert found.reason.endswith("% of the points at its lasers' elevations")
    assert found.lattice is None


@pytest.mark.parametrize("stray", [0.0, 0.005, 0.03])
def test_stray_points_make_no_terrestrial_scanner_of_a_spinning_one(stray: float) -> None:
    """Rain and wrong returns stand in rows in which no laser looks."""
    random = np.random.default_rng(1)
    elevation = np.repeat(np.arange(-20, 20), 1800) / 3.0
    azimuth = np.tile(np.arange(1800), 40) * 0.2
    level = np.cos(np.radians(elevation))
    beam = np.column_stack(
        [level * np.cos(np.radians(azimuth)), level * np.sin(np.radians(azimuth)),
         np.sin(np.radians(elevation))]
    )  # fmt: skip
    points = beam * random.uniform(8.0, 40.0, (len(beam), 1))
    some = random.choice(len(points), int(stray * len(points)), replace=False)
    points[some] += random.normal(0.0, 3.0, (len(some), 3))
    assert identify_sensor(points.astype(np.float32)).kind == "spinning"


@pytest.mark.parametrize("model", BEAMS)
def test_lasers_beside_them_do_not(model: str) -> None:
    """A mount that tilts, or a unit of another maker."""
    apart = float(np.diff(np.sort(BEAMS[model])).min())
    shifted = BEAMS[model] + (0.5 * apart if apart < 4 * BEAM_WIDTH else 2 * BEAM_WIDTH)
    assert identify_sensor(scan_of(shifted)).name != model


def test_a_part_of_the_points_beside_the_lasers_is_another_scanner() -> None:
    mixed = np.concatenate([np.tile(BEAMS["VLP-32C"], 20), np.linspace(-25, 15, 300)])
    assert identify_sensor(scan_of(mixed, blur=0.03)).name != "VLP-32C"


def test_a_model_needs_more_than_half_of_its_lasers() -> None:
    """Sixteen of 32 whole degrees could be any scanner's."""
    some = np.sort(BEAMS["Hesai PandarXT-32"])
    assert identify_sensor(scan_of(some[:24], blur=0.03)).name == "Hesai PandarXT-32"
    assert identify_sensor(scan_of(some[:12], blur=0.03)).name != "Hesai PandarXT-32"


@pytest.mark.parametrize("lasers", [12, 40, 100])
def test_other_lasers_are_counted(lasers: int) -> None:
    found = identify_sensor(scan_of(np.linspace(-21.37, 17.91, lasers)))
    assert (found.name, found.kind) == ("spinning scanner", "spinning")
    assert found.reason == f"the points stand on {lasers} elevations"


@pytest.mark.parametrize("model", BEAMS)
def test_rings_name_a_model_whose_points_were_deskewed(model: str) -> None:
    """Single points are beside the lasers' elevations; the median of each ring is at one."""
    beams = np.sort(BEAMS[model])
    random = np.random.default_rng(5)
    ring = random.integers(0, len(beams), COUNT)
    apart = 0.4 * np.gradient(beams)
    elevation = np.radians(beams[ring] + random.uniform(-apart[ring], apart[ring]))
    azimuth = random.uniform(-np.pi, np.pi, COUNT)
    level = np.cos(elevation)
    beam = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    points = (beam * random.uniform(4.0, 40.0, (COUNT, 1))).astype(np.float32)
    assert identify_sensor(points).kind == "unknown"
    ids = random.permutation(len(beams)).astype(np.uint16)  # in the order of firing
    found = identify_sensor(LidarFrame(points, ring=ids[ring]))
    assert (found.name, found.kind) == (model, "spinning")
    assert found.reason == f"its {len(beams)} rings have the elevations of its lasers"
    tilted = LidarFrame(points, ring=random.permutation(ids[ring]))
    assert identify_sensor(tilted).kind == "unknown"


def test_no_rows_are_no_spinning_scanner() -> None:
    anywhere = np.linspace(-20.0, 20.0, 100_000)
    assert identify_sensor(scan_of(anywhere)).kind == "unknown"
    for turn in (80.0, 140.0):
        ahead = identify_sensor(scan_of(anywhere, turn=turn))
        assert (ahead.name, ahead.kind) == ("non-repetitive scanner", "non-repetitive")
    assert identify_sensor(scan_of(anywhere, turn=170.0)).kind == "unknown"


def test_few_points_tell_nothing() -> None:
    few = identify_sensor(scan_of(BEAMS["VLP-16"])[:900])
    assert (few.kind, few.reason) == ("unknown", "fewer than 1000 points")


def test_points_within_two_metres_do_not_blur_the_elevations() -> None:
    """Lasers sit beside each other, which turns what is near up or down."""
    near = scan_of(np.linspace(-20.0, 20.0, 5000), seed=1)
    near *= 1.6 / np.linalg.norm(near, axis=1, keepdims=True)
    mixed = np.concatenate([scan_of(BEAMS["VLP-16"], blur=0.03), near])
    assert identify_sensor(mixed).name == "VLP-16"
    far = np.concatenate([scan_of(BEAMS["VLP-16"], blur=0.03), 2.0 * near])
    assert identify_sensor(far).name != "VLP-16"


def of_lasers(count: int) -> SensorLattice:
    """The lasers of KITTI's scanner that are so many apart that this many remain."""
    known = kitti_lattice()
    kept = np.linspace(0, 63, count).astype(np.intp)
    return replace(known, **{name: getattr(known, name)[kept] for name in COLUMNS})


def street_of(lattice: SensorLattice) -> NDArray[np.float32]:
    return scans.scan(np.random.default_rng(5), lattice)


@pytest.mark.parametrize("lasers", [16, 20, 64])
def test_a_scanner_whose_lattice_is_given_is_named_by_its_lasers(lasers: int) -> None:
    lattice = of_lasers(lasers)
    found = identify_sensor(street_of(lattice), lattice=lattice)
    expected = "HDL-64E" if lasers == 64 else f"scanner of at least {lasers} lasers"
    assert (found.name, found.kind, found.off_lattice) == (expected, "lattice", 0.0)
    assert found.lattice is lattice
    assert not found.is_own


def test_fewer_than_sixteen_lasers_are_on_no_lattice() -> None:
    lattice = of_lasers(15)
    assert identify_sensor(street_of(lattice), lattice=lattice).lattice is not lattice


@pytest.mark.parametrize(("kept", "is_on"), [(20, True), (19, False)])
def test_a_laser_counts_from_twenty_points_on(kept: int, is_on: bool) -> None:
    lattice = of_lasers(16)
    points = street_of(lattice)
    ring = lattice.read(points).ring
    some = np.ones(len(points), np.bool_)
    some[np.flatnonzero(ring == 7)[kept:]] = False
    assert (identify_sensor(points[some], lattice=lattice).lattice is lattice) is is_on


@pytest.mark.parametrize(("turned", "is_on"), [(0.4, True), (0.6, False)])
def test_half_of_the_horizon_stands_on_the_lattice(turned: float, is_on: bool) -> None:
    lattice = of_lasers(16)
    points = street_of(lattice)
    angle = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2.0 * np.pi)
    points[angle < 2.0 * np.pi * turned, 2] += np.float32(0.05)
    assert (identify_sensor(points, lattice=lattice).lattice is lattice) is is_on


@pytest.mark.parametrize("shift", [0.004, 0.012])
def test_a_scan_beside_the_lines_was_moved(shift: float) -> None:
    points = street_of(kitti_lattice())
    points[:, 2] += np.float32(shift)
    found = identify_sensor(points)
    assert (found.name, found.kind) == ("HDL-64E", "lattice")
    assert found.off_lattice == pytest.approx(shift, rel=0.1)
    points[:, 2] += np.float32(0.05)
    assert identify_sensor(points).off_lattice == 0.0


@pytest.mark.parametrize(("seen", "are_two"), [(0.4, False), (0.6, True)])
def test_points_beside_the_lines_in_most_directions_are_no_edit(seen: float, are_two: bool) -> None:
    lattice = of_lasers(16)
    points = street_of(lattice)
    angle = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2.0 * np.pi)
    points[angle < 2.0 * np.pi * seen, 2] += np.float32(0.05)
    assert is_of_two_scanners(points, lattice.read(points)) is are_two


def test_another_unit_of_a_model_was_not_moved() -> None:
    """Its lasers look a little elsewhere; its own lattice tells where."""
    known, random = kitti_lattice(), np.random.default_rng(1)
    turn = np.sort(random.normal(0.0, 2.5e-3, 64))[::-1] + random.normal(0.0, 6e-4, 64)
    other = replace(known, slope=known.slope + turn)
    assert (np.diff(other.slope) < 0.0).all()
    points = scans.scan(np.random.default_rng(5), other)
    reading = known.read(points)
    assert 0.004 < np.median(np.abs(reading.line_error)) < 0.02
    found = identify_sensor(points)
    assert (found.name, found.off_lattice, found.is_own) == ("HDL-64E", 0.0, True)
    assert found.lattice is not None
    np.testing.assert_allclose(found.lattice.slope, other.slope, atol=1e-4)


@pytest.mark.parametrize(("lasers", "is_exact"), [(7, False), (8, True), (16, True)])
def test_eight_lasers_are_the_fewest_of_an_exact_lattice(lasers: int, is_exact: bool) -> None:
    found = identify_sensor(exact_scan(hesai(lasers), labelled=True))
    assert (found.kind == "lattice") is is_exact
    assert found.is_own is is_exact


@pytest.mark.parametrize("lift", [0.0, 0.0003, -0.0002, 1.7304])
def test_the_common_part_of_heights_is_a_sum_of_whole_nanometres(lift: float) -> None:
    whole = np.random.default_rng(0).integers(-2000, 1000, 5000) / 1000.0
    heights = (whole + lift).astype(np.float32)
    heights[:400] += np.float32(0.0004)  # 8 % of them lie elsewhere
    heights[-1] = np.float32(3e38)
    beside, share = _common_part(heights, 0.001)
    off = (beside - lift) % 0.001
    assert min(off, 0.001 - off) < 1e-8
    assert 0.9195 < share < 0.9205
    assert _common_part(heights[::-1].copy(), 0.001) == (beside, share)


def rastered(rows: float, columns: float, *, lowest: float = -40.0) -> NDArray[np.float32]:
    """A room from a scanner whose rows and columns are so many degrees apart; whole millimetres."""
    random = np.random.default_rng(3)
    elevation, azimuth = np.meshgrid(
        np.arange(lowest, 40.0, rows), np.arange(0.0, 360.0, columns), indexing="ij"
    )
    e, a = np.radians([elevation.ravel(), azimuth.ravel()])
    beam = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    room = (np.array([7.0, 5.0, 3.0]) / np.maximum(np.abs(beam), 1e-9)).min(axis=1)
    distance = np.round(room + random.normal(0.0, 0.01, len(room)), 3)
    return np.asarray(beam * distance[:, None], np.float32)


@pytest.mark.parametrize(("rows", "columns"), [(1.0, 1.0), (0.9, 1.2), (1.25, 1.0)])
def test_rows_of_a_raster_are_no_lasers(rows: float, columns: float) -> None:
    found = identify_sensor(rastered(rows, columns))
    assert (found.name, found.lattice) == ("unknown", None)
    assert "rows of a raster" in found.reason


@pytest.mark.parametrize(
    ("rows", "columns"), [(2.0, 0.2), (4.0 / 3.0, 0.16), (1.0, 0.4), (0.625, 360.0 / 1024.0)]
)
def test_equally_spaced_lasers_are_no_raster(rows: float, columns: float) -> None:
    """Lasers of a VLP-16, an HDL-32E, a PandarXT-32 at 20 turns a second, and an Ouster."""
    points = rastered(rows, columns, lowest=-30.0)
    assert identify_sensor(points).kind == "lattice"
    thinned = points[np.random.default_rng(0).random(len(points)) < 0.2]
    assert identify_sensor(thinned).kind == "lattice"


@pytest.mark.parametrize("lasers", [64, 128])
def test_an_ouster_with_columns_as_far_apart_as_its_lasers_is_no_raster(lasers: int) -> None:
    assert identify_sensor(exact_scan(ouster(lasers))).kind == "lattice"


@pytest.mark.realdata
@pytest.mark.parametrize("number", [1, 2])
def test_crops_of_a_real_room_are_no_spinning_scanners(number: int, realdata: RealData) -> None:
    points = io.read_scan(realdata(f"lidar/tls/room_scan{number}.ply.xz")).points
    distance = np.linalg.norm(points, axis=1)
    for kept in (distance > 2.0, distance > 3.2, points[:, 2] < 0.0, points[:, 0] > 2.0):
        assert "rows of a raster" in identify_sensor(points[kept]).reason
    assert inspect(points[distance > 3.2], plant=1).verdict == "undecidable"


@pytest.mark.parametrize("points", [6000, 60_000])
@pytest.mark.parametrize("step", [0.05, 0.1, 0.2])
def test_directions_rounded_to_a_grid_are_no_terrestrial_scanners(step: float, points: int) -> None:
    """Detectors I and II would find no trace, and nobody has measured what they find there."""
    random = np.random.default_rng(0)
    x, y = random.uniform(-0.6, 0.6, (2, points))  # a part of the turn without rows, as of a Livox
    wall = np.column_stack([np.ones(points), x, y]) * random.uniform(9.0, 11.0, (points, 1))
    rosette = in_polar_steps(wall.astype(np.float32), 0.005, step, step)
    assert identify_sensor(rosette).kind != "terrestrial"
    turn = in_polar_steps(exact_scan(ouster(64)).points, 0.005, step, step)
    assert identify_sensor(turn).kind != "terrestrial"


@pytest.mark.parametrize(("step", "is_terrestrial"), [(0.3, True), (0.45, False)])
def test_a_coarse_grid_is_not_that_of_a_terrestrial_scanner(
    step: float, is_terrestrial: bool
) -> None:
    """Detectors I and II are calibrated for fine ones."""
    azimuth, elevation = np.meshgrid(np.arange(0.0, 360.0, step), np.arange(-50.0, 50.0, step))
    a, e = np.radians(azimuth.ravel()), np.radians(elevation.ravel())
    beam = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    walls = 5.0 / np.abs(beam).max(axis=1, keepdims=True)
    found = identify_sensor((walls * beam).astype(np.float32))
    assert (found.kind == "terrestrial") is is_terrestrial


@pytest.mark.parametrize(
    ("up", "around", "name"),
    [
        ((-12.8, 12.8), (-60, 60), "raster scanner"),  # a solid-state scanner of a car
        ((-30.0, 50.0), (-60, 60), "terrestrial scanner"),  # a window
        ((-40.0, 10.0), (-180, 180), "terrestrial scanner"),  # which sees no sky
        ((-25.0, 25.0), (-60, 60), "raster scanner"),
    ],
)
def test_many_rows_over_a_small_view_make_no_terrestrial_scanner(
    up: tuple[float, float], around: tuple[float, float], name: str
) -> None:
    """The power of the detectors was measured on terrestrial scanners only."""
    azimuth, elevation = np.meshgrid(np.arange(*around, 0.15), np.arange(*up, 0.13))
    a, e = np.radians(azimuth.ravel()), np.radians(elevation.ravel())
    beam = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    walls = 5.0 / np.abs(beam).max(axis=1, keepdims=True)
    scan = (walls * beam).astype(np.float32)
    assert identify_sensor(scan).name == name
    if name == "raster scanner":
        found = inspect(scan)
        assert (found.verdict, dict(found.power)) == ("undecidable", {})
        assert "of azimuth" in found.reason


@pytest.mark.parametrize("far", [1e19, 1e30, 3e38])
def test_coordinates_whose_squares_are_no_float32_are_far_away(far: float) -> None:
    scan = far * np.random.default_rng(0).uniform(0.1, 1.0, (5000, 3))
    assert identify_sensor(scan.astype(np.float32)).kind != "lattice"


def test_one_elevation_is_said_in_the_singular() -> None:
    azimuth = np.linspace(-np.pi, np.pi, 5000, endpoint=False)
    ring = 20.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.05 + 0.0 * azimuth])
    assert identify_sensor(ring.astype(np.float32)).reason == "the points stand on one elevation"
