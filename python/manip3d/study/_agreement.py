"""Statistics of categorical answers: agreement of raters, and confidence intervals of shares."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.options import generator_of
from manip3d._util.shares import wilson
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Rng


class Interval(NamedTuple):
    """A number and the ends of its 95 % confidence interval."""

    value: float
    low: float
    high: float


@checked
def share_interval(hits: int, count: int) -> Interval:
    """Return a share and its 95 % confidence interval [Wilson 1927].

    Parameters
    ----------
    hits, count : int
        The share is ``hits`` of ``count``.

    Returns
    -------
    Interval

    Raises
    ------
    InputError
        ``count`` is not positive, or ``hits`` not between 0 and ``count``.

    Examples
    --------
    >>> from manip3d.study import share_interval
    >>> [round(end, 3) for end in share_interval(8, 10)]
    [0.8, 0.49, 0.943]
    """
    if not 0 <= hits <= count or count == 0:
        raise InputError(f"hits, count: expected 0 <= hits <= count > 0, got {hits} and {count}")
    return Interval(hits / count, *wilson(hits, count))


@checked
def fleiss_kappa(counts: ArrayLike) -> float:
    """Return the agreement of several raters beyond chance [Fleiss 1971].

    Parameters
    ----------
    counts : (items, categories) int
        Number of raters who put each item into each category. All items have the same number of
        raters, at least two.

    Returns
    -------
    float
        1: raters agree on every item; 0: agreement as expected by chance; NaN: all answers are in
        one category.

    Raises
    ------
    InputError
        A wrong shape, negative counts, or different numbers of raters.

    Examples
    --------
    >>> from manip3d.study import fleiss_kappa
    >>> fleiss_kappa([[3, 0], [0, 3]])
    1.0
    >>> round(fleiss_kappa([[2, 1], [1, 2]]), 3)
    -0.333
    """
    table = _table(counts)
    raters = int(table[0].sum())
    agreeing = (table * (table - 1)).sum(axis=1) / (raters * (raters - 1))
    shares = table.sum(axis=0) / table.sum()
    by_chance = float((shares**2).sum())
    if by_chance == 1.0:
        return math.nan
    return float((agreeing.mean() - by_chance) / (1.0 - by_chance))


@checked
def fleiss_kappa_interval(counts: ArrayLike, *, repeats: int = 2000, rng: Rng = 0) -> Interval:
    """Return `fleiss_kappa` with the 95 % interval of a bootstrap over items.

    Parameters
    ----------
    counts : (items, categories) int
        Counts, as for `fleiss_kappa`.
    repeats : int
        Number of bootstrap samples, at least 100.
    rng : int, Generator or None
        Seed or generator; None: another interval each time.

    Returns
    -------
    Interval
        Kappa and percentiles of the bootstrap; NaN if kappa is undefined for all samples.

    Raises
    ------
    InputError
        As `fleiss_kappa`, or too few repeats.

    Examples
    --------
    >>> from manip3d.study import fleiss_kappa_interval
    >>> found = fleiss_kappa_interval([[5, 1], [1, 5], [6, 0], [2, 4]])
    >>> found.low <= found.value <= found.high
    True
    """
    if not 100 <= repeats <= 1_000_000:
        raise InputError(f"repeats: expected 100 to 1000000, got {repeats}")
    table = _table(counts)
    random = generator_of(rng)
    chosen = random.integers(len(table), size=(repeats, len(table)))
    found = np.array([fleiss_kappa(table[rows]) for rows in chosen])
    found = found[np.isfinite(found)]
    low, high = np.quantile(found, [0.025, 0.975]) if len(found) else (math.nan, math.nan)
    return Interval(fleiss_kappa(table), float(low), float(high))


def _table(counts: ArrayLike) -> NDArray[np.int64]:
    table = np.asarray(counts)
    if table.ndim != 2 or not table.size or table.dtype.kind not in "iu" or table.min() < 0:
        raise InputError("counts: expected (items, categories) whole numbers >= 0")
    raters = table.sum(axis=1)
    if raters[0] < 2 or (raters != raters[0]).any():
        raise InputError("counts: expected the same number of raters, at least two, for each item")
    return table.astype(np.int64)
