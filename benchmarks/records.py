"""Counts of the finder's right claims, as every finding prints them: rtcal/finder/records.json.

    python -m benchmarks.records   # print the counts
    python -m benchmarks.records write  # write the file

Means over positions: the stored rows of `benchmarks.studies.means.judged` and of
`benchmarks.studies.means.several_effects`, and of `benchmarks.studies.runs`. Measured rooms: the
judging cases of `benchmarks.studies.means.real_rooms`. Positions: the stored rows of
`benchmarks.studies.pairs.where`. Every judged room of a statement counts once.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks.studies.geometric_world.load import EMPTY
from benchmarks.studies.means import judged, real_rooms, several_effects
from benchmarks.studies.means.judging import FLAGS
from benchmarks.studies.means.real_cases import every_case
from benchmarks.studies.pairs import where
from benchmarks.studies.pairs.where_figures import (
    ABSORBERS,
    DATA,
    HIDDEN,
    Rows,
    family_of,
    is_first,
    right_families,
)
from benchmarks.studies.runs.counts import STORED as RUNS
from benchmarks.studies.stored import rows
from rtcal.finder import records

FILE = Path(__file__).parents[1] / "rtcal" / "finder" / records.FILE
OF_STATEMENT = {
    records.IN_SITU: (where.IN_SITU, ("sixth", "seventh", "eighth", "ninth", "tenth")),
    records.HANDBOOK: (where.HANDBOOK, ("first",)),
}
"""By the coefficients' source its name in the rows, and the stored rooms that count
(`benchmarks.studies.pairs.where_figures.ROOMS`). Each was judged by one finder, and no room is in
two of them."""
Counts = tuple[int, int]
"""A number of rooms or claims, and of how many it is."""


def counted(hits: Iterable[bool]) -> Counts:
    table = list(hits)
    return sum(table), len(table)


def of_means(data: str) -> dict[str, Any]:
    """Return the counts of means over positions with one kind of data, in the rooms of both worlds."""
    rooms = judged.judged(judged.rows_of(), data, judged.BOTH)
    return {
        "detected": counted(r.flagged for r in rooms if r.hidden),
        "flagged": counted(r.flagged for r in rooms if r.nothing),
        "right": {
            v: counted(r.truth_in_set for r in rooms if r.row["verdict"] == v) for v in FLAGS[:3]
        },
    }


def of_runs() -> dict[str, Any]:
    """Return the counts of means beside another program's, in rooms that a third simulator gave."""
    found = [(r["with"], bool(r["hidden"])) for r in rows(RUNS)]
    some, none = (counted(w["verdict"] in FLAGS for w, h in found if h == k) for k in (True, False))
    right = {
        v: counted(
            w["right"] if w["family"] else w["in_set"] for w, _ in found if w["verdict"] == v
        )
        for v in FLAGS[:3]
    }
    return {"detected": some, "flagged": none, "right": right}


def of_several() -> dict[str, Counts]:
    """Return claims that were right, and claims, of a search for several effects."""
    rooms = several_effects.judged("all")
    claims = [f.split(",")[0] in r.families for r in rooms for f in r.row["named_families"]]
    return {
        "families": counted(claims),
        "sets of families": counted(r.both_claimed for r in rooms if r.row["named_set"]),
    }


def of_measured() -> dict[str, int]:
    """Return the judging cases in measured rooms, the names and families claimed, and wrong ones."""
    found = real_rooms.rows_of(None)
    cases = [c for c in every_case() if c.part == "judging" and c.name in found]
    claims = [c for c in cases if found[c.name]["verdict"] in FLAGS[:2]]
    wrong = sum(real_rooms.outcome(c, found[c.name]) == "wrong" for c in claims)
    return {"cases": len(cases), "claims": len(claims), "wrong": wrong}


def of_positions(statement: str, data: str) -> dict[str, Any]:
    """Return the counts of a search at every position; ``data`` is a key of `DATA`."""
    name, of = OF_STATEMENT[statement]
    every = [
        pair
        for which in of
        for pair in Rows(where.kept(name, which)[0], where.population_of(which), data).all
    ]
    flagged = [(t, r) for t, r in every if r["verdict"] in FLAGS]
    claimed = [(t, r) for t, r in flagged if r["verdict"] in FLAGS[:2]]
    return {
        "detected": counted(r["verdict"] in FLAGS for t, r in every if t["kind"] in HIDDEN),
        "flagged": counted(r["verdict"] in FLAGS for t, r in every if t["kind"] == EMPTY),
        "right": {
            "family": counted(family_of(r) in right_families(t["kind"]) for t, r in claimed),
            "surface": counted(is_first(r) for t, r in flagged if t["kind"] in ABSORBERS),
            "surface claimed": counted(
                r["surface"] == r["true_surface"] for _, r in flagged if r["surface"] is not None
            ),
        },
    }


def text() -> str:
    """Return the file's text."""
    of_data = zip(judged.DATA, (records.TIMES, records.ALL), strict=True)
    words = dict(zip(DATA, (records.WITHOUT_LEVEL, records.WITH_LEVEL), strict=True))
    counts = {
        "means": {**{name: of_means(data) for data, name in of_data}, records.RUN: of_runs()},
        "several": of_several(),
        "measured": of_measured(),
        "positions": {
            statement: {words[data]: of_positions(statement, data) for data in DATA}
            for statement in OF_STATEMENT
        },
    }
    return json.dumps(counts, indent=1) + "\n"


if __name__ == "__main__":
    if sys.argv[1:] == ["write"]:
        FILE.write_text(text(), encoding="utf-8")
    else:
        print(text(), end="")
