"""Count what a search claimed with and without the run; README.md has the rooms and the rule.

python -m benchmarks.studies.runs.counts          # the stored rooms that judged this code
python -m benchmarks.studies.runs.counts benchmarks/studies/runs/judged_seed2.jsonl.gz

`benchmarks.studies.runs.world` in commit 995d6858 drew and searched the rooms.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.studies.means.judging import FLAGS
from benchmarks.studies.stored import Row, rows

STORED = Path(__file__).parent / "judged_seed3.jsonl.gz"
"""Rooms that judged the code as it is; those of seed 2 judged the code before."""


def group(row: Row) -> str:
    """Return which simulators and which room a row is of."""
    if row["kind"] != "ordinary":
        return "not ordinary"
    return "image sources" if "images" in row["simulators"] else "ordinary, two tracers"


def count(table: Sequence[Row]) -> None:
    """Print the table of the rule."""

    def share(name: str, hits: Sequence[object]) -> None:
        print(f"{name:58} {sum(map(bool, hits)):3d} of {len(hits)}")

    nothing, some = ([r for r in table if bool(r["hidden"]) == k] for k in (False, True))
    for side in ("with", "without"):
        print(f"-- {side} the run")
        share("flagged, nothing hidden", [r[side]["verdict"] in FLAGS for r in nothing])
        for name in ("ordinary, two tracers", "image sources", "not ordinary"):
            for of, those in (("flagged, nothing hidden", nothing), ("detected", some)):
                flags = [r[side]["verdict"] in FLAGS for r in those if group(r) == name]
                share(f"{of}, {name}", flags)
        over = [np.array([r[side]["over"] for r in rs]) for rs in (some, nothing)]
        greater = np.sign(np.subtract.outer(*over)) / 2 + 0.5
        print(f"probability that a room with something exceeds by more: {greater.mean():.2f}")
        share("family right where claimed", [r[side]["right"] for r in table if r[side]["family"]])
        ambiguous = [r[side]["in_set"] for r in some if r[side]["verdict"] == "ambiguous"]
        share("truth in the set where ambiguous", ambiguous)
        fails = [r[side]["right"] is False for r in table if r["kind"] != "ordinary"]
        share("wrong claims where Eyring fails", fails)
    again = [r for r in table if "gap" in r]
    for before, gaps in (
        ("calibrated alone", [r["gap"] for r in again]),
        ("as simulated", [(r["values"][0], r["values"][2]) for r in again]),
    ):
        then, now = np.reshape(gaps, (-1, 2)).T
        share(f"gap smaller after apply and a second run than {before}", list(now < then))
        if len(now):
            print(f"median ratio of the gap: {np.median(now / then):.2f}")
    for r in again:
        text = ", ".join(f"{of:.2f}" for of in r["values"])
        print(
            f"room {r['number']}, EDT, T30, C80, G: {text} JND as simulated, calibrated, corrected"
        )


if __name__ == "__main__":
    count(rows(Path(sys.argv[1]) if len(sys.argv) > 1 else STORED))
