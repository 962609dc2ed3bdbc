"""Organised clouds (PCD of depth cameras) are depth images with their own camera and colours."""

import hashlib
import itertools
import warnings
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from manip3d import FormatError, InputError, io, metrics, simplify
from manip3d.camera import Intrinsics
from manip3d.simplify._organised import camera_of_cloud, camera_of_scan, find_camera
from real_data import RealData

Image = pytest.importorskip("PIL.Image", reason="the extra 'io' is not installed")

ROWS, COLS = 60, 80
CAMERA = Intrinsics(COLS, ROWS, 70.0, 72.0, 39.0, 30.5)


def points_of(depth: NDArray[np.float32], bend: float = 0.0) -> NDArray[np.float32]:
    """Lift the image to points; ``bend`` turns the rays outwards, as a lens does."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    far = 1.0 + bend * (x**2 + y**2)
    z = np.where(depth > 0, depth, np.nan)
    return np.stack([x * far * z, y * far * z, z], axis=-1).astype(np.float32)


def scene() -> NDArray[np.float32]:
    """Return a wavy wall with a box before it, and a corner without measurements."""
    v, u = np.mgrid[:ROWS, :COLS]
    depth = 2.0 + 0.05 * np.sin(u / 9.0) + 0.002 * v
    depth[20:40, 30:50] = 1.2
    depth[:10, :12] = 0.0
    return depth.astype(np.float32)


def write_pcd(
    path: Path,
    points: NDArray[Any],
    packed: NDArray[Any] | None = None,
    *,
    name: str = "rgb",
    size: Sequence[int] = (COLS, ROWS),
) -> Path:
    fields = ["x", "y", "z"] + ([name] if packed is not None else [])
    kinds = [("F", 4)] * 3
    table = points.reshape(-1, 3).astype("<f4")
    data = table.tobytes()
    if packed is not None:
        kinds.append(("F" if packed.dtype.kind == "f" else "U", 4))
        rows = np.zeros(len(table), [("p", "<f4", 3), ("c", packed.dtype)])
        rows["p"], rows["c"] = table, packed.ravel()
        data = rows.tobytes()
    header = (
        f"VERSION 0.7\nFIELDS {' '.join(fields)}\nSIZE {' '.join(str(n) for _, n in kinds)}\n"
        f"TYPE {' '.join(kind for kind, _ in kinds)}\nCOUNT {' '.join('1' for _ in kinds)}\n"
        f"WIDTH {size[0]}\nHEIGHT {size[1]}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\n"
        "DATA binary\n"
    )
    path.write_bytes(header.encode() + data)
    return path


def made(source: Path, target: Path, **options: Any) -> simplify.DepthFileResult:
    return simplify.simplify_depth_file(source, target, simplify.DepthOptions(300, **options))


def test_the_cloud_of_a_camera_gives_the_mesh_of_its_depth_image(tmp_path: Path) -> None:
    depth = scene()
    np.save(tmp_path / "depth.npy", depth)
    cloud = write_pcd(tmp_path / "cloud.pcd", points_of(depth))
    camera = f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy}"
    of_image = made(tmp_path / "depth.npy", tmp_path / "a.ply", intrinsics=camera)
    of_cloud = made(cloud, tmp_path / "b.ply")
    assert of_cloud.coverage == of_image.coverage == 1.0
    assert of_cloud.faces == pytest.approx(of_image.faces, rel=0.02)  # both are rounded
    image, same = (io.read_mesh(tmp_path / name) for name in ("a.ply", "b.ply"))
    assert metrics.metro(image, same, rng=1).mean < 1e-3
    assert "organised cloud" in of_cloud.depth
    assert of_cloud.unit == "m"


def test_no_face_joins_the_box_and_the_wall(tmp_path: Path) -> None:
    made(write_pcd(tmp_path / "cloud.pcd", points_of(scene())), tmp_path / "out.ply")
    mesh = io.read_mesh(tmp_path / "out.ply")
    near = mesh.vertices[mesh.faces, 2] < 1.6
    assert (near.all(axis=1) | ~near.any(axis=1)).all()
    assert near.all(axis=1).any()


def test_vertices_are_the_measured_points_whatever_the_lens(tmp_path: Path) -> None:
    points = points_of(scene(), bend=0.3)
    made(write_pcd(tmp_path / "cloud.pcd", points), tmp_path / "out.ply")
    vertices = io.read_mesh(tmp_path / "out.ply").vertices
    known = points.reshape(-1, 3)
    known = known[~np.isnan(known).any(axis=1)]
    nearest = np.linalg.norm(vertices[:, None] - known[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-6


@pytest.mark.parametrize("y_up", [False, True])
def test_clouds_are_upright_in_gltf(tmp_path: Path, y_up: bool) -> None:
    """Clouds with y down or up (OpenNI, Kinect) are upright: the bump is in the upper right."""
    v, u = np.mgrid[:ROWS, :COLS]
    depth = (2.0 + 0.3 * np.exp(-((u - 60) ** 2 + (v - 15) ** 2) / 100)).astype(np.float32)
    points = points_of(depth) * np.float32([1.0, -1.0 if y_up else 1.0, 1.0])
    np.save(tmp_path / "cloud.npy", points)
    for suffix in (".glb", ".ply"):
        made(tmp_path / "cloud.npy", tmp_path / f"out{suffix}")
    upright, stored = (io.read_mesh(tmp_path / f"out{suffix}") for suffix in (".glb", ".ply"))
    far = upright.vertices[np.abs(upright.vertices[:, 2]).argmax()]
    assert far[1] == pytest.approx(15.5 / 72 * 2.3, abs=0.05)  # above the middle
    assert far[2] == pytest.approx(-2.3, abs=0.05)
    assert facing(tmp_path / "out.glb") == facing(tmp_path / "out.ply") == 1.0
    # The mesh is turned, not mirrored: its volume before the camera keeps its sign.
    volumes = [np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6 for mesh in (upright, stored)]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-4)


def test_millimetres_become_metres(tmp_path: Path) -> None:
    result = made(
        write_pcd(tmp_path / "cloud.pcd", 1000.0 * points_of(scene())), tmp_path / "out.ply"
    )
    assert result.unit == "mm"
    assert "guessed" in result.depth
    assert io.read_mesh(tmp_path / "out.ply").vertices[:, 2].max() < 2.5
    given = made(tmp_path / "cloud.pcd", tmp_path / "m.ply", unit="m")
    assert given.unit == "m"
    assert io.read_mesh(tmp_path / "m.ply").vertices[:, 2].max() > 2000.0


def test_zeros_are_no_measurement(tmp_path: Path) -> None:
    points = points_of(scene())
    grid = io.read_range_grid(write_pcd(tmp_path / "nan.pcd", points))
    zeros = io.read_range_grid(write_pcd(tmp_path / "zero.pcd", np.nan_to_num(points)))
    assert np.array_equal(grid.valid, scene() > 0)
    assert np.array_equal(grid.valid, zeros.valid)
    assert np.array_equal(grid.points, zeros.points, equal_nan=True)
    assert np.array_equal(grid.points[grid.valid], points[grid.valid].astype(np.float64))


@pytest.mark.parametrize(("name", "kind"), [("rgb", "<f4"), ("rgb", "<u4"), ("rgba", "<u4")])
def test_colours_are_the_texture(tmp_path: Path, name: str, kind: str) -> None:
    v, u = np.mgrid[:ROWS, :COLS].astype(np.uint32)
    packed = (0xFF << 24 if name == "rgba" else 0) | (u << 16) | (v << 8) | 7
    cloud = write_pcd(tmp_path / "c.pcd", points_of(scene()), packed.astype("<u4").view(kind),
                      name=name)  # fmt: skip
    grid = io.read_range_grid(cloud)
    assert grid.color is not None
    assert np.array_equal(grid.color, np.stack([u, v, np.full_like(u, 7)], axis=-1))
    made(cloud, tmp_path / "out.glb")
    mesh = io.read_mesh(tmp_path / "out.glb")
    data = mesh.materials[0].textures["base_color"].data
    assert data is not None
    assert np.array_equal(np.array(Image.open(BytesIO(data)).convert("RGB")), grid.color)


def test_the_camera_is_told_by_the_points() -> None:
    valid = scene() > 0
    found = camera_of_cloud(points_of(scene()).astype(np.float64), valid)
    assert found is not None
    assert found.fx == pytest.approx(CAMERA.fx, rel=1e-5)
    assert found.fy == pytest.approx(CAMERA.fy, rel=1e-5)
    assert (found.cx, found.cy) == pytest.approx((CAMERA.cx, CAMERA.cy), abs=1e-3)


def turned_and_moved(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return points in a robot's frame, x ahead and z up, of a camera that looks down a little."""
    tilt = np.deg2rad(20.0)
    ahead = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    down = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    return points.astype(np.float64) @ (down @ ahead).T + [0.3, -0.1, 1.2]


