"""Cameras, dense meshes of depth images and range scans."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d
from manip3d import InputError, Intrinsics, Registration, simplify
from manip3d.io import read_mesh_bytes, read_range_grid
from real_data import RealData

RNG = np.random.default_rng(3)
CAMERA = Intrinsics(8, 6, 10.0, 11.0, 3.5, 2.5)


def facing(mesh: simplify.DepthMesh) -> NDArray[np.float64]:
    """For each triangle the normal times the direction from the camera to it; < 0 = looks at it."""
    p, q, r = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return np.einsum("ij,ij->i", np.cross(q - p, r - p), p)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, r"intrinsics\.width: expected 1 to 16384"),
        ({"height": 16385}, r"intrinsics\.height: expected 1 to 16384"),
        ({"width": 2.5}, r"intrinsics\.width: expected a whole number, got 2\.5"),
        ({"fx": -1.0}, r"intrinsics\.fx: expected a finite number > 0"),
        ({"fx": np.nan}, r"intrinsics\.fx"),
        ({"fy": 0.0}, r"intrinsics\.fy: expected a finite number other than 0"),
        ({"cx": np.inf}, r"intrinsics\.cx"),
        ({"cy": "middle"}, r"intrinsics\.cy: expected a number, got 'middle'"),
        ({"distortion": (0.1, 0.0)}, r"expected five numbers \(k1, k2, p1, p2, k3\), got 2"),
        ({"distortion": (0.0, 0.0, np.nan, 0.0, 0.0)}, r"intrinsics\.distortion"),
        ({"rays": np.zeros((8, 6, 2))}, r"intrinsics\.rays: expected shape \(6, 8, 2\)"),
        ({"rays": np.zeros((6, 8, 2)), "mirrored": True}, "a ray table says all"),
    ],
)
def test_bad_intrinsics(change: dict[str, object], message: str) -> None:
    fields = {"width": 8, "height": 6, "fx": 10.0, "fy": 11.0, "cx": 3.5, "cy": 2.5}
    with pytest.raises(InputError, match=message):
        Intrinsics(**{**fields, **change})


def test_bad_registration() -> None:
    with pytest.raises(InputError, match=r"registration\.rotation: expected a rotation"):
        Registration(CAMERA, 2 * np.eye(3))
    with pytest.raises(InputError, match=r"registration\.rotation: expected a rotation"):
        Registration(CAMERA, np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(InputError, match=r"registration\.translation"):
        Registration(CAMERA, np.eye(3), np.array([0.0, np.nan, 0.0]))
    with pytest.raises(InputError, match=r"registration\.color: expected Intrinsics"):
        Registration(None)  # type: ignore[arg-type]
    rays = Intrinsics(2, 2, 1.0, 1.0, 0.0, 0.0, rays=np.zeros((2, 2, 2), np.float32))
    with pytest.raises(InputError, match=r"registration\.color: expected a lens model"):
        Registration(rays)


def test_pixels_are_lifted_along_their_rays() -> None:
    depth = RNG.uniform(1.0, 3.0, (6, 8)).astype(np.float32)
    mesh = simplify.dense_mesh(depth, CAMERA)
    u, v = mesh.pixels.T
    z = depth[v, u]
    expected = np.column_stack([(u - 3.5) / 10 * z, (v - 2.5) / 11 * z, z])
    np.testing.assert_allclose(mesh.vertices, expected, rtol=1e-6)
    assert mesh.vertices.dtype == np.float32
    np.testing.assert_array_equal(
        mesh.texcoords, np.column_stack([(u + 0.5) / 8, 1 - (v + 0.5) / 6]).astype(np.float32)
    )
    assert (facing(mesh) < 0).all()


def test_millimetres_become_the_nearest_metres() -> None:
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    camera = Intrinsics(256, 256, 200.0, 200.0, 127.5, 127.5)
    mesh = simplify.dense_mesh(every, camera)
    assert mesh.num_vertices == 65535  # 0 = no measurement
    np.testing.assert_array_equal(
        mesh.vertices[:, 2], (np.arange(1, 65536) / 1000).astype(np.float32)
    )


@pytest.mark.parametrize(("fy", "mirrored"), [(-11.0, False), (11.0, True), (-11.0, True)])
def test_front_faces_look_at_the_camera(fy: float, mirrored: bool) -> None:
    camera = Intrinsics(8, 6, 10.0, fy, 3.5, 2.5, mirrored=mirrored)
    mesh = simplify.dense_mesh(np.full((6, 8), 2.0, np.float32), camera)
    assert (facing(mesh) < 0).all()
    assert (
        np.sign(mesh.vertices[:, 0]) == np.sign(mesh.pixels[:, 0] - 3.5) * (-1) ** mirrored
    ).all()
    assert (np.sign(mesh.vertices[:, 1]) == np.sign(mesh.pixels[:, 1] - 2.5) * np.sign(fy)).all()


def test_distorted_pixels_project_back_to_themselves() -> None:
    """The lens model is inverted for depth and used forward for colour: they must agree."""
    lens = {"distortion": (-0.2, 0.05, 0.001, -0.002, 0.01)}
    for mirrored in (False, True):
        camera = Intrinsics(64, 48, 60.0, 55.0, 30.2, 24.9, mirrored=mirrored, **lens)
        depth = RNG.uniform(0.5, 4.0, (48, 64)).astype(np.float32)
        mesh = simplify.dense_mesh(depth, camera, registration=Registration(camera))
        pixels = np.column_stack(
            [mesh.texcoords[:, 0] * 64 - 0.5, (1 - mesh.texcoords[:, 1]) * 48 - 0.5]
        )
        np.testing.assert_allclose(pixels, mesh.pixels, atol=2e-4)
        straight = (mesh.pixels[:, 0] - 30.2) / 60 * mesh.vertices[:, 2] * (-1) ** mirrored
        assert np.abs(mesh.vertices[:, 0] - straight).max() > 0.02


def test_a_lens_that_cannot_be_inverted_leaves_pixels_out() -> None:
    camera = Intrinsics(9, 1, 2.0, 2.0, 4.0, 0.0, distortion=(-0.4, 0.0, 0.0, 0.0, 0.0))
    mesh = simplify.dense_mesh(np.ones((1, 9), np.float32), camera)
    assert mesh.pixels[:, 0].tolist() == [3, 4, 5]  # r - 0.4 r^3 is at most 0.61


def test_ray_table() -> None:
    v, u = np.mgrid[0.0:6, 0:8]
    rays = np.stack([(u - 3.5) / 10, -(v - 2.5) / 11], axis=-1).astype(np.float32)
    rays[0, 0] = np.nan
    table = Intrinsics(8, 6, 10.0, 11.0, 3.5, 2.5, rays=rays)
    depth = RNG.uniform(1.0, 3.0, (6, 8)).astype(np.float32)
    mesh = simplify.dense_mesh(depth, table)
    model = simplify.dense_mesh(depth, Intrinsics(8, 6, 10.0, -11.0, 3.5, 2.5))
    assert mesh.num_vertices == 47  # the pixel without a ray is no measurement
    np.testing.assert_allclose(mesh.vertices, model.vertices[1:], rtol=1e-6)
    assert (facing(mesh) < 0).all()


def test_registration_moves_texture_coordinates_only() -> None:
    depth = RNG.uniform(1.0, 3.0, (6, 8)).astype(np.float32)
    color = Intrinsics(16, 12, 20.0, 21.0, 7.5, 5.5)
    angle = 0.1
    rotation = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    registration = Registration(color, rotation, np.array([0.05, 0.0, 0.01]))
    image = np.zeros((12, 16, 3), np.uint8)
    mesh = simplify.dense_mesh(depth, CAMERA, color=image, registration=registration)
    plain = simplify.dense_mesh(depth, CAMERA)
    np.testing.assert_array_equal(mesh.vertices, plain.vertices)
    q = mesh.vertices @ rotation.T + [0.05, 0.0, 0.01]
    u, v = 20 * q[:, 0] / q[:, 2] + 7.5, 21 * q[:, 1] / q[:, 2] + 5.5
    expected = np.column_stack([(u + 0.5) / 16, 1 - (v + 0.5) / 12])
    beside = ((expected < 0) | (expected > 1)).any(axis=1)
    assert 0 < beside.sum() < 24
    np.testing.assert_array_equal(np.isnan(mesh.texcoords), np.stack([beside, beside], axis=1))
    np.testing.assert_allclose(mesh.texcoords[~beside], expected[~beside], atol=1e-6)


def test_what_the_color_camera_cannot_see_has_no_texture() -> None:
    behind = Registration(CAMERA, np.diag([-1.0, 1.0, -1.0]), np.array([0.0, 0.0, 2.0]))
    depth = np.ones((6, 8), np.float32)
    depth[:, 4:] = 3.0
    result = simplify.dense_mesh(depth, CAMERA, registration=behind)
    assert np.isnan(result.texcoords).any(axis=1).sum() == 24
    unseen = np.isnan(result.texcoords[:, 0])[result.faces].any(axis=1)
    assert 0 < unseen.sum() < result.num_faces
    corners = result.mesh.face_texcoords
    np.testing.assert_array_equal(corners, np.where(unseen[:, None], -1, result.faces))


METHODS: dict[str, Callable[..., simplify.DepthMesh | simplify.JointSimplification]] = {
    "dense": lambda depth, camera, **given: simplify.dense_mesh(depth, camera, **given),
    "relief": lambda depth, camera, **given: simplify.relief(depth, camera, 300, **given),
    "cs3": lambda depth, camera, **given: simplify.cs3(depth, camera, 300, **given),
    "uniform": lambda depth, camera, **given: simplify.sample_depth(depth, camera, 300, **given),
    "joint": lambda depth, camera, **given: simplify.relief_cameras(
        [simplify.CameraView(depth, camera, **given)], 300
    ),
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
@pytest.mark.parametrize("method", METHODS)
def test_a_picture_is_not_repeated_beside_its_border(
    method: str, suffix: str, tmp_path: Path
) -> None:
    """The colour camera sees half of the wall's width, and most of its height."""
    depth_camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    narrow = Registration(Intrinsics(50, 60, 94.0, 60.0, 24.5, 29.5))
    wall = np.full((48, 64), 2000, np.uint16)
    wall[::3, ::3] += 9
    picture = np.full((60, 50, 3), 200, np.uint8)
    found = METHODS[method](wall, depth_camera, color=picture, registration=narrow)
    mesh = found.mesh
    mesh.write(tmp_path / f"wall{suffix}")
    for each in (mesh, manip3d.read_mesh(tmp_path / f"wall{suffix}")):
        assert each.texcoords is not None
        assert each.face_texcoords is not None
        assert each.face_material is not None
        aside = np.abs(each.vertices[each.faces, 0] / each.vertices[each.faces, 2])
        bare = each.face_texcoords[:, 0] < 0
        assert (each.face_texcoords[bare] == -1).all()
        np.testing.assert_array_equal(bare, aside.max(axis=1) > 25 / 94)
        used = each.texcoords[each.face_texcoords[~bare]]
        assert used.min() >= 0
        assert used.max() <= 1
        pictured = np.array([bool(material.textures) for material in each.materials])
        np.testing.assert_array_equal(pictured[each.face_material], ~bare)


