"""Streams, numbers and names that are not as usual end in a message and an exit code."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import rgbd_frames
from command_line import error_line, manip3d
from manip3d import Mesh, RgbdFrame, capture

MESH = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    path = tmp_path / "square.obj"
    MESH.write(path)
    return path


def in_shell(command: str, *arguments: object) -> subprocess.CompletedProcess[bytes]:
    """Run a line of bash, in which ``manip3d`` is the command and ``$1`` an argument."""
    program = f'manip3d() {{ "{sys.executable}" -m manip3d "$@"; }}; {command}'
    return subprocess.run(
        ["bash", "-c", program, "bash", *map(str, arguments)], capture_output=True, check=False
    )


@pytest.mark.parametrize("number", ["99999999999999999999999", str(2**63 - 1), "-1", "0"])
@pytest.mark.parametrize("option", ["--faces", "--jobs"])
def test_huge_numbers(option: str, number: str, mesh: Path, tmp_path: Path) -> None:
    done = manip3d("simplify", mesh, "-o", tmp_path / "o.obj", "--ratio", 1, option, number)
    assert done.returncode in (0, 1, 2), done
    assert "internal error" not in done.stderr
    if done.returncode:
        assert option in done.stderr or option.strip("-") in done.stderr


@pytest.mark.parametrize("number", [2**31, 2**63, 10**30])
def test_huge_numbers_of_threads(number: int, mesh: Path) -> None:
    line = error_line(manip3d("compare", mesh, mesh, "--jobs", str(number), "-q"))
    assert "threads: expected" in line


def test_stdout_that_is_closed(mesh: Path, tmp_path: Path) -> None:
    done = in_shell('manip3d info "$1" -q >&-', mesh)
    assert done.returncode == 1
    assert done.stderr.decode() == "manip3d: error: Bad file descriptor\n"
    out = tmp_path / "out.obj"
    done = in_shell('manip3d simplify "$1" -o "$2" --ratio 1 >&-', mesh, out)
    assert done.returncode == 0
    assert out.read_bytes().startswith(b"v ")  # nothing was printed into it


def test_stderr_that_is_closed(tmp_path: Path) -> None:
    done = in_shell('manip3d info "$1" 2>&-', tmp_path / "nothing.obj")
    assert (done.returncode, done.stdout, done.stderr) == (1, b"", b"")


def test_stdin_that_is_closed() -> None:
    done = in_shell("manip3d info - <&-")
    assert done.returncode == 1
    assert done.stderr.startswith(b"manip3d: error: ")
    assert b"internal" not in done.stderr


def test_stdin_that_is_empty() -> None:
    told = "manip3d: error: standard input: expected a mesh, got nothing"
    assert error_line(manip3d("info", "-")) == told
    assert "standard input: unknown mesh format" in error_line(manip3d("info", "-", stdin=b"no"))


def test_stdin_that_never_ends() -> None:
    done = in_shell("manip3d --max-bytes 3000000 info - </dev/zero")
    assert done.returncode == 1
    told = b"standard input: expected at most max_bytes = 3000000 bytes, got more\n"
    assert done.stderr == b"manip3d: error: " + told


def test_stdin_that_is_slow(mesh: Path) -> None:
    """The writer ends only after the reader: a limit that does not hold would wait for ever."""
    command = [sys.executable, "-m", "manip3d", "--max-seconds", "0.2", "info", "-"]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(command, **pipes) as process:  # type: ignore[call-overload]
        process.stdin.write(mesh.read_bytes())
        process.stdin.flush()
        told = b"manip3d: error: standard input: reading takes more than max_seconds = 0.2\n"
        assert process.stderr.read() == told
        assert process.wait() == 1


def test_stdin_is_read_within_its_limits(mesh: Path) -> None:
    size = str(mesh.stat().st_size)
    done = manip3d("--max-bytes", size, "--max-seconds", "99", "info", "-", stdin=mesh.read_bytes())
    assert done.returncode == 0, done.stderr


def test_stdin_holds_one_mesh(mesh: Path) -> None:
    done = manip3d("compare", "-", "-", stdin=mesh.read_bytes())
    assert done.returncode == 2
    assert "stdin holds one mesh" in done.stderr


def test_the_format_of_a_mesh_without_a_suffix_is_told(mesh: Path, tmp_path: Path) -> None:
    bare = mesh.rename(tmp_path / "bare")
    assert f"read {bare} (obj): 4 vertices" in manip3d("info", bare).stderr


@pytest.mark.parametrize("option", ["", "--json"])
@pytest.mark.parametrize("stream", [">/dev/full", "| exec false"])
def test_readers_of_stdout_that_fail(stream: str, option: str, mesh: Path) -> None:
    done = in_shell(f'manip3d info "$1" -q {option} {stream}; exit "${{PIPESTATUS[0]}}"', mesh)
    assert done.returncode == 1, done
    full = b"manip3d: error: No space left on device\n"
    assert done.stderr == (full if "full" in stream else b"")


def test_verdicts_that_nobody_reads(tmp_path: Path) -> None:
    """The exit code of a verdict is not that of a success when its text is lost."""
    np.random.default_rng(0).random((100, 4), np.float32).tofile(tmp_path / "scan.bin")
    done = in_shell('manip3d inspect "$1" -q --json >/dev/full', tmp_path / "scan.bin")
    assert done.returncode == 1, done


@pytest.mark.parametrize("option", ["", "--json"])
@pytest.mark.parametrize("encoding", ["utf-8:strict", "ascii:strict"])
def test_names_that_no_encoding_has(encoding: str, option: str, mesh: Path) -> None:
    odd = mesh.with_name(os.fsdecode(b"a\xff\xc3.obj"))
    mesh.rename(odd)
    environment = f"PYTHONIOENCODING={encoding}"
    done = in_shell(f'export {environment}; manip3d info "$1" {option}', odd)
    assert done.returncode == 0, done.stderr
    assert b"\\udcff" in done.stdout
    if option:
        assert json.loads(done.stdout)["faces"] == 2
    done = in_shell(f'export {environment}; manip3d info "$1".gone {option}', odd)
    assert done.returncode == 1
    assert b"No such file" in done.stderr


@pytest.mark.parametrize(
    "text", ["", "null", "[]", "{", "{}", '{"experiments": 3}', "\xff", "[" * 9000], ids=range(8)
)
def test_results_that_are_none(text: str, tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(text, encoding="latin-1")
    line = error_line(manip3d("report", tmp_path))
    assert "results.json" in line
    assert "internal error" not in line


def test_recording_tells_frames_and_skeletons(tmp_path: Path) -> None:
    first, *others = rgbd_frames.frames(3)
    nobody = [dataclasses.replace(frame, skeletons=()) for frame in others]
    done = capture.record([first, *nobody], tmp_path / "one")
    assert (done.frames, done.frames_with_skeleton) == (3, 1)
    capture.record(nobody, tmp_path / "none")
    for name, count in (("one", "3 frames"), ("none", "2 frames")):
        told = manip3d("capture", "record", tmp_path / name, "-o", tmp_path / f"{name}-again")
        assert told.returncode == 0, told.stderr
        assert count in told.stderr
        assert ("no frame of the source has a skeleton" in told.stderr) == (name == "none")


@pytest.mark.parametrize("damage", ["missing", "damaged"])
def test_a_frame_of_a_folder_that_cannot_be_read_is_left_out(tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "walk"
    capture.record("sim:body?frames=6&color=none&room=no", folder)
    bad = sorted((folder / "depth").iterdir())[2]
    if damage == "missing":
        bad.unlink()
    else:
        bad.write_bytes(bad.read_bytes()[:60])
    for verb in (
        ["info"],
        ["play"],
        ["export", "-o", tmp_path / "walk.csv"],
        ["record", "-o", tmp_path / "walk.mkv"],
    ):
        done = manip3d("capture", verb[0], f"folder:{folder}", *verb[1:])
        assert done.returncode == 0, (verb, done.stderr)
        assert bad.name in done.stderr, verb
        assert "damaged" in done.stdout + done.stderr, verb
    assert len(list(capture.open_rgbd(f"mkv:{tmp_path / 'walk.mkv'}"))) == 5
    found = capture.summarize(capture.open_rgbd(f"folder:{folder}"))
    assert (found.num_frames, found.counters["damaged"]) == (5, 1)


def test_an_iterator_that_raises_is_not_taken_for_its_end(tmp_path: Path) -> None:
    def frames() -> Iterator[RgbdFrame]:
        yield from capture.open_rgbd("sim:body?frames=2&color=none&room=no")
        raise OSError("the network is gone")

    with pytest.raises(OSError, match="the network is gone"):
        capture.record(frames(), tmp_path / "walk.mkv")
