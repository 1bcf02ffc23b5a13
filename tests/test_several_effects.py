"""Several effects at once: the evidence of sets, their prior, and what is said of each effect."""

from dataclasses import replace
from itertools import combinations
from math import exp, factorial

import numpy as np
import pytest
from scipy.stats import multivariate_t

import rtcal as rt
from rtcal.finder import Case, Configuration, library
from rtcal.finder import evidence as densities
from rtcal.finder.effects import AppliedEffect
from rtcal.finder.evidence import DEGREES, UNKNOWN, prior_of
from rtcal.finder.means import problem
from rtcal.finder.means.problem import (
    MeansProblem,
    Screen,
    acting_order,
    averaged_alpha,
    compare,
    distances,
    estimate_discrepancy,
    evaluate,
    evaluate_sets,
    features_of,
    log_prior,
    moments,
    observe,
    posterior_of_sets,
    predict_hypotheses,
    state,
)
from rtcal.finder.model import FEATURES, predict
from rtcal.finder.search import find
from rtcal.report.finding_words import cautions, details, headline, next_step
from rtcal.support.errors import DataError
from tests.conftest import also, measurement_of, room_of
from tests.test_discrepancy import ALPHA, AREAS, F, alpha_covariance, controls_of
from tests.test_find_with_run import natural

FEW = ("volume", "noise floor", "opening", "air", "coupled room", "unknown")
BOTH = (
    AppliedEffect("volume", {"ratio": 1.3}),
    AppliedEffect("noise floor", {"level": -46.0, "record": 1.5}),
)


def measured(features):
    """Return what a model predicts, as a measurement of a pair at 5 m."""
    values = natural(features)
    spread = {k: 0.01 * v if k in ("t20", "edt", "t30") else 0.2 for k, v in values.items()}
    return measurement_of(
        F,
        u={k: np.broadcast_to(u, (1, 7)).copy() for k, u in spread.items()},
        **{k: v[None] for k, v in values.items()},
    )


def case_with(*effects):
    """A case whose measurement is what the model predicts with the effects in it."""
    materials = zip(AREAS, ALPHA, 0.005 + 0.03 * ALPHA, strict=True)
    of_names = dict(zip("abcd", materials, strict=True))
    room = room_of(of_names, F, 300, name="hall", band_correlation=0.7, air=rt.Air(20, 50))
    nothing = np.array([np.zeros(7)] * len(FEATURES))
    blank = Configuration(name="as built", measured=measured(nothing), distances=np.array([5.0]))
    case = Case(room=room, configurations=[blank])
    features = predict_hypotheses(replace(case, applied=effects), []).features[0, 0]
    return replace(case, configurations=[replace(blank, measured=measured(features))])


def compared(*effects):
    return compared_case(case_with(*effects), library())


def compared_case(case, effects):
    observed, _ = observe(case)
    error = estimate_discrepancy(case, controls_of(case, 0.01))
    return compare(MeansProblem(case, observed, predict_hypotheses(case, effects), error))


def sought(case, only=FEW, **more):
    more = {"most": 3, **more}
    return find(case, only=only, controls=controls_of(case, 0.01), **more)


def test_what_leads_in_place_of_an_effect_that_is_not_judged_is_not_the_next_step():
    """Without directions a second room stands for uneven absorption, too, so these come first."""
    shape = {"aperture": 20.0, "volume": 400.0, "alpha": 0.05}
    case = case_with(AppliedEffect("coupled room", shape))
    only = ("coupled room", "non-diffuse field")
    found = sought(case, only, most=1)
    assert found.best_effect == "coupled room"
    assert next_step(found).startswith("State in which direction")
    (said,) = (c for c in cautions(found) if "coupled room may be" in c)
    assert said not in details(found)
    # Another effect leads in no other's place: the sentence is a detail, the advice as it was.
    other = sought(case_with(AppliedEffect("opening", {"area": 12.0})), ("opening", *only), most=1)
    assert other.best_effect == "opening"
    assert not next_step(other).startswith("State in which direction")
    assert said in details(other)
    assert said not in cautions(other)


def row(c, name, place=3):
    return [i for i, n in enumerate(c.predicted.names) if n == name][place]


