"""Stories run the commands that they print, and show what these wrote."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import manip3d
from manip3d import Error, Mesh, datasets
from manip3d.experiments import Case, Plan, stories
from manip3d.experiments._scan_pictures import Eye, draw_scan

SIMULATED = Plan("simulated", "quick")
KITTI = "lidar/kitti_object/velodyne/demo.bin.xz"


def case_of(name: str, plan: Plan = SIMULATED) -> Case:
    (case,) = next(s for s in stories.STORIES if s.id == f"story-{name}").cases(plan)
    return case


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file that a command wrote."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def type_commands(commands: list[str], folder: Path) -> None:
    """Type them in a shell that knows ``manip3d``."""
    bin_folder = folder.with_name("bin")
    bin_folder.mkdir()
    script = bin_folder / "manip3d"
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -m manip3d "$@"\n')
    script.chmod(0o755)
    folder.mkdir()
    path = f"{bin_folder}{os.pathsep}{os.environ['PATH']}"
    for command in commands:
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, env=os.environ | {"PATH": path},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode in (0, 3), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["depth", "model", "phantom", "scan"])
def test_typed_commands_write_what_the_story_shows(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("open3d")
    told: list[dict[str, str]] = []

    def tell(folder: Path, printed: list) -> stories.Shown:
        assert len(printed) == len(case_of(name).options["commands"])
        told.append(contents(folder))
        return stories.Shown([], [])

    monkeypatch.setattr(stories, "_TELLERS", {name: tell})
    stories.run_story(case_of(name))
    type_commands(case_of(name).options["commands"], tmp_path / "typed")
    typed = contents(tmp_path / "typed")
    # Recordings hold the time at which they were made.
    timed = {file for file in typed if file.endswith(("frames.jsonl", "calibration.json"))}
    assert len(typed) > len(timed)
    (shown,) = told
    assert {f: s for f, s in shown.items() if f not in timed} == {
        f: s for f, s in typed.items() if f not in timed
    }


def test_a_command_that_fails_is_named() -> None:
    case = case_of("model")
    command = "manip3d simplify absent.obj --ratio 0.1 -o x.glb"
    broken = Case(case.run, {**case.options, "commands": [command]})
    with pytest.raises(Error, match=f"{command}: manip3d: error: absent.obj: No such file"):
        stories.run_story(broken)


def test_commands_end_with_the_process_that_runs_them(tmp_path: Path) -> None:
    """The runner kills its workers at Ctrl-C; what they started must not go on."""
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "from pathlib import Path; from manip3d.experiments import stories\n"
        "stories._run('manip3d simulate sim:street -o drives --frames 500', Path.cwd())"
    )
    worker = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    children = Path(f"/proc/{worker.pid}/task/{worker.pid}/children")
    deadline = time.monotonic() + 60
    while not (started := children.read_text().split()) and time.monotonic() < deadline:
        time.sleep(0.05)
    worker.kill()
    worker.wait()
    (child,) = started
    while Path(f"/proc/{child}/cwd").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not Path(f"/proc/{child}/cwd").exists()


@pytest.mark.parametrize("command", ["rm -rf x", "manip3d info $NOT_SET_AT_ALL/a.obj"])
def test_other_commands_are_refused(command: str) -> None:
    with pytest.raises(Error, match="expected a command of manip3d"):
        stories.command_line(command)


def test_variables_are_filled_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_DATA", "/data")
    assert stories.command_line("manip3d info '$MANIP3D_DATA/a b.obj'")[1:] == [
        "-m", "manip3d", "info", "/data/a b.obj",
    ]  # fmt: skip


def test_recorded_data_are_used_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MANIP3D_DATA", str(tmp_path))
    auto = Plan("auto", "quick")
    assert case_of("scan", auto).options["data"] == "simulated"
    (tmp_path / KITTI).parent.mkdir(parents=True)
    (tmp_path / KITTI).write_bytes(b"a scan")
    options = case_of("scan", auto).options
    assert options["data"] == "recorded"
    assert options["files"] == {KITTI: hashlib.sha256(b"a scan").hexdigest()}
    assert f"$MANIP3D_DATA/{KITTI}" in " ".join(options["commands"])
    assert case_of("scan").options["data"] == "simulated"
    for name in ("model", "depth", "phantom"):
        assert case_of(name, auto).options["data"] == "simulated"
        assert "$MANIP3D_DATA" not in " ".join(case_of(name, auto).options["commands"])


def test_registered_files_of_stories_are_registered() -> None:
    for story in stories.STORIES:
        for name in story.data:
            assert datasets.get(name).files


def test_a_scan_is_drawn_where_it_lies() -> None:
    eye = Eye(np.array([0.0, 0.0, 0.0]), np.array([10.0, 0.0, 0.0]), (100, 80), field_deg=90.0)
    points = np.array([[10, 0, 0], [10, 5, 0], [10, 0, 5], [-10, 0, 0]], np.float32)
    pixels, depth = eye.project(points)
    # x forward, y left, z up: left is a smaller column, up a smaller row.
    np.testing.assert_allclose(pixels[:3], [[50, 40], [25, 40], [50, 15]], atol=1e-9)
    np.testing.assert_allclose(depth, [10, 10, 10, -10])
    marked = np.array([True, False, False, True])
    image = draw_scan(points, eye, marked=marked)
    assert tuple(image[40, 50]) == (226, 92, 255)
    assert (image != image[0, 0]).any(axis=2).sum() == 12  # three points of 2 x 2 pixels
    boxed = draw_scan(points, eye, marked=marked, boxes=[((10, 0, 0), (2, 2, 2))])
    assert (boxed != image).any()


def run_forked(command: str, folder: Path) -> Any:
    with contextlib.chdir(folder):
        done = manip3d(*stories.command_line(command)[3:], "--json", "--quiet")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "told",
    [
        pytest.param([story.id for story in stories.STORIES], marks=pytest.mark.slow, id="all"),
        pytest.param(["story-depth"], id="depth"),
    ],
)
def test_stories_are_told(told: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("open3d")
    pytest.importorskip("pyvista")
    from manip3d.experiments import run

    if len(told) == 1:  # its commands as they are, in processes that have imported all
        monkeypatch.setattr(stories, "_run", run_forked)
    chosen = [story for story in stories.STORIES if story.id in told]
    summary = run(chosen, tmp_path, plan=SIMULATED, jobs=1)
    assert (summary.failed, summary.problems) == (0, [])
    experiments = summary.results["experiments"]
    assert sorted(experiments) == sorted(told)
    for record in experiments.values():
        (row,) = record["rows"]
        assert row["facts"]
        for number, _ in enumerate(row["captions"]):
            assert (tmp_path / row[f"picture_{number}"]).stat().st_size > 2000
    if "story-scan" in told:
        (scan,) = experiments["story-scan"]["rows"]
        assert "The forged one: tampered." in scan["facts"][0]
    shutil.rmtree(tmp_path)


def test_a_far_wall_with_many_points_leaves_the_picture_to_the_desk() -> None:
    """A desk that fills the image and has few points, before a rough wall: the desk stays.

    By the median of the vertices the wall was the middle, and the desk a corner of the picture.
    """
    desk = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]], float)
    across, up = np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20))
    wall = np.column_stack([across.ravel(), up.ravel(), np.full(400, -4.0)])
    corner = np.add.outer(np.arange(19) * 20, np.arange(19)).ravel()
    faces = np.concatenate(
        [
            [[0, 1, 2], [0, 2, 3]],
            4 + corner[:, None] + [0, 1, 20],
            4 + corner[:, None] + [1, 21, 20],
        ]
    )
    near = stories._near(Mesh(np.concatenate([desk, wall]), faces))
    assert near.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
