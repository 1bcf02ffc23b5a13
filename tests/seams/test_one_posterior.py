"""Law: interval, standard deviation, samples, file and page speak of one distribution, which covers."""

from unittest.mock import patch

import numpy as np
import pytest

import rtcal as rt
from benchmarks.studies.calibrations import interval_coverage
from rtcal import terms
from rtcal.calibration.posterior import distribution
from tests.conftest import also, measurement_of, room_of

EYRING = rt.Eyring()
METHODS = ("mle", "soft")


def room(n, alpha=0.3, sigma=0.02):
    areas = enumerate(np.linspace(20, 60, n))
    materials = {f"m{i}": (area, alpha, sigma) for i, area in areas}
    return room_of(materials, [500, 1000], 200, air=rt.Air(20, 50))


def measured(t, relative):
    return measurement_of([500, 1000], u={"t20": relative * t[np.newaxis]}, t20=t[np.newaxis])


def solved(n, method, relative, more=1.05, **prior):
    stated = room(n, **prior)
    t = EYRING.time(stated, more * stated.absorption_area)
    return rt.calibrate(stated, measured(t, relative), method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("n", [1, 2, 6])
@pytest.mark.parametrize("relative", [0.02, *also(0.002, 0.1)])
def test_far_from_the_bounds_all_say_the_same(n, method, relative):
    result = solved(n, method, relative)
    low, high = result.interval
    np.testing.assert_allclose(
        (low + high) / 2, result.alpha, atol=0.01 * result.posterior_sigma.max()
    )
    # Quantiles are read from 201 points.
    np.testing.assert_allclose((high - low) / 2, 1.6449 * result.posterior_sigma, rtol=5e-3)
    known = distribution(result)
    np.testing.assert_allclose(known.sigma, result.posterior_sigma, rtol=2e-3)
    np.testing.assert_array_equal(known.interval(0.9), (low, high))
    entry = result.to_dict()["materials"][0]
    np.testing.assert_allclose(entry["interval_after"], [low[0], high[0]], rtol=1e-12)
    np.testing.assert_allclose(entry["sigma_after"], result.room.sigma[0], rtol=1e-12)


def test_one_material_is_as_uncertain_as_its_time():
    """Its coefficient is b / S: u_T alone is what can be off."""
    result = solved(1, "mle", 0.1)
    low, high = result.interval
    u = result.target_uncertainty / result.prior.areas[0]
    np.testing.assert_allclose((high - low)[0] / 2, 1.6449 * u, rtol=2e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [*range(4), *also(*range(4, 12))])
def test_the_interval_holds_its_own_value(method, seed):
    """Also at a bound, and where T is beyond reach."""
    rng = np.random.default_rng(seed)
    stated = room(int(rng.integers(1, 7)))
    end = seed % 2
    stated = stated.replace(alpha=np.abs(end - rng.uniform(0.01, 0.1, stated.alpha.shape)))
    t = EYRING.time(stated, stated.absorption_area) * rng.choice([0.7, 1.4])
    result = rt.calibrate(stated, measured(t, 0.1), method, unreachable="nearest")
    low, high = result.interval
    assert (low <= result.alpha).all()
    assert (result.alpha <= high).all()
    assert ((low >= 0) & (high <= 1)).all()
    other = distribution(result).interval(0.5)
    assert ((other[0] <= result.alpha) & (result.alpha <= other[1])).all()


def test_a_constraint_that_never_binds_leaves_the_same_distribution():
    stated = room(4)
    t = measured(EYRING.time(stated, 1.05 * stated.absorption_area), 0.1)
    loose = [terms.ExactMatch(), terms.GroupAbsorption(["m0"], most=10_000.0)]
    drawn = rt.Calibration(terms.PriorDeviation(), loose).build(stated).solve(t)
    known, exact = distribution(drawn), distribution(rt.calibrate(stated, t))
    np.testing.assert_allclose(known.sigma, exact.sigma, rtol=0.06)
    np.testing.assert_allclose(known.mean, exact.mean, atol=0.1 * exact.sigma.max())
    np.testing.assert_allclose(drawn.posterior_sigma, exact.sigma, rtol=2e-3)


@pytest.mark.long
@pytest.mark.parametrize("method", ["soft", *also("mle")])
def test_the_interval_covers(method):
    """The first 160 rooms of benchmarks/studies/calibrations/interval_coverage.py: 0.9 ± 0.013."""
    with patch.object(interval_coverage, "METHODS", (method,)):
        found = list(interval_coverage.rows(160))
    weight, share = np.array([[row[1], row[4]] for row in found]).T
    assert weight @ share / weight.sum() == pytest.approx(0.9, abs=0.03)
    assert len({row[1] for row in found}) == interval_coverage.MOST
