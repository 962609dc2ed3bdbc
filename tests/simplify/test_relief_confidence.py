"""Masks and confidences of pixels in the relief, against plain sums over all pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import InputError, Intrinsics, simplify

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
EFFORTS: tuple[simplify.Effort, ...] = ("live", "fast", "balanced", "fine", "best")
V, U = np.mgrid[0:48, 0:64]
HILLS = (1.5 + 0.1 * np.sin(U / 7) * np.cos(V / 5)).astype(np.float32)


def scan(heights: NDArray[np.float64]) -> NDArray[np.float32]:
    """A grid of points with a step of 1 between columns and rows."""
    v, u = np.mgrid[0 : heights.shape[0], 0 : heights.shape[1]]
    return np.stack([u, v, heights], axis=-1).astype(np.float32)


def areas(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(H, W): a third of the dense triangles around each pixel."""
    result = np.zeros(points.shape[:2])
    dense = simplify.dense_mesh_grid(points)
    corners = dense.vertices[dense.faces].astype(np.float64)
    sizes = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    u, v = dense.pixels[dense.faces].reshape(-1, 2).T
    np.add.at(result, (v, u), np.repeat(np.linalg.norm(sizes, axis=1) / 6, 3))
    return result


def error(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    pixels: NDArray[np.int64],
    faces: NDArray[np.int64],
) -> float:
    """Sum over pixels of weight times distance from the plane of the triangle that holds them.

    A pixel on a side belongs to the triangle whose side goes down there or, if level, to the
    right; rows go up.
    """
    total = 0.0
    v, u = np.mgrid[0 : weights.shape[0], 0 : weights.shape[1]]
    for face in faces:
        inside = np.ones(weights.shape, bool)
        corners = pixels[face]
        for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            du, dv = q - p
            side = du * (v - p[1]) - dv * (u - p[0])
            inside &= side >= 0 if dv < 0 or (dv == 0 and du > 0) else side > 0
        a, b, c = points[corners[:, 1], corners[:, 0]]
        normal = np.cross(b - a, c - a)
        away = np.abs((points - a) @ (normal / np.linalg.norm(normal)))
        total += float((weights * away)[inside].sum())
    return total


@pytest.mark.parametrize("seed", [*range(8), 26, 48, 50, 51, 54, 72, 78, 79, 100, 110])
def test_the_error_of_a_pixel_is_area_times_distance_times_confidence(seed: int) -> None:
    """Two triangles over a rectangle: of its diagonals the one with the smaller sum is chosen.

    From 26 on the other one has the smaller sum without area, or with another power of the
    confidence.
    """
    rng = np.random.default_rng(seed)
    shape = (6, 9)  # no pixel lies on a diagonal
    points = scan(0.2 * rng.normal(size=shape))
    believed = 0.02 + 0.98 * rng.random(shape) ** 3
    believed[[0, 0, -1, -1], [0, -1, 0, -1]] = 1.0
    found = simplify.relief_grid(points, None, 4, effort="best", confidence=believed)
    pixels = np.array([[0, 0], [8, 0], [0, 5], [8, 5]])
    assert sorted(found.pixels.tolist()) == sorted(pixels.tolist())
    exact = points.astype(np.float64)
    weights = areas(exact) * believed

    def sums_of(weights: NDArray[np.float64]) -> list[float]:
        return [
            error(exact, weights, pixels, np.array(faces))
            for faces in ([[0, 1, 2], [1, 3, 2]], [[0, 1, 3], [0, 3, 2]])
        ]

    sums = sums_of(weights)
    size = areas(exact)
    others = (believed, size, size * believed**2, size * believed**0.5)
    assert seed < 26 or any(np.argmin(sums_of(o)) != np.argmin(sums) for o in others)
    chosen = error(exact, weights, found.pixels.astype(np.int64), found.faces.astype(np.int64))
    assert chosen == pytest.approx(min(sums), rel=2e-3)


