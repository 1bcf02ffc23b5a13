"""The QP: compiled once by cvxpy, solved with Clarabel or OSQP, polished and certified.

    minimise ½ v'Pv + c'v  subject to  A v = b,  A v <= b (the last rows),  lower <= v <= upper

v has the deviations x = (alpha - mu) / sigma of the unknowns, and what terms define beside them.

1. `compile_once` has cvxpy compile the terms once per structure; `CompiledProblem.filled` puts numbers
   into the matrices: cvxpy's maps are affine in the parameters.
2. `solve` asks a solver which bounds and inequalities are active. OSQP starts at `closed_form`, which
   is step 3 from the guess that none is: its first round is the paper's closed form.
3. `polish` solves the optimality (KKT) conditions on the active set, one sparse linear system, by
   SuperLU with refinement. It corrects the set until no bound is violated and no multiplier has the
   wrong sign.
4. `certify` computes residuals and gap anew from P, c, A and b. Nothing that a solver states is used,
   and a solver that returns nothing is no failure: `closed_form` needs none.
"""

from __future__ import annotations

import functools
import threading
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rtcal.calibration.terms import AnyTerm, Model, Term
from rtcal.calibration.unknowns import Flags, Integers, Layout, Numbers
from rtcal.support import checks
from rtcal.support.errors import MissingDependencyError, ModelError, SolverError
from rtcal.support.types import Array

_EPS = np.finfo(float).eps
Active = NDArray[np.int8]
"""The active bounds: -1 at the lower bound, 1 at the upper, 0 between them. In this module ``at``."""


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """The options of one solve; DataError or ModelError for a value that is not allowed.

    Parameters
    ----------
    solver : str
        ``"clarabel"``, ``"osqp"``, or another solver of cvxpy's.
    unreachable : {"raise", "nearest"}
        What to do where no coefficients within the bounds give the measured T. ``"raise"`` raises
        InfeasibleError; ``"nearest"`` takes the nearest T within reach and lists the band in the
        result.
    warm_start : bool
        Whether OSQP starts from the closed form. No other solver takes a start.
    settings : mapping, optional
        The solver's own settings by name, beside `SETTINGS`.
    """

    solver: str = "clarabel"
    unreachable: str = "raise"
    warm_start: bool = True
    settings: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str):
            raise ModelError(f'solver = {self.solver!r} is not a name such as "clarabel"')
        checks.choice("unreachable", self.unreachable, ("raise", "nearest"))
        checks.flag("warm_start", self.warm_start)
        if not isinstance(self.settings, Mapping | None):
            raise ModelError(f"settings = {self.settings!r} is not a mapping of name to value")
        for key in self.settings or {}:
            if not isinstance(key, str):
                raise ModelError(f"settings has {key!r}, which is no setting's name")

    @property
    def all_settings(self) -> dict[str, Any]:
        """The settings that a solve runs with: these override those of `SETTINGS`."""
        return {**SETTINGS.get(self.solver.lower(), {}), **(self.settings or {})}


SETTINGS: dict[str, dict[str, Any]] = {
    # Polishing asks for the active set alone, to which Clarabel's own tolerance of 1e-8 suffices. The
    # whitened problem needs no equilibration.
    "clarabel": {"equilibrate_enable": False, "iterative_refinement_enable": False},
    # At its default 1e-3, every second answer has an error above 1e-6. Feasibility is checked before,
    # and with its default 1e-4 OSQP calls feasible targets infeasible.
    "osqp": {
        "eps_abs": 1e-8,
        "eps_rel": 1e-8,
        "max_iter": 20_000,
        "polishing": True,
        "eps_prim_inf": 1e-14,
        # At its default of 25 iterations, a start at the optimum is noticed 20 iterations late.
        "check_termination": 5,
    },
    "scs": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 100_000},
}
"""Settings by solver, beside its own defaults."""


