"""The exact batch solver: against rational arithmetic, NumPy, the definitions, bad input."""

import functools
from fractions import Fraction

import numpy as np
import pytest

from rtcal.calibration import exact, exact_kernel
from rtcal.support.errors import DataError
from tests import rational
from tests.problems import problems

EPS = np.finfo(float).eps
COUNTS = [500, pytest.param(5000, marks=pytest.mark.long)]
STATUS = {"below": exact.BELOW, "above": exact.ABOVE}


def by_size(found):
    sizes = {}
    for i, p in enumerate(found):
        sizes.setdefault(p.mu.size, []).append(i)
    return sizes


def end_distance(p):
    """Return the distance of b outside the ends, exactly, over the tolerance that makes it the end."""
    held = p.sigma == 0
    low, high = (
        sum(
            (
                Fraction(s) * Fraction(x)
                for s, x in zip(p.areas, np.where(held, p.mu, bound), strict=True)
            ),
            Fraction(0),
        )
        for bound in (0.0, 1.0)
    )
    b = Fraction(p.target)
    return float(max(low - b, b - high) / (Fraction(16 * p.mu.size * EPS) * high))


@functools.cache
def truth(count):
    found = list(problems(count))
    return found, [
        rational.solve(p.mu.tolist(), p.sigma.tolist(), p.areas.tolist(), p.target) for p in found
    ]


@pytest.mark.long
@pytest.mark.parametrize("count", COUNTS)
def test_against_rational_arithmetic(count):
    found, right = truth(count)
    worst, infeasible, snapped = 0.0, 0, 0
    for indices in by_size(found).values():
        chosen = [found[i] for i in indices]
        mu, sigma, areas = (
            np.array([getattr(p, k) for p in chosen]) for k in ("mu", "sigma", "areas")
        )
        target = np.array([p.target for p in chosen])
        alpha, multiplier, status = exact.solve(mu, sigma, areas, target)
        assert alpha.min(where=status[:, np.newaxis] == 0, initial=0) == 0
        assert alpha.max(where=status[:, np.newaxis] == 0, initial=1) == 1
        for j, i in enumerate(indices):
            p, answer = found[i], right[i]
            if isinstance(answer, str):
                outside = end_distance(p)
                assert abs(outside - 1) > 0.01, "a problem sits on the tolerance itself"
                if outside > 1:
                    infeasible += 1
                    assert status[j] == STATUS[answer]
                    assert np.isnan(alpha[j]).all()
                    assert np.isnan(multiplier[j])
                    continue
                snapped += 1
                answer = [Fraction(x) for x in np.where(p.sigma == 0, p.mu, answer == "above")]
            assert status[j] == exact.OK
            worst = max(worst, *(abs(float(x) - a) for x, a in zip(answer, alpha[j], strict=True)))
            held = p.sigma == 0
            assert np.array_equal(alpha[j][held], p.mu[held])
    assert infeasible > count // 10
    assert snapped > count // 500
    assert worst < 1e-11
    assert worst > 0  # an answer compared with itself would be 0


@functools.cache
def variants():
    """Arguments of `exact.solve`, its options, and the right answer: bounds, soft match."""
    rng = np.random.default_rng(5)
    found = []
    for p in problems(105, seed=11):
        n = p.mu.size
        lower, upper = rng.uniform(0, 0.3, n), rng.uniform(0.4, 1, n)
        mu = np.where(p.sigma == 0, 0.5 * (lower + upper), p.mu)
        least, most = (float(p.areas @ np.where(p.sigma == 0, mu, x)) for x in (lower, upper))
        b = least + rng.uniform(1e-6, 1 - 1e-6) * (most - least)
        data = [x.tolist() for x in (mu, p.sigma, p.areas)]
        bounds = [x.tolist() for x in (lower, upper)]
        arrays = (mu, p.sigma, p.areas, b, lower, upper)
        found.append((arrays, {}, rational.solve(*data, b, *bounds)))
        # a soft match is one more coefficient, of area 1, mean 0, sigma u and no bounds
        u = float(10 ** rng.uniform(-3, 1))
        asked = b + float(rng.normal(0, 3 * u))
        more = [[*x, y] for x, y in zip((*data, *bounds), (0.0, u, 1.0, -1e6, 1e6), strict=True)]
        right = rational.solve(*more[:3], asked, *more[3:])
        found.append(((*arrays[:3], asked, lower, upper), {"uncertainty": u}, right[:n]))
    return found


