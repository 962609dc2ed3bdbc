"""Detectors I and II against plain NumPy, on small scans whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from cave_scans import CAVE, STEP, Points, ball, cave
from manip3d import InputError, LidarFrame, _core, forge
from manip3d.authenticate import (
    PAPER_DENSITY,
    AngularGrid,
    DensityParameters,
    OcclusionParameters,
    density_consistency,
    estimate_grid,
    inspect,
    occlusion_consistency,
)
from manip3d.io import read_scan
from manip3d.metrics import nearest_distances
from real_data import RealData

FORGED = forge.ctp(CAVE, ball(0.6, 20_000), position=(3, 1, 0))


# --- grid ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.12, 0.3, 0.5, 0.97, 1.0])
def test_grid_is_found(step: float) -> None:
    grid = estimate_grid(cave(step))
    assert grid.azimuth_deg == pytest.approx(step, rel=2e-3)
    assert grid.elevation_deg == pytest.approx(step, rel=2e-3)
    elevation = np.arange(-40 + step / 2, 60, step)
    off = (elevation - grid.elevation_phase_deg) / grid.elevation_deg
    assert np.median(np.abs(off - np.round(off))) < 0.3  # rows lie inside their cells


def test_grid_does_not_depend_on_order_or_threads() -> None:
    grid = estimate_grid(CAVE)
    assert estimate_grid(CAVE, threads=1) == grid
    shuffled = estimate_grid(np.random.default_rng(0).permutation(CAVE))
    assert shuffled.azimuth_deg == pytest.approx(grid.azimuth_deg, rel=1e-4)


def test_points_without_a_grid_get_the_size_of_their_density() -> None:
    grid = estimate_grid(ball(5.0, 40_000))
    assert grid.azimuth_strength == grid.elevation_strength == 0.0
    area = 360 * 180 / 40_000  # a rectangle of all azimuths and elevations
    assert grid.azimuth_deg * grid.elevation_deg == pytest.approx(area, rel=0.1)


# --- detector II --------------------------------------------------------------------------------


def masks(
    points: Points, grid: AngularGrid, gap: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Raw and cleaned mask over all elevations, as the formulas say, and the scan's first row."""
    p = points.astype(float)
    r = np.linalg.norm(p, axis=1)
    azimuth = np.degrees(np.arctan2(p[:, 1], p[:, 0]))
    elevation = np.degrees(np.arcsin(p[:, 2] / r))
    columns = round(360 / grid.azimuth_deg)
    rows = int(180 / grid.elevation_deg) + 2

    def index(
        angle: NDArray[np.float64], low: float, phase: float, step: float
    ) -> NDArray[np.int_]:
        first = low + ((phase - low) / step - math.floor((phase - low) / step) - 0.5) * step
        first = first - step if first > low else first
        return ((angle - first) / step).astype(int)

    column = index(azimuth, -180, grid.azimuth_phase_deg, grid.azimuth_deg) % columns
    row = index(elevation, -90, grid.elevation_phase_deg, grid.elevation_deg)
    near, far = np.full((rows, columns), np.inf), np.zeros((rows, columns))
    np.minimum.at(near, (row, column), r)
    np.maximum.at(far, (row, column), r)
    raw = far - near > gap
    wrapped = np.pad(raw, ((2, 2), (4, 4)), mode="constant")
    wrapped[:, :4], wrapped[:, -4:] = wrapped[:, -8:-4], wrapped[:, 4:8]
    box = np.ones((3, 3))
    closed = ndimage.binary_erosion(ndimage.binary_dilation(wrapped, box), box)
    closed[:3] = closed[-3:] = False  # beyond the poles there is nothing
    median = ndimage.median_filter(closed.astype(np.uint8), size=3)
    return raw, median[2:-2, 4:-4].astype(bool), int(row.min())


