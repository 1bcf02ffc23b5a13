"""Finding a missing effect: the model against theory, the evidence against scipy, cases end to end."""

import json
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.stats import chi2, multivariate_normal, multivariate_t

import rtcal as rt
from rtcal.finder import Absorber, Case, Configuration, evidence, plan, recalibrate, verify
from rtcal.finder.claim import MISTAKE
from rtcal.finder.effects import (
    CoupledDecay,
    NoiseFloor,
    NonDiffuse,
    Opening,
    Porous,
    Resonator,
    WrongArea,
    WrongVolume,
    checked_grid,
)
from rtcal.finder.evidence import bounded, leading_products, student, with_columns
from rtcal.finder.means import problem as problem_of_means
from rtcal.finder.means.engines import ControlRooms, recentred
from rtcal.finder.means.problem import (
    MeansProblem,
    estimate_discrepancy,
    evaluate,
    observe,
    predict_hypotheses,
    state,
)
from rtcal.finder.means.recalibration import plain
from rtcal.finder.model import DirectionalDecay, RoomState, predict, sensitivities
from rtcal.finder.positions.problem import LEAST, RATIO, areas_tried
from rtcal.finder.search import find
from rtcal.support.errors import DataError
from tests.conftest import also, room_of

F = 125.0 * 2.0 ** np.arange(7)
AREAS = np.array([60.0, 60.0, 30.0, 50.0])
ALPHA = np.outer([0.1, 0.3, 0.05, 0.2], np.linspace(0.7, 1.2, 7))


def made(**changes):
    base = RoomState(
        volume=300.0,
        areas=AREAS,
        alpha=ALPHA,
        facing=np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float),
        air=np.full(7, 1e-3),
        frequencies=F,
        speed_of_sound=343.2,
    )
    return replace(base, **changes)


def case_with(t20, **more):
    sigma = 0.02 + 0.05 * ALPHA
    materials = dict(zip("abcd", zip(AREAS, ALPHA, sigma, strict=True), strict=True))
    room = room_of(materials, F, 300, name="hall", band_correlation=0.7, air=rt.Air(20, 50))
    values = {k: v[None] for k, v in {"t20": t20, **more}.items()}
    times = ("t20", "edt", "t30")
    u = {k: 0.02 * v if k in times else np.full_like(v, 0.3) for k, v in values.items()}
    measured = rt.Measurement(centre_frequencies=F, values=values, uncertainty=u)
    return Case(room=room, configurations=[Configuration(name="as built", measured=measured)])


def controls_of(case, spread=0.02):
    """Reference rooms without an engine: what the model errs by, drawn."""
    rng = np.random.default_rng(1)
    shape = (40, len(case.configurations), 5, case.room.n_bands)
    scale = np.array([1, 1, 0.7, 20, 20])[:, None] * spread
    return [ControlRooms(name, scale * rng.standard_normal(shape)) for name in ("one", "other")]


def alpha_covariance(predicted, i):
    """J Sigma J' of one hypothesis, over all features raveled."""
    slopes = predicted.slopes[i]
    count, kinds, n = slopes.shape
    variance = predicted.log_time_errors(slice(i, i + 1))[0].reshape(count, n, count, n)
    full = np.einsum("afk,akbl,bgl->afkbgl", slopes, variance, slopes)
    return np.asarray(full.reshape(count * kinds * n, -1))


def test_the_state_is_the_equation():
    case = case_with(np.ones(7))
    for name in ("eyring", "sabine", "millington"):
        one = state(replace(case, equation=name), case.configurations[0])
        equation = getattr(rt, name.capitalize())()
        np.testing.assert_allclose(
            6 * np.log(10) / one.rate, equation.reverberation_time(case.room), rtol=1e-12
        )


@pytest.mark.parametrize("equation", ["eyring", "sabine", "millington", "kuttruff"])
def test_sensitivity_is_the_derivative_of_the_rate(equation):
    base = made(equation=equation)
    for i in range(4):
        alpha = ALPHA.copy()
        alpha[i] += 1e-6
        slope = (made(equation=equation, alpha=alpha).rate - base.rate) / 1e-6
        np.testing.assert_allclose(sensitivities([base])[0, i], slope, rtol=1e-4)


