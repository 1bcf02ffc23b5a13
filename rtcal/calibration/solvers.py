"""The solvers, and how each is called on the compiled problem.

``"clarabel"`` and ``"osqp"`` are called directly on cvxpy's compiled matrices, and their workspaces are
updated in place. Only direct calls can warm-start OSQP: cvxpy ignores ``variable.value``. Clarabel
has no warm start. ``"qpsolvers:NAME"`` calls any solver of
qpsolvers' on the same matrices. Any other name is a solver of cvxpy's, called through cvxpy.
"""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.calibration.compiled_qp import CompiledQP
from rtcal.support import checks
from rtcal.support.errors import MissingDependencyError, ModelError, SolverError
from rtcal.support.types import Array

Unreachable = Literal["raise", "nearest"]
WarmStart = Literal["auto", "closed_form", "none"]

STARTED = ("osqp", "qpsolvers:osqp", "qpsolvers:daqp", "qpsolvers:proxqp", "qpsolvers:scs")
"""Solvers that take a start."""


class SolveKeywords(TypedDict, total=False):
    """The keyword arguments of `SolveOptions`, for the functions that pass them on."""

    solver: str
    unreachable: Unreachable
    warm_start: WarmStart
    settings: Mapping[str, Any] | None


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """The options of one solve.

    Parameters
    ----------
    solver : str
        ``"clarabel"``, ``"osqp"``, another solver of cvxpy's, or ``"qpsolvers:NAME"``.
    unreachable : {"raise", "nearest"}
        What to do where no coefficients within the bounds give the measured T. ``"raise"`` raises
        InfeasibleError; ``"nearest"`` takes the nearest T within reach and lists the band in the
        result.
    warm_start : {"auto", "closed_form", "none"}
        ``"auto"`` starts a solver that takes a start from the paper's closed form, if the problem has
        one. ``"closed_form"`` raises ModelError where that cannot be. Clarabel takes no start.
    settings : mapping, optional
        The solver's own settings by name, beside rtcal's; ``{}`` for rtcal's alone. Without it,
        Clarabel may run with looser ones first; ``result.raw.settings`` says with which.

    Raises
    ------
    DataError, ModelError
        For a value that is not allowed.
    """

    solver: str = "clarabel"
    unreachable: Unreachable = "raise"
    warm_start: WarmStart = "auto"
    settings: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str):
            raise ModelError(f'solver = {self.solver!r} is not a name such as "clarabel"')
        checks.choice("unreachable", self.unreachable, ("raise", "nearest"))
        if not isinstance(self.warm_start, str) or self.warm_start not in (
            "auto",
            "closed_form",
            "none",
        ):
            raise ModelError(
                f'warm_start = {self.warm_start!r} is not "auto", "closed_form" or "none"'
            )
        if not isinstance(self.settings, Mapping | None):
            raise ModelError(f"settings = {self.settings!r} is not a mapping of name to value")
        for key in self.settings or {}:
            if not isinstance(key, str):
                raise ModelError(f"settings has {key!r}, which is no setting's name")
        if self.warm_start == "closed_form" and not self.takes_start:
            raise ModelError(f'solver "{self.solver}" takes no warm start; {", ".join(STARTED)} do')

    @property
    def takes_start(self) -> bool:
        """Whether the solver takes a start."""
        return self.solver.lower() in STARTED


SETTINGS: dict[str, dict[str, Any]] = {
    # At the default 1e-8, some answers with status "solved" have errors of 2e-4. The whitened problem
    # needs no equilibration: it takes 7 iterations without it, 10 with it.
    "CLARABEL": {
        "tol_feas": 1e-10,
        "tol_gap_abs": 1e-10,
        "tol_gap_rel": 1e-10,
        "equilibrate_enable": False,
    },
    # At its default 1e-3, every second answer has an error above 1e-6. Feasibility is checked before,
    # and with its default 1e-4 OSQP calls feasible targets infeasible.
    "OSQP": {
        "eps_abs": 1e-8,
        "eps_rel": 1e-8,
        "max_iter": 20_000,
        "polishing": True,
        "eps_prim_inf": 1e-14,
        # At its default of 25 iterations, a start at the optimum is noticed 20 iterations late.
        "check_termination": 5,
    },
    "SCS": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 100_000},
}
"""Settings by solver, in cvxpy's capital spelling; solvers not named run at their defaults."""

QUICK = {
    "tol_feas": 1e-8,
    "tol_gap_abs": 1e-8,
    "tol_gap_rel": 1e-8,
    "iterative_refinement_enable": False,
}
"""Clarabel's settings where polishing asks for the active bounds alone: its own default tolerance, and
no iterative refinement."""


