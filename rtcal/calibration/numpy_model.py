"""The NumPy model of a whole problem, which polish and certificate read instead of cvxpy.

The solver uses the expression; polish and certificate use the description. If an answer does not pass
the certificate, or polishing moves it far, this check shows whether a term or the solver is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.layout import Integers
from rtcal.calibration.problem_data import Flags, ProblemData
from rtcal.calibration.terms import (
    ExactMatch,
    MatchConstraint,
    Objective,
    ObjectiveTerm,
    PriorDeviation,
    RowConstraint,
)
from rtcal.support.errors import TermError
from rtcal.support.kkt import DENSE, Hessian
from rtcal.support.types import Array, read_only_view

_AGREEMENT = 1e-4
"""Largest relative difference of two descriptions of one term: rounding and the finite differences
stay below 1e-6, and a wrong term differs by a factor."""
_ROUNDING = 1e-14
"""Rounding error of a term's value or gradient, or of a row's sum, relative to its size."""
_MINIMUM = 1e-6
"""Error of the solver that minimises an expression over its helper variables, relative to its value."""
_STEP = 1e-4
"""Step of the finite differences in units of the prior's sigma."""
_POINTS = 4


def require_agreement(
    context: Context,
    model: NumpyModel,
    expressions: Sequence[Any],
    constraints: Sequence[Sequence[Any]],
) -> None:
    """Raise TermError for a term whose description and expression disagree.

    Parameters
    ----------
    context : Context
        Its parameters hold the data of ``model``.
    model : NumpyModel
    expressions : sequence of cvxpy expressions
        One per objective term, its weight folded in.
    constraints : sequence of sequences of cvxpy constraints
        One sequence per row constraint.
    """
    scale, centre = model.data.scale, model.data.centre
    rng = np.random.default_rng(0)
    points = np.where(scale > 0, rng.standard_normal((_POINTS, len(scale))), 0.0)
    weights = model.data.weights
    for term, weight, expression in zip(model.objective.terms, weights, expressions, strict=True):
        if weight > 0:
            _check_value(term, weight, expression, context, model, points)
            _check_derivatives(term, model, read_only_view(centre + scale * points), scale)
    for constraint, parts in zip(model.row_constraints, constraints, strict=True):
        _check_rows(constraint, parts, context, model, points)


def _check_value(
    term: ObjectiveTerm,
    weight: float,
    expression: Any,
    context: Context,
    model: NumpyModel,
    points: Array,
) -> None:
    data = model.data
    us = read_only_view(data.centre + data.scale * points)
    numpy_values = [weight * term.value(u, data) for u in us]
    cvxpy_values = [_minimum(expression, context, x, data.scale > 0) for x in points]
    numpy_changes, cvxpy_changes = np.diff(numpy_values), np.diff(cvxpy_values)
    if _differ(numpy_changes, cvxpy_changes, _MINIMUM * np.max(np.abs(cvxpy_values))):
        raise TermError(
            f"{term!r}: its value and its cvxpy expression disagree. Between two points the value "
            f"times its weight changes by {numpy_changes[0]:.6g}, the expression by "
            f"{cvxpy_changes[0]:.6g}"
        )


def _minimum(expression: Any, context: Context, x: Array, moves: Flags) -> float:
    """The expression at x, minimised over its helper variables.

    Helper variables are those of its own, and the x of fixed unknowns, which move nothing: a prior
    integrates them out, as they are free. NaN where cvxpy finds no minimum, which shows nothing.
    """
    if moves.all() and all(v.id == context.x.id for v in expression.variables()):
        context.x.save_value(x)
        return float(expression.value)
    problem = cp.Problem(cp.Minimize(expression), [context.x[moves] == x[moves]])
    try:
        return float(problem.solve(solver=cp.CLARABEL))
    except cp.SolverError:
        return np.nan


