"""Time to import manip3d and to print its help, compared with the import of peers.

``python benchmarks/bench_startup.py [--rounds N]`` writes the section `startup` of the results.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys

import tables

COMMANDS = {
    "Python alone": ["-c", "pass"],
    "import numpy": ["-c", "import numpy"],
    "import manip3d": ["-c", "import manip3d"],
    "manip3d --help": ["-m", "manip3d", "--help"],
    "import trimesh": ["-c", "import trimesh"],
    "import pymeshlab": ["-c", "import pymeshlab"],
    "import meshlib.mrmeshpy": ["-c", "import meshlib.mrmeshpy"],
    "import open3d": ["-c", "import open3d"],
}


def cpu_seconds(arguments: list[str]) -> float | None:
    """Return the processor time of one start; None: it failed, because it is not installed."""
    with subprocess.Popen(
        [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime if process.returncode == 0 else None


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    seconds: dict[str, list[float | None]] = {name: [] for name in COMMANDS}
    for _ in range(rounds):
        for name, arguments in COMMANDS.items():
            seconds[name].append(cpu_seconds(arguments))
    body = []
    for name, taken in seconds.items():
        times = [1e3 * t for t in taken if t is not None]
        cells = [f"{statistics.median(times):.0f}", f"{min(times):.0f}"] if times else ["–", "–"]
        body.append([name, *cells])
    tables.write_section("startup", tables.table(["start", "ms, median", "ms, least"], body))


if __name__ == "__main__":
    main()
