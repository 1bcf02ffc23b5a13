"""A law: what a room states of its volume, areas, climate and tables counts in every part."""

from types import SimpleNamespace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.air import Air
from rtcal.acoustics.room_errors import value_changes
from rtcal.finder.positions.problem import _prior
from rtcal.finder.positions.weighing import AIR
from rtcal.prediction import Assumptions, predict
from tests.conftest import measurement_of, room_of

SABINE = rt.Sabine()
PAIRS = (("S", "R1"), ("S", "R2"))
STATED = {
    "volume_sigma": 0.04,
    "area_sigma": {"floor": 0.1, "ceiling": 0.02},
    "common_area_sigma": 0.03,
    "climate_sigma": (0.0, 5.0),
}


def box(**stated):
    materials = {
        "floor": (35.0, [0.2, 0.3], [0.04, 0.06]),
        "ceiling": (35.0, [0.5, 0.6], [0.1, 0.12]),
        "wall": (66.0, [0.1, 0.15], [0.02, 0.03]),
    }
    return room_of(materials, [1000, 4000], 105, air=Air(20.0, 50.0), **stated)


def logarithm(room):
    return np.log(SABINE.reverberation_time(room))


def derivatives(room):
    """Return those of log T by every coefficient, (n_bands, n_materials * n_bands)."""
    step, columns = 1e-6, []
    for place in np.ndindex(room.alpha.shape):
        alpha = room.alpha.copy()
        alpha[place] += step
        columns.append((logarithm(room.replace(alpha=alpha)) - logarithm(room)) / step)
    return np.array(columns).T


@pytest.mark.parametrize("of_level", [False, True])
def test_changes_are_those_of_the_equation(of_level):
    room = box(**STATED)
    got = value_changes(room, derivatives(room), np.full(2, of_level))
    step = 1e-4

    def moved(**changes):
        return (logarithm(room.replace(**changes)) - logarithm(room)) / step

    expected = [
        # A larger volume at the same absorption area keeps the level, which here stands for nothing.
        0.04 * (np.zeros(2) if of_level else moved(volume=105 * (1 + step))),
        0.03 * moved(areas=room.areas * (1 + step)),
        *(
            sigma * moved(areas=room.areas * (1 + step * (np.arange(3) == i)))
            for i, sigma in enumerate((0.1, 0.02, 0.0))
        ),
        np.zeros(2),
        (logarithm(room.with_air(Air(20.0, 45.0))) - logarithm(room.with_air(Air(20.0, 55.0)))) / 2,
    ]
    np.testing.assert_allclose(got, expected, rtol=0.02, atol=1e-6)


def calibrated(room, factor):
    """Calibrated to T that is ``factor`` times the room's at two pairs, heard by an equation."""

    def program(alpha, seed):
        t = SABINE.time(room, room.areas @ alpha)
        return measurement_of(room.centre_frequencies, PAIRS, t20=[t, t])

    simulator = rt.simulators.External(room=room, run=program, name="Sabine")
    t = factor * SABINE.reverberation_time(room)
    measured = measurement_of(
        room.centre_frequencies, PAIRS, u={"t20": [0.01 * t, 0.01 * t]}, t20=[t, t]
    )
    controls = rt.loop.ControlRuns(
        parameters=("t20",), pairs=PAIRS, errors=0.01 * np.ones((4, 1, 2, room.n_bands))
    )
    return rt.calibrate_positions(simulator, room, measured, ("t20",), controls=controls)


@pytest.mark.parametrize(
    "stated", [{"volume_sigma": 0.1}, {"area_sigma": 0.1}, {"common_area_sigma": 0.1}]
)
def test_coefficients_carry_less_of_what_the_room_explains(stated):
    exact, uncertain = box(), box(**stated)
    taken = [calibrated(room, 1.1) for room in (exact, uncertain)]
    shift = [np.abs(result.room.alpha - exact.alpha) for result in taken]
    assert (shift[1] < 0.9 * shift[0]).all()
    assert np.abs(taken[1].gap_after).mean() > np.abs(taken[0].gap_after).mean()
    # Each coefficient is as uncertain as before, or more: the same data tell less.
    assert (taken[1].room.sigma >= taken[0].room.sigma * (1 - 1e-9)).all()
    # The equation's own calibration shares out T alike.
    t = 1.1 * SABINE.reverberation_time(exact)
    measured = rt.Measurement.from_values(exact.centre_frequencies, t20=t)
    soft = [rt.calibrate(room, measured, "soft", SABINE) for room in (exact, uncertain)]
    by_equation = (soft[1].alpha - exact.alpha) / (soft[0].alpha - exact.alpha)
    assert (by_equation < 1).all()


