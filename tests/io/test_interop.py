"""Meshes to Open3D and trimesh and back."""

from __future__ import annotations

import io
import itertools
import sys
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d
from gltf_files import PNG
from manip3d import InputError, Material, Mesh, Texture
from zoo import arrays_of


def picture() -> bytes:
    image = pytest.importorskip("PIL.Image")
    stream = io.BytesIO()
    image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(stream, "PNG")
    return stream.getvalue()


def pixels(texture: Texture) -> NDArray[np.uint8]:
    image = pytest.importorskip("PIL.Image")
    assert texture.data is not None
    return np.asarray(image.open(io.BytesIO(texture.data)))


def corner_texcoords(mesh: Mesh) -> NDArray[np.float64]:
    assert mesh.texcoords is not None
    assert mesh.face_texcoords is not None
    with_none: NDArray[np.float64] = np.vstack([mesh.texcoords, [[np.nan, np.nan]]])
    return with_none[mesh.face_texcoords]


def make(**changes: Any) -> Mesh:
    """A tetrahedron: a seam at vertex 0, two materials, and a face without UVs."""
    parts: dict[str, Any] = {
        "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "faces": [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        "texcoords": [[0, 0], [1, 0], [0, 1], [0.5, 0.25]],
        "face_texcoords": [[0, 2, 1], [3, 1, 2], [-1, -1, -1], [1, 2, 0]],
        "face_material": [0, 1, 0, 1],
        "materials": [
            Material("skin", textures={"base_color": Texture(data=picture())}),
            Material("glass", (1.0, 0.4, 0.2, 0.6), 0.25, 0.5, "mask", 0.75, double_sided=False),
        ],
    }
    return Mesh(**{**parts, **changes})


def overwrite(arrays: Iterable[NDArray[Any] | None]) -> None:
    """Set all numbers to 0, which are valid indices, too."""
    for array in arrays:
        if array is not None:
            array[:] = 0


def assert_not_changed_by(change: Callable[[], object], mesh: Mesh) -> None:
    before = {name: array.copy() for name, array in arrays_of(mesh).items()}
    change()
    for name, array in arrays_of(mesh).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


COLORS = [[0, 0, 0], [255, 254, 253], [1, 2, 3], [128, 129, 130]]
PLAIN: dict[str, Any] = {
    "texcoords": None,
    "face_texcoords": None,
    "face_material": None,
    "materials": (),
}


