"""Signals that interrupt a step only when it is done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP.


@contextmanager
def signals_held() -> Iterator[None]:
    """Pass a signal to its handler, which may raise KeyboardInterrupt, at the end of the block.

    A second signal is passed on at once. Signals without a Python handler are not held, nor those
    of a block in another thread than the main one, which receives none.

    Examples
    --------
    >>> import os, signal
    >>> from manip3d._util.held_signals import signals_held
    >>> done = []
    >>> try:
    ...     with signals_held():
    ...         os.kill(os.getpid(), signal.SIGINT)
    ...         done.append("first half")
    ...         done.append("second half")
    ... except KeyboardInterrupt:
    ...     print(done)
    ['first half', 'second half']
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Callable[[int, FrameType | None], object]] = {}
    held: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        if not held:
            held.append(number)
            return
        held.clear()
        before[number](number, frame)

    for number in (getattr(signal, name) for name in _NAMES if hasattr(signal, name)):
        handler = signal.getsignal(number)
        if callable(handler):
            before[number] = handler
            signal.signal(number, hold)
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is hold:  # no other handler was installed since
                signal.signal(number, handler)
        if held:
            before[held[0]](held[0], None)