@dataclass(frozen=True)
class SolverOutput:
    """A solver's answer, not yet checked.

    Attributes
    ----------
    x : array (size,)
        The whitened unknowns.
    row_duals : list of array
        cvxpy's dual value of each row constraint.
    lower_dual, upper_dual : array (size,)
        Dual values of the box, 0 or more.
    status : str
        As the solver names it.
    iterations : int
    seconds : float
        The solver's own time; NaN if it states none.
    """

    x: Array
    row_duals: list[Array]
    lower_dual: Array
    upper_dual: Array
    status: str
    iterations: int
    seconds: float


def settings_of(options: SolveOptions) -> dict[str, Any]:
    """Return the settings that a solve runs with: the options' override those of `SETTINGS`."""
    return {**SETTINGS.get(options.solver.upper(), {}), **(options.settings or {})}


def run(
    compiled: CompiledQP, options: SolveOptions, start: tuple[Array, list[Array]] | None = None
) -> SolverOutput:
    """Solve the compiled problem with the numbers that its parameters now hold.

    Parameters
    ----------
    compiled : CompiledQP
    options : SolveOptions
        The solver's name, in any case of letters, and its settings; see `settings_of`.
    start : (x, row duals), optional
        Primal and dual start of a problem without helper variables, for a solver that takes one.
        qpsolvers passes on the primal one.

    Raises
    ------
    ModelError
        If the solver refuses a setting.
    MissingDependencyError
        If the solver is not installed.
    SolverError
        If it returns no values.
    """
    name = options.solver.lower()
    chosen = settings_of(options)
    if name == "clarabel":
        return _clarabel(compiled, chosen)
    if name == "osqp":
        return _osqp(compiled, chosen, start)
    if name.startswith("qpsolvers:"):
        return _qpsolvers(compiled, name.removeprefix("qpsolvers:"), chosen, start)
    return _cvxpy(compiled, name.upper(), chosen)


@functools.cache
def _installed() -> dict[str, str]:
    """cvxpy's installed solvers by capital name, cached since the query takes milliseconds."""
    return {str(s).upper(): str(s) for s in cp.installed_solvers()}


def _cvxpy(compiled: CompiledQP, name: str, settings: dict[str, Any]) -> SolverOutput:
    installed = _installed()
    if name not in installed:
        have = ", ".join(sorted(s.lower() for s in installed))
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
            problem.solve(solver=installed[name], warm_start=False, **settings)
        except cp.SolverError as error:
            raise SolverError(f'solver "{name.lower()}" failed: {error}') from error
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise _refused(name.lower(), settings, error) from error
    x, stats = compiled.x.value, problem.solver_stats
    if x is None or not np.isfinite(x).all():
        raise SolverError(f"the solver returned no values; its status is {problem.status}")
    return SolverOutput(
        x=np.array(x, dtype=float),
        row_duals=[_dual(c) for c in compiled.rows],
        lower_dual=np.maximum(_dual(compiled.lower), 0.0),
        upper_dual=np.maximum(_dual(compiled.upper), 0.0),
        status=str(problem.status),
        iterations=int(stats.num_iters or 0),
        seconds=float(stats.solve_time or np.nan),
    )


def _dual(constraint: Any) -> Array:
    value = constraint.dual_value
    return np.zeros(constraint.size) if value is None else np.array(value, dtype=float).ravel()


def _refused(name: str, settings: Mapping[str, Any], error: Exception) -> ModelError:
    stated = ", ".join(f"{key}={value!r}" for key, value in settings.items())
    return ModelError(f'solver "{name}" refuses the settings {stated}: {error}')


def _clarabel(compiled: CompiledQP, settings: dict[str, Any]) -> SolverOutput:
    import clarabel

    numbers = compiled.numbers()
    began = time.perf_counter()
    given, solver = compiled.workspaces.pop("clarabel", ({}, None))
    if solver is not None and given == settings:
        names = "Ab" if compiled.fixed_objective else "PqAb"
        # It reads lists twice as fast as arrays.
        solver.update(**{name: getattr(numbers, name).tolist() for name in names})
    else:
        chosen = clarabel.DefaultSettings()
        chosen.verbose = False
        for key, value in settings.items():
            if not hasattr(chosen, key):
                raise ModelError(f'solver "clarabel" has no setting "{key}"')
            try:
                setattr(chosen, key, value)
            except (TypeError, OverflowError) as error:
                raise _refused("clarabel", settings, error) from error
        qp = compiled.matrices(numbers)
        cones = [clarabel.ZeroConeT(qp.n_equal), clarabel.NonnegativeConeT(len(qp.b) - qp.n_equal)]
        solver = clarabel.DefaultSolver(qp.P_upper, qp.q, qp.A, qp.b, cones, chosen)
    result = solver.solve()
    # Equilibration would be that of the first numbers, and would let an answer depend on them.
    if not settings.get("equilibrate_enable", True) and solver.is_data_update_allowed():
        compiled.workspaces["clarabel"] = settings, solver
    return _from_values(
        compiled,
        "clarabel",
        np.array(result.x),
        np.array(result.z),
        str(result.status),
        int(result.iterations),
        time.perf_counter() - began,
    )


