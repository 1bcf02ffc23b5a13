"""Samples of a normal density within bounds, linear equalities and linear inequalities.

The equalities hold in coordinates of their null space. A chain moves along one line after the other,
each time to a sample of the truncated normal density on that line (hit-and-run; Smith 1984, Chen &
Schmeiser 1993). No move is rejected. The directions are the axes of coordinates in which the density
is about isotropic, rotated at random for every sweep.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.support.errors import ModelError, SolverError
from rtcal.support.types import Array, read_only

Integers = NDArray[np.intp]

_CHAINS = 128
_WARM_UP = 32
"""Sweeps before the first sample. The slowest of 60 random rooms forgets its start in eight."""
_SWEEPS = 3
"""Sweeps per sample: in the slowest of those rooms, three samples are worth one independent sample."""
_LARGEST = 2_000
"""Largest number of unknowns; a sweep's cost rises with its square."""
_TIGHT = 1e-6
"""Range in standard deviations below which an inequality counts as an equality.
It is ten times the tolerance of the linear program that computes the range."""
_UNREACHED = 100.0
"""Distance in standard deviations beyond which walls are ignored. The mass of a log-concave density
beyond it is at most exp(-49), even if the standard deviation is underestimated twofold."""
_DRAWS = 8
"""Number of plain draws per sample, before a chain is asked."""
_DRAWS_WITHIN = 100_000
"""Number of draws of `probability_within`."""
_EXACT = 1e-12
"""Standard deviation up to which an unknown is known."""
_LEAST = 1e-300
"""Positive number in place of a distance of 0, to avoid divisions by 0."""
_FAR = 25.0
"""Normal tails that begin beyond this use an asymptotic expansion; its error is 1 / _FAR⁴ = 3e-6."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointTruncatedNormal:
    """A normal density within bounds, linear equalities and linear inequalities.

    The density of u is proportional to exp(-g'(u - p) - ½ (u - p)'H(u - p)).

    Attributes
    ----------
    point : array (size,)
        p, where the equalities hold.
    gradient : array (size,)
        g.
    curvature : array (size,) or sparse array (size, size)
        H; its diagonal if H is diagonal.
    scale : array (size,)
        The scale of each unknown; 0 for a fixed one.
    lower, upper : array (size,)
        The bounds.
    matrix : array or sparse array (n_rows, size)
    row_lower, row_upper : array (n_rows,)
        Limits of ``matrix @ u``; equal for an equality.
    """

    point: Array
    gradient: Array
    curvature: Any
    scale: Array
    lower: Array
    upper: Array
    matrix: Any
    row_lower: Array
    row_upper: Array


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of all unknowns.

    ``values`` (n_samples, size); ``effective`` (size,), the number of independent samples with the
    same standard error of the mean.
    """

    values: Array
    effective: Array


@dataclass(frozen=True, eq=False)
class _Region:
    """Unknowns u = centre + basis w, with w standard normal where walls w + offset >= 0.

    The rows of ``walls`` have unit length.
    """

    centre: Array
    basis: Array
    walls: Array
    offset: Array


