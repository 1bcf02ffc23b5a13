"""The posterior distribution of the coefficients, and their sensitivity to T.

Marginals are exact, by FFT, if the priors are independent and each band has one matched sum. In all
other cases they come from samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rtcal.calibration.posterior.density import POINTS, CoupledBands, IndependentBands, Marginals
from rtcal.calibration.posterior.marginals import marginal_distributions, passed_on, unmatched
from rtcal.support import checks, kkt
from rtcal.support.errors import DataError
from rtcal.support.kkt import Hessian
from rtcal.support.sampler import sample
from rtcal.support.types import Array

__all__ = ["Posterior", "distribution", "sensitivity"]
__dir__ = __all__.copy

Rows = NDArray[np.intp]

_ROUNDING = 1e-13
"""Coefficients whose samples differ by less than this have a single value."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """The distribution of alpha given the measurement.

    Attributes
    ----------
    alpha : array (n_materials, n_bands)
        The calibrated coefficients.
    mean, sigma : array (n_materials, n_bands)
        Posterior mean and standard deviation.
    correlation : array (n_bands, n_materials, n_materials)
        Correlations between the materials, per band.
    points, cumulative : array (n_materials, n_bands, n_points)
        The distribution function of every coefficient.
    prior_sigma : array (n_materials, n_bands)
        Standard deviation of the truncated prior.
    samples : array (n_samples, n_materials, n_bands), optional
        Only if sampling was needed.
    effective_samples : array (n_materials, n_bands), optional
        Number of independent samples with the same standard error of the mean, which is
        sigma / sqrt(effective_samples).
    effects : dict of str to array (n_samples,)
        Samples of the sizes of further unknowns.
    """

    alpha: Array
    mean: Array
    sigma: Array
    correlation: Array
    points: Array
    cumulative: Array
    prior_sigma: Array
    samples: Array | None = None
    effective_samples: Array | None = None
    effects: dict[str, Array] = field(default_factory=dict)

    def quantile(self, probability: float) -> Array:
        """Return the quantile of every coefficient, (n_materials, n_bands).

        Raises DataError for a probability that is not between 0 and 1.
        """
        checks.number("probability", probability)
        if not 0 < probability < 1:
            raise DataError(f"probability = {probability:g} is not between 0 and 1")
        return _quantile(self.points, self.cumulative, probability)

    def interval(self, level: float = 0.9) -> tuple[Array, Array]:
        """Return the ends of the credible interval, both (n_materials, n_bands).

        It is the central one, moved only as far as it takes to hold the calibrated coefficient. So at a
        bound it ends there.

        Raises DataError for a level that is not between 0 and 1.
        """
        checks.number("level", level)
        if not 0 < level < 1:
            raise DataError(f"level = {level:g} is not between 0 and 1")
        return _interval(self.alpha, self.points, self.cumulative, level)

    @property
    def identifiability(self) -> Array:
        """1 - posterior variance / prior variance, (n_materials, n_bands).

        At 1 the measurement determines the coefficient; at 0 it adds no information. The value is
        slightly below 0 if the measurement moves a coefficient away from a bound that truncates its
        prior.
        """
        before = self.prior_sigma**2
        ratio = np.divide(self.sigma**2, before, out=np.ones_like(before), where=before > 0)
        return np.asarray(1 - ratio)


@runtime_checkable
class HasDensity(Protocol):
    """A result that has a posterior density."""

    def density(self) -> IndependentBands | CoupledBands:
        """Return the density of the coefficients given the measurement."""


def distribution(result: HasDensity, n_samples: int = 4000, seed: int = 0) -> Posterior:
    """Return the posterior distribution of a calibration's coefficients.

    The prior is normal with the room's sigma, truncated to the bounds. The error of b is normal with
    the standard deviation u_b, 0 where it is unknown. With an exact match T alone says what S'alpha is,
    to within u_b, and the prior how it is shared. With a soft match both are weighed.

    Parameters
    ----------
    result : CalibrationResult or JointResult
    n_samples : int
        Number of samples if sampling is needed.
    seed : int
        Seed of the sampler.

    Raises
    ------
    ModelError
        If the objective is not a log-density: a prior with one sigma for all (`lse`) or a
        `HuberDeviation` (`robust`).
    SolverError
        If sampling was needed and no point inside the constraints was found.
    DataError
        If ``result`` is not the result of a calibration, ``n_samples`` not a whole number of at
        least 2, or ``seed`` not one of at least 0.

    Examples
    --------
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2(), method="soft")
    >>> low, high = rt.posterior.distribution(result).interval(0.9)
    >>> bool(((low < result.alpha) & (result.alpha < high)).all())
    True
    """
    if not isinstance(result, HasDensity):
        raise DataError(f"result = {result!r} is not the result of a calibration")
    checks.whole("n_samples", n_samples, 2)
    checks.whole("seed", seed, 0)
    density = result.density()
    if isinstance(density, IndependentBands):
        return exact_posterior(density)
    return _sampled(density, n_samples, seed)


def exact_posterior(bands: IndependentBands) -> Posterior:
    """Return the posterior of independent priors with one matched sum per band."""
    shape = bands.mu.shape
    points = np.repeat(bands.alpha[:, :, np.newaxis], POINTS, axis=2)
    cumulative = np.broadcast_to(np.linspace(0, 1, POINTS), points.shape).copy()
    mean, sigma, prior_sigma = bands.alpha.copy(), np.zeros(shape), np.zeros(shape)
    correlation = np.tile(np.eye(shape[0]), (shape[1], 1, 1))
    for k in _bands_with_freedom(bands):
        free = np.flatnonzero(bands.sigma[:, k] > 0)
        prior_sigma[free, k] = np.sqrt(np.diag(unmatched(*_prior(bands, free, k)).covariance))
        band = _band(bands, free, k, covariances=True)
        points[free, k], cumulative[free, k] = band.points, band.cumulative
        mean[free, k] = band.mean
        spread = sigma[free, k] = np.sqrt(np.diag(band.covariance))
        product = np.outer(spread, spread)
        between = np.divide(band.covariance, product, out=np.eye(len(free)), where=product > 0)
        # Variances and covariances come from two quadratures, which agree to 1e-4.
        correlation[k][np.ix_(free, free)] = np.clip(between, -1, 1)
    rows = list(bands.rows)
    return Posterior(
        bands.alpha[rows],
        mean[rows],
        sigma[rows],
        correlation[:, rows][:, :, rows],
        points[rows],
        cumulative[rows],
        prior_sigma[rows],
    )


def exact_interval(bands: IndependentBands, level: float) -> tuple[Array, Array]:
    """Return the ends of `Posterior.interval`, both (n_materials, n_bands).

    They equal those of `exact_posterior`, but take less time, since no correlations are computed.
    """
    ends = bands.alpha.copy(), bands.alpha.copy()
    for k in _bands_with_freedom(bands):
        free = np.flatnonzero(bands.sigma[:, k] > 0)
        band = _band(bands, free, k, covariances=False)
        of_band = _interval(bands.alpha[free, k], band.points, band.cumulative, level)
        for end, values in zip(ends, of_band, strict=True):
            end[free, k] = values
    rows = list(bands.rows)
    return ends[0][rows], ends[1][rows]


def _bands_with_freedom(bands: IndependentBands) -> list[int]:
    """The bands in which a coefficient may move."""
    return np.flatnonzero((bands.sigma > 0).any(axis=0)).tolist()


def _prior(bands: IndependentBands, free: Rows, k: int) -> tuple[Array, Array, Array, Array]:
    """mu, sigma, lower and upper bound of the free rows in band k."""
    return bands.mu[free, k], bands.sigma[free, k], bands.lower[free, k], bands.upper[free, k]


def _band(bands: IndependentBands, free: Rows, k: int, *, covariances: bool) -> Marginals:
    """The marginals of the free rows in band k."""
    if not np.isfinite(bands.target[k]):
        return unmatched(*_prior(bands, free, k))
    held = np.where(bands.sigma[:, k] > 0, 0.0, bands.alpha[:, k])
    of_sum = passed_on if bands.exact and bands.noise[k] > 0 else marginal_distributions
    return of_sum(
        *_prior(bands, free, k),
        bands.areas[free],
        float(bands.target[k] - bands.areas @ held),
        float(bands.noise[k]),
        float(bands.multiplier[k]),
        covariances=covariances,
    )


def _interval(alpha: Array, points: Array, cumulative: Array, level: float) -> tuple[Array, Array]:
    """The ends of `Posterior.interval` of distribution functions (..., n_points), shape (...)."""
    low, high = np.empty(alpha.shape), np.empty(alpha.shape)
    for place in np.ndindex(*alpha.shape):
        x, of_x, own = points[place], cumulative[place], alpha[place]
        below = float(np.interp(own, x, of_x))
        start = min(max((1 - level) / 2, below - level), below)
        low[place] = np.minimum(np.interp(start, of_x, x), own)
        high[place] = np.maximum(np.interp(start + level, of_x, x), own)
    return low, high


def _quantile(points: Array, cumulative: Array, probability: float) -> Array:
    """The quantiles of distribution functions (..., n_points), shape (...)."""
    out = np.empty(points.shape[:-1])
    for place in np.ndindex(*out.shape):
        out[place] = np.interp(probability, cumulative[place], points[place])
    return out


def _sampled(bands: CoupledBands, n_samples: int, seed: int) -> Posterior:
    rows, n_alpha = list(bands.rows), (max(bands.rows) + 1) * bands.n_bands
    drawn = sample(bands.posterior, n_samples, seed)
    unknowns = drawn.values
    alpha = unknowns[:, :n_alpha].reshape(len(unknowns), -1, bands.n_bands)[:, rows]
    ordered = np.moveaxis(np.sort(alpha, axis=0), 0, -1)
    levels = (np.arange(len(alpha)) + 0.5) / len(alpha)
    sigma = alpha.std(axis=0, ddof=1)
    sigma[np.ptp(alpha, axis=0) < _ROUNDING] = 0.0
    scaled = (alpha - alpha.mean(axis=0)) / np.where(sigma > 0, sigma, np.inf)
    correlation = np.einsum("sik,sjk->kij", scaled, scaled) / (len(alpha) - 1)
    correlation[:, range(len(rows)), range(len(rows))] = 1.0
    prior = sample(bands.prior, n_samples, seed + 1).values
    prior_sigma = prior[:, :n_alpha].std(axis=0, ddof=1)
    calibrated = bands.posterior.point[:n_alpha].reshape(-1, bands.n_bands)[rows]
    return Posterior(
        alpha=calibrated,
        mean=alpha.mean(axis=0),
        sigma=sigma,
        correlation=correlation,
        points=ordered,
        cumulative=np.broadcast_to(levels, ordered.shape),
        prior_sigma=prior_sigma.reshape(-1, bands.n_bands)[rows],
        samples=alpha,
        effective_samples=drawn.effective[:n_alpha].reshape(-1, bands.n_bands)[rows],
        effects={name: unknowns[:, n_alpha + p] for p, name in enumerate(bands.further)},
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimality:
    """The optimality conditions at the answer, and their derivatives with respect to T.

    H du + A' dy = -dg and A du = dc, over the free unknowns u and the active rows A.

    Attributes
    ----------
    rows : tuple of int (n_materials,)
        The row of coefficients of each material.
    n_bands, n_configurations : int
    curvature : Hessian
        H.
    matrix : array or sparse array (n_rows, size)
    scale : array (size,)
        The scale of each unknown.
    free : array (size,) of bool
        Unknowns that may move.
    active : array (n_rows,) of bool
        Rows that hold with equality.
    gradient_by_time : array (size, n_times)
        d gradient / d T in 1/s, one T per configuration and band.
    limit_by_time : array (n_rows, n_times)
        d limit / d T in m²/s.
    """

    rows: tuple[int, ...]
    n_bands: int
    n_configurations: int
    curvature: Hessian
    matrix: Any
    scale: Array
    free: NDArray[np.bool_]
    active: NDArray[np.bool_]
    gradient_by_time: Array
    limit_by_time: Array

    def derivative(self) -> Array:
        """Return du / dT in 1/s, (size, n_times); 0 for unknowns that are not free."""
        import scipy.sparse as sp

        scale = self.scale[self.free]
        rows = sp.csr_array(self.matrix)[self.active][:, self.free] * scale
        norm = np.sqrt(np.asarray((rows**2).sum(axis=1)).ravel())
        rows = sp.csr_array(sp.diags_array(1 / norm) @ rows)
        force = -self.gradient_by_time[self.free] * scale[:, np.newaxis]
        limit = self.limit_by_time[self.active] / norm[:, np.newaxis]
        step, _ = kkt.solve(self.curvature.part(self.free, scale), rows, force, limit)
        out = np.zeros((len(self.scale), force.shape[1]))
        out[self.free] = scale[:, np.newaxis] * step
        return out


@runtime_checkable
class Optimal(Protocol):
    """A result that has optimality conditions."""

    def optimality(self) -> Optimality:
        """Return the optimality conditions at the answer."""


def sensitivity(result: Optimal) -> Array:
    """Return d alpha / d T in 1/s, (n_materials, n_bands, n_configurations, n_bands).

    The last two axes are those of T. Coefficients at a bound stay there: the derivative is valid until
    the next bound. For independent priors and an exact match, over the free coefficients F of the
    band,  d alpha_F / db = S_F sigma_F² / sum(S_F² sigma_F²),  times db/dT (docs/posterior.md).

    Parameters
    ----------
    result : CalibrationResult or JointResult

    Raises
    ------
    DataError
        If ``result`` is not the result of a calibration.

    Examples
    --------
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2())
    >>> slope = rt.posterior.sensitivity(result)
    >>> bool((slope[:, 2, 0, 2] <= 0).all())  # a longer T at 500 Hz needs less absorption there
    True
    """
    if not isinstance(result, Optimal):
        raise DataError(f"result = {result!r} is not the result of a calibration")
    conditions = result.optimality()
    n_rows = max(conditions.rows) + 1
    by_time = conditions.derivative()[: n_rows * conditions.n_bands]
    shape = (n_rows, conditions.n_bands, conditions.n_configurations, conditions.n_bands)
    return np.asarray(by_time.reshape(shape)[list(conditions.rows)])


_SHARE_OF_ROUNDING = 1e-7
"""Of the prior's sigma: what the difference of equal variances leaves. As an uncertainty it would let a
coefficient that T alone determines contradict the next T by millions of standard deviations."""


def linear_estimate_sigma(gain: Array, sigma: Array, cross: Array, innovation: Array) -> Array:
    """Return the standard deviation of a linear estimate's error, (size,).

    The estimate is mu + G (b - S'mu), its error (1 - G S')(mu - u) + G e, with e the error of b.
    With the prior's covariance K and the covariance U of e the error's covariance is
    (1 - G S') K (1 - G S')' + G U G'. It holds for any gain, also for one whose method assumes
    another sigma.

    Parameters
    ----------
    gain : array (size, n_rows)
        G = du / db in 1/m².
    sigma : array (size,)
        Square root of the diagonal of K.
    cross : array (size, n_rows)
        K S.
    innovation : array (n_rows, n_rows)
        S'KS + U, the covariance of b - S'mu.
    """
    variance = (
        sigma**2 - 2 * np.sum(gain * cross, axis=1) + np.sum((gain @ innovation) * gain, axis=1)
    )
    left = np.sqrt(np.maximum(variance, 0.0))
    return np.where(left > _SHARE_OF_ROUNDING * sigma, left, 0.0)
