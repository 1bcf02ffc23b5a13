"""Feasible rooms at the edge of double precision: `python benchmarks/extreme_rooms.py [ROOMS]`.

Up to 200 materials, areas from 0.1 to 1,000 m², standard deviations of 1e-8 among ordinary ones, T
anywhere within reach, some bands without T. Counted are the rooms without an accepted answer, and the
raw and the final answers outside their own `alpha_error_bound`.
The truth is `rtcal.exact`, which shares no code with the calibration. 10,000 rooms take ten minutes.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass, field

import numpy as np

import rtcal as rt
from rtcal.calibration import exact
from rtcal.support.errors import SolverError
from rtcal.support.types import Array

FREQUENCIES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
EXACT_ROUNDING = 1e-12
"""Error of `rtcal.exact` in alpha: it is not the truth to more digits."""


def extreme_room(seed: int) -> tuple[rt.Room, Array]:
    """Return a room and a T in s, (n_bands,), that some coefficients within its bounds give."""
    rng = np.random.default_rng(seed)
    n = int(rng.choice([1, 2, 5, 20, 60, 200], p=[0.1, 0.2, 0.3, 0.2, 0.1, 0.1]))
    shape = (n, int(rng.integers(1, 7)))
    alpha = rng.uniform(0, 1, shape)
    sigma = 10 ** rng.uniform(-3, 0, shape)
    certain = rng.random(shape) < rng.choice([0, 0.1, 0.5, 0.9])
    sigma[certain] = 10 ** rng.uniform(-8, -5, certain.sum())
    areas = 10 ** rng.uniform(-1, 3, n)
    floor = np.zeros(shape) if rng.random() < 0.5 else alpha * rng.uniform(0, 1, shape)
    room = rt.Room(
        name="extreme",
        volume=float(areas.sum() ** 1.5 / 10),
        materials=[f"m{i}" for i in range(n)],
        areas=areas,
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=FREQUENCIES[: shape[1]],
        air=rt.Air(),
        alpha_min=floor,
    )
    near_prior = alpha + sigma * rng.standard_normal(shape) * 10 ** rng.uniform(-1, 2)
    near_floor = floor + (1 - floor) * 10 ** rng.uniform(-9, 0, (1, shape[1]))
    anywhere = rng.uniform(floor, 1)
    true = [near_prior, near_floor, anywhere][rng.integers(3)]
    true = np.clip(true, floor, np.maximum(floor, 0.999))  # at a mean of 1 T is 0
    t = rt.Eyring().time(room, areas @ true)
    missing = rng.random(shape[1]) < 0.15
    missing[0] = False
    return room, np.where(missing, np.nan, t)


@dataclass
class Counts:
    """The number of rooms by what became of them."""

    rooms: int = 0
    failed: list[int] = field(default_factory=list)
    raw_outside: list[int] = field(default_factory=list)
    outside: list[int] = field(default_factory=list)
    widest: float = 0.0
    moved_without_time: float = 0.0
    looseness: list[float] = field(default_factory=list)

    def add(self, seed: int) -> None:
        """Calibrate a room and compare it with its exact answer."""
        room, t = extreme_room(seed)
        self.rooms += 1
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                result = rt.calibrate(room, t, unreachable="nearest")
        except SolverError:
            self.failed.append(seed)
            return
        missing = np.isnan(t)
        target = np.where(missing, 0.0, result.target)
        truth = exact.solve(
            room.alpha.T, room.sigma.T, room.areas, target, room.alpha_min.T, 1.0
        ).alpha.T
        truth[:, missing] = room.alpha[:, missing]
        raw_error = np.abs(result.joint.raw_alpha - truth)
        raw_bound = result.joint.raw_certificate.alpha_error_bound
        error = np.abs(result.alpha - truth)
        bound = result.certificate.alpha_error_bound
        if (raw_error > raw_bound + EXACT_ROUNDING).any():
            self.raw_outside.append(seed)
        if (error > bound + EXACT_ROUNDING).any():
            self.outside.append(seed)
        self.widest = max(self.widest, float(bound.max()))
        self.moved_without_time = max(
            self.moved_without_time, float(np.max(error[:, missing], initial=0.0))
        )
        measurable = raw_error > 1e3 * EXACT_ROUNDING
        self.looseness += (raw_bound[measurable] / raw_error[measurable]).tolist()

    def __str__(self) -> str:
        loose = np.median(self.looseness) if self.looseness else np.nan
        return "\n".join(
            [
                f"{self.rooms} rooms: {len(self.failed)} SolverErrors {self.failed[:9]}",
                f"outside alpha_error_bound: {len(self.raw_outside)} raw answers "
                f"{self.raw_outside[:9]}, {len(self.outside)} final answers {self.outside[:9]}",
                f"widest bound of a final answer {self.widest:.1e}; of raw answers the bound is "
                f"{loose:.3f} times the error in the median",
                f"largest move of a band without T {self.moved_without_time:.1e}",
            ]
        )


def main() -> None:
    """Run the rooms and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", type=int, nargs="?", default=10_000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first room")
    chosen = parser.parse_args()
    counts = Counts()
    for seed in range(chosen.first, chosen.first + chosen.rooms):
        counts.add(seed)
    print(counts)


if __name__ == "__main__":
    main()