def test_the_evidence_of_a_set_is_the_density_with_all_of_it_in_the_model():
    c = compared(*BOTH)
    rows = (row(c, "volume", 13), row(c, "noise floor", 28))
    applied = [AppliedEffect(c.predicted.names[i], c.predicted.parameters[i]) for i in rows]
    together = predict_hypotheses(replace(c.case, applied=applied), [])
    mask = c.observed.used.ravel()
    covariance = alpha_covariance(together, 0)[np.ix_(mask, mask)]
    fixed = c.covariance_of(0)[1]
    covariance = covariance + fixed
    for i in rows:
        covariance += c.covariance_of(i)[1] - fixed
    mean = together.features[0].ravel()[mask] + c.discrepancy.bias[mask]
    shape = covariance * (DEGREES - 2) / DEGREES
    expected = multivariate_t.logpdf(c.observed.values, mean, shape, DEGREES)
    assert evaluate_sets(c, [rows], off=False)[0, 0] == pytest.approx(expected, abs=1e-6)
    assert np.isneginf(evaluate_sets(c, [rows], off=False)[0, 1])


def test_a_set_has_an_error_of_the_direct_sound():
    """Its columns are the change of the features by `DIRECT_SOUND` dB, here by a smaller difference."""
    case = case_with()
    observed, _ = observe(case)
    plain = MeansProblem(
        case,
        observed,
        predict_hypotheses(case, []),
        estimate_discrepancy(case, controls_of(case, 0.01)),
    )
    added = np.diag(compare(plain).predicted.applied - plain.predicted.applied)
    base, at = state(case, case.configurations[0]), distances(case, case.configurations[0])
    levels = [replace(base, direct_db=base.direct_db + d) for d in (0.01, -0.01)]
    up, down = predict(levels, at).features
    change = problem.DIRECT_SOUND * (up - down) / 0.02
    np.testing.assert_allclose(added, change.ravel() ** 2, rtol=0.05, atol=1e-9)
    np.testing.assert_array_equal(features_of(case), features_of(case, far=1.0))


def at_the_points(c):
    """Without the error of what lies between the grid's points."""
    return replace(c, cells=np.zeros_like(c.cells))


def test_a_set_of_one_is_the_single_hypothesis(monkeypatch):
    monkeypatch.setattr(densities, "COARSENING", np.inf)
    c = at_the_points(compared(*BOTH))
    single = evaluate(c, 0.1)[-1]
    rows = [row(c, name) for name in ("opening", "air", "coupled room")]
    sets = evaluate_sets(c, [(i,) for i in rows], off=True)
    np.testing.assert_allclose(sets[:, 0], single.stated[rows], atol=1e-8)
    np.testing.assert_allclose(sets[:, 1], single.off[rows], atol=1e-8)


def test_the_screen_is_the_density_where_effects_add(monkeypatch):
    """The effects have errors smooth over bands; with or without one of them as the base."""
    monkeypatch.setattr(densities, "COARSENING", np.inf)
    monkeypatch.setattr(problem, "SHAPE_CHANGE", (("edt", 0.0), ("t30", 0.0)))
    c = compared(*BOTH)
    smooth = c.predicted.spectrum_errors.copy()
    smooth[:, :, 2:] = 0
    predicted = replace(
        c.predicted, spectrum_errors=smooth, formula_errors=np.zeros(len(c.predicted.names))
    )
    c = replace(c, predicted=predicted)
    i, k = row(c, "volume"), row(c, "opening")
    none = evaluate(c, 0.0)[-1].stated[0]
    first = np.array([i, 0])
    table = Screen(c).pairs(first, np.array([k, 0]))
    assert table[1, 1] == pytest.approx(none, abs=1e-8)
    beside = Screen(c, (i,)).pairs(np.array([k]), np.array([0]))
    assert beside[0, 0] == pytest.approx(table[0, 0], abs=1e-8)


def test_effects_act_in_an_order_in_which_absorbers_see_the_right_equation():
    c = compared()
    order, _ = acting_order(c.case, c.predicted)
    assert order[0] == "formula"
    assert order.index("volume") < order.index("opening")


