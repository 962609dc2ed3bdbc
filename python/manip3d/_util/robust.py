"""Constants of robust statistics."""

from __future__ import annotations

NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute value; the core's
``kNormalMad``."""
