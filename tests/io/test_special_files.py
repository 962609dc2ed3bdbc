"""Pipes and devices, which may go on for ever, are refused where files are read."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import rgbd_frames
from manip3d import FormatError, LidarFrame, capture, io

# A mistake would wait for a writer, or read for ever: each case runs in a process of its own.
PROGRAM = textwrap.dedent(
    """
    import json, os, resource, signal, sys
    import numpy as np
    from manip3d import FormatError, authenticate, capture, io

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
SCANS = (".pcd", ".bin", ".ply", ".3d", ".las", ".laz", ".e57", ".pcd.gz", ".ply.xz")
READERS = {
    "io.read_scan(path)": SCANS,
    "io.read_depth(path)": (".png", ".npy", ".tif"),
    "io.read_range_grid(path)": (".ply",),
    "capture.open('pcap:' + path).read()": (".pcap",),
    "capture.read_velodyne_calibration(path)": (".xml", ".yaml"),
    "authenticate.SensorLattice.load(path)": (".json",),
}
Case = tuple[str, str]


def not_refused(cases: list[Case]) -> str:
    """The cases that were read, that waited, or that failed in another way."""
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


each_kind = pytest.mark.parametrize("kind", ["pipe", "device"])


@each_kind
def test_readers_refuse_it(kind: str, tmp_path: Path) -> None:
    cases = []
    for code, suffixes in READERS.items():
        for suffix in suffixes:
            path = tmp_path / f"{len(cases)}{suffix}"
            make_special(path, kind)
            cases.append((code, str(path)))
    assert not_refused(cases) == ""


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


@each_kind
def test_folders_of_frames_refuse_it(kind: str, tmp_path: Path) -> None:
    victims = ("calibration.json", "frames.jsonl", "depth", "colour", "body_index")
    cases = [recording_with(name, kind, tmp_path / f"of {name[:5]}") for name in victims]
    cases += [
        tum_folder_with(name, kind, tmp_path / f"tum {name[:3]}")
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