@pytest.mark.parametrize("bend", [0.0, 0.05])
def test_the_camera_of_a_cloud_in_another_frame_is_found(tmp_path: Path, bend: float) -> None:
    points = points_of(scene(), bend)
    moved = turned_and_moved(points)
    found = find_camera(io.RangeGrid(moved, scene() > 0))
    assert found is not None
    assert found.rotation is not None
    assert found.intrinsics.fx == pytest.approx(CAMERA.fx, rel=1e-3 if bend == 0 else 0.2)
    assert np.allclose(found.centre, [0.3, -0.1, 1.2], atol=1e-3 if bend == 0 else 0.2)
    result = made(write_pcd(tmp_path / "moved.pcd", moved), tmp_path / "out.ply")
    assert "own axes" in result.depth
    mesh = io.read_mesh(tmp_path / "out.ply")
    known = moved.reshape(-1, 3)[~np.isnan(points).any(axis=2).ravel()]
    nearest = np.linalg.norm(mesh.vertices[:, None] - known[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-5
    made(write_pcd(tmp_path / "still.pcd", points), tmp_path / "still.ply")
    still = io.read_mesh(tmp_path / "still.ply")
    assert mesh.num_faces == pytest.approx(still.num_faces, rel=0.03)
    back = (mesh.vertices - found.centre) @ found.rotation.T
    near = back[mesh.faces, 2] < 1.6
    assert (near.all(axis=1) | ~near.any(axis=1)).all()  # no face joins the box and the wall


@pytest.mark.parametrize("place", [(1e3, 2e3, 1.0), (1e5, 2e5, 1.0), (5e5, 5.4e6, 300.0)])
def test_the_camera_of_a_cloud_on_a_map_is_found(
    tmp_path: Path, place: tuple[float, float, float]
) -> None:
    """The camera is found at coordinates of a map, where noise must not grow with them."""
    depth = scene() + np.random.default_rng(0).normal(0, 0.002, (ROWS, COLS)).astype(np.float32)
    local = turned_and_moved(points_of(np.where(scene() > 0, depth, 0).astype(np.float32)))
    found = find_camera(io.RangeGrid(local + place, scene() > 0))
    assert found is not None
    assert found.intrinsics.fx == pytest.approx(CAMERA.fx, rel=0.01)
    assert np.allclose(found.centre - place, [0.3, -0.1, 1.2], atol=0.01)
    assert np.nanmax(np.abs(found.depth - depth)[scene() > 0]) < 0.01
    np.save(tmp_path / "map.npy", local + place)
    made(tmp_path / "map.npy", tmp_path / "out.ply")
    vertices = io.read_mesh(tmp_path / "out.ply").vertices - place
    known = local[scene() > 0]
    assert np.linalg.norm(vertices[:, None] - known[None], axis=2).min(axis=1).max() < 1e-5


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_a_wall_in_another_frame_is_simplified(tmp_path: Path, slope: float) -> None:
    """A plane is simplified, although its points do not show where the camera was."""
    u = np.mgrid[:ROWS, :COLS][1]
    wall = points_of((2.0 / (1.0 - slope * (u - CAMERA.cx) / CAMERA.fx)).astype(np.float32))
    result = made(write_pcd(tmp_path / "wall.pcd", turned_and_moved(wall)), tmp_path / "out.ply")
    assert result.coverage > 0.99
    vertices = io.read_mesh(tmp_path / "out.ply").vertices
    normal = np.linalg.svd(vertices - vertices.mean(axis=0))[2][2]
    assert np.abs((vertices - vertices.mean(axis=0)) @ normal).max() < 1e-4


def test_millimetres_in_another_frame_become_metres(tmp_path: Path) -> None:
    moved = turned_and_moved(points_of(scene()))
    made(write_pcd(tmp_path / "m.pcd", moved), tmp_path / "m.ply")
    result = made(write_pcd(tmp_path / "mm.pcd", 1000.0 * moved), tmp_path / "mm.ply")
    assert result.unit == "mm"
    metres, same = (io.read_mesh(tmp_path / name) for name in ("m.ply", "mm.ply"))
    assert np.allclose(metres.vertices.mean(axis=0), same.vertices.mean(axis=0), atol=0.02)


def test_clouds_that_are_no_camera_s_stay_as_they_are(tmp_path: Path) -> None:
    azimuth, elevation = np.meshgrid(np.linspace(0.0, 6.2, COLS), np.linspace(-0.3, 0.3, ROWS))
    far = 5.0 + np.sin(3 * azimuth)
    turning = np.stack(
        [np.cos(azimuth) * far, np.sin(azimuth) * far, np.tan(elevation) * far], axis=-1
    )
    flipped = turned_and_moved(points_of(scene()))[:, ::-1]  # a mirror image is no camera's
    v, u = np.mgrid[:ROWS, :COLS]
    folded = np.stack([np.abs(u - 40) / 70.0, v / 72.0, 2.0 + 0.1 * np.sin(u)], axis=-1)
    for points in (turning, flipped, folded):
        valid = ~np.isnan(points).any(axis=2)
        assert find_camera(io.RangeGrid(points, valid)) is None
    result = made(write_pcd(tmp_path / "turning.pcd", turning), tmp_path / "out.ply")
    assert "not those of a camera's pixels" in result.depth
    assert result.unit == ""
    vertices = io.read_mesh(tmp_path / "out.ply").vertices
    reach = np.hypot(vertices[:, 0], vertices[:, 1])
    assert reach.min() > 3.9
    assert reach.max() < 6.1


def test_a_sequence_of_clouds_stays_still(tmp_path: Path) -> None:
    """Most vertices stay under noise, and pixels that the first cloud lacks are used later."""
    sequence = simplify.DepthSequence(simplify.DepthOptions(300))
    noise = np.random.default_rng(3)
    meshes = []
    for number in range(6):
        depth = scene() + noise.normal(0.0, 0.002, (ROWS, COLS)).astype(np.float32)
        depth[:10, :12] = 0.0 if number == 0 else 2.0
        cloud = write_pcd(tmp_path / f"{number}.pcd", points_of(depth))
        found = sequence.simplify_file(cloud, tmp_path / f"{number}.ply")
        assert found.coverage > 0.99
        meshes.append(io.read_mesh(tmp_path / f"{number}.ply").vertices)
    assert all(np.isfinite(vertices).all() for vertices in meshes)
    corner = np.array([-39.0 / 70.0 * 2.0, -30.5 / 72.0 * 2.0, 2.0])  # where nothing was measured
    assert np.linalg.norm(meshes[0] - corner, axis=1).min() > 0.2
    assert np.linalg.norm(meshes[-1] - corner, axis=1).min() < 0.05
    places = [{(round(x / z, 3), round(y / z, 3)) for x, y, z in one} for one in meshes]
    kept = [len(a & b) / len(b) for a, b in itertools.pairwise(places[1:])]
    assert np.mean(kept) > 0.8  # each cloud alone keeps a fifth


def test_a_sequence_within_a_bandwidth_stays_still(tmp_path: Path) -> None:
    """Most vertices stay, since each frame starts from the number of points of the last one."""
    allowance = 9000
    options = simplify.DepthOptions(bandwidth=30.0 * allowance, rate=30.0)
    sequence = simplify.DepthSequence(options)
    noise = np.random.default_rng(3)
    places = []
    for number in range(10):
        depth = scene() + noise.normal(0.0, 0.002, (ROWS, COLS)).astype(np.float32)
        cloud = write_pcd(tmp_path / f"{number}.pcd", points_of(depth))
        sequence.simplify_file(cloud, tmp_path / f"{number}.ply")
        assert 0.7 * allowance <= (tmp_path / f"{number}.ply").stat().st_size <= allowance
        vertices = io.read_mesh(tmp_path / f"{number}.ply").vertices
        places.append({(round(x / z, 3), round(y / z, 3)) for x, y, z in vertices})
    kept = [len(a & b) / len(b) for a, b in itertools.pairwise(places[4:])]
    assert np.mean(kept) > 0.85


def test_a_sequence_takes_no_cloud_of_another_frame(tmp_path: Path) -> None:
    mirrored = points_of(scene())[:, ::-1]
    cloud = write_pcd(tmp_path / "mirrored.pcd", mirrored)
    sequence = simplify.DepthSequence(simplify.DepthOptions(300))
    with pytest.raises(InputError, match="expected a depth camera's cloud"):
        sequence.simplify_file(cloud, tmp_path / "out.ply")
    assert not (tmp_path / "out.ply").exists()


def test_a_cloud_has_its_own_camera(tmp_path: Path) -> None:
    cloud = write_pcd(tmp_path / "cloud.pcd", points_of(scene()))
    with pytest.raises(InputError, match=r"^intrinsics: "):
        made(cloud, tmp_path / "out.ply", intrinsics="tum")
    assert not (tmp_path / "out.ply").exists()


@pytest.mark.parametrize(
    ("points", "size", "words"),
    [
        (points_of(scene()), (ROWS * COLS, 1), "organised cloud"),
        (points_of(scene())[:, :1], (1, ROWS), "organised cloud"),
        (np.full((ROWS, COLS, 3), [np.inf, 0, 1], "<f4"), (COLS, ROWS), "expected coordinates"),
    ],
)
def test_what_is_no_image_is_refused(
    tmp_path: Path, points: NDArray[np.float32], size: tuple[int, int], words: str
) -> None:
    cloud = write_pcd(tmp_path / "cloud.pcd", points, size=size)
    with pytest.raises(FormatError, match=words):
        io.read_range_grid(cloud)
    with pytest.raises(FormatError, match=words):
        made(cloud, tmp_path / "out.ply")
    assert not (tmp_path / "out.ply").exists()


def write_array(folder: Path, kind: str) -> Path:
    """Write the points of an image as users of NumPy do."""
    points = points_of(scene())
    colors = np.full((ROWS, COLS, 3), (200, 100, 50), np.uint8)
    path = folder / f"cloud.{kind.partition(' ')[0]}"
    if kind == "npy":
        np.save(path, points)
    elif kind == "npy with reflectance":
        np.save(path, np.dstack([points, np.ones((ROWS, COLS))]))
    elif kind == "npy by names":
        named = np.zeros((ROWS, COLS), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("t", "u4")])
        named["x"], named["y"], named["z"] = np.moveaxis(points, -1, 0)
        np.save(path, named)
    elif kind == "npz":
        np.savez(path, points)
    else:
        np.savez_compressed(path, points=points, colors=colors)
    return path


@pytest.mark.parametrize(
    "kind", ["npy", "npy with reflectance", "npy by names", "npz", "npz with colors"]
)
def test_arrays_of_pixels_are_organised_clouds(tmp_path: Path, kind: str) -> None:
    path = write_array(tmp_path, kind)
    expected = io.read_range_grid(write_pcd(tmp_path / "cloud.pcd", points_of(scene())))
    grid = io.read_range_grid(path)
    np.testing.assert_array_equal(grid.points, expected.points)
    assert (grid.color is None) == (kind != "npz with colors")
    if grid.color is not None:
        assert (grid.color == (200, 100, 50)).all()
    of_array = made(path, tmp_path / "array.ply")
    of_pcd = made(tmp_path / "cloud.pcd", tmp_path / "pcd.ply")
    assert "organised cloud" in of_array.depth
    assert of_array.points == of_pcd.points
    assert of_array.coverage == of_pcd.coverage
    scan = io.read_scan(path)
    assert scan.num_points == np.count_nonzero(grid.valid)
    np.testing.assert_array_equal(scan.points, grid.points[grid.valid].astype(np.float32))


def facing(path: Path, place: ArrayLike = (0.0, 0.0, 0.0)) -> float:
    """Return the share of a mesh's triangles that face a place."""
    mesh = io.read_mesh(path)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(((np.cross(b - a, c - a) * (place - a)).sum(axis=1) > 0).mean())


@pytest.mark.parametrize("suffix", [".pcd", ".npy"])
def test_views_of_clouds_face_their_cameras(tmp_path: Path, suffix: str) -> None:
    sources = [tmp_path / f"{k}{suffix}" for k in range(2)]
    for path in sources:
        if suffix == ".pcd":
            write_pcd(path, points_of(scene()))
        else:
            np.save(path, points_of(scene()))
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 0 1\n1 0.3 0 0 0 0 0 1\n")
    options = simplify.DepthOptions(300, max_edge=0.1)
    simplify.simplify_camera_files(sources, tmp_path / "poses.txt", tmp_path / "out.ply", options)
    assert facing(tmp_path / "out.ply", (0.15, 0.0, 0.0)) > 0.95


def test_views_of_clouds_bring_their_colours(tmp_path: Path) -> None:
    points, colors = points_of(scene()), np.full((ROWS, COLS, 3), (200, 100, 50), np.uint8)
    sources = [tmp_path / f"{k}.npz" for k in range(2)]
    for path in sources:  # arrays without numbers for each point are left out, with a warning
        np.savez(path, points=points, colors=colors, none=np.zeros((ROWS, COLS, 0)))
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 0 1\n1 0.3 0 0 0 0 0 1\n")
    options = simplify.DepthOptions(300, max_edge=0.1)
    with pytest.warns(UserWarning, match="left out: none"):
        simplify.simplify_camera_files(sources, tmp_path / "poses.txt", tmp_path / "o.glb", options)
    for material in io.read_mesh(tmp_path / "o.glb").materials:
        texture = material.textures["base_color"]
        assert texture.data is not None
        pixels = np.asarray(Image.open(BytesIO(texture.data)).convert("RGB"))
        assert (pixels == (200, 100, 50)).all()


@pytest.mark.parametrize("rows", [slice(None), slice(None, None, -1)])
def test_clouds_of_scanners_face_the_scanner(tmp_path: Path, rows: slice) -> None:
    """Faces face a spinning scanner, with lasers ordered downwards or upwards."""
    np.save(tmp_path / "court.npy", court(rows).astype(np.float32))
    made(tmp_path / "court.npy", tmp_path / "out.ply", max_edge=1.0)
    assert facing(tmp_path / "out.ply") > 0.95


def write_scan(path: Path, points: NDArray[Any], colors: NDArray[np.uint8] | None = None) -> Path:
    """Write a PLY file with a range grid, which does not name its sensor."""
    rows, cols = points.shape[:2]
    valid = ~np.isnan(points).any(axis=2)
    vertex = np.where(valid.ravel(), np.cumsum(valid) - 1, -1)
    lines = ["ply", "format ascii 1.0", f"obj_info num_cols {cols}", f"obj_info num_rows {rows}"]
    lines += [f"element vertex {valid.sum()}", *(f"property float {axis}" for axis in "xyz")]
    table: list[list[Any]] = [[*point] for point in points[valid]]
    if colors is not None:
        lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
        table = [[*point, *color] for point, color in zip(table, colors[valid], strict=True)]
    lines += [f"element range_grid {rows * cols}", "property list uchar int vertex_indices"]
    lines += ["end_header", *(" ".join(map(str, row)) for row in table)]
    lines += ["0" if i < 0 else f"1 {i}" for i in vertex]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("method", ["relief", "cs3", "uniform"])
@pytest.mark.parametrize("order", ["rows down", "rows up", "columns left", "transposed"])
def test_range_grids_of_cameras_face_the_camera(tmp_path: Path, method: str, order: str) -> None:
    points = points_of(scene()) * np.array([1.0, -1.0, -1.0])  # y up, it looks along -z
    ordered = {
        "rows down": points,
        "rows up": points[::-1],
        "columns left": points[:, ::-1],
        "transposed": points.transpose(1, 0, 2),
    }[order]
    scan = write_scan(tmp_path / "scan.ply", ordered)
    made(scan, tmp_path / "out.ply", method=method, max_edge=0.2)
    assert facing(tmp_path / "out.ply") > 0.99
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n")
    options = simplify.DepthOptions(300, max_edge=0.2)
    simplify.simplify_camera_files([scan], tmp_path / "poses.txt", tmp_path / "joined.ply", options)
    assert facing(tmp_path / "joined.ply") > 0.99


def some_colors() -> NDArray[np.uint8]:
    v, u = np.mgrid[:ROWS, :COLS]
    return np.stack([3 * u, 4 * v, 100 + u % 9], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("turn", [False, True])
def test_a_range_grid_of_a_camera_is_its_depth_image(turn: bool, tmp_path: Path) -> None:
    """Range grids in PLY, as PCL writes them, keep colours and get no faces across steps."""
    points = points_of(scene())
    if turn:  # y up, it looks along -z
        points = points * np.float32([1.0, -1.0, -1.0])
    scan = write_scan(tmp_path / "scan.ply", 1000.0 * points, some_colors())
    color = io.read_range_grid(scan).color
    assert color is not None
    valid = scene() > 0
    assert np.array_equal(color[valid], some_colors()[valid])
    result = made(scan, tmp_path / "out.glb")
    assert result.unit == "mm"
    assert "organised cloud of a camera" in result.depth
    mesh = io.read_mesh(tmp_path / "out.glb")
    near = mesh.vertices[mesh.faces, 2] > -1.6
    assert (near.all(axis=1) | ~near.any(axis=1)).all()
    assert facing(tmp_path / "out.glb") > 0.99
    data = mesh.materials[0].textures["base_color"].data
    assert data is not None
    assert np.array_equal(np.array(Image.open(BytesIO(data)).convert("RGB"))[valid], color[valid])
    (tmp_path / "p.txt").write_text("0 0 0 0 0 0 1\n")
    simplify.simplify_camera_files(
        [scan], tmp_path / "p.txt", tmp_path / "joined.glb", simplify.DepthOptions(300)
    )
    assert "base_color" in io.read_mesh(tmp_path / "joined.glb").materials[0].textures


def test_a_sequence_of_range_grids(tmp_path: Path) -> None:
    sequence = simplify.DepthSequence(simplify.DepthOptions(300))
    for number in range(2):
        scan = write_scan(tmp_path / f"{number}.ply", points_of(scene()), some_colors())
        assert sequence.simplify_file(scan, tmp_path / f"{number}.glb").coverage > 0.99
        assert "base_color" in io.read_mesh(tmp_path / f"{number}.glb").materials[0].textures
    v, u = np.mgrid[:ROWS, :COLS]
    flat = write_scan(
        tmp_path / "flat.ply", np.stack([0.01 * u, 0.01 * v, 1 + 0.1 * np.sin(u)], -1)
    )
    with pytest.raises(InputError, match=r"expected a depth camera's cloud .*, got flat\.ply"):
        sequence.simplify_file(flat, tmp_path / "flat.glb")


@pytest.mark.parametrize("name", ["bunny/bun000", "dragon_stand/dragonStandRight_0"])
def test_scans_of_stanford_have_no_camera_and_no_colors(name: str, realdata: RealData) -> None:
    grid = io.read_range_grid(realdata(f"range_scans/{name}.ply.xz"))
    assert grid.color is None
    assert camera_of_scan(grid) is None


def colored(kind: str, points: NDArray[np.float32], path: Path) -> Path:
    """Write a cloud with `some_colors` under names that are in use."""
    colors = some_colors()
    shares = (colors / 255).astype(np.float32)
    shares[scene() == 0] = np.nan
    opaque = np.dstack([colors, np.full((ROWS, COLS), 255, np.uint8)])
    if kind.startswith("points of "):
        shine = np.random.default_rng(0).uniform(size=(ROWS, COLS, 1))
        last = {"7": [shine, colors], "alpha": [opaque], "6": [colors]}[kind.split()[2]]
        table = np.concatenate([points, *last], axis=-1).astype(np.float32)
        beside = {} if "alone" in kind else {"label": np.arange(ROWS * COLS), "pose": np.eye(4)}
        np.savez(path.with_suffix(".npz"), points=table, **beside)
        return path.with_suffix(".npz")
    if kind.startswith("npz "):
        _, place, name, *share = kind.split()
        values = opaque if name == "rgba" else shares if share else colors
        np.savez(path.with_suffix(".npz"), **{place: points, name: values})
        return path.with_suffix(".npz")
    if kind.startswith("names "):
        names = kind.split()[1:]
        table = np.zeros(
            (ROWS, COLS), [(axis, "f4") for axis in "xyz"] + [(n, "u1") for n in names]
        )
        for i in range(3):
            table["xyz"[i]], table[names[i]] = points[..., i], colors[..., i]
    else:
        last = {
            "6 bytes": colors.astype(np.float32),
            "6 shares": shares,
            "zed": opaque.view(np.float32),
            "packed": (colors.astype("<u4") @ np.uint32([1 << 16, 1 << 8, 1])[:, None])
            .astype("<u4")
            .view(np.float32),
        }[kind]
        table = np.concatenate([points, last], axis=-1)
    np.save(path.with_suffix(".npy"), table)
    return path.with_suffix(".npy")


@pytest.mark.parametrize(
    "kind",
    ["names r g b", "names red green blue", "6 bytes", "6 shares", "zed", "packed"]
    + [f"points of {size}{alone}" for size in ("6", "7", "alpha") for alone in ("", " alone")]
    + [
        f"npz {place} {name}"
        for place in ("xyz", "points")
        for name in ("rgb", "color", "colors", "rgba", "rgb shares", "colors shares")
    ],
)
def test_colors_of_arrays_under_names_in_use(kind: str, tmp_path: Path) -> None:
    cloud = colored(kind, points_of(scene()), tmp_path / "cloud")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*arrays without numbers for each")
        grid = io.read_range_grid(cloud)
    assert grid.color is not None
    assert np.array_equal(grid.color[grid.valid], some_colors()[grid.valid])
    if kind in ("zed", "6 bytes"):
        made(cloud, tmp_path / "out.glb")
        assert "base_color" in io.read_mesh(tmp_path / "out.glb").materials[0].textures


def test_columns_that_are_no_colors(tmp_path: Path) -> None:
    points = points_of(scene())
    normals = np.broadcast_to(np.float32([0.6, 0.0, 0.8]), points.shape)
    far = np.linalg.norm(points, axis=-1, keepdims=True)
    nothing = np.full_like(far, np.nan)
    nothing.view(np.uint32)[:] = 0xFFC00000
    wide = np.rint(100 * np.nan_to_num(points))
    lasers = np.broadcast_to(np.float32([0.5, 100, 2, 40]), (ROWS, COLS, 4))
    with_one = np.dstack([normals, np.ones_like(far)])
    for rest in (normals, far, nothing, np.zeros_like(far), wide + 300, np.dstack([far, far]),
                 lasers, np.dstack([normals, far]), with_one):  # fmt: skip
        np.save(tmp_path / "cloud.npy", np.concatenate([points, rest], axis=-1))
        assert io.read_range_grid(tmp_path / "cloud.npy").color is None


@pytest.mark.parametrize("bulge", [0.0, 0.02, 1.0])
def test_rows_of_other_scans_go_up(tmp_path: Path, bulge: float) -> None:
    """Faces face a scanner with parallel rays, although the origin is behind the surface."""
    v, u = np.mgrid[:ROWS, :COLS]
    relief = 1.0 + bulge * np.sin(u / 9.0) * np.cos(v / 7.0) / 3
    points = np.stack([0.01 * u - 0.4, 0.01 * v - 0.3, relief], axis=-1)
    made(write_scan(tmp_path / "scan.ply", points), tmp_path / "out.ply")
    assert facing(tmp_path / "out.ply", np.array([0.0, 0.0, 50.0])) > 0.99


def court(rows: slice = slice(None)) -> NDArray[np.float64]:
    """Return the points of a spinning scanner."""
    elevation, azimuth = np.meshgrid(np.linspace(0.3, -0.3, 32), np.linspace(3.0, -3.0, 256),
                                     indexing="ij")  # fmt: skip
    rays = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)]
    ranges = 5.0 + np.sin(3 * azimuth)
    return (np.stack([*rays, np.sin(elevation)], axis=-1) * ranges[..., None])[rows]


