"""Depth images of real cameras and files: lone pixels, coarse pixels, marks and steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import (
    FormatError,
    InputError,
    Intrinsics,
    Registration,
    _core,
    datasets,
    io,
    simplify,
)
from manip3d._util.paths import in_order
from manip3d.batch import find_files
from manip3d.io._depth_files import read_mask
from manip3d.io._images import read_color
from manip3d.simplify._depth_inputs import planar_depth
from manip3d.simplify._depth_sets import maps_by_name
from manip3d.simplify._depth_steps import across_gaps
from manip3d.simplify._time_stamps import associate, seconds
from real_data import RealData

CAMERA = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)


def waves() -> NDArray[np.uint16]:
    v, u = np.mgrid[0:120, 0:160]
    return (1500 + 150 * np.sin(u / 20) + 100 * np.cos(v / 15)).astype(np.uint16)


def box_before_waves() -> NDArray[np.uint16]:
    depth = waves()
    depth[30:90, 50:110] = 700
    return depth


def slope_behind_pole() -> NDArray[np.uint16]:
    """Return a slope with a pole before it, behind which long edges of the slope pass."""
    depth = np.tile((1000 / np.linspace(0.66, 0.4, 160)).astype(np.uint16), (120, 1))
    depth[30:90, 78:82] = 800
    return depth


def floor(focal: float = 60.0) -> NDArray[np.uint16]:
    """Return the depth image of a floor one metre below the camera."""
    below = np.arange(96)[:, None] - 20.5
    z = np.where(below > 0, 1000 * focal / np.maximum(below, 0.5), 0)
    return np.repeat(np.where(z > 12000, 0, z), 128, axis=1).astype(np.uint16)


def box_and_far_specks() -> NDArray[np.uint16]:
    """Return a box and specks of twelve pixels 60 m away.

    The specks have half a percent of the pixels, and most of the area.
    """
    depth = box_before_waves()
    v, u = np.mgrid[0:120, 0:160]
    for i in range(8):
        top, left = 15 + 28 * (i // 4), 20 + 35 * (i % 4)
        at = np.s_[top : top + 3, left : left + 4]
        depth[at] = (60_000 + 100 * np.sin(7 * u + 3 * v))[at]
    return depth


def depth_over(found: simplify.DepthMesh, corners: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the depth of a face at each pixel in or on it, and NaN at the other pixels."""
    u, v = np.meshgrid(np.arange(160), np.arange(120))
    (au, av), (bu, bv), (cu, cv) = found.pixels[corners].astype(float)
    area = (bu - au) * (cv - av) - (bv - av) * (cu - au)
    b = ((u - au) * (cv - av) - (v - av) * (cu - au)) / area
    c = ((bu - au) * (v - av) - (bv - av) * (u - au)) / area
    weights = np.stack([1 - b - c, b, c])
    inverse = np.tensordot(1 / found.vertices[corners, 2].astype(float), weights, 1)
    return np.where((weights >= -1e-9).all(axis=0), 1 / inverse, np.nan)


def boxes_before_a_slope(seed: int) -> NDArray[np.uint16]:
    rng = np.random.default_rng(seed)
    depth = np.full((48, 64), 3000.0) - np.arange(48)[:, None] * rng.uniform(0, 20)
    for _ in range(rng.integers(2, 8)):
        v, u = rng.integers(0, 40), rng.integers(0, 55)
        box = np.s_[v : v + rng.integers(4, 20), u : u + rng.integers(4, 20)]
        depth[box] = rng.uniform(1000, 2800)
    depth += rng.normal(size=depth.shape) * rng.uniform(0, 30)
    depth[rng.random(depth.shape) < rng.uniform(0, 0.1)] = 0
    return depth.round().clip(0).astype(np.uint16)


@pytest.mark.parametrize("seed", [69, 209, 243, 302])
def test_three_points_are_a_face_between_depth_steps(seed: int, tmp_path: Path) -> None:
    """Three points give a face, although it lies across a step or its piece has four points."""
    depth, camera = boxes_before_a_slope(seed), Intrinsics(64, 48, 57.0, 57.0, 31.5, 23.5)
    found = simplify.simplify_depth(depth, camera, simplify.DepthOptions(3, method="relief"))
    assert (found.num_faces, found.num_used) == (1, 3)
    assert found.coverage > 0.1
    np.save(tmp_path / "a.npy", depth)
    options = simplify.DepthOptions(3, method="relief", intrinsics="57,57,31.5,23.5", unit="mm")
    made = simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert (made.faces, made.points) == (1, 3)
    assert io.read_mesh(tmp_path / "a.ply").num_faces == 1


def disks(seed: int) -> NDArray[np.uint16]:
    """Return disks at any depth without background, with up to 30 % of the pixels missing."""
    rng = np.random.default_rng(seed + 10**6)
    height, width = rng.integers(6, 60, 2)
    depth = np.zeros((height, width))
    v, u = np.mgrid[0:height, 0:width]
    for _ in range(rng.integers(1, 9)):
        row, column, radius = rng.uniform(0, height), rng.uniform(0, width), rng.uniform(1, 12)
        depth[(v - row) ** 2 + (u - column) ** 2 < radius**2] = rng.uniform(500, 4000)
    depth += (depth > 0) * rng.normal(size=depth.shape) * rng.uniform(0, 20)
    depth[rng.random(depth.shape) < rng.uniform(0, 0.3)] = 0
    return depth.round().clip(0).astype(np.uint16)


@pytest.mark.parametrize("effort", ["live", "fast", "balanced"])
@pytest.mark.parametrize("step", [None, simplify.DEPTH_STEP])
def test_relief_leaves_a_face_of_any_number_of_points(
    effort: simplify.Effort, step: float | None
) -> None:
    """A face is left for any number of points, which is neither at a hole nor across a step."""
    boxes = [boxes_before_a_slope(seed) for seed in (131, 187, 220, 255, 261, 277, 326, 697)]
    for depth in boxes + [disks(seed) for seed in (257, 330, 579, 606, 625, 633)]:
        height, width = depth.shape
        camera = Intrinsics(width, height, 57.0, 57.0, 31.5, 23.5)
        for points in (3, 4, 5, 6):
            found = simplify.relief(depth, camera, points, depth_step=step, effort=effort)
            if step is not None:
                found = simplify.cut_depth_steps(found, depth)
            assert found.num_faces > 0
            assert found.num_vertices <= points
            assert (depth[found.pixels[:, 1], found.pixels[:, 0]] > 0).all()


def test_few_points_cover_the_largest_faces_between_steps() -> None:
    """Three points among 60 boxes cover more than the last face of a collapsing mesh."""
    rng = np.random.default_rng(3)
    depth = np.full((120, 160), 4000, np.uint16)
    for _ in range(60):
        v, u = rng.integers(0, 110), rng.integers(0, 150)
        box = np.s_[v : v + rng.integers(5, 30), u : u + rng.integers(5, 30)]
        depth[box] = rng.integers(1000, 3500)
    depth[rng.random(depth.shape) < 0.01] = 0
    found = simplify.relief(depth, CAMERA, 3, depth_step=simplify.DEPTH_STEP)
    assert simplify.cut_depth_steps(found, depth).coverage > 0.07  # 0.034 of three last points


def test_a_few_more_points_cover_hardly_less() -> None:
    """One more point loses at most a tenth of the coverage of a star, whose bays may be filled."""
    v, u = np.mgrid[0:96, 0:128].astype(float)
    x, y = u - 63.5, v - 47.5
    camera = Intrinsics(128, 96, 110.0, 110.0, 63.5, 47.5)
    for tips, turn in ((4, 0.9), (5, 0.0), (6, 0.0), (6, 0.9), (7, 0.9)):
        inside = np.hypot(x, y) < 28 + 16 * np.sin(tips * np.arctan2(y, x) + turn)
        depth = np.where(inside, 2.0 + 0.1 * np.sin(u / 20), 0.0).astype(np.float32)
        best = 0.0
        for points in (3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 25, 30):
            found = simplify.relief(depth, camera, points)
            assert found.num_vertices <= points
            assert found.coverage > best / 1.1
            best = max(best, found.coverage)


@pytest.mark.parametrize("effort", ["live", "balanced", "best"])
def test_more_points_leave_a_wall_behind_islands_as_it_is(effort: simplify.Effort) -> None:
    """Vertices stay off islands before a wall; on them, 1000 points covered .43 and 50 .73."""
    v, u = np.mgrid[0:120, 0:160]
    depth = np.where((u % 6 < 3) & (v % 6 < 3), 1500, 3000).astype(np.uint16)
    for points in (50, 250, 1000):
        found = simplify.relief(
            depth, CAMERA, points, depth_step=simplify.DEPTH_STEP, effort=effort
        )
        assert simplify.cut_depth_steps(found, depth).coverage > 0.72


