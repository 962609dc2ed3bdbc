"""live_soak.py [SECONDS [SOURCE]]: a live session, unattended: the simulated amputee plays game
after game into a diary, beside a client that hangs and one that leaves and comes back.

Prints a summary as JSON; exits with 1 where memory grows, a frame of a client that keeps up is lost
without being counted, a game is missing in the diary, or somebody was refused. An hour by default,
from the simulator as fast as it draws; a recording (``mkv:FILE``) is played over and over.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "phantom"))

from live_player import Player

from manip3d.diary import Diary

HOUR = 3600.0
GROWTH = 1.05  # of memory, from the second fifth of the time to the last
GAME_S = 20.0
AGAIN_S = 30.0  # after which a client leaves and comes back


def main(seconds: float, source: str | None = None) -> int:
    # In the background of a shell it is ignored, and the session that it ends would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as name:
        return soak(Path(name), seconds, [] if source is None else [f"--source={source}"])


def soak(folder: Path, seconds: float, source: list[str]) -> int:
    path, log = folder / "soak.diary", folder / "log"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm", clips=True)
    program = subprocess.Popen(
        [sys.executable, "-m", "manip3d", "phantom", "live", "--no-open", "--limb", "right-arm",
         "--diary", str(path), "--participant", "P01", "--log", str(log), "--json", *source],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert program.stderr is not None
        found = re.match(r"open (http://\S+)\n", program.stderr.readline())
        assert found is not None, program.stderr.read()
        games = play(found[1], seconds)
        program.send_signal(signal.SIGINT)
        out, _ = program.communicate(timeout=60)
    finally:
        program.kill()
    return judge(json.loads(out), log, path, games)


def play(url: str, seconds: float) -> int:
    """Games that were begun and stopped."""
    player = Player(url)
    cookie = player.stream.cookie
    hangs = Player(url, cookie=cookie, acknowledges=False)
    guest = Player(url, cookie=cookie)
    end, again, games = time.monotonic() + seconds, time.monotonic() + AGAIN_S, 0
    player.say("pain", value=3)
    player.wait(lambda s: s["game"]["pain"] == 3)
    while time.monotonic() < end:
        player.say("ready")
        player.wait(lambda s: s["game"]["phase"] in ("playing", "paused"))
        stop = min(end, time.monotonic() + GAME_S)
        while time.monotonic() < stop and player.status["game"]["phase"] != "over":
            time.sleep(0.2)
            if time.monotonic() > again:
                guest.close()
                guest = Player(url, cookie=cookie)
                again += AGAIN_S
        player.say("stop")
        player.wait(lambda s: s["game"]["phase"] == "over")
        games += 1
    for client in (player, hangs, guest):
        client.close()
    return games


def judge(report: dict, log: Path, path: Path, games: int) -> int:  # type: ignore[type-arg]
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    memory = [line["memory_mib"] for line in lines]
    fifth = max(1, len(memory) // 5)
    before = statistics.median(memory[fifth : 2 * fifth] or memory)
    after = statistics.median(memory[-fifth:])
    with Diary(path) as diary:
        diary.check()
        kept = sum(len(session.games) for session in diary.sessions("P01"))
        clips = len(diary.clips("P01"))
    first = report["clients"][0] if report["clients"] else {}
    best = max(report["clients"], key=lambda one: one["acknowledged"])
    told = {
        "seconds": round(report["seconds"], 1),
        "frames": report["frames"],
        "frames_per_second": round(report["frames"] / report["seconds"], 2),
        "stage_ms": {name: round(value, 2) for name, value in report["stage_ms"].items()},
        "memory_mib": [before, after],
        "games": [games, kept],
        "clips": clips,
        "clients": len(report["clients"]),
        "player": best,
        "refused": report["refused"],
    }
    print(json.dumps(told, indent=1))
    wrong = []
    if after > GROWTH * before:
        wrong.append(f"memory grew from {before} to {after} MiB")
    if kept != games:
        wrong.append(f"{games} games were played, {kept} are in the diary")
    if report["refused"]:
        wrong.append(f"refused: {report['refused']}")
    if not first or best["sent"] - best["acknowledged"] > 2:
        wrong.append(f"not acknowledged: {best}")
    for one in wrong:
        print(one, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", type=float, nargs="?", default=HOUR, help="default: an hour")
    parser.add_argument("source", nargs="?", help="an address; default: the simulated amputee")
    options = parser.parse_args()
    sys.exit(main(options.seconds, options.source))
