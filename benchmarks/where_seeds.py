"""How far random numbers move the score of `rtcal.where.find`.

    python -m benchmarks.where_seeds --rooms 2.21 --seeds 0,1 --paths 8000 --folder out

Prints the score, with level and in situ, for each seed of the control runs and each of the paths.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.where import case_of
from rtcal.loop.control_runs import control_runs
from rtcal.where import track_record
from rtcal.where.find import find_by_positions
from rtcal.where.responses import parameters
from tests.geometric_world.load import IN_SITU, load


def scores(population: int, index: int, seeds: list[int], paths: int, folder: Path) -> np.ndarray:
    """Return the score by the seed of the control runs and that of the paths, in nats."""
    case = case_of(load(population, index, IN_SITU), "level")
    case = replace(case, simulator=replace(case.simulator, n_paths=paths))
    every = [
        control_runs(case.simulator, case.room, parameters(case), seed=seed, cache=folder)
        for seed in seeds
    ]
    found = [[find_by_positions(case, c, folder, seed, ()).score for seed in seeds] for c in every]
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rooms", default="2.21", help="of development: population.number, ...")
    parser.add_argument("--seeds", default="0,1")
    parser.add_argument("--paths", type=int, default=track_record.PATHS)
    parser.add_argument("--folder", type=Path, required=True)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.folder.mkdir(parents=True, exist_ok=True)
    for room in given.rooms.split(","):
        population, index = map(int, room.split("."))
        seeds = [int(seed) for seed in given.seeds.split(",")]
        print(room, scores(population, index, seeds, given.paths, given.folder).round(2).tolist())


if __name__ == "__main__":
    main()
