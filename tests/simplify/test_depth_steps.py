"""Faces across depth steps, and depth images from file to file."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from manip3d import InputError, Intrinsics, read_mesh, simplify
from manip3d.simplify import (
    DepthOptions,
    common_depth_unit,
    cut_depth_steps,
    dense_mesh,
    simplify_depth_file,
)
from manip3d.simplify._depth_steps import StepRule

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def wall_with_box() -> np.ndarray:
    """A wall at 3 m, a box at 2 m before it in columns 20 to 39."""
    depth = np.full((48, 64), 3000, np.uint16)
    depth[10:40, 20:40] = 2000
    return depth


def crosses(faces: np.ndarray, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Oracle: walk each edge pixel by pixel, compare neighbours, and the ends."""
    bad = np.zeros(len(faces), bool)
    for number, face in enumerate(faces):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            p, q = pixels[face[a]].astype(int), pixels[face[b]].astype(int)
            n = max(abs(q - p).max(), 1)
            values = []
            for k in range(n + 1):
                u, v = (p[i] + int(np.floor(k * (q[i] - p[i]) / n + 0.5)) for i in (0, 1))
                if depth[v, u] > 0:
                    values.append(float(depth[v, u]))
            jumps = any(abs(x - y) > 0.05 * min(x, y) for x, y in pairwise(values))
            first, last = values[0], values[-1]
            bad[number] |= jumps and abs(first - last) > 0.05 * min(first, last)
    return bad


@pytest.mark.parametrize("method", ["cs3", "relief", "uniform", "poisson", "ssa"])
def test_no_face_is_left_across_a_step_and_no_other_is_lost(method: str) -> None:
    depth = wall_with_box()
    depth[0, 5] = depth[30:33, 25:30] = 0  # holes
    options = DepthOptions(300, method=method, depth_step=0.0)
    uncut = simplify.simplify_depth(depth, CAMERA, options)
    cut = cut_depth_steps(uncut, depth)
    expected = ~crosses(uncut.faces, uncut.pixels, depth)
    np.testing.assert_array_equal(cut.faces, uncut.faces[expected])
    assert 0 < cut.num_faces <= uncut.num_faces
    if method not in ("relief", "ssa"):  # which make none themselves in this image
        assert expected.sum() < len(expected)
    assert cut.num_vertices == uncut.num_vertices
    assert type(cut) is type(uncut)
    same = simplify.simplify_depth(depth, CAMERA, DepthOptions(300, method=method))
    if method == "relief":  # steps were boundaries from the start
        assert not crosses(same.faces, same.pixels, depth).any()
        assert same.coverage >= cut.coverage
    else:
        np.testing.assert_array_equal(same.faces, cut.faces)


def test_one_noisy_pixel_before_an_edge_is_no_step() -> None:
    depth = np.full((5, 7), 3000, np.uint16)
    depth[2, 3] = 1500
    corners = np.int32([[0, 2], [6, 2], [3, 4], [3, 2]])
    mesh = dataclasses.replace(
        dense_mesh(depth, Intrinsics(7, 5, 6.0, 6.0, 3.0, 2.0)),
        pixels=corners,
        vertices=np.zeros((4, 3), np.float32),
        texcoords=np.zeros((4, 2), np.float32),
        faces=np.int32([[0, 1, 2], [0, 3, 2]]),  # before it, and with it as a corner
    )
    assert cut_depth_steps(mesh, depth).faces.tolist() == [[0, 1, 2]]


def test_slopes_are_no_steps() -> None:
    v, u = np.mgrid[:48, :64]
    floor = (1000 + 40 * v + 0 * u).astype(np.uint16)  # 4 % of the depth from row to row, at most
    mesh = dense_mesh(floor, CAMERA)
    assert cut_depth_steps(mesh, floor).num_faces == mesh.num_faces
    assert cut_depth_steps(mesh, floor, step=0.01).num_faces == 0


@pytest.mark.parametrize(("metres", "dtype"), [(1.0, np.float32), (1e-3, np.uint16)])
@pytest.mark.parametrize(
    ("focal", "depth", "limit"),
    [
        (0.0, 4.0, 0.2),  # five hundredths of the depth
        (525.0, 4.0, 0.2),  # tan 78 degrees / 525 and the noise: 0.104 m
        (60.0, 1.0, 0.08268),  # tan 78 degrees / 60, and 3 * 1.425e-3
        (60.0, 4.0, 0.38204),  # the noise grows with the square of the depth
        (60.0, 0.5, 0.04027),
    ],
)
def test_the_step_of_a_depth(
    metres: float, dtype: type, focal: float, depth: float, limit: float
) -> None:
    rule = StepRule.of(0.05, focal, metres)
    nearer = np.float32([depth, depth, 0]) / np.float32(metres)
    farther = np.float32([depth + 0.99 * limit, depth + 1.01 * limit, depth]) / np.float32(metres)
    assert rule.differ(nearer, farther).tolist() == [False, True, False]
    # The mesh of two columns of pixels, one at each depth, is cut by the same rule.
    camera = Intrinsics(2, 2, focal or 1.0, focal or 1.0, 0.5, 0.5)
    for share, faces in ((0.99, 2), (1.01, 0)):
        image = np.tile([depth, depth + share * limit], (2, 1)) / metres
        image = np.rint(image).astype(dtype) if dtype is np.uint16 else image.astype(dtype)
        cut = cut_depth_steps(
            dense_mesh(image, camera), image, intrinsics=camera if focal else None
        )
        assert cut.num_faces == faces


