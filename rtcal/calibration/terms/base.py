"""The protocols of terms, how terms add and scale, and the term of any linear observations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.acoustics.room import Room
from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.layout import Integers, Layout, Whitened
from rtcal.calibration.problem_data import ProblemData
from rtcal.support import checks
from rtcal.support.errors import ModelError
from rtcal.support.types import Array


@runtime_checkable
class ObjectiveTerm(Protocol):
    """A convex function of the unknowns: quadratic, or piecewise quadratic."""

    is_prior: ClassVar[bool]
    """Whether it is the prior that makes alpha unique; a calibration has exactly one."""

    def expression(self, context: Context, weight: int) -> Any:
        """Return the weighted cvxpy expression; ``weight`` is the index of its weight in the data.

        A prior's weight is 1: the whole objective is scaled so.
        """
        ...

    def value(self, u: Array, data: ProblemData) -> float:
        """Return the unweighted value at the unknowns u."""
        ...

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return the unweighted gradient, (size,)."""
        ...

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return the unweighted second derivative.

        Its diagonal (size,), a sparse matrix, or the `rtcal.support.kkt.Squares` of few rows that
        couple many unknowns.
        """
        ...

    def convexity(self, data: ProblemData) -> Array:
        """Return m, (size,), with curvature >= diag(m / sigma²) everywhere; 0 where unsure."""
        ...

    def correlate(self, columns: Array, layout: Layout) -> Array:
        """Return R @ columns, R the prior correlation of the unknowns; columns (size, ...)."""
        ...

    def __add__(self, other: Any) -> Objective: ...

    def __rmul__(self, factor: float) -> Objective: ...


@dataclass(frozen=True)
class Objective:
    """A weighted sum of objective terms."""

    terms: tuple[ObjectiveTerm, ...]
    weights: tuple[float, ...]

    @cached_property
    def further(self) -> list[FurtherUnknown]:
        """The terms that bring an unknown of their own."""
        return [t for t in self.terms if isinstance(t, FurtherUnknown)]

    def __add__(self, other: Any) -> Objective:
        other = as_objective(other)
        return Objective(self.terms + other.terms, self.weights + other.weights)

    def __radd__(self, other: Any) -> Objective:
        """Add to 0, with which `sum` begins; anything else raises ModelError."""
        return self if isinstance(other, int) and other == 0 else as_objective(other) + self

    def __rmul__(self, factor: float) -> Objective:
        checks.number("weight", factor, ModelError)
        if not (np.isfinite(factor) and factor >= 0):
            raise ModelError(f"a weight of {factor:g} is not finite and 0 or more: not convex")
        return Objective(self.terms, tuple(float(factor) * w for w in self.weights))

    __mul__ = __rmul__


def as_objective(term: ObjectiveTerm | Objective) -> Objective:
    """Return a term, or a sum of them, as an `Objective`; ModelError for anything else."""
    if isinstance(term, Objective):
        return term
    if isinstance(term, ObjectiveTerm):
        return Objective((term,), (1.0,))
    raise ModelError(f"{term!r} is not an objective term{lacking(term, ObjectiveTerm)}")


def lacking(thing: object, protocol: type, *others: type) -> str:
    """Return the members that ``thing`` lacks of the most similar protocol, as ": it lacks ...".

    Empty where it has nothing of any of them.
    """
    members = [
        {n for n in (*vars(p), *vars(p).get("__annotations__", ())) if not n.startswith("_")}
        for p in (protocol, *others)
    ]
    present = [sum(hasattr(thing, name) for name in names) for names in members]
    nearest = present.index(max(present))
    if not present[nearest]:
        return ""
    return f": it lacks {', '.join(sorted(n for n in members[nearest] if not hasattr(thing, n)))}"


class BaseTerm:
    """Adds and scales a term; by default it is no prior, independent, and claims no convexity."""

    is_prior: ClassVar[bool] = False

    def convexity(self, data: ProblemData) -> Array:
        """Return zeros: no strong convexity is claimed."""
        return np.zeros(data.layout.size)

    def correlate(self, columns: Array, layout: Layout) -> Array:
        """Return the columns as they are: independent."""
        return columns

    def compiled_as(self) -> Any:
        """Return the term that the compiled problem is built of, which other numbers may share."""
        return self

    def __add__(self, other: Any) -> Objective:
        mine: Any = self
        return as_objective(mine).__add__(other)

    def __radd__(self, other: Any) -> Objective:
        mine: Any = self
        return as_objective(mine).__radd__(other)

    def __rmul__(self, factor: float) -> Objective:
        mine: Any = self
        return as_objective(mine) * factor

    __mul__ = __rmul__


@dataclass(frozen=True)
class Rows:
    """lower <= matrix @ u <= upper, in the unknowns' units; an equality where the two are equal."""

    matrix: Any
    lower: Array
    upper: Array


@runtime_checkable
class RowConstraint(Protocol):
    """A constraint that adds rows to the problem."""

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """Return cvxpy constraints, each with the sign of its dual in the rows' multipliers."""
        ...

    def row_scale(self, data: ProblemData) -> Array:
        """Return the scale factor of each row in the cvxpy constraint, (n_rows,)."""
        ...

    def rows(self, data: ProblemData) -> Rows:
        """Return the rows' NumPy model; one that does not apply is all zero and without limits."""
        ...

    def label(self, row: int, layout: Layout) -> str:
        """Return how messages name one row."""
        ...


