"""The run: each route to a solver takes each case; what it answers is judged here, and stored.

``qpsolvers:NAME`` calls a solver through qpsolvers, ``rtcal:NAME raw`` and ``rtcal:NAME`` take
`rtcal.calibrate`'s path before and after polishing, ``rtcal.exact`` is the batch solver. The table is
appended while it runs, so that a run that was stopped goes on.
"""

from __future__ import annotations

import csv
import datetime
import functools
import gzip
import importlib.metadata
import io
import json
import os
import platform
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

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
    part = functools.partial
    found: dict[str, Route] = {
        f"qpsolvers:{n}": part(by_qpsolvers, n) for n in NAMES if n in qpsolvers.available_solvers
    }
    for n in ("clarabel", "osqp"):
        found[f"rtcal:{n} raw"] = part(by_rtcal, n, False)
        found[f"rtcal:{n}"] = part(by_rtcal, n, True)
    found["rtcal.exact"] = by_exact
    return found


def fits(route: str, case: Case) -> bool:
    """Whether a route can, or can in reasonable time, take a case."""
    if route == "rtcal.exact":
        return case.separable is not None
    name = route.removeprefix("qpsolvers:")
    dense = route.startswith("qpsolvers:") and name not in qpsolvers.sparse_solvers
    return len(case.q) <= DENSE_LIMIT or not dense


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
        alpha = found.alpha if found.x is None else case.of(found.x)
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
        took = []
        for _ in range(5):
            began = time.perf_counter()
            rt.exact.solve(mu, sigma, areas, target)
            took.append(time.perf_counter() - began)
        rows.append((n, 1e6 * min(took) / count))
    return rows


COLUMNS = [f.name for f in fields(Row)]
PACKAGES = (
    "rtcal",
    "numpy",
    "scipy",
    "cvxpy",
    "clarabel",
    "osqp",
    "qpsolvers",
    "qpbenchmark",
    "highspy",
    "daqp",
    "piqp",
    "proxsuite",
    "scs",
    "quadprog",
    "numba",
)
TOO_SLOW = 1.0  # s: a route that took longer is not given larger problems of that family


def machine() -> dict[str, object]:
    """Return what a time depends on: processor, cores, versions, date; no names."""
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            x.split(":", 1)[1].strip()
            for x in info.read_text().splitlines()
            if x.startswith("model name")
        ]
        model = names[0] if names else model
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "processor": model,
        "cores": os.cpu_count(),
        "system": platform.system(),
        "versions": versions,
    }


def read(path: Path) -> list[Row]:
    """Read the rows of a table, plain or compressed; a last line that was cut off is left out."""
    if not path.exists():
        return []
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
    whole = text[: text.rfind("\n") + 1]
    return [_row(given) for given in csv.DictReader(io.StringIO(whole))]


def _row(given: dict[str, str]) -> Row:
    kinds = {"int": int, "float": float, "str": str, "bool": lambda v: v == "True"}
    return Row(**{f.name: kinds[str(f.type)](given[f.name]) for f in fields(Row)})  # type: ignore[arg-type]


def _line(row: Row) -> list[object]:
    return [f"{v:.3g}" if isinstance(v, float) else v for v in asdict(row).values()]


def run(folder: Path, size: str, routes: dict[str, Route] | None = None) -> list[Row]:
    """Run what is not yet in ``folder``'s table, and return all rows."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{size}.csv"
    rows = read(path)
    done = {(r.problem, r.route, r.settings) for r in rows}
    slow = {_kind(r) for r in rows if r.microseconds > 1e6 * TOO_SLOW}
    # Rewritten whole first: a line that was cut off goes.
    write_text(path, _text(rows))
    test_set = Rooms(size)
    chosen = available() if routes is None else routes
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for case in test_set:
            for name, route in chosen.items():
                if not fits(name, case):
                    continue
                for setting in ("default",) if name == "rtcal.exact" else ("default", *EPS):
                    key = (case.family, case.name.split()[0], name, setting)
                    if (case.name, name, setting) in done or key in slow:
                        continue
                    found = timed(route, case, test_set.solver_settings[setting], setting)
                    row = judge(case, name, setting, found, test_set.tolerances[setting])
                    if found.seconds > TOO_SLOW:
                        slow.add(key)
                    writer.writerow(_line(row))
                    rows.append(row)
            file.flush()
    return rows


def _kind(row: Row) -> tuple[str, str, str, str]:
    return row.family, row.problem.split()[0], row.route, row.settings


def _text(rows: Iterable[Row]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_line(row) for row in rows)
    return out.getvalue()


def finish(folder: Path, size: str) -> None:
    """Measure iterations and throughput, and write the table compressed with the machine beside it."""
    also = {"run": size, **machine(), "iterations": iterations(), "throughput": throughput()}
    write_text(folder / f"{size}.json", json.dumps(also) + "\n")
    rows = read(folder / f"{size}.csv")
    write_bytes(folder / f"{size}.csv.gz", gzip.compress(_text(rows).encode(), mtime=0))
