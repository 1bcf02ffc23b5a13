"""The NumPy model of a whole problem, which polish and certificate read instead of cvxpy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from rtcal.calibration.layout import Integers
from rtcal.calibration.problem_data import Flags, ProblemData
from rtcal.calibration.terms import (
    ExactMatch,
    MatchConstraint,
    Objective,
    PriorDeviation,
    RowConstraint,
)
from rtcal.support.hessian import Hessian
from rtcal.support.kkt import DENSE
from rtcal.support.types import Array, read_only_view


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
