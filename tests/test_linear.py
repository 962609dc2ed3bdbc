"""Products and fits beside exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from manip3d._util.linear import line_fit, product

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