@pytest.mark.parametrize("seed", [1, 11, 59, 109])
def test_no_vertex_leaves_a_pinhole_for_an_island(seed: int) -> None:
    """A vertex on an island would have faces across steps only, as in 56 of 150 such images."""
    v, u = np.mgrid[0:72, 0:96]
    rng = np.random.default_rng(seed)
    wall = 3000 + 150 * np.sin(u / 8) * np.cos(v / 6) + 10 * rng.normal(size=u.shape)
    islands = (u % 6 < 3) & (v % 6 < 3)
    depth = np.where(islands, wall - 1500, wall).round().astype(np.uint16)
    depth[rng.random(depth.shape) < 0.02] = 0
    camera = Intrinsics(96, 72, 84.0, 84.0, 47.5, 35.5)
    found = simplify.relief(depth, camera, 300, depth_step=simplify.DEPTH_STEP)
    assert found.filled_pixels > 0
    assert not islands[found.pixels[:, 1], found.pixels[:, 0]].any()


def test_an_error_tells_how_many_points_leave_a_face(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", boxes_before_a_slope(0))
    asked = {"method": "cs3", "intrinsics": "57,57,31.5,23.5", "unit": "mm"}
    with pytest.raises(
        FormatError, match=r"the only face: .*3 points are too few, \d+ leave one"
    ) as caught:
        simplify.simplify_depth_file(
            tmp_path / "a.npy", tmp_path / "a.ply", simplify.DepthOptions(3, **asked)
        )
    enough = int(str(caught.value).split("too few, ")[1].split()[0])
    for points in range(4, enough):
        with pytest.raises(FormatError, match="too few"):
            simplify.simplify_depth_file(
                tmp_path / "a.npy", tmp_path / "a.ply", simplify.DepthOptions(points, **asked)
            )
    made = simplify.simplify_depth_file(
        tmp_path / "a.npy", tmp_path / "a.ply", simplify.DepthOptions(enough, **asked)
    )
    assert made.faces > 0


def test_edges_that_pass_behind_something_are_no_steps() -> None:
    depth = slope_behind_pole()
    found = simplify.relief(depth, CAMERA, 6, depth_step=0.05)
    cut = simplify.cut_depth_steps(found, depth)
    assert cut.num_faces == found.num_faces > 0
    assert found.coverage > 0.9  # the pole is a fortieth of the pixels


@pytest.mark.parametrize("points", [5, 10, 20])
def test_few_points_keep_a_mesh(points: int) -> None:
    depth = box_before_waves()
    found = simplify.relief(depth, CAMERA, points, depth_step=0.05)
    cut = simplify.cut_depth_steps(found, depth)
    assert cut.num_faces > 0
    assert cut.coverage > 0.7 * found.coverage


def test_few_points_are_not_spent_on_faces_across_steps() -> None:
    depth = box_before_waves()
    # If such faces are made first and then cut, coverage is 0, 0.362 and 0.397.
    for points, least in ((3, 0.12), (8, 0.39), (10, 0.48)):
        found = simplify.relief(depth, CAMERA, points, depth_step=0.05)
        cut = simplify.cut_depth_steps(found, depth)
        assert cut.num_faces == found.num_faces > 0
        assert cut.coverage > least
        assert found.num_vertices == points


def test_faces_between_box_and_wall_are_cut() -> None:
    depth = box_before_waves()
    plain = simplify.relief(depth, CAMERA, 60)  # no boundary at the box: faces join it and the wall
    z = plain.vertices[plain.faces, 2]
    assert ((z.min(axis=1) < 0.75) & (z.max(axis=1) > 1.2)).any()
    found = simplify.relief(depth, CAMERA, 60, depth_step=0.05).with_faces(plain.faces[:0])
    joined = type(found)(**{**vars(found), **{
        name: getattr(plain, name) for name in ("vertices", "faces", "pixels", "texcoords")
    }})  # fmt: skip
    z = simplify.cut_depth_steps(joined, depth)
    ends = z.vertices[z.faces, 2]
    assert not ((ends.min(axis=1) < 0.75) & (ends.max(axis=1) > 1.2)).any()


@pytest.mark.parametrize("points", [6, 50])
def test_coverage_counts_pixels_near_their_face(points: int) -> None:
    depth = box_before_waves()
    found = simplify.relief(depth, CAMERA, points, depth_step=0.05)
    z = depth / 1000
    covered = np.zeros(z.shape, bool)
    for corners in found.faces:
        over = depth_over(found, corners)
        limit = np.maximum(0.05, np.tan(np.radians(78)) / 130 + 3 * 1.425e-3 * z) * z
        near = (over / z <= 1 + limit / z) & (z / over <= 1 + limit / z)
        covered |= np.nan_to_num(near).astype(bool)
    assert found.coverage == pytest.approx(covered.mean(), abs=2e-3)
    if points == 6:
        assert found.dropped_pixels > 0
        assert found.coverage < 1 - found.dropped_pixels / depth.size


def test_a_floor_of_coarse_pixels_is_no_step() -> None:
    depth = floor()
    camera = Intrinsics(128, 96, 60.0, 60.0, 63.5, 20.5)
    found = simplify.relief(depth, camera, 200, depth_step=0.05)
    used = found.vertices[np.unique(found.faces), 2]
    assert used.max() > 4.6  # tan 78 degrees: 4.7 m; 5 % alone end at 2.9 m
    z = depth[np.flatnonzero(depth[:, 0]), 0].astype(float) / 1000  # nearer from row to row
    change = np.diff(z[::-1])
    limit = np.maximum(0.05, np.tan(np.radians(78)) / 60 + 3 * 1.425e-3 * z[::-1][:-1])
    last = int(np.argmax(change > limit * z[::-1][:-1]))
    assert found.outside == pytest.approx(1 - (last + 1) / len(z))
    dense = simplify.dense_mesh(depth, camera)
    without = simplify.cut_depth_steps(dense, depth)
    with_camera = simplify.cut_depth_steps(dense, depth, intrinsics=camera)
    assert with_camera.num_faces > without.num_faces > 0


@pytest.mark.parametrize("far", [1e5, 1e6, 1e9])
def test_one_far_pixel_leaves_the_rest_as_it_is(far: float) -> None:
    depth = (waves() / 1000).astype(np.float32)
    alone = depth.copy()
    alone[5, 5] = 0
    depth[5, 5] = far
    found = simplify.relief(depth, CAMERA, 300, depth_step=0.05)
    expected = simplify.relief(alone, CAMERA, 300, depth_step=0.05)
    np.testing.assert_array_equal(found.pixels, expected.pixels)
    assert found.coverage == expected.coverage > 0.99
    assert found.outside == pytest.approx(1 / depth.size)
    stream = simplify.ReliefStream(CAMERA, 300, depth_step=0.05)
    assert stream.simplify(depth).coverage > 0.99


@pytest.mark.parametrize("seed", [0, 2])
def test_depths_that_are_far_off_do_not_take_the_few_points(seed: int) -> None:
    """Specks at 500 m do not take the points, although their area is larger than the wall's."""
    v, u = np.mgrid[0:120, 0:160].astype(float)
    depth = (3 + 0.3 * np.sin(u / 9) * np.cos(v / 7)).astype(np.float32)
    rng = np.random.default_rng(seed)
    for _ in range(12):
        row, column = rng.integers(2, 116), rng.integers(2, 156)
        depth[row : row + 2, column : column + 2] = 500
    camera = Intrinsics(160, 120, fx=150, fy=150, cx=79.5, cy=59.5)
    found = simplify.relief(depth, camera, 10, depth_step=simplify.DEPTH_STEP)
    cut = simplify.cut_depth_steps(found, depth)
    assert cut.coverage > 0.45  # 0.52; 0.27 and 0.35 where these pieces are weighed by area alone


def test_where_nothing_is_left_nothing_is_covered() -> None:
    depth = (waves() / 1000).astype(np.float32)
    depth[5, 5] = 1e9
    found = simplify.relief(depth, CAMERA, 300)  # without a limit the far pixel is a surface
    assert found.coverage < 0.01
    result = simplify.DepthFileResult(
        Path("a"), Path("b"), simplify.DepthOptions(3), coverage=float("nan")
    )
    assert result.coverage_missed


def test_a_mesh_where_there_is_no_surface_is_all_bridges() -> None:
    v, u = np.mgrid[0:120, 0:160]
    depth = np.where((u + v) % 2 == 0, 1000, 3000).astype(np.uint16)  # a step beside each pixel
    found = simplify.cs3(depth, CAMERA, 60, depth_step=0.05)
    assert found.num_faces > 0
    assert (found.coverage, found.bridges, found.outside) == (0, 1, 1)
    assert simplify.relief(depth, CAMERA, 60, depth_step=0.05).bridges == 0  # no faces


@pytest.mark.parametrize("believed", [np.arange(160) >= 80, np.zeros(160, bool)])
@pytest.mark.parametrize("points", [20, 50, 300])
def test_what_is_not_believed_is_covered(believed: NDArray[np.bool_], points: int) -> None:
    confidence = np.tile(believed.astype(float), (120, 1))
    found = simplify.relief(waves(), CAMERA, points, confidence=confidence)
    assert found.coverage > 0.98


@pytest.mark.parametrize("effort", ["live", "balanced"])
def test_room_for_all_points_gives_the_dense_mesh(effort: simplify.Effort) -> None:
    random = np.random.default_rng(0)
    depth = waves()
    depth[random.random(depth.shape) < 0.1] = 0
    dense = simplify.dense_mesh(depth, CAMERA)
    used = np.unique(dense.faces)
    found = simplify.relief(depth, CAMERA, len(used), effort=effort)
    assert found.stop == "all_points"
    np.testing.assert_array_equal(found.pixels, dense.pixels[used])
    assert found.num_faces == dense.num_faces


def test_names_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for folder in ("depth", "color", "same"):
        (tmp_path / folder).mkdir()
    for i in range(12):
        (tmp_path / "depth" / f"{i}.png").touch()
        (tmp_path / "color" / f"{i:04d}.jpg").touch()
        (tmp_path / "same" / f"{11 - i}.jpg").touch()
    frames = [file.name for file in find_files([tmp_path / "depth"], suffixes=(".png",))]
    assert [Path(name).stem for name in frames] == [str(i) for i in range(12)]
    pairs = simplify.colors_of_frames(frames, tmp_path / "color")
    assert all(int(Path(a).stem) == int(Path(b).stem) for a, b in pairs.items())
    pairs = simplify.colors_of_frames(frames, tmp_path / "same")
    assert all(Path(a).stem == Path(b).stem for a, b in pairs.items())


def test_each_image_is_of_one_frame(tmp_path: Path) -> None:
    for name in ("1.jpg", "1.png"):
        (tmp_path / name).touch()
    pairs = simplify.colors_of_frames(["x/1.png", "y/1.png"], tmp_path)
    assert {frame: Path(image).name for frame, image in pairs.items()} == {
        "x/1.png": "1.jpg", "y/1.png": "1.png"
    }  # fmt: skip


def test_what_lies_beside_the_images_does_not_count(tmp_path: Path) -> None:
    for name in ("0001.jpg", "0002.JPG", ".DS_Store", "._0001.jpg", "notes.txt"):
        (tmp_path / name).touch()
    pairs = simplify.colors_of_frames(["a.png", "b.png"], tmp_path)
    assert [Path(image).name for image in pairs.values()] == ["0001.jpg", "0002.JPG"]


def test_a_part_of_the_frames_has_its_pictures_by_name(tmp_path: Path) -> None:
    for i in range(12):
        (tmp_path / f"{i}.jpg").touch()
    pairs = simplify.colors_of_frames(["d/7.png", "d/3.png"], tmp_path)
    assert pairs == {f"d/{i}.png": str(tmp_path / f"{i}.jpg") for i in (7, 3)}
    with pytest.raises(InputError, match=r"expected 2 images in .*, found 12, not one of each"):
        simplify.colors_of_frames(["d/27.png", "d/30.png"], tmp_path)


@pytest.mark.parametrize("name", ["color", "mask", "confidence"])
@pytest.mark.parametrize("names", ["{:04d}.png", "{:04d}.{}.png"])
def test_pictures_are_not_shifted_by_a_lost_frame(name: str, names: str, tmp_path: Path) -> None:
    """A missing picture is an error, although depth images and pictures are equally many."""
    for i in range(1, 6):
        (tmp_path / names.format(i, name)).touch()
    frames = [f"d/{names.format(i, 'depth')}" for i in range(2, 7)]
    missing = rf"{name}: expected an image in .*, found 4 of 5, none for {Path(frames[-1]).name}$"
    with pytest.raises(InputError, match=missing):
        simplify.colors_of_frames(frames, tmp_path, name=name)
    assert len(simplify.colors_of_frames(frames[:-1], tmp_path, name=name)) == 4


def test_numbers_are_those_of_one_list_if_some_agree(tmp_path: Path) -> None:
    for i in (0, 2, 4, 6):
        (tmp_path / f"{i:04}.jpg").touch()
    with pytest.raises(InputError, match=r"by the name of each depth image, found 1 of 4"):
        simplify.colors_of_frames([f"d/{i}.png" for i in (1, 2, 3, 5)], tmp_path)
    pairs = simplify.colors_of_frames([f"d/a{i}.png" for i in (1, 3, 5, 7)], tmp_path)  # none does
    assert [Path(image).stem for image in pairs.values()] == ["0000", "0002", "0004", "0006"]
    pairs = simplify.colors_of_frames([f"d/a{i}.png" for i in (6, 2)], tmp_path)
    assert {frame: Path(image).stem for frame, image in pairs.items()} == {
        "d/a2.png": "0002", "d/a6.png": "0006"
    }  # fmt: skip


def test_one_list_may_be_numbered_from_0_and_the_other_from_1(tmp_path: Path) -> None:
    for i in range(1, 6):
        (tmp_path / f"{i}.jpg").touch()
    pairs = simplify.colors_of_frames([f"d/{i}.png" for i in range(5)], tmp_path)
    assert [Path(image).stem for image in pairs.values()] == ["1", "2", "3", "4", "5"]
    (tmp_path / "5.jpg").rename(tmp_path / "6.jpg")  # a number is missing
    with pytest.raises(InputError, match=r"found 4 of 5, none for 0\.png$"):
        simplify.colors_of_frames([f"d/{i}.png" for i in range(5)], tmp_path)


def test_names_that_are_decimal_numbers_are_in_the_order_of_their_values(tmp_path: Path) -> None:
    names = ["0.25.png", "0.5.png", "1.0.png", "1.03333.png", "1.1.png", "10.0.png"]
    for name in names:
        (tmp_path / name).touch()
    found = find_files([tmp_path], suffixes=(".png",))
    assert [Path(file.name).name for file in found] == names


def test_time_stamps_that_agree_by_chance_are_no_names(tmp_path: Path) -> None:
    stamps = ["1.100", "1.230", "1.370"]
    for stamp in stamps:
        (tmp_path / f"{stamp}.png").touch()
    pairs = simplify.colors_of_frames(["d/1.110.png", "d/1.230.png", "d/1.360.png"], tmp_path)
    assert [Path(image).stem for image in pairs.values()] == stamps


def test_numbers_of_takes_and_frames_are_whole(tmp_path: Path) -> None:
    names = [f"1.{i}.bin" for i in range(1, 13)]
    for name in names:
        (tmp_path / name).touch()
    found = find_files([tmp_path], suffixes=(".bin",))
    assert [Path(file.name).name for file in found] == names
    assert [path.name for path in in_order(tmp_path.iterdir())] == names


def test_masks_are_told_from_depth_images_by_their_last_word() -> None:
    depths = ["a/1_depth.npy", "mask_depth_2.npy", "conference_3.npy", "conf_room_4.npy"]
    maps = ["a/1_depth_mask.npy", "1.conf.npy", "Mask_07.npy", "x confidence.npy"]
    assert maps_by_name([*depths, *maps]) == set(maps)
    assert maps_by_name([*depths[2:], *maps]) == set()  # no name says that it is a depth image


TIMES = [1305031102.160407 + 0.0334 * i for i in range(12)]


def touched(folder: Path, times: list[float], name: str = "{:.6f}.png") -> list[str]:
    folder.mkdir()
    files = [folder / name.format(time) for time in times]
    for file in files:
        file.touch()
    return [str(file) for file in files]


@pytest.mark.parametrize("kind", ["color", "mask", "confidence"])
def test_images_of_other_times_are_the_nearest(kind: str, tmp_path: Path) -> None:
    """After losses in both lists, images are paired by time and not by order."""
    frames = touched(tmp_path / "depth", TIMES[:4] + TIMES[5:])
    others = touched(tmp_path / "other", [time + 0.012 for time in TIMES if time != TIMES[8]])
    (tmp_path / "other" / "preview.png").touch()
    expected = dict(zip(frames[:7], others[:4] + others[5:8], strict=True))
    assert simplify.colors_of_frames(frames[:7], tmp_path / "other", name=kind) == expected
    missing = rf"{kind}: expected an image in .* within 0.02 s of each depth image, found 10 of 11"
    with pytest.raises(InputError, match=rf"{missing}, none for {Path(frames[7]).name}$"):
        simplify.colors_of_frames(frames, tmp_path / "other", name=kind)


def test_an_image_is_that_of_one_time_only(tmp_path: Path) -> None:
    frames = touched(tmp_path / "depth", [1.000, 1.010, 1.020])
    others = touched(tmp_path / "color", [1.011, 1.019, 1.500])
    with pytest.raises(InputError, match=r"found 2 of 3, none for 1\.000000\.png$"):
        simplify.colors_of_frames(frames, tmp_path / "color")
    pairs = simplify.colors_of_frames(frames[1:], tmp_path / "color")
    assert pairs == dict(zip(frames[1:], others[:2], strict=True))


def test_most_frames_have_a_picture(tmp_path: Path) -> None:
    """The largest number of frames get a picture, although each is nearer to the next frame."""
    frames = touched(tmp_path / "depth", TIMES)
    others = touched(tmp_path / "color", [time + 0.018 for time in TIMES])
    pairs = simplify.colors_of_frames(frames, tmp_path / "color")
    assert pairs == dict(zip(frames, others, strict=True))


def test_a_preview_among_the_frames_has_no_time(tmp_path: Path) -> None:
    frames = touched(tmp_path / "depth", TIMES)
    touched(tmp_path / "color", [time + 0.01 for time in TIMES])
    with pytest.raises(InputError, match=r"found 12 of 13, none for preview\.png$"):
        simplify.colors_of_frames([*frames, "depth/preview.png"], tmp_path / "color")
    assert associate([np.nan, 1.0, 2.0], [1.001, 2.001, 3.0]) == [None, 0, 1]
    assert associate([np.inf, 1.0], [np.nan, 1.001, np.inf]) == [None, 1]


@pytest.mark.parametrize("unit", [1, 1000])
def test_dates_are_no_times_since_1970(unit: int, tmp_path: Path) -> None:
    """Dates in names are not taken for times, by which half a minute would be 30 ms."""
    stamps = [(20210304120000 + 100 * minute) * unit for minute in range(12)]
    frames = touched(tmp_path / "depth", stamps, "{}.png")
    others = touched(tmp_path / "color", [stamp + 30 * unit for stamp in stamps], "{}.jpg")
    pairs = simplify.colors_of_frames(frames, tmp_path / "color")  # in order
    assert pairs == dict(zip(frames, others, strict=True))
    assert [seconds(stamp) for stamp in stamps] == stamps


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e9])
def test_times_without_a_point_are_those_since_1970(unit: float, tmp_path: Path) -> None:
    stamps = [round(time * unit) for time in TIMES]
    late = [round((time + 0.01) * unit) for time in TIMES]
    frames = touched(tmp_path / "depth", stamps[6:], "{}.png")
    others = touched(tmp_path / "color", late, "rgb_{}.jpg")
    expected = dict(zip(frames, others[6:], strict=True))
    assert simplify.colors_of_frames(frames, tmp_path / "color") == expected


