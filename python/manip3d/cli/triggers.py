"""Triggers that start a recording: a signal, a key or a person."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d.rgbd import RgbdFrame

_SIGNALS = ("SIGUSR1", "SIGUSR2")


@contextlib.contextmanager
def trigger_of(word: str) -> Iterator[tuple[Callable[[RgbdFrame], bool], str]]:
    """Yield the trigger of ``--trigger`` for `capture.record`, and a phrase how to activate it.

    Raises
    ------
    InputError
        The trigger does not exist, or not on this operating system.
    """
    if word == "person":
        yield (lambda frame: bool(frame.skeletons)), "a person with a skeleton"
    elif word == "key":
        yield _key(), "Enter"
    elif word in _SIGNALS and hasattr(signal, word):
        with _signal(signal.Signals[word]) as has_come:
            yield (lambda _: has_come()), f"{word}: kill -s {word[3:]} {os.getpid()}"
    else:
        known = ", ".join(("key", "person", *_SIGNALS))
        raise InputError(f"--trigger: expected one of {known}, got {word!r}")


@contextlib.contextmanager
def _signal(number: signal.Signals) -> Iterator[Callable[[], bool]]:
    came: list[int] = []
    before = signal.signal(number, lambda got, _: came.append(got))
    try:
        yield lambda: bool(came)
    finally:
        signal.signal(number, before)


def _key() -> Callable[[RgbdFrame], bool]:
    """Return a trigger that polls the standard input for a line, without blocking or a thread."""
    try:
        typed = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        raise InputError("--trigger key: expected a terminal, got no standard input") from None
    with contextlib.suppress(ImportError, OSError):  # discards what was typed before
        import termios

        if os.isatty(typed):
            termios.tcflush(typed, termios.TCIFLUSH)

    def has_come(frame: RgbdFrame) -> bool:
        if not select.select([typed], [], [], 0)[0]:
            return False
        if not os.read(typed, 1024):
            raise InputError("--trigger key: expected Enter, but standard input has ended")
        return True

    return has_come
