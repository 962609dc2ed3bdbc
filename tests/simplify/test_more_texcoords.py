"""TEXCOORD_1 and further sets: read, carried by simplified meshes, written again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gltf_files import FACES, PNG, SQUARE, Scene, data_uri
from manip3d import InputError, io, simplify
from posed_gltf import PosedGltf

Corners = tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]


def sheet(side: int, warp: Any, charts: Any, **more: Any) -> Scene:
    """A grid of `side` quads a side, warped; `charts` gives the values of a quad's corners."""
    rows: list[list[float]] = []
    first, second = [], []
    for i, j in np.ndindex(side, side):
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
            u, v = (i + a) / side, (j + b) / side
            rows.append(list(warp(u, v)))
            first.append([u, v])
            second.append(charts((i + 0.5) / side, (j + 0.5) / side, u, v))
    starts = 4 * np.arange(side * side)[:, None]
    corners = np.concatenate([starts + np.array(own) for own in ([0, 1, 2], [0, 2, 3])])
    made = Scene()
    made.json["images"] = [{"uri": data_uri(PNG, "image/png")}]
    made.json["textures"] = [{"source": 0}]
    made.json["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
            "occlusionTexture": {"index": 0, "texCoord": 1},
        }
    ]
    attributes = {
        "POSITION": made.accessor(rows, min=np.min(rows, 0).tolist(), max=np.max(rows, 0).tolist()),
        "TEXCOORD_0": made.accessor(first),
        "TEXCOORD_1": made.accessor(second),
    }
    indices = made.accessor(corners.reshape(-1), "u4")
    made.primitive(attributes, indices=indices, material=0, **more)
    return made


def corners_of(path: Path) -> Corners:
    """(F, 3, 3) positions of the corners of faces, and (F, 3, 2) each set of coordinates."""
    file = PosedGltf(path)
    places, sets = [], {"TEXCOORD_0": [], "TEXCOORD_1": []}  # type: ignore[var-annotated]
    for primitive in file.json["meshes"][0]["primitives"]:
        faces = file.accessor(primitive["indices"]).astype(int).reshape(-1, 3)
        places.append(file.accessor(primitive["attributes"]["POSITION"])[faces])
        for name, found in sets.items():
            found.append(file.accessor(primitive["attributes"][name])[faces])
    return np.concatenate(places), {name: np.concatenate(found) for name, found in sets.items()}


def two_charts(mid_u: float, _: float, u: float, v: float) -> list[float]:
    """Each half of the sheet on a chart of its own, turned and mirrored."""
    return [0.4 * v, 0.8 * u] if mid_u < 0.5 else [0.9 - 0.4 * v, 0.5 + 0.3 * u]


@pytest.mark.parametrize("method", ["quality", "fast", "qem4vr"])
def test_each_chart_of_a_second_set_stays_where_it_lies(method: str, tmp_path: Path) -> None:
    """The first set has no seam there: without care for the second, faces cross it."""
    source = tmp_path / "sheet.glb"
    source.write_bytes(sheet(16, lambda u, v: (u, v, 0.0), two_charts).glb())
    done = simplify.simplify_scene(io.read_scene(source), target_faces=40, method=method)
    done.scene.write(tmp_path / "light.glb")
    places, sets = corners_of(tmp_path / "light.glb")
    assert len(places) <= 40
    middles = places.mean(axis=1)
    for corner in range(3):
        expected = [
            two_charts(mid[0], mid[1], *place[:2])
            for mid, place in zip(middles, places[:, corner], strict=True)
        ]
        np.testing.assert_allclose(sets["TEXCOORD_1"][:, corner], expected, atol=1e-4)
    np.testing.assert_allclose(sets["TEXCOORD_0"], places[:, :, :2], atol=1e-4)