def _osqp(
    compiled: CompiledQP, settings: dict[str, Any], start: tuple[Array, list[Array]] | None
) -> SolverOutput:
    import osqp

    numbers = compiled.numbers()
    low = numbers.b.copy()
    low[compiled.n_equal :] = -np.inf
    if compiled.n_equal == 0 and settings.get("polishing"):
        # Without active rows OSQP's polishing prints a message, even with verbose=False.
        settings = {**settings, "polishing": False}
    given, solver = compiled.workspaces.pop("osqp", ({}, None))
    try:
        if solver is not None and given == settings:
            solver.update(q=numbers.q, l=low, u=numbers.b, Px=numbers.P, Ax=numbers.A)
            solver.update_settings(rho=solver.settings.rho)  # the last solve has adapted its own
        else:
            qp = compiled.matrices(numbers)
            solver = osqp.OSQP()
            solver.setup(qp.P_upper, qp.q, qp.A, low, qp.b, **{"verbose": False, **settings})
    except Exception as error:  # TypeError, ValueError or osqp's own, by version
        raise _refused("osqp", settings, error) from error
    x, duals = start or (np.zeros(len(numbers.q)), [np.zeros(len(numbers.b))])
    solver.warm_start(x=x, y=np.concatenate(duals))
    result = solver.solve(raise_error=False)
    compiled.workspaces["osqp"] = settings, solver
    return _from_values(
        compiled,
        "osqp",
        result.x,
        result.y,
        str(result.info.status),
        int(result.info.iter),
        float(result.info.run_time),
    )


def _qpsolvers(
    compiled: CompiledQP,
    name: str,
    settings: dict[str, Any],
    start: tuple[Array, list[Array]] | None,
) -> SolverOutput:
    import qpsolvers

    if name not in qpsolvers.available_solvers:
        have = ", ".join(sorted(qpsolvers.available_solvers))
        raise MissingDependencyError(f'qpsolvers has no solver "{name}" here; it has {have}')
    qp = compiled.matrices()
    rows = sp.csr_matrix(qp.A)
    matrices = [qp.P, sp.csc_matrix(rows[qp.n_equal :]), sp.csc_matrix(rows[: qp.n_equal])]
    if name not in qpsolvers.sparse_solvers:
        matrices = [m.toarray() for m in matrices]
    quadratic, unequal, equal = matrices
    problem = qpsolvers.Problem(
        quadratic, qp.q, unequal, qp.b[qp.n_equal :], equal, qp.b[: qp.n_equal]
    )
    began = time.perf_counter()
    try:
        solution = qpsolvers.solve_problem(
            problem, solver=name, initvals=None if start is None else start[0], **settings
        )
    except Exception as error:  # backends raise errors of many kinds; all mean that it failed
        raise SolverError(f'solver "qpsolvers:{name}" failed: {error}') from error
    seconds = time.perf_counter() - began
    y = np.zeros(len(qp.b))
    if solution.y is not None:
        y[: qp.n_equal] = solution.y
    if solution.z is not None:
        y[qp.n_equal :] = solution.z
    status = "solved" if solution.found else "not found"
    return _from_values(compiled, f"qpsolvers:{name}", solution.x, y, status, 0, seconds)


def _from_values(
    compiled: CompiledQP,
    name: str,
    x: Array | None,
    y: Array,
    status: str,
    iterations: int,
    seconds: float,
) -> SolverOutput:
    """Read the answer of a solver that was called on the compiled matrices."""
    if x is None or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise SolverError(f'solver "{name}" returned no values; its status is {status}')
    unknowns, (*rows, lower, upper) = compiled.unpack(x, y)
    return SolverOutput(
        x=unknowns,
        row_duals=rows,
        lower_dual=np.maximum(lower, 0.0),
        upper_dual=np.maximum(upper, 0.0),
        status=status,
        iterations=iterations,
        seconds=seconds,
    )
