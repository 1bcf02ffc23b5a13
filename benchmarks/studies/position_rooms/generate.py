"""Write a population of position rooms.

    python -m benchmarks.studies.position_rooms.generate 1 [number]

Two files per population: what a calibration may read and, apart from it, the truth. It takes 7 s of
processor time per room.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from benchmarks.studies import stored as files
from benchmarks.studies.position_rooms.rooms import COUNTS, build

WORLD = "position_rooms"
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


def order(population: int) -> list[int]:
    """Return the rooms' numbers so that the first ones are spread over the volumes."""
    pairs = range(COUNTS[population] // 2)
    spread = [p for first in (0, 3, 1, 4, 2) for p in pairs[first::5]]
    return [2 * p + odd for p in spread for odd in (0, 1)]


def main(population: int, number: int) -> None:
    """Build the first ``number`` rooms in `order` that are not there yet; written after each."""
    parts = {"rooms": ("stated", "measured"), "truth": ("truth",)}
    lines = {part: files.numbered(WORLD, population, part) for part in parts}
    for i in order(population)[:number]:
        if i in lines["truth"]:
            continue
        made = stored(build(population, i))
        for part, keys in parts.items():
            lines[part][i] = {k: made[k] for k in keys}
            rows = ({"index": n, **row} for n, row in sorted(lines[part].items()))
            files.write(WORLD, population, part, rows)
        print(i, made["stated"]["kind"], made["truth"]["n_rays"], flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else max(COUNTS.values()))
