"""The player of films, run by Node.js without a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import manip3d

FILM = Path(manip3d.__file__).parent / "viewer" / "src" / "film.js"

CLOCK = """
let waiting = new Map(), number = 0, now = 0;
globalThis.requestAnimationFrame = step => (waiting.set(++number, step), number);
globalThis.cancelAnimationFrame = request => waiting.delete(request);
Object.defineProperty(globalThis, "performance", {value: {now: () => now}});
const tick = ms => {
  now += ms;
  const steps = waiting;
  waiting = new Map();
  for (const step of steps.values()) step(now);
};
"""


def run(script: str) -> list[int]:
    """Run a script that knows `Film` and `tick`, and return the list that it prints."""
    beside = shutil.which("node", path=str(Path(sys.executable).parent))  # of `make setup`
    node = shutil.which("node") or beside
    if node is None:
        pytest.skip("Node.js is not installed: make setup")
    if not FILM.exists():
        pytest.skip("the installed package has no sources of the viewer")
    text = f"const {{Film}} = await import({json.dumps(FILM.as_uri())});{CLOCK}{script}"
    done = subprocess.run(
        [node, "--input-type=module", "-e", text], capture_output=True, text=True, check=True
    )
    found: list[int] = json.loads(done.stdout)
    return found


def test_a_film_is_played_once_at_a_time() -> None:
    """Stopped, moved and played again before the next animation frame, it goes on from there."""
    shown = run("""
        const shown = [], film = new Film(100, 10, frame => shown.push(frame));
        film.toggle();
        tick(1000);
        film.toggle(); film.show(50); film.toggle();
        for (let i = 0; i < 4; i++) tick(100);
        console.log(JSON.stringify([...shown, waiting.size]));
    """)
    assert shown == [0, 0, 10, 10, 50, 50, 51, 52, 53, 54, 1]


def test_a_stopped_film_asks_for_no_frames() -> None:
    assert run("""
        const film = new Film(100, 10, () => {});
        film.toggle();
        tick(100);
        film.toggle();
        console.log(JSON.stringify([film.frame, waiting.size]));
    """) == [1, 0]
