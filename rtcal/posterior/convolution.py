"""Densities and covariances of independent variables given their sum, by FFT."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.posterior.integration import POINTS, integrated
from rtcal.posterior.tilting import Variables
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
