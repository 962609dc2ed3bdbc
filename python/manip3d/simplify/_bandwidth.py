"""A limit on bytes per second, and the number of points of a frame that fits into its share."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from manip3d.errors import InputError

Item = TypeVar("Item")

SECOND_NS = 1_000_000_000
LEAST_POINTS = 3
_AIM = 0.97  # of the bytes of a frame: sizes are not known beforehand
_MOST_TRIES = 8


@dataclass(frozen=True)
class Bandwidth:
    """Bytes a second, and frames a second that share them alike.

    Raises
    ------
    InputError
        A number is not positive and finite, or there is less than a byte for a frame.
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
        """Bytes of one frame: a second begins at most so many frames."""
        return int(self.bytes_per_second // math.ceil(self.rate))


class SlidingSecond:
    """Bytes sent in the second before a frame; frames may come late, or too many of them."""

    def __init__(self, bandwidth: Bandwidth) -> None:
        self._bandwidth = bandwidth
        self._sent: deque[tuple[int, int]] = deque()

    def allowance(self, time_ns: int) -> int:
        """Bytes that a frame at this time may have, so that no second has more than its bytes."""
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
        """Count the bytes of a frame."""
        self._sent.append((time_ns, size))


def fit_bytes(
    make: Callable[[int], tuple[Item, int, int]],
    *,
    most_points: int,
    allowance: int,
    guess: float,
    bytes_per_point: float,
    least_share: float,
) -> Item | None:
    """Make an item of as many points as fit into an allowance of bytes.

    Parameters
    ----------
    make : callable
        Takes a number of points; returns the item, its number of points and its bytes.
    most_points : int
    allowance : int
        Bytes.
    guess : float
        Number of points of the first try.
    bytes_per_point : float
        Bytes that a further point is assumed to add, until two tries show it.
    least_share : float
        If an item has fewer bytes than this share of the allowance, more points are tried, unless
        the last try had no more points than the one before.

    Returns
    -------
    Item or None
        None: not even three points fit.
    """
    fits: tuple[Item, int, int] | None = None
    too_large: tuple[int, int] | None = None
    most = 0  # points of what fits
    points = _clamp(guess, LEAST_POINTS, most_points)
    slope = bytes_per_point
    before: tuple[int, int] | None = None
    for number in range(_MOST_TRIES):
        item, count, size = make(points)
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
            if is_all or size >= least_share * allowance or number == _MOST_TRIES - 1:
                return best
        else:
            too_large = points, size
            if points == LEAST_POINTS:
                return None
        low = LEAST_POINTS if fits is None else fits[1] + 1
        high = most_points if too_large is None else too_large[0] - 1
        if low > high:
            break
        points = _clamp(points + (_AIM * allowance - size) / max(slope, 1e-3), low, high)
    if fits is not None:
        return fits[0]
    item, _, size = make(LEAST_POINTS)
    return item if size <= allowance else None


def _clamp(points: float, low: int, high: int) -> int:
    return int(min(max(points, low), max(low, high)))
