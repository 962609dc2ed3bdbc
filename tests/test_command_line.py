"""The processes in which tests run the command line."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

import command_line


def test_what_python_reads_at_its_start_is_that_of_the_command() -> None:
    with pytest.raises(AssertionError, match="does not start with this environment"):
        command_line.manip3d("--version", PYTHONHASHSEED="no number")


def test_a_command_that_is_given_up_answers_no_other_one(tmp_path: Path) -> None:
    server = command_line._server(dict(os.environ))
    server.connection.settimeout(0.3)
    words = ["capture", "record", "sim:body?frames=100000", "-o", str(tmp_path / "a")]
    with pytest.raises(TimeoutError):
        server.run(words, dict(os.environ), b"")
    assert server.process.returncode == -signal.SIGKILL
    assert command_line.manip3d("nonsense").returncode == 2
    assert command_line.manip3d("--version").returncode == 0
