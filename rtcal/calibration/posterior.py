"""The posterior distribution of the coefficients, and their sensitivity to T."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.normal import NORMAL
from rtcal.support.truncated import Density, Draws, draws, samples
from rtcal.support.types import Array

__all__ = ["Posterior", "distribution", "sensitivity"]
__dir__ = __all__.copy

_ROUNDING = 1e-13
"""A coefficient whose quantiles differ by less than this has a single value."""


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
    points : array (n_materials, n_bands, 201)
        Quantiles of every coefficient at the normal values `rtcal.support.normal.NORMAL`.
    prior_sigma : array (n_materials, n_bands)
        Standard deviation of the truncated prior.
    samples : array (n_samples, n_materials, n_bands)
        Draws of equal weight.
    effective_samples : array (n_materials, n_bands)
        Number of draws of equal weight that are worth those that the distribution rests on.
    effects : dict of str to array (n_samples,)
        Samples of the sizes of further unknowns.
    """

    alpha: Array
    mean: Array
    sigma: Array
    correlation: Array
    points: Array
    prior_sigma: Array
    samples: Array
    effective_samples: Array
    effects: dict[str, Array] = field(default_factory=dict)

    def quantile(self, probability: float) -> Array:
        """Return the quantile of every coefficient, (n_materials, n_bands).

        Raises DataError for a probability that is not between 0 and 1.
        """
        checks.number("probability", probability)
        if not 0 < probability < 1:
            raise DataError(f"probability = {probability:g} is not between 0 and 1")
        z = ndtri(probability)
        return np.apply_along_axis(lambda x: np.interp(z, NORMAL, x), -1, self.points)

    def interval(self, level: float = 0.9) -> tuple[Array, Array]:
        """Return the ends of the credible interval, both (n_materials, n_bands).

        It is the central one, moved only as far as it takes to hold the calibrated coefficient. So at a
        bound it ends there.

        Raises DataError for a level that is not between 0 and 1.
        """
        checks.number("level", level)
        if not 0 < level < 1:
            raise DataError(f"level = {level:g} is not between 0 and 1")
        return intervals(self.alpha, self.points, level)

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Densities:
    """The densities of a calibration's unknowns with the measurement and without it.

    The unknowns are the coefficients, row by row with the bands last, and then the further ones.

    Attributes
    ----------
    rows : tuple of int (n_materials,)
        The row of coefficients of each material; several materials may share a row.
    n_bands : int
    further : tuple of str
        Names of the further unknowns.
    separate : bool
        Whether each band stands for itself: independent priors, and one matched sum.
    posterior, prior : Density
    """

    rows: tuple[int, ...]
    n_bands: int
    further: tuple[str, ...]
    separate: bool
    posterior: Density
    prior: Density

    def of_materials(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the coefficients' entries of values (size, ...), (n_materials, n_bands, ...)."""
        n = (max(self.rows) + 1) * self.n_bands
        return values[:n].reshape(-1, self.n_bands, *values.shape[1:])[list(self.rows)]

    def quantiles(self, parts: list[Draws]) -> Array:
        """Return the coefficients' quantiles at `NORMAL`, (n_materials, n_bands, 201)."""
        table = np.repeat(self.posterior.point[:, np.newaxis], len(NORMAL), axis=1)
        for part in parts:
            table[part.unknowns] = part.quantiles
        return self.of_materials(table)


@runtime_checkable
class HasDensity(Protocol):
    """A result that has a posterior density."""

    def density(self) -> Densities:
        """Return the density of the coefficients given the measurement."""


def distribution(result: HasDensity, n_samples: int = 1024, seed: int = 0) -> Posterior:
    """Return the posterior distribution of a calibration's coefficients.

    The prior is normal with the room's sigma, truncated to the bounds. The error of b is normal with
    the standard deviation u_b, 0 where it is unknown. With an exact match T alone says what S'alpha is,
    to within u_b, and the prior how it is shared. With a soft match both are weighed.

    Parameters
    ----------
    result : CalibrationResult or JointResult
    n_samples : int
        Number of samples, and at least as many draws are made.
    seed : int
        Seed of the evenly spread points from which they come.

    Raises
    ------
    ModelError
        If the objective is not a log-density: a prior with one sigma for all (`lse`) or a
        `HuberDeviation` (`robust`).
    SolverError
        If no point inside the constraints was found.
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
    known = result.density()
    parts = draws(known.posterior, 2 ** max(10, (n_samples - 1).bit_length()), seed)
    points, prior = known.quantiles(parts), known.quantiles(draws(known.prior, seed=seed))
    every = samples(known.posterior, parts, n_samples, seed)
    effective = np.full(len(known.posterior.point), float(n_samples))
    for part in parts:
        effective[part.unknowns] = part.effective
    mean, sigma = _moments(points)
    return Posterior(
        alpha=known.of_materials(known.posterior.point),
        mean=mean,
        sigma=sigma,
        correlation=correlations(known, parts),
        points=points,
        prior_sigma=_moments(prior)[1],
        samples=np.moveaxis(known.of_materials(every.T), -1, 0),
        effective_samples=known.of_materials(effective),
        effects={
            name: every[:, every.shape[1] - len(known.further) + i]
            for i, name in enumerate(known.further)
        },
    )


def correlations(known: Densities, parts: list[Draws]) -> Array:
    """Return the correlations between the materials, (n_bands, n_materials, n_materials)."""
    place = known.of_materials(np.arange(len(known.posterior.point)))
    n = len(place)
    out = np.tile(np.eye(n), (known.n_bands, 1, 1))
    for part in parts:
        centred = part.values - part.weights @ part.values
        covariance = (centred.T * part.weights) @ centred
        spread = np.sqrt(np.diag(covariance))
        scaled = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > _ROUNDING)
        between = np.clip(covariance * np.outer(scaled, scaled), -1, 1)
        for k in range(known.n_bands):
            at = np.searchsorted(part.unknowns, place[:, k])
            at[at == len(part.unknowns)] = 0
            own = np.flatnonzero((part.unknowns[at] == place[:, k]) & (scaled[at] > 0))
            out[k][np.ix_(own, own)] = between[np.ix_(at[own], at[own])]
    out[:, range(n), range(n)] = 1.0
    return out


def intervals(alpha: Array, points: Array, level: float) -> tuple[Array, Array]:
    """Return the ends of `Posterior.interval` of quantiles (..., 201), shape (...)."""
    low, high = np.empty(alpha.shape), np.empty(alpha.shape)
    for place in np.ndindex(*alpha.shape):
        x, own = points[place], alpha[place]
        below = float(ndtr(np.interp(own, x, NORMAL)))
        start = min(max((1 - level) / 2, below - level), below)
        ends = np.interp(ndtri([start, start + level]), NORMAL, x)
        low[place], high[place] = np.minimum(ends[0], own), np.maximum(ends[1], own)
    return low, high


def _moments(points: Array) -> tuple[Array, Array]:
    """Means and standard deviations of quantiles at `NORMAL`."""
    weight = np.exp(-(NORMAL**2) / 2)
    weight /= weight.sum()
    mean = points @ weight
    spread = np.sqrt((points - mean[..., np.newaxis]) ** 2 @ weight)
    return mean, np.where(np.ptp(points, axis=-1) > _ROUNDING, spread, 0.0)


@runtime_checkable
class Optimal(Protocol):
    """A result that has optimality conditions, and so derivatives."""

    def by_time(self) -> Array:
        """Return d alpha / dT in 1/s, (n_materials, n_bands, n_configurations, n_bands)."""


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
    return result.by_time()


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
