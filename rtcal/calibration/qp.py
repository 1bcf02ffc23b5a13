"""The quadratic programme (QP): compiled once by cvxpy, solved by Clarabel or OSQP, and checked.

    minimise ½ v'Pv + c'v  subject to  A v = b,  A v <= b (the last rows),  lower <= v <= upper

v has the deviations x = (alpha - mu) / sigma of the unknowns, and further variables of the terms.

1. `compile_once` has cvxpy compile the terms once per structure; `CompiledProblem.filled` inserts the
   values of a room.
2. `solve` finds with a solver which bounds and inequalities are active. OSQP starts at `closed_form`,
   which is step 3 from the guess that none is active: its first round is the closed form of the paper.
3. `polish` solves the optimality (KKT) conditions on the active set, one sparse linear system, by
   SuperLU with refinement. It corrects the set until no bound is violated and no multiplier has the
   wrong sign.
4. `certify` calculates residuals and duality gap from P, c, A and b, independently of the solver. A
   solver that returns nothing is no failure, because `closed_form` needs none.
"""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import hadamard
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from rtcal.calibration.terms import AddedAbsorption, AnyTerm, Model, Shared, Term
from rtcal.calibration.unknowns import Flags, Integers, Layout, Numbers, cp
from rtcal.files.saved import NOT_SAVED
from rtcal.support.errors import ModelError, SolverError
from rtcal.support.types import Array

_EPS = np.finfo(float).eps
Active = NDArray[np.int8]
"""State of bounds: -1 for a value at its lower bound, 1 at its upper bound, 0 between them."""

SETTINGS: dict[str, dict[str, Any]] = {
    # Polishing asks for the active set alone: 1e-5 gives the same as Clarabel's own 1e-8, two
    # iterations earlier. The whitened problem needs no equilibration.
    "clarabel": {
        "equilibrate_enable": False,
        "iterative_refinement_enable": False,
        **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-5),
    },
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
}
"""Settings of each solver that differ from its defaults."""


