"""The figures of a run, told apart in grey and legible on a phone."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.solvers.measure import Row


def grouped(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return the rows by route and setting."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row.route, row.settings), []).append(row)
    return found


def by_size(rows: Sequence[Row]) -> dict[tuple[str, str], dict[int, float]]:
    """Return the microseconds by route and kind of problem, then by number of unknowns."""
    found: dict[tuple[str, str], dict[int, float]] = {}
    for r in rows:
        # cvxpy's two sizes give no slope, and its first solve of a shape compiles.
        if (
            r.family == "sizes"
            and r.settings == "default"
            and r.status == "solved"
            and not r.route.startswith("cvxpy:")
        ):
            kind = r.problem.rsplit(" ", 3)[0]
            found.setdefault((r.route, kind), {})[r.unknowns] = r.microseconds
    return found


def errors(rows: Sequence[Row]) -> bytes:
    """Return the picture of the errors of what was called solved."""
    groups = {
        f"{route}, {setting.removesuffix('_accuracy')}": [
            max(r.error, 1e-17) for r in own if r.status == "solved" and np.isfinite(r.error)
        ]
        for (route, setting), own in grouped(rows).items()
        if setting in ("default", "high_accuracy")
    }
    figure, axes = _figure(5.6, 9)
    for place, values in enumerate(groups.values()):
        axes.plot(values, np.full(len(values), place), "|", color="0.6")
        axes.plot(max(values, default=1e-17), place, "o", color="black", markersize=4)
    axes.set_yticks(range(len(groups)), list(groups), fontsize=8)
    axes.set_xscale("log")
    axes.axvline(1e-4, color="0.5", linestyle="--")
    axes.set_xlabel("Error of an answer called solved (dot: the worst)")
    return _png(figure)


def sizes(rows: Sequence[Row]) -> bytes:
    """Return the picture of time over unknowns."""
    curves = {r: c for (r, kind), c in sorted(by_size(rows).items()) if kind == "mle"}
    figure, panels = _figure(5.6, 9, 3)
    groups = {
        "rtcal": [r for r in curves if r.startswith("rtcal")],
        "Clarabel and OSQP elsewhere": [
            r for r in curves if r.split(":")[-1] in ("clarabel", "osqp") and "rtcal" not in r
        ],
    }
    groups["Other solvers"] = [r for r in curves if all(r not in g for g in groups.values())]
    for axes, (title, routes) in zip(panels, groups.items(), strict=True):
        for curve in curves.values():  # all the others in grey, to compare with
            axes.loglog(*_milliseconds(curve), color="0.85", linewidth=1, zorder=0)
        for place, route in enumerate(routes):
            style = {"marker": "os^Dv*"[place], "linestyle": ("-", "--", "-.", ":")[place % 4]}
            colour = ("#000000", "#0072B2", "#D55E00")[place % 3]
            axes.loglog(
                *_milliseconds(curves[route]), color=colour, mfc="white", label=route, **style
            )
        axes.set_title(f"{title} (grey: the others)", fontsize=10)
        axes.set_ylabel("Time / ms")
        axes.set_ylim(0.08, 2e5)  # the upper third is the legend's
        axes.legend(fontsize=8, loc="upper left", ncols=2)
    panels[-1].set_xlabel("Unknowns")
    return _png(figure)


def _milliseconds(curve: dict[int, float]) -> tuple[list[int], list[float]]:
    n = sorted(curve)
    return n, [1e-3 * curve[i] for i in n]


def _figure(width: float, height: float, rows: int = 1) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure((width, height), layout="constrained")
    return figure, figure.subplots(rows)


def _png(figure: Any) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()
