"""Runs of the command line: in this process, or in processes of their own."""

from __future__ import annotations

import atexit
import functools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from typer.testing import CliRunner, Result

from manip3d.cli import app

READ_AT_START = re.compile(
    r"PYTHON|LC_|LANG|LD_|OMP_|OPENBLAS_|MALLOC_|GLIBC_|TERMINAL_WIDTH|FORCE_COLOR|NO_COLOR|PY_COLORS"
)
"""Variables that Python and libraries read when they are loaded."""
LONGEST_S = 300.0
"""Limit of the time of a command."""


def run(*arguments: object, entered: str = "") -> Result:
    """Run the command in this process; ``entered`` is what a user types."""
    return CliRunner().invoke(app, [str(each) for each in arguments], input=entered)


def manip3d(
    *arguments: str | Path, stdin: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own.

    It is forked from a process that has imported all modules, because most commands take longer
    to import them than to work.
    """
    words = list(map(str, arguments))
    whole = dict(os.environ) | environment
    code, out, err = _server(whole).run(words, whole, stdin)
    command = [sys.executable, "-m", "manip3d", *words]
    return subprocess.CompletedProcess(command, code, out.decode(), err.decode())


class _Server:
    """The process of ``command_server.py``."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.number = 0  # of the last request, which its answer names
        self.lock = threading.Lock()
        self.connection, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        program = Path(__file__).with_name("command_server.py")
        with other:
            self.process = subprocess.Popen(
                [sys.executable, str(program), str(other.fileno())],
                env=environment,
                pass_fds=[other.fileno()],
                stdin=subprocess.PIPE,  # Python remembers that its streams are pipes
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                process_group=0,  # of its own, with the commands that it runs
            )
        self.connection.settimeout(LONGEST_S)
        if self.connection.recv(100) != b"ready":
            self.kill()
            raise AssertionError("Python does not start with this environment")

    def close(self) -> None:
        self.connection.close()
        if self.process.returncode is None:
            self.process.communicate()

    def run(
        self, words: list[str], environment: dict[str, str], stdin: bytes
    ) -> tuple[int, bytes, bytes]:
        """Give the exit code, stdout and stderr."""
        self.number += 1
        request = {
            "number": self.number,
            "words": words,
            "folder": os.getcwd(),
            "environment": environment,
        }
        in_read, in_write = os.pipe()
        out_read, out_write = os.pipe()
        err_read, err_write = os.pipe()
        theirs = [in_read, out_write, err_write]
        with self.lock, ThreadPoolExecutor(3) as pool:
            try:
                socket.send_fds(self.connection, [json.dumps(request).encode()], theirs)
            finally:
                for descriptor in theirs:
                    os.close(descriptor)
            pool.submit(_write, in_write, stdin)
            out, err = pool.submit(_read, out_read), pool.submit(_read, err_read)
            try:
                number, code = json.loads(self.connection.recv(100))
                assert number == self.number
            except BaseException:  # the command still runs: nobody may be given its answer
                self.kill()
                _server_for.cache_clear()
                raise
            return code, out.result(), err.result()

    def kill(self) -> None:
        """End the process and the command that it runs, whose pipes the threads here read."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.close()


@functools.cache
def _server_for(environment: frozenset[tuple[str, str]]) -> _Server:
    rest = {name: value for name, value in os.environ.items() if not READ_AT_START.match(name)}
    server = _Server(rest | dict(environment))
    atexit.register(server.close)
    return server


def _server(environment: dict[str, str]) -> _Server:
    """Give the server that was started with what Python reads at its start."""
    read = {name: value for name, value in environment.items() if READ_AT_START.match(name)}
    return _server_for(frozenset(read.items()))


def _read(descriptor: int) -> bytes:
    with open(descriptor, "rb") as file:
        return file.read()


def _write(descriptor: int, content: bytes) -> None:
    try:
        with open(descriptor, "wb", buffering=0) as file:
            file.write(content)
    except BrokenPipeError:  # the command does not read it all
        pass


def error_line(done: subprocess.CompletedProcess[str]) -> str:
    """Return the single line that a failed command leaves on stderr."""
    assert done.returncode == 1, done
    words = [str(word) for word in done.args]
    if "--json" in words:
        assert json.loads(done.stdout)["error"]["code"]
    else:
        assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("manip3d: error: ")
    return line