def test_what_is_refused() -> None:
    mesh = dense_mesh(wall_with_box(), CAMERA)
    with pytest.raises(InputError, match="step: expected > 0"):
        cut_depth_steps(mesh, wall_with_box(), step=0.0)
    with pytest.raises(InputError, match="depth: expected the image of the mesh"):
        cut_depth_steps(mesh, np.zeros((4, 4), np.uint16))
    with pytest.raises(InputError, match="method: expected 'relief'"):
        DepthOptions(10, method="magic")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="depth_step"):
        DepthOptions(10, depth_step=-1.0)


def options(**more: object) -> DepthOptions:
    return DepthOptions(200, intrinsics="60,60,31.5,23.5", **more)  # type: ignore[arg-type]


def test_a_folder_has_one_unit(tmp_path: Path) -> None:
    """Frames nearer than 0.8 m alone look like millimetres; the others of the folder tell."""
    for number, metres in enumerate((2.0, 2.0, 0.6)):
        image = (wall_with_box().astype(np.float64) / 2 * metres * 5).astype(np.uint16)
        np.save(tmp_path / f"{number}.npy", image)
    frames = sorted(tmp_path.glob("*.npy"))
    assert common_depth_unit(frames[2:]) == "mm"
    assert common_depth_unit(frames) == "tum"
    assert common_depth_unit(frames, "m") == "m"
    assert common_depth_unit(frames, "guess", "tum") == "guess"  # the camera knows
    for frame, metres in zip(frames, (2.0, 2.0, 0.6), strict=True):
        output = tmp_path / f"{frame.stem}.glb"
        simplify_depth_file(frame, output, options(unit=common_depth_unit(frames)))
        assert -read_mesh(output).vertices[:, 2].max() == pytest.approx(metres, rel=1e-3)


def test_a_camera_that_knows_its_unit_is_believed_and_doubts_are_said(tmp_path: Path) -> None:
    depth = np.full((480, 640), 2000, np.uint16)
    np.save(tmp_path / "depth.npy", depth)
    asked = DepthOptions(50, intrinsics="tum")
    result = simplify.simplify_depth_file(tmp_path / "depth.npy", tmp_path / "x.ply", asked)
    assert result.unit == "tum"
    assert "0.40 to 0.40 m" in result.depth
    assert "the numbers look like mm" in result.depth
    given = DepthOptions(50, intrinsics="tum", unit="mm")
    result = simplify.simplify_depth_file(tmp_path / "depth.npy", tmp_path / "y.ply", given)
    assert result.depth.startswith("depth 2.00 to 2.00 m, unit mm")
    np.save(tmp_path / "depth.npy", depth.astype(np.float32) / 1000)
    result = simplify.simplify_depth_file(tmp_path / "depth.npy", tmp_path / "z.ply", asked)
    assert result.unit == "m"  # fractions are metres, whatever the camera


@pytest.mark.parametrize(("corner", "named"), [(4, "faces: .* 4"), (-1, "faces: .* -1")])
def test_a_face_of_vertices_that_are_not_there_is_refused(corner: int, named: str) -> None:
    mesh = dense_mesh(wall_with_box()[:2, :2].copy(), Intrinsics(2, 2, 60.0, 60.0, 0.5, 0.5))
    faces = np.array([[0, 1, 2], [0, 1, corner]], np.int32)
    with pytest.raises(InputError, match=named):
        cut_depth_steps(mesh.with_faces(faces), wall_with_box()[:2, :2])


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb"])
@pytest.mark.parametrize("method", ["relief", "cs3", "uniform", "poisson", "ssa"])
def test_a_file_has_no_points_that_no_face_uses(
    method: simplify.DepthMethod, suffix: str, tmp_path: Path
) -> None:
    depth = wall_with_box()
    depth[np.random.default_rng(0).random(depth.shape) < 0.3] = 0
    np.save(tmp_path / "d.npy", depth)
    asked = options(method=method, unit="mm")
    found = simplify_depth_file(tmp_path / "d.npy", tmp_path / f"o{suffix}", asked)
    mesh = read_mesh(tmp_path / f"o{suffix}")
    assert len(np.unique(mesh.faces)) == mesh.num_vertices == found.points <= 200
    assert mesh.num_faces == found.faces


@pytest.mark.parametrize("method", ["cs3", "relief", "uniform"])
def test_a_depth_image_has_one_of_two_types_in_either_byte_order(method: str) -> None:
    """Millimetres of another type were metres, in which no step was cut."""
    depth = wall_with_box()
    uncut = simplify.simplify_depth(depth, CAMERA, DepthOptions(300, method=method, depth_step=0))
    cut = cut_depth_steps(uncut, depth)
    assert cut.num_faces < uncut.num_faces
    np.testing.assert_array_equal(cut_depth_steps(uncut, depth.astype(">u2")).faces, cut.faces)
    wrong = [depth.astype(kind) for kind in (np.int16, np.int32, np.int64, np.float64)]
    for image in (*wrong, depth.tolist()):
        with pytest.raises(InputError, match="depth: expected dtype uint16"):
            cut_depth_steps(uncut, image)
