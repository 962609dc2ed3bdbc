"""Runs of the command line in processes of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path


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
    words = [str(word) for word in done.args]
    if "--json" in words:
        assert json.loads(done.stdout)["error"]["code"]
    else:
        assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("manip3d: error: ")
    return line
