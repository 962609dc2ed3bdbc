"""``manip3d study`` as somebody types it: what it prints, and what it refuses in one line."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from command_line import manip3d as run
from manip3d.cli.study import study_stimuli


@pytest.fixture
def definition(tmp_path: Path) -> Path:
    file = tmp_path / "study.toml"
    assert run("study", "define", "display", "-o", file, "--example", "-q").returncode == 0
    return file


def test_a_definition_is_not_replaced_without_force(definition: Path) -> None:
    before = definition.read_bytes()
    done = run("study", "define", "rating", "-o", definition)
    assert done.returncode == 1
    assert "exists already; --force replaces it" in done.stderr
    assert definition.read_bytes() == before
    assert run("study", "define", "rating", "-o", definition, "--force").returncode == 0
    assert definition.read_bytes() != before


def test_an_empty_definition_names_what_is_empty(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    run("study", "define", "display", "-o", file)
    done = run("study", "display", file, "-o", tmp_path / "a", "--no-open", "--seconds", "1")
    assert done.returncode == 1
    assert "consent: expected a list of 1 to 100 different texts that are not empty" in done.stderr
    assert not (tmp_path / "a").exists()


def test_another_kind_of_study_is_refused(definition: Path, tmp_path: Path) -> None:
    done = run("study", "jnd", definition, "-o", tmp_path / "a", "--no-open", "--seconds", "1")
    assert done.returncode == 1
    assert "expected a definition of a jnd, got display" in done.stderr
    assert not (tmp_path / "a").exists()


def test_a_study_without_its_stimuli_leaves_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    run("study", "define", "jnd-textured", "--example", "-o", file)
    done = run("study", "jnd", file, "-o", tmp_path / "a", "--no-open", "--seconds", "1")
    assert done.returncode == 1
    assert "expected a stimulus, found none" in done.stderr
    assert not (tmp_path / "a").exists()


def test_from_simulated_people_to_results(definition: Path, tmp_path: Path) -> None:
    answers, tables = tmp_path / "answers", tmp_path / "tables"
    done = run("study", "simulate", definition, "-o", answers, "--participants", "3", "--json")
    assert json.loads(done.stdout)["participants"] == ["sim-000", "sim-001", "sim-002"]
    assert json.loads(done.stdout)["seed"] == 0
    assert run("study", "withdraw", answers, "sim-001").returncode == 0
    done = run("study", "results", answers, "-o", tables, "--json")
    assert json.loads(done.stdout)["files"] == [
        "answers.csv",
        "participants.csv",
        "redcap_dictionary.csv",
        "summary.csv",
        "summary.html",
    ]
    assert "sim-001" not in (tables / "participants.csv").read_text()
    done = run("study", "results", answers, "-o", tables)
    assert done.returncode == 1
    assert "exists already; --force replaces it" in done.stderr
    assert run("study", "results", answers, "-o", tables, "--force").returncode == 0


def test_what_is_damaged_is_told_beside_the_results(definition: Path, tmp_path: Path) -> None:
    answers, tables = tmp_path / "answers", tmp_path / "tables"
    run("study", "simulate", definition, "-o", answers, "--participants", "3", "-q")
    journal = answers / "participants" / "sim-001.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b"consent", b"consenu", 1))
    done = run("study", "results", answers, "-o", tables, "--json")
    assert done.returncode == 0
    assert "left out sim-001: " in done.stderr
    assert list(json.loads(done.stdout)["damaged"]) == ["sim-001"]


def test_a_code_that_nobody_can_have_is_refused(definition: Path, tmp_path: Path) -> None:
    words = ["study", "display", definition, "-o", tmp_path / "a", "--no-open", "--seconds", "1"]
    done = run(*words, "--participant", "a b")
    assert done.returncode == 1
    assert "--participant: expected letters, digits, - and _" in done.stderr


def test_stimuli_are_told_one_by_one_where_stderr_is_no_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def make(definition: Path, *, progress: Callable[[float, str], object], **_: object) -> object:
        progress(0.5, "color clip")
        return SimpleNamespace(count=1, folder=tmp_path, problems=())

    monkeypatch.setattr("manip3d.study.make_stimuli", make)
    study_stimuli(tmp_path / "study.toml")
    assert "50%  color clip" in capsys.readouterr().err
    study_stimuli(tmp_path / "study.toml", quiet=True)
    assert capsys.readouterr().err == ""


def test_power_is_a_table(tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    done = run("study", "power", "0.5", "--comparisons", "1", "--json")
    found = json.loads(done.stdout)
    assert found["participants"] == 34
    assert found["power"]["34"] >= 0.8
    assert json.loads(run("study", "power", "-0.5", "--comparisons", "1", "--json").stdout) == found
    assert run("study", "power", "0.5", "--comparison", "1").returncode == 2
    done = run("study", "power", "0")
    assert done.returncode == 1
    assert "effect: expected an effect that" in done.stderr


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_ctrl_c_ends_a_study(definition: Path, tmp_path: Path, number: str) -> None:
    pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")
    from manip3d.viewer.page import BUNDLE

    if not (BUNDLE.parent / "study.js").exists():
        pytest.skip("the page is not built: make setup")
    words = ["study", "display", str(definition), "-o", str(tmp_path / "a"), "--no-open"]
    process = subprocess.Popen(
        [sys.executable, "-m", "manip3d", *words], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    line = process.stderr.readline()
    assert re.fullmatch(r"open http://127\.0\.0\.1:\d+/\?token=\S+\n", line)
    process.send_signal(getattr(signal, number))
    _, rest = process.communicate(timeout=30)
    assert process.returncode == 0
    assert "0 participants, 0 to the end; 0 answers in" in rest


def test_options_of_a_rating_are_refused_for_a_jnd(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    run("study", "define", "jnd-textured", "--example", "-o", file)
    for name, value in (("surfaces", 2), ("images", tmp_path), ("frames", 3), ("seed", 1)):
        done = run("study", "stimuli", file, f"--{name}", value)
        assert f"--{name}: can only be given with a rating, got a jnd" in done.stderr
    assert not (tmp_path / "stimuli-textured").exists()
    rating = tmp_path / "rating.toml"
    run("study", "define", "rating", "--example", "-o", rating)
    done = run("study", "stimuli", rating, "--images", tmp_path, "--frames", 3)
    assert "--frames: cannot be given with images, which are copied" in done.stderr
