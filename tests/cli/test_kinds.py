"""A source of the wrong kind is named, with the commands that take it, before any work."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import manip3d
from manip3d.cli import app
from manip3d.cli.kinds import NAMES, SHOWN, VERBS, OtherKindError, expect_kind, kind_of

Image = pytest.importorskip("PIL.Image")

RANGE_GRID = "ply\nformat ascii 1.0\nelement vertex 0\nelement range_grid 0\nend_header\n"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One small source of each kind."""
    folder = tmp_path_factory.mktemp("kinds")
    found = {
        "mesh": folder / "mesh.ply", "scan": folder / "scan.bin", "range grid": folder / "grid.ply",
        "depth": folder / "depth.png", "packets": folder / "lidar.pcap",
        "recording": folder / "recording", "drive": folder / "drive",
        "picture": folder / "picture.png", "results": folder / "results",
        "truth": folder / "forged.truth.npz", "folder": folder / "folder",
        "unknown": folder / "notes.xyzzy",
    }  # fmt: skip
    manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).write(found["mesh"])
    manip3d.LidarFrame(np.eye(3, dtype=np.float32)).write(found["scan"])
    found["range grid"].write_text(RANGE_GRID)
    Image.fromarray(np.full((4, 5), 1000, np.uint16)).save(found["depth"])
    Image.fromarray(np.zeros((4, 5, 3), np.uint8)).save(found["picture"])
    np.savez(found["truth"], masks=np.zeros(1, np.uint8))
    found["packets"].write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
    for name in ("recording", "results", "folder"):
        found[name].mkdir()
    (found["recording"] / "frames.jsonl").touch()
    (found["results"] / "results.json").touch()
    (found["drive"] / "velodyne").mkdir(parents=True)
    found["unknown"].write_text("nothing")
    return found


TAKEN = {
    "simplify": ("mesh", "folder"),
    "depth": ("depth", "range grid", "folder"),
    "compare": ("mesh",),
    "convert": ("mesh", "scan", "range grid", "packets", "drive"),
    "inspect": ("scan", "drive", "packets", "recording"),
    "forge lidar": ("scan",),
    "phantom render": ("recording",),
}


def arguments(verb: str, source: Path, mesh: Path, folder: Path) -> list[str]:
    """A whole command line for a verb on a source."""
    out = str(folder / "out.glb")
    lines = {
        "simplify": [str(source), "-o", out, "--faces", "9"],
        "depth": [str(source), "-o", out, "--points", "9", "--intrinsics", "5,5,2,2"],
        "compare": [str(mesh), str(source)],
        "convert": [str(source), "-o", str(folder / "out.ply")],
        "inspect": [str(source)],
        "forge lidar": ["translation", str(source), "-o", str(folder / "out.bin")],
        "phantom render": [str(source), "-o", str(folder / "out")],
    }
    return [*verb.split(), *lines[verb]]


def test_a_ply_of_points_that_says_it_has_no_faces_is_a_scan(tmp_path: Path) -> None:
    path = tmp_path / "meshlab.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
        "property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
        "1 2 3\n4 5 6\n"
    )
    assert kind_of(str(path)) == "scan"
    done = CliRunner().invoke(app, ["convert", str(path), "-o", str(tmp_path / "b.bin")])
    assert done.exit_code == 0, done.output
    assert np.fromfile(tmp_path / "b.bin", np.float32).tolist() == [1, 2, 3, 0, 4, 5, 6, 0]
    told = CliRunner().invoke(app, ["info", str(path)])
    assert "range" in told.output


def test_every_kind_is_told(files: dict[str, Path]) -> None:
    assert set(files) == set(NAMES)
    assert {kind: kind_of(str(path)) for kind, path in files.items()} == {k: k for k in files}
    assert kind_of("-") == kind_of("sim:body?frames=2") == "stream"
    with pytest.raises(FileNotFoundError):
        kind_of("absent.obj")


@pytest.mark.parametrize("verb", TAKEN)
def test_other_kinds_name_their_commands(verb: str, files: dict[str, Path], tmp_path: Path) -> None:
    for kind, path in files.items():
        if kind in TAKEN[verb] or kind == "unknown" or path.is_dir():
            continue
        done = CliRunner().invoke(app, arguments(verb, path, files["mesh"], tmp_path))
        message = str(done.exception)
        assert done.exit_code == 1, (verb, kind)
        assert f"{path} is {NAMES[kind]}; {verb} takes " in message
        assert VERBS.get(kind, "manip3d.forge.read_stream_truth") in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.ptx", "a.ply"])
def test_scans_that_depth_refuses_say_which_ones_it_takes(name: str, tmp_path: Path) -> None:
    """An organised PTX, and a PLY that PCL writes with an element camera."""
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    more = " 0.5" if name == "a.ptx" else ""
    points = "".join(f"{u} {v} 1{more}\n" for u in (0, 1) for v in (0, 1))
    head = {
        "a.ptx": "2\n2\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
        "a.ply": f"ply\nformat ascii 1.0\nelement vertex 4\n{properties}element camera 1\n"
        "property float view_px\nend_header\n",
    }
    (tmp_path / name).write_text(head[name] + points + ("0\n" if name == "a.ply" else ""))
    done = CliRunner().invoke(app, arguments("depth", tmp_path / name, tmp_path, tmp_path))
    assert done.exit_code == 1
    assert "depth (of an organised cloud as .pcd, .npy or .npz, or as " in str(done.exception)


def test_the_commands_named_for_a_kind_take_it(files: dict[str, Path]) -> None:
    for verb, kinds in TAKEN.items():
        for kind in kinds:
            assert verb in VERBS[kind], (verb, kind)


