"""Thirds to octaves and back: absorption averages, T by its rate, incomplete octaves are refused."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics import bands
from rtcal.acoustics.observables import observable
from tests.conftest import measurement_of, room_of

THIRDS = bands.third_octaves(100, 5000)
OCTAVES = bands.octaves(125, 4000)
PARAMETERS = {"t20": 1.7, "edt": 1.2, "t30": 1.9, "c50": -3.0, "c80": 2.5, "d50": 0.4, "ts": 0.09}


def parameter(values, frequencies, wanted, name="t20"):
    averaging = observable(name).averaging
    return bands.Conversion(frequencies, wanted).mean(np.asarray(values, dtype=float), averaging)


def parameter_uncertainty(u, values, frequencies, wanted, name="t20"):
    averaging = observable(name).averaging
    return bands.Conversion(frequencies, wanted).uncertainty(u, values, averaging)


def absorption(values, frequencies, wanted):
    return bands.Conversion(frequencies, wanted).mean(np.asarray(values))


def room_in_thirds():
    shape = (2, len(THIRDS))
    rng = np.random.default_rng(3)
    alpha, sigma = rng.uniform(0.05, 0.6, shape), rng.uniform(0.01, 0.1, shape)
    materials = {"a": (200, alpha[0], sigma[0]), "b": (350, alpha[1], sigma[1])}
    scattering = rng.uniform(0.1, 0.9, shape)
    return room_of(materials, THIRDS, 800, scattering=scattering, air=rt.Air(18, 60))


def test_absorption_areas_average():
    stated = room_in_thirds()
    found = stated.in_bands(OCTAVES)
    by_hand = stated.absorption_area.reshape(-1, 3).mean(axis=1)
    np.testing.assert_allclose(found.absorption_area, by_hand, rtol=1e-14)
    np.testing.assert_allclose(found.sigma, stated.sigma.reshape(2, -1, 3).mean(-1), rtol=1e-14)
    np.testing.assert_allclose(found.scattering[0, 1], stated.scattering[0, 3:6].mean())
    np.testing.assert_allclose(found.air_attenuation, stated.air.attenuation(OCTAVES))


def test_t_averages_by_its_rate():
    """So the octave's T is the one of the octave's mean absorption area, without air."""
    stated = room_in_thirds().with_air(None)
    sabine = rt.Sabine(343)
    found = parameter(sabine.reverberation_time(stated), THIRDS, OCTAVES)
    octave = sabine.reverberation_time(stated.in_bands(OCTAVES))
    np.testing.assert_allclose(found, octave, rtol=1e-13)


@pytest.mark.parametrize("name", [*PARAMETERS, "g"])
def test_octaves_to_thirds_and_back_is_the_identity(name):
    value = np.full((3, 2), PARAMETERS.get(name, 12.0)) * [[1.0], [1.1], [0.7]]
    u = 0.03 * np.abs(value)
    octaves, thirds = [500, 1000], bands.third_octaves(400, 1250)
    fine = parameter(value, octaves, thirds, name)
    fine_u = parameter_uncertainty(u, value, octaves, thirds, name)
    assert fine.shape == (3, 6)
    np.testing.assert_allclose(fine[:, :3], np.repeat(value[:, :1], 3, axis=1))
    np.testing.assert_allclose(fine_u[:, 0], np.sqrt(3) * u[:, 0])
    np.testing.assert_allclose(parameter(fine, thirds, octaves, name), value, rtol=1e-12)
    np.testing.assert_allclose(
        parameter_uncertainty(fine_u, fine, thirds, octaves, name), u, rtol=1e-12
    )


@pytest.mark.parametrize("name", [*PARAMETERS, "g"])
def test_uncertainty_against_drawn_values(name):
    rng = np.random.default_rng(1)
    middle = PARAMETERS.get(name, 12.0) * np.array([0.8, 1.0, 1.3])
    u = 0.01 * np.abs(middle) * [1, 2, 3]
    drawn = middle + u * rng.standard_normal((200_000, 3))
    found = parameter_uncertainty(u, middle, [400, 500, 630], [500], name)
    scatter = parameter(drawn, [400, 500, 630], [500], name).std()
    assert found[0] == pytest.approx(scatter, rel=0.01)


def test_energy_quantities_average_as_energy():
    thirds = [800, 1000, 1250]
    share = np.array([0.3, 0.5, 0.7])
    clarity = 10 * np.log10(share / (1 - share))
    found = parameter(clarity, thirds, [1000], "c80")
    assert found[0] == pytest.approx(0.0, abs=1e-12)
    level = parameter([0, 0, 10 * np.log10(4)], thirds, [1000], "g")
    assert level[0] == pytest.approx(10 * np.log10(2))


def test_measurements_convert_as_a_whole():
    t20 = np.random.default_rng(2).uniform(1, 2, (2, 6))
    measured = measurement_of(
        bands.third_octaves(400, 1250),
        [("S1", "R1"), ("S1", "R2")],
        u={"t20": 0.03 + 0 * t20},
        t20=t20,
    )
    found = measured.in_bands([500, 1000])
    assert found.pairs == measured.pairs
    np.testing.assert_allclose(found.values["t20"], 1 / (1 / t20).reshape(2, 2, 3).mean(-1))
    assert np.all(found.uncertainty["t20"] < 0.03)
    summary = rt.Measurement(
        centre_frequencies=[400, 500, 630],
        values={"t20": [[1.0] * 3]},
        standard_deviation={"t20": [0.1] * 3},
        n_sources=2,
        n_receivers=5,
    )
    found = summary.in_bands([500])
    assert found.standard_deviation["t20"][0] == pytest.approx(0.1 / np.sqrt(3))
    assert found.n_receivers == 5


def test_incomplete_octaves_are_refused():
    thirds = bands.third_octaves(125, 1250)
    assert bands.obtainable(thirds, bands.OCTAVES).tolist() == [250, 500, 1000]
    for frequencies, wanted, said in (
        (thirds, [125, 250], "125 Hz cannot be made.*100 Hz is missing"),
        (thirds, [2000], "2000 Hz.*1600, 2000 and 2500 Hz are missing"),
        ([500, 1000], [315, 400], "315 Hz cannot be made.*250 Hz is missing"),
        ([500], [1000], "1000 Hz cannot be made"),
    ):
        with pytest.raises(rt.errors.DataError, match=said):
            absorption(np.ones(len(frequencies)), frequencies, wanted)
    with pytest.raises(rt.errors.DataError, match="last axis must have 3 values"):
        absorption([0.1, 0.2], [400, 500, 630], [500])
