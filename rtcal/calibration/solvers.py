"""One table of solvers, and how each is called on the compiled problem.

``"clarabel"`` and every other solver of cvxpy's are called through cvxpy. ``"osqp"`` is called on
cvxpy's compiled matrices by its own interface, because only so can it be started from a given
point: cvxpy ignores ``variable.value``, and Clarabel has no warm start at all.
``"qpsolvers:NAME"`` calls any solver of qpsolvers' on the same matrices.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.errors import MissingDependencyError, ModelError, SolverError
from rtcal.types import Array

# SOLVED, for cvxpy's reading of an OSQP answer.
_OSQP_SOLVED = 1

SETTINGS: dict[str, dict[str, Any]] = {
    # At the default 1e-8, single answers are off by 2e-4 although "solved".
    "CLARABEL": {"tol_feas": 1e-10, "tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10},
    # At its default 1e-3 every second answer is off by more than 1e-6.
    # What can be reached was checked before; left at 1e-4, OSQP calls feasible targets infeasible.
    "OSQP": {
        "eps_abs": 1e-8,
        "eps_rel": 1e-8,
        "max_iter": 20_000,
        "polishing": True,
        "eps_prim_inf": 1e-14,
    },
    "SCS": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 100_000},
}
"""Settings by solver, in cvxpy's capital spelling; solvers not named run at their defaults."""


@dataclass(frozen=True)
class Answer:
    """What a solver said, before anything is checked.

    Attributes
    ----------
    x : array (size,)
        Whitened unknowns.
    row_duals : list of array
        cvxpy's dual value of each row constraint.
    lower_dual, upper_dual : array (size,)
        Of the box, 0 or more.
    status : str
        The solver's own word.
    iterations : int
    seconds : float
        The solver's own time; NaN where it does not tell.
    """

    x: Array
    row_duals: list[Array]
    lower_dual: Array
    upper_dual: Array
    status: str
    iterations: int
    seconds: float


@dataclass(frozen=True)
class Compiled:
    """A cvxpy problem that is built, with its unknown and its constraints in order."""

    problem: Any
    x: Any
    rows: tuple[Any, ...]
    lower: Any
    upper: Any

    def answer(self, status: str, iterations: int, seconds: float) -> Answer:
        """Collect the values that cvxpy has put into its variables and constraints."""
        if self.x.value is None or not np.isfinite(self.x.value).all():
            raise SolverError(f"the solver returned no values; its status is {status}")
        return Answer(
            x=np.array(self.x.value, dtype=float),
            row_duals=[_dual(c) for c in self.rows],
            lower_dual=np.maximum(_dual(self.lower), 0.0),
            upper_dual=np.maximum(_dual(self.upper), 0.0),
            status=status,
            iterations=iterations,
            seconds=seconds,
        )


def _dual(constraint: Any) -> Array:
    value = constraint.dual_value
    return np.zeros(constraint.size) if value is None else np.array(value, dtype=float).ravel()


def run(
    compiled: Compiled,
    solver: str,
    settings: Mapping[str, Any] | None = None,
    start: tuple[Array, list[Array]] | None = None,
) -> Answer:
    """Solve the compiled problem with the numbers that its parameters now hold.

    Parameters
    ----------
    compiled : Compiled
    solver : str
        A cvxpy solver in any case, or ``"qpsolvers:NAME"``.
    settings : mapping, optional
        The solver's own settings, over those of `SETTINGS`.
    start : (x, row duals), optional
        Primal and dual warm start; only OSQP can use one.

    Raises
    ------
    ModelError
        If the solver's name is unknown or it takes no warm start.
    MissingDependencyError
        If the solver is not installed.
    SolverError
        If it returns no values.
    """
    name = solver.lower()
    chosen = {**SETTINGS.get(name.upper(), {}), **(settings or {})}
    if start is not None and name != "osqp":
        raise ModelError(f'solver "{solver}" takes no warm start; only "osqp" does')
    if name == "osqp":
        return _osqp(compiled, chosen, start)
    if name.startswith("qpsolvers:"):
        return _qpsolvers(compiled, name.removeprefix("qpsolvers:"), chosen)
    return _cvxpy(compiled, name.upper(), chosen)


@functools.cache
def _installed() -> dict[str, str]:
    """Cvxpy's installed solvers by capital name; asking costs milliseconds."""
    return {str(s).upper(): str(s) for s in cp.installed_solvers()}


