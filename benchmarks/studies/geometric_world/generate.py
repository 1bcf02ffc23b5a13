"""Write a population of geometric rooms.

    python -m benchmarks.studies.geometric_world.generate 1 [number]

Two files per population: what a finder may read and, apart from it, the truth. It takes a few seconds
of processor time per room, and goes on where it was stopped.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.studies.geometric_world.rooms import build, draw, order
from benchmarks.studies.position_rooms.generate import plain, stored

HERE = Path(__file__).parent
PARTS = {"rooms": ("stated", "measured"), "truth": ("truth",)}


def path(population: int, part: str) -> Path:
    return HERE / f"population_{population}_{part}.jsonl.gz"


def read(population: int, part: str) -> dict[int, dict[str, Any]]:
    """Read ``part`` ("rooms" or "truth") of a population, by the rooms' numbers."""
    if not path(population, part).exists():
        return {}
    lines = gzip.decompress(path(population, part).read_bytes()).splitlines()
    rows = [json.loads(line) for line in lines]
    return {row.pop("index"): row for row in rows}


def digest(population: int, number: int) -> str:
    """Return the SHA-256 of what is drawn of the first rooms, before anything is traced."""
    whole = hashlib.sha256()
    for index in range(number):
        stated, scene, sources, made = draw(population, index)
        drawn = {
            "stated": stated,
            "polygons": scene.polygons,
            "alpha": scene.alpha,
            "scattering": scene.scattering,
            "sources": sources,
            "receivers": scene.receivers,
            "truth": made.truth,
        }
        whole.update(json.dumps(plain(drawn), sort_keys=True).encode())
    return whole.hexdigest()


def main(population: int, number: int) -> None:
    """Build the first ``number`` rooms that are not there yet; written after each."""
    lines = {part: read(population, part) for part in PARTS}
    for index in range(min(number, len(order(population)))):
        if index in lines["truth"]:
            continue
        made = stored(build(population, index))
        for part, keys in PARTS.items():
            lines[part][index] = {k: made[k] for k in keys}
            rows = [{"index": n, **row} for n, row in sorted(lines[part].items())]
            text = "\n".join(json.dumps(row, separators=(",", ":")) for row in rows)
            path(population, part).write_bytes(gzip.compress(text.encode(), mtime=0))
        print(index, made["stated"]["shape"], made["truth"]["kind"], flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 250)
