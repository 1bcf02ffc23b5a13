"""Calibration to every position: nearer to the truth than T alone, and what the result says."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.datasets import halls
from rtcal.errors import DataError
from rtcal.loop.positions_result import PositionsResult
from rtcal.simulators import PathTracing

MATCH = ("t20", "edt", "c80", "ts", "level")
HALL = halls.lecture_hall()


def tracing(room, **options):
    settings = {"n_paths": 1600, "scattering": 0.5} | options
    return PathTracing(
        geometry=HALL.geometry,
        room=room,
        sources=HALL.sources,
        receivers=HALL.receivers,
        **settings,
    )


def heard(room, alpha, **options):
    """Return what another tracing of the room measures, with its levels."""
    other = tracing(room, **options)
    seen = other.observe(alpha, MATCH, seed=77)
    return rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        pairs=seen.pairs,
        values={("g" if p == "level" else p): seen.natural(p) for p in MATCH},
    )


@pytest.fixture(scope="module")
def case():
    """The hall with a wide prior, true coefficients drawn from it, and what was heard there."""
    room = HALL.room.replace(sigma=0.3 * HALL.room.alpha)
    rng = np.random.default_rng(5)
    truth = np.clip(rng.normal(room.alpha, room.sigma), 0.01, 0.99)
    return room, truth, heard(room, truth, scattering=0.35, n_paths=4000)


@pytest.fixture(scope="module")
def result(case, tmp_path_factory):
    room, _, measured = case
    cache = tmp_path_factory.mktemp("cache")
    return rt.calibrate_simulator(tracing(room), room, measured, match=MATCH, cache=cache)


def error(room, alpha, truth):
    return np.sqrt(room.areas @ ((alpha - truth) ** 2).mean(axis=1) / room.total_area)


def test_it_is_nearer_to_the_truth_than_the_prior(case, result):
    room, truth, _ = case
    assert isinstance(result, PositionsResult)
    assert error(room, result.alpha, truth) < 0.8 * error(room, room.alpha, truth)
    low, high = result.interval
    assert 0.8 < np.mean((low <= truth) & (truth <= high)) <= 1


def test_gaps_shrink_in_every_parameter(result):
    before, after = (
        np.sqrt(np.mean(gap**2, axis=(1, 2))) for gap in (result.gap_before, result.gap_after)
    )
    assert before.shape == (5,)
    assert (after < before).all()


def test_t20_alone_stays_the_default(case):
    room, _, measured = case
    default = rt.calibrate_simulator(tracing(room), room, measured)
    stated = rt.calibrate_simulator(tracing(room), room, measured, match=("t20",))
    np.testing.assert_array_equal(default.alpha, stated.alpha)
    with pytest.raises(DataError, match="exclude does not go with match"):
        rt.calibrate_simulator(tracing(room), room, measured, exclude=[("S", "R1")])
    with pytest.raises(DataError, match="rule does not go with match"):
        rt.calibrate_simulator(tracing(room), room, measured, rule="secant", match=MATCH)
