"""Pipes and devices, which may go on for ever, are refused where files are read."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import manip3d
import rgbd_frames
from manip3d import FormatError, InputError, LidarFrame, authenticate, batch, capture, io
from manip3d._util.json import unsealed

# A mistake would wait for a writer, or read for ever: each case runs in a process of its own.
PROGRAM = textwrap.dedent(
    """
    import json, os, resource, signal, sys
    import numpy as np
    from pathlib import Path
    from manip3d import FormatError, authenticate, camera, capture, diary, forge, io, report, serve
    from manip3d import viewer
    from manip3d.diary._sealing import read_key
    from manip3d.io._images import read_color
    from manip3d.io._utd_mhad import read_trial
    from manip3d.study import StudyFolder
    from manip3d.study._definition import read_table

    def refused(code, path):
        signal.alarm(60)
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        try:
            exec(code)
        except FormatError as error:
            return "expected a regular file" in str(error)
        return False

    for code, path in json.load(sys.stdin):
        child = os.fork()
        if child == 0:
            os._exit(0 if refused(code, path) else 1)
        if os.waitpid(child, 0)[1] != 0:
            print(code, path)
    """
)
SCANS = (
    ".pcd",
    ".bin",
    ".ply",
    ".3d",
    ".csv",
    ".npy",
    ".las",
    ".laz",
    ".e57",
    ".ptx",
    ".pcd.gz",
    ".ply.xz",
)
MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".obj.gz", ".ply.xz", ".3mf", ".dae")
READERS = {
    "io.read_mesh(path)": MESHES,
    "io.read_scene(path)": (".glb", ".gltf"),
    "io.read_scan(path)": SCANS,
    "io.read_depth(path)": (".png", ".npy", ".tif"),
    "io.read_range_grid(path)": (".ply",),
    "capture.open('pcap:' + path).read()": (".pcap",),
    "capture.read_velodyne_calibration(path)": (".xml", ".yaml"),
    "authenticate.SensorLattice.load(path)": (".json",),
    "camera.read_intrinsics(path, width=64, height=48)": (".json",),
    "forge.read_stream_truth(path)": (".npz",),
    "serve.kept_certificate(path, '127.0.0.1')": (".pem",),
    "read_key(Path(path))": (".key",),
    "diary.load_questionnaire(path)": (".json",),
    "read_color(Path(path))": (".png",),
    "np.save(path + '.npy', np.ones((4, 4), np.uint16));"
    "viewer.open_thing(path + '.npy', color=path)": (".png",),
    "read_table(path)": (".toml", ".json"),
    "read_trial(Path(path))": ("_depth.mat",),
}
Case = tuple[str, str]


def not_refused(cases: list[Case]) -> str:
    """Return the cases that were read, that waited, or that failed with another error."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def make_special(path: Path, kind: str) -> None:
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")


KINDS = ("pipe", "device")


def test_readers_refuse_it(tmp_path: Path) -> None:
    cases = []
    for code, suffixes in READERS.items():
        for suffix, kind in itertools.product(suffixes, KINDS):
            path = tmp_path / f"{len(cases)} {kind}{suffix}"
            make_special(path, kind)
            cases.append((code, str(path)))
    assert not_refused(cases) == ""


