"""Scenes with instances: each mesh is simplified once, faces count as they are drawn."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import exact_models
from command_line import manip3d
from gltf_files import glb, scene_of
from manip3d import InputError, Mesh, _core, io, metrics, read_mesh, simplify
from manip3d.simplify import _memory
from zoo import grid, sphere


def scene_file(
    path: Path,
    meshes: list[tuple[NDArray[np.float64], NDArray[np.int32]]],
    nodes: list[dict[str, Any]],
) -> Path:
    """A GLB of plain meshes, shown by these nodes; all without a parent are roots."""
    buffer = b""
    made: dict[str, Any] = {
        "asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "meshes": [],
    }  # fmt: skip

    def add(values: NDArray[Any], component: int, shape: str, **more: Any) -> int:
        nonlocal buffer
        data = values.tobytes()
        made["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(buffer), "byteLength": len(data)}
        )
        made["accessors"].append(
            {"bufferView": len(made["bufferViews"]) - 1, "componentType": component,
             "count": values.size if shape == "SCALAR" else len(values), "type": shape, **more}
        )  # fmt: skip
        buffer += data
        return len(made["accessors"]) - 1

    for i, (vertices, faces) in enumerate(meshes):
        points = vertices.astype("<f4")
        low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        position = add(points, 5126, "VEC3", min=low, max=high)
        index = add(faces.astype("<u4"), 5125, "SCALAR")
        primitive = {"attributes": {"POSITION": position}, "indices": index}
        made["meshes"].append({"name": f"mesh {i}", "primitives": [primitive]})
    children = {child for node in nodes for child in node.get("children", [])}
    made["nodes"] = nodes
    made["scenes"] = [{"nodes": [i for i in range(len(nodes)) if i not in children]}]
    made["buffers"] = [{"byteLength": len(buffer)}]
    path.write_bytes(glb(made, buffer))
    return path


def four_balls(path: Path) -> Path:
    """Four instances of a ball below one node, one of them mirrored and larger."""
    nodes: list[dict[str, Any]] = [{"name": "balls", "children": [1, 2, 3, 4]}]
    nodes += [{"name": f"ball {i}", "mesh": 0, "translation": [4.0 * i, 0, 0]} for i in range(4)]
    nodes[3]["scale"] = [-1.5, 1.5, 1.5]
    return scene_file(path, [sphere(24, 16)], nodes)


def test_instances_of_one_node_count_as_they_are_drawn(tmp_path: Path) -> None:
    """EXT_mesh_gpu_instancing: as many faces as the same balls with a node each."""
    nodes = [{"mesh": 0, "translation": [4.0 * i, 0, 0]} for i in range(3)]
    scene = io.read_scene(scene_file(tmp_path / "nodes.glb", [sphere(24, 16)], nodes))
    places = np.tile(np.eye(4), (3, 1, 1))
    places[:, 0, 3] = [0, 4, 8]
    of_one = replace(
        scene, nodes=(replace(scene.nodes[0], instances=places), *scene.nodes[1:1]), fixed=("",)
    )
    apart, together = (simplify.simplify_scene(s, ratio=0.25) for s in (scene, of_one))
    assert together.scene.num_faces == apart.scene.num_faces == 3 * len(apart.scene.meshes[0].faces)
    assert together.max_error == pytest.approx(apart.max_error, rel=1e-9)


@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr", "qem-orig"])
def test_a_mesh_of_four_instances_is_simplified_once(method: str, tmp_path: Path) -> None:
    source = four_balls(tmp_path / "balls.glb")
    scene = io.read_scene(source)
    target = scene.num_faces // 4
    done = simplify.simplify_scene(scene, method, target_faces=target)
    assert done.stop == "target_reached"
    assert 0.98 * target <= done.scene.num_faces <= target
    assert done.scene.num_faces == 4 * done.scene.num_stored_faces
    done.scene.write(tmp_path / "out.glb")
    again = io.read_scene(tmp_path / "out.glb")
    assert [node.name for node in again.nodes] == [node.name for node in scene.nodes]
    np.testing.assert_array_equal(again.world_transforms(), scene.world_transforms())
    assert len(again.meshes) == 1
    before, after = read_mesh(source), read_mesh(tmp_path / "out.glb")
    assert after.num_faces == done.scene.num_faces
    assert metrics.metro(before, after, sampling="vertex").mean < 3e-3
    # outward as before, in the mirrored instance as well
    volume = [np.linalg.det(mesh.vertices[mesh.faces]).sum() for mesh in (before, after)]
    assert volume[1] == pytest.approx(volume[0], rel=0.1)


@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr"])
def test_a_target_between_two_numbers_of_drawn_faces_is_met(method: str, tmp_path: Path) -> None:
    """Two instances of a closed mesh, which has 2 faces fewer after a collapse: drawn, 4 fewer."""
    nodes: list[dict[str, Any]] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    scene = io.read_scene(scene_file(tmp_path / "two.glb", [sphere(24, 16)], nodes))
    assert scene.num_faces % 4 == 0
    for below in (1, 2, 3, 4):
        target = scene.num_faces - 300 - below
        done = simplify.simplify_scene(scene, method, target_faces=target)
        assert done.stop == "target_reached"
        assert done.scene.num_faces == scene.num_faces - 304
    done = simplify.simplify_scene(scene, method, target_faces=scene.num_faces - 1)
    assert done.stop == "target_reached"
    assert done.scene.num_faces == scene.num_faces - 4


@pytest.mark.parametrize("alone", [(12, 8), (48, 32)])
def test_a_target_is_met_where_most_drawn_faces_are_of_one_mesh(
    alone: tuple[int, int], tmp_path: Path
) -> None:
    """Fifty instances of one mesh beside a single one: drawn faces are no share of the stored."""
    nodes: list[dict[str, Any]] = [{"mesh": 1, "translation": [-5, 0, 0]}]
    nodes += [{"mesh": 0, "translation": [5.0 * i, 0, 0]} for i in range(50)]
    scene = io.read_scene(
        scene_file(tmp_path / "many.glb", [sphere(16, 12), sphere(*alone)], nodes)
    )
    for ratio in (0.9, 0.5, 0.1):
        done = simplify.simplify_scene(scene, ratio=ratio)
        assert done.stop == "target_reached"
        assert 0.9 * ratio * scene.num_faces <= done.scene.num_faces <= ratio * scene.num_faces


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_fewer_faces_than_instances_leave_one_of_the_mesh(method: str, tmp_path: Path) -> None:
    scene = io.read_scene(four_balls(tmp_path / "balls.glb"))
    done = simplify.simplify_scene(scene, method, target_faces=1)
    assert (done.scene.num_stored_faces, done.scene.num_faces) == (1, 4)
    assert done.stop == simplify.StopReason.NO_LEGAL_COLLAPSE


def test_a_number_of_faces_that_is_undercut_counts_as_met(tmp_path: Path) -> None:
    """A search that asks for fewer stored faces than there can be, where more are enough."""
    tetrahedron = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
                   np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32))  # fmt: skip
    nodes: list[dict[str, Any]] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    scene = io.read_scene(scene_file(tmp_path / "two.glb", [tetrahedron], nodes))
    for method in ("quality", "fast", "qem4vr"):
        done = simplify.simplify_scene(scene, method, target_faces=7)
        assert (done.stop == "target_reached") == (done.scene.num_faces <= 7), method


def test_one_error_for_all_meshes_at_the_size_they_are_shown(tmp_path: Path) -> None:
    """The same ball twice, as two meshes, one shown ten times as large: it needs more faces."""
    ball = sphere(32, 24)
    nodes = [{"mesh": 0}, {"mesh": 1, "translation": [50, 0, 0], "scale": [10, 10, 10]}]
    scene = io.read_scene(scene_file(tmp_path / "two.glb", [ball, ball], nodes))
    done = simplify.simplify_scene(scene, ratio=0.2).scene
    assert done.num_faces <= 0.2 * scene.num_faces
    small, large = (mesh.num_faces for mesh in done.meshes)
    assert large > 5 * small
    # without the scale both are alike
    del nodes[1]["scale"]
    scene = io.read_scene(scene_file(tmp_path / "two.glb", [ball, ball], nodes))
    done = simplify.simplify_scene(scene, ratio=0.2).scene
    small, large = (mesh.num_faces for mesh in done.meshes)
    assert large == pytest.approx(small, rel=0.1)


def test_meshes_that_touch_stay_together(tmp_path: Path) -> None:
    """A wavy sheet cut in two meshes: no gap opens along the cut."""
    vertices, faces = grid(24, 24)
    vertices[:, 2] = 2 * np.sin(vertices[:, 0] / 4) * np.cos(vertices[:, 1] / 5)
    left = vertices[faces].mean(axis=1)[:, 0] < 12
    scene = io.read_scene(
        scene_file(
            tmp_path / "sheet.glb",
            [(vertices, faces[left]), (vertices, faces[~left])],
            [{"mesh": 0}, {"mesh": 1}],
        )
    )
    for method in ("quality", "fast", "qem4vr"):
        done = simplify.simplify_scene(scene, method, ratio=0.1).scene
        assert min(mesh.num_faces for mesh in done.meshes) > 0
        done.write(tmp_path / "out.glb")
        welded = simplify.clean(read_mesh(tmp_path / "out.glb")).mesh
        assert welded.summary().components == 1
        edges = np.sort(welded.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        borders, counts = np.unique(edges, axis=0, return_counts=True)
        ends = welded.vertices[borders[counts == 1]]
        on_rim = (np.abs(ends[:, 0, :2] - 12) > 11.5).any(axis=1)
        assert on_rim.all(), method


@pytest.mark.parametrize("locks", [{}, {"lock_box": [[0, -9, -9], [0.5, 99, 99]]}])
def test_max_distance_holds_for_every_instance(tmp_path: Path, locks: dict[str, Any]) -> None:
    vertices, faces = sphere(48, 32)
    nodes: list[dict[str, Any]] = [
        {"mesh": 0},
        {"mesh": 0, "translation": [9, 0, 0], "scale": [1, 1, 3]},
        {"mesh": 0, "translation": [0, 9, 0], "scale": [2.5, 2.5, 1]},
    ]
    scene = io.read_scene(scene_file(tmp_path / "a.glb", [(vertices, faces)], nodes))
    done = simplify.simplify_scene(scene, max_distance=0.05, **locks)
    assert done.stop == "distance_limit"
    assert done.distance_bound is not None
    assert done.distance_bound <= 0.05
    assert done.scene.num_faces < 0.7 * scene.num_faces
    for place in scene.world_transforms():
        meshes = [
            mesh.replace(vertices=mesh.vertices @ place[:3, :3].T + place[:3, 3])
            for mesh in (scene.meshes[0], done.scene.meshes[0])
        ]
        assert metrics.metro(*meshes, sampling="vertex").max * meshes[0].diagonal <= 0.05


def test_attributes_of_each_mesh_stay_its_own(tmp_path: Path) -> None:
    """A textured head in a group, beside a plain ball that has neither texture nor material."""
    from manip3d import simulate

    head = simulate.models.head(faces=2000)
    head.write(tmp_path / "head.glb")
    alone = io.read_scene(tmp_path / "head.glb")
    colored = Mesh(*sphere(12, 8), colors=np.full((98, 3), 7)[: len(sphere(12, 8)[0])])
    colored.write(tmp_path / "ball.glb")
    done = simplify.simplify_scene(alone, target_faces=400)
    (mesh,) = done.scene.meshes
    assert mesh.texcoords is not None
    assert mesh.num_faces == done.scene.num_faces <= 400
    flat = simplify.quality(read_mesh(tmp_path / "head.glb"), target_faces=400).mesh
    np.testing.assert_allclose(mesh.vertices, flat.vertices, atol=1e-12)
    (ball,) = simplify.simplify_scene(io.read_scene(tmp_path / "ball.glb"), ratio=0.5).scene.meshes
    assert ball.texcoords is None
    assert ball.colors is not None
    assert (ball.colors == 7).all()


def test_a_flattened_instance_is_simplified_all_the_same(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "scale": [2, 2, 0]}, {"mesh": 0, "scale": [0, 0, 0]}]
    scene = io.read_scene(scene_file(tmp_path / "flat.glb", [sphere(24, 16)], nodes))
    done = simplify.simplify_scene(scene, ratio=0.25)
    assert done.scene.num_faces <= 0.25 * scene.num_faces


def test_what_is_refused(tmp_path: Path) -> None:
    scene = io.read_scene(four_balls(tmp_path / "balls.glb"))
    with pytest.raises(InputError, match="at least one, got none"):
        simplify.simplify_scene(scene)
    with pytest.raises(InputError, match="method: expected one of quality"):
        simplify.simplify_scene(scene, "best", ratio=0.5)
    with pytest.raises(InputError, match="ratio"):
        simplify.simplify_scene(scene, ratio=2.0)
    with pytest.raises(InputError, match=r"lock_box: expected shape \(2, 3\)"):
        simplify.simplify_scene(scene, ratio=0.5, lock_box=[1, 2])
    with pytest.raises(InputError, match="max_distance: expected method='quality' or a publ"):
        simplify.simplify_scene(scene, "fast", max_distance=0.1)
    for lock in ({"lock_boundary": True}, {"lock_box": [[0, 0, 0], [1, 1, 1]]}):
        told = f"{next(iter(lock))}: expected method='quality' or 'fast', got 'qem4vr'"
        for run in (simplify.simplify_scene, simplify.scene_lods):
            with pytest.raises(InputError, match=told):
                run(scene, method="qem4vr", ratio=0.5, **lock)
    for own in ("max_error", "max_distance", "importance", "ratio"):
        with pytest.raises(InputError, match=f"options: expected none that .*, got {own}"):
            simplify.simplify_scene(scene, target_faces=9, options={own: 0.1})
    assert simplify.simplify_scene(scene, ratio=0.5, max_distance=math.inf).distance_bound is None


def test_levels_of_detail_of_a_scene(tmp_path: Path) -> None:
    scene = io.read_scene(four_balls(tmp_path / "balls.glb"))
    chain = simplify.scene_lods(scene, 3)
    assert [level.num_faces for level in chain.levels] == [
        scene.num_faces, scene.num_faces // 2, scene.num_faces // 4
    ]  # fmt: skip
    chain.write(tmp_path / "lods.glb")
    assert io.read_scene(tmp_path / "lods.glb").num_instances == 4
    assert read_mesh(tmp_path / "lods.glb").num_faces == scene.num_faces


@pytest.mark.parametrize("levels", [1, 3])
def test_quantised_meshes_lie_where_they_did(levels: int, tmp_path: Path) -> None:
    """Quantisation moves vertices by at most half a step, scaled by the size of the instance."""
    scene = io.read_scene(four_balls(tmp_path / "balls.glb"))
    written = scene if levels == 1 else simplify.scene_lods(scene, levels)
    written.write(tmp_path / "plain.glb")
    written.write(tmp_path / "small.glb", quantize=True)
    plain, small = (read_mesh(tmp_path / f"{name}.glb") for name in ("plain", "small"))
    off = np.abs(small.vertices[small.faces] - plain.vertices[plain.faces]).max()
    # The smallest power of two of which 65534 are the 2 m of a ball; the largest instance is 1.5
    # times as large.
    step = 2.0**-14
    assert 0.2 * step < off < 0.75 * step + 1e-6  # readers place it with float32
    again = io.read_scene(tmp_path / "small.glb")
    assert [node.name for node in again.nodes][:5] == [node.name for node in scene.nodes]
    assert again.num_instances == 4
    sizes = [(tmp_path / f"{name}.glb").stat().st_size for name in ("plain", "small")]
    assert sizes[1] < sizes[0]


def test_the_command_keeps_nodes_and_prints_both_counts(tmp_path: Path) -> None:
    source = four_balls(tmp_path / "balls.glb")
    run = manip3d("simplify", source, "-o", tmp_path / "out.glb", "--ratio", "0.25", "--json")
    record = json.loads(run.stdout)
    assert record["scene"]["instances"] == 4
    assert record["faces_before"] == 4 * record["scene"]["stored_faces_before"]
    assert record["faces_after"] == 4 * record["scene"]["stored_faces_after"]
    assert io.read_scene(tmp_path / "out.glb").num_instances == 4
    said = run.stderr.replace("\N{NARROW NO-BREAK SPACE}", "").replace("\N{NO-BREAK SPACE}", "")
    assert "5 nodes, 1 mesh shown 4 times" in said
    assert "faces drawn" in said
    # another format holds no nodes
    manip3d("simplify", source, "-o", tmp_path / "out.ply", "--ratio", "0.25")
    assert read_mesh(tmp_path / "out.ply").num_faces <= 0.25 * record["faces_before"]
    manip3d("lod", source, "-o", tmp_path / "lods", "--levels", "2", "--quantize")
    assert b"KHR_mesh_quantization" in (tmp_path / "lods" / "level_1.glb").read_bytes()
    levels = json.loads((tmp_path / "lods" / "lods.json").read_text())["levels"]
    assert [level["faces"] for level in levels] == [4 * level["stored_faces"] for level in levels]


def test_other_readers_see_the_same_instances(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    source = four_balls(tmp_path / "balls.glb")
    done = simplify.simplify_scene(io.read_scene(source), ratio=0.5).scene
    done.write(tmp_path / "out.glb")
    before, after = (trimesh.load(p, force="scene") for p in (source, tmp_path / "out.glb"))
    assert len(after.geometry) == 1
    assert len(after.graph.nodes_geometry) == len(before.graph.nodes_geometry) == 4
    np.testing.assert_allclose(after.bounds, before.bounds, atol=0.05)


HIDING = {
    "hidden": [0, 0, 0],
    "flattened": [1, 1, 0],
    "a line": [1, 0, 0],
    "1e-30": [1e-30] * 3,
    "1e-12": [1e-12] * 3,
    "1e-8": [1e-8] * 3,
    "1e-6": [1e-6] * 3,
    "1e-5": [1e-5] * 3,
    "1e-4": [1e-4] * 3,
}


@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr"])
@pytest.mark.parametrize("scale", HIDING.values(), ids=HIDING)
def test_what_is_seen_stays_when_another_mesh_is_not(
    scale: list[float], method: str, tmp_path: Path
) -> None:
    """The same wavy sheet as two meshes, at the same place; one of them is hardly there."""
    vertices, faces = grid(19, 19)
    vertices[:, 2] = np.sin(vertices[:, 0])
    nodes: list[dict[str, Any]] = [{"mesh": 0, "scale": scale}, {"mesh": 1}]
    sheet = (vertices, faces)
    scene = io.read_scene(scene_file(tmp_path / "two.glb", [sheet, sheet], nodes))
    done = simplify.simplify_scene(scene, method, target_faces=200)
    assert 180 <= done.scene.num_faces <= 200
    hidden, seen = done.scene.meshes
    assert seen.num_faces >= 100
    # as good as alone, with the faces that it has
    alone = simplify.METHODS.get(method, getattr(simplify, method))
    best = alone(simplify.clean(scene.meshes[1]).mesh, target_faces=seen.num_faces).mesh
    before = scene.meshes[1]
    error = metrics.metro(before, seen, sampling="vertex").mean
    assert error <= 1.05 * metrics.metro(before, best, sampling="vertex").mean
    if scale[0] < 1e-5 or 0 in scale:  # what an animation may show later keeps its shape, too
        assert metrics.metro(before, hidden, sampling="vertex").mean <= 1.3 * error
    levels = simplify.scene_lods(scene, 3, method=method).levels
    assert [level.num_faces for level in levels] == pytest.approx([1444, 722, 361], abs=4)
    assert all(level.scene.meshes[1].num_faces > 0.4 * level.num_faces for level in levels)


@pytest.mark.parametrize("levels", [[200, 200], [0], [-5], [50, 100], []])
def test_levels_shared_out_are_checked_first(levels: list[int], tmp_path: Path) -> None:
    nodes: list[dict[str, Any]] = [{"mesh": 0, "scale": [0, 0, 0]}, {"mesh": 1}]
    scene = io.read_scene(scene_file(tmp_path / "two.glb", [sphere(24, 16)] * 2, nodes))
    with pytest.raises(InputError, match="levels: expected descending numbers of faces >= 1"):
        simplify.scene_lods(scene, levels)


def test_limits_of_error_leave_alone_what_is_not_seen(tmp_path: Path) -> None:
    ball = sphere(24, 16)
    nodes: list[dict[str, Any]] = [
        {"mesh": 0, "scale": [0, 0, 0]}, {"mesh": 1}, {"mesh": 2, "scale": [2, 2, 0]}
    ]  # fmt: skip
    scene = io.read_scene(scene_file(tmp_path / "a.glb", [ball, ball, ball], nodes))
    done = simplify.simplify_scene(scene, max_distance=0.05)
    before, after = ([mesh.num_faces for mesh in s.meshes] for s in (scene, done.scene))
    assert after[0] == before[0]
    assert after[1] < 0.7 * before[1]
    assert after[1] < after[2] < before[2]
    assert done.distance_bound is not None
    assert 0.025 < done.distance_bound <= 0.05
    scene = io.read_scene(scene_file(tmp_path / "a.glb", [ball], nodes[:1]))
    with pytest.raises(InputError, match="every instance has scale 0"):
        simplify.simplify_scene(scene, max_error=0.1)
    assert simplify.simplify_scene(scene, ratio=0.5).scene.num_faces <= scene.num_faces // 2
    # a box of the scene holds what is drawn in it
    scene = io.read_scene(scene_file(tmp_path / "a.glb", [ball], [{"mesh": 0, "scale": [1, 1, 0]}]))
    held = simplify.simplify_scene(scene, ratio=0.1, lock_box=[[-9, -9, 0], [9, 9, 0]])
    assert held.scene.num_faces == scene.num_faces


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_a_box_holds_what_any_instance_has_in_it(method: str, tmp_path: Path) -> None:
    """The larger ball is far away, the third turns its top down, and the fourth is hidden."""
    nodes: list[dict[str, Any]] = [
        {"mesh": 0, "scale": [2, 2, 2], "translation": [20, 0, 0]},
        {"mesh": 0},
        {"mesh": 0, "rotation": [1, 0, 0, 0], "translation": [0, 0, 0.1]},
        {"mesh": 0, "scale": [0, 0, 0], "translation": [0, 0, 1]},
    ]
    ball, other = sphere(24, 16), sphere(24, 16)
    scene = io.read_scene(
        scene_file(
            tmp_path / "a.glb", [ball, other], [*nodes, {"mesh": 1, "translation": [9, 0, 0]}]
        )
    )
    mesh = scene.meshes[0]
    height = mesh.vertices[:, 2]
    held = mesh.vertices[(height >= 0.9) | (height <= -0.8)]
    assert 20 < len(held) < 0.5 * mesh.num_vertices
    box = [[-1, -1, 0.9], [1, 1, 2]]
    for after in (
        simplify.simplify_scene(scene, method, ratio=0.5, lock_box=box).scene,
        simplify.scene_lods(scene, 2, ratio=0.5, method=method, lock_box=box).levels[1].scene,
    ):
        assert after.num_faces < 0.7 * scene.num_faces
        found = np.linalg.norm(held[:, None] - after.meshes[0].vertices[None], axis=2).min(axis=1)
        assert found.max() < 1e-6
    corners = [str(value) for value in np.ravel(box)]
    for verb, output in (("simplify", "b.glb"), ("lod", "c.glb")):
        more = ["--ratio", "0.5", *(["--levels", "2"] if verb == "lod" else [])]
        command = [verb, tmp_path / "a.glb", "-o", tmp_path / output, *more, "--mode", method]
        done = manip3d(*command, "--lock-box", *corners)
        assert done.returncode == 0, done.stderr
        assert f"--lock-box holds {len(held)} vertices" in done.stderr
        done = manip3d(*command, "--force", "--lock-box", *"888999")
        assert "--lock-box holds 0 vertices" in done.stderr


def test_a_boundary_may_be_locked_beside_a_box(tmp_path: Path) -> None:
    """The dome's boundary is its rim, not the seam of its texture; the box holds its top."""
    vertices, faces = sphere(24, 16)
    low = vertices[faces][:, :, 2].min(axis=1)
    scene = io.read_scene(
        scene_file(tmp_path / "a.glb", [(vertices, faces[low > -0.2])], [{"mesh": 0}])
    )
    (mesh,) = scene.meshes
    rim = mesh.vertices[simplify.boundary_vertices(mesh)]
    assert np.ptp(rim[:, 2]) < 1e-6
    options = {"lock_boundary": True, "lock_box": [[-1, -1, 0.9], [1, 1, 2]]}
    (small,) = simplify.simplify_scene(scene, ratio=0.2, **options).scene.meshes
    after = set(map(tuple, small.vertices))
    top = mesh.vertices[mesh.vertices[:, 2] >= 0.9]
    assert len(rim) >= 24
    assert len(top) > 1
    assert set(map(tuple, rim)) | set(map(tuple, top)) <= after
    levels = simplify.scene_lods(scene, 3, ratio=0.7, **options).levels
    assert len(levels) == 3
    for level in levels:
        after = set(map(tuple, level.scene.meshes[0].vertices))
        assert set(map(tuple, rim)) | set(map(tuple, top)) <= after
    with pytest.raises(InputError, match=r"lock_box: expected shape \(2, 3\)"):
        simplify.scene_lods(scene, 3, lock_box=[1, 2])


