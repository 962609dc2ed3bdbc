"""Range-image error, flicker and boundary noise: closed forms, Open3D's ray casting, real scans."""

from __future__ import annotations

import time

import numpy as np
import pytest

from manip3d import InputError, Intrinsics, Mesh, datasets, metrics
from manip3d.simplify import DepthMesh, dense_mesh, dense_mesh_grid
from manip3d.simulate import depth as simulated
from real_data import RealData

CAMERA = Intrinsics(64, 48, 60.0, 55.0, 30.7, 24.2)


def rays(camera: Intrinsics = CAMERA) -> np.ndarray:
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], 2)


def plane(a: float, b: float, d: float, size: float = 20.0) -> Mesh:
    """Two triangles of the plane z = a x + b y + d."""
    xy = np.array([[-size, -size], [size, -size], [size, size], [-size, size]])
    return Mesh(np.c_[xy, xy @ [a, b] + d], [[0, 1, 2], [0, 2, 3]])


def fitting_plane(a: float, b: float, d: float) -> Mesh:
    """A part of the plane that lies before the camera."""
    return plane(a, b, d, size=0.9 * d / (abs(a) + abs(b) + 1e-9) if a or b else 20.0)


def test_a_slanted_plane_has_its_depth_and_not_one_interpolated_in_the_image() -> None:
    a, b, d = 0.5, -0.2, 2.0
    depth = metrics.render_depth(fitting_plane(a, b, d), CAMERA)
    r = rays()
    exact = d / (1.0 - a * r[..., 0] - b * r[..., 1])
    hit = np.isfinite(depth)
    assert hit.mean() > 0.9
    np.testing.assert_allclose(depth[hit], exact[hit], rtol=1e-6)


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        Intrinsics(64, 48, 60.0, -55.0, 30.7, 24.2),
        Intrinsics(64, 48, 60.0, 55.0, 30.7, 24.2, mirrored=True),
        Intrinsics(64, 48, 60.0, 55.0, 30.7, 24.2, distortion=(-0.2, 0.05, 0.001, -0.002, 0.0)),
        Intrinsics(64, 48, 40.0, 40.0, 30.7, 24.2, distortion=(-0.28, 0.07, 0.0, 0.0, 0.0)),
    ],
    ids=["pinhole", "rows up", "mirrored", "distorted", "wide"],
)
def test_triangles_at_random_are_hit_where_open3d_hits_them(camera: Intrinsics) -> None:
    o3d = pytest.importorskip("open3d")
    random = np.random.default_rng(4)
    centers = random.uniform([-1.5, -1.5, 0.5], [1.5, 1.5, 4.0], (150, 1, 3))
    vertices = (centers + random.normal(0, 0.3, (150, 3, 3))).reshape(-1, 3)  # some behind
    mesh = Mesh(vertices, np.arange(450).reshape(-1, 3))
    depth = metrics.render_depth(mesh, camera, threads=1)

    ones = np.ones((48, 64), np.float32)
    points = dense_mesh(ones, camera).vertices  # the lens model is the camera's own
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)),
        o3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    lines = np.c_[np.zeros_like(points), points].astype(np.float32)
    expected = scene.cast_rays(o3d.core.Tensor(lines))["t_hit"].numpy().reshape(48, 64)
    hit = np.isfinite(expected)
    assert 0.3 < hit.mean() < 0.95
    assert (np.isfinite(depth) != hit).mean() < 2e-3  # lines that touch a border
    both = np.isfinite(depth) & hit
    assert (np.abs(depth - expected)[both] > 1e-4).mean() < 2e-3
    np.testing.assert_array_equal(depth, metrics.render_depth(mesh, camera, threads=2))


WIDE = Intrinsics(160, 120, 62.5, 62.5, 80.0, 60.0, distortion=(-0.31, 0.1, 0.0, 0.0, -0.012))


def test_pixels_without_a_line_of_sight_count_as_not_covered() -> None:
    depth = np.full((120, 160), 2.0, np.float32)
    depth[:10] = 0.0
    seen = np.isfinite(WIDE.unproject(depth)).all(axis=2)
    error = metrics.range_image_error(depth, WIDE, dense_mesh(depth, WIDE))
    assert error.valid == 110 * 160 > 1.1 * seen.sum()
    assert error.coverage == seen.sum() / error.valid


