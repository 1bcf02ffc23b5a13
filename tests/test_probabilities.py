"""The finder's beliefs: priors, probabilities, families, coefficients that are off together."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.room_errors import HANDBOOK_SIGMA
from rtcal.finder import Case, ChangedMaterial, Configuration, library
from rtcal.finder.claim import by_family, conclude
from rtcal.finder.effects import Audience, Opening, People
from rtcal.finder.evidence import SHARPER, log_mixture, prior_of, probability_off
from rtcal.finder.means import problem as bootstrap
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import (
    MeansEvidence,
    draw_null_features,
    observe,
    predict_hypotheses,
    state,
)
from rtcal.finder.model import predict
from rtcal.finder.search import find
from rtcal.support.errors import DataError
from tests.conftest import also, measurement_of, room_of

F = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
ALPHA = np.array([[0.05] * 6, [0.1, 0.15, 0.2, 0.3, 0.35, 0.4], [0.3, 0.2, 0.1, 0.08, 0.07, 0.06]])


def room(sigma=0.3, **more):
    rows = zip([200.0, 80.0, 60.0], ALPHA, sigma * ALPHA, strict=True)
    materials = dict(zip(["plaster", "carpet", "glass"], rows, strict=True))
    return room_of(materials, F, 400, **{"name": "hall", "air": rt.Air(20, 50), **more})


def measured(truth, *, stated=True):
    """Return what a case's model predicts, as a measurement of three parameters."""
    (row,) = predict([state(truth, truth.configurations[0])], np.array([5.0])).features
    t20 = np.exp(row[0])
    times = {"t20": t20, "edt": t20 * np.exp(row[1]), "t30": t20 * np.exp(row[2])}
    values = {k: v[None] for k, v in times.items()}
    return measurement_of(
        np.array(F), u={k: 0.01 * v for k, v in values.items()} if stated else {}, **values
    )


def case_of(model, truth, *, stated=True):
    some = rt.Measurement.from_values(F, t20=np.ones(6))
    made = Case(room=truth, configurations=[Configuration(name="A", measured=some)])
    real = Configuration(name="A", measured=measured(made, stated=stated))
    return Case(room=model, configurations=[real])


def controls(case):
    rng = np.random.default_rng(1)
    shape = (24, len(case.configurations), 5, case.room.n_bands)
    return [ControlRooms(f"engine {i}", 0.01 * rng.standard_normal(shape)) for i in (1, 2)]


def louder():
    """A room whose coefficients are all twice what is stated at 125 Hz, and a third more at 4 kHz."""
    factor = np.geomspace(2.4, 1.6, 6)
    return case_of(room(), room(alpha=np.minimum(ALPHA * factor, 0.95)))


def test_measured_coefficients_are_hardly_off_together():
    assert probability_off(room(HANDBOOK_SIGMA)) == pytest.approx(0.2)
    assert probability_off(room(1.0)) == pytest.approx(0.2)
    assert probability_off(room(0.1)) == pytest.approx(0.2 / 9)
    exact = room(0.0)
    assert probability_off(exact) == 0.0
    assert prior_of(exact, library(), {}).log_probability["coefficients"] == -np.inf


def test_a_mixture_is_the_mean_of_two_densities_also_where_they_round_to_zero():
    one, other = np.array([-1.0, -2.0]), np.array([-3.0, 0.5])
    expected = np.log(0.7 * np.exp(one) + 0.3 * np.exp(other))
    assert log_mixture(one, other, 0.3) == pytest.approx(expected)
    assert log_mixture(one - 1e4, other - 1e4, 0.3) == pytest.approx(expected - 1e4)


