"""The ways to a solver: each takes a case and returns what the solver said, unchecked.

``qpsolvers:NAME`` calls it through qpsolvers, ``own:NAME`` by its own interface, ``cvxpy:NAME``
through one cvxpy problem that is built once, ``rtcal:NAME raw`` and ``rtcal:NAME`` through
`rtcal.calibrate`'s path before and after polishing, ``rtcal.exact`` is the batch solver.
"""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cvxpy as cp
import numpy as np
import qpsolvers
import scipy.optimize
import scipy.sparse as sp
from qpbenchmark.solver_settings import SolverSettings

import rtcal as rt
from benchmarks.solvers.cases import Case
from rtcal.support.types import Array

EPS = {"low_accuracy": 1e-3, "mid_accuracy": 1e-6, "high_accuracy": 1e-9}
NAMES = ("clarabel", "osqp", "highs", "daqp", "piqp", "proxqp", "scs", "quadprog")
# Unknowns, beyond which a route only costs time or memory.
DENSE_LIMIT = 2000  # qpsolvers' dense solvers
CVXPY_LIMIT = 400  # its rows are one dense parameter here
SLSQP_LIMIT = 50


@dataclass(frozen=True, eq=False)
class Found:
    """The answer of a solver: x, the duals y of the equalities and z of the inequalities, and its word.

    ``status`` is solved, infeasible (where a solver tells) or failed. ``own`` are residuals of the
    certificate, for a route whose duals are not those of the matrices.
    """

    status: str
    seconds: float
    x: Array | None = None
    y: Array | None = None
    z: Array | None = None
    alpha: Array | None = None
    iterations: int = 0
    own: tuple[float, float, float] | None = field(default=None)


Route = Callable[[Case, SolverSettings, str], Found]


def by_qpsolvers(name: str, case: Case, settings: SolverSettings, setting: str) -> Found:
    problem = case.to_sparse() if name in qpsolvers.sparse_solvers else case.to_dense()
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = qpsolvers.solve_problem(problem, solver=name, **settings[name])
    except Exception:  # backends raise errors of many kinds; all mean that there is no answer
        return Found("failed", time.perf_counter() - began)
    seconds = time.perf_counter() - began
    status = "solved" if found.found and found.x is not None else "failed"
    return Found(status, seconds, found.x, found.y, found.z)


def by_clarabel(case: Case, settings: SolverSettings, setting: str) -> Found:
    import clarabel

    qp = case.whitened.matrices
    chosen = clarabel.DefaultSettings()
    chosen.verbose = False
    for key, value in settings["clarabel"].items():
        setattr(chosen, key, value)
    cones = [clarabel.ZeroConeT(qp.n_equal), clarabel.NonnegativeConeT(len(qp.b) - qp.n_equal)]
    began = time.perf_counter()
    result = clarabel.DefaultSolver(
        sp.triu(qp.P, format="csc"), qp.q, qp.A, qp.b, cones, chosen
    ).solve()
    seconds = time.perf_counter() - began
    word = str(result.status)
    status = "solved" if word == "Solved" else "infeasible" if "Infeasible" in word else "failed"
    y = np.array(result.z)
    return Found(
        status,
        seconds,
        np.array(result.x),
        y[: qp.n_equal],
        y[qp.n_equal :],
        iterations=int(result.iterations),
    )


def by_osqp(
    case: Case, settings: SolverSettings, setting: str, start: tuple[Array, Array] | None = None
) -> Found:
    import osqp

    qp = case.whitened.matrices
    low = qp.b.copy()
    low[qp.n_equal :] = -np.inf
    began = time.perf_counter()
    solver = osqp.OSQP()
    solver.setup(
        sp.triu(qp.P, format="csc"),
        qp.q,
        qp.A,
        low,
        qp.b,
        **{"verbose": False, **settings["osqp"]},
    )
    if start is not None:
        solver.warm_start(x=start[0], y=start[1])
    result = solver.solve(raise_error=False)
    seconds = time.perf_counter() - began
    word = str(result.info.status)
    status = "solved" if word == "solved" else "infeasible" if "infeasible" in word else "failed"
    y = np.asarray(result.y)
    return Found(
        status,
        seconds,
        np.asarray(result.x),
        y[: qp.n_equal],
        y[qp.n_equal :],
        iterations=int(result.info.iter),
    )


@functools.cache
def _built(n: int, bands: int) -> tuple[Any, Any, list[Any], list[Any]]:
    x = cp.Variable(n)
    rows, target = cp.Parameter((bands, n)), cp.Parameter(bands)
    scale, low, high = cp.Parameter(n, nonneg=True), cp.Parameter(n), cp.Parameter(n)
    moved = cp.multiply(scale, x)
    constraints = [rows @ x == target, moved >= low, moved <= high]
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(x)), constraints)
    return problem, x, constraints, [rows, target, scale, low, high]