class _Pattern:
    """A sparse matrix by columns whose entries are given anew; entries of one place are added up."""

    def __init__(self, rows: Integers, columns: Integers, shape: tuple[int, int]) -> None:
        self.rows, self.columns = rows, columns
        key, self._place = np.unique(columns * shape[0] + rows, return_inverse=True)
        starts = np.searchsorted(key // shape[0], np.arange(shape[1] + 1))
        # scipy copies indices of any other kind.
        self._indices, self._starts = (key % shape[0]).astype(np.int32), starts.astype(np.int32)
        self._shape = shape

    def filled(self, entries: Array) -> Any:
        """Return the matrix with these entries."""
        data = np.bincount(self._place, entries, minlength=len(self._indices))
        return sp.csc_matrix((data, self._indices, self._starts), shape=self._shape)


class CompiledProblem:
    """A calibration that cvxpy has compiled for rooms of one layout: `filled` makes a `QP` of it.

    It keeps cvxpy's affine map from the parameters to P, c, A and b, and where their entries stand.
    Callers share it through `compile_once`: its terms are those of `Term.structure`, equal to the
    caller's but for the numbers that enter through the parameters.

    Parameters
    ----------
    layout : Layout
    terms : sequence of functions of a `Model`
        The objective.
    weights : sequence of float
    constraints : sequence of functions of a `Model`

    Attributes
    ----------
    model : Model
    stated : list
        Each constraint with the cvxpy constraints that it states.
    rows_of : list
        For each of them the rows of A, one array per cvxpy constraint; -1 for one that became a bound.
    size, n_rows : int
        Number of variables v, and of rows of A.
    equal : array (n_rows,) of bool
        Which rows are equalities.
    places : array (layout.size,)
        Where the unknowns u stand among the variables.
    band, row_band : array (size,), (n_rows,)
        The band of a variable and of a row; -1 for what belongs to none, or to several.
    P_rows, P_columns, A_rows, A_columns : array
        The place of each entry of P and A.
    limited : tuple of two arrays
        The variables that have a lower and those that have an upper bound.
    triangle : array
        Which entries of P are in its upper triangle, which is what solvers take.
    kkt, solver_P, solver_A : _Pattern
        The optimality conditions of a `System`, and the matrices of `solve`.

    Raises
    ------
    ModelError
        If a term is no convex quadratic expression, a constraint is not linear, or the problem is not
        DPP, so that every solve would compile anew.
    """

    def __init__(
        self,
        layout: Layout,
        terms: Sequence[AnyTerm],
        weights: Sequence[float],
        constraints: Sequence[AnyTerm],
    ) -> None:
        self.layout, self._arguments = layout, (layout, terms, weights, constraints)
        m = self.model = Model(layout)
        pairs = zip(terms, weights, strict=True)
        objective = sum(weight * _expression(term, m) for term, weight in pairs)
        stated = [_constraints(term, m) for term in constraints]
        self.stated = list(zip(constraints, stated, strict=True))
        rows = [constraint for of_term in stated for constraint in of_term]
        problem = cp.Problem(cp.Minimize(objective), [*rows, *m.definitions, *m.box()])
        if not problem.is_dcp(dpp=True):
            raise ModelError(
                "the composed problem is not DPP, a convex problem that cvxpy compiles once: a term is "
                "not convex, or it multiplies parameters or divides by one. m.parameter gives a "
                "product of numbers as one parameter, m.defined makes an expression a variable"
            )
        for parameter, _ in m.parameters:  # cvxpy compiles none without a value
            parameter.save_value(np.ones(parameter.shape))
        data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
        if data["dims"].soc or data["dims"].exp or data["dims"].psd or data["dims"].p3d:
            raise ModelError(
                "the composed problem is no QP: a term is neither linear nor quadratic"
            )
        self._keep_maps(data["param_prob"], int(data["dims"].zero), len(data["b"]))
        self._keep_places(data["param_prob"].var_id_to_col)
        self._keep_patterns()
        # cvxpy unpacks the numbers of the rows once: where it puts them is where the multipliers go.
        numbered = np.arange(len(self._row_of), dtype=float)
        answer = SimpleNamespace(x=np.zeros(self.size), z=numbered, s=numbered, status="Solved")
        answer.obj_val, answer.solve_time, answer.iterations = 0.0, 0.0, 0
        problem.unpack_results(answer, chain, inverse)
        self.rows_of = [
            [self._row_of[np.abs(np.ravel(c.dual_value)).astype(int)] for c in of_term]
            for of_term in stated
        ]

    def __reduce__(self) -> Any:
        """Pickle what it is compiled of."""
        return compile_once, self._arguments

    def _keep_maps(self, compiled: Any, n_equal: int, n_rows: int) -> None:
        """Keep cvxpy's maps from the parameters to P, c, A and b, and the places of their entries.

        Of its ``n_rows`` rows the first ``n_equal`` are equalities. An inequality of one variable with
        a constant factor is a bound of it and no row of A.
        """
        compiled.reduced_A.cache()
        compiled.reduced_P.cache()
        linear = compiled.q if hasattr(compiled, "q") else compiled.c  # c in cvxpy 1.7
        start = compiled.param_id_to_col
        self._filled = [
            (start[p.id], compute) for p, compute in self.model.parameters if p.id in start
        ]
        # The last entry of theta is the maps' constant.
        self._theta = np.ones(compiled.total_param_size + 1)
        rows, starts, _ = compiled.reduced_A.problem_data_index
        size = self.size = len(starts) - 2  # its last column is b
        columns = np.repeat(np.arange(size + 1), np.diff(starts))
        # cvxpy's rows are -A x + b = 0 and -A x + b >= 0; here they are A x = b and A x <= b.
        sign = np.where(columns < size, -1.0, 1.0)
        every = sp.csr_array(sp.diags_array(sign) @ compiled.reduced_A.reduced_mat)
        is_A = columns < size
        b = sp.csr_array(
            (np.ones((~is_A).sum()), (rows[~is_A], np.flatnonzero(~is_A))), (n_rows, len(rows))
        )
        constant = np.diff(sp.csr_array(every[:, :-1]).indptr) == 0
        alone = (np.bincount(rows[is_A], minlength=n_rows) == 1) & (np.arange(n_rows) >= n_equal)
        single = is_A & constant & alone[rows]
        factor = every[:, [-1]].toarray().ravel()
        lower, upper = (np.flatnonzero(single & (side * factor > 0)) for side in (-1, 1))
        self._bounds = [(rows[e], columns[e], factor[e]) for e in (lower, upper)]
        self.limited = columns[lower], columns[upper]
        self._general = np.setdiff1d(np.arange(n_rows), rows[single])
        self.n_rows, self.equal = len(self._general), self._general < n_equal
        self._row_of = np.full(n_rows, -1)
        self._row_of[self._general] = np.arange(self.n_rows)
        entries = np.flatnonzero(is_A & ~single)
        self.A_rows, self.A_columns = self._row_of[rows[entries]], columns[entries]
        self.P_rows, starts, _ = compiled.reduced_P.problem_data_index
        self.P_columns = np.repeat(np.arange(size), np.diff(starts))
        parts = [
            compiled.reduced_P.reduced_mat,
            sp.csr_array(linear)[:size],
            every[entries],
            b @ every,
        ]
        self._map = sp.csr_array(sp.vstack([sp.csr_array(part) for part in parts]))
        self._map.eliminate_zeros()
        self._parts = np.cumsum([0, *(part.shape[0] for part in parts)]).tolist()

    def _keep_places(self, first: Mapping[int, int]) -> None:
        """Keep where the unknowns stand, and bands; ``first`` is where a cvxpy variable begins."""
        m, n = self.model, self.layout.n_alpha
        self.places = first[m.x.id] + np.arange(n)
        if m.effects is not None:
            sizes = first[m.effects.id] + np.arange(m.effects.size)
            self.places = np.concatenate([self.places, sizes])
        self.band = np.full(self.size, -1)
        self.band[self.places[:n]] = np.arange(n) % self.layout.n_bands
        known = self.band[self.A_columns] >= 0
        of_row, band = self.A_rows[known], self.band[self.A_columns[known]]
        lowest, highest = np.full(self.n_rows, self.layout.n_bands), np.full(self.n_rows, -1)
        np.minimum.at(lowest, of_row, band)
        np.maximum.at(highest, of_row, band)
        self.row_band = np.where(lowest == highest, highest, -1)

    def _keep_patterns(self) -> None:
        """Keep the places of the optimality conditions, and of the matrices that solvers take."""
        size, n = self.size, self.size + self.n_rows
        P, A, variables = (
            (self.P_rows, self.P_columns),
            (self.A_rows, self.A_columns),
            np.arange(size),
        )
        self.kkt = _Pattern(
            np.concatenate([P[0], size + A[0], A[1], np.arange(n)]),
            np.concatenate([P[1], A[1], size + A[0], np.arange(n)]),
            (n, n),
        )
        bounds = np.concatenate(self.limited)
        self.solver_A = _Pattern(
            np.concatenate([A[0], self.n_rows + np.arange(len(bounds))]),
            np.concatenate([A[1], bounds]),
            (self.n_rows + len(bounds), size),
        )
        self.triangle = np.flatnonzero(P[0] <= P[1])
        self.solver_P = _Pattern(
            np.concatenate([P[0][self.triangle], variables]),
            np.concatenate([P[1][self.triangle], variables]),
            (size, size),
        )

    def filled(self, numbers: Numbers) -> QP:
        """Return the QP of a set of numbers."""
        theta = self._theta.copy()
        for place, compute in self._filled:
            value = np.ravel(compute(numbers), order="F")
            theta[place : place + len(value)] = value
        values = self._map @ theta
        P, c, A, b = (values[start:stop] for start, stop in pairwise(self._parts))
        bounds = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        tighter = np.maximum, np.minimum
        for bound, (rows, columns, factor), narrow in zip(
            bounds, self._bounds, tighter, strict=True
        ):
            narrow.at(bound, columns, b[rows] / factor)
        scale = np.ones(self.size)
        scale[self.places] = numbers.sigma
        held = float(numbers.areas.max(axis=0).sum()) if (numbers.sigma == 0).any() else 0.0
        return QP(self, P, c, A, b[self._general], *bounds, scale, held)


def _expression(term: AnyTerm, m: Model) -> Any:
    """Return an objective term's expression; ModelError unless it is one number."""
    expression = term(m)
    if not isinstance(expression, cp.Expression) or not expression.is_scalar():
        raise ModelError(
            f"{term!r} is no objective term: it returns {expression!r} in place of a cvxpy expression "
            "of one number"
        )
    return expression


def _constraints(term: AnyTerm, m: Model) -> list[Any]:
    """Return a term's constraints; ModelError unless they are."""
    stated = term(m)
    stated = list(stated) if isinstance(stated, list | tuple) else [stated]
    for constraint in stated:
        if not isinstance(constraint, cp.constraints.constraint.Constraint):
            raise ModelError(f"{term!r} is no constraint: it returns {constraint!r}")
    return stated


_cached = functools.lru_cache(maxsize=16)(CompiledProblem)
COMPILING = threading.RLock()


def compile_once(
    layout: Layout,
    terms: Sequence[AnyTerm],
    weights: Sequence[float],
    constraints: Sequence[AnyTerm],
) -> CompiledProblem:
    """Return the compiled problem of these terms, an earlier one if nothing it depends on differs.

    The 16 used last are kept. A term that cannot be hashed is compiled anew. What a function refers to
    must not change: its numbers are constants of the compiled problem.
    """
    structure = tuple(t.structure() if isinstance(t, Term) else t for t in terms)
    key = layout, structure, tuple(weights), tuple(constraints)
    with COMPILING:  # two threads that ask at once share one
        try:
            hash(key)
        except TypeError:
            return CompiledProblem(*key)
        return _cached(*key)


def forget() -> None:
    """Forget the compiled problems that later calibrations of equal shape would use again.

    Examples
    --------
    >>> import rtcal as rt
    >>> rt.calibration.forget()
    """
    _cached.cache_clear()


@dataclass(frozen=True, eq=False, repr=False)
class QP:
    """minimise ½ v'Pv + c'v  subject to  A v = b or A v <= b,  lower <= v <= upper.

    Attributes
    ----------
    compiled : CompiledProblem
        It has the places of the entries of P and A, and which rows are equalities.
    P, A : array
        The entries.
    c, b : array (size,), (n_rows,)
    lower, upper : array (size,)
    scale : array (size,)
        Change of an unknown by its deviation: the prior's sigma; 1 for other variables.
    fixed_area : float
        m² of the materials if b has some of sigma 0, which no row of A has; 0 otherwise.
    """

    compiled: CompiledProblem
    P: Array
    c: Array
    A: Array
    b: Array
    lower: Array
    upper: Array
    scale: Array
    fixed_area: float

    def __repr__(self) -> str:
        n_equal = np.count_nonzero(self.equal)
        counts = f"{n_equal} equalities, {len(self.b) - n_equal} inequalities"
        return f"<QP: {len(self.c)} variables, {counts}>"

    def unknowns(self, numbers: Numbers, v: Array) -> Array:
        """Return the unknowns u = mu + sigma x of a point v, (size,)."""
        return np.asarray(numbers.mu + numbers.sigma * v[self.compiled.places])

    @property
    def equal(self) -> Flags:
        """Which rows are equalities."""
        return self.compiled.equal

    @functools.cached_property
    def fixed(self) -> Flags:
        """Variables whose bounds are equal."""
        return np.asarray(self.lower == self.upper)

    @functools.cached_property
    def row_size(self) -> Array:
        """Sum of each row's coefficients by the unknowns: for the match of a band the area."""
        unit = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.scale > 0)
        return self.row_sums(unit, np.abs(self.A))

    @functools.cached_property
    def matrices(self) -> tuple[Any, Any]:
        """P and A as sparse arrays."""
        compiled = self.compiled
        return (
            sp.csc_array(
                (self.P, (compiled.P_rows, compiled.P_columns)), (len(self.c), len(self.c))
            ),
            sp.csr_array(
                (self.A, (compiled.A_rows, compiled.A_columns)), (len(self.b), len(self.c))
            ),
        )

    def row_sums(self, v: Array, entries: Array | None = None) -> Array:
        """Return A v, (n_rows,), of A or of other entries at its places."""
        compiled, entries = self.compiled, self.A if entries is None else entries
        products = entries * v[compiled.A_columns]
        return np.asarray(np.bincount(compiled.A_rows, products, minlength=len(self.b)), float)

    def line(self, row: int) -> Array:
        """Return the coefficients of one row, (size,)."""
        compiled, line = self.compiled, np.zeros(len(self.c))
        line[compiled.A_columns[compiled.A_rows == row]] = self.A[compiled.A_rows == row]
        return line

    def gradient(self, v: Array) -> Array:
        """Return P v + c, (size,)."""
        compiled = self.compiled
        return self.c + np.bincount(
            compiled.P_rows, self.P * v[compiled.P_columns], minlength=len(self.c)
        )

    def force(self, v: Array, y: Array) -> Array:
        """Return P v + c + A'y, which the multipliers of the bounds balance, (size,)."""
        compiled = self.compiled
        pull = np.bincount(compiled.A_columns, self.A * y[compiled.A_rows], minlength=len(self.c))
        return self.gradient(v) + pull

    @functools.cached_property
    def magnitudes(self) -> QP:
        """The QP of the absolute values of P, c, A and b: its sums bound the rounding of this one's."""
        return replace(self, **{name: np.abs(getattr(self, name)) for name in "PcAb"})

    def at_bounds(self, at: Active) -> Array:
        """Return v with what is at a bound there, and 0, the prior, elsewhere."""
        held = np.where((at < 0) | self.fixed, self.lower, np.where(at > 0, self.upper, 0.0))
        return np.where(np.isfinite(held), held, 0.0)


