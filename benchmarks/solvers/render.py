"""The page and figures of a run: every number in it is computed from the table."""

# ruff: noqa: E501 (the lines of the page are prose)

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from qpbenchmark.shgeom import shgeom

from benchmarks.solvers.cases import RUNTIME
from benchmarks.solvers.measure import Row
from benchmarks.solvers.results import TOO_SLOW, read
from benchmarks.solvers.routes import DENSE_LIMIT, SLSQP_LIMIT
from rtcal.acoustics.files import write_bytes, write_text

SHIFT = 10.0  # microseconds; qpbenchmark's ten seconds would hide every difference here
DEFAULT = "rtcal:clarabel"
NO_EXACT = ("soft", "correlated")  # first words of names: problems without a closed answer
_SIZES_FROM = 400  # unknowns: below, the cost of a call hides the slope


def _grouped(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row.route, row.settings), []).append(row)
    return found


def _table(head: Sequence[object], lines: Sequence[Sequence[object]]) -> str:
    out = ["| " + " | ".join(str(h) for h in head) + " |", "|" + "---|" * len(head)]
    return "\n".join(out + ["| " + " | ".join(str(v) for v in line) + " |" for line in lines])


def _worst(values: Sequence[float]) -> str:
    finite = [v for v in values if np.isfinite(v)]
    return f"{max(finite):.0e}" if finite else "–"


def accuracy(rows: Sequence[Row]) -> str:
    """One line a route and setting: failures, wrong answers, errors, residuals, infeasible ones."""
    lines = []
    for (route, setting), own in _grouped(rows).items():
        feasible = [r for r in own if r.feasible]
        solved = [r for r in feasible if r.status == "solved"]
        lines.append((
            route, setting.removesuffix("_accuracy"), len(feasible),
            sum(r.failed for r in feasible), sum(r.wrong for r in own),
            sum(r.off(1e-6) for r in own), _worst([r.error for r in solved]),
            _worst([r.primal for r in solved]), _worst([r.dual for r in solved]),
            _worst([r.gap for r in solved]), sum(r.passes for r in solved),
            f"{sum(r.detected for r in own)}/{len(own) - len(feasible)}",
        ))  # fmt: skip
    head = ("route", "settings", "feasible", "failed", "wrong > 1e-4", "off > 1e-6",
            "worst error", "primal", "dual", "gap", "within tolerance", "infeasible detected")  # fmt: skip
    return _table(head, lines)


def _mean(own: Sequence[Row]) -> str:
    values = [r.microseconds for r in own if r.status == "solved" and np.isfinite(r.microseconds)]
    return f"{shgeom(np.array(values), SHIFT):.0f}" if values else "–"


def times(rows: Sequence[Row]) -> str:
    """Shifted geometric means by size; only problems that the route solved count."""
    ranges: list[tuple[str, Callable[[Row], bool]]] = [
        ("one band, 6", lambda r: r.family == "hard" and r.unknowns == 6),
        ("one band, 23", lambda r: r.family == "hard" and r.unknowns == 23),
        ("one band, 40", lambda r: r.family == "hard" and r.unknowns == 40),
        ("6 x 8", lambda r: r.family == "random" and r.unknowns == 48),
        ("23 x 8", lambda r: r.family == "random" and r.unknowns == 184),
        ("40 x 8", lambda r: r.family == "random" and r.unknowns == 320),
        ("composed", lambda r: r.family == "composed"),
    ]
    lines = [
        (route, setting.removesuffix("_accuracy"),
         *(_mean([r for r in own if belongs(r)]) for _, belongs in ranges))
        for (route, setting), own in _grouped(rows).items()
        if setting in ("default", "high_accuracy")
    ]  # fmt: skip
    return _table(("route", "settings", *(name for name, _ in ranges)), lines)


def _by_size(rows: Sequence[Row]) -> dict[tuple[str, str], dict[int, float]]:
    found: dict[tuple[str, str], dict[int, float]] = {}
    for r in rows:
        # cvxpy's two sizes give no slope, and its first solve of a shape compiles.
        if (
            r.family == "sizes"
            and r.settings == "default"
            and r.status == "solved"
            and not r.route.startswith("cvxpy:")
        ):
            found.setdefault((r.route, r.problem.split()[0]), {})[r.unknowns] = r.microseconds
    return found


def exponent(curve: dict[int, float]) -> float:
    """Slope of log time over log unknowns from `_SIZES_FROM` on; NaN with fewer than three sizes."""
    large = sorted((n, t) for n, t in curve.items() if n >= _SIZES_FROM)
    if len(large) < 3:
        return float("nan")
    n, t = np.log(np.array(large)).T
    return float(np.polyfit(n, t, 1)[0])