def sample(density: JointTruncatedNormal, n_samples: int, seed: int) -> Samples:
    """Return samples of a truncated normal density.

    Parameters
    ----------
    density : TruncatedNormal
    n_samples : int
    seed : int

    Raises
    ------
    ModelError
        With more than 2,000 unknowns.
    SolverError
        If the linear program that looks for a point inside the constraints fails.
    """
    free = np.flatnonzero(density.scale > 0)
    if len(free) > _LARGEST:
        raise ModelError(f"{len(free)} unknowns are too many to sample; at most {_LARGEST}")
    draws = -(-n_samples // _CHAINS)
    region, inside = _region(density, free)
    w = _chains(region, inside, draws, np.random.default_rng(seed))
    values = np.moveaxis(region.basis @ w, 1, 2) + region.centre
    out = np.tile(density.point, (draws * _CHAINS, 1))
    out[:, free] = values.reshape(-1, len(free))
    effective = np.full(len(density.point), float(n_samples))
    effective[free] = _effective(values) * n_samples / len(out)
    # Rounding may leave a sample beyond its bound.
    return Samples(np.clip(out, density.lower, density.upper)[:n_samples], effective)


def samples_of_normal(
    mean: Array,
    covariance: Array,
    bounds: tuple[Array, Array],
    inside: Array,
    number: int,
    seed: int,
) -> Array:
    """Return samples of a normal distribution within bounds, (number, size).

    Draws that keep the bounds; those of `sample` where few do.

    Parameters
    ----------
    mean, covariance : array (size,), (size, size)
        Without the bounds.
    bounds : (lower, upper)
        (size,) each.
    inside : array (size,)
        A probable point within them, from which `sample` starts.
    number, seed : int
    """
    lower, upper = bounds
    value, vector = np.linalg.eigh(covariance)
    # The symmetric root: it depends on the covariance alone, and not on the eigenvectors' signs, so
    # that another processor's rounding draws the same samples.
    root = (vector * np.sqrt(np.maximum(value, 0))) @ vector.T
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    for multiple in (2, _DRAWS):  # most often the first are enough
        even = _even_normal(multiple * number, len(mean), seed)
        drawn = mean + np.where(sigma > _EXACT, even @ root, 0.0)
        kept = ((drawn >= lower) & (drawn <= upper)).all(axis=1)
        if kept.sum() >= number:
            return np.asarray(drawn[kept][:number])
    scale = np.where(sigma > _EXACT, sigma, 0.0)
    free = np.flatnonzero(scale)
    inverse = np.linalg.inv(covariance[np.ix_(free, free)])
    curvature = np.zeros_like(covariance)
    curvature[np.ix_(free, free)] = (inverse + inverse.T) / 2
    point = np.clip(inside, lower, upper)
    density = JointTruncatedNormal(
        point=point,
        gradient=curvature @ (point - mean),
        curvature=sp.csr_array(curvature),
        scale=scale,
        lower=lower,
        upper=upper,
        matrix=np.zeros((0, len(mean))),
        row_lower=np.zeros(0),
        row_upper=np.zeros(0),
    )
    return sample(density, number, seed).values


@lru_cache(maxsize=24)  # a search for a design draws in the same bands a hundred times
def _even_normal(number: int, size: int, seed: int) -> Array:
    """Return standard normal numbers (number, size) that fill space evenly (Sobol 1967, scrambled).

    A mean of some thousand has a fraction of the noise that random numbers give it. Read-only.
    """
    from scipy.special import ndtri
    from scipy.stats import qmc

    bits = (number - 1).bit_length()
    even = qmc.Sobol(size, seed=np.random.default_rng(seed)).random_base2(bits)[:number]
    return read_only(ndtri(np.clip(even, 1e-12, 1 - 1e-12)))


def _effective(values: Array) -> Array:
    """Effective sample sizes from the scatter of the chains' means; values (draws, chains, n)."""
    draws, chains, _ = values.shape
    variance = values.reshape(draws * chains, -1).var(axis=0)
    of_means = values.mean(axis=0).var(axis=0, ddof=1)
    effective = np.full(len(variance), float(draws * chains))
    np.divide(chains * variance, of_means, out=effective, where=of_means > 0)
    return effective


def _region(density: JointTruncatedNormal, free: Integers) -> tuple[_Region, Array]:
    """Return the region of the free unknowns, and the coordinates of a point inside it.

    Coordinates are relative to the density's point, in units of its scale.
    """
    scale = density.scale[free]
    rows = sp.csr_array(density.matrix)[:, free].toarray() * scale
    at_point = sp.csr_array(density.matrix) @ density.point
    equal = density.row_lower == density.row_upper
    one_each = np.eye(len(free))
    normals = np.vstack([one_each, -one_each, rows[~equal], -rows[~equal]])
    gaps = np.concatenate(
        [
            (density.point - density.lower)[free] / scale,
            (density.upper - density.point)[free] / scale,
            (at_point - density.row_lower)[~equal],
            (density.row_upper - at_point)[~equal],
        ]
    )
    normals, gaps = normals[np.isfinite(gaps)], gaps[np.isfinite(gaps)]
    equalities, wanted = rows[equal], np.zeros(int(equal.sum()))
    while True:
        centre, basis = _coordinates(density, free, equalities, wanted)
        walls, offset = normals @ basis, normals @ centre + gaps
        length = np.linalg.norm(walls, axis=1)
        used = np.flatnonzero(length > 1e-12 * np.linalg.norm(normals, axis=1))
        walls, offset = walls[used] / length[used, np.newaxis], offset[used] / length[used]
        inside, room, tight = _inside(walls, offset)
        if room > _TIGHT:
            centre, basis = density.point[free] + scale * centre, scale[:, np.newaxis] * basis
            return _Region(centre, basis, walls, offset), inside
        equalities = np.vstack([equalities, normals[used[tight]]])
        wanted = np.append(wanted, -gaps[used[tight]])


def _coordinates(
    density: JointTruncatedNormal, free: Integers, equalities: Array, wanted: Array
) -> tuple[Array, Array]:
    """Return c and B such that c + B w, w standard normal, has the density on the equalities.

    c is the mode without inequalities: one Newton step within the equalities.
    """
    from scipy.linalg import cholesky, null_space, solve_triangular

    scale = density.scale[free]
    if sp.issparse(density.curvature):
        curvature = density.curvature[free][:, free].toarray() * np.outer(scale, scale)
    else:
        curvature = np.diag(density.curvature[free] * scale**2)
    within, start = np.eye(len(free)), np.zeros(len(free))
    if len(equalities):
        within = null_space(equalities)
        start = np.asarray(np.linalg.pinv(equalities) @ wanted)
    factor = cholesky(within.T @ curvature @ within, lower=True)
    basis = within @ solve_triangular(factor, np.eye(len(factor)), lower=True).T
    gradient = density.gradient[free] * scale + curvature @ start
    return start - basis @ (basis.T @ gradient), basis


def _inside(walls: Array, offset: Array) -> tuple[Array, float, Integers]:
    """Return an interior point, its distance to the walls (at most 1), and the walls without interior.

    The point is the centre of the largest ball. If its radius is 0, walls with a multiplier hold with
    equality everywhere.
    """
    from scipy.optimize import linprog

    m, d = walls.shape
    if not m * d:
        return np.zeros(d), 1.0, np.zeros(0, dtype=np.intp)
    ball = linprog(
        np.append(np.zeros(d), -1.0),
        A_ub=np.hstack([-walls, np.ones((m, 1))]),
        b_ub=offset,
        bounds=[(None, None)] * d + [(None, 1.0)],
        method="highs",
    )
    if ball.status != 0:
        raise SolverError(
            f"no point inside the constraints was found to sample from: {ball.message}"
        )
    tight = np.flatnonzero(ball.ineqlin.marginals < -1e-6)
    return ball.x[:d], float(ball.x[d]), tight


def _chains(region: _Region, inside: Array, draws: int, rng: np.random.Generator) -> Array:
    """Coordinates of the chains, (draws, dimensions, chains)."""
    from scipy.linalg import cholesky, solve_triangular

    middle, hessian = _middle(region, inside)
    d = len(middle)
    axes = solve_triangular(cholesky(hessian, lower=True), np.eye(d), lower=True).T
    distance = region.walls @ middle + region.offset
    near = distance < _UNREACHED * np.linalg.norm(region.walls @ axes, axis=1)
    walls, offset = region.walls[near], region.offset[near]
    w = np.tile(middle[:, np.newaxis], _CHAINS)
    kept = np.empty((draws, d, _CHAINS))
    for sweep in range(1 - _WARM_UP, draws * _SWEEPS + 1):
        turned = axes @ np.linalg.qr(rng.standard_normal((d, d)))[0]
        w = _sweep(w, walls, offset, turned, rng.random((d, _CHAINS)))
        if sweep > 0 and sweep % _SWEEPS == 0:
            kept[sweep // _SWEEPS - 1] = w
    return kept


def _middle(region: _Region, inside: Array) -> tuple[Array, Array]:
    """Return the minimum of |w|²/2 - sum log(walls w + offset), by Newton's method, and its Hessian.

    Near a wall that cuts the density far from its mode, the distance of this point from the wall is the
    mean distance of the density, and the curvature is the inverse of its variance. So the Hessian has
    the scales and directions of the truncated density, which the normal density's would overestimate.
    """

    def value(w: Array) -> float:
        distance = region.walls @ w + region.offset
        return (
            0.5 * float(w @ w) - float(np.log(distance).sum()) if (distance > 0).all() else np.inf
        )

    w = inside
    for _ in range(100):
        distance = region.walls @ w + region.offset
        gradient = w - region.walls.T @ (1 / distance)
        scaled = region.walls / distance[:, np.newaxis]
        hessian = np.eye(len(w)) + scaled.T @ scaled
        step = -np.linalg.solve(hessian, gradient)
        decrease = -float(gradient @ step)
        if decrease < 0.01:
            break
        while value(w + step) > value(w) + 0.1 * float(gradient @ step):
            step = step / 2
        w = w + step
    return w, hessian


def _sweep(w: Array, walls: Array, offset: Array, directions: Array, uniform: Array) -> Array:
    """Move every chain (dimensions, chains) once along each direction, the columns of (d, d)."""
    slopes = walls @ directions
    distance = np.maximum(walls @ w + offset[:, np.newaxis], _LEAST)
    along, gram = directions.T @ w, directions.T @ directions
    steps = np.empty_like(along)
    for k, slope in enumerate(slopes.T):
        # The nearest walls on both sides are those with the extreme slopes per distance.
        nearness = slope[:, np.newaxis] / distance
        low = -1 / np.max(nearness, axis=0, initial=_LEAST)
        high = -1 / np.min(nearness, axis=0, initial=-_LEAST)
        sigma = 1 / np.sqrt(gram[k, k])
        mean = -along[k] * sigma**2
        drawn = mean + sigma * truncated_normal(
            (low - mean) / sigma, (high - mean) / sigma, uniform[k]
        )
        steps[k] = np.clip(drawn, low, high)
        distance += np.outer(slope, steps[k])
        np.maximum(distance, _LEAST, out=distance)
        along += np.outer(gram[:, k], steps[k])
    return w + directions @ steps


def truncated_normal(lower: Array, upper: Array, uniform: Array) -> Array:
    """Return the quantiles ``uniform`` of the standard normal distribution cut to [lower, upper]."""
    from scipy.special import ndtr, ndtri

    # The interval is mirrored to the upper side, where the tails keep all digits.
    turned = upper < -lower
    a, b = np.where(turned, -upper, lower), np.where(turned, -lower, upper)
    near = np.minimum(a, _FAR)
    top, bottom = ndtr(-near), ndtr(-np.maximum(b, near))
    x = -ndtri(top + np.where(turned, 1 - uniform, uniform) * (bottom - top))
    far = a > _FAR
    if far.any():
        x[far] = _tail(a[far], b[far], np.where(turned, 1 - uniform, uniform)[far])
    return np.asarray(np.where(turned, -x, x))


def _tail(a: Array, b: Array, uniform: Array) -> Array:
    """Quantiles of the normal distribution cut to [a, b] with a far above 0.

    An exponential distribution is the first guess; one Newton step on the tail's logarithm follows.
    """
    from scipy.special import erfcx

    def log_tail(t: Array) -> Array:
        """Log of the tail beyond a + t over that beyond a."""
        with np.errstate(divide="ignore", over="ignore"):
            ratio = erfcx((a + t) / np.sqrt(2)) / erfcx(a / np.sqrt(2))
            return np.asarray(np.log(ratio) - t * (a + t / 2))

    wanted = np.log1p(uniform * np.expm1(log_tail(b - a)))
    t = -wanted / a
    mills = np.sqrt(np.pi / 2) * erfcx((a + t) / np.sqrt(2))
    return np.asarray(a + t + (log_tail(t) - wanted) * mills)


def probability_within(below: Array, above: Array, correlation: Array) -> float:
    """Return the probability that standard normal errors are all within limits, (n,) each.

    Of 100,000 draws: its error is at most 0.0016.

    Examples
    --------
    >>> limit = np.full(2, 1.645)
    >>> round(probability_within(-limit, limit, np.eye(2)), 2)
    0.81
    """
    root = np.linalg.cholesky(correlation)
    drawn = np.random.default_rng(0).standard_normal((_DRAWS_WITHIN, len(root))) @ root.T
    return float(((drawn >= below) & (drawn <= above)).all(axis=1).mean())