def test_one_exponential_has_no_shape_and_a_known_level():
    one = predict([made()], np.array([6.0])).features[0]
    np.testing.assert_allclose(np.exp(one[0]), 6 * np.log(10) / made().rate, rtol=1e-12)
    np.testing.assert_array_equal(one[1:3], 0)
    t = np.exp(one[0])
    # Barron and Lee 1988, with 31200 rounded from 4 pi 100 c / (6 ln 10): 0.6 % of a level of 4.3 dB.
    direct, late = 100 / 36, 31200 * t / 300 * np.exp(-0.04 * 6 / t)
    np.testing.assert_allclose(one[4], 10 * np.log10(direct + late), atol=0.05)
    share = np.exp(-1.11 / t)
    np.testing.assert_allclose(
        one[3], 10 * np.log10((direct + late * (1 - share)) / (late * share)), atol=0.08
    )


def test_coupled_rooms_follow_their_energy_balance():
    one = made()
    decay = CoupledDecay.together([one], [CoupledDecay(10.0, 500.0, 0.05)])
    c, s1 = 343.2, one.covered(10.0, np.ones(7)).rate
    band = 2
    a2 = -np.log1p(-0.05) * 6 * 500 ** (2 / 3) + 4 * 1e-3 * 500 + 10
    back = c * 10 / 4

    balance = [[-s1[band], back / 300], [back / 500, -c * a2 / (4 * 500)]]
    t = np.linspace(0, 2, 50)
    solved = np.array([expm(np.multiply(balance, at))[0, 0] / 300 for at in t])
    weights, rates = decay.weights[0, band], decay.rates[0, band]
    np.testing.assert_allclose((weights * np.exp(-np.outer(t, rates))).sum(1), solved, rtol=1e-5)


def test_a_field_that_scatters_is_diffuse_and_one_that_does_not_decays_by_direction():
    even = predict([made()], np.array([6.0])).features[0]
    much = predict([made(shape=DirectionalDecay(50.0))], np.array([6.0])).features[0]
    np.testing.assert_allclose(much[:3], even[:3], atol=0.02)
    little = predict([made(shape=DirectionalDecay(0.02))], np.array([6.0])).features[0]
    assert (little[0] > even[0] + 0.1).all()  # the directions that see little absorption last
    assert (little[1] < -0.05).all()  # ... and the early decay is that of the others
    assert (little[2] > 0.01).all()


def test_noise_lengthens_what_is_read_low_in_the_decay():
    quiet, loud = (
        predict([made(floor_db=level)], np.array([6.0])).features[0] for level in (-120.0, -55.0)
    )
    np.testing.assert_allclose(
        quiet[:3], predict([made()], np.array([6.0])).features[0, :3], atol=1e-4
    )
    # By hand, band 500 Hz: exp(-kt) + N (t_end - t).
    k = made().rate[2]
    t = np.linspace(0, 2 * 6 * np.log(10) / k, 40001)[:-1]
    left = np.exp(-k * t) / k + 10**-5.5 * (t[-1] + t[1] - t)
    level = 10 * np.log10(left / left[0])
    t20, edt, t30 = (
        -60 / np.polyfit(t[here], level[here], 1)[0]
        for low, high in ((-5, -25), (0, -10), (-5, -35))
        for here in [(level <= low) & (level >= high)]
    )
    np.testing.assert_allclose(loud[:3, 2], np.log([t20, edt / t20, t30 / t20]), atol=2e-3)
    assert loud[2, 2] > 0.01


def test_porous_is_miki_s_layer():
    d, sigma = 0.05, 12e3

    def alpha(f):
        x = f / sigma
        z = 1 + 0.0699 * x**-0.632 - 0.1071j * x**-0.632
        k = 2 * np.pi * f / 343.2 * (1 + 0.1093 * x**-0.618 - 0.1597j * x**-0.618)
        z = -1j * z / np.tan(k * d)

        def absorbed(a):
            r = (z * np.cos(a) - 1) / (z * np.cos(a) + 1)
            return float((1 - abs(r) ** 2) * np.sin(2 * a))

        top = np.radians(78)
        return float(quad(absorbed, 0, top)[0] / quad(lambda a: np.sin(2 * a), 0, top)[0])

    found = Porous().spectrum(F, {"thickness": d, "flow_resistivity": sigma})
    # The layer's octave is the mean of three frequencies.
    by_hand = [np.mean([alpha(f * 2.0**o) for o in (-0.33, 0, 0.33)]) for f in F]
    np.testing.assert_allclose(found, by_hand, rtol=0.01)
    assert found[0] < 0.2
    assert found[4] > 0.8


