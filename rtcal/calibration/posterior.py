"""The probability distribution of calibrated coefficients, and their sensitivity to the measured T.

All knowledge (input, T, other observations) is one normal density, with bounds on linear functions of
the unknowns. `draws` returns quantiles and random draws of such a density. Unknowns that neither the
density nor a bound connects are groups by themselves. For each group:

1. Each bound is replaced by a normal factor with which every unknown has the mean and variance that its
   bound leaves it (expectation propagation; Minka 2001, Cunningham, Hennig & Lacoste-Julien 2011).
2. The unknowns are drawn one after the other from evenly spread points (Sobol 1967), each within its
   bound and with the factors of those that follow. A weight corrects the error of the factors (Genz
   1992, with the factors as in Botev 2017). Nearly all weights are alike.
3. The quantiles are those of a mixture: for each draw, the density along a line through it. Without
   bounds this is the normal density itself, with all digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.special import log_ndtr, ndtr, ndtri

from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError, SolverError
from rtcal.support.normal import FAR, NORMAL, quantile_and_mass, truncated_moments
from rtcal.support.types import Array, read_only

__all__ = ["distribution", "sensitivity"]
__dir__ = __all__.copy

_SINGLE = 1e-13
"""A coefficient whose quantiles differ by less than this has a single value."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Probability distribution of the coefficients, given the measurement.

    ``alpha`` are the calibrated coefficients, ``mean`` and ``sigma`` the distribution's means and
    standard deviations, and ``prior_sigma`` the standard deviations before the measurement,
    (n_materials, n_bands) each. ``correlation`` is that between materials in each band. ``points`` are
    quantiles, ``samples`` random coefficients, and ``effective_samples`` how many independent ones have
    the same accuracy. ``effects`` has samples of each further unknown by name.
    """

    alpha: Array
    """Calibrated coefficients, (n_materials, n_bands)."""
    mean: Array
    sigma: Array
    """Means (``mean``) and standard deviations of the coefficients given the measurement,
    (n_materials, n_bands)."""
    correlation: Array
    """Correlations between the materials in each band, (n_bands, n_materials, n_materials)."""
    points: Array
    """Quantiles of each coefficient at the normal values `rtcal.support.normal.NORMAL`, (n_materials,
    n_bands, 201)."""
    prior_sigma: Array
    """Standard deviation of the input coefficients, cut at their bounds, (n_materials, n_bands)."""
    samples: Array
    """Random samples of the coefficients, all of equal weight, (n_samples, n_materials, n_bands)."""
    effective_samples: Array
    """Number of equally weighted samples with the same accuracy, (n_materials, n_bands)."""
    effects: dict[str, Array] = field(default_factory=dict)
    """Samples of the size of each further unknown by its name, (n_samples,)."""

    def quantile(self, probability: float) -> Array:
        """Return the value that each coefficient does not exceed with a given probability.

        The values are (n_materials, n_bands). Raises DataError for a ``probability`` that is not
        between 0 and 1.
        """
        checks.number("probability", probability)
        if not 0 < probability < 1:
            raise DataError(f"probability = {probability:g} must be between 0 and 1")
        z = ndtri(probability)
        return np.apply_along_axis(lambda x: np.interp(z, NORMAL, x), -1, self.points)

    def interval(self, level: float = 0.9) -> tuple[Array, Array]:
        """Return the lower and the upper end of each coefficient's credible interval.

        Both ends are (n_materials, n_bands). ``level`` is the probability that the interval contains
        the coefficient. The same probability lies below and above the interval, unless it would then
        exclude the calibrated coefficient: in that case it is moved just far enough to contain it.
        Raises DataError for a ``level`` that is not between 0 and 1.
        """
        checks.number("level", level)
        if not 0 < level < 1:
            raise DataError(f"level = {level:g} must be between 0 and 1")
        return intervals(self.alpha, self.points, level)

    @property
    def identifiability(self) -> Array:
        """Share of each coefficient's variance that the measurement removes, (n_materials, n_bands).

        At 1 the measurement determines the coefficient, at 0 the measurement gives no information on
        it. The share is slightly below 0 if the measurement moves the coefficient away from a bound
        that cuts off part of its input distribution.
        """
        before = self.prior_sigma**2
        ratio = np.divide(self.sigma**2, before, out=np.ones_like(before), where=before > 0)
        return np.asarray(1 - ratio)


def distribution(result: Any, n_samples: int = 1024, seed: int = 0) -> Posterior:
    """Return the probability distribution of a calibration's coefficients, given the measurement.

    Before the measurement, each coefficient has a normal distribution with the room's alpha and sigma,
    cut at its bounds. The absorption area that the measured T needs has a normal error, whose standard
    deviation follows from the uncertainty of T; an unknown uncertainty counts as 0. If the calibration
    matches T exactly, T alone determines the absorption area, and the input only determines how the
    materials share it. With a soft match (`rtcal.terms.SoftMatch`), T and the input both determine the
    absorption area.

    Parameters
    ----------
    result : CalibrationResult or JointResult
        Calibration whose coefficients have this distribution.
    n_samples : int
        Number of samples in the result, at least 2.
    seed : int
        Seed of the random numbers, at least 0; the same seed gives the same samples.

    Returns
    -------
    Posterior
        Means, standard deviations, quantiles and random samples of the coefficients.

    Raises
    ------
    ModelError
        If the method has no probability distribution: one sigma for all coefficients (``method="lse"``)
        or a `HuberDeviation` (``method="robust"``).
    SolverError
        If no coefficients within the constraints were found.
    DataError
        If ``n_samples`` or ``seed`` is not such a number.

    Examples
    --------
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2(), method="soft")
    >>> low, high = rt.posterior.distribution(result).interval(0.9)
    >>> bool(((low < result.alpha) & (result.alpha < high)).all())
    True
    """
    checks.whole("n_samples", n_samples, 2)
    checks.whole("seed", seed, 0)
    joint = getattr(result, "joint", result)
    layout, density = joint.composition.layout, joint.density()
    parts = draws(density, 2 ** max(10, (n_samples - 1).bit_length()), seed)
    points, prior = quantiles(layout, density, parts), joint.density(measured=False)
    every = samples(density, parts, n_samples, seed)
    effective = np.full(len(density.point), float(n_samples))
    for part in parts:
        effective[part.unknowns] = part.effective
    mean, sigma = _moments(points)
    return Posterior(
        alpha=layout.expand(density.point),
        mean=mean,
        sigma=sigma,
        correlation=correlations(layout, density, parts),
        points=points,
        prior_sigma=_moments(quantiles(layout, prior, draws(prior, seed=seed)))[1],
        samples=np.moveaxis(layout.expand(every.T), -1, 0),
        effective_samples=layout.expand(effective),
        effects=dict(zip(layout.further, every[:, layout.n_alpha :].T, strict=True)),
    )


def quantiles(layout: Any, density: Density, parts: Sequence[Draws]) -> Array:
    """Return 201 quantiles of each coefficient's distribution, (n_materials, n_bands, 201).

    Quantile i is at the probability with which a standard normal value is below
    `rtcal.support.normal.NORMAL` [i]. ``layout`` is the order of the unknowns, ``density`` their
    density, and ``parts`` are the random draws from it.
    """
    table = np.repeat(density.point[:, np.newaxis], len(NORMAL), axis=1)
    for part in parts:
        table[part.unknowns] = part.quantiles
    return np.asarray(layout.expand(table))


def correlations(layout: Any, density: Density, parts: Sequence[Draws]) -> Array:
    """Return the correlations between materials in each band, (n_bands, n_materials, n_materials)."""
    place = layout.expand(np.arange(len(density.point)))
    n, n_bands = place.shape
    out = np.tile(np.eye(n), (n_bands, 1, 1))
    for part in parts:
        centred = part.values - part.weights @ part.values
        covariance = (centred.T * part.weights) @ centred
        spread = np.sqrt(np.diag(covariance))
        scaled = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > _SINGLE)
        between = np.clip(covariance * np.outer(scaled, scaled), -1, 1)
        for k in range(n_bands):
            at = np.searchsorted(part.unknowns, place[:, k])
            at[at == len(part.unknowns)] = 0
            own = np.flatnonzero((part.unknowns[at] == place[:, k]) & (scaled[at] > 0))
            out[k][np.ix_(own, own)] = between[np.ix_(at[own], at[own])]
    out[:, range(n), range(n)] = 1.0
    return out


def intervals(alpha: Array, points: Array, level: float) -> tuple[Array, Array]:
    """Return both ends of `Posterior.interval` from quantiles (..., 201), (...) each."""
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
    return mean, np.where(np.ptp(points, axis=-1) > _SINGLE, spread, 0.0)


def sensitivity(result: Any) -> Array:
    """Return the change of each calibrated coefficient per change of each measured T, in 1/s.

    The derivatives are (n_materials, n_bands, n_configurations, n_bands): the first two axes are those
    of the coefficient, the last two those of T. They hold for small changes, because a coefficient at a
    bound is taken to stay there. With an exact match and independent input coefficients, the derivative
    of coefficient i by the absorption area that T needs is S_i sigma_i² / sum(S_j² sigma_j²). S_i is
    the area of the material, and the sum is over the coefficients of the band that are at no bound
    (docs/posterior.md).

    Parameters
    ----------
    result : CalibrationResult or JointResult
        Calibration whose derivatives are returned.

    Examples
    --------
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2())
    >>> slope = rt.posterior.sensitivity(result)
    >>> bool((slope[:, 2, 0, 2] <= 0).all())  # a longer T at 500 Hz needs less absorption there
    True
    """
    slopes: Array = getattr(result, "joint", result).by_time()
    return slopes


Integers = NDArray[np.intp]

_LARGEST = 2_000
"""Largest number of unknowns: the cost of their covariance rises with its cube."""
_HELD = 1e-6
"""Range in units of an unknown's scale below which it has a single value."""
_DETERMINED = 1e-13
"""Variance, of 1 before the data, below which a coordinate follows from those drawn before it."""
_ROUNDS, _STEP, _CHANGE = 16, 0.7, 1e-3
"""Rounds of the factors at most, the share of each step that is made, and the change at which they end;
the weights make up for what is left."""
_ROUNDING = 1e-6
"""How far rounding may put a coordinate that follows from others beyond its bound."""
_SLICES, _PER_STEP = 16, 16
"""Slices of a stated sum's distribution; and draws in each step of it, which get its probability."""
_BLOCK = 128
"""Pieces that are drawn side by side, so that NumPy does the loop."""
_REACH = 9.0
"""Distance in standard deviations beyond which nothing is left."""
_POINTS = ndtr(np.linspace(-3.2, 3.2, 29))
"""Probabilities at whose values, among the draws, a mixture of several densities is calculated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Density:
    """Describe the normal density of a calibration's unknowns, cut by bounds and linear constraints.

    The density of the unknowns u (size,), which are coefficients and sizes of effects, is proportional
    to exp(-g'(u - p) - ½ (u - p)'H(u - p)). p is ``point``, g is ``gradient`` and H is ``curvature``.
    ``lower`` and ``upper`` are the bounds of u. The sums ``matrix`` u must lie from ``row_lower`` to
    ``row_upper``, (n_rows,) each; equal limits are an equality.

    An equality whose ``row_noise`` is above 0 is not exact: the sum is then normal with the limit as
    mean and ``row_noise`` as standard deviation, cut to the values that the bounds allow. In that case
    g, H and the bounds only determine how the unknowns share the sum.
    """

    point: Array  # p, where the equalities hold
    gradient: Array  # g
    curvature: Any  # H, (size, size), sparse; or its diagonal, if H is diagonal
    scale: Array  # of each unknown; 0 for a fixed one
    lower: Array
    upper: Array
    matrix: Any  # (n_rows, size), may be sparse
    row_lower: Array  # limits of ``matrix @ u``; equal for an equality
    row_upper: Array
    row_noise: Array  # standard uncertainty of what each equality is equal to
    rank: Integers  # order of drawing where bounds change unknowns alike: by names, not by places


@dataclass(frozen=True, eq=False)
class Draws:
    """Weighted random draws of unknowns that depend on each other."""

    unknowns: Integers  # their places among all, (n_unknowns,)
    values: Array  # (number, n_unknowns)
    weights: Array  # (number,), 1 in sum
    quantiles: Array  # (n_unknowns, 201), at the normal values `rtcal.support.normal.NORMAL`

    @property
    def effective(self) -> float:
        """Number of equally weighted draws with the same accuracy."""
        return float(1 / (self.weights @ self.weights))


def samples(density: Density, parts: Sequence[Draws], number: int, seed: int) -> Array:
    """Return equally weighted random samples of all unknowns, (number, size)."""
    rng = np.random.default_rng(seed)
    out = np.tile(density.point, (number, 1))
    for part in parts:  # drawn from the same even points, hence the permutation
        total = np.cumsum(part.weights)
        chosen = np.searchsorted(total, (np.arange(number) + rng.random()) / number * total[-1])
        chosen = rng.permutation(np.minimum(chosen, len(total) - 1))
        out[:, part.unknowns] = part.values[chosen]
    return out


@dataclass(frozen=True, eq=False)
class _Part:
    """Unknowns that belong together, relative to the density's point and in units of its scale.

    The coordinates are stated sums, the unknowns, and other sums that have limits: a normal density
    (mean, covariance) within bounds. ``stated`` (n_stated, 2) are mean and variance of the first.
    ``sums`` (n_sums, size) times the coordinates is ``value`` (n_sums,).
    """

    unknowns: Integers
    rank: Integers
    mean: Array
    covariance: Array
    lower: Array
    upper: Array
    stated: Array
    sums: Array
    value: Array

    @property
    def size(self) -> int:
        return len(self.mean)


def draws(density: Density, number: int = 1024, seed: int = 0) -> list[Draws]:
    """Return random draws from a density, one `Draws` per group of unknowns that depend on each other.

    A `Draws` has the weighted draws and the quantiles of its unknowns. ``number`` is the number of
    draws and a power of two. A group with an inexact equality (`Density.row_noise`) gets twice as many.
    ``seed`` is the seed of the random numbers. Raises ModelError for more than 2,000 unknowns, and
    SolverError if no draw is within the constraints.
    """
    parts = _parts(density)
    pieces = [(i, *piece) for i, part in enumerate(parts) for piece in _pieces(part, number, seed)]
    drawn: list[list[tuple[Array, Array]]] = [[] for _ in parts]
    for _, alike in groupby(sorted(pieces, key=_shape), key=_shape):
        group = list(alike)
        for first in range(0, len(group), _BLOCK):
            block = group[first : first + _BLOCK]
            of_block = _drawn([piece for _, piece, _ in block], [even for *_, even in block])
            for (i, *_), one in zip(block, of_block, strict=True):
                drawn[i].append(one)
    found = []
    for part, of_pieces in zip(parts, drawn, strict=True):
        u, own = part.unknowns, slice(len(part.stated), len(part.stated) + len(part.unknowns))
        values = np.concatenate([values for values, _ in of_pieces])
        weights = np.concatenate([weight for _, weight in of_pieces]) / len(of_pieces)
        point, scale = density.point[u], density.scale[u]
        box = density.lower[u], density.upper[u]
        marginals = np.clip(point + scale * _marginals(values, weights, part).T, *box).T
        values = np.clip(point + scale * values[:, own], *box)
        found.append(Draws(u, values, weights, marginals))
    return found


def _shape(piece: tuple[int, _Part, Array]) -> tuple[int, int]:
    return len(piece[2]), piece[1].size


def _parts(density: Density) -> list[_Part]:
    """The parts of a density that nothing couples."""
    free = np.flatnonzero(density.scale > 0)
    if len(free) > _LARGEST:
        raise ModelError(
            f"{len(free)} unknowns are too many to sample; at most {_LARGEST} are possible"
        )
    scale, point = density.scale[free], density.point[free]
    curvature = _dense(density.curvature)[np.ix_(free, free)] * np.outer(scale, scale)
    matrix = _dense(density.matrix)
    rows = matrix[:, free] * scale
    used = np.flatnonzero(rows.any(axis=1))
    rows, at_point = rows[used], (matrix @ density.point)[used]
    length = np.linalg.norm(rows, axis=1)
    rows = rows / length[:, np.newaxis]
    low, high = (
        (limit[used] - at_point) / length for limit in (density.row_lower, density.row_upper)
    )
    noise, gradient = density.row_noise[used] / length, density.gradient[free] * scale
    box = [(bound[free] - point) / scale for bound in (density.lower, density.upper)]
    touched = (rows != 0).astype(float)
    _, group = connected_components((curvature != 0) | (touched.T @ touched > 0), directed=False)
    parts = []
    for one in range(group.max(initial=-1) + 1):
        own = np.flatnonzero(group == one)
        row = touched[:, own].any(axis=1)
        parts.append(
            _part(
                free[own],
                density.rank[free[own]],
                curvature[np.ix_(own, own)],
                gradient[own],
                [bound[own] for bound in box],
                rows[np.ix_(row, own)],
                [low[row], high[row]],
                noise[row],
            )
        )
    return parts


def _dense(matrix: Any) -> Array:
    """A matrix as an array; a vector is its diagonal."""
    if sp.issparse(matrix):
        return np.asarray(matrix.toarray())
    return np.diag(matrix) if matrix.ndim == 1 else np.asarray(matrix)


def _part(
    unknowns: Integers,
    rank: Integers,
    curvature: Array,
    gradient: Array,
    box: Sequence[Array],
    rows: Array,
    limits: Sequence[Array],
    noise: Array,
) -> _Part:
    """The coordinates of a part, and their normal density within the equalities."""
    covariance = np.linalg.inv(curvature)
    covariance = (covariance + covariance.T) / 2
    mean = -covariance @ gradient
    equal = limits[0] == limits[1]
    loose = equal & (noise > 0)
    least, most = (each.sum(axis=1) for each in _ends(rows, *box))
    lower, upper = _implied(rows[~loose], [limit[~loose] for limit in limits], *box)
    held = upper - lower <= _HELD
    exact = np.vstack([rows[equal], np.eye(len(mean))[held]])
    fixed = np.clip(0.0, lower, upper)
    value = np.append(limits[0][equal], fixed[held])
    spread = np.append(noise[equal], np.zeros(held.sum()))
    if len(exact):
        cross = covariance @ exact.T
        gain = cross @ np.linalg.pinv(exact @ cross, rcond=1e-12, hermitian=True)
        mean = mean + gain @ (value - exact @ mean)
        covariance = covariance - gain @ cross.T + (gain * spread**2) @ gain.T
    # Bounds of one value hold through the equalities; rounding must not put the value outside. Where
    # one unknown determines all, its bounds are those of all: counted twice they would be too narrow.
    idle = held.copy()
    if (~held).sum() - (equal & ~loose).sum() == 1:
        idle[:] = np.arange(len(mean)) != np.argmax(np.where(held, -1.0, np.diag(covariance)))
    lower, upper = np.where(idle, -np.inf, lower), np.where(idle, np.inf, upper)
    within = ~equal & (np.isfinite(limits[0]) | np.isfinite(limits[1]))
    seen = np.vstack([rows[loose], np.eye(len(mean)), rows[within]])
    lower = np.concatenate([least[loose], lower, limits[0][within]])
    upper = np.concatenate([most[loose], upper, limits[1][within]])
    n_stated = int(loose.sum())
    sums = np.zeros((int(equal.sum()), len(seen)))
    sums[:, n_stated : n_stated + len(mean)] = np.where(held, 0.0, rows[equal])
    sums[loose[equal], :n_stated] = -np.eye(n_stated)
    after = rank.max() + 1 + np.arange(len(seen) - n_stated - len(mean))
    return _Part(
        unknowns,
        np.concatenate([np.full(n_stated, -1), rank, after]),
        seen @ mean,
        seen @ covariance @ seen.T,
        lower,
        upper,
        np.array([limits[0][loose], noise[loose] ** 2]).T,
        sums,
        np.where(loose, 0.0, limits[0])[equal] - rows[equal] @ np.where(held, fixed, 0.0),
    )


def _ends(rows: Array, lower: Array, upper: Array) -> list[Array]:
    """The least and the largest value of each entry of rows times its coordinate."""
    with np.errstate(invalid="ignore"):
        ends = rows * lower, rows * upper
    return [np.where(rows != 0, end(*ends), 0.0) for end in (np.minimum, np.maximum)]


def _implied(
    rows: Array, limits: Sequence[Array], lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The bounds that the box and the limits of the rows leave each unknown."""
    for row, least, most in zip(rows, *limits, strict=True):
        used = np.flatnonzero(row)
        a = row[used]
        ends = a * lower[used], a * upper[used]
        low, high = np.minimum(*ends), np.maximum(*ends)
        with np.errstate(invalid="ignore"):
            # An infinite end leaves the others without a limit: inf - inf is no number.
            room = np.nan_to_num(
                most - (low.sum() - low), nan=np.inf, posinf=np.inf, neginf=-np.inf
            )
            need = np.nan_to_num(
                least - (high.sum() - high), nan=-np.inf, posinf=np.inf, neginf=-np.inf
            )
        ends = need / a, room / a
        lower, upper = lower.copy(), upper.copy()
        lower[used] = np.maximum(lower[used], np.minimum(*ends))
        upper[used] = np.minimum(upper[used], np.maximum(*ends))
    middle = 0.5 * (lower + upper)
    crossed = lower > upper  # by rounding
    return np.where(crossed, middle, lower), np.where(crossed, middle, upper)


