"""The choice of an active set: rows that are let go or kept, bounds that are met, tolerance limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.calibration.feasibility import reach, restrict_to_reach
from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.calibration.optimum import active_rows, polish_answer
from rtcal.support import kkt
from rtcal.support.errors import SolverError
from rtcal.support.kkt import Hessian

PRIOR = terms.PriorDeviation()
ROOM, MEASURED = rt.datasets.bras_cr2()


def solved(constraint: object, factor: float) -> tuple[NumpyModel, np.ndarray, np.ndarray]:
    """Model, optimum and multipliers of the rows for the prior's own T times a factor."""
    t = factor * rt.Eyring().reverberation_time(ROOM)
    solution = rt.Calibration(PRIOR, [constraint]).build(ROOM).solve(t).joint.solution
    return solution.model, solution.unknowns, solution.multipliers.rows


class NoTarget(rt.Eyring):
    """No absorption gives any T."""

    def target(self, room: rt.Room, reverberation_time: np.ndarray) -> np.ndarray:
        return np.full(np.shape(reverberation_time), np.nan)


def polished(model: NumpyModel, start: np.ndarray, rows: np.ndarray) -> tuple:
    none = np.zeros(len(start))
    answer = polish_answer(model, start, Multipliers(rows, none, none), none > 0, none > 0)
    assert answer is not None
    return answer.alpha, answer.multipliers.rows


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_inequality_row_with_the_wrong_sign_is_let_go(side: float) -> None:
    """The prior is within the tolerance; the start claims that it is not."""
    model, optimum, _ = solved(terms.MatchWithin(1.0), 1.0)
    np.testing.assert_array_equal(optimum, model.data.mu)
    u, rows = polished(model, optimum, np.full(ROOM.n_bands, side * 1e3))
    np.testing.assert_allclose(u, model.data.mu, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rows, 0)


@pytest.mark.parametrize(("factor", "side"), [(0.8, -1.0), (1.25, 1.0)])
def test_inequality_row_with_the_right_sign_is_kept(factor: float, side: float) -> None:
    model, optimum, expected = solved(terms.MatchWithin(1.0), factor)
    assert (side * expected > 0).all()
    limit = model.row_lower if side < 0 else model.row_upper
    np.testing.assert_allclose(model.matrix @ optimum, limit, rtol=1e-13)
    for claimed in (side, 0.0, -side):  # right, not active at all, active on the other side
        u, rows = polished(model, optimum, np.full(ROOM.n_bands, claimed * 1e3))
        np.testing.assert_allclose(u, optimum, rtol=0, atol=1e-14)
        np.testing.assert_allclose(rows, expected, rtol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-4])
def testactive_rows_are_the_same_in_any_unit_of_area(unit: float) -> None:
    volume = unit**1.5 * ROOM.volume
    room = ROOM.replace(areas=unit * ROOM.areas, surfaces=(), volume=volume)
    t = rt.Eyring().reverberation_time(room) * [0.8, 0.8, 1.0, 1.0, 1.25, 1.25]
    calibration = rt.Calibration(PRIOR, [terms.MatchWithin(1.0)])
    solution = calibration.build(room).solve(t).joint.solution
    rows = solution.multipliers.rows
    np.testing.assert_array_equal(np.sign(rows), [-1, -1, 0, 0, 1, 1])
    np.testing.assert_array_equal(active_rows(solution.model, solution.unknowns, rows), rows)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_target_at_an_end_forces_its_band_and_no_other(share: float) -> None:
    sabine = rt.Sabine()
    problem = rt.Calibration(PRIOR, [terms.ExactMatch()]).build(ROOM, sabine)
    data = problem.solve(MEASURED).joint.solution.model.data
    least, most = reach(data)
    target = data.target.copy()
    target[0, 2] = (1 - share) * least[0, 2] + share * most[0, 2]
    _, at_lower, at_upper, beyond = restrict_to_reach(
        replace(data, target=target), [ROOM], (target, target), sabine, "raise"
    )
    assert beyond == ()
    band = np.tile(np.arange(ROOM.n_bands) == 2, len(ROOM.materials))
    np.testing.assert_array_equal(at_lower, band & (share == 0))
    np.testing.assert_array_equal(at_upper, band & (share == 1))


@pytest.mark.parametrize(("factor", "side"), [(1.4, -1), (0.6, 1)])
def test_wrongly_claimed_bounds_are_let_go_and_missed_bounds_are_met(
    factor: float, side: int
) -> None:
    room = ROOM.replace(alpha=np.clip(ROOM.alpha, 0.061, 0.069))
    t = factor * rt.Eyring().reverberation_time(room)
    bounds = terms.Bounds(0.06, 0.07, material="plaster")
    calibration = rt.Calibration(PRIOR, [terms.ExactMatch(), bounds])
    solution = calibration.build(room).solve(t).joint.solution
    model, optimum = solution.model, solution.unknowns
    assert (solution.active == side).any()
    assert (solution.active == 0).any()
    nothing = np.zeros(len(optimum), dtype=bool)
    none = np.zeros(len(optimum))
    for claimed in (solution.active, -solution.active, 0 * solution.active):
        lower, upper = (np.where(claimed == s, 1e6, none) for s in (-1, 1))
        start = Multipliers(solution.multipliers.rows, lower, upper)
        answer = polish_answer(model, optimum, start, nothing, nothing)
        assert answer is not None
        np.testing.assert_allclose(answer.alpha, optimum, rtol=0, atol=1e-13)
        np.testing.assert_array_equal(answer.active, solution.active)
        for multiplier, s in ((answer.multipliers.lower, -1), (answer.multipliers.upper, 1)):
            assert (multiplier >= 0).all()
            assert (multiplier[solution.active != s] == 0).all()


