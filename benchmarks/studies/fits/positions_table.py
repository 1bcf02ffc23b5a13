"""The calibration to every position beside T20 alone, on the frozen position rooms: the table.

    python -m benchmarks.studies.fits.positions_table  # of the stored run

All pairs were fitted for alpha, and those of three receivers for the gaps at the other three. A method
is "t20" (the loop of `rtcal.calibrate_simulator`) or "positions" (the same with ``match``). The gaps of
the stated and of the true alpha stand beside them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.studies import stored
from benchmarks.studies.position_rooms.load import PRIORS
from benchmarks.studies.rates import Line, over, share
from benchmarks.studies.stored import Row

GAPS = ("edt", "c80", "g")
JUDGED = 2
"""Population that no other version of the calibration was judged on. An earlier one was on 1."""
ALLOWED = 0.05
"""An error of alpha that is at most so much larger than the prior's counts as no worse."""
FITTING = {"t20": "T20 alone", "positions": "every position"}
METHODS = {
    "positions": "every position",
    "perfect": "true alpha and scattering",
    "truth": "true alpha",
    "stated": "stated alpha",
}
GAP_KINDS = {"gap_without_noise": "to what is heard", "gap": "to what was measured"}
"""At the held-out pairs. What is heard has no noise. What was measured has it, and with it a gap that
no alpha closes: that of the true one."""


def stored_run(population: int, part: str = "results") -> Path:
    """Return the file of a stored run: "results" or "bound"."""
    return stored.HERE / "position_rooms" / f"population_{population}_{part}.jsonl"


def read(file: Path) -> list[Row]:
    """Return the rows of a run in the order of their rooms."""
    return sorted(stored.rows(file), key=lambda row: int(row["index"]))


def median_ratio(a: np.ndarray, b: np.ndarray) -> Line:
    """Return the median over rooms of a ratio."""
    return over(lambda a, b: np.median(a / b), a, b)


def ratio_of_sums(a: np.ndarray, b: np.ndarray) -> Line:
    """Return the ratio of sums over rooms."""
    return over(lambda a, b: a.sum() / b.sum(), a, b)


def complete(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the rooms that have one of every method and prior there is."""
    methods = {r["method"] for r in rows}
    number = Counter(r["index"] for r in rows)
    return [r for r in rows if number[r["index"]] == len(methods) * len(PRIORS)]


def summary(rows: Sequence[Row]) -> dict[str, Line]:
    """Return the figures of complete rooms by name, each with its 95 % interval."""
    rows = complete(rows)
    found: dict[str, Line] = {}
    for prior in PRIORS:
        of = {
            method: [r for r in rows if (r["prior"], r["method"]) == (prior, method)]
            for method in ("t20", *METHODS)
        }
        base, t20, every = (
            np.array([r[key] for r in of[method]])
            for method, key in (("t20", "prior_error"), ("t20", "error"), ("positions", "error"))
        )
        found[f"{prior}: error, every position / T20 alone"] = median_ratio(every, t20)
        for name, error in zip(FITTING.values(), (t20, every), strict=True):
            found[f"{prior}: error, {name} / prior"] = median_ratio(error, base)
            no_worse = share(error <= (1 + ALLOWED) * base)
            found[f"{prior}: {name} no worse than the prior"] = no_worse
        found[f"{prior}: coverage of 90 % intervals"] = ratio_of_sums(
            *(np.array([r[n] for r in of["positions"]]) for n in ("covered", "coefficients"))
        )
        for kind, name in GAP_KINDS.items():
            alone = over_parameters(of["t20"], kind)
            gap = {method: over_parameters(of[method], kind) for method in METHODS}
            of_gap = f"{prior}: gap {name}"
            for method, label in METHODS.items():
                found[f"{of_gap}, {label} / T20 alone"] = ratio_of_sums(gap[method], alone)
            # The ratio of sums is that of the rooms with large gaps.
            by_room = median_ratio(gap["positions"], alone)
            found[f"{of_gap}, every position / T20 alone, room by room"] = by_room
            kept = np.arange(len(alone)) != np.argmax(alone)
            found[f"{of_gap}, without the room where T20 alone has the largest"] = ratio_of_sums(
                gap["positions"][kept], alone[kept]
            )
            foretold = over_parameters(of["positions"], kind.replace("gap", "predicted"))
            found[f"{of_gap}, predicted by every position / T20 alone"] = ratio_of_sums(
                foretold, alone
            )
    return found


def over_parameters(rows: list[Row], kind: str) -> np.ndarray:
    """Return each room's gap, the mean over the parameters, in JND."""
    return np.array([np.mean([row[kind][p] for p in GAPS]) for row in rows])


def print_bound(bounds: Sequence[Row], rows: Sequence[Row]) -> None:
    """Print the expected error of alpha with a perfect simulator, over that of T20 alone."""
    for prior in PRIORS:
        t20 = {r["index"]: r["error"] for r in rows if (r["method"], r["prior"]) == ("t20", prior)}
        least = {r["index"]: r["least_error"] for r in bounds if r["prior"] == prior}
        both = [(least[i], t20[i]) for i in sorted(least.keys() & t20.keys())]
        value, low, high, n = median_ratio(*np.transpose(both))
        print(
            f"{prior}: a simulator without error / T20 alone, {n} rooms: "
            f"{value:.3f}  {low:.3f} to {high:.3f}"
        )


def table(rows: Sequence[Row]) -> None:
    """Print the figures of the complete rooms, and what a room with the wide prior cost.

    The narrow prior comes second and has the traces of the wide one, so its costs say nothing.
    """
    rows = complete(rows)
    rooms = {r["index"] for r in rows}
    boxes = sum(i % 2 == 0 for i in rooms)
    print(f"{len(rooms)} rooms, {boxes} boxes; 95 % intervals over rooms")
    for name, (value, low, high, _) in summary(rows).items():
        print(f"{name:67} {value:6.3f}  {low:.3f} to {high:.3f}")
    for method in FITTING:
        chosen = [r for r in rows if (r["method"], r["prior"]) == (method, "wide")]
        costs = np.array([[r[k] for k in ("seconds", "processor", "traces")] for r in chosen])
        seconds, processor, traces = np.median(costs, axis=0)
        print(
            f"{method}: median {seconds:.1f} s, {processor:.1f} s of processor, {traces:.0f} "
            f"traces, at most {costs[:, 2].max():.0f}"
        )


if __name__ == "__main__":
    run = read(stored_run(JUDGED))
    table(run)
    print_bound(read(stored_run(JUDGED, "bound")), complete(run))
