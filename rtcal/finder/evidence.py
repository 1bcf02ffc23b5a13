"""The evidence of a hypothesis in each observation model: a log density from products of residuals.

    y - f = d + e,   e of covariance C + U U'

f is what is predicted as stated and d the hypothesis' change of it. C is the covariance that is
factored once, U the columns of errors that are the hypothesis' own. With r = y - f - d, the density
needs r' C⁻¹ r, U' C⁻¹ r and U' C⁻¹ U alone (`with_columns`), and the form of its tail: Student's t by
means (`student`), normal up to the number of values by positions (`bounded`), and normal for the
surfaces between two states.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.special import gammaln

from rtcal.support.types import Array


def with_columns(
    square: Array, half: Array | float, across: Array, inner: Array
) -> tuple[Array, Array]:
    """Return r' (C + U U')⁻¹ r, (..., m), and ln sqrt|C + U U'|, (..., 1) (Woodbury).

    Parameters
    ----------
    square : array (..., m)
        r' C⁻¹ r of m residuals.
    half : array (..., 1) or float
        ln sqrt|C|.
    across : array (..., n_columns, m)
        U' C⁻¹ r.
    inner : array (..., n_columns, n_columns)
        U' C⁻¹ U.
    """
    factor = np.asarray(np.linalg.cholesky(inner + np.eye(inner.shape[-1])), dtype=float)
    whitened = np.array(across.swapaxes(-2, -1), order="C")
    shape = whitened.shape[-2:]
    _whiten(factor.reshape(-1, *factor.shape[-2:]), whitened.reshape(-1, *shape))
    more = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)[..., np.newaxis]
    return square - np.einsum("...mr,...mr->...m", whitened, whitened), half + more


def _whiten(factors: Array, rows: Array) -> None:
    """Replace rows x (n, d, m) by L⁻¹ x, of lower factors L (n, m, m)."""
    # LAPACK sees the transpose of a matrix in C order, so its upper factor is the lower one.
    for factor, each in zip(factors, rows, strict=True):
        dtrtrs(factor.T, each.T, lower=0, trans=1, overwrite_b=1)


DEGREES = 5.0
"""Degrees of freedom of the densities: Student's t of covariance C; infinite is the normal density. C
is estimated from few control rooms, and other rooms differ from them, so its scale is uncertain.
Chosen on development rooms of both worlds."""
COARSENING = 50.0
"""Number of features at which the log likelihood counts half: its power is 50 / (50 + n).

No model is exact, and the covariance of its errors is estimated from few control rooms, so n features
say less than n independent ones would. A density of the data being near the model's, instead of equal
to them, has this power (Miller & Dunson 2019, the coarsened posterior). Chosen on
development rooms of both worlds."""


def student(square: Array, half: Array | float, n: int, *, coarsened: bool = True) -> Array:
    """Return the log density of n values from r' C⁻¹ r and ln sqrt|C|: Student's t of covariance C.

    It is taken to the power that `COARSENING` gives. Not ``coarsened``, its power is 1.
    """
    power = COARSENING / (COARSENING + n) if coarsened and np.isfinite(COARSENING) else 1.0
    if np.isinf(DEGREES):
        return np.asarray(power * (-0.5 * square - half - 0.5 * n * np.log(2 * np.pi)))
    degrees, scale = DEGREES, DEGREES - 2
    constant = gammaln((degrees + n) / 2) - gammaln(degrees / 2) - 0.5 * n * np.log(scale * np.pi)
    log = constant - half - 0.5 * (degrees + n) * np.log(1 + square / scale)
    return np.asarray(power * log)


def bounded(square: Array, half: Array | float, n: int) -> Array:
    """Return the log density of n values, but for a constant, from r' C⁻¹ r and ln sqrt|C|.

    Normal up to n; beyond it as if the errors were larger throughout, since few control runs say how
    large they are.
    """
    beyond = n / 2 * (1 + np.log(np.maximum(square / n, 1.0)))
    return np.asarray(-np.where(square <= n, square / 2, beyond) - half)


def log_mixture(one: Array, other: Array, share: float) -> Array:
    """Return the log density where ``one`` holds, or with the probability ``share`` the other.

    ``one`` and ``other`` are log densities of the same data, of one shape.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(np.logaddexp(np.log1p(-share) + one, np.log(share) + other))


class Factorization:
    """The Cholesky factors L of n covariances C (n, m, m), which are overwritten.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is not positive definite.
    """

    def __init__(self, covariance: Array) -> None:
        # LAPACK sees the transpose of a matrix in C order, so its upper factor is the lower one.
        for i, matrix in enumerate(covariance):
            _, info = dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
            if info:
                raise np.linalg.LinAlgError(f"covariance {i} is not positive definite")
        self._half = np.cumsum(np.log(np.diagonal(covariance, axis1=1, axis2=2)), axis=1)
        self._lower = covariance

    def leading(
        self, rows: Array, first: int, ends: Sequence[int]
    ) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Yield ln sqrt|C| and products x C⁻¹ y' of rows (n, d, m), for leading parts of C.

        ``ends`` are the parts' numbers of rows and columns; they rise. The factor of a leading part is
        the leading part of the factor, so that all cost little more than the last. The products are the
        squares of the ``first`` rows (n, first), those of the others with them (n, d - first, first),
        and those of the others with one another. ``rows`` may be overwritten.
        """
        whitened, begin = np.ascontiguousarray(rows), 0
        if whitened.size:
            _whiten(self._lower, whitened)
        square, across, inner = np.zeros(()), np.zeros(()), np.zeros(())
        for end in ends:
            z, w = whitened[:, :first, begin:end], whitened[:, first:, begin:end]
            square = square + np.einsum("ndm,ndm->nd", z, z)
            across, inner = across + w @ z.swapaxes(1, 2), inner + w @ w.swapaxes(1, 2)
            yield self._half[:, end - 1, np.newaxis], square, across, inner
            begin = end
