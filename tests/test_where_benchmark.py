"""The figures of benchmarks/studies/pairs/where.py, on rows whose figures are known."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.studies.geometric_world.load import EMPTY, stored, truth
from benchmarks.studies.pairs import where_figures


def row(index: int, **changed: Any) -> dict[str, Any]:
    """A room about which nothing is said."""
    values = {
        "index": index,
        "data": "without",
        "verdict": "none",
        "effect": None,
        "family": None,
        "surface": None,
        "true_surface": "face 1",
        "n_surfaces": 6,
        "surfaces": {"face 1": 0.7, "face 2": 0.3},
        "likely": ["face 1", "face 2"],
        "best": None,
        "score": 0.0,
        "families": {"none": 0.9, "scale": 0.1},
        "processor": 2.0,
    }
    return {**values, **changed}


def first_of(kind: str, n: int = 1) -> list[int]:
    return [i for i in sorted(stored(0, "truth")) if truth(0, i)["kind"] == kind][:n]


def best(effect: str, size: float) -> dict[str, Any]:
    return {"effect": effect, "surface": "face 1", "size": [size, 0.9 * size, 1.1 * size]}


def test_every_line_counts_the_rooms_that_it_is_about() -> None:
    (opening,), (curtain,) = first_of("opening"), first_of("curtain")
    nothing = first_of(EMPTY, 4)
    flat = {"none": 0.05, "added absorption, flat": 0.9, "added absorption": 0.92}
    size = truth(0, opening)["size"]
    found = [
        row(opening, score=4.0, verdict="named", effect="opening", surface="face 1", families=flat,
            best=best("opening", size)),
        row(curtain, verdict="ambiguous", surfaces={"face 2": 0.6, "face 1": 0.4}, families=flat,
            best=best("opening", 3 * truth(0, curtain)["size"])),
        row(nothing[0], score=5.0, verdict="unknown", true_surface=None),
        *(row(i, true_surface=None) for i in nothing[1:]),
    ]  # fmt: skip
    means = [row(i, verdict="none") for i in (opening, curtain, nothing[0])]
    lines = where_figures.summary(found, means, 0, "without")
    shares = {
        "flagged with nothing hidden": (0.25, 4),
        "detected": (1.0, 2),
        "detected where one empty room is flagged": (0.5, 2),
        "right family, of the detected": (0.5, 2),
        "right surface, of absorbers detected": (0.5, 2),
        "right surface among the candidates": (1.0, 2),
        "candidates, mean": (2.0, 2),
        "a single surface claimed: right": (1.0, 1),
        "size in its 90 % interval": (0.5, 2),
        "means: detected": (0.0, 2),
        "means: flagged with nothing hidden": (0.0, 1),
        "detected more than by means": (1.0, 2),
    }
    for name, (value, n) in shares.items():
        assert (lines[name][0], lines[name][3]) == (pytest.approx(value), n), name
    assert set(where_figures.asked("level")) <= set(lines)
    assert where_figures.summary(found, means, 0, "level")["detected"][3] == 0