def test_a_kind_of_picture_that_is_unknown_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name: expected one of color, mask, confidence, got 'd"):
        simplify.colors_of_frames([], tmp_path, name="depht")
    with pytest.raises(FileNotFoundError):
        simplify.colors_of_frames(["1.png"], tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("depth", "color", "mask", "confidence"),
    [
        ("frame-0{}.depth.png", "frame-0{}.color.png", "frame-0{}.mask.png", "frame-0{}.conf.png"),
        ("0{}_depth.png", "0{}.jpg", "0{}_mask.jpg", "0{}_confidence.png"),
        ("depth_{}.png", "rgb_{}.png", "mask_{}.png", "confidence_{}.png"),
        ("Depth{}.tif", "Color{}.png", "Mask{}.png", "Conf{}.tif"),
        ("0{}_depth.npy", "0{}.png", "0{}_depth_mask.npy", "0{}_depth_conf.npy"),  # DIODE
    ],
)
def test_one_folder_holds_all_images(
    tmp_path: Path, depth: str, color: str, mask: str, confidence: str
) -> None:
    kinds = {"color": color, "mask": mask, "confidence": confidence}
    for i in range(4):
        for name in (depth, *kinds.values()):
            (tmp_path / name.format(i)).touch()
    some = [str(tmp_path / depth.format(i)) for i in (1, 3)]  # and through another path
    for frames in (some, [str(tmp_path / "." / ".." / tmp_path.name / Path(f).name) for f in some]):
        for kind, name in kinds.items():
            pairs = simplify.colors_of_frames(frames, tmp_path, name=kind)
            assert [Path(pairs[f]).name for f in frames] == [name.format(i) for i in (1, 3)], kind


