"""A second solve beside plain cvxpy with Clarabel, in one run: python -m benchmarks.resolve

Plain cvxpy is the same calibration as a user would write it: alpha as the variable, 1 / sigma,
mu / sigma, the areas and the target as parameters, compiled once, solved with Clarabel at its defaults.
Its answers are neither polished nor certified. Times are milliseconds of processor time, the median
over rooms of the least of several calls, timed in turn, so that other work on the machine hardly
changes the ratios. "first" compiles. "off by" is the largest difference of alpha.
"""

from __future__ import annotations

import argparse
import time
import timeit
import warnings
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np

import rtcal as rt
from rtcal.acoustics.bands import octaves, third_octaves
from rtcal.calibration.methods import preset

METHODS = ("mle", "lse", "soft", "smooth", "robust", "correlated")
SIZES = ((6, 6), (23, 8), (40, 8))
OCTAVES, THIRDS = octaves(63, 8000), third_octaves(50, 20_000)


def case(n: int, k: int, seed: int, method: str) -> tuple[rt.Room, rt.Measurement]:
    """Return a random room and its T, with some bounds active; in thirds of octaves above 8 bands."""
    rng = np.random.default_rng(seed)
    areas, mu = rng.uniform(2, 60, n), rng.uniform(0.02, 0.6, (n, k))
    sigma = 0.02 + 0.2 * mu * rng.uniform(0.2, 2, (n, k))
    true = np.clip(mu + 2 * sigma * rng.standard_normal((n, k)), 0, 1)
    room = rt.Room(
        name="random",
        volume=300.0,
        materials=[f"m{i}" for i in range(n)],
        areas=areas,
        alpha=mu,
        sigma=sigma,
        centre_frequencies=(OCTAVES if k <= len(OCTAVES) else THIRDS)[:k],
        air=rt.Air(),
        band_correlation=0.5 if method == "correlated" else 0.0,
    )
    t = rt.Eyring().time(room, areas @ true)
    return room, rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        values={"t20": t[np.newaxis]},
        uncertainty={"t20": 0.05 * t[np.newaxis]},
    )


class Plain:
    """The calibration in plain cvxpy."""

    def __init__(self, method: str, n: int, k: int) -> None:
        self.alpha = cp.Variable((n, k))
        self.weight, self.weighted = cp.Parameter((n, k), nonneg=True), cp.Parameter((n, k))
        self.areas, self.target = cp.Parameter((1, n), nonneg=True), cp.Parameter(k)
        self.steep, self.scaled = cp.Parameter((n, k), nonneg=True), cp.Parameter(k)
        x = cp.multiply(self.weight, self.alpha) - self.weighted
        objective, constraints = cp.sum_squares(x), [self.alpha >= 0, self.alpha <= 1]
        if method == "robust":
            objective = 0.01 * objective + 0.99 * cp.sum(cp.huber(x, 1.5))
        if method == "correlated":
            r = rt.acoustics.bands.correlation(np.array(OCTAVES[:k], dtype=float), 0.5)
            objective = cp.sum_squares(x @ np.linalg.inv(np.linalg.cholesky(r)).T)
        if method == "smooth":
            objective = objective + 0.3 * cp.sum_squares(x[:, 1:] - x[:, :-1])
        if method in ("mle", "lse", "correlated"):
            constraints.append((self.areas @ self.alpha)[0] == self.target)
        else:
            match = cp.sum(cp.multiply(self.steep, self.alpha), axis=0) - self.scaled
            objective = objective + cp.sum_squares(match)
        self.problem = cp.Problem(cp.Minimize(objective), constraints)

    def solve(self, room: rt.Room, target: np.ndarray, u: np.ndarray, method: str) -> np.ndarray:
        """Return alpha."""
        sigma = np.ones_like(room.sigma) if method == "lse" else room.sigma
        self.weight.value, self.weighted.value = 1 / sigma, room.alpha / sigma
        self.areas.value, self.target.value = room.areas[np.newaxis], target
        self.steep.value, self.scaled.value = room.areas[:, np.newaxis] / u, target / u
        self.problem.solve(solver=cp.CLARABEL)
        return np.asarray(self.alpha.value)


def least(call: Callable[[], Any], times: int = 5) -> float:
    """Return the least processor time of several calls in ms."""
    spent = timeit.repeat(call, timer=time.process_time, number=1, repeat=times)
    return 1e3 * min(spent)


def row(method: str, n: int, k: int, rooms: int) -> list[float]:
    """Return ms of plain cvxpy, of a second solve, of a second `rt.calibrate` and of a first one."""
    name, plain = "mle" if method == "correlated" else method, Plain(method, n, k)
    spent, off = [], 0.0
    rt.calibration.forget()
    first = least(lambda: rt.calibrate(*case(n, k, 0, method), method=name), 1)
    problem = preset(name, case(n, k, 0, method)[0]).build(case(n, k, 0, method)[0])
    for seed in range(rooms):
        room, measured = case(n, k, seed, method)
        result = problem.solve(measured, room)
        b, u = result.target, result.target_uncertainty
        spent.append(
            [
                least(lambda: plain.solve(room, b, u, method)),  # noqa: B023 (it is called at once)
                least(lambda: problem.solve(measured, room)),  # noqa: B023
                least(lambda: rt.calibrate(room, measured, method=name)),  # noqa: B023
            ]
        )
        if method != "smooth":  # plain cvxpy has no widths of bands
            off = max(off, float(np.max(np.abs(plain.solve(room, b, u, method) - result.alpha))))
        if not result.certificate.accepted:
            raise SystemExit(f"{method}, room {seed}: the certificate does not pass")
    return [*np.median(spent, axis=0), first, off]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=12)
    rooms = parser.parse_args().rooms
    warnings.simplefilter("ignore")
    print("method      n x k   plain  solve  ratio  calibrate  ratio  first  plain off by")
    for n, k in SIZES:
        for method in METHODS:
            plain, solve, calibrate, first, off = row(method, n, k, rooms)
            print(
                f"{method:10s} {n:3d} x {k} {plain:6.2f} {solve:6.2f} {solve / plain:6.2f} "
                f"{calibrate:10.2f} {calibrate / plain:6.2f} {first:6.0f} {off:10.0e}"
            )


if __name__ == "__main__":
    main()
