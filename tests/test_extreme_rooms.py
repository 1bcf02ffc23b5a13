"""Feasible rooms at the edge of double precision, the exact dual, and the bound of the error."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import rtcal as rt
from benchmarks.extreme_rooms import Counts, extreme_room
from rtcal import terms
from rtcal.calibration import convex_program, exact, optimum, solvers
from rtcal.calibration.certificate import certify
from rtcal.calibration.numpy_model import Multipliers
from rtcal.support.errors import SolverError

PRIOR = terms.PriorDeviation()


@pytest.mark.parametrize("n", [20, pytest.param(60, marks=pytest.mark.long)])
def test_no_failure_and_no_answer_outside_its_bound(n: int) -> None:
    counts = Counts()
    for seed in range(n):
        counts.add(seed)
    assert counts.failed == []
    assert counts.raw_outside == []
    assert counts.outside == []
    assert counts.widest < 1e-6
    assert counts.moved_without_time < 1e-12
    assert np.median(counts.looseness) < 2


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("kind", ["exact", "tolerance", "soft"])
def test_dual_is_the_exact_batch_solver_s_answer(kind: str, seed: int) -> None:
    room, t = extreme_room(seed)
    calibration = {
        "exact": rt.Calibration(PRIOR, [terms.ExactMatch()]),
        "tolerance": rt.Calibration(PRIOR, [terms.MatchWithin(0.7)]),
        "soft": rt.Calibration(PRIOR + 0.4 * terms.SoftMatch(0.03)),
    }[kind]
    model = calibration.build(room).solve(t, unreachable="nearest").joint.solution.model
    u, multipliers = optimum.dual_solution(model)
    data, missing = model.data, np.isnan(t)
    target, uncertainty, tolerance = data.target[0], 0.0, 0.0
    if kind == "soft":
        uncertainty = np.nan_to_num(data.target_uncertainty[0] / np.sqrt(0.4))
    if kind == "tolerance":
        lower, upper = (limit[0] for limit in terms.MatchWithin(0.7).target_limits(data))
        target, tolerance = (lower + upper) / 2, np.nan_to_num((upper - lower) / 2)
    wanted = exact.solve(
        room.alpha.T,
        room.sigma.T,
        room.areas,
        np.where(missing, 0.0, target),
        room.alpha_min.T,
        1.0,
        uncertainty=uncertainty,
        tolerance=tolerance,
    ).alpha.T
    wanted[:, missing] = room.alpha[:, missing]
    np.testing.assert_allclose(data.alpha(u), wanted, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(multipliers.lower[u > model.lower], 0)
    np.testing.assert_array_equal(multipliers.upper[u < model.upper], 0)
    force = model.stationarity(u, multipliers.rows)
    above = force[model.movable & (u == model.upper) & (u > model.lower)]
    at_upper = multipliers.upper[model.movable & (u == model.upper) & (u > model.lower)]
    np.testing.assert_array_equal(at_upper, np.maximum(-above, 0.0))
    certificate = certify(model, u, multipliers)
    assert np.max(certificate.primal_residual) < 1e-12
    below, above = optimum.separable_form(model).enclosure()
    assert (wanted >= below.T - 1e-12).all()
    assert (wanted <= above.T + 1e-12).all()
    assert (above - below).max() < 1e-6


@pytest.mark.parametrize("coupled", [PRIOR + 0.3 * terms.BandSmoothness(), terms.HuberDeviation()])
def test_other_problems_are_not_taken_for_separable(coupled) -> None:
    room, measured = rt.datasets.bras_cr2()
    model = rt.Calibration(coupled).build(room).solve(measured).joint.solution.model
    assert optimum.dual_solution(model) is None


def fails(*_: object, **__: object) -> None:
    raise SolverError('solver "clarabel" returned no values; its status is NumericalError')


def test_dual_answers_where_the_default_solver_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    room, measured = rt.datasets.bras_cr2()
    usual = rt.calibrate(room, measured)
    monkeypatch.setattr(solvers, "run", fails)
    for polish in (convex_program.polish_answer, lambda *_: None):
        monkeypatch.setattr(convex_program, "polish_answer", polish)
        result = rt.calibrate(room, measured)
        np.testing.assert_allclose(result.alpha, usual.alpha, rtol=0, atol=1e-13)
        np.testing.assert_allclose(result.multipliers, usual.multipliers, rtol=1e-9)
        assert result.certificate.worst < 1e-12
        assert result.raw.status.startswith("exact dual, since the solver failed: solver")


@pytest.mark.parametrize("options", [{"solver": "osqp"}, {"settings": {"max_iter": 50}}])
def test_a_solver_or_settings_that_were_asked_for_fail_as_they_do(options, monkeypatch) -> None:
    monkeypatch.setattr(solvers, "run", fails)
    with pytest.raises(SolverError, match="NumericalError"):
        rt.calibrate(*rt.datasets.bras_cr2(), **options)


def test_steep_band_does_not_excuse_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """A band without T that stands off its prior is refused, however steep the other band is."""
    room = rt.Room(
        name="steep",
        volume=100,
        materials=["wall", "floor"],
        areas=[80, 40],
        alpha=[[0.3, 0.3], [0.2, 0.2]],
        sigma=[[1e-8, 0.1], [1e-8, 0.1]],
        centre_frequencies=[500, 1000],
        air=rt.Air(),
    )
    t = np.array([rt.Eyring().time(room, np.full(2, 20.0))[0], np.nan])
    solution = rt.calibrate(room, t).joint.solution
    model = solution.model
    assert np.max(np.abs(model.sigma * model.gradient(solution.unknowns))) > 1e6
    assert convex_program._failure(solution, "") == ""
    moved = solution.unknowns.copy()
    moved[[1, 3]] += 4.9e-4 * np.array([1, -2])
    off = convex_program.Solution(
        model,
        moved,
        solution.multipliers,
        solution.active,
        certify(model, moved, solution.multipliers),
        solution.raw,
        False,
        (),
    )
    assert "its answer does not pass" in convex_program._failure(off, "clarabel")


@pytest.mark.parametrize("method", ["soft", "smooth", "robust", "joint"])
def test_bound_of_coupled_problems_holds_and_is_small_at_rounding_level(method: str) -> None:
    rng = np.random.default_rng(4)
    rooms = [extreme_room(seed) for seed in range(12)]
    for room, t in [(room, t) for room, t in rooms if room.n_bands > 1]:
        room = room.replace(sigma=np.clip(room.sigma, 1e-3, None))
        result = rt.calibrate(room, t, method=method)
        model, alpha = result.joint.solution.model, result.alpha
        assert np.nanmax(result.certificate.alpha_error_bound) < 1e-6
        scale = 10 ** rng.uniform(-8, -1)
        u = result.joint.solution.unknowns + scale * model.sigma * rng.standard_normal(alpha.size)
        u = np.clip(u, model.lower, model.upper)
        bound = certify(model, u, Multipliers(np.zeros(0), u * 0, u * 0)).alpha_error_bound
        assert (np.abs(model.data.alpha(u) - alpha) <= bound + 1e-12).all()


def test_bound_counts_only_what_can_move_towards_the_target() -> None:
    """The wall stands at 0, so that the floor alone can take up less absorption."""
    room = rt.Room(
        name="hard wall",
        volume=200,
        materials=["wall", "floor"],
        areas=[200, 20],
        alpha=[[0.0, 0.0], [0.5, 0.5]],
        sigma=[[0.1, 0.1], [0.1, 0.1]],
        centre_frequencies=[500, 1000],
    )
    t = rt.Eyring().time(room, np.full(2, 9.0))
    coupled = rt.Calibration(PRIOR + terms.BandSmoothness(), [terms.ExactMatch()])
    result = coupled.build(room).solve(t)
    np.testing.assert_allclose(result.alpha, [[0, 0], [0.45, 0.45]], rtol=0, atol=1e-12)
    model = result.joint.solution.model
    prior, none = model.data.mu, np.zeros(4)
    rows = np.zeros(len(model.row_lower))
    bound = certify(model, prior, Multipliers(rows, none, none)).alpha_error_bound
    assert (bound >= np.abs(room.alpha - result.alpha) - 1e-12).all()


@pytest.mark.parametrize(
    "objective", [terms.HuberDeviation() + terms.SoftMatch(0.05), PRIOR + terms.SoftMatch(0.05)]
)
def test_one_problem_is_solved_from_eight_threads(objective) -> None:
    room, measured = rt.datasets.bras_cr2()
    problem = rt.Calibration(objective).build(room)
    base = measured.decay_time().mean
    times = [base * factor for factor in np.linspace(0.7, 1.4, 48)]
    alone = [problem.solve(t) for t in times]
    start = threading.Barrier(8)

    def solve(t: np.ndarray) -> rt.calibration.CalibrationResult:
        return problem.solve(t)

    with ThreadPoolExecutor(8, initializer=start.wait) as pool:
        together = list(pool.map(solve, times))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(other.alpha, one.alpha)
        np.testing.assert_array_equal(other.raw.alpha, one.raw.alpha)
        assert other.raw.certificate.worst == one.raw.certificate.worst
