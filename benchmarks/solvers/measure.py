"""What is measured: everything is computed here from x, y, z; no solver's own residual is taken."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import qpsolvers
from qpbenchmark.solver_settings import SolverSettings
from qpbenchmark.tolerance import Tolerance

import rtcal as rt
from benchmarks.solvers.cases import RANDOM, Case, Rooms
from benchmarks.solvers.routes import Found, Route, by_clarabel, by_osqp

NAN = float("nan")


@dataclass(frozen=True)
class Row:
    """One solve. NaN where there is nothing to compute; ``within`` bounds the truth's own error."""

    problem: str
    family: str
    unknowns: int
    feasible: bool
    route: str
    settings: str
    status: str
    error: float
    within: float
    primal: float
    dual: float
    gap: float
    passes: bool
    microseconds: float
    iterations: int

    @property
    def failed(self) -> bool:
        """No answer where there is one."""
        return self.feasible and self.status != "solved"

    @property
    def wrong(self) -> bool:
        """Called solved, yet off by more than 1e-4, or there is no answer."""
        return self.off(1e-4)

    def off(self, limit: float) -> bool:
        """Whether it is called solved, yet off by more than ``limit``, not finite or impossible."""
        return self.status == "solved" and not (self.feasible and self.error <= limit)

    @property
    def detected(self) -> bool:
        """An infeasible problem that was not called solved."""
        return not self.feasible and self.status != "solved"


def judge(case: Case, route: str, setting: str, found: Found, tolerance: Tolerance) -> Row:
    """Hold an answer against the truth and against the optimality conditions."""
    error = primal = dual = gap = NAN
    if found.status == "solved":
        alpha = found.alpha if found.x is None else case.whitened.alpha(found.x)
        if case.alpha is not None:
            error = float(np.max(np.abs(alpha - case.alpha)))
        if found.own is not None:
            primal, dual, gap = found.own
        elif found.x is not None and np.isfinite(found.x).all():
            primal, dual, gap = residuals(case, found)
    passes = primal <= tolerance.primal and dual <= tolerance.dual and gap <= tolerance.gap
    return Row(
        case.name, case.family, case.unknowns, case.alpha is not None, route, setting,
        found.status, error, case.alpha_within, primal, dual, gap, bool(passes),
        1e6 * found.seconds, found.iterations,
    )  # fmt: skip


def residuals(case: Case, found: Found) -> tuple[float, float, float]:
    """Primal and dual residual and duality gap by qpsolvers' `Solution`; NaN without duals."""
    solution = qpsolvers.Solution(
        case, found=True, x=found.x, y=np.zeros(0) if case.A is None else found.y, z=found.z,
        z_box=np.zeros(0),
    )  # fmt: skip
    primal = float(solution.primal_residual())
    if found.z is None or (case.A is not None and found.y is None):
        return primal, NAN, NAN
    return primal, float(solution.dual_residual()), float(solution.duality_gap())


def timed(route: Route, case: Case, settings: SolverSettings, setting: str) -> Found:
    """Solve twice where that is quick and keep the quicker: the first call pays for caches."""
    first = route(case, settings, setting)
    if first.seconds > 0.02:
        return first
    second = route(case, settings, setting)
    return second if second.seconds < first.seconds else first


def iterations(count: int, seed: int = 7) -> Iterator[tuple[str, str, int]]:
    """Yield (problem, start, OSQP's iterations) cold and from three warm starts, eps 1e-8."""
    settings = SolverSettings()
    settings.set_eps_abs(1e-8)
    settings.set_eps_rel(1e-8)
    settings.set_param("osqp", "check_termination", 1)  # its 25 would round every count up
    exact = SolverSettings()
    exact.set_eps_abs(1e-12)
    exact.set_eps_rel(1e-12)
    test_set = Rooms("full", seed)
    previous: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for number, case in enumerate(test_set._random()):
        if number % RANDOM >= count:
            continue
        qp = case.whitened.matrices
        rows = qp.A[: qp.n_equal]
        # The closed form, whitened: the nearest x on the equalities, the box left out.
        y = -np.linalg.solve((rows @ rows.T).toarray(), qp.b[: qp.n_equal])
        closed = (-(rows.T @ y), np.concatenate([y, np.zeros(len(qp.b) - qp.n_equal)]))
        truth = by_clarabel(case, exact, "")
        answer = (truth.x, np.concatenate([truth.y, truth.z]))
        starts = {"cold": None, "closed form": closed, "exact answer": answer}
        if case.unknowns in previous:
            starts["previous room"] = previous[case.unknowns]
        previous[case.unknowns] = answer
        for name, start in starts.items():
            yield case.name, name, by_osqp(case, settings, "", start).iterations


def throughput(count: int = 100_000) -> list[tuple[int, str, float]]:
    """(n, engine, microseconds a problem) of rtcal.exact on a batch of one-band problems."""
    rows = []
    for n in (6, 23, 40):
        rng = np.random.default_rng(n)
        mu, sigma = rng.uniform(0.02, 0.6, n), rng.uniform(0.01, 0.1, n)
        areas = rng.uniform(5, 60, n)
        target = np.clip(mu + sigma * rng.standard_normal((count, n)), 0.01, 0.99) @ areas
        for engine in ("numpy", "numba"):
            try:
                rt.exact.solve(mu, sigma, areas, target[:10], engine=engine)
            except rt.errors.MissingDependencyError:
                continue
            began = time.perf_counter()
            rt.exact.solve(mu, sigma, areas, target, engine=engine)
            rows.append((n, engine, 1e6 * (time.perf_counter() - began) / count))
    return rows
