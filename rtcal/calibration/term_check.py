"""Check that each term's NumPy description agrees with its cvxpy expression.

The solver uses the expression; polish and certificate use the description. If an answer does not pass
the certificate, or polishing moves it far, this check shows whether a term or the solver is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cvxpy as cp
import numpy as np

from rtcal.calibration.context import Context
from rtcal.calibration.numpy_model import NumpyModel
from rtcal.calibration.terms import ObjectiveTerm, RowConstraint
from rtcal.errors import TermError
from rtcal.support.hessian import Hessian
from rtcal.support.types import Array, read_only_view

_AGREEMENT = 1e-4
"""Largest relative difference of two descriptions of one term: rounding and the finite differences
stay below 1e-6, and a wrong term differs by a factor."""
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
    cvxpy_values = [_minimum(expression, context, x) for x in points]
    numpy_changes, cvxpy_changes = np.diff(numpy_values), np.diff(cvxpy_values)
    if _differ(numpy_changes, cvxpy_changes):
        raise TermError(
            f"{term!r}: its value and its cvxpy expression disagree. Between two points the value "
            f"times its weight changes by {numpy_changes[0]:.6g}, the expression by "
            f"{cvxpy_changes[0]:.6g}"
        )


def _minimum(expression: Any, context: Context, x: Array) -> float:
    """The expression at x, minimised over its helper variables."""
    if all(variable.id == context.x.id for variable in expression.variables()):
        context.x.save_value(x)
        return float(expression.value)
    problem = cp.Problem(cp.Minimize(expression), [context.x == x])
    return float(problem.solve(solver=cp.CLARABEL))


def _check_derivatives(term: ObjectiveTerm, model: NumpyModel, us: Array, scale: Array) -> None:
    """Compare the gradient with the value's differences, the curvature with the gradient's."""
    data = model.data
    slopes, directional, bends, curved = [], [], [], []
    for u, towards in zip(us, us[::-1], strict=True):
        direction = towards - u
        low, high = map(read_only_view, (u - _STEP * direction, u + _STEP * direction))
        slopes.append((term.value(high, data) - term.value(low, data)) / (2 * _STEP))
        directional.append(float(term.gradient(u, data) @ direction))
        gradients = term.gradient(high, data) - term.gradient(low, data)
        bends.append(float(direction @ gradients) / (2 * _STEP))
        curvature = Hessian.total([(1.0, term.curvature(u, data))], len(u)).whole()
        product = curvature * direction if np.ndim(curvature) == 1 else curvature @ direction
        curved.append(float(direction @ product))
    for first, second, stated, derived in (
        ("gradient", "value", directional, slopes),
        ("curvature", "gradient", curved, bends),
    ):
        # A piecewise quadratic term may have a kink within the step at some of the points.
        if all(_differ(np.array([a]), np.array([b])) for a, b in zip(stated, derived, strict=True)):
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
        values = rows.matrix @ (data.centre + data.scale * x)
        outside = np.maximum(np.maximum(rows.lower - values, values - rows.upper), 0.0) * row_scale
        context.x.save_value(x)
        violations = np.sum([np.ravel(part.violation()) for part in parts], axis=0)
        for row in np.flatnonzero(row_scale > 0):
            if _differ(outside[[row]], violations[[row]]):
                raise TermError(
                    f"{constraint!r}: its rows and its cvxpy constraint disagree. At one point "
                    f'"{constraint.label(int(row), data.layout)}" is violated by '
                    f"{outside[row]:.6g} in its rows, by {violations[row]:.6g} in the constraint"
                )


def _differ(first: Array, second: Array) -> bool:
    size = max(float(np.max(np.abs(first))), float(np.max(np.abs(second))))
    return bool(np.max(np.abs(first - second)) > _AGREEMENT * size + np.finfo(float).tiny)
