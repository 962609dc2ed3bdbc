"""The stereo pair: its geometry against the truth, the LiDAR, and itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d.simulate import LidarScan, StereoPair, Street, cameras, hdl64e, stereo_pair, street
from manip3d.simulate._shading import LEVELS, SIDE, Shader
from manip3d.simulate._world import Surface

pytest.importorskip("open3d")

Doubles = NDArray[np.float64]
TIME = 1.0


@pytest.fixture(scope="module")
def place(busy_street: Street) -> Street:
    return busy_street


@pytest.fixture(scope="module")
def pair(place: Street) -> StereoPair:
    return stereo_pair(place, TIME)


@pytest.fixture(scope="module")
def scan(place: Street) -> LidarScan:
    return hdl64e(place, TIME)


def projected(points: NDArray[np.float32]) -> tuple[Doubles, Doubles, Doubles]:
    """Left pixels, disparity and depth of LiDAR points."""
    matrices, rigid = cameras.projections()
    ones = np.ones((len(points), 1))
    at = np.hstack([points.astype(float), ones]) @ rigid.T
    left, right = at @ matrices[2].T, at @ matrices[3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = left[:, :2] / left[:, 2:]
        return pixels, pixels[:, 0] - right[:, 0] / right[:, 2], left[:, 2]


def in_picture(scan: LidarScan, border: int) -> tuple[NDArray[np.int64], Doubles, Doubles]:
    """Whole pixels, disparity and depth of the points that both pictures show."""
    pixels, disparity, depth = projected(scan.points)
    with np.errstate(invalid="ignore"):
        seen = (depth > 0) & (pixels >= border).all(axis=1)
        seen &= (pixels < np.array([cameras.WIDTH, cameras.HEIGHT]) - border - 1).all(axis=1)
        seen &= pixels[:, 0] - disparity >= border
    return np.round(pixels[seen]).astype(int), disparity[seen], depth[seen]


def test_same_seed_same_pictures_whatever_the_threads(place: Street, pair: StereoPair) -> None:
    again = stereo_pair(street(3), TIME, threads=1)
    for field in ("left", "right", "depth", "object"):
        np.testing.assert_array_equal(getattr(pair, field), getattr(again, field))
    assert (stereo_pair(place, TIME, rng=1).left != pair.left).any()


def test_geometry_is_kitti_s() -> None:
    matrices, rigid = cameras.projections()
    assert matrices[2][0, 0] == pytest.approx(721.54, abs=0.01)
    shift = (matrices[2][0, 3] - matrices[3][0, 3]) / matrices[2][0, 0]
    assert shift == pytest.approx(0.5327, abs=1e-9)
    np.testing.assert_allclose(rigid[:3, :3] @ rigid[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rigid @ [*cameras.CAMERA_0, 1.0], [0, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rigid[:3, :3] @ [1, 0, 0], [0, 0, 1])  # looks ahead


def test_pictures_show_everything(pair: StereoPair) -> None:
    assert pair.left.shape == pair.right.shape == (375, 1242, 3)
    assert pair.left.dtype == np.uint8
    assert 0.02 < (pair.depth == 0).mean() < 0.4
    assert pair.left.std() > 30
    assert (pair.object >= 0).mean() > 0.03
    assert np.isfinite(pair.disparity).all()


def test_lidar_and_pictures_agree(scan: LidarScan, pair: StereoPair) -> None:
    # KITTI: 17 800 to 20 500 points, median 0.06 to 0.09 px, 90 to 96 % below 1 px.
    pixels, disparity, _ = in_picture(scan, 4)
    off = abs(pair.disparity[pixels[:, 1], pixels[:, 0]] - disparity)
    assert 15_000 < len(off) < 22_000
    assert np.median(off) < 0.1
    assert (off < 1.0).mean() > 0.9


def test_lidar_and_pictures_see_the_same_objects(scan: LidarScan, pair: StereoPair) -> None:
    pixels, disparity, depth = projected(scan.points)
    u, v = np.round(pixels).T
    with np.errstate(invalid="ignore"):
        seen = (depth > 0) & (u >= 0) & (u < 1242) & (v >= 0) & (v < 375)
    u, v = u[seen].astype(int), v[seen].astype(int)
    near = abs(pair.disparity[v, u] - disparity[seen]) < 0.5
    same = pair.object[v, u] == scan.object[seen]
    assert same[near].mean() > 0.99


def test_the_right_picture_fits_the_left_one(scan: LidarScan, pair: StereoPair) -> None:
    # The check of the data's description: 7 x 7 patches; KITTI has correlations of 0.68 to 0.80.
    pixels, disparity, _ = in_picture(scan, 12)
    chosen = np.random.default_rng(0).permutation(len(pixels))[:2000]
    (u, v), d = pixels[chosen].T, disparity[chosen]
    left, right = (image.astype(float).mean(axis=2) for image in (pair.left, pair.right))
    here = normalised_patches(left, u, v)
    match = np.round(u - d).astype(int)
    score = {
        (dx, dy): (here * normalised_patches(right, match + dx, v + dy)).sum(axis=1).mean()
        for dx in range(-8, 9)
        for dy in (-2, -1, 0, 1, 2)
    }
    assert max(score, key=lambda offset: score[offset]) == (0, 0)
    assert score[0, 0] > 0.65


def normalised_patches(
    image: Doubles, column: NDArray[np.int64], row: NDArray[np.int64]
) -> Doubles:
    around = np.arange(-3, 4)
    u = np.clip(column, 3, image.shape[1] - 4)[:, None, None] + around
    patches = image[row[:, None, None] + around[:, None], u].reshape(len(row), -1)
    patches -= patches.mean(axis=1, keepdims=True)
    return np.asarray(patches / np.maximum(np.linalg.norm(patches, axis=1, keepdims=True), 1e-9))


def test_movers_hide_what_is_behind_them(place: Street, pair: StereoPair) -> None:
    first = place.world.face_object.max() + 1
    moving = pair.object >= first
    assert moving.sum() > 500
    boxes = {box.track: box for box in place.boxes(TIME, max_range=400.0)}
    for number in np.unique(pair.object[moving]):
        mask = pair.object == number
        if mask.sum() > 50:
            depth = np.median(pair.depth[mask])
            box = boxes[int(number)]
            assert abs(depth + cameras.CAMERA_0[0] - box.center[0]) < 0.5 * max(box.size) + 0.1


def shader(texture: NDArray[np.uint8] | None, size: float = 1.0) -> Shader:
    """One face whose texture coordinates are its barycentric weights, in repetitions."""
    texcoords = np.array([[[0, 0], [size, 0], [0, size]]], np.float32)
    surface = Surface((0.5, 1.0, 0.25), texture=texture, texture_size=size)
    return Shader([surface], np.zeros(1, np.int32), texcoords)


def test_plain_surfaces_have_their_own_color() -> None:
    uv, one = np.zeros((1, 2), np.float32), np.ones(1, np.float32)
    color = shader(None).colors(np.zeros(1, np.int64), uv, 0.01 * one, one)
    np.testing.assert_allclose(color, [[127.5, 255.0, 63.75]], rtol=1e-6)


def test_textures_are_read_between_texels_and_repeat() -> None:
    texture = np.random.default_rng(0).integers(0, 256, (SIDE, SIDE)).astype(np.uint8)
    uv = np.random.default_rng(1).uniform(-2.0, 2.0, (500, 2)).astype(np.float32)
    fine = np.full(500, 0.5 / SIDE, np.float32)
    color = shader(texture).colors(np.zeros(500, np.int64), uv, fine, np.ones(500, np.float32))
    at = uv.astype(float) * SIDE - 0.5
    column, row = np.floor(at).astype(int).T
    a, b = (at - np.floor(at)).T
    expected = sum(
        weight * texture[(row + i) % SIDE, (column + j) % SIDE]
        for i, j, weight in (
            (0, 0, (1 - a) * (1 - b)),
            (0, 1, a * (1 - b)),
            (1, 0, (1 - a) * b),
            (1, 1, a * b),
        )
    )
    np.testing.assert_allclose(color[:, 1], expected * 255 / 128, atol=0.1)


@pytest.mark.parametrize("level", range(LEVELS + 1))
def test_far_textures_are_averaged(level: int) -> None:
    stripes = np.zeros((SIDE, SIDE), np.uint8)
    stripes[:, ::2] = 128
    uv = np.array([[0.5 / SIDE, 0.5 / SIDE]], np.float32)
    footprint = np.array([0.75 * 2.0**level / SIDE], np.float32)
    color = shader(stripes).colors(np.zeros(1, np.int64), uv, footprint, np.ones(1, np.float32))
    assert color[0, 1] == pytest.approx(255.0 if level == 0 else 127.5, rel=1e-5)
