"""No fit ends farther from what was measured than it began: over simulators, priors and data."""

from functools import cache

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import rms
from rtcal.loop.measured_pairs import ControlRuns
from rtcal.loop.positions import precise
from rtcal.simulators import External, ImageSource, PathTracing, ScatteringDelayNetwork
from rtcal.simulators.base import observe
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from tests.conftest import also, measurement_of

MATCH = ("t20", "edt", "c80")
BANDS = [500.0, 2000.0]
SIZE = (4.2, 5.1, 2.9)
SIDES = {"floor": "floor", "ceiling": "ceiling"}
OF_WALL = {w: SIDES.get(w, "walls") for w in SHOEBOX_WALLS}
AREAS = {
    "walls": 2 * (SIZE[0] + SIZE[1]) * SIZE[2],
    "floor": SIZE[0] * SIZE[1],
    "ceiling": SIZE[0] * SIZE[1],
}
PLACES = {
    "sources": {"S": (1.1, 1.3, 1.2)},
    "receivers": {"Q": (3.2, 3.9, 1.4), "R": (2.4, 4.3, 1.0), "P": (3.4, 1.7, 1.8)},
}
ALPHA = np.array([[0.1, 0.15], [0.25, 0.2], [0.12, 0.3]])
PRIORS = {
    "tight": 0.02 * ALPHA,
    "usual": 0.3 * ALPHA,
    "wide": np.full(ALPHA.shape, 0.4),
    "none": np.zeros(ALPHA.shape),
}


def stated(sigma, alpha=ALPHA):
    return rt.Room(
        name="small box",
        volume=float(np.prod(SIZE)),
        materials=[*AREAS],
        areas=[*AREAS.values()],
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=BANDS,
        dimensions=SIZE,
        surfaces=[
            rt.Surface(w, m, AREAS[m] if m != "walls" else _area(w)) for w, m in OF_WALL.items()
        ],
        air=rt.Air(temperature=20, humidity=50),
    )


def _area(wall):
    return SIZE[2] * (SIZE[1] if wall in ("west", "east") else SIZE[0])


def paths(room):
    geometry = Polyhedron.shoebox([*SIZE], OF_WALL)
    return PathTracing(geometry=geometry, room=room, n_paths=640, scattering=0.3, **PLACES)


def images(room):
    return ImageSource(room=room, duration=0.9, **PLACES)


def network(room):
    return ScatteringDelayNetwork(room=room, sampling_rate=8000, **PLACES)


def program(room):
    """Three pairs, each with its own T and clarity, which bend with the absorption."""

    def run(alpha, seed):
        area = room.areas @ alpha
        late = rt.Eyring().time(room, area)
        near = np.array([0.9, 1.0, 1.1])[:, np.newaxis]
        early = late * near * (0.5 + alpha[1]) ** 0.4
        return measurement_of(
            BANDS,
            [("S", "Q"), ("S", "R"), ("S", "P")],
            t20=np.broadcast_to(late, (3, 2)) * near**0.2,
            edt=early,
            c80=10 * np.log10(np.expm1(13.8 * 0.08 / early)),
        )

    return External(room=room, run=run, name="program")


def equation(room):
    return rt.simulators.of_equation(rt.Kuttruff(), room)


SIMULATORS = {of.__name__: of for of in (paths, images, network, program, equation)}
AT_PAIRS = ("paths", "images", "program")
"""Simulators of several pairs: an equation has one T for all."""


def controls(simulator):
    """Errors that a path tracing may have, by level of scattering; None where they are not known."""
    if not isinstance(simulator, (PathTracing, ImageSource, ScatteringDelayNetwork)):
        return None
    rng = np.random.default_rng(3)
    size = np.array([0.04, 0.05, 0.3])[:, np.newaxis, np.newaxis]
    common = rng.standard_normal((16, 3, 1, 1))
    return ControlRuns(
        parameters=MATCH,
        pairs=tuple(simulator.simulate(ALPHA).pairs),
        errors=size * (0.7 * common + 0.7 * rng.standard_normal((16, 3, 3, 2))),
        levels=np.linspace(0.1, 0.8, 16),
        models=("random", "vector") * 8,
    )


@cache
def of_simulator(name):
    simulator = SIMULATORS[name](stated(PRIORS["usual"]))
    return controls(simulator)


