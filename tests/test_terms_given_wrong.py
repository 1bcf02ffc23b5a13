"""Terms that lack a method, stand twice, or contradict their own cvxpy expression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.calibration.problem_data import times_in_room
from rtcal.calibration.terms import BaseTerm
from rtcal.support.errors import ModelError, SolverError, TermError

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
