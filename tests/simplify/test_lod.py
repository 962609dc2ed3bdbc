"""Levels of detail from one run, the files they go to, and a budget that models share."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import manip3d
from gltf_files import PNG, json_of
from manip3d import InputError, Material, Mesh, Texture, _core, io, read_mesh, simplify
from manip3d.simplify import lod_chain, polygon_budget, qem4vr, share_budget
from zoo import grid, sphere


def hills(columns: int = 20) -> Mesh:
    vertices, faces = grid(columns, columns)
    vertices[:, 2] = np.sin(vertices[:, 0] * 0.6) + np.cos(vertices[:, 1] * 0.5)
    return Mesh(
        vertices,
        faces,
        texcoords=vertices[:, :2] / columns,
        face_texcoords=faces,
        face_material=np.zeros(len(faces), np.int32),
        materials=[Material("grass", textures={"base_color": Texture(data=PNG)})],
    )


def test_levels_equal_runs_of_their_own() -> None:
    mesh = hills()
    chain = lod_chain(mesh, 4, ratio=0.4, method="qem4vr")
    assert [level.num_faces for level in chain.levels] == [800, 320, 128, 51]
    assert chain.levels[0].mesh is mesh
    for level, target in zip(chain.levels[1:], (320, 128, 51), strict=True):
        own = qem4vr(mesh, target_faces=target)
        np.testing.assert_array_equal(level.mesh.faces, own.mesh.faces)
        np.testing.assert_array_equal(level.mesh.vertices, own.mesh.vertices)
        assert level.max_error == own.max_error


def test_quality_levels_are_runs_from_the_input() -> None:
    mesh = hills()
    chain = lod_chain(mesh, 3, ratio=0.3, method="quality", options={"texture_weight": 0.1})
    for level, most in zip(chain.levels, (800, 240, 72), strict=True):
        assert most - 2 <= level.num_faces <= most
    for level, target in zip(chain.levels[1:], (240, 72), strict=True):
        own = simplify.quality(mesh, target_faces=target, texture_weight=0.1)
        np.testing.assert_array_equal(level.mesh.vertices, own.mesh.vertices)
        assert level.max_error == own.max_error
    kept = lod_chain(mesh, [400, 4], options={"max_distance": 0.3})
    assert len(kept.levels) == 2
    assert kept.result.stop == "distance_limit"
    with pytest.raises(InputError, match="options: expected arguments of quality, got curvature"):
        lod_chain(mesh, method="quality", options={"curvature": "paper"})


def test_levels_that_cannot_be_reached_are_left_out() -> None:
    ball = Mesh(*sphere(12, 6))
    chain = lod_chain(ball, [60, 20, 1], method="qem-orig")
    assert [level.num_faces for level in chain.levels] == [144, 60, 20]
    assert chain.result.stop == "no_legal_collapse"


def test_options_go_to_the_method() -> None:
    mesh = hills()
    chain = lod_chain(mesh, [400, 2], options={"max_distance": 0.1})
    assert chain.result.stop == "distance_limit"
    assert [level.num_faces for level in chain.levels] in ([800, 400], [800, 399])
    with pytest.raises(InputError, match=r"options: .*got color"):
        lod_chain(mesh, options={"color": 1})
    with pytest.raises(InputError, match="method"):
        share_budget([mesh], 9, method="best")


@pytest.mark.parametrize(
    ("levels", "ratio", "message"),
    [
        (1, 0.5, "levels"),
        (3, 1.0, "ratio"),
        (3, 0.0, "ratio"),
        ([], 0.5, "levels"),
        ([9, 9], 0.5, "levels"),
        ([3, 0], 0.5, "levels"),
    ],
)
def test_bad_levels_are_refused(levels: int | list[int], ratio: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        lod_chain(hills(4), levels, ratio=ratio)


def test_one_glb_holds_all_levels(tmp_path: Path) -> None:
    chain = lod_chain(hills(), 3)
    chain.write(tmp_path / "hills.glb")
    document = json_of(tmp_path / "hills.glb")
    node = document["nodes"][0]
    assert document["extensionsUsed"] == ["MSFT_lod"]
    assert document["scenes"] == [{"nodes": [0]}]
    assert node["extensions"] == {"MSFT_lod": {"ids": [1, 2]}}
    assert node["extras"]["MSFT_screencoverage"] == [0.5, 0.25, 0.0]
    assert len(document["nodes"]) == len(document["meshes"]) == 3
    assert len(document["materials"]) == len(document["images"]) == 1
    counts = [
        document["accessors"][mesh["primitives"][0]["indices"]]["count"] // 3
        for mesh in document["meshes"]
    ]
    assert counts == [800, 400, 200]
    back = read_mesh(tmp_path / "hills.glb")  # who does not know the extension sees the finest
    assert back.num_faces == 800
    assert back.materials == hills().materials


def test_other_readers_show_the_finest_level(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    lod_chain(hills(), 3).write(tmp_path / "hills.glb")
    scene = trimesh.load(tmp_path / "hills.glb", force="scene")
    placed = {scene.graph[name][1] for name in scene.graph.nodes_geometry}
    assert 800 in {len(scene.geometry[name].faces) for name in placed}


def test_a_folder_holds_a_glb_for_each_level_and_a_manifest(tmp_path: Path) -> None:
    chain = lod_chain(hills(), [400, 100])
    chain.write(tmp_path / "hills")
    manifest = json.loads((tmp_path / "hills" / "lods.json").read_text())
    assert "boundaries and seams there; no bound" in manifest["error_measure"]
    assert "surface quadric" in lod_chain(hills(4), [9], method="qem-orig").error_measure
    assert [level["faces"] for level in manifest["levels"]] == [800, 400, 100]
    assert [level["screen_coverage"] for level in manifest["levels"]] == [0.5, 0.125, 0.0]
    for level, made in zip(manifest["levels"], chain.levels, strict=True):
        assert read_mesh(tmp_path / "hills" / level["file"]).num_faces == level["faces"]
        assert level["max_error"] == made.max_error


def test_a_folder_of_levels_is_replaced_only_where_nothing_else_is_in_it(tmp_path: Path) -> None:
    """The folder is replaced as a whole: the mesh itself would be lost, if it lies there."""
    io.write_lods([hills(), hills(4)], tmp_path / "levels")
    io.write_lods([hills()], tmp_path / "levels")
    assert sorted(p.name for p in (tmp_path / "levels").iterdir()) == ["level_0.glb", "lods.json"]
    (tmp_path / "levels" / "hills.obj").write_text("mine")
    with pytest.raises(InputError, match=r"output: .*levels holds other files: hills\.obj"):
        io.write_lods([hills(4)], tmp_path / "levels")
    assert (tmp_path / "levels" / "hills.obj").read_text() == "mine"
    assert (tmp_path / "levels" / "level_0.glb").is_file()


@pytest.mark.parametrize("name", ["levels", "levels.glb"])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"errors": [0.1]}, "errors: expected 2 finite numbers"),
        ({"errors": [0.1, 0.2, 0.3]}, "errors: expected 2 finite numbers"),
        ({"errors": [0.1, np.nan]}, "errors: expected 2 finite numbers"),
        ({"coverages": [0.1, 0.9]}, "coverages: expected them in descending order"),
    ],
)
def test_errors_and_coverages_that_do_not_fit_the_levels_are_refused(
    name: str, options: dict[str, list[float]], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        io.write_lods([hills(), hills(4)], tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["levels", "levels.glb"])
def test_levels_that_grow_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"levels: expected the finest first, got \[\d+, \d+\]"):
        io.write_lods([hills(4), hills()], tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("most", [3, 64, 65535])
def test_primitives_of_limited_size(most: int, tmp_path: Path) -> None:
    mesh = Mesh(*grid(300, 300)) if most == 65535 else hills()
    io.write_mesh(mesh, tmp_path / "mesh.glb", max_vertices=most)
    document = json_of(tmp_path / "mesh.glb")
    primitives = document["meshes"][0]["primitives"]
    assert len(primitives) > 1
    for primitive in primitives:
        count = document["accessors"][primitive["attributes"]["POSITION"]]["count"]
        assert count <= most
        assert document["accessors"][primitive["indices"]]["componentType"] == 5123
    back = read_mesh(tmp_path / "mesh.glb")
    np.testing.assert_array_equal(
        back.vertices[back.faces], mesh.vertices.astype(np.float32)[mesh.faces]
    )


def test_limits_are_for_gltf_only(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="glb"):
        io.write_mesh(hills(4), tmp_path / "mesh.ply", max_vertices=65535)
    with pytest.raises(InputError, match="max_vertices"):
        io.write_mesh(hills(4), tmp_path / "mesh.glb", max_vertices=2)
    with pytest.raises(InputError, match="suffix"):
        io.write_lods([hills(4)], tmp_path / "mesh.ply")
    with pytest.raises(InputError, match="coverages"):
        io.write_lods([hills(4)], tmp_path / "mesh.glb", coverages=[1.0, 0.5])


def test_a_budget_goes_where_the_error_is() -> None:
    rough = hills()
    smooth = rough.replace(vertices=rough.vertices * [1, 1, 0.1])
    told: list[float] = []
    shared = share_budget(
        [rough, smooth], 400, method="qem4vr", progress=lambda fraction, _: told.append(fraction)
    )
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert shared.reached
    assert 398 <= shared.num_faces <= 400
    first, second = shared.levels
    assert first.num_faces > 2 * second.num_faces
    assert shared.num_faces == first.num_faces + second.num_faces
    # No collapse of either record would have been cheaper than those made.
    assert qem4vr(rough, target_faces=first.num_faces).max_error == first.max_error
    assert shared.max_error == max(first.max_error, second.max_error)


@pytest.mark.parametrize("method", ["quality", "fast"])
def test_a_shared_budget_leaves_every_model_with_the_same_error(method: str) -> None:
    """A flat strip with a wavy outline has no error in its surface, but has one in its rim."""
    rough = hills()
    vertices, faces = grid(200, 1)
    vertices[:, 1] *= 4 + np.sin(vertices[:, 0] / 4)
    comb = Mesh(vertices, faces)
    shared = share_budget([rough, comb], 400, method=method)
    assert shared.reached
    assert 390 <= shared.num_faces <= 400
    errors = [level.max_error for level in shared.levels]
    assert min(errors) > 0.3 * max(errors)
    assert shared.levels[1].num_faces > 20
    with pytest.raises(InputError, match="options: expected arguments of"):
        share_budget([rough], 100, method=method, options={"curvature": "paper"})
    limited = share_budget([rough, comb], 20, method=method, options={"max_error": 0.05})
    assert not limited.reached
    assert limited.max_error <= 0.05


def test_a_budget_that_is_no_limit_changes_nothing_and_one_that_is_too_small_is_missed() -> None:
    mesh = hills(4)
    assert share_budget([mesh, mesh], 64).levels[0].mesh is mesh
    with pytest.raises(InputError, match="method: expected one of quality, fast, qem"):
        share_budget([mesh, mesh], 64, method="nonsense")
    for method in ("quality", "qem4vr"):
        with pytest.raises(InputError, match="options: expected arguments of"):
            share_budget([mesh, mesh], 64, method=method, options={"nonsense": 1})
    missed = share_budget([mesh, mesh], 3)
    assert not missed.reached
    with pytest.raises(InputError, match="meshes"):
        share_budget([], 3)
    with pytest.raises(InputError, match="faces"):
        share_budget([mesh], 0)


def test_faces_left_agree_with_replays() -> None:
    mesh = hills(8)
    result = qem4vr(mesh, target_faces=10)
    left = simplify._lod._faces_left(mesh, result)
    assert left[-1] == result.mesh.num_faces
    for count in left[:: len(left) // 7]:
        assert result.level_of_detail(int(count)).num_faces == count


@pytest.mark.parametrize("record", [[(5, 6), (5, 9)], [(5, 6), (6, 5)], [(5, 5)], [(5, 99)]])
def test_a_record_names_only_vertices_that_are_left(record: list[tuple[int, int]]) -> None:
    with pytest.raises(InputError, match="collapses: expected two vertices that are left"):
        _core.faces_left(Mesh(*grid(3, 3)), np.array(record, dtype=np.int32))


def test_the_command_writes_levels(tmp_path: Path) -> None:
    hills().write(tmp_path / "hills.obj")
    done = manip3d("lod", str(tmp_path / "hills.obj"), "-o", str(tmp_path / "out.glb"), "--json")
    assert done.returncode == 0
    assert [level["faces"] for level in json.loads(done.stdout)["levels"]] == [800, 400, 200, 100]
    assert len(json_of(tmp_path / "out.glb")["meshes"]) == 4
    done = manip3d(
        "lod", str(tmp_path / "hills.obj"), "-o", str(tmp_path / "levels"), "--levels", "2"
    )
    assert done.returncode == 0
    assert (tmp_path / "levels" / "lods.json").exists()
    (tmp_path / "levels" / "mine.obj").write_text("no mesh")  # is told before the mesh is read
    done = manip3d("lod", tmp_path / "levels" / "mine.obj", "-o", tmp_path / "levels", "--force")
    assert done.returncode == 1
    assert "holds other files (mine.obj); give another folder" in done.stderr


def test_the_command_simplifies_as_the_other_one_and_tells_of_levels_that_are_missing(
    tmp_path: Path,
) -> None:
    """A comb in a plane: its outline is all that it has."""
    vertices, faces = grid(40, 1)
    vertices[:, 1] *= 1 + 3 * (np.arange(len(vertices)) % 2)
    Mesh(vertices, faces).write(tmp_path / "comb.obj")
    order = ("lod", str(tmp_path / "comb.obj"), "-o", str(tmp_path / "out"), "--levels")
    done = manip3d(*order, "3", "--json")
    record = json.loads(done.stdout)
    assert "boundaries" in record["error_measure"]
    assert record["levels"][2]["max_error"] > 0.01
    manifest = json.loads((tmp_path / "out" / "lods.json").read_text())
    assert manifest["error_measure"] == record["error_measure"]
    assert manip3d(*order, "30", "--force").returncode == 0
    missed = manip3d(*order, "30", "--force", "--strict")
    assert missed.returncode == 4
    assert "could be made" in missed.stderr


def test_the_command_takes_many(tmp_path: Path) -> None:
    for name in ("a.obj", "b.obj"):
        hills(8).write(tmp_path / name)
    both = (tmp_path / "a.obj", tmp_path / "b.obj")
    done = manip3d("lod", *both, "-o", tmp_path / "out", "--jobs", "1")
    assert done.returncode == 0
    for name in ("a.glb", "b.glb"):
        assert len(json_of(tmp_path / "out" / name)["meshes"]) == 4


def test_a_budget_is_the_time_between_two_pictures_over_that_of_a_triangle() -> None:
    assert polygon_budget(10.0, 50, views=1, share=1.0) == 2_000_000
    assert polygon_budget(10.0, 50) == 800_000
    assert polygon_budget(10.0, 50, other_ms=8.0) == 400_000
    assert polygon_budget(10.0, 50, other_ms=30.0) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 90.0), "ms_per_million: expected a number > 0"),
        ((1.0, float("nan")), "refresh_hz: expected a number > 0"),
        ((1e-323, 1e-300), "ms_per_million: .* gives no number"),
    ],
)
def test_a_budget_without_sense_is_refused(arguments: tuple[float, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        polygon_budget(*arguments)
    for name, value in {"views": 0, "share": 0.0, "other_ms": -1.0}.items():
        with pytest.raises(InputError, match=f"{name}: expected"):
            polygon_budget(1.0, 90.0, **{name: value})  # type: ignore[arg-type]


def test_the_command_takes_a_headset(tmp_path: Path) -> None:
    hills().write(tmp_path / "hills.obj")
    order = ("simplify", str(tmp_path / "hills.obj"), "-o", str(tmp_path / "out.ply"), "--json")
    done = manip3d(*order, "--headset", "20000", "90")  # 8.9 ms for two eyes
    assert done.returncode == 0
    assert json.loads(done.stdout)["target_faces"] == 222
    assert manip3d(*order, "--force", "--headset", "20000", "90", "--faces", "9").returncode == 1
