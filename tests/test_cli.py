"""The command line as a user meets it: verbs, exit codes, streams."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest


def manip3d(
    *arguments: str | Path, stdin: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "manip3d", *map(str, arguments)],
        capture_output=True,
        input=stdin,
        env=os.environ | environment,
        check=False,
    )
    return subprocess.CompletedProcess(
        done.args, done.returncode, done.stdout.decode(), done.stderr.decode()
    )


def error_line(done: subprocess.CompletedProcess[str]) -> str:
    """The one line that a failed command leaves on stderr."""
    assert done.returncode == 1, done
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("manip3d: error: ")
    return line


def test_version() -> None:
    done = manip3d("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("manip3d 0.")


def test_help_is_quick() -> None:
    times = []
    for _ in range(5):
        started = time.perf_counter()
        assert manip3d("--help").returncode == 0
        times.append(time.perf_counter() - started)
    assert min(times) < 0.5  # 0.25 s on a machine that does nothing else


def test_no_arguments_and_wrong_ones_are_usage_errors() -> None:
    assert manip3d().returncode == 2
    assert manip3d("nonsense").returncode == 2
    assert manip3d("reproduce", "--scale", "huge").returncode == 2


def test_data_list_says_what_is_missing(tmp_path: Path) -> None:
    here = {"MANIP3D_DATA": str(tmp_path), "MANIP3D_CACHE": str(tmp_path / "cache")}
    done = manip3d("data", "list", "--json", **here)
    records = json.loads(done.stdout)
    assert len(records) == 24
    assert not any(record["here"] for record in records)
    text = manip3d("data", "list", **here).stdout
    assert "missing, can be fetched" in text
    assert "missing, get by hand" in text
    assert "0 of 24 here" in text


def test_data_get_shows_the_licence_first_and_honours_offline(tmp_path: Path) -> None:
    done = manip3d(
        "data",
        "get",
        "rockerArm",
        MANIP3D_DATA=str(tmp_path),
        MANIP3D_CACHE=str(tmp_path),
        MANIP3D_OFFLINE="1",
    )
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    assert any("licence" in line for line in lines[:-1])
    assert "MANIP3D_OFFLINE" in lines[-1]


def test_unknown_data_set_is_one_line() -> None:
    assert "got 'nothing'" in error_line(manip3d("data", "get", "nothing"))


def test_traceback_only_for_debug() -> None:
    assert "Traceback" in manip3d("data", "get", "nothing", MANIP3D_LOG="debug").stderr


def test_wrong_log_level_is_refused() -> None:
    assert "MANIP3D_LOG" in error_line(manip3d("data", "list", MANIP3D_LOG="loud"))


def test_doctor_reports_state_and_cure(tmp_path: Path) -> None:
    done = manip3d(
        "doctor",
        "--json",
        MANIP3D_DATA=str(tmp_path),
        MANIP3D_RENDERER="none",
        MANIP3D_CACHE=str(tmp_path / "cache"),
    )
    assert done.returncode == 0
    checks = {check["what"]: check for check in json.loads(done.stdout)}
    assert checks["core"]["state"] == "ok"
    assert checks["real data"]["state"] == "missing"
    assert "MANIP3D_DATA" in checks["real data"]["cure"]
    assert checks["off-screen pictures"]["state"] == "missing"


def test_doctor_finds_a_broken_setting(tmp_path: Path) -> None:
    done = manip3d("doctor", MANIP3D_DATA=str(tmp_path / "absent"), MANIP3D_RENDERER="none")
    assert done.returncode == 1
    assert "BROKEN" in done.stdout


def test_unknown_experiment_is_refused() -> None:
    assert "got table-9.9" in error_line(manip3d("reproduce", "table-9.9"))


@pytest.mark.parametrize("as_json", [False, True])
def test_colour_and_control_codes_stay_out_of_pipes(as_json: bool) -> None:
    done = manip3d("data", "list", *(["--json"] if as_json else []))
    assert "\x1b" not in done.stdout
