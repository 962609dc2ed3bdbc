"""LiDAR against stereo depth, on scenes whose ranges are known by formula."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import Box, LidarFrame
from manip3d.authenticate import (
    CrossModalParameters,
    CrossModalRegion,
    CrossModalResult,
    Disparity,
    StereoRig,
    attack_type,
    cross_modal_consistency,
    stereo_disparity,
)
from manip3d.authenticate._cross_modal import nearest_place
from manip3d.errors import InputError

Floats = NDArray[np.float64]

WIDTH, HEIGHT, FOCAL, BASELINE = 620, 188, 360.0, 0.54
EYE = np.array([0.27, 0.0, -0.08])  # of the left camera in the LiDAR's frame
TO_LIDAR = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
RIG = StereoRig(
    FOCAL,
    (309.5, 86.0),
    BASELINE,
    np.block([[TO_LIDAR, EYE[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]),
)
WALL, GROUND = 30.0, -1.7  # metres ahead, and below the scanner
CAR = Box((12.0, 1.0, -0.9), (4.0, 1.8, 1.6))


def ranges(origin: Floats, rays: Floats, boxes: tuple[Box, ...]) -> Floats:
    """Return the distance along each ray to ground, wall or the nearest box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = (WALL - origin[0]) / rays[:, 0]
        ground = (GROUND - origin[2]) / rays[:, 2]
        nearest = np.where(ground > 0.0, np.minimum(wall, ground), wall)
        for box in boxes:
            low = (np.asarray(box.center) - np.asarray(box.size) / 2 - origin) / rays
            high = (np.asarray(box.center) + np.asarray(box.size) / 2 - origin) / rays
            enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
            hit = (enter <= leave) & (enter > 0.0)
            nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    return nearest


def lidar(*boxes: Box) -> LidarFrame:
    """Scan the front half with 64 rings and an azimuth step of 0.18 degrees."""
    azimuth = np.radians(np.arange(-80.0, 80.0, 0.18))
    elevation = np.radians(np.linspace(-24.8, 2.0, 64))
    a, e = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    distance = ranges(np.zeros(3), rays, boxes)
    return LidarFrame((rays * distance[:, None])[distance < 80.0].astype(np.float32))


def cameras(*boxes: Box, noise: float = 0.0) -> Disparity:
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    (cu, cv) = RIG.center
    seen = np.stack([(u - cu) / FOCAL, (v - cv) / FOCAL, np.ones(u.shape)], axis=-1)
    rays = seen.reshape(-1, 3) @ TO_LIDAR.T  # of length 1 along the camera's axis: depth
    depth = ranges(EYE, rays, boxes).reshape(u.shape)
    disparity = FOCAL * BASELINE / depth
    disparity += noise * np.random.default_rng(0).standard_normal(u.shape)
    return Disparity(disparity.astype(np.float32))


def judged(scan: LidarFrame, disparity: Disparity, **parameters: float) -> CrossModalResult:
    return cross_modal_consistency(
        scan, disparity, RIG, parameters=CrossModalParameters(**parameters)
    )


def overlaps(found: Box, wanted: Box, slack: float = 0.6) -> bool:
    gap = np.abs(np.subtract(found.center, wanted.center))
    return bool(np.all(gap <= np.add(found.size, wanted.size) / 2 + slack))


def test_the_same_scene_has_no_contradiction() -> None:
    result = judged(lidar(CAR), cameras(CAR, noise=0.2))
    assert result.verdict == "no_trace"
    assert result.regions == ()
    assert result.attack == ""
    assert not result.mask.any()
    assert result.observation(speed_mps=15.0) is None
    # Both maps hold the ranges of the formula, but at edges.
    both = result.judged & (result.lidar > 0) & (result.stereo > 0)
    ratio = result.lidar[both] / result.stereo[both]
    assert np.mean(np.abs(ratio - 1) < 0.1) > 0.95
    left, right = result.judged_azimuth_deg
    assert 38.0 < left < 42.0
    assert -42.0 < right < -38.0
    assert 0.1 < result.judged_points < 0.6  # of the half turn that these scans have


