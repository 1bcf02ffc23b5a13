"""Values that are legal but wrong by a unit: refused with what they look like, or marked where odd."""

from functools import partial

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import agreement, plausibility
from rtcal.acoustics.priors import SigmaRule, sigma_iso_12999_2
from rtcal.calibration.terms import SoftMatch
from rtcal.loop.closed import start
from rtcal.studies import analytic_scores
from rtcal.support.errors import RtcalError
from tests.test_robustness import room as usual

room = partial(usual, sigma=[[0.02, 0.02], [0.05, 0.05]])


def test_bands_between_the_nominal_ones_stay_as_they_are():
    """Twelfths of an octave, and a band of its own far from every third."""
    for f in ([106, 112, 118, 125, 132], [440.0, 1000], [124.9, 251.2]):
        kept = rt.Measurement.from_values(f, t20=np.ones(len(f))).centre_frequencies
        np.testing.assert_allclose(kept, f, rtol=0.015)


def measured(**values):
    return rt.Measurement.from_values([500, 1000], **values)


REFUSED = [
    (lambda: room(centre_frequencies=[0.5, 1]), "0.5, 1 is probably in kHz"),
    (lambda: room(centre_frequencies=[120, 250]), r"120 Hz, which is not .* nearest is 125 Hz"),
    (lambda: rt.Air(20, 0.417), r"humidity = 0.417 % looks like a fraction; write humidity = 41.7"),
    (lambda: room(sigma=[[2, 2], [5, 5]]), r'sigma\["a", 500 Hz\] = 2 .* If it is in percent'),
    (lambda: room(sigma=[[1e160, 0.1], [0.1, 0.1]]), r"1e\+160 must be from 0 to 1"),
    (lambda: SoftMatch(relative=30), "relative = 30 .* at most 1. If it is in percent"),
    (lambda: rt.calibrate(room(), measured(t20=[900, 800])), r"T20\[500 Hz\] = 900 s"),
    (lambda: rt.compare(measured(t30=[90, 60]), measured(t30=[80, 190])), r"T30\[1000 Hz\] = 190"),
    (lambda: measured(ts=[80, 70]), r"ts, 500 Hz\] = 80 must be from 0 to 10 s; check"),
    (lambda: measured(d50=[50, 60]), "= 50 must be from 0 to 1; D50 is a fraction"),
    (lambda: measured(c80=[500, 1]), "= 500 must be from -200 to 200 dB; check that the value"),
    (lambda: room(alpha=[[10, 20], [30, 20]], above_one="clip"), r'alpha\["a", 500 Hz\] = 10'),
    (lambda: SigmaRule().sigma([0.1, 2, -3], [1, 2, 3]), "alpha has -3, but a coefficient"),
    (lambda: sigma_iso_12999_2([0.1, 0.2], [500, 1000, 2000]), "its last axis must have 3 values"),
    (lambda: rt.exact.multiplier([0.1, 0.2], [0, 0], [10, 20], 4), "no coefficient of this band"),
    (lambda: analytic_scores([1e300, 1e300], 0.05, 10), r"areas\[0\] = 1e\+300 m² must be above 0"),
    (
        lambda: start(room(), measured(t20=[1, 1])).record([[0.1]], measured(t20=[1, 1])),
        r"alpha has shape \(1, 1\)",
    ),
    (lambda: plausibility(np.zeros(2), np.full((2, 2), np.inf), False), "covariance"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[m[:40] for _, m in REFUSED])
def test_a_wrong_unit_is_refused_with_what_it_looks_like(call, message):
    with pytest.raises(RtcalError, match=message):
        call()


def unwrapped(result):
    return " ".join(str(result).split())


def kinds(stated):
    result = rt.calibrate(stated, rt.Eyring().reverberation_time(stated) * 0.9)
    return {m.kind: m.text for m in result.trust_marks}


def test_an_odd_sigma_is_marked():
    assert "wide_sigma" not in kinds(room())
    text = kinds(room(sigma=[[1, 1], [0.05, 0.05]]))["wide_sigma"]
    assert text == 'sigma["a", 500 Hz] = 1 is above 0.5, and 1 more'


def test_dimensions_of_another_volume_are_marked():
    assert "dimensions" not in kinds(room(dimensions=(10, 5, 4.1)))
    stated = room(dimensions=(10, 5, 3))
    assert "the dimensions 10 x 5 x 3 m hold 150 m³" in kinds(stated)["dimensions"]
    result = rt.calibrate(stated, rt.Eyring().reverberation_time(stated))
    assert "volume = 200 m³, but the dimensions" in unwrapped(result)


def test_q_too_small_is_said():
    assert [agreement(p) for p in (None, 0.01, 0.5, 1.0)] == [
        None,
        "contradicts",
        "agrees",
        "too good",
    ]
    exact = rt.calibrate(room(), rt.Eyring().reverberation_time(room()))
    assert agreement(exact.plausibility.p_value) == "too good"
    assert exact.verdict.level == "open"
    stated = room()
    spread = np.sqrt(stated.areas**2 @ stated.sigma**2)
    usual = rt.Eyring().time(stated, stated.absorption_area + 0.8 * spread)
    assert rt.calibrate(stated, usual).verdict.level == "agrees"
