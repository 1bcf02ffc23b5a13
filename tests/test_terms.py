"""Every term: its cvxpy expression against plain NumPy at random points, and what it refuses."""

from collections.abc import Callable

import cvxpy as cp
import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.calibration.feasibility import reach
from rtcal.calibration.measured import times_in_room
from rtcal.calibration.unknowns import Configurations, Numbers
from rtcal.support.errors import DataError, ModelError
from tests.conftest import random_room, true_times

EYRING = rt.Eyring()
N, K = 4, 4
GAIN = [0.5, 1.0, 2.0, 1.5]
CORRELATED = terms.PriorDeviation(band_correlation=0.7, material_correlation={("m1", "m3"): 0.5})
BOTH = terms.PriorDeviation(
    band_correlation=0.6, material_correlation={("m1", "m3"): 0.5}, common=True
)
SEEN = terms.LinearObservations()
DRAWN = np.random.default_rng(7).standard_normal((5, N * K + 1))
DATA = terms.Observed(matrix=DRAWN[:, :-1], values=DRAWN[:, -1], covariance=np.eye(5))


def numbers_of(seed, *objective):
    """Return the numbers of a room with a missing T, one sigma of 0 and a second configuration."""
    rng = np.random.default_rng(seed)
    room = random_room(rng, N, K)
    sigma = room.sigma.copy()
    sigma[0, 1] = 0.0
    room = room.replace(
        sigma=sigma,
        air=rt.Air(),
        volume_sigma=0.05,
        area_sigma=0.03,
        common_area_sigma=0.02,
        common_alpha_sigma=0.1,
        climate_sigma=(2, 10),
    )
    both = Configurations([room, room.replace(name="other", areas=room.areas[::-1], surfaces=())])
    terms_ = [terms.PriorDeviation(), *objective]
    composed = rt.Calibration(sum(terms_), []).build(both, EYRING)
    times = [true_times(rng, r, EYRING) for r in both.rooms]
    times[0][2] = np.nan
    measured = [times_in_room(r, t) for r, t in zip(both.rooms, times, strict=True)]
    return composed.numbers(measured, {SEEN: DATA} if SEEN in objective else None)


def model_at(numbers, x):
    """Return a model whose unknowns have the deviations x, (size,)."""
    m = terms.Model(numbers.layout)
    m.x.value = x[: N * K]
    if m.effects is not None:
        m.effects.value = x[N * K :]
    return m


def filled(m, numbers):
    for parameter, compute in m.parameters:
        parameter.value = np.reshape(compute(numbers), parameter.shape)


