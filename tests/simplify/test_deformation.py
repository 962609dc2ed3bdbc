"""Skins and morph targets on simplified meshes: what was posed is close to what is posed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from command_line import manip3d
from gltf_files import Scene
from manip3d import Mesh, io, metrics, simplify
from manip3d.simplify._deformation import deformation_of
from posed_gltf import PosedGltf, arm
from zoo import sphere

BEND = 1.2  # radians


def mesh_of(posed: tuple[NDArray[np.float64], NDArray[np.int64]]) -> Mesh:
    return Mesh(posed[0], posed[1].astype(np.int32))


def farthest(a: Mesh, b: Mesh) -> float:
    found = metrics.metro(a, b, sampling="area")
    return max(found.forward.max, found.backward.max)


@pytest.mark.parametrize(
    ("method", "ratio", "most"),
    [("quality", 0.1, 0.25), ("fast", 0.1, 0.25), ("qem4vr", 0.25, 0.25)],
)
def test_a_simplified_arm_bends_and_swells_as_the_original(
    method: str, ratio: float, most: float, tmp_path: Path
) -> None:
    """Simplified as it lies, straight, the arm of "quality" is 0.39 away when it is bent.

    Its radius is 1; "qem4vr" knows of no other pose, and gets more faces.
    """
    source = tmp_path / "arm.glb"
    source.write_bytes(arm().glb())
    done = simplify.simplify_scene(io.read_scene(source), ratio=ratio, method=method)
    done.scene.write(tmp_path / "light.glb")
    before, after = PosedGltf(source), PosedGltf(tmp_path / "light.glb")
    assert len(after.posed()[1]) <= ratio * len(before.posed()[1])
    for bend, swollen in ((0.0, 0.0), (BEND, 0.0), (0.0, 1.0), (BEND, 0.5)):
        shapes = mesh_of(before.posed(bend, swollen)), mesh_of(after.posed(bend, swollen))
        assert farthest(*shapes) < (most if bend else 0.1)
    weights = after.accessor(after.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"])
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)


def test_a_flat_banner_keeps_the_vertices_that_it_waves_with(tmp_path: Path) -> None:
    """A flat banner keeps vertices for its morph target, although a ball needs faces, too."""
    side = 41
    x, y = (c.reshape(-1) / 4.0 for c in np.meshgrid(range(side), range(side), indexing="ij"))
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1)
    corners = [a, a + side, a + 1, a + 1, a + side, a + side + 1]
    wave = np.stack([0 * x, 0 * x, np.sin(x)], axis=1)
    made = Scene()
    flat = {"POSITION": made.accessor(np.stack([x, y, 0 * x], axis=1))}
    indices = made.accessor(np.stack(corners, axis=1).reshape(-1), "u2")
    made.primitive(flat, indices=indices, targets=[{"POSITION": made.accessor(wave)}])
    ball, faces = sphere(48, 32)
    indices = made.accessor(faces.reshape(-1), "u2")
    primitive = {"attributes": {"POSITION": made.accessor(ball)}, "indices": indices}
    made.json["meshes"].append({"primitives": [primitive]})
    made.json["nodes"].append({"mesh": 1, "translation": [20, 0, 0]})
    (tmp_path / "banner.glb").write_bytes(made.glb())
    scene = io.read_scene(tmp_path / "banner.glb")
    done = simplify.simplify_scene(scene, ratio=0.2).scene

    def waving(of: io.Scene) -> Mesh:
        moves = of.deformations[0]
        assert moves is not None
        return of.meshes[0].replace(vertices=of.meshes[0].vertices + moves.targets[0])

    assert farthest(waving(scene), waving(done)) < 0.1
    assert np.abs(done.meshes[0].vertices[:, 2]).max() < 1e-6  # flat at rest, as before


def test_levels_of_detail_bend_as_the_original(tmp_path: Path) -> None:
    source = tmp_path / "arm.glb"
    source.write_bytes(arm().glb())
    chain = simplify.scene_lods(io.read_scene(source), 3)
    before = mesh_of(PosedGltf(source).posed(BEND))
    for level in chain.levels[1:]:
        level.scene.write(tmp_path / "level.glb")
        assert farthest(before, mesh_of(PosedGltf(tmp_path / "level.glb").posed(BEND))) < 0.15


def test_the_command_line_keeps_skins_and_morph_targets(tmp_path: Path) -> None:
    source = tmp_path / "arm.glb"
    source.write_bytes(arm().glb())
    done = manip3d("simplify", str(source), "-o", str(tmp_path / "light.glb"), "--ratio", "0.2")
    assert done.returncode == 0
    assert "unchanged" not in done.stderr
    (moves,) = io.read_scene(tmp_path / "light.glb").deformations
    assert moves is not None
    assert moves.joints.shape[1] == 4
    assert len(moves.targets) == 1


def sheet(z: float, turned: bool) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    x, y = (c.reshape(-1).astype(float) for c in np.meshgrid(range(9), range(9), indexing="ij"))
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    faces = np.concatenate(
        [np.stack([a, a + 9, a + 1], axis=1), np.stack([a + 1, a + 9, a + 10], axis=1)]
    )
    if turned:
        faces = faces[:, ::-1]
    return np.stack([x, y, np.full_like(x, z)], axis=1), faces.astype(np.int32)


def test_lips_that_touch_keep_their_own_joints() -> None:
    """The upper sheet looks down, the lower one up; a vertex is nearer to the other sheet."""
    (upper, up_faces), (lower, low_faces) = sheet(0.001, True), sheet(0.0, False)
    count = len(upper)
    original = Mesh(np.concatenate([upper, lower]), np.concatenate([up_faces, low_faces + count]))
    joints = np.zeros((2 * count, 4), np.uint16)
    joints[:count, 0] = 1
    weights = np.tile(np.float32([1, 0, 0, 0]), (2 * count, 1))
    none = np.zeros((0, 2 * count, 3), np.float32)
    moves = io.Deformation(joints, weights, none, none)
    pushed = original.vertices + np.where(np.arange(2 * count) < count, -0.1, 0.1)[:, None] * [
        0,
        0,
        1,
    ]
    found = deformation_of(moves, original, Mesh(pushed, original.faces))
    np.testing.assert_array_equal(found.joints[:, 0], joints[:, 0])
    np.testing.assert_array_equal(found.weights[:, 0], 1.0)


def test_layers_of_other_materials_keep_their_own_joints() -> None:
    """A sleeve over a skin: both look the same way."""
    (sleeve, faces), (skin, _) = sheet(0.001, False), sheet(0.0, False)
    count = len(sleeve)
    joints = np.zeros((2 * count, 4), np.uint16)
    joints[:count, 0] = 1
    weights = np.tile(np.float32([1, 0, 0, 0]), (2 * count, 1))
    none = np.zeros((0, 2 * count, 3), np.float32)
    materials = np.repeat(np.int32([0, 1]), len(faces))
    both = np.concatenate([faces, faces + count])
    original = Mesh(np.concatenate([sleeve, skin]), both, face_material=materials)
    pushed = Mesh(np.concatenate([sleeve - [0, 0, 0.1], skin]), both, face_material=materials)
    found = deformation_of(io.Deformation(joints, weights, none, none), original, pushed)
    np.testing.assert_array_equal(found.joints[:, 0], joints[:, 0])


def test_a_foot_between_corners_takes_their_heaviest_joints() -> None:
    """Six joints meet; the four with most weight stay and add up to 1."""
    triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    joints = np.array([[0, 1, 9, 9], [2, 1, 9, 9], [4, 5, 9, 9]], np.uint16)
    weights = np.array([[0.6, 0.4, 0, 0], [0.7, 0.3, 0, 0], [0.9, 0.1, 0, 0]], np.float32)
    targets = np.array([[[3, 0, 0], [0, 3, 0], [0, 0, 3]]], np.float32)
    moves = io.Deformation(joints, weights, targets, targets[:0])
    at = Mesh([[0.25, 0.25, 0.5], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])  # shares 1/2, 1/4, 1/4
    found = deformation_of(moves, triangle, at)
    expected = {0: 0.3, 1: 0.275, 4: 0.225, 2: 0.175}  # joint 5 has .025
    assert dict(zip(found.joints[0].tolist(), found.weights[0].tolist(), strict=True)) == {
        joint: pytest.approx(weight / 0.975, abs=1e-6) for joint, weight in expected.items()
    }
    np.testing.assert_allclose(found.targets[0, 0], [1.5, 0.75, 0.75], atol=1e-6)
    np.testing.assert_array_equal(found.joints[1], [2, 1, 0, 0])


def test_faces_without_area_give_a_foot_too() -> None:
    line = Mesh([[0, 0, 0], [2, 0, 0], [1, 0, 0]], [[0, 1, 2]])
    point = Mesh([[1, 1, 1]] * 3, [[0, 1, 2]])
    targets = np.array([[[0, 0, 0], [2, 0, 0], [1, 0, 0]]], np.float32)
    none = np.zeros((3, 0))
    moves = io.Deformation(none.astype(np.uint16), none.astype(np.float32), targets, targets[:0])
    asked = Mesh([[0.5, 0, 0], [1.5, 0, 0], [1, 1, 0]], [[0, 1, 2]])
    found = deformation_of(moves, line, asked).targets[0, :, 0]
    np.testing.assert_allclose(found, [0.5, 1.5, 1.0], atol=1e-6)
    assert np.isfinite(deformation_of(moves, point, asked).targets).all()


def test_a_character_beside_a_stage_is_simplified_where_its_skin_places_it(tmp_path: Path) -> None:
    """Nodes scale the joints a hundredfold; the mesh itself is as large as the floor."""
    made: Scene = arm()
    floor = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0]])
    primitive = {"attributes": {"POSITION": made.accessor(floor)}, "mode": 5}
    made.json["meshes"].append({"primitives": [primitive]})
    made.json["nodes"].append({"mesh": 1})
    source = tmp_path / "stage.glb"
    source.write_bytes(made.glb())
    done = simplify.simplify_scene(io.read_scene(source), max_error=0.05)
    done.scene.write(tmp_path / "out.glb")
    before, after = PosedGltf(source), PosedGltf(tmp_path / "out.glb")
    assert len(after.posed()[1]) < 0.5 * len(before.posed()[1])
    assert farthest(mesh_of(before.posed()), mesh_of(after.posed())) < 0.3
