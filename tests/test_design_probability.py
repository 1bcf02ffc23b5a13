"""The probability that a prediction and a design state, beside importance sampling from the prior."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

import rtcal as rt
from rtcal.prediction import Assumptions, Change, changed
from tests.conftest import also, measurement_of, room_of

BANDS = np.array([250.0, 1000.0])
AXES = {"floor": (0, 0, 1), "ceiling": (0, 0, 1), "wall": (0.5, 0.5, 0)}
"""Shares of a surface's area across x, y and z, which its name says."""
U_T = 0.05
"""Relative standard uncertainty of the measured T."""


def a_room(seed):
    """A calibrated room, some of whose coefficients are near 0 beside what is not known of them."""
    rng = np.random.default_rng([57, 40, seed])
    x, y, z = np.exp(rng.uniform(np.log(3), np.log(8))) * np.array([1.4, 1.1, 0.65])
    alpha = np.clip(np.exp(rng.uniform(np.log(0.01), np.log(0.3), (3, 2))), 0.005, 0.6)
    sigma = np.maximum(rng.uniform(0.2, 0.9, (3, 2)) * alpha, 0.01)
    areas = [x * y, x * y, 2 * (x + y) * z]
    materials = dict(zip(AXES, zip(areas, alpha, sigma, strict=True), strict=True))
    room = room_of(materials, BANDS, x * y * z, air=rt.Air(20, 50))
    t = rt.Eyring().reverberation_time(room) * np.exp(0.15 * rng.standard_normal(2))
    measured = measurement_of(BANDS, u={"t20": U_T * t[np.newaxis]}, t20=t[np.newaxis])
    method = ("mle", "soft")[seed % 2]
    return rng, rt.calibrate(room, measured, method=method, unreachable="nearest"), t


def some_changes(rng, room):
    """Panels on the ceiling, and in half of the rooms screens that stand free."""
    panel = rt.Material("panel", rng.uniform(0.3, 0.9, 2), [0.1] * 2)
    screen = rt.Material("screen", rng.uniform(0.1, 0.6, 2), [0.05] * 2)
    put = [Change(cover="ceiling", by=panel, area=room.areas[1] * rng.uniform(0.2, 0.9))]
    if rng.random() < 0.5:
        put.append(Change(add=screen, area=room.areas[0] * rng.uniform(0.05, 0.3)))
    return put


def cut_normal(rng, n, mean, sigma, low, high):
    ends = ndtr((low - mean) / sigma), ndtr((high - mean) / sigma)
    return np.asarray(mean + sigma * ndtri(rng.uniform(*ends, n)))


def log_time(room, facing, absorption, u, band):
    """ln T of draws: u of the way through Eyring's, Arau-Puchades' and Fitzroy's T, as they rise."""
    free = room.areas - facing.sum(axis=1)
    axes = facing.sum(axis=0)
    spread = facing + np.outer(free, axes / axes.sum())
    air = 4 * room.air_attenuation[band] * room.volume
    whole = room.total_area

    def of(area, absorbed):
        return np.asarray(-whole * np.log1p(-np.minimum(absorbed / area, 0.999)) + air)

    by_axis = [sum(s * a for s, a in zip(column, absorption, strict=True)) for column in spread.T]
    areas = spread.sum(axis=0)
    each = [of(area, absorbed) for area, absorbed in zip(areas, by_axis, strict=True)]
    even = of(whole, sum(by_axis))
    share = areas / whole
    arau = -sum(g * np.log(e) for g, e in zip(share, each, strict=True)) + np.log(even)
    fitzroy = np.log(sum(g / e for g, e in zip(share, each, strict=True))) + np.log(even)
    constant = rt.Eyring().room_constant(room) * room.volume
    one, two, three = np.sort([np.zeros_like(arau), arau, fitzroy], axis=0)
    added = one + np.minimum(u, 1) * (two - one) + np.maximum(u - 1, 0) * (three - two)
    return np.asarray(np.log(constant / even) + added)


def sampled(n, result, t, changes, band):
    """Return n draws of T after changes in s, and their weights, (n,) each."""
    assumed, room, after = Assumptions(), result.prior, changed(result.prior, changes)
    rng = np.random.default_rng(band)
    names = list(dict.fromkeys([*room.materials, *after.materials]))
    stated = {m: r for r in (after, room) for m in r.materials}
    alpha, absorption = {}, {}
    for name in names:
        owner = stated[name]
        row = owner.materials.index(name)
        mean, sigma = float(owner.alpha[row, band]), float(owner.sigma[row, band])
        alpha[name] = cut_normal(rng, n, mean, sigma, 0.0, 1.0)
        known = result.alpha[row, band] if name in room.materials else mean
        least = assumed.least / max(known, assumed.least)
        factor = np.sqrt(assumed.factor**2 + least**2 + assumed.areas**2)
        absorption[name] = alpha[name] * np.exp(factor * rng.standard_normal(n))
    u = cut_normal(rng, n, assumed.evenness, assumed.evenness_sigma, 0.0, 2.0)

    # What the calibration says of alpha: S'alpha is b to within its uncertainty. After an exact match
    # that holds whatever the priors say of the sum, so that their density of it is divided by.
    area = sum(s * alpha[m] for s, m in zip(room.areas, room.materials, strict=True))
    b = float(result.equation.target(room, t)[band])
    noise = float(abs(result.equation.target_sensitivity(room, t)[band]) * U_T * t[band])
    log_weight = -0.5 * ((area - b) / noise) ** 2
    if result.method == "mle":
        density, edges = np.histogram(area, 400, density=True)
        smooth = np.convolve(density, np.ones(5) / 5, "same")
        at = np.interp(area, (edges[1:] + edges[:-1]) / 2, smooth)
        log_weight -= np.log(np.maximum(at, 1e-4 * smooth.max()))

    def of(state):
        facing = np.array(
            [
                np.multiply(AXES.get(m, (0, 0, 0)), s)
                for m, s in zip(state.materials, state.areas, strict=True)
            ]
        )
        if "panel" in state.materials:
            row = state.materials.index("panel")
            facing[row] = 0, 0, state.areas[row]
        return log_time(state, facing, [absorption[m] for m in state.materials], u, band)

    before = of(room)
    now = float(np.log(result.equation.time(room, room.areas @ result.alpha)[band]))
    log_weight -= 0.5 * ((now - before) / max(U_T, 0.02)) ** 2
    return np.exp(now + of(after) - before), np.exp(log_weight - log_weight.max())


@pytest.mark.parametrize(
    ("seed", "draws"), [(0, 600_000), *also((1, 600_000), *((s, 2_000_000) for s in range(2, 10)))]
)
def test_the_probability_is_that_of_importance_sampling_from_the_prior(seed, draws):
    rng, result, t = a_room(seed)
    changes = some_changes(rng, result.prior)
    made = result.predict(changes)
    high = np.exp(made.log_mean + rng.uniform(0.7, 1.8, 2) * made.log_sigma)
    low = high / rng.uniform(1.3, 2.5, 2)
    found = made.probability(low, high)
    compared = 0
    for k in range(len(BANDS)):
        time, weight = sampled(draws, result, t, changes, k)
        effective = weight.sum() ** 2 / (weight**2).sum()
        if effective < 15_000:  # its own noise would be above 0.003
            continue
        inside = (time >= low[k]) & (time <= high[k])
        assert found[k] == pytest.approx((weight * inside).sum() / weight.sum(), abs=0.01)
        compared += 1
    assert compared > 0