def test_a_resonator_peaks_at_its_resonance():
    found = Resonator().spectrum(F, {"resonance": 250.0, "quality": 2.0})
    assert np.argmax(found) == 1
    assert found[1] == pytest.approx(
        0.8 * np.mean([1 / (1 + 4 * (x - 1 / x) ** 2) for x in 2.0 ** np.linspace(-0.45, 0.45, 9)])
    )


def test_evidence_is_the_normal_density():
    t20 = 6 * np.log(10) / made().rate
    case = case_with(1.1 * t20, edt=1.05 * t20, c80=np.linspace(1, 5, 7))
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, [Opening()])
    error = estimate_discrepancy(case, controls_of(case))
    problem = MeansProblem(case, observed, predicted, error)
    got = evaluate(problem, prior_off=0.2)[-1]
    mask = observed.used.ravel()
    for i in (0, 3, 9):
        d = (predicted.features[i] - predicted.features[0]).ravel()[mask]
        covariance = (alpha_covariance(predicted, i) + error.covariance)[np.ix_(mask, mask)]
        # No distances are stated, which leaves C80 open.
        covariance = covariance + observed.covariance
        covariance += predicted.applied[np.ix_(mask, mask)]
        # An opening's error over bands: common, a tilt per octave, and rough; and one per feature.
        bands = np.tile(np.arange(7), 5)[mask]
        lag = np.abs(np.subtract.outer(bands, bands))
        octave = bands - 3.0
        error_over_bands = 0.1**2 + 0.05**2 * np.outer(octave, octave) + 0.05**2 * 0.5**lag
        covariance += np.outer(d, d) * error_over_bands + np.diag((0.106 * d) ** 2)
        # What a change of T20 may do to the ratio of EDT in the same band; T30 was not measured.
        amount = (predicted.features[i] - predicted.features[0])[:, :1]
        bent = 0.12 * amount * (np.arange(5) == 1)[:, None]
        bent = bent.ravel()[mask]
        covariance += 0.5 * (np.outer(bent, bent) + np.diag(bent**2))
        mean = predicted.features[i].ravel()[mask] + error.bias[mask]
        # Student's t with 5 degrees of freedom, scaled to this covariance.
        # 21 features have the power 50 / 71.
        power = 50 / (50 + observed.used.sum())
        expected = power * multivariate_t(mean, 0.6 * covariance, df=5).logpdf(observed.values)
        assert got.stated[i] == pytest.approx(expected, rel=1e-6)
        # Off together: the error that the coefficients have in common is twice or four times as large.
        common = predicted.log_time_errors(slice(i, i + 1))[1][0]
        c, f, b = np.nonzero(observed.used)
        common = common[b] * predicted.slopes[i, c, f, b][:, None]
        both = [
            multivariate_t(mean, 0.6 * (covariance + (s**2 - 1) * common @ common.T), df=5).pdf(
                observed.values
            )
            ** power
            for s in (2, 4)
        ]
        assert got.off[i] == pytest.approx(np.log(0.6 * both[0] + 0.4 * both[1]), rel=1e-6)
    several = evaluate(problem, prior_off=0.2, values=np.stack([observed.values] * 3))[-1]
    np.testing.assert_allclose(several.stated[:, 2], got.stated, rtol=1e-9)
    np.testing.assert_allclose(several.off[:, 2], got.off, rtol=1e-9)
    each = 0.8 * np.exp(got.stated[1:]) + 0.2 * np.exp(got.off[1:])
    assert got.by_effect()["opening"] == pytest.approx(
        np.log(np.exp(predicted.log_weights[1:]) @ each)
    )
    assert np.exp(predicted.log_weights[1:]).sum() == pytest.approx(1)