def by_cvxpy(name: str, case: Case, settings: SolverSettings, setting: str) -> Found:
    qp, n = case.whitened.matrices, case.unknowns
    problem, x, constraints, parameters = _built(n, qp.n_equal)
    lower = np.zeros(n) if case.separable is None else case.separable.lower.ravel()
    values = [
        qp.A[: qp.n_equal].toarray(),
        qp.b[: qp.n_equal],
        case.whitened.scale,
        lower - case.whitened.centre,
        1.0 - case.whitened.centre,
    ]
    for parameter, value in zip(parameters, values, strict=True):
        parameter.value = value
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=name, warm_start=False, **settings[name.lower()])
    except Exception:  # cvxpy's and the backends' own kinds
        return Found("failed", time.perf_counter() - began)
    seconds = time.perf_counter() - began
    word = str(problem.status)
    status = "solved" if word == "optimal" else "infeasible" if "infeasible" in word else "failed"
    if status != "solved" or x.value is None:
        return Found(status, seconds)
    duals = [c.dual_value for c in constraints]
    z = None if any(d is None for d in duals) else np.concatenate(duals[1:])
    return Found(status, seconds, x.value, duals[0], z)


def by_slsqp(case: Case, settings: SolverSettings, setting: str) -> Found:
    dense = case.to_dense()
    began = time.perf_counter()
    constraints = [
        {"type": "ineq", "fun": lambda x: dense.h - dense.G @ x, "jac": lambda x: -dense.G}
    ]
    if dense.A is not None:
        constraints.append(
            {"type": "eq", "fun": lambda x: dense.A @ x - dense.b, "jac": lambda x: dense.A}
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = scipy.optimize.minimize(
            lambda x: 0.5 * x @ dense.P @ x + dense.q @ x,
            np.zeros(len(dense.q)),
            method="SLSQP",
            jac=lambda x: dense.P @ x + dense.q,
            constraints=constraints,
            options={} if setting == "default" else {"ftol": EPS[setting]},
        )
    status = "solved" if found.success else "failed"
    return Found(status, time.perf_counter() - began, found.x, iterations=int(found.nit))


def by_rtcal(
    name: str, polished: bool, case: Case, settings: SolverSettings, setting: str
) -> Found:
    chosen = None if setting == "default" else settings[name]
    began = time.perf_counter()
    try:
        result: Any = case.built.solve(case.measured, case.room, solver=name, settings=chosen)
    except rt.errors.InfeasibleError:
        return Found("infeasible", time.perf_counter() - began)
    except rt.errors.SolverError:
        return Found("failed", time.perf_counter() - began)
    seconds = time.perf_counter() - began
    joint = getattr(result, "joint", result)
    c = joint.certificate if polished else joint.raw_certificate
    residuals = (c.primal_residual, c.dual_residual, c.duality_gap)
    word = "solved" if polished else joint.raw.status.lower()
    status = word if word == "solved" else "infeasible" if "infeasible" in word else "failed"
    return Found(
        status,
        seconds if polished else joint.raw.seconds,
        alpha=joint.alpha if polished else joint.raw_alpha,
        own=tuple(float(np.max(r)) for r in residuals),
        iterations=joint.raw.iterations,
    )


def by_exact(case: Case, settings: SolverSettings, setting: str) -> Found:
    began = time.perf_counter()
    answer = case.separable.solve()
    seconds = time.perf_counter() - began
    if (answer.status != rt.exact.OK).any():
        return Found("infeasible", seconds)
    alpha, given = answer.alpha.T, case.separable
    # Its residuals: the sums it reaches, relative, and stationarity where it is inside the bounds.
    missed = np.abs(given.areas @ alpha - given.target)
    pull = (alpha - given.mu) + answer.multiplier * given.areas[:, None] * given.sigma**2
    sigma = np.where(given.sigma > 0, given.sigma, 1.0)
    inside = (alpha > given.lower) & (alpha < 1)
    primal = float(np.nanmax(missed) / given.areas.sum())
    dual = float(np.max(np.abs(pull / sigma) * inside))
    return Found("solved", seconds, alpha=alpha, own=(primal, dual, 0.0))


def available() -> dict[str, Route]:
    """The routes that run here, by name; quadprog (GPL) only where the user has it."""
    part = functools.partial
    found: dict[str, Route] = {
        f"qpsolvers:{n}": part(by_qpsolvers, n) for n in NAMES if n in qpsolvers.available_solvers
    }
    found |= {"own:clarabel": by_clarabel, "own:osqp": by_osqp}
    installed = {str(s) for s in cp.installed_solvers()}
    for n in NAMES:
        if n.upper() in installed:
            found[f"cvxpy:{n}"] = part(by_cvxpy, n.upper())
    found["scipy:slsqp"] = by_slsqp
    for n in ("clarabel", "osqp"):
        found[f"rtcal:{n} raw"] = part(by_rtcal, n, False)
        found[f"rtcal:{n}"] = part(by_rtcal, n, True)
    found["rtcal.exact"] = by_exact
    return found


def settings_of(route: str) -> tuple[str, ...]:
    """The settings a route is run at; ``rtcal.exact`` has none."""
    return ("default",) if route == "rtcal.exact" else ("default", *EPS)


def fits(route: str, case: Case) -> bool:
    """Whether a route can, or can in reasonable time, take a case."""
    if route == "rtcal.exact":
        return case.separable is not None
    if route == "scipy:slsqp":
        return case.unknowns <= SLSQP_LIMIT
    if route.startswith("cvxpy:"):
        return case.separable is not None and case.unknowns <= CVXPY_LIMIT
    name = route.removeprefix("qpsolvers:")
    dense = route.startswith("qpsolvers:") and name not in qpsolvers.sparse_solvers
    return len(case.q) <= DENSE_LIMIT or not dense