def test_probabilities_sum_to_one_and_families_hold_their_members():
    case = louder()
    finding = find(case, controls=controls(case))
    assert sum(finding.probabilities.values()) == pytest.approx(1)
    assert set(finding.not_judged) == {"non-diffuse field"}  # nothing says the room's directions
    assert set(finding.probabilities) | {*finding.not_judged} == {e.name for e in library()} | {
        "none",
        "coefficients",
        "unknown",
    }
    p, families = finding.probabilities, finding.families
    flat, rising, low = (families[f"added absorption, {x}"] for x in ("flat", "rising", "low"))
    assert flat == pytest.approx(p["opening"] + p["furniture"])
    assert rising == pytest.approx(p["audience"] + p["people"] + p["porous"] + p["curtain"])
    assert low == pytest.approx(p["resonator"] + p["membrane"])
    assert families["added absorption"] == pytest.approx(flat + rising + low)
    total = sum(v for k, v in families.items() if k != "added absorption")
    assert total == pytest.approx(1)


def test_what_states_no_uncertainty_gets_it_from_theory_and_reproducibility():
    observed, _ = observe(case_of(room(), room(), stated=False))
    spread = np.sqrt(np.diag(observed.covariance).reshape(3, 6))
    t = observed.features[0, 0]
    one = (
        0.88 * np.sqrt(1 + 1.9 / 10) / np.sqrt(0.71 * np.array(F) * np.exp(t))
    )  # ISO 3382-2, Eq. 4
    # A single value: theory of one decay, and 4.6 % at 125 Hz to 1.3 % at 4 kHz.
    assert spread[0, 0] == pytest.approx(np.hypot(one[0], 0.046), rel=0.05)
    assert spread[0, -1] == pytest.approx(np.hypot(one[-1], 0.013), rel=0.05)
    assert (np.diff(spread[0]) < 0).all()
    assert "none is given" in str(observed.origin)
    stated, _ = observe(case_of(room(), room()))
    assert str(stated.origin) == "The uncertainty of T20, EDT and T30 is as given."


def test_a_stated_climate_is_a_measurement():
    """An error of 10 % of humidity in a large room is no finding; without air stated, air is one."""
    large = {"volume": 8000.0, "areas": [1600.0, 500.0, 300.0], "sigma": 0.02 * ALPHA}
    damp = case_of(room(**large), room(**large, air=rt.Air(20, 60)))
    assert find(damp, controls=controls(damp)).verdict in ("none", "hint")
    dry = case_of(room(**large, air=None), room(**large))
    finding = find(dry, controls=controls(dry))
    assert finding.best_effect == "air"
    assert 10 <= finding.best.parameters["temperature"] <= 33
    sure = replace(damp, climate_uncertainty=(0.1, 0.1))
    assert Case.from_dict(sure.to_dict()).climate_uncertainty == (0.1, 0.1)
    with pytest.raises(DataError, match="climate_uncertainty"):
        replace(damp, climate_uncertainty=(1.0, -1.0))


def test_coefficients_off_together_given_an_effect_follow_bayes():
    stated, off = np.array([-3.0, -1.0, -2.0, -9.0]), np.array([-2.5, -4.0, -0.5, -9.0])
    weights, prior = np.array([1.0, 0.7, 0.3, 0.0]), 0.2
    names = ("none", "air", "air", "air")
    rows = {"none": np.array([0]), "air": np.arange(1, 4)}
    with np.errstate(divide="ignore"):
        problem = Mock(predicted=Mock(names=names, rows=rows, log_weights=np.log(weights)))
    evidence = MeansEvidence(problem, stated, off, np.array(-5.0), prior)
    for name, at in rows.items():
        with_off = prior * (weights[at] @ np.exp(off[at]))
        without = (1 - prior) * (weights[at] @ np.exp(stated[at]))
        expected = with_off / (with_off + without)
        assert evidence.off_given(name) == pytest.approx(expected, rel=1e-12)