def test_depth_images_are_not_their_own_colors_and_masks(tmp_path: Path) -> None:
    for i in range(2):
        (tmp_path / f"{i}_depth.png").touch()
        (tmp_path / f"{i}.jpg").touch()
    frames = [tmp_path / f"{i}_depth.png" for i in range(2)]
    expected = r"mask: expected 2 images in .*, found 0 beside the depth images, not one of each"
    with pytest.raises(InputError, match=expected):  # the colour images are no masks
        simplify.colors_of_frames(frames, tmp_path, name="mask")
    with pytest.raises(InputError, match=r"color: expected 1 images in .*, found 0 beside"):
        simplify.colors_of_frames([tmp_path / "0.jpg"], tmp_path)
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "7.png").symlink_to(tmp_path / "0_depth.png")
    with pytest.raises(InputError, match=r"color: expected 1 images in .*, found 0 beside"):
        simplify.colors_of_frames([tmp_path / "linked" / "7.png"], tmp_path)


def test_a_copy_of_a_depth_image_is_not_its_color(tmp_path: Path) -> None:
    for name in ("0.depth.png", "0.color.jpg"):
        (tmp_path / name).touch()
    pairs = simplify.colors_of_frames(["elsewhere/0.depth.png"], tmp_path)
    assert Path(pairs["elsewhere/0.depth.png"]).name == "0.color.jpg"


def test_colors_of_other_times_are_matched_in_order(tmp_path: Path) -> None:
    for name in ("1.05.depth.png", "1.06.rgb.png", "1.09.depth.png", "1.10.rgb.png", "sheet.png"):
        (tmp_path / name).touch()
    frames = [str(tmp_path / f"1.{i}.depth.png") for i in ("05", "09")]
    pairs = simplify.colors_of_frames(frames, tmp_path)
    assert [Path(pairs[frame]).name for frame in frames] == ["1.06.rgb.png", "1.10.rgb.png"]


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("place", "kind", "depth", "other"),
    [
        ("scene_7scenes_redkitchen", "color", ".depth.png", ".color.jpg"),
        ("person_turning_uva", "color", "_depth.png", ".jpg"),
        ("person_turning_uva", "mask", "_depth.png", "_mask.jpg"),
        ("scene_tum_fr2_desk", "color", "_depth.png", "_color.png"),
    ],
)
def test_folders_of_data_sets_give_each_image_its_own(
    realdata: RealData, place: str, kind: str, depth: str, other: str
) -> None:
    folder = realdata(f"rgbd/{place}")
    frames = [str(path) for path in folder.glob(f"*{depth}")]
    pairs = simplify.colors_of_frames(frames, folder, name=kind)
    assert pairs == {frame: frame.removesuffix(depth) + other for frame in frames} != {}


