"""Killed writers leave the old file or the new one; their litter goes with the next write."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def test_old_or_new_and_no_litter(request: pytest.FixtureRequest) -> None:
    """A thousand kills with ``--hypothesis-profile=nightly``."""
    nightly = request.config.getoption("--hypothesis-profile") == "nightly"
    path = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(HERE / "killed_writers.py"), "1000" if nightly else "100"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