def test_a_file_of_unknown_kind_is_refused_where_no_reader_looks_into_it(
    files: dict[str, Path],
) -> None:
    with pytest.raises(manip3d.InputError, match="a file of unknown kind; inspect takes"):
        expect_kind(str(files["unknown"]), "scan", verb="inspect")
    assert expect_kind(str(files["unknown"]), "mesh", verb="simplify") == "unknown"


def test_advice_on_another_format_is_for_what_the_command_takes(tmp_path: Path) -> None:
    """An HDF5 file may hold points or a depth image; only depth has an option for Hypersim's."""
    path = tmp_path / "a.h5"
    path.touch()
    points, image = "write its columns x, y, z, intensity as .npz", "write its array as .npy"

    def refusal(*kinds: str, verb: str) -> str:
        with pytest.raises(OtherKindError) as refused:
            expect_kind(str(path), *kinds, verb=verb)
        return str(refused.value)

    told = refusal("recording", verb="phantom render")
    assert told == f"{path} is a file of unknown kind; phantom render takes an RGB-D recording"
    told = refusal("depth", verb="depth")
    assert (points in told, image in told, "--ray-depth" in told) == (False, True, True)
    told = refusal("mesh", verb="simplify")
    assert (points in told, image in told) == (True, False)
    told = refusal(*SHOWN, verb="view")
    assert (points in told, image in told, "--ray-depth" in told) == (True, True, False)


@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_arrays_that_are_no_points_say_what_points_are(suffix: str, tmp_path: Path) -> None:
    """They count as depth images, which a user may never have seen in whole coordinates."""
    path = str(tmp_path / f"a.{suffix}")
    for array in (np.ones((4, 500), np.float32), np.ones((500, 3), np.int16)):
        (np.save if suffix == "npy" else np.savez)(path, array)
        with pytest.raises(OtherKindError, match=r"An ar\w+ of points has") as refused:
            expect_kind(path, "scan", verb="inspect")
        assert "holds no points as inspect reads them" in str(refused.value)
        assert "is a depth image" not in str(refused.value)
    with pytest.raises(OtherKindError) as caught:
        expect_kind(path, "mesh", verb="simplify")
    assert " of points has " not in str(caught.value)


def test_outputs_are_checked_before_the_source_is_read(
    files: dict[str, Path], tmp_path: Path
) -> None:
    files["scan"].parent.joinpath("torn.bin").write_bytes(b"\0" * 7)
    torn = files["scan"].parent / "torn.bin"

    def message(*words: object) -> str:
        done = CliRunner().invoke(app, [str(word) for word in words])
        assert done.exit_code == 1
        return str(done.exception)

    assert message("inspect", torn, "-o", tmp_path / "x.pdf").startswith("-o ")
    assert ".html, .json" in message("inspect", torn, "-o", tmp_path / "x.pdf")
    absent = tmp_path / "absent" / "x.html"
    assert f"there is no folder {absent.parent}" in message("inspect", torn, "-o", absent)
    assert "torn.bin" in message("inspect", torn, "-o", tmp_path / "x.html")
    assert ".glb" in message("simplify", files["mesh"], "-o", tmp_path / "x.png", "--faces", 9)
    assert ".mp4" in message("phantom", "render", "sim:body", "-o", tmp_path / "x.gif")


def test_what_meshes_of_a_folder_name_is_no_source_of_its_own(tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    mesh = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    mesh.write(source / "a.gltf")
    assert (source / "a.bin").exists()
    (source / "b.obj").write_text("mtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (source / "b.mtl").write_text("newmtl m\nmap_Bump -bm 0.5 maps/height.png\n")
    (source / "maps").mkdir()
    Image.fromarray(np.full((4, 5), 1000, np.uint16)).save(source / "maps" / "height.png")
    manip3d.LidarFrame(np.eye(3, dtype=np.float32)).write(source / "c.bin")

    told = CliRunner().invoke(app, ["info", str(source), "--json", "-q", "--jobs", "1"])
    assert told.exit_code == 0, told.output
    names = [Path(row["source"]).name for row in json.loads(told.stdout)]
    assert names == ["a.gltf", "b.obj", "c.bin"]
    url = f"file://{source}"
    told = CliRunner().invoke(app, ["info", url, "--json", "-q", "--jobs", "1"])
    assert Path(json.loads(told.stdout)[0]["source"]).name == "a.gltf"
    assert not any(row["source"].endswith("a.bin") for row in json.loads(told.stdout))

    out = tmp_path / "out"
    order = ["convert", str(source), "-o", str(out), "--to", ".ply", "-q", "--jobs", "1"]
    assert CliRunner().invoke(app, order).exit_code == 0
    assert sorted(path.name for path in out.glob("*.ply")) == ["a.ply", "b.ply", "c.ply"]


def test_sources_that_differ_in_their_suffix_only_keep_it(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    mesh = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for name in ("head.ply", "head.obj", "hand.stl"):
        mesh.write(source / name)
    order = ["convert", str(source), "-o", str(out), "--to", ".glb", "-q", "--jobs", "1"]
    told = CliRunner().invoke(app, order)
    assert told.exit_code == 0, told.output
    names = sorted(path.name for path in out.glob("*.glb"))
    assert names == ["hand.glb", "head.obj.glb", "head.ply.glb"]
    told = CliRunner().invoke(app, ["compare", str(source), str(out), "--json", "-q", "-j", "1"])
    assert told.exit_code == 0, told.output
    originals = [Path(row["original"]).name for row in json.loads(told.stdout)]
    assert originals == ["hand.stl", "head.obj", "head.ply"]