class CompiledProblem:
    """Hold the quadratic programme of a calibration without its numbers, as cvxpy has compiled it.

    Compiling takes longer than solving. Rooms with the same materials, bands and terms therefore share
    one compiled problem, and `filled` inserts the values of one room and its measurement. Call
    `compile_once` instead of this class: it returns the same object for an equal problem.

    ``shape`` has the names of the materials, the centre frequencies in Hz and the number of
    configurations (measured states of the room). ``terms`` of the objective and ``constraints`` are
    functions of a `rtcal.terms.Model`; a constraint may also be a `rtcal.terms.Shared`. ``weights`` has
    the factor of each term in the objective.

    Raises ModelError if a term is no convex quadratic expression, if a constraint is not linear, or if
    a term combines parameters so that cvxpy would have to compile again for each solve (DPP).
    """

    def __init__(
        self,
        shape: tuple[tuple[str, ...], tuple[float, ...], int],
        terms: Sequence[AnyTerm],
        weights: Sequence[float],
        constraints: Sequence[Any],
    ) -> None:
        self._arguments = shape, terms, weights, constraints
        effects = tuple(t.name for t in terms if isinstance(t, AddedAbsorption))
        layout = Layout(shape[0], tuple(range(len(shape[0]))), *shape[1:], effects)
        for constraint in constraints:
            if isinstance(constraint, Shared):
                layout = layout.sharing(constraint.materials)
        self.layout, m = layout, Model(layout)
        self.model = m
        pairs = zip(terms, weights, strict=True)
        objective = sum(weight * _stated(term, m, cp.Expression)[0] for term, weight in pairs)
        kind = cp.constraints.constraint.Constraint
        stated = [(t, _stated(t, m, kind)) for t in constraints if not isinstance(t, Shared)]
        rows = [constraint for _, of_term in stated for constraint in of_term]
        problem = cp.Problem(cp.Minimize(objective), [*rows, *m.definitions])
        if not problem.is_dcp(dpp=True):
            raise ModelError(
                "cvxpy cannot compile the objective or a constraint, because a term is not "
                "convex, or multiplies or divides two quantities that depend on room or "
                "measurement, such as m.alpha, m.target or your m.parameter. Compute a product of "
                "two of your parameters in one m.parameter(shape, compute); in a product of "
                "m.alpha and a parameter p write cp.multiply(p, m.defined(m.alpha))"
            )
        for parameter, _ in m.parameters:  # cvxpy compiles none without a value
            parameter.save_value(np.ones(parameter.shape))
        data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
        if data["dims"].soc or data["dims"].exp or data["dims"].psd or data["dims"].p3d:
            raise ModelError(
                "the composed problem is not a quadratic program: a term is neither linear "
                "nor quadratic"
            )
        self._program = program = data["param_prob"]
        self.size, n = program.x.size, len(data["b"])  # variables v, rows of A
        self.equal = np.arange(n) < int(data["dims"].zero)  # which rows are equalities
        # The place of each entry of P and A.
        (self.P_rows, self.P_columns), _ = self._entries_of(program.reduced_P)
        (self.A_rows, self.A_columns), self._b_rows = self._entries_of(program.reduced_A)

        def places(variables: list[Any]) -> Integers:
            first = program.var_id_to_col
            return np.array([first[v.id] + i for v in variables for i in range(v.size)], np.intp)

        # Where the unknowns u stand among the variables, (layout.size,).
        self.places = places([m.x] if m.effects is None else [m.x, m.effects])
        self._nonnegative = places(m.nonnegative)
        every = np.arange(self.size + n)
        below = self.size + self.A_rows
        kkt = np.concatenate([self.P_rows, below, self.A_columns, every])
        across = np.concatenate([self.P_columns, self.A_columns, below, every])
        key, place = np.unique(across * len(every) + kkt, return_inverse=True)
        starts = np.searchsorted(key // len(every), np.append(every, len(every)))
        # Rows and columns of the entries of [[P, A'], [A, 0]] and its diagonal, the place of each among
        # the matrix's own, and these by columns: rows, and where columns begin.
        self.kkt = (kkt, across, place), key % len(every), starts
        # cvxpy unpacks the numbers of the rows once: where it puts them is where the multipliers go.
        numbered = np.arange(n, dtype=float)
        answer = SimpleNamespace(x=np.zeros(self.size), z=numbered, s=numbered)
        answer.status, answer.obj_val, answer.solve_time, answer.iterations = "Solved", 0.0, 0.0, 0
        problem.unpack_results(answer, chain, inverse)
        # Clarabel's solvers that are not at work, by the bounds and settings that they are set up for.
        self.solvers: dict[Any, Any] = {}
        # Each constraint but `Shared`, with its rows of A by cvxpy constraint that it states.
        self.rows_of = [
            (t, [np.abs(np.ravel(c.dual_value)).astype(int) for c in of_term])
            for t, of_term in stated
        ]

    @functools.cached_property
    def signs(self) -> tuple[Array, Array]:
        """Signs of Hadamard matrices, with which a few solves bound the effect of many rounding errors.

        The first array (size, n) is for errors of the gradient, the second (n_rows, n) for errors of
        the rows. If a coefficient changes by a'e for errors e of several rows, the change is at most
        sum |a e|. With the n signs of a Hadamard matrix for n rows, this sum is at most the sum of
        |a'(signs e)| over the n solves. Rows that no entry of P or A joins may have the same signs.
        """
        (rows, columns, _), ones = self.kkt[0], np.ones(len(self.kkt[0][0]))
        n = self.size + len(self.equal)
        of = connected_components(sp.coo_array((ones, (rows, columns)), (n, n)), directed=False)[1]
        numbers = [_number_within(part) for part in np.split(of, [self.size])]
        most = min(int(numbers[1].max(initial=0)) + 1, _MOST_SIGNS)
        signs = hadamard(1 << (most - 1).bit_length(), float)
        return signs[numbers[0] % len(signs)], signs[numbers[1] % len(signs)]

    @functools.cached_property
    def defining(self) -> Integers | None:
        """Entry of A, by row, of the variable that the row defines; None unless each defines one.

        Such a variable stands in this equality alone, is no unknown and has no bound. None also if
        there are further variables than these and the unknowns.
        """
        alone = np.bincount(self.A_columns, minlength=self.size) == 1
        alone[self.places] = alone[self._nonnegative] = False
        entries = np.flatnonzero(alone[self.A_columns])
        rows, first = np.unique(self.A_rows[entries], return_index=True)
        every = len(rows) == self.equal.sum() == len(self.equal)
        return entries[first] if every and len(rows) + len(self.places) == self.size else None

    def __reduce__(self) -> Any:
        """Pickle what it is compiled of."""
        return compile_once, self._arguments

    def _entries_of(self, reduced: Any) -> tuple[tuple[Integers, Integers], Integers]:
        """Rows and columns of the entries of a matrix, and the rows of those beyond, which are b's."""
        reduced.cache()
        none = np.zeros(0, np.intp), np.zeros(self.size + 1, np.intp), None
        rows, starts, _ = reduced.problem_data_index or none
        columns = np.repeat(np.arange(self.size), np.diff(starts[: self.size + 1]))
        return (rows[: len(columns)], columns), rows[len(columns) :]

    def filled(self, numbers: Numbers) -> QP:
        """Return the quadratic programme (QP) for the numbers of one solve."""
        program = self._program
        theta = np.ones(program.total_param_size + 1)  # its last entry is what is constant
        for parameter, compute in self.model.parameters:
            if (place := program.param_id_to_col.get(parameter.id)) is not None:
                theta[place : place + parameter.size] = np.ravel(compute(numbers), order="F")
        P, c = program.reduced_P.reduced_mat @ theta, (program.q @ theta)[: self.size]
        # cvxpy's rows are A v + b = 0 and A v + b >= 0; here they are A v = b and A v <= b.
        A, of_b = np.split(program.reduced_A.reduced_mat @ theta, [len(self.A_rows)])
        b = np.zeros(len(self.equal))
        b[self._b_rows] = of_b
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        lower[self._nonnegative] = 0.0
        moves = numbers.sigma > 0  # elsewhere alpha is mu whatever x is
        for bound, end in ((lower, numbers.lower), (upper, numbers.upper)):
            distance = (end - numbers.mu) * numbers.inverse_sigma
            bound[self.places[moves]] = distance[moves]
        scale = np.ones(self.size)
        scale[self.places] = numbers.sigma
        held = float(numbers.areas.max(axis=0).sum()) if (numbers.sigma == 0).any() else 0.0
        return QP(self, P, c, -A, b, lower, upper, scale, self.equal, held)


_MOST_SIGNS = 256
"""Most right sides of a bound of rounding errors; more rows that are joined share signs."""


def _number_within(groups: Integers) -> Integers:
    """Return the number of each entry, from 0, within its group."""
    order = np.argsort(groups, kind="stable")
    _, first, n = np.unique(groups[order], return_index=True, return_counts=True)
    out = np.empty(len(groups), np.intp)
    out[order] = np.arange(len(groups)) - np.repeat(first, n)
    return out


def _stated(term: AnyTerm, m: Model, kind: Any) -> list[Any]:
    """Return a term's expression of one number, or its constraints; ModelError for anything else."""
    stated = term(m)
    parts = list(stated) if isinstance(stated, list | tuple) else [stated]
    minimised = kind is cp.Expression
    whole = all(isinstance(part, kind) for part in parts)
    if not whole or (minimised and [part.size for part in parts] != [1]):
        wanted = "one number as an expression of cvxpy" if minimised else "a constraint"
        raise ModelError(f"{term!r} must return {wanted}, but returns {stated!r}")
    return parts


_cached = functools.lru_cache(maxsize=16)(CompiledProblem)
_COMPILING = threading.RLock()


def compile_once(
    shape: tuple[tuple[str, ...], tuple[float, ...], int],
    terms: Sequence[AnyTerm],
    weights: Sequence[float],
    constraints: Sequence[Any],
) -> CompiledProblem:
    """Return the compiled problem of terms and constraints, which is compiled only the first time.

    ``shape`` has the names of the materials, the centre frequencies in Hz and the number of
    configurations (measured states of the room); ``weights`` has the factor of each term. The 16
    problems used last are kept and returned for equal arguments; a problem with a term that Python
    cannot hash is never kept. If a term or constraint is a function of your own, the values that it
    refers to must not change later, because they are constants of the compiled problem.
    """
    structure = tuple(t.structure() if isinstance(t, Term) else t for t in terms)
    key = shape, structure, tuple(weights), tuple(constraints)
    with _COMPILING:  # two threads that ask at once share one
        try:
            hash(key)
        except TypeError:
            return CompiledProblem(*key)
        return _cached(*key)


def forget() -> None:
    """Remove all compiled problems from memory; the next calibration compiles its problem again.

    Examples
    --------
    >>> import rtcal as rt
    >>> rt.calibration.forget()
    """
    _cached.cache_clear()


@dataclass(frozen=True, eq=False, repr=False)
class QP:
    """Hold the numbers of a calibration's quadratic programme.

    The programme is to minimise ½ v'Pv + c'v subject to A v = b (rows where ``equal`` is True) or A v
    <= b (all other rows), and lower <= v <= upper. The variables v (size,) are the unknowns, which are
    coefficients and sizes of effects, each as its deviation from the input in standard deviations; and
    further variables that terms have defined. ``c``, ``lower`` and ``upper`` are (size,), and ``b`` is
    (n_rows,). ``P`` and ``A`` hold only the entries that can differ from 0.
    """

    compiled: CompiledProblem
    P: Array  # the entries, at the places that ``compiled`` has
    c: Array
    A: Array
    b: Array
    lower: Array
    upper: Array
    scale: Array  # change of an unknown by its deviation: the prior's sigma; 1 for other variables
    equal: Flags  # which rows are equalities
    fixed_area: float  # m² of the materials if b has some of sigma 0, which no row of A has; else 0

    def unknowns(self, numbers: Numbers, v: Array) -> Array:
        """Return the unknowns, such as coefficients, for values of the programme's variables.

        The result (n_unknowns,) is the input plus the deviation in ``v`` (size,) times the input sigma.
        ``numbers`` has input and sigma.
        """
        return np.asarray(numbers.mu + numbers.sigma * v[self.compiled.places])

    @functools.cached_property
    def fixed(self) -> Flags:
        """Whether each variable is fixed because its bounds are equal."""
        return np.asarray(self.lower == self.upper)

    @functools.cached_property
    def row_size(self) -> Array:
        """Sum of each row's coefficients; for the row of a matched band it is the total area."""
        unit = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.scale > 0)
        return self.absolute.row_sums(unit)

    @functools.cached_property
    def matrices(self) -> tuple[Any, Any]:
        """Matrices P and A as sparse arrays."""
        of, n, m = self.compiled, len(self.c), len(self.b)
        return (
            sp.csc_array((self.P, (of.P_rows, of.P_columns)), (n, n)),
            sp.csr_array((self.A, (of.A_rows, of.A_columns)), (m, n)),
        )

    def row_sums(self, v: Array, entries: Array | None = None) -> Array:
        """Return A v, (n_rows,), the left sides of the constraints for the variables v (size,).

        ``entries`` replaces the entries of A; None keeps them.
        """
        of, entries = self.compiled, self.A if entries is None else entries
        products = entries * v[of.A_columns]
        return np.asarray(np.bincount(of.A_rows, products, minlength=len(self.b)), float)

    def gradient(self, v: Array) -> Array:
        """Return the gradient P v + c of the objective, (size,)."""
        products = self.P * v[self.compiled.P_columns]
        return self.c + np.bincount(self.compiled.P_rows, products, minlength=len(self.c))

    def force(self, v: Array, y: Array) -> Array:
        """Return P v + c + A'y, (size,): the gradient of the objective and of the constraints.

        At the optimum it is 0 for every variable that is not at a bound. ``v`` (size,) are the
        variables, and ``y`` (n_rows,) the multipliers of the constraints.
        """
        pull = self.A * y[self.compiled.A_rows]
        return self.gradient(v) + np.bincount(self.compiled.A_columns, pull, minlength=len(self.c))

    @functools.cached_property
    def absolute(self) -> QP:
        """QP of the absolute values of P, c, A and b, whose sums bound rounding errors."""
        return replace(self, **{name: np.abs(getattr(self, name)) for name in "PcAb"})

    def at_bounds(self, at: Active) -> Array:
        """Return the variables, (size,), with some at their bounds and all others 0, the input.

        ``at`` (size,) is -1 or 1 for a variable at its lower or upper bound, and else 0.
        """
        held = np.where((at < 0) | self.fixed, self.lower, np.where(at > 0, self.upper, 0.0))
        return np.where(np.isfinite(held), held, 0.0)


