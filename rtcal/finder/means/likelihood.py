"""The problem of a search by means, and the likelihood of each hypothesis in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.special import chdtrc, gammaln, logsumexp

from rtcal.finder.case import Case
from rtcal.finder.means.hypotheses import (
    LowRank,
    MeansHypotheses,
    ModelDiscrepancy,
    ObservedFeatures,
    misfit,
)
from rtcal.finder.prior import SCALES
from rtcal.support.types import Array


class Factorization:
    """The Cholesky factors L of n covariances C (n, m, m), which are overwritten.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is not positive definite.
    """

    def __init__(self, covariance: Array) -> None:
        self._half = np.cumsum(_cholesky(covariance), axis=1)
        self._lower = covariance

    def leading(
        self, rows: Array, first: int, ends: Sequence[int]
    ) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Yield ln sqrt|C| and products x C⁻¹ y' of rows (n, d, m), for leading parts of C.

        ``ends`` are the parts' numbers of rows and columns; they rise. The factor of a leading part is
        the leading part of the factor, so that all cost little more than the last. The products are the
        squares of the ``first`` rows (n, first), those with the others (n, first, d - first), and those
        of the others with one another. ``rows`` may be overwritten.
        """
        whitened, begin = np.ascontiguousarray(rows), 0
        _solve(self._lower, whitened)
        square, across, others = (np.zeros(()) for _ in range(3))
        for end in ends:
            new = _products(whitened[:, :, begin:end], first)
            square, across, others = square + new[0], across + new[1], others + new[2]
            yield self._half[:, end - 1], square, across, others
            begin = end


def _products(rows: Array, first: int) -> tuple[Array, Array, Array]:
    z, w = rows[:, :first], rows[:, first:]
    turned = w.swapaxes(1, 2)
    return np.einsum("ndm,ndm->nd", z, z), z @ turned, w @ turned


def _cholesky(matrices: Array) -> Array:
    """Replace the lower triangles of (n, m, m) by their Cholesky factors L; return ln diag L, (n, m).

    LAPACK sees the transpose of a matrix in C order, so its upper factor is the lower one.
    """
    for i, matrix in enumerate(matrices):
        _, info = dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError(f"covariance {i} is not positive definite")
    return np.asarray(np.log(np.diagonal(matrices, axis1=1, axis2=2)))


def _solve(factors: Array, rows: Array) -> None:
    """Replace rows (n, d, m), in C order, by rows times L⁻ᵀ; L (n, m, m) as `_cholesky` leaves it."""
    if rows.size:
        for matrix, right in zip(factors, rows, strict=True):
            dtrtrs(matrix.T, right.T, lower=0, trans=1, overwrite_b=1)


DEGREES = 5.0
"""Degrees of freedom of the densities: Student's t of covariance C; infinite is the normal density. C
is estimated from few control rooms, and other rooms differ from them, so its scale is uncertain.
Chosen on development rooms of both worlds."""

COARSENING = 50.0
"""Number of features at which the log likelihood counts half: its power is 50 / (50 + n).

No model is exact, and the covariance of its errors is estimated from few control rooms, so n features
say less than n independent ones would. A density of the data being near the model's, instead of equal
to them, has this power (Miller & Dunson 2019, the coarsened posterior). Chosen by
`python -m benchmarks.studies.means.calibrated likelihood` on development rooms of both worlds."""