def _pieces(part: _Part, number: int, seed: int) -> list[tuple[_Part, Array]]:
    """A part with the even points of its draws; one with a stated sum in slices of equal probability.

    Each slice has factors of its own: what the bounds do differs between the ends of a wide sum.
    """
    even = _even(number * (1 + bool(len(part.stated))), part.size, seed)
    if len(part.stated) != 1:
        return [(part, even)]
    (mean, variance), slices = part.stated[0], np.arange(_SLICES)
    s = np.sqrt(variance)
    below, above = (ndtr((end[0] - mean) / s) for end in (part.lower, part.upper))
    inner = mean + s * ndtri(below + (above - below) * slices[1:] / _SLICES)
    ends = np.concatenate([part.lower[:1], inner, part.upper[:1]])
    place = (even[:, 0] * _SLICES).astype(int)
    pieces = []
    for i in slices.tolist():
        own, lower, upper = even[place == i], part.lower.copy(), part.upper.copy()
        own[:, 0] = np.clip(own[:, 0] * _SLICES - i, 1e-9, 1 - 1e-9)
        lower[0], upper[0] = ends[i], ends[i + 1]
        pieces.append((replace(part, lower=lower, upper=upper), own))
    return pieces


def _drawn(parts: Sequence[_Part], even: Sequence[Array]) -> list[tuple[Array, Array]]:
    """Draws (number, size) of parts of one size, and their weights (number,)."""
    mean, covariance, lower, upper, stated, *sums = _side_by_side(parts)
    precision, shift = _factors(mean, covariance, lower, upper, stated)
    # Stated sums first, then what its bound changes most.
    free = np.isnan(stated[0])
    factors = np.where(free, precision, 0.0), np.where(free, shift, 0.0)
    cut = np.where(free, precision * np.einsum("knn->kn", covariance), np.inf)
    order = np.lexsort((np.array([part.rank for part in parts]), -cut.round(6)), axis=1)
    points = np.array(even)
    values, logs = _sequence(mean, covariance, factors, (lower, upper), stated, sums, order, points)
    drawn = []
    for part, own, log in zip(parts, values, logs, strict=True):
        if not np.isfinite(log).any():
            raise SolverError(
                "sampling cannot start, because no point inside the constraints was "
                "found; make the constraints wider"
            )
        drawn.append((own, _as_stated(log, own, part)))
    return drawn