class System:
    """Solve the optimality (KKT) conditions of a programme for given active bounds and rows.

        P dv + A'dy = force,  A dv = limit

    P and A are the matrices of ``program``, dv is the step of the variables, and dy are the multipliers
    of the rows. The equations contain the variables for which ``free`` (size,) is True, because they
    are at no bound, and the rows for which ``active`` (n_rows,) is True, because they hold with
    equality. The matrix is factored once. A small number on its diagonal makes it regular if rows
    depend on each other, and iterative refinement removes the effect of that number.
    """

    _SHIFT = 1e-11
    _REFINEMENTS = 4

    def __init__(self, program: QP, free: Flags, active: Flags) -> None:
        norm = np.sqrt(program.row_sums(free.astype(float), program.A**2))
        self.used = active & (norm > 0)
        self._unit = np.divide(1.0, norm, out=np.zeros_like(norm), where=self.used)
        self._on, n = np.concatenate([free, self.used]), len(free) + len(active)
        (rows, columns, place), *structure = program.compiled.kkt
        scale = np.concatenate([free, self._unit])
        entries = np.concatenate([program.P, program.A, program.A, np.zeros(n)])
        entries *= scale[rows] * scale[columns]
        shift = np.where(np.arange(n) < len(free), self._SHIFT, -self._SHIFT)
        self._shift = np.where(self._on, shift, 1.0)
        entries[-n:] = self._shift
        self._matrix = sp.csc_matrix((np.bincount(place, entries), *structure), (n, n))
        try:
            # SuperLU's own threshold of 1 undoes the symmetric order: four times the fill.
            symmetric = {"SymmetricMode": True, "DiagPivotThresh": 0.1}
            self._factors = splu(self._matrix, permc_spec="MMD_AT_PLUS_A", options=symmetric)
        except RuntimeError as error:
            raise SolverError(
                "the optimality conditions are singular: the terms leave a coefficient "
                "undetermined; add a prior or a bound for it"
            ) from error

    def solve(self, force: Array, limit: Array, refine: bool = True) -> tuple[Array, Array]:
        """Return the step of the variables (size, ...) and the multipliers of the rows (n_rows, ...).

        ``force`` (size, ...) and ``limit`` (n_rows, ...) are the right sides of the equations; a second
        axis holds several right sides. The step is 0 for variables that are not free, and the
        multiplier is 0 for rows that are not active. With ``refine`` = False, the small error of the
        regularisation stays in the result.
        """
        right = np.concatenate([force, (limit.T * self._unit).T])
        right[~self._on] = 0.0
        solution, off, residual = np.zeros(right.shape), np.inf, right
        for _ in range(1 + self._REFINEMENTS):
            solution = solution + self._factors.solve(residual)
            if not refine:
                break
            residual = right - self._matrix @ solution + (solution.T * self._shift).T
            before, off = off, np.max(np.abs(residual), initial=0.0)
            if not off < before / 2:
                break
        return solution[: len(force)], (solution[len(force) :].T * self._unit).T


