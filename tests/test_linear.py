"""Products and fits beside exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from manip3d._util.linear import determinant, eigen, inverse, line_fit, moved, product

SHAPES = [
    ((3,), (3,)),
    ((5, 3), (3,)),
    ((3,), (3, 4)),
    ((5, 3), (3, 4)),
    ((2, 5, 3), (3, 4)),
    ((2, 5, 3), (2, 3, 4)),
]


@pytest.mark.parametrize(("left", "right"), SHAPES)
def test_product_is_that_of_matrices(left: tuple[int, ...], right: tuple[int, ...]) -> None:
    random = np.random.default_rng(1)
    a, b = random.normal(size=left), random.normal(size=right)
    np.testing.assert_allclose(product(a, b), a @ b, rtol=1e-12, atol=1e-12)
    assert product(a.astype(np.float32), b.astype(np.float32)).dtype == np.float32


def test_product_rounds_each_term() -> None:
    """Fused multiply-add, as in a BLAS, leaves a remainder of x and -x."""
    for x, y in np.random.default_rng(2).uniform(0.1, 3.0, (200, 2)):
        assert product([x, -x], [y, y]) == 0.0
        assert (product(np.full((9, 2), [x, -x]), np.full((2, 9), y)) == 0.0).all()


def test_points_are_moved_as_homogeneous_coordinates_are() -> None:
    turn = np.array([[0.0, -1, 0, 5], [2, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    assert moved([[1.0, 2, 3]], turn).tolist() == [[3.0, 8.0, 10.0]]
    assert moved(np.empty((0, 3), np.float32), turn).shape == (0, 3)


def test_a_line_is_fitted_as_exactly_as_doubles_allow() -> None:
    random = np.random.default_rng(3)
    x = random.uniform(5.0, 60.0, 400)
    y = 0.03 * x - 1.7 + random.normal(scale=0.01, size=400)
    u, v = [Fraction(a) for a in x], [Fraction(b) for b in y]
    mean_u, mean_v = sum(u) / 400, sum(v) / 400
    away = [a - mean_u for a in u]
    slope = sum(a * b for a, b in zip(away, v, strict=True)) / sum(a * a for a in away)
    assert line_fit(x, y) == pytest.approx(
        (float(slope), float(mean_v - slope * mean_u)), rel=1e-12
    )


@pytest.mark.parametrize("size", [1, 2, 3, 4, 12])
def test_inverse_and_eigenvectors_are_those_of_lapack(size: int) -> None:
    random = np.random.default_rng(size)
    for _ in range(20):
        a = random.normal(size=(size, size))
        np.testing.assert_allclose(product(inverse(a), a), np.eye(size), atol=1e-10)
    symmetric = random.normal(size=(5, size, size))
    symmetric = symmetric + symmetric.swapaxes(1, 2)
    values, vectors = eigen(symmetric)
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(symmetric), atol=1e-13)
    np.testing.assert_allclose(
        product(symmetric, vectors), vectors * values[:, None], atol=1e-13 * size
    )
    np.testing.assert_allclose(
        product(vectors.swapaxes(1, 2), vectors), np.tile(np.eye(size), (5, 1, 1)), atol=1e-13
    )


def test_matrices_that_are_nearly_singular() -> None:
    """Pivots keep the digits of needles; what has no inverse is refused."""
    needle = [[0.6, 0.8e-9, 0.0], [-0.8, 0.6e-9, 0.0], [0.0, 0.0, 1e-9]]
    np.testing.assert_allclose(
        inverse(needle), [[0.6, -0.8, 0.0], [0.8e9, 0.6e9, 0.0], [0.0, 0.0, 1e9]], atol=1e-6
    )
    with pytest.raises(np.linalg.LinAlgError):
        inverse([[1.0, 2.0], [2.0, 4.0]])


def test_small_eigenvalues_are_as_precise_as_large_ones() -> None:
    values, vectors = eigen(np.diag([1e-300, 1e300, 0.0]))
    assert values.tolist() == [1e-300, 1e300, 0.0]
    assert (vectors == np.eye(3)).all()


def test_signs_of_determinants_are_right_up_to_needles_and_sheets() -> None:
    random = np.random.default_rng(4)
    for size in ([1.0, 1.0, 1.0], [1.0, 1e-9, 1e-9], [1.0, 1.0, 1e-9]):
        for sign in (1.0, -1.0):
            turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
            matrix = turn * np.sign(np.linalg.det(turn)) * np.array(size) @ np.diag([1, 1, sign])
            assert determinant(matrix) == pytest.approx(sign * np.prod(size), rel=1e-5)
    assert determinant([[0.0, 1.0], [1.0, 0.0]]) == -1.0
    assert determinant(np.ones((3, 3))) == 0.0