class TestOpen3d:
    pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

    @pytest.fixture(autouse=True)
    def _open3d(self) -> None:
        pytest.importorskip("open3d")

    def test_round_trip(self) -> None:
        mesh = make(colors=COLORS)
        again = Mesh.from_open3d(mesh.to_open3d())
        np.testing.assert_array_equal(again.vertices, mesh.vertices)
        np.testing.assert_array_equal(again.faces, mesh.faces)
        np.testing.assert_array_equal(corner_texcoords(again), corner_texcoords(mesh))
        np.testing.assert_array_equal(again.face_material, mesh.face_material)
        np.testing.assert_array_equal(again.colors, mesh.colors)
        assert [m.name for m in again.materials] == ["material_0", "material_1"]
        assert again.materials[1].textures == {}
        np.testing.assert_array_equal(
            pixels(again.materials[0].textures["base_color"]),
            pixels(mesh.materials[0].textures["base_color"]),
        )

    def test_open3d_keeps_images_bottom_up(self) -> None:
        image = np.asarray(make().to_open3d().textures[0])
        np.testing.assert_array_equal(image[::-1], np.arange(48).reshape(4, 4, 3))

    def test_without_attributes(self) -> None:
        mesh = make(**PLAIN)
        again = Mesh.from_open3d(mesh.to_open3d())
        np.testing.assert_array_equal(again.faces, mesh.faces)
        assert again.texcoords is again.face_material is again.colors is again.normals is None
        assert again.materials == ()

    def test_normals_where_each_vertex_has_one(self) -> None:
        normals = np.eye(4, 3) + 1
        mesh = make(normals=normals, face_normals=make().faces)
        again = Mesh.from_open3d(mesh.to_open3d())
        assert again.normals is not None
        np.testing.assert_array_equal(again.normals[again.face_normals], normals[mesh.faces])
        creased = make(normals=normals, face_normals=[[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]])
        assert not creased.to_open3d().has_vertex_normals()

    def test_missing_images_are_empty(self) -> None:
        material = Material(textures={"base_color": Texture(path="missing.png")})
        mesh = make(materials=[material, *make().materials], source="nowhere/mesh.obj")
        textures = mesh.to_open3d().textures
        assert [image.is_empty() for image in textures] == [True, False, True]

    def test_no_memory_is_shared(self) -> None:
        """The faces pointed into Open3D's buffer, which it changes and frees."""
        made = make(colors=COLORS, normals=np.eye(4, 3) + 1, face_normals=make().faces)
        source = made.to_open3d()
        mesh = Mesh.from_open3d(source)
        lent = [
            np.asarray(getattr(source, name))
            for name in (
                *("vertices", "triangles", "vertex_normals", "vertex_colors"),
                *("triangle_uvs", "triangle_material_ids"),
            )
        ]
        assert all(array.any() for array in lent)
        assert_not_changed_by(lambda: assert_not_changed_by(lambda: overwrite(lent), mesh), made)
        for one, other in itertools.combinations(arrays_of(mesh).values(), 2):
            assert not np.shares_memory(one, other)

    def test_a_mesh_outlives_its_source(self) -> None:
        import open3d as o3d

        source = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=30)
        source.remove_triangles_by_index(list(range(500)))
        mesh = Mesh.from_open3d(source)
        assert_not_changed_by(source.remove_unreferenced_vertices, mesh)
        assert_not_changed_by(source.clear, mesh)

    def test_tensor_meshes(self) -> None:
        import open3d as o3d

        mesh = make(**PLAIN)
        tensor = o3d.t.geometry.TriangleMesh.from_legacy(mesh.to_open3d())
        np.testing.assert_array_equal(Mesh.from_open3d(tensor).faces, mesh.faces)

    def test_others_are_refused(self) -> None:
        with pytest.raises(manip3d.InputError, match="source: expected an Open3D TriangleMesh"):
            Mesh.from_open3d("mesh")
        trimesh = pytest.importorskip("trimesh")  # whose meshes have triangles, too
        with pytest.raises(manip3d.InputError, match="source: expected an Open3D TriangleMesh"):
            Mesh.from_open3d(trimesh.creation.box())


