"""Errors as programs read them: a code that stays, and the position as fields."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from command_line import manip3d
from manip3d import errors


def run(*words: str) -> tuple[int, dict[str, Any]]:
    """The exit code and the error on stdout."""
    done = manip3d(*words)
    assert done.stderr.startswith("manip3d: error: ")
    return done.returncode, json.loads(done.stdout)["error"]


def test_a_damaged_file_is_a_format_error_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "damaged.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 zero\nf 1 2 3\n")
    code, error = run("info", str(path), "--json")
    assert code == 1
    assert (error["code"], error["file"], error["line"]) == ("format", str(path), 3)
    assert error["reason"] in error["message"]


def test_an_option_of_a_wrong_value_is_an_input_error(tmp_path: Path) -> None:
    code, error = run("reproduce", "table-0.0", "--json", "-o", str(tmp_path / "out"))
    assert code == 1
    assert error["code"] == "input"


def test_a_file_that_is_not_there_is_a_file_error(tmp_path: Path) -> None:
    path = str(tmp_path / "nothing.obj")
    code, error = run("info", path, "--json")
    assert code == 1
    assert (error["code"], error["file"]) == ("file", path)


def test_stdout_stays_empty_without_json(tmp_path: Path) -> None:
    done = manip3d("info", tmp_path / "nothing.obj")
    assert (done.returncode, done.stdout) == (1, "")


def test_each_class_has_a_code_of_its_own() -> None:
    found = [c for c in vars(errors).values() if isinstance(c, type)]
    classes = [c for c in found if issubclass(c, errors.Error)]
    assert len({c.code for c in classes}) == len(classes) == 7


@pytest.mark.parametrize(
    "error",
    [
        errors.InputError("faces: expected 3 columns, got 2"),
        errors.FormatError("cut off", file="a.ply", byte_offset=17),
        errors.MissingExtraError("laspy", "las"),
        errors.BrokenExtraError("laspy", "las", "no module"),
    ],
)
def test_details_are_json(error: errors.Error) -> None:
    details = json.loads(json.dumps(error.details()))
    assert details["message"] == str(error)
    assert details["code"] == type(error).code