def test_the_largest_number_is_no_measurement(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    depth = waves()
    depth[40:60, 40:60] = 65535
    image.fromarray(depth).save(tmp_path / "a.png")
    options = simplify.DepthOptions(20, intrinsics="130,130,79.5,59.5", unit="mm")
    result = simplify.simplify_depth_file(tmp_path / "a.png", tmp_path / "a.ply", options)
    assert result.points_before == depth.size - 400
    assert "400 pixels of 65535 taken as not measured" in result.depth
    assert "1.25 to 1.75 m" in result.depth
    assert result.dropped_pixels == 0


def test_a_camera_with_rows_up_has_steps_too() -> None:
    depth = box_before_waves()
    up = Intrinsics(160, 120, 130.0, -130.0, 79.5, 59.5)
    for found, other in (
        (simplify.relief(depth, up, 60), simplify.relief(depth, CAMERA, 60)),
        (simplify.cs3(depth, up, target_points=60), simplify.cs3(depth, CAMERA, target_points=60)),
    ):
        assert found.coverage == pytest.approx(other.coverage, abs=0.02)
        cut = simplify.cut_depth_steps(found, depth, intrinsics=up)
        assert 0 < cut.num_faces < found.num_faces
        assert cut.num_faces == simplify.cut_depth_steps(found, depth).num_faces
    assert simplify.ReliefStream(up, 60).simplify(depth).num_faces > 0


@pytest.mark.parametrize("method", [simplify.relief_cameras, simplify.cs3_cameras])
def test_views_of_several_cameras_know_their_camera(
    method: Callable[..., simplify.JointSimplification],
) -> None:
    depth = floor()
    camera = Intrinsics(128, 96, 60.0, 60.0, 63.5, 20.5)
    joint = method([simplify.CameraView(depth, camera)], 200)
    assert 0.9 < joint.coverage <= 1
    (view,) = joint.views
    said = simplify.cut_depth_steps(view, depth, intrinsics=camera)
    assert simplify.cut_depth_steps(view, depth).num_faces == said.num_faces
    assert isinstance(view.surface, simplify.DenseGrid)
    unknown = replace(view, surface=replace(view.surface, focal=0.0))
    assert simplify.cut_depth_steps(unknown, depth).num_faces < said.num_faces


def test_coloured_and_paletted_masks_are_read(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    mask = np.zeros((4, 6, 3), np.uint8)
    mask[1, 2] = (0, 200, 0)
    image.fromarray(mask).save(tmp_path / "rgb.png")
    image.fromarray(mask).quantize(4).save(tmp_path / "palette.png")
    for name in ("rgb.png", "palette.png"):
        found = io.read_pixel_map(tmp_path / name)
        np.testing.assert_array_equal(found != 0, mask.any(axis=2))


def test_a_jpeg_mask_is_where_it_is_bright(tmp_path: Path) -> None:
    """Grey values that compression leaves around a white mask do not belong to it."""
    image = pytest.importorskip("PIL.Image")
    np.save(tmp_path / "wall.npy", np.full((60, 80), 2000, np.uint16))
    disk = np.hypot(*(np.mgrid[:60, :80] - np.array([[[30]], [[40]]]))) < 20
    options = simplify.DepthOptions(30, intrinsics="80,80,39.5,29.5")
    for mode, grey in (("L", 255), ("RGB", 255), ("L", 120), ("L", 60)):
        path = tmp_path / f"{mode}.jpg"
        image.fromarray(np.uint8(grey * disk)).convert(mode).save(path, quality=80)
        assert np.count_nonzero(io.read_pixel_map(path)) > disk.sum() + 80
        found = simplify.simplify_depth_file(
            tmp_path / "wall.npy", tmp_path / "wall.ply", options, mask=path
        )
        assert abs(found.points_before - disk.sum()) <= 0.01 * disk.sum()
    black = np.random.default_rng(0).integers(0, 5, (60, 80), dtype=np.uint8)
    image.fromarray(black).save(tmp_path / "black.jpg")
    with pytest.raises(FormatError, match="the mask leaves"):
        simplify.simplify_depth_file(
            tmp_path / "wall.npy", tmp_path / "wall.ply", options, mask=tmp_path / "black.jpg"
        )


def stored_sideways(upright: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Return the pixels as stored by a camera that states this EXIF orientation."""
    flips = {3: upright[::-1, ::-1], 6: np.rot90(upright, 1), 8: np.rot90(upright, -1)}
    return np.ascontiguousarray(flips[orientation])


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_pictures_are_turned_upright(orientation: int, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    exif = image.Exif()
    exif[274] = orientation
    picture = np.zeros((120, 160, 3), np.uint8)
    picture[:60, :80] = 250
    stored = image.fromarray(stored_sideways(picture, orientation))
    for name, each in (("color.jpg", stored), ("mask.jpg", stored.convert("L"))):
        each.save(tmp_path / name, quality=100, exif=exif)
    stored.save(tmp_path / "color.png", exif=exif)
    expected = picture[..., 0].astype(int)
    for name in ("color.jpg", "color.png"):
        for shape in (None, (120, 160), (60, 80), (7, 9)):
            found = read_color(tmp_path / name, shape)[..., 0]
            assert found.shape == expected.shape
            assert np.abs(found - expected).max() < 12
    for shape in (None, (120, 160)):
        np.testing.assert_array_equal(
            read_mask(tmp_path / "mask.jpg", shape=shape), picture[..., 0] > 0
        )
        levels = io.read_pixel_map(tmp_path / "mask.jpg", shape=shape)
        assert np.abs(levels - expected).max() < 12


@pytest.mark.parametrize("orientation", [0, 1, 2, 3, 4, 5, 6, 7, 8, 9])
def test_each_orientation_is_that_of_pillow(orientation: int, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    operations = pytest.importorskip("PIL.ImageOps")
    exif = image.Exif()
    exif[274] = orientation
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    for name in ("a.png", "a.tif"):
        image.fromarray(pixels).save(tmp_path / name, exif=exif)
        with image.open(tmp_path / name) as stored:
            expected = np.array(operations.exif_transpose(stored))
        np.testing.assert_array_equal(read_color(tmp_path / name), expected)


@pytest.mark.parametrize("orientation", [6, 8])
def test_pictures_stay_as_the_sensor_has_them_if_the_depth_does(
    orientation: int, tmp_path: Path
) -> None:
    """Pictures are not turned if their depth image is stored sideways, too."""
    image = pytest.importorskip("PIL.Image")
    exif = image.Exif()
    exif[274] = orientation
    stored = np.zeros((120, 160), np.uint8)
    stored[:60, :80] = 250
    image.fromarray(stored).save(tmp_path / "a.jpg", quality=100, exif=exif)
    assert np.abs(read_color(tmp_path / "a.jpg", (120, 160))[..., 0] - stored.astype(int)).max() < 9
    np.testing.assert_array_equal(read_mask(tmp_path / "a.jpg", shape=(120, 160)), stored > 0)


def test_a_mesh_has_the_colours_of_the_upright_picture(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    exif = image.Exif()
    exif[274] = 3
    picture = np.zeros((120, 160, 3), np.uint8)
    picture[:60, :80] = 250
    image.fromarray(picture[::-1, ::-1]).save(tmp_path / "a.jpg", quality=100, exif=exif)
    np.save(tmp_path / "a.npy", waves())
    options = simplify.DepthOptions(20, intrinsics="130,130,79.5,59.5", unit="mm")
    simplify.simplify_depth_file(
        tmp_path / "a.npy", tmp_path / "a.glb", options, color=tmp_path / "a.jpg"
    )
    material = io.read_mesh(tmp_path / "a.glb").materials[0]
    with image.open(BytesIO(material.textures["base_color"].data or b"")) as texture:
        assert texture.getpixel((20, 20))[0] > 240
        assert texture.getpixel((140, 100))[0] < 15


def test_nan_in_a_mask_leaves_a_pixel_out(tmp_path: Path) -> None:
    np.save(tmp_path / "wall.npy", np.full((24, 32), 2000, np.uint16))
    mask = np.full((24, 32), np.nan, np.float32)
    mask[:, :16] = 1
    mask[:, :4] = 0
    np.save(tmp_path / "mask.npy", mask)
    options = simplify.DepthOptions(30, intrinsics="30,30,15.5,11.5")
    found = simplify.simplify_depth_file(
        tmp_path / "wall.npy", tmp_path / "wall.ply", options, mask=tmp_path / "mask.npy"
    )
    assert found.points_before == 24 * 12


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_grey_colour_images_of_16_bits_keep_their_upper_bits(suffix: str, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    np.save(tmp_path / "wall.npy", np.full((24, 32), 2000, np.uint16))
    levels = (2000 * np.arange(32, dtype=np.uint16))[None].repeat(24, axis=0)
    image.fromarray(levels).save(tmp_path / f"grey{suffix}")
    image.fromarray(levels.astype(np.float32)).save(tmp_path / "floats.tif")
    image.fromarray(levels.astype(np.int32) * 9).save(tmp_path / "wide.tif")
    options = simplify.DepthOptions(30, intrinsics="30,30,15.5,11.5")
    given = (tmp_path / "wall.npy", tmp_path / "wall.glb", options)
    simplify.simplify_depth_file(*given, color=tmp_path / f"grey{suffix}")
    data = io.read_mesh(tmp_path / "wall.glb").materials[0].textures["base_color"].data
    assert data is not None
    shown = np.asarray(image.open(BytesIO(data)).convert("RGB"))
    np.testing.assert_array_equal(shown, (levels >> 8)[..., None].repeat(3, axis=2))
    for name in ("floats.tif", "wide.tif"):
        with pytest.raises(FormatError, match="expected a colour image of 8 or 16 bits"):
            simplify.simplify_depth_file(*given, color=tmp_path / name)


def test_fewer_than_three_points_are_refused() -> None:
    with pytest.raises(InputError, match="points: expected at least 3, got 2"):
        simplify.DepthOptions(2)
    with pytest.raises(
        InputError, match="points: expected a whole number of 64 bits or None, got 1000"
    ):
        simplify.DepthOptions(10**20)


def test_cameras_do_not_join_box_and_wall() -> None:
    pose = np.eye(4)
    pose[0, 3] = 0.3
    depth = box_before_waves()
    views = [simplify.CameraView(depth, CAMERA), simplify.CameraView(depth, CAMERA, pose=pose)]
    for simplified in (simplify.relief_cameras, simplify.cs3_cameras):
        shares = []
        for step in (None, 0.05):
            joint = simplified(views, 300, depth_step=step)
            corners = joint.vertices[joint.faces]
            z = corners[..., 2]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = np.linalg.norm(normals, axis=1)
            joins = (z.min(axis=1) < 0.75) & (z.max(axis=1) > 1.2)
            shares.append(area[joins].sum() / area.sum())
        assert shares[0] > 0.3
        assert shares[1] < 0.03, shares
        assert shares[1] < 0.1 * shares[0]
        assert 0.5 < joint.coverage <= 1
    with pytest.raises(InputError, match="depth_step: expected > 0"):
        simplify.relief_cameras(views, 300, depth_step=0.0)


def stars_before_a_wall(shift: float) -> NDArray[np.uint16]:
    """Return the view of stars by a camera that is moved right by ``shift`` metres."""
    v, u = np.mgrid[0:120, 0:160].astype(float)
    depth = 2 + 0.1 * np.sin(v / 9) * np.cos(u / 13)
    for x, y, z, size in ((-0.3, -0.2, 1, 0.12), (0.2, 0.1, 1.2, 0.15), (0.45, -0.3, 0.9, 0.1)):
        du, dv = u - ((x - shift) / z * 130 + 79.5), v - (y / z * 130 + 59.5)
        radius = size / z * 130 * (1 + 0.25 * np.sin(5 * np.arctan2(dv, du)))
        depth[np.hypot(du, dv) < radius] = z
    return (1000 * depth).round().astype(np.uint16)


@pytest.mark.parametrize(("points", "least"), [(400, 0.97), (1500, 0.98)])
def test_cameras_make_no_sheets_across_steps(points: int, least: float) -> None:
    """Meshes of two cameras have no thin triangles across steps, once 5 to 7 % of the area."""
    pose = np.eye(4)
    pose[0, 3] = 0.15
    views = [
        simplify.CameraView(stars_before_a_wall(0), CAMERA),
        simplify.CameraView(stars_before_a_wall(0.15), CAMERA, pose=pose),
    ]
    joint = simplify.relief_cameras(views, points, depth_step=simplify.DEPTH_STEP)
    assert joint.bridges < 0.01
    assert joint.coverage > least  # the outlines of the stars are as coarse as the mesh


@pytest.mark.parametrize("max_edge", [0.3, 0.05])
def test_a_limit_on_edges_leaves_the_seam_of_a_wall_whole(max_edge: float) -> None:
    wall = np.full((120, 160), 2000, np.uint16)
    pose = np.eye(4)
    pose[0, 3] = 0.5
    views = [simplify.CameraView(wall, CAMERA), simplify.CameraView(wall, CAMERA, pose=pose)]
    joint = simplify.relief_cameras(views, 60, max_edge=max_edge)
    assert joint.coverage > 0.999
    sides = joint.vertices[joint.faces] - joint.vertices[np.roll(joint.faces, 1, axis=1)]
    assert np.linalg.norm(sides, axis=2).max() > 0.5


def test_a_limit_on_edges_keeps_box_and_wall_apart_at_the_seam() -> None:
    pose = np.eye(4)
    pose[0, 3] = 0.3
    depth = box_before_waves()
    views = [simplify.CameraView(depth, CAMERA), simplify.CameraView(depth, CAMERA, pose=pose)]
    for max_edge in (None, 0.2):
        joint = simplify.relief_cameras(views, 300, max_edge=max_edge)
        z = joint.vertices[joint.faces, 2]
        joins = (z.min(axis=1) < 0.75) & (z.max(axis=1) > 1.2)
        assert joins.any() == (max_edge is None)
        assert joint.coverage > 0.9


@pytest.mark.parametrize("join", [simplify.cs3_cameras, simplify.relief_cameras])
@pytest.mark.parametrize("max_edge", [-1.0, 0.0, float("nan")])
def test_cameras_refuse_a_limit_that_is_none(
    join: Callable[..., simplify.JointSimplification], max_edge: float
) -> None:
    with pytest.raises(InputError, match="max_edge: expected > 0"):
        join([simplify.CameraView(waves(), CAMERA)], 50, max_edge=max_edge)


def test_edges_that_pass_behind_something_join_no_gap() -> None:
    depth = slope_behind_pole()
    points, valid, _ = _core.unproject(depth, CAMERA, 1)
    points, valid = points.reshape(120, 160, 3), valid.reshape(120, 160).view(np.bool_)
    pixels = np.array([[20, 60], [140, 60], [140, 110], [80, 60]], np.int32)
    faces = np.array([[0, 1, 2], [0, 3, 2]], np.int32)
    assert across_gaps(faces, pixels, points, valid, 0.2).tolist() == [False, True]
    assert across_gaps(faces, pixels, points, valid, 2.0).tolist() == [False, False]
    valid[30:90, 70:90] = False  # the pole is not seen: 20 pixels of a slope may be 20 edges
    points[30:90, 70:90] = np.nan
    pixels[3, 0] = 60
    assert across_gaps(faces, pixels, points, valid, 0.05).tolist() == [False, False]
    assert across_gaps(faces, pixels, points, valid, 0.01).tolist() == [True, True]


def test_three_points_are_a_triangle_of_one_camera() -> None:
    pose = np.eye(4)
    pose[0, 3] = 0.2
    views = [simplify.CameraView(waves(), CAMERA), simplify.CameraView(waves(), CAMERA, pose=pose)]
    joint = simplify.relief_cameras(views, 3)
    assert (joint.num_vertices, joint.num_faces) == (3, 1)


def test_cs3_takes_a_mask_and_a_depth_step() -> None:
    depth = box_before_waves()
    left = np.tile(np.arange(160) < 80, (120, 1))
    found = simplify.cs3(depth, CAMERA, 200, mask=left, depth_step=0.05)
    plain = simplify.cs3(np.where(left, depth, 0).astype(np.uint16), CAMERA, 200)
    np.testing.assert_array_equal(found.pixels, plain.pixels)
    assert found.pixels[:, 0].max() < 80
    np.testing.assert_array_equal(found.faces, simplify.cut_depth_steps(plain, depth).faces)
    assert 0 < found.num_faces < plain.num_faces
    with pytest.raises(InputError, match="depth_step: expected > 0"):
        simplify.cs3(depth, CAMERA, 200, depth_step=-0.1)


@pytest.mark.parametrize("method", ["cs3", "relief"])
def test_faces_across_steps_that_stayed_are_counted(
    method: simplify.DepthMethod, tmp_path: Path
) -> None:
    np.save(tmp_path / "a.npy", box_before_waves())
    for step, max_edge in ((0.0, None), (0.05, None), (0.0, 0.2)):
        options = simplify.DepthOptions(
            200, method, intrinsics="130,130,79.5,59.5", unit="mm", depth_step=step,
            max_edge=max_edge,
        )  # fmt: skip
        result = simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
        stayed = step == 0.0 and max_edge is None
        assert (result.faces_left > 0) == stayed
        assert (result.left_area > 0.3) == stayed
        assert result.bridges_missed == stayed
        assert (result.left_area == 0) != stayed


def lone_pixels(valid: NDArray[np.bool_]) -> int:
    """Count measured pixels that no square of two by two joins with two others."""
    height, width = valid.shape
    lone = 0
    for v, u in np.argwhere(valid):
        squares = [
            valid[top : top + 2, left : left + 2].sum()
            for top in (v - 1, v)
            for left in (u - 1, u)
            if 0 <= top < height - 1 and 0 <= left < width - 1
        ]
        lone += max(squares) < 3
    return lone


@pytest.mark.parametrize("share", [0.04, 0.15, 0.45, 0.6, 0.9])
def test_lone_pixels_are_counted(share: float, tmp_path: Path) -> None:
    mask = np.random.default_rng(3).random((120, 160)) < share
    mask[:2, -2:] = [[True, True], [True, False]]  # a face, so that there is something to write
    depth = np.where(mask, 2000, 0).astype(np.uint16)
    np.save(tmp_path / "a.npy", depth)
    options = simplify.DepthOptions(20000, intrinsics="130,130,79.5,59.5", unit="mm")
    result = simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert result.lone_pixels == lone_pixels(mask)
    assert result.points_before == mask.sum()
    assert result.is_sparse == (lone_pixels(mask) > 0.5 * mask.sum())
    assert result.is_sparse == (share < 0.3)


@pytest.mark.realdata
def test_a_projected_scan_is_said_to_be_sparse(realdata: RealData, tmp_path: Path) -> None:
    """A scan in a camera, stored in 1/256 m as in KITTI's depth completion, is sparse."""
    folder = realdata("lidar/kitti_object")
    frame = datasets.open_kitti(folder)[0]
    calibration = frame.calibration()
    pixels, z = calibration.project(frame.scan().points, camera=2)
    at = np.round(pixels[(z > 0) & (z < 255)])
    inside = (at >= 0).all(axis=1) & (at < (1242, 375)).all(axis=1)
    u, v = at[inside].astype(int).T
    depth = np.zeros((375, 1242), np.uint16)
    depth[v, u] = np.round(256 * z[(z > 0) & (z < 255)][inside])
    assert 0.03 < np.mean(depth > 0) < 0.06
    np.save(tmp_path / "a.npy", depth)
    p = calibration.projections[2]
    camera = f"{p[0, 0]},{p[1, 1]},{p[0, 2]},{p[1, 2]}"
    options = simplify.DepthOptions(5000, "relief", intrinsics=camera, unit="256")
    with pytest.raises(FormatError, match=r"stand alone, .* simplify\.grid_delaunay joins pixels"):
        simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert not (tmp_path / "a.ply").exists()
    options = replace(options, method="cs3")
    result = simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert result.is_sparse
    assert result.coverage_missed
    assert result.lone_pixels == lone_pixels(depth > 0)


def test_an_empty_mesh_is_not_blamed_on_what_was_not_asked_for(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.where(np.arange(24)[:, None] % 2, np.full((24, 48), 2000), 0)
            .astype(np.uint16))  # fmt: skip
    for step, max_edge, words in (
        (0.0, None, "two by two; most"),
        (0.05, None, "two by two without a depth step; most"),
        (0.0, 0.1, "two by two without a longer edge than max_edge; most"),
        (0.05, 0.1, "two by two without a longer edge than max_edge or a depth step; most"),
    ):
        options = simplify.DepthOptions(
            20, intrinsics="40,40,23.5,11.5", unit="mm", depth_step=step, max_edge=max_edge
        )
        with pytest.raises(FormatError, match=words):
            simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)


@pytest.mark.parametrize(
    ("option", "value"),
    [("intrinsics", "tum"), ("unit", "mm"), ("depth_step", 0.1), ("depth_step", 0.0)],
)
def test_what_a_scan_cannot_follow_is_refused(
    option: str, value: float | str, tmp_path: Path
) -> None:
    lines = ["ply", "format ascii 1.0", "obj_info num_cols 2", "obj_info num_rows 2",
             "element vertex 4", *(f"property float {axis}" for axis in "xyz"),
             "element range_grid 4", "property list uchar int vertex_indices", "end_header",
             "0 0 0", "1 0 0", "0 1 0", "1 1 0", *(f"1 {i}" for i in range(4))]  # fmt: skip
    (tmp_path / "scan.ply").write_text("\n".join(lines) + "\n")
    options = simplify.DepthOptions(4)
    assert simplify.simplify_depth_file(tmp_path / "scan.ply", tmp_path / "a.ply", options).faces
    asked = replace(options, **{option: value})  # type: ignore[arg-type]
    with pytest.raises(
        InputError, match=f"{option}: can only be given with a depth image, got a scan"
    ):
        simplify.simplify_depth_file(tmp_path / "scan.ply", tmp_path / "b.ply", asked)


def test_numbers_that_are_none_are_refused_by_name() -> None:
    depth = waves()
    with pytest.raises(InputError, match="expected a number for outliers, got 'x'"):
        simplify.cs3(depth, CAMERA, 50, reading={"outliers": "x"})
    with pytest.raises(InputError, match="target_points: expected >= 1, got 0"):
        simplify.cs3(depth, CAMERA, 0)
    with pytest.raises(InputError, match=r"got shape \(3, 5, 6\).*; np.moveaxis\(points, 0, -1\)"):
        simplify.relief_grid(np.ones((3, 5, 6)), None, 50)
    with pytest.raises(InputError, match="num_vertices: expected a whole number, got '3'"):
        simplify.relief(depth, CAMERA, 50).prefix("3")  # type: ignore[arg-type]
    for step in (float("inf"), float("nan"), -1.0):
        with pytest.raises(InputError, match="depth_step: expected >= 0 and finite"):
            simplify.DepthOptions(50, depth_step=step)
    with pytest.raises(InputError, match=r"max_bridges: expected 0 to 1, got 1\.5"):
        simplify.DepthOptions(50, max_bridges=1.5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"points": "100"}, "points: expected a whole number of 64 bits or None, got '100'"),
        ({"points": 100.5}, r"points: expected a whole number of 64 bits or None, got 100\.5"),
        ({"depth_step": None}, "depth_step: expected a number, got None"),
        ({"threads": -3}, "threads: expected 0 to 2147483647, got -3"),
        ({"seed": -1}, "seed: expected >= 0, got -1"),
        ({"max_edge": -1.0}, r"max_edge: expected > 0, got -1\.0"),
        ({"max_edge": float("nan")}, "max_edge: expected > 0, got nan"),
        ({"bandwidth": -1.0, "rate": 30.0}, "bandwidth: expected > 0"),
        ({"points": None, "ratio": 0.5, "bandwidth": -1.0, "rate": 30.0}, "bandwidth: expected"),
    ],
)
def test_options_of_a_depth_image_are_checked(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simplify.DepthOptions(**({"points": 50} | given))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"valid": np.zeros((120, 160), bool)}, "valid: can only be given with points, got depth"),
        ({"rows_up": False}, "rows_up: can only be given with points, got depth"),
        ({"intrinsics": CAMERA}, "intrinsics: can only be given with depth, got points"),
        (
            {"registration": Registration(CAMERA, np.eye(3), np.zeros(3))},
            "registration: can only be given with depth, got points",
        ),
    ],
)
def test_views_refuse_what_belongs_to_another_kind(given: dict[str, Any], message: str) -> None:
    kind: dict[str, Any] = {"depth": waves(), "intrinsics": CAMERA}
    if message.endswith("got points"):
        kind = {"points": CAMERA.unproject(waves() / np.float32(1000)).reshape(120, 160, 3)}
    view = simplify.CameraView(**(kind | given))
    with pytest.raises(InputError, match=rf"views\[1\]\.{message}"):
        simplify.cs3_cameras([simplify.CameraView(**kind), view], 50)