@pytest.mark.parametrize("method", ["relief", "cs3", "uniform"])
@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_scans_on_a_map_are_not_rounded(tmp_path: Path, method: str, suffix: str) -> None:
    place = np.array([5e5, 5.4e6, 300.0])
    np.save(tmp_path / "court.npy", court() + place)
    out = tmp_path / f"out{suffix}"
    made(tmp_path / "court.npy", out, method=method, max_edge=1.0)
    vertices = io.read_mesh(out).vertices - place
    known = court().reshape(-1, 3)
    assert np.linalg.norm(vertices[:, None] - known[None], axis=2).min(axis=1).max() < 1e-5
    assert facing(out, place) > 0.95


def test_a_plane_on_a_map_is_not_rounded(tmp_path: Path) -> None:
    """A plane keeps its precision, although its rays from the origin resemble a far camera's."""
    v, u = np.mgrid[:ROWS, :COLS]
    place = np.array([5e5, 5.4e6, 300.0])
    ground = np.stack([0.1 * u, -0.1 * v, 0.0 * u], axis=-1) + place
    np.save(tmp_path / "ground.npy", ground)
    made(tmp_path / "ground.npy", tmp_path / "out.ply")
    vertices = io.read_mesh(tmp_path / "out.ply").vertices
    known = ground.reshape(-1, 3)
    assert np.linalg.norm(vertices[:, None] - known[None], axis=2).min(axis=1).max() < 1e-5


