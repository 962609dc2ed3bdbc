"""Readers of bags that are forked from one process, as most of their time goes into their start.

``python bag_readers.py SOCKET`` is that process: it has imported what ``_bag_process.py`` needs. A
request holds that script's arguments and the descriptors of its streams; the answer is the number
of the process that serves it.
"""

from __future__ import annotations

import atexit
import functools
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, Any

MAX_BYTES = 1 << 16


class ForkedReader:
    """A reader of a bag, with what `manip3d.capture` uses of `subprocess.Popen`."""

    def __init__(self, command: list[str], *, stdin: int, **_: Any) -> None:
        in_read, in_write = os.pipe()
        out_read, out_write = os.pipe()
        at = next(n for n, word in enumerate(command) if word.endswith("_bag_process.py"))
        request = json.dumps(command[at + 1 :]).encode()
        connection = _connection(str(Path(command[at]).parent))
        socket.send_fds(connection, [request], [in_read, out_write])
        os.close(in_read)
        os.close(out_write)
        self.pid = json.loads(connection.recv(MAX_BYTES))
        self.stdout: IO[bytes] = os.fdopen(out_read, "rb")
        self.stdin: IO[bytes] | None = os.fdopen(in_write, "wb", buffering=0)
        if stdin == subprocess.DEVNULL:
            self.stdin.close()
            self.stdin = None

    def kill(self) -> None:
        if self._is_alive():
            os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> None:
        while self._is_alive():
            time.sleep(0.001)

    def _is_alive(self) -> bool:
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        return True


@functools.cache
def _connection(folder: str) -> socket.socket:
    """To the process that forks, of the script in a folder; it ends with its connection."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        command = [sys.executable, __file__, str(theirs.fileno()), folder]
        process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], process_group=0, stdin=subprocess.DEVNULL
        )
    assert ours.recv(MAX_BYTES) == b"ready"

    def end() -> None:
        ours.close()
        process.wait()

    atexit.register(end)
    return ours


def main() -> None:
    """Fork a process for each request."""
    typesys = importlib.import_module("rosbags.typesys")
    for reader in ("rosbags.rosbag1", "rosbags.rosbag2"):
        importlib.import_module(reader)
    typesys.get_typestore = functools.cache(typesys.get_typestore)
    for store in (typesys.Stores.ROS1_NOETIC, typesys.Stores.ROS2_HUMBLE):
        typesys.get_typestore(store)
    sys.path.insert(0, sys.argv[2])
    script = importlib.import_module("_bag_process")

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        connection.send(b"ready")
        while True:
            message, descriptors, _, _ = socket.recv_fds(connection, MAX_BYTES, 2)
            if not message:
                return
            child = os.fork()
            if child == 0:
                break
            for descriptor in descriptors:
                os.close(descriptor)
            connection.send(json.dumps(child).encode())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.setsid()
    for number, descriptor in enumerate(descriptors):
        os.dup2(descriptor, number)
        os.close(descriptor)
    path, topic, limit, mode = json.loads(message)
    script.main(Path(path), topic, int(limit), sys.stdout.buffer, mode)


if __name__ == "__main__":
    main()
