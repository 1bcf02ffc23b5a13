"""alpha_error_bound where rows share coefficients, against the optimum in rational arithmetic."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.certificate import certify
from rtcal.calibration.convex_program import Solution
from rtcal.calibration.numpy_model import Multipliers
from rtcal.support.errors import SolverError
from tests import coupled


def answers(solver: str = "clarabel") -> Iterator[tuple[Solution, np.ndarray]]:
    """Solutions and their exact optima, without problems that have no accepted answer (0.1 %)."""
    for seed in range(50):
        with contextlib.suppress(SolverError):
            answer = coupled.solution(seed, solver)
            truth = coupled.optimum(answer)
            if truth is not None:
                yield answer, truth


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
def test_the_bound_holds_for_raw_and_final_answers(solver: str) -> None:
    off = 0
    for answer, truth in answers(solver):
        for u, certificate in (
            (answer.raw.unknowns, answer.raw.certificate),
            (answer.unknowns, answer.certificate),
        ):
            error = np.abs(u - truth)
            assert (error <= certificate.alpha_error_bound.ravel() + 2e-16).all()
            off += error.max() > 1e-9
    assert off > 10  # raw answers that are not the optimum


@pytest.mark.parametrize("seed", [17, 62, 76, 505, 561, 642, 763, 2837])
def test_nearly_dependent_rows_and_an_optimum_at_a_bound_are_polished(seed: int) -> None:
    """These raised SolverError: the rows were missed by 1e-12, with multipliers of 1e6."""
    answer = coupled.solution(seed)
    assert answer.polished
    assert np.max(answer.certificate.alpha_error_bound) < 1e-6


def test_the_bound_is_small_at_rounding_level() -> None:
    """It was 1e-6 in the median and 0.015 at worst when each row counted on its own."""
    widest = [np.max(answer.certificate.alpha_error_bound) for answer, _ in answers()]
    assert len(widest) > 40
    assert max(widest) < 1e-6
    assert np.median(widest) < 1e-10


def test_the_bound_holds_far_from_the_optimum_and_for_any_multipliers() -> None:
    rng = np.random.default_rng(1)
    for answer, truth in answers():
        model = answer.model
        noise = 10 ** rng.uniform(-9, 0)
        u = answer.unknowns + noise * model.sigma * rng.standard_normal(truth.size)
        rows = answer.multipliers.rows * rng.uniform(1 - noise, 1 + noise)
        bound = certify(model, u, Multipliers(rows, 0 * u, 0 * u)).alpha_error_bound.ravel()
        assert (np.abs(u - truth) <= bound + 2e-16).all()


def test_poor_multipliers_hardly_loosen_the_bound() -> None:
    """The rows' imbalance is put right, and what is forced to a bound is moved there."""
    rng = np.random.default_rng(1)
    ratios = []
    for answer, truth in answers():
        model = answer.model
        u = answer.unknowns + 1e-3 * model.sigma * rng.standard_normal(truth.size)
        rows = answer.multipliers.rows * rng.uniform(0.5, 1.5)
        bound = certify(model, u, Multipliers(rows, 0 * u, 0 * u)).alpha_error_bound
        ratios.append(bound.max() / np.abs(u - truth).max())
    assert np.median(ratios) < 2  # 10 without the second, 1000 without the first


def test_a_target_at_the_end_of_its_reach_leaves_no_freedom() -> None:
    """No move keeps such a row: its coefficients are known as precisely as its limits."""
    rooms = [
        rt.Room(
            name=f"{mat} m² of mat",
            volume=100,
            materials=["wall", "mat"],
            areas=[80, mat],
            alpha=[[0.2], [0.5]],
            sigma=[[0.05], [0.2]],
            centre_frequencies=[500],
            alpha_min=[[0.1], [0.0]],
        )
        for mat in (10, 30)
    ]
    floor = [
        rt.Eyring().time(room, np.array([room.areas @ room.alpha_min[:, 0]])) for room in rooms
    ]
    calibration = rt.Calibration(rt.terms.PriorDeviation(), [rt.terms.ExactMatch()])
    result = calibration.build(rt.Configurations(rooms)).solve(floor, unreachable="nearest")
    certificate = result.solution.certificate
    assert result.solution.unknowns == pytest.approx([0.1, 0.0], abs=1e-12)
    assert certificate.alpha_error_bound.max() < 1e-12