def test_the_bias_is_the_mean_of_those_who_know_it_and_of_the_model():
    case = case_with(np.ones(7))
    rng = np.random.default_rng(2)
    tracing, images, further = (
        ControlRooms(name, mean + 0.01 * rng.standard_normal((12, 1, 5, 7)))
        for name, mean in (("path tracing", 0.3), ("image sources", 5.0), ("another", 0.6))
    )
    images.errors[0, 0, :, 0] = np.nan  # a band that could not be evaluated there
    own = [np.nanmean(c.errors, axis=0) for c in (tracing, images, further)]
    bias = (own[0] + own[2]) / 3
    error = estimate_discrepancy(case, [tracing, images, further])
    np.testing.assert_allclose(error.bias, bias.ravel(), rtol=1e-12)
    # Between 0, 0.3 and 0.6 lies a variance of 0.09; image sources tell no mean.
    variance = np.diag(error.covariance).reshape(5, 7) / 1.2
    np.testing.assert_allclose(variance[0], 0.09, rtol=0.1)
    np.testing.assert_allclose(variance[4] - 0.5**2, 0.09, rtol=0.1)
    first, moved, third = recentred([tracing, images, further])
    np.testing.assert_array_equal(first.errors, tracing.errors)
    np.testing.assert_allclose(np.nanmean(moved.errors, axis=0), bias, rtol=1e-12)
    np.testing.assert_allclose(moved.errors - bias, images.errors - own[1], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(third.errors, further.errors)


def test_the_prior_s_covariance_is_what_drawn_coefficients_give():
    case = case_with(np.ones(7))
    rng = np.random.default_rng(3)
    lag = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    z = rng.standard_normal((4000, 4, 7)) @ np.linalg.cholesky(0.7**lag).T
    small = 0.1  # of sigma, so that the linear model holds
    moved = ALPHA + small * case.room.sigma * z
    drawn = np.log([made(alpha=alpha, air=np.zeros(7)).rate for alpha in moved])
    dry = replace(case, room=case.room.replace(air=None))
    (variance,), (common,) = predict_hypotheses(dry, []).log_time_errors(slice(0, 1))
    # 4,000 draws: a variance is known to 2.2 %.
    np.testing.assert_allclose(np.cov(drawn.T) / small**2, variance - common @ common.T, rtol=0.12)


def opened(area=15.0):
    room = case_with(np.ones(7)).room
    state = made(air=room.air_attenuation, speed_of_sound=room.speed_of_sound)
    times = 6 * np.log(10) / state.covered(area, np.ones(7)).rate
    return case_with(times, edt=times, t30=times)


def test_an_opening_is_found_added_and_its_alpha_left_alone():
    case = opened(25.0)
    finding = find(case, effects=[Opening()], controls=controls_of(case))
    assert finding.verdict == "named"
    assert finding.effect == "opening"
    assert finding.size.low < 25 < finding.size.high
    seen = verify(finding)
    # The truth is the prior's alpha: plain calibration is off, the corrected one hardly.
    plain_off = np.abs(seen.uncorrected.alpha - ALPHA).max()
    assert plain_off > 0.05
    assert np.abs(seen.corrected.alpha - ALPHA).max() < 0.25 * plain_off
    np.testing.assert_allclose(
        np.exp(seen.uncorrected.features[0, 0]),
        case.configurations[0].measured.mean("t20"),
        rtol=1e-6,
    )
    nothing = find(
        case_with(6 * np.log(10) / made(air=case.room.air_attenuation).rate),
        effects=[Opening()],
        controls=controls_of(case),
    )
    assert nothing.verdict == "none"
    with pytest.raises(DataError, match='verdict "none"'):
        nothing.apply()


def test_added_twice_is_added_once_and_survives_a_file(tmp_path):
    case = opened()
    finding = find(case, effects=[Opening()], controls=controls_of(case))
    corrected = finding.apply().case
    assert finding.with_effects(corrected) is corrected
    (tmp_path / "corrected.json").write_text(corrected.to_json("Do not simulate with it."))
    again = Case.from_file(str(tmp_path / "corrected.json"))
    assert again.to_dict() == corrected.to_dict()
    error = finding.discrepancy
    np.testing.assert_array_equal(
        recalibrate(again, error).alpha, recalibrate(corrected, error).alpha
    )
    assert find(corrected, effects=[Opening()], controls=controls_of(case)).verdict == "none"


def test_geometry_betrays_nothing():
    """A volume and a T that are both x times as large say the same, whatever the areas are."""
    case = opened()
    dry = replace(case, room=case.room.replace(air=None))
    first = dry.configurations[0]
    longer = replace(
        first.measured,
        values={k: 1.3 * v for k, v in first.measured.values.items()},
        uncertainty={k: 1.3 * v for k, v in first.measured.uncertainty.items()},
    )
    large = replace(
        dry,
        room=dry.room.replace(volume=1.3 * dry.room.volume),
        configurations=[replace(first, measured=longer)],
    )
    effects = [Opening(), WrongArea(), WrongVolume()]
    one, other = (find(c, effects=effects, controls=controls_of(c)) for c in (dry, large))
    for name, value in one.evidence.items():
        assert other.evidence[name] == pytest.approx(value, abs=1e-6)


@dataclass(frozen=True)
class Organ(Absorber):
    """An effect of one's own: organ pipes, by a spectrum."""

    name: ClassVar[str] = "organ"

    def spectrum(self, frequencies, parameters):
        return np.interp(frequencies, [125, 500, 8000], [0.6, 0.4, 0.2])


def test_the_plan_knows_what_cannot_be_distinguished():
    case = opened()
    made_plan = plan(case.only("t20"))
    assert made_plan.separations["opening", "coupled room"] < 2.3
    assert made_plan.separations["noise floor", "opening"] > 2.3
    for name in ("furniture", "people"):
        assert made_plan.separations[name, "opening"] < 2.3
    json.dumps(made_plan.to_dict())


def absorbing_room(share, *, alike, shape):
    """An absorber on a share of all surfaces, or its median factor of T in every band."""
    room = opened().room
    soft = np.array([0.1, 0.25, 0.6, 0.9, 0.95, 0.95, 0.95])
    stated = rt.Eyring().reverberation_time(room)
    times = rt.Eyring().time(room, room.areas @ room.alpha + share * room.total_area * soft)
    if alike:
        times = np.exp(np.median(np.log(times / stated))) * stated
    case = case_with(times, **({"edt": times, "t30": times} if shape else {}))
    return find(case, controls=controls_of(case))


@pytest.mark.parametrize("shape", [True, *also(False)])
@pytest.mark.parametrize("share", [0.35, *also(0.25)])
def test_the_same_large_factor_in_every_band_is_no_more_than_a_hint(share, *, shape):
    finding = absorbing_room(share, alike=True, shape=shape)
    assert finding.verdict not in ("named", "family")
    assert finding.reasons[0].code == MISTAKE


def test_surprise_is_chi_square_s():
    case = opened()
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, [Opening()])
    error = estimate_discrepancy(case, controls_of(case))
    times, probability = MeansProblem(case, observed, predicted, error).goodness_of_fit(0)
    mask = observed.used.ravel()
    covariance = alpha_covariance(predicted, 0) + error.covariance
    covariance = covariance[np.ix_(mask, mask)] + observed.covariance
    off = observed.values - predicted.features[0].ravel()[mask] - error.bias[mask]
    square = off @ np.linalg.inv(covariance) @ off
    assert times == pytest.approx(np.sqrt(square / len(off)), rel=1e-9)
    assert probability == pytest.approx(chi2.sf(square, len(off)), rel=1e-9)


