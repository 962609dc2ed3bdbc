"""Run a peer in a process of its own, so that a crash or its settings do not affect the others."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
Row = dict[str, Any]


def run_peer(peer: str, source: Path, outputs: dict[int, Path], timeout_s: float) -> list[Row]:
    """Return the output of `run_peer.py` for each target; targets without output have failed."""
    pairs = [text for target, path in outputs.items() for text in (str(target), str(path))]
    command = [sys.executable, str(HERE / "run_peer.py"), peer, str(source), *pairs]
    rest: Row = {"status": "failed"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
        said = done.stdout
        if done.returncode != 0:
            rest["message"] = (done.stderr.strip() or f"exit {done.returncode}").splitlines()[-1]
    except subprocess.TimeoutExpired as expired:
        printed = expired.stdout or b""
        said = printed if isinstance(printed, str) else printed.decode()
        rest = {"status": "timeout", "message": f"more than {timeout_s:.0f} s"}
    rows = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    return rows + [dict(rest) for _ in range(len(outputs) - len(rows))]
