"""What the finder does on the second hidden world (tests/second_world), and on the first beside it.

    python -m benchmarks.second_world controls --folder out --population 1   # hours; can be resumed
    python -m benchmarks.second_world run --folder out --population 1        # with what stands there
    python -m benchmarks.second_world table --folder out --population 1
    python -m benchmarks.second_world run --folder out --world 1 --population 1

A case is judged as it is stated ("all": T20, EDT, T30, C80 and G, every second room in two
configurations) and cut down to T20, EDT and T30 in one configuration ("one"). Rows of the first world
that `hidden_effects run` made have the same keys, and `table` reads them as well.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects import NAMES
from benchmarks.judging import (
    NOTHING,
    Judged,
    first_of,
    kept_controls,
    one,
    print_confusion,
    print_rates,
    row_of,
)
from rtcal.discrepancy import Case, find
from tests.hidden_world import generate as first_world
from tests.hidden_world.populations import TOGGLED
from tests.second_world import generate as second_world
from tests.second_world.rooms import KINDS

WORLDS = {1: first_world, 2: second_world}
DATA = {"one": "T20, EDT, T30; one configuration", "all": "the case as it is stated"}


def truth_of(world: int, truth: dict[str, Any]) -> tuple[frozenset[str], str] | None:
    """The right names and how the uncertainty is stated; None for what is not judged here.

    Left out of the first world: rooms with two effects, and those made to look like others.
    """
    if world == 2:
        name = {"nothing": NOTHING}.get(truth["kind"], truth["kind"])
        return frozenset({name}), truth["statement"]
    kind = truth["seed"][1]
    kind = TOGGLED.get(kind, kind)
    if kind == 0:
        return frozenset({NOTHING}), ""
    return (frozenset({NAMES[kind]}), "") if kind in NAMES else None


def order(n: int, step: int) -> list[int]:
    """Room numbers in an order in which the kinds are mixed, every so many of them."""
    return [int(i) for i in np.random.default_rng(0).permutation(n)[::step]]


def place(folder: str, world: int, population: int, part: str, index: int, kind: str) -> Path:
    return Path(folder) / f"world{world}_pop{population}" / part / f"{index}.{kind}"


def controls(folder: str, world: int, population: int, step: int) -> None:
    """Simulate the control rooms; they do not depend on the finder."""
    rooms = WORLDS[world].read(population, "case")
    for n, index in enumerate(order(len(rooms), step), 1):
        path = place(folder, world, population, "controls", index, "npz")
        kept_controls(Case.from_dict(rooms[index]), path)
        print(f"\r{n}/{len(rooms)}", end="", flush=True)
    print()


def run(folder: str, world: int, population: int, step: int, label: str) -> None:
    """Run the finder on the rooms whose control rooms stand."""
    warnings.simplefilter("ignore")
    rooms, truths = (WORLDS[world].read(population, part) for part in ("case", "truth"))
    for n, index in enumerate(order(len(rooms), step), 1):
        kept = place(folder, world, population, "controls", index, "npz")
        path = place(folder, world, population, label, index, "json")
        if path.exists() or not kept.exists() or truth_of(world, truths[index]) is None:
            continue
        case, made = Case.from_dict(rooms[index]), kept_controls(Case.from_dict(rooms[index]), kept)
        row = {
            "one": row_of(find(one(case), controls=first_of(made))),
            "all": row_of(find(case, controls=made)),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(row), encoding="utf-8")
        print(f"\r{n}/{len(rooms)}", end="", flush=True)
    print()


def judged(folder: str, world: int, population: int, label: str, data: str) -> Iterator[Judged]:
    """The rooms that were run."""
    for index, truth in enumerate(WORLDS[world].read(population, "truth")):
        path = place(folder, world, population, label, index, "json")
        known = truth_of(world, truth)
        if path.exists() and known is not None:
            row = json.loads(path.read_text(encoding="utf-8"))
            if data in row:
                yield Judged(known[0], row[data], known[1])


def table(folder: str, world: int, population: int, label: str) -> None:
    names = list(NAMES.values()) if world == 1 else [k for k in KINDS if k != "nothing"]
    for data, words in DATA.items():
        rooms = list(judged(folder, world, population, label, data))
        print(f"\n== world {world}, population {population}: {words}; {len(rooms)} rooms ==")
        print_rates(rooms)
        print_confusion(rooms, [NOTHING, *names])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("controls", "run", "table"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--world", type=int, choices=tuple(WORLDS), default=2)
    parser.add_argument("--population", type=int, default=0)
    parser.add_argument("--step", type=int, default=1, help="every so many rooms")
    parser.add_argument("--label", default="rows", help="folder of this run's rows")
    given = parser.parse_args()
    if given.what == "controls":
        controls(given.folder, given.world, given.population, given.step)
    elif given.what == "run":
        run(given.folder, given.world, given.population, given.step, given.label)
    else:
        table(given.folder, given.world, given.population, given.label)


if __name__ == "__main__":
    main()
