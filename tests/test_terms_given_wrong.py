"""Terms that lack a method, stand twice, or contradict their own cvxpy expression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.calibration.problem_data import times_in_room
from rtcal.calibration.terms import BaseTerm
from rtcal.support.errors import DataError, InfeasibleError, ModelError, SolverError, TermError

PRIOR = terms.PriorDeviation()


class OnlyExpression(BaseTerm):
    def expression(self, context, weight):
        return context.x[0]

    def value(self, u, data):
        return float(u[0])

    def __repr__(self) -> str:
        return "OnlyExpression()"


class OnlyRows:
    def rows(self, data):
        return terms.Rows(np.zeros((0, 1)), np.zeros(0), np.zeros(0))

    def __repr__(self) -> str:
        return "OnlyRows()"


@pytest.mark.parametrize(
    "composed",
    [
        lambda: PRIOR + OnlyExpression(),
        lambda: OnlyExpression() + PRIOR,
        lambda: 2 * OnlyExpression(),
        lambda: rt.Calibration(OnlyExpression()),
    ],
)
def test_a_term_is_told_which_methods_it_lacks(composed) -> None:
    with pytest.raises(ModelError, match=r"OnlyExpression\(\).*: it lacks curvature, gradient$"):
        composed()


def test_a_constraint_is_told_which_methods_it_lacks() -> None:
    with pytest.raises(
        ModelError, match=r"OnlyRows\(\).*: it lacks constraints, label, row_scale$"
    ):
        rt.Calibration(PRIOR, [OnlyRows()])


def test_what_is_no_term_at_all_is_said_to_be_none() -> None:
    with pytest.raises(ModelError, match=r"5 is not an objective term$"):
        PRIOR + 5
    with pytest.raises(ModelError, match=r"5 is no constraint of rtcal\.terms$"):
        rt.Calibration(PRIOR, [5])


SMOOTH = terms.BandSmoothness()


@pytest.mark.parametrize(
    ("objective", "constraints", "message"),
    [
        (PRIOR + SMOOTH + SMOOTH, None, r"objective: BandSmoothness\(\) stands there twice"),
        (PRIOR + SMOOTH + 3 * SMOOTH, None, r"objective: BandSmoothness\(\) stands there twice"),
        (PRIOR + terms.SoftMatch(0.05) + terms.SoftMatch(0.05), None, "stands there twice"),
        (PRIOR + terms.SoftMatch(0.05) + terms.SoftMatch(0.1), None, "two soft matches"),
        (PRIOR, [terms.ExactMatch(), terms.ExactMatch()], r"constraints: ExactMatch\(\) stands"),
        (PRIOR, [terms.Bounds(0, 0.9), terms.Bounds(0, 0.9)], "constraints: Bounds"),
    ],
)
def test_a_term_given_twice_is_refused(objective, constraints, message) -> None:
    with pytest.raises(ModelError, match=message):
        rt.Calibration(objective, constraints)


ROOM, MEASURED = rt.datasets.bras_cr2()


@dataclass(frozen=True)
class Scaled(terms.HuberDeviation):
    """A prior whose NumPy description has one factor wrong."""

    value_factor: float = 1.0
    gradient_factor: float = 1.0
    curvature_factor: float = 1.0

    def value(self, u, data):
        return self.value_factor * super().value(u, data)

    def gradient(self, u, data):
        return self.gradient_factor * super().gradient(u, data)

    def curvature(self, u, data):
        return self.curvature_factor * super().curvature(u, data)


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (Scaled(value_factor=2, gradient_factor=2, curvature_factor=2), "its cvxpy expression"),
        (Scaled(gradient_factor=2), "its gradient and its value disagree"),
    ],
)
def test_a_wrong_description_is_told_apart_from_a_failed_solver(term, message) -> None:
    with pytest.raises(TermError, match=message) as caught:
        rt.Calibration(term + terms.SoftMatch(0.05)).build(ROOM).solve(MEASURED)
    assert "Scaled(" in str(caught.value)


def test_a_wrong_curvature_that_the_polish_cannot_use_is_named() -> None:
    with pytest.raises(TermError, match="its curvature and its gradient disagree"):
        rt.Calibration(Scaled(curvature_factor=-0.5) + terms.SoftMatch(0.05)).build(ROOM).solve(
            MEASURED, settings={"max_iter": 3}
        )


class DoubledTarget(terms.ExactMatch):
    def rows(self, data):
        rows = super().rows(data)
        return terms.Rows(rows.matrix, 1.1 * rows.lower, 1.1 * rows.upper)


def test_rows_that_contradict_their_constraint_are_named() -> None:
    with pytest.raises(
        TermError, match=r'its rows .* "exact match of T at 125 Hz .*" is violated by'
    ):
        rt.Calibration(PRIOR, [DoubledTarget()]).build(ROOM).solve(MEASURED)


def checked(calibration: rt.Calibration) -> None:
    """Compare the two descriptions of every term of a calibration of CR2."""
    joint = calibration.build(ROOM)._joint
    times = [times_in_room(ROOM, MEASURED)]
    data = joint._assembler.problem_data(joint.configurations, times, None)
    joint._program._require_agreement(data)


def test_a_wrong_value_is_found_though_no_answer_depends_on_it() -> None:
    with pytest.raises(TermError, match="its value and its cvxpy expression disagree"):
        checked(rt.Calibration(Scaled(value_factor=2)))


@pytest.mark.parametrize(
    "objective",
    [
        PRIOR + terms.SoftMatch(0.05) + 0.3 * SMOOTH,
        terms.HuberDeviation() + terms.SoftMatch(0.05),
        terms.PriorDeviation(band_correlation=0.6) + terms.SoftMatch(0.05),
        PRIOR + terms.SoftMatch(0.05) + terms.AddedAbsorption("opening", [1.0] * 6, sigma=2.0),
    ],
)
@pytest.mark.parametrize(
    "constraint",
    [
        terms.ExactMatch(),
        terms.MatchWithin(0.5),
        terms.AtMost("floor", "ceiling"),
        terms.GroupAbsorption(["floor", "ceiling"], least=1, most=9),
        terms.Fixed("floor"),
    ],
)
def test_sound_terms_agree(objective, constraint) -> None:
    checked(rt.Calibration(objective, [constraint]))


def test_a_solver_that_fails_is_not_blamed_on_the_terms() -> None:
    problem = rt.Calibration(terms.HuberDeviation() + terms.SoftMatch(0.05)).build(ROOM)
    with pytest.raises(SolverError, match="its answer does not pass"):
        problem.solve(MEASURED, settings={"max_iter": 1})


STOPPED: tuple[dict[str, Any], ...] = (
    {"settings": {"max_iter": 1}},
    {"settings": {"max_iter": 3}},
    {"settings": {"tol_gap_abs": 1e-2, "tol_gap_rel": 1e-2, "tol_feas": 1e-2}},
    {"solver": "osqp", "settings": {"max_iter": 5}},
    {"solver": "osqp", "settings": {"eps_abs": 3e-2, "eps_rel": 3e-2, "polishing": False}},
    {"solver": "scs", "settings": {"max_iters": 10}},
    {"solver": "qpsolvers:osqp", "settings": {"eps_abs": 1e-2, "eps_rel": 1e-2}},
    {"solver": "qpsolvers:daqp"},
)
"""Solvers that stop early, or are content with little."""


@pytest.mark.parametrize("options", STOPPED, ids=str)
@pytest.mark.parametrize("known", [(0, 0), (0, 1), (1, 1)])
def test_a_right_prior_is_not_accused_for_a_coefficient_that_is_known(options, known) -> None:
    """A correlated prior integrates out what is known exactly (sigma = 0), in both descriptions."""
    sigma = np.array([[0.08, 0.12], [0.05, 0.06]])
    sigma[known] = 0.0
    room = rt.Room(
        name="small",
        volume=72,
        materials=["plaster", "board"],
        areas=[31, 75],
        alpha=[[0.25, 0.35], [0.15, 0.1]],
        sigma=sigma,
        centre_frequencies=[250, 500],
        air=rt.Air(),
        band_correlation=0.6,
        material_correlation={("plaster", "board"): 0.3},
    )
    for t in ([0.7, 0.55], [1.6, 1.1]):
        _as_by_itself(room, t, "soft", options)


def _as_by_itself(room: rt.Room, t: Any, method: str, options: dict[str, Any]) -> str:
    """Calibrate, and return the outcome: the answer of the solver's own settings, or its message."""
    try:
        right = rt.calibrate(room, t, method)
    except InfeasibleError:
        right = None
    except (ModelError, DataError):
        return "refused"
    try:
        result = rt.calibrate(room, t, method, **options)
    except InfeasibleError:
        assert right is None
        return "infeasible"
    except TermError:
        raise
    except SolverError:
        return "solver"
    assert right is not None
    np.testing.assert_allclose(result.alpha, right.alpha, rtol=0, atol=1e-7)
    return "right"


