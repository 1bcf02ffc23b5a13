"""Write a population of the second world: ``python -m benchmarks.studies.second_world.generate 1``.

Two files per population: what a finder may read and, apart from it, the truth.
"""

from __future__ import annotations

import gzip
import json
import multiprocessing
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.studies.second_world.rooms import COUNTS, KINDS, build

HERE = Path(__file__).parent


def _build(seed: tuple[int, int, int]) -> dict[str, Any]:
    return build(*seed)


def path(folder: Path, population: int, part: str) -> Path:
    return folder / f"population_{population}_{part}.jsonl.gz"


def write(folder: Path, population: int, made: Sequence[dict[str, Any]]) -> None:
    """Write the rooms of a population; the third world's, too."""
    for part in ("case", "truth"):
        text = "\n".join(json.dumps(room[part], separators=(",", ":")) for room in made)
        path(folder, population, part).write_bytes(gzip.compress(text.encode(), mtime=0))


def read(population: int, part: str, folder: Path = HERE) -> list[dict[str, Any]]:
    """Read ``part`` ("case" or "truth") of a population."""
    lines = gzip.decompress(path(folder, population, part).read_bytes()).splitlines()
    return [json.loads(line) for line in lines]


def main(population: int) -> None:
    counts = COUNTS[population]
    seeds = [(population, k, i) for k, kind in enumerate(KINDS) for i in range(counts[kind])]
    with multiprocessing.Pool(2) as pool:
        write(HERE, population, pool.map(_build, seeds, chunksize=4))


if __name__ == "__main__":
    main(int(sys.argv[1]))