class System:
    """The optimality (KKT) conditions on an active set, factored.

        P dv + A'dy = force,  A dv = limit

    over the free variables and the active rows; the rows are scaled to unit length there. A little
    regularisation lets rows be dependent, and refinement removes its effect.
    """

    _SHIFT = 1e-11
    _REFINEMENTS = 4

    def __init__(self, program: QP, free: Flags, active: Flags) -> None:
        compiled = program.compiled
        norm = np.sqrt(program.row_sums(free.astype(float), program.A**2))
        self.used = active & (norm > 0)
        self._unit = np.divide(1.0, norm, out=np.zeros_like(norm), where=self.used)
        self._on = np.concatenate([free, self.used])
        scaled = program.A * self._unit[compiled.A_rows]
        entries = np.concatenate([program.P, scaled, scaled, np.zeros(len(self._on))])
        entries[~(self._on[compiled.kkt.rows] & self._on[compiled.kkt.columns])] = 0.0
        self._matrix = compiled.kkt.filled(entries)
        shift = np.where(np.arange(len(self._on)) < len(free), self._SHIFT, -self._SHIFT)
        entries[-len(shift) :] = np.where(self._on, shift, 1.0)
        try:
            self._factors = splu(
                compiled.kkt.filled(entries),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise SolverError("the optimality conditions are singular") from error

    def solve(self, force: Array, limit: Array, refine: bool = True) -> tuple[Array, Array]:
        """Return dv (size, ...) and dy (n_rows, ...), 0 for what is not free or not active.

        ``force`` (size,) and ``limit`` (n_rows,) may have a second axis, of several right sides.
        """
        right = np.concatenate([force, (limit.T * self._unit).T])
        right[~self._on] = 0.0
        solution, off, residual = np.zeros(right.shape), np.inf, right
        for _ in range(1 + self._REFINEMENTS):
            solution = solution + self._factors.solve(residual)
            if not refine:
                break
            residual = right - self._matrix @ solution
            before, off = off, np.max(np.abs(residual), initial=0.0)
            if not off < before / 2:
                break
        return solution[: len(force)], (solution[len(force) :].T * self._unit).T


@dataclass(frozen=True, eq=False, repr=False)
class Iterate:
    """A point of a QP with its multipliers and its active set.

    Attributes
    ----------
    v : array (size,)
        The variables.
    y : array (n_rows,)
        The rows' multipliers.
    at : array (size,)
        -1 at the lower bound, 1 at the upper, 0 between them.
    lower_multipliers, upper_multipliers : array (size,)
        Of the bounds, 0 or more.
    system : System, optional
        The optimality conditions on the active set; None of a solver's own answer.
    status, iterations, seconds : str, int, float
        How a solver names its status, its iterations and its time in s.
    """

    v: Array
    y: Array
    at: Active
    lower_multipliers: Array
    upper_multipliers: Array
    system: System | None = None
    status: str = ""
    iterations: int = 0
    seconds: float = float("nan")

    def __repr__(self) -> str:
        stated = f", status {self.status}, {self.iterations} iterations" if self.status else ""
        n = np.count_nonzero(self.at)
        return f"<Iterate: {len(self.v)} variables, {n} held at a bound{stated}>"

    @classmethod
    def of(cls, program: QP, at: Active) -> Iterate:
        """Return the prior, with what is at a bound there, and all multipliers 0."""
        zero = np.zeros(len(at))
        return cls(program.at_bounds(at), np.zeros(len(program.b)), at, zero, zero)

    def active(self, program: QP) -> tuple[Active, Flags]:
        """Return which bounds and which rows are active: of a slack and its multiplier one is 0."""
        at = (self.upper_multipliers > program.upper - self.v).astype(np.int8) - (
            self.lower_multipliers > self.v - program.lower
        )
        square = program.row_sums(np.ones(len(self.v)), program.A**2)
        return at, self.y * square > program.b - program.row_sums(self.v)


_ROUNDS = 100
_AT_ONCE = 20
"""Rounds in which the active set changes by all that is wrong at once; then by the worst alone."""
_ROUNDING = 1e-13
"""Share of the sum of the absolute parts of a difference up to which it counts as 0."""


def polish(program: QP, at: Active, tight: Flags) -> Iterate | None:
    """Return the optimum, by the active-set method from a first guess; None if it does not converge.

    Each round solves the optimality conditions on the active set from the prior on, so that the
    answer depends on the final set alone, to the last bit. What is violated joins the set; only if
    nothing is, what has a multiplier of the wrong sign leaves it.

    Parameters
    ----------
    program : QP
    at : array (size,)
        Variables guessed at their lower bound (-1) or upper bound (1).
    tight : array (n_rows,) of bool
        Inequalities guessed to hold with equality.
    """
    at, tight = at.copy(), tight | program.equal
    at[program.fixed] = 0
    near = 8 * _EPS / np.where(program.scale > 0, program.scale, 1.0)
    for round_ in range(_ROUNDS):
        free = (at == 0) & ~program.fixed
        start = program.at_bounds(at)
        try:
            system = System(program, free, tight)
        except SolverError:
            return None
        dv, y = system.solve(-program.gradient(start), program.b - program.row_sums(start))
        v = start + dv
        if not (np.isfinite(v).all() and np.isfinite(y).all()):
            return None
        inside = np.minimum(np.maximum(v, program.lower), program.upper)
        v = np.where(free & (abs(v - inside) <= near + 4 * _EPS * abs(inside)), inside, v)
        below, above = free & (v < program.lower), free & (v > program.upper)
        slack = program.b - program.row_sums(v)
        rounding = _ROUNDING * (program.magnitudes.row_sums(np.abs(v)) + program.magnitudes.b)
        beyond = ~tight & (slack < -rounding)
        if below.any() or above.any() or beyond.any():
            if round_ >= _AT_ONCE:
                below, above, beyond = _worst(
                    (below, program.lower - v), (above, v - program.upper), (beyond, -slack)
                )
            at = np.where(below, -1, np.where(above, 1, at)).astype(np.int8)
            tight = tight | beyond
            continue
        alone = tight & ~system.used & (program.row_size > 0)
        unmet = alone & (abs(slack) > rounding)
        if unmet.any():
            released = _released(program, v, unmet, slack, at)
            if released.any():
                at = np.where(released, 0, at).astype(np.int8)
                continue
        if alone.any():
            y = _nearest_to_zero(program, v, y, alone, at)
        force = program.force(v, y)
        tolerance = _ROUNDING * (1 + program.magnitudes.force(np.abs(v), np.abs(y)))
        wrong = ((at < 0) & (force < -tolerance)) | ((at > 0) & (force > tolerance))
        released_rows = tight & ~program.equal & (y < 0)
        if not (wrong.any() or released_rows.any()):
            return Iterate(v, y, at, *_of_bounds(force, at), system)
        if round_ >= _AT_ONCE:
            wrong, released_rows = _worst((wrong, abs(force)), (released_rows, -y))
        at = np.where(wrong, 0, at).astype(np.int8)
        tight = tight & ~released_rows
    return None


def _of_bounds(force: Array, at: Active) -> tuple[Array, Array]:
    """Return the multipliers of the lower and upper bounds that balance a force."""
    lower = np.where(at < 0, np.maximum(force, 0.0), 0.0)
    return lower, np.where(at > 0, np.maximum(-force, 0.0), 0.0)


def _worst(*parts: tuple[Flags, Array]) -> list[Flags]:
    """Return of flags with their sizes only the one of the largest size."""
    sizes = [np.where(flags, size, -np.inf) for flags, size in parts]
    largest = max(np.max(size, initial=-np.inf) for size in sizes)
    return [size == largest for size in sizes]


def _released(program: QP, v: Array, unmet: Flags, slack: Array, at: Active) -> Flags:
    """Choose a variable at a bound to release, for each unmet row without a free one.

    Near an end of the row's range its last free variable is easily mistaken for one at a bound. The
    one released is the first to move as the row's multiplier leaves its interval.
    """
    release = np.zeros(len(v), dtype=bool)
    gradient = program.gradient(v)
    for row in np.flatnonzero(unmet).tolist():
        line = program.line(row)
        wanted = np.sign(slack[row]) * np.sign(line)  # the direction that reduces the residual
        able = ((wanted > 0) & (at < 0)) | ((wanted < 0) & (at > 0))
        cost = np.full(len(v), np.inf)
        cost[able] = (gradient * wanted)[able] / np.abs(line[able])
        if able.any():
            release[np.argmin(cost)] = True
    return release


def _nearest_to_zero(program: QP, v: Array, y: Array, rows: Flags, at: Active) -> Array:
    """Give rows without a free variable their multiplier.

    It may lie anywhere in an interval: each variable at its lower bound requires at least
    -gradient / coefficient, each at its upper bound at most that. The value nearest 0 is returned.
    """
    y = np.where(rows, 0.0, y)
    gradient = program.force(v, y)
    for row in np.flatnonzero(rows).tolist():
        line = program.line(row)
        pull = -at * line
        ends = np.divide(-gradient, line, out=np.zeros_like(line), where=pull != 0)
        at_least = ends[pull > 0].max(initial=-np.inf)
        at_most = ends[pull < 0].min(initial=np.inf)
        if at_least <= at_most:
            y[row] = np.clip(0.0, at_least, at_most)
    return y


def closed_form(program: QP, at: Active | None = None) -> Iterate | None:
    """Return the optimum by `polish`, with no inequality and only the bounds of ``at`` guessed active.

    Only its first round is closed: without inequalities the QP is one linear system, for an independent
    prior with an exact match that of the paper (Bellows & Katz 2025, Eqs. 22 to 25; by itself, and as
    the oracle of the tests, in `rtcal.calibration.exact`). Where that violates bounds, these are held
    and the system is solved again, as in every `polish`. Variables of a term's own that have a bound,
    such as the parts beyond a threshold, begin there. ``at`` is that of `polish`.
    """
    own = np.isfinite(program.lower)
    own[program.compiled.places] = False
    start = np.where(own, -1, 0 if at is None else at).astype(np.int8)
    return polish(program, start, program.equal)


def solve(program: QP, at: Active, options: SolveOptions) -> Iterate:
    """Return a solver's answer to a QP.

    Variables that stand at a bound by ``at`` (-1, 1), or whose bounds are equal, are left out. The rows
    have unit length, so that no band weighs more than another.

    Raises
    ------
    ModelError
        If the solver refuses a setting.
    MissingDependencyError
        If the solver is not installed.
    SolverError
        If it returns no values. That is no failure of the calibration: its caller goes on to
        `closed_form`, which needs none.
    """
    compiled = program.compiled
    left_out = (at != 0) | program.fixed
    start = program.at_bounds(at)
    on = ~left_out
    entries = program.A * on[compiled.A_columns]
    norm = np.sqrt(program.row_sums(1.0 * on, program.A**2))
    unit = np.divide(1.0, norm, out=np.zeros_like(norm), where=norm > 0)
    bounds = [
        (end - start)[where]
        for end, where in zip((program.lower, program.upper), compiled.limited, strict=True)
    ]
    limited = [
        np.isfinite(end) & on[where] for end, where in zip(bounds, compiled.limited, strict=True)
    ]
    # A row that says nothing reads 0 <= 1, which leaves the solver an interior.
    limits = np.concatenate(
        [
            np.where(
                unit > 0,
                (program.b - program.row_sums(start)) * unit,
                np.where(program.equal, 0.0, 1.0),
            ),
            np.where(limited[0], -bounds[0], 1.0),
            np.where(limited[1], bounds[1], 1.0),
        ]
    )
    matrix = compiled.solver_A.filled(
        np.concatenate([entries * unit[compiled.A_rows], -1.0 * limited[0], 1.0 * limited[1]])
    )
    moves = on[compiled.P_rows] & on[compiled.P_columns]
    triangle = np.where(moves, program.P, 0.0)[compiled.triangle]
    quadratic = compiled.solver_P.filled(np.concatenate([triangle, 1.0 * left_out]))
    linear = program.gradient(start) * on
    name = options.solver.lower()
    began = time.perf_counter()
    first = None
    if name == "osqp" and options.warm_start and (form := closed_form(program, at)) is not None:
        duals = (
            form.y * norm,
            limited[0] * form.lower_multipliers[compiled.limited[0]],
            limited[1] * form.upper_multipliers[compiled.limited[1]],
        )
        first = (form.v - start) * on, np.concatenate(duals)
    matrices = _SolverInput(
        quadratic, linear, matrix, limits, int(compiled.equal.sum()), options.all_settings
    )
    if name == "clarabel":
        x, z, status, iterations = _clarabel(matrices)
    elif name == "osqp":
        x, z, status, iterations = _osqp(matrices, first)
    else:
        x, z, status, iterations = _through_cvxpy(name, matrices)
    seconds = time.perf_counter() - began
    if x is None or z is None or not (np.isfinite(x).all() and np.isfinite(z).all()):
        raise SolverError(f'solver "{name}" returned no values; its status is {status}')
    y, *sides = np.split(
        np.asarray(z), [compiled.n_rows, compiled.n_rows + len(compiled.limited[0])]
    )
    lower, upper = np.zeros(len(program.c)), np.zeros(len(program.c))
    for side, where, applies, values in zip(
        (lower, upper), compiled.limited, limited, sides, strict=True
    ):
        side[where] = np.where(applies, np.maximum(values, 0.0), 0.0)
    v, y = np.where(on, start + x, start), y * unit
    if (at != 0).any():  # what was left out has multipliers, too
        y = _nearest_to_zero(program, v, y, (norm == 0) & (program.row_size > 0), at)
        of_held = _of_bounds(program.force(v, y), at)
        lower, upper = (
            np.where(at != 0, side, own) for side, own in zip(of_held, (lower, upper), strict=True)
        )
    return Iterate(v, y, at, lower, upper, None, status, iterations, seconds)


class _SolverInput(NamedTuple):
    """What a solver is given, scaled and with the bounds among the rows of A.

    minimise ½ x'Px + c'x subject to A x = b (the first rows), A x <= b; P is its upper triangle.
    """

    P: Any
    c: Array
    A: Any
    b: Array
    n_equal: int
    settings: dict[str, Any]


_SolverOutput = tuple[Any, Any, str, int]  # x, the rows' multipliers, status, iterations


def _clarabel(given: _SolverInput) -> _SolverOutput:
    import clarabel

    chosen = clarabel.DefaultSettings()
    chosen.verbose = False
    for key, value in given.settings.items():
        if not hasattr(chosen, key):
            raise ModelError(f'solver "clarabel" has no setting "{key}"')
        try:
            setattr(chosen, key, value)
        except (TypeError, OverflowError) as error:
            raise _refused("clarabel", given, error) from error
    cones = [
        clarabel.ZeroConeT(given.n_equal),
        clarabel.NonnegativeConeT(len(given.b) - given.n_equal),
    ]
    result = clarabel.DefaultSolver(given.P, given.c, given.A, given.b, cones, chosen).solve()
    return np.array(result.x), np.array(result.z), str(result.status), int(result.iterations)


def _osqp(given: _SolverInput, first: tuple[Array, Array] | None) -> _SolverOutput:
    import osqp

    low = np.where(np.arange(len(given.b)) < given.n_equal, given.b, -np.inf)
    settings = {"verbose": False, **given.settings}
    if given.n_equal == 0:
        # Without active rows OSQP's polishing prints a message, even with verbose=False.
        settings["polishing"] = False
    solver = osqp.OSQP()
    try:
        solver.setup(given.P, given.c, given.A, low, given.b, **settings)
    except Exception as error:  # TypeError, ValueError or osqp's own, by version
        raise _refused("osqp", given, error) from error
    if first is not None:
        solver.warm_start(x=first[0], y=first[1])
    result = solver.solve(raise_error=False)
    return result.x, result.y, str(result.info.status), int(result.info.iter)


def _through_cvxpy(name: str, given: _SolverInput) -> _SolverOutput:
    """Solve with any other solver of cvxpy's, which is given the matrices as a problem."""
    installed = _installed()
    if name not in installed:
        raise MissingDependencyError(
            f'solver "{name}" is not installed; cvxpy here has {", ".join(sorted(installed))}'
        )
    x, rows, n = cp.Variable(len(given.c)), sp.csr_array(given.A), given.n_equal
    whole = cp.psd_wrap(sp.csc_array(given.P + sp.triu(given.P, 1).T))
    constraints = [rows[:n] @ x == given.b[:n]] if n else []
    constraints.append(rows[n:] @ x <= given.b[n:])
    problem = cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, whole) + given.c @ x), constraints)
    with warnings.catch_warnings():
        # cvxpy warns of an inaccurate answer; here the certificate judges every answer.
        warnings.simplefilter("ignore", UserWarning)
        try:
            problem.solve(solver=installed[name], **given.settings)
        except cp.SolverError as error:
            raise SolverError(f'solver "{name}" failed: {error}') from error
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise _refused(name, given, error) from error
    duals = [constraint.dual_value for constraint in constraints]
    missing = x.value is None or any(dual is None for dual in duals)
    z = None if missing else np.concatenate([np.ravel(dual) for dual in duals])
    return x.value, z, str(problem.status), int(problem.solver_stats.num_iters or 0)