@pytest.mark.long
def test_bounds_per_coefficient_and_soft_against_rational_arithmetic():
    active, worst = 0, 0.0
    for arrays, options, right in variants():
        alpha, d, status = exact.solve(*arrays, **options)
        assert status == exact.OK
        worst = max(worst, *(abs(float(x) - a) for x, a in zip(right, alpha, strict=True)))
        active += int(np.sum((alpha == arrays[4]) | (alpha == arrays[5])))
        if "uncertainty" in options:
            u = options["uncertainty"]
            miss = float(arrays[2] @ alpha) - arrays[3]
            assert d == pytest.approx(miss / u**2, rel=1e-6, abs=1e-9 / u**2)
    assert worst < 1e-11
    assert active > 1000


def test_multiplier_is_the_papers_d():
    """With it every answer meets the optimality conditions, and so is the optimum."""
    checked = 0
    for p in problems(210, seed=2):
        alpha, d, status = exact.solve(p.mu, p.sigma, p.areas, p.target)
        if status != exact.OK or not np.any(p.sigma > 0):
            continue
        np.testing.assert_allclose(p.areas @ alpha, p.target, atol=1e-12 * p.areas.sum())
        w = p.areas * p.sigma**2
        leaves_low, leaves_high = (p.mu / w, (p.mu - 1) / w) if np.all(w > 0) else (None, None)
        at_low, at_high = (alpha == 0) & (w > 0), (alpha == 1) & (w > 0)
        free = (w > 0) & ~at_low & ~at_high
        np.testing.assert_allclose(p.mu[free] - d * w[free], alpha[free], rtol=0, atol=1e-11)
        if leaves_low is not None and not np.any(free):  # an end: its multiplier nearest 0
            want = leaves_low.max() if at_low.all() else leaves_high.min()
            assert d == pytest.approx(want, rel=1e-12)
            checked += 1
        else:  # at a bound the clipped formula must stay outside the bound
            assert np.all(p.mu[at_low] - d * w[at_low] <= 1e-11)
            assert np.all(p.mu[at_high] - d * w[at_high] >= 1 - 1e-11)
    assert checked > 5


def test_the_ends():
    """b within 16 n eps sum |S bound| of an end is that end; beyond, it is out of reach."""
    areas = np.array([0.1, 33.3, 7.7])
    mu, sigma = np.array([0.2, 0.4, 0.6]), np.array([0.05, 0.1, 0.0])
    least, most = 0.6 * 7.7, 0.1 + 33.3 + 0.6 * 7.7
    near = 16 * 3 * EPS * most
    target = np.array(
        [
            least,
            least - near / 2,
            least + near / 2,
            least - 3 * near,
            most,
            most + near / 2,
            most - near / 2,
            most + 3 * near,
        ]
    )
    alpha, d, status = exact.solve(mu, sigma, areas, target)
    assert status.tolist() == [0, 0, 0, 1, 0, 0, 0, 2]
    assert np.array_equal(alpha[:3], np.tile([0, 0, 0.6], (3, 1)))
    assert np.array_equal(alpha[4:7], np.tile([1, 1, 0.6], (3, 1)))
    w = areas * sigma**2
    assert d[:3] == pytest.approx(max(0.2 / w[0], 0.4 / w[1]))
    assert d[4:7] == pytest.approx(min(-0.8 / w[0], -0.6 / w[1]))
    # nothing can move: feasible only at S'mu
    held = exact.solve(mu, np.zeros(3), areas, [mu @ areas, mu @ areas + 1, 1.0])
    assert held.status.tolist() == [0, 2, 1]
    assert np.array_equal(held.alpha[0], mu)
    assert held.multiplier[0] == 0
    # a point where all coefficients are at a bound, though not an end
    corner = exact.solve([-1.0, 2.0], [1.0, 1.0], [2.0, 3.0], 3.0)
    assert corner.alpha.tolist() == [0, 1]
    assert corner.multiplier == pytest.approx(1 / 3)  # of [-1/2, 1/3] the end nearest 0


