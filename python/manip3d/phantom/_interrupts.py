"""Handling of signals that end a live session, so that a second Ctrl-C loses no diary entries."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP.
_Handler = Callable[[int, FrameType | None], object]


class Interrupts:
    """Context in which only the first signal interrupts.

    The first signal is passed to the earlier handler, which usually raises KeyboardInterrupt. Later
    signals interrupt nothing and are only noted, so that the end of the session waits no longer
    than necessary (`is_hurried`). A first signal whose handler raises nothing does not count.

    Signals are not handled outside of the main thread, which receives none, or if no Python handler
    is installed: they are ignored (nohup) or end the process (`SIG_DFL`).
    """

    def __init__(self) -> None:
        self._is_ending = self._is_hurried = False
        self._before: dict[int, _Handler] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
            for number in numbers:
                before = signal.getsignal(number)
                if callable(before):
                    self._before[number] = before
                    signal.signal(number, self._hear)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, before in self._before.items():
            if signal.getsignal(number) == self._hear:  # no other handler was installed since
                signal.signal(number, before)

    def note_end(self) -> None:
        """Note that the session ends: from now on no signal interrupts."""
        self._is_ending = True

    def is_hurried(self) -> bool:
        """Return whether a signal arrived while the session was ending."""
        return self._is_hurried

    def _hear(self, number: int, frame: FrameType | None) -> None:
        if self._is_ending:
            self._is_hurried = (
                True  # a plain attribute: the interrupted thread may hold the lock of an Event
            )
            return
        try:
            self._before[number](number, frame)
        except BaseException:
            self._is_ending = True
            raise