def test_a_pipe_that_is_sewn_to_itself_is_not_smeared_across_its_seam(tmp_path: Path) -> None:
    """Beside the seam 0 and 1 meet: a face over it would show the whole texture backwards."""

    def around(mid_u: float, _: float, u: float, v: float) -> list[float]:
        return [(u - 0.25) + (1.0 if mid_u < 0.25 else 0.0), v]

    def pipe(u: float, v: float) -> tuple[float, float, float]:
        angle = 2 * np.pi * u
        return np.cos(angle), np.sin(angle), 4 * v

    source = tmp_path / "pipe.glb"
    source.write_bytes(sheet(32, pipe, around).glb())
    done = simplify.simplify_scene(io.read_scene(source), ratio=0.1)
    done.scene.write(tmp_path / "light.glb")
    places, sets = corners_of(tmp_path / "light.glb")
    u = sets["TEXCOORD_1"][:, :, 0]
    assert np.ptp(u, axis=1).max() < 0.5
    angle = np.arctan2(places[:, :, 1], places[:, :, 0]) / (2 * np.pi) - 0.25
    turns = u - angle
    assert np.abs(turns - turns.round()).max() < 0.02
    np.testing.assert_allclose(sets["TEXCOORD_1"][:, :, 1], places[:, :, 2] / 4, atol=0.02)


def test_levels_of_detail_have_all_sets(tmp_path: Path) -> None:
    source = tmp_path / "sheet.glb"
    source.write_bytes(sheet(16, lambda u, v: (u, v, np.sin(3 * u)), two_charts).glb())
    simplify.scene_lods(io.read_scene(source), 3).write(tmp_path / "lods.glb", quantize=True)
    meshes = PosedGltf(tmp_path / "lods.glb").json["meshes"]
    assert len(meshes) == 3
    assert all("TEXCOORD_1" in mesh["primitives"][0]["attributes"] for mesh in meshes)


def test_a_swaying_mesh_carries_a_second_set(tmp_path: Path) -> None:
    """A morph target moves a sheet out of its plane; its vertices are parted at the seam."""
    made = sheet(16, lambda u, v: (u, v, 0.0), two_charts)
    moved = [[0.0, 0.0, u * u] for u, _, _ in _positions(made)]
    made.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": made.accessor(moved)}]
    source = tmp_path / "sheet.glb"
    source.write_bytes(made.glb())
    done = simplify.simplify_scene(io.read_scene(source), target_faces=100)
    (moves,), (mesh,) = done.scene.deformations, done.scene.meshes
    (more,) = done.scene.more_texcoords
    assert moves is not None
    assert more is not None
    assert len(moves.targets[0]) == len(more) == mesh.num_vertices
    np.testing.assert_allclose(moves.targets[0, :, 2], mesh.vertices[:, 0] ** 2, atol=0.01)
    np.testing.assert_allclose(mesh.vertices[:, 2], 0.0, atol=1e-4)


def _positions(made: Scene) -> NDArray[np.float32]:
    view = made.json["bufferViews"][made.json["accessors"][0]["bufferView"]]
    start = view["byteOffset"]
    rows = np.frombuffer(made.buffer[start : start + view["byteLength"]], "<f4")
    return rows.reshape(-1, 3)


def small(tmp_path: Path, read: int = 2) -> io.Scene:
    """A square whose texture reads a set of coordinates."""
    made = Scene()
    made.json["images"] = [{"uri": data_uri(PNG, "image/png")}]
    made.json["textures"] = [{"source": 0}]
    made.json["materials"] = [{"emissiveTexture": {"index": 0, "texCoord": read}}]
    made.primitive(
        {
            "POSITION": made.accessor(SQUARE),
            "TEXCOORD_0": made.accessor(SQUARE[:, :2]),
            "TEXCOORD_1": made.accessor((SQUARE[:, :2] * 255).astype("u1"), "u1", normalized=True),
            "TEXCOORD_2": made.accessor(SQUARE[:, 1:]),
            "TEXCOORD_4": made.accessor(SQUARE[:, 1:]),
        },
        indices=made.accessor(FACES.reshape(-1), "u2"),
        material=0,
    )
    # Bytes in pairs: each element begins at a multiple of four.
    for view in made.json["accessors"]:
        if view["componentType"] == 5121:
            packed = np.zeros((4, 4), dtype="u1")
            packed[:, :2] = (SQUARE[:, :2] * 255).astype("u1")
            view["bufferView"] = made.view(packed.tobytes(), byteStride=4)
    path = tmp_path / "square.glb"
    path.write_bytes(made.glb())
    return io.read_scene(path)


