"""Kill safety: nothing that was acknowledged is lost, whenever the program is killed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")

from manip3d.diary import make_key

LOOP = Path(__file__).parent / "kill_loop.py"


def killed(folder: Path, kills: int, seed: int, key: Path | None) -> None:
    words = [str(folder), str(kills), str(seed), *([str(key)] if key else [])]
    done = subprocess.run(
        [sys.executable, str(LOOP), *words], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["kills"] == kills
    # Most kills fall between writes of games, and not before the first one.
    assert found["without_a_game"] <= 0.7 * kills


@pytest.mark.parametrize("is_encrypted", [False, True])
def test_what_was_acknowledged_survives_kills(
    tmp_path: Path, is_encrypted: bool, request: pytest.FixtureRequest
) -> None:
    """A hundred kills with ``--hypothesis-profile=nightly``."""
    nightly = request.config.getoption("--hypothesis-profile") == "nightly"
    key = tmp_path / "k.key" if is_encrypted else None
    if key:
        make_key(key)
    killed(tmp_path, 100 if nightly else 15, 1, key)
