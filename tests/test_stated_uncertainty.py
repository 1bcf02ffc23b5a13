"""Uncertainties that `rtcal measure --uncertainty` writes: theory, file, and what reads them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.observables import observable
from rtcal.finder import Case, Configuration
from rtcal.finder.means.problem import _uncertainty, observe
from rtcal.io.impulse_responses import with_uncertainty
from rtcal.support.errors import DataError

F = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
PAIRS = [("S1", "R1"), ("S1", "R2"), ("S1", "R3"), ("S1", "R4")]


def measured() -> rt.Measurement:
    rng = np.random.default_rng(3)
    t20 = np.array([1.4, 1.3, 1.2, 1.1, 1.0, 0.8]) * np.exp(0.01 * rng.standard_normal((4, 6)))
    values = {
        "t20": t20,
        "edt": 0.98 * t20,
        "c80": 1.0 + rng.standard_normal((4, 6)),
        "ts": t20 / 14,
    }
    return rt.Measurement(centre_frequencies=np.array(F), values=values, pairs=PAIRS)


def hall() -> rt.Room:
    return rt.Room(
        name="hall",
        volume=400.0,
        materials=["plaster"],
        areas=[340.0],
        alpha=np.full((1, 6), 0.15),
        sigma=np.full((1, 6), 0.05),
        centre_frequencies=F,
    )


def test_c80_of_decaying_noise_scatters_as_theory_says() -> None:
    rate, time, rng = 4000, 1.0, np.random.default_rng(5)
    t = np.arange(int(1.5 * rate)) / rate
    noise = np.fft.rfft(rng.standard_normal((600, len(t))))
    frequency = np.fft.rfftfreq(len(t), 1 / rate)
    noise[:, (frequency < 500 / np.sqrt(2)) | (frequency > 500 * np.sqrt(2))] = 0
    energy = (np.fft.irfft(noise, len(t)) * np.exp(-3 * np.log(10) * t / time)) ** 2
    early = t < 0.08
    c80 = 10 * np.log10(energy[:, early].sum(1) / energy[:, ~early].sum(1))
    (theory,) = observable("c80").scatter(np.array([500.0]), np.array([time]))
    assert c80.std() == pytest.approx(theory, rel=0.12)


@pytest.mark.parametrize("name", ["uncertainty", "common_uncertainty"])
@pytest.mark.parametrize(("parameter", "value"), [("t20", 5.0), ("t20", 1e300), ("c80", 500.0)])
def test_an_uncertainty_above_the_value_is_refused(name: str, parameter: str, value: float) -> None:
    m = measured()
    shape = (4, 6) if name == "uncertainty" else (6,)
    stated = replace(m, **{name: {parameter: np.full(shape, value)}})
    said = rf"{name}\[{parameter}, 125 Hz\] = .* is too large for an uncertainty of "
    with pytest.raises(DataError, match=said):
        Configuration(name="measured", measured=stated)
    with pytest.raises(DataError, match=said):
        rt.calibrate(hall(), stated)


def test_a_part_in_common_that_stands_alone_is_taken() -> None:
    m, common = measured(), np.full(6, 0.2)
    alone = replace(m, common_uncertainty={"t20": common})
    assert alone.mean_uncertainty("t20") == pytest.approx(
        np.hypot(m.mean_uncertainty("t20"), common)
    )
    relative = common / m.mean("t20")
    own, shared, _ = _uncertainty(alone, "t20")
    assert shared == pytest.approx(relative)
    assert own == pytest.approx(_uncertainty(m, "t20")[0])


def test_what_is_common_does_not_average_out() -> None:
    stated = with_uncertainty(measured())
    spread = stated.values["t20"].std(0, ddof=1) / 2
    own = np.sqrt((stated.uncertainty["t20"] ** 2).sum(0)) / 4
    expected = np.hypot(np.maximum(own, spread), stated.common_uncertainty["t20"])
    assert stated.mean_uncertainty("t20") == pytest.approx(expected)
    assert (stated.mean_uncertainty("t20") > stated.common_uncertainty["t20"]).all()


def test_the_finder_takes_what_is_written_as_what_it_would_have_made() -> None:
    def seen(m: rt.Measurement) -> tuple[np.ndarray, str]:
        case = Case(room=hall(), configurations=[Configuration(name="A", measured=m)])
        observed, _ = observe(case.only("t20", "edt"))
        return np.sqrt(np.diag(observed.covariance)), str(observed.origin)

    made, written = seen(measured()), seen(with_uncertainty(measured()))
    assert "none is given" in made[1]
    assert written[1] == "The uncertainty of T20 and EDT is as given."
    # ISO 3382-2 counts an integrated response as ten decays: 9 % more than one decay's theory.
    assert written[0] == pytest.approx(made[0], rel=0.1)


def test_measure_writes_them(tmp_path: Path) -> None:
    pytest.importorskip("pyrato")
    pyfar = pytest.importorskip("pyfar")
    from click.testing import CliRunner

    from rtcal.command.main import cli

    rng = np.random.default_rng(1)
    t = np.arange(48000) / 48000
    decay = rng.standard_normal(len(t)) * np.exp(-6.9 * t / 0.6) + 1e-6 * rng.standard_normal(
        len(t)
    )
    path = str(tmp_path / "S1_R1.wav")
    pyfar.io.write_audio(pyfar.Signal(decay / np.abs(decay).max(), 48000), path)
    out = str(tmp_path / "t.csv")
    result = CliRunner().invoke(cli, ["measure", path, "--uncertainty", "--out", out])
    assert result.exit_code == 0, result.output
    again = rt.Measurement.from_file(out)
    assert np.isfinite(again.uncertainty["t20"]).any()
    assert set(again.common_uncertainty) >= {"t20", "edt", "c80"}
