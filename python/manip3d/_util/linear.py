"""Linear algebra that gives the same bits on every processor.

NumPy passes ``@``, ``dot``, the norm of one vector, ``polyfit`` and most of ``numpy.linalg`` to a
BLAS, which chooses its kernels by processor: with or without fused multiply-add, and in different
orders of summation. Use these functions instead if the last bit matters, or if equal input must
give equal output.
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


def moved(points: ArrayLike, transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points, (N, 3), to which an affine transform, (4, 4), was applied."""
    return np.asarray(product(points, transform[:3, :3].T) + transform[:3, 3])


def inverse(matrix: ArrayLike) -> NDArray[np.float64]:
    """Return the inverse of a small matrix, by Gauss-Jordan elimination with pivots.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    size = len(np.asarray(matrix))
    rows = np.hstack([np.asarray(matrix, np.float64), np.eye(size)])
    for i in range(size):
        pivot = i + int(np.argmax(np.abs(rows[i:, i])))
        rows[[i, pivot]] = rows[[pivot, i]]
        if rows[i, i] == 0.0:
            raise np.linalg.LinAlgError("Singular matrix")
        rows[i] /= rows[i, i]
        factors = rows[:, i].copy()
        factors[i] = 0.0
        rows -= factors[:, None] * rows[i]
    return rows[:, size:]


def determinant(matrix: ArrayLike) -> float:
    """Return the determinant of a small matrix, by elimination with pivots, without LAPACK.

    The sign is right as long as rounding does not make the matrix singular.
    """
    rows, found = np.array(matrix, np.float64), 1.0
    for i in range(len(rows)):
        pivot = i + int(np.argmax(np.abs(rows[i:, i])))
        rows[[i, pivot]] = rows[[pivot, i]]
        found *= float(rows[i, i]) * (1.0 if pivot == i else -1.0)
        if found == 0.0:
            break
        rows[i + 1 :] -= (rows[i + 1 :, i] / rows[i, i])[:, None] * rows[i]
    return found


_MAX_SWEEPS = 30
"""Largest number of sweeps of `eigen`; matrices of a dozen rows need less than ten."""


def eigen(symmetric: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the eigenvalues, (..., n), and eigenvectors of small symmetric (..., n, n) matrices.

    The eigenvectors are the columns of (..., n, n). Cyclic Jacobi method [Golub & Van Loan 2013,
    sec. 8.5], which unlike LAPACK needs no BLAS.
    """
    left = np.array(symmetric, np.float64)
    size = left.shape[-1]
    vectors = np.zeros_like(left) + np.eye(size)
    for _ in range(_MAX_SWEEPS):
        if not np.triu(left, 1).any():
            break
        for p in range(size - 1):
            for q in range(p + 1, size):
                c, s = _annihilating(left, p, q)
                _turn_columns(left, p, q, c, s)
                _turn_columns(np.swapaxes(left, -1, -2), p, q, c, s)
                left[..., p, q] = left[..., q, p] = 0.0
                _turn_columns(vectors, p, q, c, s)
    return np.diagonal(left, axis1=-2, axis2=-1).copy(), vectors


def _annihilating(
    symmetric: NDArray[np.float64], p: int, q: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return cosine and sine, (..., 1), of the turn after which the entries (p, q) are 0."""
    off = symmetric[..., p, q, None]
    apart = symmetric[..., q, q, None] - symmetric[..., p, p, None]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        tau = apart / (2.0 * off)
        tangent = np.copysign(1.0, tau) / (np.abs(tau) + np.sqrt(1.0 + tau * tau))
    tangent = np.where(off == 0.0, 0.0, tangent)
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    return cosine, tangent * cosine


def _turn_columns(
    matrices: NDArray[np.float64],
    p: int,
    q: int,
    c: NDArray[np.float64],
    s: NDArray[np.float64],
) -> None:
    one, other = matrices[..., p].copy(), matrices[..., q].copy()
    matrices[..., p] = c * one - s * other
    matrices[..., q] = s * one + c * other


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