def test_tables_that_are_off_together_move_together():
    exact, together = box(), box(common_alpha_sigma=0.3)
    alone, common = (
        calibrated(room, 1 / 1.2).room.alpha / exact.alpha for room in (exact, together)
    )
    assert np.ptp(common) < np.ptp(alone)


def test_a_loop_gives_the_materials_coefficients_beside_the_simulators():
    room = box(volume_sigma=0.1)
    simulator = rt.simulators.External(
        room=room,
        name="Sabine",
        run=lambda alpha, seed: rt.Measurement.from_values(
            room.centre_frequencies, t20=1.05 * SABINE.time(room, room.areas @ alpha)
        ),
    )
    t = 1.2 * SABINE.reverberation_time(room)
    measured = rt.Measurement.from_values(room.centre_frequencies, t20=t)
    result = rt.calibrate_simulator(simulator, room, measured, equation=SABINE, tolerance=0.01)
    np.testing.assert_allclose(result.gap, 0, atol=0.01)
    expected = rt.calibrate(room, result.outcome.reverberation_time_after, "mle", SABINE)
    np.testing.assert_allclose(result.of_uncertain_room.alpha, expected.alpha, rtol=1e-9)
    assert (result.of_uncertain_room.alpha > result.alpha + 1e-3).all()
    assert "volume 10 %" in " ".join(str(result).split())
    exact = rt.calibrate_simulator(simulator, box(), measured, equation=SABINE, tolerance=0.01)
    assert exact.of_uncertain_room is None


@pytest.mark.parametrize("stated", [{"volume_sigma": 0.1}, {"area_sigma": 0.1}])
def test_the_finder_at_positions_expects_what_the_room_may_be_off_by(stated):
    slopes = np.random.default_rng(0).uniform(-2, -1, (2, 5, 3))

    def variance(room):
        case = SimpleNamespace(room=room)
        factor, _ = _prior(case, slopes, np.zeros((2, 5, len(AIR))))
        return (factor**2).sum(axis=1)

    exact, uncertain = box(), box(**stated)
    matrix = np.zeros((2, 5, 3, 2))
    for k in range(2):
        matrix[k, :, :, k] = slopes[k]
    changes = value_changes(uncertain, matrix.reshape(10, -1), np.zeros(10, dtype=bool))
    np.testing.assert_allclose(
        variance(uncertain) - variance(exact), (changes**2).sum(axis=0), rtol=1e-9
    )


SURE = Assumptions(volume=0, areas=0, common=0, factor=0, least=0, evenness=0, evenness_sigma=0)


def variance_before(room):
    """Variance of ln T of a room in which nothing was measured."""
    made = predict(room, [], equation=SABINE, assumptions=SURE)
    return np.asarray((made.uncertainty_before / made.time_before) ** 2)


def test_a_prediction_counts_that_the_tables_are_off_together():
    """Its T has the variance of the coefficients, those off together included."""
    sigma = np.full((3, 2), 1e-3)
    exact, uncertain = (box(common_alpha_sigma=t).replace(sigma=sigma) for t in (0, 0.03))
    together = 0.03 * derivatives(exact) @ exact.alpha.ravel()
    found = variance_before(uncertain) - variance_before(exact)
    np.testing.assert_allclose(found, together**2, rtol=0.05)


@pytest.mark.parametrize("name", list(STATED))
def test_a_prediction_counts_each_area_of_its_own_and_the_climate(name):
    """Its T has the variance of what the room states, as positions hear it; nothing else is unknown."""
    exact = box().replace(sigma=np.zeros((3, 2)))
    uncertain = exact.replace(**{name: STATED[name]})
    expected = value_changes(uncertain, derivatives(exact), np.zeros(2, dtype=bool))
    variance = variance_before(uncertain)
    np.testing.assert_allclose(variance, (expected**2).sum(axis=0), rtol=0.06)
    assert (variance > 0).all()