def test_a_distorted_lens_takes_hardly_more_time_than_a_pinhole() -> None:
    """All pixels up to the largest shift of the image from a triangle were tried: 160 times."""
    depth = np.full((120, 160), 2.0, np.float32)

    def seconds(camera: Intrinsics) -> float:
        mesh, times = dense_mesh(depth, camera), []
        for _ in range(3):
            started = time.perf_counter()
            metrics.range_image_error(depth, camera, mesh, threads=1)
            times.append(time.perf_counter() - started)
        return min(times)

    pinhole = Intrinsics(160, 120, 62.5, 62.5, 80.0, 60.0)
    assert seconds(WIDE) < 30.0 * seconds(pinhole)


def test_the_error_of_a_shifted_mesh_is_its_shift() -> None:
    depth = np.full((48, 64), 2000, np.uint16)
    depth[:8] = 0
    mesh = plane(0.0, 0.0, 2.005)
    error = metrics.range_image_error(depth, CAMERA, mesh)
    assert error.mean_square_mm2 == pytest.approx(25.0, rel=1e-4)
    assert error.mean_absolute == pytest.approx(5e-3, rel=1e-4)
    x, y = 2.0 * 63 / 60.0, 2.0 * 39 / 55.0
    assert error.diagonal == pytest.approx(np.hypot(x, y), rel=1e-6)
    assert error.mse == pytest.approx(25e-6 / (x**2 + y**2), rel=1e-4)
    assert (error.coverage, error.compared, error.valid) == (1.0, 40 * 64, 40 * 64)


def test_holes_lower_the_coverage_and_are_no_error() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    dense = dense_mesh(depth, CAMERA)
    left = (dense.pixels[:, 0] < 32)[dense.faces].all(axis=1)
    error = metrics.range_image_error(depth, CAMERA, Mesh(dense.vertices, dense.faces[left]))
    assert error.coverage == 0.5
    assert error.mean_square == pytest.approx(0.0, abs=1e-14)
    assert error.max == pytest.approx(0.0, abs=1e-6)


def test_the_nearest_of_several_surfaces_is_seen() -> None:
    far, near = plane(0, 0, 3.0), plane(0, 0, 1.5, size=0.2)
    both = Mesh(np.r_[far.vertices, near.vertices], np.r_[far.faces, near.faces + 4])
    depth = metrics.render_depth(both, CAMERA)
    assert depth[24, 31] == pytest.approx(1.5)
    assert depth[0, 0] == pytest.approx(3.0)


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_the_nearest_surface_is_seen_in_a_grid_with_columns_from_the_right(
    is_mirrored: bool,
) -> None:
    """Such a grid is left-handed: the sensor is where the lines of sight meet."""
    depth = 2.0 + 0.2 * np.sin(np.arange(64) / 9.0) * np.cos(np.arange(48) / 7.0)[:, None]
    points = rays() * depth[..., None]
    if is_mirrored:
        points = points[:, ::-1].copy()
    dense = dense_mesh_grid(points, rows_up=False)
    behind = dense.vertices * 1.3
    both = Mesh(np.r_[dense.vertices, behind], np.r_[dense.faces, dense.faces + len(behind)])
    error = metrics.range_image_error_grid(points, None, both, rows_up=False)
    assert error.coverage == 1.0
    assert error.max < 1e-4


def test_a_mesh_that_nothing_sees_compares_nothing() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    error = metrics.range_image_error(depth, CAMERA, plane(0, 0, -2.0))
    assert error.coverage == 0.0
    assert np.isnan([error.mse, error.mean_absolute, error.max]).all()


def pushbroom(noise: float = 0.0) -> np.ndarray:
    """A laser stripe scan: parallel planes along x, a camera's lines in each."""
    v, u = np.mgrid[:60, :80].astype(float)
    x = 0.002 * u
    z = 1.0 + 0.1 * np.sin(0.1 * u) * np.cos(0.08 * v)
    y = z * (v - 30.0) / 50.0
    random = np.random.default_rng(0)
    return np.stack([x, y, z], axis=-1) + noise * random.standard_normal((60, 80, 3))


