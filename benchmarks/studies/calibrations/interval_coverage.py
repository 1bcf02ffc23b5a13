"""The share of `result.interval` that holds the true coefficient: 2,000 rooms with noise in T.

    # 2,000 rooms; prints the table, about 8 minutes
    python -m benchmarks.studies.calibrations.interval_coverage
    python -m benchmarks.studies.calibrations.interval_coverage --rooms 200

A room has one to eight materials, 2 to 200 m² each, and one band. Half of the stated coefficients are
`anywhere` in 0.02 to 0.9, half `small`, from 0 to two sigma; sigma is 0.01 to 0.15. The true ones are
drawn from the prior, normal and cut to the bounds. u_T is 1 to 20 % of the true T, log-uniform, and the
measured T errs by it. Every room is calibrated with the exact match (`mle`) and the soft one, and
T that no coefficients give is taken as the nearest. Seeds are the rooms' numbers. ± is the
standard error over rooms.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.support.normal import truncated_normal

METHODS = ("mle", "soft")
MOST = 8
RANGES = ((0.01, 0.03), (0.03, 0.08), (0.08, 0.2))
"""Of u_T / T, by which the table is split."""


@dataclass(frozen=True)
class Drawn:
    """A room as it is stated, its true coefficients, and the measured T with its uncertainty."""

    room: rt.Room
    truth: np.ndarray
    measured: rt.Measurement
    relative: float


def draw(seed: int) -> Drawn:
    """Return a room of ``seed % 8 + 1`` materials."""
    rng = np.random.default_rng([seed, 37])
    n = seed % MOST + 1
    sigma = rng.uniform(0.01, 0.15, n)
    small = rng.random(n) < 0.5
    mu = np.where(small, sigma * rng.uniform(0, 2, n), rng.uniform(0.02, 0.9, n))
    truth = mu + sigma * truncated_normal(-mu / sigma, (1 - mu) / sigma, rng.random(n))
    room = rt.Room(
        name=f"room {seed}",
        volume=float(rng.uniform(100, 3000)),
        materials=[f"m{i}" for i in range(n)],
        areas=np.exp(rng.uniform(np.log(2), np.log(200), n)),
        alpha=mu[:, np.newaxis],
        sigma=sigma[:, np.newaxis],
        centre_frequencies=[1000],
        air=rt.Air(20, 50),
    )
    relative = float(np.exp(rng.uniform(*np.log([RANGES[0][0], RANGES[-1][1]]))))
    exact = rt.Eyring().time(room, np.atleast_1d(room.areas @ truth))
    u = relative * exact
    heard = exact + u * rng.standard_normal(1)
    measured = rt.Measurement(
        centre_frequencies=[1000],
        values={"t20": heard[np.newaxis]},
        uncertainty={"t20": u[np.newaxis]},
    )
    return Drawn(room, truth, measured, relative)


def rows(n_rooms: int) -> Iterator[tuple[str, int, float, bool, float]]:
    """Yield method, number of materials, u_T / T, whether at a bound, and the share covered."""
    warnings.simplefilter("ignore")
    for seed in range(n_rooms):
        drawn = draw(seed)
        for method in METHODS:
            result = rt.calibrate(drawn.room, drawn.measured, method, unreachable="nearest")
            low, high = (end[:, 0] for end in result.interval or ())
            held = (low <= drawn.truth) & (drawn.truth <= high)
            yield method, len(held), drawn.relative, bool(result.active.any()), float(held.mean())


def table(n_rooms: int) -> str:
    """Return the shares of coefficients in their intervals, over all rooms and parts of them."""
    found = list(rows(n_rooms))
    parts: dict[str, Callable[[tuple[Any, ...]], bool]] = {"all": lambda row: True}
    for n in range(1, MOST + 1):
        parts[f"{n} material{'s' * (n > 1)}"] = lambda row, n=n: row[1] == n
    for a, b in RANGES:
        parts[f"u_T {100 * a:g} to {100 * b:g} %"] = lambda row, a=a, b=b: a <= row[2] < b
    parts["no coefficient at a bound"] = lambda row: not row[3]
    parts["one at a bound"] = lambda row: row[3]
    lines = [f"{'':28s}" + "".join(f"{m:>18s}" for m in METHODS)]
    for name, holds in parts.items():
        cells = []
        for method in METHODS:
            of_part = [row for row in found if row[0] == method and holds(row)]
            # Every coefficient counts alike; those of a room share their T.
            weight = np.array([row[1] for row in of_part], dtype=float)
            share = np.array([row[4] for row in of_part])
            mean = weight @ share / weight.sum()
            error = np.sqrt(np.sum((weight * (share - mean)) ** 2)) / weight.sum()
            cells.append(f"{mean:10.3f} ± {error:.3f}")
        lines.append(f"{name:28s}" + "".join(f"{cell:>18s}" for cell in cells))
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=2000)
    print(table(parser.parse_args().rooms))
