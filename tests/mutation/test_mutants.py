"""The list of mutants fits the code, and a change to the package reaches its tests."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mutate import HERE, ROOT, module_of, mutants, verdict

MUTANTS = mutants()


def test_each_mutant_is_one_place_of_the_code() -> None:
    for mutant in MUTANTS:
        assert (ROOT / mutant["file"]).read_text().count(mutant["old"]) == 1, mutant
        assert mutant["old"] != mutant["new"]
        assert all((ROOT / test).exists() for test in mutant["tests"].split()), mutant


def test_ten_kernels_have_one() -> None:
    assert len({m["file"] for m in MUTANTS if m["file"].startswith("cpp/")}) >= 10


@pytest.mark.parametrize(("new", "expected"), [("cx=self.cx * sx,", "killed"), (None, "survived")])
def test_a_change_reaches_the_tests(new: str | None, expected: str) -> None:
    mutant = next(m for m in MUTANTS if m["old"].startswith("cx=(self.cx"))
    about = {
        "module": module_of(mutant["file"]),
        "path": str(ROOT / mutant["file"]),
        "old": mutant["old"],
        "new": new or mutant["old"],
    }
    quick = {**mutant, "tests": mutant["tests"] + " -k resized"}
    assert verdict(quick, about, 600) == expected


def test_the_runner_knows_what_was_asked_for() -> None:
    command = [sys.executable, str(Path(HERE) / "mutate.py"), "no such file"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "no mutant of no such file\n")
