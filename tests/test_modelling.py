"""Composed calibrations: compile once, every solver agrees, what is proved holds."""

from itertools import combinations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rtcal as rt
from rtcal import terms
from rtcal.calibration.problem import fit
from rtcal.calibration.unknowns import Configurations
from tests.conftest import also, random_room, room_of, true_times

EYRING = rt.Eyring()
PRIOR = terms.PriorDeviation()
# Each ingredient: an objective term, a constraint, or a prior in place of the plain one.
INGREDIENTS = {
    "correlated": terms.PriorDeviation(band_correlation=0.5),
    "huber": terms.HuberDeviation(),
    "soft": terms.SoftMatch(0.03),
    "smooth": 0.3 * terms.BandSmoothness(),
    "effect": terms.AddedAbsorption("opening", [0.5, 1.0, 2.0], sigma=1.0),
    "exact": terms.ExactMatch(),
    "within": terms.MatchWithin(0.5),
    "bounds": terms.Bounds(0.05, 0.95, "m0"),
    "fixed": terms.Fixed("m1"),
    "shared": terms.Shared("m2", "m3"),
    "at most": terms.AtMost("m0", "m4"),
    "group": terms.GroupAbsorption(["m0", "m4"], most=80.0),
}


def composed(*names):
    parts = [INGREDIENTS[n] for n in names]
    objective = [p for p in parts if isinstance(p, terms.Objective | terms.Term)]
    constraints = [p for p in parts if not isinstance(p, terms.Objective | terms.Term)]
    if not any(getattr(t, "is_prior", False) for t in objective):
        objective.insert(0, PRIOR)
    return rt.Calibration(sum(objective), constraints)


def a_room(rng):
    """Materials 2 and 3 have one prior, so that they can be shared."""
    room = random_room(rng, 5, 3)
    alpha, sigma = room.alpha.copy(), room.sigma.copy()
    alpha[3], sigma[3] = alpha[2], sigma[2]
    return room.replace(alpha=alpha, sigma=sigma)


PAIRS = [p for p in combinations(INGREDIENTS, 2) if p != ("correlated", "huber")]
ONE_OR_TWO = [*((n,) for n in INGREDIENTS), *also(*((p,) for p in PAIRS))]


@pytest.mark.parametrize("names", ONE_OR_TWO, ids=" & ".join)
def test_changed_data_resolve_without_compiling(names, compilations):
    """Prior, areas, volume, air, T and missing bands change; the answer follows."""
    rng = np.random.default_rng(len(names[0]) + 7 * len(names[-1]))
    room = a_room(rng)
    problem = composed(*names).build(room)
    first = problem.solve(true_times(rng, room, EYRING))
    assert len(compilations) == 1
    answers = [first.alpha]
    for round_ in range(2):
        other = a_room(rng).replace(volume=150.0 + 50 * round_, air=rt.Air(15, 60))
        t = true_times(rng, other, EYRING)
        t[round_] = np.nan
        result = problem.solve(t, other)
        answers.append(result.alpha)
        assert result.certificate.worst < 1e-9
        assert np.nanmax(result.certificate.alpha_error_bound) < 1e-4
    assert len(compilations) == 1
    assert np.abs(answers[1] - answers[2]).max() > 1e-3
    # Built anew for the last room, the answer is the same.
    rt.calibration.forget()
    fresh = composed(*names).build(other).solve(t)
    np.testing.assert_allclose(fresh.alpha, answers[2], rtol=0, atol=1e-8)


