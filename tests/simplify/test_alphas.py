"""Alpha of vertex colours in scenes: read, carried by simplified meshes, written again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from command_line import manip3d
from gltf_files import Scene
from manip3d import InputError, io, simplify
from posed_gltf import PosedGltf
from zoo import grid

SIDE = 16


def fading(alpha: Any, mode: str | None = "BLEND", rgb: tuple[float, ...] = (1, 1, 1)) -> Scene:
    """A flat sheet of side 1 whose vertices have the alpha ``alpha(x, y)``."""
    vertices, faces = grid(SIDE, SIDE)
    vertices /= SIDE
    made = Scene()
    looks = {} if mode is None else {"alphaMode": mode}
    made.json["materials"] = [{"name": "smoke", **looks}]
    alphas = alpha(vertices[:, 0], vertices[:, 1]) * np.ones(len(vertices))
    colors = np.column_stack([np.tile(rgb, (len(vertices), 1)), alphas])
    attributes = {
        "POSITION": made.accessor(vertices, min=[0, 0, 0], max=[1, 1, 0]),
        "COLOR_0": made.accessor(colors),
    }
    made.primitive(attributes, indices=made.accessor(faces.reshape(-1), "u4"), material=0)
    return made


def of_vertices(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and colours of the vertices of a file."""
    file = PosedGltf(path)
    every = [primitive["attributes"] for primitive in file.json["meshes"][0]["primitives"]]
    places = np.concatenate([file.accessor(own["POSITION"]) for own in every])
    return places, np.concatenate([file.accessor(own["COLOR_0"]) for own in every])


