"""The page of a run, `page.md.jinja`: every number in it is computed from the table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from msgspec.structs import asdict
from qpbenchmark.shgeom import shgeom

from benchmarks.solvers.cases import RUNTIME
from benchmarks.solvers.run import DENSE_LIMIT, ENOUGH, EPS, TOO_SLOW, read
from benchmarks.studies.rates import markdown
from rtcal.files.disk import write_text

SHIFT = 10.0  # microseconds; qpbenchmark's ten seconds would hide every difference here
DEFAULT, OTHER = "rtcal:clarabel", "rtcal:osqp"
SHOWN = {"default": "default", "high_accuracy": "high"}
"""Settings of the tables; the page says what the others change."""
SIZES = (6, 23, 40)
NONE = "–"


def of_run(path: Path) -> pd.DataFrame:
    """Return the table of a run, with what each row counts as."""
    counts = ("failed", "wrong", "detected")
    return pd.DataFrame(
        {**asdict(r), "off": r.off(1e-6), **{c: getattr(r, c) for c in counts}} for r in read(path)
    )


def worst(values: pd.Series) -> str:
    """Return the largest finite value."""
    finite = values[np.isfinite(values)]
    return f"{finite.max():.0e}" if len(finite) else NONE


def score(own: pd.DataFrame) -> dict[str, object]:
    """Return the outcome of a route at one setting, in the order of the table."""
    feasible = own[own.feasible]
    solved = feasible[feasible.status == "solved"]
    residuals = {name: worst(solved[name]) for name in ("primal", "dual", "gap")}
    return {
        "feasible": len(feasible),
        "failed": own.failed.sum(),
        "wrong": own.wrong.sum(),
        "off": own.off.sum(),
        "worst": worst(solved.error),
        **residuals,
        "within": NONE if residuals["dual"] == NONE else solved.passes.sum(),
        "detected": f"{own.detected.sum()} of {len(own) - len(feasible)}",
    }


def mean(own: pd.DataFrame) -> float:
    """Return the shifted geometric mean of the times of what was solved; infinity of nothing."""
    times = own.microseconds[(own.status == "solved") & np.isfinite(own.microseconds)]
    return float(shgeom(times.to_numpy(), SHIFT)) if len(times) else float("inf")


def accuracy(groups: dict[Any, pd.DataFrame]) -> str:
    """One line a route and setting: failures, wrong answers, errors, residuals, infeasible ones."""
    head = (
        "route settings feasible failed wrong>1e-4 off>1e-6 worst&nbsp;error primal dual gap "
        "within&nbsp;tolerance infeasible&nbsp;detected"
    )
    lines = [
        (route, SHOWN[setting], *score(own).values())
        for (route, setting), own in groups.items()
        if setting in SHOWN
    ]
    return markdown(head.split(), *lines)


def times(groups: dict[Any, pd.DataFrame]) -> str:
    """Shifted geometric means by size; only problems that the route solved count."""
    ranges = {f"one band, {n}": f"family == 'hard' and unknowns == {n}" for n in SIZES}
    ranges |= {f"{n} x 8": f"family == 'random' and unknowns == {8 * n}" for n in SIZES}
    ranges |= {"composed": "family == 'composed'"}
    lines = []
    for (route, setting), own in groups.items():
        if setting in SHOWN:
            means = [mean(own.query(where)) for where in ranges.values()]
            cells = [f"{m:.0f}" if np.isfinite(m) else NONE for m in means]
            lines.append((route, SHOWN[setting], *cells))
    return markdown(("route", "settings", *ranges), *lines)


def sizes(rows: pd.DataFrame) -> str:
    """Unknowns against time in ms at default settings, with one equality a band and separate bands."""
    of_curve = "family == 'sizes' and settings == 'default' and status == 'solved'"
    chosen = rows.query(of_curve)
    chosen = chosen[chosen.problem.str.startswith("mle")]
    curves = chosen.pivot(index="route", columns="unknowns", values="microseconds") / 1e3
    lines = [
        (route, *(NONE if np.isnan(t) else f"{t:.3g}" for t in curve))
        for route, curve in zip(curves.index, curves.to_numpy(), strict=True)
    ]
    return markdown(("route", *curves.columns), *lines)


def iterations(also: dict[str, Any]) -> str:
    """OSQP's median iterations by the number of unknowns, cold and warm."""
    table = pd.DataFrame(also["iterations"])
    medians = table.pivot_table("iterations", "unknowns", "warm", "median")
    lines = [(n, f"{cold:.0f}", f"{warm:.0f}") for n, cold, warm in medians.itertuples()]
    return markdown(("unknowns", "cold", "from the closed form"), *lines)


