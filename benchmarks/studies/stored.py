"""What is stored beside this module: the drawn rooms of every world, and the rows of judged runs.

A population has two files: what a method may read ("case" or "rooms") and, apart from it, the truth.
The rooms were drawn and frozen by code that commits have: `hidden_world` 995d6858, the second, the
third and the geometric world 2621e9c7, `position_rooms` cf77b20c. A row is what came of one room.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
Row = dict[str, Any]


def rows(file: Path) -> list[Row]:
    """Return the rows of a file of JSON lines, which may be compressed; none if there is no file."""
    if not file.exists():
        return []
    content = file.read_bytes()
    text = gzip.decompress(content) if file.suffix == ".gz" else content
    return [json.loads(line) for line in text.splitlines()]


def numbered(file: Path, key: str = "index") -> dict[int, Row]:
    """Return the rows of a file by their numbers; none if there is no file."""
    return {row.pop(key): row for row in rows(file)}


def plain(value: Any, digits: int | None = None) -> Any:
    """Return a value as JSON keeps it, with every bit of a number or so many digits; NaN is None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v, digits) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), digits)
    if isinstance(value, list | tuple):
        return [plain(v, digits) for v in value]
    if isinstance(value, float | np.floating):
        exact = float(value) if digits is None else float(f"{value:.{digits}g}")
        return exact if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def write(file: Path, table: Iterable[Mapping[str, Any]]) -> None:
    """Write rows, compressed; the same rows are the same bytes."""
    text = "\n".join(json.dumps(row, separators=(",", ":")) for row in table)
    file.write_bytes(gzip.compress(text.encode(), mtime=0))


def resume(file: Path, jobs: Mapping[str, Callable[[], Mapping[str, Any]]]) -> None:
    """Append the row of every job that a file lacks, each at once, so that a run may be stopped."""
    done = {row["job"] for row in rows(file)}
    file.parent.mkdir(parents=True, exist_ok=True)
    for n, (name, judge) in enumerate(jobs.items(), 1):
        if name not in done:
            row = json.dumps({"job": name, **judge()}, separators=(",", ":"))
            with file.open("a", encoding="utf-8") as stream:
                stream.write(row + "\n")
            print(f"{n}/{len(jobs)} {name}", flush=True)


def path(world: str, population: int, part: str) -> Path:
    """Return the file of one part of a population."""
    return HERE / world / f"population_{population}_{part}.jsonl.gz"


def read(world: str, population: int, part: str) -> list[Row]:
    """Return one part of a population's rooms in their order."""
    return rows(path(world, population, part))


def commands(description: str, **steps: Callable[[Path | None], None]) -> None:
    """Run the step that the command line names; each takes the folder of a run, or None."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("what", choices=steps)
    parser.add_argument("--folder", type=Path, help="of a run; the stored rows without it")
    given = parser.parse_args()
    steps[given.what](given.folder)
