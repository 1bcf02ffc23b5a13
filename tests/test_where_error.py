"""The error of what `rtcal.finder.positions` compares, by reference simulations of known errors."""

import numpy as np
import pytest

from rtcal.finder.positions.problem import COMMON, Likelihood, levels, simulator_error
from rtcal.finder.positions.weighing import TRACED, TRACINGS
from rtcal.loop.measured_pairs import ControlRuns

RUNS, GROUPS = 400, 200
SHAPE = (2, 6, 3)
"""Parameters, pairs, bands."""
OCTAVES = np.array([250.0, 500.0, 1000.0])
PAIRS = tuple(("S", f"R{i}") for i in range(SHAPE[1]))


def controls(errors, **more):
    return ControlRuns(parameters=("t20", "edt"), pairs=PAIRS, errors=errors, **more)


STILL = np.zeros((*SHAPE, 2))
"""Derivatives by the scattering of two materials that change nothing."""


def error_of(runs, noise, scattering=STILL, of_groups=None):
    none = np.zeros((*noise.shape, scattering.shape[-1]))
    return simulator_error(
        runs, noise, scattering, none if of_groups is None else of_groups, TRACINGS, OCTAVES
    )


def test_beside_a_run_two_rooms_err():
    """The program errs against the real room's simulator as the real room does."""
    rng = np.random.default_rng(4)
    runs, noise = controls(rng.standard_normal((RUNS, *SHAPE))), np.zeros((GROUPS, *SHAPE))
    none = np.zeros((*noise.shape, STILL.shape[-1]))
    given = runs, noise, STILL, none, TRACINGS, OCTAVES
    np.testing.assert_allclose(simulator_error(*given, erring=2), 2 * simulator_error(*given))


def with_noise(error, noise, more_paths=1):
    """Return the error of reference simulations, the difference of two tracings of ``noise`` each."""
    rng = np.random.default_rng(1)
    runs = error * rng.standard_normal((RUNS, *SHAPE))
    runs += noise * np.sqrt(2 / more_paths) * rng.standard_normal(runs.shape)
    controlled = controls(runs, more_paths=more_paths)
    return error_of(controlled, noise * rng.standard_normal((GROUPS, *SHAPE)))


def test_the_noise_of_one_tracing_is_left_and_has_no_pattern():
    left = with_noise(0.1, 0.2)
    common = COMMON * 0.1**2 / SHAPE[1] - 0.1**2 / SHAPE[1]  # of the runs, as is assumed
    variance = np.diag(left)
    assert variance.mean() == pytest.approx(0.1**2 + common + 0.2**2, rel=0.1)
    # Noise alone: few runs leave hardly any covariance of values that have none.
    noise = with_noise(0.0, 0.2)
    off = noise[~np.eye(len(noise), dtype=bool)]
    assert np.sqrt((off**2).mean()) < 0.02 * np.diag(noise).mean()


def of_the_mean(noise):
    """Return the covariance of the error by noise alone, but for that of one tracing."""
    of_one = controls(noise).alike() * GROUPS / (GROUPS - TRACINGS)
    covariance = error_of(controls(np.zeros((16, *SHAPE))), noise) - of_one
    return np.asarray(covariance.reshape(*SHAPE, *SHAPE))


def test_what_is_compared_has_noise_of_its_own():
    # All parameters and bands of a pair share its paths. Here no pair shares those of another.
    rng = np.random.default_rng(5)
    of_pair = 0.2 * rng.standard_normal((GROUPS, 1, SHAPE[1], 1))
    covariance = of_the_mean(of_pair * np.ones(SHAPE))
    expected = 0.2**2 / GROUPS
    assert covariance[0, 2, 1, 1, 2, 2] == pytest.approx(expected, rel=0.15)
    assert abs(covariance[0, 2, 1, 0, 3, 1]) < 0.1 * expected


def test_noise_of_the_derivatives_by_scattering_is_no_evidence():
    """Each counts by the variance of the scattering that it multiplies; few paths say less."""
    rng = np.random.default_rng(8)
    of_groups = 0.2 * rng.standard_normal((GROUPS, 1, 1, 1, 2)) * np.ones((*SHAPE, 2))
    error = error_of(
        controls(np.zeros((16, *SHAPE))), np.zeros((GROUPS, *SHAPE)), of_groups=of_groups
    )
    covariance = error.reshape(*SHAPE, *SHAPE)
    # Two materials: their own variance in all bands, and that of the whole room from band to band.
    expected = 2 * (0.8**2 + 0.7 * (0.8**2 + 1.0)) * 0.2**2 / GROUPS
    assert covariance[0, 2, 1, 1, 3, 2] == pytest.approx(expected, rel=0.25)


def test_what_the_scattering_of_a_material_changes_is_no_evidence():
    """Neither as much in every band, nor another change in each; what pairs differ by is noise."""
    rng = np.random.default_rng(6)
    slope = rng.standard_normal((*SHAPE, 2))
    error = error_of(controls(np.zeros((16, *SHAPE))), np.zeros((GROUPS, *SHAPE)), slope)
    covariance = error.reshape(*SHAPE, *SHAPE)
    first, other = slope[0].mean(axis=0)[1], slope[1].mean(axis=0)[2]
    own = 0.8**2 * np.eye(2)
    expected = first @ (own + 0.7 * (own + 1.0)) @ other
    assert covariance[0, 2, 1, 1, 3, 2] == pytest.approx(expected)


def test_how_much_the_whole_room_scatters_is_no_evidence():
    """Its effect is no straight line: each level counts by its prior, in the mean over pairs."""
    of_pairs = np.zeros((3, 2, 6, len(TRACED)))  # bands, parameters, pairs
    of_pairs[:, 0] = [4.0, 1.0, -0.5]
    of_pairs[:, 0, :3] += 1.0
    of_pairs[:, 0, 3:] -= 1.0
    found = levels(of_pairs)
    shifts = found.shifts.reshape(3, 2, 6, -1)
    assert np.ptp(shifts, axis=2) == pytest.approx(np.zeros((3, 2, shifts.shape[-1])))
    assert np.exp(found.log_weights).sum() == pytest.approx(1.0)
    little, middle, much = shifts[0, 0, 0, [0, shifts.shape[-1] // 2, -1]]
    assert little > 4.0
    assert middle == pytest.approx(0.0)
    assert much < -0.5
    n = len(found.shifts)
    room = Likelihood(
        np.eye(n),
        np.ones(n, dtype=bool),
        {},
        uneven=np.zeros((12, 1)),
        amount=np.zeros(12),
        levels=found,
    )
    row = 1
    heard = found.shifts[:, row]
    each = -0.5 * ((heard[:, np.newaxis] - found.shifts) ** 2).sum(axis=0) + found.log_weights
    assert room.stated(room.of(heard)) == pytest.approx(np.logaddexp.reduce(each))


def test_only_what_is_common_to_all_pairs_is_assumed_smaller():
    rng = np.random.default_rng(4)
    common, own = rng.standard_normal((2, 2000, *SHAPE))
    runs = own - own.mean(axis=2, keepdims=True) + 3 * common[:, :, :1]
    error = error_of(controls(runs), np.zeros((8, *SHAPE)))
    covariance = error.reshape(*SHAPE, *SHAPE)
    variance = np.einsum("pikpik->pik", covariance)
    assert variance == pytest.approx(np.full(SHAPE, COMMON * 9 + 1 - 1 / SHAPE[1]), rel=0.1)