@pytest.mark.parametrize("turn", [0.0, math.pi])
def test_mask_is_that_of_the_formulas(turn: float) -> None:
    where = (3 * math.cos(turn), 3 * math.sin(turn), 0.2)  # the second goes round the back
    forged = forge.ctp(CAVE, ball(0.6, 20_000), position=where).points
    result = occlusion_consistency(forged)
    *expected, first = masks(forged, result.grid, result.parameters.min_gap)
    rows = slice(first, first + len(result.mask))  # the result has the rows on which points lie
    for found, wanted in zip((result.raw_mask, result.mask), expected, strict=True):
        assert wanted.sum() > 100
        assert wanted.sum() == wanted[rows].sum()
        # Cells decided by single precision may differ at their borders.
        assert (found != wanted[rows]).sum() <= 0.01 * wanted.sum()
    assert result.verdict == "tampered"
    assert len(result.regions) == 1
    region = result.regions[0]
    columns = result.mask.shape[1]
    assert (region.mask_columns[0] > region.mask_columns[1]) == (turn > 0)
    width = (region.mask_columns[1] - region.mask_columns[0]) % columns + 1
    assert width * result.grid.azimuth_deg == pytest.approx(
        2 * math.degrees(math.asin(0.6 / 3.0)), abs=1.0
    )
    # The only region: its first and last row are those of the marked cells.
    marked_rows = np.flatnonzero(result.mask.any(axis=1))
    assert region.mask_rows == (marked_rows[0], marked_rows[-1])


@pytest.mark.parametrize(("begin", "span"), [(-135.0, 270.0), (45.0, 270.0), (-170.0, 100.0)])
def test_a_region_of_more_than_half_a_turn_has_all_of_its_columns(
    begin: float, span: float
) -> None:
    """A belt around the scanner; the second crosses the seam."""
    azimuth = np.radians(begin + np.arange(0.0, span, 0.1))
    belt = np.concatenate(
        [np.c_[3 * np.cos(azimuth), 3 * np.sin(azimuth), np.full(len(azimuth), z)]
         for z in np.arange(-0.3, 0.3, 0.01)]
    )  # fmt: skip
    result = occlusion_consistency(np.concatenate([CAVE, belt.astype(np.float32)]))
    region = result.regions[0]
    first, last = ((edge * result.grid.azimuth_deg - 180.0) % 360.0 for edge in region.mask_columns)
    assert first == pytest.approx(begin % 360.0, abs=1.0)
    assert last == pytest.approx((begin + span) % 360.0, abs=1.0)


def test_region_is_the_object() -> None:
    result = occlusion_consistency(FORGED.points)
    assert occlusion_consistency(CAVE).verdict == "no_trace"
    assert result.verdict == "tampered"
    box = result.boxes[0]
    np.testing.assert_allclose(box.center, (3, 1, 0), atol=0.1)
    np.testing.assert_allclose(box.size, (1.2, 1.2, 1.2), atol=0.1)
    precision = np.isin(result.suspected, FORGED.added).mean()
    recall = np.isin(FORGED.added, result.suspected).mean()
    assert precision > 0.99
    assert recall > 0.95
    distance = math.sqrt(10.0)
    solid_angle = 2 * math.pi * (1 - math.sqrt(1 - (0.6 / distance) ** 2))
    assert result.regions[0].solid_angle == pytest.approx(solid_angle, rel=0.06)
    assert result.calibration is not None


def test_an_object_with_a_shadow_passes() -> None:
    forged = forge.insert_occluding(CAVE, ball(0.6, 20_000), position=(3, 1, 0))
    assert len(forged.moved) > 100
    assert occlusion_consistency(forged.points).verdict == "no_trace"


def test_threads_and_order_do_not_matter() -> None:
    points = FORGED.points
    first = occlusion_consistency(points, threads=1)
    order = np.random.default_rng(0).permutation(len(points))
    for given, back, threads in ((points, np.arange(len(points)), 4), (points[order], order, 2)):
        again = occlusion_consistency(given, grid=first.grid, threads=threads)
        np.testing.assert_array_equal(first.mask, again.mask)
        np.testing.assert_array_equal(first.suspected, np.sort(back[again.suspected]))
        assert [r.cells for r in first.regions] == [r.cells for r in again.regions]


