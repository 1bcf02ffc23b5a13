"""Exact marginals of one band: independent truncated normals, given their weighted sum.

With y_i = S_i a_i, the error of b as one more normal variable, and f_i the density of y_i,

    p_i(y) ~ f_i(y) g_i(b - y),

g_i the density of the sum of all other variables. Three steps resolve every scale:

1. All densities are multiplied by exp(-D y), with D such that the mean of the sum is about b
   (exponential tilting; Daniels 1954, Sect. 2). The conditional densities do not change. But the sum
   now has a high density at b, also if the measured T is far from its prediction.
2. The variable with the largest standard deviation is restricted to the range that b and the others
allow. The grid of
   the convolution spans the sum of the others only. So a variable a million times wider than the
   others costs no accuracy.
3. Each density has points of its own, and g_i is interpolated at them.

`rtcal.posterior.convolution` has step 1 and `rtcal.posterior.convolution` steps 2 and 3.

`passed_on` is the same after an exact match to a b that is uncertain: the mean of these conditional
distributions over b.
"""

from __future__ import annotations

import numpy as np

from rtcal.posterior.convolution import Variables, balanced, by_convolution, tilted
from rtcal.posterior.integration import POINTS, Marginals, integrated
from rtcal.support.types import Array

_SIDES = np.array([-1.0, 1.0])
_REACH = 4.5
"""Standard uncertainties of b on either side; 7e-6 of a normal distribution lies beyond."""
_SUMS = 13
"""Values of b at which the conditional distributions are computed, and between which they are
interpolated. Every third of them is enough where the quantiles are nearly linear in b."""
_STRAIGHT = 0.01
"""Deviation of the quantiles between every sixth, of all that they go over. It leaves an eighth between
every third."""
_FINE = 97
_LEVELS = np.linspace(-5.0, 5.0, 201)
"""Normal quantiles of the probabilities at which theirs are tabulated, dense in the tails."""
_PAIRS, _TURN = 6765, 4181
"""Pairs of a probability and a b: a lattice of two Fibonacci numbers, even in both and in the plane."""


def marginal_distributions(
    mu: Array,
    sigma: Array,
    lower: Array,
    upper: Array,
    areas: Array,
    target: float,
    uncertainty: float,
    multiplier: float,
    *,
    covariances: bool = True,
) -> Marginals:
    """Return the marginals of coefficients with sigma > 0 given S'a = target ± uncertainty.

    Parameters
    ----------
    mu, sigma, lower, upper : array (n,)
        Normal priors, truncated to the bounds.
    areas : array (n,)
        S in m², above 0.
    target, uncertainty : float
        b and its standard uncertainty (0 or more) in m².
    multiplier : float
        A first guess of the tilt D in 1/m², such as the calibration's multiplier.
    covariances : bool
        Whether to compute the covariances between coefficients; their cost rises with n².
    """
    n = len(mu)
    if uncertainty == 0:
        values = _single_answer(areas, lower, upper, target)
        if values is not None:
            return _certain(values)
    mu, sigma, lower, upper = mu * areas, sigma * areas, lower * areas, upper * areas
    if uncertainty > 0:
        mu, sigma = np.append(mu, 0.0), np.append(sigma, uncertainty)
        lower, upper = np.append(lower, -np.inf), np.append(upper, np.inf)
    variables = balanced(mu, sigma, lower, upper, target, multiplier)
    remainder = target - float(np.sum(variables.peak))
    if len(variables.peak) == 2:
        t, density, covariance = _of_two(variables, remainder)
    else:
        t, density, covariance = by_convolution(variables, remainder, n if covariances else 0)
    shifted = integrated(t[:n], density[:n])
    np.fill_diagonal(covariance, np.diag(shifted.covariance))
    return Marginals(
        (variables.peak[:n, np.newaxis] + shifted.points) / areas[:, np.newaxis],
        shifted.cumulative,
        (variables.peak[:n] + shifted.mean) / areas,
        covariance[:n, :n] / np.outer(areas, areas),
    )