def test_all_sets_without_a_gap_are_read_and_written(tmp_path: Path) -> None:
    scene = small(tmp_path)
    assert scene.fixed == ("",)
    assert scene.warnings == ("TEXCOORD_4 of meshes that are simplified is left out",)
    (more,) = scene.more_texcoords
    assert more is not None
    assert more.dtype == np.float32
    np.testing.assert_array_equal(more[:, 0], SQUARE[:, :2])
    np.testing.assert_array_equal(more[:, 1], SQUARE[:, 1:])
    scene.write(tmp_path / "copy.glb")
    (again,) = io.read_scene(tmp_path / "copy.glb").more_texcoords
    assert again is not None
    np.testing.assert_array_equal(np.unique(again, axis=0), np.unique(more, axis=0))


def test_sets_that_no_texture_reads_are_left_out(tmp_path: Path) -> None:
    """Their seams would cost faces: light maps have hundreds of charts."""
    scene = small(tmp_path, read=0)
    assert scene.more_texcoords == (None,)
    assert len(scene.warnings) == 3
    assert scene.warnings[0] == (
        "TEXCOORD_1 of meshes that are simplified is left out: no texture reads it"
    )
    scene.write(tmp_path / "copy.glb")
    attributes = PosedGltf(tmp_path / "copy.glb").json["meshes"][0]["primitives"][0]["attributes"]
    assert sorted(attributes) == ["POSITION", "TEXCOORD_0"]


def test_a_set_that_only_a_variant_reads_comes_along(tmp_path: Path) -> None:
    made = sheet(4, lambda u, v: (u, v, 0.0), two_charts)
    made.json["materials"].insert(0, {})
    made.json["extensionsUsed"] = ["KHR_materials_variants"]
    made.json["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "worn"}]}}
    made.json["meshes"][0]["primitives"][0]["extensions"] = {
        "KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}
    }
    source = tmp_path / "variants.glb"
    source.write_bytes(made.glb())
    (more,) = io.read_scene(source).more_texcoords
    assert more is not None


def test_other_triangles_need_all_sets(tmp_path: Path) -> None:
    scene = small(tmp_path)
    mesh = scene.meshes[0]
    with pytest.raises(InputError, match="more_texcoords: expected those of mesh 0, which has"):
        scene.with_meshes({0: mesh})
    with pytest.raises(InputError, match=r"more_texcoords: expected shape \(4, S, 2\)"):
        scene.with_meshes({0: mesh}, more_texcoords={0: np.zeros((3, 1, 2), np.float32)})
    flat = scene.with_meshes({0: mesh}, more_texcoords={0: np.full((4, 1, 2), 0.5, np.float32)})
    flat.write(tmp_path / "flat.glb")
    attributes = PosedGltf(tmp_path / "flat.glb").json["meshes"][0]["primitives"][0]["attributes"]
    assert sorted(attributes) == ["POSITION", "TEXCOORD_0", "TEXCOORD_1"]


def test_a_primitive_without_a_second_set_gets_none(tmp_path: Path) -> None:
    made = sheet(4, lambda u, v: (u, v, 0.0), two_charts)
    attributes = made.json["meshes"][0]["primitives"][0]["attributes"]
    made.primitive({"POSITION": attributes["POSITION"]}, indices=3)
    source = tmp_path / "two.glb"
    source.write_bytes(made.glb())
    scene = io.read_scene(source)
    scene.write(tmp_path / "copy.glb")
    primitives = PosedGltf(tmp_path / "copy.glb").json["meshes"][0]["primitives"]
    assert ["TEXCOORD_1" in primitive["attributes"] for primitive in primitives] == [True, False]
