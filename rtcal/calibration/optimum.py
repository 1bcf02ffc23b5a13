"""The exact optimum: on the active set of a solver's answer, or without one, through the dual.

Polishing: an interior-point answer has errors up to 1e-5, but shows reliably which coefficients are at
a bound. With this active set the optimum is the solution of one linear system. The loop solves the
system, adds violated bounds to the active set, and drops bounds whose multiplier has the wrong
sign. When there is nothing to add or to drop, the answer is exact to rounding. For a piecewise
quadratic objective the loop is Newton's method.

The dual of a separable problem has one multiplier D per band. With independent priors and at most one
matched sum per band, the coefficients for a given D are alpha(D) = clip(mu - D S sigma², lower, upper).
The sum S'alpha(D) falls with D and is linear between the points where a coefficient meets a bound. A
bisection over those points and one linear equation give D. It shares no code with solvers, with
polishing, or with `rtcal.exact`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.calibration.problem_data import Flags, ProblemData
from rtcal.calibration.terms import ExactMatch, MatchWithin, PriorDeviation, RoomMatch, SoftMatch
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


_SUM_ROUNDING = 32 * np.finfo(float).eps
"""Relative rounding error of a sum over materials. NumPy adds in blocks of 128 with 8 partial sums,
so that the error of 100,000 summands is below 27 eps (Higham 1993, SIAM J. Sci. Comput. 14, 783)."""


_BEYOND = 1e280
"""Multiplier in 1/m² above all multipliers at which a coefficient meets a bound. Its products do not
overflow."""


@dataclass(frozen=True)
class Separable:
    """The data of a separable problem, bands first.

    Attributes
    ----------
    mu, sigma, lower, upper, held : array (n_bands, n_rows)
        Prior and box; ``held`` is the value of coefficients with sigma = 0.
    areas : array (n_rows,)
        S in m².
    least, most : array (n_bands,)
        Limits of S'alpha in m²; infinite without a match, equal for an exact match.
    target, variance : array (n_bands,)
        b in m² and its variance for a soft match; the variance is NaN without one.
    """

    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    held: Array
    areas: Array
    least: Array
    most: Array
    target: Array
    variance: Array

    def alpha(self, multiplier: Array) -> Array:
        """Return alpha(D), (n_bands, n_rows), for D (n_bands,) in 1/m²."""
        moved = self.mu - multiplier[:, np.newaxis] * (self.areas * self.sigma**2)
        return np.where(self.sigma > 0, np.clip(moved, self.lower, self.upper), self.held)

    def sum(self, multiplier: Array) -> Array:
        """Return S'alpha(D) in m², (n_bands,)."""
        return np.asarray((self.areas * self.alpha(multiplier)).sum(axis=1))

    def solve(self) -> Array:
        """Return the optimal D in 1/m², (n_bands,); 0 where nothing is matched."""
        target, variance, _ = self._equation()
        return self._multiplier(target, variance)

    def enclosure(self) -> tuple[Array, Array]:
        """Return bounds of the optimal coefficients, (n_bands, n_rows) each.

        Every alpha rises with b. The optimum for b therefore lies between the solutions for b plus
        and minus twice the rounding error of S'alpha, also after the rounding of these solutions.
        """
        target, variance, error = self._equation()
        below = self.alpha(self._multiplier(target - error, variance))
        above = self.alpha(self._multiplier(target + error, variance))
        return below, above

    def _equation(self) -> tuple[Array, Array, Array]:
        """The b and u² of S'alpha(D) - D u² = b, and twice the rounding error of S'alpha in m².

        b is NaN where D is 0: without a match, or with the prior well within the tolerance.
        """
        at_prior = self.sum(np.zeros(len(self.mu)))
        soft = np.isfinite(self.variance)
        nearest = np.where(soft, self.target, np.clip(at_prior, self.least, self.most))
        largest = np.maximum(np.abs(self.lower), np.abs(self.upper))
        error = 2 * _SUM_ROUNDING * ((self.areas * largest).sum(axis=1) + np.abs(nearest))
        inside = (at_prior > self.least + error) & (at_prior < self.most - error) & ~soft
        variance = np.where(soft, self.variance, 0.0)
        return np.where(inside, np.nan, nearest), variance, error

    def _multiplier(self, target: Array, variance: Array) -> Array:
        """Solve S'alpha(D) - D u² = b; the D nearest 0 where several or none solve it."""
        weight = self.areas * self.sigma**2
        moves = weight > 0
        # alpha meets its lower bound at D = to_lower and its upper bound at D = to_upper.
        to_lower = np.divide(self.mu - self.lower, weight, out=np.zeros_like(weight), where=moves)
        to_upper = np.divide(self.mu - self.upper, weight, out=np.zeros_like(weight), where=moves)
        end = np.full((len(weight), 1), _BEYOND)
        points = np.sort(np.concatenate([-end, to_lower, to_upper, end], axis=1), axis=1)
        bands = np.arange(len(points))
        first, stop = np.zeros_like(bands), np.full_like(bands, points.shape[1] - 1)
        wanted = np.where(np.isfinite(target), target, 0.0)
        while (stop - first > 1).any():
            middle = (first + stop) // 2
            at = points[bands, middle]
            too_large = self.sum(at) - at * variance > wanted
            first, stop = np.where(too_large, middle, first), np.where(too_large, stop, middle)
        low, high = points[bands, first], points[bands, stop]
        free = moves & (to_upper <= low[:, np.newaxis]) & (to_lower >= high[:, np.newaxis])
        pegged = np.where(free, self.mu, self.alpha(0.5 * (low + high)))
        excess = (self.areas * pegged).sum(axis=1) - wanted
        slope = (self.areas * np.where(free, weight, 0.0)).sum(axis=1) + variance
        solution = np.divide(excess, slope, out=np.zeros_like(excess), where=slope > 0)
        return np.where(np.isfinite(target), np.clip(solution, low, high), 0.0)


