"""The run: each route to a solver takes each case; what it answers is judged here, and stored.

``qpsolvers:NAME`` calls a solver through qpsolvers, ``rtcal:NAME raw`` and ``rtcal:NAME`` take
`rtcal.calibrate`'s path before and after polishing, ``rtcal.exact`` is the batch solver. The table is
appended while it runs, so that a run that was stopped goes on.
"""

from __future__ import annotations

import csv
import datetime
import gzip
import importlib.metadata
import io
import json
import os
import platform
import re
import time
import timeit
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import qpsolvers
from qpbenchmark.solver_settings import SolverSettings
from qpbenchmark.tolerance import Tolerance

import rtcal as rt
from benchmarks.solvers.cases import Case, Rooms
from rtcal.files.disk import write_bytes, write_text
from rtcal.support.types import Array

EPS = {"low_accuracy": 1e-3, "mid_accuracy": 1e-6, "high_accuracy": 1e-9}
NAMES = ("clarabel", "osqp", "highs", "daqp", "piqp", "proxqp", "scs", "quadprog")
DENSE_LIMIT = 2000  # unknowns, beyond which qpsolvers' dense solvers only cost time or memory
NAN = float("nan")
ENOUGH = 0.2  # s


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
    own: tuple[float, float, float] | None = None


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
    x, y, z = (None if v is None else np.asarray(v) for v in (found.x, found.y, found.z))
    return Found(status, seconds, x, y, z)


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
    here = [n for n in NAMES if n in qpsolvers.available_solvers]
    found: dict[str, Route] = {f"qpsolvers:{n}": partial(by_qpsolvers, n) for n in here}
    for n in ("clarabel", "osqp"):
        found[f"rtcal:{n} raw"] = partial(by_rtcal, n, False)
        found[f"rtcal:{n}"] = partial(by_rtcal, n, True)
    found["rtcal.exact"] = by_exact
    return found


def fits(route: str, case: Case) -> bool:
    """Whether a route can, or can in reasonable time, take a case."""
    if route == "rtcal.exact":
        return case.separable is not None
    name = route.removeprefix("qpsolvers:")
    dense = route.startswith("qpsolvers:") and name not in qpsolvers.sparse_solvers
    return len(case.q) <= DENSE_LIMIT or not dense