def test_bad_rows_are_status_3_and_leave_the_others_alone():
    mu, sigma, areas = np.full((10, 3), 0.5), np.full((10, 3), 0.1), np.full((10, 3), 2.0)
    lower, upper, target = np.zeros((10, 3)), np.ones((10, 3)), np.full(10, 2.5)
    u = np.zeros(10)
    mu[1, 0] = np.nan
    sigma[2, 1] = -0.1
    areas[3, 2] = -2.0
    target[4] = np.inf
    lower[5, 0], upper[5, 0] = 0.7, 0.6
    mu[6, 1], sigma[6, 1] = 1.2, 0.0  # held outside the bounds: no silent clipping
    upper[7, 0] = np.nan
    sigma[8, 0] = np.inf
    u[9] = -1.0
    alpha, d, status = exact.solve(mu, sigma, areas, target, lower, upper, uncertainty=u)
    assert status.tolist() == [0] + [3] * 9
    assert np.isnan(alpha[1:]).all()
    assert np.isnan(d[1:]).all()
    np.testing.assert_allclose(alpha[0], 2.5 / 6)


@pytest.mark.parametrize("tiny", [1e-170, 1e-160, 1e-145])
def test_a_sigma_whose_square_rounds_to_0_is_refused(tiny):
    sigma = [[tiny, tiny], [0.1, 0.1], [0.0, 0.1]]
    answer = exact.solve([0.1, 0.2], sigma, [10, 20], 7.0)
    assert answer.status.tolist() == [exact.BAD_INPUT, exact.OK, exact.OK]
    np.testing.assert_allclose(answer.alpha[1:] @ [10, 20], 7)
    one = exact.solve([0.1, 0.2], [tiny, tiny], [10, 20], [7.0, 8.0])
    assert one.status.tolist() == [exact.BAD_INPUT] * 2


def test_what_does_not_fit_is_an_error():
    with pytest.raises(DataError, match="do not fit"):
        exact.solve([0.1, 0.2], [0.1, 0.1, 0.1], [1, 1], 0.2)
    with pytest.raises(DataError, match="at least one axis"):
        exact.solve(0.1, [0.1], [1], 0.2)
    with pytest.raises(DataError, match="mu must be an array"):
        exact.solve(["a"], [0.1], [1], 0.2)


def test_small_difference_of_large_areas_is_exact_to_rounding():
    """S'alpha - b where b is S'alpha in doubles: what is left is below one rounding error of it."""
    rng = np.random.default_rng(0)
    areas, alpha = rng.uniform(1, 300, (50, 23)), rng.uniform(0, 1, (50, 23))
    target = (areas * alpha).sum(axis=1)
    pairs = zip(areas.tolist(), alpha.tolist(), target.tolist(), strict=True)
    wanted = [
        float(sum(Fraction(s) * Fraction(a) for s, a in zip(*row, strict=True)) - Fraction(b))
        for *row, b in pairs
    ]
    assert np.abs(wanted).max() > 1e-14
    found = [exact_kernel.excess_of(*row) for row in zip(areas, alpha, target, strict=True)]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-25)


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_rows_at_an_end_have_multipliers_of_their_own(end):
    """Each row's multiplier is that of the row solved alone."""
    mu = np.array([[0.3, 0.5], [0.6, 0.2], [0.45, 0.7]])
    sigma = np.array([[0.1, 0.2], [0.05, 0.1], [0.3, 0.02]])
    areas = np.array([20.0, 35.0])
    target = np.full(3, end * areas.sum())
    together = exact.solve(mu, sigma, areas, target)
    alone = [exact.solve(m, s, areas, target[0]) for m, s in zip(mu, sigma, strict=True)]
    assert len({float(one.multiplier) for one in alone}) == 3
    assert together.multiplier.tolist() == [float(one.multiplier) for one in alone]
