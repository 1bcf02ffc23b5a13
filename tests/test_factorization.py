"""Products and determinants of factored covariances are those of the whole matrices."""

from __future__ import annotations

import numpy as np
import pytest

from rtcal.finder.means.likelihood import Factorization


def test_products_and_determinant_are_those_of_the_whole_matrix() -> None:
    rng = np.random.default_rng(0)
    n, m = 4, 9
    root = rng.standard_normal((n, m, 12))
    covariance = root @ root.swapaxes(1, 2)
    rows = rng.standard_normal((n, 5, m))
    factors = Factorization(covariance.copy())
    ends = [3, 6, 9]
    for end, products in zip(ends, factors.leading(rows.copy(), 2, ends), strict=True):
        part, seen = covariance[:, :end, :end], rows[:, :, :end]
        expected = seen @ np.linalg.solve(part, seen.swapaxes(1, 2))
        half, square, across, others = products
        np.testing.assert_allclose(half, 0.5 * np.linalg.slogdet(part)[1], rtol=1e-12)
        diagonal = np.diagonal(expected, axis1=1, axis2=2)
        np.testing.assert_allclose(square, diagonal[:, :2], rtol=1e-9)
        np.testing.assert_allclose(across, expected[:, :2, 2:], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(others, expected[:, 2:, 2:], rtol=1e-8, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="covariance 1 is not positive definite"):
        Factorization(np.stack([np.eye(2), -np.eye(2)]))
