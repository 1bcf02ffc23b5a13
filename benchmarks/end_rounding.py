"""Rounding of b at an end of its range: `python benchmarks/end_rounding.py`.

A room with all coefficients at their lower bound has a T, from which the calibration computes b. In
exact arithmetic b is the end of its range. The table has the largest |b - end| in units of
eps sum S, where `rtcal.calibration.feasibility.end_tolerance` allows 16 n. The exact sum is
`math.fsum`'s. Rooms are random; half of them have air.
"""

from __future__ import annotations

import math

import numpy as np

import rtcal as rt

EQUATIONS = (rt.Sabine(), rt.Eyring(), rt.Kuttruff())
ROOMS = {1: 2000, 2: 2000, 6: 2000, 23: 1000, 200: 300}


def error(rng: np.random.Generator, n: int, equation: rt.equations.LinearEquation) -> float:
    areas = rng.uniform(1, 100, n)
    alpha = rng.uniform(0.001, 0.8, (n, 4))
    room = rt.Room(
        name="random",
        volume=float(rng.uniform(0.3, 1) * (areas.sum() / 4.84) ** 1.5),
        materials=[f"m{i}" for i in range(n)],
        areas=areas,
        alpha=alpha,
        sigma=np.full((n, 4), 0.1),
        centre_frequencies=[125, 500, 2000, 4000],
        air=rt.Air() if rng.integers(2) else None,
    )
    end = np.array([math.fsum(areas * column) for column in alpha.T])
    b = equation.target(room, equation.time(room, end))
    return float(np.max(np.abs(b - end)) / (np.finfo(float).eps * areas.sum()))


def main() -> None:
    rng = np.random.default_rng(20261122)
    print("largest |b - end| / (eps sum S); allowed: 16 n")
    print(f"{'n':>5}" + "".join(f"{e.name:>12}" for e in EQUATIONS))
    for n, count in ROOMS.items():
        worst = [max(error(rng, n, e) for _ in range(count)) for e in EQUATIONS]
        print(f"{n:5}" + "".join(f"{w:12.2f}" for w in worst))


if __name__ == "__main__":
    main()
