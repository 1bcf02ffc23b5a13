"""Stored verdicts: what moved is said, figure by figure, and the same figures are the same bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import golden


def test_each_figure_that_moved_is_told() -> None:
    before = golden.plain({"verdict": "none", "p": {"a": 0.5, "b": 0.5}, "gap": np.ones((2, 2))})
    assert golden.moved(before, before) == []
    now = golden.plain(
        {"verdict": "hint", "p": {"a": 0.5, "b": 0.25}, "gap": np.array([[1, 1], [1, 1.5]])}
    )
    assert golden.moved(before, now) == [
        "verdict: none -> hint",
        "p, b: 0.5 -> 0.25",
        "gap: 1 of 4 numbers, by 0.5 at most",
    ]
    assert golden.moved(before, golden.plain({**before, "gap": 1 + np.finfo(float).eps}))
    swapped = {**before, "p": {"b": 0.5, "a": 0.5}}
    assert golden.moved(before, swapped) == ["p: another order"]


def test_figures_are_kept_to_the_last_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(golden, "STORED", tmp_path / "golden.json.gz")
    task = next(t for t in golden.every_task(False, tmp_path) if t.name.startswith("fit: "))
    name, figures, _ = golden.made(task)
    golden.write({name: figures})
    once = golden.STORED.read_bytes()
    assert golden.compare(golden.read(), {name: golden.made(task)[1]}) == 0
    golden.write(golden.read())
    assert golden.STORED.read_bytes() == once


def test_only_rooms_of_development_are_read(tmp_path: Path) -> None:
    real = {c.name for c in golden.every_case() if c.part == "development"}
    named = {t.name.removeprefix("real: ") for t in golden.every_task(True, tmp_path)}
    judged = {c.name for c in golden.every_case()} - real
    assert real <= named
    assert not judged & named
