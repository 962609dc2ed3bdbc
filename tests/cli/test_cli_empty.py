"""Meshes without faces: an error where faces are wanted, a warning where they are counted."""

from __future__ import annotations

from pathlib import Path

import pytest

from command_line import error_line, manip3d

POINTS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
TRIANGLE = POINTS + "f 1 2 3\n"


@pytest.mark.parametrize("verb", [["simplify", "--ratio", "0.5"], ["convert"]])
def test_a_mesh_without_faces_is_an_error(verb: list[str], tmp_path: Path) -> None:
    (tmp_path / "points.obj").write_text(POINTS)
    done = manip3d(*verb, str(tmp_path / "points.obj"), "-o", str(tmp_path / "out.ply"))
    assert done.returncode == 1
    assert "points.obj: expected a mesh with faces, got none" in error_line(done)
    assert not (tmp_path / "out.ply").exists()


def test_info_counts_a_mesh_without_faces_and_warns(tmp_path: Path) -> None:
    (tmp_path / "points.obj").write_text(POINTS)
    done = manip3d("info", str(tmp_path / "points.obj"))
    assert done.returncode == 0
    assert "warning" in done.stderr
    assert "has no faces" in done.stderr


def test_nothing_left_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    done = manip3d(
        "simplify",
        str(tmp_path / "triangle.obj"),
        "-o",
        str(tmp_path / "out.ply"),
        "--max-error",
        "10",
        "--method",
        "qem-orig",
    )
    assert done.returncode == 1
    assert "nothing is left of it" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out.ply").exists()


DEGENERATE = "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 1 2\nf 3 1 3\n"


@pytest.mark.parametrize("mode", ["quality", "fast", "published"])
@pytest.mark.parametrize("verb", [["simplify", "--ratio", "0.5"], ["lod"]])
def test_faces_without_three_corners_are_an_error(
    verb: list[str], mode: str, tmp_path: Path
) -> None:
    (tmp_path / "degenerate.obj").write_text(DEGENERATE)
    output = tmp_path / "out.glb"
    done = manip3d(*verb, tmp_path / "degenerate.obj", "-o", output, "--mode", mode)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "degenerate.obj: none of its 2 faces has three different corners" in last
    assert not output.exists()
