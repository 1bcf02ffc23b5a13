"""Exact marginals of one band: independent truncated normals, given their weighted sum.

    p_i(a) ~ f_i(a) g_i(b - S_i a),

f_i the prior density of coefficient i, g_i the density of the others' weighted sum plus the error
of b, by FFT on a grid. Everything is tilted by exp(-D S'a), D the calibration's multiplier: given
S'a that changes nothing, but it moves the grid to where the posterior is, so that a T many standard
deviations off its prediction costs no accuracy. A tilted truncated normal is one again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.support.types import Array

Waves = NDArray[np.complex128]

_GRID = 8192
_TAIL = 64.0  # a density is cut where it is exp(-_TAIL / 2) of its highest value
POINTS = 801


@dataclass(frozen=True)
class Marginals:
    """Of the n coefficients of a band: points and density at them, (n, points), and moments."""

    points: Array
    density: Array
    mean: Array
    covariance: Array


def marginals(
    mu: Array,
    sigma: Array,
    lower: Array,
    upper: Array,
    areas: Array,
    target: float,
    uncertainty: float,
    multiplier: float,
) -> Marginals:
    """Return the marginals of coefficients with sigma > 0 given S'a = target ± uncertainty.

    Parameters
    ----------
    mu, sigma, lower, upper : array (n,)
        Normal priors, truncated to the box.
    areas : array (n,)
        m².
    target, uncertainty : float
        b and its standard uncertainty (0 or more) in m².
    multiplier : float
        D in 1/m²: where the grid is centred, mu - D S sigma².
    """
    n = len(mu)
    tilted = mu - multiplier * areas * sigma**2
    low, high = _support(tilted, sigma, lower, upper)
    reach = np.sum(areas * (high - low)) + 16 * uncertainty
    step = reach / (_GRID // 2)  # the other half keeps the circular convolution from wrapping
    masses, moments = [], []
    middle = np.empty(n)
    for i in range(n):
        # Fine enough that no cell of the grid is skipped.
        count = max(POINTS, int(4 * areas[i] * (high[i] - low[i]) / step))
        a = np.linspace(low[i], high[i], count)
        weight = _density(a, tilted[i], sigma[i])
        weight[[0, -1]] *= 0.5
        weight /= weight.sum()
        middle[i] = weight @ a
        place = areas[i] * (a - low[i]) / step
        masses.append(_spread(place, weight))
        moments.append(_spread(place, weight * (a - middle[i])))
    waves = np.fft.rfft(masses, axis=1)
    first = np.fft.rfft(moments, axis=1)
    frequency = np.arange(waves.shape[1]) * 2 * np.pi / _GRID
    # The error of b, tilted too; its mean is folded into where b stands on the grid.
    error = np.exp(-0.5 * (frequency * uncertainty / step) ** 2)
    start = float(areas @ low)
    place = (target + multiplier * uncertainty**2 - start) / step
    rest = _products(waves) * error
    others = np.fft.irfft(rest, n=_GRID, axis=1)
    points, density = np.empty((n, POINTS)), np.empty((n, POINTS))
    for i in range(n):
        a = np.linspace(low[i], high[i], POINTS)
        at = np.mod(place - areas[i] * (a - low[i]) / step, _GRID)
        own = _density(a, tilted[i], sigma[i])
        cells = np.arange(_GRID + 1)
        closed = np.append(others[i], others[i, 0])
        value = np.maximum(own * np.interp(at, cells, closed), 0.0)
        total = np.trapezoid(value, a)
        points[i], density[i] = a, value / total if total > 0 else np.nan
    mean = np.asarray(np.trapezoid(points * density, points, axis=1))
    variance = np.trapezoid((points - mean[:, np.newaxis]) ** 2 * density, points, axis=1)
    covariance = _covariance(waves, first, error, place, mean - middle)
    np.fill_diagonal(covariance, variance)
    return Marginals(points, density, mean, covariance)


def unmatched(mu: Array, sigma: Array, lower: Array, upper: Array) -> Marginals:
    """Return the marginals of a band without a target: the priors themselves."""
    low, high = _support(mu, sigma, lower, upper)
    points = np.linspace(low, high, POINTS, axis=1)
    density = np.exp(-0.5 * ((points - mu[:, np.newaxis]) / sigma[:, np.newaxis]) ** 2)
    density /= np.trapezoid(density, points, axis=1)[:, np.newaxis]
    mean = np.asarray(np.trapezoid(points * density, points, axis=1))
    variance = np.trapezoid((points - mean[:, np.newaxis]) ** 2 * density, points, axis=1)
    return Marginals(points, density, mean, np.diag(variance))


def _support(mean: Array, sigma: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Where a truncated normal is more than exp(-_TAIL / 2) of its highest value."""
    peak = np.clip(mean, lower, upper)
    off = (peak - mean) / sigma
    up, down = np.maximum(off, 0.0), np.maximum(-off, 0.0)
    high = np.minimum(upper, peak + sigma * (np.sqrt(up**2 + _TAIL) - up))
    low = np.maximum(lower, peak - sigma * (np.sqrt(down**2 + _TAIL) - down))
    return low, high


def _density(a: Array, mean: float, sigma: float) -> Array:
    """A normal density up to a factor: 1 at its highest value on ``a``."""
    exponent = -0.5 * ((a - mean) / sigma) ** 2
    return np.asarray(np.exp(exponent - exponent.max()))


def _spread(place: Array, weight: Array) -> Array:
    """Put weights on the grid, each shared between its two neighbours: the mean is kept."""
    left = np.floor(place).astype(np.intp)
    share = place - left
    masses = np.bincount(left, weight * (1 - share), minlength=_GRID)
    return np.asarray(masses + np.bincount(left + 1, weight * share, minlength=_GRID))[:_GRID]


def _products(waves: Waves) -> Waves:
    """For each row the product of all other rows, without dividing."""
    n = len(waves)
    before, after = np.ones_like(waves), np.ones_like(waves)
    for i in range(1, n):
        before[i] = before[i - 1] * waves[i - 1]
        after[n - 1 - i] = after[n - i] * waves[n - i]
    return before * after


def _covariance(waves: Waves, first: Waves, error: Array, place: float, shift: Array) -> Array:
    """E (a_i - E a_i)(a_j - E a_j) given the sum: every pair's transforms, read at one place."""
    n, half = waves.shape
    frequency = np.arange(half) * 2 * np.pi / _GRID
    read = np.exp(1j * frequency * place) * error
    read[1:-1] *= 2  # the negative frequencies
    total = float(np.real(np.sum(np.prod(waves, axis=0) * read)))
    covariance = np.zeros((n, n))
    for i in range(n - 1):
        others = np.delete(waves, i, axis=0)
        products = _products(others) * (first[i] * read)
        later = np.real(np.sum(products[i:] * first[i + 1 :], axis=1)) / total
        covariance[i, i + 1 :] = covariance[i + 1 :, i] = later - shift[i] * shift[i + 1 :]
    return covariance