def test_color_becomes_a_texture(tmp_path: Path) -> None:
    depth = np.ones((6, 8), np.float32)
    image = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    mesh = simplify.dense_mesh(depth, CAMERA, color=image).mesh
    mesh.write(tmp_path / "m.glb")
    read = manip3d.read_mesh(tmp_path / "m.glb")
    assert read.num_faces == 70
    from PIL import Image

    data = read.materials[0].textures["base_color"].data
    assert data is not None
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), image)


def test_buffers_for_a_gpu() -> None:
    mesh = simplify.dense_mesh(np.ones((6, 8), np.float32), CAMERA)
    positions, texcoords, indices = mesh.gpu_buffers()
    assert positions is mesh.vertices
    assert texcoords.dtype == np.float32
    np.testing.assert_allclose(
        texcoords[0], [0.5 / 8, 0.5 / 6], rtol=1e-6
    )  # the upper left pixel, v down
    np.testing.assert_allclose(mesh.texcoords[0], [0.5 / 8, 1 - 0.5 / 6])
    assert indices.dtype == np.uint16
    np.testing.assert_array_equal(indices.reshape(-1, 3), mesh.faces)
    camera = Intrinsics(256, 256, 200.0, 200.0, 127.5, 127.5)
    for rows, dtype in ((255, np.uint16), (256, np.uint32)):
        depth = np.ones((256, 256), np.float32)
        depth[rows:] = 0
        large = simplify.dense_mesh(depth, camera)
        indices = large.gpu_buffers()[2]
        assert indices.dtype == dtype
        np.testing.assert_array_equal(indices.reshape(-1, 3), large.faces)