@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr"])
@pytest.mark.parametrize("scale", [[0, 0, 0], [1, 1, 0], [1, 1, 1]])
def test_a_mesh_that_cleaning_empties_is_emptied(
    method: str, scale: list[float], tmp_path: Path
) -> None:
    flat = np.array([[0, 0, 1], [1, 1, 2]], np.int32)
    meshes = [sphere(24, 16), (sphere(24, 16)[0], flat)]
    nodes: list[dict[str, Any]] = [{"mesh": 0}, {"mesh": 1, "scale": scale}]
    scene = io.read_scene(scene_file(tmp_path / "two.glb", meshes, nodes))
    done = simplify.simplify_scene(scene, method, target_faces=100)
    assert [mesh.num_faces for mesh in done.scene.meshes] == [100, 0]
    chain = simplify.scene_lods(scene, 3, method=method)
    assert len(chain.levels) == 3
    assert all(level.scene.meshes[1].num_faces == 0 for level in chain.levels[1:])
    nothing = io.read_scene(scene_file(tmp_path / "none.glb", meshes[1:], [{"mesh": 0}]))
    for simplified in (simplify.simplify_scene, simplify.scene_lods):
        with pytest.raises(InputError, match=r"scene: expected a face .* got none of 2 faces"):
            simplified(nothing, method=method, ratio=0.5)  # type: ignore[operator]


