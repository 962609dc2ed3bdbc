"""Receiver operating characteristics: curves, areas, and confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Scores = Mapping[str, Sequence[float]]
"""Scores of the frames of each scene, by scene."""

_RESAMPLES = 2000  # of the bootstrap


def auc(clean: ArrayLike, forged: ArrayLike) -> float:
    """Return the area under the ROC curve.

    It is the probability that a forged frame has a higher score than a clean one; ties count half.
    """
    ranks = np.subtract.outer(np.asarray(forged, float), np.asarray(clean, float))
    return float(np.mean((ranks > 0) + 0.5 * (ranks == 0)))


def auc_interval(clean: Scores, forged: Scores) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the area; whole scenes are drawn with replacement."""
    scenes = sorted(set(clean) & set(forged))
    random = np.random.default_rng(0)
    areas = []
    for draw in random.integers(len(scenes), size=(_RESAMPLES, len(scenes))):
        some = [scenes[i] for i in draw]
        areas.append(
            auc(
                np.concatenate([clean[scene] for scene in some]),
                np.concatenate([forged[scene] for scene in some]),
            )
        )
    low, high = np.percentile(areas, [2.5, 97.5])
    return float(low), float(high)


def curve(clean: Sequence[float], forged: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return false-alarm and detection rates over all thresholds, from (0, 0) to (1, 1)."""
    thresholds = np.unique(np.concatenate([clean, forged]))[::-1]
    false = [float(np.mean(np.asarray(clean) >= t)) for t in thresholds]
    found = [float(np.mean(np.asarray(forged) >= t)) for t in thresholds]
    return [0.0, *false], [0.0, *found]
