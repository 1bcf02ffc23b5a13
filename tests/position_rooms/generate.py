"""Write a population of position rooms: ``python -m tests.position_rooms.generate 1``.

Two files per population: what a calibration may read and, apart from it, the truth. It takes 7 s of
processor time per room.
"""

from __future__ import annotations

import gzip
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tests.position_rooms.rooms import COUNTS, build

HERE = Path(__file__).parent
DIGITS = 5


def plain(value: Any) -> Any:
    """Return JSON's types; numbers with `DIGITS` digits, None for what is not finite."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def stored(room: dict[str, Any]) -> dict[str, Any]:
    """Return a room as it is written: its corners to a micrometre."""
    corners = room["stated"]["vertices"].tolist()
    out: dict[str, Any] = plain(room)
    out["stated"]["vertices"] = [[round(x, 6) for x in corner] for corner in corners]
    return out


def main(population: int) -> None:
    """Build the rooms that are not there yet; written after each."""
    parts = {"rooms": ("stated", "measured"), "truth": ("truth",)}
    lines: dict[str, list[str]] = {part: [] for part in parts}
    for part in parts:
        if path(population, part).exists():
            lines[part] = [json.dumps(r, separators=(",", ":")) for r in read(population, part)]
    for i in range(len(lines["truth"]), COUNTS[population]):
        made = stored(build(population, i))
        for part, keys in parts.items():
            kept = {k: made[k] for k in keys}
            lines[part] = [*lines[part][:i], json.dumps(kept, separators=(",", ":"))]
            text = "\n".join(lines[part]).encode()
            path(population, part).write_bytes(gzip.compress(text, mtime=0))
        print(i, made["stated"]["kind"], made["truth"]["n_rays"], flush=True)


def path(population: int, part: str) -> Path:
    return HERE / f"population_{population}_{part}.jsonl.gz"


def read(population: int, part: str) -> list[dict[str, Any]]:
    """Read ``part`` ("rooms" or "truth") of a population."""
    lines = gzip.decompress(path(population, part).read_bytes()).splitlines()
    return [json.loads(line) for line in lines]


if __name__ == "__main__":
    main(int(sys.argv[1]))
