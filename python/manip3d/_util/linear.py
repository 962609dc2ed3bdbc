"""Products and fits that round the same on every processor.

NumPy hands ``@``, ``dot``, the norm of one vector and ``polyfit`` to a BLAS, which chooses its
kernels by the processor: with or without fused multiply-add, in other orders. Where the last bit
decides something, or where the same input promises the same output, these stand in for them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def product(a: ArrayLike, b: ArrayLike) -> NDArray[Any]:
    """``a @ b``."""
    left, right = np.asarray(a), np.asarray(b)
    how = {1: "...i,i->...", 2: "...i,ij->...j"}.get(right.ndim, "...ij,...jk->...ik")
    return np.asarray(np.einsum(how, left, right))  # not optimized: else a BLAS again


def line_fit(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and offset of the line y(x) of least squares, as ``numpy.polyfit(x, y, 1)``."""
    center, height = x.mean(), y.mean()
    away = x - center
    slope = float((away * (y - height)).sum() / (away * away).sum())
    return slope, float(height - slope * center)