def test_a_room_s_coupling_is_claimed_by_its_family():
    effects = {e.name: e for e in library()}
    rough = [name for name, effect in effects.items() if not effect.alone]
    probabilities = {"coupled room": 0.97, "non-diffuse field": 0.02, "none": 0.01}
    families = by_family(probabilities, effects)
    claim = conclude(None, probabilities, families, rough)
    assert (claim.verdict, claim.family) == ("family", "field")
    probabilities = {"opening": 0.97, "none": 0.03}
    families = by_family(probabilities, effects)
    assert conclude(None, probabilities, families, rough).verdict == "named"


def with_levels(*, stated):
    """Two configurations with T20 and C80 as predicted at a distance that is not stated."""
    one = case_of(room(0.02), room(0.02))
    (row,) = predict([state(one, one.configurations[0])], np.array([5.0])).features
    values = {"t20": np.exp(row[0])[None], "c80": row[3][None]}
    spread = {"t20": 0.01 * values["t20"], "c80": np.full((1, 6), 0.3)}
    heard = measurement_of(np.array(F), u=spread if stated else {}, **values)
    return replace(one, configurations=[Configuration(name=n, measured=heard) for n in "AB"])


def test_distances_that_are_not_stated_err_by_configuration_and_in_the_null_rooms():
    case = with_levels(stated=True)
    observed, _ = observe(case)
    applied = predict_hypotheses(case, []).applied
    shape = (*observed.used.shape, *observed.used.shape)
    by_distance = applied.reshape(shape)
    assert (by_distance[0, 3, :, 0, 3] > 0).all()  # C80 of one configuration
    assert (by_distance[0, :, :, 1] == 0).all()  # another place in the other
    errors = [np.zeros((20, *observed.used.shape))]
    c80 = np.nonzero(observed.used)[1] == 3
    spread = []
    for covariance in (applied, 0 * applied):
        rng = np.random.default_rng(1)
        values = draw_null_features(case, observed, covariance, errors, rng, 4000)
        spread.append(values[:, c80].var(0).mean())
    distance = np.diag(applied)[observed.used.ravel()][c80].mean()
    assert spread[0] - spread[1] == pytest.approx(distance, rel=0.3)


def test_what_a_changed_material_moves_is_uncertain_as_an_effect_is():
    one = with_levels(stated=True)
    first, second = one.configurations
    covered = ChangedMaterial(np.full(6, 0.6), np.full(6, 0.02))
    name = one.room.materials[0]
    third = replace(second, name="C", changes={name: covered})
    configurations = [first, replace(second, changes={name: covered}), third]

    def applied(covered):
        case = replace(one, configurations=covered)
        shape = (len(covered), 5, 6)
        return predict_hypotheses(case, []).applied.reshape(shape * 2)

    more = applied(configurations) - applied([replace(c, changes={}) for c in configurations])
    case = replace(one, configurations=configurations)
    features = predict_hypotheses(case, []).features[0]
    moved = features[1, 0] - features[0, 0]  # ln T20
    assert (more[0] == 0).all()  # nothing was changed in the first
    own = np.einsum("kk->k", more[1, 0, :, 1, 0]) / moved**2
    np.testing.assert_allclose(own, 2 * 0.106**2)
    # Two bands, and two configurations with the same change, share half of it.
    np.testing.assert_allclose(more[1, 0, 0, 1, 0, 1], 0.106**2 * moved[0] * moved[1])
    np.testing.assert_allclose(more[1, 0, 2, 2, 0, 2], (0.106 * moved[2]) ** 2, rtol=1e-3)
    # The decay's shape changes, too: half common to the bands.
    edt = np.einsum("kk->k", more[1, 1, :, 1, 1])
    shape = features[1, 1] - features[0, 1]
    np.testing.assert_allclose(edt, (0.12 * moved) ** 2 + 2 * (0.106 * shape) ** 2)


