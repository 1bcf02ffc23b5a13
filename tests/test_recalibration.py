"""Gauss-Newton steps of a case's calibration where the model's T is far from linear in alpha."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.means.recalibration import plain
from tests.conftest import room_of
from tests.test_discrepancy import case_with, made


def millington_case(time: float) -> rt.finder.Case:
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