@pytest.mark.parametrize("effort", EFFORTS)
def test_believed_pixels_are_nearer(effort: simplify.Effort) -> None:
    """Noise in one half that the camera does not believe takes few points from the other."""
    rng = np.random.default_rng(3)
    heights = 4 * np.sin(U / 7) * np.cos(V / 5) + np.where(U < 32, 1.5, 0.02) * rng.normal(
        size=U.shape
    )
    points = scan(heights)
    believed = np.where(U < 32, 0.02, 1.0)
    weights = areas(points.astype(np.float64)) * believed
    plain, weighed = (
        simplify.relief_grid(points, None, 200, effort=effort, confidence=c)
        for c in (None, believed)
    )
    before, after = (
        error(
            points.astype(np.float64), weights, f.pixels.astype(np.int64), f.faces.astype(np.int64)
        )
        for f in (plain, weighed)
    )
    assert after < 0.7 * before
    assert (weighed.pixels[:, 0] >= 32).sum() > 1.3 * (plain.pixels[:, 0] >= 32).sum()


@pytest.mark.parametrize("effort", EFFORTS)
def test_only_the_ratio_of_confidences_counts_where_nothing_is_missing(
    effort: simplify.Effort,
) -> None:
    believed = np.random.default_rng(0).random(HILLS.shape)
    one, half = (
        simplify.relief(HILLS, CAMERA, 150, effort=effort, confidence=c)
        for c in (believed, believed / 2)
    )
    assert np.array_equal(one.pixels, half.pixels)
    assert np.array_equal(one.faces, half.faces)


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("move_points", [False, True])
def test_full_confidence_is_none(effort: simplify.Effort, move_points: bool) -> None:
    depth = HILLS.copy()
    depth[10:20, 30:33] = 0
    plain, sure = (
        simplify.relief(
            depth, CAMERA, 120, effort=effort, move_points=move_points, confidence=confidence
        )
        for confidence in (None, np.ones(depth.shape, np.float32))
    )
    assert plain.vertices.tobytes() == sure.vertices.tobytes()
    assert plain.faces.tobytes() == sure.faces.tobytes()


@pytest.mark.parametrize("effort", EFFORTS)
def test_nothing_is_believed(effort: simplify.Effort) -> None:
    found = simplify.relief(
        HILLS, CAMERA, 50, effort=effort, move_points=True, confidence=np.zeros(HILLS.shape)
    )
    assert 3 <= found.num_vertices <= 50
    assert np.isfinite(found.vertices).all()
    assert found.coverage > 0


def test_wrong_measurements_that_are_not_believed_cost_no_points() -> None:
    wrong = np.random.default_rng(1).random(HILLS.shape) < 0.02
    depth = np.where(wrong, 1.0, HILLS).astype(np.float32)
    believed = np.where(wrong, 0.0, 1.0)
    at_wrong = [
        int(wrong[found.pixels[:, 1], found.pixels[:, 0]].sum())
        for found in (
            simplify.relief(depth, CAMERA, 150),
            simplify.relief(depth, CAMERA, 150, confidence=believed),
        )
    ]
    assert at_wrong[0] > 20
    assert at_wrong[1] <= at_wrong[0] // 8


WALL_CAMERA = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)
WALL_V, WALL_U = np.mgrid[0:120, 0:160]