def hidden_beside_two(path: Path) -> Path:
    """Two instances of a ball, a second mesh, and one that no instance shows."""
    ball = sphere(24, 16)
    nodes: list[dict[str, Any]] = [
        {"mesh": 0},
        {"mesh": 0, "translation": [3, 0, 0]},
        {"mesh": 1, "translation": [6, 0, 0]},
        {"mesh": 2, "scale": [0, 0, 0]},
    ]
    return scene_file(path, [ball, ball, ball], nodes)


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_a_scene_under_a_ceiling_of_memory(
    method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = io.read_scene(hidden_beside_two(tmp_path / "a.glb"))
    free = simplify.simplify_scene(scene, method, ratio=0.3)
    enough = simplify.simplify_scene(scene, method, ratio=0.3, memory=1 << 40)
    for one, other in zip(free.scene.meshes, enough.scene.meshes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    with pytest.raises(InputError, match="memory: expected at least"):
        simplify.simplify_scene(scene, method, ratio=0.3, memory=1 << 20)
    with pytest.raises(InputError, match="memory: expected method='quality' or 'fast'"):
        simplify.simplify_scene(scene, "qem4vr", ratio=0.3, memory=1 << 40)
    # Two stages, as where the whole does not fit.
    plans: list[int] = []

    def first_to_half(mesh: Mesh, *_: object) -> _memory._Plan:
        plans.append(mesh.num_faces)
        return _memory._Plan(direct=False, faces=mesh.num_faces // 2)

    monkeypatch.setattr(_memory, "_plan", first_to_half)
    options = {"seam_weight": 2.0}
    staged = simplify.simplify_scene(scene, method, ratio=0.3, memory=1 << 30, options=options)
    assert len(plans) > 1
    assert 0.95 * 0.3 * scene.num_faces <= staged.scene.num_faces <= 0.3 * scene.num_faces
    with pytest.raises(InputError, match="max_distance: the whole mesh has to"):
        simplify.simplify_scene(scene, "quality", max_distance=0.1, memory=1 << 30)


def test_a_scene_has_importance(tmp_path: Path) -> None:
    scene = io.read_scene(hidden_beside_two(tmp_path / "a.glb"))
    weights = [np.where(m.vertices[:, 2] > 0.2, 50.0, 1.0) for m in scene.meshes]
    done = simplify.simplify_scene(scene, ratio=0.3, importance=np.concatenate(weights))
    for before, after in zip(scene.meshes, done.scene.meshes, strict=True):
        above = [(m.vertices[m.faces].mean(axis=1)[:, 2] > 0.3).sum() for m in (before, after)]
        below = [(m.vertices[m.faces].mean(axis=1)[:, 2] < -0.3).sum() for m in (before, after)]
        assert above[1] / above[0] > 2.0 * below[1] / below[0]
    with pytest.raises(InputError, match=r"importance: expected shape .* scene's 3 meshes, got"):
        simplify.simplify_scene(scene, ratio=0.3, importance=weights[0])
    with pytest.raises(InputError, match="importance: expected method='quality'"):
        simplify.simplify_scene(scene, "fast", ratio=0.3, importance=np.concatenate(weights))


@pytest.mark.parametrize("work", ["scene", "scene_lods", "lods", "budget"])
@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr"])
def test_one_progress_over_all_runs(
    method: str, work: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each run tells of a half, besides what it tells by itself ten times a second."""
    scene = io.read_scene(hidden_beside_two(tmp_path / "a.glb"))
    balls = [scene.meshes[0], scene.meshes[1]]
    told: list[float] = []
    runs = 0
    name = f"simplify_{method.replace('4vr', '')}"
    real = getattr(_core, name)

    def halfway(mesh: Mesh, options: object, report: Callable[[float], object]) -> Any:
        nonlocal runs
        runs += 1
        report(0.5)
        return real(mesh, options, None)

    def tell(fraction: float, _: str) -> None:
        told.append(fraction)

    monkeypatch.setattr(_core, name, halfway)
    if work == "scene":
        simplify.simplify_scene(scene, method, ratio=0.3, progress=tell)
    elif work == "scene_lods":
        simplify.scene_lods(scene, 4, method=method, progress=tell)
    elif work == "lods":
        simplify.lod_chain(balls[0], 4, method=method, progress=tell)
    else:
        simplify.share_budget(balls, 400, method=method, progress=tell)
    is_one_run = (method, work) == ("qem4vr", "lods")
    ends_of_meshes = 2 if work == "scene_lods" and method != "qem4vr" else 1
    assert len(told) == runs + (0 if is_one_run else ends_of_meshes)
    assert runs > 1 or is_one_run
    assert told == sorted(set(told))
    assert 0.0 < told[0] <= 0.5
    assert (told[-1] == 1.0) is not is_one_run  # its own end is not in `halfway`


def ball_with_buttons(path: Path, buttons: int = 3) -> Path:
    """A ball, and small balls that lie half in it, each a mesh and a node of its own."""
    vertices, faces = sphere(48, 32)
    small, small_faces = sphere(12, 8)
    meshes = [(vertices, faces)] + [(0.03 * small, small_faces)] * buttons
    nodes: list[dict[str, Any]] = [{"mesh": 0}]
    turns = np.linspace(0.0, 2.0, buttons)
    for i, turn in enumerate(turns, start=1):
        nodes.append({"mesh": i, "translation": [float(np.cos(turn)), float(np.sin(turn)), 0.0]})
    return scene_file(path, meshes, nodes)


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_small_meshes_keep_a_few_faces_while_there_is_room(method: str, tmp_path: Path) -> None:
    """The buttons vanish first by their error alone; an animation of their nodes would show it."""
    scene = io.read_scene(ball_with_buttons(tmp_path / "buttons.glb"))
    done = simplify.simplify_scene(scene, target_faces=300, method=method)
    assert done.scene.num_faces <= 300
    assert done.stop == simplify.StopReason.TARGET_REACHED
    for before, after in zip(scene.meshes, done.scene.meshes, strict=True):
        assert 0 < after.num_faces < before.num_faces
        far = metrics.metro(before, after, sampling="area", samples=5000)
        assert max(far.max, far.backward.max / far.diagonal) < 0.35


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_small_meshes_vanish_where_their_corners_would_take_a_tenth_of_the_faces(
    method: str, tmp_path: Path
) -> None:
    """Equal ones stay in the order of the file while there is room."""
    scene = io.read_scene(ball_with_buttons(tmp_path / "buttons.glb"))
    done = simplify.simplify_scene(scene, target_faces=90, method=method)
    counts = [mesh.num_faces for mesh in done.scene.meshes]
    assert done.scene.num_faces <= 90
    assert counts[1] > 0
    assert counts[2] > 0
    assert counts[3] == 0


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_small_meshes_keep_a_few_faces_in_each_level(method: str, tmp_path: Path) -> None:
    scene = io.read_scene(ball_with_buttons(tmp_path / "buttons.glb"))
    chain = simplify.scene_lods(scene, [800, 300, 200], method=method)
    for level, target in zip(chain.levels[1:], (800, 300, 200), strict=True):
        assert level.num_faces <= target
    for level in chain.levels:
        assert all(mesh.num_faces > 0 for mesh in level.scene.meshes)


@pytest.mark.parametrize(("textures", "is_seen"), [([], False), ([{"source": 0}], True)])
def test_a_texture_of_any_format_is_seen(
    textures: list[Any], is_seen: bool, tmp_path: Path
) -> None:
    """Materials hold PNG and JPEG images alone: the file tells of others."""
    scene = scene_of(Mesh(*grid(8, 8)))
    assert not scene.has_textures
    made = json.loads(scene._document)
    scene = replace(scene, _document=json.dumps({**made, "textures": textures}).encode())
    assert scene.has_textures is is_seen
    told = []

    def run(mesh: Mesh, **_: Any) -> Any:
        told.append(any(material.textures for material in mesh.materials))
        return simplify.quality(mesh, target_faces=20)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("manip3d.simplify._scene.runner", lambda _: run)
        simplify.simplify_scene(scene, target_faces=20)
    assert told == [is_seen]


@pytest.mark.golden
def test_a_scene_of_turned_instances_is_the_same_bytes_everywhere(
    tmp_path: Path, golden: Callable[[str, object], None]
) -> None:
    """Products of transforms, and of vertices with them, depend on the BLAS if it makes them."""
    turns = ([0.1, 0.3, 0.5, 0.8], [0.7, -0.1, 0.1, 0.7], [0.5, 0.5, -0.1, 0.7])
    nodes: list[dict[str, Any]] = [{"children": [1, 3, 5], "scale": [1.1, 0.9, 1.3]}]
    for number, turn in enumerate(turns):
        w, x, y, z = turn  # Python 3.12 and later add up sum() more exactly
        length = math.sqrt(w * w + x * x + y * y + z * z)
        nodes.append({"rotation": [each / length for each in turn], "children": [2 * number + 2]})
        nodes.append(
            {"mesh": number % 2, "translation": [0.3, 2.1 * number, 0.7], "scale": [0.7] * 3}
        )
    meshes = [
        (mesh.vertices, mesh.faces) for mesh in (exact_models.ball(21), exact_models.hill(31))
    ]
    scene = io.read_scene(scene_file(tmp_path / "scene.glb", meshes, nodes))
    digest = hashlib.sha256()
    for mode in ("quality", "fast"):
        result = simplify.simplify_scene(scene, mode, ratio=0.1)
        result.scene.write(tmp_path / "simplified.glb")
        digest.update((tmp_path / "simplified.glb").read_bytes() + result.max_error.hex().encode())
    golden("scene of turned instances", digest.hexdigest())
