"""Matrix products and line fits that give the same bits on every processor.

NumPy passes ``@``, ``dot``, the norm of one vector and ``polyfit`` to a BLAS, which chooses its
kernels by processor: with or without fused multiply-add, and in different orders of summation. Use
these functions instead if the last bit matters, or if equal input must give equal output.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def product(a: ArrayLike, b: ArrayLike) -> NDArray[Any]:
    """Return ``a @ b``, summed without a BLAS."""
    left, right = np.asarray(a), np.asarray(b)
    how = {1: "...i,i->...", 2: "...i,ij->...j"}.get(right.ndim, "...ij,...jk->...ik")
    return np.asarray(np.einsum(how, left, right))  # optimize=True would call a BLAS


def line_fit(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return slope and offset of the least-squares line y(x), as ``numpy.polyfit(x, y, 1)``."""
    center, height = x.mean(), y.mean()
    away = x - center
    slope = float((away * (y - height)).sum() / (away * away).sum())
    return slope, float(height - slope * center)
