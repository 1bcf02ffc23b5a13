"""The next measurement: the information of a measurement, and what `plan` makes of it."""

import json

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from rtcal.finder import evidence as densities
from rtcal.finder import plan
from rtcal.finder.claim import Reason
from rtcal.finder.effects import checked_effects
from rtcal.finder.means.planning import COSTS, Information, extended, possible
from rtcal.finder.means.problem import Moments
from rtcal.report.finding_words import CHECKS
from tests.test_several_effects import BOTH, case_with, compared


def two(apart, correlation=0.0):
    """Two hypotheses whose second feature differs by so many standard deviations."""
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    return Moments(
        np.array([[0.0, 0.0], [0.0, apart]]),
        np.stack([covariance, covariance]),
        np.zeros((2, 0, 2)),
    )


@pytest.fixture
def normal(monkeypatch):
    """Normal densities, for which the information is an integral."""
    monkeypatch.setattr(densities, "DEGREES", np.inf)


SECOND = np.array([False, True])
FIRST = np.array([True, False])


@pytest.mark.usefixtures("normal")
@pytest.mark.parametrize("apart", [0.0, 1.0, 2.0, 8.0])
def test_information_is_the_mutual_information(apart):
    half = np.full(2, 0.5)
    about = Information(two(apart), half, np.arange(2), np.zeros(2, dtype=bool))

    def entropy(y):
        p = norm.pdf(y), norm.pdf(y, apart)
        q = p[0] / sum(p)
        return sum(p) / 2 * -sum(x * np.log(x) for x in (q, 1 - q) if x > 0)

    left = quad(entropy, -8, 8 + apart, limit=200)[0]
    assert about.entropy() == pytest.approx(np.log(2))
    assert about.of(SECOND) == pytest.approx(np.log(2) - left, abs=0.06)


@pytest.mark.usefixtures("normal")
def test_what_is_measured_already_says_the_noise_of_what_is_to_come():
    """A feature without news of its own cancels the error that the next has in common with it."""
    half, values = np.full(2, 0.5), np.zeros(1)
    of = [
        Information(two(1.0, r), half, np.arange(2), FIRST, values).of(SECOND) for r in (0.0, 0.95)
    ]
    assert of[1] > 2 * of[0]
    nothing = Information(two(1.0), half, np.arange(2), FIRST, values)
    assert nothing.of(FIRST) == 0.0


def test_the_model_s_error_of_a_further_configuration_is_that_of_the_first():
    c = compared(*BOTH)
    further = possible(c.case)
    whole, measured, masks = extended(c, further)
    error = whole.discrepancy
    n, size = len(whole.case.configurations), len(c.discrepancy.bias)
    blocks = error.covariance.reshape(n, size, n, size)
    np.testing.assert_allclose(blocks[1, :, 1], c.discrepancy.covariance)
    same = [f.same_error for f in further if f.configuration is not None]
    np.testing.assert_allclose(blocks[1, :, 0], same[0] * c.discrepancy.covariance)
    assert np.linalg.eigvalsh(error.covariance).min() > -1e-12
    # Nothing of the measured configuration is in a further one.
    assert not any((mask & measured).any() for mask in masks)


def test_a_plan_proposes_the_most_information_per_hour_and_then_goes_on():
    case = case_with(*BOTH).only("t20")
    before = plan(case)
    assert [p.per_cost for p in before.proposals] == sorted(
        (p.per_cost for p in before.proposals), reverse=True
    )
    assert before.sequence[0] == before.proposals[0]
    assert len({p.kind for p in before.sequence}) == 3
    assert sum(p.information for p in before.sequence) <= before.uncertainty + 0.05
    assert {p.kind for p in before.proposals} >= {"EDT and T30", "C80", "G", "removed"}
    dear = plan(case, costs=dict.fromkeys(COSTS, 1.0) | {before.proposals[0].kind: 1e6})
    assert dear.proposals[-1].kind == before.proposals[0].kind
    assert "per hour" in str(before)
    assert json.loads(json.dumps(before.to_dict(), allow_nan=False))["sequence"]


def test_each_effect_that_cannot_be_taken_out_has_a_way_to_confirm_it():
    fixed = [e.name for e in checked_effects(None) if not e.removable]
    assert fixed
    assert [name for name in fixed if name not in CHECKS] == []
    assert "rtcal measure" in str(Reason("look it up", {"effect": "noise floor"}))
    assert "look it up" in str(Reason("look it up", {"effect": "an effect of mine"}))
