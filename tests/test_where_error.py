"""The error of what `rtcal.where` compares, from control runs whose errors are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rtcal.errors import DataError
from rtcal.loop.control_runs import ControlRuns
from rtcal.where.responses import _at_shares
from rtcal.where.simulator_error import COMMON, OWN, simulator_error

RUNS, GROUPS = 400, 200
SHAPE = (2, 6, 3)
"""Parameters, pairs, bands."""
PAIRS = tuple(("S", f"R{i}") for i in range(SHAPE[1]))


def controls(errors: np.ndarray, **more: object) -> ControlRuns:
    return ControlRuns(parameters=("t20", "edt"), pairs=PAIRS, errors=errors, **more)  # type: ignore[arg-type]


def test_the_noise_of_fewer_paths_is_taken_off() -> None:
    rng = np.random.default_rng(1)
    error, noise = 0.1, 0.2
    runs = error * rng.standard_normal((RUNS, *SHAPE))
    runs += noise * np.sqrt(2) * rng.standard_normal(runs.shape)  # of both tracings
    left = simulator_error(controls(runs), noise * rng.standard_normal((GROUPS, *SHAPE)), 8)
    expected = error**2 + noise**2 / 8
    assert left.runs.errors.var() == pytest.approx(expected, rel=0.25)
    assert runs.var() > 5 * expected


def test_errors_that_are_all_noise_do_not_vanish() -> None:
    rng = np.random.default_rng(2)
    runs = rng.standard_normal((RUNS, *SHAPE))
    left = simulator_error(controls(runs), rng.standard_normal((GROUPS, *SHAPE)), 8)
    assert left.runs.errors.var() > 0.1


def test_half_of_a_variance_is_the_value_s_own() -> None:
    # All errors of a run are alike, so that only the values' own parts leave other combinations open.
    rng = np.random.default_rng(3)
    runs = np.ones(SHAPE) * rng.standard_normal((16, 1, 1, 1))
    error = simulator_error(controls(runs), np.zeros((8, *SHAPE)), 8)
    covariance = error.covariance()
    assert np.linalg.eigvalsh(covariance).min() > 0.99 * OWN * covariance.diagonal().min()
    fewer = error.covariance(np.array([0, 1]))
    assert not np.allclose(fewer, covariance)


def test_only_what_is_common_to_all_pairs_is_assumed_smaller() -> None:
    rng = np.random.default_rng(4)
    common, own = rng.standard_normal((2, 2000, *SHAPE))
    runs = own - own.mean(axis=2, keepdims=True) + 3 * common[:, :, :1]
    error = simulator_error(controls(runs), np.zeros((8, *SHAPE)), 8)
    covariance = error.covariance().reshape(*SHAPE, *SHAPE)
    variance = np.einsum("pikpik->pik", covariance)
    assert variance == pytest.approx(np.full(SHAPE, COMMON * 9 + 1 - 1 / SHAPE[1]), rel=0.1)
    assert error.runs.errors == pytest.approx(runs)


def test_the_shift_of_scattering_is_the_control_runs_slope() -> None:
    levels = np.linspace(0.1, 0.8, 16)
    runs = np.ones(SHAPE) * levels[:, np.newaxis, np.newaxis, np.newaxis]
    more = {"levels": levels, "models": ("random", "vector") * 8}
    error = simulator_error(controls(runs, **more), np.zeros((8, *SHAPE)), 8)
    assert error.scattering(np.array([-0.3, 0.5])) == pytest.approx(
        np.ones((*SHAPE, 2)) * [-0.3, 0.5], abs=1e-6
    )
    unknown = simulator_error(controls(runs), np.zeros((8, *SHAPE)), 8)
    assert not unknown.scattering(np.array([0.5])).any()


def test_a_surface_that_leaves_a_decay_without_a_parameter_is_that_of_a_smaller_share() -> None:
    """Room 163 of the geometric world: a search ended in an error where one surface was open."""

    def parameters(energy: float) -> np.ndarray:
        if energy <= 0:
            raise DataError("the decay has no EDT")
        return np.array([energy])

    weighing: Any = SimpleNamespace(parameters=parameters)
    assert np.ravel(_at_shares(weighing, [3.0, 1.0, 0.0, 2.0])).tolist() == [3.0, 1.0, 1.0, 2.0]
    with pytest.raises(DataError, match="no EDT"):
        _at_shares(weighing, [0.0, 1.0])
