"""The sampler of coupled posteriors: against quadrature, and its own claims."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import log_ndtr

import rtcal as rt
from rtcal import terms
from rtcal.calibration.posterior import distribution
from rtcal.calibration.posterior.density import CoupledBands
from rtcal.support.sampler import JointTruncatedNormal, sample, truncated_normal
from tests.conftest import random_room, true_times

EYRING = rt.Eyring()
LOOSE = [terms.GroupAbsorption(["m0"], most=10_000.0)]  # never binds, but asks for samples


def hard_room(rng: np.random.Generator, n: int, k: int) -> tuple[rt.Room, np.ndarray]:
    """A room whose coefficients and sigmas span decades, and a T far from its prediction."""
    room = random_room(rng, n, k, air=rt.Air(20, 50))
    alpha = np.clip(room.alpha * 10 ** -rng.uniform(0, 2, (n, 1)), 0.005, 1)
    room = room.replace(alpha=alpha, sigma=room.sigma * 10 ** -rng.uniform(0, 2, (n, 1)))
    return room, true_times(rng, room, EYRING) * 10 ** rng.uniform(-0.1, 0.1)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        (-np.inf, np.inf),
        (-1.0, 2.0),
        (-3.0, -1.0),
        (0.5, np.inf),
        (24.9, np.inf),
        (25.1, np.inf),
        (26.0, 1e300),
        (-1e300, 1e300),
        (30.0, 30.01),
        (-40.0, -26.0),
        (-np.inf, -300.0),
        (1e4, np.inf),
    ],
)
def test_truncated_normal_quantiles(lower: float, upper: float) -> None:
    """The logarithm of the tail at each quantile, where the distribution function has no digits."""
    uniform = np.linspace(0.01, 0.99, 25)
    x = truncated_normal(np.full(25, lower), np.full(25, upper), uniform)
    assert ((x >= lower) & (x <= upper)).all()
    sign = -1 if lower + upper > 0 else 1
    a, b = (lower, upper) if sign == 1 else (-upper, -lower)
    share = uniform if sign == 1 else 1 - uniform
    # log of (1 - share) Phi(a) + share Phi(b), on the side of the smaller tail.
    wanted = log_ndtr(b) + np.log(share + (1 - share) * np.exp(log_ndtr(a) - log_ndtr(b)))
    np.testing.assert_allclose(log_ndtr(sign * x), wanted, rtol=1e-9, atol=2e-5)


def test_a_very_far_tail_is_exponential() -> None:
    uniform = np.linspace(0.01, 0.99, 25)
    x = truncated_normal(np.full(25, -2e8), np.full(25, -1e8), uniform) + 1e8
    np.testing.assert_allclose(x * 1e8, np.log(uniform), rtol=0.4, atol=2)
    start, width = np.full(25, 1e6), 2e-6
    inside = truncated_normal(start, start + width, uniform) - start
    share = -np.log1p(-uniform * -np.expm1(-width * 1e6)) / 1e6
    np.testing.assert_allclose(inside, share, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_samples_have_the_moments_of_the_exact_posterior(seed: int) -> None:
    """Bounds active, exact match or soft: means within 4.5 standard errors of quadrature's."""
    rng = np.random.default_rng(seed)
    room, t = hard_room(rng, 5, 2)
    objective, constraints = terms.PriorDeviation(), [terms.ExactMatch()]
    if seed % 2:
        objective, constraints = objective + terms.SoftMatch(0.02), []
    exact = distribution(rt.Calibration(objective, constraints).build(room).solve(t))
    drawn = distribution(
        rt.Calibration(objective, [*constraints, *LOOSE]).build(room).solve(t), 3200
    )
    assert drawn.effective_samples is not None
    assert drawn.effective_samples.min() > 400
    error = exact.sigma / np.sqrt(drawn.effective_samples)
    np.testing.assert_array_less(np.abs(drawn.mean - exact.mean), 4.5 * error + 1e-12)
    np.testing.assert_allclose(drawn.sigma, exact.sigma, rtol=0.15)
    np.testing.assert_allclose(drawn.prior_sigma, exact.prior_sigma, rtol=0.1)
    for probability in (0.05, 0.5, 0.95):
        offset = drawn.quantile(probability) - exact.quantile(probability)
        np.testing.assert_array_less(np.abs(offset), 8 * error + 1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_no_coupled_room_is_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, k = int(rng.integers(3, 8)), int(rng.integers(1, 5))
    room, t = hard_room(rng, n, k)
    prior = terms.PriorDeviation(band_correlation=float(rng.uniform(0.3, 0.95)))
    if seed % 2:
        calibration = rt.Calibration(prior, [terms.ExactMatch()])
    else:
        match = terms.SoftMatch(10 ** rng.uniform(-4, -1))
        calibration = rt.Calibration(prior + match + terms.BandSmoothness(), [])
    result = calibration.build(room).solve(t, unreachable="nearest")
    found = distribution(result, n_samples=1280)
    assert found.samples is not None
    assert np.isfinite(found.samples).all()
    assert found.samples.min() >= 0
    assert found.samples.max() <= 1
    moves = found.sigma > 0
    assert found.effective_samples is not None
    assert found.effective_samples[moves].min() > 160
    if seed % 2:
        area = np.einsum("i,sik->sk", room.areas, found.samples)
        np.testing.assert_allclose(area, np.tile(result.target, (1280, 1)), rtol=1e-9)


def small_density(seed: int = 0) -> JointTruncatedNormal:
    """Three coefficients with correlated bands, pressed against their bounds by T."""
    rng = np.random.default_rng(seed)
    room = random_room(rng, 3, 2, air=rt.Air(20, 50))
    room = room.replace(alpha=room.alpha / 20)
    t = EYRING.time(room, room.absorption_area * 0.6)
    calibration = rt.Calibration(terms.PriorDeviation(band_correlation=0.8), [terms.ExactMatch()])
    density = calibration.build(room).solve(t).density()
    assert isinstance(density, CoupledBands)
    return density.posterior


def test_effective_sample_size_is_that_of_the_mean() -> None:
    """Over 80 seeds the variance of the mean is the variance over the effective sample size."""
    density = small_density()
    runs = [sample(density, 256, seed) for seed in range(80)]
    means = np.array([run.values.mean(axis=0) for run in runs])
    variance = np.mean([run.values.var(axis=0) for run in runs], axis=0)
    effective = 1 / np.mean([1 / run.effective for run in runs], axis=0)
    ratio = means.var(axis=0, ddof=1) * effective / variance
    low, high = stats.chi2(79).ppf([0.0005, 0.9995]) / 79
    assert (ratio > low).all()
    assert (ratio < high).all()
    assert (effective < 256 * 1.3).all()


def test_a_seed_gives_its_samples() -> None:
    density = small_density()
    np.testing.assert_array_equal(sample(density, 300, 4).values, sample(density, 300, 4).values)
    assert (sample(density, 300, 4).values != sample(density, 300, 5).values).any()
    assert sample(density, 300, 4).values.shape == (300, 6)


def test_a_band_at_the_end_of_its_reach_is_held_and_the_other_sampled() -> None:
    """Bounds that the match makes equalities leave no volume: they are taken as equalities."""
    rng = np.random.default_rng(3)
    room = random_room(rng, 4, 2, air=rt.Air(20, 50))
    room = room.replace(alpha_min=np.full((4, 2), 0.1))
    t = EYRING.time(room, room.absorption_area)
    t[0] = EYRING.time(room, 0.05 * room.areas.sum() * np.ones(2))[0]
    calibration = rt.Calibration(terms.PriorDeviation(band_correlation=0.7), [terms.ExactMatch()])
    result = calibration.build(room).solve(t, unreachable="nearest")
    found = distribution(result, n_samples=1280)
    assert found.samples is not None
    np.testing.assert_allclose(found.samples[:, :, 0], 0.1, atol=1e-9)
    np.testing.assert_array_equal(found.sigma[:, 0], 0)
    np.testing.assert_array_equal(found.correlation[0], np.eye(4))
    assert found.correlation[1].min() < -0.1
    assert np.abs(found.correlation[1]).max() <= 1
    assert (found.sigma[:, 1] > 0.01).all()
    area = found.samples[:, :, 1] @ room.areas
    np.testing.assert_allclose(area, result.target[1], rtol=1e-9)


def test_too_many_unknowns_are_refused() -> None:
    size = 2001
    zeros, ones = np.zeros(size), np.ones(size)
    density = JointTruncatedNormal(
        point=zeros,
        gradient=zeros,
        curvature=ones,
        scale=ones,
        lower=-ones,
        upper=ones,
        matrix=np.zeros((0, size)),
        row_lower=np.zeros(0),
        row_upper=np.zeros(0),
    )
    with pytest.raises(rt.errors.ModelError, match="2001 unknowns are too many"):
        sample(density, 10, 0)