def measured(name, alpha, *, scale=1.0, seed=9):
    """Return another run of the same simulator, its times ``scale`` times as long."""
    heard = precise(SIMULATORS[name](stated(PRIORS["usual"]))).simulate(alpha, seed=seed)
    values = {p: heard.values[p] for p in MATCH if p in heard.values}
    for p in {"t20", "edt"} & set(values):
        values[p] = scale * values[p]
    return rt.Measurement(centre_frequencies=BANDS, pairs=heard.pairs, values=values)


def fit(name, room, data, **options):
    return rt.calibrate_positions(
        SIMULATORS[name](room), room, data, MATCH, **{"controls": of_simulator(name), **options}
    )


def objective(result, heard, alpha):
    """Half of the squares of what is missed and of the deviations from the prior."""
    left = (result.measured.observations.values - heard.values)[result.measured.used]
    moved = (alpha - result.prior.alpha).ravel()
    of_prior = moved @ np.linalg.pinv(result.prior_covariance) @ moved
    return 0.5 * (left @ np.linalg.solve(result.covariance, left) + of_prior)


QUICK = {("paths", "wide", 1 / 3), ("program", "wide", 1.0), ("program", "none", 1.0)}
EACH = [(n, p, s) for n in (*AT_PAIRS, "network") for p in PRIORS for s in (1 / 3, 1.0, 3.0)]


@pytest.mark.parametrize(
    ("name", "prior", "scale"), [x for e in EACH for x in ([e] if e in QUICK else also(e))]
)
def test_gap_and_objective_are_at_most_those_of_the_start(name, prior, scale):
    room = stated(PRIORS[prior])
    data = measured(name, np.clip(1.4 * ALPHA, 0, 0.9), scale=scale)
    result = fit(name, room, data, fit_scattering=False)
    before, after = rms(result.gap_before), rms(result.gap_after)
    assert after <= before + 1e-9
    assert result.scattering is None
    each = [rms(gap, axis=(1, 2)) for gap in (result.gap_before, result.gap_after)]
    assert (each[1] <= np.maximum(each[0], 0.5) + 1e-9).all()  # none is given up for the others
    start = objective(result, result.matched.before, room.alpha)
    assert objective(result, result.matched.after, result.alpha) <= start * (1 + 1e-9)
    if prior == "none":
        assert result.refused
        assert (result.alpha == room.alpha).all()
    assert str(result).startswith("No step reduced") == bool(result.refused)
    if result.refused:
        assert result.room is room
    elif prior == "wide" and scale == 1:
        assert after < 0.5 * before


@pytest.mark.parametrize("factor", [1 / 3, *also(1.0, 3.0)])
@pytest.mark.parametrize("prior", ["wide", *also("tight", "usual")])
def test_a_fitted_scattering_ends_no_farther_either(prior, factor):
    room = stated(PRIORS[prior])
    result = fit("paths", room, measured("paths", np.clip(factor * ALPHA, 0.02, 0.9)))
    assert rms(result.gap_after) <= rms(result.gap_before) + 1e-9
    returned = precise(result.tracer).observe(result.alpha, MATCH)  # what its user gets
    gap = result.measured.gap(returned.at(result.matched.after).values)
    assert rms(gap) <= rms(result.gap_before) + 0.01
    if prior == "wide":
        assert rms(result.gap_after) < 1


@pytest.mark.parametrize(
    ("name", "alpha"),
    [("program", 0.001), ("program", 0.97), *also(("images", 0.97), ("images", 0.001))],
)
def test_a_start_at_a_bound_is_left_towards_what_was_measured(name, alpha):
    at_bound = ALPHA.copy()
    at_bound[2] = alpha
    room = stated(PRIORS["wide"], at_bound)
    result = fit(name, room, measured(name, ALPHA))
    assert rms(result.gap_after) < 0.3 * rms(result.gap_before)
    assert np.abs(result.alpha - 0.5).max() <= 0.5