def mound(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 in the middle, 0 at the border."""
    return np.clip(4 * np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)), 0.0, 1.0)


@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr"])
def test_vertices_keep_the_alpha_of_their_place(tmp_path: Path, method: str) -> None:
    source, light = tmp_path / "sheet.glb", tmp_path / "light.glb"
    source.write_bytes(fading(lambda x, y: 0.25 + 0.5 * x, rgb=(1.0, 0.5, 0.0)).glb())
    scene = io.read_scene(source)
    assert scene.warnings == ()
    simplify.simplify_scene(scene, target_faces=60, method=method).scene.write(light)
    places, colors = of_vertices(light)
    assert len(places) < 100
    np.testing.assert_allclose(colors[:, 3], 0.25 + 0.5 * places[:, 0], atol=1e-5)
    np.testing.assert_allclose(colors[:, :3], np.tile([1.0, 0.5, 0.0], (len(places), 1)), atol=5e-3)


@pytest.mark.parametrize("rgb", [(1, 1, 1), (0, 0, 0)])
@pytest.mark.parametrize("method", ["quality", "fast"])
def test_a_flat_sheet_that_fades_at_its_border_stays_visible(
    tmp_path: Path, method: str, rgb: tuple[float, ...]
) -> None:
    """Its shape needs two faces, whose four corners are all transparent."""
    source = tmp_path / "sheet.glb"
    source.write_bytes(fading(mound, rgb=rgb).glb())
    scene = io.read_scene(source)
    done = simplify.simplify_scene(scene, target_faces=100, method=method).scene
    (mesh,), (alphas,) = done.meshes, done.alphas
    assert alphas is not None
    corners = mesh.vertices[mesh.faces]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    (before,), (own,) = scene.meshes, scene.alphas
    assert own is not None
    whole = own[before.faces].mean(axis=1).mean()  # all of its faces are equally large
    assert areas @ alphas[mesh.faces].mean(axis=1) == pytest.approx(whole, rel=0.1)


def test_a_hard_edge_of_alpha_stays_hard(tmp_path: Path) -> None:
    """Two sheets that meet, one of them half transparent, with vertices of their own."""
    made = fading(lambda x, y: 1.0)
    vertices, faces = grid(SIDE, SIDE)
    vertices = vertices / SIDE + [1, 0, 0]
    colors = np.tile([1.0, 1.0, 1.0, 0.5], (len(vertices), 1))
    attributes = {
        "POSITION": made.accessor(vertices, min=[1, 0, 0], max=[2, 1, 0]),
        "COLOR_0": made.accessor(colors),
    }
    made.primitive(attributes, indices=made.accessor(faces.reshape(-1), "u4"), material=0)
    (tmp_path / "two.glb").write_bytes(made.glb())
    done = simplify.simplify_scene(io.read_scene(tmp_path / "two.glb"), target_faces=20).scene
    (mesh,), (alphas,) = done.meshes, done.alphas
    assert alphas is not None
    assert mesh.num_faces <= 20
    is_right = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 1.0
    assert set(alphas[mesh.faces[is_right]].ravel()) == {0.5}
    assert set(alphas[mesh.faces[~is_right]].ravel()) == {1.0}


def test_a_mesh_without_colors_has_no_alpha(tmp_path: Path) -> None:
    source = tmp_path / "sheet.glb"
    source.write_bytes(fading(mound).glb())
    scene = io.read_scene(source)
    plain = scene.with_meshes({0: scene.meshes[0].replace(colors=None)})
    assert plain.alphas == (None,)
    assert simplify.simplify_scene(plain, target_faces=20).scene.meshes[0].num_faces <= 20


@pytest.mark.parametrize("mode", [None, "OPAQUE"])
def test_alpha_that_no_material_shows_is_no_loss(tmp_path: Path, mode: str | None) -> None:
    source = tmp_path / "sheet.glb"
    source.write_bytes(fading(mound, mode).glb())
    scene = io.read_scene(source)
    assert (scene.alphas, scene.warnings) == ((None,), ())
    assert io.read_report(source).warnings == ()


def test_a_mesh_says_that_it_holds_no_alpha(tmp_path: Path) -> None:
    source = tmp_path / "sheet.glb"
    source.write_bytes(fading(mound).glb())
    assert io.read_report(source).warnings == ("alpha of vertex colors is left out",)


def test_levels_of_detail_and_copies_keep_alpha(tmp_path: Path) -> None:
    source = tmp_path / "sheet.glb"
    source.write_bytes(fading(mound).glb())
    scene = io.read_scene(source)
    scene.write(tmp_path / "copy.glb")
    places, colors = of_vertices(tmp_path / "copy.glb")
    np.testing.assert_allclose(colors[:, 3], mound(places[:, 0], places[:, 1]), atol=1e-6)
    simplify.scene_lods(scene, 3).write(tmp_path / "lods.glb", quantize=True)
    meshes = PosedGltf(tmp_path / "lods.glb").json
    for mesh in meshes["meshes"]:
        color = mesh["primitives"][0]["attributes"]["COLOR_0"]
        assert meshes["accessors"][color]["type"] == "VEC4"
    run = manip3d("simplify", source, "-o", tmp_path / "light.glb", "--ratio", "0.5")
    assert run.returncode == 0, run.stderr
    assert "alpha" not in run.stderr


def test_alphas_of_new_meshes_are_checked(tmp_path: Path) -> None:
    source = tmp_path / "sheet.glb"
    source.write_bytes(fading(mound).glb())
    scene = io.read_scene(source)
    (mesh,) = scene.meshes
    with pytest.raises(InputError, match="alphas: expected those of mesh 0, whose colors have"):
        scene.with_meshes({0: mesh})
    with pytest.raises(InputError, match=r"alphas: expected shape \(289,\) \(the vertices of"):
        scene.with_meshes({0: mesh}, alphas={0: np.ones(3, np.float32)})
    for wrong in (1.5, -0.5, np.nan):
        with pytest.raises(InputError, match="alphas: expected numbers from 0 to 1 for mesh 0"):
            scene.with_meshes({0: mesh}, alphas={0: np.full(289, wrong, np.float32)})
    half = scene.with_meshes({0: mesh}, alphas={0: np.full(289, 0.5, np.float32)})
    half.write(tmp_path / "half.glb")
    assert set(of_vertices(tmp_path / "half.glb")[1][:, 3]) == {0.5}