def test_bands_without_a_trustworthy_t_are_dropped_and_named():
    case = opened()
    first = case.configurations[0]
    values = {k: v.copy() for k, v in first.measured.values.items()}
    values["t20"][0, 0] = np.nan
    u = {k: v.copy() for k, v in first.measured.uncertainty.items()}
    u["t20"][0, 1] = 0.5 * values["t20"][0, 1]
    worse = replace(first, measured=replace(first.measured, values=values, uncertainty=u))
    observed, notes = observe(replace(case, configurations=[worse]))
    assert not observed.used[0, :, :2].any()
    assert observed.used[0, 0, 2:].all()
    assert any("is left out: it has neither T20" in str(n) for n in notes)
    assert any('250 Hz of "as built" is left out' in str(n) for n in notes)


def test_a_case_too_large_is_refused_before_the_work():
    case = opened()
    (c,) = case.configurations
    heard = [  # each measured anew
        replace(c.measured, values={p: v + 1e-6 * i for p, v in c.measured.values.items()})
        for i in range(48)
    ]
    large = replace(
        case, configurations=[replace(c, name=str(i), measured=m) for i, m in enumerate(heard)]
    )
    for call in (lambda: find(large), lambda: plan(large)):
        with pytest.raises(DataError, match=r"48 configurations have 1008 values.* at most 1000"):
            call()
    fits = replace(large, configurations=large.configurations[:47])
    problem_of_means.check_size(fits, 500)
    with pytest.raises(DataError, match=r"5001 sets of parameters .* at most 5000"):
        problem_of_means.check_size(case, 5001)


# Gauss-Newton steps of a case's calibration where the model's T is far from linear in alpha


