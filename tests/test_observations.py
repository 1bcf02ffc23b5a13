"""Observations at positions and their derivatives: against differences, by material and by surface."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.observables import OBSERVABLES, gradients, observable, register
from rtcal.datasets import halls
from rtcal.simulators import PathTracing, Polyhedron, kernels
from rtcal.simulators.base import differences, jacobian
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.errors import DataError
from tests.conftest import in_geometry, in_hall
from tests.reference import in_place_of
from tests.reference import paths as reference


@pytest.fixture(scope="module")
def tracer():
    hall = halls.lecture_hall()
    first = dict(list(hall.sources.items())[:1])
    scattering = np.linspace(0.3, 0.7, hall.room.n_materials)
    return in_hall(hall, sources=first, n_paths=1600, scattering=scattering)


def bent_decay(share):
    """A decay of two slopes, in bins so fine that the ranges' ends move smoothly."""
    time = np.arange(60000) * 5e-5
    return (1 - share) * 10 ** (-6 * time / 0.5) + share * 10 ** (-6 * time / 0.7)


@pytest.mark.parametrize("parameter", OBSERVABLES)
def test_gradient_of_a_parameter_is_its_difference(parameter):
    kind = observable(parameter)

    def value(share):
        return kind.observed(kind.value(bent_decay(share), 5e-5))

    step = 0.01
    expected = (value(0.3 + step) - value(0.3 - step)) / (2 * step)
    by_bin = gradients(bent_decay(0.3), 5e-5, [parameter])[0]
    change = by_bin @ (bent_decay(1.0) - bent_decay(0.0))
    # The ends of the ranges move as those of a straight decay do; of this one, nearly so.
    assert change == pytest.approx(expected, rel=0.03)


def test_path_tracing_differentiates_as_differences_do(tracer):
    alpha = tracer.room.alpha
    exact = tracer.jacobian(alpha, seed=3)
    by_difference = differences(tracer, alpha, seed=3)
    size = np.abs(by_difference).max(axis=(1, 2, 3))
    off = np.abs(exact - by_difference).mean(axis=(1, 2, 3)) / size
    # T20 and EDT jump where a bin enters the regression; the others differ by the step's curvature.
    assert (off < [0.05, 0.05, 1e-4, 1e-4, 1e-4]).all()


def test_numpy_and_the_compiled_loops_give_the_same_derivatives_by_scattering(tracer):
    found = []
    for loops in (kernels, reference):
        with in_place_of(kernels, loops):
            found.append(tracer.scattering_jacobian(tracer.room.alpha, ["c80", "level"], seed=1))
    assert found[0].shape == (2, 2, len(tracer.pairs), tracer.room.n_bands, tracer.room.n_materials)
    assert np.abs(found[0]).max() > 0
    np.testing.assert_allclose(*found, rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_the_derivative_by_scattering_is_that_of_other_paths():
    """Between hard walls, a soft floor and ceiling. The differences take other paths."""
    geometry = Polyhedron.shoebox([8.0, 6.0, 3.0], {wall: wall for wall in SHOEBOX_WALLS})
    alpha = np.array([[0.05]] * 4 + [[0.6]] * 2)
    room = in_geometry(geometry, [1000.0], alpha, sigma=np.full((6, 1), 0.01), air=None)

    def traced(log_odds):
        return PathTracing(
            geometry=geometry,
            room=room,
            sources={"S": [1.5, 1.2, 1.4]},
            receivers={"R1": [6.5, 4.5, 1.2], "R2": [3.0, 4.9, 1.2]},
            n_paths=40000,
            scattering=1 / (1 + np.exp(-log_odds)),
        )

    stated = np.full(6, -1.5)
    slope = traced(stated).scattering_jacobian(room.alpha, ["ts"]).mean(axis=(0, 1, 2, 3))
    assert (slope[:4] < -0.03).all()
    assert (np.abs(slope[4:]) < 0.03).all()
    for wall in (0, 4):
        step = np.where(np.arange(6) == wall, 0.4, 0.0)
        before, after = (
            traced(stated + sign * step).observe(room.alpha, ["ts"], seed=seed).values.mean()
            for seed, sign in ((1, -1), (2, 1))
        )
        assert slope[wall] == pytest.approx((after - before) / 0.8, abs=0.03)


def test_what_scatters_nothing_or_everything_has_no_derivative_by_scattering(tracer):
    stated = np.linspace(0.0, 1.0, tracer.room.n_materials)
    ends = replace(tracer, scattering=stated)
    slope = ends.scattering_jacobian(tracer.room.alpha, ["level"])
    assert not slope[..., [0, -1]].any()
    assert slope[..., 1:-1].any(axis=(0, 1, 2, 3)).all()
    with pytest.raises(DataError, match="number = 3 must divide"):
        ends.scattering_jacobian(tracer.room.alpha, ["level"], number=3)


def test_other_simulators_are_differentiated_by_differences():
    room, _ = rt.datasets.bras_cr2()
    simulator = rt.simulators.of_equation(room=room, equation=rt.Sabine())
    found = jacobian(simulator, room.alpha, ["t20"])
    loss = room.areas @ room.alpha + 4 * room.air_attenuation * room.volume
    expected = -room.areas[np.newaxis] / loss[:, np.newaxis]  # d ln T / d alpha = -S / A
    np.testing.assert_allclose(found[0, 0], expected, rtol=0.02)


@pytest.mark.parametrize(
    ("match", "said"),
    [
        (("t20", "loudness"), "match = 'loudness'"),
        ((), "match is empty"),
        (("t20", "t20"), "twice"),
        ("t20", "match"),
    ],
)
def test_wrong_parameters_are_refused(tracer, match, said):
    with pytest.raises(DataError, match=said):
        tracer.observe(tracer.room.alpha, match)


def share(**attributes):
    """A class like D50's, of another key, from outside the package."""
    return type("Share", (type(observable("d50")),), {"key": "d50b", **attributes})


@pytest.fixture
def registry():
    before = dict(OBSERVABLES)
    yield before
    OBSERVABLES.clear()
    OBSERVABLES.update(before)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"key": "t20"}, 'observable "t20": T20 already has this key'),
        ({"teams": (0.05,) * 8}, "teams has 8 values; give one for each of 125, 250, 500, 1000"),
        (
            {"gradient": lambda self, *decay: -observable("d50").gradient(*decay)},
            r"gradient by the energy of the time bin at \d\S* s = .* value changes by",
        ),
        ({"gradient": lambda self, energy, *_: np.nan * energy}, "gradient by .* = nan, but"),
    ],
)
def test_a_wrong_observable_is_not_registered(registry, attributes, message):
    with pytest.raises(DataError, match=message):
        register(share(**attributes))
    assert registry == OBSERVABLES
