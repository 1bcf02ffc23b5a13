"""The separable problem, solved exactly through its dual: one multiplier D per band.

With independent priors and at most one matched sum per band, the coefficients for a given D are
alpha(D) = clip(mu - D S sigma², lower, upper). The sum S'alpha(D) falls with D and is linear
between the points where a coefficient meets a bound. A bisection over those points and one linear
equation give D. It shares no code with the QP's solvers, with `closed_form` or with `rtcal.exact`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.calibration.problem_data import ProblemData
from rtcal.calibration.terms import ExactMatch, MatchWithin, PriorDeviation, RoomMatch, SoftMatch
from rtcal.support.types import Array

_ROUNDING = 32 * np.finfo(float).eps
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
        error = 2 * _ROUNDING * ((self.areas * largest).sum(axis=1) + np.abs(nearest))
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


def solve(model: NumpyModel) -> tuple[Array, Multipliers] | None:
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
