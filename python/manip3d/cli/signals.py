"""Handling of signals by which another process ends this one."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_NAMES = ("SIGTERM", "SIGHUP")  # SIGHUP: the terminal was closed; it does not exist on Windows


@contextlib.contextmanager
def ended_like_ctrl_c() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt as Ctrl-C does, so that output is completed.

    A second signal raises nothing, because the end is under way; code that waits there may still
    handle signals, as `manip3d phantom live` does. Signals that are ignored, as by ``nohup``, stay
    ignored.
    """
    if threading.current_thread() is not threading.main_thread():  # others may not set handlers
        yield
        return
    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    heard = {number for number in numbers if before[number] == signal.SIG_DFL}

    is_ending = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal is_ending
        if not is_ending:
            is_ending = True
            raise KeyboardInterrupt

    for number in heard:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, before[number])
