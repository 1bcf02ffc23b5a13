"""Decay parameters against exact exponentials, against pyrato, and against what they must refuse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rtcal as rt
from rtcal.acoustics import observables
from rtcal.acoustics.marks import bent_decays
from rtcal.acoustics.observables import observable
from rtcal.support.errors import DataError, TooShortError


def exponential(t, width=0.0001, length=1.5):
    """Energy per bin of a pure exponential decay, ``length`` reverberation times long."""
    return 10 ** (-6 * np.arange(round(length * t / width)) * width / t)


@given(st.floats(0.1, 8))
def test_exponentials_are_exact(t):
    width = t / 1000
    energy = exponential(t, width, 1.6)
    for name in ("edt", "t20", "t30"):
        # The end at -96 dB lets the curve bend by 4e-7 at -35 dB.
        assert observable(name).value(energy, width) == pytest.approx(t, rel=1e-6)
    rate = 6 * np.log(10) / t
    assert observable("ts").value(energy, width) == pytest.approx(1 / rate, rel=1e-4)


@pytest.mark.parametrize("t", [0.5, 2.0])
def test_clarity_and_definition_of_an_exponential(t):
    energy = np.stack([exponential(t, 1e-4, 2.0)] * 2)
    rate = 6 * np.log(10) / t
    found = observables.parameters(energy, 1e-4)
    assert found["c50"] == pytest.approx(10 * np.log10(np.expm1(0.05 * rate)), abs=1e-6)
    assert found["c80"] == pytest.approx(10 * np.log10(np.expm1(0.08 * rate)), abs=1e-6)
    assert found["d50"] == pytest.approx(-np.expm1(-0.05 * rate), rel=1e-6)
    assert found["ts"].shape == (2,)


def test_a_limit_within_a_bin_counts_in_proportion():
    assert observable("d50").value(np.ones(10), 0.02) == pytest.approx(0.25)


def test_pyrato_agrees_on_a_noisy_decay():
    pyfar = pytest.importorskip("pyfar")
    pyrato = pytest.importorskip("pyrato")
    rate, t = 8000, 0.9
    time = np.arange(2 * rate) / rate
    noise = np.random.default_rng(3).standard_normal(time.size)
    energy = noise**2 * 10 ** (-6 * time / t)
    level = observables.decay_curve_db(energy)
    curve = pyfar.TimeData(10 ** (level / 10), time)
    for name, label in (("edt", "EDT"), ("t20", "T20"), ("t30", "T30")):
        expected = float(
            np.squeeze(pyrato.parameters.reverberation_time_linear_regression(curve, T=label))
        )
        # pyrato takes the points nearest to the range's ends, here those within it: one of thousands.
        assert observable(name).value(energy, 1 / rate) == pytest.approx(expected, rel=1e-3)
    for name, limit in (("c50", 50), ("c80", 80)):
        expected = float(np.squeeze(pyrato.parameters.clarity(curve, limit)))
        assert observables.parameters(energy, 1 / rate)[name] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(("length", "short"), [(0.3, True), (0.6, True), (0.7, False)])
def test_too_short_is_said(length, short):
    energy = exponential(1.0, 1e-4, length)
    assert bool(observable("t20").too_short(energy)) is short
    assert bool(np.isnan(observable("t20").value(energy, 1e-4))) is short
    if not short:  # what the margin lets pass
        assert observable("t20").value(energy, 1e-4) == pytest.approx(1.0, rel=0.004)


def test_a_slow_late_part_is_seen():
    """A double slope whose late part is cut off: the early slope alone would look long enough."""
    time = np.arange(7000) * 1e-4
    energy = 10 ** (-6 * time / 0.5) + 1e-3 * 10 ** (-6 * time / 5)
    assert observable("t20").too_short(energy)


@pytest.mark.parametrize(
    ("second", "error", "said"),
    [
        (exponential(4.0, 1e-4, 0.2), TooShortError, "S to B"),  # not averaged away
        (np.eye(1, 8000)[0], DataError, "too little sound is reflected"),
    ],
)
def test_a_pair_without_a_decay_is_named(second, error, said):
    energy = np.stack([exponential(0.5, 1e-4, 1.6), second])[:, np.newaxis]
    with pytest.raises(error, match=said):
        rt.Measurement.from_decays(energy, 1e-4, np.array([500.0]), [("S", "A"), ("S", "B")])


def test_a_late_part_lost_in_rounding_is_still_a_late_part():
    """As one less the early share it came out below nothing, and C50 as no number."""
    rng = np.random.default_rng(3)
    energy = np.append(rng.random((400, 50)), np.full((400, 1), 1e-18), axis=1)
    expected = 10 * np.log10(energy[:, :50].sum(axis=1) / 1e-18)
    assert observable("c50").value(energy, 1e-3) == pytest.approx(expected, abs=1e-9)
    assert observable("c50").value(energy[:, :50], 1e-3).tolist() == [np.inf] * 400
    assert np.isnan(observable("c50").value(np.zeros(100), 1e-3))


@pytest.mark.parametrize(
    ("energy", "width", "name", "message"),
    [
        ([1, -1.0], 1e-3, "t20", r"energy\[1\] = -1 must be finite"),
        ([1, np.nan], 1e-3, "t20", r"energy\[1\] = nan must be finite"),
        ([], 1e-3, "t20", "at least one bin"),
        ([1, 1], 0.0, "t20", "bin_width = 0 s"),
        ([1, 1], 1e-3, "t60", '"t60" is unknown'),
    ],
)
def test_bad_input(energy, width, name, message):
    with pytest.raises(DataError, match=message):
        observables.parameters(np.array(energy), width, [name])


def test_the_double_slope_of_the_issue_is_bent():
    measured = rt.Measurement.from_values(
        [500, 1000], edt=[0.72, 0.42], t20=[0.73, 0.73], t30=[0.74, 1.01]
    )
    (bent,) = bent_decays(measured)
    assert bent.frequency == 1000
    assert bent.text == "the decay is curved, curvature T30/T20 - 1 = +38 %, EDT/T20 - 1 = -42 %"


def test_straight_decays_are_seldom_flagged():
    """Two standard deviations of a ratio beyond its limit: less than 2 % of straight decays."""
    rng = np.random.default_rng(3)
    time, width, n_rooms = 1.0, 88, 1500  # the octave of 125 Hz, one position
    t = np.arange(int(1.6 * width)) / width
    energy = rng.exponential(1, (n_rooms, len(t))) * 10 ** (-6 * t / time)
    times = observables.parameters(energy, 1 / width, ("edt", "t20", "t30"))
    n_bent = sum(
        bool(
            bent_decays(rt.Measurement.from_values([125], **{p: [v[i]] for p, v in times.items()}))
        )
        for i in range(n_rooms)
    )
    assert n_bent / n_rooms < 0.02
