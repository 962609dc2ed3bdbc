"""Written files open in trimesh, Open3D and VTK, with all attributes that these support."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manip3d
from gltf_files import glb_parts
from manip3d import Material, Mesh, MissingExtraError, Texture
from manip3d.io import WRITABLE
from real_data import RealData

PARTLY_TEXTURED = Mesh(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]],
    [[0, 1, 2], [0, 2, 3], [0, 3, 1]],
    texcoords=[[0, 0], [1, 0], [1, 1], [0.5, 0.25]],
    face_texcoords=[[0, 1, 2], [3, 2, 0], [-1, -1, -1]],
    face_material=[0, 1, 0],
    materials=[Material("skin"), Material("cloth")],
)


def vtk_surface(path: Path) -> Any:
    """Read a file with VTK; return one vtkPolyData."""
    vtk = pytest.importorskip("vtk")
    readers = {
        ".obj": "vtkOBJReader",
        ".ply": "vtkPLYReader",
        ".off": "vtkOFFReader",
        ".stl": "vtkSTLReader",
    }
    if path.suffix not in readers:
        reader = vtk.vtkGLTFReader()
        reader.SetFileName(str(path))
        surface = vtk.vtkCompositeDataGeometryFilter()
        surface.SetInputConnection(reader.GetOutputPort())
    else:
        reader = surface = getattr(vtk, readers[path.suffix])()
        reader.SetFileName(str(path))
    complaints: list[str] = []
    for level in ("WarningEvent", "ErrorEvent"):
        reader.AddObserver(level, lambda _, event: complaints.append(event))
    surface.Update()
    assert not complaints
    return surface.GetOutput()


@pytest.mark.parametrize("face_material", [[0, -1, 1], [-1, 0, 1], [0, 1, -1]])
def test_faces_without_a_material_get_none_of_the_others_in_obj(
    face_material: list[int], tmp_path: Path
) -> None:
    trimesh = pytest.importorskip("trimesh")
    open3d = pytest.importorskip("open3d")
    path = tmp_path / "mesh.obj"
    triangles = np.arange(9).reshape(3, 3)
    colored = [Material("red", (1, 0, 0, 1)), Material("blue", (0, 0, 1, 1))]
    mesh = Mesh(
        [[x, y, 0] for i in range(3) for x, y in ((i, 0), (i + 1, 0), (i, 1))],
        triangles,
        face_material=face_material,
        materials=colored,
    )
    mesh.write(path)
    expected = [[(1, 0, 0), (0, 0, 1), (1, 1, 1)][i] for i in face_material]

    scene = trimesh.load(path, process=False, force="scene")
    by_place = {
        float(part.bounds[0, 0]): tuple(part.visual.material.diffuse[:3] / 255)
        for part in scene.dump()
    }
    assert [by_place[i] for i in range(3)] == expected
    model = open3d.io.read_triangle_model(str(path))
    by_place = {
        float(part.mesh.get_min_bound()[0]): tuple(
            model.materials[part.material_idx].base_color[:3].tolist()
        )
        for part in model.meshes
    }
    assert [by_place[i] for i in range(3)] == expected

    back = manip3d.read_mesh(path)
    np.testing.assert_array_equal(back.faces, triangles)
    assert back.face_material is not None
    names = [back.materials[i].name if i >= 0 else None for i in back.face_material]
    assert names == [colored[i].name if i >= 0 else None for i in face_material]
    assert len(back.materials) == 2


@pytest.mark.parametrize("suffix", WRITABLE)
def test_every_format_opens_elsewhere(suffix: str, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    open3d = pytest.importorskip("open3d")
    path = tmp_path / f"mesh{suffix}"
    PARTLY_TEXTURED.write(path)
    assert len(trimesh.load(path, force="mesh").faces) == 3
    assert len(open3d.io.read_triangle_mesh(str(path)).triangles) == 3
    if suffix != ".off":  # VTK has no reader for it
        assert vtk_surface(path).GetNumberOfPolys() == 3


def test_a_ply_with_some_texture_coordinates_has_lists_of_one_length(tmp_path: Path) -> None:
    PARTLY_TEXTURED.write(tmp_path / "mesh.ply")
    back = manip3d.read_mesh(tmp_path / "mesh.ply")
    assert back.texcoords is not None
    assert back.face_texcoords is not None
    np.testing.assert_array_equal(back.face_texcoords[2], [-1, -1, -1])
    np.testing.assert_array_equal(
        back.texcoords[back.face_texcoords[:2]],
        [[[0, 0], [1, 0], [1, 1]], [[0.5, 0.25], [1, 1], [0, 0]]],
    )
    np.testing.assert_array_equal(back.face_material, [0, 1, 0])
    surface = vtk_surface(tmp_path / "mesh.ply")
    assert surface.GetPointData().GetTCoords() is not None


def test_no_flag_where_all_faces_have_texture_coordinates(tmp_path: Path) -> None:
    whole = PARTLY_TEXTURED.replace(face_texcoords=[[0, 1, 2], [3, 2, 0], [0, 0, 0]])
    whole.write(tmp_path / "mesh.ply")
    assert b"has_texcoord" not in (tmp_path / "mesh.ply").read_bytes()


def linear(color: np.ndarray) -> np.ndarray:
    """Convert sRGB bytes to linear light [IEC 61966-2-1]."""
    y = color / 255.0
    return np.where(y <= 0.04045, y / 12.92, ((y + 0.055) / 1.055) ** 2.4)


def test_vertex_colors_of_a_glb_are_right_elsewhere(tmp_path: Path) -> None:
    """Colours are stored as linear light, as glTF requires, and not in 16 bits.

    trimesh reads 16 bits modulo 256.
    """
    trimesh = pytest.importorskip("trimesh")
    open3d = pytest.importorskip("open3d")
    colors = np.array([[0, 0, 0], [10, 60, 128], [128, 200, 255], [255, 255, 255]], np.uint8)
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [2, 1, 3]], colors=colors)
    path = tmp_path / "mesh.glb"
    mesh.write(path)
    seen = trimesh.load(path, force="mesh").visual.vertex_colors[:, :3]
    np.testing.assert_allclose(seen / 255.0, linear(colors), atol=0.6 / 255)
    seen = np.asarray(open3d.io.read_triangle_mesh(str(path)).vertex_colors)
    np.testing.assert_allclose(seen, linear(colors), atol=1e-4)
    array = vtk_surface(path).GetPointData().GetArray("COLOR_0")
    seen = np.array([array.GetTuple(i)[:3] for i in range(4)])
    np.testing.assert_allclose(seen, linear(colors), atol=1e-4)


def tga(width: int, height: int, color: tuple[int, int, int]) -> bytes:
    """An uncompressed true-colour TGA file."""
    head = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, width, height, 24, 0)
    return head + bytes(reversed(color)) * (width * height)


def images_of_glb(path: Path) -> list[bytes]:
    document, buffer = glb_parts(path.read_bytes())
    views = [document["bufferViews"][image["bufferView"]] for image in document["images"]]
    return [buffer[v["byteOffset"] : v["byteOffset"] + v["byteLength"]] for v in views]


@pytest.fixture
def with_tga(tmp_path: Path) -> Mesh:
    (tmp_path / "bike.tga").write_bytes(tga(3, 2, (200, 100, 50)))
    return PARTLY_TEXTURED.replace(
        materials=[
            Material("a", textures={"base_color": Texture("bike.tga")}),
            Material("b", textures={"base_color": Texture("bike.tga")}),
        ],
        source=str(tmp_path / "bike.obj"),
    )


def test_tga_textures_survive_into_gltf(with_tga: Mesh, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    (tmp_path / "out").mkdir()
    with_tga.write(tmp_path / "out" / "bike.glb")
    (content,) = images_of_glb(tmp_path / "out" / "bike.glb")
    picture = image.open(io.BytesIO(content))
    assert picture.format == "PNG"
    assert picture.size == (3, 2)
    assert picture.getpixel((1, 1)) == (200, 100, 50)
    with_tga.write(tmp_path / "out" / "bike.gltf")
    assert (tmp_path / "out" / "bike.png").read_bytes() == content
    with_tga.write(tmp_path / "out" / "bike.obj")  # other formats keep the file
    assert (tmp_path / "out" / "bike.tga").read_bytes() == (tmp_path / "bike.tga").read_bytes()


def test_open3d_gets_tga_textures(with_tga: Mesh) -> None:
    pytest.importorskip("open3d")
    texture = np.asarray(with_tga.to_open3d().textures[0])
    assert texture.shape == (2, 3, 3)
    assert texture[0, 0].tolist() == [200, 100, 50]


def test_without_pillow_a_tga_texture_is_no_silent_loss(
    with_tga: Mesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    with pytest.raises(MissingExtraError, match="pillow"):
        with_tga.write(tmp_path / "bike.glb")
    assert not (tmp_path / "bike.glb").exists()


def test_an_image_that_nobody_can_read_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = PARTLY_TEXTURED.replace(
        materials=[Material("a", textures={"base_color": Texture("a.tga", b"no image")})] * 2
    )
    mesh.write(tmp_path / "mesh.glb")
    assert "'a.tga' cannot be converted to PNG" in caplog.text
    assert manip3d.read_mesh(tmp_path / "mesh.glb").materials[0].textures == {}


def test_an_image_that_claims_to_be_huge_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bomb = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 65535, 65535, 24, 0) + bytes(100)
    mesh = PARTLY_TEXTURED.replace(
        materials=[Material("a", textures={"base_color": Texture("a.tga", bomb)})] * 2
    )
    mesh.write(tmp_path / "mesh.glb")
    assert "'a.tga' cannot be converted to PNG" in caplog.text
    assert manip3d.read_mesh(tmp_path / "mesh.glb").materials[0].textures == {}


def test_a_converted_image_keeps_its_alpha(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    original = image.new("PA", (2, 1))
    original.putpalette([200, 100, 50] + 255 * [0, 0, 0])
    original.putpixel((0, 0), (0, 255))
    original.putpixel((1, 0), (0, 64))
    stream = io.BytesIO()
    original.save(stream, format="TIFF")
    mesh = PARTLY_TEXTURED.replace(
        materials=[Material("a", textures={"base_color": Texture("a.tif", stream.getvalue())})] * 2
    )
    mesh.write(tmp_path / "mesh.glb")
    (content,) = images_of_glb(tmp_path / "mesh.glb")
    picture = image.open(io.BytesIO(content))
    assert [picture.getpixel((u, 0)) for u in range(2)] == [(200, 100, 50, 255), (200, 100, 50, 64)]


@pytest.mark.realdata
def test_the_wild_files_open_elsewhere(realdata: RealData, tmp_path: Path) -> None:
    """A PLY with faces with and without UVs and a GLB with TGA images open in other programs."""
    trimesh = pytest.importorskip("trimesh")
    panel = manip3d.read_mesh(realdata("meshes/wild/panel/panel.obj.xz"))
    panel.write(tmp_path / "panel.ply")
    assert len(trimesh.load(tmp_path / "panel.ply").faces) == panel.num_faces
    assert vtk_surface(tmp_path / "panel.ply").GetNumberOfPolys() == panel.num_faces
    bike = manip3d.read_mesh(realdata("meshes/wild/HarleyDavidson/Harley-Davidson.obj.xz"))
    bike.write(tmp_path / "bike.glb")
    assert len(images_of_glb(tmp_path / "bike.glb")) == 4
