"""The solver comparison: each broken solver is caught by the metric meant for it, and runs resume."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import qpsolvers

pytest.importorskip("qpbenchmark")
pytest.importorskip("piqp")

from benchmarks.solvers import render, run, truth
from benchmarks.solvers.cases import Rooms


@pytest.fixture(scope="module")
def test_set():
    return Rooms("tiny")


@pytest.fixture(scope="module")
def cases(test_set):
    return {case.name: case for case in test_set}


@pytest.fixture
def feasible(cases):
    return cases["random 6 x 8 no 0"]


def right(case, test_set):
    settings = test_set.solver_settings["high_accuracy"]
    return run.by_qpsolvers("clarabel", case, settings, "high_accuracy")


def judged(case, test_set, **broken):
    found = dataclasses.replace(right(case, test_set), **broken)
    return run.judge(case, "broken", "mid_accuracy", found, test_set.tolerances["mid_accuracy"])


@pytest.mark.parametrize(
    ("broken", "seen"),
    [
        # The primal residual sees it even where the error in alpha is not known.
        (lambda good: {"x": good.x + 0.5}, lambda row: row.primal > 1e-3 and row.wrong),
        (lambda good: {"y": -good.y}, lambda row: row.dual > 1e-3 and row.gap > 1e-3),
        (lambda good: {"z": None}, lambda row: np.isnan(row.dual)),
        (lambda good: {"x": np.full(len(good.x), np.nan)}, lambda row: row.wrong),
        (
            lambda good: {"status": "infeasible"},
            lambda row: row.failed and not row.wrong and not row.detected,
        ),
        # As much on both sides of the box: stationarity holds, and only the gap can see it.
        (
            lambda good: {"z": good.z + np.tile(np.eye(len(good.x))[0], 2)},
            lambda row: max(row.primal, row.dual) < 1e-8 and row.error < 1e-7 and row.gap > 1e-3,
        ),
    ],
    ids=["infeasible", "wrong duals", "no duals", "nan", "claimed", "not complementary"],
)
def test_a_broken_solver_is_caught(broken, seen, feasible, test_set):
    row = judged(feasible, test_set, **broken(right(feasible, test_set)))
    assert seen(row)
    assert not row.passes


def test_the_truth_of_a_problem_solved_by_hand():
    """Least |x|² with x1 + x2 + x3 = 3 and x1 <= 1/2: x = (1/2, 5/4, 5/4)."""
    x = np.array([0.5, 1.25, 1.25])
    problem = qpsolvers.Problem(
        np.eye(3),
        np.zeros(3),
        np.array([[1.0, 0, 0], [0, -1, 0]]),
        np.array([0.5, 0]),
        np.ones((1, 3)),
        np.array([3.0]),
    )
    np.testing.assert_allclose(truth.of_matrices(problem).x, x, rtol=0, atol=1e-16)
    problem.h = np.array([0.5, -2.0])  # and x2 >= 2
    np.testing.assert_allclose(truth.of_matrices(problem).x, [0.5, 2, 0.5], rtol=0, atol=1e-16)


def test_the_page_is_that_of_the_table():
    """The committed page has the committed table's numbers."""
    root = Path(__file__).resolve().parents[1]
    folder = root / "benchmarks" / "solvers" / "results"
    text = render.text(folder, "full")
    assert (folder.parent / "README.md").read_text(encoding="utf-8") == text