def test_views_of_scans_on_a_map_are_not_rounded(tmp_path: Path) -> None:
    place = np.array([5e5, 5.4e6, 300.0])
    for name in ("a", "b"):
        np.save(tmp_path / f"{name}.npy", court() + place)
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n0 0 40 0 0 0.6 0.8\n")
    options = simplify.DepthOptions(600, max_edge=1.0)
    sources = [tmp_path / "a.npy", tmp_path / "b.npy"]
    simplify.simplify_camera_files(sources, tmp_path / "poses.txt", tmp_path / "out.ply", options)
    vertices = io.read_mesh(tmp_path / "out.ply").vertices
    turn = np.array([[0.28, -0.96, 0.0], [0.96, 0.28, 0.0], [0.0, 0.0, 1.0]])
    first = court().reshape(-1, 3) + place
    known = np.concatenate([first, first @ turn.T + [0, 0, 40]])
    away = [np.linalg.norm(known - vertex, axis=1).min() for vertex in vertices]
    assert max(away) < 1e-5


def test_a_list_of_points_is_no_image(tmp_path: Path) -> None:
    np.save(tmp_path / "rows.npy", points_of(scene()).reshape(-1, 3))
    np.savez(tmp_path / "rows.npz", points=points_of(scene()).reshape(-1, 3))
    for name in ("rows.npy", "rows.npz"):
        with pytest.raises(FormatError, match="expected an organised cloud"):
            made(tmp_path / name, tmp_path / "out.ply")
    np.save(tmp_path / "depth.npy", scene())
    with pytest.raises(InputError, match="intrinsics"):
        made(tmp_path / "depth.npy", tmp_path / "out.ply")