def millington_case(time):
    alpha, areas = (0.22, 0.07, 0.68, 0.15, 0.04, 0.06), (40.0, 40.0, 30.0, 30.0, 48.0, 48.0)
    one_soft = {n: (s, a, 0.2 * a) for n, s, a in zip("abcdef", areas, alpha, strict=True)}
    room = room_of(one_soft, [8000], 240, air=rt.Air(20, 50))
    measured = rt.Measurement(centre_frequencies=[8000], values={"t20": [[time]]})
    configuration = rt.finder.Configuration(name="as is", measured=measured)
    return rt.finder.Case(room=room, equation="millington", configurations=[configuration])


@pytest.mark.parametrize("time", [0.35, 0.5, 0.6])
def test_millington_s_pole_at_1_does_not_hide_the_measured_time(time):
    calibrated = plain(millington_case(time))
    assert 0.05 < calibrated.alpha[2, 0] < 1
    np.testing.assert_allclose(np.exp(calibrated.features[0, 0]), time, rtol=0.01)


def test_a_time_that_no_alpha_reaches_gets_the_nearest():
    calibrated = plain(millington_case(9.0))
    np.testing.assert_array_equal(calibrated.alpha, 0)
    assert np.isfinite(calibrated.features[0, 0]).all()


def test_a_time_five_times_as_long_is_matched():
    times = 5 * 6 * np.log(10) / made().rate
    case = case_with(times)
    calibrated = plain(replace(case, room=case.room.replace(air=None)))
    np.testing.assert_allclose(np.exp(calibrated.features[0, 0]), times, rtol=1e-6)


def test_a_band_beyond_reach_spoils_no_other():
    """Steps to ln T with a weight of 1e10 left these T off by up to 1.7 %."""
    case, _ = rt.datasets.hidden_room("identified")
    calibrated = plain(case)
    measured = case.configurations[0].measured.mean("t20")
    times = np.exp(calibrated.features[0, 0])
    np.testing.assert_allclose(times[:5], measured[:5], rtol=1e-9)
    assert (times[5:] < 0.6 * measured[5:]).all()  # the air alone absorbs more
    np.testing.assert_array_equal(calibrated.alpha[:, 5:], 0)


# A size is sought until the evidence falls or physics ends, and a doubt about it leaves the family

FAR = [
    (Opening(), {"area": 75.0}),
    (Porous(), {"area": 75.0, "thickness": 0.06, "flow_resistivity": 12e3}),
    (NonDiffuse(), {"scattering": 0.003}),
    (NoiseFloor(), {"level": -25.0, "record": 2.5}),
    (WrongArea(), {"material": 1.0, "ratio": 5.0}),
]
"""Effects with a size beyond their grids."""


def case_of(effect, theta):
    """Return a case whose measurement is the model's own with the effect in it."""
    room = opened().room
    room = room.replace(alpha=room.alpha * np.array([1.5, 1.5, 0.2, 1.0])[:, None])
    facing = np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float)
    empty = replace(opened(), room=room, facing=facing)
    ln = predict_hypotheses(empty, [effect], [[theta]]).features[1, 0]
    t20 = np.exp(ln[0])
    measured = case_with(t20, edt=t20 * np.exp(ln[1]), t30=t20 * np.exp(ln[2]))
    return replace(empty, configurations=measured.configurations)


@pytest.mark.parametrize(("effect", "theta"), FAR, ids=[effect.name for effect, _ in FAR])
def test_a_size_beyond_the_grid_is_found(effect, theta):
    case = case_of(effect, theta)
    sizes = [t[effect.size] for t in checked_grid(effect, state(case, case.configurations[0]))]
    true = theta[effect.size]
    assert not min(sizes) <= true <= max(sizes)
    finding = find(case, effects=[effect], controls=controls_of(case))
    if effect.name == "area":  # T is 0.29 times the model's in all bands, as by other units
        assert finding.verdict == "hint"
        assert finding.reasons[0].code == MISTAKE
        assert finding.mistake == finding.reasons[0]
    else:
        sure = effect.name in ("porous", "noise floor")
        assert finding.verdict == ("named" if sure else "family"), finding.reasons
    assert finding.best_effect == effect.name
    size = finding.size
    assert not min(sizes) <= size.mean <= max(sizes)
    if size.end:  # the data bound it on one side only
        assert size.low < true if size.end == "least" else true < size.high
        assert size.words.startswith(f"at {size.end} ")
        assert any(size.words in str(reason) for reason in finding.reasons)
    else:
        assert size.low < true < size.high


