"""The list of verbs that --help prints without loading them."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from manip3d.cli import _VERBS, app, load

SHORTER = ("info", "view")
"""Verbs whose first line of help is too long for the list."""


@pytest.mark.parametrize("verb", [verb for verb in _VERBS if verb not in SHORTER])
def test_the_list_says_what_the_verb_says(verb: str) -> None:
    assert load(verb).get_short_help_str(200) == _VERBS[verb]


@pytest.mark.parametrize("verb", SHORTER)
def test_short_lines_are_needed(verb: str) -> None:
    assert len(load(verb).get_short_help_str(200)) > len(_VERBS[verb])


@pytest.mark.parametrize("verb", ["simplify", "depth"])
def test_options_that_fit_no_file_are_a_usage_error_before_any_work(
    verb: str, tmp_path: Path
) -> None:
    for name in ("a.ply", "b.ply"):
        (tmp_path / name).touch()
    done = CliRunner().invoke(app, [verb, str(tmp_path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "give --" in done.stderr
    assert not (tmp_path / "out").exists()
