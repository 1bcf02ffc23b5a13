"""Polishing: from a solver's answer to the exact optimum on its active set.

An interior-point answer has errors up to 1e-5, but shows reliably which coefficients are at a
bound. With this active set the optimum is the solution of one linear system. The loop solves the
system, adds violated bounds to the active set, and drops bounds whose multiplier has the wrong
sign. When there is nothing to add or to drop, the answer is exact to rounding. For a piecewise
quadratic objective the loop is Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.calibration.problem_data import Flags
from rtcal.support import kkt
from rtcal.support.errors import SolverError
from rtcal.support.types import Array

_ROUNDS = 60
_ROUNDING = 1e-13
_AT_BOUND = 8 * np.finfo(float).eps
"""Distance beyond a bound that counts as none: a coefficient whose optimum is its bound passes it by
the rounding error of the rows."""
_UNBALANCED = 1e3
"""Imbalance of a free unknown, in units of its rounding error, up to which it counts as balanced."""
_PATIENCE = 8
"""Largest number of rounds without progress; then the certificate judges the answer reached."""


@dataclass(frozen=True)
class Polished:
    """A polished answer, flattened: alpha, its multipliers, and -1, 0, 1 for lower, free, upper."""

    alpha: Array
    multipliers: Multipliers
    active: NDArray[np.int8]


def polish_answer(
    model: NumpyModel,
    alpha: Array,
    multipliers: Multipliers,
    forced_lower: Flags,
    forced_upper: Flags,
) -> Polished | None:
    """Return the optimum near a solver's answer, or None if the active set does not converge.

    Parameters
    ----------
    model : NumpyModel
    alpha : array (size,)
        The solver's answer, flattened.
    multipliers : Multipliers
        The solver's multipliers.
    forced_lower, forced_upper : array (size,) of bool
        Coefficients that a target at the end of its reach forces to a bound.
    """
    lower, upper, sigma = model.lower, model.upper, model.sigma
    # At an optimum either a slack or its multiplier is 0: in whitened units, the smaller one.
    reciprocal = model.data.inverse_sigma
    at_lower = model.movable & (multipliers.lower * sigma > (alpha - lower) * reciprocal)
    at_upper = model.movable & (multipliers.upper * sigma > (upper - alpha) * reciprocal)
    at_lower = (at_lower & ~forced_upper) | forced_lower
    at_upper = (at_upper & ~at_lower) | forced_upper
    fixed_row = model.row_lower == model.row_upper
    side = np.where(fixed_row, 1, np.sign(active_rows(model, alpha, multipliers.rows)))
    alpha = np.where(model.movable, alpha, model.data.centre)
    # Where one step reaches the optimum from anywhere, it begins at the prior: then the answer depends
    # on the active set alone, to the last bit, and not on the solver or on its start.
    start = model.data.centre if model.has_closed_form else None
    alpha = alpha if start is None else start
    worst, patience = np.inf, _PATIENCE
    for _ in range(_ROUNDS):
        alpha = np.where(at_lower, lower, np.where(at_upper, upper, alpha))
        free = model.movable & ~at_lower & ~at_upper
        limit = np.where(side < 0, model.row_lower, model.row_upper)
        solved = _solve(model, alpha, free, side != 0, limit)
        if solved is None:
            return None
        trial, rows, moving = solved
        nearest = np.minimum(np.maximum(trial, lower), upper)
        trial = np.where(free & (np.abs(trial - nearest) <= _AT_BOUND), nearest, trial)
        below, above = free & (trial < lower), free & (trial > upper)
        at_rows = np.asarray(model.matrix @ trial)
        slack = _ROUNDING * np.maximum(model.row_norm, 1e-300)
        row_below = (side == 0) & (at_rows < model.row_lower - slack)
        row_above = (side == 0) & (at_rows > model.row_upper + slack)
        if (below | above).any() or (row_below | row_above).any():
            at_lower, at_upper = at_lower | below, at_upper | above
            side = np.where(row_below, -1, np.where(row_above, 1, side))
            alpha = nearest if start is None else start
            continue
        without_free = (side != 0) & ~moving & (model.row_norm > 0)
        if without_free.any():
            release = _released(model, trial, limit, without_free, slack, at_lower, at_upper)
            if release.any():
                at_lower, at_upper = at_lower & ~release, at_upper & ~release
                alpha = trial if start is None else start
                continue
            rows = undetermined(model, trial, rows, without_free, at_lower, at_upper)
        gradient = model.gradient(trial)
        force = np.asarray(gradient + model.matrix.T @ rows)
        balance = force * sigma
        tolerance = _ROUNDING * model.steepness(trial, gradient)
        free_lower = at_lower & (balance < -tolerance)
        free_upper = at_upper & (balance > tolerance)
        free_row = ~fixed_row & (side * rows < 0)
        alpha = trial
        if (free_lower | free_upper).any() or free_row.any():
            alpha = trial if start is None else start
            at_lower, at_upper = at_lower & ~free_lower, at_upper & ~free_upper
            side = np.where(free_row, 0, side)
            continue
        unbalanced = float(np.max(np.abs(balance[free]) / tolerance[free], initial=0.0))
        if unbalanced > _UNBALANCED and patience:
            # Either a piecewise quadratic objective changed its piece, or only rounding remains.
            worst, patience = min(worst, unbalanced), patience - (unbalanced > 0.5 * worst)
            continue
        multipliers = Multipliers(
            rows,
            np.where(at_lower, np.maximum(force, 0.0), 0.0),
            np.where(at_upper, np.maximum(-force, 0.0), 0.0),
        )
        return Polished(trial, multipliers, (at_upper.astype(np.int8) - at_lower.astype(np.int8)))
    return None


def active_rows(model: NumpyModel, alpha: Array, rows: Array) -> Array:
    """Multiplier of each inequality row judged active (scaled multiplier > scaled slack), else 0."""
    if np.array_equal(model.row_lower, model.row_upper):
        return np.zeros(len(rows))
    values = np.asarray(model.matrix @ alpha)
    distance = np.where(rows > 0, model.row_upper - values, values - model.row_lower)
    k = np.sqrt(np.asarray(model.squares @ model.sigma**2))
    scaled = np.divide(distance, k, out=np.full_like(distance, np.inf), where=k > 0)
    return np.where(np.abs(rows) * k > scaled, rows, 0.0)


def _solve(
    model: NumpyModel, alpha: Array, free: Flags, active: Flags, limit: Array
) -> tuple[Array, Array, Flags] | None:
    """One Newton step on the free coefficients with the active rows as equalities.

    Returns alpha, the rows' multipliers, and which rows have a free coefficient.
    """
    rows = np.zeros(len(active))
    scale = model.sigma[free]
    norm = np.sqrt(np.asarray(model.squares @ np.where(free, model.sigma, 0.0) ** 2))
    used = active & (norm > 0)
    matrix = model.matrix[used][:, free] * scale / norm[used][:, np.newaxis]
    residual = (limit[used] - np.asarray(model.matrix @ alpha)[used]) / norm[used]
    force = model.gradient(alpha)[free] * scale
    hessian = model.curvature(alpha).part(free, scale)
    try:
        step, pull = kkt.solve(hessian, matrix, -force, residual)
    except SolverError:
        return None
    if not np.isfinite(np.concatenate([step, pull])).all():
        return None
    trial = alpha.copy()
    trial[free] += scale * step
    rows[used] = pull / norm[used]
    return trial, rows, norm > 0


def _released(
    model: NumpyModel,
    alpha: Array,
    limit: Array,
    without_free: Flags,
    slack: Array,
    at_lower: Flags,
    at_upper: Flags,
) -> Flags:
    """Choose a coefficient at a bound to release, for each unmet active row without a free one.

    Near an end of the row's range its last free coefficient is easily mistaken for one at a bound.
    The coefficient released is the first to move as the row's multiplier leaves its interval.
    """
    release = np.zeros(len(alpha), dtype=bool)
    residual = limit - np.asarray(model.matrix @ alpha)
    gradient = model.gradient(alpha)
    for row in np.flatnonzero(without_free & (np.abs(residual) > slack)):
        values = _line(model, int(row))
        wanted = np.sign(residual[row]) * np.sign(values)  # the direction that reduces the residual
        able = ((wanted > 0) & at_lower) | ((wanted < 0) & at_upper)
        cost = np.full(len(alpha), np.inf)
        cost[able] = (gradient * wanted)[able] / np.abs(values[able])
        if able.any():
            release[np.argmin(cost)] = True
    return release


def _line(model: NumpyModel, row: int) -> Array:
    """One row's coefficients, (size,)."""
    line = model.matrix[[row]]
    return np.asarray(line.toarray() if sp.issparse(line) else line).ravel()


def undetermined(
    model: NumpyModel,
    alpha: Array,
    rows: Array,
    without_free: Flags,
    at_lower: Flags,
    at_upper: Flags,
) -> Array:
    """Give rows without a free coefficient their multiplier.

    Their multiplier may lie anywhere in an interval: each coefficient at its lower bound requires
    at least -gradient / coefficient, each at its upper bound at most that. The value nearest 0 is
    returned.
    """
    gradient = model.gradient(alpha)
    sign = at_lower.astype(float) - at_upper.astype(float)
    rows = rows.copy()
    for row in np.flatnonzero(without_free):
        values = _line(model, int(row))
        pull = sign * values
        ends = np.divide(-gradient, values, out=np.zeros_like(values), where=pull != 0)
        at_least = ends[pull > 0].max(initial=-np.inf)
        at_most = ends[pull < 0].min(initial=np.inf)
        if at_least <= at_most:
            rows[row] = np.clip(0.0, at_least, at_most)
    return rows
