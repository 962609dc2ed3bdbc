"""Range scans and RGB-D recordings: units, masks, cameras and poses as their sets define them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, InputError, datasets, read_mesh

needs_data = pytest.mark.skipif(
    not os.environ.get("MANIP3D_DATA"), reason="MANIP3D_DATA is not set"
)


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


@pytest.mark.realdata
@needs_data
def test_a_scan_is_its_mesh_s_vertices_on_the_grid() -> None:
    scan = datasets.load_scan("bun000")
    mesh = read_mesh(datasets.scan_path("bun000"))
    assert scan.points.shape == (400, 512, 3)
    assert scan.valid.sum() == 40_256
    np.testing.assert_array_equal(
        np.unique(scan.points[scan.valid], axis=0), np.unique(mesh.vertices, axis=0)
    )
    assert np.isnan(scan.points[~scan.valid]).all()
    np.testing.assert_array_equal(scan.pose, np.eye(4))


@pytest.mark.realdata
@needs_data
def test_poses_bring_neighbouring_scans_together() -> None:
    """Inverting the rotations instead puts the scans centimetres apart."""
    mesh = read_mesh(datasets.scan_path("bun000"))
    from manip3d.metrics import closest_points

    scan = datasets.load_scan("bun045")
    points = scan.points[scan.valid][::50]
    aligned = points @ scan.pose[:3, :3].T + scan.pose[:3, 3]
    assert np.median(closest_points(mesh, aligned).distance) < 0.4e-3
    turned = points @ scan.pose[:3, :3] + scan.pose[:3, 3]
    assert np.median(closest_points(mesh, turned).distance) > 5e-3
