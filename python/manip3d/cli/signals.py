"""Signals that end a program which somebody else wants to end."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_NAMES = ("SIGTERM", "SIGHUP")  # a shutdown; a terminal that was closed. Windows has no SIGHUP.


@contextlib.contextmanager
def ended_like_ctrl_c() -> Iterator[None]:
    """Have what ends a program end it as Ctrl-C does, with all that is to be written.

    A second one interrupts nothing: the end is under way, and who waits in it may hear the signal,
    as `manip3d phantom live` does. What is ignored, as by ``nohup``, stays so.
    """
    if threading.current_thread() is not threading.main_thread():  # it alone may do this
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
