"""Whether means or positions should decide that something is missing.

    python -m benchmarks.where_decides

`where_scores.json` holds two scores in nats of each room of the geometric world that was read before
the rule was chosen, in situ: that of the positions and that of the means over them. The rooms are those
for development (populations 0 and 2) and those that had been judged (population 1), as
`python -m benchmarks.where run` and `means` scored them. Prints how many hidden things each rule
detects where all flag as many rooms that lack nothing, and how many of these exceed the thresholds.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from rtcal.where.detection import MEANS, POSITIONS

Row = dict[str, float]
SCORES = Path(__file__).with_name("where_scores.json")
FLAGGED = 3
"""Rooms without anything hidden that each rule flags: 5 % of 60."""
RULES: dict[str, Callable[[Row], float]] = {
    "means": lambda row: row["means"],
    "means + positions / 4": lambda row: row["means"] + row["positions"] / 4,
    "positions": lambda row: row["positions"],
}


def detected(rows: list[Row], score: Callable[[Row], float]) -> tuple[float, int]:
    """Return the threshold that `FLAGGED` rooms without anything hidden exceed, and what it detects."""
    empty = sorted((score(row) for row in rows if not row["hidden"]), reverse=True)
    threshold = empty[FLAGGED]
    return threshold, sum(score(row) > threshold for row in rows if row["hidden"])


def main() -> None:
    stored: list[Row] = json.loads(SCORES.read_text(encoding="utf-8"))
    for level in (False, True):
        rows = [row for row in stored if row["level"] == level]
        hidden = sum(bool(row["hidden"]) for row in rows)
        print(
            f"{'with' if level else 'without'} level: {FLAGGED} of {len(rows) - hidden} flagged, "
            f"detected of {hidden} above a threshold in nats"
        )
        for name, score in RULES.items():
            threshold, number = detected(rows, score)
            print(f"  {name:22} {number:3}  {threshold:5.1f}")
        for name, limit in (("means", MEANS), ("positions", POSITIONS)):
            above = sum(row[name] > limit for row in rows if not row["hidden"])
            print(f"  with nothing hidden, {name} above {limit:g}: {above}")


if __name__ == "__main__":
    main()