def separable_form(model: NumpyModel) -> Separable | None:
    """Return the problem as a separable one, or None if it is not."""
    data, layout = model.data, model.data.layout
    terms = model.objective.terms
    prior = next(term for term in terms if term.is_prior)
    weighted = zip(terms, data.weights, strict=True)
    soft = [(term, weight) for term, weight in weighted if isinstance(term, SoftMatch)]
    rows = model.row_constraints
    if (
        layout.n_configurations > 1
        or layout.further
        or not isinstance(prior, PriorDeviation)
        or prior.correlated()
        or any(isinstance(term, RoomMatch) for term in terms)
        or len(terms) > 1 + len(soft)
        or len(rows) + len(soft) > 1
        or not all(isinstance(row, ExactMatch | MatchWithin) for row in rows)
    ):
        return None
    least, most = np.full(layout.n_bands, -np.inf), np.full(layout.n_bands, np.inf)
    for row in rows:
        limits = row.rows(data)
        least, most = limits.lower, limits.upper
    variance = np.full(layout.n_bands, np.nan)
    for term, weight in soft:
        if weight > 0:
            variance = term.uncertainty(data)[0] ** 2 / weight
    return _bands_first(data, least, most, variance)


def _bands_first(data: ProblemData, least: Array, most: Array, variance: Array) -> Separable:
    def bands_first(values: Array) -> Array:
        return np.ascontiguousarray(data.alpha(values).T)

    return Separable(
        mu=bands_first(data.mu),
        sigma=bands_first(data.scale),
        lower=bands_first(data.lower),
        upper=bands_first(data.upper),
        held=bands_first(data.centre),
        areas=data.areas[0],
        least=least,
        most=most,
        target=data.target[0],
        variance=variance,
    )


def dual_solution(model: NumpyModel) -> tuple[Array, Multipliers] | None:
    """Return the optimal unknowns and multipliers; None if the problem is not separable."""
    problem = separable_form(model)
    if problem is None:
        return None
    multiplier = problem.solve()
    u = problem.alpha(multiplier).T.ravel()
    rows = multiplier if model.row_constraints else np.zeros(0)
    force = model.stationarity(u, rows)
    at_lower, at_upper = model.movable & (u == model.lower), model.movable & (u == model.upper)
    lower = np.where(at_lower, np.maximum(force, 0.0), 0.0)
    upper = np.where(at_upper & ~at_lower, np.maximum(-force, 0.0), 0.0)
    return u, Multipliers(rows, lower, upper)
