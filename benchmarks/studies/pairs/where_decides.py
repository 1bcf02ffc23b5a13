"""Whether positions or means over them should decide that something is missing.

    python -m benchmarks.studies.pairs.where_decides

Reads the rows of `python -m benchmarks.studies.pairs.where_temper run`: rooms of the geometric
world that were read before the rule was chosen, in situ. Prints how many hidden things each rule
detects where all flag as many rooms that lack nothing, in the rooms of populations 0 and 2, which
no finder has chosen; then what the thresholds detect and flag there. Rooms of population 1 are
those in which means had detected something.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.studies.geometric_world.rooms import NOTHING
from benchmarks.studies.pairs.where import read
from benchmarks.studies.pairs.where_figures import DATA
from benchmarks.studies.pairs.where_temper import STORED
from rtcal.finder.positions.search import THRESHOLD

Row = dict[str, Any]
FLAGGED = 1
"""Rooms without anything hidden that each rule flags: one of 23."""
RULES: dict[str, Callable[[Row], float]] = {
    "positions": lambda row: row["score"],
    "positions, noisy pairs too": lambda row: max(row["score"], row["noise"]),
    "positions + means / 2": lambda row: row["score"] + row["score_of_means"] / 2,
    "positions + means": lambda row: row["score"] + row["score_of_means"],
    "means": lambda row: row["score_of_means"],
}


def detected(rows: list[Row], score: Callable[[Row], float]) -> tuple[float, int]:
    """Return the threshold that `FLAGGED` rooms without anything hidden exceed, and what it detects."""
    empty = sorted((score(row) for row in rows if row["kind"] == NOTHING), reverse=True)
    threshold = empty[FLAGGED]
    return threshold, sum(score(row) > threshold for row in rows if row["kind"] != NOTHING)


def counted(rows: list[Row], above: Callable[[Row], bool]) -> str:
    """Return how many rooms with something and with nothing hidden are above a threshold."""
    hidden = [above(row) for row in rows if row["kind"] != NOTHING]
    empty = [above(row) for row in rows if row["kind"] == NOTHING]
    return f"detects {sum(hidden)} of {len(hidden)}, flags {sum(empty)} of {len(empty)}"


def main() -> None:
    stored = read(STORED)
    for data, words in DATA.items():
        rows = [row for row in stored if row["data"] == data and row["population"] != 1]
        earlier = [row for row in stored if row["data"] == data and row["population"] == 1]
        print(f"{words}, populations 0 and 2: {FLAGGED} flagged, detected, threshold in nats")
        for name, score in RULES.items():
            threshold, number = detected(rows, score)
            print(f"  {name:28} {number:3}  {threshold:5.1f}")
        positions = counted(rows, lambda row: row["score"] > THRESHOLD)
        means = counted(rows, lambda row: row["score_of_means"] > row["threshold_of_means"])
        print(f"  positions above {THRESHOLD:g}: {positions}; means above their own: {means}")
        of_earlier = counted(earlier, lambda row: row["score"] > THRESHOLD)
        print(
            f"  population 1, where means had detected: positions above {THRESHOLD:g}: {of_earlier}"
        )


if __name__ == "__main__":
    main()