def _check_derivatives(term: ObjectiveTerm, model: NumpyModel, us: Array, scale: Array) -> None:
    """Compare the gradient with the value's differences, the curvature with the gradient's."""
    data = model.data
    slopes, directional, bends, curved, rounding = [], [], [], [], []
    for u, towards in zip(us, us[::-1], strict=True):
        direction = towards - u
        low, high = map(read_only_view, (u - _STEP * direction, u + _STEP * direction))
        values = term.value(high, data), term.value(low, data)
        slopes.append((values[0] - values[1]) / (2 * _STEP))
        directional.append(float(term.gradient(u, data) @ direction))
        gradients = term.gradient(high, data), term.gradient(low, data)
        bends.append(float(direction @ (gradients[0] - gradients[1])) / (2 * _STEP))
        sizes = max(map(abs, values)), float(np.abs(direction) @ np.abs(gradients).max(axis=0))
        rounding.append(_ROUNDING / _STEP * np.array(sizes))
        curvature = Hessian.total([(1.0, term.curvature(u, data))], len(u)).whole()
        product = curvature * direction if np.ndim(curvature) == 1 else curvature @ direction
        curved.append(float(direction @ product))
    for first, second, stated, derived, error in (
        ("gradient", "value", directional, slopes, np.array(rounding)[:, 0]),
        ("curvature", "gradient", curved, bends, np.array(rounding)[:, 1]),
    ):
        # A piecewise quadratic term may have a kink within the step at some of the points.
        if all(map(_differ, stated, derived, error)):
            raise TermError(
                f"{term!r}: its {first} and its {second} disagree. Along one direction the {first} "
                f"gives {stated[0]:.6g}, differences of the {second} give {derived[0]:.6g}"
            )


def _check_rows(
    constraint: RowConstraint,
    parts: Sequence[Any],
    context: Context,
    model: NumpyModel,
    points: Array,
) -> None:
    data = model.data
    rows, row_scale = constraint.rows(data), constraint.row_scale(data)
    for x in np.concatenate([points, 30 * points]):  # far points violate inequalities too
        u = data.centre + data.scale * x
        values = rows.matrix @ u
        limits = np.abs(np.where(np.isfinite(rows.lower), rows.lower, rows.upper))
        row_magnitude = (abs(rows.matrix) @ np.abs(u) + np.nan_to_num(limits, posinf=0)) * row_scale
        outside = np.maximum(np.maximum(rows.lower - values, values - rows.upper), 0.0) * row_scale
        context.x.save_value(x)
        violations = np.sum([np.ravel(part.violation()) for part in parts], axis=0)
        for row in np.flatnonzero(row_scale > 0):
            size = float(row_magnitude[row])
            if _differ(outside[row], violations[row], _ROUNDING * size):
                raise TermError(
                    f"{constraint!r}: its rows and its cvxpy constraint disagree. At one point "
                    f'"{constraint.label(int(row), data.layout)}" is violated by '
                    f"{outside[row]:.6g} in its rows, by {violations[row]:.6g} in the constraint"
                )


