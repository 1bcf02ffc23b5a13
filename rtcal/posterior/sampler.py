"""Samples of a normal distribution within linear equalities and inequalities.

Exact Hamiltonian Monte Carlo (Pakman & Paninski 2014): in whitened coordinates a particle moves on
ellipses in closed form and bounces off the constraints; no step size, no rejection.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.errors import ModelError, SolverError
from rtcal.posterior.density import TruncatedNormal
from rtcal.support.types import Array

Integers = NDArray[np.intp]

_CHAINS = 32
_TRAVEL = np.pi / 2
_WARM_UP = 30
_BOUNCES = 20_000
_LARGEST = 2_000
_MIXED = 1.05
"""Between-chain over within-chain spread (Gelman & Rubin 1992) up to which samples are returned."""


def sample(density: TruncatedNormal, n_samples: int, seed: int) -> Array:
    """Return samples of a truncated normal density, (n_samples, size).

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
        If the chains disagree: the samples would not be trustworthy.
    """
    free = np.flatnonzero(density.scale > 0)
    if len(free) > _LARGEST:
        raise ModelError(f"{len(free)} unknowns are too many to sample; at most {_LARGEST}")
    rng = np.random.default_rng(seed)
    basis, centre = _coordinates(density, free)
    walls, offset = _walls(density, free, basis, centre)
    draws = max(2 * int(np.ceil(n_samples / _CHAINS / 2)), 60)
    w = np.tile(_interior(walls, offset)[:, np.newaxis], _CHAINS)
    kept = np.empty((draws, basis.shape[1], _CHAINS))
    for draw in range(-_WARM_UP, draws):
        w = _trajectory(w, rng.standard_normal(w.shape), walls, offset)
        if draw >= 0:
            kept[draw] = w
    values = np.einsum("ij,djc->dci", basis, kept)
    _check_mixing(values)
    out = np.tile(density.point, (draws * _CHAINS, 1))
    out[:, free] = values.reshape(-1, len(free)) + centre
    return out[:n_samples]


def _coordinates(density: TruncatedNormal, free: Integers) -> tuple[Array, Array]:
    """Basis B and centre c: the free unknowns are c + B w with w standard normal."""
    from scipy.linalg import cholesky, null_space, solve_triangular

    scale = density.scale[free]
    curvature = density.curvature
    if sp.issparse(curvature):
        own = curvature[free][:, free].toarray() * np.outer(scale, scale)
    else:
        own = np.diag(curvature[free] * scale**2)
    equal = density.row_lower == density.row_upper
    rows = sp.csr_array(density.matrix)[equal][:, free].toarray() * scale
    rows = rows[np.abs(rows).max(axis=1, initial=0.0) > 0]
    within = null_space(rows) if len(rows) else np.eye(len(free))
    factor = cholesky(within.T @ own @ within, lower=True)
    basis = within @ solve_triangular(factor, np.eye(factor.shape[0]), lower=True).T
    # The mode without inequalities: one Newton step within the equalities.
    step = basis @ (basis.T @ (density.gradient[free] * scale))
    return scale[:, np.newaxis] * basis, density.point[free] - scale * step


def _walls(
    density: TruncatedNormal, free: Integers, basis: Array, centre: Array
) -> tuple[Array, Array]:
    """F and g of F w + g >= 0, the rows of F of unit length."""
    unequal = density.row_lower < density.row_upper
    rows = sp.csr_array(density.matrix)[unequal][:, free].toarray()
    fixed = sp.csr_array(density.matrix)[unequal] @ np.where(density.scale > 0, 0.0, density.point)
    normals = np.vstack([basis, -basis, rows @ basis, -rows @ basis])
    at = rows @ centre + fixed
    gaps = np.concatenate(
        [
            centre - density.lower[free],
            density.upper[free] - centre,
            at - density.row_lower[unequal],
            density.row_upper[unequal] - at,
        ]
    )
    length = np.linalg.norm(normals, axis=1)
    used = np.isfinite(gaps) & (length > 1e-14)
    return normals[used] / length[used, np.newaxis], gaps[used] / length[used]


def _interior(walls: Array, offset: Array) -> Array:
    """A point well inside: the centre of the largest ball, its radius capped at 1."""
    from scipy.optimize import linprog

    m, d = walls.shape
    found = linprog(
        np.append(np.zeros(d), -1.0),
        A_ub=np.hstack([-walls, np.ones((m, 1))]),
        b_ub=offset,
        bounds=[(-50.0, 50.0)] * d + [(None, 1.0)],
        method="highs",
    )
    if found.status != 0 or found.x[-1] <= 0:
        raise SolverError("the constraints leave no room to sample in: some of them are equalities")
    return np.asarray(found.x[:-1])


def _trajectory(w: Array, v: Array, walls: Array, offset: Array) -> Array:
    """Move every chain (dimensions, chains) for the same time, bouncing off the walls."""
    left = np.full(w.shape[1], _TRAVEL)
    last = np.full(w.shape[1], -1)
    for _ in range(_BOUNCES):
        a, b = walls @ w, walls @ v
        radius = np.hypot(a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            # a cos t + b sin t = -g, at its later root: the way out.
            reached = np.arccos(np.clip(-offset[:, np.newaxis] / radius, -1, 1))
            time = np.arctan2(b, a) + reached
        time = np.mod(time, 2 * np.pi)
        # The wall just bounced off is met again only after a whole sweep of its far side.
        own = np.arange(len(last))
        here = last >= 0
        near = time[last[here], own[here]]
        time[last[here], own[here]] = np.where(
            np.minimum(near, 2 * np.pi - near) < 1e-9, np.inf, near
        )
        time = np.where(radius > offset[:, np.newaxis], time, np.inf)
        hit = np.argmin(time, axis=0)
        until = np.minimum(time[hit, own], left)
        bounce = time[hit, own] < left
        w, v = w * np.cos(until) + v * np.sin(until), v * np.cos(until) - w * np.sin(until)
        left = left - until
        if not bounce.any():
            return w
        normal = walls[hit].T
        v = np.where(bounce, v - 2 * np.sum(normal * v, axis=0) * normal, v)
        last = np.where(bounce, hit, -1)
    raise SolverError("the sampler was caught between two constraints that nearly touch")


def _check_mixing(values: Array) -> None:
    """Raise SolverError unless the chains (draws, chains, unknowns) agree."""
    draws = len(values)
    halves = np.concatenate([values[: draws // 2], values[draws // 2 :]], axis=1)
    within = halves.var(axis=0, ddof=1).mean(axis=0)
    between = halves.mean(axis=0).var(axis=0, ddof=1)
    moves = within > 0
    ratio = np.sqrt((within[moves] * (1 - 2 / draws) + between[moves]) / within[moves])
    if np.max(ratio, initial=1.0) > _MIXED:
        raise SolverError(
            f"the sampler's chains disagree by a factor of {np.max(ratio):.2f}; ask for more samples"
        )
