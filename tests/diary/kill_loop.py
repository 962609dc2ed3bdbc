"""A program that is killed again and again while it writes into a diary.

Usage: ``python kill_loop.py FOLDER KILLS SEED [KEY]``. Each round a child writes games and prints
the seed of each one when `add_game` has returned; it is killed at a random moment. Then the file
must be whole and hold all that was printed. Prints the numbers of kills and games.
"""

from __future__ import annotations

import json
import os
import random
import select
import signal
import sys
import time
from datetime import datetime
from pathlib import Path

from manip3d.diary import Diary, DiaryGame

PICTURE = b"\xff\xd8" + bytes(20_000)


def write_for_ever(path: Path, key: Path | None, first: int, out: int) -> None:
    with Diary(path, key=key, create=True) as diary:
        if not diary.participants():
            diary.enrol("P01", clips=True)
        session = diary.start_session("P01")
        for number in range(first, first + 10_000):
            game = DiaryGame(
                datetime.now().astimezone(), "piano", 1, number, "time", 60.0, 0.0, 9, 1, 4,
                ((1.0, 12.0),),
            )  # fmt: skip
            diary.add_game(session, game, [[(0.5, PICTURE + b"%d" % number)]])
            os.write(out, b"%d\n" % number)


def killed_child(
    path: Path, key: Path | None, first: int, seconds: float | None = None
) -> list[int]:
    """Kill a child that writes games; return the games that it acknowledged.

    It is killed after so many seconds, or as soon as it acknowledges its first game.
    """
    told, out = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(told)
        try:
            write_for_ever(path, key, first, out)
        finally:
            os._exit(1)
    os.close(out)
    if seconds is None:
        select.select([told], [], [])
    else:
        time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise SystemExit("the child ended by itself")
    with os.fdopen(told) as lines:
        return [int(line) for line in lines if line.endswith("\n")]


def main(folder: Path, kills: int, seed: int, key: Path | None) -> None:
    chance = random.Random(seed)
    acknowledged: set[int] = set()
    idle = 0
    started = time.monotonic()
    killed_child(folder / "first.diary", key, 0)
    longest = 4 * (time.monotonic() - started)  # most kills come after the first game
    for number in range(kills):
        # A new file now and then, so that kills fall into its making too.
        path = folder / f"{number // 10}.diary"
        acknowledged = set() if number % 10 == 0 else acknowledged
        found = killed_child(path, key, 10_000 * number, chance.uniform(0.0, longest))
        idle += not found
        acknowledged |= set(found)
        with Diary(path, key=key, create=True) as diary:
            diary.check()
            kept = {
                game.seed
                for person in diary.participants()
                for session in diary.sessions(person.identifier)
                for game in session.games
            }
            filmed = {
                int(clip.pictures[0][1].removeprefix(PICTURE))
                for person in diary.participants()
                for clip in diary.clips(person.identifier)
            }
            whole = filmed == kept and all(
                game.anomalies == ((1.0, 12.0),)
                for person in diary.participants()
                for session in diary.sessions(person.identifier)
                for game in session.games
            )
        if not acknowledged <= kept:
            raise SystemExit(f"kill {number}: lost {sorted(acknowledged - kept)}")
        if len(kept - acknowledged) > number + 1:
            raise SystemExit(f"kill {number}: made up {sorted(kept - acknowledged)}")
        if not whole:
            raise SystemExit(f"kill {number}: a game without its anomaly or clip")
        acknowledged = kept  # what was written but not told in time is no loss later either
    print(json.dumps({"kills": kills, "without_a_game": idle}))


if __name__ == "__main__":
    words = sys.argv[1:]
    main(Path(words[0]), int(words[1]), int(words[2]), Path(words[3]) if words[3:] else None)
