"""Speed of the main path, as ratios within one run: `python benchmarks/resolve.py`.

Re-solving a problem that was built once, with polish and certificate, against building it anew for
every solve and against Clarabel's own solve time; and `import rtcal` against `import numpy`. Medians
of 200 solves for each size, the three timed in turn so that a drifting machine touches all alike,
in processor time, so that other work on the machine does not count. (Clarabel's own time is its wall
clock: short enough that it is hardly ever interrupted.)
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from statistics import median

import numpy as np

import rtcal as rt
from rtcal.calibration.presets import preset

BANDS = 8
# Promised: rebuild at least this many times slower, and Clarabel's own time at most this
# many times quicker.
LIMITS = {6: (3, 8), 23: (3, 4), 40: (2, 4)}
IMPORT_LIMIT = 1.5


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


def resolve(n: int, repeats: int) -> tuple[float, float, float]:
    """Median seconds of a re-solve, of a rebuild with its solve, and of Clarabel alone."""
    rng = np.random.default_rng(n)
    equation = rt.Eyring()
    problem = preset("mle").build(room(rng, n), equation)
    again, anew, own = [], [], []
    for i in range(repeats + 3):
        given = room(rng, n)
        drawn = np.clip(given.alpha + given.sigma * rng.standard_normal(given.alpha.shape), 0.01, 1)
        t = equation.time(given, given.areas @ drawn)
        began = time.process_time()
        result = problem.solve(t, room=given)
        again.append(time.process_time() - began)
        own.append(result.raw.seconds)
        began = time.process_time()
        preset("mle").build(given, equation).solve(t)
        anew.append(time.process_time() - began)
        if i < 3:  # warm caches do not count
            again.clear(), anew.clear(), own.clear()
    return median(again), median(anew), median(own)


def import_time(module: str, repeats: int) -> float:
    """Median seconds of a fresh interpreter's import, its own start taken out."""
    code = f"import time; t = time.process_time(); import {module}; print(time.process_time() - t)"
    runs = [
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
        for _ in range(repeats)
    ]
    return median(runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    repeats = parser.parse_args().repeats
    print(f"n x {BANDS} bands, medians of {repeats}: milliseconds")
    print(
        "   n  re-solve  rebuild  Clarabel   rebuild/re-solve (at least)  re-solve/Clarabel (at most)"
    )
    for n, (least, most) in LIMITS.items():
        again, anew, own = resolve(n, repeats)
        print(
            f"{n:4d}  {1e3 * again:8.2f} {1e3 * anew:8.2f}  {1e3 * own:8.2f}"
            f"   {anew / again:16.1f} ({least}){again / own:25.1f} ({most})"
        )
    both = [(import_time("numpy", 1), import_time("rtcal", 1)) for _ in range(21)]
    numpy_time, own_time = (median(times) for times in zip(*both, strict=True))
    print(
        f"import: numpy {1e3 * numpy_time:.0f} ms, rtcal {1e3 * own_time:.0f} ms, "
        f"ratio {own_time / numpy_time:.2f} (at most {IMPORT_LIMIT})"
    )


if __name__ == "__main__":
    main()
