"""Several effects at once, in rooms of the first hidden world that lack two of them, or one.

    python -m benchmarks.studies.means.several_effects run --folder out  # can be resumed; then: store
    python -m benchmarks.studies.means.several_effects table

The rooms are those of population 5: 50 with two effects and 60 with one of every kind, in turn.
"""

from __future__ import annotations

import contextlib
import time
import warnings
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.studies import stored
from benchmarks.studies.means.judged import DATA, name_of, read, rmse
from benchmarks.studies.means.judging import families, first_of, kept_controls, one
from benchmarks.studies.rates import rate
from benchmarks.studies.stored import Row
from rtcal.finder import Case, recalibrate
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import MOST
from rtcal.finder.means.recalibration import plain
from rtcal.finder.search import find
from rtcal.support.errors import DataError

POPULATION = 5
STORED = Path(__file__).with_name("several_effects.jsonl.gz")


def judge(index: int, folder: Path) -> Row:
    """Search a room with both sets of data."""
    case = Case.from_dict(read(1, POPULATION, "case")[index])
    truth = read(1, POPULATION, "truth")[index]
    controls = kept_controls(case, folder / "controls" / f"{index}.npz")
    return {
        "truth": truth["effects"],
        "one": searched(one(case), first_of(controls), truth),
        "all": searched(case, controls, truth),
    }


def run(folder: Path) -> None:
    """Search every room that is not there yet."""
    warnings.simplefilter("ignore")
    rooms = range(len(read(1, POPULATION, "case")))
    stored.resume(folder / "rows.jsonl", {f"{i}": partial(judge, i, folder) for i in rooms})


def searched(case: Case, controls: list[ControlRooms], truth: Row) -> Row:
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
        added = plain(case).alpha
        tables = [case.room.alpha, added]
        with contextlib.suppress(DataError):  # nothing found, or not probable enough to be added
            added = recalibrate(found.apply().case, found.discrepancy).alpha
        row["rmse"] = [rmse(alpha, truth) for alpha in (*tables, added, found.alpha)]
    return row


@dataclass(frozen=True)
class Searched:
    """A judged room: what was hidden in it and what a search for several effects found."""

    truth: list[str]
    row: Row

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
    stored.write(STORED, stored.rows(folder / "rows.jsonl"))


def judged(data: str) -> list[Searched]:
    """The stored rooms, with one set of data."""
    rows = stored.rows(STORED)
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
        print("  a set of two or three claimed         ", rate(r.row["named_set"] for r in single))
        claims = [f.split(",")[0] in r.families for r in every for f in r.row["named_families"]]
        print("claims of a family that were right      ", rate(claims))
        sets = [r.both_claimed for r in every if r.row["named_set"]]
        print("claims of a set that were right         ", rate(sets))
        seconds = [r.row["seconds"] for r in every]
        print(f"seconds of processor: median {np.median(seconds):.2f}, at most {max(seconds):.2f}")


if __name__ == "__main__":
    stored.commands(__doc__, run=run, store=store, table=lambda _: table())