def test_a_scanner_on_a_stage_is_no_pinhole_and_is_recognised() -> None:
    points = pushbroom()
    dense = dense_mesh_grid(points)
    error = metrics.range_image_error_grid(points, None, dense)
    assert error.coverage == 1.0
    assert error.max < 1e-6
    # Pushed 1 mm away from the sensor, as its lines of sight run (here: mostly z).
    moved = Mesh(dense.vertices + np.array([0.0, 0.0, 1e-3]), dense.faces)
    error = metrics.range_image_error_grid(points, None, moved)
    assert error.mean_absolute == pytest.approx(1e-3, rel=0.05)
    assert error.coverage > 0.95


def test_a_sheared_grid_of_parallel_lines_sees_the_shift_along_them() -> None:
    """Depth is measured along the lines of sight, not along z."""
    v, u = np.mgrid[:40, :50].astype(float)
    height = 0.3 * np.sin(0.2 * u) * np.cos(0.3 * v)
    points = np.stack([0.1 * u + 0.5 * height, 0.1 * v, height], axis=-1)
    dense = dense_mesh_grid(points)
    direction = np.array([0.5, 0.0, 1.0]) / np.hypot(0.5, 1.0)
    moved = Mesh(dense.vertices + 0.01 * direction, dense.faces)
    error = metrics.range_image_error_grid(points, None, moved)
    assert error.mean_absolute == pytest.approx(0.01, rel=1e-3)


def test_grids_that_fix_no_lines_of_sight_are_refused() -> None:
    v, u = np.mgrid[:20, :30].astype(float)
    flat = np.stack([u, v, 0.5 * u], axis=-1)
    mesh = dense_mesh_grid(flat)
    with pytest.raises(InputError, match="fixes its lines of sight, got a plane"):
        metrics.range_image_error_grid(flat, None, mesh)
    random = np.random.default_rng(0).standard_normal((20, 30, 3))
    with pytest.raises(InputError, match="off their pixels"):
        metrics.range_image_error_grid(random, None, mesh)
    few = np.full((20, 30, 3), np.nan)
    few[:3, :3] = random[:3, :3]
    with pytest.raises(InputError, match="at least 16 valid points, got 9"):
        metrics.range_image_error_grid(few, None, mesh)


def test_arguments_are_checked() -> None:
    mesh = plane(0, 0, 2.0)
    with pytest.raises(InputError, match="depth: expected shape"):
        metrics.range_image_error(np.zeros((3, 3), np.uint16), CAMERA, mesh)
    with pytest.raises(InputError, match="at least one valid pixel"):
        metrics.range_image_error(np.zeros((48, 64), np.uint16), CAMERA, mesh)
    with pytest.raises(InputError, match="frames: expected at least two"):
        metrics.flicker([mesh], CAMERA)
    with pytest.raises(InputError, match="frames: expected at least two"):
        metrics.flicker([mesh, plane(0, 0, -2.0)], CAMERA)


def test_an_empty_mesh_covers_nothing() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    error = metrics.range_image_error(depth, CAMERA, Mesh(np.empty((0, 3)), np.empty((0, 3))))
    assert error.coverage == 0.0


def test_flicker_is_the_standard_deviation_over_time() -> None:
    depths = [2.0, 2.01, 2.03, 2.0]
    frames = [plane(0, 0, z) for z in depths]
    result = metrics.flicker(iter(frames), CAMERA)
    assert result.mean_std_mm == pytest.approx(1000 * np.std(depths), rel=1e-9)
    steps = np.sqrt(np.mean(np.diff(depths) ** 2) / 2)
    assert result.mean_step_mm == pytest.approx(1000 * steps, rel=1e-9)
    assert (result.unstable, result.changed, result.frames) == (0.0, None, 4)


def test_flicker_looks_at_the_pixels_it_is_given() -> None:
    still = np.full((48, 64), 2.0, np.float32)
    moving = still.copy()
    moving[:, 40:] = 2.2
    frames = [dense_mesh(image, CAMERA) for image in (still, moving, still)]
    left = np.zeros((48, 64), bool)
    left[:, :38] = True
    assert metrics.flicker(frames, CAMERA).mean_std_mm > 10
    assert metrics.flicker(frames, CAMERA, within=left).mean_std_mm == pytest.approx(0, abs=1e-9)
    with pytest.raises(InputError, match="within: expected bool"):
        metrics.flicker(frames, CAMERA, within=left.T)