def _side_by_side(parts: Sequence[_Part]) -> tuple[Array, ...]:
    """Mean, covariance, bounds, stated moments and sums of parts of one size."""
    names = ("mean", "covariance", "lower", "upper")
    mean, covariance, lower, upper = (np.array([getattr(p, n) for p in parts]) for n in names)
    stated = np.full((2, *mean.shape), np.nan)
    most = max(len(part.value) for part in parts)
    sums, value = np.zeros((len(parts), most, mean.shape[1])), np.zeros((len(parts), most))
    for i, part in enumerate(parts):
        rows, first = slice(len(part.value)), slice(len(part.stated))
        sums[i, rows], value[i, rows] = part.sums, part.value
        stated[:, i, first] = part.stated.T
    return mean, covariance, lower, upper, stated, sums, value


def _factors(
    mean: Array, covariance: Array, lower: Array, upper: Array, stated: Array
) -> tuple[Array, Array]:
    """Precision and shift of the normal factor that stands for each coordinate's bounds, (k, n) each.

    A stated sum gets the factor that leaves it its stated moments.
    """
    variance = np.einsum("knn->kn", covariance)
    moves = variance > 0
    unit = np.where(moves, variance, 1.0)
    is_stated = np.isfinite(stated[0])
    stated = np.where(is_stated, stated, np.array([mean, np.ones_like(mean)]))
    stated = np.array(truncated_moments(stated[0], stated[1], lower, upper))
    bounded = moves & (np.isfinite(lower) | np.isfinite(upper))
    precision, shift = np.zeros_like(mean), np.zeros_like(mean)
    centre, spread = mean, variance
    for _ in range(_ROUNDS):
        left = np.maximum(1 - precision * spread, 1e-9)
        without = np.where(moves, spread / left, 1.0)
        middle = (centre - shift * spread) / left
        least, most = (
            np.where(bounded, end, wall) for end, wall in ((lower, -np.inf), (upper, np.inf))
        )
        cut, cut_spread = truncated_moments(middle, without, least, most)
        cut, cut_spread = np.where(is_stated, stated, (cut, cut_spread))
        cut_spread = np.maximum(cut_spread, 1e-300)
        new = np.where(bounded, np.maximum(1 / cut_spread - 1 / without, 0.0), 0.0)
        moved = np.where(bounded, cut * (new + 1 / without) - middle / without, 0.0)
        change = np.abs(new - precision) * unit / (1 + np.abs(new) * unit)
        precision = precision + _STEP * (new - precision)
        shift = shift + _STEP * (moved - shift)
        centre, whole = _with_factors(mean, covariance, precision, shift)
        spread = np.maximum(np.einsum("knn->kn", whole), 0.0)
        if change.max() < _CHANGE:
            break
    return precision, shift


