"""The real meshes: counts of their manifests, and other readers where they agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import io
from real_data import ROOT, RealData


def manifest(folder: str, columns: int) -> list[list[str]]:
    """Rows of the first table of a manifest that has so many columns."""
    if ROOT is None:
        return [[""]]
    rows: list[list[str]] = []
    for line in (ROOT / folder / "MANIFEST.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("## ") and rows:
            break
        if line.startswith("|") and len(cells) == columns and "." in cells[0]:
            rows.append(cells)
    return rows


MESHES = manifest("meshes", 8)
SCANS = manifest("range_scans", 9)


def test_manifests_are_read(realdata: RealData) -> None:
    assert (len(MESHES), len(SCANS)) == (24, 40)


@pytest.mark.parametrize("row", MESHES, ids=lambda row: row[0])
def test_counts_of_the_manifest(realdata: RealData, row: list[str]) -> None:
    report = io.read_report(realdata(f"meshes/{row[0]}"))
    mesh = report.mesh
    assert [mesh.num_vertices, mesh.num_faces, report.num_polygons] == [int(c) for c in row[1:4]]
    measured = "properties of element vertex are left out: "
    assert [text for text in report.warnings if not text.startswith(measured)] == []
    for material in mesh.materials:
        for texture in material.textures.values():
            found = io.texture_path(mesh, texture)
            assert found is not None or "truman" in row[0] or "flash2a" in row[0]


@pytest.mark.parametrize("row", SCANS, ids=lambda row: row[0])
def test_range_scans(realdata: RealData, row: list[str]) -> None:
    path = realdata(f"range_scans/{row[0]}")
    cols, rows = map(int, row[1].split(" x "))
    num_vertices, full, three, triangles = map(int, row[2:6])
    report = io.read_report(path)
    assert report.mesh.num_vertices == num_vertices
    assert report.mesh.num_faces == triangles
    assert report.num_polygons == full + three
    assert report.num_skipped == (0 if row[6] == "-" else int(row[6]))
    grid = io.read_range_grid(path)
    assert grid.valid.shape == (rows, cols)
    np.testing.assert_array_equal(grid.points[grid.valid], report.mesh.vertices)
    # The scanner looks along -z: faces turn towards it.
    a, b, c = (report.mesh.vertices[report.mesh.faces[:, k]] for k in range(3))
    assert np.mean(np.cross(b - a, c - a)[:, 2] > 0) > 0.99


def newell(points: np.ndarray) -> np.ndarray:
    return np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)


def test_polygons_of_e2c_are_not_turned_inside_out(realdata: RealData) -> None:
    import lzma

    path = realdata("meshes/flightgear/E-2C/E-2C.obj.xz")
    mesh = manip3d.read_mesh(path)
    vertices, polygons = [], []
    for line in lzma.decompress(path.read_bytes()).decode().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        if words[:1] == ["f"]:
            polygons.append([int(w.split("/")[0]) - 1 for w in words[1:]])
    positions = np.array(vertices)
    np.testing.assert_array_equal(mesh.vertices, positions)
    face = flipped = fan_flipped = 0
    for polygon in polygons:
        corners = positions[polygon] - positions[polygon[0]]
        normal = newell(corners)
        triangles = mesh.faces[face : face + len(polygon) - 2]
        assert set(triangles.ravel()) == set(polygon)
        face += len(polygon) - 2
        p = positions[triangles]
        normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        flipped += bool((normals @ normal < 0).any())
        fan = np.cross(corners[1:-1], corners[2:])
        fan_flipped += bool((fan @ normal < 0).any())
    assert face == mesh.num_faces
    assert fan_flipped > 100
    assert flipped < fan_flipped / 4


TRIMESH_FILES = ["spot/spot_triangulated.obj", "rocker_arm/rockerArm.ply.xz",
                 "stanford/bun_zipper.ply.xz", "stanford/xyzrgb_dragon_100k.ply.xz",
                 "nonmanifold/abominevole.off.xz", "stanford/armadillo_86k.obj.xz"]  # fmt: skip


@pytest.mark.parametrize("name", TRIMESH_FILES)
def test_same_as_trimesh(realdata: RealData, name: str) -> None:
    import gzip
    import io as streams
    import lzma

    trimesh = pytest.importorskip("trimesh")
    path = realdata(f"meshes/{name}")
    opened = {".xz": lzma.open, ".gz": gzip.open}.get(path.suffix, open)
    with opened(path, "rb") as file:
        stream = streams.BytesIO(file.read())
    kind = name.removesuffix(".xz").rsplit(".", 1)[1]
    other = trimesh.load(stream, file_type=kind, process=False, maintain_order=True)
    mesh = manip3d.read_mesh(path)
    assert len(other.faces) == mesh.num_faces
    np.testing.assert_allclose(
        other.vertices[other.faces], mesh.vertices[mesh.faces], rtol=1e-6, atol=1e-7
    )


def test_same_as_open3d(realdata: RealData, tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d")
    for name in ("rocker_arm/rockerArm.ply.xz", "nonmanifold/abominevole.off.xz"):
        mesh = manip3d.read_mesh(realdata(f"meshes/{name}"))
        for suffix in ("ply", "off", "stl", "obj"):
            path = tmp_path / f"m.{suffix}"
            mesh.write(path)
            other = open3d.io.read_triangle_mesh(str(path))
            theirs = np.asarray(other.vertices)[np.asarray(other.triangles)]
            np.testing.assert_allclose(
                theirs, mesh.vertices[mesh.faces], rtol=1e-6, atol=1e-7, err_msg=suffix
            )


def test_meshlab_reads_our_ply_with_texture_coordinates(realdata: RealData, tmp_path: Path) -> None:
    pymeshlab = pytest.importorskip("pymeshlab", reason="PyMeshLab is not installed (peers)")
    path = realdata("meshes/face_multitexture/face.obj")
    mesh = manip3d.read_mesh(path)
    mesh.write(tmp_path / "face.ply")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "face.ply"))
    other = meshes.current_mesh()
    assert (other.vertex_number(), other.face_number()) == (mesh.num_vertices, mesh.num_faces)
    assert mesh.texcoords is not None
    assert mesh.face_texcoords is not None
    ours = mesh.texcoords[mesh.face_texcoords]
    theirs = np.asarray(other.wedge_tex_coord_matrix()).reshape(-1, 3, 2)
    np.testing.assert_allclose(theirs, ours, atol=1e-6)
    assert other.texture_number() == len(mesh.materials) == 4
