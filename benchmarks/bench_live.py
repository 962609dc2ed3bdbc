"""Latency of the live session, from the capture of a frame to its decoding in headless Chromium.

Server, browser and source run on this machine. Run it alone: ``python -m benchmarks.bench_live
[SECONDS]``. The frames come from a recording that is simulated beforehand, so that their rendering
takes no time. Chromium draws without a graphics card, which causes most of the load.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from manip3d import capture
from manip3d.phantom import run_live, simulated_patient
from manip3d.viewer import _chromium

FRAMES = 300
WINDOW = (1280, 800)
START_S = 20.0  # longest time for the browser to start, seconds


def main(seconds: float) -> None:
    with tempfile.TemporaryDirectory() as name:
        address = _recorded(Path(name) / "patient.mkv")
        told: dict[str, Any] = {}

        def on_start(url: str, made: object) -> None:
            threading.Thread(target=_watch, args=(url, seconds, told), daemon=True).start()

        report = run_live(
            address, affected="right_arm", seconds=seconds + START_S, on_start=on_start
        )
    print(
        json.dumps(
            {
                "first_frame_s": round(report.first_frame_s or 0.0, 2),
                "frames_per_second": round(report.frames / report.seconds, 2),
                "stage_ms": {name: round(value, 2) for name, value in report.stage_ms.items()},
                "server": list(report.clients),
                "page": told,
            },
            indent=1,
        )
    )


def _recorded(path: Path) -> str:
    capture.record(simulated_patient("right_arm") + f"&frames={FRAMES}", path)
    return f"mkv:{path}"


def _watch(url: str, seconds: float, told: dict[str, Any]) -> None:
    with _chromium.open_address(url, WINDOW) as tab:
        time.sleep(seconds)
        told.update(tab.evaluate("manip3dLive.stats()"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", type=float, nargs="?", default=30.0, help="default: 30")
    main(parser.parse_args().seconds)