def test_a_coordinate_of_two_numbers_is_refused(tmp_path: Path) -> None:
    cloud = write_pcd(tmp_path / "cloud.pcd", points_of(scene()))
    header, _, data = cloud.read_bytes().partition(b"DATA binary\n")
    for old, new in ((b"FIELDS x y z", b"FIELDS x y"), (b"COUNT 1 1 1", b"COUNT 2 1"),
                     (b"SIZE 4 4 4", b"SIZE 4 4"), (b"TYPE F F F", b"TYPE F F")):  # fmt: skip
        header = header.replace(old, new)
    cloud.write_bytes(header + b"DATA binary\n" + data)
    with pytest.raises(FormatError, match="x, z not found"):
        io.read_range_grid(cloud)


def test_a_cloud_without_points_is_refused(tmp_path: Path) -> None:
    cloud = write_pcd(tmp_path / "cloud.pcd", np.full((ROWS, COLS, 3), np.nan))
    with pytest.raises(FormatError, match="no measured pixel"):
        made(cloud, tmp_path / "out.ply")


@pytest.mark.parametrize("name", ["cloud.npy", "cloud.npz"])
def test_whole_numbers_are_a_cloud_too(name: str, tmp_path: Path) -> None:
    """Clouds of integers, as of the Azure Kinect in millimetres with 0 for no point, are read."""
    whole = np.rint(np.nan_to_num(1000 * points_of(scene()))).astype(np.int16)
    (np.save if name.endswith(".npy") else np.savez)(tmp_path / name, whole)
    found = made(tmp_path / name, tmp_path / "out.ply")
    assert (found.unit, found.points_before) == ("mm", int((scene() > 0).sum()))
    np.save(tmp_path / "colour.npy", np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match="expected the camera of the depth image"):
        made(tmp_path / "colour.npy", tmp_path / "out.ply")


