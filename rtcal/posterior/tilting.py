"""Independent truncated normal variables, tilted so that their sum has the target as its mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.support.types import Array

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
