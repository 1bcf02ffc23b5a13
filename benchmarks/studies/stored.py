"""The drawn rooms of every world, as they are stored beside this module.

A population has two files: what a method may read ("case" or "rooms") and, apart from it, the truth.
The rooms of `hidden_world` are drawn by the code that stands there. Those of the second, the third and
the geometric world were drawn and frozen by code that commit 2621e9c7 has, those of `position_rooms` by
that of commit cf77b20c.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def path(world: str, population: int, part: str) -> Path:
    return HERE / world / f"population_{population}_{part}.jsonl.gz"


def read(world: str, population: int, part: str) -> list[dict[str, Any]]:
    """Return one part of a population's rooms in their order."""
    text = gzip.decompress(path(world, population, part).read_bytes())
    return [json.loads(line) for line in text.splitlines()]


def numbered(world: str, population: int, part: str) -> dict[int, dict[str, Any]]:
    """Return one part of a population's rooms by their numbers; none if there is no file."""
    if not path(world, population, part).exists():
        return {}
    return {row.pop("index"): row for row in read(world, population, part)}


def write(world: str, population: int, part: str, rows: Iterable[dict[str, Any]]) -> None:
    text = "\n".join(json.dumps(row, separators=(",", ":")) for row in rows)
    path(world, population, part).write_bytes(gzip.compress(text.encode(), mtime=0))
