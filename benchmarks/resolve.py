"""Speed of the main path, as ratios within one run: `python benchmarks/resolve.py`.

The first table has a re-solve of a problem that was built once, a second `rt.calibrate` of the same
shape, a calibration after `rt.calibration.forget()`, and Clarabel alone: set up at its defaults, but
for a tolerance of 1e-10, and solved for the same matrices, which are ready. Then come the parts of a
re-solve beside the solver: polish and certificate. The error bound is computed when it is read. The
second table has the solvers that take a start, with and without the closed form. The last line is
`import rtcal` against `import numpy`.

All are medians over rooms of the least of five calls. What is compared is timed in turn for each room,
so that a drifting machine touches all alike, in processor time, so that other work on the machine
hardly counts.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from statistics import median

import clarabel
import numpy as np
import qpsolvers

import rtcal as rt
from rtcal.calibration.certificate import certify, largest_error
from rtcal.calibration.compiled_qp import Matrices
from rtcal.calibration.convex_program import RawSolution
from rtcal.calibration.methods import preset
from rtcal.calibration.numpy_model import NumpyModel
from rtcal.calibration.optimum import polish_answer
from rtcal.calibration.solvers import SETTINGS, STARTED

BANDS = 8
SIZES = (6, 23, 40)
MOST = {"re-solve / Clarabel": 1.5, "calibrate / re-solve": 1.3}
"""Largest ratios that are promised for 23 materials."""
IMPORT_LIMIT = 1.5
EYRING = rt.Eyring()


def room(rng: np.random.Generator, n: int) -> rt.Room:
    return rt.Room(
        name="random",
        volume=300,
        materials=[f"m{i}" for i in range(n)],
        areas=rng.uniform(5, 60, n),
        alpha=rng.uniform(0.05, 0.6, (n, BANDS)),
        sigma=rng.uniform(0.01, 0.1, (n, BANDS)),
        centre_frequencies=[63, 125, 250, 500, 1000, 2000, 4000, 8000],
        air=rt.Air(),
    )


def rooms(n: int, repeats: int) -> Iterator[tuple[rt.Room, np.ndarray]]:
    """Rooms of one shape with a T that their prior allows."""
    rng = np.random.default_rng(n)
    for _ in range(repeats):
        given = room(rng, n)
        drawn = given.alpha + given.sigma * rng.standard_normal(given.alpha.shape)
        yield given, EYRING.time(given, given.areas @ np.clip(drawn, 0.01, 1))


def alone(qp: Matrices) -> None:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
        setattr(settings, name, SETTINGS["CLARABEL"][name])
    cones = [clarabel.ZeroConeT(qp.n_equal), clarabel.NonnegativeConeT(len(qp.b) - qp.n_equal)]
    clarabel.DefaultSolver(qp.P_upper, qp.q, qp.A, qp.b, cones, settings).solve()


def polished(model: NumpyModel, raw: RawSolution) -> None:
    """Polish with a model whose matrices are not made yet, as in a re-solve."""
    nothing = np.zeros(len(raw.unknowns), dtype=bool)
    polish_answer(replace(model), raw.unknowns, raw.multipliers, nothing, nothing)


def timed(call: Callable[[], object], calls: int = 5) -> float:
    least = np.inf
    for _ in range(calls):
        began = time.process_time()
        call()
        least = min(least, time.process_time() - began)
    return least


def resolve(n: int, repeats: int) -> dict[str, float]:
    """Median seconds of each way to the answer, and of a re-solve's parts."""
    seconds: dict[str, list[float]] = defaultdict(list)
    ((first, _),) = rooms(n, 1)
    problem = preset("mle").build(first)
    for i, (given, t) in enumerate(rooms(n, repeats + 3)):
        if i == 3:  # warm caches do not count
            seconds.clear()
        solution = problem.solve(t, room=given).joint.solution
        qp, raw, data = problem.whitened(t, given).matrices, solution.raw, solution.model.data
        model = NumpyModel(data, solution.model.objective, solution.model.row_constraints)
        answer = solution.unknowns, solution.multipliers
        calls: dict[str, Callable[[], object]] = {
            "re-solve": partial(problem.solve, t, given),
            "calibrate": partial(rt.calibrate, given, t),
            "Clarabel": partial(alone, qp),
            "polish": partial(polished, model, raw),
            "certificate": partial(certify, model, *answer),
            "error bound": partial(largest_error, model, answer[0], answer[1].rows),
        }
        for name, call in calls.items():
            seconds[name].append(timed(call))
        if i % 10 == 3:
            rt.calibration.forget()
            seconds["from nothing"].append(timed(calls["calibrate"], calls=1))
    return {name: median(values) for name, values in seconds.items()}