@pytest.mark.parametrize("area", [0.04, 3.0, 5.0 * LEAST * RATIO**20, 1000.0])
def test_areas_on_a_surface_go_on_to_its_own(area):
    tried = areas_tried(5.0, area)
    assert (len(tried) == 0) == (area < 5.0 * LEAST)
    assert all(area / RATIO * (1 - 1e-12) < last <= area for last in tried[-1:])
    before = np.geomspace(0.05, 1.4, 14) * 5.0
    n = min(len(tried), len(before))
    np.testing.assert_allclose(tried[:n], before[:n], rtol=1e-12)
    assert n == len(before[before <= area * (1 + 1e-12)])


# One evidence: products with factored covariances, and densities, are those of the whole matrices


def test_products_and_determinant_are_those_of_the_whole_matrix():
    rng = np.random.default_rng(0)
    n, m = 4, 9
    root = rng.standard_normal((n, m, 12))
    covariance = root @ root.swapaxes(1, 2)
    rows = rng.standard_normal((n, 5, m))
    ends = [3, 6, 9]
    leading = leading_products(covariance.copy(), rows.copy(), 2, ends)
    for end, products in zip(ends, leading, strict=True):
        part, seen = covariance[:, :end, :end], rows[:, :, :end]
        expected = seen @ np.linalg.solve(part, seen.swapaxes(1, 2))
        half, square, across, inner = products
        np.testing.assert_allclose(half[:, 0], 0.5 * np.linalg.slogdet(part)[1], rtol=1e-12)
        diagonal = np.diagonal(expected, axis1=1, axis2=2)
        np.testing.assert_allclose(square, diagonal[:, :2], rtol=1e-9)
        np.testing.assert_allclose(across, expected[:, 2:, :2], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(inner, expected[:, 2:, 2:], rtol=1e-8, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_is_an_error():
    with pytest.raises(np.linalg.LinAlgError, match="covariance 1 is not positive definite"):
        list(leading_products(np.stack([np.eye(2), -np.eye(2)]), np.zeros((2, 1, 2)), 1, [2]))


def test_the_evidence_of_a_hypothesis_is_the_density_under_its_whole_covariance(monkeypatch):
    rng = np.random.default_rng(1)
    n, draws = 7, 3
    root = rng.standard_normal((n, 9))
    covariance, shift = root @ root.T, rng.standard_normal((4, n, 1))
    left = 3 * rng.standard_normal((n, draws)) - shift  # four hypotheses
    columns = rng.standard_normal((4, n, 2))
    inverse, turned = np.linalg.inv(covariance), columns.swapaxes(1, 2)
    square, half = with_columns(
        np.einsum("hnm,nk,hkm->hm", left, inverse, left),
        0.5 * np.linalg.slogdet(covariance)[1],
        turned @ inverse @ left,
        turned @ inverse @ columns,
    )
    by_student, by_bounded = student(square, half, n), bounded(square, half, n)
    monkeypatch.setattr(evidence, "DEGREES", np.inf)
    monkeypatch.setattr(evidence, "COARSENING", np.inf)
    by_normal = student(square, half, n)
    for h, (residual, own) in enumerate(zip(left, columns, strict=True)):
        whole = covariance + own @ own.T
        normal = multivariate_normal(np.zeros(n), whole).logpdf(residual.T)
        np.testing.assert_allclose(by_normal[h], normal, rtol=1e-9)
        heavy = multivariate_t(np.zeros(n), 0.6 * whole, df=5).logpdf(residual.T)
        np.testing.assert_allclose(by_student[h], 50 / 57 * heavy, rtol=1e-9)
        distance = np.einsum("nm,nm->m", residual, np.linalg.solve(whole, residual))
        constant = 0.5 * n * np.log(2 * np.pi)
        near = distance <= n
        np.testing.assert_allclose(by_bounded[h][near], normal[near] + constant, rtol=1e-9)
        # Beyond, the density with errors as large as the residuals themselves.
        larger = distance[~near] / n
        wider = [
            multivariate_normal(np.zeros(n), s * whole).logpdf(r)
            for s, r in zip(larger, residual.T[~near], strict=True)
        ]
        np.testing.assert_allclose(by_bounded[h][~near], np.array(wider) + constant, rtol=1e-9)
    assert (square > n).any()
    assert (square <= n).any()
