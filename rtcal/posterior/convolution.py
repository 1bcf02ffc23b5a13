"""Densities and covariances of independent variables given their sum, by FFT.

The variables are truncated normal, and tilted so that their sum has the target as its mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.posterior.integration import POINTS, integrated
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
