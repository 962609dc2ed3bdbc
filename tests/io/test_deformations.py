"""Skins and morph targets of scenes: read, carried by other triangles, written again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gltf_files import SQUARE, Scene
from manip3d import FormatError, InputError, Mesh, io, read_mesh
from posed_gltf import RINGS, SCALE, SIDES, PosedGltf, arm, elbow, swelling, tube


def written(path: Path, scene: Scene) -> Path:
    path.write_bytes(scene.glb())
    return path


def test_joints_weights_and_targets_are_read_for_each_vertex(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    assert (scene.fixed, scene.warnings) == (("",), ())
    (moves,) = scene.deformations
    assert moves is not None
    vertices, _ = tube()
    assert moves.joints.dtype == np.uint16
    np.testing.assert_array_equal(moves.joints, np.tile([0, 1, 0, 0], (RINGS * SIDES, 1)))
    np.testing.assert_allclose(moves.weights[:, 1], elbow(vertices), atol=1e-6)
    np.testing.assert_allclose(moves.targets, swelling(vertices)[None], atol=1e-6)
    assert moves.target_normals.shape == (0, RINGS * SIDES, 3)


def test_a_skin_places_its_mesh_in_the_stead_of_its_node(tmp_path: Path) -> None:
    made = arm()
    made.json["nodes"][0]["translation"] = [7, 0, 0]  # without effect, by the standard
    scene = io.read_scene(written(tmp_path / "arm.glb", made))
    node = scene.nodes[0]
    assert node.joint == 2
    assert scene.nodes[1].joint is None
    place = scene.world_transforms()[node.joint] @ node.inverse_bind
    np.testing.assert_allclose(place, np.eye(4), atol=1e-6)


def test_a_mesh_with_a_skin_is_read_in_the_pose_of_its_joints(tmp_path: Path) -> None:
    """The node that shows it says another place and size, which the standard leaves out."""
    made = arm()
    made.json["nodes"][0] |= {"translation": [7, 0, 0], "scale": [SCALE] * 3}
    bend = 0.8
    made.json["nodes"][3]["rotation"] = [np.sin(bend / 2), 0, 0, np.cos(bend / 2)]
    source = written(tmp_path / "arm.glb", made)
    expected, _ = PosedGltf(source).posed(bend)
    np.testing.assert_allclose(read_mesh(source).vertices, expected, atol=1e-5)


def test_normals_follow_the_joints(tmp_path: Path) -> None:
    """A quarter turn about x of the second joint, which alone moves the square."""
    made = Scene()
    joints = made.accessor(np.tile([1, 0, 0, 0], (4, 1)), "u1")
    weights = made.accessor(np.tile([0.5, 0, 0, 0], (4, 1)))  # as good as one
    up = made.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    attributes = {"POSITION": made.accessor(SQUARE), "NORMAL": up}
    made.primitive({**attributes, "JOINTS_0": joints, "WEIGHTS_0": weights}, mode=5)
    turn = [np.sin(np.pi / 4), 0, 0, np.cos(np.pi / 4)]
    made.json["nodes"] = [{"mesh": 0, "skin": 0}, {}, {"rotation": turn, "scale": [1, 1, 2]}]
    made.json["skins"] = [{"joints": [1, 2]}]
    mesh = read_mesh(written(tmp_path / "a.glb", made))
    np.testing.assert_allclose(mesh.vertices, SQUARE[:, [0, 2, 1]], atol=1e-6)
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, np.tile([0, -1, 0], (4, 1)), atol=1e-6)


def test_primitives_that_share_positions_may_have_other_joints(tmp_path: Path) -> None:
    made = Scene()
    position = made.accessor(SQUARE)
    for joint in (0, 1):
        joints = made.accessor(np.tile([joint, 0, 0, 0], (4, 1)), "u1")
        weights = made.accessor(np.tile([1, 0, 0, 0], (4, 1)))
        attributes = {"POSITION": position, "JOINTS_0": joints, "WEIGHTS_0": weights}
        made.primitive(attributes, mode=5)
    made.json["nodes"] = [{"mesh": 0, "skin": 0}, {}, {"translation": [0, 0, 9]}]
    made.json["skins"] = [{"joints": [1, 2]}]
    mesh = read_mesh(written(tmp_path / "a.glb", made))
    np.testing.assert_array_equal(mesh.vertices[:, 2], [0] * 4 + [9] * 4)


def test_a_joint_that_a_skin_does_not_have_is_named(tmp_path: Path) -> None:
    made = arm()
    made.json["skins"][0]["joints"] = [2]
    with pytest.raises(
        FormatError, match=r"/primitives/0: vertex 600 has joint 1 of a skin with 1"
    ):
        read_mesh(written(tmp_path / "arm.glb", made))


def test_what_is_written_moves_as_what_was_read(tmp_path: Path) -> None:
    source = written(tmp_path / "arm.glb", arm())
    io.read_scene(source).write(tmp_path / "again.glb")
    before, after = PosedGltf(source), PosedGltf(tmp_path / "again.glb")
    for bend, swollen in ((0.0, 0.0), (1.0, 0.0), (0.5, 1.0)):
        vertices, faces = before.posed(bend, swollen)
        again, again_faces = after.posed(bend, swollen)
        np.testing.assert_allclose(again[again_faces], vertices[faces], atol=1e-5 * SCALE)
    assert after.json["animations"]
    assert after.json["skins"]
    assert after.json["meshes"][0]["extras"] == {"targetNames": ["swelling"]}
    (primitive,) = after.json["meshes"][0]["primitives"]
    target = after.json["accessors"][primitive["targets"][0]["POSITION"]]
    assert target["sparse"]["count"] == 18 * SIDES  # those that move: z < 3


def test_a_target_that_moves_most_vertices_is_written_densely(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    (moves,) = scene.deformations
    assert moves is not None
    everywhere = replace(moves, targets=np.ones_like(moves.targets))
    nowhere = replace(moves, targets=np.zeros_like(moves.targets))
    for given, keys in ((everywhere, {"bufferView"}), (nowhere, set())):
        scene.with_meshes({0: scene.meshes[0]}, {0: given}).write(tmp_path / "out.glb")
        found = PosedGltf(tmp_path / "out.glb")
        (primitive,) = found.json["meshes"][0]["primitives"]
        index = primitive["targets"][0]["POSITION"]
        assert {"bufferView", "sparse"} & found.json["accessors"][index].keys() == keys
        np.testing.assert_array_equal(found.accessor(index), given.targets[0])


def test_normals_of_targets_are_kept(tmp_path: Path) -> None:
    made = Scene()
    up = np.tile(np.float32([0, 0, 1]), (4, 1))
    target = {"POSITION": made.accessor(up), "NORMAL": made.accessor(2 * up)}
    attributes = {"POSITION": made.accessor(SQUARE), "NORMAL": made.accessor(up)}
    made.primitive(attributes, mode=5, targets=[{}, target])
    scene = io.read_scene(written(tmp_path / "a.glb", made))
    scene.write(tmp_path / "b.glb")
    (moves,) = io.read_scene(tmp_path / "b.glb").deformations
    assert moves is not None
    np.testing.assert_array_equal(moves.target_normals, [0 * up, 2 * up])
    np.testing.assert_array_equal(moves.targets, [0 * up, up])


def test_primitives_without_a_second_set_of_joints_have_weights_of_zero(tmp_path: Path) -> None:
    made = Scene()
    joints, weights = np.ones((4, 4)), np.full((4, 4), 0.125)
    common = {"JOINTS_0": made.accessor(joints, "u2"), "WEIGHTS_0": made.accessor(weights)}
    more = {"JOINTS_1": made.accessor(joints, "u1"), "WEIGHTS_1": made.accessor(weights)}
    made.primitive({"POSITION": made.accessor(SQUARE), **common, **more}, mode=5)
    made.primitive({"POSITION": made.accessor(SQUARE + 1), **common}, mode=5)
    scene = io.read_scene(written(tmp_path / "a.glb", made))
    (moves,) = scene.deformations
    assert moves is not None
    assert moves.weights.shape == (8, 8)
    np.testing.assert_array_equal(moves.weights.sum(axis=1), [1, 1, 1, 1, 0.5, 0.5, 0.5, 0.5])
    scene.write(tmp_path / "b.glb")
    (again,) = io.read_scene(tmp_path / "b.glb").deformations
    assert again is not None
    np.testing.assert_array_equal(again.weights, moves.weights)


def _without_joints(made: Scene) -> None:
    del made.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"]


def _other_targets(made: Scene) -> None:
    first = made.json["meshes"][0]["primitives"][0]
    attributes = {**first["attributes"], "POSITION": made.accessor(tube()[0])}
    made.json["meshes"][0]["primitives"].append({"attributes": attributes})


def _shared_positions(made: Scene) -> None:
    first = made.json["meshes"][0]["primitives"][0]
    other = first["attributes"] | {"JOINTS_0": made.accessor(np.zeros((RINGS * SIDES, 4)), "u1")}
    made.json["meshes"][0]["primitives"].append({**first, "attributes": other})


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_without_joints, "it has a skin, but not all of it has joints and weights"),
        (_other_targets, "its primitives have different numbers of morph targets"),
        (_shared_positions, "its primitives share positions, but not joints and morph targets"),
    ],
)
def test_what_cannot_follow_other_triangles_stays(change: Any, reason: str, tmp_path: Path) -> None:
    made = arm()
    change(made)
    scene = io.read_scene(written(tmp_path / "arm.glb", made))
    assert (scene.fixed, scene.deformations) == ((reason,), (None,))
    with pytest.raises(InputError, match=f"mesh 0 is fixed: {reason}"):
        scene.with_meshes({0: scene.meshes[0]})


def _short(made: Scene) -> None:
    attributes = made.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["WEIGHTS_0"] = made.accessor(np.zeros((5, 4)))


def _no_integers(made: Scene) -> None:
    attributes = made.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = made.accessor(np.full((RINGS * SIDES, 4), 0.5))


def _no_joint(made: Scene) -> None:
    made.json["skins"][0]["joints"] = []


def _no_matrix(made: Scene) -> None:
    made.json["skins"][0]["inverseBindMatrices"] = made.accessor(np.zeros((0, 16)))


def _no_node(made: Scene) -> None:
    made.json["skins"][0]["joints"] = [9]


def _three_numbers(made: Scene) -> None:
    target = made.json["meshes"][0]["primitives"][0]["targets"][0]
    target["POSITION"] = made.accessor(np.zeros((RINGS * SIDES, 4)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_short, "has 5 elements, POSITION of /meshes/0/primitives/0 1464"),
        (_no_integers, "expected joints as integers from 0 to 65535, got 0.5"),
        (_no_joint, "/skins/0/joints: expected at least one joint"),
        (_no_matrix, "expected a matrix for each of 2 joints, got 0"),
        (_no_node, "/skins/0/joints/0: expected a whole number"),
        (_three_numbers, "the type does not suit POSITION"),
    ],
)
def test_damaged_skins_and_targets_are_named(change: Any, message: str, tmp_path: Path) -> None:
    made = arm()
    change(made)
    with pytest.raises(FormatError, match=message):
        io.read_scene(written(tmp_path / "arm.glb", made))


def test_targets_of_zeros_cannot_take_all_memory(tmp_path: Path) -> None:
    """No bytes of the file stand for an accessor without a bufferView."""
    made = Scene()
    for array in ("accessors", "bufferViews"):
        made.json[array] = []
    count = 30_000
    made.json["accessors"] = [{"componentType": 5126, "count": count, "type": "VEC3"}]
    made.primitive({"POSITION": 0}, targets=[{"POSITION": 0}] * 300)
    with pytest.raises(FormatError, match="bytes"):
        io.read_scene(written(tmp_path / "zeros.glb", made))


def test_other_triangles_need_a_deformation_that_fits(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    triangle = Mesh(np.eye(3), [[0, 1, 2]])
    with pytest.raises(InputError, match="deformations: expected one for mesh 0"):
        scene.with_meshes({0: triangle})
    (moves,) = scene.deformations
    assert moves is not None
    with pytest.raises(InputError, match=r"expected 3 rows \(the vertices of mesh 0\), got \[1464"):
        scene.with_meshes({0: triangle}, {0: moves})
    few = io.Deformation(
        moves.joints[:3], moves.weights[:3], moves.targets[:, :3], moves.target_normals[:, :3]
    )
    assert scene.with_meshes({0: triangle}, {0: few}).num_faces == 1
    wrong = replace(few, weights=few.weights[:, :2])
    with pytest.raises(InputError, match="weights: expected 3 x 4 values, got 6"):
        scene.with_meshes({0: triangle}, {0: wrong}).write(tmp_path / "out.glb")
    assert not (tmp_path / "out.glb").exists()


def test_a_mesh_that_is_left_out_leaves_no_skin_and_no_animation_behind(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    scene.with_meshes({0: nothing}).write(tmp_path / "out.glb")
    found = PosedGltf(tmp_path / "out.glb").json
    assert found["nodes"][0] == {"name": "arm"}
    assert "animations" not in found


def test_levels_of_detail_have_their_own_skin_and_animation(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    half = scene.with_meshes(
        {0: Mesh(scene.meshes[0].vertices, scene.meshes[0].faces[::2])},
        {0: scene.deformations[0]} if scene.deformations[0] else {},
    )
    io.write_lods([scene, half], tmp_path / "lods.glb", errors=[0.0, 0.1])
    found = PosedGltf(tmp_path / "lods.glb")
    nodes = found.json["nodes"]
    shown = [i for i, node in enumerate(nodes) if "mesh" in node]
    assert len(shown) == 2
    assert [nodes[i]["skin"] for i in shown] == [0, 0]
    (animation,) = found.json["animations"]
    assert [channel["target"]["node"] for channel in animation["channels"]] == shown
    assert all(len(found.posed(0.5, 1.0, node)[1]) > 0 for node in shown)
    assert "skin" not in nodes[0]


def test_meshes_with_a_skin_are_not_quantized(tmp_path: Path) -> None:
    source = written(tmp_path / "arm.glb", arm())
    io.read_scene(source).write(tmp_path / "small.glb", quantize=True)
    vertices, _ = PosedGltf(source).posed(1.0)
    again, _ = PosedGltf(tmp_path / "small.glb").posed(1.0)
    np.testing.assert_allclose(np.ptp(again, axis=0), np.ptp(vertices, axis=0), rtol=1e-5)


def test_weights_that_were_rounded_add_up_to_1_again(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    (moves,) = scene.deformations
    assert moves is not None
    rounded = replace(moves, weights=moves.weights * np.float32(1.001))
    scene.with_meshes({0: scene.meshes[0]}, {0: rounded}).write(tmp_path / "out.glb")
    (again,) = io.read_scene(tmp_path / "out.glb").deformations
    assert again is not None
    np.testing.assert_allclose(again.weights.sum(axis=1, dtype=np.float64), 1.0, atol=2e-7)


def test_a_joint_keeps_its_transform(tmp_path: Path) -> None:
    scene = io.read_scene(written(tmp_path / "arm.glb", arm()))
    joint = scene.nodes[0].joint
    assert joint is not None
    place = np.eye(4)
    place[0, 3] = 2.0
    nodes = list(scene.nodes)
    nodes[joint] = replace(nodes[joint], transform=place)
    with pytest.raises(InputError, match=rf"nodes\[{joint}\].transform: .* a joint of a skin"):
        replace(scene, nodes=tuple(nodes)).write(tmp_path / "out.glb")
