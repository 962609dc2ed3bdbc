"""Times in the names of files, and images of two kinds that belong together by their times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

MAX_SECONDS_APART = 0.02  # tolerance of TUM's own tool, which matches depth images and others

_LEAST_EPOCH, _MOST_EPOCH = 1e9, 4e9  # seconds since 1970, from the year 2001 to 2096
_UNITS = (1e-3, 1e-6, 1e-9)


def seconds(number: float) -> float:
    """Return a time in seconds, converted if it counts a smaller unit since 1970.

    Other numbers stay. Dates that are written as numbers (20210304123400) are none of these years
    in any unit.
    """
    times = (number * unit for unit in _UNITS)
    return next((time for time in times if _LEAST_EPOCH <= time < _MOST_EPOCH), number)


def is_since_1970(number: float) -> bool:
    """Return whether a number is so large that it is a time since 1970, and no frame's number."""
    return number >= _LEAST_EPOCH


class _Chain(NamedTuple):
    """Pairs that increase in both lists: their number, sum of differences, and the last pair."""

    pairs: int = 0
    cost: int = 0
    last: int = -1


def associate(wanted: Sequence[float], times: Sequence[float]) -> list[int | None]:
    """Return the index of the partner in ``times`` of each of ``wanted``; None: it has none.

    The rule is that of ``associate`` in cpp/src/capture/folder_lists.cpp, by which
    `manip3d.capture.open_rgbd` pairs the images of a TUM folder: the most pairs up to
    `MAX_SECONDS_APART` that do not cross, and of these the least sum of differences. NaN has no
    partner. Times are rounded to microseconds, the digits of TUM's names, as a double since 1970
    holds no more.
    """
    most_pairs = 8  # of a time; bounds the work
    most_apart = round(1e6 * MAX_SECONDS_APART)
    files, others = _in_microseconds(wanted), _in_microseconds(times)
    pairs: list[tuple[int, int, int]] = []  # two indices, and the pair before in the chain
    # best[k]: the best of the chains that end at some of the others before k, as a Fenwick tree.
    best = [_Chain()] * (len(others) + 1)
    first = 0
    for time, i in files:
        while first < len(others) and others[first][0] < time - most_apart:
            first += 1
        near = range(first, min(first + most_pairs, len(others)))
        for k in reversed(near):  # later ones first: a file has one partner
            apart = abs(others[k][0] - time)
            if apart > most_apart:
                continue
            before = _best_before(best, k)
            pairs.append((i, others[k][1], before.last))
            chain = _Chain(before.pairs + 1, before.cost + apart, len(pairs) - 1)
            at = k + 1
            while at < len(best):
                best[at] = _better(best[at], chain)
                at += at & -at
    found: list[int | None] = [None] * len(wanted)
    at = _best_before(best, len(others)).last
    while at >= 0:
        i, k, at = pairs[at]
        found[i] = k
    return found


def _in_microseconds(times: Sequence[float]) -> list[tuple[int, int]]:
    """Return the finite times, ascending, each with its index."""
    return sorted((round(1e6 * time), i) for i, time in enumerate(times) if math.isfinite(time))


def _best_before(best: Sequence[_Chain], k: int) -> _Chain:
    found = _Chain()
    while k > 0:
        found = _better(found, best[k])
        k -= k & -k
    return found


def _better(known: _Chain, other: _Chain) -> _Chain:
    """Return the chain with more pairs, or else the lower cost; the known one if they are equal."""
    return other if (-other.pairs, other.cost) < (-known.pairs, known.cost) else known