@dataclass(frozen=True, eq=False, repr=False)
class Iterate:
    """Hold an answer to a quadratic programme: variables, multipliers, and which bounds are active.

    The variables ``v``, the multipliers ``z`` of their bounds and the active bounds ``at`` are (size,);
    the multipliers ``y`` of the rows are (n_rows,).
    """

    v: Array  # the variables
    y: Array  # the rows' multipliers
    z: Array  # the bounds' multipliers: above 0 at the upper bound, below 0 at the lower
    at: Active
    system: System | None = None  # the conditions on the active set; None of a solver's own answer
    status: str = ""  # as a solver names it
    iterations: int = 0
    # Not saved: the same calculation has the same file.
    seconds: float = field(default=float("nan"), metadata=NOT_SAVED)

    def active(self, program: QP) -> tuple[Active, Flags]:
        """Return the bounds and rows of a programme that hold with equality at this point.

        A bound or row counts as active if its multiplier is larger than the variable's distance from
        the bound, or the row's from its limit. The bounds are (size,): -1 lower, 1 upper, 0 none. The
        rows are (n_rows,) of bool.
        """
        at = (self.z > program.upper - self.v).astype(np.int8) - (-self.z > self.v - program.lower)
        square = program.row_sums(np.ones(len(self.v)), program.A**2)
        return at, self.y * square > program.b - program.row_sums(self.v)