def test_an_added_car_is_found_where_it_stands() -> None:
    result = judged(lidar(CAR), cameras())
    assert result.verdict == "tampered"
    assert result.attack == "additive"
    region = result.regions[0]
    assert region.kind == "added"
    assert overlaps(region.box, CAR, slack=0.0)
    inside = Box(CAR.center, tuple(np.add(CAR.size, 0.02)))  # type: ignore[arg-type]
    assert inside.contains(lidar(CAR).points[result.suspected]).all()
    assert len(result.suspected) > 500
    assert region.difference > 3.0


def test_a_missing_car_is_found_where_it_was() -> None:
    clean, car = lidar(CAR), CAR.contains(lidar(CAR).points)
    for scan, empty in ((lidar(), False), (clean.select(~car), True)):
        result = judged(scan, cameras(CAR))
        assert result.attack == "subtractive"
        region = result.regions[0]
        assert region.kind == "missing"
        assert overlaps(region.box, CAR, slack=0.0)
        assert (region.empty > region.cells // 2) == empty
        assert len(result.suspected) == 0


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize(("scanned", "seen", "sign"), [((CAR,), (), 1), ((), (CAR,), -1)])
def test_the_difference_of_a_marked_cell_exceeds_the_tolerance(
    scanned: tuple[Box, ...], seen: tuple[Box, ...], sign: int, noise: float
) -> None:
    """Marks compare extremes of 3x3 cells, the difference a mean: the mean is at least as far."""
    result = judged(lidar(*scanned), cameras(*seen, noise=noise))
    marked = result.mask == sign
    assert marked.sum() > 50
    assert (sign * result.difference[marked]).min() > CrossModalParameters().tolerance


def test_a_moved_car_is_a_modification_and_two_far_apart_are_both() -> None:
    moved = Box((15.0, 1.25, -0.9), CAR.size)
    result = judged(lidar(moved), cameras(CAR))
    assert result.attack == "modification"
    assert [region.kind for region in result.regions] == ["missing"]  # nothing is nearer
    nearer = Box((9.0, 0.75, -0.9), CAR.size)
    assert judged(lidar(nearer), cameras(CAR)).attack in ("modification", "additive")
    beside = Box((12.0, -2.5, -0.9), CAR.size)
    assert judged(lidar(beside), cameras(CAR)).attack == "modification"
    far = Box((20.0, -8.0, -0.9), CAR.size)
    assert judged(lidar(far), cameras(CAR)).attack == "both"


def region(kind: str, x: float, y: float, area: float) -> CrossModalRegion:
    return CrossModalRegion(kind, 9, 0, 0.01, area, 5.0, Box((x, y, 0.0), (1.0, 1.0, 1.0)), 2.0)


@pytest.mark.parametrize(
    ("regions", "expected"),
    [
        ([], ""),
        ([("added", 10, 0, 2)], "additive"),
        ([("missing", 10, 0, 2), ("missing", 30, 9, 2)], "subtractive"),
        ([("added", 10, 0, 2), ("missing", 14.9, 0, 2)], "modification"),  # near
        ([("added", 10, 0, 2), ("missing", 30, 0, 5.9)], "modification"),  # same direction
        ([("added", 10, 0, 2), ("missing", 30, 0, 6.1)], "both"),  # of another size
        ([("added", 10, 0, 2), ("missing", 30, 0, 0)], "both"),
        ([("added", 10, 0, 2), ("missing", 10, 8, 2)], "both"),
    ],
)  # fmt: skip
def test_types(regions: list[tuple[str, float, float, float]], expected: str) -> None:
    assert attack_type([region(*each) for each in regions]) == expected


@pytest.mark.parametrize(
    ("empty", "behind", "expected"),
    [
        (75, 25, "modification"),
        (76, 24, "subtractive"),  # less than a quarter of it is still there
        (0, 50, "modification"),
        (0, 49, "subtractive"),  # most of what is there was hidden before
        (100, 0, "subtractive"),
    ],
)
def test_what_stands_behind_its_place_was_moved_away(
    empty: int, behind: int, expected: str
) -> None:
    gone = replace(region("missing", 10, 0, 2), cells=100, empty=empty, behind=behind)
    assert attack_type([gone]) == expected


def test_where_the_cameras_see_nothing_nothing_is_said() -> None:
    blind = Disparity(np.zeros((HEIGHT, WIDTH), np.float32))
    result = judged(lidar(CAR), blind)
    assert result.verdict == "undecidable"
    assert result.judged_points == 0.0
    assert result.judged_azimuth_deg == (0.0, 0.0)
    half = cameras().values.copy()
    half[:, : WIDTH // 2] = 0.0  # the left half, in which the car stands
    result = judged(lidar(CAR), Disparity(half))
    assert not result.judged[:, : result.judged.shape[1] // 2 - 5].any()


def test_that_a_dark_car_returns_nothing_is_weak_evidence() -> None:
    everything = lidar(CAR)
    gone = everything.select(~CAR.contains(everything.points))
    seen = cameras(CAR)
    regions = []
    for level in (200, 20):
        grey = np.full(seen.values.shape, level, np.uint8)
        told = judged(gone, Disparity(seen.values, grey=grey))
        assert told.attack == "subtractive"  # a whole car is enough even so
        regions.append(told.regions[0])
    bright, dark = regions
    assert bright.dark == 0
    assert dark.dark == dark.empty > 0
    assert dark.area == bright.area == bright.evidence
    # Cells in which the scanner sees what is behind the car count as before.
    assert 0.25 * dark.area <= dark.evidence < 0.6 * dark.area
    assert dark.score < bright.score
    least = (dark.evidence + bright.evidence) / 2
    for level, expected in ((200, "tampered"), (20, "no_trace")):
        grey = np.full(seen.values.shape, level, np.uint8)
        told = judged(gone, Disparity(seen.values, grey=grey), min_missing_area=least)
        assert told.verdict == expected
    # A dark car that the scanner sees elsewhere is as good as any other.
    grey = np.full(seen.values.shape, 20, np.uint8)
    behind = judged(lidar(), Disparity(seen.values, grey=grey)).regions[0]
    assert behind.dark <= behind.empty < behind.cells // 2


def test_what_is_nearer_than_cameras_can_match_is_not_added() -> None:
    """At 5 m and 40 degrees to the side a thing is 3.6 m before the cameras: they cannot see it."""
    for x, expected in ((3.7, "no_trace"), (5.2, "tampered")):
        beside = Box((x, -3.4, -0.6), (0.6, 0.6, 2.0))
        assert judged(lidar(beside), cameras()).verdict == expected, x


def test_risk_counts_what_is_missing_too() -> None:
    clean = lidar(CAR)
    gone = clean.select(~CAR.contains(clean.points))
    for scan, seen in ((lidar(CAR), ()), (gone, (CAR,))):
        observed = judged(scan, cameras(*seen)).observation(speed_mps=15.0)
        assert observed is not None
        assert observed.changed > 50
        assert observed.changed < observed.cells
        assert 9.5 < observed.distance < 12.5


def test_a_nearer_contradiction_beside_the_car_hides_none_ahead() -> None:
    post = Box((5.2, -3.4, -0.6), (0.6, 0.6, 2.0))
    alone = judged(lidar(CAR), cameras()).observation(speed_mps=15.0)
    found = judged(lidar(CAR, post), cameras())
    both = found.observation(speed_mps=15.0)
    assert alone is not None
    assert both is not None
    assert len(found.boxes) == 2
    assert min(math.hypot(*nearest_place(box)) for box in found.boxes) < 7.0
    assert both.position == pytest.approx(alone.position)


def test_a_box_around_the_scanner_is_not_behind_it() -> None:
    place = nearest_place(Box((-1.0, 1.0, 0.0), (8.0, 8.0, 2.0)))
    assert math.atan2(place[1], place[0]) == 0.0


def test_a_map_of_half_the_size_gives_the_same() -> None:
    whole = cameras(CAR).values
    quarter = whole[: HEIGHT // 2 * 2, : WIDTH // 2 * 2].reshape(HEIGHT // 2, 2, WIDTH // 2, 2)
    halved = Disparity(quarter.mean(axis=(1, 3)) / 2, step=2)
    for scan in (lidar(CAR), lidar()):
        a, b = judged(scan, cameras(CAR)), judged(scan, halved)
        assert a.verdict == b.verdict
        if a.regions:
            assert overlaps(b.regions[0].box, a.regions[0].box, slack=0.0)
            assert b.regions[0].difference == pytest.approx(a.regions[0].difference, rel=0.2)


@pytest.mark.parametrize("there", [(CAR,), ()], ids=["missing", "added"])
def test_a_mirrored_scene_has_the_mirrored_map(there: tuple[Box, ...]) -> None:
    """The cameras look straight ahead from the middle plane, so left and right are alike."""
    gone = () if there else (CAR,)
    scan, disparity = lidar(*gone), cameras(*there)
    mirrored_scan = LidarFrame(scan.points * np.float32([1.0, -1.0, 1.0]))
    mirrored = Disparity(np.ascontiguousarray(disparity.values[:, ::-1]))
    one, other = judged(scan, disparity), judged(mirrored_scan, mirrored)
    assert np.count_nonzero(one.mask) > 100
    for name in ("judged", "mask", "lidar", "stereo", "difference"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name)[:, ::-1])


def test_results_do_not_depend_on_the_order_of_points() -> None:
    scan = lidar(CAR)
    turned = scan.select(np.arange(scan.num_points)[::-1])
    a, b = judged(scan, cameras()), judged(turned, cameras())
    assert np.array_equal(a.mask, b.mask)
    assert np.array_equal(a.difference, b.difference)
    assert np.array_equal(np.sort(scan.num_points - 1 - b.suspected), a.suspected)


def test_strange_scans_and_maps_are_judged_or_refused() -> None:
    far = np.full((3, 3), 1e30, np.float32)
    for points in (np.zeros((0, 3)), np.zeros((5, 3)), far, np.full((2, 3), 1e-40)):
        assert judged(LidarFrame(points.astype(np.float32)), cameras()).verdict in (
            "no_trace",
            "tampered",
        )
    wild = cameras().values.copy()
    wild[::3] = np.inf
    wild[1::3] = 1e-30
    wild[2::3] = np.nan
    assert judged(lidar(), Disparity(wild)).verdict == "undecidable"


@pytest.mark.parametrize(("factor", "dtype"), [(16, np.int16), (256, np.uint16)])
def test_integers_are_divided_before_they_are_a_map(factor: int, dtype: type) -> None:
    """OpenCV's sixteenths of a pixel and KITTI's 256ths called a clean scan tampered."""
    stored = np.round(cameras(CAR).values * factor).astype(dtype)
    with pytest.raises(InputError, match=r"values: expected floats.*by 16\.0.*by 256\.0"):
        Disparity(stored)
    assert judged(lidar(CAR), Disparity(stored / factor)).verdict == "no_trace"


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"azimuth_step": 0.0}, "azimuth_step, elevation_step: expected finite numbers > 0"),
        ({"azimuth_step": math.inf}, "azimuth_step, elevation_step: expected finite numbers > 0"),
        ({"elevation_step": math.inf}, "azimuth_step, elevation_step: expected finite numbers"),
        ({"azimuth_step": 1e-6}, "at most 2\\^22 cells"),
        ({"half_azimuth": 91.0}, "half_azimuth: expected"),
        ({"lowest": 3.0}, "lowest, highest"),
        ({"min_range": 50.0}, "min_range, max_range"),
        ({"max_range": math.inf}, "min_range, max_range"),
        ({"tolerance": math.nan}, "tolerance: expected a number > 0"),
        ({"min_added_area": math.nan}, "min_cells, min_added_area"),
        ({"dark_level": math.inf}, "dark_level, dark_weight"),
        ({"dark_weight": 1.5}, "dark_level, dark_weight"),
    ],
)
def test_bad_parameters_are_named(parameters: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        judged(lidar(), cameras(), **parameters)


def picture_of(grey: NDArray[np.uint8]) -> Disparity:
    return Disparity(np.zeros((5, 5), np.float32), grey=grey)


def test_bad_rigs_and_maps_are_named() -> None:
    bad: list[tuple[Callable[[], object], str]] = [
        (lambda: StereoRig(0.0, (1.0, 1.0), 0.5, np.eye(4)), "focal: expected a number > 0"),
        (lambda: StereoRig(9.0, (1.0, 1.0), math.nan, np.eye(4)), "baseline: expected"),
        (lambda: StereoRig(9.0, (1.0, math.nan), 0.5, np.eye(4)), "center: expected finite"),
        (lambda: StereoRig(9.0, (1.0, 1.0), 0.5, np.eye(3)), "T_lidar_camera: expected"),
        (lambda: Disparity(np.zeros(5, np.float32)), "values: expected shape"),
        (lambda: Disparity(np.zeros((5, 5), np.float32), step=0), "step: expected"),
        (lambda: picture_of(np.zeros((5, 4), np.uint8)), r"grey: expected uint8 of shape \(5, 5\)"),
        (lambda: picture_of(np.zeros((5, 5), np.int16)), "grey: expected uint8"),
    ]
    for make, words in bad:
        with pytest.raises(InputError, match=words):
            make()


# --- stereo matching ------------------------------------------------------------------------------


def textured(shift: int, size: tuple[int, int] = (120, 400)) -> NDArray[np.uint8]:
    picture = np.random.default_rng(0).integers(0, 256, (size[0], size[1] + 64), np.uint8)
    return np.ascontiguousarray(picture[:, shift : shift + size[1]])


def test_a_shifted_picture_has_the_disparity_of_the_shift() -> None:
    cv2 = pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    found = stereo_disparity(textured(0), textured(24))
    inner = found.values[5:-5, 55:-5]
    assert found.step == 2
    assert np.median(inner) == 12.0
    assert np.mean(inner == 12.0) > 0.95
    before = cv2.getNumThreads()
    try:
        for threads in (1, 2, 4):
            cv2.setNumThreads(threads)
            again = stereo_disparity(textured(0), textured(24))
            assert np.array_equal(again.values, found.values)
    finally:
        cv2.setNumThreads(before)


def test_where_the_picture_is_plain_nothing_is_measured() -> None:
    """A plain area, such as the sky beside a tree, must not get the depth of its neighbour."""
    pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    noise = np.random.default_rng(1)
    pair = []
    for shift in (0, 24):
        picture = textured(shift)
        picture[:60] = 230
        pair.append(np.clip(picture + noise.normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8))
    found = stereo_disparity(*pair)
    assert np.mean(found.values[:24] > 0) < 0.01  # the plain half, in pixels of the map
    assert np.mean(found.values[36:-5, 55:-5] == 12.0) > 0.9
    assert found.grey is not None
    assert found.grey.shape == found.values.shape
    assert 225 < np.mean(found.grey[:24]) < 235


def test_what_only_one_picture_sees_is_not_measured() -> None:
    """Behind the left edge of a near thing the left camera sees what the right one does not."""
    pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    behind, before = textured(0, (120, 500)), textured(30, (120, 500))[40:80, :120]
    left, right = behind[:, 40:440].copy(), behind[:, 50:450].copy()  # 10 pixels
    left[40:80, 200:320], right[40:80, 140:260] = before, before  # 60 pixels
    found = stereo_disparity(left, right).values
    hidden = found[22:38, 76:98]  # 50 pixels to the left of the near thing
    assert np.mean(hidden > 0) < 0.2
    assert np.mean(found[22:38, 105:155] == 30.0) > 0.9
    assert np.mean(found[22:38, 60:70] == 5.0) > 0.9


def test_bad_pictures_are_named() -> None:
    pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    good = textured(0)
    for left, right, words in (
        (good.astype(np.float32), good, "left: expected .H, W. or .H, W, 3. uint8"),
        (good, good[:-2], "right: expected shape"),
        (good[:8], good[:8], "left: expected at least 192 x 20 pixels"),
        (np.zeros((0, 5), np.uint8), good, "left: expected pixels"),
    ):
        with pytest.raises(InputError, match=words):
            stereo_disparity(left, right)


def test_without_opencv_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from manip3d.errors import MissingExtraError

    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtraError, match="alert"):
        stereo_disparity(textured(0), textured(24))