class TestTrimesh:
    @pytest.fixture(autouse=True)
    def _trimesh(self) -> None:
        pytest.importorskip("trimesh")

    def test_light_that_a_surface_sends_out(self) -> None:
        image = {"emissive": Texture(data=picture())}
        lamp, screen = (
            Material("lamp", emissive=(1.0, 0.5, 0.0)),
            Material("screen", textures=image),
        )
        again = Mesh.from_trimesh(make(materials=[lamp, screen]).to_trimesh())
        found = {material.name: material.emissive for material in again.materials}
        assert found == {"lamp": (1.0, 0.5, 0.0), "screen": (1.0, 1.0, 1.0)}
        plain = Mesh.from_trimesh(make().to_trimesh())
        assert {material.emissive for material in plain.materials} == {(0.0, 0.0, 0.0)}

    def test_parts_of_a_scene(self) -> None:
        """One geometry per material and having UVs; faces keep their order in each."""
        mesh = make(colors=COLORS)
        scene = mesh.to_trimesh()
        sizes = [(len(g.vertices), len(g.faces)) for g in scene.geometry.values()]
        assert sizes == [(3, 1), (3, 1), (5, 2)]
        again = Mesh.from_trimesh(scene)
        order = [2, 0, 1, 3]
        np.testing.assert_array_equal(again.vertices[again.faces], mesh.vertices[mesh.faces][order])
        np.testing.assert_array_equal(corner_texcoords(again), corner_texcoords(mesh)[order])
        np.testing.assert_array_equal(again.face_material, [0, 0, 1, 1])
        assert again.colors is not None
        assert mesh.colors is not None
        np.testing.assert_array_equal(again.colors[again.faces], mesh.colors[mesh.faces][order])

    def test_materials(self) -> None:
        mesh = make()
        skin, glass = Mesh.from_trimesh(mesh.to_trimesh()).materials
        assert glass == mesh.materials[1]  # 0.4, 0.2, 0.6 are whole in 255ths
        assert (skin.name, skin.base_color) == ("skin", (1.0, 1.0, 1.0, 1.0))
        np.testing.assert_array_equal(
            pixels(skin.textures["base_color"]),
            pixels(mesh.materials[0].textures["base_color"]),
        )

    def test_one_part_is_one_mesh(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        mesh = make(**PLAIN)
        one = mesh.to_trimesh()
        assert isinstance(one, trimesh.Trimesh)
        assert one.is_watertight
        np.testing.assert_array_equal(Mesh.from_trimesh(one).faces, mesh.faces)

    def test_without_materials(self) -> None:
        mesh = make(face_material=None, materials=(), face_texcoords=make().faces)
        again = Mesh.from_trimesh(mesh.to_trimesh())
        assert again.materials == ()
        assert again.face_material is None
        np.testing.assert_array_equal(corner_texcoords(again), corner_texcoords(mesh))

    @pytest.mark.parametrize("geometry_only", [False, True])
    @pytest.mark.parametrize("parts", [PLAIN, PLAIN | {"faces": []}, {}])
    def test_no_memory_is_shared(self, parts: dict[str, Any], geometry_only: bool) -> None:
        """A change of units of trimesh's mesh changed that of the mesh."""
        made = make(colors=COLORS, **parts)
        source = made.to_trimesh(geometry_only=geometry_only)
        mesh = Mesh.from_trimesh(source)
        pieces = list(source.geometry.values()) if hasattr(source, "geometry") else [source]

        def change() -> None:
            for piece in pieces:
                piece.vertices *= 1000.0
                piece.invert()
                lent = [piece.vertices, piece.faces, getattr(piece.visual, "uv", None)]
                colors = [piece.visual.vertex_colors] if piece.visual.kind == "vertex" else []
                overwrite([*lent, *colors, *piece.vertex_attributes.values()])

        assert_not_changed_by(lambda: assert_not_changed_by(change, mesh), made)

    def test_geometry_only(self) -> None:
        mesh = make(colors=COLORS)
        one = mesh.to_trimesh(geometry_only=True)
        np.testing.assert_array_equal(one.vertices, mesh.vertices)
        np.testing.assert_array_equal(one.faces, mesh.faces)
        np.testing.assert_array_equal(one.visual.vertex_colors[:, :3], COLORS)
        np.testing.assert_array_equal(Mesh.from_trimesh(one).colors, COLORS)

    def test_the_graph_of_a_scene_places_its_meshes(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        mesh = make(**PLAIN)
        scene = trimesh.Scene()
        mirror = np.diag([-1.0, 1, 1, 1])
        mirror[:3, 3] = [5, 0, 0]
        scene.add_geometry(mesh.to_trimesh())
        scene.add_geometry(mesh.to_trimesh(), transform=mirror)
        again = Mesh.from_trimesh(scene)
        assert again.num_faces == 8
        np.testing.assert_array_equal(again.vertices[5], [4, 0, 0])
        np.testing.assert_array_equal(again.faces[4:], mesh.faces[:, ::-1] + 4)

    def test_empty(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        assert len(Mesh([], []).to_trimesh().faces) == 0
        assert Mesh.from_trimesh(trimesh.Scene()).num_faces == 0

    def test_others_are_refused(self) -> None:
        with pytest.raises(manip3d.InputError, match=r"source: expected a trimesh\.Trimesh"):
            Mesh.from_trimesh("mesh")


UVS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] * 2)


class TestWhatAMeshCannotHold:
    """It survives, or a warning says what is left out."""

    pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

    def test_colours_of_faces(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        box = trimesh.creation.box()
        box.visual.face_colors = np.array([[255, 0, 0, 255], [0, 0, 255, 255]] * 6, np.uint8)
        mesh = Mesh.from_trimesh(trimesh.Scene([box, trimesh.creation.box()]))
        assert mesh.colors is None
        assert [m.name for m in mesh.materials] == ["color_FF0000", "color_0000FF"]
        assert mesh.materials[0].base_color == (1.0, 0.0, 0.0, 1.0)
        assert mesh.face_material is not None
        assert mesh.face_material.tolist() == [0, 1] * 6 + [-1] * 12

    def test_colours_of_faces_beside_those_of_vertices(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        box, other = trimesh.creation.box(), trimesh.creation.box()
        box.visual.face_colors = np.full((12, 4), 255, np.uint8)
        other.visual.vertex_colors = np.full((8, 4), 255, np.uint8)
        with pytest.warns(UserWarning, match="left out: colours of faces") as warned:
            Mesh.from_trimesh(trimesh.Scene([box, other]))
        assert warned[0].filename == __file__

    def test_colours_of_very_many_faces(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        ball = trimesh.creation.icosphere(3)
        count = len(ball.faces)
        colors = [[i % 256, i // 256, 10, 255] for i in range(count)]
        ball.visual.face_colors = np.array(colors, np.uint8)
        with pytest.warns(UserWarning, match="more than 256 colors") as warned:
            mesh = Mesh.from_trimesh(ball)
        assert mesh.colors is not None
        assert (mesh.colors[:, 2] == 10).all()
        assert warned[0].filename == __file__

    def test_transparency_of_vertices(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        box = trimesh.creation.box()
        box.visual.vertex_colors = np.full((8, 4), 90, np.uint8)
        with pytest.warns(UserWarning, match="left out: transparency"):
            colors = Mesh.from_trimesh(box).colors
        assert colors is not None
        assert (colors == 90).all()

    def test_a_scene_of_which_one_part_has_colours(self) -> None:
        """None had any then."""
        trimesh = pytest.importorskip("trimesh")
        box, ball = trimesh.creation.box(), trimesh.creation.icosphere(1)
        box.visual.vertex_colors = np.tile(np.uint8([90, 255, 255, 255]), (8, 1))
        colors = Mesh.from_trimesh(trimesh.Scene([box, ball])).colors
        assert colors is not None
        assert np.unique(colors, axis=0).tolist() == [[90, 255, 255], [255, 255, 255]]

    def test_points_of_a_scene(self) -> None:
        trimesh = pytest.importorskip("trimesh")
        scene = trimesh.Scene([trimesh.creation.box(), trimesh.PointCloud(np.eye(3))])
        with pytest.warns(UserWarning, match="left out: 1 of 2 geometries"):
            assert Mesh.from_trimesh(scene).num_faces == 12

    def test_several_materials_of_one_trimesh(self) -> None:
        """The first one was that of all faces."""
        trimesh = pytest.importorskip("trimesh")
        material = trimesh.visual.material
        several = material.MultiMaterial([material.PBRMaterial(name=name) for name in "ab"])
        box = trimesh.creation.box()
        box.visual = trimesh.visual.TextureVisuals(
            uv=UVS, material=several, face_materials=np.arange(12) % 2
        )
        mesh = Mesh.from_trimesh(box)
        assert [each.name for each in mesh.materials] == ["a", "b"]
        assert mesh.face_material is not None
        assert mesh.face_material.tolist() == [0, 1] * 6

    def test_materials_of_obj_files_keep_their_names_and_are_no_metals(self) -> None:
        """trimesh converts them to glTF's model without name and metalness."""
        trimesh = pytest.importorskip("trimesh")
        material = trimesh.visual.material
        wood = material.SimpleMaterial(name="wood", diffuse=(102, 51, 0, 255))
        box, other = trimesh.creation.box(), trimesh.creation.box()
        box.visual = trimesh.visual.TextureVisuals(uv=UVS, material=wood)
        other.visual = trimesh.visual.TextureVisuals(
            uv=UVS, material=material.PBRMaterial(name="gltf")
        )
        first, second = Mesh.from_trimesh(trimesh.Scene([box, other])).materials
        assert (first.name, first.metallic) == ("wood", 0.0)
        assert first.base_color == pytest.approx((0.4, 0.2, 0.0, 1.0))
        assert (second.name, second.metallic) == ("gltf", 1.0)

    def test_the_grey_of_absent_colours_does_not_darken(self) -> None:
        """A SimpleMaterial without colours has trimesh's default, as of an .obj without .mtl."""
        trimesh = pytest.importorskip("trimesh")
        image = pytest.importorskip("PIL.Image").new("RGB", (2, 2), (255, 0, 0))
        visual, box = trimesh.visual, trimesh.creation.box()
        box.visual = visual.TextureVisuals(uv=UVS, image=image)
        (textured,) = Mesh.from_trimesh(box).materials
        assert textured.base_color == (1.0, 1.0, 1.0, 1.0)
        assert "base_color" in textured.textures
        for name, expected in ((None, []), ("wood", ["wood"])):
            material = visual.material.SimpleMaterial(name=name)
            box.visual = visual.TextureVisuals(uv=UVS, material=material)
            found = Mesh.from_trimesh(box).materials
            assert [each.name for each in found] == expected
            assert all(each.base_color == (1.0, 1.0, 1.0, 1.0) for each in found)

    def test_a_texture_for_print(self) -> None:
        """PNG has no cyan, magenta, yellow and black."""
        trimesh = pytest.importorskip("trimesh")
        image = pytest.importorskip("PIL.Image")
        box = trimesh.creation.box()
        box.visual = trimesh.visual.TextureVisuals(
            uv=UVS,
            material=trimesh.visual.material.PBRMaterial(
                baseColorTexture=image.new("CMYK", (2, 2), (0, 255, 255, 0))
            ),
        )
        (material,) = Mesh.from_trimesh(box).materials
        assert pixels(material.textures["base_color"])[0, 0].tolist() == [255, 0, 0]

    def test_a_single_texture_without_material_ids(self) -> None:
        """It was in the materials, and no face had it."""
        o3d = pytest.importorskip("open3d")
        triangle = Mesh(np.eye(3), [[0, 1, 2]]).to_open3d()
        triangle.triangle_uvs = o3d.utility.Vector2dVector(UVS[:3])
        photo = o3d.geometry.Image(np.full((2, 2, 3), 9, np.uint8))
        triangle.textures = [photo]
        mesh = Mesh.from_open3d(triangle)
        assert mesh.face_material is not None
        assert mesh.face_material.tolist() == [0]
        triangle.textures = [photo, photo]
        with pytest.warns(UserWarning, match="left out: which face has which of the 2 textures"):
            assert Mesh.from_open3d(triangle).face_material is None

    def test_the_material_of_a_tensor_mesh(self) -> None:
        """It was lost without a word."""
        o3d = pytest.importorskip("open3d")
        legacy = Mesh(np.eye(3), [[0, 1, 2]]).to_open3d()
        triangle = o3d.t.geometry.TriangleMesh.from_legacy(legacy)
        triangle.triangle.texture_uvs = o3d.core.Tensor(UVS[None, :3].astype(np.float32))
        triangle.triangle.colors = o3d.core.Tensor(np.zeros((1, 3), np.float32))
        triangle.material.set_default_properties()
        triangle.material.material_name = "defaultLit"
        triangle.material.scalar_properties["metallic"] = 0.25
        photo = o3d.t.geometry.Image(np.full((2, 2, 3), 9, np.uint8))
        triangle.material.texture_maps["albedo"] = photo
        triangle.material.texture_maps["metallic"] = photo
        with pytest.warns(UserWarning, match="left out") as warned:
            mesh = Mesh.from_open3d(triangle)
        assert [str(each.message).partition("left out: ")[2] for each in warned] == [
            "colours of faces: a Mesh has them by vertex",
            "texture maps of the material: metallic",
        ]
        (material,) = mesh.materials
        assert material.metallic == 0.25
        assert pixels(material.textures["base_color"])[0, 0].tolist() == [9, 9, 9]
        assert mesh.face_material is not None
        assert mesh.face_material.tolist() == [0]


@pytest.mark.parametrize(
    ("package", "method", "cure"),
    [
        ("open3d", "to_open3d", r"manip3d\[simulate\]"),
        ("trimesh", "to_trimesh", r"manip3d\[io\]"),
        ("PIL.Image", "to_trimesh", r"pillow is needed here: pip install 'manip3d\[io\]'"),
    ],
)
def test_a_missing_package_names_its_cure(
    monkeypatch: pytest.MonkeyPatch, package: str, method: str, cure: str
) -> None:
    if method == "to_trimesh":
        pytest.importorskip("trimesh")
    skin = Material(textures={"base_color": Texture(data=PNG)})
    mesh = Mesh(np.eye(3), [[0, 1, 2]], face_material=[0], materials=[skin])
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(manip3d.MissingExtraError, match=cure):
        getattr(mesh, method)()


@pytest.mark.parametrize("shape", [(8,), (8, 1)])
def test_trimesh_colours_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    box = pytest.importorskip("trimesh").creation.box()
    box.vertex_attributes["color"] = np.full(shape, 7, np.uint8)
    with pytest.raises(InputError, match=r"expected \(V, 3\) or \(V, 4\) .* got \(8,"):
        Mesh.from_trimesh(box)
