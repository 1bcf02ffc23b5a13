"""Can scattering bring C80 and EDT nearer, once T is calibrated? README.md has the counts.

Reality is pyroomacoustics' ray tracer, the program rtcal's path tracer; scattering and absorption of
reality are hidden. A second run of the calibrated room at another scattering gives the derivatives of
C80 and EDT by it. The scattering with the least squares of both gaps is simulated, T calibrated again.

python -m benchmarks.studies.loops.scattering 0 10 --seed 1
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.acoustics.marks import gap_jnd
from rtcal.simulators import PathTracing, Polyhedron, RayTracing
from rtcal.simulators.geometry import SHOEBOX_WALLS

F = 125.0 * 2.0 ** np.arange(6)
USED = ("edt", "c80")
STEP, FARTHEST = 1.6, 2.5
"""Ratio of the two runs' scattering, and of the chosen one to the first at most."""
LEAST, MOST = 0.05, 0.95


def gaps(simulated: rt.Measurement, measured: rt.Measurement) -> np.ndarray:
    """Return the gaps of the means of EDT and C80 in JND, (2, n_bands)."""
    return np.array([gap_jnd(simulated.mean(p), measured.mean(p), p) for p in USED])


def tried(seed: int, number: int) -> dict[str, Any]:
    """Return scatterings and mean absolute gaps of a room before and after."""
    rng = np.random.default_rng([62, 3, seed, number])
    size = rng.uniform([6, 5, 2.8], [14, 10, 6])
    walls = [*SHOEBOX_WALLS]
    geometry = Polyhedron.shoebox(tuple(size.tolist()), dict(zip(walls, walls, strict=True)))
    base = np.exp(rng.uniform(np.log(0.04), np.log(0.3), (6, 1)))
    true = np.clip(base * (F / 500) ** rng.uniform(-0.15, 0.25, (6, 1)), 0.02, 0.85)
    stated = np.clip(true * np.exp(0.2 * rng.standard_normal((6, 1))), 0.02, 0.9)
    room = rt.Room(
        name="box", volume=geometry.volume, materials=walls,
        areas=[geometry.areas[w] for w in walls], alpha=stated, sigma=0.3 * stated,
        centre_frequencies=F, air=rt.Air(20, 50), dimensions=tuple(size.tolist()),
    )  # fmt: skip
    point = size * rng.uniform(0.15, 0.85, (5, 3))
    at: dict[str, Any] = {
        "room": room, "geometry": geometry, "sources": {"S": tuple(point[0].tolist())},
        "receivers": {f"R{i}": tuple(p.tolist()) for i, p in enumerate(point[1:], 1)},
    }  # fmt: skip
    hidden, guess = rng.uniform(0.1, 0.7), rng.uniform(0.1, 0.7)
    measured = RayTracing(**at, scattering=hidden, n_rays=16000, n_batches=2).simulate(true, seed=1)

    def program(s: float) -> PathTracing:
        return PathTracing(**at, scattering=s, n_paths=12000, n_batches=2, workers=1)

    def calibrated(s: float) -> Any:
        return rt.calibrate_simulator(program(s), room, measured, max_simulations=5)

    first = calibrated(guess)
    before = first.after
    other = guess * STEP if guess < 0.4 else guess / STEP
    second = program(other).simulate(first.alpha, seed=2)
    # EDT and C80 of both runs at one T: of an exponential decay, by the T of each.
    by = np.log(other / guess)
    slope = (at_one_time(second, before, measured) - gaps(before, measured)) / by
    gap = gaps(before, measured)
    step = -float((slope * gap).sum() / (slope * slope).sum())
    farthest = np.log(FARTHEST)
    chosen = float(np.clip(guess * np.exp(np.clip(step, -farthest, farthest)), LEAST, MOST))
    after = calibrated(chosen).after
    return {
        "scattering": (hidden, guess, chosen),
        "before": np.abs(gap).mean(axis=1),
        "after": np.abs(gaps(after, measured)).mean(axis=1),
        "t": [np.abs(gap_jnd(m.mean("t20"), measured.mean("t20"))).mean() for m in (before, after)],
    }


def at_one_time(run: rt.Measurement, like: rt.Measurement, measured: rt.Measurement) -> np.ndarray:
    """Return the gaps of a run if it had the T20 of another one, its decay as exponential."""
    ratio = like.mean("t20") / run.mean("t20")

    def c80(t: np.ndarray) -> np.ndarray:
        return 10 * np.log10(np.expm1(0.08 * 6 * np.log(10) / t))

    edt = run.mean("edt") * ratio
    clarity = run.mean("c80") + c80(like.mean("t20")) - c80(run.mean("t20"))
    moved = rt.Measurement.from_values(F, edt=edt, c80=clarity)
    return gaps(moved, measured)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    every = []
    for number in range(args.first, args.last):
        every.append(made := tried(args.seed, number))
        hidden, guess, chosen = made["scattering"]
        edt, c80 = zip(made["before"], made["after"], strict=True)
        print(
            f"{number}: scattering {hidden:.2f}, {guess:.2f} to {chosen:.2f}; EDT {edt[0]:.2f} to "
            f"{edt[1]:.2f} JND, C80 {c80[0]:.2f} to {c80[1]:.2f} JND; T {made['t'][0]:.2f}, "
            f"{made['t'][1]:.2f} JND",
            flush=True,
        )
    for i, p in enumerate(USED):
        fell = sum(m["after"][i] < m["before"][i] for m in every)
        print(f"{p}: the gap shrinks in {fell} of {len(every)}")
    nearer = sum(
        abs(np.subtract(*m["scattering"][::2])) < abs(np.subtract(*m["scattering"][:2]))
        for m in every
    )
    print(f"scattering nearer to the hidden one in {nearer} of {len(every)}")