_ROUNDS = 100
_AT_ONCE = 20
"""Rounds in which the active set changes by all that is wrong at once; then by the worst alone."""
_ROUNDING = 1e-13
"""Share of the sum of the absolute parts of a difference up to which it counts as 0."""


def polish(program: QP, at: Active, tight: Flags) -> Iterate | None:
    """Return the optimum of a programme by the active-set method, from a guess of the active set.

    The guess is ``at`` (size,), -1 or 1 for variables at their lower or upper bound and else 0, and
    ``tight`` (n_rows,), True for inequalities that hold with equality. Each round solves the optimality
    conditions with these as equalities. Bounds and rows that the solution violates then become active;
    if none is violated, active ones with a multiplier of the wrong sign become inactive. Returns None
    if this does not end within 100 rounds. The optimum does not depend on the guess.
    """
    at, tight, absolute = at.copy(), tight | program.equal, program.absolute
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
        rounding = _ROUNDING * (absolute.row_sums(np.abs(v)) + absolute.b)
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
        if alone.any():
            missed = np.where(abs(slack) > rounding, slack, 0.0)
            y, released = _rows_alone(program, v, y, alone, missed, at)
            if released.any():
                at = np.where(released, 0, at).astype(np.int8)
                continue
        force = program.force(v, y)
        tolerance = _ROUNDING * (1 + absolute.force(np.abs(v), np.abs(y)))
        wrong = ((at < 0) & (force < -tolerance)) | ((at > 0) & (force > tolerance))
        released_rows = tight & ~program.equal & (y < 0)
        if not (wrong.any() or released_rows.any()):
            return Iterate(v, y, _of_bounds(force, at), at, system)
        if round_ >= _AT_ONCE:
            wrong, released_rows = _worst((wrong, abs(force)), (released_rows, -y))
        at = np.where(wrong, 0, at).astype(np.int8)
        tight = tight & ~released_rows
    return None


def _of_bounds(force: Array, at: Active) -> Array:
    """Return the multipliers of the active bounds that balance a force."""
    return np.where(at < 0, np.minimum(-force, 0.0), np.where(at > 0, np.maximum(-force, 0.0), 0.0))


def _worst(*parts: tuple[Flags, Array]) -> list[Flags]:
    """Return of flags with their sizes only the one of the largest size."""
    sizes = [np.where(flags, size, -np.inf) for flags, size in parts]
    largest = max(np.max(size, initial=-np.inf) for size in sizes)
    return [size == largest for size in sizes]


