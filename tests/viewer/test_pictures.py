"""Pictures show what they are asked to show. Measured on pixels, so any OpenGL driver will do."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyvista")
Image = pytest.importorskip("PIL.Image")

from square import square  # noqa: E402

from manip3d import (  # noqa: E402
    InputError,
    Material,
    Mesh,
    MissingExtraError,
    RenderError,
    Texture,
)
from manip3d._util import extras  # noqa: E402
from manip3d.viewer import comparison, picture, png_bytes, renderer  # noqa: E402
from manip3d.viewer.scene import boundary_edges, frame, rgb, srgb  # noqa: E402

WHITE = (255, 255, 255)

draws = pytest.mark.usefixtures("needs_renderer")


def png(pixels: object) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def front(mesh: Mesh, **options: object) -> np.ndarray:
    return picture(mesh, size=(120, 100), azimuth=0, elevation=0, background=WHITE, **options)


def covered(image: np.ndarray) -> float:
    return float((image != 255).any(axis=2).mean())


def looks(pixel: np.ndarray, name: str) -> bool:
    red, green, blue = (int(c) for c in pixel)
    return {
        "red": red > 2 * max(green, blue, 20),
        "green": green > 2 * max(red, blue, 20),
        "blue": blue > 2 * max(red, green, 20),
        "yellow": min(red, green) > 2 * max(blue, 20),
    }[name]


@draws
def test_the_mesh_fills_the_picture_and_not_more() -> None:
    image = front(square())
    rows, columns = np.nonzero((image != 255).any(axis=2))
    assert 90 <= np.ptp(rows) + 1 <= 98
    assert 90 <= np.ptp(columns) + 1 <= 98
    assert abs(rows.mean() - 49.5) < 1.0
    assert abs(columns.mean() - 59.5) < 1.0


@draws
@pytest.mark.parametrize("size", [(120, 100), (60, 200), (1, 1), (333, 7)])
def test_size_is_width_then_height(size: tuple[int, int]) -> None:
    image = picture(square(), size=size)
    assert image.shape == (size[1], size[0], 3)
    assert image.dtype == np.uint8


@draws
def test_textures_are_upright_and_each_on_its_own_faces() -> None:
    # Upper left face: red above blue. Lower right face: green above yellow.
    one = Texture(data=png([[[255, 0, 0]] * 4] * 2 + [[[0, 0, 255]] * 4] * 2))
    two = Texture(data=png([[[0, 255, 0]] * 4] * 2 + [[[255, 255, 0]] * 4] * 2))
    materials = tuple(Material(textures={"base_color": t}) for t in (one, two))
    image = front(square(materials=materials, face_material=[1, 0]))
    assert looks(image[15, 30], "red")
    assert looks(image[70, 17], "blue")
    assert looks(image[30, 100], "green")
    assert looks(image[85, 90], "yellow")


@draws
def test_faces_without_texture_coordinates_show_the_base_color() -> None:
    textured = Material(
        base_color=(0.0, 0.0, 1.0, 1.0), textures={"base_color": Texture(data=png([[WHITE] * 2]))}
    )
    mesh = square(materials=(textured,), face_material=[0, 0])
    mesh.face_texcoords[1] = -1
    image = front(mesh)
    assert looks(image[15, 30], "blue")
    assert looks(image[85, 90], "blue")


@draws
def test_a_missing_texture_warns_and_shows_the_base_color(tmp_path: Path) -> None:
    material = Material(
        base_color=(1.0, 0.0, 0.0, 1.0), textures={"base_color": Texture(path="gone.png")}
    )
    mesh = square(materials=(material,), face_material=[0, 0]).replace(
        source=str(tmp_path / "a.obj")
    )
    with pytest.warns(UserWarning, match=r"gone\.png cannot be read"):
        image = front(mesh)
    assert looks(image[50, 60], "red")


@draws
def test_a_texture_path_starts_in_the_folder_of_the_mesh(tmp_path: Path) -> None:
    (tmp_path / "green.png").write_bytes(png([[[0, 255, 0]]]))
    material = Material(textures={"base_color": Texture(path="green.png")})
    mesh = square(materials=(material,), face_material=[0, 0]).replace(
        source=str(tmp_path / "a.obj")
    )
    assert looks(front(mesh)[50, 60], "green")


@draws
def test_vertex_colors() -> None:
    image = front(square().replace(colors=[[255, 0, 0]] * 4))
    assert looks(image[50, 60], "red")


@draws
def test_base_color_is_linear() -> None:
    grey = front(square(materials=(Material(base_color=(0.2140, 0.2140, 0.2140, 1.0)),),
                      face_material=[0, 0]))[50, 60]  # fmt: skip
    white = front(square(materials=(Material(),), face_material=[0, 0]))[50, 60]
    np.testing.assert_allclose(grey / white, 0.5, atol=0.06)


@draws
def test_alpha_modes() -> None:
    half = png([[[255, 0, 0, 100]]])
    seen = {}
    for mode in ("opaque", "mask", "blend"):
        material = Material(alpha_mode=mode, textures={"base_color": Texture(data=half)})
        seen[mode] = front(square(materials=(material,), face_material=[0, 0]))[50, 60].astype(int)
    assert looks(seen["opaque"], "red")
    assert tuple(seen["mask"]) == WHITE  # 100 / 255 is below the cut-off
    assert seen["opaque"][1] + 60 < seen["blend"][1] < 240


@draws
def test_texture_false_draws_the_shape_alone() -> None:
    mesh = square(materials=(Material(base_color=(1, 0, 0, 1)),), face_material=[0, 0])
    pixel = front(mesh, texture=False)[50, 60].astype(int)
    assert np.ptp(pixel) < 20


@draws
def test_both_sides_are_lit_unless_backfaces_are_left_out() -> None:
    mesh = square()
    turned = mesh.replace(faces=mesh.faces[:, ::-1], face_texcoords=mesh.face_texcoords[:, ::-1])
    np.testing.assert_array_equal(front(mesh), front(turned))
    assert covered(front(turned, backfaces=False)) == 0.0


@draws
def test_boundary_edges_are_red_and_inner_edges_are_not() -> None:
    image = front(square(), boundary=True).astype(int)
    red = (image[..., 0] > image[..., 1] + 60) & (image[..., 0] > image[..., 2] + 60)
    rows, columns = np.nonzero(red)
    assert np.ptp(rows) > 85
    assert np.ptp(columns) > 85
    assert not red[40:60, 40:80].any()
    assert not (
        front(square()).astype(int)[..., 0] > front(square()).astype(int)[..., 1] + 60
    ).any()


@draws
def test_wireframe_draws_the_inner_edge() -> None:
    middle = np.s_[47:53, 57:63, 0]
    assert front(square(), wireframe=True)[middle].min() + 40 < front(square())[middle].min()


@draws
def test_smooth_and_flat_differ_on_a_bent_strip() -> None:
    x = np.linspace(-1, 1, 9)
    bow = np.column_stack([x, np.zeros(9), -(x**2) / 2])
    mesh = Mesh(
        np.vstack([bow, bow + np.array([0, 1, 0])]),
        [[i, i + 1, i + 10] for i in range(8)] + [[i, i + 10, i + 9] for i in range(8)],
    )
    steps = [
        np.count_nonzero(np.diff(front(mesh, shading=kind)[50, :, 0].astype(int)))
        for kind in ("smooth", "flat")
    ]
    assert steps[0] > 2 * steps[1]


@draws
def test_the_files_own_normals_are_used() -> None:
    tilted = square().replace(normals=[[0.8, -0.5, 0.3]], face_normals=np.zeros((2, 3), int))
    assert front(tilted)[50, 60].sum() + 60 < front(square())[50, 60].sum()


@draws
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("up", ["y", "z"])
def test_any_scale_and_place(scale: float, up: str) -> None:
    mesh = square().replace(vertices=square().vertices * scale + 5 * scale)
    image = picture(mesh, size=(80, 60), elevation=50, up=up, background=WHITE)
    assert 0.1 < covered(image) < 0.9


@draws
@pytest.mark.parametrize("scale", [1e-150, 1e-30, 1e30])
def test_extreme_sizes_look_like_any_other(scale: float) -> None:
    bend = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]])
    bent = square().replace(vertices=square().vertices + bend)
    scaled = bent.replace(vertices=bent.vertices * scale)
    options = {"size": (80, 60), "background": WHITE, "boundary": True}
    image = picture(scaled, **options).astype(int)
    np.testing.assert_allclose(image, picture(bent, **options), atol=3)


@draws
@pytest.mark.parametrize(
    "mesh",
    [
        Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),
        Mesh(np.zeros((3, 3)), [[0, 1, 2]]),
        Mesh(np.ones((3, 3)), [[0, 0, 0]]),
        Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]),
    ],
    ids=["empty", "point", "repeated index", "line"],
)
def test_degenerate_meshes_give_a_picture(mesh: Mesh) -> None:
    assert covered(picture(mesh, size=(40, 30), background=WHITE, boundary=True)) < 0.2


@draws
def test_zoom_shows_the_middle_larger() -> None:
    assert covered(front(square(), zoom=0.5)) < 0.3 * covered(front(square()))
    assert covered(front(square(), zoom=3.0)) == 1.0


@draws
def test_comparison_uses_one_camera_and_labels_each() -> None:
    small = square().replace(vertices=square().vertices * 0.5)
    sheet = comparison([square(), small, square()], ["a", "b", "c"], columns=2, size=(100, 80))
    assert sheet.shape == (2 * 110, 2 * 100, 3)
    filled = (sheet != rgb("#f5f6f8")).any(axis=2)
    first, second = filled[30:110, :100].sum(), filled[30:110, 100:].sum()
    assert second < 0.4 * first
    assert filled[:30, :100].any()
    assert not filled[110:, 100:].any()


@draws
def test_png_bytes_round_trip() -> None:
    image = front(square())
    with Image.open(io.BytesIO(png_bytes(image))) as read:
        np.testing.assert_array_equal(np.asarray(read), image)


@pytest.mark.parametrize("shape", [(4, 6), (4, 6, 3), (4, 6, 4)])
def test_png_bytes_of_each_kind_of_picture(shape: tuple[int, ...]) -> None:
    image = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    with Image.open(io.BytesIO(png_bytes(image))) as read:
        np.testing.assert_array_equal(np.asarray(read), image)
    with pytest.raises(InputError, match=r"image: expected a picture, \(H, W\), \(H, W, 3\) or"):
        png_bytes(image[..., :2] if len(shape) > 2 else image[0])


def test_boundary_edges_after_welding() -> None:
    mesh = square()
    assert len(boundary_edges(mesh)) == 4
    split = mesh.replace(  # as glTF stores a texture seam
        vertices=mesh.vertices[mesh.faces.ravel()], faces=np.arange(6).reshape(2, 3)
    )
    assert len(boundary_edges(split)) == 4
    assert len(boundary_edges(Mesh(mesh.vertices, [[0, 0, 1]]))) == 0


def test_frame_holds_every_vertex() -> None:
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.normal(size=(30, 3)) * [5, 1, 0.2] + 100, np.arange(30).reshape(10, 3))
    for up in ("y", "z"):
        camera = frame(mesh, (300, 200), 37.0, -25.0, 1.0, up)
        back = camera.position - camera.target
        back /= np.linalg.norm(back)
        right = np.cross(camera.up, back)
        seen = (mesh.vertices - camera.position) @ np.array([right, camera.up, -back]).T
        tangent = np.tan(np.radians(camera.view_angle / 2))
        assert (np.abs(seen[:, 1]) <= seen[:, 2] * tangent).all()
        assert (np.abs(seen[:, 0]) <= seen[:, 2] * tangent * 1.5).all()
        assert ((camera.near < seen[:, 2]) & (seen[:, 2] < camera.far)).all()


def test_srgb_known_values() -> None:
    np.testing.assert_allclose(srgb([0.0, 0.0031308, 0.2140, 1.0]), [0, 0.04045, 0.5, 1], atol=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (0, 10)}, "size"),
        ({"size": (10, 100000)}, "size"),
        ({"azimuth": float("nan")}, "azimuth"),
        ({"elevation": 91}, "elevation"),
        ({"zoom": 0}, "zoom"),
        ({"zoom": float("nan")}, "zoom"),
        ({"up": "x"}, "up"),
        ({"shading": "toon"}, "shading"),
        ({"background": "white"}, "background"),
        ({"background": (0, 0, 256)}, "background"),
        ({"background": (0.9, 0.9, 0.9)}, "background: .* whole numbers of 0 to 255"),
    ],
)
def test_bad_options_are_named(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        picture(square(), **options)


def test_comparison_needs_a_label_for_each_mesh() -> None:
    with pytest.raises(InputError, match="got 1 labels for 2 meshes"):
        comparison([square(), square()], ["one"])


def test_renderer_none_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    with pytest.raises(RenderError, match="MANIP3D_RENDERER=none"):
        picture(square())


def test_an_unknown_renderer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "povray")
    with pytest.raises(InputError, match="povray"):
        renderer()


@pytest.mark.parametrize("wanted", ["auto", "pyvista", "chromium"])
def test_without_the_extra_its_name_is_told(wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", wanted)
    monkeypatch.setattr(extras, "_is_installed", lambda name: name != "PIL")
    with pytest.raises(MissingExtraError, match=r"pip install 'manip3d\[viz\]'"):
        renderer()


def test_a_driver_that_fails_is_an_error_with_the_cure() -> None:
    code = "from manip3d.viewer import renderer; renderer()"
    child = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ
        | {"MANIP3D_RENDERER": "pyvista", "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        | {"__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull, "LIBGL_DRIVERS_PATH": os.devnull},
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 1
    assert "RenderError" in child.stderr
    assert "libegl1" in child.stderr
