"""Bandwidth limits: the number of bytes of each frame, and the number of points that fit."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from manip3d._util.times import SECOND_NS
from manip3d.errors import InputError

Item = TypeVar("Item")

MIN_POINTS = 3  # those of one face
_AIM = 0.97  # share of the allowed bytes to aim at, because a size is only predicted
_MAX_TRIES = 8  # each one is a whole simplification


@dataclass(frozen=True)
class Bandwidth:
    """Limit in bytes per second, shared equally by the frames of a second.

    Raises
    ------
    InputError
        A number is not positive and finite, or the limit is less than one byte per frame.
    """

    bytes_per_second: float
    rate: float

    def __post_init__(self) -> None:
        for name, value in (("bandwidth", self.bytes_per_second), ("rate", self.rate)):
            is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not is_number or not 0 < value < math.inf:
                raise InputError(f"{name}: expected > 0 and finite, got {value!r}")
        if self.share < 1:
            raise InputError(
                f"bandwidth: expected at least {math.ceil(self.rate)} bytes a second for "
                f"{self.rate:g} frames, got {self.bytes_per_second:g}"
            )

    @property
    def share(self) -> int:
        """Bytes of one frame; at most ``ceil(rate)`` frames begin within a second."""
        return int(self.bytes_per_second // math.ceil(self.rate))


class SlidingSecond:
    """Bytes sent in the last second; holds the limit if frames are late or too frequent."""

    def __init__(self, bandwidth: Bandwidth) -> None:
        self._bandwidth = bandwidth
        self._sent: deque[tuple[int, int]] = deque()

    def allowance(self, time_ns: int) -> int:
        """Return the bytes that a frame may have so that no second exceeds the limit."""
        if self._sent and time_ns < self._sent[-1][0]:
            raise InputError(
                f"time_ns: expected {self._sent[-1][0]} or later, as frames come in order, "
                f"got {time_ns}"
            )
        while self._sent and self._sent[0][0] <= time_ns - SECOND_NS:
            self._sent.popleft()
        left = self._bandwidth.bytes_per_second - sum(size for _, size in self._sent)
        return max(0, min(self._bandwidth.share, math.floor(left)))

    def spend(self, time_ns: int, size: int) -> None:
        """Record the bytes of a frame that was sent."""
        self._sent.append((time_ns, size))


def fit_bytes(
    make: Callable[[int], tuple[Item, int, int] | None],
    *,
    most_points: int,
    allowance: int,
    guess: float,
    bytes_per_point: float,
    least_share: float,
) -> Item | None:
    """Make an item with as many points as fit into ``allowance`` bytes, by a secant search.

    Parameters
    ----------
    make : callable
        Takes a number of points; returns the item, its number of points and its size in bytes, or
        None if so few points make none.
    most_points : int
        Largest number of points to ask for.
    allowance : int
        Largest size in bytes.
    guess : float
        Number of points of the first try.
    bytes_per_point : float
        Assumed size of a point, used until two tries have measured it.
    least_share : float
        An item smaller than this share of the allowance is tried again with more points, unless
        the last increase gave an item with no more points than before: no more points exist.

    Returns
    -------
    Item or None
        None: not even three points fit, or they make no item and none of the tries fits.
    """
    fits: tuple[Item, int, int] | None = None
    too_large: tuple[int, int] | None = None
    empty = MIN_POINTS - 1  # largest number of points that made no item
    most = 0  # points of the best item that fits
    points = _clamp(guess, MIN_POINTS, most_points)
    slope = bytes_per_point
    before: tuple[int, int] | None = None
    for number in range(_MAX_TRIES):
        made = make(points)
        if made is None:
            empty = points
            above = 3 * points if too_large is None else too_large[0]
            wanted = (points + above) / 2
        else:
            item, count, size = made
            if (
                before is not None
                and points != before[0]
                and (size > before[1]) == (points > before[0])
            ):
                slope = (size - before[1]) / (points - before[0])
            before = points, size
            if size <= allowance:
                is_all = points == most_points or (count < points and 0 < count <= most)
                best = item if fits is None or count > most else fits[0]
                fits, most = (best, points, size), max(count, most)
                if is_all or size >= least_share * allowance or number == _MAX_TRIES - 1:
                    return best
            else:
                too_large = points, size
                if points == MIN_POINTS:
                    return None
            wanted = points + (_AIM * allowance - size) / max(slope, 1e-3)
            if wanted < MIN_POINTS:  # points are larger than the slope says
                wanted = points * _AIM * allowance / size
        low = max(empty, 0 if fits is None else fits[1]) + 1
        high = most_points if too_large is None else too_large[0] - 1
        if low > high:
            break
        points = _clamp(wanted, low, high)
    if fits is not None:
        return fits[0]
    made = make(MIN_POINTS) if empty < MIN_POINTS else None
    return made[0] if made is not None and made[2] <= allowance else None


def _clamp(points: float, low: int, high: int) -> int:
    return int(min(max(points, low), max(low, high)))