def _with_factors(
    mean: Array, covariance: Array, precision: Array, shift: Array
) -> tuple[Array, Array]:
    """Mean (k, n) and covariance (k, n, n) of normal densities times normal factors."""
    inner = np.eye(mean.shape[1]) + covariance * precision[:, np.newaxis, :]
    whole = np.linalg.solve(inner, covariance)
    whole = (whole + np.swapaxes(whole, 1, 2)) / 2
    move = whole @ (shift - precision * mean)[:, :, np.newaxis]
    return mean + move[:, :, 0], whole


def _sequence(
    mean: Array,
    covariance: Array,
    factors: tuple[Array, Array],
    bounds: tuple[Array, Array],
    stated: Array,
    sums: Sequence[Array],
    order: Integers,
    even: Array,
) -> tuple[Array, Array]:
    """Draw one coordinate after the other: values (k, number, n) and logarithms of their weights."""
    k, n = mean.shape
    each = np.arange(k)[:, np.newaxis]
    centre, spread = _with_factors(mean, covariance, *factors)
    spread = spread[each[:, :, np.newaxis], order[:, :, np.newaxis], order[:, np.newaxis]]
    means = np.repeat(centre[each, order][:, np.newaxis], even.shape[1], axis=1)
    lower, upper, precision, shift, known, known_spread = (
        v[each, order][:, np.newaxis] for v in (*bounds, *factors, *stated)
    )
    log, values = np.zeros(means.shape[:2]), np.empty_like(means)
    rows = np.take_along_axis(sums[0], order[:, np.newaxis], axis=2)
    left = np.repeat(sums[1][:, np.newaxis], even.shape[1], axis=1)  # of each sum, for what follows
    limits = _sums_of_rest(rows, lower, upper)
    for i in range(n):
        t, h, m, v = precision[:, :, i], shift[:, :, i], means[:, :, i], spread[:, i, i, np.newaxis]
        # The coordinate's own factor is taken off: its bound itself takes the place.
        column = spread[:, i:, i] / (1 - t * v)
        means[:, :, i:] += (t * m - h)[:, :, np.newaxis] * column[:, np.newaxis]
        spread[:, i:, i:] += t[:, :, np.newaxis] * (
            column[:, :, np.newaxis] * spread[:, i, np.newaxis, i:]
        )
        m, v = means[:, :, i].copy(), spread[:, i, i, np.newaxis].copy()
        least, most = lower[:, :, i], upper[:, :, i]
        beyond = np.maximum(least - m, m - most) > _ROUNDING
        moves, is_stated = v > _DETERMINED, np.isfinite(known[:, :, i])
        for r in range(rows.shape[1]):  # what the sums leave
            a = rows[:, r, i, np.newaxis]
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = [(left[:, :, r] - rest[:, r, i, np.newaxis]) / a for rest in limits]
            least = np.where(a != 0, np.maximum(least, np.minimum(*ends)), least)
            most = np.where(a != 0, np.maximum(np.minimum(most, np.maximum(*ends)), least), most)
            moves = moves & ((a == 0) | (rows[:, r, i + 1 :] != 0).any(axis=1, keepdims=True))
        at = np.where(is_stated, known[:, :, i], m)
        s = np.sqrt(np.where(is_stated, known_spread[:, :, i], np.where(moves, v, 1.0)))
        low, high = (least - at) / s, (most - at) / s
        x, inside = quantile_and_mass(low, high, even[:, :, i])
        x = at + s * x
        x = np.clip(np.where(moves, x, m), least, most)
        mass = np.where(moves, inside, np.where(beyond, -np.inf, 0.0))
        v = np.where(moves, v, 0.0)
        of_factor = -0.5 * np.log1p(t * v) + (h * m + 0.5 * h**2 * v - 0.5 * t * m**2) / (1 + t * v)
        log += np.where(is_stated, 0.0, mass - of_factor)
        column = spread[:, i:, i] * np.divide(1.0, v, out=np.zeros_like(v), where=moves)
        means[:, :, i:] += (x - m)[:, :, np.newaxis] * column[:, np.newaxis]
        spread[:, i:, i:] -= column[:, :, np.newaxis] * spread[:, i, np.newaxis, i:]
        left -= x[:, :, np.newaxis] * rows[:, np.newaxis, :, i]
        values[:, :, i] = x
    back = np.argsort(order, axis=1)
    return np.take_along_axis(values, back[:, np.newaxis], axis=2), log


