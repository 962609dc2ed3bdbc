"""Confidence intervals of counted shares."""

from __future__ import annotations


def interval(found: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval of the share ``found`` / ``of``."""
    if of == 0:
        return (0.0, 1.0)
    z, share = 1.959964, found / of
    middle = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z * (share * (1 - share) / of + z * z / (4 * of * of)) ** 0.5 / (1 + z * z / of)
    return (max(0.0, middle - half), min(1.0, middle + half))
