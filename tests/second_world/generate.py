"""Write a population of the second world: ``python -m tests.second_world.generate 1``.

Two files per population: what a finder may read and, apart from it, the truth.
"""

from __future__ import annotations

import gzip
import json
import multiprocessing
import sys
from pathlib import Path
from typing import Any

from tests.second_world.rooms import COUNTS, KINDS, build

HERE = Path(__file__).parent


def _build(seed: tuple[int, int, int]) -> dict[str, Any]:
    return build(*seed)


def path(population: int, part: str) -> Path:
    return HERE / f"population_{population}_{part}.jsonl.gz"


def main(population: int) -> None:
    counts = COUNTS[population]
    seeds = [(population, k, i) for k, kind in enumerate(KINDS) for i in range(counts[kind])]
    with multiprocessing.Pool(2) as pool:
        made = pool.map(_build, seeds, chunksize=4)
    for part in ("case", "truth"):
        text = "\n".join(json.dumps(room[part], separators=(",", ":")) for room in made)
        path(population, part).write_bytes(gzip.compress(text.encode(), mtime=0))


def read(population: int, part: str) -> list[dict[str, Any]]:
    """Read ``part`` ("case" or "truth") of a population."""
    lines = gzip.decompress(path(population, part).read_bytes()).splitlines()
    return [json.loads(line) for line in lines]


if __name__ == "__main__":
    main(int(sys.argv[1]))