@pytest.mark.parametrize("seed", range(6))
def test_theorem_separable_sigma_exact_match_no_bound(seed):
    """sigma_ik = u_i v_k, one band correlation, exact match, no bound: nothing changes alpha."""
    rng = np.random.default_rng(seed)
    room = random_room(rng, 6, 8)
    separable = np.outer(rng.uniform(0.02, 0.1, 6), rng.uniform(0.5, 1.0, 8))
    room = room.replace(sigma=separable)
    t = EYRING.time(room, room.areas @ (room.alpha + 0.3 * separable * rng.standard_normal((6, 8))))
    plain = rt.calibrate(room, t)
    assert not plain.active.any()
    assert np.abs(plain.shift).max() > 1e-3
    exact = [terms.ExactMatch()]
    for objective in (
        terms.PriorDeviation(band_correlation=0.8),
        PRIOR + 0.7 * terms.BandSmoothness(),
        terms.PriorDeviation(band_correlation=0.3) + 5 * terms.BandSmoothness(),
    ):
        other = rt.Calibration(objective, exact).build(room).solve(t)
        np.testing.assert_allclose(other.alpha, plain.alpha, rtol=0, atol=1e-10)


@given(
    st.integers(0, 10_000),
    st.lists(st.sampled_from(list(INGREDIENTS)), min_size=2, max_size=4, unique=True),
    st.sampled_from([0.0, 0.25, 0.35]),
    st.sampled_from([0.7, 1.0, 1.5]),
)
@settings(max_examples=25)
def test_random_compositions_are_certified_by_two_solvers(seed, names, shift, factor):
    """Also near the box and far from the prior; or the contradiction is named."""
    if {"correlated", "huber"} <= set(names):
        names.remove("huber")
    rng = np.random.default_rng(seed)
    room = a_room(rng)
    room = room.replace(alpha=np.clip(room.alpha - shift, 0.06, 1))
    t = true_times(rng, room, EYRING) * factor
    problem = composed(*names).build(room)
    found, refused = [], []
    for solver in ("clarabel", "osqp"):
        try:
            found.append(problem.solve(t, solver=solver))
        except rt.errors.InfeasibleError as error:
            refused.append(str(error))
    assert len(found) != 1
    assert all("contradict" in text or "cannot be reached" in text for text in refused)
    if found:
        assert all(r.certificate.worst < 1e-9 for r in found)
        np.testing.assert_allclose(found[0].alpha, found[1].alpha, rtol=0, atol=1e-6)


def test_constraints_do_what_they_say():
    rng = np.random.default_rng(5)
    room = a_room(rng)
    t = true_times(rng, room, EYRING) * 0.9
    exact = terms.ExactMatch()

    def solved(*constraints, objective=PRIOR):
        return rt.Calibration(objective, list(constraints)).build(room).solve(t)

    plain = solved(exact)
    lesser, greater = (1, 0) if (plain.alpha[1] > plain.alpha[0]).any() else (0, 1)
    ordered = solved(exact, terms.AtMost(f"m{lesser}", f"m{greater}"))
    assert (plain.alpha[lesser] > plain.alpha[greater]).any()
    assert (ordered.alpha[lesser] <= ordered.alpha[greater] + 1e-12).all()
    only = solved(exact, terms.AtMost(f"m{lesser}", f"m{greater}", band=125))
    assert only.alpha[lesser, 1] <= only.alpha[greater, 1] + 1e-12
    np.testing.assert_allclose(only.alpha[:, [0, 2]], plain.alpha[:, [0, 2]], atol=1e-12)
    fixed = solved(exact, terms.Fixed("m0"), terms.Fixed("m1", 0.5, band=125))
    np.testing.assert_array_equal(fixed.alpha[0], room.alpha[0])
    assert fixed.alpha[1, 1] == 0.5 != fixed.alpha[1, 0]
    shared = solved(exact, terms.Shared("m2", "m3"))
    np.testing.assert_array_equal(shared.alpha[2], shared.alpha[3])
    one = room.replace(
        materials=["m0", "m1", "m2", "m4"],
        areas=[*room.areas[:2], room.areas[2] + room.areas[3], room.areas[4]],
        alpha=np.delete(room.alpha, 3, 0),
        sigma=np.delete(room.sigma, 3, 0),
    )
    np.testing.assert_allclose(rt.calibrate(one, t).alpha[2], shared.alpha[2], atol=1e-12)
    within = solved(terms.MatchWithin(1.0))
    assert np.abs(within.gap_after).max() == pytest.approx(1.0, abs=1e-9)
    assert np.abs(within.shift_in_sigmas).max() < np.abs(plain.shift_in_sigmas).max()