def starts(n: int, repeats: int) -> Iterator[tuple[str, bool, dict[str, tuple[int, float]]]]:
    """Median iterations and seconds of each solver, without and with bounds active, by its start."""
    for solver in STARTED:
        if solver.startswith("qpsolvers:") and solver[10:] not in qpsolvers.available_solvers:
            print(f"{solver} is not installed")
            continue
        for active in (False, True):
            found: dict[str, list[tuple[int, float]]] = defaultdict(list)
            for given, t in rooms(n, repeats):
                # Between 0.35 and 0.6 nothing meets a bound; a room so hard pushes many to 0.
                inside = given.replace(alpha=np.clip(given.alpha, 0.35, 0.6))
                share = 0.15 if active else 0.95
                t = EYRING.time(inside, share * inside.absorption_area)
                for how in ("none", "auto"):
                    call = partial(rt.calibrate, inside, t, solver=solver, warm_start=how)
                    result, took = call(), timed(call)
                    found[how].append((result.raw.iterations, took))
                    if result.active.any() != active:
                        raise RuntimeError(f"{solver}: bounds are not as the table says")
            yield (
                solver,
                active,
                {
                    how: (int(median(i for i, _ in runs)), median(s for _, s in runs))
                    for how, runs in found.items()
                },
            )


def import_time(module: str) -> float:
    """Seconds of a fresh interpreter's import, its own start taken out."""
    code = f"import time; t = time.process_time(); import {module}; print(time.process_time() - t)"
    return float(
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    repeats = parser.parse_args().repeats
    print(f"n x {BANDS} bands, medians of {repeats} rooms: milliseconds")
    ways = ("re-solve", "calibrate", "from nothing", "Clarabel")
    parts = ("polish", "certificate", "error bound")
    print("   n" + "".join(f"{name:>14}" for name in (*ways, *parts)))
    ratios = {}
    for n in SIZES:
        took = resolve(n, repeats)
        print(f"{n:4d}" + "".join(f"{1e3 * took[name]:14.3f}" for name in (*ways, *parts)))
        ratios[n] = {ratio: _quotient(took, ratio) for ratio in MOST}
        ratios[n]["from nothing / re-solve"] = took["from nothing"] / took["re-solve"]
    for n, of in ratios.items():
        print(f"{n:4d}  " + ", ".join(f"{ratio} {value:.2f}" for ratio, value in of.items()))
    for ratio, most in MOST.items():
        print(f"{ratio}, 23 materials: {ratios[23][ratio]:.2f} (at most {most})")
    print(
        f"\n23 x {BANDS} bands, with and without the closed form as start, medians of {repeats // 5}"
    )
    print("solver            bounds    iterations cold, warm    milliseconds cold, warm")
    for solver, active, of in starts(23, repeats // 5):
        (cold, cold_time), (warm, warm_time) = of["none"], of["auto"]
        counts = f"{cold}, {warm}" if warm else "not stated"
        print(
            f"{solver:17} {'active' if active else 'free':7} {counts:>23}"
            f"{1e3 * cold_time:17.2f}, {1e3 * warm_time:.2f}"
        )
    both = [(import_time("numpy"), import_time("rtcal")) for _ in range(21)]
    numpy_time, own_time = (median(times) for times in zip(*both, strict=True))
    print(
        f"\nimport: numpy {1e3 * numpy_time:.0f} ms, rtcal {1e3 * own_time:.0f} ms, "
        f"ratio {own_time / numpy_time:.2f} (at most {IMPORT_LIMIT})"
    )


def _quotient(took: dict[str, float], ratio: str) -> float:
    above, below = ratio.split(" / ")
    return took[above] / took[below]


if __name__ == "__main__":
    main()