@pytest.mark.parametrize(
    "case",
    [case_of(room(0.02), room(0.02)), with_levels(stated=True), with_levels(stated=False)],
    ids=["no levels", "stated", "not given"],
)
def test_the_smallest_threshold_is_the_same_for_all_data(case, monkeypatch):
    monkeypatch.setattr(bootstrap, "QUANTILE", 0.0)  # so that the smallest threshold decides
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, [Opening()])
    prior = prior_of(case.room, [Opening()], {})
    scores = bootstrap.null_scores(case, observed, predicted, controls(case), prior)
    assert (bootstrap.thresholds(scores) == 0).all()


def test_of_the_null_rooms_one_in_twenty_exceeds_a_threshold():
    rng = np.random.default_rng(0)
    both = rng.multivariate_normal([1.0, 2.0], [[1.0, 0.6], [0.6, 1.0]], 4000)
    values = bootstrap.thresholds(both)
    assert np.mean((both > values).any(1)) == pytest.approx(0.05, abs=0.001)
    each = np.mean(both > values, axis=0)
    np.testing.assert_allclose(each, each.mean(), atol=0.001)  # at one level
    alone = bootstrap.thresholds(both[:, :1])
    assert alone == pytest.approx(max(np.quantile(both[:, 0], 0.95), 0.0), abs=1e-3)
    assert (bootstrap.thresholds(both - 10) == bootstrap.MINIMUM).all()


def test_data_that_say_nothing_do_not_hide_what_t20_detects():
    """C80 that fits worse than assumed takes every error for larger, that of T20, too."""
    first = with_levels(stated=True).configurations[0].measured
    up_and_down = 4.0 * (-1.0) ** np.arange(6)  # from band to band, as no effect changes it
    values = {"t20": 0.95 * first.values["t20"], "c80": first.values["c80"] + up_and_down}
    heard = Configuration(name="A", measured=replace(first, values=values))
    case = replace(with_levels(stated=True), configurations=[heard])
    tried = {"effects": [Opening()], "without": ["unknown"], "controls": controls(case)}
    assert find(case.only("t20"), **tried).detected
    whole = find(case, **tried)
    assert whole.score < whole.threshold
    assert whole.detection.deciding == "T20"
    assert "(only T20, as all data give lower odds)" in " ".join(str(whole).split())
    # All data leave nothing a fair part of the probability, which makes it a hint.
    assert whole.verdict == "hint"
    assert whole.reasons[0].code == "nothing likely"


def test_people_are_objects_and_an_audience_covers_floor():
    case = case_of(room(), room())
    before = state(case, case.configurations[0])
    people = People().change(before, {"persons": 20.0})
    # Vorländer (2008): 0.72 and 1 person per m² have alpha 0.65 and 0.80 at 1 kHz.
    each = (people.objects - before.objects)[3] / 20
    assert each == pytest.approx(np.mean([0.65 / 0.72, 0.80]), abs=0.01)
    assert (people.areas == before.areas).all()
    seated = Audience().change(before, {"absorption_area": 20.0})
    assert np.array_equal(seated.objects, before.objects)
    both = {e.name: e for e in library()}
    assert both["people"].family == both["audience"].family
    assert both["people"].odds + both["audience"].odds == 1  # as one effect before


@pytest.mark.parametrize(
    ("sigma", "power"),
    [(0.03, 1 + 0.9 * SHARPER), *also((0.3, 1.0), (0.6, 1.0), (0.15, 1 + SHARPER / 2))],
)
def test_probabilities_are_sharper_where_coefficients_were_measured(sigma, power):
    """Odds of two effects: evidence times prior, to a power that grows towards a sigma of 0."""
    case = case_of(room(sigma), room())
    finding = find(case, controls=controls(case))
    names = ["none", "volume", "opening", "noise floor"]
    prior = finding.prior.log_probability
    nats = np.array([finding.evidence.get(n, 0.0) + prior[n] for n in names])
    stated = np.log([finding.probabilities[n] for n in names])
    np.testing.assert_allclose(np.diff(stated), power * np.diff(nats), rtol=1e-9)
    assert sum(finding.probabilities.values()) == pytest.approx(1)