def test_cells_of_four_three_and_two() -> None:
    v, u = np.mgrid[0.0:3, 0:3]
    points = np.stack([u, v, np.zeros((3, 3))], axis=-1)
    points[0, 0] = np.nan  # upper left cell: three
    points[2, 1:] = np.nan  # lower cells: three, two
    mesh = simplify.dense_mesh_grid(points)
    assert mesh.num_vertices == 6
    assert mesh.num_faces == 1 + 2 + 1 + 0
    up = simplify.dense_mesh_grid(points).faces
    down = simplify.dense_mesh_grid(points, rows_up=False).faces
    assert {tuple(t) for t in np.sort(up, axis=1)} == {tuple(t) for t in np.sort(down, axis=1)}
    p, q, r = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    assert (np.cross(q - p, r - p)[:, 2] > 0).all()


def test_cells_are_cut_along_the_shorter_diagonal() -> None:
    points = np.array([[[0, 0, 0], [1, 0, 0]], [[0, 1, 0], [2, 2, 0]]], dtype=float)
    assert simplify.dense_mesh_grid(points).faces.tolist() == [[1, 3, 2], [1, 2, 0]]
    points[1, 1] = [0.5, 0.5, 0]
    assert simplify.dense_mesh_grid(points).faces.tolist() == [[0, 1, 3], [0, 3, 2]]