def test_printed_sum_depends_on_the_order() -> None:
    grid = AngularGrid(1.0, 1.0)
    ray = np.array([[1, 0, 0], [2, 0, 0], [3, 0, 0]])
    shell = ball(4.0, 4000)
    shell = shell[np.abs(shell[:, 1]) + np.abs(shell[:, 2]) > 1.0]

    def marked(order: list[int], gap: float) -> int:
        scan = np.concatenate([shell, ray[order]])
        parameters = OcclusionParameters(min_gap=gap, accumulate=True, min_cells=1, min_area=0.0)
        return int(occlusion_consistency(scan, parameters=parameters, grid=grid).raw_mask.sum())

    # 1, 2, 3 sum to 2; 1, 3, 2 to 3.
    base = marked([0, 1, 2], 2.5)
    assert marked([0, 2, 1], 2.5) == base + 1
    assert marked([0, 1, 2], 1.5) == marked([0, 2, 1], 1.5)


def test_regions_of_the_printed_sum_have_points() -> None:
    """Its gaps exceed the limit where no point is so far in front of another."""
    near = CAVE[:, :2].max() / 2 * np.array([1.0, 0.0, 0.0])
    rng = np.random.default_rng(0)
    patch = near + rng.normal(0.0, [0.02, 0.2, 0.2], (4000, 3))  # 0.1 m thick
    hidden = (np.abs(CAVE[:, 1]) < 2.0) & (np.abs(CAVE[:, 2]) < 2.0) & (CAVE[:, 0] > 0.0)
    scan = np.concatenate([CAVE[~hidden], patch]).astype(np.float32)
    parameters = OcclusionParameters(min_gap=0.3, accumulate=True, min_cells=20, min_area=0.0)
    result = occlusion_consistency(scan, parameters=parameters)
    assert result.verdict == "tampered"
    region = result.regions[0]
    assert region.range == pytest.approx(near[0], rel=0.05)
    assert region.area > 0.01
    assert len(region.rows) > region.cells / 2
    assert np.isin(region.rows, np.arange(len(scan) - 4000, len(scan))).all()
    assert np.abs(region.box.center - near).max() < 0.2


def test_fused_scans_are_undecidable() -> None:
    moved = CAVE + np.float32([2.0, 1.0, 0.3])
    result = occlusion_consistency(np.concatenate([CAVE, moved]))
    assert result.verdict == "undecidable"
    assert "no single position" in result.reason


def test_second_echoes_are_left_out() -> None:
    scan = np.concatenate([CAVE, CAVE[:40_000] * np.float32(1.3)])
    index = np.ones(len(scan), np.uint8)
    index[len(CAVE) :] = 2
    frame = LidarFrame(scan, fields={"target_index": index})
    assert occlusion_consistency(frame).verdict == "no_trace"
    assert occlusion_consistency(scan).verdict != "no_trace"


def posts_in_the_cave(share: float) -> tuple[Points, Points]:
    """A cave with a post in each 30 degrees, and second echoes of beams at their edges."""
    azimuth = np.degrees(np.arctan2(CAVE[:, 1], CAVE[:, 0]))
    off = np.abs((azimuth + 7.5) % 30.0 - 15.0)
    first = (CAVE * np.where(off < 3.0, 0.5, 1.0)[:, None]).astype(np.float32)
    has_two = (off > 2.4) & (off < 3.0) & (np.random.default_rng(0).random(len(CAVE)) < share)
    return first, CAVE[has_two]