@dataclass(frozen=True, eq=False)
class MeansProblem:
    """The problem of a search by means: what was measured, what each hypothesis predicts, the errors.

    Attributes
    ----------
    case : Case
    observed : ObservedFeatures
    predicted : MeansHypotheses
    discrepancy : ModelDiscrepancy
    cells : array (n_hypotheses, n_used, n_parameters)
        Of sets: changes of the features over the cell of the grid that a hypothesis stands for, one
        standard deviation of each parameter (`rtcal.finder.means.sets.compare`).
    """

    case: Case
    observed: ObservedFeatures
    predicted: MeansHypotheses
    discrepancy: ModelDiscrepancy
    cells: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """Which of all features, raveled, are in use."""
        return np.asarray(self.observed.used.ravel())

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], ...]:
        """Configurations, rows of `FEATURES` and bands of the features in use, (n_used,) each."""
        return np.nonzero(self.observed.used)

    @cached_property
    def t20(self) -> NDArray[np.intp]:
        """The row of each feature's ln T20 among configurations and bands, (n_used,)."""
        c, _, b = self.places
        return np.asarray(c * self.observed.used.shape[2] + b)

    @cached_property
    def changes(self) -> Array:
        """Changes of the features in use by each hypothesis, (n_hypotheses, n_used)."""
        c, f, b = self.places
        return np.asarray((self.predicted.features - self.predicted.features[0])[:, c, f, b])

    @cached_property
    def amounts(self) -> Array:
        """Change of ln T20 in the same band and configuration, (n_hypotheses, n_used)."""
        c, _, b = self.places
        return np.asarray((self.predicted.features - self.predicted.features[0])[:, c, 0, b])

    @cached_property
    def slopes(self) -> Array:
        """The derivatives of the features in use by ln T20, (n_hypotheses, n_used)."""
        c, f, b = self.places
        return np.asarray(self.predicted.slopes[:, c, f, b])

    @property
    def bias(self) -> Array:
        """The model's bias of the features in use, (n_used,)."""
        return np.asarray(self.discrepancy.bias[self.mask])

    def residual(self, i: int, values: Array | None = None) -> Array:
        """Return the measured features, or ``values`` for them, less those of hypothesis ``i``."""
        y = self.observed.values if values is None else values
        return np.asarray(y - self.predicted.features[i].ravel()[self.mask] - self.bias)

    def log_likelihood(
        self, values: Array, ends: Sequence[int], *, off: bool
    ) -> tuple[Array, Array]:
        """Return log N(y; y_k + bias, C) of the first so many of ``values`` (n_draws, n), by ``ends``.

        Two arrays (n_ends, n_hypotheses, n_draws), in nats. The first with the coefficients as stated,
        the second with coefficients that are off together; -inf without ``off``.
        """
        c, f, b = self.places
        centres = self.predicted.features[:, c, f, b] + self.bias
        n, (draws, m) = len(centres), values.shape
        stated, together = (np.full((len(ends), n, draws), -np.inf) for _ in range(2))
        # A few hypotheses at a time, so that their covariances stay in the processor's cache.
        step = max(1, min(_AT_ONCE, _ELEMENTS // (m + draws) ** 2))
        for begin in range(0, n, step):
            part = slice(begin, begin + step)
            rows = values - centres[part, None]
            if off:
                common = self.predicted.alpha_covariance.off_together(part).take(self.t20, 1)
                common = common * self.slopes[part, :, None]
                rows = np.concatenate([rows, common.swapaxes(1, 2)], axis=1)
            densities = log_densities(self._factorization(part), rows, draws, ends)
            for i, (as_stated, scaled) in enumerate(densities):
                stated[i, part] = as_stated
                if scaled is not None:
                    together[i, part] = scaled
        return stated, together

    @cached_property
    def without_alpha(self) -> Array:
        """R + D + the covariance from the applied effects, of the features in use."""
        both = self.discrepancy.covariance + self.predicted.applied.covariance
        return np.asarray(self.observed.covariance + both[np.ix_(self.mask, self.mask)])

    def _alpha(self, part: slice) -> Array:
        """Return J Sigma J' of some hypotheses, (n, n_used, n_used)."""
        out = self.predicted.alpha_covariance.of(part).take(self.t20, 2)
        out *= self.slopes[part, None, :]
        out = out.take(self.t20, 1)
        return np.asarray(out * self.slopes[part, :, None])

    def _misfit(self, part: slice) -> LowRank:
        """Return the error of the effects' changes of some hypotheses."""
        _, f, b = self.places
        errors = self.predicted.spectrum_errors[part]
        errors = errors[:, :, errors.any((0, 1))].take(b, 1)
        alone = self.predicted.formula_errors[part]
        return misfit(self.changes[part], self.amounts[part], f, errors, alone)

    def _factorization(self, part: slice) -> Factorization:
        """Return the factors of some hypotheses' covariances."""
        covariance = self._alpha(part)
        covariance += self.without_alpha
        covariance += self._misfit(part).covariance
        return Factorization(covariance)

    def covariance_of(self, i: int, scale: float = 1.0) -> tuple[Array, Array]:
        """Return the covariance of hypothesis ``i`` from the coefficients, and that from all else.

        Both (n_used, n_used). ``scale`` multiplies the error that the coefficients have in common.
        """
        part = slice(i, i + 1)
        alpha = self._alpha(part)[0]
        if scale != 1:
            common = self.spreading(i) @ self.predicted.alpha_covariance.off_together(part)[0]
            alpha = alpha + (scale**2 - 1) * common @ common.T
        return alpha, self.without_alpha + self._misfit(part).covariance[0]

    def spreading(self, i: int) -> Array:
        """Return d feature / d ln T20, (n_used, n_configurations * n_bands)."""
        count, _, bands = self.observed.used.shape
        out = np.zeros((len(self.t20), count * bands))
        out[np.arange(len(self.t20)), self.t20] = self.slopes[i]
        return out

    def goodness_of_fit(self, i: int, scale: float = 1.0) -> tuple[float, float]:
        """Return the distance of the measurement from hypothesis ``i``, and its probability.

        The distance is sqrt(r' C^-1 r / n), 1 on average. The probability is that of a larger
        chi-square (Gelman, Meng & Stern 1996, without their draws, since C includes the prior).
        ``scale`` as for `covariance_of`.
        """
        alpha, other = self.covariance_of(i, scale)
        residual = self.residual(i)
        square = float(residual @ np.linalg.solve(alpha + other, residual))
        return float(np.sqrt(square / len(residual))), float(chdtrc(len(residual), square))

    def standardized_residuals(self) -> Array:
        """Return modelled less measured over its standard deviation, as `ObservedFeatures.features`."""
        c = alpha_covariance(self.predicted, 0) + self.discrepancy.covariance
        spread = np.sqrt(np.diag(c)[self.mask] + np.diag(self.observed.covariance))
        out = np.full(self.mask.size, np.nan)
        modelled = self.predicted.features[0].ravel()[self.mask] + self.bias
        out[self.mask] = (modelled - self.observed.values) / spread
        return out.reshape(self.observed.used.shape)


_AT_ONCE = 32  # hypotheses
_ELEMENTS = 4_000_000  # numbers in an array of covariances: 32 MB


def alpha_covariance(predicted: MeansHypotheses, i: int) -> Array:
    """Return J Sigma J' of one hypothesis, over all features raveled."""
    slopes = predicted.slopes[i]  # (configurations, features, bands)
    count, kinds, bands = slopes.shape
    variance = predicted.alpha_covariance.of(slice(i, i + 1)).reshape(count, bands, count, bands)
    full = np.einsum("afk,akbl,bgl->afkbgl", slopes, variance, slopes)
    return np.asarray(full.reshape(count * kinds * bands, -1))


def log_density(residual: Array, covariance: Array) -> float:
    """Return the log density of a residual (m,) under a covariance, in nats."""
    factorization = Factorization(covariance[None].copy())
    ((log, _),) = log_densities(factorization, residual[None, None].copy(), 1, [len(residual)])
    return float(log[0, 0])


def log_densities(
    factorization: Factorization,
    rows: Array,
    draws: int,
    ends: Sequence[int],
    *,
    coarsened: bool = True,
) -> Iterator[tuple[Array, Array | None]]:
    """Yield log densities (n, draws) of residuals under C: as stated, and off together.

    They are of the first so many values, for each of ``ends``. ``rows`` (n, draws + r, m) are the
    residuals, then F'; without F' the second is None. It is the mean density over `SCALES` under
    C + (s² - 1) F F'. With M = F' C⁻¹ F, a scale costs the factors of I + (s² - 1) M (Woodbury).
    ``coarsened`` as for `student`.
    """
    scales = np.array(SCALES)
    more, log_probability = (scales[:, 0] ** 2 - 1)[:, None], np.log(scales[:, 1])[:, None]
    for m, products in zip(ends, factorization.leading(rows, draws, ends), strict=True):
        half, square, across, others = products
        stated = student(square, half[:, None], m, coarsened=coarsened)
        if rows.shape[1] == draws:
            yield stated, None
            continue
        grown = np.eye(others.shape[1]) + more[:, None] * others[:, None]
        solved = across[:, None] @ np.linalg.inv(grown)
        less = more * np.einsum("nsdr,ndr->nsd", solved, across)
        spread = half[:, None] + 0.5 * np.linalg.slogdet(grown)[1]
        log = student(square[:, None] - less, spread[:, :, None], m, coarsened=coarsened)
        yield stated, logsumexp(log_probability + log, axis=1)


def student(square: Array, half_log_determinant: Array, m: int, *, coarsened: bool = True) -> Array:
    """Return the log density from r' C^-1 r and ln sqrt|C|, to the power that `COARSENING` gives.

    It is Student's t with C as its covariance. Not ``coarsened``, its power is 1.
    """
    power = COARSENING / (COARSENING + m) if coarsened and np.isfinite(COARSENING) else 1.0
    if np.isinf(DEGREES):
        log = -0.5 * square - half_log_determinant - 0.5 * m * np.log(2 * np.pi)
        return np.asarray(power * log)
    n, scale = DEGREES, DEGREES - 2
    constant = gammaln((n + m) / 2) - gammaln(n / 2) - 0.5 * m * np.log(scale * np.pi)
    log = constant - half_log_determinant - 0.5 * (n + m) * np.log(1 + square / scale)
    return np.asarray(power * log)
