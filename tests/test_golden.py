"""Stored figures: what moved is printed, figure by figure, and the same figures are the same bytes."""

import numpy as np
import pytest

from benchmarks import golden


def lines(before, now):
    found = golden.Differences()
    found.add(golden.plain(before), golden.plain(now), 1e-9)
    return found.lines


def test_each_figure_that_moved_is_printed():
    before = {"verdict": "none", "p": {"a": 0.5, "b": 0.5}, "gap": np.ones((2, 2)), "n": 2}
    assert lines(before, before) == []
    now = {
        "verdict": "hint",
        "p": {"a": 0.5, "b": 0.25},
        "gap": np.array([[1, 1], [1, 1.5]]),
        "n": 3,
    }
    assert lines(before, now) == [
        "verdict: none -> hint",
        "p: 1 of 2 numbers, by 0.25 at most",
        "gap: 1 of 4 numbers, by 0.5 at most",
        "n: 2 -> 3, by 1",
    ]
    assert lines({"a": [1.0, None]}, {"a": [1.0, 2.0]}) == ["a: 1 of 2 numbers, by 0 at most"]
    assert lines({"a": 1, "b": 2}, {"a": 1, "c": 2}) == ["b: gone", "c: new"]
    # Of a list with a list in it each member is compared.
    assert lines({"a": [1.0, [2.0, 3.0]]}, {"a": [1.0 + 1e-12, [2.0, 4.0]]}) == [
        "a [1]: 1 of 2 numbers, by 1 at most"
    ]


def test_rounding_is_counted_and_has_not_moved():
    found = golden.Differences()
    found.add({"x": [1.0, 100.0]}, {"x": [1.0 + 5e-8, 100.0]}, 1e-9)
    assert (found.lines, found.within) == ([], 1)
    assert found.largest == pytest.approx(5e-8)
    found.add({"x": [1.0, 100.0]}, {"x": [1.0 + 5e-7, 100.0]}, 1e-9)
    assert found.lines == ["x: 1 of 2 numbers, by 5e-07 at most"]
    alone = golden.Differences(alone=True)
    alone.add({"x": [1.0, 1000.0]}, {"x": [1.0 + 5e-7, 1000.0 + 5e-7]}, 1e-9)
    assert (alone.lines, alone.within) == (["x: 1 of 2 numbers, by 5e-07 at most"], 1)
    # A gap that is closed is rounding, whatever it is a share of.
    assert lines({"gap": [1e-15, 5e-15]}, {"gap": [7e-15, 2e-15]}) == []
    assert lines({"gap": [1e-15, 5e-15]}, {"gap": [2e-12, 5e-15]}) != []


def test_figures_are_kept_to_the_last_bit(tmp_path, monkeypatch):
    monkeypatch.setattr(golden, "STORED", tmp_path / "golden.json.gz")
    task = next(t for t in golden.every_task(False).items() if t[0].startswith("modes: "))
    name, figures, _ = golden.made(task)
    golden.write({name: figures})
    once = golden.STORED.read_bytes()
    assert golden.compare(golden.read(), {name: golden.made(task)[1]}) == 0
    golden.write(golden.read())
    assert golden.STORED.read_bytes() == once


def test_every_task_has_a_kind_and_is_stored():
    names = {*golden.every_task(False)}
    assert {golden.kind_of(n) for n in names} == set(golden.TOLERANCE)
    # Real rooms have their data beside the repository.
    assert {n for n in names if golden.kind_of(n) != "real"} <= set(golden.read())


def test_only_rooms_of_development_are_read():
    real = {c.name for c in golden.every_case() if c.part == "development"}
    named = {name.removeprefix("real: ") for name in golden.every_task(True)}
    judged = {c.name for c in golden.every_case()} - real
    assert real <= named
    assert not judged & named
