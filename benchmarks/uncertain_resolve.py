"""Time of one re-solve of a compiled problem in a room that is exact, and in one that is uncertain.

    python -m benchmarks.uncertain_resolve

The two are solved in turns, so that both see the same load; processor time, the median of 300.
"""

from __future__ import annotations

import time

import numpy as np

import rtcal as rt
from rtcal.calibration.methods import preset

STATED = {"volume_sigma": 0.05, "area_sigma": 0.03}
CASES = {
    "soft, exact room": ("soft", {}),
    "mle, uncertain": ("mle", STATED),
    "mle, uncertain, coefficients together": ("mle", {**STATED, "common_alpha_sigma": 0.1}),
}


def milliseconds(n: int, frequencies: list[int], solves: int = 300) -> dict[str, float]:
    """Median processor time of a re-solve, plain ("mle, exact room") and by case."""
    rng = np.random.default_rng(3)
    shape = (n, len(frequencies))
    base = rt.Room(
        name="room",
        volume=500,
        materials=[f"material {i}" for i in range(n)],
        areas=rng.uniform(5, 60, n),
        alpha=rng.uniform(0.05, 0.6, shape),
        sigma=rng.uniform(0.02, 0.08, shape),
        centre_frequencies=frequencies,
        air=rt.Air(),
    )
    cases = {"mle, exact room": ("mle", {}), **CASES}
    problems = {}
    for name, (method, stated) in cases.items():
        room = base.replace(**stated)
        problems[name] = preset(method, room).build(room, rt.Sabine())
    stated_time = rt.Sabine().reverberation_time(base)
    spent: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(solves):
        measured = stated_time * np.exp(0.05 * rng.standard_normal(shape[1]))
        for name, problem in problems.items():
            start = time.process_time()
            problem.solve(measured)
            spent[name].append(1e3 * (time.process_time() - start))
    return {name: float(np.median(each)) for name, each in spent.items()}


if __name__ == "__main__":
    octaves = [63, 125, 250, 500, 1000, 2000, 4000, 8000]
    for surfaces, frequencies in ((6, octaves[1:7]), (23, octaves)):
        print(f"{surfaces} surfaces, {len(frequencies)} bands")
        taken = milliseconds(surfaces, frequencies)
        plain = taken["mle, exact room"]
        for name, each in taken.items():
            print(f"  {name:40s} {each:6.2f} ms, {each / plain:.2f} times")
