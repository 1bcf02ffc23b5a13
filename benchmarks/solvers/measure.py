"""The measurement: everything is computed here from x, y, z; no solver's own residual is taken."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import qpsolvers
from qpbenchmark.solver_settings import SolverSettings
from qpbenchmark.tolerance import Tolerance

import rtcal as rt
from benchmarks.solvers.cases import Case, warm_cases
from benchmarks.solvers.routes import Found, Route, by_clarabel, by_osqp

NAN = float("nan")
ENOUGH = 0.2  # s


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
        case.name,
        case.family,
        case.unknowns,
        case.alpha is not None,
        route,
        setting,
        found.status,
        error,
        case.alpha_within,
        primal,
        dual,
        gap,
        bool(passes),
        1e6 * found.seconds,
        found.iterations,
    )


def residuals(case: Case, found: Found) -> tuple[float, float, float]:
    """Primal and dual residual and duality gap by qpsolvers' `Solution`; NaN without duals."""
    solution = qpsolvers.Solution(
        case,
        found=True,
        x=found.x,
        y=np.zeros(0) if case.A is None else found.y,
        z=found.z,
        z_box=np.zeros(0),
    )
    primal = float(solution.primal_residual())
    if found.z is None or (case.A is not None and found.y is None):
        return primal, NAN, NAN
    return primal, float(solution.dual_residual()), float(solution.duality_gap())


def timed(route: Route, case: Case, settings: SolverSettings, setting: str) -> Found:
    """Solve three times, or as often as fits in `ENOUGH`, and keep the quickest.

    The first call pays for caches, and other work on the machine for some.
    """
    best = route(case, settings, setting)
    spent = best.seconds
    for _ in range(2):
        if spent > ENOUGH:
            break
        again = route(case, settings, setting)
        spent += again.seconds
        best = again if again.seconds < best.seconds else best
    return best


@dataclass(frozen=True)
class Count:
    """Iterations of one solve: ``box`` is inactive or active, ``start`` where it began."""

    n: int
    box: str
    solver: str
    start: str
    iterations: int


def iterations(count: int, seed: int = 7) -> Iterator[Count]:
    """Yield Clarabel's iterations, and OSQP's cold and from three warm starts, at eps 1e-8."""
    settings, exact = SolverSettings(), SolverSettings()
    for chosen, eps in ((settings, 1e-8), (exact, 1e-12)):
        chosen.set_eps_abs(eps)
        chosen.set_eps_rel(eps)
    settings.set_param("osqp", "check_termination", 1)  # its 25 would round every count up
    for n in (6, 23, 40):
        for box in ("inactive", "active"):
            previous: tuple[np.ndarray, np.ndarray] | None = None
            for case in warm_cases(n, box, count, seed):
                qp = case.whitened.matrices
                rows = qp.A[: qp.n_equal]
                # The closed form, whitened: the nearest x on the equalities, the box left out.
                y = -np.linalg.solve((rows @ rows.T).toarray(), qp.b[: qp.n_equal])
                nothing = np.zeros(len(qp.b) - qp.n_equal)
                truth = by_clarabel(case, exact, "")
                answer = (truth.x, np.concatenate([truth.y, truth.z]))
                starts = {
                    "cold": None,
                    "closed form": (-(rows.T @ y), np.concatenate([y, nothing])),
                    "previous room": previous,
                    "exact answer": answer,
                }
                for name, start in starts.items():
                    if name == "previous room" and start is None:
                        continue
                    used = by_osqp(case, settings, "", start).iterations
                    yield Count(n, box, "osqp", name, used)
                held = case.built.solve(
                    case.measured,
                    case.room,
                    solver="osqp",
                    settings={**settings["osqp"], "polishing": False},
                ).raw
                yield Count(n, box, "osqp", "closed form, held", held.iterations)
                yield Count(n, box, "clarabel", "cold", by_clarabel(case, settings, "").iterations)
                previous = answer


def throughput(count: int = 100_000) -> list[tuple[int, float]]:
    """(n, microseconds a problem) of rtcal.exact on a batch of one-band problems."""
    rows = []
    for n in (6, 23, 40):
        rng = np.random.default_rng(n)
        mu, sigma = rng.uniform(0.02, 0.6, n), rng.uniform(0.01, 0.1, n)
        areas = rng.uniform(5, 60, n)
        target = np.clip(mu + sigma * rng.standard_normal((count, n)), 0.01, 0.99) @ areas
        rt.exact.solve(mu, sigma, areas, target[:10])  # which compiles it
        took = []
        for _ in range(5):
            began = time.perf_counter()
            rt.exact.solve(mu, sigma, areas, target)
            took.append(time.perf_counter() - began)
        rows.append((n, 1e6 * min(took) / count))
    return rows
