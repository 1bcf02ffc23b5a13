"""The study of room modes: the page shows what the judged rooms say."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.studies.room_modes.modes import summary

ROOT = Path(__file__).parents[1]


def test_page_shows_the_judged_rooms():
    stored = ROOT / "benchmarks" / "studies" / "room_modes" / "modes_judged.jsonl"
    lines = stored.read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    seeds = [r["seed"] for r in rows]
    assert sorted(set(seeds)) == seeds
    assert set(seeds) <= set(range(5000, 5060))
    page = (ROOT / "benchmarks" / "studies" / "room_modes" / "README.md").read_text()
    found = summary(rows)
    for name, value in found.items():
        assert f"| {name} | {value} |" in page
    assert (
        found["error, modes / T alone"] < found["mean error, stated"] / found["mean error, T alone"]
    )
