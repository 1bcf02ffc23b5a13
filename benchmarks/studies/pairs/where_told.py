"""The score of `finder.positions.find` where a part of the truth is told to it exactly.

    python -m benchmarks.studies.pairs.where_told --rooms 2.21 --folder out

For a room of studies/geometric_world, in situ and with level: the score as it is, the score of what is
heard without the measurement's noise, and the score where the shift by the true coefficients, by the
true scattering or by the true positions is taken off. Each is traced with `PATHS` thinned paths per
source. So it says which part of the truth makes a score. `at nothing` is the log density with nothing
other than stated.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.studies.geometric_world.load import IN_SITU, load, truth, without_noise
from benchmarks.studies.pairs.where import case_of, prepared
from rtcal.acoustics.observables import observable
from rtcal.finder.positions.posterior import evaluate, flat, scores, weights
from rtcal.finder.positions.weighing import BASE, responses_of
from rtcal.simulators.base import Observations

SEED = 77
"""Of the tracings that are told."""


def told(population: int, index: int, folder: Path) -> Iterator[tuple[str, float, float]]:
    """Yield what is told, the score in nats, and the log density at nothing."""
    room, true = load(population, index, IN_SITU), truth(population, index)
    case = case_of(room, "level")
    numbers, every = prepared(case, folder)
    likelihoods = numbers.likelihoods()
    wanted = numbers.data.observations
    names, n_bands = wanted.parameters, room.room.n_bands
    tracer, alpha = case.simulator.denser(BASE), np.clip(true["alpha"], 0.001, 0.99)
    columns = [tracer.pairs.index(pair) for pair in wanted.pairs]
    made = responses_of(case, 0, folder)
    base = made.base[[made.parameters.index(name) for name in names]][:, columns]

    def off(values: np.ndarray, stated: np.ndarray) -> np.ndarray:
        rows = zip(names, values, stated, strict=True)
        return flat(np.array([observable(name).linear(v, at) for name, v, at in rows]))

    def heard(what: np.ndarray, **changes: object) -> np.ndarray:
        changed = replace(tracer, **changes)  # type: ignore[arg-type]
        return np.asarray(changed.observe(what, names, seed=SEED).values[:, columns])

    def said(residual: np.ndarray) -> tuple[float, float]:
        evidence = evaluate(likelihoods, every, residual[:, np.newaxis])
        return float(scores(weights(evidence, every), every)[0][0]), float(evidence[0, 0])

    yield "as it is", *said(numbers.residual)
    quiet = Observations.of_measurement(without_noise(population, index), names, wanted.pairs)
    yield "no noise of the measurement", *said(off(quiet.values, base))
    stated = heard(room.room.alpha)
    places = {
        kind: dict(zip(getattr(tracer, kind), np.array(true[kind]), strict=True))
        for kind in ("sources", "receivers")
    }
    scattering = np.tile(np.array(true["scattering"])[:, np.newaxis], (1, n_bands))
    for what, shifted in (
        ("coefficients", heard(alpha)),
        ("scattering", heard(room.room.alpha, scattering=scattering)),
        ("positions", heard(room.room.alpha, **places)),
    ):
        yield f"{what} told", *said(numbers.residual - off(shifted, stated))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rooms", default="2.21", help="of development: population.number, ...")
    parser.add_argument("--folder", type=Path, required=True)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.folder.mkdir(parents=True, exist_ok=True)
    for room in given.rooms.split(","):
        population, index = map(int, room.split("."))
        for what, score, density in told(population, index, given.folder):
            print(f"{room}, {what}: {score:+.1f}, at nothing {density:.1f}", flush=True)


if __name__ == "__main__":
    main()