def test_long_edges_are_left_out() -> None:
    depth = np.ones((6, 8), np.float32)
    depth[:, 4:] = 2.0
    mesh = simplify.dense_mesh(depth, CAMERA, max_edge=0.5)
    assert mesh.num_vertices == 48
    assert mesh.num_faces == 70 - 10
    with pytest.raises(InputError, match="max_edge: expected > 0"):
        simplify.dense_mesh(depth, CAMERA, max_edge=0.0)
    with pytest.raises(InputError, match="max_edge: expected > 0"):
        simplify.dense_mesh(depth, CAMERA, max_edge=np.nan)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (1, 7), (7, 1)])
def test_grids_without_cells(shape: tuple[int, int]) -> None:
    mesh = simplify.dense_mesh_grid(np.ones((*shape, 3)))
    assert mesh.num_vertices == shape[0] * shape[1]
    assert mesh.num_faces == 0
    assert mesh.mesh.num_faces == 0


def test_nothing_valid() -> None:
    assert simplify.dense_mesh(np.zeros((6, 8), np.uint16), CAMERA).num_vertices == 0
    assert simplify.dense_mesh(np.full((6, 8), np.nan, np.float32), CAMERA).num_vertices == 0


def test_same_bytes_for_any_number_of_threads() -> None:
    depth = RNG.uniform(0.5, 4.0, (120, 160)).astype(np.float32)
    depth[RNG.random(depth.shape) < 0.3] = 0
    camera = Intrinsics(160, 120, 100.0, 100.0, 80.0, 60.0)
    one = simplify.dense_mesh(depth, camera)
    for threads in (2, 4):
        other = simplify.dense_mesh(depth, camera, threads=threads)
        for name in ("vertices", "faces", "pixels", "texcoords"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.ones((8, 6), np.float32), r"depth: expected shape \(6, 8\) as the intrinsics say"),
        (np.ones((6, 8)), r"depth: expected dtype uint16 \(millimetres\) or float32 \(metres\)"),
        (np.full((6, 8), -1, np.float32), r"depth: .*got -1 at row 0, column 0"),
        (np.diag(np.full(8, np.inf, np.float32))[:6], r"depth: .*got inf at row 0, column 0"),
    ],
)
def test_bad_depth(depth: NDArray[np.float32], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simplify.dense_mesh(depth, CAMERA)


def test_bad_grids_and_colors() -> None:
    points = np.ones((6, 8, 3))
    with pytest.raises(InputError, match=r"points: expected \(H, W, 3\) floats"):
        simplify.dense_mesh_grid(points[0])
    with pytest.raises(InputError, match=r"valid: expected bool of shape \(6, 8\)"):
        simplify.dense_mesh_grid(points, np.ones((8, 6), bool))
    points[2, 3, 1] = np.inf
    with pytest.raises(InputError, match=r"points: .* at row 2, column 3"):
        simplify.dense_mesh_grid(points, np.ones((6, 8), bool))
    assert simplify.dense_mesh_grid(points).num_vertices == 47
    with pytest.raises(InputError, match=r"color: expected uint8 of shape \(6, 8, 3 or 4\)"):
        simplify.dense_mesh(np.ones((6, 8), np.float32), CAMERA, color=np.zeros((6, 8, 3)))
    with pytest.raises(InputError, match="intrinsics: expected Intrinsics, got None"):
        simplify.dense_mesh(np.ones((6, 8), np.float32), None)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["dense", "relief", "cs3", "uniform"])