def _drawn_room(rng: np.random.Generator) -> rt.Room:
    """A room of any kind: known, nearly known and unknown coefficients, with and without errors."""
    n, k = int(rng.integers(1, 5)), int(rng.integers(1, 5))
    alpha = rng.uniform(0.02, 0.7, (n, k))
    sigma = alpha * 10 ** rng.uniform(-1.5, 0, (n, k))
    sigma[rng.random((n, k)) < 0.1] *= 1e-3
    sigma[rng.random((n, k)) < rng.choice([0, 0.3])] = 0.0
    free = int(rng.integers(n))
    sigma[free] = np.maximum(sigma[free], 0.02)
    names = [f"material {i}" for i in range(n)]
    stated: dict[str, Any] = {}
    if rng.random() < 0.5:
        stated["band_correlation"] = float(rng.choice([0.3, 0.9]))
    if rng.random() < 0.3 and n > 1:
        stated["material_correlation"] = {(names[0], names[1]): 0.5}
    if rng.random() < 0.3:
        stated["common_alpha_sigma"] = 0.2
    if rng.random() < 0.4:
        stated |= {"volume_sigma": 0.05, "area_sigma": 0.03, "climate_sigma": (2, 10)}
    if rng.random() < 0.3:
        stated["alpha_min"] = alpha * rng.uniform(0, 1, (n, k))
    return rt.Room(
        name="drawn",
        volume=float(rng.uniform(40, 4000)),
        materials=names,
        areas=10 ** rng.uniform(0, 2.5, n),
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=[250, 500, 1000, 2000][:k],
        air=rt.Air(),
        **stated,
    )


def _swept(seeds: Sequence[int]) -> dict[str, int]:
    """Calibrate drawn rooms by every method with a solver that stops early; return what came of it."""
    outcomes: dict[str, int] = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        room = _drawn_room(rng)
        t = rt.Eyring().reverberation_time(room) * np.exp(0.3 * rng.standard_normal(room.n_bands))
        method = str(rng.choice(["mle", "lse", "soft", "smooth", "robust"]))
        options = dict(STOPPED[int(rng.integers(len(STOPPED)))])
        outcome = _as_by_itself(room, t, method, options)
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
    return outcomes


def test_no_right_term_is_accused_in_a_few_drawn_rooms() -> None:
    assert _swept(range(60))["right"] > 20


@pytest.mark.long
def test_no_right_term_is_accused_whatever_solver_settings_or_method() -> None:
    outcomes = _swept(range(1000, 3000))
    assert outcomes["right"] > 1000, outcomes
    assert outcomes["refused"] < 600, outcomes