def _cvxpy(compiled: Compiled, name: str, settings: dict[str, Any]) -> Answer:
    known = _installed()
    if name not in known:
        have = ", ".join(sorted(s.lower() for s in known))
        raise MissingDependencyError(
            f'solver "{name.lower()}" is not installed; cvxpy here has {have}, and qpsolvers '
            'solvers are called "qpsolvers:NAME"'
        )
    problem = compiled.problem
    with warnings.catch_warnings():
        # cvxpy warns of an inaccurate answer; here the certificate judges every answer.
        warnings.simplefilter("ignore", UserWarning)
        try:
            # A cached solver is reused by some interfaces in ways that fail on new matrices.
            problem.solve(solver=known[name], warm_start=False, **settings)
        except cp.SolverError as error:
            raise SolverError(f'solver "{name.lower()}" failed: {error}') from error
    stats = problem.solver_stats
    return compiled.answer(
        str(problem.status), int(stats.num_iters or 0), float(stats.solve_time or np.nan)
    )


def _osqp(
    compiled: Compiled, settings: dict[str, Any], start: tuple[Array, list[Array]] | None
) -> Answer:
    import osqp

    data, chain, inverse = compiled.problem.get_problem_data(cp.OSQP)
    matrix = sp.csc_matrix(sp.vstack([data["A"], data["F"]]))
    low = np.concatenate([data["b"], np.full(data["n_ineq"], -np.inf)])
    high = np.concatenate([data["b"], data["G"]])
    solver = osqp.OSQP()
    quadratic = sp.csc_matrix(sp.triu(data["P"]))
    solver.setup(quadratic, data["q"], matrix, low, high, verbose=False, **settings)
    if start is not None:
        x, duals = start
        column = data["param_prob"].var_id_to_col[compiled.x.id]
        if len(x) != data["n_var"] or column != 0:
            raise ModelError("a warm start fits only a problem without helper variables")
        y = np.zeros(matrix.shape[0])
        given = np.concatenate(duals) if duals else np.zeros(0)
        y[: len(given)] = given
        solver.warm_start(x=x, y=y)
    result = solver.solve(raise_error=False)
    status = str(result.info.status)
    if result.x is None or not np.isfinite(result.x).all():
        raise SolverError(f'solver "osqp" returned no values; its status is {status}')
    _unpack(compiled, chain, inverse, result.x, result.y, result.info.iter, result.info.run_time)
    return compiled.answer(status, int(result.info.iter), float(result.info.run_time))


def _qpsolvers(compiled: Compiled, name: str, settings: dict[str, Any]) -> Answer:
    import time

    import qpsolvers

    if name not in qpsolvers.available_solvers:
        have = ", ".join(sorted(qpsolvers.available_solvers))
        raise MissingDependencyError(f'qpsolvers has no solver "{name}" here; it has {have}')
    data, chain, inverse = compiled.problem.get_problem_data(cp.OSQP)
    as_given = sp.csc_matrix
    if name in qpsolvers.dense_solvers and name not in qpsolvers.sparse_solvers:
        as_given = lambda m: m.toarray()  # noqa: E731
    problem = qpsolvers.Problem(
        as_given(data["P"]),
        data["q"],
        as_given(data["F"]),
        data["G"],
        as_given(data["A"]),
        data["b"],
    )
    began = time.perf_counter()
    try:
        solution = qpsolvers.solve_problem(problem, solver=name, **settings)
    except Exception as error:  # backends raise errors of many kinds; all mean that it failed
        raise SolverError(f'solver "qpsolvers:{name}" failed: {error}') from error
    seconds = time.perf_counter() - began
    if solution.x is None:
        raise SolverError(f'solver "qpsolvers:{name}" returned no values')
    duals = [
        np.zeros(size) if dual is None else dual
        for dual, size in ((solution.y, data["n_eq"]), (solution.z, data["n_ineq"]))
    ]
    _unpack(compiled, chain, inverse, solution.x, np.concatenate(duals), 0, seconds)
    return compiled.answer("solved" if solution.found else "not found", 0, seconds)


def _unpack(
    compiled: Compiled,
    chain: Any,
    inverse: Any,
    x: Array,
    y: Array,
    iterations: int,
    seconds: float,
) -> None:
    """Let cvxpy put values and duals where they belong; the true status is kept apart."""
    info = SimpleNamespace(status_val=_OSQP_SOLVED, obj_val=0.0, iter=iterations, run_time=seconds)
    compiled.problem.unpack_results(SimpleNamespace(x=x, y=y, info=info), chain, inverse)
