"""The posterior: FFT against quadrature and against samples; sensitivity against re-solving."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import rtcal as rt
from rtcal import terms
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.posterior import distribution, sensitivity
from rtcal.calibration.posterior.marginals import marginal_distributions
from tests.conftest import also, random_room, true_times
from tests.quadrature import errors, random_band

EYRING = rt.Eyring()
PRIOR = terms.PriorDeviation()


def room_with(mu: float, sigma: float, n: int = 4) -> rt.Room:
    return rt.Room(
        name="r",
        volume=100,
        materials=[f"m{i}" for i in range(n)],
        areas=np.linspace(10, 40, n),
        alpha=np.full((n, 1), mu),
        sigma=np.full((n, 1), sigma),
        centre_frequencies=[1000],
    )


@pytest.mark.parametrize("uncertainty", [0.0, 0.6])
@pytest.mark.parametrize("target", [3.0, *also(6.0, 11.0), 20.0])
def test_marginals_of_two_against_quadrature(target: float, uncertainty: float) -> None:
    """Two coefficients, one of them cut by its bound; the target up to far in the tail."""
    mu, sigma, areas = np.array([0.05, 0.3]), np.array([0.05, 0.06]), np.array([20.0, 30.0])
    box = np.zeros(2), np.ones(2)
    d = (areas @ mu - target) / (areas**2 @ sigma**2 + uncertainty**2)
    found = marginal_distributions(mu, sigma, *box, areas, target, uncertainty, d)
    a = np.linspace(0, 1, 4001)
    prior = [stats.norm(m, s).logpdf(a) for m, s in zip(mu, sigma, strict=True)]
    if uncertainty:
        miss = (target - np.add.outer(areas[0] * a, areas[1] * a)) / uncertainty
        log = np.add.outer(*prior) - miss**2 / 2
        weight = np.exp(log - log.max())
        density = [weight.sum(axis=1), weight.sum(axis=0)]
    else:
        density = []
        for i, j in ((0, 1), (1, 0)):
            other = (target - areas[i] * a) / areas[j]
            log = prior[i] + stats.norm(mu[j], sigma[j]).logpdf(other)
            density.append(np.where((other >= 0) & (other <= 1), np.exp(log - log.max()), 0))
    for i in range(2):
        own = density[i] / np.trapezoid(density[i], a)
        mean = np.trapezoid(a * own, a)
        spread = np.sqrt(np.trapezoid((a - mean) ** 2 * own, a))
        assert found.mean[i] == pytest.approx(mean, abs=0.01 * spread)
        assert np.sqrt(found.covariance[i, i]) == pytest.approx(spread, rel=0.01)
    if not uncertainty:  # the sum is fixed: whatever one gains the other loses
        pair = found.covariance[0, 1] / np.sqrt(np.prod(np.diag(found.covariance)))
        assert pair == pytest.approx(-1, abs=0.02)


@pytest.mark.parametrize("seed", range(24))
def test_random_bands_against_quadrature(seed: int) -> None:
    """The first of the bands of benchmarks/studies/calibrations/posterior_accuracy.py."""
    rng = np.random.default_rng(seed)
    band = random_band(rng)
    _, sigma, width, correlation = errors(band, rng)
    assert sigma < 0.0005
    assert width < 0.001
    assert correlation < 0.001


def single_band(areas: list[float], alpha: float, sigma: list[float]) -> rt.Room:
    n = len(areas)
    return rt.Room(
        name="r",
        volume=1000,
        materials=[f"m{i}" for i in range(n)],
        areas=areas,
        alpha=np.full((n, 1), alpha),
        sigma=np.reshape(sigma, (n, 1)),
        centre_frequencies=[1000],
    )


@pytest.mark.parametrize("small", [0.01, 0.005, 0.002, 0.001, 1e-5])
def test_a_posterior_much_narrower_than_its_prior(small: float) -> None:
    """Far from the bounds it is normal; the first coefficient is what the five others leave."""
    areas = [300.0, 20.0, 10.0, 5.0, 40.0, 8.0]
    room = single_band(areas, 0.3, [0.05] + [small] * 5)
    result = rt.calibrate(room, EYRING.time(room, room.absorption_area * 1.0001))
    found = distribution(result)
    variance, s = room.sigma[:, 0] ** 2, room.areas
    covariance = np.diag(variance) - np.outer(variance * s, variance * s) / (s**2 @ variance)
    # diag - outer cancels for the first: its variance is what the others have.
    others = (s[1:] ** 2 @ variance[1:]) / s[0] ** 2
    covariance[0, 0] = others * variance[0] / (variance[0] + others)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.sigma[:, 0], sigma, rtol=1e-4)
    low, high = found.interval(0.9)
    np.testing.assert_allclose((high - low)[:, 0], 3.28971 * sigma, rtol=5e-4)
    correlation = covariance / np.outer(sigma, sigma)
    np.testing.assert_allclose(found.correlation[0], correlation, atol=1e-4)
    assert np.abs(found.correlation).max() <= 1


def test_two_coefficients_with_one_sum_have_correlation_minus_one() -> None:
    room = single_band([2.0, 200.0], 0.5, [0.01, 0.2])
    found = distribution(rt.calibrate(room, EYRING.time(room, room.absorption_area)))
    np.testing.assert_allclose(found.correlation[0], [[1, -1], [-1, 1]], atol=1e-9)
    np.testing.assert_allclose(found.sigma[:, 0], [0.01, 0.0001], rtol=1e-4)


@pytest.mark.parametrize("sigma", [[0.05, 0.0, 0.0], [0.0, 0.0, 0.0]])
def test_a_coefficient_that_the_match_determines_has_a_point_interval(sigma: list[float]) -> None:
    room = single_band([30.0, 20.0, 10.0], 0.3, sigma)
    target = room.absorption_area + (1.5 if any(sigma) else 0.0)
    result = rt.calibrate(room, EYRING.time(room, target))
    found = distribution(result)
    for end in (*found.interval(0.9), *result.interval, found.mean):
        np.testing.assert_allclose(end, result.alpha, rtol=1e-12)
    np.testing.assert_array_equal(found.sigma, 0)
    np.testing.assert_array_equal(found.correlation[0], np.eye(3))
    saved = [m["interval_after"] for m in result.to_dict()["materials"]]
    np.testing.assert_allclose(saved, result.alpha[:, np.newaxis].repeat(2, 1), rtol=1e-12)


@pytest.mark.parametrize("target", [1.0, 100.0])
def test_an_unreachable_target_leaves_one_answer(target: float) -> None:
    room = single_band([30.0, 20.0, 10.0], 0.3, [0.05] * 3)
    room = room.replace(alpha_min=np.full((3, 1), 0.1))
    time = rt.Sabine().time(room, np.array([target]))
    result = rt.calibrate(room, time, equation=rt.Sabine(), unreachable="nearest")
    np.testing.assert_array_equal(result.alpha, 0.1 if target == 1 else 1.0)
    found = distribution(result)
    np.testing.assert_array_equal(found.interval(0.9)[0], result.alpha)
    np.testing.assert_array_equal(found.interval(0.9)[1], result.alpha)
    np.testing.assert_array_equal(found.sigma, 0)
    assert np.isfinite(found.identifiability).all()


@pytest.mark.parametrize("end", [0, 1])
def test_a_target_within_rounding_of_an_end_is_that_end(end: int) -> None:
    mu, sigma, areas = np.full(3, 0.3), np.full(3, 0.05), np.array([30.0, 20.0, 10.0])
    box = np.full(3, 0.1), np.full(3, 0.7)
    sign = 1 - 2 * end
    for relative, width in ((6e-15, 0.0), (1e-9, 1e-10)):
        target = float(areas @ box[end]) * (1 + sign * relative)
        found = marginal_distributions(mu, sigma, *box, areas, target, 0.0, 0.0)
        np.testing.assert_allclose(found.mean, box[end], rtol=3 * relative)
        spread = np.ptp(found.points, axis=1)
        assert (spread > width / 10).all() if width else (spread == 0).all()
        assert np.isfinite(found.cumulative).all()


def test_intervals_of_many_materials_are_those_of_the_posterior() -> None:
    """More than the 40 materials that were once the most; one material and one band are held."""
    rng = np.random.default_rng(5)
    room = random_room(rng, 45, 2)
    sigma = room.sigma.copy()
    sigma[3] = 0
    room = room.replace(sigma=sigma)
    t = true_times(rng, room, EYRING)
    t[1] = np.nan
    result = rt.calibrate(room, t)
    low, high = distribution(result).interval(0.9)
    np.testing.assert_array_equal(result.interval[0], low)
    np.testing.assert_array_equal(result.interval[1], high)
    np.testing.assert_array_equal(low[3], room.alpha[3])
    assert (low[0] < high[0]).all()


def test_posterior_is_gaussian_far_from_the_box() -> None:
    rng = np.random.default_rng(0)
    room = random_room(rng, 6, 3)
    room = room.replace(sigma=room.sigma / 4)
    t = true_times(rng, room, EYRING)
    t[1] = np.nan
    result = rt.calibrate(room, t, method="soft")
    found = distribution(result)
    np.testing.assert_allclose(found.mean, result.alpha, atol=1e-6)
    np.testing.assert_allclose(found.sigma, result.posterior_sigma, rtol=1e-4)
    np.testing.assert_allclose(found.sigma[:, 1], room.sigma[:, 1], rtol=1e-4)
    np.testing.assert_allclose(found.identifiability[:, 1], 0, atol=1e-4)
    assert (found.identifiability[:, [0, 2]] > 1e-4).all()
    low, high = found.interval(0.9)
    np.testing.assert_allclose(high - low, 2 * 1.6449 * found.sigma, rtol=2e-3)
    k, prior = 0, room.sigma[:, 0] ** 2
    cov = np.diag(prior) - np.outer(prior * room.areas, prior * room.areas) / (
        room.areas**2 @ prior + result.target_uncertainty[k] ** 2
    )
    wanted = cov / np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
    np.testing.assert_allclose(found.correlation[k], wanted, atol=1e-4)


def test_at_a_small_alpha_the_gaussian_interval_is_wrong() -> None:
    """mu = sigma = 0.05: the 90 % interval stays within the box, the Gaussian one does not."""
    room = room_with(0.05, 0.05)
    result = rt.calibrate(room, EYRING.time(room, np.array([5.0])))
    assert not result.active.any()
    low, high = distribution(result).interval(0.9)
    assert (low > 0).all()
    assert (result.alpha - 1.645 * result.posterior_sigma < 0).any()
    assert (high - low < 2 * 1.645 * result.posterior_sigma).all()


def test_samples_agree_with_the_fft() -> None:
    """A constraint that never binds sends the same problem to the sampler."""
    rng = np.random.default_rng(4)
    room = random_room(rng, 5, 2)
    room = room.replace(alpha=np.clip(room.alpha - 0.2, 0.02, 1))
    t = true_times(rng, room, EYRING)
    soft = PRIOR + terms.SoftMatch(0.05)
    exact = distribution(rt.Calibration(soft, []).build(room).solve(t))
    loose = [terms.GroupAbsorption(["m0"], most=10_000.0)]
    drawn = distribution(rt.Calibration(soft, loose).build(room).solve(t), n_samples=6400)
    assert exact.samples is None
    assert drawn.samples is not None
    assert drawn.samples.shape == (6400, 5, 2)
    error = exact.sigma / np.sqrt(6400 / 4)  # as if every fourth sample counted
    np.testing.assert_array_less(np.abs(drawn.mean - exact.mean), 4 * error)
    np.testing.assert_allclose(drawn.sigma, exact.sigma, rtol=0.08)
    np.testing.assert_allclose(drawn.quantile(0.05), exact.quantile(0.05), atol=0.01)
    np.testing.assert_allclose(drawn.correlation, exact.correlation, atol=0.1)
    np.testing.assert_allclose(drawn.identifiability, exact.identifiability, atol=0.15)
    again = distribution(rt.Calibration(soft, loose).build(room).solve(t), n_samples=6400)
    np.testing.assert_array_equal(again.samples, drawn.samples)


def test_samples_keep_to_every_constraint() -> None:
    rng = np.random.default_rng(6)
    room = random_room(rng, 4, 3)
    t = true_times(rng, room, EYRING)
    calibration = rt.Calibration(
        terms.PriorDeviation(band_correlation=0.6)
        + terms.AddedAbsorption("opening", [1.0, 1.0, 1.0], sigma=1.0),
        [terms.ExactMatch(), terms.AtMost("m0", "m1"), terms.Fixed("m2", band=125)],
    )
    result = calibration.build(room).solve(t)
    found = distribution(result, n_samples=1280)
    assert found.samples is not None
    area = np.einsum("i,sik->sk", room.areas, found.samples) + found.effects["opening"][:, None]
    np.testing.assert_allclose(area, np.tile(result.target, (1280, 1)), rtol=1e-9)
    assert (found.samples[:, 0] <= found.samples[:, 1] + 1e-9).all()
    assert (found.samples[:, 2, 1] == room.alpha[2, 1]).all()
    assert (found.effects["opening"] >= 0).all()
    assert found.sigma[2, 1] < 1e-12
    assert found.effects["opening"].std() > 0.1
    assert found.identifiability.shape == (4, 3)


def test_several_configurations_are_sampled() -> None:
    a = room_with(0.3, 0.1)
    b = a.replace(name="b", areas=a.areas[::-1])
    truth = np.array([0.35, 0.25, 0.4, 0.3])
    times = [EYRING.time(r, np.atleast_1d(r.areas @ truth)) for r in (a, b)]
    both = rt.calibrate(Configurations([a, b]), times, method="joint")
    one = distribution(rt.calibrate(a, times[0], method="soft"))
    found = distribution(both, n_samples=3200)
    np.testing.assert_allclose(found.sigma, both.posterior_sigma, rtol=0.15)
    assert found.identifiability.sum() > one.identifiability.sum()


@pytest.mark.parametrize("method", ["mle", "soft", "smooth", "robust"])
def test_sensitivity_is_how_the_answer_follows_t(method: str) -> None:
    rng = np.random.default_rng(8)
    room = random_room(rng, 5, 3)
    room = room.replace(alpha=np.clip(room.alpha - 0.25, 0.01, 1))
    t = true_times(rng, room, EYRING) * 1.3
    result = rt.calibrate(room, t, method=method)
    assert result.active.any()
    slope = sensitivity(result.joint)
    assert slope.shape == (5, 3, 1, 3)
    np.testing.assert_array_equal(slope[result.active != 0], 0)
    for k in range(3):
        h = np.zeros(3)
        h[k] = 1e-5
        ends = [rt.calibrate(room, t + s * h, method=method).alpha for s in (-1, 1)]
        difference = (ends[1] - ends[0]) / 2e-5
        np.testing.assert_allclose(slope[:, :, 0, k], difference, rtol=1e-3, atol=1e-5)
    assert np.abs(slope).max() > 0.01
    if method == "mle":
        k = 0
        free = result.active[:, k] == 0
        own = room.areas * room.sigma[:, k] ** 2 * free
        wanted = own / (room.areas @ own) * EYRING.target_sensitivity(room, t)[k]
        np.testing.assert_allclose(slope[:, k, 0, k], wanted, rtol=1e-6)


def test_constraint_that_does_not_bind_changes_no_sensitivity() -> None:
    rng = np.random.default_rng(8)
    room = random_room(rng, 5, 3)
    t = true_times(rng, room, EYRING)
    loose = terms.GroupAbsorption(["m0", "m1"], most=10_000.0)
    free, limited = (
        rt.Calibration(PRIOR, [terms.ExactMatch(), *others]).build(room).solve(t)
        for others in ([], [loose])
    )
    np.testing.assert_allclose(
        sensitivity(limited.joint), sensitivity(free.joint), rtol=1e-9, atol=1e-15
    )


def test_multiplier_of_a_soft_match_balances_the_prior() -> None:
    """u_b is below 1 m² here, and D = (mu - alpha) / (S sigma²) for every coefficient."""
    room = room_with(0.3, 0.05, n=2)
    result = rt.calibrate(room, EYRING.time(room, np.array([14.0])), method="soft")
    bands = result.joint.density()
    assert bands.noise[0] < 1
    wanted = (room.alpha - result.alpha) / (room.areas[:, np.newaxis] * room.sigma**2)
    np.testing.assert_allclose(wanted, np.broadcast_to(bands.multiplier, (2, 1)), rtol=1e-9)


def test_posterior_sigma_of_any_composition_against_draws() -> None:
    """Truth and noise drawn 4,000 times, the composed estimate solved for each."""
    rng = np.random.default_rng(1)
    room = random_room(rng, 4, 2)
    room = room.replace(sigma=room.sigma / 3)
    calibration = rt.Calibration(
        terms.PriorDeviation(band_correlation=0.5)
        + terms.SoftMatch(0.02)
        + 0.5 * terms.BandSmoothness(),
        [],
    )
    problem = calibration.build(room)
    t = EYRING.time(room, room.absorption_area)
    base = problem.solve(t)
    u = base.posterior_sigma
    layout = base.joint.solution.model.data.layout
    factor = np.linalg.cholesky(terms.PriorDeviation(band_correlation=0.5).correlation(layout))
    b_slope = EYRING.target_sensitivity(room, t)
    gain = sensitivity(base.joint)[:, :, 0] / b_slope
    x = rng.standard_normal((4000, 8)) @ factor.T
    truth = x.reshape(-1, 4, 2) * room.sigma
    b = np.einsum("i,sik->sk", room.areas, truth)
    b += rng.standard_normal(b.shape) * base.target_uncertainty[0]
    error = np.einsum("iak,sk->sia", gain, b) - truth
    np.testing.assert_allclose(error.std(axis=0), u, rtol=0.06)


def test_what_is_no_density_has_no_posterior() -> None:
    room = room_with(0.3, 0.05)
    t = EYRING.time(room, np.array([30.0]))
    for method in ("lse", "robust"):
        with pytest.raises(rt.errors.ModelError, match="no posterior"):
            distribution(rt.calibrate(room, t, method=method))
    found = distribution(rt.calibrate(room, t))
    with pytest.raises(rt.errors.DataError, match="level = 1 "):
        found.interval(1.0)
    for probability in (0, 1):
        with pytest.raises(rt.errors.DataError, match=f"probability = {probability} "):
            found.quantile(probability)
