"""Posterior moments of one band by quadrature alone, to check `rtcal.calibration.posterior`.

The density of a sum is built by adding one truncated normal after the other, the widest first, by
Gauss-Legendre quadrature between cubic splines. No transform and no common grid.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.interpolate import CubicSpline

from rtcal.calibration.posterior import Density, draws
from rtcal.support.normal import NORMAL

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)
REACH = 9.0  # support ends where a density is exp(-40) of its highest value
GRID = 1501


@dataclass(frozen=True)
class Normal:
    """A normal density, truncated to [lower, upper]; ``low`` and ``high`` bound its mass."""

    mean: float
    sd: float
    lower: float
    upper: float

    @property
    def ends(self) -> tuple[float, float]:
        peak = np.clip(self.mean, self.lower, self.upper)
        off = abs(peak - self.mean) / self.sd
        reach = self.sd * REACH**2 / (np.sqrt(off**2 + REACH**2) + off)
        return max(self.lower, peak - reach), min(self.upper, peak + reach)

    def log(self, y: Array) -> Array:
        peak = np.clip(self.mean, self.lower, self.upper)
        # (y - mean)² - (peak - mean)², without cancellation far in the tail.
        value = -0.5 * (y - peak) * (y + peak - 2 * self.mean) / self.sd**2
        return np.where((y >= self.lower) & (y <= self.upper), value, -np.inf)


def with_part(log: LogDensity, low: float, high: float, part: Normal) -> LogDensity:
    """Log density of the sum of a variable, whose support is [low, high], and a narrower part."""

    def added(z: Array) -> Array:
        start = np.maximum(part.ends[0], z - high)[:, np.newaxis]
        half = 0.5 * (np.minimum(part.ends[1], z - low)[:, np.newaxis] - start)
        y = start + half * (1 + NODES)
        value = log((z[:, np.newaxis] - y).ravel()).reshape(y.shape) + part.log(y)
        value = np.where(half >= 0, value, -np.inf)
        top = np.maximum(value.max(axis=1, initial=-1e300), -1e300)
        with np.errstate(divide="ignore"):
            total = np.sum(np.exp(value - top[:, np.newaxis]) * WEIGHTS * np.abs(half), axis=1)
            return top + np.log(total)

    return added


def splined(log: LogDensity, low: float, high: float) -> LogDensity:
    """The same log density from a cubic spline on a grid."""
    z = np.linspace(low, high, GRID)
    value = log(z)
    spline = CubicSpline(z, np.exp(value - value.max()))

    def read(x: Array) -> Array:
        with np.errstate(divide="ignore"):
            found = np.log(np.maximum(spline(np.clip(x, low, high)), 0.0))
        return np.where((x >= low) & (x <= high), found, -np.inf)

    return read


def log_sum(parts: list[Normal], low: float, high: float) -> LogDensity:
    """Log density, up to a constant, of the sum of independent parts, between low and high."""
    parts = sorted(parts, key=lambda p: p.ends[1] - p.ends[0], reverse=True)
    density, start, end = parts[0].log, *parts[0].ends
    for k in range(1, len(parts)):
        density = with_part(density, start, end, parts[k])
        if k < len(parts) - 1:
            done, later = parts[: k + 1], parts[k + 1 :]
            start = max(sum(p.ends[0] for p in done), low - sum(p.ends[1] for p in later))
            end = min(sum(p.ends[1] for p in done), high - sum(p.ends[0] for p in later))
            density = splined(density, start, end)
    return density


def tilted(mu: Array, sigma: Array, lower: Array, upper: Array, target: float) -> list[Normal]:
    """Return the parts, tilted so that the sum of their modes is the target."""

    def modes(d: float) -> Array:
        return np.clip(mu - d * sigma**2, lower, upper)

    ends = [-1.0, 1.0]
    while modes(ends[0]).sum() < target:
        ends[0] *= 4
    while modes(ends[1]).sum() > target:
        ends[1] *= 4
    for _ in range(200):
        d = 0.5 * sum(ends)
        ends[int(modes(d).sum() < target)] = d
    return [Normal(*p) for p in zip(mu - d * sigma**2, sigma, lower, upper, strict=True)]


def spread(log: LogDensity, low: float, high: float) -> tuple[float, float, float]:
    """Return mean, standard deviation and width of the central 90 % of a density."""
    for _ in range(12):  # zoom in on the mass
        y = np.linspace(low, high, 4001)
        value = log(y)
        inside = np.flatnonzero(value > value.max() - 40)
        first, last = max(inside[0] - 1, 0), min(inside[-1] + 1, len(y) - 1)
        if last - first > 2000:
            break
        low, high = y[first], y[last]
    weight = np.exp(value - value.max())
    cells = 0.5 * (weight[1:] + weight[:-1])
    cumulative = np.append(0.0, np.cumsum(cells)) / cells.sum()
    mean = np.trapezoid(weight * y, y) / np.trapezoid(weight, y)
    variance = np.trapezoid(weight * (y - mean) ** 2, y) / np.trapezoid(weight, y)
    ends = np.interp([0.05, 0.95], cumulative, y)
    return float(mean), float(np.sqrt(variance)), float(ends[1] - ends[0])


def marginal(parts: list[Normal], i: int, target: float) -> tuple[float, float, float]:
    """Return mean, standard deviation and 90 % width of part i, given the sum of all."""
    others = parts[:i] + parts[i + 1 :]
    low = max(parts[i].ends[0], target - sum(p.ends[1] for p in others))
    high = min(parts[i].ends[1], target - sum(p.ends[0] for p in others))
    rest = log_sum(others, target - high, target - low)
    return spread(lambda y: parts[i].log(y) + rest(target - y), low, high)


@dataclass(frozen=True)
class Band:
    """One band: priors (n,), areas, b and its uncertainty."""

    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    areas: Array
    target: float
    noise: float


def random_band(rng: np.random.Generator) -> Band:
    """Return a band of 2 to 40 materials whose scales span up to six decades.

    b comes from coefficients drawn from the prior, or lies near an end of its reach; half of the
    bands have u_b = 0.
    """
    n = int(rng.integers(2, 41)) if rng.random() < 0.5 else int(rng.integers(2, 6))
    decades = rng.uniform(0, 6)
    areas = 10 ** rng.uniform(0, min(decades, 3), n)
    sigma = 0.2 * 10 ** -rng.uniform(0, max(decades - 3, 0.3), n)
    mu = rng.uniform(0.02, 0.98, n) if rng.random() < 0.5 else rng.uniform(0, 2, n) * sigma
    lower, upper = np.zeros(n), np.ones(n)
    if rng.random() < 0.3:
        lower, upper = np.maximum(0, mu - sigma), np.minimum(1, mu + sigma)
    ends = float(areas @ lower), float(areas @ upper)
    if rng.random() < 0.7:
        truth = np.clip(mu + sigma * rng.standard_normal(n), lower, upper)
        target = float(areas @ truth)
    else:
        share = 10 ** -rng.uniform(0.3, 6)
        target = ends[0] + (ends[1] - ends[0]) * (share if rng.random() < 0.5 else 1 - share)
    margin = 1e-9 * (ends[1] - ends[0])
    target = float(np.clip(target, ends[0] + margin, ends[1] - margin))
    noise = 0.0
    if rng.random() < 0.5:
        noise = float(np.sqrt(np.sum((areas * sigma) ** 2)) * 10 ** rng.uniform(-6, 1))
    return Band(mu, sigma, lower, upper, areas, target, noise)


def density_of(band: Band) -> Density:
    """Return the band as a density: a sum that is exact is a row, one with a noise an observation."""
    share = (band.target - band.areas @ band.lower) / (band.areas @ (band.upper - band.lower))
    point = band.lower + np.clip(share, 0, 1) * (band.upper - band.lower)
    gradient, curvature = (point - band.mu) / band.sigma**2, np.diag(band.sigma**-2.0)
    rows, limit = band.areas[np.newaxis], np.array([band.target])
    if band.noise:
        gradient = gradient + band.areas * (band.areas @ point - band.target) / band.noise**2
        curvature = curvature + np.outer(band.areas, band.areas) / band.noise**2
        rows, limit = rows[:0], limit[:0]
    return Density(
        point=point,
        gradient=gradient,
        curvature=curvature,
        scale=band.sigma,
        lower=band.lower,
        upper=band.upper,
        matrix=rows,
        row_lower=limit,
        row_upper=limit,
        row_noise=np.zeros(len(limit)),
        rank=np.arange(len(point)),
    )


def errors(band: Band, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return posterior / prior, and the relative errors of sd and width of one coefficient."""
    (found,) = draws(density_of(band))
    assert np.isfinite(found.quantiles).all()
    assert (np.diff(found.quantiles, axis=1) >= 0).all()
    weight = stats.norm.pdf(NORMAL)
    mean = found.quantiles @ weight / weight.sum()
    sd = np.sqrt((found.quantiles - mean[:, np.newaxis]) ** 2 @ weight / weight.sum())
    values = np.array([band.mu, band.sigma, band.lower, band.upper]) * band.areas
    if band.noise:
        values = np.column_stack([values, [0, band.noise, -np.inf, np.inf]])
    parts = tilted(*values, band.target)
    i = int(rng.integers(len(sd))) if rng.random() < 0.5 else int(np.argmax(sd * band.areas))
    _, wanted, width = marginal(parts, i, band.target)
    ends = np.interp(stats.norm.ppf([0.05, 0.95]), NORMAL, found.quantiles[i])
    return (
        float(wanted / (band.areas[i] * band.sigma[i])),
        abs(sd[i] * band.areas[i] / wanted - 1),
        abs((ends[1] - ends[0]) * band.areas[i] / width - 1),
    )