def test_an_effect_is_found_beside_alpha():
    rng = np.random.default_rng(3)
    room = random_room(rng, 5, 3).replace(sigma=np.full((5, 3), 0.002))
    gain = np.array([1.0, 4.0, 2.0])
    t = EYRING.time(room, room.areas @ room.alpha + 1.5 * gain)
    term = terms.AddedAbsorption("opening", gain, sigma=3.0)
    result = rt.Calibration(PRIOR + term).build(room).solve(t)
    size, joint = result.effects["opening"], result.joint
    (spread,) = joint.numbers.further(joint.estimate_sigma)
    assert size == pytest.approx(1.5, abs=0.02)
    assert 0 < spread < 0.1
    np.testing.assert_allclose(result.reverberation_time_after, t, rtol=1e-10)
    assert result.to_dict()["effects"] == {"opening": size}
    # Nothing missing: the size stays at its bound, 0.
    t = EYRING.time(room, room.areas @ (room.alpha - 0.002))
    assert rt.Calibration(PRIOR + term).build(room).solve(t).effects["opening"] == 0.0


def test_a_contradiction_is_explained_by_the_smallest_relaxation():
    room = room_of({"a": (50, 0.3, 0.1), "b": (50, 0.3, 0.1)}, [1000], 60, name="two")
    t = EYRING.time(room, np.array([30.0]))
    constraints = [terms.ExactMatch(), terms.GroupAbsorption(["a"], least=40.0)]
    with pytest.raises(rt.errors.InfeasibleError) as error:
        rt.Calibration(PRIOR, constraints).build(room).solve(t)
    # 40 m² of a alone, but T allows 30: 10 m² are 0.1 of all 100 m², 0.2 of a's 50 m².
    assert str(error.value) == (
        "the constraints contradict each other. The smallest change that removes the "
        "contradiction: exact match of T at 1000 Hz (m² of absorption) has to be 10 higher"
    )
    with pytest.raises(rt.errors.InfeasibleError) as error:
        rt.Calibration(PRIOR, [terms.MatchWithin(1), constraints[1]]).build(room).solve(t)
    # 1 JND: T may be 5 % shorter, so that Eyring's exponent 0.3567 is 0.3754 and S'alpha 31.30 m².
    assert str(error.value).endswith(
        "contradiction: match of T within 1 JND at 1000 Hz (m² of absorption) has to be 8.698 higher"
    )
    with pytest.raises(rt.errors.InfeasibleError, match=r"upper bound 0\.1 has to be 0\.02"):
        rt.Calibration(
            PRIOR + terms.SoftMatch(0.05),
            [
                terms.Bounds(0, 0.1, "a"),
                terms.Bounds(0.12, 1, "b"),
                terms.AtMost("b", "a"),
                terms.GroupAbsorption(["a"], least=6.0),
            ],
        ).build(room).solve(t)
    # Two configurations that ask one room for two T.
    twice = Configurations([room, room])
    with pytest.raises(rt.errors.InfeasibleError, match="configuration"):
        rt.Calibration(PRIOR).build(twice).solve([t, 1.2 * t])


