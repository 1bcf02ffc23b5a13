"""Write the frozen populations: ``python -m benchmarks.studies.hidden_world.generate 1``.

Two files a population: what a finder may read and, apart from it, the truth.
"""

from __future__ import annotations

import gzip
import json
import multiprocessing
import sys
from pathlib import Path
from typing import Any

from benchmarks.studies.hidden_world.populations import COUNTS, build

HERE = Path(__file__).parent


def numbers(population: int) -> list[tuple[int, int, int]]:
    counts = COUNTS[population]
    return [(population, kind, i) for kind, n in counts.items() for i in range(n)]


def _build(seed: tuple[int, int, int]) -> dict[str, Any]:
    return build(*seed)


def main(population: int) -> None:
    with multiprocessing.Pool(2) as pool:
        rooms = pool.map(_build, numbers(population), chunksize=4)
    for part in ("case", "truth"):
        text = "\n".join(json.dumps(r[part], separators=(",", ":")) for r in rooms)
        path = HERE / f"population_{population}_{part}.jsonl.gz"
        path.write_bytes(gzip.compress(text.encode(), mtime=0))


def read(population: int, part: str) -> list[dict[str, Any]]:
    """Read ``part`` ("case" or "truth") of a population."""
    path = HERE / f"population_{population}_{part}.jsonl.gz"
    return [json.loads(line) for line in gzip.decompress(path.read_bytes()).splitlines()]


if __name__ == "__main__":
    main(int(sys.argv[1]))