@functools.cache
def _installed() -> dict[str, str]:
    """cvxpy's installed solvers by small name, cached since the query takes milliseconds."""
    return {str(s).lower(): str(s) for s in cp.installed_solvers()}


def _refused(name: str, given: _SolverInput, error: Exception) -> ModelError:
    stated = ", ".join(f"{key}={value!r}" for key, value in given.settings.items())
    return ModelError(f'solver "{name}" refuses the settings {stated}: {error}')


_ACCEPTED = 1e-9
"""Largest residual of an answer that is returned; see `Certificate`."""


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """Residuals of the optimality conditions, each (n_bands,), computed from P, c, A and b.

    What belongs to no band, or to several, counts in every one.

    Attributes
    ----------
    primal_residual : array
        The larger of |S'alpha - b| / sum S and the violation of the box.
    dual_residual : array
        max |sigma (gradient + S D - z_lower + z_upper)|.
    duality_gap : array
        sum z_lower (alpha - lower) + z_upper (upper - alpha), and D slack of the inequalities.
    alpha_error_bound : array (n_materials, n_bands)
        No coefficient is farther than this from the optimum; see `certify`.
    accepted : bool
        Whether three numbers are at most 1e-9: the largest primal residual; the largest dual residual
        over 1 and the sum of the absolute values of its parts; the gap, each product once, over the
        largest of these sums.
    """

    primal_residual: Array
    dual_residual: Array
    duality_gap: Array
    alpha_error_bound: Array
    accepted: bool

    @property
    def worst(self) -> float:
        """The largest of the three residuals over all bands."""
        residuals = (self.primal_residual, self.dual_residual, self.duality_gap)
        return float(max(np.max(r) for r in residuals))

    def __repr__(self) -> str:
        return (
            f"<Certificate: worst residual {self.worst:.1e}, alpha within "
            f"{np.max(self.alpha_error_bound):.1e} of the optimum>"
        )


