"""Lasers left out of a scan, everywhere or in a sector, and bands that were cut out all around."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import lattice_scans as scans
import turn_scans
from manip3d import authenticate, simulate
from manip3d.authenticate._empty_bands import empty_bands
from manip3d.authenticate._firings import firings_of
from manip3d.authenticate._power import BLIND_CUT
from manip3d.authenticate._sensors import kitti_lattice
from manip3d.io import read_scan
from manip3d.lidar import LidarFrame
from manip3d.simulate._surfaces import sheet
from manip3d.simulate._things import Relief, block, tree
from manip3d.simulate._world import Label, Surface, WorldBuilder, placed
from manip3d.simulate.streets import Street
from real_data import RealData

RAW = "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0002_sync/velodyne_points/data"


@functools.cache
def street() -> NDArray[np.float32]:
    """A street as KITTI's scanner sees it, with the scanner's own car."""
    pytest.importorskip("open3d")
    return simulate.hdl64e(simulate.street(rng=88_500), 3.0, rng=88_500).frame.points


def ahead(points: NDArray[np.float32], degrees: float) -> NDArray[np.bool_]:
    angles = np.arctan2(points[:, 1], points[:, 0])
    return np.abs(angles) < np.radians(degrees) / 2.0


def lasers_of(points: NDArray[np.float32], first: int, last: int) -> NDArray[np.bool_]:
    ring = kitti_lattice().read(points).ring
    return (ring >= first) & (ring <= last)


@pytest.mark.parametrize(
    ("first", "last", "degrees"),
    [(20, 39, 45), (20, 39, 90), (5, 54, 60), (20, 63, 60), (0, 40, 60), (30, 31, 45)],
)
def test_lasers_left_out_in_a_wide_sector_are_a_crop(first: int, last: int, degrees: int) -> None:
    """The sector is ahead, where the rings of the file begin and end."""
    points = street()
    left_out = ahead(points, degrees) & lasers_of(points, first, last)
    stray = np.flatnonzero(left_out)[300]  # one return does not split the silence
    left_out[stray] = False
    found = authenticate.inspect(points[~left_out], power=False)
    assert (found.verdict, [step.kind for step in found.processing]) == ("processed", ["sector"])
    assert f" (counter-clockwise from x), lasers {first} to {last} (0: the highest)" in found.reason
    assert azimuths_of(found) == pytest.approx([360 - degrees / 2, degrees / 2], abs=1.5)


def azimuths_of(found: authenticate.Inspection) -> list[float]:
    """Both ends of the sector that a verdict names, degrees."""
    match = re.search(r"from (\d+) to (\d+) degrees", found.reason)
    assert match is not None
    return [float(each) for each in match.groups()]


def test_a_sector_is_named_beside_a_missing_laser() -> None:
    points = street()
    angles = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    left_out = (angles > 45.0) & (angles < 170.0) & lasers_of(points, 5, 40)
    left_out |= lasers_of(points, 50, 50)
    found = authenticate.inspect(points[~left_out], power=False)
    assert azimuths_of(found) == pytest.approx([45.0, 170.0], abs=1.5)
    assert "lasers: 1 of the 64 lasers has no returns" in found.reason


@pytest.mark.parametrize("behind", [(30, 50), (10, 25)])
def test_the_largest_of_several_sectors_is_named(behind: tuple[int, int]) -> None:
    points = street()
    left_out = ahead(points, 60) & lasers_of(points, 20, 35)
    left_out |= ~ahead(points, 270) & lasers_of(points, *behind)
    found = authenticate.inspect(points[~left_out], power=False)
    assert f", lasers {behind[0]} to {behind[1]} (" in found.reason
    assert azimuths_of(found) == pytest.approx([135.0, 225.0], abs=1.5)


def test_missing_returns_of_a_narrower_sector_are_still_evidence() -> None:
    """A sector of some lasers leaves the rest of a scan as it was, and so all detectors judge."""
    points = street()
    left_out = ahead(points, 36) & lasers_of(points, 20, 45)
    found = authenticate.inspect(points[~left_out], power=False)
    assert (found.verdict, found.all_accusing[0].name) == ("tampered", "generic")
    assert [step.kind for step in found.processing] == ["sector"]


def test_turns_beside_a_silent_sector_are_still_compared() -> None:
    """No comparison calls the scan foreign, because it lacks what the sector would show."""
    lattice = turn_scans.LATTICE
    before, now, after = (turn_scans.turn(0.5 * k, 10 + k) for k in (-1, 0, 1))
    ring = lattice.read(now).ring
    left_out = ahead(now, 120) & (ring >= 10) & (ring <= 40)
    found = authenticate.inspect(
        LidarFrame(now[~left_out], origin=(0.0, 0.0, 0.0)), previous=before, following=after,
        lattice=lattice, power=False,
    )  # fmt: skip
    assert found.turns is not None
    kinds = {step.kind for step in found.processing}
    assert "sector" in kinds
    assert "foreign" not in kinds


@pytest.mark.parametrize(
    ("left_out", "number"),
    [((20, 21), 2), ((10, 11, 12, 13, 14, 15), 6), ((44, 45, 46), 3), ((20, 21, 30, 31), 4)],
)
def test_neighbouring_lasers_that_are_missing_are_counted(
    left_out: tuple[int, ...], number: int
) -> None:
    points = scans.scan(np.random.default_rng(8))
    lattice = scans.lattice()
    kept = ~np.isin(lattice.read(points).ring, left_out)
    found = authenticate.inspect(points[kept], lattice=lattice, power=False)
    assert found.verdict == "processed"
    details = [step.detail for step in found.processing]
    assert f"{number} of the 64 lasers have no returns" in details


def ranges(points: NDArray[np.float32]) -> NDArray[np.floating]:
    return np.linalg.norm(points.astype(np.float64), axis=1)


def heights(points: NDArray[np.float32]) -> NDArray[np.floating]:
    return points[:, 2].astype(np.float64)


def elevations(points: NDArray[np.float32]) -> NDArray[np.floating]:
    return np.degrees(np.arcsin(heights(points) / ranges(points)))


@pytest.mark.parametrize(
    ("along", "first", "last", "words"),
    [
        (ranges, 10.0, 12.0, "no points from 10.0 to 12.0 m"),
        (ranges, 20.0, 22.0, "no points from 20.0 to 22.0 m"),
        (heights, -1.2, -0.9, "no points at heights from -1.20 to -0.90 m"),
        (elevations, -5.0, -4.0, "no points at elevations from -5.0 to -4.0 degrees"),
        (elevations, -10.0, -9.0, "no points at elevations from -10.0 to -9.0 degrees"),
    ],
)
def test_a_band_that_was_cut_out_all_around_is_named(
    along: Callable[[NDArray[np.float32]], NDArray[np.floating]],
    first: float,
    last: float,
    words: str,
) -> None:
    points = street()
    values = along(points)
    found = authenticate.inspect(points[(values < first) | (values > last)], power=False)
    assert (found.verdict, found.processing[0].kind) == ("processed", "cropped")
    assert words in found.reason


def test_a_whole_street_has_no_bands_and_no_silent_sectors() -> None:
    found = authenticate.inspect(street(), power=False)
    assert (found.verdict, found.processing) == ("no_trace", ())


def test_a_cut_that_is_not_found_is_stated_as_such() -> None:
    points = street()
    z = heights(points)
    found = authenticate.inspect(points[(z < 0.4) | (z > 0.8)], power=False)
    assert (found.verdict, found.processing) == ("no_trace", ())
    assert BLIND_CUT in found.blind


STONE = Surface((0.6, 0.6, 0.6), 0.5)


def plain(
    builder: WorldBuilder, relief: Relief, *, until: float = 95.0, reflectance: float = 0.25
) -> None:
    """Add ground from 95 m to the right of a road to ``until`` metres to its left."""
    x, y = np.meshgrid(np.arange(0.0, 421.0, 2.0), np.linspace(-95.0, until, 96))
    ground = sheet(np.stack([x, y, relief(x, y)], -1), uv_box=(0.0, 0.0, 420.0, 95.0))
    builder.add([(ground, Surface((0.3, 0.3, 0.3), reflectance))], Label.GROUND)


def scan_of(builder: WorldBuilder, relief: Relief, seed: int) -> NDArray[np.float32]:
    drive = Street(builder.build(), (), relief, (60.0, -1.6), 8.0, 0.1)
    return simulate.hdl64e(drive, 3.0, rng=seed).frame.points


@pytest.mark.parametrize("edge", [3.0, 5.0, 8.0])
def test_water_beside_a_road_is_no_silent_sector(edge: float) -> None:
    """Nothing answers beyond the edge of a quay, and houses stand on the other side."""
    pytest.importorskip("open3d")
    builder, random = WorldBuilder(), np.random.default_rng(1)
    relief = Relief(random, 0.03, 30.0)
    plain(builder, relief, until=edge)
    for x in np.arange(0.0, 400.0, 10.0):
        y, height = random.uniform(-45.0, -20.0), random.uniform(4.0, 20.0)
        builder.add(block((x, y, -1.0), (x + 8.0, y + 8.0, height), STONE), Label.BUILDING)
    found = authenticate.inspect(scan_of(builder, relief, 1), power=False)
    assert (found.verdict, found.processing) == ("no_trace", ())


@pytest.mark.parametrize(
    ("seed", "unevenness", "reflectance", "nearest"),
    [(8820, 0.03, 0.05, 32.0), (8820, 0.03, 0.03, 28.0), (8821, 0.1, 0.05, 32.0)],
)
def test_the_end_of_dark_ground_is_no_band(
    seed: int, unevenness: float, reflectance: float, nearest: float
) -> None:
    """The ground answers up to a distance at which single returns get lost; trees stand beyond."""
    pytest.importorskip("open3d")
    builder, random = WorldBuilder(), np.random.default_rng(seed)
    relief = Relief(random, unevenness, 30.0)
    plain(builder, relief, reflectance=reflectance)
    for yaw in np.linspace(0.0, 2.0 * np.pi, 70, endpoint=False):
        away = nearest + random.uniform(0.0, 60.0) * random.random()
        at = (84.0 + away * np.cos(yaw), -1.6 + away * np.sin(yaw), 0.0)
        grown = tree(random, random.uniform(5.0, 15.0))
        builder.add(placed(grown, at=at, yaw=0.0), Label.VEGETATION)
    found = authenticate.inspect(scan_of(builder, relief, seed), power=False)
    assert not re.search(r"no points (from|at) ", found.reason)


def test_gaps_between_rings_on_open_ground_are_no_bands() -> None:
    """Rings on a level plain, of which a quarter of the returns are lost."""
    lattice, random = scans.lattice(), np.random.default_rng(4)
    fired = scans.firings(random)
    ring, count = (a.ravel() for a in np.meshgrid(np.arange(20, 60), fired, indexing="ij"))
    slope, offset = lattice.slope[ring], lattice.offset[ring]
    kept = random.random(len(ring)) < 0.75
    reach = (scans.GROUND - offset) / slope
    points = scans.rounded(scans.beam_points(lattice, ring[kept], count[kept], reach[kept]))
    wide = points.astype(np.float64)
    firings = firings_of(lattice.read(points), len(lattice.slope))
    assert firings is not None
    assert empty_bands(wide, np.linalg.norm(wide, axis=1), firings) == []


def test_without_four_lasers_a_drive_is_not_accused(realdata: RealData) -> None:
    """Detector V compared with turns from which the same lasers were not left out."""
    turns = []
    for number in (5, 6, 7):
        scan = read_scan(realdata(f"{RAW}/{number:010}.bin.xz"))
        turns.append(scan.select(np.flatnonzero(~lasers_of(scan.points, 30, 33))))
    found = authenticate.inspect(turns[1], previous=turns[0], following=turns[2], power=False)
    assert found.verdict == "processed"
    assert found.reason == "lasers: 4 of the 64 lasers have no returns"


@pytest.mark.parametrize("number", [0, 9])
def test_whole_frames_of_a_drive_have_neither(realdata: RealData, number: int) -> None:
    scan = read_scan(realdata(f"{RAW}/{number:010}.bin.xz"))
    assert authenticate.inspect(scan, power=False).processing == ()
    wedge = ahead(scan.points, 45) & lasers_of(scan.points, 20, 39)
    found = authenticate.inspect(scan.select(np.flatnonzero(~wedge)), power=False)
    assert azimuths_of(found) == pytest.approx([337.5, 22.5], abs=1.5)
    assert ", lasers 20 to 39 (" in found.reason
    far = ranges(scan.points)
    ring = authenticate.inspect(scan.select(np.flatnonzero(abs(far - 11.0) > 1.0)), power=False)
    assert "cropped: no points from 10.0 to 12.0 m" in ring.reason