def _sums_of_rest(rows: Array, lower: Array, upper: Array) -> list[Array]:
    """The least and most that the coordinates after each add to each sum, (k, n_sums, n) each."""
    both = []
    for own in _ends(rows, lower, upper):
        rest = np.cumsum(own[:, :, ::-1], axis=2)[:, :, ::-1]
        both.append(np.concatenate([rest[:, :, 1:], np.zeros_like(rest[:, :, :1])], axis=2))
    return both


def _as_stated(log: Array, values: Array, part: _Part) -> Array:
    """Weights with which each stated sum has its stated distribution, 1 in sum."""
    weight = np.exp(log - log.max())
    n = len(weight) // _PER_STEP
    for r, (mean, variance) in enumerate(part.stated):
        s = np.sqrt(variance)
        below, above = (ndtr((end - mean) / s) for end in (part.lower[r], part.upper[r]))
        share = (ndtr((values[:, r] - mean) / s) - below) / max(above - below, 1e-300)
        place = np.clip((share * n).astype(int), 0, n - 1)
        total = np.bincount(place, weight, minlength=n)[place]
        weight = np.divide(weight, total, out=np.zeros_like(weight), where=total > 0)
    return np.asarray(weight / weight.sum())


def _marginals(values: Array, weight: Array, part: _Part) -> Array:
    """Quantiles of each unknown at `NORMAL`, (n_unknowns, 201)."""
    first = len(part.stated)
    mean, covariance = part.mean[np.newaxis], part.covariance
    if first:  # given the stated sums of each draw
        gain = covariance[:, :first] / part.stated[:, 1]
        mean = mean + (values[:, :first] - part.stated[:, 0]) @ gain.T
        covariance = covariance - gain @ covariance[:first]
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.sqrt(np.maximum(np.diag(part.covariance), 0.0))
    gap = np.minimum(values - part.lower, part.upper - values).min(axis=0)
    out = np.empty((len(part.unknowns), len(NORMAL)))
    for row, i in zip(out, range(first, part.size), strict=False):
        if spread[i] <= _HELD:
            row[:] = _weighted_quantiles(values[:, i], weight, ndtr(NORMAL))
            continue
        # Along this line the normal density is that of the unknown alone: what stays as it is does not
        # depend on it.
        slope = covariance[:, i] / spread[i] ** 2
        # A bound that is farther than the density reaches counts for nothing.
        reach = np.abs(slope) * (np.abs(values[:, i] - mean[:, i]).max() + _REACH * spread[i])
        used = (np.abs(slope) * spread[i] > 1e-9 * unit) & (gap < reach)
        at, slope = values[:, used], slope[used]
        ends = (part.lower[used] - at) / slope, (part.upper[used] - at) / slope
        low = np.minimum(np.minimum(*ends).max(axis=1, initial=-np.inf), 0.0) + values[:, i]
        high = np.maximum(np.maximum(*ends).min(axis=1, initial=np.inf), 0.0) + values[:, i]
        m, s = mean[:, i], spread[i]
        turned = (
            -1 if weight @ values[:, i] > m[0] else 1
        )  # to the side where tails keep all digits
        ends = turned * (low - m) / s, turned * (high - m) / s
        if len(m) > 1 or np.maximum(*ends).min() < -FAR:
            row[:] = _mixture_of_several(m, s, low, high, values[:, i], weight)
        else:
            alike = _mixture(np.minimum(*ends), np.maximum(*ends), weight)[::turned]
            row[:] = m + turned * s * alike
    return out