@pytest.mark.parametrize("move", [False, True])
@pytest.mark.parametrize("effort", ["fine", "balanced", "live"])
def test_lone_pixels_far_from_each_other_are_no_surface(move: bool, effort: str) -> None:
    depth = np.zeros((20, 30), np.float32)
    depth[3, 4], depth[10, 20], depth[15, 8] = 1.0, 5e4, 2.0
    camera = Intrinsics(30, 20, 30.0, 30.0, 14.5, 9.5)
    found = simplify.relief(
        depth, camera, 10, max_edge=0.1, depth_step=0.05, move_points=move, effort=effort
    )
    assert (found.num_vertices, found.num_faces, found.coverage) == (0, 0, 0.0)


def test_disparities_of_a_stereo_pair_are_depth(tmp_path: Path) -> None:
    depth = np.full((60, 80), 2.0, np.float32)
    depth[20:40, 30:60] = 1.5
    disparity = 80.0 * 0.2 / depth - 3.5
    disparity[:4] = np.inf  # Middlebury's mark of an unknown one
    rows = disparity[::-1].astype("<f4").tobytes()
    (tmp_path / "disp0.pfm").write_bytes(b"Pf\n80 60\n-1.0\n" + rows)
    calibration = tmp_path / "calib.txt"
    calibration.write_text(
        "cam0=[80 0 39.5; 0 80 29.5; 0 0 1]\ndoffs=3.5\nbaseline=200\nwidth=80\nheight=60\n"
    )
    options = simplify.DepthOptions(100, intrinsics=str(calibration))
    result = simplify.simplify_depth_file(tmp_path / "disp0.pfm", tmp_path / "out.ply", options)
    assert result.unit == "disparity:16,3.5"
    z = io.read_mesh(tmp_path / "out.ply").vertices[:, 2]
    np.testing.assert_allclose([z.min(), z.max()], [1.5, 2.0], rtol=1e-5)