def _differ(first: ArrayLike, second: ArrayLike, rounding: float) -> bool:
    """Whether two descriptions differ by more than rounding makes them; not where one is unknown."""
    first, second = np.asarray(first), np.asarray(second)
    size = max(float(np.max(np.abs(first))), float(np.max(np.abs(second))))
    return bool(
        np.max(np.abs(first - second)) > _AGREEMENT * size + rounding + np.finfo(float).tiny
    )


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers in alpha's units: of the rows, and of the two sides of the box.

    Sign: gradient + rows' ``rows`` - ``lower`` + ``upper`` = 0 with ``lower``, ``upper`` >= 0, all
    over the unknowns.
    """

    rows: Array
    lower: Array
    upper: Array


@dataclass(frozen=True, repr=False)
class NumpyModel:
    """Objective, rows and box over the unknowns, from the terms' own NumPy descriptions."""

    data: ProblemData
    objective: Objective
    row_constraints: tuple[RowConstraint, ...]

    @property
    def lower(self) -> Array:
        """The box's lower side."""
        return self.data.lower

    @property
    def upper(self) -> Array:
        """The box's upper side."""
        return self.data.upper

    @property
    def sigma(self) -> Array:
        """The unknowns' scale: the prior's standard deviations, 0 for a fixed unknown."""
        return self.data.scale

    @cached_property
    def movable(self) -> Flags:
        """Unknowns that the calibration may change."""
        return np.asarray(self.sigma > 0)

    @cached_property
    def matrix(self) -> Any:
        """All rows, (n_rows, size): an array, or sparse where that would be large."""
        parts = [rows.matrix for rows in self._rows]
        if not parts:
            return np.zeros((0, self.sigma.size))
        matrix = (
            parts[0] if len(parts) == 1 else sp.csr_array(sp.vstack([*map(sp.csr_array, parts)]))
        )
        small = sp.issparse(matrix) and matrix.shape[0] * matrix.shape[1] <= DENSE
        return matrix.toarray() if small else matrix

    @cached_property
    def squares(self) -> Any:
        """The squared coefficients of `matrix`."""
        return self.matrix**2

    @cached_property
    def row_band(self) -> Any:
        """The band that each row is reported with, (n_rows,): that of its first coefficient."""
        n_bands = self.data.layout.n_bands
        if not sp.issparse(self.matrix):
            return np.argmax(self.matrix != 0, axis=1) % n_bands
        first = np.minimum(self.matrix.indptr[:-1], max(self.matrix.nnz - 1, 0))
        return self.matrix.indices[first] % n_bands

    @cached_property
    def row_place(self) -> Integers:
        """Index of the T that each row matches, configuration by configuration; -1 for other rows."""
        places = [
            np.arange(len(rows.lower))
            if isinstance(constraint, MatchConstraint)
            else np.full(len(rows.lower), -1)
            for constraint, rows in zip(self.row_constraints, self._rows, strict=True)
        ]
        return np.concatenate([*places, np.zeros(0, dtype=int)])

    @cached_property
    def convexity(self) -> Array:
        """Lower limits m of the curvature, (size,), such that curvature >= diag(m / sigma²)."""
        pairs = zip(self.objective.terms, self.data.weights, strict=True)
        return np.asarray(sum(w * t.convexity(self.data) for t, w in pairs))

    @cached_property
    def has_closed_form(self) -> bool:
        """Whether the paper's closed form solves the problem where no bound is active."""
        parts = (*self.objective.terms, *self.row_constraints)
        return (
            len(parts) == 2
            and isinstance(parts[0], PriorDeviation)
            and isinstance(parts[1], ExactMatch)
            and not parts[0].correlated()
            and self.data.layout.n_configurations == 1
        )

    def separate(self, u: Array) -> bool:
        """Whether neither a row nor the objective couples two bands."""
        layout = self.data.layout
        if layout.further or self.has_closed_form:
            return self.has_closed_form
        k = layout.n_bands
        rows, columns = self.matrix.nonzero()
        if (columns % k != self.row_band[rows]).any():
            return False
        return not self.curvature(u).couples(np.arange(layout.size) % k)

    @cached_property
    def row_lower(self) -> Array:
        """The rows' lower limits."""
        return np.concatenate([rows.lower for rows in self._rows]) if self._rows else np.zeros(0)

    @cached_property
    def row_upper(self) -> Array:
        """The rows' upper limits."""
        return np.concatenate([rows.upper for rows in self._rows]) if self._rows else np.zeros(0)

    @cached_property
    def _rows(self) -> list[Any]:
        return [constraint.rows(self.data) for constraint in self.row_constraints]

    @cached_property
    def row_norm(self) -> Array:
        """The sum of each row's absolute coefficients: for a matched band the total area."""
        return np.asarray(self.absolute.sum(axis=1)).ravel()

    @cached_property
    def absolute(self) -> Any:
        """The absolute coefficients of `matrix`."""
        return abs(self.matrix)

    @cached_property
    def entries(self) -> Any:
        """Number of coefficients in each row, (n_rows,)."""
        return np.asarray((self.absolute > 0).sum(axis=1)).ravel()

    def gradient(self, u: Array) -> Array:
        """Return the objective's gradient at the unknowns."""
        pairs, u = zip(self.objective.terms, self.data.weights, strict=True), read_only_view(u)
        return np.asarray(sum(w * t.gradient(u, self.data) for t, w in pairs if w > 0))

    def steepness(self, u: Array, gradient: Array | None = None) -> Array:
        """Return 1 + max |sigma gradient| over the bands that each unknown is coupled with, (size,).

        Rounding errors of the optimality conditions are relative to this scale. ``gradient`` is that
        at u, where it is known already.
        """
        slope = np.abs(self.sigma * (self.gradient(u) if gradient is None else gradient))
        if not self.separate(u):
            return np.full(len(slope), 1 + np.max(slope, initial=0.0))
        by_band = self.data.alpha(slope)
        by_band[:] = 1 + by_band.max(axis=0)  # a view of all unknowns: there are no further ones
        return slope

    def value(self, u: Array) -> float:
        """Return the objective at the unknowns."""
        pairs, u = zip(self.objective.terms, self.data.weights, strict=True), read_only_view(u)
        return float(sum(weight * term.value(u, self.data) for term, weight in pairs))

    def curvature(self, u: Array) -> Hessian:
        """Return the objective's second derivative."""
        pairs, u = zip(self.objective.terms, self.data.weights, strict=True), read_only_view(u)
        return Hessian.total(((w, t.curvature(u, self.data)) for t, w in pairs), self.sigma.size)

    def __repr__(self) -> str:
        terms = " + ".join(type(term).__name__ for term in self.objective.terms)
        rows = ", ".join(type(row).__name__ for row in self.row_constraints) or "no rows"
        return f"<NumpyModel: {terms} subject to {rows}, {self.sigma.size} unknowns>"

    def stationarity(self, u: Array, rows: Array) -> Array:
        """Return gradient + rows' multipliers at the unknowns, which the box's multipliers balance."""
        return np.asarray(self.gradient(u) + self.matrix.T @ rows)
