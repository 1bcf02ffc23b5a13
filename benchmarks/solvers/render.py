"""The page of a run: every number in it is computed from the table."""

# ruff: noqa: E501 (the lines of the page are prose)

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from qpbenchmark.shgeom import shgeom

from benchmarks.solvers.cases import RUNTIME
from benchmarks.solvers.run import DENSE_LIMIT, ENOUGH, EPS, TOO_SLOW, Row, read
from rtcal.files.disk import write_text

SHIFT = 10.0  # microseconds; qpbenchmark's ten seconds would hide every difference here
DEFAULT, OTHER = "rtcal:clarabel", "rtcal:osqp"
SHOWN = ("default", "high_accuracy")
"""Settings of the tables; the page says what the others change."""


def grouped(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return the rows by route and setting."""
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


@dataclass(frozen=True)
class Score:
    """The outcome of a route at one setting."""

    feasible: int
    failed: int
    wrong: int
    off: int
    worst: str
    residuals: tuple[str, str, str]
    passes: str
    detected: str


def score(own: Sequence[Row]) -> Score:
    """Count what a route did."""
    feasible = [r for r in own if r.feasible]
    solved = [r for r in feasible if r.status == "solved"]
    residuals = tuple(
        _worst([getattr(r, name) for r in solved]) for name in ("primal", "dual", "gap")
    )
    return Score(
        len(feasible),
        sum(r.failed for r in own),
        sum(r.wrong for r in own),
        sum(r.off(1e-6) for r in own),
        _worst([r.error for r in solved]),
        residuals,
        str(sum(r.passes for r in solved)) if residuals[1] != "–" else "–",
        f"{sum(r.detected for r in own)} of {len(own) - len(feasible)}",
    )


def accuracy(rows: Sequence[Row]) -> str:
    """One line a route and setting: failures, wrong answers, errors, residuals, infeasible ones."""
    lines = []
    for (route, setting), own in grouped(rows).items():
        if setting in SHOWN:
            s = score(own)
            counts = (
                s.feasible,
                s.failed,
                s.wrong,
                s.off,
                s.worst,
                *s.residuals,
                s.passes,
                s.detected,
            )
            lines.append((route, setting.removesuffix("_accuracy"), *counts))
    head = "route settings feasible failed wrong>1e-4 off>1e-6 worst&nbsp;error primal dual gap within&nbsp;tolerance infeasible&nbsp;detected"
    return _table(head.split(), lines)


def _mean_of(own: Sequence[Row]) -> float:
    values = [r.microseconds for r in own if r.status == "solved" and np.isfinite(r.microseconds)]
    return float(shgeom(np.array(values), SHIFT)) if values else float("inf")


def _mean(own: Sequence[Row]) -> str:
    mean = _mean_of(own)
    return f"{mean:.0f}" if np.isfinite(mean) else "–"


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
        (
            route,
            setting.removesuffix("_accuracy"),
            *(_mean([r for r in own if belongs(r)]) for _, belongs in ranges),
        )
        for (route, setting), own in grouped(rows).items()
        if setting in SHOWN
    ]
    return _table(("route", "settings", *(name for name, _ in ranges)), lines)


def sizes(rows: Sequence[Row]) -> str:
    """Unknowns against time in ms at default settings, with one equality a band and separate bands."""
    curves: dict[str, dict[int, float]] = {}
    for r in rows:
        of_curve = (r.family, r.settings, r.status) == ("sizes", "default", "solved")
        if of_curve and r.problem.startswith("mle"):
            curves.setdefault(r.route, {})[r.unknowns] = 1e-3 * r.microseconds
    columns = sorted({n for curve in curves.values() for n in curve})
    lines = [
        (route, *(f"{curve[n]:.3g}" if n in curve else "–" for n in columns))
        for route, curve in sorted(curves.items())
    ]
    return _table(("route", *columns), lines)


def _iterations(also: dict[str, Any]) -> str:
    lines = []
    for n in sorted({c["unknowns"] for c in also["iterations"]}):
        own = [c for c in also["iterations"] if c["unknowns"] == n]
        medians = (
            f"{np.median([c['iterations'] for c in own if c['warm'] == warm]):.0f}"
            for warm in (False, True)
        )
        lines.append((n, *medians))
    return _table(("unknowns", "cold", "from the closed form"), lines)


def _throughput(rows: Sequence[Row], also: dict[str, Any]) -> str:
    lines = [
        (n, "rtcal.exact, 100,000 at once", f"{t:.3f}", f"{1e6 / t:,.0f}")
        for n, t in also["throughput"]
    ]
    for n in (6, 23, 40):
        own = {
            route: _mean_of([r for r in group if r.family == "hard" and r.unknowns == n])
            for (route, setting), group in grouped(rows).items()
            if setting == "default" and not route.endswith(" raw")
        }
        outside = {r: t for r, t in own.items() if not r.startswith("rtcal")}
        for route in (min(outside, key=lambda r: outside[r]), DEFAULT):
            lines.append(
                (n, f"{route}, one by one", f"{own[route]:.0f}", f"{1e6 / own[route]:,.0f}")
            )
    head = ("n", "how", "microseconds a problem", "problems a second")
    return _table(head, sorted(lines, key=lambda line: line[0]))


def _ratio(rows: Sequence[Row], family: str, unknowns: int) -> str:
    """OSQP's time over Clarabel's, both polished."""
    times = [
        _mean_of(
            [
                r
                for r in rows
                if (r.route, r.settings, r.family, r.unknowns)
                == (route, "default", family, unknowns)
            ]
        )
        for route in (OTHER, DEFAULT)
    ]
    return f"{times[0] / times[1]:.1f}"


def verdict(rows: Sequence[Row]) -> str:
    """Which solver and settings, with the numbers that say so; and what they do not say."""
    of = {key: score(own) for key, own in grouped(rows).items()}
    own, other, exact, plain, raw, other_raw = (
        of[route, "default"]
        for route in (
            DEFAULT,
            OTHER,
            "rtcal.exact",
            "qpsolvers:clarabel",
            f"{DEFAULT} raw",
            f"{OTHER} raw",
        )
    )
    largest = max(r.unknowns for r in rows)
    levels = []
    for setting in EPS:
        c, o = of[DEFAULT, setting], of[OTHER, setting]
        levels.append(f"| {EPS[setting]:.0e} | {c.failed} | {c.worst} | {o.failed} | {o.worst} |")
    return f"""**Keep the default: Clarabel with rtcal's polish and certificate.** Of {own.feasible} feasible problems it failed on
{own.failed}. It returned {own.wrong} wrong answers as solved (an error above 1e-4; {own.off} above 1e-6). Its worst error in α is {own.worst} against exact
arithmetic. It detected {own.detected} infeasible problems. Without the polish it fails on {raw.failed} (worst error {raw.worst}); OSQP without
the polish fails on {other_raw.failed}. For many rooms at once and one band at a time, use `rtcal.exact` (worst error {exact.worst}).

The table does not say that Clarabel beats OSQP *after* the polish. There OSQP failed on {other.failed}, returned {other.wrong} wrong answers
as solved, and its worst error is {other.worst}. The {other_raw.failed} are targets near an end, or with almost all coefficients at a bound. OSQP stops
at its 20,000 iterations, and the polish mends every one. So the default needs the polish for digits, not for the answer.

Time does not decide either. OSQP's time over Clarabel's is {_ratio(rows, "hard", 23)} on one band of 23 materials, {_ratio(rows, "random", 184)} on 23 x 8,
{_ratio(rows, "random", 320)} on 40 x 8 and {_ratio(rows, "sizes", largest)} at {largest} unknowns. Who calibrates large rooms well inside their reach may prefer
`solver="osqp"`.

The settings matter only before the polish. After it, whatever the tolerance was:

| tolerance before the polish | Clarabel fails | its worst error | OSQP fails | its worst error |
|---|---|---|---|---|
{chr(10).join(levels)}

Through qpsolvers, without rtcal's polish, Clarabel at its own default of 1e-8 has an error of {plain.worst}."""


def text(folder: Path, size: str) -> str:
    """Return the whole page."""
    rows = read(folder / f"{size}.csv.gz")
    also = json.loads((folder / f"{size}.json").read_text(encoding="utf-8"))
    within = max(r.within for r in rows if r.feasible)
    versions = ", ".join(f"{k} {v}" for k, v in also["versions"].items())
    families = sorted({r.family for r in rows})
    counts = ", ".join(f"{len({r.problem for r in rows if r.family == f})} {f}" for f in families)
    return f"""# Which solver should calibrate a room

{verdict(rows)}

`python -m benchmarks.solvers run --full` makes the numbers and `python -m benchmarks.solvers render` writes this page.
`run --short` is a smaller run. A run that was stopped goes on where it was. The table is `benchmarks/solvers/results/{size}.csv.gz`, {len(rows)} solves.

Run of {also["date"]} on {also["processor"]}, {also["cores"]} cores, {also["system"]}. {versions}. All numbers here are of that date, rtcal's too:
its Clarabel then ran at 1e-10. Now Clarabel runs at its own 1e-8 before the polish ([the QP](qp.md)), and OSQP starts from the closed form.

## Problems

{len({r.problem for r in rows})} problems: {counts}.

- *Real* is the shipped CR2 room, solved as mle and lse.
- *Paper* is Figs. 1 and 3 and Table 1 of Bellows & Katz (2025).
- *Random* is 6, 23 and 40 materials in 8 bands.
- *Hard* and *infeasible* are one band with areas over 1000:1 and σ over 100:1. Targets lie at, near and beyond both ends.
  Some have σ = 0, one bound active, or all but one.
- *Composed* is a tolerance, a soft match, correlated bands and two configurations.
- *Sizes* goes up to {max(r.unknowns for r in rows)} unknowns.

They are a qpbenchmark `TestSet` (`benchmarks.solvers.cases.Rooms`), in the whitened unknowns $x = (\\alpha - \\mu) / \\sigma$.

The exact answer shares nothing with rtcal's solvers, polish or certificate (`benchmarks/solvers/truth.py`). A separable problem
is solved in rational arithmetic. For a composed problem PIQP names the active set. The optimality conditions on that set are
solved with residuals in rational arithmetic, and feasibility, signs and stationarity are checked in it. What passes is the
optimum, whoever named the set (residuals below 1e-20). Rounded to floats, every answer is known to {within:.0e}.

## Accuracy and failures

Errors are $\\max \\lvert \\alpha - \\text{{exact}} \\rvert$. qpsolvers' `Solution` computes residuals and gap from x and the duals. Those of rtcal's routes are
its certificate's, in units of the prior. "Wrong" is called solved, yet off by more than 1e-4, not finite, or without an answer
to find. "Within tolerance" counts solved problems within qpbenchmark's tolerance of that setting: 1 at the defaults, 1e-9 at
"high". "–" means that the route gives no duals. The rows of 1e-3 and 1e-6 ("low", "mid") are in the stored table. The default
of an rtcal route is rtcal's own. In its other row the solver's tolerances are replaced.

A route is a package and a solver. rtcal itself takes Clarabel and OSQP; qpsolvers serves this comparison alone. "raw" is rtcal's solver before the polish.

{accuracy(rows)}

## Time

Microseconds, shifted geometric mean with a shift of {SHIFT:.0f} microseconds, of what was solved. A call by rtcal includes filling in the
numbers, the polish and the certificate; a "raw" time is the solver's own. Timings are the
best of up to three calls, as many as fit in {ENOUGH} s. `python -m benchmarks.resolve` prints the times of rtcal as it is installed.

{times(rows)}

## Unknowns against time

Milliseconds at default settings, `mle` in third-octaves. A route that took over {TOO_SLOW:.0f} s at some size was not given larger ones.

{sizes(rows)}

## OSQP's iterations, cold and warm

Medians over the random rooms at eps 1e-8, looked at every 5 iterations. The warm start is the closed form in which violators of the
box are held at their bound (`warm_start=True`, the default). It is the answer there. Clarabel has no warm start.

{_iterations(also)}

## Throughput

One-band problems: a batch by `rtcal.exact`, and one by one by the quickest solver outside rtcal and by the default path.

{_throughput(rows, also)}

## Known limits

- One machine, whose cores did other work beside the run. The run was stopped and taken up once, for the largest tolerances and
  pairs of configurations. Each problem is timed three times at most: read ratios, not times.
- Tens of problems a family, not thousands; `Rooms("full", seed)` gives others.
- A setting means something else to each solver. The table of settings is qpbenchmark's, as it is.
- qpsolvers tells only "found" or not, so an infeasible problem counts as detected if it is not called solved.
- Beside the sizes on which it met the time limit, HiGHS fails at its default on {_named(rows, "qpsolvers:highs")}.
  In these, one row's bound is below 1e-7 ("excessively small"). Its own final check calls its point infeasible by 1e-6 to
  1e-5, and it returns "Solve error". The point is right to 1e-13.
- rtcal's "raw" rows exist only where the polished answer passed its certificate. rtcal checks feasibility before any solver
  runs. So its solvers see no unreachable target, and coefficients that a target at an end pins do not come from the solver.
- Solvers that have a time limit had {RUNTIME:.0f} s. Dense solvers were given at most {DENSE_LIMIT} variables.
- quadprog is GPL: it is run where the user has it, and is not a dependency.
"""


def _named(rows: Sequence[Row], route: str) -> str:
    found = [
        r.problem
        for r in rows
        if r.failed and (r.route, r.settings) == (route, "default") and r.family != "sizes"
    ]
    return ", ".join(f'"{name}"' for name in found) or "none here"


def page(folder: Path, size: str, out: Path) -> None:
    """Write the page."""
    write_text(out / "README.md", text(folder, size))