def test_a_mesh_can_come_from_a_pipe_of_the_shell() -> None:
    """A pipe of the shell on stdin is read, unlike a named pipe, since its writer is known."""
    done = subprocess.run(
        [sys.executable, "-c", "import manip3d; print(manip3d.read_mesh('/dev/stdin').num_faces)"],
        input="v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("1\n", "")


def recording_with(victim: str, kind: str, path: Path) -> Case:
    capture.record(rgbd_frames.frames(2), path, lossless_color=True)
    place = path / victim
    if place.is_dir():
        place = sorted(place.iterdir())[1]
    place.unlink()
    make_special(place, kind)
    return "list(capture.open('folder:' + path))", str(path)


def tum_folder_with(victim: str, kind: str, path: Path) -> Case:
    path.mkdir()
    for file in ("depth.txt", "rgb.txt"):
        (path / file).write_text("1.0 depth/1.png\n")
    (path / victim).unlink()
    make_special(path / victim, kind)
    return "capture.open('tum:' + path)", str(path)


def test_folders_of_frames_refuse_it(tmp_path: Path) -> None:
    victims = ("calibration.json", "frames.jsonl", "depth", "colour", "body_index")
    cases = []
    for kind in KINDS:
        folder = tmp_path / kind
        folder.mkdir()
        cases += [recording_with(name, kind, folder / f"of {name[:5]}") for name in victims]
        cases += [
            tum_folder_with(name, kind, folder / f"tum {name[:3]}")
            for name in ("depth.txt", "rgb.txt")
        ]
    assert not_refused(cases) == ""


def test_a_link_to_a_regular_file_is_one(tmp_path: Path) -> None:
    scan = LidarFrame(np.random.default_rng(0).random((9, 3), np.float32))
    io.write_scan(scan, tmp_path / "a.pcd")
    (tmp_path / "b.pcd").symlink_to("a.pcd")
    np.testing.assert_array_equal(io.read_scan(tmp_path / "b.pcd").points, scan.points)


def test_the_message_says_what_was_expected(tmp_path: Path) -> None:
    make_special(tmp_path / "a.pcd", "pipe")
    with pytest.raises(FormatError, match=r"a\.pcd.*expected a regular file, got a pipe"):
        io.read_scan(tmp_path / "a.pcd")


BARE = re.compile(
    r"""\.read_bytes\(|\.read_text\(|\.open\(["']rb["']|\bopen\([^)]*["']rb["']|Image\.open\((?!io\.|file\b)"""
)
OURS = {
    "_util/fingerprint.py": 2,
    "_util/memory.py": 3,
    "batch/_earlier.py": 2,
    "batch/_places.py": 1,
    "capture/_bag_process.py": 1,
    "datasets/_registry.py": 1,
    "datasets/_tables.py": 1,
    "experiments/_depth_pictures.py": 2,
    "experiments/_environment.py": 1,
    "experiments/_pictures.py": 2,
    "experiments/_published.py": 1,
    "experiments/_store.py": 2,
    "experiments/cameras_5.py": 1,
    "experiments/stories.py": 2,
    "io/_interop.py": 1,
    "io/_remote.py": 3,
    "modify/_joints.py": 1,
    "modify/_motions.py": 1,
    "report/_html.py": 1,
    "serve/_bundles.py": 1,
    "simulate/lidar.py": 1,
    "study/_reading.py": 1,
    "viewer/page.py": 2,
}
"""Number of plain `open` calls per module. They open files of the package and of the system, of our
own temporary folders, stores and experiments, files that are known to be regular, downloads that
have just been made, and the start of a remote ``.glb``."""


def test_files_of_users_are_opened_as_regular_files() -> None:
    root = Path(io.__file__).parents[1]
    found: dict[str, int] = {}
    for file in sorted(root.rglob("*.py")):
        lines = file.read_text(encoding="utf-8").splitlines()
        code = [line for line in lines if not line.lstrip().startswith((">>>", "...", "#"))]
        count = sum(bool(BARE.search(line)) for line in code)
        name = str(file.relative_to(root))
        if count and name not in ("io/_files.py", "_util/regular_files.py"):
            found[name] = count
    assert found == OURS, "manip3d.io._files.open_regular and regular_bytes read files of users"


def test_json_that_nests_too_deep_is_no_json(tmp_path: Path) -> None:
    deep = b"[" * 100_000
    assert unsealed(deep) is None
    path = tmp_path / "a.json"
    path.write_bytes(deep)
    with pytest.raises(FormatError, match=r"a\.json"):
        authenticate.SensorLattice.load(path)
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FormatError, match=r"a\.json.*at most 1048576 bytes"):
        authenticate.SensorLattice.load(path)


POINTER = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'4d7a' * 16}\nsize 123\n"


@pytest.mark.parametrize(
    "name",
    ["a.bin", "a.pcd", "a.ply", "a.csv", "a.las", "a.e57", "a.ptx", "a.npy", "a.glb", "a.gltf",
     "a.obj", "a.stl", "a.png", "a.exr"],
)  # fmt: skip
def test_pointers_of_git_lfs_are_named(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_text(POINTER)
    suffix = file.suffix
    readers: list[Callable[[Path], object]] = []
    if suffix in io.SCAN_SUFFIXES:
        readers.append(io.read_scan)
    if suffix in io.READABLE:
        readers.append(manip3d.read_mesh)
    if suffix in (".glb", ".gltf"):
        readers.append(io.read_scene)
    if suffix in io.DEPTH_SUFFIXES:
        readers.append(io.read_depth)
    if suffix in (".pcd", ".ply"):
        readers.append(io.read_range_grid)
    for read in readers:
        with pytest.raises(FormatError, match="git lfs pull") as caught:
            read(file)
        assert caught.value.file == str(file)


def test_pipes_in_folders_are_left_out_of_batches(tmp_path: Path) -> None:
    """Batches leave out pipes, on which a reader would wait for ever; dangling links are errors."""
    io.write_mesh(manip3d.Mesh(np.eye(3), np.array([[0, 1, 2]])), tmp_path / "a.obj")
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "gone.obj").symlink_to(tmp_path / "nowhere.obj")
    for source in (tmp_path, tmp_path / "*.obj"):
        names = [Path(file.name).name for file in batch.find_files(source, suffixes=[".obj"])]
        assert names == ["a.obj", "gone.obj"]
    os.mkfifo(tmp_path / "pipe.pcap")
    with pytest.raises(InputError, match=r"layout, or files \(\.pcap\), found none"):
        batch.find_drives(tmp_path, suffixes=[".pcap"])
