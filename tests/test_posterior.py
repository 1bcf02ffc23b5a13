"""The posterior: its engine against quadrature and plain draws; sensitivity against re-solving."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import log_ndtr

import rtcal as rt
from rtcal import terms
from rtcal.calibration.posterior import distribution, draws, samples, sensitivity
from rtcal.support.normal import NORMAL, quantile_and_mass
from tests.conftest import also, in_order, random_room, room_of, true_times
from tests.quadrature import errors, random_band

EYRING = rt.Eyring()


def room_with(mu, sigma, n=4):
    areas = enumerate(np.linspace(10, 40, n))
    return room_of({f"m{i}": (area, mu, sigma) for i, area in areas}, [1000])


@pytest.mark.parametrize("seed", [*range(8), *also(*range(8, 24))])
def test_random_bands_against_quadrature(seed):
    """Scales over six decades, T up to hundreds of sigma off; of 150 bands the worst errs by 0.039."""
    rng = np.random.default_rng(seed)
    _, sigma, width = errors(random_band(rng), rng)
    assert sigma < 0.03
    assert width < 0.03


def single_band(areas, alpha, sigma):
    rows = enumerate(zip(areas, sigma, strict=True))
    return room_of({f"m{i}": (area, alpha, u) for i, (area, u) in rows}, [1000], 1000)


@pytest.mark.parametrize("small", [0.01, 0.005, 0.002, 0.001, 1e-5])
def test_a_posterior_much_narrower_than_its_prior(small):
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
    np.testing.assert_allclose(found.sigma[:, 0], sigma, rtol=1e-3)
    low, high = found.interval(0.9)
    np.testing.assert_allclose((high - low)[:, 0], 3.28971 * sigma, rtol=5e-4)
    correlation = covariance / np.outer(sigma, sigma)
    np.testing.assert_allclose(found.correlation[0], correlation, atol=0.02)
    assert np.abs(found.correlation).max() <= 1


@pytest.mark.parametrize("sigma", [[0.05, 0.0, 0.0], [0.0, 0.0, 0.0]])
def test_a_coefficient_that_the_match_determines_has_a_point_interval(sigma):
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


def test_samples_keep_to_every_constraint():
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
    area = np.einsum("i,sik->sk", room.areas, found.samples) + found.effects["opening"][:, None]
    np.testing.assert_allclose(area, np.tile(result.target, (1280, 1)), rtol=1e-9)
    assert (found.samples[:, 0] <= found.samples[:, 1] + 1e-9).all()
    assert (found.samples[:, 2, 1] == room.alpha[2, 1]).all()
    assert (found.effects["opening"] >= 0).all()
    assert found.sigma[2, 1] < 1e-12
    assert found.effects["opening"].std() > 0.1
    assert found.identifiability.shape == (4, 3)


@pytest.mark.parametrize("method", ["mle", "soft", "smooth", "robust"])
def test_sensitivity_is_how_the_answer_follows_t(method):
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


def test_posterior_sigma_of_any_composition_against_draws():
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
    layout = base.joint.composition.layout
    factor = np.linalg.cholesky(
        terms.PriorDeviation(band_correlation=0.5).correlate(np.eye(layout.n_alpha), layout)
    )
    b_slope = EYRING.target_sensitivity(room, t)
    gain = sensitivity(base.joint)[:, :, 0] / b_slope
    x = rng.standard_normal((4000, 8)) @ factor.T
    truth = x.reshape(-1, 4, 2) * room.sigma
    b = np.einsum("i,sik->sk", room.areas, truth)
    b += rng.standard_normal(b.shape) * base.target_uncertainty[0]
    error = np.einsum("iak,sk->sia", gain, b) - truth
    np.testing.assert_allclose(error.std(axis=0), u, rtol=0.06)


def test_what_is_no_density_has_no_posterior():
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


def coupled(seed=0, **keywords):
    """Three coefficients in two bands, pressed against their bounds by T."""
    room = random_room(np.random.default_rng(seed), 3, 2, air=rt.Air(20, 50))
    room = room.replace(alpha=room.alpha / 20, **keywords)
    return room, EYRING.time(room, room.absorption_area * 0.6)


def whole(parts, size):
    """Quantiles of all unknowns, (size, 201)."""
    table = np.empty((size, len(NORMAL)))
    for part in parts:
        table[part.unknowns] = part.quantiles
    return table


@pytest.mark.parametrize("exact", [True, False])
def test_a_coupled_density_is_that_of_plain_draws(exact):
    """Bands correlate: the normal density is drawn, and what breaks a bound is left out."""
    room, t = coupled()
    prior = terms.PriorDeviation(band_correlation=0.8)
    objective, match = (
        (prior, [terms.ExactMatch()]) if exact else (prior + terms.SoftMatch(0.1), [])
    )
    density = rt.Calibration(objective, match).build(room).solve(t).joint.density()
    covariance = np.linalg.inv(density.curvature.toarray())
    mean = density.point - covariance @ density.gradient
    if exact:
        rows = np.asarray(density.matrix @ np.eye(6))
        gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T)
        mean = mean + gain @ (density.row_lower - rows @ mean)
        covariance = covariance - gain @ rows @ covariance
    value, vector = np.linalg.eigh(covariance)
    root = vector * np.sqrt(np.maximum(value, 0))
    plain = mean + np.random.default_rng(1).standard_normal((400_000, 6)) @ root.T
    plain = plain[((plain >= density.lower) & (plain <= density.upper)).all(axis=1)]
    assert 2_000 < len(plain) < 200_000
    parts = draws(density)
    assert [len(part.unknowns) for part in parts] == [6]
    assert parts[0].effective > 500
    spread, found = plain.std(axis=0), whole(parts, 6)
    for p in (0.05, 0.5, 0.95):
        got = [np.interp(stats.norm.ppf(p), NORMAL, row) for row in found]
        error = 0.02 + 4 * np.sqrt(p * (1 - p) / len(plain)) / 0.1
        np.testing.assert_allclose(got / spread, np.quantile(plain, p, axis=0) / spread, atol=error)
    of_samples = samples(density, parts, 4096, 0)
    np.testing.assert_allclose(np.cov(of_samples.T), np.cov(plain.T), atol=0.1 * spread.max() ** 2)


def test_draws_are_the_same_twice_and_follow_names_not_places():
    room, t = coupled()
    one, again = (distribution(rt.calibrate(room, t)) for _ in range(2))
    np.testing.assert_array_equal(one.samples, again.samples)
    turned = in_order(room, [2, 1, 0])
    other = distribution(rt.calibrate(turned, t))
    np.testing.assert_allclose(other.points[::-1], one.points, rtol=1e-6, atol=1e-9)
    assert (distribution(rt.calibrate(room, t), seed=1).samples != one.samples).any()


def test_a_band_at_the_end_of_its_reach_is_held_and_the_other_drawn():
    """Bounds that the match makes equalities leave no volume: they are taken as equalities."""
    rng = np.random.default_rng(3)
    room = random_room(rng, 4, 2, air=rt.Air(20, 50))
    room = room.replace(alpha_min=np.full((4, 2), 0.1))
    t = EYRING.time(room, room.absorption_area)
    t[0] = EYRING.time(room, 0.05 * room.areas.sum() * np.ones(2))[0]
    calibration = rt.Calibration(terms.PriorDeviation(band_correlation=0.7), [terms.ExactMatch()])
    result = calibration.build(room).solve(t, unreachable="nearest")
    found = distribution(result)
    np.testing.assert_allclose(found.samples[:, :, 0], 0.1, atol=1e-9)
    np.testing.assert_array_equal(found.sigma[:, 0], 0)
    np.testing.assert_array_equal(found.correlation[0], np.eye(4))
    assert found.correlation[1].min() < -0.1
    assert (found.sigma[:, 1] > 0.01).all()
    area = found.samples[:, :, 1] @ room.areas
    np.testing.assert_allclose(area, result.target[1], rtol=1e-9)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        (-np.inf, np.inf),
        (-1.0, 2.0),
        (-3.0, -1.0),
        (0.5, np.inf),
        (7.9, np.inf),
        (8.1, np.inf),
        (26.0, 1e300),
        (-1e300, 1e300),
        (30.0, 30.01),
        (-40.0, -26.0),
        (-np.inf, -300.0),
        (1e4, np.inf),
    ],
)
def test_truncated_normal_quantiles(lower, upper):
    """The logarithm of the tail at each quantile, where the distribution function has no digits."""
    uniform = np.linspace(0.01, 0.99, 25)
    x, mass = quantile_and_mass(np.full(25, lower), np.full(25, upper), uniform)
    assert ((x >= lower) & (x <= upper)).all()
    sign = -1 if lower + upper > 0 else 1
    a, b = (lower, upper) if sign == 1 else (-upper, -lower)
    share = uniform if sign == 1 else 1 - uniform
    # log of (1 - share) Phi(a) + share Phi(b), on the side of the smaller tail.
    ratio = np.exp(log_ndtr(a) - log_ndtr(b))
    wanted = log_ndtr(b) + np.log(share + (1 - share) * ratio)
    np.testing.assert_allclose(log_ndtr(sign * x), wanted, rtol=1e-9, atol=2e-5)
    np.testing.assert_allclose(mass, log_ndtr(b) + np.log1p(-ratio), rtol=1e-9, atol=1e-9)