def wall(factor: float, radius: int = 15) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A wall with noise, and the pixels of a blob that is wrong by a factor."""
    wrong = np.hypot(WALL_U - 60, WALL_V - 50) < radius
    noise = np.random.default_rng(0).normal(0, 0.004, wrong.shape)
    return ((3.0 + noise) * np.where(wrong, factor, 1.0)).astype(np.float32), wrong


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("points", [40, 200])
def test_a_piece_that_is_not_believed_is_no_measurement(
    effort: simplify.Effort, points: int
) -> None:
    """A reflection lies a depth step before the wall; one of its pixels is believed by mistake."""
    depth, wrong = wall(0.6)
    believed = np.where(wrong, 0.0, 1.0)
    believed[50, 60] = 0.3
    plain, found, masked = (
        simplify.relief(depth, WALL_CAMERA, points, effort=effort, depth_step=0.05, **maps)  # type: ignore[arg-type]
        for maps in ({}, {"confidence": believed}, {"mask": ~wrong})
    )
    assert (plain.vertices[:, 2] < 2.5).any()
    assert found.vertices.tobytes() == masked.vertices.tobytes()
    assert found.faces.tobytes() == masked.faces.tobytes()
    assert (found.coverage, found.bridges, found.outside) == (
        masked.coverage,
        masked.bridges,
        masked.outside,
    )
    assert (plain.unsure_pixels, found.unsure_pixels) == (0, np.count_nonzero(wrong))
    assert found.surface.num_measured == np.count_nonzero(~wrong)
    options = simplify.DepthOptions(points, effort=effort)
    cut = simplify.simplify_depth(depth, WALL_CAMERA, options, confidence=believed)
    assert cut.vertices[:, 2].min() > 2.5
    assert cut.coverage == found.coverage


def test_little_confidence_is_some() -> None:
    """The limit is a thousandth of the mean, whatever the largest confidence is."""
    depth, wrong = wall(0.6)
    for of_wrong, of_wall, is_left in ((1e-2, 1.0, False), (1e-4, 1.0, True), (1e-6, 1e-2, True)):
        believed = np.where(wrong, of_wrong, of_wall)
        found = simplify.relief(depth, WALL_CAMERA, 200, depth_step=0.05, confidence=believed)
        assert (found.unsure_pixels > 0) == is_left
    none = np.zeros(depth.shape)
    found = simplify.relief(depth, WALL_CAMERA, 200, depth_step=0.05, confidence=none)
    assert found.unsure_pixels == 0
    assert found.coverage > 0.95


def test_pieces_of_scans_and_streams_that_are_not_believed() -> None:
    depth, wrong = wall(0.6)
    believed = np.where(wrong, 0.0, 1.0)
    stream = simplify.ReliefStream(WALL_CAMERA, 150, depth_step=0.05)
    for _ in range(2):
        found = stream.simplify(depth, confidence=believed)
        assert found.vertices[:, 2].min() > 2.5
        assert found.unsure_pixels == np.count_nonzero(wrong)
    points = scan(np.where(wrong, 60.0, 0.0) + np.sin(WALL_U / 9))
    valid = np.ones(wrong.shape, bool)
    asked = {"max_edge": 5.0, "effort": "live"}
    one = simplify.relief_grid(points, valid, 150, confidence=believed, **asked)  # type: ignore[arg-type]
    two = simplify.relief_grid(points, valid & ~wrong, 150, **asked)  # type: ignore[arg-type]
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.coverage == two.coverage
    assert valid.all()


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("points", [100, 900])
def test_triangles_lie_over_what_is_not_believed(effort: simplify.Effort, points: int) -> None:
    """Without a depth step the blob is part of the wall; its own depth must not shape it."""
    depth, wrong = wall(0.97)
    believed = np.where(wrong, 0.0, 1.0)
    found = simplify.relief(
        depth, WALL_CAMERA, points, effort=effort, depth_step=0.05, confidence=believed
    )
    assert found.unsure_pixels == 0
    assert found.coverage > 0.98
    assert not wrong[found.pixels[:, 1], found.pixels[:, 0]].any()
    assert found.vertices[:, 2].min() > 2.96  # the blob is at 2.91


@pytest.mark.parametrize("effort", EFFORTS)
def test_a_mask_is_no_measurement(effort: simplify.Effort) -> None:
    mask = np.hypot(U - 30, V - 20) < 18
    masked = simplify.relief(HILLS, CAMERA, 100, effort=effort, mask=mask)
    cut = simplify.relief(np.where(mask, HILLS, np.float32(np.nan)), CAMERA, 100, effort=effort)
    assert masked.vertices.tobytes() == cut.vertices.tobytes()
    assert masked.faces.tobytes() == cut.faces.tobytes()
    assert masked.coverage == cut.coverage
    assert mask[masked.pixels[:, 1], masked.pixels[:, 0]].all()
    points = scan(HILLS.astype(np.float64))
    valid = V < 40
    one = simplify.relief_grid(points, valid, 100, effort=effort, mask=mask)
    two = simplify.relief_grid(points, valid & mask, 100, effort=effort)
    assert one.faces.tobytes() == two.faces.tobytes()
    nothing = simplify.relief(HILLS, CAMERA, 100, effort=effort, mask=np.zeros_like(mask))
    assert nothing.num_vertices == 0


def test_streams_take_the_mask_and_the_confidence_of_each_frame() -> None:
    stream = simplify.ReliefStream(CAMERA, 80, newest_share=1.0, stability=1.0)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        mask, believed = rng.random(HILLS.shape) < 0.9, rng.random(HILLS.shape)
        found = stream.simplify(HILLS, mask=mask, confidence=believed)
        alone = simplify.relief(HILLS, CAMERA, 80, mask=mask, confidence=believed)
        assert found.faces.tobytes() == alone.faces.tobytes()
        assert found.vertices.tobytes() == alone.vertices.tobytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mask": np.ones((48, 63), bool)}, r"mask: expected shape \(48, 64\), got \(48, 63\)"),
        ({"mask": np.ones((48, 64), np.uint8)}, r"mask: expected bool, got uint8; `mask != 0` is"),
        ({"confidence": np.ones((48, 64, 1))}, r"confidence: expected shape \(48, 64\), got"),
        ({"confidence": np.ones((48, 64), np.uint8)}, "floats, got uint8; confidence_of_levels"),
        ({"confidence": np.full((48, 64), 1.5)}, "confidence: expected 0 to 1, got 1.5 to 1.5"),
        ({"confidence": np.full((48, 64), -0.5)}, "confidence: expected 0 to 1"),
        (
            {"confidence": np.full((48, 64), 1.0 + 2.0**-20, np.float32)},
            "got 1.00000095367431.* to 1.00000095367431",
        ),
        (
            {"confidence": np.where(np.arange(64) < 2, np.nan, np.ones((48, 64)))},
            "confidence: expected 0 to 1, got 96 NaN",
        ),
    ],
)
def test_bad_maps(options: dict[str, NDArray[np.generic]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simplify.relief(HILLS, CAMERA, 50, **options)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        simplify.relief_grid(scan(HILLS.astype(np.float64)), None, 50, **options)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        simplify.ReliefStream(CAMERA, 50).simplify(HILLS, **options)  # type: ignore[arg-type]


def test_levels_of_cameras() -> None:
    levels = np.array([[0, 1, 2]], np.uint8)
    np.testing.assert_array_equal(simplify.confidence_of_levels(levels, 2), [[0, 0.5, 1]])
    for dtype in (np.uint16, np.int8, np.int64, np.float16, np.float64):
        found = simplify.confidence_of_levels(levels.astype(dtype), 2)
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, [[0, 0.5, 1]])
    for bad, highest, message in (
        (levels, 1, "levels: expected whole numbers from 0 to 1, got 2"),
        (levels.astype(int) - 1, 2, "levels: expected whole numbers from 0 to 2, got -1"),
        (levels / 2, 2, r"levels: expected whole numbers from 0 to 2, got 0\.5"),
        (levels * np.nan, 2, "levels: expected whole numbers from 0 to 2, got nan"),
        (levels, 0, "highest: expected a whole number of at least 1"),
        (levels[0], 2, r"levels: expected shape \(H, W\), got \(3,\)"),
    ):
        with pytest.raises(InputError, match=message):
            simplify.confidence_of_levels(bad, highest)


def roof(seed: int, factor: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Two walls that meet in an edge, with noise, and the noisier pixels of a blob on the edge."""
    rng = np.random.default_rng(seed)
    ridge = 3 / (1 + 0.7 * np.abs(WALL_U - 79.5) / 130)  # planes: 1 / depth is linear in pixels
    wrong = np.hypot(WALL_U - rng.uniform(60, 100), WALL_V - rng.uniform(45, 75)) < 22
    noise = rng.normal(0, 1, wrong.shape)
    return (ridge + noise * np.where(wrong, factor * ridge, 0.004)).astype(np.float32), wrong


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("points", [150, 300])
def test_noise_that_is_not_believed_holds_few_points(effort: simplify.Effort, points: int) -> None:
    """Depth steps within the noise are no ends of the surface that have to be followed."""
    at_wrong = []
    for seed in range(3):
        depth, wrong = roof(seed, 0.03)
        for believed in (np.ones(wrong.shape), np.where(wrong, 0.0, 1.0)):
            found = simplify.relief(
                depth, WALL_CAMERA, points, effort=effort, depth_step=0.05, confidence=believed
            )
            at_wrong.append(int(wrong[found.pixels[:, 1], found.pixels[:, 0]].sum()))
    assert sum(at_wrong[1::2]) < 0.55 * sum(at_wrong[::2])