def certify(program: QP, point: Iterate, convexity: float) -> Certificate:
    """Return the certificate of a point.

    The error bound. f - m |x|²/2 is convex, with x the deviations and m the ``convexity`` of the prior.
    From a point of dual residual r and gap g that keeps its rows, the optimum x* is within

        m |x - x*|² <= |r| |x - x*| + g.

    The step that the optimality conditions on the active set still ask for, which removes residuals of
    the rows and their rounding, counts in addition.

    Parameters
    ----------
    program : QP
    point : Iterate
    convexity : float
        m; with 0 the box alone bounds the error.
    """
    compiled, layout, v = program.compiled, program.compiled.layout, point.v
    force = program.force(v, point.y)
    magnitude = 1 + program.magnitudes.force(np.abs(v), np.abs(point.y))
    unbalanced = np.where(
        program.fixed, 0.0, force - point.lower_multipliers + point.upper_multipliers
    )
    slack = program.b - program.row_sums(v)
    missed = np.where(program.equal, abs(slack), np.maximum(-slack, 0.0))
    missed = np.divide(missed, program.row_size, out=missed.copy(), where=program.row_size > 0)
    outside = np.maximum(np.maximum(program.lower - v, v - program.upper), 0.0) * program.scale
    to_lower, to_upper = (
        np.where(np.isfinite(room), room, 0.0) for room in (v - program.lower, program.upper - v)
    )
    gap = abs(point.lower_multipliers * to_lower + point.upper_multipliers * to_upper)
    row_gap = np.where(program.equal, 0.0, abs(point.y * slack))

    def by_band(reduce: Any, *parts: tuple[Array, Integers]) -> Array:
        """Reduce values by band; those of no one band count in every one."""
        out = np.zeros(layout.n_bands)
        for values, of_band in parts:
            reduce.at(out, of_band[of_band >= 0], values[of_band >= 0])
            out = reduce(out, reduce.reduce(values[of_band < 0], initial=0.0))
        return out

    primal = by_band(np.maximum, (outside, compiled.band), (missed, compiled.row_band))
    dual = by_band(np.maximum, (abs(unbalanced), compiled.band))
    total = by_band(np.add, (gap, compiled.band), (row_gap, compiled.row_band))
    g = gap.sum() + row_gap.sum()
    relative = np.max(abs(unbalanced) / magnitude, initial=0.0), g / magnitude.max()
    moved, left = np.zeros(len(v)), unbalanced
    if point.system is not None:  # what is not active has no multiplier, and so no gap
        moved, left, g = *_step_left(program, point, point.system, force, slack), 0.0
    bound = np.maximum(to_lower, to_upper)
    if convexity > 0:
        r, m = np.linalg.norm(left), convexity
        bound = np.minimum(bound, moved + (r + np.sqrt(r**2 + 4 * m * g)) / (2 * m))
    bound = np.where(program.fixed, 0.0, bound * program.scale)
    return Certificate(
        primal_residual=primal,
        dual_residual=dual,
        duality_gap=total,
        alpha_error_bound=layout.expand(bound[compiled.places]),
        accepted=bool(primal.max() <= _ACCEPTED and max(relative) <= _ACCEPTED),
    )