def throughput(groups: dict[Any, pd.DataFrame], also: dict[str, Any]) -> str:
    """One-band problems in a batch, by the quickest solver outside rtcal and by the default path."""
    lines = [
        (n, "rtcal.exact, 100,000 at once", f"{t:.3f}", f"{1e6 / t:,.0f}")
        for n, t in also["throughput"]
    ]
    for n in SIZES:
        own = {
            route: mean(group.query(f"family == 'hard' and unknowns == {n}"))
            for (route, setting), group in groups.items()
            if setting == "default" and not route.endswith(" raw")
        }
        outside = min((r for r in own if not r.startswith("rtcal")), key=lambda r: own[r])
        for route in (outside, DEFAULT):
            cells = f"{own[route]:.0f}", f"{1e6 / own[route]:,.0f}"
            lines.append((n, f"{route}, one by one", *cells))
    head = ("n", "how", "microseconds a problem", "problems a second")
    return markdown(head, *sorted(lines, key=lambda line: line[0]))


def text(folder: Path, size: str) -> str:
    """Return the whole page."""
    rows = of_run(folder / f"{size}.csv.gz")
    also = json.loads((folder / f"{size}.json").read_text(encoding="utf-8"))
    groups = dict(list(rows.groupby(["route", "settings"], sort=False)))
    of = {key: score(own) for key, own in groups.items()}
    families = rows.groupby("family").problem.nunique()
    highs = groups["qpsolvers:highs", "default"]
    missed = highs[highs.failed & (highs.family != "sizes")].problem

    def ratio(family: str, unknowns: int) -> str:
        """OSQP's time over Clarabel's, both polished."""
        where = f"family == '{family}' and unknowns == {unknowns}"
        osqp, clarabel = (mean(groups[r, "default"].query(where)) for r in (OTHER, DEFAULT))
        return f"{osqp / clarabel:.1f}"

    levels = [
        f"| {eps:.0e} | {c['failed']} | {c['worst']} | {o['failed']} | {o['worst']} |"
        for eps, c, o in ((e, of[DEFAULT, s], of[OTHER, s]) for s, e in EPS.items())
    ]
    template = Path(__file__).with_name("page.md.jinja").read_text(encoding="utf-8")
    return jinja2.Template(template, keep_trailing_newline=True).render(
        size=size,
        rows=rows,
        also=also,
        versions=", ".join(f"{k} {v}" for k, v in also["versions"].items()),
        counts=", ".join(f"{n} {family}" for family, n in families.items()),
        largest=rows.unknowns.max(),
        within=f"{rows.within[rows.feasible].max():.0e}",
        own=of[DEFAULT, "default"],
        other=of[OTHER, "default"],
        raw=of[f"{DEFAULT} raw", "default"],
        other_raw=of[f"{OTHER} raw", "default"],
        exact=of["rtcal.exact", "default"],
        plain=of["qpsolvers:clarabel", "default"],
        ratio=ratio,
        levels="\n".join(levels),
        missed_by_highs=", ".join(f'"{name}"' for name in missed) or "none here",
        accuracy=accuracy(groups),
        times=times(groups),
        sizes=sizes(rows),
        iterations=iterations(also),
        throughput=throughput(groups, also),
        shift=f"{SHIFT:.0f}",
        enough=ENOUGH,
        too_slow=f"{TOO_SLOW:.0f}",
        runtime=f"{RUNTIME:.0f}",
        dense_limit=DENSE_LIMIT,
    )


def page(folder: Path, size: str, out: Path) -> None:
    """Write the page."""
    write_text(out / "README.md", text(folder, size))
