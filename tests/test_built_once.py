"""A problem is compiled once for its shape and terms, whoever asks, and its solver is set up once."""

from __future__ import annotations

import gc
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import clarabel
import cvxpy as cp
import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.acoustics import changed_time
from rtcal.calibration import convex_program, solvers
from rtcal.finder import AppliedEffect, recalibrate, verify
from rtcal.finder.effects.absorbers import Opening
from rtcal.finder.search import find
from rtcal.support.errors import DataError, SolverError
from tests.conftest import random_room, true_times
from tests.test_discrepancy import controls_of, opened

EYRING = rt.Eyring()


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Every time that cvxpy builds the chain of reductions; nothing is compiled at the start."""
    rt.calibration.forget()
    seen: list[object] = []
    original = cp.Problem._construct_chain

    def counted(self: cp.Problem, *args: object, **kwargs: object) -> object:
        seen.append(self)
        return original(self, *args, **kwargs)

    monkeypatch.setattr(cp.Problem, "_construct_chain", counted)
    return seen


def cases(count: int, n: int = 6, k: int = 4) -> list[tuple[rt.Room, np.ndarray]]:
    """Rooms of one shape; in every other one, T pushes coefficients to their bounds."""
    made = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        room = random_room(rng, n, k, rt.Air())
        t = true_times(rng, room, EYRING)
        made.append((room, EYRING.time(room, 0.15 * room.absorption_area) if seed % 2 else t))
    return made


@pytest.mark.parametrize("solver", ["clarabel", "osqp", "highs"])
def test_rooms_of_one_shape_are_compiled_once(solver: str, compilations: list[object]) -> None:
    answers = [rt.calibrate(room, t, solver=solver).alpha for room, t in cases(4)]
    assert len(compilations) == 1
    for (room, t), alpha in zip(cases(4), answers, strict=True):
        rt.calibration.forget()
        np.testing.assert_array_equal(rt.calibrate(room, t, solver=solver).alpha, alpha)


def test_another_shape_or_another_term_is_compiled_anew(compilations: list[object]) -> None:
    ((room, t),) = cases(1)
    for count, (method, of) in enumerate(
        [
            ("mle", room),
            ("soft", room),
            ("smooth", room),
            ("soft", room.replace(centre_frequencies=[125, 250, 500, 1000])),
            ("soft", room.replace(materials=list("abcdef"))),
        ],
        start=1,
    ):
        for _ in range(2):
            rt.calibrate(of, t, method=method)
        assert len(compilations) == count


def test_a_solver_s_workspace_is_updated_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    set_up = []
    original = clarabel.DefaultSolver
    monkeypatch.setattr(
        clarabel, "DefaultSolver", lambda *given: set_up.append(given) or original(*given)
    )
    rt.calibration.forget()
    again = [rt.calibrate(room, t).raw for room, t in cases(6)]
    assert len(set_up) == 1
    for (room, t), raw in zip(cases(6), again, strict=True):
        rt.calibration.forget()
        fresh = rt.calibrate(room, t).raw
        np.testing.assert_array_equal(raw.unknowns, fresh.unknowns)
        np.testing.assert_array_equal(raw.multipliers.rows, fresh.multipliers.rows)
    assert len(set_up) == 7
    for tolerance in (1e-9, 1e-9, 1e-7):
        rt.calibrate(room, t, settings={"tol_gap_rel": tolerance})
    assert len(set_up) == 9


def test_a_quick_first_solve_changes_no_answer_and_says_its_tolerance() -> None:
    for room, t in cases(40):
        quick, full = rt.calibrate(room, t), rt.calibrate(room, t, settings={})
        assert quick.raw.settings["tol_gap_abs"] == 1e-8
        assert full.raw.settings["tol_gap_abs"] == 1e-10
        assert quick.raw.iterations < full.raw.iterations
        np.testing.assert_array_equal(quick.alpha, full.alpha)
        np.testing.assert_array_equal(quick.multipliers, full.multipliers)
        np.testing.assert_array_equal(quick.active, full.active)


@pytest.mark.parametrize("fault", ["no polish", "wrong polish", "no values"])
def test_where_the_quick_answer_does_not_do_the_full_solve_follows(
    fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ((room, t),) = cases(1)
    usual = rt.calibrate(room, t)
    run, polish, calls = solvers.run, convex_program.polish_answer, []

    def failing_once(*given):
        calls.append(given)
        if len(calls) > 1:
            return polish(*given)
        right = polish(*given)
        return replace(right, alpha=right.alpha + 1e-6) if fault == "wrong polish" else None

    def without_values_once(*given):
        calls.append(given)
        if len(calls) > 1:
            return run(*given)
        raise SolverError("no values")

    if fault == "no values":
        monkeypatch.setattr(solvers, "run", without_values_once)
    else:
        monkeypatch.setattr(convex_program, "polish_answer", failing_once)
    result = rt.calibrate(room, t)
    assert len(calls) == 2
    assert result.polished
    assert result.raw.settings["tol_gap_abs"] == 1e-10
    np.testing.assert_array_equal(result.alpha, usual.alpha)


def test_a_piecewise_term_is_solved_in_full_at_once() -> None:
    ((room, t),) = cases(1)
    assert rt.calibrate(room, t, method="robust").raw.settings["tol_gap_abs"] == 1e-10


def test_threads_share_one_problem(compilations: list[object]) -> None:
    given = cases(24)
    ready = threading.Barrier(8)

    def solve(some: list[tuple[rt.Room, np.ndarray]]) -> list[np.ndarray]:
        ready.wait(30)
        return [rt.calibrate(room, t).alpha for room, t in some]

    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(solve, [given[i::8] for i in range(8)]))
    assert len(compilations) == 1
    for i, answers in enumerate(found):
        for (room, t), alpha in zip(given[i::8], answers, strict=True):
            np.testing.assert_array_equal(rt.calibrate(room, t).alpha, alpha)


def test_forget_empties(compilations: list[object]) -> None:
    ((room, t),) = cases(1)
    problem = rt.Calibration(terms.PriorDeviation()).build(room)
    kept = weakref.ref(problem._joint._program._compilation)
    del problem
    rt.calibrate(room, t)
    gc.collect()
    assert kept() is not None
    rt.calibration.forget()
    gc.collect()
    assert kept() is None
    rt.calibrate(room, t)
    assert len(compilations) == 2


def test_the_number_kept_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    rt.calibration.forget()
    ((room, _),) = cases(1)
    built = [
        weakref.ref(rt.Calibration(terms.PriorDeviation(sigma=0.1 + i)).build(room)._joint._program)
        for i in range(2 * convex_program._KEPT)
    ]
    gc.collect()
    assert len(built) > convex_program._kept.cache_info().currsize == convex_program._KEPT
    monkeypatch.setattr(convex_program, "_LARGEST_KEPT", room.alpha.size - 1)
    rt.calibration.forget()
    rt.Calibration(terms.PriorDeviation()).build(room)
    assert convex_program._kept.cache_info().currsize == 0


def test_a_term_that_may_change_is_not_shared(compilations: list[object]) -> None:
    class Mutable(terms.PriorDeviation):
        """A subclass that is no frozen dataclass of its own may hold anything."""

    ((room, t),) = cases(1)
    term = Mutable()
    for count in (1, 2):
        rt.Calibration(term).build(room).solve(t)
        assert len(compilations) == count


def test_the_numbers_of_an_effect_are_no_part_of_the_compiled_problem(
    compilations: list[object],
) -> None:
    ((room, t),) = cases(1)
    measured = rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        values={"t20": [0.8 * t]},
        uncertainty={"t20": [0.02 * t]},
    )

    def sizes(gain: float, sigma: float, mean: float) -> tuple[float, np.ndarray]:
        effect = terms.AddedAbsorption("opening", room.n_bands * [gain], sigma, mean)
        objective = terms.PriorDeviation() + terms.SoftMatch() + effect
        result = rt.Calibration(objective).build(room).solve(measured)
        return result.effects["opening"], result.alpha

    numbers = [(1.0, 1.0, 0.0), (2.5, 0.3, 0.0), (1.0, 4.0, 2.0)]
    shared = [sizes(*given) for given in numbers]
    assert len(compilations) == 1
    assert len({size for size, _ in shared}) == 3
    for given, (size, alpha) in zip(numbers, shared, strict=True):
        rt.calibration.forget()
        fresh_size, fresh_alpha = sizes(*given)
        assert fresh_size == size
        np.testing.assert_array_equal(fresh_alpha, alpha)


def test_a_verification_compiles_each_of_its_two_problems_once(
    compilations: list[object],
) -> None:
    """The plain calibration matches T exactly, the corrected one softly, in several steps."""
    case = opened(25.0)
    finding = find(case, effects=[Opening()], controls=controls_of(case))
    rt.calibration.forget()
    compilations.clear()
    verify(finding)
    assert len(compilations) == 2
    verify(finding)
    assert len(compilations) == 2


def test_the_steps_of_a_recalibration_share_one_problem(compilations: list[object]) -> None:
    """The size of the effect is an unknown; each step begins at another size."""
    applied = AppliedEffect("opening", {"area": 8.0})
    recalibrate(replace(opened(25.0), applied=(applied,)))
    assert len(compilations) == 1


def test_a_single_room_is_not_compared_with_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[object] = []

    def counted(*arrays: object) -> bool:
        compared.append(arrays)
        return np.array_equal(*arrays)  # type: ignore[arg-type]

    monkeypatch.setattr(
        changed_time, "np", SimpleNamespace(array_equal=counted, flatnonzero=np.flatnonzero)
    )
    (room, t), (other, _) = cases(2)
    rt.calibrate(room, t)
    assert not compared
    with pytest.raises(DataError, match="a shared material has one prior"):
        rt.calibrate(rt.Configurations([room, other]), [t, t])
    assert compared
