"""Psychometric functions: simulated observers, and estimates of the 70.7 % point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

TARGET = math.sqrt(0.5)
"""Share of right answers at the threshold, at which one-up-two-down settles [Levitt 1971]."""

GUESS = 0.5  # share of right answers by guessing between two alternatives

# Prior: uniform in the threshold from 0 to 100 %, the range of differences; log-normal in the slope
# with 1 to 9 within two standard deviations; lapse rates up to 6 % [Wichmann and Hill 2001].
_STEP = 0.5
_THRESHOLDS = np.arange(0.5 * _STEP, 100.0, _STEP)
_SLOPES = np.geomspace(0.5, 12.0, 36)
_SLOPE_MIDDLE, _SLOPE_SPREAD = 3.0, math.log(3.0) / 2.0
_LAPSES = np.array([0.0, 0.015, 0.03, 0.06])
_LAPSE_WEIGHTS = np.array([0.35, 0.3, 0.2, 0.15])
_CERTAIN = 1e-6  # smallest probability of either answer, because a slip is always possible


def weibull(difference: Floats, threshold: Floats, slope: Floats, lapse: Floats | float) -> Floats:
    """Return the share of right answers, 1/2 + (1/2 - lapse) (1 - exp(-c (d / t)^slope)).

    d is the difference, t the threshold, and c the constant for which the share is sqrt(1/2) at
    d = t [Watson and Pelli 1983].
    """
    c = -np.log1p(-(TARGET - GUESS) / (1.0 - GUESS - lapse))
    found: Floats = GUESS + (1.0 - GUESS - lapse) * -np.expm1(
        -c * (difference / threshold) ** slope
    )
    return found


@checked
@dataclass(frozen=True)
class SimulatedObserver:
    """An observer who notices differences in polygon counts by a known psychometric function.

    Attributes
    ----------
    threshold : float
        Difference in percent at which a share of sqrt(1/2) of the answers is right.
    slope : float
        Steepness of the psychometric function.
    lapse : float
        Share of wrong answers to very large differences.
    law : {"weibull", "lognormal"}
        Psychometric function; `estimate_threshold` fits the first one.

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
            Difference of the compared polygon counts; at 0 and below, the observer guesses.
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
        # The factor 0.75 makes the curve about as steep in the middle as a Weibull of this slope.
        z = normal.inv_cdf(share) + 0.75 * self.slope * math.log(difference / self.threshold)
        return GUESS + (1.0 - GUESS - self.lapse) * normal.cdf(z)


@dataclass(frozen=True)
class Estimate:
    """A threshold and its interval.

    Attributes
    ----------
    threshold : float
        Difference in percent at which a share of sqrt(1/2) of the answers is right; the median of
        the posterior.
    low, high : float
        Ends of the central 95 % interval of the posterior.
    """

    threshold: float
    low: float
    high: float

    __repr__ = short_repr


@checked
def estimate_threshold(trials: Sequence[tuple[int, bool]]) -> Estimate:
    """Estimate the 70.7 % point from the answers of a staircase.

    Parameters
    ----------
    trials : sequence of (int, bool)
        Difference in percent, and whether the answer was right, for each comparison.

    Returns
    -------
    Estimate

    Raises
    ------
    InputError
        No trials, or a difference out of 1 to 100.

    Notes
    -----
    The model is a Weibull function with unknown threshold, slope and lapse rate. Its posterior is
    computed on a grid and summed over slope and lapse rate. The prior is uniform in the threshold
    from 0 to 100 %, so that the interval of an observer who never notices the simplification ends
    at 100 %. The posterior does not depend on the rule by which the staircase chose the levels.
    Experiment ``jnd-simulated`` measures how often the interval contains the true threshold.

    Examples
    --------
    >>> from manip3d.study import estimate_threshold
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
    # Each point of the grid represents the cell around it.
    heaped = np.concatenate([[0.0], np.cumsum(weights.sum(axis=(0, 1)))])
    edges = np.arange(len(heaped)) * _STEP
    low, middle, high = np.interp([0.025, 0.5, 0.975], heaped / heaped[-1], edges)
    return Estimate(float(middle), float(low), float(high))


@lru_cache(maxsize=128)
def _logarithms(level: int) -> tuple[Floats, Floats]:
    """Return logarithms of the shares of right and wrong answers, by lapse, slope, threshold."""
    right = weibull(
        np.float64(level),  # type: ignore[arg-type]
        _THRESHOLDS,
        _SLOPES[:, None],
        _LAPSES[:, None, None],
    )
    right = np.clip(right, _CERTAIN, 1.0 - _CERTAIN)
    return np.log(right), np.log1p(-right)
