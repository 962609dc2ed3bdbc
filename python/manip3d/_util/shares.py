"""Confidence limits of shares and rates that were counted."""

from __future__ import annotations

import math

_NORMAL_975 = 1.959964  # 97.5 % quantile of the normal distribution, for intervals of 95 %


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of the share ``hits`` / ``count`` [Wilson 1927].

    Parameters
    ----------
    hits, count : int
        Expected 0 <= hits <= count. Without any count the interval is 0 to 1.
    """
    if count == 0:
        return (0.0, 1.0)
    z, share = _NORMAL_975, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    half /= 1 + z * z / count
    return (max(0.0, middle - half), min(1.0, middle + half))


def clopper_pearson(hits: int, count: int, level: float = 0.95) -> tuple[float, float]:
    """Return the exact confidence interval of a share [Clopper and Pearson 1934]; needs SciPy.

    Parameters
    ----------
    hits, count : int
        Expected 0 <= hits <= count.
    level : float
        Confidence that the share is in the interval; it is above and below it equally rarely.
    """
    from scipy import special

    tail = (1.0 - level) / 2
    low = float(special.betaincinv(hits, count - hits + 1, tail)) if hits else 0.0
    return low, upper_limit(hits, count, 1.0 - tail)


def upper_limit(hits: int, count: int, confidence: float = 0.95) -> float:
    """Return the exact upper limit of a share [Clopper and Pearson 1934]; needs SciPy.

    Parameters
    ----------
    hits, count : int
        Where all of the count are hits, or there is no count, the limit is 1.
    confidence : float
        Confidence that the share is not above the limit.
    """
    from scipy import special

    return 1.0 if hits >= count else float(special.betaincinv(hits + 1, count - hits, confidence))


def upper_rate(alarms: int, frames: int) -> float:
    """Return the upper limit of a rate with 95 % confidence [Clopper and Pearson 1934].

    It is `upper_limit` without SciPy, which detectors do not need.

    Parameters
    ----------
    alarms, frames : int
        Number of alarms, and number of frames; without frames the limit is 1.
    """
    low, high = 0.0, 1.0
    if alarms >= frames:
        return 1.0
    # bisection: at the limit, at most this many alarms have a probability of 5 %
    for _ in range(60):
        rate = 0.5 * (low + high)
        fewer = 1.0 - binomial_tail(alarms + 1, frames, rate)
        low, high = (rate, high) if fewer > 0.05 else (low, rate)
    return high


def binomial_tail(least: int, frames: int, rate: float) -> float:
    """Return the probability that at least ``least`` of ``frames`` independent frames alarm.

    Parameters
    ----------
    least, frames : int
        Number of alarms, and number of frames.
    rate : float
        Probability that one frame alarms, in (0, 1).
    """

    def log_share(count: int) -> float:
        ways = math.lgamma(frames + 1) - math.lgamma(count + 1) - math.lgamma(frames - count + 1)
        return ways + count * math.log(rate) + (frames - count) * math.log1p(-rate)

    # The upper tail is summed directly: 1 minus the lower tail has no significant digits if it is
    # small.
    tail = math.fsum(math.exp(log_share(count)) for count in range(max(least, 0), frames + 1))
    return min(1.0, tail)