@pytest.mark.parametrize("effort", ["live", "balanced"])
@pytest.mark.parametrize("target", [40, 80])
def test_far_specks_do_not_take_the_points_of_the_surface(
    target: int, effort: simplify.Effort
) -> None:
    """Specks, 0.5 % of the pixels, get no vertices; they once had up to three eighths."""
    found = simplify.relief(box_and_far_specks(), CAMERA, target, depth_step=0.05, effort=effort)
    assert not (found.vertices[:, 2] > 5).any()
    assert found.stop == "small_pieces"
    assert found.dropped_pixels == 8 * 6  # three by four pixels are two by three squares
    plain = simplify.relief(box_before_waves(), CAMERA, target, depth_step=0.05, effort=effort)
    assert found.coverage > 0.9 * plain.coverage


def test_far_specks_stay_where_there_are_points_for_all() -> None:
    found = simplify.relief(box_and_far_specks(), CAMERA, 400, depth_step=0.05)
    assert (found.vertices[:, 2] > 50).sum() >= 8 * 4
    assert found.coverage > 0.99


def bars_before_a_corridor() -> NDArray[np.float32]:
    """Return a corridor 100 m long behind bars at 1.6 m, which are a quarter of the pixels."""
    v, u = np.mgrid[0:120, 0:160]
    x, y = (u - 79.5) / 130, (v - 59.5) / 130
    niche = 1.3 / np.abs(x)
    is_niche = (niche % 3 < 1) & (niche * np.abs(y) < 0.8)
    wall = np.where(is_niche, niche, 1.15 / np.abs(x))
    depth = np.minimum(np.minimum(wall, 1.2 / np.abs(y)), 100.0)
    is_bar = (np.abs(x) < 0.4) & (np.abs(y) < 0.35) & ((1.6 * x) % 0.12 < 0.06) & (depth > 1.6)
    return np.where(is_bar, 1.6, depth).astype(np.float32)


