"""The distance by which random numbers move the score of `rtcal.find`.

    python -m benchmarks.studies.pairs.where_seeds --rooms 2.21 --seeds 0,1 --paths 8000 --folder out

Prints the score, with level and in situ, for each seed of the control runs and each of the paths, at
once, and the seconds of processor. What is traced is kept in the folder, so that an interrupted run
goes on. The first of a seed's control runs and the first of a seed's paths are a whole search.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.studies.geometric_world.load import IN_SITU, load
from benchmarks.studies.pairs.where import PATHS, case_of
from rtcal.finder.effects import library
from rtcal.finder.positions.search import controls_of, find_by_positions


def scores(
    population: int, index: int, seeds: list[int], paths: int, folder: Path
) -> Iterator[tuple[int, int, float, float]]:
    """Yield the seeds of control runs and paths, the score in nats, and the seconds of processor."""
    case = case_of(load(population, index, IN_SITU), "level")
    case = replace(case, simulator=replace(case.simulator, n_paths=paths))
    begin = time.process_time()
    for of_runs in seeds:
        controls = controls_of(case, of_runs, folder)
        for of_paths in seeds:
            found = find_by_positions(case, library(), controls, folder, of_paths, ())
            yield of_runs, of_paths, found.score, time.process_time() - begin
            begin = time.process_time()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rooms", default="2.21", help="of development: population.number, ...")
    parser.add_argument("--seeds", default="0,1")
    parser.add_argument("--paths", type=int, default=PATHS)
    parser.add_argument("--folder", type=Path, required=True)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.folder.mkdir(parents=True, exist_ok=True)
    seeds = [int(seed) for seed in given.seeds.split(",")]
    for room in given.rooms.split(","):
        population, index = map(int, room.split("."))
        every = []
        for runs, of_paths, score, seconds in scores(
            population, index, seeds, given.paths, given.folder
        ):
            said = f"{room}, control runs {runs}, paths {of_paths}: {score:+.2f}"
            print(f"{said} in {seconds:.1f} s", flush=True)
            every.append(score)
        if len(every) > 1:
            print(f"{room}: standard deviation {np.std(every, ddof=1):.2f}", flush=True)


if __name__ == "__main__":
    main()