def _rows_alone(
    program: QP, v: Array, y: Array, rows: Flags, missed: Array, at: Active
) -> tuple[Array, Flags]:
    """Give rows without a free variable their multipliers; return these and the variables to release.

    A multiplier may lie anywhere in an interval: each variable at its lower bound requires at least
    -gradient / coefficient, each at its upper bound at most that. The value nearest 0 is taken.

    Near an end of a row's range its last free variable is easily mistaken for one at a bound. Of a row
    that misses its limit, the variable at the end of the interval is released: the first to move as the
    multiplier leaves it.
    """
    y, release = np.where(rows, 0.0, y), np.zeros(len(v), dtype=bool)
    gradient = program.force(v, y)
    for row in np.flatnonzero(rows).tolist():
        line = program.matrices[1][[row]].toarray().ravel()
        pull = -at * line
        ends = np.divide(-gradient, line, out=np.zeros_like(line), where=pull != 0)
        at_least, at_most = np.where(pull > 0, ends, -np.inf), np.where(pull < 0, ends, np.inf)
        if at_least.max() <= at_most.min():
            y[row] = np.clip(0.0, at_least.max(), at_most.min())
        if missed[row] > 0:
            release[np.argmax(at_least)] |= (pull > 0).any()
        elif missed[row] < 0:
            release[np.argmin(at_most)] |= (pull < 0).any()
    return y, release


def closed_form(program: QP, at: Active | None = None) -> Iterate | None:
    """Return the optimum of a programme by `polish` from the guess that no inequality is active.

    Returns None if `polish` does. The first round solves one linear system. If the coefficients are
    independent and match T exactly, its solution is the closed form of Bellows & Katz (2025), Eqs. 22
    to 25, as in `rtcal.calibration.exact`; coefficients outside their bounds are then set to these, and
    the system is solved again. ``at`` (size,) is -1 or 1 for variables that start at their lower or
    upper bound and else 0; None if none does. Variables that a term has defined with a lower bound
    start at this bound.
    """
    own = np.isfinite(program.lower)
    own[program.compiled.places] = False
    start = np.where(own, -1, 0 if at is None else at).astype(np.int8)
    return polish(program, start, program.equal)


def solve(
    program: QP,
    at: Active,
    solver: str = "clarabel",
    settings: Mapping[str, Any] | None = None,
    warm_start: bool = True,
) -> Iterate:
    """Return the answer of Clarabel or OSQP to a quadratic programme.

    ``at`` (size,) is -1 or 1 for a variable that stays at its lower or upper bound, and else 0.
    ``solver`` is "clarabel" or "osqp". ``settings`` are settings of the solver by name, which take
    precedence over rtcal's own (`SETTINGS`); None for rtcal's own alone. If ``warm_start`` is True,
    OSQP starts from the optimum that `closed_form` has found. Clarabel has no warm start.

    Raises
    ------
    ModelError
        If the solver does not accept a setting.
    SolverError
        If the solver returns no values.
    """
    of, start = program.compiled, program.at_bounds(at)
    on = (at == 0) & ~program.fixed
    norm = np.sqrt(program.row_sums(1.0 * on, program.A**2))
    unit = np.divide(1.0, norm, out=np.zeros_like(norm), where=norm > 0)
    # A row that says nothing reads 0 <= 1, which leaves the solver an interior.
    silent = np.where(program.equal, 0.0, 1.0)
    limits = np.where(norm > 0, (program.b - program.row_sums(start)) * unit, silent)
    low = np.flatnonzero(on & np.isfinite(program.lower))
    high = np.flatnonzero(on & np.isfinite(program.upper))
    bounds, size, n = np.concatenate([low, high]), len(start), len(norm)
    half = of.P_rows <= of.P_columns
    at_row, at_column = of.P_rows[half], of.P_columns[half]
    P = program.P[half] * (on[at_row] & on[at_column])
    A = program.A * unit[of.A_rows] * on[of.A_columns]
    entries = np.concatenate([A, -np.ones(len(low)), np.ones(len(high))])
    rows = np.concatenate([of.A_rows, n + np.arange(len(bounds))])
    columns = np.concatenate([of.A_columns, bounds])
    given = (
        sp.csc_matrix((P, (at_row, at_column)), (size, size)),
        program.gradient(start) * on,
        sp.csc_matrix((entries, (rows, columns)), (n + len(bounds), size)),
        np.concatenate([limits, (start - program.lower)[low], (program.upper - start)[high]]),
        int(program.equal.sum()),
        {**SETTINGS[solver], **(settings or {})},
    )
    began, first = time.perf_counter(), None
    if solver == "osqp" and warm_start and (form := closed_form(program, at)) is not None:
        z = form.z
        duals = np.concatenate([form.y * norm, np.maximum(-z, 0)[low], np.maximum(z, 0)[high]])
        first = (form.v - start) * on, duals
    try:
        if solver == "clarabel":
            key = low.tobytes(), high.tobytes(), repr(sorted(given[-1].items()))
            x, z, status, iterations = _clarabel(*given, of.solvers, key)
        else:
            x, z, status, iterations = _osqp(*given, first)
    except (TypeError, ValueError, AttributeError, KeyError, OverflowError) as error:
        stated = ", ".join(f"{key}={value!r}" for key, value in given[-1].items())
        raise ModelError(
            f'solver "{solver}" does not accept the settings {stated}: {error}'
        ) from error
    seconds = time.perf_counter() - began
    if x is None or z is None or not (np.isfinite(x).all() and np.isfinite(z).all()):
        raise SolverError(f'solver "{solver}" returned no values; its status is {status}')
    y, below, above = np.split(np.asarray(z), [n, n + len(low)])
    v, y = np.where(on, start + x, start), y * unit
    # What was left out has multipliers, too, and its rows.
    alone = (norm == 0) & (program.row_size > 0)
    y, _ = _rows_alone(program, v, y, alone, np.zeros(n), at)
    z = _of_bounds(program.force(v, y), at)
    z[high] += np.maximum(above, 0.0)
    z[low] -= np.maximum(below, 0.0)
    return Iterate(v, y, z, at, None, status, iterations, seconds)