@pytest.mark.parametrize("most", [1, 2, 3])
def test_the_prior_of_sets_sums_to_one_by_number(most):
    prior = prior_of(case_with().room, library(), {})
    names = [*(e.name for e in library()), UNKNOWN]
    weight = log_prior(prior, names[:-1], 0.7, most)
    poisson = np.array([0.7**n / factorial(n) for n in range(most + 1)])
    for n in range(most + 1):
        total = sum(exp(weight(s)) for s in combinations(names, n))
        assert total == pytest.approx(poisson[n] / poisson.sum())


def test_two_effects_are_named_added_and_alpha_is_left_alone():
    case = case_with(*BOTH)
    found = sought(case)
    assert found.verdict == "named"
    assert set(found.members) == {"volume", "noise floor"}
    assert {"scale", "measurement"} <= {f.split(",")[0] for f in found.named_families}
    assert found.named_set == ("measurement", "scale")
    assert "More than one effect is missing (" in " ".join(headline(found))
    assert "identified sets of groups were right" in " ".join(str(found).split())
    assert repr(found).startswith("<Finding named: ")
    assert sum(found.sets.values()) == pytest.approx(1)
    assert sum(found.family_sets.values()) == pytest.approx(1)
    assert sum(found.numbers) == pytest.approx(1)
    together = found.candidate("volume")
    assert together.low < 1.3 < together.high
    corrected = found.apply().case
    assert [a.name for a in corrected.applied] == list(found.members)
    done = rt.finder.recalibrate(corrected, found.discrepancy)
    plain = rt.finder.recalibrate(case)
    assert np.abs(done.alpha - ALPHA).max() < 0.5 * np.abs(plain.alpha - ALPHA).max()
    assert found.with_effects(corrected).applied == corrected.applied


@pytest.mark.parametrize("effect", [BOTH[0], *also(BOTH[1])], ids=lambda e: e.name)
def test_one_effect_is_not_taken_for_two(effect):
    case = case_with(effect)
    found = sought(case)
    assert set(found.members) == {effect.name}
    assert set(found.named) <= {effect.name}
    assert found.named_set == ()
    assert found.numbers[1] > 0.5


def test_nothing_is_claimed_where_nothing_is_missing():
    case = case_with()
    found = sought(case)
    assert found.verdict == "none"
    assert found.named == found.named_families == ()
    assert found.numbers[0] > 0.5
    assert found.probabilities["none"] > 0.5
    with pytest.raises(DataError, match='verdict "none"'):
        found.apply()


def test_a_family_alone_is_not_called_a_name():
    """The single search says "family" as well."""
    coupled = AppliedEffect("coupled room", {"aperture": 10.0, "volume": 400.0, "alpha": 0.05})
    found = sought(case_with(coupled), ("coupled room", "volume"), most=2)
    assert found.named == ()
    assert found.named_families == ("field",)
    assert found.verdict == "family"


def test_an_unknown_effect_is_said_to_be_unknown():
    """Where the user's odds leave nothing else, no set of the library is called the most probable."""
    found = sought(case_with(*BOTH), ("volume", "noise floor"), prior={UNKNOWN: 1e40}, most=2)
    assert found.verdict == "unknown"
    with pytest.raises(DataError, match='verdict "unknown"'):
        found.apply()


def test_three_effects_are_tried_where_two_do_not_explain_the_measurement():
    air = AppliedEffect("air", {"temperature": 30.0, "humidity": 8.0})
    noise = AppliedEffect("noise floor", {"level": -45.0, "record": 2.0})
    case = case_with(AppliedEffect("volume", {"ratio": 1.7}), air, noise)
    only = ("volume", "air", "noise floor")
    assert set(sought(case, only).members) == {*only}
    assert len(sought(case, only, most=2).members) == 2


def test_odds_of_none_are_those_of_no_effect_against_a_poisson_number():
    """The evidence of sets with one number does not depend on the prior of that number."""
    few, many = (
        sought(case_with(), ("volume", "air"), prior={"none": odds}, most=2).numbers
        for odds in (9.0, 1 / 9)
    )
    ratio = (few[0] / few[1]) / (many[0] / many[1])
    assert ratio == pytest.approx(np.log1p(9) / np.log1p(1 / 9))