def _step_left(
    program: QP, point: Iterate, system: System, force: Array, slack: Array
) -> tuple[Array, Array]:
    """Return how far the optimality conditions still move each variable, and what they leave.

    Two more right sides have the size of the residuals' own rounding errors.
    """
    free = (point.at == 0) & ~program.fixed
    dv, dy = system.solve(-force, slack)
    left = force + program.force(dv, dy) - program.c
    v, y, absolute = np.abs(point.v), np.abs(point.y), program.magnitudes
    # b is a difference of sums, such as b - S'mu, which are at most as large as the row at alpha = 1.
    sums = absolute.row_sums(v) + absolute.b + np.maximum(program.row_size, program.fixed_area)
    errors = _EPS * absolute.force(v, y), 16 * _EPS * sums
    moved = np.abs(dv)
    # A row that keeps no variable free is met within rounding; one variable alone can make up for it.
    unmet = np.where(program.equal & ~system.used, np.abs(slack), 0.0)[program.compiled.A_rows]
    alone = np.divide(unmet, np.abs(program.A), out=np.zeros_like(unmet), where=program.A != 0)
    np.maximum.at(moved, program.compiled.A_columns, alone)
    for sign in (1.0, -1.0):
        each, row = (error * sign ** np.arange(len(error)) for error in errors)
        moved = moved + np.abs(system.solve(each, row, refine=False)[0])
    wrong = np.where(point.at < 0, np.minimum(left, 0.0), np.maximum(left, 0.0))
    return moved, np.where(free, left, np.where(point.at != 0, wrong, 0.0))
