"""Times in the names of files, and the nearest of them."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence

MAX_SECONDS_APART = 0.02  # tolerance of TUM's own tool, which matches depth images and others

_LEAST_EPOCH = 1e9  # seconds since 1970; the year is 2001
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""Least number of a time since 1970 in nanoseconds, microseconds and milliseconds, and the unit."""


def seconds(number: float) -> float:
    """Return a time in seconds, which is in a smaller unit if it would lie millennia after 1970."""
    return number * next((unit for least, unit in _UNITS if number >= least), 1.0)


def is_since_1970(number: float) -> bool:
    """Return whether a number is so large that it is a time since 1970, and no frame's number."""
    return number >= _LEAST_EPOCH


def nearest_in_time(wanted: Sequence[float], times: Sequence[float]) -> list[int | None]:
    """Return the index of the nearest of ``times`` for each of ``wanted``, each at most once.

    As in TUM's own tool, pairs are made in the order of their differences, up to
    `MAX_SECONDS_APART`. None is returned where no pair is left, and for NaN.
    """
    order = sorted((time, i) for i, time in enumerate(times) if not math.isnan(time))
    ascending = [time for time, _ in order]
    pairs = []
    for i, time in enumerate(wanted):
        first = bisect.bisect_left(ascending, time - MAX_SECONDS_APART)
        last = bisect.bisect_right(ascending, time + MAX_SECONDS_APART)
        pairs += [(abs(time - near), i, k) for near, k in order[first:last]]
    found: list[int | None] = [None] * len(wanted)
    used: set[int] = set()
    for _, i, k in sorted(pairs):
        if found[i] is None and k not in used:
            found[i] = k
            used.add(k)
    return found