def test_tolerance_reaches_to_a_target_that_was_moved_and_no_farther() -> None:
    model, _, _ = solved(terms.MatchWithin(1.0), 1.0)
    data, within = model.data, terms.MatchWithin(1.0)
    low, high = (limit.copy() for limit in within.target_limits(data))
    assert (low < data.target).all()
    assert (data.target < high).all()
    t = data.time
    np.testing.assert_allclose(low, data.target_of(1.05 * t), rtol=1e-14)
    np.testing.assert_allclose(high, data.target_of(0.95 * t), rtol=1e-14)
    for moved, expected in (
        (0.5 * low, (0.5 * low, high)),
        (2.0 * high, (low, 2.0 * high)),
        (0.5 * (low + high), (low, high)),
    ):
        limits = within.target_limits(replace(data, target=moved))
        np.testing.assert_array_equal(limits[0], expected[0])
        np.testing.assert_array_equal(limits[1], expected[1])


def test_target_whose_tolerance_has_one_end_only_is_closed_by_the_target() -> None:
    """T so short that no absorption gives it: the end within reach takes the lower limit's place."""
    model, _, _ = solved(terms.MatchWithin(1.0), 1.0)
    data = model.data
    nothing = replace(data, equation=NoTarget())
    low, high = terms.MatchWithin(1.0).target_limits(nothing)
    np.testing.assert_array_equal(low, data.target)
    np.testing.assert_array_equal(high, np.broadcast_to(data.largest_target, high.shape))


@pytest.mark.parametrize("sparse", [False, True])
def test_kkt_solution_satisfies_both_equations(sparse: bool) -> None:
    import scipy.sparse as sp

    rng = np.random.default_rng(0)
    hessian = rng.uniform(1, 3, 6)
    rows = rng.standard_normal((2, 6))
    for columns in ((), (3,)):
        force, limit = rng.standard_normal((6, *columns)), rng.standard_normal((2, *columns))
        given = sp.csr_array(sp.diags_array(hessian)) if sparse else hessian
        step, multipliers = kkt.solve(given, sp.csr_array(rows) if sparse else rows, force, limit)
        np.testing.assert_allclose(
            np.diag(hessian) @ step + rows.T @ multipliers, force, atol=1e-12
        )
        np.testing.assert_allclose(rows @ step, limit, atol=1e-12)


@pytest.mark.parametrize("steep", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("columns", [(), (3,)])
@pytest.mark.parametrize("common", [False, True])
def test_kkt_with_squares_solves_the_whole_system(
    common: bool, sparse: bool, steep: float, columns: tuple[int, ...]
) -> None:
    import scipy.sparse as sp

    rng = np.random.default_rng(0)
    diagonal, squares = rng.uniform(1, 3, 6), steep * rng.standard_normal((2, 6))
    rows = rng.standard_normal((1, 6))
    force, limit = rng.standard_normal((6, *columns)), rng.standard_normal((1, *columns))
    plain = sp.csr_array(sp.diags_array(diagonal)) if sparse else diagonal
    less = rng.uniform(0.2, 0.4, (1, 6)) if common else None
    hessian = Hessian(plain, sp.csr_array(squares), less)
    whole = np.diag(diagonal) + squares.T @ squares
    whole -= 0.0 if less is None else less.T @ less
    np.testing.assert_allclose(hessian.whole().toarray(), whole)
    np.testing.assert_allclose(hessian.diagonal(), np.diag(whole))
    part = hessian.part(np.arange(6) < 4, np.full(4, 2.0))
    np.testing.assert_allclose(part.whole().toarray(), 4 * whole[:4, :4])
    size = rng.uniform(0, 1, 6)
    assert (hessian.magnitude(size) >= np.abs(whole) @ size * (1 - 1e-12)).all()
    step, multipliers = kkt.solve(hessian, sp.csr_array(rows) if sparse else rows, force, limit)
    np.testing.assert_allclose(rows @ step, limit, atol=1e-12)
    # Along the rows' null space the whole system holds, which is solved there in 6 - 1 dimensions.
    null = np.linalg.svd(rows)[2][1:].T
    particular = np.linalg.pinv(rows) @ limit
    inner = np.linalg.solve(null.T @ whole @ null, null.T @ (force - whole @ particular))
    np.testing.assert_allclose(step, particular + null @ inner, rtol=1e-6, atol=1e-9)
    assert multipliers.shape == limit.shape


def test_kkt_takes_the_least_multipliers_of_dependent_rows() -> None:
    rows = np.array([[1.0, 1.0], [1.0, 1.0]])
    step, multipliers = kkt.solve(np.ones(2), rows, np.zeros(2), np.array([2.0, 2.0]))
    np.testing.assert_allclose(step, 1.0, atol=1e-12)
    np.testing.assert_allclose(multipliers, -0.5, atol=1e-12)


def test_kkt_says_that_a_system_is_singular() -> None:
    import scipy.sparse as sp

    with pytest.raises(SolverError, match="singular"):
        kkt.solve(sp.csr_array(np.diag([-1e-11, 1.0])), np.zeros((0, 2)), np.zeros(2), np.zeros(0))
