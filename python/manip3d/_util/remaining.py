"""Estimate of the time that a run still needs."""

from __future__ import annotations

import time
from collections.abc import Callable


class RemainingTime:
    """Estimate in words of the time that a run still needs, if it continues at its mean speed.

    Parameters
    ----------
    begun_at : float
        Fraction that was already done at the start, by an earlier run that was stopped.
    clock : callable
        Function that returns the time in seconds.
    """

    def __init__(self, begun_at: float = 0.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._begun_at, self._clock = begun_at, clock
        self._begun_s = clock()

    def __call__(self, fraction: float) -> str:
        """Return a text such as ``about 12 minutes left``; '' before any progress or at the end."""
        done = fraction - self._begun_at
        if not (done > 0.0 and fraction < 1.0):
            return ""
        seconds = (self._clock() - self._begun_s) * (1.0 - fraction) / done
        for unit, length in (("hour", 3600.0), ("minute", 60.0)):
            if seconds >= 1.5 * length:
                return f"about {round(seconds / length)} {unit}s left"
        return "about a minute left" if seconds >= 30.0 else "less than a minute left"
