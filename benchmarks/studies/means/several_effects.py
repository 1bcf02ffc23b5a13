"""Several effects at once, in rooms of the first hidden world that lack two of them, or one.

    python -m benchmarks.studies.means.several_effects run --folder out  # can be resumed; then: store
    python -m benchmarks.studies.means.several_effects table

The rooms are built from their numbers: the last 50 of 100 of population 1 with two effects, and 60
with one of every kind in turn, none of which is stored. Both kinds are searched turn by turn.
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import json
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.populations import COUNTS, DOUBLE, build
from benchmarks.studies.means.judged import DATA, name_of, rmse
from benchmarks.studies.means.judging import (
    families,
    first_of,
    kept_controls,
    one,
    rate,
)
from rtcal.finder import Case, recalibrate
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import MOST
from rtcal.finder.means.recalibration import plain
from rtcal.finder.search import find
from rtcal.support.errors import DataError

POPULATION = 1
STORED = Path(__file__).with_name("several_effects.jsonl.gz")
DOUBLES = range(50, 100)
SINGLES = 60
N_KINDS = 12


def seeds() -> Iterator[tuple[int, int]]:
    """Kind and number of every room, those with two effects and those with one in turn."""
    two = [(DOUBLE, COUNTS[POPULATION][DOUBLE] + i) for i in DOUBLES]
    kinds = [(1 + i % N_KINDS, i // N_KINDS) for i in range(SINGLES)]
    alone = [(kind, COUNTS[POPULATION][kind] + number) for kind, number in kinds]
    for pair in zip_longest(two, alone):
        yield from (seed for seed in pair if seed is not None)


def run(folder: Path) -> None:
    """Build and search every room that is not there yet."""
    warnings.simplefilter("ignore")
    folder.mkdir(parents=True, exist_ok=True)
    for kind, number in seeds():
        path = folder / f"{kind}_{number}.json"
        if path.exists():
            continue
        made = build(POPULATION, kind, number)
        case = Case.from_dict(made["case"])
        controls = kept_controls(case, path.with_suffix(".npz"))
        row = {
            "truth": made["truth"]["effects"],
            "one": searched(one(case), first_of(controls), made["truth"]),
            "all": searched(case, controls, made["truth"]),
        }
        path.write_text(json.dumps(row), encoding="utf-8")
        print(f"\r{path.stem}   ", end="", flush=True)
    print()


def searched(case: Case, controls: list[ControlRooms], truth: dict[str, Any]) -> dict[str, Any]:
    """A search for several effects as plain values, the error of alpha, and the time it took."""
    began = time.process_time()
    found = find(case, controls=controls, most=MOST)
    row = {
        "seconds": time.process_time() - began,
        "verdict": found.verdict,
        "named_families": list(found.named_families),
        "named_set": list(found.named_set),
        "members": list(found.members),
        "sets": [[list(s), p] for s, p in found.sets.items() if p > 1e-4],
    }
    if len(truth["effects"]) == 2:
        simple = rmse(plain(case).alpha, truth)
        added = simple
        with contextlib.suppress(
            DataError
        ):  # nothing found, or nothing probable enough to be added
            added = rmse(recalibrate(found.apply().case, found.discrepancy).alpha, truth)
        row["rmse"] = [rmse(case.room.alpha, truth), simple, added, rmse(found.alpha, truth)]
    return row


@dataclass(frozen=True)
class Searched:
    """A judged room: what was hidden in it and what a search for several effects found."""

    truth: list[str]
    row: dict[str, Any]

    @property
    def families(self) -> list[str]:
        """The families of what was hidden, added absorption as one, sorted."""
        return wide(self.truth)

    @property
    def both_claimed(self) -> bool:
        """Whether both families are claimed, and no other."""
        return self.row["named_set"] == self.families

    @property
    def wrong_claim(self) -> bool:
        """Whether a family is claimed that nothing hidden belongs to."""
        claimed = {f.split(",")[0] for f in self.row["named_families"]} | {*self.row["named_set"]}
        return bool(claimed - set(self.families))

    @property
    def second_claim(self) -> bool:
        """Whether more is claimed than is hidden: a wrong family, or two where one is hidden."""
        return self.wrong_claim or len(self.row["named_set"]) > len(self.truth)

    @property
    def likeliest_right(self) -> bool:
        """Whether the most probable set has the families of what was hidden."""
        return self.row["verdict"] in ("named", "family", "ambiguous") and (
            wide(self.row["members"]) == self.families
        )

    @property
    def both_among_pairs(self) -> bool:
        """Whether the most probable families of two effects are right, given that there are two."""
        table: Counter[tuple[str, ...]] = Counter()
        for names, p in self.row["sets"]:
            if len(names) == 2 and "unknown" not in names:
                table[tuple(wide(names))] += p
        return bool(table) and [*max(table, key=lambda k: table[k])] == self.families


def wide(names: list[str]) -> list[str]:
    """The families of effects, added absorption as one, sorted."""
    return sorted(families()[n].split(",")[0] for n in names)


def store(folder: Path) -> None:
    """Store the rows of a run."""
    rows = [p.read_text(encoding="utf-8") for p in sorted(folder.glob("*.json"))]
    STORED.write_bytes(gzip.compress("\n".join(rows).encode(), mtime=0))


def judged(data: str) -> list[Searched]:
    """The stored rooms, with one set of data."""
    rows = map(json.loads, gzip.decompress(STORED.read_bytes()).splitlines())
    return [Searched([name_of(e) for e in row["truth"]], row[data]) for row in rows]


def table() -> None:
    """Print what was asked and found."""
    for data, words in DATA.items():
        every = judged(data)
        two = [r for r in every if len(r.truth) == 2]
        single = [r for r in every if len(r.truth) == 1]
        print(f"\n== {words}: {len(two)} rooms with two effects, {len(single)} with one ==")
        print("two hidden: both families claimed       ", rate(r.both_claimed for r in two))
        print("  of the most probable set              ", rate(r.likeliest_right for r in two))
        print("  most probable, given that there are two", rate(r.both_among_pairs for r in two))
        print("  a family claimed that is not there    ", rate(r.wrong_claim for r in two))
        errors = np.array([r.row["rmse"] for r in two])
        for k, label in ((2, "the set added"), (3, "averaged over sets"), (0, "as stated")):
            half = rate(errors[:, k] <= errors[:, 1] / 2)
            print(f"alpha's error at most half of plain's, {label:18}", half)
        medians = np.median(errors, axis=0).round(4)
        print("  medians: stated, plain, added, averaged", medians)
        print("one hidden: more claimed than is there  ", rate(r.second_claim for r in single))
        print(
            "  a set of two or three claimed         ",
            rate(bool(r.row["named_set"]) for r in single),
        )
        claims = [f.split(",")[0] in r.families for r in every for f in r.row["named_families"]]
        print("claims of a family that were right      ", rate(claims))
        print(
            "claims of a set that were right         ",
            rate(r.both_claimed for r in every if r.row["named_set"]),
        )
        seconds = [r.row["seconds"] for r in every]
        print(f"seconds of processor: median {np.median(seconds):.2f}, at most {max(seconds):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("run", "store", "table"))
    parser.add_argument("--folder", type=Path)
    given = parser.parse_args()
    if given.what == "table":
        table()
    else:
        {"run": run, "store": store}[given.what](given.folder)


if __name__ == "__main__":
    main()
