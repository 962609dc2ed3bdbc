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


def quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions w, x, y, z, (N, 4), of (N, 3, 3) rotations; largest component positive."""
    r = rotations
    trace = np.trace(r, axis1=1, axis2=2)
    # Four times each squared component; division by the largest loses no digits [Shepperd 1978].
    squares = np.column_stack([trace] + [2.0 * r[:, i, i] - trace for i in range(3)]) + 1.0
    products = np.empty((len(r), 4, 4))
    products[:, range(4), range(4)] = squares
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, 0, i + 1] = products[:, i + 1, 0] = r[:, k, j] - r[:, j, k]
        products[:, j + 1, k + 1] = products[:, k + 1, j + 1] = r[:, k, j] + r[:, j, k]
    largest = np.argmax(squares, axis=1)
    row: NDArray[np.float64] = products[np.arange(len(r)), largest]
    return np.asarray(row / np.linalg.norm(row, axis=1, keepdims=True))


def rotations_of(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations, (N, 3, 3), of (N, 4) unit quaternions w, x, y, z."""
    w, x, y, z = quaternion.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
        ],
        1,
    )