@pytest.mark.parametrize("name", ["cloud.pcd", "cloud.npy", "cloud.npz"])
def test_infinite_points_are_no_measurement(name: str, tmp_path: Path) -> None:
    points = points_of(scene())
    points[scene() == 0] = np.inf
    points[0, 0] = -np.inf
    if name.endswith(".pcd"):
        write_pcd(tmp_path / name, points)
    else:
        (np.save if name.endswith(".npy") else np.savez)(tmp_path / name, points)
    grid = io.read_range_grid(tmp_path / name)
    assert np.array_equal(grid.valid, scene() > 0)
    assert np.isnan(grid.points[~grid.valid]).all()
    assert io.read_scan(tmp_path / name).num_points == grid.valid.sum()
    assert made(tmp_path / name, tmp_path / "out.ply").coverage > 0.99
    points[5, 70, 0] = np.inf  # only one coordinate: a damaged point
    np.save(tmp_path / "bad.npy", points)
    with pytest.raises(FormatError, match="finite"):
        io.read_range_grid(tmp_path / "bad.npy")


@pytest.mark.parametrize("source", ["a.pcd", "a.npy", "a.npz"])
@pytest.mark.parametrize("target", ["b.pcd", "b.npy"])
def test_a_cloud_keeps_its_grid_in_formats_that_hold_one(
    source: str, target: str, tmp_path: Path
) -> None:
    points = points_of(scene())
    if source.endswith(".pcd"):
        write_pcd(tmp_path / source, points)
    else:
        (np.save if source.endswith(".npy") else np.savez)(tmp_path / source, points)
    read = io.read_scan(tmp_path / source)
    read.write(tmp_path / target)
    grid = io.read_range_grid(tmp_path / target)
    assert np.array_equal(grid.points.astype(np.float32), points, equal_nan=True)
    again = io.read_scan(tmp_path / target)
    assert np.array_equal(again.points, read.points)
    assert again.num_dropped == read.num_dropped > 0
    # A part of the points is no grid.
    read.select(read.points[:, 0] > 0).write(tmp_path / target)
    with pytest.raises(FormatError, match="expected an organised cloud"):
        io.read_range_grid(tmp_path / target)


