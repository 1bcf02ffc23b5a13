"""Write a population of the third world: ``python -m tests.third_world.generate 1``.

Two files per population: what a finder may read and, apart from it, the truth. Rooms are kept one by
one in a folder beside them while they are made, so that an interrupted run goes on.
"""

from __future__ import annotations

import gzip
import json
import sys
from pathlib import Path
from typing import Any

from tests.third_world.rooms import COUNTS, KINDS, build

HERE = Path(__file__).parent


def path(population: int, part: str) -> Path:
    return HERE / f"population_{population}_{part}.jsonl.gz"


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
    for part in ("case", "truth"):
        text = "\n".join(json.dumps(room[part], separators=(",", ":")) for room in made)
        path(population, part).write_bytes(gzip.compress(text.encode(), mtime=0))


def read(population: int, part: str) -> list[dict[str, Any]]:
    """Read ``part`` ("case" or "truth") of a population."""
    lines = gzip.decompress(path(population, part).read_bytes()).splitlines()
    return [json.loads(line) for line in lines]


if __name__ == "__main__":
    main(int(sys.argv[1]))