def test_two_configurations_determine_two_materials():
    """Exact in both, without noise: the two coefficients are determined."""
    a = room_of(
        {"wall": (90, [0.3, 0.4], 0.1), "curtain": (10, [0.5, 0.6], 0.1)},
        [500, 1000],
        100,
        name="open",
    )
    b = a.replace(name="drawn", areas=[75, 25])
    truth = np.array([[0.25, 0.45], [0.62, 0.51]])
    times = [EYRING.time(r, r.areas @ truth) for r in (a, b)]
    both = Configurations([a, b])
    result = rt.Calibration(PRIOR).build(both).solve(times)
    np.testing.assert_allclose(result.alpha, truth, atol=1e-10)
    assert result.certificate.worst < 1e-9
    for view, t in zip(result.results, times, strict=True):
        np.testing.assert_allclose(view.reverberation_time_after, t, rtol=1e-10)
        assert view.room.alpha.shape == (2, 2)
    joint = rt.calibrate(both, times, method="joint")
    assert np.abs(joint.alpha - truth).max() < np.abs(rt.calibrate(a, times[0]).alpha - truth).max()
    assert "configuration: drawn" in str(joint)
    # A room of twice the size with the same coefficients: dependent rows, still certified.
    twice = a.replace(name="twice", volume=2 * a.volume, areas=2 * a.areas)
    same = rt.Calibration(PRIOR).build(Configurations([a, twice])).solve([times[0]] * 2)
    np.testing.assert_allclose(same.alpha, rt.calibrate(a, times[0]).alpha, atol=1e-9)


def test_a_function_is_a_term():
    """An expression to be minimised or constraints: nothing else has to be stated."""
    rng = np.random.default_rng(6)
    room = a_room(rng)
    t = true_times(rng, room, EYRING)
    opinion = room.alpha + 0.05

    def second_opinion(m):
        return 0.5 * cp.sum_squares((m.alpha - opinion) / 0.02)

    def quiet_floor(m):
        return [m.alpha[0] <= 0.5 * opinion[0]]

    result = rt.Calibration(PRIOR + second_opinion, [quiet_floor]).build(room).solve(t)
    precision = 1 / room.sigma**2 + 1 / 0.02**2
    wanted = (room.alpha / room.sigma**2 + opinion / 0.02**2) / precision
    wanted[0] = np.minimum(wanted[0], 0.5 * opinion[0])
    np.testing.assert_allclose(result.alpha, wanted, rtol=0, atol=1e-12)
    assert result.certificate.worst < 1e-9
    too_much = [lambda m: m.absorption_area >= 2 * m.target, terms.ExactMatch()]
    with pytest.raises(rt.errors.InfeasibleError, match="smallest change"):
        rt.Calibration(PRIOR, too_much).build(room).solve(t)


class Levels:
    """Data of a user's own: the steady level of a source by band, -10 lg of the absorption area."""

    def __init__(self, room, values):
        self.room, self.values = room, values
        self.covariance = 0.1**2 * np.eye(len(values))

    def predict(self, alpha):
        return np.asarray(-10 * np.log10(self.room.areas @ alpha))

    def jacobian(self, alpha):
        by_area = -10 / np.log(10) / (self.room.areas @ alpha)
        rows = np.einsum("k,m,kl->kml", by_area, self.room.areas, np.eye(len(by_area)))
        return np.asarray(rows.reshape(len(by_area), -1))


def test_a_kind_of_data_from_outside_is_fitted():
    """No file of the package knows it: the fit ends where the objective with its own model is least."""
    room = random_room(np.random.default_rng(8))
    term = terms.LinearObservations("levels")
    twice = np.clip(2 * room.alpha, 0, 0.9)
    data = Levels(room, -10 * np.log10(room.areas @ twice))
    problem = rt.Calibration(PRIOR + term, []).build(room)

    def fitted(most):
        return fit(problem, data, room.alpha, term=term, method="levels", most=most)

    ended = fitted(6)
    assert ended.settled
    assert len(ended.steps) > 1
    x, slope = (ended.alpha - room.alpha) / room.sigma, data.jacobian(ended.alpha)
    pull = slope.T @ (data.values - data.predict(ended.alpha)) / 0.1**2
    inside = (ended.alpha > 0) & (ended.alpha < 1)
    force = pull.reshape(room.alpha.shape) * room.sigma - x
    assert np.abs(force[inside]).max() < 0.05 * np.abs(pull.max() * room.sigma).max()
    assert not fitted(1).settled
    left = [np.abs(data.values - data.predict(a)).max() for a in (room.alpha, ended.alpha)]
    assert left[1] < 0.5 * left[0]
