"""One registry says what each observable is: reading, measuring, fitting and finding ask it."""

import json

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics import observables
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.observables import MODULATIONS, OBSERVABLES, Observable, observable, register
from rtcal.io import impulse_responses, tables
from rtcal.io.impulse_responses import means, with_uncertainty
from rtcal.simulators import ImageSource
from tests.conftest import measurement_of
from tests.test_positions_input import BOX, IN_BOX

WIDTH = 1e-3
NEW = ("d50", "sti")
"""Observables that were added as one file each."""


def exponential(rate, width=WIDTH):
    """A decay of energy at ``rate`` in 1/s, long enough for each observable."""
    return np.exp(-rate * np.arange(int(20 / rate / width)) * width)


@pytest.mark.parametrize("key", OBSERVABLES)
def test_the_linear_scale_is_linear_in_the_absorption(key):
    """The rate of an exponential decay is proportional to the absorption, its energy to 1 / rate."""
    kind = observable(key)
    rates = np.array([8.0, 10.0, 14.0])
    seen = kind.observed(np.array([kind.value(exponential(r, 1e-4), 1e-4) for r in rates]))
    sign = 1 if kind.rises else -1
    assert sign * kind.linear(seen, seen[1]) == pytest.approx(rates / 10 - 1, abs=2e-3)
    step = 1e-4
    slope = (kind.linear(seen + step, seen[1]) - kind.linear(seen - step, seen[1])) / (2 * step)
    assert kind.linear_slope(seen, seen[1]) == pytest.approx(slope, rel=2e-3)


@pytest.mark.parametrize("key", OBSERVABLES)
def test_theory_has_the_scatter_of_one_response(key):
    """Responses are drawn: bins of noise have the relative variance 1 / (B w)."""
    kind, band, time = observable(key), np.array([1000.0]), 0.8
    decay_of = exponential(6 * np.log(10) / time)
    rng = np.random.default_rng(1)
    shape = 2 * 710.0 * WIDTH / 2  # degrees of freedom of a bin, over two
    drawn = decay_of * rng.gamma(shape, 1 / shape, (600, decay_of.size))
    seen = kind.observed(kind.value(drawn, WIDTH))
    (expected,) = kind.scatter(band, np.array([time]))
    assert np.nanstd(seen) == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("key", OBSERVABLES)
def test_thirds_average_and_uncertainties_are_of_a_kind(key):
    kind = observable(key)
    value = kind.natural(np.array([-1.0])) if kind.logarithmic else np.array([0.4])
    assert kind.averaging.inverse(kind.averaging.forward(value)) == pytest.approx(value)
    assert (kind.between_teams(np.array([125.0, 4000.0])) > 0).all()
    assert kind.of_observed(kind.of_value(np.array([0.02]), value), value) == pytest.approx(0.02)
    assert abs(gap_jnd(value + kind.jnd_of(value), value, key)) == pytest.approx(1.0)


def test_sti_is_that_of_iec_60268_16():
    """The MTF of an exponential decay (Houtgast and Steeneken 1973), and the weights of the octaves."""
    time = 1.2
    m = 1 / np.sqrt(1 + (2 * np.pi * MODULATIONS * time / (6 * np.log(10))) ** 2)
    ratio = np.clip(10 * np.log10(m / (1 - m)), -15, 15)
    value = observable("sti").value(exponential(6 * np.log(10) / time), WIDTH)
    assert value == pytest.approx(np.mean((ratio + 15) / 30), abs=1e-4)
    octaves, overall = np.array([125, 250, 500, 1000, 2000, 4000, 8000]), observable("sti").overall
    assert overall(np.ones((2, 7)), octaves) == pytest.approx([1.0, 1.0])
    assert np.isnan(overall(np.ones(6), octaves[1:]))
    rising, falling = np.linspace(0.3, 0.9, 7), np.linspace(0.9, 0.3, 7)
    assert overall(rising, octaves) > overall(falling, octaves) + 0.02  # 2 kHz weighs most
    table = "\n".join(means(rt.Measurement.from_values(octaves, sti=np.full(7, 0.6))))
    assert "STI of all bands: 0.60" in table


def test_new_observables_are_read_and_written(tmp_path):
    table = tables.parse(b"Frequency,D50 [%],STI\n500,48,0.55\n1000,52,0.61\n").measurement
    assert table.values["d50"].tolist() == [[0.48, 0.52]]
    assert table.values["sti"].tolist() == [[0.55, 0.61]]
    table.save(str(tmp_path / "m.csv"))
    again = rt.Measurement.from_file(str(tmp_path / "m.csv"))
    assert again.to_dict() == table.to_dict()
    assert json.loads(json.dumps(table.to_dict()))["values"]["sti"] == [[0.55, 0.61]]
    assert "STI" in repr(table)
    with pytest.raises(rt.errors.DataError, match="STI is a fraction"):
        tables.parse(b"Frequency,STI\n500,55\n")


def test_new_observables_are_measured_with_their_uncertainty():
    pytest.importorskip("pyfar")
    pytest.importorskip("pyrato")
    rate = 8000
    time = np.arange(2 * rate) / rate
    energy = np.exp(-6 * np.log(10) / 1.0 * time)
    found, *_ = impulse_responses.of_energy(energy, rate)
    assert {*found} == {*impulse_responses.MINIMUM_RANGE}
    for key in NEW:
        assert found[key] == pytest.approx(observable(key).value(energy, 1 / rate), abs=2e-3)
    measured = rt.Measurement.from_values([1000], **{k: [v] for k, v in found.items()})
    stated = with_uncertainty(measured)
    for key in NEW:
        (own,), (common,) = stated.uncertainty[key][0], [stated.common_uncertainty[key]]
        assert 0 < own < 3 * observable(key).jnd
        assert 0 < common[0] < observable(key).jnd


def test_an_observable_from_outside_is_simulated():
    """As one file would: registered, it is simulated, fitted and printed."""

    class Late(Observable):
        """Level of the energy after 80 ms in dB."""

        key, label, rank, unit = "l80", "L80", 55, "dB"
        decimals, jnd, limits, doubt = 1, 1.0, (-200.0, 200.0), "check that the value is in dB"
        teams, unknown_error, minimum_range = (1.0,) * 6, 0.5, None

        def value(self, energy, bin_width):
            return 10 * np.log10(energy[..., int(0.08 / bin_width) :].sum(-1))

        def gradient(self, energy, level, bin_width):
            late = np.arange(energy.shape[-1]) >= int(0.08 / bin_width)
            total = energy[..., late].sum(-1, keepdims=True)
            return 10 / np.log(10) * late / total

        def rate(self, observed):
            return -(10 ** (-observed / 10))

    before = dict(OBSERVABLES)
    register(Late)
    try:
        assert list(OBSERVABLES).index("l80") == 1 + list(OBSERVABLES).index("c80")
        seen = ImageSource(room=BOX, duration=1.0, **IN_BOX).observe(BOX.alpha, ("t20", "l80"))
        measured = measurement_of([1000], seen.pairs, l80=seen.natural("l80"))
        assert repr(measured).startswith("<Measurement of L80")
        energy = exponential(10.0)
        by_bin = observables.gradients(energy, WIDTH, ["l80"])[0]
        assert by_bin @ energy == pytest.approx(10 / np.log(10))
    finally:
        OBSERVABLES.clear()
        OBSERVABLES.update(before)
