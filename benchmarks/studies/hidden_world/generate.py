"""Write the frozen populations: ``python -m benchmarks.studies.hidden_world.generate 1``.

Two files a population: what a finder may read and, apart from it, the truth.
"""

from __future__ import annotations

import multiprocessing
import sys
from typing import Any

from benchmarks.studies import stored
from benchmarks.studies.hidden_world.populations import COUNTS, build


def numbers(population: int) -> list[tuple[int, int, int]]:
    counts = COUNTS[population]
    return [(population, kind, i) for kind, n in counts.items() for i in range(n)]


def _build(seed: tuple[int, int, int]) -> dict[str, Any]:
    return build(*seed)


def main(population: int) -> None:
    with multiprocessing.Pool(2) as pool:
        rooms = pool.map(_build, numbers(population), chunksize=4)
    for part in ("case", "truth"):
        stored.write("hidden_world", population, part, (room[part] for room in rooms))


if __name__ == "__main__":
    main(int(sys.argv[1]))