def test_grids_that_float32_rounds_raise_a_warning(method: str) -> None:
    y, x = np.mgrid[0:30, 0:40] * 0.02
    points = np.stack([x, -y, 2.0 + 0.3 * np.sin(4 * x)], axis=2)
    points[:3, :3] = np.nan  # no measurement
    made: dict[str, Callable[[NDArray[np.float64]], object]] = {
        "dense": simplify.dense_mesh_grid,
        "relief": lambda grid: simplify.relief_grid(grid, None, 100, effort="live"),
        "cs3": lambda grid: simplify.cs3_grid(grid, None, 100),
        "uniform": lambda grid: simplify.sample_depth_grid(grid, None, 100),
    }
    made[method](points)  # near 0: no warning
    with pytest.warns(UserWarning, match=r"points: float32 rounds .* by up to 0\.2") as warned:
        made[method](points + np.array([450_000.0, 5_400_000.0, 300.0]))
    assert [warning.filename for warning in warned] == [__file__]


def test_a_range_scan_reads_like_its_grid() -> None:
    """The reader of PLY range scans and the dense mesh of their grid make the same cells."""
    header = (
        "ply\nformat ascii 1.0\nobj_info num_cols 2\nobj_info num_rows 2\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\nelement range_grid 4\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    text = header + "0 0 0\n1 0 0\n0 1 0\n1 1.5 0\n1 0\n1 1\n1 2\n1 3\n"
    mesh = read_mesh_bytes(text.encode())
    dense = simplify.dense_mesh_grid(mesh.vertices.reshape(2, 2, 3))
    canonical = [sorted(map(tuple, np.sort(f, axis=1).tolist())) for f in (mesh.faces, dense.faces)]
    assert canonical[0] == canonical[1]


@pytest.mark.published("table 3.1")
@pytest.mark.parametrize(
    ("scan", "vertices", "faces"),
    [("bunny/bun000", 40256, 79312), ("happy_stand/happyStandRight_0", 78056, 151838)],
)
def test_dense_meshes_of_the_published_scans(
    realdata: RealData, scan: str, vertices: int, faces: int
) -> None:
    grid = read_range_grid(realdata(f"range_scans/{scan}.ply.xz"))
    mesh = simplify.dense_mesh_grid(grid.points, grid.valid)
    assert (mesh.num_vertices, mesh.num_faces) == (vertices, faces)


@pytest.mark.parametrize("far", [(0, 0), (9, 12)])
def test_faces_to_pixels_that_are_left_out_cover_nothing(far: tuple[int, int]) -> None:
    """A pixel at a million metres, at the corner or in the middle, and faces that use it."""
    depth = np.full((30, 40), 1000, np.uint16)
    camera = Intrinsics(40, 30, 40.0, 40.0, 19.5, 14.5)
    points, valid, _ = manip3d._core.unproject(depth, camera, 1)
    points = points.reshape(30, 40, 3).copy()
    points[far] *= 1e6
    mask = valid.reshape(30, 40).view(bool)
    pixels = np.array([[5, 5], [30, 5], [30, 25], far[::-1]], np.int32)

    none = np.empty((0, 2), np.int32)

    def measured(*faces: tuple[int, int, int]) -> tuple[float, ...]:
        corners = np.array(faces, np.int32)
        found = manip3d._core.depth_coverage(points, mask, pixels, corners, 0.1, np.inf, 0.0, none)
        return tuple(found)

    alone = measured((0, 1, 2))
    assert 0.2 < alone[0] < 0.3
    assert alone[1:] == (pytest.approx(0.0, abs=0.02), pytest.approx(1 / 1200), 0.0)
    assert measured((0, 1, 2), (0, 2, 3), (1, 2, 3)) == alone