def sizes(rows: Sequence[Row]) -> str:
    """Unknowns against time in ms, with the fitted exponents."""
    curves = _by_size(rows)
    columns = sorted({n for curve in curves.values() for n in curve})
    lines = []
    for (route, kind), curve in sorted(curves.items()):
        slope = exponent(curve)
        lines.append((
            route, kind, *(f"{1e-3 * curve[n]:.2f}" if n in curve else "–" for n in columns),
            f"{slope:.2f}" if np.isfinite(slope) else "–",
        ))  # fmt: skip
    return _table(("route", "problem", *columns, "exponent"), lines)


def _iterations(also: dict[str, Any]) -> str:
    starts = ("cold", "closed form", "previous room", "exact answer")
    lines = []
    for n in (6, 23, 40):
        own = [(s, i) for p, s, i in also["iterations"] if p.startswith(f"random {n} x")]
        lines.append(
            (f"{n} x 8", *(f"{np.median([i for t, i in own if t == s]):.0f}" for s in starts))
        )
    return _table(("size", *starts), lines)


def _agreement(rows: Sequence[Row], problems: set[str]) -> float:
    """Largest distance over ``problems`` of the truth from the nearest answer of a solver outside rtcal."""
    nearest = [
        min(r.error for r in rows if r.problem == p and r.status == "solved"
            and not r.route.startswith("rtcal"))
        for p in problems
    ]  # fmt: skip
    return max(nearest)


def text(folder: Path, size: str) -> str:
    """Return the whole page."""
    rows = read(folder / f"{size}.csv.gz")
    also = json.loads((folder / f"{size}.json").read_text(encoding="utf-8"))
    groups = _grouped(rows)
    own = groups[(DEFAULT, "default")]
    feasible = [r for r in own if r.feasible]
    composed = {r.problem for r in rows if r.family == "composed" or r.problem.startswith(NO_EXACT)}
    known = [r for r in feasible if r.problem not in composed]
    worst = max(r.error for r in known if r.status == "solved")
    within = max(r.within for r in feasible)
    agree = _agreement(rows, composed)
    raw = [r for r in groups[(f"{DEFAULT} raw", "default")] if r.feasible]
    plain = [r for r in groups[("own:clarabel", "default")] if r.feasible]
    throughput = _table(
        ("n", "engine", "microseconds a problem"),
        [(n, engine, f"{t:.3f}") for n, engine, t in also["throughput"]],
    )
    versions = ", ".join(f"{k} {v}" for k, v in also["versions"].items())
    families = sorted({r.family for r in rows})
    counts = ", ".join(f"{len({r.problem for r in rows if r.family == f})} {f}" for f in families)
    return f"""# Which solver should calibrate a room

**Keep the default: Clarabel at 1e-10 with rtcal's polish and certificate. Of {len(feasible)} feasible
problems it failed on {sum(r.failed for r in own)} and called {sum(r.wrong for r in own)} wrong answers solved (an error above 1e-4; {sum(r.off(1e-6) for r in own)} above 1e-6), its worst error in
alpha was {worst:.0e} on the {len(known)} that have an exact answer, and it detected {sum(r.detected for r in own)} of {len(own) - len(feasible)} infeasible ones. For many rooms at once and one band at
a time, use `rtcal.exact`.**

Before polishing its worst error is {_worst([r.error for r in raw])}; Clarabel at its own default has {_worst([r.error for r in plain])}.

Everything here comes from `python -m benchmarks.solvers run --full` and is written by
`python -m benchmarks.solvers render`; `run --short` is a smaller one. A run that was stopped goes
on where it was. The table is `benchmarks/solvers/results/{size}.csv.gz`, {len(rows)} solves.

Run of {also["date"]} on {also["processor"]}, {also["cores"]} cores, {also["system"]}. {versions}.

## Problems

{len({r.problem for r in rows})} problems: {counts}. *Real* is the shipped CR2 room (mle and lse); *paper* is
Figs. 1 and 3 and Table 1 of Bellows & Katz (2025); *random* is 6, 23 and 40 materials in 8 bands; *hard* and
*infeasible* are one band with areas over 1000:1 and sigma over 100:1, targets at, near and beyond both ends, sigma = 0,
one bound active and all but one; *composed* is a tolerance, a soft match, correlated bands and two
configurations; *sizes* goes up to {max(r.unknowns for r in rows)} unknowns. They are a qpbenchmark `TestSet`
(`benchmarks.solvers.cases.Rooms`), in the whitened unknowns x = (alpha - mu) / sigma.

The exact answer is `rtcal.exact`'s where the problem is separable (held to 1e-11 against rational
arithmetic in the tests). A composed problem has none: there the truth is rtcal's polished answer with the error
bound that its certificate proves, at most {within:.0e} here. The nearest answer of a solver outside rtcal is
within {agree:.0e} of it on each of these {len(composed)}.

## Accuracy and failures

Errors are max |alpha - exact|. Residuals and gap are computed here from x and the duals by qpsolvers' `Solution`; those of
rtcal's routes are its certificate's, in units of the prior. "Wrong" is called solved, yet off by more than 1e-4,
not finite, or without an answer to find. "Within tolerance" counts solved ones within qpbenchmark's tolerance of that
setting: 1, 1e-3, 1e-6 or 1e-9. "–": the route gives no duals. A solver asked for 1e-3 may well be off by more than 1e-4: that
is what the row tells. The dual residual of a "raw" row counts what the target at an end takes from
the solver: there rtcal pins the coefficients.

![Errors of the answers called solved](figures/solver_errors.png)

{accuracy(rows)}

## Time

Microseconds, shifted geometric mean with a shift of {SHIFT:.0f} microseconds, of what was solved. A call by cvxpy or rtcal includes filling in the
numbers, rtcal's also the polish and the certificate; a "raw" time is the solver's own. Timings are the better of two calls where the first took under 20 ms.

{times(rows)}

## Unknowns against time

Milliseconds at default settings, and the slope on log-log axes from {_SIZES_FROM} unknowns on. A route that took over {TOO_SLOW:.0f} s at some size was not given larger ones.

![Time over unknowns](figures/solver_sizes.png)

{sizes(rows)}

## OSQP's iterations, cold and warm

Medians at eps 1e-8: from nothing, from the paper's closed form (primal and dual), from the answer of the room
before, from the exact answer.

{_iterations(also)}

## Throughput of rtcal.exact

A batch of 100,000 one-band problems.

{throughput}

## Known limits

- One machine with shared cores, and each problem is timed twice at most: read ratios, not times.
- cvxpy compiles in its first solve of a shape; that solve's time counts where it was over 20 ms.
- Tens of problems a family, not thousands; `Rooms("full", seed)` gives others.
- A setting means to each solver what it takes it to mean; qpbenchmark's table of settings is used as it is.
- qpsolvers tells only "found" or not, so an infeasible problem counts as detected if it is not called solved.
- `rtcal.exact` is the truth of the separable problems, so its own error of 0 says nothing here; the composed ones' truth
  is the default path's, and its error there is bounded by its certificate and not by another method.
- rtcal's "raw" rows exist only where the polished answer passed its certificate, and rtcal checks what
  can be reached before any solver runs: no solver sees an unreachable target there.
- Solvers that have a time limit had {RUNTIME:.0f} s. Dense solvers and cvxpy were given at most {DENSE_LIMIT} unknowns, SLSQP {SLSQP_LIMIT}.
- SciPy stands for general nonlinear solvers by SLSQP only.
- quadprog is GPL: it is run where the user has it, and is not a dependency.
"""


