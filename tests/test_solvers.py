"""The table of solvers: what each is given, what it says, and what happens where it says less."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

import rtcal as rt
from rtcal import terms

PRIOR = terms.PriorDeviation()
NO_START = "starts only an independent prior deviation with an exact match, in one configuration"
STATUS = {"clarabel": "Solved", "osqp": "solved", "highs": "optimal", "qpsolvers:daqp": "solved"}


@pytest.mark.parametrize("solver", STATUS)
def test_raw_answer_keeps_the_solver_s_own_status(solver: str, cr2) -> None:
    if solver == "qpsolvers:daqp":
        pytest.importorskip("daqp")
    assert rt.calibrate(*cr2, solver=solver).raw.status == STATUS[solver]


def test_inaccurate_answer_of_a_cvxpy_solver_is_left_to_polish_and_certificate(cr2) -> None:
    usual = rt.calibrate(*cr2)
    result = rt.calibrate(*cr2, solver="scs", settings={"max_iters": 20})
    assert result.raw.status == "optimal_inaccurate"
    np.testing.assert_allclose(result.alpha, usual.alpha, rtol=0, atol=1e-12)


def test_solver_without_dual_values_is_polished_to_the_same_answer(cr2, monkeypatch) -> None:
    """No multiplier says which rows and bounds are active: the polish finds them."""
    usual = rt.calibrate(*cr2)
    for constraint in (cp.constraints.Equality, cp.constraints.Inequality):
        monkeypatch.setattr(constraint, "dual_value", property(lambda _: None))
    result = rt.calibrate(*cr2, solver="highs")
    np.testing.assert_array_equal(result.raw.multipliers.rows, np.zeros(cr2[0].n_bands))
    np.testing.assert_allclose(result.alpha, usual.alpha, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.multipliers, usual.multipliers, rtol=1e-9)


@pytest.mark.parametrize("sparse", [True, False])
def test_qpsolvers_is_given_sparse_matrices_where_it_takes_them(
    sparse: bool, cr2, monkeypatch
) -> None:
    pytest.importorskip("daqp")
    import qpsolvers

    monkeypatch.setattr(qpsolvers, "sparse_solvers", ["daqp"] if sparse else [])
    problems, solve = [], qpsolvers.solve_problem

    def recorded(problem: qpsolvers.Problem, **options: object) -> qpsolvers.Solution:
        problems.append(problem)
        # With the lowest versions daqp itself takes dense ones alone.
        dense = {
            name: getattr(problem, name).toarray()
            if sp.issparse(getattr(problem, name))
            else getattr(problem, name)
            for name in ("P", "q", "G", "h", "A", "b", "lb", "ub")
        }
        return solve(qpsolvers.Problem(**dense), **options)

    monkeypatch.setattr(qpsolvers, "solve_problem", recorded)
    rt.calibrate(*cr2, solver="qpsolvers:daqp")
    (problem,) = problems
    assert [sp.issparse(m) for m in (problem.P, problem.G, problem.A)] == 3 * [sparse]


def test_warm_start_leaves_a_band_alone_whose_coefficients_are_all_known() -> None:
    room = rt.Room(
        name="known at 500 Hz",
        volume=200,
        materials=["a", "b"],
        areas=[100, 120],
        alpha=[[0.1, 0.2], [0.3, 0.2]],
        sigma=[[0, 0.1], [0, 0.1]],
        centre_frequencies=[500, 1000],
    )
    t = rt.Eyring().reverberation_time(room) * [1, 0.9]
    result = rt.calibrate(room, t, solver="osqp", warm_start="closed_form")
    np.testing.assert_array_equal(result.alpha[:, 0], room.alpha[:, 0])
    np.testing.assert_allclose(result.alpha, rt.calibrate(room, t).alpha, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("objective", "constraint"),
    [
        (PRIOR, terms.MatchWithin(1.0)),
        (PRIOR, terms.AtMost("plaster", "concrete")),
        (PRIOR + terms.SoftMatch(0.1), terms.ExactMatch()),
        (terms.HuberDeviation(), terms.ExactMatch()),
        (terms.PriorDeviation(band_correlation=0.5), terms.ExactMatch()),
    ],
)
def test_closed_form_starts_only_the_problem_that_it_solves(objective, constraint, cr2) -> None:
    """OSQP reads a start of another problem's size beyond its end."""
    problem = rt.Calibration(objective, [constraint]).build(cr2[0])
    with pytest.raises(rt.errors.ModelError, match=NO_START):
        problem.solve(cr2[1], solver="osqp", warm_start="closed_form")


def test_closed_form_starts_no_joint_calibration(cr2) -> None:
    room, measured = cr2
    problem = rt.Calibration(PRIOR, [terms.ExactMatch()]).build(rt.Configurations([room, room]))
    with pytest.raises(rt.errors.ModelError, match=NO_START):
        problem.solve([measured, measured], solver="osqp", warm_start="closed_form")
