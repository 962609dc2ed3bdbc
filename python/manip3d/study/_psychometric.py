"""Psychometric functions: simulated observers, and the 70.7 % point with its interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

TARGET = math.sqrt(0.5)
"""Share of right answers at the threshold: where one-up-two-down settles [Levitt 1971]."""

GUESS = 0.5  # of two, one is right

# The prior: flat in the threshold from 0 to 100 %, which is all that can be shown; slopes of 1 to 9
# within two standard deviations; lapses up to 6 %, as Wichmann and Hill [2001] allow.
_STEP = 0.5
_THRESHOLDS = np.arange(0.5 * _STEP, 100.0, _STEP)
_SLOPES = np.geomspace(0.5, 12.0, 36)
_SLOPE_MIDDLE, _SLOPE_SPREAD = 3.0, math.log(3.0) / 2.0
_LAPSES = np.array([0.0, 0.015, 0.03, 0.06])
_LAPSE_WEIGHTS = np.array([0.35, 0.3, 0.2, 0.15])
_CERTAIN = 1e-6  # no answer is surer: a slip of the hand is always possible


def weibull(difference: Floats, threshold: Floats, slope: Floats, lapse: Floats | float) -> Floats:
    """Share of right answers: 1/2 + (1/2 - lapse) (1 - exp(-c (d / t)^slope)); c makes it sqrt(1/2)
    at d = t [Watson and Pelli 1983]."""
    c = -np.log1p(-(TARGET - GUESS) / (1.0 - GUESS - lapse))
    found: Floats = GUESS + (1.0 - GUESS - lapse) * -np.expm1(
        -c * (difference / threshold) ** slope
    )
    return found


@dataclass(frozen=True)
class SimulatedObserver:
    """Somebody who sees differences in polygon counts by a known law.

    Attributes
    ----------
    threshold : float
        Difference, percent, of which sqrt(1/2) of the answers are right.
    slope : float
        How steeply the share of right answers grows.
    lapse : float
        Share of wrong answers to the largest differences.
    law : {"weibull", "lognormal"}
        ``lognormal`` is not the law that `estimate_threshold` fits.

    Raises
    ------
    InputError
        A number is out of range.
    """

    threshold: float
    slope: float = 3.0
    lapse: float = 0.02
    law: Literal["weibull", "lognormal"] = "weibull"

    def __post_init__(self) -> None:
        if not (0.0 < self.threshold < math.inf and 0.0 < self.slope < math.inf):
            raise InputError(
                f"threshold, slope: expected > 0, got {self.threshold} and {self.slope}"
            )
        if not 0.0 <= self.lapse < 1.0 - TARGET:
            raise InputError(f"lapse: expected 0 to {1 - TARGET:.3f}, got {self.lapse}")
        if self.law not in ("weibull", "lognormal"):
            raise InputError(f"law: expected weibull or lognormal, got {self.law!r}")

    def probability(self, difference: float) -> float:
        """Return the share of right answers at a difference.

        Parameters
        ----------
        difference : float, percent
            Difference of the compared polygon counts; 0 and less: the observer guesses.
        """
        if difference <= 0.0:
            return GUESS
        if self.law == "weibull":
            one = np.float64(difference)
            return float(
                weibull(one, np.float64(self.threshold), np.float64(self.slope), self.lapse)  # type: ignore[arg-type]
            )
        share = (TARGET - GUESS) / (1.0 - GUESS - self.lapse)
        from statistics import NormalDist

        normal = NormalDist()
        # A slope of 3 is about as steep as a Weibull's in the middle.
        z = normal.inv_cdf(share) + 0.75 * self.slope * math.log(difference / self.threshold)
        return GUESS + (1.0 - GUESS - self.lapse) * normal.cdf(z)


@dataclass(frozen=True)
class Estimate:
    """A threshold and its interval.

    Attributes
    ----------
    threshold : float
        Difference, percent, of which sqrt(1/2) of the answers are right: the posterior's median.
    low, high : float
        Between which 95 % of the posterior lie.
    """

    threshold: float
    low: float
    high: float


@checked
def estimate_threshold(trials: Sequence[tuple[int, bool]]) -> Estimate:
    """Estimate the 70.7 % point of the answers of a staircase.

    Parameters
    ----------
    trials : sequence of (int, bool)
        Difference in percent, and whether the answer was right.

    Returns
    -------
    Estimate

    Raises
    ------
    InputError
        No trials, or a difference out of 1 to 100.

    Notes
    -----
    A Weibull function with unknown threshold, slope and lapse rate; the posterior on a grid, summed
    over slope and lapse. The prior is flat in the threshold, from 0 to 100 %, so the
    interval of an observer who never sees the simplification ends at 100 %. The staircase chose the
    levels by the answers, which has no effect on a posterior. Experiment ``jnd-simulated`` counts
    how often the interval holds the true threshold.

    Examples
    --------
    >>> found = estimate_threshold([(20, True), (20, True), (15, True), (15, False)] * 12)
    >>> found.low < found.threshold < found.high
    True
    """
    levels = [int(level) for level, _ in trials]
    if not levels or not 1 <= min(levels) <= max(levels) <= 100:
        raise InputError("trials: expected differences of 1 to 100 percent, at least one")
    shown = sorted(set(levels))
    place = {level: n for n, level in enumerate(shown)}
    right, wrong = np.zeros(len(shown)), np.zeros(len(shown))
    for level, is_right in trials:
        (right if is_right else wrong)[place[int(level)]] += 1.0
    likelihood = np.zeros((len(_LAPSES), len(_SLOPES), len(_THRESHOLDS)))
    for level, num_right, num_wrong in zip(shown, right, wrong, strict=True):
        log_right, log_wrong = _logarithms(level)
        likelihood += num_right * log_right + num_wrong * log_wrong
    slope_prior = np.exp(-0.5 * (np.log(_SLOPES / _SLOPE_MIDDLE) / _SLOPE_SPREAD) ** 2)
    weights = np.exp(likelihood - likelihood.max())
    weights *= _LAPSE_WEIGHTS[:, None, None] * slope_prior[:, None]
    # Each point of the grid stands for the cell around it.
    heaped = np.concatenate([[0.0], np.cumsum(weights.sum(axis=(0, 1)))])
    edges = np.arange(len(heaped)) * _STEP
    low, middle, high = np.interp([0.025, 0.5, 0.975], heaped / heaped[-1], edges)
    return Estimate(float(middle), float(low), float(high))


@lru_cache(maxsize=128)
def _logarithms(level: int) -> tuple[Floats, Floats]:
    """Logarithms of the shares of right and of wrong answers, by lapse, slope and threshold."""
    right = weibull(
        np.float64(level),  # type: ignore[arg-type]
        _THRESHOLDS,
        _SLOPES[:, None],
        _LAPSES[:, None, None],
    )
    right = np.clip(right, _CERTAIN, 1.0 - _CERTAIN)
    return np.log(right), np.log1p(-right)
