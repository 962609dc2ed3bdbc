"""A short run of hostile_files.py: each reader on damaged files, in a process with limits."""

from __future__ import annotations

import subprocess
import sys

import hostile_files
import pytest

CASES = 400
"""For each kind: 8 800 in all; the long run is for the night."""


@pytest.mark.parametrize("kind", hostile_files.KINDS)
def test_damaged_files_end_in_errors_of_ours(kind: str) -> None:
    for module in hostile_files.NEEDS.get(kind, ()):
        pytest.importorskip(module)
    # In an interpreter of its own: it forks, which a process with other threads must not.
    command = [sys.executable, hostile_files.__file__, "--kind", kind, "--cases", str(CASES)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{kind}: {CASES} cases" in done.stdout
