"""Range scans and RGB-D recordings: units, masks, cameras and poses as their sets define them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, InputError, Mesh, datasets, read_mesh
from real_data import RealData


def test_the_registry_knows_the_40_scans() -> None:
    assert len(datasets.scan_names()) == 40
    assert datasets.scan_names("bunny_scans")[0] == "bun000"
    assert datasets.get("happy_stand").facts["points"] == 1_099_005
    with pytest.raises(InputError, match="expected range scans, got 'rockerArm' \\(mesh\\)"):
        datasets.scan_names("rockerArm")
    with pytest.raises(InputError, match="scan: expected one of bun000"):
        datasets.load_scan("bun001")


def test_missing_scans_say_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_DATA", str(tmp_path))
    monkeypatch.setenv("MANIP3D_CACHE", str(tmp_path / "cache"))
    assert not datasets.scan_is_here("bun000")
    with pytest.raises(datasets.DataMissingError, match="manip3d data get bunny_scans"):
        datasets.load_scan("bun000")


def test_poses_turn_by_the_inverse_of_their_quaternion(tmp_path: Path) -> None:
    path = tmp_path / "some.conf"
    half = np.sqrt(0.5)
    path.write_text(f"camera 0 0 0 0 0 0 1\n\nbmesh a.ply 1 2 3 0 0 {half} {half}\n")
    (pose,) = datasets.read_poses(path).values()
    # The quaternion turns x to y by 90 degrees; its inverse turns y to x.
    np.testing.assert_allclose(pose @ [0, 1, 0, 1], [2, 2, 3, 1], atol=1e-15)


@pytest.mark.parametrize(
    "line", ["bmesh", "bmesh a 1 2 3", "bmesh a 1 2 3 0 0 0 0", "bmesh a 1 2 nan 0 0 0 1"]
)
def test_bad_poses_name_their_line(line: str, tmp_path: Path) -> None:
    path = tmp_path / "some.conf"
    path.write_text(f"camera 0\n{line}\n")
    with pytest.raises(FormatError, match="line 2: expected 'bmesh FILE' and seven"):
        datasets.read_poses(path)


def test_a_scan_is_its_mesh_s_vertices_on_the_grid(realdata: RealData) -> None:
    realdata.needs("bun000")
    scan = datasets.load_scan("bun000")
    mesh = read_mesh(datasets.scan_path("bun000"))
    assert scan.points.shape == (400, 512, 3)
    assert scan.valid.sum() == 40_256
    np.testing.assert_array_equal(
        np.unique(scan.points[scan.valid], axis=0), np.unique(mesh.vertices, axis=0)
    )
    assert np.isnan(scan.points[~scan.valid]).all()
    np.testing.assert_array_equal(scan.pose, np.eye(4))


def test_poses_bring_neighbouring_scans_together(realdata: RealData) -> None:
    """Inverting the rotations instead puts the scans centimetres apart."""
    realdata.needs("bun000", "bun045")
    mesh = read_mesh(datasets.scan_path("bun000"))
    from manip3d.metrics import closest_points

    scan = datasets.load_scan("bun045")
    points = scan.points[scan.valid][::50]
    aligned = points @ scan.pose[:3, :3].T + scan.pose[:3, 3]
    assert np.median(closest_points(mesh, aligned).distance) < 0.4e-3
    turned = points @ scan.pose[:3, :3] + scan.pose[:3, 3]
    assert np.median(closest_points(mesh, turned).distance) > 5e-3


RECORDINGS = {
    # frames, pixels, nearest and farthest measurement in metres, colour, mask, pose
    "person_turning": (100, (480, 640), (0.81, 2.75), True, True, True),
    "person_ddrnet": (20, (480, 640), (1.2, 2.0), True, True, False),
    "person_normalgan": (3, (424, 512), (1.8, 2.4), True, False, False),
    "person_frontsurfaces": (3, (424, 512), (1.0, 3.0), True, False, False),
    "person_utd_mhad": (409, (240, 320), (1.8, 4.0), False, False, False),
    "scene_kitchen": (19, (480, 640), (0.4, 5.0), True, False, True),
    "scene_redwood": (5, (480, 640), (0.3, 8.0), True, False, True),
    "scene_livingroom": (5, (480, 640), (0.5, 8.0), True, False, True),
    "scene_tum_desk": (2, (480, 640), (0.9, 8.6), True, False, False),
    "scene_kinect2_desk": (1, (424, 512), (0.7, 6.9), False, False, False),
    "wall_realsense": (2, (480, 640), (0.3, 65.6), False, False, False),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_are_registered(name: str) -> None:
    assert len(datasets.frame_names(name)) == RECORDINGS[name][0]
    assert datasets.get(name).facts["frames"] == RECORDINGS[name][0]
    with pytest.raises(InputError, match="frame: expected an index below"):
        datasets.load_frame(name, 1000)
    with pytest.raises(InputError, match="frame: expected one of"):
        datasets.load_frame(name, "none")


def test_other_data_sets_are_no_recordings() -> None:
    with pytest.raises(InputError, match=r"expected one of person_turning, .*got 'rockerArm'"):
        datasets.frame_names("rockerArm")
    with pytest.raises(InputError, match="got 'kinect2_rays'"):
        datasets.load_frame("kinect2_rays")


@pytest.mark.parametrize("name", RECORDINGS)
def test_frames_have_their_units_and_companions(realdata: RealData, name: str) -> None:
    realdata.needs(name)
    _, shape, (near, far), color, mask, pose = RECORDINGS[name]
    frame = datasets.load_frame(name)
    assert frame.depth.shape == shape == (frame.intrinsics.height, frame.intrinsics.width)
    metres = frame.depth / 1000.0 if frame.depth.dtype == np.uint16 else frame.depth
    measured = metres[metres > 0]
    assert near <= measured.min()
    assert measured.max() <= far
    assert (frame.color is not None, frame.mask is not None, frame.pose is not None) == (
        color, mask, pose,
    )  # fmt: skip
    if frame.color is not None:
        assert frame.color.shape == (*shape, 3)
        assert frame.is_registered == (name != "scene_kitchen")
    if frame.mask is not None:
        assert 0.05 < (frame.person > 0).mean() < 0.5
    if frame.pose is not None:
        rotation = frame.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
        assert np.linalg.det(rotation) > 0


@pytest.mark.parametrize(
    ("name", "other"), [("scene_kitchen", 1), ("scene_redwood", 1), ("scene_livingroom", 4)]
)
def test_poses_bring_the_frames_of_a_scene_together(
    realdata: RealData, name: str, other: int
) -> None:
    """The median distance between two views' surfaces: a wrong unit, pose or camera parts them."""
    realdata.needs(name)
    from manip3d.metrics import closest_points
    from manip3d.simplify import dense_mesh

    first, second = datasets.load_frame(name, 0), datasets.load_frame(name, other)
    world = [
        dense_mesh(f.depth, f.intrinsics, max_edge=0.1).vertices.astype(float) @ f.pose[:3, :3].T
        + f.pose[:3, 3]
        for f in (first, second)
        if f.pose is not None
    ]
    mesh = dense_mesh(first.depth, first.intrinsics, max_edge=0.1)
    surface = Mesh(world[0], mesh.faces)
    assert np.median(closest_points(surface, world[1][::200]).distance) < 0.02


def test_the_ray_table_of_a_kinect2_is_near_its_pinhole_in_the_middle(realdata: RealData) -> None:
    realdata.needs("kinect2_rays")
    from manip3d.simplify import dense_mesh

    camera = datasets.load_kinect2_intrinsics()
    mesh = dense_mesh(np.ones((424, 512), np.float32), camera)
    u, v = mesh.pixels.T
    middle = (abs(u - 256) < 40) & (abs(v - 212) < 40)
    x = (u - camera.cx) / camera.fx
    y = (v - camera.cy) / camera.fy
    np.testing.assert_allclose(mesh.vertices[middle, 0], x[middle], atol=2e-3)
    np.testing.assert_allclose(mesh.vertices[middle, 1], y[middle], atol=2e-3)
