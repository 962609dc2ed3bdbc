"""Memory and processor time that reading a file costs a process that has read nothing before.

A process that has imported the package forks one for each file, since starting Python and importing
takes longer than most of the files.
"""

from __future__ import annotations

import atexit
import functools
import os
import resource
import subprocess
import sys
import time
from pathlib import Path


def cost_of_reading(kind: str, path: Path) -> tuple[int, float]:
    """Give the bytes of memory that reading takes at most, and the seconds of processor time.

    The kind is ``"mesh"``, ``"scan"`` or ``"packets"``. The file may be refused with a
    ``FormatError``.
    """
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    print(kind, path, file=server.stdin, flush=True)
    size, seconds = server.stdout.readline().split()
    return int(size), float(seconds)


@functools.cache
def _server() -> subprocess.Popen[str]:
    command = [sys.executable, __file__]
    server = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=0
    )
    atexit.register(server.communicate)
    return server


def _read(kind: str, path: str) -> None:
    import manip3d

    try:
        if kind == "mesh":
            manip3d.read_mesh(path)
        elif kind == "scan":
            manip3d.io.read_scan(path)
        else:
            for _ in manip3d.capture.open("pcap:" + path):
                pass
    except manip3d.FormatError:
        pass


def _peak() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Answer each line with what reading it costs, or with how the process ended."""
    import manip3d.capture
    import manip3d.io
    import manip3d.lidar  # noqa: F401

    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            before, begin = _peak(), time.process_time()
            _read(*line.rstrip("\n").split(" ", 1))
            print(_peak() - before, time.process_time() - begin, flush=True)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if status != 0:
            print(f"the process ended with {os.waitstatus_to_exitcode(status)}", flush=True)


if __name__ == "__main__":
    main()