def test_flicker_counts_what_comes_and_goes() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    less = depth.copy()
    less[:, 60:] = 0
    frames = [dense_mesh(image, CAMERA) for image in (depth, less, depth)]
    result = metrics.flicker(frames, CAMERA)
    assert result.unstable == 4 / 64
    assert result.mean_std_mm == pytest.approx(0.0, abs=1e-9)
    assert result.changed == pytest.approx((0 + 4 / 64) / 2)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_meshes_of_another_camera_are_refused(factor: float) -> None:
    """Pixels of a larger image have no place; those of a smaller one are others here."""
    width, height = round(64 * factor), round(48 * factor)
    other = CAMERA.resized(width, height)
    mesh = dense_mesh(np.full((height, width), 2000, np.uint16), other)
    with pytest.raises(InputError, match=r"frames\[0\]: expected a mesh of this camera"):
        metrics.flicker([mesh, mesh], CAMERA)
    depth, flags = np.full((48, 64), 2000, np.uint16), np.ones((48, 64), bool)
    with pytest.raises(InputError, match="mesh: expected a mesh of this camera"):
        metrics.boundary_noise(depth, CAMERA, mesh, flying=flags, truth=np.ones((48, 64)))


def test_boundary_noise_needs_a_measured_pixel() -> None:
    flags, truth = np.ones((48, 64), bool), np.ones((48, 64))
    mesh = dense_mesh(np.full((48, 64), 2000, np.uint16), CAMERA)
    with pytest.raises(InputError, match="depth: expected at least one measured pixel"):
        metrics.boundary_noise(
            np.zeros((48, 64), np.uint16), CAMERA, mesh, flying=flags, truth=truth
        )


def test_boundary_noise_of_a_dense_mesh_and_of_the_truth() -> None:
    scene = simulated.person(width=160, height=120, wall=True)
    capture = scene.capture(noise=0.0, dropouts=0.0, rng=3)
    camera, depth = scene.intrinsics, capture.depth
    truth = {"flying": capture.flying, "truth": scene.depth}
    noisy = metrics.boundary_noise(depth, camera, dense_mesh(depth, camera), **truth)
    assert noisy.survived > 0.9  # some float within 3 cm of a surface
    assert (noisy.chosen, noisy.density) == (1.0, 1.0)
    clean = dense_mesh(scene.depth.astype(np.float32), camera)
    assert metrics.boundary_noise(depth, camera, clean, **truth).survived == 0.0
    nothing = Mesh(np.empty((0, 3)), np.empty((0, 3)))
    gone = metrics.boundary_noise(depth, camera, nothing, **truth)
    assert (gone.survived, gone.chosen) == (0.0, None)
    with pytest.raises(InputError, match="at least one flying pixel"):
        metrics.boundary_noise(
            depth, camera, clean, flying=np.zeros_like(capture.flying), truth=scene.depth
        )
    for dtype in (np.uint8, np.int64):  # which would be numbers of rows
        flags = capture.flying.astype(dtype)
        with pytest.raises(InputError, match="flying: expected bool"):
            metrics.boundary_noise(depth, camera, clean, flying=flags, truth=scene.depth)


@pytest.mark.parametrize("name", ["bun000", "happyStandRight_0", "dragonStandRight_0"])
def test_scans_see_their_own_dense_mesh(realdata: RealData, name: str) -> None:
    """Each pixel is a vertex of it; 32-bit points are off their places by 1e-7 of their size."""
    realdata.needs(name)
    scan = datasets.load_scan(name)
    dense = dense_mesh_grid(scan.points, scan.valid)
    error = metrics.range_image_error_grid(scan.points, scan.valid, dense)
    assert error.coverage > 0.995  # where pixels have no neighbour there is no triangle
    assert np.sqrt(error.mse) < 1e-4
    moved = Mesh(dense.vertices + np.array([0.0, 0.0, 1e-4]), dense.faces)
    shift = metrics.range_image_error_grid(scan.points, scan.valid, moved)
    assert shift.mean_absolute == pytest.approx(1e-4, rel=0.15)
    assert isinstance(dense, DepthMesh)
