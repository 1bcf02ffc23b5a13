"""The simulator's error without the noise that the reference simulations' finite paths make."""

from dataclasses import replace

import numpy as np
import pytest

from rtcal.datasets import halls
from rtcal.loop.measured_pairs import COMMON_LEFT, ControlRuns, basis, errors_by_scattering
from rtcal.loop.positions import unexplained_errors
from rtcal.simulators import PathTracing
from rtcal.support.errors import DataError

PAIRS = tuple(("S", f"R{i}") for i in range(6))
RUNS = 400
"""Far more than in use, so that the variances are known to some per cent."""


def runs(rng, noise, common=0.03, own=0.02):
    """Return reference simulations with a known error, and the noise of their paths on top."""
    shape = (RUNS, 2, len(PAIRS), 3)
    errors = common * rng.standard_normal((RUNS, 2, 1, 3)) + own * rng.standard_normal(shape)
    return ControlRuns(
        parameters=("t20", "edt"),
        pairs=PAIRS,
        errors=errors + noise * rng.standard_normal(shape),
        levels=rng.uniform(0.1, 0.85, RUNS),
        models=tuple(np.where(np.arange(RUNS) % 2, "vector", "random").tolist()),
    )


def test_the_errors_keep_the_variance_that_is_not_noise():
    made = runs(np.random.default_rng(1), noise=0.07)
    left = made.without_noise(np.full((2, 3), 0.07**2)).errors
    common = left.mean(axis=2)
    own = left - common[:, :, np.newaxis]
    assert common.std() == pytest.approx(np.hypot(0.03, 0.02 / np.sqrt(6)), rel=0.1)
    assert own.std() == pytest.approx(0.02 * np.sqrt(5 / 6), rel=0.25)
    assert made.without_noise(np.zeros((2, 3))).errors == pytest.approx(made.errors, abs=1e-15)


def test_noise_of_the_control_runs_does_not_count_as_the_simulators_error():
    rng = np.random.default_rng(3)
    made = runs(rng, noise=0.07)
    fits = [errors_by_scattering(made, np.full((2, 3), v)) for v in (0.0, 0.07**2)]
    counted, taken_off = (np.diag(fit.covariance(0.475, "random")).mean() for fit in fits)
    for variance, of_pair in ((counted, 0.02**2 + 0.07**2), (taken_off, 0.02**2)):
        common = 0.03**2 + of_pair / len(PAIRS)
        own = of_pair * (1 - 1 / len(PAIRS))
        assert variance == pytest.approx(COMMON_LEFT * common + own, rel=0.2)


def test_pairs_that_differ_by_noise_alone_share_what_the_other_model_adds():
    rng = np.random.default_rng(4)
    made = runs(rng, noise=0.2)
    vector = np.array([m == "vector" for m in made.models])[:, np.newaxis, np.newaxis, np.newaxis]
    of_pair = np.linspace(-1, 1, len(PAIRS))[:, np.newaxis]
    spread = []
    for factor in (0.0, 1.0):
        moved = replace(made, errors=made.errors + 0.1 * vector * (1 + factor * of_pair))
        added = errors_by_scattering(moved, np.full((2, 3), 0.2**2)).of_model
        assert added.mean() == pytest.approx(0.1, abs=0.01)
        spread.append(np.ptp(added.mean(axis=(0, 2))))
    assert spread[0] < 0.02
    assert spread[1] == pytest.approx(2 * 0.1, rel=0.15)


def test_an_error_may_grow_where_little_is_scattered():
    made = runs(np.random.default_rng(6), noise=0.0)
    columns = basis(made.levels, [m == "vector" for m in made.models])
    growth = np.ones((RUNS, 2))
    growth[:, 0] = made.levels.mean() / made.levels  # of T20, not of EDT
    slope = 2 * columns[:, 2, np.newaxis, np.newaxis, np.newaxis]
    grown = replace(made, errors=made.errors * growth[:, :, np.newaxis, np.newaxis] + slope)
    fit = errors_by_scattering(grown, np.zeros((2, 3)))
    variances = [
        np.diag(fit.covariance(level, "random")).reshape(2, -1).mean(axis=1)
        for level in (0.2, 0.75)
    ]
    ratio = variances[0] / variances[1]
    assert ratio[0] > 7  # (0.75 / 0.2)² = 14; 1 with one covariance for all levels
    assert ratio[1] == pytest.approx(1.0, abs=0.4)


def test_a_control_run_far_from_all_others_counts_little():
    made = runs(np.random.default_rng(7), noise=0.0)
    variances = []
    for factor in (1.0, 30.0):
        errors = made.errors[:16].copy()
        errors[5] *= factor
        few = replace(made, errors=errors, levels=made.levels[:16], models=made.models[:16])
        fit = errors_by_scattering(few, np.zeros((2, 3)))
        variances.append(np.diag(fit.covariance(0.475, "random")).mean())
    usual, with_one = variances
    assert with_one < 8 * usual  # by least squares some 50 times


def test_groups_of_paths_have_the_mean_of_all_and_their_noise():
    hall = halls.corridor()
    tracer = PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources=hall.sources,
        receivers=hall.receivers,
        n_paths=1600,
        n_batches=16,
    )
    groups = tracer.observe_in_groups(hall.room.alpha, 4, ("level",))
    every = tracer.observe(hall.room.alpha, ("level",)).values
    energy = (10 ** (groups / 10)).mean(axis=0)
    np.testing.assert_allclose(10 * np.log10(energy), every, rtol=0, atol=1e-6)
    assert groups.std(axis=0).min() > 0
    with pytest.raises(DataError, match="number = 5 must divide n_batches = 16"):
        tracer.observe_in_groups(hall.room.alpha, 5)


def test_small_unexplained_errors_are_found():
    """Each parameter has its own; what all values have in common is no part of it."""
    rng, of = np.random.default_rng(2), np.repeat([0, 1], 90)
    unit = np.array([0.05, 1.0])[of]
    common = rng.standard_normal((180, 10))
    expected = np.outer(unit, unit) * (common @ common.T + np.diag(np.full(180, 0.2**2)))
    own = np.array([0.3, 0.6])[of] * unit
    # By Cholesky's factor: the singular vectors, numpy's default, differ from processor to processor.
    root = np.linalg.cholesky(expected + np.diag(own**2))
    found = unexplained_errors(root @ rng.standard_normal(180), expected, unit, of)
    assert found == pytest.approx([0.3, 0.6], rel=0.4)  # 90 values know it to 15 %
