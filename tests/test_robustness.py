"""Ways in which an outsider broke an earlier version; each stays mended."""

import numpy as np
import pytest

import rtcal as rt
from rtcal import studies
from rtcal.calibration.posterior import distribution
from rtcal.support.errors import DataError, InfeasibleError, RtcalError
from tests.conftest import room_of

AIR = rt.Air()


def room(**changes):
    materials = {"a": (100, [0.1, 0.2], 0.1), "b": (120, [0.3, 0.2], 0.1)}
    return room_of(materials, [500, 1000], 200, **{"name": "x", "air": AIR, **changes})


@pytest.mark.parametrize("t", [0.31, 0.37, 0.40, 0.43, 0.52, 0.61])
def test_what_t_alone_determines_has_no_uncertainty_of_rounding(t):
    one = room(materials=["a"], areas=[94], alpha=[[0.3, 0.3]], sigma=[[0.1, 0.1]], volume=60)
    np.testing.assert_array_equal(rt.calibrate(one, [t, t]).room.sigma, 0)


def test_z_is_of_what_t_asks_not_of_the_nearest_end():
    known = room(sigma=[[0.01, 0.01], [0.01, 0.01]], alpha_min=[[0.09, 0.19], [0.29, 0.19]])
    result = rt.calibrate(known, [5.0, 0.75], unreachable="nearest")
    asked = rt.Eyring().target(known, np.array([5.0, 0.75]))
    spread = np.sqrt(known.areas**2 @ known.sigma**2)
    expected = (asked - known.absorption_area) / spread
    np.testing.assert_allclose(result.plausibility.z, expected, rtol=1e-9)
    assert result.plausibility.z[0] < -10
    assert {"unreachable", "implausible"} <= {m.kind for m in result.trust_marks}


def test_a_t_too_short_for_any_equation_is_unreachable():
    with pytest.raises(InfeasibleError, match=r"T\[500 Hz\] = 0.001 s cannot be reached"):
        rt.calibrate(room(air=None), [0.001, 0.7])
    result = rt.calibrate(room(air=None), [0.001, 0.7], unreachable="nearest")
    assert result.reverberation_time_after[0] == pytest.approx(result.unreachable[0].shortest)


def test_areas_and_surfaces_cannot_part():
    walls = [rt.Surface("s", "a", 100.0), rt.Surface("t", "b", 120.0)]
    known = room(surfaces=walls)
    with pytest.raises(DataError, match=r'areas\["a"\] = 200 m², but its surfaces sum to 100 m²'):
        known.replace(areas=known.areas * 2)
    assert known.replace(areas=known.areas * 2, surfaces=()).areas[0] == 200


def test_lse_leaves_alone_what_is_known_exactly():
    known = room(sigma=[[0, 0], [0.1, 0.1]])
    result = rt.calibrate(known, [0.8, 0.9], method="lse")
    np.testing.assert_array_equal(result.alpha[0], known.alpha[0])
    assert np.abs(result.gap_after).max() < 1e-9
    np.testing.assert_array_equal(result.posterior_sigma[0], 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"standard_deviation": {"t20": [0.1, 0.1]}}, "needs the numbers of sources and receivers"),
        ({"n_sources": 0, "n_receivers": 1}, "sources = 0 must be a whole number of at least 1"),
        ({"pairs": [("S", "R")], "n_sources": 2}, "are allowed only in a summary"),
        ({"pairs": [("S", "R", "x")]}, r"give each pair as \[source, receiver\]"),
        ({"pairs": [("#S", "R")]}, "which begins a comment"),
        ({"pairs": [("S\n", "R")]}, "a name must not have control characters"),
        ({"values": {"t20": [["a", "b"]]}}, r"values\[t20\]"),
        ({"values": [1]}, "must be a mapping"),
        ({"uncertainty": {"c80": [[1, 1]]}}, r"uncertainty\[c80\] is given without values\[c80\]"),
    ],
)
def test_measurement(changes, message):
    values = {"centre_frequencies": [500, 1000], "values": {"t20": [[0.8, 0.7]]}}
    with pytest.raises(DataError, match=message):
        rt.Measurement(**{**values, **changes})


def test_a_soft_match_is_not_made_exact_behind_ones_back():
    """Without constraints an exact match is added only where nothing else matches T."""
    room_, measured = rt.datasets.bras_cr2()
    prior, soft = rt.terms.PriorDeviation(), rt.terms.SoftMatch()
    default = rt.Calibration(prior + soft).build(room_).solve(measured)
    stated = rt.Calibration(prior + soft, []).build(room_).solve(measured)
    exact = rt.Calibration(prior).build(room_).solve(measured)
    np.testing.assert_allclose(default.alpha, stated.alpha, rtol=0, atol=1e-12)
    assert np.abs(default.gap_after).max() > 1
    assert np.abs(exact.gap_after).max() < 1e-9