@runtime_checkable
class MatchConstraint(RowConstraint, Protocol):
    """A row constraint that holds S'alpha to the measured T: one row per configuration and band."""

    def target_limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return the least and the most S'alpha in m², both (n_configurations, n_bands)."""
        ...


@runtime_checkable
class BoundConstraint(Protocol):
    """A constraint that narrows the box; it costs nothing."""

    def box(self, room: Room, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the narrowed box, both (n_materials, n_bands)."""
        ...


@runtime_checkable
class SharedMaterials(Protocol):
    """A constraint that makes materials one unknown; it costs nothing either."""

    def groups(self, materials: tuple[str, ...]) -> Iterable[tuple[str, ...]]:
        """Return the groups of materials that share their coefficients."""
        ...


@runtime_checkable
class FurtherUnknown(Protocol):
    """A term that brings an unknown of its own beside alpha, with its prior and its gain."""

    name: str
    mean: float
    sigma: float

    def gains(self, n_configurations: int, n_bands: int) -> Array:
        """Return the absorption in m² that one unit adds, (n_configurations, n_bands)."""
        ...


def limited(
    context: Context, rows: Integers, columns: Integers, n_rows: int, term: LimitedRows
) -> list[tuple[Any, int]]:
    """Return the cvxpy constraints of a term whose rows have limits; a side may be missing."""
    made: list[tuple[Any, int]] = []
    for side, sign in ((0, -1), (1, 1)):
        if not term.sides[side]:
            continue

        def compute(data: ProblemData, side: int = side) -> tuple[Array, Array]:
            scale = term.row_scale(data)
            limit = term.limits(data)[side]
            applies = np.isfinite(limit) & (scale > 0)
            scale = np.where(applies, scale, 0.0)
            # A row that does not apply reads 0 <= 1, which leaves the solver an interior.
            constant = np.where(applies, -np.where(applies, limit, 0.0) * scale, 1 - 2 * side)
            return term.coefficients(data) * scale[rows], constant

        expression = context.affine(rows, columns, n_rows, compute).expression
        made.append((expression <= 0 if side else expression >= 0, sign))
    return made


class LimitedRows(Protocol):
    """The protocol of a term that `limited` accepts."""

    @property
    def sides(self) -> tuple[bool, bool]:
        """Whether there is a lower limit, and an upper one."""
        ...

    def limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return the lower and the upper limit of every row, (n_rows,) each."""
        ...

    def coefficients(self, data: ProblemData) -> Array:
        """Return the coefficients of the unknowns, in the order of the pattern."""
        ...

    def row_scale(self, data: ProblemData) -> Array:
        """Return the scale factor of each row, (n_rows,)."""
        ...


def reciprocal(values: Array) -> Array:
    """Return 1 / values, 0 where they are 0."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)


def half_squares(expression: Any) -> Any:
    """Return half the sum of squares of a cvxpy expression, for a term's ``expression``."""
    return 0.5 * cp.sum_squares(expression)


@dataclass(frozen=True)
class LinearObservations(BaseTerm):
    """½ (y - J alpha)' C⁻¹ (y - J alpha): linear observations y of alpha; C is the errors' covariance.

    The numbers are an `Observed`, and are given to `rtcal.Calibration`'s problem when it is solved:
    ``problem.solve(measured, observed={term: Observed(...)})``. So the problem is compiled once,
    whatever the number of observations, and solved for each of them.

    When to use it: where measurements tell more of alpha than one T per band does. J and y come from
    a simulator's derivatives in `rtcal.calibrate_positions`; weight 1 is then the right one.

    Parameters
    ----------
    name : str
        Tells several of them apart.

    References
    ----------
    Aitken 1935, generalised least squares.
    """

    name: str = "observations"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ModelError(f"LinearObservations: name = {self.name!r} is not a text")

    def expression(self, context: Context, weight: int) -> Any:
        """½ |w^½ (R alpha - z)|², R the upper triangle of the QR of the whitened J.

        R has as many rows as there are coefficients, however many observations there are. Those of
        its rows that lack observations are 0. What J alpha cannot reach of y is a constant.
        """
        n = context.layout.n_alpha
        rows, columns = np.triu_indices(n)

        def compute(data: ProblemData) -> tuple[Array, Array]:
            matrix, values = self._of(data).matrix, self._of(data).values
            triangle = np.linalg.qr(np.column_stack([matrix, values]), mode="r")
            full = np.zeros((n, n + 1))
            full[: min(len(triangle), n)] = triangle[:n]
            full *= np.sqrt(data.weights[weight])
            return full[rows, columns], -full[:, n]

        return half_squares(context.affine(rows, columns, n, compute).expression)

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ (y - J alpha)' C⁻¹ (y - J alpha)."""
        return 0.5 * float(np.sum(self._residual(u, data) ** 2))

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return J' C⁻¹ (J alpha - y)."""
        gradient = np.zeros_like(u)
        gradient[: data.layout.n_alpha] = self._of(data).matrix.T @ self._residual(u, data)
        return gradient

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return J' C⁻¹ J: a matrix that couples materials and bands."""
        further = data.layout.size - data.layout.n_alpha
        return sp.csr_array(np.pad(self._of(data).information, (0, further)))

    def _residual(self, u: Array, data: ProblemData) -> Array:
        return np.asarray(self._of(data).matrix @ u[: data.layout.n_alpha] - self._of(data).values)

    def _of(self, data: ProblemData) -> Whitened:
        return data.observed[self]