@pytest.mark.parametrize("effort", ["live", "fast", "balanced", "fine"])
def test_near_things_are_not_the_first_to_be_left_out(effort: simplify.Effort) -> None:
    """Near bars keep their points; by area alone, far niches get them: coverage 0.76 to 0.82."""
    depth = bars_before_a_corridor()
    found = simplify.relief(depth, CAMERA, 160, depth_step=simplify.DEPTH_STEP, effort=effort)
    cut = simplify.cut_depth_steps(found, depth)
    assert cut.coverage > 0.85
    assert found.dropped_pixels < 600  # of 4,700 in bars


def test_poses_with_a_whole_matrix_in_each_line(tmp_path: Path) -> None:
    """Lines with whole 4x4 matrices, camera to world as in Replica's traj.txt, are read."""
    poses = np.stack([np.eye(4)] * 2)
    poses[1, :3] = [[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0]]
    place = tmp_path / "traj.txt"
    np.savetxt(place, poses.reshape(-1, 16))
    found = simplify.poses_of_files(["depth000000.png", "depth000001.png"], place)
    np.testing.assert_array_equal(found, poses)
    poses[1, 3, 0] = 1.0
    np.savetxt(place, poses.reshape(-1, 16))
    with pytest.raises(FormatError, match="expected a rigid transform") as caught:
        simplify.poses_of_files(["depth000000.png", "depth000001.png"], place)
    assert caught.value.line == 2


RAYS = np.random.default_rng(0).uniform(-0.6, 0.6, (120, 160, 2)).astype(np.float32)
LENSES = [
    CAMERA,
    replace(CAMERA, fy=-130.0, cx=40.0, distortion=(0.1, -0.05, 0.01, 0.02, 0.003)),
    replace(CAMERA, mirrored=True),
    replace(CAMERA, rays=RAYS),
]


@pytest.mark.parametrize("camera", LENSES)
def test_distances_along_the_rays_are_those_of_points_at_the_depth(camera: Intrinsics) -> None:
    depth = waves() / np.float32(1000)
    distances = np.linalg.norm(camera.unproject(depth).astype(np.float64), axis=2)
    found = planar_depth(distances.astype(np.float32), camera)
    np.testing.assert_allclose(found, depth, rtol=3e-7)
    millimetres = np.round(1000 * distances).astype(np.uint16)
    np.testing.assert_allclose(planar_depth(millimetres, camera), depth, atol=0.0005)


def test_pixels_without_a_line_of_sight_or_a_measurement_keep_their_number() -> None:
    rays = RAYS.copy()
    rays[3, 4] = np.nan
    distances = waves() / np.float32(1000)
    distances[5, 6], distances[7, 8] = 0.0, np.nan
    found = planar_depth(distances, replace(CAMERA, rays=rays))
    assert found[3, 4] == distances[3, 4]
    assert found[5, 6] == 0.0
    assert np.isnan(found[7, 8])


@pytest.mark.parametrize("method", ["relief", "cs3", "uniform"])
def test_a_wall_in_distances_along_the_rays_is_flat(
    method: simplify.DepthMethod, tmp_path: Path
) -> None:
    """`ray_depth` makes a flat wall of distances, which would else be a bowl."""
    wall = np.full((120, 160), 2.0, np.float32)
    distances = np.linalg.norm(CAMERA.unproject(wall), axis=2).astype(np.float32)
    np.save(tmp_path / "a.npy", distances)
    options = simplify.DepthOptions(
        50, method=method, intrinsics="130,130,79.5,59.5", ray_depth=True
    )
    result = simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert result.depth.startswith("depth 2.00 to 2.00 m, unit m")
    assert result.depth.endswith("converted from distances along the lines of sight")
    for vertices in (
        io.read_mesh(tmp_path / "a.ply").vertices,
        simplify.simplify_depth(distances, CAMERA, options).vertices,
    ):
        np.testing.assert_allclose(np.asarray(vertices)[:, 2], 2.0, rtol=3e-7)
    bowl = simplify.simplify_depth(distances, CAMERA, replace(options, ray_depth=False))
    assert np.ptp(np.asarray(bowl.vertices)[:, 2]) > 0.3


def test_the_camera_of_an_image_is_read_once(tmp_path: Path) -> None:
    """A warning about a camera file appears once, also if the file states the unit."""
    np.save(tmp_path / "a.npy", waves())
    camera = tmp_path / "camera.json"
    camera.write_text(
        '{"fx": 130, "fy": 130, "cx": 79.5, "cy": 59.5, "depth_scale": 0.001, "owner": "Ada"}'
    )
    options = simplify.DepthOptions(50, intrinsics=str(camera), ray_depth=True)
    with pytest.warns(UserWarning, match="left out: 'owner'") as caught:
        simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert len(caught) == 1


def test_views_in_distances_along_the_rays_are_flat(tmp_path: Path) -> None:
    wall = np.full((120, 160), 2.0, np.float32)
    distances = np.linalg.norm(CAMERA.unproject(wall), axis=2).astype(np.float32)
    for name in ("a.npy", "b.npy"):
        np.save(tmp_path / name, distances)
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n0.1 0 0 0 0 0 1\n")
    options = simplify.DepthOptions(50, intrinsics="130,130,79.5,59.5", ray_depth=True)
    files = [tmp_path / "a.npy", tmp_path / "b.npy"]
    simplify.simplify_camera_files(files, tmp_path / "poses.txt", tmp_path / "a.ply", options)
    vertices = np.asarray(io.read_mesh(tmp_path / "a.ply").vertices)
    np.testing.assert_allclose(vertices[:, 2], 2.0, rtol=3e-7)


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_a_picture_that_is_cut_off_is_named(tmp_path: Path, name: str) -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    image.fromarray(pixels).save(tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(FormatError, match="expected a colour image") as caught:
        read_color(tmp_path / name)
    assert caught.value.file == str(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        read_color(tmp_path / "missing.png")