@pytest.mark.parametrize("name", ["paths", "images", "program", "equation"])
@pytest.mark.parametrize("factor", [0.85, 1.0, *also(3.0)])
def test_no_loop_ends_farther_than_the_stated_coefficients(name, factor):
    room = stated(PRIORS["usual"])
    simulator = SIMULATORS[name](room)
    alpha = np.clip(factor * ALPHA, 0.02, 0.9)
    heard = simulator.simulate(alpha, seed=0)
    data = measurement_of(BANDS, heard.pairs, t20=heard.values["t20"])
    result = rt.calibrate_simulator(simulator, room, data)
    wanted = data.mean("t20")
    start, end = (
        rms(rt.acoustics.marks.gap_jnd(simulator.simulate(a).mean("t20"), wanted))
        for a in (room.alpha, result.alpha)
    )
    assert end <= start + 1e-9
    assert end <= 1
    if factor == 1:
        np.testing.assert_allclose(result.alpha, ALPHA, atol=1e-6)
        assert len(result.steps) == 1


def test_bands_that_depend_on_each_other_end_no_farther_than_a_step():
    room = stated(PRIORS["usual"])
    wanted = rt.Eyring().reverberation_time(room)

    def run(alpha, seed):
        more = np.log(room.areas @ alpha / (room.areas @ room.alpha))
        return wanted * np.exp(0.2 + np.tanh(8 * more[::-1]))

    simulator = External(room=room, run=run, name="crossed")
    result = rt.calibrate_simulator(
        simulator, room, rt.Measurement.from_values(BANDS, t20=wanted), max_simulations=6
    )
    start = rms(rt.acoustics.marks.gap_jnd(run(room.alpha, 0), wanted))
    end = rms(rt.acoustics.marks.gap_jnd(run(result.alpha, 0), wanted))
    assert end <= start + 1e-9


@pytest.mark.parametrize(("name", "factor"), [("program", 2.0), *also(("paths", 1 / 3))])
def test_a_t_that_the_prior_cannot_explain_is_not_bent_into_scattering(name, factor):
    room, truth = stated(PRIORS["tight"]), np.clip(factor * ALPHA, 0.02, 0.9)
    data = measured(name, truth)
    result = fit(name, room, data)
    beyond = result.beyond
    assert beyond.bands == beyond.of_bands == 2
    assert np.sign(beyond.z) == np.sign(factor - 1)
    mean = room.areas @ truth[:, BANDS.index(beyond.frequency)] / room.total_area
    assert beyond.needed == pytest.approx(mean, rel=0.35)  # by Sabine's law
    assert result.scattering is None
    # Also where T is too short: the coefficients are then too large, and no absorption is missing.
    of_tracing = [n for n in result.every_note if n.startswith("The input scattering was kept")]
    assert all("correct wrong coefficients" in note for note in of_tracing)
    assert len(of_tracing) == (name == "paths")
    assert fit(name, stated(PRIORS["wide"]), data).beyond is None


def of_common_errors():
    """Return errors of a simulator that all pairs and bands share."""
    common = 0.06 * np.random.default_rng(3).standard_normal((16, 1, 1, 1))
    return ControlRuns(
        parameters=MATCH,
        pairs=(("S", "Q"), ("S", "R"), ("S", "P")),
        errors=common * np.array([1.0, 1.0, 16.0])[:, np.newaxis, np.newaxis]
        + 0.002 * np.random.default_rng(4).standard_normal((16, 3, 3, 2)),
    )


def test_the_errors_that_pairs_share_are_predicted_where_nothing_was_measured():
    """Of coefficients that are known, all that the measured pairs miss is the simulator's error."""
    data, room = measured("program", ALPHA, scale=1.2), stated(PRIORS["none"])
    runs, first = of_common_errors(), data.pairs[:1]
    result = fit("program", room, data, exclude=first, controls=runs)
    assert result.pairs == tuple(data.pairs[1:])
    assert result.predicted.pairs == tuple(data.pairs)
    moved = result.predicted.natural("t20") / program(room).simulate(ALPHA).values["t20"]
    assert moved[0] == pytest.approx(1.2, abs=0.05)


def test_of_coefficients_that_are_as_likely_those_with_the_smallest_gap_are_taken():
    """An error of the simulator that all bands share would else excuse a part of the gap."""
    room, data = stated(PRIORS["usual"]), measured("program", 2 * ALPHA)
    result = fit("program", room, data, controls=of_common_errors())
    likeliest = result.steps[-1].answer.alpha
    heard = observe(program(room), likeliest, MATCH)
    assert rms(result.gap_after) < 0.9 * rms(result.measured.gap(heard.values))
    least = objective(result, heard, likeliest)
    assert least - 0.01 < objective(result, result.matched.after, result.alpha) < least + 0.5
    np.testing.assert_array_equal(result.room.sigma, result.sigma)