def page(folder: Path, size: str, docs: Path) -> None:
    """Write the page and its figures."""
    write_text(docs / "solver_comparison.md", text(folder, size))
    rows = read(folder / f"{size}.csv.gz")
    for name, draw in (("solver_errors", _errors), ("solver_sizes", _curves)):
        write_bytes(docs / "figures" / f"{name}.png", draw(rows))


def _errors(rows: Sequence[Row]) -> bytes:
    groups = {
        f"{route}, {setting.removesuffix('_accuracy')}": [
            max(r.error, 1e-17) for r in own if r.status == "solved" and np.isfinite(r.error)
        ]
        for (route, setting), own in _grouped(rows).items()
        if setting in ("default", "high_accuracy") and route != "rtcal.exact"
    }
    figure, axes = _figure(7, 8)
    for place, values in enumerate(groups.values()):
        axes.plot(values, np.full(len(values), place), "|", color="C0")
        axes.plot(max(values, default=1e-17), place, "o", color="C3", markersize=4)
    axes.set_yticks(range(len(groups)), list(groups), fontsize=7)
    axes.set_xscale("log")
    axes.axvline(1e-4, color="0.5", linestyle="--")
    axes.set_xlabel("max |alpha - exact| of an answer called solved (dot: the worst)")
    return _png(figure)


def _curves(rows: Sequence[Row]) -> bytes:
    figure, axes = _figure(8, 5)
    shown = [(r, c) for (r, kind), c in sorted(_by_size(rows).items()) if kind == "mle"]
    for place, (route, curve) in enumerate(shown):
        n = sorted(curve)
        style = ("o-", "s--", "^:")[place // 10]
        axes.loglog(
            n,
            [1e-3 * curve[i] for i in n],
            style,
            color=f"C{place % 10}",
            markersize=3,
            label=route,
        )
    axes.set_xlabel("unknowns")
    axes.set_ylabel("time in ms")
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
    return _png(figure)


def _figure(width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure((width, height), layout="constrained")
    return figure, figure.add_subplot()


def _png(figure: Any) -> bytes:
    import io

    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()
