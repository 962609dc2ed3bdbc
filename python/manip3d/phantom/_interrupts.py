"""Signals that end a live session, so that nobody who is impatient loses what was to be kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP.
_Handler = Callable[[int, FrameType | None], object]


class Interrupts:
    """The first signal does what it did before, as to raise KeyboardInterrupt; later ones interrupt
    nothing and are only noted, so that the end of the session waits no longer than it must. A first
    one that interrupts nothing, as where the earlier handler only notes it, does not count.

    Signals are left alone outside the main thread, where none arrives, and where no handler of
    Python's is installed: where they are ignored, as under nohup, or end the process (`SIG_DFL`).
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
            if signal.getsignal(number) == self._hear:  # else somebody ignores it by now
                signal.signal(number, before)

    def note_end(self) -> None:
        """The session ends, for whatever reason: from now on no signal interrupts."""
        self._is_ending = True

    def is_hurried(self) -> bool:
        """Whether a signal came while the session ended."""
        return self._is_hurried

    def _hear(self, number: int, frame: FrameType | None) -> None:
        if self._is_ending:
            self._is_hurried = True  # no lock, as in an Event: the thread interrupted may hold it
            return
        try:
            self._before[number](number, frame)
        except BaseException:
            self._is_ending = True
            raise