def passed_on(
    mu: Array,
    sigma: Array,
    lower: Array,
    upper: Array,
    areas: Array,
    target: float,
    uncertainty: float,
    multiplier: float,
    *,
    covariances: bool = True,
) -> Marginals:
    """Return the marginals after an exact match to b = target ± uncertainty, b within its reach.

    The sum is normal about the target, whatever the priors say of it. Given the sum, the coefficients
    are distributed as `marginal_distributions` has them with an uncertainty of 0. Without bounds this
    is the exact estimate's error. Parameters are those of `marginal_distributions`, with an uncertainty
    above 0.
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.special import ndtr, ndtri

    ends = np.clip([areas @ lower, areas @ upper], *(target + _REACH * uncertainty * _SIDES))
    levels = ndtr(_LEVELS)

    def at(sums: Array) -> tuple[list[Marginals], Array]:
        """Return the marginals given each sum, and their quantiles, (n_sums, n, n_levels)."""
        found = [
            marginal_distributions(
                mu, sigma, lower, upper, areas, float(b), 0.0, multiplier, covariances=covariances
            )
            for b in sums
        ]
        rows = [
            [np.interp(levels, *own) for own in zip(m.cumulative, m.points, strict=True)]
            for m in found
        ]
        return found, np.array(rows)

    every, fine = (np.linspace(ends[0], ends[1], n) for n in (_SUMS, _FINE))
    sums = every[::3]
    given, quantiles = at(sums)
    bent = np.abs(PchipInterpolator(sums[::2], quantiles[::2])(sums[1::2]) - quantiles[1::2])
    if (bent.max(axis=(0, 2)) > _STRAIGHT * np.ptp(quantiles, axis=(0, 2))).any():
        sums = every
        given, quantiles = at(sums)
    table = PchipInterpolator(sums, quantiles)(fine)
    pair = np.arange(_PAIRS)
    probability, turned = (pair + 0.5) / _PAIRS, (pair * _TURN % _PAIRS + 0.5) / _PAIRS
    below, above = ndtr((ends - target) / uncertainty)
    b = np.clip(target + uncertainty * ndtri(below + (above - below) * turned), *ends)
    values = np.sort(_between(table, fine, b, levels, probability))
    cumulative = np.linspace(0, 1, POINTS)
    mean = PchipInterpolator(sums, np.array([m.mean for m in given]))(b)
    # Linear between the sums: each has the mean weight of its hat function.
    share = np.array([np.interp(b, sums, hat).mean() for hat in np.eye(len(sums))])
    within = np.tensordot(share, np.array([m.covariance for m in given]), 1)
    return Marginals(
        np.array([np.interp(cumulative, probability, own) for own in values]),
        np.tile(cumulative, (len(mu), 1)),
        mean.mean(axis=0),
        within + np.atleast_2d(np.cov(mean.T, bias=True)),
    )


def _between(table: Array, x: Array, at_x: Array, y: Array, at_y: Array) -> Array:
    """Return a table (n_x, n, n_y) at pairs of x and y, (n, n_pairs), linear between its entries."""
    i, j = (np.clip(np.searchsorted(v, at) - 1, 0, len(v) - 2) for v, at in ((x, at_x), (y, at_y)))
    u, v = (at_x - x[i]) / (x[i + 1] - x[i]), (at_y - y[j]) / (y[j + 1] - y[j])
    out = np.empty((table.shape[1], len(u)))
    for row, t in zip(out, np.moveaxis(table, 1, 0), strict=True):
        low, high = t[i, j] * (1 - u) + t[i + 1, j] * u, t[i, j + 1] * (1 - u) + t[i + 1, j + 1] * u
        row[:] = low + v * (high - low)
    return out


def unmatched(mu: Array, sigma: Array, lower: Array, upper: Array) -> Marginals:
    """Return the marginals of a band without a target: the priors themselves."""
    prior = tilted(mu, sigma, lower, upper, 0.0)
    t = np.linspace(prior.low, prior.high, POINTS, axis=1)
    density = np.array([prior.density(i, row) for i, row in enumerate(t)])
    shifted = integrated(t, density)
    points, mean = prior.peak[:, np.newaxis] + t, prior.peak + shifted.mean
    return Marginals(points, shifted.cumulative, mean, shifted.covariance)


def _single_answer(areas: Array, lower: Array, upper: Array, target: float) -> Array | None:
    """Return the coefficients if the target determines all of them, else None.

    It does so for a single coefficient, and at an end of the range of S'alpha, to within rounding.
    """
    if len(areas) == 1:
        return np.asarray(np.clip(target / areas, lower, upper))
    for end, sign in ((lower, 1), (upper, -1)):
        # n eps bounds the relative rounding error of a sum of n products (Higham 2002, Sect. 3.1).
        # The factor 16 is that of `rtcal.calibration.feasibility.end_tolerance`.
        rounding = 16 * len(end) * np.finfo(float).eps * float(np.abs(areas * end).sum())
        if sign * (target - float(areas @ end)) <= rounding:
            return end
    return None


def _certain(values: Array) -> Marginals:
    points = np.repeat(values[:, np.newaxis], POINTS, axis=1)
    cumulative = np.broadcast_to(np.linspace(0, 1, POINTS), points.shape)
    return Marginals(points, cumulative, values.copy(), np.zeros((len(values),) * 2))


def _of_two(variables: Variables, remainder: float) -> tuple[Array, Array, Array]:
    """Points, densities and covariance of two variables whose t have the sum ``remainder``."""
    low = max(variables.low[0], remainder - variables.high[1])
    high = min(variables.high[0], remainder - variables.low[1])
    t = np.linspace(low, high, POINTS)
    # Rounding must not put an end outside the other's support.
    other = np.clip(remainder - t, variables.low[1], variables.high[1])
    density = variables.density(0, t) * variables.density(1, other)
    variance = integrated(t[np.newaxis], density[np.newaxis]).covariance[0, 0]
    covariance = np.array([[variance, -variance], [-variance, variance]])
    return np.array([t, remainder - t[::-1]]), np.array([density, density[::-1]]), covariance