def solved(*more, **given):
    """A composed calibration of the room, with these constraints beside the match."""
    terms = given.pop("objective", rt.terms.PriorDeviation())
    return rt.Calibration(terms, [rt.terms.ExactMatch(), *more]).build(room()).solve([0.8, 0.75])


def study(**given):
    return studies.run([35, 20, 11], 0.05, 3, 3, 1, **given).scores()


HIDDEN = np.ma.array([0.1, 0.2], mask=[False, True])
SMALL = ([0.1, 0.2], [0.1, 0.1], [10, 10], 3.0)
PRIOR = rt.terms.PriorDeviation()


HARD_TO_SEE = [
    (lambda: rt.exact.solve(HIDDEN, *SMALL[1:]), "mu is a masked array with masked entries"),
    (lambda: room(areas=HIDDEN), "areas is a masked array with masked entries"),
    (lambda: rt.calibrate(room(), HIDDEN), "measured is a masked array with masked entries"),
    (lambda: study(workers=1.5), "workers = 1.5 must be a whole number of at least 1"),
    (lambda: rt.terms.PriorDeviation(material_correlation={"a": 1}), "a pair of materials"),
    (lambda: rt.terms.AddedAbsorption("x", ["a"], 1), r'AddedAbsorption\("x"\): gain must be'),
    (lambda: rt.terms.GroupAbsorption("floor", 1), "GroupAbsorption: materials = 'floor'"),
    (lambda: distribution(solved(), 1), "n_samples = 1 must be a whole number of at least 2"),
    (lambda: rt.Eyring().absorption_area(room(), "a"), "T must be an array of real numbers"),
    (lambda: rt.calibrate(room(), [0.8, 0.7], settings={5: 1}), "settings = {5: 1}"),
]


@pytest.mark.parametrize(("call", "message"), HARD_TO_SEE, ids=[m for _, m in HARD_TO_SEE])
def test_what_numpy_would_take_is_named(call, message):
    with pytest.raises(RtcalError, match=message):
        call()


def test_a_room_of_one_surface_is_calibrated_exactly():
    """One unknown and one equation: no error is left, and none of rounding is reported."""
    done = studies.run([35.0], 0.05, 20, 30, seed=1)
    for table in (done.scores(), done.controlled_scores(), studies.analytic_scores([35], 0.05, 99)):
        calibrated = table[table["method"] != "none"]
        np.testing.assert_array_equal(calibrated["aace"], 0)
        np.testing.assert_array_equal(calibrated["score"], 1)
        np.testing.assert_array_equal(table["standard_error"], 0)
        assert table["aace"][0] > 0.04
    spread = done.spread()
    np.testing.assert_array_equal(spread["most"][spread["method"] != "none"], 0)
    two = studies.run([35.0, 0.01], 0.05, 20, 30, seed=1).scores()
    assert (two["aace"] > 0.01).all()


def test_an_effect_of_weight_0_is_named():
    effect = rt.terms.AddedAbsorption("door", [1, 1], 1.0)
    with pytest.raises(rt.errors.ModelError, match=r"AddedAbsorption\(name='door'.* has weight 0"):
        solved(objective=PRIOR + 0 * effect)


def test_a_calibration_that_ignores_t_says_so():
    said = "Nothing in this calibration requires the measured T"
    ignoring = rt.Calibration(PRIOR, []).build(room()).solve([0.8, 0.75])
    assert said in str(ignoring)
    assert not ignoring.matched.any()
    np.testing.assert_array_equal(ignoring.alpha, room().alpha)
    for asking in (
        solved(),
        rt.calibrate(room(), [0.8, 0.75], method="soft"),
        rt.Calibration(PRIOR, [rt.terms.MatchWithin()]).build(room()).solve([0.8, 0.75]),
    ):
        assert said not in str(asking)
        assert asking.matched.all()
    unweighted = rt.Calibration(PRIOR + 0 * rt.terms.SoftMatch(0.05)).build(room())
    assert said in str(unweighted.solve([0.8, 0.75]))


def test_a_raw_answer_at_an_end_is_not_charged_with_what_was_never_asked():
    """Its coefficients are pinned before the solver runs; their multipliers follow from them."""
    known = room(alpha_min=[[0.05, 0.05], [0.1, 0.05]])
    end = rt.Eyring().time(known, known.areas @ known.alpha_min)
    result = rt.calibrate(known, end)
    np.testing.assert_array_equal(result.alpha, known.alpha_min)
    assert result.joint.raw_certificate.worst < 1e-9
    assert np.all(result.raw.z <= 0)
    assert result.raw.y.max() > 1e-3
