"""Write a population of the third world: ``python -m benchmarks.studies.third_world.generate 1``.

Rooms are kept one by one in a folder beside the population's files while they are made, so that an
interrupted run goes on.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

from benchmarks.studies.second_world import generate as second
from benchmarks.studies.third_world.rooms import COUNTS, KINDS, build

HERE = Path(__file__).parent
read = partial(second.read, folder=HERE)


def main(population: int) -> None:
    counts = COUNTS[population]
    kept = HERE / f"made_{population}"
    kept.mkdir(exist_ok=True)
    made = []
    for k, kind in enumerate(KINDS):
        for i in range(counts[kind]):
            file = kept / f"{k}_{i}.json"
            if not file.exists():
                file.write_text(json.dumps(build(population, k, i), separators=(",", ":")))
            made.append(json.loads(file.read_text()))
            print(f"\r{len(made)}/{sum(counts.values())}", end="", flush=True)
    print()
    second.write(HERE, population, made)


if __name__ == "__main__":
    main(int(sys.argv[1]))
