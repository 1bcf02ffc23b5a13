"""Uncertainties that `rtcal measure --uncertainty` writes: theory, file, and what reads them."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.datasets.examples import example
from rtcal.finder import Case, Configuration
from rtcal.finder.means.problem import _uncertainty, observe
from rtcal.io.impulse_responses import with_uncertainty
from rtcal.support.errors import DataError
from tests.conftest import room_of, run

F = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
PAIRS = [("S1", "R1"), ("S1", "R2"), ("S1", "R3"), ("S1", "R4")]


def measured():
    rng = np.random.default_rng(3)
    t20 = np.array([1.4, 1.3, 1.2, 1.1, 1.0, 0.8]) * np.exp(0.01 * rng.standard_normal((4, 6)))
    values = {
        "t20": t20,
        "edt": 0.98 * t20,
        "c80": 1.0 + rng.standard_normal((4, 6)),
        "ts": t20 / 14,
    }
    return rt.Measurement(centre_frequencies=np.array(F), values=values, pairs=PAIRS)


def hall():
    return room_of({"plaster": (340.0, 0.15, 0.05)}, F, 400.0, name="hall")


@pytest.mark.parametrize("name", ["uncertainty", "common_uncertainty"])
@pytest.mark.parametrize(("parameter", "value"), [("t20", 5.0), ("t20", 1e300), ("c80", 500.0)])
def test_an_uncertainty_above_the_value_is_refused(name, parameter, value):
    m = measured()
    shape = (4, 6) if name == "uncertainty" else (6,)
    stated = replace(m, **{name: {parameter: np.full(shape, value)}})
    said = rf"{name}\[{parameter}, 125 Hz\] = .* must be at most .* Check that it is not in percent"
    with pytest.raises(DataError, match=said):
        Configuration(name="measured", measured=stated)
    with pytest.raises(DataError, match=said):
        rt.calibrate(hall(), stated)


def test_a_part_in_common_that_stands_alone_is_taken():
    m, common = measured(), np.full(6, 0.2)
    alone = replace(m, common_uncertainty={"t20": common})
    assert alone.mean_uncertainty("t20") == pytest.approx(
        np.hypot(m.mean_uncertainty("t20"), common)
    )
    relative = common / m.mean("t20")
    own, shared, _ = _uncertainty(alone, "t20")
    assert shared == pytest.approx(relative)
    assert own == pytest.approx(_uncertainty(m, "t20")[0])


def test_what_is_common_does_not_average_out():
    stated = with_uncertainty(measured())
    spread = stated.values["t20"].std(0, ddof=1) / 2
    own = np.sqrt((stated.uncertainty["t20"] ** 2).sum(0)) / 4
    expected = np.hypot(np.maximum(own, spread), stated.common_uncertainty["t20"])
    assert stated.mean_uncertainty("t20") == pytest.approx(expected)
    assert (stated.mean_uncertainty("t20") > stated.common_uncertainty["t20"]).all()


def test_the_finder_takes_what_is_written_as_what_it_would_have_made():
    def seen(m):
        case = Case(room=hall(), configurations=[Configuration(name="A", measured=m)])
        observed, _ = observe(case.only("t20", "edt"))
        return np.sqrt(np.diag(observed.covariance)), str(observed.origin)

    made, written = seen(measured()), seen(with_uncertainty(measured()))
    assert "none is given" in made[1]
    assert written[1] == "The uncertainty of T20 and EDT is as given."
    # ISO 3382-2 counts an integrated response as ten decays: 9 % more than one decay's theory.
    assert written[0] == pytest.approx(made[0], rel=0.1)


def test_measure_writes_them(tmp_path):
    pytest.importorskip("pyrato")
    path, out = tmp_path / "S1_R1.wav", tmp_path / "t.csv"
    path.write_bytes(example("responses").files[path.name])
    assert run("measure", path, "--uncertainty", "--out", out) == 0
    again = rt.Measurement.from_file(str(out))
    assert np.isfinite(again.uncertainty["t20"]).any()
    assert set(again.common_uncertainty) >= {"t20", "edt", "c80"}
