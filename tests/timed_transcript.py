"""Run a command on a terminal of its own and print what it prints with the seconds before it.

Usage: ``python timed_transcript.py COMMAND...``. Ends with the time it took, the processor time of
it and of all that it started, and the longest time without a byte of output. The command's status
is passed on.
"""

from __future__ import annotations

import os
import pty
import re
import resource
import sys
import time

ESCAPES = re.compile(rb"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07]*\x07|[()][0-9A-B]|[=>78M])")
EVERY = 5.0  # seconds between two states of a line that is drawn over, as of a progress bar


class Transcript:
    """Prints lines as they end and remembers the longest silence."""

    def __init__(self) -> None:
        self.start = self.heard = self.drawn = time.monotonic()
        self.line = b""
        self.silence = (0.0, 0.0)

    def add(self, output: bytes) -> None:
        now = time.monotonic()
        self.silence = max(self.silence, (now - self.heard, self.heard - self.start))
        self.heard = now
        *ended, self.line = re.split(rb"(?<=\n)|(?<=\r)(?=[^\n])", self.line + output)
        for line in ended:
            drawn_over = line.endswith(b"\r")
            if not drawn_over or now - self.drawn >= EVERY:
                self.drawn = now
                self.show(line)

    def show(self, line: bytes) -> None:
        text = ESCAPES.sub(b"", line).decode(errors="replace").strip("\r\n")
        if text.strip():
            print(f"{self.heard - self.start:7.1f}  {text}", flush=True)


def main() -> int:
    child, terminal = pty.fork()
    if child == 0:
        os.execvp(sys.argv[1], sys.argv[1:])
    transcript = Transcript()
    while True:
        try:
            output = os.read(terminal, 65536)
        except OSError:  # Linux's end of a terminal
            break
        if not output:
            break
        transcript.add(output)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    transcript.add(b"\n")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds, since = transcript.silence
    print(
        f"status {status} after {transcript.heard - transcript.start:.0f} s, "
        f"processor time {used.ru_utime + used.ru_stime:.0f} s, "
        f"longest silence {seconds:.1f} s (from {since:.0f} s on)"
    )
    return status


if __name__ == "__main__":
    sys.exit(main())