@pytest.mark.parametrize("share", [0.6, 1.0])
@pytest.mark.parametrize("is_shuffled", [False, True])
def test_second_echoes_that_nobody_numbered_are_no_forgery(share: float, is_shuffled: bool) -> None:
    """Clean scans of scanners with several echoes, as XYZ or NPY, had been accused."""
    first, second = posts_in_the_cave(share)
    assert occlusion_consistency(first).verdict == "no_trace"
    both = np.concatenate([first, second])
    if is_shuffled:
        both = both[np.random.default_rng(1).permutation(len(both))]
    found = occlusion_consistency(both)
    assert (found.verdict, found.regions, len(found.suspected)) == ("undecidable", (), 0)
    assert found.echoes > 0
    assert "does not number echoes" in found.reason
    judged = inspect(LidarFrame(both))
    assert (judged.verdict, [step.kind for step in judged.processing]) == ("processed", ["echoes"])


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("place", [(2, 1, 0), (12, 6, 0)], ids=["in front", "behind"])
def test_what_was_pasted_among_second_echoes_is_found(
    share: float, place: tuple[float, float, float]
) -> None:
    scan = np.concatenate(posts_in_the_cave(share))
    pasted = ball(0.6, 20_000) + np.float32(place)
    found = occlusion_consistency(np.concatenate([scan, pasted]))
    assert found.verdict == "tampered"
    assert len(found.regions) == 1
    center = found.regions[0].box.center
    ahead = math.atan2(place[1], place[0])
    assert math.atan2(center[1], center[0]) == pytest.approx(ahead, abs=0.1)
    assert inspect(LidarFrame(np.concatenate([scan, pasted]))).verdict == "tampered"


@pytest.mark.parametrize(("name", "first"), [("return_number", 1), ("returnIndex", 0)])
def test_an_echo_is_no_later_one_because_the_file_says_so(name: str, first: int) -> None:
    """A real one is behind the first of its pulse; a pasted ball is in front."""
    in_front = np.concatenate([CAVE, ball(0.6, 20_000) + np.float32([3, 1, 0])])
    behind = np.concatenate([CAVE, CAVE[:40_000] * np.float32(1.3)])
    for points, verdict in ((in_front, "tampered"), (behind, "no_trace")):
        index = np.full(len(points), first, np.uint8)
        index[len(CAVE) :] += 1
        found = occlusion_consistency(LidarFrame(points, fields={name: index}))
        assert found.verdict == verdict
        assert (found.suspected >= len(CAVE)).any() == (verdict == "tampered")


def test_origin_of_the_frame_is_used() -> None:
    away = np.float32([100, 200, 30])
    frame = LidarFrame(FORGED.points + away, origin=(100, 200, 30))
    result = occlusion_consistency(frame)
    assert result.verdict == "tampered"
    np.testing.assert_allclose(result.boxes[0].center, (103, 201, 30), atol=0.1)


# --- detector I ---------------------------------------------------------------------------------


