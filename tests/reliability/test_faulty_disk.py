"""A disk that is full or broken: typed errors, the old file or the new one, no litter."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_each_call_that_fails_is_a_typed_error(request: pytest.FixtureRequest) -> None:
    """All writers on a full disk; 2 000 cases with ``--hypothesis-profile=nightly``."""
    nightly = request.config.getoption("--hypothesis-profile") == "nightly"
    path = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(HERE / "faulty_disk.py"), "2000" if nightly else "400"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