def _weighted_quantiles(values: Array, weight: Array, levels: Array) -> Array:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return np.interp(levels, (total - 0.5 * weight[order]) / total[-1], values[order])


def _mixture_of_several(
    mean: Array, spread: float, lower: Array, upper: Array, values: Array, weight: Array
) -> Array:
    """Quantiles at `NORMAL` of a mixture of normal distributions (mean, spread), each cut."""
    from scipy.interpolate import PchipInterpolator

    points = _weighted_quantiles(values, weight, _POINTS)
    peak = np.clip(mean, lower, upper)
    ends = [
        f(end, peak + sign * _REACH * spread)
        for f, end, sign in ((np.maximum, lower, -1), (np.minimum, upper, 1))
    ]
    ends = [ends[0].min(), ends[1].max()]
    points = np.unique(np.concatenate([ends, points]))
    a, b = (lower - mean) / spread, (upper - mean) / spread
    turned = np.where(a > -b, -1.0, 1.0)  # to the lower side, where the tail keeps all digits
    a, b = np.minimum(turned * a, turned * b), np.maximum(turned * a, turned * b)
    x = np.multiply.outer(points, turned / spread) - turned * mean / spread
    np.clip(x, a, b, out=x)
    of_a, of_b, far = ndtr(a), ndtr(b), b < -FAR
    of_x = ndtr(x, out=x) if not far.any() else np.where(far, x, ndtr(x))
    if far.any():
        top = log_ndtr(b[far])
        of_a[far], of_b[far] = np.exp(log_ndtr(a[far]) - top), 1.0
        of_x[:, far] = np.exp(log_ndtr(x[:, far]) - top)
    rate = turned * weight / np.maximum(of_b - of_a, 1e-300)
    total = of_x @ rate - of_a @ rate + weight[turned < 0].sum()
    # The normal quantile of the distribution function is about linear in the value.
    z = ndtri(np.clip(total / total[-1], *ndtr([-5.5, 5.5])))
    kept = np.append(np.flatnonzero(np.diff(z) > 1e-9), len(z) - 1)
    return np.asarray(PchipInterpolator(z[kept], points[kept])(NORMAL))


def _mixture(lower: Array, upper: Array, weight: Array) -> Array:
    """Quantiles at `NORMAL` of a mixture of standard normal distributions, each cut to an interval.

    In the normal distribution function each of them is uniform, and so the mixture piecewise so.
    """
    a, b = ndtr(lower), ndtr(upper)
    b = np.maximum(b, a + 1e-9 * (b.max() - a.min()))
    rate = weight / (b - a)
    ends = np.concatenate([a, b])
    order = np.argsort(ends)
    ends = ends[order]
    slope = np.cumsum(np.concatenate([rate, -rate])[order])
    total = np.append(0.0, np.cumsum(np.maximum(slope[:-1], 0.0) * np.diff(ends)))
    return np.asarray(ndtri(np.interp(ndtr(NORMAL), total / total[-1], ends)))


@lru_cache(maxsize=16)
def _even(number: int, size: int, seed: int) -> Array:
    """Read-only points (number, size) between 0 and 1 that fill space evenly (Sobol, scrambled)."""
    from scipy.stats import qmc

    points = qmc.Sobol(size, seed=np.random.default_rng(seed)).random(number)
    return read_only(np.clip(points, 1e-12, 1 - 1e-12))