@pytest.mark.parametrize("sector", [0, 10, 30])
def test_levels_are_the_means_of_the_formulas(sector: int) -> None:
    distances = nearest_distances(CAVE)
    origin = np.zeros(3)
    sectors, edges, counts, means = _core.density_levels(
        CAVE, distances, origin, sector, 0.25, 0.05, 50.0, sector > 0, 2
    )
    p = CAVE.astype(float)
    r = np.linalg.norm(p, axis=1)
    level = np.digitize(r, edges) - 1
    value = distances / np.maximum(np.hypot(p[:, 0], p[:, 1]) / r, 0.2) if sector else distances
    key = level
    if sector:
        azimuth = (np.degrees(np.arctan2(p[:, 1], p[:, 0])) + 180) / sector
        elevation = (np.degrees(np.arcsin(p[:, 2] / r)) + 90) / sector
        key = (elevation.astype(int) * (360 // sector) + azimuth.astype(int)) * (len(edges) - 1)
        key = key + level
    number = np.bincount(key, minlength=sectors * (len(edges) - 1))
    total = np.bincount(key, weights=value, minlength=len(number))
    assert counts.sum() == len(CAVE)
    assert np.abs(counts - number).sum() <= 0.01 * len(CAVE)  # borders hold to 5 mm
    many = (counts == number) & (number > 200)
    np.testing.assert_allclose(means[many], total[many] / number[many], rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("max_range", [1.3149999999999997, 60.02499999999999, 2000.0449999999998])
def test_a_range_just_below_the_largest_is_in_the_last_level(max_range: float) -> None:
    last = np.nextafter(np.float32(max_range), np.float32(0))
    point = np.array([[last, 0, 0]], np.float32)
    grid = (np.zeros(3), 0, 0.05, 0.01, max_range)
    counts = _core.density_levels(point, np.array([0.1]), *grid, True, 1)[2]
    assert np.flatnonzero(counts).tolist() == [len(counts) - 1]
    marks = np.arange(len(counts)) == len(counts) - 1
    assert _core.points_of_levels(point, marks.astype(np.uint8), *grid, 1).tolist() == [0]


@pytest.mark.parametrize("distance", [np.nan, -5.0])
def test_distances_that_are_none_are_refused(distance: float) -> None:
    points = np.array([[5, 0, 0], [6, 0, 0]], np.float32)
    with pytest.raises(InputError, match=r"distances: expected at least 0, got .* in row 1"):
        _core.density_levels(
            points, np.array([0.1, distance]), np.zeros(3), 0, 0.05, 0.01, 50.0, True, 1
        )


def test_a_dense_object_is_found_and_a_resampled_one_is_not() -> None:
    assert density_consistency(CAVE).verdict == "no_trace"
    finer = DensityParameters(sector=10, level_width=0.1, fall=0.6)
    assert density_consistency(CAVE, parameters=finer).verdict == "no_trace"
    hoax = ball(0.35, 8000)
    forged = forge.ctp(CAVE, hoax, position=(3.5, 1, 0))
    dense = density_consistency(forged.points, parameters=finer)
    assert dense.verdict == "tampered"
    assert np.isin(forged.added, dense.suspected).mean() > 0.7
    (low, high) = dense.offending[:, 0].min(), dense.offending[:, 1].max()
    assert low < math.hypot(3.5, 1) < high
    assert dense.score >= 1.0
    same = forge.crtp(CAVE, hoax, position=(3.5, 1, 0), spacing=3.6 * math.radians(STEP))
    assert density_consistency(same.points, parameters=finer).verdict == "no_trace"
    assert occlusion_consistency(same.points).verdict == "tampered"


def tilted(points: Points) -> Points:
    """The same surfaces scanned about a lying axis: columns crowd at its two ends."""
    return np.ascontiguousarray(points[:, [2, 0, 1]])


def test_a_scan_on_which_spacing_is_no_law_is_not_judged() -> None:
    finer = DensityParameters(sector=10, level_width=0.1, fall=0.6)
    for scan in (tilted(cave(noise=0.0)), np.repeat(CAVE, 2, axis=0)):
        found = density_consistency(scan, parameters=finer)
        assert found.verdict == "undecidable"
        assert len(found.suspected) == len(found.boxes) == 0
    assert "no spacing is known" in found.reason


@pytest.mark.parametrize(
    "name",
    [
        "riegl_vz400i_forest.ply.xz",
        "room_scan1.ply.xz",
        *(f"3dtk_dat/scan00{i}.3d.xz" for i in range(3)),
    ],
)
def test_real_scans_of_other_laws_are_not_accused(realdata: RealData, name: str) -> None:
    assert density_consistency(read_scan(realdata(f"lidar/tls/{name}"))).verdict == "undecidable"


def test_paper_signal_is_a_moving_average_over_range() -> None:
    result = density_consistency(CAVE, parameters=PAPER_DENSITY)
    distances = nearest_distances(CAVE)
    level = (np.linalg.norm(CAVE.astype(float), axis=1) / 0.2).astype(int)
    number = np.bincount(level)
    mean = np.bincount(level, weights=distances) / np.maximum(number, 1)
    mean[number < 10] = np.nan
    middle = 40  # 8 m
    assert result.signal[middle] == pytest.approx(
        np.nanmean(mean[middle - 3 : middle + 4]), rel=1e-3
    )
    a = np.nanmedian(result.signal / result.ranges)
    np.testing.assert_allclose(result.fit[middle], a * result.ranges[middle], rtol=1e-9)
    assert result.calibration is None


def test_density_does_not_depend_on_threads_or_order() -> None:
    first = density_consistency(FORGED.points, threads=1)
    order = np.random.default_rng(0).permutation(len(FORGED.points))
    again = density_consistency(FORGED.points[order], threads=4)
    np.testing.assert_array_equal(first.ratio, again.ratio)
    np.testing.assert_array_equal(first.suspected, np.sort(order[again.suspected]))


Outcome = tuple[str, str]
FEW: Outcome = ("undecidable", "fewer than 1000 points")
LEVELS: Outcome = ("undecidable", "too few levels of range")
NOTHING: Outcome = ("no_trace", "nothing is seen behind anything")
NOWHERE: Outcome = ("undecidable", "all points lie in 0 directions")
COPIES: Outcome = ("undecidable", "all points lie in 1 direction")


# --- both ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("detect", [density_consistency, occlusion_consistency])
@pytest.mark.parametrize(
    ("scan", "density", "occlusion"),
    [
        (np.zeros((0, 3)), FEW, FEW),
        (np.ones((1, 3)), FEW, FEW),
        (np.ones((5000, 3)), LEVELS, COPIES),
        (np.zeros((5000, 3)), LEVELS, NOWHERE),
        (np.full((5000, 3), 1e9), LEVELS, COPIES),
        (np.outer(np.linspace(1, 100, 5000), [1.0, 2.0, 3.0]), LEVELS, COPIES),
        (np.repeat(CAVE[:2000], 3, axis=0), LEVELS, NOTHING),
        (CAVE * 1e9, LEVELS, NOTHING),
        (CAVE * 1e-9, LEVELS, NOTHING),
    ],
    ids=["empty", "one", "same", "origin", "far", "ray", "duplicates", "huge", "tiny"],
)
def test_hostile_scans(
    detect: Callable[[Points], Any], scan: Points, density: Outcome, occlusion: Outcome
) -> None:
    verdict, reason = density if detect is density_consistency else occlusion
    result = detect(scan)
    assert result.verdict == verdict
    assert result.reason.startswith(reason)
    assert not result.reason.endswith("1 directions")
    assert len(result.suspected) == len(result.boxes) == 0


@pytest.mark.parametrize("detect", [density_consistency, occlusion_consistency])
def test_what_is_refused(detect: object) -> None:
    scan = CAVE.copy()
    scan[77, 2] = np.nan
    with pytest.raises(InputError, match="row 77"):
        detect(scan)  # type: ignore[operator]
    with pytest.raises(InputError, match="origin"):
        detect(CAVE, origin=(0, 0))  # type: ignore[operator]
    with pytest.raises(InputError, match="threads"):
        detect(CAVE, threads=-1)  # type: ignore[operator]


def test_bad_parameters() -> None:
    with pytest.raises(InputError, match="window"):
        DensityParameters(window=2)
    with pytest.raises(InputError, match="fall"):
        DensityParameters(fall=1.5)
    with pytest.raises(InputError, match="fused"):
        OcclusionParameters(fused=0.0)
    for area in (-1.0, np.nan):  # with NaN there was no trace of anything
        with pytest.raises(InputError, match="min_area: expected >= 0, got"):
            OcclusionParameters(min_area=area)
    with pytest.raises(InputError, match="min_gap"):
        occlusion_consistency(CAVE, parameters=OcclusionParameters(min_gap=-1.0))
    with pytest.raises(InputError, match="2\\^28 cells"):
        occlusion_consistency(CAVE, grid=AngularGrid(1e-4, 1e-4))
    with pytest.raises(InputError, match="sector"):
        density_consistency(CAVE, parameters=DensityParameters(sector=7))


@pytest.mark.parametrize(
    "name", ["object/velodyne/demo", "stereo2015/velodyne/000083", "odometry/00/velodyne/000001"]
)
def test_rings_that_share_no_cell_accuse_nobody(realdata: RealData, name: str) -> None:
    path = realdata(f"lidar/kitti_{name}.bin.xz")
    assert occlusion_consistency(read_scan(path)).verdict == "no_trace"


def test_empty_rows_of_a_terrestrial_scan_are_at_the_scanner() -> None:
    """Points that lie together in the scanner have no direction to look for neighbours in."""
    points = np.concatenate([CAVE, np.zeros((500, 3), np.float32)])
    distances = nearest_distances(points, origin=(0.0, 0.0, 0.0))
    assert (distances[-500:] == 0.0).all()
    found = density_consistency(points, origin=(0.0, 0.0, 0.0))
    assert found.verdict == density_consistency(CAVE, origin=(0.0, 0.0, 0.0)).verdict