def value_of(term, numbers, x):
    """Return a term's expression at the deviations x, minimised over the variables of its own."""
    m = model_at(numbers, x)
    expression = term(m)
    filled(m, numbers)
    held = numbers.alpha(numbers.sigma) > 0
    at = [m.deviation[held] == m.deviation.value[held]]
    at += [] if m.effects is None else [m.effects == m.effects.value]
    at += [variable >= 0 for variable in m.nonnegative]
    problem = cp.Problem(cp.Minimize(expression), [*m.definitions, *at])
    problem.solve(solver="CLARABEL", tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return float(problem.value)


def u_of(numbers, x):
    return numbers.mu + numbers.sigma * x


def left(numbers, x):
    """S'alpha - b of all configurations and bands, in m², 0 without T."""
    u = u_of(numbers, x)
    area = numbers.areas @ numbers.alpha(u) + numbers.gains @ numbers.further(u)
    return np.where(numbers.matched, area - numbers.target, 0.0)


def gaussian(numbers, x, r):
    """½ x'R⁻¹x over the coefficients with sigma > 0: others are integrated out."""
    moves = numbers.sigma[: N * K] > 0
    return 0.5 * float(
        x[: N * K][moves] @ np.linalg.solve(r[np.ix_(moves, moves)], x[: N * K][moves])
    )


def correlation(numbers, of_bands, *, common=False):
    """R by its definition: bands by octaves apart, m1 and m3 by 0.5, and q q' of a common part."""
    octaves = np.log2(np.array(numbers.layout.centre_frequencies))
    between = np.eye(N)
    between[1, 3] = between[3, 1] = 0.5
    r = np.kron(between, of_bands ** np.abs(octaves[:, None] - octaves))
    q = (0.1 * numbers.mu / np.where(numbers.sigma > 0, numbers.sigma, np.inf))[: N * K]
    return r + np.outer(q, q) if common else r


def huber(x, t, e):
    a = np.abs(x)
    return float(np.sum(e * a**2 / 2 + (1 - e) * np.where(a <= t, a**2 / 2, t * a - t**2 / 2)))


def uncertain(numbers, x):
    used = numbers.matched.ravel()
    noise = np.diag(np.nan_to_num(numbers.target_uncertainty).ravel() ** 2)
    covariance = (noise + numbers.room_changes.T @ numbers.room_changes)[np.ix_(used, used)]
    r = left(numbers, x).ravel()[used]
    return 0.5 * float(r @ np.linalg.solve(covariance, r))


def smooth(numbers, x):
    moves = numbers.alpha(numbers.sigma) > 0
    both = moves[:, 1:] & moves[:, :-1]
    steps = np.diff(numbers.alpha(x), axis=1) ** 2
    return 0.5 * float(np.sum(steps * both / np.diff(np.log2(numbers.layout.centre_frequencies))))


def free(numbers, x):
    return x[: N * K][numbers.sigma[: N * K] > 0]


def observed(numbers, x):
    residual = np.linalg.qr(DATA.matrix)[0].T @ (DATA.values - DATA.matrix @ u_of(numbers, x))
    return 0.5 * float(residual @ residual)


Value = Callable[[Numbers, np.ndarray], float]
OBJECTIVE = {
    "prior": (terms.PriorDeviation(), lambda of, x: 0.5 * float(free(of, x) @ free(of, x))),
    "correlated": (CORRELATED, lambda of, x: gaussian(of, x, correlation(of, 0.7))),
    "correlated and together": (
        BOTH,
        lambda of, x: gaussian(of, x, correlation(of, 0.6, common=True)),
    ),
    "huber": (terms.HuberDeviation(0.8), lambda of, x: huber(free(of, x), 0.8, 0.01)),
    "soft": (
        terms.SoftMatch(0.05),
        lambda of, x: 0.5 * float(np.nansum((left(of, x) / of.target_uncertainty) ** 2)),
    ),
    "uncertain room": (terms.SoftMatch(0.05, room=True), uncertain),
    "smooth": (terms.BandSmoothness(), smooth),
    "effect": (
        terms.AddedAbsorption("opening", GAIN, sigma=2.0, mean=0.5),
        lambda of, x: 0.5 * float(x[N * K] ** 2),
    ),
    "observations": (SEEN, observed),
}


@pytest.mark.parametrize("name", OBJECTIVE)
@pytest.mark.parametrize("seed", range(3))
def test_an_objective_term_has_its_value(name, seed):
    term, by_numpy = OBJECTIVE[name]
    numbers = numbers_of(seed, *([] if getattr(term, "is_prior", False) else [term]))
    rng = np.random.default_rng(seed + 100)
    for scale in (0.5, 3.0):
        x = scale * rng.standard_normal(numbers.layout.size)
        wanted = by_numpy(numbers, x)
        assert wanted > 1e-3
        assert value_of(term, numbers, x) == pytest.approx(wanted, rel=1e-6)


def within(numbers):
    """The excess of S'alpha over b in m² of T 5 % longer and shorter, 0 without T."""
    ends = (
        np.array(
            [EYRING.target(r, f * t) for r, t in zip(numbers.rooms, numbers.time, strict=True)]
        )
        for f in (1.05, 0.95)
    )
    return tuple(np.nan_to_num(end - numbers.target) for end in ends)


def group(numbers, x, members):
    return numbers.areas[0, members] @ numbers.alpha(u_of(numbers, x))[members]


ROWS = {
    "exact": (terms.ExactMatch(), lambda of, x: np.abs(left(of, x)).ravel()),
    "within": (
        terms.MatchWithin(1.0),
        lambda of, x: np.maximum.reduce(
            [within(of)[0] - left(of, x), left(of, x) - within(of)[1], 0 * left(of, x)]
        ).ravel(),
    ),
    "at most": (
        terms.AtMost("m1", "m3"),
        lambda of, x: np.maximum(-np.diff(of.alpha(u_of(of, x))[[1, 3]], axis=0)[0], 0.0),
    ),
    "group": (
        terms.GroupAbsorption(["m0", "m2"], least=15.0, most=20.0),
        lambda of, x: np.maximum(np.abs(group(of, x, [0, 2]) - 17.5) - 2.5, 0.0),
    ),
    "group at most": (
        terms.GroupAbsorption(["m0", "m2"], most=15.0),
        lambda of, x: np.maximum(group(of, x, [0, 2]) - 15.0, 0.0),
    ),
    "group at least": (
        terms.GroupAbsorption(["m0", "m2"], least=20.0),
        lambda of, x: np.maximum(20.0 - group(of, x, [0, 2]), 0.0),
    ),
    "group at one band": (
        terms.GroupAbsorption(["m0", "m1"], least=20.0, most=20.0, band=250),
        lambda of, x: np.abs(group(of, x, [0, 1])[[2]] - 20.0),
    ),
}


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("seed", range(3))
def test_a_constraint_is_violated_by_as_much_as_it_should(name, seed):
    term, by_numpy = ROWS[name]
    numbers = numbers_of(seed)
    x = 3 * np.random.default_rng(seed + 50).standard_normal(numbers.layout.size)
    m = model_at(numbers, x)
    stated = term(m)
    filled(m, numbers)
    violations = [np.broadcast_to(c.violation(), c.shape).ravel() for c in stated]
    wanted = by_numpy(numbers, x)
    assert np.max(wanted) > 1e-3
    np.testing.assert_allclose(np.sum(violations, axis=0), wanted, atol=1e-9)


@pytest.mark.parametrize("term", [CORRELATED, BOTH, terms.HuberDeviation()])
def test_a_prior_is_as_convex_as_it_claims(term):
    numbers = numbers_of(1)
    r = correlation(numbers, 0.7 if term is CORRELATED else 0.6, common=term is BOTH)
    least = 0.01 if isinstance(term, terms.HuberDeviation) else 1 / np.linalg.eigvalsh(r).max()
    claimed = term.convexity(numbers)
    assert 0.5 * least < claimed <= least * (1 + 1e-12)


def test_effects_widen_the_reach_of_their_own_band_and_side():
    effects = [
        terms.AddedAbsorption(name, gain, sigma=3.0)
        for name, gain in (("opening", [1.0, 0, 0, 0]), ("correction", [0, 0, -2.0, 0]))
    ]
    numbers = numbers_of(2, *effects)
    least, most = reach(numbers)
    known = numbers.areas[0, 0] * numbers.mu[1]  # the coefficient with sigma = 0, in band 1
    total = numbers.areas[0].sum()
    np.testing.assert_allclose(least[0], [0, known, -np.inf, 0])
    full = total - numbers.areas[0, 0] + known
    np.testing.assert_allclose(most[0], [np.inf, full, total, total])


def test_groups_of_shared_materials_stay_apart():
    room = random_room(np.random.default_rng(0), 5, 2)
    room = room.replace(alpha=np.full((5, 2), 0.3), sigma=np.full((5, 2), 0.1))
    shared = [terms.Shared("m1", "m3"), terms.Shared("m4", "m0")]

    def layout(*constraints):
        return rt.Calibration(terms.PriorDeviation(), constraints).build(room).layout

    assert layout(*shared).alpha_rows == (0, 1, 2, 1, 0)
    assert layout(*shared, terms.Shared("m3", "m0")).alpha_rows == (0, 0, 1, 0, 0)


P = terms.PriorDeviation
REFUSED = [
    (lambda: P(sigma=0.0), DataError, "PriorDeviation"),
    (lambda: P(band_correlation=np.ones((4, 4))), DataError, "band_correlation"),
    (lambda: terms.HuberDeviation(threshold=-1), DataError, "threshold"),
    (lambda: terms.SoftMatch(5), DataError, "percent"),
    (lambda: terms.MatchWithin(20), DataError, "MatchWithin"),
    (lambda: terms.AddedAbsorption("x", [1, np.nan], 1.0), DataError, '"x"'),
    (lambda: terms.AddedAbsorption("x", [1, 1], 0.0), DataError, "sigma"),
    (lambda: terms.AtMost("a", "a"), DataError, '"a"'),
    (lambda: terms.AtMost("a", 5), DataError, "AtMost: material"),
    (lambda: terms.GroupAbsorption(["a"]), DataError, "least, most or both"),
    (lambda: terms.GroupAbsorption(["a"], least=3, most=2), DataError, "least"),
    (lambda: terms.Shared("a"), DataError, "two"),
    (lambda: terms.Bounds(0.6, 0.5), DataError, "Bounds"),
    (lambda: terms.Fixed("a", -0.1), DataError, "Fixed"),
    (lambda: P(material_correlation={"m0": 0.5}), DataError, "pair of materials"),
    (lambda: -1 * terms.BandSmoothness(), DataError, "-1"),
    (lambda: P() + 5, ModelError, "5"),
    (lambda: P() + terms.BandSmoothness, ModelError, r"BandSmoothness\(\)"),
    (lambda: rt.Calibration(P(), [terms.ExactMatch]), ModelError, r"ExactMatch\(\)"),
    (lambda: rt.Calibration(P(), [terms.SoftMatch()]), ModelError, "neither a constraint"),
    (lambda: rt.Calibration(P() + terms.HuberDeviation()), ModelError, "2 prior"),
    (lambda: rt.Calibration(0 * P() + terms.SoftMatch()), ModelError, "weight 0"),
    (lambda: rt.Calibration(P() + P()), ModelError, "2 prior"),
    (lambda: rt.Calibration(P(), [terms.ExactMatch()] * 2), ModelError, "twice"),
    (
        lambda: rt.Calibration(P() + terms.SoftMatch(0.05) + terms.SoftMatch(0.1)),
        ModelError,
        "two soft",
    ),
]


@pytest.mark.parametrize(("make", "error", "place"), REFUSED)
def test_what_makes_no_sense_is_refused(make, error, place):
    with pytest.raises(error, match=place):
        make()


def two(m):
    return [m.deviation, m.deviation]


def not_dpp(m):
    first, second = (m.parameter(m.deviation.shape, lambda of: of.alpha(of.mu)) for _ in range(2))
    return cp.sum_squares(cp.multiply(cp.multiply(first, second), m.deviation))


SHARE = terms.Shared("m0", "m1")
BUILT = [
    (P(material_correlation={("m0", "no"): 0.5}), [], DataError, '"no"'),
    (P(material_correlation={("m0", "m1"): 1.5}), [], ModelError, "definite"),
    (P(), [terms.Shared("m0", "no")], DataError, '"no"'),
    (P(), [terms.AtMost("m0", "no")], DataError, '"no"'),
    (P(), [terms.AtMost("m0", "m1", band=8000)], DataError, "8000 Hz"),
    (P(), [terms.AtMost("m0", "m1", band=0)], DataError, "band = 0"),
    (P(), [terms.Shared("m2", "m3"), terms.GroupAbsorption(["m2"], most=5)], ModelError, '"m3"'),
    (P() + not_dpp, [], ModelError, "cvxpy cannot compile"),
    (P() + (lambda m: cp.norm(m.deviation[0])), [], ModelError, "not a quadratic program"),
    (P() + (lambda m: -cp.sum_squares(m.deviation)), [], ModelError, "not convex"),
    (P() + (lambda m: m.deviation), [], ModelError, "must return one number"),
    (P(), [two], ModelError, "must return"),
    (
        P() + terms.AddedAbsorption("x", GAIN, 1.0) + terms.AddedAbsorption("x", [1.0] * 4, 1.0),
        [],
        ModelError,
        "the same name",
    ),
]


@pytest.mark.parametrize(("objective", "constraints", "error", "place"), BUILT)
def test_terms_that_do_not_fit_the_room_are_refused_when_built(
    objective, constraints, error, place
):
    room = random_room(np.random.default_rng(0), N, K)
    with pytest.raises(error, match=place):
        rt.Calibration(objective, constraints).build(room)


@pytest.mark.parametrize("r", [-0.1, 1.0, np.nan])
def test_a_correlation_of_bands_is_at_least_0_and_below_1(r):
    with pytest.raises((DataError, ModelError), match="band_correlation"):
        P(band_correlation=r)


def test_numbers_that_do_not_fit_are_refused_when_solved():
    room = random_room(np.random.default_rng(0), N, K)
    t = true_times(np.random.default_rng(0), room, EYRING)
    for objective, constraints, error, place in (
        (P(), [SHARE], DataError, "have the same prior"),
        (P() + terms.SoftMatch(), [], DataError, r"the uncertainty of T\[63 Hz\] is unknown or 0"),
        (P() + terms.SoftMatch(), [], DataError, "give the term's `relative` one"),
        (P() + terms.SoftMatch(1e-9), [], DataError, r"uncertainty of T\[63 Hz\] is below"),
        (P() + terms.AddedAbsorption("x", [1, 1], 1.0), [], ModelError, "shape"),
        (P(), [terms.Bounds(0.6, 1), terms.Bounds(0, 0.5)], DataError, "lower bound is above"),
        (P(), [terms.Bounds(material=5)], DataError, "material = 5"),
        (P(), [terms.Bounds(band=-1)], DataError, "band = -1"),
        (P(), [terms.Fixed("m0", band="500 Hz")], DataError, "band"),
    ):
        with pytest.raises(error, match=place):
            rt.Calibration(objective, constraints).build(room).solve(t)
