"""The share of tracing noise in the pattern over the pairs that a hidden absorber makes.

    python -m benchmarks.studies.pairs.where_patterns --population 1 --rooms 49 61 153

A room of studies/geometric_world is traced with what is hidden in it and without, by its own tracer and
twice with other random numbers. Each time both share their paths. Prints by parameter the mean change
over the pairs, the standard deviation of the pairs' differences from it, and the correlation of these
differences between the two repetitions: 1 where they are the room's, 0 where they are noise. The rooms
have patches, and people as a flat layer.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.studies.geometric_world.load import truth
from benchmarks.studies.geometric_world.rooms import WIDTH, Room, decay_time, draw
from benchmarks.studies.position_rooms import parameters
from benchmarks.studies.position_rooms.tracer import Scene, trace

LOGARITHMIC = ("t20", "edt", "ts")


def without_it(scene: Scene, made: Room, surface: int) -> Scene:
    """Return the scene with the hidden patch as absorbing as its surface."""
    alpha = scene.alpha.copy()
    hidden = np.array(made.solid.owner) == len(made.rows) - 1
    alpha[hidden] = made.rows[made.owner[surface]]
    return replace(scene, alpha=alpha)


def change(population: int, index: int, seed: int) -> dict[str, np.ndarray]:
    """Return the change of every parameter by what is hidden, (n_pairs, n_bands)."""
    _, scene, sources, made = draw(population, index)
    true = truth(population, index)
    length = float(np.clip(1.3 * decay_time(scene, made).max(), 0.5, 10.0))

    def heard(of: Scene) -> dict[str, np.ndarray]:
        rays = true["n_rays"]
        energy = [
            trace(of, x, rays, 1000 * seed + k, width=WIDTH, length=length)
            for k, x in enumerate(sources)
        ]
        return parameters.evaluate(np.concatenate(energy), WIDTH)

    now, before = heard(scene), heard(without_it(scene, made, true["surface"]))
    out = {}
    for name in now:
        after, first = np.asarray(now[name]), np.asarray(before[name])
        out[name] = np.log(after / first) if name in LOGARITHMIC else after - first
    return out


def own(values: np.ndarray) -> np.ndarray:
    """Return the pairs' differences from their mean."""
    return np.asarray(values - values.mean(axis=0))


def said(population: int, rooms: Sequence[int]) -> None:
    """Print the figures of each room and, last, the mean correlation of all."""
    every: dict[str, list[float]] = {}
    for index in rooms:
        first, second = (change(population, index, seed) for seed in (1, 2))
        print(f"room {index}: {truth(population, index)['kind']}")
        for name, values in first.items():
            a, b = own(values), own(second[name])
            alike = float((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()))
            every.setdefault(name, []).append(alike)
            print(
                f"  {name:4} mean {values.mean():+.3f}, pairs differ by {a.std():.3f}, "
                f"correlation {alike:+.2f}"
            )
    for name, some in every.items():
        print(f"{name:4} mean correlation {np.mean(some):+.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--population", type=int, default=1)
    parser.add_argument("--rooms", type=int, nargs="+", default=[49, 61, 153])
    given = parser.parse_args()
    said(given.population, given.rooms)


if __name__ == "__main__":
    main()
