"""Several calibrated cameras into one mesh: no doubled layer, no gap, the density of one view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import (
    InputError,
    Intrinsics,
    Mesh,
    Registration,
    datasets,
    io,
    metrics,
    simplify,
)
from manip3d.simplify import CameraView, JointSimplification, cs3_cameras, relief_cameras
from real_data import RealData

Join = Callable[..., JointSimplification]
BOTH = pytest.mark.parametrize("join", [cs3_cameras, relief_cameras])
CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


def looking_at_origin(angle: float, distance: float = 3.0) -> NDArray[np.float64]:
    """Camera-to-world pose of a camera on a circle around the origin, y down."""
    pose = np.eye(4)
    pose[:3, :3] = [
        [np.cos(angle), 0, -np.sin(angle)],
        [0, 1, 0],
        [np.sin(angle), 0, np.cos(angle)],
    ]
    pose[:3, 3] = -distance * pose[:3, 2]
    return pose


def ball(pose: NDArray[np.float64]) -> NDArray[np.float32]:
    """Depth image of the unit ball at the origin; 0 beside it and where it is seen edge-on."""
    v, u = np.mgrid[0:120, 0:160]
    rays = np.stack(
        [(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1
    )
    rays = rays @ pose[:3, :3].T
    a = (rays**2).sum(-1)
    b = rays @ pose[:3, 3]
    root = b**2 - a * ((pose[:3, 3] ** 2).sum() - 1)
    z = (-b - np.sqrt(np.maximum(root, 0))) / a
    points = pose[:3, 3] + rays * z[..., None]
    facing = -np.einsum("ijk,ijk->ij", points, rays) / np.sqrt(a)
    return np.where((root > 0) & (facing > 0.25), z, 0).astype(np.float32)


ANGLES = (0.0, 0.7, -0.8)
VIEWS = [
    CameraView(depth=ball(pose), intrinsics=CAMERA, pose=pose)
    for pose in map(looking_at_origin, ANGLES)
]


def areas(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    p, q, r = (vertices[faces[:, i]] for i in range(3))
    result: NDArray[np.float64] = np.linalg.norm(np.cross(q - p, r - p), axis=1) / 2
    return result


def test_one_view_is_cs3() -> None:
    joint = cs3_cameras(VIEWS[:1], 400)
    assert VIEWS[0].depth is not None
    single = simplify.cs3(VIEWS[0].depth, CAMERA, 400)
    np.testing.assert_array_equal(joint.faces, single.faces)
    np.testing.assert_array_equal(joint.pixels, single.pixels)
    np.testing.assert_allclose(joint.vertices, single.vertices + VIEWS[0].pose[:3, 3])  # type: ignore[index]


def layers_of(joint: JointSimplification, views: list[CameraView]) -> tuple[float, float]:
    """Shares of the directions from the ball's centre with two layers, and with none.

    The ball is round, so each direction meets each layer once. Of the latter only those count that
    lie three pixels inside of an outline: a sparse mesh ends within it.
    """
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    inverse = np.linalg.inv(np.swapaxes(joint.vertices[joint.faces], 1, 2))
    layers = (np.einsum("fij,dj->dfi", inverse, directions) >= 0).all(axis=2).sum(axis=1)
    seen = np.zeros(len(directions), bool)
    for view in views:
        pose = np.asarray(view.pose)
        sight = directions - pose[:3, 3]
        local = sight @ pose[:3, :3]
        u = np.rint(CAMERA.fx * local[:, 0] / local[:, 2] + CAMERA.cx).astype(int)
        v = np.rint(CAMERA.fy * local[:, 1] / local[:, 2] + CAMERA.cy).astype(int)
        facing = -np.einsum("ij,ij->i", directions, sight) / np.linalg.norm(sight, axis=1)
        valid = np.asarray(view.depth) > 0
        inside = np.all([valid[v + dv, u + du] for dv, du in ((0, 3), (0, -3), (3, 0), (-3, 0))], 0)
        seen |= inside & (facing > 0.25)
    return float((layers > 1).mean()), float((layers[seen] == 0).mean())


@pytest.mark.parametrize("count", [2, 3])
@BOTH
def test_the_overlap_is_sampled_once(count: int, join: Join) -> None:
    joint = join(VIEWS[:count], 900)
    assert 0.95 * 900 <= joint.num_vertices <= 900
    assert sorted(set(joint.vertex_view.tolist())) == list(range(count))
    np.testing.assert_allclose(np.linalg.norm(joint.vertices, axis=1), 1, atol=1e-6)
    summary = joint.mesh.summary()
    assert summary.non_manifold_edges == 0
    used = np.unique(joint.faces)
    assert len(used) >= 0.99 * joint.num_vertices
    normals = np.cross(
        joint.vertices[joint.faces[:, 1]] - joint.vertices[joint.faces[:, 0]],
        joint.vertices[joint.faces[:, 2]] - joint.vertices[joint.faces[:, 0]],
    )
    corner = joint.vertices[joint.faces[:, 0]]
    outward = np.einsum("ij,ij->i", normals, corner) > 0
    sensors = np.array([np.asarray(view.pose)[:3, 3] for view in VIEWS])[joint.face_view]
    seen = np.einsum("ij,ij->i", normals, sensors - corner) > 0
    # Three points of the outline span a face that looks past the ball's centre.
    assert outward.all() if join is cs3_cameras else (outward.mean() > 0.998 and seen.all())
    doubled, holes = layers_of(joint, VIEWS[:count])
    assert doubled < 0.002
    assert holes < 0.01
    # The density where two views overlap is that of one view.
    assert VIEWS[0].depth is not None
    share = joint.views[0].num_vertices
    method = simplify.cs3 if join is cs3_cameras else simplify.relief
    alone = method(VIEWS[0].depth, CAMERA, share)
    inside = np.hypot(alone.pixels[:, 0] - 79.5, alone.pixels[:, 1] - 59.5) < 40
    there = (joint.vertex_view == 0) & (np.hypot(*(joint.pixels - [79.5, 59.5]).T) < 40)
    other = (joint.vertex_view > 0) & (joint.vertices @ [0, 0, -1] > 0.8)
    assert abs(there.sum() + other.sum() - inside.sum()) <= 0.1 * inside.sum()


@BOTH
def test_views_without_overlap_stay_apart(join: Join) -> None:
    back = looking_at_origin(np.pi)
    joint = join([VIEWS[0], CameraView(depth=ball(back), intrinsics=CAMERA, pose=back)], 500)
    assert not any(covered.any() for covered in joint.covered)
    assert joint.mesh.summary().components == 2


@BOTH
def test_a_view_that_adds_nothing(join: Join) -> None:
    joint = join([VIEWS[0], VIEWS[0]], 500)
    assert joint.covered[1].sum() > 0.9 * (np.asarray(VIEWS[0].depth) > 0).sum()
    assert (joint.vertex_view == 0).mean() > 0.85
    empty = CameraView(depth=np.zeros((120, 160), np.uint16), intrinsics=CAMERA)
    nothing = join([empty, empty], 10)
    assert nothing.num_vertices == nothing.num_faces == nothing.mesh.num_faces == 0
    first = join([empty, VIEWS[0]], 300)
    assert first.vertex_view.tolist() == [1] * first.num_vertices


@BOTH
def test_textures_stay_with_their_views(join: Join) -> None:
    red, blue = (np.full((120, 160, 3), c, np.uint8) for c in ((255, 0, 0), (0, 0, 255)))
    views = [
        CameraView(
            depth=v.depth,
            intrinsics=CAMERA,
            pose=v.pose,
            color=color,
            registration=registration,
        )
        for v, color, registration in zip(
            VIEWS[:2], (red, blue), (None, Registration(CAMERA)), strict=True
        )
    ]
    joint = join(views, 600)
    mesh = joint.mesh
    assert mesh.face_material is not None
    np.testing.assert_array_equal(mesh.face_material, joint.face_view)
    assert len(mesh.materials) == 2
    # Both views take their pictures through the same camera model, so a corner's coordinates are
    # where its vertex projects to in the view that the triangle was made in.
    for index, view in enumerate(views):
        pose = np.asarray(view.pose)
        faces = joint.faces[joint.face_view == index]
        local = (joint.vertices[faces] - pose[:3, 3]) @ pose[:3, :3]
        u = CAMERA.fx * local[..., 0] / local[..., 2] + CAMERA.cx
        v = CAMERA.fy * local[..., 1] / local[..., 2] + CAMERA.cy
        expected = np.stack([(u + 0.5) / 160, 1 - (v + 0.5) / 120], axis=-1)
        off = np.abs(joint.corner_texcoords[joint.face_view == index] - expected).max()
        assert off <= (1.0 / 120 if index == 0 else 1e-5)


@BOTH
def test_corners_of_a_view_share_their_texture_coordinates(join: Join, tmp_path: Path) -> None:
    """A file with one place for each corner had 3 vertices for each face."""
    joint = join(VIEWS[:2], 600)
    mesh = joint.mesh
    assert mesh.texcoords is not None
    assert mesh.face_texcoords is not None
    assert len(mesh.texcoords) < 1.3 * joint.num_vertices
    np.testing.assert_array_equal(
        mesh.texcoords[mesh.face_texcoords], np.nan_to_num(joint.corner_texcoords)
    )
    io.write_mesh(mesh, tmp_path / "a.glb")
    assert io.read_mesh(tmp_path / "a.glb").num_vertices < 1.3 * joint.num_vertices


@BOTH
def test_same_bytes_for_any_number_of_threads(join: Join) -> None:
    one, two = (join(VIEWS, 700, threads=threads) for threads in (1, 2))
    for name in ("vertices", "faces", "pixels", "vertex_view", "face_view", "corner_texcoords"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (CameraView(), r"views\[0\]: expected either depth with intrinsics, or points"),
        (CameraView(depth=np.ones((2, 2), np.float32)), r"views\[0\]: expected intrinsics"),
        (
            CameraView(points=np.ones((2, 2, 3)), pose=np.diag([1, 1, -1, 1])),
            r"views\[0\]\.pose: expected a rigid",
        ),
        (
            CameraView(points=np.ones((2, 2, 3)), pose=np.eye(3)),
            r"views\[0\]\.pose: expected shape",
        ),
        (None, r"views\[0\]: expected CameraView, got None"),
    ],
)
@BOTH
def test_bad_views(view: CameraView, message: str, join: Join) -> None:
    with pytest.raises(InputError, match=message):
        join([view], 10)


@BOTH
def test_bad_options(join: Join) -> None:
    with pytest.raises(InputError, match="views: expected at least one"):
        join([], 10)
    with pytest.raises(InputError, match="target_points"):
        join(VIEWS, -1)
    with pytest.raises(InputError, match="tolerance: expected > 0"):
        join(VIEWS, 10, tolerance=np.nan)


@pytest.mark.parametrize("names", [("bun000", "bun045"), ("bun000", "bun045", "bun090", "bun315")])
@BOTH
def test_bunny_scans(realdata: RealData, names: tuple[str, ...], join: Join) -> None:
    """Poses of bun.conf: one mesh, no doubled layer, the overlap as dense as a single scan."""
    realdata.needs(*names)
    scans = [datasets.load_scan(name) for name in names]
    views = [CameraView(points=s.points, valid=s.valid, pose=s.pose) for s in scans]
    joint = join(views, 4000)
    assert joint.num_vertices <= 4000
    mesh = joint.mesh
    summary = mesh.summary()
    assert summary.non_manifold_edges == 0
    # Everything that was measured is near the mesh: nothing is missing.
    for scan in scans:
        world = scan.points[scan.valid] @ scan.pose[:3, :3].T + scan.pose[:3, 3]
        distances = metrics.closest_points(mesh, world).distance
        assert np.quantile(distances, 0.99) < 1.5e-3  # metres
    # No doubled layer: what a later view adds does not lie on what the earlier ones made.
    doubled = total = 0.0
    for index in range(1, len(scans)):
        before = Mesh(joint.vertices, joint.faces[joint.face_view < index])
        added = joint.faces[joint.face_view == index]
        size = areas(joint.vertices, added)
        closest = metrics.closest_points(before, joint.vertices[added].mean(axis=1))
        foot = before.faces[closest.face]
        sides = [normals_of(joint.vertices, f) for f in (foot, added)]
        same_side = np.einsum("ij,ij->i", *sides) > 0
        # Triangles of the seam touch the border; their centroids are further from it.
        doubled += size[(closest.distance < 0.3e-3) & same_side].sum()
        total += size.sum()
    everything = areas(joint.vertices, joint.faces).sum()
    assert doubled < 0.01 * everything
    assert total > 0.05 * everything
    if len(scans) > 2:
        return
    # Density, in points near the surface of both scans.
    single = joint.views[0].vertices.astype(float)
    dense = [
        Mesh(d.vertices.astype(float) @ s.pose[:3, :3].T + s.pose[:3, 3], d.faces)
        for s in scans
        for d in [simplify.dense_mesh_grid(s.points, s.valid)]
    ]

    def shared(points: NDArray[np.float64]) -> int:
        near = [metrics.closest_points(m, points).distance < 2e-3 for m in dense]
        return int(np.all(near, axis=0).sum())

    assert abs(shared(joint.vertices) - shared(single)) <= 0.1 * shared(single)


def normals_of(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    p, q, r = (vertices[faces[:, i]] for i in range(3))
    result: NDArray[np.float64] = np.cross(q - p, r - p)
    return result


def test_one_view_is_relief() -> None:
    joint = relief_cameras(VIEWS[:1], 400)
    assert VIEWS[0].depth is not None
    single = simplify.relief(VIEWS[0].depth, CAMERA, 400)
    faces = joint.vertices[joint.faces], single.vertices[single.faces] + VIEWS[0].pose[:3, 3]  # type: ignore[index]
    assert joint.num_vertices == 400
    assert joint.num_faces == pytest.approx(single.num_faces, rel=0.02)
    np.testing.assert_allclose(*(np.linalg.norm(f, axis=2).mean() for f in faces), atol=1e-3)


def test_relief_is_nearer_than_cs3_with_as_many_points(realdata: RealData) -> None:
    names = ("bun000", "bun045")
    realdata.needs(*names)
    scans = [datasets.load_scan(name) for name in names]
    views = [CameraView(points=s.points, valid=s.valid, pose=s.pose) for s in scans]
    world = np.concatenate(
        [s.points[s.valid][::7] @ s.pose[:3, :3].T + s.pose[:3, 3] for s in scans]
    )
    cs3, relief = (
        metrics.closest_points(join(views, 2000).mesh, world).distance
        for join in (cs3_cameras, relief_cameras)
    )
    assert relief.mean() < 0.8 * cs3.mean()
    assert np.quantile(relief, 0.99) < np.quantile(cs3, 0.99)


def test_masks_and_confidences_of_views() -> None:
    rng = np.random.default_rng(0)
    left = np.tile(np.arange(160) < 80, (120, 1))
    masked = CameraView(VIEWS[0].depth, CAMERA, mask=left)
    depth = np.asarray(VIEWS[0].depth)
    cut = CameraView(np.where(left, depth, np.float32(0)), CAMERA)
    for join in (cs3_cameras, relief_cameras):
        one, two = join([masked], 300), join([cut], 300)
        assert one.vertices.tobytes() == two.vertices.tobytes()
        assert one.faces.tobytes() == two.faces.tobytes()
    noise = np.where(left, 0.03 * rng.normal(size=depth.shape), 0).astype(np.float32)
    noisy = np.where(depth > 0, depth + noise, np.float32(0))
    plain, weighed = (
        relief_cameras([CameraView(noisy, CAMERA, confidence=c)], 300)
        for c in (None, np.where(left, 0.05, 1.0))
    )
    assert (weighed.pixels[:, 0] >= 80).sum() > 1.2 * (plain.pixels[:, 0] >= 80).sum()
    wall = np.full(depth.shape, 3.0, np.float32)
    wall[30:60, 50:90] = 1.8  # a reflection
    believed = np.where(wall == 3.0, 1.0, 0.0)
    found = relief_cameras([CameraView(wall, CAMERA, confidence=believed)], 300, depth_step=0.05)
    assert found.vertices[:, 2].min() == 3.0
    assert found.coverage == pytest.approx(believed.mean(), abs=0.01)
    for bad, message in (
        (CameraView(depth, CAMERA, mask=left[1:]), r"views\[0\]\.mask: expected shape"),
        (CameraView(depth, CAMERA, confidence=left), r"views\[0\]\.confidence: expected floats"),
    ):
        with pytest.raises(InputError, match=message):
            relief_cameras([bad], 300)


def room_views() -> list[CameraView]:
    """Views of three different cameras of a room with a box on its floor."""
    low, high = np.array([-2, -1, -0.5]), np.array([2, 1.5, 4])
    views = []
    for width, height, focal, place, angle in (
        (320, 240, 200.0, (-0.6, 0, 0.2), 0.25),
        (160, 120, 110.0, (0.7, -0.1, 0.3), -0.3),
        (96, 128, 70.0, (0, 0.2, 0), 0.0),
    ):
        pose = looking_at_origin(-angle)
        pose[:3, 3] = place
        camera = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        v, u = np.mgrid[0:height, 0:width]
        sight = np.stack([(u - camera.cx) / focal, (v - camera.cy) / focal, np.ones(u.shape)], -1)
        sight = sight @ pose[:3, :3].T
        with np.errstate(divide="ignore"):
            ends = [(corner - pose[:3, 3]) / sight for corner in (low, high)]
            depth = np.maximum(*ends).min(axis=-1)  # the camera is inside the room
            box = [(c - pose[:3, 3]) / sight for c in ([-0.4, 0.6, 2.1], [0.4, 1.4, 2.9])]
        enters, leaves = np.minimum(*box).max(axis=-1), np.maximum(*box).min(axis=-1)
        depth = np.where(enters <= leaves, np.minimum(enters, depth), depth)
        millimetres = np.rint(1000 * depth).astype(np.uint16)
        views.append(CameraView(millimetres, camera, pose=pose))
    return views


ROOM = room_views()


def seen_of(joint: JointSimplification, view: CameraView) -> NDArray[np.float64]:
    """Depth of the mesh on each line of sight of a view; NaN: none."""
    assert view.intrinsics is not None
    pose = np.asarray(view.pose)
    own = Mesh((joint.vertices - pose[:3, 3]) @ pose[:3, :3], joint.faces)
    return metrics.render_depth(own, view.intrinsics)


@pytest.mark.parametrize("points", [300, 1500])
def test_few_points_leave_no_hole_at_the_seam(points: int) -> None:
    joint = relief_cameras(ROOM, points, depth_step=0.05)
    # With 250 to 350 points, bridges are 0 to 0.4 % of the area, depending on the number.
    assert joint.bridges < (0.005 if points == 300 else 0.002)
    # The box hides parts of the room, and its outline is as coarse as the mesh.
    missing = [float(np.isnan(seen_of(joint, view)).mean()) for view in ROOM]
    assert max(missing) < 0.02
    assert joint.mesh.summary().non_manifold_edges == 0


def hits(joint: JointSimplification, view: CameraView, pixels: NDArray[np.intp]) -> float:
    """Share of pixels whose line of sight meets the mesh at their depth, by trying each face."""
    assert view.intrinsics is not None
    pose = np.asarray(view.pose)
    corners = ((joint.vertices - pose[:3, 3]) @ pose[:3, :3])[joint.faces]
    v, u = np.divmod(pixels, view.intrinsics.width)
    camera = view.intrinsics
    sight = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.linalg.solve(
            np.swapaxes(corners, 1, 2), np.broadcast_to(sight, (len(corners), *sight.shape))
        )
        inside = (shares >= -1e-6 * shares.sum(axis=1, keepdims=True)).all(axis=1)
        depth = np.where(inside, 1 / shares.sum(axis=1), np.inf)
    measured = np.asarray(view.depth)[v, u] / 1000
    return float((np.abs(depth - measured) <= 0.05 * measured).any(axis=0).mean())


@pytest.mark.parametrize("points", [100, 300])
@BOTH
def test_coverage_is_that_of_lines_of_sight(points: int, join: Join) -> None:
    joint = join(ROOM, points, depth_step=0.05)
    some = np.random.default_rng(1)
    met = total = 0.0
    for view in ROOM:
        num = np.asarray(view.depth).size
        met += num * hits(joint, view, some.choice(num, 3000, replace=False))
        total += num
    assert joint.coverage == pytest.approx(met / total, abs=0.01)


@BOTH
def test_coverage_of_scans_counts_a_hole(join: Join) -> None:
    v, u = np.mgrid[0:80, 0:100]
    z = 50 + 1e-3 * np.random.default_rng(0).normal(size=u.shape)
    joint = join([CameraView(points=np.stack([u, v, z], axis=-1).astype(np.float32))], u.size)
    assert joint.coverage == 1
    corners = joint.vertices[joint.faces][..., :2]
    inside = (np.abs(corners - (50, 40)) <= 10.5).all(axis=(1, 2))
    holed = replace(joint, faces=joint.faces[~inside])
    # One or two of the 21 pixels on each side are on the border of the hole or beside it.
    assert 1 - 19**2 / u.size <= holed.coverage <= 1 - 17**2 / u.size
