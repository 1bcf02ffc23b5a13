"""Bellows & Katz (2025): the printed examples, by the closed forms and by the QP."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.equations import PAPER_SPEED_OF_SOUND

SABINE = rt.Sabine(speed_of_sound=PAPER_SPEED_OF_SOUND)


def room_of(areas, mu, sigma):
    return rt.Room(
        name="paper",
        volume=60,
        materials=[f"S{i + 1}" for i in range(len(areas))],
        areas=np.array(areas, dtype=float),
        alpha=np.array(mu)[:, np.newaxis],
        sigma=np.array(sigma, dtype=float)[:, np.newaxis],
        centre_frequencies=[1000],
    )


def calibrated(areas, mu, sigma, truth, method, solver):
    room = room_of(areas, mu, sigma)
    t = SABINE.reverberation_time(room.replace(alpha=np.array(truth)[:, np.newaxis]))
    return rt.calibrate(room, t, method=method, equation=SABINE, solver=solver).alpha[:, 0]


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
def test_figure_1(solver):
    """5 x 4 x 3 m, floor 0.2, rest 0.4, estimated 0.4 and 0.6; the paper prints T 0.29 and 0.19 s."""
    room = room_of([20, 74], [0.4, 0.6], [0.1, 0.1])
    truth = room.replace(alpha=np.array([[0.2], [0.4]]))
    assert SABINE.reverberation_time(truth)[0] == pytest.approx(0.29, abs=0.005)
    assert SABINE.reverberation_time(room)[0] == pytest.approx(0.19, abs=0.005)
    found = calibrated([20, 74], [0.4, 0.6], [0.1, 0.1], [0.2, 0.4], "lse", solver)
    np.testing.assert_array_equal(found.round(2), [0.34, 0.36])
    errors = [np.linalg.norm(np.array(a) - [0.2, 0.4]) for a in ([0.4, 0.6], found)]
    np.testing.assert_array_equal(np.round(errors, 2), [0.28, 0.14])


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
@pytest.mark.parametrize(
    ("sigma_2", "printed"), [(0.05, (0.45, 0.35)), (0.1, (0.54, 0.26)), (0.2, (0.58, 0.22))]
)
def test_figure_3(sigma_2, printed, solver):
    found = calibrated([47, 47], [0.6, 0.5], [0.05, sigma_2], [0.6, 0.2], "mle", solver)
    np.testing.assert_array_equal(found.round(2), printed)


AREAS = np.array([35.0, 35, 15, 15, 21, 21])
MU = np.array([0.66, 0.45, 0.88, 0.83, 0.12, 0.52])
SIGMA = np.array([0.04, 0.07, 0.06, 0.01, 0.05, 0.06])
TRUTH = np.array([0.68, 0.47, 0.88, 0.83, 0.10, 0.55])
PRINTED = {
    "ref": [0.68, 0.46, 0.90, 0.85, 0.12, 0.53],
    "lse": [0.68, 0.46, 0.89, 0.84, 0.12, 0.53],
    "mle": [0.67, 0.47, 0.89, 0.83, 0.12, 0.53],
}


def table_1():
    b = AREAS @ TRUTH
    return {
        "ref": rt.exact.scaling(MU, AREAS, b),
        "lse": rt.exact.least_squares(MU, AREAS, b),
        "mle": rt.exact.maximum_likelihood(MU, SIGMA, AREAS, b),
    }


@pytest.mark.parametrize("method", ["ref", "lse", "mle"])
def test_table_1_calibrated_values(method):
    """Within 0.01, because its inputs are printed to two digits."""
    np.testing.assert_allclose(table_1()[method], PRINTED[method], rtol=0, atol=0.01)


def test_table_1_mse_row_is_a_power_of_ten_off():
    """The printed row 34.1 26.9 23.6 20.4 (x 1e-4) is ten times what its own columns give."""
    ours = {"none": MU, **table_1()}
    mse = {name: 1e4 * np.mean((alpha - TRUTH) ** 2) for name, alpha in ours.items()}
    assert mse["none"] == pytest.approx(3.5, abs=0.05)
    for name, printed in (("none", 34.1), ("ref", 26.9), ("lse", 23.6), ("mle", 20.4)):
        assert 0.5 < 10 * mse[name] / printed < 1.5


def test_equations_11_12_26_27_agree_with_the_projection():
    """The paper's constants C and D, written out from T, give the same coefficients."""
    room = room_of(AREAS, MU, SIGMA).replace(air=rt.Air())
    for equation in (SABINE, rt.Eyring(speed_of_sound=PAPER_SPEED_OF_SOUND)):
        before = equation.reverberation_time(room)
        t = 1.1 * before
        b = equation.absorption_area(room, t)
        air = 4 * room.air_attenuation * room.volume
        rates = [0.164 * room.volume / value - air for value in (before, t)]
        s = room.total_area
        if isinstance(equation, rt.Sabine):
            numerator = rates[0] - rates[1]
        else:
            numerator = s * (np.exp(-rates[1] / s) - np.exp(-rates[0] / s))
        c = numerator / np.sum(AREAS**2)
        d = numerator / np.sum(AREAS**2 * SIGMA**2)
        lse = rt.exact.least_squares(room.alpha, AREAS, b)
        mle = rt.exact.maximum_likelihood(room.alpha, room.sigma, AREAS, b)
        np.testing.assert_allclose(lse[:, 0], MU - c * AREAS, rtol=1e-12)
        np.testing.assert_allclose(mle[:, 0], MU - d * AREAS * SIGMA**2, rtol=1e-12)