def test_a_cloud_without_gaps_keeps_its_grid_and_its_columns(tmp_path: Path) -> None:
    columns = np.random.default_rng(0).uniform(1, 2, (6, 8, 4)).astype(np.float32)
    np.save(tmp_path / "a.npy", columns)
    read = io.read_scan(tmp_path / "a.npy")
    read.write(tmp_path / "b.npy")
    assert np.array_equal(np.load(tmp_path / "b.npy"), columns)
    read.write(tmp_path / "b.pcd")
    assert io.read_range_grid(tmp_path / "b.pcd").valid.shape == (6, 8)
    whole = np.rint(1000 * columns[..., :3]).astype(np.int16)
    np.save(tmp_path / "a.npy", whole)
    io.read_scan(tmp_path / "a.npy").write(tmp_path / "b.npy")
    assert np.array_equal(np.load(tmp_path / "b.npy"), whole)


@pytest.mark.golden
def test_a_turned_cloud_is_the_same_bytes_everywhere(
    tmp_path: Path, golden: Callable[[str, object], None]
) -> None:
    """A BLAS would fit a camera that depends on the processor."""
    v, u = np.mgrid[:ROWS, :COLS]
    depth = (1900 + (u - 40) ** 2 + (v - 20) ** 2 // 2) / 1000
    depth[20:40, 30:50] = 1.2
    depth[:10, :12] = 0.0
    x, y, z = np.moveaxis(points_of(depth.astype(np.float32)).astype(np.float64), -1, 0)
    turned = np.stack([0.8 * z + 0.6 * y + 0.3, -x - 0.1, 0.6 * z - 0.8 * y + 1.2], axis=-1)
    result = made(write_pcd(tmp_path / "cloud.pcd", turned), tmp_path / "out.ply")
    assert "organised cloud" in result.depth
    vertices = io.read_mesh(tmp_path / "out.ply").vertices
    found = find_camera(io.RangeGrid(turned, depth > 0))
    assert found is not None
    arrays = (vertices, found.depth, found.rotation, found.centre, found.intrinsics.rays)
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    golden("turned cloud", digest.hexdigest())