@pytest.mark.parametrize("effort", ["live", "fast", "balanced", "fine"])
def test_few_steps_in_noise_that_is_not_believed_hold_hardly_a_point(
    effort: simplify.Effort,
) -> None:
    """If covering the holes there costs a twentieth, 24 to 37 of 3,600 points are held."""
    at_wrong = 0
    for seed in range(4):
        depth, wrong = roof(seed, 0.01)
        believed = np.where(wrong, 0.0, 1.0)
        for points in (300, 600):
            found = simplify.relief(
                depth, WALL_CAMERA, points, effort=effort, depth_step=0.05, confidence=believed
            )
            at_wrong += int(wrong[found.pixels[:, 1], found.pixels[:, 0]].sum())
    assert at_wrong <= 22  # 22 with live


@pytest.mark.parametrize("effort", EFFORTS)
def test_pixels_beside_those_that_are_not_believed_keep_their_error(
    effort: simplify.Effort,
) -> None:
    """Triangles over the blob do not lie over the believed pixels around it as well."""
    sums = np.zeros(2)
    for seed in range(6):
        depth, wrong = roof(seed, 0.001)
        u, v = (WALL_U - 79.5) / 130, (WALL_V - 59.5) / 130
        points = np.stack([u * depth, v * depth, depth], axis=-1).astype(np.float64)
        believed = np.where(wrong, 0.0, 1.0)
        found = simplify.relief_grid(points, None, 300, effort=effort, confidence=believed)
        beside = (np.hypot(*np.gradient(believed)) > 0) & ~wrong
        pixels, faces = found.pixels.astype(np.int64), found.faces.astype(np.int64)
        sums += [
            error(points, part / np.count_nonzero(part), pixels, faces) for part in (beside, ~wrong)
        ]
    assert sums[0] < 2 * sums[1]


@pytest.mark.parametrize("effort", ["fast", "balanced", "fine", "best"])
def test_near_surface_that_is_not_believed_holds_hardly_a_point(effort: simplify.Effort) -> None:
    """Near blobs cover many pixels, which count by their confidence."""
    rng = np.random.default_rng(0)
    at_blobs = np.zeros(2, int)
    for _ in range(3):
        blobs = np.zeros(WALL_U.shape, bool)
        for u, v in rng.uniform(20, (140, 100), (6, 2)):
            blobs |= np.hypot(WALL_U - u, WALL_V - v) < 11
        wall = 4 + 0.3 * np.sin(WALL_U / 9) * np.cos(WALL_V / 7)
        depth = np.where(blobs, 1 + 0.02 * np.sin(WALL_U / 3), wall).astype(np.float32)
        for i, confidence in enumerate((1.0, 0.02)):
            found = simplify.relief(
                depth,
                WALL_CAMERA,
                120,
                effort=effort,
                depth_step=0.1,
                confidence=np.where(blobs, confidence, 1.0),
            )
            at_blobs[i] += blobs[found.pixels[:, 1], found.pixels[:, 0]].sum()
    assert at_blobs[1] < 0.1 * at_blobs[0]