class Row(msgspec.Struct, frozen=True):
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
    def kind(self) -> tuple[str, str, str, str]:
        """Its family and kind of problem, and how it was solved."""
        return self.family, self.problem.split()[0], self.route, self.settings

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
        alpha = found.alpha if found.x is None else case.of(found.x)
        if case.alpha is not None:
            error = float(np.max(np.abs(alpha - case.alpha)))
        if found.own is not None:
            primal, dual, gap = found.own
        elif found.x is not None and np.isfinite(found.x).all():
            primal, dual, gap = residuals(case, found)
    passes = primal <= tolerance.primal and dual <= tolerance.dual and gap <= tolerance.gap
    return Row(
        problem=case.name,
        family=case.family,
        unknowns=case.unknowns,
        feasible=case.alpha is not None,
        route=route,
        settings=setting,
        status=found.status,
        error=error,
        within=case.alpha_within,
        primal=primal,
        dual=dual,
        gap=gap,
        passes=bool(passes),
        microseconds=1e6 * found.seconds,
        iterations=found.iterations,
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
    tries: list[Found] = []
    while len(tries) < 3 and sum(found.seconds for found in tries) <= ENOUGH:
        tries.append(route(case, settings, setting))
    return min(tries, key=lambda found: found.seconds)


def iterations() -> list[dict[str, Any]]:
    """Return OSQP's iterations from a cold start and from rtcal's, the closed form, in random rooms."""
    found = []
    for case in Rooms("short"):
        if case.family == "random":
            for warm in (False, True):
                given = {"solver": "osqp", "warm_start": warm, "settings": {"polishing": False}}
                raw = case.built.solve(case.measured, case.room, **given).raw
                of_case = {"unknowns": case.unknowns, "warm": warm}
                found.append({**of_case, "iterations": raw.iterations})
    return found


def throughput(count: int = 100_000) -> list[tuple[int, float]]:
    """(n, microseconds a problem) of rtcal.exact on a batch of one-band problems."""
    rows = []
    for n in (6, 23, 40):
        rng = np.random.default_rng(n)
        mu, sigma = rng.uniform(0.02, 0.6, n), rng.uniform(0.01, 0.1, n)
        areas = rng.uniform(5, 60, n)
        target = np.clip(mu + sigma * rng.standard_normal((count, n)), 0.01, 0.99) @ areas
        rt.exact.solve(mu, sigma, areas, target[:10])  # which compiles it
        took = timeit.repeat(partial(rt.exact.solve, mu, sigma, areas, target), number=1)
        rows.append((n, 1e6 * min(took) / count))
    return rows


PACKAGES = (
    "rtcal", "numpy", "scipy", "cvxpy", "clarabel", "osqp", "qpsolvers", "qpbenchmark", "highspy",
    "daqp", "piqp", "proxsuite", "scs", "quadprog", "numba",
)  # fmt: skip
TOO_SLOW = 1.0  # s: a route that took longer is not given larger problems of that family


def machine() -> dict[str, object]:
    """Return what a time depends on: processor, cores, versions, date; no names."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", info.read_text() if info.exists() else "")
    there = {d.name.lower() for d in importlib.metadata.distributions()}
    versions = {n: importlib.metadata.version(n) for n in PACKAGES if n in there}
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "processor": model[1] if model else platform.machine(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "versions": {"python": platform.python_version(), **versions},
    }


def read(path: Path) -> list[Row]:
    """Read the rows of a table, plain or compressed; a last line that was cut off is left out."""
    if not path.exists():
        return []
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
    whole = text[: text.rfind("\n") + 1]
    return [msgspec.convert(r, Row, strict=False) for r in csv.DictReader(io.StringIO(whole))]


def written(rows: Iterable[Row], *, head: bool = True) -> str:
    """Return rows as lines of a table, below its header."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    if head:
        writer.writerow(Row.__struct_fields__)
    for row in rows:
        values = msgspec.structs.astuple(row)
        writer.writerow([f"{v:.3g}" if isinstance(v, float) else v for v in values])
    return out.getvalue()


def run(folder: Path, size: str, routes: dict[str, Route] | None = None) -> list[Row]:
    """Run what is not yet in ``folder``'s table, and return all rows."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{size}.csv"
    rows = read(path)
    done = {(r.problem, r.route, r.settings) for r in rows}
    slow = {r.kind for r in rows if r.microseconds > 1e6 * TOO_SLOW}
    # Rewritten whole first: a line that was cut off goes.
    write_text(path, written(rows))
    test_set = Rooms(size)
    chosen = available() if routes is None else routes
    with path.open("a", newline="", encoding="utf-8") as file:
        for case in test_set:
            for name, route in chosen.items():
                for setting in ("default",) if name == "rtcal.exact" else ("default", *EPS):
                    kind = (case.family, case.name.split()[0], name, setting)
                    known = (case.name, name, setting) in done or kind in slow
                    if known or not fits(name, case):
                        continue
                    found = timed(route, case, test_set.solver_settings[setting], setting)
                    row = judge(case, name, setting, found, test_set.tolerances[setting])
                    if found.seconds > TOO_SLOW:
                        slow.add(kind)
                    file.write(written([row], head=False))
                    rows.append(row)
            file.flush()
    return rows


def finish(folder: Path, size: str) -> None:
    """Measure iterations and throughput, and write the table compressed with the machine beside it."""
    also = {"run": size, **machine(), "iterations": iterations(), "throughput": throughput()}
    write_text(folder / f"{size}.json", json.dumps(also) + "\n")
    rows = read(folder / f"{size}.csv")
    write_bytes(folder / f"{size}.csv.gz", gzip.compress(written(rows).encode(), mtime=0))
