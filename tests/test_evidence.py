"""One evidence: products with factored covariances, and densities, are those of the whole matrices."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from rtcal.finder import evidence
from rtcal.finder.evidence import bounded, leading_products, student, with_columns


def test_products_and_determinant_are_those_of_the_whole_matrix():
    rng = np.random.default_rng(0)
    n, m = 4, 9
    root = rng.standard_normal((n, m, 12))
    covariance = root @ root.swapaxes(1, 2)
    rows = rng.standard_normal((n, 5, m))
    ends = [3, 6, 9]
    leading = leading_products(covariance.copy(), rows.copy(), 2, ends)
    for end, products in zip(ends, leading, strict=True):
        part, seen = covariance[:, :end, :end], rows[:, :, :end]
        expected = seen @ np.linalg.solve(part, seen.swapaxes(1, 2))
        half, square, across, inner = products
        np.testing.assert_allclose(half[:, 0], 0.5 * np.linalg.slogdet(part)[1], rtol=1e-12)
        diagonal = np.diagonal(expected, axis1=1, axis2=2)
        np.testing.assert_allclose(square, diagonal[:, :2], rtol=1e-9)
        np.testing.assert_allclose(across, expected[:, 2:, :2], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(inner, expected[:, 2:, 2:], rtol=1e-8, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_is_an_error():
    with pytest.raises(np.linalg.LinAlgError, match="covariance 1 is not positive definite"):
        list(leading_products(np.stack([np.eye(2), -np.eye(2)]), np.zeros((2, 1, 2)), 1, [2]))


def test_the_evidence_of_a_hypothesis_is_the_density_under_its_whole_covariance(monkeypatch):
    rng = np.random.default_rng(1)
    n, draws = 7, 3
    root = rng.standard_normal((n, 9))
    covariance, shift = root @ root.T, rng.standard_normal((4, n, 1))
    left = 3 * rng.standard_normal((n, draws)) - shift  # four hypotheses
    columns = rng.standard_normal((4, n, 2))
    inverse, turned = np.linalg.inv(covariance), columns.swapaxes(1, 2)
    square, half = with_columns(
        np.einsum("hnm,nk,hkm->hm", left, inverse, left),
        0.5 * np.linalg.slogdet(covariance)[1],
        turned @ inverse @ left,
        turned @ inverse @ columns,
    )
    by_student, by_bounded = student(square, half, n), bounded(square, half, n)
    monkeypatch.setattr(evidence, "DEGREES", np.inf)
    monkeypatch.setattr(evidence, "COARSENING", np.inf)
    by_normal = student(square, half, n)
    for h, (residual, own) in enumerate(zip(left, columns, strict=True)):
        whole = covariance + own @ own.T
        normal = multivariate_normal(np.zeros(n), whole).logpdf(residual.T)
        np.testing.assert_allclose(by_normal[h], normal, rtol=1e-9)
        heavy = multivariate_t(np.zeros(n), 0.6 * whole, df=5).logpdf(residual.T)
        np.testing.assert_allclose(by_student[h], 50 / 57 * heavy, rtol=1e-9)
        distance = np.einsum("nm,nm->m", residual, np.linalg.solve(whole, residual))
        constant = 0.5 * n * np.log(2 * np.pi)
        near = distance <= n
        np.testing.assert_allclose(by_bounded[h][near], normal[near] + constant, rtol=1e-9)
        # Beyond, the density with errors as large as the residuals themselves.
        larger = distance[~near] / n
        wider = [
            multivariate_normal(np.zeros(n), s * whole).logpdf(r)
            for s, r in zip(larger, residual.T[~near], strict=True)
        ]
        np.testing.assert_allclose(by_bounded[h][~near], np.array(wider) + constant, rtol=1e-9)
    assert (square > n).any()
    assert (square <= n).any()