def test_what_lies_between_the_points_of_a_grid_is_no_second_effect():
    """The record is 1.5 or 2.5 reverberation times long on the grid."""
    case = case_with(AppliedEffect("noise floor", {"level": -35.0, "record": 2.0}))
    some = ("noise floor", "volume", "coupled room", "opening")
    effects = [e for e in library() if e.name in some]
    c, prior = compared_case(case, effects), prior_of(case.room, effects, {})
    of_two = []
    for each in (c, at_the_points(c)):
        sets = posterior_of_sets(each, prior, most=2).sets
        of_two.append(sum(p for names, p in sets.items() if len(names) == 2))
    assert of_two[0] < 0.05
    assert of_two[1] > 0.08


def test_a_shaded_direct_sound_is_no_second_effect():
    """Furniture between source and receiver: C80 and G are lower than any formula says."""
    furniture = AppliedEffect("furniture", {"absorption_area": 20.0})
    case = case_with(furniture, AppliedEffect("direct sound", {"gain": -6.0}))
    found = sought(case, ("furniture", "volume", "noise floor", "direct sound"))
    assert found.verdict == "named"
    assert found.named_set == ()
    assert found.probabilities["furniture"] > 0.9
    assert found.numbers[2] < 0.5


def test_alpha_is_the_posterior_mean_of_the_linear_model():
    c = compared(BOTH[0])
    near = [abs(p["ratio"] - 1.3) for p in c.predicted.parameters if set(p) == {"ratio"}]
    rows = (row(c, "volume", int(np.argmin(near))),)
    volume = AppliedEffect("volume", dict(c.predicted.parameters[rows[0]]))
    of, _ = moments(c, [rows])
    mask, room = c.observed.used.ravel(), c.case.room
    base = predict_hypotheses(replace(c.case, applied=[volume]), []).features[0].ravel()[mask]
    jacobian = np.empty((mask.sum(), *ALPHA.shape))
    for m, b in np.ndindex(ALPHA.shape):
        alpha = ALPHA.copy()
        alpha[m, b] += 1e-6
        moved = replace(c.case, room=room.replace(alpha=alpha), applied=[volume])
        up = predict_hypotheses(moved, []).features[0].ravel()[mask]
        jacobian[:, m, b] = (up - base) / 1e-6
    lag = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    across = (jacobian * room.sigma) @ (0.7**lag) * room.sigma
    explained = np.linalg.solve(of.covariance[0], c.observed.values - of.mean[0])
    expected = ALPHA + np.tensordot(explained, across, axes=1)
    np.testing.assert_allclose(averaged_alpha(c, [(rows, 1.0)]), expected, atol=1e-6)
    assert np.abs(expected - ALPHA).max() > 1e-4


def test_a_decay_that_the_second_room_decides_can_be_calibrated():
    """T then hardly depends on alpha: its uncertainty over that slope is larger than T."""
    coupled = AppliedEffect("coupled room", {"aperture": 8.0, "volume": 900.0, "alpha": 0.02})
    case = replace(case_with(coupled), applied=[coupled])
    np.testing.assert_allclose(rt.finder.recalibrate(case).alpha, ALPHA, atol=0.01)


def test_a_single_effect_is_a_set_of_one():
    case = case_with(BOTH[0])
    found = find(case, only=FEW, controls=controls_of(case, 0.01))
    assert found.members == ("volume",)
    assert found.numbers[1] == pytest.approx(1 - found.sets[()])
    assert all(found.sets[name,] == found.probabilities[name] for name in found.effects)
    assert found.sets[()] == pytest.approx(
        found.probabilities["none"] + found.probabilities.get("coefficients", 0.0)
    )
    assert sum(p for _, p in found.likely) == pytest.approx(1)
    assert found.alpha.shape == case.room.alpha.shape
    # What is left of the coefficients is little: the effect explains T.
    assert np.abs(found.alpha - ALPHA).max() < 0.05
    after = rt.finder.plan(case, finding=found)
    assert after.proposals
    assert after.uncertainty < 0.5 * rt.finder.plan(case).uncertainty
