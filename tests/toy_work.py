"""Work on single files that tests hand to batches, in a module that workers can import."""

from __future__ import annotations

import logging
import os
import signal
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from manip3d.errors import FormatError


def upper(
    source: Path, output: Path | None, *, log: str = "", seconds: float = 0.0, die: str = ""
) -> dict[str, Any]:
    """Write a text in capitals; leave a line in a log when it begins and when it ends or fails."""
    _note(log, f"begin {source.name} {os.getpid()}")
    if source.name == die:
        os.kill(os.getpid(), signal.SIGKILL)
    try:
        text = source.read_text()
        if "bad" in text:
            raise ValueError(f"{source}: bad text")
        time.sleep(seconds)
        if output is not None:
            output.write_text(text.upper())
    finally:
        _note(log, f"end {source.name} {os.getpid()}")
    return {"length": np.int64(len(text)), "nested": {"pair": (1, 2)}, "read": str(source)}


def _note(log: str, line: str) -> None:
    if log:
        with Path(log).open("a") as stream:
            stream.write(line + "\n")


def running(log: Path) -> list[int]:
    """Return the processes that have begun and not ended a file, by the log."""
    lines = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
    ended = {tuple(rest) for word, *rest in lines if word == "end"}
    return [int(rest[1]) for word, *rest in lines if word == "begin" and tuple(rest) not in ended]


def clashing(source: Path, output: Path | None) -> dict[str, Any]:
    """Return values under the names of a batch's own columns; a bad text is a `FormatError`."""
    if "bad" in source.read_text():
        raise FormatError("expected a good text", file=str(source), line=3)
    return {"source": "mine", "error": "mine", "task_seconds": -1.0, "seconds": 60.0}


def talkative(source: Path, output: Path | None) -> dict[str, Any]:
    """Write to the log and give a warning."""
    logging.getLogger("manip3d").warning("%s is in the log", source.name)
    warnings.warn(f"a warning of {source.name}", stacklevel=1)
    return {}
