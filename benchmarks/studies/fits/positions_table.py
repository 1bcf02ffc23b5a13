"""The calibration to every position beside T20 alone, on the frozen position rooms: the table.

    python -m benchmarks.studies.fits.positions_table  # of the stored run

All pairs were fitted for alpha, and those of three receivers for the gaps at the other three. A method
is "t20" (the loop of `rtcal.calibrate_simulator`) or "positions" (the same with ``match``). The gaps of
the stated and of the true alpha stand beside them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.position_rooms.load import PRIORS
from benchmarks.studies.stored import HERE
from rtcal.finder.records import Share

GAPS = ("edt", "c80", "g")
JUDGED = 2
"""Population that no other version of the calibration was judged on. An earlier one was on 1."""
RNG = 20261122
ALLOWED = 0.05
"""An error of alpha that is at most so much larger than the prior's counts as no worse."""
FITTING = {"t20": "T20 alone", "positions": "every position"}
METHODS = {
    **FITTING,
    "perfect": "true alpha and scattering",
    "truth": "true alpha",
    "stated": "stated alpha",
}
GAP_KINDS = {"gap_without_noise": "to what is heard", "gap": "to what was measured"}
"""At the held-out pairs. What is heard has no noise. What was measured has it, and with it a gap that
no alpha closes: that of the true one."""


def stored_run(population: int, part: str = "results") -> Path:
    """Return the file of a stored run: "results", "bound", "before"."""
    return HERE / "position_rooms" / f"population_{population}_{part}.jsonl"


def read(path: Path) -> list[dict[str, Any]]:
    return (
        [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []
    )


def bootstrap(
    statistic: Callable[[np.ndarray], float], n: int, draws: int = 4000
) -> tuple[float, float, float]:
    """Return a statistic of rooms' numbers 0 to n - 1 with its 95 % interval over rooms."""
    rng = np.random.default_rng(RNG)
    values = [statistic(rng.integers(n, size=n)) for _ in range(draws)]
    low, high = np.quantile(values, [0.025, 0.975])
    return statistic(np.arange(n)), float(low), float(high)


def share(hits: int, n: int) -> tuple[float, float, float]:
    """Return a share with its 95 % interval (Clopper & Pearson 1934)."""
    return (hits / n, *Share(hits, n).interval)


def median_ratio(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    return bootstrap(lambda i: float(np.median((a / b)[i])), len(a))


def ratio_of_sums(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    return bootstrap(lambda i: float(a[i].sum() / b[i].sum()), len(a))


def no_worse(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    return share(int((a <= (1 + ALLOWED) * b).sum()), len(a))


def over_parameters(rows: list[dict[str, Any]], kind: str) -> np.ndarray:
    """Return each room's gap, the mean over the parameters, in JND."""
    return np.array([np.mean([row[kind][p] for p in GAPS]) for row in rows])


def complete(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of the rooms that have one of every method and prior there is."""
    methods = {r["method"] for r in rows}
    number = Counter(r["index"] for r in rows)
    return [r for r in rows if number[r["index"]] == len(methods) * len(PRIORS)]


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, tuple[float, float, float]]:
    """Return the figures of complete rooms by name, each with its 95 % interval."""
    rows = complete(rows)
    found: dict[str, tuple[float, float, float]] = {}
    for prior in PRIORS:
        of = {
            method: sorted(
                (r for r in rows if r["prior"] == prior and r["method"] == method),
                key=lambda r: int(r["index"]),
            )
            for method in METHODS
        }
        base = np.array([r["prior_error"] for r in of["t20"]])
        errors = {m: np.array([r["error"] for r in of[m]]) for m in FITTING if of[m]}
        every = errors.get("positions")
        if every is not None:
            found[f"{prior}: error, every position / T20 alone"] = median_ratio(
                every, errors["t20"]
            )
        for method, name in FITTING.items():
            if method in errors:
                found[f"{prior}: error, {name} / prior"] = median_ratio(errors[method], base)
                found[f"{prior}: {name} no worse than the prior"] = no_worse(errors[method], base)
        if stating := [r for r in of["positions"] if "covered" in r]:
            found[f"{prior}: coverage of 90 % intervals"] = ratio_of_sums(
                *(np.array([r[n] for r in stating]) for n in ("covered", "coefficients"))
            )
        for kind, name in GAP_KINDS.items():
            gaps = {m: over_parameters(of[m], kind) for m in METHODS if of[m]}
            for method in ("positions", "perfect", "truth", "stated"):
                if method in gaps:
                    label = f"{prior}: gap {name}, {METHODS[method]} / T20 alone"
                    found[label] = ratio_of_sums(gaps[method], gaps["t20"])
            if "positions" in gaps:
                # The ratio of sums is that of the rooms with large gaps.
                label = f"{prior}: gap {name}, every position / T20 alone, room by room"
                found[label] = median_ratio(gaps["positions"], gaps["t20"])
                kept = np.arange(len(gaps["t20"])) != np.argmax(gaps["t20"])
                label = f"{prior}: gap {name}, without the room where T20 alone has the largest"
                found[label] = ratio_of_sums(gaps["positions"][kept], gaps["t20"][kept])
                foretold = over_parameters(of["positions"], kind.replace("gap", "predicted"))
                label = f"{prior}: gap {name}, predicted by every position / T20 alone"
                found[label] = ratio_of_sums(foretold, gaps["t20"])
    return found


def bound_ratios(
    bounds: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]], prior: str
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return the least expected errors, those of T20 alone, and the rooms that have both."""
    t20 = {r["index"]: r["error"] for r in rows if (r["method"], r["prior"]) == ("t20", prior)}
    least = {r["index"]: r["least_error"] for r in bounds if r["prior"] == prior}
    rooms = sorted(least.keys() & t20.keys())
    return np.array([least[i] for i in rooms]), np.array([t20[i] for i in rooms]), rooms


def print_bound(bounds: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]]) -> None:
    """Print the expected error of alpha with a perfect simulator, over that of T20 alone."""
    for prior in PRIORS:
        least, base, rooms = bound_ratios(bounds, rows, prior)
        if rooms:
            value, low, high = median_ratio(least, base)
            print(
                f"{prior}: a simulator without error / T20 alone, {len(rooms)} rooms: "
                f"{value:.3f}  {low:.3f} to {high:.3f}"
            )


def table(rows: Sequence[dict[str, Any]]) -> None:
    """Print the figures of the complete rooms, and what a room with the wide prior cost.

    The narrow prior comes second and has the traces of the wide one, so its costs say nothing.
    """
    rows = complete(rows)
    rooms = sorted({r["index"] for r in rows})
    boxes = sum(i % 2 == 0 for i in rooms)
    print(f"{len(rooms)} rooms, {boxes} boxes; 95 % intervals over rooms")
    for name, (value, low, high) in summary(rows).items():
        print(f"{name:67} {value:6.3f}  {low:.3f} to {high:.3f}")
    for method in ("t20", "positions"):
        chosen = [r for r in rows if (r["method"], r["prior"]) == (method, "wide")]
        if chosen:
            seconds, processor, traces = (
                np.median([r[k] for r in chosen]) for k in ("seconds", "processor", "traces")
            )
            most = max(r["traces"] for r in chosen)
            print(
                f"{method}: median {seconds:.1f} s, {processor:.1f} s of processor, {traces:.0f} "
                f"traces, at most {most}"
            )


if __name__ == "__main__":
    run = read(stored_run(JUDGED))
    table(run)
    print_bound(read(stored_run(JUDGED, "bound")), complete(run))
