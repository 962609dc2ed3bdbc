"""The log of a running session: a line of JSON every ten seconds."""

from __future__ import annotations

import errno
import json
import logging
import os
import time
from collections.abc import Mapping
from datetime import datetime
from io import FileIO
from types import TracebackType
from typing import Self

from manip3d._util.memory import resident_bytes
from manip3d._util.paths import path_of
from manip3d._util.regular_files import open_regular
from manip3d.errors import InputError
from manip3d.phantom._session import LiveSession
from manip3d.serve import LocalServer

LOG = logging.getLogger("manip3d")
_EVERY_S = 10.0  # time between two lines
_BEGIN = b'{"at": "'
"""First bytes of each line."""


class SessionLog:
    """Log file that gets a line every ten seconds; without a path nothing is written.

    Attributes
    ----------
    lost_lines : int
        Number of lines that could not be written, for example because the disk was full.

    Raises
    ------
    InputError
        The file has other content, for example a diary or a key.
    OSError
        The file cannot be opened.
    """

    def __init__(self, path: str | os.PathLike[str] | None) -> None:
        self._path = None if path is None else path_of(path, "log")
        if self._path is not None and self._path.is_file():
            with open_regular(self._path) as file:
                first = file.read(len(_BEGIN))
            if first not in (b"", _BEGIN):  # lines would be appended to other content
                raise InputError(
                    f"log: expected a new file or the log of a session, got {self._path}"
                )
        self._file: FileIO | None = None
        self.lost_lines = 0
        self._due = 0.0

    def __enter__(self) -> Self:
        if self._path is not None:
            self._file = FileIO(self._path, "a")
            self._due = time.monotonic() + _EVERY_S
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()

    def tell(
        self, session: LiveSession, server: LocalServer, frames: int, states: Mapping[str, int]
    ) -> None:
        """Write a line if it is due."""
        if self._file is None or time.monotonic() < self._due:
            return
        self._due += _EVERY_S
        record = {
            "at": datetime.now().astimezone().isoformat(timespec="milliseconds"),
            "frames": frames,
            "states": dict(states),
            "stage_ms": {name: round(value, 3) for name, value in session.stage_ms.items()},
            "clients": server.num_clients,
            "latest_client": next(reversed(server.report()), None),
            "refused": dict(server.refused),
            "games": len(session.summaries),
            "memory_mib": memory_mib(),
            "lost_lines": self.lost_lines,
        }
        try:
            self._write(json.dumps(record).encode() + b"\n")
        except OSError as error:  # a full disk must not end a patient's session
            self.lost_lines += 1
            LOG.warning("%s: a line of the log is lost: %s", self._path, error.strerror)

    def _write(self, line: bytes) -> None:
        """Append a whole line, or nothing."""
        assert self._file is not None
        written = self._file.write(line)
        if written != len(line):
            self._file.truncate(self._file.seek(0, os.SEEK_END) - (written or 0))
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), os.fspath(self._path or ""))


def memory_mib() -> float | None:
    """Return the resident memory of this process; None if the system does not state it."""
    size = resident_bytes()
    return None if size is None else round(size / 2**20, 1)
