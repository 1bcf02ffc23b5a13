"""Exact marginals of one band: independent truncated normals, given their weighted sum.

With y_i = S_i a_i, the error of b as one more normal variable, and f_i the density of y_i,

    p_i(y) ~ f_i(y) g_i(b - y),

g_i the density of the sum of all other variables. Three steps resolve every scale:

1. All densities are multiplied by exp(-D y), with D such that the mean of the sum is about b
   (exponential tilting; Daniels 1954, Sect. 2). The conditional densities do not change. But the sum
   now has a high density at b, also if the measured T is far from its prediction.
2. The variable with the largest standard deviation is restricted to the range that b and the others
   allow. The grid of the convolution (FFT) spans the sum of the others only. So a variable a
   million times wider than the others costs no accuracy.
3. Each density has points of its own, and g_i is interpolated at them.

`passed_on` is the same after an exact match to a b that is uncertain: the mean of these conditional
distributions over b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.calibration.posterior.density import POINTS, Marginals, integrated
from rtcal.support.types import Array

Waves = NDArray[np.complex128]

_CELLS = 2048
_SPREAD = 32.0
"""Width of the grid in standard deviations of the sum. A log-concave density falls at least
exponentially: at most exp(-15) = 3e-7 of the sum lies outside."""
_NARROW = 0.05
"""A variable with a standard deviation below this many cells enters the convolution with its mean and
variance. The neglected higher moments change its transform by at most 2 (0.05 pi)³ / 6 = 0.0013."""
_NEGLIGIBLE = 1e-13
"""Frequencies where the transforms of all sums are smaller than this are left out."""


def by_convolution(
    variables: Variables, remainder: float, n_covariances: int
) -> tuple[Array, Array, Array]:
    """Points, densities and covariances of variables whose t have the sum ``remainder``."""
    mean, variance = variables.moments()
    m, widest = len(mean), int(np.argmax(variance))
    low, high = variables.low.copy(), variables.high.copy()
    others = np.arange(m) != widest
    centre, spread = float(mean[others].sum()), float(np.sqrt(variance[others].sum()))
    least = max(float(low[others].sum()), centre - _SPREAD / 2 * spread)
    most = min(float(high[others].sum()), centre + _SPREAD / 2 * spread)
    low[widest] = max(low[widest], remainder - most)
    high[widest] = min(high[widest], remainder - least)
    step = (most - least) / _CELLS
    # Cell 0 is the lower end of each variable's range; for the widest, the start of the window.
    origin = low.copy()
    origin[widest] = remainder - most
    waves, moments, middle = _transforms(variables, low, high, origin, step)
    place = (remainder - float(origin.sum())) / step
    used = _significant(waves)
    waves, moments = waves[:, :used], moments[:, :used]
    sums = np.fft.irfft(_products(waves), n=_CELLS, axis=1)
    # Range of each variable, given the sum and the ranges of the others.
    all_low, all_high = float(low.sum()), float(high.sum())
    low = np.maximum(low, remainder - (all_high - high))
    high = np.minimum(high, remainder - (all_low - low))
    t = np.linspace(low, high, POINTS, axis=1)
    density = np.empty_like(t)
    cells = np.arange(_CELLS + 1)
    for i in range(m):
        at = np.mod(place - (t[i] - origin[i]) / step, _CELLS)
        of_others = np.interp(at, cells, np.append(sums[i], sums[i, 0]))
        density[i] = variables.density(i, t[i]) * np.maximum(of_others, 0.0)
    covariance = np.zeros((m, m))
    if n_covariances:
        shift = integrated(t, density).mean - middle
        covariance = _covariances(waves, moments, place, shift, n_covariances)
    return t, density, covariance


def _transforms(
    variables: Variables, low: Array, high: Array, origin: Array, step: float
) -> tuple[Waves, Waves, Array]:
    """Return E exp(-iωx) and E (t - middle) exp(-iωx), (n, frequencies), and the means ``middle``.

    x is t in cells from the origin.
    """
    n = len(low)
    masses, moments, middle = np.zeros((n, _CELLS)), np.zeros((n, _CELLS)), np.empty(n)
    variance = np.empty(n)
    for i in range(n):
        # Four points per cell, so that no cell is skipped.
        count = int(max(256, 4 * (high[i] - low[i]) / step))
        t = low[i] + (high[i] - low[i]) * (np.arange(count) + 0.5) / count
        weight = variables.density(i, t)
        weight /= weight.sum()
        middle[i] = weight @ t
        t -= middle[i]
        variance[i] = weight @ t**2
        x = (t + (middle[i] - origin[i])) / step
        masses[i], moments[i] = _shared(x, weight), _shared(x, weight * t)
    frequency = 2 * np.pi / _CELLS * np.arange(_CELLS // 2 + 1)
    # Sharing weights between two cells was a convolution with a triangle; this division reverts it.
    sharing = np.sinc(frequency / (2 * np.pi)) ** 2
    waves = np.fft.rfft(masses, axis=1) / sharing
    first = np.fft.rfft(moments, axis=1) / sharing
    for i in np.flatnonzero(variance < (_NARROW * step) ** 2).tolist():
        x, u = (middle[i] - origin[i]) / step, variance[i] / step**2
        waves[i] = np.exp(-1j * frequency * x - 0.5 * frequency**2 * u)
        first[i] = -1j * frequency * variance[i] / step * waves[i]
    return waves, first, middle


def _shared(x: Array, weight: Array) -> Array:
    """Share each weight between the two nearest cells, which keeps its mean."""
    left = np.floor(x).astype(np.intp)
    share = x - left
    masses = np.bincount(left % _CELLS, weight * (1 - share), minlength=_CELLS)
    return np.asarray(masses + np.bincount((left + 1) % _CELLS, weight * share, minlength=_CELLS))


def _significant(waves: Waves) -> int:
    """Number of frequencies at which the transform of a sum without two variables is not negligible."""
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(waves))
    size = np.maximum(size, -700.0)
    smallest = np.partition(size, 1, axis=0)[:2].sum(axis=0)
    matters = np.flatnonzero(size.sum(axis=0) - smallest > np.log(_NEGLIGIBLE))
    return int(matters[-1]) + 1


def _products(waves: Waves) -> Waves:
    """For each row the product of all other rows, without a division by small numbers."""
    n = len(waves)
    before, after = np.ones_like(waves), np.ones_like(waves)
    for i in range(1, n):
        before[i] = before[i - 1] * waves[i - 1]
        after[n - 1 - i] = after[n - i] * waves[n - i]
    return before * after


def _covariances(waves: Waves, moments: Waves, place: float, shift: Array, n: int) -> Array:
    """Covariances of the first n variables given the sum, (n, n), with zeros on the diagonal.

    ``shift`` are the means given the sum, relative to the points about which the moments were taken.
    """
    m, used = waves.shape
    read = np.exp(2j * np.pi / _CELLS * place * np.arange(used))
    read[1:] *= 2  # the negative frequencies
    if used == _CELLS // 2 + 1:
        read[-1] /= 2
    total = float(np.real(np.sum(np.prod(waves, axis=0) * read)))
    covariance = np.zeros((m, m))
    before = read / total
    for i in range(n - 1):
        products = _products(waves[i + 1 :])[: n - 1 - i] * (before * moments[i])
        both = np.real(np.sum(products * moments[i + 1 : n], axis=1))
        covariance[i, i + 1 : n] = both - shift[i] * shift[i + 1 : n]
        before = before * waves[i]
    return covariance + covariance.T


_TAIL = 64.0
"""Supports end where a density is exp(-_TAIL / 2) = 1e-14 of its highest value."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_BALANCED = 0.05
"""Largest distance of the tilted mean of the sum from b, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Variables:
    """Truncated normal variables, each described from the peak of its density.

    The density at peak + t is exp(-(slope t + t² / (2 sigma²))) up to a factor, for t from ``low``
    to ``high``. The slope is 0 unless the peak is at a bound. So a density much narrower than sigma
    keeps all digits.
    """

    peak: Array
    slope: Array
    sigma: Array
    low: Array
    high: Array

    def density(self, i: int, t: Array) -> Array:
        """Return the density of variable i at peak + t: 1 at its peak, 0 outside its support."""
        value = np.exp(-(self.slope[i] * t + 0.5 * (t / self.sigma[i]) ** 2))
        return np.where((t >= self.low[i]) & (t <= self.high[i]), value, 0.0)

    def moments(self) -> tuple[Array, Array]:
        """Return the means relative to the peaks, and the variances."""
        half = 0.5 * (self.high - self.low)[:, np.newaxis]
        t = self.low[:, np.newaxis] + half * (1 + _NODES)
        exponent = self.slope[:, np.newaxis] * t + 0.5 * (t / self.sigma[:, np.newaxis]) ** 2
        weight = _WEIGHTS * np.exp(-exponent)
        weight /= weight.sum(axis=1, keepdims=True)
        mean = np.sum(weight * t, axis=1)
        return mean, np.sum(weight * (t - mean[:, np.newaxis]) ** 2, axis=1)


def tilted(mu: Array, sigma: Array, lower: Array, upper: Array, tilt: float) -> Variables:
    """Return truncated normal variables whose densities are multiplied by exp(-tilt y)."""
    centre = mu - tilt * sigma**2
    peak = np.clip(centre, lower, upper)
    slope = np.where(peak == centre, 0.0, (peak - mu) / sigma**2 + tilt)
    steepness = np.abs(slope) * sigma
    reach = sigma * _TAIL / (np.sqrt(steepness**2 + _TAIL) + steepness)
    return Variables(
        peak, slope, sigma, np.maximum(lower - peak, -reach), np.minimum(upper - peak, reach)
    )


def balanced(
    mu: Array, sigma: Array, lower: Array, upper: Array, target: float, tilt: float
) -> Variables:
    """Return the variables tilted so that the mean of their sum is about the target.

    The derivative of the mean with respect to the tilt is minus the variance of the sum, as Newton's
    method needs; a bracket keeps it safe.
    """
    least, most = -np.inf, np.inf
    for _ in range(200):
        variables = tilted(mu, sigma, lower, upper, tilt)
        mean, variance = variables.moments()
        excess = float(np.sum(variables.peak)) - target + float(np.sum(mean))
        spread = float(variance.sum())
        if abs(excess) <= _BALANCED * np.sqrt(spread):
            break
        least, most = (tilt, most) if excess > 0 else (least, tilt)
        tilt += excess / spread
        if not least < tilt < most:
            tilt = 0.5 * (least + most)
    return variables


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
