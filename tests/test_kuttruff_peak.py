"""Calibrations near the mean coefficient up to which Kuttruff's equation holds."""

import json

import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.support.errors import InfeasibleError
from tests.conftest import also, room_of

KUTTRUFF = rt.Kuttruff()
PEAK = KUTTRUFF.largest_mean


def room(mean, sigma=0.2, **more):
    materials = {"wall": (90, mean, sigma), "floor": (40, mean, sigma)}
    return room_of(materials, [500, 1000][: len(mean)], air=rt.Air(), **more)


def at_mean(given, mean):
    return KUTTRUFF.time(given, np.full(given.n_bands, mean * given.total_area))


def test_tolerance_beyond_the_peak_ends_at_the_peak():
    """The prior lies beyond the measured T and within the tolerance: nothing has to move."""
    given = room([0.9])
    t = 1.02 * at_mean(given, PEAK)
    exact = rt.calibrate(given, t, equation=KUTTRUFF)
    assert (given.areas @ exact.alpha)[0] < 0.9 * given.total_area
    within = rt.Calibration(terms.PriorDeviation(), [terms.MatchWithin(1.0)])
    result = within.build(given, KUTTRUFF).solve(t)
    np.testing.assert_allclose(result.alpha, given.alpha, rtol=0, atol=1e-12)


@pytest.mark.parametrize("unreachable", ["raise", "nearest"])
def test_prior_beyond_the_peak_has_no_time_before_and_everything_else(unreachable):
    given = room([0.93, 0.3])
    t = np.array([at_mean(given, 0.8)[0], 100.0 if unreachable == "nearest" else 0.4])
    result = rt.calibrate(given, t, equation=KUTTRUFF, unreachable=unreachable)
    assert np.isnan(result.reverberation_time_before[0])
    assert np.isnan(result.gap_before[0])
    assert np.isfinite(result.gap_before[1])
    assert result.gap_after[0] == pytest.approx(0, abs=1e-9)
    assert json.loads(result.to_json())["reverberation_time_before"][0] is None
    assert "T of the input cannot be calculated at 500 Hz" in " ".join(str(result).split())
    assert len(result.unreachable) == (unreachable == "nearest")


@pytest.mark.parametrize("unreachable", ["raise", "nearest"])
def test_bounds_that_lie_beyond_the_peak_are_named(unreachable):
    given = room([0.93], alpha_min=np.full((2, 1), 0.925))
    with pytest.raises(InfeasibleError, match=r"500 Hz: with these bounds .* is at least 0\.925"):
        rt.calibrate(given, at_mean(given, 0.5), equation=KUTTRUFF, unreachable=unreachable)


NEAR = [1e-2, 1e-13, *also(0.5, 0.1, 1e-3, 1e-5, 1e-9)]
UNCERTAIN = {
    "climate": {"climate_sigma": (2, 10)},
    "temperature": {"climate_sigma": (5, 0)},
    "volume and areas": {"volume_sigma": 0.05, "area_sigma": 0.03, "common_area_sigma": 0.02},
    "nothing": {},
}


@pytest.mark.parametrize("method", ["mle", "lse", "soft", "smooth", "robust"])
@pytest.mark.parametrize("uncertain", UNCERTAIN)
@pytest.mark.parametrize("below", NEAR)
def test_near_the_peak_there_is_an_answer_for_every_method(below, uncertain, method):
    """The closer to the peak, the less T determines the absorption; the other band is as it was."""
    given = room([0.6, 0.3], **UNCERTAIN[uncertain])
    peak = KUTTRUFF.exponent_of_time(given, at_mean(given, PEAK))[0]
    exponent = np.array([peak * (1 - below), 0.4])
    t = KUTTRUFF._time(given, given.total_area * exponent)
    result = rt.calibrate(given, t, method, KUTTRUFF)
    assert np.isfinite(result.alpha).all()
    assert np.isfinite(result.posterior_sigma).all()
    assert str(result)
    other = rt.calibrate(given, t, method, KUTTRUFF, solver="osqp")
    np.testing.assert_allclose(other.alpha, result.alpha, rtol=0, atol=1e-8)


def test_band_without_time_beyond_the_peak_has_no_time_after():
    given = room([0.93, 0.3])
    result = rt.calibrate(given, [np.nan, 0.4], equation=KUTTRUFF)
    assert np.isnan(result.reverberation_time_after[0])
    assert np.isnan(result.air_share[0])
    assert str(result)
    assert result.to_json()
