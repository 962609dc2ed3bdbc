"""Forks a process for each command line that arrives, with the modules imported already.

Started by ``command_line.py``, with the number of a socket. A request holds number, words, folder
and environment, with the descriptors of stdin, stdout and stderr; the answer is its number and the
exit code.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import pkgutil
import runpy
import socket
import sys
from typing import Any

MAX_BYTES = 1 << 20


def import_all() -> None:
    """Import every verb, and every room, which most verbs load when they run."""
    for package in ("manip3d", "manip3d.cli"):
        for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
            if module.name != "__main__":
                importlib.import_module(f"{package}.{module.name}")


def next_request(connection: socket.socket) -> dict[str, Any]:
    """Serve requests; return in the child that is to run one, with its descriptors in place."""
    while True:
        message, descriptors, _, _ = socket.recv_fds(connection, MAX_BYTES, 3)
        if not message:
            sys.exit(0)
        request: dict[str, Any] = json.loads(message)
        child = os.fork()
        if child == 0:
            connection.close()
            for number, descriptor in enumerate(descriptors):
                os.dup2(descriptor, number)
                os.close(descriptor)
            return request
        for descriptor in descriptors:
            os.close(descriptor)
        _, status = os.waitpid(child, 0)
        answer = [request["number"], os.waitstatus_to_exitcode(status)]
        connection.send(json.dumps(answer).encode())


def main() -> None:
    """Run one command line as ``python -m manip3d`` does, in each child."""
    import_all()
    gc.freeze()
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        connection.send(b"ready")
        request = next_request(connection)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.path.pop(0)  # the folder of this file; -m has the current one there
    sys.path.insert(0, request["folder"])
    sys.argv = ["manip3d", *request["words"]]
    runpy.run_module("manip3d", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
