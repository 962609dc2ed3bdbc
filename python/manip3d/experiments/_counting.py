"""Confidence intervals of counted shares."""

from __future__ import annotations

from manip3d._util.shares import wilson


def interval(found: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval of the share ``found`` / ``of``."""
    return wilson(found, of)