# A solver is given P's upper triangle, c, A and b with the bounds among the rows, the number of
# equalities and the settings. It returns x, the rows' multipliers, its status and its iterations.
_Answer = tuple[Any, Any, str, int]


def _clarabel(
    P: Any,
    c: Array,
    A: Any,
    b: Array,
    n: int,
    settings: dict[str, Any],
    kept: dict[Any, Any],
    key: Any,
) -> _Answer:
    import clarabel

    # Ordering and analysing a matrix takes half of a solve, and depends on its places alone. A solver
    # is taken out while it works, so that threads do not share one.
    solver = kept.pop(key, None)
    if solver is None:
        chosen = clarabel.DefaultSettings()
        chosen.verbose = False
        for name, value in settings.items():
            setattr(chosen, name, value)
        cones = [clarabel.ZeroConeT(n), clarabel.NonnegativeConeT(len(b) - n)]
        solver = clarabel.DefaultSolver(P, c, A, b, cones, chosen)
    else:
        solver.update(P=P, q=c, A=A, b=b)
    result = solver.solve()
    kept.clear()  # one is kept, which bounds the memory
    if solver.is_data_update_allowed():  # not if it has removed rows
        kept[key] = solver
    return np.array(result.x), np.array(result.z), str(result.status), int(result.iterations)


def _osqp(
    P: Any,
    c: Array,
    A: Any,
    b: Array,
    n: int,
    settings: dict[str, Any],
    first: tuple[Array, Array] | None,
) -> _Answer:
    import osqp

    # Without active rows OSQP's polishing prints a message, even with verbose=False.
    quiet = {"verbose": False, **settings, **({} if n else {"polishing": False})}
    solver = osqp.OSQP()
    solver.setup(P, c, A, np.where(np.arange(len(b)) < n, b, -np.inf), b, **quiet)
    if first is not None:
        solver.warm_start(x=first[0], y=first[1])
    result = solver.solve(raise_error=False)
    return result.x, result.y, str(result.info.status), int(result.info.iter)


_ACCEPTED = 1e-9
"""Largest residual of an answer that is returned; see `Certificate`."""


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """Hold how well an answer satisfies the optimality conditions, and what its error can be at most.

    At the optimum the three residuals are 0 (KKT conditions). They are calculated from the programme's
    numbers, not taken from the solver.

    ``primal_residual`` is the largest violation of a match or bound, ``dual_residual`` the largest
    unbalanced gradient, and ``duality_gap`` the sum of multipliers times distances from bounds.
    ``alpha_error_bound`` (n_materials, n_bands) is the largest possible error of each coefficient.
    ``accepted`` is True if the residuals are at most 1e-9.
    """

    primal_residual: float
    """Largest violation of a match (|S'alpha - b| / sum S) or of a bound, as a coefficient."""
    dual_residual: float
    """Largest unbalanced gradient, max |sigma (gradient + S D - z_lower + z_upper)|."""
    duality_gap: float
    """Sum of multipliers times distances from bounds and inequalities, which is 0 at the optimum."""
    alpha_error_bound: Array
    """Largest possible distance of each coefficient from the optimum, (n_materials, n_bands)."""
    accepted: bool
    """Whether the residuals are at most 1e-9: the primal one; the dual one over 1 and the sum of its
    parts' absolute values; the duality gap over the largest of these sums."""

    @property
    def worst(self) -> float:
        """Largest of the primal residual, the dual residual and the duality gap."""
        return max(self.primal_residual, self.dual_residual, self.duality_gap)

    def __repr__(self) -> str:
        return (
            f"<Certificate: worst residual {self.worst:.1e}, alpha within "
            f"{np.max(self.alpha_error_bound):.1e} of the optimum>"
        )


