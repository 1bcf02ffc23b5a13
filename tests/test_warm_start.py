"""The closed form starts every solver that takes a start, and changes nothing of the answer."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration import solvers
from tests.conftest import random_room, true_times

EYRING = rt.Eyring()


def cases(count: int, n: int = 12) -> list[tuple[rt.Room, np.ndarray]]:
    """Rooms of one shape; in every other one, T pushes coefficients to their bounds."""
    made = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        room = random_room(rng, n, 8, rt.Air())
        t = true_times(rng, room, EYRING)
        made.append((room, EYRING.time(room, 0.15 * room.absorption_area) if seed % 2 else t))
    return made


@pytest.mark.parametrize("solver", solvers.STARTED)
def test_cold_and_warm_answers_are_bit_identical(solver: str) -> None:
    if solver.startswith("qpsolvers:"):
        pytest.importorskip(solver.removeprefix("qpsolvers:").replace("proxqp", "proxsuite"))
    at_bound = 0
    for room, t in cases(20):
        cold, warm = (
            rt.calibrate(room, t, solver=solver, warm_start=how) for how in ("none", "auto")
        )
        assert cold.polished
        assert warm.polished
        at_bound += bool(warm.active.any())
        for name in ("alpha", "multipliers", "active"):
            np.testing.assert_array_equal(getattr(cold, name), getattr(warm, name))
        np.testing.assert_array_equal(cold.certificate.duality_gap, warm.certificate.duality_gap)
    assert 10 <= at_bound < 20


def test_solvers_have_one_answer_to_the_last_bit() -> None:
    """The polished answer depends on the active set alone."""
    for room, t in cases(10):
        found = [rt.calibrate(room, t, solver=s).alpha for s in ("clarabel", "osqp", "highs")]
        for alpha in found[1:]:
            np.testing.assert_array_equal(alpha, found[0])


def test_osqp_starts_at_the_closed_form_by_default() -> None:
    for room, t in cases(10):
        cold = rt.calibrate(room, t, solver="osqp", warm_start="none").raw.iterations
        assert rt.calibrate(room, t, solver="osqp").raw.iterations == 5 < cold
        asked = rt.calibrate(room, t, solver="osqp", warm_start="closed_form")
        assert asked.raw.iterations == 5


def test_a_problem_without_a_closed_form_starts_cold_by_default(cr2) -> None:
    result = rt.calibrate(*cr2, method="soft", solver="osqp")
    np.testing.assert_allclose(result.alpha, rt.calibrate(*cr2, method="soft").alpha, atol=1e-9)
    with pytest.raises(rt.errors.ModelError, match="the closed form starts only"):
        rt.calibrate(*cr2, method="soft", solver="osqp", warm_start="closed_form")


def test_qpsolvers_hands_the_start_on(monkeypatch: pytest.MonkeyPatch) -> None:
    qpsolvers = pytest.importorskip("qpsolvers")
    pytest.importorskip("daqp")
    given, solve = [], qpsolvers.solve_problem

    def recorded(problem: object, initvals: np.ndarray | None = None, **more: object) -> object:
        given.append(initvals)
        return solve(problem, initvals=initvals, **more)

    monkeypatch.setattr(qpsolvers, "solve_problem", recorded)
    room, t = cases(1)[0]
    result = rt.calibrate(room, t, solver="qpsolvers:daqp")
    np.testing.assert_allclose(given[0], result.shift_in_sigmas.ravel(), atol=1e-9)
    rt.calibrate(room, t, solver="qpsolvers:daqp", warm_start="none")
    rt.calibrate(room, t, method="soft", solver="qpsolvers:daqp")
    assert given[1:] == [None, None]
