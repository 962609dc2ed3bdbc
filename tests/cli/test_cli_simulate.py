"""``manip3d simulate`` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import error_line, manip3d
from manip3d.datasets import open_kitti
from manip3d.io import read_mesh, read_scan

pytest.importorskip("open3d")


def test_a_street_becomes_a_drive_that_the_loader_reads(tmp_path: Path) -> None:
    pytest.importorskip("PIL.Image")
    output = tmp_path / "drives"
    done = manip3d("simulate", "sim:street", "-o", output, "--frames", 1, "--seed", 3, "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    (frame,) = open_kitti(record["drive"])
    assert frame.scan().num_points > 90_000
    assert set(frame.images) == {2, 3}
    assert "exists already" in error_line(manip3d("simulate", "sim:street", "-o", output))


def test_a_scene_becomes_a_scan(tmp_path: Path) -> None:
    output = tmp_path / "office.bin"
    done = manip3d("simulate", "indoor-00", "-o", output, "--resolution", 1, "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert record["rows"] * record["columns"] == 36_000
    assert read_scan(output).num_points == record["points"] > 30_000


def test_cameras_all_around_need_pictures(tmp_path: Path) -> None:
    asked = ("simulate", "sim:street", "-o", tmp_path / "drives", "--surround", "--no-pictures")
    assert "--surround: cannot be given with --no-pictures" in error_line(manip3d(*asked))
    assert not (tmp_path / "drives").exists()


@pytest.mark.parametrize(
    ("source", "option", "told"),
    [
        ("sim:jet", ("--frames", 3), "--frames: can only be given with a drive, got sim:jet"),
        ("sim:street", ("--resolution", 1), "--resolution: can only be given with a scene, got a"),
        ("indoor-00", ("--no-pictures",), "--no-pictures: can only be given with a drive, got a s"),
        ("sim:rocker", ("--surround",), "--surround: can only be given with a drive, got sim:rock"),
        ("sim:jet", ("--seed", 1), "sim:lifeboat, sim:rocker, got sim:jet"),
    ],
)
def test_options_without_effect_are_refused(
    source: str, option: tuple[object, ...], told: str, tmp_path: Path
) -> None:
    line = error_line(manip3d("simulate", source, "-o", tmp_path / "out.bin", *option))
    assert told in line
    assert not list(tmp_path.iterdir())


def test_unknown_sources_and_suffixes_are_one_line(tmp_path: Path) -> None:
    line = error_line(manip3d("simulate", "sim:moon", "-o", tmp_path / "moon"))
    assert "sim:moon: expected sim:street or a scene" in line
    line = error_line(manip3d("simulate", "sim:street?seed=1&frames=2", "-o", tmp_path / "s"))
    assert "expected sim:street; give --seed and --frames as options" in line
    line = error_line(manip3d("simulate", "indoor-00", "-o", tmp_path / "a.odt"))
    assert "a.odt: expected a name that ends in " in line
    assert " .bin, " in line


def test_a_model_becomes_a_mesh_file(tmp_path: Path) -> None:
    output = tmp_path / "jet.obj.gz"
    done = manip3d("simulate", "sim:jet", "-o", output, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["faces"] == read_mesh(output).num_faces > 30_000
    output = tmp_path / "lifeboat.glb"
    done = manip3d("simulate", "sim:lifeboat", "-o", output, "--seed", 3, "--json")
    assert json.loads(done.stdout)["seed"] == 3
    assert "expected a name that ends in .obj, " in error_line(
        manip3d("simulate", "sim:jet", "-o", tmp_path / "jet.bin")
    )