def certify(program: QP, point: Iterate, convexity: float) -> Certificate:
    """Return the residuals of an answer to a programme, and the largest error that they allow.

    ``point`` has the variables and multipliers of the answer. ``convexity`` is a number m with which f
    - m |x|²/2 is convex, where f is the objective and x are the deviations of the unknowns from the
    input in standard deviations. If all constraints hold, the distance from the optimum x* satisfies

        m |x - x*|² <= |r| |x - x*| + g

    with the dual residual r and the duality gap g. To this distance is added the step by which the
    point misses equalities, and the rounding errors. If m = 0, the error bound is the distance of the
    coefficient from the farther of its bounds.
    """
    v, y, z = point.v, point.y, point.z
    force = program.force(v, y)
    parts = program.absolute.force(np.abs(v), np.abs(y))
    magnitude = 1 + parts
    unbalanced = np.where(program.fixed, 0.0, force + z)
    slack = program.b - program.row_sums(v)
    missed = np.where(program.equal, abs(slack), np.maximum(-slack, 0.0))
    missed = np.divide(missed, program.row_size, out=missed.copy(), where=program.row_size > 0)
    outside = np.maximum(np.maximum(program.lower - v, v - program.upper), 0.0) * program.scale
    to_lower, to_upper = (
        np.where(np.isfinite(room), room, 0.0) for room in (v - program.lower, program.upper - v)
    )
    gap = np.sum(np.abs(z * np.where(z < 0, to_lower, to_upper)))
    gap += np.sum(np.abs(y * slack)[~program.equal])
    primal = max(outside.max(), missed.max(initial=0.0))
    relative = np.max(abs(unbalanced) / magnitude), gap / magnitude.max()
    moved, left, g = np.zeros(len(v)), unbalanced, gap
    if point.system is not None and convexity > 0:
        # What is not active has no multiplier, and so no gap.
        system, absolute, g = point.system, program.absolute, 0.0
        dv, dy = system.solve(-force, slack)
        rest = force + program.force(dv, dy) - program.c
        free = (point.at == 0) & ~program.fixed
        left, moved = np.where(free, np.abs(rest), point.at * rest), np.abs(dv)
        # The residuals have rounding errors of their own. With u = eps / 2 and n materials, a row errs
        # in A v by (n + 1) u |A||v|: n for the sum of products (Higham 2002, Sect. 3.1) and 1 for A =
        # S sigma. v at a bound and alpha = mu + sigma v add 3 u |A||v| + u S'alpha, and b = t - S'mu
        # adds (n + 2) u S'mu + 2 u |b|. S'alpha and S'mu are at most the row at alpha = 1.
        sums = absolute.row_sums(np.abs(v)) + absolute.b
        sums += np.maximum(program.row_size, program.fixed_area)
        n = len(program.compiled.layout.materials)
        errors = _EPS * parts, (n + 4) / 2 * _EPS * sums
        # A row that keeps no variable free is met within rounding; one variable alone can mend it.
        unmet = np.where(program.equal & ~system.used, np.abs(slack) + errors[1], 0.0)
        unmet = unmet[program.compiled.A_rows]
        alone = np.divide(unmet, absolute.A, out=np.zeros_like(unmet), where=absolute.A != 0)
        np.maximum.at(moved, program.compiled.A_columns, alone)
        signs = program.compiled.signs
        if signs[1].shape[1] > 1 and program.compiled.defining is not None:
            left = with_errors(program, left, *errors)
        else:
            each, row = ((sign.T * error).T for sign, error in zip(signs, errors, strict=True))
            moved = moved + np.abs(system.solve(each, row, refine=False)[0]).sum(axis=1)
        left = np.maximum(left, 0.0)
    bound = np.maximum(to_lower, to_upper)
    if convexity > 0:
        r, m = np.linalg.norm(left), convexity
        bound = np.minimum(bound, moved + (r + np.sqrt(r**2 + 4 * m * g)) / (2 * m))
    bound = np.where(program.fixed, 0.0, bound * program.scale)
    return Certificate(
        primal_residual=float(primal),
        dual_residual=float(np.max(abs(unbalanced))),
        duality_gap=float(gap),
        alpha_error_bound=program.compiled.layout.expand(bound[program.compiled.places]),
        accepted=bool(primal <= _ACCEPTED and max(relative) <= _ACCEPTED),
    )


def with_errors(program: QP, left: Array, of_gradient: Array, of_rows: Array) -> Array:
    """Return the residuals of the unknowns with the errors of gradient and rows in them, (size,).

    ``left`` (size,) are the absolute residuals without errors, and ``of_gradient`` (size,) and
    ``of_rows`` (n_rows,) the largest absolute errors. Every row must define a variable
    (`CompiledProblem.defining`). With an error e of its row, this variable moves by e over its entry of
    A, which changes the gradient. Its residual is one of the unknowns that define it.
    """
    of, entries = program.compiled, program.absolute
    defined, pivot = of.A_columns[of.defining], entries.A[of.defining]
    moved = np.zeros(len(left))
    moved[defined] = of_rows / pivot
    error = of_gradient + np.bincount(of.P_rows, entries.P * moved[of.P_columns], len(left))
    pull = entries.A * ((left + error)[defined] / pivot)[of.A_rows]
    left = left + error + np.bincount(of.A_columns, pull, len(left))
    left[defined] = left[program.fixed] = 0.0
    return left
