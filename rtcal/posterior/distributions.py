"""The posterior distribution of the coefficients: `distribution` and what it returns.

Marginals are exact, by FFT, if the priors are independent and each band has one matched sum. In all
other cases they come from samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rtcal.posterior.density import POINTS, CoupledBands, IndependentBands, Marginals
from rtcal.posterior.marginals import marginal_distributions, passed_on, unmatched
from rtcal.posterior.sampler import sample
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array

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
class Calibrated(Protocol):
    """A result that has a posterior density."""

    def density(self) -> IndependentBands | CoupledBands:
        """Return the density of the coefficients given the measurement."""


@checked
def distribution(result: Calibrated, n_samples: int = 4000, seed: int = 0) -> Posterior:
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
    if not isinstance(result, Calibrated):
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
